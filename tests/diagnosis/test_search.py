"""The state-space engine on logs of plain MuJoCo: names, values, intervals, noise, missing samples."""

import mujoco
import numpy as np
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.causes import find_causes
from skat.diagnosis.statespace import linearise, state_space
from skat.simulators import MujocoSimulator

ARM = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" damping="{damping}"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="{mass}"/>
      <body name="lower" pos="0 0 -.3">
        <joint name="elbow" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".4"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder" name="shoulder"/><motor joint="elbow" name="elbow"/></actuator>
</mujoco>"""
NOMINAL = ARM.format(damping=0.05, mass=0.6)
SIGMA = np.array([0.002, 0.002, 0.02, 0.02])


def measured(text, seed, *, rows=50, force=0.0, episodes=6):
    """Return a log by plain MuJoCo, ten milliseconds a row, under random torques held for a row."""
    model, rng = mujoco.MjModel.from_xml_string(text), np.random.default_rng(seed)
    X, y, groups = [], [], []
    for episode in range(episodes):
        data = mujoco.MjData(model)
        data.qpos[:] = rng.uniform(-1, 1, 2)
        states, controls = [np.r_[data.qpos, data.qvel]], []
        phases = rng.uniform(0, 6, (2, 3))
        for row in range(rows):
            control = np.sin(np.array([2.0, 5.0, 9.0]) * row * 0.01 + phases).sum(axis=1) * [1.5, 0.4]
            data.ctrl[:], data.qfrc_applied[:] = control, force * rng.normal(size=2)
            mujoco.mj_step(model, data, 2)
            states.append(np.r_[data.qpos, data.qvel])
            controls.append(control)
        read = np.array(states) + SIGMA * rng.normal(size=(rows + 1, 4))
        X.append(np.column_stack([read[:-1], controls]))
        y.append(read[1:])
        groups += [episode] * rows
    return np.concatenate(X), np.concatenate(y), np.array(groups)


@pytest.fixture(scope="module")
def simulator():
    return MujocoSimulator(NOMINAL, frame_skip=2)


def asked(simulator, X, y, groups):
    return find_causes(state_space(simulator, X, y, groups, consecutive=True), simulator.effects())


@pytest.mark.parametrize("force", [0.0, 0.3], ids=["no force", "a random force"])
def test_a_right_model_is_not_accused_and_its_noise_is_found(simulator, force):
    found = asked(simulator, *measured(NOMINAL, 0, rows=300, episodes=2, force=force))
    assert not found.values
    assert found.settled
    np.testing.assert_allclose(np.sqrt(found.fitted.estimate.noise.error[0]), SIGMA, rtol=0.15)
    np.testing.assert_allclose(np.sqrt(found.fitted.estimate.noise.force), force, rtol=0.15, atol=0.03)


# Each cause and each force once; the other pairs of them are long.
@pytest.mark.parametrize(
    ("name", "force"),
    [
        ("damping[shoulder]", 0.3),
        ("mass[upper]", 0.0),
        pytest.param("damping[shoulder]", 0.0, marks=pytest.mark.long),
        pytest.param("mass[upper]", 0.3, marks=pytest.mark.long),
    ],
)
def test_a_hidden_cause_is_named_alone_inside_its_interval(simulator, name, force):
    text, value = {
        "damping[shoulder]": (ARM.format(damping=0.25, mass=0.6), 0.2),
        "mass[upper]": (ARM.format(damping=0.05, mass=0.72), 1.2),
    }[name]
    found = asked(simulator, *measured(text, 1, force=force))
    assert list(found.values) == [name]
    low, high = found.intervals[name]
    half = (high - low) / 2
    assert low - half < value < high + half
    assert found.worth[name] > -np.log(0.01)


def test_samples_and_channels_that_were_not_measured_are_left_out(simulator):
    X, y, groups = measured(ARM.format(damping=0.25, mass=0.6), 2)
    follows = np.r_[False, np.diff(groups) == 0]
    lost = (np.random.default_rng(0).random(len(y)) < 0.05) & np.r_[np.diff(groups) == 0, False]
    y[lost] = np.nan
    X[np.r_[False, lost[:-1]] & follows, :4] = np.nan
    X[:, 2:4], y[:, 2:4] = np.nan, np.nan  # no velocities
    found = asked(simulator, X, y, groups)
    assert list(found.values) == ["damping[shoulder]"]
    assert found.values["damping[shoulder]"] == pytest.approx(0.2, rel=0.05)


def test_slopes_and_means_are_those_of_the_simulation(simulator):
    X, y, groups = measured(NOMINAL, 3, rows=40)
    space = state_space(simulator, X, y, groups, consecutive=True)
    linear = linearise(space, space.measured, {})
    rows = space.rows(space.measured)
    move = np.random.default_rng(0).normal(size=(len(rows), 4)) * 1e-5
    moved = simulator.predict(simulator.displace(rows, move))
    expected = np.einsum("nij,nj->ni", linear.chains.transitions[space.places], move)
    np.testing.assert_allclose(moved - linear.outputs, expected, atol=1e-8)
    pushed = simulator.predict(rows, effects={"force[elbow]": 1e-3})
    carried = linear.chains.carrier[space.places][..., 1] * 1e-3
    np.testing.assert_allclose(pushed - linear.outputs, carried, rtol=1e-4, atol=1e-8)


def test_effects_that_are_listed_when_asked_for_can_be_sought(simulator):
    X, _, groups = measured(NOMINAL, 4, rows=40)
    names = ["lag[elbow]", "payload[lower]", "damping[elbow]"]
    diagnosis = SimulationDiagnosis(simulator, effects=names)
    assert set(diagnosis.preflight(X, groups).index) == set(names)
