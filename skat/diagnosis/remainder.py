"""What is left of a log beside the causes: how large it is, what predicts it, and what it looks like over time.

A law of forces is asked of the whitened innovations, which it moves by the filter's response to its columns; the theory
page derives what it is worth. Its size comes from two halves of the log, blocks of time in turns: the mean of the
product of what either half has it to be is free of what each takes for the law by chance.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import signal

from skat.diagnosis.ahead import Seen, ahead, filtered
from skat.diagnosis.chains import Array, Chains, Mask, Memory, Places
from skat.diagnosis.evidence import Gram
from skat.diagnosis.filtering import Smoothed, kalman_filter, smooth
from skat.diagnosis.findings import Gain
from skat.diagnosis.fitting import NOTHING_KNOWN, Columns, Fitted, Known, response
from skat.diagnosis.laws import OWN_BINS, Law, Likeliest, Regressor, binned, likeliest, regressors_of
from skat.diagnosis.noise import Estimate, Noise, estimate_noise, passed
from skat.diagnosis.prediction import ends, horizon_rows, windows
from skat.diagnosis.statespace import StateSpace, steps_of

# Rows of a block of time, of which each half of a log has every other.
BLOCK_ROWS = 16
# What a force's own past is called, and how many rows of it there are from the horizon on.
PAST, PAST_ROWS = "its own past", 12
# Fewer episodes do not tell a law of time from chance.
EPISODES_FOR_TIME = 5
# Of a force's variance: where the sensors show less of it, there is no saying what it looks like.
LEAST_SHOWN = 0.1
# Rows of one spectrum, and draws of what the smoother shows of a white force.
SPECTRUM_ROWS, LEAST_SPECTRUM_ROWS, DRAWS = 128, 32, 4
# Of the square: what a word stands for holds more than half of it. An impact's rows are one in fifty; a vibration is
# within 15 % of its frequency; a drift has the lowest tenth of all frequencies.
MAJORITY, FEW_ROWS, WIDTH, SLOW = 0.5, 0.02, 0.15, 0.1


@dataclass(frozen=True)
class Left:
    """What is left in one direction: a force on a joint, or an error of one output.

    `rms`: of the force, what sensors hide of it included; no less than what is predictable. `scale`: root mean square
    of the force that the nominal model has there, same unit. `predictable`: root mean square of the part that the best
    single regressor predicts. `regressor`: that regressor, such as ``"|v|v"`` of a coordinate. `evidence`: what there
    is for a law in this direction, nats, corrected for all that was tried: above ln(1 / alpha) in at most a share alpha
    of logs in which nothing is left. `law`: of the best regressor's coordinate. `past`: share of the variance that is
    predicted a row ahead by the force's own past; 0 for a white one. `ahead`: what the predictable part adds to the
    mean square error at the horizon, in units of a right model's; 0 where there is more against a law than for it.
    `frequencies`, `spectrum` (n_frequencies,): Hz (or per row), and the power density of what no law but its own past
    predicts, as if sensors hid nothing. `word`: "drift", "vibration at 22 Hz", "impacts", "white", or "none" where
    sensors show no force.
    """

    name: str
    unit: str
    rms: float
    scale: float
    predictable: float
    regressor: str
    evidence: float
    law: Law
    past: float
    ahead: float
    frequencies: Array
    spectrum: Array
    word: str

    @property
    def share(self) -> float:
        """Share of the force's square that is predictable."""
        return min(1.0, (self.predictable / self.rms) ** 2) if self.rms > 0 else 0.0


@dataclass(frozen=True)
class Remainder:
    """What is left in each direction, that with most evidence of a law first."""

    parts: tuple[Left, ...]
    horizon: int

    @property
    def evidence(self) -> float:
        """Of the clearest law, nats."""
        return max((part.evidence for part in self.parts), default=-np.inf)


@dataclass(frozen=True)
class _Directions:
    """Where something may act: names, units, and the derivative of the next state, (n_rows, d, n)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    own: tuple[tuple[str, ...], ...]
    columns: Array
    forces: Array  # (n_rows, n), smoothed
    variances: Array
    scales: Array


def is_unexplained(
    remainder: Remainder, gain: Gain | None, *, tolerance: float = 0.1, alpha: float = 0.01
) -> bool:
    """Whether what is predictable, and no cause explains, is too much.

    `gain`: on the log held out, at the same horizon. `tolerance`: share of the excess error at the horizon that may be
    left; where a law that is left adds less than this share to a right model's error, of the joint's force.
    """
    clear = [part for part in remainder.parts if part.evidence > -np.log(alpha)]
    if not clear:
        return False
    ahead = sum(part.ahead for part in clear)
    if ahead > tolerance:
        explained = max(gain.nominal - gain.extended, 0.0) if gain is not None else 0.0
        return bool(ahead > tolerance * (explained + ahead))
    return any(part.predictable > tolerance * part.scale for part in clear)


def find_remainder(
    space: StateSpace,
    fitted: Fitted,
    *,
    known: Known = NOTHING_KNOWN,
    horizon: int | None = None,
    random_state: np.random.RandomState,
) -> Remainder:
    """Return what is left of a log beside the causes.

    `fitted`: on this log, at the values of the causes. `known`: of the sensors' noise. `horizon`: in rows; as
    `horizon_rows` by default. `random_state`: draws white forces, for comparison of spectra.
    """
    seen = Seen(fitted.linear, fitted.chains, fitted.estimate, fitted.memory)
    h = horizon_rows(space.simulator) if horizon is None else horizon
    directions, rows = _directions(space, fitted), _rows_as_known(space, seen)
    white = _white_spectra(space, fitted, directions, random_state)
    laws = [_likeliest(space, seen, directions, index, rows, h) for index in range(len(directions.names))]
    # What there is more against than for adds to no error.
    some = any(law.evidence > 0 for law in laws)
    runs = _runs(space, seen, fitted.values, h) if some else None
    # How large it is, is a matter of mean squares: heavy tails would take a law's largest forces for outliers.
    sized = _without_laws(space, seen, directions, laws, known)
    parts = [
        _left(space, seen, sized, directions, index, law, runs, (white[0], white[1][index]))
        for index, law in enumerate(laws)
    ]
    return Remainder(tuple(sorted(parts, key=lambda part: -part.evidence)), h)


def beside_laws(space: StateSpace, fitted: Fitted, columns: Columns, needed: float) -> Gram | None:
    """Return what is known of causes where laws act as well, if there are such laws, whatever the causes' values.

    A law that stands for no effect of the list is noise of a known shape, of a size that the log asks for. What a cause
    is worth beside it is what the law cannot do; a cause that is worth nothing there stands for the law.

    `columns`: of the causes, at this fit. `needed`: nats that there must be for a law.
    """
    seen = Seen(fitted.linear, fitted.chains, fitted.estimate, fitted.memory)
    directions, rows = _directions(space, fitted), _rows_as_known(space, seen)
    h = horizon_rows(space.simulator)
    taken = np.linalg.qr(columns.columns)[0]
    found = []
    for index in range(len(directions.names)):
        law = _likeliest(space, seen, directions, index, rows, h, taken)
        if law.evidence > needed:
            own = _response(space, seen, directions.columns[..., index], law.regressor.columns)
            found.append(own[seen.chains.mask] * law.size)
    if not found:
        return None
    acting = np.concatenate(found, axis=1)
    root = np.linalg.cholesky(np.eye(acting.shape[1]) + acting.T @ acting)
    half = np.linalg.solve(root, acting.T)
    moved, shown = half @ columns.columns, half @ columns.whitened
    gram = columns.gram
    return Gram(gram.products - moved.T @ moved, gram.projections - moved.T @ shown, gram.origin)


def _likeliest(
    space: StateSpace,
    seen: Seen,
    directions: _Directions,
    index: int,
    rows: Array,
    horizon: int,
    taken: Array | None = None,
) -> Likeliest:
    """Return the likeliest law of a direction, beside what orthonormal columns `taken` of innovations stand for."""
    scale, direction, n = (
        float(directions.scales[index]),
        directions.columns[..., index],
        len(directions.names),
    )
    simulator, own = space.simulator, directions.own[index]
    regressors = regressors_of(simulator, simulator.input_names, rows, own, space.groups, n)
    regressors += [*_of_time(space), *_own_past(space, seen, direction, scale, horizon)]
    return likeliest(regressors, partial(_told, space, seen, direction, taken=taken), scale, n)


def _told(
    space: StateSpace, seen: Seen, direction: Array, columns: Array, *, taken: Array | None = None
) -> tuple[Array, Array]:
    """Return what innovations tell of the strengths of columns of a force, G and b."""
    return _gram(seen, _response(space, seen, direction, columns), taken=taken)


def _of_time(space: StateSpace) -> list[Regressor]:
    """Return the law of time since an episode began, where they are enough to tell it from chance."""
    steps = steps_of(space.groups)
    if not space.simulator.state_names or np.count_nonzero(steps == 0) < EPISODES_FOR_TIME:
        return []
    return binned(
        "time", np.asarray(steps * (space.simulator.dt or 1.0), dtype=np.float64), OWN_BINS, is_own=True
    )


def _without_laws(
    space: StateSpace, seen: Seen, directions: _Directions, laws: Sequence[Likeliest], known: Known
) -> Seen:
    """Return a log with the noise that is left when those laws act that there is more for than against.

    What a law explains is no noise: forces of memory would take most of it.
    """
    shift = np.zeros((len(space.X), space.d))
    for index, law in enumerate(laws):
        if law.evidence > 0:
            own = _response(space, seen, directions.columns[..., index], law.regressor.columns)
            force = law.regressor.columns @ law.strengths(*_gram(seen, own))
            shift += directions.columns[..., index] * force[:, None]
    if not shift.any():
        return seen
    hidden = seen.chains.drive.shape[-1] - space.d
    moved = replace(seen.chains, drive=seen.chains.drive + space.padded(np.pad(shift, [(0, 0), (0, hidden)])))
    found = _normal_estimate(moved, seen.estimate.noise, space, known)
    return replace(seen, estimate=passed(seen.chains, found.noise, space.real))


def _normal_estimate(chains: Chains, start: Noise, space: StateSpace, known: Known) -> Estimate:
    """Return the noise of chains without heavy tails."""
    floor, held = known.least(chains), known.held(chains)
    return estimate_noise(chains, start, space.real, floor=floor, held=held, heavy=False)


def _left(
    space: StateSpace,
    fitted: Seen,
    seen: Seen,
    directions: _Directions,
    index: int,
    law: Likeliest,
    runs: "_Runs | None",
    white: tuple[Array, Array],
) -> Left:
    chosen, column = law.regressor, directions.columns[..., index]
    own = _response(space, seen, column, chosen.columns)
    half = _halves(space)
    predicted: list[Array] = [
        chosen.columns @ law.strengths(*_gram(seen, own, half == which)) for which in (False, True)
    ]
    predictable = float(np.sqrt(max(float(np.mean(predicted[0] * predicted[1])), 0.0)))
    added = 0.0
    if runs is not None and law.evidence > 0:
        added = _added(space, seen, column, np.stack(predicted, axis=-1), runs)
    force, variance = directions.forces[:, index], directions.variances[:, index]
    mean_square = float(np.mean(force**2 + variance))
    # What its own past predicts is what a spectrum is to show.
    is_law = law.evidence > 0 and chosen.name != PAST
    left = force - ((predicted[0] + predicted[1]) / 2 if is_law else 0.0)
    shown = 1 - float(variance.mean()) / mean_square if mean_square > 0 else 0.0
    frequencies, spectrum = _spectrum(space, left, white[0], white[1])
    word = word_of(left, frequencies, spectrum, "Hz" if space.simulator.dt else "per row")
    return Left(
        directions.names[index],
        directions.units[index],
        max(float(np.sqrt(mean_square)), predictable),
        float(directions.scales[index]),
        predictable,
        chosen.name,
        law.evidence,
        law.law(partial(_told, space, seen, column)),
        _past(fitted, index),
        added,
        frequencies,
        spectrum,
        word if shown > LEAST_SHOWN else "none",
    )


# -- where something may act, and how large it is ---------------------------------------------------------------------


def _directions(space: StateSpace, fitted: Fitted) -> _Directions:
    simulator, smoothed = space.simulator, fitted.estimate.smoothed
    units = [simulator.units.get(name, f"unit of {name}") for name in simulator.residual_names]
    n_rows, d = len(space.X), space.d
    if not simulator.state_names:
        return _Directions(
            simulator.residual_names,
            tuple(units),
            tuple(simulator.input_names for _ in range(d)),
            np.broadcast_to(np.eye(d), (n_rows, d, d)),
            smoothed.errors[:, 1:][space.places],
            smoothed.error_variances[:, 1:][space.places],
            np.maximum(space.spread / 3, 1e-300),
        )
    columns = fitted.linear.chains.carrier[space.places]
    k = columns.shape[-1]
    noise = fitted.estimate.noise
    forces = _total_forces(space, fitted.memory, noise, smoothed)
    variances = noise.variances_on_joints(smoothed, k)[space.places]
    if len(fitted.memory):
        diagonal = np.einsum("ctii->cti", smoothed.covariances)[..., d:]
        variances = variances + np.maximum(diagonal[:, :-1][space.places], 0.0)
    joints = simulator.joint_forces()
    if joints:
        names = tuple(effect.target or effect.name for effect, _ in joints)
        return _Directions(
            names,
            tuple(effect.unit for effect, _ in joints),
            tuple(inputs for _, inputs in joints),
            columns,
            forces,
            variances,
            _joint_scales(space, fitted),
        )
    # A random force of such a simulation is one of each channel, or an acceleration.
    actions = simulator.input_names[len(simulator.state_names) :]
    rates = [name for name in simulator.residual_names if name.startswith("qvel.")]
    is_acceleration = k != d
    acting = rates if is_acceleration else list(simulator.residual_names)
    unit = np.ones(k) if is_acceleration else np.diag(space.carrier)
    change = simulator.residual(space.path_ends(fitted.linear.path), fitted.linear.path[:, :-1][space.places])
    change = change[:, [simulator.residual_names.index(name) for name in acting]]
    named = dict(zip(simulator.residual_names, units))
    size = np.sqrt(np.mean(change**2, axis=0)) / (simulator.dt or 1.0 if is_acceleration else 1.0)
    own = tuple(tuple(dict.fromkeys((*_state_inputs(space, name), *actions))) for name in acting)
    return _Directions(
        tuple(acting),
        tuple(f"{named[name]}/s" if is_acceleration else f"{named[name]} per row" for name in acting),
        own,
        columns / unit,
        forces * unit,
        variances * unit**2,
        np.maximum(size, 1e-300),
    )


def _state_inputs(space: StateSpace, channel: str) -> tuple[str, ...]:
    """Return the inputs that belong to a channel: itself, and the position beside a velocity."""
    names = (channel, channel.replace("qvel.", "qpos.", 1))
    return tuple(name for name in names if name in space.simulator.input_names)


def _total_forces(space: StateSpace, memory: Memory, noise: Noise, smoothed: Smoothed) -> Array:
    """Return white forces with those of memory added, (n_rows, k)."""
    k = smoothed.forces.shape[-1] - len(memory)
    forces = noise.on_joints(smoothed.forces[..., :k])
    if len(memory):
        fresh = noise.on_joints(smoothed.forces[..., k:])
        forces = forces + memory.acting(fresh, smoothed.means[:, :-1, space.d :])
    return forces[space.places]


def _joint_scales(space: StateSpace, fitted: Fitted) -> Array:
    """Return the nominal model's rms force on each joint: that of motors, of gravity where none drives it."""
    exerted: Callable[[Array, Places], tuple[Array, Array]] = getattr(space.simulator, "exerted")  # noqa: B009
    forces = exerted(space.rows(fitted.linear.path), space.groups)
    actuators, bias = (np.sqrt(np.mean(force**2, axis=0)) for force in forces)
    scales: Array = np.maximum(np.where(actuators > 0, actuators, bias), 1e-9)
    return scales


def _past(seen: Seen, index: int) -> float:
    """Return the share of a force's variance that its own past predicts a row ahead."""
    k, memory = len(seen.memory), seen.memory
    if not k:
        return 0.0
    force = seen.estimate.noise.joint_force.mean(axis=0)
    remembered = memory.variance(force[k:])[index]
    total = remembered + force[index]
    return float(memory.predicted * remembered / total) if total > 0 else 0.0


# -- what predicts it -------------------------------------------------------------------------------------------------


def _own_past(space: StateSpace, seen: Seen, direction: Array, scale: float, horizon: int) -> list[Regressor]:
    """Return the regressor of what innovations say of a force a horizon before, and in the rows before that.

    A vibration that keeps its phase is predicted so; a random force whose memory is short against the horizon is not.
    """
    chain, step = space.places
    steps, last = steps_of(space.groups), horizon + PAST_ROWS - 1
    if not space.simulator.state_names or steps.max() < last:
        return []
    factors = seen.estimate.filtered.factors[chain, step + 1][..., : space.d]
    moved = (factors @ direction[..., None])[..., 0]
    shown = np.sum(moved * seen.estimate.filtered.whitened[chain, step + 1], axis=1)
    force = shown / (np.sum(moved**2, axis=1) + 1 / scale**2)
    columns = np.zeros((len(force), PAST_ROWS))
    for column, before in enumerate(range(horizon, last + 1)):
        there = np.flatnonzero(steps >= before)
        columns[there, column] = force[there - before]
    size = float(np.sqrt(np.mean(columns**2)))
    return [Regressor(PAST, PAST, columns[:, 0], columns / size, True)] if size > 0 else []


def _rows_as_known(space: StateSpace, seen: Seen) -> Array:
    """Return the rows with states as the filter has them from what was measured before."""
    n_states = len(space.simulator.state_names)
    if not n_states:
        return space.X
    return _turned_back(space, np.c_[filtered(space, seen)[0], space.X[:, n_states:]])


def _turned_back(space: StateSpace, rows: Array) -> Array:
    """Return the rows with angles that turn over within half a turn of zero: a force there comes back each turn."""
    for column, name in enumerate(space.simulator.state_names):
        if space.simulator.units.get(name) == "rad" and np.ptp(rows[:, column]) > 2 * np.pi:
            rows[:, column] = np.remainder(rows[:, column] + np.pi, 2 * np.pi) - np.pi
    return rows


def _response(space: StateSpace, seen: Seen, direction: Array, columns: Array) -> Array:
    """Return by how much whitened innovations change with each column of force, (n_chains, n_steps + 1, d_all, k).

    Times how certain these are, see `Estimate.certainty`.
    """
    drive = direction[:, :, None] * columns[:, None, :]
    drive[~seen.linear.valid] = 0.0
    return response(space, seen.chains, seen.estimate.filtered, drive) * seen.estimate.certainty[..., None]


def _gram(
    seen: Seen, N: Array, chosen: Mask | None = None, *, taken: Array | None = None
) -> tuple[Array, Array]:
    mask = seen.chains.mask if chosen is None else seen.chains.mask & chosen[..., None]
    columns, z = N[mask], (seen.estimate.filtered.whitened / seen.estimate.certainty)[mask]
    if taken is not None:
        columns = columns - taken @ (taken.T @ columns)
    return columns.T @ columns, columns.T @ z


def _halves(space: StateSpace) -> Mask:
    """Return the half that each instant belongs to, (n_chains, n_steps + 1)."""
    n, steps = space.real.shape
    block = np.arange(n)[:, None] + np.arange(steps + 1) // BLOCK_ROWS
    return np.asarray(block % 2 == 1)


@dataclass(frozen=True)
class _Runs:
    """Rows at which predictions start, how many rows they run, and a right model's variances (n_starts, d) then."""

    starts: Places
    horizon: int
    right: Array


def _runs(space: StateSpace, seen: Seen, values: Mapping[str, float], horizon: int) -> _Runs:
    starts, horizon = windows(space, horizon) if space.simulator.state_names else (np.arange(len(space.X)), 1)
    right = ahead(space, seen, values, starts, horizon).variances[:, -1]
    return _Runs(starts, horizon, right)


def _added(space: StateSpace, seen: Seen, direction: Array, forces: Array, runs: _Runs) -> float:
    """Return what a force adds to the mean square error at a horizon, from two estimates (n_rows, 2) of it."""
    drive = direction[:, :, None] * forces[:, None, :]
    A = seen.linear.chains.transitions[space.places]
    moved = np.zeros((len(runs.starts), space.d, 2))
    for step in range(runs.horizon):
        rows = runs.starts + step
        moved = A[rows] @ moved + drive[rows]
    mask = ends(space)[1][runs.starts + runs.horizon - 1]
    both = moved[..., 0] * moved[..., 1] / runs.right
    return float(max(both[mask].mean(), 0.0)) if mask.any() else 0.0


# -- what it looks like over time -------------------------------------------------------------------------------------


def _segments(space: StateSpace) -> tuple[list[Places], int]:
    """Return the rows of each episode, and how many of them a spectrum takes."""
    rows = np.split(np.arange(len(space.groups)), np.flatnonzero(np.diff(space.groups)) + 1)
    longest = max(len(one) for one in rows)
    length = min(SPECTRUM_ROWS, longest)
    return [one for one in rows if len(one) >= length], length


def _welch(space: StateSpace, force: Array) -> tuple[Array, Array]:
    segments, length = _segments(space)
    if length < LEAST_SPECTRUM_ROWS:
        return np.zeros(0), np.zeros(0)
    rate = 1 / space.simulator.dt if space.simulator.dt else 1.0
    spectra, weights = [], []
    for rows in segments:
        frequencies, power = signal.welch(force[rows], rate, nperseg=length, detrend=False)
        spectra.append(power)
        weights.append(len(rows))
    return frequencies, np.average(spectra, axis=0, weights=weights)


def _white_spectra(
    space: StateSpace, fitted: Fitted, directions: _Directions, random_state: np.random.RandomState
) -> tuple[Array, list[Array]]:
    """Return what the smoother shows of a white force with the variance that was found: frequencies, and spectra.

    Where sensors hide a force, a smoothed one is a slow one, whatever it was.
    """
    n = len(directions.names)
    if not space.simulator.state_names or _segments(space)[1] < LEAST_SPECTRUM_ROWS:
        return np.zeros(0), [np.zeros(0)] * n
    noise = fitted.estimate.noise
    plain, chains = (one.mixed(noise.mixings) for one in (fitted.linear.chains, fitted.chains))
    d, k = space.d, plain.carrier.shape[-1]

    def sizes(force: Array) -> Array:
        return force[:, :k] + (fitted.memory.variance(force[:, k:]) if len(fitted.memory) else 0.0)

    forces, mean = sizes(noise.force), sizes(noise.joint_force).mean(axis=0)
    variances = noise.force_variances, noise.error_variances
    spectra = [np.zeros(0)] * n
    frequencies = np.zeros(0)
    for draw in range(DRAWS):
        pushes = np.sqrt(forces)[noise.law][:, None] * random_state.normal(size=(*space.real.shape, k))
        pushes *= space.real[..., None]
        readings = np.sqrt(variances[1]) * random_state.normal(size=variances[1].shape)
        state = np.zeros((len(pushes), d))
        for step in range(pushes.shape[1] + 1):
            readings[:, step, :d] += state
            if step < pushes.shape[1]:
                state = np.einsum("nij,nj->ni", plain.transitions[:, step], state)
                state += np.einsum("nij,nj->ni", plain.carrier[:, step], pushes[:, step])
        drawn = replace(
            chains, measured=np.where(chains.mask, readings, 0.0), drive=np.zeros_like(chains.drive)
        )
        smoothed = smooth(drawn, kalman_filter(drawn, *variances), *variances, covariances=False)
        shown = _total_forces(space, fitted.memory, noise, smoothed)
        for index in range(n):
            frequencies, power = _welch(space, shown[:, index] / np.sqrt(max(mean[index], 1e-300)))
            spectra[index] = power / DRAWS if draw == 0 else spectra[index] + power / DRAWS
    return frequencies, spectra


def _spectrum(space: StateSpace, force: Array, frequencies: Array, white: Array) -> tuple[Array, Array]:
    """Return the power density that a force would show if the smoother showed all of it."""
    if not len(frequencies):
        return frequencies, np.zeros(0)
    shown = _welch(space, force)[1]
    level = 1 / frequencies[-1]  # of a white force of unit variance
    ratio = np.where(white > 0, shown / np.where(white > 0, white, 1.0), 0.0)
    return frequencies, ratio * level


def word_of(force: Array, frequencies: Array, spectrum: Array, unit: str) -> str:
    """Return what a force over time looks like, in a word."""
    squares = np.sort(force**2)[::-1]
    total = float(squares.sum())
    if len(frequencies) < 2 or total == 0 or not spectrum.sum() > 0:
        return "none" if total == 0 else "white"
    if squares[: max(1, int(FEW_ROWS * len(squares)))].sum() > MAJORITY * total:
        return "impacts"
    power = spectrum[1:] / spectrum[1:].sum()
    above = frequencies[1:]
    peak = int(np.argmax(power))
    near = np.abs(above - above[peak]) <= max(WIDTH * above[peak], 2 * above[0])
    if peak > 2 and power[near].sum() > MAJORITY:
        centre = float((above[near] * power[near]).sum() / power[near].sum())
        return f"vibration at {centre:.2g} {unit}"
    if power[above <= SLOW * above[-1]].sum() > MAJORITY:
        return "drift"
    return "white"
