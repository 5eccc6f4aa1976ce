"""The filter, the smoother and the noise, against dense normal laws and quadrature."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats

from skat.diagnosis.chains import NO_MEMORY, Chains, Memory
from skat.diagnosis.filtering import filter_columns, kalman_filter, smooth, student_log_density
from skat.diagnosis.noise import Noise, estimate_noise, normal_noise, passed


@pytest.fixture
def log():
    """Three chains of six steps, four channels and two forces; a third of the samples and one channel are missing."""
    rng = np.random.default_rng(0)
    n, steps, d, k = 3, 6, 4, 2
    bends = 0.1 * rng.normal(size=(n, steps, d, d))
    mask = rng.random((n, steps + 1, d)) > 0.3
    mask[..., 3] = False
    chains = Chains(
        0.6 * rng.normal(size=(n, steps, d, d)),
        rng.normal(size=(n, steps, d)),
        bends @ bends.swapaxes(-1, -2),
        rng.normal(size=(n, steps, d, k)),
        rng.normal(size=(n, steps + 1, d)),
        mask,
        np.full(d, 9.0),
    )
    return chains, 0.1 + rng.random((n, steps, k)), 0.1 + rng.random((n, steps + 1, d))


def dense(chains, forces, errors, chain):
    """Return mean and covariance of all states of a chain, and what of them was measured, with its noise."""
    n_states, d = chains.measured.shape[1:]
    total = n_states * d
    carried, spread, mean = np.zeros((total, total)), np.zeros((total, total)), np.zeros(total)
    at = [slice(t * d, (t + 1) * d) for t in range(n_states)]
    carried[at[0], at[0]], spread[at[0], at[0]] = np.eye(d), np.diag(chains.prior)
    for t in range(n_states - 1):
        A, F = chains.transitions[chain, t], chains.carrier[chain, t]
        carried[at[t + 1]] = A @ carried[at[t]]
        carried[at[t + 1], at[t + 1]] += np.eye(d)
        mean[at[t + 1]] = A @ mean[at[t]] + chains.drive[chain, t]
        spread[at[t + 1], at[t + 1]] = F @ np.diag(forces[chain, t]) @ F.T + chains.bends[chain, t]
    seen = chains.mask[chain].ravel()
    return mean, carried @ spread @ carried.T, seen, errors[chain].ravel()[seen]


def test_filter_and_smoother_are_those_of_the_dense_normal_law(log):
    chains, forces, errors = log
    filtered = kalman_filter(chains, forces, errors)
    smoothed = smooth(chains, filtered, forces, errors)
    expected = 0.0
    for chain in range(len(chains.drive)):
        mean, covariance, seen, noise = dense(chains, forces, errors, chain)
        S = covariance[np.ix_(seen, seen)] + np.diag(noise)
        measured = chains.measured[chain].ravel()[seen]
        expected += stats.multivariate_normal(mean[seen], S).logpdf(measured)
        gain = np.linalg.solve(S, covariance[seen]).T
        states = mean + gain @ (measured - mean[seen])
        left = covariance - gain @ covariance[seen]
        np.testing.assert_allclose(smoothed.means[chain].ravel(), states, rtol=1e-9, atol=1e-10)
        d = chains.measured.shape[2]
        for t, found in enumerate(smoothed.covariances[chain]):
            block = slice(t * d, (t + 1) * d)
            np.testing.assert_allclose(found, left[block, block], rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(
            smoothed.errors[chain].ravel()[seen], measured - states[seen], rtol=1e-8, atol=1e-10
        )
        np.testing.assert_allclose(
            smoothed.error_variances[chain].ravel()[seen], np.diag(left)[seen], rtol=1e-8, atol=1e-10
        )
    assert filtered.log_likelihood == pytest.approx(expected, rel=1e-11)


def test_derivatives_of_innovations_are_those_of_the_filter(log):
    chains, forces, errors = log
    columns = np.random.default_rng(1).normal(size=(*chains.drive.shape, 3))
    filtered = kalman_filter(chains, forces, errors)
    slopes = filter_columns(chains, filtered, columns)
    theta = np.array([0.3, -1.0, 0.5])
    moved = kalman_filter(replace(chains, drive=chains.drive + columns @ theta), forces, errors)
    np.testing.assert_allclose(filtered.whitened - slopes @ theta, moved.whitened, atol=1e-10)


def test_no_noise_and_no_force_are_allowed(log):
    chains, forces, errors = log
    exact = replace(chains, bends=np.zeros_like(chains.bends))
    assert np.isfinite(kalman_filter(exact, 0 * forces, 1e-14 + 0 * errors).log_likelihood)


def random_walk(rng, *, steps=400, force=0.3, error=1.0, chains=4, memory=0.0, nu=np.inf):
    """Return chains in which a place is pushed by a random force and read with noise."""
    pushes = force * rng.normal(size=(chains, steps + 50, 1))
    for t in range(1, steps + 50):
        pushes[:, t] += memory * pushes[:, t - 1]
    place = np.concatenate([np.zeros((chains, 1, 1)), np.cumsum(pushes[:, 50:], axis=1)], axis=1)
    noise = rng.normal(size=place.shape) if np.isinf(nu) else stats.t(nu).rvs(place.shape, random_state=rng)
    ones = np.ones((chains, steps, 1, 1))
    return Chains(
        ones,
        np.zeros((chains, steps, 1)),
        0 * ones,
        ones,
        place + error * noise,
        np.ones((chains, steps + 1, 1), dtype=bool),
        np.array([100.0]),
    )


def test_the_bound_never_falls_and_noise_and_force_are_found():
    chains = random_walk(np.random.default_rng(2))
    real = np.ones(chains.drive.shape[:2], dtype=bool)
    noise = normal_noise(chains, [4.0], [0.01])
    bounds = []
    for _ in range(6):
        estimate = estimate_noise(chains, noise, real, floor=np.zeros(1))
        noise = estimate.noise
        bounds.append(estimate.bound)
    assert np.all(np.diff(bounds) >= -1e-9)
    assert np.sqrt(noise.error[0]) == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(noise.force[0]) == pytest.approx(0.3, abs=0.1)


def test_heavy_tails_are_noticed_and_normal_ones_are_not():
    for nu, heavy in ((3.0, True), (np.inf, False)):
        chains = random_walk(np.random.default_rng(3), nu=nu)
        real = np.ones(chains.drive.shape[:2], dtype=bool)
        estimate = estimate_noise(chains, normal_noise(chains, [0.1], [1.0]), real, floor=np.zeros(1))
        assert np.isfinite(estimate.noise.error_nu[0]) == heavy
        if not heavy:
            assert np.sqrt(estimate.noise.error[0]) == pytest.approx(1.0, abs=0.15)


def test_a_force_with_memory_is_told_from_a_white_one_by_the_bound():
    gains = []
    for memory in (0.9, 0.0):
        chains = random_walk(np.random.default_rng(4), memory=memory, error=0.5)
        real = np.ones(chains.drive.shape[:2], dtype=bool)
        white = estimate_noise(chains, normal_noise(chains, [0.3], [0.3]), real, floor=np.zeros(1))
        both = chains.with_memory(Memory(1, 0.9))
        start = normal_noise(both, [0.1, 0.1], [0.3, 1.0])
        gains.append(estimate_noise(both, start, real, floor=np.zeros(2)).bound - white.bound)
    assert gains[0] > 20
    assert gains[1] < 6


@pytest.mark.parametrize("returns", [False, True])
def test_a_force_of_memory_is_at_all_times_what_all_steps_before_have_made_it(returns):
    memory, force = Memory(2, 0.95, returns), np.array([0.2, 3.0])
    chains = Chains(
        np.tile(np.eye(2), (1, 6, 1, 1)),
        np.zeros((1, 6, 2)),
        np.zeros((1, 6, 2, 2)),
        np.tile(np.eye(2), (1, 6, 1, 1)),
        np.zeros((1, 7, 2)),
        np.zeros((1, 7, 2), dtype=bool),
        np.ones(2),
    ).with_memory(memory)
    forces = np.tile(np.r_[1.0, 1.0, force], (1, 6, 1))
    spread = kalman_filter(chains, forces, np.ones((1, 7, 4))).covariances[0, :, 2:, 2:]
    steady = np.diag(memory.steady(force))
    np.testing.assert_allclose(spread, np.tile(steady, (7, 1, 1)), rtol=1e-12)


def test_a_force_that_is_not_there_costs_a_log_nothing_however_many_chains_it_is_cut_into():
    rng = np.random.default_rng(6)
    measured = np.cumsum(rng.normal(size=241))
    for n in (1, 8):
        steps = 240 // n
        pieces = np.stack([measured[one * steps : (one + 1) * steps + 1] for one in range(n)])[..., None]
        flat = np.ones((n, steps, 1, 1))
        seen = np.ones(pieces.shape, dtype=bool)
        chains = Chains(flat, 0 * flat[..., 0], 0 * flat, flat, pieces, seen, np.full(1, 100.0))
        real = np.ones((n, steps), dtype=bool)
        white = estimate_noise(chains, normal_noise(chains, [1.0], [0.1]), real, floor=np.zeros(1))
        both = chains.with_memory(Memory(1, 0.95))
        start = normal_noise(both, [1.0, 0.01], [0.1, 1.0])
        bound = estimate_noise(both, start, real, floor=np.zeros(2)).bound
        # Its variance may be zero.
        assert white.bound - 0.2 < bound < white.bound + 4


def test_of_a_force_that_returns_nothing_is_left():
    """Its pushes add up to what is hidden of them, which fades."""
    memory, rng = Memory(1, 0.7, returns=True), np.random.default_rng(0)
    fresh, hidden, forces = rng.normal(size=400), 0.0, []
    for push in fresh:
        forces.append(memory.acting(push, hidden))
        hidden = memory.share * hidden + memory.kept(push)
    assert np.sum(forces) == pytest.approx(hidden / (1 - 0.7))
    assert np.var(forces) == pytest.approx(float(memory.variance(1.0)), rel=0.15)
    slow, fast = (
        np.mean(np.abs(np.fft.rfft(forces)[part]) ** 2) for part in (slice(1, 10), slice(-50, None))
    )
    assert fast > 10 * slow


@pytest.mark.parametrize("returns", [False, True])
def test_forces_with_memory_have_the_likelihood_of_their_dense_covariance(returns):
    """Of a place that is moved by them, and read with noise: from the recursion, push by push."""
    rows, memory, fresh, error = 7, Memory(1, 0.6, returns), 0.5, 0.2
    rng = np.random.default_rng(1)
    measured = rng.normal(size=(1, rows + 1, 1))
    chains = Chains(
        np.ones((1, rows, 1, 1)), np.zeros((1, rows, 1)), np.zeros((1, rows, 1, 1)), np.ones((1, rows, 1, 1)), measured,
        np.ones((1, rows + 1, 1), bool), np.array([4.0]),
    )  # fmt: skip
    steady = memory.steady(np.array([fresh]))
    both = chains.with_memory(memory)
    force, errors = np.tile([0.0, fresh], (1, rows, 1)), np.tile([error, 1.0], (1, rows + 1, 1))
    found = kalman_filter(both, force, errors).log_likelihood
    # Columns: the first place, what is hidden at first, and the pushes.
    places = np.zeros((rows + 1, rows + 2))
    places[:, 0] = 1.0
    hidden = np.zeros(rows + 2)
    hidden[1] = 1.0
    for row in range(rows):
        push = np.zeros(rows + 2)
        push[2 + row] = 1.0
        places[row + 1 :] += push - hidden if returns else hidden
        hidden = 0.6 * hidden + (0.4 * push if returns else push)
    covariance = (places * np.r_[4.0, steady, np.full(rows, fresh)]) @ places.T + error * np.eye(rows + 1)
    dense = stats.multivariate_normal(np.zeros(rows + 1), covariance).logpdf(measured[0, :, 0])
    assert found == pytest.approx(dense, rel=1e-9)


def test_the_bound_is_near_the_likelihood_by_quadrature():
    rng = np.random.default_rng(5)
    measured, scale, nu = 1.5 * rng.standard_t(3, size=12), 1.2, 3.0
    chains = Chains(
        np.zeros((12, 1, 1, 1)),
        np.zeros((12, 1, 1)),
        np.zeros((12, 1, 1, 1)),
        np.zeros((12, 1, 1, 1)),
        np.stack([0 * measured, measured], axis=1)[..., None],
        np.stack([np.zeros(12, bool), np.ones(12, bool)], axis=1)[..., None],
        np.ones(1),
    )
    weights = np.ones((12, 2, 1))
    weights[:, 1, 0] = (nu + 1) / (nu + measured**2 / scale)
    noise = Noise(
        *(np.array([[one]]) for one in (1.0, scale, np.inf, nu)),
        np.zeros(12, dtype=int),
        np.ones((12, 1, 1)),
        weights,
    )
    bound = passed(chains, noise, np.ones((12, 1), dtype=bool)).bound
    exact = 0.0
    for value in measured:
        law = stats.gamma(nu / 2, scale=2 / nu)
        density, _ = integrate.quad(
            lambda lam, value=value, law=law: (
                law.pdf(lam) * stats.norm.pdf(value, scale=np.sqrt(scale / lam))
            ),
            0,
            60,
        )
        exact += np.log(density)
    assert exact - 0.1 <= bound <= exact + 1e-6
    assert student_log_density(measured**2, scale, nu).sum() == pytest.approx(exact, abs=1e-6)


# -- forces that act together ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("memory", [NO_MEMORY, Memory(2, 0.6), Memory(2, 0.6, returns=True)])
def test_slopes_by_how_forces_act_together_are_those_of_the_likelihood(log, memory):
    chains, forces, errors = log
    chains = chains.with_memory(memory)
    forces = np.concatenate([forces, 0.5 + forces], axis=2) if memory else forces
    errors = np.pad(errors, [(0, 0), (0, 0), (0, 2 if memory else 0)], constant_values=1.0)
    # What is hidden at first has the variance of the pushes, which are those of the first step at all times.
    forces = np.repeat(forces[:, :1], forces.shape[1], axis=1)
    mixing = np.tile([[1.0, 0.0], [0.7, 1.0]], (len(forces), 1, 1))

    def likelihood(step):
        mixed = chains.mixed(mixing @ (np.eye(2) + step * np.array([[0, 0], [1, 0]])))
        return kalman_filter(mixed, forces, errors).log_likelihood

    whole = chains.mixed(mixing)
    smoothed = smooth(whole, kalman_filter(whole, forces, errors), forces, errors)
    blocks = smoothed.force_scores.sum(axis=(0, 1))
    found = blocks[1, 0] + (blocks[3, 2] if memory else 0.0)
    step = 1e-5
    slope = (likelihood(step) - likelihood(-step)) / (2 * step)
    assert found == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize("share", [0.5, 0.0])
def test_forces_that_act_together_are_told_from_those_that_do_not(share):
    """Two places, read with noise; what pushes the first pushes the second by a share as well."""
    rng, n, steps = np.random.default_rng(6), 6, 300
    pushes = rng.normal(size=(n, steps, 2)) * [1.0, 0.4]
    forces = pushes @ np.array([[1.0, 0.0], [share, 1.0]]).T
    places = np.concatenate([np.zeros((n, 1, 2)), np.cumsum(forces, axis=1)], axis=1)
    eye = np.tile(np.eye(2), (n, steps, 1, 1))
    chains = Chains(
        eye, np.zeros((n, steps, 2)), 0 * eye, eye, places + 0.2 * rng.normal(size=places.shape),
        np.ones(places.shape, dtype=bool), np.full(2, 100.0),
    )  # fmt: skip
    # Neither place acts on the other, and what they have in common shows only if they may have it.
    assert len(chains.parts) == 2
    chains = replace(chains, transitions=eye + 1e-9)
    real = np.ones((n, steps), dtype=bool)
    noise = normal_noise(chains, [1.0, 1.0], [0.1, 0.1])
    apart = estimate_noise(chains, noise, real, floor=np.zeros(2))
    both = estimate_noise(chains, apart.noise.together(2), real, floor=np.zeros(2))
    mixing = both.noise.mixing
    np.testing.assert_array_equal(mixing[0, [0, 0, 1], [0, 1, 1]], [1, 0, 1])
    assert mixing[0, 1, 0] == pytest.approx(share, abs=0.03)
    # From another start the same is found.
    again = estimate_noise(chains, noise.together(2), real, floor=np.zeros(2))
    assert again.bound == pytest.approx(both.bound, abs=0.2)
    # Had the forces been seen it would be worth so much.
    most = -0.5 * n * steps * np.log(1 - np.corrcoef(forces.reshape(-1, 2).T)[0, 1] ** 2)
    assert 0.5 * most - 2 < both.bound - apart.bound < most + 2
    np.testing.assert_allclose(both.noise.joint_force[0], np.diag(np.cov(forces.reshape(-1, 2).T)), rtol=0.15)
    np.testing.assert_allclose(both.noise.on_joints(pushes), pushes @ mixing[0].T)
