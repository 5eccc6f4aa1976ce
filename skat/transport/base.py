"""What all transports share: whose rows are whose, whether they can be used, and the interface."""

from dataclasses import dataclass
from typing import NoReturn, Self

import numpy as np
from sklearn.base import BaseEstimator, OneToOneFeatureMixin, TransformerMixin
from sklearn.utils import Tags, assert_all_finite, check_array
from sklearn.utils.validation import check_is_fitted, validate_data

from skat._compat import (
    StrOptions,
    check_feature_names,
    check_n_features,
    check_same_namespace,
    check_sample_weight,
    feature_names,
    get_namespace_and_device,
    is_numpy_namespace,
    supported_float_dtypes,
)
from skat.gaussian.arrays import AnyArray, Places
from skat.gaussian.backends import is_dask, on_host
from skat.metrics.affinity import affinity_at_any_size
from skat.metrics.domains import domain_signs, some_of
from skat.metrics.samples import weight_of_each_side

__all__ = [
    "BaseTransport",
    "Samples",
    "checked_weight",
    "is_flat",
    "named",
    "rows_at",
    "same_length",
    "weight_of_pairs",
]


@dataclass(frozen=True, eq=False)
class Samples:
    """The rows of the two domains with their weights.

    Attributes
    ----------
    source, target : array of shape (n_rows, n_features) or None
        Rows; None where only the other side was given.
    source_weight, target_weight : ndarray of shape (n_rows,) or None
        Weights; None is uniform.
    stacked : bool
        Whether both came as one array.
    """

    source: AnyArray
    target: AnyArray
    source_weight: AnyArray = None
    target_weight: AnyArray = None
    stacked: bool = False


class BaseTransport(OneToOneFeatureMixin, TransformerMixin, BaseEstimator):
    """Carry rows of a source domain onto a target domain.

    A subclass implements ``_fit(samples)``, ``_carry(X, keep=None)`` and ``_carry_back(X)``.
    """

    _array_api = False
    _parameter_constraints = {
        "unlabelled": [StrOptions({"raise", "source", "target"})],
        "source_domain": "no_validation",
    }

    def __init__(self, *, unlabelled: str = "raise", source_domain: object = None) -> None:
        self.unlabelled = unlabelled
        self.source_domain = source_domain

    # The domain has to reach every step that tells source rows from target rows, so it is asked for by
    # default.
    __metadata_request__fit = {"sample_domain": True}
    __metadata_request__partial_fit = {"sample_domain": True}
    __metadata_request__transform = {"sample_domain": True}
    __metadata_request__score = {"sample_domain": True}

    def fit(
        self,
        X: AnyArray,
        y: AnyArray | None = None,
        sample_weight: AnyArray | None = None,
        sample_domain: AnyArray | None = None,
    ) -> Self:
        """Learn the map from source rows to target rows.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Source rows; or the rows of both domains, stacked, with `sample_domain`.
        y : array-like of shape (n_target_samples, n_features)
            Target rows, of the same columns as `X`; ignored with `sample_domain`.
        sample_weight : array-like of shape (n_samples,) or tuple of two, default=None
            One weight per row of `X` and the row of `y` beside it; a tuple (source, target) gives each side
            its own, and either may be None. With `sample_domain`, one weight per stacked row. A weight counts
            as so many repetitions of its row, except with ``covariance="shrunk"``, ``mean="shrunk"`` and
            ``shrinkage="source"``, where the effective number of rows (Kish), which does not change if all weights
            are doubled, sets the shrinkage.
        sample_domain : array-like of shape (n_samples,), default=None
            Which rows of a stacked `X` are source and which are target rows: numbers, positive and negative;
            the words "sim" and "real"; or labels of any kind, with the parameter `source_domain`.

        Returns
        -------
        self : object
            The fitted transport.

        Raises
        ------
        ValueError
            If the target is missing, if rows are too few or not finite, if columns differ, or if no map of
            the required kind exists.
        """
        self._validate_params()
        self._forget()
        samples = self._samples(X, y, sample_weight, sample_domain, reset=True)
        for rows, name in ((samples.source, "source"), (samples.target, "target")):
            if not is_dask(rows) and rows.shape[0] < 2:
                self._refuse_few_rows(rows.shape[0], name)
        self._stacked = sample_domain is not None
        self._fit(samples)
        return self

    def fit_transform(
        self,
        X: AnyArray,
        y: AnyArray | None = None,
        sample_weight: AnyArray | None = None,
        sample_domain: AnyArray | None = None,
    ) -> AnyArray:
        """Fit, and return the rows of `X` with its source rows carried over.

        Parameters
        ----------
        X, y, sample_weight, sample_domain
            As for `fit`.

        Returns
        -------
        array of shape (n_samples, n_features)
            Target rows of a stacked `X` are returned unchanged.
        """
        given = {"sample_weight": sample_weight, "sample_domain": sample_domain}
        self.fit(X, y, **{name: value for name, value in given.items() if value is not None})
        return self.transform(X, **({} if sample_domain is None else {"sample_domain": sample_domain}))

    def transform(self, X: AnyArray, sample_domain: AnyArray | None = None) -> AnyArray:
        """Carry source rows over.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Rows.
        sample_domain : array-like of shape (n_samples,), default=None
            As for `fit`; target rows are returned unchanged. None means that all are source rows or, after a
            stacked fit, what the parameter `unlabelled` says.

        Returns
        -------
        array of shape (n_samples, n_features)
            Float32 for float32, float64 otherwise; lazy for dask.

        Raises
        ------
        ValueError
            If rows are not finite, have other columns than at fit, or if `sample_domain` is missing.
        """
        self._check_is_fitted()
        if sample_domain is None and self._stacked and self.unlabelled == "raise":
            raise ValueError(
                f"this {type(self).__name__} was fitted to stacked rows, so transform cannot tell which rows "
                "of X are "
                "source rows. Pass sample_domain=... (positive: source row, carried over; negative: target "
                "row, "
                "returned unchanged), or fit it with two arrays, fit(X_source, X_target), after which every "
                "row is a "
                'source row, or say once for all what rows without a domain are: unlabelled="target" or "source".'
            )
        X = self._rows(X, "X", reset=False)
        if hasattr(self, "coef_") and not is_dask(X):
            check_same_namespace(X, self, attribute="coef_", method="transform")
        if sample_domain is None:
            if self._stacked and self.unlabelled == "target":
                if is_dask(X):
                    return X
                return self._carry(X, keep=np.ones(X.shape[0], dtype=bool))
            return self._carry(X)
        return self._carry(X, keep=self._domain(sample_domain, X) < 0)

    def inverse_transform(self, X: AnyArray) -> AnyArray:
        """Carry target rows back.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Target rows.

        Returns
        -------
        array of shape (n_samples, n_features)
            Rows of the source domain.

        Raises
        ------
        ValueError
            If the map has no inverse.
        """
        self._check_is_fitted()
        return self._carry_back(self._rows(X, "X", reset=False))

    def score(
        self,
        X: AnyArray,
        y: AnyArray | None = None,
        sample_weight: AnyArray | None = None,
        sample_domain: AnyArray | None = None,
    ) -> float:
        r"""Return the affinity of the carried source rows and the target rows.

        .. math:: \rho = 1 - \frac{W_2(T X, Y)}{\sqrt{2 \operatorname{tr} \Sigma(Y)}}

        It is not clipped: on rows that were not fitted it may be negative. Time grows with the cube of the
        number of rows and memory with its square. Where that would be more than 8 GB, beyond 31,600 rows of
        each, it is the score of `~skat.metrics.affinity_estimate` (with ``random_state=0``) instead, an estimate of
        what infinitely many rows would score and so not to be compared with scores of fewer rows.

        Parameters
        ----------
        X, y, sample_weight, sample_domain
            As for `fit`.

        Returns
        -------
        float
            At most one.
        """
        self._check_is_fitted()
        samples = self._samples(X, y, sample_weight, sample_domain, reset=False)
        carried, target = (on_host(rows) for rows in (self._carry(samples.source), samples.target))
        weights = {"x_weight": samples.source_weight, "y_weight": samples.target_weight}
        return affinity_at_any_size(carried, target, **weights)

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = True
        tags.target_tags.two_d_labels = True
        tags.array_api_support = self._array_api
        tags.transformer_tags.preserves_dtype = ["float64", "float32"]
        return tags

    def _check_is_fitted(self) -> None:
        check_is_fitted(self, "wasserstein_distance_")

    def _forget(self) -> None:
        """Drop what an earlier fit has found, so that nothing of it is left where another one fails."""
        for name in list(vars(self)):
            if name.endswith("_") and name not in ("n_features_in_", "feature_names_in_"):
                delattr(self, name)

    def _see_columns(self, X: AnyArray, rows: AnyArray) -> None:
        """Look at the container as given, while its column names are at hand."""

    def _refuse_few_rows(self, n_rows: int, name: str) -> NoReturn:
        raise ValueError(
            f"{type(self).__name__} needs at least 2 rows of each domain to see them vary; the {name} has "
            f"{n_rows} sample(s), n_samples = {n_rows}. Give more rows."
        )

    def _samples(
        self,
        X: AnyArray,
        y: AnyArray | None,
        sample_weight: AnyArray | None,
        sample_domain: AnyArray | None,
        *,
        reset: bool,
        either: bool = False,
    ) -> Samples:
        """Return the rows of both domains, validated but for being finite."""
        if sample_domain is not None:
            rows = self._rows(X, "X", reset=reset)
            if reset:
                self._see_columns(X, rows)
            return self._split(rows, sample_weight, sample_domain, either=either)
        if y is None:
            raise ValueError(
                f"This {type(self).__name__} estimator requires y to be passed, but the target y is None. "
                "Give the "
                "target rows either as an array of their own, fit(X_source, X_target), or stacked with the "
                "source "
                "rows, fit(X, sample_domain=d) with d positive for source rows and negative for target rows."
            )
        source = self._rows(X, "X", reset=reset)
        if is_flat(y):
            self._refuse_flat_target(y, source, sample_weight)
        if reset:
            self._see_columns(X, source)
        target = self._target(y)
        return self._weighted(source, target, sample_weight)

    def _weighted(
        self, source: AnyArray | None, target: AnyArray | None, sample_weight: AnyArray | None
    ) -> Samples:
        """Return samples with their weights; either side may be None."""
        if not isinstance(sample_weight, tuple) and sample_weight is not None:
            if source is not None and target is not None and not same_length(source, target):
                raise ValueError(
                    f"one array of weights is for rows side by side, but there are {source.shape[0]} source "
                    "rows and "
                    f"{target.shape[0]} target rows. Give a tuple, sample_weight=(source_weight, "
                    "target_weight)."
                )
            sample_weight = (sample_weight, sample_weight)
        source_weight, target_weight = (
            (None, None) if sample_weight is None else weight_of_each_side(sample_weight)
        )
        return Samples(
            source, target, checked_weight(source_weight, source), checked_weight(target_weight, target)
        )

    def _split(
        self, X: AnyArray, sample_weight: AnyArray | None, sample_domain: AnyArray | None, *, either: bool
    ) -> Samples:
        """Return the samples of stacked rows."""
        domain = self._domain(sample_domain, X)
        weight = checked_weight(sample_weight, X)
        if is_dask(X):
            one = 1.0 if weight is None else weight
            return Samples(X, X, (domain > 0) * one, (domain < 0) * one, stacked=True)
        parts: list[AnyArray | None] = []
        weights: list[AnyArray | None] = []
        for name, mask in (("source (positive)", domain > 0), ("target (negative)", domain < 0)):
            if not mask.any() and not either:
                by = (
                    ""
                    if self.source_domain is None
                    else f" by source_domain={self.source_domain!r}; the labels are {some_of(sample_domain)}"
                )
                raise ValueError(
                    f"sample_domain marks none of the {len(domain)} rows as {name}{by}. Give rows of both "
                    "domains, or two arrays, fit(X_source, X_target)."
                )
            parts.append(rows_at(X, np.flatnonzero(mask)) if mask.any() else None)
            weights.append(None if weight is None else weight[mask])
        source, target = parts
        return Samples(source, target, weights[0], weights[1], stacked=True)

    def _domain(self, sample_domain: AnyArray, X: AnyArray) -> AnyArray:
        """Return a number for each row, positive for source rows and negative for target rows."""
        if is_dask(sample_domain):
            if self.source_domain is not None:
                raise ValueError("with dask give numbers, positive for source rows, and no source_domain.")
            return sample_domain
        n_rows = None if is_dask(X) else X.shape[0]
        return domain_signs(on_host(sample_domain), n_rows, self.source_domain)

    def _refuse_flat_target(
        self, y: AnyArray, source: AnyArray | None = None, sample_weight: AnyArray | None = None
    ) -> NoReturn:
        """Raise for a y of one dimension; but first for what is wrong with the source, if anything is."""
        if source is not None and not is_dask(source):
            if source.shape[0] < 2:
                self._refuse_few_rows(source.shape[0], "source")
            assert_all_finite(source, estimator_name=type(self).__name__, input_name="X")
            if not isinstance(sample_weight, tuple):
                checked_weight(sample_weight, source)
        columns = "" if source is None else f", n_features = {source.shape[1]}"
        shape = tuple(y.shape if hasattr(y, "shape") else np.asarray(y).shape)
        raise ValueError(
            f"{type(self).__name__} needs target rows: y must be 2-D with the columns of X{columns}; it is 1-D, of "
            f"shape {shape}. If these are labels and X holds both domains, pass sample_domain=... too."
        )

    def _target(self, y: AnyArray) -> AnyArray:
        if is_flat(y):
            self._refuse_flat_target(y)
        self._check_target_names(y)
        y = self._rows(y, "y", reset=None)
        if y.shape[1] != self.n_features_in_:
            raise ValueError(
                f"X and y must have the same columns; X has {self.n_features_in_} features, y has "
                f"{y.shape[1]}."
            )
        return y

    def _check_target_names(self, y: AnyArray) -> None:
        ours = getattr(self, "feature_names_in_", None)
        names = feature_names(y._meta if is_dask(y) and hasattr(y, "_meta") else y)
        if ours is None or names is None or list(ours) == list(names):
            return
        if set(ours) == set(names):
            raise ValueError(
                f"the columns of y must be in the order of those of X; X has {list(ours)}, y has "
                f"{list(names)}. "
                "Give y[X.columns]."
            )
        raise ValueError(
            f"y must have the columns of X; missing: {sorted(set(ours) - set(names))}, "
            f"unexpected: {sorted(set(names) - set(ours))}."
        )

    def _rows(self, X: AnyArray, name: str, *, reset: bool | None) -> AnyArray:
        """Return rows as 2-D floats, whether finite or not; `reset` None leaves the features alone."""
        if is_dask(X):
            return self._dask_rows(X, name, reset=reset)
        xp, _, device = get_namespace_and_device(X)
        options = {"dtype": supported_float_dtypes(xp, device), "ensure_all_finite": False}
        if reset is None:
            return check_array(X, input_name=name, estimator=self, **options)
        return validate_data(self, X, reset=reset, **options)

    def _dask_rows(self, X: AnyArray, name: str, *, reset: bool | None) -> AnyArray:
        if X.ndim != 2:
            raise ValueError(f"{name} must be 2-D; it is a dask {type(X).__name__} of {X.ndim} dimensions.")
        if reset is not None:
            meta = X._meta if not hasattr(X, "chunks") else np.empty((1, X.shape[1]))
            check_feature_names(self, meta, reset=reset)
            check_n_features(self, np.empty((1, X.shape[1])), reset=reset)
        return X

    def _refuse_infinite(self, *named_rows: tuple[AnyArray, str]) -> NoReturn:
        """Raise on NaN or infinity in rows, given as (rows, name), or say that their squares overflow."""
        for rows, name in named_rows:
            if rows is not None and not is_dask(rows):
                assert_all_finite(rows, estimator_name=type(self).__name__, input_name=name)
        names = " or ".join(dict.fromkeys(name for rows, name in named_rows if rows is not None))
        if any(is_dask(rows) for rows, _ in named_rows):
            raise ValueError(
                f"Input {names} contains NaN or infinity, or values whose squares exceed the range of "
                "float64. Drop or fill those rows."
            )
        raise ValueError(f"the squares of {names} exceed the range of float64. Choose larger units.")


def is_flat(y: AnyArray) -> bool:
    """Whether a target is of one dimension, as labels are."""
    shape = y.shape if hasattr(y, "shape") else np.asarray(y).shape
    return len(shape) == 1


def same_length(source: AnyArray, target: AnyArray) -> bool:
    """Whether two sets of rows are of one number, or may be: dask does not always know."""
    lengths = (source.shape[0], target.shape[0])
    return not all(isinstance(length, int | np.integer) for length in lengths) or lengths[0] == lengths[1]


def rows_at(X: AnyArray, places: Places) -> AnyArray:
    """Return rows by their numbers, in whichever library they are."""
    xp, _, device = get_namespace_and_device(X)
    return X[places] if is_numpy_namespace(xp) else xp.take(X, xp.asarray(places, device=device), axis=0)


def weight_of_pairs(samples: Samples) -> AnyArray | None:
    """Return the weights of rows in pairs, which both sides share."""
    if not np.array_equal(samples.source_weight, samples.target_weight):
        raise ValueError("a pair has one weight: give one array of weights, not two that differ.")
    return samples.source_weight


def named(rows: AnyArray, like: AnyArray) -> AnyArray:
    """Return rows in a data frame with the columns of another, or as they are where that is no data frame."""
    return type(like)(dict(zip(like.columns, rows.T))) if hasattr(like, "columns") else rows


def checked_weight(weight: AnyArray | None, rows: AnyArray | None) -> AnyArray | None:
    """Return weights as a float array in NumPy (or lazily, for dask), or None."""
    if weight is None or rows is None or is_dask(weight):
        return weight
    if is_dask(rows):
        return np.asarray(weight, dtype=np.float64)
    if np.isscalar(weight):
        weight = np.full(rows.shape[0], weight, dtype=np.float64)
    return check_sample_weight(
        on_host(weight), np.empty((rows.shape[0], 1)), ensure_non_negative=True, dtype=np.float64
    )
