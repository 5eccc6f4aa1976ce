"""Columns of a log that were mixed up: two in each other's place, or one with its sign turned."""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from skat.diagnosis.changes.candidates import WEAKEST
from skat.diagnosis.changes.motions import Half, lacking_forces, whole_coefficients_of
from skat.diagnosis.changes.question import Question
from skat.diagnosis.filtering import Array, Mask
from skat.effects import Effect
from skat.simulators import MujocoSimulator

# Odds that two columns of a log were mixed up, or that one has its sign turned.
MIXED_UP = 1e-3


def mistake_of(
    question: Question,
    differences: Array,
    alone: Array,
    drawn: Sequence[tuple[Array, ...]],
    *,
    price: float,
    needed: float,
) -> str:
    """Return how columns of the second log seem to be mixed up, if that explains it better than all changes.

    As changes do, it has to hold in drawn windows.

    Parameters
    ----------
    question : Question
    differences : ndarray of shape (n_candidates,)
        That were found, in units of scales.
    alone : ndarray of shape (n_effects,)
        What is wrong by the first log alone, in units of sizes.
    drawn : sequence of tuple of ndarray of shape (n_windows,)
        How often each window of either log is in each pair of logs of drawn windows.
    price : float
        Of the changes: by how much their evidence is less than what they explain, nats.
    needed : float
        By how much a mix-up has to be more likely than none, nats.

    Returns
    -------
    str
        Empty if nothing is mixed up.
    """
    simulator = question.simulator
    known = {effect.name: (effect, size) for effect, size in zip(question.effects, question.sizes)}
    values = dict(question.base.values)
    for (name, (effect, size)), one in zip(known.items(), alone):
        values[name] = _within(effect, values.get(name, effect.neutral) + size * one)
    model = replace(question.base, values=values)
    mixed = [_mixed_up(simulator, half) for half in question.halves]
    if not mixed[0]:
        return ""
    kept = np.ones(len(question.sides[0].target), dtype=bool), ~question.held_out

    def misfits(side: int) -> tuple[Array, Array]:
        """Return half the log of what is left over the noise, of all drawn windows, as columns are and in other orders.

        Of rows that both orders have: of two joints that change places, as far as both were fast, and of speeds that
        were measured of both.
        """
        own, rows, noise = question.halves[side], question.sides[side], question.law.noise[side]
        windows, window = np.unique(rows.stretch[kept[side]], return_inverse=True)
        joints, joint = np.unique(rows.joint[kept[side]], return_inverse=True)
        times = np.array([one[side] for one in drawn])

        def left(half: Half) -> Array:
            motion = replace(half.motion, cutoff=own.motion.cutoff)
            forces = lacking_forces(simulator, half, [model])
            return whole_coefficients_of(replace(half, motion=motion), forces)[0][:, 0]

        def misfit(squares: Array, seen: Mask) -> Array:
            shape = len(windows), len(joints)
            place = np.ravel_multi_index((window, joint), shape)
            sums, counts = (
                np.bincount(place, some[kept[side]], minlength=shape[0] * shape[1]).reshape(shape)
                for some in (np.where(seen, squares, 0.0), seen.astype(float))
            )
            many = np.maximum(times @ counts, 1)
            return np.asarray(0.5 * np.sum(many * np.log1p(times @ sums / many), axis=1))

        whole = left(own)
        measured = np.isfinite(whole)
        given = whole[measured] - (rows.columns[:, len(question.effects) :] @ differences if side else 0.0)
        as_is, otherwise = [], []
        for _, half in mixed[side]:
            other = left(half)[measured]
            seen = np.isfinite(other) & (rows.frequency <= np.tile(half.motion.cutoff, 2)[rows.joint])
            as_is.append(misfit((given / noise) ** 2, seen))
            otherwise.append(misfit((other / noise) ** 2, seen))
        return np.array(as_is), np.array(otherwise)

    first, second = misfits(0), misfits(1)
    # What as well mends the first log is the model's matter.
    share = kept[1].sum() / kept[0].sum()
    mended = second[0] + price - second[1] - share * np.maximum(first[0] - first[1], 0)
    # Probabilities of none of them, and of each, in each draw; their means, as of sets of changes.
    logs = np.vstack([np.zeros(mended.shape[1]), mended + np.log(MIXED_UP / len(mended))])
    means = logsumexp(logs - logsumexp(logs, axis=0), axis=1)
    best = int(np.argmax(means[1:]))
    return mixed[1][best][0] if means[1 + best] - means[0] > needed else ""


def _within(effect: Effect, value: float) -> float:
    """Return a value within the bounds; no factor so small that a machine would not be one."""
    low, high = effect.bounds
    return float(np.clip(value, max(low, WEAKEST) if effect.neutral == 1 else low, high))


def _mixed_up(simulator: MujocoSimulator, half: Half) -> list[tuple[str, Half]]:
    """Return halves with columns in the order, and with the sign, that they may have been meant to have."""
    motion, nv = half.motion, len(half.motion.slip)
    joints = simulator.residual_names[:nv]
    controls = simulator.input_names[len(simulator.state_names) :]
    found = []
    for index, name in enumerate(controls):
        signs = np.where(np.arange(len(controls)) == index, -1.0, 1.0)
        found.append(
            (
                f"{name} has its sign turned",
                replace(half, motion=replace(motion, commands=motion.commands * signs)),
            )
        )
    for index, name in enumerate(joints):
        signs = np.where(np.arange(nv) == index, -1.0, 1.0)
        turned = replace(
            motion, states=motion.states * np.tile(signs, 2), accelerations=motion.accelerations * signs
        )
        found.append(
            (f"{name} has its sign turned", replace(half, motion=turned, speeds=half.speeds * signs))
        )
    for one, other in itertools.combinations(range(len(controls)), 2):
        order = _swapped(len(controls), one, other)
        swapped = replace(motion, commands=motion.commands[:, order])
        found.append((f"{controls[one]} and {controls[other]} are swapped", replace(half, motion=swapped)))
    for one, other in itertools.combinations(range(nv), 2):
        if simulator.units[joints[one]] == simulator.units[joints[other]]:
            order = _swapped(nv, one, other)
            swapped = replace(
                motion,
                states=motion.states[:, np.r_[order, order + nv]],
                accelerations=motion.accelerations[:, order],
                cutoff=np.minimum(motion.cutoff, motion.cutoff[order]),
            )
            found.append(
                (
                    f"{joints[one]} and {joints[other]} are swapped",
                    replace(half, motion=swapped, speeds=half.speeds[:, order]),
                )
            )
    return found


def _swapped(n: int, one: int, other: int) -> NDArray[np.intp]:
    order = np.arange(n)
    order[[one, other]] = other, one
    return order
