"""From the text of a model to what MuJoCo steps."""

import warnings
from typing import Any

import mujoco
import numpy as np

from skat.simulators.channels import element_name
from skat.simulators.derived import write_down
from skat.simulators.source import ModelSource, broken_model


def lean_spec(source: ModelSource) -> mujoco.MjSpec:
    """Return the model as a spec, without what only the eye needs, so that copies compile fast."""
    try:
        spec = source.spec()
        write_down(spec)
    except ValueError as error:
        raise broken_model("the model", error) from None
    for element in [*spec.geoms, *spec.sites, *spec.skins, *spec.tendons, *spec.meshes, *spec.flexes]:
        element.material = ""
    for light in spec.lights:
        light.texture = ""
    for element in [*spec.materials, *spec.textures, *spec.skins]:
        spec.delete(element)
    _check_delays(spec)
    for actuator in spec.actuators:  # the commands are delayed outside
        actuator.nsample, actuator.delay = 0, 0
    for sensor in spec.sensors:  # what a sensor remembers acts on nothing
        sensor.nsample, sensor.delay, sensor.interval = 0, 0, [0, 0]
    spec.compiler.fusestatic = spec.compiler.discardvisual = False  # effects mean elements by their place
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # a diverged row must not restart
    spec.option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)  # sleeping needs memory between calls
    return spec


def _check_delays(spec: mujoco.MjSpec) -> None:
    """Raise where MuJoCo delays a control in another way than the commands are delayed outside of it."""
    for index, actuator in enumerate(spec.actuators):
        if not (actuator.nsample and actuator.delay):
            continue
        name = actuator.name or f"actuator{index}"
        if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            raise ValueError(
                f"actuator {name!r} has a delay, which the integrator RK4 reads between time steps: take another "
                "integrator, or take delay and nsample out of the MJCF and build the effect delay in"
            )
        if actuator.interp > 1:  # 0 holds, 1 is linear
            raise ValueError(
                f'actuator {name!r} has a delay with interp="cubic"; only "zoh" and "linear" are supported'
            )


def compile_spec(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Return the compiled model; what MuJoCo warns of was said when the source was read."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return spec.compile()


def checked_model(spec: mujoco.MjSpec, frame_skip: Any) -> mujoco.MjModel:
    """Return the compiled model, if its state is that of rows [qpos, qvel, ctrl].

    Raises
    ------
    ValueError
        If MuJoCo refuses the model, nothing can move, there are other states, or actuators of several controls.
    """
    is_number = isinstance(frame_skip, int | float | np.integer) and not isinstance(frame_skip, bool)
    if not is_number or frame_skip % 1 or frame_skip < 1:
        raise ValueError(f"frame_skip must be a positive whole number of time steps; got {frame_skip!r}")
    try:
        model = compile_spec(spec)
    except ValueError as error:
        raise broken_model("the model", error) from None
    if model.nq == 0:
        raise ValueError("the model has no joints: nothing in it can move, so there is no state to predict")
    hidden = {
        "a plastic state (springyield, yield, or the twist of an elastic rod)": (
            model.nplastic,
            "take springyield and yield out of the MJCF, and elasticity out of rods with twist joints",
        ),
        "contacts with a memory (the flag ipc)": (
            int(model.opt.enableflags) & int(mujoco.mjtEnableBit.mjENBL_IPC),
            'take ipc="enable" out of the MJCF',
        ),
        "a plugin with a state": (model.npluginstate, "remove it"),
    }
    for what, (count, advice) in hidden.items():
        if count:
            raise ValueError(
                f"the model has {what}, a state that the rows [qpos, qvel, ctrl] do not hold: {advice}"
            )
    for actuator, n_controls in enumerate(model.actuator_ctrlnum):
        if n_controls != 1:
            name = element_name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, actuator, "actuator")
            raise ValueError(
                f"actuator {name!r} takes {n_controls} controls; only actuators of "
                f"one control are supported. Give each control an actuator of its own: <position>, <velocity> and "
                f"<motor> on one joint for a pid with the inputs pos, vel and ff; a <motor> about each axis of the "
                f"joint for an orientation"
            )
    return model
