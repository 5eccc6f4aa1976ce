"""What a search ends with: causes with their intervals and probabilities, aliases, and what else the log shows."""

from collections import defaultdict
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from skat.diagnosis.chains import Array
from skat.diagnosis.evidence import WIDTH_95, Gram, Law, Priors, Weighed, Weigher, at_bound, law_of, weigh
from skat.diagnosis.fits import Fit, Fits
from skat.diagnosis.fitting import Fitted, coordinate, value_at
from skat.diagnosis.search import ALIAS_FACTOR, Ranked, without_weak
from skat.effects import Effect

# Sets that are less likely say nothing of an interval.
LEAST_SHARE = 1e-4


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
    """Another set of causes than the one that a search ends with, at a fit of its own beside that.

    Attributes
    ----------
    members : tuple of int
    places : ndarray of shape (len(members),)
        Coordinates.
    gain : float
        By how much this set may be likelier, nats.
    """

    members: tuple[int, ...]
    places: Array
    gain: float

    def without(self, dropped: Container[int]) -> "Rival":
        """Return the same where some causes are in neither."""
        kept = [place for place, one in enumerate(self.members) if one not in dropped]
        return Rival(tuple(self.members[place] for place in kept), self.places[kept], self.gain)


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
        What fits say of those that they were asked of, small sets before larger ones.
    also : mapping from name to value
        What else the log shows.
    needed : float
        By how many nats a set must be likelier for each name more.
    stands : bool
        Whether the search has come to rest.
    """
    effects, priors, gram = fits.effects, fits.priors, worth.gram
    names, best = priors.names, worth(now.members)
    ranked = _with_laws(_with_fits(ranked, worth, best, rivals), worth)
    ranked = _beside_rivals(ranked, worth, best, rivals)
    own = next(one for one in ranked.sets if one.members == best.members)
    probabilities = {name: ranked.probability(place) for place, name in enumerate(names)}
    aliases = {
        names[one]: tuple((names[other], share) for other, share in others.items())
        for one, others in stand_ins(ranked, gram, own, names).items()
    }
    # A search that was stopped may end at a bound, or with what is worth no name.
    strong, _ = without_weak(best, worth, needed)
    kept = [one for one in strong.members if not is_held(effects[one], now.values[names[one]])]
    losses, intervals = worth.losses(best), {}
    for one, ends in _ends(worth, best, ranked).items():
        place = coordinate(effects[one], now.values[names[one]])
        low, high = (value_at(effects[one], place + end) for end in ends)
        intervals[names[one]] = low, max(high, value_at(effects[one], fits.most_likely(now, one)))
    return Found(
        effects,
        {names[one]: now.values[names[one]] for one in kept},
        intervals,
        {names[one]: losses[one] for one in kept},
        aliases,
        probabilities,
        also,
        now.fitted,
        gram,
        priors,
        ranked,
        best,
        stands,
    )


def _with_laws(ranked: Ranked, worth: Weigher) -> Ranked:
    """Return sets, those that are likely with what Laplace's approximation leaves out; see `law_of`."""
    sets, least = [], ranked.sets[0].evidence + np.log(LEAST_SHARE)
    for one in ranked.sets:
        slopes = worth(one.members)
        if one.evidence > least:
            law = law_of(worth.gram, worth.priors, slopes, power=worth.power)
            one = replace(one, evidence=one.evidence + law.evidence - slopes.evidence)
        sets.append(one)
    return Ranked(tuple(sorted(sets, key=lambda one: -one.evidence)))


def _ends(worth: Weigher, best: Weighed, ranked: Ranked) -> dict[int, tuple[float, float]]:
    """Return the ends of each cause's 95 % interval, from its value in the best set, coordinates.

    Over all sets with the cause, of the whole likelihood, those that were fitted where their fits are: where another
    cause may hide beside it, its value is known no better than that.
    """
    gram, priors, laws = worth.gram, worth.priors, []
    for share, one in zip(ranked.probabilities, ranked.sets):
        if share > LEAST_SHARE or one.members == best.members:
            law = law_of(gram, priors, weigh(gram, priors, one.members))
            moved = one.values - worth(one.members).values
            laws.append((one.evidence, replace(law, means=law.means + moved)))
    found = {}
    for cause, centre in zip(best.members, weigh(gram, priors, best.members).values):
        lower, upper = _quantiles(*_marginal(cause, [law for law in laws if cause in law[1].members], centre))
        found[cause] = min(lower, 0.0), max(upper, 0.0)
    return found


def _marginal(cause: int, laws: Sequence[tuple[float, Law]], centre: float) -> tuple[Array, Array, Array]:
    """Return weights, means from a centre and deviations of a cause's value in the laws of some sets that have it.

    Each law with the evidence of its set, nats: all of these sets may be next to impossible beside one without it.
    """
    at = [law.members.index(cause) for _, law in laws]
    most = max(evidence for evidence, _ in laws)
    shares = np.concatenate([np.exp(evidence - most) * law.shares for evidence, law in laws])
    means = np.concatenate([law.means[:, place] for (_, law), place in zip(laws, at)])
    deviations = np.concatenate([law.deviations[:, place] for (_, law), place in zip(laws, at)])
    return shares / shares.sum(), means - centre, deviations


def _quantiles(weights: Array, means: Array, deviations: Array) -> tuple[float, float]:
    """Return the ends between which 95 % of a mixture of normal laws lie."""
    outermost = 2 * WIDTH_95 * deviations + deviations.max()

    def end(share: float) -> float:
        low, high = (means - outermost).min(), (means + outermost).max()
        # Laws may be narrower than what lies between them by more orders than a faster search stands.
        for _ in range(100):
            middle = (low + high) / 2
            is_below = weights @ ndtr((middle - means) / deviations) < share
            low, high = (middle, high) if is_below else (low, middle)
        return float(low + high) / 2

    return end(float(ndtr(-WIDTH_95))), end(float(ndtr(WIDTH_95)))


def _with_fits(ranked: Ranked, worth: Weigher, best: Weighed, rivals: Sequence[Rival]) -> Ranked:
    """Return sets with what fits say of rivals in place of what slopes do; sets with more causes lose as much.

    But for what the set that was preferred to a rival has beside it. None with as few causes is likelier than that set.
    """
    sets = {one.members: one for one in (*ranked.sets, best)}
    for rival in rivals:
        slopes = sets.get(rival.members) or worth(rival.members)
        more = len(rival.members) > len(best.members)
        gain = rival.gain if more else min(rival.gain, 0.0)
        found = replace(slopes, values=rival.places, evidence=best.evidence + gain)
        lost, missing = max(slopes.evidence - found.evidence, 0.0), set(best.members) - set(rival.members)
        # What is lost by a cause less may be made up for by what is added.
        fewer = set(rival.members) < set(best.members)
        for one in list(sets.values()) if missing and not fewer else ():
            if set(rival.members) < set(one.members) and not missing & set(one.members):
                sets[one.members] = replace(one, evidence=one.evidence - lost)
        sets[rival.members] = found
    return Ranked(tuple(sorted(sets.values(), key=lambda one: (-one.evidence, one.members != best.members))))


def _beside_rivals(ranked: Ranked, worth: Weigher, best: Weighed, rivals: Sequence[Rival]) -> Ranked:
    """Return sets, where what may act beside the best one may act beside its rivals: neither is likelier by it.

    It is worth as much there, or less by as much as slopes say. What slopes say of a rival's larger sets stands where
    they say it of the best one's, too.
    """
    sets, now = {one.members: one for one in ranked.sets}, set(best.members)
    best, fitted = sets[best.members], {one.members for one in rivals}
    least = best.evidence + np.log(LEAST_SHARE)
    others = [
        one
        for one in ranked.sets
        if one.members in fitted
        and one.evidence > least
        and now - set(one.members)
        and set(one.members) - now
    ]
    least = ranked.sets[0].evidence + np.log(LEAST_SHARE)
    for whole in [one for one in ranked.sets if now < set(one.members) and one.evidence > least]:
        for rival in others:
            members = tuple(sorted({*rival.members, *(set(whole.members) - now)}))
            known = members in fitted or (members in sets and whole.members not in fitted)
            if known or not worth.allows(members):
                continue
            both = worth(members)
            there = both.evidence - worth(rival.members).evidence
            here = worth(whole.members).evidence - worth(best.members).evidence
            gain = whole.evidence - best.evidence + min(there - here, 0.0)
            sets[members] = replace(both, evidence=rival.evidence + gain)
    return Ranked(tuple(sorted(sets.values(), key=lambda one: -one.evidence)))


def stand_ins(ranked: Ranked, gram: Gram, best: Weighed, names: Sequence[str]) -> dict[int, dict[int, float]]:
    """Return for each cause the effects that have its place in other sets, if nearly as likely, the likeliest first."""
    found: dict[int, dict[int, float]] = {one: defaultdict(float) for one in best.members}
    for share, one in zip(ranked.probabilities, ranked.sets):
        others = [other for other in one.members if other not in best.members]
        for cause in set(best.members) - set(one.members):
            if others:
                alike = gram.cosines(cause)[others]
                found[cause][others[int(np.argmax(alike))]] += float(share)

    def first(one: tuple[int, float]) -> tuple[float, str]:
        return -round(one[1], 6), names[one[0]]

    for cause, shares in found.items():
        least = ranked.probability(cause) / ALIAS_FACTOR
        likely = [(other, share) for other, share in shares.items() if share > least]
        found[cause] = dict(sorted(likely, key=first))
    return found


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
