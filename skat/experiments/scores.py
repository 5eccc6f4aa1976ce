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


def covariance_error(rows, target_rows):
    r"""Return how far the covariance of rows is from that of the target's, whatever the columns' units.

    .. math:: \|D^{-1} (C - C_t) D^{-1}\|_F / \|D^{-1} C_t D^{-1}\|_F

    with D the diagonal matrix of the target's standard deviations, 1 for constant columns.

    Parameters
    ----------
    rows, target_rows : ndarray of shape (n_rows, n_features)

    Returns
    -------
    float
    """
    deviations = target_rows.std(axis=0)
    scale = np.where(deviations > 0, deviations, 1.0)
    covariance, target_covariance = np.cov((rows / scale).T), np.cov((target_rows / scale).T)
    return float(np.linalg.norm(covariance - target_covariance) / np.linalg.norm(target_covariance))


def affinity_of_first(rows, target_rows, n_rows):
    """Return the affinity score of the first rows; its time grows with the cube of their number."""
    return affinity_score(rows[:n_rows], target_rows[:n_rows])
