"""Read any log as transitions of a simulator."""

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

from skat.episodes import FEWEST_ROWS
from skat.logs import clock
from skat.logs.errors import LogError
from skat.logs.grid import acting, ended, on_grid, stream_times
from skat.logs.log import Log, joined
from skat.logs.mapping import checked_columns
from skat.logs.matching import Plan, plan, simulator_inputs
from skat.logs.readers import recording
from skat.logs.stamps import joined_stamps
from skat.logs.streams import Recording, Stream, is_number
from skat.logs.suspects import in_degrees
from skat.simulators import Simulator
from skat.simulators.adapting import at_rate, without_root
from skat.simulators.tables import Array

# The mean transition is known better than single rows, and what it misses of a whole number of steps acts in each.
STEP_TOLERANCE = 1e-3
# A rate that is told and one that is measured are the same within this.
SAME_RATE = 0.01
# Rows at a rate that is told, for each row of the log: more of them hold nothing new, and fill the memory.
MOST_RATES = 100


def load_log(
    source: Any,
    simulator: Simulator,
    *,
    columns: Any = None,
    units: str | Mapping[str, str] | None = None,
    rate: float | None = None,
    topic: str | None = None,
    episodes: str | None = None,
    base: Literal["fixed", "free"] | None = None,
) -> Log:
    r"""Load a log as transitions of a simulator.

    Parameters
    ----------
    source : path, data frame, mapping from name to array, or sequence of these
        A file or folder that is recognised by what is in it: CSV (also compressed by gzip), Parquet, NPZ, HDF5,
        rosbag2 (SQLite or MCAP, a folder or a single file), ROS 1 bag, MCAP (ROS 2, JSON, protobuf), a LeRobot data
        set v2.1 or v3, a Minari data set. A data frame of pandas or polars; a mapping from names to arrays, of which
        one of shape (n, k) is k columns ``name[0]``, ... Several are joined, each its own episodes.

    simulator : Simulator
        With a state. Its inputs are what is looked for.

    columns : mapping from name to str, or path, default=None
        What is not found by its name: ``{"qpos.elbow": "q1:deg"}``, the simulator's name, then theirs (a column, an
        element ``observation.state[2]`` of a vector, a field ``/commands.position`` of a topic), and, after a colon,
        the unit. ``*`` stands for every joint: ``{"ctrl.*": "/commands.position"}``, ``{"qpos.*": "*_pos:deg"}``; and
        ``{"*.elbow": "joint3"}`` says what the log calls a joint, in all of its columns.
        Also ``time`` and ``episode``. A number is a constant: ``{"ctrl.*": "0"}``; ``-`` leaves a channel out, as
        not measured. A path is that of a ``map.toml``, as `write_map` writes it.

    units : str or mapping from name to str, default=None
        Units beside `columns`: ``{"qpos.*": "deg", "time": "ms"}``; one alone, such as ``"deg"``, is that of every
        angle, its rate and its command. See the user guide for the list.

    rate : float, default=None
        Rows per second of the log that is returned, at most 100 times as many as it has. None: that of the log. Where
        the file has no times, its rate.

    topic : str, default=None
        Of a bag, the topic that holds the state, where there are several.

    episodes : str, default=None
        Name of the column that tells episodes apart; ``"gaps"``: gaps in time alone do. None: a column ``episode``,
        or of that meaning, where there is one, and gaps in time.

    base : {"fixed", "free"}, default=None
        Of a model with a free root whose pose the log does not hold: whether the root is welded to the world, or
        moves unmeasured.

    Returns
    -------
    Log

    Raises
    ------
    LogError
        A ValueError with file, place and remedy: if the source is no log that can be read, or its columns cannot be
        matched.
    FileNotFoundError
        If there is no such file.
    ImportError
        If a library that reads this format is missing; with the line that installs it.
    TypeError
        If the source is none of these, units are neither a text nor a mapping, or the simulator is none.
    """
    if isinstance(source, Sequence) and not isinstance(source, str | PathLike | bytes):
        options = {"units": units, "rate": rate, "topic": topic, "episodes": episodes, "base": base}
        return joined([load_log(one, simulator, columns=columns, **options) for one in source])  # type: ignore[arg-type]
    if not isinstance(simulator, Simulator):
        raise TypeError(
            "simulator must be a Simulator, such as MujocoSimulator(path_of_the_model) or a FunctionSimulator; it is "
            f"{simulator!r}."
        )
    if not simulator.state_names:
        raise ValueError(
            "A log of states in time needs a simulator with a state; this one is one-shot. Read its inputs and outputs "
            "by pandas.read_csv, and pass them to fit as X and y."
        )
    if rate is not None and not 0 < rate < np.inf:
        raise ValueError(f"rate must be rows per second, positive and finite; it is {rate!r}.")
    if base not in (None, "fixed", "free"):
        raise ValueError(f'base must be "fixed", "free" or None; it is {base!r}.')
    told = checked_columns(columns)
    record = joined_stamps(recording(source, topic=topic))
    notes = list(record.notes)
    if base == "fixed":
        simulator, welded = _welded(simulator, record)
        notes.append(welded)
    found = plan(record, simulator, told, units, topic, episodes)
    _check_base(found, simulator, base, record)
    log = _timed(record, found, simulator, rate, notes)
    _check_degrees(log, found, record)
    return log


def _welded(simulator: Simulator, record: Recording) -> tuple[Simulator, str]:
    """Return the simulator without its root's joint, and a note."""
    roots = simulator_inputs(simulator).roots
    if not roots:
        raise LogError(
            record.source, 'base="fixed" was said, and the model has no free root.', "Leave base out."
        )
    return without_root(simulator), "The root is welded to the world where the model has it (base: fixed)."


def _check_base(found: Plan, simulator: Simulator, base: str | None, record: Recording) -> None:
    """Raise where a root's pose is lacking and nobody has said what it does."""
    roots = simulator_inputs(simulator).roots
    lacking = [name for name in roots if name in found.lacking]
    if lacking and base is None and any(name.startswith("qpos.") for name in lacking):
        raise LogError(
            record.source,
            f"does not hold the pose of the model's free root ({', '.join(lacking[:3])}, ...).",
            'Say whether it was fixed to something, such as a stand (base="fixed"), or moved unmeasured (base="free"); '
            "or name the columns.",
            options={"base": "fixed"},
        )


def _timed(record: Recording, found: Plan, simulator: Simulator, rate: float | None, notes: list[str]) -> Log:
    """Return the log on an even grid."""
    names = tuple(simulator.input_names)
    n_states = len(simulator.state_names)
    main = _main_stream(found, simulator)
    stream = record.streams[main]
    data = _read(record, found)
    n_rows = len(next(iter(data[main].values())))
    if n_rows == 0:
        raise LogError(record.where(stream), "has no rows.", f"Record a log with at least {FEWEST_ROWS}.")
    states = _states(record, found, data, n_states, names)
    clocks = {column for column, _ in found.times.values()} | ({found.episode[1]} if found.episode else set())
    data = {place: {name: read[name] for name in read if name in clocks} for place, read in data.items()}
    labels, labels_text = _labels(record, found, data, main, n_rows)
    notes += found.notes
    times, good, step = _times(record, found, data, main, labels, simulator, rate, n_rows, notes)
    mine = [name for name, (place, _, _) in found.found.items() if place == main and name in states]
    empty = np.ones(n_rows, dtype=bool)
    for name in mine:
        empty &= np.isnan(states[name])
    kept = np.flatnonzero(good & ~empty)
    if empty.any() and mine:
        notes.append(f"{int(empty.sum())} rows hold no state: not measured there.")
    if len(kept) < 2:
        raise LogError(
            record.where(stream),
            f"holds {len(kept)} rows with a state.",
            f"Record a log with at least {FEWEST_ROWS}.",
        )

    def moves() -> Array:
        # Velocities jump where commands do, wherever the stamps stand.
        smooth = [name for name in mine if name in names[:n_states] and not name.startswith("qvel.")]
        return np.stack([states[name][kept] for name in (smooth or mine)[:8]], axis=1)

    own, dt, said = clock.pieces(
        times[kept],
        labels[kept],
        labels_text,
        step,
        lambda row: f"{record.source}, {stream.place(int(kept[row]))}",
        moves,
    )
    notes += said
    times_of = {place: stream_times(record, found, data, place, main, times) for place in data}
    own, acts, bending = acting(found, states, own, kept, main, names, n_states, times_of)
    notes += [bending] if bending else []
    simulator, step, said = _stepped(simulator, dt, rate, record)
    notes += said
    told = rate or record.rate
    apart = abs(dt * told - 1) if told else np.inf
    same = apart <= SAME_RATE
    if same and apart > STEP_TOLERANCE:
        notes.append(f"Rows are taken as {step:g} s apart, as told; the clock says {dt:.6g} s.")
    own, how = clock.resampled(own, dt, step, same=same)
    notes += [how] if how else []
    own = [piece for piece in own if piece.size >= 2]
    notes += ended(record, found, own, main, names[n_states:], times_of)
    commands = np.array([states[name][kept] for name in mine if name in names[n_states:]]).reshape(
        -1, len(kept)
    )
    if n_lost := sum(_lost(commands[:, piece.rows]) for piece in own):
        notes.append(
            f"{n_lost} row{'s' if n_lost > 1 else ''} without a command: the one before is held there."
        )
    grid, groups, errors = on_grid(found, states, own, kept, main, names, n_states, times_of, acts)
    return _log(record, found, simulator, grid, groups, own, errors, n_states, notes)


def _lost(commands: Array) -> int:
    """Return how many rows of an episode lack a command that was given before; a row for each channel."""
    given = np.isfinite(commands)
    return int((~given & np.logical_or.accumulate(given, axis=1)).any(axis=0).sum())


def _main_stream(found: Plan, simulator: Simulator) -> int:
    """Return the stream whose clock the log follows: the one with most of the state."""
    counts: dict[int, int] = {}
    for name, (place, _, _) in found.found.items():
        counts[place] = counts.get(place, 0) + (1000 if name in simulator.state_names else 1)
    return max(counts, key=lambda place: (counts[place], -place))


def _read(record: Recording, found: Plan) -> dict[int, dict[str, np.ndarray]]:
    wanted: dict[int, list[str]] = {}
    for place, column, _ in found.found.values():
        wanted.setdefault(place, []).append(column)
    for place, (column, _) in found.times.items():
        wanted.setdefault(place, []).append(column)
    if found.episode is not None:
        wanted.setdefault(found.episode[0], []).append(found.episode[1])
    return {place: record.streams[place].read(list(dict.fromkeys(names))) for place, names in wanted.items()}


def _states(
    record: Recording,
    found: Plan,
    data: dict[int, dict[str, np.ndarray]],
    n_states: int,
    names: tuple[str, ...],
) -> dict[str, Array]:
    """Return the values of each channel in the simulator's units."""
    states = {}
    for name, (place, column, unit) in found.found.items():
        stream = record.streams[place]
        values = data[place][column]
        if values.dtype == object:
            row = next(row for row, cell in enumerate(values) if not is_number(str(cell).strip() or "nan"))
            raise LogError(
                f"{record.source}, {stream.place(row)}, column {column}",
                f"expected a number for {name}, got {str(values[row])[:40]!r}.",
                "Correct the cell, or empty it if it was not measured; or take another column for it.",
            )
        if np.isinf(values).any():
            row = int(np.argmax(np.isinf(values)))
            raise LogError(
                f"{record.source}, {stream.place(row)}, column {column}",
                f"expected a finite number for {name}, got {values[row]}.",
                "Correct the cell, or empty it if it was not measured.",
            )
        if len(values) and np.isnan(values).all():
            raise LogError(
                f"{record.source}, column {column}",
                f"is taken for {name} and holds no number.",
                "Leave the channel out, as not measured; or take another column."
                if name in names[:n_states]
                else "Take another column.",
                options={"columns": {name: "-" if name in names[:n_states] else "0"}},
            )
        states[name] = unit.applied(values)
    _align(states)
    return states


def _align(states: dict[str, Array]) -> None:
    """Give quaternions one sign from row to row, in place: between opposite ones nothing can be interpolated."""
    for name in [name for name in states if name.startswith("qpos.") and name.endswith(".qw")]:
        parts = [name[:-1] + part for part in "wxyz"]
        if not all(part in states for part in parts) or len({len(states[part]) for part in parts}) > 1:
            continue
        turned = np.asarray(sum(states[part][1:] * states[part][:-1] for part in parts)) < 0
        if turned.any():
            signs = np.cumprod(np.r_[1.0, np.where(turned, -1.0, 1.0)])
            states |= {part: signs * states[part] for part in parts}


def _labels(
    record: Recording, found: Plan, data: dict[int, dict[str, np.ndarray]], main: int, n_rows: int
) -> tuple[NDArray[np.intp], list[str]]:
    """Return the place of each row's episode in the list of their names, and that list."""
    if found.episode is None:
        return np.zeros(n_rows, dtype=np.int64), ["0"]
    place, column = found.episode
    if place != main:
        raise LogError(
            f"{record.source}, column {column}",
            "tells episodes apart, and is in another topic than the state.",
            options={"episodes": "gaps"},
        )
    values = data[place][column]
    stream = record.streams[place]
    if values.dtype.kind == "f":
        if not np.isfinite(values).all():
            row = int(np.argmax(~np.isfinite(values)))
            _no_episode(record, stream, column, row, "empty" if np.isnan(values[row]) else str(values[row]))
        starts = np.r_[True, values[1:] != values[:-1]]
        texts = [f"{value:g}" if value != int(value) else str(int(value)) for value in values[starts]]
    else:
        texts_all = np.array([str(value).strip() for value in values], dtype=object)
        if (texts_all == "").any():
            _no_episode(record, stream, column, int(np.argmax(texts_all == "")))
        starts = np.r_[True, texts_all[1:] != texts_all[:-1]]
        texts = texts_all[starts].tolist()
    if len(set(texts)) < len(texts):
        again = next(place for place, text in enumerate(texts) if text in texts[:place])
        row = int(np.flatnonzero(starts)[again])
        raise LogError(
            f"{record.source}, {stream.place(row)}, column {column}",
            f"episode {texts[again]} goes on after another one began; the rows of an episode stand together, in time "
            "order.",
            "Sort the rows; or leave the column aside, and let gaps in time tell episodes apart.",
            options={"episodes": "gaps"},
        )
    return np.cumsum(starts) - 1, texts


def _no_episode(record: Recording, stream: Stream, column: str, row: int, cell: str = "empty") -> NoReturn:
    raise LogError(
        f"{record.source}, {stream.place(row)}, column {column}",
        f"is {cell}, and tells episodes apart.",
        "Name the episode of every row; or leave the column aside.",
        options={"episodes": "gaps"},
    )


def _times(
    record: Recording,
    found: Plan,
    data: dict[int, dict[str, np.ndarray]],
    main: int,
    labels: NDArray[np.intp],
    simulator: Simulator,
    rate: float | None,
    n_rows: int,
    notes: list[str],
) -> tuple[Array, NDArray[np.bool_], float]:
    """Return (times in s of the main stream, rows that have one, usual step)."""
    if main not in found.times:
        step = _step_without_clock(record, simulator, rate)
        starts = np.flatnonzero(np.r_[True, labels[1:] != labels[:-1]])
        counted = np.arange(n_rows, dtype=np.float64) - np.repeat(starts, np.diff(np.append(starts, n_rows)))
        notes.append(
            f"The log has no times: rows are {step:g} s apart, as "
            + ("told." if rate or record.rate else "the simulator has it.")
        )
        return counted * step, np.ones(n_rows, dtype=bool), step
    column, unit = found.times[main]
    where = f"{record.source}, column {column}"
    times, in_unit, _ = clock.in_seconds(data[main][column], unit, where)
    if in_unit not in ("s", unit):
        notes.append(f"Times in {column} are taken as {in_unit}.")
    good = np.isfinite(times)
    if not good.any():
        raise LogError(
            where,
            "holds no times.",
            "Name the column of times, or leave it out and say the rate.",
            options={"columns": {"time": "-"}, "rate": 1 / simulator.dt if simulator.dt else 100.0},
        )
    if not good.all():
        notes.append(f"{int((~good).sum())} rows have no time: left out.")
    if good.sum() < 2:
        raise LogError(
            record.source, f"holds {int(good.sum())} rows.", f"Record a log with at least {FEWEST_ROWS}."
        )
    chosen = np.flatnonzero(good)
    apart = np.r_[True, labels[chosen][1:] != labels[chosen][:-1]]
    step = clock.usual_step(times[chosen], apart, where)
    return times, good, step


def _step_without_clock(record: Recording, simulator: Simulator, rate: float | None) -> float:
    if rate is not None:
        return 1 / rate
    if record.rate is not None:
        return 1 / record.rate
    settled = "frame_skip" not in simulator.get_params(deep=False) or simulator.frame_skip != 1
    if settled and simulator.dt is not None:
        return simulator.dt
    raise LogError(
        record.source,
        "has no column of times, and nobody has said how many rows a second it has.",
        "Say how many: rate=..., on the command line --rate; or name the column of times, as "
        "columns={'time': ...}, on the command line --map time=COLUMN.",
    )


def _stepped(
    simulator: Simulator, dt: float, rate: float | None, record: Recording
) -> tuple[Simulator, float, list[str]]:
    """Return (the simulator for rows of this log, their step in s, notes)."""
    notes: list[str] = []
    step = dt
    if rate is not None and rate * dt > MOST_RATES:
        raise LogError(
            record.source,
            f"has {1 / dt:.4g} rows per second; a rate of {rate:g} would make {rate * dt:.3g} of each.",
            f"Give a rate of {MOST_RATES} times the log's own at most.",
            options={"rate": float(f"{1 / dt:.4g}")},
        )
    if rate is not None:
        step = 1 / rate
    elif record.rate is not None and abs(dt * record.rate - 1) < SAME_RATE:
        step = 1 / record.rate
    if "frame_skip" not in simulator.get_params(deep=False):
        own_step = simulator.dt
        if own_step is None:
            raise ValueError(
                "The simulator has no dt, the seconds of a transition, to compare the log's times with."
            )
        taken = step if abs(dt / step - 1) <= SAME_RATE else dt
        if taken > own_step * (1 + STEP_TOLERANCE):
            raise LogError(
                record.source,
                f"{taken:g} s from row to row, while a transition of the simulator takes {own_step:g} s (dt).",
                "Write the function for the log's step, or record faster.",
            )
        return simulator, own_step, notes
    changed, exact = at_rate(simulator, step)
    own_step = changed.dt / changed.frame_skip
    before = simulator.dt / simulator.frame_skip
    if abs(own_step / before - 1) > STEP_TOLERANCE:
        notes.append(
            f"{step:.6g} s from row to row is no multiple of the model's time step of {before:g} s: it is simulated in "
            f"{changed.frame_skip} steps of {own_step:.6g} s."
        )
    return changed, exact, notes


def _log(
    record: Recording,
    found: Plan,
    simulator: Simulator,
    grid: Array,
    groups: NDArray[np.intp],
    own: list[clock.Piece],
    errors: dict[str, float],
    n_states: int,
    notes: list[str],
) -> Log:
    """Return the log of values on a grid."""
    _normalise(grid, simulator)
    times = np.concatenate(
        [piece.start + piece.spacing * np.arange(piece.size) for piece in own] or [np.empty(0)]
    )
    known = np.isfinite(grid[:, n_states:]).all(axis=1)
    if not known.all():
        notes.append(f"{int((~known).sum())} rows are left out, before the first command.")
        grid, groups, times = grid[known], groups[known], times[known]
    measured = np.any(np.isfinite(grid[:, :n_states]), axis=1)
    first = np.r_[True, groups[1:] != groups[:-1]][: len(groups)]
    seen = int((measured[:-1] & ~first[1:]).sum()) if len(grid) else 0
    if seen < FEWEST_ROWS:
        raise LogError(
            record.source,
            f"holds {max(seen, 0)} transitions in {int(first.sum())} episodes; at least {FEWEST_ROWS} are needed.",
            "Record longer, or give several logs.",
        )
    if int(first.sum()) == 1:
        X, y, rows = grid[:-1], grid[1:, :n_states], groups[:-1]
        times = times[:-1]
    else:
        arrivals = np.flatnonzero(~first)
        X, y, rows, times = (
            grid[arrivals - 1],
            grid[arrivals, :n_states],
            groups[arrivals],
            times[arrivals - 1],
        )
    changes = np.r_[True, rows[1:] != rows[:-1]]
    present, renumbered = rows[changes], np.cumsum(changes) - 1
    if errors:
        notes.append(
            "Error of interpolation (standard deviation): "
            + ", ".join(
                f"{name} {size:.2g} {simulator.units.get(name, '')}".rstrip() for name, size in errors.items()
            )
            + "."
        )
    for array in (X, y, renumbered, times):
        array.flags.writeable = False
    return Log(
        X=X,
        y=y,
        groups=renumbered,
        group_names=tuple(own[group].name for group in present),
        time=times,
        simulator=simulator,
        matches=found.matches,
        notes=tuple(notes),
        interpolation=errors,
        source=record.source,
        actions=found.actions,
    )


def _normalise(grid: Array, simulator: Simulator) -> None:
    """Give quaternions unit length, in place."""
    names = list(simulator.state_names)
    for column, name in enumerate(names):
        if not (name.startswith("qpos.") and name.endswith(".qw")):
            continue
        block = grid[:, column : column + 4]
        length = np.linalg.norm(block, axis=1)
        good = np.isfinite(length) & (np.abs(length - 1) < 0.2)
        moved = np.abs(length - 1) > 1e-6
        block[good & moved] /= length[good & moved, None]


def _check_degrees(log: Log, found: Plan, record: Recording) -> None:
    """Raise where angles that nobody gave a unit are in degrees."""
    angles = [
        name
        for name in log.simulator.angle_names
        if name not in found.told_units and name not in log.unmeasured
    ]
    if not angles:
        return
    said = in_degrees(log.simulator, log, told=found.told_units)
    if said is None:
        return
    advice = "If they are in rad, say so by units=\"rad\" (--map '*=:rad')."
    if any(note.startswith("LeRobot") for note in record.notes):
        advice += (
            " If they are in LeRobot's percentages of the calibrated range: --map 'qpos.*=:percent:-100:100' --map "
            "'ctrl.*=:percent:-100:100'."
        )
    raise LogError(record.source, said.sentence, advice, options=said.options)
