"""The regression of two logs: what is common of motors and delays, units of columns, and windows held out."""

from dataclasses import replace

import numpy as np
import pytest

from skat.diagnosis.changes.law import settled_law
from skat.diagnosis.changes.question import (
    Machines,
    _about_machines,
    _bases,
    _held_out,
    question_of,
)
from skat.diagnosis.forces.force_space import Rows
from skat.diagnosis.forces.machines import WEAKEST, Candidate, Model
from skat.diagnosis.forces.motions import (
    _later,
    coefficients_of,
    columns_of,
    lacking_forces,
    motion_of,
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
    return replace(half, commands=_later(half.commands, half.episodes, -late))


WHOLE = ("dry_friction[shoulder]", "dry_friction[elbow]", "damping[shoulder]", "damping[elbow]")


def bases_of(simulator, lates, *, needed, names=WHOLE, **truth):
    halves = [
        later_by(motion_of(simulator, log_of(seed, rows=600, **truth), "log"), late)
        for seed, late in zip((4, 5), lates, strict=True)
    ]
    effects, sizes = [effect_of(simulator, name) for name in names], np.full(len(names), 0.3)
    sides = [rows_about(simulator, half, Model({}), effects, sizes) for half in halves]
    sides = [with_friction(simulator, *one, effects, sizes) for one in zip(halves, sides, strict=True)]
    return _bases(Machines(simulator, halves, Model({}), effects, sizes), sides, needed)


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
    half = motion_of(simulator, log_of(4, rows=600), "log")
    effects = [effect_of(simulator, name) for name in ("damping[elbow]", "dry_friction[elbow]")]
    rows = rows_about(simulator, half, Model({}), effects, np.array([0.3, 0.2]))
    found = with_friction(simulator, half, rows, effects, np.array([0.3, 0.2])).columns
    models = [Model({}), Model({"dry_friction[elbow]": 0.2})]
    whole = coefficients_of(half, lacking_forces(simulator, half, models))[0]
    np.testing.assert_allclose(found[:, 1], whole[:, 0] - whole[:, 1], atol=1e-9)
    np.testing.assert_array_equal(found[:, 0], rows.columns[:, 0])


def test_columns_are_as_they_are_where_no_dry_friction_is_asked_about(simulator):
    half = motion_of(simulator, log_of(4, rows=600), "log")
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
    halves = [motion_of(simulator, log, "log") for log in logs]
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
    machines = Machines(simulator, (), Model({}, 2.0), (effect_of(simulator, name),), np.array([0.5]))
    found = machines.model(np.array([2 * value]))
    assert found == Model({name: pytest.approx(has)}, 2.0)


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


def test_the_machine_has_what_is_common_to_both_logs(simulator):
    logs = [log_of(seed, rows=600, damping=(0.1, 0.05), gain=(1.3, 0.8)) for seed in (4, 5)]
    halves = [motion_of(simulator, log, "log") for log in logs]
    names = ["damping[shoulder]", "damping[elbow]", "gain[shoulder]", "gain[elbow]"]
    effects = [effect_of(simulator, name) for name in names]
    question = question_of(simulator, halves, effects, typical={}, test_size=0.3, needed=np.log(100))
    assert question.base == Model({})
    for name, truth in zip(names, (0.1, 0.05, 1.3, 0.8), strict=True):
        assert question.machine.values[name] == pytest.approx(truth, rel=0.05), name
    # About it slopes lead nowhere else.
    assert np.abs((question.law.value - question.here) * question.sizes).max() < 0.03


@pytest.mark.parametrize("joint", [0, 1])
def test_a_motor_whose_commands_are_turned_is_not_one_that_died(simulator, joint):
    more = {"friction": (0.12, 0.06), "damping": (0.1, 0.05), "mass": 1.15, "rows": 600}
    names = ["damping[shoulder]", "damping[elbow]", "mass[lower]", "gain[shoulder]", "gain[elbow]"]
    effects = [effect_of(simulator, name) for name in names]
    died = log_of(5, **more, gain=tuple(float(one != joint) for one in range(2)))
    turned = log_of(5, **more)
    turned[0][:, 4 + joint] *= -1
    for after, weak in ((died, (names[3 + joint],)), (turned, ())):
        halves = [motion_of(simulator, log, "log") for log in (log_of(4, **more), after)]
        question = question_of(simulator, halves, effects, typical={}, test_size=0.3, needed=np.log(100))
        assert question.weak == weak


GAINS = ("gain[shoulder]", "gain[elbow]", "mass[lower]")


@pytest.mark.parametrize(
    ("led", "found"),
    [((0.3, -0.2, 0.0), 1.0), ((0.6, -0.4, 0.0), 0.5), ((2.4, -1.6, 0.0), 0.125), ((-0.9, 0.9, 0.0), 0.0)],
)
def test_a_machine_goes_as_far_as_slopes_lead_to_where_less_is_lacking(simulator, monkeypatch, led, found):
    halves = [motion_of(simulator, log_of(seed, rows=600, gain=(1.3, 0.8)), "log") for seed in (4, 5)]
    effects, sizes = [effect_of(simulator, name) for name in GAINS], np.array([0.2, 0.2, 0.2])
    base = Model({})
    values = np.array(led) / sizes

    def led_there(sides, ends):
        return replace(settled_law(sides, ends), value=values, second=values)

    monkeypatch.setattr("skat.diagnosis.changes.question.settled_law", led_there)
    monkeypatch.setattr("skat.diagnosis.changes.question.TURNS", 2)
    about, _, _, _ = _about_machines(Machines(simulator, halves, base, effects, sizes), 0.0, np.log(100))
    np.testing.assert_allclose(about, [found * values] * 2)


def test_what_is_lacking_is_over_what_windows_have_of_their_own_in_units_of_what_motors_exert(simulator):
    half = motion_of(simulator, log_of(4, rows=400), "log")
    effects, sizes = [effect_of(simulator, name) for name in GAINS], np.array([0.2, 0.2, 0.2])
    rows = rows_about(simulator, half, Model({}), effects, sizes)
    noise = np.linspace(0.5, 2.0, len(rows.target))
    law = replace(settled_law([rows, rows]), spread=np.array([0.3, 0.1, 2.0]))
    gains = (1.0, -0.5, 0.01)
    models = [Model({"gain[shoulder]": one, "mass[lower]": 1.2}) for one in gains]
    window = rows.stretch[:, None] == rows.stretch
    covariance = np.diag(noise**2) + (rows.columns * law.spread) @ rows.columns.T * window
    expected = []
    for model, gain in zip(models, gains, strict=True):
        left = coefficients_of(half, lacking_forces(simulator, half, [model]))[0][:, 0]
        left = np.where(rows.joint == 0, left / max(abs(gain), WEAKEST), left)
        expected.append(left @ np.linalg.solve(covariance, left))
    machines = Machines(simulator, (half,), Model({}), effects, sizes)
    found = machines.squares_lacking(0, rows, replace(law, noise=(noise, noise)), models)
    np.testing.assert_allclose(found, expected)


def test_the_second_machine_lacks_least_with_what_changed(simulator):
    before, after = log_of(4, rows=600), log_of(5, rows=600, gain=(1.0, 1.25), damping=(0.0, 0.05))
    names = ("gain[elbow]", "damping[elbow]")
    candidates = [Candidate(effect_of(simulator, name), 1.0, {}) for name in names]
    question = question_about(simulator, before, after, effects=names, candidates=candidates)
    sets = [np.zeros(2), np.array([0.25, 0.0]), np.array([0.0, 0.05]), np.array([0.25, 0.05])]
    lacking = question.lacking([(np.zeros(2), one / question.scales) for one in sets])
    assert np.argmin(lacking) == 3
    assert np.argmax(lacking) == 0
    # Beside what is common a difference counts from there.
    beside = (np.array([0.25, 0.0]) / question.sizes, sets[2] / question.scales)
    assert question.lacking([beside])[0] == pytest.approx(lacking[3])
