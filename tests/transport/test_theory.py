"""The theorems behind the transports, as laws on random inputs."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.dummy import DummyRegressor
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skat import (
    AffineTransport,
    ConditionalAffineTransport,
    IdentityTransport,
    ProcrustesAffineTransport,
    ResidualTransport,
)
from skat.gaussian import gaussian_wasserstein_distance, transport_map
from skat.metrics.wasserstein import affinity, wasserstein_distance
from skat.transport.alignment import PairFactors
from skat.transport.residual import GAMMAS, PENALTIES, KernelRidgeCV
from tests.transport.reference import relative_error

seeds = st.integers(0, 2**32 - 1)
dimensions = st.integers(1, 5)
laws = settings(max_examples=40, deadline=None)


def positive_definite(rng, n_features, floor=0.1):
    root = rng.normal(size=(n_features, n_features))
    return root @ root.T + floor * np.eye(n_features)


def skewed(rng, n_rows, n_features):
    """Rows that are far from normal."""
    return rng.exponential(size=(n_rows, n_features)) @ rng.normal(size=(n_features, n_features))


def orthogonal(rng, n_features):
    return np.linalg.qr(rng.normal(size=(n_features, n_features)))[0]


@given(seeds, dimensions)
@laws
def test_map_is_symmetric_positive_and_carries_one_covariance_to_the_other(seed, n_features):
    rng = np.random.default_rng(seed)
    source, target = positive_definite(rng, n_features), positive_definite(rng, n_features)
    coef = transport_map(source, target)
    np.testing.assert_allclose(coef, coef.T, atol=1e-11 * np.abs(coef).max())
    assert np.linalg.eigvalsh(coef)[0] > 0
    np.testing.assert_allclose(coef @ source @ coef, target, atol=1e-10 * np.abs(target).max())
    np.testing.assert_allclose(coef @ transport_map(target, source), np.eye(n_features), atol=1e-8)


@given(seeds, dimensions)
@laws
def test_map_and_distance_equal_the_formulas_with_matrix_roots(seed, n_features):
    rng = np.random.default_rng(seed)
    source, target = positive_definite(rng, n_features), positive_definite(rng, n_features)
    root = scipy.linalg.sqrtm(target).real
    middle = scipy.linalg.sqrtm(root @ source @ root).real
    np.testing.assert_allclose(
        transport_map(source, target), root @ np.linalg.solve(middle, root), rtol=1e-6, atol=1e-6
    )
    shift = rng.normal(size=n_features)
    squared = shift @ shift + np.trace(source) + np.trace(target) - 2 * np.trace(middle)
    distance = gaussian_wasserstein_distance(shift, source, np.zeros(n_features), target)
    assert distance**2 == pytest.approx(squared, rel=1e-9, abs=1e-9)


@given(seeds, dimensions)
@laws
def test_gaussian_distance_is_a_metric(seed, n_features):
    rng = np.random.default_rng(seed)
    a, b, c = ((rng.normal(size=n_features), positive_definite(rng, n_features)) for _ in range(3))
    assert gaussian_wasserstein_distance(*a, *b) == pytest.approx(
        gaussian_wasserstein_distance(*b, *a), rel=1e-9
    )
    assert gaussian_wasserstein_distance(*a, *a) < 1e-13 * np.sqrt(np.trace(a[1]))
    through = gaussian_wasserstein_distance(*a, *b) + gaussian_wasserstein_distance(*b, *c)
    assert gaussian_wasserstein_distance(*a, *c) <= through * (1 + 1e-12)


@given(seeds, dimensions)
@laws
def test_map_pushes_source_moments_onto_target_moments(seed, n_features):
    rng = np.random.default_rng(seed)
    X, y = skewed(rng, 60, n_features), skewed(rng, 40, n_features)
    transport = AffineTransport().fit(X, y)
    carried = transport.transform(X)
    scale = np.abs(y).max()
    np.testing.assert_allclose(carried.mean(axis=0), y.mean(axis=0), atol=1e-11 * scale)
    np.testing.assert_allclose(np.cov(carried.T, bias=True), np.cov(y.T, bias=True), atol=1e-10 * scale**2)
    displacement = np.sqrt(np.square(carried - X).sum(axis=1).mean())
    assert transport.wasserstein_distance_ == pytest.approx(displacement, rel=1e-9)


@given(seeds, dimensions)
@laws
def test_gelbrich_distance_of_normal_approximations_is_a_lower_bound(seed, n_features):
    rng = np.random.default_rng(seed)
    X, y = skewed(rng, 30, n_features), skewed(rng, 25, n_features)
    assert AffineTransport().fit(X, y).wasserstein_distance_ <= wasserstein_distance(X, y) * (1 + 1e-10)


@given(seeds, dimensions)
@laws
def test_a_positive_definite_map_is_the_optimal_one_and_is_found(seed, n_features):
    """Corollary 1 and Theorem 4: whatever the distribution of X."""
    rng = np.random.default_rng(seed)
    X, coef = skewed(rng, 25, n_features), positive_definite(rng, n_features)
    y = X @ coef + rng.normal(size=n_features)
    transport = AffineTransport().fit(X, y)
    np.testing.assert_allclose(transport.coef_, coef, atol=1e-7 * np.abs(coef).max())
    exact = wasserstein_distance(X, y)
    assert exact == pytest.approx(np.sqrt(np.square(X - y).sum(axis=1).mean()), rel=1e-9)
    assert exact == pytest.approx(transport.wasserstein_distance_, rel=1e-8)
    assert transport.score(X, y) == pytest.approx(1, abs=1e-7)


def test_score_is_one_only_where_the_affine_map_is_positive_semi_definite():
    """The paper says "affine"; a rotation is affine, yet a skewed sample and its rotation score low."""
    rng = np.random.default_rng(0)
    X = rng.exponential(size=(200, 2))
    assert AffineTransport().fit(X, -X).score(X, -X) < 0.9


@given(seeds, dimensions)
@laws
def test_transport_recovers_the_positive_factor_of_the_polar_decomposition(seed, n_features):
    """The linear case of Brenier: A = P U, and the optimal map from white X to A X is P."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n_features, n_features))
    _, positive = scipy.linalg.polar(A, side="left")
    # P is rooted in A A^T, whose condition is the square of A's.
    tolerance = 1e-14 * np.linalg.cond(A) ** 2
    assert relative_error(transport_map(np.eye(n_features), A @ A.T), positive) < tolerance


@given(seeds, dimensions)
@laws
def test_whitened_procrustes_recovers_every_invertible_affine_map(seed, n_features):
    rng = np.random.default_rng(seed)
    X, coef = skewed(rng, 40, n_features), rng.normal(size=(n_features, n_features))
    intercept = rng.normal(size=n_features)
    transport = ProcrustesAffineTransport().fit(X, X @ coef.T + intercept)
    condition = np.linalg.cond(coef) * np.linalg.cond(np.cov(X.T).reshape(n_features, n_features))
    assert relative_error(transport.coef_, coef) < 1e-13 * condition
    np.testing.assert_allclose(transport.rotation_ @ transport.rotation_.T, np.eye(n_features), atol=1e-12)
    back = transport.inverse_transform(transport.transform(X))
    np.testing.assert_allclose(back, X, atol=1e-11 * condition * np.abs(X).max())


@pytest.mark.parametrize("noise", [0.3, 3.0])
def test_procrustes_of_many_columns_is_the_map_of_the_formula(noise):
    rng = np.random.default_rng(0)
    n_features = 80
    X = (
        rng.normal(size=(3000, n_features)) @ (np.eye(n_features) + 0.05 * rng.normal(size=(n_features,) * 2))
        + 1
    )
    y = X @ (np.eye(n_features) + 0.05 * rng.normal(size=(n_features,) * 2)) + noise * rng.normal(
        size=X.shape
    )
    transport = ProcrustesAffineTransport().fit(X, y)
    factor = transport._moments[0].covariance_factor
    assert PairFactors(factor[:, :n_features], factor[:, n_features:]).triangles is not None
    joint = np.cov(X.T, y.T, bias=True)
    source, target, cross = joint[:80, :80], joint[80:, 80:], joint[80:, :80]
    roots = [np.real(scipy.linalg.sqrtm(part)) for part in (source, target)]
    rotation = scipy.linalg.polar(roots[1] @ cross @ np.linalg.inv(roots[0]))[0]
    np.testing.assert_allclose(transport.rotation_, rotation, atol=1e-10)
    np.testing.assert_allclose(transport.coef_, roots[1] @ rotation @ np.linalg.inv(roots[0]), atol=1e-10)
    np.testing.assert_allclose(transport.inverse_transform(transport.transform(X)), X, atol=1e-10)
    distance = gaussian_wasserstein_distance(X.mean(axis=0), source, y.mean(axis=0), target)
    assert transport.wasserstein_distance_ == pytest.approx(distance, rel=1e-10)


@pytest.mark.parametrize("how", ["shuffled", "a column twice"])
def test_many_columns_that_need_care_get_it(how):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(3000, 80))
    y = X + 0.3 * rng.normal(size=X.shape)
    if how == "shuffled":
        with pytest.warns(UserWarning, match="no correlation that shuffled rows would not show"):
            ProcrustesAffineTransport().fit(X, rng.permutation(y))
        return
    X[:, -1], y[:, -1] = X[:, 0], y[:, 0]
    transport = ProcrustesAffineTransport().fit(X, y)
    assert transport.rank_ == 79
    np.testing.assert_allclose(np.cov(transport.transform(X).T), np.cov(y.T), atol=1e-10)


@pytest.mark.parametrize("scale", [1e-6, 1.0])
def test_distance_of_many_columns_is_that_of_the_formula(scale):
    rng = np.random.default_rng(0)
    source = positive_definite(rng, 300) / 300
    change = np.eye(300) + scale * rng.normal(size=(300, 300)) / 20
    target = change @ source @ change.T
    root = np.real(scipy.linalg.sqrtm(target))
    direct = np.trace(source + target) - 2 * np.trace(np.real(scipy.linalg.sqrtm(root @ source @ root)))
    distance = gaussian_wasserstein_distance(np.zeros(300), source, np.zeros(300), target)
    # What is left of the formula's terms has as few digits as they cancel.
    assert distance**2 == pytest.approx(direct, abs=1e-12 * np.trace(source))


def test_algorithm_1_recovers_rotations_of_white_rows_but_not_every_affine_map():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200, 4))
    white = (X - X.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(X.T, bias=True))).T
    rotation = orthogonal(rng, 4)
    raw = ProcrustesAffineTransport(alignment="raw")
    assert relative_error(raw.fit(white, white @ rotation.T).coef_, rotation) < 1e-12
    errors = []
    for _ in range(20):
        coef = rng.normal(size=(4, 4))
        correlated = X @ rng.normal(size=(4, 4))
        errors.append(relative_error(raw.fit(correlated, correlated @ coef.T).coef_, coef))
    assert np.median(errors) > 0.1


def test_algorithm_1_step_by_step():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(50, 3)) + 2, rng.normal(size=(50, 3)) - 1
    y += X @ rng.normal(size=(3, 3))
    left, _, right = np.linalg.svd(y.T @ X)
    rotation = left @ right
    turned = X @ rotation.T
    coef = transport_map(np.cov(turned.T, bias=True), np.cov(y.T, bias=True)) @ rotation
    letter = ProcrustesAffineTransport(alignment="raw", center=False).fit(X, y)
    np.testing.assert_allclose(letter.rotation_, rotation, atol=1e-12)
    np.testing.assert_allclose(letter.coef_, coef, atol=1e-12)
    np.testing.assert_allclose(
        letter.transform(X), (X - X.mean(axis=0)) @ coef.T + y.mean(axis=0), atol=1e-12
    )


@pytest.mark.filterwarnings("ignore:the pairs carry no correlation")
@given(seeds, st.integers(2, 4))
@laws
def test_whitened_procrustes_has_the_least_error_of_all_maps_that_match_the_moments(seed, n_features):
    """Every such map is C_t^(1/2) Q C_s^(-1/2) with Q orthogonal; none that is tried does better."""
    rng = np.random.default_rng(seed)
    X = skewed(rng, 60, n_features)
    y = X @ rng.normal(size=(n_features, n_features)) + 2 * skewed(rng, 60, n_features)
    transport = ProcrustesAffineTransport()
    transport.fit(X, y)
    best = np.square(transport.transform(X) - y).sum(axis=1).mean()
    source_root = scipy.linalg.sqrtm(transport.source_covariance_).real
    target_root = scipy.linalg.sqrtm(transport.target_covariance_).real
    for scale in (1e-3, 0.1, 1, 10):
        skew = rng.normal(size=(n_features, n_features)) * scale
        turn = scipy.linalg.expm(skew - skew.T) @ transport.rotation_
        coef = target_root @ turn @ np.linalg.inv(source_root)
        other = (X - X.mean(axis=0)) @ coef.T + y.mean(axis=0)
        np.testing.assert_allclose(
            np.cov(other.T, bias=True), transport.target_covariance_, rtol=1e-5, atol=1e-5
        )
        assert best <= np.square(other - y).sum(axis=1).mean() * (1 + 1e-9)


@given(seeds, st.integers(1, 3), st.integers(1, 3))
@laws
def test_conditional_transport_leaves_the_context_and_matches_the_conditional_moments(
    seed, n_context, n_rest
):
    rng = np.random.default_rng(seed)
    c = rng.normal(size=(80, n_context))

    def rest():
        return c @ rng.normal(size=(n_context, n_rest)) + skewed(rng, 80, n_rest) + rng.normal(size=n_rest)

    X, y = np.hstack([c, rest()]), np.hstack([c, rest()])
    carried = ConditionalAffineTransport(context=n_context).fit(X, y).transform(X)
    np.testing.assert_array_equal(carried[:, :n_context], c)
    scale = np.abs(y).max()
    np.testing.assert_allclose(carried.mean(axis=0), y.mean(axis=0), atol=1e-11 * scale)
    np.testing.assert_allclose(np.cov(carried.T), np.cov(y.T), atol=1e-9 * scale**2)


@given(seeds)
@laws
def test_conditional_transport_recovers_a_change_that_is_positive_given_the_context(seed):
    """The next state changes by z' = B c + P z, with P positive definite; the rows are not paired."""
    rng = np.random.default_rng(seed)
    c = rng.normal(size=(60, 2))
    z = c @ rng.normal(size=(2, 3)) + skewed(rng, 60, 3)
    change, slope = positive_definite(rng, 3), rng.normal(size=(3, 2))
    X, y = np.hstack([c, z]), np.hstack([c, z @ change + c @ slope.T])
    transport = ConditionalAffineTransport(context=2).fit(X, rng.permutation(y))
    np.testing.assert_allclose(
        transport.coef_[2:], np.hstack([slope, change]), atol=1e-6 * np.abs(change).max()
    )


@given(seeds, dimensions)
@laws
def test_affinity_lies_between_zero_and_one_in_sample(seed, n_features):
    """Proposition 2: the independent coupling is one of those minimised over."""
    rng = np.random.default_rng(seed)
    X, y = skewed(rng, 25, n_features), skewed(rng, 30, n_features)
    transport = AffineTransport().fit(X, y)
    assert 0 <= transport.score(X, y) <= 1
    assert transport.score(X, y) == affinity(transport.transform(X), y)


def test_estimated_map_approaches_the_true_one_at_the_rate_of_the_square_root_of_n():
    rng = np.random.default_rng(0)
    source, target = positive_definite(rng, 4, 1), positive_definite(rng, 4, 1)
    true = transport_map(source, target)
    roots = np.linalg.cholesky(source), np.linalg.cholesky(target)

    def error(n_rows):
        samples = [[rng.normal(size=(n_rows, 4)) @ root.T for root in roots] for _ in range(60)]
        return np.mean([relative_error(AffineTransport().fit(*sample).coef_, true) for sample in samples])

    # Sixty repetitions know each mean error to about five per cent.
    assert error(200) / error(3200) == pytest.approx(4, rel=0.25)


def test_a_noise_free_linear_simulation_is_carried_to_the_targets_mean_given_the_context():
    rng = np.random.default_rng(0)
    inputs, slope = rng.normal(size=(400, 3)), rng.normal(size=(3, 2))
    X = np.hstack([inputs, inputs @ slope])
    y = np.hstack([inputs, 1.2 * inputs @ slope + 0.05 * rng.normal(size=(400, 2))])
    with pytest.warns(UserWarning, match=r"% of the target's variance cannot be reached"):
        transport = ConditionalAffineTransport(context=3).fit(X, y)
    best = LinearRegression().fit(inputs, y[:, 3:]).predict(inputs)
    np.testing.assert_allclose(transport.transform(X)[:, 3:], best, atol=1e-9)
    residual = np.square(y[:, 3:] - best).sum() / np.square(y[:, 3:] - y[:, 3:].mean(axis=0)).sum()
    assert transport.unreached_ == pytest.approx(residual, rel=1e-6)


@pytest.mark.parametrize("transport", [AffineTransport, ProcrustesAffineTransport])
def test_what_can_be_reached_is_carried_and_the_rest_is_the_share_that_is_said(transport):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(300, 2)) @ rng.normal(size=(2, 4))
    y = X + 0.1 * rng.normal(size=X.shape)
    with pytest.raises(np.linalg.LinAlgError, match='rank_deficient="reach"'):
        transport().fit(X, y)
    with pytest.warns(UserWarning, match="cannot be reached"):
        fitted = transport(rank_deficient="reach").fit(X, y)
    carried = fitted.transform(X)
    assert fitted.rank_ == 2
    assert 1 - carried.var(axis=0).sum() / y.var(axis=0).sum() == pytest.approx(fitted.unreached_, rel=1e-9)
    # What is carried is part of the target: its covariance exceeds that of the carried rows in no direction.
    least = np.linalg.eigvalsh(np.cov(y.T, bias=True) - np.cov(carried.T, bias=True))[0]
    assert least > -1e-12


def test_a_slope_drawn_to_the_sources_needs_fewer_rows_and_agrees_with_many():
    rng = np.random.default_rng(0)
    slope = rng.normal(size=(8, 3))

    def world(n_rows, factor):
        inputs = rng.normal(size=(n_rows, 8))
        return np.hstack([inputs, factor * inputs @ slope + 0.3 * rng.normal(size=(n_rows, 3))])

    X, test = world(2000, 1.0), rng.normal(size=(500, 8))
    expected = 1.05 * test @ slope
    errors = {}
    for n_rows in (15, 5000):
        y = world(n_rows, 1.05)
        for shrinkage in (None, "source"):
            fitted = ConditionalAffineTransport(context=8, shrinkage=shrinkage).fit(X, y)
            carried = fitted.transform(np.hstack([test, test @ slope]))[:, 8:]
            errors[n_rows, shrinkage] = np.linalg.norm(carried - expected, axis=1).mean()
    assert errors[15, "source"] < 0.6 * errors[15, None]
    assert errors[5000, "source"] == pytest.approx(errors[5000, None], rel=0.3)


def test_a_residual_regression_bends_the_map_where_pairs_show_it_and_is_left_out_where_they_do_not():
    rng = np.random.default_rng(0)
    X, fresh = rng.normal(size=(2, 300, 2))

    def bent(rows):
        return rows + np.column_stack([np.sin(2 * rows[:, 0]), np.zeros(len(rows))])

    plain, residual = (each.fit(X, bent(X)) for each in (ProcrustesAffineTransport(), ResidualTransport()))
    errors = [np.abs(each.transform(fresh) - bent(fresh)).mean() for each in (plain, residual)]
    assert errors[1] < 0.3 * errors[0]
    # A transport that matches a noisy target's variance errs more than one that does not, which has nothing to mend.
    nothing = ResidualTransport(IdentityTransport()).fit(X, X + rng.normal(size=X.shape))
    assert nothing.weights_.max() < 0.5
    assert np.abs(nothing.transform(fresh) - fresh).mean() < 0.1


def test_a_regression_that_predicts_nothing_weighs_nothing():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(60, 2))
    silent = DummyRegressor(strategy="constant", constant=np.zeros(2))
    fitted = ResidualTransport(regressor=silent).fit(X, X + rng.normal(size=X.shape))
    assert fitted.weights_.tolist() == [0.0, 0.0]
    assert fitted.regressor_ is None


def test_the_kernel_ridge_of_residuals_is_the_one_that_a_grid_search_finds():
    rng = np.random.default_rng(5)
    X = rng.normal(size=(75, 3)) * [1.0, 10.0, 0.1]
    y = np.column_stack([np.sin(X[:, 0]), X[:, 1] * X[:, 2]]) + 0.1 * rng.normal(size=(75, 2))
    pipeline = make_pipeline(StandardScaler(), KernelRidge(kernel="rbf"))
    grid = {"kernelridge__gamma": GAMMAS / 3, "kernelridge__alpha": PENALTIES}
    expected = GridSearchCV(pipeline, grid, cv=2, scoring="neg_mean_squared_error").fit(X, y)
    found = KernelRidgeCV().fit(X, y)
    chosen = found.model_.named_steps["kernelridge"]
    assert {"kernelridge__gamma": chosen.gamma, "kernelridge__alpha": chosen.alpha} == expected.best_params_
    np.testing.assert_allclose(found.predict(X), expected.predict(X), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        KernelRidgeCV().fit(X, y, sample_weight=np.ones(75)).predict(X),
        found.predict(X),
        rtol=1e-9,
        atol=1e-9,
    )


def test_a_weight_of_the_kernel_ridge_counts_as_repetitions():
    rng = np.random.default_rng(6)
    X = rng.normal(size=(40, 2))
    y = X + np.sin(2 * X)
    counts = np.concatenate([rng.integers(0, 4, size=19), [3], rng.integers(0, 4, size=20)])
    counts[20:] = rng.permutation(counts[:20])  # as many rows in either fold
    repeated = KernelRidgeCV().fit(np.repeat(X, counts, axis=0), np.repeat(y, counts, axis=0))
    weighted = KernelRidgeCV().fit(X, y, sample_weight=counts)
    np.testing.assert_allclose(weighted.predict(X), repeated.predict(X), rtol=1e-8, atol=1e-8)
    fitted = ResidualTransport().fit(X, y, sample_weight=counts)
    assert fitted.weights_.shape == (2,)
