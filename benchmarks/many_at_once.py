"""A real robot's first model: everything that joints have is missing from it, a dozen causes and more at once.

A six-joint arm that torques drive, and a quadruped hung up by its base; their models have no friction, no damping and
no rotor inertia. Twelve to thirty causes are hidden together at realistic sizes, and in half of the logs one mass, gain
or delay besides; sensors in turn are ideal, causally low-passed, positions only, an encoder::

    python benchmarks/many_at_once.py --cut       # one log of each robot
    python benchmarks/many_at_once.py             # 20 of each

Of each hidden cause a line says what it is worth in the true model, in nats (`worlds.worth`).
"""

import numpy as np
import tables
from tables import Case, Table
from worlds.hidden import actuator_names, channel_names, nominal_model
from worlds.robots import World, machine, make_log
from worlds.worth import worth

ROBOTS = ("torque_arm", "quadruped_hung")
SENSORS = ("ideal", "lowpass30", "positions", "encoder")
PER_SENSOR = 5
# Families of what every joint lacks, and how many torque constants and encoder offsets beside them.
MIXES = {
    "torque_arm": (
        (("dry_friction", "damping"), 0, 0),
        (("dry_friction", "damping", "armature"), 0, 0),
        (("dry_friction", "damping", "armature"), 3, 0),
        (("dry_friction", "damping", "armature"), 6, 0),
        (("dry_friction", "damping", "armature"), 6, 6),
    ),
    "quadruped_hung": (
        (("dry_friction",), 0, 0),
        (("dry_friction", "damping"), 0, 0),
        (("dry_friction", "armature"), 0, 0),
        (("dry_friction", "armature"), 6, 0),
        (("dry_friction", "damping"), 3, 3),
    ),
}
EXTRA = {
    "torque_arm": ("mass[forearm]", "gain[wrist1]", "delay[action]"),
    "quadruped_hung": ("mass[FR_calf]", "gain[RL_thigh]", "delay[action]"),
}
OPEN_LOOP = 0.25  # s


def cases(cut):
    found = []
    for index in range(1 if cut else PER_SENSOR * len(SENSORS)):
        for robot in ROBOTS:
            sensor = SENSORS[index % len(SENSORS)]
            mix = (index // len(SENSORS) + (1 if cut else 0)) % 5
            # Half of the logs of each sensor and of each mix.
            extra = (index + index // len(SENSORS)) % 2 == 1
            found.append(Case(f"{robot} | {sensor} | mix {mix}{' +' if extra else ''}", 7000 + index))
    return found


def truth_of(case):
    """Return what is hidden in a case, and the name of what is hidden besides (or None)."""
    robot, _, mix = case.name.split(" | ")
    rng = np.random.default_rng([case.seed, sum(robot.encode()), 20240613])
    families, n_gains, n_biases = MIXES[robot][int(mix.split()[1])]
    truth = machine(robot, rng, families)
    model = nominal_model(World(robot).kind.text())
    motors = rng.permutation(actuator_names(model))[:n_gains]
    truth |= {f"gain[{motor}]": float(1 + rng.choice([-1, 1]) * rng.uniform(0.05, 0.15)) for motor in motors}
    angles = rng.permutation(channel_names(model)[: model.nq])[:n_biases]
    truth |= {f"bias[{angle}]": float(rng.choice([-1, 1]) * rng.uniform(0.005, 0.02)) for angle in angles}
    if not mix.endswith("+"):
        return truth, None
    names = [name for name in EXTRA[robot] if name not in truth]
    name = names[rng.integers(len(names))]
    value = {
        "mass": rng.uniform(1.2, 1.8),
        "gain": rng.choice([rng.uniform(0.7, 0.85), rng.uniform(1.15, 1.3)]),
        "delay": rng.uniform(0.5, 2.0) * World(robot).dt,
    }[name.partition("[")[0]]
    return truth | {name: float(value)}, name


def log_of(case):
    """Return the log of a case, and the name of what is hidden besides."""
    robot, sensor, _ = case.name.split(" | ")
    truth, extra = truth_of(case)
    return make_log(robot, truth, sensor=sensor, seed=case.seed), extra


def run(case, parameters):
    log, extra = log_of(case)
    simulator = tables.simulator_of(log)
    answer, diagnosis = tables.ask(simulator, log.X, log.y, log.groups, seed=case.seed, parameters=parameters)
    bounds = {effect.name: effect.bounds for effect in simulator.effects()}
    at_bound = [
        cause["name"]
        for cause in answer["causes"]
        if min(abs(cause["value"] - bound) for bound in bounds[cause["name"]])
        <= 1e-6 * (bounds[cause["name"]][1] - bounds[cause["name"]][0])
    ]
    fresh = make_log(log.robot, log.truth, seed=case.seed + 500_000, rows=300, episodes=1, sensor="ideal")
    line = {
        "robot": log.robot,
        "sensor": log.sensor,
        "truth": log.truth,
        "extra": extra,
        "worth": {name: nats for name, (nats, _) in worth(log).items()},
        "out_of_bounds": [
            name for name, value in log.truth.items() if not bounds[name][0] <= value <= bounds[name][1]
        ],
        "at_bound": at_bound,
        "open_loop_true": open_loop(fresh, None, log.truth),
        **answer,
    }
    if diagnosis is not None:
        line["open_loop"] = open_loop(fresh, diagnosis.extended_simulator_)
        line["open_loop_nominal"] = open_loop(fresh, simulator)
    return line


def open_loop(log, simulator, truth=None):
    """Return the rms distance of paths of 0.25 s from readings, in spreads, each from a reading; of rows not fitted.

    By a simulator, or by plain MuJoCo with ``truth`` in it.
    """
    world = World(log.robot, truth)
    n_states, steps = world.model.nq + world.model.nv, max(2, round(OPEN_LOOP / world.dt))
    starts = np.arange(0, len(log.X) - steps + 1, steps)
    errors = []
    if simulator is None:
        for start in starts:
            world.reset(log.X[start, :n_states])
            path = [world.advance(log.history[start + step]) for step in range(steps)]
            errors.append(np.array(path) - log.y[start : start + steps])
    else:
        # Row by row within the log, whose earlier commands a delay needs.
        X, paths = log.X.copy(), []
        for step in range(steps):
            paths.append(simulator.predict(X, groups=log.groups)[starts + step])
            if step + 1 < steps:
                X[starts + step + 1, :n_states] = paths[-1]
        measured = np.stack([log.y[starts + step] for step in range(steps)])
        errors = np.stack(paths) - measured
    spread = 100 * log.sigma  # sigma is 1 % of it
    return float(np.sqrt(np.mean((np.asarray(errors) / spread) ** 2)))


def report(lines, shown):
    pairs = [(line, name) for line in lines for name, nats in line["worth"].items() if nats > 10]
    named = [any(tables.covers(cause, name) for cause in line["causes"]) for line, name in pairs]
    shown.share("of causes worth more than 10 nats: named or an alias", named, ">= 92 %")
    shown.share("... named", [name in tables.names(line) for line, name in pairs])
    false = [
        not any(tables.covers(cause, name) for name in line["truth"])
        for line in lines
        for cause in line["causes"]
    ]
    shown.share("of what is named: false", false, "<= 4 %")
    shown.share("logs with an estimate at a bound", [line["at_bound"] for line in lines], "none")
    ratios = [line["open_loop"] / line["open_loop_true"] for line in lines if "open_loop" in line]
    shown.share(
        "open loop, held out: at most 1.1 of the true model's", [ratio <= 1.1 for ratio in ratios], "all"
    )
    shown.number("... ratio, median and largest", ratios)
    some = [line for line in lines if line["extra"]]
    found = [any(tables.covers(cause, line["extra"]) for cause in line["causes"]) for line in some]
    shown.share("the mass, gain or delay besides is found", found, ">= 90 %")
    shown.share("intervals that cover", [one for line in lines for one in tables.in_interval(line)])
    shown.share("within three minutes", [line["seconds"] <= 180 for line in lines], "all, on two free cores")
    for robot in ROBOTS:
        for sensor in SENSORS:
            mine = [
                hit
                for (line, _), hit in zip(pairs, named)
                if (line["robot"], line["sensor"]) == (robot, sensor)
            ]
            shown.share(f"... {robot}, {sensor}: named or alias", mine)
    shown.share("truths that the effects' bounds exclude", [line["out_of_bounds"] for line in lines], "none")
    shown.probabilities(lines)


TABLE = Table("many_at_once", cases, run, report)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
