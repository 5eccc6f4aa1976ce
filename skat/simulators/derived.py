"""What MuJoCo's compiler derives from masses, lengths and poses, written down before effects change these."""

import warnings

import mujoco
import numpy as np

from skat.simulators.channels import free_name
from skat.simulators.edits import heed_inertials, multiply_mass, orientation
from skat.simulators.tables import Array

BODY, SITE = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_SITE
QUATERNION = mujoco.mjtOrientation.mjORIENTATION_QUAT
MUSCLE = (mujoco.mjtGain.mjGAIN_MUSCLE, mujoco.mjtBias.mjBIAS_MUSCLE)
CONNECT, WELD = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD
ALIGN, ALIGN_NOT = mujoco.mjtAlignFree.mjALIGNFREE_TRUE, mujoco.mjtAlignFree.mjALIGNFREE_FALSE
Pose = tuple[Array, Array]  # place and unit quaternion


def write_down(spec: mujoco.MjSpec) -> None:
    """Put into a spec, in place, the numbers that its compiler would derive anew from edited ones.

    So that an effect changes what it says and nothing else: a heavier link is not made lighter again by
    ``settotalmass`` or ``boundmass``, nor its servo more damped by ``dampratio`` or its muscle stronger, the two ends
    of a closed loop stay on their links, and the frame of a free body stays where ``align`` had put it.
    """
    _frames(spec)
    _masses(spec)
    model = _compiled(spec)
    _controllers(spec, model)
    _muscles(spec, model)
    _springs(spec, model)
    _loops(spec, model)


def _compiled(spec: mujoco.MjSpec, *, fusestatic: bool = False) -> mujoco.MjModel:
    """Return the compiled model, its bodies in the spec's order unless static ones are fused."""
    copy = spec.copy()
    copy.compiler.fusestatic = fusestatic
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return copy.compile()


def _frames(spec: mujoco.MjSpec) -> None:
    """Put the frame of each free body where the compiler aligns it with the body's mass, and have it align no more.

    Except in models with scaled frames, where places in the body and around it have other units.
    """
    if any(np.any(frame.scale != 1) for frame in spec.frames):
        return
    joints = [index for index, joint in enumerate(spec.joints) if _may_align(joint)]
    fused = spec.compiler.fusestatic  # so that a body is aligned together with what is welded to it
    aligned = _compiled(spec, fusestatic=fused) if joints else None
    spec.compiler.alignfree = False  # written MJCF has no other way to say so
    if aligned is None:
        return
    for index in joints:
        spec.joints[index].align = ALIGN_NOT
    given, alone = _compiled(spec, fusestatic=fused), _compiled(spec)
    for index in joints:
        row, own, body = given.jnt_bodyid[index], alone.jnt_bodyid[index], spec.joints[index].parent
        same = (
            np.array_equal(getattr(aligned, name)[row], getattr(given, name)[row])
            for name in ("body_ipos", "body_iquat")
        )
        if all(same):
            continue
        shift = given.body_ipos[row], given.body_iquat[row]
        back = _inverse(*shift)
        if body.explicitinertial or not body.geoms:
            inertial = alone.body_ipos[own], alone.body_iquat[own]
            _place_inertial(body, inertial[1], _product(*back, *inertial))
        body.pos, body.quat = _product(
            body.pos, orientation(body.quat, body.alt, body.compiler, spec), *shift
        )
        body.alt.type = QUATERNION
        parts = [*body.geoms, *body.sites, *body.cameras, *body.lights, *body.bodies, *body.frames]
        outer = [part for part in parts if part.frame is None]
        frame = body.add_frame(pos=back[0], quat=back[1])
        for part in outer:
            part.set_frame(frame)


def _may_align(joint: mujoco.MjsJoint) -> bool:
    automatic = joint.align == mujoco.mjtAlignFree.mjALIGNFREE_AUTO and joint.compiler.alignfree
    return bool(joint.type == mujoco.mjtJoint.mjJNT_FREE and (automatic or joint.align == ALIGN))


def _place_inertial(body: mujoco.MjsBody, axes: Array, pose: Pose) -> None:
    """Put a body's explicit inertia, along the given principal axes, to another pose in the body's frame."""
    body.explicitinertial = True
    if not np.isnan(body.fullinertia[0]):
        xx, yy, zz, xy, xz, yz = body.fullinertia
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, axes)
        turn = matrix.reshape(3, 3)
        body.inertia = np.diag(turn.T @ [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] @ turn)
        body.fullinertia = np.full(6, np.nan)
    body.ialt.type = QUATERNION
    body.ipos, body.iquat = pose


def _product(place: Array, turn: Array, inner_place: Array, inner_turn: Array) -> Pose:
    """Return a pose that is given in the frame of another."""
    found = np.empty(3), np.empty(4)
    mujoco.mju_mulPose(*found, place, turn, inner_place, inner_turn)
    return found


def _inverse(place: Array, turn: Array) -> Pose:
    found = np.empty(3), np.empty(4)
    mujoco.mju_negPose(*found, place, turn)
    return found


def _masses(spec: mujoco.MjSpec) -> None:
    """Write down masses and inertias that bounds decide, and then scale all to their total, as the compiler does."""
    compiler = spec.compiler
    total, compiler.settotalmass = compiler.settotalmass, -1
    if compiler.boundmass > 0 or compiler.boundinertia > 0:
        bounded = _compiled(spec)
        compiler.boundmass = compiler.boundinertia = 0
        try:
            free = _compiled(spec)
        except ValueError:  # A body that moves has no mass but for the bounds: all are written down.
            free = None
        heed_inertials(spec)
        for index, body in enumerate(spec.bodies):
            same = free is not None and all(
                np.array_equal(getattr(free, name)[index], getattr(bounded, name)[index])
                for name in ("body_mass", "body_inertia")
            )
            if index and not same:
                body.explicitinertial = True
                body.fullinertia = np.full(6, np.nan)
                body.ialt.type = QUATERNION
                body.mass, body.inertia = bounded.body_mass[index], bounded.body_inertia[index]
                body.ipos, body.iquat = bounded.body_ipos[index], bounded.body_iquat[index]
    if total > 0:
        multiply_mass(range(len(spec.bodies)), spec, total / float(np.sum(_compiled(spec).body_mass)))


def _controllers(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Replace a damping ratio, which a servo's third parameter is while it is positive, by the damping."""
    for index, actuator in enumerate(spec.actuators):
        if actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE and actuator.biasprm[2] > 0:
            actuator.biasprm = model.actuator_biasprm[index]


def _muscles(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Replace a negative peak force, which means one that accelerates the load so much, and write down ranges."""
    spec.compiler.LRopt.useexisting = True
    for index, actuator in enumerate(spec.actuators):
        actuator.lengthrange = model.actuator_lengthrange[index]
        for parameters, kind in (
            (actuator.gainprm, actuator.gaintype),
            (actuator.biasprm, actuator.biastype),
        ):
            if kind in MUSCLE and parameters[2] < 0:
                parameters[2] = parameters[3] / max(model.actuator_acc0[index], mujoco.mjMINVAL)


def _springs(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    for index, joint in enumerate(spec.joints):
        if np.any(joint.springdamper):
            joint.stiffness[0] = model.jnt_stiffness[index]
            joint.damping[0] = model.dof_damping[model.jnt_dofadr[index]]
            joint.springdamper = np.zeros(2)
    for index, tendon in enumerate(spec.tendons):
        if tendon.springlength[0] == -1:
            tendon.springlength = model.tendon_lengthspring[index]


def _loops(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Tie what connects two bodies to a site on each of them, where the compiler had put it."""
    for index, equality in enumerate(spec.equalities):
        if equality.objtype != BODY or equality.type not in (CONNECT, WELD):
            continue
        # The model's own sites have taken the default over; the new ones it would place elsewhere.
        default = spec.default.site
        default.alt.type, default.fromto = QUATERNION, np.full(6, np.nan)
        default.type, default.meshname = mujoco.mjtGeom.mjGEOM_SPHERE, ""
        data, first, second = model.eq_data[index], model.eq_obj1id[index], model.eq_obj2id[index]
        straight = np.array([1.0, 0.0, 0.0, 0.0])
        ends = [(first, data[:3], straight), (second, data[3:6], straight)]
        if equality.type == WELD:
            ends = [(first, data[3:6], data[6:10]), (second, data[:3], straight)]
        names = []
        for end, (body, place, turn) in enumerate(ends, start=1):
            name = free_name(f"equality{index}_{end}", [site.name for site in spec.sites])
            spec.bodies[body].add_site(spec.default, name=name, pos=place, quat=turn)
            names.append(name)
        equality.objtype, (equality.name1, equality.name2) = SITE, names
