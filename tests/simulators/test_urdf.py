"""URDF texts: what is one, what its numbers mean, and that only the changed ones are written back."""

import copy
import re
import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skat.simulators.urdf import (
    _differ,
    _mesh_file,
    _rotation,
    edited_urdf,
    is_urdf,
    root_link,
    says_what_its_root_is,
    spec_of_urdf,
)

ARM = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <link name="upper">
    <inertial>
      <origin xyz="0 0 0.1" rpy="0.4 -0.7 1.1"/><mass value="1"/>
      <inertia ixx="0.1" iyy="0.2" izz="0.15" ixy="0.01" ixz="-0.02" iyz="0.03"/>
    </inertial>
  </link>
  <link name="lower">
    <inertial><mass value='0.5'/><inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="pad"><collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision></link>
  <joint name="shoulder" type="revolute">
    <origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><parent link="base"/><child link="upper"/>
    <limit lower="-1" upper="1" effort="12" velocity="3"/><dynamics damping="0.3"/>
  </joint>
  <joint name="elbow" type="continuous"><axis xyz="0 1 0"/><parent link="upper"/><child link="lower"/></joint>
  <joint name="mount" type="fixed"><parent link="lower"/><child link="pad"/></joint>
  <gazebo reference="upper"><joint name="unused"/></gazebo>
  <transmission name="t"><joint name="shoulder"/></transmission>
</robot>
"""


def model_of(text):
    spec, _ = spec_of_urdf(text, None)
    for joint in ("shoulder", "elbow"):
        motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        if joint == "shoulder":
            motor.forcelimited, motor.forcerange = 1, [-12, 12]
    return spec.compile()


def element(text, path):
    return ElementTree.fromstring(text).find(path).attrib


@pytest.mark.parametrize(
    ("text", "is_one"),
    [
        ("<robot/>", True),
        ("\ufeff  \n<?xml version='1.0'?><!-- a\n<mujoco> --><!DOCTYPE robot><robot name='a'>", True),
        ("<mujoco><robot/></mujoco>", False),
        ("<robots/>", False),
        ("a <robot/>", False),
    ],
)
def test_a_urdf_is_told_by_its_first_element(text, is_one):
    assert is_urdf(text) is is_one


def test_the_root_is_no_joints_child_and_fixed_if_a_joint_says_so():
    assert root_link(ARM) == "base"
    assert not says_what_its_root_is(ARM)
    fixed = ARM.replace(
        '<joint name="mount"',
        '<joint name="w" type="fixed"><parent link="world"/><child link="base"/></joint><joint name="mount"',
    )
    assert says_what_its_root_is(fixed)
    assert model_of(fixed).nbody == 5
    assert root_link("<robot/>") == ""


@pytest.mark.parametrize("rpy", [(0.4, -0.7, 1.1), (np.pi / 2, 0, 0), (0, np.pi / 2, 0), (0, 0, np.pi / 2)])
def test_angles_are_about_fixed_axes(rpy):
    np.testing.assert_allclose(_rotation(list(rpy)), Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-15)


def test_two_numbers_are_one_up_to_rounding_whatever_their_size():
    for size in (1e-30, 1.0, -1e30):
        assert not _differ(size, size * (1 + 1e-12))
        assert _differ(size, size * (1 + 1e-7))
    assert not _differ(0.0, 0.0)
    assert _differ(np.array([1.0, 0.0]), np.array([1.0, 1e-6]))
    assert not _differ(np.array([1.0, 0.0]), np.array([1.0, 1e-12]))


def test_an_unchanged_model_changes_no_letter():
    nominal = model_of(ARM)
    assert edited_urdf(ARM, nominal, nominal) == ARM


def changed(field, index, value):
    nominal = model_of(ARM)
    edited = copy.copy(nominal)
    getattr(edited, field)[index] = value
    text = edited_urdf(ARM, nominal, edited)
    return text, sum(a != b for a, b in zip(re.split(r"(?<=>)", ARM), re.split(r"(?<=>)", text)))


@pytest.mark.parametrize("body", ["upper", "lower"])
def test_inertia_is_written_in_the_frame_of_its_origin(body):
    nominal = model_of(ARM)
    edited = copy.copy(nominal)
    index = nominal.body(body).id
    edited.body_inertia[index] *= 2.5
    text = edited_urdf(ARM, nominal, edited)
    before, after = (element(one, f"link[@name='{body}']/inertial/inertia") for one in (ARM, text))
    for name, value in before.items():
        assert float(after[name]) == pytest.approx(2.5 * float(value), abs=1e-12)
    assert element(text, "link[@name='upper']/inertial/origin")["rpy"] == "0.4 -0.7 1.1"
    again = model_of(text)
    np.testing.assert_allclose(again.body_inertia, edited.body_inertia, rtol=1e-9)


def test_mass_damping_friction_effort_and_places_are_written_where_they_stand():
    text, n_changed = changed("body_mass", 2, 1.25)
    assert (element(text, "link[@name='upper']/inertial/mass"), n_changed) == ({"value": "1.25"}, 1)
    text, n_changed = changed("body_mass", 3, 0.75)
    assert (element(text, "link[@name='lower']/inertial/mass"), n_changed) == ({"value": "0.75"}, 1)
    text, n_changed = changed("dof_damping", 0, 0.5)
    assert (element(text, "joint[@name='shoulder']/dynamics"), n_changed) == ({"damping": "0.5"}, 1)
    text, n_changed = changed("dof_frictionloss", 0, 0.25)
    expected = {"damping": "0.3", "friction": "0.25"}
    assert (element(text, "joint[@name='shoulder']/dynamics"), n_changed) == (expected, 1)
    text, _ = changed("dof_damping", 1, 0.5)
    assert element(text, "joint[@name='elbow']/dynamics") == {"damping": "0.5"}
    text, n_changed = changed("actuator_forcerange", 0, [-6, 6])
    limit = {"lower": "-1", "upper": "1", "effort": "6.0", "velocity": "3"}
    assert (element(text, "joint[@name='shoulder']/limit"), n_changed) == (limit, 1)
    assert changed("actuator_forcerange", 1, [-6, 6])[0] == ARM  # the elbow has no limit to write it to
    text, n_changed = changed("body_ipos", 2, [0.1, 0.2, 0.3])
    assert element(text, "link[@name='upper']/inertial/origin")["xyz"] == "0.1 0.2 0.3"
    assert n_changed == 1
    text, _ = changed("body_ipos", 3, [0.1, 0.2, 0.3])
    assert element(text, "link[@name='lower']/inertial/origin") == {"xyz": "0.1 0.2 0.3"}
    text, n_changed = changed("body_pos", 2, [0.0, 0.0, 0.5])
    assert (element(text, "joint[@name='shoulder']/origin"), n_changed) == ({"xyz": "0.0 0.0 0.5"}, 1)
    text, _ = changed("body_pos", 3, [0.0, 0.0, 0.5])
    assert element(text, "joint[@name='elbow']/origin") == {"xyz": "0.0 0.0 0.5"}


def test_a_base_that_is_bolted_elsewhere_is_moved_at_its_bolt():
    bolt = '<joint name="bolt" type="fixed"><parent link="world"/><child link="base"/></joint>'
    text = ARM.replace("</robot>", f"{bolt}</robot>")
    nominal = model_of(text)
    edited = copy.copy(nominal)
    assert nominal.body("base").id == 1
    edited.body_pos[1] = [0.1, 0.0, 0.5]
    moved = edited_urdf(text, nominal, edited)
    assert element(moved, "joint[@name='bolt']/origin") == {"xyz": "0.1 0.0 0.5"}
    np.testing.assert_allclose(model_of(moved).body_pos, edited.body_pos)


def test_what_the_compiler_took_from_shapes_is_written_as_an_inertial():
    nominal = model_of(ARM)
    pad = nominal.body("pad").id
    sizes = np.array([0.1, 0.2, 0.3])
    inertia = 1000 * np.prod(sizes) / 12 * (np.square(sizes).sum() - np.square(sizes))
    for field, factor in (("body_mass", 2.0), ("body_inertia", 3.0)):
        edited = copy.copy(nominal)
        getattr(edited, field)[pad] *= factor
        text = edited_urdf(ARM, nominal, edited)
        mass = float(element(text, "link[@name='pad']/inertial/mass")["value"])
        found = element(text, "link[@name='pad']/inertial/inertia")
        assert mass == pytest.approx(6.0 * (factor if field == "body_mass" else 1.0))
        diagonal = [float(found[name]) for name in ("ixx", "iyy", "izz")]
        np.testing.assert_allclose(
            diagonal, inertia * (factor if field == "body_inertia" else 1.0), rtol=1e-9
        )
        np.testing.assert_allclose([float(found[name]) for name in ("ixy", "ixz", "iyz")], 0, atol=1e-12)
        again = model_of(text)
        np.testing.assert_allclose(again.body_mass, edited.body_mass, rtol=1e-9)


def test_meshes_are_looked_for_upwards_by_package_and_without(tmp_path):
    urdf = tmp_path / "robot" / "a" / "b" / "c" / "d"
    urdf.mkdir(parents=True)
    near, far = tmp_path / "robot" / "meshes", tmp_path / "far"
    for folder in (near, far):
        folder.mkdir()
        (folder / "part.STL").write_bytes(b"")
        (folder / "part.dae").write_bytes(b"")
    for name in ("package://robot/meshes/part.STL", "model://other/meshes/part.STL", "meshes/part.STL"):
        assert _mesh_file(name, urdf) == near / "part.STL"
    assert _mesh_file("package://far/part.STL", urdf.parent) == far / "part.STL"
    assert _mesh_file("package://far/part.STL", urdf / "e") is None  # too far up
    assert _mesh_file("meshes/part.dae", urdf) is None
    assert _mesh_file("gone.stl", urdf) is None
