"""Where a search begins: sets of causes in the forces that joints lack."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from skat.diagnosis.evidence import Gram, Weigher
from skat.diagnosis.fitting import priors_of
from skat.diagnosis.forces.force_space import noise_beside
from skat.diagnosis.forces.machines import UNSEEN, Model
from skat.diagnosis.forces.motions import Log, half_of, rows_about, shares_of, units_by, with_friction
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
    inverse dynamics lack is linear in friction, damping, armature and gains, however much of them there is [1]_.

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
        half = half_of(simulator, log, "")
    except ValueError:  # contacts, pieces that are too short, a free joint: where to begin is not known
        return {}
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
