"""What the noise is estimated by, against quadrature, dense normal laws and general optimisers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, optimize, stats

from skat.diagnosis.chains import Chains, Memory
from skat.diagnosis.noise import (
    DEGREES_OF_FREEDOM,
    FINEST,
    Noise,
    _best_scales,
    _cost_of_scales,
    _look,
    _of_variances,
    _scales,
    estimate_noise,
    expected_squares,
    normal_noise,
    passed,
    precisions,
    scales_of,
    variances_of,
)


def walks(seed=0, *, n=3, steps=40, force=0.04, error=0.09, prior=4.0):
    """Return the chains of random walks that are read with noise."""
    rng = np.random.default_rng(seed)
    start = np.sqrt(prior) * rng.normal(size=(n, 1))
    path = np.c_[start, start + np.cumsum(np.sqrt(force) * rng.normal(size=(n, steps)), axis=1)]
    return Chains(
        np.ones((n, steps, 1, 1)),
        np.zeros((n, steps, 1)),
        np.zeros((n, steps, 1, 1)),
        np.ones((n, steps, 1, 1)),
        (path + np.sqrt(error) * rng.normal(size=path.shape))[..., None],
        np.ones((n, steps + 1, 1), dtype=bool),
        np.array([prior]),
    )


def likelihood(chains, force, error):
    """Return the log density of random walks that are read with noise, from their covariance."""
    steps = np.arange(chains.measured.shape[1])
    covariance = chains.prior[0] + force * np.minimum.outer(steps, steps) + error * np.eye(len(steps))
    law = stats.multivariate_normal(np.zeros(len(steps)), covariance)
    return sum(law.logpdf(one) for one in chains.measured[..., 0])


def test_normal_noise_has_even_weights_and_its_variances():
    chains = walks(n=2, steps=5)
    noise = normal_noise(chains, [0.3], [0.7])
    assert noise.force_variances.shape == (2, 5, 1)
    assert noise.error_variances.shape == (2, 6, 1)
    assert (noise.force_variances == 0.3).all()
    assert (noise.error_variances == 0.7).all()
    assert np.isinf(np.r_[noise.force_nu, noise.error_nu]).all()


@pytest.mark.parametrize(("force", "error"), [(0.04, 0.09), (1.0, 1e-3), (0.0, 0.5)])
def test_the_bound_of_normal_noise_is_the_likelihood(force, error):
    chains, real = walks(), np.ones((3, 40), dtype=bool)
    estimate = passed(chains, normal_noise(chains, [force], [error]), real)
    assert estimate.bound == pytest.approx(likelihood(chains, force, error), rel=1e-9)


@pytest.mark.parametrize("start", [(1.0, 1.0), (1e-4, 1.0), (1.0, 1e-4)])
def test_variances_are_those_of_the_largest_likelihood_wherever_they_begin(start):
    chains, real = walks(seed=2, n=6, steps=15), np.ones((6, 15), dtype=bool)
    found = estimate_noise(
        chains,
        normal_noise(chains, [start[0]], [start[1]]),
        real,
        floor=np.zeros(1),
        heavy=False,
        tolerance=1e-4,
    )
    best = optimize.minimize(
        lambda logs: -likelihood(chains, *np.exp(logs)), np.log([0.04, 0.09]), method="Nelder-Mead", tol=1e-2
    )
    assert found.bound == pytest.approx(-best.fun, abs=0.02)
    np.testing.assert_allclose([found.noise.force[0, 0], found.noise.error[0, 0]], np.exp(best.x), rtol=0.1)
    assert found.smoothed.covariances.shape == (6, 16, 1, 1)


def test_a_search_that_may_end_sooner_ends_lower_but_never_below_its_start():
    chains, real = walks(steps=20), np.ones((3, 20), dtype=bool)
    start = normal_noise(chains, [1e-3], [4.0])
    bounds = [
        estimate_noise(chains, start, real, floor=np.zeros(1), heavy=False, **options).bound
        for options in ({"tolerance": np.inf}, {"tolerance": 5.0}, {"tolerance": 1e-4})
    ]
    assert likelihood(chains, 1e-3, 4.0) < bounds[0] <= bounds[1] < bounds[2] + 1e-9


def test_no_noise_is_finer_than_any_sensor_or_below_its_floor():
    chains = walks(force=0.0, error=0.0)
    real = np.ones((3, 40), dtype=bool)
    options = {"heavy": False, "tolerance": 1e-9}
    start = normal_noise(chains, [1e-20], [1e-20])
    assert estimate_noise(chains, start, real, floor=np.zeros(1), **options).noise.error[0] >= FINEST * 4.0
    assert estimate_noise(chains, start, real, floor=np.array([1e-4]), **options).noise.error[0] == 1e-4
    # What was given stays below the floor.
    held = estimate_noise(chains, start, real, floor=np.array([1e-4]), held=np.array([True]), **options)
    assert held.noise.error[0] == 1e-20


def test_a_noise_so_fine_that_no_filter_runs_with_it_is_a_start_all_the_same():
    """The first place moves by a million times the second, and both are read as well as anything is."""
    rng, n, steps, prior = np.random.default_rng(0), 2, 10, np.array([1e-6, 1.0])
    eye = np.tile(np.eye(2), (n, steps, 1, 1))
    chains = Chains(
        eye + 1e6 * np.eye(2, k=1), np.zeros((n, steps, 2)), 0 * eye, eye,
        np.sqrt(prior) * rng.normal(size=(n, steps + 1, 2)), np.ones((n, steps + 1, 2), dtype=bool), prior,
    )  # fmt: skip
    noise, real = normal_noise(chains, [1e-30, 1e-30], FINEST * prior), np.ones((n, steps), dtype=bool)
    with pytest.raises(np.linalg.LinAlgError):
        passed(chains, noise, real)
    assert np.isfinite(estimate_noise(chains, noise, real, floor=np.zeros(2)).bound)
    with pytest.raises(np.linalg.LinAlgError):  # what was given stays
        estimate_noise(chains, noise, real, floor=np.zeros(2), held=np.ones(2, dtype=bool))


def test_expected_squares_are_not_below_zero_by_rounding():
    """As a rounded variance can be, where next to nothing is left; otherwise they are of what was found."""
    chains, real = walks(steps=5), np.ones((3, 5), dtype=bool)
    smoothed = passed(chains, normal_noise(chains, [0.3], [0.7]), real).smoothed
    whole = expected_squares(smoothed)
    np.testing.assert_array_equal(whole[0], smoothed.forces**2 + smoothed.force_variances)
    np.testing.assert_array_equal(whole[1], smoothed.errors**2 + smoothed.error_variances)
    none = np.zeros_like
    rounded = replace(
        smoothed, forces=none(smoothed.forces), force_variances=-1e-17 * smoothed.force_variances,
        errors=none(smoothed.errors), error_variances=-1e-17 * smoothed.error_variances,
    )  # fmt: skip
    assert all((one == 0).all() for one in expected_squares(rounded))


@pytest.mark.parametrize("nu", [3.0, 5.0])
@pytest.mark.parametrize("mean", [0.2, 1.0, 1.4])
def test_scales_cost_their_divergence_from_their_law_and_gain_the_mean_of_their_logarithm(nu, mean):
    """By quadrature over a Gamma variable of shape (nu + 1) / 2 and that mean, against one of mean 1."""
    own, law = (
        stats.gamma((nu + 1) / 2, scale=2 * mean / (nu + 1)),
        stats.gamma(nu / 2, scale=2 / nu),
    )

    def cost(w):
        return own.pdf(w) * (0.5 * np.log(w) - own.logpdf(w) + law.logpdf(w))

    expected, _ = integrate.quad(cost, 0, own.ppf(1 - 1e-14), limit=200)
    weights = np.full((2, 3, 2), 7.0)
    weights[..., 1] = mean
    present = np.ones((2, 3, 1), dtype=bool)
    present[0, 0] = False
    law = np.zeros(2, dtype=int)
    told = _cost_of_scales(weights, np.array([[np.inf, nu]]), law, present)
    # The normal likelihood at the expected precision has half of its logarithm already.
    assert told == pytest.approx(5 * (expected - 0.5 * np.log(mean)), rel=1e-5)
    assert _cost_of_scales(weights, np.full((1, 2), np.inf), law, present) == 0.0


def test_precisions_are_expected_ones_where_something_is():
    squares = np.array([[[4.0, 4.0]], [[0.0, 1.0]]])
    present = np.array([[[True, True]], [[True, False]]])
    weights = precisions(squares, np.array([2.0, 0.5]), np.array([np.inf, 3.0]), present)
    assert weights[..., 0].tolist() == [[1.0], [1.0]]
    assert weights[:, 0, 1].tolist() == [(3 + 1) / (3 + 4 / 0.5), 1.0]


def test_without_tails_the_likeliest_scale_is_the_mean_square_of_what_is_there():
    squares = np.array([[1.0, 3.0], [2.0, 5.0], [100.0, 7.0]])
    seen = np.array([[True, True], [True, True], [False, True]])
    assert _best_scales(squares, seen, np.ones(2), np.inf).tolist() == [1.5, 5.0]
    nothing = _best_scales(squares, np.zeros((3, 2), dtype=bool), np.ones(2), np.inf)
    assert (nothing > 0).all()
    assert (nothing < 1e-200).all()


@pytest.mark.parametrize("nu", [3.0, np.inf])
def test_degrees_of_freedom_are_the_likeliest_of_the_grid(nu):
    rng = np.random.default_rng(1)
    values = rng.standard_t(nu, size=(4, 250, 1)) if np.isfinite(nu) else rng.normal(size=(4, 250, 1))
    found, _ = _scales(values**2, np.ones(1), np.ones(values.shape, dtype=bool))

    def best(one):
        law = stats.norm if np.isinf(one) else stats.t(one)
        return optimize.minimize_scalar(
            lambda log: -law.logpdf(values / np.exp(log)).sum() + values.size * log
        ).fun

    assert found[0] == min(DEGREES_OF_FREEDOM, key=best)


def test_a_variance_is_multiplied_by_what_is_left_of_it_over_what_was_told():
    """Of a force that was told exactly nothing is left of its variance: the mean square itself."""
    rng = np.random.default_rng(0)
    means, prior = rng.normal(size=(2, 30, 1)), np.full((2, 30, 1), 0.5)
    present = np.ones((2, 30, 1), dtype=bool)
    present[1, 10:] = False

    def ratio(means, variances, prior):
        slopes, curvatures, _ = _of_variances(means, 1 - variances / prior, prior, present)
        return np.exp(slopes / curvatures)

    known = ratio(means, np.zeros((2, 30, 1)), prior)
    assert known[0] == pytest.approx(np.mean(means[present] ** 2) / 0.5)
    # Of what was told half, squares count for as much less.
    told = ratio(means, prior / 2, prior)
    assert told[0] == pytest.approx(2 * known[0])
    # What nothing tells of stays.
    assert ratio(means, prior, prior)[0] == 1.0
    # A sample of twice the precision has half of the variance.
    weights = np.where(np.arange(30) % 2, 2.0, 1.0)[None, :, None] * np.ones((2, 1, 1))
    even = ratio(means / np.sqrt(weights), 0 * prior, prior / weights)
    assert even[0] == pytest.approx(known[0])


@pytest.mark.parametrize("start", [1e-6, 1e6])
def test_a_start_far_off_comes_to_the_same_variances(start):
    chains = walks(n=6, steps=60)
    real = np.ones((6, 60), dtype=bool)
    begun = (normal_noise(chains, np.array([one]), np.array([0.09])) for one in (0.04, 0.04 * start))
    near, far = (estimate_noise(chains, one, real, floor=np.zeros(1), tolerance=1e-6) for one in begun)
    assert far.bound == pytest.approx(near.bound, abs=0.01)
    np.testing.assert_allclose(far.noise.force, near.noise.force, rtol=0.02)


@pytest.mark.parametrize("given", [False, True])
def test_beside_a_noise_that_does_not_move_the_force_is_the_likeliest(given):
    """What would lower the sensor's noise is not taken from the force."""
    chains, real = walks(n=6, steps=60, force=0.09, error=0.01), np.ones((6, 60), dtype=bool)
    floor = np.array([0.0 if given else 0.09])
    begun = normal_noise(chains, np.array([0.09]), np.array([0.09]))
    held = np.array([given])
    found = estimate_noise(chains, begun, real, floor=floor, held=held, heavy=False, tolerance=1e-6)
    assert found.noise.error[0, 0] == 0.09
    best = optimize.minimize_scalar(
        lambda force: -likelihood(chains, force, 0.09),
        bounds=(0.01, 0.2),
        method="bounded",
        options={"xatol": 1e-6},
    )
    assert found.noise.force[0, 0] == pytest.approx(best.x, rel=1e-3)


def test_passes_are_few_where_a_variance_is_hardly_told_from_another():
    """Of a walk whose steps are a tenth of what it is read with, a step by the ratio alone goes a share of the way."""
    chains, passes = walks(n=6, steps=60, force=0.0009, error=0.09), []

    def counted(*arguments, **options):
        passes.append(1)
        return passed(*arguments, **options)

    real = np.ones((6, 60), dtype=bool)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("skat.diagnosis.noise.passed", counted)
        found = estimate_noise(
            chains, normal_noise(chains, [0.09], [0.01]), real, floor=np.zeros(1), tolerance=0.01
        )
    assert len(passes) < 17
    best = optimize.minimize(
        lambda logs: -passed(chains, normal_noise(chains, *np.exp(logs)[:, None]), real).bound,
        np.log([0.0009, 0.09]),
        method="Nelder-Mead",
    )
    assert found.bound == pytest.approx(-best.fun, abs=0.1)


def test_a_noise_of_samples_with_weights_has_their_variances():
    one = np.ones((1, 2, 1))
    noise = Noise(
        *(np.array([[value]]) for value in (4.0, 9.0, 3.0, 5.0)),
        np.zeros(1, dtype=int),
        2 * one,
        np.ones((1, 3, 1)) / 3,
    )
    assert noise.force_variances.ravel().tolist() == [2.0, 2.0]
    np.testing.assert_allclose(noise.error_variances.ravel(), 27.0)


# -- what a step is taken from ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("returns", [False, True])
def test_slopes_are_those_of_the_likelihood_of_lasting_forces_and_of_shares_too(returns):
    """Two walks that the same pushes drive, white and lasting ones, from chains that begin with what lasts."""
    rng, memory = np.random.default_rng(3), Memory(2, 0.9, returns=returns)
    chains = two_walks(rng, n=12, steps=15).with_memory(memory)
    mixing = np.tile([[1.0, 0.0], [0.6, 1.0]], (1, 1, 1))
    noise = replace(normal_noise(chains, [0.5, 0.3, 0.2, 0.1], [0.1, 0.2, 1.0, 1.0]), mixing=mixing)
    real = np.ones((12, 15), dtype=bool)
    look = _look(chains, passed(chains, noise, real), real, np.zeros(4), None)

    def bound(place, step):
        force, error, share = noise.force.copy(), noise.error.copy(), np.eye(2)
        if place < 4:
            force[0, place] *= np.exp(step)
        elif place < 8:
            error[0, place - 4] *= np.exp(step)
        else:
            share[1, 0] = step
        return passed(chains, replace(noise, force=force, error=error, mixing=mixing @ share), real).bound

    slopes = [(bound(place, 1e-5) - bound(place, -1e-5)) / 2e-5 for place in range(9)]
    np.testing.assert_allclose(look.slopes, slopes, rtol=1e-4, atol=1e-4)
    # Of hidden channels nothing is known.
    assert (look.information[6:8] == 0).all()


def two_walks(rng, *, n, steps):
    pushes = rng.normal(size=(n, steps, 2)) @ np.array([[1.0, 0.5], [0.0, 0.7]])
    places = np.concatenate([np.zeros((n, 1, 2)), np.cumsum(pushes, axis=1)], axis=1)
    eye = np.tile(np.eye(2), (n, steps, 1, 1))
    return Chains(
        eye + 1e-9, np.zeros((n, steps, 2)), 0 * eye, eye, places + 0.3 * rng.normal(size=places.shape),
        np.ones(places.shape, dtype=bool), np.full(2, 4.0),
    )  # fmt: skip


def test_laws_of_several_logs_are_pooled_by_what_acts_on_joints():
    """Each log's pushes act on the second joint as well, in one to one side, in the other to the other."""
    chains = two_walks(np.random.default_rng(0), n=2, steps=3)
    noise = normal_noise(chains, [[1.0, 0.01], [1.0, 0.01]], np.ones((2, 2)), np.array([0, 1]))
    noise = replace(noise, mixing=np.array([[[1.0, 0.0], [1.0, 1.0]], [[1.0, 0.0], [-1.0, 1.0]]]))
    pooled = noise.pooled()
    np.testing.assert_allclose(pooled.joint_force, noise.joint_force.mean(axis=0, keepdims=True))
    np.testing.assert_allclose(pooled.mixing, np.eye(2)[None], atol=1e-9)
    same = replace(noise, mixing=noise.mixing[[0, 0]]).pooled()
    np.testing.assert_allclose(same.mixing, noise.mixing[:1], rtol=1e-6)
    np.testing.assert_allclose(same.force, noise.force[:1], rtol=1e-6)
    gone = replace(noise, force=np.array([[1.0, 1e-30], [1e-30, 1e-30]])).pooled()
    assert (gone.force >= 0).all()
    # Without a joint that pushes act on there is nothing to mix.
    assert chains.mixed(np.zeros((2, 0, 0))) is chains


@pytest.mark.parametrize("mixed", [False, True])
def test_pooled_laws_have_the_mean_variance_whatever_their_tails(mixed):
    noise = replace(
        normal_noise(two_walks(np.random.default_rng(0), n=2, steps=3), np.ones((2, 2)), np.ones((2, 2)), np.arange(2)),
        force=np.array([[1.0, 2.0], [0.01, 0.5]]), force_nu=np.array([[np.inf, 5.0], [3.0, 10.0]]),
        error=np.array([[1.0, 0.1], [0.01, 0.2]]), error_nu=np.array([[np.inf, np.inf], [3.0, np.inf]]),
    )  # fmt: skip
    if mixed:
        noise = noise.together(2)
    pooled = noise.pooled()
    for name in ("force", "error"):
        scales, nus = (getattr(noise, one) for one in (name, f"{name}_nu"))
        variances = stats.t.var(nus, scale=np.sqrt(scales))
        scale, nu = (getattr(pooled, one) for one in (name, f"{name}_nu"))
        np.testing.assert_array_equal(nu[0], nus.min(axis=0))
        np.testing.assert_allclose(variances_of(scale, nu)[0], variances.mean(axis=0))
        np.testing.assert_allclose(scales_of(variances_of(scales, nus), nus), scales)
    alone = noise.alone(1)
    assert alone.pooled() is alone


def test_a_channel_that_a_log_did_not_read_has_there_the_law_of_the_logs_that_did():
    chains, real = two_walks(np.random.default_rng(1), n=6, steps=40), np.ones((6, 40), dtype=bool)
    law = np.array([0, 0, 1, 1, 2, 2])
    chains.mask[law == 2, :, 1] = False
    read = chains.of(law < 2), real[law < 2]
    found, pair = (
        estimate_noise(
            one, normal_noise(one, *(np.full((n, 2), 0.1),) * 2, laws), own, floor=np.zeros(2)
        ).noise
        for one, own, laws, n in ((chains, real, law, 3), (*read, law[law < 2], 2))
    )
    np.testing.assert_allclose(found.pooled().error[:, 1], pair.pooled().error[:, 1], rtol=1e-12)
    np.testing.assert_allclose(found.error[2, 1], found.pooled().error[0, 1], rtol=1e-12)
    np.testing.assert_array_equal(found.error[:2], pair.error)


def test_what_is_not_known_of_forces_on_joints_is_so_in_whatever_order_the_joints_are():
    """The same normal law of two forces as pushes on the first and both joints, and on the second and both."""
    chains = two_walks(np.random.default_rng(1), n=3, steps=12)
    mixing, real = np.array([[[1.0, 0.0], [1.5, 1.0]]]), np.ones((3, 12), dtype=bool)
    noise = replace(normal_noise(chains, [0.8, 0.3], [0.1, 0.4]), mixing=mixing)
    found = passed(chains, noise, real).smoothed
    root = np.linalg.cholesky((mixing[0] * noise.force[0] @ mixing[0].T)[::-1, ::-1])
    turned = replace(chains, carrier=chains.carrier[..., ::-1])
    other = replace(noise, force=np.diag(root)[None] ** 2, mixing=(root / np.diag(root))[None])
    same = passed(turned, other, real).smoothed
    np.testing.assert_allclose(
        other.variances_on_joints(same, 2)[..., ::-1], noise.variances_on_joints(found, 2), rtol=1e-9
    )
    np.testing.assert_allclose(
        other.on_joints(same.forces)[..., ::-1], noise.on_joints(found.forces), rtol=1e-9
    )
    # Pushes that are told apart by both joints alone are not independent of each other once these were read.
    assert (noise.variances_on_joints(found, 2) < found.force_variances @ (mixing[0] ** 2).T - 1e-3)[
        ..., 1
    ].all()


def test_forces_of_channels_that_came_apart_act_together_no_more():
    chains = two_walks(np.random.default_rng(0), n=4, steps=30)
    apart = replace(chains, transitions=chains.transitions - 1e-9)
    assert (len(chains.parts), len(apart.parts)) == (1, 2)
    real = np.ones((4, 30), dtype=bool)
    both = estimate_noise(
        chains, normal_noise(chains, [1.0, 1.0], [0.1, 0.1]).together(2), real, floor=np.zeros(2)
    )
    assert both.noise.mixing[0, 1, 0] > 0.3
    found = estimate_noise(apart, both.noise, real, floor=np.zeros(2))
    np.testing.assert_array_equal(found.noise.mixing, np.eye(2)[None])
    assert passed(apart, found.noise, real).bound == pytest.approx(found.bound, abs=1e-6)
