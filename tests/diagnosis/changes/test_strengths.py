"""Sets weighed where logs may differ though nothing changed: by dense normal densities, and by simulation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from skat.diagnosis.changes.law import Law, with_misfit
from skat.diagnosis.changes.question import Question
from skat.diagnosis.changes.search import _logs
from skat.diagnosis.changes.strengths import BEYOND, LEAST, STRENGTHS, OverStrengths
from skat.diagnosis.evidence import Gram, Priors, Weigher
from skat.diagnosis.forces.force_space import Rows
from skat.diagnosis.forces.machines import Candidate, Model
from skat.diagnosis.search import without_weak
from tests.diagnosis.changes.arm import arm, effect_of
from tests.diagnosis.changes.drawn import ALIKE, WEIGHTS, K, M, dense, question_of_rows

NEEDED = np.log(100.0)


@pytest.fixture(scope="module")
def simulator():
    return arm()


def priors_of(k):
    return Priors(("",) * k, np.ones(k), np.full(k, -np.log(k + 1.0)), np.full(k, -50.0), np.full(k, 50.0))


def apart_at(strength):
    """Return the variances by which effects of the second log differ."""
    return 1 / (ALIKE.sum(axis=0) / strength + LEAST)


def assert_dense(left, question, strength, gone=(None, None)):
    """Assert that a quadratic is the log density of both logs at any differences."""
    z, D, N, covariance, _ = dense(question, apart_at(strength), gone=gone)
    covariance = covariance + (N / WEIGHTS) @ N.T
    for x in np.random.default_rng(1).normal(size=(3, M)) * 3:
        found = left.level + left.projections @ x - 0.5 * x @ left.products @ x
        expected = multivariate_normal.logpdf(z - D @ x, cov=covariance) + 0.5 * len(z) * np.log(2 * np.pi)
        assert found == pytest.approx(expected, rel=1e-9)
    over = np.linalg.solve(covariance, np.column_stack([D, z]))
    np.testing.assert_allclose(left.products, D.T @ over[:, :-1], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(left.projections, D.T @ over[:, -1], rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("strength", [STRENGTHS[0], 0.1, 1.0, BEYOND[-1]])
def test_candidates_alone_are_told_by_a_normal_law_of_all_else(simulator, strength):
    question = question_of_rows(simulator, differences=(1.0, 0.0, -2.0))
    assert_dense(_logs(question).left(strength), question, strength)


def test_what_looks_like_late_commands_in_both_logs_is_no_change(simulator):
    """Smoothed motions and steps of commands do; of one log it is a change, of the other no matter how much of it."""
    drawn = question_of_rows(simulator, windows=12)
    (first, second), rng = drawn.sides, np.random.default_rng(4)
    chord = rng.normal(size=len(first.target))
    late = Candidate(effect_of(simulator, "delay[action]"), 1.0, {}, -0.5)
    drawn = replace(drawn, candidates=(*drawn.candidates[:-1], late), later=chord[:, None])

    def worth_of_late(*sizes):
        before = replace(first, target=first.target + sizes[0] * chord)
        after = replace(second, target=second.target + sizes[1] * second.columns[:, -1])
        worth = OverStrengths(_logs(replace(drawn, sides=(before, after))), priors_of(M), {})
        return worth.losses(worth((M - 1,)))[M - 1], worth((M - 1,))

    for both in (-5.0, 0.0, 5.0):
        assert worth_of_late(both, both)[0] < 0
        nats, changed = worth_of_late(both, both + 3.0)
        assert nats > NEEDED
        assert changed.values == pytest.approx(3.0, abs=3 / np.sqrt(changed.curvature[0, 0]))


def test_logs_that_have_to_be_alike_have_one_value_in_common_and_those_that_may_differ_two(simulator):
    logs = _logs(question_of_rows(simulator))
    alike, free = logs.both(STRENGTHS[0]), logs.both(BEYOND[1])
    own = logs.first.products
    # Of the second log an effect that may be anything tells nothing of what is common.
    assert np.linalg.norm(free.products[:2, :2] - own) < 0.1 * np.linalg.norm(alike.products[:2, :2] - own)


def test_logs_without_a_window_are_those_that_never_had_it(simulator):
    question, strength = question_of_rows(simulator, differences=(1.0, 0.0, -2.0)), 0.1
    shortened = list(_logs(question).shortened())
    windows = [(one, None) for one in range(5)] + [(None, one) for one in (0, 1, 3, 4)]
    assert len(shortened) == len(windows)
    for logs, gone in zip(shortened, windows, strict=True):
        assert_dense(logs.left(strength), question, strength, gone)


def test_both_logs_are_worth_what_no_change_is_at_all_strengths(simulator):
    logs = _logs(question_of_rows(simulator))
    worth = OverStrengths(logs, priors_of(M), {})
    levels = [logs.left(strength).level for strength in STRENGTHS]
    assert logs.level() == pytest.approx(logsumexp(levels) - np.log(len(levels)), abs=1e-9)
    assert logs.level() == pytest.approx(worth(()).evidence, abs=1e-3)


@pytest.mark.parametrize(
    ("moved", "shown", "beyond"), [(0.0, 8, False), (0.3, 8, False), (30.0, 8, True), (30.0, 1, False)]
)
def test_logs_that_differ_by_more_than_misfit_could_are_told_where_no_one_window_decides(
    simulator, moved, shown, beyond
):
    question = misfit_question(simulator, 0, apart=0.0)
    rows = question.sides[1]
    # On one joint, by what is not alike in two windows, so that no one effect explains it.
    step = moved * np.random.default_rng(3).normal(size=(WINDOWS, EFFECTS)) * (np.arange(EFFECTS) < EACH)
    step[shown:] = 0.0
    extra = np.sum(rows.columns[:, :EFFECTS] * step.mean(axis=0), axis=1) * (rows.stretch < shown)
    logs = _logs(replace(question, sides=(question.sides[0], replace(rows, target=rows.target + extra))))
    assert logs.differ_beyond_misfit(logs.level(), NEEDED) == beyond


def test_a_change_of_one_effect_is_likelier_than_that_all_differ(simulator):
    question = misfit_question(simulator, 0, apart=0.0, change=30.0)
    logs = _logs(question)
    assert logs.differ_beyond_misfit(logs.level(), NEEDED)
    assert not logs.differ_beyond_misfit(named(question).evidence, NEEDED)


def at(logs, strength, members):
    """Return what a set is worth at a strength, by a search's weigher of its own."""
    left = logs.left(strength)
    k = len(left.projections)
    gram = Gram(left.products, left.projections, np.zeros(k))
    return Weigher(gram, priors_of(k))(members).evidence + left.level


def at_all(logs, members):
    """Return the same at all strengths together."""
    return logsumexp([at(logs, strength, members) for strength in STRENGTHS]) - np.log(len(STRENGTHS))


@pytest.mark.parametrize("members", [(), (0,), (2,), (0, 2), (0, 1, 2)])
def test_a_set_is_worth_what_it_is_at_all_strengths_together(simulator, members):
    logs = _logs(question_of_rows(simulator, differences=(1.0, 0.0, -2.0)))
    worth = OverStrengths(logs, priors_of(M), {})
    assert worth(members).evidence == pytest.approx(at_all(logs, members), abs=0.05)
    each = [at(logs, strength, members) for strength in STRENGTHS]
    assert worth.strength(members) == STRENGTHS[np.argmax(each)]


def test_values_and_their_errors_are_those_of_the_mixture_over_strengths(simulator):
    logs = _logs(question_of_rows(simulator, differences=(1.0, 0.0, -2.0)))
    worth = OverStrengths(logs, priors_of(M), {})
    shares = np.exp([at(logs, strength, (2,)) for strength in STRENGTHS])
    shares /= shares.sum()
    rng, drawn = np.random.default_rng(0), []
    for strength, share in zip(STRENGTHS, shares):
        left = logs.left(strength)
        one = Weigher(Gram(left.products, left.projections, np.zeros(M)), priors_of(M))((2,))
        drawn.append(rng.normal(one.values[0], one.deviations[0], round(2e6 * share)))
    found, drawn = worth((2,)), np.concatenate(drawn)
    assert found.values[0] == pytest.approx(drawn.mean(), abs=0.01 * drawn.std())
    assert found.deviations[0] == pytest.approx(drawn.std(), rel=0.01)


def test_the_price_of_a_set_is_what_it_explains_but_is_not_worth(simulator):
    logs = _logs(question_of_rows(simulator, differences=(4.0, 0.0, 0.0)))
    worth = OverStrengths(logs, priors_of(M), {})
    strength = worth.strength((0,))
    left = logs.left(strength)
    value = worth((0,)).values[0]
    explained = left.projections[0] * value - 0.5 * left.products[0, 0] * value**2
    assert worth.price((0,)) == pytest.approx(explained - at(logs, strength, (0,)) + left.level, abs=0.1)
    assert worth.price(()) == 0.0


def test_a_promise_is_about_what_a_further_effect_gains(simulator):
    logs = _logs(question_of_rows(simulator, differences=(2.0, 0.0, -2.0)))
    worth = OverStrengths(logs, priors_of(M), {1: [2]})
    now = worth((0,))
    promises = worth.promises(now)
    assert promises[0] == -np.inf
    for one in (1, 2):
        assert promises[one] == pytest.approx(worth((0, one)).evidence - now.evidence, abs=1.0)
    rest = worth((1,))
    np.testing.assert_array_equal(np.isfinite(worth.promises(rest)), [True, False, False])


@pytest.mark.parametrize("difference", [-4.0, -0.5, 0.0, 1.0, 5.0])
def test_what_a_candidate_would_be_worth_is_what_it_is_where_the_log_differs_so(simulator, difference):
    question = question_of_rows(simulator, differences=(0.5, 0.0, 0.0))
    found = OverStrengths(_logs(question), priors_of(M), {}).gains_of(np.full((2, M), difference))
    np.testing.assert_array_equal(found[0], found[1])
    for one in range(M):
        rows = question.sides[1]
        moved = replace(rows, target=rows.target + difference * rows.columns[:, K + one])
        worth = OverStrengths(_logs(replace(question, sides=(question.sides[0], moved))), priors_of(M), {})
        assert found[0, one] == pytest.approx(worth.losses(worth((one,)))[one], abs=0.5)


# Of each joint as many effects, each a candidate too.
JOINTS, EACH, WINDOWS, ROWS = 2, 8, 8, 25
EFFECTS = JOINTS * EACH


def misfit_question(simulator, seed, *, apart, change=0.0, spread=0.0025, shown=range(WINDOWS)):
    """Return a question of logs in which each effect differs by a normal law, and one by a change beside.

    The second log shows the third effect, that of the change, in some windows alone.
    Noise and columns of a row are about 1, so that misfit which is all of a joint's noise has a variance of 1.
    """
    rng = np.random.default_rng(seed)
    n = JOINTS * ROWS * WINDOWS
    joint = np.tile(np.repeat(np.arange(JOINTS), ROWS), WINDOWS)
    stretch = np.repeat(np.arange(WINDOWS), JOINTS * ROWS)
    felt = np.repeat(np.arange(JOINTS), EACH) == joint[:, None]
    common = rng.normal(size=EFFECTS)
    sides = []
    for place in range(2):
        N, zeros = rng.normal(size=(n, EFFECTS)) * felt, np.zeros(n)
        value = common + place * (
            np.sqrt(apart) * rng.normal(size=EFFECTS) + change * (np.arange(EFFECTS) == 2)
        )
        if place:
            N[:, 2] *= np.where(np.isin(stretch, shown), 1.0, 0.01)
        own = value + np.sqrt(spread) * rng.normal(size=(WINDOWS, EFFECTS))
        target = np.sum(N * own[stretch], axis=1) + rng.normal(size=n)
        sides.append(Rows(target, N, joint, zeros, stretch, zeros))
    law = with_misfit(
        sides,
        Law(
            (np.ones(n), np.ones(n)),
            np.full(EFFECTS, spread),
            np.ones(EFFECTS),
            np.zeros(EFFECTS),
            np.zeros(EFFECTS),
            np.zeros((0, EFFECTS)),
        ),
    )
    sides[1] = replace(sides[1], columns=np.hstack([sides[1].columns] * 2))
    effect = effect_of(simulator, "damping[elbow]")
    candidates, ones = tuple(Candidate(effect, 1.0, {}) for _ in range(EFFECTS)), np.ones(EFFECTS)
    return Question(
        simulator=simulator,
        halves=(),
        base=Model({}),
        effects=(effect,) * EFFECTS,
        candidates=candidates,
        sizes=ones,
        scales=ones,
        here=np.zeros(EFFECTS),
        sides=tuple(sides),
        later=np.zeros((len(sides[0].target), 0)),
        law=law,
        held_out=stretch < 0,
    )


def named(question):
    worth = OverStrengths(_logs(question), priors_of(EFFECTS), {})
    return without_weak(worth.best(NEEDED), worth, NEEDED)[0]


@pytest.mark.parametrize("apart", [0.0, pytest.param(0.01, marks=pytest.mark.long), 0.1])
def test_nothing_is_named_where_every_effect_differs_a_little(simulator, apart):
    wrong = sum(bool(named(misfit_question(simulator, seed, apart=apart)).members) for seed in range(20))
    assert wrong <= 1


@pytest.mark.parametrize(
    ("apart", "change"), [(0.0, 3.0), pytest.param(0.01, 3.0, marks=pytest.mark.long), (0.1, 6.0)]
)
def test_an_effect_that_changed_alone_is_named_with_its_value(simulator, apart, change):
    found = [named(misfit_question(simulator, seed, apart=apart, change=change)) for seed in range(8)]
    right = [one for one in found if one.members == (2,)]
    assert len(right) >= 7
    values, widths = (
        np.array([getattr(one, name)[0] for one in right]) for name in ("values", "half_widths")
    )
    assert np.mean(values) == pytest.approx(change, abs=3 * np.sqrt((apart + 0.02) / len(right)))
    assert np.mean(np.abs(values - change) <= widths) >= 0.75


def test_a_change_on_one_joint_is_told_beside_misfit_on_the_other(simulator):
    # Of the first joint all effects differ; on the second one changed alone, by more.
    question = misfit_question(simulator, 0, apart=0.0)
    step = np.zeros(EFFECTS)
    step[:EACH], step[EACH + 1] = [1.0, -0.8, 0.9, -1.1, 0.7, -0.9, 0.8, -1.0], 8.0
    rows = question.sides[1]
    moved = replace(rows, target=rows.target + rows.columns[:, :EFFECTS] @ step)
    assert named(replace(question, sides=(question.sides[0], moved))).members == (EACH + 1,)


def changed(simulator, shown):
    question = misfit_question(simulator, 0, apart=0.0, change=4.0, shown=shown)
    worth = OverStrengths(_logs(question), priors_of(EFFECTS), {})
    return question, worth, worth((2,))


def test_a_change_that_hangs_on_one_window_is_worth_less_than_none(simulator):
    question, worth, whole = changed(simulator, shown=[3])
    assert Weigher.losses(worth, whole)[2] > NEEDED
    assert worth.losses(whole)[2] < 0
    assert named(question).members == ()


@pytest.mark.parametrize("shown", [[3, 5], range(WINDOWS)])
def test_a_change_that_several_windows_show_is_worth_about_what_it_is(simulator, shown):
    question, worth, whole = changed(simulator, shown)
    (loss,), (plain,) = worth.losses(whole).values(), Weigher.losses(worth, whole).values()
    assert 0.8 * plain < loss <= plain
    assert loss > NEEDED
    assert named(question).members == (2,)


@pytest.mark.parametrize("shown", [[3], [3, 5], range(WINDOWS)])
def test_no_member_is_worth_more_than_without_any_one_window(simulator, shown):
    question, worth, whole = changed(simulator, shown)
    logs = _logs(question)
    ways = [logs, *logs.shortened()]
    found = min(at_all(one, (2,)) - at_all(one, ()) for one in ways)
    assert len(ways) == 1 + 2 * WINDOWS
    assert worth.losses(whole)[2] == pytest.approx(found, abs=0.1)


def test_one_member_that_hangs_on_a_window_takes_nothing_from_another(simulator):
    question = misfit_question(simulator, 0, apart=0.0, change=4.0, shown=[3])
    rows = question.sides[1]
    moved = replace(rows, target=rows.target + 4.0 * rows.columns[:, EACH])
    worth = OverStrengths(_logs(replace(question, sides=(question.sides[0], moved))), priors_of(EFFECTS), {})
    whole = worth((2, EACH))
    plain, found = Weigher.losses(worth, whole), worth.losses(whole)
    assert found[2] < 0 < plain[2]
    assert NEEDED < 0.8 * plain[EACH] < found[EACH] <= plain[EACH]
