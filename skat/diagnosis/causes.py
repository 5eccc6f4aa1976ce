"""The causes that a log asks for: fit, search, fit anew, until the set stands still."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from skat.diagnosis.evidence import Gram, Priors, Weighed, weigh
from skat.diagnosis.filtering import Array
from skat.diagnosis.fitting import (
    STILL,
    Columns,
    Fitted,
    coordinate,
    gram_of,
    noise_without,
    priors_of,
    settled,
    slopes_of,
    value_at,
)
from skat.diagnosis.noise import TOLERANCE
from skat.diagnosis.search import Ranked, search, without_weak
from skat.diagnosis.statespace import StateSpace, derivatives
from skat.effects import EVERY, Effect
from skat.simulators.base import Simulator

# Families that act on what a sensor reads, and so on nothing where it was not read.
SENSORS = ("bias", "scale", "lag")
# Biases have a typical size in these units; elsewhere it is a share of a channel's spread.
KNOWN_UNITS = ("rad", "m", "rad/s", "m/s")
BIAS_SHARE = 0.03
# Relinearisations; a set that moves by less than this share of its standard errors stands still.
TURNS = 16
STANDS_STILL = 0.1
# How often noise and what all effects explain are taken in turns, before any is a cause.
DENSE_TURNS = 2
# No model is exact: a log of so many rows counts half [Miller, Dunson 2019].
COARSE_ROWS = 10_000
# Of a normal law within its 95 % interval.
WIDTH_95 = 1.96
# Sets less likely than the best by more than this factor are told from it.
ALIAS_FACTOR = 20.0
# Effects whose slopes are taken anew with the causes in, of those that promise most.
LIVE = 24
# The weakest causes, so many, must bear being left out of a fit of its own, of so many turns.
REFITTED, REFIT_TURNS = 3, 3
# Chords of an effect that has no slope where it is neutral, to each of its bounds.
CHORDS = 10
# Effects whose responses make a smaller angle than this cosine may be the same: so many are fitted in a cause's place.
ALIKE, RIVALS = 0.8, 2
# A bound that an estimate comes this near to, as a share of the range, holds it.
AT_BOUND = 1e-6


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
class Search:
    """How far a search has come: what it goes on from behind a relinearisation.

    Attributes
    ----------
    turn : int
        Of this relinearisation.
    values : dict of str to float
        At which it was made.
    fitted : Fitted
    slopes : ndarray of shape (n_rows, d, k)
    first : Gram or None
        Of the first turn; None in it.
    evidences : dict of tuple of int to float
        The most that a fit of its own gave to each set that was a rival or had one, nats.
    bounds : dict of tuple of int to float
        The best bound of each set so far.
    banned : tuple of int
        Effects that were refused.
    before : Fitted or None
        That of the turn before, from which slopes led here.
    astray : bool
        Whether slopes led to where a fit of its own did worse.
    """

    turn: int
    values: dict[str, float]
    fitted: Fitted
    slopes: Array
    first: Gram | None
    evidences: dict[tuple[int, ...], float]
    bounds: dict[tuple[int, ...], float]
    banned: tuple[int, ...]
    before: Fitted | None
    astray: bool


@dataclass(frozen=True)
class Rival:
    """A set in which another effect stands in a cause's place, at a fit of its own.

    Attributes
    ----------
    cause, other : int
    members : tuple of int
    evidence : float
        The most that a fit of its own gave to this set, nats.
    values : mapping from name to value
    """

    cause: int
    other: int
    members: tuple[int, ...]
    evidence: float
    values: Mapping[str, float]


def find_causes(
    space: StateSpace,
    effects: Sequence[Effect],
    *,
    alpha: float = 0.01,
    typical: Mapping[str, float] | None = None,
    floor: Array | None = None,
    given: Array | None = None,
    max_effects: int | None = None,
    start: Mapping[str, float] | None = None,
    resumed: Search | None = None,
    checkpoint: Callable[[Search], None] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Found:
    """Search for the set of causes that a log asks for.

    Parameters
    ----------
    space : StateSpace
    effects : sequence of Effect
        That may be causes; those of sensors that were not read are left out.
    alpha : float, default=0.01
        A cause is named if the odds for the set with it are 1 / alpha times those of the set without it.
    typical : mapping from name to size, optional
        Scales of the priors of a user's own.
    floor : ndarray of shape (d,), optional
        Least variance of each channel's noise, such as that of rounding.
    given : ndarray of shape (d,), optional
        Standard deviation of each channel's noise, where it is known.
    max_effects : int, optional
        Most causes at a time.
    start : mapping from name to value, optional
        Where to begin.
    resumed : Search, optional
        Go on from there.
    checkpoint : callable, optional
        ``checkpoint(search)`` is called behind each relinearisation.
    progress : callable, optional
        ``progress(stage, done, total)``.

    Returns
    -------
    Found
    """
    floor = np.zeros(space.d) if floor is None else floor
    effects = _readable(space, effects)
    priors = priors_of(effects, {**_typical_biases(space, effects), **(typical or {})})
    families = _families(effects)
    needed = -float(np.log(alpha))
    power = COARSE_ROWS / (COARSE_ROWS + len(space.X))
    places = {effect.name: place for place, effect in enumerate(effects)}
    values: dict[str, float] = dict(start or {})
    fitted: Fitted | None = None
    slopes: Array | None = None
    first: Gram | None = None
    rivals: list[Rival] = []
    evidences: dict[tuple[int, ...], float] = {}
    bounds: dict[tuple[int, ...], float] = {}
    banned: set[int] = set()
    live: list[int] = []
    before: Fitted | None = None
    astray = False
    if resumed is not None:
        values, fitted, slopes, first = dict(resumed.values), resumed.fitted, resumed.slopes, resumed.first
        evidences, bounds, banned = dict(resumed.evidences), dict(resumed.bounds), set(resumed.banned)
        before, astray = resumed.before, resumed.astray
    for turn in range(0 if resumed is None else resumed.turn, TURNS):
        if progress is not None:
            progress("search", turn, TURNS)
        rivals = []
        is_known = resumed is not None and turn == resumed.turn
        if fitted is None or not is_known:
            fitted = settled(space, values, fitted, floor, given=given)
            if before is not None and fitted.bound < before.bound - needed:
                # Slopes led to where a fit of its own does worse: stay, and trust them no more.
                fitted, values, astray = before, dict(before.values), True
        if slopes is None:
            slopes = slopes_of(space, fitted, effects, priors)
            slopes = _with_chords(space, fitted, effects, slopes)
            for _ in range(DENSE_TURNS):
                columns = gram_of(space, fitted, slopes, effects)
                fitted = noise_without(
                    space, fitted, slopes, columns.dense(priors.scales), floor, given=given
                )
        elif not is_known:
            slopes = slopes.copy()
            slopes[..., live] = slopes_of(space, fitted, [effects[one] for one in live], _part(priors, live))
        if checkpoint is not None and not is_known:
            state = dict(evidences), dict(bounds), tuple(sorted(banned)), before, astray
            checkpoint(Search(turn, dict(values), fitted, slopes, first, *state))
        columns = gram_of(space, fitted, slopes, effects)
        members = [places[name] for name in values if name in places]
        gram = _judged(columns, priors, members if turn else None)
        first = first or gram
        ranked = search(
            gram, priors, members, families=families, power=power, banned=sorted(banned), most=max_effects
        )
        predictive = partial(_predicted, columns, priors)
        # What does as well is an alias, and no reason to go elsewhere: slopes know least of what is far away.
        here = weigh(gram, priors, members, power=power)
        if astray:
            inside = (one for one in ranked.sets if set(one.members) < set(members))
            ranked = Ranked(tuple(sorted((here, *inside), key=lambda one: -one.evidence)))
        top = here if ranked.sets[0].evidence - here.evidence < needed else ranked.sets[0]
        # Where slopes went astray, fits of their own say what a member is worth.
        least = -np.inf if astray else needed
        best, worth = without_weak(top, gram, priors, least, power=power, predictive=predictive)
        found = {priors.names[one]: value_at(effects[one], at) for one, at in zip(best.members, best.values)}
        deviations = _deviations(gram, priors, best.members)
        # Where something hits, the bound and with it the values never rest: a set is done when it gains no more.
        stands = set(found) == set(values) and (
            fitted.bound < bounds.get(best.members, -np.inf) + STILL
            or all(
                abs(coordinate(effects[one], values[priors.names[one]]) - at) < STANDS_STILL * deviation
                for one, at, deviation in zip(best.members, best.values, deviations)
            )
        )
        if set(found) == set(values):
            bounds[best.members] = max(fitted.bound, bounds.get(best.members, -np.inf))
        if stands:
            refused = {one for one in best.members if is_held(effects[one], found[priors.names[one]])}
            refused |= _refused(space, fitted, effects, priors, best, worth, floor, given, needed, power)
            if not refused:
                rivals = _rivals(
                    space, fitted, effects, priors, (gram, first), best, evidences, floor, given, power
                )
                evidences |= {rival.members: rival.evidence for rival in rivals}
                evidences[best.members] = max(
                    evidences.get(best.members, -np.inf),
                    _evidence(space, fitted, effects, priors, best.members, power),
                )
                better = max(rivals, key=lambda rival: rival.evidence, default=None)
                if better is None or better.evidence < evidences[best.members] + TOLERANCE:
                    break
                found = dict(better.values)
            banned |= refused
            found = {name: value for name, value in found.items() if places[name] not in refused}
        before, astray = None if stands else fitted, astray and not stands
        values = found
        live = _live(ranked, gram, best)
        stands = False
    if fitted is not None and not stands:
        # The noise and what is left are those of the values at which the search was stopped.
        last = settled(space, values, fitted, floor, given=given)
        fitted = last if last.bound > fitted.bound - needed else fitted
    if fitted is None or first is None:
        raise RuntimeError("no relinearisation was made")
    # A search that was stopped may end at a bound, or with what was just refused.
    kept = [
        one
        for one in best.members
        if one not in banned
        and not is_held(effects[one], value_at(effects[one], float(best.values[best.members.index(one)])))
    ]
    found = {
        priors.names[one]: value_at(effects[one], float(at))
        for one, at in zip(best.members, best.values)
        if one in kept
    }
    probabilities = {name: ranked.probability(place) for place, name in enumerate(priors.names)}
    shares = _shares(rivals, evidences[best.members]) if rivals else {}
    for one, others in shares.items():
        name = priors.names[one]
        probabilities[name] = min(probabilities[name], 1 - sum(share for _, share in others))
    intervals = {
        priors.names[one]: (
            value_at(effects[one], at - WIDTH_95 * deviation),
            value_at(effects[one], at + WIDTH_95 * deviation),
        )
        for one, at, deviation in zip(best.members, best.values, deviations)
    }
    return Found(
        tuple(effects),
        found,
        intervals,
        {priors.names[one]: nats for one, nats in worth.items() if one in kept},
        _with_refitted(
            _aliases(ranked, gram, priors, best),
            {
                priors.names[one]: tuple((priors.names[other], share) for other, share in others)
                for one, others in shares.items()
            },
        ),
        probabilities,
        {} if astray else _also(gram, priors, effects, best, needed, families, banned, predictive),
        fitted,
        gram,
        priors,
        ranked,
        best,
        stands,
    )


def _refused(
    space: StateSpace,
    fitted: Fitted,
    effects: Sequence[Effect],
    priors: Priors,
    best: Weighed,
    worth: Mapping[int, float],
    floor: Array,
    given: Array | None,
    needed: float,
    power: float,
) -> set[int]:
    """Return the cause without which the others, at a noise and about a path of their own, do as well; or none.

    Slopes at one set say little of another that lies far away.
    """
    if not best.members:
        return set()
    whole = _evidence(space, fitted, effects, priors, best.members, power)
    for one in sorted(best.members, key=lambda member: worth[member])[:REFITTED]:
        rest = [other for other in best.members if other != one]
        start = weigh(
            _gram_at(space, fitted, effects, priors, best.members),
            _part(priors, best.members),
            [best.members.index(other) for other in rest],
        )
        alone = _refitted(space, fitted, effects, priors, rest, start.values, floor, given)
        if _evidence(space, alone, effects, priors, rest, power) + needed > whole:
            return {one}
    return set()


def _refitted(
    space: StateSpace,
    fitted: Fitted,
    effects: Sequence[Effect],
    priors: Priors,
    members: Sequence[int],
    start: Array,
    floor: Array,
    given: Array | None,
) -> Fitted:
    """Return the fit of a set about a path, at a noise and at values of its own."""
    places, alone, found = np.array(start, dtype=float), fitted, None
    chosen = [effects[one] for one in members]
    for _ in range(REFIT_TURNS):
        values = {effect.name: value_at(effect, at) for effect, at in zip(chosen, places)}
        alone = settled(space, values, alone, floor, given=given)
        if found is None or alone.bound > found.bound:
            found = alone
        if not members:
            break
        gram, own = _gram_at(space, alone, effects, priors, members), _part(priors, members)
        moved = weigh(gram, own, range(len(members)))
        deviations = np.sqrt(np.diag(np.linalg.inv(moved.curvature)))
        if np.all(np.abs(moved.values - places) < STANDS_STILL * deviations):
            break
        places = moved.values
    return alone if found is None else found


def _rivals(
    space: StateSpace,
    fitted: Fitted,
    effects: Sequence[Effect],
    priors: Priors,
    grams: Sequence[Gram],
    best: Weighed,
    evidences: Mapping[tuple[int, ...], float],
    floor: Array,
    given: Array | None,
    power: float,
) -> list[Rival]:
    """Return for each cause the sets, at fits of their own, in which an effect that acts much like it has its place.

    Slopes say that two effects act alike for small values; whether they do at this one, a fit must say. Some act alike
    only where neither is a cause yet: of two limits the lower one hides the other.
    """
    found: list[Rival] = []
    for cause in best.members[:REFITTED]:
        looks = np.stack([_cosines(gram, cause) for gram in grams])
        alike = looks.max(axis=0)
        alike[list(best.members)] = 0.0
        for other in np.argsort(-alike, kind="stable")[:RIVALS]:
            if alike[other] < ALIKE:
                break
            members = tuple(sorted({*best.members, int(other)} - {cause}))
            moved = weigh(grams[int(np.argmax(looks[:, other]))], priors, members)
            alone = _refitted(space, fitted, effects, priors, members, moved.values, floor, given)
            own = _evidence(space, alone, effects, priors, members, power)
            most = max(own, evidences.get(members, -np.inf))
            found.append(Rival(cause, int(other), members, most, dict(alone.values)))
    return found


def _shares(rivals: Sequence[Rival], evidence: float) -> dict[int, tuple[tuple[int, float], ...]]:
    """Return for each cause the rivals that do nearly as well as the set of this evidence, and their probabilities."""
    near = [rival for rival in rivals if rival.evidence > evidence - np.log(ALIAS_FACTOR)]
    shares = {}
    for cause in {rival.cause for rival in near}:
        own = [rival for rival in near if rival.cause == cause]
        odds = np.exp(np.minimum([rival.evidence - evidence for rival in own], 50.0))
        shares[cause] = tuple((rival.other, float(one / (1 + odds.sum()))) for rival, one in zip(own, odds))
    return shares


def _cosines(gram: Gram, one: int) -> Array:
    """Return the cosines of the angles between an effect's response and those of all."""
    sizes = np.sqrt(np.maximum(np.diag(gram.products), 1e-300))
    cosines: Array = np.abs(gram.products[one]) / (sizes[one] * sizes)
    return cosines


def _with_refitted(
    aliases: dict[str, tuple[tuple[str, float], ...]], refitted: dict[str, tuple[tuple[str, float], ...]]
) -> dict[str, tuple[tuple[str, float], ...]]:
    """Return aliases with those of fits of their own put before those of slopes."""
    both = {}
    for cause, names in aliases.items():
        own = refitted.get(cause, ())
        both[cause] = (*own, *(one for one in names if one[0] not in {name for name, _ in own}))
    return both


def _gram_at(
    space: StateSpace, fitted: Fitted, effects: Sequence[Effect], priors: Priors, members: Sequence[int]
) -> Gram:
    chosen = [effects[one] for one in members]
    return gram_of(space, fitted, slopes_of(space, fitted, chosen, _part(priors, members)), chosen).gram


def _evidence(
    space: StateSpace,
    fitted: Fitted,
    effects: Sequence[Effect],
    priors: Priors,
    members: Sequence[int],
    power: float,
) -> float:
    """Return the log evidence of a set at a fit of its own, beside what all sets have in common."""
    if not members:
        return power * fitted.bound
    gram = _gram_at(space, fitted, effects, priors, members)
    one = weigh(gram, _part(priors, members), range(len(members)), power=power)
    b, G, origin = gram.at_neutral, gram.products, gram.origin
    there = float(b @ origin - 0.5 * origin @ G @ origin)
    return power * (fitted.bound - there) + one.evidence


def _readable(space: StateSpace, effects: Sequence[Effect]) -> list[Effect]:
    seen = space.mask.any(axis=(0, 1))
    unread = {name for name, there in zip(space.simulator.residual_names, np.atleast_1d(seen)) if not there}
    return [effect for effect in effects if effect.family not in SENSORS or effect.target not in unread]


def _typical_biases(space: StateSpace, effects: Sequence[Effect]) -> dict[str, float]:
    """Return typical biases of channels whose unit says nothing of their size: a share of what they read."""
    spreads = dict(zip(space.simulator.residual_names, space.spread))
    return {
        effect.name: BIAS_SHARE * float(spreads[effect.target])
        for effect in effects
        if effect.family == "bias" and effect.unit not in KNOWN_UNITS and effect.target in spreads
    }


def _families(effects: Sequence[Effect]) -> dict[str, list[int]]:
    """Return the members of each family, without what stands for all of them."""
    families = defaultdict(list)
    for place, effect in enumerate(effects):
        if effect.target is not None and effect.target != EVERY.get(effect.family, "all"):
            families[effect.family].append(place)
    return dict(families)


def _part(priors: Priors, chosen: Sequence[int]) -> Priors:
    index = list(chosen)
    return Priors(
        tuple(priors.names[one] for one in index),
        priors.scales[index],
        priors.log_odds[index],
        priors.low[index],
        priors.high[index],
    )


def _judged(columns: Columns, priors: Priors, members: Sequence[int] | None) -> Gram:
    """Return the Gram matrices of a fit, scores trusted as far as blocks of time agree on them.

    What acts is the set found last; before any was, what all effects together explain.
    """
    moves = columns.dense(priors.scales)
    if members is not None:
        moves = np.zeros(len(moves))
        if members:
            best = weigh(columns.gram, priors, members)
            moves[list(best.members)] = best.values - columns.gram.origin[list(best.members)]
    return columns.gram.scattered(columns.excess(columns.whitened - columns.columns @ moves))


def _predicted(columns: Columns, priors: Priors, members: Sequence[int]) -> float:
    """Return what a set gains in each block with the values that the others have, in all."""
    if not len(members):
        return 0.0
    chosen = list(members)
    gained = columns.predictive(chosen, priors.scales[chosen], priors.low[chosen], priors.high[chosen])
    return float(gained.sum())


def _with_chords(space: StateSpace, fitted: Fitted, effects: Sequence[Effect], slopes: Array) -> Array:
    """Return the slopes, those that say nothing of what lies further off as the chord to where most is explained.

    What a delay does has a kink at every time step: the ends of its chords are the whole ones. What has no slope at
    all, such as a limit that is never reached, may have one further off: their ends divide the way to each bound.
    """
    slopes = slopes.copy()
    dead = ~np.any(slopes, axis=(0, 1))
    for place, effect in enumerate(effects):
        if effect.name in fitted.values:
            continue
        ends = _ends_of_chords(space.simulator, effect, bool(dead[place]))
        if not len(ends):
            continue
        grid = np.array([coordinate(effect, float(end)) for end in ends])
        chords = np.concatenate(
            [
                derivatives(space, fitted.linear, fitted.values, {effect.name: (effect.neutral, float(end))})
                * ((end - effect.neutral) / at)
                for end, at in zip(ends, grid)
            ],
            axis=-1,
        )
        columns = gram_of(space, fitted, chords, [effect] * len(grid))
        b, G = columns.gram.projections, np.diag(columns.gram.products)
        slopes[..., place] = chords[..., int(np.argmax(b * grid - 0.5 * G * grid**2))]
    return slopes


def _ends_of_chords(simulator: Simulator, effect: Effect, dead: bool) -> Array:
    """Return the values to which chords of an effect are drawn; none where its slope will do."""
    if effect.family == "delay" and simulator.dt:
        step = simulator.dt / int(getattr(simulator, "frame_skip", 1))
        return np.asarray(step * np.arange(1.0, int(effect.bounds[1] / step + 1e-9) + 1), dtype=np.float64)
    if not dead:
        return np.zeros(0)
    shares = np.arange(1, CHORDS + 1) / CHORDS
    low, high = (shares * coordinate(effect, bound) for bound in effect.bounds)
    ends: Array = np.array([value_at(effect, place) for place in (*low, *high) if place], dtype=np.float64)
    return ends


def _deviations(gram: Gram, priors: Priors, members: Sequence[int]) -> Array:
    if not members:
        return np.zeros(0)
    return np.sqrt(np.diag(np.linalg.inv(weigh(gram, priors, members).curvature)))


def is_held(effect: Effect, value: float) -> bool:
    """Whether an estimate lies at a bound that is not neutral."""
    low, high = (coordinate(effect, bound) for bound in effect.bounds)
    place, width = coordinate(effect, value), AT_BOUND * (high - low)
    return (place > high - width and high > 0) or (place < low + width and low < 0)


def _live(ranked: Ranked, gram: Gram, best: Weighed) -> list[int]:
    """Return the effects that may still be causes: those of likely sets, and what is like them."""
    top = ranked.sets[0].evidence
    live = dict.fromkeys(best.members)
    for one in ranked.sets:
        if len(live) >= LIVE + len(best.members) or one.evidence < top - 1000 * ALIAS_FACTOR:
            break
        live.update(dict.fromkeys(one.members))
    return list(live)


def _aliases(
    ranked: Ranked, gram: Gram, priors: Priors, best: Weighed
) -> dict[str, tuple[tuple[str, float], ...]]:
    """Return for each cause the effects that stand in its place in sets nearly as likely."""
    sizes = np.sqrt(np.maximum(np.diag(gram.products), 1e-300))
    found: dict[int, dict[int, float]] = {one: defaultdict(float) for one in best.members}
    for share, one in zip(ranked.probabilities, ranked.sets):
        if one.evidence < best.evidence - np.log(ALIAS_FACTOR):
            break
        others = [other for other in one.members if other not in best.members]
        for cause in set(best.members) - set(one.members):
            if others:
                alike = np.abs(gram.products[cause, others]) / (sizes[cause] * sizes[others])
                found[cause][others[int(np.argmax(alike))]] += float(share)
    return {
        priors.names[cause]: tuple(
            (priors.names[other], share)
            for other, share in sorted(shares.items(), key=lambda one: (-round(one[1], 6), one[0]))
        )
        for cause, shares in found.items()
    }


def _also(
    gram: Gram,
    priors: Priors,
    effects: Sequence[Effect],
    best: Weighed,
    needed: float,
    families: Mapping[str, Sequence[int]],
    banned: set[int],
    predictive: Callable[[Sequence[int]], float],
) -> dict[str, float]:
    """Return what the log shows beside the causes if the model is taken for exact."""
    ranked = search(gram, priors, best.members, families=families, banned=sorted(banned))
    exact, _ = without_weak(ranked.sets[0], gram, priors, needed, predictive=predictive)
    return {
        priors.names[one]: value_at(effects[one], at)
        for one, at in zip(exact.members, exact.values)
        if one not in best.members and not is_held(effects[one], value_at(effects[one], at))
    }


__all__ = ["Found", "Search", "find_causes"]
