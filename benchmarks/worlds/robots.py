r"""Robots like those of users, with what is hidden in them, their sensors and random forces; no code of ``skat``.

A log of one call::

    from worlds.robots import make_log            # with benchmarks/ on the path

    log = make_log(
        "two_link",                               # any of ROBOTS
        {"dry_friction[elbow]": 0.1, "mass[lower]": 1.2},     # what is hidden: names and values as skat has them
        sensor="ideal",                           # any of sensing.SENSORS, or "exact"
        force="white20",                          # any of forces.FORCES, or None
        seed=3,
        rows=1000, episodes=1,                    # by default the robot's own
        finer=1,                                  # reality has so many time steps for one of the model's
    )
    log.mjcf, log.frame_skip                      # the nominal model of the user
    log.X, log.y, log.groups                      # what is handed to fit; NaN: not measured
    log.truth                                     # {name: value}
    log.size                                      # s of the whole truth, see Log.size
    log.sigma, log.exact                          # true noise of the ideal sensor; true states of the rows

Robots: two_link, cart_pole,
torque_arm, servo_arm, servo_arm_15hz, so101, quadruped_hung, quadruped_free, quadrotor, hopper, halfcheetah, puck, and
feedback (the two-link arm under feedback of its own noisy readings of a row ago).

Hidden families: mass, inertia, length, centre_of_mass, gravity, tilt, wind, damping, dry_friction, armature, stiffness,
gain, kp, kv, offset, contact_friction[all], restitution[all], delay[action], bias, scale.

Paths run on through an episode, from a lead of some rows before the first that is logged, so that filters have settled
and a delayed command is a real one. One seed gives one excitation, one noise and one force; sensors and forces are
drawn apart from commands, so that the same seed with another sensor is the same motion.
"""

import functools
from dataclasses import dataclass, field

import mujoco
import numpy as np

from worlds import mjcf as texts
from worlds.forces import random_force
from worlds.hidden import channel_names, edited_model, family_of, nominal_model, target_of
from worlds.models import PUCK_MJCF
from worlds.sensing import NOISE, read

LEAD = 8  # rows before the first that is logged
TAIL = 2
# Of positions and of velocities, SI units: noise that no sensor goes below.
LEAST_NOISE = (1e-4, 1e-3)


@dataclass(frozen=True)
class Robot:
    """A nominal model and how it is driven.

    Attributes
    ----------
    text : callable
        Returns the nominal MJCF.
    frame_skip : int
        Time steps of a row.
    drive : {"torques", "tracking", "feedback", "servos", "random", "hover"}
        Smooth random torques; torques of a controller that tracks a smooth random reference from exact readings, or
        from noisy ones of a row ago; smooth random targets of servos; random commands that are held for some rows;
        rotors of a controller that tracks a smooth random place, m, from exact readings.
    amplitude : tuple or float
        Of commands (torques, rad) or of references (rad).
    centre : tuple
        Pose about which the robot moves; () for the model's own.
    rate : float
        Highest frequency of the motion, Hz.
    rows, episodes : int
        Of a log, by default: rows in all.
    stiffness : tuple
        Of a controller that reads late, N m/rad; damping is a tenth of it.
    machine : tuple of (family, tuple of float)
        What each joint of every machine of this kind has and its model lacks, about; see `machine`.
    """

    text: object
    frame_skip: int
    drive: str
    amplitude: object
    centre: tuple = ()
    rate: float = 1.5
    rows: int = 1000
    episodes: int = 2
    stiffness: tuple = ()
    machine: tuple = ()


ARM_POSE = (0.0, -1.2, 1.2, -1.4, -1.5, 0.0)
STANCE = (0.0, 0.8, -1.5)

ROBOTS = {
    "two_link": Robot(lambda: texts.TWO_LINK, 5, "torques", (1.5, 0.7)),
    "feedback": Robot(
        lambda: texts.TWO_LINK, 5, "feedback", (0.7, 0.7), centre=(0.3, 0.3), stiffness=(6.0, 2.0)
    ),
    "cart_pole": Robot(lambda: texts.CART_POLE, 4, "torques", (6.0,), rate=1.0),
    "torque_arm": Robot(
        functools.partial(texts.six_joint_arm, "torque"),
        5,
        "tracking",
        (0.6, 0.4, 0.5, 0.6, 0.6, 0.8),
        centre=ARM_POSE,
        rate=1.0,
        rows=1500,
        machine=(
            ("dry_friction", (6.0, 6.0, 5.0, 1.5, 1.4, 1.2)),
            ("damping", (10.0, 12.0, 7.0, 2.0, 1.8, 1.5)),
            ("armature", (3.5, 3.5, 1.6, 0.3, 0.3, 0.3)),
        ),
    ),
    "servo_arm": Robot(
        functools.partial(texts.six_joint_arm, "servo"),
        5,
        "servos",
        (0.5, 0.35, 0.4, 0.5, 0.5, 0.6),
        centre=ARM_POSE,
        rate=1.2,
        rows=1500,
    ),
    # The same arm, logged at 15 Hz.
    "servo_arm_15hz": Robot(
        functools.partial(texts.six_joint_arm, "servo"),
        33,
        "servos",
        (0.5, 0.35, 0.4, 0.5, 0.5, 0.6),
        centre=ARM_POSE,
        rate=1.2,
        rows=450,
    ),
    "so101": Robot(texts.so101, 4, "servos", 0.4, rate=1.5, rows=1500),
    "quadruped_hung": Robot(
        functools.partial(texts.quadruped, "hung"),
        5,
        "tracking",
        (0.3, 0.5, 0.5) * 4,
        centre=STANCE * 4,
        rate=2.0,
        rows=1500,
        machine=(
            ("dry_friction", (0.3, 0.3, 0.4) * 4),
            ("damping", (0.15, 0.15, 0.2) * 4),
            ("armature", (0.012, 0.012, 0.025) * 4),
        ),
    ),
    "quadruped_free": Robot(
        functools.partial(texts.quadruped, "free"),
        5,
        "servos",
        (0.06, 0.12, 0.15) * 4,
        centre=STANCE * 4,
        rate=1.5,
        rows=1500,
        episodes=4,
    ),
    "quadrotor": Robot(lambda: texts.QUADROTOR, 5, "hover", (0.6, 0.6, 0.4), rate=0.5, rows=1500),
    "hopper": Robot(
        functools.partial(texts.gymnasium_text, "hopper.xml"), 4, "random", 1.0, rows=1000, episodes=20
    ),
    "halfcheetah": Robot(
        functools.partial(texts.gymnasium_text, "half_cheetah.xml"), 5, "random", 1.0, rows=1000, episodes=20
    ),
    "puck": Robot(lambda: PUCK_MJCF, 5, "random", 1.0, rows=1000, episodes=20),
}


@dataclass(frozen=True)
class Log:
    """What was measured of a robot, and the truth about it.

    Attributes
    ----------
    mjcf : str
        The nominal model.
    X, y, groups : ndarray
        Measured states with exact commands, measured next states, episode of each row. NaN: not measured.
    truth : dict
        Name to value of what is hidden.
    sigma : ndarray of shape (2 nv,)
        Noise of the ideal sensor, in each tangent channel's unit.
    exact, exact_next : ndarray
        True states of the rows of X and y.
    previous : ndarray
        The command of the row before.
    forces : ndarray of shape (n_rows, nv)
        Mean random force of each row.
    """

    robot: str
    mjcf: str
    frame_skip: int
    X: np.ndarray
    y: np.ndarray
    groups: np.ndarray
    truth: dict
    sensor: str
    force: str | None
    seed: int
    sigma: np.ndarray = field(repr=False)
    exact: np.ndarray = field(repr=False)
    exact_next: np.ndarray = field(repr=False)
    commands: np.ndarray = field(repr=False)
    history: np.ndarray = field(repr=False)  # (n_rows, LEAD + 1, nu): commands up to the row's own
    forces: np.ndarray = field(repr=False)

    @functools.cached_property
    def size(self):
        """s: what the hidden causes add to the squared one-step error of ideal readings, over what noise makes it.

        Noise is that of both ends of a step, and of the random force; the mean is over channels with noise.
        """
        return size_of(self, ())


def make_log(
    robot,
    truth=None,
    *,
    sensor="ideal",
    force=None,
    seed=0,
    rows=None,
    episodes=None,
    finer=1,
    noise=NOISE,
    unmodelled=0.0,
    build=None,
):
    """Return a `Log`; see the head of this module.

    Parameters
    ----------
    robot : str
        One of `ROBOTS`.
    truth : dict of str to float, optional
        What is hidden, by the names that ``skat`` gives to effects.
    sensor, force : str
    seed : int or sequence of int
    rows, episodes : int, optional
        Rows in all; episodes have equally many.
    finer : int
        Time steps of reality for one of the model.
    noise : float
        Of the ideal sensor, over the spread of each channel.
    build : callable, optional
        Of the world: a subclass of `World`, which is the default.
    """
    truth = dict(truth or {})
    kind = ROBOTS[robot]
    rows, episodes = rows or kind.rows, episodes or kind.episodes
    per_episode = rows // episodes
    entropy = [*np.atleast_1d(seed).tolist(), sum(robot.encode())]
    world = (build or World)(robot, truth, finer=finer)
    spread, rms = scales(robot)
    # Nobody measures a puck's height to a thousandth of a millimetre.
    sigma = noise / NOISE * np.maximum(NOISE * spread, np.repeat(LEAST_NOISE, len(spread) // 2))
    nv = world.model.nv
    parts = []
    for episode in range(episodes):
        motion, noises, pushes = (np.random.default_rng([*entropy, episode, stream]) for stream in range(3))
        n = LEAD + per_episode + TAIL
        forces = np.zeros((n * world.substeps, nv))
        if force:
            forces = random_force(force, rms, n, world.substeps, world.timestep, pushes)
        if unmodelled:
            joint = int(np.argmax(rms > 0))
            times = world.timestep * np.arange(len(forces))
            forces[:, joint] += (
                unmodelled * rms[joint] * np.sin(2 * np.pi * 0.7 * times + pushes.uniform(0, 6))
            )
        normal = noises.normal(size=(n + 1, 2 * nv))
        states, commands = run(world, n, motion, forces, sigma * normal)
        readings = world.readings(sensor, states, sigma, noises, normal)
        logged = np.arange(LEAD, LEAD + per_episode)
        history = np.stack([commands[logged - back] for back in range(LEAD, -1, -1)], axis=1)
        parts.append(
            (
                np.column_stack([readings[logged], commands[logged]]),
                readings[logged + 1],
                states[logged],
                states[logged + 1],
                commands[logged],
                history,
                forces.reshape(n, world.substeps, nv).mean(axis=1)[logged],
            )
        )
    X, y, exact, exact_next, sent, history, pushed = (np.concatenate(part) for part in zip(*parts))
    return Log(
        robot=robot,
        mjcf=kind.text(),
        frame_skip=kind.frame_skip,
        X=X,
        y=y,
        groups=np.repeat(np.arange(episodes), per_episode),
        truth=truth,
        sensor=sensor,
        force=force,
        seed=seed,
        sigma=sigma,
        exact=exact,
        exact_next=exact_next,
        commands=sent,
        history=history,
        forces=pushed,
    )


class World:
    """A robot as it really is: the model with what is hidden in it, stepped by plain MuJoCo.

    Parameters
    ----------
    robot : str
    truth : dict
    finer : int
    """

    def __init__(self, robot, truth=None, *, finer=1):
        self.kind = ROBOTS[robot]
        self.truth = dict(truth or {})
        self.model = edited_model(self.kind.text(), self.truth)
        self.dt = float(self.model.opt.timestep) * self.kind.frame_skip
        self.model.opt.timestep /= finer
        self.substeps = self.kind.frame_skip * finer
        self.timestep = float(self.model.opt.timestep)
        self.delay = self.truth.get("delay[action]", 0.0)
        self.data = mujoco.MjData(self.model)
        self.winds = {
            "xyz".index(target_of(name)): value
            for name, value in self.truth.items()
            if family_of(name) == "wind"
        }
        self.is_free = bool(np.any(self.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE))

    def reset(self, state):
        """Start from a state, as after a rest of the solver."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = state[: self.model.nq], state[self.model.nq :]

    def advance(self, history, forces=None):
        """Go one row on, and return the state.

        Parameters
        ----------
        history : ndarray of shape (n, nu)
            Commands of the rows before, the last the row's own.
        forces : ndarray of shape (substeps, nv), optional
        """
        model, data, h = self.model, self.data, self.timestep
        for k in range(self.substeps):
            # The command of a time step is the mean of what has arrived while it lasts.
            whole, part = divmod((self.delay - k * h) / self.dt, 1.0) if self.delay > k * h else (-1, 0.0)
            if self.delay <= k * h:
                data.ctrl[:] = history[-1]
            else:
                # From (delay - k h) back in time, for h: the row that it falls into, and the one after.
                row = int(whole) + 1
                stays = min(1.0, part * self.dt / h) if part > 0 else 0.0
                if part <= 1e-9:
                    row, stays = int(whole), 1.0
                older, newer = history[-1 - min(row, len(history) - 1)], history[-1 - max(row - 1, 0)]
                data.ctrl[:] = stays * older + (1 - stays) * newer
            if forces is not None:
                data.qfrc_applied[:] = forces[k]
            for axis, value in self.winds.items():
                data.xfrc_applied[1, axis] = value
            mujoco.mj_step(model, data)
        return np.concatenate([data.qpos, data.qvel])

    def readings(self, sensor, states, sigma, rng, normal):
        """Return what sensors say of a path of states, (n, nq + nv)."""
        model = self.model
        nq, nv = model.nq, model.nv
        if self.is_free:
            if sensor not in ("ideal", "exact"):
                raise ValueError("a free base is read by ideal sensors only")
            measured = states.copy()
            if sensor == "ideal":
                for row, error in zip(measured, sigma * normal):
                    mujoco.mj_integratePos(model, row[:nq], error[:nv], 1.0)
                    row[nq:] += error[nv:]
        else:
            turning = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
            measured = read(sensor, states, sigma, turning, self.dt, rng, normal=normal)
        names = channel_names(model)
        # Measured = scale * true + bias.
        for family, act in (("scale", np.multiply), ("bias", np.add)):
            for name, value in self.truth.items():
                if family_of(name) == family and not target_of(name).startswith("ctrl."):
                    column = names.index(target_of(name))
                    measured[:, column] = act(measured[:, column], value)
        return measured


def run(world, n_rows, rng, forces, errors):
    """Return states (n_rows + 1, nq + nv) and commands (n_rows, nu) of an episode."""
    model, kind = world.model, world.kind
    nominal = nominal_model(kind.text())
    nu, dt = model.nu, world.dt
    hovers = kind.drive == "hover"
    driven = np.array([], int) if hovers else model.actuator_trnid[:, 0]
    positions, dofs = model.jnt_qposadr[driven], model.jnt_dofadr[driven]
    centre = np.array(kind.centre) if kind.centre else model.qpos0[positions]
    n_references = 3 if hovers else nu
    smooth = Smooth(rng, n_references, kind.rate) if kind.drive != "random" else None
    amplitude = np.broadcast_to(np.asarray(kind.amplitude, float), n_references)
    limited = model.actuator_ctrllimited.astype(bool)
    low, high = np.where(limited, model.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
    state = start_state(world, rng, smooth, amplitude, centre, positions, dofs)
    world.reset(state)
    states, commands = np.empty((n_rows + 1, len(state))), np.empty((n_rows, nu))
    states[0] = state
    helper = mujoco.MjData(nominal)
    command = np.zeros(nu)
    for row in range(n_rows):
        time = row * dt
        if kind.drive == "random":
            if row == 0 or rng.random() < 0.5:
                command = amplitude * rng.uniform(-1, 1, nu)
        elif kind.drive == "torques":
            command = amplitude * smooth(time)[0]
        elif kind.drive == "servos":
            command = centre + amplitude * smooth(time)[0]
        elif hovers:
            command = _hovering(nominal, states[row], *(amplitude * one for one in smooth(time)))
        else:
            late = row - 1 if kind.drive == "feedback" and row else row
            seen = states[late] + (errors[late] if kind.drive == "feedback" else 0.0)
            command = _tracking(
                world, nominal, helper, seen, *(amplitude * one for one in smooth(time)), centre
            )
        command = np.clip(command, low, high)
        commands[row] = command
        past = np.maximum(np.arange(row - LEAD, row + 1), 0)
        states[row + 1] = world.advance(
            commands[past],
            forces[row * world.substeps : (row + 1) * world.substeps] if forces.any() else None,
        )
    if not np.all(np.isfinite(states)) or np.abs(states).max() > 1e3 or _warned(world.data):
        raise RuntimeError(f"the world with {world.truth} hidden in it diverged")
    return states, commands


def _tracking(world, nominal, helper, seen, angle, rate, centre):
    """Return the torques of a controller that knows the model, and of its machine what its maker tuned it to.

    Gravity by the model; feedback of 15 rad/s, or as stiff as the robot says; 80 % of the friction.
    """
    model, stiffness = world.model, world.kind.stiffness
    driven = model.actuator_trnid[:, 0]
    positions, dofs = model.jnt_qposadr[driven], model.jnt_dofadr[driven]
    helper.qpos[:], helper.qvel[:] = seen[: model.nq], 0
    mujoco.mj_forward(nominal, helper)
    error, late = centre + angle - seen[positions], rate - seen[model.nq + dofs]
    gravity = helper.qfrc_bias[dofs]
    if stiffness:
        return gravity + stiffness * (error + 0.1 * late)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(nominal, helper, inertia)
    inertia = np.diag(inertia)[dofs] + model.dof_armature[dofs]
    friction = model.dof_frictionloss[dofs] * np.tanh(rate / 0.05) + model.dof_damping[dofs] * rate
    return gravity + inertia * (15.0**2 * error + 1.5 * 15.0 * late) + 0.8 * friction


def _hovering(model, state, place, speed):
    """Return the thrust of each rotor of a quadrotor that tracks a place about that of its model, by the model's mass.

    2 rad/s in place, 12 rad/s in attitude, both critically damped; the thrust is turned to where it is wanted.
    """
    q, v = state[:7], state[7:]
    push = 4.0 * (model.qpos0[:3] + place - q[:3]) + 4.0 * (speed - v[:3]) - model.opt.gravity
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, q[3:])
    axes = axes.reshape(3, 3)
    mass, inertia = model.body_mass[1], model.body_inertia[1]
    thrust = mass * push @ axes[:, 2]
    # About which axis of the frame, and how far, its own z is off; yaw is held.
    off = axes.T @ np.cross(axes[:, 2], push / np.linalg.norm(push))
    off[2] = -2 * q[0] * q[6]
    moment = inertia * (144.0 * off - 24.0 * v[3:])
    arms = model.actuator_gear[:, 5] / model.actuator_gear[:, 2]
    places = model.site_pos[model.actuator_trnid[:, 0]]
    mixer = np.stack([np.ones(model.nu), places[:, 1], -places[:, 0], arms])
    return np.linalg.solve(mixer, np.r_[thrust, moment])


def machine(robot, rng=None, families=("dry_friction", "damping", "armature")):
    """Return what every machine of a kind has and its model lacks: name to value, one per joint and family.

    Parameters
    ----------
    robot : str
    rng : numpy.random.Generator, optional
        Varies each value by a factor of up to 2 either way.
    families : sequence of str
    """
    kind = ROBOTS[robot]
    model = nominal_model(kind.text())
    return {
        f"{family}[{model.joint(joint).name}]": value * (2 ** rng.uniform(-1, 1) if rng else 1.0)
        for family, values in kind.machine
        if family in families
        for joint, value in enumerate(values)
    }


class Smooth:
    """A sum of eight sines per channel, of random phases and frequencies up to ``rate``; about 1 at most."""

    def __init__(self, rng, n, rate):
        self.omega = 2 * np.pi * rng.uniform(0.1 * rate, rate, size=(8, n))
        self.phase = rng.uniform(0, 2 * np.pi, size=(8, n))

    def __call__(self, time):
        """Return value and derivative at a time, s."""
        angle = self.omega * time + self.phase
        return np.sin(angle).sum(axis=0) / 4, (self.omega * np.cos(angle)).sum(axis=0) / 4


def start_state(world, rng, smooth, amplitude, centre, positions, dofs):
    """Return the state in which an episode begins."""
    model, kind = world.model, world.kind
    qpos, qvel = model.qpos0.copy(), np.zeros(model.nv)
    if kind.drive == "hover":
        place, rate = smooth(0.0)
        qpos[:3], qvel[:3] = qpos[:3] + amplitude * place, amplitude * rate
    elif kind.drive in ("tracking", "feedback", "servos"):
        angle, rate = smooth(0.0)
        qpos[positions], qvel[dofs] = centre + amplitude * angle, amplitude * rate
        if world.is_free:
            qvel[:] = 0
            qpos[2] = _standing(model, qpos)
    elif kind.drive == "torques":
        qpos += rng.uniform(-0.5, 0.5, model.nq)
        qvel += rng.normal(size=model.nv)
    elif kind is ROBOTS["puck"]:
        # From half a centimetre within the table to three above it.
        qpos[2:] = rng.uniform(-0.005, 0.03), rng.uniform(-3, 3)
        qvel[:] = rng.normal(size=model.nv) * [0.8, 0.8, 0.3, 3.0]
    else:
        qpos[2] += 0.1 * rng.normal()
        qpos[positions] += rng.uniform(-0.2, 0.2, len(positions))
        for joint in np.flatnonzero(model.jnt_limited):
            at, (least, most) = model.jnt_qposadr[joint], model.jnt_range[joint]
            qpos[at] = np.clip(qpos[at], least + 0.05 * (most - least), most - 0.05 * (most - least))
        qvel[:] = rng.normal(size=model.nv)
        qpos[1] += 0.1 + rng.uniform(0, 0.15)
    return np.concatenate([qpos, qvel])


def _standing(model, qpos):
    """Return the height at which the lowest foot touches the floor."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    feet = [g for g in range(model.ngeom) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_SPHERE]
    return qpos[2] - min(data.geom_xpos[g, 2] - model.geom_size[g, 0] for g in feet)


@functools.cache
def scales(robot):
    """Return the spread of each tangent channel, and the rms torque of the motors on each degree of freedom.

    Both are of the robot's motion in episodes of its own; with what every machine of the kind has.
    """
    world = World(robot, machine(robot))
    model = world.model
    moved, torques = [], []
    for seed in range(6):
        rng = np.random.default_rng([seed, 20240612])
        n = max(60, world.kind.rows // world.kind.episodes // 2)
        nothing = np.zeros((n * world.substeps, model.nv))
        states, commands = run(world, n, rng, nothing, np.zeros((n + 1, len(model.qpos0) + model.nv)))
        data = mujoco.MjData(model)
        tangent = np.empty((n, 2 * model.nv))
        torque = np.empty((n, model.nv))
        for row in range(n):
            state = states[row]
            mujoco.mj_differentiatePos(model, tangent[row, : model.nv], 1.0, model.qpos0, state[: model.nq])
            tangent[row, model.nv :] = state[model.nq :]
            data.qpos[:], data.qvel[:], data.ctrl[:] = state[: model.nq], state[model.nq :], commands[row]
            mujoco.mj_forward(model, data)
            torque[row] = data.qfrc_actuator
        moved.append(tangent)
        torques.append(torque)
    return np.concatenate(moved).std(axis=0), np.sqrt(np.mean(np.concatenate(torques) ** 2, axis=0))


def tangent_error(model, states, others):
    """Return states minus others in the tangent space, (n, 2 nv)."""
    error = np.empty((len(states), 2 * model.nv))
    for row, (one, other) in enumerate(zip(states, others)):
        mujoco.mj_differentiatePos(model, error[row, : model.nv], 1.0, other[: model.nq], one[: model.nq])
    error[:, model.nv :] = states[:, model.nq :] - others[:, model.nq :]
    return error


def predict(log, truth, states=None):
    """Return next states of a log's rows, from ``states`` (the true ones), by the model with ``truth`` in it."""
    world = World(log.robot, truth)
    states = log.exact if states is None else states
    predicted = np.empty_like(states)
    for row, state in enumerate(states):
        world.reset(state)
        predicted[row] = world.advance(log.history[row])
    return predicted


def size_of(log, without):
    """Return s of what is hidden, or of the causes named in ``without`` alone, the others being known.

    Parameters
    ----------
    log : Log
    without : sequence of str
        Names of hidden causes; () for all.
    """
    model = World(log.robot).model
    names = [name for name in log.truth if not _is_sensor(name)]
    left = {name: value for name, value in log.truth.items() if without and name not in without}
    change = tangent_error(model, predict(log, log.truth), predict(log, left)) if names else 0.0
    change = change + _sensor_change(log, model, set(without) or set(log.truth))
    # Noise of a step's error: of the reading after it, and of that before it, carried on.
    rng = np.random.default_rng(1)
    start = log.exact.copy()
    errors = log.sigma * rng.normal(size=(len(start), 2 * model.nv))
    for row, error in zip(start, errors):
        mujoco.mj_integratePos(model, row[: model.nq], error[: model.nv], 1.0)
        row[model.nq :] += error[model.nv :]
    noise = tangent_error(model, predict(log, log.truth, start), log.exact_next)
    variance = np.mean(noise**2, axis=0) + log.sigma**2
    usable = log.sigma > 0
    return float(np.mean(np.mean(np.atleast_2d(change) ** 2, axis=0)[usable] / variance[usable]))


def _sensor_change(log, model, chosen):
    """Return by how much biases and scales move a one-step error, about; only of channels without quaternions."""
    change = np.zeros((len(log.exact), 2 * model.nv))
    if model.nq != model.nv:
        return change
    moved = log.exact.copy()
    after = log.exact_next.copy()
    names = channel_names(model)
    present = [name for name in log.truth if _is_sensor(name) and name in chosen]
    if not present:
        return change
    for name in present:
        column, value = names.index(target_of(name)), log.truth[name]
        for states in (moved, after):
            states[:, column] = (
                states[:, column] + value if family_of(name) == "bias" else states[:, column] * value
            )
    others = {name: value for name, value in log.truth.items() if not _is_sensor(name)}
    return tangent_error(model, after, predict(log, others, moved)) - tangent_error(
        model, log.exact_next, predict(log, others)
    )


def _is_sensor(name):
    return family_of(name) in ("bias", "scale")


def _warned(data):
    # Not of what only says that a buffer was small.
    kinds = (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
    return any(data.warning[kind].number for kind in kinds)
