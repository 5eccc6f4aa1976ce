"""Signs that a log is not what it seems: stuck channels, late commands, other units, jumps, made or late velocities."""

import warnings
from itertools import permutations

import numpy as np

from skat.diagnosis.log import measured_channels
from skat.simulators.base import HALF_TURNS

# Share of an actuator's commands beyond its range that is worth a warning.
CLIPPED_SHARE = 0.01
# The log in degrees is tried where an angle leaves a full turn; it must fit so many times better in radians, and is
# refused where it does so by far.
BETTER_IN_RADIANS = 2.0
CERTAIN_IN_RADIANS = 10.0
ROWS_TRIED = 200
# What a simulation's outputs for the same rows may differ by, as a share of each channel's spread: rounding.
SAME = 1e-6
# Commands are late where the simulation misses so many times less with those of the row after, in rows in which they
# change.
BETTER_IF_EARLIER = 2.0
FEWEST_CHANGES = 20
# The state jumps in a row in which so many of the channels miss by more than the first share of their spread, if they
# miss by less than the second one in a typical row, and jumps are no larger a share of the rows than the third.
MOST_CHANNELS = 0.75
JUMP = 0.3
SMOOTH = 0.05
MOST_JUMPS = 0.1
# Velocities that nine rows in ten have as a difference of positions, this much better than velocities that the
# simulation makes, were computed from them.
DIFFERENCED_SHARE = 0.05
MOST_ROWS = 0.9
# They must also be closer than this share of what differences change by from row to row. Where nothing moves, that is
# 6 ** .5 of the noise of positions, and differences miss a velocity of its own by 2 ** .5 of it, central ones by half
# of that.
QUIET_SHARE = 0.15

# Velocities lag the positions if they do by so many standard errors, and by more than this share of a row's duration.
# They are summed over so many rows, of joints whose position is in the simulation what the velocity sums up to, but for
# this share; what misses by more than so many deviations, as where an angle starts anew, counts no more.
PLAIN_LAG = 5.0
LEAST_LAG = 0.03
ROWS_SUMMED = 10
SUMS_UP = 0.2
LARGEST_MISS = 5.0

# Noise found along whole episodes, so many times that of neighbouring rows, holds more than noise.
MORE_THAN_NOISE = 2.0


def warn_of_doubts(simulator, log, hidden=()):
    """Warn of what in a log is well-formed but hardly meant.

    Parameters
    ----------
    simulator : Simulator
    log : Log
    hidden : sequence of str
        State channels that were not measured.

    Raises
    ------
    ValueError
        If angles are in degrees, or the simulation is random.
    """
    _check_same_again(simulator, log)
    for doubt in (
        *_constant(simulator, log, hidden),
        *_clipped(simulator, log),
        *(_degrees(simulator, log, hidden) or _wrapped(simulator, log, hidden)),
        *_late(simulator, log, hidden),
        *_jumps(simulator, log, hidden),
        *(_differenced(simulator, log, hidden) or _lagging(simulator, log, hidden)),
    ):
        warnings.warn(doubt, UserWarning, stacklevel=3)


def warn_of_lasting_noise(simulator, log, hidden, deviations):
    """Warn where noise, found along whole episodes, is larger than neighbouring rows show.

    Third differences of a smooth motion leave the noise of the sensor, whose variance they have twentyfold.

    Parameters
    ----------
    simulator : Simulator
    log : Log
    hidden : sequence of str
        State channels that were not measured.
    deviations : ndarray of shape (n_measured_channels,)
        The noise found.
    """
    measured = measured_channels(simulator, hidden)
    together = (log.episodes[3:] == log.episodes[:-3])[:, None]
    steps = simulator.residual(log.y[1:], log.y[:-1])[:, measured]
    thirds = np.where(together, steps[2:] - 2 * steps[1:-1] + steps[:-2], 0.0)
    seen = np.sqrt(np.sum(thirds**2, axis=0) / (20 * max(together.sum(), 1)))
    # Of a slow motion most differences are zero where the sensor has steps.
    step = np.min(np.where(steps != 0, np.abs(steps), np.inf), axis=0)
    seen = np.maximum(seen, np.where(np.isfinite(step), step, 0.0) / np.sqrt(12))
    for name, found, least in zip(np.array(simulator.residual_names)[measured], deviations, seen):
        if found > MORE_THAN_NOISE * least > 0:
            unit = f" {simulator.units[name]}" if name in simulator.units else ""
            warnings.warn(
                f"The noise found in {name} is {found:.2g}{unit}, but neighbouring rows differ as if it were at most "
                f"{least:.2g}{unit}: something that lasts passes for noise, and the verdict may be too good. If you "
                "know the sensors' noise, give it by noise=.",
                UserWarning,
                stacklevel=3,
            )


def _check_same_again(simulator, log):
    """Raise if the simulation gives other outputs when it is asked for the same rows again."""
    some = log.rows(np.arange(min(len(log), ROWS_TRIED)))
    first, again = (simulator.predict_many(some.X, [{}], groups=some.groups)[0] for _ in range(2))
    spread = simulator.residual(some.y, np.broadcast_to(some.y[:1], some.y.shape)).std(axis=0)
    differences = np.abs(np.nan_to_num(simulator.residual(again, first))) / np.where(spread > 0, spread, 1.0)
    differences[np.isfinite(first).all(axis=1) != np.isfinite(again).all(axis=1)] = np.inf
    if differences.max() > SAME:
        row, channel = np.unravel_index(np.argmax(differences), differences.shape)
        raise ValueError(
            f"The simulation is not the same when it is asked again: {simulator.residual_names[channel]} in row {row} "
            f"differs by {differences[row, channel]:.2g} of its spread. Effects are told by how predictions change, so "
            "these must depend on the rows and the effects alone: seed what is random anew in each call, and keep "
            "nothing from one call to the next."
        )


def _constant(simulator, log, hidden):
    """Name channels that never change although the simulation changes them."""
    names = [
        name
        for column, name in enumerate(simulator.output_names)
        if name not in hidden and np.ptp(log.y[:, column]) == 0
    ]
    moving = []
    if names:
        some = log.rows(np.arange(min(len(log), ROWS_TRIED)))
        predicted = simulator.predict_many(some.X, [{}], groups=some.groups)[0]
        for name in names:
            column = simulator.output_names.index(name)
            if np.max(np.nan_to_num(np.abs(predicted[:, column] - some.y[:, column]))) > 1e-9:
                moving.append(name)
    if moving:
        yield (
            f"{', '.join(moving)} {'have' if len(moving) > 1 else 'has'} the same value in every row of y, but the "
            "simulation moves it. A channel that was not measured is no evidence: name it in hidden=; a sensor that "
            "is stuck must be left out of the log."
        )


def _clipped(simulator, log):
    """Name commands beyond the range that the simulation clips them to."""
    for name, (low, high) in simulator.command_limits.items():
        values = log.X[:, simulator.input_names.index(name)]
        reach = 1e-9 * (high - low)
        share = np.mean((values < low - reach) | (values > high + reach))
        if share > CLIPPED_SHARE:
            yield (
                f"{100 * share:.0f} % of {name} lie beyond [{low:g}, {high:g}], where the simulation clips them: the "
                "log may hold commands where the simulation expects what the actuator does, or another unit. "
                "Effects of this actuator are seen only in the other rows."
            )


def _degrees(simulator, log, hidden):
    """Return a text if angles leave a full turn and the simulation fits them better as degrees; raise if by far."""
    angles = [name for name in simulator.angle_names if name not in hidden]
    columns = [simulator.input_names.index(name) for name in angles]
    positions = [column for column, name in zip(columns, angles) if simulator.units.get(name) == "rad"]
    if not positions or np.abs(log.X[:, positions]).max() < 2 * np.pi:
        return ()
    some = log.rows(np.arange(min(len(log), ROWS_TRIED)))
    misses = []
    for factor in (1.0, np.pi / 180):
        X, y = some.X.copy(), some.y.copy()
        X[:, columns] *= factor
        y[:, columns] *= factor
        predicted = simulator.predict_many(X, [{}], groups=some.groups)[0]
        spread = y[:, columns].std(axis=0)
        errors = np.abs(y - predicted)[:, columns] / np.where(spread > 0, spread, 1.0)
        misses.append(np.median(np.nan_to_num(errors, nan=np.inf)))
    text = (
        f"{', '.join(angles)} look like degrees: read as such, the simulation's typical error falls from "
        f"{misses[0]:.2g} to {misses[1]:.2g} of their spread. The simulator's unit is rad (rad/s): convert with "
        "numpy.deg2rad."
    )
    if misses[1] * CERTAIN_IN_RADIANS < misses[0]:
        raise ValueError(text)
    return (text,) if misses[1] * BETTER_IN_RADIANS < misses[0] else ()


def _wrapped(simulator, log, hidden):
    """Name angles that jump by a full turn where the simulation turns on."""
    for name in simulator.state_names:
        half = HALF_TURNS.get(simulator.units.get(name, ""))
        if half is None or name in hidden:
            continue
        before, after = simulator.input_names.index(name), simulator.output_names.index(name)
        jumps = np.flatnonzero(np.abs(log.y[:, after] - log.X[:, before]) > half)
        if not len(jumps):
            continue
        some = log.rows(jumps)
        predicted = simulator.predict_many(some.X, [{}], groups=some.groups)[0][:, after]
        count = int(np.sum(np.abs(some.y[:, after] - predicted) > half))
        if count:
            yield (
                f"{name} jumps by about a full turn in {count} of {len(log)} rows, where the simulation turns on: an "
                "angle that starts anew at a full turn. Unwrap it within each episode (numpy.unwrap)."
            )


def _late(simulator, log, hidden):
    """Say that commands stand a row too late where the simulation fits better with those of the row after."""
    n_states = len(simulator.state_names)
    if not log.consecutive or hidden or n_states == log.X.shape[1] or simulator.n_lags():
        return
    changes = np.any(log.X[1:, n_states:] != log.X[:-1, n_states:], axis=1)
    rows = np.flatnonzero(changes & (np.diff(log.episodes) == 0))[:ROWS_TRIED]
    if len(rows) < FEWEST_CHANGES:
        return
    earlier = log.X[rows].copy()
    earlier[:, n_states:] = log.X[rows + 1, n_states:]
    misses = []
    for X in (log.X[rows], earlier):
        errors = _shares_of_spread(simulator, log.y[rows], simulator.predict_many(X, [{}])[0])
        misses.append(np.median(np.sqrt(np.mean(errors**2, axis=1))))
    if misses[1] * BETTER_IF_EARLIER < misses[0]:
        yield (
            "Commands look a row late: with those of the row after, the simulation's typical error falls from "
            f"{misses[0]:.2g} to {misses[1]:.2g} of the spread. The action in a row must be the one that acts from "
            "that row to the next; move the commands up by one row in each episode."
        )


def _jumps(simulator, log, hidden):
    """Name rows in which most of the state changes as the simulation never does it: another episode may begin there."""
    if not log.consecutive or hidden:
        return
    predicted = simulator.predict_many(log.X, [{}], groups=log.groups)[0]
    errors = _shares_of_spread(simulator, log.y, predicted)
    misses = np.quantile(errors, 1 - MOST_CHANNELS, axis=1, method="lower")
    rows = np.flatnonzero(misses > JUMP)
    if len(rows) and np.median(misses) < SMOOTH and len(rows) < MOST_JUMPS * len(log):
        some = ", ".join(map(str, rows[:5])) + (", ..." if len(rows) > 5 else "")
        yield (
            f"The state jumps in {'row' if len(rows) == 1 else 'rows'} {some}, in most channels at once, where the "
            "simulation goes on: does another episode begin behind it? Name the episode of each row (groups=; in a "
            "file the column episode), and leave out rows that lead from one into the next."
        )


def _shares_of_spread(simulator, y, predicted):
    """Return errors (n_rows, n_channels) as shares of each channel's spread; infinite where a simulation diverged."""
    spread = simulator.residual(y, np.broadcast_to(y[:1], y.shape)).std(axis=0)
    errors = np.abs(simulator.residual(y, np.where(np.isfinite(predicted), predicted, y)))
    errors[~np.isfinite(predicted).all(axis=1)] = np.inf
    return errors / np.where(spread > 0, spread, 1.0)


def _differenced(simulator, log, hidden):
    """Return texts that name velocities that were not measured but are differences of the log's positions."""
    pairs = _motions(simulator, hidden)
    some = log.rows(np.arange(min(len(log), ROWS_TRIED)))
    follows = np.flatnonzero(np.diff(some.episodes) == 0)
    if not log.consecutive or simulator.dt is None or not pairs or not len(follows):
        return []
    columns, state = np.array(pairs).T, len(simulator.state_names)
    simulated_now = some.X[follows + 1].copy()
    simulated_now[:, :state] = simulator.predict_many(some.X[follows], [{}])[0]
    follows, simulated_now = _finite(follows, simulated_now)
    simulated_after = simulator.predict_many(simulated_now, [{}])[0]
    follows, simulated_now, simulated_after = _finite(follows, simulated_now, simulated_after)
    if not len(follows):
        return []
    before, now, after = some.X[follows], some.X[follows + 1], some.y[follows + 1]
    measured = _misses(before, now, after, columns, simulator.dt)
    positions = columns[0]
    bends = np.abs(after[:, positions] - 2 * now[:, positions] + before[:, positions]) / simulator.dt
    changes = np.quantile(bends, MOST_ROWS, axis=0)
    simulated = _misses(before, simulated_now, simulated_after, columns, simulator.dt)
    texts = []
    for kind in measured:
        made = measured[kind] < np.minimum(DIFFERENCED_SHARE * simulated[kind], QUIET_SHARE * changes)
        found = [simulator.state_names[column] for column in columns[1, made]]
        if found:
            texts.append(
                f"{', '.join(found)} {'are' if len(found) > 1 else 'is'} no measurement of velocity, but {kind} "
                "differences of the positions in this log. Such a difference is the mean over a time, not the velocity "
                "at an instant, and it has the noise of the positions; either may pass for an effect, such as a scale "
                "of these channels, that the robot does not have. Log velocities that were measured, or name these in "
                "hidden=."
            )
    return texts


def _lagging(simulator, log, hidden):
    """Say that velocities lag the positions: a filter that delays them by a time makes their sum miss that much of it.

    What velocities that are late by a time sum up to lacks this time times their change. Their noise does not bias the
    ratio of the two: the change is the difference of its ends', the sum holds the sum of both. Errors in proportion to
    the sum, and constant ones, are other sensors' faults and regressed out. The simulation's own integrator may take
    the velocity at the end of a time step h for that of the step, so that its velocities lag by h / 2 (semi-implicit
    Euler). Reality has finer steps, or the same: any lag between none and the simulation's own is right.
    """
    pairs, dt = np.array(_motions(simulator, hidden)), simulator.dt
    starts = np.flatnonzero(log.steps % ROWS_SUMMED == 0)
    starts = starts[starts + ROWS_SUMMED <= len(log)]
    starts = starts[log.episodes[starts] == log.episodes[starts + ROWS_SUMMED - 1]]
    if not log.consecutive or dt is None or not len(pairs) or len(starts) < ROWS_SUMMED:
        return
    some = log.rows(np.arange(min(len(log), ROWS_TRIED)))
    predicted = simulator.predict_many(some.X, [{}], groups=some.groups)[0]
    finite = np.isfinite(predicted).all(axis=1)
    now, then = some.X[finite], predicted[finite]
    if len(now) < ROWS_SUMMED:
        return
    mean = (now[:, pairs[:, 1]] + then[:, pairs[:, 1]]) / 2
    moved, change = then[:, pairs[:, 0]] - now[:, pairs[:, 0]], then[:, pairs[:, 1]] - now[:, pairs[:, 1]]
    missed = moved - dt * mean
    own = np.sum(missed * change, axis=0) / np.maximum(np.sum(change**2, axis=0), 1e-300)
    sums_up = np.median(np.abs(missed - own * change), axis=0) < SUMS_UP * np.median(np.abs(moved), axis=0)
    pairs, own = pairs[sums_up], own[sums_up]
    first, last = log.X[starts], log.y[starts + ROWS_SUMMED - 1]
    rows = starts[:, None] + np.arange(ROWS_SUMMED)
    numerators, denominators = np.zeros((2, len(starts))), np.zeros(len(starts))
    for (position, velocity), by_itself in zip(pairs, own):
        change = last[:, velocity] - first[:, velocity]
        summed = dt * (log.X[rows, velocity].sum(axis=1) + change / 2)
        missed = last[:, position] - first[:, position] - summed
        others = np.stack([np.ones(len(starts)), summed / max(np.abs(summed).max(), 1e-300)], axis=1)
        fitted = np.linalg.lstsq(others, np.stack([missed, change], axis=1), rcond=None)[0]
        missed, change = (np.stack([missed, change], axis=1) - others @ fitted).T
        # Beside a world with steps as fine as can be, and beside one with those of the simulation.
        beside = missed - np.array([[0.0], [by_itself]]) * change
        size = 1.4826 * np.median(np.abs(beside), axis=1).min()
        if size > 0:
            numerators += np.clip(beside / size, -LARGEST_MISS, LARGEST_MISS) * change / size
            denominators += (change / size) ** 2
    if not denominators.any():
        return
    lags = numerators.sum(axis=1) / denominators.sum()
    errors = np.linalg.norm(numerators - lags[:, None] * denominators, axis=1) / denominators.sum()
    nearest = int(np.argmin(np.abs(lags)))
    lag, error = lags[nearest], errors[nearest]
    same_side = bool(np.all(lags > 0) or np.all(lags < 0))
    if same_side and abs(lag) > max(PLAIN_LAG * error, LEAST_LAG * dt):
        size = f"about {abs(lag):.2g} s ({abs(100 * lag / dt):.0f} % of a row)"
        yield (
            f"The velocities lag the positions by {size}, as if a low-pass filter had made them: that passes for a "
            "delay of the commands, or for other effects, that the robot does not have. Log velocities that are not "
            "filtered, or name them in hidden=, so that the positions alone tell."
            if lag > 0
            else f"The positions lag the velocities by {size}, as if a filter or another clock delayed them: that "
            "passes for effects that the robot does not have. Log positions and velocities at the same moments, or "
            "move the velocities back by that time."
        )


def _motions(simulator, hidden):
    """Return the columns of pairs (position, velocity) of which the second may be the rate of the first, both measured.

    MuJoCo's names tell; others pair wherever units do not speak against it.
    """
    states, units = simulator.state_names, simulator.units
    names, half = simulator.residual_names, len(simulator.residual_names) // 2
    if all(name.startswith(("qpos.", "qvel.")) for name in names):
        pairs = [pair for pair in zip(names[:half], names[half:]) if set(pair) <= set(states)]
    else:
        pairs = [
            (one, other)
            for one, other in permutations(states, 2)
            if not {one, other} <= set(units) or units[other] == f"{units[one]}/s"
        ]
    return [
        (states.index(one), states.index(other)) for one, other in pairs if not {one, other} & set(hidden)
    ]


def _finite(follows, *simulated):
    """Return the rows in which no simulation diverged."""
    kept = np.isfinite(simulated[-1]).all(axis=1)
    return follows[kept], *(table[kept] for table in simulated)


def _misses(before, now, after, columns, dt):
    """Return by how much velocities miss three differences of positions, of each joint, in all but a few rows."""
    positions, velocities = columns
    before, now, after, velocity = (
        table[:, chosen]
        for table, chosen in ((before, positions), (now, positions), (after, positions), (now, velocities))
    )
    rates = {
        "backward": (now - before) / dt,
        "forward": (after - now) / dt,
        "central": (after - before) / (2 * dt),
    }
    return {kind: np.quantile(np.abs(velocity - rate), MOST_ROWS, axis=0) for kind, rate in rates.items()}
