"""What sets of causes are worth, against quadrature, and the search for them."""

import numpy as np
import pytest
from scipy import integrate

from skat.diagnosis.evidence import Gram, Priors, Weigher, weigh
from skat.diagnosis.search import search, without_weak


def priors(k, *, scale=0.3, low=-1e3, high=1e3, odds=0.1):
    return Priors(
        tuple(f"e{place}" for place in range(k)),
        np.full(k, scale),
        np.full(k, np.log(odds)),
        np.full(k, low),
        np.full(k, high),
    )


def problem(rng, theta, n=200):
    N = rng.normal(size=(n, len(theta)))
    z = N @ theta + rng.normal(size=n)
    return Gram(N.T @ N, N.T @ z, np.zeros(len(theta)))


@pytest.mark.parametrize(
    ("theta", "low", "high"),
    [
        (0.4, -1e3, 1e3),
        (0.05, -1e3, 1e3),
        (0.3, 0.0, 1e3),
        (0.0, 0.0, 1e3),
        (-0.1, 0.0, 1e3),
        (-3.0, 0.0, 1e3),
        (3.0, -1e3, 0.0),
        (3.0, -1e3, 0.2),
    ],
    ids=["plain", "small", "positive", "at its bound", "against it", "far below", "far above", "beyond"],
)
def test_evidence_of_one_cause_is_that_by_quadrature(theta, low, high):
    given = priors(1, low=low, high=high)
    gram = problem(np.random.default_rng(0), np.array([theta]))
    G, b = gram.products[0, 0], gram.projections[0]
    best = np.clip(b / G, low, high)
    peak = b * best - G * best**2 / 2

    def density(value):
        inside = (np.arctan(high / 0.3) - np.arctan(low / 0.3)) / np.pi
        law = np.pi * 0.3 * (1 + (value / 0.3) ** 2) * inside
        return np.exp(b * value - G * value**2 / 2 - peak) / law

    # Against a bound the law falls over the inverse of its slope there.
    width = 12 / max(np.sqrt(G), abs(b - G * best))
    exact, _ = integrate.quad(
        density, max(low, best - width), min(high, best + width), points=[best], epsabs=0, limit=200
    )
    assert weigh(gram, given, [0]).evidence == pytest.approx(
        np.log(exact) + peak + given.log_odds[0], abs=0.12
    )


def test_evidence_of_two_causes_is_that_by_quadrature():
    given = priors(2)
    gram = problem(np.random.default_rng(1), np.array([0.4, -0.2]))
    G, b = gram.products, gram.projections

    def density(second, first):
        value = np.array([first, second])
        law = np.prod(1 / (np.pi * 0.3 * (1 + (value / 0.3) ** 2)))
        return np.exp(b @ value - value @ G @ value / 2 - peak) * law

    best = np.linalg.solve(G, b)
    peak = b @ best / 2
    width = 8 / np.sqrt(np.diag(G))
    exact, _ = integrate.dblquad(
        density, best[0] - width[0], best[0] + width[0], best[1] - width[1], best[1] + width[1], epsabs=1e-12
    )
    expected = np.log(exact) + peak + given.log_odds.sum()
    assert weigh(gram, given, [0, 1]).evidence == pytest.approx(expected, abs=0.1)


def test_values_count_from_neutral_wherever_slopes_were_taken():
    given, theta = priors(2), np.array([0.4, -0.2])
    gram = problem(np.random.default_rng(2), theta)
    moved = Gram(gram.products, gram.projections - gram.products @ [0.3, 0.1], np.array([0.3, 0.1]))
    assert weigh(moved, given, [0, 1]).evidence == pytest.approx(
        weigh(gram, given, [0, 1]).evidence, rel=1e-12
    )


def test_bounds_hold():
    gram = problem(np.random.default_rng(3), np.array([-0.5, 0.4]))
    found = weigh(gram, priors(2, low=0.0), [0, 1]).values
    assert found[0] == 0.0
    assert found[1] > 0.2


def test_sets_come_back_from_data_simulated_with_them():
    rng = np.random.default_rng(4)
    for hidden in ((), (3,), (1, 5), (0, 2, 4, 6, 8, 10)):
        theta = np.zeros(20)
        theta[list(hidden)] = 0.5
        gram = problem(rng, theta, n=400)
        given = priors(20, odds=1 / 20)
        worth = Weigher(gram, given)
        best, losses = without_weak(search(worth).sets[0], worth, -np.log(0.01))
        assert best.members == hidden
        assert set(losses) == set(hidden)


def test_of_nothing_nothing_is_made():
    rng, given = np.random.default_rng(5), priors(30, odds=1 / 31)
    alarms = 0
    for _ in range(150):
        gram = problem(rng, np.zeros(30), n=300)
        worth = Weigher(gram, given)
        best, _ = without_weak(search(worth).sets[0], worth, -np.log(0.01))
        alarms += bool(best.members)
    assert alarms <= 3


def test_a_cause_is_exchanged_for_a_likelier_one_that_acts_alike():
    rng = np.random.default_rng(6)
    N = rng.normal(size=(300, 3))
    N[:, 1] = N[:, 0]
    z = 0.5 * N[:, 0] + rng.normal(size=300)
    given = Priors(
        ("a", "b", "c"), np.full(3, 0.3), np.log([0.01, 0.1, 0.1]), np.full(3, -1e3), np.full(3, 1e3)
    )
    gram = Gram(N.T @ N, N.T @ z, np.zeros(3))
    assert search(Weigher(gram, given), start=(0,)).sets[0].members == (1,)
