"""Many small affine transports at once: one stacked solve, no loop over the maps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skat.gaussian import optimal_map, root_of_moments, row_moments
from skat.gaussian.arrays import Flags, Floats
from skat.gaussian.maps import EPS, LEAST_OF_A_PRODUCT, MUCH_ROUNDING

__all__ = ["BatchedMaps", "fit_batched"]

# A product of centred rows squares their condition: beyond this one the rows of a map go their own, slower way.
WORST_CONDITION = 1e6


@dataclass(frozen=True, eq=False)
class BatchedMaps:
    r"""Affine maps :math:`x \mapsto m_t + A (x - m_s)`, one for each of many problems.

    Attributes
    ----------
    coef : ndarray of shape (n_maps, n_features, n_features)
        :math:`A`.
    source_mean, target_mean : ndarray of shape (n_maps, n_features)
    """

    coef: Floats
    source_mean: Floats
    target_mean: Floats

    def __call__(self, X: ArrayLike) -> Floats:
        """Carry rows over, each stack by its own map.

        Parameters
        ----------
        X : array-like of shape (n_maps, n_rows, n_features)

        Returns
        -------
        ndarray of shape (n_maps, n_rows, n_features)
        """
        X = _stack(X, "X")
        expected = self.coef.shape[0], self.coef.shape[2]
        if (X.shape[0], X.shape[2]) != expected:
            raise ValueError(
                f"X must be a stack of rows for {expected[0]} maps of {expected[1]} columns; its shape is {X.shape}."
            )
        centred = X - self.source_mean[:, np.newaxis]
        return centred @ self.coef.transpose(0, 2, 1) + self.target_mean[:, np.newaxis]


def fit_batched(X: ArrayLike, y: ArrayLike) -> BatchedMaps:
    """Return the maps of `AffineTransport` for many problems of one size, solved together.

    Parameters
    ----------
    X : array-like of shape (n_maps, n_rows, n_features)
        Source rows of each problem.
    y : array-like of shape (n_maps, n_target_rows, n_features)
        Target rows of each.

    Returns
    -------
    BatchedMaps

    Raises
    ------
    ValueError
        If the stacks do not match or are not finite, or rows are fewer than two.
    numpy.linalg.LinAlgError
        If in one of the problems no affine map carries one domain to the other.

    Notes
    -----
    What is well conditioned is solved by stacked products, Cholesky factors and singular values. Problems beyond a
    condition of 1e6 of a correlation matrix are solved one by one, as `AffineTransport` does.

    Examples
    --------
    >>> import numpy as np
    >>> from skat.transport import fit_batched
    >>> X = np.random.default_rng(0).normal(size=(1000, 50, 2))
    >>> maps = fit_batched(X, 3 * X + 1)
    >>> bool(np.allclose(maps(X), 3 * X + 1))
    True
    """
    X, y = _stack(X, "X"), _stack(y, "y")
    if X.shape[0] != y.shape[0] or X.shape[2] != y.shape[2]:
        raise ValueError(
            f"X and y must be stacks of as many problems with the same columns; they are {X.shape} and {y.shape}."
        )
    if min(X.shape[1], y.shape[1]) < 2:
        raise ValueError(
            f"each problem needs two rows a side or more; there are {X.shape[1]} and {y.shape[1]}."
        )
    (source_mean, source_covariance), (target_mean, target_covariance) = _moments(X), _moments(y)
    good = _well_conditioned(source_mean, source_covariance)
    good &= _well_conditioned(target_mean, target_covariance)
    coef = np.empty(source_covariance.shape)
    if good.any():
        source_root = np.linalg.cholesky(source_covariance[good])
        target_root = np.linalg.cholesky(target_covariance[good])
        left, values, _ = np.linalg.svd(target_root.transpose(0, 2, 1) @ source_root)
        half = target_root @ (left / np.sqrt(values)[:, np.newaxis])
        coef[good] = half @ half.transpose(0, 2, 1)
    for k in np.flatnonzero(~good):
        coef[k] = optimal_map(root_of_moments(row_moments(X[k])), root_of_moments(row_moments(y[k])))
    return BatchedMaps(coef, source_mean, target_mean)


def _stack(rows: ArrayLike, name: str) -> Floats:
    rows = np.asarray(rows, dtype=np.float64)
    if rows.ndim != 3 or not rows.size:
        raise ValueError(f"{name} must be of shape (n_maps, n_rows, n_features); its shape is {rows.shape}.")
    # A sum is not finite if one of its terms is not.
    if not np.isfinite(rows.sum()) and not np.isfinite(rows).all():
        raise ValueError(f"Input {name} contains NaN or infinity. Drop those rows.")
    return rows


def _moments(rows: Floats) -> tuple[Floats, Floats]:
    mean = rows.mean(axis=1)
    centred = rows - mean[:, np.newaxis]
    return mean, centred.transpose(0, 2, 1) @ centred / rows.shape[1]


def _well_conditioned(mean: Floats, covariance: Floats) -> Flags:
    """Return where columns vary by far more than the rounding of their mean, and depend little on each other."""
    deviation = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    varies = (LEAST_OF_A_PRODUCT * deviation > MUCH_ROUNDING * EPS * np.abs(mean)).all(axis=1)
    scale = np.where(deviation > 0, deviation, 1.0)
    values = np.linalg.eigvalsh(covariance / scale[:, np.newaxis] / scale[:, :, np.newaxis])
    return varies & (values[:, 0] * WORST_CONDITION > values[:, -1])
