"""Clouds of rows before and after a transport, in two coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from sklearn.utils import check_scalar

from skat.gaussian import row_moments
from skat.metrics.samples import one_sample
from skat.plotting.style import AFTER, BEFORE, MEASURED, column_of, new_axes, trim

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray


class TransportDisplay:
    """Clouds of source, transported and target rows in two coordinates.

    Use `from_estimator` or `from_predictions`.

    Parameters
    ----------
    source, transported, target : ndarray of shape (n_rows, 2)
        Coordinates of the rows; `source` and `transported` have as many.
    labels : tuple of two str
        Names of the coordinates.

    Attributes
    ----------
    ax_ : matplotlib Axes
        Where it is drawn.
    figure_ : matplotlib Figure
        The figure around it.

    Examples
    --------
    >>> from sklearn.preprocessing import FunctionTransformer
    >>> rng = np.random.default_rng(0)
    >>> X, y = rng.normal(size=(2, 50, 3))
    >>> display = TransportDisplay.from_estimator(FunctionTransformer(), X, y)
    >>> display.ax_.get_xlabel()
    'principal coordinate 1'
    """

    def __init__(
        self,
        *,
        source: NDArray[np.float64],
        transported: NDArray[np.float64],
        target: NDArray[np.float64],
        labels: tuple[str, str],
    ) -> None:
        self.source = source
        self.transported = transported
        self.target = target
        self.labels = labels

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        X: Any,
        y: Any,
        *,
        features: str | tuple[int | str, int | str] = "principal",
        feature_names: Sequence[str] | None = None,
        n_points: int = 1000,
        n_arrows: int = 0,
        ax: Axes | None = None,
    ) -> Self:
        """Draw a fitted transport at work.

        Parameters
        ----------
        estimator : fitted transport or pipeline that ends in one
            Anything with ``transform``.
        X : array-like of shape (n_source, n_features)
            Source rows.
        y : array-like of shape (n_target, n_features)
            Target rows.
        features : "principal" or pair of int or str, default="principal"
            Two columns, by number or name; or the first two principal axes of the target.
        feature_names : sequence of str, default=None
            Names of the columns; those of a data frame by default.
        n_points : int, default=1000
            Largest number of rows drawn of each cloud, evenly picked.
        n_arrows : int, default=0
            Number of arrows from source rows to where they are carried.
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.

        Returns
        -------
        TransportDisplay

        Raises
        ------
        TypeError
            If the estimator cannot transform.
        ValueError
            If the columns differ or a feature is unknown.
        """
        if not hasattr(estimator, "transform"):
            raise TypeError(
                "a transport is drawn by what estimator.transform(X) returns, but "
                f"{type(estimator).__name__} cannot transform. Give a transport or a pipeline."
            )
        options: dict[str, Any] = {"features": features, "feature_names": feature_names, "n_points": n_points}
        return cls.from_predictions(X, estimator.transform(X), y, n_arrows=n_arrows, ax=ax, **options)

    @classmethod
    def from_predictions(
        cls,
        X: Any,
        X_transported: Any,
        y: Any,
        *,
        features: str | tuple[int | str, int | str] = "principal",
        feature_names: Sequence[str] | None = None,
        n_points: int = 1000,
        n_arrows: int = 0,
        ax: Axes | None = None,
    ) -> Self:
        """Draw rows that were carried before.

        Parameters
        ----------
        X, X_transported : array-like of shape (n_source, n_features)
            Source rows, before and after.
        y : array-like of shape (n_target, n_features)
            Target rows.
        features, feature_names, n_points, n_arrows, ax
            As for `from_estimator`.

        Returns
        -------
        TransportDisplay

        Raises
        ------
        ValueError
            If shapes do not fit or a feature is unknown.
        """
        check_scalar(n_points, "n_points", Integral, min_val=1)
        names = _feature_names(X, feature_names)
        X, X_transported, y = (
            one_sample(rows, name) for rows, name in ((X, "X"), (X_transported, "X_transported"), (y, "y"))
        )
        if X.shape != X_transported.shape or X.shape[1] != y.shape[1]:
            raise ValueError(
                "X and X_transported must have one shape and y the same columns; "
                f"their shapes are {X.shape}, {X_transported.shape} and {y.shape}."
            )
        if len(names) != X.shape[1]:
            raise ValueError(
                f"feature_names must hold one name per column, {X.shape[1]}; it holds {len(names)}."
            )
        if isinstance(features, str) and features == "principal":
            axes, labels = _principal_axes(y)
        else:
            if not isinstance(features, tuple | list) or len(features) != 2:
                raise ValueError(
                    f"features must be two columns, by number or name, or 'principal'; it is {features!r}."
                )
            columns = [column_of(feature, names, X.shape[1]) for feature in features]
            first, second = columns
            axes, labels = np.eye(X.shape[1])[columns], (names[first], names[second])
        drawn, target = _evenly(len(X), n_points), _evenly(len(y), n_points)
        display = cls(
            source=X[drawn] @ axes.T,
            transported=X_transported[drawn] @ axes.T,
            target=y[target] @ axes.T,
            labels=labels,
        )
        return display.plot(ax=ax, n_arrows=n_arrows)

    def plot(self, ax: Axes | None = None, *, n_arrows: int = 0) -> Self:
        """Draw.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.
        n_arrows : int, default=0
            Number of arrows from source rows to where they are carried.

        Returns
        -------
        TransportDisplay
        """
        from matplotlib.collections import PathCollection

        self.ax_, self.figure_ = new_axes(ax, size=(5.2, 4.2))
        clouds = (
            ("target", self.target, MEASURED, "o", 16),
            ("source", self.source, BEFORE, "^", 14),
            ("source, transported", self.transported, AFTER, "o", 9),
        )
        for name, rows, colour, marker, size in clouds:
            opacity = float(np.clip(150 / len(rows), 0.25, 0.9))
            self.ax_.scatter(
                rows[:, 0],
                rows[:, 1],
                s=size,
                color=colour,
                marker=marker,
                alpha=opacity,
                linewidths=0,
                label=name,
            )
        for k in _evenly(len(self.source), n_arrows) if n_arrows else ():
            arrow = {"arrowstyle": "->", "color": AFTER, "alpha": 0.7}
            self.ax_.annotate("", self.transported[k], self.source[k], arrowprops=arrow)
        self.ax_.set(xlabel=self.labels[0], ylabel=self.labels[1])
        legend = self.ax_.legend(loc="best", frameon=False)
        for handle in legend.legend_handles:
            if isinstance(handle, PathCollection):
                handle.set_alpha(1.0)
                handle.set_sizes([30])
        trim(self.ax_)
        return self


def _feature_names(X: Any, feature_names: Sequence[str] | None) -> list[str]:
    if feature_names is not None:
        return list(feature_names)
    if hasattr(X, "columns"):
        return [str(name) for name in X.columns]
    return [f"feature {k}" for k in range(np.shape(X)[-1])]


def _principal_axes(rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], tuple[str, str]]:
    """Return two axes, in rows, and their labels."""
    if rows.shape[1] < 2:
        raise ValueError(f"a plane needs two columns; there is {rows.shape[1]}.")
    _, vectors = np.linalg.eigh(row_moments(rows).covariance)
    axes = vectors[:, [-1, -2]].T
    # An axis has no direction: its largest entry is made positive, so that figures are reproducible.
    largest = axes[[0, 1], np.abs(axes).argmax(axis=1)]
    return axes * np.sign(largest)[:, np.newaxis], ("principal coordinate 1", "principal coordinate 2")


def _evenly(n_rows: int, n_points: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, n_rows - 1, min(n_points, n_rows)).astype(int))
