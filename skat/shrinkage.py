"""Shrinkage of a target covariance towards the source's, for few target rows."""

import numpy as np

from skat.gaussian import check_that_source_reaches_target, root_of_moments, spectrum
from skat.moments import Moments

__all__ = ["shrinkage_intensity", "shrunk_towards"]


def shrunk_towards(target, source):
    r"""Return target moments with the covariance shrunk towards the source's, and by how much.

    In coordinates that whiten the source, so that nothing depends on units, the root of the target's
    covariance is drawn towards the identity,

    .. math:: R^* = (1 - \lambda)\, (C_s^{-1/2} C_t C_s^{-1/2})^{1/2} + \lambda I, \quad
              C_t^* = C_s^{1/2} R^{*2} C_s^{1/2},

    that is, along the shortest path between the two normal distributions in the Wasserstein metric. It is the
    root and not the covariance that is averaged because the error of the map is linear in the root.

    Parameters
    ----------
    target, source : Moments
        Moments of the rows of each domain.

    Returns
    -------
    Moments
        The target's, with another covariance.
    float
        :math:`\lambda`, from 0 (the target's own covariance) to 1 (the source's).

    Raises
    ------
    numpy.linalg.LinAlgError
        If the target varies where the source does not.
    """
    directions, spread = spectrum(root_of_moments(source))
    if len(spread) < source.n_features:
        check_that_source_reaches_target((directions.T @ spectrum(root_of_moments(target))[0]).T)
    whitened = target.covariance_factor() @ directions / spread
    _, values, axes = np.linalg.svd(whitened, full_matrices=True)
    values = np.pad(values, (0, len(spread) - len(values)))
    intensity = shrinkage_intensity(values, target.effective_n_rows)
    shrunk = (1 - intensity) * values + intensity
    factor = (shrunk[:, np.newaxis] * axes * spread) @ directions.T
    moments = Moments(
        target.n_rows,
        target.weight,
        target.squared_weight,
        target.mean,
        target.mean_remainder,
        factor=factor * np.sqrt(target.weight),
    )
    return moments, intensity


def shrinkage_intensity(values, n_rows):
    r"""Return the weight of the identity that makes the expected squared error of a root least.

    .. math:: \lambda = \frac{\operatorname{E} \|\hat R - R\|^2}{\operatorname{E} \|\hat R - I\|^2}, \quad
              \operatorname{E} \|\hat R - R\|^2 \approx
              \frac{1}{n} \sum_{ij} \frac{r_i^2 r_j^2 (1 + \delta_{ij})}{(r_i + r_j)^2}

    as for a covariance in Ledoit and Wolf (2004); the second formula is the first-order error of the root of
    the covariance of n normal rows. Its own :math:`r` come from a covariance shrunk in the ordinary way,
    since the sample's are too far apart.

    Parameters
    ----------
    values : ndarray of shape (n_features,)
        Singular values of the root: square roots of the eigenvalues of the whitened covariance.
    n_rows : float
        Number of rows, the effective one for weighted rows.

    Returns
    -------
    float
        Between 0 and 1.

    References
    ----------
    .. [1] Ledoit and Wolf (2004). A well-conditioned estimator for large-dimensional covariance matrices.
    Journal
       of Multivariate Analysis 88(2).
    """
    freedom = n_rows - 1
    distance = np.square(values - 1).sum()
    if freedom <= 1:
        return 1.0
    if distance == 0:
        return 0.0
    eigenvalues = np.square(values)
    trace, squares = eigenvalues.sum(), np.square(eigenvalues).sum()
    # Unbiased for the trace of the squared covariance of normal rows.
    unbiased = freedom**2 / ((freedom - 1) * (freedom + 2)) * (squares - trace**2 / freedom)
    apart = np.square(eigenvalues - 1).sum()
    ordinary = min(1.0, (trace**2 + max(unbiased, 0.0)) / freedom / apart)
    roots = np.sqrt((1 - ordinary) * eigenvalues + ordinary)
    products = np.square(np.outer(roots, roots) / np.add.outer(roots, roots))
    error = (products.sum() + np.trace(products)) / freedom
    return float(min(1.0, error / distance))
