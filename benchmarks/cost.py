"""What a diagnosis costs: seconds, memory, and ratios to peers in the same run.

Wanted on two free cores: Hopper, 1,500 rows, all effects, at most 15 s and 0.3 of what ``mujoco.sysid`` takes with four
parameters given; a six-joint servo arm, 1,500 rows, 30 s; a quadruped with a free base, 1,500 rows, 120 s within 1.5
GB; a wrong or a missing cause at most three times a clean log; positions only at most twice all measured; linear in
rows up to 150,000 within 4 GB; ``quick`` at most 5, 10 and 30 s::

    python benchmarks/cost.py --cut
    python benchmarks/cost.py --cases "two_link | rows"     # see tables.py for the rest

Seconds are of the wall, and mean something on a machine that does nothing else; a line has the load at its start.
Ratios in the report are of processor seconds.
"""

import os

import numpy as np
import tables
from tables import Case, Table
from worlds.robots import make_log

ROWS = (1500, 5000, 15_000, 50_000, 150_000)
HIDDEN = {
    "hopper": {"dry_friction[leg_joint]": 6.0},
    "servo_arm": {"dry_friction[elbow]": 5.0},
    "quadruped_free": {"gain[FL_thigh]": 0.85},
}
# A cause that is hidden and may not be named.
MISSING = {"hopper": "dry_friction", "servo_arm": "dry_friction", "quadruped_free": "gain"}
MOST_SECONDS = {"hopper": 15, "servo_arm": 30, "quadruped_free": 120}
MOST_QUICK = {"hopper": 5, "servo_arm": 10, "quadruped_free": 30}
MOST_MEGABYTES = {"quadruped_free": 1536}


def cases(cut):
    found = []
    robots = ("hopper",) if cut else tuple(HIDDEN)
    for robot in robots:
        for which in ("clean",) if cut else ("clean", "hidden", "missing", "quick"):
            found.append(Case(f"{robot} | {which}", 9500, {"rows": 1500}))
    if not cut:
        found += [Case(f"{robot} | positions", 9500, {"rows": 1500}) for robot in ("servo_arm", "two_link")]
        found.append(Case("two_link | measured", 9500, {"rows": 1500}))
    found += [Case(f"two_link | rows {n}", 9500, {"rows": n}) for n in (ROWS[:1] if cut else ROWS)]
    found.append(Case("hopper | sysid", 9500, {"rows": 300 if cut else 1500}))
    return found


def run(case, parameters):
    robot, which = case.name.split(" | ")
    line = {"robot": robot, "which": which, "load": os.getloadavg()[0], "truth": {}}
    rows = case.settings["rows"]
    if which == "sysid":
        return line | _sysid(rows)
    truth = HIDDEN.get(robot, {}) if which in ("hidden", "missing") else {}
    sensor = "positions" if which == "positions" else "ideal"
    episodes = {"hopper": rows // 50, "two_link": max(1, rows // 1500)}.get(robot)
    log = make_log(robot, truth, sensor=sensor, seed=case.seed, rows=rows, episodes=episodes)
    simulator = tables.simulator_of(log)
    options = {"n_jobs": 2}
    if which == "missing":
        options["effects"] = [e.name for e in simulator.effects() if e.family != MISSING[robot]]
    if which == "quick":
        options["quick"] = True
    answer, _ = tables.ask(
        simulator, log.X, log.y, log.groups, seed=case.seed, parameters={**options, **parameters}
    )
    return {**line, "truth": truth, "n_effects": len(simulator.effects()), "n_rows": rows, **answer}


def _sysid(rows):
    """Return what ``mujoco.sysid`` takes for four parameters of the Hopper."""
    import time

    import sysid_comparison
    from worlds import measure

    log = measure("hopper", [("dry_friction", sysid_comparison.JOINT, 6.0)], seed=9500, n_episodes=rows // 50)
    start = time.process_time()
    found = sysid_comparison.fit_sysid(log, list(sysid_comparison.PARAMETERS), 10)
    return {
        "verdict": "peer",
        "causes": [],
        "seconds": found["seconds"],
        "cpu_seconds": time.process_time() - start,
        "n_rows": rows,
    }


def report(lines, shown):
    by = {(line["robot"], line["which"]): line for line in lines if line["verdict"] != "error"}

    def cpu(*key):
        return by[key]["cpu_seconds"] if key in by else np.nan

    def ratio(label, one, other, wanted):
        shown.number(label, [cpu(*one) / cpu(*other)], wanted)

    for robot, most in MOST_SECONDS.items():
        for which in ("clean", "hidden"):
            shown.number(
                f"{robot}, {which}: seconds", [by.get((robot, which), {}).get("seconds")], f"<= {most}"
            )
        shown.number(
            f"{robot}, quick: seconds",
            [by.get((robot, "quick"), {}).get("seconds")],
            f"<= {MOST_QUICK[robot]}",
        )
        for which in ("hidden", "missing"):
            ratio(f"{robot}: {which} cause over clean", (robot, which), (robot, "clean"), "<= 3")
    for robot, most in MOST_MEGABYTES.items():
        shown.number(
            f"{robot}: megabytes", [by.get((robot, "hidden"), {}).get("peak_megabytes")], f"<= {most}"
        )
    for which in ("clean", "hidden"):
        ratio(f"hopper, {which}: over mujoco.sysid", ("hopper", which), ("hopper", "sysid"), "<= 0.3")
    ratio(
        "servo arm: positions only over measured", ("servo_arm", "positions"), ("servo_arm", "clean"), "<= 2"
    )
    ratio(
        "two-link arm: positions only over measured",
        ("two_link", "positions"),
        ("two_link", "measured"),
        "<= 2",
    )
    per_row = [cpu("two_link", f"rows {n}") / n * 1500 for n in ROWS]
    for n, seconds in zip(ROWS, per_row):
        line = by.get(("two_link", f"rows {n}"), {})
        shown.number(
            f"two-link arm, {n} rows: processor seconds for 1,500", [seconds], "no more than the first"
        )
        shown.number("... megabytes", [line.get("peak_megabytes")], "<= 4096")


TABLE = Table("cost", cases, run, report)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
