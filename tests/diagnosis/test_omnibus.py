"""What no effect explains is found: a law of a joint in its own coordinates, and what outlasts single rows."""

import numpy as np

from skat.diagnosis.log import Log
from skat.diagnosis.omnibus import TIME, _persistence, find_remainder
from skat.diagnosis.residuals import Linearisation


class Rows:
    """As much of residuals as the test of persistence needs: episodes and names."""

    log = Log(np.zeros((1000, 1)), np.zeros((1000, 1)), np.repeat(np.arange(20), 50), True)

    class simulator:
        residual_names = ("a", "b")


def test_persistence_is_uniform_for_noise_with_heavy_tails():
    p_values = [
        p
        for seed in range(200)
        for _, _, p in _persistence(Rows, np.random.default_rng(seed).standard_t(4, (1000, 2)))
    ]
    # A standard deviation of the share is 0.011 at 5 %.
    assert 0.02 < np.mean(np.array(p_values) < 0.05) < 0.09
    assert np.mean(np.array(p_values) < 0.001) < 0.01


def test_periodic_remainder_is_found_in_its_channel():
    white = np.random.default_rng(0).normal(size=(1000, 2))
    white[:, 1] += np.sin(np.arange(1000) / 3)
    (_, _, quiet), (name, what, loud) = _persistence(Rows, white)
    assert (name, what) == ("b", TIME)
    assert loud < 1e-4 < quiet


def test_one_contact_whose_linearisation_failed_does_not_count_as_lasting():
    white = np.random.default_rng(0).normal(size=(1000, 2))
    white[200:230, 1] += 5.0
    assert all(p > 0.05 for _, _, p in _persistence(Rows, white))


class Joints(Rows):
    """White residuals of ten joints, as the test of a remainder needs them."""

    joints = [f"j{k}" for k in range(10)]
    blocks = np.arange(1000)

    def __init__(self, seed, input_names):
        self.points = np.random.default_rng(seed).normal(size=(1000, 10))
        self.simulator = type(
            "simulator",
            (),
            {"residual_names": [f"qvel.{joint}" for joint in self.joints], "input_names": input_names},
        )

    def directions(self, values):
        names = self.simulator.residual_names
        return np.broadcast_to(np.eye(10), (1000, 10, 10)), tuple((name, (name,)) for name in names)

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


def test_remainder_of_noise_keeps_to_its_level():
    p_values = np.array([remainder_of(seed, 0.0, OWN).p_value for seed in range(60)])
    # At the level, nine of sixty or more are below 5 % in 0.3 % of runs.
    assert np.sum(p_values < 0.05) < 9
    assert 0.3 < np.mean(p_values) < 0.75
