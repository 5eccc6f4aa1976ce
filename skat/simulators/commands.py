"""What acts of the commands: scaled, shifted, late, within their range, filtered, with a dead zone.

All of it follows from the commands alone. Commands hold from row to row; before an episode's first row its own first
command is taken to have held for ever.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skat.simulators.tables import Array, earlier_rows


@dataclass(frozen=True)
class CommandPath:
    """What lies between the commands of a log and the actuators, an entry for each of them.

    Attributes
    ----------
    scale, bias : ndarray of shape (nu,)
        What acts is scale * command + bias.
    held, delay : ndarray of shape (nu,)
        s. The first in whole time steps, up to which it is rounded; the second on top of it, linear between them.
    lag : ndarray of shape (nu,)
        Time constant of a filter of first order, s.
    dead_zone : ndarray of shape (nu,)
        Half of the width within which a command does nothing; beyond, it acts as much less.
    """

    scale: Array
    bias: Array
    held: Array
    delay: Array
    lag: Array
    dead_zone: Array

    @property
    def changes(self) -> bool:
        """Whether anything but the command itself acts."""
        return bool(
            (self.scale != 1).any()
            or any(values.any() for values in (self.bias, self.held, self.delay, self.lag, self.dead_zone))
        )

    def n_lags(self, dt: float, n_substeps: int) -> int:
        """Return how many earlier rows' commands are on the way, at most."""
        return math.ceil(float(self._late_by(dt, n_substeps).max(initial=0.0)) / n_substeps - 1e-9)

    def _late_by(self, dt: float, n_substeps: int) -> Array:
        """Return how late the command of each actuator is, in time steps."""
        per_step = n_substeps / dt
        late: Array = np.ceil(self.held * per_step - 1e-9) + self.delay * per_step
        return late

    def acting(
        self,
        commands: Array,
        starts: NDArray[np.intp],
        dt: float,
        n_substeps: int,
        limits: tuple[Array | float, Array | float] = (-np.inf, np.inf),
    ) -> Array:
        """Return what acts in each time step.

        Parameters
        ----------
        commands : ndarray of shape (n_rows, nu)
        starts : ndarray of shape (n_rows,)
            First row of each row's episode.
        dt : float
            Duration of a row, s.
        n_substeps : int
            Time steps of a row.
        limits : pair of ndarray of shape (nu,)
            Ends of the range that late commands are put into, as MuJoCo does, before anything filters them.

        Returns
        -------
        ndarray of shape (n_rows, n_substeps, nu)
        """
        commands = self.scale * commands + self.bias
        n_lags, late_by = self.n_lags(dt, n_substeps), self._late_by(dt, n_substeps)
        history = earlier_rows(commands, starts, n_lags) if n_lags else None
        acts = np.repeat(commands[:, None], n_substeps, axis=1)
        for steps in np.unique(late_by[late_by > 0]):
            late = np.flatnonzero(late_by == steps)
            past = history[:, :, late] if history is not None else None
            acts[:, :, late] = delayed_controls(commands[:, late], past, steps, n_substeps)
        acts = np.clip(acts, *limits)
        if self.lag.any():
            acts = filtered(acts, starts, self.lag * n_substeps / dt)
        return acts - np.clip(acts, -self.dead_zone, self.dead_zone)


def delayed_controls(controls: Array, history: Array | None, lag: float, n_substeps: int) -> Array:
    """Return the controls of each substep that come ``lag`` substeps late, linear between substeps.

    Parameters
    ----------
    controls : ndarray of shape (n_rows, nu)
    history : ndarray of shape (n_rows, n_lags, nu)
        Controls of the transitions before: one back, two back, ...
    lag : float
    n_substeps : int

    Returns
    -------
    ndarray of shape (n_rows, n_substeps, nu)
    """
    known = controls[:, None] if history is None else np.concatenate([controls[:, None], history], axis=1)
    delayed = np.empty((len(controls), n_substeps, controls.shape[1]))
    for substep in range(n_substeps):
        moment = substep - lag
        before = math.floor(moment + 1e-9)
        weight = moment - before
        earlier, later = (
            known[:, -math.floor(index / n_substeps)] for index in (before, min(before + 1, substep))
        )
        delayed[:, substep] = earlier if weight <= 1e-9 else (1 - weight) * earlier + weight * later
    return delayed


def filtered(acts: Array, starts: NDArray[np.intp], lags: Sequence[float] | Array) -> Array:
    """Return what filters of first order, in steady state as each episode begins, make of piecewise constant inputs.

    Exactly, the mean over each substep: what something much slower feels. MuJoCo's ``actearly`` has the substep's end.

    Parameters
    ----------
    acts : ndarray of shape (n_rows, n_substeps, nu)
    starts : ndarray of shape (n_rows,)
    lags : sequence of nu floats
        Time constants, in substeps; 0: no filter.
    """
    from scipy.signal import lfilter  # loads slowly, for commands that few models filter

    found = np.array(acts)
    for start in np.unique(starts):
        rows = slice(*_span(starts, start))
        path = acts[rows].reshape(-1, acts.shape[2])
        for column, lag in enumerate(lags):
            if lag > 0:
                # Of what the filter held as a substep began, so much is left at its end, and in its mean.
                left, mean = math.exp(-1 / lag), lag * -math.expm1(-1 / lag)
                weights = [1 - mean, mean * (1 - left) - (1 - mean) * left]
                values, _ = lfilter(weights, [1, -left], path[:, column], zi=[mean * path[0, column]])
                found[rows, :, column] = values.reshape(-1, acts.shape[1])
    return found


def _span(starts: NDArray[np.intp], start: int) -> tuple[int, int]:
    return int(start), int(np.searchsorted(starts, start, side="right"))
