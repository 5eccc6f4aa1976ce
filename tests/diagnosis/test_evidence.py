"""Gains, Wald statistics and family-wise p-values against explicit regressions and simulation."""

import numpy as np
import pytest
from scipy import stats

from skat.diagnosis.evidence import as_good, fall_p_value, family_p_value, grams, screen, wald
from skat.diagnosis.omnibus import _score_test, hat_functions
from skat.effects import Effect

N_BLOCKS, BLOCK, N_CHANNELS, N_EFFECTS = 60, 8, 3, 4
NAMES = ("a", "b", "c", "d")
WIDE = {name: Effect(name, unit="1", neutral=0.0, bounds=(-1e3, 1e3)) for name in NAMES}
BLOCKS = np.repeat(np.arange(N_BLOCKS), BLOCK)


def regression(seed, truth=(0.0, 0.0, 0.0, 0.0)):
    """Return residuals = derivatives @ truth + standard normal noise, and the derivatives."""
    rng = np.random.default_rng(seed)
    derivatives = rng.normal(size=(len(BLOCKS), N_CHANNELS, N_EFFECTS))
    derivatives[..., 1] += 0.7 * derivatives[..., 0]
    return derivatives @ np.array(truth) + rng.normal(size=derivatives.shape[:2]), derivatives


def least_squares(residuals, derivatives, weights, columns):
    """Return the coefficients and the weighted loss of an explicit weighted least squares fit."""
    root = np.sqrt(np.repeat(weights, N_CHANNELS))
    design = derivatives.reshape(-1, N_EFFECTS)[:, columns] * root[:, None]
    target = residuals.ravel() * root
    solution = np.linalg.lstsq(design, target, rcond=None)[0]
    return solution, np.sum((target - design @ solution) ** 2)


def test_grams_are_the_sums_over_each_block():
    residuals, derivatives = regression(0)
    weights = np.random.default_rng(1).uniform(0.2, 1, size=len(BLOCKS))
    gram = grams(residuals, derivatives, BLOCKS, weights)
    rows = BLOCKS == 5
    flat = derivatives[rows].reshape(-1, N_EFFECTS)
    W = np.repeat(weights[rows], N_CHANNELS)
    np.testing.assert_allclose(gram.information[5], flat.T @ (W[:, None] * flat), rtol=1e-12)
    np.testing.assert_allclose(gram.scores[5], flat.T @ (W * residuals[rows].ravel()), rtol=1e-10)


def test_screened_move_and_gain_are_those_of_weighted_least_squares():
    residuals, derivatives = regression(0, (0.1, 0.0, -0.2, 0.0))
    weights = np.random.default_rng(1).uniform(0.2, 1, size=len(BLOCKS))
    found = screen(grams(residuals, derivatives, BLOCKS, weights), NAMES, {}, WIDE)
    nothing = np.sum(weights[:, None] * residuals**2)
    for k in range(N_EFFECTS):
        move, loss = least_squares(residuals, derivatives, weights, [k])
        np.testing.assert_allclose(found.moves[k], move[0], rtol=1e-10)
        np.testing.assert_allclose(found.gains[k], nothing - loss, rtol=1e-8)


def test_effects_in_the_model_adapt_when_another_is_screened():
    residuals, derivatives = regression(2, (0.1, 0.0, -0.2, 0.0))
    weights = np.random.default_rng(3).uniform(0.2, 1, size=len(BLOCKS))
    # At the optimum of the effects inside, as the selection is when it looks for one more.
    at, before = least_squares(residuals, derivatives, weights, [0, 2])
    residuals = residuals - derivatives[..., [0, 2]] @ at
    gram = grams(residuals, derivatives, BLOCKS, weights)
    found = screen(gram, NAMES, {"a": at[0], "c": at[1]}, WIDE, fitted=("a", "c"))
    for k in (1, 3):
        moves, loss = least_squares(residuals, derivatives, weights, [0, 2, k])
        np.testing.assert_allclose(found.moves[k], moves[2], rtol=1e-8)
        np.testing.assert_allclose(found.gains[k], before - loss, rtol=1e-6)
    np.testing.assert_array_equal(found.gains[[0, 2]], 0)
    np.testing.assert_array_equal(found.p_values[[0, 2]], 1)


def test_move_stops_at_the_bounds_and_the_gain_with_it():
    residuals, derivatives = regression(0, (0.3, 0.0, 0.0, 0.0))
    ones = np.ones(len(BLOCKS))
    effects = {**WIDE, "a": Effect("a", unit="1", neutral=0.0, bounds=(-0.1, 0.1))}
    found = screen(grams(residuals, derivatives, BLOCKS, ones), NAMES, {}, effects)
    assert found.moves[0] == 0.1
    gain = np.sum(residuals**2) - np.sum((residuals - 0.1 * derivatives[..., 0]) ** 2)
    np.testing.assert_allclose(found.gains[0], gain, rtol=1e-8)


def test_effect_without_a_trace_or_spanned_by_the_model_is_not_significant():
    residuals, derivatives = regression(0, (0.3, 0.0, 0.0, 0.0))
    derivatives[..., 2] = 0
    derivatives[..., 3] = -2 * derivatives[..., 0]
    gram = grams(residuals, derivatives, BLOCKS, np.ones(len(BLOCKS)))
    found = screen(gram, NAMES, {"a": 0.0}, WIDE, fitted=("a",))
    np.testing.assert_array_equal(found.p_values[[2, 3]], 1)
    np.testing.assert_array_equal(found.moves[[2, 3]], 0)


@pytest.mark.parametrize("seed", range(5))
def test_covariance_of_independent_noise_is_that_of_least_squares(seed):
    residuals, derivatives = regression(seed)
    ones = np.ones(len(BLOCKS))
    at = least_squares(residuals, derivatives, ones, list(range(N_EFFECTS)))[0]
    covariance, freedom = wald(grams(residuals - derivatives @ at, derivatives, BLOCKS, ones))
    flat = derivatives.reshape(-1, N_EFFECTS)
    expected = np.diag(np.linalg.inv(flat.T @ flat))
    # Never below what noise alone gives; above it by the chance of 60 blocks, three standard errors of a variance.
    assert (np.diag(covariance) >= expected * (1 - 1e-9)).all()
    assert (np.diag(covariance) <= expected * (1 + 3 * np.sqrt(2 / N_BLOCKS) + N_EFFECTS / N_BLOCKS)).all()
    assert (freedom > N_BLOCKS / 3).all()
    assert (freedom < N_BLOCKS).all()
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9, atol=1e-15)


def test_correlated_noise_within_blocks_widens_the_covariance():
    rng = np.random.default_rng(0)
    derivatives = np.ones((len(BLOCKS), 1, 1))
    ratios = []
    for _ in range(40):
        residuals = rng.normal(size=(N_BLOCKS, 1, 1)).repeat(BLOCK, axis=1).reshape(-1, 1)
        left = residuals - residuals.mean()
        covariance, _ = wald(grams(left, derivatives, BLOCKS, np.ones(len(BLOCKS))))
        ratios.append(covariance[0, 0] * N_BLOCKS)
    # The mean of 60 independent values, each repeated: variance 1/60, not 1/480.
    np.testing.assert_allclose(np.mean(ratios), 1, atol=4 * np.sqrt(2 / N_BLOCKS / 40) + 2 / N_BLOCKS)


def test_effect_that_no_row_shows_has_infinite_variance():
    residuals, derivatives = regression(0)
    derivatives[..., 3] = 0
    covariance, _ = wald(grams(residuals, derivatives, BLOCKS))
    assert np.isinf(covariance[3, 3])
    assert np.isfinite(np.diag(covariance)[:3]).all()


def test_screened_p_values_are_uniform_where_nothing_is_hidden():
    p_values = []
    for seed in range(150):
        residuals, derivatives = regression(1000 + seed)
        p_values.append(screen(grams(residuals, derivatives, BLOCKS), NAMES, {}, WIDE).p_values)
    p_values = np.ravel(p_values)
    # The standard error is never below that of the noise, so that the test may only err to the safe side.
    for level in (0.01, 0.05, 0.2):
        assert np.mean(p_values < level) < level + 3 * np.sqrt(level * (1 - level) / len(p_values))
    assert np.mean(p_values < 0.2) > 0.1


def test_family_p_value_is_that_of_the_smallest_of_uniform_p_values():
    smallest = np.random.default_rng(0).uniform(size=(20000, 7)).min(axis=1)
    for level in (0.01, 0.1, 0.5):
        share = np.mean([family_p_value(p, 7) <= level for p in smallest])
        assert abs(share - level) < 4 * np.sqrt(level * (1 - level) / len(smallest))


def test_family_p_value_keeps_its_digits():
    assert family_p_value(0.03, 1) == pytest.approx(0.03, rel=1e-12)
    assert family_p_value(1e-20, 50) == pytest.approx(50e-20, rel=1e-12)
    assert family_p_value(1.0, 50) == pytest.approx(1.0)
    assert family_p_value(0.5, 2) == pytest.approx(0.75, rel=1e-12)


@pytest.mark.parametrize("degrees_of_freedom", [3, np.inf])
def test_fall_of_the_loss_by_an_effect_that_is_not_there_is_rarely_significant(degrees_of_freedom):
    """The effect is fitted to the noise, as a refit does."""
    rng = np.random.default_rng(0)
    noise = stats.t.rvs(degrees_of_freedom, size=(4000, 20, 30), random_state=rng)
    noise /= np.std(noise)
    direction = rng.normal(size=noise.shape) * rng.choice([0.1, 1.0, 5.0], size=(4000, 20, 1))
    size = np.sum(noise * direction, axis=(1, 2)) / np.sum(direction**2, axis=(1, 2))
    without = np.sum(noise**2, axis=2)
    losses = np.sum((noise - size[:, None, None] * direction) ** 2, axis=2)
    p_values = np.array([fall_p_value(*one) for one in zip(without, losses)])
    for level in (0.1, 0.01, 0.001):
        assert np.mean(p_values < level) <= level + 3 * np.sqrt(level / len(p_values))


def test_fall_counts_where_few_blocks_miss_by_very_different_amounts():
    rng = np.random.default_rng(1)
    losses = rng.chisquare(100, size=40)
    missed = np.where(np.arange(40) % 4 == 0, 10 ** rng.uniform(1.5, 3.5, size=40), 0.0)
    of_falls = stats.ttest_1samp(missed, 0.0, alternative="greater").pvalue
    assert fall_p_value(losses + missed, losses) < 0.2 * of_falls
    assert fall_p_value(losses, losses + missed) > 0.5
    assert fall_p_value(losses, losses) > 0.4
    assert fall_p_value(losses[:1] + 1e4, losses[:1]) == 1.0


def test_few_blocks_that_happen_to_agree_prove_nothing():
    """Quantised measurements make residuals equal, and with them the falls of the loss."""
    without, losses = np.full(20, 10.0), np.full(20, 10.0)
    without[:2] += 2.25
    assert fall_p_value(without, losses) > 0.05
    assert fall_p_value(without[:2], losses[:2]) > 0.05
    assert fall_p_value(losses + 1e-9, losses) > 0.05


def test_models_that_differ_by_what_a_refit_leaves_are_as_good():
    losses = np.full(50, 1e-12)
    assert as_good(losses + 1e-5, losses)
    assert not as_good(losses + 1.0, losses)


@pytest.mark.parametrize("start", [-0.5, 10.0, 1000.0])
def test_degrees_of_freedom_do_not_depend_on_where_an_input_has_its_zero(start):
    place = np.random.default_rng(0).uniform(size=300)
    derivatives = np.stack([start + place, np.ones(300)], axis=-1)[:, None]
    residuals = np.random.default_rng(1).normal(size=(300, 1))
    covariance, freedom = wald(grams(residuals, derivatives, np.arange(300)))
    leverage = (place - place.mean()) ** 2 / np.sum((place - place.mean()) ** 2)
    assert freedom[0] == pytest.approx(1 / np.sum(leverage**2) - 2, rel=0.05)
    assert freedom[1] > 100
    assert covariance[0, 0] >= 0.99 / np.sum((place - place.mean()) ** 2)


def test_hat_functions_sum_to_one_and_span_straight_lines():
    values = np.random.default_rng(0).normal(size=200)
    basis = hat_functions(values)
    np.testing.assert_allclose(basis.sum(axis=1), 1, atol=1e-12)
    low, high = np.quantile(values, [0.02, 0.98])
    line = np.clip(values, low, high)
    solution = np.linalg.lstsq(basis, line, rcond=None)[0]
    np.testing.assert_allclose(basis @ solution, line, atol=1e-10)
    assert hat_functions(np.full(10, 3.0)).shape == (10, 1)


def test_score_test_is_hotelling_and_its_p_values_are_uniform():
    rng = np.random.default_rng(0)
    scores = rng.normal(size=(30, 1)) + 0.3
    np.testing.assert_allclose(_score_test(scores), stats.ttest_1samp(scores[:, 0], 0).pvalue, rtol=1e-9)
    mixed = rng.normal(size=(2, 2))
    p_values = [_score_test(rng.normal(size=(30, 2)) @ mixed) for _ in range(500)]
    assert stats.kstest(p_values, "uniform").pvalue > 1e-3
