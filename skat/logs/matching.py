"""Find out which column of a recording stands for which input of a simulator."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from skat.logs.errors import LogError
from skat.logs.log import Match
from skat.logs.mapping import without_unit
from skat.logs.names import EPISODES, Reading, is_time, joint_key, named_unit, natural, reading, tokens
from skat.logs.streams import ELEMENT, Recording, Stream
from skat.logs.units import Unit, parsed_unit
from skat.simulators import Simulator

KINDS = ("qpos", "qvel", "ctrl")
GUESSED_NAME, GUESSED_ORDER = "by its name", "by order"


@dataclass(frozen=True)
class Column:
    """A column of a recording, with what its name says."""

    name: str
    stream: int
    said: Reading
    label: str = ""


@dataclass(frozen=True)
class Plan:
    """Which columns are read for what.

    Attributes
    ----------
    matches : tuple of Match
        In the order of the simulator's inputs; then time and episode.
    found : mapping from the simulator's name to (stream, column, Unit)
    constants : mapping from name to float
    lacking : tuple of str
        The state's names that the log lacks.
    times : mapping from stream to (column, unit or None where it is to be found out)
    episode : (stream, column) or None
    notes : tuple of str
    told_units : frozenset of str
        Names whose unit was told, or is in the column's name.
    actions : {"commanded", "measured"}
        Whether the commands are efforts of the messages that hold the positions, and so were measured as these were.
    """

    matches: tuple[Match, ...]
    found: Mapping[str, tuple[int, str, Unit]]
    constants: Mapping[str, float]
    lacking: tuple[str, ...]
    times: Mapping[int, tuple[str, str | None]]
    episode: tuple[int, str] | None
    notes: tuple[str, ...] = ()
    told_units: frozenset[str] = field(default_factory=frozenset)
    actions: str = "commanded"


@dataclass(frozen=True)
class Inputs:
    """The simulator's inputs by kind, each with the keys by which logs may know it."""

    names: tuple[str, ...]
    kinds: Mapping[str, tuple[str, ...]]
    keys: Mapping[str, tuple[tuple[str, ...], ...]]
    roots: tuple[str, ...]
    servos: Mapping[str, str]
    limits: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]


def plan(
    recording: Recording,
    simulator: Simulator,
    columns: Mapping[str, str],
    units: str | Mapping[str, str] | None,
    topic: str | None,
    episodes: str | None,
) -> Plan:
    """Return which columns are read for what.

    Raises
    ------
    LogError
        If a column is named that is not there, or the model's positions or commands cannot be found.
    """
    inputs = simulator_inputs(simulator)
    streams = recording.streams
    if topic is not None and all(stream.name for stream in streams):
        _check_topic(recording, topic)
    known = {
        column: Column(
            column,
            place,
            reading(column, stream.labels.get(column, ""), stream.name),
            stream.labels.get(column, ""),
        )
        for place, stream in enumerate(streams)
        for column in stream.columns
    }
    inputs, columns = _renamed(inputs, columns, known, recording)
    matched, told, constants, left_out = _told(columns, known, inputs, recording)
    settled = {*matched, *constants, *left_out}
    guesses, notes = _guessed(known, inputs, settled, recording, topic)
    matched |= guesses
    told_units = _units(units, told, inputs, recording)
    lacking = _lacking(inputs, matched, constants, known, recording)
    found, matches, with_units = {}, [], set(told_units)
    for name in inputs.names:
        if name in constants:
            matches.append(Match(name, f"{constants[name]:g}", "", "told"))
        if name not in matched:
            continue
        column, how = matched[name]
        text = told_units.get(name) or _named_unit(known[column], inputs, recording)
        if text and name not in told_units:
            with_units.add(name)
        found[name] = (known[column].stream, column, _unit(text, name, inputs, simulator, recording))
        matches.append(Match(name, column, text, how))
    times = _times(known, streams, {place for place, _, _ in found.values()}, columns, told_units, recording)
    used = {column for _, column, _ in found.values()} | {column for column, _ in times.values()}
    episode = _episode(known, columns, episodes, recording, {place for place, _, _ in found.values()})
    for column, unit in times.values():
        matches.append(Match("time", column, unit or "", "told" if "time" in columns else GUESSED_NAME))
    if episode is not None:
        matches.append(
            Match("episode", episode[1], "", "told" if "episode" in columns or episodes else GUESSED_NAME)
        )
        used.add(episode[1])
    _check_driven(known, used, simulator, recording)
    notes += _leftovers(known, used, lacking)
    actions = "commanded"
    if _are_measured(found, known, inputs, recording):
        actions = "measured"
        notes = [
            *notes,
            "Efforts are of the messages that hold the positions, and so were measured (actions).",
        ]
    return Plan(
        tuple(matches),
        found,
        constants,
        lacking,
        times,
        episode,
        tuple(notes),
        frozenset(with_units),
        actions,
    )


def _are_measured(
    found: Mapping[str, tuple[int, str, Unit]],
    known: Mapping[str, Column],
    inputs: Inputs,
    recording: Recording,
) -> bool:
    """Whether all commands are efforts of a topic that holds positions, as a ``JointState`` does: what was measured."""
    driven = [name for name in inputs.kinds["ctrl"] if name in found]
    efforts = [found[name] for name in driven if inputs.servos.get(name) == "effort"]
    places = {found[name][0] for name in inputs.kinds["qpos"] if name in found}
    return (
        bool(efforts)
        and len(efforts) == len(driven)
        and all(
            recording.streams[stream].name and stream in places and known[column].said.kind == "effort"
            for stream, column, _ in efforts
        )
    )


def simulator_inputs(simulator: Simulator) -> Inputs:
    """Return what a simulator takes, with the names of joints that its actuators drive."""
    names = tuple(simulator.input_names)
    states = set(simulator.state_names)
    kinds: dict[str, list[str]] = {kind: [] for kind in KINDS}
    for name in names:
        kind = next(
            (kind for kind in KINDS if name.startswith(f"{kind}.")), "qpos" if name in states else "ctrl"
        )
        kinds[kind].append(name)
    model = simulator.compiled() if hasattr(simulator, "compiled") else None
    keys: dict[str, list[tuple[str, ...]]] = {}
    for name in names:
        own = name.split(".", 1)[1] if any(name.startswith(f"{kind}.") for kind in KINDS) else name
        keys[name] = [joint_key(own)]
    servos: dict[str, str] = {}
    limits: dict[str, tuple[float, float]] = {}
    units = dict(simulator.units)
    roots: list[str] = []
    if model is not None:
        for actuator, name in enumerate(kinds["ctrl"]):
            servos[name] = _servo(model, actuator)
            if servos[name] == "effort":
                units[name] = "N"
            if int(model.actuator_trntype[actuator]) == 0:
                joint = int(model.actuator_trnid[actuator, 0])
                driven = model.joint(joint).name or f"joint{joint}"
                if joint_key(driven) not in keys[name]:
                    keys[name].append(joint_key(driven))
                limits |= _range(model, joint, name)
                units.setdefault(name, units.get(f"{servos[name]}.{driven}", ""))
        for joint in range(model.njnt):
            named = model.joint(joint).name or f"joint{joint}"
            if int(model.jnt_type[joint]) >= 2:
                limits |= _range(model, joint, f"qpos.{named}")
            elif int(model.jnt_type[joint]) == 0:
                mine = (f"qpos.{named}.", f"qvel.{named}.")
                roots += [name for name in names if name.startswith(mine)]
    return Inputs(
        names,
        {kind: tuple(found) for kind, found in kinds.items()},
        {name: tuple(found) for name, found in keys.items()},
        tuple(roots),
        servos,
        limits,
        units,
    )


def _range(model: Any, joint: int, name: str) -> dict[str, tuple[float, float]]:
    if not model.jnt_limited[joint]:
        return {}
    low, high = model.jnt_range[joint]
    return {name: (float(low), float(high))}


def _servo(model: Any, actuator: int) -> str:
    """Return what an actuator's command is: "qpos", "qvel" or "effort"."""
    if int(model.actuator_biastype[actuator]) == 1:
        if model.actuator_biasprm[actuator, 1]:
            return "qpos"
        if model.actuator_biasprm[actuator, 2]:
            return "qvel"
    return "effort"


def _check_topic(recording: Recording, topic: str) -> None:
    names = [stream.name for stream in recording.streams]
    if topic not in names:
        likely = [name for name in names if topic.strip("/") in name] or names
        raise LogError(
            recording.source,
            f"has no topic {topic!r} with numbers; it has {', '.join(names)}.",
            options={"topic": likely[0]},
        )


def _renamed(
    inputs: Inputs, columns: Mapping[str, str], known: Mapping[str, Column], recording: Recording
) -> tuple[Inputs, dict[str, str]]:
    """Return the inputs with the log's names of joints (``"*.elbow": "joint3"``), and what else the user says."""
    keys, rest = dict(inputs.keys), dict(columns)
    for ours, text in columns.items():
        theirs, unit = without_unit(text, known)
        if (
            not ours.startswith("*.")
            or "*" in theirs
            or theirs in ("", "-")
            or _constant(theirs, known) is not None
        ):
            continue
        names, key = _ours(ours, inputs, recording), joint_key(theirs)
        if not any(key == one.said.key for one in known.values()):
            raise _no_column(theirs, ours, known, recording)
        keys |= dict.fromkeys(names, (key,))
        del rest[ours]
        if unit:
            rest |= {name: rest.get(name, f":{unit}") for name in _meant(ours, names, unit, inputs)}
    return replace(inputs, keys=keys), rest


def _told(
    columns: Mapping[str, str], known: Mapping[str, Column], inputs: Inputs, recording: Recording
) -> tuple[dict[str, tuple[str, str]], dict[str, str], dict[str, float], list[str]]:
    """Return ({name: (column, how)}, {name: unit}, {name: constant}, names left out) of what the user says."""
    matched: dict[str, tuple[str, str]] = {}
    units: dict[str, str] = {}
    constants: dict[str, float] = {}
    left_out: list[str] = []
    # What names one channel comes after, and so before, what names many.
    for ours, text in sorted(columns.items(), key=lambda item: item[0].count("*"), reverse=True):
        if ours in ("time", "episode"):
            continue
        names = _ours(ours, inputs, recording)
        theirs, unit = without_unit(text, known)
        if unit:
            units |= dict.fromkeys(_meant(ours, names, unit, inputs), unit)
        if theirs == "-" or (theirs == "" and not unit):
            left_out += names
            for name in names:
                matched.pop(name, None)
            continue
        if theirs == "":
            continue
        if (number := _constant(theirs, known)) is not None:
            constants |= dict.fromkeys(names, number)
            continue
        names = [name for name in names if name == ours or name not in columns]
        for name, column, how in _theirs(names, theirs, known, inputs, recording, ours):
            matched[name] = (column, how)
            constants.pop(name, None)
    return matched, units, constants, left_out


def _constant(text: str, known: Mapping[str, Column]) -> float | None:
    if text in known:
        return None
    try:
        return float(text)
    except ValueError:
        return None


def _ours(pattern: str, inputs: Inputs, recording: Recording) -> list[str]:
    """Return the simulator's names that a pattern of the user's means."""
    if "*" not in pattern:
        if pattern not in inputs.names:
            raise LogError(
                f"{recording.source}, columns[{pattern!r}]",
                "is no input of the simulator.",
                f"It has {_listed(inputs.names, 30)}, time and episode.",
            )
        return [pattern]
    head, _, tail = pattern.partition("*")
    names = [
        name
        for name in inputs.names
        if name.startswith(head) and name.endswith(tail) and (name not in inputs.roots or pattern == "*")
    ]
    if not names:
        raise LogError(
            f"{recording.source}, columns[{pattern!r}]",
            "means no input of the simulator.",
            f"It has {_listed(inputs.names, 30)}.",
        )
    return names


def _theirs(
    names: list[str],
    theirs: str,
    known: Mapping[str, Column],
    inputs: Inputs,
    recording: Recording,
    ours: str,
) -> list[tuple[str, str, str]]:
    """Return (name, column, how) for what the user wrote."""
    if theirs in known and len(names) == 1:
        return [(names[0], theirs, "told")]
    if "*" in theirs:
        direct = [(name, theirs.replace("*", name.split(".", 1)[-1])) for name in names]
        if all(column in known for _, column in direct):
            return [(name, column, "told") for name, column in direct]
        head, _, tail = theirs.partition("*")
        columns = [
            name
            for name in known
            if name.startswith(head) and name.endswith(tail) and len(name) >= len(theirs) - 1
        ]
        parts = {column: column[len(head) : len(column) - len(tail)] for column in columns}
    else:
        parts = {}
        for column, one in known.items():
            element = ELEMENT.match(column)
            if element and (element[1] == theirs or element[1].lstrip("/") == theirs.lstrip("/")):
                parts[column] = one.label or element[2]
        columns = list(parts)
        if not columns:
            # A topic whose messages have a single array.
            columns = [
                column for column, one in known.items() if recording.streams[one.stream].name == theirs
            ]
            columns = [column for column in columns if ELEMENT.match(column)]
            parts = {column: column.rsplit("[", 1)[1][:-1] for column in columns}
            if len({column.rsplit("[", 1)[0] for column in columns}) > 1:
                columns = []
        if not columns and len(names) > 1 and theirs in known:
            raise LogError(
                f"{recording.source}, column {theirs}",
                f"is one column, and {ours} means {len(names)} inputs: {_listed(names)}.",
                "Name one input for it, or put * for what differs in their names.",
            )
    if not columns:
        raise _no_column(theirs, ours, known, recording)
    by_name = {}
    for name in names:
        fits = [column for column in columns if joint_key(_bare(parts[column])) in inputs.keys[name]]
        if len(fits) == 1:
            by_name[name] = fits[0]
    if len(by_name) == len(names):
        return [(name, by_name[name], "told") for name in names]
    # A vector of all joints has an element, too, for one that is told apart, as a gripper in another unit.
    for meant in (_ours(ours, inputs, recording), names):
        if len(columns) == len(meant) and not by_name:
            ordered = dict(zip(meant, sorted(columns, key=natural)))
            return [(name, ordered[name], f"told, {GUESSED_ORDER}") for name in names]
    missing = [name for name in names if name not in by_name]
    raise LogError(
        f"{recording.source}, {theirs}",
        f"has {len(columns)} columns ({_listed(columns)}) for {len(names)} inputs; none is named after "
        f"{_listed(missing)}.",
        f"Name each: columns={{{missing[0]!r}: {columns[0]!r}}} (on the command line --map "
        f"'{missing[0]}={columns[0]}').",
    )


def _bare(part: str) -> str:
    """Return a joint's name without the words for a quantity that a file may put behind it."""
    said = reading(part)
    return " ".join(said.key) or part


def _no_column(theirs: str, ours: str, known: Mapping[str, Column], recording: Recording) -> LogError:
    close = [column for column in known if tokens(theirs) and set(tokens(theirs)) & set(tokens(column))]
    return LogError(
        f"{recording.source}, column {theirs!r}",
        f"was told for {ours} and is not there.{_left_out(recording)}",
        f"It has {_listed(close or list(known), 30)}.",
    )


def _guessed(
    known: Mapping[str, Column], inputs: Inputs, settled: set[str], recording: Recording, topic: str | None
) -> tuple[dict[str, tuple[str, str]], list[str]]:
    """Return ({name: (column, how)}, notes) for inputs that nobody told of."""
    matched: dict[str, tuple[str, str]] = {}
    notes: list[str] = []
    for name in inputs.names:
        if name not in settled and name in known:
            matched[name] = (name, "same name")
    columns = [
        one
        for one in known.values()
        if topic is None or recording.streams[one.stream].name in ("", topic) or one.said.kind == "ctrl"
    ]
    taken = {column for column, _ in matched.values()}
    for kind in KINDS:
        wanted = [name for name in inputs.kinds[kind] if name not in settled and name not in matched]
        joints = [name for name in wanted if name not in inputs.roots]
        if not joints:
            continue
        candidates = [one for one in columns if one.said.kind == kind and one.name not in taken]
        if kind == "ctrl":
            candidates = [
                one
                for one in candidates
                if not one.said.of or one.said.of == inputs.servos.get(joints[0], one.said.of)
            ]
        by_name = _by_key(joints, candidates, inputs, recording, kind)
        if len(by_name) < len(joints) and not by_name:
            by_name = _by_order(joints, candidates, recording)
        matched |= by_name
        taken |= {column for column, _ in by_name.values()}
    if not any(name in matched or name in settled for name in inputs.kinds["qpos"]):
        vectors = _whole_state(columns, inputs, settled)
        matched |= vectors
        if not vectors:
            plain = [one for one in columns if one.said.kind in ("", "state") and one.name not in taken]
            joints = [
                name for name in inputs.kinds["qpos"] if name not in settled and name not in inputs.roots
            ]
            matched |= _by_key(joints, plain, inputs, recording, "qpos")
    by_order = [name for name, (_, how) in matched.items() if how.startswith(GUESSED_ORDER)]
    if by_order:
        pairs = ", ".join(f"{name} = {matched[name][0]}" for name in by_order)
        notes.append(f"Taken by order, as the file names no joints: {pairs}.")
    return matched, notes


def _by_key(
    names: list[str], candidates: list[Column], inputs: Inputs, recording: Recording, kind: str
) -> dict[str, tuple[str, str]]:
    """Return {name: (column, how)} for columns that are named after joints."""
    matched = {}
    for name in names:
        fits = [one for one in candidates if one.said.key in inputs.keys[name]]
        if not fits:
            continue
        best = min(one.said.rank for one in fits)
        fits = [one for one in fits if one.said.rank == best]
        if len(fits) > 1:
            streams = [recording.streams[one.stream].name for one in fits]
            several = len(set(streams)) > 1
            raise LogError(
                recording.source,
                f"has several columns that may be {name}: {_listed([one.name for one in fits])}.",
                options={"topic": streams[0]}
                if several and kind != "ctrl"
                else {"columns": {name: fits[0].name}},
            )
        matched[name] = (fits[0].name, GUESSED_NAME)
    return matched


def _by_order(names: list[str], candidates: list[Column], recording: Recording) -> dict[str, tuple[str, str]]:
    """Return {name: (column, how)} for a numbered series with as many members as there are names."""
    series: dict[str, list[Column]] = {}
    for one in candidates:
        if all(word.isdigit() for word in one.said.key):
            series.setdefault(one.said.series, []).append(one)
    fitting = {name: members for name, members in series.items() if len(members) == len(names)}
    if fitting:
        least = min(members[0].said.rank for members in fitting.values())
        fitting = {name: members for name, members in fitting.items() if members[0].said.rank == least}
    if len(fitting) > 1:
        first = sorted((one.name for one in next(iter(fitting.values()))), key=natural)
        raise LogError(
            recording.source,
            f"has several series of columns that may be {_listed(names)}: {_listed(list(fitting))}.",
            options={"columns": dict(zip(names, first))},
        )
    for members in fitting.values():
        ordered = sorted((one.name for one in members), key=natural)
        return {name: (column, GUESSED_ORDER) for name, column in zip(names, ordered)}
    return {}


def _whole_state(columns: Iterable[Column], inputs: Inputs, settled: set[str]) -> dict[str, tuple[str, str]]:
    """Return matches for a vector that holds the state, or all of it but the first coordinates (as in Gymnasium)."""
    positions, velocities = inputs.kinds["qpos"], inputs.kinds["qvel"]
    if settled & {*positions, *velocities}:
        return {}
    vectors: dict[str, list[Column]] = {}
    for one in columns:
        if one.said.kind == "state" and ELEMENT.match(one.name):
            vectors.setdefault(one.said.series, []).append(one)
    for members in vectors.values():
        ordered = [one.name for one in sorted(members, key=lambda one: natural(one.name))]
        joints = [name for name in positions if name not in inputs.roots]
        if len(ordered) == len(joints):
            return {name: (column, GUESSED_ORDER) for name, column in zip(joints, ordered)}
        missing = len(positions) + len(velocities) - len(ordered)
        if 0 <= missing <= min(2, len(positions) - 1):
            names = (*positions[missing:], *velocities)
            return {name: (column, f"{GUESSED_ORDER}, [qpos, qvel]") for name, column in zip(names, ordered)}
    return {}


def _lacking(
    inputs: Inputs,
    matched: dict[str, tuple[str, str]],
    constants: Mapping[str, float],
    known: Mapping[str, Column],
    recording: Recording,
) -> tuple[str, ...]:
    """Return the state's names that the log lacks; raise where too much is lacking."""
    missing = {
        kind: [name for name in names if name not in matched and name not in constants]
        for kind, names in inputs.kinds.items()
    }
    # Of a body that only floats, its pose is all there is.
    positions = [name for name in inputs.kinds["qpos"] if name not in inputs.roots] or inputs.kinds["qpos"]
    found = [name for name in positions if name in matched]
    if not found and not any(name in matched for name in inputs.kinds["qvel"]):
        raise LogError(
            recording.source,
            f"no column could be found for the model's positions ({_listed(positions)}); it has "
            f"{_listed(list(known), 30)}.{_left_out(recording)}",
            _advice(known, positions, recording),
        )
    if missing["ctrl"] and (lost := [name for name in recording.left_out if reading(name).kind == "ctrl"]):
        raise LogError(
            recording.source,
            f"no column could be found for {_listed(missing['ctrl'])}.{_left_out(recording)}",
            f"If {lost[0]} holds the commands, write as many rows of it as of the states, or one less.",
        )
    if missing["ctrl"]:
        candidates = _command_columns(known, len(inputs.kinds["ctrl"]), matched)
        could = f" Columns that could be commands: {_listed(candidates)}." if candidates else ""
        whole = len(missing["ctrl"]) == len(inputs.kinds["ctrl"])
        pattern = "ctrl.*" if whole else missing["ctrl"][0]
        raise LogError(
            recording.source,
            f"no column could be found for {_listed(missing['ctrl'])}: what the model's motors were told.{could}"
            + _left_out(recording),
            f"If a column is the command, name it (--map '{pattern}={candidates[0] if candidates else 'COLUMN'}'). If "
            "the motors were off, and the robot moved freely, hold the commands constant at 0"
            + (
                " (of a position servo that is a position; take the actuators out of the model then)."
                if set(inputs.servos.values()) & {"qpos"}
                else "."
            ),
            options={"columns": {"ctrl.*": "0"} if whole else dict.fromkeys(missing["ctrl"], "0")},
        )
    return tuple(name for kind in ("qpos", "qvel") for name in missing[kind])


def _left_out(recording: Recording) -> str:
    """Return a sentence on arrays that are no columns, with a blank before it; "" where there are none."""
    told = [f"{name} has {why}" for name, why in recording.left_out.items()]
    return f" Left out: {_listed(told, 6)}." if told else ""


def _command_columns(
    known: Mapping[str, Column], size: int, matched: dict[str, tuple[str, str]]
) -> list[str]:
    """Return series and columns that could be commands: efforts, or anything of the right number."""
    taken = {column for column, _ in matched.values()}
    series: dict[str, list[Column]] = {}
    for one in known.values():
        if one.name not in taken and one.said.kind in ("effort", "ctrl"):
            series.setdefault(one.said.series, []).append(one)
    fitting = [name.replace("#", "*") for name, members in series.items() if len(members) == size]
    return fitting or [one.name for members in series.values() for one in members]


def _advice(known: Mapping[str, Column], positions: Sequence[str], recording: Recording) -> str:
    likely = [name for name, one in known.items() if one.said.kind in ("qpos", "state")]
    likely += [
        name
        for name, one in known.items()
        if not one.said.kind and not is_time(name, recording.streams[one.stream].name)
    ]
    column = [*likely, *known][0]
    return (
        f"Say which is which: columns={{{positions[0]!r}: {column!r}}} (on the command line --map "
        f"'{positions[0]}={column}'); with :deg behind it where it is in degrees. Or the log is of another robot."
    )


def _units(
    units: str | Mapping[str, str] | None, told: dict[str, str], inputs: Inputs, recording: Recording
) -> dict[str, str]:
    """Return {name: unit} of what the user says; what is said with the column comes first."""
    found: dict[str, str] = {}
    if isinstance(units, str):
        units = {"*": units}
    if not isinstance(units, Mapping | None) or not all(
        isinstance(one, str) for one in (units or {}).values()
    ):
        raise TypeError(
            f'units must be a unit such as "deg", or a mapping such as {{"qpos.*": "deg"}}; got {units!r}.'
        )
    for pattern, unit in (units or {}).items():
        if pattern in ("time", "episode"):
            found[pattern] = unit
            continue
        names = _ours(pattern, inputs, recording)
        found |= dict.fromkeys(_meant(pattern, names, unit, inputs), unit)
    return found | told


def _meant(pattern: str, names: list[str], unit: str, inputs: Inputs) -> list[str]:
    """Return the channels that a unit is meant for: of a pattern's, those that it measures, and of ``*`` no efforts."""
    if "*" not in pattern:
        return names
    if pattern.startswith("*"):
        efforts = [name for name in inputs.kinds["ctrl"] if inputs.servos.get(name, "effort") == "effort"]
        names = [name for name in names if name not in (*inputs.roots, *efforts)]
    try:
        kind = parsed_unit(unit, limits=(0.0, 1.0)).kind
    except ValueError:
        return names
    own = {"A": "rad", "L": "m"}.get(kind[:1], "")
    return [name for name in names if (inputs.units.get(name) or own).startswith(own)] or names


def _named_unit(column: Column, inputs: Inputs, recording: Recording) -> str:
    """Return the unit in a column's name; "" where the simulator's own name ends so (``qpos.slide_mm``)."""
    own = column.name.removeprefix(f"{recording.streams[column.stream].name}.")
    return "" if {own, column.name} & {*inputs.names} else column.said.unit


def _unit(text: str, name: str, inputs: Inputs, simulator: Simulator, recording: Recording) -> Unit:
    if not text:
        return Unit("")
    where = f"{recording.source}, unit of {name}"
    try:
        unit = parsed_unit(text, limits=inputs.limits.get(name))
    except ValueError as error:
        raise LogError(where, str(error)) from None
    own = simulator.units.get(name, "")
    of_length, of_angle = own.startswith("m"), own.startswith("rad")
    kind = unit.kind
    if name.startswith("qvel.") and kind in ("A", "L"):
        kind += "/s"
    if own and kind and name in simulator.state_names:
        expected = ("A" if of_angle else "L" if of_length else "") + ("/s" if own.endswith("/s") else "")
        if expected and kind != expected:
            raise LogError(
                where,
                f"{text!r} does not measure what the model has in {own}.",
                "Check the unit or the name.",
            )
    return unit


def _times(
    known: Mapping[str, Column],
    streams: tuple[Stream, ...],
    used: set[int],
    columns: Mapping[str, str],
    told_units: Mapping[str, str],
    recording: Recording,
) -> dict[int, tuple[str, str | None]]:
    """Return {stream: (column, unit)} of the clocks of the streams that are used."""
    if columns.get("time") == "-":
        return {}
    theirs, unit = without_unit(columns.get("time", ""), known)
    told, shared = unit or told_units.get("time"), told_units.get("time")
    own: dict[int, tuple[str, str | None]] = {}
    if theirs:
        if theirs not in known:
            raise _no_column(theirs, "time", known, recording)
        own = {known[theirs].stream: (theirs, told or named_unit(theirs)[1] or None)}
        if set(own) >= used:
            return own
    else:
        shared = told
    times: dict[int, tuple[str, str | None]] = {}
    message = [place for place in used if streams[place].clock_unit is not None]
    stamped = all(f"{streams[place].name}.header.stamp" in streams[place].columns for place in message)
    for place in used:
        stream = streams[place]
        if place in message:
            times[place] = (f"{stream.name}.{'header.stamp' if stamped else 'time'}", stream.clock_unit)
            continue
        clocks = [column for column in stream.columns if is_time(column, stream.name)]
        usual = f"{stream.name}.time" if stream.name else "time"
        plain = [column for column in clocks if column == usual] or sorted(clocks, key=len)
        if plain:
            times[place] = (plain[0], shared or named_unit(plain[0])[1] or None)
    return times | own


def _episode(
    known: Mapping[str, Column],
    columns: Mapping[str, str],
    episodes: str | None,
    recording: Recording,
    used: set[int],
) -> tuple[int, str] | None:
    name = columns.get("episode") or (episodes if episodes not in (None, "gaps") else None)
    if name is not None:
        if name not in known:
            close = [column for column in known if column.lower() in EPISODES]
            raise LogError(
                f"{recording.source}, column {name!r}",
                f"was told to tell episodes apart and is not there; it has {_listed(list(known), 30)}.",
                "Name one of them, or let gaps in time tell them apart.",
                options={"episodes": close[0] if close else "gaps"},
            )
        return known[name].stream, name
    if episodes == "gaps":
        return None
    for wanted in EPISODES:
        for column, one in known.items():
            if column.lower().replace(" ", "_") == wanted and one.stream in used:
                return one.stream, column
    return None


def _check_driven(
    known: Mapping[str, Column], used: set[str], simulator: Simulator, recording: Recording
) -> None:
    """Raise where a log has commands and its model, read from a URDF, has no actuators for them."""
    source = getattr(simulator, "model", None)
    if source is None or getattr(source, "urdf", None) is None or source.motors is not None:
        return
    commands = [column for column, one in known.items() if one.said.kind == "ctrl" and column not in used]
    if commands and len(simulator.input_names) == len(simulator.state_names):
        raise LogError(
            recording.source,
            f"has commands ({_listed(commands, 6)}), and the model, a URDF, has no actuators.",
            'Say what drives the joints: MujocoSimulator(..., motors="torque") or motors="position:kp,kv" (on the '
            'command line --motors torque); motors="none" leaves the commands aside.',
        )


def _leftovers(known: Mapping[str, Column], used: set[str], lacking: tuple[str, ...]) -> list[str]:
    unused = [column for column in known if column not in used]
    notes = []
    if unused:
        whole = list(dict.fromkeys(ELEMENT.sub(r"\1", column) for column in unused))
        notes.append(f"Left aside: {_listed(whole)}.")
    if lacking:
        notes.append(f"Not in the log, so not measured: {_listed(lacking)}.")
    return notes


def _listed(names: Any, limit: int = 12) -> str:
    names = list(names)
    return ", ".join(names[:limit]) + (f", ... ({len(names)} in all)" if len(names) > limit else "")
