"""Transports by an affine map that is a function of the two domains' moments."""

import warnings
from dataclasses import dataclass
from typing import Any, Literal, NoReturn, Self, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binom
from sklearn.base import BaseEstimator, clone
from sklearn.exceptions import NotFittedError
from sklearn.utils.validation import has_fit_parameter

from skat._compat import HasMethods, StrOptions
from skat.gaussian import AffineMap, Moments, covariance_root, distance_of_roots, root_of_moments, spectrum
from skat.gaussian.arrays import AnyArray, Flags, Floats, Places
from skat.gaussian.backends import apply_map, is_dask, moments_of, on_host, to_namespace
from skat.gaussian.maps import EPS
from skat.transport.base import BaseTransport, Samples, is_flat, rows_at
from skat.transport.shift import MOST_CALIBRATING_ROWS, Distances, Support
from skat.transport.shrinkage import mean_drawn_towards, shrunk_towards

__all__ = ["MomentTransport", "Solution"]

LEVEL, RARE = 0.99, 1e-3
# What has faded so far is gone, and zero weight would be no moments.
LEAST_FACTOR = 1e-100


@dataclass(frozen=True, eq=False)
class Solution:
    """A map that a transport has found, in units of the metric's scale.

    Attributes
    ----------
    affine : AffineMap
        The map.
    rank : int
        Rank of its linear part.
    unreached : float
        Share of the target's variance that the carried rows do not have, for the source does not vary there.
    """

    affine: AffineMap
    rank: int
    unreached: float = 0.0


class MomentTransport(BaseTransport):
    """A transport by an affine map that is a function of moments.

    A subclass implements ``_solve(source, target, scale)``, which returns a `Solution`, and
    ``_solve_back(source, target, scale)``, which returns the way back, in the same units.
    """

    _array_api = True
    _parameter_constraints = {
        **BaseTransport._parameter_constraints,
        "covariance": [StrOptions({"empirical", "shrunk"}), HasMethods("fit")],
        "mean": [StrOptions({"empirical", "shrunk"})],
        "metric_scale": [None, StrOptions({"target"}), "array-like"],
        "rank_deficient": [StrOptions({"raise", "reach"})],
        "outside": [StrOptions({"ignore", "warn", "raise"})],
    }
    _moments: Any = None
    _missing: str | None = None
    mean = "empirical"
    rank_deficient = "raise"
    outside = "ignore"
    _support: Support | None = None
    _distances: Distances | None = None
    _back: AffineMap | None = None
    _is_empirical = False

    def __init__(
        self,
        *,
        covariance: str | BaseEstimator = "empirical",
        mean: str = "empirical",
        metric_scale: str | ArrayLike | None = None,
        rank_deficient: str = "raise",
        outside: str = "ignore",
        unlabelled: str = "raise",
        source_domain: object = None,
    ) -> None:
        self.mean = mean
        self.outside = outside
        super().__init__(unlabelled=unlabelled, source_domain=source_domain)
        self.covariance = covariance
        self.metric_scale = metric_scale
        self.rank_deficient = rank_deficient

    @property
    def _reaches(self) -> bool:
        return self.rank_deficient == "reach"

    def partial_fit(
        self,
        X: AnyArray | None = None,
        y: AnyArray | None = None,
        sample_weight: AnyArray | None = None,
        sample_domain: AnyArray | None = None,
        half_life: float | None = None,
    ) -> Self:
        """Add rows of either domain, or of both.

        The map is the one that `fit` would find on all rows so far. It exists once both domains have rows and
        the source varies wherever the target does; until then `transform` says what is missing.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features), default=None
            More source rows; or rows of both domains, stacked, with `sample_domain`.
        y : array-like of shape (n_target_samples, n_features), default=None
            More target rows.
        sample_weight : array-like of shape (n_samples,) or tuple of two, default=None
            As for `fit`.
        sample_domain : array-like of shape (n_samples,), default=None
            As for `fit`.
        half_life : float, default=None
            For a world that changes: number of rows of a domain after which what came before counts half. None
            forgets nothing. A domain that gets no rows in a call forgets nothing, either.

        Returns
        -------
        self : object
            The transport.

        Raises
        ------
        ValueError
            As for `fit`; and with a covariance estimator, which needs all rows at once.
        """
        self._validate_params()
        self._check_parameters()
        if not isinstance(self.covariance, str):
            raise ValueError(
                f"partial_fit merges moments, which covariance={self.covariance!r} cannot use: it needs all "
                'rows at once. Use covariance="empirical" or "shrunk", or fit.'
            )
        if X is None and y is None:
            raise ValueError("partial_fit needs rows: source rows as X, target rows as y, or both.")
        first = self._moments is None
        samples = self._part(X, y, sample_weight, sample_domain, reset=first)
        collected = self._collect(samples)
        if half_life is not None and not 0 < half_life < np.inf:
            raise ValueError(f"half_life must be a positive number of rows; it is {half_life!r}.")
        earlier = (None,) * len(collected) if first else self._moments
        self._moments = tuple(_merged(old, new, half_life) for old, new in zip(earlier, collected))
        self._stacked = sample_domain is not None or (not first and self._stacked)
        self._learn_if_possible(_given(samples))
        if self._missing is None and samples.source is not None:
            self._calibrate(samples, self._distances)
        return self

    def _part(
        self,
        X: AnyArray | None,
        y: AnyArray | None,
        sample_weight: AnyArray | None,
        sample_domain: AnyArray | None,
        *,
        reset: bool,
    ) -> Samples:
        """Return validated samples of which either side may be missing."""
        if X is None:
            if is_flat(y):
                self._refuse_flat_target(y)
            target = self._rows(y, "y", reset=reset)
            if reset:
                self._see_columns(y, target)
            return self._weighted(None, target, sample_weight)
        if sample_domain is not None or y is not None:
            return self._samples(X, y, sample_weight, sample_domain, reset=reset, either=True)
        source = self._rows(X, "X", reset=reset)
        if reset:
            self._see_columns(X, source)
        return self._weighted(source, None, sample_weight)

    def _fit(self, samples: Samples) -> None:
        self._check_parameters()
        self._moments = self._collect(samples)
        source, target = self._sides()
        for side, name in ((source, "source"), (target, "target")):
            if side is None or side.n_rows < 2:
                self._refuse_few_rows(0 if side is None else side.n_rows, name)
        self._warns = True
        both = cast(tuple[Moments, Moments], (source, target))
        sides = both if isinstance(self.covariance, str) else self._estimated(samples)
        self._learn(sides, _given(samples))
        self._calibrate(samples, None)
        self._warn_of_few_rows()
        self._warn_of_unreached()

    def _check_parameters(self) -> None:
        """Look at what `_parameter_constraints` cannot say."""
        if isinstance(self.covariance, type):
            raise ValueError(
                "covariance must be an instance of a covariance estimator, not its class; give "
                f"{self.covariance.__name__}()."
            )

    def _sets_of_rows(self, samples: Samples) -> list[tuple[AnyArray | None, AnyArray | None]]:
        """Return the sets of rows, with weights, whose moments the map is a function of."""
        return [(samples.source, samples.source_weight), (samples.target, samples.target_weight)]

    def _collect(self, samples: Samples) -> tuple[Moments | None, ...]:
        moments = tuple(moments_of(self._sets_of_rows(samples)))
        if not all(part is None or part.is_finite for part in moments):
            self._refuse_infinite((samples.source, "X"), (samples.target, "X" if samples.stacked else "y"))
        return moments

    def _sides(self) -> tuple[Moments | None, Moments | None]:
        """Return the moments of source and target."""
        sides: tuple[Moments | None, Moments | None] = self._moments
        return sides

    def _known_sides(self) -> tuple[Moments, Moments]:
        """Return the moments of source and target, of both of which there are rows."""
        return cast(tuple[Moments, Moments], self._sides())

    def _pairs(self) -> Moments | None:
        """Return the moments of rows in pairs, the source's columns first, or None without pairs."""
        return None

    def _learn_if_possible(self, like: AnyArray) -> None:
        """Learn the map from what partial_fit has collected, or note why there is none yet."""
        self._forget()
        self._warns = False
        source, target = self._sides()
        if source is None or target is None:
            self._missing = f"there are no {'source' if source is None else 'target'} rows yet"
            return
        try:
            self._learn((source, target), like)
        except np.linalg.LinAlgError as error:
            self._forget()
            self._missing = str(error)

    def _forget(self) -> None:
        super()._forget()
        self._missing = self._back = None

    def _check_is_fitted(self) -> None:
        if self._missing is not None:
            raise NotFittedError(
                f"this {type(self).__name__} has no map yet: {self._missing.removesuffix('.')}. "
                "Add rows of both domains by partial_fit."
            )
        super()._check_is_fitted()

    def _estimated(self, samples: Samples) -> tuple[Moments, Moments]:
        """Return the sides with mean and covariance by a scikit-learn covariance estimator."""
        parts = (
            (samples.source, samples.source_weight, "source"),
            (samples.target, samples.target_weight, "target"),
        )
        sides = []
        for (rows, weight, _), moments in zip(parts, self._known_sides()):
            if is_dask(rows):
                raise ValueError(
                    f"covariance={self.covariance!r} needs all rows in memory. "
                    'Use covariance="empirical" or "shrunk" with dask, or compute the rows first.'
                )
            estimator = clone(self.covariance)
            if weight is not None and not has_fit_parameter(estimator, "sample_weight"):
                raise ValueError(
                    f"{type(estimator).__name__} takes no sample_weight. "
                    'Use covariance="empirical" or "shrunk" with weights.'
                )
            given = {} if weight is None else {"sample_weight": weight}
            estimator.fit(np.asarray(on_host(rows), dtype=np.float64), **given)
            mean = np.asarray(estimator.location_, dtype=np.float64)
            factor = covariance_root(estimator.covariance_).T
            # What varies is the estimator's to say, not the rows' rounding.
            sides.append(Moments(moments.n_rows, 1.0, 1.0, mean, np.zeros_like(mean), factor=factor, eps=0.0))
        return sides[0], sides[1]

    def _learn(self, sides: tuple[Moments, Moments], like: AnyArray) -> None:
        """Set the fitted attributes, as arrays of the library that `like` is of."""
        source, target = sides
        if self.mean == "shrunk":
            n_source, n_target = (side.effective_n_rows for side in self._known_sides())
            target, self.mean_shrinkage_ = mean_drawn_towards(
                target, source, n_target, n_source, self._pairs()
            )
        outside = 0.0
        if isinstance(self.covariance, str) and self.covariance == "shrunk":
            whole = target
            target, self.shrinkage_ = shrunk_towards(whole, source, self._pairs(), reach=self._reaches)
            if self._reaches:
                outside = _share_outside(source, whole)
        scale = self._scale_of(target)
        self._learned, self._back, self._support = (source, target, scale), None, None
        self._is_empirical = isinstance(self.covariance, str) and self.covariance == self.mean == "empirical"
        scaled = self._scaled()
        solution = self._solve(*scaled, scale)
        affine, self.rank_ = solution.affine, solution.rank
        self.unreached_ = max(outside, solution.unreached)
        self._map = affine if self.metric_scale is None else affine.scaled(scale)
        for name, value in {
            "coef_": self._map.coef,
            "intercept_": self._map.intercept,
            "source_mean_": source.mean,
            "target_mean_": target.mean,
        }.items():
            setattr(self, name, to_namespace(value, like))
        self.wasserstein_distance_ = self._distance(scaled[0], scaled[1], affine)

    def __getstate__(self) -> dict[str, Any]:
        state: dict[str, Any] = super().__getstate__()
        if "coef_" in state and state["coef_"] is self._map.coef:
            # The map writes down half of it where it is symmetric.
            state = {**state, "coef_": None}
        if "_map" in state:
            # They follow from the moments.
            state = {**state, "_support": None, "_back": None}
            if self._is_empirical:
                state["_learned"] = (None, None, self._learned[2])
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        if state.get("coef_", self) is None:
            self.coef_ = self._map.coef
        if "_map" in state and self._is_empirical:
            self._learned = (*self._known_sides(), self._learned[2])

    @property
    def source_covariance_(self) -> AnyArray:
        """Covariance of the source rows, as estimated."""
        return to_namespace(self._learned_side(0).covariance, self.coef_)

    @property
    def target_covariance_(self) -> AnyArray:
        """Covariance of the target rows, as estimated."""
        return to_namespace(self._learned_side(1).covariance, self.coef_)

    def _learned_side(self, side: Literal[0, 1]) -> Moments:
        if not hasattr(self, "coef_"):
            raise AttributeError(
                f"this {type(self).__name__} has not been fitted and knows no covariance yet."
            )
        return self._learned[side]

    def support_distance(self, X: AnyArray) -> Floats:
        """Return how far rows are from the source rows that were fitted, in standard deviations.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Source rows.

        Returns
        -------
        ndarray of shape (n_samples,)
            Mahalanobis distance from the source's mean; infinite off the plane in which the fitted rows lie.
        """
        self._check_is_fitted()
        rows = np.asarray(on_host(self._rows(X, "X", reset=False)), dtype=np.float64)
        if not np.isfinite(rows).all():
            self._refuse_infinite((rows, "X"))
        return self._fitted_support().distance(rows)

    def in_support(self, X: AnyArray, *, level: float = LEVEL) -> Flags:
        """Return which rows lie where the fitted source rows do.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Source rows.
        level : float, default=0.99
            Share of rows of the law that was fitted, whatever it is, that are in the support: seen from the fitted
            rows' distances, each left out of its own yardstick. From n rows no level beyond 1 - 1 / (n + 1) can be
            seen; it is taken for a higher one.

        Returns
        -------
        ndarray of bool of shape (n_samples,)

        Raises
        ------
        ValueError
            If the level is not between 0 and 1, or the fitted rows were in dask.
        """
        distances = self.support_distance(X)
        return distances <= self._fitted_support().radius(level)

    def _fitted_support(self) -> Support:
        if self._support is None:
            support = Support.of(self._learned[0])
            self._support = support if self._distances is None else support.calibrated(self._distances)
        return self._support

    def _calibrate(self, samples: Samples, earlier: Distances | None) -> None:
        """Look at some of the fitted rows, and before them at the distances of rows that came earlier."""
        self._distances = self._support = None
        if is_dask(samples.source):
            return
        places = _evenly(samples.source.shape[0], samples.source_weight)
        rows = np.asarray(on_host(rows_at(samples.source, places)), dtype=np.float64)
        weight = None if samples.source_weight is None else np.asarray(on_host(samples.source_weight))[places]
        source = self._learned[0]
        if not isinstance(self.covariance, str):
            # An estimator's moments count as one row, and its yardstick has not been bent by single ones.
            distances = Support.of(source).distance(rows)
        else:
            distances = Support.of(source).left_out(rows, source, weight)
        self._distances = Distances.of(distances, earlier)

    def _scaled(self) -> tuple[Moments, Moments]:
        """Return the moments in units of the metric's scale."""
        source, target, scale = self._learned
        if (scale == 1.0).all():
            return source, target
        return source.scaled(1 / scale), target.scaled(1 / scale)

    def _scale_of(self, target: Moments) -> Floats:
        """Return the metric's lengths."""
        if self.metric_scale is None:
            return np.ones(target.n_features)
        if isinstance(self.metric_scale, str):
            deviation = np.sqrt(target.variance)
            return np.where(deviation > 0, deviation, 1.0)
        scale = np.asarray(self.metric_scale, dtype=np.float64)
        if scale.shape != (target.n_features,) or not (np.isfinite(scale) & (scale > 0)).all():
            raise ValueError(
                f"metric_scale must have one positive length per feature, {target.n_features}; "
                f"it is {self.metric_scale!r}."
            )
        return scale

    def _distance(self, source: Moments, target: Moments, affine: AffineMap) -> float:
        return distance_of_roots(source.mean - target.mean, root_of_moments(source), root_of_moments(target))

    def _warn_of_few_rows(self) -> None:
        source, target, _ = self._learned
        n_rows = min(source.n_rows, target.n_rows)
        if n_rows <= self.n_features_in_ and self.rank_ < self.n_features_in_:
            warnings.warn(
                f"{n_rows} rows cannot show how {self.n_features_in_} features vary together: the map has "
                "rank "
                f"{self.rank_}, fits these rows and will not generalise to others. Give more rows, or use "
                'covariance="shrunk" or a covariance estimator.',
                UserWarning,
                stacklevel=4,
            )

    def _warn_of_unreached(self) -> None:
        if self.unreached_ > 0:
            warnings.warn(
                f"{100 * self.unreached_:.2g} % of the target's variance cannot be reached: the target varies where "
                "the source does not, and the carried rows will not vary there.",
                UserWarning,
                stacklevel=4,
            )

    def _look_outside(self, X: AnyArray, keep: AnyArray | None) -> None:
        """Warn or raise where more rows lie outside the support than the level lets expect."""
        if self.outside == "ignore" or is_dask(X):
            return
        rows = np.asarray(on_host(X), dtype=np.float64)
        rows = rows if keep is None else rows[~np.asarray(keep, dtype=bool)]
        if not len(rows) or not np.isfinite(rows).all():
            return
        support = self._fitted_support()
        n_outside = int((support.distance(rows) > support.radius(LEVEL)).sum())
        # As many or more in one of a thousand samples of the fitted law.
        if n_outside == 0 or binom.sf(n_outside - 1, len(rows), 1 - LEVEL) > RARE:
            return
        message = (
            f"{n_outside} of {len(rows)} rows lie outside of what was fitted (beyond the distance that "
            f"{100 * (1 - LEVEL):.0f} % of such rows exceed), where the map is a guess. Fit rows from there, or "
            "look at in_support(X)."
        )
        if self.outside == "raise":
            raise ValueError(message)
        warnings.warn(message, UserWarning, stacklevel=4)

    def _carry(self, X: AnyArray, keep: AnyArray | None = None) -> AnyArray:
        self._look_outside(X, keep)
        if self._map.is_tame is None and str(getattr(X, "dtype", None)).endswith("float32"):
            self._map = self._map.tame(self._learned[0])
        return apply_map(self._map, X, keep=keep, check=self._refuse_rows)

    def _carry_back(self, X: AnyArray) -> AnyArray:
        if self._back is None:
            scale = self._learned[2]
            try:
                affine = self._solve_back(*self._scaled(), scale)
            except np.linalg.LinAlgError as error:
                raise np.linalg.LinAlgError(
                    f"this map has no inverse: it is of rank {self.rank_}, and the source varies in "
                    "directions in which the carried rows do not. Fit it with more target rows."
                ) from error
            self._back = affine.scaled(scale)
        return apply_map(self._back, X, check=self._refuse_rows)

    def _refuse_rows(self, rows: AnyArray) -> NoReturn:
        self._refuse_infinite((rows, "X"))


def _evenly(n_rows: int, weight: Floats | None) -> Places:
    """Return numbers of rows to calibrate by, each as often as its weight says, as far as there is room."""
    if weight is None:
        return np.arange(0, n_rows, -(-n_rows // MOST_CALIBRATING_ROWS))
    ends = np.cumsum(on_host(weight))
    n_drawn = min(max(int(np.count_nonzero(weight)), int(ends[-1])), MOST_CALIBRATING_ROWS)
    places: Places = np.searchsorted(ends, (np.arange(n_drawn) + 0.5) / n_drawn * ends[-1])
    return places


def _merged(first: Moments | None, second: Moments | None, half_life: float | None) -> Moments | None:
    if first is None or second is None:
        return second if first is None else first
    if half_life is not None:
        first = first * max(0.5 ** (second.n_rows / half_life), LEAST_FACTOR)
    return first + second


def _share_outside(source: Moments, target: Moments) -> float:
    """Return the share of the target's variance in directions in which the source does not vary."""
    directions = spectrum(root_of_moments(source))[0]
    if directions.shape[1] == source.n_features:
        return 0.0
    factor = target.covariance_factor
    outside = factor - (factor @ directions) @ directions.T
    share = float(np.square(outside).sum() / np.square(factor).sum())
    return share if share > len(directions) * EPS else 0.0


def _given(samples: Samples) -> AnyArray:
    return samples.target if samples.source is None else samples.source
