"""A log in chains, its slopes and means over what is not known, and its noise, against closed forms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import optimize, stats

from skat.diagnosis import slopes as module_of_slopes
from skat.diagnosis import statespace
from skat.diagnosis.chains import Chains
from skat.diagnosis.filtering import student_log_density
from skat.diagnosis.noise import _best_scales, _scales, estimate_noise, normal_noise
from skat.diagnosis.slopes import derivatives
from skat.diagnosis.statespace import (
    Forces,
    _carrier,
    about_forces,
    guessed,
    in_chains,
    linearise,
    state_space,
    tangent_mask,
)
from skat.effects import Effect
from skat.simulators import FunctionSimulator, MujocoSimulator

DT = 0.1
EFFECTS = (
    Effect("gain", unit="1", neutral=1.0, bounds=(0.1, 5.0), typical=0.2),
    Effect("bend", unit="1", neutral=0.0, bounds=(-2.0, 2.0), typical=0.2),
)


def of_states(step, n=2, effects=(), dt=DT, names=None):
    names = names or tuple("pqrs"[:n])
    return FunctionSimulator(
        step, input_names=(*names, "u"), output_names=names, state_names=names, effects=effects, dt=dt
    )


def drifting(X, gain=1.0, bend=0.0):
    return np.c_[X[:, 0] + 0.1 * X[:, 1], 0.9 * X[:, 1] + gain * X[:, 2] + bend**3 + bend]


def logged(lengths, seed=0):
    rng, X, y = np.random.default_rng(seed), [], []
    for length in lengths:
        path, u = rng.normal(size=(length + 1, 2)), rng.normal(size=(length, 1))
        X.append(np.c_[path[:-1], u])
        y.append(path[1:])
    return np.concatenate(X), np.concatenate(y), np.repeat(np.arange(len(lengths)), lengths)


# -- chains ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("chain_length", [4, 5, 64])
def test_chains_are_pieces_of_episodes_about_as_long_as_each_other(chain_length):
    lengths = [10, 1, 4, 13, 5]
    X, y, groups = logged(lengths)
    (chain, step), states = in_chains(
        of_states(drifting), X, y, groups, consecutive=True, chain_length=chain_length
    )
    sizes = np.bincount(chain)
    assert sizes.max() <= chain_length
    assert len(sizes) == sum(-(-length // chain_length) for length in lengths)
    np.testing.assert_array_equal(states[chain, step], X[:, :2])
    np.testing.assert_array_equal(states[chain, step + 1], y)
    assert np.isfinite(states).all(axis=2).sum() == len(X) + len(sizes)
    for episode in range(len(lengths)):
        own = chain[groups == episode]
        assert (np.diff(own) >= 0).all()
        assert len(set(np.bincount(own - own[0])[:-1])) <= 1
    np.testing.assert_array_equal(step == 0, np.r_[True, np.diff(chain) > 0])


def test_a_state_at_which_an_episode_was_cut_counts_once():
    lengths = [10, 4, 13]
    X, y, groups = logged(lengths)
    for chain_length in (4, 64):
        space = state_space(of_states(drifting), X, y, groups, consecutive=True, chain_length=chain_length)
        assert space.mask.sum() == 2 * (sum(lengths) + len(lengths))
        assert space.real.sum() == sum(lengths)
        np.testing.assert_array_equal(space.padded(X)[space.places], X)
        assert (space.padded(np.ones(len(X)))[~space.real] == 0).all()
    apart = state_space(of_states(drifting), X, y, np.arange(27), consecutive=False)
    assert apart.real.shape == (27, 1)
    assert apart.mask.all()


def test_a_channel_that_rests_is_known_to_a_millionth_of_the_widest_at_worst():
    X, y, groups = logged([30])
    X[:, 1], y[:, 1] = 2.0, 2.0
    space = state_space(of_states(drifting), X, y, groups, consecutive=True)
    states = np.r_[X[:1, 0], y[:, 0]]
    assert space.spread[0] == pytest.approx(3 * states.std())
    assert space.spread[1] == pytest.approx(1e-6 * space.spread[0])


def test_in_chains_of_one_row_a_measurement_ends_one_and_begins_the_next():
    X, y, groups = logged([10, 4])
    space = state_space(of_states(drifting), X, y, groups, consecutive=True, chain_length=1)
    assert space.mask.shape[:2] == (14, 2)
    assert space.mask.all()
    np.testing.assert_array_equal(space.measured[:, 0], X[:, :2])
    np.testing.assert_array_equal(space.measured[:, 1], y)
    assert space.groups.tolist() == groups.tolist()


def test_what_was_not_measured_is_guessed_in_time_from_positions_or_from_the_rest_of_the_log():
    names = ("qpos.a", "qvel.a", "other", "none")
    simulator = of_states(lambda X: X[:, :4], names=names)
    states = np.full((2, 5, 4), np.nan)
    states[:, :, 0] = [[0.0, 1.0, np.nan, 3.0, 4.0], [np.nan, 2.0, 2.0, 2.0, np.nan]]
    states[0, :, 2] = [1.0, 3.0, 1.0, 3.0, 2.0]
    filled = guessed(simulator, states)
    np.testing.assert_allclose(filled[..., 0], [[0, 1, 2, 3, 4], [2, 2, 2, 2, 2]])
    np.testing.assert_allclose(filled[..., 1], [[1 / DT] * 5, [0] * 5], atol=1e-12)
    np.testing.assert_allclose(filled[1, :, 2], 2.0)
    np.testing.assert_array_equal(filled[..., 3], 0.0)
    timeless = guessed(of_states(lambda X: X[:, :4], names=names, dt=None), states)
    np.testing.assert_array_equal(timeless[..., 1], 0.0)


BALL = MujocoSimulator(
    "<mujoco><worldbody><body><freejoint name='b'/><geom size='.1'/></body></worldbody></mujoco>"
)


def test_a_rotation_nobody_measured_is_that_of_the_model_and_one_of_which_a_part_lacks_is_none():
    states = np.zeros((1, 3, 13))
    states[..., 3:7] = np.nan
    np.testing.assert_array_equal(guessed(BALL, states)[..., 3:7], np.broadcast_to([1.0, 0, 0, 0], (1, 3, 4)))
    seen = np.ones((3, 13), dtype=bool)
    seen[1, 5] = seen[2, 0] = False
    mask = tangent_mask(BALL, seen)
    assert mask.shape == (3, 12)
    assert np.argwhere(~mask).tolist() == [[1, 3], [1, 4], [1, 5], [2, 0]]


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_an_acceleration_enters_as_semi_implicit_euler_carries_it(steps):
    names = ("qpos.a", "qpos.b", "qvel.a", "qvel.b")
    carrier = _carrier(SimpleNamespace(residual_names=names, dt=DT, frame_skip=steps), np.ones(4))
    place = speed = 0.0
    for _ in range(steps):
        speed += DT / steps
        place += speed * DT / steps
    np.testing.assert_allclose(carrier, np.r_[place * np.eye(2), speed * np.eye(2)], rtol=1e-12)
    unpaired = SimpleNamespace(residual_names=names[1:], dt=DT)
    np.testing.assert_array_equal(_carrier(unpaired, np.array([1.0, 2.0, 3.0])), np.diag([1.0, 2.0, 3.0]))
    timeless = SimpleNamespace(residual_names=names, dt=None)
    np.testing.assert_array_equal(_carrier(timeless, np.ones(4)), np.eye(4))


def test_a_force_on_a_joint_enters_by_its_mass():
    text = "<mujoco><option gravity='0 0 0'/><worldbody><body><joint name='rail' type='slide' axis='1 0 0'/>"
    simulator = MujocoSimulator(f"{text}<geom size='.1' mass='4'/></body></worldbody></mujoco>", frame_skip=5)
    states = simulator.rollout([[0.0, 1.0]], n_steps=20)[0]
    space = state_space(simulator, states[:-1], states[1:], np.zeros(20, int), consecutive=True)
    dt = simulator.dt
    carrier = linearise(space, space.measured, {}).chains.carrier[space.places]
    np.testing.assert_allclose(carrier[:, :, 0], np.tile([dt**2 * 6 / 10 / 4, dt / 4], (20, 1)), rtol=1e-6)


def test_a_force_on_a_joint_that_rests_against_its_friction_is_taken_to_both_sides():
    """Gravity pulls with nearly all that friction holds: a little more makes the joint slide, a little less not."""
    text = (
        "<mujoco><option gravity='{} 0 0'/><worldbody><body><joint name='rail' type='slide' axis='1 0 0' "
        "frictionloss='1'/><geom size='.1' mass='1'/></body></worldbody></mujoco>"
    )

    def moved(pull):
        simulator = MujocoSimulator(text.format(pull), frame_skip=5)
        (effect, _), *_ = simulator.joint_forces()
        step = statespace.SMALL_FORCE * effect.bounds[1]
        states = np.zeros((3, 2))
        space = state_space(simulator, states[:-1], states[1:], np.zeros(2, int), consecutive=True)
        carrier = linearise(space, space.measured, {}).chains.carrier[space.places][0, 1, 0]
        ends = [
            simulator.predict_many(states[:1], [{effect.name: sign * step}])[0, 0, 1] for sign in (-1, 0, 1)
        ]
        return carrier, np.diff(ends) / step

    carrier, sides = moved(0.999)
    assert sides[1] > 3 * sides[0]
    assert carrier == pytest.approx(sides.mean(), rel=1e-6)
    (resting, _), (sliding, _) = moved(0.9), moved(1.1)
    assert resting < carrier < sliding


RAIL = (
    "<mujoco><option gravity='{} 0 0'/><worldbody><body><joint name='rail' type='slide' axis='1 0 0' "
    "frictionloss='1'/><geom size='.1' mass='2'/></body></worldbody></mujoco>"
)


def on_a_rail(pull=0.0):
    """A slider of 2 kg at rest, with friction of 1 N, and its log of four rows."""
    simulator = MujocoSimulator(RAIL.format(pull), frame_skip=5)
    states = np.zeros((5, 2))
    return simulator, state_space(simulator, states[:-1], states[1:], np.zeros(4, int), consecutive=True)


def test_a_lasting_force_that_is_known_slides_a_joint_that_would_rest():
    simulator, space = on_a_rail()
    force = np.array([[0.0], [0.5], [2.0], [-3.0]])
    linear = linearise(space, space.measured, {}, forces=Forces(force, np.zeros((4, 1))))
    ends = [simulator.predict(np.zeros((1, 2)), effects={"force[rail]": one})[0] for (one,) in force]
    np.testing.assert_allclose(linear.outputs, ends, atol=1e-15)
    assert abs(linear.outputs[1, 1]) < 0.05 * linear.outputs[2, 1]
    slope = linear.chains.carrier[space.places][..., 0]
    np.testing.assert_allclose(slope[2:], np.tile([0.01**2 * 6 / 10 / 2, 0.01 / 2], (2, 1)), rtol=1e-6)
    assert np.all(slope[:2, 1] < 0.1 * slope[2:, 1])
    # The forces of chains are whole ones: where those that are known act, chains end where the simulation does.
    drive = linear.chains.drive[space.places]
    np.testing.assert_allclose(drive + slope * force, ends, atol=1e-15)


CROSSED = (
    "<mujoco><option timestep='.002' gravity='0 0 0'/><worldbody><body><joint name='x' type='slide' axis='1 0 0' "
    "frictionloss='1'/><geom size='.1' mass='2'/><body><joint name='y' type='slide' axis='0 1 0' frictionloss='1'/>"
    "<geom size='.1' mass='1'/></body></body></worldbody></mujoco>"
)


def test_about_other_forces_slopes_by_them_are_those_that_would_be_taken_anew():
    """Kept where pushes go as they say: not of a joint that rested and slides, or that slid and rests."""
    states = np.zeros((5, 4))
    simulator = MujocoSimulator(CROSSED, frame_skip=5)
    space = state_space(simulator, states[:-1], states[1:], np.zeros(4, int), consecutive=True)
    known = np.broadcast_to(1e-8 * np.eye(4), (*space.mask.shape, 4))
    before, now = (
        Forces(np.array([along_x, [0.0, 3.0, 3.0, 0.0]]).T, np.full((4, 2), 0.1))
        for along_x in ([0.0, 3.0, 3.0, 0.0], [0.0, 2.0, 0.5, -3.0])
    )
    about = linearise(space, space.measured, {}, known, forces=before)
    kept, anew = (
        about_forces(space, about, {}, now, known),
        linearise(space, space.measured, {}, known, forces=now),
    )
    np.testing.assert_allclose(kept.chains.carrier, anew.chains.carrier, atol=1e-6)
    np.testing.assert_allclose(kept.chains.drive, anew.chains.drive, atol=1e-6)
    apart = np.abs(about.chains.carrier - anew.chains.carrier)[space.places].max(axis=(1, 2))
    assert np.flatnonzero(apart > 1e-3).tolist() == [2, 3]


def test_a_slope_by_a_force_is_taken_over_what_is_not_known_of_it():
    """At rest a kink lies to both sides: the larger the force that may act, the more of it moves the joint."""
    simulator, space = on_a_rail()
    deviations = np.array([[0.0], [0.3], [2.0], [20.0]])
    known = np.broadcast_to(1e-12 * np.eye(2), (*space.mask.shape, 2))
    linear = linearise(space, space.measured, {}, known, forces=Forces(np.zeros((4, 1)), deviations))
    slope = linear.chains.carrier[space.places][:, 1, 0]
    reach = np.sqrt(3) * deviations[2:, 0]
    ends = [simulator.predict(np.zeros((1, 2)), effects={"force[rail]": one})[0, 1] for one in reach]
    np.testing.assert_allclose(slope[2:], ends / reach, rtol=1e-9)
    assert slope[1] < 0.1 * slope[2] < 0.1 * slope[3] < 0.1 * 0.01 / 2
    # To one side of a kink there are a mean beyond the simulation, and what no slope explains.
    pulled, there = on_a_rail(0.9 / 2)
    linear = linearise(there, there.measured, {}, known, forces=Forces(np.zeros((4, 1)), deviations))
    up, down = (
        pulled.predict(np.zeros((1, 2)), effects={"force[rail]": sign * reach[0]})[0, 1] for sign in (1, -1)
    )
    bent = up + down - 2 * linear.outputs[2, 1]
    off = linear.chains.drive[there.places] - linear.outputs
    assert off[2, 1] - off[0, 1] == pytest.approx(bent / 6, rel=1e-6)
    assert linear.chains.bends[there.places][2, 1, 1] == pytest.approx(bent**2 / 18, rel=1e-6)


# -- slopes ----------------------------------------------------------------------------------------------------------


def test_of_a_parabola_mean_slope_and_bend_are_those_of_the_normal_law():
    def step(X):
        return np.c_[X[:, 0] ** 2 + 3 * X[:, 1], X[:, 1] - 2 * X[:, 0] ** 2]

    X, y, groups = logged([20])
    space = state_space(of_states(step), X, y, groups, consecutive=True)
    variance = np.array([0.001, 0.09])  # a hundredth of what is not known is bent: three points do
    covariances = np.broadcast_to(np.diag(variance), (1, 21, 2, 2))
    linear = linearise(space, space.measured, {}, covariances)
    ends = step(X)
    np.testing.assert_allclose(linear.outputs, ends, rtol=1e-9)
    x = X[:, 0]
    slopes = np.stack([np.c_[2 * x, np.full(20, 3.0)], np.c_[-4 * x, np.ones(20)]], axis=1)
    np.testing.assert_allclose(linear.chains.transitions[space.places], slopes, atol=1e-9)
    mean = ends + np.array([1.0, -2.0]) * variance[0]
    np.testing.assert_allclose(linear.chains.drive[space.places], mean - y, atol=1e-9)
    bend = 2 * variance[0] ** 2 * np.outer([1.0, -2.0], [1.0, -2.0])
    np.testing.assert_allclose(
        linear.chains.bends[space.places], np.broadcast_to(bend, (20, 2, 2)), atol=1e-9
    )
    # At a point there is neither a bend nor a shift of the mean.
    point = linearise(space, space.measured, {})
    np.testing.assert_allclose(point.chains.transitions[space.places], slopes, atol=1e-6)
    np.testing.assert_allclose(point.chains.drive[space.places], ends - y, rtol=1e-9)
    assert (point.chains.bends == 0).all()
    again = linearise(space, space.measured, {}, slopes=linear)
    np.testing.assert_array_equal(again.chains.transitions, linear.chains.transitions)
    np.testing.assert_array_equal(again.chains.bends, linear.chains.bends)
    np.testing.assert_allclose(again.chains.drive[space.places], mean - y, atol=1e-9)


@pytest.mark.parametrize("d", [2, 9])
def test_of_a_kink_mean_slope_and_bend_are_about_those_of_the_normal_law(d):
    """A wall that pushes back: of x + 4 max(-x, 0), x normal about 0, and of what is beside it."""
    names = tuple(f"s{one}" for one in range(d))

    def step(X):
        out = X[:, :d].copy()
        out[:, 0] += 4 * np.maximum(-X[:, 0], 0)
        return out

    rng = np.random.default_rng(0)
    X = np.c_[rng.normal(size=(30, d)), np.zeros(30)]
    X[::2, 0] = 0.0  # the others make its spread
    simulator = FunctionSimulator(
        step, input_names=(*names, "u"), output_names=names, state_names=names, dt=DT
    )
    space = state_space(simulator, X, step(X), np.arange(30), consecutive=False)
    sigma = 0.1
    covariances = np.broadcast_to(sigma**2 * np.eye(d), (30, 2, d, d))
    linear = linearise(space, space.measured, {}, covariances)
    # E max(z, 0) = 1 / sqrt(2 pi), its slope 1 / 2, and its variance 1 / 2 - 1 / (2 pi), of which the slope has 1 / 4.
    np.testing.assert_allclose(linear.by_row.beyond[::2, 0], 4 * sigma / np.sqrt(2 * np.pi), rtol=0.03)
    np.testing.assert_allclose(linear.by_row.beyond[::2, 1:], 0, atol=1e-12)
    np.testing.assert_allclose(linear.chains.transitions[::2, 0, 0, 0], 1 - 2, atol=0.02)
    bend = 16 * sigma**2 * (1 / 4 - 1 / (2 * np.pi))
    np.testing.assert_allclose(linear.chains.bends[::2, 0, 0, 0], bend, rtol=0.15)


@pytest.mark.parametrize("d", [2, 9])
def test_where_a_row_is_bent_a_slope_by_an_effect_is_the_mean_one(d):
    """Of k max(-x, 0) by k: max(-x, 0), x normal about 0, by eight pairs of points; at the point it is 0."""
    names = tuple(f"s{one}" for one in range(d))

    def step(X, wall=4.0, push=0.0, cube=0.0):
        out = X[:, :d].copy() + push
        out[:, -1] += cube**3
        out[:, 0] += wall * np.maximum(-X[:, 0], 0)
        return out

    X = np.c_[np.random.default_rng(0).normal(size=(30, d)), np.zeros(30)]
    X[::2, 0], X[1::2, 0] = 0.0, np.abs(X[1::2, 0]) + 3.0
    effects = (
        Effect("wall", unit="1", neutral=4.0, bounds=(0.0, 9.0)),
        Effect("push", unit="1", neutral=0.0, bounds=(-1.0, 1.0)),
        Effect("cube", unit="1", neutral=0.0, bounds=(-1.0, 1.0)),
    )
    simulator = FunctionSimulator(
        step, input_names=(*names, "u"), output_names=names, state_names=names, effects=effects, dt=DT
    )
    space = state_space(simulator, X, step(X), np.arange(30), consecutive=False)
    sigma = 0.1
    covariances = np.broadcast_to(sigma**2 * np.eye(d), (30, 2, d, d))
    linear = linearise(space, space.measured, {}, covariances)
    steps = {"wall": (3.5, 4.5), "push": (-0.1, 0.1), "cube": (-0.1, 0.1)}
    point = derivatives(space, linear, {}, steps)
    means = derivatives(space, linear, {}, steps, covariances[:, 0])
    assert (point[..., 0] == 0).all()
    np.testing.assert_allclose(means[::2, 0, 0], sigma / np.sqrt(2 * np.pi), rtol=0.15)
    np.testing.assert_array_equal(means[1::2], point[1::2])
    np.testing.assert_allclose(means[..., 1], 1.0, rtol=1e-9)
    # Means may be taken over more than the slopes of other rows.
    wide = derivatives(space, linear, {}, steps, covariances[:, 0], {**steps, "cube": (-0.5, 0.5)})
    np.testing.assert_allclose(means[..., -1, 2], 0.1**2, rtol=1e-6)
    np.testing.assert_allclose(wide[::2, -1, 2], 0.5**2, rtol=1e-6)
    np.testing.assert_array_equal(wide[1::2], means[1::2])


def test_mean_slopes_end_where_they_are_known():
    """Of k max(-x, 0) + push at a kink: by k all eight pairs of points are asked, by the push one."""
    asked = []

    def step(X, wall=4.0, push=0.0):
        asked.append((wall, push, len(X)))
        return X[:, :1] + wall * np.maximum(-X[:, :1], 0) + push

    effects = (
        Effect("wall", unit="1", neutral=4.0, bounds=(0.0, 9.0)),
        Effect("push", unit="1", neutral=0.0, bounds=(-1.0, 1.0)),
    )
    simulator = FunctionSimulator(
        step, input_names=("s", "u"), output_names=("s",), state_names=("s",), effects=effects, dt=DT
    )
    X = np.zeros((30, 2))
    X[1::2, 0] = 3.0  # far from the kink
    space = state_space(simulator, X, step(X), np.arange(30), consecutive=False)
    covariances = np.full((30, 2, 1, 1), 0.01)
    linear = linearise(space, space.measured, {}, covariances)
    asked.clear()
    derivatives(space, linear, {}, {"wall": (3.5, 4.5), "push": (-0.1, 0.1)}, covariances[:, 0])
    rows = [sum(n for *values, n in asked if values == one) for one in ([3.5, 0.0], [4.0, 0.1])]
    assert rows == [30 + 8 * 2 * 15, 30 + 2 * 15]


def test_a_correlated_law_has_the_slopes_of_a_linear_step():
    A = np.array([[0.9, 0.2], [-0.3, 0.7]])
    X, y, groups = logged([8])
    space = state_space(of_states(lambda X: X[:, :2] @ A.T), X, y, groups, consecutive=True)
    covariances = np.broadcast_to(0.1 * np.array([[2.0, 0.9], [0.9, 1.0]]), (1, 9, 2, 2))
    linear = linearise(space, space.measured, {}, covariances)
    np.testing.assert_allclose(linear.chains.transitions[space.places], np.tile(A, (8, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(linear.chains.bends, 0, atol=1e-18)


@pytest.mark.parametrize("end", [np.nan, 1e6])
def test_a_row_that_diverges_says_nothing_and_may_end_anywhere(end):
    def step(X, gain=1.0, bend=0.0):
        out = drifting(X, gain, bend)
        out[X[:, 2] > 10] = end if np.isnan(end) else end * X[X[:, 2] > 10][:, :2]
        return out

    X, y, groups = logged([12])
    X[[3, 7], 2] = 11.0
    space = state_space(of_states(step, effects=EFFECTS), X, y, groups, consecutive=True)
    linear = linearise(space, space.measured, {}, np.broadcast_to(0.1 * np.eye(2), (1, 13, 2, 2)))
    assert np.flatnonzero(~linear.valid).tolist() == [3, 7]
    rows = tuple(one[[3, 7]] for one in space.places)
    assert (linear.chains.transitions[rows] == 0).all()
    assert (linear.chains.drive[rows] == 0).all()
    np.testing.assert_array_equal(linear.chains.bends[rows], np.tile(np.diag(space.spread**2), (2, 1, 1)))
    slopes = derivatives(space, linear, {}, {"gain": (1.0, 1.1)})
    assert (slopes[[3, 7]] == 0).all()
    np.testing.assert_allclose(np.delete(slopes, [3, 7], axis=0)[:, 1, 0], np.delete(X[:, 2], [3, 7]))


def test_a_row_that_diverges_at_one_end_of_a_chord_has_no_slope():
    def step(X, gain=1.0, bend=0.0):
        out = drifting(X, gain, bend)
        out[(X[:, 2] > 0.5) & (gain > 1.05)] = np.nan
        return out

    X, y, groups = logged([12])
    space = state_space(of_states(step, effects=EFFECTS), X, y, groups, consecutive=True)
    linear = linearise(space, space.measured, {})
    assert linear.valid.all()
    for ends, there in (((1.0, 1.1), X[:, 2] <= 0.5), ((0.9, 1.0), np.ones(12, dtype=bool))):
        slopes = derivatives(space, linear, {}, {"gain": ends})
        np.testing.assert_allclose(slopes[:, 1, 0], np.where(there, X[:, 2], 0.0), atol=1e-9)
    np.testing.assert_array_equal(linear.chains.prior, space.spread**2)


@pytest.mark.parametrize("at_once", [1.0, 2e7])
def test_slopes_by_effects_are_chords_between_the_values_given(monkeypatch, at_once):
    monkeypatch.setattr(module_of_slopes, "VALUES_AT_ONCE", at_once)
    X, y, groups = logged([12])
    space = state_space(of_states(drifting, effects=EFFECTS), X, y, groups, consecutive=True)
    values = {"bend": 0.5}
    linear = linearise(space, space.measured, values)
    steps = {"gain": (0.9, 1.0), "bend": (0.3, 0.7)}
    slopes = derivatives(space, linear, values, steps)
    np.testing.assert_allclose(slopes[:, 0], 0, atol=1e-12)
    np.testing.assert_allclose(slopes[:, 1, 0], X[:, 2], rtol=1e-9)
    np.testing.assert_allclose(slopes[:, 1, 1], 1 + (0.7**3 - 0.3**3) / 0.4, rtol=1e-9)
    from_here = derivatives(space, linear, values, {"bend": (0.5, 0.9)})
    np.testing.assert_allclose(from_here[:, 1, 0], 1 + (0.9**3 - 0.5**3) / 0.4, rtol=1e-9)


def kinked(X, gain=1.0, bend=0.0):
    out = drifting(X, gain, bend)
    out[:, 1] += np.where(X[:, 0] > 2, X[:, 0] - 2, 0.0)
    return out


def test_slopes_are_taken_anew_only_in_rows_that_do_not_go_as_they_say(monkeypatch):
    simulator = of_states(kinked)
    X, y, groups = logged([30, 30])
    X[:, :2], y = np.clip(X[:, :2], -1.5, 1.5), np.clip(y, -1.5, 1.5)
    space = state_space(simulator, X, y, groups, consecutive=True)
    covariances = np.broadcast_to(1e-4 * np.eye(2), (*space.mask.shape, 2))
    before = linearise(space, space.measured, {}, covariances)
    moved = space.measured + 0.05
    crossing = np.zeros(space.real.shape, dtype=bool)
    crossing[1, [3, 8]] = True
    moved[1, [3, 8], 0] = 2.5
    rows = []
    predict = FunctionSimulator.predict_many
    monkeypatch.setattr(
        FunctionSimulator,
        "predict_many",
        lambda self, X, *rest, **more: rows.append(len(X)) or predict(self, X, *rest, **more),
    )
    kept = linearise(space, moved, {}, covariances, slopes=before, renewed=True)
    assert rows == [60, 5 * 2]
    fresh = linearise(space, moved, {}, covariances)
    for name in ("outputs", "beyond"):
        np.testing.assert_allclose(getattr(kept.by_row, name), getattr(fresh.by_row, name), atol=1e-12)
    np.testing.assert_array_equal(kept.valid, fresh.valid)
    for name in ("transitions", "drive", "bends", "measured"):
        np.testing.assert_allclose(getattr(kept.chains, name), getattr(fresh.chains, name), atol=1e-9)
    at_crossing = crossing[space.places]
    np.testing.assert_array_equal(kept.by_row.origins[~at_crossing], before.by_row.origins[~at_crossing])
    np.testing.assert_array_equal(kept.by_row.origins[at_crossing], fresh.by_row.origins[at_crossing])


def test_slopes_of_another_fit_are_kept_where_they_are_not_to_be_renewed():
    X, y, groups = logged([12])
    space = state_space(of_states(drifting, effects=EFFECTS), X, y, groups, consecutive=True)
    before = linearise(space, space.measured, {})
    other = linearise(space, space.measured + 1.0, {"bend": 1.0}, slopes=before)
    np.testing.assert_array_equal(other.chains.transitions, before.chains.transitions)
    np.testing.assert_allclose(
        other.chains.drive[..., 1][space.real] - before.chains.drive[..., 1][space.real], 1.9
    )


ARM = """
<mujoco><worldbody><body><joint name="a" armature=".01" frictionloss=".05"/>
<geom size=".1" mass="1" pos=".1 0 0"/></body>
</worldbody><actuator><position name="a" joint="a" kp="20"/></actuator></mujoco>
"""


@pytest.mark.parametrize("values", [{"lag[a]": 0.03}, {"delay[action]": 0.013}, {"lag_torque[a]": 0.02}])
def test_rows_that_are_taken_anew_are_those_of_a_whole_log_whatever_they_remember(values):
    simulator = MujocoSimulator(ARM, frame_skip=5)
    rng = np.random.default_rng(0)
    commands = np.cumsum(rng.normal(scale=0.1, size=(1, 40, 1)), axis=1)
    states = simulator.rollout(np.zeros((1, 2)), commands, n_steps=40, effects=values)[0]
    X, y = np.column_stack([states[:-1], commands[0]]), states[1:]
    space = state_space(simulator, X, y, np.zeros(40, dtype=int), consecutive=True)
    covariances = np.tile(np.diag([1e-6, 1e-4]), (*space.measured.shape[:2], 1, 1))
    whole = linearise(space, space.measured, values, covariances)
    np.testing.assert_allclose(whole.outputs, y, atol=1e-9)
    # Every third row is taken anew, which do not follow each other.
    other = replace(whole, valid=np.arange(40) % 3 > 0)
    again = linearise(space, space.measured, values, covariances, slopes=other, renewed=True)
    np.testing.assert_allclose(again.outputs, y, atol=1e-9)
    np.testing.assert_allclose(again.chains.transitions, whole.chains.transitions, atol=1e-9)


# -- noise -----------------------------------------------------------------------------------------------------------


def walk(increments, *, prior=1.0):
    """Return the chains of a random walk that is read in each step."""
    n, steps = increments.shape
    path = np.concatenate([np.zeros((n, 1)), np.cumsum(increments, axis=1)], axis=1)
    return Chains(
        np.ones((n, steps, 1, 1)),
        np.zeros((n, steps, 1)),
        np.zeros((n, steps, 1, 1)),
        np.ones((n, steps, 1, 1)),
        path[..., None],
        np.ones((n, steps + 1, 1), dtype=bool),
        np.array([prior]),
    )


def readings(values):
    """Return the chains of what is read about zero, each for itself."""
    n, steps = values.shape[0], values.shape[1] - 1
    return Chains(
        np.zeros((n, steps, 1, 1)),
        np.zeros((n, steps, 1)),
        np.zeros((n, steps, 1, 1)),
        np.zeros((n, steps, 1, 0)),
        values[..., None],
        np.ones((n, steps + 1, 1), dtype=bool),
        np.array([1e-20]),
    )


def test_noise_about_what_is_known_is_its_mean_square_unless_given_or_below_the_floor():
    values = 0.3 * np.random.default_rng(0).normal(size=(4, 50))
    chains, real = readings(values), np.ones((4, 49), bool)
    start = normal_noise(chains, np.zeros(0), np.array([1.0]))
    options = {"floor": np.zeros(1), "heavy": False, "tolerance": 1e-9}
    found = estimate_noise(chains, start, real, **options)
    assert found.noise.error[0] == pytest.approx(np.mean(values**2), rel=1e-4)
    assert np.isinf(found.noise.error_nu).all()
    assert found.bound == pytest.approx(
        stats.norm(0, np.sqrt(np.mean(values**2))).logpdf(values).sum(), abs=0.01
    )
    held = estimate_noise(chains, start, real, **options, held=np.array([True]))
    assert held.noise.error[0] == 1.0
    raised = estimate_noise(chains, start, real, **{**options, "floor": np.array([0.5])})
    assert raised.noise.error[0] == 0.5
    chains.mask[:, ::2] = False
    seen = estimate_noise(chains, start, real, **options)
    assert seen.noise.error[0] == pytest.approx(np.mean(values[:, 1::2] ** 2), rel=1e-4)


def test_a_force_that_is_read_exactly_has_the_mean_square_of_its_steps():
    steps = 0.2 * np.random.default_rng(0).normal(size=(5, 40))
    chains, real = walk(steps), np.ones((5, 40), bool)
    start = normal_noise(chains, np.array([1.0]), np.array([1e-10]))
    found = estimate_noise(
        chains, start, real, floor=np.zeros(1), heavy=False, held=np.array([True]), tolerance=1e-9
    )
    assert found.noise.force[0] == pytest.approx(np.mean(steps**2), rel=1e-3)
    real[:, 20:] = False
    first = estimate_noise(
        chains, start, real, floor=np.zeros(1), heavy=False, held=np.array([True]), tolerance=1e-9
    )
    assert first.noise.force[0] == pytest.approx(np.mean(steps[:, :20] ** 2), rel=1e-3)


def test_a_noise_that_was_given_has_no_outliers():
    values = np.random.default_rng(0).standard_t(3, size=(4, 100))
    chains, real = readings(values), np.ones((4, 99), bool)
    start = normal_noise(chains, np.zeros(0), np.array([1.0]))
    free = estimate_noise(chains, start, real, floor=np.zeros(1))
    assert np.isfinite(free.noise.error_nu[0])
    held = estimate_noise(chains, start, real, floor=np.zeros(1), held=np.array([True]))
    assert np.isinf(held.noise.error_nu[0])
    assert (held.noise.error_weights == 1).all()


@pytest.mark.parametrize("nu", [3.0, 5.0, 10.0])
def test_the_likeliest_scale_is_that_of_student_s_law(nu):
    values = 2 * np.random.default_rng(0).standard_t(nu, size=(400, 1))
    seen = np.ones((400, 1), dtype=bool)
    seen[:100] = False
    values[:100] = 50.0
    scale = _best_scales(values**2, seen, np.array([1.0]), nu)[0]

    def loss(log_scale):
        return -stats.t(nu, scale=np.exp(log_scale / 2)).logpdf(values[100:]).sum()

    best = np.exp(optimize.minimize_scalar(loss, bounds=(-3, 5), method="bounded").x)
    assert scale == pytest.approx(best, rel=0.02)
    assert student_log_density(values[100:] ** 2, scale, nu).sum() == pytest.approx(
        -loss(np.log(best)), abs=0.05
    )


def test_heavy_tails_are_chosen_where_they_are_likelier_and_weigh_what_was_there():
    rng = np.random.default_rng(0)
    squares = (
        np.stack([rng.standard_t(3, size=(5, 200)), rng.normal(size=(5, 200)), np.zeros((5, 200))], -1) ** 2
    )
    present = np.ones(squares.shape, dtype=bool)
    present[..., 2] = False
    present[0] = False
    nus, weights = _scales(squares, np.array([1.0, 1.0, 1.0]), present)
    assert nus[0] <= 5
    assert np.isinf(nus[1:]).all()
    assert (weights[..., 1:] == 1).all()
    assert (weights[0] == 1).all()
    np.testing.assert_allclose(weights[1:, :, 0], (nus[0] + 1) / (nus[0] + squares[1:, :, 0]))
    nothing = _scales(squares, np.ones(3), np.zeros_like(present))
    assert np.isinf(nothing[0]).all()


@pytest.mark.parametrize("length", [3, 64])
def test_states_that_nobody_measured_follow_the_model_from_its_own_place(length):
    simulator = MujocoSimulator(
        "<mujoco><worldbody><body pos='0 0 2'><freejoint name='b'/><geom size='.1'/></body>"
        "<body><joint name='s' type='slide'/><geom size='.1' pos='5 0 0'/></body></worldbody></mujoco>",
        frame_skip=5,
    )
    names = simulator.state_names
    start = simulator.reference_state
    assert start[names.index("qpos.b.z")] == 2.0
    truth = simulator.rollout(np.stack([start, start]), n_steps=7)
    X, y = truth[:, :-1].reshape(14, -1).copy(), truth[:, 1:].reshape(14, -1).copy()
    hidden = [column for column, name in enumerate(names) if ".b." in name]
    X[:, hidden] = y[:, hidden] = np.nan
    episodes = np.repeat([0, 1], 7)
    space = state_space(simulator, X, y, episodes, consecutive=True, chain_length=length)
    np.testing.assert_allclose(space.rows(space.measured), truth[:, :-1].reshape(14, -1), atol=1e-12)
    np.testing.assert_allclose(space.path_ends(space.measured), truth[:, 1:].reshape(14, -1), atol=1e-12)
    # Rows that do not follow each other begin there each.
    apart = state_space(simulator, X, y, np.arange(14), consecutive=False)
    np.testing.assert_array_equal(apart.measured[:, 0, hidden], np.tile(start[hidden], (14, 1)))
    np.testing.assert_allclose(apart.measured[:, 1, hidden], np.tile(truth[0, 1, hidden], (14, 1)))


def test_the_first_state_alone_may_be_one_that_nobody_measured():
    simulator = of_states(drifting)
    truth = simulator.rollout(np.array([[0.0, 1.0]]), np.full((1, 6, 1), 0.3), n_steps=6)[0]
    X, y = np.c_[truth[:-1], np.full(6, 0.3)], truth[1:].copy()
    X[:, 0] = y[:, 0] = np.nan
    space = state_space(simulator, X, y, np.zeros(6, dtype=int), consecutive=True)
    np.testing.assert_allclose(space.measured[0], truth, atol=1e-12)


def test_slopes_are_those_at_a_time_step_that_a_function_was_given():
    """A function's own effect may be called so: nothing is known of what a coarser one would do."""
    step = Effect("timestep", unit="s", neutral=DT, bounds=(0.01, 0.5))

    def moved(X, timestep=DT):
        return np.c_[X[:, 0] + timestep * X[:, 1], X[:, 1] + timestep * X[:, 2]]

    space = state_space(of_states(moved, effects=(step,)), *logged([10]), consecutive=True)
    linear = linearise(space, space.measured, {"timestep": 0.3})
    np.testing.assert_allclose(linear.by_row.transitions, np.tile([[1, 0.3], [0, 1]], (10, 1, 1)), atol=1e-6)


@pytest.mark.parametrize("value", [0.25, 0.1])
def test_slopes_of_a_stiff_servo_are_those_of_a_finer_step(value):
    text = """<mujoco><option timestep="{step}"/><worldbody><body><joint name="j" type="slide" damping="1"/>
    <geom size=".1" mass="1"/></body></worldbody>
    <actuator><position name="s" joint="j" kp="9000"/></actuator></mujoco>"""
    rows = np.random.default_rng(0).normal(size=(10, 3))
    found = []
    for step, skip, values in ((0.01, 2, {"timestep": value}), (0.01 * value, round(2 / value), {})):
        simulator = MujocoSimulator(text.format(step=step), frame_skip=skip)
        space = state_space(simulator, rows, rows[:, :2], np.arange(10), consecutive=False)
        found.append(linearise(space, space.measured, values).by_row.transitions)
    np.testing.assert_allclose(found[0], found[1], rtol=0.4)
