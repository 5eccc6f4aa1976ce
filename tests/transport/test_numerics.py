"""The map has the digits that the data allow: against eighty-digit arithmetic, in hard cases."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skat import AffineTransport, ConditionalAffineTransport, ProcrustesAffineTransport
from tests.transport.reference import exact_map, graded, relative_error, rotated

EPS = np.finfo(float).eps


@pytest.mark.parametrize("make", [rotated, graded])
@pytest.mark.parametrize("target_condition", [1e2, 1e12])
@pytest.mark.parametrize("condition", [1e2, 1e6, 1e9, 1e12, 1e15, 1e18, 1e22])
def test_map_agrees_with_exact_arithmetic(make, condition, target_condition):
    rng = np.random.default_rng(0)
    for _ in range(2):
        X, y = make(rng, 60, 5, condition), make(rng, 50, 5, target_condition)
        worst = max(condition, target_condition)
        tolerance = 1e-9 if worst <= 1e12 else 1000 * EPS * np.sqrt(worst)
        assert relative_error(AffineTransport().fit(X, y).coef_, exact_map(X, y)) < tolerance


@pytest.mark.parametrize("condition", [1e4, 1e9, 1e12])
def test_large_samples_agree_with_exact_arithmetic(condition):
    """Enough rows for the product path, where conditioning allows it."""
    rng = np.random.default_rng(0)
    n_rows, n_features = 30_000, 30
    X = rotated(rng, n_rows, n_features, condition) + 10
    y = rotated(rng, n_rows, n_features, 1e2)
    blockwise = AffineTransport()
    for rows, target in zip(np.array_split(X, 40), np.array_split(y, 40)):
        blockwise.partial_fit(rows, target)
    factors = [np.linalg.qr(rows - rows.mean(axis=0), mode="r") / np.sqrt(n_rows) for rows in (X, y)]
    left, values, _ = np.linalg.svd(factors[1] @ factors[0].T)
    half = factors[1].T @ left / np.sqrt(values)
    whole = AffineTransport().fit(X, y)
    assert relative_error(whole.coef_, half @ half.T) < 1e-9
    assert relative_error(blockwise.coef_, whole.coef_) < 1e-9


@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
@settings(max_examples=30, deadline=None)
def test_partial_fit_in_any_chunks_equals_fit(seed, n_chunks):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(300, 4)) @ (np.eye(4) + 0.2 * rng.normal(size=(4, 4))) + 50
    y = rng.normal(size=(200, 4)) @ (np.eye(4) + 0.2 * rng.normal(size=(4, 4))) - 20
    whole, parts = AffineTransport().fit(X, y), AffineTransport()
    calls = [("X", rows) for rows in np.array_split(X, n_chunks)] + [
        ("y", rows) for rows in np.array_split(y, n_chunks)
    ]
    for k in rng.permutation(len(calls)):
        parts.partial_fit(**dict([calls[k]]))
    assert relative_error(parts.coef_, whole.coef_) < 1e-12
    np.testing.assert_allclose(parts.transform(X), whole.transform(X), rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("factor", [1e-6, 1e-12, 1e6, 1e-150])
def test_a_common_factor_leaves_the_map_unchanged(factor):
    rng = np.random.default_rng(0)
    X, y = rotated(rng, 100, 6, 1e6), rotated(rng, 80, 6, 1e4)
    coef = AffineTransport().fit(X, y).coef_
    assert relative_error(AffineTransport().fit(factor * X, factor * y).coef_, coef) < 1e-11


def test_mixed_units_give_the_map_of_those_data():
    rng = np.random.default_rng(0)
    units = np.logspace(-6, 6, 5)
    X, y = (
        rng.normal(size=(60, 5)) @ rng.normal(size=(5, 5)),
        rng.normal(size=(50, 5)) @ rng.normal(size=(5, 5)),
    )
    coef = AffineTransport().fit(X * units, y * units).coef_
    assert relative_error(coef, exact_map(X * units, y * units)) < 1e-12
    rescaled = AffineTransport().fit(X, y).coef_ * units[:, np.newaxis] / units
    assert relative_error(coef, rescaled) > 1e-3


def test_target_metric_makes_the_map_independent_of_units():
    rng = np.random.default_rng(0)
    units = np.logspace(-6, 6, 5)
    X, y = (
        rng.normal(size=(60, 5)) @ rng.normal(size=(5, 5)),
        rng.normal(size=(50, 5)) @ rng.normal(size=(5, 5)),
    )
    plain = AffineTransport(metric_scale="target").fit(X, y).coef_
    in_units = AffineTransport(metric_scale="target").fit(X * units, y * units).coef_
    np.testing.assert_allclose(in_units / units[:, np.newaxis] * units, plain, rtol=1e-12)


def test_metric_scale_is_the_map_of_scaled_data_scaled_back():
    rng = np.random.default_rng(0)
    X, y = (
        rng.normal(size=(60, 3)) @ rng.normal(size=(3, 3)),
        rng.normal(size=(50, 3)) @ rng.normal(size=(3, 3)),
    )
    lengths = np.array([0.5, 2.0, 7.0])
    scaled = AffineTransport(metric_scale=lengths).fit(X, y)
    by_hand = AffineTransport().fit(X / lengths, y / lengths)
    np.testing.assert_allclose(scaled.transform(X), by_hand.transform(X / lengths) * lengths, rtol=1e-12)
    assert scaled.wasserstein_distance_ == pytest.approx(by_hand.wasserstein_distance_, rel=1e-12)


def test_float32_in_gives_float32_out_within_1e_6():
    rng = np.random.default_rng(0)
    X = rotated(rng, 500, 6, 1e7).astype(np.float32)
    y = rotated(rng, 400, 6, 1e2).astype(np.float32)
    transport = AffineTransport().fit(X, y)
    carried = transport.transform(X)
    assert carried.dtype == np.float32
    coef = exact_map(X, y)
    assert relative_error(transport.coef_, coef) < 1e-10
    X, y = X.astype(float), y.astype(float)
    assert relative_error(carried, (X - X.mean(axis=0)) @ coef.T + y.mean(axis=0)) < 1e-6


@pytest.mark.parametrize(
    "transport", [AffineTransport(), ProcrustesAffineTransport(), ConditionalAffineTransport(context=2)]
)
def test_constant_and_duplicated_columns_work(transport):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(100, 6)) + 0.1
    y = X @ (np.eye(6) + 0.2 * rng.normal(size=(6, 6)))
    for rows in (X, y):
        rows[:, 3] = 0.1
        rows[:, 5] = rows[:, 4]
    carried = transport.fit(X, y).transform(X)
    assert transport.rank_ == 4
    np.testing.assert_allclose(carried[:, 3], 0.1, rtol=1e-13)
    np.testing.assert_allclose(carried[:, 5], carried[:, 4], rtol=1e-12)
    if not isinstance(transport, ConditionalAffineTransport):
        np.testing.assert_allclose(np.cov(carried.T), np.cov(y.T), atol=1e-12)
    np.testing.assert_allclose(transport.inverse_transform(carried), X, atol=1e-11)


@pytest.mark.parametrize(
    ("n_source", "n_target", "n_features"), [(30, 20, 50), (200, 200, 400), (40, 40, 40)]
)
def test_fewer_rows_than_features_give_the_map_of_least_rank_and_a_warning(n_source, n_target, n_features):
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(n_source, n_features)), 2 * rng.normal(size=(n_target, n_features)) + 1
    with pytest.warns(UserWarning, match="will not generalise"):
        transport = AffineTransport().fit(X, y)
    assert transport.rank_ == n_target - 1 == np.linalg.matrix_rank(transport.coef_)
    residual = transport.coef_ @ np.cov(X.T, bias=True) @ transport.coef_.T - np.cov(y.T, bias=True)
    assert np.linalg.norm(residual) < 1e-10 * np.linalg.norm(np.cov(y.T, bias=True))
    np.testing.assert_allclose(transport.coef_, transport.coef_.T, atol=1e-12)


def test_a_target_that_varies_where_the_source_does_not_is_an_error_that_names_both_ranks():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match=r"rank\(S_t\) is 29, .* only 19"):
        AffineTransport().fit(rng.normal(size=(20, 50)), rng.normal(size=(30, 50)))
    X = rng.normal(size=(100, 3))
    X[:, 2] = 1.0
    with pytest.raises(ValueError, match=r"rank\(S_t\) is 3, .* only 2"):
        AffineTransport().fit(X, rng.normal(size=(100, 3)))


def test_far_from_the_origin_carried_rows_keep_their_digits():
    rng = np.random.default_rng(0)
    X, y = rng.integers(-1000, 1000, size=(200, 3)) / 1024, rng.normal(size=(150, 3))
    near, far = (
        AffineTransport().fit(X, y).transform(X),
        AffineTransport().fit(X + 2**30, y).transform(X + 2**30),
    )
    np.testing.assert_allclose(far, near, atol=1e-12)


def test_a_map_that_drops_directions_has_no_inverse_and_says_so():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(50, 3)), rng.normal(size=(50, 3))
    y[:, 1] = 2.0
    y[:, [0, 2]] += X[:, :2]
    for transport in (
        AffineTransport(),
        ProcrustesAffineTransport(),
        ProcrustesAffineTransport(alignment="raw"),
    ):
        transport.fit(X, y)
        assert transport.rank_ == 2
        with pytest.raises(ValueError, match="no inverse: it is of rank 2"):
            transport.inverse_transform(y)


@pytest.mark.parametrize("offset", [0.0, 1e3])
def test_float32_rows_of_a_tame_map_err_by_their_own_rounding(offset):
    rng = np.random.default_rng(4)
    X = (rng.normal(size=(3000, 30)) + offset).astype(np.float32)
    y = X @ (np.eye(30) + 0.1 * rng.normal(size=(30, 30))).astype(np.float32)
    fitted = AffineTransport().fit(X, y)
    exact = fitted.transform(X.astype(np.float64))
    error = np.abs(fitted.transform(X) - exact)
    assert fitted._map.is_tame
    # Half a unit in the last place of the result, and what thirty rounded terms of its spread add to it.
    eps = np.finfo(np.float32).eps
    assert (error <= eps * np.abs(exact) + 10 * eps * exact.std(axis=0)).all()


def test_where_terms_cancel_float32_rows_are_carried_in_float64_arithmetic():
    rng = np.random.default_rng(5)
    X = rng.normal(size=(500, 2))
    X[:, 1] = X[:, 0] + 1e-3 * X[:, 1]
    X = X.astype(np.float32)
    fitted = AffineTransport().fit(X, rng.normal(size=(500, 2)).astype(np.float32))
    exact = fitted.transform(X.astype(np.float64))
    np.testing.assert_array_equal(fitted.transform(X), exact.astype(np.float32))
    assert fitted._map.is_tame is False
