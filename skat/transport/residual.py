"""A regression of what a transport leaves, with a weight that falls to zero where it does not help."""

import warnings
from typing import Self

import numpy as np
from scipy.linalg import solve
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.utils.validation import has_fit_parameter

from skat._compat import HasMethods, safe_indexing
from skat.gaussian.arrays import AnyArray, Flags, Floats, Places
from skat.gaussian.backends import is_dask, on_host
from skat.transport.base import BaseTransport, Samples, named, same_length, weight_of_pairs
from skat.transport.procrustes import ProcrustesAffineTransport

__all__ = ["KernelRidgeCV", "ResidualTransport"]

# Inverse squared lengths of standardised rows times the number of columns, and penalties.
GAMMAS, PENALTIES = np.array([0.05, 0.25, 1.0, 4.0]), (1e-3, 1e-2, 1e-1, 1.0)
FEWEST_TO_CHOOSE, FIRST_GUESS = 12, (2, 3)


class ResidualTransport(BaseTransport):
    r"""Carry rows by a transport, and correct them by a regression of what it leaves.

    .. math:: T(x) = T_0(x) + w \odot g(x)

    with :math:`T_0` the transport and :math:`g` a regression of :math:`y - T_0(x)` on the source row, over rows in
    pairs. Both are cross-fitted: each row's residual comes from a transport, and each row's prediction from a
    regression, that has not seen the row. The weight of column j is the one of least expected squared error on
    those predictions, drawn to zero by as much as it is uncertain (positive part of James and Stein),

    .. math:: w_j = \Bigl[\hat w_j - \frac{s_j^2}{\hat w_j}\Bigr]_0^1, \qquad
              \hat w_j = \frac{\langle r_j, g_j \rangle}{\langle g_j, g_j \rangle},

    with :math:`s_j` the standard error of :math:`\hat w_j`. A regression that does not help is left out.

    Parameters
    ----------
    transport : transport, default=None
        Fitted to the pairs. None is ``ProcrustesAffineTransport()``.
    regressor : regressor, default=None
        Of many outputs, with ``fit(X, y)`` and ``predict(X)``; it sees source rows, and residuals in standard
        deviations of the target. None is a kernel ridge regression on standardised rows, whose length and penalty
        two folds of consecutive rows choose. Its time grows with the cube of the number of rows and its memory with
        the square: beyond some 5,000 rows give another, as ``make_pipeline(StandardScaler(), Nystroem(), RidgeCV())``.
    cv : int or cross-validation splitter, default=3
        Folds of the cross-fitting, each pair left out once; pairs of no weight are in none. An int is of consecutive
        rows, so that neighbours in time stay together.
    unlabelled, source_domain
        As for `AffineTransport`.

    Attributes
    ----------
    transport_ : transport
        Fitted to all pairs.
    regressor_ : regressor or None
        Fitted to the cross-fitted residuals of all pairs; None where every weight is zero.
    weights_ : ndarray of shape (n_features,)
        Of each column's correction, from 0 to 1.
    wasserstein_distance_ : float
        Of `transport_`.
    n_features_in_, feature_names_in_
        As for `AffineTransport`.

    Notes
    -----
    The carried rows have the target's mean and covariance only as nearly as the regression is right, and the map
    has no inverse.

    Examples
    --------
    >>> import numpy as np
    >>> from skat import ResidualTransport
    >>> simulated = np.random.default_rng(0).normal(size=(200, 1))
    >>> measured = simulated + np.sin(2 * simulated)
    >>> carried = ResidualTransport().fit(simulated, measured).transform([[0.5]])
    >>> bool(abs(carried[0, 0] - 0.5 - np.sin(1.0)) < 0.02)
    True
    """

    _parameter_constraints = {
        **BaseTransport._parameter_constraints,
        "transport": [None, BaseTransport],
        "regressor": [None, HasMethods(["fit", "predict"])],
        "cv": ["cv_object"],
    }

    def __init__(
        self,
        transport: BaseTransport | None = None,
        regressor: BaseEstimator | None = None,
        *,
        cv: object = 3,
        unlabelled: str = "raise",
        source_domain: object = None,
    ) -> None:
        super().__init__(unlabelled=unlabelled, source_domain=source_domain)
        self.transport = transport
        self.regressor = regressor
        self.cv = cv

    def _see_columns(self, X: AnyArray, rows: AnyArray) -> None:
        """Keep the columns' names, for a transport that goes by them."""
        self._frame = None if is_dask(X) else named(np.empty((0, rows.shape[1])), X)

    def _fit(self, samples: Samples) -> None:
        from sklearn.model_selection import check_cv

        if is_dask(samples.source) or is_dask(samples.target):
            raise ValueError(
                "a regression needs all rows in memory. Compute them first, or fit a transport alone."
            )
        if not same_length(samples.source, samples.target):
            raise ValueError(
                f"{type(self).__name__} learns from pairs: row k of y belongs to row k of X; there are "
                f"{samples.source.shape[0]} source rows and {samples.target.shape[0]} target rows."
            )
        X, y = (np.asarray(on_host(rows), dtype=np.float64) for rows in (samples.source, samples.target))
        if not (np.isfinite(X).all() and np.isfinite(y).all()):
            self._refuse_infinite((X, "X"), (y, "X" if samples.stacked else "y"))
        weight = weight_of_pairs(samples)
        if weight is not None:
            # A fold without weight would be none.
            X, y, weight = (part[weight > 0] for part in (X, y, weight))
        transport = ProcrustesAffineTransport() if self.transport is None else self.transport
        regressor = KernelRidgeCV() if self.regressor is None else self.regressor
        source, target = named(X, self._frame), named(y, self._frame)
        self.transport_ = clone(transport).fit(source, target, **_given(weight))
        self.wasserstein_distance_ = self.transport_.wasserstein_distance_
        self._lengths = _deviations(y)
        residuals = np.empty(y.shape)
        splits = list(check_cv(self.cv).split(X))
        times = np.bincount(np.concatenate([left_out for _, left_out in splits]), minlength=len(X))
        if not np.array_equal(times, np.ones(len(X))):
            raise ValueError(
                f"cv has to leave each of the {len(X)} pairs of positive weight out once, as KFold does; {self.cv!r} "
                f"leaves {np.count_nonzero(times != 1)} out never or more often."
            )
        for kept, left_out in splits:
            pairs = safe_indexing(source, kept), safe_indexing(target, kept)
            fold = _fitted(transport, pairs[0], pairs[1], _part(weight, kept))
            carried = np.asarray(fold.transform(safe_indexing(source, left_out)))
            residuals[left_out] = (y[left_out] - carried) / self._lengths
        predictions = np.empty(y.shape)
        for kept, left_out in splits:
            fold = _fitted(regressor, X[kept], residuals[kept], _part(weight, kept))
            predictions[left_out] = _rows_of(fold.predict(X[left_out]), y.shape[1])
        self.weights_ = _weights(residuals, predictions, weight)
        self.regressor_ = None
        if self.weights_.any():
            self.regressor_ = _fitted(regressor, X, residuals, weight)

    def _carry(self, X: AnyArray, keep: AnyArray | None = None) -> AnyArray:
        rows = np.asarray(on_host(X), dtype=np.float64)
        if not np.isfinite(rows).all():
            self._refuse_infinite((rows, "X"))
        carried = rows.copy()
        moves = np.ones(len(rows), dtype=bool) if keep is None else ~np.asarray(keep, dtype=bool)
        if moves.any():
            carried[moves] = self._corrected(rows[moves])
        return carried.astype(np.float32 if on_host(X).dtype == np.float32 else np.float64)

    def _corrected(self, rows: Floats) -> Floats:
        carried = np.asarray(self.transport_.transform(named(rows, self._frame)))
        if self.regressor_ is None:
            return carried
        correction = _rows_of(self.regressor_.predict(rows), rows.shape[1])
        corrected: Floats = carried + self.weights_ * self._lengths * correction
        return corrected

    def support_distance(self, X: AnyArray) -> Floats:
        """Return how far rows are from the fitted ones, as of `transport_`."""
        self._check_is_fitted()
        distance: Floats = self.transport_.support_distance(X)
        return distance

    def in_support(self, X: AnyArray, *, level: float = 0.99) -> Flags:
        """Return which rows lie where the fitted ones do, as of `transport_`."""
        self._check_is_fitted()
        inside: Flags = self.transport_.in_support(X, level=level)
        return inside

    def _carry_back(self, X: AnyArray) -> AnyArray:
        raise np.linalg.LinAlgError(
            "a transport that a regression corrects has no inverse. Take that of transport_, or fit one with the "
            "two domains exchanged."
        )


class KernelRidgeCV(RegressorMixin, BaseEstimator):
    """Kernel ridge regression on standardised rows, whose length and penalty two folds choose.

    It is ``GridSearchCV`` over `~sklearn.kernel_ridge.KernelRidge` behind a scaler, at a third of its time: all lengths
    share the distances of a fold, and all penalties its kernel.

    Attributes
    ----------
    model_ : pipeline
        Of the length and the penalty chosen, fitted to all rows.
    """

    def fit(self, X: Floats, y: Floats, sample_weight: AnyArray | None = None) -> Self:
        """Fit the regression to rows of shape (n_rows, n_features) and as many outputs."""
        from sklearn.kernel_ridge import KernelRidge
        from sklearn.pipeline import make_pipeline
        from sklearn.preprocessing import StandardScaler

        gammas = GAMMAS / X.shape[1]
        gamma, alpha = gammas[FIRST_GUESS[0]], PENALTIES[FIRST_GUESS[1]]
        if len(X) >= FEWEST_TO_CHOOSE:
            weight = np.ones(len(X)) if sample_weight is None else np.asarray(sample_weight, dtype=np.float64)
            first, second = np.array_split(np.arange(len(X)), 2)
            errors = _errors_by_penalty(X, y, weight, second, first, gammas)
            errors += _errors_by_penalty(X, y, weight, first, second, gammas)
            best = np.unravel_index(np.argmin(errors), errors.shape)
            gamma, alpha = gammas[best[0]], PENALTIES[best[1]]
        # Whatever transforms return elsewhere, here it is arrays.
        scaler = StandardScaler().set_output(transform="default")
        self.model_ = make_pipeline(scaler, KernelRidge(kernel="rbf", gamma=gamma, alpha=alpha))
        names = [] if sample_weight is None else list(self.model_.named_steps)
        self.model_.fit(X, y, **{f"{name}__sample_weight": sample_weight for name in names})
        return self

    def predict(self, X: Floats) -> Floats:
        """Return the outputs of rows."""
        outputs: Floats = self.model_.predict(X)
        return outputs


def _errors_by_penalty(
    X: Floats, y: Floats, weight: Floats, train: Places, test: Places, gammas: Floats
) -> Floats:
    """Return the weighted mean squared error on the rows of one fold, by length and penalty."""
    from sklearn.metrics import euclidean_distances
    from sklearn.preprocessing import StandardScaler

    scaler = StandardScaler().fit(X[train], sample_weight=weight[train])
    rows, others = scaler.transform(X[train]), scaler.transform(X[test])
    within, across = (euclidean_distances(left, rows, squared=True) for left in (rows, others))
    root = np.sqrt(weight[train])
    errors = np.empty((len(gammas), len(PENALTIES)))
    for i, gamma in enumerate(gammas):
        kernel, to_predict = np.exp(-gamma * within), np.exp(-gamma * across) * root
        kernel *= root * root[:, np.newaxis]
        for j, alpha in enumerate(PENALTIES):
            penalised = kernel + alpha * np.eye(len(kernel))
            dual = solve(penalised, root[:, np.newaxis] * y[train], assume_a="pos", overwrite_a=True)
            missed = np.square(y[test] - to_predict @ dual).mean(axis=1)
            errors[i, j] = np.average(missed, weights=weight[test])
    return errors


def _weights(residuals: Floats, predictions: Floats, weight: Floats | None) -> Floats:
    """Return the weight of each column's prediction: of least squared error, less its own uncertainty."""
    weight = np.ones(len(residuals)) if weight is None else weight / weight.mean()
    product = weight @ (residuals * predictions)
    square = weight @ np.square(predictions)
    square = np.where(square > 0, square, 1.0)
    best = product / square
    noise = np.square(weight) @ np.square(predictions * (residuals - best * predictions)) / np.square(square)
    with np.errstate(divide="ignore", invalid="ignore"):
        drawn = np.where(best > 0, best - noise / best, 0.0)
    return np.clip(drawn, 0.0, 1.0)


def _fitted(estimator: BaseEstimator, X: Floats, y: Floats, weight: Floats | None) -> BaseEstimator:
    with warnings.catch_warnings():
        # The fit to all rows has said that they are few.
        warnings.filterwarnings("ignore", message=".*rows cannot show how", category=UserWarning)
        estimator = clone(estimator)
        if weight is not None and not has_fit_parameter(estimator, "sample_weight"):
            raise ValueError(
                f"{type(estimator).__name__} takes no sample_weight. Give a regressor that does, or no weights."
            )
        return estimator.fit(X, y, **_given(weight))


def _given(weight: Floats | None) -> dict[str, Floats]:
    return {} if weight is None else {"sample_weight": weight}


def _part(weight: Floats | None, rows: Places) -> Floats | None:
    return None if weight is None else weight[rows]


def _rows_of(predictions: AnyArray, n_features: int) -> Floats:
    return np.asarray(predictions, dtype=np.float64).reshape(-1, n_features)


def _deviations(rows: Floats) -> Floats:
    deviation = rows.std(axis=0)
    return np.where(deviation > 0, deviation, 1.0)
