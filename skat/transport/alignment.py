"""Maps from rows in pairs: which rotation to put between two roots."""

from dataclasses import dataclass

import numpy as np

from skat.gaussian import (
    accurate_svd,
    check_that_source_reaches_target,
    optimal_map,
    root_of_factor,
    spectrum,
)
from skat.gaussian.arrays import Floats
from skat.gaussian.maps import reached_part

__all__ = ["Alignment", "look_shuffled", "raw_alignment", "whitened_alignment"]

# Pillai's trace of shuffled pairs is this many standard deviations above its mean about once in a thousand of many
# columns, and once in a hundred of one or two.
LEAST_CORRELATION = 3.3


@dataclass(frozen=True, eq=False)
class Alignment:
    """A linear map between centred rows, the rotation inside it, and the way back.

    Attributes
    ----------
    coef : ndarray of shape (n_features, n_features)
        The map; unit of feature i per unit of feature j.
    inverse_coef : ndarray of shape (n_features, n_features) or None
        The way back; None where the source has directions that the map drops.
    rotation : ndarray of shape (n_features, n_features)
        Orthogonal; a partial isometry where a covariance is singular.
    rank : int
        Rank of the map.
    unreached : float
        Share of the target's variance that the map does not reach.
    """

    coef: Floats
    inverse_coef: Floats | None
    rotation: Floats
    rank: int
    unreached: float = 0.0


def whitened_alignment(
    source_factor: Floats,
    target_factor: Floats,
    *,
    source_root: Floats | None = None,
    target_root: Floats | None = None,
    source_rounding: Floats | None = None,
    target_rounding: Floats | None = None,
    reach: bool = False,
) -> Alignment:
    r"""Return the map of least squared error over the pairs that carries one covariance exactly to the other.

    .. math:: T = C_t^{1/2} Q C_s^{-1/2}, \quad
              Q \text{ the orthogonal polar factor of } C_t^{1/2} C_{ts} C_s^{-1/2}

    With factors :math:`F = O D V^T` the latter is :math:`D_t^2 O_t^T O_s` in principal coordinates, so that
    no covariance is formed.

    Parameters
    ----------
    source_factor, target_factor : ndarray of shape (n_rows, n_features)
        Factors of the two covariances, the k-th rows of which belong together, such that their product is the
        cross-covariance: centred pairs, divided by the root of their number, or an orthogonal transform of
        those.
    source_root, target_root : ndarray of shape (n_features, rank), default=None
        Roots of covariances that are estimated otherwise; None takes those of the factors.
    source_rounding, target_rounding : ndarray of shape (n_features,), default=None
        As in `root_of_factor`.
    reach : bool, default=False
        Whether to carry what can be reached where the target has the higher rank.

    Returns
    -------
    Alignment

    Raises
    ------
    numpy.linalg.LinAlgError
        If the target has the higher rank, unless `reach`.
    """
    source_scores, source_spread, source_directions = _principal(source_factor, source_root, source_rounding)
    target_scores, target_spread, target_directions = _principal(target_factor, target_root, target_rounding)
    source_rank, target_rank = len(source_spread), len(target_spread)
    if source_rank < target_rank and not reach:
        check_that_source_reaches_target(np.eye(target_rank, source_rank))
    pull = np.square(target_spread)[:, np.newaxis] * (target_scores.T @ source_scores)
    left, _, right = accurate_svd(pull)
    turn = left @ right
    coef = ((target_directions * target_spread) @ turn / source_spread) @ source_directions.T
    inverse = None
    if source_rank == target_rank:
        inverse = ((source_directions * source_spread) @ turn.T / target_spread) @ target_directions.T
    unreached = 0.0
    if source_rank < target_rank:
        # Rows of the turn outside its range are zero.
        unreached = 1.0 - float(
            np.square(target_spread[:, np.newaxis] * turn).sum() / np.square(target_spread).sum()
        )
    rotation = target_directions @ turn @ source_directions.T
    return Alignment(coef, inverse, rotation, min(source_rank, target_rank), unreached)


def raw_alignment(
    source_factor: Floats,
    target_factor: Floats,
    *,
    source_root: Floats | None = None,
    target_root: Floats | None = None,
    source_rounding: Floats | None = None,
    target_rounding: Floats | None = None,
    mean_product: Floats | float = 0.0,
    reach: bool = False,
) -> Alignment:
    r"""Return the map of Algorithm 1: rotate by the polar factor of the cross-covariance, then transport.

    .. math:: T = A(R C_s R^T, C_t) R, \quad C_{ts} = U w V^T, \quad R = U V^T

    Parameters
    ----------
    source_factor, target_factor : ndarray of shape (n_rows, n_features)
        As for `whitened_alignment`.
    source_root, target_root : ndarray of shape (n_features, rank), default=None
        As for `whitened_alignment`.
    source_rounding, target_rounding : ndarray of shape (n_features,), default=None
        As for `whitened_alignment`.
    mean_product : ndarray of shape (n_features, n_features) or 0.0
        Outer product of target and source mean, to be added to the cross-covariance as the algorithm's letter
        has it.
    reach : bool, default=False
        As for `whitened_alignment`.

    Returns
    -------
    Alignment

    Raises
    ------
    numpy.linalg.LinAlgError
        If the rotated source does not vary wherever the target does, unless `reach`.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Algorithm 1.
    """
    left, _, right = accurate_svd(target_factor.T @ source_factor + mean_product)
    rotation = left @ right
    source_root = rotation @ (
        root_of_factor(source_factor, rounding=source_rounding) if source_root is None else source_root
    )
    target_root = (
        root_of_factor(target_factor, rounding=target_rounding) if target_root is None else target_root
    )
    carry = optimal_map(source_root, target_root, reach=reach)
    rank, unreached = target_root.shape[1], 0.0
    if reach:
        rank, unreached = reached_part(carry, source_root, target_root)
    inverse = None
    if source_root.shape[1] == target_root.shape[1]:
        inverse = rotation.T @ optimal_map(target_root, source_root)
    return Alignment(carry @ rotation, inverse, rotation, rank, unreached)


def look_shuffled(source_factor: Floats, target_factor: Floats, n_rows: float) -> bool:
    r"""Whether pairs are no more correlated than shuffled ones.

    The statistic is Pillai's trace, the sum of the squared canonical correlations. For orthogonal projections
    of ranks p and q, one of them turned at random in N = n - 1 dimensions, it has mean p q / N and variance
    2 p q (N - p) (N - q) / (N^2 (N - 1) (N + 2)); at most it is the smaller rank.

    Parameters
    ----------
    source_factor, target_factor : ndarray of shape (n_factor_rows, n_features)
        As for `whitened_alignment`.
    n_rows : float
        Number of pairs, of equal weight.

    Returns
    -------
    bool
        False where pairs are so few that even those which agree exactly would not show it.
    """
    source_scores, target_scores = _basis(source_factor), _basis(target_factor)
    p, q, size = source_scores.shape[1], target_scores.shape[1], n_rows - 1
    if size <= max(p, q, 1):
        return False
    variance = 2 * p * q * (size - p) * (size - q) / (size**2 * (size - 1) * (size + 2))
    least = p * q / size + LEAST_CORRELATION * np.sqrt(variance)
    return bool(np.square(target_scores.T @ source_scores).sum() < least <= min(p, q))


def _basis(factor: Floats) -> Floats:
    """Return orthonormal columns that span those of a factor."""
    if root_of_factor(factor).shape[1] == factor.shape[1]:
        return np.linalg.qr(factor)[0]
    return _principal(factor)[0]


def _principal(
    factor: Floats, root: Floats | None = None, rounding: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """Return scores, standard deviations and principal directions of a factor, or of another root of it."""
    if root is not None:
        directions, spread = spectrum(root)
        return factor @ directions / spread, spread, directions
    root = root_of_factor(factor, rounding=rounding)
    if root.shape[1] == factor.shape[1]:
        scores, spread, directions = accurate_svd(factor)
        return scores, spread, directions.T
    directions, spread = spectrum(root)
    scores, triangle = np.linalg.qr(factor @ directions / spread)
    return scores * np.sign(triangle.diagonal()), spread, directions
