"""Maps from rows in pairs: which rotation to put between two roots."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import bandwidth, blas, lapack, solve_triangular

from skat.gaussian import (
    accurate_svd,
    check_that_source_reaches_target,
    optimal_map,
    root_of_factor,
    spectrum,
)
from skat.gaussian.arrays import Floats
from skat.gaussian.maps import reached_part
from skat.gaussian.moments import triangle

__all__ = ["Alignment", "PairFactors", "look_shuffled", "raw_alignment", "whitened_alignment"]

# Pillai's trace of shuffled pairs is this many standard deviations above its mean about once in a thousand of many
# columns, and once in a hundred of one or two.
LEAST_CORRELATION = 3.3
# Up to so many columns the way that keeps all digits of every direction costs next to nothing.
FEW_COLUMNS = 64
# Condition of a triangle, and of the matrix whose polar factor is taken, beyond which what plain products lose is kept.
WORST_CONDITION, WORST_CONDITION_OF_PULL = 1e5, 1e7


@dataclass(frozen=True, eq=False)
class PairFactors:
    """Factors of two covariances, the k-th rows of which belong together: their product is the cross-covariance.

    Attributes
    ----------
    source, target : ndarray of shape (n_rows, n_features)
        Centred pairs, divided by the root of their number, or an orthogonal transform of those.
    """

    source: Floats
    target: Floats

    @cached_property
    def triangles(self) -> tuple[Floats, Floats, Floats] | None:
        r"""Triangles :math:`R_s, R_t` of the two covariances, and :math:`P` with :math:`R_s^T P` the cross-covariance.

        None where there are few columns, where the source's factor is no triangle, or where one is ill-conditioned.
        """
        n_features = self.source.shape[1]
        if not FEW_COLUMNS < n_features <= len(self.source) or bandwidth(self.source)[0]:
            return None
        source, target = self.source[:n_features], triangle(self.target)
        for part in (source, target):
            if lapack.dtrcon(part, norm="1", uplo="U")[0] * WORST_CONDITION < 1:
                return None
        return source, target, self.target[:n_features]


@dataclass(frozen=True, eq=False)
class Alignment:
    """A linear map between centred rows, the rotation inside it, and the way back.

    Attributes
    ----------
    coef : ndarray of shape (n_features, n_features)
        The map; unit of feature i per unit of feature j.
    inverse_coef : ndarray of shape (n_features, n_features) or None
        The way back; None where the source has directions that the map drops.
    rotation : ndarray of shape (n_features, n_features) or None
        Orthogonal; a partial isometry where a covariance is singular. None where the map was found without it.
    rank : int
        Rank of the map.
    unreached : float
        Share of the target's variance that the map does not reach.
    """

    coef: Floats
    inverse_coef: Floats | None
    rotation: Floats | None
    rank: int
    unreached: float = 0.0


def whitened_alignment(
    factors: "PairFactors",
    *,
    source_root: Floats | None = None,
    target_root: Floats | None = None,
    source_rounding: Floats | None = None,
    target_rounding: Floats | None = None,
    reach: bool = False,
    quick: bool = True,
) -> Alignment:
    r"""Return the map of least squared error over the pairs that carries one covariance exactly to the other.

    .. math:: T = C_t^{1/2} Q C_s^{-1/2}, \quad
              Q \text{ the orthogonal polar factor of } C_t^{1/2} C_{ts} C_s^{-1/2}

    With factors :math:`F = O D V^T` the latter is :math:`D_t^2 O_t^T O_s` in principal coordinates, so that
    no covariance is formed.

    Parameters
    ----------
    factors : PairFactors
    source_root, target_root : ndarray of shape (n_features, rank), default=None
        Roots of covariances that are estimated otherwise; None takes those of the factors.
    source_rounding, target_rounding : ndarray of shape (n_features,), default=None
        As in `root_of_factor`.
    reach : bool, default=False
        Whether to carry what can be reached where the target has the higher rank.
    quick : bool, default=True
        Whether the rotation may be left out, where the map can be had for less without it.

    Returns
    -------
    Alignment

    Raises
    ------
    numpy.linalg.LinAlgError
        If the target has the higher rank, unless `reach`.
    """
    if quick and source_root is None and target_root is None:
        alignment = _alignment_of_triangles(factors)
        if alignment is not None:
            return alignment
    source_scores, source_spread, source_directions = _principal(factors.source, source_root, source_rounding)
    target_scores, target_spread, target_directions = _principal(factors.target, target_root, target_rounding)
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


def _alignment_of_triangles(factors: "PairFactors") -> Alignment | None:
    r"""Return the map of well-conditioned pairs, or None for others.

    Any roots of the covariances give the same map: with :math:`C_s = R_s^T R_s`, :math:`C_t = R_t^T R_t` and
    :math:`C_{ts} = P^T R_s`

    .. math:: T = R_t^T Q R_s^{-T}, \quad Q \text{ the orthogonal polar factor of } R_t C_{ts} R_s^{-1} = R_t P^T
    """
    if factors.triangles is None:
        return None
    source, target, across = factors.triangles
    left, values, right = np.linalg.svd(blas.dtrmm(1.0, target, across.T))
    if values[-1] * WORST_CONDITION_OF_PULL < values[0]:
        return None
    turn = left @ right
    coef = solve_triangular(source, blas.dtrmm(1.0, target, turn.T, side=1), check_finite=False).T
    inverse = solve_triangular(target, blas.dtrmm(1.0, source, turn, side=1), check_finite=False).T
    return Alignment(coef, inverse, None, len(source))


def raw_alignment(
    factors: "PairFactors",
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
    factors : PairFactors
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
    left, _, right = accurate_svd(factors.target.T @ factors.source + mean_product)
    rotation = left @ right
    source_root = rotation @ (
        root_of_factor(factors.source, rounding=source_rounding) if source_root is None else source_root
    )
    target_root = (
        root_of_factor(factors.target, rounding=target_rounding) if target_root is None else target_root
    )
    carry = optimal_map(source_root, target_root, reach=reach)
    rank, unreached = target_root.shape[1], 0.0
    if reach:
        rank, unreached = reached_part(carry, source_root, target_root)
    inverse = None
    if source_root.shape[1] == target_root.shape[1]:
        inverse = rotation.T @ optimal_map(target_root, source_root)
    return Alignment(carry @ rotation, inverse, rotation, rank, unreached)


def look_shuffled(factors: "PairFactors", n_rows: float) -> bool:
    r"""Whether pairs are no more correlated than shuffled ones.

    The statistic is Pillai's trace, the sum of the squared canonical correlations. For orthogonal projections
    of ranks p and q, one of them turned at random in N = n - 1 dimensions, it has mean p q / N and variance
    2 p q (N - p) (N - q) / (N^2 (N - 1) (N + 2)); at most it is the smaller rank.

    Parameters
    ----------
    factors : PairFactors
    n_rows : float
        Number of pairs, of equal weight.

    Returns
    -------
    bool
        False where pairs are so few that even those which agree exactly would not show it.
    """
    if factors.triangles is not None:
        _, target, across = factors.triangles
        p = q = len(target)
        cosines = solve_triangular(target, across.T, trans="T", check_finite=False)
    else:
        source_scores, target_scores = _basis(factors.source), _basis(factors.target)
        p, q = source_scores.shape[1], target_scores.shape[1]
        cosines = target_scores.T @ source_scores
    size = n_rows - 1
    if size <= max(p, q, 1):
        return False
    variance = 2 * p * q * (size - p) * (size - q) / (size**2 * (size - 1) * (size + 2))
    least = p * q / size + LEAST_CORRELATION * np.sqrt(variance)
    return bool(np.square(cosines).sum() < least <= min(p, q))


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
