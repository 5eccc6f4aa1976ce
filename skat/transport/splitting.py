"""Cross-validation over stacked rows that scores target rows only."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Self

import numpy as np
from sklearn.utils.metadata_routing import UNCHANGED, MetadataRequest

from skat.gaussian.arrays import AnyArray, Places
from skat.gaussian.backends import on_host
from skat.metrics.domains import domain_signs

if TYPE_CHECKING:
    from sklearn.model_selection import BaseCrossValidator

__all__ = ["TargetRows"]


class TargetRows:
    """Split stacked rows so that validation folds hold target rows only.

    A grid over a pipeline of a transport and a predictor is to be scored on what the predictor is for: measured
    rows. Source rows of a validation fold would be scored as they are, for a scorer of scikit-learn hands no
    domain on to ``transform``. Here the target rows are split by `cv`; all source rows are for training. Rows to train
    on alternate between the domains in proportion to their numbers, so that the first so many of them, which a learning
    curve takes, are rows of both.

    Parameters
    ----------
    cv : int or cross-validation splitter, default=5
        Splits the target rows, with their y and groups; an int is of ``KFold``.
    sample_domain : array-like of shape (n_samples,), default=None
        Domain of each row. With metadata routing it may come with the others instead.
    source_domain : label or list of labels, default=None
        As for `AffineTransport`.
    paired : bool, default=False
        Whether the k-th source row belongs to the k-th target row; a source row then leaves with its partner, and
        the first 2 k rows to train on are k pairs.

    Examples
    --------
    >>> import numpy as np
    >>> from skat import TargetRows
    >>> rows, domain = np.zeros((6, 1)), ["sim", "sim", "real", "real", "real", "sim"]
    >>> for train, test in TargetRows(3, sample_domain=domain).split(rows):
    ...     print(train, test)
    [0 3 1 4 5] [2]
    [0 2 1 4 5] [3]
    [0 2 1 3 5] [4]
    """

    def __init__(
        self,
        cv: object = 5,
        *,
        sample_domain: AnyArray | None = None,
        source_domain: object = None,
        paired: bool = False,
    ) -> None:
        # A grid asks for the folds twice.
        self.cv = list(cv) if isinstance(cv, Iterator) else cv
        self.sample_domain = sample_domain
        self.source_domain = source_domain
        self.paired = paired

    def __repr__(self) -> str:
        return f"TargetRows({self.cv!r})"

    def get_n_splits(
        self,
        X: AnyArray | None = None,
        y: AnyArray | None = None,
        groups: AnyArray | None = None,
        sample_domain: AnyArray | None = None,
    ) -> int:
        """Return the number of folds, of arguments as for `split`; without a domain that of `cv` for all rows."""
        if self.sample_domain is not None or sample_domain is not None:
            _, target = self._sides(sample_domain, None)
            X, y, groups = np.empty((len(target), 1)), _part(y, target), _part(groups, target)
        return int(self._cv(y).get_n_splits(X, y, groups))

    def split(
        self,
        X: AnyArray,
        y: AnyArray | None = None,
        groups: AnyArray | None = None,
        sample_domain: AnyArray | None = None,
    ) -> Iterator[tuple[Places, Places]]:
        """Yield row numbers to train on and target row numbers to validate on.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Stacked rows.
        y, groups : array-like of shape (n_samples,), default=None
            Handed to `cv`, those of the target rows.
        sample_domain : array-like of shape (n_samples,), default=None
            Domain of each row; None takes the constructor's.

        Yields
        ------
        train, test : ndarray of int

        Raises
        ------
        ValueError
            If the domain is missing or has no rows of one side, or of `paired` the numbers differ.
        """
        source, target = self._sides(sample_domain, X.shape[0] if hasattr(X, "shape") else len(X))
        if self.paired and len(source) != len(target):
            raise ValueError(
                f"pairs are as many on both sides; there are {len(source)} and {len(target)} rows."
            )
        y, groups = _part(y, target), _part(groups, target)
        for train, test in self._cv(y).split(np.empty((len(target), 1)), y, groups):
            yield _alternating(source[train] if self.paired else source, target[train]), target[test]

    def _sides(self, sample_domain: AnyArray | None, n_rows: int | None) -> tuple[Places, Places]:
        """Return the numbers of source rows and of target rows."""
        domain = self.sample_domain if sample_domain is None else sample_domain
        if domain is None:
            raise ValueError(
                "TargetRows has to know which rows are target rows: TargetRows(cv, sample_domain=...), or, with "
                "metadata routing, sample_domain beside X."
            )
        signs = domain_signs(domain, n_rows, self.source_domain)
        source, target = np.flatnonzero(signs > 0), np.flatnonzero(signs < 0)
        if not len(source) or not len(target):
            raise ValueError(
                f"there are {len(source)} source and {len(target)} target rows. Give some of each."
            )
        return source, target

    def _cv(self, y: AnyArray | None) -> "BaseCrossValidator":
        from sklearn.model_selection import check_cv

        return check_cv(self.cv, y)

    def get_metadata_routing(self) -> MetadataRequest:
        """Ask for `groups` and `sample_domain` where they are given."""
        routing = MetadataRequest(owner=self)
        wanted = {"groups": getattr(self, "_groups", None), "sample_domain": True}
        for name, alias in wanted.items():
            routing.split.add_request(param=name, alias=alias)
        return routing

    def set_split_request(self, *, groups: bool | str | None = UNCHANGED) -> Self:
        """Ask for `groups`, or not, in metadata routing."""
        if groups is not UNCHANGED:
            self._groups = groups
        return self


def _part(given: AnyArray | None, rows: Places) -> AnyArray | None:
    return None if given is None else on_host(given)[rows]


def _alternating(first: Places, second: Places) -> Places:
    """Return the numbers of both, each in its order, so that any part from the front holds them in proportion."""
    places = np.concatenate([(np.arange(len(part)) + 0.5) / max(len(part), 1) for part in (first, second)])
    return np.concatenate([first, second])[np.argsort(places, kind="stable")]
