"""By how much what a simulation adds in a step changes with each effect: slopes of rows, as far as they are linear."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from skat.diagnosis.chains import Array, Mask
from skat.diagnosis.statespace import (
    BENT,
    OUTER,
    SMALL_FORCE,
    TIME_STEP,
    Forces,
    Linear,
    StateSpace,
    finite,
    is_bent,
    normal_points,
    roots_of,
    told_apart,
)
from skat.effects import is_inertial

# Values that the simulations of one block of derivatives return.
VALUES_AT_ONCE = 2e7
# Pairs of points over which the slope of a bent row is averaged, at most.
SLOPE_PAIRS = 8


def derivatives(
    space: StateSpace,
    linear: Linear,
    values: Mapping[str, float],
    steps: Mapping[str, tuple[float, float]],
    known: Array | None = None,
    wide: Mapping[str, tuple[float, float]] | None = None,
) -> Array:
    """Return the derivative of what the model adds in a step by each parameter, (n_rows, d, k).

    Parameters
    ----------
    space, linear, values
    steps : mapping from name to (low, high)
        For each effect, two values between which the slope is taken; one of them may be that in `values`.
    known : ndarray of shape (n_rows, d, d), optional
        Covariance of the states that rows start from: the slopes of rows that are bent are means over it.
    wide : mapping from name to (low, high), optional
        Between which values these are taken; as `steps` by default.
    """
    simulator, rows, base = space.simulator, space.rows(linear.path), linear.outputs
    if simulator.coarsely(values) != values and set(steps) != {TIME_STEP}:
        return _of_finer_steps(space, linear, values, steps, known, wide)
    neutral = {effect.name: effect.neutral for effect in simulator.effects(also="all")}
    safe = finite(base, linear.path[:, 1:][space.places])
    columns, forced = np.zeros((2, len(rows), space.d, len(steps)))
    names = list(steps)
    here = {name: values.get(name, neutral[name]) for name in names}
    # Both ends of each, and under known forces those with more and with less of them.
    ends_of_one = 6 if linear.forces.means.any() else 2
    together = max(1, int(VALUES_AT_ONCE // max(1, ends_of_one * base.size)))
    groups = told_apart(space, sorted(names, key=lambda name: here[name] not in steps[name]))
    for start in range(0, len(groups), together):
        part = groups[start : start + together]
        # One end of most slopes is where the effect is.
        moves = [
            {name: steps[name][end] for name in group if steps[name][end] != here[name]}
            for group in part
            for end in (0, 1)
        ]
        moved_values = [{**values, **moved} for moved in moves if moved]
        outputs = iter(space.simulated(rows, moved_values, linear.forces.means))
        reached = [next(outputs) if moved else base for moved in moves]
        heavier = [any(map(is_inertial, group)) for group in part for _ in (0, 1)]
        asked = [{**values, **moved} for moved, is_one in zip(moves, heavier) if moved and is_one]
        as_is, *exerted = (
            _exerted(space, rows, [values, *asked], linear.forces, safe) if any(heavier) else [forced[..., 0]]
        )
        others = iter(exerted)
        lasting = [next(others) if moved and is_one else as_is for moved, is_one in zip(moves, heavier)]
        for place, group in enumerate(part):
            for name in group:
                low, high = (
                    reached[2 * place + end] if name in moves[2 * place + end] else base for end in (0, 1)
                )
                changes = [simulator.residual(finite(high, safe), finite(low, safe))]
                if is_inertial(name):
                    more, less = (
                        lasting[2 * place + end] if name in moves[2 * place + end] else as_is
                        for end in (1, 0)
                    )
                    changes.append(more - less)
                bad = ~(np.isfinite(high).all(axis=1) & np.isfinite(low).all(axis=1))
                own, column = space.channels_of(name), names.index(name)
                width = steps[name][1] - steps[name][0]
                for slopes, change in zip((columns, forced), changes):
                    change[bad] = 0.0
                    slopes[:, own, column] = change[:, own] / width
    if known is not None and simulator.state_names:
        chains, places = linear.chains, space.places
        bent = is_bent(chains.transitions[places], linear.by_row.bends, known)
        for start in range(0, len(names) if bent.any() else 0, together):
            ends = {name: (wide or steps)[name] for name in names[start : start + together]}
            centres = columns[bent, :, start : start + together]
            columns[bent, :, start : start + together] = _mean_derivatives(
                space, rows, values, ends, known, bent, centres, linear.forces.means
            )
    # Of a heavier machine the lasting forces are those that do the same to it.
    columns -= forced
    columns[~linear.valid] = 0.0
    return columns


def _of_finer_steps(
    space: StateSpace,
    linear: Linear,
    values: Mapping[str, float],
    steps: Mapping[str, tuple[float, float]],
    known: Array | None,
    wide: Mapping[str, tuple[float, float]] | None,
) -> Array:
    """Return what `derivatives` does where a finer time step is a cause: by it as it is; see `Simulator.coarsely`."""
    wide, rough = wide or steps, space.simulator.coarsely(values)
    found: dict[str, Array] = {}
    (ends,) = space.simulated(space.rows(linear.path), [rough], linear.forces.means)
    there = values, linear, [name for name in steps if name == TIME_STEP]
    about = replace(linear, by_row=replace(linear.by_row, outputs=ends))
    elsewhere = rough, about, [name for name in steps if name != TIME_STEP]
    for at, about, names in (there, elsewhere):
        own, further = ({name: both[name] for name in names} for both in (steps, wide))
        if names:
            slopes = derivatives(space, about, at, own, known, further)
            found |= dict(zip(names, np.moveaxis(slopes, -1, 0)))
    return np.stack([found[name] for name in steps], axis=-1)


def _exerted(
    space: StateSpace, rows: Array, candidates: Sequence[Mapping[str, float]], forces: Forces, safe: Array
) -> list[Array]:
    """Return what the lasting forces that are known do to the ends of rows under each candidate, (n_rows, d).

    By what more and less of them would do, by as much as is not known of them.
    """
    known = forces.means
    if not known.any():
        return [np.zeros((len(rows), space.d)) for _ in candidates]
    largest = np.array([effect.bounds[1] for effect, _ in space.simulator.joint_forces()])
    sizes, unsure = (np.linalg.norm(one / largest, axis=1) for one in (known, forces.deviations))
    share = (OUTER * np.maximum(unsure, SMALL_FORCE) / np.maximum(sizes, SMALL_FORCE**2))[:, None]
    ends = [space.simulated(rows, candidates, (1 + sign * share) * known) for sign in (1, -1)]
    return [
        space.simulator.residual(finite(more, safe), finite(less, safe)) / (2 * share)
        for more, less in zip(*ends)
    ]


def _mean_derivatives(
    space: StateSpace,
    rows: Array,
    values: Mapping[str, float],
    ends: Mapping[str, tuple[float, float]],
    known: Array,
    bent: Mask,
    centres: Array,
    forces: Array,
) -> Array:
    """Return derivatives by k parameters in bent rows, means over what is not known of where they start.

    What bends a row seldom bends what an effect does there: pairs of points are added until the standard error of the
    mean, of them and of the derivative at the centre (n_bent, d, k), is a small share of it.
    """
    simulator, units = space.simulator, space.spread
    candidates = [{**values, name: end} for name, both in ends.items() for end in both]
    past = space.past(rows, candidates, forces).of(np.flatnonzero(bent))
    roots, rows = roots_of(known[bent], units, space.parts), rows[bent]
    # Of one turn of the axes so many points are as good as any.
    points = normal_points(space.d, SLOPE_PAIRS)[:, :SLOPE_PAIRS].T
    columns = np.empty_like(centres)
    for column, (first, last) in enumerate(ends.values()):
        pair = 2 * column, 2 * column + 1
        own, before = [candidates[one] for one in pair], past.under(pair)
        found = np.full((1 + len(points), *centres.shape[:2]), np.nan)
        found[0] = centres[:, :, column]
        unsure = np.arange(len(rows))
        for turn, point in enumerate(points, 1):
            offsets, copies = roots[unsure] @ point, np.tile(unsure, 2)
            displaced = simulator.displace(rows[copies], np.concatenate([offsets, -offsets]))
            low, high = simulator.predict_many(displaced, own, past=before.of(copies))
            fine = np.isfinite(low).all(axis=1) & np.isfinite(high).all(axis=1)
            slopes = found[0, copies]
            slopes[fine] = simulator.residual(high[fine], low[fine]) / (last - first)
            found[turn, unsure] = slopes.reshape(2, len(unsure), -1).mean(axis=0)
            until = found[: turn + 1, unsure] / units
            errors = until.var(axis=0, ddof=1) / (turn + 1)
            unsure = unsure[errors.sum(axis=1) > BENT**2 * np.sum(until.mean(axis=0) ** 2, axis=1)]
            if not len(unsure):
                break
        columns[:, :, column] = np.nanmean(found[1:], axis=0)
    return columns
