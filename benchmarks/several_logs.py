"""Three logs of one robot, on motions of their own and measured well, less well and badly: fitted together.

A cause is hidden in all three, or in one of them, or none is::

    python benchmarks/several_logs.py --cut
    python benchmarks/several_logs.py --cases one     # see tables.py for the rest

Asked is whether a shared cause is named and its interval covers, whether the noise of each log is right, and how often
logs are said not to agree: of a robot that stayed the same, and of one that did not.
"""

import numpy as np
import sensors
import tables
from tables import Case, Table
from worlds.robots import NOISE, make_log

ROBOTS = ("two_link", "feedback")
# Noise of each log over that of the table of sensors.
NOISES = (0.3, 1.0, 5.0)
ROWS, EPISODES = 300, 3
N_SEEDS = 8


def cases(cut):
    found = []
    for seed in range(1 if cut else N_SEEDS):
        for robot in ROBOTS[:1] if cut else ROBOTS:
            for name in list(sensors.CAUSES[robot])[1:3] if cut else sensors.CAUSES[robot]:
                for kind in ("all", "one"):
                    found.append(Case(f"{kind} | {robot} | {name}", 6000 + seed, {"cause": name}))
            for turn in range(1 if cut else 6):
                found.append(Case(f"clean | {robot} | {turn}", 6000 + seed, {"turn": turn}))
    return found


def run(case, parameters):
    kind, robot, *_ = case.name.split(" | ")
    name = case.settings.get("cause")
    truth = {name: sensors.draw(robot, name, case.seed)} if name else {}
    logs = [
        make_log(
            robot,
            truth if kind == "all" or number == 1 else {},
            seed=[case.seed, case.settings.get("turn", 0), number, sum(case.name.encode())],
            rows=ROWS,
            episodes=EPISODES,
            noise=NOISE * noise,
        )
        for number, noise in enumerate(NOISES)
    ]
    rows = [(log.X, log.y, log.groups) for log in logs]
    answer, diagnosis = tables.ask(
        tables.simulator_of(logs[0]), rows, None, None, seed=case.seed, parameters=parameters
    )
    line = {"kind": kind, "robot": robot, "truth": truth, "size": logs[1].size, **answer}
    if diagnosis is not None:
        true = np.stack([np.asarray(log.sigma, float) for log in logs])
        line["noise_ratios"] = (diagnosis.noise_of_logs_.to_numpy() / true).round(4).tolist()
        line["apart"] = diagnosis.agreement_.loc[
            diagnosis.agreement_["agreement"] == "differ", "cause"
        ].tolist()
        line["p_values"] = dict(zip(diagnosis.agreement_["cause"], diagnosis.agreement_["p_value"]))
    return line


def report(lines, shown):
    every, one, clean = ([line for line in lines if line["kind"] == kind] for kind in ("all", "one", "clean"))
    shown.share("in all: named, alone", map(tables.alone, every))
    shown.share("... or an alias", map(tables.or_alias, every))
    shown.share("intervals that cover", [hit for line in every for hit in tables.in_interval(line)])
    shown.share("in all, or in none: said not to agree", [bool(line.get("apart")) for line in every + clean])
    shown.share("clean: alarms", [not tables.silent(line) for line in clean])
    shown.share("in one: said not to agree", [bool(line.get("apart")) for line in one])
    shown.share("... on the cause itself", [set(line["truth"]) & set(line.get("apart", ())) for line in one])
    shown.share("... or unexplained", [line["verdict"] == "unexplained" for line in one])
    for number, noise in enumerate(NOISES):
        ratios = [ratio for line in lines if "noise_ratios" in line for ratio in line["noise_ratios"][number]]
        shown.number(f"noise of {noise:g}: found over true", [one for one in ratios if np.isfinite(one)])
    shown.probabilities(every + clean)


TABLE = Table("several_logs", cases, run, report)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
