"""The same model for another log: with the log's step, or with its root welded to the world."""

import math
from dataclasses import replace

from skat.simulators.base import Simulator
from skat.simulators.mujoco import MujocoSimulator
from skat.simulators.source import write_xml

# A step that misses a whole number of time steps by less than this share is one.
STEP_TOLERANCE = 1e-3


def at_rate(simulator: Simulator, step: float) -> tuple[Simulator, float]:
    """Return the simulator whose transition takes a step, and how long it takes exactly.

    Where the step is a whole number of time steps within 0.1 %, the model takes so many. Otherwise its time step
    becomes the step's share of the next whole number, so that none is longer than the model's own.

    Parameters
    ----------
    simulator : Simulator
    step : float
        s.

    Raises
    ------
    ValueError
        If the simulator has steps of its own that cannot be changed.
    """
    if not isinstance(simulator, MujocoSimulator):
        if simulator.dt is None or abs(step / simulator.dt - 1) > STEP_TOLERANCE:
            raise ValueError(
                f"{step:g} s from row to row, while a transition of this {type(simulator).__name__} takes "
                f"{simulator.dt} s (dt). Write the function for the log's step, or give rate=1 / dt (--rate)."
            )
        return simulator, simulator.dt
    timestep = simulator.dt / simulator.frame_skip
    count = round(step / timestep)
    parameters = simulator.get_params(deep=False)
    if count >= 1 and abs(step / timestep - count) <= STEP_TOLERANCE * step / timestep:
        same = count == simulator.frame_skip
        changed = simulator if same else type(simulator)(**(parameters | {"frame_skip": count}))
        return changed, changed.dt
    count = max(1, math.ceil(step / timestep - STEP_TOLERANCE))
    spec = simulator.model.spec()
    spec.option.timestep = step / count
    source = replace(simulator.model, xml=write_xml(spec))
    changed = type(simulator)(**(parameters | {"model": source, "frame_skip": count}))
    return changed, changed.dt


def without_root(simulator: Simulator) -> Simulator:
    """Return the simulator with free joints at the world taken out: the root stays where the model has it.

    Raises
    ------
    ValueError
        If the simulator is no MuJoCo model.
    """
    if not isinstance(simulator, MujocoSimulator):
        raise ValueError(f'base="fixed" is of MuJoCo models; this is a {type(simulator).__name__}.')
    return type(simulator)(**(simulator.get_params(deep=False) | {"base": "fixed"}))
