"""Distances of two samples by their moments, and the paper's bounds."""

from typing import Any

import numpy as np

from skat.gaussian import distance_of_roots, root_of_moments, row_moments
from skat.metrics.samples import one_sample, row_weight, two_samples, two_weights

__all__ = [
    "affine_discrepancy_bound",
    "affine_error_bound",
    "gaussian_wasserstein_distance",
    "gelbrich_bound",
    "normal_approximation_bound",
]


def gaussian_wasserstein_distance(X: Any, y: Any, *, sample_weight: Any = None) -> Any:
    r"""Return the 2-Wasserstein distance between the normal approximations of two samples.

    .. math:: W_2^2(N_X, N_Y) = \|m_x - m_y\|^2 + \operatorname{tr} \Sigma_x + \operatorname{tr} \Sigma_y
              - 2 \operatorname{tr} (\Sigma_y^{1/2} \Sigma_x \Sigma_y^{1/2})^{1/2}

    with :math:`m` the means and :math:`\Sigma` the covariances of the rows, divided by their number.
    `skat.gaussian.gaussian_wasserstein_distance` takes means and covariances instead.

    Parameters
    ----------
    X : array-like of shape (n_source, n_features)
        One sample.
    y : array-like of shape (n_target, n_features)
        The other one, in the same units.
    sample_weight : array-like of shape (n_rows,) or tuple of two array-likes, default=None
        As in `affinity_score`.

    Returns
    -------
    float
        In the unit that the columns share.

    Raises
    ------
    ValueError
        If the arrays are not two-dimensional, finite and of the same number of columns.

    Notes
    -----
    *When it lies.* It sees means and covariances only. After an affine transport fitted to these rows it is
    zero, however wrong the map.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Equation 6.

    Examples
    --------
    >>> gaussian_wasserstein_distance([[-1.0], [1.0]], [[-2.0], [8.0]])
    5.0
    """
    source, target = _two_moments(X, y, sample_weight)
    return distance_of_roots(source.mean - target.mean, root_of_moments(source), root_of_moments(target))


def gelbrich_bound(X: Any, y: Any, *, sample_weight: Any = None) -> Any:
    r"""Return a lower bound of the 2-Wasserstein distance between two samples, from their moments.

    .. math:: W_2(N_X, N_Y) \le W_2(X, Y)

    The normal approximations :math:`N` have the samples' means and covariances, so this is
    `gaussian_wasserstein_distance`, under the name of what it is good for: the exact distance of many rows is
    expensive, this is not.

    Parameters
    ----------
    X : array-like of shape (n_source, n_features)
        One sample.
    y : array-like of shape (n_target, n_features)
        The other one, in the same units.
    sample_weight : array-like of shape (n_rows,) or tuple of two array-likes, default=None
        As in `affinity_score`.

    Returns
    -------
    float
        In the unit that the columns share. Equal to the distance if one sample is a symmetric, positive
        semi-definite affine image of the other.

    Raises
    ------
    ValueError
        If the arrays are not two-dimensional, finite and of the same number of columns.

    Notes
    -----
    *When it lies.* It bounds the distance of these samples. That of the populations is estimated by it with
    an error of order :math:`n^{-1/2}`, of either sign.

    References
    ----------
    .. [1] Gelbrich (1990). On a formula for the L2 Wasserstein metric between measures on Euclidean and
       Hilbert spaces. Mathematische Nachrichten 147.

    Examples
    --------
    >>> from skat.metrics import wasserstein_distance
    >>> X, y = [[0.0], [0.0], [3.0]], [[0.0], [3.0], [3.0]]
    >>> bool(gelbrich_bound(X, y) < wasserstein_distance(X, y))
    True
    """
    return gaussian_wasserstein_distance(X, y, sample_weight=sample_weight)


def affine_discrepancy_bound(X: Any, y: Any, *, sample_weight: Any = None) -> Any:
    r"""Return Proposition 1's bound of how far apart the exact and the Gaussian distance can be.

    .. math:: |W_2(N_X, N_Y) - W_2(X, Y)| \le
              \frac{2 \operatorname{tr} (\Sigma_x \Sigma_y)^{1/2}}{\sqrt{\operatorname{tr} \Sigma_x +
              \operatorname{tr} \Sigma_y}}

    Parameters
    ----------
    X : array-like of shape (n_source, n_features)
        One sample.
    y : array-like of shape (n_target, n_features)
        The other one, in the same units.
    sample_weight : array-like of shape (n_rows,) or tuple of two array-likes, default=None
        As in `affinity_score`.

    Returns
    -------
    float
        In the unit that the columns share; zero if both samples are constant.

    Raises
    ------
    ValueError
        If the arrays are not two-dimensional, finite and of the same number of columns.

    Notes
    -----
    *When it lies.* The paper proves it for centred laws; a difference of the means only shrinks the left
    side. It does not see the shape of the laws: it is as large for two normal laws, where the left side is
    zero.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Proposition 1.

    Examples
    --------
    >>> round(affine_discrepancy_bound([[-1.0], [1.0]], [[-1.0], [1.0]]), 6)
    1.414214
    """
    source, target = _two_moments(X, y, sample_weight)
    core = root_of_moments(target).T @ root_of_moments(source)
    spread = source.variance.sum() + target.variance.sum()
    if spread == 0.0:
        return 0.0
    return float(2.0 * np.linalg.svd(core, compute_uv=False).sum() / np.sqrt(spread))


def normal_approximation_bound(X: Any, *, sample_weight: Any = None) -> float:
    r"""Return Corollary 2's bound of the distance between a law and its normal approximation.

    .. math:: W_2(N_X, X) \le \sqrt{2 \operatorname{tr} \Sigma_x}

    Parameters
    ----------
    X : array-like of shape (n_samples, n_features)
        Rows of the law.
    sample_weight : array-like of shape (n_samples,), default=None
        Weights of the rows.

    Returns
    -------
    float
        In the unit that the columns share.

    Raises
    ------
    ValueError
        If the array is not two-dimensional and finite.

    Notes
    -----
    *When it lies.* It knows only the spread: it is the same for a normal law, where the distance is zero.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Corollary 2.

    Examples
    --------
    >>> normal_approximation_bound([[-1.0, 0.0], [1.0, 2.0]])
    2.0
    """
    moments = row_moments(one_sample(X, "X"), row_weight(sample_weight, len(X)))
    return float(np.sqrt(2.0 * moments.variance.sum()))


def affine_error_bound(y: Any, *, sample_weight: Any = None) -> Any:
    r"""Return Proposition 2's bound of how far affine transport can land from the target.

    .. math:: W_2(T X, Y) \le \sqrt{2 \operatorname{tr} \Sigma(Y)}

    for the affine transport :math:`T` from any law :math:`X` to :math:`Y`. It is the scale of the affinity
    score.

    Parameters
    ----------
    y : array-like of shape (n_target, n_features)
        Target rows.
    sample_weight : array-like of shape (n_target,), default=None
        Weights of the rows.

    Returns
    -------
    float
        In the unit that the columns share.

    Raises
    ------
    ValueError
        If the array is not two-dimensional and finite.

    Notes
    -----
    *When it lies.* It holds where the means and covariances of :math:`T X` and :math:`Y` agree: for the rows
    that the map was fitted to, or for populations. Held-out rows can be further away.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Proposition 2.

    Examples
    --------
    >>> affine_error_bound([[-1.0, 0.0], [1.0, 2.0]])
    2.0
    """
    return normal_approximation_bound(y, sample_weight=sample_weight)


def _two_moments(X: Any, y: Any, sample_weight: Any) -> Any:
    X, y = two_samples(X, y, "X")
    x_weight, y_weight = two_weights(sample_weight, len(X), len(y))
    return row_moments(X, x_weight), row_moments(y, y_weight)
