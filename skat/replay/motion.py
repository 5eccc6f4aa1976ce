"""Poses of the measured and of the simulated robot over an episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses over an episode.

    Attributes
    ----------
    time : ndarray of shape (n_times,)
        In s, from the episode's first row on.
    measured : ndarray of shape (n_times, n_positions)
        MuJoCo's qpos. What was not measured is held from the row before, or as the model has it at rest.
    simulated : dict of str to ndarray of shape (n_times, n_positions)
        By what they are called. Where a simulation diverges its last pose is held.
    notes : tuple of str
        What was filled in.
    """

    time: Array
    measured: Array
    simulated: dict[str, Array]
    notes: tuple[str, ...] = ()

    def at(self, times: Array) -> Motion:
        """Return the poses in the rows that are nearest to some times."""
        rows = np.clip(np.searchsorted(self.time, times), 1, max(len(self.time) - 1, 1))
        rows -= np.abs(self.time[rows - 1] - times) < np.abs(self.time[rows] - times)
        simulated = {name: poses[rows] for name, poses in self.simulated.items()}
        return Motion(self.time[rows], self.measured[rows], simulated, self.notes)


def motion(
    simulators: Mapping[str, Any], X: Array, y: Array, *, rest: Array, horizon: int | None = None
) -> Motion:
    """Simulate an episode, and return it with what was measured.

    Parameters
    ----------
    simulators : mapping from str to MujocoSimulator
        The first one is the model that the log was read with; others may have further joints and lack none.
    X : array-like of shape (n_rows, n_inputs)
        States and commands of one episode, as the first simulator has them; NaN where not measured.
    y : array-like of shape (n_rows, n_states)
        What followed.
    rest : array-like of shape (n_positions,)
        Pose of the model at rest.
    horizon : int, optional
        Rows after which the simulations start anew from what was measured. By default they run through.

    Returns
    -------
    Motion
    """
    first = next(iter(simulators.values()))
    n_states, n_positions = len(first.state_names), len(rest)
    states = np.vstack([np.asarray(X, dtype=float)[:, :n_states], np.asarray(y, dtype=float)[-1:]])
    commands = np.asarray(X, dtype=float)[:, n_states:]
    notes = []
    lacking = [name for name, column in zip(first.state_names, states.T) if not np.isfinite(column).any()]
    if lacking:
        notes.append(
            f"{', '.join(lacking)} were not measured: positions are as at rest, velocities as positions change."
        )
    known = _filled(states, n_positions, np.asarray(rest, dtype=float), float(first.dt), first.state_names)
    simulated = {}
    for name, simulator in simulators.items():
        own = _states_of(simulator, first, known)
        poses = _rolled_out(simulator, own, commands, horizon)
        if not np.isfinite(poses).all():
            notes.append(f"The simulation {name} diverges: its last pose is held.")
        columns = [simulator.state_names.index(one) for one in first.state_names[:n_positions]]
        simulated[name] = _held(poses[:, columns], known[:, :n_positions])
    time = np.arange(len(states), dtype=float) * float(first.dt)
    return Motion(time, known[:, :n_positions], simulated, tuple(notes))


def _filled(states: Array, n_positions: int, rest: Array, dt: float, names: tuple[str, ...]) -> Array:
    """Return states without gaps: held, at rest where there is nothing to hold, velocities as positions change."""
    filled = states.copy()
    filled[:, :n_positions] = _held(
        states[:, :n_positions], np.broadcast_to(rest, (len(states), n_positions))
    )
    for column in range(n_positions, len(names)):
        if np.isfinite(states[0, column]):
            filled[:, column] = _held(states[:, [column]], np.zeros((len(states), 1)))[:, 0]
            continue
        position = names[column].replace("qvel.", "qpos.", 1)
        # Velocities of quaternions are no difference of columns; at rest is the better guess.
        change: Any = np.zeros(len(states))
        if position in names:
            change = np.gradient(filled[:, names.index(position)], dt)
        filled[:, column] = np.where(np.isfinite(states[:, column]), states[:, column], change)
    return filled


def _held(values: Array, otherwise: Array) -> Array:
    """Return rows in which what is not finite is that of the row before, or of another table where there is none."""
    finite = np.isfinite(values)
    last = np.maximum.accumulate(np.where(finite, np.arange(len(values))[:, None], -1), axis=0)
    held = np.take_along_axis(values, np.maximum(last, 0), axis=0)
    return np.where(last >= 0, held, otherwise)


def _states_of(simulator: Any, first: Any, states: Array) -> Array:
    """Return the states as another simulator has them; joints that it has besides are at zero."""
    missing = [name for name in first.state_names if name not in simulator.state_names]
    if missing:
        raise ValueError(
            f"{simulator!r} lacks {', '.join(missing)}, which the model of the log has: replay the log with the model "
            "that it was diagnosed with, and an extended one that was written from it."
        )
    own = np.zeros((len(states), len(simulator.state_names)))
    for column, name in enumerate(simulator.state_names):
        if name in first.state_names:
            own[:, column] = states[:, first.state_names.index(name)]
    return own


def _rolled_out(simulator: Any, states: Array, commands: Array, horizon: int | None) -> Array:
    """Return the simulated states at all times, started anew every horizon."""
    n_steps = len(commands)
    pieces = min(horizon or n_steps, n_steps)
    starts = np.arange(0, n_steps, pieces)
    inputs = np.zeros((len(starts), pieces, commands.shape[1]))
    for piece, start in enumerate(starts):
        there = commands[start : start + pieces]
        inputs[piece, : len(there)] = there
    paths = simulator.rollout_many(states[starts], inputs, [{}], n_steps=pieces)[0]
    joined = np.concatenate(
        [paths[:, :-1].reshape(-1, paths.shape[2])[:n_steps], np.empty((1, paths.shape[2]))]
    )
    joined[-1] = paths[-1, n_steps - starts[-1]]
    return joined
