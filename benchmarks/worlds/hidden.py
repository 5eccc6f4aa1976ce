"""What is hidden in robots that is a property of a model: edits of a text of MJCF, or of compiled arrays.

By the names that ``skat`` gives to effects, in plain MuJoCo.
"""

import functools
import re
import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np

from worlds.models import actuator_names, hinges


@functools.cache
def nominal_model(text):
    """Return the compiled model; callers do not change it."""
    return mujoco.MjModel.from_xml_string(text)


def channel_names(model):
    """Return the names of the columns of states."""
    qpos, qvel = [], []
    for joint in range(model.njnt):
        name = model.joint(joint).name
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            qpos += [f"qpos.{name}.{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz")]
            qvel += [f"qvel.{name}.{part}" for part in ("vx", "vy", "vz", "wx", "wy", "wz")]
        else:
            qpos.append(f"qpos.{name}")
            qvel.append(f"qvel.{name}")
    return qpos + qvel


def family_of(name):
    return name.partition("[")[0]


def target_of(name):
    return re.search(r"\[(.*)\]$", name).group(1) if "[" in name else None


def edited_model(text, truth):
    """Return the compiled model with causes in it that are properties of a model."""
    written = [name for name in truth if family_of(name) in ("centre_of_mass", "length")]
    if written:
        tree = ElementTree.fromstring(text)
        for name in written:
            _edit_text(tree, name, truth[name])
        text = ElementTree.tostring(tree, encoding="unicode")
    model = mujoco.MjModel.from_xml_string(text)
    for name, value in truth.items():
        _edit_arrays(model, family_of(name), target_of(name), value)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _edit_text(tree, name, value):
    family, target = family_of(name), target_of(name)
    wanted = target.rsplit(".", 1)[0] if family == "centre_of_mass" else target
    bodies = [body for body in tree.find("worldbody").iter("body") if body.get("name") == wanted]
    if not bodies or bodies[0].find("inertial") is None:
        raise ValueError(f"{name} needs a body of that name with an inertial")
    (body,) = bodies
    inertial = body.find("inertial")
    centre = [float(part) for part in inertial.get("pos").split()]
    if family == "centre_of_mass":
        centre["xyz".index(target[-1])] += value
        inertial.set("pos", " ".join(map(repr, centre)))
        return
    # Joints are at the origin of their bodies here, so that a link grows from there.
    inertial.set("pos", " ".join(repr(value * part) for part in centre))
    inertial.set(
        "diaginertia", " ".join(repr(value**2 * float(part)) for part in inertial.get("diaginertia").split())
    )
    for part in [*body.findall("body"), *body.findall("geom")]:
        for attribute in ("pos", "fromto"):
            if part.get(attribute):
                part.set(attribute, " ".join(repr(value * float(one)) for one in part.get(attribute).split()))


def _edit_arrays(model, family, target, value):
    if family in ("mass", "inertia"):
        bodies = slice(1, None) if target == "all" else model.body(target).id
        if family == "mass":
            model.body_mass[bodies] *= value
        model.body_inertia[bodies] *= value
    elif family == "gravity":
        model.opt.gravity[:] *= value
    elif family == "tilt":
        gravity = -model.opt.gravity[2]
        model.opt.gravity[:] = 0, 0, -gravity * np.cos(value)
        model.opt.gravity["xy".index(target)] = gravity * np.sin(value)
    elif family in ("damping", "dry_friction", "armature"):
        field_name = {
            "damping": "dof_damping",
            "dry_friction": "dof_frictionloss",
            "armature": "dof_armature",
        }[family]
        joints = hinges(model) if target == "all" else [model.joint(target).id]
        getattr(model, field_name)[[model.jnt_dofadr[joint] for joint in joints]] += value
    elif family == "stiffness":
        model.jnt_stiffness[hinges(model) if target == "all" else model.joint(target).id] += value
    elif family in ("gain", "kp", "kv", "offset"):
        names = actuator_names(model)
        for index in range(model.nu) if target == "all" else [names.index(target)]:
            if family == "gain":
                model.actuator_gainprm[index, 0] *= value
                model.actuator_biasprm[index, :3] *= value
            elif family == "kp":
                model.actuator_gainprm[index, 0] *= value
                model.actuator_biasprm[index, 1] *= value
            elif family == "kv":
                model.actuator_biasprm[index, 2] *= value
            else:
                model.actuator_biasprm[index, 0] += model.actuator_gainprm[index, 0] * value
    elif family == "contact_friction":
        model.geom_friction[:, 0] *= value
        model.pair_friction[:, :2] *= value
    elif family == "restitution":
        model.geom_solref[:, 1] *= value
        model.pair_solref[:, 1] *= value
    elif family not in ("centre_of_mass", "length", "wind", "delay", "bias", "scale"):
        raise ValueError(f"no world knows how to hide {family}[{target}]")
