"""The causes that a log asks for: fit, search, fit anew, until the set stands still."""

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from skat.diagnosis.chains import Array
from skat.diagnosis.evidence import Gram, Priors, Weighed, Weigher, coarsened, weigh
from skat.diagnosis.fits import Fit, Fits
from skat.diagnosis.fitting import (
    NOTHING_KNOWN,
    STILL,
    Columns,
    Fitted,
    Known,
    acting_together,
    bent_rows,
    coordinate,
    doubled,
    gram_of,
    noise_without,
    priors_of,
    slopes_of,
    time_step,
    value_at,
)
from skat.diagnosis.found import LEAST_SHARE, Found, Rival, also_seen, exchanged, is_held, stand_ins, told
from skat.diagnosis.noise import TOLERANCE
from skat.diagnosis.remainder import beside_laws
from skat.diagnosis.search import (
    ALIAS_FACTOR,
    EXCHANGED,
    Ranked,
    families_of,
    rivals_of,
    search,
    without_weak,
)
from skat.diagnosis.slopes import derivatives
from skat.diagnosis.statespace import Linear, StateSpace
from skat.effects import Effect
from skat.simulators.base import Simulator

# Families that act on what a sensor reads, and so on nothing where it was not read.
SENSORS = ("bias", "scale", "lag")
# Biases have a typical size in these units; elsewhere it is a share of a channel's spread.
KNOWN_UNITS = ("rad", "m", "rad/s", "m/s")
BIAS_SHARE = 0.03
# Moves from a set to a better one, or to better values; so many for a first look.
TURNS, QUICK_TURNS = 16, 3
# How often noise and what all effects explain are taken in turns, before any is a cause.
DENSE_TURNS = 2
# Effects whose slopes are taken anew with the causes in, of those that promise most.
LIVE = 24
# The weakest causes, so many, must be missed by a fit of their own of the others, and their rivals' too.
REFITTED = 3
# What acts only beyond some place has no slope, or one that says little of what it does further off.
THRESHOLDS = ("backlash", "torque_speed", "dry_friction")
# A chord is drawn to no place where slopes have the log less likely by more than so many nats.
DENIED = 30.0
# Effects whose responses make a smaller angle than this cosine may be the same: so many are fitted in a cause's place.
ALIKE, RIVALS = 0.8, 3


class Comparison:
    """Sets of causes beside the present one, with the slopes of its fit; and of theirs, before one is taken.

    With the same slopes a set costs a simulation of each row.

    Parameters
    ----------
    fits : Fits
    now : Fit
        The present set.
    look : Fit, optional
        Whose slopes are taken; those of the present set, if None.
    """

    def __init__(self, fits: Fits, now: Fit, look: Fit | None = None) -> None:
        self.fits, self.now = fits, now
        self._look = now if look is None else look
        self._fits: dict[tuple[int, ...], Fit] = {}
        self._turned: dict[tuple[int, ...], float] = {}
        self._refused: dict[tuple[int, ...], float] = {}

    def fit(self, members: Sequence[int], places: Array) -> Fit:
        """Return the fit of a set with these slopes, from values that may be near at first."""
        members = tuple(members)
        if members not in self._fits:
            guessed = members not in (self.now.members, self._look.members)
            self._fits[members] = self.fits.of(members, places, self._look, own_slopes=False, guessed=guessed)
        return self._fits[members]

    def gain(self, members: Sequence[int], places: Array) -> float:
        """Return by how much a set is likelier than the present one, nats."""
        present = self.fit(self.now.members, self.fits.places(self.now))
        return self.fit(members, places).evidence - present.evidence

    def gains(self, members: Sequence[int], places: Array) -> tuple[float, float]:
        """Return the same by the slopes of the present set and by its own, as it is.

        Where rows are bent either favour their own set; elsewhere they are the same. Of a set far behind one is enough.
        """
        gain = self.gain(members, places)
        if gain < -EXCHANGED or not self.fits.bends(self.now):
            return gain, gain
        other = self.fit(members, places)
        if other.members not in self._turned:
            look = self.fits.about(other.members, self.fits.places(other), self.now)
            own = Comparison(self.fits, self.now, look)
            self._turned[other.members] = own.gain(look.members, self.fits.places(look))
        return gain, self._turned[other.members]

    def rivals(self) -> list[Rival]:
        """Return the sets that were fitted beside the present one, small ones first.

        By their slopes, too, unless they would be as good as impossible though these liked them as well; and no
        likelier than a fit of its own found one that was not taken.
        """
        found = []
        for members in sorted((one for one in self._fits if one != self.now.members), key=len):
            places = self.fits.places(self._fits[members])
            gain = self.gain(members, places)
            if gain > 2 * np.log(LEAST_SHARE):
                gain = float(np.mean(self.gains(members, places)))
            found.append(Rival(members, places, min(gain, self._refused.get(members, np.inf))))
        return found

    def near(self, other: Fit, within: float) -> dict[tuple[int, ...], Array]:
        """Return the sets that were fitted and are as likely as another one but for so many nats: their coordinates."""
        least = self._fits[other.members].evidence - within if other.members in self._fits else np.inf
        return {
            members: self.fits.places(fit)
            for members, fit in self._fits.items()
            if fit.evidence > least and members != other.members
        }

    def prefers(self, members: Sequence[int], places: Array, needed: float) -> bool:
        """Whether a set is to be preferred to the present one: by what more names need.

        Fewer are if the slopes of one of both say so.
        """
        fewer = len(members) < len(self.now.members)
        gain = max(self.gains(members, places)) if fewer else self.gain(members, places)
        return self._is_better(members, gain, needed)

    def taken(self, members: Sequence[int], places: Array, needed: float) -> Fit | None:
        """Return the fit of a set with slopes of its own, if it is preferred.

        What more names are worth must be so with the slopes of both; fewer are preferred if those of one say so. Nor
        may fits with slopes of their own differ the other way.
        """
        near = self.fit(members, places)
        moved = self.fits.of(near.members, self.fits.places(near), self.now)
        own = Comparison(self.fits, self.now, moved).gain(moved.members, self.fits.places(moved))
        gains = self.gain(members, places), own
        fewer = len(moved.members) < len(self.now.members)
        apart = moved.evidence - self.now.evidence
        gain = min((max if fewer else min)(gains), apart)
        if self._is_better(moved.members, gain, needed):
            return moved
        self._refused[moved.members] = float(gain)
        return None

    def _is_better(self, members: Sequence[int], gain: float, needed: float) -> bool:
        more = len(members) - len(self.now.members)
        return gain > needed * more + (TOLERANCE if more >= 0 else 0.0)


@dataclass(frozen=True)
class Search:
    """How far a search has come: what it goes on from behind a relinearisation.

    Attributes
    ----------
    turn : int
        Of this relinearisation.
    now : Fit
        The best so far.
    dense : Fitted or None
        The same, at the noise that is left when all effects act; None once that has proposed what it can.
    slopes : ndarray of shape (n_rows, d, k)
        At `now`, of those effects that may still be causes.
    first : Gram or None
        Of the first turn; None in it.
    banned : tuple of int
        Effects that were held at a bound.
    near : mapping from members to coordinates
        Sets that fits found nearly as likely as those that were preferred to them.
    """

    turn: int
    now: Fit
    dense: Fitted | None
    slopes: Array
    first: Gram | None
    banned: tuple[int, ...]
    near: Mapping[tuple[int, ...], Array] = field(default_factory=dict)


def find_causes(
    space: StateSpace,
    effects: Sequence[Effect],
    *,
    alpha: float = 0.01,
    typical: Mapping[str, float] | None = None,
    known: Known = NOTHING_KNOWN,
    max_effects: int | None = None,
    turns: int = TURNS,
    coarse: bool = False,
    start: Mapping[str, float] | None = None,
    look: Linear | None = None,
    resumed: Search | None = None,
    checkpoint: Callable[[Search], None] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Found:
    """Search for the set of causes that a log asks for.

    Gram matrices propose sets, at no cost; a fit of its own, about a path and at a noise of its own, decides. Slopes
    that mislead, as they may where something hits, cost a fit and no more.

    Parameters
    ----------
    space : StateSpace
    effects : sequence of Effect
        That may be causes; those of sensors that were not read are left out.
    alpha : float, default=0.01
        A cause is named if the odds for the set with it are 1 / alpha times those of the set without it.
    typical : mapping from name to size, optional
        Scales of the priors of a user's own.
    known : Known, optional
        Of the sensors' noise.
    max_effects : int, optional
        Most causes at a time.
    turns : int, default=16
        Moves from a set to another at most; the search that makes them all has not come to rest.
    coarse : bool, default=False
        Whether noise is estimated no finer than a path, and slopes alone tell what a cause is worth beside the others
        and from what acts much like it; otherwise fits without it, and of the other in its place, do.
    start : mapping from name to value, optional
        What missing forces ask for, from where the search goes on if the log prefers it to nothing.
    look : Linear, optional
        Slopes to begin with; see `nominal_look`.
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
    effects = readable(space, effects)
    priors = priors_of(effects, {**typical_biases(space, effects), **(typical or {})})
    power = coarsened(len(space.X))
    needed = -float(np.log(alpha))
    known = replace(known, tolerance=STILL) if coarse else known
    fits = Fits(space, tuple(effects), priors, known, power)
    state = _begun(fits, look) if resumed is None else resumed
    ask = partial(search, families=families_of(effects), most=max_effects)
    exclusive = rivals_of(effects)
    rivals: list[Rival] = []
    compared: Comparison | None = None
    stands = misled = False
    shown = -1
    while True:
        if state.turn != shown:
            shown = state.turn
            if checkpoint is not None and state is not resumed:
                checkpoint(state)
            if progress is not None:
                progress("search", state.turn, turns)
        now, banned = state.now, set(state.banned)
        columns = gram_of(fits.space, state.dense or now.fitted, state.slopes, effects)
        gram = _judged(columns, priors, now.members if state.dense is None else None)
        state = replace(state, first=state.first or gram)
        worth = Weigher(gram, priors, exclusive, power=power)
        ranked = ask(worth, now.members, banned=state.banned)
        if state.turn == turns:
            break
        moved = None
        misled = misled and state.dense is not None
        # What is noise changes which sets are proposed, not what a fit finds in them.
        compared = compared if compared is not None and compared.now is now else Comparison(fits, now)
        afar = state.turn == 0 and state.dense is not None
        if afar:
            moved = _first_guess(start or {}, fits, now, needed, max_effects)
            if moved is not None and not coarse:
                moved = _instead(moved, _likeliest(compared, worth, _singles(worth, banned), needed), needed)
            afar = moved is not None
        proposed = [] if afar else list(proposals(ranked, worth, now.members, needed))
        asked = [*proposed, *(_singles(worth, banned) if proposed else ())]
        if not proposed and state.dense is None and not coarse and ranked.sets[0].members != now.members:
            # At noise that holds what they would explain slopes promise too little.
            asked.append(ranked.sets[0])
        if asked:
            moved = _likeliest(compared, worth, asked, needed)
            misled = misled or (bool(proposed) and (moved is None or moved.members != asked[0].members))
        if moved is None and state.dense is not None:
            # What all effects together explain is noise again.
            state = replace(state, dense=None)
            continue
        if moved is None:
            held = {one for one in now.members if is_held(effects[one], now.values[priors.names[one]])}
            banned |= held
            if held:
                rest = _without(worth, now, held)
                moved = fits.of(rest.members, rest.values, now)
        if moved is None and not coarse:
            moved = (
                _as_one(compared, worth, exclusive)
                or _superfluous(compared, worth, needed)
                or _again(compared, state.near, banned, needed)
                or _in_place(compared, worth, state.first or gram, state.slopes, ranked, banned)
            )
        if moved is None:
            rivals = [] if coarse else compared.rivals()
            stands = True
            break
        # Far from where slopes were taken they say nothing.
        live = list(range(len(effects))) if afar else _live(ranked, moved.members)
        slopes = state.slopes.copy()
        slopes[..., live] = _slopes(fits, moved, live)
        near = {**state.near, **compared.near(moved, needed + np.log(ALIAS_FACTOR))}
        state = Search(state.turn + 1, moved, None, slopes, state.first, tuple(sorted(banned)), near)
    # Of a first look slopes alone tell; a search does not stand where fits and slopes differ on what is worth a name.
    firm = now if coarse else _without_doubtful(fits, now, worth, needed)
    stands = stands and firm is now
    slopes = state.slopes[..., list(now.members)] if firm is now else _slopes(fits, firm, firm.members)
    own = firm if coarse else _without_stand_ins(fits, firm, slopes, needed)
    dropped = set(now.members) - set(own.members)
    rivals = [one.without(dropped) for one in rivals if dropped <= set(one.members)]
    now, beside_a_law = own, own is not firm
    best = worth(now.members)
    if misled or beside_a_law:
        # What slopes say of other sets was seen to be wrong, or does not know of laws.
        ranked = _comparable(ranked, best, 0.0 if beside_a_law else needed)
    misled = misled or beside_a_law
    also = {} if misled else also_seen(ask, gram, priors, effects, exclusive, best, needed, state.banned)
    return told(fits, now, worth, ranked, rivals, also, needed, stands)


def _comparable(ranked: Ranked, best: Weighed, needed: float) -> Ranked:
    """Return a set with those that have less, and those that have more but not by what more names need."""

    def is_one(one: Weighed) -> bool:
        more = len(one.members) - len(best.members)
        if more < 0:
            return set(one.members) < set(best.members)
        return set(best.members) < set(one.members) and one.evidence < best.evidence + needed * more

    kept = (one for one in ranked.sets if is_one(one))
    return Ranked(tuple(sorted((best, *kept), key=lambda one: -one.evidence)))


def _begun(fits: Fits, look: Linear | None) -> Search:
    """Return the search at its first fit, with a noise from which what all effects explain is taken out."""
    space, effects, priors, now = fits.space, fits.effects, fits.priors, fits.first(look)
    slopes = _slopes(fits, now, range(len(effects)))
    dense = now.fitted
    for _ in range(DENSE_TURNS):
        columns = gram_of(space, dense, slopes, effects)
        moves = columns.dense(priors.scales)
        dense = noise_without(space, dense, slopes, moves, fits.known)
    if dense.estimate.noise.mixing is not None:
        now = fits.of((), np.zeros(0), replace(now, fitted=acting_together(now.fitted)))
    return Search(0, now, dense, slopes, None, ())


def _first_guess(
    start: Mapping[str, float], fits: Fits, now: Fit, needed: float, most: int | None
) -> Fit | None:
    """Return the fit of the set that missing forces ask for, if the log is likelier with it, as it is, than with none.

    Not of one with more causes than may be.

    It is far from where slopes were taken: what these propose is asked for from there. What passes for noise about the
    path of a model without it is none about its own.
    """
    members = [place for place, effect in enumerate(fits.effects) if effect.name in start]
    places = np.array([coordinate(fits.effects[one], start[fits.effects[one].name]) for one in members])
    if not members or (most is not None and len(members) > most):
        return None
    # What has the log likelier by so much as to be worth a start has it so by any slopes.
    if fits.bound(tuple(members), places, now) <= now.fitted.bound:
        return None
    about = fits.unweighed(members, places, now)
    if about.fitted.bound - needed * len(members) <= now.fitted.bound:
        return None
    return fits.of(members, places, about)


def _instead(guess: Fit, other: Fit | None, needed: float) -> Fit:
    """Return the likelier of what missing forces ask for and of another fit, by what more names need.

    Forces on a joint that hardly moves ask for little that is there.
    """
    better = other is not None and other.evidence - guess.evidence > needed * (
        len(other.members) - len(guess.members)
    )
    return other if other is not None and better else guess


def proposals(ranked: Ranked, worth: Weigher, members: tuple[int, ...], needed: float) -> Iterator[Weighed]:
    """Yield sets that slopes put before the present one: the best, and the best of half its size, and so on.

    Each without what is worth less than a name needs.
    """
    here = worth(members)
    asked = {members}
    most = len(worth.priors.names)
    while most:
        top = next((one for one in ranked.sets if len(one.members) <= most), here)
        top, _ = without_weak(top, worth, needed)
        most = len(top.members) // 2
        gain = top.evidence - here.evidence
        if top.members not in asked and gain > needed * (len(top.members) - len(here.members)) + TOLERANCE:
            yield top
        asked.add(top.members)


def _singles(worth: Weigher, banned: Container[int]) -> list[Weighed]:
    """Return the effects that slopes say explain most by themselves, a set each."""
    sets = [worth((one,)) for one in range(len(worth.priors.names)) if one not in banned]
    likely = sorted(sets, key=lambda one: -one.evidence)
    apart: list[Weighed] = []
    for one in likely:
        cosines = worth.gram.cosines(one.members[0])
        if len(apart) < REFITTED and all(cosines[other.members[0]] < ALIKE for other in apart):
            apart.append(one)
    return [*likely[:REFITTED], *(one for one in apart if one not in likely[:REFITTED])]


def _likeliest(compared: Comparison, worth: Weigher, asked: Sequence[Weighed], needed: float) -> Fit | None:
    """Return the fit of the set that the log likes best, of some that slopes put before the present one, if any is.

    Slopes that promise more of a set than the log finds in it promise too much of others, or too little: each is asked
    of which they promise more than the best was found to be worth.
    """
    now, here = compared.now, worth(compared.now.members).evidence
    found: dict[tuple[int, ...], tuple[float, Weighed]] = {}
    for one in asked:
        cost = needed * (len(one.members) - len(now.members))
        best = max((gain for gain, _ in found.values()), default=-np.inf)
        if one.members in found or one.evidence - here - cost <= best:
            continue
        if compared.prefers(one.members, one.values, needed):
            found[one.members] = compared.gain(one.members, one.values) - cost, one
    for _, one in sorted(found.values(), key=lambda pair: -pair[0]):
        moved = compared.taken(one.members, one.values, needed)
        if moved is not None:
            return moved
    return None


def _less(members: Sequence[int], dropped: Container[int]) -> tuple[int, ...]:
    return tuple(one for one in members if one not in dropped)


def _without(worth: Weigher, now: Fit, dropped: Sequence[int] | set[int]) -> Weighed:
    """Return the present set without some members, at the values that slopes have for the others."""
    return weigh(worth.gram, worth.priors, _less(now.members, dropped))


def _superfluous(compared: Comparison, worth: Weigher, needed: float) -> Fit | None:
    """Return the fit of the set without the member that the others hardly need, if there is one."""
    now = compared.now
    for one in _weakest(worth, now):
        rest = _without(worth, now, {one})
        if compared.prefers(rest.members, rest.values, needed):
            moved = compared.taken(rest.members, rest.values, needed)
            if moved is not None:
                return moved
    return None


def _as_one(compared: Comparison, worth: Weigher, exclusive: Mapping[int, Sequence[int]]) -> Fit | None:
    """Return the fit of the set with all of a family in the place of its members that are causes, if it is likelier."""
    now = set(compared.now.members)
    for every, family in exclusive.items():
        if len(now.intersection(family)) > 1:
            one = _all_of(compared, worth, sorted(now.intersection(family)), every)
            if compared.prefers(one.members, one.values, 0.0):
                moved = compared.taken(one.members, one.values, 0.0)
                if moved is not None:
                    return moved
    return None


def _all_of(compared: Comparison, worth: Weigher, some: Sequence[int], every: int) -> Weighed:
    """Return the set with all of a family in the place of some members, at the value that is nearest to theirs."""
    gram, now = worth.gram, compared.now
    places = dict(zip(now.members, compared.fits.places(now)))
    G = gram.products[np.ix_(some, some)]
    mean = G.sum(axis=0) @ [places[one] for one in some] / G.sum()
    members = tuple(sorted({*set(now.members).difference(some), every}))
    return replace(worth(members), values=np.array([places.get(one, mean) for one in members]))


def _weakest(worth: Weigher, now: Fit) -> list[int]:
    """Return the members of a set that slopes say are worth least."""
    losses = worth.losses(worth(now.members))
    return sorted(losses, key=lambda one: losses[one])[:REFITTED]


def _again(
    compared: Comparison, near: Mapping[tuple[int, ...], Array], banned: Container[int], needed: float
) -> Fit | None:
    """Return the fit of a set that was nearly as likely as one preferred to it, if it is to be preferred now."""
    for members, places in near.items():
        if members == compared.now.members or any(one in banned for one in members):
            continue
        if compared.prefers(members, places, needed):
            moved = compared.taken(members, places, needed)
            if moved is not None:
                return moved
    return None


def _in_place(
    compared: Comparison,
    worth: Weigher,
    first: Gram,
    slopes: Array,
    ranked: Ranked,
    banned: Container[int],
) -> Fit | None:
    """Return the fit of a set in which an effect that acts much like a cause has its place, if one does better.

    Slopes say that two effects act alike for small values; whether they do at this one, a fit must say. Some act alike
    only where neither is a cause yet: of two limits the lower one hides the other. And of what hits slopes tell effects
    apart that are the same in all other rows, as those of a weight over less than those of a push.
    """
    now = compared.now
    grams = worth.gram, first, _unbent(compared.fits, now, slopes)
    others_of = stand_ins(ranked, worth.gram, worth(now.members), worth.priors.names)
    for cause in _weakest(worth, now):
        looks = np.stack([gram.cosines(cause) for gram in grams])
        alike = looks.max(axis=0)
        alike[list(now.members)] = 0.0
        by_angle = [int(one) for one in np.argsort(-alike, kind="stable") if alike[one] >= ALIKE]
        for other in list(dict.fromkeys([*others_of[cause], *by_angle]))[:RIVALS]:
            members = exchanged(now.members, cause, other)
            if other in banned or not worth.allows(members):
                continue
            one = weigh(grams[int(np.argmax(looks[:, other]))], worth.priors, members)
            if (
                compared.prefers(members, one.values, 0.0)
                and (moved := compared.taken(one.members, one.values, 0.0)) is not None
            ):
                return moved
    return None


def _unbent(fits: Fits, now: Fit, slopes: Array) -> Gram:
    """Return the Gram matrices of a fit by those of its rows that are not bent."""
    straight = np.where(bent_rows(fits.space, now.fitted)[:, None, None], 0.0, slopes)
    return gram_of(fits.space, now.fitted, straight, fits.effects).gram


def _without_doubtful(fits: Fits, now: Fit, worth: Weigher, needed: float) -> Fit:
    """Return the fit of those members of a set that slopes, too, find worth a name: at values without the others."""
    strong, _ = without_weak(worth(now.members), worth, needed)
    return now if strong.members == now.members else fits.of(strong.members, strong.values, now)


def _without_stand_ins(fits: Fits, now: Fit, slopes: Array, needed: float) -> Fit:
    """Return the fit of those members of a set that are worth a name beside laws that are no effects.

    Their sizes are those of a fit without the laws: what either may be, a cause is.
    """
    while now.members:
        effects = [fits.effects[one] for one in now.members]
        columns, priors = gram_of(fits.space, now.fitted, slopes, effects), fits.priors.part(now.members)
        gram = beside_laws(fits.space, now.fitted, columns, needed)
        if gram is None:
            break
        worth = Weigher(gram, priors, power=fits.power)
        strong, _ = without_weak(worth(range(len(effects))), worth, needed)
        if len(strong.members) == len(effects):
            break
        now = fits.of([now.members[one] for one in strong.members], strong.values, now)
        slopes = _slopes(fits, now, now.members)
    return now


def readable(space: StateSpace, effects: Sequence[Effect]) -> list[Effect]:
    seen = space.mask.any(axis=(0, 1))
    unread = {name for name, there in zip(space.simulator.residual_names, np.atleast_1d(seen)) if not there}
    return [effect for effect in effects if effect.family not in SENSORS or effect.target not in unread]


def typical_biases(space: StateSpace, effects: Sequence[Effect]) -> dict[str, float]:
    """Return typical biases of channels whose unit says nothing of their size: a share of what they read."""
    spreads = dict(zip(space.simulator.residual_names, space.spread))
    return {
        effect.name: BIAS_SHARE * float(spreads[effect.target])
        for effect in effects
        if effect.family == "bias" and effect.unit not in KNOWN_UNITS and effect.target in spreads
    }


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


def _slopes(fits: Fits, now: Fit, members: Sequence[int]) -> Array:
    """Return the slopes by effects at a fit, of what is no cause there the chord to where most is explained, if any is.

    No more is known of such a value than what is typical in the log, and what lies as far off may be of another slope.
    What a delay does has a kink at every time step. What has no slope at all, such as a limit that is never reached,
    may have one further off.
    """
    space, fitted = fits.space, now.fitted
    chosen, priors = [fits.effects[one] for one in members], fits.priors.part(members)
    widths = dict(zip(now.members, now.widths))
    slopes = slopes_of(
        space, fitted, chosen, priors.scales, np.array([widths.get(one, 0.0) for one in members])
    )
    dead = ~np.any(slopes, axis=(0, 1))
    ends = {
        place: _ends_of_chords(space.simulator, effect, float(priors.scales[place]), bool(dead[place]))
        for place, effect in enumerate(chosen)
        if effect.name not in fitted.values
    }
    # A slope is taken at its word, but where a delay has none; a chord holds as far as its end.
    found = _Promised.of(fits, fitted, slopes, chosen)
    gains = found.gains(priors.low, priors.high)
    # Where a slope says so of one side, nothing is looked for on the other.
    for place, own in ends.items():
        way = float(found.projections[place])
        towards = [end for end in own if (end - chosen[place].neutral) * way > 0]
        if towards and not dead[place] and chosen[place].family not in THRESHOLDS:
            ends[place] = towards
    late = [place for place, effect in enumerate(chosen) if effect.family == "delay"]
    gains[late] = -np.inf
    # Of what is further off slopes of rows that are bent know nothing.
    bent = bool(bent_rows(space, fitted).any())
    while places := [place for place, own in ends.items() if own]:
        reached = {place: ends[place].pop(0) for place in places}
        at = np.array([coordinate(chosen[place], reached[place]) for place in places])
        # Nor is it where the log would lose too much, as far as slopes know; those of a delay know of one step.
        asked = np.isin(places, late) | (found.gained(places, at) > -DENIED) | bent
        places, at = [place for place, one in zip(places, asked) if one], at[asked]
        if not places:
            continue
        some = [chosen[place] for place in places]
        steps = {effect.name: (effect.neutral, reached[place]) for effect, place in zip(some, places)}
        chords = derivatives(space, fitted.linear, fitted.values, steps)
        chords *= [(steps[effect.name][1] - effect.neutral) / one for effect, one in zip(some, at)]
        gained = _Promised.of(fits, fitted, chords, some).gains(np.minimum(at, 0), np.maximum(at, 0))
        better = gained > gains[places]
        chosen_places = np.array(places)[better]
        slopes[..., chosen_places] = chords[..., better]
        gains[chosen_places] = gained[better]
        # What does nothing at such a distance does nothing nearer by.
        for place, one, idle in zip(places, at, ~np.any(chords, axis=(0, 1))):
            if dead[place] and idle:
                ends[place] = [end for end in ends[place] if coordinate(chosen[place], end) * one < 0]
    return slopes


@dataclass(frozen=True)
class _Promised:
    """What slopes by each of some effects alone say of the log, (k,).

    Attributes
    ----------
    projections, products : ndarray of shape (k,)
        Diagonals of `Gram`'s.
    """

    projections: Array
    products: Array

    @staticmethod
    def of(fits: Fits, fitted: Fitted, slopes: Array, effects: Sequence[Effect]) -> "_Promised":
        """Return what slopes (n_rows, d, k) at a fit say."""
        gram = gram_of(fits.space, fitted, slopes, effects).gram
        return _Promised(gram.projections, np.diag(gram.products))

    def gained(self, places: Sequence[int], at: Array) -> Array:
        """Return what each of some effects would gain by a move, nats."""
        gained: Array = self.projections[places] * at - 0.5 * self.products[places] * at**2
        return gained

    def gains(self, low: Array, high: Array) -> Array:
        """Return the most that each would gain, within bounds."""
        at = np.clip(self.projections / np.maximum(self.products, 1e-300), low, high)
        return self.gained(range(len(at)), at)


def _ends_of_chords(simulator: Simulator, effect: Effect, typical: float, dead: bool) -> list[float]:
    """Return the values to which chords of an effect are drawn; of what has no slope from the furthest on."""
    if effect.family == "delay" and simulator.dt:
        step = time_step(simulator)
        return [step * row for row in range(1, int(effect.bounds[1] / step + 1e-9) + 1)]
    places = np.array([-typical, typical])
    if dead or effect.family in THRESHOLDS:
        bounds = [coordinate(effect, bound) for bound in effect.bounds]
        places = np.concatenate([doubled(typical / 2, bound) for bound in bounds])
    if dead:
        places = places[np.argsort(-np.abs(places))]
    ends = dict.fromkeys(value_at(effect, place) for place in places)
    return [end for end in ends if end != effect.neutral]


def _live(ranked: Ranked, members: Sequence[int]) -> list[int]:
    """Return the effects that may still be causes: those of likely sets, and what is like them."""
    top = ranked.sets[0].evidence
    live = dict.fromkeys(members)
    for one in ranked.sets:
        if len(live) >= LIVE + len(members) or one.evidence < top - 1000 * ALIAS_FACTOR:
            break
        live.update(dict.fromkeys(one.members))
    return list(live)


__all__ = ["QUICK_TURNS", "TURNS", "Search", "find_causes"]
