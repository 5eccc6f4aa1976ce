"""Make what README shows: the picture of an arm before and after its diagnosis.

The arm's log is made in plain MuJoCo with a dry friction of 0.6 N m in the elbow, a finer time step, an encoder of
14 bits and a noisy speed; skat knows none of it. ``python docs/readme.py`` writes ``docs/_static/arm.svg``, and
``python docs/readme.py FOLDER`` writes ``robot.xml`` and ``log.csv`` there instead, with which README's commands run.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd

ROOT = Path(__file__).resolve().parent.parent
ARM = """<mujoco model="arm">
  <option timestep="0.002" integrator="implicitfast"/>
  <default><joint damping="0.4" armature="0.01"/><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1.5"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.025" mass="0.8"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="60" kv="4" ctrlrange="-1.5 1.5"/>
    <position name="elbow" joint="elbow" kp="12" kv="1" ctrlrange="-1.5 1.5"/>
  </actuator>
</mujoco>
"""
FRICTION = 0.6  # N m
STEP = 0.02  # s
COUNT = 2 * np.pi / 2**14  # rad


def measured(*, timestep=0.0005, n_episodes=8, n_rows=150, seed=0, forearm=1.0):
    """Return the log of an arm whose elbow rubs, as a table that ``skat diagnose`` reads.

    The forearm is `forearm` times as heavy as in the model.
    """
    model = mujoco.MjModel.from_xml_string(ARM)
    model.opt.timestep = timestep
    model.dof_frictionloss[model.joint("elbow").dofadr[0]] = FRICTION
    lower = model.body("lower").id
    model.body_mass[lower] *= forearm
    model.body_inertia[lower] *= forearm
    mujoco.mj_setConst(model, mujoco.MjData(model))
    rng = np.random.default_rng(seed)
    rows = []
    for episode in range(n_episodes):
        data = mujoco.MjData(model)
        data.qpos[:] = rng.uniform(-0.3, 0.3, 2)
        rates, phases = rng.uniform(2, 5, 2), rng.uniform(0, 2 * np.pi, 2)
        for row in range(n_rows):
            data.ctrl[:] = 0.7 * np.sin(rates * STEP * row + phases)
            angles = COUNT * np.round(data.qpos / COUNT)
            speeds = data.qvel + 0.01 * rng.normal(size=2)
            rows.append([round(STEP * row, 3), episode, *angles, *speeds, *data.ctrl])
            mujoco.mj_step(model, data, nstep=round(STEP / model.opt.timestep))
    names = ["qpos.shoulder", "qpos.elbow", "qvel.shoulder", "qvel.elbow", "ctrl.shoulder", "ctrl.elbow"]
    return pd.DataFrame(rows, columns=["time", "episode", *names])


def write_files(folder, **log):
    """Write the model and the log that README's commands name."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.xml").write_text(ARM, "utf-8")
    measured(**log).to_csv(folder / "log.csv", index=False)


def write_picture(path):
    """Diagnose the arm and draw one episode in open loop, before and after."""
    import tempfile

    import matplotlib

    matplotlib.use("agg")
    matplotlib.rcParams["svg.hashsalt"] = "skat"
    from matplotlib import pyplot

    from skat.diagnosis import SimulationDiagnosis
    from skat.logs import load_log
    from skat.plotting import TrajectoryDisplay
    from skat.simulators import MujocoSimulator

    with tempfile.TemporaryDirectory() as folder:
        write_files(folder)
        log = load_log(Path(folder) / "log.csv", MujocoSimulator(Path(folder) / "robot.xml"))
    diagnosis = SimulationDiagnosis(log.simulator, random_state=0).fit(log.X, log.y, groups=log.groups)
    print(diagnosis)
    rows = log.groups == log.groups[-1]
    figure, axes = pyplot.subplots(1, 1, figsize=(7, 3), layout="constrained")
    TrajectoryDisplay.from_estimator(diagnosis, log.X[rows], log.y[rows], channels=["qpos.elbow"], ax=[axes])
    axes.set_xlabel("\n".join(["time (s)", *(cause.sentence for cause in diagnosis.causes_)]))
    figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    if sys.argv[1:]:
        write_files(sys.argv[1])
    else:
        write_picture(ROOT / "docs" / "_static" / "arm.svg")
