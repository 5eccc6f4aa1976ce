"""Sets of causes, searched on Gram matrices of whitened innovations."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from skat.diagnosis.evidence import Gram, Priors, Weighed, weigh
from skat.diagnosis.filtering import Array

LARGEST_SET = 60
# Effects that are weighed exactly in a move, of those that promise most; pairs are made of fewer.
PROMISING, PAIRED, ALIKE = 12, 8, 6


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


def search(
    gram: Gram,
    priors: Priors,
    start: Sequence[int] = (),
    *,
    families: Mapping[str, Sequence[int]] | None = None,
    power: float = 1.0,
    banned: Sequence[int] = (),
    most: int | None = None,
) -> Ranked:
    """Return sets of causes by what they are worth.

    Causes are added, dropped and exchanged one at a time, or a family at a time, and added two at a time where no such
    move gains, until none does; from nothing, and from a set to start with.

    Parameters
    ----------
    gram : Gram
    priors : Priors
    start : sequence of int
        Places of the effects of a set that may be near.
    families : mapping from name to places, optional
        Effects that may come together.
    power : float, default=1.0
        To which the likelihood is taken.
    banned : sequence of int
        Effects that are no causes.
    most : int, optional
        Causes at a time.
    """
    seen: dict[tuple[int, ...], Weighed] = {}
    families = families or {}
    most = LARGEST_SET if most is None else most

    def worth(members: Sequence[int]) -> Weighed:
        key = tuple(sorted(set(members)))
        if key not in seen:
            seen[key] = weigh(gram, priors, key, power=power)
        return seen[key]

    worth(())
    for first in dict.fromkeys([(), tuple(sorted(set(start) - set(banned)))[:most]]):
        now = worth(first)
        while True:
            promising = _promising(gram, priors, now, power, banned)
            moves = [(*now.members, one) for one in promising[:PROMISING]]
            moves += [tuple(set(now.members) - {one}) for one in now.members]
            moves += [
                (*(set(now.members) - {one}), other)
                for one in now.members
                for other in _alike(gram, one)
                if other not in now.members and other not in banned
            ]
            moves += _family_moves(now.members, families, banned)
            top = _best(worth, moves, most)
            if top is None or top.evidence <= now.evidence + 1e-9:
                pairs = combinations(promising[:PAIRED], 2)
                top = _best(worth, [(*now.members, *pair) for pair in pairs], most)
                if top is None or top.evidence <= now.evidence + 1e-9:
                    break
            now = top
    return Ranked(tuple(sorted(seen.values(), key=lambda one: -one.evidence)))


def _best(
    worth: Callable[[Sequence[int]], Weighed], moves: Sequence[Sequence[int]], most: int
) -> Weighed | None:
    candidates = [worth(move) for move in moves if len(set(move)) <= most]
    return max(candidates, key=lambda one: one.evidence, default=None)


def _promising(gram: Gram, priors: Priors, now: Weighed, power: float, banned: Sequence[int]) -> list[int]:
    """Return the effects that are not in a set, by about what each one would add."""
    G, b = gram.products * power, gram.at_neutral * power
    left, information = b.copy(), np.diag(G).copy()
    if now.members:
        members = np.array(now.members)
        left -= G[:, members] @ now.values
        solved = np.linalg.solve(now.curvature, G[members])
        information -= np.sum(G[:, members] * solved.T, axis=1)
    information = np.maximum(information, 1e-9 * np.maximum(np.diag(G), 1e-300))
    whole = information + 1 / priors.scales**2
    values = np.clip(left / whole, priors.low, priors.high)
    gain = left * values - 0.5 * information * values**2 + priors.log_odds
    gain += -np.log1p((values / priors.scales) ** 2) - np.log(priors.scales) - 0.5 * np.log(whole)
    gain[[*now.members, *banned]] = -np.inf
    order = np.argsort(-gain, kind="stable")
    return [int(one) for one in order if np.isfinite(gain[one])]


def _alike(gram: Gram, one: int) -> list[int]:
    """Return the effects whose response is most like that of one."""
    sizes = np.sqrt(np.maximum(np.diag(gram.products), 1e-300))
    cosines = np.abs(gram.products[one]) / (sizes * sizes[one])
    return [int(other) for other in np.argsort(-cosines, kind="stable")[: ALIKE + 1] if other != one]


def _family_moves(
    members: Sequence[int], families: Mapping[str, Sequence[int]], banned: Sequence[int]
) -> list[tuple[int, ...]]:
    """Return sets with a whole family more, or without one."""
    now, moves = set(members), []
    for family in families.values():
        own = set(family) - set(banned)
        if own - now and len(own) > 1:
            moves.append(tuple(now | own))
        if len(own & now) > 1:
            moves.append(tuple(now - own))
    return moves


def without_weak(
    best: Weighed,
    gram: Gram,
    priors: Priors,
    needed: float,
    *,
    power: float = 1.0,
    predictive: Callable[[Sequence[int]], float] | None = None,
) -> tuple[Weighed, dict[int, float]]:
    """Return what is left of a set when all of its members are worth what a name needs, and what each is worth.

    A member is worth what the set loses when it is dropped: of its evidence, or of what it predicts, if that is less.

    Parameters
    ----------
    best : Weighed
    gram, priors
    needed : float
        Nats.
    power : float, default=1.0
        To which the likelihood is taken.
    predictive : callable, optional
        ``predictive(members)`` returns what a set gains in pieces of the log with values from the others, nats.
    """
    while best.members:
        worth = {}
        whole = predictive(best.members) if predictive is not None else 0.0
        for one in best.members:
            rest = [other for other in best.members if other != one]
            worth[one] = best.evidence - weigh(gram, priors, rest, power=power).evidence
            if predictive is not None:
                predicted = power * (whole - predictive(rest)) + float(priors.log_odds[one])
                worth[one] = min(worth[one], predicted)
        weakest = min(worth, key=lambda one: worth[one])
        if worth[weakest] >= needed:
            return best, worth
        best = weigh(gram, priors, [other for other in best.members if other != weakest], power=power)
    return best, {}
