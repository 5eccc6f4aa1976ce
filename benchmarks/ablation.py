"""What each constant of the engine is for: halved, doubled, off, one of a tuple left out.

24 causes and 24 clean logs of cheap worlds, the same for all. The constants are the numbers, and tuples of numbers, in
capitals at the top of the modules in `ENGINE`: a number is halved, doubled, and set to 0; one that is infinite is set
to 1; of a tuple every member is halved and doubled, and its first and its last member are left out. Where neither
halving, doubling nor absence changes an answer, the constant does nothing::

    python benchmarks/ablation.py --cut                        # four logs, the first three constants
    python benchmarks/ablation.py --cases "causes.LIVE "       # one constant; see tables.py for the rest

A constant is replaced in every module that has it from the one that defines it, for the time of one fit. Some values
are none that the engine can work with, and end in an error, which is told as an answer.
"""

import ast
import contextlib
import importlib
import inspect
import math
import sys

import numpy as np
import sensors
import tables
from tables import Case, Table
from worlds.robots import make_log

# Modules of ``skat.diagnosis`` that decide; what only draws or words a finding is not tried.
ENGINE = (
    "estimator",
    "log",
    "velocities",
    "statespace",
    "noise",
    "fitting",
    "evidence",
    "search",
    "fits",
    "causes",
    "prediction",
    "remainder",
)
# Cheap robots and sensors: (robot, sensor, rows).
WORLDS = (
    ("two_link", "ideal", 400),
    ("two_link", "lowpass30", 400),
    ("puck", "ideal", 500),
    ("feedback", "positions", 400),
)
N_EACH = 6  # of each world, with a cause and without


def logs(cut):
    """Return (name, robot, sensor, rows, cause or None, seed) of 24 causes and 24 clean logs."""
    found = []
    for robot, sensor, rows in WORLDS[:1] if cut else WORLDS:
        names = list(sensors.CAUSES[robot])
        for index in range(2 if cut else N_EACH):
            found.append(
                (f"{robot} {sensor} {names[index]}", robot, sensor, rows, names[index], 9700 + index)
            )
            found.append((f"{robot} {sensor} clean", robot, sensor, rows, None, 9800 + index))
    return found


def constants():
    """Return the constants of the engine: (module, name) to value, in the order of the sources."""
    found = {}
    for short in ENGINE:
        module = importlib.import_module(f"skat.diagnosis.{short}")
        for name in assigned(inspect.getsource(module)):
            if _is_tried(getattr(module, name)):
                found[short, name] = getattr(module, name)
    return found


def assigned(source):
    """Return the names in capitals that a source assigns at its top."""
    targets = [
        target for node in ast.parse(source).body if isinstance(node, ast.Assign) for target in node.targets
    ]
    return [
        name.id
        for target in targets
        for name in ast.walk(target)
        if isinstance(name, ast.Name) and name.id.isupper()
    ]


def _is_tried(value):
    members = value if isinstance(value, tuple) else (value,)
    return all(isinstance(one, int | float) and not isinstance(one, bool) for one in members)


def changes(found):
    """Return what is tried: a label to (module, name, other value)."""
    return {
        f"{module}.{name} {word}": (module, name, other)
        for (module, name), value in found.items()
        for word, other in _others(value)
    }


def _others(value):
    if isinstance(value, tuple):
        tried = [
            ("halved", tuple(one / 2 for one in value)),
            ("doubled", tuple(one * 2 for one in value)),
        ]
        return tried + (
            [("without its first", value[1:]), ("without its last", value[:-1])] if len(value) > 1 else []
        )
    if math.isinf(value):
        return [("finite", 1.0)]
    # A count stays a count.
    half = value // 2 if isinstance(value, int) else value / 2
    found = [("halved", half), ("doubled", value * 2), ("off", type(value)(0))]
    return [(word, other) for word, other in found if other != value]


@contextlib.contextmanager
def replaced(module, name, other):
    """Have the module ``skat.diagnosis.<module>``, and all that take the constant from it, use another value."""
    owner = f"skat.diagnosis.{module}"
    holders = [sys.modules[owner], *(one for one in _modules() if name in _taken(one, owner))]
    before = getattr(sys.modules[owner], name)
    for holder in holders:
        setattr(holder, name, other)
    try:
        yield
    finally:
        for holder in holders:
            setattr(holder, name, before)


def _modules():
    return [
        one
        for name, one in list(sys.modules.items())
        if name.startswith("skat.") and hasattr(one, "__file__")
    ]


def _taken(module, owner):
    """Return the names that a module imports from another one."""
    return {
        name.name
        for node in ast.parse(inspect.getsource(module)).body
        if isinstance(node, ast.ImportFrom) and node.module == owner
        for name in node.names
    }


def cases(cut):
    """Return a case for each change and log: "as it is" first."""
    found = constants()
    labels = list(changes(dict(list(found.items())[:3]) if cut else found))
    return [
        Case(f"{label} | {name}", seed, {"label": label, "log": [robot, sensor, rows, cause]})
        for label in ["as it is", *labels]
        for name, robot, sensor, rows, cause, seed in logs(cut)
    ]


def run(case, parameters):
    robot, sensor, rows, cause = case.settings["log"]
    truth = {cause: sensors.draw(robot, cause, case.seed)} if cause else {}
    log = make_log(
        robot, truth, sensor=sensor, seed=case.seed, rows=rows, episodes=rows // 50 if robot == "puck" else 1
    )
    label = case.settings["label"]
    change = contextlib.nullcontext() if label == "as it is" else replaced(*changes(constants())[label])
    with change:
        answer, _ = tables.ask(
            tables.simulator_of(log), log.X, log.y, log.groups, seed=case.seed, parameters=parameters
        )
    return {"label": label, "log": case.name.split(" | ")[1], "truth": truth, **answer}


def report(lines, shown):
    def key(line):
        return f"{line['log']} #{line['seed']}"

    base = {key(line): line for line in lines if line["label"] == "as it is"}
    hits = [tables.or_alias(line) for line in base.values() if line["truth"]]
    alarms = [not tables.silent(line) for line in base.values() if not line["truth"]]
    shown.share("as it is: named or alias", hits)
    shown.share("as it is: alarms", alarms, "few")
    constants_tried = {}
    for label in dict.fromkeys(line["label"] for line in lines if line["label"] != "as it is"):
        mine = [line for line in lines if line["label"] == label and key(line) in base]
        changed = [_answer(line) != _answer(base[key(line)]) for line in mine]
        right = [tables.or_alias(line) for line in mine if line["truth"]]
        wrong = [not tables.silent(line) for line in mine if not line["truth"]]
        before = [base[key(line)]["cpu_seconds"] for line in mine]
        time = np.sum([line["cpu_seconds"] for line in mine]) / max(np.sum(before), 1e-9)
        shown.table.add_row(
            label,
            f"named {sum(right)} of {len(right)}, alarms {sum(wrong)} of {len(wrong)}",
            f"time x {time:.2f}",
            f"{sum(changed)} of {len(changed)} differ",
            "" if any(changed) else "does nothing",
        )
        constants_tried.setdefault(label.split()[0], []).append(any(changed))
    idle = [name for name, flags in constants_tried.items() if not any(flags)]
    shown.table.add_row(
        "constants that change nothing",
        ", ".join(idle) or "none",
        "",
        f"{len(idle)} of {len(constants_tried)}",
        "none",
    )


def _answer(line):
    return line["verdict"], tuple(tables.names(line))


TABLE = Table("ablation", cases, run, report)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
