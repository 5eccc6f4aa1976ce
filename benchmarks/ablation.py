"""What each constant and rule of the engine is for: every field of `Settings` halved, doubled, off, none left out.

24 causes and 24 clean logs of cheap worlds, the same for all. The fields are those of the frozen dataclass
``skat.diagnosis.settings.Settings``: a number is halved, doubled, and set to 0; one that is infinite or None is set to
1; a flag is turned, a Literal takes its other values; of a tuple of numbers every member is halved and doubled, and its
first and its last member are left out; a mapping or a dataclass is taken apart. A value that `Settings` refuses is told
as such, and one of another kind stops the table. Where neither halving, doubling nor absence changes an answer, the
constant does nothing::

    python benchmarks/ablation.py --cut                  # four logs, the first three fields
    python benchmarks/ablation.py --cases "tolerance "   # one field; see tables.py for the rest

Settings are replaced where the modules of ``skat`` hold the default instance (a module's attribute, the default of a
parameter, or a member of a class that is that instance), for the time of one fit.
"""

import contextlib
import dataclasses
import importlib
import math
import pkgutil
import sys
import types
import typing

import numpy as np
import sensors
import tables
from tables import Case, Table
from worlds.robots import make_log

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


def settings_class():
    """Return the class of settings; an engine without one has none to try."""
    try:
        return importlib.import_module("skat.diagnosis.settings").Settings
    except ModuleNotFoundError as error:
        raise SystemExit(
            "the engine has no skat.diagnosis.settings.Settings, whose fields are what is tried"
        ) from error


def instances():
    """Return the default instances of the settings that the modules of ``skat.diagnosis`` hold."""
    import skat.diagnosis

    kind = settings_class()
    for module in pkgutil.walk_packages(skat.diagnosis.__path__, "skat.diagnosis."):
        importlib.import_module(module.name)
    found = []
    for module in _modules():
        for value in vars(module).values():
            if isinstance(value, kind) and not any(value is one for one in found):
                found.append(value)
    return found or [kind()]


def changes(settings):
    """Return {label: settings} of everything that is tried of each field."""
    found = {}
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        literal = typing.get_type_hints(type(settings))[field.name]
        if typing.get_origin(literal) is typing.Literal:
            tried = [(f"as {other!r}", other) for other in typing.get_args(literal) if other != value]
        else:
            tried = _others(value)
        for word, other in tried:
            found[f"{field.name} {word}"] = (field.name, other)
    return found


def _others(value):
    if isinstance(value, bool):
        return [("turned", not value)]
    if isinstance(value, int | float):
        if math.isinf(value):
            return [("finite", 1.0)]
        # A count stays a count.
        half = value // 2 if isinstance(value, int) else value / 2
        found = [("halved", half), ("doubled", value * 2), ("off", type(value)(0))]
        return [(word, other) for word, other in found if other != value]
    if isinstance(value, tuple):
        found = []
        if len(value) > 1:
            found = [("without its first", value[1:]), ("without its last", value[:-1])]
        if all(isinstance(one, int | float) and not isinstance(one, bool) for one in value):
            found += [
                ("halved", tuple(one / 2 for one in value)),
                ("doubled", tuple(one * 2 for one in value)),
            ]
        return found
    if isinstance(value, dict | types.MappingProxyType):
        numbers = {name: one for name, one in value.items() if isinstance(one, int | float)}
        return [
            (f"{word} at {name}", {**value, name: factor * one})
            for name, one in numbers.items()
            for word, factor in (("halved", 0.5), ("doubled", 2.0))
        ]
    if dataclasses.is_dataclass(value):
        return [
            (f"{inner} {word}", dataclasses.replace(value, **{inner: other}))
            for inner in (field.name for field in dataclasses.fields(value))
            for word, other in _others(getattr(value, inner))
        ]
    if value is None:
        return [("one", 1.0)]
    raise TypeError(f"no rule says how to try another value than {value!r}")


@contextlib.contextmanager
def replaced(old, new):
    """Have every module of ``skat`` use other settings: attributes, defaults of parameters, members of classes."""
    undo = []

    def put(owner, name, value):
        undo.append((owner, name, getattr(owner, name)))
        setattr(owner, name, value)

    def swap(values):
        return tuple(new if one is old else one for one in values)

    def visit(function):
        if function.__defaults__ and any(one is old for one in function.__defaults__):
            put(function, "__defaults__", swap(function.__defaults__))
        if function.__kwdefaults__ and any(one is old for one in function.__kwdefaults__.values()):
            given = function.__kwdefaults__
            put(function, "__kwdefaults__", {k: new if one is old else one for k, one in given.items()})

    for module in _modules():
        for name, value in list(vars(module).items()):
            if value is old:
                put(module, name, new)
            elif isinstance(value, types.FunctionType) and value.__module__ == module.__name__:
                visit(value)
            elif isinstance(value, type) and value.__module__ == module.__name__:
                for inner, member in list(vars(value).items()):
                    if member is old:
                        put(value, inner, new)
                    elif isinstance(member, types.FunctionType):
                        visit(member)
    if not undo:
        raise RuntimeError("no module of skat holds these settings, so that nothing would change")
    try:
        yield
    finally:
        for owner, name, value in reversed(undo):
            setattr(owner, name, value)


def _modules():
    return [
        module for name, module in list(sys.modules.items()) if name.partition(".")[0] == "skat" and module
    ]


def cases(cut):
    """Return a case for each change and log: "as it is" first."""
    settings = instances()
    if len(settings) != 1:
        raise SystemExit(f"expected one instance of Settings in skat.diagnosis; there are {len(settings)}")
    labels = list(changes(settings[0]))
    if cut:
        fields = [field.name for field in dataclasses.fields(settings[0])][:3]
        labels = [label for label in labels if label.split()[0] in fields]
    return [
        Case(f"{label} | {name}", seed, {"label": label, "log": [robot, sensor, rows, cause]})
        for label in ["as it is", *labels]
        for name, robot, sensor, rows, cause, seed in logs(cut)
    ]


def run(case, parameters):
    (default,) = instances()
    robot, sensor, rows, cause = case.settings["log"]
    truth = {cause: sensors.draw(robot, cause, case.seed)} if cause else {}
    log = make_log(
        robot, truth, sensor=sensor, seed=case.seed, rows=rows, episodes=rows // 50 if robot == "puck" else 1
    )
    line = {"label": case.settings["label"], "log": case.name.split(" | ")[1], "truth": truth}
    simulator = tables.simulator_of(log)

    def asked():
        answer, _ = tables.ask(simulator, log.X, log.y, log.groups, seed=case.seed, parameters=parameters)
        return {**line, **answer}

    if case.settings["label"] == "as it is":
        return asked()
    name, value = changes(default)[case.settings["label"]]
    try:
        other = dataclasses.replace(default, **{name: value})
    except (TypeError, ValueError) as error:
        return {**line, "verdict": "refused", "causes": [], "error": f"Settings refuses it: {error}"}
    with replaced(default, other):
        return asked()


def report(lines, shown):
    def key(line):
        return f"{line['log']} #{line['seed']}"

    base = {key(line): line for line in lines if line["label"] == "as it is"}
    hits = [tables.or_alias(line) for line in base.values() if line["truth"]]
    alarms = [not tables.silent(line) for line in base.values() if not line["truth"]]
    shown.share("as it is: named or alias", hits)
    shown.share("as it is: alarms", alarms, "few")
    fields = {}
    for label in dict.fromkeys(line["label"] for line in lines if line["label"] != "as it is"):
        mine = [line for line in lines if line["label"] == label and key(line) in base]
        if mine and mine[0]["verdict"] == "refused":
            shown.table.add_row(label, "refused", "", str(len(mine)), "")
            continue
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
        fields.setdefault(label.split()[0], []).append(any(changed))
    idle = [name for name, flags in fields.items() if not any(flags)]
    shown.table.add_row(
        "fields that change nothing", ", ".join(idle) or "none", "", f"{len(idle)} of {len(fields)}", "none"
    )


def _answer(line):
    return line["verdict"], tuple(tables.names(line))


TABLE = Table("ablation", cases, run, report)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
