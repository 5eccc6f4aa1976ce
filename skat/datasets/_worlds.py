"""Worlds in which pucks are "measured": plain MuJoCo, with nothing of the effects or simulators of skat.

What these worlds hide must be found, not recognised. So they have a model text of their own, another time
step than the simulators', their own stepping loop, and noise; only the geometry and the meaning of a strike
(z0, z1) are the same, as a robot and its simulation would share them.
"""

from dataclasses import dataclass
from math import hypot

import mujoco
import numpy as np

LONGEST = 20.0
REST_SPEED = 0.002


@dataclass(frozen=True)
class PuckWorld:
    """How things are in a world.

    Parameters
    ----------
    friction_x, friction_y : float
        Coefficient of sliding friction between puck and table along each axis of the table.

    slope_x, slope_y : float
        Slope of the table in rad: without friction a puck would slide towards positive x, positive y.

    puck_mass : float
        In kg.

    stick_speed : float
        Speed of the stick over what was commanded.

    drag : float
        Air drag: force over squared speed, in kg/m.

    time_step : float
        Of the computation, in s.

    noise : float
        Standard deviation per axis of where a puck is found, over many strikes with the same command, in m.
    """

    friction_x: float = 0.2
    friction_y: float = 0.2
    slope_x: float = 0.0
    slope_y: float = 0.0
    puck_mass: float = 0.165
    stick_speed: float = 1.0
    drag: float = 0.0
    time_step: float = 0.0008
    noise: float = 0.01


# The effects that the demo hides, and what is true in each of these worlds.
HIDDEN = {
    "slope": (
        PuckWorld(slope_y=0.012),
        {"tilt[y]": 0.012},
        "The table slopes by 0.012 rad (0.7 degrees) towards y; a constant force would push a puck alike.",
    ),
    "friction": (
        PuckWorld(friction_x=0.16, friction_y=0.16),
        {"contact_friction[slide]": 0.8},
        "Puck and table have a coefficient of friction of 0.16; the simulation has 0.2.",
    ),
    "grain": (
        PuckWorld(friction_x=0.26, friction_y=0.2),
        {"contact_anisotropy[slide]": 1.3},
        "The table has a grain: its friction along x is 0.26, along y 0.2; the simulation has 0.2 in both.",
    ),
    "heavy puck": (
        PuckWorld(puck_mass=0.22),
        {"mass[puck]": 0.22 / 0.165},
        "The puck weighs 220 g; the simulation has 165 g. A slower stick would send one nearly alike.",
    ),
    "nothing": (PuckWorld(), {}, "Nothing but noise and the time step differs from the simulation."),
}

# Two pucks on one table. Fixed before any estimator was run on them, and not to be tuned.
_TABLE = {"slope_x": -0.002, "slope_y": 0.005, "time_step": 0.0004, "noise": 0.05}
REAL = {
    "blue": PuckWorld(friction_x=0.183, friction_y=0.187, puck_mass=0.162, **_TABLE),
    "red": PuckWorld(friction_x=0.176, friction_y=0.18, puck_mass=0.171, **_TABLE),
}


def shoot(world: PuckWorld, z: np.ndarray, random_state: np.random.RandomState) -> np.ndarray:
    """Return where pucks come to rest.

    Parameters
    ----------
    world : PuckWorld
        Where the puck is struck.

    z : ndarray of shape (n_shots, 2)
        Commands of the strikes: the stick sweeps in the direction 0.4 z0 rad from the x axis, with the speed
        1.2 exp(0.25 z1) m/s.

    random_state : RandomState
        Draws the noise.

    Returns
    -------
    ndarray of shape (n_shots, 2)
        Places in m; the puck starts at the origin.

    Raises
    ------
    RuntimeError
        If a puck still slides after 20 s.
    """
    model = _model(world)
    data = mujoco.MjData(model)
    rest = np.array([_shot(model, data, world, *command) for command in z])
    return rest + world.noise * random_state.standard_normal(rest.shape)


def _model(world: PuckWorld) -> mujoco.MjModel:
    down = np.array([np.tan(world.slope_x), np.tan(world.slope_y), -1.0])
    gravity = 9.81 * down / np.linalg.norm(down)
    # A pair's sliding frictions act along the tangents of the contact, which on this board are y and -x.
    return mujoco.MjModel.from_xml_string(
        _TEXT.format(
            step=world.time_step,
            gravity=" ".join(map(repr, gravity.tolist())),
            mass=world.puck_mass,
            first=world.friction_y,
            second=world.friction_x,
        )
    )


def _shot(model: mujoco.MjModel, data: mujoco.MjData, world: PuckWorld, z0: float, z1: float) -> np.ndarray:
    mujoco.mj_resetData(model, data)
    direction = np.array([np.cos(0.4 * z0), np.sin(0.4 * z0)])
    stick, puck = slice(4, 6), slice(0, 2)
    data.qpos[stick] = -(0.0381 + 0.015 + 0.01) * direction
    data.qvel[stick] = world.stick_speed * 1.2 * np.exp(0.25 * z1) * direction
    for step in range(int(LONGEST / world.time_step)):
        if world.drag:
            velocity = data.qvel[puck]
            data.qfrc_applied[puck] = -world.drag * np.linalg.norm(velocity) * velocity
        mujoco.mj_step(model, data)
        if step * world.time_step > 0.1:
            velocity = data.qvel.tolist()  # of floats: numpy would take longer than the time step
            if max(hypot(*velocity[puck]), hypot(*velocity[stick])) < REST_SPEED:
                return np.array(data.qpos[puck].copy())
    raise RuntimeError(f"the puck still slides after {LONGEST} s, at {data.qvel[puck]} m/s")


_TEXT = """
<mujoco model="measured puck">
  <option timestep="{step}" gravity="{gravity}" cone="elliptic" impratio="10"/>
  <worldbody>
    <geom name="board" type="plane" size="8 8 1" contype="0" conaffinity="0"/>
    <body name="disc" pos="0 0 0.0127">
      <joint name="along" type="slide" axis="1 0 0"/>
      <joint name="across" type="slide" axis="0 1 0"/>
      <joint name="up" type="slide" axis="0 0 1"/>
      <joint name="spin" type="hinge" axis="0 0 1"/>
      <geom name="disc" type="cylinder" size="0.0381 0.0127" mass="{mass}" contype="0" conaffinity="0"/>
    </body>
    <body name="rod" pos="0 0 0.02" gravcomp="1">
      <joint name="rod_along" type="slide" axis="1 0 0" damping="10"/>
      <joint name="rod_across" type="slide" axis="0 1 0" damping="10"/>
      <geom name="rod" type="cylinder" size="0.015 0.02" mass="1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <contact>
    <pair geom1="board" geom2="disc" friction="{first} {second} 0.005" solref="0.01 1"/>
    <pair geom1="disc" geom2="rod" friction="0.3 0.3 0.005" solref="-20000 -10"/>
  </contact>
</mujoco>
"""
