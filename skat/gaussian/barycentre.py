"""The barycentre of normal distributions in the Wasserstein metric."""

import warnings
from collections.abc import Sequence

import numpy as np

from skat.gaussian.arrays import Floats
from skat.gaussian.maps import optimal_map, root_of_factor

__all__ = ["barycentre_root"]

SETTLED, MOST_STEPS = 1e-10, 1000


def barycentre_root(roots: Sequence[Floats], shares: Floats, rounding: Floats | None = None) -> Floats:
    r"""Return a root of the covariance of the Wasserstein barycentre of centred normal distributions.

    .. math:: C \leftarrow M C M, \quad M = \sum_k w_k A(C, C_k)

    from the mean of the covariances on, with :math:`A` the optimal map. At the barycentre the mean of the maps from
    there is the identity.

    Parameters
    ----------
    roots : sequence of ndarray of shape (n_features, rank)
        Roots of :math:`C_k`.
    shares : ndarray of shape (n_distributions,)
        :math:`w_k`, of sum one.
    rounding : ndarray of shape (n_features,), default=None
        As in `root_of_factor`.

    Returns
    -------
    ndarray of shape (n_features, rank)

    References
    ----------
    .. [1] Álvarez-Esteban, del Barrio, Cuesta-Albertos and Matrán (2016). A fixed-point approach to barycenters
       in Wasserstein space. Journal of Mathematical Analysis and Applications 441.

    Examples
    --------
    >>> root = barycentre_root([np.array([[1.0]]), np.array([[3.0]])], np.array([0.5, 0.5]))
    >>> (root @ root.T).round(9)
    array([[4.]])
    """
    pooled = np.hstack([np.sqrt(share) * root for share, root in zip(shares, roots)])
    middle: Floats = root_of_factor(pooled.T, rounding=rounding)
    for _ in range(MOST_STEPS):
        mean_map = np.sum([share * optimal_map(middle, root) for share, root in zip(shares, roots)], axis=0)
        step = mean_map @ middle - middle
        middle = middle + step
        if (np.linalg.norm(step, axis=1) <= SETTLED * np.linalg.norm(middle, axis=1)).all():
            return middle
    warnings.warn(
        f"the barycentre has not settled after {MOST_STEPS} steps. Drop columns that vary by less than their rounding.",
        UserWarning,
        stacklevel=2,
    )
    return middle
