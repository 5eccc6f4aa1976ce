"""What the evidence is made of, against dense algebra, quadrature and general optimisers."""

import numpy as np
import pytest
from scipy import integrate, optimize, stats

from skat.diagnosis.evidence import (
    NO_CAUSE,
    Gram,
    Priors,
    Weigher,
    _log_share,
    bounded_solution,
    law_of,
    posterior_mode,
    weigh,
)
from skat.diagnosis.search import _likely_losses

K = 4
SCALES = np.array([0.3, 1.0, 2.0, 0.1])
ODDS = np.array([-2.0, -3.0, -1.0, -4.0])


def priors(low=-50.0, high=50.0):
    return Priors(tuple("abcd"), SCALES, ODDS, np.full(K, low), np.full(K, high))


def drawn(seed=0, n=60, strength=5.0):
    """Return whitened innovations and their derivatives by four effects in units of their own."""
    rng = np.random.default_rng(seed)
    N = rng.normal(size=(n, K)) @ (np.eye(K) + 0.3 * rng.normal(size=(K, K))) * strength / np.sqrt(n)
    return N, N @ [0.5, 0.0, -1.0, 0.2] + rng.normal(size=n)


def gram_of(N, z, origin=None):
    return Gram(N.T @ N, N.T @ z, np.zeros(N.shape[1]) if origin is None else origin)


# -- priors and Gram matrices ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("low", "high"), [(-50.0, 50.0), (0.0, 2.0), (-0.5, 0.1)])
def test_the_law_of_a_value_is_a_cauchy_law_cut_at_its_bounds(low, high):
    some = priors(low, high)
    for place, scale in enumerate(SCALES):
        law = stats.cauchy(scale=scale)
        at = np.linspace(low, high, 7)
        told = np.array([some.log_density([place], np.array([one]))[0] for one in at])
        np.testing.assert_allclose(told, law.logpdf(at) - np.log(law.cdf(high) - law.cdf(low)), rtol=1e-9)


def test_priors_of_some_effects_are_theirs_in_the_order_asked_for():
    some = Priors(tuple("abcd"), SCALES, ODDS, -np.arange(K, dtype=float), np.arange(K, dtype=float))
    part = some.part([2, 0])
    assert part.names == ("c", "a")
    assert part.scales.tolist() == [2.0, 0.3]
    assert part.log_odds.tolist() == [-1.0, -2.0]
    assert (part.low.tolist(), part.high.tolist()) == ([-2.0, 0.0], [2.0, 0.0])


def test_scores_at_neutral_are_those_of_innovations_without_what_was_taken_out():
    N, z = drawn()
    origin = np.array([0.2, -0.1, 1.0, 0.0])
    np.testing.assert_allclose(gram_of(N, z - N @ origin, origin).at_neutral, N.T @ z, rtol=1e-9)


@pytest.mark.parametrize("units", [np.ones(K), np.array([1e-4, 1.0, 1e5, 3.0])], ids=["alike", "apart"])
def test_scores_that_scatter_have_the_likelihood_of_their_own_law(units):
    N, z = drawn()
    N = N * units
    gram, excess = gram_of(N, z), np.array([0.0, 3.0, 0.5, 10.0])
    G, b, root = gram.products, gram.projections, np.sqrt(excess)
    V = G + G * root * root[:, None]
    scattered = gram.scattered(excess)
    scale = np.sqrt(np.diag(G))
    np.testing.assert_allclose(
        scattered.products / scale / scale[:, None],
        G @ np.linalg.solve(V, G) / scale / scale[:, None],
        rtol=1e-6,
        atol=1e-9,
    )
    np.testing.assert_allclose(scattered.projections / scale, G @ np.linalg.solve(V, b) / scale, rtol=1e-6)
    same = gram.scattered(np.zeros(K))
    np.testing.assert_allclose(same.products / scale / scale[:, None], G / scale / scale[:, None], atol=1e-9)
    np.testing.assert_allclose(same.projections / scale, b / scale, rtol=1e-6, atol=1e-9)


def test_scores_scatter_alike_in_whatever_units_effects_are_told():
    N, z = drawn()
    excess, units = np.array([0.0, 3.0, 0.5, 10.0]), np.array([1e-9, 1.0, 1e6, 3.0])
    own, other = gram_of(N, z).scattered(excess), gram_of(N * units, z).scattered(excess)
    np.testing.assert_allclose(other.products, own.products * units * units[:, None], rtol=1e-9)
    np.testing.assert_allclose(other.projections, own.projections * units, rtol=1e-9)


def test_scores_of_effects_that_act_the_same_scatter_once():
    N, z = drawn()
    N = np.column_stack([N[:, 0], -2 * N[:, 0], N[:, 1]])
    gram = gram_of(N, z)
    same = gram.scattered(np.zeros(3))
    np.testing.assert_allclose(same.products, gram.products, atol=1e-9)
    np.testing.assert_allclose(same.projections, gram.projections, atol=1e-9)


# -- one set ---------------------------------------------------------------------------------------------------------


def test_a_member_is_worth_what_least_squares_lose_without_it():
    N, z = drawn()
    wide = Priors(tuple("abcd"), np.full(K, 1e6), ODDS, np.full(K, -1e9), np.full(K, 1e9))

    def loss(columns):
        return np.linalg.lstsq(N[:, columns], z)[1][0] / 2

    others = [loss([one for one in range(K) if one != gone]) for gone in range(K)]
    losses = _likely_losses(weigh(gram_of(N, z), wide, range(K)))
    np.testing.assert_allclose(losses, others - loss(range(K)), rtol=1e-6)


def log_posterior(theta, N, z, scales):
    return -0.5 * np.sum((z - N @ theta) ** 2) - np.sum(np.log1p((theta / scales) ** 2))


@pytest.mark.parametrize("low", [-50.0, 0.0])
@pytest.mark.parametrize("information", [1e-3, 0.1, 3.0, 100.0])
def test_what_rows_hardly_tell_has_its_prior_s_tails(information, low):
    some = Priors(("a",), np.ones(1), np.full(1, -3.0), np.full(1, low), np.full(1, 50.0))
    gram = Gram(np.full((1, 1), information), np.sqrt([information]), np.zeros(1))
    law = law_of(gram, some, weigh(gram, some, (0,), power=0.5), power=0.5)

    def density(at):
        likelihood = 0.5 * (gram.projections[0] * at - information * at**2 / 2)
        return np.exp(likelihood + some.log_density([0], np.array([at]))[0] - 3.0)

    whole = integrate.quad(density, low, 50.0, limit=400, points=[0.0, 1.0, 5.0])[0]
    assert law.evidence == pytest.approx(np.log(whole), abs=0.03)
    assert law.shares.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("low", [-50.0, 0.0])
@pytest.mark.parametrize("total", [0.3, 1.0, 4.0])
def test_effects_that_act_the_same_share_what_both_do_by_both_priors(total, low):
    """Known to .01 is their sum alone: its law is that of a sum of two values, each may be any share of it."""
    some = Priors(("a", "b"), np.ones(2), np.zeros(2), np.full(2, low), np.full(2, 50.0))
    gram = Gram(np.full((2, 2), 1e4), np.full(2, 1e4 * total), np.zeros(2))
    law = law_of(gram, some, weigh(gram, some, (0, 1)))

    def density(at):
        return np.exp(some.log_density([0, 1], np.array([at, total - at])).sum())

    first, last = (-40.0, 40.0) if low < 0 else (0.0, total)
    inside = [one for one in (0.0, total / 2, total) if first < one < last]
    whole = integrate.quad(density, first, last, limit=400, points=inside)[0]
    expected = 1e4 * total**2 / 2 + np.log(whole) + 0.5 * np.log(2 * np.pi / 1e4)
    assert law.evidence == pytest.approx(expected, abs=0.05)
    np.testing.assert_allclose(law.means.sum(axis=1)[law.shares > 1e-3], total, atol=0.01)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("low", "high"), [(-50.0, 50.0), (0.0, 0.3), (-0.2, 0.0)])
def test_a_mode_is_where_no_general_optimiser_gets_higher(seed, low, high):
    N, z = drawn(seed, strength=20.0)
    values, curvature = posterior_mode(N.T @ N, N.T @ z, SCALES, np.full(K, low), np.full(K, high))
    best = optimize.minimize(
        lambda theta: -log_posterior(theta, N, z, SCALES), values, bounds=[(low, high)] * K, tol=1e-12
    )
    assert log_posterior(values, N, z, SCALES) >= -best.fun - 1e-5
    assert (values >= low).all()
    assert (values <= high).all()
    step = 1e-4 * np.eye(K)
    differences = [
        [
            sum(
                sign * log_posterior(values + one + way * other, N, z, SCALES)
                - sign * log_posterior(values - one + way * other, N, z, SCALES)
                for sign, way in ((1, 1), (-1, -1))
            )
            for other in step
        ]
        for one in step
    ]
    np.testing.assert_allclose(curvature, -np.array(differences) / 4e-8, rtol=1e-3, atol=0.5)


def test_where_the_log_posterior_is_not_concave_its_curvature_is_that_of_normal_laws_of_the_same_slope():
    """A value far beyond the typical size that the rows hardly hold: beyond s the Cauchy law bends the other way."""
    G, b, scale = np.array([[1.0]]), np.array([3.0]), np.array([0.5])
    values, curvature = posterior_mode(G, b, scale, np.array([2.5]), np.array([9.0]))
    bent = 2 * (scale**2 - values**2) / (scale**2 + values**2) ** 2
    assert curvature[0, 0] == pytest.approx(1 + bent[0])
    values, curvature = posterior_mode(0.01 * G, 0.03 * b, scale, np.array([1.0]), np.array([9.0]))
    assert values[0] == 1.0
    assert curvature[0, 0] == pytest.approx(0.01 + 2 / (scale[0] ** 2 + 1))


@pytest.mark.parametrize("seed", range(8))
def test_a_quadratic_within_bounds_has_its_least_value_there(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(7, 6)) * 10 ** rng.uniform(-2, 2, 6)
    H, b = root.T @ root + 1e-6 * np.diag(np.sum(root**2, axis=0)), root.T @ rng.normal(size=7)
    free = np.linalg.solve(H, b)
    low, high = -np.abs(free) * rng.uniform(0, 2, 6), np.abs(free) * rng.uniform(0, 2, 6)
    low[0], high[1] = 0.0, 0.0
    found = bounded_solution(H, b, low, high, np.clip(np.zeros(6), low, high))
    slope = (b - H @ found) / np.sqrt(np.diag(H))
    # The certificate of Karush, Kuhn and Tucker.
    size = 1e-6 * np.linalg.norm(b / np.sqrt(np.diag(H)))
    assert (found >= low).all()
    assert (found <= high).all()
    inside = (found > low) & (found < high)
    np.testing.assert_allclose(slope[inside], 0, atol=size)
    assert (slope[(found == low) & (low < high)] < size).all()
    assert (slope[(found == high) & (low < high)] > -size).all()


@pytest.mark.parametrize(
    ("lower", "upper"),
    [
        (-1.0, 2.0),
        (-np.inf, 0.5),
        (0.5, np.inf),
        (3.0, 4.0),
        (-4.0, -3.0),
        (-9.0, -8.0),
        (8.0, 9.0),
        (-0.1, 0.1),
    ],
)
def test_the_share_of_a_normal_law_between_two_ends_is_its_integral(lower, upper):
    share, _ = integrate.quad(stats.norm.pdf, max(lower, -12), min(upper, 12), epsabs=0, epsrel=1e-10)
    assert _log_share(np.array(lower), np.array(upper)) == pytest.approx(np.log(share), rel=1e-7)


def test_a_power_of_the_likelihood_is_that_of_as_many_rows_fewer():
    N, z = drawn()
    gram = gram_of(N, z, np.array([0.1, 0.0, -0.3, 0.0]))
    half = weigh(gram, priors(), (0, 2), power=0.5)
    fewer = weigh(Gram(gram.products / 2, gram.projections / 2, gram.origin), priors(), (0, 2))
    assert half.evidence == pytest.approx(fewer.evidence)
    assert half.likelihood == pytest.approx(2 * fewer.likelihood)
    np.testing.assert_allclose(half.values, fewer.values)
    np.testing.assert_allclose(half.curvature, fewer.curvature)


def test_the_members_of_a_set_stand_in_order_whatever_the_order_asked_for():
    N, z = drawn()
    one, other = (weigh(gram_of(N, z), priors(), members) for members in ((2, 0), (0, 2)))
    assert one.members == other.members == (0, 2)
    np.testing.assert_array_equal(one.values, other.values)
    assert weigh(gram_of(N, z), priors(), ()) is NO_CAUSE
    np.testing.assert_allclose(one.covariance @ one.curvature, np.eye(2), atol=1e-9)
    np.testing.assert_allclose(one.half_widths, stats.norm.ppf(0.975) * one.deviations, rtol=1e-4)


def test_a_set_is_worth_its_likelihood_and_the_laws_of_its_values_about_their_mode():
    """Written out, where bounds are far: Laplace's approximation."""
    N, z = drawn(strength=40.0)
    one = weigh(gram_of(N, z), priors(), (0, 2, 3))
    chosen = [0, 2, 3]
    part = N[:, chosen]
    gain = 0.5 * (np.sum(z**2) - np.sum((z - part @ one.values) ** 2))
    assert one.likelihood == pytest.approx(gain)
    s, at = SCALES[chosen], one.values
    density = stats.cauchy(scale=s).logpdf(at) - np.log(np.arctan(50 / s) * 2 / np.pi)
    bent = 2 * (s**2 - at**2) / (s**2 + at**2) ** 2
    volume = 1.5 * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(part.T @ part + np.diag(bent))[1]
    assert one.evidence == pytest.approx(gain + density.sum() + volume + ODDS[chosen].sum(), abs=1e-3)


# -- many sets -------------------------------------------------------------------------------------------------------


def test_each_set_is_weighed_once_however_it_is_asked_for():
    N, z = drawn()
    worth = Weigher(gram_of(N, z), priors(), power=0.7)
    one = worth([2, 0, 0])
    assert one is worth((0, 2))
    assert list(worth.seen) == [(0, 2)]
    assert one.evidence == weigh(gram_of(N, z), priors(), (0, 2), power=0.7).evidence
    assert worth.without(one, 2) is worth((0,))
    assert worth.losses(one) == {
        0: one.evidence - worth((2,)).evidence,
        2: one.evidence - worth((0,)).evidence,
    }


@pytest.mark.parametrize("power", [1.0, 0.5])
@pytest.mark.parametrize("members", [(), (0,), (0, 2)])
def test_a_promise_is_what_a_further_effect_gains(members, power):
    """Of effects that the rows hold much better than their priors, but for the priors' ends."""
    N, z = drawn(strength=60.0)
    worth = Weigher(gram_of(N, z), priors(), power=power)
    now = worth(members)
    promised = worth.promises(now)
    assert (promised[list(members)] == -np.inf).all()
    others = [one for one in range(K) if one not in members]
    gains = [worth((*members, one)).evidence - now.evidence for one in others]
    inside = np.log(np.arctan(50 / SCALES[others]) * 2 / np.pi)
    np.testing.assert_allclose(promised[others] - inside, gains, rtol=0.02, atol=0.3)


def test_promises_end_at_bounds():
    N, z = drawn(strength=60.0)
    free, held = (Weigher(gram_of(N, z), one).promises(NO_CAUSE) for one in (priors(), priors(-0.01, 0.01)))
    G, b = N.T @ N, N.T @ z
    whole = np.diag(G) + SCALES**-2
    at = 0.01 * np.sign(b)
    assert (np.abs(b / whole) > 0.01).all()
    expected = (
        b * at - 0.5 * np.diag(G) * at**2 + ODDS - np.log1p((at / SCALES) ** 2) - np.log(np.pi * SCALES)
    )
    np.testing.assert_allclose(held, expected + 0.5 * np.log(2 * np.pi / whole), rtol=1e-9)
    assert (free > held).all()


@pytest.mark.parametrize(("low", "high"), [(-50.0, 50.0), (-0.2, 0.4), (0.0, 0.3)])
@pytest.mark.parametrize("strength", [1.0, 20.0])
def test_sets_weighed_from_those_before_come_to_the_same(low, high, strength):
    N, z = drawn(3, strength=strength)
    gram, some = gram_of(N, z), priors(low, high)
    swift, whole = Weigher(gram, some, alike=True), Weigher(gram, some)
    assert swift(()) is NO_CAUSE
    for members in ((0,), (0, 2), (0, 1, 2, 3), (1, 3), (3,)):
        one, other = swift(members), whole(members)
        assert one.evidence == pytest.approx(other.evidence, abs=0.02)
        np.testing.assert_allclose(one.values, other.values, atol=0.02 * np.max(other.deviations))
        assert one.likelihood == pytest.approx(other.likelihood, abs=0.02)


def test_of_effects_that_are_the_same_but_for_rounding_more_are_worth_no_more():
    same = np.array([1.0, 1.0, 0.7])
    some = Priors(tuple("abc"), np.full(3, 0.1), np.full(3, -2.0), -np.ones(3), np.ones(3))
    for information in (1e8, 1e18, 1e20):
        products = information * np.outer(same, same)
        gram = Gram(products, products @ [0.1, 0.0, 0.0], np.zeros(3))
        alone = weigh(gram, some, (0,)).evidence
        for members in ((0, 1), (0, 1, 2)):
            assert weigh(gram, some, members).evidence <= alone


@pytest.mark.parametrize("seed", range(30))
def test_values_of_effects_that_are_the_same_but_for_rounding_have_errors(seed):
    rng = np.random.default_rng(seed)
    scales = 10.0 ** rng.uniform(-3, 3, 3)
    unbounded = np.full(3, np.inf)
    some = Priors(tuple("abc"), scales, np.full(3, -2.0), -unbounded, unbounded)
    moved = rng.normal(size=(6, 3))
    moved[:, 1] = moved[:, 0]
    for information in (1e15, 4e15, 1e16, 1e17):
        products = information * (moved / scales).T @ (moved / scales)
        one = weigh(Gram(products, products @ (scales * [0.1, 0.0, 0.05]), np.zeros(3)), some, (0, 1, 2))
        assert np.all(one.deviations > 0)
