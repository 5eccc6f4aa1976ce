"""Models as people have them: MjModel, folders, URDF; what is added to them, and URDF out."""

import difflib
import pickle

import mujoco
import numpy as np
import pytest
from sklearn.base import clone

from skat.simulators import MujocoSimulator, make_simulator
from skat.simulators.adapting import without_root
from skat.simulators.source import differing_fields

ARM = """<?xml version="1.0"?>
<!-- an arm -->
<robot name="arm">
  <link name="world"/>
  <link name="base"/>
  <link name="upper">
    <visual><geometry><mesh filename="package://arm/upper.dae"/></geometry></visual>
    <inertial>
      <origin xyz="0 0 0.1" rpy="0.1 0.2 0.3"/> <mass value="1"/>
      <inertia ixx='0.1' iyy='0.2' izz='0.15' ixy='0.01' ixz='0' iyz='0'/>
    </inertial>
  </link>
  <link name="lower">
    <inertial><mass value="0.5"/><inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="tool"/>
  <joint name="bolt" type="fixed"><parent link="world"/><child link="base"/></joint>
  <joint name="shoulder" type="revolute">
    <origin xyz="0 0 0.3" rpy="0 0 1"/><axis xyz="0 1 0"/><parent link="base"/><child link="upper"/>
    <limit lower="-1" upper="1" effort="12" velocity="3"/><dynamics damping="0.3" friction="0.2"/>
  </joint>
  <joint name="elbow" type="continuous">
    <origin xyz="0 0.1 0.3"/><axis xyz="0 1 0"/><parent link="upper"/><child link="lower"/>
    <limit effort="5" velocity="3"/>
  </joint>
  <joint name="flange" type="fixed"><origin xyz="0 0 0.3"/><parent link="lower"/><child link="tool"/></joint>
</robot>
"""
UNBOLTED = ARM.replace('  <link name="world"/>\n', "").replace(
    '  <joint name="bolt" type="fixed"><parent link="world"/><child link="base"/></joint>\n', ""
)
HEAVY = UNBOLTED.replace(
    '<link name="base"/>',
    '<link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    "</inertial></link>",
)
SLIDER = (
    '<mujoco><worldbody><body><joint name="{}" type="slide"/><geom size="0.1"/></body></worldbody></mujoco>'
)
WALKER = """<mujoco>
  <worldbody>
    <body name="trunk" pos="0 0 1">
      <joint name="float" type="free"/><geom size="0.1"/>
      <body name="leg"><joint name="hip"/><geom size="0.05" pos="0 0 -0.3"/></body>
    </body>
  </worldbody>
  <keyframe><key name="home" qpos="0 0 1 1 0 0 0 0.7" qvel="0 0 0 0 0 0 3"/></keyframe>
</mujoco>"""


def test_a_urdf_keeps_its_links_and_a_model_of_each_in_fixed_joints():
    simulator = MujocoSimulator(ARM)
    model = simulator.compiled()
    assert simulator.state_names == ("qpos.shoulder", "qpos.elbow", "qvel.shoulder", "qvel.elbow")
    assert [model.body(index).name for index in range(model.nbody)] == [
        *("world", "base", "upper", "lower", "tool")
    ]
    np.testing.assert_array_equal(model.dof_damping, [0.3, 0])
    np.testing.assert_array_equal(model.dof_frictionloss, [0.2, 0])
    assert pickle.loads(pickle.dumps(simulator)).model == clone(simulator).model == simulator.model


def test_a_parent_called_world_need_not_be_declared():
    undeclared = ARM.replace('  <link name="world"/>\n', "")
    assert not differing_fields(MujocoSimulator(undeclared).compiled(), MujocoSimulator(ARM).compiled())


def test_a_urdf_without_a_joint_to_the_world_asks_whether_its_root_is_free():
    with pytest.raises(ValueError, match=r"root link 'base' .* say base='fixed' or base='free' .*--base"):
        MujocoSimulator(UNBOLTED)
    assert MujocoSimulator(UNBOLTED, base="fixed").state_names == MujocoSimulator(ARM).state_names
    assert MujocoSimulator(HEAVY, base="free").state_names[:3] == (
        "qpos.root.x",
        "qpos.root.y",
        "qpos.root.z",
    )


def test_the_root_of_a_model_is_welded_and_there_is_none_elsewhere():
    welded = without_root(MujocoSimulator(WALKER, frame_skip=3))
    assert (welded.base, welded.frame_skip, welded.state_names) == ("fixed", 3, ("qpos.hip", "qvel.hip"))
    with pytest.raises(ValueError, match=r'base="fixed" is of MuJoCo models; this is a PuckSimulator'):
        without_root(make_simulator("puck"))


def test_a_free_root_is_welded_where_it_is_and_keyframes_keep_the_rest():
    simulator = MujocoSimulator(WALKER, base="fixed")
    model = simulator.compiled()
    assert simulator.state_names == ("qpos.hip", "qvel.hip")
    np.testing.assert_array_equal(model.body("trunk").pos, [0, 0, 1])
    np.testing.assert_array_equal([model.key_qpos, model.key_qvel], [[[0.7]], [[3]]])
    assert "trunk is welded to the world" in simulator.model.notes[0]
    assert MujocoSimulator(WALKER, base="free").model.xml == MujocoSimulator(WALKER).model.xml
    again = type(simulator)(**simulator.get_params(deep=False))
    assert again.state_names == simulator.state_names


@pytest.mark.parametrize("base", ["loose", True])
def test_another_base_is_refused(base):
    with pytest.raises(ValueError, match="base must be 'fixed' or 'free'"):
        MujocoSimulator(ARM, base=base)


def test_torque_motors_drive_each_joint_up_to_its_effort_and_say_so():
    simulator = MujocoSimulator(ARM, motors="torque")
    assert simulator.input_names[4:] == ("ctrl.shoulder", "ctrl.elbow")
    assert "limits of effort: shoulder 12, elbow 5" in simulator.model.notes[0]
    rest = np.zeros((3, 6))
    rest[:, 5] = 1.0, 5.0, 50.0
    velocity = simulator.predict(rest)[:, 3] - MujocoSimulator(ARM).predict(rest[:1, :4])[0, 3]
    assert velocity[1] == pytest.approx(5 * velocity[0], rel=0.05)
    assert velocity[2] == velocity[1]
    assert clone(simulator).input_names == simulator.input_names
    assert simulator.extended({"mass[upper]": 1.1}).input_names == simulator.input_names
    # The limit is the motor's, so that it may turn out higher as well.
    freer = simulator.predict(rest, effects={"force_limit[elbow]": 2.0})
    assert freer[2, 3] > simulator.predict(rest)[2, 3]


def test_position_servos_pull_with_their_gains():
    simulator = MujocoSimulator(ARM, motors="position:20,0.5")
    model = simulator.compiled()
    np.testing.assert_array_equal(model.actuator_gainprm[:, 0], 20)
    np.testing.assert_array_equal(model.actuator_biasprm[:, 1:3], [[-20, -0.5]] * 2)
    np.testing.assert_array_equal(model.actuator_forcerange, [[-12, 12], [-5, 5]])


def test_motors_of_joints_without_a_name_are_called_as_their_columns_are():
    nameless = """<mujoco><worldbody><body><joint name="joint1" axis="0 1 0"/><geom size=".1"/><body>
    <joint axis="0 1 0"/><geom size=".1"/></body></body></worldbody></mujoco>"""
    columns = MujocoSimulator(nameless).state_names
    driven = MujocoSimulator(nameless, motors="torque")
    assert driven.state_names == columns
    assert driven.input_names[4:] == ("ctrl.joint1", "ctrl.joint1_")


@pytest.mark.parametrize(
    "motors", ["pid", "position", "position:1", "position:-1,2", "position:a,b", "torque:3"]
)
def test_other_motors_are_refused(motors):
    with pytest.raises(ValueError, match="motors must be 'torque', 'position:kp,kv'"):
        MujocoSimulator(ARM, motors=motors)


def test_a_model_with_actuators_gets_no_others():
    driven = SLIDER.format("a").replace("</mujoco>", '<actuator><motor joint="a"/></actuator></mujoco>')
    with pytest.raises(ValueError, match="the model has 1 actuators of its own"):
        MujocoSimulator(driven, motors="torque")


def test_meshes_of_a_package_are_found_and_those_that_are_not_there_are_left_out(tmp_path):
    package = tmp_path / "arm_description"
    (package / "meshes").mkdir(parents=True)
    (package / "urdf").mkdir()
    corners = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    (package / "meshes" / "upper.obj").write_text(corners)
    shape = '<collision><geometry><mesh filename="package://{}/meshes/{}"/></geometry></collision>'
    text = ARM.replace(
        '<link name="tool"/>', f'<link name="tool">{shape.format("arm_description", "upper.obj")}</link>'
    )
    text = text.replace(
        '<link name="base"/>', f'<link name="base">{shape.format("arm_description", "gone.stl")}</link>'
    )
    path = package / "urdf" / "arm.urdf"
    path.write_text(text)
    simulator = MujocoSimulator(path)
    assert simulator.compiled().ngeom == 1
    assert "'package://arm_description/meshes/gone.stl' of base is left out" in simulator.model.notes[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ARM[:600], "not well-formed XML"),
        (
            ARM.replace("<axis", "<xacro:include/><axis").replace("<robot", '<robot xmlns:xacro="x"'),
            "expand it first",
        ),
        (ARM.replace('value="1"', 'value="0"'), "mass and inertia"),
        (ARM.replace('link="upper"', 'link="uper"'), "parent or child missing"),
    ],
)
def test_a_broken_urdf_is_refused_with_the_reason(text, message):
    with pytest.raises(ValueError, match=rf"the URDF text cannot be read: .*{message}"):
        MujocoSimulator(text)


URDF_EFFECTS = {
    "mass[upper]": 1.1,
    "inertia[lower]": 1.3,
    "centre_of_mass[lower.x]": 0.01,
    "damping[shoulder]": 0.1,
    "dry_friction[elbow]": 0.05,
    "force_limit[shoulder]": 0.5,
    "length[upper]": 1.2,
}


@pytest.mark.parametrize("name", URDF_EFFECTS)
def test_a_urdf_is_written_with_the_effect_and_nothing_else(name, tmp_path):
    extended = MujocoSimulator(ARM, motors="torque").extended({name: URDF_EFFECTS[name]})
    (written,) = extended.to_urdf(tmp_path / "better.urdf")
    assert not differing_fields(MujocoSimulator(written, motors="torque").compiled(), extended.compiled())
    lines = [
        line for line in difflib.ndiff(ARM.splitlines(), written.read_text().splitlines()) if line[0] in "+-"
    ]
    assert 1 <= len(lines) <= 6, lines


def test_what_a_urdf_does_not_say_is_written_beside(tmp_path):
    values = {"mass[upper]": 1.1, "armature[elbow]": 0.01, "timestep": 0.5, "gravity": 0.9}
    written, notes = MujocoSimulator(ARM).extended(values).to_urdf(tmp_path / "better.urdf")
    assert 'mass value="1.1"' in written.read_text()
    assert all(name in notes.read_text() for name in ("armature[elbow]", "timestep", "gravity"))
    assert "mass[upper]" not in notes.read_text()
    with pytest.raises(FileExistsError, match="force=True"):
        MujocoSimulator(ARM).to_urdf(written)
    with pytest.raises(ValueError, match="not read from a URDF"):
        MujocoSimulator(SLIDER.format("a")).to_urdf(tmp_path / "no.urdf")


@pytest.mark.parametrize(("option", "integrator"), [("", "IMPLICITFAST"), ('integrator="RK4"', "RK4")])
def test_servos_that_are_added_to_a_light_joint_are_integrated_by_what_their_damping_needs(
    option, integrator
):
    text = f"""<mujoco><option gravity="0 0 0" {option}/><worldbody><body><joint name="j" axis="0 1 0"/>
    <geom size=".03" mass=".1"/></body></worldbody></mujoco>"""
    simulator = MujocoSimulator(text, motors="position:20,0.5", frame_skip=4)
    assert simulator.compiled().opt.integrator == getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    torque = MujocoSimulator(text, motors="torque").compiled()
    assert torque.opt.integrator == mujoco.MjModel.from_xml_string(text).opt.integrator
    if not option:  # with h kv a thousand times its inertia, the joint follows at kp / kv
        places = simulator.rollout([[0.0, 0.0]], np.full((1, 20, 1), 0.3), n_steps=20)[0, :, 0]
        np.testing.assert_allclose(places, 0.3 * (1 - np.exp(-0.008 * np.arange(21) * 40)), atol=0.01)


@pytest.mark.parametrize(
    ("motors", "effect", "value"),
    [
        *(
            ("position:20,0.5", name, 0.03)
            for name in ("lag[elbow]", "lag_torque[elbow]", "torque_speed[elbow]")
        ),
        *(("position:20,0.5", f"{family}[ctrl.elbow]", 0.5) for family in ("scale", "bias")),
        ("position:20,0.5", "backlash[elbow]", 0.01),
        ("torque", "lag[all]", 0.03),
        ("torque", "damping[root]", 0.03),
    ],
)
def test_no_effect_that_changes_no_number_of_a_urdf_is_lost(motors, effect, value, tmp_path):
    arm = MujocoSimulator(HEAVY, base="free", motors=motors).extended({effect: value})
    written, notes = arm.to_urdf(tmp_path / "arm.urdf")
    assert written.read_text() == HEAVY
    assert effect in notes.read_text()


def test_a_compiled_model_is_taken_with_the_numbers_that_it_has():
    model = mujoco.MjModel.from_xml_string(SLIDER.format("a"))
    model.dof_damping[:] = 1 / 3
    assert MujocoSimulator(model).compiled().dof_damping[0] == 1 / 3
    mujoco.MjModel.from_xml_string(SLIDER.format("b"))
    with pytest.raises(ValueError, match="pass the path of the MJCF file"):
        MujocoSimulator(model)


def test_the_model_of_a_folder_is_the_robot_or_its_scene_where_it_needs_the_ground(tmp_path):
    arm, walker = tmp_path / "arm", tmp_path / "walker"
    for folder, text in ((arm, SLIDER.format("a")), (walker, WALKER)):
        folder.mkdir()
        (folder / "robot.xml").write_text(text)
        (folder / "robot_mjx.xml").write_text(text)
        (folder / "scene.xml").write_text(
            '<mujoco><include file="robot.xml"/><worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>'
        )
    assert MujocoSimulator(arm).compiled().ngeom == 1
    assert MujocoSimulator(walker).compiled().ngeom == 3
    assert "scene.xml" in MujocoSimulator(walker).model.notes[0]
    (arm / "scene.xml").unlink()
    with pytest.raises(ValueError, match=r"holds several models, robot\.xml, robot_mjx\.xml; give the path"):
        MujocoSimulator(arm)
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match="there is no model in the folder"):
        MujocoSimulator(tmp_path / "empty")
