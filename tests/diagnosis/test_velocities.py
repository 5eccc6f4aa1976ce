"""Velocities that were computed from positions are told from measured ones."""

import numpy as np
import pytest
from scipy import signal

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.log import check_log
from skat.diagnosis.velocities import computed_velocities, is_computed, motions, noise_variance
from skat.simulators import FunctionSimulator, MujocoSimulator

DT = 0.01


def motion(rng, n=400):
    times = np.arange(n) * DT
    phases = rng.uniform(0, 6, 4)
    rates = rng.uniform(1, 15, 4)
    return np.sin(rates * times[:, None] + phases).sum(axis=1), (
        rates * np.cos(rates * times[:, None] + phases)
    ).sum(axis=1)


def causal(read):
    return signal.lfilter(*signal.butter(2, 0.1), np.diff(read, prepend=read[:1]) / DT)


def zero_phase(read):
    return signal.filtfilt(*signal.butter(2, 0.3), np.gradient(read, DT))


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("noise", [1e-4, 1e-2], ids=["little noise", "much noise"])
def test_a_measured_velocity_is_no_computed_one(seed, noise):
    rng = np.random.default_rng(seed)
    angle, rate = motion(rng)
    read = angle + noise * rng.normal(size=len(angle))
    # A sensor may be better than any difference of positions.
    for error in (1e-3, 0.5):
        assert not is_computed(read, rate + error * rng.normal(size=len(rate)), np.zeros(len(rate)))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(
    "made", [lambda read: np.gradient(read, DT), causal, zero_phase], ids=["central", "causal", "zero"]
)
def test_a_computed_velocity_is_found(seed, made):
    rng = np.random.default_rng(seed)
    angle, _ = motion(rng)
    for read in (angle + 1e-3 * rng.normal(size=len(angle)), np.round(angle / 4e-4) * 4e-4):
        assert is_computed(read, made(read), np.zeros(len(read)))


def test_lost_samples_and_several_episodes_change_nothing():
    rng = np.random.default_rng(0)
    pieces = [motion(rng, 150)[0] + 1e-3 * rng.normal(size=150) for _ in range(4)]
    read, made = np.concatenate(pieces), np.concatenate([np.gradient(piece, DT) for piece in pieces])
    lost = rng.random(600) < 0.02
    read[lost] = made[lost] = np.nan
    assert is_computed(read, made, np.repeat(np.arange(4), 150))


def test_few_rows_leave_it_open():
    angle, _ = motion(np.random.default_rng(0))
    assert not is_computed(angle[:30], np.gradient(angle[:30], DT), np.zeros(30))


def test_four_rows_for_each_regressor_are_asked_for():
    """Nine positions and four velocities: 52 windows, of eight rows more than there are windows."""
    angle, _ = motion(np.random.default_rng(0))
    read = angle[:60] + 1e-3 * np.random.default_rng(1).normal(size=60)
    assert is_computed(read, np.gradient(read, DT), np.zeros(60))
    assert not is_computed(read[:59], np.gradient(read[:59], DT), np.zeros(59))


def test_of_several_short_episodes_there_are_rows_enough_together():
    rng = np.random.default_rng(0)
    pieces = [motion(rng, 20)[0] + 1e-3 * rng.normal(size=20) for _ in range(9)]
    made = [np.gradient(piece, DT) for piece in pieces]
    assert is_computed(np.concatenate(pieces), np.concatenate(made), np.repeat(np.arange(9), 20))
    # An episode of no more rows than neighbours has no window.
    short = [piece[:9] for piece in pieces]
    assert not is_computed(
        np.concatenate(short), np.concatenate([one[:9] for one in made]), np.repeat(np.arange(9), 9)
    )


def test_a_velocity_that_other_readings_tell_as_well_is_no_computed_one():
    """Where motion is rough differences do not tell it from noise: a second encoder on the joint does."""
    rng = np.random.default_rng(0)
    rough = np.cumsum(rng.normal(size=600))
    read, other = (rough + 1e-3 * rng.normal(size=600) for _ in range(2))
    rate = np.gradient(rough, DT) + 1e-3 * rng.normal(size=600)
    assert is_computed(read, rate, np.zeros(600))
    assert not is_computed(read, rate, np.zeros(600), other[:, None])
    assert is_computed(read, np.gradient(read, DT), np.zeros(600), other[:, None])
    # What lacks somewhere tells nothing, and nothing else changes nothing.
    other[::5] = np.nan
    assert is_computed(read, rate, np.zeros(600), other[:, None])
    assert is_computed(read, rate, np.zeros(600), np.zeros((600, 0)))


# -- noise -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [1e-3, 2.0])
def test_the_variance_of_white_noise_on_slow_motion_is_told_to_a_third(sigma):
    """A quarter of pieces of ten rows has less than the mean: somewhat too little, never too much."""
    rng = np.random.default_rng(0)
    series = 3 * np.sin(0.01 * np.arange(4000)) + sigma * rng.normal(size=4000)
    variance = noise_variance(series, np.zeros(4000))
    assert 0.3 * sigma**2 < variance < sigma**2


def test_noise_is_what_the_quieter_quarter_of_the_pieces_has():
    """Of constant squares of sixth differences: (1, -1, 1, ...) has 64, over their 924 of unit noise."""
    ones = (-1.0) ** np.arange(406)
    assert noise_variance(ones, np.zeros(406)) == pytest.approx(64**2 / 924)
    hit = np.where(np.arange(406) < 270, 100.0, 1.0) * ones
    assert noise_variance(hit, np.zeros(406)) == pytest.approx(64**2 / 924)
    hit = np.where(np.arange(406) < 330, 100.0, 1.0) * ones
    assert noise_variance(hit, np.zeros(406)) > 64**2 / 924


def test_differences_are_taken_within_episodes_and_of_rows_that_were_measured():
    ones = (-1.0) ** np.arange(60)
    apart = np.r_[ones, 1e6 + ones]
    assert noise_variance(apart, np.repeat([0, 1], 60)) == pytest.approx(64**2 / 924, rel=1e-6)
    ones[::8] = np.nan
    assert noise_variance(ones, np.zeros(60)) == pytest.approx(64**2 / 924)
    assert noise_variance(ones[:7], np.zeros(7)) == 0.0
    assert noise_variance((-1.0) ** np.arange(7), np.zeros(7)) == pytest.approx(64**2 / 924)
    assert noise_variance(np.ones(6), np.zeros(6)) == 0.0


# -- channels --------------------------------------------------------------------------------------------------------


def of_units(units, names=("x", "y", "v", "w")):
    return FunctionSimulator(
        lambda X: X, input_names=names, output_names=names, state_names=names, units=units, dt=DT
    )


@pytest.mark.parametrize(
    ("units", "pairs"),
    [
        ({"x": "m", "v": "m/s"}, (("x", "v"),)),
        ({"x": "m", "y": "rad", "v": "rad/s", "w": "m/s"}, (("x", "w"), ("y", "v"))),
        ({"x": "m", "y": "m", "v": "m/s"}, ()),  # which of the two?
        ({"x": "m", "v": "m/s", "w": "m/s"}, ()),
        ({"x": "m", "v": "rad/s"}, ()),
        ({"v": "m/s"}, ()),
        ({}, ()),
    ],
)
def test_a_position_has_the_one_rate_of_its_unit(units, pairs):
    assert motions(of_units(units)) == pairs


def test_mujoco_s_positions_have_the_velocities_of_their_joints_but_for_orientations():
    model = """<mujoco><worldbody><body><freejoint name="base"/><geom size=".1"/>
    <body><joint name="arm"/><geom size=".1"/></body></body></worldbody></mujoco>"""
    names = [*(f"base.{axis}" for axis in "xyz"), "arm"]
    found = motions(MujocoSimulator(model))
    assert [position for position, _ in found] == [f"qpos.{name}" for name in names]
    assert all(velocity.startswith("qvel.") for _, velocity in found)


def test_velocities_of_a_log_that_were_computed_are_named():
    units = {"x": "m", "y": "rad", "v": "m/s", "w": "rad/s"}
    rng = np.random.default_rng(0)
    tables, groups = [], []
    for episode in range(2):
        place, _ = motion(rng, 151)
        angle, rate = motion(rng, 151)
        place, angle = (one + 1e-3 * rng.normal(size=151) for one in (place, angle))
        states = np.column_stack([place, angle, np.gradient(place, DT), rate + 1e-3 * rng.normal(size=151)])
        tables.append((states[:-1], states[1:]))
        groups += [episode] * 150
    X, y = (np.concatenate(one) for one in zip(*tables))
    assert computed_velocities(of_units(units), X, y, np.array(groups)) == ("v",)
    X[:, 3], y[:, 3] = X[:, 2], y[:, 2]
    assert computed_velocities(of_units(units), X, y, np.array(groups)) == ("v",)


def test_velocities_of_any_name_are_left_out_where_they_were_computed():
    rng, units = np.random.default_rng(0), {"x": "m", "y": "rad", "v": "m/s", "w": "rad/s"}
    simulator = of_units(units)
    place, angle, rate = (
        *(one + 1e-3 * rng.normal(size=301) for one in (motion(rng, 301)[0], *motion(rng, 301))),
    )
    states = np.column_stack([place, angle, np.gradient(place, DT), rate])
    log = check_log(simulator, states[:-1], states[1:], np.zeros(300))
    with pytest.warns(UserWarning, match="^v were computed from the positions"):
        less = SimulationDiagnosis(simulator)._without_computed(log)
    np.testing.assert_array_equal(less.measured, [True, True, False, True])
    less = SimulationDiagnosis(simulator, velocities="computed")._without_computed(log)
    np.testing.assert_array_equal(less.measured, [True, True, False, False])
    independent = check_log(simulator, states[:-1:2], states[1::2], None)
    with pytest.raises(ValueError, match=r"positions in time order: pass groups="):
        SimulationDiagnosis(simulator, velocities="computed")._without_computed(independent)
    assert SimulationDiagnosis(simulator)._without_computed(independent) is independent


def test_velocities_that_are_not_known_as_such_cannot_be_left_out():
    states = np.random.default_rng(0).normal(size=(11, 4))
    simulator = of_units({})
    log = check_log(simulator, states[:-1], states[1:], np.zeros(10))
    with pytest.raises(ValueError, match=r"no velocity among x, y, v, w: .* in hidden="):
        SimulationDiagnosis(simulator, velocities="computed")._without_computed(log)
    for velocities in ("auto", "measured"):
        assert SimulationDiagnosis(simulator, velocities=velocities)._without_computed(log) is log


def test_differences_are_told_from_sensors_that_rest_for_half_of_the_log():
    """An encoder at rest repeats itself, and its noise is seen where it moves alone."""
    rng, n = np.random.default_rng(0), 400
    motion = np.cumsum(0.02 * np.sin(0.05 * np.arange(n)) + 0.01 * np.sin(0.19 * np.arange(n)))
    angle = np.r_[np.zeros(n), motion]
    step = 2 * np.pi / 16384
    read = step * np.round(angle / step)
    differences = np.r_[0.0, np.diff(read)] / 0.01
    assert is_computed(read, differences, np.zeros(2 * n))
    rate = np.gradient(angle, 0.01)
    gyroscope = np.where(np.arange(2 * n) < n, 0.0, rate + 0.02 * rng.normal(size=2 * n))
    assert not is_computed(read, gyroscope, np.zeros(2 * n))


def test_the_noise_of_a_sensor_is_that_of_where_it_moves():
    noisy = 0.1 * np.random.default_rng(1).normal(size=400)
    rested = np.r_[np.zeros(300), noisy]
    own = noise_variance(noisy, np.zeros(400))
    assert noise_variance(rested, np.zeros(700)) == pytest.approx(own, rel=0.3)
    assert noise_variance(np.zeros(100), np.zeros(100)) == 0.0
