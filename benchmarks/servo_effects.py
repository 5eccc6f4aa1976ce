"""What position servos and people do to a robot: lag, play, friction that grows with load, a weight that was put on.

A servo arm like a UR5e, one like an SO-101, a quadruped on its feet and a quadrotor, none of which the engine was made
with; worlds of plain MuJoCo (`worlds/servos.py`), sensors of 1 % noise, and every family of `ALSO` on offer beside
what is offered always. Wanted of ten seeds each: nine named, eight alone; a lag of 5 ms right to 20 %, play of .25 and
1 degree to 25 %, as play or dead zone, a weight to 5 %; friction that grows with load, by the law M4 of an MX-106, not
called dry; and of a hundred clean logs at most two accused::

    python benchmarks/servo_effects.py --cut
    python benchmarks/servo_effects.py --cases "so101 | play"     # see tables.py for the rest
"""

import re

import numpy as np
import tables
from tables import Case, Table
from worlds.hidden import nominal_model
from worlds.robots import make_log
from worlds.servos import ServoWorld

ALSO = (
    *("lag", "lag_torque", "delay", "dead_zone", "backlash", "torque_speed", "scale", "payload"),
    *("stribeck", "load_friction"),
)
N_SEEDS, N_CLEAN = 10, 100
ROWS = 800
LAG, PLAY = 0.005, {"quarter": np.radians(0.25), "degree": np.radians(1.0)}
# A joint of each arm that carries something; one whose motor presses on either flank, as where gravity keeps it on one
# play is an offset; and where weights go: kg, m in the body's frame.
JOINTS = {"servo_arm": ("lift", "elbow", "wrist1"), "so101": ("lift", "elbow", "flex")}
LOOSE = {"servo_arm": ("pan", "elbow", "wrist2"), "so101": ("pan", "lift", "roll")}
# The rest of what servos do, of one joint: sizes in each arm. The large one never comes near its limits.
REST = {
    "zone": ("dead_zone[{}]", {"servo_arm": 0.01, "so101": 0.02}),
    "tires": ("torque_speed[{}]", {"so101": 2.0}),
    "weak": ("force_limit[{}]", {"so101": 0.5}),
    "late": ("delay[{}]", {"servo_arm": 0.01, "so101": 0.01}),
    "sensor": ("lag[qvel.{}]", {"servo_arm": 0.01, "so101": 0.01}),
    "unit": ("scale[ctrl.{}]", {"servo_arm": 0.9, "so101": 0.9}),
    "zero": ("bias[ctrl.{}]", {"servo_arm": 0.03, "so101": 0.03}),
}
WEIGHTS = {
    "servo_arm": ("wrist_3", 1.0, {"y": 0.12}),
    "so101": ("gripper", 0.05, {"x": 0.06}),
    "quadruped_free": ("trunk", 1.0, {"x": -0.1}),
    "quadrotor": ("frame", 0.13, {"x": 0.02}),
}
# Largest error of a size, as a share.
RIGHT = {"lag": 0.2, "lag_torque": 0.2, "play": 0.25, "weight": 0.05, **dict.fromkeys(REST, 0.2)}
# What is said of each kind where it is rightly named.
FAMILIES = {
    "lag": ("lag",),
    "lag_torque": ("lag_torque", "lag"),
    "play": ("backlash", "dead_zone"),
    "load": ("load_friction",),
    "weight": ("payload", "mass"),
    "zone": ("dead_zone", "backlash"),
    **{kind: (name.partition("[")[0],) for kind, (name, _) in REST.items() if kind != "zone"},
    "zero": ("bias", "offset"),
}
# What is part of the same thing: M4 sticks and is viscous, a weight moves the centre of mass, and worlds of torque that
# lags and of play go in finer steps than the model.
PARTS = {
    "load": ("stribeck", "damping"),
    "weight": ("centre_of_mass", "inertia"),
    "lag_torque": ("timestep",),
    "play": ("timestep",),
}


def cases(cut):
    found = []
    for index in range(1 if cut else N_SEEDS):
        for robot in ("so101",) if cut else JOINTS:
            seed = 9700 + index
            found += [
                Case(f"{robot} | lag", seed),
                Case(f"{robot} | lag_torque", seed),
                *(Case(f"{robot} | play | {width}", seed) for width in PLAY),
                Case(f"{robot} | load", seed),
                *(Case(f"{robot} | {kind}", seed) for kind, (_, sizes) in REST.items() if robot in sizes),
            ]
        found += [Case(f"{robot} | weight", 9700 + index) for robot in (("so101",) if cut else WEIGHTS)]
    robots = list(WEIGHTS)
    for index in range(2 if cut else N_CLEAN):
        robot = robots[index % 2 if cut else index % len(robots)]
        found.append(Case(f"{robot} | clean", 9800 + index // len(robots)))
    return found


def truth_of(case):
    """Return what is hidden."""
    robot, kind, *which = case.name.split(" | ")
    if kind == "clean":
        return {}
    if kind == "weight":
        body, mass, place = WEIGHTS[robot]
        return {f"payload[{body}]": mass, **{f"payload[{body}.{axis}]": at for axis, at in place.items()}}
    if kind == "lag":
        return {"lag[all]": LAG}
    joint = (LOOSE if kind == "play" else JOINTS)[robot][case.seed % 3]
    if kind == "play":
        return {f"backlash[{joint}]": PLAY[which[0]]}
    if kind in REST:
        name, sizes = REST[kind]
        return {name.format(joint): sizes[robot]}
    return {f"lag_torque[{joint}]": LAG} if kind == "lag_torque" else {f"mx106[{joint}]": 1.0}


def parts_of(kind):
    """Return the families of what is hidden and of what is part of the same thing."""
    return [*FAMILIES.get(kind, ()), *PARTS.get(kind, ())]


def run(case, parameters):
    robot, kind, *_ = case.name.split(" | ")
    log = make_log(robot, truth_of(case), seed=case.seed, rows=ROWS, build=ServoWorld)
    simulator = tables.simulator_of(log)
    offered = [effect.name for effect in simulator.effects(also=ALSO)]
    answer, _ = tables.ask(
        simulator, log.X, log.y, log.groups, seed=case.seed, parameters={"effects": offered, **parameters}
    )
    model = nominal_model(log.mjcf)
    masses = {model.body(one).name: float(model.body_mass[one]) for one in range(1, model.nbody)}
    return {
        "robot": robot,
        "kind": kind,
        "truth": log.truth,
        "masses": masses,
        "parts": parts_of(kind),
        "n_effects": len(offered),
        **answer,
    }


def said(line):
    """Return the causes that say what is hidden, by name or by an alias: their sizes in its unit."""
    (name, value), *_ = line["truth"].items()
    target = re.search(r"\[(?:ctrl\.)?(.*)\]$", name).group(1)
    found = {}
    for cause in line["causes"]:
        for one in (cause["name"], *(alias for alias, _ in cause["aliases"])):
            family, _, element = one.replace("[ctrl.", "[").rstrip("]").partition("[")
            if family in FAMILIES[line["kind"]] and element == target:
                found[cause["name"]] = _size(line, cause, target)
                break
    return found, value


def _size(line, cause, target):
    family, value = cause["name"].partition("[")[0], cause["value"]
    if family in ("dead_zone", "backlash"):
        # A zone goes as far to either side, play as far as both.
        return value * {"dead_zone": 2, "backlash": 1}[family] / (2 if line["kind"] == "zone" else 1)
    return (value - 1) * line["masses"][target] if family == "mass" else value


def is_named(line):
    """Whether it is said, and as large as it is."""
    found, value = said(line)
    most = RIGHT.get(line["kind"], np.inf)
    return any(abs(one / value - 1) <= most for one in found.values())


def is_alone(line):
    """Whether nothing else is said but what is part of it."""
    found, _ = said(line)
    parts = parts_of(line["kind"])
    beside = [cause["name"] for cause in line["causes"] if cause["name"].partition("[")[0] not in parts]
    return is_named(line) and not [name for name in beside if name not in found]


def report(lines, shown):
    hidden = [line for line in lines if line["kind"] != "clean"]
    for kind in dict.fromkeys((line["robot"], line["case"].partition(" | ")[2]) for line in hidden):
        mine = [line for line in hidden if (line["robot"], line["case"].partition(" | ")[2]) == kind]
        label = ", ".join(kind)
        shown.share(f"{label}: named, of the right size", map(is_named, mine), ">= 9 of 10")
        shown.share("... alone", map(is_alone, mine), ">= 8 of 10")
        if mine[0]["kind"] in RIGHT:
            errors = [abs(size / value - 1) for found, value in map(said, mine) for size in found.values()]
            shown.number("... error of its size, as a share", errors)
    clean = [line for line in lines if line["kind"] == "clean"]
    shown.share("nothing hidden: alarms", [not tables.silent(line) for line in clean], "<= 2 %")


TABLE = Table("servo_effects", cases, run, report)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
