"""The machines of the open logs have the mass properties that were published of them."""

import os
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pytest

from skat.simulators import make_simulator
from skat.simulators.machines import MACHINES, UR10

HOME = os.environ.get("SKAT_DATA_HOME")
published = pytest.mark.skipif(HOME is None, reason="the published files are not on this machine")


def dynamics(model, seed=0, n=20):
    """Return inertia matrices and the forces that hold the model in random states, without its friction."""
    data, random, found = mujoco.MjData(model), np.random.default_rng(seed), []
    for _ in range(n):
        data.qpos[:] = random.uniform(-1, 1, model.nq)
        data.qvel[:] = random.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        matrix = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, matrix)
        found.append(np.column_stack([matrix, data.qfrc_bias, data.qfrc_damper]))
    return np.array(found)


def compiled(text):
    spec = mujoco.MjSpec.from_string(text)
    return spec.compile()


@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_is_listed_by_name_and_can_be_simulated(name):
    machine = make_simulator(name)
    assert machine.compiled().opt.timestep * machine.frame_skip == pytest.approx(machine.dt)
    rows = np.zeros((3, len(machine.input_names)))
    assert np.isfinite(machine.predict(rows)).all()
    with pytest.raises(ValueError, match=f"unknown condition of {name} 'heavy'. There are: normal"):
        make_simulator(name, condition="heavy")


@published
def test_so101_is_the_official_model_with_the_joints_of_the_logs():
    text = (Path(HOME) / "so101" / "so101_plain.xml").read_text()
    official, ours = compiled(text), make_simulator("so101").compiled()
    np.testing.assert_allclose(dynamics(ours), dynamics(official), rtol=1e-4, atol=1e-7)
    for field in (
        "actuator_gainprm",
        "actuator_biasprm",
        "actuator_forcerange",
        "dof_frictionloss",
        "dof_armature",
    ):
        np.testing.assert_allclose(getattr(ours, field), getattr(official, field), rtol=1e-9, err_msg=field)
    np.testing.assert_allclose(ours.jnt_range, official.jnt_range, rtol=1e-6)
    names = (Path(HOME) / "so101" / "joint_list.txt").read_text().split()
    assert make_simulator("so101").state_names[:6] == tuple(f"qpos.{name}" for name in names)


@published
def test_go2_is_the_published_model_hung_up():
    text = (Path(HOME) / "go2_air" / "go2_plain.xml").read_text()
    text = re.sub(r"<keyframe>.*?</keyframe>", "", text.replace("<freejoint/>", ""), flags=re.DOTALL)
    theirs, ours = compiled(text), make_simulator("go2_air").compiled()
    assert [ours.joint(index).name for index in range(12)] == [
        theirs.joint(index).name for index in range(12)
    ]
    np.testing.assert_allclose(dynamics(ours), dynamics(theirs), rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(ours.jnt_range, theirs.jnt_range)
    np.testing.assert_allclose(ours.dof_frictionloss, theirs.dof_frictionloss)
    np.testing.assert_allclose(ours.actuator_forcerange, theirs.actuator_ctrlrange)


@published
def test_ricmonk_is_the_published_description_hanging_by_its_first_arm():
    tree = ElementTree.parse(Path(HOME) / "ricmonk" / "ricmonk.urdf").getroot()
    ours = make_simulator("ricmonk").compiled()
    for name, link in {"arm1": "hook_1", "tail": "tail", "arm2": "link2", "hook2": "hook_2"}.items():
        inertial = tree.find(f"link[@name='{link}']/inertial")
        inertia = {key: float(value) for key, value in inertial.find("inertia").attrib.items()}
        xx, yy, zz, xy, xz, yz = (inertia[key] for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
        body, turn = ours.body(name), np.zeros(9)
        assert body.mass[0] == pytest.approx(float(inertial.find("mass").get("value")), rel=1e-12)
        centre = [float(one) for one in inertial.find("origin").get("xyz").split()]
        np.testing.assert_allclose(body.ipos, centre, atol=1e-12)
        mujoco.mju_quat2Mat(turn, body.iquat)
        axes = turn.reshape(3, 3)
        matrix = axes @ np.diag(body.inertia) @ axes.T
        np.testing.assert_allclose(matrix, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], atol=1e-9)
    places = {"tail": "Joint1", "arm2": "Joint3", "hook2": "virtual_fixed_link"}
    for name, joint in places.items():
        origin = tree.find(f"joint[@name='{joint}']/origin").get("xyz")
        np.testing.assert_allclose(ours.body(name).pos, [float(one) for one in origin.split()], atol=1e-9)
    hanging = mujoco.MjData(ours)
    mujoco.mj_forward(ours, hanging)
    assert hanging.body("hook2").xpos[2] == pytest.approx(-2 * 0.314009, abs=1e-4)  # arm under arm


@published
def test_double_pendulum_has_the_equations_of_its_authors():
    lines = (Path(HOME) / "double_pendulum" / "model_parameters.yml").read_text().splitlines()
    p = {name: float(value) for name, value in (line.split(":") for line in lines if line.strip())}
    model = make_simulator("double_pendulum").compiled()
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(10):
        first, second = data.qpos[:] = random.uniform(-2, 2, 2)
        mujoco.mj_forward(model, data)
        matrix = np.zeros((2, 2))
        mujoco.mj_fullM(model, data, matrix)
        coupled = p["m2"] * p["l1"] * p["r2"] * np.cos(second)
        rotor = p["gr"] ** 2 * p["Ir"]
        expected = np.array(
            [
                [
                    p["I1"] + p["I2"] + p["m2"] * p["l1"] ** 2 + 2 * coupled + rotor + p["Ir"],
                    p["I2"] + coupled,
                ],
                [p["I2"] + coupled, p["I2"] + rotor],
            ]
        )
        np.testing.assert_allclose(matrix, expected, rtol=1e-9)
        far = p["m2"] * p["g"] * p["r2"] * np.sin(first + second)
        near = p["g"] * (p["m1"] * p["r1"] + p["m2"] * p["l1"]) * np.sin(first)
        np.testing.assert_allclose(data.qfrc_bias, [near + far, far], rtol=1e-9)


def test_pendulum_is_a_point_mass_on_a_rod():
    model = make_simulator("pendulum").compiled()
    found = dynamics(model)[:, 0]
    np.testing.assert_allclose(found[:, 0], 0.6755 * 0.5**2, rtol=1e-4)


def test_ur10_reaches_as_far_as_the_manufacturers_dimensions_say():
    """Stretched out, the last joint is the sum of the Denavit-Hartenberg lengths away."""
    model = make_simulator("ur10").compiled()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    x, y, z = data.body("wrist_3_link").xpos
    a2, a3, d1, d4, d5 = 0.612, 0.5723, 0.1273, 0.163941, 0.1157
    np.testing.assert_allclose([x, y, z], [a2 + a3, d4, d1 - d5], atol=1e-9)
    assert model.body_mass.sum() == pytest.approx(28.7)
    assert sum(row[2] for row in UR10) == pytest.approx(28.7)
    # Holding the stretched arm, the shoulder carries each link's weight at its distance.
    lever = 12.93 * 0.306 + 3.87 * (a2 + 0.28615) + (1.96 + 1.96 + 0.202) * (a2 + a3)
    assert abs(data.qfrc_bias[1]) == pytest.approx(9.81 * lever, rel=1e-6)


@pytest.mark.parametrize("name", MACHINES)
def test_moments_of_inertia_are_those_of_bodies_that_can_be(name):
    """No moment is more than the sum of the others, and none of a body larger than a metre about its own centre."""
    model = make_simulator(name).compiled()
    for mass, moments in zip(model.body_mass[1:], model.body_inertia[1:]):
        assert 0 < mass < 15
        assert 2 * moments.max() <= moments.sum() * (1 + 1e-3)
        assert moments.max() < mass


@pytest.mark.parametrize(
    ("name", "rate"),
    [
        ("pendulum", 200),
        ("double_pendulum", 500),
        ("ur10", 125),
        ("so101", 50),
        ("go2_air", 200),
        ("ricmonk", 167),
    ],
)
def test_rows_come_as_often_as_the_robot_is_read(name, rate):
    machine = make_simulator(name)
    assert machine.compiled().opt.timestep in (0.001, 0.002)
    assert round(1 / machine.dt) == rate


def test_the_legs_of_a_go2_are_mirror_images():
    model = make_simulator("go2_air").compiled()
    for part in ("hip", "thigh", "calf"):
        bodies = {leg: model.body(f"{leg}_{part}") for leg in ("FL", "FR", "RL", "RR")}
        across = np.array([1.0, -1.0, 1.0])
        for left, right in (("FL", "FR"), ("RL", "RR")):
            for field in ("pos", "ipos"):
                np.testing.assert_allclose(
                    getattr(bodies[left], field), across * getattr(bodies[right], field), rtol=1e-12
                )
            tensors = []
            for leg in (left, right):
                turn = np.zeros(9)
                mujoco.mju_quat2Mat(turn, bodies[leg].iquat)
                axes = turn.reshape(3, 3)
                tensors.append(axes @ np.diag(bodies[leg].inertia) @ axes.T)
            np.testing.assert_allclose(tensors[0], np.outer(across, across) * tensors[1], atol=2e-8)
        assert {float(body.mass[0]) for body in bodies.values()} == {float(bodies["FL"].mass[0])}
    front, rear = model.body("FL_hip"), model.body("RL_hip")
    np.testing.assert_allclose(front.pos, rear.pos * [-1, 1, 1])
    np.testing.assert_allclose(front.ipos, rear.ipos * [-1, 1, 1])
    ranges = {
        name: model.joint(f"{name}_joint").range for name in ("FL_hip", "FL_calf", "FL_thigh", "RL_thigh")
    }
    assert ranges["FL_hip"][0] == -ranges["FL_hip"][1]
    assert -np.pi < ranges["FL_calf"][0] < ranges["FL_calf"][1] < 0  # knees bend one way
    # The hind thighs are the front ones, turned by sixty degrees.
    np.testing.assert_allclose(ranges["RL_thigh"] - ranges["FL_thigh"], np.radians(60), atol=1e-4)
    # Stretched, a leg is two links of one length.
    np.testing.assert_allclose(model.body("FL_calf").pos, [0, 0, -0.213])


def test_so101_turns_each_joint_by_less_than_a_turn_and_weighs_half_a_kilogram():
    model = make_simulator("so101").compiled()
    low, high = model.jnt_range.T
    assert (low < 0).all()
    assert (high > 0).all()
    assert (np.maximum(-low, high) < np.pi).all()
    np.testing.assert_allclose(-low[:4], high[:4], rtol=1e-6)
    assert 0.45 < model.body_mass.sum() < 0.55
    np.testing.assert_array_equal(model.actuator_ctrlrange, model.jnt_range)


def test_double_pendulum_has_links_of_one_kind_and_a_geared_rotor():
    """The rotor is felt by the gear's square; one more of it at the shoulder, whose motor turns with nothing."""
    model = make_simulator("double_pendulum").compiled()
    shoulder, elbow = model.dof_armature
    assert elbow / (shoulder - elbow) == pytest.approx(36)
    np.testing.assert_allclose(model.body("lower").pos, [0, 0, -0.2])
    assert 1.0 < model.body_mass.sum() < 1.3
    for body, reach in (("upper", 0.2), ("lower", 0.3)):
        assert 0.1 < -model.body(body).ipos[2] <= reach


def test_a_cylinder_of_a_ur10_has_the_inertia_that_mujoco_gives_one():
    model = make_simulator("ur10").compiled()
    for _, link, mass, length, *_ in UR10:
        text = (
            '<mujoco><worldbody><body><freejoint/><geom type="cylinder" '
            f'size="0.075 {length / 2}" mass="{mass}"/></body></worldbody></mujoco>'
        )
        shape = mujoco.MjModel.from_xml_string(text)
        np.testing.assert_allclose(
            np.sort(model.body(link).inertia), np.sort(shape.body_inertia[1]), rtol=1e-9
        )
    np.testing.assert_array_equal(model.actuator_ctrlrange[:, 0], -model.actuator_ctrlrange[:, 1])
    # Larger motors are nearer to the base, and come in three sizes.
    torques = model.actuator_ctrlrange[:, 1]
    assert (np.diff(torques) <= 0).all()
    np.testing.assert_array_equal(torques, [330, 330, 150, 54, 54, 54])
