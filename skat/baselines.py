"""What a transport has to beat, with the interface of the transports."""

import numpy as np

from skat.base import BaseTransport, on_host
from skat.gaussian import AffineMap, coral_map, root_of_moments
from skat.moment_transport import MomentTransport
from skat.wasserstein import refuse_large_cost, wasserstein_distance

__all__ = ["CORAL", "ExactTransport", "IdentityTransport"]


class IdentityTransport(MomentTransport):
    """Return every row as it is: the raw simulation.

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

    def __init__(self):
        pass

    def _solve(self, source, target, scale):
        origin = np.zeros(source.n_features)
        return AffineMap(np.eye(source.n_features), origin, origin), source.n_features

    def _solve_back(self, source, target, scale):
        return self._solve(source, target, scale)[0]


class CORAL(MomentTransport):
    r"""Whiten by the source's covariance and colour by the target's.

    .. math:: T(x) = m_t + C_t^{1/2} C_s^{-1/2} (x - m_s)

    CORrelation ALignment with the means aligned as well, and without the identity that the authors' code adds
    to both covariances: that would make the map depend on units and miss the target's covariance. Where the
    source has the lower rank, that many of the target's largest principal directions are matched.

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

    def __init__(self):
        pass

    def _solve(self, source, target, scale):
        source_root, target_root = root_of_moments(source), root_of_moments(target)
        rank = min(source_root.shape[1], target_root.shape[1])
        return AffineMap.between(coral_map(source_root, target_root), source, target), rank

    def _solve_back(self, source, target, scale):
        return self._solve(target, source, scale)[0]


class ExactTransport(BaseTransport):
    """Carry rows by the exact optimal plan between the samples, which POT solves.

    A row that was fitted goes to the mean of the target rows that the plan sends it to (barycentric
    projection). Any other row goes where the nearest fitted row goes, with its offset from that row, as in
    ``ot.da.EMDTransport``.

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

    def __init__(self):
        pass

    def _fit(self, samples):
        from ot.da import EMDTransport

        source = self._finite(on_host(samples.source), "X")
        target = self._finite(on_host(samples.target), "X" if samples.stacked else "y")
        refuse_large_cost(len(source), len(target))
        weights = iter((samples.source_weight, samples.target_weight))

        def weight_of(rows):
            weight = next(weights)
            return np.full(len(rows), 1 / len(rows)) if weight is None else weight / weight.sum()

        self._solver = EMDTransport(
            distribution_estimation=weight_of, max_iter=100 * len(source) * len(target) + 100_000
        )
        self._solver.fit(Xs=source, Xt=target)
        self._solver.distribution_estimation = None
        self.coupling_ = self._solver.coupling_
        self.wasserstein_distance_ = wasserstein_distance(
            source, target, x_weight=samples.source_weight, y_weight=samples.target_weight
        )

    def _finite(self, rows, name="X"):
        if not np.isfinite(rows).all():
            self._refuse_infinite((rows, name))
        return np.asarray(rows, dtype=np.float64)

    def _carry(self, X, keep=None):
        rows = self._finite(on_host(X))
        carried = np.array(rows)
        moves = np.ones(len(rows), dtype=bool) if keep is None else ~np.asarray(keep)
        if moves.any():
            carried[moves] = self._solver.transform(Xs=rows[moves])
        return carried.astype(np.float32 if X.dtype == np.float32 else np.float64)

    def _carry_back(self, X):
        carried = self._solver.inverse_transform(Xt=self._finite(on_host(X)))
        return carried.astype(np.float32 if X.dtype == np.float32 else np.float64)
