"""What is left of measured efforts beside the causes: how large it is on each joint, and what predicts it.

As `skat.diagnosis.remainder` has it of a log whose commands move the machine, with the rows of a regression in forces
for whitened innovations: laws of a joint's own position and speed, and of those of others; not of the efforts, which
are what is to be predicted.
"""

from dataclasses import dataclass, replace

import numpy as np

from skat.diagnosis.chains import Array
from skat.diagnosis.forces.force_space import Motion, Rows, transformed
from skat.diagnosis.forces.machines import Model
from skat.diagnosis.forces.motions import lacking_forces
from skat.diagnosis.laws import likeliest, regressors_of
from skat.diagnosis.remainder import Left, Remainder, word_of
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
    names, states = simulator.state_names, joint.half.states
    nv = len(names) // 2
    own = names[joint.place], names[nv + joint.place]
    regressors = regressors_of(simulator, names, states, own, joint.half.stretches, nv)
    law = likeliest(regressors, joint.quadratic, scale, nv)
    columns = law.regressor.columns
    first, second = (columns @ law.strengths(*joint.quadratic(columns, which)) for which in (False, True))
    effect = simulator.joint_forces()[joint.place][0]
    return Left(
        name=effect.target or effect.name,
        unit=effect.unit,
        rms=float(np.sqrt(np.sum(left**2) / len(states))),
        scale=scale,
        predictable=float(np.sqrt(max(float(np.mean(first * second)), 0.0))),
        regressor=law.regressor.name,
        evidence=law.evidence,
        law=law.law(joint.quadratic),
        past=0.0,
        ahead=0.0,
        frequencies=spectrum[0],
        spectrum=spectrum[1],
        word=word_of(left, *spectrum, "Hz"),
    )


def _spectrum(frequency: Array, left: Array, duration: float) -> tuple[Array, Array]:
    """Return frequencies, Hz, and the power density of coefficients, in bands."""
    edges = np.linspace(0, max(float(frequency.max()), 1e-12), BANDS + 1)
    band = np.clip(np.searchsorted(edges, frequency, side="right") - 1, 0, BANDS - 1)
    there = np.bincount(band, minlength=BANDS) > 0
    power = np.bincount(band, left**2, minlength=BANDS) / np.maximum(np.bincount(band, minlength=BANDS), 1)
    return (0.5 * (edges[1:] + edges[:-1]))[there], 2 * duration * power[there]
