"""Rows outside of what was fitted: how far they are, whether they belong, and weights that make up for a shift."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import bandwidth, solve_triangular
from sklearn.base import ClassifierMixin

from skat.gaussian import Moments, root_of_moments, spectrum
from skat.gaussian.arrays import AnyArray, Floats, Places
from skat.gaussian.maps import EPS
from skat.metrics.samples import two_samples

__all__ = ["Distances", "Support", "importance_weights"]

# The share of rows beyond what one in a hundred exceeds is known to a fifth of a point from as many.
MOST_CALIBRATING_ROWS = 2000
# Copies of more rows would be the most of what a fit holds.
ROWS_AT_A_TIME = 256
LEVELS = np.concatenate(
    [np.linspace(0.0, 0.9, 46), 1.0 - np.geomspace(0.1, 1.0 / MOST_CALIBRATING_ROWS, 128)[1:]]
)


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances of fitted rows, each left out of its own yardstick; the latest, where they are many.

    Attributes
    ----------
    values : ndarray of float32 of shape (n_rows,)
        In standard deviations.
    """

    values: NDArray[np.float32]

    @classmethod
    def of(cls, values: Floats, earlier: Self | None = None) -> Self:
        """Return distances after others that came earlier."""
        seen = values if earlier is None else np.concatenate([earlier.values, values])
        return cls(seen[-MOST_CALIBRATING_ROWS:].astype(np.float32))

    @property
    def quantiles(self) -> NDArray[np.float32]:
        """What is usual: distances at the levels ``LEVELS``."""
        return np.sort(self.values)[_places(len(self.values))]

    def __getstate__(self) -> dict[str, Any]:
        # A tenth of the numbers, and all that is asked of them.
        return {"quantiles": self.quantiles, "n_rows": len(self.values)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        ranks = np.arange(state["n_rows"])
        values = np.interp(ranks, _places(len(ranks)), state["quantiles"]).astype(np.float32)
        vars(self)["values"] = values


def _places(n_rows: int) -> Places:
    """Return where in order the distances of so many rows are those at the levels."""
    # Of one more row than there are, as in conformal prediction; of too few rows for a level the farthest.
    places = np.minimum(np.ceil(LEVELS * (n_rows + 1)).astype(int), n_rows) - 1
    held: Places = np.maximum(places, 0)
    return held


@dataclass(frozen=True, eq=False)
class Support:
    r"""Where the fitted source rows lie: their covariance, and what distances from their mean are usual.

    The distance is Mahalanobis', :math:`D(x)^2 = (x - m)^T C^{-1} (x - m)`. What is usual is seen from the fitted rows,
    whatever their law: for each of them the distance from the mean in the covariance of the others, which follows from
    its own in closed form.

    Attributes
    ----------
    mean : ndarray of shape (n_features,)
    scale : ndarray of shape (n_features,)
        Standard deviations, by which rows are divided first.
    root : ndarray of shape (n_features, rank)
        Root of the covariance of scaled rows.
    quantiles : ndarray or None
        Distances at the levels ``LEVELS``; None where there are no rows to see them from.
    """

    mean: Floats
    scale: Floats
    root: Floats
    quantiles: NDArray[np.float32] | None = None

    @classmethod
    def of(cls, moments: Moments, rows: Floats | None = None, weight: Floats | None = None) -> Self:
        """Return the support of rows with these moments, calibrated by some of them.

        Parameters
        ----------
        moments : Moments
        rows : ndarray of shape (n_rows, n_features), default=None
        weight : ndarray of shape (n_rows,), default=None

        Returns
        -------
        Support
        """
        deviation = np.sqrt(moments.variance)
        scale = np.where(deviation > 0, deviation, 1.0)
        support = cls(moments.mean, scale, root_of_moments(moments) / scale[:, np.newaxis])
        if rows is None or not len(rows):
            return support
        return support.calibrated(Distances.of(support.left_out(rows, moments, weight)))

    def calibrated(self, distances: Distances) -> Self:
        """Return the support with what is usual taken from `Distances` of rows that are usual."""
        return replace(self, quantiles=distances.quantiles)

    def distance(self, rows: Floats) -> Floats:
        """Return the Mahalanobis distance of rows; infinite off the plane in which the fitted rows lie."""
        starts = range(0, len(rows), ROWS_AT_A_TIME)
        blocks = [self._distance(rows[start : start + ROWS_AT_A_TIME]) for start in starts]
        return np.concatenate(blocks) if blocks else np.empty(0)

    def _distance(self, rows: Floats) -> Floats:
        centred = (np.asarray(rows, dtype=np.float64) - self.mean) / self.scale
        if self.root.shape[1] == len(self.root) and bandwidth(self.root)[1] == 0:
            whitened = solve_triangular(self.root, centred.T, lower=True, check_finite=False)
            return np.asarray(np.linalg.norm(whitened, axis=0))
        directions, spread = spectrum(self.root)
        scores = centred @ directions
        distances: Floats = np.linalg.norm(scores / spread, axis=1)
        off = np.linalg.norm(centred - scores @ directions.T, axis=1)
        size = np.linalg.norm(centred, axis=1) + np.linalg.norm(self.mean / self.scale)
        distances[off > 1e3 * np.sqrt(EPS) * np.maximum(size, 1.0)] = np.inf
        return distances

    def left_out(self, rows: Floats, moments: Moments, weight: Floats | None = None) -> Floats:
        """Return the distance of fitted rows in the covariance of the others.

        Parameters
        ----------
        rows : ndarray of shape (n_rows, n_features)
            Some of the rows that the moments are of.
        moments : Moments
        weight : ndarray of shape (n_rows,), default=None
            Their weights.

        Returns
        -------
        ndarray of shape (n_rows,)
        """
        share = 1.0 / moments.weight if weight is None else weight / moments.weight
        # Without the row the mean moves by v s / (1 - s), and the scatter loses v v' s / (1 - s).
        squares = np.square(self.distance(rows))
        rest = np.maximum(1.0 - share * (1.0 + squares), EPS)
        return np.sqrt(squares / rest)

    def radius(self, level: float) -> float:
        """Return the distance that a share `level` of rows of the fitted law does not exceed."""
        if not 0.0 < level < 1.0:
            raise ValueError(f"level must be a share between 0 and 1, as 0.99; it is {level!r}.")
        if self.quantiles is None:
            raise ValueError(
                "this transport has seen no rows that say which distances are usual (dask rows are not looked at "
                "one by one). Use support_distance and a threshold of your own."
            )
        place = min(int(np.searchsorted(LEVELS, level - 1e-12)), len(LEVELS) - 1)
        return float(self.quantiles[place])


def importance_weights(
    X: AnyArray, y: AnyArray, *, classifier: ClassifierMixin | None = None, cv: object = 5
) -> Floats:
    r"""Return weights that make rows of one sample count as if they came from the law of another.

    .. math:: w(x) = \frac{p_y(x)}{p_x(x)} \propto \frac{\Pr(y \mid x)}{\Pr(x \mid x)}

    from the probabilities that a classifier gives each row of belonging to either sample, cross-fitted. For a map that
    is to serve under another distribution of states and actions than it is fitted to: give it the weights of the
    (state, action) columns of the fitted rows against those it will meet, as `sample_weight`.

    Parameters
    ----------
    X : array-like of shape (n_rows, n_features)
        The rows to weight.
    y : array-like of shape (n_other_rows, n_features)
        Rows of the law that they are to stand for.
    classifier : classifier, default=None
        With ``predict_proba``. None is a logistic regression on standardised rows, their squares and products, which
        holds for two normal laws exactly.
    cv : int or cross-validation splitter, default=5
        An int is of stratified folds.

    Returns
    -------
    ndarray of shape (n_rows,)
        Positive, of mean one.

    Raises
    ------
    ValueError
        If rows are not finite or of different columns.

    Notes
    -----
    Weights stand for rows that are there. Where the other law puts rows and `X` has none no weight helps:
    ``in_support`` tells. The effective number of rows, ``w.sum() ** 2 / (w ** 2).sum()``, says what the weights cost.

    References
    ----------
    .. [1] Bickel, Brückner and Scheffer (2009). Discriminative learning under covariate shift. Journal of Machine
       Learning Research 10.

    Examples
    --------
    >>> import numpy as np
    >>> from skat.transport import importance_weights
    >>> rng = np.random.default_rng(0)
    >>> here, there = rng.normal(size=(2000, 1)), 1 + rng.normal(size=(2000, 1))
    >>> weight = importance_weights(here, there)
    >>> bool(abs(np.average(here[:, 0], weights=weight) - 1) < 0.1)
    True
    """
    from sklearn.linear_model import LogisticRegression
    from sklearn.model_selection import cross_val_predict
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import PolynomialFeatures, StandardScaler

    X, y = two_samples(X, y, "X")
    if classifier is None:
        classifier = make_pipeline(
            StandardScaler(),
            PolynomialFeatures(2, include_bias=False),
            StandardScaler(),
            LogisticRegression(max_iter=2000),
        )
    rows = np.vstack([X, y])
    belongs = np.repeat([0, 1], [len(X), len(y)])
    probability = cross_val_predict(classifier, rows, belongs, cv=cv, method="predict_proba")[: len(X), 1]
    probability = np.clip(probability, EPS, 1 - EPS)
    weight = probability / (1 - probability)
    ratio: Floats = weight / weight.mean()
    return ratio
