"""Models that are hard to take along or to predict: files in several folders, hidden states, several controls."""

import shutil
import struct
import zlib
from pathlib import Path

import mujoco
import numpy as np
import pytest

from skat.simulators import MujocoSimulator

# A robot whose files are of every kind, in folders of its own.
ROBOT = """
<mujoco model="robot">
  <compiler meshdir="assets" texturedir="pictures"/>
  <asset>
    <mesh name="part" file="part.obj"/>
    <hfield name="ground" file="ground.png" size="1 1 .1 .1"/>
    <texture name="paint" type="2d" file="one.png"/>
    <texture name="decal" type="2d" file="two.png" embed="false"/>
    <texture name="box" type="cube" fileup="one.png" filefront="two.png"/>
    <material name="paint" texture="paint"/><material name="decal" texture="decal"/><material name="box" texture="box"/>
    <skin name="skin" file="skin.skn"/>
  </asset>
  <worldbody>
    <body name="robot">
      <joint name="turn" axis="0 0 1" damping=".1"/>
      <geom type="mesh" mesh="part"/>
      <geom type="hfield" hfield="ground" contype="0" conaffinity="0" pos="0 0 -1"/>
      <site material="paint"/><site material="decal"/><site material="box"/>
    </body>
  </worldbody>
</mujoco>
"""
SCENE = """
<mujoco model="scene">
  <compiler meshdir="assets" texturedir="pictures"/>
  <asset><mesh name="part" file="part.obj"/><model name="robot" file="{file}"/></asset>
  <worldbody>
    <body name="fall" pos="0 0 2"><freejoint/><geom type="mesh" mesh="part"/></body>
    <frame pos="1 0 0"><attach model="robot" body="{body}" prefix="a_"/></frame>
  </worldbody>
</mujoco>
"""
PLAIN_SCENE = """
<mujoco>
  <compiler meshdir="assets"/>
  <asset><mesh name="own" file="part.obj"/></asset>
  <worldbody><body name="fall" pos="0 0 2"><freejoint/><geom type="mesh" mesh="own"/></body></worldbody>
</mujoco>
"""
ARM = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="upper">
      <joint name="ball" type="ball" damping=".1"/>
      <geom type="capsule" size=".05" fromto="0 0 0 .3 0 0"/>
      <body name="lower" pos=".3 0 0">
        <joint name="hinge" axis="0 1 0" damping=".1"/>
        <geom type="capsule" size=".05" fromto="0 0 0 .3 0 0"/>
      </body>
    </body>
  </worldbody>
  {}
</mujoco>
"""


def tetrahedron(size):
    corners = f"v 0 0 0\nv {size} 0 0\nv 0 {size} 0\nv 0 0 {size}\n"
    return (corners + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n").encode()


def picture(shade):
    """Return a PNG of 4 times 4 pixels."""

    def chunk(kind, content):
        return (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )

    rows = b"".join(bytes([0, *(shade + 10 * index for index in range(12))]) for _ in range(4))
    header = struct.pack(">IIBBBBB", 4, 4, 8, 2, 0, 0, 0)
    parts = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


def skin(body, size):
    """Return a skin of one triangle on one body, as MuJoCo's binary format."""
    corners = np.array([0, 0, 0, size, 0, 0, 0, size, 0], np.float32).tobytes()
    bone = body.encode().ljust(40, b"\0") + np.array([0, 0, 0, 1, 0, 0, 0], np.float32).tobytes()
    weights = struct.pack("4i", 3, 0, 1, 2) + np.ones(3, np.float32).tobytes()
    return struct.pack("4i", 3, 0, 1, 1) + corners + struct.pack("3i", 0, 1, 2) + bone + weights


def write_files(folder, size, shade):
    """Write the files that ROBOT names."""
    (folder / "assets").mkdir(parents=True)
    (folder / "pictures").mkdir()
    (folder / "assets" / "part.obj").write_bytes(tetrahedron(size))
    (folder / "assets" / "ground.png").write_bytes(picture(shade + 20))
    (folder / "assets" / "skin.skn").write_bytes(skin("robot", size))
    (folder / "pictures" / "one.png").write_bytes(picture(shade))
    (folder / "pictures" / "two.png").write_bytes(picture(shade + 1))


@pytest.fixture
def robot(tmp_path):
    """A robot in its folder; beside it a scene whose folder holds other files of the same names."""
    write_files(tmp_path / "robots" / "own", 0.2, 10)
    write_files(tmp_path / "scenes", 0.4, 90)
    path = tmp_path / "robots" / "own" / "robot.xml"
    path.write_text(ROBOT)
    return path


def scene_in_xml(robot):
    path = robot.parents[2] / "scenes" / "scene.xml"
    path.write_text(SCENE.format(file="../robots/own/robot.xml", body="robot"))
    return path


def scene_of_scenes(robot):
    path = robot.parents[2] / "outer" / "scene.xml"
    path.parent.mkdir()
    path.write_text(SCENE.format(file=scene_in_xml(robot), body="a_robot"))
    (path.parent / "assets").mkdir()
    (path.parent / "assets" / "part.obj").write_bytes(tetrahedron(0.3))
    return path


def attached_spec(robot):
    scene = mujoco.MjSpec()
    scene.attach(mujoco.MjSpec.from_file(str(robot)), frame=scene.worldbody.add_frame(), prefix="a_")
    return scene


def attached_body(robot):
    path = robot.parents[2] / "scenes" / "plain.xml"
    path.write_text(PLAIN_SCENE)
    scene = mujoco.MjSpec.from_file(str(path))
    child = mujoco.MjSpec.from_file(str(robot))
    scene.worldbody.add_frame().attach_body(child.body("robot"), "a_", "")
    return scene


@pytest.mark.parametrize("made", [scene_in_xml, scene_of_scenes, attached_spec, attached_body])
def test_attached_models_bring_the_files_of_their_own_folders(robot, tmp_path, made):
    model = made(robot)
    spec = mujoco.MjSpec.from_file(str(model)) if isinstance(model, Path) else model.copy()
    for texture in spec.textures:  # plain MuJoCo holds no pixels of a texture by reference
        texture.embed = mujoco.mjtEmbed.mjEMBED_AUTO
    expected = spec.compile()
    simulator = MujocoSimulator(model)
    for folder in ("robots", "scenes", "outer"):
        shutil.rmtree(tmp_path / folder, ignore_errors=True)
    np.testing.assert_allclose(simulator.compiled().body_mass, expected.body_mass, rtol=1e-12)
    (tmp_path / "out").mkdir()
    written = mujoco.MjModel.from_xml_path(str(simulator.to_mjcf(tmp_path / "out" / "scene.xml")[0]))
    for name in ("body_mass", "hfield_data", "tex_data", "skin_vert"):
        found, wanted = (np.asarray(getattr(each, name), float) for each in (written, expected))
        np.testing.assert_allclose(found, wanted, rtol=1e-12, err_msg=name)
    assert expected.ntexdata > 0


def test_missing_file_of_an_attached_model_is_not_that_of_the_scene(robot):
    path = scene_in_xml(robot)
    (robot.parent / "assets" / "part.obj").unlink()
    with pytest.raises(FileNotFoundError, match=r"refers to the file 'assets/part.obj', which is not there"):
        MujocoSimulator(path)


def test_missing_picture_by_reference_is_named(robot):
    text = robot.read_text().replace('type="2d" file="two.png"', 'type="2d" file="gone.png"')
    robot.write_text(text)
    with pytest.raises(
        FileNotFoundError, match=r"refers to the file '.*pictures/gone.png', which is not there"
    ):
        MujocoSimulator(robot)


def test_given_files_are_told_apart_by_their_paths():
    text = """<mujoco><asset><mesh name="a" file="a/part.obj"/><mesh name="b" file="{}/part.obj"/></asset><worldbody>
    <body name="a"><joint/><geom type="mesh" mesh="a"/><body name="b"><joint/><geom type="mesh" mesh="b"/></body>
    </body></worldbody></mujoco>"""
    assets = {"a/part.obj": tetrahedron(0.2), "b/part.obj": tetrahedron(0.4)}
    simulator = MujocoSimulator(mujoco.MjSpec.from_string(text.format("b"), assets=assets))
    masses = simulator.compiled().body_mass
    assert masses[2] == pytest.approx(8 * masses[1], rel=1e-5)
    with pytest.raises(
        ValueError, match=r"several of this name, a/part.obj, b/part.obj.*'c/part.obj' in spec.assets"
    ):
        MujocoSimulator(mujoco.MjSpec.from_string(text.format("c"), assets=assets))


ROPE = """<mujoco><worldbody><flexcomp name="rope" type="grid" count="5 1 1" spacing=".1 .1 .1" mass=".2" radius=".01"
dim="1" pos="0 0 1"><edge equality="true"/><elasticity young="1e6" poisson=".3"/></flexcomp></worldbody></mujoco>"""
FOIL = """<mujoco><worldbody><flexcomp name="foil" type="grid" count="3 3 1" spacing=".1 .1 .1" mass="1" radius=".01"
dim="2" pos="0 0 1"><elasticity young="1e4" poisson=".1" thickness=".01" elastic2d="both" yield=".01 .01"/></flexcomp>
</worldbody></mujoco>"""
WIRE = ARM.format("").replace('name="hinge"', 'name="hinge" stiffness="20" springyield=".2"')


@pytest.mark.parametrize("text", [WIRE, FOIL, ROPE], ids=["joint", "flex", "rod"])
def test_plastic_states_are_refused(text):
    with pytest.raises(
        ValueError, match=r"a plastic state.*rows .* do not hold: take springyield and yield out"
    ):
        MujocoSimulator(text)


def test_contacts_with_a_memory_are_refused():
    text = ARM.format("").replace("/>", ' integrator="discrete"><flag ipc="enable"/></option>', 1)
    with pytest.raises(ValueError, match=r'the flag ipc.*do not hold: take ipc="enable" out'):
        MujocoSimulator(text)


@pytest.mark.parametrize(
    ("actuator", "message"),
    [
        ('<orientation name="turn" joint="ball" kp="5" kv=".3"/>', "actuator 'turn' takes 3 controls"),
        (
            '<pid name="servo" joint="hinge" kp="5" kv=".3" input="pos vel"/>',
            "actuator 'servo' takes 2 controls",
        ),
        ('<pid joint="hinge" kp="5" kv=".3" input="pos vel ff"/>', "actuator 'actuator1' takes 3 controls"),
    ],
)
def test_actuators_of_several_controls_are_refused(actuator, message):
    text = ARM.format(f'<actuator><motor name="first" joint="hinge"/>{actuator}</actuator>')
    with pytest.raises(ValueError, match=f"{message}.*Give each control an actuator of its own: <position>"):
        MujocoSimulator(text)


def test_several_actuators_do_what_one_of_several_controls_does():
    single = '<pid joint="hinge" kp="5" kv=".3" input="pos vel ff"/>'
    several = '<position joint="hinge" kp="5"/><velocity joint="hinge" kv=".3"/><motor joint="hinge"/>'
    model = mujoco.MjModel.from_xml_string(ARM.format(f"<actuator>{single}</actuator>"))
    data = mujoco.MjData(model)
    data.ctrl[:] = [0.3, -0.2, 0.4]
    row = np.r_[data.qpos, data.qvel, data.ctrl]
    mujoco.mj_step(model, data, 5)
    simulator = MujocoSimulator(ARM.format(f"<actuator>{several}</actuator>"), frame_skip=5)
    np.testing.assert_allclose(simulator.predict([row])[0], np.r_[data.qpos, data.qvel], atol=1e-12)


def test_delay_of_a_sensor_is_kept_and_acts_on_nothing(tmp_path):
    sensor = '<sensor><jointpos name="late" joint="hinge" delay=".01" nsample="6" interval=".004"/></sensor>'
    simulator, plain = (MujocoSimulator(ARM.format(text), frame_skip=5) for text in (sensor, ""))
    rows = np.random.default_rng(0).normal(size=(4, len(plain.input_names)))
    rows[:, :4] /= np.linalg.norm(rows[:, :4], axis=1, keepdims=True)
    np.testing.assert_array_equal(simulator.predict(rows), plain.predict(rows))
    written = mujoco.MjModel.from_xml_path(str(simulator.to_mjcf(tmp_path / "late.xml")[0]))
    assert written.sensor("late").id == 0
    assert written.sensor_delay[0] == pytest.approx(0.01)


@pytest.mark.parametrize("nothing", ["", Path("."), Path("/")])
def test_no_model_is_no_model_file(nothing, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        FileNotFoundError,
        match=r"there is no model file '' .*give the path of an MJCF or URDF file|there is no model in the folder [./]",
    ):
        MujocoSimulator(nothing)
