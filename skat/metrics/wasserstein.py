"""Exact 2-Wasserstein distance between two finite samples, and the affinity that is built on it."""

from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from skat.gaussian.arrays import AnyArray, Floats, Places
from skat.metrics.samples import one_sample, root_of_twice_the_spread, row_weight, two_samples

__all__ = ["affinity", "is_large_cost", "optimal_plan", "refuse_large_cost", "wasserstein_distance"]

LARGEST_COST_MATRIX_BYTES = 8e9


def wasserstein_distance(
    X: AnyArray, y: AnyArray, *, x_weight: AnyArray = None, y_weight: AnyArray = None
) -> float:
    r"""Return the exact 2-Wasserstein distance between two weighted samples.

    .. math:: W_2^2 = \min_{\gamma} \sum_{ij} \gamma_{ij} \|x_i - y_j\|^2

    over all couplings :math:`\gamma` of the two samples. Samples of equal size and uniform weight are an
    assignment problem, which SciPy solves; any other goes to POT's network simplex. Both are exact, need
    memory :math:`n_x n_y` and time that grows about with the cube of the number of rows.

    Parameters
    ----------
    X : array-like of shape (n_x, n_features)
        One sample.
    y : array-like of shape (n_y, n_features)
        The other one, in the same units.
    x_weight, y_weight : array-like of shape (n_x,) and (n_y,), default=None
        Non-negative weights of the rows, of any positive sum; None is uniform.

    Returns
    -------
    float
        In the unit that the columns share.

    Raises
    ------
    ValueError
        If the samples are empty, not finite or differ in their number of columns; if weights are negative,
        all zero or of another number than the rows; or if the cost matrix would be larger than 8 GB.
    RuntimeError
        If POT's solver does not reach the optimum.

    Examples
    --------
    >>> wasserstein_distance([[0.0], [1.0]], [[3.0], [2.0]])
    2.0
    >>> wasserstein_distance([[0.0], [1.0]], [[1.0]], x_weight=[1, 3])
    0.5
    """
    X, y, size, weights = _problem(X, y, x_weight, y_weight)
    cost = cdist(X, y, "sqeuclidean")
    if len(X) == len(y) and all(weight is None or _is_uniform(weight) for weight in weights):
        return size * float(np.sqrt(np.square(X - y[_assignment(cost)]).sum(axis=1).mean()))
    return size * float(np.sqrt(max(_network_simplex(cost, *weights, plan=False), 0.0)))


def optimal_plan(
    X: AnyArray, y: AnyArray, *, x_weight: AnyArray = None, y_weight: AnyArray = None
) -> tuple[Floats, float]:
    r"""Return the coupling of two weighted samples of least mean squared distance, and the distance.

    Parameters
    ----------
    X, y, x_weight, y_weight
        As for `wasserstein_distance`.

    Returns
    -------
    ndarray of shape (n_x, n_y)
        Not negative, of sum one.
    float
        The 2-Wasserstein distance.

    Raises
    ------
    ValueError, RuntimeError
        As for `wasserstein_distance`.
    """
    X, y, size, weights = _problem(X, y, x_weight, y_weight)
    cost = cdist(X, y, "sqeuclidean")
    plan = _network_simplex(cost, *weights, plan=True)
    return plan, size * float(np.sqrt((plan * cost).sum()))


def affinity(
    X_transported: AnyArray, y: AnyArray, *, x_weight: AnyArray = None, y_weight: AnyArray = None
) -> float:
    r"""Return the affinity of transported rows and target rows.

    .. math:: \rho = 1 - \frac{W_2(T X, Y)}{\sqrt{2 \operatorname{tr} \Sigma(Y)}}

    One where the two samples are equal, zero where the best coupling of centred samples is no better than the
    independent one; negative where they are further apart than that, as may be on rows that the map was not
    fitted to.

    Parameters
    ----------
    X_transported : array-like of shape (n_x, n_features)
        Source rows, carried over by a map.
    y : array-like of shape (n_y, n_features)
        Target rows.
    x_weight, y_weight : array-like of shape (n_x,) and (n_y,), default=None
        Non-negative weights of the rows; None is uniform.

    Returns
    -------
    float
        At most one, without unit.

    Raises
    ------
    ValueError
        As `wasserstein_distance`; and if the target rows are all equal while the transported ones are not
        equal to them, so that there is no scale to measure by.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Section II.

    Examples
    --------
    >>> affinity([[0.0], [2.0]], [[2.0], [0.0]])
    1.0
    """
    distance = wasserstein_distance(X_transported, y, x_weight=x_weight, y_weight=y_weight)
    if distance == 0.0:
        return 1.0
    y = one_sample(y, "y")
    return float(1.0 - distance / root_of_twice_the_spread(y, row_weight(y_weight, len(y), "y_weight")))


def is_large_cost(n_x: int, n_y: int) -> bool:
    """Whether the cost matrix between so many rows is larger than what is computed."""
    return 8.0 * n_x * n_y > LARGEST_COST_MATRIX_BYTES


def refuse_large_cost(n_x: int, n_y: int) -> None:
    """Raise where the exact transport would need a cost matrix that few machines can hold.

    Parameters
    ----------
    n_x, n_y : int
        Numbers of rows.

    Raises
    ------
    ValueError
        Naming the size and what needs less.
    """
    cost_bytes = 8.0 * n_x * n_y
    if is_large_cost(n_x, n_y):
        raise ValueError(
            f"the exact transport between {n_x} and {n_y} rows needs a cost matrix of "
            f"{cost_bytes / 1e9:.0f} GB; it is computed up to {LARGEST_COST_MATRIX_BYTES / 1e9:.0f} GB. Use "
            "a part of the rows or, for a score, skat.metrics.affinity_estimate, whose memory is linear in "
            "their number."
        )


def _problem(
    X: AnyArray, y: AnyArray, x_weight: AnyArray, y_weight: AnyArray
) -> tuple[Floats, Floats, float, tuple[Floats | None, Floats | None]]:
    """Return rows about one of them in units of the largest entry, that unit, and their weights; all checked.

    The solvers stop at absolute tolerances, and squares have half the range of the numbers.
    """
    X, y = two_samples(X, y, "X")
    refuse_large_cost(len(X), len(y))
    centre = y[0].copy()
    with np.errstate(over="ignore"):
        X, y = X - centre, y - centre
    size = float(max(np.abs(X).max(), np.abs(y).max())) or 1.0
    if not np.isfinite(size):
        raise ValueError(
            "the differences between rows of X and y exceed the range of float64. Choose larger units."
        )
    weights = row_weight(x_weight, len(X), "x_weight"), row_weight(y_weight, len(y), "y_weight")
    return X / size, y / size, size, weights


def _is_uniform(weight: Floats) -> bool:
    return bool((weight == weight[0]).all())


def _assignment(cost: Floats) -> Places:
    """Return the column of each row of least total cost, and reduce the cost in place on the way."""
    # Which columns are best does not change, but the solver's searches end two to three times sooner.
    cost -= cost.min(axis=0)
    cost -= cost.min(axis=1)[:, np.newaxis]
    columns: Places = linear_sum_assignment(cost)[1]
    return columns


def _network_simplex(cost: Floats, x_weight: Floats | None, y_weight: Floats | None, *, plan: bool) -> Any:
    """Return the coupling of least mean cost, or that cost, by POT."""
    import ot

    weights = (
        np.full(n_rows, 1.0 / n_rows) if weight is None else weight / weight.sum()
        for n_rows, weight in zip(cost.shape, (x_weight, y_weight))
    )
    solve = ot.emd if plan else ot.emd2
    found, log = solve(*weights, cost, numItermax=100 * cost.size + 100_000, log=True)
    if log["warning"] is not None:
        raise RuntimeError(
            f"POT did not solve the exact transport between {cost.shape[0]} and {cost.shape[1]} rows: "
            f"{log['warning']}. Use fewer rows."
        )
    return found
