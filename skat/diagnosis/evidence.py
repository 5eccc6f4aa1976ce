r"""What sets of causes are worth: priors, and evidence on Gram matrices of whitened innovations.

With whitened innovations :math:`z - N\theta` of unit variance, values measured from neutral and a Cauchy prior of scale
s on each, a set S is worth, in nats against none,

.. math::

    \ln \frac{p(z \mid S)}{p(z \mid \varnothing)} \approx b_S'\hat\theta - \tfrac12 \hat\theta' G_{SS} \hat\theta
    + \sum_{k \in S} \ln p_k(\hat\theta_k) + \tfrac{|S|}{2} \ln 2\pi - \tfrac12 \ln |G_{SS} + D| + \sum_k \ln P_k,

Laplace's approximation at the posterior mode, :math:`G = N'N, b = N'z`, D the curvature of the prior there and
:math:`P_k` the share of the normal law that lies within the effect's bounds. Beside it each effect has odds of being a
cause at all.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf
from scipy.special import log_ndtr

from skat.diagnosis.chains import Array

# No model is exact: a log of so many rows counts half [Miller, Dunson 2019].
COARSE_ROWS = 10_000
# Of the largest eigenvalue of a scaled Gram matrix: below it there is rounding.
RANK = 1e-12
# A bound that a value comes this near to, as a share of the range, holds it.
AT_BOUND = 1e-6
# Of a normal law within its 95 % interval, in standard deviations.
WIDTH_95 = 1.96
# A value that is known to less than this, in the angles of its prior, has a normal law; another is told at places.
LEAST_WIDTH = 0.15
PLACES = 100
# Steps of a posterior mode, each with a normal law in the place of each prior.
STEPS = 30


def at_bound(value: float, low: float, high: float) -> bool:
    """Whether a value, from neutral, lies at a bound that is not neutral."""
    width = AT_BOUND * (high - low)
    return bool((value > high - width and high > 0) or (value < low + width and low < 0))


def coarsened(n_rows: int) -> float:
    """Return the power to which the likelihood of so many rows is taken where sets are weighed."""
    return COARSE_ROWS / (COARSE_ROWS + n_rows)


@dataclass(frozen=True)
class Priors:
    """Laws of effects' values before anything was measured, in the coordinates of the search.

    Attributes
    ----------
    names : tuple of str
    scales : ndarray of shape (k,)
        Of the Cauchy law of each value.
    log_odds : ndarray of shape (k,)
        Log of the odds that an effect is a cause.
    low, high : ndarray of shape (k,)
        Bounds, from neutral.
    """

    names: tuple[str, ...]
    scales: Array
    log_odds: Array
    low: Array
    high: Array

    def is_held(self, one: int, value: float) -> bool:
        """Whether a value lies at a bound that is not neutral."""
        return at_bound(value, self.low[one], self.high[one])

    def part(self, members: Sequence[int]) -> "Priors":
        """Return the priors of some effects."""
        index = list(members)
        names = tuple(self.names[one] for one in index)
        return Priors(names, self.scales[index], self.log_odds[index], self.low[index], self.high[index])

    def log_density(self, members: Sequence[int], values: Array) -> Array:
        """Return the log density of each value under the prior cut at its bounds."""
        s = self.scales[list(members)]
        inside = (np.arctan(self.high[list(members)] / s) - np.arctan(self.low[list(members)] / s)) / np.pi
        return -np.log(np.pi * s) - np.log1p((values / s) ** 2) - np.log(np.maximum(inside, 1e-12))


@dataclass(frozen=True)
class Gram:
    """Second moments of whitened innovations and their derivatives.

    Attributes
    ----------
    products : ndarray of shape (k, k)
        G.
    projections : ndarray of shape (k,)
        b, of innovations at the values `origin`.
    origin : ndarray of shape (k,)
        Values from neutral at which the derivatives were taken.
    """

    products: Array
    projections: Array
    origin: Array

    @property
    def at_neutral(self) -> Array:
        """B of innovations extrapolated to where every value is neutral."""
        return self.projections + self.products @ self.origin

    def cosines(self, one: int) -> Array:
        """Return the cosines of the angles between an effect's response and those of all, without signs, (k,)."""
        sizes = np.sqrt(np.maximum(np.diag(self.products), 1e-300))
        cosines: Array = np.abs(self.products[one]) / (sizes[one] * sizes)
        return cosines

    def scattered(self, excess: Array) -> "Gram":
        r"""Return this Gram where scores scatter more than the model says.

        Scores are read as :math:`b \sim N(G\theta, V)` with :math:`V = G + E G E`, E the diagonal of the roots of
        `excess`; for no excess the likelihood is as before.

        Parameters
        ----------
        excess : ndarray of shape (k,)
            By how much the variance of each score, between blocks of time, is above that of the model, as a share.
        """
        units = 1 / np.sqrt(np.maximum(np.diag(self.products), 1e-300))
        scaled = self.products * units * units[:, None]
        root = np.sqrt(excess)
        spread = scaled + scaled * root * root[:, None]
        values, axes = np.linalg.eigh(spread)
        kept = values > RANK * max(values[-1], 1e-300)
        half = (axes[:, kept] / np.sqrt(values[kept])).T @ scaled
        projections = self.projections * units
        lowered = (axes[:, kept] / np.sqrt(values[kept])).T @ projections
        return Gram(half.T @ half / (units * units[:, None]), half.T @ lowered / units, self.origin)


@dataclass(frozen=True)
class Weighed:
    """A set of causes and what it is worth.

    Attributes
    ----------
    members : tuple of int
        Places of the effects, ascending.
    values : ndarray of shape (len(members),)
        Posterior mode, from neutral.
    evidence : float
        Log posterior odds against no cause, nats.
    likelihood : float
        Gain of the log likelihood at the mode.
    curvature : ndarray of shape (len(members), len(members))
        Of the log posterior at the mode, with its sign turned.
    """

    members: tuple[int, ...]
    values: Array
    evidence: float
    likelihood: float
    curvature: Array

    @property
    def covariance(self) -> Array:
        """Of the normal law of the values about the mode."""
        return _inverse(self.curvature)

    @property
    def deviations(self) -> Array:
        """Standard errors of the values, (len(members),)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def half_widths(self) -> Array:
        """Half of the width of each value's 95 % interval, (len(members),)."""
        return WIDTH_95 * self.deviations


NO_CAUSE = Weighed((), np.zeros(0), 0.0, 0.0, np.zeros((0, 0)))


def weigh(
    gram: Gram, priors: Priors, members: Sequence[int], *, power: float = 1.0, near: Array | None = None
) -> Weighed:
    """Return what a set is worth.

    Parameters
    ----------
    gram : Gram
    priors : Priors
    members : sequence of int
    power : float, default=1.0
        To which the likelihood is taken: below 1 where innovations are not as independent as the model has them.
    near : ndarray of shape (n_effects,), optional
        Values of a set that is much alike; the mode is then told no finer than a search of many such sets needs.
    """
    members = tuple(sorted(members))
    if not members:
        return NO_CAUSE
    chosen = np.array(members)
    scales, low, high = priors.scales[chosen], priors.low[chosen], priors.high[chosen]
    G = gram.products[np.ix_(chosen, chosen)] * power
    b = gram.at_neutral[chosen] * power
    values, curvature = posterior_mode(G, b, scales, low, high, None if near is None else near[chosen])
    likelihood = float(b @ values - 0.5 * values @ G @ values)
    evidence = likelihood + float(priors.log_density(members, values).sum() + priors.log_odds[chosen].sum())
    evidence += 0.5 * len(members) * np.log(2 * np.pi) - 0.5 * _log_determinant(curvature)
    # Where the slope does not vanish, as on a bound, the law is normal about where it would.
    roots = np.sqrt(np.diag(curvature))
    slopes = (b - G @ values - 2 * values / (scales**2 + values**2)) / roots
    centres = values + slopes / roots
    evidence += np.sum(0.5 * slopes**2 + _log_share((low - centres) * roots, (high - centres) * roots))
    return Weighed(members, values, float(evidence), likelihood / power, curvature)


@dataclass(frozen=True)
class Law:
    """What a set of causes is worth, and the law of its values: normal for each value of the one that is known least.

    Attributes
    ----------
    members : tuple of int
    evidence : float
        As that of `Weighed`.
    shares : ndarray of shape (n,)
        Of values of that member.
    means : ndarray of shape (n, len(members))
        Of all values there.
    deviations : ndarray of shape (n, len(members))
        And how far they scatter about these; of that member, half of the way from each value to the next.
    """

    members: tuple[int, ...]
    evidence: float
    shares: Array
    means: Array
    deviations: Array


def law_of(gram: Gram, priors: Priors, one: Weighed, *, power: float = 1.0) -> Law:
    """Return the law of a set of causes; ``power`` as of `weigh`.

    Of a value that rows hardly tell Laplace's approximation leaves out the tails of its prior, .57 nats of a Cauchy
    law, and what other values would have to be there.
    """
    members, values, C = list(one.members), one.values, one.curvature
    scales, low, high = priors.scales[members], priors.low[members], priors.high[members]
    covariance = one.covariance
    pull = 2 * values / (scales**2 + values**2)
    curvature = np.diag(C) - power * np.diag(gram.products)[members]
    # In the angles in which a Cauchy law is even.
    known = np.maximum(1 / np.maximum(np.diag(covariance), 1e-300) - curvature, 1e-300)
    widths = scales / (scales**2 + values**2) / np.sqrt(known)
    k = int(np.argmax(widths)) if members else 0
    if not members or widths[k] < LEAST_WIDTH:
        return Law(one.members, one.evidence, np.ones(1), values[None], one.deviations[None])
    angles, weights = _quadrature(PLACES)
    first, last = np.arctan(low[k] / scales[k]), np.arctan(high[k] / scales[k])
    moves = scales[k] * np.tan((first + last) / 2 + (last - first) / 2 * angles) - values[k]
    rest = [place for place in range(len(members)) if place != k]
    slopes = power * (gram.at_neutral[members] - gram.products[np.ix_(members, members)] @ values)
    inverse = _inverse(C[np.ix_(rest, rest)])
    towards = (slopes - pull)[rest] - np.outer(moves, C[k, rest])
    others = towards @ inverse
    logs = slopes[k] * moves - (C[k, k] - curvature[k]) * moves**2 / 2 + np.sum(towards * others, axis=1) / 2
    means, deviations = np.tile(values, (len(moves), 1)), np.empty((len(moves), len(members)))
    means[:, k] += moves
    means[:, rest] += others
    deviations[:, k] = np.gradient(moves) / 2
    deviations[:, rest] = np.sqrt(np.diag(inverse))
    # Of the others the prior at their means, in place of the normal law that has met it at the mode.
    met = (
        priors.log_density(members, values) - pull * (means - values) - curvature * (means - values) ** 2 / 2
    )
    met = priors.log_density(members, means) - met
    inside = _log_share(*(((end - means) / deviations)[:, rest] for end in (low, high)))
    logs += met[:, rest].sum(axis=1) + inside.sum(axis=1)
    evidence = power * one.likelihood + priors.log_odds[members].sum()
    evidence += priors.log_density(members, values)[rest].sum()
    evidence += 0.5 * len(rest) * np.log(2 * np.pi) - 0.5 * _log_determinant(C[np.ix_(rest, rest)])
    shares = weights / 2 * np.exp(logs - logs.max())
    evidence += logs.max() + np.log(shares.sum())
    return Law(one.members, float(evidence), shares / shares.sum(), means, deviations)


@cache
def _quadrature(n: int) -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(n)


def posterior_mode(
    G: Array, b: Array, scales: Array, low: Array, high: Array, near: Array | None = None
) -> tuple[Array, Array]:
    """Return the mode under Cauchy priors within bounds, and the curvature there.

    The prior is met by a normal law of the same slope, in turns (each turn raises the posterior). ``near`` as of
    `weigh`.
    """
    values, still = (np.zeros(len(b)), 1e-3) if near is None else (near, 1e-2)
    weights = 2.0 / (scales**2 + (scales if near is None else near) ** 2)
    for _ in range(STEPS):
        new = bounded_solution(G + np.diag(weights), b, low, high, values)
        moved = np.max(np.abs(new - values) * np.sqrt(np.diag(G) + weights), initial=0.0)
        values = new
        weights = 2.0 / (scales**2 + values**2)
        if moved < still:
            break
    curvature = G + np.diag(weights**2 * (scales**2 - values**2) / 2)
    if not np.isfinite(_log_determinant(curvature)):
        curvature = G + np.diag(weights + RANK * np.diag(G))
    return values, curvature


def _log_determinant(curvature: Array) -> float:
    """Return the log of a determinant, -inf of what is not positive definite."""
    units = 1 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    factor, failed = dpotrf(curvature * units * units[:, None])
    return -np.inf if failed else 2 * float(np.log(np.diag(factor) / units).sum())


def _inverse(curvature: Array) -> Array:
    """Return the covariance of a curvature; of what rounding leaves of no curvature it is as large as that may be."""
    units = 1 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    values, axes = np.linalg.eigh(curvature * units * units[:, None])
    inverse: Array = (axes / np.maximum(values, np.finfo(np.float64).eps)) @ axes.T
    return inverse * units * units[:, None]


def bounded_solution(H: Array, b: Array, low: Array, high: Array, start: Array) -> Array:
    """Return the minimum of x'Hx/2 - b'x within bounds, by an active set: at first the bounds that a start lies on."""
    unit = 1 / np.sqrt(np.diag(H))
    scaled = H * unit * unit[:, None]
    x = start
    free = (start > low) & (start < high)
    for _ in range(3 * len(b) + 3):
        x = np.where(free, 0.0, x)
        if free.any():
            part = scaled if free.all() else scaled[free][:, free]
            right = (b - H @ x)[free] * unit[free]
            _, solved, failed = dposv(part, right)
            if failed:
                solved = np.linalg.solve(part + RANK * np.eye(len(part)), right)
            x[free] = solved * unit[free]
        excess = np.maximum(low - x, x - high) / unit
        if (excess > 0).any():
            worst = int(np.argmax(excess))
            free[worst], x[worst] = False, low[worst] if x[worst] < low[worst] else high[worst]
            continue
        slope = (b - H @ x) * unit
        inward = ~free & (low < high) & (((x == low) & (slope > 1e-9)) | ((x == high) & (slope < -1e-9)))
        if not inward.any():
            return x
        free[int(np.argmax(np.where(inward, np.abs(slope), -1.0)))] = True
    return np.clip(x, low, high)


def _log_share(lower: Array, upper: Array) -> Array:
    """Return the log of the share of the standard normal law that lies between two ends."""
    # Where both ends are above the centre, the difference of two shares of 1 would be lost.
    above = lower > 0
    upper, lower = np.where(above, -lower, upper), np.where(above, -upper, lower)
    return np.asarray(
        log_ndtr(upper) + np.log1p(-np.exp(np.minimum(log_ndtr(lower) - log_ndtr(upper), -1e-12)))
    )


class Weigher:
    """Weighs sets, each once.

    Parameters
    ----------
    gram : Gram
    priors : Priors
    rivals : mapping from place to places, optional
        Effects that are in no set with a given one: all of a family, and each of it.
    power : float, default=1.0
        As `weigh`'s.
    alike : bool, default=False
        Whether sets are many and much alike: each is weighed from the values of those before.

    Attributes
    ----------
    seen : dict of tuple of int to Weighed
        All that were weighed.
    """

    def __init__(
        self,
        gram: Gram,
        priors: Priors,
        rivals: Mapping[int, Sequence[int]] | None = None,
        *,
        power: float = 1.0,
        alike: bool = False,
    ):
        self.gram, self.priors, self.power = gram, priors, power
        self.rivals = rivals or {}
        self._last = np.zeros(len(priors.scales)) if alike else None
        self.seen: dict[tuple[int, ...], Weighed] = {}

    def __call__(self, members: Collection[int]) -> Weighed:
        """Return what a set is worth."""
        key = tuple(sorted(set(members)))
        if key not in self.seen:
            self.seen[key] = self._weighed(key)
        return self.seen[key]

    def allows(self, members: Collection[int]) -> bool:
        """Whether a set holds no two rivals."""
        there = set(members)
        return not any(there.intersection(self.rivals.get(one, ())) for one in there)

    def without(self, whole: Weighed, gone: int) -> Weighed:
        """Return what a set is worth without one of its members."""
        return self([one for one in whole.members if one != gone])

    def losses(self, whole: Weighed) -> dict[int, float]:
        """Return what each member of a set is worth: what the evidence loses when it is dropped, nats."""
        return {one: whole.evidence - self.without(whole, one).evidence for one in whole.members}

    def promises(self, now: Weighed) -> Array:
        """Return about what each further effect would add to the log posterior odds; -inf of members and rivals."""
        G, left = self.gram.products * self.power, self.gram.at_neutral * self.power
        information = np.diag(G).copy()
        if now.members:
            members = np.array(now.members)
            left = left - G[:, members] @ now.values
            solved = np.linalg.solve(now.curvature, G[members])
            information -= np.sum(G[:, members] * solved.T, axis=1)
        gain = gains_alone(left, np.maximum(information, 0.0), self.priors)
        gain[[*now.members, *(other for one in now.members for other in self.rivals.get(one, ()))]] = -np.inf
        return gain

    def _weighed(self, members: tuple[int, ...]) -> Weighed:
        one = weigh(self.gram, self.priors, members, power=self.power, near=self._last)
        if self._last is not None:
            self._last[list(one.members)] = one.values
        return one


def gains_alone(left: Array, information: Array, priors: Priors) -> Array:
    """Return about by how much each effect alone would raise the log posterior odds, nats.

    Parameters
    ----------
    left, information : ndarray of shape (..., k)
        Slope and curvature of the log likelihood in each effect's value, where it is neutral.
    priors : Priors
        Of the k effects.
    """
    scales = priors.scales
    whole = information + 1 / scales**2
    # As near as a normal law of the typical size holds a value, and as far as the rows alone pull it.
    shifts = [left / whole, left / np.maximum(information, 1e-9 * whole)]
    gains = [
        left * shift - 0.5 * information * shift**2 - np.log1p((shift / scales) ** 2)
        for shift in (np.clip(one, priors.low, priors.high) for one in shifts)
    ]
    gain = np.max(gains, axis=0) + priors.log_odds + 0.5 * np.log(2 * np.pi / whole)
    return np.asarray(gain - np.log(np.pi * scales))
