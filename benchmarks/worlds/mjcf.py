"""Nominal models of robots like those of users, as MJCF text: what a user would hand to a diagnosis.

Masses, centres, inertias and lengths are the manufacturers' public numbers, rounded, or plain round numbers where a
machine is nobody's product. No model of a torque-driven robot has friction, damping or rotor inertia, as no first
model has.
"""

import functools
from pathlib import Path

# A two-link arm in a vertical plane, motors at shoulder and elbow.
TWO_LINK = """
<mujoco model="two-link arm">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <inertial pos="0 0 -0.16" mass="0.55" diaginertia="0.0042 0.0042 0.0003"/>
      <joint name="shoulder" axis="0 1 0" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" contype="0" conaffinity="0"/>
      <body name="lower" pos="0 0 -0.2">
        <inertial pos="0 0 -0.2" mass="0.6" diaginertia="0.0065 0.0065 0.0003"/>
        <joint name="elbow" axis="0 1 0" damping="0.02"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder" joint="shoulder" ctrllimited="true" ctrlrange="-8 8"/>
    <motor name="elbow" joint="elbow" ctrllimited="true" ctrlrange="-5 5"/>
  </actuator>
</mujoco>
"""

CART_POLE = """
<mujoco model="cart-pole">
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="cart" pos="0 0 1">
      <inertial pos="0 0 0" mass="1.2" diaginertia="0.004 0.006 0.006"/>
      <joint name="slider" type="slide" axis="1 0 0" damping="0.2"/>
      <geom type="box" size="0.1 0.06 0.04" contype="0" conaffinity="0"/>
      <body name="pole">
        <inertial pos="0 0 -0.3" mass="0.25" diaginertia="0.0075 0.0075 0.0001"/>
        <joint name="hinge" axis="0 1 0" damping="0.002"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.6" size="0.015" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="slider" ctrllimited="true" ctrlrange="-12 12"/></actuator>
</mujoco>
"""

# A quadrotor of 1.3 kg, arms of .2 m; a rotor's drag turns it about its axis.
QUADROTOR = """
<mujoco model="quadrotor">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="frame" pos="0 0 1">
      <freejoint name="root"/>
      <inertial pos="0 0 0" mass="1.3" diaginertia="0.012 0.012 0.021"/>
      <geom type="box" size="0.1 0.1 0.03" contype="0" conaffinity="0"/>
      <site name="front_left" pos="0.14 0.14 0.03"/>
      <site name="rear_left" pos="-0.14 0.14 0.03"/>
      <site name="rear_right" pos="-0.14 -0.14 0.03"/>
      <site name="front_right" pos="0.14 -0.14 0.03"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="front_left" site="front_left" gear="0 0 1 0 0 -0.016" ctrllimited="true" ctrlrange="0 9"/>
    <motor name="rear_left" site="rear_left" gear="0 0 1 0 0 0.016" ctrllimited="true" ctrlrange="0 9"/>
    <motor name="rear_right" site="rear_right" gear="0 0 1 0 0 -0.016" ctrllimited="true" ctrlrange="0 9"/>
    <motor name="front_right" site="front_right" gear="0 0 1 0 0 0.016" ctrllimited="true" ctrlrange="0 9"/>
  </actuator>
</mujoco>
"""

# The six links of a UR5e: place of the joint in the link before, its axis, mass kg, centre m, principal inertia kg m2.
UR5E_LINKS = (
    ("shoulder", (0, 0, 0.163), "0 0 1", 3.761, (0, 0.026, -0.002), (0.0103, 0.0103, 0.00666)),
    ("upper_arm", (0, 0.138, 0), "0 1 0", 8.058, (0, 0, 0.2125), (0.1339, 0.1339, 0.0151)),
    ("forearm", (0, -0.131, 0.425), "0 1 0", 2.846, (0, 0, 0.196), (0.0312, 0.0312, 0.0041)),
    ("wrist_1", (0, 0, 0.392), "0 1 0", 1.37, (0, 0.127, 0), (0.0026, 0.0026, 0.0022)),
    ("wrist_2", (0, 0.127, 0), "0 0 1", 1.3, (0, 0, 0.1), (0.0026, 0.0026, 0.0022)),
    ("wrist_3", (0, 0, 0.1), "0 1 0", 0.365, (0, 0.077, 0), (0.0002, 0.0002, 0.00014)),
)
UR5E_JOINTS = ("pan", "lift", "elbow", "wrist1", "wrist2", "wrist3")
UR5E_TORQUE = (150, 150, 150, 28, 28, 28)
# Of the position servos that users' models of this arm have.
UR5E_KP, UR5E_KV = (2000, 2000, 2000, 500, 500, 500), (400, 400, 400, 100, 100, 100)

SO101_LINKS = (
    ("shoulder", (0.039, 0, 0.062), "0 0 1", 0.1, (-0.03, 0, -0.02), (4e-5, 5e-5, 5e-5)),
    ("upper_arm", (-0.03, 0, 0.054), "0 1 0", 0.103, (-0.02, 0, 0.075), (1.6e-4, 1.6e-4, 3e-5)),
    ("lower_arm", (0.028, 0, 0.1126), "0 1 0", 0.104, (0.08, 0, 0.003), (3e-5, 1.6e-4, 1.6e-4)),
    ("wrist", (0.135, 0, 0.005), "0 1 0", 0.079, (0.03, 0, 0), (3e-5, 4e-5, 3e-5)),
    ("gripper", (0.061, 0, 0), "1 0 0", 0.087, (0.03, 0, 0), (3e-5, 4e-5, 4e-5)),
    ("jaw", (0.02, 0.02, 0), "0 0 1", 0.012, (0.04, 0, 0), (2e-6, 8e-6, 8e-6)),
)
SO101_JOINTS = ("pan", "lift", "elbow", "flex", "roll", "grip")

# Places of hips m, and sides.
GO2_LEGS = {
    "FL": (0.1934, 0.0465, 1),
    "FR": (0.1934, -0.0465, -1),
    "RL": (-0.1934, 0.0465, 1),
    "RR": (-0.1934, -0.0465, -1),
}


def _text(numbers):
    return " ".join(f"{number:g}" for number in numbers)


def _chain(links, joints, joint_attributes):
    """Return nested bodies, each at the end of the one before."""
    text, ends = "", ""
    for (name, place, axis, mass, centre, inertia), joint, attributes in zip(links, joints, joint_attributes):
        text += (
            f'<body name="{name}" pos="{_text(place)}">'
            f'<inertial pos="{_text(centre)}" mass="{mass:g}" diaginertia="{_text(inertia)}"/>'
            f'<joint name="{joint}" axis="{axis}" {attributes}/>'
            f'<geom type="capsule" fromto="0 0 0 {_text(2 * c + 1e-3 for c in centre)}" size="0.03" contype="0" '
            'conaffinity="0"/>\n'
        )
        ends += "</body>"
    return text + ends


def six_joint_arm(drive):
    """Return an arm with a UR5e's links; ``drive``: "torque" (no friction, no rotors) or "servo" (with rotors)."""
    attributes = ['armature="0.1"'] * 6 if drive == "servo" else [""] * 6
    if drive == "servo":
        actuators = "".join(
            f'<position name="{joint}" joint="{joint}" kp="{kp}" kv="{kv}" forcerange="-{limit} {limit}"/>'
            for joint, kp, kv, limit in zip(UR5E_JOINTS, UR5E_KP, UR5E_KV, UR5E_TORQUE)
        )
    else:
        actuators = "".join(
            f'<motor name="{joint}" joint="{joint}" ctrllimited="true" ctrlrange="-{limit} {limit}"/>'
            for joint, limit in zip(UR5E_JOINTS, UR5E_TORQUE)
        )
    return (
        f'<mujoco model="six-joint {drive} arm"><option timestep="0.002" integrator="implicitfast"/>'
        '<worldbody><body name="base"><inertial pos="0 0 0" mass="4" diaginertia="0.007 0.007 0.007"/>\n'
        f"{_chain(UR5E_LINKS, UR5E_JOINTS, attributes)}</body></worldbody><actuator>{actuators}</actuator></mujoco>"
    )


def so101():
    """Return a small arm on hobby servos, with the gains and the friction of its public model."""
    attributes = ['armature="0.028" frictionloss="0.052" damping="0.6"'] * 6
    actuators = "".join(
        f'<position name="{joint}" joint="{joint}" kp="17.8" forcerange="-3.35 3.35"/>'
        for joint in SO101_JOINTS
    )
    return (
        '<mujoco model="small servo arm"><option timestep="0.005" integrator="implicitfast"/><worldbody>\n'
        f"{_chain(SO101_LINKS, SO101_JOINTS, attributes)}</worldbody><actuator>{actuators}</actuator></mujoco>"
    )


def quadruped(base):
    """Return a robot with a Go2's links: ``base`` "hung" (fixed, torques, no friction) or "free" (floor, servos)."""
    hung = base == "hung"
    extra = "" if hung else 'armature="0.01" damping="0.1" frictionloss="0.2"'
    joints = []
    legs = ""
    for leg, (x, y, side) in GO2_LEGS.items():
        joints += [f"{leg}_hip", f"{leg}_thigh", f"{leg}_calf"]
        foot = f'<geom name="{leg}_foot" type="sphere" pos="0 0 -0.213" size="0.022" ' + (
            'contype="0" conaffinity="0"/>' if hung else 'friction="0.8 0.02 0.01" condim="3"/>'
        )
        legs += (
            f'<body name="{leg}_hip" pos="{x} {y} 0">'
            f'<inertial pos="0 {side * 0.002} 0" mass="0.678" diaginertia="0.00048 0.00088 0.0006"/>'
            f'<joint name="{leg}_hip" axis="1 0 0" {extra}/>'
            f'<body name="{leg}_thigh" pos="0 {side * 0.0955} 0">'
            f'<inertial pos="-0.004 {-side * 0.022} -0.033" mass="1.152" diaginertia="0.0058 0.0058 0.0011"/>'
            f'<joint name="{leg}_thigh" axis="0 1 0" {extra}/>'
            f'<body name="{leg}_calf" pos="0 0 -0.213">'
            '<inertial pos="0.005 0 -0.135" mass="0.194" diaginertia="0.0012 0.0012 0.00005"/>'
            f'<joint name="{leg}_calf" axis="0 1 0" {extra}/>{foot}</body></body></body>\n'
        )
    if hung:
        actuators = "".join(
            f'<motor name="{j}" joint="{j}" ctrllimited="true" ctrlrange="-24 24"/>' for j in joints
        )
    else:
        actuators = "".join(
            f'<position name="{j}" joint="{j}" kp="60" kv="2" forcerange="-24 24"/>' for j in joints
        )
    root = "" if hung else '<freejoint name="root"/>'
    floor = "" if hung else '<geom name="floor" type="plane" size="5 5 0.1" friction="0.8 0.02 0.01"/>'
    return (
        f'<mujoco model="quadruped, {base}"><option timestep="0.002" integrator="implicitfast"/><worldbody>{floor}'
        f'<body name="trunk" pos="0 0 {1 if hung else 0.32}">{root}'
        '<inertial pos="0.02 0 -0.005" mass="6.921" diaginertia="0.0245 0.0981 0.107"/>'
        f'<geom type="box" size="0.19 0.047 0.057" contype="0" conaffinity="0"/>\n{legs}</body></worldbody>'
        f"<actuator>{actuators}</actuator></mujoco>"
    )


@functools.cache
def gymnasium_text(file):
    """Return the text of one of Gymnasium's models."""
    import gymnasium

    return (Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / file).read_text()
