"""What a search ends with: causes with their intervals and probabilities, aliases, and what else the log shows."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skat.diagnosis.evidence import Gram, Priors, Weighed, Weigher, at_bound, weigh
from skat.diagnosis.fits import Fit, Fits
from skat.diagnosis.fitting import Fitted, around, coordinate, value_at
from skat.diagnosis.search import ALIAS_FACTOR, Ranked, without_weak
from skat.effects import Effect


@dataclass(frozen=True)
class Found:
    """The causes that a log asks for.

    Attributes
    ----------
    effects : tuple of Effect
        That might have been causes.
    values : dict of str to float
    intervals : dict of str to tuple of two floats
        95 %.
    worth : dict of str to float
        What each cause is worth beside the others, nats: log posterior odds for the set with it against that without.
    aliases : dict of str to tuple of (str, float)
        For each cause the effects that may be behind it, with their probabilities.
    probabilities : dict of str to float
        Of every effect, that it is a cause.
    also : dict of str to float
        Effects that the log shows, and their values, but that matter less than what no model gets right.
    fitted : Fitted
        At these values.
    gram : Gram
        There.
    priors : Priors
    ranked : Ranked
    best : Weighed
    settled : bool
        Whether the search stands still.
    """

    effects: tuple[Effect, ...]
    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    worth: dict[str, float]
    aliases: dict[str, tuple[tuple[str, float], ...]]
    probabilities: dict[str, float]
    also: dict[str, float]
    fitted: Fitted
    gram: Gram
    priors: Priors
    ranked: Ranked
    best: Weighed
    settled: bool


@dataclass(frozen=True)
class Rival:
    """A set in which another effect stands in a cause's place, at a fit of its own.

    Attributes
    ----------
    cause, other : int
    gain : float
        By how much this set may be likelier than that with the cause, nats.
    """

    cause: int
    other: int
    gain: float


def told(
    fits: Fits,
    now: Fit,
    worth: Weigher,
    ranked: Ranked,
    rivals: Sequence[Rival],
    also: dict[str, float],
    needed: float,
    stands: bool,
) -> Found:
    """Return the causes of the set that a search ends with.

    Parameters
    ----------
    fits : Fits
    now : Fit
        Of this set.
    worth : Weigher
        Of slopes there.
    ranked : Ranked
        What slopes say of sets.
    rivals : sequence of Rival
        What fits say of those that they were asked of.
    also : mapping from name to value
        What else the log shows.
    needed : float
        By how many nats a set must be likelier for each name more.
    stands : bool
        Whether the search has come to rest.
    """
    effects, priors, gram = fits.effects, fits.priors, worth.gram
    names, best = priors.names, worth(now.members)
    ranked = _with_fits(ranked, worth, best, rivals)
    probabilities = {name: ranked.probability(place) for place, name in enumerate(names)}
    shares = _shares(rivals)
    for one, others in shares.items():
        # Both together may be likelier than either, which does not make either of them the one.
        probabilities[names[one]] = min(probabilities[names[one]], 1 - sum(share for _, share in others))
    refitted = {
        names[one]: tuple((names[other], share) for other, share in others) for one, others in shares.items()
    }
    alike = {
        names[one]: tuple((names[other], share) for other, share in others.items())
        for one, others in stand_ins(ranked, gram, best, names).items()
    }
    # A search that was stopped may end at a bound, or with what is worth no name.
    strong, _ = without_weak(best, worth, needed)
    kept = [one for one in strong.members if not is_held(effects[one], now.values[names[one]])]
    intervals, losses = {}, worth.losses(best)
    # Intervals are of the whole likelihood.
    for one, half in zip(best.members, weigh(gram, priors, best.members).half_widths):
        low, high = around(effects[one], now.values[names[one]], half)
        intervals[names[one]] = low, max(high, value_at(effects[one], fits.most_likely(now, one)))
    return Found(
        effects,
        {names[one]: now.values[names[one]] for one in kept},
        intervals,
        {names[one]: losses[one] for one in kept},
        _with_refitted(alike, refitted),
        probabilities,
        also,
        now.fitted,
        gram,
        priors,
        ranked,
        best,
        stands,
    )


def _with_fits(ranked: Ranked, worth: Weigher, best: Weighed, rivals: Sequence[Rival]) -> Ranked:
    """Return sets with what fits say of rivals in place of what slopes do; sets with more causes lose as much.

    None is likelier than the set that was preferred to it.
    """
    sets = {one.members: one for one in ranked.sets}
    for rival in rivals:
        members = exchanged(best.members, rival.cause, rival.other)
        swapped = sets.get(members) or worth(members)
        found = replace(swapped, evidence=best.evidence + min(rival.gain, 0.0))
        lost = max(swapped.evidence - found.evidence, 0.0)
        for one in list(sets.values()):
            if set(members) < set(one.members) and rival.cause not in one.members:
                sets[one.members] = replace(one, evidence=one.evidence - lost)
        sets[members] = found
    return Ranked(tuple(sorted(sets.values(), key=lambda one: (-one.evidence, one.members != best.members))))


def _shares(rivals: Sequence[Rival]) -> dict[int, tuple[tuple[int, float], ...]]:
    """Return for each cause the rivals that do nearly as well, and their probabilities."""
    near = [rival for rival in rivals if rival.gain > -np.log(ALIAS_FACTOR)]
    shares = {}
    for cause in {rival.cause for rival in near}:
        own = [rival for rival in near if rival.cause == cause]
        odds = np.exp(np.minimum([rival.gain for rival in own], 0.0))
        shares[cause] = tuple((rival.other, float(one / (1 + odds.sum()))) for rival, one in zip(own, odds))
    return shares


def _with_refitted(
    aliases: dict[str, tuple[tuple[str, float], ...]], refitted: dict[str, tuple[tuple[str, float], ...]]
) -> dict[str, tuple[tuple[str, float], ...]]:
    """Return aliases with those of fits of their own put before those of slopes."""
    both = {}
    for cause, names in aliases.items():
        own = refitted.get(cause, ())
        both[cause] = (*own, *(one for one in names if one[0] not in {name for name, _ in own}))
    return both


def stand_ins(ranked: Ranked, gram: Gram, best: Weighed, names: Sequence[str]) -> dict[int, dict[int, float]]:
    """Return for each cause the effects that have its place in sets nearly as likely, the likeliest first."""
    found: dict[int, dict[int, float]] = {one: defaultdict(float) for one in best.members}
    for share, one in zip(ranked.probabilities, ranked.sets):
        if one.evidence < best.evidence - np.log(ALIAS_FACTOR):
            break
        others = [other for other in one.members if other not in best.members]
        for cause in set(best.members) - set(one.members):
            if others:
                alike = gram.cosines(cause)[others]
                found[cause][others[int(np.argmax(alike))]] += float(share)

    def first(one: tuple[int, float]) -> tuple[float, str]:
        return -round(one[1], 6), names[one[0]]

    return {cause: dict(sorted(shares.items(), key=first)) for cause, shares in found.items()}


def also_seen(
    ask: Callable[..., Ranked],
    gram: Gram,
    priors: Priors,
    effects: Sequence[Effect],
    exclusive: Mapping[int, Sequence[int]],
    best: Weighed,
    needed: float,
    banned: Sequence[int],
) -> dict[str, float]:
    """Return what the log shows beside the causes if the model is taken for exact."""
    worth = Weigher(gram, priors, exclusive)
    exact, _ = without_weak(ask(worth, best.members, banned=banned).sets[0], worth, needed)
    return {
        priors.names[one]: value_at(effects[one], at)
        for one, at in zip(exact.members, exact.values)
        if one not in best.members and not is_held(effects[one], value_at(effects[one], at))
    }


def exchanged(members: Sequence[int], cause: int, other: int) -> tuple[int, ...]:
    """Return a set with another effect in a cause's place."""
    return tuple(sorted({*members, other} - {cause}))


def is_held(effect: Effect, value: float) -> bool:
    """Whether an estimate lies at a bound that is not neutral, but for the finest time step: reality has none."""
    low, high = (coordinate(effect, bound) for bound in effect.bounds)
    return at_bound(coordinate(effect, value), 0.0 if effect.family == "timestep" else low, high)
