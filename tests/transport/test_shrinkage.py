"""What shrinkage promises: less error with few target rows, hardly ever more."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skat import AffineTransport, ConditionalAffineTransport, ProcrustesAffineTransport
from skat.gaussian import transport_map
from skat.gaussian.moments import row_moments
from skat.transport.regression import ridge_regression
from skat.transport.shrinkage import _explained, shrinkage_intensity, shrunk_towards
from tests.transport.reference import relative_error


def error_ratio(change, n_target, n_features, n_repeats=25):
    """Return the mean error of the shrunk map over that of the empirical one."""
    rng = np.random.default_rng(0)
    errors = np.zeros(2)
    for _ in range(n_repeats):
        root = rng.normal(size=(n_features, n_features))
        source = root @ root.T / n_features + 0.1 * np.eye(n_features)
        coef = change(rng, n_features)
        target = coef @ source @ coef.T
        true = transport_map(source, target)
        X = rng.normal(size=(3000, n_features)) @ np.linalg.cholesky(source).T
        y = rng.normal(size=(n_target, n_features)) @ np.linalg.cholesky(target).T
        errors += [
            relative_error(AffineTransport(covariance=covariance).fit(X, y).coef_, true)
            for covariance in ("shrunk", "empirical")
        ]
    return errors[0] / errors[1]


def paired_error_ratio(change, noise, n_pairs, alignment, n_features=27, n_repeats=6):
    """Return the same for maps from pairs, whose error is measured against the map of the population."""
    rng = np.random.default_rng(0)
    errors = np.zeros(2)
    for _ in range(n_repeats):
        root = rng.normal(size=(n_features, n_features))
        source = root @ root.T / n_features + 0.1 * np.eye(n_features)
        coef = change(rng, n_features)
        target = coef @ source @ coef.T + noise**2 * np.eye(n_features)
        true = map_of_pairs(source, target, coef @ source, alignment)
        X = rng.normal(size=(n_pairs, n_features)) @ np.linalg.cholesky(source).T
        y = X @ coef.T + noise * rng.normal(size=(n_pairs, n_features))
        for k, covariance in enumerate(("shrunk", "empirical")):
            transport = ProcrustesAffineTransport(alignment=alignment, covariance=covariance).fit(X, y)
            errors[k] += relative_error(transport.coef_, true)
    return errors[0] / errors[1]


def map_of_pairs(source, target, cross, alignment):
    """Return the map of `ProcrustesAffineTransport` by its definition."""
    if alignment == "raw":
        rotation = polar_factor(cross)
        return transport_map(rotation @ source @ rotation.T, target) @ rotation
    source_root, target_root = symmetric_root(source), symmetric_root(target)
    turn = polar_factor(np.linalg.solve(source_root, (target_root @ cross).T).T)
    return np.linalg.solve(source_root, (target_root @ turn).T).T


def symmetric_root(matrix):
    variance, axes = np.linalg.eigh(matrix)
    return (axes * np.sqrt(variance)) @ axes.T


def polar_factor(matrix):
    left, _, right = np.linalg.svd(matrix)
    return left @ right


def same(rng, n_features):
    return np.eye(n_features)


def rescaled(rng, n_features):
    return np.diag(rng.uniform(0.7, 1.5, size=n_features))


def perturbed(rng, n_features):
    return np.eye(n_features) + 0.1 * rng.normal(size=(n_features, n_features))


def unrelated(rng, n_features):
    return rng.normal(size=(n_features, n_features)) / np.sqrt(n_features)


@pytest.mark.filterwarnings("ignore:.*rows cannot show how")
@pytest.mark.parametrize("n_target", [20, 50, 100])
@pytest.mark.parametrize(
    ("change", "at_most"), [(same, 0.3), (rescaled, 0.85), (perturbed, 0.95), (unrelated, 1.02)]
)
def test_shrinkage_lowers_the_error_of_the_map_and_never_raises_it_by_more_than_2_per_cent(
    change, at_most, n_target
):
    assert error_ratio(change, n_target, 27) < at_most


@pytest.mark.parametrize("change", [same, rescaled, perturbed, unrelated])
def test_shrinkage_does_no_harm_where_there_are_rows_enough(change):
    assert error_ratio(change, 2000, 5, n_repeats=40) < 1.02


@given(st.integers(0, 2**32 - 1), st.integers(2, 5))
@settings(max_examples=30, deadline=None)
def test_shrinkage_does_not_depend_on_units(seed, n_features):
    rng = np.random.default_rng(seed)
    X, y = rng.normal(size=(100, n_features)), rng.normal(size=(12, n_features)) * 2
    change = np.eye(n_features) + 0.3 * rng.normal(size=(n_features, n_features))
    target, intensity = shrunk_towards(row_moments(y), row_moments(X))
    changed, same_intensity = shrunk_towards(row_moments(y @ change.T), row_moments(X @ change.T))
    assert intensity == pytest.approx(same_intensity, abs=1e-8)
    np.testing.assert_allclose(
        changed.covariance, change @ target.covariance @ change.T, rtol=1e-6, atol=1e-8
    )


def test_intensity_is_one_without_and_nearly_zero_with_endless_rows():
    values = np.array([0.5, 1.0, 2.0])
    assert shrinkage_intensity(values, 1) == 1.0
    assert shrinkage_intensity(values, 1e9) < 1e-8
    rising = [shrinkage_intensity(values, n_rows) for n_rows in (1000, 100, 30, 10)]
    assert rising == sorted(rising)


def test_partial_fit_shrinks_as_fit_does():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(100, 4)), 2 * rng.normal(size=(15, 4))
    whole = AffineTransport(covariance="shrunk").fit(X, y)
    parts = AffineTransport(covariance="shrunk").partial_fit(X, y[:6]).partial_fit(y=y[6:])
    assert 0 < whole.shrinkage_ < 1
    assert parts.shrinkage_ == pytest.approx(whole.shrinkage_, rel=1e-12)
    np.testing.assert_allclose(parts.coef_, whole.coef_, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(
        whole.coef_ @ whole.source_covariance_ @ whole.coef_, whole.target_covariance_, rtol=1e-10, atol=1e-12
    )


@pytest.mark.parametrize("alignment", ["whitened", "raw"])
@pytest.mark.parametrize("noise", [0.02, 0.1, 0.3, 1.0])
@pytest.mark.parametrize("change", [same, rescaled, perturbed, unrelated])
def test_shrinkage_never_raises_the_error_of_a_map_from_pairs_by_more_than_2_per_cent(
    change, noise, alignment
):
    assert paired_error_ratio(change, noise, 100, alignment) < 1.02


def test_shrinkage_still_lowers_the_error_of_a_map_from_noisy_pairs():
    assert paired_error_ratio(same, 0.3, 100, "whitened") < 0.93
    assert paired_error_ratio(rescaled, 0.3, 100, "whitened") < 0.98


@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
@settings(max_examples=30, deadline=None)
def test_pairs_without_noise_are_not_shrunk(seed, n_features):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(20, n_features))
    change = np.linalg.qr(rng.normal(size=(n_features, n_features)))[0] * rng.uniform(1.5, 3, size=n_features)
    transport = ProcrustesAffineTransport(covariance="shrunk").fit(X, X @ change.T)
    assert transport.shrinkage_ < 1e-9
    np.testing.assert_allclose(transport.coef_, change, rtol=1e-7, atol=1e-7)


def test_intensity_of_pairs_is_that_of_the_variance_given_the_source_rows():
    """The numerator, against the scatter of roots over samples of the noise, the source rows held."""
    rng = np.random.default_rng(0)
    n_pairs, coef, noise = 2000, np.diag([0.4, 1.5, 0.9]), np.array([0.8, 0.5, 0.1])
    X = rng.normal(size=(n_pairs, 3))
    X = np.linalg.qr(X - X.mean(axis=0))[0] * np.sqrt(n_pairs)
    root = np.sqrt(np.diagonal(coef) ** 2 + noise**2)
    squares, estimates = [], []
    for _ in range(300):
        y = X @ coef.T + noise * rng.normal(size=(n_pairs, 3))
        target, source = row_moments(y), row_moments(X)
        sample_root = symmetric_root(target.covariance)
        _, intensity = shrunk_towards(target, source, row_moments(np.hstack([X, y])))
        squares.append(np.square(sample_root - np.diag(root)).sum())
        estimates.append(intensity * np.square(sample_root - np.eye(3)).sum())
    assert np.mean(estimates) == pytest.approx(np.mean(squares), rel=0.15)


def test_pairs_that_are_not_are_shrunk_as_unpaired_rows_are():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(2, 300, 4)) * [[[1.0]], [[1.3]]]
    target, source = row_moments(y), row_moments(X)
    _, paired = shrunk_towards(target, source, row_moments(np.hstack([X, y])))
    _, unpaired = shrunk_towards(target, source)
    assert paired == pytest.approx(unpaired, rel=0.01)


def near_domains(rng, n_rows, shift, n_features=10):
    """Return 1,000 source rows, few target rows of a law whose mean is so many deviations off, and that mean."""
    source_root = rng.normal(size=(n_features, n_features))
    target_root = source_root @ (np.eye(n_features) + 0.1 * rng.normal(size=source_root.shape))
    mean = shift * source_root[:, 0]
    source = rng.normal(size=(1000, n_features)) @ source_root.T
    return source, rng.normal(size=(n_rows, n_features)) @ target_root.T + mean, mean, source_root


@pytest.mark.parametrize(
    ("shift", "n_rows"),
    [
        (0.0, 30),
        (0.5, 8),
        (3.0, 30),
        *(pytest.param(*case, marks=pytest.mark.long) for case in [(0.0, 8), (0.5, 30), (3.0, 8)]),
    ],
)
def test_a_shrunk_mean_errs_less_than_the_plain_one_wherever_the_mean_is(shift, n_rows):
    rng = np.random.default_rng(0)
    errors = {"empirical": [], "shrunk": []}
    for _ in range(150):
        X, y, mean, root = near_domains(rng, n_rows, shift)
        for kind, found in errors.items():
            fitted = AffineTransport(mean=kind, covariance="shrunk").fit(X, y)
            found.append(np.square(np.linalg.solve(root, fitted.target_mean_ - mean)).sum())
    ratio = np.mean(errors["shrunk"]) / np.mean(errors["empirical"])
    # With fewer rows than columns the largest error looks larger than it is, and less is drawn.
    assert ratio < (0.5 if shift == 0 and n_rows > 10 else 1.0)


def test_a_shrunk_mean_does_not_depend_on_units_and_is_the_formula():
    rng = np.random.default_rng(1)
    X, y, _, _ = near_domains(rng, 20, 0.3)
    fitted = AffineTransport(mean="shrunk").fit(X, y)
    root = np.linalg.cholesky(np.cov(X.T, bias=True))
    shift = np.linalg.solve(root, y.mean(axis=0) - X.mean(axis=0))
    whitened = np.linalg.solve(root, np.linalg.solve(root, np.cov(y.T, bias=True)).T)
    error = whitened / 19 + np.eye(10) / 999
    weight = (np.trace(error) - 2 * np.linalg.eigvalsh(error).max()) / (shift @ shift)
    assert 0 < weight < 1
    assert fitted.mean_shrinkage_ == pytest.approx(weight, rel=1e-9)
    np.testing.assert_allclose(
        fitted.target_mean_, (1 - weight) * y.mean(axis=0) + weight * X.mean(axis=0), rtol=1e-8, atol=1e-10
    )
    units = np.logspace(-3, 3, 10)
    other = AffineTransport(mean="shrunk").fit(X * units, y * units)
    np.testing.assert_allclose(other.target_mean_ / units, fitted.target_mean_, rtol=1e-8, atol=1e-10)


def test_of_pairs_only_what_partners_do_not_share_shrinks_the_mean():
    rng = np.random.default_rng(2)
    X = rng.normal(size=(30, 5))
    y = X + 0.5 + 1e-3 * rng.normal(size=X.shape)
    paired = ProcrustesAffineTransport(mean="shrunk").fit(X, y)
    assert paired.mean_shrinkage_ < 1e-5 < AffineTransport(mean="shrunk").fit(X, y).mean_shrinkage_
    given = ConditionalAffineTransport(context=2, mean="shrunk").fit(X, y)
    np.testing.assert_array_equal(given.transform(X)[:, :2], X[:, :2])
    # Of two columns James and Stein shrink nothing.
    assert AffineTransport(mean="shrunk").fit(X[:, :2], y[:, :2]).mean_shrinkage_ == 0
    parts = AffineTransport(mean="shrunk").partial_fit(X[:10], y[:10]).partial_fit(X[10:], y[10:])
    np.testing.assert_allclose(
        parts.coef_, AffineTransport(mean="shrunk").fit(X, y).coef_, rtol=1e-9, atol=1e-12
    )
    again = pickle.loads(pickle.dumps(paired))
    np.testing.assert_array_equal(again.transform(X), paired.transform(X))


def test_what_pairs_explain_is_the_share_of_variance_adjusted_for_chance():
    """Of one column on one, by the textbook: 1 - (1 - R^2) (n - 1) / (n - 2)."""
    for cosine, expected in ((0.8, 1 - (1 - 0.64) * 11 / 10), (0.1, 0.0)):
        assert _explained(np.array([[cosine]]), 12) == pytest.approx(expected, rel=1e-12)
    assert _explained(np.array([[1.0]]), 2) == 0.0


@pytest.mark.parametrize("unit", [1e-4, 1e4])
def test_a_slope_drawn_to_the_source_has_no_unit_of_its_own(unit):
    rng = np.random.default_rng(3)
    context = rng.normal(size=(40, 6))
    outcome = context @ rng.normal(size=(6, 2)) + rng.normal(size=(40, 2))
    known, prior = np.arange(8) < 6, rng.normal(size=(2, 6))
    plain, _, freedom = ridge_regression(row_moments(np.hstack([context, outcome])), known, prior)
    scaled, _, same = ridge_regression(row_moments(np.hstack([context, unit * outcome])), known, unit * prior)
    np.testing.assert_allclose(scaled, unit * plain, rtol=1e-9)
    assert same == pytest.approx(freedom)


@pytest.mark.parametrize("n_columns", [1, 2])
def test_the_way_back_from_a_map_drawn_to_the_source_is_its_inverse(n_columns):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200, 4)) @ rng.normal(size=(4, 4))
    if n_columns == 1:
        # The third column follows from the others, in both domains.
        X[:, 2] = X[:, 0] + X[:, 3]
    y = X[:20] * [1.0, 1.0, 2.0, 2.0] + [0.0, 0.0, 1.0, 3.0]
    y[:, 3] += rng.normal(size=20)
    y[:, 2] = y[:, 0] + y[:, 3] if n_columns == 1 else y[:, 2]
    transport = ConditionalAffineTransport(context=2, shrinkage="source").fit(X, y)
    np.testing.assert_allclose(transport.inverse_transform(transport.transform(X)), X, atol=1e-11)
