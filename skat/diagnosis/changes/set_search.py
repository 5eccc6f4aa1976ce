"""Sets of causes, searched on a Gram matrix.

Effects are added, dropped and exchanged one at a time, as long as that gains. Which are worth weighing is told by the
gain of the likelihood that the quadratic approximation promises, so that few sets are weighed.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import log_ndtr

from skat.diagnosis.evidence import Gram, Priors, Weighed, weigh
from skat.diagnosis.filtering import Array

LARGEST_SET = 80
# Of the sets that a step could lead to, the most promising are weighed.
WEIGHED = 4
# Steps of a posterior mode, each with a normal law in the place of each prior.
TURNS = 12
# A member that is worth more nats than this is exchanged for none but its twin.
EXCHANGED = 100.0
TWIN = 0.95


class Weigher:
    """Weighs sets, each once.

    Parameters
    ----------
    gram : Gram
    priors : Priors
    rivals : mapping from place to places
        Effects that are in no set with a given one: all of a family, and each of it.
    """

    def __init__(self, gram: Gram, priors: Priors, rivals: Mapping[int, Sequence[int]] | None = None):
        self.gram, self.priors = gram, priors
        self.rivals = rivals or {}
        self._last = np.zeros(len(priors.scales))
        self.seen: dict[tuple[int, ...], Weighed] = {}

    def __call__(self, members: Sequence[int]) -> Weighed:
        """Return what a set is worth."""
        key = tuple(sorted(set(members)))
        if key not in self.seen:
            self.seen[key] = self._weighed(key)
        return self.seen[key]

    def _weighed(self, members: tuple[int, ...]) -> Weighed:
        """Return what a set is worth: as `weigh`, from the values of like sets."""
        if not members:
            return weigh(self.gram, self.priors, ())
        chosen = np.array(members)
        G, b = self.gram.products[np.ix_(chosen, chosen)], self.gram.at_neutral[chosen]
        scales, low, high = self.priors.scales[chosen], self.priors.low[chosen], self.priors.high[chosen]
        values = self._last[chosen]
        for _ in range(TURNS):
            weights = 2 / (scales**2 + values**2)
            new = _bounded(G + np.diag(weights), b, low, high, values)
            moved = float(np.max(np.abs(new - values) * np.sqrt(np.diag(G) + weights)))
            values = new
            if moved < 1e-2:
                break
        self._last[chosen] = values
        bent = 2 * (scales**2 - values**2) / (scales**2 + values**2) ** 2
        curvature = G + np.diag(bent)
        unit = 1 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
        sign, log_determinant = np.linalg.slogdet(curvature * unit * unit[:, None])
        if sign <= 0 or not (np.diag(curvature) > 0).all():
            curvature = G + np.diag(2 / (scales**2 + values**2))
            unit = 1 / np.sqrt(np.diag(curvature))
            _, log_determinant = np.linalg.slogdet(curvature * unit * unit[:, None])
        log_determinant -= 2 * float(np.log(unit).sum())
        likelihood = float(b @ values - 0.5 * values @ G @ values)
        prior = self.priors.log_density(members, values).sum() + self.priors.log_odds[chosen].sum()
        evidence = likelihood + float(prior) + 0.5 * len(members) * np.log(2 * np.pi) - 0.5 * log_determinant
        slope = b - G @ values - 2 * values / (scales**2 + values**2)
        roots = 1 / unit
        centres = values + slope * unit**2
        upper, lower = (high - centres) * roots, (low - centres) * roots
        above = lower > 0
        upper, lower = np.where(above, -lower, upper), np.where(above, -upper, lower)
        inside = log_ndtr(upper) + np.log1p(-np.exp(np.minimum(log_ndtr(lower) - log_ndtr(upper), -1e-12)))
        evidence += float(np.sum(0.5 * (slope * unit) ** 2 + inside))
        return Weighed(members, values, evidence, likelihood, curvature)

    def promises(self, now: Weighed) -> Array:
        """Return by how much each further effect would raise the log posterior odds, about; -inf of members."""
        S, G = list(now.members), self.gram.products
        left, spread = self.gram.at_neutral.copy(), np.diag(G) + 1 / self.priors.scales**2
        if S:
            solved = np.linalg.solve(now.curvature, G[S])
            left = left - G[:, S] @ now.values
            spread = spread - np.sum(G[S] * solved, axis=0)
        spread = np.maximum(spread, 1 / self.priors.scales**2)
        shift = np.clip(left / spread, self.priors.low, self.priors.high)
        gain = left * shift - 0.5 * spread * shift**2
        gain += self.priors.log_odds + 0.5 * np.log(2 * np.pi / spread)
        gain -= np.log(np.pi * self.priors.scales) + np.log1p((shift / self.priors.scales) ** 2)
        gain[[*S, *(other for one in S for other in self.rivals.get(one, ()))]] = -np.inf
        return np.asarray(gain)


def _bounded(H: Array, b: Array, low: Array, high: Array, start: Array) -> Array:
    """Return the minimum of x'Hx/2 - b'x within bounds: those that a solution breaks are held, several at a time."""
    unit = 1 / np.sqrt(np.diag(H))
    H, b, low, high = H * unit * unit[:, None], b * unit, low / unit, high / unit
    held = np.zeros(len(b), dtype=bool)
    x = np.clip(start / unit, low, high)
    for _ in range(2 * len(b) + 2):
        free = ~held
        if free.any():
            right = b[free] - H[np.ix_(free, held)] @ x[held]
            x[free] = np.linalg.solve(H[np.ix_(free, free)], right)
        beyond = free & ((x < low - 1e-12) | (x > high + 1e-12))
        if beyond.any():
            x = np.clip(x, low, high)
            held |= beyond
            continue
        slope = b - H @ x
        inward = held & (((x <= low) & (slope > 1e-9)) | ((x >= high) & (slope < -1e-9)))
        if not inward.any():
            break
        held[int(np.argmax(np.where(inward, np.abs(slope), -1.0)))] = False
    return np.clip(x, low, high) * unit


def search_sets(
    gram: Gram,
    priors: Priors,
    *,
    start: Sequence[int] = (),
    rivals: Mapping[int, Sequence[int]] | None = None,
) -> tuple[Weighed, Weigher]:
    """Return the set of causes that is worth most, and all that were weighed.

    No single effect can be added, dropped or exchanged with a gain.

    Parameters
    ----------
    gram : Gram
    priors : Priors
    start : sequence of int
        A set to begin with.
    rivals : mapping from place to places, optional
        As `Weigher`'s.
    """
    worth = Weigher(gram, priors, rivals)
    now = worth(start)
    while True:
        tried = _best_drop(worth, now)
        if tried.evidence <= now.evidence + 1e-9:
            tried = _best_addition(worth, now)
        if tried.evidence <= now.evidence + 1e-9:
            tried = _best_exchange(worth, now)
        if tried.evidence <= now.evidence + 1e-9:
            return now, worth
        now = tried


def _evidence(one: Weighed) -> float:
    return one.evidence


def _best_addition(worth: Weigher, now: Weighed) -> Weighed:
    own = now.members
    if len(own) >= LARGEST_SET:
        return now
    promises = worth.promises(now)
    likely = [int(one) for one in np.argsort(-promises)[:WEIGHED] if promises[one] > -np.inf]
    return max((worth((*own, one)) for one in likely), key=_evidence, default=now)


def _best_drop(worth: Weigher, now: Weighed) -> Weighed:
    own = now.members
    if not own:
        return now
    losses = now.values**2 / np.maximum(np.diag(np.linalg.inv(now.curvature)), 1e-300)
    order = [own[place] for place in np.argsort(losses)[:WEIGHED]]
    return max((worth([one for one in own if one != gone]) for gone in order), key=_evidence)


def _best_exchange(worth: Weigher, now: Weighed) -> Weighed:
    """Return the first better set that has another effect in a member's place."""
    own = now.members
    sizes = np.sqrt(np.diag(worth.gram.products)) + 1e-300
    spreads = np.diag(np.linalg.inv(now.curvature)) if now.members else np.zeros(0)
    losses = dict(zip(now.members, now.values**2 / np.maximum(spreads, 1e-300) / 2))
    for gone in sorted(own, key=lambda one: losses[one]):
        twins = np.abs(worth.gram.products[gone]) / (sizes * sizes[gone])
        twins[gone] = 0
        if losses[gone] > EXCHANGED and twins.max() < TWIN:
            continue
        rest = worth([one for one in own if one != gone])
        promises = worth.promises(rest)
        promises[gone] = -np.inf
        for one in np.argsort(-promises)[:2]:
            if promises[one] > -np.inf and rest.evidence + promises[one] > now.evidence - 3:
                tried = worth((*rest.members, int(one)))
                if tried.evidence > now.evidence + 1e-9:
                    return tried
    return now


def without_weak(best: Weighed, worth: Weigher, needed: float) -> tuple[Weighed, dict[int, float]]:
    """Return the best set all of whose members are worth enough, and the nats that each is worth."""
    while own := best.members:
        nats = {one: best.evidence - worth([other for other in own if other != one]).evidence for one in own}
        weakest = min(nats, key=lambda one: nats[one])
        if nats[weakest] >= needed:
            return best, nats
        best = worth([other for other in own if other != weakest])
    return best, {}


def alternatives(best: Weighed, worth: Weigher, within: float) -> dict[int, list[tuple[int, float]]]:
    """Return for each member the effects that could stand in its place, and how many nats less such a set is worth."""
    found: dict[int, list[tuple[int, float]]] = {}
    for one in best.members:
        rest = worth([other for other in best.members if other != one])
        likely = [
            int(other)
            for other in np.argsort(-worth.promises(rest))[: WEIGHED + 1]
            if other != one and other not in best.members
        ]
        lost = [(other, best.evidence - worth((*rest.members, other)).evidence) for other in likely]
        found[one] = sorted([pair for pair in lost if pair[1] <= within], key=lambda pair: pair[1])
    return found
