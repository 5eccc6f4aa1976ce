"""Figures of a diagnosis: channels over time, and causes with their intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from skat.plotting.style import AFTER, BEFORE, MEASURED, column_of, new_axes, trim
from skat.rounding import interval_text, number, size_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray


class TrajectoryDisplay:
    """A measured trajectory against the simulation before and after, over time.

    Use `from_estimator` or `from_predictions`.

    Parameters
    ----------
    time : ndarray of shape (n_times,)
        In s.
    measured, before, after : ndarray of shape (n_times, n_channels)
        `after` may be None.
    names : sequence of str
        Names of the channels.
    units : mapping from name to str, default=None
        Units of channels, as far as they are known.

    Attributes
    ----------
    ax_ : ndarray of matplotlib Axes of shape (n_channels,)
        One for each channel, from top to bottom.
    figure_ : matplotlib Figure
        The figure around them.

    Examples
    --------
    >>> time = np.linspace(0, 1, 50)
    >>> fall = np.column_stack([1 - 4.9 * time**2, -9.8 * time])
    >>> display = TrajectoryDisplay.from_predictions(time, fall, 1.1 * fall, names=["height", "velocity"])
    >>> [ax.get_ylabel() for ax in display.ax_]
    ['height', 'velocity']
    """

    def __init__(
        self,
        *,
        time: NDArray[np.float64],
        measured: NDArray[np.float64],
        before: NDArray[np.float64],
        after: NDArray[np.float64] | None,
        names: Sequence[str],
        units: Mapping[str, str] | None = None,
    ) -> None:
        self.time = time
        self.measured = measured
        self.before = before
        self.after = after
        self.names = names
        self.units = units

    @classmethod
    def from_estimator(
        cls,
        diagnosis: Any,
        X: Any,
        y: Any,
        *,
        channels: Sequence[str] | None = None,
        ax: Axes | None = None,
    ) -> Self:
        """Draw one episode, simulated open loop from its first measured state.

        X and y do not say where an episode ends: rows of several are drawn as if they were one, wrongly. Pass those
        of one, such as ``X[groups == 3]``.

        Parameters
        ----------
        diagnosis : fitted SimulationDiagnosis
            Anything with ``simulator`` and ``extended_simulator_``.
        X : array-like of shape (n_rows, n_inputs)
            The episode's rows: state, then other inputs.
        y : array-like of shape (n_rows, n_states)
            Its next states.
        channels : sequence of str, default=None
            Which states to show; all by default.
        ax : sequence of matplotlib Axes, default=None
            One for each channel; a new figure by default.

        Returns
        -------
        TrajectoryDisplay

        Raises
        ------
        ValueError
            If the simulation has no state, or a channel is unknown.
        """
        simulator = diagnosis.simulator
        names = tuple(simulator.state_names)
        if not names:
            raise ValueError(
                "a trajectory needs a simulation with a state; this one maps inputs to outputs in one step. "
                "Compare its outputs by TransportDisplay instead."
            )
        X, y = _in_order(X, simulator.input_names), _in_order(y, simulator.output_names)
        states, inputs = X[:, : len(names)], X[np.newaxis, :, len(names) :]
        measured = np.vstack([states[:1], y])
        before, after = (
            each.rollout(states[:1], inputs, n_steps=len(X))[0]
            for each in (simulator, diagnosis.extended_simulator_)
        )
        time = np.arange(len(measured)) * (1.0 if simulator.dt is None else simulator.dt)
        display = cls.from_predictions(
            time, measured, before, after, names=names, channels=channels, units=simulator.units, ax=ax
        )
        if simulator.dt is None:
            display.ax_[-1].set_xlabel("step")
        return display

    @classmethod
    def from_predictions(
        cls,
        time: Any,
        measured: Any,
        before: Any,
        after: Any = None,
        *,
        names: Sequence[str],
        channels: Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
        ax: Axes | None = None,
    ) -> Self:
        """Draw trajectories computed before.

        Parameters
        ----------
        time : array-like of shape (n_times,)
            In s.
        measured, before : array-like of shape (n_times, n_channels)
            The measurement and the simulation as given; rows may be NaN where there is none.
        after : array-like of shape (n_times, n_channels), default=None
            The simulation after transport or diagnosis.
        names : sequence of str
            Names of the channels.
        channels : sequence of str, default=None
            Which of them to show; all by default.
        units : mapping from name to str, default=None
            Units of channels, as far as they are known.
        ax : sequence of matplotlib Axes, default=None
            One for each channel; a new figure by default.

        Returns
        -------
        TrajectoryDisplay

        Raises
        ------
        ValueError
            If shapes do not fit or a channel is unknown.
        """
        time, names = np.asarray(time, dtype=float), list(names)
        rows = {"measured": measured, "before": before, "after": after}
        rows = {name: np.asarray(part, dtype=float) for name, part in rows.items() if part is not None}
        for name, part in rows.items():
            if part.shape != (len(time), len(names)):
                raise ValueError(
                    f"{name} must have a row per time and a column per name, "
                    f"shape ({len(time)}, {len(names)}); its shape is {part.shape}."
                )
        columns = [
            column_of(channel, names, len(names)) for channel in (names if channels is None else channels)
        ]
        measured, before, after = (
            rows[name][:, columns] if name in rows else None for name in ("measured", "before", "after")
        )
        shown = [names[k] for k in columns]
        return cls(time=time, measured=measured, before=before, after=after, names=shown, units=units).plot(
            ax=ax
        )

    def plot(self, ax: Any = None) -> Self:
        """Draw.

        Parameters
        ----------
        ax : sequence of matplotlib Axes, default=None
            One for each channel; a new figure by default.

        Returns
        -------
        TrajectoryDisplay

        Raises
        ------
        ValueError
            If there are fewer or more Axes than channels.
        """
        from matplotlib import pyplot

        n_channels = len(self.names)
        if ax is None:
            size = (6.4, 0.9 + 1.45 * n_channels)
            _, ax = pyplot.subplots(
                n_channels, squeeze=False, sharex=True, figsize=size, layout="constrained"
            )
        self.ax_ = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
        if len(self.ax_) != n_channels:
            raise ValueError(
                f"each of the {n_channels} channels needs its own Axes; there are {len(self.ax_)}."
            )
        self.figure_ = self.ax_[0].figure
        for k, (axes, name) in enumerate(zip(self.ax_, self.names)):
            axes.plot(
                self.time, self.measured[:, k], color=MEASURED, linewidth=2.5, alpha=0.7, label="measured"
            )
            axes.plot(self.time, self.before[:, k], color=BEFORE, linestyle="--", label="simulated, before")
            if self.after is not None:
                axes.plot(self.time, self.after[:, k], color=AFTER, linewidth=1.2, label="simulated, after")
            axes.set_ylabel(with_unit(name, (self.units or {}).get(name)))
            trim(axes)
        self.figure_.align_ylabels(list(self.ax_))
        self.ax_[-1].set_xlabel("time (s)")
        self.ax_[0].legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False)
        return self


class CauseDisplay:
    """Named causes and their intervals, each relative to the value at which it would do nothing.

    Causes have different units, so each has a scale of its own: the neutral value is at the line in the
    middle, and the end of the interval that is furthest from it at one edge. Numbers and units stand beside
    them. Use `from_estimator` or `from_causes`.

    Parameters
    ----------
    names, units : sequence of str
        Of the causes.
    values, neutrals : ndarray of shape (n_causes,)
        Estimates, and the values that leave the simulation as it is.
    intervals : ndarray of shape (n_causes, 2)
        Lower and upper ends.

    Attributes
    ----------
    ax_ : matplotlib Axes
        Where it is drawn.
    figure_ : matplotlib Figure
        The figure around it.

    Examples
    --------
    >>> display = CauseDisplay(
    ...     names=["mass[torso]"], units=["1"], values=[1.08], neutrals=[1.0], intervals=[(1.05, 1.11)]
    ... )
    >>> [text.get_text() for text in display.plot().ax_.get_yticklabels()]
    ['mass[torso]']
    """

    def __init__(
        self,
        *,
        names: Sequence[str],
        units: Sequence[str],
        values: Sequence[float],
        neutrals: Sequence[float],
        intervals: Sequence[tuple[float, float]],
    ) -> None:
        self.names = names
        self.units = units
        self.values = values
        self.neutrals = neutrals
        self.intervals = intervals

    @classmethod
    def from_estimator(cls, diagnosis: Any, *, ax: Axes | None = None) -> Self:
        """Draw what a diagnosis has named.

        Parameters
        ----------
        diagnosis : fitted SimulationDiagnosis
            Anything with ``causes_`` and a ``simulator`` that knows its ``effects(also="all")``.
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.

        Returns
        -------
        CauseDisplay
        """
        neutral = {effect.name: effect.neutral for effect in diagnosis.simulator.effects(also="all")}
        return cls.from_causes(diagnosis.causes_, neutral=neutral, ax=ax)

    @classmethod
    def from_causes(
        cls, causes: Sequence[Any], *, neutral: Mapping[str, float], ax: Axes | None = None
    ) -> Self:
        """Draw causes.

        Parameters
        ----------
        causes : sequence of Cause
            Anything with ``name``, ``value``, ``interval`` and ``unit``.
        neutral : dict of str to float
            For each name the value that leaves the simulation as it is.
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.

        Returns
        -------
        CauseDisplay

        Raises
        ------
        ValueError
            If a cause has no neutral value.
        """
        missing = [cause.name for cause in causes if cause.name not in neutral]
        if missing:
            raise ValueError(f"neutral has no value for {missing}; it has values for {sorted(neutral)}.")
        display = cls(
            names=[cause.name for cause in causes],
            units=[cause.unit for cause in causes],
            values=[cause.value for cause in causes],
            neutrals=[neutral[cause.name] for cause in causes],
            intervals=[cause.interval for cause in causes],
        )
        return display.plot(ax=ax)

    def plot(self, ax: Axes | None = None) -> Self:
        """Draw.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            Where to draw; a new figure by default.

        Returns
        -------
        CauseDisplay
        """
        n_causes = len(self.names)
        sizes = [self._size_of(row) for row in range(n_causes)]
        # Names and sizes stand beside what is drawn, and must not take its place.
        letters = sum(max(map(len, texts), default=0) for texts in (self.names, sizes))
        self.ax_, self.figure_ = new_axes(
            ax, size=(max(6.8, 3.0 + 0.08 * letters), 0.9 + 0.5 * max(n_causes, 1))
        )
        values, neutrals = np.asarray(self.values, dtype=float), np.asarray(self.neutrals, dtype=float)
        ends = np.asarray(self.intervals, dtype=float).reshape(n_causes, 2)
        away = np.abs(np.column_stack([values, ends]) - neutrals[:, np.newaxis]).max(axis=1, initial=0)
        scale = np.where(away > 0, away, 1.0)
        rows = np.arange(n_causes)
        low, middle, high = ((each - neutrals) / scale for each in (ends[:, 0], values, ends[:, 1]))
        self.ax_.axvline(0, color=MEASURED, linewidth=1)
        self.ax_.hlines(
            rows, np.minimum(0, middle), np.maximum(0, middle), color=AFTER, alpha=0.3, linewidth=1.5
        )
        self.ax_.hlines(rows, low, high, color=AFTER, linewidth=5, alpha=0.45)
        self.ax_.plot(middle, rows, "o", color=AFTER, markersize=7)
        for row, text in enumerate(sizes):
            self.ax_.text(1.12, row, text, va="center", fontsize=9)
        if not n_causes:
            self.ax_.text(0.05, 0, "nothing named", va="center")
        self.ax_.set_yticks(rows, self.names)
        self.ax_.set(xlim=(-1.08, 1.08), ylim=(max(n_causes, 1) - 0.5, -0.5))
        self.ax_.set_xticks([0], ["neutral"])
        self.ax_.tick_params(length=0)
        trim(self.ax_)
        self.ax_.spines["bottom"].set_visible(False)
        self.ax_.spines["left"].set_visible(False)
        return self

    def _size_of(self, row: int) -> str:
        """Return a cause's size with its interval, in words."""
        least, most = self.intervals[row]
        interval = float(least), float(most)
        unit = "" if self.units[row] in ("", "1") else f" {self.units[row]}"
        size = f"{size_text(float(self.values[row]), interval)}{unit}"
        return f"{size}  ({interval_text(interval)}; neutral {number(float(self.neutrals[row]))})"


def with_unit(text: str, unit: str | None) -> str:
    """Return the text of an axis and, below it, the unit in brackets, if it is known and not 1."""
    return text if unit in (None, "", "1") else f"{text}\n({unit})"


def _in_order(rows: Any, names: Sequence[str]) -> NDArray[np.float64]:
    """Return rows as an array, the columns of a data frame in the order of the names."""
    if hasattr(rows, "columns") and set(names) <= set(rows.columns):
        rows = rows[list(names)]
    return np.asarray(rows, dtype=float)
