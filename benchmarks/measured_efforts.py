"""Arms whose logs hold the efforts that were measured, and not the commands: a controller at 4 kHz, a log at 100 Hz.

The controller feeds back angles and speeds and knows the model's gravity, as those of industrial arms do; what it
answers to friction within a row is in the efforts of the row::

    python benchmarks/measured_efforts.py --cut
    python benchmarks/measured_efforts.py --cases "machine"     # see tables.py for the rest

Asked with ``actions="measured"`` of what every machine has and its model lacks (all frictions, or all and rotors, and
in half of the logs a mass or a torque constant besides), of single causes, and of nothing.
"""

import mujoco
import numpy as np
import tables
from tables import Case, Table
from worlds.hidden import edited_model, nominal_model
from worlds.robots import ROBOTS, Smooth, machine, scales

ROBOT = "torque_arm"
MIXES = {"friction": ("dry_friction", "damping"), "machine": ("dry_friction", "damping", "armature")}
# Rotors, kg m2, that the model has where they are not hidden: friction of a joint without is MuJoCo's alone.
ROTORS = dict(zip(("pan", "lift", "elbow", "wrist1", "wrist2", "wrist3"), (3.5, 3.5, 1.6, 0.3, 0.3, 0.3)))
SINGLE = (
    ("dry_friction[elbow]", 2.0, 8.0),
    ("damping[lift]", 4.0, 20.0),
    ("gain[lift]", 0.7, 0.9),
    ("mass[forearm]", 1.2, 1.6),
    ("mass[wrist_3]", 4.0, 12.0),
    ("armature[elbow]", 0.5, 2.5),
)
BESIDES = (("mass[forearm]", 1.2, 1.6), ("gain[elbow]", 0.75, 0.9))
ROWS, EPISODES, N_SEEDS = 2000, 2, 10
# Time steps of reality, and of the controller, for one of the model's.
FINER = 8
# Of a channel's spread; of an effort's rms; of the filter of a motor's current, s; of feedback, rad/s.
ANGLE_NOISE, EFFORT_NOISE, CURRENT_LAG, BANDWIDTH = 0.001, 0.02, 0.002, 20.0


def cases(cut):
    found = []
    for seed in range(1 if cut else N_SEEDS):
        for mix in MIXES:
            found.append(Case(f"{mix} | {'besides' if seed % 2 else 'alone'}", 9000 + seed))
        for name, *_ in SINGLE[:2] if cut else SINGLE:
            found.append(Case(f"single | {name}", 9000 + seed, {"cause": name}))
        found += [Case(f"clean | {turn}", 9000 + seed) for turn in range(1 if cut else 2)]
    return found


def truth_of(case):
    kind, which = case.name.split(" | ")
    rng = np.random.default_rng([case.seed, sum(case.name.encode()), 20261128])
    if kind == "clean":
        return {}
    if kind == "single":
        _, low, high = next(one for one in SINGLE if one[0] == which)
        return {which: float(rng.uniform(low, high))}
    truth = machine(ROBOT, rng, MIXES[kind])
    if which == "besides":
        name, low, high = BESIDES[rng.integers(len(BESIDES))]
        truth[name] = float(rng.uniform(low, high))
    return truth


def model_of(case):
    """Return the nominal MJCF of a case."""
    text = ROBOTS[ROBOT].text()
    for joint, rotor in ROTORS.items() if not case.name.startswith("machine") else ():
        text = text.replace(f'<joint name="{joint}"', f'<joint name="{joint}" armature="{rotor}"')
    return text


def log_of(text, truth, seed, rows=ROWS, episodes=EPISODES):
    """Return X, y and groups of an arm under a controller that is faster than its log."""
    kind, model, nominal = ROBOTS[ROBOT], edited_model(text, truth), nominal_model(text)
    # Reality has no time steps: those of a simulation move friction by half of one.
    model.opt.timestep /= FINER
    data, helper, nv, h = mujoco.MjData(model), mujoco.MjData(nominal), model.nv, float(model.opt.timestep)
    substeps = FINER * kind.frame_skip
    spread, rms = scales(ROBOT)
    sigma = ANGLE_NOISE * spread
    blend = 1 - np.exp(-h / CURRENT_LAG)
    parts = []
    for episode in range(episodes):
        motion, noises = (np.random.default_rng([seed, episode, stream]) for stream in range(2))
        smooth, amplitude = Smooth(motion, nv, kind.rate), np.array(kind.amplitude)
        angle, rate = (amplitude * one for one in smooth(0.0))
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = kind.centre + angle, rate
        n = rows // episodes
        states, efforts, current = np.empty((n + 1, 2 * nv)), np.empty((n + 1, nv)), None
        for tick in range(n * substeps + 1):
            angle, rate = (amplitude * one for one in smooth(tick * h))
            helper.qpos[:], helper.qvel[:] = data.qpos, 0
            mujoco.mj_forward(nominal, helper)
            inertia = np.zeros((nv, nv))
            mujoco.mj_fullM(nominal, helper, inertia)
            stiff = np.diag(inertia) + model.dof_armature
            error = kind.centre + angle - data.qpos
            torque = helper.qfrc_bias + stiff * (BANDWIDTH**2 * error + 2 * BANDWIDTH * (rate - data.qvel))
            current = torque if current is None else current + blend * (torque - current)
            if tick % substeps == 0:
                states[tick // substeps] = np.r_[data.qpos, data.qvel]
                efforts[tick // substeps] = current
            data.ctrl[:] = torque
            mujoco.mj_step(model, data)
        read = states + sigma * noises.normal(size=states.shape)
        told = efforts + EFFORT_NOISE * rms * noises.normal(size=efforts.shape)
        parts.append((np.column_stack([read[:-1], told[:-1]]), read[1:]))
    X, y = (np.concatenate(part) for part in zip(*parts))
    return X, y, np.repeat(np.arange(episodes), rows // episodes)


def run(case, parameters):
    from skat.simulators import MujocoSimulator

    truth = truth_of(case)
    text = model_of(case)
    simulator = MujocoSimulator(text, frame_skip=ROBOTS[ROBOT].frame_skip)
    X, y, groups = log_of(text, truth, case.seed)
    asked = {"actions": "measured", **(parameters or {})}
    answer, _ = tables.ask(simulator, X, y, groups, seed=case.seed, parameters=asked)
    return {"kind": case.name.split(" | ")[0], "truth": truth, **answer}


def report(lines, shown):
    single, clean, many = (
        [line for line in lines if line["kind"] in kinds] for kinds in (("single",), ("clean",), tuple(MIXES))
    )
    shown.share("single: named, alone", map(tables.alone, single))
    shown.share("... or an alias", map(tables.or_alias, single))
    shown.share("clean: alarms", [not tables.silent(line) for line in clean])
    pairs = [(line, name) for line in many for name in line["truth"]]
    shown.share("many: named", [name in tables.names(line) for line, name in pairs])
    shown.share(
        "... or an alias", [any(tables.covers(one, name) for one in line["causes"]) for line, name in pairs]
    )
    false = [
        not any(tables.covers(cause, name) for name in line["truth"])
        for line in lines
        for cause in line["causes"]
    ]
    shown.share("of what is named: false", false)
    shown.share("intervals that cover", [one for line in lines for one in tables.in_interval(line)])
    shown.share("unexplained", [line["verdict"] == "unexplained" for line in lines])
    shown.probabilities(lines)
    shown.costs(lines)


TABLE = Table("measured_efforts", cases, run, report)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
