"""Robots of which measured logs are open, as MJCF made from the numbers that were published of them.

Each is the model one would begin with: masses, places and motors; no mesh, and no contact, as none of the logs has any.
The joints are named as in the logs.
"""

from collections.abc import Callable

from skat.simulators.mujoco import MujocoSimulator

# Of the project of the pendulum: the mass that its controller reckons with, all of it at the end of the rod. See
# https://github.com/dfki-ric-underactuated-lab/torque_limited_simple_pendulum (BSD-3-Clause).
PENDULUM_MASS, PENDULUM_LENGTH = 0.6755, 0.5

# Design C.1, model 1.0: https://github.com/dfki-ric-underactuated-lab/double_pendulum (BSD-3-Clause). Its inertias are
# about the joints; friction is cf arctan(100 v), thus cf pi / 2.
DOUBLE_PENDULUM = {
    "m1": 0.5234602302310271, "m2": 0.6255677234174437, "l1": 0.2, "r1": 0.2, "r2": 0.25569305436052964,
    "I1": 0.031887199591513114, "I2": 0.05086984812807257, "Ir": 6.287203962819607e-05, "gr": 6.0,
    "b": 0.001, "cf1": 0.16, "cf2": 0.12,
}  # fmt: skip

# UR10: name of the joint, of the link, mass, length of the cylinder that stands for it, its middle along z, place and
# turn of the joint in the link before (about y), axis, torque in N m. Manufacturer's description for ROS, package
# ur_description, robot ur10 (BSD-3-Clause); all cylinders have the radius 0.075 m.
UR10_RADIUS = 0.075
UR10 = (
    ("shoulder_pan_joint", "shoulder_link", 7.778, 0.178, 0.0, (0, 0, 0.1273), 0, "0 0 1", 330),
    ("shoulder_lift_joint", "upper_arm_link", 12.93, 0.612, 0.306, (0, 0.220941, 0), 90, "0 1 0", 330),
    ("elbow_joint", "forearm_link", 3.87, 0.5723, 0.28615, (0, -0.1719, 0.612), 0, "0 1 0", 150),
    ("wrist_1_joint", "wrist_1_link", 1.96, 0.12, 0.0, (0, 0, 0.5723), 90, "0 1 0", 54),
    ("wrist_2_joint", "wrist_2_link", 1.96, 0.12, 0.0, (0, 0.1149, 0), 0, "0 0 1", 54),
    ("wrist_3_joint", "wrist_3_link", 0.202, 0.12, 0.0, (0, 0, 0.1157), 0, "0 1 0", 54),
)

# SO-101: body, its place and turn in the one before, joint, its range, mass, centre, principal axes and moments.
# https://github.com/TheRobotStudio/SO-ARM100, Simulation/SO101/so101_new_calib.xml (Apache-2.0); names of the joints as
# in the logs of https://github.com/isaac-sim2real/sage (Apache-2.0).
SO101 = (
    ("shoulder", "0.0388353 -8.97657e-09 0.0624", "0 0 -1 0", "Rotation", (-1.91986, 1.91986), 0.100006,
     "-0.0307604 -1.66727e-05 -0.0252713", "0.999865 0.00149568 0.0097084 0.0132043",
     "8.37836e-05 8.10388e-05 2.39552e-05"),
    ("upper_arm", "-0.0303992 -0.0182778 -0.0542", "0.5 -0.5 -0.5 -0.5", "Pitch", (-1.74533, 1.74533), 0.103,
     "-0.0898471 -0.00838224 0.0184089", "0.453195 0.454063 0.541891 0.542951",
     "0.000150873 0.000142487 3.72451e-05"),
    ("lower_arm", "-0.11257 -0.028 0", "0.707107 0 0 0.707107", "Elbow", (-1.69, 1.69), 0.104,
     "-0.0980701 0.00324376 0.0182831", "0.510729 0.517006 0.487966 0.483477",
     "0.000160262 0.000145304 2.83125e-05"),
    ("wrist", "-0.1349 0.0052 0", "0.707107 0 0 -0.707107", "Wrist_Pitch", (-1.65806, 1.65806), 0.079,
     "-0.000103312 -0.0386143 0.0281156", "0.967143 0.254226 0.00162226 -0.000146307",
     "3.68265e-05 2.74474e-05 1.89434e-05"),
    ("gripper", "0 -0.0611 0.0181", "0.0172091 -0.0172091 0.706897 0.706897", "Wrist_Roll", (-2.74385, 2.84121), 0.087,
     "0.000213627 0.000245138 -0.025187", "0.600717 0.355993 0.35863 0.61951",
     "4.33735e-05 3.77229e-05 2.42839e-05"),
    ("jaw", "0.0202 0.0188 -0.0234", "0.707107 0.707107 -1.85362e-08 1.85362e-08", "Jaw", (-0.174533, 1.74533), 0.012,
     "-0.00157495 -0.0300244 0.0192755", "0.695265 0.717965 -0.0245618 -0.0230097",
     "6.63582e-06 5.29092e-06 1.86523e-06"),
)  # fmt: skip

# Unitree Go2, one leg: what mirrors from left to right changes the sign of y, from front to rear that of x of the hip.
# https://github.com/iit-DLSLab/sim2real-robot-identification (BSD-3-Clause), with the gains of the robot there.
GO2_LEGS = {"FL": (1, 1), "FR": (1, -1), "RL": (-1, 1), "RR": (-1, -1)}
GO2_RANGES = {"hip": (-1.0472, 1.0472), "calf": (-2.7227, -0.83776)}
GO2_THIGHS = {1: (-1.5708, 3.4907), -1: (-0.5236, 4.5379)}

# RicMonk: https://github.com/dfki-ric-underactuated-lab/ricmonk (BSD-3-Clause), finalRicMonkCurrent.urdf. Of each link
# mass, centre, and xx, yy, zz, xy, xz, yz of its inertia; the second hook sits on the second arm.
RICMONK = {
    "arm1": (0.31253, "-0.00077047 0.16959 -0.022094",
             "0.00099006 0.00036755 0.00069232 6.8261E-06 1.0342E-10 -4.7577E-06"),
    "tail": (2.63096785521702, "-0.0056009765606122 0.182449040804017 0.00254813231558806",
             "0.00523785541666047 0.00395069160539681 0.00309094774503178 "
             "5.87184699597149E-07 -4.07133795898078E-07 -1.24226112383513E-06"),
    "arm2": (0.140647941711974, "-0.0011371 0.089177 -1.9429E-16",
             "0.0008365 0.00032416 0.00056305 -6.8246E-06 -2.7105E-20 -1.152E-19"),
    "hook2": (0.171894025592926, "-1.4364E-07 0.035208 -0.027189",
              "0.00015356 4.3392E-05 0.00012928 1.4986E-09 1.0342E-10 -4.7577E-06"),
}  # fmt: skip


def make_machine(name: str, condition: str) -> MujocoSimulator:
    """Return a robot of which a measured log is open.

    Parameters
    ----------
    name : str
        One of `MACHINES`.
    condition : {"normal"}
        There is no other.
    """
    text, frame_skip = MACHINES[name]()
    return MujocoSimulator(text, frame_skip=frame_skip)


def _model(name: str, timestep: float, bodies: str, actuators: str, defaults: str = "") -> str:
    return (
        f'<mujoco model="{name}"><compiler angle="radian" autolimits="true"/>'
        f'<option timestep="{timestep!r}" integrator="implicitfast"/><default>{defaults}</default>'
        f"<worldbody>{bodies}</worldbody><actuator>{actuators}</actuator></mujoco>"
    )


def _pendulum() -> tuple[str, int]:
    body = (
        '<body name="weight"><joint name="hinge" axis="0 -1 0"/>'
        f'<inertial pos="0 0 {-PENDULUM_LENGTH}" mass="{PENDULUM_MASS}" diaginertia="1e-6 1e-6 1e-6"/></body>'
    )
    return _model("pendulum", 0.001, body, '<motor name="motor" joint="hinge"/>'), 5


def _double_pendulum() -> tuple[str, int]:
    p = DOUBLE_PENDULUM
    first, second = p["I1"] - p["m1"] * p["r1"] ** 2, p["I2"] - p["m2"] * p["r2"] ** 2
    rotor = p["gr"] ** 2 * p["Ir"]
    bodies = (
        f'<body name="upper"><joint name="shoulder" axis="0 -1 0" armature="{rotor + p["Ir"]!r}"/>'
        f'<inertial pos="0 0 {-p["r1"]!r}" mass="{p["m1"]!r}" diaginertia="{first!r} {first!r} 1e-4"/>'
        f'<body name="lower" pos="0 0 {-p["l1"]!r}"><joint name="elbow" axis="0 -1 0" armature="{rotor!r}"/>'
        f'<inertial pos="0 0 {-p["r2"]!r}" mass="{p["m2"]!r}" diaginertia="{second!r} {second!r} 1e-4"/>'
        "</body></body>"
    )
    motors = "".join(
        f'<motor name="{joint}" joint="{joint}" ctrlrange="-10 10"/>' for joint in ("shoulder", "elbow")
    )
    return _model("double_pendulum", 0.001, bodies, motors), 2


def _ur10() -> tuple[str, int]:
    bodies, motors = "", ""
    for joint, link, mass, length, middle, place, turn, axis, torque in UR10:
        across = mass * (3 * UR10_RADIUS**2 + length**2) / 12
        along = mass * UR10_RADIUS**2 / 2
        bodies += (
            f'<body name="{link}" pos="{place[0]} {place[1]} {place[2]}" euler="0 {turn * 0.017453292519943295!r} 0">'
            f'<joint name="{joint}" axis="{axis}"/>'
            f'<inertial pos="0 0 {middle}" mass="{mass}" diaginertia="{across!r} {across!r} {along!r}"/>'
        )
        motors += f'<motor name="{joint}" joint="{joint}" ctrlrange="-{torque} {torque}"/>'
    return _model("ur10", 0.002, bodies + "</body>" * len(UR10), motors), 4


def _so101() -> tuple[str, int]:
    bodies, servos = "", ""
    for body, place, turn, joint, (low, high), mass, centre, axes, moments in SO101:
        bodies += (
            f'<body name="{body}" pos="{place}" quat="{turn}"><joint name="{joint}" range="{low} {high}"/>'
            f'<inertial pos="{centre}" quat="{axes}" mass="{mass}" diaginertia="{moments}"/>'
        )
        servos += (
            f'<position name="{joint}" joint="{joint}" kp="998.22" kv="2.731" ctrlrange="{low} {high}" '
            'forcerange="-3.35 3.35"/>'
        )
    defaults = '<joint axis="0 0 1" armature="0.028" damping="0.6" frictionloss="0.052"/>'
    return _model("so101", 0.002, bodies + "</body>" * len(SO101), servos, defaults), 10


def _go2_air() -> tuple[str, int]:
    bodies, servos = "", ""
    for leg, (front, left) in GO2_LEGS.items():
        joints = {part: f"{leg}_{part}_joint" for part in ("hip", "thigh", "calf")}
        ranges = {**GO2_RANGES, "thigh": GO2_THIGHS[front]}
        hip_axes = {
            (1, 1): "0.497014 0.499245 0.505462 0.498237", (1, -1): "0.498237 0.505462 0.499245 0.497014",
            (-1, 1): "0.505462 0.498237 0.497014 0.499245", (-1, -1): "0.499245 0.497014 0.498237 0.505462",
        }[front, left]  # fmt: skip
        thigh_axes = (
            "0.829533 0.0847635 -0.0200632 0.551623" if left > 0 else "0.551623 -0.0200632 0.0847635 0.829533"
        )
        calf_axes = (
            "0.710672 0.00154099 -0.00450087 0.703508"
            if left > 0
            else "0.703508 -0.00450087 0.00154099 0.710672"
        )
        limits = {part: "{} {}".format(*ranges[part]) for part in ranges}
        bodies += (
            f'<body name="{leg}_hip" pos="{0.1934 * front} {0.0465 * left} 0">'
            f'<inertial pos="{-0.0054 * front} {0.00194 * left} -0.000105" quat="{hip_axes}" mass="0.678" '
            'diaginertia="0.00088403 0.000596003 0.000479967"/>'
            f'<joint name="{joints["hip"]}" axis="1 0 0" range="{limits["hip"]}"/>'
            f'<body name="{leg}_thigh" pos="0 {0.0955 * left} 0">'
            f'<inertial pos="-0.00374 {-0.0223 * left} -0.0327" quat="{thigh_axes}" mass="1.152" '
            'diaginertia="0.00594973 0.00584149 0.000878787"/>'
            f'<joint name="{joints["thigh"]}" range="{limits["thigh"]}"/>'
            f'<body name="{leg}_calf" pos="0 0 -0.213">'
            f'<inertial pos="0.00629595 {-0.000622121 * left} -0.141417" quat="{calf_axes}" mass="0.241352" '
            'diaginertia="0.0014901 0.00146356 5.31397e-05"/>'
            f'<joint name="{joints["calf"]}" range="{limits["calf"]}"/></body></body></body>'
        )
        for part, joint in joints.items():
            limit = 45.43 if part == "calf" else 23.7
            servos += (
                f'<position name="{leg}_{part}" joint="{joint}" kp="20" kv="1.5" '
                f'forcerange="-{limit} {limit}"/>'
            )
    defaults = '<joint axis="0 1 0" damping="0.6" armature="0.01" frictionloss="0.2"/>'
    return _model("go2_air", 0.001, bodies, servos, defaults), 5


def _ricmonk() -> tuple[str, int]:
    def inertial(link: str) -> str:
        mass, centre, inertia = RICMONK[link]
        return f'<inertial pos="{centre}" mass="{mass}" fullinertia="{inertia}"/>'

    bodies = (
        '<body name="arm1" euler="-1.5708 0 0"><joint name="arm1" axis="1 0 0"/>'
        f"{inertial('arm1')}"
        '<body name="tail" pos="0.03655 0.31400886121263 -0.02" euler="3.14159265358979 0 3.14159265358979">'
        f'<joint name="tail" axis="-1 0 0"/>{inertial("tail")}'
        f'<body name="arm2" pos="-0.0365 0 0"><joint name="phi" axis="-1 0 0"/>{inertial("arm2")}'
        '<body name="hook2" pos="0.00055 0.314008861212629 0.02" euler="0 0 3.14159265358979">'
        f"{inertial('hook2')}</body></body></body></body>"
    )
    motors = "".join(
        f'<motor name="{joint}" joint="{joint}" ctrlrange="-16 16"/>' for joint in ("tail", "phi")
    )
    return _model("ricmonk", 0.001, bodies, motors), 6


MACHINES: dict[str, Callable[[], tuple[str, int]]] = {
    "pendulum": _pendulum,
    "double_pendulum": _double_pendulum,
    "ur10": _ur10,
    "so101": _so101,
    "go2_air": _go2_air,
    "ricmonk": _ricmonk,
}
