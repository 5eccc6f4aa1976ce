"""The baselines do what their papers and POT do."""

import numpy as np
import ot
import pytest
import scipy.linalg

from skat import CORAL, AffineTransport, ExactTransport, IdentityTransport
from skat.transport.baselines import KernelAlignment


def samples(n_source=40, n_target=30):
    rng = np.random.default_rng(0)
    return rng.normal(size=(n_source, 3)) + 1, rng.exponential(size=(n_target, 3)) @ rng.normal(size=(3, 3))


def test_coral_whitens_and_colours():
    X, y = samples()
    source, target = np.cov(X.T, bias=True), np.cov(y.T, bias=True)
    coef = scipy.linalg.sqrtm(target).real @ np.linalg.inv(scipy.linalg.sqrtm(source).real)
    coral = CORAL().fit(X, y)
    np.testing.assert_allclose(coral.coef_, coef, rtol=1e-8, atol=1e-10)
    carried = coral.transform(X)
    np.testing.assert_allclose(carried.mean(axis=0), y.mean(axis=0), atol=1e-13)
    np.testing.assert_allclose(np.cov(carried.T, bias=True), target, atol=1e-13)
    moved = [
        np.square(transport.transform(X) - X).sum() for transport in (coral, AffineTransport().fit(X, y))
    ]
    assert moved[0] > moved[1]


def test_coral_matches_as_many_directions_as_the_source_has():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(60, 3)), rng.normal(size=(60, 3)) * [3, 2, 1]
    X[:, 2] = 0.5
    with pytest.warns(UserWarning, match=r"% of the target's variance cannot be reached"):
        coral = CORAL().fit(X, y)
    assert coral.rank_ == 2 == np.linalg.matrix_rank(coral.coef_)
    carried = np.linalg.eigvalsh(np.cov(coral.transform(X).T, bias=True))
    np.testing.assert_allclose(carried[1:], np.linalg.eigvalsh(np.cov(y.T, bias=True))[1:], rtol=1e-10)


def test_identity_leaves_every_bit():
    X, y = samples()
    identity = IdentityTransport().fit(X, y)
    np.testing.assert_array_equal(identity.transform(X), X)
    np.testing.assert_array_equal(identity.inverse_transform(X), X)
    np.testing.assert_array_equal(identity.coef_, np.eye(3))
    assert identity.wasserstein_distance_ == pytest.approx(
        AffineTransport().fit(X, y).wasserstein_distance_, rel=1e-10
    )


def test_exact_transport_is_what_pot_does():
    X, y = samples()
    reference = ot.da.EMDTransport().fit(Xs=X, Xt=y)
    exact = ExactTransport().fit(X, y)
    np.testing.assert_allclose(exact.coupling_, reference.coupling_, atol=1e-12)
    np.testing.assert_allclose(exact.transform(X), reference.transform(Xs=X), atol=1e-12)
    new = X[:7] + 0.1
    np.testing.assert_allclose(exact.transform(new), reference.transform(Xs=new), atol=1e-12)
    np.testing.assert_allclose(exact.inverse_transform(y), reference.inverse_transform(Xt=y), atol=1e-12)
    assert exact.wasserstein_distance_**2 == pytest.approx((exact.coupling_ * ot.dist(X, y)).sum(), rel=1e-12)


def test_exact_transport_of_equal_numbers_is_a_permutation():
    X, y = samples(30, 30)
    carried = ExactTransport().fit(X, y).transform(X)
    np.testing.assert_allclose(np.sort(carried, axis=0), np.sort(y, axis=0), atol=1e-12)


def test_exact_transport_heeds_weights():
    X, y = np.array([[0.0], [1.0]]), np.array([[0.0], [2.0]])
    exact = ExactTransport().fit(X, y, sample_weight=([3, 1], [1, 1]))
    np.testing.assert_allclose(exact.coupling_, [[0.5, 0.25], [0.0, 0.25]], atol=1e-12)
    np.testing.assert_allclose(exact.transform(X), [[2 / 3], [2.0]], atol=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_kernel_alignment_refuses_one_value_that_is_not_finite(value):
    X, y = samples()
    broken = y.copy()
    broken[3, 0] = value
    with pytest.raises(ValueError, match="y"):
        KernelAlignment().fit(X, broken)
    with pytest.raises(ValueError, match="X"):
        KernelAlignment(n_components=10).fit(X, y).transform(
            np.where(np.arange(len(X))[:, None] == 2, value, X)
        )
