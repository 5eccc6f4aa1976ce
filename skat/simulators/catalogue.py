"""Which effects a MuJoCo model can take on, with their bounds.

Bounds are physical: they scale with the model's masses, its actuators and its gravity, and stay where the
model's integrator is stable.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import mujoco
import numpy as np

from skat.effects import Effect
from skat.simulators import contacts, edits
from skat.simulators.base import Array
from skat.simulators.channels import BALL, FREE, HINGE, SLIDE, joint_name

AXES = "xyz"
MAX_DELAY_IN_TRANSITIONS = 5
JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
EXPLICIT_INTEGRATOR = int(mujoco.mjtIntegrator.mjINT_RK4)


@dataclass(frozen=True)
class Listing:
    """Effects by name, and the names that only repeat another effect of this model.

    ``mass[all]`` of a model with one body repeats ``mass[<body>]``: it is accepted, not listed.
    """

    effects: tuple[Effect, ...]
    repeated: frozenset[str]


def effect_listing(anatomy: "Anatomy", frame_skip: int) -> Listing:
    """Return every effect of a compiled model."""
    model = anatomy.model
    effects: list[Effect] = []
    repeated: list[str] = []
    for family in (
        _link_effects,
        _gravity_effects,
        _force_effects,
        _joint_effects,
        _actuator_effects,
        _contact_effects,
    ):
        for effect, listed in family(anatomy):
            effects.append(effect)
            if not listed:
                repeated.append(effect.name)
    if model.nu:
        dt = frame_skip * model.opt.timestep
        bounds = (0.0, MAX_DELAY_IN_TRANSITIONS * dt)
        effects.append(
            Effect("delay[action]", unit="s", neutral=0.0, bounds=bounds, apply=edits.delay_actuators)
        )
    bounds = (0.1, float(max(1, frame_skip)))
    effects.append(Effect("timestep", unit="1", neutral=1.0, bounds=bounds, apply=edits.scale_timestep))
    return Listing(tuple(effects), frozenset(repeated))


class Anatomy:
    """What the effects need to know of a compiled model.

    Parameters
    ----------
    model : mujoco.MjModel
    """

    def __init__(self, model: mujoco.MjModel):
        self.model = model

    @cached_property
    def moving(self) -> list[int]:
        """Bodies that can move."""
        return [body for body in range(1, self.model.nbody) if self.model.body_weldid[body] != 0]

    @cached_property
    def roots(self) -> list[int]:
        """Moving bodies that hang on the world."""
        model = self.model
        return [body for body in self.moving if model.body_weldid[model.body_parentid[body]] == 0]

    @cached_property
    def root(self) -> int:
        """The body on which wind and drag act: the first root with a free joint, else the first root."""
        free = [
            body
            for body in self.roots
            if any(self.joint_kind(joint) == FREE for joint in self.joints_of(body))
        ]
        return (free or self.roots)[0]

    @cached_property
    def poses(self) -> Array:
        """The reference pose and a few around it, shape (n_poses, nq)."""
        random = np.random.default_rng(0)
        poses = np.tile(self.model.qpos0, (6, 1))
        for pose in poses[1:]:
            mujoco.mj_integratePos(self.model, pose, 0.5 * random.normal(size=self.model.nv), 1.0)
        return poses

    @cached_property
    def reach(self) -> dict[int, Array]:
        """For each moving body, how much its centre of mass can move along x, y, z (0: not at all)."""
        data = mujoco.MjData(self.model)
        jacobian = np.zeros((3, self.model.nv))
        reach = {body: np.zeros(3) for body in self.moving}
        for pose in self.poses:
            data.qpos[:] = pose
            mujoco.mj_kinematics(self.model, data)
            mujoco.mj_comPos(self.model, data)
            for body in self.moving:
                mujoco.mj_jacBodyCom(self.model, data, jacobian, None, body)
                reach[body] = np.maximum(reach[body], np.abs(jacobian).max(axis=1, initial=0.0))
        return {body: np.where(reach[body] > 1e-9, reach[body], 0.0) for body in reach}

    @cached_property
    def pairs(self) -> tuple[contacts.ContactPair, ...]:
        """Pairs of geoms that can touch."""
        return contacts.contact_pairs(self.model)

    def body_name(self, body: int) -> str:
        """Return the body's name, or ``body<id>``."""
        return self.model.body(body).name or f"body{body}"

    def joint_kind(self, joint: int) -> int:
        """Return the joint's type."""
        return int(self.model.jnt_type[joint])

    def joints_of(self, body: int) -> list[int]:
        """Return the joints of a body."""
        first = int(self.model.body_jntadr[body])
        return list(range(first, first + int(self.model.body_jntnum[body])))

    def dofs_of(self, joint: int) -> list[int]:
        """Return the degrees of freedom of a joint."""
        count = {FREE: 6, BALL: 3}.get(self.joint_kind(joint), 1)
        first = int(self.model.jnt_dofadr[joint])
        return list(range(first, first + count))

    @cached_property
    def actuated(self) -> set[int]:
        """Joints that an actuator drives."""
        model = self.model
        driven = np.isin(model.actuator_trntype, JOINT_TRANSMISSIONS)
        return {int(joint) for joint in model.actuator_trnid[driven, 0]}

    @cached_property
    def base_joints(self) -> set[int]:
        """Joints that only say where the robot is: those of a planar floating base, and free joints."""
        found: set[int] = set()
        for body in self.roots:
            joints = self.joints_of(body)
            kinds = [self.joint_kind(joint) for joint in joints]
            carries = (
                self.model.body_treeid[body]
                in self.model.body_treeid[
                    [
                        int(self.model.jnt_bodyid[joint])
                        for joint in range(self.model.njnt)
                        if joint not in joints
                    ]
                ]
            )
            planar = len(joints) > 1 and SLIDE in kinds and carries and not self.actuated & set(joints)
            if FREE in kinds or planar:
                found |= set(joints)
        return found

    @cached_property
    def inertia(self) -> Array:
        """Inertia of each degree of freedom in the reference pose, kg or kg m2."""
        return np.maximum(self.model.dof_M0, 1e-6)

    @cached_property
    def force(self) -> Array:
        """Characteristic force or torque of each degree of freedom: of gravity, of actuators, of 1 g."""
        model, data = self.model, mujoco.MjData(self.model)
        force = 10 * self.inertia
        for pose in self.poses:
            data.qpos[:] = pose
            mujoco.mj_forward(model, data)
            force = np.maximum(force, np.abs(data.qfrc_bias))
        for actuator in range(model.nu):
            joint = int(model.actuator_trnid[actuator, 0])
            if int(model.actuator_trntype[actuator]) in JOINT_TRANSMISSIONS and self.joint_kind(joint) in (
                HINGE,
                SLIDE,
            ):
                limit = (
                    np.abs(model.actuator_ctrlrange[actuator]).max()
                    if model.actuator_ctrllimited[actuator]
                    else 1.0
                )
                capacity = abs(model.actuator_gear[actuator, 0] * model.actuator_gainprm[actuator, 0]) * limit
                dof = int(model.jnt_dofadr[joint])
                force[dof] = max(force[dof], capacity)
        return force

    @cached_property
    def stable_rate(self) -> Array:
        """Largest damping that the integrator bears on each degree of freedom, force per velocity."""
        if int(self.model.opt.integrator) != EXPLICIT_INTEGRATOR:
            return np.full(self.model.nv, np.inf)
        return 1 / (self.model.opt.timestep * np.maximum(self.model.dof_invweight0, 1e-9))


def actuator_name(model: mujoco.MjModel, actuator: int) -> str:
    """Return the actuator's name; if it has none the name of its joint; else ``actuator<id>``."""
    own = [model.actuator(index).name for index in range(model.nu)]
    if own[actuator]:
        return own[actuator]

    def joint_of(index: int) -> str:
        if own[index] or int(model.actuator_trntype[index]) not in JOINT_TRANSMISSIONS:
            return ""
        return joint_name(model, int(model.actuator_trnid[index, 0]))

    name = joint_of(actuator)
    taken = own + [joint_of(index) for index in range(model.nu) if index != actuator]
    return name if name and name not in taken else f"actuator{actuator}"


def drag_joint(anatomy: Anatomy, axis: int) -> int | None:
    """Return the slide joint whose quadratic damping is the root's air drag along a world axis.

    None if there is none: the root turns, or its slides are oblique.
    """
    joints = anatomy.joints_of(anatomy.root)
    if not all(anatomy.joint_kind(joint) == SLIDE for joint in joints):
        return None
    data = mujoco.MjData(anatomy.model)
    mujoco.mj_kinematics(anatomy.model, data)
    for joint in joints:
        if abs(abs(data.xaxis[joint, axis]) - 1) < 1e-12:
            return joint
    return None


Found = Iterator[tuple[Effect, bool]]


def _factor(name: str, low: float, high: float, apply: Callable[..., Any]) -> Effect:
    return Effect(name, unit="1", neutral=1.0, bounds=(low, high), apply=apply)


def _link_effects(anatomy: Anatomy) -> Found:
    model = anatomy.model
    massive = [body for body in anatomy.moving if model.body_mass[body] > 0]
    yield from _each_and_all("mass", massive, anatomy.body_name, (0.05, 20.0), edits.scale_mass)
    extended = [body for body in anatomy.moving if _has_length(anatomy, body)]
    yield from _each_and_all("length", extended, anatomy.body_name, (0.3, 3.0), edits.scale_length)
    for body in massive:
        geoms = range(int(model.body_geomadr[body]), int(model.body_geomadr[body] + model.body_geomnum[body]))
        extent = max(
            [float(model.geom_rbound[geom] + np.linalg.norm(model.geom_pos[geom])) for geom in geoms] or [0.1]
        )
        for axis in range(3):
            if _shift_matters(anatomy, body, axis):
                yield (
                    Effect(
                        f"centre_of_mass[{anatomy.body_name(body)}.{AXES[axis]}]",
                        unit="m",
                        neutral=0.0,
                        bounds=(-max(extent, 1e-3), max(extent, 1e-3)),
                        apply=partial(edits.shift_centre_of_mass, body, axis),
                    ),
                    True,
                )


def _each_and_all(
    family: str,
    elements: Sequence[int],
    name: Callable[[int], str],
    bounds: tuple[float, float],
    edit: Callable[..., Any],
) -> Found:
    """Yield the factor of each element, and that of all at once."""
    for element in elements:
        yield _factor(f"{family}[{name(element)}]", *bounds, partial(edit, (element,))), True
    if elements:
        yield _factor(f"{family}[all]", *bounds, partial(edit, tuple(elements))), len(elements) > 1


def _has_length(anatomy: Anatomy, body: int) -> bool:
    model = anatomy.model
    geoms = range(int(model.body_geomadr[body]), int(model.body_geomadr[body] + model.body_geomnum[body]))
    long_types = (edits.CAPSULE, edits.CYLINDER)
    joints = [joint for joint in anatomy.joints_of(body) if anatomy.joint_kind(joint) in (HINGE, BALL)]
    children = [child for child in range(1, model.nbody) if model.body_parentid[child] == body]
    return (
        any(int(model.geom_type[geom]) in long_types or model.geom_pos[geom].any() for geom in geoms)
        or any(model.jnt_pos[joint].any() for joint in joints)
        or any(model.body_pos[child].any() for child in children)
    )


def _shift_matters(anatomy: Anatomy, body: int, axis: int) -> bool:
    """Whether a shift of the centre of mass along an axis of the body changes how it moves.

    A body that cannot turn, and one that turns about this axis only, move the same wherever their mass is.
    """
    model, data = anatomy.model, mujoco.MjData(anatomy.model)
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for pose in anatomy.poses:
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBodyCom(model, data, linear, angular, body)
        direction = data.xmat[body].reshape(3, 3)[:, axis]
        if np.abs(np.cross(angular.T, direction)).max(initial=0.0) > 1e-9:
            return True
    return False


def _gravity_effects(anatomy: Anatomy) -> Found:
    model = anatomy.model
    off = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    if off or not np.any(model.opt.gravity) or not anatomy.moving:
        return
    yield _factor("gravity", 0.0, 3.0, edits.scale_gravity), True
    for axis in range(2):
        if any(anatomy.reach[body][axis] for body in anatomy.moving):
            edit = partial(edits.tilt_gravity, axis)
            yield Effect(f"tilt[{AXES[axis]}]", unit="rad", neutral=0.0, bounds=(-0.7, 0.7), apply=edit), True


def _force_effects(anatomy: Anatomy) -> Found:
    if not anatomy.moving:
        return
    mass = float(anatomy.model.body_subtreemass[anatomy.root])
    axes = [axis for axis in range(3) if anatomy.reach[anatomy.root][axis]]
    for axis in axes:
        bounds = (-20 * mass, 20 * mass)
        yield Effect(f"wind[{AXES[axis]}]", unit="N", neutral=0.0, bounds=bounds), True
    slides = {axis: drag_joint(anatomy, axis) for axis in axes}
    drag = partial(Effect, unit="kg/m", neutral=0.0, bounds=(0.0, 10 * mass))
    for axis in axes:
        joint = slides[axis]
        edit = None if joint is None else partial(edits.add_quadratic_damping, (joint,))
        yield drag(f"air_drag[{AXES[axis]}]", apply=edit), True
    if axes:
        joint = slides[axes[0]] if len(axes) == 1 else None
        edit = None if joint is None else partial(edits.add_quadratic_damping, (joint,))
        yield drag("air_drag[all]", apply=edit), len(axes) > 1


def _joint_effects(anatomy: Anatomy) -> Found:
    model = anatomy.model
    joints = list(range(model.njnt))
    inner = [joint for joint in joints if joint not in anatomy.base_joints]
    damped = inner or joints
    damping = {joint: float(model.dof_damping[anatomy.dofs_of(joint)[0]]) for joint in joints}
    friction = {joint: float(model.dof_frictionloss[anatomy.dofs_of(joint)[0]]) for joint in joints}
    armature = {joint: float(model.dof_armature[anatomy.dofs_of(joint)[0]]) for joint in joints}
    stiffness = {joint: float(model.jnt_stiffness[joint]) for joint in joints}
    limits: dict[str, dict[int, float]] = {"damping": {}, "dry_friction": {}, "armature": {}, "stiffness": {}}
    for joint in joints:
        dofs = anatomy.dofs_of(joint)
        inertia, force = float(anatomy.inertia[dofs].max()), float(anatomy.force[dofs].max())
        stable = float(anatomy.stable_rate[dofs].min())
        stable_spring = 1 / (model.opt.timestep**2 * max(float(model.dof_invweight0[dofs].max()), 1e-9))
        limits["damping"][joint] = min(
            100 * max(damping[joint], inertia), max(stable - damping[joint], 0.1 * stable)
        )
        limits["dry_friction"][joint] = max(2 * force, 10 * friction[joint])
        limits["armature"][joint] = 10 * inertia
        limits["stiffness"][joint] = min(max(10 * force, 10 * stiffness[joint]), stable_spring)
    for joint in joints:
        is_base = joint in anatomy.base_joints
        name, kind = joint_name(model, joint), anatomy.joint_kind(joint)
        angular = kind in (HINGE, BALL)
        unit = "N s/m, N m s/rad" if kind == FREE else "N m s/rad" if angular else "N s/m"
        yield (
            _added(
                f"damping[{name}]", unit, damping[joint], limits["damping"][joint], edits.add_damping, joint
            ),
            True,
        )
        if is_base and (kind == FREE or inner):
            continue
        unit = "N m" if angular else "N"
        limit = limits["dry_friction"][joint]
        yield (
            _added(f"dry_friction[{name}]", unit, friction[joint], limit, edits.add_dry_friction, joint),
            True,
        )
        if kind != BALL:
            unit = "N m/rad" if angular else "N/m"
            yield Effect(f"position_friction[{name}]", unit=unit, neutral=0.0, bounds=(0.0, limit)), True
        unit = "kg m2" if angular else "kg"
        yield (
            _added(
                f"armature[{name}]",
                unit,
                armature[joint],
                limits["armature"][joint],
                edits.add_armature,
                joint,
            ),
            True,
        )
        unit = "N m/rad" if angular else "N/m"
        limit = limits["stiffness"][joint]
        yield _added(f"stiffness[{name}]", unit, stiffness[joint], limit, edits.add_stiffness, joint), True
    if damped:
        yield _added_to_all("damping", damped, damping, limits, edits.add_damping, anatomy), len(damped) > 1
    rubbing = [joint for joint in damped if anatomy.joint_kind(joint) != FREE]
    if rubbing:
        yield (
            _added_to_all("dry_friction", rubbing, friction, limits, edits.add_dry_friction, anatomy),
            len(rubbing) > 1,
        )


def _added(
    name: str, unit: str, nominal: float, limit: float, edit: Callable[..., Any], *joints: int
) -> Effect:
    """Return the effect of what is added to a nominal value that cannot fall below zero."""
    return Effect(name, unit=unit, neutral=0.0, bounds=(0.0 - nominal, limit), apply=partial(edit, joints))


def _added_to_all(
    family: str,
    joints: list[int],
    nominal: dict[int, float],
    limits: dict[str, dict[int, float]],
    edit: Callable[..., Any],
    anatomy: Anatomy,
) -> Effect:
    kinds = {anatomy.joint_kind(joint) for joint in joints}
    units = {"damping": ("N s/m", "N m s/rad"), "dry_friction": ("N", "N m")}[family]
    present = [units[0]] * bool(kinds & {SLIDE, FREE}) + [units[1]] * bool(kinds & {HINGE, BALL, FREE})
    low = min(nominal[joint] for joint in joints)
    limit = min(limits[family][joint] for joint in joints)
    return _added(f"{family}[all]", ", ".join(present), low, limit, edit, *joints)


def _actuator_effects(anatomy: Anatomy) -> Found:
    name = partial(actuator_name, anatomy.model)
    yield from _each_and_all("gain", range(anatomy.model.nu), name, (-3.0, 3.0), edits.scale_gain)


def _contact_effects(anatomy: Anatomy) -> Found:
    model, pairs = anatomy.model, anatomy.pairs
    rough = tuple(pair for pair in pairs if pair.has_friction)
    explicit = [pair for pair in rough if pair.index is not None]
    geoms = sorted({geom for pair in rough for geom in (pair.first, pair.second)})
    names: set[str] = set()
    for geom in geoms:
        mine = tuple(pair for pair in rough if geom in (pair.first, pair.second))
        name = contacts.geom_name(model, geom)
        names.add(name)
        edit = partial(contacts.scale_friction, mine)
        repeats = len(mine) == len(rough) or (len(mine) == 1 and mine[0] in explicit)
        yield _factor(f"contact_friction[{name}]", 0.01, 20.0, edit), not repeats
    for pair in explicit if len(rough) > 1 else ():
        if pair.name not in names:
            edit = partial(contacts.scale_friction, (pair,))
            yield _factor(f"contact_friction[{pair.name}]", 0.01, 20.0, edit), True
    if rough:
        yield _factor("contact_friction[all]", 0.01, 20.0, contacts.scale_all_friction), True
        yield from _each_pair_and_all("contact_anisotropy", rough, (0.05, 20.0), contacts.set_anisotropy)
    if pairs:
        for effect, listed in _each_pair_and_all(
            "restitution", pairs, (0.05, 5.0), contacts.scale_damping_ratio
        ):
            if effect.target == "all":
                effect = replace(effect, apply=contacts.scale_all_damping_ratios, describe=effect.describe)
            yield effect, listed


def _each_pair_and_all(
    family: str,
    pairs: tuple[contacts.ContactPair, ...],
    bounds: tuple[float, float],
    edit: Callable[..., Any],
) -> Found:
    """Yield the factor of each pair, and that of all; only explicit pairs are listed, as others are many."""
    for pair in pairs:
        listed = pair.index is not None and len(pairs) > 1
        yield _factor(f"{family}[{pair.name}]", *bounds, partial(edit, (pair,))), listed
    yield _factor(f"{family}[all]", *bounds, partial(edit, pairs)), True
