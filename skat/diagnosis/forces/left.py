"""What is left of measured efforts beside the causes: how large it is on each joint, and what predicts it.

As `skat.diagnosis.remainder` has it of a log whose commands move the machine, with the rows of a regression in forces
for whitened innovations: laws of a joint's own position and speed, and of those of others; not of the efforts, which
are what is to be predicted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from skat.diagnosis.chains import Array
from skat.diagnosis.evidence import WIDTH_95
from skat.diagnosis.forces.force_space import Motion, Rows, transformed
from skat.diagnosis.forces.machines import Model
from skat.diagnosis.forces.motions import lacking_forces
from skat.diagnosis.remainder import (
    LONGEST_TABLE,
    MOST_COLUMNS,
    OTHER_BINS,
    OWN_BINS,
    Law,
    Left,
    Regressor,
    Remainder,
    binned,
    bins_of,
    single,
    word_of,
    worth_of,
)
from skat.simulators import MujocoSimulator

# Of the frequencies that are compared, for a spectrum.
BANDS = 16


@dataclass(frozen=True)
class _Joint:
    """What is left of a joint's force.

    Attributes
    ----------
    half : Motion
        The motion of the whole machine.
    place : int
    whitened, noise : ndarray of shape (n_rows,)
        Of the joint's rows: what is left over its noise, and the noise, N or N m.
    second : ndarray of bool of shape (n_rows,)
        Whether a row is of the second half of the log, stretches in turns.
    """

    half: Motion
    place: int
    whitened: Array
    noise: Array
    second: Array

    def response(self, columns: Array) -> Array:
        """Return the whitened rows of forces (n_blocks, k) on the joint."""
        own = replace(self.half, cutoff=self.half.cutoff[[self.place]])
        return transformed(own, columns[:, None, :])[0] / self.noise[:, None]

    def quadratic(self, columns: Array, half: bool | None = None) -> tuple[Array, Array]:
        """Return G and b of forces (n_blocks, k), of all rows or of those of a half."""
        rows, left = self.response(columns), self.whitened
        if half is not None:
            rows, left = rows[self.second == half], left[self.second == half]
        return rows.T @ rows, rows.T @ left


def left_of_efforts(
    simulator: MujocoSimulator, half: Motion, rows: Rows, left: Array, noise: Array
) -> Remainder:
    """Return what is left of measured efforts.

    Parameters
    ----------
    simulator : MujocoSimulator
    half : Motion
    rows : Rows
        Of which only places are taken.
    left, noise : ndarray of shape (n_rows,)
        What the causes leave of each row, and its noise, N or N m.
    """
    nv = half.accelerations.shape[1]
    unpowered = replace(half, commands=np.zeros_like(half.commands))
    needed = lacking_forces(simulator, unpowered, [Model({})])[0, :, :nv]
    scales = np.sqrt(np.mean(needed**2, axis=0))
    parts = []
    for place in range(nv):
        own = rows.joint == place
        stretches = np.unique(rows.stretch[own], return_inverse=True)[1]
        joint = _Joint(half, place, left[own] / noise[own], noise[own], stretches % 2 == 1)
        spectrum = _spectrum(rows.frequency[own], left[own], half.duration)
        parts.append(_left(simulator, joint, float(scales[place]), left[own], spectrum))
    return Remainder(tuple(sorted(parts, key=lambda part: -part.evidence)), 1)


def _left(
    simulator: MujocoSimulator,
    joint: _Joint,
    scale: float,
    left: Array,
    spectrum: tuple[Array, Array],
) -> Left:
    names = simulator.state_names
    nv, states = len(names) // 2, joint.half.states
    regressors = _regressors(names, states, joint.place)
    n_own = sum(one.is_own for one in regressors)
    tried = []
    for one in regressors:
        nats, size = worth_of(*joint.quadratic(one.columns), scale)
        tried.append(
            (nats, nats + np.log(0.5 / (n_own if one.is_own else len(regressors) - n_own)), size, one)
        )
    ranked = sorted(tried, key=lambda entry: -entry[1])
    _, _, size, chosen = ranked[0]
    ridge = np.eye(chosen.columns.shape[1]) / size**2
    predicted = []
    for which in (False, True):
        G, b = joint.quadratic(chosen.columns, which)
        predicted.append(chosen.columns @ np.linalg.solve(G + ridge, b))
    edges, columns = bins_of(chosen.values, OWN_BINS)
    G, b = joint.quadratic(columns)
    curvature = G + np.eye(len(G)) / size**2
    mean = np.asarray(np.linalg.solve(curvature, b), dtype=np.float64)
    reach = WIDTH_95 * np.sqrt(np.diag(np.linalg.inv(curvature)))
    effect = simulator.joint_forces()[joint.place][0]
    return Left(
        name=effect.target or effect.name,
        unit=effect.unit,
        rms=float(np.sqrt(np.sum(left**2) / len(states))),
        scale=scale,
        predictable=float(np.sqrt(max(np.mean(predicted[0] * predicted[1]), 0.0))),
        regressor=chosen.name,
        evidence=float(logsumexp([weighted for _, weighted, *_ in tried]) - np.log(nv)),
        law=Law(chosen.coordinate, edges, mean, mean - reach, mean + reach),
        past=0.0,
        ahead=0.0,
        frequencies=spectrum[0],
        spectrum=spectrum[1],
        word=word_of(left, *spectrum, "Hz"),
        tried=tuple((one.name, nats) for nats, _, _, one in ranked[:LONGEST_TABLE]),
    )


def _regressors(names: Sequence[str], states: Array, place: int) -> list[Regressor]:
    """Return laws of a joint's own position and speed, and of those of others."""
    nv = len(names) // 2
    q, v = states[:, place], states[:, nv + place]
    position, speed = names[place], names[nv + place]
    found = [
        Regressor("constant", position, q, np.ones((len(q), 1)), True),
        *binned(position, q, OWN_BINS, is_own=True),
        *binned(speed, v, OWN_BINS, is_own=True),
        *single(f"sign({speed})", speed, v, np.sign(v)),
        *single(f"|{speed}|{speed}", speed, v, np.abs(v) * v),
        *single(f"{position} {speed}", f"{position} {speed}", q * v),
    ]
    others = [one for one in range(len(names)) if one % nv != place]
    if len(others) * OTHER_BINS * nv <= MOST_COLUMNS:
        for one in others:
            found += binned(names[one], states[:, one], OTHER_BINS, is_own=False)
    return found


def _spectrum(frequency: Array, left: Array, duration: float) -> tuple[Array, Array]:
    """Return frequencies, Hz, and the power density of coefficients, in bands."""
    edges = np.linspace(0, max(float(frequency.max()), 1e-12), BANDS + 1)
    band = np.clip(np.searchsorted(edges, frequency, side="right") - 1, 0, BANDS - 1)
    there = np.bincount(band, minlength=BANDS) > 0
    power = np.bincount(band, left**2, minlength=BANDS) / np.maximum(np.bincount(band, minlength=BANDS), 1)
    return (0.5 * (edges[1:] + edges[:-1]))[there], 2 * duration * power[there]
