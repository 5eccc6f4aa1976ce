"""The optimal affine map between two normal approximations, as an estimator."""

from skat.gaussian import AffineMap, Moments, coefficient_distance, optimal_map, root_of_moments
from skat.gaussian.arrays import Floats
from skat.gaussian.maps import reached_part
from skat.transport.moment_transport import MomentTransport, Solution

__all__ = ["AffineTransport"]


class AffineTransport(MomentTransport):
    r"""Carry source rows to target rows by the optimal map between their normal approximations.

    .. math:: T(x) = m_t + A (x - m_s), \quad
              A = C_t^{1/2} (C_t^{1/2} C_s C_t^{1/2})^{-1/2} C_t^{1/2}

    It gives the carried rows exactly the target's mean and covariance, with the least mean squared
    displacement of all maps that do. It is the map of these data in these units: optimal transport
    depends on units, see `metric_scale`.

    Parameters
    ----------
    covariance : {"empirical", "shrunk"} or estimator, default="empirical"
        How the covariances are estimated. ``"shrunk"`` draws the target's towards the source's, for few
        target rows. A covariance estimator of scikit-learn is fitted to each side.
    mean : {"empirical", "shrunk"}, default="empirical"
        ``"shrunk"`` draws the target's mean towards the source's by as much as it is uncertain (the positive part of
        James and Stein): for few target rows of a domain whose mean is near. Three columns or more.
    metric_scale : None, "target" or array-like of shape (n_features,), default=None
        Lengths, in the features' units, in which displacement is measured; ``"target"`` takes the target's
        standard deviations (1 for constant columns), which makes the map independent of units.
    rank_deficient : {"raise", "reach"}, default="raise"
        What to do where the target varies and the source does not, so that no affine map carries one to the
        other. ``"reach"`` carries what can be reached (the mean of the target given the source, under the optimal
        coupling of the normal approximations), and warns of the share of variance that is missing.
    outside : {"ignore", "warn", "raise"}, default="ignore"
        What ``transform`` does where more source rows lie outside the support of the fitted ones than chance would
        put there: where as many are beyond the distance that one in a hundred of the fitted law exceeds as come in
        one of a thousand samples of it. `in_support` says which rows these are.
    unlabelled : {"raise", "source", "target"}, default="raise"
        After a fit to stacked rows: what rows are that come to ``transform`` without a domain. ``"target"`` returns
        them as they are, so that a pipeline fitted to both domains predicts measured rows.
    source_domain : label or list of labels, default=None
        The labels of source rows in `sample_domain`, where these are not numbers of either sign nor "sim" and
        "real": all other rows are target rows.

    Attributes
    ----------
    coef_ : array of shape (n_features, n_features)
        The linear part: ``transform(X)`` is ``X @ coef_.T + intercept_``.
    intercept_ : array of shape (n_features,)
        The constant part.
    source_mean_, target_mean_ : array of shape (n_features,)
        Means of the two domains, as estimated.
    source_covariance_, target_covariance_ : array of shape (n_features, n_features)
        Covariances as estimated; empirical ones divide by the sum of the weights.
    wasserstein_distance_ : float
        Distance between the two normal approximations, in units of `metric_scale` where that is given.
    rank_ : int
        Rank of `coef_`.
    shrinkage_ : float
        With ``covariance="shrunk"``: from 0 (the target's own covariance) to 1 (the source's).
    mean_shrinkage_ : float
        With ``mean="shrunk"``: from 0 (the target's own mean) to 1 (the source's).
    unreached_ : float
        Share of the target's variance, in units of `metric_scale`, that the carried rows lack; zero but with
        ``rank_deficient="reach"``.
    n_features_in_ : int
        Number of columns.
    feature_names_in_ : ndarray of shape (n_features,)
        Names of the columns, where `X` has them.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Section III.

    Examples
    --------
    >>> import numpy as np
    >>> from skat import AffineTransport
    >>> simulated = np.array([[0.0], [1.0], [2.0]])
    >>> measured = np.array([[1.0], [3.0], [5.0]])
    >>> AffineTransport().fit(simulated, measured).transform([[4.0]])
    array([[9.]])
    """

    def _solve(self, source: Moments, target: Moments, scale: Floats) -> Solution:
        source_root, target_root = root_of_moments(source), root_of_moments(target)
        coef = optimal_map(source_root, target_root, reach=self._reaches)
        rank, unreached = target_root.shape[1], 0.0
        if self._reaches:
            rank, unreached = reached_part(coef, source_root, target_root)
        return Solution(AffineMap.between(coef, source, target), rank, unreached)

    def _solve_back(self, source: Moments, target: Moments, scale: Floats) -> AffineMap:
        coef = optimal_map(root_of_moments(target), root_of_moments(source))
        return AffineMap.between(coef, target, source)

    def _distance(self, source: Moments, target: Moments, affine: AffineMap) -> float:
        return coefficient_distance(source, target, affine.coef)
