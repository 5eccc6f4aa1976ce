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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv
from scipy.special import log_ndtr

from skat.diagnosis.filtering import Array

# Of the largest eigenvalue of a scaled Gram matrix: below it there is rounding.
RANK = 1e-12


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


def weigh(gram: Gram, priors: Priors, members: Sequence[int], *, power: float = 1.0) -> Weighed:
    """Return what a set is worth.

    Parameters
    ----------
    gram : Gram
    priors : Priors
    members : sequence of int
    power : float, default=1.0
        To which the likelihood is taken: below 1 where innovations are not as independent as the model has them.
    """
    members = tuple(sorted(members))
    if not members:
        return Weighed((), np.zeros(0), 0.0, 0.0, np.zeros((0, 0)))
    chosen = np.array(members)
    G = gram.products[np.ix_(chosen, chosen)] * power
    b = gram.at_neutral[chosen] * power
    values, curvature = posterior_mode(G, b, priors.scales[chosen], priors.low[chosen], priors.high[chosen])
    likelihood = float(b @ values - 0.5 * values @ G @ values)
    gradient = b - G @ values - 2 * values / (priors.scales[chosen] ** 2 + values**2)
    _, log_determinant = np.linalg.slogdet(curvature)
    evidence = likelihood + float(priors.log_density(members, values).sum() + priors.log_odds[chosen].sum())
    evidence += 0.5 * len(members) * np.log(2 * np.pi) - 0.5 * log_determinant
    evidence += _inside(values, gradient, curvature, priors.low[chosen], priors.high[chosen])
    return Weighed(members, values, float(evidence), likelihood / power, curvature)


def posterior_mode(G: Array, b: Array, scales: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the mode under Cauchy priors within bounds, and the curvature there.

    The prior is met by a normal law of the same slope, in turns (each turn raises the posterior).
    """
    values = np.zeros(len(b))
    weights = 1.0 / scales**2  # 2 / (s^2 + theta^2) at theta = s
    for _ in range(30):
        new = _bounded_solution(G + np.diag(weights), b, low, high, values)
        moved = np.max(np.abs(new - values) * np.sqrt(np.diag(G) + weights), initial=0.0)
        values = new
        weights = 2.0 / (scales**2 + values**2)
        if moved < 1e-3:
            break
    bent = 2 * (scales**2 - values**2) / (scales**2 + values**2) ** 2
    curvature = G + np.diag(bent)
    if np.linalg.eigvalsh(curvature)[0] <= 0:
        curvature = G + np.diag(weights)
    return values, curvature


def _bounded_solution(H: Array, b: Array, low: Array, high: Array, start: Array) -> Array:
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
            x[free] = (np.linalg.solve(part, right) if failed else solved) * unit[free]
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


def _inside(values: Array, gradient: Array, curvature: Array, low: Array, high: Array) -> float:
    """Return the log of the share of the normal law about the mode that lies within the bounds, one value at a time."""
    total = 0.0
    for index, (value, slope) in enumerate(zip(values, gradient)):
        root = np.sqrt(curvature[index, index])
        # Where the slope does not vanish, as on a bound, the law is normal about where it would.
        centre = value + slope / root**2
        upper, lower = (high[index] - centre) * root, (low[index] - centre) * root
        shift = 0.5 * (slope / root) ** 2
        if lower > 0:  # both ends are above the centre, where the difference of two shares of 1 is lost
            upper, lower = -lower, -upper
        log_share = log_ndtr(upper) + np.log1p(-np.exp(min(log_ndtr(lower) - log_ndtr(upper), -1e-12)))
        total += float(shift + log_share)
    return total
