"""Sets of causes, searched on Gram matrices and relinearised until they stand still."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skat.diagnosis.filtering import Array
from skat.diagnosis.fitting import Fitted, gram_of, priors_of, settled
from skat.diagnosis.set_evidence import Gram, Priors, Weighed, weigh
from skat.diagnosis.statespace import StateSpace
from skat.effects import Effect

LARGEST_SET = 40
# Families that act on what a sensor reads, and so on nothing where it was not read.
SENSORS = ("bias", "scale", "lag")
# Relinearisations; a set that moves by less than this share of its standard errors stands still.
TURNS = 8
STANDS_STILL = 0.1
# Of a normal law within its 95 % interval.
WIDTH_95 = 1.96


@dataclass(frozen=True)
class Named:
    """The causes that a log asks for.

    Attributes
    ----------
    values : dict of str to float
    intervals : dict of str to tuple of two floats
        95 %, from the curvature of the log posterior.
    worth : dict of str to float
        What each cause is worth beside the others, nats: log posterior odds for the set with it against the best
        found without it.
    fitted : Fitted
        At these values, or at those of the last relinearisation.
    settled : bool
        Whether the search stands still.
    """

    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    worth: dict[str, float]
    fitted: Fitted
    settled: bool


def name_causes(
    space: StateSpace,
    effects: Sequence[Effect],
    *,
    alpha: float = 0.01,
    typical: Mapping[str, float] | None = None,
    floor: Array | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Named:
    """Search for the set of causes that a log asks for.

    Parameters
    ----------
    space : StateSpace
    effects : sequence of Effect
        That may be causes; those of sensors that were not read are left out.
    alpha : float, default=0.01
        A cause is named if the odds for the set with it are 1 / alpha times those of the best set without it.
    typical : mapping from name to size, optional
        Scales of the priors of a user's own.
    floor : ndarray of shape (d,), optional
        Least variance of each channel's noise, such as that of rounding.
    progress : callable, optional
        ``progress(stage, done, total)``.

    Returns
    -------
    Named
    """
    floor = np.zeros(space.d) if floor is None else floor
    unread = {
        name
        for name, seen in zip(space.simulator.residual_names, np.atleast_1d(space.mask.any(axis=(0, 1))))
        if not seen
    }
    effects = [effect for effect in effects if effect.family not in SENSORS or effect.target not in unread]
    priors = priors_of(effects, typical)
    needed = -np.log(alpha)
    values: dict[str, float] = {}
    fitted: Fitted | None = None
    stands = False
    for turn in range(TURNS):
        if progress is not None:
            progress("search", turn, TURNS)
        fitted = settled(space, values, fitted, floor)
        gram, _, _ = gram_of(space, fitted, effects, priors)
        start = [place for place, effect in enumerate(effects) if effect.name in values]
        best, worth = without_weak(search(gram, priors, start), gram, priors, needed)
        found = {
            priors.names[place]: float(np.clip(value + effects[place].neutral, *effects[place].bounds))
            for place, value in zip(best.members, best.values)
        }
        deviations = np.sqrt(np.diag(np.linalg.inv(best.curvature))) if best.members else np.zeros(0)
        errors = dict(zip(found, deviations))
        stands = set(found) == set(values) and all(
            abs(found[name] - values[name]) < STANDS_STILL * errors[name] for name in found
        )
        values = found
        if stands:
            break
    if fitted is None:
        raise RuntimeError("no relinearisation was made")
    intervals = {
        name: (value - WIDTH_95 * errors[name], value + WIDTH_95 * errors[name])
        for name, value in values.items()
    }
    named = {priors.names[place]: nats for place, nats in worth.items()}
    return Named(values, intervals, named, fitted, stands)


def without_weak(
    ranked: Sequence[Weighed], gram: Gram, priors: Priors, needed: float
) -> tuple[Weighed, dict[int, float]]:
    """Return the best set all of whose members are worth what a name needs, and what each is worth.

    A member is worth what the set loses when it is dropped, the best of like effects in its place included only where
    the search has tried it without the member.
    """
    best = ranked[0]
    while best.members:
        worth = {}
        for one in best.members:
            rest = weigh(gram, priors, [other for other in best.members if other != one])
            worth[one] = best.evidence - rest.evidence
        weakest = min(worth, key=lambda one: worth[one])
        if worth[weakest] >= needed:
            return best, worth
        best = weigh(gram, priors, [other for other in best.members if other != weakest])
    return best, {}


def search(gram: Gram, priors: Priors, start: Sequence[int] = (), power: float = 1.0) -> list[Weighed]:
    """Return sets of causes by what they are worth: adding, dropping and exchanging until nothing gains."""
    seen: dict[tuple[int, ...], Weighed] = {}

    def worth(members: Sequence[int]) -> Weighed:
        key = tuple(sorted(members))
        if key not in seen:
            seen[key] = weigh(gram, priors, key, power=power)
        return seen[key]

    k = len(priors.names)
    best = worth(())
    for first in ((), tuple(start)):
        now = worth(first)
        while True:
            members = now.members
            moves = (
                [(*members, one) for one in range(k) if one not in members]
                if len(members) < LARGEST_SET
                else []
            )
            moves += [tuple(set(members) - {one}) for one in members]
            moves += [
                (*(set(members) - {one}), other)
                for one in members
                for other in _alike(gram, one)
                if other not in members
            ]
            candidates = [worth(move) for move in moves]
            top = max(candidates, key=lambda one: one.evidence, default=now)
            if top.evidence <= now.evidence + 1e-9:
                break
            now = top
        best = max(best, now, key=lambda one: one.evidence)
    return sorted(seen.values(), key=lambda one: -one.evidence)


def _alike(gram: Gram, one: int, count: int = 8) -> NDArray[np.intp]:
    """Return the effects whose response is most like that of one."""
    sizes = np.sqrt(np.maximum(np.diag(gram.products), 1e-300))
    cosines = np.abs(gram.products[one]) / (sizes * sizes[one])
    return np.argsort(-cosines)[: count + 1]
