"""Where a search begins: sets of causes in the forces that joints lack."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from skat.diagnosis.evidence import Gram, Weigher
from skat.diagnosis.fitting import priors_of
from skat.diagnosis.forces.force_space import Motion, noise_beside
from skat.diagnosis.forces.machines import MOTORS, UNSEEN, Model
from skat.diagnosis.forces.motions import (
    Log,
    lacking_forces,
    motion_of,
    rows_about,
    shares_of,
    units_by,
    with_friction,
)
from skat.diagnosis.search import families_of, rivals_of, search, without_weak
from skat.effects import Effect
from skat.simulators import MujocoSimulator, Simulator


def start_in_forces(
    simulator: Simulator,
    log: Log,
    effects: Sequence[Effect],
    *,
    typical: Mapping[str, float] | None = None,
    needed: float,
) -> dict[str, float]:
    """Return what a log's missing forces ask for: effects and their values, none where no force can be told.

    Far from the truth a simulation of the next row misleads: a light wrist without its friction accelerates by
    thousands of rad/s^2, and the cheapest way to explain that it does not is a motor that does nothing. The force that
    inverse dynamics lack is linear in friction, damping, armature and gains, however much of them there is [1]_. But a
    motor's strength is the unit of what is lacking, and so must be about right: servos that would be at their limits
    are first made softer.

    Parameters
    ----------
    simulator : Simulator
    log : tuple of (X, y, groups)
        NaN in states where nothing was measured. Rows of a group follow each other in time.
    effects : sequence of Effect
    typical : mapping from name to size, optional
        Scales of the priors of a user's own.
    needed : float
        Nats that each of the values is worth beside the others at least.

    Returns
    -------
    dict of str to float
        Values of effects, in their units.

    References
    ----------
    .. [1] Gautier (1997). Dynamic identification of robots with power model. ICRA.
    """
    typical = typical or {}
    effects = [effect for effect in effects if effect.family not in UNSEEN]
    if not isinstance(simulator, MujocoSimulator) or not effects:
        return {}
    try:
        half = motion_of(simulator, log, "")
    except ValueError:  # contacts, pieces that are too short, a free joint: where to begin is not known
        return {}
    weaker, some, strengths = with_possible_servos(simulator, half, effects)
    rivals = rivals_of(some)
    # Of a family whose members have factors of their own none stands for all.
    some = [
        effect
        for place, effect in enumerate(some)
        if not any(some[other].name in strengths for other in rivals.get(place, ()))
    ]
    found = _found(weaker, half, some, typical, needed)
    return {**found, **{name: own * found.get(name, 1.0) for name, own in strengths.items()}}


def with_possible_servos(
    simulator: MujocoSimulator, half: Motion, effects: Sequence[Effect]
) -> tuple[MujocoSimulator, Sequence[Effect], dict[str, float]]:
    """Return a simulator whose servos exert at no time of a log more than they may, its effects, and factors in it.

    Motors' strengths are the unit of what is lacking: of servos that are far too stiff all that gravity and friction
    exert is next to nothing, and so is what they may exert.
    """
    strengths = _strengths(simulator, half, effects)
    if not strengths:
        return simulator, effects, {}
    weaker, names = simulator.extended(strengths), {effect.name for effect in effects}
    return weaker, [effect for effect in weaker.effects(also="all") if effect.name in names], strengths


def _strengths(simulator: MujocoSimulator, half: Motion, effects: Sequence[Effect]) -> dict[str, float]:
    """Return factors of servos that would exert more than they may: with them they do at no time.

    A servo that is far too stiff is at its limit all the time, and there no slope tells how stiff it is.
    """
    limits, names = simulator.servo_limits, {effect.name for effect in effects}
    servos = [
        effect
        for effect in effects
        if effect.family in MOTORS
        and effect.target in limits
        and not (effect.family == "gain" and f"kp[{effect.target}]" in names)
    ]
    if not servos:
        return {}
    most = np.array([limits[str(effect.target)] for effect in servos])
    off = np.array([np.clip(0.0, *effect.bounds) for effect in servos])
    models = [Model({}), *(Model({effect.name: float(one)}) for effect, one in zip(servos, off))]
    forces = lacking_forces(simulator, half, models)[:, :, : len(half.slip)]
    exerted = np.abs(forces[1:] - forces[0]).max(axis=(1, 2)) / (1 - off)
    return {
        effect.name: max(float(share), effect.bounds[0])
        for effect, share in zip(servos, most / np.maximum(exerted, most))
        if share < 1
    }


def _found(
    simulator: MujocoSimulator,
    half: Motion,
    effects: Sequence[Effect],
    typical: Mapping[str, float],
    needed: float,
) -> dict[str, float]:
    """Return the set of effects that is worth most by the forces that a model lacks, and their values."""
    model = Model({})
    sizes = priors_of(effects, typical, logarithmic=False).scales
    rows = rows_about(simulator, half, model, effects, sizes)
    units = units_by(shares_of(rows), effects, typical)
    sizes = sizes * units
    rows = replace(rows, columns=rows.columns * units)
    # In units of the sizes.
    priors = priors_of(effects, dict(zip([effect.name for effect in effects], sizes)), logarithmic=False)
    priors = replace(priors, scales=np.ones(len(sizes)), low=priors.low / sizes, high=priors.high / sizes)

    def found(machine: Model) -> dict[str, float]:
        braked = with_friction(simulator, half, rows, effects, sizes, machine)
        target, columns = braked.whitened(noise_beside(braked))
        gram = Gram(columns.T @ columns, columns.T @ target, np.zeros(len(sizes)))
        worth = Weigher(gram, priors, rivals_of(effects))
        best, _ = without_weak(search(worth, families=families_of(effects)).sets[0], worth, needed)
        return {
            effects[one].name: float(np.clip(effects[one].neutral + sizes[one] * value, *effects[one].bounds))
            for one, value in zip(best.members, best.values)
        }

    values = found(model)
    rotors = {name: value for name, value in values.items() if name.startswith("armature[")}
    if rotors:
        # MuJoCo's friction of a light joint is as soft as its damping, and hardens with a rotor's inertia.
        values = found(Model(rotors))
    return values
