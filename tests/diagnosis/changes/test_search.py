"""The search of what changed: its regression against a dense one, and what is never named."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize

from skat.diagnosis.changes import find_changes
from skat.diagnosis.changes.search import _at_bounds, _common, _impossible, _logs
from skat.diagnosis.changes.strengths import LEAST, OverStrengths
from skat.diagnosis.evidence import WIDTH_95, Priors, Weighed
from skat.diagnosis.findings import Gain
from skat.diagnosis.forces.machines import Candidate, Model
from skat.diagnosis.search import without_weak
from tests.diagnosis.changes.arm import arm, effect_of
from tests.diagnosis.changes.drawn import ALIKE, WEIGHTS, K, M, dense, question_of_rows
from tests.diagnosis.forces.test_force_space import log_of


@pytest.fixture(scope="module")
def simulator():
    return arm()


@pytest.mark.parametrize("most", [np.inf, 0.05])
def test_what_is_common_is_likeliest_given_the_differences_of_what_a_machine_may_have(simulator, most):
    question = question_of_rows(simulator)
    strength, steps, ends = 0.1, np.array([0.5, -1.0, 2.0]), (np.full(K, -most), np.full(K, most))
    apart = 1 / (ALIKE.sum(axis=0) / strength + LEAST)
    z, D, N, covariance, _ = dense(question, apart)
    over = np.linalg.solve(covariance, N)
    H = over.T @ N + np.diag(WEIGHTS)
    level, value = _common(_logs(question), strength, steps, ends)
    for found, target in ((level, z), (value, z - D @ steps)):
        root = np.linalg.cholesky(H)
        expected = optimize.lsq_linear(root.T, np.linalg.solve(root, over.T @ target), bounds=ends, tol=1e-14)
        np.testing.assert_allclose(found, expected.x, atol=1e-6)
    assert (np.abs(value).max() == most) == np.isfinite(most)


def test_windows_that_are_held_out_tell_nothing(simulator):
    question = question_of_rows(simulator)
    rows, law = question.sides[1], question.law
    target = np.where(question.held_out, 1e3, rows.target)
    other = replace(question, sides=(question.sides[0], replace(rows, target=target)))
    found, expected = _logs(other), _logs(question)
    assert (len(found.firsts), len(found.seconds)) == (5, 4)
    assert found.second.level == expected.second.level
    np.testing.assert_array_equal(found.second.projections, expected.second.projections)
    assert found.law is law


def test_a_set_with_more_names_must_be_worth_what_they_need(simulator):
    question = question_of_rows(simulator, differences=(0.0, 0.0, 1.5))
    priors = Priors(("",) * M, np.ones(M), np.full(M, np.log(0.1)), np.full(M, -50.0), np.full(M, 50.0))

    def named(needed):
        worth = OverStrengths(_logs(question), priors, {})
        best, nats = without_weak(worth.best(needed), worth, needed)
        return best.members, nats

    members, nats = named(np.log(100))
    assert members == (2,)
    worth = OverStrengths(_logs(question), priors, {})
    gain = worth((2,)).evidence - worth(()).evidence
    assert nats[2] == pytest.approx(worth.losses(worth((2,)))[2], abs=0.05)
    assert nats[2] <= gain + 0.05
    assert named(nats[2] - 0.1)[0] == (2,)
    assert named(nats[2] + 0.1) == ((), {})


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
def logs():
    """Two logs between which the elbow is damped."""
    return log_of(4, rows=800), log_of(5, rows=800, damping=(0.0, 0.1))


def test_what_would_have_to_be_at_an_end_of_what_is_possible_is_not_named(simulator, logs):
    narrow = replace(effect_of(simulator, "damping[elbow]"), bounds=(0.0, 0.05))
    assert "damping[elbow]" not in [one.name for one in find_changes(simulator, *logs, [narrow]).changes]


def test_a_change_is_named_where_its_odds_are_as_long_as_asked(simulator, logs):
    # Of one effect alone misfit that looks like it cannot be told from a change.
    families = ("damping", "mass", "gain", "armature", "dry_friction")
    effects = [effect_of(simulator, f"{one}[{'lower' if one == 'mass' else 'elbow'}]") for one in families]
    (change,) = find_changes(simulator, *logs, effects).changes
    assert (change.name, change.value) == ("damping[elbow]", pytest.approx(0.1, rel=0.05))
    alpha = float(np.exp(-change.evidence - 0.1))
    assert find_changes(simulator, *logs, effects, alpha=alpha).verdict == "nothing changed"


@pytest.mark.parametrize(
    ("name", "difference", "impossible"),
    [
        # In both logs .1 + .2 * .5 = .2 at the elbow, and .05 * .5 at the shoulder; errors are .03.
        ("damping[elbow]", -0.19, False),
        ("damping[elbow]", -0.22, False),
        ("damping[elbow]", -0.24, True),
        ("damping[shoulder]", -0.24, True),
        ("damping[all]", -0.04, False),
        # Of all of a family no joint may have less than none.
        ("damping[all]", -0.1, True),
        ("mass[lower]", -0.5, False),
        ("mass[lower]", -1.2, True),
        ("gain[elbow]", -2.0, False),
        ("delay[action]", -5.0, False),
        ("payload[lower]", -0.3, False),
    ],
)
def test_what_no_machine_can_have_with_what_is_common_is_not_named(simulator, name, difference, impossible):
    effect = effect_of(simulator, name)
    candidate = Candidate(effect, 1.0, {}, float(name.startswith("delay")))
    effects = [effect_of(simulator, one) for one in ("damping[elbow]", "damping[shoulder]", "mass[lower]")]
    question = replace(
        question_of_rows(simulator),
        candidates=(candidate,),
        scales=np.array([0.5]),
        effects=tuple(effects),
        sizes=np.array([0.2, 0.05, 0.1]),
        base=Model({"damping[elbow]": 0.1}),
    )
    best = Weighed((0,), np.array([difference / 0.5]), 0.0, 0.0, np.array([[(WIDTH_95 * 0.5 / 0.03) ** 2]]))
    assert _impossible(best, question, np.array([0.5, 0.5, 0.0])) == [0] * impossible


@pytest.mark.parametrize(("explained", "verdict"), [(0.4, "unexplained"), (0.6, "named")])
def test_what_explains_little_of_the_windows_held_out_is_not_named(
    simulator, logs, monkeypatch, explained, verdict
):
    def gain_of(*_):
        return Gain(5.0, 5.0 - 4.0 * explained, 1.0, explained, (0.0, 1.0), 0.0, {})

    monkeypatch.setattr("skat.diagnosis.changes.search.gain_of", gain_of)
    names = [f"{family}[elbow]" for family in ("damping", "dry_friction", "stiffness", "armature", "gain")]
    found = find_changes(simulator, *logs, [effect_of(simulator, name) for name in names])
    assert found.verdict == verdict
    assert bool(found.changes) == (verdict == "named")
    assert ("explains too little of parts" in found.reason) == (verdict == "unexplained")
