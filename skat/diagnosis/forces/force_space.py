r"""Forces that joints lack, along smoothed motion, as rows of a regression whose noise is white.

Positions are smoothed to speeds and accelerations; inverse dynamics then say what force each joint lacks. Each joint's
missing force, and what effects exert on it, are cut into blocks of rows and transformed by a cosine transform, of which
the coefficients up to the frequency at which the smoother keeps most of the motion are rows of the regression. What is
left of them is noise whose variance changes smoothly with frequency: drift, forces that have a memory, sensor noise
that differentiation lifts. Divided by its deviation these rows are white.

References
----------
.. [1] Gautier (1997). Dynamic identification of robots with power model. ICRA.
.. [2] Whittle (1953). Estimation and information in stationary time series. Arkiv för Matematik 2.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from skat.diagnosis.chains import Array, Mask
from skat.diagnosis.forces.smoothing import smooth_coordinate
from skat.diagnosis.velocities import states_in_time
from skat.simulators import MujocoSimulator

# Of a motion, that the smoother must keep up to the highest frequency that is compared.
KEPT = 0.75
# Blocks of rows for each period of that frequency: forces change within a block by little.
BLOCKS_A_PERIOD = 4
# Of the power of a speed, or of the changes of efforts that were measured; and how far beyond the frequency below which
# it is of a speed forces are compared: of hard stops, which ring, less is lost than is gained.
MOTION, BEYOND_MOTION = 0.95, 2.0
# Fewest blocks of a stretch without contacts, and rows about a contact that a smoothed motion blurs.
SHORTEST = 12
BLURRED = 2
# Blocks of a window, at least.
FEWEST_OF_WINDOW = 16
# Blocks of a log that are compared at most.
MOST_BLOCKS = 6000
# Rows of a joint without which its noise is white; and the share of the highest frequency below which drift is level.
FEWEST_FOR_CURVES, DRIFT = 40, 0.02
# Of the missing force: smoothed motions and commands that hold for a row tell none of it better.
INEXACT = 0.03
# Turns of noise, white and then not, and of what effects explain; and the share of a row's square that is taken to be
# left at least: what a fit takes nearly all of tells no noise.
NOISE_TURNS, LEFT_AT_LEAST = 4, 0.1


@dataclass(frozen=True)
class Motion:
    """A log as smooth motion, in blocks of rows.

    Attributes
    ----------
    states : ndarray of shape (n_blocks, n_states)
        Mean over each block.
    speeds : ndarray of shape (n_blocks, nv)
        As measured, mean over each block, m/s or rad/s; NaN where not.
    accelerations : ndarray of shape (n_blocks, nv)
    velocities : ndarray of shape (n_blocks, rows of a block + 1, nv)
        Of the instants of each block: friction is that of each, not of their mean.
    commands : ndarray of shape (n_rows, nu)
        Of the log's rows.
    episodes : ndarray of shape (n_rows,)
    rows : ndarray of int of shape (n_blocks, rows of a block)
    stretches : ndarray of int of shape (n_blocks,)
        Blocks of one follow each other.
    duration : float
        Of a block, s.
    slip : ndarray of shape (nv,)
        Standard deviation of speeds: slower, the direction of friction is not known.
    cutoff : ndarray of shape (nv,)
        Highest frequency that is compared, Hz.
    """

    states: Array
    speeds: Array
    accelerations: Array
    velocities: Array
    commands: Array
    episodes: NDArray[np.intp]
    rows: NDArray[np.intp]
    stretches: NDArray[np.intp]
    duration: float
    slip: Array
    cutoff: Array


def smooth_motion(
    simulator: MujocoSimulator, X: Array, y: Array, groups: Array, *, window: float, measured: bool = False
) -> Motion | None:
    """Return the smoothed motion of a log without what contacts push, None if nothing is left.

    Parameters
    ----------
    simulator : MujocoSimulator
        Of joints that turn or slide: each has one position and one speed.
    X, y : ndarray of shape (n_rows, n_inputs), (n_rows, n_outputs)
        NaN in positions where nothing was measured; speeds do not count.
    groups : ndarray of shape (n_rows,)
    window : float
        About how long a stretch is, s.
    measured : bool, default=False
        Whether commands are efforts that were measured: forces are compared as far as those of a joint change, behind
        whatever filter, and not as far as it moves. Where it turns back dry friction is faster than the motion.
    """
    n_states, dt = len(simulator.state_names), simulator.dt
    nv = len(simulator.residual_names) // 2
    instants, episodes, _ = states_in_time(simulator, X, y, groups)
    try:
        smooth = [smooth_coordinate(instants[:, joint], episodes, dt) for joint in range(nv)]
    except ValueError:
        return None
    q, v = (np.column_stack([getattr(one, name) for one in smooth]) for name in ("position", "velocity"))
    slip = np.array([one.velocity_error for one in smooth])
    kept = [one.cutoff(KEPT, dt) for one in smooth]
    if measured:
        efforts = X[:, n_states:] @ _exerted(simulator, np.concatenate([q[0], v[0]]))
        joined = groups[1:] == groups[:-1]
        changes, where = np.diff(efforts, axis=0)[joined], np.asarray(groups)[1:][joined]
        busy = np.array([_busy(one, where, dt, MOTION) for one in changes.T])
    else:
        busy = BEYOND_MOTION * np.array([_busy(one, episodes, dt, MOTION) for one in v.T])
    cutoff = np.minimum(kept, busy)
    free = ~simulator.constrained(np.column_stack([q, v]))
    for _ in range(BLURRED):
        free = free & np.r_[True, free[:-1]] & np.r_[free[1:], True]
    # A block ends where the next one begins, and has the mean speed and acceleration of what is in between.
    length = max(1, int(1 / (BLOCKS_A_PERIOD * dt * max(float(cutoff.max()), 1e-9))))
    length = min(length, max(1, int(window / (FEWEST_OF_WINDOW * dt))))
    most = max(SHORTEST, round(window / (length * dt)))
    blocks, stretches = [], []
    instant_of_row = np.arange(len(X)) + np.cumsum(np.r_[0, groups[1:] != groups[:-1]])
    usable = free[instant_of_row] & free[instant_of_row + 1]
    breaks = np.flatnonzero(np.r_[True, (groups[1:] != groups[:-1]) | ~usable[1:] | ~usable[:-1]])
    for number, (start, stop) in enumerate(zip(breaks, np.r_[breaks[1:], len(X)])):
        count = (stop - start) // length if usable[start] else 0
        if count >= SHORTEST:
            blocks.append(start + np.arange(count * length).reshape(count, length))
            stretches.append(number * (1 + len(X)) + np.arange(count) * max(1, round(count / most)) // count)
    if not blocks:
        return None
    rows, stretch = np.concatenate(blocks), np.unique(np.concatenate(stretches), return_inverse=True)[1]
    rows, stretch = _fewer(rows, stretch)
    first, last = instant_of_row[rows[:, 0]], instant_of_row[rows[:, -1]] + 1
    middle = first[:, None] + np.arange(length + 1)
    ends_count = np.r_[0.5, np.ones(length - 1), 0.5] / length
    duration = length * dt

    means = np.einsum("bij,i->bj", q[middle], ends_count)
    return Motion(
        np.column_stack([means, (q[last] - q[first]) / duration]),
        0.5 * (X[rows, nv:n_states].mean(axis=1) + y[rows, nv:].mean(axis=1)),
        (v[last] - v[first]) / duration,
        v[middle],
        X[:, n_states:],
        np.asarray(groups),
        rows,
        stretch,
        duration,
        slip,
        np.minimum(cutoff, 0.5 / duration),
    )


def _exerted(simulator: MujocoSimulator, state: Array) -> Array:
    """Return the force on each joint of each command's unit, (nu, nv), N or N m."""
    nu, nv = len(simulator.input_names) - len(state), len(state) // 2
    units = np.vstack([np.zeros(nu), np.eye(nu)])[:, None]
    lacking = simulator.missing_forces(state[None], np.zeros((1, nv)), units, [{}] * (nu + 1))[:, 0]
    return np.asarray(lacking[0] - lacking[1:])


def _busy(course: Array, episodes: Array, dt: float, share: float) -> float:
    """Return the frequency below which a share of the power of a course over time is, Hz."""
    frequencies, powers = [], []
    for episode in np.unique(episodes):
        own = course[episodes == episode]
        powers.append(dct(own, norm="ortho") ** 2)
        frequencies.append(np.arange(len(own)) / (2 * len(own) * dt))
    frequency, power = np.concatenate(frequencies), np.concatenate(powers)
    order = np.argsort(frequency)
    below = np.cumsum(power[order]) / max(float(power.sum()), 1e-300)
    return float(frequency[order][min(int(np.searchsorted(below, share)), len(below) - 1)])


def _fewer(rows: NDArray[np.intp], stretch: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return evenly spread stretches of a long log."""
    if len(rows) <= MOST_BLOCKS:
        return rows, stretch
    kinds = np.unique(stretch)
    kept = kinds[np.linspace(0, len(kinds) - 1, max(1, len(kinds) * MOST_BLOCKS // len(rows))).astype(int)]
    chosen = np.isin(stretch, kept)
    return rows[chosen], np.unique(stretch[chosen], return_inverse=True)[1]


@dataclass(frozen=True)
class Rows:
    """Cosine coefficients of missing forces, and of what measured speeds differ by, and of their columns.

    Attributes
    ----------
    target : ndarray of shape (n_rows,)
        Of the missing force, N or N m; of a speed, m/s or rad/s.
    columns : ndarray of shape (n_rows, k)
        By how much it falls with each effect.
    joint : ndarray of int of shape (n_rows,)
        Degree of freedom of each row's force, 0 to nv - 1; nv and on are those of measured speeds.
    frequency : ndarray of shape (n_rows,)
        Hz.
    stretch : ndarray of int of shape (n_rows,)
        Of blocks.
    nominal : ndarray of shape (n_rows,)
        The target of the model as it is.
    """

    target: Array
    columns: Array
    joint: NDArray[np.intp]
    frequency: Array
    stretch: NDArray[np.intp]
    nominal: Array

    def whitened(self, deviations: Array) -> tuple[Array, Array]:
        """Return target and columns over the noise."""
        return self.target / deviations, self.columns / deviations[:, None]

    def part(self, kept: Mask) -> "Rows":
        """Return some of the rows."""
        return Rows(*(getattr(self, name)[kept] for name in self.__dataclass_fields__))


def joined(sides: Sequence[Rows]) -> Rows:
    """Return the rows of several logs, which have the same columns, one log after the other."""
    return Rows(
        *(np.concatenate([getattr(side, name) for side in sides]) for name in Rows.__dataclass_fields__)
    )


def transformed(motion: Motion, forces: Array) -> tuple[Array, NDArray[np.intp], Array, NDArray[np.intp]]:
    """Return the cosine coefficients (n_rows, k) of forces (n_blocks, nv, k); joint, frequency, stretch of each."""
    nv = forces.shape[1]
    parts, joints, frequencies, stretches = [], [], [], []
    for stretch in np.unique(motion.stretches):
        own = forces[motion.stretches == stretch]
        coefficients = dct(own, axis=0, norm="ortho")
        frequency = np.arange(len(own)) / (2 * len(own) * motion.duration)
        for joint in range(nv):
            kept = frequency <= motion.cutoff[joint]
            parts.append(coefficients[kept, joint])
            joints.append(np.full(int(kept.sum()), joint))
            frequencies.append(frequency[kept])
            stretches.append(np.full(int(kept.sum()), stretch))
    return tuple(map(np.concatenate, (parts, joints, frequencies, stretches)))  # type: ignore[return-value]


def noise_of(rows: Rows, squares: Array, *, flat: bool = False) -> Array:
    """Return the deviation of each row's noise, which changes smoothly with frequency.

    Parameters
    ----------
    rows : Rows
    squares : ndarray of shape (n_rows,)
        Unbiased squares of what is left of each row.
    flat : bool, default=False
        Whether each joint's noise is white. A curve, fitted before the causes are, takes them for noise.
    """
    inexact = INEXACT**2 * smooth_squares(rows, rows.nominal**2)
    return np.sqrt(np.maximum(smooth_squares(rows, squares, flat=flat), inexact))


def noise_beside(rows: Rows) -> Array:
    """Return the deviation of each row's noise where all effects act, each held by a normal law of its unit."""
    noise = noise_of(rows, rows.target**2, flat=True)
    for turn in range(2 * NOISE_TURNS):
        target, columns = rows.whitened(noise)
        law = np.linalg.inv(columns.T @ columns + np.eye(columns.shape[1]))
        left = target - columns @ (law @ (columns.T @ target))
        lever = np.sum((columns @ law) * columns, axis=1)
        squares = (left * noise) ** 2 / np.maximum(1 - lever, LEFT_AT_LEAST)
        noise = noise_of(rows, squares, flat=turn < NOISE_TURNS)
    return noise


def smooth_squares(rows: Rows, squares: Array, *, flat: bool = False) -> Array:
    """Return the variance of which rows have such squares: of each joint a smooth curve over frequency.

    Notes
    -----
    Of each joint the log of the variance is a curve of three numbers: a level, a drift that falls with the logarithm of
    the frequency, and a rise, as differentiated noise has. They maximise the likelihood of squares that are variance
    times chi-squared of one degree of freedom.
    """
    variances = np.empty(len(squares))
    least = 1e-18 * float(np.mean(rows.nominal**2)) + 1e-300
    for joint in np.unique(rows.joint):
        mine = rows.joint == joint
        share = rows.frequency[mine] / max(float(rows.frequency[mine].max()), 1e-12)
        curves = np.column_stack([np.ones_like(share), np.log(share + DRIFT), share**2])
        curves = curves[:, : 1 if flat or len(share) < FEWEST_FOR_CURVES else 3]
        variances[mine] = np.exp(curves @ _log_variance(curves, np.maximum(squares[mine], least)))
    return np.maximum(variances, least)


def _log_variance(curves: Array, squares: Array) -> Array:
    """Return coefficients of the log variance of squares, by Fisher's scoring with steps of at most a factor of e^2."""
    coefficients = np.zeros(curves.shape[1])
    coefficients[0] = np.log(squares.mean())
    information = curves.T @ curves + 1e-3 * np.eye(curves.shape[1])
    for _ in range(40):
        fitted = curves @ coefficients
        step = np.linalg.solve(information, curves.T @ (squares * np.exp(-fitted) - 1))
        largest = float(np.abs(curves @ step).max())
        coefficients = coefficients + step * min(1.0, 2 / max(largest, 1e-12))
        if largest < 1e-3:
            break
    return coefficients
