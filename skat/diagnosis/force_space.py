r"""Regression in force space: a first look at what a model of joints misses, in seconds and without simulating.

Positions are smoothed to speeds and accelerations; inverse dynamics then say what force each joint lacks. It is the
sum of what effects exert, nearly linear in their values, whatever the family: columns are differences of inverse
dynamics with an effect in the model and without.

Each joint's missing force, and its columns, are cut into blocks of rows and transformed by a cosine transform, of which
the coefficients up to the frequency at which the smoother keeps most of the motion are rows of the regression. What is
left of them is noise whose variance changes smoothly with frequency: drift, forces that have a memory, sensor noise
that differentiation lifts. Divided by its deviation these rows are white, and sets of causes are weighed on their Gram
matrix.

References
----------
.. [1] Gautier (1997). Dynamic identification of robots with power model. ICRA.
.. [2] Whittle (1953). Estimation and information in stationary time series. Arkiv för Matematik 2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from skat.diagnosis.evidence import Gram, Priors, Weighed, posterior_mode
from skat.diagnosis.filtering import Array, Mask
from skat.diagnosis.fitting import priors_of
from skat.diagnosis.set_search import alternatives, search_sets, without_weak
from skat.diagnosis.smoothing import smooth_coordinate
from skat.effects import Effect
from skat.simulators import MujocoSimulator, Simulator

# Of a motion, that the smoother must keep up to the highest frequency that is compared.
KEPT = 0.75
# Blocks of rows for each period of that frequency: forces change within a block by little.
BLOCKS_A_PERIOD = 4
# Of the power of a speed, and how far beyond the frequency below which it is forces are compared.
MOTION, BEYOND_MOTION = 0.99, 2.0
# The same where logs are cut into windows: of hard stops, which ring, less is lost than is gained.
MOTION_OF_WINDOWS = 0.95
# Fewest blocks of a stretch without contacts, and rows about a contact that a smoothed motion blurs.
SHORTEST = 12
BLURRED = 2
# Blocks of a window, at least.
FEWEST_OF_WINDOW = 16
# Blocks of a log that are compared at most, in stretches of so many.
MOST_BLOCKS, STRETCH = 6000, 1000
# Rows of a joint without which its noise is white; and the share of the highest frequency below which drift is level.
FEWEST_FOR_CURVES, DRIFT = 40, 0.02
# Families that differentiated positions do not show, or that need what a row does not hold.
UNSEEN = ("scale", "lag", "timestep", "backlash", "lag_torque")
# Of the typical size of an effect: over which its column is taken. Weak dry friction saturates at once.
STEP = 0.01
NOISE_TURNS = 4
# Blocks from which the strength of commands is told.
ROWS_FOR_ANCHORS = 200
# Searches, each about the values of the one before, where forces are not linear: a mean square, of the noise.
TURNS, BENT = 2, 0.02
# Of factors: in units of the commands a motor that does nothing cannot be told.
WEAKEST = 0.2
# Of the missing force: smoothed motions and commands that hold for a row tell none of it better.
INEXACT = 0.03
# In nats, for a start; a delay is named by its evidence.
WORTH_OF_DELAY = 5.0
# Sets that are less likely by at most this factor cannot be told apart.
ALIAS_ODDS = 20.0
WIDTH_95 = 1.96


@dataclass(frozen=True)
class Motion:
    """A log as smooth motion, in blocks of rows.

    Attributes
    ----------
    states : ndarray of shape (n_blocks, n_states)
        Mean over each block.
    accelerations : ndarray of shape (n_blocks, nv)
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
    accelerations: Array
    commands: Array
    episodes: NDArray[np.intp]
    rows: NDArray[np.intp]
    stretches: NDArray[np.intp]
    duration: float
    slip: Array
    cutoff: Array


def smooth_motion(
    simulator: MujocoSimulator, X: Array, y: Array, groups: Array, *, window: float | None = None
) -> Motion | None:
    """Return the smoothed motion of a log without what contacts push, None if nothing is left.

    Parameters
    ----------
    simulator : MujocoSimulator
    X, y : ndarray of shape (n_rows, n_inputs), (n_rows, n_outputs)
        NaN in states where nothing was measured.
    groups : ndarray of shape (n_rows,)
    window : float, optional
        About how long a stretch is, s.
    """
    n_states, dt = len(simulator.state_names), simulator.dt
    nv = len(simulator.residual_names) // 2
    ends = np.flatnonzero(np.r_[groups[1:] != groups[:-1], True])
    instants = np.insert(X[:, :n_states], ends + 1, y[ends], axis=0)
    episodes = np.insert(np.asarray(groups), ends + 1, groups[ends])
    if n_states != 2 * nv:
        return None
    q, v, a = (np.empty((len(instants), nv)) for _ in range(3))
    slip, cutoff = np.empty(nv), np.empty(nv)
    share = MOTION if window is None else MOTION_OF_WINDOWS
    for joint in range(nv):
        try:
            smooth = smooth_coordinate(instants[:, joint], instants[:, nv + joint], episodes, dt)
        except ValueError:
            return None
        q[:, joint], v[:, joint], a[:, joint] = smooth.position, smooth.velocity, smooth.acceleration
        slip[joint] = smooth.velocity_error
        cutoff[joint] = min(smooth.cutoff(KEPT, dt), _busy(v[:, joint], episodes, dt, share))
    free = ~simulator.constrained(np.column_stack([q, v]))
    for _ in range(BLURRED):
        free = free & np.r_[True, free[:-1]] & np.r_[free[1:], True]
    # A block ends where the next one begins, and has the mean speed and acceleration of what is in between.
    length = max(1, int(1 / (BLOCKS_A_PERIOD * dt * max(float(cutoff.max()), 1e-9))))
    most = STRETCH
    if window is not None:
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
    states = np.column_stack([np.einsum("bij,i->bj", q[middle], ends_count), (q[last] - q[first]) / duration])
    return Motion(
        states,
        (v[last] - v[first]) / duration,
        X[:, n_states:],
        np.asarray(groups),
        rows,
        stretch,
        duration,
        slip,
        np.minimum(cutoff, 0.5 / duration),
    )


def _busy(speed: Array, episodes: Array, dt: float, share: float) -> float:
    """Return the frequency below which nearly all of a motion is; above, it is what structures ring with, Hz."""
    frequencies, powers = [], []
    for episode in np.unique(episodes):
        own = speed[episodes == episode]
        powers.append(dct(own, norm="ortho") ** 2)
        frequencies.append(np.arange(len(own)) / (2 * len(own) * dt))
    frequency, power = np.concatenate(frequencies), np.concatenate(powers)
    order = np.argsort(frequency)
    below = np.cumsum(power[order]) / max(float(power.sum()), 1e-300)
    return float(BEYOND_MOTION * frequency[order][min(int(np.searchsorted(below, share)), len(below) - 1)])


def _fewer(rows: NDArray[np.intp], stretch: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return evenly spread stretches of a long log."""
    if len(rows) <= MOST_BLOCKS:
        return rows, stretch
    kinds = np.unique(stretch)
    kept = kinds[np.linspace(0, len(kinds) - 1, max(1, len(kinds) * MOST_BLOCKS // len(rows))).astype(int)]
    chosen = np.isin(stretch, kept)
    return rows[chosen], np.unique(stretch[chosen], return_inverse=True)[1]


def seen_effects(effects: Sequence[Effect]) -> list[Effect]:
    """Return the effects that forces may show."""
    return [
        effect
        for effect in effects
        if effect.family not in UNSEEN
        and not (effect.family == "bias" and str(effect.target).startswith("qvel."))
    ]


def missing_force(
    simulator: MujocoSimulator, motion: Motion, candidates: Sequence[Mapping[str, float]]
) -> Array:
    """Return the force that each candidate's model lacks for a motion, (n_candidates, n_blocks, nv)."""
    commands = simulator.acting_commands(motion.commands, candidates, groups=motion.episodes)
    commands = np.stack([one[motion.rows].mean(axis=1) for one in commands])
    forces = simulator.missing_forces(
        motion.states, motion.accelerations, commands, candidates, slip=motion.slip
    )
    return forces / _anchors(simulator, motion, commands, candidates)[:, None]


def _anchors(
    simulator: MujocoSimulator, motion: Motion, commands: Array, candidates: Sequence[Mapping[str, float]]
) -> Array:
    """Return by which factor each candidate scales what a joint's forces are measured by, (n_candidates, nv).

    A model of motors that do nothing and bodies that weigh nothing lacks no force. The unit of a joint is therefore the
    larger part of its balance in the model as it is: what the commands exert, or what its motion takes.
    """
    some = np.unique(np.linspace(0, len(motion.states) - 1, ROWS_FOR_ANCHORS).astype(int))
    whole, nv = [{}, *candidates], len(motion.slip)
    sent = np.concatenate([commands[:1, some], commands[:, some]])
    held = np.repeat(np.concatenate([commands[:1], commands]).mean(axis=1, keepdims=True), len(some), axis=1)
    states, moved = motion.states[some].copy(), motion.accelerations[some]
    states[:, -nv:] = 0.0
    of = simulator.missing_forces
    taken = of(states, moved, held, whole)
    by_command = np.sqrt(np.mean((of(states, moved, sent, whole) - taken) ** 2, axis=1))
    by_motion = taken.std(axis=1)
    sizes = np.where(by_command[0] >= by_motion[0], by_command, by_motion)
    return np.where(
        sizes[0] > 0, np.maximum(sizes[1:], WEAKEST * sizes[0]) / np.maximum(sizes[0], 1e-300), 1.0
    )


@dataclass(frozen=True)
class Rows:
    """Cosine coefficients of missing forces and of their columns.

    Attributes
    ----------
    target : ndarray of shape (n_rows,)
        Of the missing force, N or N m.
    columns : ndarray of shape (n_rows, k)
        By how much it falls with each effect.
    joint : ndarray of int of shape (n_rows,)
        Degree of freedom of each row.
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


def rows_at(
    simulator: MujocoSimulator, motion: Motion, values: Mapping[str, float], effects: Sequence[Effect]
) -> Rows:
    """Return the rows of the regression about given values."""
    candidates, widths = [{}, dict(values)], []
    for effect in effects:
        now = values.get(effect.name, effect.neutral)
        step = STEP * effect.typical
        other = now + step if now + step <= effect.bounds[1] else now - step
        other = float(np.clip(other, *effect.bounds))
        candidates.append({**values, effect.name: other})
        widths.append(other - now)
    forces = missing_force(simulator, motion, candidates)
    differences = (forces[1] - forces[2:]) / np.array(widths)[:, None, None]
    together = np.concatenate([forces[:2], differences]).transpose(1, 2, 0)
    coefficients, joint, frequency, stretch = transformed(motion, together)
    return Rows(coefficients[:, 1], coefficients[:, 2:], joint, frequency, stretch, coefficients[:, 0])


def noise_of(rows: Rows, squares: Array, *, flat: bool = False) -> Array:
    """Return the deviation of each row's noise, which changes smoothly with frequency.

    Parameters
    ----------
    rows : Rows
    squares : ndarray of shape (n_rows,)
        Unbiased squares of what is left of each row.
    flat : bool, default=False
        Whether each joint's noise is white. A curve, fitted before the causes are, takes them for noise.

    Notes
    -----
    Of each joint the log of the variance is a curve of three numbers: a level, a drift that falls with the logarithm of
    the frequency, and a rise, as differentiated noise has. They maximise the likelihood of squares that are variance
    times chi-squared of one degree of freedom.
    """
    deviations = np.empty(len(squares))
    least = 1e-18 * float(np.mean(rows.nominal**2)) + 1e-300
    for joint in np.unique(rows.joint):
        mine = rows.joint == joint
        share = rows.frequency[mine] / max(float(rows.frequency[mine].max()), 1e-12)
        curves = np.column_stack([np.ones_like(share), np.log(share + DRIFT), share**2])
        own = np.maximum(squares[mine], least)
        curves = curves[:, : 1 if flat or len(own) < FEWEST_FOR_CURVES else 3]
        deviations[mine] = np.exp(0.5 * curves @ _log_variance(curves, own))
        curves = curves[:, : 1 if len(own) < FEWEST_FOR_CURVES else 3]
        missing = np.exp(0.5 * curves @ _log_variance(curves, np.maximum(rows.nominal[mine] ** 2, least)))
        deviations[mine] = np.maximum(deviations[mine], INEXACT * missing)
    return np.maximum(deviations, np.sqrt(least))


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


def gram_of_rows(rows: Rows, deviations: Array, origin: Array) -> Gram:
    """Return the Gram matrix of whitened rows that were taken at values `origin` from neutral."""
    z, N = rows.whitened(deviations)
    return Gram(N.T @ N, N.T @ z, origin)


def all_explained(
    rows: Rows, priors: Priors, origin: Array, *, deviations: Array | None = None
) -> tuple[Array, Array]:
    """Return the noise that is left if all effects act, held by their priors alone, and their values from neutral."""
    begun = deviations is not None
    if deviations is None:
        deviations = noise_of(rows, rows.target**2, flat=True)
    values = np.zeros(len(origin))
    for turn in range(NOISE_TURNS if begun else 2 * NOISE_TURNS):
        gram = gram_of_rows(rows, deviations, origin)
        values, curvature = posterior_mode(
            gram.products, gram.at_neutral, priors.scales, priors.low, priors.high
        )
        squares = unbiased_squares(rows, values - origin, deviations, curvature)
        deviations = noise_of(rows, squares, flat=not begun and turn < NOISE_TURNS)
    return deviations, values


def unbiased_squares(
    rows: Rows, shifts: Array, deviations: Array, curvature: Array, every: Rows | None = None
) -> Array:
    """Return squares of what fitted values leave of each row, over the share of its noise that they leave.

    Parameters
    ----------
    rows : Rows
        With the columns of the values that were fitted.
    shifts : ndarray
        Of the columns of `every`, or of those.
    deviations, curvature
        That they were fitted with.
    every : Rows, optional
    """
    whole = rows if every is None else every
    left = whole.target - whole.columns @ shifts
    if not curvature.size:
        return np.asarray(left**2)
    _, N = rows.whitened(deviations)
    unit = 1 / np.sqrt(np.diag(curvature))
    values, vectors = np.linalg.eigh(curvature * unit * unit[:, None])
    leverage = np.sum((N * unit @ vectors) ** 2 / np.maximum(values, 1e-9), axis=1)
    return np.asarray(left**2 / np.maximum(1 - leverage, 0.1))


def visible(rows: Rows) -> Mask:
    """Return which effects have a column that is not zero."""
    sizes = np.sqrt(np.mean(rows.columns**2, axis=0))
    return np.asarray(sizes > 1e-9 * max(float(np.sqrt(np.mean(rows.target**2))), 1e-12))


@dataclass(frozen=True)
class FirstLook:
    """What the forces of a log ask for.

    Attributes
    ----------
    values : dict of str to float
        The causes that are worth their name.
    errors : dict of str to float
        Standard error of each, at the noise of this set.
    worth : dict of str to float
        What each is worth beside the others, nats.
    aliases : dict of str to tuple of (str, float)
        What could stand in a cause's place, and how many nats less such a set is worth.
    evidence : float
        Log posterior odds of the set against no cause, nats.
    starts : tuple of dict of str to float
        The best sets, best first, the dense one of all effects last.
    missing, left : dict of str to float
        Of each degree of freedom, by the name of its speed: rms of the force that the model lacks, and of what the
        causes leave of it, in the frequencies that are compared; N or N m.
    n_rows : int
        Of the regression.
    """

    values: dict[str, float]
    errors: dict[str, float]
    worth: dict[str, float]
    aliases: dict[str, tuple[tuple[str, float], ...]]
    evidence: float
    starts: tuple[dict[str, float], ...]
    missing: dict[str, float]
    left: dict[str, float]
    n_rows: int

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """95 % intervals of the values."""
        return {
            name: (value - WIDTH_95 * self.errors[name], value + WIDTH_95 * self.errors[name])
            for name, value in self.values.items()
        }


def first_look(
    simulator: Simulator,
    X: Array,
    y: Array,
    groups: Array,
    effects: Sequence[Effect],
    *,
    typical: Mapping[str, float] | None = None,
    alpha: float = 0.01,
) -> FirstLook | None:
    """Return what the forces of a log ask for; None where forces tell nothing.

    Parameters
    ----------
    simulator : Simulator
    X, y : ndarray of shape (n_rows, n_inputs), (n_rows, n_outputs)
        Rows of an episode follow each other. NaN in states where nothing was measured; a speed that was computed from
        positions is no measurement.
    groups : ndarray of shape (n_rows,)
    effects : sequence of Effect
        That may be causes; those that forces do not show are left out.
    typical : mapping from name to size, optional
        Scales of the priors of a user's own.
    alpha : float, default=0.01
        A cause is named if the odds for the set with it are 1 / alpha times those of the set without.

    Returns
    -------
    FirstLook or None
        None if the simulator is not one of joints that turn or slide, or if contacts push all the time.
    """
    if not isinstance(simulator, MujocoSimulator):
        return None
    motion = smooth_motion(simulator, X, y, groups)
    if motion is None:
        return None
    offered = seen_effects(effects)
    rows = rows_at(simulator, motion, {}, offered)
    shown = np.flatnonzero(visible(rows))
    offered = [offered[place] for place in shown]
    if not offered:
        return None
    rows = _only(rows, shown)
    nominal = rows
    priors = force_priors(offered, typical)
    neutral = np.array([effect.neutral for effect in offered])
    origin = np.zeros(len(offered))
    deviations, dense = all_explained(rows, priors, origin)
    values = late_commands(simulator, motion, offered, priors, rows, deviations)
    if values:
        rows, origin = rows_at(simulator, motion, values, offered), _origin(offered, values)
        deviations, dense = all_explained(rows, priors, origin)
    families, rivals = families_of(offered), rivals_of(offered)
    needed = -np.log(alpha)
    for _ in range(TURNS):
        before = values
        best, worth = search_sets(gram_of_rows(rows, deviations, origin), priors, families, rivals=rivals)
        best, nats = without_weak(best, worth, needed)
        found, shifts = _shifts(best, neutral, origin)
        values = {
            offered[place].name: float(np.clip(found[place], *offered[place].bounds))
            for place in best.members
        }
        squares = unbiased_squares(_only(rows, best.members), shifts, deviations, best.curvature, rows)
        deviations = noise_of(rows, squares)
        if set(before) == set(values) or not _bends(
            simulator, motion, values, rows, shifts, best, deviations
        ):
            break
        rows, origin = rows_at(simulator, motion, values, offered), _origin(offered, values)
    best, worth = search_sets(
        gram_of_rows(rows, deviations, origin), priors, families, start=best.members, rivals=rivals
    )
    best, nats = without_weak(best, worth, needed)
    found, shifts = _shifts(best, neutral, origin)
    names = [offered[place].name for place in best.members]
    errors = np.sqrt(np.maximum(np.diag(np.linalg.inv(best.curvature)), 0.0)) if names else np.zeros(0)
    ranked = sorted(worth.seen.values(), key=lambda one: -one.evidence)
    starts = [_named(one, offered) for one in [best, *ranked[:2]]]
    everything = {effect.name: float(value + effect.neutral) for effect, value in zip(offered, dense)}
    left = rows.target - rows.columns @ shifts
    return FirstLook(
        values=_named(best, offered),
        errors=dict(zip(names, errors.tolist())),
        worth={offered[place].name: float(nats[place]) for place in best.members},
        aliases={
            offered[place].name: tuple((offered[other].name, float(lost)) for other, lost in pairs)
            for place, pairs in alternatives(best, worth, np.log(ALIAS_ODDS)).items()
        },
        evidence=best.evidence,
        starts=(*(one for index, one in enumerate(starts) if one not in starts[:index]), everything),
        missing=_sizes(simulator, nominal, nominal.target, motion),
        left=_sizes(simulator, rows, left, motion),
        n_rows=len(rows.target),
    )


def force_priors(effects: Sequence[Effect], typical: Mapping[str, float] | None = None) -> Priors:
    """Return the priors of effects, without factors so small that a machine would not be one."""
    priors = priors_of(effects, typical, logarithmic=False)
    factors = np.array([effect.neutral == 1 for effect in effects])
    return replace(priors, low=np.where(factors, np.maximum(priors.low, WEAKEST - 1), priors.low))


def families_of(effects: Sequence[Effect]) -> dict[str, list[int]]:
    """Return the places of the members of each family that has several, the ones for all of it left out."""
    found: dict[str, list[int]] = {}
    for place, effect in enumerate(effects):
        if effect.target not in (None, "all", "action"):
            family = effect.family if effect.family != "centre_of_mass" else f"{effect.name[:-3]}]"
            found.setdefault(family, []).append(place)
    return {family: places for family, places in found.items() if len(places) > 1}


def rivals_of(effects: Sequence[Effect]) -> dict[int, list[int]]:
    """Return for each effect those that are all of its family, or each of it."""
    rivals: dict[int, list[int]] = {}
    for every, effect in enumerate(effects):
        if effect.target == "all":
            for one, other in enumerate(effects):
                if other.family == effect.family and one != every:
                    rivals.setdefault(every, []).append(one)
                    rivals.setdefault(one, []).append(every)
    return rivals


def late_commands(
    simulator: MujocoSimulator,
    motion: Motion,
    effects: Sequence[Effect],
    priors: Priors,
    rows: Rows,
    deviations: Array,
) -> dict[str, float]:
    """Return the delay, of whole rows and time steps, that explains forces best beside all effects; {} if none."""
    late = next((effect for effect in effects if effect.name == "delay[action]"), None)
    if late is None:
        return {}
    steps = round(simulator.dt / simulator.time_step)
    grid = np.unique(np.r_[np.arange(1, steps + 1) / steps, np.arange(1.0, 6.0)]) * simulator.dt
    grid = grid[grid <= late.bounds[1] * (1 + 1e-9)]
    others = [place for place, effect in enumerate(effects) if effect.family != "delay"]
    forces = missing_force(
        simulator, motion, [{}, *({late.name: min(float(one), late.bounds[1])} for one in grid)]
    )
    targets = transformed(motion, forces.transpose(1, 2, 0))[0]
    some = _only(rows, others)
    gains = []
    for target in targets.T:
        gram = gram_of_rows(replace(some, target=target), deviations, np.zeros(len(others)))
        z = target / deviations
        values, _ = posterior_mode(
            gram.products, gram.projections, priors.scales[others], priors.low[others], priors.high[others]
        )
        gains.append(gram.projections @ values - 0.5 * values @ gram.products @ values - 0.5 * z @ z)
        gains[-1] -= float(np.log1p((values / priors.scales[others]) ** 2).sum())
    best = int(np.argmax(gains))
    return (
        {late.name: min(float(grid[best - 1]), late.bounds[1])}
        if gains[best] > gains[0] + WORTH_OF_DELAY
        else {}
    )


def _only(rows: Rows, members: Sequence[int] | NDArray[np.intp]) -> Rows:
    return replace(rows, columns=rows.columns[:, list(members)])


def _origin(effects: Sequence[Effect], values: Mapping[str, float]) -> Array:
    return np.array([values.get(effect.name, effect.neutral) - effect.neutral for effect in effects])


def _shifts(best: Weighed, neutral: Array, origin: Array) -> tuple[Array, Array]:
    """Return values of all effects, and how far they are from where the rows were taken."""
    whole = np.zeros(len(neutral))
    whole[list(best.members)] = best.values
    return whole + neutral, whole - origin


def _named(one: Weighed, effects: Sequence[Effect]) -> dict[str, float]:
    return {
        effects[place].name: float(np.clip(value + effects[place].neutral, *effects[place].bounds))
        for place, value in zip(one.members, one.values)
    }


def _bends(
    simulator: MujocoSimulator,
    motion: Motion,
    values: Mapping[str, float],
    rows: Rows,
    shifts: Array,
    best: Weighed,
    deviations: Array,
) -> bool:
    """Whether forces at these values are not those that the columns say."""
    there = transformed(motion, missing_force(simulator, motion, [values]).transpose(1, 2, 0))[0][:, 0]
    missed = (there - (rows.target - rows.columns @ shifts)) / deviations
    return bool(np.mean(missed**2) > BENT)


def _sizes(simulator: MujocoSimulator, rows: Rows, values: Array, motion: Motion) -> dict[str, float]:
    names = simulator.residual_names[len(simulator.residual_names) // 2 :]
    n_blocks = len(motion.states)
    return {
        name: float(np.sqrt(np.sum(values[rows.joint == joint] ** 2) / n_blocks))
        for joint, name in enumerate(names)
    }
