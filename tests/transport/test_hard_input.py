"""Rows that are far away, tiny, huge, rounded, weightless or not as they should be."""

import warnings

import numpy as np
import pandas as pd
import pytest
from sklearn.covariance import ShrunkCovariance
from sklearn.exceptions import NotFittedError

from skat import (
    CORAL,
    AffineTransport,
    ConditionalAffineTransport,
    ExactTransport,
    ProcrustesAffineTransport,
)
from skat.gaussian import gaussian_wasserstein_distance, transport_map
from skat.metrics import (
    affinity_estimate,
    affinity_score,
    affinity_scorer,
    affinity_test,
    wasserstein_distance,
)
from skat.plotting import TransportDisplay


def deterministic(n_context, offset=0.0, dtype=np.float64, seed=0):
    """Rows of a linear simulation without noise, and measured ones with noise."""
    rng = np.random.default_rng(seed)
    context = rng.normal(size=(300, n_context))
    outcome = context @ rng.normal(size=(n_context, 2)) + offset
    noise = 0.1 * rng.normal(size=outcome.shape)
    return np.hstack([context, outcome]).astype(dtype), np.hstack([context, outcome + noise]).astype(dtype)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("n_context", [1, 2, 4])
@pytest.mark.parametrize(("offset", "dtype"), [(0.3, np.float64), (1e6, np.float64), (0.3, np.float32)])
def test_rounding_of_a_deterministic_simulation_is_no_variance(n_context, offset, dtype, seed):
    X, y = deterministic(n_context, offset, dtype, seed)
    for transport in (
        AffineTransport(),
        ProcrustesAffineTransport(),
        ConditionalAffineTransport(context=n_context, rank_deficient="raise"),
    ):
        with pytest.raises(np.linalg.LinAlgError, match="rank"):
            transport.fit(X, y)


@pytest.mark.parametrize(("offset", "dtype"), [(0.3, np.float64), (1e3, np.float32)])
def test_an_estimator_of_full_rank_has_a_map_where_the_rows_have_none(offset, dtype):
    X, y = deterministic(2, offset, dtype)
    shrunk = ShrunkCovariance(shrinkage=1e-8)
    assert AffineTransport(covariance=shrunk).fit(X, y).rank_ == 4


def test_one_exact_column_beside_others_that_vary_is_no_variance():
    rng = np.random.default_rng(0)
    context = rng.normal(size=(300, 2))
    varying = context @ [[1.0], [0.5]] + 1e-3 * rng.normal(size=(300, 1))
    exact = context.sum(axis=1, keepdims=True)
    X, y = (
        np.hstack([context, varying, exact]),
        np.hstack([context, varying, exact + 0.01 * rng.normal(size=(300, 1))]),
    )
    with pytest.raises(np.linalg.LinAlgError):
        ConditionalAffineTransport(context=2, rank_deficient="raise").fit(X, y)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_what_varies_little_but_more_than_rounding_is_carried(dtype):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(300, 2))
    X = np.column_stack([X, X.sum(axis=1) + 1e-3 * rng.normal(size=300), 1e3 + 1e-2 * rng.normal(size=300)])
    y = X * [1, 2, 1, 1] + [0, 0, 5, 0]
    carried = AffineTransport().fit(X.astype(dtype), y.astype(dtype)).transform(X.astype(dtype))
    np.testing.assert_allclose(np.cov(carried.T), np.cov(y.T), rtol=0.02, atol=1e-3)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("offset", [0.0, 100.0])
def test_columns_that_are_linear_functions_of_others_on_both_sides_do_no_harm(dtype, offset):
    rng = np.random.default_rng(0)
    place, speed = rng.normal(size=(2, 400)) + offset
    sides = {}
    for side, gain in (("source", 1.0), ("target", 1.5)):
        after = gain * speed + 0.1 * rng.normal(size=400)
        rows = np.column_stack([place, speed, place + 0.01 * after, after]).astype(dtype)
        sides[side] = rows
    X, y = sides["source"], sides["target"]
    for transport in (AffineTransport(), ProcrustesAffineTransport(), CORAL()):
        carried = transport.fit(X, y).transform(X)
        np.testing.assert_allclose(carried.mean(axis=0), y.mean(axis=0), rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(np.cov(carried.T), np.cov(y.T), atol=2e-3)


def test_a_constant_column_far_away_is_left_where_it_is():
    rng = np.random.default_rng(0)
    X = np.column_stack([rng.normal(size=(50, 2)), np.full(50, 1e9)])
    for transport in (AffineTransport(), ConditionalAffineTransport(context=[2]), CORAL()):
        np.testing.assert_array_equal(transport.fit(X, X + np.array([1, 1, 0])).transform(X)[:, 2], 1e9)


@pytest.mark.parametrize("scale", [1e-200, 1e-100, 1e-12, 1e-8, 1e8, 1e100, 1e200])
@pytest.mark.parametrize("n_target", [40, 30])
def test_exact_distances_do_not_depend_on_the_unit(scale, n_target):
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(40, 2)), rng.normal(size=(n_target, 2))
    assert wasserstein_distance(scale * X, scale * y) == pytest.approx(
        scale * wasserstein_distance(X, y), rel=1e-9
    )
    near, far = ExactTransport().fit(X, y), ExactTransport().fit(scale * X, scale * y)
    np.testing.assert_allclose(far.coupling_, near.coupling_, atol=1e-12)
    assert far.wasserstein_distance_ == pytest.approx(scale * near.wasserstein_distance_, rel=1e-9)
    if 1e-100 <= scale <= 1e100:
        assert affinity_score(scale * X, scale * y) == pytest.approx(affinity_score(X, y), rel=1e-9)


def test_differences_beyond_the_range_of_numbers_are_refused():
    with pytest.raises(ValueError, match=r"exceed the range of float64\. Choose larger units"):
        wasserstein_distance([[-1.5e308], [0.0]], [[1.5e308], [1.0]])
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="squares of X or y exceed the range of float64"):
        AffineTransport().fit(1e155 * rng.normal(size=(20, 2)), 1e155 * rng.normal(size=(20, 2)))


@pytest.mark.parametrize("offset", [1e5, 1e8])
def test_exact_transport_far_from_the_origin_is_the_one_near_it(offset):
    rng = np.random.default_rng(0)
    X, y, new = rng.normal(size=(60, 2)), rng.normal(size=(60, 2)) + 0.5, rng.normal(size=(200, 2))
    near, far = ExactTransport().fit(X, y), ExactTransport().fit(X + offset, y + offset)
    np.testing.assert_allclose(far.coupling_, near.coupling_, atol=1e-12)
    np.testing.assert_allclose(far.transform(new + offset) - offset, near.transform(new), atol=1e-6)


def test_exact_transport_moves_a_row_without_weight_as_the_nearest_one_with_weight():
    X = np.array([[0.0], [1.0], [2.0], [3.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        exact = ExactTransport().fit(X, X + 5, sample_weight=([0, 1, 1, 1], None))
    first, second = exact.transform(X[:2])
    assert first == second - 1
    assert exact.transform([[-7.0]]) == second - 8


def test_exact_transport_carries_a_row_alike_whatever_rows_are_beside_it():
    exact = ExactTransport().fit([[0.0], [0.0]], [[1.0], [3.0]])
    for n_rows in (1, 2, 3):
        np.testing.assert_array_equal(exact.transform(np.zeros((n_rows, 1))), 2.0)


def test_exact_transport_carries_a_dask_frame():
    frames = pytest.importorskip("dask.dataframe")
    X = pd.DataFrame(np.random.default_rng(0).normal(size=(20, 2)), columns=["a", "b"])
    exact = ExactTransport().fit(X, X + 1.0)
    np.testing.assert_allclose(exact.transform(frames.from_pandas(X, npartitions=3)), exact.transform(X))


@pytest.mark.parametrize("n_rows", [9, 60, 1000])
@pytest.mark.parametrize("value", [1.0, 0.1])
def test_a_target_that_does_not_vary_has_no_affinity(n_rows, value):
    X, y = np.random.default_rng(0).normal(size=(n_rows, 3)), np.full((n_rows, 3), value)
    for score in (affinity_score, affinity_estimate):
        with pytest.raises(ValueError, match="target rows are equal"):
            score(X, y)
    assert affinity_score(y, y) == 1.0


def test_the_way_back_of_a_map_that_lost_directions_is_refused():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(60, 3)), rng.normal(size=(60, 2)) @ rng.normal(size=(2, 3))
    for transport in (CORAL(), AffineTransport()):
        with pytest.raises(np.linalg.LinAlgError, match="no inverse"):
            transport.fit(X, y).inverse_transform(y)


def test_after_a_fit_that_failed_there_is_no_map():
    X, y = deterministic(2)
    for transport in (AffineTransport(), ExactTransport()):
        with pytest.raises(ValueError, match=r"rank|NaN"):
            transport.fit(X, np.full_like(y, np.nan) if isinstance(transport, ExactTransport) else y)
        with pytest.raises(NotFittedError):
            transport.transform(X)


def test_few_pairs_that_agree_do_not_look_shuffled_and_weightless_ones_show_nothing():
    rng = np.random.default_rng(0)
    for n_rows, n_columns in ((4, 1), (5, 1), (5, 2), (6, 3)):
        X = rng.normal(size=(n_rows, n_columns))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            ProcrustesAffineTransport().fit(
                X, X @ (np.eye(n_columns) + 0.3 * rng.normal(size=(n_columns,) * 2))
            )
    X, y = rng.normal(size=(2, 200, 3))
    weight = np.r_[np.ones(40), np.full(160, 1e-9)]
    with pytest.warns(UserWarning, match="no correlation"):
        ProcrustesAffineTransport().fit(X, y, sample_weight=weight)


@pytest.mark.parametrize("n_permutations", [19, 99])
def test_scores_below_a_quantile_of_the_null_are_rejected_at_its_level(n_permutations):
    X, y = np.random.default_rng(0).normal(size=(2, 30, 2))
    test = affinity_test(X, y, n_permutations=n_permutations, random_state=0)
    quantile = test.quantile(0.05)
    for score in (quantile - 1e-9, quantile + 1e-9):
        p_value = (1 + np.count_nonzero(test.null_scores <= score)) / (1 + n_permutations)
        assert (p_value <= 0.05 + 1e-12) == (score < quantile)


def test_a_tuple_of_weights_has_two_sides():
    X = np.random.default_rng(0).normal(size=(3, 2))
    for call in (AffineTransport().fit, affinity_score):
        with pytest.raises(ValueError, match=r"has 3 entries\. Give weights of rows as a list"):
            call(X, X, sample_weight=(1.0, 1.0, 1.0))


def test_a_scorer_can_only_be_asked_for_what_it_takes():
    with pytest.raises(TypeError, match="sample_wieght"):
        affinity_scorer().set_score_request(sample_wieght=True)


@pytest.mark.parametrize("context", [None, ["speed"], 0.5])
def test_a_context_that_is_none_says_what_it_may_be(context):
    X = pd.DataFrame(np.random.default_rng(0).normal(size=(20, 2)), columns=["angle", "torque"])
    with pytest.raises(ValueError, match=r"context must be a number of leading columns.*angle, torque"):
        ConditionalAffineTransport(context=context).fit(X, X)


def test_normal_distributions_must_be_of_the_same_features():
    with pytest.raises(ValueError, match="source_mean must be a finite vector"):
        gaussian_wasserstein_distance([np.nan], [[1.0]], [0.0], [[1.0]])
    with pytest.raises(ValueError, match="source_mean has 2, source_covariance has 3"):
        gaussian_wasserstein_distance([0, 0], np.eye(3), [1, 1, 1], np.eye(3))
    with pytest.raises(ValueError, match="source_covariance has 3, target_covariance has 2"):
        transport_map(np.eye(3), np.eye(2))
    with pytest.raises(ValueError, match="must be a square matrix"):
        transport_map(np.zeros((0, 0)), np.zeros((0, 0)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_points": 0}, "n_points == 0"),
        ({"feature_names": ["a"]}, "one name per column, 3; it holds 1"),
        ({"features": 0}, "features must be two columns"),
        ({"features": (0.5, 1)}, "given by number or by name; 0.5 is neither"),
    ],
)
def test_a_display_says_what_it_cannot_draw(options, message):
    X, y = np.random.default_rng(0).normal(size=(2, 20, 3))
    with pytest.raises(ValueError, match=message):
        TransportDisplay.from_predictions(X, X, y, **options)
    with pytest.raises(ValueError, match="Input X contains NaN"):
        TransportDisplay.from_predictions(np.full_like(X, np.nan), X, y)
