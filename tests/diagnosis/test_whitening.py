"""Whitening, smoothing and noise estimation against dense algebra and simulated noise."""

import numpy as np
import pytest

from skat.diagnosis.whitening import LARGEST_SQUARE, block_cholesky, estimate_variances

N_CHAINS, N_STEPS, N_CHANNELS = 3, 6, 4


@pytest.fixture
def chains():
    """Return transitions, variances, extra variances and presence of a few chains, one with a gap."""
    rng = np.random.default_rng(0)
    transitions = rng.normal(size=(N_CHAINS, N_STEPS, N_CHANNELS, N_CHANNELS))
    variances = np.array([0.5, 1.0, 2.0, 0.1])
    extra = rng.uniform(0, 0.3, size=(N_CHAINS, N_STEPS, N_CHANNELS))
    present = np.ones((N_CHAINS, N_STEPS), dtype=bool)
    present[1, 3] = False
    return transitions, variances, extra, present


def moving_average(transitions, present):
    """Return M with r = M e for the noise e_0 ... e_T of a chain; rows that are missing are left out."""
    M = np.zeros((N_STEPS * N_CHANNELS, (N_STEPS + 1) * N_CHANNELS))
    for t in range(N_STEPS):
        row = slice(t * N_CHANNELS, (t + 1) * N_CHANNELS)
        M[row, t * N_CHANNELS : (t + 1) * N_CHANNELS] = -transitions[t]
        M[row, (t + 1) * N_CHANNELS : (t + 2) * N_CHANNELS] = np.eye(N_CHANNELS)
    return M[np.repeat(present, N_CHANNELS)]


def dense(chain, chains):
    """Return (M, R, C) of a chain: r = M e, e ~ (0, R), C = M R M^T + Q."""
    transitions, variances, extra, present = chains
    M = moving_average(transitions[chain], present[chain])
    R = np.diag(np.tile(variances, N_STEPS + 1))
    return M, R, M @ R @ M.T + np.diag(extra[chain][present[chain]].ravel())


def test_whitening_is_the_inverse_cholesky_factor_of_the_full_covariance(chains):
    present = chains[3]
    whitener = block_cholesky(*chains)
    residuals = np.random.default_rng(1).normal(size=(N_CHAINS, N_STEPS, N_CHANNELS))
    white = whitener.whiten(residuals)
    for chain in range(N_CHAINS):
        factor = np.linalg.cholesky(dense(chain, chains)[2])
        expected = np.linalg.solve(factor, residuals[chain][present[chain]].ravel())
        np.testing.assert_allclose(white[chain][present[chain]].ravel(), expected, rtol=1e-9, atol=1e-9)


def test_blocks_of_the_factor_multiply_to_the_covariance(chains):
    transitions, variances, extra, present = chains
    whitener = block_cholesky(transitions, variances, extra, np.ones_like(present))
    R = np.diag(variances)
    for t in range(N_STEPS):
        factor, gain, A = whitener.factors[0, t], whitener.gains[0, t], transitions[0, t]
        np.testing.assert_allclose(
            factor @ factor.T + gain @ gain.T, A @ R @ A.T + R + np.diag(extra[0, t]), atol=1e-8
        )
        if t:
            np.testing.assert_allclose(gain @ whitener.factors[0, t - 1].T, -A @ R, atol=1e-10)


def test_missing_residuals_carry_no_evidence(chains):
    whitener = block_cholesky(*chains)
    residuals = np.random.default_rng(1).normal(size=(N_CHAINS, N_STEPS, N_CHANNELS))
    changed = residuals.copy()
    changed[1, 3] = 1e6
    np.testing.assert_array_equal(whitener.whiten(residuals), whitener.whiten(changed))
    assert not whitener.whiten(residuals)[1, 3].any()
    np.testing.assert_array_equal(whitener.smooth(residuals), whitener.smooth(changed))


def test_columns_are_whitened_as_residuals_are(chains):
    whitener = block_cholesky(*chains)
    columns = np.random.default_rng(2).normal(size=(N_CHAINS, N_STEPS, N_CHANNELS, 3))
    white, weights = whitener.whiten(columns), whitener.unwhiten_adjoint(columns)
    for k in range(3):
        np.testing.assert_allclose(white[..., k], whitener.whiten(columns[..., k]), atol=1e-12)
        np.testing.assert_allclose(weights[..., k], whitener.unwhiten_adjoint(columns[..., k]), atol=1e-12)


def test_adjoint_is_the_transpose_of_whitening(chains):
    whitener = block_cholesky(*chains)
    rng = np.random.default_rng(3)
    left, right = rng.normal(size=(2, N_CHAINS, N_STEPS, N_CHANNELS))
    left[1, 3] = 0
    np.testing.assert_allclose(
        np.sum(left * whitener.whiten(right)), np.sum(whitener.unwhiten_adjoint(left) * right), rtol=1e-10
    )


def test_adjoint_of_whitened_residuals_is_the_inverse_covariance_times_them(chains):
    present = chains[3]
    whitener = block_cholesky(*chains)
    residuals = np.random.default_rng(4).normal(size=(N_CHAINS, N_STEPS, N_CHANNELS))
    weights = whitener.unwhiten_adjoint(whitener.whiten(residuals))
    for chain in range(N_CHAINS):
        expected = np.linalg.solve(dense(chain, chains)[2], residuals[chain][present[chain]].ravel())
        np.testing.assert_allclose(weights[chain][present[chain]].ravel(), expected, rtol=1e-8, atol=1e-8)


def test_smoothing_is_the_conditional_mean_of_the_noise(chains):
    present = chains[3]
    whitener = block_cholesky(*chains)
    residuals = np.random.default_rng(5).normal(size=(N_CHAINS, N_STEPS, N_CHANNELS))
    smoothed = whitener.smooth(residuals)
    for chain in range(N_CHAINS):
        M, R, C = dense(chain, chains)
        expected = R @ M.T @ np.linalg.solve(C, residuals[chain][present[chain]].ravel())
        np.testing.assert_allclose(
            smoothed[chain].ravel(), expected[: N_STEPS * N_CHANNELS], rtol=1e-8, atol=1e-8
        )


def test_smoothing_knows_what_it_leaves_unknown(chains):
    covariances = block_cholesky(*chains).smoothed_covariances()
    for chain in range(N_CHAINS):
        M, R, C = dense(chain, chains)
        expected = R - R @ M.T @ np.linalg.solve(C, M @ R)
        for t in range(N_STEPS):
            block = slice(t * N_CHANNELS, (t + 1) * N_CHANNELS)
            np.testing.assert_allclose(covariances[chain, t], expected[block, block], rtol=1e-8, atol=1e-8)


def test_smoothing_error_is_uncorrelated_with_the_residuals(chains):
    transitions, variances, _, _ = chains
    present = np.ones((1, N_STEPS), dtype=bool)
    whitener = block_cholesky(transitions[:1], variances, np.zeros((1, N_STEPS, N_CHANNELS)), present)
    M = moving_average(transitions[0], present[0])
    R = np.diag(np.tile(variances, N_STEPS + 1))
    size = N_STEPS * N_CHANNELS
    smoother = np.stack(
        [whitener.smooth(unit.reshape(1, N_STEPS, N_CHANNELS)).ravel() for unit in np.eye(size)],
        axis=1,
    )
    left = np.eye(size, R.shape[0]) - smoother @ M
    np.testing.assert_allclose(left @ R @ M.T, 0, atol=1e-8)
    # At the measured state itself, the error of a derivative is correlated with the residual.
    assert np.abs(np.eye(size, R.shape[0]) @ R @ M.T).max() > 0.1


def simulated(seed, *, tails=None, n_rows=800):
    """Return residuals r = e' - A e and their transitions, and the variances of e."""
    rng = np.random.default_rng(seed)
    variances = np.array([1e-4, 0.04, 1.0])
    transitions = np.eye(3) + rng.normal(scale=0.3, size=(n_rows, 3, 3)) * np.sqrt(
        variances[:, None] / variances
    )
    draw = rng.normal if tails is None else lambda size: rng.standard_t(tails, size) * np.sqrt(1 - 2 / tails)
    noise = draw(size=(n_rows + 1, 3)) * np.sqrt(variances)
    residuals = noise[1:] - np.einsum("nij,nj->ni", transitions, noise[:-1])
    return residuals, transitions, variances


@pytest.mark.parametrize(("tails", "bias"), [(None, 0.03), (5, 0.08)])
def test_noise_is_recovered_from_the_size_of_residuals(tails, bias):
    ratios = []
    for seed in range(20):
        residuals, transitions, variances = simulated(seed, tails=tails)
        found = estimate_variances(
            residuals, transitions, np.zeros_like(residuals), smallest=1e-12 * variances
        )
        ratios.append(np.sqrt(found / variances))
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1, atol=bias)
    np.testing.assert_allclose(ratios, 1, atol=0.25)


def test_rows_at_contacts_do_not_pass_for_noise():
    residuals, transitions, variances = simulated(0, n_rows=2000)
    share = 1 / 50
    residuals[::50] *= 30
    found = estimate_variances(residuals, transitions, np.zeros_like(residuals), smallest=1e-12 * variances)
    assert (np.mean(residuals**2, axis=0) > 10 * variances).all()
    # Cut squares count LARGEST_SQUARE times the variance found; 10 % for the chance of 2000 rows.
    assert (found < 1.1 * (1 - share) / (1 - LARGEST_SQUARE * share) * variances).all()


def test_variance_that_curvature_adds_is_not_counted_as_noise():
    rng = np.random.default_rng(7)
    extra = np.full((4000, 1), 3.0)
    residuals = rng.normal(size=(4000, 1)) * np.sqrt(1.0 + extra)
    transitions = np.zeros((4000, 1, 1))
    found = estimate_variances(residuals, transitions, extra, smallest=np.array([1e-12]))
    np.testing.assert_allclose(found, 1.0, atol=4 * 4 * np.sqrt(2 / 4000))


def test_neighbours_tell_apart_what_sizes_cannot():
    """Sizes are the same for all R0 and R1 with R0 + R1 / 4 alike; the products of neighbours are not."""
    transitions = np.tile([[0.0, 0.5], [2.0, 0.0]], (800, 1, 1))
    ratios = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        variances = [1.0, 4.0] * np.exp(rng.uniform(-0.7, 0.7, size=2))
        noise = rng.normal(size=(801, 2)) * np.sqrt(variances)
        residuals = noise[1:] - np.einsum("nij,nj->ni", transitions, noise[:-1])
        follows = np.arange(800) % 50 > 0
        found = estimate_variances(
            residuals, transitions, np.zeros((800, 2)), smallest=1e-12 * variances, follows=follows
        )
        ratios.append(found / variances)
    # Errors of about 0.1; sizes alone leave R0 between none and twice its value.
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1, atol=0.07)
    np.testing.assert_allclose(ratios, 1, atol=0.4)


def test_misses_that_neighbours_have_in_common_do_not_pass_for_the_absence_of_noise():
    residuals, transitions, variances = simulated(0)
    residuals += 5 * np.sqrt(variances) * np.sin(np.arange(800) / 20)[:, None]
    extra, smallest = np.zeros_like(residuals), 1e-12 * variances
    follows = np.arange(800) % 50 > 0
    found = estimate_variances(residuals, transitions, extra, smallest=smallest, follows=follows)
    np.testing.assert_array_equal(found, estimate_variances(residuals, transitions, extra, smallest=smallest))


@pytest.mark.parametrize("follows", [None, np.arange(800) % 50 > 0])
def test_noise_does_not_depend_on_units(follows):
    residuals, transitions, variances = simulated(0)
    units = np.array([1e-7, 1e3, 1e-4])
    found, scaled = (
        estimate_variances(
            residuals * unit,
            transitions * unit[:, None] / unit,
            np.zeros_like(residuals),
            smallest=1e-12 * variances * unit**2,
            follows=follows,
        )
        for unit in (np.ones(3), units)
    )
    np.testing.assert_allclose(scaled / units**2, found, rtol=1e-9)


def test_estimated_noise_is_never_below_the_smallest():
    residuals = np.zeros((30, 2))
    smallest = np.array([1e-6, 1e-3])
    found = estimate_variances(residuals, np.zeros((30, 2, 2)), residuals, smallest=smallest)
    np.testing.assert_array_equal(found, smallest)
