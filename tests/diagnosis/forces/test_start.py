"""Where a search begins: missing forces name what joints lack, at first sight, and nothing of a right model."""

import mujoco
import numpy as np
import pytest

from skat.diagnosis.forces.start import start_in_forces
from skat.simulators import FunctionSimulator, MujocoSimulator
from tests.diagnosis.forces.test_force_space import ARM, JOINTS, log_of

FRICTION, DAMPING = (0.12, 0.05), (0.08, 0.03)


@pytest.fixture(scope="module")
def simulator():
    return MujocoSimulator(ARM, frame_skip=5)


def started(simulator, log, **options):
    return start_in_forces(simulator, log, simulator.effects(), needed=-np.log(0.01), **options)


def test_all_that_the_joints_lack_is_found_at_once(simulator):
    start = started(simulator, log_of(0, friction=FRICTION, damping=DAMPING, noise=0.0005))
    for family, truth in (("dry_friction", FRICTION), ("damping", DAMPING)):
        for joint, value in zip(JOINTS, truth):
            assert start[f"{family}[{joint}]"] == pytest.approx(value, rel=0.3)


def test_of_members_that_differ_each_is_named_and_not_all(simulator):
    start = started(simulator, log_of(2, damping=(0.3, 0.03), noise=0.0005))
    assert "damping[all]" not in start
    assert {"damping[shoulder]", "damping[elbow]"} <= set(start)


def test_friction_of_a_light_wheel_is_told_beside_its_rotor():
    wheel = """
    <mujoco>
      <option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/>
      <worldbody>
        <body name="wheel">
          <joint name="axle" axis="0 1 0"/>
          <geom type="cylinder" size="0.01 0.01" mass="0.1"/>
        </body>
      </worldbody>
      <actuator><motor name="axle" joint="axle"/></actuator>
    </mujoco>"""
    truth = {"armature[axle]": 0.02, "dry_friction[axle]": 0.3, "damping[axle]": 0.1}
    real, rng = mujoco.MjModel.from_xml_string(wheel), np.random.default_rng(0)
    real.dof_armature[0], real.dof_frictionloss[0], real.dof_damping[0] = truth.values()
    data, states = mujoco.MjData(real), []
    mujoco.mj_setConst(real, data)
    commands = np.sin(0.03 * np.arange(1201)) + 0.5 * np.sin(0.11 * np.arange(1201) + 1)
    for command in commands:
        states.append(np.r_[data.qpos, data.qvel])
        data.ctrl[:] = command
        mujoco.mj_step(real, data, 5)
    states = np.array(states) + 0.0005 * rng.normal(size=(1201, 2)) * [1, 10]
    X = np.column_stack([states[:-1], commands[:-1]])
    start = started(MujocoSimulator(wheel, frame_skip=5), (X, states[1:], np.zeros(1200, dtype=int)))
    assert start == pytest.approx(truth, rel=0.3)


def servos(kp, forces="-1 1"):
    """Return the arm with servos of so much stiffness (N m/rad) and a velocity gain of .1 N m s/rad."""
    motors = '<motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/>'
    return ARM.replace(
        motors,
        "".join(
            f'<position name="{joint}" joint="{joint}" kp="{kp}" kv=".1" forcerange="{forces}"/>'
            for joint in JOINTS
        ),
    )


def servo_log(kp, rows=1200):
    """Return (X, y, groups) of such an arm with dry friction, rows of 10 ms."""
    model, rng = mujoco.MjModel.from_xml_string(servos(kp)), np.random.default_rng(0)
    model.dof_frictionloss[:] = FRICTION
    data, states = mujoco.MjData(model), []
    commands = 0.6 * np.sin(0.03 * np.arange(rows + 1)[:, None] * [1.0, 1.7] + [0.0, 1.0])
    for command in commands:
        states.append(np.r_[data.qpos, data.qvel])
        data.ctrl[:] = command
        mujoco.mj_step(model, data, 5)
    states = np.array(states) + 0.0005 * rng.normal(size=(rows + 1, 4)) * [1, 1, 10, 10]
    return np.column_stack([states[:-1], commands[:-1]]), states[1:], np.zeros(rows, dtype=int)


def test_servos_fifty_times_too_stiff_begin_where_they_are_not_at_their_limits():
    start = started(MujocoSimulator(servos(200.0), frame_skip=5), servo_log(4.0))
    assert start["kp[shoulder]"] * 200 == pytest.approx(4.0, rel=0.25)
    assert start["kp[elbow]"] * 200 == pytest.approx(4.0, rel=0.25)
    assert "kp[all]" not in start
    assert start["dry_friction[shoulder]"] == pytest.approx(FRICTION[0], rel=0.5)


def test_servos_that_are_never_at_their_limits_begin_where_the_model_has_them():
    start = started(MujocoSimulator(servos(4.4, "-9 9"), frame_skip=5), servo_log(4.0))
    assert start["kp[all]"] * 4.4 == pytest.approx(4.0, rel=0.05)
    assert start["dry_friction[shoulder]"] == pytest.approx(FRICTION[0], rel=0.3)


def test_a_typical_size_of_a_user_s_own_holds_a_value(simulator):
    log = log_of(3, damping=(0.1, 0.0), noise=0.0005)
    assert "damping[shoulder]" in started(simulator, log)
    held = started(simulator, log, typical={"damping[shoulder]": 1e-6, "damping[all]": 1e-6})
    assert held.get("damping[shoulder]", 0.0) < 0.05


def test_where_no_force_can_be_told_there_is_no_start(simulator):
    X, y, groups = log_of(4, friction=FRICTION)
    assert started(simulator, (X, y, np.arange(len(X)) // 5)) == {}
    unread = X.copy()
    unread[:, 0] = np.nan
    later = y.copy()
    later[:, 0] = np.nan
    assert started(simulator, (unread, later, groups)) == {}
    function = FunctionSimulator(
        lambda X: X[:, :4],
        input_names=(*simulator.state_names, "a", "b"),
        output_names=simulator.state_names,
        state_names=simulator.state_names,
        dt=0.01,
    )
    assert start_in_forces(function, (X, y, groups), function.effects(), needed=4.6) == {}
