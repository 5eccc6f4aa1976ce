"""What has a memory: delays, lags, activations, play. Against plain MuJoCo and integrations of their own."""

import math
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from skat.effects import Effect
from skat.simulators import FunctionSimulator, MujocoSimulator
from tests.machines import SERVO_ARM, changed, without_limits

N_STEPS, SKIP = 40, 5
# One hinge of 0.02 kg m2 with a rotor of 0.03 kg m2, without gravity: all of it can be integrated by hand.
LINK = """
<mujoco><compiler angle="radian"/><option timestep="0.0005" gravity="0 0 0" integrator="implicitfast"/>
<worldbody><body name="link"><joint name="hinge" axis="0 1 0" armature="0.03"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.02 0.01"/></body></worldbody>
<actuator>{}</actuator></mujoco>
"""
MOTOR, SERVO = '<motor name="m" joint="hinge"/>', '<position name="m" joint="hinge" kp="4" kv=".3"/>'


def commands(n_steps=N_STEPS, n_controls=2, seed=0):
    """Return steps of commands, each of which holds for four rows."""
    steps = np.random.default_rng(seed).uniform(-1, 1, size=(n_steps // 4 + 1, n_controls))
    return np.repeat(steps, 4, axis=0)[:n_steps]


def stepped(text, controls, *, n_substeps=SKIP, state=None, late=None):
    """Return states (n_steps + 1, n) of plain MuJoCo from rest, its filters in steady state at the first command."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    if state is not None:
        data.qpos[:], data.qvel[:] = np.split(state, [model.nq])
    if model.na:
        data.act[:] = controls[0]
    states = [np.r_[data.qpos, data.qvel]]
    for row in range(len(controls)):
        for substep in range(n_substeps):
            moment = row * n_substeps + substep
            data.ctrl[:] = controls[row] if late is None else late(moment)
            mujoco.mj_step(model, data)
        states.append(np.r_[data.qpos, data.qvel])
    return np.array(states)


def rows_of(states, controls):
    return np.concatenate([states[:-1], controls], axis=1)


def test_lag_of_a_command_is_written_as_mujocos_own_filter(tmp_path):
    controls = commands()
    simulator = MujocoSimulator(SERVO_ARM, frame_skip=SKIP)
    lagging = simulator.extended({"lag[lift]": 0.03, "lag[all]": 0.01})
    (path,) = lagging.to_mjcf(tmp_path / "lagging.xml")
    assert 'dyntype="filterexact"' in path.read_text()
    plain = stepped(path.read_text(), controls)
    found = lagging.predict(rows_of(plain, controls))
    # MuJoCo's filter acts as it is at the end of a step, and is as late in the mean: nearly the same.
    without = simulator.predict(rows_of(plain, controls))
    assert np.std(found - plain[1:]) < 0.3 * np.std(without - plain[1:])
    assert lagging.hidden_state_names == ()


def test_lag_is_the_law_of_a_filter_of_first_order():
    lag, torque = 0.02, 0.5
    simulator = MujocoSimulator(LINK.format(MOTOR), frame_skip=4)
    controls = np.r_[np.zeros(5), np.full(45, torque)][None, :, None]
    states = simulator.rollout(np.zeros((1, 2)), controls, n_steps=50, effects={"lag[m]": lag})[0]
    time = 0.002 * np.arange(46)
    speed = torque / 0.05 * (time - lag * (1 - np.exp(-time / lag)))
    np.testing.assert_allclose(states[5:, 1], speed, atol=1e-9)


@pytest.mark.parametrize(
    "name", ["lag[m]", "lag_torque[m]", "lag[qpos.hinge]", "delay[m]", "dead_zone[m]", "torque_speed[m]"]
)
def test_what_has_a_memory_vanishes_continuously(name):
    simulator = MujocoSimulator(LINK.format(SERVO), frame_skip=4)
    controls = commands(20, 1)[None]
    plain = simulator.rollout(np.zeros((1, 2)), controls, n_steps=20)
    sizes = [
        np.abs(simulator.rollout(np.zeros((1, 2)), controls, n_steps=20, effects={name: value}) - plain).max()
        for value in (1e-4, 1e-5)
    ]
    assert sizes[1] < 0.15 * sizes[0] + 1e-5 < 1e-2


def test_lag_of_a_torque_is_the_law_of_a_servo_whose_torque_is_late():
    lag, kp, kv, inertia, goal = 0.03, 4.0, 0.3, 0.05, 0.4
    simulator = MujocoSimulator(LINK.format(SERVO), frame_skip=4)
    controls = np.full((1, 100, 1), goal)

    def law(_, state):
        place, speed, torque = state
        return [speed, torque / inertia, (kp * (goal - place) - kv * speed - torque) / lag]

    start = np.array([0.1, -0.5])
    torque = kp * (goal - start[0]) - kv * start[1]
    times = 0.002 * np.arange(101)
    truth = solve_ivp(law, (0, times[-1]), [*start, torque], t_eval=times, rtol=1e-10, atol=1e-12).y[:2].T
    found = simulator.rollout(start[None], controls, n_steps=100, effects={"lag_torque[m]": lag})[0]
    np.testing.assert_allclose(found, truth, atol=6e-3 * np.abs(truth).max(axis=0).max())
    late = simulator.extended({"lag_torque[m]": lag})
    assert late.hidden_state_names == ("torque.m",)
    np.testing.assert_allclose(late.predict(rows_of(found, controls[0])), found[1:], atol=1e-10)


def test_delay_of_one_actuator_leaves_the_others(tmp_path):
    controls = commands()
    simulator = MujocoSimulator(SERVO_ARM, frame_skip=SKIP).extended({"delay[lift]": 0.028})
    (path,) = simulator.to_mjcf(tmp_path / "late.xml")

    def late(moment):
        return [controls[max(moment - 7, 0) // SKIP][0], controls[moment // SKIP][1]]

    plain = stepped(SERVO_ARM, controls, late=late)
    found = simulator.rollout(np.zeros((1, 4)), controls[None], n_steps=N_STEPS)[0]
    np.testing.assert_allclose(found, plain, atol=1e-7)
    assert path.read_text().count("delay=") == 1


@pytest.mark.parametrize("interp", ["zoh", "linear"])
@pytest.mark.parametrize("delay", [0.008, 0.0101])
def test_native_delays_are_mujocos(delay, interp):
    text = changed(SERVO_ARM, ('name="lift"', f'name="lift" delay="{delay}" nsample="8" interp="{interp}"'))
    controls = commands()
    controls[:4] = 0  # before the first row MuJoCo has commands of zero, the simulator the first one
    simulator = MujocoSimulator(text, frame_skip=SKIP)
    found = simulator.rollout(np.zeros((1, 4)), controls[None], n_steps=N_STEPS)[0]
    np.testing.assert_allclose(found, stepped(text, controls), atol=1e-7)
    more = simulator.rollout(
        np.zeros((1, 4)), controls[None], n_steps=N_STEPS, effects={"delay[lift]": 0.02}
    )[0]
    assert np.abs(more - found).max() > 1e-3


@pytest.mark.parametrize("extra", [0.003, 0.0041, 0.008])
def test_a_delay_on_top_of_one_that_holds_is_linear_between_time_steps(tmp_path, extra):
    text = changed(SERVO_ARM, ('name="lift"', 'name="lift" delay="0.0101" nsample="8"'))
    simulator = MujocoSimulator(text, frame_skip=SKIP)
    controls = commands()
    controls[:4] = 0
    moments = 0.004 * np.arange(N_STEPS * SKIP)
    lift = np.interp(
        moments - 0.012 - extra, moments, np.repeat(controls[:, 0], SKIP)
    )  # the model's, in whole steps

    def late(moment):
        return [lift[moment], controls[moment // SKIP][1]]

    loose = simulator.extended({"delay[lift]": extra})
    found = loose.rollout(np.zeros((1, 4)), controls[None], n_steps=N_STEPS)[0]
    np.testing.assert_allclose(found, stepped(SERVO_ARM, controls, late=late), atol=1e-7)
    path, *beside = loose.to_mjcf(tmp_path / "late.xml")
    near = loose.predict(rows_of(found, controls), effects={"timestep": 1 + 1e-9})
    np.testing.assert_allclose(near, found[1:], atol=1e-5)
    assert bool(beside) == (extra != 0.008)
    if not beside:
        np.testing.assert_allclose(stepped(path.read_text(), controls), found, atol=1e-7)


@pytest.mark.parametrize(
    ("interp", "integrator", "message"),
    [
        ("zoh", "RK4", "which the integrator RK4 reads between time steps"),
        ("cubic", "Euler", 'with interp="cubic"'),
    ],
)
def test_native_delays_that_are_not_simulated_as_mujoco_does_are_refused(interp, integrator, message):
    text = """<mujoco><option integrator="{}"/><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>
    <actuator><motor name="drive" joint="j" {}/></actuator></mujoco>"""
    with pytest.raises(ValueError, match=f"actuator 'drive' has a delay,? {message}"):
        MujocoSimulator(text.format(integrator, f'delay=".01" nsample="8" interp="{interp}"'))
    MujocoSimulator(text.format(integrator, 'nsample="8"'))


@pytest.mark.parametrize(
    "actuator",
    [
        '<position name="a" joint="shoulder" kp="40" kv="2" timeconst=".05"/>',
        '<general name="a" joint="shoulder" dyntype="filter" dynprm=".04" gainprm="3"/>',
        '<muscle name="a" joint="shoulder" lengthrange="-1 1" force="20" ctrlrange="0 1"/>',
        '<intvelocity name="a" joint="shoulder" kp="30" actrange="-1 1"/>',
        '<dcmotor name="a" joint="shoulder" motorconst="1" resistance="2" inductance=".05"/>',
        '<dcmotor name="a" joint="shoulder" motorconst="1" resistance="2"/>',
        '<pid name="a" joint="shoulder" kp="30" ki="20" input="pos"/>',
    ],
    ids=["timeconst", "filter", "muscle", "intvelocity", "inductance", "dcmotor", "pid"],
)
def test_activations_are_carried_from_row_to_row(actuator):
    text = SERVO_ARM.partition("<actuator>")[0] + f"<actuator>{actuator}</actuator></mujoco>"
    simulator = MujocoSimulator(text, frame_skip=SKIP)
    model = mujoco.MjModel.from_xml_string(text)
    controls = np.abs(commands(n_controls=1)) / 2
    data = mujoco.MjData(model)
    filters = ("timeconst", "filter", "muscle")
    data.act[:] = controls[0] if any(kind in actuator for kind in filters) else 0
    truth = [np.zeros(4)]
    for control in controls:
        data.ctrl[:] = control
        mujoco.mj_step(model, data, nstep=SKIP)
        truth.append(np.r_[data.qpos, data.qvel])
    truth = np.array(truth)
    assert simulator.hidden_state_names == ("act.a",) * model.na
    np.testing.assert_allclose(simulator.predict(rows_of(truth, controls)), truth[1:], atol=1e-7)
    opened = simulator.rollout(np.zeros((1, 4)), controls[None], n_steps=N_STEPS)[0]
    np.testing.assert_allclose(opened, truth, atol=1e-7)


def test_copies_of_an_episode_do_not_share_a_memory():
    simulator = MujocoSimulator(LINK.format(SERVO), frame_skip=4)
    values = {"lag_torque[m]": 0.02, "lag[m]": 0.01, "backlash[hinge]": 0.02, "lag[qpos.hinge]": 0.004}
    controls = commands(30, 1)
    rows = rows_of(
        simulator.rollout(np.zeros((1, 2)), controls[None], n_steps=30, effects=values)[0], controls
    )
    moved = simulator.displace(rows, [1e-3, 0.0])
    both = np.concatenate([rows[:20], rows[20:], moved[:20], moved[20:]])
    groups = np.repeat([0, 1, 2, 3], [20, 10, 20, 10])
    together = simulator.predict_many(both, [{}, values, {"mass[link]": 2.0} | values], groups=groups)
    for start, end in pairwise([0, 20, 30, 50, 60]):
        alone = simulator.predict_many(both[start:end], [{}, values, {"mass[link]": 2.0} | values])
        np.testing.assert_array_equal(together[:, start:end], alone)


def test_a_sensors_lag_is_the_law_of_a_filter_and_rows_know_how_far_it_is_behind():
    lag = 0.01
    simulator = MujocoSimulator(LINK.format(SERVO), frame_skip=4)
    controls = np.full((200, 1), 0.5)
    true = simulator.rollout(np.zeros((1, 2)), controls[None], n_steps=200)[0]
    times, read = 0.002 * np.arange(201), [0.0]
    for index in range(200):  # of a place that changes linearly within each row
        start, slope = true[index, 0], (true[index + 1, 0] - true[index, 0]) / 0.002
        left = math.exp(-0.002 / lag)
        read.append(true[index + 1, 0] - lag * slope + (read[-1] - start + lag * slope) * left)
    seen = np.column_stack([read, true[:, 1]])
    values = {"lag[qpos.hinge]": lag}
    found = simulator.predict(rows_of(seen, controls), effects=values)
    np.testing.assert_allclose(found, seen[1:], atol=1e-4)
    assert np.abs(simulator.predict(rows_of(seen, controls)) - seen[1:]).max() > 20 * 1e-4
    assert simulator.extended(values).hidden_state_names == ("ahead.qpos.hinge",)
    assert times[-1] > 20 * lag


@pytest.mark.parametrize("channel", ["qpos.hinge", "qvel.hinge"])
@pytest.mark.parametrize("timestep", [1.0, 0.8])
def test_a_sensors_filter_follows_what_moves_within_a_row(channel, timestep):
    """A stiff servo has gone most of its way before a row ends: against SciPy's filter of plain MuJoCo's time steps."""
    lag, n_substeps = 0.015, 40
    text = LINK.format('<position name="m" joint="hinge" kp="800" kv="8"/>')
    simulator = MujocoSimulator(text, frame_skip=n_substeps)
    controls = commands(60, 1)
    h = 0.0005 * timestep
    fine = stepped(
        text.replace('timestep="0.0005"', f'timestep="{h}"'),
        np.repeat(controls, round(n_substeps / timestep), axis=0),
        n_substeps=1,
        state=np.r_[controls[0], 0.0],
    )
    column = ["qpos.hinge", "qvel.hinge"].index(channel)
    times = h * np.arange(len(fine))
    _, shown, _ = lsim(([1.0], [lag, 1.0]), fine[:, column], times, X0=lag * fine[0, column])
    every = slice(None, None, round(n_substeps / timestep))
    true = fine[every].copy()
    read = true.copy()
    read[:, column] = shown[every]
    values = {f"lag[{channel}]": lag, "timestep": timestep}
    found = simulator.predict(rows_of(read, controls), effects=values)
    np.testing.assert_allclose(found, read[1:], atol=2e-3 * np.ptp(true[:, column]))
    rolled = simulator.rollout(true[:1], controls[None], n_steps=60, effects=values)[0]
    np.testing.assert_allclose(rolled[:, column], read[:, column], atol=2e-3 * np.ptp(true[:, column]))


@pytest.mark.parametrize("also", [{}, {"stribeck[hinge]": 0.1}])
def test_a_candidate_begins_steady_whatever_other_candidates_run_beside_it(also):
    """Where an integrating servo begins follows from its own model: without gain it is at no place."""
    other = also | {"gain[m]": 0.0}
    simulator = MujocoSimulator(
        LINK.format('<intvelocity name="m" joint="hinge" kp="4" kv=".3" actrange="-2 2"/>')
    )
    rows = np.array([[0.8, 0.0, 0.1], [-0.5, 0.2, 0.0]])
    alone = simulator.predict_many(rows, [also])[0]
    np.testing.assert_array_equal(simulator.predict_many(rows, [other, also])[1], alone)
    np.testing.assert_array_equal(simulator.predict_many(rows, [also, other])[0], alone)


def test_a_filter_sees_commands_within_their_range():
    limited = MOTOR.replace("/>", ' ctrllimited="true" ctrlrange="-1 1"/>')
    simulator = MujocoSimulator(LINK.format(limited), frame_skip=4)
    controls = 3 * commands(n_controls=1)[None]
    values = {"scale[ctrl.m]": 2.0, "bias[ctrl.m]": 0.1, "lag[m]": 0.02}
    beyond = simulator.rollout(np.zeros((1, 2)), controls, n_steps=N_STEPS, effects=values)
    within = np.clip(2 * controls + 0.1, -1, 1)
    expected = simulator.rollout(np.zeros((1, 2)), within, n_steps=N_STEPS, effects={"lag[m]": 0.02})
    np.testing.assert_allclose(beyond, expected, atol=1e-12)


def test_late_commands_beyond_their_range_are_plain_mujocos(tmp_path):
    limited = MOTOR.replace("/>", ' ctrllimited="true" ctrlrange="-1 1"/>')
    simulator = MujocoSimulator(LINK.format(limited), frame_skip=SKIP).extended({"delay[m]": 0.00333})
    controls = 3 * commands(n_controls=1)
    controls[:4] = 0  # which plain MuJoCo takes to have been before
    found = simulator.rollout(np.zeros((1, 2)), controls[None], n_steps=N_STEPS)[0]
    (path,) = simulator.to_mjcf(tmp_path / "late.xml")
    np.testing.assert_allclose(stepped(path.read_text(), controls), found, atol=1e-9)


def test_a_dead_zone_takes_from_a_command_within_its_range():
    limited = MOTOR.replace("/>", ' ctrllimited="true" ctrlrange="-1 1"/>')
    simulator = MujocoSimulator(LINK.format(limited))
    rows = np.array([[0.0, 0.0, 4.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.5]])
    far, end, plain = simulator.predict(rows, effects={"dead_zone[m]": 0.5})[:, 1]
    assert far == end == pytest.approx(simulator.predict(rows)[2, 1], rel=1e-12)
    assert plain == 0


def test_a_link_with_play_is_left_to_itself_until_its_motor_has_crossed_the_gap():
    width, push = 0.03, 0.2
    simulator = MujocoSimulator(LINK.format(MOTOR), frame_skip=4)
    controls = np.r_[np.full(100, push), np.full(200, -push)]
    times = 0.002 * np.arange(301)
    found = simulator.rollout(
        np.zeros((1, 2)), controls[None, :, None], n_steps=300, effects={"backlash[hinge]": width}
    )[0]
    speed = push / 0.05 * 0.2
    # Pushed as one; then free until the motor has lost the play; then a blow without rebound, and as one again.
    crossing = math.sqrt(2 * width * 0.03 / push)
    free = (times > 0.204) & (times < 0.2 + crossing - 0.004)
    np.testing.assert_allclose(found[times <= 0.2, 1], push / 0.05 * times[times <= 0.2], atol=4e-3 * speed)
    np.testing.assert_allclose(found[free, 1], speed, atol=4e-3 * speed)
    blow = push * crossing / 0.05  # what the motor's momentum changed by meanwhile, shared by both
    later = times > 0.2 + crossing + 0.04  # the flanks of MuJoCo are soft
    expected = speed - blow - push / 0.05 * (times - 0.2 - crossing)
    np.testing.assert_allclose(found[later, 1], expected[later], atol=0.02 * speed)


@pytest.mark.parametrize("speed", [-1.0, 1.0])
def test_a_log_begins_at_the_flank_that_carries_the_link_whichever_way_its_motor_pushes(speed):
    """Of what a motor does against its own damping nothing goes through the gear: it is gravity that presses."""
    text = """
    <mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body>
    <joint name="hinge" axis="0 1 0" damping="4" armature="0.05"/>
    <geom type="sphere" size="0.02" pos="0.2 0 0" mass="1"/></body></worldbody>
    <actuator><position name="m" joint="hinge" kp="60"/></actuator></mujoco>
    """
    simulator = MujocoSimulator(text, frame_skip=5).extended({"backlash[hinge]": 0.02})
    controls = -speed + speed * 0.01 * np.arange(200)[:, None]
    whole = simulator.rollout([[-speed, 0.0]], controls[None], n_steps=200)[0]
    rows = rows_of(whole[120:], controls[120:])
    # How far it has pressed into a flank that is soft is not known.
    np.testing.assert_allclose(simulator.predict(rows), whole[121:], atol=0.01)


def test_play_is_carried_along_a_log_and_written_as_a_joint(tmp_path):
    simulator = MujocoSimulator(without_limits(SERVO_ARM), frame_skip=SKIP).extended(
        {"backlash[elbow]": 0.02}
    )
    controls = commands()
    found = simulator.rollout(np.zeros((1, 4)), controls[None], n_steps=N_STEPS)[0]
    assert simulator.hidden_state_names == ("play.elbow", "play_rate.elbow")
    np.testing.assert_allclose(simulator.predict(rows_of(found, controls)), found[1:], atol=1e-9)
    (path,) = simulator.to_mjcf(tmp_path / "loose.xml")
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.nq == 3
    assert "time step times the damping" in path.read_text()
    assert model.joint("elbow.play").range[1] == pytest.approx(0.01)
    far = []
    for flank in (-0.01, 0.01):
        plain = stepped(path.read_text(), controls, state=np.array([0, -flank, flank, 0, 0, 0]))
        plain[:, [1, 4]] += plain[:, [2, 5]]
        far.append(np.abs(plain[:, [0, 1, 3, 4]] - found).max())
    assert min(far) < 1e-7
    assert max(far) > 1e-3


@pytest.mark.parametrize(
    ("integrator", "damping", "feedback"),
    [("implicitfast", 0, 40), ("implicitfast", 40, 0), ("Euler", 40, 0)],
)
def test_a_small_rotor_with_a_strong_damper_is_stopped_by_the_flanks(integrator, damping, feedback):
    """A time step times its damping is eight times the rotor, which an implicit integrator hides from constraints."""
    text = """
    <mujoco><compiler angle="radian"/><option timestep="{}" integrator="{}"/><worldbody><body name="motor">
    <inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>
    <joint name="hinge" axis="0 0 1" armature="0.01" damping="{}"/>
    {}<geom type="box" size="0.1 0.02 0.02" pos="0.1 0 0" mass="1"/></body>{}</worldbody>
    <actuator><position name="m" joint="hinge" kp="400" kv="{}"/></actuator></mujoco>
    """
    link = """<body><joint name="play" axis="0 0 1" limited="true" range="-0.01 0.01" solreflimit="1e-4 1"
    solimplimit="0.95 0.99 1e-4"/>"""
    times = 0.01 * np.arange(300)
    controls = 0.1 * np.sin(3 * np.pi * times)[:, None]
    fine = stepped(
        text.format(5e-5, integrator, damping, link, "</body>", feedback), controls, n_substeps=200
    )
    simulator = MujocoSimulator(text.format(0.002, integrator, damping, "", "", feedback), frame_skip=5)
    rigid, loose = (
        simulator.rollout(np.zeros((1, 2)), controls[None], n_steps=300, effects=effects)[0, :, 0]
        for effects in ({}, {"backlash[hinge]": 0.02})
    )
    truth = fine[:, 0] + fine[:, 1]
    assert np.std(loose - truth) < 0.1 * np.std(rigid - truth)


@pytest.mark.parametrize(
    "limits", ['forcerange="-1 1"/>', '/><motor joint="hinge" ctrllimited="true" ctrlrange="0 1"/>']
)
def test_play_of_nothing_is_no_play_where_a_servo_is_at_its_limit(limits):
    """An integrator that is implicit drops the damping of a servo that is at a limit of its force, or its joint's."""
    joint = "" if "forcerange" in limits else 'actuatorfrcrange="-1 1"'
    text = f"""
    <mujoco><compiler angle="radian"/><option timestep="0.005" gravity="0 0 0" integrator="implicitfast"/><worldbody>
    <body><joint name="hinge" axis="0 1 0" armature="0.03" {joint}/><geom size="0.02" pos="0.2 0 0" mass="0.2"/></body>
    </worldbody><actuator><position name="m" joint="hinge" kp="20" kv="4" {limits}</actuator></mujoco>
    """
    simulator = MujocoSimulator(text, frame_skip=4)
    places = 0.8 * np.sign(np.sin(0.06 * np.pi * np.arange(100)))[:, None]
    controls = np.pad(places, ((0, 0), (0, simulator._nominal.nu - 1)))
    rigid, loose = (
        simulator.rollout(np.zeros((1, 2)), controls[None], n_steps=100, effects=effects)[0, :, 0]
        for effects in ({}, {"backlash[hinge]": 1e-7})
    )
    np.testing.assert_allclose(loose, rigid, atol=0.01 * np.ptp(rigid))  # flanks are soft


def test_a_function_gets_delays_and_lags_of_its_inputs():
    def integrator(X, **_):
        return X[:, :1] + 0.1 * X[:, 1:]

    names = {"input_names": ("x", "u"), "output_names": ("x",), "state_names": ("x",), "dt": 0.1}
    simulator = FunctionSimulator(
        integrator, **names, effects=(Effect("a", unit="1", neutral=1.0, bounds=(0, 2)),)
    )
    offered = {effect.name for effect in simulator.effects(also="all")} - {
        effect.name for effect in simulator.effects()
    }
    assert offered == {"delay[action]", "delay[u]", "lag[u]", "lag[x]"}
    u = np.r_[np.zeros(3), np.ones(20)][None, :, None]
    late = simulator.rollout([[0.0]], u, n_steps=23, effects={"delay[u]": 0.15})[0, :, 0]
    time = 0.1 * np.arange(24) - 0.3
    np.testing.assert_allclose(
        late[np.abs(time - 0.15) > 0.06], np.maximum(time - 0.15, 0)[np.abs(time - 0.15) > 0.06], atol=1e-9
    )
    slow = simulator.rollout([[0.0]], u, n_steps=23, effects={"lag[u]": 0.2})[0, :, 0]
    after = np.maximum(time, 0)
    np.testing.assert_allclose(slow, after - 0.2 * (1 - np.exp(-after / 0.2)), atol=3e-3)


def test_what_few_machines_have_is_listed_when_asked_for():
    simulator = MujocoSimulator(SERVO_ARM)
    plain = {effect.family for effect in simulator.effects()}
    every = {effect.family for effect in simulator.effects(also="all")}
    assert {
        "lag",
        "lag_torque",
        "dead_zone",
        "backlash",
        "stribeck",
        "load_friction",
        "payload",
    } <= every - plain
    assert {effect.family for effect in simulator.effects(also=("backlash",))} - plain == {"backlash"}
    with pytest.raises(ValueError, match="out of bounds"):
        simulator.predict(np.zeros((1, 6)), effects={"backlash[elbow]": 1.0})


def test_a_reading_that_lags_lags_from_the_first_row_on():
    """What moves at a constant speed is ahead of its reading by the speed times the time constant, wherever it is."""
    simulator = FunctionSimulator(
        lambda X: X[:, :1] + 0.1 * X[:, 1:],
        **{"input_names": ("x", "u"), "output_names": ("x",), "state_names": ("x",), "dt": 0.1},
        effects=(),
    )
    rows = np.column_stack([5.0 + 0.2 * np.arange(4), np.full(4, 2.0)])
    lagging = simulator.extended({"lag[x]": 0.3})
    np.testing.assert_allclose(lagging.predict(rows)[:, 0], rows[:, 0] + 0.2, atol=1e-9)


@pytest.mark.parametrize(
    "effects", [{"lag_torque[lift]": 0.01}, {"backlash[elbow]": 0.02}, {"lag[qvel.elbow]": 0.02}]
)
def test_hidden_states_carried_in_pieces_are_those_carried_in_the_order_of_time(monkeypatch, effects):
    simulator, controls = MujocoSimulator(SERVO_ARM, frame_skip=SKIP), commands(120)
    X = rows_of(simulator.rollout(np.zeros((1, 4)), controls[None], n_steps=120)[0], controls)
    in_pieces = simulator.predict_many(X, [effects, {}], groups=np.zeros(120))
    monkeypatch.setattr("skat.simulators.base.PIECES", 1)
    np.testing.assert_allclose(
        simulator.predict_many(X, [effects, {}], groups=np.zeros(120)), in_pieces, atol=1e-8
    )
