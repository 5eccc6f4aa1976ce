"""What the statistical scores promise, by simulation: calibration, centring, bounds, brackets."""

import tracemalloc

import numpy as np
import pytest
from scipy.stats import binom, norm

from skat.gaussian import transport_map
from skat.metrics import (
    AffinityTest,
    affinity_estimate,
    affinity_score,
    affinity_test,
    affinity_upper_bound,
    debiased_affinity_score,
)


def exponential(rng, n_rows, n_features):
    return rng.exponential(size=(n_rows, n_features)) - 1


def bimodal(rng, n_rows, n_features):
    sign = rng.choice([-1.0, 1.0], size=(n_rows, n_features))
    return 0.95 * sign + np.sqrt(1 - 0.95**2) * rng.normal(size=(n_rows, n_features))


def population_score(law):
    """Score of normal rows against independent components of unit variance: that of one component."""
    component = np.sort(law(np.random.default_rng(0), 400_000, 1)[:, 0])
    normal = norm.ppf((np.arange(len(component)) + 0.5) / len(component))
    return 1 - np.sqrt(np.square(component - normal).mean() / 2)


def carried(X, y):
    A = transport_map(np.cov(X.T, ddof=0), np.cov(y.T, ddof=0))
    return (X - X.mean(axis=0)) @ A.T + y.mean(axis=0)


def largest_plausible_count(n_trials, probability):
    return binom.ppf(0.9999, n_trials, probability)


# The quick run has each null once, in as many features as it costs the least in.
@pytest.mark.parametrize(
    ("in_sample", "n_features"),
    [
        (False, 5),
        (True, 2),
        pytest.param(False, 2, marks=pytest.mark.long),
        pytest.param(True, 5, marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize("rows", ["equal numbers", "unequal numbers", "pairs"])
def test_test_rejects_a_right_map_at_most_as_often_as_promised(rows, in_sample, n_features):
    rng = np.random.default_rng(0)
    n_trials, rejected = 80, 0
    for _ in range(n_trials):
        X = exponential(rng, 40, n_features)
        y = exponential(rng, 35 if rows == "unequal numbers" else 40, n_features)
        if rows == "pairs":
            # Partners agree up to noise; the swap of a pair changes nothing in law.
            X, y = X + 0.3 * rng.normal(size=(2, 40, n_features))
        if in_sample:
            X = carried(2 * X, y)
        options = {"paired": rows == "pairs", "in_sample": in_sample, "n_permutations": 9}
        rejected += affinity_test(X, y, **options, random_state=rng.integers(2**31)).p_value <= 0.1
    assert rejected <= largest_plausible_count(n_trials, 0.1)
    # It is not merely that nothing is ever rejected: of 80 that comes in .02 % of runs.
    assert rejected > 0


def test_test_rejects_a_law_of_another_shape():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(150, 2)), bimodal(rng, 150, 2)
    test = affinity_test(X, y, n_permutations=99, random_state=0)
    assert test.p_value <= 0.03
    assert test.score < test.quantile(0.05) < test.quantile(0.5)


def test_pairs_that_agree_are_never_rejected():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(50, 3))
    test = affinity_test(rows, rows, paired=True, n_permutations=19, random_state=0)
    assert test.score == 1.0
    assert test.p_value == 1.0


def test_pairs_score_above_every_null_that_forgets_the_pairing():
    rng = np.random.default_rng(0)
    common = rng.normal(size=(100, 10))
    X, y = common + 0.1 * rng.normal(size=(2, 100, 10))
    forgetful = affinity_test(X, y, n_permutations=19, random_state=0)
    faithful = affinity_test(X, y, paired=True, n_permutations=19, random_state=0)
    assert forgetful.score > forgetful.null_scores.max() + 0.1
    assert faithful.null_scores.min() - 0.02 < faithful.score < faithful.null_scores.max() + 0.02


def test_fitted_rows_without_saying_so_reject_too_rarely():
    rng = np.random.default_rng(0)
    p_values = {True: [], False: []}
    for _ in range(30):
        X, y = rng.normal(size=(2, 40, 2))
        for in_sample, values in p_values.items():
            test = affinity_test(carried(X, y), y, in_sample=in_sample, n_permutations=19, random_state=0)
            values.append(test.p_value)
    assert np.mean(p_values[False]) > np.mean(p_values[True]) + 0.1


def test_null_scores_do_not_depend_on_threads():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(2, 40, 2))
    one, two = (affinity_test(X, y, n_permutations=9, random_state=3, n_jobs=n_jobs) for n_jobs in (1, 2))
    np.testing.assert_array_equal(one.null_scores, two.null_scores)


def test_p_value_by_hand():
    assert AffinityTest(0.2, 0.5, np.array([0.1, 0.3, 0.5])).quantile(0.5) == 0.3


@pytest.mark.parametrize("n_features", [2, 27])
@pytest.mark.parametrize("in_sample", [False, True])
def test_debiased_score_is_centred_where_the_map_is_right(n_features, in_sample):
    rng = np.random.default_rng(0)
    squares = []
    for _ in range(30):
        X, y = exponential(rng, 200, n_features), exponential(rng, 200, n_features)
        score = debiased_affinity_score(
            carried(X, y) if in_sample else X,
            y,
            in_sample=in_sample,
            n_repeats=2,
            random_state=rng.integers(2**31),
        )
        squares.append(np.sign(1 - score) * (1 - score) ** 2)
    standard_error = np.std(squares) / np.sqrt(len(squares))
    assert abs(np.mean(squares)) < 4 * standard_error
    assert standard_error < 0.01


def test_debiased_score_forgets_pairs():
    rng = np.random.default_rng(0)
    common = rng.normal(size=(400, 10))
    paired = common + 0.1 * rng.normal(size=(2, 400, 10))
    assert affinity_score(*paired) > 0.8
    assert debiased_affinity_score(*paired, random_state=0) == pytest.approx(1, abs=0.12)


def test_debiased_score_hides_non_affinity_in_many_dimensions():
    rng = np.random.default_rng(0)
    truth = population_score(bimodal)
    for n_features, low, high in [(2, -0.03, 0.04), (27, 0.1, 0.2)]:
        X, y = rng.normal(size=(800, n_features)), bimodal(rng, 800, n_features)
        assert truth + low < debiased_affinity_score(X, y, n_repeats=8, random_state=0) < truth + high


def test_debiased_score_names_what_it_needs():
    with pytest.raises(ValueError, match="3 source and 9 target rows"):
        debiased_affinity_score(np.eye(3), np.ones((9, 3)))


@pytest.mark.parametrize("law", [exponential, bimodal])
@pytest.mark.parametrize("n_rows", [pytest.param(200, marks=pytest.mark.long), 1000])
def test_upper_bound_holds_in_expectation(law, n_rows):
    rng = np.random.default_rng(0)
    truth = (1 - population_score(law)) ** 2
    squares = []
    for _ in range(20):
        mixing, _ = np.linalg.qr(rng.normal(size=(5, 5)))
        X, y = rng.normal(size=(n_rows, 5)), law(rng, n_rows, 5) @ mixing
        squares.append((1 - affinity_upper_bound(X, y, random_state=rng.integers(2**31))) ** 2)
    assert np.mean(squares) < truth + 3 * np.std(squares) / np.sqrt(len(squares))
    if n_rows == 1000:
        assert np.mean(squares) > 0.8 * truth


def test_upper_bound_sees_in_many_dimensions_what_debiasing_hides():
    rng = np.random.default_rng(0)
    mixing, _ = np.linalg.qr(rng.normal(size=(27, 27)))
    X, y = rng.normal(size=(2000, 27)), bimodal(rng, 2000, 27) @ mixing
    bound = affinity_upper_bound(X, y, random_state=0)
    assert population_score(bimodal) - 0.01 < bound < population_score(bimodal) + 0.03


@pytest.mark.parametrize("n_features", [1, 2, 27])
def test_upper_bound_of_one_law_is_about_one(n_features):
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(5, 2, 1000, n_features))
    scores = [affinity_upper_bound(X, y, random_state=0) for X, y in samples]
    assert np.mean(np.square(np.subtract(1, scores))) < 0.003


def test_upper_bound_uses_all_rows_of_the_larger_sample():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(5000, 3)), exponential(rng, 500, 3)
    truth = population_score(exponential)
    assert affinity_upper_bound(X, y, random_state=0) == pytest.approx(truth, abs=0.05)
    assert affinity_upper_bound(y, X, random_state=0) == pytest.approx(truth, abs=0.05)


def test_upper_bound_takes_constant_and_duplicated_columns():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(400, 2)), exponential(rng, 400, 2)
    padded = [np.column_stack([rows, rows[:, 0], np.ones(400)]) for rows in (X, y)]
    assert affinity_upper_bound(*padded, random_state=0) == pytest.approx(
        affinity_upper_bound(X, y, random_state=0), abs=0.05
    )


def test_upper_bound_names_what_it_needs():
    with pytest.raises(ValueError, match=r"7 source and 9 target rows\. Give at least eight"):
        affinity_upper_bound(np.eye(9)[:7], np.eye(9))


@pytest.mark.parametrize("law", [exponential, bimodal])
@pytest.mark.parametrize("n_features", [2, 27])
def test_estimate_brackets_the_population(law, n_features):
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(10_000, n_features)), law(rng, 10_000, n_features)
    estimate = affinity_estimate(X, y, n_block_rows=250, random_state=0)
    truth = population_score(law)
    assert estimate.lower < truth < estimate.score + 0.02
    assert estimate.score <= estimate.upper
    assert float(estimate) == estimate.score == pytest.approx(truth, abs=0.04)


def test_estimate_is_below_one_only_by_noise_where_the_map_is_right():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(2, 10_000, 27))
    estimate = affinity_estimate(X, y, n_block_rows=250, random_state=0)
    assert (1 - estimate.score) ** 2 < 4 * estimate.standard_error
    assert estimate.lower < 0.3


def test_pairs_sharpen_the_lower_end_only():
    rng = np.random.default_rng(0)
    common = rng.normal(size=(4000, 10))
    X, y = common + 0.1 * rng.normal(size=(2, 4000, 10))
    blind = affinity_estimate(X, y, n_block_rows=250, random_state=0)
    paired = affinity_estimate(X, y, n_block_rows=250, paired=True, random_state=0)
    assert paired.lower > blind.lower + 0.3
    assert (paired.score, paired.upper) == (blind.score, blind.upper)


def test_lower_end_is_below_the_exact_score_of_all_rows_in_the_mean():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(800, 5)), bimodal(rng, 800, 5)
    lower = [affinity_estimate(X, y, random_state=seed).lower for seed in range(5)]
    assert max(lower) < affinity_score(X, y)


def test_estimate_needs_memory_linear_in_the_rows():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(2, 60_000, 3))
    tracemalloc.start()
    affinity_estimate(X, y, n_block_rows=100, n_blocks=2, random_state=0)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # The cost matrix would be 29 GB; the rows are 3 MB.
    assert peak < 10 * (X.nbytes + y.nbytes)


def test_estimate_names_what_it_needs():
    with pytest.raises(ValueError, match=r"5 source and 9 target rows\. Give at least eight"):
        affinity_estimate(np.eye(9)[:5], np.eye(9))
    with pytest.raises(ValueError, match=r"there are 10 and 9\. Give the rows in pairs"):
        affinity_estimate(np.ones((10, 9)), np.eye(9), paired=True)
    with pytest.raises(ValueError, match=r"there are 10 and 9\. Give the rows in pairs"):
        affinity_test(np.ones((10, 9)), np.eye(9), paired=True)
    with pytest.raises(ValueError, match="all 9 target rows are equal"):
        affinity_estimate(np.eye(9), np.ones((9, 9)))


@pytest.mark.parametrize(
    ("function", "parameter", "value"),
    [
        (affinity_test, "n_permutations", 0),
        (debiased_affinity_score, "n_repeats", 0),
        (debiased_affinity_score, "n_block_rows", 1),
        (affinity_estimate, "n_blocks", 1),
        (affinity_estimate, "n_block_rows", 1),
    ],
)
def test_numbers_that_no_statistic_can_be_made_of_are_refused(function, parameter, value):
    rows = np.random.default_rng(0).normal(size=(40, 2))
    with pytest.raises(ValueError, match=rf"{parameter} == {value}, must be >= "):
        function(rows, rows, **{parameter: value})


def test_a_test_of_more_rows_than_a_third_of_those_fitted_warns():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(2, 40, 2))
    affinity_test(X, y, n_fitted=120, n_permutations=1, random_state=0)
    with pytest.warns(UserWarning, match="fitted to 119 rows and 40 are tested"):
        affinity_test(X, y, n_fitted=119, n_permutations=1, random_state=0)


def test_p_values_of_held_out_rows_are_uniform_for_heavy_tails_too():
    rng = np.random.default_rng(0)
    p_values = [
        affinity_test(*rng.standard_t(3, size=(2, 15, 2)), n_permutations=9, random_state=seed).p_value
        for seed in range(200)
    ]
    # Ten values, each as likely as the others: chi-square of 9 degrees of freedom, below 27.9 in 999 of 1,000.
    counts = np.bincount(np.round(10 * np.array(p_values)).astype(int), minlength=11)[1:]
    assert (np.square(counts - 20) / 20).sum() < 27.9


def test_debiased_score_takes_four_rows_and_one_repeat():
    X, y = np.random.default_rng(0).normal(size=(2, 4, 2))
    assert np.isfinite(debiased_affinity_score(X, y, n_repeats=1, random_state=0))
