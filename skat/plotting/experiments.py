"""Figures of experiments: errors by pair of domains, and over the number of pairs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from skat.plotting.style import MARKERS, MEASURED, METHODS, new_axes, trim

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from numpy.typing import NDArray


class DomainMatrixDisplay:
    """A number for each pair of a source and a target domain, as a heat map.

    Use `from_frame`.

    Parameters
    ----------
    values : ndarray of shape (n_sources, n_targets)
        NaN where a pair is missing; such cells stay empty.
    sources, targets : sequence of str
        Names of rows and columns.
    label : str
        What the numbers are.

    Attributes
    ----------
    ax_ : matplotlib Axes
        Where it is drawn.
    figure_ : matplotlib Figure
        The figure around it.
    im_ : matplotlib AxesImage
        The cells.

    Examples
    --------
    >>> import pandas as pd
    >>> frame = pd.DataFrame(
    ...     {"source": ["light", "heavy"], "target": ["heavy", "light"], "value": [0.3, 0.5]}
    ... )
    >>> DomainMatrixDisplay.from_frame(frame).values
    array([[nan, 0.3],
           [0.5, nan]])
    """

    def __init__(self, *, values: Any, sources: Sequence[str], targets: Sequence[str], label: str) -> None:
        self.values = values
        self.sources = sources
        self.targets = targets
        self.label = label

    @classmethod
    def from_frame(
        cls,
        frame: pd.DataFrame,
        *,
        value: str = "value",
        source: str = "source",
        target: str = "target",
        label: str | None = None,
        ax: Axes | None = None,
        **options: Any,
    ) -> Self:
        """Draw a data frame with a row for each pair.

        Parameters
        ----------
        frame : pandas.DataFrame
            Columns `source`, `target` and `value`; domains are shown in the order in which they first appear
            as sources, so that a domain has the same place in rows and columns.
        value, source, target : str
            Names of the columns.
        label : str, default=None
            What the numbers are; the name of their column by default.
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.
        **options
            For `plot`.

        Returns
        -------
        DomainMatrixDisplay

        Raises
        ------
        ValueError
            If a column is missing or a pair appears more than once.
        """
        _check_columns(frame, (value, source, target))
        twice = frame.duplicated([source, target])
        if twice.any():
            pair = frame[twice].iloc[0]
            raise ValueError(
                f"each pair of domains can have one value; {pair[source]} to {pair[target]} has several. "
                "Select one method or average first."
            )
        sources = list(dict.fromkeys(frame[source]))
        targets = [name for name in sources if name in set(frame[target])]
        targets += [name for name in dict.fromkeys(frame[target]) if name not in set(sources)]
        values = np.full((len(sources), len(targets)), np.nan)
        for row, column, number in zip(frame[source], frame[target], frame[value]):
            values[sources.index(row), targets.index(column)] = number
        display = cls(values=values, sources=sources, targets=targets, label=label or value)
        return display.plot(ax=ax, **options)

    def plot(
        self,
        ax: Axes | None = None,
        *,
        limits: tuple[float, float] | None = None,
        cmap: str = "viridis_r",
        number_format: str = ".2f",
        colorbar: bool = True,
    ) -> Self:
        """Draw.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.
        limits : pair of float, default=None
            Numbers at the ends of the colour scale, to make figures comparable; those of the data by default.
        cmap : str or matplotlib Colormap, default="viridis_r"
            Colour scale; by default large numbers are dark.
        number_format : str, default=".2f"
            How to write the numbers; empty for none.
        colorbar : bool, default=True
            Whether to draw the scale.

        Returns
        -------
        DomainMatrixDisplay
        """
        n_rows, n_columns = self.values.shape
        self.ax_, self.figure_ = new_axes(ax, size=(2.6 + 0.62 * n_columns, 1.5 + 0.5 * n_rows))
        low, high = limits or (np.nanmin(self.values), np.nanmax(self.values))
        self.im_ = self.ax_.imshow(self.values, cmap=cmap, vmin=low, vmax=high, aspect="auto")
        self.ax_.set_xticks(range(n_columns), self.targets, rotation=35, ha="right", rotation_mode="anchor")
        self.ax_.set_yticks(range(n_rows), self.sources)
        self.ax_.set(xlabel="target", ylabel="source")
        self.ax_.tick_params(length=0)
        self.ax_.spines[:].set_visible(False)
        self.ax_.set_xticks(np.arange(n_columns - 1) + 0.5, minor=True)
        self.ax_.set_yticks(np.arange(n_rows - 1) + 0.5, minor=True)
        self.ax_.grid(which="minor", color="white", linewidth=1.5)
        self.ax_.tick_params(which="minor", length=0)
        if number_format:
            for (row, column), number in np.ndenumerate(self.values):
                if np.isfinite(number):
                    self._write(row, column, format(number, number_format))
        if colorbar:
            bar = self.figure_.colorbar(self.im_, ax=self.ax_, label=self.label)
            bar.outline.set_visible(False)
        else:
            self.ax_.set_title(self.label)
        return self

    def _write(self, row: int, column: int, text: str) -> None:
        red, green, blue, _ = self.im_.cmap(self.im_.norm(self.values[row, column]))
        is_dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
        self.ax_.text(
            column, row, text, ha="center", va="center", color="white" if is_dark else "black", fontsize=9
        )


class LearningCurveDisplay:
    """Error against the number of samples, for several methods, with bands of two standard deviations.

    Use `from_frame`.

    Parameters
    ----------
    curves : dict of str to ndarray of shape (n_sizes, 3)
        For each method, in columns: the number of samples, the mean and the standard deviation (NaN for no
        band).
    labels : tuple of two str
        Names of the axes.

    Attributes
    ----------
    ax_ : matplotlib Axes
        Where it is drawn.
    figure_ : matplotlib Figure
        The figure around it.

    Examples
    --------
    >>> import pandas as pd
    >>> frame = pd.DataFrame(
    ...     {"n_samples": [10, 10, 20, 20], "method": "affine", "error": [4.0, 2.0, 1.0, 1.0]}
    ... )
    >>> LearningCurveDisplay.from_frame(frame).curves["affine"]
    array([[10., 3., 1.],
           [20., 1., 0.]])
    """

    def __init__(self, *, curves: dict[str, NDArray[np.float64]], labels: tuple[str, str]) -> None:
        self.curves = curves
        self.labels = labels

    @classmethod
    def from_frame(
        cls,
        frame: pd.DataFrame,
        *,
        size: str = "n_samples",
        method: str = "method",
        value: str = "error",
        deviation: str | None = None,
        ax: Axes | None = None,
        **options: Any,
    ) -> Self:
        """Draw a tidy data frame.

        Parameters
        ----------
        frame : pandas.DataFrame
            A row for each size, method and repetition; or for each size and method, with a column
            `deviation`.
        size, method, value : str
            Names of the columns of the number of samples, the method and the error.
        deviation : str, default=None
            Column of standard deviations of already averaged values; by default they are taken over
            repetitions.
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.
        **options
            For `plot`.

        Returns
        -------
        LearningCurveDisplay

        Raises
        ------
        ValueError
            If a column is missing; or with `deviation`, if a size appears twice for a method.
        """
        _check_columns(frame, (size, method, value) + ((deviation,) if deviation else ()))
        curves = {}
        for name, rows in frame.groupby(method, sort=False):
            by_size = rows.groupby(size)
            if deviation is None:
                spread = by_size[value].std(ddof=0).where(by_size[value].count() > 1)
            elif rows[size].duplicated().any():
                raise ValueError(
                    f"with a column of deviations each size appears once a method; {name} has "
                    f"{len(rows)} rows for {rows[size].nunique()} sizes. "
                    "Select or average first, or leave out deviation."
                )
            else:
                spread = by_size[deviation].mean()
            curves[str(name)] = np.column_stack([spread.index, by_size[value].mean(), spread]).astype(float)
        return cls(curves=curves, labels=(size, value)).plot(ax=ax, **options)

    def plot(
        self,
        ax: Axes | None = None,
        *,
        log_size: bool = True,
        log_value: bool = False,
        baseline: float | None = None,
    ) -> Self:
        """Draw.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.
        log_size, log_value : bool
            Whether the axes are logarithmic. On a logarithmic axis bands are cut at half the lowest mean; a linear
            one begins at zero where no band goes below.
        baseline : float, default=None
            A number to compare with, such as the error without transport, as a dashed line.

        Returns
        -------
        LearningCurveDisplay
        """
        self.ax_, self.figure_ = new_axes(ax, size=(5.6, 3.8))
        floor = 0.5 * min(curve[:, 1].min() for curve in self.curves.values()) if log_value else -np.inf
        for k, (name, (sizes, means, deviations)) in enumerate((n, c.T) for n, c in self.curves.items()):
            style: dict[str, Any] = {"color": METHODS[k % len(METHODS)]}
            self.ax_.plot(sizes, means, marker=MARKERS[k % len(MARKERS)], markersize=4, label=name, **style)
            low = np.maximum(means - 2 * deviations, floor)
            self.ax_.fill_between(sizes, low, means + 2 * deviations, alpha=0.16, linewidth=0, **style)
        if baseline is not None:
            self.ax_.axhline(baseline, color=MEASURED, linestyle="--", linewidth=1, label="without transport")
        if log_size:
            self.ax_.set_xscale("log")
            sizes = sorted({size for curve in self.curves.values() for size in curve[:, 0]})
            if len(sizes) <= 8:
                self.ax_.set_xticks(sizes, [f"{size:g}" for size in sizes])
                self.ax_.set_xticks([], minor=True)
        if log_value:
            self.ax_.set_yscale("log")
        elif min((c[:, 1] - 2 * np.nan_to_num(c[:, 2])).min() for c in self.curves.values()) >= 0:
            self.ax_.set_ylim(bottom=0)
        self.ax_.set(xlabel=self.labels[0], ylabel=self.labels[1])
        self.ax_.legend(frameon=False, title="mean, band of 2 standard deviations", title_fontsize="small")
        trim(self.ax_)
        return self


def _check_columns(frame: pd.DataFrame, names: Sequence[str]) -> None:
    missing = [name for name in names if name not in frame.columns]
    if missing:
        raise ValueError(f"the data frame has no column {missing[0]!r}; it has {list(frame.columns)}.")
