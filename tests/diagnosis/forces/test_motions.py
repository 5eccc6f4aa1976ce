"""The forces that models lack for a motion, by plain inverse dynamics, and the slopes of them."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from skat.diagnosis.forces.machines import WEAKEST, Candidate, Model
from skat.diagnosis.forces.motions import (
    coefficients_of,
    columns_of,
    driven,
    lacking_forces,
    motion_of,
    rows_about,
)
from tests.diagnosis.changes.arm import arm, effect_of
from tests.diagnosis.forces.test_force_space import ARM, JOINTS, log_of

DT = 0.01


@pytest.fixture(scope="module")
def simulator():
    return arm()


@pytest.fixture(scope="module")
def half(simulator):
    return motion_of(simulator, log_of(4), "before")


def missing(simulator, half, values, *, commands=None, scale=(1.0, 1.0)):
    """Return by inverse dynamics what a model lacks of a motion that is so many times as large as it seems."""
    motion = half
    sent = (motion.commands if commands is None else commands)[motion.rows].mean(axis=1)
    states, pulls = motion.states / np.tile(scale, 2), motion.accelerations / scale
    return simulator.missing_forces(states, pulls, sent[None], [values], slip=motion.slip)[0]


def test_a_motion_is_that_of_positions_alone(simulator):
    X, y, groups = log_of(4)
    whole = motion_of(simulator, (X, y, groups), "before")
    X[:, 2:4] = y[:, 2:4] = np.nan
    alone = motion_of(simulator, (X, y, groups), "before")
    np.testing.assert_array_equal(alone.states, whole.states)
    assert np.isnan(alone.speeds).all()
    assert np.isfinite(whole.speeds).all()


def test_speeds_of_a_block_are_the_mean_of_its_rows_and_what_followed_them(simulator):
    X, y, groups = log_of(4)
    rows = np.arange(len(X))
    X[:, 2:4], y[:, 2:4] = rows[:, None] * [1.0, 10.0], (rows[:, None] + 1.0) * [1.0, 10.0]
    half = motion_of(simulator, (X, y, groups), "before")
    middle = half.rows.mean(axis=1) + 0.5
    np.testing.assert_allclose(half.speeds, middle[:, None] * [1.0, 10.0])


@pytest.mark.parametrize(("rows", "windows"), [(1200, 8), (2400, 12)])
def test_a_log_has_eight_windows_or_more_of_two_seconds(simulator, rows, windows):
    half = motion_of(simulator, log_of(4, rows=rows), "before")
    assert len(np.unique(half.stretches)) == windows


def test_the_model_as_it_is_lacks_what_inverse_dynamics_says(simulator, half):
    found = lacking_forces(simulator, half, [Model({}), Model({"damping[elbow]": 0.3, "mass[lower]": 1.2})])
    for place, values in enumerate(({}, {"damping[elbow]": 0.3, "mass[lower]": 1.2})):
        np.testing.assert_allclose(found[place, :, :2], missing(simulator, half, values), atol=1e-9)
        np.testing.assert_allclose(found[place, :, 2:], half.speeds - half.states[:, 2:])


@pytest.mark.parametrize("late", [1.0, 0.5, -2.0])
def test_late_commands_are_those_of_rows_before(simulator, half, late):
    rows = np.arange(len(half.commands))
    sent = np.column_stack([np.interp(rows - late, rows, one) for one in half.commands.T])
    models = [Model({"mass[lower]": 1.2}), Model({"mass[lower]": 1.2}, late), Model({}, late)]
    found = lacking_forces(simulator, half, models)[:, :, :2]
    for place, values, commands in ((0, 1.2, None), (1, 1.2, sent), (2, 1.0, sent)):
        expected = missing(simulator, half, {"mass[lower]": values}, commands=commands)
        np.testing.assert_allclose(found[place], expected, atol=1e-9)


def test_positions_that_a_sensor_scales_are_those_of_a_smaller_motion(simulator, half):
    model = Model({"scale[qpos.elbow]": 1.25, "damping[elbow]": 0.3})
    found = lacking_forces(simulator, half, [Model({}), model])[1]
    expected = missing(simulator, half, {"damping[elbow]": 0.3}, scale=(1.0, 1.25))
    np.testing.assert_allclose(found[:, :2], expected, atol=1e-9)
    np.testing.assert_allclose(found[:, 2:], half.speeds - half.states[:, 2:] / [1.0, 1.25])


def test_speeds_that_a_sensor_scales_or_shifts_change_no_force(simulator, half):
    model = Model({"scale[qvel.elbow]": 1.25, "bias[qvel.shoulder]": 0.5})
    plain, found = lacking_forces(simulator, half, [Model({}), model])
    np.testing.assert_array_equal(found[:, :2], plain[:, :2])
    expected = half.speeds - half.states[:, 2:] * [1.0, 1.25] - [0.5, 0.0]
    np.testing.assert_allclose(found[:, 2:], expected)


@pytest.mark.parametrize("gain", [0.1, 1.25, -1.5])
def test_forces_count_as_they_are_however_strong_motors_are(simulator, half, gain):
    values = {"gain[elbow]": gain, "damping[shoulder]": 0.1}
    found = lacking_forces(simulator, half, [Model({}), Model(values)])[1, :, :2]
    np.testing.assert_allclose(found, missing(simulator, half, values), atol=1e-9)


def accelerations_of(half, *, friction=(0.0, 0.0), mass=1.0):
    """Return those of MuJoCo's own forward dynamics, in the states and under the commands of each block."""
    model = mujoco.MjModel.from_xml_string(ARM)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "lower")
    model.body_mass[body] *= mass
    model.body_inertia[body] *= mass
    mujoco.mj_setConst(model, mujoco.MjData(model))
    data, found = mujoco.MjData(model), []
    for state, command in zip(half.states, half.commands[half.rows].mean(axis=1), strict=True):
        data.qpos, data.qvel, data.ctrl = state[:2], state[2:], command
        data.qfrc_applied = -np.array(friction) * np.sign(state[2:])
        mujoco.mj_forward(model, data)
        found.append(data.qacc.copy())
    return np.array(found)


def taken(own, measured):
    """Return what is taken of the accelerations of a model and of measured ones, of one joint."""
    explained = own * np.linalg.lstsq(own[:, None], measured, rcond=None)[0]
    rest = measured - explained
    return explained + np.sum(rest**2) / np.sum(measured**2) * rest


@pytest.mark.parametrize("mass", [1.0, 1.7])
def test_a_machine_moves_as_forward_dynamics_say_as_far_as_that_is_what_was_seen(simulator, half, mass):
    found = driven(simulator, half, Model({"mass[lower]": mass}))
    own, measured = accelerations_of(half, mass=mass), half.accelerations
    for joint in range(2):
        expected = taken(own[:, joint], measured[:, joint])
        np.testing.assert_allclose(found.accelerations[:, joint], expected, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(found.states, half.states)


def test_noise_of_accelerations_is_left_out_where_the_model_is_right(simulator, half):
    rng = np.random.default_rng(0)
    own = accelerations_of(half)
    noisy = own * (1 + 0.1 * rng.normal(size=(len(own), 1))) + rng.normal(size=own.shape)
    measured = replace(half, accelerations=noisy)
    found = driven(simulator, measured, Model({})).accelerations
    assert np.std(found - own) < 0.1 * np.std(noisy - own)


def test_dry_friction_slows_a_machine_but_is_no_inertia_of_it(simulator, half):
    friction = (0.1, 0.05)
    found = driven(
        simulator, half, Model({f"dry_friction[{one}]": size for one, size in zip(JOINTS, friction)})
    )
    own, measured = accelerations_of(half, friction=friction), half.accelerations
    # MuJoCo's friction is soft: slower joints have less of it.
    fast = np.abs(half.states[:, 2:]).min(axis=1) > 1.0
    assert fast.sum() > 30
    for joint in range(2):
        expected = taken(own[:, joint], measured[:, joint])
        left = found.accelerations[fast, joint] - expected[fast]
        assert np.std(left) < 0.03 * np.std(expected)


def test_of_a_model_that_moves_the_other_way_no_motion_is_taken(simulator, half):
    backwards = replace(half, accelerations=-half.accelerations)
    found = driven(simulator, backwards, Model({})).accelerations
    np.testing.assert_allclose(found, backwards.accelerations)


@pytest.mark.parametrize("name", ["mass[lower]", "damping[elbow]", "centre_of_mass[lower.z]"])
def test_columns_are_slopes_where_the_machine_moves_by_a_model(simulator, half, name):
    candidates, base, by = (
        [Candidate(effect_of(simulator, name), 1.0, {})],
        Model({}),
        Model({"mass[lower]": 1.4}),
    )
    found = columns_of(simulator, half, base, candidates, np.ones(1), driven_by=by)
    moved = driven(simulator, half, by)
    np.testing.assert_allclose(found, columns_of(simulator, moved, base, candidates, np.ones(1)), atol=1e-9)


@pytest.mark.parametrize("gain", [0.7, 0.05, -1.5])
def test_what_is_lacking_counts_in_units_of_what_its_motor_exerts(simulator, half, gain):
    candidates, base = [Candidate(effect_of(simulator, "gain[elbow]"), 1.0, {})], Model({"gain[elbow]": gain})
    column = columns_of(simulator, half, base, candidates, np.array([0.3]))[:, 0]
    more, less = (target(simulator, half, Model({"gain[elbow]": gain + step})) for step in (0.003, 0.0))
    rows = rows_about(simulator, half, base, [], np.zeros(0))
    lacking = np.where(rows.joint == 1, rows.target, 0.0) / (gain if abs(gain) > WEAKEST else WEAKEST)
    np.testing.assert_allclose(column, 0.3 * ((less - more) / 0.003 + lacking), atol=1e-8)


def test_less_of_all_there_is_explains_nothing(simulator):
    # Log of a machine that rubs; the model lacks it. Motors that do less, and bodies that weigh less, lack as much.
    half = motion_of(simulator, log_of(4, friction=(0.1, 0.05)), "before")
    names = ["gain[shoulder]", "gain[elbow]", "mass[upper]", "mass[lower]"]
    effects = [effect_of(simulator, name) for name in names]
    rows = rows_about(simulator, half, Model({}), effects, np.ones(4))
    assert np.linalg.norm(rows.columns @ np.ones(4)) < 1e-6 * np.linalg.norm(rows.target)


def target(simulator, half, model):
    return coefficients_of(half, lacking_forces(simulator, half, [model]))[0][:, 0]


@pytest.mark.parametrize("name", ["damping[elbow]", "mass[lower]", "scale[qpos.elbow]", "scale[qvel.elbow]"])
def test_columns_are_by_how_much_what_is_lacking_falls(simulator, half, name):
    effect, base = effect_of(simulator, name), Model({"damping[elbow]": 0.5})
    neutral, size = base.values.get(name, effect.neutral), 0.02
    column = columns_of(simulator, half, base, [Candidate(effect, 1.0, {})], np.array([size]))[:, 0]
    more, less = (
        target(simulator, half, Model({**base.values, name: neutral + step})) for step in (1e-4, -1e-4)
    )
    slope = size * (less - more) / 2e-4
    assert np.linalg.norm(column - slope) < 0.01 * np.linalg.norm(slope)


def test_a_column_of_an_effect_at_its_bound_is_that_of_less_of_it(simulator, half):
    effect = effect_of(simulator, "damping[elbow]")
    columns = [
        columns_of(simulator, half, Model({effect.name: at}), [Candidate(effect, 1.0, {})], np.array([0.2]))
        for at in (effect.bounds[1], 1.0)
    ]
    np.testing.assert_allclose(columns[0], columns[1], atol=1e-9)


def test_a_chord_of_a_delay_ends_where_commands_come_so_late(simulator, half):
    delay = Candidate(effect_of(simulator, "delay[action]"), 1.0, {}, 2.0)
    column = columns_of(simulator, half, Model({}, 1.0), [delay], np.array([0.004]))[:, 0]
    fall = target(simulator, half, Model({}, 1.0)) - target(simulator, half, Model({}, 3.0))
    np.testing.assert_allclose(column * 2.0 * DT / 0.004, fall, atol=1e-9)


def test_rows_are_what_a_model_lacks_and_the_columns_of_effects(simulator, half):
    names, sizes, base = ["mass[lower]", "delay[action]"], np.array([0.2, 0.02]), Model({"mass[lower]": 1.5})
    effects = [effect_of(simulator, name) for name in names]
    rows = rows_about(simulator, half, base, effects, sizes)
    np.testing.assert_allclose(rows.target, target(simulator, half, base), atol=1e-9)
    np.testing.assert_allclose(rows.nominal, target(simulator, half, Model({})), atol=1e-9)
    candidates = [Candidate(effects[0], 1.0, {}), Candidate(effects[1], 1.0, {}, 1.0)]
    expected = columns_of(simulator, half, base, candidates, sizes)
    np.testing.assert_allclose(rows.columns, expected, atol=1e-9)


def test_rows_are_forces_then_speeds_as_far_as_their_joint_is_fast(simulator, half):
    rows = rows_about(simulator, half, Model({}), [], np.zeros(0))
    for joint in range(4):
        own = rows.joint == joint
        assert rows.frequency[own].max() <= half.cutoff[joint % 2]
        assert own.sum() == (rows.joint == joint % 2).sum()


def test_speeds_that_were_not_measured_have_no_rows(simulator, half):
    some = replace(half, speeds=np.where([True, False], half.speeds, np.nan))
    rows = rows_about(simulator, some, Model({}), [], np.zeros(0))
    assert np.unique(rows.joint).tolist() == [0, 1, 2]
    assert np.isfinite(rows.target).all()
