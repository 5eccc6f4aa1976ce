"""The channels of a log on the grid of its rows."""

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from skat.logs import clock
from skat.logs.between import Bends, Held, bends, interpolated
from skat.logs.errors import LogError
from skat.logs.matching import Plan
from skat.logs.streams import Recording
from skat.simulators.tables import Array


def on_grid(
    found: Plan,
    states: dict[str, Array],
    own: list[clock.Piece],
    kept: NDArray[np.intp],
    main: int,
    names: tuple[str, ...],
    n_states: int,
    times_of: dict[int, Array],
    acts: dict[int, Array],
) -> tuple[Array, NDArray[np.intp], dict[str, float]]:
    """Return (values on the grid, its episodes, errors of interpolation by channel)."""
    size = sum(piece.size for piece in own)
    grid = np.full((size, len(names)), np.nan)
    groups = np.repeat(np.arange(len(own)), [piece.size for piece in own])
    even = bool(own) and own[0].slots is not None
    apart = any(found.found[name][0] != main for name in states if name not in found.constants)
    held = (
        _held(found, states, own, kept, main, names[n_states:], times_of | acts) if apart or not even else []
    )
    errors: dict[str, float] = {}
    offsets = np.cumsum([0, *(piece.size for piece in own)])
    for column, name in enumerate(names):
        if name in found.constants:
            grid[:, column] = found.constants[name]
            continue
        if name not in states:
            continue
        place = found.found[name][0]
        values = states[name]
        parts = [grid[offset : offset + piece.size, column] for piece, offset in zip(own, offsets)]
        if place == main and even:
            for part, piece in zip(parts, own):
                part[piece.slots] = values[kept[piece.rows]]
                if column >= n_states:
                    _fill(part)
        elif column >= n_states:
            for part, piece, commands in zip(parts, own, held):
                part[:] = commands[name].mean(_even(piece), piece.spacing)
        else:
            if place == main:
                samples = [_in_order(piece.times, values[kept[piece.rows]]) for piece in own]
            else:
                samples = [_in_order(times_of[place], values)] * len(own)
            missed = _interpolate(parts, own, samples, held, kinked=not name.startswith("qpos."))
            if missed is not None:
                errors[name] = missed
        del values
        if column < n_states:
            states.pop(name)
    return grid, groups, errors


def _even(piece: clock.Piece) -> Array:
    return piece.start + piece.spacing * np.arange(piece.size, dtype=np.float64)


def _held(
    found: Plan,
    states: dict[str, Array],
    own: list[clock.Piece],
    kept: NDArray[np.intp],
    main: int,
    names: tuple[str, ...],
    times_of: dict[int, Array],
) -> list[dict[str, Held]]:
    """Return the commands of each piece."""
    told = [(name, found.found[name][0]) for name in names if name in states and name not in found.constants]
    apart = {name: Held.of(times_of[place], states[name]) for name, place in told if place != main}
    return [
        apart
        | {
            name: Held.of(piece.command_times, states[name][kept[piece.rows]])
            for name, place in told
            if place == main
        }
        for piece in own
    ]


def acting(
    found: Plan,
    states: dict[str, Array],
    own: list[clock.Piece],
    kept: NDArray[np.intp],
    main: int,
    names: tuple[str, ...],
    n_states: int,
    times_of: dict[int, Array],
) -> tuple[list[clock.Piece], dict[int, Array], str]:
    """Find whether commands act from uneven stamps on, or from the even times behind them.

    What jitters may be the reading of sensors and the writing of the log, under a controller that does not. The motion
    tells: velocities bend where commands act, and cubics miss them less with corners at the right places.

    Returns
    -------
    pieces : list of Piece
    times : mapping from the place of another stream to ndarray
        From when on its commands act, s.
    note : str
        "" where nothing is uneven.
    """
    moved = [name for name in states if name not in found.constants]
    commands = tuple(name for name in moved if name in names[n_states:])
    speeds = [
        name
        for name in moved
        if name in names[:n_states] and not name.startswith("qpos.") and found.found[name][0] == main
    ]
    others = {found.found[name][0] for name in commands} - {main}
    stamps = {place: times_of[place] for place in others}
    even = {place: times for place in others for times in [_evened(stamps[place])] if times is not None}
    uneven = bool(own) and own[0].slots is None
    evened = [piece for piece in map(clock.evened, own) if piece is not None] if uneven else own
    if not speeds or not commands or not (uneven or even) or len(evened) < len(own):
        return own, {}, ""

    def missed(pieces: list[clock.Piece], times: dict[int, Array]) -> float:
        held = _held(found, states, pieces, kept, main, commands, times)
        return sum(
            float(np.log(max(_bends(pieces, samples, held).missed, clock.TINY)))
            for name in speeds
            for samples in [[_in_order(piece.times, states[name][kept[piece.rows]]) for piece in pieces]]
        )

    if missed(evened, stamps | even) >= missed(own, stamps):
        return own, {}, ""
    return evened, even, "Stamps of commands jitter, commands do not: velocities bend at even times."


def _evened(stamps: Array) -> Array | None:
    """Return the even times behind a stream's stamps; None where they are even, or there are none."""
    good = np.flatnonzero(np.isfinite(stamps))
    times = stamps[good]
    if len(times) < 3 or (np.diff(times) <= 0).any():
        return None
    dt = clock.refined(times, [np.arange(len(times))], float(np.median(np.diff(times))))
    found = clock.even_times(times, dt)
    if found is None or np.abs(found[0] - times).max() <= clock.ON_GRID * dt:
        return None
    out = np.full(len(stamps), np.nan)
    out[good] = found[0]
    return out


def _in_order(stamps: Array, samples: Array) -> tuple[Array, Array]:
    """Return the samples that are there, each time once; none where time goes back."""
    good = np.isfinite(samples) & np.isfinite(stamps)
    stamps, samples = stamps[good], samples[good]
    fresh = np.r_[True, np.diff(stamps) > 0][: len(stamps)]
    stamps, samples = stamps[fresh], samples[fresh]
    if len(stamps) < 2 or (np.diff(stamps) <= 0).any():
        return stamps[:0], samples[:0]
    return stamps, samples


def _bends(own: list[clock.Piece], samples: list[tuple[Array, Array]], held: list[dict[str, Held]]) -> Bends:
    """Return by how much commands bend a channel."""
    within = []
    for piece, (stamps, values), commands in zip(own, samples, held):
        inside = slice(*np.searchsorted(stamps, [piece.times[0], piece.times[-1]], side="left"))
        within.append((stamps[inside], values[inside], list(commands.values())))
    usual = [float(np.median(np.diff(stamps))) for stamps, _, _ in within if len(stamps) > 1]
    return bends(within, float(np.median(usual)) if usual else 0.0)


def _interpolate(
    parts: list[Array],
    own: list[clock.Piece],
    samples: list[tuple[Array, Array]],
    held: list[dict[str, Held]],
    *,
    kinked: bool,
) -> float | None:
    """Write samples at the places of a grid, as they are where they were taken there, otherwise between them.

    Returns the error of interpolation, a standard deviation; None where there is none.
    """
    bent: Bends | None = None
    squares, count = 0.0, 0
    for part, piece, (stamps, values), commands in zip(parts, own, samples, held):
        if not len(stamps):
            continue
        at = _even(piece)
        usual = float(np.median(np.diff(stamps)))
        nearest = np.clip(np.searchsorted(stamps, at), 1, len(stamps) - 1)
        nearest -= at - stamps[nearest - 1] < stamps[nearest] - at
        on = np.abs(stamps[nearest] - at) <= clock.ON_GRID * min(piece.spacing, usual)
        rest = np.arange(len(at))
        if on.mean() > 0.5:
            part[on] = values[nearest[on]]
            on |= np.abs(stamps[nearest] - at) > usual / 2
            rest = np.flatnonzero(~on)
        if not len(rest):
            continue
        if bent is None and kinked:
            bent = _bends(own, samples, held)
        own_commands = list(commands.values())
        straight = values if bent is None else values - bent.share(own_commands, stamps)
        between, missed = interpolated(
            stamps,
            straight[:, None],
            at[rest],
            usual,
            kinked=bent is not None and not bent.told,
        )
        part[rest] = between[:, 0]
        if bent is not None and bent.told:
            part[rest] += bent.share(own_commands, at[rest])
            corners = bent.corner(own_commands, at[rest], piece.spacing / 2)
            missed = np.hypot(missed, piece.slip * corners[:, None])
        finite = np.isfinite(between[:, 0])
        squares += float(np.sum(missed[finite, 0] ** 2))
        count += int(finite.sum())
    return float(np.sqrt(squares / count)) if count else None


def _fill(part: Array) -> None:
    """Hold the last command where one is lost, in place."""
    lost = np.isnan(part)
    if not lost.any():
        return
    places = np.where(lost, 0, np.arange(len(part)))
    np.maximum.accumulate(places, out=places)
    part[:] = part[places]


def ended(
    record: Recording,
    found: Plan,
    own: list[clock.Piece],
    main: int,
    names: tuple[str, ...],
    times_of: dict[int, Array],
) -> list[str]:
    """Return a note for each other stream whose commands, of these names, end long before the rows do."""
    at = np.concatenate([_even(piece) for piece in own] or [np.empty(0)])
    notes = []
    for place in sorted({found.found[name][0] for name in names if name in found.found} - {main}):
        times = times_of[place]
        steps = np.diff(times[np.isfinite(times)])
        if not (steps > 0).any():
            continue
        last = float(np.nanmax(times))
        held = int((at > last + clock.LONGEST_LOSS * np.median(steps[steps > 0])).sum())
        if held:
            notes.append(
                f"Commands of {record.streams[place].name} end at {last:.6g} s: held for the last {held} rows."
            )
    return notes


def stream_times(
    record: Recording,
    found: Plan,
    data: dict[int, dict[str, np.ndarray]],
    place: int,
    main: int,
    clock_times: Array,
) -> Array:
    """Return the times of a stream, s, from the same origin as those of the main one.

    Raises
    ------
    LogError
        If it has none, none within those of the main one, or some of several runs.
    """
    if place == main:
        return clock_times
    stream = record.streams[place]
    if place not in found.times:
        raise LogError(
            record.where(stream),
            "has no times, and is another table than the state's.",
            "Name its column of times.",
        )
    column, unit = found.times[place]
    origin = Fraction(0)
    if main in found.times:
        _, _, origin = clock.in_seconds(data[main][found.times[main][0]], found.times[main][1], record.source)
    times = clock.in_seconds(data[place][column], unit, f"{record.source}, column {column}", origin)[0]
    rows, known = np.flatnonzero(np.isfinite(times)), clock_times[np.isfinite(clock_times)]
    if not len(rows):
        return times
    early, late = known.min() - times[rows].max(), times[rows].min() - known.max()
    if max(early, late) > 0:
        said = (
            f"ends {early:.6g} s before the state begins"
            if early > 0
            else f"begins {late:.6g} s after it ends"
        )
        raise LogError(
            record.where(stream),
            f"has no time in common with the state: it {said}.",
            "Write both clocks in one unit and from one origin. Commands that were given once, beforehand, are "
            "constants: --map 'ctrl.*=0.5'.",
        )
    steps = np.diff(times[rows])
    if (steps > 0).any() and steps.min() < -clock.LONGEST_LOSS * np.median(steps[steps > 0]):
        row = int(np.argmin(steps))
        raise LogError(
            f"{record.source}, {stream.place(int(rows[row + 1]))}",
            f"time goes back by {-steps[row]:.6g} s: rows of several runs cannot be told apart by their times.",
            "Give runs one by one, each a log.",
        )
    return times
