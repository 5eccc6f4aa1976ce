"""Rows outside of what was fitted, weights that make up for a shift, and forgetting."""

import pickle

import numpy as np
import pytest
from sklearn.covariance import LedoitWolf

from skat import AffineTransport, ConditionalAffineTransport, ProcrustesAffineTransport, ResidualTransport
from skat.gaussian import row_moments
from skat.transport import importance_weights
from skat.transport.shift import Support

LAWS = {
    "normal": lambda rng, size: rng.normal(size=size),
    "uniform": lambda rng, size: rng.uniform(size=size),
    "exponential": lambda rng, size: rng.exponential(size=size),
    "t3": lambda rng, size: rng.standard_t(3, size=size),
    "bimodal": lambda rng, size: rng.choice([-3.0, 3.0], size=size) + rng.normal(size=size),
}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("level", [0.9, 0.99])
def test_flagged_share_of_the_fits_own_law_is_one_minus_the_level(law, level):
    rng = np.random.default_rng(0)
    shape = rng.normal(size=(6, 6))
    fitted, fresh = (LAWS[law](rng, (n_rows, 6)) @ shape + 5 for n_rows in (4000, 20_000))
    transport = AffineTransport().fit(fitted, 2 * fitted)
    assert abs((~transport.in_support(fresh, level=level)).mean() - (1 - level)) < 0.01


def test_of_few_rows_the_flagged_share_is_right_on_average():
    rng = np.random.default_rng(0)
    shares = []
    for _ in range(100):
        fitted, fresh = rng.normal(size=(40, 5)), rng.normal(size=(200, 5))
        shares.append((~AffineTransport().fit(fitted, fitted + 1).in_support(fresh, level=0.9)).mean())
    assert abs(np.mean(shares) - 0.1) < 0.02


@pytest.mark.parametrize("weighted", [False, True])
def test_distances_of_fitted_rows_are_those_in_the_moments_of_the_others(weighted):
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(30, 3)) @ rng.normal(size=(3, 3))
    weight = rng.uniform(0.5, 2, size=30) if weighted else None
    moments = row_moments(rows, weight)
    found = Support.of(moments).left_out(rows, moments, weight)
    for k in range(30):
        others = row_moments(np.delete(rows, k, 0), np.delete(weight, k) if weighted else None)
        assert found[k] == pytest.approx(Support.of(others).distance(rows[k : k + 1])[0], rel=1e-10)


def test_distance_is_of_mahalanobis_and_does_not_depend_on_units():
    rng = np.random.default_rng(0)
    rows, others = rng.normal(size=(2, 50, 3))
    centred = others - rows.mean(axis=0)
    expected = np.sqrt(np.einsum("ij,ij->i", centred @ np.linalg.inv(np.cov(rows.T, bias=True)), centred))
    for units in (1.0, np.array([1e-9, 1.0, 1e9])):
        transport = AffineTransport().fit(rows * units, rows * units)
        np.testing.assert_allclose(transport.support_distance(others * units), expected, rtol=1e-9)


@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_rows_off_the_plane_of_the_fitted_ones_are_infinitely_far(unit):
    rng = np.random.default_rng(0)
    rows = unit * rng.normal(size=(50, 2)) @ [[1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]
    transport = AffineTransport().fit(rows, rows)
    distances = transport.support_distance(np.vstack([rows[:5], rows[:5] + unit * np.array([0, 0, 0.1])]))
    assert np.isfinite(distances[:5]).all()
    assert np.isinf(distances[5:]).all()


@pytest.mark.parametrize(
    "transport",
    [
        AffineTransport(outside="warn"),
        AffineTransport(outside="warn", covariance=LedoitWolf()),
        ProcrustesAffineTransport(outside="warn"),
        ConditionalAffineTransport(context=1, outside="warn"),
    ],
    ids=str,
)
def test_rows_from_elsewhere_are_warned_of_and_those_of_the_law_are_not(transport):
    rng = np.random.default_rng(0)
    rows, fresh = rng.normal(size=(2, 1000, 3))
    measured = rows + 0.1 * rng.normal(size=rows.shape)
    fitted = pickle.loads(pickle.dumps(transport.fit(rows, measured)))
    fitted.transform(fresh)
    with pytest.warns(UserWarning, match=r"\d+ of 1000 rows lie outside"):
        fitted.transform(fresh + 2)
    with pytest.raises(ValueError, match="in_support"):
        fitted.set_params(outside="raise").transform(fresh + 2)
    fitted.set_params(outside="ignore").transform(fresh + 2)


def test_target_rows_of_a_stack_are_never_outside():
    rng = np.random.default_rng(0)
    rows = np.vstack([rng.normal(size=(100, 2)), 50 + rng.normal(size=(100, 2))])
    domain = np.repeat([1, -1], 100)
    AffineTransport(outside="raise").fit(rows, sample_domain=domain).transform(rows, sample_domain=domain)


@pytest.mark.parametrize("n_rows", [200, 5000])
def test_a_weight_counts_as_repetitions_in_the_support(n_rows):
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(n_rows, 2))
    weight = np.where(np.abs(rows[:, 0]) > 1, 9, rng.integers(0, 2, n_rows))
    repeated = np.repeat(rows, weight, axis=0)
    weighted = AffineTransport().fit(rows, rows, sample_weight=weight)
    plain = AffineTransport().fit(repeated, repeated)
    for level in (0.3, 0.9, 0.99):
        radii = [fitted._fitted_support().radius(level) for fitted in (weighted, plain)]
        assert radii[0] == pytest.approx(radii[1], rel=0.1)


def test_level_and_missing_rows_are_refused_with_what_to_do():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(50, 2))
    with pytest.raises(ValueError, match=r"between 0 and 1, as 0\.99; it is 99"):
        AffineTransport().fit(rows, rows).in_support(rows, level=99)
    da = pytest.importorskip("dask.array")
    lazy = AffineTransport().fit(da.from_array(rows), da.from_array(rows))
    assert lazy.support_distance(rows).shape == (50,)
    with pytest.raises(ValueError, match="Use support_distance"):
        lazy.in_support(rows)


def test_residual_transports_know_their_support():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(60, 2))
    fitted = ResidualTransport().fit(rows, rows + 1)
    assert not fitted.in_support(rows + 20).any()
    np.testing.assert_array_equal(fitted.support_distance(rows), fitted.transport_.support_distance(rows))


def test_importance_weights_give_the_moments_of_the_other_law():
    rng = np.random.default_rng(0)
    here, there = rng.normal(size=(4000, 2)), rng.normal(size=(4000, 2)) * [0.7, 1.0] + [0.5, -0.5]
    weight = importance_weights(here, there)
    assert weight.mean() == pytest.approx(1)
    np.testing.assert_allclose(np.average(here, axis=0, weights=weight), there.mean(axis=0), atol=0.06)
    deviation = np.sqrt(np.average(np.square(here - there.mean(axis=0)), axis=0, weights=weight))
    np.testing.assert_allclose(deviation, there.std(axis=0), atol=0.06)


def test_weights_of_a_shift_make_a_map_that_serves_there():
    rng = np.random.default_rng(0)
    context, later = rng.normal(size=(3000, 1)), 1.0 + 0.7 * rng.normal(size=(3000, 1))

    def world(c):
        return np.hstack([c, c + 0.05 * rng.normal(size=c.shape)]), np.hstack([c, c + c**2])

    (X, y), (X_later, y_later) = world(context), world(later)
    weight = importance_weights(context, later)
    plain, weighted = (
        ConditionalAffineTransport(context=1).fit(X, y, sample_weight=given).transform(X_later)
        for given in (None, weight)
    )
    errors = [np.linalg.norm(carried - y_later, axis=1).mean() for carried in (plain, weighted)]
    assert errors[1] < 0.7 * errors[0]


def test_moments_times_a_number_are_those_of_rows_with_that_weight():
    rng = np.random.default_rng(0)
    for n_rows, n_features in ((50, 3), (200_000, 12)):
        rows = rng.normal(size=(n_rows, n_features)) + 3
        faded, weighted = 0.3 * row_moments(rows), row_moments(rows, np.full(n_rows, 0.3))
        np.testing.assert_allclose(faded.covariance, weighted.covariance, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(faded.mean, weighted.mean, rtol=1e-12)
        assert faded.weight == pytest.approx(weighted.weight)
        assert faded.effective_n_rows == pytest.approx(weighted.effective_n_rows)
    with pytest.raises(ValueError, match="positive number"):
        faded * 0.0


def test_what_came_before_counts_half_after_half_life_rows():
    rng = np.random.default_rng(0)
    (X, y), (X_new, y_new) = rng.normal(size=(2, 2, 40, 3))
    forgetful = AffineTransport().partial_fit(X, y).partial_fit(X_new, y_new, half_life=20)
    weight = np.repeat([0.25, 1.0], 40)
    expected = AffineTransport().fit(np.vstack([X, X_new]), np.vstack([y, y_new]), sample_weight=weight)
    np.testing.assert_allclose(forgetful.coef_, expected.coef_, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(forgetful.intercept_, expected.intercept_, rtol=1e-11, atol=1e-13)
    # The side without new rows forgets nothing.
    one_sided = AffineTransport().partial_fit(X, y).partial_fit(y=y_new, half_life=20)
    np.testing.assert_array_equal(one_sided.source_mean_, row_moments(X).mean)
    with pytest.raises(ValueError, match="positive number of rows; it is 0"):
        forgetful.partial_fit(X, y, half_life=0)


def test_a_forgetful_map_follows_a_world_that_changes():
    rng = np.random.default_rng(0)
    before, after = np.diag([1.0, 2.0]), np.diag([3.0, 0.5])
    maps = {None: AffineTransport(), 100: AffineTransport()}
    for step in range(40):
        X = rng.normal(size=(25, 2))
        y = rng.normal(size=(25, 2)) @ (before if step < 20 else after)
        for half_life, transport in maps.items():
            transport.partial_fit(X, y, half_life=half_life)
    errors = {half_life: np.abs(transport.coef_ - after).max() for half_life, transport in maps.items()}
    assert errors[100] < 0.5 < errors[None]
