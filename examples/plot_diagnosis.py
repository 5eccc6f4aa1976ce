"""
What does my simulation get wrong?
==================================

A motor swings a pendulum. The real one has dry friction in its hinge, and the model has none: whoever fits
its mass and its damping to the measurements gets wrong ones. Here the measurements are simulated, so that we
know what there is to find; the diagnosis is not told, nor how large the noise is.
"""

# sphinx_gallery_thumbnail_number = 2
# %%
# The simulation that one would write first.

import mujoco
import numpy as np

from skat.diagnosis import SimulationDiagnosis, compare_transports
from skat.plotting import CauseDisplay, TrajectoryDisplay
from skat.simulators import MujocoSimulator

MODEL = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <body name="rod">
      <joint name="hinge" axis="0 1 0" damping="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="0.4"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
</mujoco>
"""
simulator = MujocoSimulator(MODEL, frame_skip=4)

# %%
# The measurements: plain MuJoCo with friction in the hinge, and 0.5 % of noise.


def measure(n_episodes, n_steps, seed):
    """Return X, y and the episode of each row."""
    world = mujoco.MjModel.from_xml_string(MODEL)
    world.dof_frictionloss[0] = 0.03
    data = mujoco.MjData(world)
    rng = np.random.default_rng(seed)
    states, actions = np.empty((n_episodes, n_steps + 1, 2)), np.empty((n_episodes, n_steps, 1))
    for episode in range(n_episodes):
        mujoco.mj_resetData(world, data)
        data.qpos[0] = rng.normal()
        states[episode, 0] = data.qpos[0], data.qvel[0]
        for step in range(n_steps):
            if step % 5 == 0:
                data.ctrl[0] = rng.uniform(-1, 1)
            actions[episode, step] = data.ctrl
            mujoco.mj_step(world, data, nstep=4)
            states[episode, step + 1] = data.qpos[0], data.qvel[0]
    states += 0.005 * states.std(axis=(0, 1)) * rng.normal(size=states.shape)
    X = np.concatenate([states[:, :-1], actions], axis=2).reshape(-1, 3)
    return X, states[:, 1:].reshape(-1, 2), np.repeat(np.arange(n_episodes), n_steps)


X, y, episodes = measure(n_episodes=15, n_steps=60, seed=0)

# %%
# The diagnosis considers everything that this simulation could take on: masses, lengths, frictions, gains,
# delays, sensor errors and more. In a notebook it shows what it finds.

print(len(simulator.effects()), "effects")
diagnosis = SimulationDiagnosis(simulator, random_state=0)
diagnosis.fit(X, y, groups=episodes)

# %%
# The interval holds the truth, 0.03 N m. What these data cannot tell apart would be said.

causes = CauseDisplay.from_estimator(diagnosis)

# %%
# The gain counts on data that were not used: on new episodes, simulated from their first state on without
# looking at the measurements again.

X_new, y_new, episodes_new = measure(n_episodes=5, n_steps=100, seed=1)
gain = diagnosis.evaluate(X_new, y_new, groups=episodes_new, horizon="episode")
print(f"open-loop error: {gain.nominal:.3f} before, {gain.extended:.3f} after")
one = episodes_new == 0
paths = TrajectoryDisplay.from_estimator(diagnosis, X_new[one], y_new[one])

# %%
# Could a map that is learned from the data do better than the named causes? If so, something would be left to
# explain.

errors = compare_transports(
    diagnosis, X, y, X_new, y_new, groups_fit=episodes, groups_test=episodes_new, random_state=0
)
errors.filter(["method", "error", "ratio", "ratio_low", "ratio_high"])

# %%
# And what else would the data have shown? For each effect the smallest size that would have been named, and
# the effect that it could most easily be taken for:

diagnosis.identifiability_.sort_values("smallest").head(8)

# %%
# A page with all of this and more pictures: ``diagnosis.report_.to_html("report.html")``. The extended model,
# for any user of MuJoCo: ``diagnosis.extended_simulator_.to_mjcf("extended.xml")``.
