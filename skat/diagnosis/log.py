"""A measured log as the diagnosis sees it: checked, in episodes, with NaN where nothing was measured."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from sklearn.utils import check_array

from skat.diagnosis.chains import Array, Mask, Places
from skat.diagnosis.statespace import (
    QUATERNION,
    filled_in,
    in_chains,
    quaternions,
    steps_of,
    tangent_mask,
    tangents,
)
from skat.episodes import LEAST_TESTED, drawn_episodes
from skat.simulators import Simulator
from skat.simulators.tables import refuse_text

# Rows, or groups of rows that have something in common: fewer tell nothing.
FEWEST_ROWS = 4
# A split leaves so many rows that are independent.
FEWEST_FITTED_ROWS = 10
# A single episode is split into so many pieces of time.
PIECES = 10
# Rows of which more than this share begin where the one before has ended are in time order.
FOLLOWING = 0.9
# Of a channel's spread, and in its unit: what rounding may put between the end of a row and the begin of the next.
ROUNDING, SMALLEST = 1e-4, 1e-9
# A first look takes so many stretches of a log, each so long (s), with at least and at most so many rows: in shorter
# ones a force that has a memory looks like one that does not change, as causes do.
STRETCHES, STRETCH_S, STRETCH_ROWS = 2, 0.8, (80, 320)


@dataclass(frozen=True)
class Log:
    """Rows of inputs and outputs in episodes.

    `X` (n_rows, n_inputs): NaN in the columns of the state where nothing was measured. `y` (n_rows, n_outputs): NaN
    where nothing was measured. `episodes` (n_rows,): 0, 1, ... in the order of the rows. `consecutive`: whether the
    rows of an episode follow each other in time. `labels`: what the user calls each episode. `simulator`: whose columns
    these are; needed where something was not measured. `sources`: names of the logs that were put together; empty of
    one. `source` (n_rows,): which of them each row is of.
    """

    X: Array
    y: Array
    episodes: Places
    consecutive: bool
    labels: tuple[Any, ...] | None = None
    simulator: Simulator | None = None
    sources: tuple[str, ...] = ()
    source: Places | None = None

    def __len__(self) -> int:
        return len(self.X)

    @property
    def n_episodes(self) -> int:
        """Number of episodes."""
        return int(self.episodes[-1]) + 1 if len(self) else 0

    def label(self, episode: int) -> Any:
        """Return what the user calls an episode."""
        return int(episode) if self.labels is None else self.labels[episode]

    @property
    def steps(self) -> Places:
        """Place of each row in its episode, from 0."""
        return steps_of(self.episodes)

    @property
    def groups(self) -> Places:
        """Episode of each row as a simulator is told it: without time order each row is one."""
        return self.episodes if self.consecutive else np.arange(len(self))

    @property
    def complete(self) -> Mask:
        """Rows in which everything was measured, (n_rows,)."""
        return np.asarray(np.isfinite(self.X).all(axis=1) & np.isfinite(self.y).all(axis=1))

    @property
    def measured(self) -> Mask:
        """Channels of a residual that were measured in any row, (n_residuals,)."""
        seen = np.isfinite(self.y)
        mask = seen if self.simulator is None else tangent_mask(self.simulator, seen)
        return np.asarray(mask.any(axis=0))

    @cached_property
    def filled(self) -> "Log":
        """The log with a guess where nothing was measured: in time, from positions, or by the model.

        A simulator takes no NaN. What follows from a guess is none: compare with `y`.
        """
        if self.complete.all():
            return self
        if self.simulator is None:
            raise ValueError("a log without its simulator cannot be filled: pass simulator=")
        (chain, step), states = in_chains(
            self.simulator, self.X, self.y, self.episodes, consecutive=self.consecutive
        )
        episodes = self.episodes if self.consecutive else None
        guess = filled_in(self.simulator, self.X, episodes, (chain, step), states)
        X, y = self.X.copy(), self.y.copy()
        n_states = len(self.simulator.state_names)
        if n_states:
            X[:, :n_states] = _where_missing(X[:, :n_states], guess[:, :-1][chain, step])
        y = _where_missing(y, guess[:, 1:][chain, step])
        if self.consecutive:
            # Chains that meet at a state that nobody measured may have guessed it differently.
            follows = np.flatnonzero(np.diff(self.episodes) == 0)
            y[follows] = _where_missing(self.y[follows], X[follows + 1, :n_states])
        return replace(self, X=X, y=y)

    def rows(self, chosen: ArrayLike) -> "Log":
        """Return the log of the chosen rows; a gap in time starts a new episode."""
        chosen = np.asarray(chosen)
        chosen = np.flatnonzero(chosen) if chosen.dtype == bool else chosen
        apart = np.r_[False, (np.diff(chosen) != 1) | (np.diff(self.episodes[chosen]) != 0)][: len(chosen)]
        episodes = (
            np.cumsum(apart) if self.consecutive else np.unique(self.episodes[chosen], return_inverse=True)[1]
        )
        labels = None
        if self.labels is not None:
            first = np.unique(episodes, return_index=True)[1]
            labels = tuple(self.labels[episode] for episode in self.episodes[chosen][first])
        source = None if self.source is None else self.source[chosen]
        return replace(
            self,
            X=self.X[chosen],
            y=self.y[chosen],
            episodes=episodes,
            labels=labels,
            source=source,
        )

    @property
    def parts(self) -> list["Log"]:
        """Each of the logs that were put together, by itself; this one if it is one."""
        if self.source is None:
            return [self]
        return [replace(self.rows(self.source == one), source=None) for one in range(len(self.sources))]

    def few(self) -> "Log":
        """Return the few rows that a first look takes of each log.

        Stretches of time, or rows from all over where there is none.
        """
        if self.source is not None:
            return self._of([one.few() for one in self.parts])
        dt = None if self.simulator is None else self.simulator.dt
        length = int(np.clip(STRETCH_S / dt if dt else 0.0, *STRETCH_ROWS))
        return self.stretches(*((STRETCHES, length) if self.consecutive else (STRETCHES * length, 1)))

    def stretches(self, count: int, length: int) -> "Log":
        """Return so many stretches of the log, each of so many rows, from all over; all of it where it has no more."""
        if len(self) <= count * length:
            return self
        starts = ((np.arange(count) + 0.5) * len(self) / count - length / 2).astype(int)
        return self.rows((starts[:, None] + np.arange(length)).ravel())

    def split(self, test_size: float, random_state: np.random.RandomState) -> tuple["Log", "Log | None"]:
        """Return (fitted, held out) logs: whole episodes where there are several, otherwise blocks of time.

        `test_size`: share of the rows to hold out, 0 <= test_size < 1. Returns: None where nothing is held out: nothing
        was asked for, or too little would be left, which is warned of.
        """
        if not test_size:
            return self, None
        if self.source is not None:
            pairs = [one.split(test_size, random_state) for one in self.parts]
            tests = [self.rows(np.zeros(0, dtype=int)) if test is None else test for _, test in pairs]
            return self._of([left for left, _ in pairs]), self._of(tests) if any(map(len, tests)) else None
        held_out = self._held_out(test_size, random_state)
        left = self.rows(~held_out)
        by_rows = self.consecutive or self.n_episodes == len(self)
        enough = len(left) >= FEWEST_FITTED_ROWS and (by_rows or left.n_episodes >= FEWEST_ROWS)
        if not held_out.any() or not enough:
            of = f"{len(self)} rows in {self.n_episodes} {'episodes' if self.consecutive else 'groups'}"
            warnings.warn(
                f"Nothing of {of} is held out to measure the gain: at least {FEWEST_FITTED_ROWS} rows"
                f"{'' if by_rows else f' in {FEWEST_ROWS} groups'} must be left to fit. Pass test_size=0, "
                "measure the gain on another log with evaluate(), or measure longer.",
                UserWarning,
                stacklevel=3,
            )
            return self, None
        if self._is_one_episode(test_size):
            log = (
                "The log is a single episode"
                if self.n_episodes == 1
                else "Nearly all rows are of one episode"
            )
            warnings.warn(
                f"{log}: it is split by blocks of time, so the rows held out are near the rows fitted and the gain may "
                "look better than on a new episode. Give several episodes (groups=), or measure the gain on another "
                "log with evaluate().",
                UserWarning,
                stacklevel=3,
            )
        return left, self.rows(held_out)

    def _of(self, parts: Sequence["Log"]) -> "Log":
        """Return some rows of each of the logs that were put together as these are."""
        offsets = np.cumsum([0, *(one.n_episodes for one in parts)])
        labels = tuple(one.label(episode) for one in parts for episode in range(one.n_episodes))
        return replace(
            self,
            X=np.concatenate([one.X for one in parts]),
            y=np.concatenate([one.y for one in parts]),
            episodes=np.concatenate([one.episodes + offset for one, offset in zip(parts, offsets)]),
            labels=labels,
            source=np.repeat(np.arange(len(parts)), [len(one) for one in parts]),
        )

    def _is_one_episode(self, test_size: float) -> bool:
        """Whether rows follow each other, and all but the longest episode are too few to be held out."""
        others = len(self) - int(np.bincount(self.episodes).max())
        return self.consecutive and others < LEAST_TESTED * test_size * len(self)

    def _held_out(self, test_size: float, random_state: np.random.RandomState) -> Mask:
        n = len(self)
        if self.n_episodes == n and not self.consecutive:
            count = int(np.clip(round(test_size * n), 1, max(1, n - FEWEST_FITTED_ROWS)))
            drawn: Mask = random_state.permutation(n) < count
            return drawn
        if self.n_episodes > 1 and not self._is_one_episode(test_size):
            sizes = np.bincount(self.episodes)
            most = self.n_episodes - (1 if self.consecutive else FEWEST_ROWS)
            episodes = drawn_episodes(sizes, test_size, random_state, most=most, stacklevel=5)
            if not episodes and most > 0:
                episodes = [int(np.argmin(sizes))]
            return np.isin(self.episodes, episodes)
        n_pieces = min(n, PIECES)
        piece = np.arange(n) * n_pieces // n
        fewest_fitted = -(-FEWEST_FITTED_ROWS * n_pieces // n)
        count = max(1, min(round(test_size * n_pieces), n_pieces - fewest_fitted))
        return np.isin(piece, ((np.arange(count) + 1) * n_pieces // count) - 1)


def check_log(
    simulator: Simulator, X: Any, y: Any, groups: ArrayLike | None, *, fewest_rows: int = FEWEST_ROWS
) -> Log:
    """Return the Log of checked rows.

    `X` (n_rows, n_inputs): NaN in columns of the state: not measured. `y` (n_rows, n_outputs): NaN: not measured. Of a
    quaternion all or nothing was measured. `groups` (n_rows,): episode of each row; the rows of an episode are
    consecutive and in time order. Returns: the state between two rows that follow each other is measured in both where
    it is in one of them. Raises a ValueError where the rows cannot be what the simulator takes and gives, with the row
    and the column; where nothing at all was measured.
    """
    n_states = len(simulator.state_names)
    X = check_matrix(X, "X", simulator.input_names, optional=simulator.state_names)
    y = check_matrix(y, "y", simulator.output_names, optional=simulator.output_names)
    if len(X) != len(y):
        raise ValueError(
            f"X has {len(X)} rows and y {len(y)}: each row of y is what followed the same row of X."
        )
    if len(X) < fewest_rows:
        raise ValueError(
            f"The log has {len(X)} rows; a diagnosis needs at least {fewest_rows} to tell an effect from noise. "
            "Measure longer, or join several logs and tell the episodes apart with groups=."
        )
    X[:, :n_states] = _whole_quaternions(simulator.state_names, X[:, :n_states])
    y = _whole_quaternions(simulator.output_names, y)
    if groups is None:
        if n_states and fewest_rows > 1 and _share_that_follows(X[:, :n_states], y) > FOLLOWING:
            warnings.warn(
                "Each row begins where the one before it has ended, but without groups= rows are taken for "
                "independent: noise then counts as if it were another one in y than in the X of the next row, and "
                "what the state's own noise does is not seen. Pass groups=, the episode of each row.",
                UserWarning,
                stacklevel=3,
            )
        return _with_something_measured(Log(X, y, np.arange(len(X)), False, None, simulator))
    episodes, labels = checked_episodes(groups, len(X))
    if not n_states:
        if episodes[-1] == 0:
            episodes = np.arange(len(X))  # One group says nothing of rows without time order.
        n_groups = episodes[-1] + 1
        if fewest_rows > 1 and n_groups < FEWEST_ROWS:
            raise ValueError(
                f"groups tells {n_groups} groups of rows apart, and each counts as one piece of evidence: a diagnosis "
                f"needs at least {FEWEST_ROWS}. Pass groups=None if the rows are independent of each other."
            )
        return _with_something_measured(Log(X, y, episodes, False, None, simulator))
    follows = np.flatnonzero(np.diff(episodes) == 0)
    both = np.isfinite(y[follows]) & np.isfinite(X[follows + 1, :n_states])
    y[follows], X[follows + 1, :n_states] = (
        _where_missing(y[follows], X[follows + 1, :n_states]),
        _where_missing(X[follows + 1, :n_states], y[follows]),
    )
    log = _with_something_measured(Log(X, y, episodes, True, labels, simulator))
    _check_continuity(simulator, log, follows, both)
    if (np.bincount(episodes) == 1).all():
        warnings.warn(
            "Every episode has one row: that the rows are in time order cannot be checked, and noise in the "
            "measured state cannot be told from noise in the next one as well as in longer episodes.",
            UserWarning,
            stacklevel=3,
        )
    return log


def put_together(logs: Sequence[Log], names: Sequence[str]) -> Log:
    """Return several checked logs of one simulator as one that knows which rows are of which.

    Raises a ValueError if the rows of some are in time order, and of others not.
    """
    first = logs[0]
    for name, one in zip(names[1:], logs[1:]):
        if one.consecutive != first.consecutive:
            raise ValueError(
                f"{names[0]} and {name}: the rows of one are in time order, of the other they are not. Give groups, "
                "the episode of each row, with all of them or with none."
            )
    called = [
        replace(one, labels=tuple(f"{name}: {one.label(episode)}" for episode in range(one.n_episodes)))
        for name, one in zip(names, logs)
    ]
    return replace(first, sources=tuple(names))._of(called)


def without_channels(simulator: Simulator, log: Log, names: Iterable[str]) -> Log:
    """Return the log as if some channels of the state, or outputs of a one-shot simulation, had not been measured.

    `names`: A part of a quaternion stands for all of it. Raises a ValueError if there is no such channel, or nothing
    would be left.
    """
    names = list(names)
    known = simulator.output_names
    unknown = [name for name in names if name not in known]
    if unknown:
        kind = "state channels" if simulator.state_names else "outputs"
        raise ValueError(f"hidden names {', '.join(unknown)}; {kind} are {', '.join(known)}.")
    if not names:
        return log
    n_states = len(simulator.state_names)
    columns = [known.index(name) for name in names]
    X, y = log.X.copy(), log.y.copy()
    y[:, columns] = np.nan
    y = _whole_quaternions(known, y)
    if n_states:
        X[:, columns] = np.nan
        X[:, :n_states] = _whole_quaternions(simulator.state_names, X[:, :n_states])
    return _with_something_measured(replace(log, X=X, y=y, simulator=simulator))


def measured_channels(simulator: Simulator, hidden: Sequence[str]) -> Mask:
    """Return for each residual channel whether it was measured, (n_channels,): a rotation as its quaternion was."""
    seen = np.array([name not in set(hidden) for name in simulator.output_names])
    return tangent_mask(simulator, seen)


def tangent_variances(simulator: Simulator, variances: Array) -> Array:
    """Return the variance of the noise of each residual channel, (n_channels,), from that of each output.

    A small turn moves its quaternion by half of it, in the direction of each axis.
    """
    outputs = simulator.output_names
    found = np.empty(len(simulator.residual_names))
    for channel, name in enumerate(simulator.residual_names):
        if name in outputs:
            found[channel] = variances[outputs.index(name)]
        else:
            joint = name[: -len(".rx")]
            found[channel] = 4 * np.mean([variances[outputs.index(f"{joint}.{part}")] for part in QUATERNION])
    return found


def check_matrix(values: Any, what: str, names: Sequence[str], *, optional: Sequence[str] = ()) -> Array:
    """Return rows as an array, the columns of a data frame in the order of the names.

    A single output may be one-dimensional, as scikit-learn's targets are.

    `values` (n_rows, n_columns). `what`: how the caller names the table, for messages. `names`: the columns expected.
    `optional`: columns in which NaN, or nothing in a data frame, stands for what was not measured. Raises a ValueError
    if a column is missing, or a value is no finite number where one has to be.
    """
    if hasattr(values, "columns") and hasattr(values, "to_numpy"):
        known = set(names) & set(values.columns)
        named = bool(known) or all(isinstance(column, str) for column in values.columns)
        if named and len(known) < len(names):
            missing = [name for name in names if name not in known]
            raise ValueError(f"{what} lacks the columns {', '.join(missing)}; expected {', '.join(names)}.")
        values = values[list(names)] if known else values
    if what == "y" and len(names) == 1 and np.ndim(values) == 1:
        values = np.reshape(values, (-1, 1))
    given = values
    try:
        objects = np.asarray(values)
        if objects.dtype == object and objects.ndim == 2:
            values = np.where(pd.isna(objects), np.nan, objects)
        checked = check_array(
            values,
            dtype=np.float64,
            ensure_min_samples=1,
            input_name=what,
            ensure_all_finite="allow-nan",
            copy=True,
        )
    except ValueError as error:
        array = np.asarray(values, dtype=object)
        if array.ndim == 2:
            readable = np.array([[_readable(value) for value in row] for row in array], dtype=bool)
            if readable.size and not readable.all():
                row, column = np.argwhere(~readable)[0]
                raise ValueError(
                    f"{what} has {array[row, column]} in row {row}, column {column}{_named(names, column)}; every "
                    f"value must be a finite number{_or_nan(names, optional)}."
                ) from error
        raise
    refuse_text(given, what)
    if checked.shape[1] != len(names):
        raise ValueError(
            f"{what} has {checked.shape[1]} columns; the simulator's are {len(names)}: {', '.join(names)}."
        )
    needed = [column for column, name in enumerate(names) if name not in set(optional)]
    absent = np.argwhere(np.isnan(checked[:, needed]))
    if len(absent):
        row, column = int(absent[0, 0]), needed[absent[0, 1]]
        raise ValueError(
            f"{what} has nan in row {row}, column {column}{_named(names, column)}; every value must be a finite "
            f"number{_or_nan(names, optional)}. Leave such rows out and start a new episode behind the gap."
        )
    return np.asarray(checked)


def _named(names: Sequence[str], column: int) -> str:
    return f" ({names[column]})" if column < len(names) else ""


def _or_nan(names: Sequence[str], optional: Sequence[str]) -> str:
    if not optional:
        return ""
    where = "" if len(optional) == len(names) else " in a column of the state,"
    return f", or,{where} NaN where nothing was measured" if where else ", or NaN where nothing was measured"


def _readable(value: Any) -> bool:
    """Whether a value is a number that is finite, or NaN."""
    try:
        return not np.isinf(float(value))
    except (TypeError, ValueError):
        return False


def _where_missing(values: Array, others: Array) -> Array:
    return np.where(np.isfinite(values), values, others)


def _whole_quaternions(names: Sequence[str], values: Array) -> Array:
    """Return values with quaternions of which a part is missing missing as a whole."""
    values = values.copy()
    for _, parts in quaternions(names):
        lost = np.isnan(values[:, parts]).any(axis=1, keepdims=True)
        values[:, parts] = np.where(lost, np.nan, values[:, parts])
    return values


def _share_that_follows(states: Array, y: Array) -> float:
    """Return the share of rows that begin where the one before has ended, as far as both were measured."""
    both = np.isfinite(states[1:]) & np.isfinite(y[:-1])
    same = np.asarray(((states[1:] == y[:-1]) | ~both).all(axis=1) & both.any(axis=1))
    return float(same.mean()) if len(same) else 0.0


def checked_episodes(groups: ArrayLike, n_rows: int) -> tuple[Places, tuple[Any, ...]]:
    """Return the number of each row's episode, and what each episode is called."""
    groups = np.asarray(groups)
    if groups.shape != (n_rows,):
        raise ValueError(
            f"groups must name the episode of each of the {n_rows} rows; it has shape {groups.shape}."
        )
    if pd.isna(groups).any():
        raise ValueError(
            f"groups is missing in row {int(np.argmax(pd.isna(groups)))}: name the episode of every row."
        )
    starts: NDArray[np.bool_] = np.r_[True, groups[1:] != groups[:-1]]
    episodes = np.cumsum(starts) - 1
    labels = groups[starts].tolist()
    first = {label: place for place, label in reversed(list(enumerate(labels)))}
    if len(first) < len(labels):
        again = next(place for place, label in enumerate(labels) if first[label] != place)
        row = np.flatnonzero(starts)[again]
        raise ValueError(
            f"Episode {labels[again]!r} goes on at row {row} after rows of another episode. The rows of an episode "
            "must be consecutive, and those of a simulation with a state in time order: sort the log."
        )
    return episodes, tuple(labels)


def _with_something_measured(log: Log) -> Log:
    if not log.measured.any():
        raise ValueError(
            "Every value of y is NaN, so that nothing was measured: there is nothing to compare the simulation with."
        )
    return log


def _check_continuity(simulator: Simulator, log: Log, follows: Places, both: Mask) -> None:
    """Raise where a row ends in another state than that in which the next one begins; `both` were measured."""
    if not len(follows):
        return
    filled = log.filled
    gap = np.abs(simulator.residual(filled.X[follows + 1, : both.shape[1]], filled.y[follows]))
    spread = tangents(simulator, filled.y).std(axis=0)
    wrong = np.argwhere((gap > ROUNDING * spread + SMALLEST) & tangent_mask(simulator, both))
    if len(wrong):
        row, channel = int(follows[wrong[0, 0]]), int(wrong[0, 1])
        raise ValueError(
            f"y of row {row} is not the state in row {row + 1} of X: {simulator.residual_names[channel]} differs by "
            f"{gap[wrong[0, 0], channel]:.3g}. The rows of an episode must be in time order, y the next row's state; "
            "if the log has a gap there, start a new episode (groups=); rows that are independent have no groups."
        )
