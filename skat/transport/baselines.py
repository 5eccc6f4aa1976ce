"""What a transport has to beat, with the interface of the transports."""

import warnings
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from sklearn.base import BaseEstimator, RegressorMixin, TransformerMixin

from skat._compat import Interval
from skat.gaussian import AffineMap, Moments, coral_map, root_of_moments, spectrum
from skat.gaussian.arrays import AnyArray, Floats
from skat.gaussian.backends import on_host
from skat.metrics.wasserstein import optimal_plan
from skat.transport.affine import AffineTransport
from skat.transport.base import BaseTransport, Samples
from skat.transport.moment_transport import MomentTransport, Solution

if TYPE_CHECKING:
    from sklearn.pipeline import Pipeline

__all__ = ["CORAL", "ExactTransport", "IdentityTransport", "KernelAlignment"]


class IdentityTransport(MomentTransport):
    """Return every row as it is: the raw simulation.

    Parameters
    ----------
    unlabelled, source_domain
        As for `AffineTransport`.

    Attributes
    ----------
    coef_, intercept_, source_mean_, target_mean_, source_covariance_, target_covariance_
        As for `AffineTransport`; the map is the identity.
    wasserstein_distance_, rank_, n_features_in_, feature_names_in_
        As for `AffineTransport`.

    Examples
    --------
    >>> from skat import IdentityTransport
    >>> IdentityTransport().fit([[0.0], [1.0]], [[2.0], [5.0]]).transform([[7.0]])
    array([[7.]])
    """

    covariance = "empirical"
    metric_scale = None
    _parameter_constraints = BaseTransport._parameter_constraints

    def __init__(self, *, unlabelled: str = "raise", source_domain: object = None) -> None:
        BaseTransport.__init__(self, unlabelled=unlabelled, source_domain=source_domain)

    def _solve(self, source: Moments, target: Moments, scale: Floats) -> Solution:
        origin = np.zeros(source.n_features)
        return Solution(AffineMap(np.eye(source.n_features), origin, origin), source.n_features)

    def _solve_back(self, source: Moments, target: Moments, scale: Floats) -> AffineMap:
        return self._solve(source, target, scale).affine


class CORAL(MomentTransport):
    r"""Whiten by the source's covariance and colour by the target's.

    .. math:: T(x) = m_t + C_t^{1/2} C_s^{-1/2} (x - m_s)

    CORrelation ALignment with the means aligned as well, and without the identity that the authors' code adds
    to both covariances: that would make the map depend on units and miss the target's covariance. Where the
    source has the lower rank, that many of the target's largest principal directions are matched, and a warning
    says which share of its variance is missed.

    Parameters
    ----------
    unlabelled, source_domain
        As for `AffineTransport`.

    Attributes
    ----------
    coef_, intercept_, source_mean_, target_mean_, source_covariance_, target_covariance_
        As for `AffineTransport`.
    wasserstein_distance_, rank_, n_features_in_, feature_names_in_
        As for `AffineTransport`.

    References
    ----------
    .. [1] Sun, Feng, Saenko (2016). Return of Frustratingly Easy Domain Adaptation. AAAI. arXiv:1511.05547.

    Examples
    --------
    >>> from skat import CORAL
    >>> CORAL().fit([[0.0], [1.0]], [[2.0], [5.0]]).transform([[2.0]])
    array([[8.]])
    """

    covariance = "empirical"
    metric_scale = None
    _parameter_constraints = BaseTransport._parameter_constraints

    def __init__(self, *, unlabelled: str = "raise", source_domain: object = None) -> None:
        BaseTransport.__init__(self, unlabelled=unlabelled, source_domain=source_domain)

    def _solve(self, source: Moments, target: Moments, scale: Floats) -> Solution:
        source_root, target_root = root_of_moments(source), root_of_moments(target)
        rank = min(source_root.shape[1], target_root.shape[1])
        unreached = 0.0
        if rank < target_root.shape[1]:
            kept = np.square(spectrum(target_root)[1])
            unreached = float(kept[rank:].sum() / kept.sum())
        affine = AffineMap.between(coral_map(source_root, target_root), source, target)
        return Solution(affine, rank, unreached)

    def _solve_back(self, source: Moments, target: Moments, scale: Floats) -> AffineMap:
        solution = self._solve(target, source, scale)
        if root_of_moments(source).shape[1] > solution.rank:
            raise np.linalg.LinAlgError("the target has the lower rank.")
        return solution.affine


class ExactTransport(BaseTransport):
    """Carry rows by the exact optimal plan between the samples, which POT solves.

    A row that was fitted goes to the mean of the target rows that the plan sends it to (barycentric
    projection). Any other row goes where the nearest fitted row goes, with its offset from that row, as in
    ``ot.da.EMDTransport``.

    Parameters
    ----------
    unlabelled, source_domain
        As for `AffineTransport`.

    Attributes
    ----------
    coupling_ : ndarray of shape (n_source_samples, n_target_samples)
        The plan; its entries sum to one.
    wasserstein_distance_ : float
        Exact 2-Wasserstein distance between the samples, in the unit that the features share.
    n_features_in_, feature_names_in_
        As for `AffineTransport`.

    Notes
    -----
    Memory is the product of the two numbers of rows; beyond 8 GB, 31,600 rows of each, `fit` refuses.

    Examples
    --------
    >>> from skat import ExactTransport
    >>> ExactTransport().fit([[0.0], [1.0]], [[5.0], [2.0]]).transform([[0.0], [1.5]])
    array([[2. ],
           [5.5]])
    """

    def __init__(self, *, unlabelled: str = "raise", source_domain: object = None) -> None:
        BaseTransport.__init__(self, unlabelled=unlabelled, source_domain=source_domain)

    def _fit(self, samples: Samples) -> None:
        source = self._finite(on_host(samples.source), "X")
        target = self._finite(on_host(samples.target), "X" if samples.stacked else "y")
        self.coupling_, self.wasserstein_distance_ = optimal_plan(
            source, target, x_weight=samples.source_weight, y_weight=samples.target_weight
        )
        self._there = _images(source, target, self.coupling_)
        self._back = _images(target, source, self.coupling_.T)

    def _finite(self, rows: AnyArray, name: str = "X") -> Floats:
        if not np.isfinite(rows).all():
            self._refuse_infinite((rows, name))
        return np.asarray(rows, dtype=np.float64)

    def _carry(self, X: AnyArray, keep: AnyArray | None = None) -> AnyArray:
        return self._moved(X, *self._there, keep=keep)

    def _carry_back(self, X: AnyArray) -> AnyArray:
        return self._moved(X, *self._back)

    def _moved(
        self, X: AnyArray, fitted: Floats, images: Floats, *, keep: AnyArray | None = None
    ) -> NDArray[np.floating[Any]]:
        """Return rows moved as the nearest fitted row is."""
        X = on_host(X)
        rows = self._finite(X)
        nearest = KDTree(fitted).query(rows)[1]
        moved = images[nearest] + (rows - fitted[nearest])
        if keep is not None:
            moved[np.asarray(keep)] = rows[np.asarray(keep)]
        return np.asarray(moved, dtype=np.float32 if X.dtype == np.float32 else np.float64)


def _images(source: Floats, target: Floats, plan: Floats) -> tuple[Floats, Floats]:
    """Return the distinct source rows that have weight, and the mean of the target rows each is sent to."""
    rows, place = np.unique(source, axis=0, return_inverse=True)
    origin = target[0]
    mass, moment = np.zeros(len(rows)), np.zeros(rows.shape)
    np.add.at(mass, place, plan.sum(axis=1))
    np.add.at(moment, place, plan @ (target - origin))
    sent = mass > 0
    return rows[sent], origin + moment[sent] / mass[sent, np.newaxis]


class KernelAlignment(BaseTransport):
    r"""Transport in the feature space of a kernel, and carry the image back to rows.

    Rows are standardised by the target and mapped to features :math:`\phi` of a Gaussian kernel, of which
    Nyström's method keeps finitely many; there the optimal map between the two normal approximations is applied,
    and a ridge regression from :math:`\phi(y)` to :math:`y` finds the row whose features come nearest:

    .. math:: T(x) = g\bigl(m_t + A (\phi(x) - m_s)\bigr)

    Parameters
    ----------
    n_components : int, default=100
        Largest number of features.
    gamma : float, default=None
        Of the kernel :math:`\exp(-\gamma \|x - x'\|^2)` of standardised rows; None is one over twice the number of
        columns.
    random_state : int, RandomState instance or None, default=None
        Which rows the features are made of.
    unlabelled, source_domain
        As for `AffineTransport`.

    Attributes
    ----------
    wasserstein_distance_ : float
        Between the two normal approximations in the feature space; without unit.
    n_features_in_, feature_names_in_
        As for `AffineTransport`.

    Notes
    -----
    The source has to be near enough for its rows to have neighbours among the target's: elsewhere all features
    of a Gaussian kernel vanish. It aligns covariances, as `AffineTransport` does, and never looks at pairs.

    References
    ----------
    .. [1] Zhang, Wang, Xiao, Liu and Yan (2018). Aligning Infinite-Dimensional Covariance Matrices in
       Reproducing Kernel Hilbert Spaces for Domain Adaptation. CVPR. The kernel optimal transport map.

    Examples
    --------
    >>> import numpy as np
    >>> from skat.transport import KernelAlignment
    >>> source = np.random.default_rng(0).normal(size=(300, 2))
    >>> target = source + [0.5, 0.0]
    >>> carried = KernelAlignment(random_state=0).fit(source, target).transform(source)
    >>> bool(np.linalg.norm(carried - target, axis=1).mean() < 0.4)  # 0.5 before
    True
    """

    _parameter_constraints = {
        **BaseTransport._parameter_constraints,
        "n_components": [Interval(Integral, 1, None, closed="left")],
        "gamma": [None, Interval(Real, 0, None, closed="neither")],
        "random_state": ["random_state"],
    }

    def __init__(
        self,
        n_components: int = 100,
        *,
        gamma: float | None = None,
        random_state: int | np.random.RandomState | None = None,
        unlabelled: str = "raise",
        source_domain: object = None,
    ) -> None:
        super().__init__(unlabelled=unlabelled, source_domain=source_domain)
        self.n_components = n_components
        self.gamma = gamma
        self.random_state = random_state

    def _fit(self, samples: Samples) -> None:
        source, target = (
            _finite_rows(self, rows, name)
            for rows, name in ((samples.source, "X"), (samples.target, "X" if samples.stacked else "y"))
        )
        if samples.source_weight is not None or samples.target_weight is not None:
            raise ValueError("a kernel alignment takes no weights. Leave sample_weight out.")
        self._there, self.wasserstein_distance_ = self._learned(source, target)

    def _learned(self, source: Floats, target: Floats) -> "tuple[Pipeline, float]":
        from sklearn.covariance import LedoitWolf
        from sklearn.kernel_approximation import Nystroem
        from sklearn.linear_model import RidgeCV
        from sklearn.pipeline import make_pipeline
        from sklearn.preprocessing import StandardScaler

        pooled = np.vstack([source, target])
        gamma = 0.5 / source.shape[1] if self.gamma is None else self.gamma
        n_components = min(self.n_components, len(pooled))
        scaler = StandardScaler().fit(target)
        features = make_pipeline(
            scaler, Nystroem(gamma=gamma, n_components=n_components, random_state=self.random_state)
        )
        features[1].fit(scaler.transform(pooled))
        align = AffineTransport(covariance=LedoitWolf())
        with warnings.catch_warnings():
            # Features of a kernel are as many as we like; that rows of them are few is no news.
            warnings.simplefilter("ignore", UserWarning)
            align.fit(features.transform(source), features.transform(target))
        back = RidgeCV(np.logspace(-8, 2, 11)).fit(features.transform(target), target)
        return make_pipeline(features, align, _Predicting(back)), align.wasserstein_distance_

    def _carry(self, X: AnyArray, keep: AnyArray | None = None) -> AnyArray:
        rows = _finite_rows(self, X, "X")
        carried = self._there.transform(rows).reshape(rows.shape)
        if keep is not None:
            carried = np.where(np.asarray(keep)[:, np.newaxis], rows, carried)
        return carried.astype(np.float32 if on_host(X).dtype == np.float32 else np.float64)

    def _carry_back(self, X: AnyArray) -> AnyArray:
        raise np.linalg.LinAlgError(
            "the images of a kernel alignment have no inverse. Fit one with the two domains exchanged."
        )


class _Predicting(TransformerMixin, BaseEstimator):
    """Transform by what a fitted regressor predicts."""

    def __init__(self, regressor: RegressorMixin) -> None:
        self.regressor = regressor

    def fit(self, X: AnyArray, y: AnyArray | None = None) -> Self:
        return self

    def transform(self, X: AnyArray) -> AnyArray:
        return self.regressor.predict(X)

    def __sklearn_is_fitted__(self) -> bool:
        return True


def _finite_rows(transport: BaseTransport, rows: AnyArray, name: str) -> Floats:
    found: Floats = np.asarray(on_host(rows), dtype=np.float64)
    if not np.isfinite(found).all():
        transport._refuse_infinite((found, name))
    return found
