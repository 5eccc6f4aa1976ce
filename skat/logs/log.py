"""A log as transitions of a simulator, with what was done to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from skat.simulators import Simulator
from skat.simulators.tables import Array


@dataclass(frozen=True)
class Match:
    """Which column of a file stands for which of the simulator's.

    Attributes
    ----------
    name : str
        The simulator's, or ``time`` or ``episode``.
    theirs : str
        The column in the file; a number where it is held constant.
    unit : str
        As the column has it, such as ``"deg"``; "" is the simulator's own unit.
    how : str
        ``"same name"``, ``"told"``, or how it was guessed.
    """

    name: str
    theirs: str
    unit: str
    how: str


@dataclass(frozen=True)
class Log:
    """Transitions of a simulator, as measured.

    NaN means "not measured": a channel that the log lacks is a column of NaN, a frame that was lost is a row whose
    state is NaN. Commands are never NaN. Within an episode ``y[t]`` is the state in ``X[t + 1]``.

    Attributes
    ----------
    X : ndarray of shape (n_rows, n_inputs)
        State and commands at the start of each transition, in the simulator's units.
    y : ndarray of shape (n_rows, n_states)
        State at its end, ``dt`` later.
    groups : ndarray of int of shape (n_rows,)
        Episode of each row, from 0; its rows are consecutive and evenly spaced by ``dt``.
    group_names : tuple of str
        What the log calls each episode.
    time : ndarray of shape (n_rows,)
        When each transition starts, s, in the log's own clock (less its first stamp where that is a date).
    simulator : Simulator
        The one to use with this log: that which was given, with as many steps, or a time step, that the log's rate
        asks for, and its root welded where ``base="fixed"``. ``simulator.dt`` is ``dt``.
    matches : tuple of Match
        Which column stands for what.
    notes : tuple of str
        All that was done, a sentence each: what was guessed, converted, resampled, lost, left aside.
    interpolation : mapping from name to float
        Of each state channel that was resampled, the standard deviation of the error of that, in the channel's unit.
        Empty where no channel was.
    source : str
        Where it was read from.
    origins : ndarray of int of shape (n_rows,) or None
        Of several logs that were joined, which one each row is of.
    origin_names : tuple of str
        Where these were read from.
    actions : {"commanded", "measured"}
        Whether commands are what motors were told, or efforts that were measured with the positions, as those of a
        ``JointState``.
    """

    X: Array
    y: Array
    groups: NDArray[np.intp]
    group_names: tuple[str, ...]
    time: Array
    simulator: Simulator
    matches: tuple[Match, ...] = ()
    notes: tuple[str, ...] = ()
    interpolation: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    origins: NDArray[np.intp] | None = None
    origin_names: tuple[str, ...] = ()
    actions: str = "commanded"

    def __len__(self) -> int:
        return len(self.X)

    def __repr__(self) -> str:
        return (
            f"<Log of {self.source or 'arrays'}: {len(self)} transitions of {self.dt:g} s, "
            f"{len(self.group_names)} episodes>"
        )

    @property
    def dt(self) -> float:
        """Seconds from row to row."""
        return float(self.simulator.dt)  # type: ignore[arg-type]

    @property
    def measured(self) -> dict[str, float]:
        """Of each state channel, the share of rows in which it was measured, by name; 0 is a channel the log lacks."""
        names = self.simulator.state_names
        shares = np.isfinite(self.X[:, : len(names)]).mean(axis=0) if len(self) else np.zeros(len(names))
        return dict(zip(names, shares.tolist()))

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Names of the state's channels that the log lacks."""
        return tuple(name for name, share in self.measured.items() if share == 0)

    @property
    def floor(self) -> Array:
        """Least variance of each state channel's noise, of shape (n_states,), in the channel's unit squared.

        What resampling has made of it, the square of `interpolation`; 0 where the values are those of the file. No
        model can be held to less than that.
        """
        return np.array([self.interpolation.get(name, 0.0) ** 2 for name in self.simulator.state_names])

    @property
    def table(self) -> pd.DataFrame:
        """Which column was taken for what, to be shown before work begins; a row for each of the simulator's."""
        columns = ("name", "theirs", "unit", "how")
        rows = [{name: getattr(match, name) for name in columns} for match in self.matches]
        return pd.DataFrame(rows, columns=list(columns))

    def rows(self, chosen: Any) -> "Log":
        """Return the log of the chosen rows.

        Parameters
        ----------
        chosen : array-like of bool of shape (n_rows,), slice, or array-like of int
            Where it leaves a gap in an episode, another one begins.
        """
        places = np.arange(len(self))[chosen]
        apart = np.r_[True, (np.diff(places) != 1) | (np.diff(self.groups[places]) != 0)][: len(places)]
        groups = np.cumsum(apart) - 1
        names = tuple(self.group_names[group] for group in self.groups[places][apart])
        return _replaced(
            self,
            X=self.X[places],
            y=self.y[places],
            groups=groups,
            group_names=names,
            time=self.time[places],
            origins=None if self.origins is None else self.origins[places],
        )


def joined(logs: Sequence[Log]) -> Log:
    """Return several logs of one simulator as one, each episode an episode of its own.

    Parameters
    ----------
    logs : sequence of Log

    Raises
    ------
    ValueError
        If there is none, or their columns or time steps differ.
    """
    if not logs:
        raise ValueError("there are no logs to join; give one at least")
    first = logs[0]
    for log in logs[1:]:
        if (
            log.simulator.input_names != first.simulator.input_names
            or abs(log.dt - first.dt) > 1e-9 * first.dt
        ):
            raise ValueError(
                f"{log.source} has rows of {log.dt:g} s, {first.source} of {first.dt:g} s, or other columns: logs "
                "that are diagnosed together have one rate. Give one for all, such as "
                f"rate={1 / max(log.dt, first.dt):g} (on the command line --rate)."
            )
    if len(logs) == 1:
        return first
    if len({log.actions for log in logs}) > 1:
        told = ", ".join(f"{log.source}: {log.actions}" for log in logs)
        raise ValueError(
            f"logs that are diagnosed together have all measured efforts, or all commands; these have {told}."
        )
    offsets = np.cumsum([0, *(len(log.group_names) for log in logs[:-1])])
    several = [log.source for log in logs]
    return _replaced(
        first,
        X=np.concatenate([log.X for log in logs]),
        y=np.concatenate([log.y for log in logs]),
        groups=np.concatenate([log.groups + offset for log, offset in zip(logs, offsets)]),
        group_names=tuple(f"{log.source} {name}" for log in logs for name in log.group_names),
        time=np.concatenate([log.time for log in logs]),
        notes=tuple(f"{log.source}: {note}" for log in logs for note in log.notes),
        interpolation={
            name: max(log.interpolation.get(name, 0.0) for log in logs)
            for log in logs
            for name in log.interpolation
        },
        source=", ".join(several),
        origins=np.repeat(np.arange(len(logs)), [len(log) for log in logs]),
        origin_names=tuple(several),
    )


def _replaced(log: Log, **changes: Any) -> Log:
    from dataclasses import replace

    return replace(log, **changes)
