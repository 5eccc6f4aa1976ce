"""How far carried rows are from the target's."""

import numpy as np

from skat.metrics import affinity_score


def pointwise_errors(rows, target_rows, context):
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


def covariance_error(rows, target_rows, context):
    r"""Return how far the covariance of the outcomes is from that of the target's.

    .. math:: \|C - C_t\|_F / \|C_t\|_F

    Parameters
    ----------
    rows, target_rows : ndarray of shape (n_rows, n_features)
    context : int
        Number of leading columns that are no outcome.

    Returns
    -------
    float
        Over the columns that the pointwise error is over, in their units.
    """
    covariance, target_covariance = (np.cov(part[:, context:].T) for part in (rows, target_rows))
    return float(np.linalg.norm(covariance - target_covariance) / np.linalg.norm(target_covariance))


def affinity_of_first(rows, target_rows, n_rows):
    """Return the affinity score of the first rows; its time grows with the cube of their number."""
    return affinity_score(rows[:n_rows], target_rows[:n_rows])
