"""The search of what changed: its regression against a dense one, and what is never named."""

from dataclasses import replace

import numpy as np
import pytest

from skat.diagnosis.changes import find_changes
from skat.diagnosis.changes.candidates import Candidate, Model
from skat.diagnosis.changes.force_space import Rows
from skat.diagnosis.changes.law import Law
from skat.diagnosis.changes.question import Question
from skat.diagnosis.changes.search import _at_bounds, _bagged, _differences, _integrated_sides
from skat.diagnosis.changes.windows import drawn_windows
from skat.diagnosis.evidence import Priors, Weighed
from tests.diagnosis.changes.arm import arm, effect_of
from tests.diagnosis.changes.test_force_space import log_of

K, M = 2, 3
SPREAD, WEIGHTS, APART = np.array([0.3, 0.1]), np.array([2.0, 0.5]), np.array([0.2, 0.7])


@pytest.fixture(scope="module")
def simulator():
    return arm()


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
    law = Law(noise, SPREAD, WEIGHTS, np.zeros(K), APART)
    held_out = sides[1].stretch == 2
    return Question(
        simulator, (), Model({}), effects, candidates, np.ones(K), np.ones(M), tuple(sides), law, held_out
    )


def dense(question, times=None):
    """Return whitened target, columns of differences, those of what is common and its weights; all by one covariance.

    What windows and logs have of their own is in the covariance; the windows that are held out are not there.
    """
    target, columns, common, blocks = [], [], [], []
    for place, (rows, noise) in enumerate(zip(question.sides, question.law.noise, strict=True)):
        kept = ~question.held_out if place else np.ones(len(rows.target), bool)
        kinds = np.unique(rows.stretch[kept])
        counts = np.ones(len(kinds), int) if times is None else times[place]
        drawn = np.concatenate(
            [
                np.flatnonzero(rows.stretch == one)
                for one, n in zip(kinds, counts, strict=True)
                for _ in range(n)
            ]
        )
        window = np.repeat(np.arange(counts.sum()), len(drawn) // counts.sum())
        N = rows.columns[drawn]
        own = (N[:, :K] * SPREAD) @ N[:, :K].T * (window[:, None] == window)
        apart = (N[:, :K] * APART) @ N[:, :K].T if place else 0.0
        blocks.append(np.diag(noise[drawn] ** 2) + own + apart)
        target.append(rows.target[drawn])
        common.append(N[:, :K])
        columns.append(N[:, K:] if place else np.zeros((len(drawn), M)))
    sizes = [len(block) for block in blocks]
    covariance = np.zeros((sum(sizes), sum(sizes)))
    covariance[: sizes[0], : sizes[0]], covariance[sizes[0] :, sizes[0] :] = blocks
    return np.concatenate(target), np.vstack(columns), np.vstack(common), covariance, sizes[0]


@pytest.mark.parametrize("times", [None, (np.array([2, 0, 1, 1, 1]), np.array([0, 1, 3, 0]))])
def test_differences_are_those_of_a_normal_law_of_all_else(simulator, times):
    question = question_of_rows(simulator, differences=(1.0, 0.0, -2.0))
    z, D, N, covariance, _ = dense(question, times)
    weights = None if times is None else tuple(one.astype(float) for one in times)
    gram, _ = _differences(question, _integrated_sides(question), weights)
    whole = covariance + N @ np.diag(1 / WEIGHTS) @ N.T
    np.testing.assert_allclose(gram.products, D.T @ np.linalg.solve(whole, D), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(gram.projections, D.T @ np.linalg.solve(whole, z), rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(gram.origin, 0.0)


def test_what_is_common_is_its_mean_given_the_differences(simulator):
    question = question_of_rows(simulator)
    z, D, N, covariance, first = dense(question)
    _, common = _differences(question, _integrated_sides(question))

    def mean(target, rows):
        over = np.linalg.solve(covariance[rows, rows], N[rows])
        return np.linalg.solve(over.T @ N[rows] + np.diag(WEIGHTS), over.T @ target[rows])

    steps = np.array([0.5, -1.0, 2.0])
    whole = slice(None)
    np.testing.assert_allclose(common.level - common.slopes @ steps, mean(z - D @ steps, whole), atol=1e-9)
    np.testing.assert_allclose(common.alone, mean(z, slice(first)), atol=1e-9)


def test_sets_are_weighed_by_the_probability_that_drawn_windows_give_them(simulator):
    question = question_of_rows(simulator, differences=(4.0, 0.0, 0.0))
    sides = _integrated_sides(question)
    priors = Priors(("",) * M, np.ones(M), np.full(M, np.log(0.1)), np.full(M, -50.0), np.full(M, 50.0))
    worth = _bagged(question, sides, drawn_windows(sides), _differences(question, sides)[0], priors)
    assert () in worth.seen
    assert max(worth.seen.values(), key=lambda one: one.evidence).members == (0,)
    assert sum(np.exp(one.evidence) for one in worth.seen.values()) == pytest.approx(1.0, rel=1e-9)


def test_values_at_an_end_of_what_is_possible_are_a_sign_of_something_else(simulator):
    candidates = [Candidate(effect_of(simulator, "mass[lower]"), 1.0, {})] * 5
    candidates[2] = Candidate(effect_of(simulator, "delay[action]"), 1.0, {}, 2.0)
    priors = Priors(("",) * 5, np.ones(5), np.zeros(5), np.full(5, -2.0), np.full(5, 3.0))

    def ends(values):
        members = tuple(range(5))[: len(values)]
        return _at_bounds(
            Weighed(members, np.array(values), 0.0, 0.0, np.eye(len(values))), candidates, priors
        )

    assert ends([-2.0, 3.0, 3.0, 0.0, -1.9]) == [0, 1]
    assert ends([2.9999, -1.9999, -2.0]) == []
    sparse = Weighed((1, 4), np.array([1.0, 3.0]), 0.0, 0.0, np.eye(2))
    assert _at_bounds(sparse, candidates, priors) == [4]


@pytest.fixture
def logs(monkeypatch):
    """Two logs between which the elbow is damped, that are drawn few times."""
    monkeypatch.setattr("skat.diagnosis.changes.windows.BAGS", 8)
    return log_of(4, rows=800), log_of(5, rows=800, damping=(0.0, 0.1))


def test_what_would_have_to_be_at_an_end_of_what_is_possible_is_not_named(simulator, logs):
    narrow = replace(effect_of(simulator, "damping[elbow]"), bounds=(0.0, 0.05))
    assert "damping[elbow]" not in [one.name for one in find_changes(simulator, *logs, [narrow]).changes]


def test_a_change_is_named_where_its_odds_are_as_long_as_asked(simulator, logs):
    effects = [effect_of(simulator, "damping[elbow]")]
    (change,) = find_changes(simulator, *logs, effects).changes
    assert (change.name, change.value) == ("damping[elbow]", pytest.approx(0.1, rel=0.05))
    alpha = float(np.exp(-change.evidence - 0.1))
    assert find_changes(simulator, *logs, effects, alpha=alpha).verdict == "nothing changed"
