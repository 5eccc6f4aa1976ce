"""Transport of some columns given the others, as an estimator."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator

from skat._compat import StrOptions, column_indices
from skat.gaussian import AffineMap, Moments
from skat.gaussian.arrays import AnyArray, Floats
from skat.transport.moment_transport import MomentTransport, Solution
from skat.transport.regression import conditional_map, conditional_map_back

__all__ = ["ConditionalAffineTransport"]


class ConditionalAffineTransport(MomentTransport):
    r"""Carry some columns over given the others, which both domains share by construction.

    Each domain's other columns are regressed on the context, :math:`z \mid c \sim (m + B c, D)`, and the
    residual is transported:

    .. math:: (c, z) \mapsto \bigl(c,\; m_t + B_t c + A(D_s, D_t)\,(z - m_s - B_s c)\bigr)

    For a simulation of a robot the context is (state, action) and the rest the next state. It needs no
    pairs. Between normal distributions of equal context it is the block-triangular (Knothe-Rosenblatt) map.

    Parameters
    ----------
    context : int, str, slice, list, array of bool or callable
        An int k: the first k columns (not the k-th, as in `~sklearn.compose.ColumnTransformer`). Anything
        else selects columns as there: positions or names in a list, one name, a slice, a mask, or a callable of `X`
        as of `~sklearn.compose.make_column_selector`.
    covariance : {"empirical", "shrunk"} or estimator, default="empirical"
        As for `AffineTransport`, for all columns together. Where the context determines the rest almost
        exactly, the regression needs no shrinkage and is worse off with it.
    mean : {"empirical", "shrunk"}, default="empirical"
        As for `AffineTransport`.
    metric_scale : None, "target" or array-like of shape (n_features,), default=None
        As for `AffineTransport`.
    shrinkage : {"source"} or None, default=None
        ``"source"``, for few target rows: the target's slope is the source's plus a ridge correction, whose
        penalty for each column generalised cross-validation chooses, and the covariance of its residuals is
        drawn towards the source's as by ``covariance="shrunk"``. Only with ``covariance="empirical"``.

    rank_deficient : {"raise", "reach"}, default="reach"
        As for `AffineTransport`. Here the default is to reach, because a simulator that is linear and free of noise
        leaves no residual to carry, and the target's mean given the context is then all that a map can give.
    outside, unlabelled, source_domain
        As for `AffineTransport`.

    Attributes
    ----------
    coef_, intercept_, source_mean_, target_mean_, source_covariance_, target_covariance_
        As for `AffineTransport`; the target's mean and covariance are reached exactly where the contexts have
        the same.
    wasserstein_distance_, rank_, unreached_, shrinkage_, mean_shrinkage_, n_features_in_, feature_names_in_
        As for `AffineTransport`.

    Examples
    --------
    >>> from skat import ConditionalAffineTransport
    >>> simulated = np.array([[0.0, 0.0], [0.0, 2.0], [1.0, 3.0], [1.0, 5.0]])
    >>> measured = np.array([[0.0, 1.0], [0.0, 2.0], [1.0, 1.0], [1.0, 2.0]])
    >>> ConditionalAffineTransport(context=1).fit(simulated, measured).transform([[1.0, 4.0]]).round(12)
    array([[1. , 1.5]])
    """

    _parameter_constraints = {
        **MomentTransport._parameter_constraints,
        "context": "no_validation",
        "shrinkage": [None, StrOptions({"source"})],
    }

    def __init__(
        self,
        *,
        context: object,
        covariance: str | BaseEstimator = "empirical",
        mean: str = "empirical",
        metric_scale: str | ArrayLike | None = None,
        shrinkage: str | None = None,
        rank_deficient: str = "reach",
        outside: str = "ignore",
        unlabelled: str = "raise",
        source_domain: object = None,
    ) -> None:
        super().__init__(
            covariance=covariance,
            mean=mean,
            metric_scale=metric_scale,
            rank_deficient=rank_deficient,
            outside=outside,
            unlabelled=unlabelled,
            source_domain=source_domain,
        )
        self.context = context
        self.shrinkage = shrinkage

    def _check_parameters(self) -> None:
        super()._check_parameters()
        if self.shrinkage == "source" and self.covariance != "empirical":
            raise ValueError(
                'shrinkage="source" draws slope and residuals towards the source by itself; with '
                f'covariance={self.covariance!r} they would be drawn twice. Use covariance="empirical".'
            )

    def _see_columns(self, X: AnyArray, rows: AnyArray) -> None:
        """Resolve the context while the container with its names is at hand."""
        context = self.context(X) if callable(self.context) else self.context
        n_features = rows.shape[1]
        chosen = np.zeros(n_features, dtype=bool)
        if isinstance(context, int | np.integer) and not isinstance(context, bool | np.bool_):
            if not 0 < context < n_features:
                raise ValueError(
                    f"context={context} means the first {context} columns; it must be at least 1 and less "
                    "than the "
                    f"number of columns, n_features = {n_features}."
                )
            chosen[:context] = True
        else:
            columns = X._meta if hasattr(X, "_meta") and hasattr(X, "columns") else X
            try:
                chosen[column_indices(columns if hasattr(columns, "columns") else rows, context)] = True
            except (TypeError, ValueError) as error:
                there = (
                    f" There are: {', '.join(map(str, columns.columns))}."
                    if hasattr(columns, "columns")
                    else ""
                )
                raise ValueError(
                    "context must be a number of leading columns, or columns by number, name or mask; it is "
                    f"{context!r}: {error}{there}"
                ) from error
        if not 0 < chosen.sum() < n_features:
            raise ValueError(
                f"context must leave some columns to transport and name some that are not; {context!r} names "
                f"{chosen.sum()} of {n_features} columns. Without context, use AffineTransport."
            )
        self._context = tuple(chosen.tolist())

    def _solve(self, source: Moments, target: Moments, scale: Floats) -> Solution:
        return Solution(*conditional_map(source, target, **self._options))

    def _solve_back(self, source: Moments, target: Moments, scale: Floats) -> AffineMap:
        return conditional_map_back(source, target, **self._options)

    @property
    def _options(self) -> dict[str, Any]:
        return {"context": np.array(self._context), "shrinkage": self.shrinkage, "reach": self._reaches}
