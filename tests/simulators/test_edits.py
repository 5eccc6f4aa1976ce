"""Edits of a spec against the numbers of a model that has the change in its text."""

from functools import partial

import mujoco
import numpy as np
import pytest

from skat.simulators import edits
from skat.simulators.source import differing_fields

LINK = """<mujoco><compiler angle="{angle}" inertiafromgeom="{mode}"/><option timestep=".004" gravity="1 2 -9"/>
<worldbody><body name="link" pos="1 0 0"><joint name="hinge" axis="0 1 0" {joint}/>{parts}</body></worldbody>
{rest}</mujoco>"""
SIZE = '<geom type="box" size=".1 .2 .3" pos=".1 0 0" mass="2"/>'


def spec_of(parts=SIZE, *, joint="", rest="", angle="radian", mode="auto"):
    return mujoco.MjSpec.from_string(LINK.format(parts=parts, joint=joint, rest=rest, angle=angle, mode=mode))


def edited(edit, *values, **text):
    """Return the compiled model after an edit."""
    spec = spec_of(**text)
    edit(spec, *values)
    return spec.compile()


def tensor(model, body="link"):
    """Return mass, centre of mass and the inertia about it along the axes of the body."""
    one, turn = model.body(body), np.zeros(9)
    mujoco.mju_quat2Mat(turn, one.iquat)
    axes = turn.reshape(3, 3)
    return float(one.mass[0]), one.ipos, axes @ np.diag(one.inertia) @ axes.T


INERTIALS = {
    "from geoms": SIZE,
    "from density": '<geom type="box" size=".1 .2 .3" pos=".1 0 0" density="80"/>',
    "diagonal": '<inertial pos=".1 .2 0" euler=".3 .4 .5" mass="2" diaginertia=".1 .2 .25"/>',
    "full": '<inertial pos=".1 .2 0" mass="2" fullinertia=".1 .2 .25 .01 .02 .03"/>',
}


@pytest.mark.parametrize("mode", ["auto", "true"])
@pytest.mark.parametrize("case", INERTIALS)
def test_a_payload_adds_its_moments_to_those_of_the_body(case, mode):
    parts, place = INERTIALS[case], np.array([0.3, -0.2, 0.4])
    mass, centre, inertia = tensor(spec_of(parts, mode=mode).compile())
    found = tensor(edited(partial(edits.add_payload, 1, place), 0.5, parts=parts, mode=mode))
    total = mass + 0.5
    middle = (mass * centre + 0.5 * place) / total
    assert found[0] == pytest.approx(total, rel=1e-12)
    np.testing.assert_allclose(found[1], middle, rtol=1e-9)
    for part, at in ((mass, centre), (0.5, place)):
        arm = at - middle
        inertia = inertia + part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    np.testing.assert_allclose(found[2], inertia, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("mode", ["auto", "true"])
@pytest.mark.parametrize("case", INERTIALS)
def test_mass_inertia_and_centre_are_changed_apart_however_they_are_given(case, mode):
    parts = INERTIALS[case]
    mass, centre, inertia = tensor(spec_of(parts, mode=mode).compile())
    heavier = tensor(edited(partial(edits.scale_mass, [1]), 1.5, parts=parts, mode=mode))
    rounder = tensor(edited(partial(edits.scale_inertia, 1), 1.5, parts=parts, mode=mode))
    shifted = tensor(edited(partial(edits.shift_centre_of_mass, 1, 2), 0.07, parts=parts, mode=mode))
    for found, (factor, shift, spread) in zip(
        (heavier, rounder, shifted), ((1.5, 0.0, 1.5), (1.0, 0.0, 1.5), (1.0, 0.07, 1.0))
    ):
        assert found[0] == pytest.approx(factor * mass, rel=1e-9)
        np.testing.assert_allclose(found[1], centre + np.array([0.0, 0.0, shift]), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found[2], spread * inertia, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("case", ["diagonal", "full"])
def test_inertia_that_is_given_grows_with_the_square_of_a_length(case):
    parts = INERTIALS[case]
    mass, centre, inertia = tensor(spec_of(parts).compile())
    found = tensor(edited(partial(edits.scale_length, {}, [1]), 1.5, parts=parts))
    assert found[0] == pytest.approx(mass)
    np.testing.assert_allclose(found[1], 1.5 * centre)
    np.testing.assert_allclose(found[2], 1.5**2 * inertia, rtol=1e-9, atol=1e-12)


CAPSULE, CYLINDER = 'type="capsule" size=".03{}"', 'type="cylinder" size=".03{}"'


@pytest.mark.parametrize(
    ("geom", "longer"),
    [
        (CAPSULE.format(" .2") + ' pos="0 0 .2"', CAPSULE.format(" .3") + ' pos="0 0 .3"'),
        (CYLINDER.format(" .2") + ' pos="0 0 .2"', CYLINDER.format(" .3") + ' pos="0 0 .3"'),
        (CAPSULE.format("") + ' fromto=".1 0 0 .1 0 .4"', CAPSULE.format("") + ' fromto=".15 0 0 .15 0 .6"'),
        (CYLINDER.format("") + ' fromto=".1 0 0 .1 0 .4"', CYLINDER.format("") + ' fromto=".15 0 0 .15 0 .6"'),
        # Only the middle of what has no length of its own moves.
        ('type="box" size=".03" fromto=".1 0 0 .1 0 .4"', 'type="box" size=".03" fromto=".15 0 .1 .15 0 .5"'),
        ('type="sphere" size=".03" pos="0 .1 .2"', 'type="sphere" size=".03" pos="0 .15 .3"'),
        ('type="box" size=".03 .02 .1" pos="0 .1 .2"', 'type="box" size=".03 .02 .1" pos="0 .15 .3"'),
    ],
)  # fmt: skip
@pytest.mark.parametrize("weight", ['mass=".7"', 'density="700"', 'density="700" shellinertia="true"'])
def test_a_longer_geom_weighs_what_it_did(geom, longer, weight):
    before = spec_of(f"<geom {geom} {weight}/>").compile()
    found = edited(partial(edits.scale_length, {}, [1]), 1.5, parts=f"<geom {geom} {weight}/>")
    shell = 'shellinertia="true"' if "shell" in weight else ""
    heavy = f'mass="{float(before.body_mass[1])!r}" {shell}'
    wanted = spec_of(f"<geom {longer} {heavy}/>").compile()
    for name in ("body_mass", "body_ipos", "body_inertia", "geom_size", "geom_pos"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(wanted, name), rtol=1e-9, atol=1e-12, err_msg=name
        )


@pytest.mark.parametrize(("axis", "about"), [(0, [0, -1, 0]), (1, [1, 0, 0])])
def test_a_slope_turns_gravity_as_a_whole(axis, about):
    """About -y, so that what points down points along x as well; about x, so that it points along y."""
    quaternion, turned = np.zeros(4), np.zeros(3)
    mujoco.mju_axisAngle2Quat(quaternion, np.array(about, float), 0.3)
    mujoco.mju_rotVecQuat(turned, np.array([1.0, 2.0, -9.0]), quaternion)
    found = edited(partial(edits.tilt_gravity, axis), 0.3).opt.gravity
    np.testing.assert_allclose(found, turned, rtol=1e-12)
    assert found[axis] > (1.0, 2.0)[axis]


DRIVE = '<actuator><general name="drive" joint="hinge" {}/></actuator>'


def test_a_command_is_scaled_with_its_range():
    drive = DRIVE.format('gainprm="4 1 2" biastype="affine" biasprm="1 -4" ctrlrange="-1 3"')
    for factor, limits in ((2.0, [-0.5, 1.5]), (-0.5, [-6.0, 2.0]), (0.0, [-1.0, 3.0])):
        found = edited(partial(edits.scale_command, 0), factor, rest=drive)
        np.testing.assert_allclose(found.actuator_gainprm[0, :3], factor * np.array([4.0, 1.0, 2.0]))
        np.testing.assert_allclose(found.actuator_biasprm[0, :3], [1.0, -4.0, 0.0])
        np.testing.assert_allclose(found.actuator_ctrlrange[0], limits)


def test_a_command_is_shifted_with_its_range():
    found = edited(partial(edits.shift_command, 0), 0.5, rest=DRIVE.format('gainprm="4" ctrlrange="-1 3"'))
    np.testing.assert_allclose(found.actuator_biasprm[0, :3], [2.0, 0.0, 0.0])
    np.testing.assert_allclose(found.actuator_ctrlrange[0], [-1.5, 2.5])
    servo = DRIVE.format('gainprm="4" biastype="affine" biasprm="1 -4"')
    for edit in (edits.shift_command, edits.offset_command):
        found = edited(partial(edit, 0), 0.5, rest=servo)
        np.testing.assert_allclose(found.actuator_biasprm[0, :3], [3.0, -4.0, 0.0])


@pytest.mark.parametrize(
    ("own", "delay", "total", "samples", "interpolation"),
    [
        ("", 0.008, 0.008, 3, 1),
        ("", 0.009, 0.009, 4, 1),
        ('delay=".008" nsample="9"', 0.008, 0.016, 5, 0),
        ('delay=".008" nsample="9" interp="linear"', 0.001, 0.009, 4, 1),
    ],
)
def test_a_delay_adds_to_the_models_and_keeps_as_many_samples_as_it_needs(
    own, delay, total, samples, interpolation
):
    spec = spec_of(rest=DRIVE.format(own))
    edits.delay_actuators([0], spec, delay)
    (drive,) = spec.actuators
    assert (drive.delay, drive.nsample) == (pytest.approx(total), samples)
    assert drive.interp == interpolation


@pytest.mark.parametrize(
    ("own", "lag"),
    [
        ("", 0.02),
        ('dyntype="filterexact" dynprm=".03" actearly="true"', 0.0480),
        ('dyntype="filterexact" dynprm=".03"', 0.02),
        ('actearly="true"', 0.02),
    ],
)
def test_a_filter_of_commands_comes_as_late_in_the_mean_and_adds_to_one_that_is_there(own, lag):
    found = edited(partial(edits.filter_commands, [0]), 0.02, rest=DRIVE.format(own))
    assert found.actuator_dyntype[0] == mujoco.mjtDyn.mjDYN_FILTEREXACT
    assert found.actuator_actearly[0]
    # Behind a command that grows steadily, as it is in MuJoCo at the end of each time step, by so much.
    step, data, rate = found.opt.timestep, mujoco.MjData(found), 10.0
    for k in range(1000):
        data.ctrl[0] = rate * step * k
        mujoco.mj_step(found, data)
    assert (data.ctrl[0] - data.act[0]) / rate == pytest.approx(lag, abs=2e-4)


def test_a_limit_of_the_force_is_that_of_both_ends_and_only_missing_ones_are_prepared():
    off = 'forcelimited="false" forcerange="-1 2"'
    for limits, expected in (("", [-7, 7]), (off, [-7, 7]), ('forcerange="-1 2"', [-1, 2])):
        rest = DRIVE.format(limits + ' gainprm="-3.5"')
        limited = edited(partial(edits.limit_force, 0), 3.0, rest=rest)
        np.testing.assert_array_equal(limited.actuator_forcerange[0], [-3, 3])
        tiring = edited(partial(edits.prepare_tiring, 0, 2.0), 0.1, rest=rest)
        np.testing.assert_array_equal(tiring.actuator_forcerange[0], expected)
        assert limited.actuator_forcelimited[0]
        assert tiring.actuator_forcelimited[0]
    weaker = edited(partial(edits.scale_force_limit, [0]), 0.5, rest=DRIVE.format('forcerange="-1 2"'))
    np.testing.assert_array_equal(weaker.actuator_forcerange[0], [-0.5, 1.0])


@pytest.mark.parametrize("angle", ["radian", "degree"])
@pytest.mark.parametrize(("armature", "rotor"), [("", 0.02), ('armature=".3"', 0.3)])
@pytest.mark.parametrize("kind", ["hinge", "slide"])
def test_play_is_a_bare_joint_of_its_width_beyond_the_motors(angle, armature, rotor, kind):
    joint = (
        f'type="{kind}" pos=".1 .2 .3" damping=".4" stiffness="5" frictionloss=".6" margin=".1" {armature}'
    )
    key = '<keyframe><key qpos=".5"/></keyframe>'
    found = edited(partial(edits.add_play, "hinge", 0.02), 0.08, joint=joint, angle=angle, rest=key)
    plain = spec_of(joint=joint, angle=angle).compile()
    motor, play = found.joint("hinge"), found.joint("hinge.play")
    assert (found.nkey, found.njnt, motor.id, play.id) == (0, 2, 0, 1)
    np.testing.assert_allclose(found.dof_armature, [rotor, 0.0])
    np.testing.assert_allclose(found.dof_damping, [0.4, 0.0])
    np.testing.assert_allclose(found.dof_frictionloss, [0.6, 0.0])
    np.testing.assert_allclose(found.jnt_stiffness, [5.0, 0.0])
    np.testing.assert_allclose(found.jnt_margin, [0.1, 0.0])
    np.testing.assert_allclose(play.range, [-0.04, 0.04])
    np.testing.assert_allclose(found.jnt_solimp[1], [0.95, 0.99, 1e-4, 0.5, 2.0])
    for name in ("pos", "axis"):
        np.testing.assert_allclose(getattr(play, name), getattr(plain.joint("hinge"), name))


DAMPED = """<mujoco><option timestep=".01" integrator="{}" {}/><worldbody><body><joint name="hinge" armature=".2"
damping=".5"/><geom size=".1"/><body><joint name="tip" damping="3"/><geom size=".1"/></body></body></worldbody>
<tendon><fixed name="t" damping="{}"><joint joint="tip" coef="1"/></fixed></tendon><actuator>{}</actuator></mujoco>"""
LIMITED = '<position joint="hinge" kp="7" kv="4" forcerange="-1 1" {}/>'
GEARED = '<position joint="hinge" kp="7" kv="4" gear="3"/>'


@pytest.mark.parametrize(
    ("integrator", "option", "tendon", "actuator", "armatures"),
    [
        ("implicitfast", "", 0, GEARED, [0.2 + 0.01 * (0.5 + 4 * 9), 0, 0.01 * 3]),
        ("implicit", "", 0, '<motor joint="hinge"/>', [0.2 + 0.01 * 0.5, 0, 0.01 * 3]),
        ("Euler", "", 0, GEARED, [0.2 + 0.01 * 0.5, 0, 0.01 * 3]),
        # What the integrator treats explicitly, or what is not of joints, stays as it is.
        ("RK4", "", 0, GEARED, [0.2, 0, 0]),
        ("discrete", "", 0, GEARED, [0.2, 0, 0]),
        ("implicitfast", 'viscosity="1"', 0, GEARED, [0.2, 0, 0]),
        ("implicitfast", "", 0.1, GEARED, [0.2, 0, 0]),
        ("implicitfast", "", 0, '<position tendon="t" kp="7" kv="4"/>', [0.2, 0, 0]),
        ("implicitfast", "", 0, '<muscle joint="hinge" lengthrange="0 1"/>', [0.2, 0, 0]),
        # A servo with a limit feeds nothing back at it; a rotor that is lighter than h D comes first.
        ("implicitfast", "", 0, LIMITED.format(""), [0.2, 0, 0]),
        ("implicitfast", "", 0, LIMITED.format('gear="3"'), [0.2 + 0.01 * (0.5 + 4 * 9), 0, 0.01 * 3]),
    ],
)
def test_flanks_are_as_hard_as_the_time_step_allows_and_know_of_dampers_on_joints(
    integrator, option, tendon, actuator, armatures
):
    spec = mujoco.MjSpec.from_string(DAMPED.format(integrator, option, tendon, actuator))
    edits.add_play("hinge", 0.02, spec, 0.08)
    before = spec.copy().compile().opt
    explicit = edits.finish_plays(["hinge"], spec, {})
    found = spec.compile()
    np.testing.assert_allclose(found.dof_armature, armatures)
    np.testing.assert_allclose(found.jnt_solref[1], [2 * 0.01, 1.0])
    assert explicit == (armatures != [0.2, 0, 0])
    assert (found.opt.integrator != before.integrator) == (explicit and integrator != "Euler")
    assert bool(found.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP) == explicit


def test_each_of_several_joints_without_a_name_has_its_own_damper():
    bodies = "".join(f'<body><joint damping="{one}"/><geom size=".1"/></body>' for one in (2, 5))
    text = DAMPED.format("implicitfast", "", 0, GEARED).replace("</worldbody>", f"{bodies}</worldbody>")
    spec = mujoco.MjSpec.from_string(text)
    assert edits.finish_plays([], spec, {})
    np.testing.assert_allclose(spec.compile().dof_armature[-2:], [0.01 * 2, 0.01 * 5])


JOINTS = {
    "turn": '<joint name="turn" axis="0 0 1" damping=".1" armature=".01"/>{}',
    "tip": '<frame euler="0 .3 0" pos=".1 0 0"><joint name="tip" axis="1 0 0" range="-2 2" armature=".2" '
    'pos="0 .1 0" springref=".1" stiffness="3"/>{}</frame>',
    "push": '<joint name="push" type="slide" axis="0 1 0" frictionloss=".3" armature=".4"/>{}',
}
JOINT_PLAY = """<joint name="{name}.play" {same} limited="true" range="-.04 .04" ref="0"
    solimplimit=".95 .99 1e-4 .5 2" springdamper="0 0" actuatorfrclimited="false"/>"""
SAME = {"turn": 'axis="0 0 1"', "tip": 'axis="1 0 0" pos="0 .1 0"', "push": 'type="slide" axis="0 1 0"'}


@pytest.mark.parametrize("loose", [["turn"], ["tip"], ["push"], ["tip", "turn"]])
def test_play_follows_its_motor_whatever_else_turns_the_body(loose):
    """A joint turns the axes of those behind it; a default for joints is not meant for the play."""
    text = """<mujoco><compiler angle="radian"/><default><joint ref=".2" springref=".1" springdamper=".5 1"
    actuatorfrcrange="-3 3"/></default><option timestep=".004"/><worldbody><body name="body">{}
    <geom type="box" size=".1 .2 .3" pos=".3 0 0"/></body></worldbody><actuator>
    <motor joint="turn"/><motor joint="tip"/><motor joint="push"/></actuator></mujoco>"""
    plays = {name: JOINT_PLAY.format(name=name, same=SAME[name]) if name in loose else "" for name in JOINTS}
    wanted = mujoco.MjModel.from_xml_string(
        text.format("".join(JOINTS[name].format(plays[name]) for name in JOINTS))
    )
    spec = mujoco.MjSpec.from_string(text.format("".join(one.format("") for one in JOINTS.values())))
    for name in loose:
        edits.add_play(name, 0.02, spec, 0.08)
    found = spec.compile()
    differing = set(differing_fields(found, wanted))
    assert not differing - {"qpos_spring"}  # of a joint without a spring


def test_servos_gains_change_by_their_parts():
    servo = DRIVE.format('gainprm="4" biastype="affine" biasprm="1 -4 -.5"')
    for edit, gain, bias in (
        (edits.scale_gain, 8.0, [2.0, -8.0, -1.0]),
        (edits.scale_stiffness_of_servo, 8.0, [1.0, -8.0, -0.5]),
        (edits.scale_velocity_gain_of_servo, 4.0, [1.0, -4.0, -1.0]),
    ):
        found = edited(partial(edit, [0]), 2.0, rest=servo)
        np.testing.assert_allclose(found.actuator_gainprm[0, 0], gain)
        np.testing.assert_allclose(found.actuator_biasprm[0, :3], bias)


def test_an_inverted_servo_pushes_instead_of_braking():
    """MuJoCo's compiler takes a positive third parameter for a damping ratio, where the others are those of a servo."""
    servo = DRIVE.format('gainprm="4" biastype="affine" biasprm="0 -4 -.5"')
    found = edited(partial(edits.scale_gain, [0]), -1.0, rest=servo)
    np.testing.assert_allclose(found.actuator_gainprm[0, 0], -4.0, rtol=1e-12)
    np.testing.assert_allclose(found.actuator_biasprm[0, :3], [0.0, 4.0, 0.5], rtol=1e-12)


def test_time_step_and_gravity_are_multiplied():
    assert edited(edits.scale_timestep, 0.5).opt.timestep == pytest.approx(0.002)
    np.testing.assert_allclose(edited(edits.scale_gravity, 0.5).opt.gravity, [0.5, 1.0, -4.5])


HELD = """<mujoco><worldbody><body name="arm" gravcomp="{}"><joint axis="0 1 0"/>
<geom pos=".2 0 0" size=".05" mass="1"/>{}</body></worldbody></mujoco>"""
WEIGHT = '<body pos=".2 0 0"><inertial pos="0 0 0" mass=".6" diaginertia="1e-9 1e-9 1e-9"/></body>'


@pytest.mark.parametrize("held", [0.0, 0.7, 1.0])
def test_what_compensates_gravity_knows_the_mass_that_the_model_had(held):
    """Of a body of four times the mass three quarters weigh as if they hung on it, of a payload all of it."""
    heavier = '<body pos=".2 0 0"><geom size=".05" mass="3"/></body>'
    for edit, value, child in (
        (partial(edits.scale_mass, [1]), 4.0, heavier),
        (partial(edits.add_payload, 1, [0.2, 0, 0]), 0.6, WEIGHT),
    ):
        spec = mujoco.MjSpec.from_string(HELD.format(held, ""))
        edit(spec, value)
        found, plain = spec.compile(), mujoco.MjModel.from_xml_string(HELD.format(held, child))
        accelerations = []
        for model in (found, plain):
            data = mujoco.MjData(model)
            mujoco.mj_forward(model, data)
            accelerations.append(data.qacc[0])
        assert accelerations[0] == pytest.approx(accelerations[1], rel=1e-7)
