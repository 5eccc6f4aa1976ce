"""Times of a log: their unit, the even grid behind them, what is lost, and values between samples."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from skat.logs.errors import LogError
from skat.logs.units import BASE, LEAST_DATE
from skat.simulators.tables import Array

# A sample this far from its place on the grid, in rows, counts as on it.
ON_GRID = 0.01
# More rows lost in a row than these begin another episode.
LONGEST_LOSS = 10
# Seconds from row to row that a robot's log may have; other numbers are in another unit.
SLOWEST, FASTEST = 0.5, 5e-4
# More rows than this share that go back in time, stand off their places or repeat a time: it is no clock of such rows.
FEW = 0.05
# Neighbours whose distance is more than so many rows have nothing between them.
BETWEEN = 1.5
# Nats of evidence for uneven samples, with less than which rows stay as they are.
CERTAIN = 3.0
TINY = np.finfo(np.float64).tiny
NO_TIME = np.iinfo(np.int64).min
# Seconds from 1970 to 2001; a clock that counts others from its start hardly comes so far.
RECENT = 1e9
# What a stamp in seconds since 1970 is at least, by unit.
DATES = (("ns", 1e17), ("us", 1e14), ("ms", 1e11), ("s", LEAST_DATE))


def in_seconds(
    values: np.ndarray, unit: str | None, where: str, origin: Fraction | None = None
) -> tuple[Array, str, Fraction]:
    """Return times in s, the unit they were in, and the origin that was subtracted, in s.

    Parameters
    ----------
    values : ndarray of shape (n_rows,)
        Numbers, or texts in ISO 8601.
    unit : str or None
        "s", "ms", "us" or "ns"; None: found out, from stamps since 1970 and from the distance of rows.
    where : str
        For messages.
    origin : Fraction, optional
        That of another stream of the log, s; a float has no nanoseconds since 1970. None: the first stamp where that is
        a date, otherwise 0.

    Raises
    ------
    LogError
        If they are no times.
    """
    if values.dtype == object:
        whole = _iso(values, where)
        if origin is None:
            origin = Fraction(int(next((stamp for stamp in whole if stamp != NO_TIME), 0)), 10**9)
        seconds = (whole - round(origin * 10**9)) / 1e9
        return np.where(whole == NO_TIME, np.nan, seconds), "ISO 8601", origin
    if unit is not None and (unit not in BASE or BASE[unit][1] != "S"):
        raise LogError(
            where, f"has the unit {unit!r}, which is none of time.", options={"units": {"time": "s"}}
        )
    unit = unit or _guessed_unit(values)
    factor = round(1 / BASE[unit][0])
    first = values[np.isfinite(values)][:1]
    if origin is None:
        is_date = len(first) and abs(first[0] / factor) >= LEAST_DATE
        origin = Fraction(float(first[0])) / factor if is_date else Fraction(0)
    moved = values - float(origin * factor) if origin else values
    return moved / factor if factor != 1 else moved, unit, origin


def _guessed_unit(values: Array) -> str:
    """Return the unit that stamps since 1970, or the distance of rows, show."""
    first = values[np.isfinite(values)][:1]
    if len(first) and abs(first[0]) >= LEAST_DATE:
        unit = next((name for name, least in DATES if abs(first[0]) >= least), "s")
        if unit != "s":
            return unit
    steps = np.diff(values)
    steps = steps[np.isfinite(steps) & (steps > 0)]
    usual = float(np.median(steps)) if len(steps) else 0.0
    # Stamps of whole seconds are as far apart as a millisecond's, and dates show which they are.
    if usual < 2 * SLOWEST or (usual == 2 * SLOWEST and first[0] >= RECENT):
        return "s"
    return next((name for name in ("ms", "us", "ns") if FASTEST <= usual * BASE[name][0] < SLOWEST), "s")


def _iso(values: np.ndarray, where: str) -> NDArray[np.int64]:
    """Return ns since 1970 of texts in ISO 8601."""
    try:
        stamps = pd.to_datetime(pd.Series(values), utc=True, format="ISO8601")
        return np.asarray(stamps.astype("datetime64[ns, UTC]"), dtype="datetime64[ns]").astype(np.int64)
    except (ValueError, TypeError, OverflowError) as error:
        raise LogError(
            where,
            f"holds no times: {str(error).split('.')[0][:150]}.",
            "Expected numbers, or ISO 8601 as 2024-05-01T12:00:00.010Z.",
        ) from None


@dataclass(frozen=True)
class Piece:
    """Rows of one episode without gaps, and the even grid that they are put on.

    Attributes
    ----------
    name : str
        The episode's.
    rows : ndarray of int of shape (n_samples,)
        In the stream.
    times : ndarray of shape (n_samples,)
        s.
    start : float
        Time of the first place of the grid.
    slots : ndarray of int of shape (n_samples,) or None
        Place of each sample on the grid; None where values are to be interpolated.
    size : int
        Number of places.
    spacing : float
        Between places, s of the log's own clock.
    acts : ndarray of shape (n_samples,) or None
        From when on the command of each sample acts, s; None: from its place, or else its time.
    slip : float
        Standard error of these times, s.
    """

    name: str
    rows: NDArray[np.intp]
    times: Array
    start: float
    slots: NDArray[np.int64] | None
    size: int
    spacing: float
    acts: Array | None = None
    slip: float = 0.0

    @property
    def command_times(self) -> Array:
        """From when on the command of each sample acts, s."""
        if self.acts is not None:
            return self.acts
        return self.times if self.slots is None else self.start + self.spacing * self.slots.astype(np.float64)


def usual_step(times: Array, apart: NDArray[np.bool_], where: str) -> float:
    """Return the usual distance of rows, s; `apart` marks rows that begin an episode.

    Raises
    ------
    LogError
        If time does not grow.
    """
    steps = np.diff(times)[~apart[1:]]
    backward = steps < 0
    growing = steps[steps > 0]
    if not len(growing) or backward.mean() > FEW:
        told = f"{backward.mean():.0%} of the steps go back" if backward.any() else "it stands still"
        raise LogError(
            where,
            f"time does not grow from row to row: {told}.",
            "Sort the rows by time, and check which column is the time.",
        )
    return float(np.median(growing))


def pieces(
    times: Array,
    labels: NDArray[np.intp],
    names: list[str],
    dt: float,
    where: Callable[[int], str],
    moves: Callable[[], Array],
) -> tuple[list[Piece], float, list[str]]:
    """Return the pieces of a log on a grid of its own step, that step, and notes.

    Parameters
    ----------
    times : ndarray of shape (n_rows,)
        s.
    labels : ndarray of int of shape (n_rows,)
        Place of each row's episode in the names.
    names : list of str
        Of the episodes.
    dt : float
        The usual step, s.
    where : callable
        Says where a row stands.
    moves : callable
        Returns positions of shape (n_rows, n_positions), which tell whether stamps or samples jitter.
    """
    notes: list[str] = []
    apart = np.r_[True, labels[1:] != labels[:-1]]
    steps = np.diff(times, prepend=times[0] - dt)
    back = np.flatnonzero((steps < 0) & ~apart)
    if len(back):
        starts = np.flatnonzero(apart)
        firsts = times[starts[np.searchsorted(starts, back, side="right") - 1]]
        restarts = times[back] <= firsts + 2 * dt
        if not restarts.all():
            row = int(back[~restarts][0])
            raise LogError(
                where(row),
                f"time goes back by {-steps[row]:.6g} s.",
                "Sort the rows by time, or name the column of episodes.",
            )
        notes.append(f"The clock starts anew {len(back)} times: an episode each.")
        apart[back] = True
    same = (steps == 0) & ~apart
    keep = ~same
    if same.mean() > FEW:
        _check_fine(times, same, apart, dt, where, moves())
    if same.any():
        notes.append(f"{int(same.sum())} rows repeat the time of the row before: left out.")
    gaps = np.flatnonzero(keep)
    wide = np.diff(times[gaps], prepend=times[0]) > (LONGEST_LOSS + 1) * dt
    wide &= ~apart[gaps]
    if wide.any():
        notes.append(
            f"{int(wide.sum())} gaps of more than {LONGEST_LOSS} rows: an episode begins behind each."
        )
    begins = apart[gaps] | wide
    groups = [part for part in np.split(gaps, np.flatnonzero(begins)) if len(part)]
    dt = refined(times, groups, dt)
    placed = [_on_grid(times[rows], dt) for rows in groups]
    worst = max((float(np.abs(jitter).max()) for _, _, jitter in placed), default=0.0) / dt
    has_grid = _is_on_places(np.concatenate([jitter for _, _, jitter in placed]), dt)
    snap = worst <= ON_GRID
    if not snap and has_grid and not _samples_jitter(times, groups, placed, moves()):
        snap = True
        notes.append(
            f"The time stamps jitter by up to {worst * 1e3 * dt:.3g} ms, and positions do not show that samples do: "
            "rows are taken as even."
        )
    elif not snap:
        notes.append(
            f"The clock is uneven, by up to {worst * 1e3 * dt:.3g} ms: positions are interpolated onto even times."
        )
    found = []
    counts: dict[str, int] = {}
    for rows, (start, slots, _) in zip(groups, placed):
        name = names[labels[rows[0]]]
        counts[name] = counts.get(name, 0) + 1
        name = name if counts[name] == 1 else f"{name} ({counts[name]})"
        found.append(
            Piece(
                name,
                rows,
                times[rows],
                start if snap else times[rows[0]],
                slots if snap else None,
                int(slots.max()) + 1,
                dt,
            )
        )
    lost = sum(piece.size - len(piece.slots) for piece in found if piece.slots is not None)
    if lost:
        whole = sum(piece.size for piece in found)
        notes.append(
            f"{lost} of {whole} rows are lost ({lost / whole:.2g} of them): not measured there, commands held."
        )
    return found, dt, notes


def _check_fine(
    times: Array,
    same: NDArray[np.bool_],
    apart: NDArray[np.bool_],
    dt: float,
    where: Callable[[int], str],
    moves: Array,
) -> None:
    """Raise where many rows that repeat the time of the row before are no copies of it."""
    rows = np.flatnonzero(same)
    moved = rows[(np.abs(moves[rows] - moves[rows - 1]) > 0).any(axis=1)]
    if len(moved) <= FEW * len(times):
        return
    later = np.flatnonzero(~same & ~apart)
    lasts = np.diff(times[later])
    usual = (lasts > 0) & (lasts < BETWEEN * dt)
    rate = np.diff(later)[usual].sum() / lasts[usual].sum() if usual.any() else 1 / dt
    raise LogError(
        where(int(moved[0])),
        f"{same.mean():.0%} of the rows repeat the time of the row before, and positions move meanwhile.",
        "Name a column of times that are finer; or leave it out and say the rate.",
        options={"columns": {"time": "-"}, "rate": float(f"{rate:.4g}")},
    )


def evened(piece: Piece) -> Piece | None:
    """Return the piece on the even grid behind its times, from which its commands act; None: there is none."""
    found = even_times(piece.times, piece.spacing)
    if found is None:
        return None
    acts, slip = found
    first = acts[0] + piece.spacing * np.ceil((piece.times[0] - acts[0]) / piece.spacing - ON_GRID)
    size = int((piece.times[-1] - first) / piece.spacing + ON_GRID) + 1
    return replace(piece, start=float(first), size=size, acts=acts, slip=slip)


def even_times(times: Array, dt: float) -> tuple[Array, float] | None:
    """Return the even times behind jittering ones and their standard error, s; None where there are none."""
    start, slots, jitter = _on_grid(times, dt)
    if not _is_on_places(jitter, dt):
        return None
    # The start is a median of them; what the step is out by adds as much again, on the average.
    slip = float(np.std(jitter) * np.sqrt(2 * np.pi / 2 / len(jitter)))
    return start + dt * slots.astype(np.float64), slip


def refined(times: Array, groups: list[NDArray[np.intp]], dt: float) -> float:
    """Return the step that fits all stamps best; pieces have one step, and beginnings of their own."""
    # The median over twice as many rows each time, so that neither an inexact step nor late stamps miscount them.
    reach = 2
    while any(len(rows) > reach for rows in groups):
        apart = np.concatenate([times[rows[reach:]] - times[rows[:-reach]] for rows in groups])
        dt = _near(float(np.median(apart / np.maximum(np.rint(apart / dt), 1))), dt)
        reach *= 2
    upper = lower = 0.0
    for rows in groups:
        if len(rows) < 3:
            continue
        places = _on_grid(times[rows], dt)[1]
        places = places - places.mean()
        upper += float(places @ (times[rows] - times[rows].mean()))
        lower += float(places @ places)
    return _near(upper / lower, dt) if lower else dt


def _near(better: float, dt: float) -> float:
    return better if abs(better / dt - 1) < 0.1 else dt


def _on_grid(times: Array, dt: float) -> tuple[float, NDArray[np.int64], Array]:
    """Return (start, places, distance from them in s) of the samples of a piece.

    A place is the number of rows before it and of those lost, which never falls: of such numbers those that lie closest
    to all stamps, so that a late one neither loses a row nor takes the place of the next.
    """
    rows, turns = np.arange(len(times)), (times - times[0]) / dt
    # How far places are from whole steps after the first row, which no lost row changes.
    phase = np.angle(np.exp(2j * np.pi * turns).mean()) / (2 * np.pi)
    slots = rows + np.rint(isotonic_regression(turns - phase - rows).x).astype(np.int64)
    slots -= slots[0]
    start = float(np.median(times - slots * dt))
    return start, slots, times - start - slots * dt


def _is_on_places(jitter: Array, dt: float) -> bool:
    """Whether all but a few samples are nearer to their places than to others."""
    return float(np.mean(np.abs(jitter) > dt / 2)) <= FEW


def _samples_jitter(
    times: Array,
    groups: list[NDArray[np.intp]],
    placed: list[tuple[float, NDArray[np.int64], Array]],
    moves: Array,
) -> bool:
    """Whether positions move further where stamps are further apart: the samples themselves are uneven.

    The evidence is the logarithm of a ratio of likelihoods: of what positions miss in the middle of five steps if they
    go on evenly by stamps, and of what they miss if by places. Where there is too little, what stamps jitter by is
    nothing beside the noise, and rows stay as they were measured.
    """
    by_places, by_stamps, count = (np.zeros(moves.shape[1]) for _ in range(3))
    for rows, (_, slots, _) in zip(groups, placed):
        if len(rows) < 8:
            continue
        q = moves[rows]
        moved, within = np.diff(q, axis=0)[2:-2], q[5:] - q[:-5]
        for missed, at in ((by_places, slots), (by_stamps, times[rows])):
            share = np.diff(at)[2:-2] / (at[5:] - at[:-5])
            missed += np.nansum((moved - share[:, None] * within) ** 2, axis=0)
        count += np.isfinite(moved - within).sum(axis=0)
    ratios = np.log(np.maximum(by_places, TINY) / np.maximum(by_stamps, TINY))
    return float(np.sum(count / 2 * ratios)) > CERTAIN


def resampled(found: list[Piece], dt: float, step: float, *, same: bool = False) -> tuple[list[Piece], str]:
    """Return the pieces on a grid of another step, and how: from every so many rows, or interpolated.

    Parameters
    ----------
    found : list of Piece
    dt : float
        Step of the log's clock, s.
    step : float
        Step of the grid, s.
    same : bool, default=False
        Whether the two are known to be the same, whatever the clock says.
    """
    every, even = round(step / dt), all(piece.slots is not None for piece in found)
    if every == 1 and (same or abs(step / dt - 1) <= 1e-3):
        return [piece if piece.slots is not None else _regridded(piece, step) for piece in found], ""
    if even and every >= 1 and abs(step / dt - every) <= 1e-3 * every:
        thinned = [_regridded(piece, piece.spacing * every) for piece in found]
        return thinned, f"Of {every} rows one is taken, with the mean command over them."
    how = f"Interpolated from {1 / dt:.6g} to {1 / step:.6g} rows per second."
    return [_regridded(piece, step) for piece in found], how


def _regridded(piece: Piece, step: float) -> Piece:
    """Return a piece whose values are taken at another step, from its first sample on."""
    times = piece.times if piece.slots is None else piece.command_times
    size = int((times[-1] - piece.start) / step + ON_GRID) + 1
    return replace(piece, times=times, slots=None, size=size, spacing=step)
