"""Log likelihoods as quadratics: laws of what is added, left out and integrated out, by dense normal densities."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from skat.diagnosis.changes.windows import Quadratic, total, windows_of
from skat.diagnosis.forces.force_space import Rows

SPREAD, NONE = np.array([0.3, 2.0]), np.zeros(0)


def rows_of(seed, *, windows=4, n=12, k=3):
    rng = np.random.default_rng(seed)
    stretch = np.repeat(np.arange(windows), n)
    zeros = np.zeros(len(stretch))
    target, columns = rng.normal(size=len(stretch)), rng.normal(size=(len(stretch), k))
    return Rows(target, columns, zeros.astype(int), zeros, stretch, zeros), rng.uniform(0.5, 2, len(stretch))


def whitened(seed, *, n=30, k=4):
    rng = np.random.default_rng(seed)
    return rng.normal(size=n), rng.normal(size=(n, k))


def value_of(quadratic, x):
    return quadratic.level + quadratic.projections @ x - 0.5 * x @ quadratic.products @ x


def log_density(left, covariance):
    """Return the log density of what is left of rows but for the constant of white noise."""
    return multivariate_normal.logpdf(left, cov=covariance) + 0.5 * len(left) * np.log(2 * np.pi)


def assert_same(one, other, atol=1e-9):
    np.testing.assert_allclose(one.products, other.products, atol=atol)
    np.testing.assert_allclose(one.projections, other.projections, atol=atol)
    assert one.level == pytest.approx(other.level, abs=atol)


def test_a_quadratic_is_the_log_density_of_rows_at_every_effect():
    z, N = whitened(0)
    for x in np.random.default_rng(1).normal(size=(3, 4)):
        expected = log_density(z - N @ x, np.eye(len(z)))
        assert value_of(Quadratic.of(z, N), x) == pytest.approx(expected, rel=1e-9)


def test_rows_of_both_add_up_and_those_of_one_can_be_left_out():
    (z, N), (other_z, other_N) = whitened(0), whitened(1, n=7)
    one, other = Quadratic.of(z, N), Quadratic.of(other_z, other_N)
    both = Quadratic.of(np.r_[z, other_z], np.vstack([N, other_N]))
    assert_same(one + other, both)
    assert_same(both - other, one)


def test_further_effects_do_nothing():
    z, N = whitened(0)
    assert_same(Quadratic.of(z, N).widened(6), Quadratic.of(z, np.column_stack([N, np.zeros((len(z), 2))])))


@pytest.mark.parametrize("units", [np.ones(4), np.array([1e-7, 1e6, 1e5, 1e-6])], ids=["alike", "far apart"])
def test_what_is_integrated_out_is_in_the_covariance(units):
    z, N = whitened(2)
    weights = np.array([0.7, 2.0])
    found = Quadratic.of(z, N * units).integrated(weights * units[:2] ** 2)
    covariance = np.eye(len(z)) + (N[:, :2] / weights) @ N[:, :2].T
    assert found.level == pytest.approx(log_density(z, covariance), rel=1e-9)
    # What is common of the first effects is still there.
    for x in np.random.default_rng(3).normal(size=(3, 4)):
        assert value_of(found, x / units) == pytest.approx(log_density(z - N @ x, covariance), rel=1e-9)


@pytest.mark.parametrize("spread", [1e-8, 1e8])
def test_an_effect_that_does_nothing_is_integrated_out_to_nothing(spread):
    z, N = whitened(2)
    idle = Quadratic.of(z, np.column_stack([np.zeros(len(z)), N]))
    assert_same(idle.integrated(np.array([1 / spread])).without(1), Quadratic.of(z, N))


def test_what_is_held_where_it_is_is_integrated_out_to_nothing():
    z, N = whitened(2)
    assert_same(Quadratic.of(z, N).integrated(np.full(2, 1e14)), Quadratic.of(z, N), atol=1e-6)


def test_effects_are_integrated_out_one_after_the_other_as_all_at_once():
    z, N = whitened(4)
    weights = np.array([0.7, 2.0])
    whole = Quadratic.of(z, N)
    turned = whole.integrated(weights[:1]).without(1).integrated(weights[1:]).without(1)
    assert_same(turned, whole.integrated(weights).without(2))


def test_without_the_first_effects_these_are_zero():
    z, N = whitened(5)
    assert_same(Quadratic.of(z, N).without(2), Quadratic.of(z, N[:, 2:]))


def test_windows_are_quadratics_of_their_own_whitened_rows():
    rows, noise = rows_of(0)
    parts = windows_of(rows, noise, NONE)
    assert len(parts) == 4
    for place, part in enumerate(parts):
        own = rows.stretch == place
        assert_same(part, Quadratic.of(*rows.part(own).whitened(noise[own])))


def test_a_log_is_all_of_its_windows():
    rows, noise = rows_of(0)
    assert_same(total(windows_of(rows, noise, NONE)), Quadratic.of(*rows.whitened(noise)))


def test_without_effects_of_their_own_windows_have_the_covariance_that_these_make():
    rows, noise = rows_of(1)
    found = total(windows_of(rows, noise, SPREAD))
    z, N = rows.whitened(noise)
    own = (N[:, :2] * SPREAD) @ N[:, :2].T * (rows.stretch[:, None] == rows.stretch)
    covariance = np.eye(len(z)) + own
    assert found.level == pytest.approx(log_density(z, covariance), rel=1e-9)
    np.testing.assert_allclose(found.products, N.T @ np.linalg.solve(covariance, N), atol=1e-9)
    np.testing.assert_allclose(found.projections, N.T @ np.linalg.solve(covariance, z), atol=1e-9)
