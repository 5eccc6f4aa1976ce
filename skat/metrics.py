"""How far transported rows are from the target: distances, bounds, scorers, and the affinity score.

What compares two samples is found here; `skat.affinity` holds the affinity score and its kin, and says which
of them to ask.
"""

import numpy as np
from sklearn.utils.metadata_routing import UNCHANGED, MetadataRequest

from skat.affinity import (
    AffinityEstimate,
    AffinityTest,
    affinity_estimate,
    affinity_score,
    affinity_test,
    affinity_upper_bound,
    debiased_affinity_score,
)
from skat.gaussian import distance_of_roots, root_of_moments, row_moments
from skat.samples import one_sample, row_weight, two_samples, two_weights
from skat.wasserstein import wasserstein_distance

__all__ = [
    "AffinityEstimate",
    "AffinityTest",
    "affine_discrepancy_bound",
    "affine_error_bound",
    "affinity_estimate",
    "affinity_score",
    "affinity_scorer",
    "affinity_test",
    "affinity_upper_bound",
    "debiased_affinity_score",
    "gaussian_wasserstein_distance",
    "gelbrich_bound",
    "normal_approximation_bound",
    "paired_error_scorer",
    "wasserstein_distance",
]


def gaussian_wasserstein_distance(X, y, *, sample_weight=None):
    r"""Return the 2-Wasserstein distance between the normal approximations of two samples.

    .. math:: W_2^2(N_X, N_Y) = \|m_x - m_y\|^2 + \operatorname{tr} \Sigma_x + \operatorname{tr} \Sigma_y
              - 2 \operatorname{tr} (\Sigma_y^{1/2} \Sigma_x \Sigma_y^{1/2})^{1/2}

    with :math:`m` the means and :math:`\Sigma` the covariances of the rows, divided by their number.
    `skat.gaussian.gaussian_wasserstein_distance` takes means and covariances instead.

    Parameters
    ----------
    X : array-like of shape (n_source, n_features)
        One sample.
    y : array-like of shape (n_target, n_features)
        The other one, in the same units.
    sample_weight : array-like of shape (n_rows,) or tuple of two array-likes, default=None
        As in `affinity_score`.

    Returns
    -------
    float
        In the unit that the columns share.

    Raises
    ------
    ValueError
        If the arrays are not two-dimensional, finite and of the same number of columns.

    Notes
    -----
    *When it lies.* It sees means and covariances only. After an affine transport fitted to these rows it is
    zero, however wrong the map.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Equation 6.

    Examples
    --------
    >>> gaussian_wasserstein_distance([[-1.0], [1.0]], [[-2.0], [8.0]])
    5.0
    """
    source, target = _two_moments(X, y, sample_weight)
    return distance_of_roots(source.mean - target.mean, root_of_moments(source), root_of_moments(target))


def gelbrich_bound(X, y, *, sample_weight=None):
    r"""Return a lower bound of the 2-Wasserstein distance between two samples, from their moments.

    .. math:: W_2(N_X, N_Y) \le W_2(X, Y)

    The normal approximations :math:`N` have the samples' means and covariances, so this is
    `gaussian_wasserstein_distance`, under the name of what it is good for: the exact distance of many rows is
    expensive, this is not.

    Parameters
    ----------
    X : array-like of shape (n_source, n_features)
        One sample.
    y : array-like of shape (n_target, n_features)
        The other one, in the same units.
    sample_weight : array-like of shape (n_rows,) or tuple of two array-likes, default=None
        As in `affinity_score`.

    Returns
    -------
    float
        In the unit that the columns share. Equal to the distance if one sample is a symmetric, positive
        semi-definite affine image of the other.

    Raises
    ------
    ValueError
        If the arrays are not two-dimensional, finite and of the same number of columns.

    Notes
    -----
    *When it lies.* It bounds the distance of these samples. That of the populations is estimated by it with
    an error of order :math:`n^{-1/2}`, of either sign.

    References
    ----------
    .. [1] Gelbrich (1990). On a formula for the L2 Wasserstein metric between measures on Euclidean and
       Hilbert spaces. Mathematische Nachrichten 147.

    Examples
    --------
    >>> X, y = [[0.0], [0.0], [3.0]], [[0.0], [3.0], [3.0]]
    >>> bool(gelbrich_bound(X, y) < wasserstein_distance(X, y))
    True
    """
    return gaussian_wasserstein_distance(X, y, sample_weight=sample_weight)


def affine_discrepancy_bound(X, y, *, sample_weight=None):
    r"""Return Proposition 1's bound of how far apart the exact and the Gaussian distance can be.

    .. math:: |W_2(N_X, N_Y) - W_2(X, Y)| \le
              \frac{2 \operatorname{tr} (\Sigma_x \Sigma_y)^{1/2}}{\sqrt{\operatorname{tr} \Sigma_x +
              \operatorname{tr} \Sigma_y}}

    Parameters
    ----------
    X : array-like of shape (n_source, n_features)
        One sample.
    y : array-like of shape (n_target, n_features)
        The other one, in the same units.
    sample_weight : array-like of shape (n_rows,) or tuple of two array-likes, default=None
        As in `affinity_score`.

    Returns
    -------
    float
        In the unit that the columns share; zero if both samples are constant.

    Raises
    ------
    ValueError
        If the arrays are not two-dimensional, finite and of the same number of columns.

    Notes
    -----
    *When it lies.* The paper proves it for centred laws; a difference of the means only shrinks the left
    side. It does not see the shape of the laws: it is as large for two normal laws, where the left side is
    zero.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Proposition 1.

    Examples
    --------
    >>> round(affine_discrepancy_bound([[-1.0], [1.0]], [[-1.0], [1.0]]), 6)
    1.414214
    """
    source, target = _two_moments(X, y, sample_weight)
    core = root_of_moments(target).T @ root_of_moments(source)
    spread = source.variance.sum() + target.variance.sum()
    if spread == 0.0:
        return 0.0
    return float(2.0 * np.linalg.svd(core, compute_uv=False).sum() / np.sqrt(spread))


def normal_approximation_bound(X, *, sample_weight=None):
    r"""Return Corollary 2's bound of the distance between a law and its normal approximation.

    .. math:: W_2(N_X, X) \le \sqrt{2 \operatorname{tr} \Sigma_x}

    Parameters
    ----------
    X : array-like of shape (n_samples, n_features)
        Rows of the law.
    sample_weight : array-like of shape (n_samples,), default=None
        Weights of the rows.

    Returns
    -------
    float
        In the unit that the columns share.

    Raises
    ------
    ValueError
        If the array is not two-dimensional and finite.

    Notes
    -----
    *When it lies.* It knows only the spread: it is the same for a normal law, where the distance is zero.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Corollary 2.

    Examples
    --------
    >>> normal_approximation_bound([[-1.0, 0.0], [1.0, 2.0]])
    2.0
    """
    moments = row_moments(one_sample(X, "X"), row_weight(sample_weight, len(X)))
    return float(np.sqrt(2.0 * moments.variance.sum()))


def affine_error_bound(y, *, sample_weight=None):
    r"""Return Proposition 2's bound of how far affine transport can land from the target.

    .. math:: W_2(T X, Y) \le \sqrt{2 \operatorname{tr} \Sigma(Y)}

    for the affine transport :math:`T` from any law :math:`X` to :math:`Y`. It is the scale of the affinity
    score.

    Parameters
    ----------
    y : array-like of shape (n_target, n_features)
        Target rows.
    sample_weight : array-like of shape (n_target,), default=None
        Weights of the rows.

    Returns
    -------
    float
        In the unit that the columns share.

    Raises
    ------
    ValueError
        If the array is not two-dimensional and finite.

    Notes
    -----
    *When it lies.* It holds where the means and covariances of :math:`T X` and :math:`Y` agree: for the rows
    that the map was fitted to, or for populations. Held-out rows can be further away.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Proposition 2.

    Examples
    --------
    >>> affine_error_bound([[-1.0, 0.0], [1.0, 2.0]])
    2.0
    """
    return normal_approximation_bound(y, sample_weight=sample_weight)


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


def _two_moments(X, y, sample_weight):
    X, y = two_samples(X, y, "X")
    x_weight, y_weight = two_weights(sample_weight, len(X), len(y))
    return row_moments(X, x_weight), row_moments(y, y_weight)
