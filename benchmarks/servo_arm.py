"""A stiff servo arm whose commands come late, and a quadruped whose base nobody measures.

Six joints with the gains of users' models of a UR5e and every effect on offer: a delay of one and of two rows, with
white noise of 1 % and with 14-bit encoders. A quadruped on its feet, its free base hidden, one motor 10 % weak, which
is among the effects offered or is not; and the same robot with nothing hidden. A bench: dry friction in all six
joints and a link that is 10 % heavier, read by 14-bit encoders, thirty seconds at 100 and at 15 Hz::

    python benchmarks/servo_arm.py --cut
    python benchmarks/servo_arm.py --cases delay     # see tables.py for the rest
"""

import mujoco
import numpy as np
import tables
from tables import Case, Table
from worlds.hidden import actuator_names, nominal_model
from worlds.robots import make_log

SENSORS = ("ideal", "encoder")
N_DELAYS, N_WEAK, N_CLEAN = 8, 5, 8
WEAK = 0.9
BENCH = {"servo_arm": "100 Hz", "servo_arm_15hz": "15 Hz"}
N_BENCH, ROWS_OF_BENCH = 3, {"servo_arm": 3000, "servo_arm_15hz": 450}
# Of each joint, N m, about; of one link.
FRICTION, HEAVIER = (6.0, 6.0, 5.0, 1.5, 1.4, 1.2), 1.1


def cases(cut):
    found = []
    for index in range(1 if cut else N_DELAYS):
        for rows in (1, 2):
            for sensor in SENSORS:
                found.append(
                    Case(f"delay | servo_arm | {sensor} | {rows} rows", 8000 + index, {"rows": rows})
                )
    for index in range(1 if cut else N_WEAK):
        for offered in (True, False):
            found.append(
                Case(f"weak | quadruped_free | {'offered' if offered else 'not offered'}", 8100 + index)
            )
        found.append(Case("weak | quadruped_free | healthy", 8200 + index))
    for index in range(1 if cut else N_CLEAN):
        for sensor in SENSORS:
            found.append(Case(f"clean | servo_arm | {sensor}", 8300 + index))
    for index in range(1 if cut else N_BENCH):
        found += [Case(f"bench | {robot} | {rate}", 8400 + index) for robot, rate in BENCH.items()]
    return found


def log_of(case):
    """Return the log of a case and the effects on offer."""
    kind, robot, which, *_ = case.name.split(" | ")
    if kind == "delay":
        return make_log(
            robot, {"delay[action]": 0.01 * case.settings["rows"]}, sensor=which, seed=case.seed
        ), "all"
    if kind == "bench":
        return make_log(
            robot,
            bench(robot, case.seed),
            sensor="encoder",
            seed=case.seed,
            rows=ROWS_OF_BENCH[robot],
            episodes=1,
        ), "all"
    if kind == "clean":
        return make_log(robot, sensor=which, seed=case.seed), "all"
    from skat.simulators import MujocoSimulator

    rng = np.random.default_rng([case.seed, 20240614])
    text = make_log(robot, seed=case.seed, rows=8, episodes=1).mjcf
    motor = actuator_names(nominal_model(text))[rng.integers(12)]
    truth = {} if which == "healthy" else {f"gain[{motor}]": WEAK}
    effects = "all"
    if which == "not offered":
        kept = MujocoSimulator(text, frame_skip=5).effects()
        # What the motor's force is multiplied with, in any name.
        effects = [
            e.name for e in kept if e.target not in (motor, "all") or e.family not in ("gain", "kp", "kv")
        ]
    return make_log(robot, truth, seed=case.seed), effects


def bench(robot, seed):
    """Return a friction of each joint and a link that is too heavy."""
    rng = np.random.default_rng([seed, 20261126])
    model = nominal_model(make_log(robot, seed=0, rows=8, episodes=1).mjcf)
    joints, bodies = (
        [mujoco.mj_id2name(model, kind, one) for one in range(start, count)]
        for kind, start, count in (
            (mujoco.mjtObj.mjOBJ_JOINT, 0, model.njnt),
            (mujoco.mjtObj.mjOBJ_BODY, 1, model.nbody),
        )
    )
    truth = {
        f"dry_friction[{name}]": size * rng.uniform(0.7, 1.3)
        for name, size in zip(joints, FRICTION, strict=True)
    }
    # The upper arm or the forearm: what is beyond weighs little.
    heavy = sorted(bodies, key=lambda name: -model.body(name).mass[0])[rng.integers(2)]
    return {**truth, f"mass[{heavy}]": HEAVIER}


def hide_base(simulator, log):
    """Return X and y with the free base not measured."""
    X, y = log.X.copy(), log.y.copy()
    columns = [i for i, name in enumerate(simulator.state_names) if name.split(".")[1] == "root"]
    X[:, columns] = y[:, columns] = np.nan
    return X, y


def run(case, parameters):
    kind, _, which, *_ = case.name.split(" | ")
    log, effects = log_of(case)
    simulator = tables.simulator_of(log)
    X, y = hide_base(simulator, log) if kind == "weak" else (log.X, log.y)
    if effects != "all":
        parameters = {"effects": effects, **parameters}
    answer, _ = tables.ask(simulator, X, y, log.groups, seed=case.seed, parameters=parameters)
    return {"kind": kind, "which": which, "truth": log.truth, "n_effects": len(simulator.effects()), **answer}


def told(line, name):
    """Return the value of a cause, None where it is not named."""
    return next((cause["value"] for cause in line["causes"] if cause["name"] == name), None)


def heavier(line):
    """Whether the weight that is off was told: its mass by at least 90 % of it, or as an alias."""
    (name,) = (one for one in line["truth"] if one.startswith("mass"))
    value = told(line, name)
    if value is not None:
        return value - 1 >= 0.9 * (HEAVIER - 1)
    return any(name in [alias for alias, _ in cause["aliases"]] for cause in line["causes"])


def beside(line):
    """Return the names that are neither a truth nor have one as an alias."""
    return [
        cause["name"]
        for cause in line["causes"]
        if not {cause["name"], *(alias for alias, _ in cause["aliases"])} & line["truth"].keys()
    ]


def report(lines, shown):
    for rows in (1, 2):
        for sensor in SENSORS:
            mine = [x for x in lines if x["case"] == f"delay | servo_arm | {sensor} | {rows} rows"]
            shown.share(f"a delay of {rows} rows named alone, {sensor}", map(tables.alone, mine), "8 of 8")
    clean = [line for line in lines if line["kind"] == "clean"]
    shown.share("servo arm, nothing hidden: alarms", [not tables.silent(x) for x in clean], "none")
    by = {which: [x for x in lines if x["which"] == which] for which in ("offered", "not offered", "healthy")}
    shown.share("weak motor, base hidden: named", map(tables.or_alias, by["offered"]), "5 of 5")
    shown.share(
        "... not among the effects: unexplained",
        [x["verdict"] == "unexplained" for x in by["not offered"]],
        "5 of 5",
    )
    shown.share("... no motor weak: alarms", [not tables.silent(x) for x in by["healthy"]], "none")
    for rate in BENCH.values():
        mine = [line for line in lines if line["kind"] == "bench" and line["which"] == rate]
        frictions = [
            (name, value, line)
            for line in mine
            for name, value in line["truth"].items()
            if name.startswith("dry_friction")
        ]
        found = [(told(line, name), value) for name, value, line in frictions]
        shown.share(f"bench, {rate}: friction of a joint named", [one is not None for one, _ in found], "all")
        shown.number(
            "... mean error of a friction, as a share",
            [abs(one / value - 1) for one, value in found if one is not None],
            "mean .10" if rate == "15 Hz" else "",
        )
        shown.share(
            "... weight: at least 90 % of what is off, or an alias",
            [heavier(line) for line in mine],
            "all",
        )
        shown.number("... names beside", [float(len(beside(line))) for line in mine])
    shown.share("intervals that cover", [one for line in lines for one in tables.in_interval(line)])
    shown.probabilities(lines)


TABLE = Table("servo_arm", cases, run, report)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
