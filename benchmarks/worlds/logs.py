"""Measured logs of the worlds, and the size of what is hidden in noise units."""

import functools
from dataclasses import dataclass, field

import mujoco
import numpy as np
from mujoco import rollout

from worlds.hidden import channel_names as names_of_states
from worlds.models import FRAME_SKIP, actuator_names, hinges, nominal_model
from worlds.physics import Physics, tangent_difference

_GRID = 0.5  # of the noise's standard deviation: the sensors' resolution


@dataclass(frozen=True)
class Log:
    """What was measured in a world, and the truth about it.

    Attributes
    ----------
    X : ndarray of shape (n_rows, nq + nv + nu)
        Measured states and exact actions.
    y : ndarray of shape (n_rows, nq + nv)
        Measured next states; within an episode ``y[t]`` is the state in ``X[t + 1]``.
    groups : ndarray of shape (n_rows,)
        Episode of each row.
    sigma : ndarray of shape (2 nv,)
        Standard deviation of the noise of each tangent channel, in its unit.
    hidden : tuple of (family, target, value)
    """

    kind: str
    X: np.ndarray
    y: np.ndarray
    groups: np.ndarray
    sigma: np.ndarray
    hidden: tuple
    names: tuple = field(repr=False)
    times: np.ndarray = field(repr=False)
    previous_actions: np.ndarray = field(repr=False)

    def squared_errors(self, prediction):
        """Return the squared error of predicted next states per row, mean over channels, in noise units.

        The unit is what noise in the row and in its outcome does to the error of the nominal model: its
        covariance R + A R A^T, where A is the derivative of the nominal model's next state by the state.
        """
        model = nominal_model(self.kind)
        nq = model.nq
        error = tangent_difference(
            model, self.y[:, :nq], self.y[:, nq:], prediction[:, :nq], prediction[:, nq:]
        )
        white = np.linalg.solve(self.noise_factor, (error / self.sigma)[..., None])[..., 0]
        return np.mean(white**2, axis=1)

    @functools.cached_property
    def noise_factor(self):
        """The Cholesky factor of each row's R + A R A^T, in units of sigma: (n_rows, 2 nv, 2 nv)."""
        model = nominal_model(self.kind)
        nq, nv = model.nq, model.nv
        moved = np.tile(self.X[:, : nq + nv], (2 * nv + 1, 1, 1))
        for channel, sigma in enumerate(self.sigma):
            if channel >= nv:
                moved[channel, :, nq + channel - nv] += sigma
                continue
            step = np.zeros(nv)
            step[channel] = sigma
            for row in range(len(self.X)):
                mujoco.mj_integratePos(model, moved[channel, row, :nq], step, 1.0)
        moved = _step_nominal(
            self.kind, moved.reshape(-1, nq + nv), np.tile(self.X[:, nq + nv :], (2 * nv + 1, 1))
        )
        moved = moved.reshape(2 * nv + 1, len(self.X), nq + nv)
        derivative = np.empty((len(self.X), 2 * nv, 2 * nv))
        for channel in range(2 * nv):
            derivative[:, :, channel] = (
                tangent_difference(
                    model,
                    moved[channel, :, :nq],
                    moved[channel, :, nq:],
                    moved[-1, :, :nq],
                    moved[-1, :, nq:],
                )
                / self.sigma
            )
        return np.linalg.cholesky(np.eye(2 * nv) + derivative @ derivative.transpose(0, 2, 1))

    def predict(self, hidden=()):
        """Return next states predicted from the measured rows by a model with ``hidden`` in it."""
        physics = Physics(self.kind, hidden)
        offset, factor = _sensors(self.kind, hidden)
        nq, nv = physics.model.nq, physics.model.nv
        states = (self.X[:, : nq + nv] - offset) / factor
        prediction = np.empty_like(self.y)
        for row, state in enumerate(states):
            prediction[row] = np.concatenate(
                physics.advance(
                    state[:nq],
                    state[nq:],
                    self.X[row, nq + nv :],
                    self.previous_actions[row],
                    self.times[row],
                )
            )
        return prediction * factor + offset

    def excess(self):
        """Return s: the nominal model's mean squared one-step error over the true model's, minus 1."""
        nominal = self.squared_errors(self.predict()).mean()
        return nominal / self.squared_errors(self.predict(self.hidden)).mean() - 1


def measure(kind, hidden=(), *, seed, n_episodes=30, n_steps=50, noise=0.01):
    """Return a log of random-action episodes, measured in the world ``kind`` with ``hidden`` in it.

    Parameters
    ----------
    kind : {"hopper", "halfcheetah", "ant", "puck"}
    hidden : sequence of (family, target, value)
        ``target`` is None for a family without one.
    seed : int or sequence of int
    n_episodes, n_steps : int
    noise : float
        Standard deviation of the noise over the spread of each channel.
    """
    hidden = tuple(hidden)
    rng = np.random.default_rng([*np.atleast_1d(seed), 20240607])
    physics = Physics(kind, hidden)
    model = physics.model
    nq, nv, nu = model.nq, model.nv, model.nu
    states = np.empty((n_episodes, n_steps + 1, nq + nv))
    actions = np.empty((n_episodes, n_steps, nu))
    previous = np.zeros((n_episodes, n_steps, nu))
    times = np.empty((n_episodes, n_steps))
    dt = model.opt.timestep * physics.substeps
    for episode in range(n_episodes):
        actions[episode] = _actions(rng, model, n_steps)
        previous[episode, 1:] = actions[episode, :-1]
        times[episode] = rng.uniform(0, 10) + dt * np.arange(n_steps)
        qpos, qvel = _initial_state(rng, kind, model)
        states[episode, 0] = np.concatenate([qpos, qvel])
        for step in range(n_steps):
            qpos, qvel = physics.advance(
                qpos, qvel, actions[episode, step], previous[episode, step], times[episode, step]
            )
            states[episode, step + 1] = np.concatenate([qpos, qvel])
    if not np.all(np.isfinite(states)) or np.abs(states).max() > 1e4:
        raise RuntimeError(f"the world {kind} with {hidden} hidden in it diverged")
    measured, sigma = _measure_states(rng, kind, states, noise)
    offset, factor = _sensors(kind, hidden)
    measured = measured * factor + offset
    return Log(
        kind=kind,
        X=np.concatenate([measured[:, :-1], actions], axis=2).reshape(n_episodes * n_steps, -1),
        y=measured[:, 1:].reshape(n_episodes * n_steps, -1),
        groups=np.repeat(np.arange(n_episodes), n_steps),
        sigma=sigma,
        hidden=hidden,
        names=channel_names(kind),
        times=times.ravel(),
        previous_actions=previous.reshape(n_episodes * n_steps, nu),
    )


def size_for(s, kind, make_hidden, *, largest):
    """Return the strength at which what is hidden has about the size ``s`` in noise units.

    It is found on one clean log: by how far the effect moves its predictions. The world's own `Log.excess`,
    which is what counts, comes near to it.

    Parameters
    ----------
    s : float
    make_hidden : callable
        Strength, from 0, to a sequence of (family, target, value).
    largest : float
        Upper limit of the strength, which is returned where it takes more than that.
    """
    log, nominal, floor = _pilot(kind)

    def too_large(strength):
        moved = log.predict(make_hidden(strength)) - nominal
        # What is hidden adds its square to the square of the noise.
        return log.squared_errors(log.y + moved).mean() - s * floor

    low, high = 0.0, largest
    if too_large(largest) < 0:
        return largest
    for _ in range(14):
        middle = (low + high) / 2 if low else high / 4
        low, high = (low, middle) if too_large(middle) > 0 else (middle, high)
        if high < 1.1 * low:
            break
    return float(high)


@functools.cache
def _pilot(kind):
    """Return a short clean log, the nominal model's predictions and their mean squared error."""
    log = measure(kind, seed=999_999_937, n_episodes=8)
    nominal = log.predict()
    return log, nominal, log.squared_errors(nominal).mean()


def channel_names(kind):
    """Return the names of the columns of ``X``."""
    model = nominal_model(kind)
    return (*names_of_states(model), *(f"ctrl.{name}" for name in actuator_names(model)))


def _step_nominal(kind, states, actions):
    """Return the next states of many rows, by the nominal model."""
    model = nominal_model(kind)
    start = np.column_stack([np.zeros(len(states)), states])
    path, _ = rollout.rollout(
        model,
        mujoco.MjData(model),
        start,
        np.repeat(actions[:, None], FRAME_SKIP[kind], axis=1),
    )
    return path[:, -1, 1 : 1 + model.nq + model.nv]


def _actions(rng, model, n_steps):
    """Return uniform random actions, half of which are held for a second step."""
    actions = rng.uniform(-1, 1, size=(n_steps, model.nu))
    for step in range(1, n_steps):
        if rng.random() < 0.5:
            actions[step] = actions[step - 1]
    return actions


def _initial_state(rng, kind, model):
    """Return a random pose with random speeds, in contact with the ground or in flight."""
    data = mujoco.MjData(model)
    qpos = model.qpos0.copy()
    for j in hinges(model):
        low, high = model.jnt_range[j] if model.jnt_limited[j] else (-0.5, 0.5)
        middle = np.clip(0.0, low + 0.15 * (high - low), high - 0.15 * (high - low))
        reach = 0.25 * min(high - low, 2.0)
        qpos[model.jnt_qposadr[j]] = np.clip(
            middle + rng.uniform(-reach, reach), low + 0.05 * (high - low), high - 0.05 * (high - low)
        )
    qvel = rng.normal(size=model.nv)
    if kind == "puck":
        qpos[:2] = rng.uniform(-0.3, 0.3, size=2)
        qvel[:] *= [0.8, 0.8, 0.3, 3.0]
        height = 2
    elif kind == "ant":
        turn = rng.normal(scale=0.15, size=3)
        mujoco.mju_quatIntegrate(qpos[3:7], turn, 1.0)
        qvel[6:] *= 2
        height = 2
    else:
        qpos[2] = rng.normal(scale=0.15)
        qvel[3:] *= 2
        height = 1
    # Lift or lower the robot until its lowest point is -0.5 cm to 25 cm (a puck's: 3 cm) above the ground.
    data.qpos = qpos
    mujoco.mj_forward(model, data)
    gap = _lowest_point(model, data)
    qpos[height] += rng.uniform(-0.005, 0.03 if kind == "puck" else 0.25) - gap
    return qpos, qvel


def _lowest_point(model, data):
    lowest = np.inf
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] == 0 or model.geom(geom).name == "weight":
            continue
        reach = model.geom_size[geom, 0]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE:
            reach += model.geom_size[geom, 1] * abs(data.geom_xmat[geom, 8])
        elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            reach = model.geom_size[geom, 2]
        lowest = min(lowest, data.geom_xpos[geom, 2] - reach)
    return lowest


def _measure_states(rng, kind, states, noise):
    """Return the states as the sensors give them, and the noise of each tangent channel."""
    model = nominal_model(kind)
    nq, nv = model.nq, model.nv
    flat = states.reshape(-1, nq + nv)
    reference = flat[:1].repeat(len(flat), axis=0)
    tangent = tangent_difference(model, flat[:, :nq], flat[:, nq:], reference[:, :nq], reference[:, nq:])
    sigma = noise * tangent.std(axis=0)
    errors = _student(rng, tangent.shape) * sigma
    measured = flat + 0.0
    for row in range(len(flat)):
        mujoco.mj_integratePos(model, measured[row, :nq], errors[row, :nv], 1.0)
    measured[:, nq:] += errors[:, nv:]
    grid = _GRID * noise * flat.std(axis=0)
    measured = np.where(grid > 0, np.round(measured / np.where(grid > 0, grid, 1)) * grid, measured)
    for j in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        quaternion = slice(model.jnt_qposadr[j] + 3, model.jnt_qposadr[j] + 7)
        # As an inertial unit reports it: of unit length, the first component not negative.
        measured[:, quaternion] *= np.where(measured[:, quaternion][:, :1] < 0, -1, 1)
        measured[:, quaternion] /= np.linalg.norm(measured[:, quaternion], axis=1, keepdims=True)
    return measured.reshape(states.shape), sigma


def _student(rng, shape):
    """Return Student's t with 5 degrees of freedom, scaled to unit variance."""
    return rng.standard_t(5, size=shape) * np.sqrt(3 / 5)


def _sensors(kind, hidden):
    """Return the offset and the factor of every state channel's sensor."""
    names = [name for name in channel_names(kind) if not name.startswith("ctrl.")]
    offset, factor = np.zeros(len(names)), np.ones(len(names))
    for family, target, value in hidden:
        if family == "bias":
            offset[names.index(target)] += value
        elif family == "scale":
            factor[names.index(target)] *= value
    return offset, factor
