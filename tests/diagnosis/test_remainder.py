"""What is left of a log: what predicts it, how large it is, and what it looks like."""

import functools

import numpy as np
import pytest

from skat.diagnosis.causes import find_causes
from skat.diagnosis.findings import Gain
from skat.diagnosis.fitting import first_fit
from skat.diagnosis.remainder import find_remainder, is_unexplained
from skat.diagnosis.statespace import state_space
from skat.simulators import FunctionSimulator, MujocoSimulator
from tests.diagnosis.cart_pole import make_simulator, measure
from tests.diagnosis.pendulum import FRAME_SKIP, NOMINAL, TEXT, laid_out, measured


@pytest.fixture(scope="module")
def simulator():
    return MujocoSimulator(NOMINAL, frame_skip=FRAME_SKIP)


def left(simulator, law, seed=3, **options):
    space = laid_out(simulator, *measured(NOMINAL, seed, law=law, **options))
    fitted = first_fit(space, {})
    return find_remainder(space, fitted, random_state=np.random.RandomState(0))


def drag(q, v, time, rng):
    return -0.03 * abs(v) * v


@functools.cache
def left_of_drag():
    return left(MujocoSimulator(NOMINAL, frame_skip=FRAME_SKIP), drag, rows=125, episodes=6)


def test_quadratic_friction_is_found_predictable_from_velocity():
    """3 % of the square of a speed of 5 rad/s: its size, and its law in every bin."""
    remainder = left_of_drag()
    (part,) = remainder.parts
    assert part.regressor == "|qvel.hinge|qvel.hinge"
    assert part.law.coordinate == "qvel.hinge"
    assert (part.name, part.unit) == ("hinge", "N m")
    v = measured(NOMINAL, 3, law=drag, rows=125, episodes=6)[0][:, 1]
    assert part.predictable == pytest.approx(np.sqrt(np.mean((0.03 * v**2) ** 2)), rel=0.15)
    middle = (part.law.edges[1:] + part.law.edges[:-1]) / 2
    true = -0.03 * np.abs(middle) * middle
    assert np.corrcoef(part.law.mean, true)[0, 1] > 0.95
    assert is_unexplained(remainder, None)


def test_a_magnet_is_found_predictable_from_position_and_drawn_where_it_is(simulator):
    def magnet(q, v, time, rng):
        return 0.4 * np.exp(-0.5 * ((np.sin(q - 0.4)) / 0.2) ** 2)

    remainder = left(simulator, magnet, rows=125, episodes=6)
    (part,) = remainder.parts
    assert part.regressor == "qpos.hinge"
    strongest = int(np.argmax(part.law.mean))
    low, high = part.law.edges[strongest : strongest + 2]
    away = np.abs(np.sin(np.array([low, (low + high) / 2, high]) - 0.4)).min()
    assert away < 0.3
    assert part.law.low[strongest] > 0
    assert is_unexplained(remainder, None)


def test_a_dead_band_of_the_motor_is_found_predictable_from_its_command(simulator):
    X, y, groups = measured(NOMINAL, 4)

    def law(q, v, time, rng):  # what a dead band of .5 N m takes from the command
        phases = law.phases
        command = 1.2 * np.sin(np.array([2.0, 5.0, 9.0]) * time + phases).sum()
        return -np.clip(command, -0.5, 0.5)

    rng = np.random.default_rng(4)
    rng.uniform(-1, 1), rng.normal()
    law.phases = rng.uniform(0, 6, 3)
    (part,) = left(simulator, law, seed=4, episodes=1, rows=500).parts
    assert "ctrl.motor" in part.regressor
    assert part.evidence > np.log(100)
    assert len(X) == len(y) == len(groups)


def test_a_cable_that_pulls_back_and_gives_way_is_found_predictable_from_where_the_joint_came(simulator):
    came = [0.0]

    def cable(q, v, time, rng):
        came[0] = 0.01 * v + (1 - 0.01 * abs(v) / 0.3) * came[0] if time else 0.0
        return -2 * came[0]

    (part,) = left(simulator, cable).parts
    assert part.regressor.startswith("the way of qpos.hinge")
    assert part.evidence > np.log(100)


@pytest.mark.parametrize("lacking", [0.0, 0.1])
def test_a_cause_is_named_for_what_it_does_beside_a_law_that_is_no_effect(simulator, lacking):
    """Drag that grows with the square of speed is not named a damping; a damping that lacks beside it is."""
    X, y, groups = measured(
        TEXT.format(damping=0.05 + lacking), 3, law=lambda q, v, time, rng: -0.02 * abs(v) * v
    )
    effects = [one for one in simulator.effects() if one.name in ("damping[hinge]", "stiffness[hinge]")]
    found = find_causes(laid_out(simulator, X, y, groups), effects)
    assert list(found.values) == (["damping[hinge]"] if lacking else [])
    assert found.settled


def test_a_white_force_makes_no_verdict_and_is_called_so(simulator):
    remainder = left(simulator, lambda q, v, time, rng: 0.3 * rng.normal())
    (part,) = remainder.parts
    assert part.word == "white"
    assert part.rms == pytest.approx(0.3, rel=0.15)
    assert part.share < 0.05
    assert not is_unexplained(remainder, None)
    level = np.median(part.spectrum[2:-2])
    assert level == pytest.approx(0.3**2 * 2 * 0.01, rel=0.3)  # a white force held for a row of 10 ms


def test_a_vibration_is_named_with_its_frequency_and_predicted_by_its_own_past(simulator):
    remainder = left(simulator, lambda q, v, time, rng: 0.3 * np.sin(2 * np.pi * 8 * time))
    (part,) = remainder.parts
    assert part.word.startswith("vibration at ")
    assert float(part.word.split()[2]) == pytest.approx(8, abs=0.4)  # of 128 rows: bins of .8 Hz
    assert part.regressor == part.law.coordinate == "its own past"
    assert part.predictable == pytest.approx(0.3 / np.sqrt(2), rel=0.1)
    assert is_unexplained(remainder, None)


def test_a_resonance_that_has_lost_its_phase_at_the_horizon_makes_no_verdict(simulator):
    """A random force at 8 Hz whose phase lasts for 50 ms, of a horizon of a quarter of a second."""
    turned, kept = np.exp(2j * np.pi * 8 * 0.01), np.exp(-0.01 / 0.05)
    state = np.zeros(1, dtype=complex)

    def resonance(q, v, time, rng):
        fresh = rng.normal(size=2) @ np.array([1, 1j]) * np.sqrt((1 - kept**2) / 2)
        state[0] = kept * turned * state[0] + fresh
        return 0.3 * state[0].real

    remainder = left(simulator, resonance)
    assert remainder.parts[0].rms == pytest.approx(0.3 / np.sqrt(2), rel=0.25)
    assert not is_unexplained(remainder, None)


def test_few_large_pushes_are_impacts(simulator):
    remainder = left(simulator, lambda q, v, time, rng: 4 * rng.normal() * (rng.random() < 0.01))
    assert remainder.parts[0].word == "impacts"
    assert not is_unexplained(remainder, None)


def test_where_nothing_is_left_no_law_is_found(simulator):
    remainder = left(simulator, None)
    assert remainder.parts[0].word == "none"
    assert remainder.evidence < 0
    assert not is_unexplained(remainder, None)


@pytest.mark.long
def test_chance_is_taken_for_a_law_in_one_log_of_a_hundred_at_most(simulator):
    found = [
        left(simulator, lambda q, v, time, rng: 0.1 * rng.normal(), seed=seed, rows=100, episodes=2).evidence
        for seed in range(60)
    ]
    assert np.sum(np.array(found) > np.log(100)) <= 2
    assert np.mean(np.exp(found)) < 1.5


@pytest.mark.parametrize("magnet", [0.0, 4.0])
def test_a_function_with_a_state_has_an_error_of_each_channel(magnet):
    simulator = make_simulator()
    X, y, groups, _ = measure(5, magnet=magnet)
    space = state_space(simulator, X, y, groups, consecutive=True)
    remainder = find_remainder(space, first_fit(space, {}), random_state=np.random.RandomState(0))
    assert {part.name for part in remainder.parts} == {"x", "angle", "v", "w"}
    assert is_unexplained(remainder, None) == bool(magnet)
    if magnet:
        assert remainder.parts[0].regressor == "x"
        assert remainder.parts[0].unit == "m/s per row"


@pytest.mark.parametrize("bent", [0.0, 0.3])
def test_what_is_left_of_a_function_without_a_state_is_its_errors(bent):
    simulator = FunctionSimulator(
        lambda X: 2 * X[:, :1] + X[:, 1:], input_names=("a", "b"), output_names=("y",)
    )
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, size=(300, 2))
    y = (2 * X[:, :1] + X[:, 1:]) + bent * X[:, 1:] ** 2 + 0.1 * rng.normal(size=(300, 1))
    space = state_space(simulator, X, y, np.arange(300), consecutive=False)
    remainder = find_remainder(space, first_fit(space, {}), random_state=np.random.RandomState(0))
    (part,) = remainder.parts
    assert is_unexplained(remainder, None) == bool(bent)
    if bent:
        assert part.regressor == "b"
        assert part.predictable == pytest.approx(bent * np.sqrt(np.mean(X[:, 1] ** 4)), rel=0.2)


def test_what_causes_explain_beside_a_law_decides_whether_it_is_much():
    remainder = left_of_drag()
    ahead = remainder.parts[0].ahead

    def gain(nominal):
        return Gain(nominal, ahead, 1.0, 1.0, (1.0, 1.0), 0.25)

    assert is_unexplained(remainder, gain(2 * ahead))
    assert not is_unexplained(remainder, gain(20 * ahead))


SERVO = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body><joint name="hinge" axis="0 1 0" damping=".05"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass=".8"/></body>
  </worldbody>
  <actuator><position joint="hinge" name="servo" kp="20" kv="1" {filter}/></actuator>
</mujoco>"""


def test_what_acts_on_a_joint_is_what_its_servo_exerts_with_a_filter_or_without():
    scales = []
    for filtered in ("", 'timeconst=".02"'):
        simulator = MujocoSimulator(SERVO.format(filter=filtered), frame_skip=FRAME_SKIP)
        commands = 1 + 0.3 * np.sin(0.02 * np.arange(300))[:, None]
        states = simulator.rollout([[1.0, 0.0]], commands[None], n_steps=300)[0]
        exerted, _ = simulator.exerted(np.column_stack([states[:-1], commands]), np.zeros(300, dtype=int))
        scales.append(np.sqrt(np.mean(exerted**2)))
    assert scales[1] == pytest.approx(scales[0], rel=0.1)
    weak = MujocoSimulator(NOMINAL, frame_skip=FRAME_SKIP).extended({"gain[motor]": 0.25})
    rows = np.array([[0.1, 0.2, 2.0]])
    assert weak.exerted(rows, np.zeros(1, dtype=int))[0].item() == pytest.approx(0.5)
