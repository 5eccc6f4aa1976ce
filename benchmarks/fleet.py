"""A fleet: 200 logs, 20 of them of a machine in which something changed; how many names are false, how many are found.

Cart-poles in plain MuJoCo (`worlds/`), two seconds each, whose sensors have noise of 1 %. Wanted over 20
repeats: at most 5 % of what holds is false, and of the 20 at least 18 are found. A repeat that is interrupted goes on
where it was::

    python benchmarks/fleet.py --limit 1       # one repeat, 200 logs: see tables.py for the rest
    python benchmarks/fleet.py --report
"""

import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
import tables
from tables import Case, Table
from worlds.robots import make_log, size_of

from skat.fleet import diagnose_many

N_REPEATS, N_LOGS, N_CHANGED = 20, 200, 20
ROWS, EPISODES = 100, 2
# What changes, with its neutral value and the first of sizes that are tried.
CHANGES = {
    "mass[cart]": (1.0, 0.1),
    "mass[pole]": (1.0, 0.1),
    "gain[push]": (1.0, -0.05),
    "damping[slider]": (0.0, 0.1),
    "dry_friction[slider]": (0.0, 0.1),
    "damping[hinge]": (0.0, 0.005),
    "armature[slider]": (0.0, 0.1),
}
# A change is as large as moves the next row by half of its noise, about (`worlds.robots.size_of`): grown until then.
SHOWN, GROWTH = 0.3, 1.25


def cases(cut):
    return [Case("cart_pole", 9900 + index) for index in range(1 if cut else N_REPEATS)]


def logs_of(case):
    """Return the logs, in most of which nothing is hidden."""
    rng = np.random.default_rng([case.seed, 1])
    changed = dict(zip(rng.permutation(N_LOGS)[:N_CHANGED].tolist(), rng.choice(list(CHANGES), N_CHANGED)))
    logs = []
    for at in range(N_LOGS):
        make = partial(make_log, case.name, seed=1000 * case.seed + at, rows=ROWS, episodes=EPISODES)
        if at not in changed:
            logs.append(make({}))
            continue
        name = str(changed[at])
        neutral, size = CHANGES[name]
        while size_of(log := make({name: neutral + size}), ()) < SHOWN:
            size *= GROWTH
        logs.append(log)
    return logs


def run(case, parameters):
    logs = logs_of(case)
    truths = [log.truth for log in logs]
    begun, used = time.perf_counter(), time.process_time()
    fleet = diagnose_many(
        [(log.X, log.y, log.groups) for log in logs],
        tables.simulator_of(logs[0]),
        names=[str(at) for at in range(N_LOGS)],
        store=Path(tempfile.gettempdir()) / f"skat-fleet-{case.seed}",
        **parameters,
    )
    held = fleet.table[fleet.table["held"]]
    named = [
        (int(row["log"]), sorted({row["cause"], *row["aliases"].split(", ")} - {""}))
        for row in held.to_dict("records")
    ]
    found = {at for at, names in named if truths[at].keys() & set(names)}
    return {
        "robot": case.name,
        "truth": {},
        "changes": {str(at): truth for at, truth in enumerate(truths) if truth},
        "verdict": f"{len(found)} of {N_CHANGED} changes found, {len(named)} causes hold",
        "causes": [],
        "held": named,
        "n_found": len(found),
        "n_failed": int(fleet.table["error"].notna().sum()),
        "seconds": time.perf_counter() - begun,
        "cpu_seconds": time.process_time() - used,
    }


def report(lines, shown):
    right = [
        set(line["changes"].get(str(at), ())) & set(names) for line in lines for at, names in line["held"]
    ]
    shown.share("false among what holds", [not one for one in right], "<= 5 %")
    shown.share(
        "changes found", [at < line["n_found"] for line in lines for at in range(N_CHANGED)], ">= 90 %"
    )
    shown.share(
        "logs without an answer", [at < line["n_failed"] for line in lines for at in range(N_LOGS)], "0 %"
    )


if __name__ == "__main__":
    tables.main(Table("fleet", cases, run, report), __doc__)
