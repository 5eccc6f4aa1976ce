"""What no effect explains is found: a law of a joint in its own coordinates, and what outlasts single rows."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.log import Log
from skat.diagnosis.omnibus import TIME, _persistence, find_remainder
from skat.diagnosis.residuals import Linearisation
from skat.simulators import MujocoSimulator


class Rows:
    """As much of residuals as the test of persistence needs: episodes, names, and that nothing is projected out."""

    log = Log(np.zeros((1000, 1)), np.zeros((1000, 1)), np.repeat(np.arange(20), 50), True)
    channels = ("a", "b")

    def taken(self):
        return np.zeros((1000, len(self.channels), 0))


def test_persistence_is_uniform_for_noise_with_heavy_tails():
    p_values = [
        pair.p_value
        for seed in range(200)
        for pair in _persistence(Rows(), np.random.default_rng(seed).standard_t(4, (1000, 2)))
    ]
    # A standard deviation of the share is 0.011 at 5 %.
    assert 0.02 < np.mean(np.array(p_values) < 0.05) < 0.09
    assert np.mean(np.array(p_values) < 0.001) < 0.01


def test_periodic_remainder_is_found_in_its_channel():
    white = np.random.default_rng(0).normal(size=(1000, 2))
    white[:, 1] += np.sin(np.arange(1000) / 3)
    quiet, loud = _persistence(Rows(), white)
    assert (loud.direction, loud.coordinate) == ("b", TIME)
    assert loud.p_value < 1e-4 < quiet.p_value


def test_one_contact_whose_linearisation_failed_does_not_count_as_lasting():
    white = np.random.default_rng(0).normal(size=(1000, 2))
    white[200:230, 1] += 5.0
    assert all(pair.p_value > 0.05 for pair in _persistence(Rows(), white))


@pytest.mark.parametrize("taken_off", [True, False])
def test_what_initial_states_take_of_noise_does_not_count_as_lasting(taken_off):
    """Of episodes of 20 rows a line each is taken: that leaves the rest correlated, in 100 episodes plainly."""
    line = np.linalg.qr(np.stack([np.ones(20), np.arange(20.0)], 1))[0]
    rows, p_values = Rows(), []
    rows.log = Log(np.zeros((2000, 1)), np.zeros((2000, 1)), np.repeat(np.arange(100), 20), True)
    columns = np.tile(line, (100, 1))[:, None] if taken_off else np.zeros((2000, 2, 0))
    rows.taken = lambda: np.broadcast_to(columns, (2000, 2, columns.shape[-1]))
    for seed in range(50):
        noise = np.random.default_rng(seed).normal(size=(100, 20, 2))
        white = noise - np.einsum("rk,sk,esc->erc", line, line, noise)
        p_values += [pair.p_value for pair in _persistence(rows, white.reshape(2000, 2))]
    if taken_off:
        assert np.mean(np.array(p_values) < 0.05) < 0.12
    else:
        assert np.median(p_values) < 0.01


class Joints(Rows):
    """White residuals of ten joints, as the test of a remainder needs them."""

    joints = [f"j{k}" for k in range(10)]

    def __init__(self, seed, input_names):
        self.points = np.random.default_rng(seed).normal(size=(1000, 10))
        self.channels = [f"qvel.{joint}" for joint in self.joints]
        self.simulator = SimpleNamespace(input_names=input_names)

    def directions(self, values):
        return np.broadcast_to(np.eye(10), (1000, 10, 10)), tuple((name, (name,)) for name in self.channels)

    def whiten(self, columns):
        return columns


def remainder_of(seed, strength, input_names, law=lambda speed: speed * np.abs(speed)):
    residuals = Joints(seed, input_names)
    white = np.random.default_rng(seed + 1_000).normal(size=(1000, 10))
    white[:, 3] += strength * law(residuals.points[:, 3])
    line = Linearisation({}, white, np.zeros((1000, 10, 0)), ())
    return find_remainder(residuals, line, [])


OWN = [f"qvel.{joint}" for joint in Joints.joints]
OTHER = [f"camera.c{k}" for k in range(10)]


def test_law_of_a_joint_in_its_own_speed_is_found_where_one_in_anything_would_be_doubted():
    own = [remainder_of(seed, 0.1, OWN) for seed in range(5)]
    other = [remainder_of(seed, 0.1, OTHER) for seed in range(5)]
    assert {(one.direction, one.coordinate) for one in own} == {("qvel.j3", "qvel.j3")}
    # Ten pairs, two tests of each, half of the level, against a hundred pairs.
    assert all(one.p_value < 0.5 * same.p_value for one, same in zip(own, other))


def stribeck(speed):
    """Return friction that falls as a joint starts to move, without its part like dry friction and damping."""
    law = np.sign(speed) * np.exp(-((speed / 0.2) ** 2))
    known = np.stack([np.sign(speed), speed], axis=1)
    return law - known @ np.linalg.lstsq(known, law, rcond=None)[0]


def test_odd_law_that_is_narrow_is_found():
    found = [remainder_of(seed, 1.0, OWN, stribeck) for seed in range(5)]
    assert all((one.direction, one.coordinate) == ("qvel.j3", "qvel.j3") for one in found)
    assert max(one.p_value for one in found) < 1e-3


def test_constant_error_is_not_said_to_depend_on_an_input():
    constant = [remainder_of(seed, 0.5, OWN, np.ones_like) for seed in range(20)]
    assert {one.direction for one in constant} == {"qvel.j3"}
    assert sum("always alike" in one.sentence for one in constant) >= 19
    lopsided = [remainder_of(seed, 0.5, OWN, lambda speed: 1 + 0.4 * speed) for seed in range(5)]
    assert all("depends on qvel.j3" in one.sentence for one in lopsided)


def test_remainder_of_noise_keeps_to_its_level():
    p_values = np.array([remainder_of(seed, 0.0, OWN).p_value for seed in range(60)])
    # At the level, nine of sixty or more are below 5 % in 0.3 % of runs.
    assert np.sum(p_values < 0.05) < 9
    assert 0.3 < np.mean(p_values) < 0.75


def test_input_that_is_always_zero_says_nothing():
    residuals = Joints(0, OWN)
    residuals.points[:, 3] = 0.0
    line = Linearisation({}, np.random.default_rng(1).normal(size=(1000, 10)), np.zeros((1000, 10, 0)), ())
    assert find_remainder(residuals, line, []).p_value > 0.05


ARM = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body><joint name="shoulder" axis="0 1 0" damping="0.05"/>
      <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4"/>
      <body pos="0 0 -.4"><joint name="elbow" axis="0 1 0" damping="0.05"/>
        <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.3"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="pull" joint="shoulder" gear="3"/></actuator>
</mujoco>
"""


def measured_arm(seed, spring, n_episodes=8, n_steps=40):
    """Return X, y, groups of an arm in plain MuJoCo with a cubic spring in its elbow, N m/rad3."""
    rng, model = np.random.default_rng(seed), mujoco.MjModel.from_xml_string(ARM)
    data, states, controls = mujoco.MjData(model), [], []
    for _ in range(n_episodes):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = rng.normal(size=2), 2 * rng.normal(size=2)
        episode = [np.r_[data.qpos, data.qvel]]
        for _ in range(n_steps):
            data.ctrl[:] = rng.normal()
            controls.append(data.ctrl.copy())
            for _ in range(4):
                data.qfrc_applied[1] = -spring * data.qpos[1] ** 3
                mujoco.mj_step(model, data)
            episode.append(np.r_[data.qpos, data.qvel])
        states.append(episode)
    states = np.array(states)
    states += 0.01 * states.std(axis=(0, 1)) * rng.normal(size=states.shape)
    X = np.hstack([states[:, :-1].reshape(-1, 4), controls])
    return X, states[:, 1:].reshape(-1, 4), np.repeat(np.arange(n_episodes), n_steps)


@pytest.mark.parametrize("spring", [0.0, 2.0])
def test_force_on_a_joint_is_found_there_with_what_it_depends_on(spring):
    X, y, groups = measured_arm(0, spring)
    effects = ["damping[shoulder]", "damping[elbow]", "stiffness[elbow]", "gain[pull]"]
    diagnosis = SimulationDiagnosis(MujocoSimulator(ARM, frame_skip=4), effects=effects, random_state=0)
    diagnosis.fit(X, y, groups=groups)
    if not spring:
        assert diagnosis.verdict_ == "nothing detected"
    else:
        assert diagnosis.verdict_ == "unexplained"
        assert (diagnosis.remainder_.direction, diagnosis.remainder_.coordinate) == ("elbow", "qpos.elbow")


@pytest.mark.filterwarnings("ignore:Every episode has one row")
def test_rows_of_a_robot_that_do_not_follow_each_other_are_diagnosed():
    X, y, _ = measured_arm(0, 0.0)
    smoother = MujocoSimulator(ARM, frame_skip=4, built_in={"damping[elbow]": -0.03})
    diagnosis = SimulationDiagnosis(smoother, random_state=0).fit(X, y, groups=np.arange(len(X)))
    assert [cause.name for cause in diagnosis.causes_] == ["damping[elbow]"]


def test_persistence_does_not_reach_across_the_borders_of_whitening():
    rng = np.random.default_rng(0)
    episodes = np.repeat(np.arange(40), 120)
    log = Log(np.zeros((len(episodes), 1)), np.zeros((len(episodes), 1)), episodes, True)
    white = 0.01 * rng.normal(size=(len(episodes), 1))
    signs = rng.choice([-1.0, 1.0], 40)
    white[np.arange(40) * 120 + 59, 0] = signs  # the last row of a piece
    white[np.arange(40) * 120 + 63, 0] = -signs  # in the next one
    residuals = SimpleNamespace(log=log, channels=("p",), taken=lambda: np.zeros((len(log), 1, 0)))
    (pair,) = _persistence(residuals, white)
    assert pair.p_value > 0.001
