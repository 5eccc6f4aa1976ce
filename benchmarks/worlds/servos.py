r"""Servos as they are: commands and torques that lag, play in gears, friction that grows with load; and weights put on.

Worlds for `robots.make_log(..., build=ServoWorld)`, in plain MuJoCo, with what no property of the nominal model is::

    lag[all], lag[<actuator>]     s: commands pass a filter of first order, solved exactly and meant over a time step
    lag_torque[<actuator>]        s: its torque does, explicitly, in steps of a tenth
    backlash[<joint>]             rad: motor and link are joints of their own, with hard ends; in steps of a fifth
    payload[<body>], payload[<body>.x|y|z]    kg, m: a point mass and its place in the body's frame
    mx106[<joint>]                the friction of a servo MX-106, by the law M4 that `BAM`_ published for it, times this

What motor, friction and rotor act on is the motor's side of play; what is read is the link.

.. _BAM: https://github.com/Rhoban/bam
"""

import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np

from worlds.robots import World, actuator_names, edited_model

OWN = ("lag", "lag_torque", "backlash", "payload", "mx106")
FINER = {"lag_torque": 10, "backlash": 5}
# Friction of M4, N m; per N m of load; at rest, and how it falls with speed.
MX106 = {
    "stribeck": 0.1049,
    "load": 0.00915,
    "load_stribeck": 0.2224,
    "viscous": 0.05096,
    "speed": 1.6233,
    "exponent": 1.3235,
}
# Time constant s and damping ratio of the ends of play.
HARD = "0.001 1"


class ServoWorld(World):
    """A robot with causes of this module in it; `model` stays in the nominal model's coordinates."""

    def __init__(self, robot, truth=None, *, finer=1):
        truth = dict(truth or {})
        self.own = {name: value for name, value in truth.items() if name.partition("[")[0] in OWN}
        plain = {name: value for name, value in truth.items() if name not in self.own}
        super().__init__(robot, plain, finer=finer)
        self.truth = truth
        text = self.kind.text()
        families = {name.partition("[")[0] for name in self.own}
        self.finer = max((FINER.get(family, 1) for family in families), default=1)
        self.real = edited_model(_written(text, self.own), plain)
        self.real.opt.timestep = self.timestep / self.finer
        self.data = mujoco.MjData(self.real)
        self._places()
        names = actuator_names(self.model)
        self.lags = np.zeros(self.model.nu)
        for name, value in self.own.items():
            family, _, target = name.rstrip("]").partition("[")
            if family == "lag":
                self.lags[:] = np.where(np.array([target in ("all", one) for one in names]), value, self.lags)
        self.slow = [
            (names.index(name[len("lag_torque[") : -1]), value)
            for name, value in self.own.items()
            if name.startswith("lag_torque")
        ]
        self.gains = {
            one: (self.real.actuator_gainprm[one, 0], *self.real.actuator_biasprm[one, :3])
            for one, _ in self.slow
        }
        for one, _ in self.slow:
            self.real.actuator_gainprm[one], self.real.actuator_biasprm[one] = 0, 0
        self.loaded = [
            (self.motors[self.model.joint(name[len("mx106[") : -1]).dofadr[0]], value)
            for name, value in self.own.items()
            if name.startswith("mx106")
        ]
        self.least = self.real.dof_frictionloss.copy()

    def _places(self):
        """Find where the real model has the nominal one's coordinates, and the play of each."""
        nominal, real = self.model, self.real
        position, speed, self.play = [], [], []
        for joint in range(nominal.njnt):
            there = real.joint(nominal.joint(joint).name)
            width = (7, 6) if nominal.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE else (1, 1)
            if f"{there.name}.play" in [real.joint(one).name for one in range(real.njnt)]:
                loose = real.joint(f"{there.name}.play")
                self.play.append((len(position), len(speed), loose.qposadr[0], loose.dofadr[0]))
            position += list(there.qposadr[0] + np.arange(width[0]))
            speed += list(there.dofadr[0] + np.arange(width[1]))
        self.positions, self.motors = np.array(position), np.array(speed)

    def reset(self, state):
        """Start from a state, play in the middle, filters settled with the first command."""
        nq = self.model.nq
        mujoco.mj_resetData(self.real, self.data)
        self.data.qpos[self.positions], self.data.qvel[self.motors] = state[:nq], state[nq:]
        self.filtered, self.torques, self.load = None, {}, np.zeros(self.real.nv)

    def advance(self, history, forces=None):
        """Go one row on, and return the state in nominal coordinates; see `World.advance`."""
        real, data = self.real, self.data
        h = float(real.opt.timestep)
        command = history[-1]
        if self.filtered is None:
            self.filtered = command.copy()
        for k in range(self.substeps * self.finer):
            late = self.lags > 0
            x = np.divide(h, self.lags, out=np.zeros_like(self.lags), where=late)
            gone = np.exp(-x)
            mean = np.where(late, (1 - gone) / np.maximum(x, 1e-300), 0.0)
            data.ctrl[:] = command + (self.filtered - command) * mean
            self.filtered = command + (self.filtered - command) * np.where(late, gone, 0.0)
            pushed = np.zeros(real.nv)
            if forces is not None:
                pushed[self.motors] = forces[k // self.finer]
            for one, lag in self.slow:
                pushed[self._dof(one)] += self._torque(one, lag, h)
            data.qfrc_applied[:] = pushed
            for dof, share in self.loaded:
                real.dof_frictionloss[dof] = self.least[dof] + share * self._m4(dof)
            mujoco.mj_step(real, data)
            if self.loaded:
                self._weigh()
        state = np.concatenate([data.qpos[self.positions], data.qvel[self.motors]])
        for at, speed, loose, turning in self.play:
            state[at] += data.qpos[loose]
            state[self.model.nq + speed] += data.qvel[turning]
        return state

    def _dof(self, actuator):
        return self.real.jnt_dofadr[self.real.actuator_trnid[actuator, 0]]

    def _torque(self, one, lag, h):
        """Return an actuator's torque, filtered: of place and speed now, between its limits."""
        gain, bias, place, speed = self.gains[one]
        joint = self.real.actuator_trnid[one, 0]
        q, v = self.data.qpos[self.real.jnt_qposadr[joint]], self.data.qvel[self._dof(one)]
        asked = gain * self.data.ctrl[one] + bias + place * q + speed * v
        if self.real.actuator_forcelimited[one]:
            asked = np.clip(asked, *self.real.actuator_forcerange[one])
        before = self.torques.get(one, asked)
        # Of the time step's end: speed feedback that waits longer would ring.
        self.torques[one] = asked + (before - asked) * np.exp(-h / lag)
        return self.torques[one]

    def _m4(self, dof):
        v = self.data.qvel[dof]
        slow = np.exp(-(abs(v / MX106["speed"]) ** MX106["exponent"]))
        load = MX106["load"] + MX106["load_stribeck"] * slow
        return MX106["viscous"] * abs(v) + MX106["stribeck"] * slow + load * abs(self.load[dof])

    def _weigh(self):
        """Find the load of each gear: what the link asks for and what the motor gives, one against the other."""
        real, data = self.real, self.data
        motor = data.qfrc_actuator
        asked = np.zeros(real.nv)
        mujoco.mj_mulM(real, data, asked, data.qacc)
        asked += data.qfrc_bias - data.qfrc_spring - real.dof_armature * data.qacc
        self.load = asked + motor


def _written(text, own):
    """Return the MJCF with play and weights in it."""
    tree = ElementTree.fromstring(text)
    for body in list(tree.find("worldbody").iter("body")):
        name = body.get("name")
        if f"payload[{name}]" in own:
            centre = [float(one) for one in body.find("inertial").get("pos").split()]
            place = [own.get(f"payload[{name}.{axis}]", at) for axis, at in zip("xyz", centre)]
            weight = ElementTree.SubElement(
                body, "body", {"name": f"{name}.weight", "pos": " ".join(map(repr, place))}
            )
            mass, inertia = own[f"payload[{name}]"], "1e-9 1e-9 1e-9"
            ElementTree.SubElement(
                weight, "inertial", {"pos": "0 0 0", "mass": repr(mass), "diaginertia": inertia}
            )
    for parent in list(tree.find("worldbody").iter()):
        for body in [one for one in list(parent) if one.tag == "body"]:
            joint = body.find("joint")
            if joint is not None and f"backlash[{joint.get('name')}]" in own:
                _loosen(parent, body, joint, own[f"backlash[{joint.get('name')}]"])
    return ElementTree.tostring(tree, encoding="unicode")


def _loosen(parent, body, joint, play):
    """Put a motor between a body and its parent, and play between motor and body."""
    motor = ElementTree.Element(
        "body", {"name": f"{body.get('name')}.motor", "pos": body.get("pos", "0 0 0")}
    )
    body.set("pos", "0 0 0")
    parent.insert(list(parent).index(body), motor)
    parent.remove(body)
    body.remove(joint)
    if not float(joint.get("armature", 0)):
        raise ValueError(f"{joint.get('name')} has no rotor: play needs one")
    ElementTree.SubElement(
        motor, "inertial", {"pos": "0 0 0", "mass": "1e-6", "diaginertia": "1e-9 1e-9 1e-9"}
    )
    motor.append(joint)
    motor.append(body)
    half = float(np.degrees(play / 2))  # as MJCF has it by default
    ends = f"{-half!r} {half!r}"
    loose = {"name": f"{joint.get('name')}.play", "axis": joint.get("axis"), "limited": "true", "range": ends}
    loose |= {"solreflimit": HARD, "solimplimit": "0.99 0.999 0.0001"}
    body.insert(0, ElementTree.Element("joint", loose))
