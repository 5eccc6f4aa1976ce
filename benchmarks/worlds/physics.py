"""The worlds as they really move: plain MuJoCo stepping, forces and action paths that nominal models lack."""

import mujoco
import numpy as np

from worlds.models import FRAME_SKIP, ROOT_BODY, SOLVER, actuator_names, compile_model


class Physics:
    """A model with hidden effects, advanced one transition at a time.

    Parameters
    ----------
    kind : str
    hidden : sequence of (family, target, value)
    """

    def __init__(self, kind, hidden=()):
        self.kind = kind
        self.model = compile_model(kind, hidden)
        self.substeps = FRAME_SKIP[kind]
        for family, _, value in hidden:
            if family == "timestep":
                # Another time step for the same transition: a whole number of them.
                substeps = round(self.substeps / value)
                self.model.opt.timestep *= self.substeps / substeps
                self.substeps = substeps
        self.model.opt.solver, self.model.opt.iterations, self.model.opt.tolerance = SOLVER, 500, 1e-12
        self.delay = sum(value for family, _, value in hidden if family == "delay")
        self._data = mujoco.MjData(self.model)
        self._root = self.model.body(ROOT_BODY[kind]).id
        self._forces = [
            _FORCES[family](self.model, self._root, target, value)
            for family, target, value in hidden
            if family in _FORCES
        ]
        self._commands = [
            _COMMANDS[family](self.model, target, value)
            for family, target, value in hidden
            if family in _COMMANDS
        ]

    def advance(self, qpos, qvel, action, previous_action, time):
        """Return the state (qpos, qvel) after one transition from rest of the solver."""
        data = self._data
        mujoco.mj_resetData(self.model, data)
        data.qpos, data.qvel = qpos, qvel
        if not (self._forces or self._commands or self.delay):
            data.ctrl = action
            mujoco.mj_step(self.model, data, self.substeps)
            return data.qpos.copy(), data.qvel.copy()
        h = self.model.opt.timestep
        for k in range(self.substeps):
            late = np.clip((self.delay - k * h) / h, 0.0, 1.0)
            command = late * previous_action + (1 - late) * action
            if self._forces or self._commands:
                # Positions and velocities of bodies, as the forces below need them.
                mujoco.mj_step1(self.model, data)
            for transmit in self._commands:
                command = transmit(data, command)
            data.ctrl = command
            data.qfrc_applied[:] = 0.0
            data.xfrc_applied[:] = 0.0
            for add_force in self._forces:
                add_force(data, time + k * h)
            mujoco.mj_step(self.model, data)
        return data.qpos.copy(), data.qvel.copy()


def tangent_difference(model, qpos, qvel, other_qpos, other_qvel):
    """Return (qpos, qvel) minus (other_qpos, other_qvel) in the tangent space, rows of 2 nv."""
    difference = np.empty((len(qpos), 2 * model.nv))
    for row in range(len(qpos)):
        mujoco.mj_differentiatePos(model, difference[row, : model.nv], 1.0, other_qpos[row], qpos[row])
    difference[:, model.nv :] = qvel - other_qvel
    return difference


def _centre_velocity(model, data, body):
    velocity = np.empty(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, velocity, 0)
    return velocity[3:]


def _wind(model, root, axis, value):
    del model

    def add_force(data, time):
        del time
        data.xfrc_applied[root, "xyz".index(axis)] += value

    return add_force


def _air_drag(model, root, axis, value):
    def add_force(data, time):
        del time
        velocity = _centre_velocity(model, data, root)
        if axis == "all":
            data.xfrc_applied[root, :3] -= value * np.linalg.norm(velocity) * velocity
        else:
            i = "xyz".index(axis)
            data.xfrc_applied[root, i] -= value * abs(velocity[i]) * velocity[i]

    return add_force


def _joint_force(law):
    """Return a force on one joint that is ``law(position, velocity, value)``."""

    def make(model, root, joint, value):
        del root
        position, velocity = model.joint(joint).qposadr[0], model.joint(joint).dofadr[0]

        def add_force(data, time):
            del time
            data.qfrc_applied[velocity] += law(data.qpos[position], data.qvel[velocity], value)

        return add_force

    return make


def _position_friction(model, root, joint, value):
    del root
    position, velocity = model.joint(joint).qposadr[0], model.joint(joint).dofadr[0]

    def add_force(data, time):
        del time
        model.dof_frictionloss[velocity] = value * abs(data.qpos[position])

    return add_force


def _periodic(model, root, axis, value):
    del model

    def add_force(data, time):
        # 7.3 Hz: faster than an episode, slower than a transition, and no multiple of either.
        data.xfrc_applied[root, "xyz".index(axis)] += value * np.sin(2 * np.pi * 7.3 * time)

    return add_force


def _magnet(model, root, place, value):
    """Pull the root's centre towards a point ``place`` along x, falling with the cube of the distance."""
    del model
    centre = np.array([float(place), 0.0, 0.1])

    def add_force(data, time):
        del time
        distance = centre - data.xipos[root]
        distance[1] = 0.0
        data.xfrc_applied[root, :3] += value * distance / (0.3**2 + distance @ distance) ** 1.5

    return add_force


def _dead_band(model, actuator, value):
    i = actuator_names(model).index(actuator)

    def transmit(data, command):
        del data
        command = command.copy()
        command[i] = np.sign(command[i]) * max(abs(command[i]) - value, 0.0)
        return command

    return transmit


def _saturation(model, actuator, value):
    i = actuator_names(model).index(actuator)

    def transmit(data, command):
        del data
        command = command.copy()
        command[i] = np.clip(command[i], value - 1, 1 - value)
        return command

    return transmit


def _speed_gain(model, actuator, value):
    i = actuator_names(model).index(actuator)
    dof = model.jnt_dofadr[model.actuator_trnid[i, 0]]

    def transmit(data, command):
        command = command.copy()
        command[i] *= 1 / (1 + value * abs(data.qvel[dof]))
        return command

    return transmit


# The last nine families are in no list of effects.
_FORCES = {
    "wind": _wind,
    "air_drag": _air_drag,
    "position_friction": _position_friction,
    "quadratic_friction": _joint_force(lambda q, v, c: -c * abs(v) * v),
    "stribeck_friction": _joint_force(lambda q, v, c: -c * np.tanh(v / 0.05) * np.exp(-((v / 2.0) ** 2))),
    "one_sided_spring": _joint_force(lambda q, v, c: -c * max(q + 0.3, 0.0)),
    "cubic_spring": _joint_force(lambda q, v, c: -c * q**3),
    "periodic_force": _periodic,
    "magnet": _magnet,
}
_COMMANDS = {
    "dead_band": _dead_band,
    "saturation": _saturation,
    "speed_gain": _speed_gain,
}
