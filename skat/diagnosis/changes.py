r"""What changed between two logs of one machine, whatever its model gets wrong in both.

The regression in force space of both logs is stacked: columns of what is common to them, and of what only the second
has. Common errors, all effects at once, are a nuisance that their priors hold; with the normal laws of their posterior
they are integrated out of the Gram matrix, and of the differences sparse sets are searched by evidence:

.. math:: G = G_{dd} - G_{dc} (G_{cc} + W)^{-1} G_{cd}, \qquad b = b_d - G_{dc} (G_{cc} + W)^{-1} b_c.

A weight is one finding: a mass at a place on a body.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skat.diagnosis.evidence import Gram, Priors, Weighed
from skat.diagnosis.filtering import Array
from skat.diagnosis.force_space import (
    ALIAS_ODDS,
    WIDTH_95,
    Motion,
    Rows,
    all_explained,
    force_priors,
    missing_force,
    noise_of,
    rivals_of,
    rows_at,
    seen_effects,
    smooth_motion,
    transformed,
    unbiased_squares,
    visible,
)
from skat.diagnosis.set_search import Weigher, alternatives, search_sets, without_weak
from skat.effects import Effect
from skat.simulators import MujocoSimulator, Simulator

Log = tuple[Array, Array, Array]
# Places along each side of a body at which a weight is tried.
PLACES = 3
# Searches, each with the noise that the one before leaves.
TURNS = 3
# Families that a machine does not change from one log to another.
FIXED = ("gravity", "tilt", "length", "timestep", "wind", "air_drag", "position_friction", "inertia")


@dataclass(frozen=True)
class Change:
    """Something in which two logs of one machine differ.

    Attributes
    ----------
    name : str
        Of the effect.
    value : float
        By how much it is more in the second log, in the effect's unit; of factors, 1 and the difference in units of
        the model's own value.
    interval : tuple of two floats
        95 %.
    unit : str
    worth : float
        Nats that the evidence loses without it.
    probability : float
        Against its aliases and against no such change.
    aliases : tuple of (str, float)
        What could be said in its place, and how probable that is.
    place : tuple of three floats or None
        Of a weight, in the body's frame, m.
    """

    name: str
    value: float
    interval: tuple[float, float]
    unit: str
    worth: float
    probability: float
    aliases: tuple[tuple[str, float], ...] = ()
    place: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Changes:
    """What changed between two logs.

    Attributes
    ----------
    changes : tuple of Change
        Most telling first.
    verdict : {"nothing changed", "named", "ambiguous"}
    gain : dict of str to tuple of two floats
        Of each degree of freedom, by the name of its speed: rms of the second log's force that the common model leaves,
        and of what is left with the changes in it; N or N m.
    common : dict of str to float
        Rms of the force that the model as it is lacks in both logs, likewise.
    """

    changes: tuple[Change, ...]
    verdict: str
    gain: dict[str, tuple[float, float]]
    common: dict[str, float]


@dataclass(frozen=True)
class _Candidate:
    """A difference that is searched for: an effect, or a weight at a place."""

    effect: Effect
    values: Mapping[str, float]
    place: tuple[float, float, float] | None = None


def find_changes(
    simulator: Simulator,
    before: Log,
    after: Log,
    effects: Sequence[Effect],
    *,
    typical: Mapping[str, float] | None = None,
    alpha: float = 0.01,
) -> Changes:
    """Return in what two logs of one machine differ.

    Parameters
    ----------
    simulator : Simulator
    before, after : tuple of (X, y, groups)
        As `force_space.first_look` takes them.
    effects : sequence of Effect
        That may be wrong in the model or may have changed; weights on bodies are tried beside them.
    typical : mapping from name to size, optional
        Scales of the priors of a user's own.
    alpha : float, default=0.01
        A change is named if the odds for the set with it are 1 / alpha times those of the set without.

    Returns
    -------
    Changes

    Raises
    ------
    ValueError
        If the simulator is not one of joints, or contacts push all the time in one of the logs.
    """
    if not isinstance(simulator, MujocoSimulator):
        raise ValueError(
            "changes are searched for in the forces on joints: the simulator must be a MujocoSimulator; it is "
            f"{simulator!r}"
        )
    motions = []
    for name, log in (("before", before), ("after", after)):
        motion = smooth_motion(simulator, *log)
        if motion is None:
            raise ValueError(
                f"no stretch of the log {name!r} is free of contacts and long enough, or a coordinate has no reading; "
                "record the machine moving freely"
            )
        motions.append(motion)
    offered = seen_effects([effect for effect in effects if effect.family != "payload"])
    parts = [rows_at(simulator, motion, {}, offered) for motion in motions]
    seen = np.flatnonzero(visible(parts[0]) | visible(parts[1]))
    offered = [offered[place] for place in seen]
    parts = [replace(part, columns=part.columns[:, seen]) for part in parts]
    priors = force_priors(offered, typical)
    stacked = _stacked(parts)
    noise, common = all_explained(stacked, priors, np.zeros(len(offered)))
    candidates = [_Candidate(effect, {}) for effect in offered if effect.family not in FIXED]
    weights = weights_on(simulator)
    candidates += weights
    n_before = len(parts[0].target)
    own = [place for place, effect in enumerate(offered) if effect.family not in FIXED]
    extra = _weight_columns(simulator, motions[1], weights, parts[1].target)
    columns = np.zeros((len(stacked.target), len(candidates)))
    columns[n_before:] = np.column_stack([parts[1].columns[:, own], extra])
    laws = _laws(candidates, offered, priors)
    rivals = _rivals(candidates)
    nuisance = 2 / (priors.scales**2 + common**2)
    origin = np.zeros(len(candidates))
    target, neutral = stacked.target, stacked
    for turn in range(TURNS):
        gram = _without_nuisance(target, stacked.columns, columns, noise, nuisance, origin)
        best, worth = search_sets(gram, laws, {}, rivals=rivals)
        best, nats = without_weak(best, worth, -np.log(alpha))
        best, nats = _without_cancelling(best, worth, nats, -np.log(alpha))
        if turn == TURNS - 1:
            break
        moved = np.zeros(len(candidates))
        moved[list(best.members)] = best.values
        if best.members:
            stacked, columns, origin = _relinearised(
                simulator, motions[1], candidates, offered, best, moved, stacked, columns, n_before
            )
            target = stacked.target
        whole = np.concatenate([stacked.columns, columns[:, list(best.members)]], axis=1)
        step = (moved - origin)[list(best.members)]
        noise = _noise_beside(stacked, target, whole, step, noise, nuisance)
    found = candidates, best, worth, nats
    return _told(simulator, *found, neutral, stacked, columns, origin, noise, nuisance, n_before, motions)


def weights_on(simulator: MujocoSimulator) -> list[_Candidate]:
    """Return weights at places on each body."""
    found = []
    for effect in simulator.all_effects():
        if effect.family == "payload" and effect.unit == "kg":
            for place in simulator.payload_places(str(effect.target), per_axis=PLACES):
                values = {f"payload[{effect.target}.{axis}]": float(one) for axis, one in zip("xyz", place)}
                found.append(_Candidate(effect, values, tuple(map(float, place))))  # type: ignore[arg-type]
    return found


def _weight_columns(
    simulator: MujocoSimulator, motion: Motion, weights: Sequence[_Candidate], target: Array
) -> Array:
    if not weights:
        return np.zeros((len(target), 0))
    steps = np.array([0.05 * one.effect.typical for one in weights])
    values = [{**one.values, one.effect.name: step} for one, step in zip(weights, steps)]
    forces = missing_force(simulator, motion, [{}, *values])
    differences = (forces[0] - forces[1:]) / steps[:, None, None]
    return transformed(motion, differences.transpose(1, 2, 0))[0]


def _stacked(parts: Sequence[Rows]) -> Rows:
    # Both logs have one noise: with one each, a fit may give one of them up.
    return Rows(
        np.concatenate([part.target for part in parts]),
        np.concatenate([part.columns for part in parts]),
        np.concatenate([part.joint for part in parts]),
        np.concatenate([part.frequency for part in parts]),
        np.concatenate([part.nominal for part in parts]),
    )


def _laws(candidates: Sequence[_Candidate], offered: Sequence[Effect], priors: Priors) -> Priors:
    """Return the priors of differences: those of the effects; a weight may be at any of its places."""
    known = {effect.name: place for place, effect in enumerate(offered)}
    n_places = PLACES**3
    odds = np.array([one.effect.odds / (n_places if one.place else 1) for one in candidates])
    scales = np.array(
        [
            priors.scales[known[one.effect.name]] if one.effect.name in known else one.effect.typical
            for one in candidates
        ]
    )
    high = np.array([one.effect.bounds[1] - one.effect.neutral for one in candidates])
    # What is taken off again is a change, too.
    low = np.array(
        [
            max(one.effect.bounds[0] - one.effect.neutral, -0.8) if one.effect.neutral == 1 else -high[place]
            for place, one in enumerate(candidates)
        ]
    )
    return Priors(
        tuple(one.effect.name for one in candidates), scales, np.log(odds / (odds.sum() + 1)), low, high
    )


def _rivals(candidates: Sequence[_Candidate]) -> dict[int, list[int]]:
    """Return which candidates exclude each other: weights on one body, all of a family and each of it."""
    rivals = rivals_of([one.effect for one in candidates])
    by_body: dict[str, list[int]] = {}
    for place, one in enumerate(candidates):
        if one.place:
            by_body.setdefault(one.effect.name, []).append(place)
    for places in by_body.values():
        for place in places:
            rivals.setdefault(place, []).extend(other for other in places if other != place)
    return rivals


def _without_nuisance(
    target: Array, common: Array, columns: Array, noise: Array, weights: Array, origin: Array
) -> Gram:
    """Return the Gram matrix of differences with what is common integrated out."""
    z, C, D = target / noise, common / noise[:, None], columns / noise[:, None]
    held = C.T @ C + np.diag(weights)
    unit = 1 / np.sqrt(np.diag(held))
    solved = np.linalg.solve(held * unit * unit[:, None], (C * unit).T @ np.column_stack([D, z]))
    cross = (D.T @ C) * unit
    return Gram(D.T @ D - cross @ solved[:, :-1], D.T @ z - cross @ solved[:, -1], origin)


def _relinearised(
    simulator: MujocoSimulator,
    motion: Motion,
    candidates: Sequence[_Candidate],
    offered: Sequence[Effect],
    best: Weighed,
    moved: Array,
    stacked: Rows,
    columns: Array,
    n_before: int,
) -> tuple[Rows, Array, Array]:
    """Return the rows of the second log about the changes that were found, and what was moved there.

    What is common acts there through the factors that changed: friction is measured in units of a motor that is
    stronger now. Its columns are otherwise those of the first log, so that both feel it alike. Less of something than
    the model has stays as it is, linear.
    """
    values: dict[str, float] = {}
    origin = np.zeros(len(moved))
    for place in best.members:
        one = candidates[place]
        value = moved[place] + one.effect.neutral
        if one.effect.bounds[0] <= value <= one.effect.bounds[1]:
            values |= {**one.values, one.effect.name: float(value)}
            origin[place] = moved[place]
    factors = {name: value for name, value in values.items() if _neutral_value(candidates, name) == 1}
    known = {effect.name: place for place, effect in enumerate(offered)}
    changed = [place for place in best.members if candidates[place].effect.name in known and origin[place]]
    rows = rows_at(simulator, motion, values, [candidates[place].effect for place in changed])
    target, common, columns = stacked.target.copy(), stacked.columns.copy(), columns.copy()
    target[n_before:], columns[n_before:, changed] = rows.target, rows.columns
    if factors:
        common[n_before:] = rows_at(simulator, motion, factors, offered).columns
    return replace(stacked, target=target, columns=common), columns, origin


def _neutral_value(candidates: Sequence[_Candidate], name: str) -> float:
    """Return the neutral value of an effect; of a weight's place, none."""
    return next((one.effect.neutral for one in candidates if one.effect.name == name), np.nan)


def _noise_beside(
    stacked: Rows, target: Array, whole: Array, step: Array, noise: Array, weights: Array
) -> Array:
    """Return the noise that common effects and the changes leave."""
    k = stacked.columns.shape[1]
    rows = replace(stacked, target=target, columns=whole)
    z, N = rows.whitened(noise)
    curvature = N.T @ N + np.diag(np.r_[weights, np.full(whole.shape[1] - k, 1e-12)])
    right = N[:, :k].T @ (z - N[:, k:] @ step)
    unit = 1 / np.sqrt(np.diag(curvature)[:k])
    common = unit * np.linalg.solve(curvature[:k, :k] * unit * unit[:, None], unit * right)
    return noise_of(rows, unbiased_squares(rows, np.r_[common, step], noise, curvature))


def _without_cancelling(
    best: Weighed, worth: Weigher, nats: dict[int, float], needed: float
) -> tuple[Weighed, dict[int, float]]:
    """Return the set without pairs whose members are worth much beside each other and little together."""
    while True:
        own = worth.chosen(best)
        pairs = [(one, other) for place, one in enumerate(own) for other in own[place + 1 :]]
        rests = [worth([left for left in own if left not in pair]) for pair in pairs]
        weak = [rest for rest in rests if best.evidence - rest.evidence < 2 * needed]
        if not weak:
            return best, nats
        best, nats = without_weak(max(weak, key=lambda one: one.evidence), worth, needed)


def _told(
    simulator: MujocoSimulator,
    candidates: Sequence[_Candidate],
    best: Weighed,
    worth: Weigher,
    nats: Mapping[int, float],
    neutral: Rows,
    stacked: Rows,
    columns: Array,
    origin: Array,
    noise: Array,
    weights: Array,
    n_before: int,
    motions: Sequence[Motion],
) -> Changes:
    errors = np.sqrt(np.maximum(np.diag(np.linalg.inv(best.curvature)), 0.0)) if best.members else np.zeros(0)
    others = alternatives(best, worth, np.log(ALIAS_ODDS))
    changes = []
    for place, value, error in zip(best.members, best.values, errors):
        one = candidates[place]
        aliases: dict[str, float] = {}
        for other, lost in others[place]:
            name = candidates[other].effect.name
            if name != one.effect.name:
                aliases[name] = aliases.get(name, 0.0) + float(np.exp(-lost))
        total = 1 + sum(aliases.values()) + float(np.exp(-nats[place]))
        centre = float(value) + (one.effect.neutral if one.effect.neutral == 1 else 0.0)
        changes.append(
            Change(
                one.effect.name,
                centre,
                (centre - WIDTH_95 * float(error), centre + WIDTH_95 * float(error)),
                one.effect.unit,
                float(nats[place]),
                1 / total,
                tuple(
                    (name, share / total)
                    for name, share in sorted(aliases.items(), key=lambda pair: -pair[1])
                ),
                one.place,
            )
        )
    changes.sort(key=lambda change: -change.worth)
    moved = np.zeros(len(candidates))
    moved[list(best.members)] = best.values
    left = []
    for rows, step in ((neutral, np.zeros(len(candidates))), (stacked, moved - origin)):
        base = rows.target - columns @ step
        z, C = base / noise, rows.columns / noise[:, None]
        held = C.T @ C + np.diag(weights)
        unit = 1 / np.sqrt(np.diag(held))
        common = unit * np.linalg.solve(held * unit * unit[:, None], unit * (C.T @ z))
        left.append(base - rows.columns @ common)
    names = simulator.residual_names[len(simulator.residual_names) // 2 :]
    nv, second = len(names), np.arange(len(stacked.target)) >= n_before
    size = [
        [
            float(np.sqrt(np.sum(one[second & (stacked.joint == joint)] ** 2) / len(motions[1].states)))
            for joint in range(nv)
        ]
        for one in left
    ]
    n_blocks = sum(len(motion.states) for motion in motions)
    lacking = [
        float(np.sqrt(np.sum(neutral.target[stacked.joint == joint] ** 2) / n_blocks)) for joint in range(nv)
    ]
    verdict = "nothing changed" if not changes else "named"
    if any(change.aliases for change in changes):
        verdict = "ambiguous"
    return Changes(tuple(changes), verdict, dict(zip(names, zip(*size))), dict(zip(names, lacking)))
