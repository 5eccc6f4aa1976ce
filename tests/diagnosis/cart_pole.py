"""A cart with a pole: a simulation that costs next to nothing, and a world that shares no code with it.

Worlds are stepped by other code than the simulation, more finely, with noise that is not normal and is rounded.
"""

import numpy as np

from skat.effects import Effect
from skat.simulators import FunctionSimulator

DT = 0.02
NEUTRAL = {
    "bob": 1.0,
    "pole": 1.0,
    "gain": 1.0,
    "drag": 0.0,
    "dry_friction": 0.0,
    "gravity": 1.0,
    "hinge": 0.0,
}
BOUNDS = {
    "bob": (0.2, 5.0),
    "pole": (0.2, 5.0),
    "gain": (-3.0, 3.0),
    "drag": (0.0, 2.0),
    "dry_friction": (0.0, 2.0),
    "gravity": (0.2, 5.0),
    "hinge": (0.0, 2.0),
}
STATES = ("x", "angle", "v", "w")


def accelerations(state, force, p):
    """Simulation: a pole of 0.5 m with a bob of 0.2 kg on a cart of 1 kg."""
    _, angle, v, w = state.T
    mass, length, gravity = 0.2 * p["bob"], 0.5 * p["pole"], 9.81 * p["gravity"]
    pushed = p["gain"] * force - p["drag"] * v - p["dry_friction"] * np.tanh(v / 0.01)
    sin, cos = np.sin(angle), np.cos(angle)
    pushed = pushed + mass * length * w**2 * sin - mass * gravity * sin * cos + p["hinge"] * w * cos / length
    a = pushed / (1.0 + mass * sin**2)
    return a, (gravity * sin - a * cos) / length - p["hinge"] * w / (mass * length**2)


def cart_pole(X, **values):
    p = {**NEUTRAL, **values}
    state, force = X[:, :4], X[:, 4]

    def slope(at):
        return np.column_stack([at[:, 2:], *accelerations(at, force, p)])

    h = DT / 2
    for _ in range(2):
        k1 = slope(state)
        k2 = slope(state + h / 2 * k1)
        k3 = slope(state + h / 2 * k2)
        k4 = slope(state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state


def world_step(state, force, hidden, magnet):
    """World: the same physics from the mass matrix, by 20 steps of the midpoint rule."""
    p = {**NEUTRAL, **hidden}
    mass, length = 0.2 * p["bob"], 0.5 * p["pole"]
    q, velocity = state[:, :2].copy(), state[:, 2:].copy()
    h = DT / 20

    def slope(q, velocity):
        (x, angle), (v, w) = q.T, velocity.T
        matrix = np.empty((len(q), 2, 2))
        matrix[:, 0, 0], matrix[:, 1, 1] = 1.0 + mass, mass * length**2
        matrix[:, 0, 1] = matrix[:, 1, 0] = mass * length * np.cos(angle)
        pull = p["gain"] * force - p["drag"] * v - p["dry_friction"] * np.tanh(v / 0.01)
        pull = pull + magnet * np.exp(-0.5 * (x / 0.5) ** 2) + mass * length * w**2 * np.sin(angle)
        torque = mass * 9.81 * p["gravity"] * length * np.sin(angle) - p["hinge"] * w
        return np.linalg.solve(matrix, np.stack([pull, torque], axis=1)[..., None])[..., 0]

    for _ in range(20):
        middle = q + h / 2 * velocity, velocity + h / 2 * slope(q, velocity)
        q, velocity = q + h * middle[1], velocity + h * slope(*middle)
    return np.concatenate([q, velocity], axis=1)


def measure(seed, *, magnet=0.0, n_episodes=8, n_steps=40, noise=0.01, **hidden):
    """Return X, y, groups and the noise's standard deviations of a measured world."""
    rng = np.random.default_rng(seed)
    state = rng.normal(size=(n_episodes, 4))
    force = 3 * rng.normal(size=n_episodes)
    states, forces = [state], []
    for _ in range(n_steps):
        force = 0.7 * force + 3 * rng.normal(size=n_episodes)
        state = world_step(state, force, hidden, magnet)
        states.append(state)
        forces.append(force)
    states, forces = np.stack(states, axis=1), np.stack(forces, axis=1)
    deviations = noise * states.reshape(-1, 4).std(axis=0)
    states = states + rng.standard_t(5, size=states.shape) * np.sqrt(3 / 5) * deviations
    if noise:
        states = np.round(states / (deviations / 4)) * (deviations / 4)
    X = np.concatenate([states[:, :-1], forces[..., None]], axis=2).reshape(-1, 5)
    return X, states[:, 1:].reshape(-1, 4), np.repeat(np.arange(n_episodes), n_steps), deviations


def make_simulator():
    """Return the simulator, with every effect that the world can hide."""
    return FunctionSimulator(
        cart_pole,
        input_names=(*STATES, "force"),
        output_names=STATES,
        state_names=STATES,
        units={"x": "m", "angle": "rad", "v": "m/s", "w": "rad/s"},
        effects=[Effect(name, unit="1", neutral=NEUTRAL[name], bounds=BOUNDS[name]) for name in NEUTRAL],
    )
