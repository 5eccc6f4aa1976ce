"""Scorers of fitted transports for scikit-learn's model selection."""

from collections.abc import Callable
from typing import Any, Self, SupportsFloat

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.utils.metadata_routing import UNCHANGED, MetadataRequest

from skat.gaussian.arrays import AnyArray, Flags, Floats
from skat.gaussian.backends import on_host
from skat.metrics.affinity import affinity_at_any_size, affinity_score
from skat.metrics.domains import domain_signs
from skat.metrics.samples import one_sample, row_weight, two_samples

__all__ = ["affinity_scorer", "paired_error_scorer"]


def paired_error_scorer(
    estimator: BaseEstimator,
    X: AnyArray,
    y: AnyArray | None = None,
    *,
    sample_weight: AnyArray | None = None,
    sample_domain: AnyArray | None = None,
) -> float:
    r"""Score a fitted transport by the mean distance between transported rows and their partners, negated.

    .. math:: -\frac1n \sum_k \|T(x_k) - y_k\|

    For ``scoring=paired_error_scorer`` in `~sklearn.model_selection.cross_validate` and its kin; greater is
    better.

    Parameters
    ----------
    estimator : fitted transport or pipeline that ends in one
        Anything with ``transform``.
    X : array-like of shape (n_samples, n_features)
        Source rows.
    y : array-like of shape (n_samples, n_features)
        The target row of each; ignored with `sample_domain`.
    sample_weight : array-like of shape (n_samples,), default=None
        Weights of the pairs; with `sample_domain` of all rows, those of the source rows counting.
    sample_domain : array-like of shape (n_samples,), default=None
        For rows of both domains, stacked in `X`: the k-th source row belongs to the k-th target row. Metadata routing
        hands it on without being asked. In the labels that `AffineTransport` understands without `source_domain`.

    Returns
    -------
    float
        Zero or less, in the unit that the columns share.

    Raises
    ------
    TypeError
        If the estimator cannot transform.
    ValueError
        If the rows are not in pairs or not finite.

    Notes
    -----
    *When it lies.* It depends on the units of the columns, and columns with large numbers decide it. Noise in
    the target is part of it: no map gets below the noise.

    Examples
    --------
    >>> from sklearn.preprocessing import FunctionTransformer
    >>> paired_error_scorer(FunctionTransformer(), [[0.0, 0.0]], [[3.0, 4.0]])
    -5.0
    """
    if sample_domain is None:
        carried = _carried(estimator, X)
    else:
        rows, carried, is_source = _by_domain(estimator, X, sample_domain)
        carried, y = carried[is_source], rows[~is_source]
        sample_weight = None if sample_weight is None else on_host(sample_weight)[is_source]
    carried, target = two_samples(carried, y)
    if len(carried) != len(target):
        raise ValueError(
            f"a paired error needs the target row of every source row; there are {len(carried)} source and "
            f"{len(target)} target rows. Use affinity_scorer() where there are no pairs."
        )
    errors = np.linalg.norm(carried - target, axis=1)
    return -float(np.average(errors, weights=row_weight(sample_weight, len(errors))))


def _routing_of_pairs() -> MetadataRequest:
    routing = MetadataRequest(owner="paired_error_scorer")
    routing.score.add_request(param="sample_domain", alias=True)
    return routing


# A scorer that is a function can ask for metadata only so.
setattr(paired_error_scorer, "get_metadata_routing", _routing_of_pairs)  # noqa: B010


def affinity_scorer(
    score: Callable[..., SupportsFloat] = affinity_score, *, source_domain: object = None, **options: Any
) -> "_AffinityScorer":
    """Return a scorer of fitted transports by an affinity score.

    For ``scoring=affinity_scorer()``. It calls ``estimator.transform(X)`` and compares the result with `y`.
    After a fit with stacked rows it compares the carried source rows with the target rows among those in `X`,
    and wants `sample_domain` for it, which metadata routing hands on without being asked; `sample_weight` it
    hands on after ``affinity_scorer().set_score_request(sample_weight=True)``.

    Parameters
    ----------
    score : callable, default=affinity_score
        ``score(X_transported, y, **options)`` to a number, greater is better: `affinity_score`,
        `debiased_affinity_score`, `affinity_upper_bound`, `affinity_estimate` or one of your own. Where the exact
        score would need a cost matrix beyond 8 GB (31,600 rows of each), the default is the estimate
        instead, as ``score`` of a transport is; it does not compare with scores of fewer rows.
    source_domain : label or list of labels, default=None
        The labels of source rows in `sample_domain`, as for `AffineTransport`.
    **options
        Further keyword arguments for it.

    Returns
    -------
    callable
        ``scorer(estimator, X, y)`` to a float.

    Raises
    ------
    TypeError
        If `score` is not callable.

    Notes
    -----
    *When it lies.* As the score it calls. In cross-validation the folds are smaller than the whole, so scores
    of different numbers of folds, or points of a learning curve whose test folds differ in size, do not
    compare.

    Examples
    --------
    >>> from sklearn.preprocessing import FunctionTransformer
    >>> affinity_scorer()(FunctionTransformer(), [[0.0], [2.0]], [[2.0], [0.0]])
    1.0
    """
    if not callable(score):
        raise TypeError(
            f"score must be a function of transported rows and target rows; it is {score!r}. "
            "Give one, such as skat.metrics.affinity_score."
        )
    return _AffinityScorer(score, options, source_domain)


class _AffinityScorer:
    def __init__(
        self, score: Callable[..., SupportsFloat], options: dict[str, Any], source_domain: object
    ) -> None:
        self._score = score
        self._options = options
        self._source_domain = source_domain
        self._requested: dict[str, bool | str | None] = {}

    def __repr__(self) -> str:
        options = "".join(f", {name}={value!r}" for name, value in self._options.items())
        return f"affinity_scorer({getattr(self._score, '__name__', self._score)}{options})"

    def __call__(
        self,
        estimator: BaseEstimator,
        X: AnyArray,
        y: AnyArray | None = None,
        *,
        sample_weight: AnyArray | None = None,
        sample_domain: AnyArray | None = None,
    ) -> float:
        options = dict(self._options)
        if sample_domain is None:
            carried = _carried(estimator, X)
            if sample_weight is not None:
                options["sample_weight"] = sample_weight
        else:
            _, carried, is_source = _by_domain(estimator, X, sample_domain, self._source_domain)
            if is_source.all() or not is_source.any():
                raise ValueError(
                    "a score compares source rows with target rows; of these rows "
                    f"{int(is_source.sum())} are source and {int((~is_source).sum())} target. Stratify the folds by "
                    "domain."
                )
            carried, y = carried[is_source], carried[~is_source]
            if sample_weight is not None:
                weight = on_host(sample_weight)
                options["sample_weight"] = (weight[is_source], weight[~is_source])
        if self._score is affinity_score and not options:
            # In NumPy and checked once: the length of another library's array is its own affair.
            return float(affinity_at_any_size(*two_samples(carried, y)))
        return float(self._score(carried, y, **options))

    def set_score_request(
        self, *, sample_weight: bool | str | None = UNCHANGED, sample_domain: bool | str | None = UNCHANGED
    ) -> Self:
        """Ask for `sample_weight`, or not for `sample_domain`, in metadata routing."""
        requests = {"sample_weight": sample_weight, "sample_domain": sample_domain}
        self._requested |= {name: wanted for name, wanted in requests.items() if wanted is not UNCHANGED}
        return self

    def get_metadata_routing(self) -> MetadataRequest:
        """Return what `set_score_request` asked for."""
        routing = MetadataRequest(owner=self)
        for name, alias in {"sample_weight": None, "sample_domain": True, **self._requested}.items():
            routing.score.add_request(param=name, alias=alias)
        return routing


def _by_domain(
    estimator: BaseEstimator, X: AnyArray, sample_domain: AnyArray, source_domain: object = None
) -> tuple[Floats, Floats, Flags]:
    """Return the rows in NumPy, the same carried over, and which of them are source rows."""
    rows, labels = one_sample(X, "X"), on_host(sample_domain)
    is_source = domain_signs(labels, len(rows), source_domain) > 0
    return rows, one_sample(_carried(estimator, X, sample_domain=labels), "X_transported"), is_source


def _carried(estimator: BaseEstimator, X: AnyArray, **keywords: AnyArray) -> AnyArray:
    if not hasattr(estimator, "transform"):
        raise TypeError(
            f"the scorer compares estimator.transform(X) with y, but {type(estimator).__name__} cannot "
            "transform. Give a transport, or a pipeline that ends in one."
        )
    return estimator.transform(X, **keywords)
