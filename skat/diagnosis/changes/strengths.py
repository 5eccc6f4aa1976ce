r"""Sets of changes, weighed where logs may differ though nothing changed, by as much as makes both logs most likely.

Of a model that is not right, two logs differ by more than noise: by what its misfit looks like in the one motion and in
the other. A change is in one effect; where there is misfit on a joint, all effects on it differ a little. By how much,
a strength for each joint, is told by all of them together, anew for each set of changes: variance components, as the
heterogeneity of studies [1]_, over which the marginal likelihood is summed.

References
----------
.. [1] Higgins, Thompson, Spiegelhalter (2009). A re-evaluation of random-effects meta-analysis. J. R. Stat. Soc. A 172.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from skat.diagnosis.changes.law import Law
from skat.diagnosis.changes.windows import Quadratic
from skat.diagnosis.evidence import RANK, Gram, Priors, SwiftWeigher, Weighed
from skat.diagnosis.filtering import Array
from skat.diagnosis.search import search_sets

# Of the variance of an effect's difference, over that if all misfit looked like it: places on a grid. No misfit exerts
# more than all of itself; logs that differ by more do so by a change.
STRENGTHS, BEYOND = np.power(8.0, np.arange(-10, 1), dtype=float), np.power(8.0, np.arange(1, 5), dtype=float)
# Of strengths, nats: so unlikely ones count for nothing, and where a smaller one changes so little none does.
UNLIKELY, FLAT = -12.0, 1e-3
# Precision of an effect that no joint feels, in typical sizes.
LEAST = 1e-6

Places = tuple[int, ...]


def prior(places: Places) -> float:
    """Return the log of how likely strengths are beside each other, at most: joints of a machine are about alike."""
    return -float(np.sum(np.abs(np.array(places) - np.median(places))))


def log_sum(gains: Array) -> float:
    """Return the log of a likelihood summed over strengths of all joints, each told for itself.

    Parameters
    ----------
    gains : ndarray of shape (n_joints, n_places)
        Log likelihood of each joint at each place, nats.

    Returns
    -------
    float
        Over levels of all joints, each as likely, and steps of each joint from it, which end where the grid does, but
        for a constant.
    """
    n = gains.shape[1]
    steps = np.arange(1 - n, n)
    at = np.clip(np.arange(n)[:, None] + steps, 0, n - 1)
    return float(logsumexp(logsumexp(gains[:, at] - np.abs(steps), axis=2).sum(axis=0)))


@dataclass(frozen=True)
class Logs:
    """Both logs as quadratics in effects, the second with candidates behind them, and the law of what is common.

    Attributes
    ----------
    first, second : Quadratic
        In (n_effects,) and (n_effects + n_candidates,) values, in units of typical sizes.
    law : Law
    firsts, seconds : tuple of Quadratic
        The windows of each, one of which may be left out.
    strengths : ndarray of shape (n_places,)
        By which joints may differ.
    """

    first: Quadratic
    second: Quadratic
    law: Law
    firsts: tuple[Quadratic, ...] = ()
    seconds: tuple[Quadratic, ...] = ()
    strengths: Array = field(default_factory=lambda: STRENGTHS)

    def both(self, places: Places) -> Quadratic:
        """Return both logs where they differ by strengths at such places of the grid, one for each joint."""
        # Of an effect that several joints feel misfit would have to look alike on each.
        apart = self.second.integrated((1 / self.strengths[list(places)]) @ self.law.alike + LEAST)
        return self.first.widened(len(apart.projections)) + apart

    def left(self, places: Places) -> Quadratic:
        """Return the same in candidates alone, with what is common integrated out."""
        return self.both(places).integrated(self.law.weights).without(len(self.law.weights))

    def climbed(self, start: Places, worth: Callable[[Places], float]) -> Places:
        """Return places from which no step of one joint's makes a worth larger."""
        now, best = start, worth(start)
        moved = True
        while moved:
            moved = False
            for joint in range(len(start)):
                for step in (-1, 1):
                    while 0 <= now[joint] + step < len(self.strengths):
                        tried = (*now[:joint], now[joint] + step, *now[joint + 1 :])
                        if (value := worth(tried)) <= best:
                            break
                        now, best, moved = tried, value, True
        return now

    def shortened(self) -> Iterator["Logs"]:
        """Yield both logs without each of their windows."""
        for one in self.firsts:
            yield replace(self, first=self.first - one)
        for one in self.seconds:
            yield replace(self, second=self.second - one)

    def alike(self) -> list[Places]:
        """Return the places where joints are all alike."""
        return [(place,) * len(self.law.alike) for place in range(len(self.strengths))]

    def level(self) -> float:
        """Return the log density of both logs if nothing changed, nats."""

        def worth(places: Places) -> float:
            return self.left(places).level + prior(places)

        best = self.climbed(max(self.alike(), key=worth), worth)
        return worth(best) + self.room(best, worth)

    def room(self, places: Places, worth: Callable[[Places], float]) -> float:
        """Return the log of what a worth is at all strengths, summed, over what it is at some.

        As if each joint told its strength for itself. Logs that are alike at all small strengths are so at many.
        """
        here = worth(places) - prior(places)
        gains = np.full((len(places), len(self.strengths)), -np.inf)
        for joint, start in enumerate(places):
            gains[joint, start] = 0.0
            for ahead in (range(start - 1, -1, -1), range(start + 1, len(self.strengths))):
                last = 0.0
                for place in ahead:
                    moved = (*places[:joint], place, *places[joint + 1 :])
                    gains[joint, place] = worth(moved) - prior(moved) - here
                    if gains[joint, place] < UNLIKELY:
                        break
                    if place < start and abs(gains[joint, place] - last) < FLAT:
                        # Smaller ones are as if there were none.
                        gains[joint, :place] = gains[joint, place]
                        break
                    last = gains[joint, place]
        return log_sum(gains) - prior(places)

    def differ_beyond_misfit(self, needed: float) -> bool:
        """Return whether logs are likelier by so many nats if they may differ by more than all misfit exerts.

        Whichever window of either is left out.
        """

        def gain(logs: Logs) -> float:
            return replace(logs, strengths=np.r_[STRENGTHS, BEYOND]).level() - logs.level()

        return all(gain(logs) > needed for logs in itertools.chain([self], self.shortened()))


class OverStrengths(SwiftWeigher):
    """Weighs sets, each at the strengths at which it is worth most.

    Parameters
    ----------
    logs : Logs
    priors : Priors
    rivals : mapping from place to places
        As `Weigher`'s.
    """

    def __init__(self, logs: Logs, priors: Priors, rivals: Mapping[int, Sequence[int]]):
        self.logs = logs
        # What was tried on a climb, and of it where sets were searched: only there others are weighed.
        self._tried: dict[Places, tuple[SwiftWeigher, float]] = {}
        self._at: dict[Places, tuple[SwiftWeigher, float]] = {}
        # Of each set for which strengths were climbed to, the log of how many strengths are about as likely; and the
        # largest of them.
        self._rooms: dict[tuple[int, ...], float] = {}
        self._most_room = 0.0
        nothing = Gram(np.zeros((0, 0)), np.zeros(0), np.zeros(0))
        super().__init__(nothing, priors, rivals)
        best = -np.inf
        for places in sorted(logs.alike(), key=lambda places: -self._worth(places, ())):
            # Where all candidates together explain too little no set does.
            if self._most(places) > best:
                self._search(places, ())
                best = max(
                    best, *(one.evidence + self._at[places][1] for one in self._at[places][0].seen.values())
                )

    def settled(self, members: Sequence[int]) -> Weighed:
        """Return what a set is worth at all strengths, after the best were climbed to for it."""
        key = tuple(sorted(set(members)))
        if key not in self._rooms:
            start = max(self._at, key=lambda places: self._worth(places, key))
            places = self.logs.climbed(start, lambda places: self._worth(places, key))
            self._search(places, key)
            room = self.logs.room(self.best_places(key), lambda places: self._worth(places, key))
            self._most_room = max(room, self._most_room) if self._rooms else room
            self._rooms[key] = room
            self.seen.clear()
        return self(key)

    def _room_of(self, members: tuple[int, ...]) -> float:
        # Where strengths were not climbed to it may be as much as of any set.
        return self._rooms.get(members, self._most_room)

    def is_settled(self, members: Sequence[int]) -> bool:
        """Return whether strengths were climbed to for a set."""
        return tuple(sorted(set(members))) in self._rooms

    def best_places(self, members: Sequence[int]) -> Places:
        """Return the strengths, as places on the grid, at which a set is worth most."""
        key = tuple(sorted(set(members)))
        return max(self._at, key=lambda places: self._worth(places, key))

    def losses(self, whole: Weighed) -> dict[int, float]:
        """Return what each member of a set is worth, nats, whichever window of either log is left out."""
        found = super().losses(whole)
        rests = {one: tuple(sorted(set(whole.members) - {one})) for one in found}
        places = {own: self.best_places(own) for own in (whole.members, *rests.values())}
        for logs in self.logs.shortened() if found else ():
            at = {one: self._weigher_of(logs, one) for one in set(places.values())}
            for one, loss in found.items():
                # Without the window strengths may be those of the other set.
                sets = whole.members, rests[one]
                worths = [at[places[own]] for own in sets]
                ours, theirs = (
                    max(worth(own).evidence + level for worth, level in worths) + self._room_of(own)
                    for own in sets
                )
                found[one] = min(loss, ours - theirs)
        return found

    def _weigher_of(self, logs: Logs, places: Places) -> tuple[SwiftWeigher, float]:
        left = logs.left(places)
        gram = Gram(left.products, left.projections, np.zeros(len(left.projections)))
        return SwiftWeigher(gram, self.priors, self.rivals), left.level + prior(places)

    def _weigher(self, places: Places) -> tuple[SwiftWeigher, float]:
        if places not in self._tried:
            self._tried[places] = self._weigher_of(self.logs, places)
        return self._tried[places]

    def _worth(self, places: Places, members: tuple[int, ...]) -> float:
        worth, level = self._weigher(places)
        return worth(members).evidence + level

    def _most(self, places: Places) -> float:
        """Return what no set is worth more than, but for its prior: what all candidates explain without bounds."""
        worth, level = self._weigher(places)
        values, axes = np.linalg.eigh(worth.gram.products)
        told = values > RANK * max(float(values[-1]), 1e-300)
        return level + 0.5 * float(np.sum((worth.gram.projections @ axes[:, told]) ** 2 / values[told]))

    def _search(self, places: Places, start: Sequence[int]) -> None:
        """Find the likeliest sets at some strengths."""
        worth, _ = self._at[places] = self._weigher(places)
        self.seen.clear()
        search_sets(worth, start)

    def best(self, needed: float) -> Weighed:
        """Return the set that is worth most, where of any two that with more names must be worth so much more, nats."""
        found = [
            (one.evidence + level + self._room_of(members) - needed * len(members), members)
            for worth, level in self._at.values()
            for members, one in worth.seen.items()
        ]
        return self(max(found)[1])

    def _weighed(self, members: tuple[int, ...]) -> Weighed:
        worth, level = self._at[self.best_places(members)]
        found = worth(members)
        return replace(found, evidence=found.evidence + level + self._room_of(members))

    def promises(self, now: Weighed) -> Array:
        """Return by how much each further effect would raise the log posterior odds, about; -inf of members."""
        # At those strengths at which it would then be worth most.
        whole = [
            level + (ours := worth(now.members)).evidence + worth.promises(ours)
            for worth, level in self._at.values()
        ]
        return np.asarray(np.max(whole, axis=0) + self._most_room - now.evidence)

    def price(self, members: Sequence[int]) -> float:
        """Return by how much what a set is worth is less than what it explains, nats."""
        one = self._at[self.best_places(members)][0](members)
        return one.likelihood - one.evidence
