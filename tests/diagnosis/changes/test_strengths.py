"""Sets weighed where logs may differ though nothing changed: by dense normal densities, and by simulation."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from skat.diagnosis.changes.law import Law, with_misfit
from skat.diagnosis.changes.question import Question
from skat.diagnosis.changes.search import _logs, _named
from skat.diagnosis.changes.strengths import BEYOND, LEAST, STRENGTHS, OverStrengths, log_sum, prior
from skat.diagnosis.evidence import Gram, Priors, SwiftWeigher, Weigher
from skat.diagnosis.forces.force_space import Rows
from skat.diagnosis.forces.machines import Candidate, Model
from tests.diagnosis.changes.arm import arm, effect_of
from tests.diagnosis.changes.drawn import ALIKE, WEIGHTS, M, dense, question_of_rows

NEEDED = np.log(100.0)


@pytest.fixture(scope="module")
def simulator():
    return arm()


def priors_of(k):
    return Priors(("",) * k, np.ones(k), np.full(k, -np.log(k + 1.0)), np.full(k, -50.0), np.full(k, 50.0))


def apart_at(places):
    """Return the variances by which effects of the second log differ."""
    return 1 / (ALIKE.T @ (1 / STRENGTHS[list(places)]) + LEAST)


def assert_dense(left, question, places, gone=(None, None)):
    """Assert that a quadratic is the log density of both logs at any differences."""
    z, D, N, covariance, _ = dense(question, apart_at(places), gone=gone)
    covariance = covariance + (N / WEIGHTS) @ N.T
    for x in np.random.default_rng(1).normal(size=(3, M)) * 3:
        found = left.level + left.projections @ x - 0.5 * x @ left.products @ x
        expected = multivariate_normal.logpdf(z - D @ x, cov=covariance) + 0.5 * len(z) * np.log(2 * np.pi)
        assert found == pytest.approx(expected, rel=1e-9)
    over = np.linalg.solve(covariance, np.column_stack([D, z]))
    np.testing.assert_allclose(left.products, D.T @ over[:, :-1], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(left.projections, D.T @ over[:, -1], rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("places", [(8, 10), (0, 0), (10, 10), (0, 10), (10, 3)])
def test_candidates_alone_are_told_by_a_normal_law_of_all_else(simulator, places):
    question = question_of_rows(simulator, differences=(1.0, 0.0, -2.0))
    assert_dense(_logs(question).left(places), question, places)


def test_logs_that_have_to_be_alike_have_one_value_in_common_and_those_that_may_differ_two(simulator):
    logs = _logs(question_of_rows(simulator))
    alike, free = logs.both((0, 0)), replace(logs, strengths=np.r_[STRENGTHS, BEYOND]).both((12, 12))
    own = logs.first.products
    # Of the second log an effect that may be anything tells nothing of what is common.
    assert np.linalg.norm(free.products[:2, :2] - own) < 0.1 * np.linalg.norm(alike.products[:2, :2] - own)


def test_logs_without_a_window_are_those_that_never_had_it(simulator):
    question, places = question_of_rows(simulator, differences=(1.0, 0.0, -2.0)), (8, 10)
    shortened = list(_logs(question).shortened())
    windows = [(one, None) for one in range(5)] + [(None, one) for one in (0, 1, 3, 4)]
    assert len(shortened) == len(windows)
    for logs, gone in zip(shortened, windows, strict=True):
        assert_dense(logs.left(places), question, places, gone)


def test_strengths_fall_by_a_nat_for_each_step_of_a_joint_from_the_others():
    assert prior((4, 4, 4)) == 0.0
    assert prior((7, 7, 7)) == 0.0
    assert prior((4, 4, 6)) == -2.0
    assert prior((3, 5, 5, 5, 9)) == -6.0
    # Of two, what they differ by is all there is.
    assert prior((2, 5)) == -3.0


@pytest.mark.parametrize("kind", ["flat", "level", "sharp", "drawn"])
def test_strengths_that_joints_tell_for_themselves_are_summed_over_a_common_level(kind):
    n, joints = 5, 3
    gains = {
        "flat": np.zeros((joints, n)),
        # Alike below some strength, as where nothing differs.
        "level": np.where(np.arange(n) < 3, 0.0, -50.0) * np.ones((joints, 1)),
        "sharp": np.where(np.arange(n) == [[1], [1], [3]], 0.0, -50.0),
        "drawn": np.random.default_rng(0).normal(size=(joints, n)) * 3,
    }[kind]
    expected = 0.0
    for level in range(n):
        for steps in itertools.product(range(1 - n, n), repeat=joints):
            at = np.clip(level + np.array(steps), 0, n - 1)
            expected += np.exp(gains[np.arange(joints), at].sum() - np.abs(steps).sum())
    assert log_sum(gains) == pytest.approx(np.log(expected), rel=1e-12)


def test_a_worth_at_all_strengths_is_its_sum_where_joints_tell_theirs_for_themselves(simulator):
    logs = _logs(question_of_rows(simulator))
    gains = np.random.default_rng(1).normal(size=(2, len(STRENGTHS))) * 3

    def worth(places):
        return float(gains[[0, 1], list(places)].sum()) + prior(places)

    for places in ((0, 0), (4, 7), (10, 2)):
        assert worth(places) + logs.room(places, worth) == pytest.approx(log_sum(gains))


def test_strengths_are_climbed_to_where_no_step_of_a_joint_gains(simulator):
    logs = _logs(question_of_rows(simulator))

    def worth(places):
        return -abs(places[0] - 7.2) - 0.5 * abs(places[1] - places[0])

    assert logs.climbed((0, 10), worth) == (7, 7)
    # At the ends of the grid.
    assert logs.climbed((5, 5), lambda places: float(sum(places))) == (10, 10)
    assert logs.climbed((5, 5), lambda places: -float(sum(places))) == (0, 0)

    def both(places):
        return logs.left(places).level + prior(places)

    for start in ((0, 0), (6, 6), (10, 3)):
        found = logs.climbed(start, both)
        assert both(found) >= both(start)
        for joint in (0, 1):
            for step in (-1, 1):
                beside = tuple(place + step * (one == joint) for one, place in enumerate(found))
                if all(0 <= place < len(STRENGTHS) for place in beside):
                    assert both(beside) <= both(found)


def test_both_logs_are_worth_what_no_change_is_at_the_best_strengths(simulator):
    logs = _logs(question_of_rows(simulator))
    worth = OverStrengths(logs, priors_of(M), {})
    assert logs.level() == pytest.approx(worth.settled(()).evidence, abs=1e-9)
    assert logs.level() >= max(logs.left(places).level for places in logs.alike())


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
    assert logs.differ_beyond_misfit(NEEDED) == beyond


def at(logs, places, members):
    """Return what a set is worth at some strengths, by a search's weigher of its own."""
    left = logs.left(places)
    k = len(left.projections)
    gram = Gram(left.products, left.projections, np.zeros(k))
    return SwiftWeigher(gram, priors_of(k))(members).evidence + left.level + prior(places)


@pytest.mark.parametrize("members", [(), (0,), (2,), (0, 2), (0, 1, 2)])
def test_a_set_is_worth_what_it_is_at_the_strengths_that_are_best_for_it(simulator, members):
    logs = _logs(question_of_rows(simulator, differences=(1.0, 0.0, -2.0)))
    worth = OverStrengths(logs, priors_of(M), {})
    expected = [at(logs, places, members) for places in logs.alike()]
    assert worth(members).evidence == pytest.approx(max(expected), abs=0.05)
    assert worth.best_places(members) == logs.alike()[int(np.argmax(expected))]
    assert not worth.is_settled(members)
    settled = worth.settled(members)
    assert worth.is_settled(members)
    assert settled.evidence == worth(members).evidence >= max(expected) - 0.05
    places = worth.best_places(members)
    room = logs.room(places, lambda places: at(logs, places, members))
    assert settled.evidence == pytest.approx(at(logs, places, members) + room, abs=0.05)
    for beside in ((places[0] - 1, places[1]), (places[0] + 1, places[1])):
        if 0 <= beside[0] < len(STRENGTHS):
            assert at(logs, beside, members) <= at(logs, places, members) + 0.05


def test_strengths_that_were_climbed_to_are_known_to_all_sets(simulator):
    logs = _logs(question_of_rows(simulator, differences=(1.0, 0.0, -2.0)))
    worth = OverStrengths(logs, priors_of(M), {})
    before = {members: worth(members).evidence for members in ((), (0,), (1,), (0, 2))}
    worth.settled((0, 2))
    for members, evidence in before.items():
        assert worth(members).evidence >= evidence - 0.05


def test_the_price_of_a_set_is_what_it_explains_but_is_not_worth(simulator):
    logs = _logs(question_of_rows(simulator, differences=(4.0, 0.0, 0.0)))
    worth = OverStrengths(logs, priors_of(M), {})
    best = worth.settled((0,))
    places = worth.best_places((0,))
    gain = at(logs, places, (0,)) - logs.left(places).level - prior(places)
    assert worth.price((0,)) == pytest.approx(best.likelihood - gain, abs=0.05)
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
        simulator, (), Model({}), (effect,) * EFFECTS, candidates, ones, ones, tuple(sides), law, stretch < 0
    )


def named(question):
    worth = OverStrengths(_logs(question), priors_of(EFFECTS), {})
    return _named(worth, NEEDED)[0]


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


def test_misfit_of_one_joint_is_no_misfit_of_the_other(simulator):
    # Of the first joint all effects differ; on the second one changed alone.
    question = misfit_question(simulator, 0, apart=0.0)
    step = np.zeros(EFFECTS)
    step[:EACH], step[EACH + 1] = [1.0, -0.8, 0.9, -1.1, 0.7, -0.9, 0.8, -1.0], 3.0
    rows = question.sides[1]
    moved = replace(rows, target=rows.target + rows.columns[:, :EFFECTS] @ step)
    worth = OverStrengths(_logs(replace(question, sides=(question.sides[0], moved))), priors_of(EFFECTS), {})
    best, _ = _named(worth, NEEDED)
    assert best.members == (EACH + 1,)
    places = worth.best_places(best.members)
    assert places[0] > max(places[1:]) + 1


def changed(simulator, shown):
    question = misfit_question(simulator, 0, apart=0.0, change=4.0, shown=shown)
    worth = OverStrengths(_logs(question), priors_of(EFFECTS), {})
    worth.settled(())
    return question, worth, worth.settled((2,))


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
    logs, known = _logs(question), [worth.best_places(members) for members in ((), (2,))]
    ways = [logs, *logs.shortened()]
    found = min(
        max(at(one, places, (2,)) for places in known) - max(at(one, places, ()) for places in known)
        for one in ways
    )
    rooms = [
        logs.room(places, lambda some, own=own: at(logs, some, own)) for own, places in zip(((), (2,)), known)
    ]
    assert len(ways) == 1 + 2 * WINDOWS
    assert worth.losses(whole)[2] == pytest.approx(found + rooms[1] - rooms[0], abs=0.1)


def test_one_member_that_hangs_on_a_window_takes_nothing_from_another(simulator):
    question = misfit_question(simulator, 0, apart=0.0, change=4.0, shown=[3])
    rows = question.sides[1]
    moved = replace(rows, target=rows.target + 4.0 * rows.columns[:, EACH])
    worth = OverStrengths(_logs(replace(question, sides=(question.sides[0], moved))), priors_of(EFFECTS), {})
    whole = worth.settled((2, EACH))
    for members in ((2,), (EACH,)):
        worth.settled(members)
    plain, found = Weigher.losses(worth, whole), worth.losses(whole)
    assert found[2] < 0 < plain[2]
    assert NEEDED < 0.8 * plain[EACH] < found[EACH] <= plain[EACH]
