"""Sets of many causes, searched on a Gram matrix by whole families and by single effects.

A first model of a real machine lacks a dozen things at once, and one at a time a search ends in absurd places. Here whole
families, each member with a value of its own, are added and dropped, several after each other; then single effects are
added, dropped and exchanged. Which are worth weighing is told by the gain of the likelihood that the quadratic
approximation promises, so that few sets are weighed.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from skat.diagnosis.filtering import Array
from skat.diagnosis.set_evidence import Gram, Priors, Weighed, weigh

LARGEST_SET = 80
# Of the sets that a step could lead to, the most promising are weighed.
WEIGHED = 5


class Weigher:
    """Weighs sets, each once.

    Parameters
    ----------
    gram : Gram
    priors : Priors
    always : sequence of int
        Effects that are in every set.
    """

    def __init__(self, gram: Gram, priors: Priors, always: Sequence[int] = ()):
        self.gram, self.priors = gram, priors
        self.always = tuple(always)
        self.seen: dict[tuple[int, ...], Weighed] = {}

    def __call__(self, members: Sequence[int]) -> Weighed:
        key = tuple(sorted({*members, *self.always}))
        if key not in self.seen:
            self.seen[key] = weigh(self.gram, self.priors, key)
        return self.seen[key]

    def chosen(self, one: Weighed) -> tuple[int, ...]:
        """Return the members that are not in every set."""
        return tuple(place for place in one.members if place not in self.always)

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
        gain[S] = -np.inf
        return np.asarray(gain)


def search_sets(
    gram: Gram,
    priors: Priors,
    families: Mapping[str, Sequence[int]],
    *,
    start: Sequence[int] = (),
    always: Sequence[int] = (),
) -> tuple[Weighed, Weigher]:
    """Return the set of causes that is worth most, and all that were weighed.

    Parameters
    ----------
    gram : Gram
    priors : Priors
    families : mapping from name to places of effects
        That may be added and dropped together.
    start : sequence of int
        A set to begin with, beside the empty one.
    always : sequence of int
        Effects that are in every set: a nuisance.
    """
    worth = Weigher(gram, priors, always)
    best = _by_single_effects(worth, worth(()))
    begun = _by_families(worth, worth(()), families)
    best = max(best, _by_single_effects(worth, begun), key=_evidence)
    if start:
        best = max(best, _by_single_effects(worth, worth(start)), key=_evidence)
    return best, worth


def _evidence(one: Weighed) -> float:
    return one.evidence


def _by_families(worth: Weigher, now: Weighed, families: Mapping[str, Sequence[int]]) -> Weighed:
    """Add and drop families as long as that gains."""
    while True:
        own = set(worth.chosen(now))
        moves = [own | set(places) for places in families.values() if not set(places) <= own]
        moves += [own - set(places) for places in families.values() if set(places) <= own]
        found = max((worth(tuple(move)) for move in moves if len(move) <= LARGEST_SET), key=_evidence, default=now)
        if found.evidence <= now.evidence + 1e-9:
            return now
        now = found


def _by_single_effects(worth: Weigher, now: Weighed) -> Weighed:
    """Add, drop and exchange single effects as long as that gains."""
    while True:
        tried = _best_drop(worth, now)
        if tried.evidence <= now.evidence + 1e-9:
            tried = _best_addition(worth, now)
        if tried.evidence <= now.evidence + 1e-9:
            tried = _best_exchange(worth, now)
        if tried.evidence <= now.evidence + 1e-9:
            return now
        now = tried


def _best_addition(worth: Weigher, now: Weighed) -> Weighed:
    own = worth.chosen(now)
    if len(own) >= LARGEST_SET:
        return now
    likely = np.argsort(-worth.promises(now))[:WEIGHED]
    likely = [int(one) for one in likely if one not in now.members]
    return max((worth((*own, one)) for one in likely), key=_evidence, default=now)


def _best_drop(worth: Weigher, now: Weighed) -> Weighed:
    own = worth.chosen(now)
    if not own:
        return now
    losses = now.values**2 / np.maximum(np.diag(np.linalg.inv(now.curvature)), 1e-300)
    order = [now.members[place] for place in np.argsort(losses) if now.members[place] in own][:WEIGHED]
    return max((worth([one for one in own if one != gone]) for gone in order), key=_evidence)


def _best_exchange(worth: Weigher, now: Weighed) -> Weighed:
    own, best = worth.chosen(now), now
    for gone in own:
        rest = worth([one for one in own if one != gone])
        if rest.evidence < now.evidence - 200:  # nothing takes the place of what is worth so much, short of a twin
            sizes = np.sqrt(np.diag(worth.gram.products))
            twin = np.abs(worth.gram.products[gone]) / (sizes * sizes[gone] + 1e-300)
            twin[list(now.members)] = 0
            candidates = [int(np.argmax(twin))]
        else:
            candidates = [int(one) for one in np.argsort(-worth.promises(rest))[:2]]
        for one in candidates:
            if one not in now.members:
                best = max(best, worth((*worth.chosen(rest), one)), key=_evidence)
    return best


def without_weak(best: Weighed, worth: Weigher, needed: float) -> tuple[Weighed, dict[int, float]]:
    """Return the best set all of whose members are worth enough, and the nats that each is worth."""
    while own := worth.chosen(best):
        nats = {one: best.evidence - worth([other for other in own if other != one]).evidence for one in own}
        weakest = min(nats, key=lambda one: nats[one])
        if nats[weakest] >= needed:
            return best, nats
        best = worth([other for other in own if other != weakest])
    return best, {}


def alternatives(best: Weighed, worth: Weigher, within: float) -> dict[int, list[tuple[int, float]]]:
    """Return for each member the effects that could stand in its place, and how many nats less such a set is worth."""
    own = worth.chosen(best)
    found: dict[int, list[tuple[int, float]]] = {}
    for one in own:
        rest = worth([other for other in own if other != one])
        likely = [int(other) for other in np.argsort(-worth.promises(rest))[: WEIGHED + 1] if other != one]
        lost = [(other, best.evidence - worth((*worth.chosen(rest), other)).evidence) for other in likely]
        found[one] = sorted([pair for pair in lost if pair[1] <= within], key=lambda pair: pair[1])
    return found
