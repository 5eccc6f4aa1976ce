"""Logs that are well-formed but hardly meant raise a warning, and sound ones none."""

import re
import warnings

import numpy as np
import pytest

from skat.diagnosis import plausibility
from skat.diagnosis.log import check_log
from skat.diagnosis.plausibility import warn_of_doubts, warn_of_lasting_noise
from skat.simulators import FunctionSimulator, MujocoSimulator

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
    monkeypatch.setattr(plausibility, "CERTAIN_IN_RADIANS", 1e12)
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
        plausibility.warn_of_doubts(simulator, check_log(simulator, X, y, groups))


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


@pytest.mark.parametrize("kind", ["backward", "forward", "central"])
def test_velocities_that_are_differences_of_noisy_positions_are_noticed(simulator, log, kind):
    X, y, groups = log
    rng = np.random.default_rng(1)
    for group in np.unique(groups):
        rows = np.flatnonzero(groups == group)
        position = np.append(X[rows, 0], y[rows[-1], 0])
        position += 0.01 * rng.standard_normal(len(position))
        rate = np.diff(position) / simulator.dt
        velocity = {
            "backward": np.append(rate[0], rate),
            "forward": np.append(rate, rate[-1]),
            "central": np.gradient(position, simulator.dt),
        }[kind]
        X[rows, :2] = np.c_[position, velocity][:-1]
        y[rows] = np.c_[position, velocity][1:]
    with pytest.warns(
        UserWarning, match=rf"qvel\.shoulder is no measurement of velocity, but {kind} differences"
    ):
        warn_of_doubts(simulator, check_log(simulator, X, y, groups))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_doubts(
            simulator, check_log(simulator, X, y, groups, hidden=["qvel.shoulder"]), ["qvel.shoulder"]
        )


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


@pytest.mark.parametrize(("unit", "noticed"), [("rad/s", True), (None, True), ("m/s", False)])
def test_velocities_that_are_differences_are_noticed_by_units_or_whatever_they_are_called(unit, noticed):
    def turn(X):
        return np.c_[X[:, 0] + 0.1 * X[:, 1] + 0.005 * X[:, 2], X[:, 1] + 0.1 * X[:, 2]]

    rig = FunctionSimulator(
        turn,
        input_names=("angle", "speed", "torque"),
        output_names=("angle", "speed"),
        state_names=("angle", "speed"),
        units={"angle": "rad", "speed": unit} if unit else {},
        dt=0.1,
    )
    rng = np.random.default_rng(0)
    torque = rng.normal(size=(60, 1))
    states = np.zeros((61, 2))
    for k in range(60):
        states[k + 1] = turn(np.c_[states[k : k + 1], torque[k : k + 1]])[0]
    angle = states[:, 0] + 0.01 * rng.normal(size=61)
    measured = np.c_[angle, np.gradient(angle, 0.1)]
    log = check_log(rig, np.c_[measured[:-1], torque], measured[1:], np.zeros(60))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_doubts(rig, log)
    assert any("speed is no measurement of velocity" in str(one.message) for one in caught) == noticed


def swung(simulator, seed, effects=None):
    """Return the noisy states (8, 51, 2) of an arm in swings of 50 rows, and the torques (8, 50, 1)."""
    rng = np.random.default_rng(seed)
    torques = rng.uniform(-1, 1, (8, 50, 1))
    states = simulator.rollout(rng.normal(size=(8, 2)), torques, n_steps=50, effects=effects)
    return states + 0.01 * states.std(axis=(0, 1)) * rng.normal(size=states.shape), torques


def doubts_about(simulator, states, torques):
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
    assert doubts_about(simulator, states, torques) == []
    for row in range(1, 51):
        states[:, row, 1] = 0.3 * states[:, row - 1, 1] + 0.7 * states[:, row, 1]
    (doubt,) = doubts_about(simulator, states, torques)
    share = float(re.search(r"velocities lag the positions by about \S+ s \((\d+) % of a row\)", doubt)[1])
    assert abs(share - 100 * 0.3 / 0.7) < 10


@pytest.mark.parametrize("finer", [1, 2, 10])
def test_finer_steps_of_reality_are_no_lag_and_hide_none(simulator, finer):
    text = ARM.replace('timestep="0.01"', f'timestep="{0.01 / finer}"')
    states, torques = swung(MujocoSimulator(text, frame_skip=2 * finer), 0)
    assert doubts_about(simulator, states, torques) == []
    for row in range(1, 51):
        states[:, row, 1] = 0.3 * states[:, row - 1, 1] + 0.7 * states[:, row, 1]
    (doubt,) = doubts_about(simulator, states, torques)
    assert doubt.startswith("The velocities lag the positions by about")


@pytest.mark.parametrize(
    "effects",
    [{"delay[action]": 0.01}, {"scale[qvel.shoulder]": 1.2, "bias[qvel.shoulder]": 0.3}, {"mass[all]": 1.5}],
)
def test_what_a_robot_does_is_no_lag_of_its_velocities(simulator, effects):
    assert doubts_about(simulator, *swung(simulator, 0, effects)) == []


def test_positions_of_a_filter_are_noticed(simulator):
    states, torques = swung(simulator, 0)
    for row in range(1, 51):
        states[:, row, 0] = 0.3 * states[:, row - 1, 0] + 0.7 * states[:, row, 0]
    (doubt,) = doubts_about(simulator, states, torques)
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


@pytest.mark.parametrize("step", [0.0, 0.02])
def test_noise_that_lasts_is_told_from_that_of_the_sensor(simulator, log, step):
    X, y, groups = log
    rng = np.random.default_rng(0)
    y = y + [[0.01, 0.0]] * rng.normal(size=y.shape)
    if step:
        y[:, 0] = step * np.round(y[:, 0] / step)
    follows = np.flatnonzero(groups[1:] == groups[:-1]) + 1
    X[follows, :2] = y[follows - 1]
    noisy, sensor = (
        check_log(simulator, X, y, groups, hidden=("qvel.shoulder",)),
        np.hypot(0.01, step / 12**0.5),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_lasting_noise(simulator, noisy, ("qvel.shoulder",), np.array([1.3 * sensor]))
    with pytest.warns(UserWarning, match=r"qpos\.shoulder is 0\.0\d+ rad, but neighbouring rows .* noise="):
        warn_of_lasting_noise(simulator, noisy, ("qvel.shoulder",), np.array([3 * sensor]))


def test_a_sensor_with_coarse_steps_is_not_taken_for_a_quiet_one(simulator, log):
    X, y, groups = log
    X[:, 0], y[:, 0] = np.round(X[:, 0]), np.round(y[:, 0])
    coarse = check_log(simulator, X, y, groups, hidden=("qvel.shoulder",))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_lasting_noise(simulator, coarse, ("qvel.shoulder",), np.array([0.29]))
