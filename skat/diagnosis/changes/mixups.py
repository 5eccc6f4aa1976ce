"""Columns of a log that were mixed up: two in each other's place, or one with its sign turned."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skat.diagnosis.chains import Array, Mask
from skat.diagnosis.changes.question import FAULT, Question
from skat.diagnosis.changes.strengths import Logs
from skat.diagnosis.changes.windows import Quadratic, total, windows_of
from skat.diagnosis.forces.force_space import Motion, Rows
from skat.diagnosis.forces.machines import Model
from skat.diagnosis.forces.motions import lacking_forces, whole_coefficients_of
from skat.simulators import MujocoSimulator


def mistake_of(question: Question, differences: Array, *, price: float, needed: float) -> tuple[str, float]:
    """Return how columns of the second log seem to be mixed up, and by how much that is likelier than changes.

    The likeliest mix-up, by what it leaves of the second log about the first log's model, is weighed as changes are:
    by the evidence of both logs, with all that is common and all misfit integrated out.

    Parameters
    ----------
    question : Question
    differences : ndarray of shape (n_candidates,)
        That were found, in units of scales.
    price : float
        Of the changes: by how much their evidence is less than what they explain, nats.
    needed : float
        By how much what is told has to be likelier than what is not, nats.

    Returns
    -------
    words : str
        All that mend about as much; empty if there are none.
    nats : float
        Log odds for it against the changes; nothing is told of one that is less likely by what is needed.
    """
    simulator, own, rows, law = question.simulator, question.halves[1], question.sides[1], question.law
    mixed = _mixed_up(simulator, own)
    if not mixed:
        return "", -np.inf
    model = question.machine

    def left(half: Motion) -> Array:
        """Return what the first log's model leaves, NaN where nothing was measured or a joint was not fast."""
        whole, joint, frequency, _ = whole_coefficients_of(
            replace(half, cutoff=own.cutoff), lacking_forces(simulator, half, [model])
        )
        return np.where(frequency <= np.tile(half.cutoff, 2)[joint], whole[:, 0], np.nan)

    as_is = left(own)
    measured = np.isfinite(as_is)
    kept = ~question.held_out
    _, groups = np.unique(np.column_stack([rows.stretch, rows.joint])[kept], axis=0, return_inverse=True)

    def misfit(values: Array, seen: Mask) -> float:
        """Return half the log of what is left over the noise, of each joint in each window."""
        squares = np.where(seen, (values / law.noise[1]) ** 2, 0.0)[kept]
        many = np.maximum(np.bincount(groups, seen[kept].astype(float)), 1)
        return float(np.sum(0.5 * many * np.log1p(np.bincount(groups, squares) / many)))

    others = [left(half)[measured] for _, half in mixed]
    mended = [misfit(as_is[measured], np.isfinite(one)) - misfit(one, np.isfinite(one)) for one in others]
    best = int(np.argmax(mended))
    if mended[best] <= 0:
        return "", -np.inf
    half = mixed[best][1]
    otherwise, seen = _in_another_order(question, 1, half, model)
    explained = rows.columns[:, len(question.effects) :] @ differences
    given = replace(rows, target=rows.target - explained, columns=rows.columns[:, : len(question.effects)])

    def whole(side: int, some: Rows, seen: Mask) -> Quadratic:
        return total(windows_of(some.part(seen), law.noise[side][seen], law.spread))

    first = total(windows_of(question.sides[0], law.noise[0], law.spread))
    mended_second = whole(1, otherwise, seen & kept)
    odds = Logs(first, mended_second, law).level() - Logs(first, whole(1, given, seen & kept), law).level()
    nats = odds + price + float(np.log(FAULT / len(mixed)))
    if nats <= -needed:
        return "", -np.inf
    # What as well mends the first log is the model's matter.
    both, seen = _in_another_order(question, 0, _mixed_up(simulator, question.halves[0])[best][1], model)
    first, mended_first = whole(0, question.sides[0], seen), whole(0, both, seen)
    as_well = Logs(mended_first, mended_second, law).level() > Logs(first, mended_second, law).level()
    if as_well:
        return "", -np.inf
    # Of a pendulum alone, to turn what is commanded is to turn what is measured.
    words = ", or ".join(one for (one, _), gain in zip(mixed, mended) if gain > mended[best] - needed)
    return words, nats


def _in_another_order(question: Question, side: int, half: Motion, machine: Model) -> tuple[Rows, Mask]:
    """Return the rows of a log with columns in another order about a machine, and which of its rows are in both."""
    own, rows = question.halves[side], question.sides[side]
    cutoff, half = half.cutoff, replace(half, cutoff=own.cutoff)
    found = replace(question, halves=(half, half)).rows(side, machine, machine)
    here, there = (
        np.isfinite(whole_coefficients_of(one, lacking_forces(question.simulator, one, [Model({})]))[0][:, 0])
        for one in (own, half)
    )
    place = np.maximum(np.cumsum(there) - 1, 0)[here]
    seen = there[here] & (rows.frequency <= np.tile(cutoff, 2)[rows.joint])
    return replace(rows, target=found.target[place], columns=found.columns[place]), seen


def _mixed_up(simulator: MujocoSimulator, half: Motion) -> list[tuple[str, Motion]]:
    """Return halves with columns in the order, and with the sign, that they may have been meant to have."""
    nv, found = len(half.slip), []
    for name, order, signs in _mix_ups(simulator.input_names[len(simulator.state_names) :]):
        found.append((name, replace(half, commands=half.commands[:, order] * signs)))
    joints = simulator.residual_names[:nv]
    units = [simulator.units[joint] for joint in joints]
    for name, order, signs in _mix_ups(joints):
        if units == [units[place] for place in order]:
            mixed = replace(
                half,
                speeds=half.speeds[:, order] * signs,
                states=half.states[:, np.r_[order, order + nv]] * np.tile(signs, 2),
                accelerations=half.accelerations[:, order] * signs,
                velocities=half.velocities[..., order] * signs,
                cutoff=np.minimum(half.cutoff, half.cutoff[order]),
            )
            found.append((name, mixed))
    return found


def _mix_ups(names: Sequence[str]) -> Iterator[tuple[str, NDArray[np.intp], Array]]:
    """Yield what may be mixed up among columns, and their order and signs then."""
    places, plain = np.arange(len(names)), np.ones(len(names))
    for index, name in enumerate(names):
        yield f"{name} has its sign turned", places, np.where(places == index, -1.0, 1.0)
    for one, other in itertools.combinations(range(len(names)), 2):
        order = places.copy()
        order[[one, other]] = other, one
        yield f"{names[one]} and {names[other]} are swapped", order, plain
