"""What a model may lack that a log needs: whether its root is fixed or free, and motors on its joints."""

import math
from dataclasses import replace

import mujoco

from skat.simulators.channels import free_name
from skat.simulators.source import ModelSource, write_xml
from skat.simulators.urdf import root_link, says_what_its_root_is

FREE, HINGE, SLIDE = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE


def with_base(source: ModelSource, base: str | None) -> ModelSource:
    """Return the model with its root welded to the world where it is, or moving freely.

    Parameters
    ----------
    source : ModelSource
    base : {"fixed", "free"} or None
        None: as it is.

    Raises
    ------
    ValueError
        If there is no such base, or no root to move.
    """
    if base is None:
        if source.urdf is not None and not says_what_its_root_is(source.urdf):
            raise ValueError(
                "the URDF has no joint to the world, so it does not say whether its root link "
                f"{root_link(source.urdf)!r} is bolted down or moves freely: say base='fixed' or base='free' (on the "
                "command line --base fixed)"
            )
        return source
    if base not in ("fixed", "free"):
        raise ValueError(f"base must be 'fixed' or 'free'; got {base!r}")
    spec = source.spec()
    joints = [joint for body in spec.worldbody.bodies for joint in body.joints if joint.type == FREE]
    if base == "fixed" and joints:
        names = []
        for joint in joints:
            names.append(joint.parent.name)
            poses = [(list(key.qpos), list(key.qvel)) for key in spec.keys]
            place, dof = _addresses(spec, joint)
            spec.delete(joint)
            for key, (qpos, qvel) in zip(spec.keys, poses):
                key.qpos, key.qvel = qpos[:place] + qpos[place + 7 :], qvel[:dof] + qvel[dof + 6 :]
        note = f"{', '.join(names)} is welded to the world where the model places it (base='fixed')."
    elif base == "free" and not joints:
        moving = [body for body in spec.worldbody.bodies if _moves(body)]
        if len(moving) != 1 or moving[0].joints:
            names = [body.name for body in moving]
            raise ValueError(
                f"base='free' needs one body on the world that is welded to it and carries the joints; there are "
                f"{len(names)}: {', '.join(names)}"
            )
        for key in list(spec.keys):
            spec.delete(key)
        moving[0].add_freejoint(
            name="root" if "root" not in {joint.name for joint in spec.joints} else "root_free"
        )
        note = f"{moving[0].name} moves freely (base='free')."
    else:
        return source
    return replace(source, xml=write_xml(spec), notes=(*source.notes, note))


def _addresses(spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> tuple[int, int]:
    """Return where in qpos and in qvel a joint of a body on the world begins."""
    model = spec.copy().compile()
    row = next(index for index, one in enumerate(spec.joints) if one == joint)
    return int(model.jnt_qposadr[row]), int(model.jnt_dofadr[row])


def _moves(body: mujoco.MjsBody) -> bool:
    return bool(body.joints) or any(_moves(child) for child in body.bodies)


def with_motors(source: ModelSource, motors: str | None) -> ModelSource:
    """Return the model with an actuator on each joint that moves, of the joint's name.

    Parameters
    ----------
    source : ModelSource
        Without actuators.
    motors : str or None
        ``"torque"``: the control is the torque or force; ``"position:kp,kv"``: it is a position that a servo with these
        gains pulls to, with an integrator that is implicit in its damping, as joints of a URDF may be light. Limited to
        what the model says of each joint (a URDF's effort). ``"none"``: nothing drives them, and a log's commands are
        left aside. None: nobody has said.

    Raises
    ------
    ValueError
        If there are no such motors, or the model has actuators.
    """
    if motors is None or motors == source.motors:
        return source
    if motors == "none":
        return replace(source, motors=motors)
    kind, _, gains = motors.partition(":")
    try:
        kp, kv = (float(gain) for gain in gains.split(",")) if kind == "position" else (0.0, 0.0)
    except ValueError:
        kind, kp, kv = "", 0.0, 0.0
    if kind not in ("torque", "position") or (kind == "torque" and gains) or not 0 <= min(kp, kv) < math.inf:
        raise ValueError(
            f"motors must be 'torque', 'position:kp,kv', such as position:20,0.5, or 'none'; got {motors!r}"
        )
    spec = source.spec()
    if spec.actuators:
        raise ValueError(
            f"the model has {len(spec.actuators)} actuators of its own; motors are added to models without any, such "
            "as a URDF"
        )
    follows = {equality.name1 for equality in spec.equalities if equality.type == mujoco.mjtEq.mjEQ_JOINT}
    limits = []
    for index, joint in enumerate(spec.joints):
        if joint.type not in (HINGE, SLIDE) or joint.name in follows:
            continue
        joint.name = joint.name or free_name(f"joint{index}", [one.name for one in spec.joints])
        actuator = spec.add_actuator(name=joint.name, target=joint.name)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        low, high = joint.actfrcrange
        if high > low:  # from here on it is the motor's, whose limit may turn out to be another one
            actuator.forcerange, actuator.forcelimited = (low, high), True
            joint.actfrcrange, joint.actfrclimited = (0, 0), False
            limits.append(f"{joint.name} {high:g}")
        if kind == "torque":
            actuator.set_to_motor()
        else:
            actuator.set_to_position(kp=kp, kv=kv)
    if kind == "position" and spec.option.integrator == mujoco.mjtIntegrator.mjINT_EULER:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    of = "a torque motor" if kind == "torque" else f"a position servo (kp {kp:g}, kv {kv:g})"
    driven = ", ".join(actuator.name for actuator in spec.actuators)
    note = f"Added {of} on {driven}; limits of effort: {', '.join(limits) or 'none'}."
    return replace(source, xml=write_xml(spec), motors=motors, notes=(*source.notes, note))
