r"""Maps and distances between normal approximations.

Everything here works on *roots*: matrices :math:`L` of shape (n_features, rank) and full column rank with
:math:`L L^T` the covariance. A root has the square root of the covariance's condition, and taking one is
where the rank is decided; from there on only products, orthogonal factors and divisions by singular values
remain.
"""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from scipy.linalg import bandwidth, blas, lapack, solve_triangular

from skat.gaussian.moments import triangle
from skat.gaussian.threads import shared

__all__ = [
    "AffineMap",
    "accurate_svd",
    "check_that_source_reaches_target",
    "coefficient_distance",
    "coral_map",
    "covariance_root",
    "distance_of_roots",
    "gaussian_wasserstein_distance",
    "optimal_map",
    "reached_part",
    "reached_rank",
    "root_of_factor",
    "root_of_moments",
    "spectrum",
    "transport_map",
]

EPS = float(np.finfo(np.float64).eps)
# Angles between subspaces are known to about EPS times the condition of the roots that span them.
SMALLEST_COSINE = np.sqrt(EPS)
# A number has gone through several roundings when it is stored.
MUCH_ROUNDING = 10.0
# Standard deviation of the least direction, in those of the columns, where moments are held as a product.
LEAST_OF_A_PRODUCT = 1e-3
# Variance of the terms of a sum over that of the sum, up to which next to no digits cancel.
MOST_CANCELLED = 10.0
LARGEST_JACOBI = 512
BLOCK_ELEMENTS = 2**17


@dataclass(frozen=True, eq=False)
class AffineMap:
    r"""The map :math:`x \mapsto m_t + A (x - m_s)` of rows, or its composition with others.

    Attributes
    ----------
    coef : ndarray of shape (n_features, n_features)
        :math:`A`, unit of feature i per unit of feature j.
    source_mean : ndarray of shape (n_features,)
        :math:`m_s`, the point that is carried to `target_mean`.
    target_mean : ndarray of shape (n_features,)
        :math:`m_t`.
    untouched : ndarray of bool of shape (n_features,) or None
        Columns that the map leaves as they are, to the last bit.
    is_tame : bool or None
        Whether rows of float32 can be carried in float32 arithmetic; see `tame`. None is not known, and they are
        not.
    scale, unscaled : ndarray of shape (n_features,), and of the shape of `coef`, or None
        Lengths in whose units the map was found, and `coef` in these; see `scaled`.

    Examples
    --------
    >>> double = AffineMap(2 * np.eye(1), np.zeros(1), np.ones(1))
    >>> double(np.array([[3.0]]))
    array([[7.]])
    """

    coef: np.ndarray
    source_mean: np.ndarray
    target_mean: np.ndarray
    untouched: np.ndarray | None = None
    is_tame: bool | None = None
    scale: np.ndarray | None = None
    unscaled: np.ndarray | None = None

    @classmethod
    def between(cls, coef: Any, source: Any, target: Any) -> Self:
        """Return the map that carries the mean of one `Moments` to that of another."""
        image = target.mean + (target.mean_remainder - coef @ source.mean_remainder)
        return cls(coef, source.mean, image)

    def scaled(self, scale: Any) -> Any:
        """Return the map of rows of which each column is this many times as large."""
        return replace(
            self,
            coef=_in_units(self.coef, scale),
            source_mean=self.source_mean * scale,
            target_mean=self.target_mean * scale,
            scale=scale,
            unscaled=self.coef,
        )

    def tame(self, source: Any) -> "AffineMap":
        r"""Return the map with `is_tame` set for rows of these moments.

        A sum in float32 errs by some :math:`\epsilon (\sum_j A_{ij}^2 \sigma_j^2)^{1/2}`. Where no terms cancel, that
        is no more than what rounding the carried row to float32 changes.

        Parameters
        ----------
        source : Moments
            Of the rows to carry.

        Returns
        -------
        AffineMap
        """
        terms = np.square(self.coef) @ source.variance
        carried = np.square(self.coef @ source.covariance_factor.T).sum(axis=1)
        return replace(self, is_tame=bool((terms <= MOST_CANCELLED * carried).all()))

    def rounded(self, dtype: Any) -> tuple[Any, Any, Any]:
        """Return `coef`, `source_mean` and `target_mean` in a floating type.

        What rounding took from the source's mean is the same for all rows, and goes into the target's.
        """
        source_mean = self.source_mean.astype(dtype)
        target_mean = self.target_mean - self.coef @ (self.source_mean - source_mean)
        return self.coef.astype(dtype), source_mean, target_mean.astype(dtype)

    def __getstate__(self) -> dict[str, Any]:
        # The optimal map is symmetric in the units that it was found in: half the numbers do.
        found = self.coef if self.unscaled is None else self.unscaled
        if np.array_equal(found, found.T):
            return {**vars(self), "coef": found[np.triu_indices(len(found))], "unscaled": None}
        return {**vars(self), "scale": None, "unscaled": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if self.coef.ndim == 1:
            found = np.zeros((len(self.source_mean), len(self.source_mean)))
            found[np.triu_indices(len(found))] = self.coef
            found += np.triu(found, 1).T
            vars(self)["coef"] = found if self.scale is None else _in_units(found, self.scale)
            vars(self)["unscaled"] = None if self.scale is None else found

    @property
    def intercept(self) -> Any:
        """What the origin is carried to."""
        return self.target_mean - self.coef @ self.source_mean

    def __call__(self, rows: Any) -> Any:
        """Return the rows carried over, in the rows' own floating type.

        The difference from the source mean is taken first, so that no digits are lost far from the origin. The
        arithmetic is of float64, but of float32 where the rows and a tame map allow it.
        """
        rows = np.asarray(rows)
        carried = np.empty(rows.shape, dtype=rows.dtype if rows.dtype == np.float32 else np.float64)
        working = np.float32 if self.is_tame and carried.dtype == np.float32 else np.float64
        size = max(BLOCK_ELEMENTS // rows.shape[1], 256)
        coef, source_mean, target_mean = self.rounded(working)
        transposed = np.ascontiguousarray(coef.T)

        def carry(starts: Any) -> None:
            buffer = np.empty((min(size, len(rows)), rows.shape[1]), dtype=working)
            product = None if carried.dtype == working else np.empty(buffer.shape)
            for start in starts:
                block, image = rows[start : start + size], carried[start : start + size]
                centred = buffer[: len(block)]
                np.subtract(block, source_mean, out=centred)
                wide = image if product is None else product[: len(block)]
                np.matmul(centred, transposed, out=wide)
                np.add(wide, target_mean, out=image, casting="same_kind")
                if self.untouched is not None:
                    image[:, self.untouched] = block[:, self.untouched]

        shared(carry, range(0, len(rows), size))
        return carried


def _in_units(coef: Any, scale: Any) -> Any:
    """Return the coefficient of rows of which each column is this many times as large."""
    return coef * scale[:, np.newaxis] / scale


def transport_map(source_covariance: Any, target_covariance: Any) -> Any:
    r"""Return the symmetric map that carries one covariance to another at the least squared displacement.

    .. math:: A = C_t^{1/2} (C_t^{1/2} C_s C_t^{1/2})^{-1/2} C_t^{1/2}

    with the pseudo-inverse where the target is singular: the map of least rank.

    Parameters
    ----------
    source_covariance, target_covariance : array-like of shape (n_features, n_features)
        Symmetric, positive semi-definite; unit of feature i times unit of feature j.

    Returns
    -------
    ndarray of shape (n_features, n_features)
        Symmetric, positive semi-definite, of the target covariance's rank; unit of feature i per unit of
        feature j.

    Raises
    ------
    numpy.linalg.LinAlgError
        A ValueError: if :math:`C_t^{1/2} C_s C_t^{1/2}` has a lower rank than :math:`C_t`, for then no linear
        map carries one to the other.
    ValueError
        If a covariance is not square, not symmetric or not positive semi-definite, or the two differ in size.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Section III.

    Examples
    --------
    >>> transport_map(np.eye(2), 4 * np.eye(2))
    array([[2., 0.],
           [0., 2.]])
    """
    source_root, target_root = covariance_root(source_covariance), covariance_root(target_covariance)
    _check_same_features(source_covariance=source_root, target_covariance=target_root)
    return optimal_map(source_root, target_root)


def gaussian_wasserstein_distance(
    source_mean: Any, source_covariance: Any, target_mean: Any, target_covariance: Any
) -> Any:
    r"""Return the 2-Wasserstein distance between two normal distributions.

    .. math:: W_2^2 = \|m_s - m_t\|^2 + \operatorname{tr} C_s + \operatorname{tr} C_t
              - 2 \operatorname{tr} (C_t^{1/2} C_s C_t^{1/2})^{1/2}

    It is computed as the distance between aligned roots, :math:`\min_Q \|L_s - L_t Q\|_F`, which has all its
    digits where the two distributions are almost the same and the formula above has none.

    Parameters
    ----------
    source_mean, target_mean : array-like of shape (n_features,)
        Means.
    source_covariance, target_covariance : array-like of shape (n_features, n_features)
        Symmetric, positive semi-definite.

    Returns
    -------
    float
        In the unit that the features share.

    Raises
    ------
    ValueError
        If a covariance is not square, not symmetric or not positive semi-definite, if a mean is not finite, or if the
        four differ in size.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Equation 6.

    Examples
    --------
    >>> gaussian_wasserstein_distance([0.0], [[1.0]], [3.0], [[25.0]])
    5.0
    """
    source_root, target_root = covariance_root(source_covariance), covariance_root(target_covariance)
    source_mean, target_mean = (np.asarray(mean, dtype=np.float64) for mean in (source_mean, target_mean))
    for name, mean in (("source_mean", source_mean), ("target_mean", target_mean)):
        if mean.ndim != 1 or not np.isfinite(mean).all():
            raise ValueError(f"{name} must be a finite vector of one entry per feature; it is {mean!r}.")
    _check_same_features(
        source_mean=source_mean,
        source_covariance=source_root,
        target_mean=target_mean,
        target_covariance=target_root,
    )
    return distance_of_roots(source_mean - target_mean, source_root, target_root)


def _check_same_features(**parts: Any) -> None:
    sizes = {name: len(part) for name, part in parts.items()}
    if len(set(sizes.values())) > 1:
        found = ", ".join(f"{name} has {size}" for name, size in sizes.items())
        raise ValueError(f"means and covariances must be of the same features; {found}.")


def covariance_root(covariance: Any) -> Any:
    """Return a root of a covariance matrix.

    Parameters
    ----------
    covariance : array-like of shape (n_features, n_features)
        Symmetric, positive semi-definite.

    Returns
    -------
    ndarray of shape (n_features, rank)
        A matrix of full column rank whose product with its transpose is the covariance. The rank is that of
        the correlation matrix, so it does not depend on the features' units.

    Raises
    ------
    ValueError
        If the matrix is not square, symmetric, finite or positive semi-definite.

    Examples
    --------
    >>> covariance_root([[4.0, 0.0], [0.0, 0.0]])
    array([[2.],
           [0.]])
    """
    covariance = np.asarray(covariance, dtype=np.float64)
    if covariance.ndim != 2 or covariance.shape[0] != covariance.shape[1] or not covariance.size:
        raise ValueError(f"a covariance must be a square matrix; its shape is {covariance.shape}.")
    if not np.isfinite(covariance).all():
        raise ValueError("a covariance must be finite; this one contains NaN or infinity.")
    variance = np.diagonal(covariance)
    if (variance < 0).any():
        raise ValueError(f"a covariance must be positive semi-definite; a variance here is {variance.min()}.")
    scale = np.where(variance > 0, np.sqrt(variance), 1.0)
    correlation = covariance / scale / scale[:, np.newaxis]
    if np.abs(correlation - correlation.T).max() > 1e-8:
        raise ValueError(
            "a covariance must be symmetric; entries across the diagonal differ by up to "
            f"{np.abs(covariance - covariance.T).max()}."
        )
    eigenvalues, vectors = np.linalg.eigh((correlation + correlation.T) / 2)
    tolerance = 10 * EPS * len(scale) * max(eigenvalues[-1], 0.0)
    if eigenvalues[0] < -max(1e-8 * eigenvalues[-1], tolerance):
        raise ValueError(
            "a covariance must be positive semi-definite; an eigenvalue of its correlations is "
            f"{eigenvalues[0]}."
        )
    kept = eigenvalues > tolerance
    return np.sqrt(eigenvalues[kept]) * vectors[:, kept] * scale[:, np.newaxis]


def root_of_moments(moments: Any) -> Any:
    """Return a root of the covariance of moments.

    Parameters
    ----------
    moments : Moments
        Moments of rows.

    Returns
    -------
    ndarray of shape (n_features, rank)
        A matrix of full column rank whose product with its transpose is the covariance.
    """
    factor, rounding = moments.covariance_factor, moments.rounding
    if moments.scatter is not None:
        deviation = np.sqrt(moments.variance)
        varies = deviation > 0
        # Its correlations are well conditioned, so that only much rounding could hide a direction.
        if (MUCH_ROUNDING * rounding[varies] < LEAST_OF_A_PRODUCT * deviation[varies]).all():
            return factor.T
    return root_of_factor(factor, rounding=rounding)


def root_of_factor(factor: Any, scale: Any = None, rounding: Any = None) -> Any:
    """Return a root of the covariance ``factor.T @ factor``.

    Parameters
    ----------
    factor : ndarray of shape (n_rows, n_features)
    scale : ndarray of shape (n_features,), default=None
        Size of each feature against which a direction of no variance is judged; the standard deviations where None.
    rounding : ndarray of shape (n_features,), default=None
        Standard deviation of what rounding has changed in each column: what varies by little more does not vary.

    Returns
    -------
    ndarray of shape (n_features, rank)
    """
    n_features = factor.shape[1]
    if scale is None:
        scale = np.sqrt(np.square(factor).sum(axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    noise = np.zeros(n_features) if rounding is None else MUCH_ROUNDING * rounding / scale
    values = np.linalg.svd(factor / scale, compute_uv=False)
    least = 10 * EPS * n_features * max(values.max(initial=0.0), 1.0)
    if len(factor) >= n_features and values[-1] > max(least, noise.max(initial=0.0)):
        return (triangle(factor) if len(factor) > n_features else factor).T
    _, values, directions = np.linalg.svd(factor / scale, full_matrices=False)
    kept = values > np.maximum(least, np.sqrt(np.square(directions) @ np.square(noise)))
    if len(factor) >= n_features and kept.all():
        return (triangle(factor) if len(factor) > n_features else factor).T
    return directions[kept].T * values[kept] * scale[:, np.newaxis]


def optimal_map(source_root: Any, target_root: Any, *, reach: bool = False) -> Any:
    r"""Return the coefficient of the optimal map between centred normal distributions.

    .. math:: A = L_t U w^{-1} U^T L_t^T \quad\text{with}\quad L_t^T L_s = U w V^T

    Parameters
    ----------
    source_root : ndarray of shape (n_features, source_rank)
        :math:`L_s`.
    target_root : ndarray of shape (n_features, target_rank)
        :math:`L_t`.
    reach : bool, default=False
        Whether to carry what can be reached where the product of the roots has the lower rank, by the pairs of
        singular vectors that it has: the mean of the target given the source under the optimal coupling, which
        is no map then.

    Returns
    -------
    ndarray of shape (n_features, n_features)
        Symmetric, positive semi-definite, of rank `target_rank` or, with `reach`, of that of the product.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the product of the roots has a lower rank than the target, unless `reach`.
    """
    n_features = len(source_root)
    is_full = source_root.shape[1] == target_root.shape[1] == n_features
    half = None
    if is_full:
        half = _half_of_well_conditioned_map(source_root, target_root)
    if half is None:
        source_directions, source_spread = spectrum(source_root)
        target_directions, target_spread = spectrum(target_root)
        angles = target_directions.T @ source_directions
        if source_root.shape[1] < n_features and not reach:
            check_that_source_reaches_target(angles)
        left, values, _ = accurate_svd(target_spread[:, np.newaxis] * angles * source_spread)
        if reach:
            n_reached = reached_rank(angles)
            left, values = left[:, :n_reached], values[:n_reached]
        half = target_directions @ (target_spread[:, np.newaxis] * left / np.sqrt(values))
    return half @ half.T


def _half_of_well_conditioned_map(source_root: Any, target_root: Any) -> Any:
    """Return G with G G^T the map, or None where a plain product of the roots would lose digits."""
    are_triangles = len(source_root) > 256 and not any(
        bandwidth(root)[1] for root in (source_root, target_root)
    )
    if are_triangles:
        core = blas.dtrmm(1.0, target_root, source_root, lower=1, trans_a=1)
        squares, right = np.linalg.eigh(core.T @ core)
        if squares[0] > 1e-5 * squares[-1]:
            return solve_triangular(
                source_root,
                right * squares**0.25,
                lower=True,
                trans="T",
                overwrite_b=True,
                check_finite=False,
            )
    left, values, _ = np.linalg.svd(target_root.T @ source_root)
    if values[-1] > 1e-4 * values[0]:
        return target_root @ (left / np.sqrt(values))
    return None


def check_that_source_reaches_target(angles: Any) -> None:
    """Raise where a direction of the target is at right angles to every one of the source.

    Parameters
    ----------
    angles : ndarray of shape (target_rank, source_rank)
        Products of the principal directions.

    Raises
    ------
    numpy.linalg.LinAlgError
        Naming both ranks.
    """
    target_rank, reached = len(angles), reached_rank(angles)
    if reached < target_rank:
        raise np.linalg.LinAlgError(
            f"no linear map carries the source's covariance to the target's: rank(S_t) is {target_rank}, but "
            f"rank(S_t^(1/2) S_s S_t^(1/2)) only {reached}, so the target varies where the source does not. "
            "Give more source rows, drop columns that do not vary there or, up to rounding, are linear functions of "
            "others, use a covariance estimator of full rank, or carry what can be reached, with "
            'rank_deficient="reach".'
        )


def reached_part(coef: Any, source_root: Any, target_root: Any) -> Any:
    """Return the rank of what a map of `optimal_map` reaches, and the share of the target's variance that it does not.

    Parameters
    ----------
    coef : ndarray of shape (n_features, n_features)
    source_root, target_root : ndarray of shape (n_features, rank)

    Returns
    -------
    int
    float
    """
    target_rank = target_root.shape[1]
    if target_rank == 0:
        return 0, 0.0
    rank = 0
    if source_root.shape[1]:
        rank = reached_rank(spectrum(target_root)[0].T @ spectrum(source_root)[0])
    if rank == target_rank:
        return rank, 0.0
    return rank, float(max(1.0 - np.square(coef @ source_root).sum() / np.square(target_root).sum(), 0.0))


def reached_rank(angles: Any) -> Any:
    """Return how many directions of the target are not at right angles to every one of the source."""
    return int((np.linalg.svd(angles, compute_uv=False) > SMALLEST_COSINE).sum()) if angles.size else 0


def spectrum(root: Any) -> Any:
    """Return the principal directions and standard deviations of a root, small ones with all their digits."""
    n_features, rank = root.shape
    if rank == n_features:
        _, spread, directions = accurate_svd(root.T)
        return directions.T, spread
    directions, spread, _ = accurate_svd(root)
    return directions, spread


def accurate_svd(matrix: Any) -> Any:
    """Return the thin SVD, by one-sided Jacobi, which keeps small values of rows or columns of unlike size.

    See Drmač and Veselić (2008), New fast and accurate Jacobi SVD algorithm, SIAM J. Matrix Anal. Appl.
    29(4).
    """
    if matrix.shape[0] < matrix.shape[1]:
        left, values, right = accurate_svd(matrix.T)
        return right.T, values, left.T
    if not 0 < matrix.shape[1] <= LARGEST_JACOBI:
        return np.linalg.svd(matrix, full_matrices=False)
    values, left, right, work, _, info = lapack.dgejsv(matrix, joba=2, jobu=0, jobv=0, jobr=0, jobt=0, jobp=0)
    if info != 0:
        return np.linalg.svd(matrix, full_matrices=False)
    return left[:, : matrix.shape[1]], values * (work[0] / work[1]), right.T


def coral_map(source_root: Any, target_root: Any) -> Any:
    r"""Return the coefficient that whitens by the source and colours by the target.

    .. math:: A = C_t^{1/2} C_s^{-1/2}

    with the pseudo-inverse; where the source has the lower rank, that many of the target's largest principal
    directions are matched. Where the two span different subspaces, the product of their principal directions
    is replaced by its orthogonal polar factor: the plain product, which the paper has, loses variance.

    Parameters
    ----------
    source_root, target_root : ndarray of shape (n_features, rank)
        Roots of the two covariances.

    Returns
    -------
    ndarray of shape (n_features, n_features)
        Unit of feature i per unit of feature j. It carries one covariance to the other, but is not optimal.

    References
    ----------
    .. [1] Sun, Feng, Saenko (2016). Return of Frustratingly Easy Domain Adaptation. AAAI. Theorem 1.
    """
    source_directions, source_spread = spectrum(source_root)
    target_directions, target_spread = spectrum(target_root)
    rank = min(len(source_spread), len(target_spread))
    target_directions, target_spread = target_directions[:, :rank], target_spread[:rank]
    left, _, right = np.linalg.svd(target_directions.T @ source_directions, full_matrices=False)
    return ((target_directions * target_spread) @ (left @ right) / source_spread) @ source_directions.T


def distance_of_roots(mean_difference: Any, source_root: Any, target_root: Any) -> float:
    """Return the distance of `gaussian_wasserstein_distance` from the means' difference and two roots."""
    rank = max(source_root.shape[1], target_root.shape[1])
    source_root, target_root = (
        np.pad(root, ((0, 0), (0, rank - root.shape[1]))) for root in (source_root, target_root)
    )
    core = target_root.T @ source_root
    if len(core) > 256:
        spread = np.square(source_root).sum() + np.square(target_root).sum()
        square = spread - 2 * _sum_of_singular_values(core)
        if square > 1e-3 * spread:
            return float(np.sqrt(np.square(mean_difference).sum() + square))
    left, _, right = np.linalg.svd(core)
    unaligned = source_root - target_root @ (left @ right)
    return float(np.hypot(np.linalg.norm(mean_difference), np.linalg.norm(unaligned)))


def _sum_of_singular_values(matrix: Any) -> Any:
    squares = np.linalg.eigvalsh(matrix.T @ matrix)
    if squares[0] > 1e-5 * squares[-1]:
        return np.sqrt(squares).sum()
    return np.linalg.svd(matrix, compute_uv=False).sum()


def coefficient_distance(source: Any, target: Any, coef: Any) -> float:
    """Return the distance of `gaussian_wasserstein_distance` where the optimal map is known.

    Parameters
    ----------
    source, target : Moments
        Moments of the two distributions.
    coef : ndarray of shape (n_features, n_features)
        Coefficient of the optimal map.

    Returns
    -------
    float
        In the unit that the features share.
    """
    spread = source.variance.sum() + target.variance.sum()
    unaligned = spread - 2 * np.vdot(coef, source.covariance)
    if source.n_features <= 256 or unaligned < 1e-3 * spread:
        factor = source.covariance_factor
        unaligned = np.square(factor @ coef.T - factor).sum()
    return float(np.sqrt(np.square(source.mean - target.mean).sum() + unaligned))
