"""Questions whose rows are drawn, and what a dense normal law says of them."""

import numpy as np

from skat.diagnosis.changes.law import Law
from skat.diagnosis.changes.question import Question
from skat.diagnosis.forces.force_space import Rows
from skat.diagnosis.forces.machines import Candidate, Model
from tests.diagnosis.changes.arm import effect_of

K, M = 2, 3
SPREAD, WEIGHTS = np.array([0.3, 0.1]), np.array([2.0, 0.5])
# Of two joints: the first feels both effects, the second hardly the first.
ALIKE = np.array([[2.0, 0.7], [0.1, 3.0]])


def question_of_rows(simulator, *, windows=5, n=8, differences=(0.0, 0.0, 0.0)):
    """Return a question of two effects and three candidates, whose rows are drawn."""
    rng = np.random.default_rng(0)
    sides = []
    for columns, step in ((K, np.zeros(K)), (K + M, np.r_[np.zeros(K), differences])):
        N, stretch = rng.normal(size=(windows * n, columns)), np.repeat(np.arange(windows), n)
        target, zeros = N @ step + rng.normal(size=windows * n), np.zeros(windows * n)
        sides.append(Rows(target, N, zeros.astype(int), zeros, stretch, zeros))
    noise = tuple(rng.uniform(0.5, 2, windows * n) for _ in sides)
    names = ["mass[lower]", "damping[elbow]", "gain[elbow]"]
    candidates = tuple(Candidate(effect_of(simulator, name), 1.0, {}) for name in names)
    effects = tuple(one.effect for one in candidates[:K])
    law = Law(noise, SPREAD, WEIGHTS, np.zeros(K), np.zeros(K), ALIKE)
    held_out = sides[1].stretch == 2
    return Question(
        simulator=simulator,
        halves=(),
        base=Model({}),
        effects=effects,
        candidates=candidates,
        sizes=np.ones(K),
        scales=np.ones(M),
        here=np.zeros(K),
        sides=tuple(sides),
        later=np.zeros((len(sides[0].target), 0)),
        law=law,
        held_out=held_out,
    )


def dense(question, apart, *, gone=(None, None)):
    """Return target, columns of differences and of what is common, and covariance of both logs, over the noise.

    What windows and logs have of their own, of variances SPREAD and ``apart``, is in the covariance; the windows that
    are held out are not there, nor is the window of each log that is ``gone``. The last is how many rows are the
    first log's.
    """
    target, columns, common, blocks = [], [], [], []
    for place, (rows, noise) in enumerate(zip(question.sides, question.law.noise, strict=True)):
        kept = ~question.held_out if place else np.ones(len(rows.target), bool)
        kept &= rows.stretch != (-1 if gone[place] is None else gone[place])
        z, N = rows.part(kept).whitened(noise[kept])
        window = rows.stretch[kept]
        own = (N[:, :K] * SPREAD) @ N[:, :K].T * (window[:, None] == window)
        blocks.append(np.eye(len(z)) + own + ((N[:, :K] * apart) @ N[:, :K].T if place else 0.0))
        target.append(z)
        common.append(N[:, :K])
        columns.append(N[:, K:] if place else np.zeros((len(z), M)))
    first, second = map(len, blocks)
    covariance = np.zeros((first + second, first + second))
    covariance[:first, :first], covariance[first:, first:] = blocks
    return np.concatenate(target), np.vstack(columns), np.vstack(common), covariance, first
