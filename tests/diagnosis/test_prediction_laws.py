"""What a prediction is made of, against closed forms: windows, variances ahead, cut squares, gains and their floor."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate, stats

from skat.diagnosis.ahead import Seen, _mean_beside, ahead, filtered
from skat.diagnosis.chains import NO_MEMORY, Memory
from skat.diagnosis.filtering import updated
from skat.diagnosis.fitting import Fitted
from skat.diagnosis.noise import Noise, normal_noise, passed, variances_of
from skat.diagnosis.prediction import (
    _channel_errors,
    _cut,
    _weighted,
    _worst_episodes,
    ends,
    horizon_rows,
    in_open_loop,
    look,
    measured_gain,
    open_loop_gain,
    pieces_of,
    predicted,
    windows,
)
from skat.diagnosis.statespace import linearise, state_space
from skat.effects import Effect
from skat.simulators import FunctionSimulator

DT = 0.05
PUSH = Effect("push", unit="m", neutral=0.0, bounds=(-5.0, 5.0))


def resting(dt=DT, most=np.inf, drift=0.0):
    """Return a simulation in which a place stays, but for a drift and a push, and none goes on beyond some place."""

    def step(X, push=0.0):
        return np.where(np.abs(X) > most, np.nan, X + drift + push)

    names = ("x",)
    return FunctionSimulator(
        step, input_names=names, output_names=names, state_names=names, effects=(PUSH,), dt=dt
    )


def still(dt=DT):
    """Return a simulation without a state."""
    return FunctionSimulator(lambda X: X, input_names=("a",), output_names=("b",), dt=dt)


def read(lengths, *, error=0.1, seed=0, chain_length=1000, simulator=None, centres=None):
    """Return the log of places, one in each episode, that were read with noise."""
    rng = np.random.default_rng(seed)
    X, y = [], []
    for episode, length in enumerate(lengths):
        centre = 3 * rng.normal() if centres is None else centres[episode]
        states = centre + error * rng.normal(size=(length + 1, 1))
        X.append(states[:-1])
        y.append(states[1:])
    groups = np.repeat(np.arange(len(lengths)), lengths)
    return state_space(
        simulator or resting(),
        np.concatenate(X),
        np.concatenate(y),
        groups,
        consecutive=True,
        chain_length=chain_length,
    )


def known(space, error, force=0.0, share=None):
    """Return the fit at a known noise; `force` is the variance of a random step of the place."""
    linear = linearise(space, space.measured, {})
    chains, memory = linear.chains, NO_MEMORY
    forces, errors = [force / float(space.carrier[0, 0]) ** 2], [error**2]
    if share is not None:
        memory = Memory(1, share)
        chains = chains.with_memory(memory)
        forces, errors = [0.0, *forces], [*errors, 1.0]
    noise = normal_noise(chains, np.array(forces), np.array(errors))
    return Fitted(
        {},
        linear,
        chains,
        passed(chains, noise, space.real, covariances=True),
        memory,
    )


def random_state():
    return np.random.RandomState(0)


# -- windows ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dt", "rows"), [(0.01, 25), (0.25 / 13, 13), (0.02, 13), (0.025, 10), (0.1, 10), (None, 10)]
)
def test_a_horizon_is_never_shorter_than_a_quarter_of_a_second_nor_than_ten_rows(dt, rows):
    assert horizon_rows(resting(dt)) == rows


def test_a_horizon_of_one_s_own_is_rounded_to_rows_and_at_least_one():
    assert horizon_rows(resting(0.05), 0.32) == 6
    assert horizon_rows(resting(0.05), 1e-6) == 1
    assert horizon_rows(resting(None), 7.0) == 7
    assert horizon_rows(still(), 3.0) == 1
    assert horizon_rows(still()) == 1


@pytest.mark.parametrize("n_lags", [0, 3])
@pytest.mark.parametrize("chain_length", [7, 1000])
def test_windows_follow_each_other_from_the_first_row_on_whose_commands_are_known(n_lags, chain_length):
    lengths = [50, 33, 12, 3]
    space = read(lengths, chain_length=chain_length)
    starts, horizon = windows(space, 10, n_lags=n_lags)
    assert horizon == 10
    first = np.r_[0, np.cumsum(lengths)[:-1]]
    expected = [
        begin + n_lags + 10 * k for begin, n in zip(first, lengths) for k in range(max(n - n_lags, 0) // 10)
    ]
    assert starts.tolist() == expected


def test_a_window_is_as_long_as_the_longest_episode_at_most():
    space = read([12, 30, 9])
    assert [one if np.isscalar(one) else one.tolist() for one in windows(space, 10**6)] == [[12], 30]
    assert [one if np.isscalar(one) else one.tolist() for one in windows(space, 10**6, n_lags=4)] == [
        [16],
        26,
    ]
    starts, horizon = windows(space, 10, n_lags=10**6)
    assert (starts.tolist(), horizon) == ([12 + 29], 1)
    assert windows(space, 0)[1] == 1


def test_where_a_state_was_not_measured_windows_begin_once_it_was_found():
    lengths = [40, 8, 41]
    space = read(lengths, chain_length=20)
    space.mask[0, 0] = False
    starts, horizon = windows(space, 5)
    assert horizon == 5
    settled = space.places[1][starts]
    assert settled.min() >= 10
    assert (np.diff(starts) > 0).all()
    assert (space.groups[starts] == space.groups[starts + horizon - 1]).all()
    assert set(space.groups[starts]) == {0, 2}
    starts, horizon = windows(space, 10**6)
    assert horizon == 41 - 10
    assert (starts + horizon <= len(space.groups)).all()
    short = read([6, 6])
    short.mask[0, 0] = False
    assert [one if np.isscalar(one) else one.tolist() for one in windows(short, 10)] == [[5, 11], 1]


@pytest.mark.parametrize("chain_length", [4, 7, 1000])
def test_rows_end_where_they_were_measured_to_end_however_episodes_are_cut(chain_length):
    rng = np.random.default_rng(0)
    X, y, groups = rng.normal(size=(30, 1)), rng.normal(size=(30, 1)), np.repeat([0, 1, 2], [14, 1, 15])
    follows = np.flatnonzero(np.diff(groups) == 0)
    y[follows] = X[follows + 1]
    lost = np.array([3, 6, 7, 20, 29])
    y[lost] = np.nan
    X[lost[:-1] + 1] = np.nan
    space = state_space(resting(), X, y, groups, consecutive=True, chain_length=chain_length)
    measured, mask = ends(space)
    np.testing.assert_array_equal(mask, np.isfinite(y))
    np.testing.assert_array_equal(measured[mask], y[np.isfinite(y)])


# -- what is known at a start, and ahead of it -----------------------------------------------------------------------


def test_what_rests_is_known_at_each_row_as_the_mean_of_its_readings_until_then():
    space, error = read([9, 6]), 0.1
    seen = look(space, known(space, error), {})
    states, covariances = filtered(space, seen)
    for row, (chain, step) in enumerate(zip(*space.places)):
        readings = space.measured[chain, : step + 1, 0]
        precisions = np.r_[space.spread[0] ** -2, np.full(len(readings), error**-2)]
        begin = seen.linear.path[chain, 0, 0]
        mean = np.average(np.r_[begin, readings], weights=precisions)
        assert states[row, 0] == pytest.approx(mean, abs=1e-8)
        assert covariances[row, 0, 0] == pytest.approx(1 / precisions.sum(), rel=1e-6)


def test_what_is_not_known_of_a_state_is_what_its_readings_leave_of_what_was_predicted():
    """In the form of informations, for two coordinates of which one is read in half of the rows."""
    rng, names = np.random.default_rng(0), ("p", "q")
    A = np.array([[0.9, 0.3], [-0.2, 0.8]])
    simulator = FunctionSimulator(
        lambda X: X @ A.T, input_names=names, output_names=names, state_names=names, dt=DT
    )
    states = [rng.normal(size=2)]
    for _ in range(30):
        states.append(A @ states[-1] + 0.1 * rng.normal(size=2))
    read_states = np.array(states) + 0.1 * rng.normal(size=(31, 2))
    read_states[1::2, 1] = np.nan
    space = state_space(
        simulator, read_states[:-1], read_states[1:], np.zeros(30, dtype=int), consecutive=True
    )
    linear, errors = linearise(space, space.measured, {}), np.array([0.01, 0.02])
    noise = normal_noise(linear.chains, 0.01 / space.carrier.diagonal() ** 2, errors)
    estimate = passed(linear.chains, noise, space.real, covariances=True)
    seen = Seen(linear, linear.chains, estimate, NO_MEMORY)
    states, covariances = filtered(space, seen)
    one = estimate.filtered
    for row in (0, 1, 2, 17):
        predicted_information = np.linalg.inv(one.covariances[0, row])
        reading_information = np.diag(np.where(space.mask[0, row], 1 / errors, 0.0))
        kept = np.linalg.inv(predicted_information + reading_information)
        np.testing.assert_allclose(covariances[row], kept, rtol=1e-6, atol=1e-12)
        read_deviation = np.where(space.mask[0, row], linear.chains.measured[0, row], 0.0)
        mean = kept @ (predicted_information @ one.means[0, row] + reading_information @ read_deviation)
        np.testing.assert_allclose(states[row], space.measured[0, row] + mean, rtol=1e-6, atol=1e-9)
    found = ahead(space, seen, {}, np.array([5]), 2).variances[0]
    M = covariances[5]
    for step in range(2):
        M = A @ M @ A.T + 0.01 * np.eye(2)
        most = 2 * (space.spread / 3) ** 2
        np.testing.assert_allclose(found[step], np.minimum(np.diag(M), most) + errors, rtol=1e-5)


def test_a_log_is_looked_at_about_the_mean_over_what_is_not_known_of_its_states(monkeypatch):
    monkeypatch.setattr("skat.diagnosis.prediction.TURNS", 30)  # until path and covariances are each other's
    for tolerance in ("UNSEEN", "BENT"):  # and no slope is kept
        monkeypatch.setattr(f"skat.diagnosis.statespace.{tolerance}", 1e-9)
    names = ("x",)
    bent = FunctionSimulator(
        lambda X: 0.5 + 0.8 * (X - 0.5) + 0.3 * (X - 0.5) ** 2,
        input_names=names,
        output_names=names,
        state_names=names,
        dt=DT,
    )
    space = read([30, 20], error=0.3, simulator=bent, centres=[0.5, 0.5])
    seen = look(space, known(space, 0.3, 0.01), {})
    _, spread = updated(seen.chains, seen.estimate.filtered, seen.estimate.noise.error_variances)
    mean, point = (linearise(space, seen.linear.path, {}, one) for one in (spread, None))
    np.testing.assert_allclose(seen.chains.drive, mean.chains.drive, atol=1e-6)
    assert np.abs(mean.chains.drive - point.chains.drive).max() > 1e-3


def test_random_steps_add_up_ahead_of_a_start_until_two_motions_have_nothing_in_common():
    space, error, force = read([40, 40]), 0.1, 0.3
    seen = look(space, known(space, error, force), {})
    starts = np.array([0, 45])
    states, unknown = (one[starts] for one in filtered(space, seen))
    begin = np.array([[[0.02]], [[0.05]]])
    found = ahead(space, seen, {}, starts, 30, (states, begin)).variances
    assert found.shape == (2, 30, 1)
    most = 2 * (space.spread[0] / 3) ** 2
    np.testing.assert_allclose(
        found[..., 0],
        np.minimum(begin[:, 0] + force * np.arange(1, 31), most) + error**2,
        rtol=1e-6,
    )
    assert found.max() == pytest.approx(most + error**2)
    own, given = ahead(space, seen, {}, starts, 4), ahead(space, seen, {}, starts, 4, (states, unknown))
    np.testing.assert_array_equal(own.variances, given.variances)


def test_what_bounces_is_as_far_apart_as_it_is_drawn_not_as_slopes_have_it():
    """A ball that falls on a floor, from heights of which some reach it: by quadrature over the height."""
    names, drop = ("z", "v"), 9.81 * DT

    def step(X):
        z, v = X[:, 0] + DT * X[:, 1], X[:, 1] - drop
        return np.stack([np.abs(z), np.where(z < 0, -v, v)], axis=1)

    simulator = FunctionSimulator(step, input_names=names, output_names=names, state_names=names, dt=DT)
    states = np.stack([np.linspace(0.5, 4.0, 41), np.linspace(-3.0, 3.0, 41)], axis=1)
    space = state_space(simulator, states[:-1], states[1:], np.arange(40), consecutive=True)
    linear = linearise(space, space.measured, {})
    noise = normal_noise(linear.chains, np.full(2, 1e-12), np.full(2, 1e-6))
    seen = Seen(linear, linear.chains, passed(linear.chains, noise, space.real, covariances=True), NO_MEMORY)
    height, speed, spread = 0.3, -2.0, 0.15
    begin = np.tile([height, speed], (20, 1)), np.tile(np.diag([spread**2, 0.0]), (20, 1, 1))
    # Where the floor is a row away, slopes know nothing of it.
    found = ahead(space, seen, {}, np.zeros(20, dtype=int), 1, begin).variances[:, 0]
    heights = height + spread * stats.norm.ppf((np.arange(20_000) + 0.5) / 20_000)
    runs = step(np.stack([heights, np.full_like(heights, speed)], axis=1)) - step(np.array([[height, speed]]))
    np.testing.assert_allclose(found.mean(axis=0), np.mean(runs**2, axis=0) + 1e-6, rtol=0.1)
    assert np.mean(runs[:, 1] ** 2) > 1


@pytest.mark.parametrize("nu", [3.0, 5.0, np.inf])
def test_the_squares_of_a_right_model_are_drawn_from_the_law_of_its_sensors(nu):
    space = read([300, 300])
    fitted = known(space, 0.1)
    noise = replace(fitted.estimate.noise, error_nu=np.array([[nu]]))
    drawn = ahead(
        space,
        look(space, replace(fitted, estimate=replace(fitted.estimate, noise=noise)), {}),
        {},
        np.arange(0, 600, 7),
        1,
    ).last
    # A resting place is known to a fraction of the noise after some rows.
    for most in (1.0, 4.0, 30.0):
        expected = cut_mean(most)
        if np.isfinite(nu):
            sd = np.sqrt(nu / (nu - 2))
            expected = stats.t(nu, scale=1 / sd).expect(lambda z, most=most: np.minimum(z * z, most))
        assert np.minimum(drawn, most).mean() == pytest.approx(expected, rel=0.04)


def test_without_a_state_the_squares_of_a_right_model_are_alike_for_all_rows():
    simulator, rng = still(), np.random.default_rng(0)
    X = rng.normal(size=(20, 1))
    space = state_space(simulator, X, X, np.arange(20), consecutive=False)
    linear = linearise(space, space.measured, {})
    noise = replace(normal_noise(linear.chains, np.zeros(0), np.array([0.04])), error_nu=np.array([[5.0]]))
    fitted = Fitted({}, linear, linear.chains, passed(linear.chains, noise, space.real), NO_MEMORY)
    found = ahead(space, look(space, fitted, {}), {}, np.arange(3), 1)
    assert found.last.shape[1:] == (1, 1)
    np.testing.assert_allclose(found.variances, 0.04 * 5 / 3)
    expected = stats.t(5, scale=np.sqrt(3 / 5)).expect(lambda z: np.minimum(z * z, 9.0))
    assert np.minimum(found.last, 9.0).mean() == pytest.approx(expected, rel=0.005)


def test_draws_are_corrected_by_others_whose_mean_is_known():
    rng = np.random.default_rng(0)
    known_draws = rng.normal(size=(16, 200)) ** 2
    alike = _mean_beside(3 + 0.5 * known_draws, known_draws, np.ones(200))
    np.testing.assert_allclose(alike, 3.5, rtol=1e-12)
    other = rng.normal(size=(16, 200)) ** 2
    apart = _mean_beside(other, known_draws, np.ones(200))
    assert apart.mean() == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(_mean_beside(other, np.ones((16, 200)), np.ones(200)), other.mean(axis=0))
    wild = known_draws.copy()
    wild[0] = np.inf
    np.testing.assert_allclose(_mean_beside(other, wild, np.ones(200)), other.mean(axis=0))


def test_a_force_with_memory_counts_ahead_with_all_of_its_variance():
    """The sum of k steps of a stationary series, whose correlation falls by a share in each."""
    space, error, share, fresh = read([40, 40]), 0.1, 0.8, 0.01
    fitted = known(space, error, fresh, share)
    seen = look(space, fitted, {})
    begin = filtered(space, seen)[0][[3]], np.zeros((1, 1, 1))
    found = ahead(space, seen, {}, np.array([3]), 6, begin).variances[0, :, 0]
    steady = fresh / (1 - share**2)
    for step in range(6):
        lags = np.abs(np.subtract.outer(np.arange(step + 1), np.arange(step + 1)))
        expected = steady * np.sum(share**lags) + error**2
        assert found[step] == pytest.approx(expected, rel=1e-4)


def test_without_a_state_an_error_ahead_is_that_of_the_sensor():
    simulator, rng = still(), np.random.default_rng(0)
    X = rng.normal(size=(20, 1))
    space = state_space(simulator, X, X, np.arange(20), consecutive=False)
    linear = linearise(space, space.measured, {})
    noise = normal_noise(linear.chains, np.zeros(0), np.array([0.04]))
    fitted = Fitted(
        {},
        linear,
        linear.chains,
        passed(linear.chains, noise, space.real),
        NO_MEMORY,
    )
    found = ahead(space, look(space, fitted, {}), {}, np.arange(3), 1)
    np.testing.assert_array_equal(found.variances, np.full((3, 1, 1), 0.04))


def test_variances_of_laws_are_those_of_student_and_gauss():
    scale, nu = np.array([0.3, 2.0, 0.5, 1.0]), np.array([np.inf, 3.0, 5.0, 10.0])
    expected = [0.3, *(stats.t(n, scale=np.sqrt(s)).var() for s, n in zip(scale[1:], nu[1:]))]
    np.testing.assert_allclose(variances_of(scale, nu), expected, rtol=1e-12)


def test_weights_of_samples_are_the_expected_precisions_of_student_s_law():
    """By quadrature over the precision, a Gamma variable of mean 1; what was not there weighs 1."""
    nu, scale = 4.0, 0.5
    errors = np.array([[[0.0, 0.3], [2.0, 0.4], [-1.0, 9.0]]])
    nothing = np.zeros((1, 2, 0))
    noise = Noise(
        force=np.zeros((1, 0)),
        force_nu=np.zeros((1, 0)),
        error=np.array([[scale, 1.0]]),
        error_nu=np.array([[nu, np.inf]]),
        law=np.zeros(1, dtype=int),
        force_weights=nothing,
        error_weights=np.ones_like(errors),
    )
    smoothed = SimpleNamespace(
        forces=nothing, force_variances=nothing, errors=errors, error_variances=np.zeros_like(errors)
    )
    mask = np.array([[[True, True], [True, True], [False, True]]])
    weights = _weighted(SimpleNamespace(noise=noise, smoothed=smoothed), np.ones((1, 2), bool), mask)
    for place, error in enumerate((0.0, 2.0)):

        def density(precision, error=error):
            prior = precision ** (nu / 2 - 1) * np.exp(-nu / 2 * precision)
            return prior * precision**0.5 * np.exp(-0.5 * precision * error**2 / scale)

        total = integrate.quad(density, 0, np.inf)[0]
        mean = integrate.quad(lambda one: one * density(one), 0, np.inf)[0] / total
        assert weights.error_weights[0, place, 0] == pytest.approx(mean, rel=1e-6)
    assert weights.error_weights[0, 2, 0] == 1.0
    assert (weights.error_weights[..., 1] == 1).all()
    smoothed.error_variances = np.full_like(errors, 2.0**2)
    unsure = _weighted(SimpleNamespace(noise=noise, smoothed=smoothed), np.ones((1, 2), bool), mask)
    # An error that is zero give or take 2 counts as one of 2.
    assert unsure.error_weights[0, 0, 0] == pytest.approx(weights.error_weights[0, 1, 0], rel=1e-12)


# -- squares and gains -----------------------------------------------------------------------------------------------


def squares_of_a_right_model(n):
    return stats.chi2.ppf((np.arange(n) + 0.5) / n, 1)


# Draws of it, alike for all starts and channels.
RIGHT = squares_of_a_right_model(20_000)[:, None, None]


def cut_mean(most):
    """Return the mean of the square of a standard normal number, cut."""
    return integrate.quad(lambda z: 2 * min(z * z, most) * stats.norm.pdf(z), 0, 40, points=[most**0.5])[0]


def test_squares_of_a_right_model_have_a_mean_of_one_whatever_was_measured():
    square = squares_of_a_right_model(20_000)
    squares = np.stack([np.stack([square, square[::-1]], axis=1)] * 2)
    counted = np.ones((20_000, 2), dtype=bool)
    counted[::3, 1] = False
    nominal, extended, floor = _cut(squares, RIGHT, counted)
    np.testing.assert_array_equal(nominal, extended)
    assert nominal.mean() == pytest.approx(1.0, rel=2e-3)
    assert floor.mean() == pytest.approx(1.0, rel=1e-12)
    # A row of which one channel was measured has the square of that one.
    np.testing.assert_allclose(
        nominal[0] / nominal[1], min(square[0], 9) * 2 / np.sum(np.minimum(squares[0, 1], 9)), rtol=1e-9
    )


def test_squares_are_cut_at_the_nominal_model_s_own_size():
    square = squares_of_a_right_model(20_000)[:, None]
    factor = 100.0
    nominal, extended, floor = _cut(np.stack([factor * square, square]), RIGHT, np.ones((20_000, 1), bool))
    assert nominal.mean() == pytest.approx(factor * cut_mean(9.0) / cut_mean(9 * factor), rel=2e-3)
    assert extended.mean() == pytest.approx(1 / cut_mean(9 * factor), rel=2e-3)
    assert floor.mean() == pytest.approx(1.0)
    # A nominal model that is better than right is no reason to cut sooner.
    small, right, _ = _cut(np.stack([square / factor, square]), RIGHT, np.ones((20_000, 1), bool))
    assert right.mean() == pytest.approx(1.0, rel=2e-3)
    assert small.mean() == pytest.approx(1 / factor / cut_mean(9.0), rel=2e-3)


def test_a_channel_in_which_the_nominal_model_diverges_is_cut_as_the_worst_other_one():
    square = squares_of_a_right_model(20_001)
    squares = np.stack([np.stack([25 * square, np.full_like(square, np.inf)], axis=1)] * 2)
    nominal, _, floor = _cut(squares, RIGHT, np.ones((20_001, 2), bool))
    assert np.isfinite(nominal).all()
    own, other = 25 * cut_mean(9.0), 9 * 25
    assert nominal.mean() == pytest.approx((own + other) / 2 / cut_mean(9 * 25), rel=2e-3)
    assert floor.mean() == pytest.approx(1.0)
    alone, _, _ = _cut(np.full((2, 5, 1), np.inf), RIGHT, np.ones((5, 1), bool))
    assert alone.mean() == pytest.approx(9 / cut_mean(9.0), rel=1e-6)


@pytest.mark.parametrize("sizes", [[100], [30, 41, 52], [9, 3, 60, 21], [4, 4, 4, 4, 4], [7] * 8])
def test_pieces_are_episodes_or_even_parts_of_them_in_time(sizes):
    episodes = np.repeat(10 + 3 * np.arange(len(sizes)), sizes)
    pieces = pieces_of(episodes)
    assert (np.diff(pieces) >= 0).all()
    each = 1 if len(sizes) >= 5 else -(-20 // len(sizes))
    for label, size in zip(np.unique(episodes), sizes):
        _, counts = np.unique(pieces[episodes == label], return_counts=True)
        assert len(counts) == min(each, size)
        assert np.ptp(counts) <= 1
    assert len(np.unique(pieces)) == sum(min(each, size) for size in sizes)


def gain_of(parts, pieces, **options):
    return measured_gain(
        np.array(parts, float), np.array(pieces), random_state(), horizon=1.0, channels={}, **options
    )


def test_a_gain_is_the_share_of_the_excess_that_is_gone():
    parts = np.array([[9.0], [4.0], [1.0]]) * np.ones(10)
    plain = gain_of(parts, np.arange(10))
    assert (plain.nominal, plain.extended, plain.floor) == (9.0, 4.0, 1.0)
    assert plain.explained == pytest.approx(5 / 8)
    assert plain.interval == pytest.approx((5 / 8, 5 / 8))
    root = gain_of(parts, np.arange(10), root=True)
    assert (root.nominal, root.extended, root.floor) == (3.0, 2.0, 1.0)
    assert root.explained == pytest.approx(1 / 2)
    assert root.interval == pytest.approx((1 / 2, 1 / 2))


def test_where_there_is_no_excess_a_share_of_it_may_be_anything():
    gain = gain_of(np.array([[1.0], [0.5], [1.0]]) * np.ones(10), np.arange(10))
    assert gain.explained == 0.0
    assert gain.interval == (-np.inf, np.inf)
    assert np.isnan(gain_of(np.ones((3, 8)), np.arange(8) // 2).interval).all()
    assert np.isfinite(
        gain_of(np.array([[3.0], [2.0], [1.0]]) * np.ones(10), np.arange(10) // 2).interval
    ).all()


def test_the_interval_of_a_gain_holds_the_true_one_in_nineteen_logs_of_twenty():
    """Of pieces that are drawn, of several rows each that go together."""
    rng, held = np.random.default_rng(0), []
    for _ in range(150):
        excess = np.repeat(rng.gamma(4, size=30), 5)
        left = excess * np.repeat(rng.uniform(0.1, 0.5, 30), 5)
        low, high = gain_of([1 + excess, 1 + left, np.ones(150)], np.arange(150) // 5).interval
        held.append(low <= 0.7 <= high)
    assert 0.89 < np.mean(held) < 0.985


def test_errors_of_a_channel_are_root_mean_squares_over_what_was_measured():
    space = read([6, 6])
    fitted = known(space, 0.1)
    errors = np.array([[3.0, 100.0, 4.0], [1.0, 100.0, 1.0]])[..., None] * 0.1
    found = _channel_errors(space, fitted, errors, np.array([[True], [False], [True]]))
    assert found["x"] == pytest.approx((0.1 * np.sqrt(12.5), 0.1))
    assert _channel_errors(space, fitted, errors, np.zeros((3, 1), bool)) == {}
    diverged = np.array([[np.nan, np.inf, -np.inf], [0.1, 0.1, 0.1]])[..., None]
    nominal, extended = _channel_errors(space, fitted, diverged, np.ones((3, 1), bool))["x"]
    assert extended == pytest.approx(0.1)
    assert np.isfinite(nominal)
    assert nominal > 5 * space.measured.std()


def test_errors_of_a_log_that_rests_are_what_they_are_by_the_spread_of_the_one_that_was_fitted():
    fitted = known(read([6, 6], centres=[-1.0, 1.0]), 1e-5, force=1e6)
    resting_log = read([20], error=1e-5, centres=[0.0])
    options = {"horizon": 1, "random_state": random_state()}
    gain = predicted(resting_log, fitted, {"push": 0.1}, **options).gain
    assert gain.channels["x"][1] == pytest.approx(0.1, rel=1e-3)


def test_the_worst_episode_has_the_largest_mean_not_the_largest_sum():
    episodes = np.repeat([4, 7, 9], [6, 2, 3])
    squares = np.repeat([2.0, 5.0, 3.0], [6, 2, 3])
    assert _worst_episodes(episodes, squares, 2) == [7, 9]
    assert _worst_episodes(episodes, squares, 5) == [7, 9, 4]
    assert _worst_episodes(np.array([5, 6, 7]), np.array([1.0, 3.0, 2.0]), 2) == [6, 7]


def test_an_overlay_has_its_own_episode_s_time_readings_and_predictions():
    space = read([20, 25], centres=[0.0, 4.0])
    space.mask[1, 8] = False
    found = predicted(space, known(space, 0.1), {"push": 0.5}, horizon=5, random_state=random_state())
    assert found.n_starts == 4 + 5
    assert found.n_diverged == 0
    one = next(one for one in found.overlays if one.episode == 1)
    assert one.horizon == 5
    np.testing.assert_allclose(one.time, DT * np.arange(1, 26), rtol=1e-12)
    expected = space.measured[1, 1:].copy()
    expected[7] = np.nan
    np.testing.assert_array_equal(one.measured, expected)
    # Begun anew every five rows, one rests, and the other goes on by a push in each.
    assert np.ptp(one.nominal.reshape(5, 5), axis=1).max() < 1e-12
    np.testing.assert_allclose(
        one.extended - one.nominal, 0.5 * (np.arange(25)[:, None] % 5 + 1), rtol=1e-9, atol=1e-9
    )
    assert found.gain.horizon == pytest.approx(5 * DT)
    assert found.gain.extended > found.gain.nominal


def test_starts_from_which_a_simulation_diverges_are_counted_and_count_as_wholly_wrong():
    """Where neither model goes, and on the way there, where only the drifting one gets."""
    space = read([20, 20, 20], simulator=resting(most=3.0, drift=0.3), centres=[0.0, 2.0, 4.0])
    found = predicted(space, known(space, 0.1), {"push": -0.3}, horizon=10, random_state=random_state())
    assert (found.n_starts, found.n_diverged) == (6, 4)
    assert found.gain.extended < found.gain.nominal < np.inf
    assert found.gain.nominal > 5


# -- whole episodes in open loop -------------------------------------------------------------------------------------


@pytest.mark.parametrize("start", ["measured", "fitted"])
def test_the_floor_in_open_loop_is_what_a_right_model_has(start):
    """From a start that was read, twice the noise; from one fitted to eleven readings, a tenth of it is taken up."""
    error, lengths = 0.1, [10] * 60
    space = read(lengths, error=error)
    gain = open_loop_gain(space, known(space, error), {}, initial_state=start, random_state=random_state())
    square = 2 * error**2 if start == "measured" else error**2 * (1 - 1 / 11)
    assert gain.floor == pytest.approx(np.sqrt(square), rel=1e-6)
    assert gain.nominal == pytest.approx(gain.floor, rel=0.2 if start == "measured" else 0.08)
    assert gain.nominal == gain.extended
    assert gain.explained == 0.0


def test_random_steps_are_carried_on_over_an_episode_in_open_loop():
    error, force, n = 0.1, 0.0004, 12
    space = read([n] * 5)
    gain = open_loop_gain(space, known(space, error, force), {}, random_state=random_state())
    assert gain.floor == pytest.approx(np.sqrt(2 * error**2 + force * (n + 1) / 2), rel=1e-6)


def test_a_fitted_start_is_taken_where_it_fits_better_than_the_reading():
    space = read([10] * 6)
    space.measured[:, 0] += 1.0
    fitted = known(space, 0.1)
    from_reading = open_loop_gain(space, fitted, {}, random_state=random_state())
    from_fit = open_loop_gain(space, fitted, {}, initial_state="fitted", random_state=random_state())
    assert from_reading.nominal == pytest.approx(1.0, rel=0.1)
    assert from_fit.nominal < 0.2


@pytest.mark.parametrize("hidden", [[], [1]])
def test_open_loop_begins_where_least_squares_over_the_episode_do(hidden):
    """Of linear dynamics, with readings of the first state as one row more."""
    A, rng, names, n, error = (
        np.array([[0.95, 0.3], [-0.2, 0.9]]),
        np.random.default_rng(0),
        ("x", "v"),
        25,
        0.1,
    )
    simulator = FunctionSimulator(
        lambda X: X[:, :2] @ A.T + np.c_[0 * X[:, 2], X[:, 2]],
        input_names=(*names, "u"),
        output_names=names,
        state_names=names,
        dt=DT,
    )
    u = rng.normal(size=(2, n, 1))
    states = simulator.rollout(rng.normal(size=(2, 2)), u, n_steps=n) + error * rng.normal(size=(2, n + 1, 2))
    states[..., hidden] = np.nan
    X = np.concatenate([states[:, :-1], u], axis=2).reshape(2 * n, 3)
    space = state_space(simulator, X, states[:, 1:].reshape(2 * n, 2), np.repeat([0, 1], n), consecutive=True)
    paths, lost = in_open_loop(space, {}, np.full((1, 2), error**2))
    assert not lost.any()
    seen = [one for one in (0, 1) if one not in hidden]
    forced = simulator.rollout(np.zeros((2, 2)), u, n_steps=n)
    powers = np.array([np.linalg.matrix_power(A, step) for step in range(n + 1)])
    for episode in range(2):
        read = (states[episode] - forced[episode])[:, seen].ravel()
        start = np.linalg.lstsq(powers[:, seen].reshape(-1, 2), read, rcond=None)[0]
        np.testing.assert_allclose(paths[episode], forced[episode] + powers @ start, atol=1e-3)


def test_the_episode_that_diverges_in_open_loop_is_named_as_its_user_does():
    simulator = resting(most=3.0)
    space = read([8, 8], simulator=simulator, centres=[0.0, 2.0])
    with pytest.raises(RuntimeError, match=r"the extended simulation diverges in episode tuesday"):
        open_loop_gain(
            space, known(space, 0.1), {"push": 0.3}, labels=["monday", "tuesday"], random_state=random_state()
        )
    with pytest.raises(RuntimeError, match=r"diverges in episode 1:"):
        open_loop_gain(space, known(space, 0.1), {"push": 0.3}, random_state=random_state())


def test_an_episode_that_diverges_in_its_last_row_alone_has_no_distance():
    space = read([8, 8], simulator=resting(most=3.0), centres=[0.0, 2.0])
    fitted = known(space, 0.1)
    # From about 2 by .15 a row: beyond 3 behind the seventh.
    space.measured[1, 0] = 2.0
    with pytest.raises(RuntimeError, match=r"diverges in episode 1:"):
        open_loop_gain(space, fitted, {"push": 0.15}, random_state=random_state())
    assert open_loop_gain(space, fitted, {"push": 0.14}, random_state=random_state()).extended < 2


def test_a_channel_that_was_measured_in_some_rows_is_compared_in_these():
    space = read([10] * 6)
    space.mask[:, 3:] = False
    gain = open_loop_gain(space, known(space, 0.1), {}, outputs=["x"], random_state=random_state())
    away = space.measured[:, 1:3, 0] - space.measured[:, :1, 0]
    assert gain.nominal == pytest.approx(np.sqrt(np.mean(away**2)))
    assert gain.channels["x"] == pytest.approx((gain.nominal, gain.nominal))


def test_commands_from_before_a_window_act_in_it():
    """What moves a place three rows late is known from the rows before each window of two."""
    names, rng = ("x",), np.random.default_rng(0)
    late = FunctionSimulator(
        lambda X: X[:, :1] + X[:, 1:], input_names=("x", "u"), output_names=names, state_names=names, dt=DT
    )
    u = rng.normal(size=(6, 40, 1))
    delay = {"delay[u]": 3 * DT}
    states = late.rollout(np.zeros((6, 1)), u, n_steps=40, effects=delay)
    states = states + 0.01 * rng.normal(size=states.shape)
    X = np.concatenate([states[:, :-1], u], axis=2).reshape(240, 2)
    space = state_space(late, X, states[:, 1:].reshape(240, 1), np.repeat(np.arange(6), 40), consecutive=True)
    gain = predicted(space, known(space, 0.01), delay, horizon=2, random_state=random_state()).gain
    assert gain.extended == pytest.approx(1.0, abs=0.4)
    assert gain.nominal > 100
