"""The affine map that rows in pairs show, as an estimator."""

import warnings

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator

from skat._compat import StrOptions
from skat.gaussian import AffineMap, Moments, root_of_moments
from skat.gaussian.arrays import AnyArray, Floats
from skat.gaussian.backends import beside, is_dask, to_namespace
from skat.transport.alignment import Alignment, PairFactors, look_shuffled, raw_alignment, whitened_alignment
from skat.transport.base import Samples, same_length, weight_of_pairs
from skat.transport.moment_transport import MomentTransport, Solution

__all__ = ["ProcrustesAffineTransport"]


class ProcrustesAffineTransport(MomentTransport):
    r"""Carry source rows to target rows by a map learned from rows in pairs.

    ``alignment="whitened"`` takes, of all affine maps that give the carried rows exactly the target's mean
    and covariance, the one with the least squared error over the pairs,

    .. math:: T = C_t^{1/2} Q C_s^{-1/2}, \quad
              Q \text{ the orthogonal polar factor of } C_t^{1/2} C_{ts} C_s^{-1/2},

    which recovers every invertible affine map from noise-free pairs. ``alignment="raw"`` is Algorithm 1 of
    the paper: the source is rotated by the polar factor of :math:`C_{ts}` and then transported.

    Parameters
    ----------
    alignment : {"whitened", "raw"}, default="whitened"
        Which rotation to use.
    center : bool, default=True
        False takes the rotation from rows that are not centred, as the letter of Algorithm 1 has it; only
        with ``alignment="raw"``.
    covariance : {"empirical", "shrunk"} or estimator, default="empirical"
        As for `AffineTransport`; but of the target's sampling error only the part counts that the pairs do
        not share, so that ``"shrunk"`` leaves pairs without noise as they are.
    mean : {"empirical", "shrunk"}, default="empirical"
        As for `AffineTransport`.
    metric_scale : None, "target" or array-like of shape (n_features,), default=None
        Lengths in which errors and displacement are measured, as for `AffineTransport`.
    rank_deficient : {"raise", "reach"}, default="raise"
        As for `AffineTransport`.
    outside, unlabelled, source_domain
        As for `AffineTransport`.

    Attributes
    ----------
    rotation_ : array of shape (n_features, n_features)
        Q or R above; orthogonal, or a partial isometry where a covariance is singular.
    coef_, intercept_, source_mean_, target_mean_, source_covariance_, target_covariance_
        As for `AffineTransport`.
    wasserstein_distance_, rank_, unreached_, shrinkage_, mean_shrinkage_, n_features_in_, feature_names_in_
        As for `AffineTransport`.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Algorithm 1.

    Examples
    --------
    >>> from skat import ProcrustesAffineTransport
    >>> simulated = np.random.default_rng(0).normal(size=(20, 2))
    >>> measured = simulated @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    >>> ProcrustesAffineTransport().fit(simulated, measured).coef_.round(12) + 0.0
    array([[ 0., -1.],
           [ 1.,  0.]])
    """

    _parameter_constraints = {
        **MomentTransport._parameter_constraints,
        "alignment": [StrOptions({"whitened", "raw"})],
        "center": ["boolean"],
    }

    def __init__(
        self,
        *,
        alignment: str = "whitened",
        center: bool = True,
        covariance: str | BaseEstimator = "empirical",
        mean: str = "empirical",
        metric_scale: str | ArrayLike | None = None,
        rank_deficient: str = "raise",
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
        self.alignment = alignment
        self.center = center

    def _check_parameters(self) -> None:
        super()._check_parameters()
        if not self.center and self.alignment != "raw":
            raise ValueError(
                'center=False belongs to alignment="raw", the letter of Algorithm 1; whitening is by '
                'covariances, which are centred. Use center=True or alignment="raw".'
            )

    def _sets_of_rows(self, samples: Samples) -> list[tuple[AnyArray | None, AnyArray | None]]:
        """Return the pairs, as rows of twice the columns."""
        if samples.source is None or samples.target is None:
            raise ValueError(
                f"{type(self).__name__} learns from pairs, so each call needs source and target rows "
                "together."
            )
        if not same_length(samples.source, samples.target):
            raise ValueError(
                f"{type(self).__name__} learns from pairs: row k of y belongs to row k of X; "
                f"there are {samples.source.shape[0]} source rows and {samples.target.shape[0]} target "
                "rows. Without pairs, use AffineTransport or ConditionalAffineTransport."
            )
        if samples.stacked and is_dask(samples.source):
            raise ValueError(
                f"{type(self).__name__} learns from pairs, which stacked dask rows do not show. Give two arrays, "
                "fit(X_source, X_target)."
            )
        return [(beside(samples.source, samples.target), weight_of_pairs(samples))]

    def _sides(self) -> tuple[Moments | None, Moments | None]:
        (pairs,) = self._moments
        if pairs is None:
            return None, None
        n_features = pairs.n_features // 2
        return pairs.columns(slice(0, n_features)), pairs.columns(slice(n_features, None))

    def _pairs(self) -> Moments | None:
        pairs: Moments | None = self._moments[0]
        return pairs

    def _solve(self, source: Moments, target: Moments, scale: Floats) -> Solution:
        alignment = self._aligned(source, target, scale, warn=self._warns)
        return Solution(
            AffineMap.between(alignment.coef, source, target), alignment.rank, alignment.unreached
        )

    def _solve_back(self, source: Moments, target: Moments, scale: Floats) -> AffineMap:
        alignment = self._aligned(source, target, scale, warn=False)
        if alignment.inverse_coef is None:
            raise np.linalg.LinAlgError("the target has the lower rank")
        return AffineMap.between(alignment.inverse_coef, target, source)

    @property
    def rotation_(self) -> AnyArray:
        """Q or R of the formula, found anew whenever it is asked for: the map needs none."""
        if not hasattr(self, "coef_"):
            raise AttributeError(f"this {type(self).__name__} has not been fitted and knows no rotation yet.")
        source, target = self._scaled()
        alignment = self._aligned(source, target, self._learned[2], warn=False, quick=False)
        return to_namespace(alignment.rotation, self.coef_)

    def _aligned(
        self, source: Moments, target: Moments, scale: Floats, *, warn: bool, quick: bool = True
    ) -> Alignment:
        (pairs,) = self._moments
        n_features = source.n_features
        factor = pairs.covariance_factor / np.concatenate([scale, scale])
        factors = PairFactors(factor[:, :n_features], factor[:, n_features:])
        if warn and look_shuffled(factors, pairs.effective_n_rows):
            warnings.warn(
                "the pairs carry no correlation that shuffled rows would not show as well, so the rotation "
                "is "
                "arbitrary. Check that row k of y belongs to row k of X, or use AffineTransport, which needs "
                "no pairs.",
                UserWarning,
                stacklevel=5,
            )
        roots = {"source_rounding": source.rounding, "target_rounding": target.rounding}
        roots["reach"] = self._reaches
        if not (isinstance(self.covariance, str) and self.covariance == "empirical"):
            roots |= {"source_root": root_of_moments(source), "target_root": root_of_moments(target)}
        if self.alignment == "raw":
            if not self.center:
                roots["mean_product"] = np.outer(target.mean, source.mean)
            return raw_alignment(factors, **roots)
        return whitened_alignment(factors, **roots, quick=quick)
