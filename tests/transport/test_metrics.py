"""The exact score, distances and bounds: laws, cases by hand and POT as the reference."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from skat import AffineTransport, ExactTransport
from skat.gaussian import gaussian_wasserstein_distance as distance_of_moments
from skat.gaussian import transport_map
from skat.metrics import (
    affine_discrepancy_bound,
    affine_error_bound,
    affinity_estimate,
    affinity_score,
    gaussian_wasserstein_distance,
    gelbrich_bound,
    normal_approximation_bound,
    wasserstein_distance,
)
from skat.metrics.samples import twice_the_spread

seeds = st.integers(0, 2**32 - 1)
dimensions = st.integers(1, 5)


def any_rows(rng, n_rows, n_features):
    """Rows of skewed and heavy-tailed components, mixed."""
    rows = np.where(
        rng.random(n_features) < 0.5,
        rng.exponential(size=(n_rows, n_features)),
        rng.standard_t(3, size=(n_rows, n_features)),
    )
    return rows @ rng.normal(size=(n_features, n_features)) + rng.normal(size=n_features)


def carried(X, y):
    """Carry rows to others by the affine transport between them."""
    A = transport_map(
        np.cov(X.T, ddof=0).reshape(X.shape[1], -1), np.cov(y.T, ddof=0).reshape(X.shape[1], -1)
    )
    return (X - X.mean(axis=0)) @ A.T + y.mean(axis=0)


def test_score_by_hand():
    # W2^2 = 1 for the centred pair, tr Sigma = 1: 1 - 1 / sqrt(2).
    assert affinity_score([[1.0], [1.0]], [[2.0], [0.0]]) == pytest.approx(1 - np.sqrt(0.5), rel=1e-14)
    # All the weight on the equal row: W2 = 0.
    assert affinity_score([[0.0], [9.0]], [[0.0], [2.0]], sample_weight=([1, 0], [1, 0])) == 1.0


def test_score_is_one_for_equal_sets_of_rows():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(50, 3))
    assert affinity_score(rng.permutation(rows), rows) == 1.0


@given(seeds, dimensions)
@settings(max_examples=25, deadline=None)
def test_score_does_not_change_under_common_similarities(seed, n_features):
    rng = np.random.default_rng(seed)
    X, y = any_rows(rng, 30, n_features), any_rows(rng, 40, n_features)
    rotation, _ = np.linalg.qr(rng.normal(size=(n_features, n_features)))
    shift, factor = rng.normal(size=n_features), rng.uniform(0.1, 10)
    moved = affinity_score(factor * X @ rotation + shift, factor * y @ rotation + shift)
    assert moved == pytest.approx(affinity_score(X, y), abs=1e-10)


@given(seeds, dimensions)
@settings(max_examples=25, deadline=None)
def test_score_of_a_transport_fitted_to_the_rows_is_between_zero_and_one(seed, n_features):
    rng = np.random.default_rng(seed)
    X, y = any_rows(rng, 40, n_features), any_rows(rng, 40, n_features)
    assert -1e-9 <= affinity_score(carried(X, y), y) <= 1


def test_score_is_negative_where_the_means_are_far_apart():
    rng = np.random.default_rng(0)
    y = rng.normal(size=(30, 2))
    assert affinity_score(y + 10, y) < -1


def test_score_agrees_with_pot_on_unequal_numbers_and_weights():
    import ot

    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(30, 3)), rng.exponential(size=(45, 3))
    weights = rng.random(30), rng.random(45)
    a, b = (weight / weight.sum() for weight in weights)
    spread = b @ np.square(y - b @ y).sum(axis=1)
    expected = 1 - np.sqrt(ot.emd2(a, b, ot.dist(X, y)) / (2 * spread))
    assert affinity_score(X, y, sample_weight=weights) == pytest.approx(expected, rel=1e-9)


def test_bias_of_the_score_is_as_the_docstring_says():
    rng = np.random.default_rng(0)
    for n_features, documented in [(2, 0.91), (27, 0.33), (62, 0.22)]:
        X, y = rng.normal(size=(2, 1000, n_features))
        assert affinity_score(X, y) == pytest.approx(documented, abs=0.012)


@pytest.mark.parametrize(
    "exact",
    [
        affinity_score,
        wasserstein_distance,
        lambda X, y: ExactTransport().fit(X, y),
    ],
    ids=["affinity_score", "wasserstein_distance", "ExactTransport"],
)
def test_exact_transport_of_too_many_rows_names_the_estimate_before_it_allocates(exact):
    rows = np.zeros((40_000, 1))
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"cost matrix of 13 GB.*affinity_estimate"):
            exact(rows, rows)
        assert tracemalloc.get_traced_memory()[1] < 100 * rows.nbytes
    finally:
        tracemalloc.stop()


@pytest.mark.long  # of fewer rows beyond a smaller limit test_metrics_scorers.py says the same
def test_score_of_too_many_rows_is_the_estimate():
    X, y = np.random.default_rng(0).normal(size=(2, 40_000, 2))
    transport = AffineTransport().fit(X, y)
    expected = affinity_estimate(transport.transform(X), y, random_state=0).score
    assert transport.score(X, y) == expected > 0.9


@pytest.mark.parametrize(
    ("X", "y", "options", "message"),
    [
        ([[0.0, 1.0]], [[1.0], [2.0]], {}, "X_transported has 2, y has 1"),
        ([[0.0]], [[1.0], [np.nan]], {}, "y contains NaN"),
        ([0.0, 1.0], [[1.0], [2.0]], {}, "Expected 2D array"),
        ([[0.0]], [[1.0], [1.0]], {}, "all 2 target rows are equal"),
        ([[0.0]], [[1.0], [2.0]], {"sample_weight": [1.0]}, r"tuple \(source, target\)"),
        ([[0.0]], [[1.0], [2.0]], {"sample_weight": ([1.0], [1.0])}, r"shape \(2,\)"),
        ([[0.0]], [[1.0], [2.0]], {"sample_weight": ([1.0], [1.0, -1.0])}, "minimum is -1.0"),
    ],
)
def test_score_says_what_is_wrong_with_its_arguments(X, y, options, message):
    with pytest.raises(ValueError, match=message):
        affinity_score(X, y, **options)


@given(seeds, dimensions)
@settings(max_examples=25, deadline=None)
def test_gaussian_distance_is_the_formula_of_the_moments(seed, n_features):
    rng = np.random.default_rng(seed)
    X, y = any_rows(rng, 30, n_features), any_rows(rng, 40, n_features)
    moments = [m for rows in (X, y) for m in (rows.mean(axis=0), np.atleast_2d(np.cov(rows.T, ddof=0)))]
    assert gaussian_wasserstein_distance(X, y) == pytest.approx(distance_of_moments(*moments), rel=1e-8)


@given(seeds, dimensions)
@settings(max_examples=50, deadline=None)
def test_gelbrich_bounds_the_distance_from_below(seed, n_features):
    rng = np.random.default_rng(seed)
    X, y = any_rows(rng, 20, n_features), any_rows(rng, 25, n_features)
    assert gelbrich_bound(X, y) <= wasserstein_distance(X, y) * (1 + 1e-9)


@given(seeds, dimensions)
@settings(max_examples=25, deadline=None)
def test_gelbrich_is_the_distance_to_a_positive_definite_image(seed, n_features):
    rng = np.random.default_rng(seed)
    X = any_rows(rng, 30, n_features)
    root = rng.normal(size=(n_features, n_features))
    y = X @ (root @ root.T + 0.1 * np.eye(n_features)) + rng.normal(size=n_features)
    assert gelbrich_bound(X, y) == pytest.approx(wasserstein_distance(X, y), rel=1e-7)


@given(seeds, dimensions)
@settings(max_examples=50, deadline=None)
def test_proposition_1_bounds_the_discrepancy(seed, n_features):
    rng = np.random.default_rng(seed)
    X, y = any_rows(rng, 20, n_features), any_rows(rng, 25, n_features)
    discrepancy = wasserstein_distance(X, y) - gaussian_wasserstein_distance(X, y)
    assert abs(discrepancy) <= affine_discrepancy_bound(X, y) * (1 + 1e-9)


def test_proposition_1_by_hand():
    # Variances 1 and 9 along different axes: orthogonal roots, so no discrepancy is possible.
    assert affine_discrepancy_bound([[-1.0, 0], [1, 0]], [[0, -3.0], [0, 3]]) == 0.0
    # Along one axis: 2 * 3 / sqrt(10).
    assert affine_discrepancy_bound([[-1.0], [1]], [[-3.0], [3]]) == pytest.approx(6 / np.sqrt(10), rel=1e-14)
    assert affine_discrepancy_bound([[1.0]], [[2.0]]) == 0.0


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_corollary_2_bounds_the_distance_to_the_normal_approximation(seed):
    rng = np.random.default_rng(seed)
    rows = np.sort(any_rows(rng, 15, 1), axis=0)
    # In one dimension W2^2 = 2 s^2 - 2 s sum_k x_k int_{(k-1)/n}^{k/n} z; the integral of normal quantiles
    # is a difference of normal densities.
    edges = norm.pdf(norm.ppf(np.linspace(0, 1, len(rows) + 1)))
    deviation = rows.std()
    square = 2 * deviation**2 - 2 * deviation * (rows[:, 0] @ -np.diff(edges))
    assert np.sqrt(square) <= normal_approximation_bound(rows)
    assert normal_approximation_bound(rows) == pytest.approx(np.sqrt(2) * deviation, rel=1e-12)


@given(seeds, dimensions)
@settings(max_examples=25, deadline=None)
def test_proposition_2_bounds_the_error_of_affine_transport(seed, n_features):
    rng = np.random.default_rng(seed)
    X, y = any_rows(rng, 25, n_features), any_rows(rng, 20, n_features)
    assert wasserstein_distance(carried(X, y), y) <= affine_error_bound(y) * (1 + 1e-9)


def test_score_is_measured_in_units_of_proposition_2():
    rng = np.random.default_rng(0)
    X, y = any_rows(rng, 25, 3), any_rows(rng, 20, 3)
    assert affinity_score(X, y) == pytest.approx(
        1 - wasserstein_distance(X, y) / affine_error_bound(y), rel=1e-12
    )


def test_weights_of_bounds_count_rows():
    rng = np.random.default_rng(0)
    X, y = any_rows(rng, 20, 2), any_rows(rng, 20, 2)
    counts = rng.integers(0, 4, size=20)
    for function in (gaussian_wasserstein_distance, gelbrich_bound, affine_discrepancy_bound):
        repeated = function(np.repeat(X, counts, axis=0), np.repeat(y, counts, axis=0))
        assert function(X, y, sample_weight=counts) == pytest.approx(repeated, rel=1e-9)
    for bound in (normal_approximation_bound, affine_error_bound):
        repeated = bound(np.repeat(y, counts, axis=0))
        assert bound(y, sample_weight=counts) == pytest.approx(repeated, rel=1e-12)


@pytest.mark.parametrize("unit", [1e-200, 1e160])
def test_an_affinity_does_not_depend_on_the_unit_where_squares_have_no_room(unit):
    X, y = np.random.default_rng(0).normal(size=(2, 30, 3))
    assert affinity_score(unit * X, unit * (y + 3)) == pytest.approx(affinity_score(X, y + 3), rel=1e-12)
    with pytest.raises(ValueError, match="beyond the range of float64"):
        twice_the_spread(unit * y)
