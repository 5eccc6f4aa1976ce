"""Every number of every effect, by hand, on models whose inertias and drives make them easy."""

from functools import cache

import numpy as np
import pytest

from skat.simulators import MujocoSimulator
from skat.simulators.anatomy import Anatomy

# Weightless, one joint a tree: the inertia of each joint is that of its body and its armature, and without gravity a
# joint's force is ten times its inertia, or what its drive can do.
MACHINE = """
<mujoco><option timestep=".005" gravity="0 0 0" integrator="{integrator}"/><worldbody>
  <body name="cart"><inertial pos=".1 .2 .3" mass="2" diaginertia="1 1 1"/>
    <joint name="rail" type="slide" axis="1 0 0" damping=".4" frictionloss=".3" armature=".5" stiffness="7"/></body>
  <body name="rotor"><inertial pos="0 0 0" mass="1" diaginertia=".02 .02 .03"/>
    <joint name="spin" axis="0 0 1" damping="1" frictionloss="5" armature=".02" stiffness="300"/></body>
  <body name="knob"><inertial pos="0 0 0" mass=".5" diaginertia=".1 .1 .1"/>
    <joint name="ball" type="ball" damping="19.5"/></body>
  <body name="drone"><inertial pos="0 0 0" mass="4" diaginertia=".2 .2 .2"/><freejoint name="base"/></body>
</worldbody><tendon>
  <fixed name="belt" damping="2" stiffness="3" frictionloss=".6">
    <joint joint="rail" coef="2"/><joint joint="spin" coef=".5"/></fixed>
</tendon><actuator>
  <position name="pusher" joint="rail" kp="400" kv="30" ctrlrange="-.2 .4"/>
  <motor name="turner" joint="spin" gear="2" forcerange="-3 6"/>
</actuator></mujoco>
"""
LISTED, ASKED, ACCEPTED = "listed", "listed if asked for", "accepted only"


@cache
def every(text, frame_skip):
    """Return each effect of a model with how it is listed."""
    simulator = MujocoSimulator(text, frame_skip=frame_skip)
    listed, asked = ({one.name for one in simulator.effects(also=also)} for also in ((), "all"))
    return [
        (one, LISTED if one.name in listed else ASKED if one.name in asked else ACCEPTED)
        for one in simulator.all_effects()
    ]


def entries(text, families, frame_skip=1):
    """Return (unit, neutral, low, high, typical, how it is listed) of each effect of the model itself, by name."""
    return {
        one.name: (one.unit, one.neutral, *one.bounds, one.typical, how)
        for one, how in every(text, frame_skip)
        if one.family in families.split() and (one.target or "").split(".")[0] not in ("qpos", "qvel")
    }


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    for name, (unit, *numbers, how) in expected.items():
        assert (found[name][0], found[name][-1]) == (unit, how), name
        np.testing.assert_allclose(found[name][1:-1], numbers, rtol=1e-9, atol=1e-12, err_msg=name)


# At 320 N, twice its servo's 160 N; at what the time step allows less what there is, 10 - 1, and at a tenth of it; at
# the least of what it allows along and about the axes.
DAMPING = {"rail": (-0.4, 320.0), "spin": (-1.0, 9.0), "ball": (-19.5, 2.0), "base": (0.0, 40.0)}
# Treated implicitly it may be a hundred times what there is, or the inertia.
IMPLICIT_DAMPING = DAMPING | {"spin": (-1.0, 100.0), "ball": (-19.5, 1950.0), "base": (0.0, 400.0)}


@pytest.mark.parametrize(
    ("integrator", "bounds", "of_all"),
    [("RK4", DAMPING, (-0.4, 2.0)), ("Euler", IMPLICIT_DAMPING, (-0.4, 100.0))],
)
def test_damping_is_bounded_by_drive_inertia_and_time_step(integrator, bounds, of_all):
    along, about = "N s/m", "N m s/rad"
    units = {"rail": along, "spin": about, "ball": about, "base": f"{along}, {about}"}
    typical = {"rail": 0.3 * 160, "spin": 0.3 * 12, "ball": 0.3, "base": 0.3 * 40}
    expected = {
        f"damping[{joint}]": (units[joint], 0.0, *bounds[joint], typical[joint], LISTED) for joint in bounds
    }
    expected["damping[all]"] = (f"{along}, {about}", 0.0, *of_all, 0.3, LISTED)
    assert_same(entries(MACHINE.format(integrator=integrator), "damping"), expected)


def test_what_else_is_added_to_joints_is_bounded_by_drive_and_inertia():
    expected = {
        "dry_friction[rail]": ("N", 0.0, -0.3, 320.0, 48.0, LISTED),
        "dry_friction[spin]": ("N m", 0.0, -5.0, 50.0, 3.6, LISTED),  # ten times its own
        "dry_friction[ball]": ("N m", 0.0, 0.0, 2.0, 0.3, LISTED),
        "dry_friction[all]": ("N, N m", 0.0, 0.0, 2.0, 0.3, LISTED),
        "position_friction[rail]": ("N/m", 0.0, 0.0, 320.0, 48.0, LISTED),
        "position_friction[spin]": ("N m/rad", 0.0, 0.0, 50.0, 3.6, LISTED),
        # With 160 N it is accelerated by 5 m/s2; of ten times the inertia, where that is more.
        "armature[rail]": ("kg", 0.0, -0.95 * 0.5, 32.0, 4.8, LISTED),
        "armature[spin]": ("kg m2", 0.0, -0.95 * 0.02, 2.4, 0.36, LISTED),
        "armature[ball]": ("kg m2", 0.0, 0.0, 1.0, 0.03, LISTED),
        "stiffness[rail]": ("N/m", 0.0, -7.0, 1600.0, 48.0, LISTED),
        "stiffness[spin]": ("N m/rad", 0.0, -300.0, 0.05 / 0.005**2, 3.6, LISTED),  # I / dt^2
        "stiffness[ball]": ("N m/rad", 0.0, 0.0, 10.0, 0.3, LISTED),
    }
    families = "dry_friction position_friction armature stiffness"
    assert_same(entries(MACHINE.format(integrator="RK4"), families), expected)


def test_forces_are_ten_times_those_of_the_joints_and_wind_twice_the_weight():
    expected = {f"wind[{axis}]": ("N", 0.0, -80.0, 80.0, 12.0, LISTED) for axis in "xyz"}
    expected |= {
        f"air_drag[{axis}]": ("kg/m", 0.0, 0.0, 40.0, 12.0, LISTED) for axis in ("x", "y", "z", "all")
    }
    expected["force[rail]"] = ("N", 0.0, -1600.0, 1600.0, 48.0, ACCEPTED)
    expected["force[spin]"] = ("N m", 0.0, -120.0, 120.0, 3.6, ACCEPTED)
    for axis in "xyz":
        expected[f"force[ball.r{axis}]"] = ("N m", 0.0, -10.0, 10.0, 0.3, ACCEPTED)
        expected[f"force[base.{axis}]"] = ("N", 0.0, -400.0, 400.0, 12.0, ACCEPTED)
        expected[f"force[base.r{axis}]"] = ("N m", 0.0, -20.0, 20.0, 0.6, ACCEPTED)
    assert_same(entries(MACHINE.format(integrator="RK4"), "wind air_drag force"), expected)


def test_places_of_mass_are_bounded_by_the_size_of_the_body():
    """Without a geom a body is as large as its radius of gyration; a slide does not feel where its mass is."""
    masses = {"cart": 2.0, "rotor": 1.0, "knob": 0.5, "drone": 4.0}
    expected = {f"mass[{body}]": ("1", 1.0, 0.05, 20.0, 0.2, LISTED) for body in (*masses, "all")}
    # About its only hinge the rotor's is the armature.
    for body, how in {"rotor": ACCEPTED, "knob": LISTED, "drone": LISTED}.items():
        expected[f"inertia[{body}]"] = ("1", 1.0, 0.1, 10.0, 0.2, how)
        for axis in "xy" if body == "rotor" else "xyz":
            expected[f"centre_of_mass[{body}.{axis}]"] = ("m", 0.0, -0.1, 0.1, 0.03, LISTED)
    # Five times the body's own mass, or the whole of the drone.
    for body, most in {"cart": 10.0, "rotor": 5.0, "knob": 4.0, "drone": 20.0}.items():
        expected[f"payload[{body}]"] = ("kg", 0.0, 0.0, most, 0.2 * masses[body], ASKED)
    inertias = {"cart": 3.0, "rotor": 0.07, "knob": 0.3, "drone": 0.6}
    for body, inertia in inertias.items():
        size = np.sqrt(inertia / masses[body])
        for axis, centre in zip("xyz", (0.1, 0.2, 0.3) if body == "cart" else (0.0, 0.0, 0.0)):
            ends = centre - size / 2, centre + size / 2
            expected[f"payload[{body}.{axis}]"] = ("m", centre, *ends, size / 4, ACCEPTED)
    found = entries(MACHINE.format(integrator="RK4"), "mass inertia centre_of_mass payload length radius")
    assert_same(found, expected)


def test_what_is_added_to_a_tendon_is_bounded_by_the_mass_that_it_moves():
    text = MACHINE.format(integrator="RK4")
    mobility = 2**2 / 2.5 + 0.5**2 / 0.05
    weight, stable = 10 / mobility, 1 / (0.005 * mobility)
    poses = Anatomy(MujocoSimulator(text).compiled()).poses
    reach = np.ptp(poses[:, :2] @ [2.0, 0.5])
    expected = {
        "tendon_damping[belt]": ("N s/m", 0.0, -2.0, stable - 2.0, 0.3 * weight, LISTED),
        "tendon_dry_friction[belt]": ("N", 0.0, -0.6, 6.0, 0.3 * weight, LISTED),
        "tendon_stiffness[belt]": ("N/m", 0.0, -3.0, 30.0, 0.3 * weight / reach, LISTED),
    }
    assert 10 * weight / reach < 30 < stable / 0.005
    assert_same(entries(text, "tendon_damping tendon_dry_friction tendon_stiffness"), expected)
    soft = text.replace('stiffness="3"', "")
    _, _, _, high, *_ = entries(soft, "tendon_stiffness")["tendon_stiffness[belt]"]
    assert high == pytest.approx(10 * weight / reach, rel=1e-9)
    # What moves little mass may have a hundred times as much damping, however strong joints may be.
    thread = '<fixed name="thread"><joint joint="spin" coef="5"/></fixed></tendon>'
    found = entries(text.replace("</tendon>", thread), "tendon_damping")["tendon_damping[thread]"]
    assert found[2:4] == (0.0, pytest.approx(100 * 0.05 / 5**2, rel=1e-6))


def test_commands_are_late_by_up_to_five_transitions_and_scaled_or_shifted_within_their_range():
    expected = {
        "gain[pusher]": ("1", 1.0, -3.0, 3.0, 0.2, LISTED),
        "gain[turner]": ("1", 1.0, -3.0, 3.0, 0.2, LISTED),
        "gain[all]": ("1", 1.0, -3.0, 3.0, 0.2, LISTED),
        "force_limit[turner]": ("1", 1.0, 0.02, 20.0, 0.2, LISTED),
        "force_limit[all]": ("1", 1.0, 0.02, 20.0, 0.2, ACCEPTED),
        "kp[pusher]": ("1", 1.0, 0.02, 20.0, 0.2, LISTED),
        "kp[all]": ("1", 1.0, 0.02, 20.0, 0.2, ACCEPTED),
        "kv[pusher]": ("1", 1.0, 0.02, 1.0, 0.2, LISTED),  # more of it is damping
        "kv[all]": ("1", 1.0, 0.02, 1.0, 0.2, ACCEPTED),
        "offset[pusher]": ("m", 0.0, -0.3, 0.3, 0.03, LISTED),
        "delay[action]": ("s", 0.0, 0.0, 0.5, 0.1, LISTED),
        "delay[pusher]": ("s", 0.0, 0.0, 0.5, 0.1, ASKED),
        "delay[turner]": ("s", 0.0, 0.0, 0.5, 0.1, ASKED),
        "lag[pusher]": ("s", 0.0, 0.0, 0.5, 0.02, ASKED),
        "lag[turner]": ("s", 0.0, 0.0, 0.5, 0.02, ASKED),
        "lag[all]": ("s", 0.0, 0.0, 0.5, 0.02, ASKED),
        "bias[ctrl.pusher]": ("m", 0.0, -0.3, 0.3, 0.03, ACCEPTED),
        "bias[ctrl.turner]": ("unit of ctrl.turner", 0.0, -10.0, 10.0, 1.0, ASKED),
        "scale[ctrl.pusher]": ("1", 1.0, -100.0, 100.0, 0.2, ASKED),
        "scale[ctrl.turner]": ("1", 1.0, -100.0, 100.0, 0.2, ACCEPTED),
        "dead_zone[pusher]": ("m", 0.0, 0.0, 0.27, 0.003, ASKED),
        "dead_zone[turner]": ("unit of ctrl.turner", 0.0, 0.0, 9.0, 0.1, ASKED),
        "timestep": ("1", 1.0, 0.01, 20.0, 0.7, LISTED),
    }
    families = "gain force_limit kp kv offset delay lag bias scale dead_zone timestep"
    assert_same(entries(MACHINE.format(integrator="RK4"), families, frame_skip=20), expected)


def test_a_fast_loop_may_still_lag_by_a_third_of_a_second():
    """As long as five transitions would be, it is lag that a motor has."""
    text = MACHINE.format(integrator="RK4")
    assert entries(text, "lag")["lag[all]"][2:4] == (0.0, 0.3)
    assert entries(text, "delay")["delay[action]"][2:4] == pytest.approx((0.0, 0.025))


def test_a_servos_motor_and_gear_are_bounded_by_what_it_can_do():
    expected = {
        "lag_torque[pusher]": ("s", 0.0, 0.0, 0.3, 0.02, ASKED),
        "lag_torque[turner]": ("s", 0.0, 0.0, 0.3, 0.02, ACCEPTED),
        # Half a metre a second takes all of its 160 N; a turner's 12 N m are 6 before its gear.
        "torque_speed[pusher]": ("N s/m", 0.0, 0.0, 320.0, 4.8, ASKED),
        "torque_speed[turner]": ("N m s/rad", 0.0, 0.0, 12.0, 0.18, ASKED),
        "current_limit[pusher]": ("N", 160.0, 3.2, 160.0, 48.0, ASKED),
        "stribeck[rail]": ("N", 0.0, 0.0, 320.0, 48.0, ASKED),
        "stribeck[spin]": ("N m", 0.0, 0.0, 24.0, 3.6, ASKED),
        "backlash[rail]": ("m", 0.0, 0.0, 0.02, 0.001, ASKED),
        "backlash[spin]": ("rad", 0.0, 0.0, 0.2, 0.01, ASKED),
    }
    for joint, speed, square in (("rail", "m/s", "1/N"), ("spin", "rad/s", "1/(N m)")):
        expected[f"stribeck_speed[{joint}]"] = (speed, 2.0, 0.01, 50.0, 1.0, ACCEPTED)
        expected[f"stribeck_exponent[{joint}]"] = ("1", 2.0, 0.3, 10.0, 1.0, ACCEPTED)
        expected[f"load_friction[{joint}]"] = ("1", 0.0, 0.0, 2.0, 0.1, ASKED)
        expected[f"load_square_motor[{joint}]"] = (square, 0.0, 0.0, 2.0, 0.1, ACCEPTED)
    families = "lag_torque torque_speed current_limit stribeck backlash stribeck_speed stribeck_exponent"
    families += " load_friction load_square_motor"
    assert_same(entries(MACHINE.format(integrator="RK4"), families), expected)


def turning(actuator, *, joint="", option="", rest=""):
    """Return a weightless hinge of 0.05 kg m2 and what drives it."""
    return f"""<mujoco><option timestep=".005" gravity="0 0 0" {option}</option><worldbody>
    <body name="rotor"><inertial pos="0 0 0" mass="1" diaginertia=".03 .03 .05"/>
      <joint name="spin" axis="0 0 1" {joint}/></body></worldbody>{rest}
    <actuator>{actuator}</actuator></mujoco>"""


SERVO = '<position name="drive" joint="spin" kp="4" kv="{}" {}/>'
RUNGE_KUTTA = 'integrator="RK4">'


@pytest.mark.parametrize(
    ("text", "high", "how"),
    [
        # Its integrator treats joints' damping otherwise: 1 + (1 - s) / s with s = dt kv / I = 0.1, and from 0.9 on a
        # tenth of it more, but 20 at most.
        (turning(SERVO.format(1, ""), option='integrator="Euler">'), 10.0, LISTED),
        (turning(SERVO.format(9.5, ""), option='integrator="Euler">'), 1 + 0.1 / 0.95, LISTED),
        (turning(SERVO.format(0.01, ""), option='integrator="Euler">'), 20.0, LISTED),
        # What a limit cuts off is no damping; implicitly it is stable.
        (turning(SERVO.format(1, 'forcerange="-9 9"'), option=RUNGE_KUTTA), 10.0, LISTED),
        (turning(SERVO.format(1, 'forcerange="-9 9"'), option='integrator="implicitfast">'), 20.0, LISTED),
        (turning(SERVO.format(1, ""), joint='actuatorfrcrange="-9 9"', option=RUNGE_KUTTA), 10.0, LISTED),
        # More is damping; less is, too, where there is as much of that to take off: all but a fiftieth.
        (turning(SERVO.format(1, ""), joint='damping=".97"', option=RUNGE_KUTTA), 1.0, LISTED),
        (turning(SERVO.format(1, ""), joint='damping=".99"', option=RUNGE_KUTTA), 10.0, ACCEPTED),
        (turning(SERVO.format(1, ""), joint='damping=".97"', option='><flag eulerdamp="disable"/>'), 1.0, LISTED),
        (turning(SERVO.format(0.5, 'gear="2"'), joint='damping="1.9"', option=RUNGE_KUTTA), 1.0, LISTED),
        (turning(SERVO.format(0.5, 'gear="2"'), joint='damping="2"', option=RUNGE_KUTTA), 5.0, ACCEPTED),
    ],
)  # fmt: skip
def test_velocity_feedback_is_bounded_by_stability_and_by_what_damping_can_do(text, high, how):
    found = entries(text, "kv")
    assert_same(found, {"kv[drive]": ("1", 1.0, 0.02, high, 0.2, how)} | {"kv[all]": found["kv[all]"]})
    assert found["kv[all]"][3:] == (found["kv[drive]"][3], 0.2, ACCEPTED)


@pytest.mark.parametrize(
    ("tendon", "joint", "high", "how"),
    [
        ('damping=".97"', "", 1.0, LISTED),
        ('damping=".99"', "", 10.0, ACCEPTED),
        ('damping=".99" actuatorfrcrange="-9 9"', "", 10.0, LISTED),
        ('damping=".99"', 'actuatorfrcrange="-9 9"', 10.0, LISTED),
    ],
)
def test_velocity_feedback_on_a_tendon_is_the_tendons_damping(tendon, joint, high, how):
    cord = f'<tendon><fixed name="cord" {tendon}><joint joint="spin" coef="1"/></fixed></tendon>'
    drive = '<position name="drive" tendon="cord" kp="4" kv="1"/>'
    found = entries(turning(drive, joint=joint, option=RUNGE_KUTTA, rest=cord), "kv offset torque_speed")
    assert found["kv[drive]"][3:] == (pytest.approx(high, rel=1e-6), 0.2, how)
    assert found["offset[drive]"][0] == "unit of ctrl.drive"
    assert "torque_speed[drive]" not in found


def test_velocity_feedback_of_all_is_bounded_by_the_least_stable():
    text = turning(SERVO.format(1, 'forcerange="-9 9"') + SERVO.format(2, "").replace("drive", "other"),
                   option='integrator="Euler">')  # fmt: skip
    found = entries(text, "kv")
    assert [one[3] for one in found.values()] == pytest.approx([10.0, 5.0, 5.0])
    assert {one[-1] for one in found.values()} == {LISTED}


EVERY_ACTUATOR = {"delay"}
AFFINE = EVERY_ACTUATOR | {"gain", "dead_zone", "lag", "lag_torque"}
JOINT = AFFINE | {"torque_speed"}
COMMANDED = JOINT | {"bias", "scale"}
SERVED = COMMANDED | {"offset", "current_limit"}


@pytest.mark.parametrize(
    ("actuator", "families"),
    [
        ("<motor {}/>", COMMANDED),
        ('<motor ctrlrange="-1 1" {}/>', COMMANDED | {"current_limit"}),
        ('<motor forcerange="-1 1" {}/>', COMMANDED | {"force_limit"}),
        ('<position kp="4" {}/>', SERVED),
        ('<position kp="4" kv="1" {}/>', SERVED | {"kp", "kv"}),
        ('<velocity kv="2" {}/>', SERVED),
        ('<general biastype="affine" gainprm="4" biasprm="0 -4 -1" {}/>', SERVED | {"kp", "kv"}),
        ('<general biastype="affine" gainprm="4" biasprm="0 -5" {}/>', COMMANDED),
        ('<general biastype="affine" gainprm="4" biasprm="0 -5 -1" {}/>', COMMANDED | {"kv"}),
        ('<general biastype="affine" gainprm="4" biasprm="0 0 -1" {}/>', COMMANDED | {"kv"}),
        ('<general biastype="affine" gainprm="0" biasprm="0 0 -1" {}/>', COMMANDED - {"torque_speed"}),
        ('<general biastype="affine" gainprm="0" biasprm="2 0 -1" {}/>', COMMANDED - {"torque_speed"} | {"kv"}),
        ('<general gaintype="affine" gainprm="4 1" {}/>', JOINT),
        ('<general gaintype="affine" gainprm="4 0 1" {}/>', JOINT),
        ('<general dyntype="filter" dynprm=".1" gainprm="4" {}/>', COMMANDED - {"lag", "lag_torque"}),
        ('<muscle lengthrange="0 1" {}/>', EVERY_ACTUATOR),
    ],
)  # fmt: skip
def test_an_actuator_has_the_effects_that_its_kind_of_force_knows(actuator, families):
    every = (
        "gain kp kv offset force_limit bias scale dead_zone lag lag_torque delay torque_speed current_limit"
    )
    found = entries(turning(actuator.format('name="drive" joint="spin"'), option=RUNGE_KUTTA), every)
    assert {name.partition("[")[0] for name in found if "drive" in name} == families


@pytest.mark.parametrize(
    ("actuator", "kind", "unit"),
    [
        ("position", "hinge", "rad"),
        ("position", "slide", "m"),
        ("velocity", "hinge", "rad/s"),
        ("velocity", "slide", "m/s"),
        ("velocity", "ball", "unit of ctrl.drive"),
    ],
)
def test_a_servos_command_has_the_unit_of_what_it_follows(actuator, kind, unit):
    drive = f'<{actuator} name="drive" joint="spin" {"kp" if actuator == "position" else "kv"}="3"/>'
    text = turning(drive, joint=f'type="{kind}"', option=">")
    assert entries(text, "offset") == {"offset[drive]": (unit, 0.0, -1.0, 1.0, 0.03, LISTED)}
    assert entries(text, "dead_zone")["dead_zone[drive]"][:4] == (unit, 0.0, 0.0, 0.9)
    geared = text.replace("<position", '<position gear="2"').replace("<velocity", '<velocity gear="2"')
    assert entries(geared, "offset")["offset[drive]"][0] == "unit of ctrl.drive"


@pytest.mark.parametrize(
    ("motor", "kind", "unit"),
    [
        ('<motor name="drive"', "hinge", "N m"),
        ('<motor name="drive"', "slide", "N"),
        ('<motor name="drive"', "ball", "unit of ctrl.drive"),
        ('<motor gear="2" name="drive"', "hinge", "unit of ctrl.drive"),
        ('<general gainprm="2" name="drive"', "hinge", "unit of ctrl.drive"),
        ('<general gainprm="1" dyntype="integrator" name="drive"', "hinge", "unit of ctrl.drive"),
    ],
)
def test_a_motors_command_has_the_unit_of_its_force(motor, kind, unit):
    text = turning(f'{motor} joint="spin"/>', joint=f'type="{kind}"', option=">")
    for effect in ("bias[ctrl.drive]", "dead_zone[drive]"):
        assert entries(text, effect.partition("[")[0])[effect][0] == unit


@pytest.mark.parametrize(
    ("parts", "has_length"),
    [
        ('<joint axis="0 1 0"/><geom size=".1"/>', False),
        ('<joint axis="0 1 0"/><geom size=".1" pos="0 0 .1"/>', True),
        ('<joint axis="0 1 0"/><geom type="capsule" size=".1 .1"/>', True),
        ('<joint axis="0 1 0"/><geom type="cylinder" size=".1 .1"/>', True),
        ('<joint axis="0 1 0"/><geom type="box" size=".1 .1 .1"/>', False),
        ('<joint axis="0 1 0" pos="0 0 .1"/><geom size=".1"/>', True),
        ('<joint type="ball" pos="0 0 .1"/><geom size=".1"/>', True),
        ('<joint type="slide" axis="1 0 0" pos="0 0 .1"/><geom size=".1"/>', False),
        ('<joint axis="0 1 0"/><geom size=".1"/><body pos="0 0 .1"><geom size=".1"/></body>', True),
        ('<joint axis="0 1 0"/><geom size=".1"/><body><geom size=".1"/></body>', False),
    ],
)
def test_a_body_has_a_length_if_anything_of_it_is_off_its_frame(parts, has_length):
    text = f'<mujoco><worldbody><geom pos="1 1 1" size=".1"/><body name="link">{parts}</body></worldbody></mujoco>'
    found = entries(text, "length")
    wanted = ("1", 1.0, 0.3, 3.0, 0.03, LISTED)
    assert found.get("length[link]") == (wanted if has_length else None)
    assert ("length[all]" in found) == has_length


def test_a_centre_of_mass_moves_within_what_the_body_reaches():
    body = """<body name="brick"><freejoint align="false"/><geom type="box" size=".1 .2 .2" pos=".3 .4 0"/>
    <geom size=".1" contype="0"/></body>"""
    found = entries(f"<mujoco><worldbody>{body}</worldbody></mujoco>", "centre_of_mass payload")
    assert found["centre_of_mass[brick.y]"] == (
        "m",
        0.0,
        pytest.approx(-0.8),
        pytest.approx(0.8),
        0.03,
        LISTED,
    )
    assert found["payload[brick.x]"][2:4] == pytest.approx((-0.1, 0.4))
    assert found["payload[brick.y]"][2:4] == pytest.approx((-0.1, 0.6))
    assert found["payload[brick.z]"][2:5] == pytest.approx((-0.2, 0.2, 0.1))


@pytest.mark.parametrize(
    ("joint", "option", "tilts"),
    [
        ("<freejoint/>", "", "xy"),
        ('<joint type="slide" axis="1 0 0"/>', "", "x"),
        ('<joint type="slide" axis="0 1 0"/>', "", "y"),
        ('<joint type="slide" axis="0 0 1"/>', "", ""),
        ('<joint axis="0 1 0"/>', "", "x"),
        ("<freejoint/>", '<option><flag gravity="disable"/></option>', None),
        ("<freejoint/>", '<option gravity="0 0 0"/>', None),
    ],
)
def test_gravity_tilts_where_something_can_slide_down(joint, option, tilts):
    text = (
        f'<mujoco>{option}<worldbody><body>{joint}<geom size=".1" pos="0 0 .3"/></body></worldbody></mujoco>'
    )
    expected = {} if tilts is None else {"gravity": ("1", 1.0, 0.0, 3.0, 0.02, LISTED)}
    expected |= {f"tilt[{axis}]": ("rad", 0.0, -0.7, 0.7, 0.03, LISTED) for axis in tilts or ""}
    assert_same(entries(text, "gravity tilt"), expected)


def test_drag_along_one_axis_is_drag_in_all():
    text = '<mujoco><worldbody><body>{}<geom size=".1" mass=".5"/></body></worldbody></mujoco>'
    found = entries(text.format('<joint type="slide" axis="0 0 1"/>'), "air_drag wind")
    assert_same(
        found,
        {
            "wind[z]": ("N", 0.0, -10.0, 10.0, 1.5, LISTED),
            "air_drag[z]": ("kg/m", 0.0, 0.0, 5.0, 1.5, LISTED),
            "air_drag[all]": ("kg/m", 0.0, 0.0, 5.0, 1.5, ACCEPTED),
        },
    )
    slides = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
    assert entries(text.format(slides), "air_drag")["air_drag[all]"][-1] == LISTED


@pytest.mark.parametrize(
    ("joints", "along_slides"),
    [
        ('<joint type="slide" axis="0 0 1"/>', {"z", "all"}),
        ('<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>', {"x", "z"}),
        ("<freejoint/>", set()),
    ],
)
def test_drag_is_an_edit_of_the_model_where_a_slide_moves_along_it(joints, along_slides):
    text = f'<mujoco><worldbody><body>{joints}<geom size=".1" mass=".5"/></body></worldbody></mujoco>'
    drags = [one for one in MujocoSimulator(text).all_effects() if one.family == "air_drag"]
    assert {one.target for one in drags if one.apply is not None} == along_slides


def test_what_lies_before_a_gear_is_bounded_by_the_force_there_and_a_rotor_has_a_fiftieth_of_the_inertia():
    text = turning('<motor name="drive" joint="spin" gear=".5" forcerange="-3 6"/>', option=">")
    assert entries(text, "torque_speed")["torque_speed[drive]"][2:5] == pytest.approx((0.0, 12.0, 0.18))
    loose = MujocoSimulator(text).compiled({"backlash[spin]": 0.01})
    np.testing.assert_allclose(loose.dof_armature, [0.02 * 0.05, 0.0], rtol=1e-9)


def test_a_joint_that_says_where_the_robot_is_has_damping_only():
    base = '<joint name="x" type="slide" axis="1 0 0"/><joint name="turn" axis="0 0 1"/>'
    leg = '<body name="leg"><joint name="hip" axis="0 1 0"/><geom size=".1" pos="0 0 .3"/></body>'
    text = '<mujoco><worldbody><body name="torso">{}<geom size=".1"/>{}</body></worldbody></mujoco>'
    families = "damping dry_friction position_friction armature stiffness stribeck load_friction"
    found = entries(text.format(base, leg), families)
    assert {name for name in found if "[x]" in name or "[turn]" in name} == {"damping[x]", "damping[turn]"}
    assert found["damping[all]"][-1] == found["dry_friction[all]"][-1] == ACCEPTED  # the hip's
    assert found["damping[all]"][:-1] == found["damping[hip]"][:-1]
    assert {"armature[x]", "stribeck[x]"} <= entries(text.format(base, ""), families).keys()
    # About the base's only hinge nothing else is its inertia.
    assert entries(text.format(base, leg), "inertia")["inertia[torso]"][-1] == LISTED
    assert entries(text.format(base, ""), "inertia")["inertia[torso]"][-1] == ACCEPTED


def test_a_body_without_mass_has_no_mass_to_change():
    arm = '<body name="arm"><joint axis="0 1 0"/><geom size=".1" pos="0 0 .3"/><body name="flange"/></body>'
    found = entries(f"<mujoco><worldbody>{arm}</worldbody></mujoco>", "mass payload inertia")
    assert {name for name in found if "." not in name} == {
        "mass[arm]",
        "mass[all]",
        "payload[arm]",
        "inertia[arm]",
    }
    assert found["mass[all]"][-1] == ACCEPTED


def test_friction_that_a_model_disables_is_not_that_of_gears_or_tendons():
    text = MACHINE.format(integrator="RK4")
    families = "stribeck load_friction tendon_dry_friction dry_friction tendon_damping tendon_stiffness"
    assert len({name.partition("[")[0] for name in entries(text, families)}) == 6
    off = text.replace('RK4"/>', 'RK4"><flag frictionloss="disable"/></option>')
    assert {name.partition("[")[0] for name in entries(off, families)} == {
        "tendon_damping",
        "tendon_stiffness",
    }


def touching(*, a="", b="", floor="", pairs="", option=""):
    return f"""<mujoco>{option}<worldbody><geom name="floor" type="plane" size="1 1 .1" {floor}/>
    <body name="a"><freejoint/><geom name="a" size=".1" {a}/></body>
    <body name="b"><freejoint/><geom name="b" size=".1" {b}/></body></worldbody>
    <contact>{pairs}</contact></mujoco>"""


GRIP = '<pair name="{}" geom1="a" geom2="b"/>'


@pytest.mark.parametrize(
    ("text", "frictions", "single"),
    [
        (touching(), {"floor": LISTED, "a": LISTED, "b": LISTED},
         {"floor/a": ACCEPTED, "floor/b": ACCEPTED, "a/b": ACCEPTED}),
        (touching(pairs=GRIP.format("grip")), {"floor": LISTED, "a": LISTED, "b": LISTED, "grip": LISTED},
         {"floor/a": ACCEPTED, "floor/b": ACCEPTED, "grip": LISTED}),
        # Of one contact only, b repeats the pair; of all of them, a repeats "all".
        (touching(b='contype="0" conaffinity="0"', pairs=GRIP.format("grip")),
         {"floor": LISTED, "a": ACCEPTED, "b": ACCEPTED, "grip": LISTED}, {"floor/a": ACCEPTED, "grip": LISTED}),
        (touching(pairs=GRIP.format("b")), {"floor": LISTED, "a": LISTED, "b": LISTED},
         {"floor/a": ACCEPTED, "floor/b": ACCEPTED, "b": LISTED}),
        (touching(a='conaffinity="0"', b='conaffinity="0" contype="0"', floor='contype="0" conaffinity="0"',
                  pairs=GRIP.format("grip")), {"a": ACCEPTED, "b": ACCEPTED}, {"grip": ACCEPTED}),
    ],
)  # fmt: skip
def test_contacts_have_factors_by_geom_by_pair_and_all(text, frictions, single):
    expected = {
        f"contact_friction[{name}]": ("1", 1.0, 0.01, 20.0, 0.2, how) for name, how in frictions.items()
    }
    for name, how in single.items():
        expected[f"contact_anisotropy[{name}]"] = ("1", 1.0, 0.05, 20.0, 0.2, how)
        expected[f"restitution[{name}]"] = ("1", 1.0, 0.05, 5.0, 0.2, how)
    for family, bounds in {
        "contact_friction": (0.01, 20.0),
        "contact_anisotropy": (0.05, 20.0),
        "restitution": (0.05, 5.0),
    }.items():
        expected[f"{family}[all]"] = ("1", 1.0, *bounds, 0.2, LISTED)
    assert_same(entries(text, "contact_friction contact_anisotropy restitution"), expected)


def test_contacts_without_friction_have_none_to_change():
    families = "contact_friction contact_anisotropy restitution"
    smooth = touching(a='condim="1"', b='condim="1"', floor='condim="1"')
    assert {name.partition("[")[0] for name in entries(smooth, families)} == {"restitution"}
    assert not entries(touching(option='<option><flag override="enable"/></option>'), families)
    assert not entries(touching(option='<option><flag contact="disable"/></option>'), families)
