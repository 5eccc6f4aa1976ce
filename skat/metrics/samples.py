"""Checks of the samples that scores and distances compare, and how far a target spreads."""

from typing import Any

import numpy as np
from sklearn.utils import check_array

from skat._compat import convert_to_numpy, get_namespace_and_device, is_numpy_namespace
from skat.gaussian.moments import row_moments

__all__ = [
    "one_sample",
    "root_of_twice_the_spread",
    "row_weight",
    "twice_the_spread",
    "two_samples",
    "two_weights",
    "weight_of_each_side",
]


def one_sample(rows: Any, name: str) -> Any:
    """Return rows as a finite array (n_rows, n_features) of float64."""
    return check_array(_in_numpy(rows), dtype=np.float64, input_name=name)


def _in_numpy(array: Any) -> Any:
    """Return an array of another library, or on another device, as one in NumPy; anything else as it is."""
    xp, is_array_api, _ = get_namespace_and_device(array)
    return convert_to_numpy(array, xp) if is_array_api and not is_numpy_namespace(xp) else array


def two_samples(X: Any, y: Any, name: str = "X_transported", *, paired: bool = False) -> Any:
    """Return two sets of rows, checked to have the same number of columns, and of rows where they are in pairs."""
    X, y = one_sample(X, name), one_sample(y, "y")
    if X.shape[1] != y.shape[1]:
        raise ValueError(
            f"{name} and y must have the same columns; {name} has {X.shape[1]}, y has {y.shape[1]}. "
            "Give both the same features."
        )
    if paired and len(X) != len(y):
        raise ValueError(
            f"pairs need as many source rows as target rows; there are {len(X)} and {len(y)}. "
            "Give the rows in pairs, or paired=False."
        )
    return X, y


def row_weight(weight: Any, n_rows: int, name: str = "sample_weight") -> Any:
    """Return weights as an array (n_rows,), not negative and of positive sum; None as it is."""
    if weight is None:
        return None
    weight = np.asarray(_in_numpy(weight), dtype=np.float64)
    if weight.shape != (n_rows,):
        raise ValueError(
            f"{name} must have one weight per row, shape ({n_rows},); its shape is {weight.shape}."
        )
    if not np.isfinite(weight).all() or weight.min() < 0 or weight.sum() <= 0:
        raise ValueError(
            f"{name} must be finite, non-negative and not all zero; its minimum is {weight.min()}."
        )
    return weight


def two_weights(sample_weight: Any, n_source: Any, n_target: Any) -> Any:
    """Return the weights of both sides, given for pairs of rows or as a tuple (source, target)."""
    if not isinstance(sample_weight, tuple):
        if sample_weight is not None and n_source != n_target:
            raise ValueError(
                f"{n_source} source and {n_target} target rows need a weight each: sample_weight must be "
                "a tuple (source, target)."
            )
        sample_weight = (sample_weight, sample_weight)
    source_weight, target_weight = weight_of_each_side(sample_weight)
    return row_weight(source_weight, n_source), row_weight(target_weight, n_target)


def weight_of_each_side(sample_weight: Any) -> Any:
    """Return a tuple of weights, checked to be one of two sides."""
    if len(sample_weight) != 2:
        raise ValueError(
            "a tuple of weights is one for two sides, (source_weight, target_weight); it has "
            f"{len(sample_weight)} entries. Give weights of rows as a list or an array."
        )
    return sample_weight


def root_of_twice_the_spread(y: Any, weight: Any = None) -> float:
    """Return the root of twice the trace of the target's covariance, by which affinities divide; never zero."""
    # Squares have half the range of the numbers.
    centred = y - y[0]
    size = float(np.abs(centred).max()) or 1.0
    root = size * float(np.sqrt(2.0 * row_moments(centred / size, weight).variance.sum()))
    if root == 0.0:
        raise ValueError(
            f"the affinity divides by the spread of the target, but all {len(y)} target rows are equal. "
            "Give target rows that vary."
        )
    return root


def twice_the_spread(y: Any, weight: Any = None) -> float:
    """Return twice the trace of the target's covariance, by which squares of distances are divided; never zero."""
    root = root_of_twice_the_spread(y, weight)
    with np.errstate(over="ignore"):
        spread = float(np.square(root))
    if not 0.0 < spread < np.inf:
        raise ValueError(
            f"the square of the target's spread, {root:.1e}, is beyond the range of float64. Choose other units."
        )
    return spread
