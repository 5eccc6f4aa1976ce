"""The motion of a log from positions alone, the forces that models lack for it, and what effects exert of them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skat.diagnosis.chains import Array
from skat.diagnosis.forces.force_space import Motion, Rows, smooth_motion, transformed
from skat.diagnosis.forces.machines import MOTORS, WEAKEST, Candidate, Model
from skat.effects import Effect
from skat.simulators import MujocoSimulator

# Rows (n_rows, n_inputs), what followed them (n_rows, n_outputs), and their episodes (n_rows,).
Log = tuple[Array, Array, NDArray[Any]]
# A log has so many windows, of so many seconds at most.
WINDOWS, LONGEST = 8, 2.0
# Of its typical size, over which the slope of an effect's force is taken.
STEP = 0.01
# An acceleration, rad/s^2 or m/s^2, beside whose force all friction is as nothing.
FAST = 1e8
# Of the force on a joint, that a typical size of an effect exerts at least if logs show it: below, there is rounding.
SHOWN = 1e-9


def motion_of(simulator: MujocoSimulator, log: Log, name: str, *, measured: bool = False) -> Motion:
    """Return the motion of a log, cut into windows.

    Parameters
    ----------
    simulator : MujocoSimulator
    log : tuple of (X, y, groups)
        NaN in states where nothing was measured.
    name : str
        Of the log, for errors.
    measured : bool, default=False
        Whether commands are efforts that were measured.

    Raises
    ------
    ValueError
        If the model has a free or a ball joint, a joint was not measured, or contacts push all the time.
    """
    X, y, groups = (np.asarray(one) for one in log)
    n_states, nv = len(simulator.state_names), len(simulator.residual_names) // 2
    if n_states != 2 * nv:
        raise ValueError(
            "forces are told on joints that turn or slide, and this model has a free or a ball joint, on which "
            "contacts push. If its base did not move, pass base='fixed'."
        )
    window = min(LONGEST, len(X) * simulator.dt / WINDOWS)
    motion = smooth_motion(simulator, X, y, groups, window=window, measured=measured)
    if motion is None:
        raise ValueError(
            f"no stretch of the log{' ' * bool(name)}{name} is free of contacts and long enough, or the position of a "
            "joint was not measured. Record the machine moving freely."
        )
    return motion


def driven(simulator: MujocoSimulator, half: Motion, model: Model) -> Motion:
    """Return a log with the accelerations that a model has in its states under its commands.

    What was measured holds noise, and what unknown forces did: it moves with what models lack, and a slope taken there
    would explain the one by the other. Of measured accelerations, what those of the model explain is theirs, as of an
    instrument [1]_. What they do not is noise as far as they explain the most, and else a model that is far off: of
    that as much is kept as they leave of the whole.

    References
    ----------
    .. [1] Janot, Vandanjon, Gautier (2014). A generic instrumental variable approach for industrial robot
       identification. IEEE Trans. Control Syst. Technol. 22(1).
    """
    nv, measured = len(half.slip), half.accelerations

    def lacking(accelerations: Array) -> Array:
        return lacking_forces(simulator, replace(half, accelerations=accelerations), [model])[0, :, :nv]

    missing = lacking(measured)
    inertia = np.stack([(lacking(measured + one) - missing) / FAST for one in FAST * np.eye(nv)], axis=2)
    own = measured - np.linalg.solve(inertia, missing[:, :, None])[:, :, 0]
    power, seen = np.sum(own**2, axis=0), np.sum(measured**2, axis=0)
    cross = np.maximum(np.sum(own * measured, axis=0), 0)
    explained = cross / np.maximum(power, 1e-300) * own
    unexplained = 1 - cross**2 / np.maximum(power * seen, 1e-300)
    return replace(half, accelerations=explained + unexplained * (measured - explained))


def rows_about(
    simulator: MujocoSimulator,
    half: Motion,
    base: Model,
    effects: Sequence[Effect],
    sizes: Array,
    *,
    machine: Model | None = None,
    driven_by: Model | None = None,
) -> Rows:
    """Return the rows of a log, with the columns of effects in units of their sizes.

    Parameters
    ----------
    simulator : MujocoSimulator
    half : Motion
    base : Model
        Which lacks the target.
    effects : sequence of Effect
        The columns: by how much typical sizes of them lessen what is lacking.
    sizes : ndarray of shape (n_effects,)
        Each in its effect's unit.
    machine : Model, optional
        About which both are linear; the base by default.
    driven_by : Model, optional
        By which the machine moves where slopes are taken; by default as it was measured.

    Returns
    -------
    Rows
        First forces, N or N m, of degrees of freedom 0 to nv - 1; those of nv and on are measured speeds, m/s or rad/s.
    """
    machine = machine or base
    candidates = [Candidate(effect, 1.0, {}, float(effect.family == "delay")) for effect in effects]
    lacking = lacking_forces(simulator, half, [machine, Model({})])
    columns = columns_of(simulator, half, machine, candidates, sizes, driven_by=driven_by)
    coefficients, joint, frequency, stretch = coefficients_of(half, lacking)
    target, nominal = coefficients.T
    away = [
        (machine.values.get(one.name, one.neutral) - base.values.get(one.name, one.neutral)) / size
        for one, size in zip(effects, sizes)
    ]
    return Rows(target + columns @ np.array(away), columns, joint, frequency, stretch, nominal)


def columns_of(
    simulator: MujocoSimulator,
    half: Motion,
    base: Model,
    candidates: Sequence[Candidate],
    scales: Array,
    *,
    driven_by: Model | None = None,
    share: float = STEP,
) -> Array:
    """Return the columns of candidates, in units of their scales, (n_rows, n_candidates): rows are `rows_about`'s.

    ``share`` of a scale is the step over which slopes are taken, about a base and as the machine moves by a model; by
    default as it was measured. What is lacking counts in units of what motors exert: else all of it would be explained
    by motors that do nothing and bodies that weigh nothing.
    """
    moved = half if driven_by is None else driven(simulator, half, driven_by)
    forces, steps = _steps(simulator, moved, base, candidates, scales, share)
    columns = (forces[0] - forces[1:]) / steps[:, None, None]
    nv = len(half.slip)
    left = lacking_forces(simulator, moved, [driven_by or base])[0, :, :nv]
    for column, one, scale in zip(columns[:, :, :nv], candidates, scales):
        if one.effect.family in MOTORS:
            gain = base.values.get(one.effect.name, 1.0)
            gain = np.copysign(max(abs(gain), WEAKEST), gain)
            column += np.any(column, axis=0) * left * scale / gain
    return coefficients_of(half, np.concatenate([forces[:1], columns]))[0][:, 1:]


def shares_of(rows: Rows) -> Array:
    """Return what a typical size of each effect exerts, over the force on the joint that feels it most."""
    joints = [rows.joint == joint for joint in np.unique(rows.joint)]
    exerted = np.array([np.sqrt(np.mean(rows.columns[own] ** 2, axis=0)) for own in joints])
    there = np.array([np.sqrt(np.mean(rows.nominal[own] ** 2)) for own in joints])
    return np.asarray(np.max(exerted / np.maximum(there, 1e-300)[:, None], axis=0))


def units_by(shares: Array, effects: Sequence[Effect], typical: Mapping[str, float]) -> Array:
    """Return by what to multiply typical sizes so that they are so of the forces in a log, (n_effects,).

    What is typical of a drive may be far from what acts in this log. ``shares`` are as from `shares_of`; sizes of a
    user's own, ``typical`` by name, hold as they are.
    """
    return np.array(
        [
            1.0
            if effect.name in typical or effect.force_share is None or share <= SHOWN
            else effect.force_share / share
            for effect, share in zip(effects, shares)
        ]
    )


def with_friction(
    simulator: MujocoSimulator,
    half: Motion,
    rows: Rows,
    effects: Sequence[Effect],
    sizes: Array,
    machine: Model | None = None,
) -> Rows:
    """Return rows about no dry friction with columns of what a typical size of it exerts: a slope tells another law.

    ``machine``, without dry friction, is the one that it would brake; the model as it is by default. The lighter what a
    joint moves, the softer is MuJoCo's friction there.
    """
    dry = [place for place, effect in enumerate(effects) if effect.family == "dry_friction"]
    if not dry:
        return rows
    columns = rows.columns.copy()
    candidates = [Candidate(effects[place], 1.0, {}) for place in dry]
    columns[:, dry] = columns_of(simulator, half, machine or Model({}), candidates, sizes[dry], share=1.0)
    return replace(rows, columns=columns)


def _steps(
    simulator: MujocoSimulator,
    half: Motion,
    base: Model,
    candidates: Sequence[Candidate],
    scales: Array,
    share: float = STEP,
) -> tuple[Array, Array]:
    """Return forces of a model, and with a step of each candidate; and the steps, in units of scales."""
    models, steps = [base], []
    for one, scale in zip(candidates, scales):
        step = one.late * simulator.dt if one.late else share * scale
        model = one.moved(base, step, simulator.dt)
        if model is None:
            step = -step
            model = one.moved(base, step, simulator.dt)
        models.append(base if model is None else model)
        steps.append(step / scale)
    return lacking_forces(simulator, half, models), np.array(steps)


def lacking_forces(simulator: MujocoSimulator, half: Motion, models: Sequence[Model]) -> Array:
    """Return the force that models lack for a motion, and by how much measured speeds differ, (n, n_blocks, 2 nv).

    Forces are in N or N m, speeds in m/s or rad/s, and NaN where they were not measured.
    """
    nv = len(half.slip)
    found = np.empty((len(models), len(half.states), 2 * nv))
    for places, scale in _by_scale(simulator, models):
        values = [
            {name: one for name, one in models[place].values.items() if not _is_sensed(name)}
            for place in places
        ]
        commands = np.empty((len(places), *half.states.shape[:1], half.commands.shape[1]))
        lates = np.array([models[place].late for place in places])
        for late in np.unique(lates):
            own = np.flatnonzero(lates == late)
            sent = _later(half.commands, half.episodes, late)
            acting = simulator.acting_commands(sent, [values[one] for one in own], groups=half.episodes)
            commands[own] = acting[:, half.rows].mean(axis=2)
        states, moved = half.states / np.tile(scale, 2), half.accelerations / scale
        found[places, :, :nv] = simulator.missing_forces(
            states, moved, commands, values, slip=half.slip, velocities=half.velocities / scale
        )
        found[places, :, nv:] = half.speeds - states[:, nv:]
        for place in places:
            one = models[place].values
            for joint, name in enumerate(simulator.residual_names[nv:]):
                found[place, :, nv + joint] -= one.get(f"bias[{name}]", 0.0)
                found[place, :, nv + joint] -= (one.get(f"scale[{name}]", 1.0) - 1) * states[:, nv + joint]
    return found


def _is_sensed(name: str) -> bool:
    """Whether an effect is of what scales the motion, or of measured speeds."""
    return name.startswith(("scale[q", "bias[qvel."))


def _by_scale(simulator: MujocoSimulator, models: Sequence[Model]) -> list[tuple[list[int], Array]]:
    """Return the places of models with equal scales of the positions' sensors, and these, by which speeds scale."""
    names = simulator.residual_names[: len(simulator.residual_names) // 2]
    found: dict[tuple[float, ...], list[int]] = {}
    for place, model in enumerate(models):
        found.setdefault(tuple(model.values.get(f"scale[{name}]", 1.0) for name in names), []).append(place)
    return [(places, np.array(scale)) for scale, places in found.items()]


def _later(commands: Array, episodes: NDArray[np.intp], late: float) -> Array:
    """Return commands that come so many rows later, or, where negative, earlier; interpolated between rows."""
    if not late or not commands.shape[1]:
        return commands
    moved = np.empty_like(commands)
    for episode in np.unique(episodes):
        own = np.flatnonzero(episodes == episode)
        places = np.arange(len(own))
        for column in range(commands.shape[1]):
            moved[own, column] = np.interp(places - late, places, commands[own, column])
    return moved


def coefficients_of(half: Motion, forces: Array) -> tuple[Array, NDArray[np.intp], Array, NDArray[np.intp]]:
    """Return the cosine coefficients of forces (n, n_blocks, 2 nv) where something was measured, and their places.

    As `transformed` does: coefficients (n_rows, n); joint, frequency in Hz and stretch of each row.
    """
    whole, joint, frequency, stretch = whole_coefficients_of(half, forces)
    seen = np.isfinite(whole[:, 0])
    return whole[seen], joint[seen], frequency[seen], stretch[seen]


def whole_coefficients_of(
    half: Motion, forces: Array
) -> tuple[Array, NDArray[np.intp], Array, NDArray[np.intp]]:
    """Return what `coefficients_of` does, and NaN in rows where nothing was measured."""
    return transformed(replace(half, cutoff=np.tile(half.cutoff, 2)), forces.transpose(1, 2, 0))
