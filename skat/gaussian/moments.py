"""Mean and covariance of weighted rows: accurate, mergeable, and computed without a centred copy."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from scipy.linalg import lapack
from scipy.sparse.linalg import LinearOperator, eigsh

__all__ = ["Moments", "SideBySide", "held_well", "row_moments", "triangle"]

# A product X'X squares the condition of X. Beyond this condition of the correlation matrix it costs more than
# about ten digits of the smallest direction, and the rows go through QR instead.
WORST_CONDITION_OF_A_PRODUCT = 1e6
# Below this many operations QR costs next to nothing and is the more accurate anyway.
CHEAP_QR = 2e7
# Up to here all eigenvalues cost less than waking SciPy's own BLAS threads beside NumPy's.
LARGEST_CHEAP_SPECTRUM = 400
# Squares of anything smaller have lost digits to underflow.
SMALLEST_SPREAD = 1e-140
BLOCK_ELEMENTS = 2**18
# BLAS works on pieces of this size without threads, whose start costs more than such a piece.
SERIAL_ELEMENTS = 2**12
# NumPy starts anew on every row of a broadcast operation, which costs more than a shorter row itself.
SHORT_ROW = 512


class SideBySide:
    """Two arrays of as many rows, read as one array with the columns of both, which is never made.

    Parameters
    ----------
    first, second : ndarray of shape (n_rows, n_features)
    """

    ndim = 2

    def __init__(self, first: Any, second: Any) -> None:
        self.parts = first, second
        self.shape = first.shape[0], first.shape[1] + second.shape[1]
        self.dtype = np.result_type(first, second)

    def __len__(self) -> Any:
        return self.shape[0]

    def __getitem__(self, rows: Any) -> Any:
        first, second = (part[rows] for part in self.parts)
        if first.ndim == 1:
            return np.concatenate([first, second])
        return SideBySide(first, second)

    def less(self, shift: Any, out: Any = None) -> Any:
        """Return the rows, as float64, less a vector."""
        out = np.empty(self.shape) if out is None else out
        middle = self.parts[0].shape[1]
        _write_less(self.parts[0], shift[:middle], out[:, :middle])
        _write_less(self.parts[1], shift[middle:], out[:, middle:])
        return out


@dataclass(frozen=True, eq=False)
class Moments:
    r"""Weight, mean and scatter of a set of rows; ``a + b`` are the moments of both sets together.

    ``a * w`` are those of rows of so much less or more weight.

    The scatter :math:`\sum_k w_k (x_k - m)(x_k - m)^T` is held either as that matrix or, where forming it
    would lose digits, as a factor :math:`F` with :math:`F^T F` the scatter. The two are never mixed up: a sum
    with a factor in it is a factor.

    Attributes
    ----------
    n_rows : int
        Number of rows with positive weight.
    weight : float
        Sum of the weights.
    squared_weight : float
        Sum of the squared weights.
    mean : ndarray of shape (n_features,)
        Weighted mean, in the features' units.
    mean_remainder : ndarray of shape (n_features,)
        What rounding took from the mean: the sum of both is the mean to about 32 digits, so that sets far
        from the origin merge without loss.
    scatter : ndarray of shape (n_features, n_features) or None
        The matrix above; None where `factor` holds it.
    factor : ndarray of shape (n_factor_rows, n_features) or None
        :math:`F`; None where `scatter` holds it.
    eps : float
        Relative rounding of the rows' numbers, that of their type.

    Examples
    --------
    >>> both = row_moments(np.array([[0.0], [2.0]])) + row_moments(np.array([[4.0]]))
    >>> both.mean, both.covariance
    (array([2.]), array([[2.66666667]]))
    """

    n_rows: int
    weight: float
    squared_weight: float
    mean: np.ndarray
    mean_remainder: np.ndarray
    scatter: Any = None
    factor: Any = None
    eps: float = float(np.finfo(np.float64).eps)

    @property
    def n_features(self) -> Any:
        """Number of columns."""
        return len(self.mean)

    @property
    def covariance(self) -> Any:
        """Weighted covariance about the mean, divided by the sum of the weights (not by one less)."""
        scatter = self.factor.T @ self.factor if self.scatter is None else self.scatter
        return scatter / self.weight

    @property
    def variance(self) -> Any:
        """The covariance's diagonal."""
        if self.scatter is None:
            return np.square(self.factor).sum(axis=0) / self.weight
        return np.diagonal(self.scatter) / self.weight

    @property
    def rounding(self) -> Any:
        """Standard deviation, in each column, of what rounding to their type has changed in the rows."""
        return self.eps * np.hypot(self.mean, np.sqrt(self.variance)) / np.sqrt(12)

    @property
    def effective_n_rows(self) -> Any:
        """Number of rows of equal weight that would give means of the same variance (Kish)."""
        return self.weight**2 / self.squared_weight

    @property
    def is_finite(self) -> Any:
        """Whether every number is finite, and every variance."""
        held = self.factor if self.scatter is None else self.scatter
        with np.errstate(over="ignore", invalid="ignore"):
            parts = (self.mean, held, self.variance)
            return all(bool(np.isfinite(part).all()) for part in parts)

    @cached_property
    def covariance_factor(self) -> Any:
        r""":math:`F` with :math:`F^T F` the covariance, of at most as many rows as columns."""
        factor = self.factor if self.scatter is None else _factor_of_scatter(self.scatter)
        return _compressed(factor, at_most=self.n_features) / np.sqrt(self.weight)

    def scaled(self, factors: Any) -> Any:
        """Return the moments of the rows with each column times a factor.

        Parameters
        ----------
        factors : ndarray of shape (n_features,)
            One positive factor per column.

        Returns
        -------
        Moments
        """
        return replace(
            self,
            mean=self.mean * factors,
            mean_remainder=self.mean_remainder * factors,
            scatter=None if self.scatter is None else self.scatter * factors * factors[:, np.newaxis],
            factor=None if self.factor is None else self.factor * factors,
        )

    def columns(self, indices: Any) -> Self:
        """Return the moments of some of the columns, in the order given.

        Parameters
        ----------
        indices : ndarray of int or slice
            The columns.

        Returns
        -------
        Moments
        """
        return replace(
            self,
            mean=self.mean[indices],
            mean_remainder=self.mean_remainder[indices],
            scatter=None if self.scatter is None else self.scatter[indices][:, indices],
            factor=None if self.factor is None else self.factor[:, indices],
        )

    def __mul__(self, factor: float) -> Self:
        """Return the moments of the rows with every weight times a positive factor: older rows fade so."""
        if not isinstance(factor, int | float | np.number):
            return NotImplemented
        factor = float(factor)
        if not 0 < factor < np.inf:
            raise ValueError(f"weights are multiplied by a positive number; it is {factor!r}.")
        return replace(
            self,
            weight=self.weight * factor,
            squared_weight=self.squared_weight * factor**2,
            scatter=None if self.scatter is None else self.scatter * factor,
            factor=None if self.factor is None else self.factor * np.sqrt(factor),
        )

    __rmul__ = __mul__

    def __getstate__(self) -> dict[str, Any]:
        # A symmetric matrix or a triangle, of which half the numbers do.
        state: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        n_features = self.n_features
        if self.scatter is not None:
            state["scatter"] = self.scatter[np.triu_indices(n_features)]
        elif self.factor.shape[0] >= n_features and self.is_finite:
            state["factor"] = triangle(self.factor)[np.triu_indices(n_features)]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        state = dict(state)
        n_features = len(state["mean"])
        upper = np.triu_indices(n_features)
        if state["scatter"] is not None:
            scatter = np.zeros((n_features, n_features))
            scatter[upper] = state["scatter"]
            state["scatter"] = np.triu(scatter, 1).T + scatter
        elif state["factor"].ndim == 1:
            factor = np.zeros((n_features, n_features))
            factor[upper] = state["factor"]
            state["factor"] = factor
        vars(self).update(state)

    def __add__(self, other: "Moments") -> "Moments":
        if not isinstance(other, Moments):
            return NotImplemented
        if self.n_features != other.n_features:
            raise ValueError(
                f"moments merge only over the same columns; these have {self.n_features} and "
                f"{other.n_features}."
            )
        weight = self.weight + other.weight
        shift = (other.mean - self.mean) + (other.mean_remainder - self.mean_remainder)
        between = np.sqrt(self.weight / weight * other.weight) * shift
        scatter, factor = None, None
        if self.scatter is not None and other.scatter is not None and not _swamps(between, self, other):
            scatter = self.scatter + other.scatter + np.outer(between, between)
        else:
            parts = [_factor_of_scatter(m.scatter) if m.factor is None else m.factor for m in (self, other)]
            factor = _compressed(np.vstack([*parts, between]), at_most=2 * self.n_features)
        mean, remainder = _sum_with_remainder(
            self.mean, self.mean_remainder + shift * (other.weight / weight)
        )
        return Moments(
            self.n_rows + other.n_rows,
            weight,
            self.squared_weight + other.squared_weight,
            mean,
            remainder,
            scatter,
            factor,
            max(self.eps, other.eps),
        )


def row_moments(rows: Any, weight: Any = None) -> Any:
    """Return the moments of the rows of an array, reading it in blocks.

    The rows are shifted by a mean before they are multiplied, so that a mean that is large against the spread
    costs no digits, and a constant column has a variance of exactly zero. Ill-conditioned rows go through QR.
    NaN or infinity in the rows shows as `Moments.is_finite` being False; nothing is raised.

    Parameters
    ----------
    rows : ndarray of shape (n_rows, n_features)
        Of any real type; sums are taken in float64.
    weight : ndarray of shape (n_rows,), default=None
        Non-negative weights, of positive sum; None is one each.

    Returns
    -------
    Moments
    """
    n_rows, n_features = rows.shape
    if weight is not None:
        weight = np.asarray(weight, dtype=np.float64)
        if not weight.all():
            rows, weight = rows[weight > 0], weight[weight > 0]
            n_rows = len(rows)
    total = float(n_rows) if weight is None else float(weight.sum())
    squared = float(n_rows) if weight is None else float(weight @ weight)
    eps = float(np.finfo(rows.dtype if rows.dtype.kind == "f" else np.float64).eps)
    with np.errstate(over="ignore", invalid="ignore"):
        shift, variance = _first_moments(rows, weight)
        if n_rows * n_features**2 <= CHEAP_QR or n_rows <= n_features:
            mean, remainder = _sum_with_remainder(shift, _mean_about(rows, weight, shift))
            factor = _row_factor(rows, weight, mean)
            return Moments(n_rows, total, squared, mean, remainder, factor=factor, eps=eps)
        # Next to such a mean a sum of squares loses less than one bit, and the rows can be read where they are.
        shift = np.where(np.square(shift) <= variance, 0.0, shift)
        scatter, offset = _scatter_about(rows, weight, shift)
        if np.isfinite(offset).all() and _is_far(offset, scatter, total):
            shift = shift + offset
            scatter, offset = _scatter_about(rows, weight, shift)
        mean, remainder = _sum_with_remainder(shift, offset)
        moments = Moments(n_rows, total, squared, mean, remainder, scatter, eps=eps)
        return held_well(moments, lambda: _row_factor(rows, weight, mean))


def held_well(moments: Moments, row_factor: Callable[[], Any]) -> Moments:
    """Return moments that hold a product of the rows as they are, or with a factor where it has lost digits.

    Parameters
    ----------
    moments : Moments
        That hold a scatter.
    row_factor : callable
        Returns a factor of it, for which the rows are read once more.

    Returns
    -------
    Moments
    """
    if not np.isfinite(moments.scatter).all():
        return moments
    factor = _factor_if_well_conditioned(moments.scatter)
    if factor is None:
        return replace(moments, scatter=None, factor=row_factor())
    # What the condition was seen from is what every map is made of.
    vars(moments)["covariance_factor"] = factor / np.sqrt(moments.weight)
    return moments


def triangle(factor: Any) -> Any:
    """Return the triangular factor of QR: a factor of the same product, of no more rows than columns."""
    upper: Any = np.linalg.qr(factor, mode="r")
    return upper


def _sum_with_remainder(large: Any, small: Any) -> Any:
    """Return the rounded sum and what rounding took from it (exact where the first is the larger)."""
    rounded = large + small
    return rounded, small - (rounded - large)


def _less(rows: Any, shift: Any, out: Any = None) -> Any:
    """Return a block of rows, as float64, less a vector."""
    if isinstance(rows, SideBySide):
        return rows.less(shift, out)
    n_rows, n_features = rows.shape
    out = np.empty(rows.shape) if out is None else out
    n_beside = SHORT_ROW // n_features
    n_wide = n_rows - n_rows % n_beside if n_beside > 1 and rows.flags.c_contiguous else 0
    if n_wide:
        wide = (n_wide // n_beside, n_beside * n_features)
        beside = np.tile(shift, n_beside)
        _write_less(rows[:n_wide].reshape(wide), beside, out[:n_wide].reshape(wide))
    _write_less(rows[n_wide:], shift, out[n_wide:])
    return out


def _write_less(rows: Any, shift: Any, out: Any) -> None:
    # A copy converts a number as it goes; a difference of two types goes through a buffer first.
    if shift.any():
        np.subtract(rows, shift, out=out, dtype=np.float64)
    else:
        np.copyto(out, rows)


def _blocks(n_rows: int, n_features: int) -> Any:
    size = max(BLOCK_ELEMENTS // n_features, 2 * n_features, 256)
    return [slice(start, min(start + size, n_rows)) for start in range(0, n_rows, size)]


def _first_moments(rows: Any, weight: Any) -> Any:
    """Return mean and variance of the first rows, exact where they are all equal."""
    first = _blocks(*rows.shape)[0]
    weight = None if weight is None else weight[first]
    shifted = _less(rows[first], rows[0])
    mean = np.average(shifted, axis=0, weights=weight)
    shifted -= mean
    return rows[0] + mean, np.average(np.square(shifted, out=shifted), axis=0, weights=weight)


def _mean_about(rows: Any, weight: Any, shift: Any) -> Any:
    total = np.zeros(rows.shape[1])
    for block in _blocks(*rows.shape):
        shifted = _less(rows[block], shift)
        total += shifted.sum(axis=0) if weight is None else weight[block] @ shifted
    return total / (len(rows) if weight is None else weight.sum())


def _scatter_about(rows: Any, weight: Any, shift: Any) -> Any:
    """Return the scatter about the mean, and the mean less the shift."""
    n_rows, n_features = rows.shape
    blocks = _blocks(n_rows, n_features)
    ones = np.ones(blocks[0].stop)
    as_they_are = (
        isinstance(rows, np.ndarray) and rows.dtype == np.float64 and weight is None and not shift.any()
    )
    buffer = None if as_they_are else np.empty((len(ones), n_features))
    scatter, total = np.zeros((n_features, n_features)), np.zeros(n_features)
    for block in blocks:
        part, root = rows[block], ones[: block.stop - block.start]
        if buffer is not None:
            part = _less(part, shift, buffer[: len(root)])
        if weight is not None:
            root = np.sqrt(weight[block])
            part *= root[:, np.newaxis]
        total += root @ part
        scatter += part.T @ part
    weight_sum = n_rows if weight is None else weight.sum()
    offset = total / weight_sum
    scatter -= np.outer(total, offset)
    return scatter, offset


def _is_far(offset: Any, scatter: Any, weight: Any) -> bool:
    """Whether taking the offset out again has cost more than one or two digits of a variance."""
    return bool((weight * np.square(offset) > 30 * np.diagonal(scatter)).any())


def _row_factor(rows: Any, weight: Any, mean: Any) -> Any:
    """Return a factor of the scatter about a mean, by QR of one block of rows after the other."""
    n_rows, n_features = rows.shape
    size = max(4 * n_features, BLOCK_ELEMENTS // n_features)
    factor = np.empty((0, n_features))
    for start in range(0, n_rows, size):
        block = slice(start, start + size)
        centred = _less(rows[block], mean)
        if weight is not None:
            centred *= np.sqrt(weight[block])[:, np.newaxis]
        factor = _compressed(np.vstack([factor, centred]) if len(factor) else centred, at_most=2 * n_features)
    return factor


def _compressed(factor: Any, at_most: Any) -> Any:
    """Return a factor of the same product with at most so many rows."""
    n_rows, n_features = factor.shape
    if n_rows <= at_most or not np.isfinite(factor).all():
        return factor
    size = SERIAL_ELEMENTS // n_features
    if size < 2 * n_features or n_rows < 2 * size:
        return triangle(factor)
    whole = n_rows - n_rows % size
    triangles = triangle(factor[:whole].reshape(-1, size, n_features))
    return _compressed(np.vstack([triangles.reshape(-1, n_features), factor[whole:]]), at_most)


def _factor_if_well_conditioned(scatter: Any) -> Any:
    """Return the Cholesky factor of a scatter, or None where the columns that vary are nearly dependent."""
    scale = np.sqrt(np.diagonal(scatter).clip(0))
    varies = np.flatnonzero(scale > 0)
    if not len(varies):
        return np.zeros((0, len(scale)))
    if scale[varies].min() < SMALLEST_SPREAD:
        return None
    correlation = _correlation(scatter, scale, varies)
    if len(varies) > LARGEST_CHEAP_SPECTRUM:
        # LAPACK reads columns: the lower triangle of the transpose is the upper one in rows, with nothing copied.
        lower, info = lapack.dpotrf(correlation.T, lower=1)
        if info != 0 or _condition(correlation, lower) > WORST_CONDITION_OF_A_PRODUCT:
            return None
        upper = lower.T
    else:
        eigenvalues = np.linalg.eigvalsh(correlation)
        if eigenvalues[0] * WORST_CONDITION_OF_A_PRODUCT < eigenvalues[-1]:
            return None
        upper = np.linalg.cholesky(correlation, upper=True)
    return _in_all_columns(upper, scale, varies)


def _condition(matrix: Any, lower: Any) -> Any:
    """Return the condition in the 2-norm, or a number on the same side of the worst of a product."""
    reciprocal, _ = lapack.dpocon(lower, np.abs(matrix).sum(axis=0).max(), uplo="L")
    condition = 1 / reciprocal if reciprocal > 0 else np.inf
    # The condition in the 2-norm is at most that in the 1-norm, and at least that divided by the number of columns.
    if WORST_CONDITION_OF_A_PRODUCT < condition <= WORST_CONDITION_OF_A_PRODUCT * len(matrix):
        inverse = LinearOperator(
            matrix.shape, lambda v: lapack.dpotrs(lower, v, lower=1)[0], dtype=np.float64
        )
        # Any start but one at right angles to the directions sought.
        start = np.random.default_rng(0).normal(size=len(matrix))
        largest, inverse_of_least = (
            eigsh(operator, k=1, v0=start, tol=1e-3, return_eigenvectors=False)[0]
            for operator in (matrix, inverse)
        )
        condition = largest * inverse_of_least
    return condition


def _factor_of_scatter(scatter: Any) -> Any:
    """Return the Cholesky factor of a scatter that is well conditioned but for columns that do not vary."""
    scale = np.sqrt(np.diagonal(scatter).clip(0))
    varies = np.flatnonzero(scale > 0)
    if not len(varies):
        return np.zeros((0, len(scale)))
    upper = np.linalg.cholesky(_correlation(scatter, scale, varies), upper=True)
    return _in_all_columns(upper, scale, varies)


def _correlation(scatter: Any, scale: Any, varies: Any) -> Any:
    """Return the correlations of the columns that vary."""
    if len(varies) < len(scale):
        scatter, scale = scatter[np.ix_(varies, varies)], scale[varies]
    return scatter / scale / scale[:, np.newaxis]


def _in_all_columns(upper: Any, scale: Any, varies: Any) -> Any:
    """Return a factor of correlations as one of the scatter, with zeros for columns that do not vary."""
    if len(varies) == len(scale):
        return upper * scale
    factor = np.zeros((len(varies), len(scale)))
    factor[:, varies] = upper * scale[varies]
    return factor


def _swamps(between: Any, first: Any, second: Any) -> Any:
    """Whether the scatter between two sets is so large against that within that a sum loses digits."""
    within = np.diagonal(first.scatter) + np.diagonal(second.scatter)
    return bool((np.square(between) > 30 * within).any())
