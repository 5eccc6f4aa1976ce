"""The stepping of rows: what needs a substep of its own, steady states, and forces against plain MuJoCo."""

import os

import mujoco
import numpy as np
import pytest

from skat.simulators import MujocoSimulator, stepping
from skat.simulators.friction import NEUTRAL, budget, creep
from skat.simulators.stepping import (
    LIMITS,
    Forces,
    Job,
    Play,
    Rest,
    Stepper,
    _alike,
    _dense,
    _different,
    _forces_of,
    _rigid_parts,
    _sizes,
    _thread_count,
    steady_activations,
)

ARM = """
<mujoco><compiler angle="radian"/><option timestep="0.004" integrator="implicitfast">
<flag autoreset="disable"/></option><worldbody>
<body pos="0 0 1"><joint name="yaw" axis="0 0 1"/><geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.03"/>
<body pos="0.2 0 0"><joint name="lift" axis="0 1 0" damping="0.1" stiffness="0.3"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03"/>
<body pos="0.3 0 0"><joint name="slide" type="slide" axis="1 0 0"/><geom size="0.04"/></body></body></body></worldbody>
<actuator>
  <motor joint="yaw" gear="2"/><position joint="lift" kp="5" kv="0.1"/><motor joint="slide"/>
</actuator></mujoco>
"""
MODEL = mujoco.MjModel.from_xml_string(ARM)


def rows(n_rows=4, seed=0):
    return np.random.default_rng(seed).normal(size=(1, n_rows, 9)) * 0.5


def plain(model, row, n_substeps, force=None):
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = np.split(row, 3)
    for _ in range(n_substeps):
        if force is not None:
            mujoco.mj_forward(model, data)
            data.xfrc_applied[1, :3] = force(data)
        mujoco.mj_step(model, data)
    return np.r_[data.qpos, data.qvel]


def test_a_force_needs_its_substeps_only_where_it_changes():
    law = tuple(NEUTRAL.values())
    loaded = tuple((NEUTRAL | {"load_friction": 0.1}).values())
    cases = {
        (): Forces(body=1, wind=(1.0, 2.0, 3.0), joints=((0, 1.0),)),
        ("drag",): Forces(drag=(0.0, 0.0, 0.1)),
        ("drag", None): Forces(drag_all=0.1),
        ("friction",): Forces(friction=((0, 0, law),)),
        ("friction", "load"): Forces(friction=((0, 0, law), (1, 1, loaded))),
        ("dead_zones",): Forces(dead_zones=((0, 0.1),)),
        ("speed_slopes",): Forces(speed_slopes=((0, 0.1),)),
        ("torque_lags",): Forces(torque_lags=((0, 0.1),)),
    }
    for kinds, forces in cases.items():
        assert forces.kinds == {kind for kind in kinds if kind}
        assert forces.changes_within_transition == bool(kinds)
        assert forces.has_drag == ("drag" in kinds)


def test_a_job_hides_activations_torques_and_two_numbers_of_each_play():
    plays = (Play(0, 0, 3, 3, 0.1), Play(1, 1, 4, 4, 0.1))
    assert Job(0, MODEL, 1).n_hidden == 0
    assert Job(0, MODEL, 1, Forces(torque_lags=((0, 0.1), (2, 0.1))), plays=plays).n_hidden == 6


def test_jobs_run_together_where_substeps_controls_and_laws_are_alike():
    lagging = Forces(torque_lags=((0, 0.1),))
    jobs = [
        Job(0, MODEL, 1),
        Job(1, MODEL, 2),
        Job(2, MODEL, 1, Forces(wind=(1.0, 0.0, 0.0))),
        Job(3, MODEL, 1, controls=np.zeros((4, 1, 3))),
        Job(4, MODEL, 1, lagging),
        Job(5, MODEL, 1, Forces(torque_lags=((1, 0.1),))),
        Job(6, MODEL, 1, Forces(torque_lags=((0, 0.3),))),
        Job(7, MODEL, 1, Forces(drag_all=1.0)),
    ]
    assert _alike(jobs) == [[0, 2], [1], [3], [4, 6], [5], [7]]


def test_states_are_those_of_plain_mujoco_and_beyond_the_limit_none():
    inputs = rows()
    inputs[0, 2, 3] = 1e11
    with np.errstate(over="ignore", invalid="ignore"):
        states, hidden = Stepper().run([Job(0, MODEL, 3)], inputs)
    for index in (0, 1, 3):
        np.testing.assert_allclose(states[0, index], plain(MODEL, inputs[0, index], 3), atol=1e-12)
    assert np.isnan(states[0, 2]).all()
    assert hidden[0].shape == (4, 0)


@pytest.mark.parametrize("n_substeps", [1, 3])
def test_wind_and_drag_are_forces_at_the_bodys_centre(n_substeps):
    inputs, wind, drag = rows(), np.array([0.3, -0.2, 0.1]), np.array([2.0, 1.0, 0.5])
    forces = Forces(body=1, wind=tuple(wind), drag=tuple(drag), drag_all=0.7)

    def force(data):
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(MODEL, data, mujoco.mjtObj.mjOBJ_BODY, 1, velocity, 0)
        speed = velocity[3:]
        return wind - drag * np.abs(speed) * speed - 0.7 * np.linalg.norm(speed) * speed

    states, _ = Stepper().run([Job(0, MODEL, n_substeps, forces)], inputs)
    for index in range(4):
        np.testing.assert_allclose(
            states[0, index], plain(MODEL, inputs[0, index], n_substeps, force), rtol=1e-8, atol=1e-10
        )


def test_forces_on_joints_act_on_theirs_and_controls_change_from_substep_to_substep():
    inputs = rows()
    controls = np.random.default_rng(1).normal(size=(4, 3, 3))
    states, _ = Stepper().run(
        [Job(0, MODEL, 3, Forces(joints=((1, 0.4), (2, -0.3))), controls=controls)], inputs
    )
    for index in range(4):
        data = mujoco.MjData(MODEL)
        data.qpos[:], data.qvel[:], _ = np.split(inputs[0, index], 3)
        data.qfrc_applied[1:] = 0.4, -0.3
        for substep in range(3):
            data.ctrl[:] = controls[index, substep]
            mujoco.mj_step(MODEL, data)
        np.testing.assert_allclose(states[0, index], np.r_[data.qpos, data.qvel], atol=1e-12)


def test_missing_forces_are_those_of_inverse_dynamics():
    inputs, accelerations = rows(), np.random.default_rng(2).normal(size=(4, 3))
    found, friction = Stepper().missing_forces([Job(0, MODEL, 1)], inputs, accelerations)
    data = mujoco.MjData(MODEL)
    for index in range(4):
        data.qpos[:], data.qvel[:], data.ctrl[:] = np.split(inputs[0, index], 3)
        mujoco.mj_forward(MODEL, data)
        data.qacc[:] = accelerations[index]
        mujoco.mj_inverse(MODEL, data)
        np.testing.assert_allclose(found[0, index], data.qfrc_inverse - data.qfrc_actuator, atol=1e-10)
    np.testing.assert_array_equal(friction, 0)


def test_a_mass_matrix_times_accelerations_is_that_of_the_full_one():
    data = mujoco.MjData(MODEL)
    data.qpos[:] = 0.3, -0.8, 0.1
    mujoco.mj_forward(MODEL, data)
    full, accelerations = np.zeros((3, 3)), np.random.default_rng(0).normal(size=(5, 3))
    mujoco.mj_fullM(MODEL, data, full)
    found = _dense(MODEL, np.tile(data.M, (5, 1)))
    np.testing.assert_allclose((found @ accelerations[..., None])[..., 0], accelerations @ full, rtol=1e-12)


def test_rows_that_settle_stop_by_themselves_and_others_never_do():
    text = (
        '<mujoco><option timestep="0.01" gravity="0 0 0"><flag autoreset="disable"/></option><worldbody><body>'
        '<joint type="slide" damping="10"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    rest = Rest(lambda qpos, qvel: np.abs(qvel[:, 0]) < 1e-3, 20)
    inputs = np.array([[[0.0, 1.0], [0.0, 0.0], [2.0, -0.5], [0.0, 1e8]]])
    states, _ = Stepper().run([Job(0, model, 10)], inputs, rest=rest)
    # A free body that is braked in proportion to its speed goes as far as speed * mass / damping, implicitly stepped.
    way = inputs[0, :3, 0] + inputs[0, :3, 1] / 10
    np.testing.assert_allclose(states[0, :3, 0], way, atol=2e-4)
    np.testing.assert_array_equal(states[0, 1], [0, 0])
    assert np.isnan(states[0, 3]).all()


ACTUATORS = """
<motor joint="yaw"/>
<general joint="lift" dyntype="filter" dynprm="0.1" ctrlrange="-1 2" ctrllimited="true"/>
<general joint="slide" dyntype="filterexact" dynprm="0.1" actrange="-0.5 0.5" actlimited="true"/>
<intvelocity joint="lift" kp="5" gear="3" actrange="-9 9"/>
<muscle joint="lift" lengthrange="0.1 1"/>
<general joint="yaw" dyntype="integrator"/>
"""


def test_steady_activations_stay_where_their_controls_hold_them():
    text = ARM.replace(ARM[ARM.index("<actuator>") + 10 : ARM.index("</actuator>")], ACTUATORS)
    model = mujoco.MjModel.from_xml_string(text)
    controls = np.array([[1.0, 5.0, 0.3, 0.0, 0.4, 0.0], [1.0, -0.4, -2.0, 0.0, 3.0, 0.0]])
    qpos = np.array([[0.1, 0.2, 0.3], [0.4, -0.5, 0.6]])
    steady = steady_activations(model, controls, qpos)
    assert steady.shape == (2, 5)
    np.testing.assert_allclose(steady[:, 0], [2.0, -0.4])
    np.testing.assert_allclose(steady[:, 1], [0.3, -0.5])
    np.testing.assert_allclose(steady[:, 2], 3 * qpos[:, 1])  # where the joint is, as its gear has it
    np.testing.assert_allclose(steady[:, 3], [0.4, 1.0])
    np.testing.assert_allclose(steady[:, 4], 0.0)
    data = mujoco.MjData(model)
    for row in range(2):
        data.qpos[:], data.ctrl[:], data.act[:] = qpos[row], controls[row], steady[row]
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.act_dot[[0, 3]], 0, atol=1e-9)


def test_models_differ_in_the_fields_that_were_changed():
    text = ARM.replace('damping="0.1"', 'damping="0.2"').replace('timestep="0.004"', 'timestep="0.002"')
    other = mujoco.MjModel.from_xml_string(text)
    assert _different(MODEL, MODEL) == ()
    assert set(_different(MODEL, other)) == {"dof_damping", "opt.timestep"}
    assert _sizes(MODEL) == _sizes(other)
    assert _rigid_parts(MODEL) == _rigid_parts(other)


def test_a_process_of_its_own_uses_all_processors(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert _thread_count() >= (2 if len(os.sched_getaffinity(0)) > 1 else 1)


def test_a_worker_uses_its_share_of_the_processors(monkeypatch):
    monkeypatch.setattr("skat.simulators.stepping.multiprocessing.parent_process", lambda: object())
    monkeypatch.setattr("skat.simulators.stepping.joblib.cpu_count", lambda: 8)
    for share, expected in (("1", 1), ("3", 3), ("99", 8), ("0", 8), ("", 8), ("many", 8)):
        monkeypatch.setenv("OMP_NUM_THREADS", share)
        assert _thread_count() == expected


def test_sticking_is_gone_at_speed_and_grows_with_place_and_load():
    def friction(position=0.0, velocity=0.0, motor=0.0, external=0.0, **coefficients):
        law = np.array(list((NEUTRAL | coefficients).values()))
        return float(budget(law, *(np.array(one) for one in (position, velocity, motor, external))))

    assert friction(3.0, 2.0, 1.0, -1.0) == 0.0
    assert friction(-3.0, position_friction=0.2) == pytest.approx(0.6)
    assert friction(stribeck=0.5) == 0.5
    assert friction(velocity=-2.0, stribeck=0.5) == pytest.approx(0.5 * np.exp(-1))
    assert friction(velocity=4.0, stribeck=0.5, stribeck_exponent=1.0) == pytest.approx(0.5 * np.exp(-2))
    assert friction(motor=3.0, external=-2.0, load_friction=0.1) == pytest.approx(0.5)
    assert friction(motor=3.0, external=3.0, load_friction=0.1) == 0.0
    assert friction(motor=3.0, external=-2.0, load_square_motor=0.1) == pytest.approx(0.9)
    assert friction(motor=1.0, external=-2.0, load_square_external=0.1) == pytest.approx(0.4)
    assert friction(motor=3.0, external=2.0, load_square_motor=0.1) == 0.0


def test_dry_friction_creeps_as_mujocos_does():
    """Pushed by half of its friction, a joint ends up at the speed at which the soft constraint holds it."""
    text = (
        '<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body><joint type="slide" frictionloss="2"/>'
        '<inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/></body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = 1.0
    for _ in range(5000):
        mujoco.mj_step(model, data)
    softness, damping = creep(model)
    assert data.qvel[0] == pytest.approx(float(softness[0] * 1.0 / damping[0]), rel=1e-3)


# -- laws that are renewed in each substep -----------------------------------------------------------------------------


def renewed(change, row, n_substeps, text=ARM):
    """Step plain MuJoCo, with what `change(model, data, control)` makes of it at the start of each substep."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], control = np.split(row, 3)
    for _ in range(n_substeps):
        data.ctrl[:] = control
        mujoco.mj_forward(model, data)
        change(model, data, control)
        data.qacc_warmstart[:] = 0
        mujoco.mj_step(model, data)
    return np.r_[data.qpos, data.qvel]


@pytest.mark.parametrize("n_substeps", [1, 4])
def test_within_its_dead_zone_a_servo_lacks_nothing(n_substeps):
    inputs = rows(8)

    def narrowed(model, data, control):
        lacks = control[1] - data.actuator_length[1]
        data.ctrl[1] = control[1] - np.sign(lacks) * min(abs(lacks), 0.2)

    states, _ = Stepper().run([Job(0, MODEL, n_substeps, Forces(dead_zones=((1, 0.2),)))], inputs)
    for index in range(8):
        expected = renewed(narrowed, inputs[0, index], n_substeps)
        np.testing.assert_allclose(states[0, index], expected, atol=1e-12)


@pytest.mark.parametrize("n_substeps", [1, 4])
def test_a_motor_loses_force_with_speed_and_gains_none(n_substeps):
    text = ARM.replace(
        '<motor joint="yaw" gear="2"/>',
        '<motor joint="yaw" gear="2" forcerange="-1 0.5" forcelimited="true"/>',
    )
    model, inputs = mujoco.MjModel.from_xml_string(text), rows(8) * 4

    def tired(model, data, control):
        lost = 0.3 * data.actuator_velocity[0]
        model.actuator_forcerange[0] = np.clip([-1 - lost, 0.5 - lost], -1, 0.5)

    states, _ = Stepper().run([Job(0, model, n_substeps, Forces(speed_slopes=((0, 0.3),)))], inputs)
    for index in range(8):
        expected = renewed(tired, inputs[0, index], n_substeps, text)
        np.testing.assert_allclose(states[0, index], expected, atol=1e-12)


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_a_late_torque_follows_what_speed_leaves_of_the_one_that_is_wanted(slope):
    """Of a filter of first order, whose input is constant within a substep, the mean acts."""
    motor = '<general joint="yaw" gear="2" biastype="affine" forcerange="-1 0.5" forcelimited="true"/>'
    text = ARM.replace('<motor joint="yaw" gear="2"/>', motor)
    model, inputs, hidden = mujoco.MjModel.from_xml_string(text), rows(8) * 4, np.full((8, 1), np.nan)
    hidden[::2, 0] = np.linspace(-1.5, 1.5, 4)
    lags = (0.003, 0.02)
    laws = [Forces(torque_lags=((0, lag),), speed_slopes=((0, slope),) if slope else ()) for lag in lags]
    jobs = [Job(0, model, 4, forces, hidden=hidden) for forces in laws]
    states, after = Stepper().run(jobs, inputs)
    for place, lag in enumerate(lags):
        for index, row in enumerate(inputs[0]):
            torque = hidden[index, 0]

            def late(_, data, control, lag=lag):
                nonlocal torque
                lost = slope * data.actuator_velocity[0]
                low, high = np.clip([-1 - lost, 0.5 - lost], -1, 0.5)
                wanted = np.clip(control[0], low, high)
                torque = wanted if np.isnan(torque) else torque
                way = 1 - np.exp(-0.004 / lag)
                data.ctrl[0] = np.clip(wanted + (torque - wanted) * way * lag / 0.004, low, high)
                torque += way * (wanted - torque)

            expected = renewed(late, row, 4)
            np.testing.assert_allclose(states[place, index], expected, atol=1e-11)
            assert after[place][index, 0] == pytest.approx(torque, abs=1e-12)


def test_a_gears_friction_is_that_of_its_load():
    """The motor's torque against that of gravity and springs."""
    inputs = rows(8)
    law = tuple(
        (NEUTRAL | {"load_friction_motor": 0.1, "load_friction_external": 0.3, "stribeck": 0.05}).values()
    )

    def braked(model, data, control):
        motor, external = data.qfrc_actuator[1], data.qfrc_spring[1] - data.qfrc_bias[1]
        slow = np.exp(-((data.qvel[1] / 2.0) ** 2))
        model.dof_frictionloss[1] = 0.05 * slow + abs(0.3 * external - 0.1 * motor)

    states, _ = Stepper().run([Job(0, MODEL, 1, Forces(friction=((1, 1, law),)))], inputs)
    for index in range(8):
        np.testing.assert_allclose(
            states[0, index], renewed(braked, inputs[0, index], 1), rtol=1e-6, atol=1e-8
        )


def test_forces_of_affine_actuators_are_mujocos_within_their_limits():
    actuators = """
    <general joint="yaw" gaintype="affine" gainprm="2 0.5 -0.3" biastype="affine" biasprm="0.1 -1 0.2"
      ctrlrange="-0.3 0.2" ctrllimited="true"/>
    <position joint="lift" kp="5" kv="0.1" forcerange="-0.2 0.4" forcelimited="true"/>
    <motor joint="slide" gear="3"/>"""
    text = ARM.replace(ARM[ARM.index("<actuator>") + 10 : ARM.index("</actuator>")], actuators)
    model = mujoco.MjModel.from_xml_string(text)
    data, inputs = mujoco.MjData(model), rows(20)[0]
    lengths, speeds, forces = np.empty((3, 20, 3))
    for index, row in enumerate(inputs):
        data.qpos[:], data.qvel[:], data.ctrl[:] = np.split(row, 3)
        mujoco.mj_forward(model, data)
        lengths[index], speeds[index], forces[index] = (
            data.actuator_length, data.actuator_velocity, data.actuator_force
        )  # fmt: skip

    def own(name):
        return np.tile(getattr(model, name), (20, *[1] * getattr(model, name).ndim))

    given = {name: own(name) for name in ("actuator_gainprm", "actuator_biasprm")}
    free, limited = _forces_of({name: own(name) for name in LIMITS}, given, inputs[:, 6:], lengths, speeds)
    np.testing.assert_allclose(limited, forces, atol=1e-12)
    np.testing.assert_allclose(free[:, [0, 2]], forces[:, [0, 2]], atol=1e-12)
    assert (np.abs(free[:, 1]) > np.abs(forces[:, 1])).any()


# -- batches -----------------------------------------------------------------------------------------------------------


def test_a_stepper_that_has_run_one_model_runs_another():
    heavier = mujoco.MjModel.from_xml_string(ARM.replace('size="0.04"', 'size="0.06"'))
    inputs, stepper = rows(), Stepper()
    for _ in range(2):
        for models in ((MODEL,), (heavier,), (MODEL, heavier), (heavier, MODEL)):
            states, _ = stepper.run([Job(0, model, 2) for model in models], inputs)
            for model, found in zip(models, states):
                expected = [plain(model, row, 2) for row in inputs[0]]
                np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("chunk", [1, 3, 4, 5, 100])
@pytest.mark.parametrize("forces", [Forces(), Forces(body=1, drag_all=0.5)], ids=["plain", "drag"])
def test_rows_of_jobs_are_cut_into_chunks_anywhere(monkeypatch, chunk, forces):
    inputs, jobs = rows(5), [Job(0, MODEL, 2, forces), Job(0, MODEL, 3, forces), Job(0, MODEL, 2, forces)]
    whole, _ = Stepper().run(jobs, inputs)
    monkeypatch.setattr(stepping, "CHUNK", chunk)
    found, _ = Stepper().run(jobs, inputs)
    np.testing.assert_array_equal(found, whole)
    np.testing.assert_array_equal(found[0], found[2])


def test_a_play_begins_where_it_was_or_at_the_flank_that_its_motor_presses_on():
    model = MujocoSimulator(ARM).compiled({"backlash[lift]": 0.1})
    motor, link = model.joint("lift"), model.joint("lift.play")
    columns = (motor.qposadr[0], motor.dofadr[0], link.qposadr[0], link.dofadr[0])
    play = Play(*(int(one) for one in columns), 0.1)
    inputs = rows(3)
    hidden = np.array([[np.nan, np.nan], [0.03, -0.2], [np.nan, np.nan]])
    states, after = Stepper().run([Job(0, model, 1, plays=(play,), hidden=hidden)], inputs)
    for index in range(3):
        data = mujoco.MjData(model)
        seen = [one for one in range(model.nq) if one != play.play]
        data.qpos[seen], data.qvel[seen], data.ctrl[:] = np.split(inputs[0, index], 3)
        mujoco.mj_forward(model, data)
        place, speed = -np.sign(data.qfrc_actuator[play.joint_dof]) * 0.05, 0.0
        if index == 1:
            place, speed = hidden[1]
        data.qpos[play.play], data.qvel[play.play_dof] = place, speed
        data.qpos[play.joint] -= place
        data.qvel[play.joint_dof] -= speed
        data.qacc_warmstart[:] = 0
        mujoco.mj_step(model, data)
        np.testing.assert_allclose(
            after[0][index], [data.qpos[play.play], data.qvel[play.play_dof]], atol=1e-9
        )
        assert states[0, index, 1] == pytest.approx(data.qpos[play.joint] + data.qpos[play.play], abs=1e-9)


def test_a_contact_is_seen_in_its_row():
    text = (
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 0.1"><joint type="slide" axis="0 0 1"/>'
        '<geom size="0.1"/></body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    inputs = np.array([[[0.5, 0.0], [-0.01, 0.0], [0.2, 0.0], [-0.02, 0.0]]])
    np.testing.assert_array_equal(Stepper().constrained(Job(0, model, 1), inputs), [False, True, False, True])


NOTHING = {
    "plain": Forces(),
    "drag": Forces(body=1, drag_all=1e-30),
    "dead zone": Forces(dead_zones=((1, 1e-30),)),
    "friction": Forces(friction=((1, 1, tuple(NEUTRAL.values())),)),
}


@pytest.mark.parametrize("n_substeps", [1, 3])
@pytest.mark.parametrize("forces", NOTHING.values(), ids=NOTHING)
def test_a_solver_that_stops_early_starts_each_row_from_nothing(forces, n_substeps):
    """With one iteration it shows where it began: laws of nothing look at the state before, and earlier rows ran."""
    text = ARM.replace('<option timestep="0.004"', '<option timestep="0.004" iterations="1" tolerance="0"')
    model = mujoco.MjModel.from_xml_string(text.replace("<joint ", '<joint frictionloss="0.3" '))
    inputs, stepper = rows(4), Stepper()
    for _ in range(2):
        states, _ = stepper.run([Job(0, model, n_substeps, forces)], inputs)
        for index in range(4):
            np.testing.assert_allclose(
                states[0, index], plain(model, inputs[0, index], n_substeps), atol=1e-12
            )
