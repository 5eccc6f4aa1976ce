"""The regression of two logs, of effects that may be wrong in both, and of candidates that may have changed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skat.diagnosis.changes.candidates import (
    MOTORS,
    UNSEEN,
    Candidate,
    Model,
    distinct,
    offered_candidates,
)
from skat.diagnosis.changes.force_space import Rows, joined
from skat.diagnosis.changes.law import Law, settled_law, variance_apart
from skat.diagnosis.changes.motions import Half, coefficients_of, columns_of, lacking_forces, rows_about
from skat.diagnosis.changes.windows import Windows
from skat.diagnosis.filtering import Array, Mask
from skat.effects import Effect
from skat.simulators import MujocoSimulator

# Rows by which commands may come late in the first log.
LATE_IN_BOTH = tuple(0.5 * one for one in range(17))
# Of the force on a joint, that a typical size of an effect exerts at least if logs show it: below, there is rounding.
SHOWN = 1e-9
# Variance by which scales of speeds differ between logs at least, in squares of typical sizes: drivers filter speeds,
# which takes from a fast motion more than from a slow one, about as much as sensors are typically wrong.
FILTERED = 1.0


@dataclass(frozen=True)
class Question:
    """The regression of two logs of a machine.

    Attributes
    ----------
    simulator : MujocoSimulator
    halves : tuple of Half
        The first log and the second.
    base : Model
        About which forces are taken.
    effects : tuple of Effect
        That may be wrong in both logs.
    candidates : tuple of Candidate
        That may have changed.
    sizes, scales : ndarray of shape (n_effects,) and (n_candidates,)
        Typical sizes of effects and of candidates, each in its effect's unit: units of the columns.
    sides : tuple of Rows
        Of both logs. Columns are those of effects; in the second log, then those of candidates.
    law : Law
    held_out : ndarray of bool of shape (n_rows of the second log,)
        Which rows of the second log measure the gain.
    """

    simulator: MujocoSimulator
    halves: tuple[Half, ...]
    base: Model
    effects: tuple[Effect, ...]
    candidates: tuple[Candidate, ...]
    sizes: Array
    scales: Array
    sides: tuple[Rows, Rows]
    law: Law
    held_out: Mask

    def left(self, value: Array, differences: Array) -> tuple[Array, Array]:
        """Return what values (n_effects,) and differences (n_candidates,) leave of the rows of both logs, (n_rows,)."""
        first, second = self.sides
        step = np.r_[value, differences]
        return first.target - first.columns @ value, second.target - second.columns @ step


def question_of(
    simulator: MujocoSimulator,
    halves: Sequence[Half],
    effects: Sequence[Effect],
    *,
    typical: Mapping[str, float],
    test_size: float,
) -> Question:
    """Return the regression about what is common of motors and delays, with its noise.

    Parameters
    ----------
    simulator : MujocoSimulator
    halves : sequence of Half
        The first log and the second.
    effects : sequence of Effect
        That may be wrong in both logs or may have changed.
    typical : mapping from name to size
        Scales of the priors of a user's own, each in its effect's unit.
    test_size : float
        Share of the second log that measures the gain.
    """
    seen = [effect for effect in effects if effect.family not in UNSEEN]
    common = [effect for effect in seen if effect.target != "all"]
    sizes = np.array([typical.get(effect.name, effect.typical) for effect in common])
    sides = [rows_about(simulator, half, Model({}), common, sizes) for half in halves]
    shares = _shares(joined(sides))
    shown = np.flatnonzero(shares > SHOWN)
    common, sizes, shares = [common[place] for place in shown], sizes[shown], shares[shown]
    units = np.array(
        [
            1.0 if effect.name in typical or effect.force_share is None else effect.force_share / share
            for effect, share in zip(common, shares)
        ]
    )
    sizes = sizes * units
    sides = [replace(side, columns=side.columns[:, shown] * units) for side in sides]
    late = np.array([effect.family == "delay" for effect in common])
    # What is late in the first log is told by a grid, not by a slope.
    prompt = [replace(side, columns=side.columns * ~late) for side in sides]
    base = _base(simulator, halves[0], prompt[0], settled_law(prompt))
    sides = [rows_about(simulator, half, base, common, sizes) for half in halves]
    law = settled_law(sides)
    apart = variance_apart(simulator, halves, sides, law)
    filtered = [effect.name.startswith("scale[qvel.") for effect in common]
    law = replace(law, apart=np.where(filtered, np.maximum(apart, FILTERED), apart))
    offered, scales = offered_candidates(simulator, effects, common, sizes, typical)
    columns = columns_of(simulator, halves[1], base, offered, scales)
    columns = _of_motors(offered, columns, sides[1], law.value, scales)
    noise = law.noise[1]
    whitened = columns / noise[:, None]
    offered, kept = distinct(offered, whitened)
    sides[1] = replace(
        sides[1], columns=np.column_stack([sides[1].columns, whitened[:, kept] * noise[:, None]])
    )
    return Question(
        simulator=simulator,
        halves=tuple(halves),
        base=base,
        effects=tuple(common),
        candidates=tuple(offered),
        sizes=sizes,
        scales=scales[kept],
        sides=(sides[0], sides[1]),
        law=law,
        held_out=_held_out(sides[1].stretch, test_size),
    )


def _shares(rows: Rows) -> Array:
    """Return what a typical size of each effect exerts, over the force on the joint that feels it most."""
    joints = [rows.joint == joint for joint in np.unique(rows.joint)]
    exerted = np.array([np.sqrt(np.mean(rows.columns[own] ** 2, axis=0)) for own in joints])
    there = np.array([np.sqrt(np.mean(rows.nominal[own] ** 2)) for own in joints])
    return np.asarray(np.max(exerted / np.maximum(there, 1e-300)[:, None], axis=0))


def _base(simulator: MujocoSimulator, half: Half, rows: Rows, law: Law) -> Model:
    """Return the model with commands as late as they come in the first log."""
    if not half.motion.commands.shape[1]:
        return Model({})
    models = [Model({}, late) for late in LATE_IN_BOTH]
    targets = coefficients_of(half, lacking_forces(simulator, half, models))[0]
    deviation, worth = law.noise[0], []
    for target in targets.T:
        windows = Windows.of(replace(rows, target=target), deviation)
        G, h = windows.without(law.spread).every()
        square = float(np.sum((target / deviation) ** 2))
        square -= windows.own_share(law.spread)
        worth.append(float(h @ np.linalg.solve(G + np.diag(law.weights), h)) - square)
    return Model({}, LATE_IN_BOTH[int(np.argmax(worth))])


def _of_motors(
    offered: Sequence[Candidate], columns: Array, rows: Rows, value: Array, scales: Array
) -> Array:
    r"""Return columns with those of motors acting on all that is common.

    In units of what its motor exerts a joint lacks :math:`\lambda f - u`, f all of its force and :math:`\lambda` one
    over the gain; nearly u is what a change of :math:`\lambda` multiplies, whatever the model says of f.
    """
    columns, explained = columns.copy(), rows.columns @ value
    for place, one in enumerate(offered):
        if one.effect.family in MOTORS:
            felt = [joint for joint in np.unique(rows.joint) if np.any(columns[rows.joint == joint, place])]
            columns[:, place] -= np.isin(rows.joint, felt) * explained * scales[place]
    return columns


def _held_out(stretch: NDArray[np.intp], share: float) -> Mask:
    """Return which rows are in windows that are held out: a share of them, evenly spread, not all."""
    kinds = np.unique(stretch)
    n = min(round(share * len(kinds)), len(kinds) - 2)
    places = np.linspace(0, len(kinds) - 1, max(n, 0) + 2).astype(int)[1:-1]
    return np.isin(stretch, kinds[places])
