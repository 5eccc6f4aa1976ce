r"""Servos as they are: what is late, lags, tires or has play, friction that grows with load; and weights put on.

Worlds for `robots.make_log(..., build=ServoWorld)`, in plain MuJoCo, with what no property of the nominal model is::

    lag[all], lag[<actuator>]     s: commands pass a filter of first order, solved exactly and meant over a time step
    lag_torque[<actuator>]        s: its torque does, explicitly, in steps of a tenth
    backlash[<joint>]             rad: motor and link are joints of their own, with hard ends; in steps of a fifth
    dead_zone[<actuator>]         rad: half of the width in which a servo takes what it lacks of its place for nothing
    torque_speed[<actuator>]      N m s/rad: its limits fall with its speed
    force_limit[<actuator>]       its limits, times this
    delay[<actuator>]             s: its commands arrive late; of what arrives within a time step the mean acts
    scale[ctrl.<actuator>], bias[ctrl.<actuator>]    what acts is scale * command + bias
    lag[<channel>]                s: its sensor is a filter of first order, exact on lines between time steps
    payload[<body>], payload[<body>.x|y|z]    kg, m: a point mass and its place in the body's frame
    mx106[<joint>]                the friction of a servo MX-106, by the law M4 that `BAM`_ published for it, times this

What motor, friction and rotor act on is the motor's side of play; what is read is the link.

.. _BAM: https://github.com/Rhoban/bam
"""

import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np

from worlds.hidden import actuator_names, channel_names, edited_model
from worlds.robots import World

OWN = ("lag", "lag_torque", "dead_zone", "torque_speed", "force_limit", "backlash", "payload", "mx106")
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
        self.own = {name: value for name, value in truth.items() if _is_own(name)}
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
        self.lags, self.zones, self.tiring, self.delays, self.shifts = (
            np.zeros(len(names)) for _ in range(5)
        )
        self.scales = np.ones(len(names))
        self.limits = self.real.actuator_forcerange.copy()
        per_actuator = {
            "lag": self.lags,
            "dead_zone": self.zones,
            "torque_speed": self.tiring,
            "delay": self.delays,
            "scale": self.scales,
            "bias": self.shifts,
        }
        for name, value in self.own.items():
            family, _, target = name.rstrip("]").partition("[")
            mine = np.array([target.removeprefix("ctrl.") in ("all", one) for one in names])
            if family in per_actuator:
                per_actuator[family][mine] = value
            elif family == "force_limit":
                self.limits[mine] *= value
        self.real.actuator_forcerange[:] = self.limits
        channels = channel_names(self.model)
        self.sensors = {
            channels.index(name[len("lag[") : -1]): value
            for name, value in self.own.items()
            if name.startswith(("lag[qpos.", "lag[qvel."))
        }
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
        self.true = np.asarray(state, float)
        self.shown = {column: self.true[column] for column in self.sensors}
        self.read = []

    def advance(self, history, forces=None):
        """Go one row on, and return the state in nominal coordinates; see `World.advance`."""
        real, data = self.real, self.data
        h = float(real.opt.timestep)
        for k in range(self.substeps * self.finer):
            command = self.scales * self._arrived(history, k * h, h) + self.shifts
            if self.filtered is None:
                self.filtered = command.copy()
            late = self.lags > 0
            x = np.divide(h, self.lags, out=np.zeros_like(self.lags), where=late)
            gone = np.exp(-x)
            mean = np.where(late, (1 - gone) / np.maximum(x, 1e-300), 0.0)
            data.ctrl[:] = command + (self.filtered - command) * mean
            self.filtered = command + (self.filtered - command) * np.where(late, gone, 0.0)
            if self.zones.any() or self.tiring.any():
                self._weaken()
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
            self._show(h)
        self.read.append(list(self.shown.values()))
        return self.true

    def readings(self, sensor, states, sigma, rng, normal):
        """Return what sensors say; those with a filter of their own read what it shows."""
        states = states.copy()
        states[1:, list(self.sensors)] = np.reshape(self.read, (len(states) - 1, len(self.sensors)))
        return super().readings(sensor, states, sigma, rng, normal)

    def _arrived(self, history, since, h):
        """Return the mean command of the time step that begins so long after the row's begin."""
        found = history[-1].copy()
        for one in np.flatnonzero(self.delays > 0):
            # From `sent` to `sent` + h after the row's begin it was sent; an edge of rows may lie within.
            sent = since - self.delays[one]
            row = int(np.floor(sent / self.dt + 1e-9))
            after = np.clip((sent + h - (row + 1) * self.dt) / h, 0.0, 1.0)
            older, newer = (history[max(len(history) - 1 + min(at, 0), 0), one] for at in (row, row + 1))
            found[one] = (1 - after) * older + after * newer
        return found

    def _weaken(self):
        """Leave out what lies in dead zones, and lower the limits of what turns fast."""
        real, data = self.real, self.data
        for one in np.flatnonzero((self.zones > 0) | (self.tiring > 0)):
            joint = real.actuator_trnid[one, 0]
            lacks = data.ctrl[one] - data.qpos[real.jnt_qposadr[joint]]
            data.ctrl[one] -= np.clip(lacks, -self.zones[one], self.zones[one])
            low, high = self.limits[one]
            fall = self.tiring[one] * data.qvel[real.jnt_dofadr[joint]]
            real.actuator_forcerange[one] = np.clip([low - fall, high - fall], low, high)

    def _show(self, h):
        """Move the filters of sensors on by a time step, over which what they read goes in a line."""
        before = self.true
        state = np.concatenate([self.data.qpos[self.positions], self.data.qvel[self.motors]])
        for at, speed, loose, turning in self.play:
            state[at] += self.data.qpos[loose]
            state[self.model.nq + speed] += self.data.qvel[turning]
        for column, lag in self.sensors.items():
            behind = lag * (state[column] - before[column]) / h
            left = np.exp(-h / lag)
            self.shown[column] = (
                state[column] - behind + (self.shown[column] - before[column] + behind) * left
            )
        self.true = state

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


def _is_own(name):
    """Whether `World` knows nothing of a cause."""
    return (
        name.partition("[")[0] in OWN
        or "[ctrl." in name
        or (name.startswith("delay[") and name != "delay[action]")
    )


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
