"""Squared distances of one-dimensional marginals: a bound from below of the squared distance of two laws."""

import warnings
from functools import partial
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from sklearn.exceptions import ConvergenceWarning
from threadpoolctl import threadpool_limits

from skat.gaussian.moments import row_moments

__all__ = ["halves", "marginal_squares", "orders"]

ROWS_THAT_FIND_A_BASIS = 10_000
# More cuts of the same rows take a third off the noise of the bound, which matters where there are few.
MOST_CUTS, ROWS_OF_ALL_CUTS = 4, 10_000
# With few rows components are found slowly. With many ten iterations find them, or there are none.
FEWEST_ITERATIONS, MOST_ITERATIONS, ROWS_OF_ALL_ITERATIONS = 20, 60, 200_000


def marginal_squares(X: Any, y: Any, rng: Any, n_jobs: int | None = None) -> Any:
    """Return the sum of squared marginal distances for either half of the rows, in a basis from the other.

    The mathematics is in the docstring of `skat.metrics.affinity.affinity_upper_bound`.

    Parameters
    ----------
    X : ndarray of shape (n_source, n_features)
        One sample; at least eight rows.
    y : ndarray of shape (n_target, n_features)
        The other one, in the same units.
    rng : numpy.random.RandomState
        Deals out the rows.
    n_jobs : int, default=None
        Number of threads; two can be of use.

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
    seeds = rng.randint(np.iinfo(np.int32).max, size=2)
    # The products of the search are too small for more threads to pay.
    with warnings.catch_warnings(), threadpool_limits(limits=1, user_api="blas"):
        # Components of a normal law do not exist, so the search need not end; any basis gives a valid bound.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return Parallel(n_jobs=n_jobs, prefer="threads")(
            delayed(_square_of_fold)(X, y, find, test, seed)
            for find, test, seed in zip(folds, folds[::-1], seeds)
        )


def _square_of_fold(X: Any, y: Any, find: Any, test: Any, seed: Any) -> Any:
    rng = np.random.RandomState(seed)
    find_source, find_target = (order[:ROWS_THAT_FIND_A_BASIS] for order in find)
    test_source, test_target = test
    basis = _telling_basis(X[find_source], y[find_target], rng)
    return _marginal_square(X[test_source], y[test_target], basis, rng)


def _marginal_square(X: Any, y: Any, basis: Any, rng: Any) -> Any:
    """Return the sum of squared marginal distances, by products of independent differences.

    The rows come in random order.
    """
    X, y = basis @ X.T, basis @ y.T
    n_rows = min(X.shape[1], y.shape[1])
    n_part = n_rows // 2
    n_cuts = min(max(ROWS_OF_ALL_CUTS // n_rows, 1), MOST_CUTS)
    square = 0.0
    for cut in range(n_cuts):
        if cut > 0:
            source, target = orders(X.shape[1], y.shape[1], rng)
            X, y = X[:, source], y[:, target]
        first, second = (
            _mean_sorted(part_of_X, n_part) - _mean_sorted(part_of_y, n_part)
            for part_of_X, part_of_y in zip(halves(X.T), halves(y.T))
        )
        square += float(np.vdot(first, second)) / n_part
    return square / n_cuts


def _mean_sorted(rows: Any, n_part: Any) -> Any:
    """Return that many sorted values of each column, in rows, averaged where there are values for several."""
    n_parts = len(rows) // n_part
    parts = rows[: n_parts * n_part].T.reshape(-1, n_parts, n_part)
    return np.sort(parts, axis=2).mean(axis=1)


def _telling_basis(X: Any, y: Any, rng: Any) -> Any:
    """Return the orthonormal basis, in rows, of the largest marginal distance among a few."""
    axes, _ = _principal(y)
    candidates = [np.eye(y.shape[1]), axes.T, _independent_basis(y, rng), _independent_basis(X, rng)]
    return max(candidates, key=partial(_marginal_square, X, y, rng=rng))


def _independent_basis(rows: Any, rng: Any) -> Any:
    """Return the orthonormal basis nearest to the independent components of the rows."""
    # Of all that scikit-learn has, this loads the most, and few calls come here.
    from sklearn.decomposition import FastICA

    axes, spread = _principal(rows)
    if len(spread) < 2:
        return axes.T
    white = (rows - rows.mean(axis=0)) @ (axes / spread)
    n_iterations = min(max(ROWS_OF_ALL_ITERATIONS // len(rows), FEWEST_ITERATIONS), MOST_ITERATIONS)
    analysis = FastICA(whiten=False, max_iter=n_iterations, tol=1e-3, random_state=rng)
    # Seven digits will do: the basis that comes of it is made orthonormal in full precision.
    components = analysis.fit(white.astype(np.float32)).components_.astype(np.float64)
    left, _, right = np.linalg.svd(components @ (axes / spread).T, full_matrices=False)
    return left @ right


def _principal(rows: Any) -> Any:
    """Return principal directions, in columns, and standard deviations, less those of no variance."""
    variance, axes = np.linalg.eigh(row_moments(rows).covariance)
    kept = variance > 1e-12 * variance[-1]
    return axes[:, kept], np.sqrt(variance[kept])


def orders(n_source: Any, n_target: Any, rng: Any) -> Any:
    """Return the row numbers in random order, the same for both sides where rows may be pairs."""
    source = rng.permutation(n_source)
    return source, source if n_source == n_target else rng.permutation(n_target)


def halves(rows: Any) -> Any:
    """Return the first and the second half."""
    return rows[: len(rows) // 2], rows[len(rows) // 2 :]
