"""Sensors as they are: seven of them on six robots, a cause hidden or none, and velocities measured or computed.

Robots: puck, Hopper, HalfCheetah, a two-link arm, a six-joint servo arm, and the two-link arm under feedback of its own
noisy readings of a row ago. Sensors: ideal with noise of 1 %, central differences, causal low-pass filters of second
order at 10 and 30 % of Nyquist, a zero-phase filter, positions only, a 14-bit encoder with 2 % of the samples lost::

    python benchmarks/sensors.py --cut            # two causes and a clean log of each robot, three sensors
    python benchmarks/sensors.py --cases clean    # see tables.py for the rest
    python benchmarks/sensors.py --cases auto     # what "auto" makes of velocities
"""

import numpy as np
import tables
from tables import Case, Table
from worlds.robots import make_log
from worlds.sensing import COMPUTED, SENSORS

# Robot: its six causes, smallest and largest value. Of a pair of ranges a seed takes one.
CAUSES = {
    "puck": {
        "mass[puck]": ((0.7, 0.85), (1.2, 1.5)),
        "gain[push_x]": ((0.7, 0.85), (1.15, 1.3)),
        "contact_friction[all]": ((0.5, 0.75), (1.3, 2.0)),
        "tilt[x]": ((-0.1, -0.03), (0.03, 0.1)),
        "damping[y]": ((0.3, 1.0),),
        "wind[y]": ((-0.6, -0.2), (0.2, 0.6)),
    },
    "hopper": {
        "mass[torso]": ((0.7, 0.85), (1.2, 1.5)),
        "damping[leg_joint]": ((1.0, 4.0),),
        "dry_friction[leg_joint]": ((4.0, 12.0),),
        "gain[thigh_joint]": ((0.7, 0.85), (1.15, 1.3)),
        "armature[foot_joint]": ((0.3, 1.0),),
        "gravity": ((0.8, 0.9), (1.1, 1.2)),
    },
    "halfcheetah": {
        "mass[torso]": ((0.7, 0.85), (1.2, 1.5)),
        "damping[bthigh]": ((2.0, 6.0),),
        "dry_friction[fthigh]": ((5.0, 15.0),),
        "gain[bshin]": ((0.7, 0.85), (1.15, 1.3)),
        "gain[all]": ((0.8, 0.9), (1.1, 1.2)),
        "stiffness[fshin]": ((20.0, 60.0),),
    },
    "two_link": {
        "mass[lower]": ((0.7, 0.85), (1.2, 1.5)),
        "dry_friction[shoulder]": ((0.06, 0.25),),
        "damping[elbow]": ((0.01, 0.04),),
        "armature[elbow]": ((0.003, 0.01),),
        "gain[elbow]": ((0.7, 0.85), (1.15, 1.3)),
        "delay[action]": ((0.005, 0.015),),
    },
    "servo_arm": {
        "mass[wrist_3]": ((3.0, 8.0),),
        "dry_friction[elbow]": ((3.0, 10.0),),
        "damping[lift]": ((10.0, 40.0),),
        "kp[elbow]": ((0.7, 0.9), (1.1, 1.3)),
        "offset[lift]": ((-0.03, -0.01), (0.01, 0.03)),
        "delay[action]": ((0.008, 0.012),),
    },
    "feedback": {
        "mass[lower]": ((0.7, 0.85), (1.2, 1.5)),
        "dry_friction[elbow]": ((0.05, 0.15),),
        "damping[shoulder]": ((0.03, 0.1),),
        "armature[elbow]": ((0.003, 0.01),),
        "gain[shoulder]": ((0.7, 0.85), (1.15, 1.3)),
        "delay[action]": ((0.005, 0.015),),
    },
}
N_CLEAN, N_AUTO = 300, 600
AUTO_ROWS = 300


def draw(robot, name, seed):
    """Return the value that a seed gives to a cause."""
    rng = np.random.default_rng([seed, sum(robot.encode()), sum(name.encode())])
    ranges = CAUSES[robot][name]
    low, high = ranges[rng.integers(len(ranges))]
    if low > 0:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return float(rng.uniform(low, high))


def cases(cut):
    found = []
    sensors = ("ideal", "lowpass30", "positions") if cut else SENSORS
    for sensor in sensors:
        for robot, causes in CAUSES.items():
            for name in list(causes)[1:3] if cut else causes:
                found.append(Case(f"cause | {robot} | {sensor} | {name}", 1000, {"cause": name}))
    pairs = [(robot, sensor) for robot in CAUSES for sensor in sensors]
    for index in range(len(pairs) if cut else N_CLEAN):
        robot, sensor = pairs[index % len(pairs)]
        found.append(Case(f"clean | {robot} | {sensor}", 2000 + index // len(pairs), {}))
    # Half with measured, half with computed velocities; half of each with a wrong model.
    for index in range(12 if cut else N_AUTO):
        robot = list(CAUSES)[index % 6]
        sensor = "ideal" if index // 6 % 2 else COMPUTED[index // 12 % len(COMPUTED)]
        wrong = list(CAUSES[robot])[index // 24 % 6] if index // 12 % 2 else None
        found.append(Case(f"auto | {robot} | {sensor} | {wrong or 'right'}", 3000 + index, {"cause": wrong}))
    return found


def log_of(case):
    """Return the log of a case."""
    kind, robot, sensor, *_ = case.name.split(" | ")
    name = case.settings.get("cause")
    truth = {name: draw(robot, name, case.seed)} if name else {}
    rows = {"rows": AUTO_ROWS, "episodes": 6 if robot in ("puck", "hopper", "halfcheetah") else 1}
    return make_log(robot, truth, sensor=sensor, seed=case.seed, **(rows if kind == "auto" else {}))


def run(case, parameters):
    kind, robot, sensor, *_ = case.name.split(" | ")
    log = log_of(case)
    simulator = tables.simulator_of(log)
    if kind == "auto":
        # Velocities are judged without the simulation, so that few effects do.
        parameters = {"velocities": "auto", "effects": ["gravity"], "test_size": 0, **parameters}
    answer, _ = tables.ask(simulator, log.X, log.y, log.groups, seed=case.seed, parameters=parameters)
    return {
        "kind": kind,
        "robot": robot,
        "sensor": sensor,
        "truth": log.truth,
        "size": log.size,
        **answer,
    }


def report(lines, shown):
    causes = [line for line in lines if line["kind"] == "cause"]
    clean = [line for line in lines if line["kind"] == "clean"]
    shown.share("clean: alarms", [not tables.silent(line) for line in clean], "<= 2 %")
    shown.share("named or alias, alone", map(tables.or_alias, causes), ">= 92 %")
    shown.share("named, alone", map(tables.alone, causes), ">= 85 %")
    shown.share(
        "intervals that cover", [one for line in causes for one in tables.in_interval(line)], "92 to 98 %"
    )
    for sensor in SENSORS:
        mine = [line for line in causes if line["sensor"] == sensor]
        shown.share(f"... {sensor}: named or alias", map(tables.or_alias, mine))
        alarms = [not tables.silent(line) for line in clean if line["sensor"] == sensor]
        shown.share(f"... {sensor}: alarms", alarms)
    for robot in CAUSES:
        mine = [line for line in causes if line["robot"] == robot]
        shown.share(f"... {robot}: named or alias", map(tables.or_alias, mine))
    auto = [line for line in lines if line["kind"] == "auto"]
    for computed in (False, True):
        mine = [line for line in auto if (line["sensor"] in COMPUTED) == computed]
        word = "computed" if computed else "measured"
        shown.share(
            f'"auto" says {word} of {word}', [line.get("velocities") == word for line in mine], ">= 98 %"
        )
    shown.probabilities(causes + clean)


TABLE = Table("sensors", cases, run, report)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
