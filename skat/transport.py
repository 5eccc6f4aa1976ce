"""Affine maps from source rows to target rows, learned from moments."""

import warnings

import numpy as np

from skat._compat import column_indices
from skat.alignment import look_shuffled, raw_alignment, whitened_alignment
from skat.backends import beside
from skat.base import same_length
from skat.conditional import conditional_map
from skat.gaussian import AffineMap, coefficient_distance, optimal_map, root_of_moments
from skat.moment_transport import MomentTransport

__all__ = ["AffineTransport", "ConditionalAffineTransport", "ProcrustesAffineTransport"]


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
    metric_scale : None, "target" or array-like of shape (n_features,), default=None
        Lengths, in the features' units, in which displacement is measured; ``"target"`` takes the target's
        standard deviations (1 for constant columns), which makes the map independent of units.

    Attributes
    ----------
    coef_ : array of shape (n_features, n_features)
        The linear part: ``transform(X)`` is ``X @ coef_.T + intercept_``.
    intercept_ : array of shape (n_features,)
        The constant part.
    source_mean_, target_mean_ : array of shape (n_features,)
        Means of the two domains.
    source_covariance_, target_covariance_ : array of shape (n_features, n_features)
        Covariances as estimated; empirical ones divide by the sum of the weights.
    wasserstein_distance_ : float
        Distance between the two normal approximations, in units of `metric_scale` where that is given.
    rank_ : int
        Rank of `coef_`.
    shrinkage_ : float
        With ``covariance="shrunk"``: from 0 (the target's own covariance) to 1 (the source's).
    n_features_in_ : int
        Number of columns.
    feature_names_in_ : ndarray of shape (n_features,)
        Names of the columns, where `X` has them.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Section III.

    Examples
    --------
    >>> from skat import AffineTransport
    >>> simulated = np.array([[0.0], [1.0], [2.0]])
    >>> measured = np.array([[1.0], [3.0], [5.0]])
    >>> AffineTransport().fit(simulated, measured).transform([[4.0]])
    array([[9.]])
    """

    def _solve(self, source, target, scale):
        source_root, target_root = root_of_moments(source), root_of_moments(target)
        coef = optimal_map(source_root, target_root)
        return AffineMap.between(coef, source, target), target_root.shape[1]

    def _solve_back(self, source, target, scale):
        return self._solve(target, source, scale)[0]

    def _distance(self, source, target, affine):
        return coefficient_distance(source, target, affine.coef)


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
    metric_scale : None, "target" or array-like of shape (n_features,), default=None
        Lengths in which errors and displacement are measured, as for `AffineTransport`.

    Attributes
    ----------
    rotation_ : array of shape (n_features, n_features)
        Q or R above; orthogonal, or a partial isometry where a covariance is singular.
    coef_, intercept_, source_mean_, target_mean_, source_covariance_, target_covariance_
        As for `AffineTransport`.
    wasserstein_distance_, rank_, shrinkage_, n_features_in_, feature_names_in_
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

    def __init__(self, *, alignment="whitened", center=True, covariance="empirical", metric_scale=None):
        super().__init__(covariance=covariance, metric_scale=metric_scale)
        self.alignment = alignment
        self.center = center

    def _check_parameters(self):
        super()._check_parameters()
        if self.alignment not in ("whitened", "raw"):
            raise ValueError(f'alignment must be "whitened" or "raw"; it is {self.alignment!r}.')
        if not self.center and self.alignment != "raw":
            raise ValueError(
                'center=False belongs to alignment="raw", the letter of Algorithm 1; whitening is by '
                'covariances, which are centred. Use center=True or alignment="raw".'
            )

    def _sets_of_rows(self, samples):
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
        if (samples.source_weight is None) != (samples.target_weight is None) or (
            samples.source_weight is not None
            and not np.array_equal(samples.source_weight, samples.target_weight)
        ):
            raise ValueError("a pair has one weight: give one array of weights, not two that differ.")
        return [(beside(samples.source, samples.target), samples.source_weight)]

    def _sides(self):
        (pairs,) = self._moments
        if pairs is None:
            return None, None
        n_features = pairs.n_features // 2
        return pairs.columns(slice(0, n_features)), pairs.columns(slice(n_features, None))

    def _pairs(self):
        return self._moments[0]

    def _solve(self, source, target, scale):
        (pairs,) = self._moments
        n_features = source.n_features
        factor = pairs.covariance_factor() / np.concatenate([scale, scale])
        source_part, target_part = factor[:, :n_features], factor[:, n_features:]
        if self._warns and look_shuffled(source_part, target_part, pairs.effective_n_rows):
            warnings.warn(
                "the pairs carry no correlation that shuffled rows would not show as well, so the rotation "
                "is "
                "arbitrary. Check that row k of y belongs to row k of X, or use AffineTransport, which needs "
                "no pairs.",
                UserWarning,
                stacklevel=4,
            )
        roots = {"source_rounding": source.rounding, "target_rounding": target.rounding}
        if not (isinstance(self.covariance, str) and self.covariance == "empirical"):
            roots |= {"source_root": root_of_moments(source), "target_root": root_of_moments(target)}
        if self.alignment == "raw":
            if not self.center:
                roots["mean_product"] = np.outer(target.mean, source.mean)
            alignment = raw_alignment(source_part, target_part, **roots)
        else:
            alignment = whitened_alignment(source_part, target_part, **roots)
        self._alignment = alignment
        return AffineMap.between(alignment.coef, source, target), alignment.rank

    def _more_attributes(self):
        return {"rotation_": self._alignment.rotation}

    def _solve_back(self, source, target, scale):
        if self._alignment.inverse_coef is None:
            raise np.linalg.LinAlgError("the target has the lower rank")
        return AffineMap.between(self._alignment.inverse_coef, target, source)


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
        else selects columns as there: positions or names in a list, a slice, a mask, or a callable of `X`.
    covariance : {"empirical", "shrunk"} or estimator, default="empirical"
        As for `AffineTransport`, for all columns together. Where the context determines the rest almost
        exactly, the regression needs no shrinkage and is worse off with it.
    metric_scale : None, "target" or array-like of shape (n_features,), default=None
        As for `AffineTransport`.

    Attributes
    ----------
    coef_, intercept_, source_mean_, target_mean_, source_covariance_, target_covariance_
        As for `AffineTransport`; the target's mean and covariance are reached exactly where the contexts have
        the same.
    wasserstein_distance_, rank_, shrinkage_, n_features_in_, feature_names_in_
        As for `AffineTransport`.

    Examples
    --------
    >>> from skat import ConditionalAffineTransport
    >>> simulated = np.array([[0.0, 0.0], [0.0, 2.0], [1.0, 3.0], [1.0, 5.0]])
    >>> measured = np.array([[0.0, 1.0], [0.0, 2.0], [1.0, 1.0], [1.0, 2.0]])
    >>> ConditionalAffineTransport(context=1).fit(simulated, measured).transform([[1.0, 4.0]]).round(12)
    array([[1. , 1.5]])
    """

    def __init__(self, *, context, covariance="empirical", metric_scale=None):
        super().__init__(covariance=covariance, metric_scale=metric_scale)
        self.context = context

    def _see_columns(self, X, rows):
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

    def _solve(self, source, target, scale):
        return conditional_map(source, target, np.array(self._context))

    def _solve_back(self, source, target, scale):
        return conditional_map(target, source, np.array(self._context))[0]
