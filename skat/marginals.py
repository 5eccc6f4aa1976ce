"""Squared distances of one-dimensional marginals: a bound from below of the squared distance of two laws."""

import warnings
from functools import partial

import numpy as np
from sklearn.decomposition import FastICA
from sklearn.exceptions import ConvergenceWarning
from threadpoolctl import threadpool_limits

from skat.moments import row_moments

__all__ = ["halves", "marginal_squares", "orders"]

ROWS_THAT_FIND_A_BASIS = 10_000
# More cuts of the same rows take a third off the noise of the bound, which matters where there are few.
MOST_CUTS, ROWS_OF_ALL_CUTS = 4, 10_000


def marginal_squares(X, y, rng):
    """Return the sum of squared marginal distances for either half of the rows, in a basis from the other.

    The mathematics is in the docstring of `skat.affinity.affinity_upper_bound`.

    Parameters
    ----------
    X : ndarray of shape (n_source, n_features)
        One sample; at least eight rows.
    y : ndarray of shape (n_target, n_features)
        The other one, in the same units.
    rng : numpy.random.RandomState
        Deals out the rows.

    Returns
    -------
    list of two floats
        In the unit that the columns share, squared; noise may make them negative.

    Raises
    ------
    ValueError
        If there are too few rows.
    """
    if min(len(X), len(y)) < 8:
        raise ValueError(
            f"each half is cut into two parts of at least two rows; there are {len(X)} source and {len(y)} "
            "target rows. Give at least eight of each."
        )
    source, target = orders(len(X), len(y), rng)
    folds = list(zip(halves(source), halves(target)))
    squares = []
    for (find_source, find_target), (test_source, test_target) in (folds, folds[::-1]):
        basis = _telling_basis(X[find_source], y[find_target], rng)
        squares.append(_marginal_square(X[test_source], y[test_target], basis, rng))
    return squares


def _marginal_square(X, y, basis, rng):
    """Return the sum of squared marginal distances, by products of independent differences."""
    X, y = X @ basis.T, y @ basis.T
    n_rows = min(len(X), len(y))
    n_part = n_rows // 2
    n_cuts = min(max(ROWS_OF_ALL_CUTS // n_rows, 1), MOST_CUTS)
    square = 0.0
    for _ in range(n_cuts):
        source, target = orders(len(X), len(y), rng)
        first, second = (
            _mean_sorted(part_of_X, n_part) - _mean_sorted(part_of_y, n_part)
            for part_of_X, part_of_y in zip(halves(X[source]), halves(y[target]))
        )
        square += float((first * second).mean(axis=0).sum())
    return square / n_cuts


def _mean_sorted(rows, n_part):
    """Return sorted columns of that many rows, averaged where there are rows for several."""
    n_parts = len(rows) // n_part
    return np.sort(rows[: n_parts * n_part].reshape(n_parts, n_part, -1), axis=1).mean(axis=0)


def _telling_basis(X, y, rng):
    """Return the orthonormal basis, in rows, of the largest marginal distance among a few."""
    X, y = X[:ROWS_THAT_FIND_A_BASIS], y[:ROWS_THAT_FIND_A_BASIS]
    axes, _ = _principal(y)
    candidates = [np.eye(y.shape[1]), axes.T, _independent_basis(y, rng), _independent_basis(X, rng)]
    return max(candidates, key=partial(_marginal_square, X, y, rng=rng))


def _independent_basis(rows, rng):
    """Return the orthonormal basis nearest to the independent components of the rows."""
    axes, spread = _principal(rows)
    if len(spread) < 2:
        return axes.T
    white = (rows - rows.mean(axis=0)) @ (axes / spread)
    analysis = FastICA(whiten=False, max_iter=60, tol=1e-3, random_state=rng)
    # The products are too small for more threads to pay.
    with warnings.catch_warnings(), threadpool_limits(limits=1, user_api="blas"):
        # Components of a normal law do not exist, so the search need not end; any basis gives a valid bound.
        warnings.simplefilter("ignore", ConvergenceWarning)
        analysis.fit(white)
    left, _, right = np.linalg.svd(analysis.components_ @ (axes / spread).T, full_matrices=False)
    return left @ right


def _principal(rows):
    """Return principal directions, in columns, and standard deviations, less those of no variance."""
    variance, axes = np.linalg.eigh(row_moments(rows).covariance)
    kept = variance > 1e-12 * variance[-1]
    return axes[:, kept], np.sqrt(variance[kept])


def orders(n_source, n_target, rng):
    """Return the row numbers in random order, the same for both sides where rows may be pairs."""
    source = rng.permutation(n_source)
    return source, source if n_source == n_target else rng.permutation(n_target)


def halves(rows):
    """Return the first and the second half."""
    return rows[: len(rows) // 2], rows[len(rows) // 2 :]
