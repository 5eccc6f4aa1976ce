"""Logs that are well-formed but hardly meant raise a warning, and sound ones none."""

import re
import warnings
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from skat.diagnosis import doubts
from skat.diagnosis.doubts import warn_of_doubts
from skat.diagnosis.log import check_log, without_channels
from skat.simulators import FunctionSimulator, MujocoSimulator
from tests.machines import SERVO_ARM, changed

ARM = """
<mujoco>
  <option timestep="0.01" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="arm">
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="0.2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.03" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder" ctrlrange="-1 1" ctrllimited="true"/></actuator>
</mujoco>
"""


@pytest.fixture
def simulator():
    return MujocoSimulator(ARM, frame_skip=2)


@pytest.fixture
def log(simulator):
    commands = np.random.default_rng(0).uniform(-1, 1, (3, 40, 1))
    states = simulator.rollout([[1.5, 0], [-1.0, 0], [0.5, 2]], commands, n_steps=40)
    X = np.concatenate([np.hstack([state[:-1], command]) for state, command in zip(states, commands)])
    return X, np.concatenate(states[:, 1:]), np.repeat(np.arange(3), 40)


def test_sound_log_raises_no_warning(simulator, log):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_doubts(simulator, check_log(simulator, *log))


def test_angles_in_degrees_are_noticed(simulator, log):
    X, y, groups = log
    X[:, :2], y[:] = np.rad2deg(X[:, :2]), np.rad2deg(y)
    with pytest.raises(
        ValueError, match=r"qpos\.shoulder, qvel\.shoulder look like degrees.* numpy\.deg2rad"
    ):
        warn_of_doubts(simulator, check_log(simulator, X, y, groups))


def test_angles_that_may_be_degrees_are_only_warned_of(simulator, log, monkeypatch):
    lenient = [replace(one, refused=1e12) if one.name == "degrees" else one for one in doubts.DOUBTS]
    monkeypatch.setattr(doubts, "DOUBTS", lenient)
    X, y, groups = noisy(log)
    X[:, :2], y[:] = np.rad2deg(X[:, :2]), np.rad2deg(y)
    with pytest.warns(UserWarning, match="look like degrees") as caught:
        warn_of_doubts(simulator, check_log(simulator, X, y, groups))
    assert len(caught) == 1


def test_degrees_are_noticed_where_a_function_s_columns_have_units(simulator, log):
    names = simulator.input_names
    units = dict(zip(names, ("rad", "rad/s")))
    arm = FunctionSimulator(
        simulator.predict, input_names=names, output_names=names[:2], state_names=names[:2], units=units
    )
    X, y, groups = log
    X[:, :2], y[:] = np.rad2deg(X[:, :2]), np.rad2deg(y)
    with pytest.raises(ValueError, match=r"qpos\.shoulder, qvel\.shoulder look like degrees"):
        warn_of_doubts(arm, check_log(arm, X, y, groups))


def noisy(log):
    X, y, groups = log
    noise = 0.01 * np.std(y, axis=0) * np.random.default_rng(1).normal(size=(len(y) + 1, 2))
    return np.hstack([X[:, :2] + noise[:-1], X[:, 2:]]), y + noise[1:], groups


def test_commands_that_stand_a_row_late_are_noticed(simulator, log):
    X, y, groups = noisy(log)
    for episode in np.unique(groups):
        rows = np.flatnonzero(groups == episode)
        X[rows[1:], 2] = X[rows[:-1], 2].copy()
    with pytest.warns(UserWarning, match=r"Commands look a row late.*move the commands up by one row"):
        warn_of_doubts(simulator, check_log(simulator, X, y, groups))


def test_delayed_commands_are_no_late_ones(simulator, log):
    commands = log[0][:, 2].reshape(3, 40, 1)
    states = simulator.rollout(
        [[1.5, 0], [-1.0, 0], [0.5, 2]], commands, n_steps=40, effects={"delay[action]": 0.02}
    )
    X = np.concatenate([states[:, :-1], commands], axis=2).reshape(-1, 3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_doubts(simulator, check_log(simulator, X, states[:, 1:].reshape(-1, 2), log[2]))


def test_episodes_that_are_glued_together_are_noticed(simulator, log):
    X, y, _ = log
    y[39], y[79] = X[40, :2], X[80, :2]
    glued = check_log(simulator, X, y, np.zeros(len(X)))
    with pytest.warns(
        UserWarning, match=r"The state jumps in rows 39, 79, .*does another episode begin behind it\?"
    ):
        warn_of_doubts(simulator, glued)


def test_rows_in_time_order_without_groups_are_noticed(simulator, log):
    X, y, groups = log
    with pytest.warns(UserWarning, match=r"Each row begins where the one before it has ended.*Pass groups="):
        check_log(simulator, X, y, None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_log(simulator, X[::2], y[::2], None)
        check_log(simulator, X, y, groups)


def test_angle_of_many_turns_in_radians_is_sound(simulator):
    states = simulator.rollout([[0.0, 60.0]], n_steps=60, inputs=np.zeros((1, 60, 1)))[0]
    X = np.hstack([states[:-1], np.zeros((60, 1))])
    assert X[:, 0].max() > 4 * np.pi
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_doubts(simulator, check_log(simulator, X, states[1:], np.zeros(60)))


def test_angle_that_starts_anew_at_a_full_turn_is_noticed(simulator):
    states = simulator.rollout([[0.0, 40.0]], n_steps=60, inputs=np.zeros((1, 60, 1)))[0]
    states[:, 0] = np.angle(np.exp(1j * states[:, 0]))
    X = np.hstack([states[:-1], np.zeros((60, 1))])
    count = np.sum(np.abs(np.diff(states[:, 0])) > np.pi)
    assert count > 1
    with pytest.warns(UserWarning, match=rf"qpos\.shoulder jumps by about a full turn in {count} of 60 rows"):
        warn_of_doubts(simulator, check_log(simulator, X, states[1:], np.zeros(60)))


def test_heading_in_degrees_that_starts_anew_is_noticed():
    names = ("heading", "rate")
    vessel = FunctionSimulator(
        lambda X: X @ [[1.0, 0.0], [0.1, 1.0]],
        input_names=names,
        output_names=names,
        state_names=names,
        units={"heading": "deg", "rate": "deg/s"},
        dt=0.1,
    )
    states = vessel.rollout([[0.0, 100.0]], n_steps=60)[0]
    states[:, 0] = (states[:, 0] + 180) % 360 - 180
    with pytest.warns(UserWarning, match="heading jumps by about a full turn in 2 of 60 rows"):
        warn_of_doubts(vessel, check_log(vessel, states[:-1], states[1:], np.zeros(60)))


def test_simulation_without_a_time_step_is_not_asked_for_rates():
    names = ("qpos.z", "qvel.z")
    falling = FunctionSimulator(
        lambda X: X @ [[1.0, 0.0], [0.1, 1.0]], input_names=names, output_names=names, state_names=names
    )
    states = falling.rollout([[0.0, 1.0]], n_steps=40)[0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_doubts(falling, check_log(falling, states[:-1], states[1:], np.zeros(40)))


def test_commands_that_the_simulation_clips_are_noticed(simulator, log):
    X, y, groups = log
    X[::3, 2] = 1.7
    with pytest.warns(UserWarning, match=r"3\d % of ctrl\.shoulder lie beyond \[-1, 1\]"):
        warn_of_doubts(simulator, check_log(simulator, X, y, groups))


def test_channel_that_never_changes_is_noticed(simulator, log):
    X, y, groups = log
    X[:, 1], y[:, 1] = 0.0, 0.0
    with pytest.warns(UserWarning, match=r"qvel\.shoulder has the same value in every row"):
        warn_of_doubts(simulator, check_log(simulator, X, y, groups))


def test_state_that_rests_in_the_simulation_too_is_sound(simulator):
    X, y = np.zeros((40, 3)), np.zeros((40, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_doubts(simulator, check_log(simulator, X, y, np.zeros(40)))


def test_simulation_that_is_random_is_refused():
    rng = np.random.default_rng(0)
    names = {"input_names": ("u",), "output_names": ("y",)}
    X = rng.normal(size=(40, 1))
    for size, accepted in ((1e-9, True), (1e-3, False)):
        random = FunctionSimulator(lambda X, size=size: X + size * rng.normal(size=X.shape), **names)
        log = check_log(random, X, X[:, 0], None)
        if accepted:
            warn_of_doubts(random, log)
        else:
            with pytest.raises(ValueError, match=r"not the same when it is asked again: y in row \d+"):
                warn_of_doubts(random, log)


def swung(simulator, seed, effects=None):
    """Return the noisy states (8, 51, 2) of an arm in swings of 50 rows, and the torques (8, 50, 1)."""
    rng = np.random.default_rng(seed)
    torques = rng.uniform(-1, 1, (8, 50, 1))
    states = simulator.rollout(rng.normal(size=(8, 2)), torques, n_steps=50, effects=effects)
    return states + 0.01 * states.std(axis=(0, 1)) * rng.normal(size=states.shape), torques


def texts_about(simulator, states, torques):
    X = np.concatenate([states[:, :-1], torques], axis=2).reshape(400, 3)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_doubts(
            simulator, check_log(simulator, X, states[:, 1:].reshape(400, 2), np.repeat(np.arange(8), 50))
        )
    return [str(one.message) for one in caught]


@pytest.mark.parametrize("seed", range(4))
def test_velocities_of_a_filter_are_noticed_with_their_lag(simulator, seed):
    states, torques = swung(simulator, seed)
    assert texts_about(simulator, states, torques) == []
    for row in range(1, 51):
        states[:, row, 1] = 0.3 * states[:, row - 1, 1] + 0.7 * states[:, row, 1]
    (doubt,) = texts_about(simulator, states, torques)
    share = float(re.search(r"velocities lag the positions by about \S+ s \((\d+) % of a row\)", doubt)[1])
    assert abs(share - 100 * 0.3 / 0.7) < 10


@pytest.mark.parametrize("finer", [1, 2, 10])
def test_finer_steps_of_reality_are_no_lag_and_hide_none(simulator, finer):
    text = ARM.replace('timestep="0.01"', f'timestep="{0.01 / finer}"')
    states, torques = swung(MujocoSimulator(text, frame_skip=2 * finer), 0)
    assert texts_about(simulator, states, torques) == []
    for row in range(1, 51):
        states[:, row, 1] = 0.3 * states[:, row - 1, 1] + 0.7 * states[:, row, 1]
    (doubt,) = texts_about(simulator, states, torques)
    assert doubt.startswith("The velocities lag the positions by about")


@pytest.mark.parametrize(
    "effects",
    [{"delay[action]": 0.01}, {"scale[qvel.shoulder]": 1.2, "bias[qvel.shoulder]": 0.3}, {"mass[all]": 1.5}],
)
def test_what_a_robot_does_is_no_lag_of_its_velocities(simulator, effects):
    assert texts_about(simulator, *swung(simulator, 0, effects)) == []


def test_positions_of_a_filter_are_noticed(simulator):
    states, torques = swung(simulator, 0)
    for row in range(1, 51):
        states[:, row, 0] = 0.3 * states[:, row - 1, 0] + 0.7 * states[:, row, 0]
    (doubt,) = texts_about(simulator, states, torques)
    assert doubt.startswith("The positions lag the velocities by about")


def test_velocity_of_what_rests_higher_than_in_the_simulation_is_one():
    simulator = MujocoSimulator(
        """<mujoco><worldbody><geom type="plane" size="1 1 .1"/><body pos="0 0 .1">
        <joint name="z" type="slide" axis="0 0 1"/><geom type="sphere" size=".1" mass="1"/>
        </body></worldbody></mujoco>""",
        frame_skip=10,
    )
    states = [0.004, 0.0] + np.random.default_rng(0).normal(size=(61, 2)) * [1e-5, 2e-4]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_doubts(simulator, check_log(simulator, states[:-1], states[1:], np.zeros(60)))


@pytest.mark.parametrize("every", [1, 7])
def test_rows_in_which_a_free_body_diverges_are_no_doubt_about_its_velocities(monkeypatch, every):
    ball = "<body><freejoint name='ball'/><geom size='0.1'/></body>"
    simulator = MujocoSimulator(f"<mujoco><worldbody>{ball}</worldbody></mujoco>", frame_skip=5)
    start = np.r_[0.0, 0.0, 9.0, 1.0, np.zeros(3), 2.0, 0.3, np.zeros(4)]
    states = simulator.rollout(start[None], n_steps=40)[0]
    states[:, :3] += 0.01 * np.random.default_rng(0).standard_normal((41, 3))
    predict_many = simulator.predict_many

    def diverging(X, candidates, **options):
        outputs = predict_many(X, candidates, **options)
        outputs[:, ::every] = np.nan
        return outputs

    monkeypatch.setattr(simulator, "predict_many", diverging)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_doubts(simulator, check_log(simulator, states[:-1], states[1:], np.zeros(40)))


# -- degrees of a robot with servos -----------------------------------------------------------------------------------

TURNING_ARM = changed(SERVO_ARM, ('axis="0 1 0"/>', 'axis="0 1 0" range="-114.6 114.6"/>'))


def servo_log(simulator, seed=0):
    """Return X, y and groups of an arm that follows its servos through large angles, with a little noise."""
    rng = np.random.default_rng(seed)
    n_commands = len(simulator.input_names) - 4
    aims = np.repeat(rng.uniform(-1.2, 1.2, (4, 6, n_commands)), 20, axis=1)
    states = simulator.rollout(0.3 * rng.normal(size=(4, 4)), aims, n_steps=120)
    states += 1e-3 * rng.normal(size=states.shape)
    X = np.concatenate([states[:, :-1], aims], axis=2).reshape(480, -1)
    return X, states[:, 1:].reshape(480, 4), np.repeat(np.arange(4), 120)


@pytest.fixture
def arm():
    return MujocoSimulator(TURNING_ARM, frame_skip=4)


def all_texts(simulator, log):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_doubts(simulator, log)
    return [str(one.message) for one in caught]


def test_a_sound_log_of_servos_raises_no_doubt_whatever_was_not_measured(arm):
    X, y, groups = servo_log(arm)
    assert all_texts(arm, check_log(arm, X, y, groups)) == []
    for hidden in (["qvel.shoulder", "qvel.elbow"], ["qpos.elbow"], ["qpos.shoulder", "qpos.elbow"]):
        assert all_texts(arm, without_channels(arm, check_log(arm, X, y, groups), hidden)) == []
    lost = np.random.default_rng(1).random((480, 4)) < 0.05
    X[:, :4][lost], y[lost] = np.nan, np.nan
    assert all_texts(arm, check_log(arm, X, y, groups)) == []


def test_commands_of_position_servos_are_taken_for_degrees_with_what_they_command(arm):
    X, y, groups = servo_log(arm)
    said = (
        r"qpos\.shoulder, qpos\.elbow, qvel\.shoulder, qvel\.elbow, ctrl\.lift, ctrl\.bend look like degrees"
    )
    with pytest.raises(ValueError, match=said) as error:
        warn_of_doubts(arm, check_log(arm, np.rad2deg(X), np.rad2deg(y), groups))
    assert re.search(r"qpos\.\w+ reaches -?\d+(\.\d)? where the joint allows -2 to 2 rad", str(error.value))


@pytest.mark.parametrize("hidden", [False, True])
def test_only_columns_in_degrees_are_named(arm, hidden):
    X, y, groups = servo_log(arm)
    X[:, :2], y[:, :2] = np.rad2deg(X[:, :2]), np.rad2deg(y[:, :2])
    log = check_log(arm, X, y, groups)
    log = without_channels(arm, log, ["qvel.shoulder", "qvel.elbow"]) if hidden else log
    (doubt,) = (one for one in doubts.doubts_about(arm, log) if one.name == "degrees")
    assert doubt.sentence.startswith("qpos.shoulder, qpos.elbow look like degrees")


def test_a_position_far_beyond_its_joint_s_range_is_noticed(arm):
    X, y, groups = servo_log(arm)
    X[:, 1] *= 8
    y[:, 1] *= 8
    texts = all_texts(arm, check_log(arm, X, y, groups))
    assert any(
        re.match(r"qpos\.elbow reaches \S+ where the joint allows -2 to 2 rad: another unit", text)
        for text in texts
    )


def test_an_angle_that_starts_anew_is_noticed_without_its_rate(simulator):
    states = simulator.rollout([[0.0, 40.0]], n_steps=60, inputs=np.zeros((1, 60, 1)))[0]
    states[:, 0] = np.angle(np.exp(1j * states[:, 0]))
    states[:, 1] = np.nan
    X = np.hstack([states[:-1], np.zeros((60, 1))])
    count = np.sum(np.abs(np.diff(states[:, 0])) > np.pi)
    (text,) = all_texts(simulator, check_log(simulator, X, states[1:], np.zeros(60)))
    assert text.startswith(f"qpos.shoulder jumps by about a full turn in {count} of 60 rows")


# -- quaternions ------------------------------------------------------------------------------------------------------

BOX = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody><body><freejoint name="box"/><geom type="box" size=".1 .2 .3" mass="1"/></body></worldbody>
</mujoco>
"""


def tumbling(simulator, seed=0):
    rng = np.random.default_rng(seed)
    start = simulator.displace(
        np.tile(np.r_[np.zeros(3), 1.0, np.zeros(9)], (3, 1)),
        rng.normal(size=(3, 12)) * np.r_[np.ones(6), 3 * np.ones(6)],
    )
    states = simulator.rollout(start, n_steps=40)
    states = simulator.displace(states, 1e-3 * rng.normal(size=(3, 41, 12)))
    return states, np.repeat(np.arange(3), 40)


def test_a_quaternion_s_order_and_length_are_noticed():
    box = MujocoSimulator(BOX, frame_skip=5)
    states, groups = tumbling(box)

    def texts(states):
        return all_texts(
            box, check_log(box, states[:, :-1].reshape(120, 13), states[:, 1:].reshape(120, 13), groups)
        )

    assert texts(states) == []
    turned = states.copy()
    turned[..., 3:7] = np.roll(states[..., 3:7], -1, axis=-1)
    (text,) = texts(turned)
    assert text.startswith("The quaternion of qpos.box looks as if its real part came last")
    turned[1, 7, 3:7] = np.nan  # one row less tells as much
    (text,) = texts(turned)
    assert text.startswith("The quaternion of qpos.box looks as if its real part came last")
    longer = states.copy()
    longer[..., 3:7] *= 1.1
    (text,) = texts(longer)
    assert text.startswith("The quaternion of qpos.box has the length 1.1 in a typical row")
    states[:, :, 3:7] = np.nan
    assert texts(states) == []


# -- a solver that does not arrive ------------------------------------------------------------------------------------

LEGGED = """
<mujoco>
  <option timestep="0.005" iterations="{}" ls_iterations="{}"/>
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body pos="0 0 .32">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
      <joint name="pitch" axis="0 1 0"/>
      <geom type="box" size=".15 .1 .05" mass="3"/>
      <body pos=".12 0 -.05"><joint name="front" axis="0 1 0" damping=".5" frictionloss=".3"/>
        <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.25" mass=".3"/></body>
      <body pos="-.12 0 -.05"><joint name="back" axis="0 1 0" damping=".5" frictionloss=".3"/>
        <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.25" mass=".3"/></body>
    </body>
  </worldbody>
  <actuator><position joint="front" kp="30"/><position joint="back" kp="30"/></actuator>
</mujoco>
"""


def walked(text, frame_skip, noise=1.0):
    """Return the noisy states and the commands of one episode in plain MuJoCo, whose solver begins where it ended."""
    model = mujoco.MjModel.from_xml_string(text)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    states, commands = [], 0.4 * np.sin(0.2 * np.arange(200)[:, None] + [0.0, 2.0])
    for command in commands:
        states.append(np.r_[data.qpos, data.qvel])
        data.ctrl[:] = command
        mujoco.mj_step(model, data, frame_skip)
    states = np.array([*states, np.r_[data.qpos, data.qvel]])
    return states + noise * np.repeat([1e-4, 5e-3], 5) * rng.normal(size=states.shape), commands


@pytest.mark.parametrize(("iterations", "line", "noticed"), [(1, 4, True), (100, 50, False)])
def test_a_solver_that_depends_on_where_it_begins_is_noticed(iterations, line, noticed):
    text = LEGGED.format(iterations, line)
    legged = MujocoSimulator(text, frame_skip=2)
    states, commands = walked(text, 2)
    log = check_log(legged, np.hstack([states[:-1], commands]), states[1:], np.zeros(200))
    cold = [one for one in doubts.doubts_about(legged, log) if one.name == "cold"]
    assert len(cold) == noticed  # in one sentence, whatever channels it is about
    if noticed:
        assert "with at most 1 iterations" in cold[0].sentence
    velocities = [name for name in legged.state_names if name.startswith("qvel.")]
    less = without_channels(legged, log, velocities)
    assert bool([one for one in doubts.doubts_about(legged, less) if one.name == "cold"]) == noticed


def test_a_warm_solver_goes_on_as_a_whole_episode_of_mujoco_does_and_a_cold_one_does_not():
    text = LEGGED.format(1, 4)
    legged = MujocoSimulator(text, frame_skip=2)
    states, commands = walked(text, 2, noise=0.0)
    log = check_log(legged, np.hstack([states[:-1], commands]), states[1:], np.zeros(200))
    model = legged.compiled()
    warm, cold = (doubts._stepped(model, log, 2, warm=warm) for warm in (True, False))
    np.testing.assert_allclose(warm, states[1:], atol=1e-9)
    assert np.abs(cold - states[1:]).max() > 1e-3


def test_rows_that_diverge_leave_no_log_of_mujoco_behind(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    legged = MujocoSimulator(LEGGED.format(1, 4), frame_skip=2)
    states, commands = walked(LEGGED.format(1, 4), 2, noise=0.0)
    log = check_log(legged, np.hstack([states[:-1], commands]), states[1:], np.zeros(200))
    log.X[:3, len(legged.state_names) - 1] = 1e12
    doubts._stepped(legged.compiled(), log, 2, warm=True)
    assert not list(tmp_path.iterdir())


def test_doubts_have_names_of_their_own_and_explain_only_such():
    names = [one.name for one in doubts.DOUBTS]
    assert len(set(names)) == len(names)
    for place, one in enumerate(doubts.DOUBTS):
        assert set(one.unless) <= set(names[:place])
