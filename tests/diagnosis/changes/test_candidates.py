"""What may have changed: how it is told, what it makes of a model, how far it may go, and what acts alike."""

from dataclasses import replace

import numpy as np
import pytest

from skat.diagnosis.changes.candidates import (
    LATER,
    NEARLY_TURNED,
    distinct,
    offered_candidates,
    priors_of,
    rivals_of,
    units_of,
)
from skat.diagnosis.forces.machines import WEAKEST, Candidate, Model
from tests.diagnosis.changes.arm import arm, effect_of


@pytest.fixture(scope="module")
def simulator():
    return arm()


def candidate(simulator, name, *, odds=1.0, beside=None, late=0.0):
    return Candidate(effect_of(simulator, name), odds, beside or {}, late)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("mass[lower]", 0.25, 1.25),
        ("scale[qvel.elbow]", -0.25, 0.75),
        ("gain[elbow]", -0.5, 0.5),
        ("scale[qpos.elbow]", 0.25, 1.25),
        ("damping[elbow]", -0.25, -0.25),
        ("bias[qpos.elbow]", 0.25, 0.25),
    ],
)
def test_factors_are_told_as_multiples_and_all_else_as_differences(simulator, name, value, told):
    assert candidate(simulator, name).told(value) == pytest.approx(told, rel=1e-12)


def test_a_factor_is_in_units_of_what_it_is_in_both_logs(simulator):
    candidates = [candidate(simulator, name) for name in ("gain[elbow]", "mass[lower]", "damping[elbow]")]
    base = Model({"gain[elbow]": 0.8, "damping[elbow]": 0.3})
    np.testing.assert_array_equal(units_of(candidates, base), [0.8, 1.0, 1.0])


def test_a_model_has_more_of_what_moved(simulator):
    model = Model({"mass[lower]": 1.5, "gain[elbow]": 0.9}, 1.0)
    assert candidate(simulator, "mass[lower]").moved(model, 0.25, 0.01) == replace(
        model, values={"mass[lower]": 1.75, "gain[elbow]": 0.9}
    )
    assert candidate(simulator, "mass[upper]").moved(model, 0.25, 0.01).values["mass[upper]"] == 1.25
    assert candidate(simulator, "damping[elbow]").moved(model, 0.25, 0.01).values["damping[elbow]"] == 0.25
    place = {"payload[lower.x]": 0.1}
    weight = candidate(simulator, "payload[lower]", beside=place).moved(Model({}), 0.25, 0.01)
    assert weight.values == {"payload[lower]": 0.25, **place}


def test_commands_come_later_by_rows(simulator):
    late = candidate(simulator, "delay[action]", late=2.0)
    assert late.moved(Model({}, 1.0), 0.03, 0.01) == Model({}, pytest.approx(4.0))
    assert late.moved(Model({}, 1.0), -0.03, 0.01) == Model({}, pytest.approx(-2.0))


def test_there_is_no_model_beyond_the_bounds_of_an_effect(simulator):
    damping = candidate(simulator, "damping[elbow]")
    low, high = damping.effect.bounds
    assert damping.moved(Model({}), low - 1e-9, 0.01) is None
    assert damping.moved(Model({}), high + 1e-9, 0.01) is None
    assert damping.moved(Model({}), low, 0.01).values == {"damping[elbow]": low}
    assert damping.moved(Model({}), high, 0.01).values == {"damping[elbow]": high}


def test_differences_have_the_bounds_and_the_odds_of_their_effects(simulator):
    names = ["mass[lower]", "damping[elbow]", "gain[elbow]"]
    candidates = [
        candidate(simulator, name, odds=odds) for name, odds in zip(names, (0.5, 0.25, 0.25), strict=True)
    ]
    candidates.append(candidate(simulator, "inertia[lower]", odds=1.0))
    scales = np.array([0.2, 0.5, 0.1, 0.4])
    priors = priors_of(candidates, scales, 0.01)
    # A mass is at least a fifth of what it was, an inertia at most ten times; all damping there can be may have gone.
    # A motor may do nothing, which errors tell as a little less; one that turns the other way has its sign turned.
    damping = candidates[1].effect.bounds[1]
    np.testing.assert_allclose(priors.low * scales, [WEAKEST - 1, -damping, NEARLY_TURNED - 1, WEAKEST - 1])
    np.testing.assert_allclose(priors.high * scales, [19.0, damping, 2.0, 9.0])
    np.testing.assert_allclose(priors.scales, 1.0)
    np.testing.assert_allclose(np.exp(priors.log_odds), np.array([0.5, 0.25, 0.25, 1.0]) / 3.0)
    assert priors.names == ("mass[lower]", "damping[elbow]", "gain[elbow]", "inertia[lower]")


def test_a_factor_keeps_to_bounds_that_are_closer_than_the_weakest(simulator):
    length = candidate(simulator, "length[lower]")
    assert priors_of([length], np.ones(1), 0.01).low == pytest.approx(0.3 - 1)


def test_a_delay_keeps_to_its_end_of_the_chord(simulator):
    candidates = [candidate(simulator, "delay[action]", late=late) for late in (2.0, -2.0, LATER[-1])]
    scales = np.array([0.01, 0.02, 0.01])
    priors = priors_of(candidates, scales, 0.01)
    np.testing.assert_allclose(priors.low * scales, [0.015, -0.025, 0.035])
    np.testing.assert_allclose(priors.high * scales, [0.025, -0.015, 0.045])


def test_all_of_a_family_excludes_each_and_one_place_of_a_weight_another(simulator):
    names = ["damping[shoulder]", "damping[all]", "mass[lower]", "damping[elbow]"]
    candidates = [candidate(simulator, name) for name in names]
    weight = candidate(simulator, "payload[lower]")
    candidates += [replace(weight, beside={"payload[lower.x]": one}) for one in (0.0, 0.1, 0.2)]
    rivals = {place: sorted(others) for place, others in rivals_of(candidates).items()}
    assert rivals == {0: [1], 1: [0, 3], 2: [], 3: [1], 4: [5, 6], 5: [4, 6], 6: [4, 5]}


def at_places(simulator, n):
    weight = candidate(simulator, "payload[lower]", odds=0.25)
    return [replace(weight, beside={"payload[lower.x]": 0.1 * one}) for one in range(n)]


def turned(angle, size=1.0):
    return size * np.array([np.cos(angle), np.sin(angle), 0.0])


def test_places_that_act_alike_are_one_with_the_odds_of_all(simulator):
    # Alike: a cosine above 0.9995, which is 0.0316 rad, and sizes within a tenth.
    columns = [turned(0), turned(0.03), turned(0.034), turned(0, 1.09), turned(0, 1.12), turned(np.pi)]
    kept, places = distinct(at_places(simulator, 6), np.column_stack(columns))
    assert places == [0, 2, 4, 5]
    np.testing.assert_allclose([one.odds for one in kept], [0.75, 0.25, 0.25, 0.25])
    assert [one.beside["payload[lower.x]"] for one in kept] == pytest.approx([0.0, 0.2, 0.4, 0.5])


def test_effects_and_delays_that_act_alike_stay(simulator):
    offered = [candidate(simulator, name) for name in ("mass[lower]", "damping[elbow]")]
    offered += [candidate(simulator, "delay[action]", late=late) for late in LATER[:2]]
    assert distinct(offered, np.ones((3, 4)))[1] == [0, 1, 2, 3]


def test_what_is_not_seen_is_left_out(simulator):
    offered = [candidate(simulator, name) for name in ("mass[lower]", "damping[elbow]", "gain[elbow]")]
    columns = np.array([[2e3, 0.0, 0.0], [0.0, 1.9e-3, 0.0], [0.0, 0.0, 2.1e-3]])
    kept, places = distinct(offered, columns)
    assert places == [0, 2]
    assert kept == [offered[0], offered[2]]


def test_machines_change_in_what_is_seen_and_not_fixed(simulator):
    effects = simulator.effects()
    shown = [
        "mass[lower]",
        "damping[shoulder]",
        "damping[elbow]",
        "gravity",
        "length[lower]",
        "delay[action]",
    ]
    common = [effect_of(simulator, name) for name in shown]
    sizes = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    offered, scales = offered_candidates(simulator, effects, common, sizes, {})
    scale_of = {one.effect.name: scale for one, scale in zip(offered, scales, strict=True)}
    # Weights are tried though nobody asked; of all joints, the largest of each; of factors, that of the effect.
    assert set(scale_of) == {
        "mass[lower]", "damping[shoulder]", "damping[elbow]", "delay[action]", "payload[upper]", "payload[lower]",
        "mass[all]", "damping[all]", "dry_friction[all]", "gain[all]",
    }  # fmt: skip
    assert scale_of["mass[lower]"] == 0.1
    assert scale_of["damping[elbow]"] == 0.3
    assert scale_of["damping[all]"] == 0.3
    assert scale_of["mass[all]"] == effect_of(simulator, "mass[all]").typical
    assert scale_of["dry_friction[all]"] == effect_of(simulator, "dry_friction[all]").typical
    assert scale_of["delay[action]"] == 0.6
    assert scale_of["payload[lower]"] == effect_of(simulator, "payload[lower]").typical


def test_a_users_own_size_of_all_of_a_family_holds(simulator):
    common, sizes = [effect_of(simulator, "damping[elbow]")], np.array([0.3])
    offered, scales = offered_candidates(
        simulator, simulator.effects(), common, sizes, {"damping[all]": 0.05, "payload[lower]": 0.7}
    )
    scale_of = {one.effect.name: scale for one, scale in zip(offered, scales, strict=True)}
    assert (scale_of["damping[all]"], scale_of["payload[lower]"]) == (0.05, 0.7)


def test_delays_and_places_share_the_odds_of_their_effect(simulator):
    offered, _ = offered_candidates(simulator, simulator.effects(), [], np.zeros(0), {})
    delays = [one for one in offered if one.effect.family == "delay"]
    assert sorted(one.late for one in delays) == sorted([*LATER, *(-late for late in LATER)])
    weights = [one for one in offered if one.effect.name == "payload[lower]"]
    places = simulator.payload_places("lower", per_axis=3)
    axes = [f"payload[lower.{axis}]" for axis in "xyz"]
    np.testing.assert_allclose([[one.beside[axis] for axis in axes] for one in weights], places)
    for same in (delays, weights):
        assert sum(one.odds for one in same) == pytest.approx(same[0].effect.odds)
        assert len({one.odds for one in same}) == 1
    assert all(one.late == 0 for one in offered if one not in delays)
