"""A stick strikes a hockey puck, which slides over a table and comes to rest."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from skat.effects import Effect
from skat.simulators.base import Acting, Simulator
from skat.simulators.mujoco import MujocoSimulator
from skat.simulators.stepping import Job, Rest, Stepper
from skat.simulators.tables import Array

PUCK_RADIUS = 0.0381  # m; an ice hockey puck: diameter 76.2 mm, thickness 25.4 mm, 156 to 170 g
STICK_RADIUS = 0.015  # m
GAP = 0.01  # m between stick and puck before the sweep
DIRECTION_PER_UNIT = 0.4  # rad
REFERENCE_SPEED = 1.2  # m/s
LOG_SPEED_PER_UNIT = 0.25
BLOCK = 50  # time steps between two looks at what is at rest
LONGEST = 15.0  # s
AT_REST = 0.005  # m/s; at a friction of 0.2 the puck would slide 6 micrometres further

# Elliptic cones: friction of the same size in all directions (pyramidal ones are weaker between their edges).
# The puck can slide and spin but not tip, which halves the chatter of its four contact points. Friction of
# 0.2: hockey pucks on smooth tables have 0.1 to 0.35.
MODEL = f"""
<mujoco model="puck">
  <option timestep="0.001" cone="elliptic" impratio="10"/>
  <worldbody>
    <geom name="table" type="plane" size="5 5 0.1" contype="0" conaffinity="0"/>
    <body name="puck" pos="0 0 0.0127">
      <joint name="puck_x" type="slide" axis="1 0 0"/>
      <joint name="puck_y" type="slide" axis="0 1 0"/>
      <joint name="puck_z" type="slide" axis="0 0 1"/>
      <joint name="puck_turn" type="hinge" axis="0 0 1"/>
      <geom name="puck" type="cylinder" size="{PUCK_RADIUS} 0.0127" mass="0.165" contype="0" conaffinity="0"/>
    </body>
    <body name="stick" pos="0 0 0.02" gravcomp="1">
      <joint name="stick_x" type="slide" axis="1 0 0" damping="10"/>
      <joint name="stick_y" type="slide" axis="0 1 0" damping="10"/>
      <geom name="stick" type="cylinder" size="{STICK_RADIUS} 0.02" mass="1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <contact>
    <pair name="slide" geom1="table" geom2="puck" friction="0.2 0.2 0.005" solref="0.01 1"/>
    <pair name="hit" geom1="puck" geom2="stick" friction="0.3 0.3 0.005" solref="-20000 -10"/>
  </contact>
</mujoco>
"""

ISOTROPIC = {
    "low": 0.5,
    "lowmed": 0.8,
    "med": 1.0,
    "medhi": 1.35,
    "high": 1.7,
}  # factors on the friction of 0.2
OFF_CENTRE = 0.008  # m
ANISOTROPY = {"heavy": 3.0, "low": 1.5}  # friction along one axis over that along the other
CONDITIONS = (
    "normal",
    *(f"isotr_{level}" for level in ISOTROPIC),
    "isotr_low_offc",
    "isotr_high_offc",
    *(f"{degree}_anisotr_low{axis}" for degree in ANISOTROPY for axis in "xy"),
)
# With bounds within which the puck comes to rest; None: those of the model.
EFFECTS_OF_MODEL: tuple[tuple[str, tuple[float, float] | None], ...] = (
    ("mass[puck]", None),
    ("tilt[x]", (-0.08, 0.08)),
    ("tilt[y]", (-0.08, 0.08)),
    ("wind[x]", (-0.12, 0.12)),
    ("wind[y]", (-0.12, 0.12)),
    ("air_drag[all]", None),
    ("contact_friction[slide]", (0.2, 10.0)),
    ("contact_friction[hit]", None),
    ("contact_anisotropy[slide]", (0.2, 5.0)),
    ("restitution[hit]", None),
)


class PuckSimulator(Simulator):
    """A stick strikes a hockey puck: the strike in, the puck's resting place out.

    The stick, 1 kg on a brake of 10 N s/m, starts 1 cm behind the puck and sweeps in the direction ``0.4 z0``
    rad from the x axis with the speed ``1.2 exp(0.25 z1)`` m/s; z0 and z1 are dimensionless, of the order 1.
    The puck starts at the origin. It can slide and spin but not tip.

    Effects are those of the MuJoCo model, and ``gain[stick]``, a factor on the stick's speed. ``slide`` is
    the contact of puck and table, ``hit`` that of stick and puck. The first direction of
    ``contact_anisotropy[slide]`` is y, the second x.

    Parameters
    ----------
    off_centre : float, default=0
        How far the stick passes to the left of the puck's centre, m.
    built_in : mapping from name to value, optional
        Effects that are built in; see `extended`.

    Examples
    --------
    >>> from skat.simulators import make_simulator
    >>> puck = make_simulator("puck")
    >>> puck.predict([[0.0, 0.0], [1.0, 0.5]]).round(2)
    array([[0.69, 0.  ],
           [0.83, 0.35]])
    """

    input_names = ("z0", "z1")
    output_names = ("x", "y")
    state_names = ()
    dt = None

    def __init__(self, *, off_centre: float = 0.0, built_in: Mapping[str, float] | None = None):
        self.off_centre = off_centre
        self.built_in = built_in

    @property
    def world(self) -> MujocoSimulator:
        """The stick, the puck and the table, without the effects that are built in."""
        return self._cached("world", lambda: MujocoSimulator(MODEL))

    def initial_states(self, X: Array, gain: float = 1.0) -> Array:
        """Return the states of `world` from which strikes start.

        Parameters
        ----------
        X : ndarray of shape (n_rows, 2)
        gain : float
            Factor on the stick's speed.

        Returns
        -------
        ndarray of shape (n_rows, 12)
        """
        angle, speed = (
            DIRECTION_PER_UNIT * X[:, 0],
            gain * REFERENCE_SPEED * np.exp(LOG_SPEED_PER_UNIT * X[:, 1]),
        )
        along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        left = np.stack([-along[:, 1], along[:, 0]], axis=1)
        states = np.zeros((len(X), len(self.world.state_names)))
        states[:, 4:6] = -(PUCK_RADIUS + STICK_RADIUS + GAP) * along + self.off_centre * left
        states[:, 10:12] = speed[:, None] * along
        return states

    @property
    def units(self) -> dict[str, str]:
        """Unit of each output, by name."""
        return {"x": "m", "y": "m"}

    def _own_effects(self) -> tuple[Effect, ...]:
        return self._cached("own_effects", lambda: _puck_effects(self.world))

    def _sensor_effects(self) -> tuple[Effect, ...]:
        return (
            *(Effect(f"bias[{axis}]", unit="m", neutral=0.0, bounds=(-2.0, 2.0)) for axis in "xy"),
            *(Effect(f"scale[{axis}]", unit="1", neutral=1.0, bounds=(0.1, 10.0)) for axis in "xy"),
        )

    def _outputs(
        self,
        inputs: Array,
        candidates: Sequence[Mapping[str, float]],
        acting: Sequence[Acting],
        hidden: Sequence[Array] | None,
        forces: Array | None = None,
    ) -> tuple[Array, list[Array]]:
        starts, jobs = [], []
        for index, values in enumerate(candidates):
            mechanical = {name: value for name, value in values.items() if name != "gain[stick]"}
            starts.append(self.initial_states(inputs[index], values.get("gain[stick]", 1.0)))
            jobs.append(Job(index, *self.world.prepared(mechanical, BLOCK)))
        rest = Rest(_at_rest, max_blocks=round(LONGEST / (BLOCK * self.world.dt)))
        stepper: Stepper = self._cached("stepper", Stepper)
        states, left = stepper.run(jobs, np.array(starts), rest=rest)
        return states[:, :, :2], left


def make_puck(condition: str) -> PuckSimulator:
    """Return the puck under one of the conditions of the paper's table.

    "isotr_low" to "isotr_high" differ in friction (0.1, 0.16, 0.2, 0.27, 0.34); "offc" strikes 8 mm off the
    centre; "heavy" and "low" anisotropy are a ratio of 3 and of 1.5 between the friction along the two axes,
    with the lower one along the axis named and the geometric mean of 0.2.

    Parameters
    ----------
    condition : str

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Table II. It gives the
    names
       of the simulations but not their numbers; these are ours.
    """
    if condition == "normal":
        return PuckSimulator()
    kind, _, rest = condition.partition("_")
    if kind == "isotr":
        level, _, off = rest.partition("_")
        factor = ISOTROPIC[level]
        built_in = {"contact_friction[slide]": factor} if factor != 1 else None
        return PuckSimulator(off_centre=OFF_CENTRE if off else 0.0, built_in=built_in)
    ratio = ANISOTROPY[kind]
    first = ratio**0.5 if condition.endswith("x") else ratio**-0.5  # friction along y, the first direction
    return PuckSimulator(built_in={"contact_friction[slide]": first, "contact_anisotropy[slide]": first**-2})


def _puck_effects(world: MujocoSimulator) -> tuple[Effect, ...]:
    effects = {effect.name: effect for effect in world.all_effects()}
    gain = Effect("gain[stick]", unit="1", neutral=1.0, bounds=(0.2, 3.0))
    chosen = (
        replace(effects[name], bounds=bounds or effects[name].bounds) for name, bounds in EFFECTS_OF_MODEL
    )
    return (*chosen, gain)


def _at_rest(qpos: Array, qvel: Array) -> np.ndarray:
    """Whether the puck no longer slides, after the stick has done its sweep."""
    return (np.hypot(qvel[:, 0], qvel[:, 1]) < AT_REST) & (np.hypot(qvel[:, 4], qvel[:, 5]) < AT_REST)
