"""How far carried rows are from the target's."""

from typing import Any

import numpy as np

from skat.metrics import affinity_score, gaussian_wasserstein_distance


def pointwise_errors(rows: Any, target_rows: Any, context: Any) -> Any:
    """Return the distance between the outcomes of each pair of rows.

    Parameters
    ----------
    rows, target_rows : ndarray of shape (n_rows, n_features)
    context : int
        Number of leading columns that are no outcome.

    Returns
    -------
    ndarray of shape (n_rows,)
        Euclidean norm over the columns of the outcome, whatever their units.
    """
    return np.linalg.norm(rows[:, context:] - target_rows[:, context:], axis=1)


def covariance_errors(rows: Any, target_rows: Any, context: Any) -> dict[str, float]:
    r"""Return how far the outcomes' covariance is from that of the target's, by several measures.

    Columns have different units, so which of them counts for how much is a choice. With C the covariances of
    the outcomes, and R those of the same columns in standard deviations of the target's:

    .. math:: \frac{\|R - R_t\|_F}{\|R_t\|_F}, \quad \frac{\|C - C_t\|_F}{\|C_t\|_F}, \quad
              \frac{\|C_t^{-1/2} C C_t^{-1/2} - I\|_F}{\sqrt{\operatorname{rank} C_t}}, \quad
              \frac{W_2^2}{\operatorname{tr} R_t}, \quad \frac{W_2^2}{\operatorname{tr} C_t}

    Parameters
    ----------
    rows, target_rows : ndarray of shape (n_rows, n_features)
    context : int
        Number of leading columns that are no outcome.

    Returns
    -------
    dict of str to float
        In the order of the formulas:

        - covariance_error: does not depend on units;
        - covariance_error_raw: in units as they are, where columns of large numbers count for all;
        - covariance_error_affine: does not depend on any choice of coordinates, so that directions of hardly
          any variance count as much as the others; where C_t is not singular;
        - normal_distance: of the normals of the same means and covariances, in standard deviations;
        - normal_distance_raw: the same in units as they are.
    """
    outcome, expected = rows[:, context:], target_rows[:, context:]
    deviations = expected.std(axis=0)
    lengths = np.where(deviations > 0, deviations, 1.0)
    scaled, scaled_expected = outcome / lengths, expected / lengths
    return {
        "covariance_error": _relative_error(scaled, scaled_expected),
        "covariance_error_raw": _relative_error(outcome, expected),
        "covariance_error_affine": _affine_error(scaled, scaled_expected),
        "normal_distance": _normal_distance(scaled, scaled_expected),
        "normal_distance_raw": _normal_distance(outcome, expected),
    }


def _relative_error(outcome: Any, expected: Any) -> Any:
    covariance, target_covariance = np.cov(outcome.T), np.cov(expected.T)
    return float(np.linalg.norm(covariance - target_covariance) / np.linalg.norm(target_covariance))


def _affine_error(outcome: Any, expected: Any) -> Any:
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(expected.T)))
    regular = values > values[-1] * len(values) * np.finfo(float).eps
    whitening = vectors[:, regular] / np.sqrt(values[regular])
    whitened = np.atleast_2d(np.cov((outcome @ whitening).T))
    return float(np.linalg.norm(whitened - np.eye(len(whitened))) / np.sqrt(len(whitened)))


def _normal_distance(outcome: Any, expected: Any) -> Any:
    return gaussian_wasserstein_distance(outcome, expected) ** 2 / expected.var(axis=0).sum()


def affinity_of_first(rows: Any, target_rows: Any, n_rows: int) -> Any:
    """Return the affinity score of the first rows; its time grows with the cube of their number."""
    return affinity_score(rows[:n_rows], target_rows[:n_rows])
