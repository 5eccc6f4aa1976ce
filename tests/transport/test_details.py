"""Of each transport what one call decides: weights, shares, orders of rows, and who is asked for what."""

import inspect

import numpy as np
import pytest
from sklearn.covariance import LedoitWolf
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import LinearRegression

import skat.transport as transports
from skat import (
    CORAL,
    AffineTransport,
    ConditionalAffineTransport,
    ExactTransport,
    IdentityTransport,
    ProcrustesAffineTransport,
    ResidualTransport,
)
from skat.gaussian import row_moments
from skat.gaussian.backends import apply_map, beside, is_dask, moments_of, on_host, to_namespace
from skat.metrics import affinity_score
from skat.transport.baselines import KernelAlignment
from skat.transport.moment_transport import _merged, _share_outside
from skat.transport.residual import KernelRidgeCV, _errors_by_penalty, _weights
from skat.transport.splitting import TargetRows, _alternating

ESTIMATORS = [
    AffineTransport(),
    ProcrustesAffineTransport(),
    ConditionalAffineTransport(context=1),
    CORAL(),
    IdentityTransport(),
    ExactTransport(),
    KernelAlignment(n_components=20, random_state=0),
    ResidualTransport(regressor=LinearRegression()),
]


def rows(n_rows=40, n_features=3, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n_rows, n_features)) @ rng.normal(size=(n_features, n_features)) + rng.normal(
        size=n_features
    )


@pytest.mark.parametrize("transport", ESTIMATORS, ids=lambda one: type(one).__name__)
def test_source_rows_of_a_stack_are_carried_and_target_rows_stay_to_the_bit(transport):
    X = rows(seed=1)
    y = X @ np.array([[1.0, 0.5, 0.0], [0.0, 2.0, 0.3], [0.2, 0.0, 1.0]]) + 0.3 * rows(seed=2)
    stacked, domain = np.vstack([X, y])[::-1], np.repeat([1, -1], 40)[::-1]
    one = transport.fit(X, y).transform(X)
    both = type(transport)(**transport.get_params(deep=False)).fit(stacked, sample_domain=domain)
    moved = both.transform(stacked, sample_domain=domain)
    np.testing.assert_array_equal(moved[domain < 0], stacked[domain < 0])
    assert moved.dtype == np.float64
    assert both.transform(stacked.astype(np.float32), sample_domain=domain).dtype == np.float32
    if not isinstance(transport, KernelAlignment | ProcrustesAffineTransport | ResidualTransport):
        np.testing.assert_allclose(moved[domain > 0][::-1], one, rtol=1e-9, atol=1e-9)
    with pytest.raises(ValueError, match="cannot tell which rows"):
        both.transform(stacked)
    both.set_params(unlabelled="target")
    np.testing.assert_array_equal(both.transform(stacked), stacked)
    for few in ((X[:1], y), (X, y[:1])):
        with pytest.raises(ValueError, match=r"1 sample|rows|as many|length"):
            type(transport)(**transport.get_params(deep=False)).fit(*few)
    for bad in ((np.where(X[3, 1] == X, np.nan, X), y), (X, np.where(y == y[3, 1], np.inf, y))):
        with pytest.raises(ValueError, match=r"NaN|infinity|finite"):
            type(transport)(**transport.get_params(deep=False)).fit(*bad)


@pytest.mark.parametrize("name", transports.__all__)
def test_what_may_be_given_is_named(name):
    """But for what a transport is about, all is given by keyword."""
    made = getattr(transports, name)
    if not (inspect.isclass(made) and hasattr(made, "fit")):
        return
    positional = [
        one.name
        for one in list(inspect.signature(made.__init__).parameters.values())[1:]
        if one.kind is one.POSITIONAL_OR_KEYWORD
    ]
    assert positional in ([], ["n_components"], ["transport"], ["transport", "regressor"], ["regressor"])


def test_score_is_the_affinity_of_carried_rows():
    X, y = rows(seed=1), rows(25, seed=2)
    transport = AffineTransport().fit(X, y)
    assert transport.score(X, y) == pytest.approx(affinity_score(transport.transform(X), y))
    weights = np.linspace(0.5, 2, 40), np.linspace(2, 0.5, 25)
    weighted = transport.score(X, y, sample_weight=weights)
    assert weighted == pytest.approx(affinity_score(transport.transform(X), y, sample_weight=weights))
    assert weighted != pytest.approx(transport.score(X, y), rel=1e-6)


def test_an_estimators_covariance_and_mean_are_those_of_the_map():
    X, y = rows(seed=1), rows(25, seed=2)
    transport = AffineTransport(covariance=LedoitWolf()).fit(X, y)
    for side, given in (("source", X), ("target", y)):
        estimated = LedoitWolf().fit(given)
        np.testing.assert_allclose(
            getattr(transport, f"{side}_covariance_"), estimated.covariance_, rtol=1e-9
        )
        np.testing.assert_allclose(getattr(transport, f"{side}_mean_"), estimated.location_)
    coef = transport.coef_
    np.testing.assert_allclose(
        coef @ transport.source_covariance_ @ coef.T, transport.target_covariance_, rtol=1e-8
    )
    with pytest.raises(ValueError, match="instance of a covariance estimator"):
        AffineTransport(covariance=LedoitWolf).fit(X, y)
    with pytest.raises(ValueError, match="needs all rows at once"):
        AffineTransport(covariance=LedoitWolf()).partial_fit(X, y)
    with pytest.raises(ValueError, match="takes no sample_weight"):
        AffineTransport(covariance=LedoitWolf()).fit(X, y, sample_weight=(np.ones(40), None))


def test_a_scale_is_the_unit_in_which_the_map_is_least():
    X, y = rows(seed=1), rows(seed=2)
    units = np.array([1.0, 10.0, 0.1])
    scaled = AffineTransport(metric_scale=units).fit(X, y)
    plain = AffineTransport().fit(X / units, y / units)
    np.testing.assert_allclose(scaled.transform(X), plain.transform(X / units) * units, rtol=1e-9)
    np.testing.assert_allclose(
        scaled.inverse_transform(y), plain.inverse_transform(y / units) * units, rtol=1e-9
    )
    assert scaled.wasserstein_distance_ == pytest.approx(plain.wasserstein_distance_, rel=1e-9)
    own = AffineTransport(metric_scale="target").fit(X, y)
    np.testing.assert_allclose(
        own.coef_, AffineTransport(metric_scale=y.std(axis=0)).fit(X, y).coef_, rtol=1e-9
    )
    for bad in ([1.0, 2.0], [1.0, 0.0, 1.0], [1.0, -1.0, 1.0], [1.0, np.inf, 1.0]):
        with pytest.raises(ValueError, match="one positive length per feature, 3"):
            AffineTransport(metric_scale=bad).fit(X, y)


def test_collected_rows_are_those_of_one_fit_and_older_ones_fade():
    X, y = rows(seed=1), rows(seed=2)
    whole, parts = AffineTransport().fit(X, y), AffineTransport()
    for first in range(0, 40, 10):
        parts.partial_fit(X[first : first + 10])
        parts.partial_fit(y=y[first : first + 10])
    np.testing.assert_allclose(parts.coef_, whole.coef_, rtol=1e-9)
    np.testing.assert_allclose(parts.intercept_, whole.intercept_, rtol=1e-9)
    old, new = row_moments(X[:20]), row_moments(X[20:30])
    merged = _merged(old, new, 5.0)
    weights = np.repeat([0.25, 1.0], [20, 10])
    np.testing.assert_allclose(merged.mean, np.average(X[:30], axis=0, weights=weights), rtol=1e-12)
    assert merged.weight == pytest.approx(15.0)
    assert _merged(None, new, 5.0) is new
    assert _merged(old, None, 5.0) is old
    for bad in (0.0, -1.0, np.inf):
        with pytest.raises(ValueError, match="half_life must be a positive number"):
            AffineTransport().partial_fit(X, y, half_life=bad)
    with pytest.raises(ValueError, match="partial_fit needs rows"):
        AffineTransport().partial_fit()


def test_share_outside_is_that_of_the_variance_off_the_plane():
    target = rows(50)
    flat = target.copy()
    flat[:, 2] = 1.0
    variance = target.var(axis=0)
    share = _share_outside(row_moments(flat), row_moments(target))
    assert share == pytest.approx(variance[2] / variance.sum(), rel=1e-9)
    assert _share_outside(row_moments(target), row_moments(flat)) == 0.0
    assert _share_outside(row_moments(flat), row_moments(flat)) == 0.0


@pytest.mark.parametrize("few", [3, 4])
def test_rows_too_few_to_tell_are_warned_of(few):
    X, y = rows(few, seed=1), rows(30, seed=2)
    if few == 3:
        with pytest.warns(UserWarning, match="3 rows cannot show how 3 features"):
            AffineTransport().fit(y, X)
    else:
        assert AffineTransport().fit(y, X).rank_ == 3


@pytest.mark.parametrize(("first", "second"), [(3, 3), (2, 6), (5, 2), (0, 4), (4, 0)])
def test_any_part_from_the_front_holds_both_in_proportion(first, second):
    order = _alternating(np.arange(first), 100 + np.arange(second))
    assert sorted(order) == [*range(first), *range(100, 100 + second)]
    for taken in range(first + second + 1):
        from_first = np.sum(order[:taken] < 100)
        assert abs(from_first - taken * first / (first + second)) <= 1
    if first == second:
        np.testing.assert_array_equal(order[::2] + 100, order[1::2])


def test_pairs_leave_together_and_validation_is_of_target_rows():
    domain = np.array([1, -1] * 10)
    for is_paired in (False, True):
        splits = list(TargetRows(5, paired=is_paired).split(np.zeros((20, 1)), sample_domain=domain))
        assert len(splits) == 5 == TargetRows(5).get_n_splits()
        assert sorted(np.concatenate([test for _, test in splits])) == list(range(1, 20, 2))
        for train, test in splits:
            assert not set(train) & set(test)
            assert len(train) == (16 if is_paired else 18)
            if is_paired:
                assert not set(train) & set(test - 1)


def test_weight_of_a_prediction_is_that_of_least_error_less_its_doubt():
    rng = np.random.default_rng(0)
    predictions = rng.normal(size=(4000, 4))
    residuals = predictions * [0.5, 1.5, -1.0, 0.0] + 0.01 * rng.normal(size=(4000, 4))
    np.testing.assert_allclose(_weights(residuals, predictions, None), [0.5, 1, 0, 0], atol=1e-3)
    assert _weights(residuals, np.zeros((4000, 4)), None).max() == 0
    # An estimate b of error e is worth (b^2 - e^2) / b.
    few, said = predictions[:30, :1], 0.5 * predictions[:30, :1] + rng.normal(size=(30, 1))
    weight = rng.integers(1, 4, size=30).astype(float)
    slope = np.sum(weight * (few * said)[:, 0]) / np.sum(weight * few[:, 0] ** 2)
    error = (
        np.sum(np.square(weight * (few * (said - slope * few))[:, 0])) / np.sum(weight * few[:, 0] ** 2) ** 2
    )
    assert _weights(said, few, weight)[0] == pytest.approx(np.clip(slope - error / slope, 0, 1))


@pytest.mark.parametrize("is_weighted", [False, True])
def test_error_of_a_fold_is_that_of_scikit_learns_ridge(is_weighted):
    from sklearn.preprocessing import StandardScaler

    from skat.transport.residual import PENALTIES

    X, y = rows(30, seed=1), rows(30, 2, seed=2)
    weight = np.random.default_rng(3).uniform(0.5, 2, 30) if is_weighted else np.ones(30)
    train, test, gammas = np.arange(20), np.arange(20, 30), np.array([0.05, 0.7])
    found = _errors_by_penalty(X, y, weight, train, test, gammas)
    scaler = StandardScaler().fit(X[train], sample_weight=weight[train])
    for i, gamma in enumerate(gammas):
        for j in (0, len(PENALTIES) - 1):
            ridge = KernelRidge(kernel="rbf", gamma=gamma, alpha=PENALTIES[j])
            ridge.fit(scaler.transform(X[train]), y[train], sample_weight=weight[train])
            missed = np.square(y[test] - ridge.predict(scaler.transform(X[test]))).mean(axis=1)
            assert found[i, j] == pytest.approx(np.average(missed, weights=weight[test]), rel=1e-6)
    assert KernelRidgeCV().fit(X, y).predict(X).shape == (30, 2)


def test_a_correction_takes_off_what_is_bent():
    X = rows(60, seed=1)
    bent = X + 0.5 * np.square(X)
    found = ResidualTransport().fit(X, bent)
    plain = ProcrustesAffineTransport().fit(X, bent)
    errors = [np.square(one.transform(X) - bent).mean() for one in (found, plain)]
    assert errors[0] < 0.2 * errors[1]
    assert found.wasserstein_distance_ == plain.wasserstein_distance_
    with pytest.raises(np.linalg.LinAlgError, match="has no inverse"):
        found.inverse_transform(bent)
    with pytest.raises(ValueError, match="row k of y belongs to row k of X"):
        ResidualTransport().fit(X, bent[:-1])


def test_rows_that_stay_are_not_carried_and_bad_ones_are_told():
    affine = AffineTransport().fit(rows(seed=1), rows(seed=2))._map
    X, keep, told = rows(6, seed=3), np.array([True, False] * 3), []
    for kept in (keep, ~keep, np.ones(6, bool), np.zeros(6, bool)):
        carried = apply_map(affine, X, keep=kept, check=told.append)
        np.testing.assert_array_equal(carried[kept], X[kept])
        np.testing.assert_array_equal(carried[~kept], affine(X)[~kept])
    assert told == []
    X[2, 1] = np.nan
    apply_map(affine, X, check=told.append)
    assert len(told) == 1
    assert moments_of([(None, None), (X[:2], np.zeros(2))]) == [None, None]
    both = beside(X, X[:, :1])
    assert both.shape == (6, 4)
    assert not is_dask(X)
    assert on_host(X) is X
    assert to_namespace(X, X) is X
