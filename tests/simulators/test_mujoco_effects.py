"""Each effect of a MuJoCo model against plain MuJoCo with the same change made by hand in the MJCF."""

import math

import mujoco
import numpy as np
import pytest

from skat.effects import Effect
from skat.simulators import MujocoSimulator
from skat.simulators.mujoco import RESERVED
from tests.machines import changed, plain

ARM = """
<mujoco model="arm">
  <option timestep="0.002" gravity="0 0 -9.81" integrator="RK4"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" pos="0 0 -.5" friction="0.8"/>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" damping="0.1" stiffness="2" armature="0.02"/>
      <geom name="upper" type="capsule" size=".03" fromto="0 0 0 .4 0 0" density="900" contype="0"
      conaffinity="0"/> <body name="lower" pos=".4 0 0">
        <joint name="elbow" axis="0 1 0" pos="0.05 0 0" damping="0.2"/>
        <geom name="lower" type="capsule" size=".02 .15" pos=".15 0 0" euler="0 90 0" mass="0.5"/>
        <geom name="hand" size=".04" pos=".3 0 0" mass="0.2" friction="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="shoulder" gear="5" ctrlrange="-1 1" ctrllimited="true"/>
    <position name="servo" joint="elbow" kp="4" kv="0.1" forcerange="-1.2 0.8"/>
  </actuator>
</mujoco>
"""
CUBE = """
<mujoco model="cube">
  <option timestep="0.002" cone="elliptic"/>
  <worldbody>
    <geom name="table" type="plane" size="5 5 .1"/>
    <body name="cube"><freejoint name="toss"/><geom name="cube" type="box" size=".05 .05 .05"
    mass=".4"/></body>
  </worldbody>
</mujoco>
"""


def arm_rows(n=12):
    return np.random.default_rng(0).normal(size=(n, 6))


def cube_rows(n=12):
    random = np.random.default_rng(1)
    quaternions = random.normal(size=(n, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    heights = random.uniform(0.04, 0.07, size=(n, 1))
    return np.hstack([random.normal(size=(n, 2)), heights, quaternions, random.normal(size=(n, 6))])


# Hand and floor touch in half of the rows: inferred contact parameters matter.
ARM_CASES = {
    "gravity": ({"gravity": 1.3}, [("-9.81", "-12.753")]),
    "tilt[x]": ({"tilt[x]": 0.1}, [("0 0 -9.81", f"{9.81 * math.sin(0.1)} 0 {-9.81 * math.cos(0.1)}")]),
    "mass[upper]": ({"mass[upper]": 1.5}, [('density="900"', 'density="1350"')]),
    "mass[lower]": ({"mass[lower]": 0.5}, [('mass="0.5"', 'mass="0.25"'), ('mass="0.2"', 'mass="0.1"')]),
    "mass[all]": (
        {"mass[all]": 2.0},
        [('density="900"', 'density="1800"'), ('mass="0.5"', 'mass="1"'), ('mass="0.2"', 'mass="0.4"')],
    ),
    "length[lower]": (
        {"length[lower]": 1.2},
        [('size=".02 .15" pos=".15 0 0"', 'size=".02 .18" pos=".18 0 0"'), ('pos=".3 0 0"', 'pos=".36 0 0"'),
         ('pos="0.05 0 0"', 'pos="0.06 0 0"'), ('pos=".4 0 0"', 'pos=".39 0 0"')],
    ),
    "damping[elbow]": ({"damping[elbow]": 0.15}, [('damping="0.2"', 'damping="0.35"')]),
    "damping[elbow] less": ({"damping[elbow]": -0.15}, [('damping="0.2"', 'damping="0.05"')]),
    "damping[all]": (
        {"damping[all]": 0.1},
        [('damping="0.2"', 'damping="0.3"'), ('damping="0.1"', 'damping="0.2"')],
    ),
    "dry_friction[elbow]": (
        {"dry_friction[elbow]": 0.3},
        [('damping="0.2"', 'damping="0.2" frictionloss="0.3"')],
    ),
    "armature[shoulder]": ({"armature[shoulder]": 0.03}, [('armature="0.02"', 'armature="0.05"')]),
    "stiffness[shoulder]": ({"stiffness[shoulder]": 3.0}, [('stiffness="2"', 'stiffness="5"')]),
    "gain[shoulder]": ({"gain[shoulder]": -1.0}, [('gear="5"', 'gear="-5"')]),
    "offset[servo]": (
        {"offset[servo]": 0.2},
        [('<position name="servo" joint="elbow" kp="4" kv="0.1" ',
          '<general name="servo" joint="elbow" biastype="affine" gainprm="4" biasprm=".8 -4 -.1" ')],
    ),
    "gain[servo]": ({"gain[servo]": 0.5}, [('kp="4" kv="0.1"', 'kp="2" kv="0.05"')]),
    "force_limit[servo]": (
        {"force_limit[servo]": 0.25}, [('forcerange="-1.2 0.8"', 'forcerange="-0.3 0.2"')],
    ),
    "kp[servo]": ({"kp[servo]": 1.5}, [('kp="4" kv="0.1"', 'kp="6" kv="0.1"')]),
    "kv[servo]": ({"kv[servo]": 1.5}, [('kp="4" kv="0.1"', 'kp="4" kv="0.15"')]),
    "contact_friction[all]": (
        {"contact_friction[all]": 0.25},
        [('friction="0.8"', 'friction="0.2"'), ('friction="0.5"', 'friction="0.1"'),
         ('density="900"', 'density="900" friction="0.25"'), ('mass="0.5"', 'mass="0.5" friction="0.25"')],
    ),
    "contact_friction[hand]": ({"contact_friction[hand]": 1.5}, [('friction="0.5"', 'friction="1.2"')]),
    "timestep": ({"timestep": 0.5}, [('timestep="0.002"', 'timestep="0.001"')]),
}  # fmt: skip


@pytest.mark.parametrize("case", ARM_CASES)
def test_effect_is_the_change_made_by_hand(case):
    values, changes = ARM_CASES[case]
    text = changed(ARM, *changes)
    rows = arm_rows()
    n_steps = 4 if case != "timestep" else 8
    simulator = MujocoSimulator(ARM, frame_skip=4)
    found = simulator.predict(rows, effects=values)
    np.testing.assert_allclose(found, plain(text, rows, n_steps), rtol=1e-9, atol=1e-9)
    assert np.abs(found - simulator.predict(rows)).max() > 1e-8


def test_length_keeps_the_mass_and_recomputes_the_inertia():
    simulator = MujocoSimulator(ARM)
    nominal, longer = simulator.compiled(), simulator.compiled({"length[upper]": 1.5})
    np.testing.assert_allclose(longer.body_mass, nominal.body_mass, rtol=1e-12)
    by_hand = mujoco.MjModel.from_xml_string(
        changed(
            ARM,
            ("0 0 0 .4 0 0", "0 0 0 .6 0 0"),
            ('density="900"', f'mass="{float(nominal.body_mass[1])!r}"'),
        )
    )
    np.testing.assert_allclose(longer.body_inertia[1], by_hand.body_inertia[1], rtol=1e-9)
    # The elbow, 0.05 from the lower link's frame, was at 0.45.
    np.testing.assert_allclose(longer.body_pos[2] + longer.jnt_pos[1], [0.675, 0, 0])


def leg(thigh=1.0, shin=1.0, *, off_joints=False):
    """Return a leg whose links are so much longer, its bodies' frames at their joints or elsewhere."""
    x, z, low = (0.1, 0.2, 0.3) if off_joints else (0.0, 0.0, 0.0)
    thigh_end, foot = f"{-0.5 * thigh - z}", f"{0.1 * shin} 0 {-0.4 * shin - low}"
    shin_frame = f"{low * math.sin(0.3)} 0 {low * math.cos(0.3)}"
    knee = f"{-0.7 * math.cos(0.4)} {0.7 * math.sin(0.4)} {-low}"
    return f"""<mujoco><compiler angle="radian"/><worldbody><geom type="plane" size="5 5 .1" pos="0 0 .2"/>
    <body name="thigh" pos="{x} 0 {1 + z}"><joint name="hip" axis="0 1 0" pos="{-x} 0 {-z}"/>
      <geom type="capsule" size=".05" fromto="{-x} 0 {-z} {-x} 0 {thigh_end}" mass="2"/>
      <frame pos="{-x} {0.1 * thigh} {thigh_end}" euler="0 0 1.2"><body name="shin" pos="{shin_frame}" euler="0 .3 0">
        <frame pos=".7 0 0" euler="0 0 .4"><joint name="knee" axis="0 1 0" pos="{knee}"/></frame>
        <geom type="capsule" size=".04" fromto="0 0 {-low} {foot}" mass="1"/>
        <geom type="sphere" size=".06" pos="{foot}" mass=".3"/>
      </body></frame>
    </body></worldbody></mujoco>"""


@pytest.mark.parametrize("off_joints", [False, True])
@pytest.mark.parametrize(("link", "lengths"), [("thigh", (1.4, 1)), ("shin", (1, 1.4)), ("all", (1.4, 1.4))])
def test_a_longer_link_begins_at_its_joint_and_leaves_the_others_as_they_are(link, lengths, off_joints):
    rows = np.random.default_rng(0).normal(size=(12, 4))
    simulator = MujocoSimulator(leg(off_joints=off_joints), frame_skip=4)
    found = simulator.predict(rows, effects={f"length[{link}]": 1.4})
    np.testing.assert_allclose(found, plain(leg(*lengths), rows, 4), rtol=1e-9, atol=1e-9)


def test_mass_scales_the_inertia_too():
    simulator = MujocoSimulator(CUBE)
    nominal, heavy = simulator.compiled(), simulator.compiled({"mass[cube]": 3.0})
    np.testing.assert_allclose(heavy.body_mass, 3 * nominal.body_mass)
    np.testing.assert_allclose(heavy.body_inertia, 3 * nominal.body_inertia)


@pytest.mark.parametrize("mode", ["", '<compiler inertiafromgeom="true"/>'])
@pytest.mark.parametrize(("text", "body"), [(ARM, "lower"), (CUBE, "cube")])
def test_inertia_changes_and_nothing_else_does(text, body, mode):
    rows = arm_rows() if text is ARM else cube_rows()
    simulator = MujocoSimulator(text.replace("<option", mode + "<option"), frame_skip=4)
    found = simulator.predict(rows, effects={f"inertia[{body}]": 1.5})
    np.testing.assert_allclose(found, plain(text, rows, 4, inertia={body: 1.5}), rtol=1e-8, atol=1e-8)
    assert np.abs(found - simulator.predict(rows)).max() > 1e-4


def test_inertia_is_that_of_the_changed_link():
    simulator, link = MujocoSimulator(ARM), {"mass[lower]": 2.0, "length[lower]": 1.2}
    both, rounder = simulator.compiled(link), simulator.compiled({"inertia[lower]": 1.5, **link})
    np.testing.assert_allclose(rounder.body("lower").inertia, 1.5 * both.body("lower").inertia)
    np.testing.assert_allclose(rounder.body_mass, both.body_mass)
    np.testing.assert_allclose(rounder.body_ipos, both.body_ipos, atol=1e-12)


def test_inertia_of_a_link_that_one_hinge_turns_is_the_armature_of_this_hinge():
    simulator = MujocoSimulator(ARM, frame_skip=4)
    assert {"inertia[lower]"} == {effect.name for effect in simulator.effects() if effect.family == "inertia"}
    upper = simulator.compiled().body("upper")
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, upper.iquat)
    about_y = turn.reshape(3, 3)[1] ** 2 @ upper.inertia
    np.testing.assert_allclose(
        simulator.predict(arm_rows(), effects={"inertia[upper]": 1.5}),
        simulator.predict(arm_rows(), effects={"armature[shoulder]": 0.5 * about_y}),
        rtol=1e-9,
        atol=1e-9,
    )


def test_offset_is_that_of_a_servos_control():
    simulator, rows = MujocoSimulator(ARM, frame_skip=4), arm_rows()
    assert [(one.name, one.unit) for one in simulator.effects() if one.family == "offset"] == [
        ("offset[servo]", "rad")
    ]
    other = changed(
        ARM,
        ('position name="servo"', 'general name="servo"'),
        ('kp="4" kv="0.1"', 'gainprm="4" biasprm="0 -4"'),
    )
    assert not [
        one for one in MujocoSimulator(other).effects() if one.family == "offset"
    ]  # of no bias at all
    moved = rows.copy()
    moved[:, 5] += 0.2
    found, expected = (
        simulator.predict(X, effects={"gain[servo]": 0.5, **offset})
        for X, offset in ((rows, {"offset[servo]": 0.2}), (moved, {}))
    )
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("mode", ["", '<compiler inertiafromgeom="true"/>'])
def test_shifted_centre_of_mass_is_an_explicit_inertial(mode):
    simulator = MujocoSimulator(CUBE.replace("<option", mode + "<option"), frame_skip=5)
    inertia = 0.4 * 0.1**2 / 6
    inertial = f'<inertial pos="0 .02 0" mass=".4" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>'
    text = changed(CUBE, ("<freejoint", inertial + "<freejoint"))
    found = simulator.predict(cube_rows(), effects={"centre_of_mass[cube.y]": 0.02})
    np.testing.assert_allclose(found, plain(text, cube_rows(), 5), rtol=1e-8, atol=1e-8)


def test_wind_is_a_constant_force_at_the_centre_of_mass():
    values = {"wind[x]": 0.7, "wind[z]": -0.2}
    found = MujocoSimulator(CUBE, frame_skip=5).predict(cube_rows(), effects=values)
    np.testing.assert_allclose(
        found, plain(CUBE, cube_rows(), 5, force=[0.7, 0, -0.2]), rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize("text", [ARM, CUBE])
def test_joint_forces_are_generalised_forces(text):
    simulator = MujocoSimulator(text, frame_skip=5)
    rows = arm_rows() if text is ARM else cube_rows()
    names = [force.name for force, _ in simulator.joint_forces()]
    assert not set(names) & {effect.name for effect in simulator.effects()}
    candidates = [{}, *({name: 0.01} for name in names), dict(zip(names, (0.02, -0.01)))]
    forces = np.vstack([np.zeros(len(names)), 0.01 * np.eye(len(names)), np.zeros(len(names))])
    forces[-1, :2] = 0.02, -0.01
    found = simulator.predict_many(rows, candidates)
    wanted = [plain(text, rows, 5, joint_forces=one) for one in forces]
    np.testing.assert_allclose(found, simulator._layout.aligned(np.array(wanted), found), atol=1e-12)
    np.testing.assert_array_equal(simulator.predict(rows), found[0])  # nothing stays behind


def test_inputs_of_a_joint_force_are_its_position_velocity_and_control():
    inputs = {force.name: names for force, names in MujocoSimulator(ARM).joint_forces()}
    assert inputs["force[elbow]"] == ("qpos.elbow", "qvel.elbow", "ctrl.servo")
    inputs = {force.name: names for force, names in MujocoSimulator(CUBE).joint_forces()}
    assert inputs["force[toss.x]"] == ("qpos.toss.x", "qvel.toss.vx")
    assert inputs["force[toss.rz]"] == ("qpos.toss.qz", "qvel.toss.wz")
    thruster = '<actuator><motor name="lift" joint="toss" gear="0 0 1 0 0 0"/></actuator></mujoco>'
    inputs = {
        force.name: names
        for force, names in MujocoSimulator(changed(CUBE, ("</mujoco>", thruster))).joint_forces()
    }
    assert [name for name, names in inputs.items() if "ctrl.lift" in names] == ["force[toss.z]"]


def test_extra_effect_must_have_a_name_of_its_own():
    again = Effect("gravity", unit="1", neutral=1.0, bounds=(0.5, 2.0), apply=lambda spec, value: None)
    with pytest.raises(ValueError, match="extra_effects names gravity"):
        MujocoSimulator(ARM, extra_effects=(again,)).effects()


@pytest.mark.parametrize("name", [*(f"{family}[foo]" for family in RESERVED), "lag[qpos.shoulder]", "delay"])
def test_extra_effect_is_of_no_family_that_acts_by_its_name(name):
    own = Effect(name, unit="1", neutral=0.0, bounds=(0.0, 2.0), apply=lambda spec, value: None)
    with pytest.raises(ValueError, match="choose another family"):
        MujocoSimulator(ARM, extra_effects=(own,)).effects()


@pytest.mark.parametrize(
    ("values", "exponent"),
    [({"air_drag[all]": 0.02}, None), ({"air_drag[x]": 0.02, "air_drag[y]": 0.01}, "axes")],
)
def test_air_drag_on_a_free_body_follows_its_equation(values, exponent):
    weightless = CUBE.replace("<option", '<option gravity="0 0 0"')
    rows = np.zeros((1, 13))
    rows[0, :7], rows[0, 7:10], rows[0, 10:] = [0, 0, 9, 1, 0, 0, 0], [30.0, -20.0, 0.0], [1.0, 2.0, 3.0]
    n_steps, mass = 500, 0.4
    found = MujocoSimulator(weightless, frame_skip=n_steps).predict(rows, effects=values)[0, 7:9]
    time, start = 0.002 * n_steps, rows[0, 7:9]
    if exponent is None:  # dv/dt = -c/m |v| v: 1/|v| grows by c t / m
        expected = start / (1 + 0.02 / mass * np.linalg.norm(start) * time)
    else:
        expected = start / (1 + np.array([0.02, 0.01]) / mass * np.abs(start) * time)
    np.testing.assert_allclose(
        found, expected, rtol=2e-3
    )  # explicit Euler of step 2 ms; halves with the step
    finer = MujocoSimulator(weightless.replace("0.002", "0.0005"), frame_skip=4 * n_steps)
    error = [np.abs(other - expected).max() for other in (found, finer.predict(rows, effects=values)[0, 7:9])]
    assert error[1] < 0.3 * error[0]


def test_air_drag_along_a_slide_is_quadratic_damping():
    ball = """<mujoco><option integrator="RK4"/><worldbody><body name="ball"><joint name="fall" type="slide"
    axis="0 0 1"%s/><geom size=".1" mass=".5"/></body></worldbody></mujoco>"""
    rows = np.array([[50.0, -3.0], [20.0, 12.0]])
    found = MujocoSimulator(ball % "", frame_skip=20).predict(rows, effects={"air_drag[z]": 0.03})
    np.testing.assert_allclose(found, plain(ball % ' damping="0 0.03"', rows, 20), rtol=1e-12)
    speed = math.sqrt(0.5 * 9.81 / 0.03)
    fallen = MujocoSimulator(ball % "", frame_skip=1000).predict(
        [[50.0, 0.0]], effects={"air_drag[all]": 0.03}
    )
    np.testing.assert_allclose(fallen[0, 1], -speed * math.tanh(9.81 * 2 / speed), rtol=1e-6)


def test_air_drag_along_a_slide_is_written_as_mjcf(tmp_path):
    text = """<mujoco><worldbody><body name="ball"><joint name="fall" type="slide" axis="0 0 1"/>
    <geom size=".1" mass=".5"/></body></worldbody></mujoco>"""
    falling = MujocoSimulator(text, frame_skip=20).extended({"air_drag[z]": 0.03})
    (written,) = falling.to_mjcf(tmp_path / "ball.xml")
    rows = np.array([[50.0, -3.0], [20.0, 12.0]])
    np.testing.assert_array_equal(plain(written.read_text(), rows, 20), falling.predict(rows))


def test_position_friction_holds_up_to_its_size_times_the_angle():
    arm = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="hinge" axis="0 0 1"/>
    <geom size=".1" pos=".3 0 0" mass="1"/></body></worldbody>
    <actuator><motor joint="hinge"/></actuator></mujoco>"""
    rows = np.array([[angle, 0.0, torque] for angle in (-0.5, 0.5) for torque in (0.9, 1.1)])
    simulator = MujocoSimulator(arm, frame_skip=20)
    rates = simulator.predict(rows, effects={"position_friction[hinge]": 2.0})[:, 1]
    free = simulator.predict(rows)[:, 1]
    assert np.abs(rates[[0, 2]]).max() < 0.03 * free[0]  # the hold of MuJoCo's dry friction is soft
    np.testing.assert_allclose(rates[[1, 3]], free[[1, 3]] * 0.1 / 1.1, rtol=0.05)
    constant = simulator.predict(rows, effects={"dry_friction[hinge]": 1.0})
    np.testing.assert_allclose(rates, constant[:, 1], rtol=0.05, atol=1e-4)


def test_anisotropy_is_an_explicit_pair():
    text = changed(
        CUBE,
        (
            "</mujoco>",
            '<contact><pair geom1="table" geom2="cube" friction="1 .4 .005"/></contact></mujoco>',
        ),
    )
    rows = cube_rows()
    rows[:, 3:7], rows[:, 2], rows[:, 10:] = [1, 0, 0, 0], 0.0499, 0
    found = MujocoSimulator(CUBE, frame_skip=10).predict(rows, effects={"contact_anisotropy[all]": 0.4})
    np.testing.assert_allclose(found, plain(text, rows, 10), rtol=1e-9, atol=1e-9)


def test_restitution_scales_the_damping_ratio():
    text = changed(
        CUBE, ('size="5 5 .1"', 'size="5 5 .1" solref=".02 .3"'), ('mass=".4"', 'mass=".4" solref=".02 .3"')
    )
    found = MujocoSimulator(CUBE, frame_skip=10).predict(cube_rows(), effects={"restitution[all]": 0.3})
    np.testing.assert_allclose(found, plain(text, cube_rows(), 10), rtol=1e-9, atol=1e-9)
    single = MujocoSimulator(CUBE, frame_skip=10).predict(
        cube_rows(), effects={"restitution[table/cube]": 0.3}
    )
    np.testing.assert_allclose(found, single, rtol=1e-8, atol=1e-8)


GEOMS = {
    "defaults": ("", ""),
    "friction": ('friction="0.3 0.01 0.002"', 'friction="0.9 0.004 0.001"'),
    "priority": (
        'priority="1" friction="0.3" condim="4" solref="0.03 0.7"',
        'friction="0.9" solref="0.01 1"',
    ),
    "weights": (
        'solmix="3" solref="0.03 0.7" solimp="0.5 0.9 0.01"',
        'solref="0.01 1" solimp="0.9 0.99 0.002"',
    ),
    "direct": ('solref="-3000 -20"', 'solref="0.02 1"'),
    "margin": ('margin="0.004" gap="0.001"', 'margin="0.002" gap="0.002"'),
    "rolling": ('condim="6" friction="0.3 0.01 0.002"', 'condim="3"'),
}


@pytest.mark.parametrize("case", GEOMS)
def test_explicit_pair_has_the_parameters_that_mujoco_infers(case):
    table, cube = GEOMS[case]
    text = CUBE.replace('size="5 5 .1"', f'size="5 5 .1" {table}').replace('mass=".4"', f'mass=".4" {cube}')
    simulator = MujocoSimulator(text)
    nominal = simulator.compiled()
    paired = simulator.compiled({"contact_anisotropy[table/cube]": 2.0})
    contacts = []
    for model in (nominal, paired):
        data = mujoco.MjData(model)
        data.qpos[2] = 0.0499
        mujoco.mj_forward(model, data)
        contacts.append(data.contact)
    inferred, explicit = contacts
    assert paired.npair == 1
    np.testing.assert_allclose(explicit.friction[:, 1], 2 * inferred.friction[:, 1])
    for field in ("dim", "includemargin", "solref", "solimp", "dist", "frame"):
        np.testing.assert_allclose(
            getattr(explicit, field), getattr(inferred, field), atol=1e-14, err_msg=field
        )
    np.testing.assert_allclose(explicit.friction[:, [0, 2, 3, 4]], inferred.friction[:, [0, 2, 3, 4]])


def test_explicit_pairs_are_meant_by_name_not_by_order():
    """MuJoCo sorts explicit pairs as it compiles."""
    balls = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
    <body name="a"><freejoint/><geom name="a" size=".1"/></body>
    <body name="b"><freejoint/><geom name="b" size=".1"/></body></worldbody>
    <contact><pair name="between" geom1="b" geom2="a"/><pair name="below b" geom1="floor" geom2="b"/>
    <pair name="below a" geom1="a" geom2="floor"/></contact></mujoco>"""
    simulator = MujocoSimulator(balls)
    for name in ("between", "below a", "below b"):
        model = simulator.compiled({f"contact_friction[{name}]": 0.5})
        assert {model.pair(index).name for index in np.flatnonzero(model.pair_friction[:, 0] == 0.5)} == {
            name
        }
        assert np.sum(model.pair_friction[:, 1] == 0.5) == 1


@pytest.mark.parametrize("compiler", ["", '<compiler fusestatic="true" discardvisual="true"/>'])
def test_elements_in_frames_and_after_static_bodies_are_the_ones_meant(compiler):
    text = """<mujoco>%s<worldbody><body name="post" pos="0 0 1"><geom size=".1" contype="0" conaffinity="0"/>
    <body name="bracket" pos=".1 0 0"><geom size=".1"/></body></body>
    <body name="arm"><joint name="turn" axis="0 1 0"/>
    <frame pos="0 0 %s" euler="0 90 0"><geom type="capsule" size=".05 %s" mass="1"/>
    <body name="tip" pos="%s 0 0"><joint name="bend" axis="0 1 0"/><geom size=".05" mass="%s"/>
    <geom type="box" size=".1 .1 .1" mass="0" contype="0" conaffinity="0"/></body></frame></body></worldbody>
    </mujoco>"""
    rows = np.random.default_rng(0).normal(size=(5, 4))
    simulator = MujocoSimulator(text % (compiler, 0.2, 0.1, 0.3, 0.5), frame_skip=5)
    found = simulator.predict(rows, effects={"length[arm]": 1.5, "mass[tip]": 2.0})
    np.testing.assert_allclose(found, plain(text % (compiler, 0.3, 0.15, 0.45, 1.0), rows, 5), rtol=1e-9)


def transitions(actions, rows, delay, n_steps, timestep, text):
    """Step plain MuJoCo, the control changing at time ``delay`` of a transition from the previous row's."""
    model = mujoco.MjModel.from_xml_string(text)
    found = []
    for index, row in enumerate(rows):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = np.split(row[: model.nq + model.nv], 2)
        for step in range(n_steps):
            data.ctrl[:] = actions[max(index - 1, 0)] if (step + 0.5) * timestep < delay else actions[index]
            mujoco.mj_step(model, data)
        found.append(np.r_[data.qpos, data.qvel])
    return np.array(found)


def test_delay_holds_the_previous_action_for_the_first_part_of_each_transition():
    rows = arm_rows()
    simulator = MujocoSimulator(ARM, frame_skip=4)
    found = simulator.predict(rows, effects={"delay[action]": 0.004})
    np.testing.assert_allclose(found, transitions(rows[:, 4:], rows, 0.004, 4, 0.002, ARM), rtol=1e-12)
    grouped = simulator.predict(rows, effects={"delay[action]": 0.004}, groups=np.repeat([0, 1], 6))
    nominal = simulator.predict(rows)
    np.testing.assert_array_equal(grouped[[0, 6]], nominal[[0, 6]])
    np.testing.assert_array_equal(np.delete(grouped, 6, axis=0), np.delete(found, 6, axis=0))


def test_delay_of_a_whole_transition_is_the_previous_action():
    rows = arm_rows()
    simulator = MujocoSimulator(ARM, frame_skip=4)
    late = rows.copy()
    late[1:, 4:] = rows[:-1, 4:]
    for delay, lag in ((0.008, 1), (0.016, 2)):
        late[lag:, 4:] = rows[:-lag, 4:]
        late[:lag, 4:] = rows[0, 4:]
        found = simulator.predict(rows, effects={"delay[action]": delay})
        np.testing.assert_allclose(found, simulator.predict(late), rtol=1e-12)


def test_delay_is_continuous():
    rows, simulator = arm_rows(), MujocoSimulator(ARM, frame_skip=4)
    delays = np.linspace(0, 0.012, 49)
    found = simulator.predict_many(rows, [{"delay[action]": delay} for delay in delays])
    jumps = np.abs(np.diff(found, axis=0)).max(axis=(1, 2))
    assert jumps.max() < 3 * np.median(jumps)


def test_timestep_is_continuous_between_whole_numbers_of_steps():
    rows, simulator = arm_rows(), MujocoSimulator(ARM, frame_skip=4)
    exact = simulator.predict_many(
        rows, [{"timestep": value} for value in (1.0, 0.8, 4 / 4.5, 1 - 1e-9, 4 / (5 - 1e-7))]
    )
    np.testing.assert_allclose(exact[2], (exact[0] + exact[1]) / 2, atol=1e-12)
    np.testing.assert_allclose(exact[3], exact[0], atol=1e-9)
    np.testing.assert_allclose(exact[4], exact[1], atol=1e-7)


@pytest.mark.parametrize(("integrator", "order"), [("Euler", 1), ("implicitfast", 1), ("RK4", 4)])
def test_steps_finer_than_are_run_are_off_no_more_than_such_steps_are(integrator, order):
    """Beside two hundred steps for one of the model."""
    text = ARM.replace("RK4", integrator)
    rows, simulator = arm_rows(), MujocoSimulator(text, frame_skip=4)
    step = f'timestep="{simulator.dt / 4:g}"'
    assert step in text
    fine = text.replace(step, f'timestep="{simulator.dt / 800:g}"').replace(integrator, "RK4")
    truth = MujocoSimulator(fine, frame_skip=800).predict(rows)
    factors = np.array([1.0, 0.2, 0.2 - 1e-9, 0.05, 0.01])
    found = simulator.predict_many(rows, [{"timestep": one} for one in factors])
    coarse, *rest = (np.sqrt(np.mean((one - truth) ** 2)) for one in found)
    assert (np.array(rest) / coarse < factors[1:] ** order + 0.005).all()
    np.testing.assert_allclose(found[2], found[1], atol=1e-9)


@pytest.mark.parametrize("text", [ARM, CUBE])
def test_neutral_values_change_no_bit(text):
    simulator = MujocoSimulator(text, frame_skip=4)
    rows = arm_rows() if text is ARM else cube_rows()
    neutral = {effect.name: effect.neutral for effect in simulator.all_effects()}
    np.testing.assert_array_equal(simulator.predict(rows, effects=neutral), simulator.predict(rows))


@pytest.mark.parametrize("text", [ARM, CUBE])
def test_every_bound_compiles_and_stays_finite(text):
    simulator = MujocoSimulator(text, frame_skip=4)
    rows = arm_rows(4) if text is ARM else cube_rows(4)
    for effect in simulator.effects():
        if effect.family not in {"bias", "scale"}:
            simulator.predict_many(rows, [{effect.name: bound} for bound in effect.bounds])
            assert np.isfinite(simulator.predict(rows, effects={effect.name: effect.bounds[1]})).all(), (
                effect.name
            )


@pytest.mark.parametrize("text", [ARM, CUBE])
def test_every_listed_effect_changes_something(text):
    simulator = MujocoSimulator(text, frame_skip=10)
    rows = arm_rows(60) if text is ARM else cube_rows(40)
    for effect in simulator.effects():
        low, high = effect.bounds
        value = effect.neutral + 0.2 * (high - effect.neutral) if high > effect.neutral else 0.5 * low
        change = np.abs(simulator.predict(rows, effects={effect.name: value}) - simulator.predict(rows)).max()
        # The cube's place on the table does not matter, nor its mass where gravity is the only other force.
        invisible = {"bias[qpos.toss.x]", "bias[qpos.toss.y]", "mass[cube]"}
        assert change > 1e-9 or effect.name in invisible, effect.name


def test_effects_that_cannot_matter_are_not_listed():
    arm = {effect.name for effect in MujocoSimulator(ARM).effects()}
    cube = {effect.name for effect in MujocoSimulator(CUBE).effects()}
    assert not arm & {
        "tilt[y]",
        "wind[y]",
        "air_drag[y]",
        "centre_of_mass[upper.y]",
    }  # it moves in the x, z plane
    assert not {
        name for name in cube if name.startswith(("gain", "delay", "length", "armature", "dry_friction"))
    }
    assert {"tilt[x]", "tilt[y]", "wind[z]", "damping[toss]", "contact_friction[all]"} <= cube
    no_contact = MujocoSimulator(CUBE.replace('size="5 5 .1"', 'size="5 5 .1" contype="0" conaffinity="0"'))
    families = {effect.family for effect in no_contact.effects()}
    assert not families & {"contact_friction", "contact_anisotropy", "restitution"}


def test_effects_that_repeat_another_are_accepted_but_not_listed():
    simulator = MujocoSimulator(CUBE)
    listed = {effect.name for effect in simulator.effects()}
    assert "mass[all]" not in listed
    assert "contact_friction[cube]" not in listed
    rows = cube_rows()
    np.testing.assert_array_equal(
        simulator.predict(rows, effects={"mass[all]": 2.0}),
        simulator.predict(rows, effects={"mass[cube]": 2.0}),
    )


def test_scaling_masses_and_all_forces_together_is_a_symmetry():
    values = {"mass[all]": 2.0, "armature[shoulder]": 0.02, "damping[shoulder]": 0.1, "damping[elbow]": 0.2}
    values |= {"stiffness[shoulder]": 2.0, "gain[all]": 2.0, "force_limit[servo]": 2.0}
    rows, simulator = (
        arm_rows(),
        MujocoSimulator(ARM.replace("<geom ", '<geom contype="0" conaffinity="0" ', 1), frame_skip=4),
    )
    np.testing.assert_allclose(
        simulator.predict(rows, effects=values), simulator.predict(rows), rtol=1e-8, atol=1e-9
    )


def test_a_joint_force_is_a_torque_where_its_joint_turns():
    units = {force.name: force.unit for force, _ in MujocoSimulator(ARM).joint_forces()}
    assert units["force[elbow]"] == "N m"
    slide = ARM.replace('name="elbow"', 'name="elbow" type="slide"')
    assert {force.unit for force, _ in MujocoSimulator(slide).joint_forces()} >= {"N"}
    units = {force.name: force.unit for force, _ in MujocoSimulator(CUBE).joint_forces()}
    assert [units[f"force[toss.{axis}]"] for axis in ("x", "y", "z", "rx", "ry", "rz")] == 3 * ["N"] + 3 * [
        "N m"
    ]
