"""A question about two logs of the arm, small enough to be asked in a moment."""

from dataclasses import replace

import numpy as np

from skat.diagnosis.changes.law import settled_law, with_misfit
from skat.diagnosis.changes.question import Question
from skat.diagnosis.forces.machines import Model
from skat.diagnosis.forces.motions import columns_of, motion_of, rows_about
from skat.simulators import MujocoSimulator
from tests.diagnosis.forces.test_force_space import ARM


def arm():
    return MujocoSimulator(ARM, frame_skip=5)


def effect_of(simulator, name):
    return next(effect for effect in simulator.all_effects() if effect.name == name)


def question_about(simulator, before, after, *, effects=(), candidates=(), base=None, held_out=()):
    """Return the question of two logs, in typical sizes; ``held_out`` are windows of the second."""
    halves = tuple(motion_of(simulator, log, name) for log, name in ((before, "before"), (after, "after")))
    base = base or Model({})
    effects = tuple(effect_of(simulator, name) for name in effects)
    sizes = np.array([effect.typical for effect in effects])
    scales = np.array([one.effect.typical for one in candidates])
    first, second = (rows_about(simulator, half, base, effects, sizes) for half in halves)
    law = with_misfit((first, second), settled_law((first, second)))
    if candidates:
        columns = columns_of(simulator, halves[1], base, candidates, scales)
        second = replace(second, columns=np.column_stack([second.columns, columns]))
    return Question(
        simulator=simulator,
        halves=halves,
        base=base,
        here=np.zeros(len(effects)),
        effects=effects,
        candidates=tuple(candidates),
        sizes=sizes,
        scales=scales,
        sides=(first, second),
        later=np.zeros((len(first.target), 0)),
        law=law,
        held_out=np.isin(second.stretch, held_out),
    )
