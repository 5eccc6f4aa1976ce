"""A stiff servo arm whose commands come late, and a quadruped whose base nobody measures.

Six joints with the gains of users' models of a UR5e and every effect on offer: a delay of one and of two rows, with
white noise of 1 % and with 14-bit encoders. A quadruped on its feet, its free base hidden, one motor 10 % weak, which
is among the effects offered or is not; and the same robot with nothing hidden::

    python benchmarks/servo_arm.py --cut
    python benchmarks/servo_arm.py --cases delay     # see tables.py for the rest
"""

import numpy as np
import tables
from tables import Case, Table
from worlds.robots import actuator_names, make_log, nominal_model

SENSORS = ("ideal", "encoder")
N_DELAYS, N_WEAK, N_CLEAN = 8, 5, 8
WEAK = 0.9


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
    return found


def log_of(case):
    """Return the log of a case and the effects on offer."""
    kind, robot, which, *_ = case.name.split(" | ")
    if kind == "delay":
        return make_log(
            robot, {"delay[action]": 0.01 * case.settings["rows"]}, sensor=which, seed=case.seed
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
    shown.share("intervals that cover", [one for line in lines for one in tables.in_interval(line)])
    shown.probabilities(lines)


TABLE = Table("servo_arm", cases, run, report)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
