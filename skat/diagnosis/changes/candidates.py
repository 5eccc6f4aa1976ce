"""What may have changed: effects, weights at places on bodies, later commands; how likely it is, and by how much."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from skat.diagnosis import search
from skat.diagnosis.chains import Array
from skat.diagnosis.evidence import Priors
from skat.diagnosis.forces.machines import MOTORS, UNSEEN, WEAKEST, Candidate, Model
from skat.effects import Effect
from skat.simulators import MujocoSimulator

# Families that a machine does not change from one log to another, and those that forces do not show.
FIXED = ("gravity", "tilt", "length", "wind", "air_drag", "position_friction", "inertia")
# Least factor of what motors exert: the other way they turn by a sign.
NEARLY_TURNED = -0.5
# Places along each side of a body at which a weight is tried; those that act alike are one: by the cosine between
# what they exert, and by how much the larger may exert more.
PLACES, ALIKE, AS_MUCH = 3, 0.9995, 0.1
# Of what the largest candidate exerts, over the noise: below, there is rounding.
FAINTEST = 1e-6
# Rows by which commands may come later, or earlier, in the second log.
LATER = (0.5, 1.0, 2.0, 3.0, 4.0)


def units_of(candidates: Sequence[Candidate], machine: Model) -> Array:
    """Return in which units of their effects differences are told: of a factor, what it is in both logs; (n,)."""
    return np.array(
        [machine.values.get(one.effect.name, 1.0) if one.is_factor else 1.0 for one in candidates]
    )


def offered_candidates(
    simulator: MujocoSimulator,
    effects: Sequence[Effect],
    common: Sequence[Effect],
    sizes: Array,
    typical: Mapping[str, float],
) -> tuple[list[Candidate], Array]:
    """Return what may have changed, and the typical size of each.

    Parameters
    ----------
    simulator : MujocoSimulator
    effects : sequence of Effect
        All that a user asks about.
    common : sequence of Effect
        Those of single targets that the logs show.
    sizes : ndarray of shape (n_common,)
        Typical sizes of these, each in its effect's unit.
    typical : mapping from name to size
        Of a user's own, which hold as they are.

    Returns
    -------
    candidates : list of Candidate
    scales : ndarray of shape (n_candidates,)
        Each in its effect's unit.
    """
    seen = [effect for effect in effects if effect.family not in UNSEEN]
    names = {effect.name for effect in common}
    offered = [
        Candidate(effect, effect.odds, {})
        for effect in seen
        if effect.family not in (*FIXED, "delay") and (effect.name in names or effect.target == "all")
    ]
    offered += _weights(simulator)
    offered += [
        Candidate(effect, effect.odds / (2 * len(LATER)), {}, late)
        for effect in effects
        if effect.name == "delay[action]"
        for late in (*LATER, *(-one for one in LATER))
    ]
    known = dict(zip([effect.name for effect in common], sizes))
    for effect in seen:
        if effect.target == "all" and effect.force_share is not None and effect.name not in typical:
            own = [size for one, size in zip(common, sizes) if one.family == effect.family]
            known[effect.name] = max(own, default=effect.typical)
    scales = np.array(
        [known.get(one.effect.name, typical.get(one.effect.name, one.effect.typical)) for one in offered]
    )
    return offered, scales


def _weights(simulator: MujocoSimulator) -> list[Candidate]:
    """Return weights at places on each body."""
    found = []
    for effect in simulator.all_effects():
        if effect.family == "payload" and effect.unit == "kg":
            places = simulator.payload_places(str(effect.target), per_axis=PLACES)
            for place in places:
                at = {f"payload[{effect.target}.{axis}]": float(one) for axis, one in zip("xyz", place)}
                found.append(Candidate(effect, effect.odds / len(places), at))
    return found


def distinct(offered: Sequence[Candidate], whitened: Array) -> tuple[list[Candidate], list[int]]:
    """Return candidates that can be seen, of one effect those that act differently, and their places among all.

    ``whitened`` (n_rows, n_candidates) holds what typical sizes exert, over the noise. Of those that act alike one has
    the odds of all.
    """
    sizes = np.linalg.norm(whitened, axis=0)
    kept: list[int] = []
    odds = [one.odds for one in offered]
    for place, one in enumerate(offered):
        if sizes[place] < FAINTEST * sizes.max():
            continue
        twins = [
            other
            for other in kept
            if offered[other].effect is one.effect
            and not one.late
            and whitened[:, other] @ whitened[:, place] > ALIKE * sizes[other] * sizes[place]
            and abs(sizes[other] / sizes[place] - 1) < AS_MUCH
        ]
        if twins:
            odds[twins[0]] += one.odds
        else:
            kept.append(place)
    return [replace(offered[place], odds=odds[place]) for place in kept], kept


def rivals_of(candidates: Sequence[Candidate]) -> dict[int, list[int]]:
    """Return places of candidates that exclude that of each: of one effect, all of a family and each of it."""
    rivals = search.rivals_of([one.effect for one in candidates])
    for place, one in enumerate(candidates):
        same = [other for other, two in enumerate(candidates) if two.effect is one.effect and other != place]
        rivals.setdefault(place, []).extend(same)
    return rivals


def priors_of(candidates: Sequence[Candidate], scales: Array, dt: float) -> Priors:
    """Return the priors of differences, those of the effects; what is taken off again is a change, too.

    Parameters
    ----------
    candidates : sequence of Candidate
    scales : ndarray of shape (n_candidates,)
        Typical sizes, each in its effect's unit: the units of values and bounds of the priors.
    dt : float
        Of a row, s.
    """
    odds = np.array([one.odds for one in candidates])
    high = np.array([one.effect.bounds[1] - one.effect.neutral for one in candidates])
    low = np.array(
        [
            max(one.effect.bounds[0], NEARLY_TURNED if one.effect.family in MOTORS else WEAKEST) - 1
            if one.is_factor
            else -most
            for one, most in zip(candidates, high)
        ]
    )
    # A chord is a delay at its end alone: a mean of commands of two times is none.
    nearest = dt * np.array([_between(one.late) if one.late else (0, 0) for one in candidates])
    late = np.array([bool(one.late) for one in candidates])
    low, high = np.where(late, nearest[:, 0], low), np.where(late, nearest[:, 1], high)
    names = tuple(one.effect.name for one in candidates)
    return Priors(names, np.ones(len(names)), np.log(odds / (odds.sum() + 1)), low / scales, high / scales)


def _between(late: float) -> tuple[float, float]:
    """Return between how many rows commands are late for which a grid has one value."""
    ends = (0.0, *(0.5 * (one + other) for one, other in itertools.pairwise(LATER)), LATER[-1] + 0.5)
    place = LATER.index(abs(late))
    low, high = sorted(np.sign(late) * np.array(ends[place : place + 2]))
    return float(low), float(high)
