"""The methods that the experiments compare: transports, and the regressions that would do without them."""

import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin, clone
from sklearn.linear_model import LinearRegression, RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.validation import check_is_fitted, validate_data

from skat import (
    CORAL,
    AffineTransport,
    ConditionalAffineTransport,
    ExactTransport,
    IdentityTransport,
    ProcrustesAffineTransport,
    ResidualTransport,
)
from skat.transport import KernelAlignment

RIDGE_PENALTIES = np.logspace(-3, 5, 17)


@dataclass(frozen=True)
class Method:
    """A way to carry source rows onto target rows.

    Attributes
    ----------
    name : str
    make : callable
        ``make(n_context)`` returns an estimator with ``fit(X, y)`` and ``transform(X)`` for rows whose first
        `n_context` columns are the context: state and action, or the strike.
    disjoint : bool
        Whether it is fitted without pairs: to one half of the source rows, the other half of the target rows.
    slow : bool
        Whether one repeat has to do.
    """

    name: str
    make: Callable[..., Any]
    disjoint: bool = False
    slow: bool = False


class RegressionTransport(TransformerMixin, BaseEstimator):
    """Carry rows (context, outcome) by a regression of the target's outcome, the context left as it is.

    Parameters
    ----------
    regressor : regressor
        Of many outputs.
    context : int
        Number of leading columns that are context.
    predictors : {"row", "context"}, default="row"
        What it regresses on: the whole source row; or the context alone, which does without the simulation.
    residual : bool, default=False
        Whether it predicts what is missing from the source's outcome instead of the outcome itself.

    Attributes
    ----------
    regressor_ : regressor
        Fitted.
    """

    def __init__(
        self, regressor: Any, *, context: Any, predictors: str = "row", residual: bool = False
    ) -> None:
        self.regressor = regressor
        self.context = context
        self.predictors = predictors
        self.residual = residual

    def fit(self, X: Any, y: Any) -> "RegressionTransport":
        """Fit the regression to pairs of rows.

        Parameters
        ----------
        X, y : array-like of shape (n_rows, n_features)
            Source rows and the target row of each.

        Returns
        -------
        RegressionTransport
        """
        X, y = validate_data(self, X, y, multi_output=True, y_numeric=True)
        outcome = y[:, self.context :] - (X[:, self.context :] if self.residual else 0.0)
        self.regressor_ = clone(self.regressor).fit(self._predictors(X), outcome)
        return self

    def transform(self, X: Any) -> Any:
        """Replace the outcome in each source row by the predicted one of the target.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_features)

        Returns
        -------
        ndarray of shape (n_rows, n_features)
        """
        check_is_fitted(self)
        X = validate_data(self, X, reset=False)
        outcome = self.regressor_.predict(self._predictors(X)) + (
            X[:, self.context :] if self.residual else 0.0
        )
        return np.hstack([X[:, : self.context], outcome])

    def _predictors(self, X: Any) -> Any:
        return X[:, : self.context] if self.predictors == "context" else X


def _ridge_on_residual(context: Any) -> Any:
    ridge = make_pipeline(StandardScaler(), RidgeCV(RIDGE_PENALTIES))
    return RegressionTransport(ridge, context=context, residual=True)


def _shrunk(transport: Any, **parameters: Any) -> Any:
    return lambda context: transport(covariance="shrunk", **parameters)


def _in_units_of_target(method: Any) -> Any:
    """Return the method with ``metric_scale="target"``, or None where it knows no units."""
    if not {"metric_scale", "transport__metric_scale"} & set(method.make(1).get_params()):
        return None

    def make(context: Any) -> Any:
        transport = method.make(context)
        name = "metric_scale" if hasattr(transport, "metric_scale") else "transport__metric_scale"
        return transport.set_params(**{name: "target"})

    return replace(method, name=f"{method.name}_scaled", make=make)


RAW_METHODS = (
    Method("none", lambda context: IdentityTransport()),
    Method("affine", lambda context: AffineTransport()),
    Method("affine_shrunk", _shrunk(AffineTransport)),
    Method("procrustes_raw", lambda context: ProcrustesAffineTransport(alignment="raw")),
    Method("procrustes_whitened", lambda context: ProcrustesAffineTransport(alignment="whitened")),
    Method("procrustes_whitened_shrunk", _shrunk(ProcrustesAffineTransport, alignment="whitened")),
    Method("conditional", lambda context: ConditionalAffineTransport(context=context)),
    Method(
        "conditional_disjoint", lambda context: ConditionalAffineTransport(context=context), disjoint=True
    ),
    Method(
        "conditional_disjoint_shrunk",
        lambda context: ConditionalAffineTransport(context=context, covariance="shrunk"),
        disjoint=True,
    ),
    Method(
        "conditional_disjoint_to_source",
        lambda context: ConditionalAffineTransport(context=context, shrinkage="source"),
        disjoint=True,
    ),
    Method("residual", lambda context: ResidualTransport(ProcrustesAffineTransport())),
    Method("kernel_alignment", lambda context: KernelAlignment(random_state=0)),
    Method("coral", lambda context: CORAL()),
    Method("exact_transport", lambda context: ExactTransport(), slow=True),
    Method("least_squares", lambda context: RegressionTransport(LinearRegression(), context=context)),
    Method("ridge_on_residual", _ridge_on_residual),
    Method(
        "target_only",
        lambda context: RegressionTransport(LinearRegression(), context=context, predictors="context"),
    ),
)
METHODS = {
    method.name: method
    for raw in RAW_METHODS
    for method in (raw, _in_units_of_target(raw))
    if method is not None
}
DIAGNOSIS = "diagnosis"


def chosen_methods(
    methods: Iterable[str] | Mapping[str, object] | None, default: Iterable[str]
) -> dict[str, Any]:
    """Return the methods to compare by name, a `Method` for each; None for the diagnosis.

    Parameters
    ----------
    methods : iterable of str, mapping of str to transport, or None
        Names; or transports of your own by the names that the table shall give them; None for the default.
    default : iterable of str

    Returns
    -------
    dict of str to Method or None

    Raises
    ------
    ValueError
        If there is no method of that name.
    """
    if isinstance(methods, str):
        raise ValueError(f"methods must be a list of names; it is {methods!r}. Give [{methods!r}].")
    chosen: dict[str, Method | None] = {}
    for name in default if methods is None else methods:
        own = methods[name] if isinstance(methods, Mapping) else None
        if own is not None:
            chosen[name] = Method(name, lambda context, own=own: clone(own))
        elif name == DIAGNOSIS:
            chosen[name] = None
        elif name in METHODS:
            chosen[name] = METHODS[name]
        else:
            raise ValueError(f"unknown method {name!r}. There are: {', '.join((*METHODS, DIAGNOSIS))}")
    if not chosen:
        raise ValueError(f"no methods to compare; there are: {', '.join((*METHODS, DIAGNOSIS))}")
    return chosen


def of_repeat(chosen: Mapping[str, Method | None], repeat: int) -> dict[str, Any]:
    """Return the methods that run in a repeat: all in the first, those that are not slow in the others."""
    return {name: method for name, method in chosen.items() if not repeat or (method and not method.slow)}


def fitted_transport(method: Any, source_rows: Any, target_rows: Any, context: Any) -> Any:
    """Return the method's transport, fitted to all rows, or to half of the target's and none of their partners.

    Parameters
    ----------
    method : Method
    source_rows, target_rows : ndarray of shape (n_rows, n_features)
        In pairs, as far as there are as many of both.
    context : int
        Number of leading columns that are context.

    Returns
    -------
    estimator
    """
    if method.disjoint:
        middle = len(target_rows) // 2
        source_rows = np.delete(source_rows, slice(middle, len(target_rows)), axis=0)
        target_rows = target_rows[middle:]
    with warnings.catch_warnings():
        # That few rows are few is what the tables show.
        warnings.simplefilter("ignore", UserWarning)
        return method.make(context).fit(source_rows, target_rows)
