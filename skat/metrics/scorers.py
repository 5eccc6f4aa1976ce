"""Scorers of fitted transports for scikit-learn's model selection."""

import numpy as np
from sklearn.utils.metadata_routing import UNCHANGED, MetadataRequest

from skat.metrics.affinity import affinity_score
from skat.metrics.samples import row_weight, two_samples

__all__ = ["affinity_scorer", "paired_error_scorer"]


def paired_error_scorer(estimator, X, y, *, sample_weight=None):
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
        The target row of each.
    sample_weight : array-like of shape (n_samples,), default=None
        Weights of the pairs.

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
    carried, target = two_samples(_carried(estimator, X), y)
    if len(carried) != len(target):
        raise ValueError(
            f"a paired error needs the target row of every source row; there are {len(carried)} source and "
            f"{len(target)} target rows. Use affinity_scorer() where there are no pairs."
        )
    errors = np.linalg.norm(carried - target, axis=1)
    return -float(np.average(errors, weights=row_weight(sample_weight, len(errors))))


def affinity_scorer(score=affinity_score, **options):
    """Return a scorer of fitted transports by an affinity score.

    For ``scoring=affinity_scorer()``. It calls ``estimator.transform(X)`` and compares the result with `y`.
    After a fit with stacked rows it compares the carried source rows with the target rows among those in `X`,
    and wants `sample_domain` for it, which metadata routing hands on without being asked; `sample_weight` it
    hands on after ``affinity_scorer().set_score_request(sample_weight=True)``.

    Parameters
    ----------
    score : callable, default=affinity_score
        ``score(X_transported, y, **options)`` to a number, greater is better: `affinity_score`,
        `debiased_affinity_score`, `affinity_upper_bound`, `affinity_estimate` or one of your own.
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
    return _AffinityScorer(score, options)


class _AffinityScorer:
    def __init__(self, score, options):
        self._score = score
        self._options = options
        self._requested = {}

    def __repr__(self):
        options = "".join(f", {name}={value!r}" for name, value in self._options.items())
        return f"affinity_scorer({getattr(self._score, '__name__', self._score)}{options})"

    def __call__(self, estimator, X, y=None, *, sample_weight=None, sample_domain=None):
        options = dict(self._options)
        if sample_domain is None:
            carried = _carried(estimator, X)
            if sample_weight is not None:
                options["sample_weight"] = sample_weight
        else:
            domain = np.asarray(sample_domain)
            is_source, is_target = domain > 0, domain < 0
            if domain.shape != (len(X),) or not (is_source.any() and is_target.any()):
                raise ValueError(
                    f"sample_domain must have one number per row ({len(X)}), some positive (source) and some "
                    f"negative (target); its shape is {domain.shape}, with {int(is_source.sum())} positive "
                    f"and {int(is_target.sum())} negative. Stratify the folds by domain."
                )
            carried = np.asarray(_carried(estimator, X, sample_domain=domain))
            carried, y = carried[is_source], carried[is_target]
            if sample_weight is not None:
                weight = np.asarray(sample_weight)
                options["sample_weight"] = (weight[is_source], weight[is_target])
        return float(self._score(carried, y, **options))

    def set_score_request(self, *, sample_weight=UNCHANGED, sample_domain=UNCHANGED):
        """Ask for `sample_weight`, or not for `sample_domain`, in metadata routing."""
        requests = {"sample_weight": sample_weight, "sample_domain": sample_domain}
        self._requested |= {name: wanted for name, wanted in requests.items() if wanted is not UNCHANGED}
        return self

    def get_metadata_routing(self):
        """Return what `set_score_request` asked for."""
        routing = MetadataRequest(owner=self)
        for name, alias in {"sample_weight": None, "sample_domain": True, **self._requested}.items():
            routing.score.add_request(param=name, alias=alias)
        return routing


def _carried(estimator, X, **keywords):
    if not hasattr(estimator, "transform"):
        raise TypeError(
            f"the scorer compares estimator.transform(X) with y, but {type(estimator).__name__} cannot "
            "transform. Give a transport, or a pipeline that ends in one."
        )
    return estimator.transform(X, **keywords)
