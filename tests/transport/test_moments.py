"""Moments merge, in any order and grouping, and lose no digits."""

import pickle
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skat.gaussian import covariance_root, root_of_moments
from skat.gaussian.backends import _device_moments
from skat.gaussian.maps import reached_part
from skat.gaussian.moments import Moments, row_moments

seeds = st.integers(0, 2**32 - 1)


def standardised_difference(first, second):
    """Return the largest difference of two covariances in standard deviations."""
    scale = np.sqrt(np.diagonal(second))
    scale = np.where(scale > 0, scale, 1.0)
    return np.abs((first - second) / scale / scale[:, np.newaxis]).max()


@given(seeds, st.integers(1, 6), st.integers(2, 80), st.integers(1, 9))
@settings(max_examples=60, deadline=None)
def test_moments_of_chunks_add_up_to_those_of_all_rows(seed, n_features, n_rows, n_chunks):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(n_rows, n_features)) + 100 * rng.normal(size=n_features)
    cuts = np.sort(rng.integers(1, n_rows, size=n_chunks))
    chunks = [row_moments(chunk) for chunk in np.split(rows, cuts) if len(chunk)]
    total = chunks[0]
    for chunk in chunks[1:]:
        total = total + chunk
    whole = row_moments(rows)
    assert total.n_rows == whole.n_rows
    np.testing.assert_allclose(total.mean, whole.mean, rtol=1e-14)
    assert standardised_difference(total.covariance, whole.covariance) < 1e-12


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_addition_is_commutative_and_associative(seed):
    rng = np.random.default_rng(seed)
    a, b, c = (
        row_moments(rng.normal(size=(n, 3)), rng.uniform(0.1, 2, size=n)) for n in rng.integers(1, 30, 3)
    )
    for first, second in ((a + b, b + a), ((a + b) + c, a + (b + c))):
        assert first.weight == pytest.approx(second.weight, rel=1e-15)
        np.testing.assert_allclose(first.mean, second.mean, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(first.covariance, second.covariance, rtol=1e-11, atol=1e-13)


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_integer_weights_are_repetitions(seed):
    rng = np.random.default_rng(seed)
    rows, weight = rng.normal(size=(40, 3)), rng.integers(0, 4, size=40)
    weighted, repeated = row_moments(rows, weight), row_moments(np.repeat(rows, weight, axis=0))
    np.testing.assert_allclose(weighted.mean, repeated.mean, atol=1e-15)
    np.testing.assert_allclose(weighted.covariance, repeated.covariance, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("n_rows", [500, 60_000])
def test_a_mean_a_billion_times_the_spread_costs_no_digits(n_rows):
    rng = np.random.default_rng(0)
    spread = rng.integers(-(2**20), 2**20, size=(n_rows, 30)).astype(float)
    far, near = row_moments(spread + 2.0**50), row_moments(spread)
    assert standardised_difference(far.covariance, near.covariance) < 1e-13
    chunks = [row_moments(chunk + 2.0**50) for chunk in np.array_split(spread, 20)]
    assert standardised_difference(sum(chunks[1:], chunks[0]).covariance, near.covariance) < 1e-13


@pytest.mark.parametrize("n_rows", [50, 60_000])
def test_a_constant_column_has_no_variance_at_all(n_rows):
    rows = np.random.default_rng(0).normal(size=(n_rows, 30))
    rows[:, 7] = 0.1
    assert row_moments(rows).variance[7] == 0.0
    halves = [row_moments(half) for half in np.array_split(rows, 2)]
    assert (halves[0] + halves[1]).variance[7] == 0.0


def test_a_trend_far_larger_than_the_first_rows_costs_no_digits():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(60_000, 30)) * 1e-4 + np.linspace(0, 1, 60_000)[:, np.newaxis] ** 8
    centred = rows - rows.mean(axis=0)
    centred -= centred.mean(axis=0)
    factor = np.linalg.qr(centred, mode="r")
    assert standardised_difference(row_moments(rows).covariance, factor.T @ factor / len(rows)) < 1e-13


@pytest.mark.parametrize("offset", [0.0, 0.9, 40.0])
@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int32])
def test_rows_are_the_same_read_where_they_are_and_shifted(dtype, offset):
    rng = np.random.default_rng(0)
    rows = (4 * (rng.normal(size=(60_007, 30)) + offset)).astype(dtype)
    moments = row_moments(rows)
    assert moments.factor is None
    exact = rows.astype(np.longdouble)
    mean = exact.mean(axis=0)
    np.testing.assert_allclose(moments.mean, mean.astype(float), rtol=1e-14, atol=1e-14)
    centred = (exact - mean).astype(float)
    assert standardised_difference(moments.covariance, centred.T @ centred / len(rows)) < 1e-14
    columns = row_moments(np.asfortranarray(rows))
    assert standardised_difference(columns.covariance, moments.covariance) < 1e-14


@pytest.mark.parametrize("mean", [0.0, 1e3, 1e6])
@pytest.mark.parametrize("is_weighted", [False, True])
def test_rows_of_float32_are_centred_and_summed_in_float64(is_weighted, mean):
    """Columns of two values: a sum in float32 would round each square to the same side, however short its blocks."""
    rng = np.random.default_rng(0)
    rows = np.where(rng.random((30_000, 30)) < 0.3, 1.0, 0.1 * rng.random(30))
    rows = ((rows + mean) * np.logspace(-6, 6, 30)).astype(np.float32)
    weight = rng.uniform(0.5, 2, len(rows)) if is_weighted else None
    moments = row_moments(rows, weight)
    assert moments.factor is None
    share = np.ones(len(rows), np.longdouble) if weight is None else weight.astype(np.longdouble)
    share /= share.sum()
    centred = rows.astype(np.longdouble)
    centred -= share @ centred
    exact = np.einsum("n,ni,nj->ij", share, centred, centred).astype(float)
    # What so many roundings to either side come to in a sum, whichever kernel adds it up.
    rounding = np.sqrt(len(rows)) * np.finfo(float).eps / 2
    assert standardised_difference(moments.covariance, exact) < rounding


def test_centred_rows_are_not_copied():
    rows = np.random.default_rng(0).normal(size=(60_000, 30))
    tracemalloc.start()
    row_moments(rows)
    without_copy = tracemalloc.get_traced_memory()[1]
    tracemalloc.reset_peak()
    row_moments(rows + 40)
    assert tracemalloc.get_traced_memory()[1] > without_copy + rows.nbytes
    tracemalloc.stop()


def test_what_was_factored_is_not_pickled_and_does_not_outlive_a_change():
    rows = np.random.default_rng(0).normal(size=(60_000, 30))
    moments = row_moments(rows)
    before = len(pickle.dumps(moments))
    factor = moments.covariance_factor
    assert moments.covariance_factor is factor
    assert len(pickle.dumps(moments)) == before
    doubled = moments.scaled(np.full(30, 2.0))
    np.testing.assert_allclose(doubled.covariance_factor, 2 * factor, rtol=1e-13)


def test_ill_conditioned_rows_are_held_as_a_factor_and_others_as_a_product():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(60_000, 30))
    assert row_moments(rows).factor is None
    rows[:, 1] = rows[:, 0] + 1e-5 * rows[:, 1]
    moments = row_moments(rows)
    assert moments.scatter is None
    smallest = np.linalg.svd(moments.covariance_factor, compute_uv=False)[-1]
    centred = rows - rows.mean(axis=0)
    assert smallest == pytest.approx(np.linalg.svd(centred, compute_uv=False)[-1] / np.sqrt(60_000), rel=1e-9)


def test_so_are_those_of_many_columns_of_which_two_nearly_agree():
    rng = np.random.default_rng(0)
    centred = rng.normal(size=(500, 402))
    axes = np.linalg.qr(centred - centred.mean(axis=0))[0]
    for condition, is_factor in ((1.6e6, True), (0.6e6, False)):
        correlation = (condition - 1) / (condition + 1)
        twin = correlation * axes[:, 0] + np.sqrt(1 - correlation**2) * axes[:, 401]
        moments = row_moments(np.column_stack([axes[:, :400], twin]))
        assert (moments.factor is not None) == is_factor


def test_sets_far_apart_merge_into_a_factor():
    rng = np.random.default_rng(0)
    parts = [rng.normal(size=(30_000, 30)) + shift for shift in (0.0, 1e6)]
    first, second = map(row_moments, parts)
    assert first.factor is None
    assert second.factor is None
    both = first + second
    assert both.scatter is None
    rows = np.vstack(parts)
    centred = rows - rows.mean(axis=0)
    expected = np.linalg.svd(centred, compute_uv=False)[-1] / np.sqrt(len(rows))
    assert np.linalg.svd(both.covariance_factor, compute_uv=False)[-1] == pytest.approx(expected, rel=1e-7)


def test_not_a_number_shows():
    rows = np.random.default_rng(0).normal(size=(60_000, 30))
    assert row_moments(rows).is_finite
    for place, value in ((3, np.nan), (59_999, np.inf), (0, -np.inf)):
        spoilt = rows.copy()
        spoilt[place, 5] = value
        assert not row_moments(spoilt).is_finite
        assert not row_moments(spoilt[max(place - 20, 0) : place + 20]).is_finite


def test_scaled_and_selected_columns_have_the_moments_of_those_rows():
    rng = np.random.default_rng(0)
    for n_rows in (40, 60_000):
        rows = rng.normal(size=(n_rows, 30)) + 3
        factors = rng.uniform(0.5, 2, size=30)
        moments = row_moments(rows)
        np.testing.assert_allclose(
            moments.scaled(factors).covariance, row_moments(rows * factors).covariance, rtol=1e-9, atol=1e-12
        )
        np.testing.assert_allclose(
            moments.columns(slice(3, 9)).covariance, np.cov(rows[:, 3:9].T, bias=True), rtol=1e-9, atol=1e-12
        )


def test_moments_of_other_columns_do_not_merge():
    with pytest.raises(ValueError, match="these have 3 and 2"):
        row_moments(np.eye(3)) + row_moments(np.eye(2))
    assert Moments.__add__(row_moments(np.eye(2)), 1) is NotImplemented


@given(seeds, st.integers(1, 6), st.integers(0, 3))
@settings(max_examples=40, deadline=None)
def test_a_root_times_its_transpose_is_the_covariance_and_shows_its_rank(seed, n_features, n_copies):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(50, n_features)) @ rng.normal(size=(n_features, n_features + n_copies))
    rows = rows * np.logspace(-6, 6, n_features + n_copies)
    moments = row_moments(rows)
    for root in (root_of_moments(moments), covariance_root(moments.covariance)):
        assert root.shape == (n_features + n_copies, n_features)
        assert standardised_difference(root @ root.T, moments.covariance) < 1e-12


def test_one_row_of_another_library_has_its_values_for_mean():
    xp = pytest.importorskip("array_api_strict")
    moments = _device_moments(xp.asarray([[1.5, -2.0]]), None, xp, None)
    np.testing.assert_allclose(moments.mean, [1.5, -2.0])
    assert moments.n_rows == 1


def test_of_a_target_that_does_not_vary_nothing_has_to_be_reached():
    assert reached_part(np.zeros((2, 2)), np.eye(2), np.zeros((2, 0))) == (0, 0.0)
