"""Exact 2-Wasserstein distance between two finite samples, and the affinity that is built on it."""

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

__all__ = ["affinity", "refuse_large_cost", "wasserstein_distance"]

LARGEST_COST_MATRIX_BYTES = 8e9


def wasserstein_distance(X, y, *, x_weight=None, y_weight=None):
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
    X, y = _sample(X, "X"), _sample(y, "y")
    if X.shape[1] != y.shape[1]:
        raise ValueError(
            f"X and y must have the same columns; X has {X.shape[1]}, y has {y.shape[1]}. "
            "Give both the same features."
        )
    refuse_large_cost(len(X), len(y))
    cost = cdist(X, y, "sqeuclidean")
    x_weight, y_weight = _weights(x_weight, len(X), "x_weight"), _weights(y_weight, len(y), "y_weight")
    if len(X) == len(y) and _is_uniform(x_weight) and _is_uniform(y_weight):
        return float(np.sqrt(np.square(X - y[_assignment(cost)]).sum(axis=1).mean()))
    return float(np.sqrt(_network_simplex(cost, x_weight, y_weight)))


def affinity(X_transported, y, *, x_weight=None, y_weight=None):
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
    y = _sample(y, "y")
    weight = _weights(y_weight, len(y), "y_weight")
    centred = y - weight @ y
    spread = np.sqrt(2.0 * (weight @ np.square(centred).sum(axis=1)))
    if distance == 0.0:
        return 1.0
    if spread == 0.0:
        raise ValueError(
            f"the affinity divides by the spread of the target, but all {len(y)} target rows are equal. "
            "Give target rows that vary."
        )
    return float(1.0 - distance / spread)


def refuse_large_cost(n_x, n_y):
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
    if cost_bytes > LARGEST_COST_MATRIX_BYTES:
        raise ValueError(
            f"the exact transport between {n_x} and {n_y} rows needs a cost matrix of "
            f"{cost_bytes / 1e9:.0f} GB; it is computed up to {LARGEST_COST_MATRIX_BYTES / 1e9:.0f} GB. Use "
            "a part of the rows or, for a score, skat.metrics.affinity_estimate, whose memory is linear in "
            "their number."
        )


def _sample(rows, name):
    rows = np.asarray(rows, dtype=np.float64)
    if rows.ndim != 2 or 0 in rows.shape:
        raise ValueError(
            f"{name} must be a 2-D array of at least one row and column; its shape is {rows.shape}."
        )
    if not np.isfinite(rows).all():
        raise ValueError(f"{name} must be finite; it contains NaN or infinity. Drop or fill those rows.")
    return rows


def _weights(weight, n_samples, name):
    if weight is None:
        return np.full(n_samples, 1.0 / n_samples)
    weight = np.asarray(weight, dtype=np.float64)
    if weight.shape != (n_samples,):
        raise ValueError(
            f"{name} must have one weight per row, shape ({n_samples},); its shape is {weight.shape}."
        )
    if not np.isfinite(weight).all() or weight.min() < 0 or weight.sum() <= 0:
        raise ValueError(
            f"{name} must be finite, non-negative and not all zero; its minimum is {weight.min()}."
        )
    return weight / weight.sum()


def _is_uniform(weight):
    return bool((weight == weight[0]).all())


def _assignment(cost):
    """Return the column of each row of least total cost, and reduce the cost in place on the way."""
    # Which columns are best does not change, but the solver's searches end two to three times sooner.
    cost -= cost.min(axis=0)
    cost -= cost.min(axis=1)[:, np.newaxis]
    return linear_sum_assignment(cost)[1]


def _network_simplex(cost, x_weight, y_weight):
    """Return the least mean cost of a coupling, by POT."""
    import ot

    value, log = ot.emd2(x_weight, y_weight, cost, numItermax=100 * cost.size + 100_000, log=True)
    if log["warning"] is not None:
        raise RuntimeError(
            f"POT did not solve the exact transport between {cost.shape[0]} and {cost.shape[1]} rows: "
            f"{log['warning']}. Use fewer rows."
        )
    return max(float(value), 0.0)
