"""Nominal models, and hidden effects as raw edits of MJCF text or of compiled arrays.

Nothing here knows of ``skat``: a world that shares code with the effects it is to be found by proves nothing.
"""

import functools
import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np

# Substeps per transition are Gymnasium's frame_skip, and worlds keep the model's step and integrator: with half of
# the step, the squared differences of a log of 1,000 rows, in units of the noise's variance, sum up to 75 to
# 450 for Hopper, 1e4 for the puck and more for the others (contacts), which is an effect of its own. They use
# another solver, which no model feels (1e-6 at most).
FRAME_SKIP = {"hopper": 4, "halfcheetah": 5, "ant": 5, "puck": 5}
SOLVER = mujoco.mjtSolver.mjSOL_CG
ROOT_BODY = {"hopper": "torso", "halfcheetah": "torso", "ant": "torso", "puck": "puck"}
KINDS = tuple(FRAME_SKIP)

PUCK_MJCF = """
<mujoco model="sliding puck">
  <option integrator="RK4" timestep="0.004" cone="pyramidal"/>
  <worldbody>
    <geom name="table" type="plane" size="5 5 0.1" contype="0" conaffinity="0"/>
    <body name="puck" pos="0 0 0.05">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <joint name="spin" type="hinge" axis="0 0 1"/>
      <geom name="disc" type="ellipsoid" size="0.08 0.08 0.05" mass="0.4" contype="0" conaffinity="0"/>
      <geom name="weight" type="box" pos="0.04 0.02 0" size="0.02 0.02 0.02" mass="0.2" contype="0"
            conaffinity="0"/>
    </body>
  </worldbody>
  <contact>
    <pair name="puck_table" geom1="disc" geom2="table" condim="4" friction="0.3 0.3 0.01 0.0001 0.0001"
          solref="0.05 0.6"/>
  </contact>
  <actuator>
    <motor name="push_x" joint="x" gear="4" ctrllimited="true" ctrlrange="-1 1"/>
    <motor name="push_y" joint="y" gear="4" ctrllimited="true" ctrlrange="-1 1"/>
    <motor name="twist" joint="spin" gear="0.05" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""


@functools.cache
def nominal_mjcf(kind):
    """Return the MJCF text of the nominal model of ``kind``."""
    if kind == "puck":
        return PUCK_MJCF
    import gymnasium

    file = {"hopper": "hopper.xml", "halfcheetah": "half_cheetah.xml", "ant": "ant.xml"}[kind]
    return (Path(os.fspath(gymnasium.__path__[0])) / "envs" / "mujoco" / "assets" / file).read_text()


@functools.cache
def nominal_model(kind):
    """Return the compiled nominal model; callers do not change it."""
    return _compile(nominal_mjcf(kind))


def compile_model(kind, hidden=()):
    """Return the model of ``kind`` with the effects that are edits of a model, in raw MJCF text or arrays.

    Parameters
    ----------
    kind : str
    hidden : sequence of (family, target, value)
        Families that are no property of the model (winds, sensors, delays) are passed over here.
    """
    tree = ElementTree.fromstring(nominal_mjcf(kind))
    lengths = {target: value for family, target, value in hidden if family == "length"}
    shifts = [(target, value) for family, target, value in hidden if family == "centre_of_mass"]
    if lengths:
        _state_geom_masses(tree, nominal_model(kind))
        _scale_links(tree, nominal_model(kind), lengths)
    if shifts:
        if lengths:
            raise ValueError("the worlds hide either lengths or centres of mass, not both")
        _state_inertias(tree, nominal_model(kind))
        _shift_centres(tree, nominal_model(kind), shifts)
    model = _compile(ElementTree.tostring(tree, encoding="unicode"))
    for family, target, value in hidden:
        _edit_arrays(model, family, target, value)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _compile(mjcf):
    """Compile without a word about ``settotalmass``, which HalfCheetah's file has and MuJoCo deprecates."""
    before, quiet = mujoco.MjLogConfig.get(), mujoco.MjLogConfig.get()
    quiet.logto_file, quiet.logto_console = False, False
    quiet.set()
    try:
        return mujoco.MjModel.from_xml_string(mjcf)
    finally:
        before.set()


def hinges(model):
    """Return the ids of the joints between links: everything but those that place the root in the world."""
    roots = {"rootx", "rootz", "rooty", "root"}
    return [j for j in range(model.njnt) if model.joint(j).name not in roots]


def _edit_arrays(model, family, target, value):
    if family == "mass":
        bodies = slice(1, None) if target == "all" else _body_id(model, target)
        model.body_mass[bodies] *= value
        model.body_inertia[bodies] *= value
    elif family == "inertia":
        model.body_inertia[_body_id(model, target)] *= value
    elif family == "gravity":
        model.opt.gravity[:] *= value
    elif family == "tilt":
        g = -model.opt.gravity[2]
        model.opt.gravity[:] = (
            g * np.sin(value) * (target == "x"),
            g * np.sin(value) * (target == "y"),
            -g * np.cos(value),
        )
    elif family in ("damping", "dry_friction", "armature"):
        array = {
            "damping": model.dof_damping,
            "dry_friction": model.dof_frictionloss,
            "armature": model.dof_armature,
        }[family]
        joints = hinges(model) if target == "all" else [model.joint(target).id]
        array[[model.jnt_dofadr[j] for j in joints]] += value
    elif family == "stiffness":
        model.jnt_stiffness[model.joint(target).id] += value
    elif family == "gain":
        chosen = range(model.nu) if target == "all" else [actuator_names(model).index(target)]
        model.actuator_gear[list(chosen)] *= value
    elif family == "contact_friction":
        if target == "all":
            model.geom_friction[:, 0] *= value
            model.pair_friction[:, :2] *= value
        elif target in [model.pair(i).name for i in range(model.npair)]:
            model.pair_friction[model.pair(target).id, :2] *= value
        else:
            model.geom_friction[model.geom(target).id, 0] *= value
    elif family == "contact_anisotropy":
        model.pair_friction[:, 1] = model.pair_friction[:, 0] * value
    elif family == "restitution":
        model.geom_solref[:, 1] *= value
        model.pair_solref[:, 1] *= value


def actuator_names(model):
    """Return each actuator's name, or its joint's where it has none."""
    return [model.actuator(i).name or model.joint(model.actuator_trnid[i, 0]).name for i in range(model.nu)]


def body_names(model):
    """Return the names of the moving bodies; ``body<id>`` where there is none."""
    return [model.body(i).name or f"body{i}" for i in range(1, model.nbody)]


def _body_id(model, name):
    return body_names(model).index(name) + 1


def _bodies(tree):
    # Document order is the compiler's order of ids, from 1.
    return list(tree.find("worldbody").iter("body"))


def _numbers(element, attribute, default):
    return np.array([float(v) for v in element.get(attribute, default).split()])


def _text(numbers):
    return " ".join(repr(float(v)) for v in np.atleast_1d(numbers))


def _forget_total_mass(tree):
    for compiler in tree.findall("compiler"):
        compiler.attrib.pop("settotalmass", None)


def _state_geom_masses(tree, model):
    """Write the mass of every geom, so that a longer one is not a heavier one."""
    _forget_total_mass(tree)
    for body_id, body in enumerate(_bodies(tree), start=1):
        first, number = model.body_geomadr[body_id], model.body_geomnum[body_id]
        radius, half = model.geom_size[first : first + number, :2].T
        capsule = model.geom_type[first : first + number] == mujoco.mjtGeom.mjGEOM_CAPSULE
        volume = np.pi * radius**2 * (4 / 3 * radius + np.where(capsule, 2 * half, 0))
        masses = model.body_mass[body_id] * volume / volume.sum()
        for geom, mass in zip(body.findall("geom"), masses, strict=True):
            geom.set("mass", _text(mass))


def _state_inertias(tree, model):
    """Write every body's mass, centre and inertia, which no geom determines any more."""
    _forget_total_mass(tree)
    compiler = tree.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(tree, "compiler")
    compiler.set("inertiafromgeom", "false")
    for body_id, body in enumerate(_bodies(tree), start=1):
        body.append(
            ElementTree.Element(
                "inertial",
                pos=_text(model.body_ipos[body_id]),
                quat=_text(model.body_iquat[body_id]),
                mass=_text(model.body_mass[body_id]),
                diaginertia=_text(model.body_inertia[body_id]),
            )
        )


def _shift_centres(tree, model, shifts):
    bodies = _bodies(tree)
    for target, value in shifts:
        name, axis = target.rsplit(".", 1)
        inertial = bodies[_body_id(model, name) - 1].find("inertial")
        position = _numbers(inertial, "pos", "0 0 0")
        position["xyz".index(axis)] += value
        inertial.set("pos", _text(position))


def _scale_links(tree, model, lengths):
    """Stretch links about the joint that carries them, so that parents keep their length."""
    if "all" in lengths:
        lengths = dict.fromkeys(body_names(model), lengths["all"])
    anchors = [_anchor(body) for body in _bodies(tree)]
    by_element = dict(zip(_bodies(tree), anchors, strict=True))
    for name, body in zip(body_names(model), _bodies(tree), strict=True):
        factor, anchor = lengths.get(name, 1.0), by_element[body]
        for geom in body.findall("geom"):
            if geom.get("fromto"):
                ends = _numbers(geom, "fromto", "").reshape(2, 3)
                geom.set("fromto", _text((anchor + factor * (ends - anchor)).ravel()))
                continue
            centre = _numbers(geom, "pos", "0 0 0")
            geom.set("pos", _text(anchor + factor * (centre - anchor)))
            if geom.get("type") == "capsule":
                radius, half = _numbers(geom, "size", "")
                geom.set("size", _text([radius, factor * half]))
        for child in body.findall("body"):
            position = _numbers(child, "pos", "0 0 0")
            place = position + by_element[child]
            child.set("pos", _text(position + (factor - 1) * (place - anchor)))


def _anchor(body):
    """Return the place of a body's hinge in its own frame; the origin where it has none."""
    hinge = [joint for joint in body.findall("joint") if joint.get("type", "hinge") == "hinge"]
    return _numbers(hinge[0], "pos", "0 0 0") if hinge else np.zeros(3)
