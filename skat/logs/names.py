"""What the name of a column says: which quantity, of which joint, in which unit."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from skat.logs.streams import ELEMENT

POSITION = {"qpos", "q", "pos", "position", "positions", "angle", "angles", "theta", "ang"}
VELOCITY = {
    "qvel",
    "v",
    "qd",
    "dq",
    "qdot",
    "vel",
    "velocity",
    "velocities",
    "speed",
    "speeds",
    "rate",
    "omega",
    "thetadot",
}
EFFORT = {"tau", "torque", "torques", "effort", "efforts", "force", "current", "currents"}
COMMAND = {
    *(
        "ctrl",
        "control",
        "controls",
        "cmd",
        "command",
        "commands",
        "commanded",
        "action",
        "actions",
        "target",
        "targets",
    ),
    *("desired", "des", "ref", "reference", "setpoint", "setpoints", "goal", "u", "con"),
}
OTHER = {
    "acc",
    "acceleration",
    "accelerations",
    "error",
    "errors",
    "std",
    "temperature",
    "voltage",
    "qacc",
    "fric",
}
STATE = {"state", "states", "obs", "observation", "observations"}
FILLER = {
    *(
        "joint",
        "joints",
        "robot",
        "sensor",
        "feedback",
        "data",
        "msg",
        "value",
        "values",
        "motor",
        "motors",
        "servo",
        "dof",
        "dofs",
    ),
    *(
        "measured",
        "meas",
        "actual",
        "present",
        "filt",
        "filtered",
        "raw",
        "store",
        "actuator",
        "link",
        "controller",
    ),
    *("trajectory", "group", "float64", "infos", "info", "measurement", "log"),
    *STATE,
}
# Of several columns for one channel: what was measured comes before what was filtered.
SECOND_CHOICE = {"filt", "filtered", "raw"}
TIMES = {
    *(
        "time",
        "t",
        "timestamp",
        "timestamps",
        "stamp",
        "times",
        "clock",
        "datetime",
        "date",
        "header",
        "elapsed",
    ),
    *("meas", "measured", "sim", "wall", "unix", "epoch", "infos", "sec", "secs", "seconds", "nanoseconds"),
}
CERTAIN_TIMES = TIMES - {"header", "meas", "measured", "sim", "wall", "unix", "elapsed", "infos"}
EPISODES = (
    *(
        "episode",
        "episode_index",
        "episode_id",
        "episode_idx",
        "episodes",
        "trajectory",
        "traj",
        "trajectory_id",
    ),
    *("traj_id", "run", "run_id", "trial", "trial_id", "demo", "demo_id", "rollout", "rollout_id"),
)
UNIT = re.compile(
    r"[_\s.\-\[(]+(deg(?:rees?)?(?:/s|_s|_per_s|ps)?|rad(?:ians?)?(?:/s|_s|_per_s|ps)?|rpm|rps|mrad|ms|us|ns|mm/s|mm|cm|"
    r"m/s|m_s|N[_ ]?m|mNm|sec|seconds|milliseconds|microseconds|nanoseconds|s|m)[\])]?$"
)
WORDS = {
    "degree": "deg",
    "degrees": "deg",
    "radian": "rad",
    "radians": "rad",
    "sec": "s",
    "seconds": "s",
    "milliseconds": "ms",
    "microseconds": "us",
    "nanoseconds": "ns",
    "N_m": "Nm",
    "N m": "Nm",
}


@dataclass(frozen=True)
class Reading:
    """What a column's name says.

    Attributes
    ----------
    kind : str
        "qpos", "qvel", "ctrl", "effort", "state" (all in one), "other", or "" where it says nothing.
    of : str
        Of a command: "qpos", "qvel" or "effort" where the name says; otherwise "".
    key : tuple of str
        What is left of the name: the joint, or a number.
    series : str
        The name with its number or joint left out: columns of one series differ in that alone.
    unit : str
        That the name ends with, or "".
    rank : int
        0 for a first choice.
    """

    kind: str
    of: str
    key: tuple[str, ...]
    series: str
    unit: str
    rank: int


def tokens(text: str) -> tuple[str, ...]:
    """Return the words and numbers of a name, in lower case."""
    split = re.sub(r"([a-z])([A-Z])", r"\1 \2", text)
    return tuple(token.lower() for token in re.findall(r"[A-Za-z]+|\d+", split))


def joint_key(name: str) -> tuple[str, ...]:
    """Return what identifies a joint or actuator in names of columns."""
    words = tokens(name)
    left = tuple(word for word in words if word not in {"joint", "motor", "actuator", "servo", "link", "dof"})
    return left or words


def named_unit(name: str) -> tuple[str, str]:
    """Return (the name without the unit at its end, the unit or "")."""
    found = UNIT.search(name)
    if not found or found.start() == 0:
        return name, ""
    unit = found[1]
    for mark in ("_per_s", "_s", "ps", "/s"):
        if unit.endswith(mark) and unit not in ("rps",):
            stem = unit[: -len(mark)]
            unit = f"{WORDS.get(stem, stem)}/s" if stem else unit
            break
    return name[: found.start()], WORDS.get(unit, unit)


def reading(column: str, label: str = "", topic: str = "") -> Reading:
    """Return what a column's name says.

    Parameters
    ----------
    column : str
    label : str, default=""
        What the file calls this element of a vector.
    topic : str, default=""
        The stream, whose name the column begins with.
    """
    inside = column.removeprefix(f"{topic}.") if topic else column
    element = ELEMENT.match(inside)
    base, part = (element[1], label or element[2]) if element else (inside, label)
    unit = ""
    if element:
        base, unit = named_unit(base)
        part_words = tokens(part)
    else:
        base, unit = named_unit(base)
        part_words = ()
    words = (*tokens(base), *part_words)
    kind, of = _kind(words)
    if not kind and topic:
        kind, of = _kind(tokens(topic))
    elif (
        kind in ("qpos", "qvel", "effort")
        and topic
        and set(tokens(topic)) & COMMAND
        and not set(tokens(topic)) & STATE
    ):
        kind, of = "ctrl", kind
    elif kind == "state" and topic:
        kind = "state"
    dropped = POSITION | VELOCITY | COMMAND | EFFORT | FILLER
    key = tuple(word for word in words if word not in dropped)
    if element and not key:
        key = part_words
    series = column[: -len(element[2]) - 2] if element else re.sub(r"\d+(?!.*\d)", "#", column)
    return Reading(kind, of, key, series, unit, sum(word in SECOND_CHOICE for word in words))


def _kind(words: Sequence[str]) -> tuple[str, str]:
    of = next(
        (
            kind
            for kind, known in (("qvel", VELOCITY), ("effort", EFFORT), ("qpos", POSITION))
            if any(word in known for word in words)
        ),
        "",
    )
    if any(word in OTHER for word in words):
        return "other", ""
    if any(word in COMMAND for word in words) and "meas" not in words and "measured" not in words:
        return "ctrl", of
    if of:
        return of, ""
    if any(word in STATE for word in words):
        return "state", ""
    return "", ""


def is_time(column: str, topic: str = "") -> bool:
    """Whether a column's name is that of a clock."""
    inside = column.removeprefix(f"{topic}.") if topic else column
    words = set(tokens(named_unit(inside)[0]))
    return bool(words) and words <= TIMES and bool(words & CERTAIN_TIMES)


def natural(text: str) -> list[tuple[int, int | str]]:
    """Return a key that sorts numbers in names as numbers."""
    return [(0, int(part)) if part.isdigit() else (1, part) for part in re.findall(r"\d+|\D+", text)]
