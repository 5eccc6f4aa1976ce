"""Sets of causes, searched on Gram matrices of whitened innovations.

Of one log `search` weighs every move, and so many sets that their probabilities are known; of many Gram matrices that
are much alike `search_sets` weighs the few moves that promise most, and looks for the best set alone.
"""

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from skat.diagnosis.chains import Array
from skat.diagnosis.evidence import Gram, Weighed, Weigher
from skat.effects import EVERY, Effect

# Sets less likely than the best by more than this factor are told from it.
ALIAS_FACTOR = 20.0
# Causes at a time.
LARGEST_SET = 60
# A move that gains no more than this, nats, is rounding.
ROUNDING = 1e-9
# Effects that are weighed exactly in a move, of those that promise most; pairs are made of fewer.
PROMISING, PAIRED, ALIKE = 12, 8, 6
# Of the sets that a step could lead to, the most promising are weighed.
FEW = 4
# By as much, in nats, what an effect promises may be wrong.
UNSURE = 3.0
# A member that is worth more nats than this is exchanged for none but its twin: the cosine between both responses.
EXCHANGED, TWIN = 100.0, 0.95


@dataclass(frozen=True)
class Ranked:
    """Sets of causes by what they are worth.

    Attributes
    ----------
    sets : tuple of Weighed
        Every set that was weighed, the likeliest first.
    """

    sets: tuple[Weighed, ...]

    @property
    def probabilities(self) -> Array:
        """Of each set, of all that were weighed."""
        evidence = np.array([one.evidence for one in self.sets])
        weights = np.exp(evidence - evidence[0])
        probabilities: Array = weights / weights.sum()
        return probabilities

    def probability(self, cause: int) -> float:
        """Return the probability that an effect is a cause."""
        shares = self.probabilities
        return min(1.0, float(sum(share for share, one in zip(shares, self.sets) if cause in one.members)))


def rivals_of(effects: Sequence[Effect]) -> dict[int, list[int]]:
    """Return for each effect the places of those that are all of its family, or each of it."""
    rivals: dict[int, list[int]] = {}
    for every, effect in enumerate(effects):
        if effect.target == EVERY.get(effect.family, "all"):
            for one, other in enumerate(effects):
                if other.family == effect.family and one != every:
                    rivals.setdefault(every, []).append(one)
                    rivals.setdefault(one, []).append(every)
    return rivals


def families_of(effects: Sequence[Effect]) -> dict[str, list[int]]:
    """Return the places of the members of each family, without what stands for all of them."""
    families = defaultdict(list)
    for place, effect in enumerate(effects):
        if effect.target is not None and effect.target != EVERY.get(effect.family, "all"):
            families[effect.family].append(place)
    return dict(families)


def search(
    worth: Weigher,
    start: Sequence[int] = (),
    *,
    families: Mapping[str, Sequence[int]] | None = None,
    banned: Sequence[int] = (),
    most: int | None = None,
) -> Ranked:
    """Return sets of causes by what they are worth.

    Causes are added, dropped and exchanged one at a time, or a family at a time, and added two at a time where no such
    move gains, until none does; from nothing, and from a set to start with.

    Parameters
    ----------
    worth : Weigher
        That has weighed nothing yet.
    start : sequence of int
        Places of the effects of a set that may be near.
    families : mapping from name to places, optional
        Effects that may come together.
    banned : sequence of int
        Effects that are no causes.
    most : int, optional
        Causes at a time.
    """
    families = families or {}
    most = LARGEST_SET if most is None else most
    worth(())
    for first in dict.fromkeys([(), tuple(sorted(set(start) - set(banned)))[:most]]):
        now = worth(first)
        while True:
            promising = _promising(worth, now, banned)
            moves = [(*now.members, one) for one in promising[:PROMISING]]
            moves += [tuple(set(now.members) - {one}) for one in now.members]
            moves += [
                (*(set(now.members) - {one}), other)
                for one in now.members
                for other in _alike(worth.gram, one)
                if other not in now.members and other not in banned
            ]
            moves += _family_moves(now.members, families, banned, worth.rivals)
            top = _best(worth, now, moves, most)
            if not _gains(top, now):
                pairs = combinations(promising[:PAIRED], 2)
                top = _best(worth, now, [(*now.members, *pair) for pair in pairs], most)
            if not _gains(top, now):
                break
            now = top
    return Ranked(tuple(sorted(worth.seen.values(), key=lambda one: -one.evidence)))


def _gains(one: Weighed, now: Weighed) -> bool:
    return one.evidence > now.evidence + ROUNDING


def _evidence(one: Weighed) -> float:
    return one.evidence


def _best(worth: Weigher, now: Weighed, moves: Sequence[Collection[int]], most: int) -> Weighed:
    allowed = (move for move in moves if len(set(move)) <= most and worth.allows(move))
    return max(map(worth, allowed), key=_evidence, default=now)


def _promising(worth: Weigher, now: Weighed, banned: Sequence[int]) -> list[int]:
    """Return the effects that are not in a set, by about what each one would add."""
    gain = worth.promises(now)
    gain[list(banned)] = -np.inf
    order = np.argsort(-gain, kind="stable")
    return [int(one) for one in order if np.isfinite(gain[one])]


def _alike(gram: Gram, one: int) -> list[int]:
    """Return the effects whose response is most like that of one."""
    order = np.argsort(-gram.cosines(one), kind="stable")
    return [int(other) for other in order[: ALIKE + 1] if other != one]


def _family_moves(
    members: Sequence[int],
    families: Mapping[str, Sequence[int]],
    banned: Sequence[int],
    rivals: Mapping[int, Sequence[int]],
) -> list[tuple[int, ...]]:
    """Return sets with a whole family more, or without one; what stands for all of it goes and comes with that."""
    now, moves = set(members), []
    for family in families.values():
        own = set(family) - set(banned)
        every = {other for one in family for other in rivals.get(one, ())}
        if own - now and len(own) > 1:
            moves.append(tuple((now - every) | own))
        if len(own & now) > 1:
            moves.append(tuple(now - own))
            moves += [tuple((now - own) | {one}) for one in every if one not in banned]
    return moves


def search_sets(worth: Weigher, start: Sequence[int] = ()) -> Weighed:
    """Return the set of causes that is worth most, begun with one that may be near.

    No single effect can be dropped, added or exchanged with a gain, of those that promise most.
    """
    now = worth(start)
    while True:
        weakest = [now.members[place] for place in np.argsort(_likely_losses(now))[:FEW]]
        top = _best(worth, now, [set(now.members) - {one} for one in weakest], LARGEST_SET)
        if not _gains(top, now):
            likely = _promising(worth, now, ())[:FEW]
            top = _best(worth, now, [(*now.members, one) for one in likely], LARGEST_SET)
        if not _gains(top, now):
            top = _best_exchange(worth, now)
        if not _gains(top, now):
            return now
        now = top


def _best_exchange(worth: Weigher, now: Weighed) -> Weighed:
    """Return the first better set that has another effect in a member's place."""
    losses = dict(zip(now.members, _likely_losses(now)))
    for gone in sorted(now.members, key=lambda one: losses[one]):
        twins = worth.gram.cosines(gone)
        twins[gone] = 0
        if losses[gone] > EXCHANGED and twins.max() < TWIN:
            continue
        rest = worth.without(now, gone)
        promises = worth.promises(rest)
        for one in _promising(worth, rest, [gone])[:2]:
            if rest.evidence + promises[one] > now.evidence - UNSURE:
                tried = worth((*rest.members, one))
                if _gains(tried, now):
                    return tried
    return now


def _likely_losses(now: Weighed) -> Array:
    """Return about how many nats of likelihood each member of a set is worth."""
    losses: Array = now.values**2 / np.maximum(np.diag(now.covariance), 1e-300) / 2
    return losses


def without_weak(best: Weighed, worth: Weigher, needed: float) -> tuple[Weighed, dict[int, float]]:
    """Return what is left of a set when all of its members are worth what a name needs, and what each is worth.

    Parameters
    ----------
    best : Weighed
    worth : Weigher
    needed : float
        Nats; see `Weigher.losses`.
    """
    while best.members:
        losses = worth.losses(best)
        weakest = min(losses, key=lambda one: losses[one])
        if losses[weakest] >= needed:
            return best, losses
        best = worth.without(best, weakest)
    return best, {}


def alternatives(best: Weighed, worth: Weigher, within: float) -> dict[int, list[tuple[int, float]]]:
    """Return for each member the effects that could stand in its place, and how many nats less such a set is worth."""
    found: dict[int, list[tuple[int, float]]] = {}
    for one in best.members:
        rest = worth.without(best, one)
        least = best.evidence - rest.evidence - within - UNSURE
        likely = [int(other) for other in np.flatnonzero(worth.promises(rest) > least) if other != one]
        lost = [(other, best.evidence - worth((*rest.members, other)).evidence) for other in likely]
        found[one] = sorted([pair for pair in lost if pair[1] <= within], key=lambda pair: pair[1])
    return found
