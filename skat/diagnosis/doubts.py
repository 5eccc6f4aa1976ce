"""What is suspicious about a log before the fit: a table of signs, each with the size from which it is worth a word.

A log may be well-formed and hardly meant: stuck channels, late commands, other units, jumps, quaternions in another
order. Whether velocities were measured at all is decided in `skat.diagnosis.velocities`.
"""

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from skat.diagnosis.chains import Array
from skat.diagnosis.log import Log
from skat.diagnosis.smoothing import SMOOTHED, smoothed_positions
from skat.diagnosis.statespace import quaternions, tangent_mask, tangents
from skat.diagnosis.velocities import motions, noise_variance
from skat.simulators import MujocoSimulator, Simulator
from skat.simulators.base import HALF_TURNS
from skat.simulators.stepping import quiet

# Rows that are simulated for a look.
ROWS_TRIED = 200
# Fewer rows in which commands change do not tell whether they are late.
FEWEST_CHANGES = 20
# The state jumps in a row in which so many of the channels miss by more than the first share of their spread, if they
# miss by less than the second one in a typical row, and jumps are no larger a share of the rows than the third.
MOST_CHANNELS = 0.75
JUMP = 0.3
SMOOTH = 0.05
MOST_JUMPS = 0.1
# Velocities lag the positions if they do by more than this share of a row's duration. They are summed over so many
# rows, of joints whose position is in the simulation what the velocity sums up to, but for this share; what misses by
# more than so many deviations, as where an angle starts anew, counts no more.
LEAST_LAG = 0.03
ROWS_SUMMED = 10
SUMS_UP = 0.2
LARGEST_MISS = 5.0
# A position is beyond its joint's range where more than this share of the rows are.
FEW = 0.02
# Of a channel's spread: what a solver may leave open in a channel without noise.
UNSEEN = 1e-3
HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True)
class Sign:
    """What a statistic finds in a log.

    `names`: columns concerned. `words`: what the doubt's sentence has beside them.
    """

    size: float
    names: tuple[str, ...] = ()
    words: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Doubt:
    """Something that a log may have and hardly anybody means.

    `statistic`: ``statistic(look)`` yields signs. `threshold`: A sign that is larger is worth a warning. `sentence`:
    with places for ``names``, ``has``, ``is`` and the sign's words. `refused`: A sign that is larger than this, too, is
    an error: no answer would be one. `unless`: names of doubts that explain this one. `together`: whether signs share a
    sentence.
    """

    name: str
    statistic: Callable[["Look"], Iterable[Sign]]
    threshold: float
    sentence: str
    refused: float = np.inf
    unless: tuple[str, ...] = ()
    together: bool = False

    def text(self, sign: Sign) -> str:
        """Return the sentence about a sign."""
        many = len(sign.names) > 1
        verbs = {"has": "have" if many else "has", "is": "are" if many else "is"}
        return self.sentence.format(names=", ".join(sign.names), **verbs, **sign.words)


@dataclass(frozen=True)
class Raised:
    """A doubt about a log: the doubt's name, the sentence, the size of the sign, and whether it forbids an answer."""

    name: str
    sentence: str
    size: float
    refused: bool


def warn_of_doubts(simulator: Simulator, log: Log, name: str = "") -> None:
    """Warn of what in a log is well-formed but hardly meant.

    `log`: NaN where nothing was measured. `name`: which log it is, where there are several. Raises a ValueError if
    angles are certainly in degrees, or the simulation is random.
    """
    for doubt in doubts_about(simulator, log):
        sentence = f"{name}: {doubt.sentence}" if name else doubt.sentence
        if doubt.refused:
            raise ValueError(sentence)
        warnings.warn(sentence, UserWarning, stacklevel=3)


def doubts_about(simulator: Simulator, log: Log) -> Iterator[Raised]:
    """Yield the doubts that a log raises, in the order of the table.

    `log`: NaN where nothing was measured.
    """
    look, raised = Look(simulator, log), set[str]()
    for doubt in DOUBTS:
        if raised & set(doubt.unless):
            continue
        signs = [sign for sign in doubt.statistic(look) if sign.size > doubt.threshold]
        if doubt.together and signs:
            largest = max(signs, key=lambda sign: sign.size)
            names = tuple(name for sign in signs for name in sign.names)
            signs = [Sign(largest.size, names, largest.words)]
        for sign in signs:
            raised.add(doubt.name)
            yield Raised(doubt.name, doubt.text(sign), sign.size, sign.size > doubt.refused)


@dataclass(frozen=True)
class Look:
    """A simulator and a log, with what several statistics ask of them."""

    simulator: Simulator
    log: Log

    @cached_property
    def few(self) -> Log:
        """The first rows, as measured."""
        return self.log.rows(np.arange(min(len(self.log), ROWS_TRIED)))

    @cached_property
    def predicted(self) -> Array:
        """What the simulation says of the first rows."""
        return self.simulate(self.few.filled)

    def simulate(self, log: Log) -> Array:
        """Return the outputs for the rows of a log without gaps, NaN where the simulation diverges."""
        return np.asarray(self.simulator.predict_many(log.X, [{}], groups=log.groups)[0])

    def is_measured(self, name: str) -> bool:
        """Whether an output was measured in any row."""
        return bool(np.isfinite(self.log.y[:, self.simulator.output_names.index(name)]).any())

    @cached_property
    def has_whole_rows(self) -> bool:
        """Whether every channel was measured, though perhaps not in every row."""
        return bool(self.log.complete.any())

    def spread(self, y: Array) -> Array:
        """Return the standard deviation of each channel of a residual, 1 where it does not change."""
        spread = tangents(self.simulator, y).std(axis=0)
        return np.where(spread > 0, spread, 1.0)

    def shares_of_spread(self, y: Array, predicted: Array) -> Array:
        """Return errors (n_rows, n_channels) as shares of each channel's spread; infinite where it diverged."""
        errors = np.abs(self.simulator.residual(y, np.where(np.isfinite(predicted), predicted, y)))
        errors[~np.isfinite(predicted).all(axis=1)] = np.inf
        return errors / self.spread(y)


def _random(look: Look) -> Iterator[Sign]:
    """By what share of its spread a channel differs when the simulation is asked for the same rows again."""
    first, again = look.predicted, look.simulate(look.few.filled)
    differences = np.abs(np.nan_to_num(look.simulator.residual(again, first))) / look.spread(
        look.few.filled.y
    )
    differences[np.isfinite(first).all(axis=1) != np.isfinite(again).all(axis=1)] = np.inf
    row, channel = np.unravel_index(np.argmax(differences), differences.shape)
    size = float(differences[row, channel])
    yield Sign(size, (look.simulator.residual_names[channel],), {"row": row, "share": f"{size:.2g}"})


def _constant(look: Look) -> Iterator[Sign]:
    """By how much the simulation moves a channel that never changes."""
    for column, name in enumerate(look.simulator.output_names):
        measured = look.log.y[:, column]
        measured = measured[np.isfinite(measured)]
        if len(measured) and np.ptp(measured) == 0:
            yield Sign(
                float(np.nanmax(np.abs(look.predicted[:, column] - measured[0]), initial=0.0)), (name,)
            )


def _clipped(look: Look) -> Iterator[Sign]:
    """Share of an actuator's commands beyond the range that the simulation clips them to."""
    for name, (low, high) in look.simulator.command_limits.items():
        values = look.log.X[:, look.simulator.input_names.index(name)]
        reach = 1e-9 * (high - low)
        share = float(np.mean((values < low - reach) | (values > high + reach)))
        yield Sign(share, (name,), {"percent": f"{100 * share:.0f}", "low": low, "high": high})


def _degrees(look: Look) -> Iterator[Sign]:
    """How many times better the simulation fits if angles, their rates or the commands of servos are degrees."""
    simulator, log = look.simulator, look.log
    angles = [name for name in simulator.angle_names if look.is_measured(name)]
    positions = [name for name in angles if simulator.units.get(name) == "rad"]
    if not positions:
        return
    columns = [simulator.input_names.index(name) for name in positions]
    beyond = [sign for sign in _beyond(look) if sign.size > 1 and sign.names[0] in positions]
    if np.nanmax(np.abs(log.X[:, columns]), initial=0.0) < 2 * np.pi and not beyond:
        return
    rates = [name for name in angles if name not in positions]
    aims, speeds = _commands_of_servos(simulator)
    tried: dict[tuple[str, ...], float] = {}
    for names in (
        (),
        (*positions, *rates, *aims, *speeds),
        (*positions, *rates),
        (*positions, *aims),
        tuple(positions),
    ):
        if names not in tried:
            tried[names] = _typical_miss(look, names, angles)
    plain = tried.pop(())
    best = min(tried, key=lambda names: tried[names])
    reach = "; ".join(_reach(sign) for sign in beyond[:3])
    yield Sign(
        plain / tried[best] if tried[best] > 0 else np.inf if plain > 0 else 1.0,
        best,
        {
            "before": f"{plain:.2g}",
            "after": f"{tried[best]:.2g}",
            "beyond": f" As they are, {reach}." if reach else "",
        },
    )


def _typical_miss(look: Look, in_degrees: Iterable[str], angles: list[str]) -> float:
    """Return the simulation's typical error of angles, as a share of their spread, if some columns are in degrees."""
    simulator = look.simulator
    scaled = [simulator.input_names.index(name) for name in in_degrees]
    states = [simulator.output_names.index(name) for name in in_degrees if name in simulator.output_names]
    X, y = look.few.X.copy(), look.few.y.copy()
    X[:, scaled], y[:, states] = np.deg2rad(X[:, scaled]), np.deg2rad(y[:, states])
    read = Log(X, y, look.few.episodes, look.few.consecutive, None, simulator)
    columns = [simulator.output_names.index(name) for name in angles]
    errors = np.abs(look.simulate(read.filled) - y)[:, columns]
    spread = np.nanstd(y[:, columns], axis=0)
    errors = np.nan_to_num(errors / np.where(spread > 0, spread, 1.0), nan=np.inf)
    return float(np.median(errors[np.isfinite(y[:, columns])]))


def _beyond(look: Look) -> Iterator[Sign]:
    """How many times the width of its joint's range a position is beyond it."""
    for name, (low, high) in _ranges(look.simulator).items():
        values = look.log.X[:, look.simulator.input_names.index(name)]
        values = values[np.isfinite(values)]
        if not len(values):
            continue
        first, last = np.quantile(values, [FEW, 1 - FEW])
        unit = look.simulator.units.get(name, "")
        words = {"value": f"{last if last - high > low - first else first:.3g}", "low": low, "high": high}
        yield Sign(float(max(last - high, low - first) / (high - low)), (name,), {**words, "unit": unit})


def _reach(sign: Sign) -> str:
    return "{0} reaches {value} where the joint allows {low:.3g} to {high:.3g} {unit}".format(
        *sign.names, **sign.words
    )


def _wrapped(look: Look) -> Iterator[Sign]:
    """In how many rows an angle jumps by a full turn where the simulation turns on."""
    simulator, log = look.simulator, look.log
    n_states = len(simulator.state_names)
    for name in simulator.state_names:
        half = HALF_TURNS.get(simulator.units.get(name, ""))
        if half is None:
            continue
        column = simulator.state_names.index(name)
        jumps = np.flatnonzero(np.abs(log.y[:, column] - log.X[:, column]) > half)
        if not len(jumps):
            continue
        # Rates that were not measured are guessed from an angle without the jumps.
        unwrapped = log.X.copy(), log.y.copy()
        for episode in np.unique(log.episodes[jumps]) if log.consecutive else ():
            rows = np.flatnonzero((log.episodes == episode) & np.isfinite(log.X[:, column]))
            ends = np.flatnonzero((log.episodes == episode) & np.isfinite(log.y[:, column]))
            unwrapped[0][rows, column] = np.unwrap(log.X[rows, column], period=2 * half)
            unwrapped[1][ends, column] = np.unwrap(log.y[ends, column], period=2 * half)
        X, y = unwrapped
        filled = Log(X, y, log.episodes, log.consecutive, None, simulator).filled.rows(jumps)
        X = np.column_stack([filled.X[:, :n_states], log.X[jumps, n_states:]])
        X[:, column] = log.X[jumps, column]
        predicted = simulator.predict_many(X, [{}], groups=np.arange(len(X)))[0][:, column]
        count = int(np.sum(np.abs(log.y[jumps, column] - predicted) > half))
        yield Sign(count, (name,), {"count": count, "rows": len(log)})


def _late(look: Look) -> Iterator[Sign]:
    """How many times better the simulation fits with the commands of the row after."""
    simulator, log = look.simulator, look.log
    n_states = len(simulator.state_names)
    if not log.consecutive or n_states == log.X.shape[1] or simulator.n_lags():
        return
    changes = np.any(log.X[1:, n_states:] != log.X[:-1, n_states:], axis=1)
    rows = np.flatnonzero(changes & (np.diff(log.episodes) == 0) & log.complete[:-1])[:ROWS_TRIED]
    if len(rows) < FEWEST_CHANGES:
        return
    earlier = log.X[rows].copy()
    earlier[:, n_states:] = log.X[rows + 1, n_states:]
    misses = []
    for X in (log.X[rows], earlier):
        errors = look.shares_of_spread(log.y[rows], simulator.predict_many(X, [{}])[0])
        misses.append(float(np.median(np.sqrt(np.mean(errors**2, axis=1)))))
    before, after = misses
    yield Sign(
        before / after if after > 0 else np.inf if before > 0 else 1.0,
        (),
        {"before": f"{before:.2g}", "after": f"{after:.2g}"},
    )


def _jumps(look: Look) -> Iterator[Sign]:
    """In how many rows most of the state changes as the simulation never does it."""
    log = look.log
    if not log.consecutive or not look.has_whole_rows:
        return
    whole = np.flatnonzero(log.complete)
    errors = look.shares_of_spread(log.y[whole], look.simulate(log.filled)[whole])
    misses = np.quantile(errors, 1 - MOST_CHANNELS, axis=1, method="lower")
    rows = whole[misses > JUMP]
    if np.median(misses) < SMOOTH and len(rows) < MOST_JUMPS * len(log):
        some = ", ".join(map(str, rows[:5])) + (", ..." if len(rows) > 5 else "")
        yield Sign(len(rows), (), {"rows": f"{'row' if len(rows) == 1 else 'rows'} {some}"})


def _lengths(look: Look) -> Iterator[Sign]:
    """By how much a quaternion's length differs from 1 in a typical row."""
    for joint, columns in quaternions(look.simulator.state_names):
        lengths = np.linalg.norm(look.log.y[:, columns], axis=1)
        lengths = lengths[np.isfinite(lengths)]
        if len(lengths):
            length = float(np.median(lengths))
            yield Sign(abs(length - 1), (joint,), {"length": f"{length:.3g}"})


def _orders(look: Look) -> Iterator[Sign]:
    """How many times better the simulation turns a quaternion whose real part is taken to come last."""
    simulator, few = look.simulator, look.few.filled
    for joint, columns in quaternions(simulator.state_names):
        seen = np.isfinite(look.few.y[:, columns]).all(axis=1) & np.isfinite(look.few.X[:, columns]).all(
            axis=1
        )
        if not seen.any():
            continue
        turns = [simulator.residual_names.index(f"{joint}.{axis}") for axis in ("rx", "ry", "rz")]
        misses = []
        for shift in (0, 1):
            X, y = few.X.copy(), few.y.copy()
            for table in (X, y):
                table[:, columns] = np.roll(table[:, columns], shift, axis=1)
            predicted = simulator.predict_many(X, [{}], groups=few.groups)[0]
            predicted = np.where(np.isfinite(predicted), predicted, y)
            missed = np.linalg.norm(simulator.residual(y, predicted)[:, turns], axis=1)
            misses.append(float(np.median(missed[seen])))
        before, after = misses
        yield Sign(before / max(after, 1e-12), (joint,), {"before": f"{before:.2g}", "after": f"{after:.2g}"})


def _lagging(look: Look) -> Iterator[Sign]:
    """By how many standard errors velocities lag the positions, or these them.

    What velocities that are late by a time sum up to lacks this time times their change. Their noise does not bias the
    ratio of the two: the change is the difference of its ends', the sum holds the sum of both. Errors in proportion to
    the sum, and constant ones, are other sensors' faults and regressed out. The simulation's own integrator may take
    the velocity at the end of a time step h for that of the step, so that its velocities lag by h / 2 (semi-implicit
    Euler). Reality has finer steps, or the same: any lag between none and the simulation's own is right.
    """
    simulator, log, dt = look.simulator, look.log, look.simulator.dt
    names = simulator.state_names
    found = [(names.index(one), names.index(other)) for one, other in motions(simulator)]
    found = [pair for pair in found if np.isfinite(log.y[:, pair]).all(axis=1).any()]
    starts = np.flatnonzero(log.steps % ROWS_SUMMED == 0)
    starts = starts[starts + ROWS_SUMMED <= len(log)]
    starts = starts[log.episodes[starts] == log.episodes[starts + ROWS_SUMMED - 1]]
    if not log.consecutive or dt is None or not found or len(starts) < ROWS_SUMMED:
        return
    pairs = np.array(found)
    now, then = look.few.X, look.predicted
    present = np.isfinite(then).all(axis=1) & np.isfinite(now[:, pairs.ravel()]).all(axis=1)
    now, then = now[present], then[present]
    if len(now) < ROWS_SUMMED:
        return
    mean = (now[:, pairs[:, 1]] + then[:, pairs[:, 1]]) / 2
    moved, change = then[:, pairs[:, 0]] - now[:, pairs[:, 0]], then[:, pairs[:, 1]] - now[:, pairs[:, 1]]
    missed = moved - dt * mean
    own = np.sum(missed * change, axis=0) / np.maximum(np.sum(change**2, axis=0), 1e-300)
    sums_up = np.median(np.abs(missed - own * change), axis=0) < SUMS_UP * np.median(np.abs(moved), axis=0)
    pairs, own = pairs[sums_up], own[sums_up]
    rows = starts[:, None] + np.arange(ROWS_SUMMED)
    numerators, denominators = np.zeros((2, len(starts))), np.zeros(len(starts))
    for (position, velocity), by_itself in zip(pairs, own):
        first, last = log.X[starts], log.y[starts + ROWS_SUMMED - 1]
        change = last[:, velocity] - first[:, velocity]
        summed = dt * (log.X[rows, velocity].sum(axis=1) + change / 2)
        missed = last[:, position] - first[:, position] - summed
        whole = np.isfinite(missed)
        if whole.sum() < ROWS_SUMMED:
            continue
        change, summed, missed = change[whole], summed[whole], missed[whole]
        others = np.stack([np.ones(len(summed)), summed / max(np.abs(summed).max(), 1e-300)], axis=1)
        fitted = np.linalg.lstsq(others, np.stack([missed, change], axis=1), rcond=None)[0]
        missed, change = (np.stack([missed, change], axis=1) - others @ fitted).T
        # Beside a world with steps as fine as can be, and beside one with those of the simulation.
        beside = missed - np.array([[0.0], [by_itself]]) * change
        size = 1.4826 * np.median(np.abs(beside), axis=1).min()
        if size > 0:
            numerators[:, whole] += np.clip(beside / size, -LARGEST_MISS, LARGEST_MISS) * change / size
            denominators[whole] += (change / size) ** 2
    if not denominators.any():
        return
    lags = numerators.sum(axis=1) / denominators.sum()
    errors = np.linalg.norm(numerators - lags[:, None] * denominators, axis=1) / denominators.sum()
    nearest = int(np.argmin(np.abs(lags)))
    lag, error = float(lags[nearest]), float(errors[nearest])
    if (np.all(lags > 0) or np.all(lags < 0)) and abs(lag) > LEAST_LAG * dt:
        words = {
            "lag": f"about {abs(lag):.2g} s ({abs(100 * lag / dt):.0f} % of a row)",
            "who": "The positions lag the velocities",
            "how": "as if a filter or another clock delayed them: that passes for effects that the robot does not "
            "have. Log positions and velocities at the same moments, or move the velocities back by that time",
        }
        if lag > 0:
            words |= {
                "who": "The velocities lag the positions",
                "how": "as if a low-pass filter had made them: that passes for a delay of the commands, or for other "
                "effects, that the robot does not have. Log velocities that are not filtered, or name them in hidden=, "
                "so that the positions alone tell",
            }
        yield Sign(abs(lag) / max(error, 1e-300), (), words)


def _smoothed(look: Look) -> Iterator[Sign]:
    """How many times more power there is about half of the Nyquist frequency than towards it, of each position.

    A sensor's noise has about as much in both. A filter of second order that was run forward and backward leaves a
    hundred thousandth above; so does a simulation of a smooth motion without any noise.
    """
    for name, size, _ in smoothed_positions(look.simulator, look.log):
        frequency = 0.25 / (look.simulator.dt or np.nan)
        yield Sign(size, (name,), {"frequency": f"{frequency:.3g}", "times": f"{size:.0e}"})


def _cold(look: Look) -> Iterator[Sign]:
    """By how much of its noise a channel depends on where the solver of contacts and friction begins."""
    simulator, few = look.simulator, look.few.filled
    if not isinstance(simulator, MujocoSimulator) or not few.consecutive:
        return
    model = simulator.compiled()
    if model.nq + model.nv + model.nu != few.X.shape[1]:
        return
    n_substeps = round(simulator.dt / model.opt.timestep)
    ends = [_stepped(model, few, n_substeps, warm=warm) for warm in (False, True)]
    ran = few.steps > 0
    for end in ends:
        ran &= np.isfinite(end).all(axis=1)
    if not ran.any():
        return
    differences = np.sqrt(np.mean(simulator.residual(ends[1][ran], ends[0][ran]) ** 2, axis=0))
    noise = _noise(look)
    spread = look.spread(look.log.filled.y)
    for name, difference, own, wide in zip(simulator.residual_names, differences, noise, spread):
        size = float(difference / max(own, UNSEEN * wide))
        words = {
            "iterations": int(model.opt.iterations),
            "difference": f"{difference:.2g} {simulator.units.get(name, '')}".strip(),
            "noise": f"{own:.2g}",
        }
        yield Sign(size, (name,), words)


def _stepped(model: mujoco.MjModel, log: Log, n_substeps: int, *, warm: bool) -> Array:
    """Return where plain MuJoCo takes each row, with a solver that begins with the solution before or with none."""
    data = mujoco.MjData(model)
    ends = np.full((len(log), model.nq + model.nv), np.nan)
    with quiet():
        for row, (values, step) in enumerate(zip(log.X, log.steps)):
            if step == 0:
                mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:], data.ctrl[:] = np.split(values, [model.nq, model.nq + model.nv])
            if not warm:
                data.qacc_warmstart[:] = 0
            mujoco.mj_step(model, data, n_substeps)
            ends[row] = np.r_[data.qpos, data.qvel]
    return ends


def _noise(look: Look) -> Array:
    """Return the standard deviation of the noise of each channel of a residual, as neighbouring rows show it."""
    simulator, log = look.simulator, look.log
    seen = tangent_mask(simulator, np.isfinite(log.y))
    series = np.where(seen, tangents(simulator, log.filled.y), np.nan)
    return np.array([np.sqrt(noise_variance(one, log.episodes)) for one in series.T])


def _ranges(simulator: Simulator) -> dict[str, tuple[float, float]]:
    """Return the range of each position whose joint has one."""
    if not isinstance(simulator, MujocoSimulator):
        return {}
    model, found = simulator.compiled(), {}
    for name, column in zip(simulator.state_names, range(model.nq)):
        joint = int(np.flatnonzero(model.jnt_qposadr <= column)[-1])
        low, high = (float(end) for end in model.jnt_range[joint])
        scalar = int(model.jnt_type[joint]) in (HINGE, SLIDE)
        if model.jnt_limited[joint] and scalar and high > low:
            found[name] = (low, high)
    return found


def _commands_of_servos(simulator: Simulator) -> tuple[list[str], list[str]]:
    """Return the inputs that say where an angle shall be, and those that say how fast it shall turn."""
    commands = simulator.input_names[len(simulator.state_names) :]
    aims = [name for name in commands if simulator.units.get(name) == "rad"]
    speeds = [name for name in commands if simulator.units.get(name) == "rad/s"]
    if isinstance(simulator, MujocoSimulator):
        model = simulator.compiled()
        for actuator, name in enumerate(commands):
            on_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
            turns = on_joint and int(model.jnt_type[model.actuator_trnid[actuator, 0]]) == HINGE
            if turns and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE:
                place, speed = model.actuator_biasprm[actuator, 1:3]
                if place or speed:
                    (aims if place else speeds).append(name)
    return aims, speeds


DOUBTS = (
    Doubt(
        "random",
        _random,
        1e-6,
        "The simulation is not the same when it is asked again: {names} in row {row} differs by {share} of its spread. "
        "Effects are told by how predictions change, so these must depend on the rows and the effects alone: seed what "
        "is random anew in each call, and keep nothing from one call to the next.",
        refused=1e-6,
    ),
    Doubt(
        "constant",
        _constant,
        1e-9,
        "{names} {has} the same value in every row of y, but the simulation moves it. A channel that was not measured "
        "is no evidence: let it be NaN, or name it in hidden=; a sensor that is stuck must be left out of the log.",
        together=True,
    ),
    Doubt(
        "degrees",
        _degrees,
        2.0,
        "{names} look like degrees: read as such, the simulation's typical error falls from {before} to {after} of "
        "their spread.{beyond} The simulator's unit is rad (rad/s): convert with numpy.deg2rad.",
        refused=10.0,
    ),
    Doubt(
        "clipped",
        _clipped,
        0.01,
        "{percent} % of {names} lie beyond [{low:g}, {high:g}], where the simulation clips them: the log may hold "
        "commands where the simulation expects what the actuator does, or another unit. Effects of this actuator are "
        "seen only in the other rows.",
        unless=("degrees",),
    ),
    Doubt(
        "beyond",
        _beyond,
        1.0,
        "{names} reaches {value} where the joint allows {low:.3g} to {high:.3g} {unit}: another unit, another joint's "
        "column, or a range that the robot does not have?",
        unless=("degrees",),
    ),
    Doubt(
        "wrapped",
        _wrapped,
        0,
        "{names} jumps by about a full turn in {count} of {rows} rows, where the simulation turns on: an angle that "
        "starts anew at a full turn. Unwrap it within each episode (numpy.unwrap).",
        unless=("degrees",),
    ),
    Doubt(
        "quaternion length",
        _lengths,
        0.02,
        "The quaternion of {names} has the length {length} in a typical row, not 1: are its columns qw, qx, qy, qz, "
        "all of them, and nothing else?",
    ),
    Doubt(
        "quaternion order",
        _orders,
        2.0,
        "The quaternion of {names} looks as if its real part came last: read as (x, y, z, w), the simulation misses "
        "the next orientation by {after} rad instead of {before} in a typical row. The order is qw, qx, qy, qz.",
        unless=("quaternion length",),
    ),
    Doubt(
        "late",
        _late,
        2.0,
        "Commands look a row late: with those of the row after, the simulation's typical error falls from {before} to "
        "{after} of the spread. The action in a row must be the one that acts from that row to the next; move the "
        "commands up by one row in each episode.",
    ),
    Doubt(
        "jumps",
        _jumps,
        0,
        "The state jumps in {rows}, in most channels at once, where the simulation goes on: does another episode begin "
        "behind it? Name the episode of each row (groups=; in a file the column episode), and leave out rows that lead "
        "from one into the next.",
    ),
    Doubt("lagging", _lagging, 5.0, "{who} by {lag}, {how}."),
    Doubt(
        "smoothed",
        _smoothed,
        SMOOTHED,
        "{names} {has} hardly any noise at high frequencies, {times} times less than at {frequency} Hz: smoothed "
        "forward and backward, as scipy.signal.filtfilt does, or never read by a sensor. What such a filter took from "
        "the motion passes for inertia, scales of sensors and delays that the robot does not have: give positions as "
        "they were read. Where no velocity was measured beside them such a filter is looked for, and undone if the log "
        "is likelier so. Of a simulation without noise it means nothing.",
        together=True,
    ),
    Doubt(
        "cold",
        _cold,
        0.3,
        "{names} {is} not what MuJoCo makes of a whole episode: with at most {iterations} iterations, the solver of "
        "contacts and friction ends elsewhere where it begins without the solution of the row before, as every row "
        "here does, by up to {difference} in a row (noise of that channel: {noise}). That passes for effects. Give the "
        'model more, such as <option iterations="100"/>, so that it does not matter where the solver begins.',
        together=True,
    ),
)
