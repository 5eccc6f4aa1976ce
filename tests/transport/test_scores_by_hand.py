"""Scores of one column, whose exact distance is that of sorted rows, put together by hand from their formulas."""

import numpy as np
import pytest
from sklearn.preprocessing import FunctionTransformer

from skat.metrics import (
    affinity_estimate,
    affinity_score,
    affinity_scorer,
    affinity_test,
    debiased_affinity_score,
    paired_error_scorer,
)
from skat.metrics.marginals import marginal_squares


def samples(n_source, n_target):
    rng = np.random.default_rng(n_source)
    return rng.normal(size=n_source), 0.5 + rng.exponential(size=n_target)


def square(a, b):
    """Return the squared 2-Wasserstein distance of two samples of one size."""
    return np.square(np.sort(a) - np.sort(b)).mean()


def carried(a, b):
    """Return one sample with the mean and the deviation of another."""
    return b.mean() + (a - a.mean()) * b.std() / a.std()


def blocks(x, y, n_block_rows, n_splits, rng):
    """Return pairs of blocks of either side, that are dealt out anew where all rows have been in one."""
    found = []
    while len(found) < n_splits:
        source = rng.permutation(len(x))
        target = source if len(x) == len(y) else rng.permutation(len(y))
        for start in range(0, min(len(x), len(y)) - 2 * n_block_rows + 1, 2 * n_block_rows):
            first, second = (
                slice(start + part * n_block_rows, start + (part + 1) * n_block_rows) for part in (0, 1)
            )
            found.append((x[source[first]], x[source[second]], y[target[first]], y[target[second]]))
    return found[:n_splits]


def squares(x_first, x_second, y_first, y_second, in_sample):
    """Return the mean squared distance between rows of other numbers, and D."""
    fit = carried if in_sample else lambda a, b: a
    between = (square(fit(x_first, y_second), y_second) + square(fit(x_second, y_first), y_first)) / 2
    within = (square(fit(x_first, x_second), x_second) + square(fit(y_first, y_second), y_second)) / 2
    return between, between - within


@pytest.mark.parametrize("in_sample", [False, True])
@pytest.mark.parametrize(
    ("n_source", "n_target", "n_block_rows", "n_repeats"), [(20, 20, 1000, 3), (20, 14, 3, 5), (9, 13, 4, 1)]
)
def test_debiased_score_is_its_formula(n_source, n_target, n_block_rows, n_repeats, in_sample):
    x, y = samples(n_source, n_target)
    size = min(n_block_rows, min(n_source, n_target) // 2)
    parts = blocks(x, y, size, n_repeats, np.random.RandomState(0))
    mean = np.mean([squares(*part, in_sample)[1] for part in parts])
    found = debiased_affinity_score(
        x[:, np.newaxis], y[:, np.newaxis], in_sample=in_sample, n_repeats=n_repeats, n_block_rows=n_block_rows,
        random_state=0,
    )  # fmt: skip
    assert found == pytest.approx(1 - np.sign(mean) * np.sqrt(abs(mean) / (2 * y.var())), rel=1e-9)


@pytest.mark.parametrize(
    ("paired", "in_sample", "n_target"),
    [(False, False, 40), (True, False, 40), (False, True, 33), (False, False, 33)],
)
def test_estimate_is_its_formulas(paired, in_sample, n_target):
    x, y = samples(40, n_target)
    rng, spread = np.random.RandomState(3), 2 * y.var()
    parts = blocks(x, y, 5, 3, rng)
    rows = x[:, np.newaxis], y[:, np.newaxis]
    marginal = np.mean(marginal_squares(*rows, rng))
    between, debiased = np.transpose([squares(*part, in_sample) for part in parts])
    if paired or in_sample:
        between = np.array([(square(a, c) + square(b, d)) / 2 for a, b, c, d in parts])
    found = affinity_estimate(
        *rows, paired=paired, in_sample=in_sample, n_block_rows=5, n_blocks=3, random_state=3
    )
    score = 1 - np.sqrt(max(debiased.mean(), marginal, 0) / spread)
    assert found.score == float(found) == pytest.approx(score, rel=1e-9)
    assert found.lower == pytest.approx(1 - np.sqrt(between.mean() / spread), rel=1e-9)
    assert found.upper == pytest.approx(1 - np.sqrt(max(marginal, 0) / spread), rel=1e-9)
    error = debiased.std(ddof=1) / np.sqrt(3) / spread
    assert found.standard_error == pytest.approx(error, rel=1e-9)
    assert (found.n_block_rows, found.n_blocks) == (5, 3)
    few = affinity_estimate(rows[0][:17], rows[1], random_state=3)
    assert (few.n_block_rows, few.n_blocks) == (4, 2)


def shuffled(x, y, paired, rng):
    if paired:
        swap = rng.random(len(x)) < 0.5
        return np.where(swap, y, x), np.where(swap, x, y)
    pooled = np.concatenate([x, y])
    order = rng.permutation(len(pooled))
    return pooled[order[: len(x)]], pooled[order[len(x) :]]


@pytest.mark.parametrize("in_sample", [False, True])
@pytest.mark.parametrize("paired", [False, True])
def test_shuffles_of_the_test_are_of_pairs_or_of_all_rows_and_fitted_anew(paired, in_sample):
    x, y = samples(15, 15)
    expected = []
    for seed in np.random.RandomState(1).randint(np.iinfo(np.int32).max, size=9):
        rng = np.random.default_rng(seed)
        source = x
        if in_sample:  # a bootstrap of the moments that the fit has made equal
            of_y = rng.exponential(size=15)
            of_x = of_y if paired else rng.exponential(size=15)
            (m_y, s_y), (m_x, s_x) = (
                (np.average(z, weights=w), np.sqrt(np.cov(z, aweights=w, bias=True)))
                for z, w in ((y, of_y), (x, of_x))
            )
            source = m_x + (x - m_y) * s_x / s_y
        first, second = shuffled(source, y, paired, rng)
        if in_sample:
            first, second = carried(first, y), carried(second, y)
        expected.append(1 - np.sqrt(square(first, second) / (2 * second.var())))
    found = affinity_test(
        x[:, np.newaxis],
        y[:, np.newaxis],
        paired=paired,
        in_sample=in_sample,
        n_permutations=9,
        random_state=1,
    )
    score = 1 - np.sqrt(square(x, y) / (2 * y.var()))
    assert found.score == pytest.approx(score, rel=1e-9)
    np.testing.assert_allclose(found.null_scores, np.sort(expected), rtol=1e-8)
    assert found.p_value == pytest.approx((1 + np.sum(np.array(expected) <= score + 1e-12)) / 10)


def stacked():
    """Return stacked rows of two domains, their domains and weights, and the map that doubles source rows."""
    rng = np.random.default_rng(0)
    rows, weight = rng.normal(size=(14, 2)), rng.uniform(0.5, 2, size=14)
    domain = rng.permutation(np.repeat([1, -1], 7))

    class Doubling(FunctionTransformer):
        def transform(self, X, sample_domain=None):
            is_source = np.ones(len(X), bool) if sample_domain is None else np.asarray(sample_domain) == 1
            return np.where(is_source[:, np.newaxis], 2 * np.asarray(X), X)

    return rows, domain, weight, Doubling()


@pytest.mark.parametrize("is_weighted", [False, True])
def test_scorers_compare_carried_source_rows_with_target_rows_by_their_weights(is_weighted):
    rows, domain, weight, double = stacked()
    given = {"sample_weight": weight} if is_weighted else {}
    source, target = rows[domain > 0], rows[domain < 0]
    errors = np.linalg.norm(2 * source - target, axis=1)
    own = weight[domain > 0] if is_weighted else None
    expected = -np.average(errors, weights=own)
    found = paired_error_scorer(double, rows, sample_domain=domain, **given)
    assert found == pytest.approx(expected, rel=1e-12)
    apart = paired_error_scorer(double, source, target, **({"sample_weight": own} if is_weighted else {}))
    assert apart == pytest.approx(expected, rel=1e-12)
    both = (own, weight[domain < 0]) if is_weighted else None
    score = affinity_scorer()(double, rows, sample_domain=domain, **given)
    assert score == pytest.approx(affinity_score(2 * source, target, sample_weight=both), rel=1e-12)
    labelled = affinity_scorer(source_domain="b")
    assert repr(affinity_scorer(affinity_score, n=3)) == "affinity_scorer(affinity_score, n=3)"
    words = np.where(domain > 0, "b", "a")
    with pytest.raises(ValueError, match="source_domain="):
        affinity_scorer()(double, rows, sample_domain=words)
    double.transform = lambda X, sample_domain: np.where((sample_domain == "b")[:, np.newaxis], 2 * X, X)
    assert labelled(double, rows, sample_domain=words, **given) == pytest.approx(score, rel=1e-12)
