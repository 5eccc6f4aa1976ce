"""A driven pendulum, stepped by plain MuJoCo, with any force on its hinge that the model lacks."""

from dataclasses import replace

import mujoco
import numpy as np

from skat.diagnosis.chains import NO_MEMORY, Memory
from skat.diagnosis.fitting import Fitted
from skat.diagnosis.noise import normal_noise, passed
from skat.diagnosis.statespace import linearise, state_space

TEXT = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="rod">
      <joint name="hinge" axis="0 1 0" damping="{damping}"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass=".8"/>
    </body>
  </worldbody>
  <actuator><motor joint="hinge" name="motor"/></actuator>
</mujoco>"""
FRAME_SKIP, DT = 2, 0.01
NOMINAL = TEXT.format(damping=0.05)
SIGMA = np.array([0.001, 0.01])


def measured(text, seed, *, law=None, rows=250, episodes=3, sigma=SIGMA, delay=0):
    """Return X, y, groups; ``law(q, v, time, rng)`` is a torque beside the model's, held for a row."""
    model, rng = mujoco.MjModel.from_xml_string(text), np.random.default_rng(seed)
    X, y = [], []
    for _ in range(episodes):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = rng.uniform(-1, 1), rng.normal()
        phases = rng.uniform(0, 6, 3)
        commands = [
            1.2 * np.sin(np.array([2.0, 5.0, 9.0]) * max(row, 0) * DT + phases).sum()
            for row in range(-10, rows)
        ]
        states = [np.r_[data.qpos, data.qvel]]
        for row in range(rows):
            data.ctrl[:] = commands[row + 10 - delay]
            if law is not None:
                data.qfrc_applied[:] = law(data.qpos[0], data.qvel[0], row * DT, rng)
            mujoco.mj_step(model, data, FRAME_SKIP)
            states.append(np.r_[data.qpos, data.qvel])
        read = np.array(states) + sigma * rng.normal(size=(rows + 1, 2))
        X.append(np.column_stack([read[:-1], commands[10:]]))
        y.append(read[1:])
    return np.concatenate(X), np.concatenate(y), np.repeat(np.arange(episodes), rows)


def laid_out(simulator, X, y, groups):
    """Return the log as a state space."""
    return state_space(simulator, X, y, groups, consecutive=True)


def known(space, values, force, *, share=None, nu=np.inf):
    """Return the fit at the true noise: of the sensors, and of a force of this standard deviation, N m."""
    linear = linearise(space, space.measured, values)
    chains, variance, memory = linear.chains, [force**2], NO_MEMORY
    error = SIGMA**2
    if share is not None:
        memory = Memory(1, share)
        chains = chains.with_memory(memory)
        variance, error = [1e-12, force**2 * (1 - share**2)], np.r_[error, 1.0]
    noise = normal_noise(chains, np.array(variance), error)
    noise = replace(noise, error_nu=np.full((1, len(error)), nu))
    return Fitted(
        values,
        linear,
        chains,
        passed(chains, noise, space.real, covariances=True),
        memory,
    )
