"""Transport of some columns given the others: regression on the context, optimal map of the residuals."""

import numpy as np

from skat.gaussian import AffineMap, optimal_map, root_of_factor
from skat.gaussian.maps import EPS
from skat.gaussian.moments import triangle

__all__ = ["conditional_map", "regression"]


def conditional_map(source, target, context):
    r"""Return the map that leaves the context untouched and transports the rest given it, and its rank.

    With :math:`z \mid c \sim (m + B c, D)` in each domain,

    .. math:: (c, z) \mapsto \bigl(c,\; m_t + B_t c + A(D_s, D_t)\,(z - m_s - B_s c)\bigr)

    Parameters
    ----------
    source, target : Moments
        Moments of the rows of each domain.
    context : ndarray of bool of shape (n_features,)
        Which columns are context.

    Returns
    -------
    AffineMap
        Block-triangular.
    int
        Rank of its linear part.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the target's residuals vary where the source's do not.
    """
    rest = ~context
    source_slope, source_root = regression(source, context)
    target_slope, target_root = regression(target, context)
    carry = optimal_map(source_root, target_root)
    coef = np.eye(source.n_features)
    coef[np.ix_(rest, rest)] = carry
    coef[np.ix_(rest, context)] = target_slope - carry @ source_slope
    image = source.mean.copy()
    image[rest] = target.mean[rest] + (
        target_slope @ (source.mean[context] - target.mean[context])
        + target.mean_remainder[rest]
        - target_slope @ target.mean_remainder[context]
        - carry @ (source.mean_remainder[rest] - source_slope @ source.mean_remainder[context])
    )
    return AffineMap(coef, source.mean, image, untouched=context), int(context.sum()) + target_root.shape[1]


def regression(moments, context):
    """Return the slope of the other columns on the context, and a root of the residuals' covariance.

    Parameters
    ----------
    moments : Moments
        Moments of the rows.
    context : ndarray of bool of shape (n_features,)
        Which columns are context.

    Returns
    -------
    ndarray of shape (n_rest, n_context)
        Of least norm, in standard deviations of the context, where the context is singular.
    ndarray of shape (n_rest, residual_rank)
        Root of the residuals' covariance.
    """
    factor = moments.covariance_factor()
    n_context = int(context.sum())
    ordered = triangle(np.hstack([factor[:, context], factor[:, ~context]]))
    predictors, response = ordered[:, :n_context], ordered[:, n_context:]
    scale = np.sqrt(np.square(predictors).sum(axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    left, values, right = np.linalg.svd(predictors / scale, full_matrices=False)
    kept = values > 10 * EPS * len(scale) * values.max(initial=0.0)
    standardised = right[kept].T @ ((left[:, kept].T @ response) / values[kept, np.newaxis])
    residual = response - (predictors / scale) @ standardised
    # Judged against the columns themselves: what a deterministic simulation leaves is rounding, not variance.
    slope = (standardised / scale[:, np.newaxis]).T
    rounding = np.hypot(
        moments.rounding[~context], np.sqrt(np.square(slope) @ np.square(moments.rounding[context]))
    )
    return slope, root_of_factor(residual, np.sqrt(np.square(response).sum(axis=0)), rounding)
