"""A measured log as the diagnosis sees it: checked, in episodes, and cut into chains and blocks of time."""

import warnings
from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.utils import check_array

from skat.episodes import FEWEST_ROWS, drawn_episodes
from skat.simulators.tables import refuse_text

# Rows whitened together, and rows that count as one independent piece of evidence.
CHAIN_LENGTH = 60
# Rows of which more than this share begin where the one before has ended are in time order.
FOLLOWING = 0.9
BLOCK_LENGTH = 12
FEWEST_BLOCKS = 20
# Groups of rows that have something in common, in logs without time order.
FEWEST_GROUPS = 5
# A split leaves so many rows that are independent, or groups of rows.
FEWEST_FITTED_ROWS = 10
FEWEST_FITTED_GROUPS = 4


@dataclass(frozen=True)
class Log:
    """Rows of inputs and outputs in episodes.

    Attributes
    ----------
    X : ndarray of shape (n_rows, n_inputs)
    y : ndarray of shape (n_rows, n_outputs)
    episodes : ndarray of int of shape (n_rows,)
        0, 1, ... in the order of the rows.
    consecutive : bool
        Whether the rows of an episode follow each other in time.
    labels : tuple or None
        What the user calls each episode.
    """

    X: np.ndarray
    y: np.ndarray
    episodes: np.ndarray
    consecutive: bool
    labels: tuple | None = None

    def __len__(self):
        return len(self.X)

    @property
    def n_episodes(self):
        """Number of episodes."""
        return int(self.episodes[-1]) + 1 if len(self) else 0

    def label(self, episode):
        """Return what the user calls an episode."""
        return int(episode) if self.labels is None else self.labels[episode]

    @property
    def steps(self):
        """Place of each row in its episode, from 0."""
        starts = np.flatnonzero(np.r_[True, np.diff(self.episodes) > 0])
        return np.arange(len(self)) - starts[self.episodes]

    @property
    def groups(self):
        """Episode of each row as a simulator is told it: without time order each row is one."""
        return self.episodes if self.consecutive else np.arange(len(self))

    def rows(self, chosen):
        """Return the log of the chosen rows; a gap in time starts a new episode."""
        chosen = np.flatnonzero(chosen) if np.asarray(chosen).dtype == bool else np.asarray(chosen)
        apart = np.r_[False, (np.diff(chosen) != 1) | (np.diff(self.episodes[chosen]) != 0)]
        episodes = (
            np.cumsum(apart) if self.consecutive else np.unique(self.episodes[chosen], return_inverse=True)[1]
        )
        labels = None
        if self.labels is not None:
            first = np.unique(episodes, return_index=True)[1]
            labels = tuple(self.labels[episode] for episode in self.episodes[chosen][first])
        return Log(self.X[chosen], self.y[chosen], episodes, self.consecutive, labels)

    def part(self, n_rows, length):
        """Return about so many rows that stand for the log: runs of a length, spread over it."""
        length = min(length, len(self))
        starts = np.linspace(0, len(self) - length, max(1, n_rows // length)).astype(int)
        return self.rows(np.unique(starts[:, None] + np.arange(length)))

    def chains(self):
        """Return (chain, step) of each row: pieces of an episode short enough to be whitened side by side."""
        if not self.consecutive:
            return np.arange(len(self)), np.zeros(len(self), dtype=int)
        steps = self.steps
        new = np.r_[True, (np.diff(self.episodes) > 0) | (steps[1:] % CHAIN_LENGTH == 0)]
        return np.cumsum(new) - 1, steps % CHAIN_LENGTH

    def blocks(self):
        """Return the block of each row: pieces of time short against an episode, long against contacts' echoes."""
        if not self.consecutive:
            return self.episodes
        length = int(np.clip(len(self) // FEWEST_BLOCKS, 1, BLOCK_LENGTH))
        new = np.r_[True, (np.diff(self.episodes) > 0) | (self.steps[1:] % length == 0)]
        return np.cumsum(new) - 1

    def split(self, test_size, random_state):
        """Return (fitted, held out) logs: whole episodes where there are several, otherwise blocks of time.

        Parameters
        ----------
        test_size : float
            Share of the rows to hold out, 0 <= test_size < 1.
        random_state : numpy.random.RandomState
        """
        if not test_size:
            return self, None
        if self.n_episodes == len(self) and not self.consecutive:
            count = int(np.clip(round(test_size * len(self)), 1, max(1, len(self) - FEWEST_FITTED_ROWS)))
            held_out = random_state.permutation(len(self)) < count
            return self.rows(~held_out), self.rows(held_out)
        if self.n_episodes > 1:
            sizes = np.bincount(self.episodes)
            most = self.n_episodes - (1 if self.consecutive else FEWEST_FITTED_GROUPS)
            drawn = drawn_episodes(sizes, test_size, random_state, most=most, stacklevel=4)
            held_out = np.isin(self.episodes, drawn or [int(np.argmin(sizes))])
            return self.rows(~held_out), self.rows(held_out)
        warnings.warn(
            "The log is a single episode: it is split by blocks of time, so the rows held out are near the rows "
            "fitted and the gain may look better than on a new episode. Give several episodes (groups=), or "
            "measure the gain on another log with evaluate().",
            UserWarning,
            stacklevel=3,
        )
        n_pieces = max(4, min(20, len(self) // FEWEST_ROWS))
        piece = np.arange(len(self)) * n_pieces // len(self)
        fewest_fitted = -(-FEWEST_FITTED_ROWS * n_pieces // len(self))
        count = int(np.clip(round(test_size * n_pieces), 1, n_pieces - fewest_fitted))
        held_out = np.isin(piece, ((np.arange(count) + 1) * n_pieces // count) - 1)
        return self.rows(~held_out), self.rows(held_out)


def measured_channels(simulator, hidden):
    """Return for each residual channel whether it was measured, (n_channels,): a rotation as its quaternion was."""
    turned = [name[: -len(".qw")] for name in hidden if name.endswith(".qw")]
    unmeasured = {*hidden, *(f"{joint}.{axis}" for joint in turned for axis in ("rx", "ry", "rz"))}
    return np.array([name not in unmeasured for name in simulator.residual_names])


def check_log(simulator, X, y, groups, *, fewest_rows=FEWEST_ROWS, hidden=()):
    """Return the Log of checked rows.

    Parameters
    ----------
    simulator : Simulator
    X : array-like of shape (n_rows, n_inputs)
    y : array-like of shape (n_rows, n_outputs)
    groups : array-like of shape (n_rows,) or None
        Episode of each row; the rows of an episode are consecutive and in time order.
    fewest_rows : int, default=20
    hidden : sequence of str, default=()
        State channels that were not measured: not compared between rows.

    Raises
    ------
    ValueError
        Where the rows cannot be what the simulator takes and gives, with the row and the column.
    """
    X = check_matrix(X, "X", simulator.input_names)
    y = check_matrix(y, "y", simulator.output_names)
    if len(X) != len(y):
        raise ValueError(
            f"X has {len(X)} rows and y {len(y)}: each row of y is what followed the same row of X."
        )
    if len(X) < fewest_rows:
        raise ValueError(
            f"The log has {len(X)} rows; a diagnosis needs at least {fewest_rows} to tell an effect from noise. "
            "Measure longer, or join several logs and tell the episodes apart with groups=."
        )
    if groups is None:
        state = len(simulator.state_names)
        if state and fewest_rows > 1 and np.mean(np.all(X[1:, :state] == y[:-1], axis=1)) > FOLLOWING:
            warnings.warn(
                "Each row begins where the one before it has ended, but without groups= rows are taken for "
                "independent: noise then counts as if it were another one in y than in the X of the next row, and "
                "what the state's own noise does is not seen. Pass groups=, the episode of each row.",
                UserWarning,
                stacklevel=3,
            )
        return Log(X, y, np.arange(len(X)), False)
    groups = np.asarray(groups)
    if groups.shape != (len(X),):
        raise ValueError(
            f"groups must name the episode of each of the {len(X)} rows; it has shape {groups.shape}."
        )
    if pd.isna(groups).any():
        raise ValueError(
            f"groups is missing in row {int(np.argmax(pd.isna(groups)))}: name the episode of every row."
        )
    starts = np.r_[True, groups[1:] != groups[:-1]]
    episodes = np.cumsum(starts) - 1
    if len(np.unique(groups)) <= episodes[-1]:
        labels = groups[starts]
        first = {label: place for place, label in reversed(list(enumerate(labels)))}
        again = next(place for place, label in enumerate(labels) if first[label] != place)
        row = np.flatnonzero(starts)[again]
        raise ValueError(
            f"Episode {groups[row]!r} goes on at row {row} after rows of another episode. The rows of an episode must "
            "be consecutive and in time order: sort the log by episode and time."
        )
    if not simulator.state_names and episodes[-1] == 0:
        episodes = np.arange(len(X))  # One group says nothing of rows without time order.
    n_groups = episodes[-1] + 1
    if not simulator.state_names and fewest_rows > 1 and n_groups < FEWEST_GROUPS:
        raise ValueError(
            f"groups tells {n_groups} groups of rows apart, and each counts as one piece of evidence: a diagnosis "
            f"needs at least {FEWEST_GROUPS}. Pass groups=None if the rows are independent of each other."
        )
    labels = tuple(groups[starts].tolist()) if simulator.state_names else None
    log = Log(X, y, episodes, bool(simulator.state_names), labels)
    if log.consecutive:
        _check_continuity(simulator, log, hidden)
        if (np.bincount(episodes) == 1).all():
            warnings.warn(
                "Every episode has one row: that the rows are in time order cannot be checked, and noise in the "
                "measured state cannot be told from noise in the next one as well as in longer episodes.",
                UserWarning,
                stacklevel=3,
            )
    return log


def check_matrix(values, what, names):
    """Return rows as an array, the columns of a data frame in the order of the names.

    A single output may be one-dimensional, as scikit-learn's targets are.

    Raises
    ------
    ValueError
        If a column is missing or a value is no finite number.
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
        values = check_array(values, dtype=np.float64, ensure_min_samples=1, input_name=what)
    except ValueError as error:
        array = np.asarray(values, dtype=object)
        if array.ndim == 2:
            numbers = np.array([[_number(value) for value in row] for row in array], dtype=float)
            if numbers.size and not np.isfinite(numbers).all():
                row, column = np.argwhere(~np.isfinite(numbers))[0]
                name = f" ({names[column]})" if column < len(names) else ""
                raise ValueError(
                    f"{what} has {array[row, column]} in row {row}, column {column}{name}; every value must be "
                    "a finite number. Leave such rows out and start a new episode behind the gap."
                ) from error
        raise
    refuse_text(given, what)
    if values.shape[1] != len(names):
        raise ValueError(
            f"{what} has {values.shape[1]} columns; the simulator's are {len(names)}: {', '.join(names)}."
        )
    return values


def _number(value):
    try:
        return float(value)
    except (TypeError, ValueError):
        return np.nan


def _check_continuity(simulator, log, hidden):
    follows = np.flatnonzero(np.diff(log.episodes) == 0)
    if not len(follows):
        return
    state = len(simulator.state_names)
    gap = np.abs(simulator.residual(log.X[follows + 1][:, :state], log.y[follows]))
    measured = np.flatnonzero(measured_channels(simulator, hidden))
    spread = simulator.residual(log.y, np.broadcast_to(log.y[:1], log.y.shape)).std(axis=0)
    wrong = np.argwhere(gap[:, measured] > 1e-4 * spread[measured] + 1e-9)
    if len(wrong):
        row, channel = int(follows[wrong[0, 0]]), int(measured[wrong[0, 1]])
        raise ValueError(
            f"y of row {row} is not the state in row {row + 1} of X: {simulator.residual_names[channel]} differs by "
            f"{gap[wrong[0, 0], channel]:.3g}. The rows of an episode must be in time order, y the next row's state; "
            "if the log has a gap there, start a new episode (groups=); if its rows are independent, pass groups=None."
        )
