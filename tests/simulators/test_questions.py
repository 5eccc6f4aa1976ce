"""What a MuJoCo simulator is asked beside its predictions: limits, commands, forces, places, contacts."""

import mujoco
import numpy as np
import pytest

from skat.simulators import MujocoSimulator

ARM = """
<mujoco><compiler angle="radian"/><option timestep="0.004" integrator="implicitfast"/><worldbody>
<body name="upper" pos="0 0 1"><joint name="lift" axis="0 1 0" damping="0.1" range="-1 1" limited="true"/>
<geom type="box" pos="0.1 0 0" size="0.1 0.02 0.03" mass="1"/>
<body name="sled" pos="0.2 0 0"><joint name="slide" type="slide" axis="1 0 0"/><geom size="0.02" mass="0.3"/></body>
</body><body name="tag" mocap="true"/></worldbody>
<actuator><motor name="m" joint="lift" ctrlrange="-2 3" ctrllimited="true" forcerange="-1 1" forcelimited="true"/>
<position name="p" joint="slide" kp="5" kv="0.1"/></actuator></mujoco>
"""
BOX = '<mujoco><worldbody><body name="box"><freejoint name="root"/><geom size="0.1"/></body></worldbody></mujoco>'


@pytest.fixture(scope="module")
def arm():
    return MujocoSimulator(ARM, frame_skip=5)


def test_angles_limits_and_steps_are_those_of_the_model(arm):
    assert arm.angle_names == ("qpos.lift", "qvel.lift")
    assert arm.command_limits == {"ctrl.m": (-2.0, 3.0)}
    assert arm.servo_limits == {}  # the motor is limited, the servo is not
    assert (arm.time_step, arm.dt) == (0.004, pytest.approx(0.02))
    assert arm.units == {"qpos.lift": "rad", "qpos.slide": "m", "qvel.lift": "rad/s", "qvel.slide": "m/s"}
    assert arm.residual_names == arm.state_names == arm.output_names
    assert repr(arm.extended({"gravity": 1.1})).endswith("frame_skip=5, built_in={'gravity': 1.1})")


def test_a_bias_is_at_most_half_a_turn_or_ten_of_the_rest(arm):
    found = {effect.name: effect for effect in arm.all_effects()}
    for name, limit in {"qpos.lift": np.pi, "qpos.slide": 10, "qvel.lift": 10, "qvel.slide": 10}.items():
        assert found[f"bias[{name}]"].bounds == (-limit, limit)
        low, high = found[f"scale[{name}]"].bounds
        assert low * high == pytest.approx(1.0)
        assert found[f"lag[{name}]"].typical == pytest.approx(0.02)
    free = {effect.name for effect in MujocoSimulator(BOX).all_effects()}
    assert {"bias[qpos.root.x]", "scale[qvel.root.wz]"} <= free
    assert not any(f"[qpos.root.q{part}]" in name for part in "wxyz" for name in free)


def test_commands_that_act_are_the_mean_of_what_reaches_the_motors(arm):
    commands = np.array([[1.0, 2.0], [3.0, -2.0], [0.5, 0.0]])
    plain, late = arm.acting_commands(commands, [{}, {"delay[action]": 0.008}])
    np.testing.assert_array_equal(plain, commands)
    before = np.vstack([commands[:1], commands[:-1]])
    np.testing.assert_allclose(late, 0.6 * commands + 0.4 * before, atol=1e-12)
    two = arm.acting_commands(commands, [{"delay[action]": 0.02}], groups=[0, 1, 1])[0]
    np.testing.assert_allclose(two, commands[[0, 1, 1]], atol=1e-12)
    assert arm.n_lags({"delay[action]": 0.02}) == 1
    assert arm.n_lags({"delay[action]": 0.021}) == 2
    assert arm.n_lags() == 0


def test_a_motion_of_the_model_needs_no_further_force_and_limits_are_not_asked(arm):
    model = arm.compiled()
    states = np.random.default_rng(0).uniform(-0.5, 0.5, size=(6, 4))
    commands = np.random.default_rng(1).uniform(-3, 3, size=(6, 2))
    accelerations, capped = np.empty((6, 2)), np.empty(6)
    data = mujoco.MjData(model)
    for row in range(6):
        data.qpos[:], data.qvel[:] = np.split(states[row], 2)
        data.ctrl[:] = commands[row]
        mujoco.mj_forward(model, data)
        accelerations[row] = data.qacc
        capped[row] = data.actuator_force[0] - np.clip(commands[row, 0], -2, 3)
    nothing, heavier = arm.missing_forces(
        states, accelerations, np.stack([commands] * 2), [{}, {"mass[sled]": 1.5}]
    )
    np.testing.assert_allclose(nothing[:, 1], 0, atol=1e-9)
    np.testing.assert_allclose(nothing[:, 0], capped, atol=1e-9)  # what the motor's limit has taken off
    assert np.abs(heavier).max() > 0.1
    pushed, _ = arm.missing_forces(
        states, accelerations, np.stack([commands] * 2), [{"force[slide]": 0.7}, {}]
    )
    np.testing.assert_allclose(pushed[:, 1], -0.7, atol=1e-9)
    np.testing.assert_array_equal(
        arm.constrained(np.array([[0.0, 0, 0, 0], [1.1, 0, 0, 0], [-1.1, 0, 0, 0]])), [False, True, True]
    )


def test_inverse_dynamics_knows_no_play(arm):
    states = np.random.default_rng(0).uniform(-1.5, 1.5, size=(6, 4))
    accelerations, commands = np.random.default_rng(1).normal(size=(2, 6, 2))
    loose = arm.extended({"backlash[slide]": 0.01})
    for values in ({}, {"mass[sled]": 1.5, "stribeck[slide]": 0.3}, {"force[slide]": 0.7}):
        rigid = arm.missing_forces(states, accelerations, commands[None], [values])
        found = loose.missing_forces(states, accelerations, commands[None], [values])
        np.testing.assert_array_equal(found, rigid)
    np.testing.assert_array_equal(loose.constrained(states), arm.constrained(states))
    assert arm.constrained(states).any()


def test_dry_friction_is_no_missing_force_where_a_joint_slides():
    text = ARM.replace('type="slide" axis="1 0 0"', 'type="slide" axis="1 0 0" frictionloss="0.4"')
    simulator = MujocoSimulator(text, frame_skip=5)
    model, state = simulator.compiled(), np.array([[0.3, 0.0, 0.0, 2.0], [0.3, 0.0, 0.0, -2.0]])
    data, accelerations = mujoco.MjData(model), np.empty((2, 2))
    for row in range(2):
        data.qpos[:], data.qvel[:] = np.split(state[row], 2)
        mujoco.mj_forward(model, data)
        accelerations[row] = data.qacc
    found = simulator.missing_forces(state, accelerations, np.zeros((1, 2, 2)), [{}])[0]
    np.testing.assert_allclose(found, 0, atol=1e-6)
    # Of a speed that is as uncertain as it is large, less of it acts for certain.
    unsure = simulator.missing_forces(state, accelerations, np.zeros((1, 2, 2)), [{}], slip=[0.0, 2.0])[0]
    np.testing.assert_allclose(np.abs(unsure[:, 1]), 0.4 * (1 - 0.6827), atol=8e-3)
    np.testing.assert_array_equal(np.sign(unsure[:, 1]), [-1, 1])


@pytest.mark.parametrize("per_axis", [2, 3])
def test_places_of_a_payload_are_a_grid_with_its_faces(arm, per_axis):
    places = arm.payload_places("upper", per_axis=per_axis)
    assert places.shape == (per_axis**3, 3)
    np.testing.assert_allclose(places.min(axis=0), [0, -0.02, -0.03], atol=1e-12)
    np.testing.assert_allclose(places.max(axis=0), [0.2, 0.02, 0.03], atol=1e-12)
    assert len(np.unique(places.round(12), axis=0)) == per_axis**3
    with pytest.raises(ValueError, match="no payload can be on 'tag'; bodies: upper, sled"):
        arm.payload_places("tag")


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.25, 1.3])
def test_between_whole_numbers_of_steps_a_transition_is_between_those(arm, factor):
    row = np.array([[0.3, 0.1, 1.0, -0.5, 0.5, 0.2]])

    def stepped(n_steps):
        model = mujoco.MjModel.from_xml_string(ARM)
        model.opt.timestep = 0.02 / n_steps
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = np.split(row[0], 3)
        for _ in range(n_steps):
            mujoco.mj_step(model, data)
        return np.r_[data.qpos, data.qvel]

    exact = 5 / factor
    low, share = int(np.floor(exact + 1e-12)), exact - np.floor(exact + 1e-12)
    expected = (1 - share) * stepped(low) + share * stepped(low + 1)
    np.testing.assert_allclose(arm.predict(row, effects={"timestep": factor})[0], expected, atol=1e-10)


def test_a_payload_acts_where_it_is_put(arm):
    at_end = arm.compiled({"payload[upper]": 0.5, "payload[upper.x]": 0.2})
    plain = arm.compiled()
    assert at_end.body("upper").mass[0] == pytest.approx(1.5)
    np.testing.assert_allclose(
        at_end.body("upper").ipos, (1.0 * 0.1 + 0.5 * 0.2) / 1.5 * np.array([1, 0, 0]), atol=1e-12
    )
    np.testing.assert_allclose(plain.body("upper").ipos, [0.1, 0, 0], atol=1e-12)
    matrices = []
    for model in (at_end, plain):
        data, matrix = mujoco.MjData(model), np.zeros((2, 2))
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, matrix)
        matrices.append(matrix[0, 0])
    assert matrices[0] - matrices[1] == pytest.approx(0.5 * 0.2**2, rel=1e-9)
