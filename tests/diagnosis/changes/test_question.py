"""The regression of two logs: what is common of motors and delays, units of columns, and windows held out."""

from dataclasses import replace

import numpy as np
import pytest

from skat.diagnosis.changes.question import (
    _bases,
    _held_out,
    model_about,
    question_of,
)
from skat.diagnosis.forces.force_space import Rows
from skat.diagnosis.forces.machines import WEAKEST, Candidate, Model
from skat.diagnosis.forces.motions import (
    _later,
    coefficients_of,
    columns_of,
    half_of,
    lacking_forces,
    rows_about,
    shares_of,
    with_friction,
)
from tests.diagnosis.changes.arm import arm, effect_of, question_about
from tests.diagnosis.forces.test_force_space import log_of


@pytest.fixture(scope="module")
def simulator():
    return arm()


def rows_of(columns, joint, *, nominal=None):
    zeros = np.zeros(len(joint))
    nominal = zeros if nominal is None else np.array(nominal)
    return Rows(zeros, np.array(columns, dtype=float), np.array(joint), zeros, zeros.astype(int), nominal)


def test_an_effect_exerts_its_share_of_the_joint_that_feels_it_most():
    rows = rows_of(
        [[3.0, 0.0], [4.0, 1.0], [6.0, 1.0], [8.0, 0.0]], [0, 0, 1, 1], nominal=[5.0, 5.0, 50.0, 0.0]
    )
    np.testing.assert_allclose(shares_of(rows), [0.5**0.5, 0.02**0.5])


def later_by(half, late):
    """Return a log whose commands reached its machine so many rows later than it says."""
    return replace(
        half, motion=replace(half.motion, commands=_later(half.motion.commands, half.motion.episodes, -late))
    )


WHOLE = ("dry_friction[shoulder]", "dry_friction[elbow]", "damping[shoulder]", "damping[elbow]")


def bases_of(simulator, lates, *, needed, names=WHOLE, **truth):
    halves = [
        later_by(half_of(simulator, log_of(seed, rows=600, **truth), "log"), late)
        for seed, late in zip((4, 5), lates, strict=True)
    ]
    effects, sizes = [effect_of(simulator, name) for name in names], np.full(len(names), 0.3)
    sides = [rows_about(simulator, half, Model({}), effects, sizes) for half in halves]
    sides = [with_friction(simulator, *one, effects, sizes) for one in zip(halves, sides, strict=True)]
    return _bases(simulator, halves, sides, effects, sizes, needed)


@pytest.mark.parametrize("lates", [(0.0, 0.0), (1.5, 1.5), (0.0, 2.0), (2.5, 0.5)])
def test_each_log_has_commands_as_late_as_they_come_in_it(simulator, lates):
    base, second = bases_of(simulator, lates, needed=np.log(100), damping=(0.1, 0.05))
    # Between rows commands are interpolated, which blurs them.
    assert (base.late, second) == pytest.approx(lates, abs=0.3)
    assert (base.late == second) == (lates[0] == lates[1])


def test_logs_that_hardly_tell_apart_how_late_commands_come_have_them_equally_late(simulator):
    base, second = bases_of(simulator, (0.0, 2.0), needed=1e6, damping=(0.1, 0.05))
    assert base.late == second
    assert 0.0 <= second <= 2.0


def test_the_model_has_the_dry_friction_that_logs_show(simulator):
    truth = {"friction": (0.12, 0.06), "damping": (0.1, 0.05)}
    first, second = bases_of(simulator, (0.0, 0.0), needed=np.log(100), **truth)
    assert first.late == second == 0.0
    assert set(first.values) == {"dry_friction[shoulder]", "dry_friction[elbow]"}
    assert first.values["dry_friction[shoulder]"] == pytest.approx(0.12, rel=0.15)
    assert first.values["dry_friction[elbow]"] == pytest.approx(0.06, rel=0.15)


def test_no_more_dry_friction_is_in_the_model_than_there_can_be(simulator):
    names = ("dry_friction[shoulder]", "dry_friction[elbow]")
    first, _ = bases_of(simulator, (0.0, 0.0), needed=np.log(100), names=names)
    for name in names:
        assert 0.0 <= first.values.get(name, 0.0) < 0.01


def test_columns_of_dry_friction_are_all_that_a_typical_size_of_it_exerts(simulator):
    half = half_of(simulator, log_of(4, rows=600), "log")
    effects = [effect_of(simulator, name) for name in ("damping[elbow]", "dry_friction[elbow]")]
    rows = rows_about(simulator, half, Model({}), effects, np.array([0.3, 0.2]))
    found = with_friction(simulator, half, rows, effects, np.array([0.3, 0.2])).columns
    models = [Model({}), Model({"dry_friction[elbow]": 0.2})]
    whole = coefficients_of(half, lacking_forces(simulator, half, models))[0]
    np.testing.assert_allclose(found[:, 1], whole[:, 0] - whole[:, 1], atol=1e-9)
    np.testing.assert_array_equal(found[:, 0], rows.columns[:, 0])


def test_columns_are_as_they_are_where_no_dry_friction_is_asked_about(simulator):
    half = half_of(simulator, log_of(4, rows=600), "log")
    effects, sizes = [effect_of(simulator, "damping[elbow]")], np.array([0.3])
    rows = rows_about(simulator, half, Model({}), effects, sizes)
    found = with_friction(simulator, half, rows, effects, sizes)
    np.testing.assert_array_equal(found.columns, rows.columns)


def test_columns_are_in_units_of_what_typically_is_exerted(simulator):
    names = ["damping[shoulder]", "damping[elbow]", "mass[lower]", "scale[qvel.shoulder]", "bias[qvel.elbow]"]
    effects = [effect_of(simulator, name) for name in names]
    logs = [log_of(seed, rows=600, damping=(0.1, 0.05)) for seed in (4, 5)]
    for X, y, _ in logs:
        X[:, 3] = y[:, 3] = np.nan
    halves = [half_of(simulator, log, "log") for log in logs]
    question = question_of(
        simulator, halves, effects, typical={"damping[elbow]": 0.05}, test_size=0.3, needed=np.log(100)
    )
    # A bias of speeds that were not measured shows nowhere.
    assert [effect.name for effect in question.effects] == names[:4]
    np.testing.assert_allclose(question.sizes[1:], [0.05, 0.2, effects[3].typical])
    first, second = question.sides
    both = rows_of(
        np.vstack([first.columns, second.columns[:, :4]]),
        np.r_[first.joint, second.joint],
        nominal=np.r_[first.nominal, second.nominal],
    )
    assert shares_of(both)[0] == pytest.approx(effects[0].force_share, rel=1e-6)
    # Forces on both joints, and the speed of the one that was measured: a scale of speeds shows there alone.
    assert question.law.alike.shape == (3, 4)
    np.testing.assert_array_equal(question.law.alike[2] > 0, [False, False, False, True])
    np.testing.assert_array_equal(question.law.alike[:2, 3], 0.0)
    assert second.columns.shape[1] == 4 + len(question.candidates) == 4 + len(question.scales)
    assert len(np.unique(second.stretch[question.held_out])) == round(0.3 * len(np.unique(second.stretch)))
    value, differences = np.array([0.3, -0.2, 0.1, 0.4]), np.linspace(-1, 1, len(question.candidates))
    left = question.left(value, differences)
    np.testing.assert_allclose(left[0], first.target - first.columns @ value)
    expected = second.target - second.columns[:, :4] @ value - second.columns[:, 4:] @ differences
    np.testing.assert_allclose(left[1], expected, atol=1e-9)


@pytest.mark.parametrize(
    ("n", "share", "held"),
    [(8, 0.25, [2, 4]), (8, 0.0, []), (10, 0.3, [2, 4, 6]), (3, 0.9, [1]), (2, 0.5, []), (1, 0.5, [])],
)
def test_windows_that_are_held_out_are_spread_and_leave_two(n, share, held):
    stretch = np.repeat(np.arange(n), 3)
    assert np.unique(stretch[_held_out(stretch, share)]).tolist() == held


@pytest.mark.parametrize(
    ("name", "value", "has"),
    [
        ("gain[elbow]", 0.2, 1.2),
        # A motor may turn the other way, as in a model with a wrong sign; no body may weigh less than nothing.
        ("gain[elbow]", -2.0, -1.0),
        ("gain[elbow]", -9.0, -3.0),
        ("scale[qpos.elbow]", 0.2, 1.2),
        ("mass[lower]", 0.25, 1.25),
        ("mass[lower]", -1.5, WEAKEST),
        ("damping[elbow]", 0.25, 0.25),
        ("damping[elbow]", -0.25, 0.0),
    ],
)
def test_a_model_about_what_is_common_is_one_that_a_machine_may_have(simulator, name, value, has):
    found = model_about(Model({}, 2.0), [effect_of(simulator, name)], np.array([0.5]), np.array([2 * value]))
    assert found == Model({name: pytest.approx(has)}, 2.0)


def test_it_is_no_machine_whose_missing_force_is_mostly_explained_by_what_none_has(simulator):
    logs = (log_of(seed, damping=(0.0, 0.3), rows=400) for seed in (4, 5))
    question = question_about(simulator, *logs, effects=("damping[elbow]",))
    assert question.describes_a_machine()

    def told(value, target):
        first, second = question.sides
        missing = first.columns @ target
        sides = replace(first, target=missing, nominal=missing), second
        return replace(question, sides=sides, law=replace(question.law, value=value))

    # Its joint is driven by what it rubs at.
    driven = -0.9 * question.law.value
    assert not told(driven, driven).describes_a_machine()
    assert told(0.2 * driven, driven).describes_a_machine()


DT = 0.01
CHANGED = ("mass[lower]", "damping[all]", "gain[elbow]")
PLACE = {"payload[lower.x]": 0.0, "payload[lower.y]": 0.0, "payload[lower.z]": -0.3}


@pytest.mark.parametrize("named", [(), ("mass[lower]",), ("damping[all]",), CHANGED])
def test_a_question_about_changes_is_exact_where_the_machine_has_them(simulator, named):
    effects = ["gain[elbow]", "mass[lower]", "damping[shoulder]", "damping[elbow]"]
    candidates = [Candidate(effect_of(simulator, name), 1.0, {}) for name in CHANGED]
    base = Model({"gain[elbow]": 0.8, "damping[elbow]": 0.1})
    question = question_about(
        simulator, log_of(4, rows=400), log_of(5, rows=400), effects=effects, candidates=candidates, base=base
    )
    value = np.array([0.5, -0.3, 0.001, 0.002])
    steps = np.where(np.isin(CHANGED, named), [1.5, 0.01, -0.5], 0.0)
    about = question.about(value, steps)
    common = dict(zip(effects, value * question.sizes, strict=True))
    scale = dict(zip(CHANGED, steps * question.scales, strict=True))
    machine = Model(
        {
            # A gain is so many times what it is in both logs.
            "gain[elbow]": 0.8 + common["gain[elbow]"] + 0.8 * scale["gain[elbow]"],
            "mass[lower]": 1 + common["mass[lower]"] + scale["mass[lower]"],
            "damping[shoulder]": common["damping[shoulder]"],
            "damping[elbow]": 0.1 + common["damping[elbow]"],
            "damping[all]": scale["damping[all]"],
        }
    )
    half = question.halves[1]
    expected = coefficients_of(half, lacking_forces(simulator, half, [machine]))[0][:, 0]
    np.testing.assert_allclose(about.left(value, steps)[1], expected, atol=1e-8)
    np.testing.assert_array_equal(about.sides[0].columns, question.sides[0].columns)


def test_a_weight_that_was_found_drives_the_machine_and_is_left_to_its_column(simulator):
    weight = Candidate(effect_of(simulator, "payload[lower]"), 1.0, PLACE)
    late = Candidate(effect_of(simulator, "delay[action]"), 1.0, {}, 2.0)
    question = question_about(
        simulator,
        log_of(4, rows=400),
        log_of(5, rows=400),
        effects=["damping[elbow]"],
        candidates=[weight, late],
    )
    kilograms, seconds, half = 0.2, 0.02, question.halves[1]
    about = question.about(np.zeros(1), np.array([kilograms, seconds]) / question.scales).sides[1]
    moved = Model({**PLACE, "payload[lower]": kilograms}, seconds / DT)
    arguments = simulator, half, Model({}), [weight, late], question.scales
    np.testing.assert_allclose(about.columns[:, 1:], columns_of(*arguments, driven_by=moved), atol=1e-9)
    np.testing.assert_allclose(about.target, question.sides[1].target, atol=1e-9)


def test_no_machine_is_where_nothing_was_found_but_that_of_both_logs(simulator):
    logs = [log_of(seed, rows=600, damping=(0.1, 0.05), gain=(1.3, 0.8)) for seed in (4, 5)]
    halves = [half_of(simulator, log, "log") for log in logs]
    names = ["damping[shoulder]", "damping[elbow]", "gain[shoulder]", "gain[elbow]"]
    effects = [effect_of(simulator, name) for name in names]
    question = question_of(simulator, halves, effects, typical={}, test_size=0.3, needed=np.log(100))
    # What is common is in the model, and little is left of it.
    base = question.base.values
    for name, truth in zip(names, (0.1, 0.05, 1.3, 0.8), strict=True):
        assert base[name] == pytest.approx(truth, rel=0.05), name
    assert np.abs(question.law.value * question.sizes).max() < 0.03
