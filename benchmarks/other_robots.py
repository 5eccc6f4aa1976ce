"""Hide effects in robots that no part of the engine was made with, diagnose each, and print what was named.

Gymnasium's Walker2d, Swimmer, InvertedPendulum, InvertedDoublePendulum, Reacher and Pusher, simulated by plain MuJoCo;
an effect is a raw edit of the compiled model. Sensors have Student-t noise of 1 % of each channel's spread, rounded to
half of that. A size s is the mean squared change of the next state by the effect, in variances of the noise::

    python benchmarks/other_robots.py                      # two seeds of every effect in every robot
    python benchmarks/other_robots.py --cases swimmer      # some of them; see tables.py for the rest
"""

from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import tables
from tables import Case, Table

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
N_SEEDS = 2
VISIBLE = 0.1


def cases(cut):
    return [
        Case(f"{robot} | {family}", seed)
        for seed in range(1 if cut else N_SEEDS)
        for robot in (list(ROBOTS)[:2] if cut else ROBOTS)
        for family in FAMILIES
    ]


def log_of(case):
    """Return the user's model and frame skip, name and value of what is hidden, its s, and X, y and groups."""
    robot, family = case.name.split(" | ")
    file, frame_skip, n_episodes = ROBOTS[robot]
    rng = np.random.default_rng([case.seed, FAMILIES.index(family), list(ROBOTS).index(robot)])
    nominal = mujoco.MjModel.from_xml_path(str(ASSETS / file))
    model = mujoco.MjModel.from_xml_path(str(ASSETS / file))
    name, value = _edited(model, family, rng)
    states, actions = _episodes(model, frame_skip, n_episodes, rng)
    s, value, X, y, groups = _measured(states, actions, nominal, frame_skip, name, value, rng)
    return ASSETS / file, frame_skip, name, value, s, X, y, groups


def run(case, parameters):
    from skat.simulators import MujocoSimulator

    file, frame_skip, name, value, s, X, y, groups = log_of(case)
    simulator = MujocoSimulator(file, frame_skip=frame_skip)
    answer, _ = tables.ask(simulator, X, y, groups, seed=case.seed, parameters=parameters)
    truth = {} if value is None else {name: value}
    which = "nothing hidden" if value is None else f"s >= {VISIBLE}" if s >= VISIBLE else f"s < {VISIBLE}"
    if truth and name not in {effect.name for effect in simulator.effects()}:
        which = "not in the list"
    return {"which": which, "size": s, "truth": truth, **answer, "told": _told(truth, answer)}


def _told(truth, answer):
    """Return right, alias, unexplained, nothing, false or error."""
    if answer["verdict"] in ("nothing detected", "unexplained", "error"):
        return answer["verdict"].removesuffix(" detected")
    line = {"truth": truth, **answer}
    if truth and tables.alone(line):
        return "right"
    return "alias" if truth and tables.or_alias(line) else "false"


def report(lines, shown):
    for which in ("nothing hidden", f"s >= {VISIBLE}", f"s < {VISIBLE}", "not in the list"):
        mine = [line for line in lines if line["which"] == which]
        for told in ("right", "alias", "nothing", "unexplained", "false", "error"):
            if any(line["told"] == told for line in mine):
                shown.share(f"{which}: {told}", [line["told"] == told for line in mine])
    shown.share("intervals that cover", [one for line in lines for one in tables.in_interval(line)])
    shown.probabilities(lines)


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


TABLE = Table("other_robots", cases, run, report)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
