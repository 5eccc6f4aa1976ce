"""Shrinkage of a target covariance towards the source's, for few target rows."""

from dataclasses import replace

import numpy as np

from skat.gaussian import check_that_source_reaches_target, root_of_moments, spectrum
from skat.gaussian.arrays import Floats
from skat.gaussian.moments import Moments

__all__ = ["mean_drawn_towards", "shrinkage_intensity", "shrunk_towards"]


def shrunk_towards(
    target: Moments, source: Moments, pairs: Moments | None = None, *, reach: bool = False
) -> tuple[Moments, float]:
    r"""Return target moments with the covariance shrunk towards the source's, and by how much.

    In coordinates that whiten the source, so that nothing depends on units, the root of the target's
    covariance is drawn towards the identity,

    .. math:: R^* = (1 - \lambda)\, (C_s^{-1/2} C_t C_s^{-1/2})^{1/2} + \lambda I, \quad
              C_t^* = C_s^{1/2} R^{*2} C_s^{1/2},

    that is, along the shortest path between the two normal distributions in the Wasserstein metric. It is the
    root and not the covariance that is averaged because the error of the map is linear in the root. Of rows
    in pairs the target's share the sampling error of the source's, which does the map no harm: only the rest
    of it is a reason to shrink.

    Parameters
    ----------
    target, source : Moments
        Moments of the rows of each domain.
    pairs : Moments, default=None
        Moments of the same rows side by side, the source's columns first, where they are pairs.
    reach : bool, default=False
        Whether to leave out what the target varies where the source does not.

    Returns
    -------
    Moments
        The target's, with another covariance.
    float
        :math:`\lambda`, from 0 (the target's own covariance) to 1 (the source's).

    Raises
    ------
    numpy.linalg.LinAlgError
        If the target varies where the source does not, unless `reach`.
    """
    directions, spread = spectrum(root_of_moments(source))
    if len(spread) < source.n_features and not reach:
        check_that_source_reaches_target((directions.T @ spectrum(root_of_moments(target))[0]).T)
    factor = (target if pairs is None else pairs).covariance_factor
    whitened = factor[:, -source.n_features :] @ directions / spread
    scores, values, axes = np.linalg.svd(whitened, full_matrices=True)
    missing = len(spread) - len(values)
    explained = None
    if pairs is not None:
        source_scores = factor[:, : source.n_features] @ directions / spread
        explained = _explained(source_scores.T @ scores[:, : len(values)], pairs.effective_n_rows)
        explained = np.pad(explained, (0, missing))
    values = np.pad(values, (0, missing))
    intensity = shrinkage_intensity(values, target.effective_n_rows, explained)
    shrunk = (1 - intensity) * values + intensity
    factor = (shrunk[:, np.newaxis] * axes * spread) @ directions.T
    moments = Moments(
        target.n_rows,
        target.weight,
        target.squared_weight,
        target.mean,
        target.mean_remainder,
        factor=factor * np.sqrt(target.weight),
        eps=target.eps,
    )
    return moments, intensity


def mean_drawn_towards(
    target: Moments, source: Moments, n_target: float, n_source: float, pairs: Moments | None = None
) -> tuple[Moments, float]:
    r"""Return target moments with the mean drawn towards the source's, and by how much.

    In coordinates that whiten the source, so that nothing depends on units, with the difference :math:`d` of the means
    and the covariance :math:`V` of its sampling error,

    .. math:: d^* = (1 - \lambda)\, d, \quad
              \lambda = \min\Bigl(1, \frac{\operatorname{tr} V - 2 \max \operatorname{eig} V}{\|d\|^2}\Bigr)_+ ,

    the positive part of James and Stein for errors of any covariance, which for normal errors has a smaller expected
    square than :math:`d` wherever the means are; with one or two columns it is :math:`d`.

    Parameters
    ----------
    target, source : Moments
        Moments of the rows of each domain.
    n_target, n_source : float
        Numbers of their rows, the effective ones of weighted rows.
    pairs : Moments, default=None
        Moments of the same rows side by side, the source's columns first, where they are pairs: what partners share
        is no error of the difference.

    Returns
    -------
    Moments
        The target's, with another mean.
    float
        :math:`\lambda`, from 0 (the target's own mean) to 1 (the source's).

    References
    ----------
    .. [1] Bock (1975). Minimax estimators of the mean of a multivariate normal distribution. Annals of Statistics 3(1).
    """
    directions, spread = spectrum(root_of_moments(source))
    shift = (target.mean - source.mean) + (target.mean_remainder - source.mean_remainder)
    whitened = shift @ directions / spread
    if pairs is None:
        scores = target.covariance_factor @ directions / spread
        error = scores.T @ scores / max(n_target - 1, 1.0) + np.eye(len(spread)) / max(n_source - 1, 1.0)
    else:
        factor = pairs.covariance_factor
        scores = (factor[:, source.n_features :] - factor[:, : source.n_features]) @ directions / spread
        error = scores.T @ scores / max(n_target - 1, 1.0)
    spare = np.trace(error) - 2 * np.linalg.eigvalsh(error).max(initial=0.0)
    square = whitened @ whitened
    intensity = float(np.clip(spare / square, 0.0, 1.0)) if square > 0 else 0.0
    return replace(target, mean=target.mean - intensity * (directions @ (spread * whitened))), intensity


def shrinkage_intensity(values: Floats, n_rows: float, explained: Floats | None = None) -> float:
    r"""Return the weight of the identity that makes the expected squared error of a root least.

    .. math:: \lambda = \frac{\operatorname{E} \|\hat R - R\|^2}{\operatorname{E} \|\hat R - I\|^2}, \quad
              \operatorname{E} \|\hat R - R\|^2 \approx
              \frac{1}{n} \sum_{ij} \frac{r_i^2 r_j^2 (1 + \delta_{ij} - P_{ii} P_{jj} - P_{ij}^2)}{(r_i + r_j)^2}

    as for a covariance in Ledoit and Wolf (2004); the second formula is the first-order error of the root of
    the covariance of n normal rows, given the source rows. Its own :math:`r` come from a covariance shrunk in
    the ordinary way, since the sample's are too far apart.

    Parameters
    ----------
    values : ndarray of shape (n_features,)
        Singular values of the root: square roots of the eigenvalues of the whitened covariance.
    n_rows : float
        Number of rows, the effective one for weighted rows.
    explained : ndarray of shape (n_features, n_features), default=None
        P, the share of the standardised target's covariance that pairs explain by the source, in the
        directions of `values`: its eigenvalues are squared canonical correlations. None is zero, without
        pairs.

    Returns
    -------
    float
        Between 0 and 1.

    References
    ----------
    .. [1] Ledoit and Wolf (2004). A well-conditioned estimator for large-dimensional covariance matrices.
       Journal of Multivariate Analysis 88(2).
    """
    freedom = n_rows - 1
    distance = np.square(values - 1).sum()
    if freedom <= 1:
        return 1.0
    if distance == 0:
        return 0.0
    shared: Floats | float = 0.0
    if explained is not None:
        shared = np.outer(explained.diagonal(), explained.diagonal()) + np.square(explained)
    eigenvalues = np.square(values)
    trace, squares = eigenvalues.sum(), np.square(eigenvalues).sum()
    # Unbiased for the trace of the squared covariance of normal rows.
    unbiased = freedom**2 / ((freedom - 1) * (freedom + 2)) * (squares - trace**2 / freedom)
    variance = trace**2 + max(unbiased, 0.0) - (np.outer(eigenvalues, eigenvalues) * shared).sum()
    apart = np.square(eigenvalues - 1).sum()
    ordinary = min(1.0, max(variance, 0.0) / freedom / apart)
    roots = np.sqrt((1 - ordinary) * eigenvalues + ordinary)
    sums = np.add.outer(roots, roots)
    products = np.square(np.outer(roots, roots) / np.where(sums > 0, sums, 1.0))
    error = (products * (1 + np.eye(len(values)) - shared)).sum() / freedom
    return float(min(1.0, max(error, 0.0) / distance))


def _explained(cosines: Floats, n_rows: float) -> Floats:
    """Return P of `shrinkage_intensity` from products of orthonormal scores, less what chance explains."""
    freedom, n_source = n_rows - 1, len(cosines)
    if freedom <= n_source:
        return np.zeros((cosines.shape[1], cosines.shape[1]))
    _, correlations, axes = np.linalg.svd(cosines, full_matrices=False)
    adjusted = 1 - (1 - np.square(correlations)) * freedom / (freedom - n_source)
    taken: Floats = (axes.T * np.clip(adjusted, 0.0, 1.0)) @ axes
    return taken
