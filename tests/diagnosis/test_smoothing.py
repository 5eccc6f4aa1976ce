"""Positions that were smoothed forward and backward: SciPy filters them, by no code of ours."""

import warnings
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import ndimage, signal

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.log import check_log
from skat.diagnosis.smoothing import SMOOTHED, Smoothing, smoothed_positions, smoothing_of
from skat.simulators import FunctionSimulator, MujocoSimulator

DT = 0.05
NAMES = ("x", "v")


def gliding():
    return FunctionSimulator(
        lambda X: np.c_[X[:, 0] + DT * X[:, 1], X[:, 1] + DT * X[:, 2]],
        input_names=(*NAMES, "a"),
        output_names=NAMES,
        state_names=NAMES,
        units={"x": "m", "v": "m/s"},
        dt=DT,
    )


def log_of(place, n_episodes=1):
    """Return a log of positions alone, of episodes of equal length one behind the other."""
    X, y = [], []
    for part in np.split(place, n_episodes):
        states = np.c_[part, np.full(len(part), np.nan)]
        X.append(np.c_[states[:-1], np.zeros(len(part) - 1)])
        y.append(states[1:])
    groups = np.repeat(np.arange(n_episodes), len(y[0]))
    return check_log(gliding(), np.concatenate(X), np.concatenate(y), groups)


def filtered(order, cutoff):
    return partial(signal.sosfiltfilt, signal.butter(order, cutoff, output="sos"))


def motion(n):
    time = DT * np.arange(n)
    return np.sin(0.7 * time) + 0.5 * np.sin(1.7 * time + 1) + 0.1 * np.sin(4 * time)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("cutoff", [0.1, 0.2, 0.45])
def test_what_was_read_comes_back_at_every_second_instant(order, cutoff):
    smooth = filtered(order, cutoff)(motion(600))
    read = Smoothing(order, cutoff, ("x",)).undone(gliding(), log_of(smooth)).y[:, 0]
    inner = slice(60, -60)  # the ends are as SciPy goes on beyond them
    kept = np.isfinite(read[inner])
    assert abs(kept.mean() - 0.5) < 0.01
    assert_allclose(read[inner][kept], motion(600)[1:][inner][kept], atol=2e-6)
    if cutoff == 0.1:
        assert np.abs(smooth - motion(600))[inner].max() > 2e-3


@pytest.mark.parametrize(("order", "cutoff"), [(1, 0.3), (2, 0.2), (4, 0.3)])
def test_noise_that_comes_back_is_white(order, cutoff):
    noise = np.random.default_rng(0).normal(size=3_000)
    read = Smoothing(order, cutoff, ("x",)).undone(gliding(), log_of(filtered(order, cutoff)(noise))).y[:, 0]
    read = read[60:-60][np.isfinite(read[60:-60])]
    along = [float(np.corrcoef(read[lag:], read[:-lag])[0, 1]) for lag in range(1, 6)]
    assert np.abs(along).max() < 4 / np.sqrt(len(read))
    assert_allclose(read.var(), 0.5, rtol=0.15)


def test_nothing_is_known_where_episodes_begin_and_end():
    smoothing = Smoothing(2, 0.2, ("x",))
    log = log_of(filtered(2, 0.2)(motion(300)), n_episodes=3)
    read = smoothing.undone(gliding(), log)
    for episode in range(3):
        own = read.episodes == episode
        states = np.r_[read.X[own, 0], read.y[own, 0][-1:]]
        seen = np.flatnonzero(np.isfinite(states))
        assert seen[0] == smoothing.reach
        assert seen[-1] in (len(states) - smoothing.reach - 1, len(states) - smoothing.reach - 2)
        assert set(np.diff(seen)) == {2}
        np.testing.assert_array_equal(read.X[own, 0][1:], read.y[own, 0][:-1])
    short = smoothing.undone(gliding(), log_of(motion(2 * smoothing.reach)))
    assert not np.isfinite(short.y).any()


@pytest.mark.parametrize(("order", "cutoff"), [(1, 0.2), (2, 0.2), (3, 0.4), (4, 0.5)])
def test_the_order_shows_in_how_noise_falls_off(order, cutoff):
    noise = 1e-3 * np.random.default_rng(1).normal(size=1200)
    ((name, _, told),) = smoothed_positions(gliding(), log_of(filtered(order, cutoff)(motion(1200) + noise)))
    assert name == "x"
    assert abs(told - order) < 0.3


def likelihood_about(path):
    """Return the log likelihood of readings as white noise of unknown size about a path that is known."""

    def likelihood(log, *, values):
        n = len(path) // log.n_episodes
        steps = log.steps + 1
        left = log.y[:, 0] - path.reshape(-1, n)[log.episodes, steps]
        left = left[np.isfinite(left)]
        return -0.5 * len(left) * (np.log(2 * np.pi * np.mean(left**2)) + 1)

    return likelihood


def nothing(*_):
    return {}


@pytest.mark.parametrize(("order", "cutoff"), [(2, 0.15), (2, 0.3), (4, 0.2)])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_likelihood_tells_the_cutoff(order, cutoff, seed):
    path = motion(400)
    place = filtered(order, cutoff)(path + 1e-3 * np.random.default_rng(seed).normal(size=400))
    found = smoothing_of(gliding(), log_of(place), likelihood_about(path), nothing, nothing)
    assert found.channels == ("x",)
    assert found.order == order
    # Of some two hundred instants; where there is motion beside noise it tells more.
    assert abs(np.log(found.cutoff / cutoff)) < 0.15


@pytest.mark.parametrize("width", [1.7, 2.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_smooth_log_that_no_filter_made_is_left_as_it_is(width, seed):
    # What the simulation says without noise, though it looks smoothed.
    path = ndimage.gaussian_filter1d(motion(400) + 1e-3 * np.random.default_rng(seed).normal(size=400), width)
    ((_, size, _),) = smoothed_positions(gliding(), log_of(path))
    assert size > SMOOTHED
    assert smoothing_of(gliding(), log_of(path), likelihood_about(path), nothing, nothing) is None


def test_positions_beside_measured_velocities_are_left_as_they_are():
    path = motion(400)
    place = filtered(2, 0.2)(path + 1e-3 * np.random.default_rng(0).normal(size=400))
    states = np.c_[place, np.random.default_rng(1).normal(size=400)]
    log = check_log(gliding(), np.c_[states[:-1], np.zeros(399)], states[1:], np.zeros(399))
    assert smoothing_of(gliding(), log, likelihood_about(path), nothing, nothing) is None


CART = """
<mujoco><option timestep=".01" gravity="0 0 0" integrator="RK4"/><worldbody><body>
<joint name="slide" type="slide" axis="1 0 0" damping="{damping}"/><geom size=".1" mass="1"/></body></worldbody>
<actuator><motor name="push" joint="slide"/></actuator></mujoco>
"""


def pushed_cart(damping, smooth, seed=0, n=70):
    """Return a log of a cart that a motor pushes, integrated in closed form; positions are read with noise."""
    rng = np.random.default_rng(seed)
    time = 0.01 * np.arange(n)
    push = np.sum(
        [np.sin(2 * np.pi * rate * time + rng.uniform(0, 6)) for rate in (0.4, 1.1, 2.3, 5.1)], axis=0
    )
    push = 4 * push + 2 * np.repeat(rng.normal(size=n // 5), 5)
    states = np.zeros((n + 1, 2))
    decay = np.exp(-damping * 0.01)
    for row in range(n):
        place, speed = states[row]
        far = push[row] / damping
        gone = (speed - far) * (1 - decay) / damping
        states[row + 1] = place + far * 0.01 + gone, far + (speed - far) * decay
    place = smooth(states[:, 0] + 1e-4 * rng.normal(size=n + 1))
    read = np.c_[place, np.gradient(place, 0.01)]
    return np.c_[read[:-1], push], read[1:], np.zeros(n)


def pushed_twice(seed):
    """Return a log of two episodes, positions filtered: what goes row by row takes no longer for two than for one."""
    (X, y, _), (other_X, other_y, _) = (
        pushed_cart(0.6, filtered(2, 0.2), seed + episode) for episode in range(2)
    )
    return np.r_[X, other_X], np.r_[y, other_y], np.repeat([0, 1], len(y))


def test_a_cause_is_right_behind_such_a_filter(tmp_path):
    log = pushed_twice(0)
    simulator = MujocoSimulator(CART.format(damping=0.3))
    effects = ["damping[slide]", "gain[push]", "delay[action]", "scale[qpos.slide]"]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = SimulationDiagnosis(simulator, effects=effects, random_state=0).fit(*log)
    assert [cause.name for cause in found.causes_] == ["damping[slide]"]
    low, high = found.causes_[0].interval
    assert low <= 0.3 <= high
    assert found.smoothing_.channels == ("qpos.slide",)
    assert found.smoothing_.order == 2
    assert abs(np.log(found.smoothing_.cutoff / 0.2)) < 0.05
    assert any("cutoff of" in str(one.message) and "undone" in str(one.message) for one in caught)
    assert found.evaluate(*pushed_twice(2)).explained > 0.9
    short = [part[:12] for part in log]
    with pytest.raises(ValueError, match="more than 20 rows"):
        found.evaluate(*short)
    assert "Butterworth filter of order 2" in found.report_.html(figures=False)
    path = found.save(tmp_path / "cart.skat")
    assert SimulationDiagnosis.load(path).smoothing_ == found.smoothing_
