"""Several source domains at once: a map for each, directly or by way of their barycentre."""

from collections.abc import Hashable
from typing import NoReturn, Self

import numpy as np
from sklearn.base import clone
from sklearn.utils import assert_all_finite

from skat._compat import StrOptions, safe_indexing
from skat.gaussian import AffineMap, barycentre_root, optimal_map, root_of_moments, row_moments
from skat.gaussian.arrays import AnyArray, Flags, Floats, Places
from skat.gaussian.backends import is_dask, on_host
from skat.metrics.domains import WORDS, are_among
from skat.transport.affine import AffineTransport
from skat.transport.base import BaseTransport, checked_weight, named

__all__ = ["MultiSourceTransport"]

TARGETS = [name for name, sign in WORDS.items() if sign < 0]


class MultiSourceTransport(BaseTransport):
    r"""Carry rows of several source domains onto one target, each domain by a map of its own.

    Parameters
    ----------
    transport : transport, default=None
        Fitted to each source and the target; None is ``AffineTransport()``.
    by : {"each", "barycentre"}, default="each"
        ``"barycentre"`` carries every source to the Wasserstein barycentre of the sources' normal approximations,
        weighted by their numbers of rows, and fits one transport from there to the target, with the rows of all:
        for a target of so few rows, or a regression of such need of rows, that one map has to serve all.
    target_domain : label or list of labels, default=None
        The labels of target rows in `sample_domain`; every other label is a source domain of its own. None takes
        negative numbers for the target and each positive number for a source, or "real" for the target.
    unlabelled : {"raise", "target"}, default="raise"
        As for `AffineTransport`: rows without a domain have no map to go by, but may be target rows.

    Attributes
    ----------
    transports_ : dict of label to transport
        By source domain; with ``by="barycentre"`` the same one for all.
    barycentre_mean_, barycentre_covariance_ : ndarray
        With ``by="barycentre"``.
    wasserstein_distance_ : float
        Root mean square, over source rows, of the domains' distances to the target.
    n_features_in_, feature_names_in_
        As for `AffineTransport`.

    References
    ----------
    .. [1] Montesuma and Mboula (2021). Wasserstein Barycenter Transport for Acoustic Adaptation. ICASSP.
    .. [2] Álvarez-Esteban, del Barrio, Cuesta-Albertos and Matrán (2016). A fixed-point approach to barycenters
       in Wasserstein space. Journal of Mathematical Analysis and Applications 441.

    Examples
    --------
    >>> import numpy as np
    >>> from skat import MultiSourceTransport
    >>> rows = np.array([[0.0], [1.0], [0.0], [3.0], [5.0], [7.0]])
    >>> pucks = ["red", "red", "blue", "blue", "real", "real"]
    >>> both = MultiSourceTransport(target_domain="real").fit(rows, sample_domain=pucks)
    >>> both.transform(rows, sample_domain=pucks).ravel()
    array([5., 7., 5., 7., 5., 7.])
    """

    _parameter_constraints = {
        "transport": [None, BaseTransport],
        "by": [StrOptions({"each", "barycentre"})],
        "target_domain": "no_validation",
        "unlabelled": [StrOptions({"raise", "target"})],
    }

    def __init__(
        self,
        transport: BaseTransport | None = None,
        *,
        by: str = "each",
        target_domain: object = None,
        unlabelled: str = "raise",
    ) -> None:
        self.transport = transport
        self.by = by
        self.target_domain = target_domain
        self.unlabelled = unlabelled

    source_domain = None

    def fit(
        self,
        X: AnyArray,
        y: AnyArray | None = None,
        sample_weight: AnyArray | None = None,
        sample_domain: AnyArray | None = None,
    ) -> Self:
        """Learn the maps.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Rows of all domains, stacked.
        y : object, default=None
            Ignored, as labels of a pipeline's predictor.
        sample_weight : array-like of shape (n_samples,), default=None
            Weights of the rows.
        sample_domain : array-like of shape (n_samples,)
            Domain of each row.

        Returns
        -------
        self : object

        Raises
        ------
        ValueError
            If domains are missing, or hold no target or no source, or if rows are not finite.
        """
        self._validate_params()
        self._forget()
        if sample_domain is None:
            raise ValueError(
                f"{type(self).__name__} has to know the domain of every row: fit(X, sample_domain=labels)."
            )
        if is_dask(X):
            raise ValueError(f"{type(self).__name__} needs all rows in memory. Compute them first.")
        rows = self._finite_rows(X, reset=True)
        labels = self._labels(sample_domain, rows)
        weight = checked_weight(sample_weight, rows)
        is_target = np.array([label is None for label in labels], dtype=bool)
        sources = list(dict.fromkeys(label for label in labels if label is not None))
        if not sources or not is_target.any():
            raise ValueError(
                f"there must be rows of the target and of one source or more; there are {int(is_target.sum())} "
                f"target rows and {len(sources)} sources."
            )
        members = {label: np.array([other == label for other in labels], dtype=bool) for label in sources}
        transport = AffineTransport() if self.transport is None else self.transport
        to_middle: dict[object, AffineMap | None] = dict.fromkeys(sources)
        if self.by == "barycentre":
            maps = self._to_barycentre(rows, members, weight)
            to_middle |= maps
            moved = np.concatenate([maps[label](rows[mask]) for label, mask in members.items()])
            order = np.concatenate([np.flatnonzero(mask) for mask in members.values()])
            target = rows[is_target]
            shared = _fitted(transport, named(moved, X), named(target, X), weight, order, is_target)
            self.transports_ = dict.fromkeys(sources, shared)
        else:
            self.transports_ = {
                label: _fitted(
                    transport,
                    safe_indexing(X, np.flatnonzero(mask)),
                    safe_indexing(X, np.flatnonzero(is_target)),
                    weight,
                    mask,
                    is_target,
                )
                for label, mask in members.items()
            }
        self._to_middle = to_middle
        sizes = np.array([mask.sum() for mask in members.values()])
        distances = np.array([self.transports_[label].wasserstein_distance_ for label in sources])
        self.wasserstein_distance_ = float(np.sqrt(np.average(np.square(distances), weights=sizes)))
        return self

    def transform(self, X: AnyArray, sample_domain: AnyArray | None = None) -> AnyArray:
        """Carry the rows of each source domain over by its own map.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Rows.
        sample_domain : array-like of shape (n_samples,), default=None
            Domain of each row; target rows are returned as they are.

        Returns
        -------
        ndarray of shape (n_samples, n_features)

        Raises
        ------
        ValueError
            If domains are missing, unless `unlabelled` says that such rows are target rows, or were not fitted;
            or if rows are not finite.
        """
        self._check_is_fitted()
        rows = self._finite_rows(X, reset=False)
        if sample_domain is None:
            if self.unlabelled == "target":
                return np.array(rows)
            raise ValueError(
                f"this {type(self).__name__} has a map for each of {len(self.transports_)} domains, so transform "
                'has to know whose rows these are. Pass sample_domain=..., or say unlabelled="target".'
            )
        labels = self._labels(sample_domain, rows)
        unknown = [
            label for label in dict.fromkeys(labels) if label is not None and label not in self.transports_
        ]
        if unknown:
            raise ValueError(
                f"no rows of {', '.join(map(repr, unknown))} were fitted; the source domains are "
                f"{', '.join(map(repr, self.transports_))}."
            )
        carried = np.array(rows)
        for label, transport in self.transports_.items():
            mask = np.array([other == label for other in labels], dtype=bool)
            if mask.any():
                moved = safe_indexing(X, np.flatnonzero(mask))
                to_middle = self._to_middle[label]
                if to_middle is not None:
                    moved = named(to_middle(rows[mask]), X)
                carried[mask] = on_host(transport.transform(moved))
        return carried

    def inverse_transform(self, X: AnyArray) -> NoReturn:
        """Raise: a target row comes from no domain in particular."""
        raise ValueError("target rows have one origin for each source domain. Use transports_[label].")

    def score(
        self,
        X: AnyArray,
        y: AnyArray | None = None,
        sample_weight: AnyArray | None = None,
        sample_domain: AnyArray | None = None,
    ) -> float:
        """Return the mean affinity of the carried rows of each source domain and the target rows.

        Parameters
        ----------
        X, y, sample_weight, sample_domain
            As for `fit`.

        Returns
        -------
        float
            At most one; domains count by their numbers of rows.
        """
        from skat.metrics import affinity_score

        rows = self._finite_rows(X, reset=False)
        labels = self._labels(sample_domain, rows)
        carried = self.transform(X, sample_domain=sample_domain)
        target = np.array([label is None for label in labels], dtype=bool)
        weight = checked_weight(sample_weight, rows)
        scores, sizes = [], []
        for label in dict.fromkeys(label for label in labels if label is not None):
            mask = np.array([other == label for other in labels], dtype=bool)
            weights = None if weight is None else (weight[mask], weight[target])
            scores.append(affinity_score(carried[mask], rows[target], sample_weight=weights))
            sizes.append(mask.sum())
        return float(np.average(scores, weights=sizes))

    def _finite_rows(self, X: AnyArray, *, reset: bool) -> AnyArray:
        rows = self._rows(X, "X", reset=reset)
        assert_all_finite(rows, estimator_name=type(self).__name__, input_name="X")
        return rows

    def _labels(self, sample_domain: AnyArray, rows: AnyArray) -> list[Hashable]:
        """Return the label of each row's source domain, None for target rows."""
        labels = on_host(sample_domain)
        if labels.ndim != 1 or len(labels) != len(rows):
            raise ValueError(
                f"sample_domain must have one label per row; its shape is {labels.shape}, there are {len(rows)} rows."
            )
        is_target = are_among(labels, TARGETS if self.target_domain is None else self.target_domain)
        named = labels.tolist()
        if self.target_domain is None and all(isinstance(label, int | float) for label in named):
            if 0 in named:
                raise ValueError(
                    "numbers of domains are positive for sources and negative for the target; "
                    f"{named.count(0)} of {len(named)} are zero. Say which label is the target's by target_domain=0."
                )
            is_target = labels < 0
        return [None if target else label for target, label in zip(is_target, named)]

    def _to_barycentre(
        self, rows: AnyArray, members: dict[Hashable, Flags], weight: Floats | None
    ) -> dict[Hashable, AffineMap]:
        """Return the map of each source to the barycentre of them all."""
        moments = {
            label: row_moments(
                rows[mask], None if weight is None else checked_weight(weight[mask], rows[mask])
            )
            for label, mask in members.items()
        }
        sides = list(moments.values())
        shares = np.array([side.weight for side in sides])
        shares /= shares.sum()
        rounding = np.sqrt(shares @ np.square([side.rounding for side in sides]))
        roots = {label: root_of_moments(side) for label, side in moments.items()}
        middle = barycentre_root(list(roots.values()), shares, rounding)
        self.barycentre_mean_ = shares @ [side.mean for side in sides]
        self.barycentre_covariance_ = middle @ middle.T
        return {
            label: AffineMap(optimal_map(roots[label], middle), side.mean, self.barycentre_mean_)
            for label, side in moments.items()
        }


def _fitted(
    transport: BaseTransport,
    source: AnyArray,
    target: AnyArray,
    weight: Floats | None,
    source_rows: Flags | Places,
    target_rows: Flags,
) -> BaseTransport:
    given = {} if weight is None else {"sample_weight": (weight[source_rows], weight[target_rows])}
    fitted: BaseTransport = clone(transport).fit(source, target, **given)
    return fitted
