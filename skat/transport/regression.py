"""Transport of some columns given the others: regression on the context, optimal map of the residuals."""

import numpy as np

from skat.gaussian import AffineMap, Moments, optimal_map, root_of_factor, root_of_moments
from skat.gaussian.arrays import Flags, Floats
from skat.gaussian.maps import EPS, reached_part
from skat.gaussian.moments import triangle
from skat.transport.shrinkage import shrunk_towards

__all__ = ["conditional_map", "conditional_map_back", "regression", "ridge_regression"]

# Penalties of standardised context per row, from none that shows to one that leaves the prior slope alone.
PENALTIES = np.concatenate([[0.0], np.logspace(-4, 4, 33)])


def conditional_map(
    source: Moments, target: Moments, context: Flags, *, shrinkage: str | None = None, reach: bool = False
) -> tuple[AffineMap, int, float]:
    r"""Return the map that leaves the context untouched and transports the rest given it, and its rank.

    With :math:`z \mid c \sim (m + B c, D)` in each domain,

    .. math:: (c, z) \mapsto \bigl(c,\; m_t + B_t c + A(D_s, D_t)\,(z - m_s - B_s c)\bigr)

    Parameters
    ----------
    source, target : Moments
        Moments of the rows of each domain.
    context : ndarray of bool of shape (n_features,)
        Which columns are context.
    shrinkage : {"source"} or None, default=None
        ``"source"`` draws the target's slope and residual covariance towards the source's.
    reach : bool, default=False
        Whether to carry what can be reached where the target's residuals vary and the source's do not.

    Returns
    -------
    AffineMap
        Block-triangular.
    int
        Rank of its linear part.
    float
        Share of the variance of the target's other columns that the map does not reach.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the target's residuals vary where the source's do not, unless `reach`.
    """
    source_part, target_part = _regressions(source, target, context, shrinkage, reach)
    return _map_between(source, target, source_part, target_part, context, reach)


def conditional_map_back(
    source: Moments, target: Moments, context: Flags, *, shrinkage: str | None = None, reach: bool = False
) -> AffineMap:
    """Return the way back from `conditional_map` of the same arguments.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the source's residuals vary where those of the carried rows do not.
    """
    source_part, target_part = _regressions(source, target, context, shrinkage, reach)
    return _map_between(target, source, target_part, source_part, context, False)[0]


def _regressions(
    source: Moments, target: Moments, context: Flags, shrinkage: str | None, reach: bool
) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """Return slope and root of the residuals' covariance of source and target."""
    source_part = regression(source, context)
    if shrinkage is None:
        return source_part, regression(target, context)
    return source_part, _drawn_to_source(source, target, context, *source_part, reach)


def _map_between(
    source: Moments,
    target: Moments,
    source_part: tuple[Floats, Floats],
    target_part: tuple[Floats, Floats],
    context: Flags,
    reach: bool,
) -> tuple[AffineMap, int, float]:
    """Return what `conditional_map` does, from slope and root of each side."""
    rest = ~context
    (source_slope, source_root), (target_slope, target_root) = source_part, target_part
    carry = optimal_map(source_root, target_root, reach=reach)
    rank, unreached = target_root.shape[1], 0.0
    if reach:
        rank, unreached = reached_part(carry, source_root, target_root)
        unreached *= np.square(target_root).sum() / max(target.variance[rest].sum(), np.finfo(float).tiny)
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
    return AffineMap(coef, source.mean, image, untouched=context), int(context.sum()) + rank, float(unreached)


def regression(moments: Moments, context: Flags) -> tuple[Floats, Floats]:
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
    factor = moments.covariance_factor
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


def ridge_regression(moments: Moments, context: Flags, prior: Floats) -> tuple[Floats, Floats, float]:
    r"""Return the slope of the other columns on the context, drawn towards one known beforehand.

    .. math:: B = B_0 + \Delta, \quad \Delta = \arg\min_\Delta \sum_k \|z_k - B_0 c_k - \Delta c_k\|^2
              + n \lambda \|\Delta\|^2

    about the means, in standard deviations of the context, with a penalty for each column of z. It is the one of
    least generalised cross-validation (leave-one-out with the mean of the leverages for each of them), which is a
    function of moments.

    Parameters
    ----------
    moments : Moments
        Moments of the rows.
    context : ndarray of bool of shape (n_features,)
        Which columns are context.
    prior : ndarray of shape (n_rest, n_context)
        :math:`B_0`.

    Returns
    -------
    ndarray of shape (n_rest, n_context)
        The slope.
    ndarray of shape (n_factor_rows, n_rest)
        Factor of the residuals' covariance, each column corrected for the freedom that its fit has used.
    float
        Largest number of those degrees of freedom.

    References
    ----------
    .. [1] Golub, Heath and Wahba (1979). Generalized cross-validation as a method for choosing a good ridge
       parameter. Technometrics 21(2).
    """
    factor = moments.covariance_factor
    n_rows, n_context = moments.effective_n_rows, int(context.sum())
    ordered = triangle(np.hstack([factor[:, context], factor[:, ~context]]))
    predictors, response = ordered[:, :n_context], ordered[:, n_context:]
    missing = response - predictors @ prior.T
    scale = np.sqrt(np.square(predictors).sum(axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    left, values, right = np.linalg.svd(predictors / scale, full_matrices=False)
    kept = values > 10 * EPS * len(scale) * values.max(initial=0.0)
    left, values, right = left[:, kept], values[kept], right[kept]
    scores = left.T @ missing
    outside = np.maximum(np.square(missing).sum(axis=0) - np.square(scores).sum(axis=0), 0.0)
    filters = np.square(values) / (np.square(values) + PENALTIES[:, np.newaxis])
    freedom = 1.0 + filters.sum(axis=1)
    # A fit that uses up all rows leaves nothing to judge it by.
    spare = np.maximum(n_rows - freedom, 0.0)
    errors = outside + np.square(1 - filters) @ np.square(scores)
    with np.errstate(divide="ignore", invalid="ignore"):
        judged = np.where(spare[:, np.newaxis] > 1.0, errors / np.square(spare[:, np.newaxis]), np.inf)
    best = judged.argmin(axis=0)
    correction = right.T @ (filters[best].T / values[:, np.newaxis] * scores)
    slope = prior + (correction / scale[:, np.newaxis]).T
    residual = response - predictors @ slope.T
    used = freedom[best]
    return slope, residual * np.sqrt(n_rows / np.maximum(n_rows - used, 1.0)), float(used.max())


def _drawn_to_source(
    source: Moments, target: Moments, context: Flags, source_slope: Floats, source_root: Floats, reach: bool
) -> tuple[Floats, Floats]:
    """Return slope and root of the residuals' covariance of the target, drawn towards the source's."""
    slope, residual, freedom = ridge_regression(target, context, source_slope)
    # The source's residuals have used up a degree of freedom for each column of the context.
    n_source = source.effective_n_rows
    used = min(1.0 + context.sum(), n_source - 1.0)
    n_rest, zeros = len(slope), np.zeros(len(slope))
    ours = Moments(source.n_rows, 1.0, 1.0, zeros, zeros, factor=source_root.T, eps=source.eps)
    # The two covariances err independently, and the map that is drawn towards the identity suffers from both.
    n_left = 1.0 / (1.0 / max(target.effective_n_rows - freedom, 1.0) + 1.0 / max(n_source - used, 1.0))
    loose = Moments(
        target.n_rows,
        n_left,
        n_left,
        np.zeros(n_rest),
        np.zeros(n_rest),
        factor=residual * np.sqrt(n_left * (1.0 - used / n_source)),
        eps=target.eps,
    )
    shrunk, _ = shrunk_towards(loose, ours, reach=reach)
    return slope, root_of_moments(shrunk)
