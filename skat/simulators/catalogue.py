"""Which effects a MuJoCo model can take on, with their bounds.

Bounds are physical: they scale with the model's masses, its actuators and its gravity, and stay where the
model's integrator is stable.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import mujoco
import numpy as np

from skat.effects import FACTOR, FAMILIES, Effect
from skat.simulators import contacts, edits
from skat.simulators.anatomy import (
    EULER,
    EXPLICIT_INTEGRATOR,
    INTEGRATOR,
    NO_DYNAMICS,
    TENDON_TRANSMISSION,
    Anatomy,
    actuator_name,
    drag_joint,
    tendon_name,
)
from skat.simulators.channels import BALL, FREE, HINGE, SLIDE, joint_name
from skat.simulators.friction import NEUTRAL

AXES = "xyz"
LINEAR_GAINS = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
LINEAR_BIASES = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
MAX_DELAY_IN_TRANSITIONS = 5
# Of a servo's control, where the model does not limit it.
LARGEST_OFFSET = 1.0
# Of factors on what a servo feeds back; and the error that no servo needs for its whole force, in m or rad: a turn.
GAIN_BOUNDS = (0.02, 20.0)
LARGEST_ERROR = (1.0, 2 * math.pi)
# Reality has no step: a coarser bound would be an estimate's end. So many steps are run for one of the model at most.
FINEST_TIMESTEP, MOST_STEPS = 0.01, 5
# Families on joints: what edits the model (None: the stepping does it), and a typical speed, acceleration or angle that
# makes a force of one unit of it, in SI.
JOINT_FAMILIES: dict[str, tuple[Callable[..., Any] | None, float]] = {
    "damping": (edits.add_damping, 1.0),
    "dry_friction": (edits.add_dry_friction, 1.0),
    "position_friction": (None, 1.0),
    "armature": (edits.add_armature, 10.0),
    "stiffness": (edits.add_stiffness, 1.0),
}
TENDON_FAMILIES: dict[str, Callable[..., Any]] = {
    "tendon_damping": edits.add_tendon_damping,
    "tendon_dry_friction": edits.add_tendon_friction,
    "tendon_stiffness": edits.add_tendon_stiffness,
}
# No geared joint needs more: with its inertia at the bound, the drive's whole force accelerates it by this, in rad/s2
# or m/s2; with its damping at the bound, it turns the joint at this, in rad/s or m/s.
LEAST_ACCELERATION, LEAST_SPEED = 5.0, 0.5
# Bounds of families of `friction.budget`; None: twice the force of the joint's drive. Others than its own are listed
# above.
FRICTION_BOUNDS: dict[str, tuple[float, float] | None] = {
    "stribeck": None,
    "stribeck_speed": (0.01, 50.0),
    "stribeck_exponent": (0.3, 10.0),
    **{family: (0.0, 2.0) for family in NEUTRAL if family.startswith("load_")},
}
LONGEST_LAG = 0.3  # s
LARGEST_SCALE = 100.0  # degrees for radians are 57
LARGEST_CONTROL = 10.0
LARGEST_PAYLOAD = 5.0
# Of the inertia of a joint: a motor's own, where the model has none.
LEAST_ROTOR = 0.02
# Of slides, m, and of hinges, rad.
WIDEST_PLAY = (0.02, 0.2)
# In 1/kg: what a tendon moves weighs less than the inverse of it, if it moves anything.
LEAST_MOBILITY = 1e-9
FIXED_TENDON = int(mujoco.mjtWrap.mjWRAP_JOINT)


@dataclass(frozen=True)
class Listing:
    """Effects, with the names of those that are no causes to choose from, of forces, and of those listed if asked for.

    ``mass[all]`` of a model with one body repeats ``mass[<body>]``. A constant force on a joint is nobody's cause, but
    shows how a joint would respond to one; there is one for each degree of freedom, in MuJoCo's order.
    """

    effects: tuple[Effect, ...]
    unlisted: frozenset[str]
    forces: tuple[str, ...]
    asked: frozenset[str]


def effect_listing(anatomy: Anatomy, frame_skip: int) -> Listing:
    """Return every effect of a compiled model."""
    model = anatomy.model
    effects: list[Effect] = []
    unlisted: list[str] = []
    for family in (
        _link_effects,
        _gravity_effects,
        _force_effects,
        _joint_effects,
        _tendon_effects,
        _actuator_effects,
        _contact_effects,
    ):
        for effect, listed in family(anatomy):
            effects.append(effect)
            if not listed:
                unlisted.append(effect.name)
    dt = frame_skip * model.opt.timestep
    if _acting(anatomy):
        bounds = (0.0, MAX_DELAY_IN_TRANSITIONS * dt)
        edit = partial(edits.delay_actuators, tuple(range(model.nu)))
        effects.append(_effect("delay", "action", bounds, edit, typical=dt))
    finer = [*_late_effects(anatomy, dt), *_servo_effects(anatomy), *_payload_effects(anatomy)]
    asked = {effect.name for effect, listed in finer if listed}
    unlisted += [effect.name for effect, listed in finer if not listed]
    effects += [effect for effect, _ in finer]
    bounds = (FINEST_TIMESTEP, float(max(1, frame_skip)))
    effects.append(_effect("timestep", None, bounds, edits.scale_timestep))
    forces = _joint_forces(anatomy)
    names = tuple(force.name for force in forces)
    repeated = [name for name, count in Counter(one.name for one in (*effects, *forces)).items() if count > 1]
    if repeated:
        raise ValueError(
            f"two effects of the model would be called {repeated[0]}: give one of the elements that this means "
            "another name ('all' stands for all of them)"
        )
    return Listing((*effects, *forces), frozenset((*unlisted, *names)), names, frozenset(asked))


def _joint_forces(anatomy: Anatomy) -> list[Effect]:
    model = anatomy.model
    forces: list[Effect] = []
    for joint in range(model.njnt):
        name, kind, dofs = joint_name(model, joint), anatomy.joint_kind(joint), anatomy.dofs_of(joint)
        ends = {FREE: [".x", ".y", ".z", ".rx", ".ry", ".rz"], BALL: [".rx", ".ry", ".rz"]}.get(kind, [""])
        for dof, end in zip(dofs, ends):
            straight = kind == SLIDE or end in (".x", ".y", ".z")
            limit = 10 * float(anatomy.force[dof])
            unit = FAMILIES["force"].unit[0 if straight else 1]
            forces.append(_effect("force", name + end, (-limit, limit), unit=unit, force=limit / 10))
    return forces


Found = Iterator[tuple[Effect, bool]]


def _effect(
    family: str,
    target: str | None,
    bounds: tuple[float, float],
    apply: Callable[..., Any] | None = None,
    *,
    unit: str | None = None,
    neutral: float | None = None,
    typical: float | None = None,
    force: float | None = None,
) -> Effect:
    """Return an effect made from its family's record.

    `force` is what a force that is typical of the joint or actuator amounts to, in the effect's unit: where the
    record's typical size is a share of the force, it is that share of it.
    """
    record = FAMILIES[family]
    if record.force_share is not None and force is not None:
        typical = record.force_share * force
    return Effect(
        family if target is None else f"{family}[{target}]",
        unit=record.unit[0] if unit is None else unit,
        neutral=record.neutral if neutral is None else neutral,
        bounds=bounds,
        apply=apply,
        typical=math.nan if typical is None else typical,
        force_share=record.force_share,
        aliases=tuple(f"{other}[{target}]" for other in record.aliases) if target else (),
    )


def _factor(name: str, low: float, high: float, apply: Callable[..., Any]) -> Effect:
    family, _, target = name.partition("[")
    return _effect(family, target.removesuffix("]") or None, (low, high), apply)


def _link_effects(anatomy: Anatomy) -> Found:
    model = anatomy.model
    massive = [body for body in anatomy.moving if model.body_mass[body] > 0]
    yield from _each_and_all("mass", massive, anatomy.body_name, (0.05, 20.0), edits.scale_mass)
    extended = [body for body in anatomy.moving if _has_length(anatomy, body)]
    meshes = {model.mesh(mesh).name: model.mesh_pos[mesh].copy() for mesh in range(model.nmesh)}
    stretch = partial(edits.scale_length, meshes)
    armatured = {joint for joint in range(model.njnt) if not _is_base(anatomy, joint)}
    yield from _each_and_all("length", extended, anatomy.body_name, (0.3, 3.0), stretch)
    rims = {body: anatomy.rims_of(body) for body in massive}
    wheels = [body for body, geoms in rims.items() if geoms]
    yield from _each_and_all(
        "radius", wheels, anatomy.body_name, (0.5, 2.0), partial(edits.scale_radius, rims)
    )
    for body in massive:
        turned_by = anatomy.turned_by(body)
        if turned_by and body == model.body_weldid[body]:
            edit = partial(edits.scale_inertia, body)
            # About one hinge only, it is the armature of that hinge.
            repeats = len(turned_by) == 1 and int(model.dof_jntid[turned_by[0]]) in armatured
            yield _factor(f"inertia[{anatomy.body_name(body)}]", 0.1, 10.0, edit), not repeats
    for body in massive:
        geoms = range(int(model.body_geomadr[body]), int(model.body_geomadr[body] + model.body_geomnum[body]))
        extent = max(
            [float(model.geom_rbound[geom] + np.linalg.norm(model.geom_pos[geom])) for geom in geoms] or [0.1]
        )
        for axis in range(3):
            if _shift_matters(anatomy, body, axis):
                limit, edit = max(extent, 1e-3), partial(edits.shift_centre_of_mass, body, axis)
                effect = _effect(
                    "centre_of_mass", f"{anatomy.body_name(body)}.{AXES[axis]}", (-limit, limit), edit
                )
                name = anatomy.body_name(body)
                yield replace(effect, aliases=(f"mass[{name}]", f"payload[{name}]")), True


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
    if anatomy.is_off("gravity") or not np.any(model.opt.gravity) or not anatomy.moving:
        return
    yield _factor("gravity", 0.0, 3.0, edits.scale_gravity), True
    for axis in range(2):
        if any(anatomy.reach[body][axis] for body in anatomy.moving):
            edit = partial(edits.tilt_gravity, axis)
            yield _effect("tilt", AXES[axis], (-0.7, 0.7), edit), True


def _force_effects(anatomy: Anatomy) -> Found:
    if not anatomy.moving:
        return
    mass = float(anatomy.model.body_subtreemass[anatomy.root])
    axes = [axis for axis in range(3) if anatomy.reach[anatomy.root][axis]]
    for axis in axes:
        bounds = (-20 * mass, 20 * mass)
        yield _effect("wind", AXES[axis], bounds, force=10 * mass), True
    slides = {axis: drag_joint(anatomy, axis) for axis in axes}
    drag = partial(_effect, "air_drag", bounds=(0.0, 10 * mass), force=10 * mass)
    for axis in axes:
        joint = slides[axis]
        edit = None if joint is None else partial(edits.add_quadratic_damping, (joint,))
        yield drag(AXES[axis], apply=edit), True
    if axes:
        joint = slides[axes[0]] if len(axes) == 1 else None
        edit = None if joint is None else partial(edits.add_quadratic_damping, (joint,))
        yield drag("all", apply=edit), len(axes) > 1


def _joint_effects(anatomy: Anatomy) -> Found:
    bodies = anatomy.model.jnt_bodyid
    joints = [joint for joint in range(anatomy.model.njnt) if bodies[joint] not in anatomy.soft_bodies]
    inner = [joint for joint in joints if joint not in anatomy.base_joints]
    bounds = {joint: _joint_bounds(anatomy, joint) for joint in joints}
    for joint in joints:
        kind = anatomy.joint_kind(joint)
        force = float(anatomy.force[anatomy.dofs_of(joint)].max())
        for family, (edit, motion) in JOINT_FAMILIES.items():
            if (_is_base(anatomy, joint) and family != "damping") or (
                kind == BALL and family == "position_friction"
            ):
                continue
            if _is_disabled(anatomy, family):
                continue
            yield (
                _effect(
                    family,
                    joint_name(anatomy.model, joint),
                    bounds[joint][family],
                    partial(edit, (joint,)) if edit else None,
                    unit=_joint_unit(family, {kind}),
                    force=force / motion,
                ),
                True,
            )
    for family in ("damping", "dry_friction"):
        edit, motion = JOINT_FAMILIES[family]
        together = [
            joint for joint in inner or joints if family == "damping" or anatomy.joint_kind(joint) != FREE
        ]
        if together and edit and not _is_disabled(anatomy, family):
            lows, highs = zip(*(bounds[joint][family] for joint in together))
            effect = _effect(
                family,
                "all",
                (max(lows), min(highs)),
                partial(edit, tuple(together)),
                unit=_joint_unit(family, {anatomy.joint_kind(joint) for joint in together}),
                force=min(float(anatomy.force[anatomy.dofs_of(joint)].max()) for joint in together) / motion,
            )
            yield effect, len(together) > 1


def _is_base(anatomy: Anatomy, joint: int) -> bool:
    """Whether a joint only says where the robot is: of a slide or hinge only where there are others."""
    joints = set(range(anatomy.model.njnt))
    is_free = anatomy.joint_kind(joint) == FREE
    return joint in anatomy.base_joints and (is_free or bool(joints - anatomy.base_joints))


def _joint_unit(family: str, kinds: set[int]) -> str:
    straight, angular = FAMILIES[family].unit
    present = [straight] * bool(kinds & {SLIDE, FREE}) + [angular] * bool(kinds & {HINGE, BALL, FREE})
    return ", ".join(present)


def _joint_bounds(anatomy: Anatomy, joint: int) -> dict[str, tuple[float, float]]:
    """Return the bounds of what is added to a joint, by family; no total falls below zero."""
    model, dofs = anatomy.model, anatomy.dofs_of(joint)
    inertia, force = float(anatomy.inertia[dofs].max()), float(anatomy.strength[dofs].max())
    damping, friction, armature = (
        float(values[dofs[0]]) for values in (model.dof_damping, model.dof_frictionloss, model.dof_armature)
    )
    stiffness = float(model.jnt_stiffness[joint])
    stable = float(anatomy.stable_rate[dofs].min())
    stable_spring = 1 / (model.opt.timestep**2 * max(float(model.dof_invweight0[dofs].max()), 1e-9))
    most_friction = _most_friction(force, friction)
    return {
        "damping": _damping_bounds(damping, inertia, stable, force),
        "dry_friction": (_taken_off(friction), most_friction),
        "position_friction": (0.0, most_friction),
        # A light link may not be stable without any.
        "armature": (_taken_off(0.95 * armature), max(10 * inertia, force / LEAST_ACCELERATION)),
        "stiffness": _stiffness_bounds(stiffness, force, stable_spring),
    }


def _damping_bounds(damping: float, inertia: float, stable: float, force: float = 0.0) -> tuple[float, float]:
    most = max(100 * max(damping, inertia), force / LEAST_SPEED)
    return _taken_off(damping), min(most, max(stable - damping, 0.1 * stable))


def _taken_off(value: float) -> float:
    """Return the lower bound of what is added to a value; one below zero, as of an over-centre spring, stays."""
    return min(0.0, -value)


def _most_friction(force: float, friction: float) -> float:
    return max(2 * force, 10 * friction)


def _stiffness_bounds(stiffness: float, force: float, stable: float) -> tuple[float, float]:
    return _taken_off(stiffness), min(max(10 * force, 10 * stiffness), stable)


def _tendon_effects(anatomy: Anatomy) -> Found:
    model = anatomy.model
    for tendon in range(model.ntendon):
        if anatomy.tendon_ranges[0][tendon] < LEAST_MOBILITY:
            continue
        bounds = _tendon_bounds(anatomy, tendon)
        force = anatomy.tendon_force(tendon)
        reach = {"tendon_stiffness": max(float(anatomy.tendon_ranges[1][tendon]), 1e-9)}
        for family, edit in TENDON_FAMILIES.items():
            if _is_disabled(anatomy, family):
                continue
            edit = partial(edit, tendon)
            share = force / reach.get(family, 1.0)
            effect = _effect(family, tendon_name(model, tendon), bounds[family], edit, force=share)
            yield effect, not _is_of_one_joint(model, tendon)


def _tendon_bounds(anatomy: Anatomy, tendon: int) -> dict[str, tuple[float, float]]:
    """Return the bounds of what is added to a tendon, by family; no total falls below zero."""
    model, force = anatomy.model, anatomy.tendon_force(tendon)
    damping, friction, stiffness = (
        float(values[tendon])
        for values in (model.tendon_damping, model.tendon_frictionloss, model.tendon_stiffness)
    )
    mobility, reach = (float(values[tendon]) for values in anatomy.tendon_ranges)
    # Integrators that treat the damping of joints implicitly need not do so with that of tendons.
    stable = 1 / (model.opt.timestep * mobility)
    return {
        "tendon_damping": _damping_bounds(damping, 1 / mobility, stable),
        "tendon_dry_friction": (_taken_off(friction), _most_friction(force, friction)),
        "tendon_stiffness": _stiffness_bounds(
            stiffness, force / max(reach, 1e-9), stable / model.opt.timestep
        ),
    }


def _is_of_one_joint(model: mujoco.MjModel, tendon: int) -> bool:
    """Whether what a tendon does is what its only joint could do itself."""
    first = int(model.tendon_adr[tendon])
    return bool(model.tendon_num[tendon] == 1 and model.wrap_type[first] == FIXED_TENDON)


def _is_disabled(anatomy: Anatomy, family: str) -> bool:
    """Whether the model disables what an effect on joints or tendons acts through."""
    flags = {"stiffness": "spring", "damping": "damper", "friction": "frictionloss"}
    return any(anatomy.is_off(flag) for kind, flag in flags.items() if family.endswith(kind))


def _acting(anatomy: Anatomy) -> list[int]:
    """Return the actuators that are not disabled."""
    model = anatomy.model
    if anatomy.is_off("actuation"):
        return []
    return [
        index
        for index in range(model.nu)
        if not (
            0 <= model.actuator_group[index] < 31
            and model.opt.disableactuator >> model.actuator_group[index] & 1
        )
    ]


def _actuator_effects(anatomy: Anatomy) -> Found:
    name = partial(actuator_name, anatomy.model)
    model = anatomy.model
    acting = _acting(anatomy)
    # The parameters of muscles and of motors with an electrical side are lengths, speeds, resistances as well, those of
    # a plugin are its own.
    simple = _simple(anatomy)
    yield from _each_and_all("gain", simple, name, (-3.0, 3.0), edits.scale_gain)
    limited = [index for index in acting if model.actuator_forcelimited[index]]
    yield from _each_and_all("force_limit", limited, name, (0.02, 20.0), edits.scale_force_limit)
    # Without damping of its own, a servo's stiffness is all of its gain.
    damped = [
        index for index in simple if _is_servo(model, index) and model.actuator_biasprm[index, 1:3].all()
    ]
    lows = [_softest(anatomy, index) for index in damped]
    for index, low in zip(damped, lows):
        edit = partial(edits.scale_stiffness_of_servo, (index,))
        yield _factor(f"kp[{name(index)}]", low, GAIN_BOUNDS[1], edit), True
    if damped:
        edit = partial(edits.scale_stiffness_of_servo, tuple(damped))
        yield _factor("kp[all]", max(lows), GAIN_BOUNDS[1], edit), len(damped) > 1
    yield from _velocity_gain_effects(
        anatomy, [index for index in simple if _has_velocity_gain(model, index)]
    )
    for index in simple:
        if _is_servo(model, index) and not _integrates(model, index):
            low, high = model.actuator_ctrlrange[index]
            limit = float(high - low) / 2 if model.actuator_ctrllimited[index] else LARGEST_OFFSET
            edit = partial(edits.offset_command, index)
            unit = _control_unit(anatomy, index)
            yield _effect("offset", name(index), (-limit, limit), edit, unit=unit), True


def _softest(anatomy: Anatomy, actuator: int) -> float:
    """Return the least factor on the position gain of a servo: a limit of its force tells how soft it may be."""
    model, low = anatomy.model, GAIN_BOUNDS[0]
    kind = (
        anatomy.joint_kind(int(model.actuator_trnid[actuator, 0]))
        if actuator in anatomy.joint_driven
        else None
    )
    if kind not in (HINGE, SLIDE) or not model.actuator_forcelimited[actuator]:
        return low
    stiffness = abs(float(model.actuator_biasprm[actuator, 1])) * float(model.actuator_gear[actuator, 0]) ** 2
    return min(low, anatomy.capacity(actuator) / (LARGEST_ERROR[kind == HINGE] * max(stiffness, 1e-9)))


def _velocity_gain_effects(anatomy: Anatomy, actuators: Sequence[int]) -> Found:
    """Yield the factor on the velocity feedback of each actuator, and on that of all.

    Where damping does the same, a factor is listed only if damping cannot fall as low, and then up to 1.
    """
    model, low = anatomy.model, GAIN_BOUNDS[0]
    highs, any_listed = [], False
    for index in actuators:
        high, damping = _highest_velocity_gain(anatomy, index), _replaceable_damping(anatomy, index)
        own = -float(model.actuator_biasprm[index, 2] * model.actuator_gear[index, 0] ** 2)
        listed = damping is None or (1 - low) * own > damping
        if damping is not None and listed:
            high = 1.0
        highs.append(high)
        any_listed |= listed
        edit = partial(edits.scale_velocity_gain_of_servo, (index,))
        yield _factor(f"kv[{actuator_name(model, index)}]", low, high, edit), listed
    if actuators:
        edit = partial(edits.scale_velocity_gain_of_servo, tuple(actuators))
        yield _factor("kv[all]", low, min(highs), edit), any_listed and len(actuators) > 1


def _has_velocity_gain(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator feeds its velocity back, beside other forces, and not against a velocity to follow."""
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    is_affine = int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
    has_other = gain[:3].any() or bias[:2].any()
    follows_velocity = _is_servo(model, actuator) and bias[1] == 0
    return bool(is_affine and bias[2] != 0 and has_other and not follows_velocity)


def _replaceable_damping(anatomy: Anatomy, actuator: int) -> float | None:
    """Return the damping of an actuator's joint or tendon, None if velocity feedback is not the same as more of it.

    It is not where a limit cuts the force off. Euler's integrator treats the damping of joints implicitly, but not
    what actuators do, so that these differ by its time step.
    """
    model, target = anatomy.model, int(anatomy.model.actuator_trnid[actuator, 0])
    if model.actuator_forcelimited[actuator]:
        return None
    if actuator in anatomy.joint_driven and anatomy.joint_kind(target) in (HINGE, SLIDE):
        euler = int(model.opt.integrator) == EULER and not anatomy.damps_explicitly
        differs = model.jnt_actfrclimited[target] or euler
        return None if differs else float(model.dof_damping[model.jnt_dofadr[target]])
    if int(model.actuator_trntype[actuator]) == TENDON_TRANSMISSION:
        limited = model.tendon_actfrclimited[target] or model.jnt_actfrclimited.any()
        return None if limited else float(model.tendon_damping[target])
    return None


def _highest_velocity_gain(anatomy: Anatomy, actuator: int) -> float:
    """Return the factor up to which an integrator that treats actuators explicitly stays stable."""
    model = anatomy.model
    if int(model.opt.integrator) not in (EULER, EXPLICIT_INTEGRATOR):
        return GAIN_BOUNDS[1]
    share: float = model.opt.timestep * float(
        anatomy.actuator_mobility[actuator] * abs(model.actuator_biasprm[actuator, 2])
    )
    return min(GAIN_BOUNDS[1], 1 + max(1 - share, 0.1) / max(share, 1e-9))


def _is_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator's force is proportional to what its control lacks of a position or a velocity."""
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    is_affine = int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
    return bool(is_affine and gain[0] != 0 and not gain[1:3].any() and -gain[0] in bias[1:3])


def _integrates(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator's control is a rate, which it integrates."""
    return int(model.actuator_dyntype[actuator]) == INTEGRATOR


def _control_unit(anatomy: Anatomy, actuator: int) -> str:
    """Return the unit of a control: of what a servo follows, or of a motor's force, as far as transmissions tell."""
    model, joint = anatomy.model, int(anatomy.model.actuator_trnid[actuator, 0])
    kind = anatomy.joint_kind(joint) if actuator in anatomy.joint_driven else None
    if kind in (HINGE, SLIDE) and model.actuator_gear[actuator, 0] == 1:
        if _is_servo(model, actuator):
            is_of_position = model.actuator_biasprm[actuator, 1] != 0 and not _integrates(model, actuator)
            return ("m" if kind == SLIDE else "rad") + ("" if is_of_position else "/s")
        if model.actuator_gainprm[actuator, 0] == 1 and model.actuator_dyntype[actuator] == NO_DYNAMICS:
            return "N" if kind == SLIDE else "N m"
    return f"unit of ctrl.{actuator_name(model, actuator)}"


def _simple(anatomy: Anatomy) -> list[int]:
    """Return the actuators whose force is affine in the place and the speed of what they move."""
    model = anatomy.model
    return [
        index
        for index in _acting(anatomy)
        if model.actuator_plugin[index] < 0
        and int(model.actuator_gaintype[index]) in LINEAR_GAINS
        and int(model.actuator_biastype[index]) in LINEAR_BIASES
    ]


def _late_effects(anatomy: Anatomy, dt: float) -> Found:
    """Yield what lies between the commands and the actuators."""
    model, acting = anatomy.model, _acting(anatomy)
    name = partial(actuator_name, model)
    longest = (0.0, max(LONGEST_LAG, MAX_DELAY_IN_TRANSITIONS * dt))
    for index in acting:
        edit = partial(edits.delay_actuators, (index,))
        bounds = (0.0, MAX_DELAY_IN_TRANSITIONS * dt)
        yield _effect("delay", name(index), bounds, edit, typical=dt), len(acting) > 1
    filtered = [index for index in acting if model.actuator_dyntype[index] == NO_DYNAMICS]
    for index in filtered:
        edit = partial(edits.filter_commands, (index,))
        yield _effect("lag", name(index), longest, edit), len(filtered) > 1
    if filtered:
        yield _effect("lag", "all", longest, partial(edits.filter_commands, tuple(filtered))), True
    for index in _simple(anatomy):
        servo, integrates = _is_servo(model, index), _integrates(model, index)
        unit, limit = _control_unit(anatomy, index), LARGEST_OFFSET if servo else LARGEST_CONTROL
        if model.actuator_ctrllimited[index]:
            low, high = model.actuator_ctrlrange[index]
            limit = float(high - low) / 2
        if not model.actuator_gainprm[index, 1:3].any():
            # Of a control that is integrated no gain and no force makes up for what comes before.
            both = (edits.shift_command, edits.scale_command)
            shift, scale = (None if integrates else partial(one, index) for one in both)
            target = f"ctrl.{name(index)}"
            bias = _effect("bias", target, (-limit, limit), shift, unit=unit, typical=0.1 * limit)
            yield bias, integrates or not servo
            bounds = (-LARGEST_SCALE, LARGEST_SCALE)
            yield _effect("scale", target, bounds, scale, typical=0.2), servo
        # A servo with a filter follows what this holds, and not its control.
        if not model.actuator_biasprm[index, 1] or integrates or model.actuator_dyntype[index] == NO_DYNAMICS:
            yield _effect("dead_zone", name(index), (0.0, 0.9 * limit), unit=unit, typical=0.01 * limit), True


def _servo_effects(anatomy: Anatomy) -> Found:
    """Yield what makes a geared servo of a motor: late and limited torque, friction under load, play."""
    model = anatomy.model
    name = partial(actuator_name, model)
    for index in _simple(anatomy):
        if model.actuator_dyntype[index] == NO_DYNAMICS:
            edit = partial(edits.prepare_lag, index)
            feeds_back = bool(model.actuator_biasprm[index, 1:3].any())
            yield _effect("lag_torque", name(index), (0.0, LONGEST_LAG), edit), feeds_back
        if index not in anatomy.joint_driven:
            continue
        kind = anatomy.joint_kind(int(model.actuator_trnid[index, 0]))
        if kind not in (HINGE, SLIDE):
            continue
        angular = int(kind == HINGE)
        capacity = anatomy.capacity(index) / max(abs(float(model.actuator_gear[index, 0])), 1e-9)
        if not capacity > 0:
            continue
        known = bool(model.actuator_ctrllimited[index] or model.actuator_forcelimited[index])
        edit = partial(edits.prepare_tiring, index, anatomy.largest_control(index))
        bounds = (0.0, capacity / LEAST_SPEED)
        unit = FAMILIES["torque_speed"].unit[angular]
        tiring = _effect("torque_speed", name(index), bounds, edit, unit=unit, force=capacity / 10)
        yield tiring, known or _is_servo(model, index)
        if not model.actuator_forcelimited[index] and (known or _is_servo(model, index)):
            edit = partial(edits.limit_force, index)
            unit = FAMILIES["current_limit"].unit[angular]
            bounds = (0.02 * capacity, capacity)
            limit = _effect(
                "current_limit", name(index), bounds, edit, unit=unit, neutral=capacity, force=capacity
            )
            yield limit, True
    for joint in range(model.njnt):
        kind = anatomy.joint_kind(joint)
        if kind not in (HINGE, SLIDE) or _is_base(anatomy, joint):
            continue
        target, angular = joint_name(model, joint), int(kind == HINGE)
        dof = int(model.jnt_dofadr[joint])
        force, strength = float(anatomy.force[dof]), float(anatomy.strength[dof])
        driven = joint in anatomy.actuated
        for family in () if _is_disabled(anatomy, "dry_friction") else FRICTION_BOUNDS:
            record = FAMILIES[family]
            unit = record.unit[min(angular, len(record.unit) - 1)]
            bounds = FRICTION_BOUNDS[family] or (0.0, 2 * strength)
            listed = family in ("stribeck", "load_friction") and driven
            neutral = NEUTRAL[family]
            yield _effect(family, target, bounds, unit=unit, neutral=neutral, force=force), listed
        if driven and model.jnt_bodyid[joint] not in anatomy.soft_bodies:
            rotor = LEAST_ROTOR * float(anatomy.inertia[dof])
            edit = partial(edits.add_play, target, rotor)
            widest, unit = WIDEST_PLAY[angular], FAMILIES["backlash"].unit[angular]
            typical = 0.01 if angular else 0.001
            play = _effect("backlash", target, (0.0, widest), edit, unit=unit, typical=typical)
            zones = (f"dead_zone[{name(one)}]" for one in anatomy.drives[dof])
            yield replace(play, aliases=tuple(zones)), bool(model.joint(joint).name)


def _payload_effects(anatomy: Anatomy) -> Found:
    """Yield a point mass on each body, and, for it to be somewhere else than at the centre of mass, its place."""
    model = anatomy.model
    for body in anatomy.moving:
        if model.body_mass[body] <= 0:
            continue
        target, mass = anatomy.body_name(body), float(model.body_mass[body])
        most = max(LARGEST_PAYLOAD * mass, float(model.body_subtreemass[anatomy.root]))
        low, high = anatomy.box(body)
        load = _effect("payload", target, (0.0, most), typical=FACTOR * mass)
        yield replace(load, aliases=(f"mass[{target}]",)), True
        for axis in range(3):
            bounds, centre = (float(low[axis]), float(high[axis])), float(model.body_ipos[body, axis])
            place = f"{target}.{AXES[axis]}"
            typical = max(float(high[axis] - low[axis]) / 4, 1e-3)
            yield _effect("payload", place, bounds, unit="m", neutral=centre, typical=typical), False


def _contact_effects(anatomy: Anatomy) -> Found:
    model, pairs = anatomy.model, anatomy.pairs
    if model.opt.enableflags & contacts.OVERRIDE:  # All contacts have the parameters of the override.
        return
    rough = tuple(pair for pair in pairs if pair.has_friction)
    explicit = [pair for pair in rough if pair.is_explicit]
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
    soft = contacts.flex_condims(model)
    if rough or any(condim > 1 for condim in soft):
        yield _factor("contact_friction[all]", 0.01, 20.0, contacts.scale_all_friction), True
    if rough:
        yield from _each_pair_and_all("contact_anisotropy", rough, (0.05, 20.0), contacts.set_anisotropy)
    if pairs or soft:
        for effect, listed in _each_pair_and_all(
            "restitution", pairs, (0.05, 5.0), contacts.scale_damping_ratio
        ):
            if effect.target == "all":
                effect = replace(effect, apply=contacts.scale_all_damping_ratios)
            yield effect, listed


def _each_pair_and_all(
    family: str,
    pairs: tuple[contacts.ContactPair, ...],
    bounds: tuple[float, float],
    edit: Callable[..., Any],
) -> Found:
    """Yield the factor of each pair, and that of all; only explicit pairs are listed, as others are many."""
    for pair in pairs:
        listed = pair.is_explicit and len(pairs) > 1
        yield _factor(f"{family}[{pair.name}]", *bounds, partial(edit, (pair,))), listed
    yield _factor(f"{family}[all]", *bounds, partial(edit, pairs)), True
