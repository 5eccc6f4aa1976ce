"""Hide effects in robots that no part of the engine was made with, diagnose each, and print what was named.

Gymnasium's Walker2d, Swimmer, InvertedPendulum, InvertedDoublePendulum, Reacher and Pusher, simulated by plain MuJoCo;
an effect is a raw edit of the compiled model. Sensors have Student-t noise of 1 % of each channel's spread, rounded to
half of that. A size s is the mean squared change of the next state by the effect, in variances of the noise::

    python benchmarks/other_robots.py                      # two seeds of every effect in every robot
    python benchmarks/other_robots.py --robots swimmer     # some of them
"""

import argparse
import time
import warnings
from collections import Counter
from pathlib import Path

import gymnasium
import joblib
import mujoco
import numpy as np

ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
# File, time steps of a transition, episodes of 50 transitions.
ROBOTS = {
    "walker2d": ("walker2d_v5.xml", 4, 12),
    "swimmer": ("swimmer.xml", 4, 12),
    "single pendulum": ("inverted_pendulum.xml", 2, 12),
    "double pendulum": ("inverted_double_pendulum.xml", 5, 12),
    "reacher": ("reacher.xml", 2, 12),
    "pusher": ("pusher_v5.xml", 5, 8),
}
FACTORS = (0.7, 0.85, 1.2, 1.4)
FAMILIES = (
    "nothing",
    "mass",
    "mass[all]",
    "damping",
    "dry_friction",
    "armature",
    "stiffness",
    "gain",
    "gravity",
    "contact_friction[all]",
    "bias",
    "scale",
)
N_ROWS, NOISE = 50, 0.01
VISIBLE = 0.1


def main():
    arguments = _arguments()
    tasks = [
        (robot, family, seed)
        for seed in range(arguments.seeds)
        for robot in arguments.robots
        for family in FAMILIES
    ]
    verdicts = Counter()
    runs = joblib.Parallel(n_jobs=arguments.n_jobs, return_as="generator")(
        joblib.delayed(run)(*task) for task in tasks
    )
    for which, told, line in runs:
        print(line, flush=True)
        verdicts[which, told] += 1
    for (which, told), count in sorted(verdicts.items()):
        print(f"{which}: {told}: {count}")


def run(robot, family, seed):
    """Return which case it is, what was told (right, alias, unexplained, nothing or false), and a line to print."""
    warnings.filterwarnings("ignore")
    from skat.diagnosis import SimulationDiagnosis
    from skat.simulators import MujocoSimulator

    file, frame_skip, n_episodes = ROBOTS[robot]
    rng = np.random.default_rng([seed, FAMILIES.index(family), list(ROBOTS).index(robot)])
    nominal = mujoco.MjModel.from_xml_path(str(ASSETS / file))
    model = mujoco.MjModel.from_xml_path(str(ASSETS / file))
    name, value = _edited(model, family, rng)
    states, actions = _episodes(model, frame_skip, n_episodes, rng)
    s, value, X, y, groups = _measured(states, actions, nominal, frame_skip, name, value, rng)
    names = _channels(nominal)
    title = f"{robot} #{seed}: " + (f"{name} {value:.4g} (s {s:.2g})" if value is not None else "nothing")
    simulator = MujocoSimulator(ASSETS / file, frame_skip=frame_skip)
    assert simulator.state_names == tuple(names)
    start = time.process_time()
    diagnosis = SimulationDiagnosis(simulator, random_state=seed, n_jobs=1).fit(X, y, groups=groups)
    seconds = time.process_time() - start
    causes = diagnosis.causes_
    found = "; ".join(
        f"{cause.name} {cause.value:.4g} ({cause.interval[0]:.4g} to {cause.interval[1]:.4g})"
        + (f", aliases {', '.join(cause.aliases)}" if cause.aliases else "")
        for cause in causes
    )
    told = {"nothing detected": "nothing", "unexplained": "unexplained"}.get(diagnosis.verdict_, "false")
    covered = ""
    if len(causes) == 1 and causes[0].name == name:
        told = told if told == "unexplained" else "right"
        covered = " in" if causes[0].interval[0] <= value <= causes[0].interval[1] else " OUT"
    elif diagnosis.verdict_ == "ambiguous" and len(causes) == 1 and name in causes[0].aliases:
        told = "alias"
    which = "nothing hidden" if value is None else f"s >= {VISIBLE}" if s >= VISIBLE else f"s < {VISIBLE}"
    if value is not None and name not in {effect.name for effect in simulator.effects()}:
        which = "not in the list"
    return (
        which,
        told,
        f"{told:11s} {title}: {diagnosis.verdict_} {found}{covered} [{which}, {seconds:.0f} s]",
    )


def _edited(model, family, rng):
    """Edit a model, and return the effect's name and value; sensors are left to `_measured`, a bias in noise units."""
    factor = float(rng.choice(FACTORS))
    joint = int(rng.integers(model.njnt))
    dof = model.jnt_dofadr[joint]
    strength = float(np.abs(model.actuator_gear[:, 0]).max())
    if family == "nothing":
        return "nothing", None
    if family.startswith("mass"):
        bodies = [int(rng.choice(np.flatnonzero(model.body_mass > 0)))] if family == "mass" else slice(None)
        model.body_mass[bodies] *= factor
        model.body_inertia[bodies] *= factor
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return (family if family != "mass" else f"mass[{model.body(bodies[0]).name}]"), factor
    if family == "gain":
        actuator = int(rng.integers(model.nu))
        model.actuator_gear[actuator] *= factor
        joint = model.actuator_trnid[actuator, 0]
        return f"gain[{model.actuator(actuator).name or model.joint(joint).name}]", factor
    if family == "gravity":
        factor = 1 + 0.3 * (factor - 1)
        model.opt.gravity[:] *= factor
        return family, factor
    if family == "contact_friction[all]":
        model.geom_friction[:, 0] *= factor
        return family, factor
    if family in ("bias", "scale"):
        column = int(rng.integers(model.nq + model.nv))
        size = 10 * (factor - 1) if family == "bias" else 1 + 0.3 * (factor - 1)
        return f"{family}[{_channels(model)[column]}]", size
    inertia = model.dof_armature[dof] + 1 / model.dof_invweight0[dof]
    field, added = {
        "damping": (model.dof_damping[dof : dof + 1], 0.05 * strength),
        "dry_friction": (model.dof_frictionloss[dof : dof + 1], 0.1 * strength),
        "armature": (model.dof_armature[dof : dof + 1], 0.2 * inertia),
        "stiffness": (model.jnt_stiffness[joint : joint + 1], 0.3 * strength),
    }[family]
    field += added
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return f"{family}[{model.joint(joint).name}]", float(added)


def _channels(model):
    names = [model.joint(joint).name for joint in range(model.njnt)]
    return [f"qpos.{name}" for name in names] + [f"qvel.{name}" for name in names]


def _episodes(model, frame_skip, n_episodes, rng):
    """Return states (n_episodes, N_ROWS + 1, nq + nv) and actions of random, correlated torques."""
    data = mujoco.MjData(model)
    limited = model.actuator_ctrllimited.astype(bool)
    low, high = np.where(limited, model.actuator_ctrlrange.T, [[-1.0], [1.0]])
    states = np.empty((n_episodes, N_ROWS + 1, model.nq + model.nv))
    actions = np.empty((n_episodes, N_ROWS, model.nu))
    for episode in range(n_episodes):
        mujoco.mj_resetData(model, data)
        data.qpos[:] += rng.uniform(-0.05, 0.05, model.nq)
        data.qvel[:] += 0.1 * rng.normal(size=model.nv)
        states[episode, 0] = np.r_[data.qpos, data.qvel]
        action = np.zeros(model.nu)
        for row in range(N_ROWS):
            action = np.clip(0.7 * action + 0.7 * rng.uniform(low, high), low, high)
            actions[episode, row] = action
            states[episode, row + 1] = _stepped(model, data, states[episode, row], action, frame_skip)
    return states, actions


def _stepped(model, data, state, action, frame_skip):
    mujoco.mj_resetData(model, data)
    data.qpos[:], data.qvel[:] = state[: model.nq], state[model.nq :]
    data.ctrl[:] = action
    for _ in range(frame_skip):
        mujoco.mj_step(model, data)
    if any(data.warning[kind].number for kind in range(len(data.warning))):
        raise ValueError("the world is unstable: choose smaller effects")
    return np.r_[data.qpos, data.qvel]


def _measured(states, actions, nominal, frame_skip, name, value, rng):
    """Return s, the effect's value in its unit, X, y and groups as sensors tell them."""
    spread = states.reshape(-1, states.shape[-1]).std(axis=0)
    sigma = NOISE * spread
    seen = states.copy()
    column = next((k for k, channel in enumerate(_channels(nominal)) if f"[{channel}]" in name), None)
    if name.startswith("scale["):
        seen[..., column] *= value
    if name.startswith("bias["):
        value *= sigma[column]
        seen[..., column] += value
    data = mujoco.MjData(nominal)
    predicted = [
        [_stepped(nominal, data, *row, frame_skip) for row in zip(*episode)]
        for episode in zip(seen[:, :-1], actions)
    ]
    change = seen[:, 1:] - predicted
    usable = sigma > 0
    s = float(np.mean((change[..., usable] / sigma[usable]) ** 2))
    noise = rng.standard_t(5, size=seen.shape) * np.sqrt(3 / 5) * sigma
    grid = np.where(usable, sigma / 2, 1.0)
    seen = np.where(usable, np.round((seen + noise) / grid) * grid, seen)
    n_episodes = len(seen)
    X = np.concatenate([seen[:, :-1], actions], axis=2).reshape(n_episodes * N_ROWS, -1)
    y = seen[:, 1:].reshape(n_episodes * N_ROWS, -1)
    return s, value, X, y, np.repeat(np.arange(n_episodes), N_ROWS)


def _arguments():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--seeds", type=int, default=2, help="of each effect")
    parser.add_argument("--n-jobs", type=int, default=2, help="processes")
    return parser.parse_args()


if __name__ == "__main__":
    main()
