"""A simulator and a log as linear dynamics about a path: chains of states, means and slopes over what is not known."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest

import numpy as np
from joblib import Parallel, delayed, effective_n_jobs
from scipy.stats import chi2, ortho_group

from skat.diagnosis.chains import Array, Chains, Mask, Places
from skat.simulators import Simulator
from skat.simulators.base import Past
from skat.simulators.tables import episode_starts

# Transitions filtered one after the other; chains run side by side.
CHAIN_LENGTH = 64
# Step of a first derivative by the state, in units of a channel's spread.
FIRST_STEP = 1e-4
# Of the largest force on a joint, the least step of a slope by it.
SMALL_FORCE = 1e-3
# Smallest step of a derivative, where the state is known better than that.
SMALLEST_STEP = 1e-7
# Outer points of Gauss and Hermite's rule of three, in standard deviations.
OUTER = 3**0.5
# A row is bent where what a line leaves has more than this share of the standard deviation of what is not known. A mean
# is known where its standard error is less than this share of it.
BENT = 0.1
# Pairs of points about the state of such a row, at least.
PAIRS = 32
# A row from near which states end so many times their spread away has diverged, as contacts do: it has no slopes.
FAR = 1e3
# Slopes are kept where a row ends off from where they say by no more than this share of what is not known of its state.
UNSEEN = 3e-3
TIME_STEP = "timestep"
QUATERNION = ("qw", "qx", "qy", "qz")


@dataclass(frozen=True)
class StateSpace:
    """A log laid out in chains.

    Attributes
    ----------
    simulator : Simulator
    X : ndarray of shape (n_rows, n_inputs)
        As measured; what was not is a guess.
    groups : ndarray of shape (n_rows,)
        Episode of each row, as the simulator takes it; of a simulation without a state, rows that have something in
        common.
    places : tuple of two ndarrays of int of shape (n_rows,)
        Chain and step of each row.
    measured : ndarray of shape (n_chains, n_steps + 1, n_states)
        States; guesses where nothing was measured.
    mask : ndarray of bool of shape (n_chains, n_steps + 1, d)
    real : ndarray of bool of shape (n_chains, n_steps)
    carrier : ndarray of shape (d, n_forces)
        How a random force enters the state where the simulator has no forces on joints.
    spread : ndarray of shape (d,)
        Standard deviation of a chain's first state about the path, before measurements.
    origin : ndarray of int of shape (n_chains,)
        Of several logs, which one each chain is of.
    n_jobs : int or None
        Processes of joblib that share the simulations of candidates.
    """

    simulator: Simulator
    X: Array
    groups: Places
    places: tuple[Places, Places]
    measured: Array
    mask: Mask
    real: Mask
    carrier: Array
    spread: Array
    origin: Places
    n_jobs: int | None = None

    @property
    def n_logs(self) -> int:
        """Number of logs."""
        return int(self.origin.max()) + 1

    @property
    def origins(self) -> Places:
        """Which log each row is of, (n_rows,)."""
        return self.origin[self.places[0]]

    @property
    def d(self) -> int:
        """Number of channels of a residual."""
        return int(self.mask.shape[-1])

    @property
    def parts(self) -> list[Places]:
        """Channels that act on each other, part by part."""
        names = self.simulator.residual_names
        return [np.array([names.index(name) for name in part]) for part in self.simulator.parts()]

    def channels_of(self, effect: str) -> Places:
        """Return the channels that an effect, by its name, may act on."""
        part = self.simulator.part_of(effect)
        return np.arange(self.d) if part is None else self.parts[part]

    def rows(self, path: Array) -> Array:
        """Return the rows of inputs that start on a path, (n_rows, n_inputs)."""
        X = self.X.copy()
        if self.simulator.state_names:
            X[:, : path.shape[-1]] = path[:, :-1][self.places]
        return X

    def simulated(
        self, rows: Array, candidates: Sequence[Mapping[str, float]], forces: Array | None = None
    ) -> Array:
        """Return the outputs of rows under each candidate, (n_candidates, n_rows, n_outputs); see `Linear.forces`."""
        run = partial(self.simulator.predict_many, rows, groups=self.groups, forces=forces)
        jobs = effective_n_jobs(self.n_jobs)
        if jobs == 1 or len(candidates) < 2:
            return run(candidates)
        parts = np.array_split(np.arange(len(candidates)), min(jobs, len(candidates)))
        outputs = Parallel(n_jobs=self.n_jobs)(
            delayed(run)([candidates[one] for one in part]) for part in parts
        )
        return np.concatenate(outputs)

    def past(self, rows: Array, candidates: Sequence[Mapping[str, float]], forces: Array | None) -> Past:
        """Return what rows have of those before them under each candidate; see `Simulator.past`."""
        return self.simulator.past(rows, candidates, groups=self.groups, forces=forces)

    def path_ends(self, path: Array) -> Array:
        """Return the states in which the rows end on a path, (n_rows, n_states)."""
        return path[:, 1:][self.places]

    def padded(self, rows: Array) -> Array:
        """Return what belongs to rows as (n_chains, n_steps, ...), zero in padding."""
        out = np.zeros((*self.real.shape, *rows.shape[1:]))
        out[self.places] = rows
        return out


@dataclass(frozen=True)
class Forces:
    """What is known of random forces as rows begin.

    A joint that a lasting force moves does not rest against its friction, as it would without.

    Attributes
    ----------
    means, deviations : ndarray of shape (n_rows, n_forces)
        Of their laws given what was measured until then.
    """

    means: Array
    deviations: Array


@dataclass(frozen=True)
class ByRow:
    """The simulation about a path, row by row.

    Attributes
    ----------
    outputs : ndarray of shape (n_rows, n_outputs)
        On the path.
    transitions, bends : ndarray of shape (n_rows, d, d)
        As in `Chains`, but for what forces bend.
    beyond : ndarray of shape (n_rows, d)
        By how much the mean over what is not known of a row's state is beyond the simulation on the path.
    origins, ends : ndarray of shape (n_rows, n_states), (n_rows, n_outputs)
        States about which the slopes of each row were taken, and what the simulation made of them.
    about : ndarray of shape (n_rows, n_forces)
        Random forces with which slopes by the state were taken.
    kinks : ndarray of shape (n_rows, d, n_forces)
        Second differences by each force over what is not known of it.
    roots : ndarray of shape (n_rows, d, d)
        Of the covariances of the states over which slopes were taken.
    unsure : ndarray of shape (n_rows, n_forces)
        Standard deviations of the forces over which they were.
    carrier : ndarray of shape (n_rows, d, n_forces) or None
        As in `Chains`; None where the simulator has no forces on joints.
    """

    outputs: Array
    transitions: Array
    bends: Array
    beyond: Array
    origins: Array
    ends: Array
    about: Array
    kinks: Array
    roots: Array
    unsure: Array
    carrier: Array | None

    def with_rows(self, chosen: Mask, other: "ByRow") -> "ByRow":
        """Return these rows with some of them replaced: `other` holds these alone."""
        filled = {}
        for name in self.__dataclass_fields__:
            whole, part = getattr(self, name), getattr(other, name)
            if whole is not None:
                filled[name] = whole.copy()
                filled[name][chosen] = part
        return replace(self, **filled)

    def with_forces(self, chosen: Mask, carrier: Array | None, kinks: Array, unsure: Array) -> "ByRow":
        """Return these rows with other slopes by forces in some of them."""
        own = {"carrier": carrier, "kinks": kinks, "unsure": unsure}
        filled = {name: getattr(self, name).copy() for name, part in own.items() if part is not None}
        for name, whole in filled.items():
            whole[chosen] = own[name]
        return replace(self, **filled)


@dataclass(frozen=True)
class Linear:
    """The simulation about a path.

    Attributes
    ----------
    path : ndarray of shape (n_chains, n_steps + 1, n_states)
    chains : Chains
    valid : ndarray of bool of shape (n_rows,)
        Rows in which it did not diverge.
    forces : Forces
        With whose means rows are simulated.
    by_row : ByRow
    """

    path: Array
    chains: Chains
    valid: Mask
    forces: Forces
    by_row: ByRow

    @property
    def outputs(self) -> Array:
        """Of the simulation on the path, (n_rows, n_outputs)."""
        return self.by_row.outputs


def state_space(
    simulator: Simulator,
    X: Array,
    y: Array,
    episodes: Places,
    *,
    consecutive: bool,
    chain_length: int = CHAIN_LENGTH,
    origins: Places | None = None,
    n_jobs: int | None = None,
) -> StateSpace:
    """Lay out a checked log.

    Parameters
    ----------
    simulator : Simulator
    X, y : ndarray of shape (n_rows, n_inputs), (n_rows, n_outputs)
        NaN in states and outputs where nothing was measured.
    episodes : ndarray of int of shape (n_rows,)
    consecutive : bool
        Whether the rows of an episode follow each other in time.
    chain_length : int, optional
        Most transitions that are filtered one after the other.
    origins : ndarray of int of shape (n_rows,), optional
        Which log each row is of, where there are several.
    n_jobs : int, optional
        Processes of joblib that share the simulations of candidates.
    """
    n_states = len(simulator.state_names)
    (chain, step), states = in_chains(
        simulator, X, y, episodes, consecutive=consecutive, chain_length=chain_length
    )
    if n_states and not consecutive:
        episodes = chain
    shape = len(states), states.shape[1] - 1
    real = np.zeros(shape, dtype=bool)
    real[chain, step] = True
    starts_rows = np.flatnonzero(step == 0)
    X = X.copy()
    d = len(simulator.residual_names)
    seen = np.isfinite(states)
    if n_states and consecutive and chain_length > 1:
        # A state at which an episode was cut belongs to the chain that it begins.
        last = np.r_[starts_rows[1:] - 1]
        cut = episodes[last] == episodes[last + 1]
        seen[chain[last][cut], step[last][cut] + 1] = False
    guesses = filled_in(simulator, X, episodes if consecutive else None, (chain, step), states)
    mask = tangent_mask(simulator, seen)
    rows = X
    if n_states:
        rows[:, :n_states] = guesses[:, :-1][chain, step]
    flat = guesses[np.concatenate([np.ones((shape[0], 1), bool), real], axis=1)]
    spread = tangents(simulator, flat).std(axis=0)
    spread = np.maximum(spread, 1e-6 * max(float(spread.max(initial=0.0)), 1e-6))
    carrier = _carrier(simulator, spread) if n_states else np.zeros((d, 0))
    origin = np.zeros(shape[0], dtype=int) if origins is None else origins[starts_rows]
    return StateSpace(
        simulator,
        rows,
        episodes,
        (chain, step),
        guesses,
        mask,
        real,
        carrier,
        3 * spread,
        origin,
        n_jobs,
    )


def in_chains(
    simulator: Simulator,
    X: Array,
    y: Array,
    episodes: Places,
    *,
    consecutive: bool,
    chain_length: int = CHAIN_LENGTH,
) -> tuple[tuple[Places, Places], Array]:
    """Return chain and step of each row, and the states as measured, (n_chains, n_steps + 1, n_states).

    Rows that do not follow each other in time are a chain each; a one-shot simulator's have no state before.
    """
    n_states = len(simulator.state_names)
    n_rows = len(X)
    step = np.zeros(n_rows, dtype=int)
    if consecutive and n_states:
        step = steps_of(episodes)
        lengths = np.diff(np.r_[np.flatnonzero(step == 0), n_rows])
        # Pieces of one episode are about as long as each other.
        longest = np.ceil(lengths / np.ceil(lengths / chain_length)).astype(int)
        longest = np.repeat(longest, lengths)
        new = (step % longest) == 0
        step = step % longest
        chain = np.cumsum(new) - 1
    else:
        chain = np.arange(n_rows)
    states = np.full((int(chain[-1]) + 1, int(step.max()) + 2, y.shape[1]), np.nan)
    states[chain, step + 1] = y
    if n_states:
        states[np.arange(len(states)), 0] = X[np.flatnonzero(step == 0), :n_states]
    return (chain, step), states


def steps_of(episodes: Places) -> Places:
    """Return the place of each row in its episode, from 0; the rows of an episode follow each other."""
    return np.arange(len(episodes)) - episode_starts(episodes, len(episodes))


def linearise(
    space: StateSpace,
    path: Array,
    values: Mapping[str, float],
    covariances: Array | None = None,
    *,
    forces: Forces | None = None,
    slopes: Linear | None = None,
    renewed: bool = False,
) -> Linear:
    """Return the simulation about a path, its slopes and means over what is not known of the states.

    Parameters
    ----------
    space : StateSpace
    path : ndarray of shape (n_chains, n_steps + 1, n_states)
    values : mapping from name to value
    covariances : ndarray of shape (n_chains, n_steps + 1, d, d), optional
        What is not known of the states; without it, slopes are those at a point.
    forces : Forces, optional
        What is known of random forces as a row begins; by default they are those of `slopes`, or zero.
    slopes : Linear, optional
        Take slopes, and what is beyond them, of this one, which is near: a simulation of each row is all it costs.
    renewed : bool, default=False
        Whether they are taken anew in rows that do not go as those of `slopes` say.

    Returns
    -------
    Linear

    Notes
    -----
    The points of a row are its state and, along each principal axis of the covariance, those of Gauss and Hermite's
    rule of three. With h the second differences between them, f has the mean f + sum(h) / 6 and, beside its slope, the
    covariance sum(h h') / 18, if it is quadratic; nearer points say the same of such a function, and are led far
    astray by one that jumps. Where that covariance is large there are more points, see `_averaged`.
    """
    simulator, places = space.simulator, space.places
    rows, after = space.rows(path), space.path_ends(path)
    known = None if covariances is None else covariances[:, :-1][places]
    if forces is None:
        nothing = np.zeros((len(rows), len(simulator.joint_forces())))
        forces = Forces(nothing, nothing) if slopes is None else slopes.forces
    acting, unsure = forces.means, forces.deviations
    rough = simulator.coarsely(values)
    if simulator.state_names and slopes is None:
        past = space.past(rows, [rough], acting)
        outputs = None if rough == values else space.simulated(rows, [values], acting)[0]
        found = _sloped(space, rows, after, outputs, rough, known, unsure, past)
        return _assembled(space, path, forces, found)
    (outputs,) = space.simulated(rows, [values], acting)
    if not simulator.state_names or slopes is None:
        return _assembled(space, path, forces, _without_states(outputs, space.d))
    found = replace(slopes.by_row, outputs=np.where(slopes.valid[:, None], outputs, np.nan))
    if not renewed or covariances is None:
        return _assembled(space, path, forces, found)
    hold, pushed = _as_expected(space, slopes, path, forces, outputs, covariances)
    anew = ~(slopes.valid & hold)
    if anew.any():
        part = covariances[:, :-1][places][anew]
        past = space.past(rows, [rough], acting).of(np.flatnonzero(anew))
        there = _sloped(space, rows[anew], after[anew], outputs[anew], rough, part, unsure[anew], past)
        found = found.with_rows(anew, there)
    forced = pushed & ~anew
    if forced.any():
        past = space.past(rows, [rough], acting).of(np.flatnonzero(forced))
        (base,) = simulator.predict_many(rows[forced], [rough], past=past)
        own = rows[forced], rough, base, after[forced], unsure[forced], past
        found = found.with_forces(forced, *_joint_carrier(space, *own), unsure[forced])
    return _assembled(space, path, forces, found)


def about_forces(
    space: StateSpace, linear: Linear, values: Mapping[str, float], forces: Forces, covariances: Array
) -> Linear:
    """Return the simulation about a path that it was about, with other forces and its own slopes by them.

    Slopes by the state, and what is beyond them, stay, and so do slopes by forces in rows that go as these say when all
    joints are pushed at once, as far as the states there are known; see `linearise`.
    """
    rows, after = space.rows(linear.path), space.path_ends(linear.path)
    rough = space.simulator.coarsely(values)
    past = space.past(rows, [rough], forces.means)
    (base,) = space.simulator.predict_many(rows, [rough], past=past)
    outputs = base if rough == values else space.simulated(rows, [values], forces.means)[0]
    base, outputs = (np.where(linear.valid[:, None], one, np.nan) for one in (base, outputs))
    unknown = np.sqrt(np.maximum(np.diagonal(covariances, axis1=-2, axis2=-1), 0.0))[:, 1:][space.places]
    near = linear.by_row.carrier, unknown
    carrier, kinks = _joint_carrier(space, rows, rough, base, after, forces.deviations, past, near)
    found = replace(linear.by_row, outputs=outputs, carrier=carrier, kinks=kinks, unsure=forces.deviations)
    return _assembled(space, linear.path, forces, found)


def _as_expected(
    space: StateSpace, slopes: Linear, path: Array, forces: Forces, outputs: Array, covariances: Array
) -> tuple[Mask, Mask]:
    """Return of which rows slopes still say where they end, as far as the states there are known.

    Either the simulation is as good as linear between the states about which they were taken and those of the path, or
    what is known of both is about the same: no mean over it is known better than by so much.

    And of which rows slopes by forces would be taken over other ones.
    """
    simulator, places, own = space.simulator, space.places, slopes.by_row
    moved = simulator.residual(path[:, :-1][places], own.origins)
    expected = (own.transitions @ moved[..., None])[..., 0]
    if own.carrier is not None:
        expected += (own.carrier @ (forces.means - own.about)[..., None])[..., 0]
    safe = finite(own.ends, space.path_ends(path))
    off = np.abs(simulator.residual(finite(outputs, safe), safe) - expected)
    left = np.diagonal(own.bends, axis1=-2, axis2=-1)
    bent = np.sqrt(np.maximum(left, 0.0))
    unknown = np.sqrt(np.maximum(np.diagonal(covariances, axis1=-2, axis2=-1), 0.0))[:, 1:][places]
    as_said: Mask = np.all(np.maximum(off, bent) < UNSEEN * unknown, axis=1)
    roots = roots_of(covariances[:, :-1][places], space.spread, space.parts)
    inverse = np.linalg.inv(own.roots)
    wider = inverse @ roots
    wider = np.abs(wider @ wider.swapaxes(1, 2) - np.eye(space.d)).max(axis=(1, 2))
    away = np.abs((inverse @ moved[..., None])[..., 0]).max(axis=1)
    same: Mask = (wider < 2 * BENT) & (away < BENT) & np.all(off < BENT * unknown, axis=1)
    before, now = (_force_steps(simulator, one) for one in (own.unsure, forces.deviations))
    # What is linear over a force is so over less of it.
    kinked = np.any(np.abs(own.kinks) > UNSEEN * unknown[..., None], axis=1)
    pushed: Mask = np.any((now > (1 + BENT) * before) | kinked & (now < (1 - BENT) * before), axis=1)
    return (as_said | same) & np.isfinite(outputs).all(axis=1), pushed


def _without_states(outputs: Array, d: int) -> ByRow:
    n = len(outputs)
    flat, nothing, unbent = np.zeros((n, d, d)), np.zeros((n, 0)), np.zeros((n, d, 0))
    return ByRow(
        outputs, flat, flat, np.zeros((n, d)), nothing, nothing, nothing, unbent, flat, nothing, None
    )


def _sloped(
    space: StateSpace,
    rows: Array,
    after: Array,
    outputs: Array | None,
    values: Mapping[str, float],
    covariances: Array | None,
    unsure: Array,
    past: Past,
) -> ByRow:
    """Return rows with slopes taken over what is not known of the states that they start from, (n_rows, d, d).

    The rows end at `outputs`, if these are given, and slopes are those at `values`; see `Simulator.coarsely`.
    """
    d, n, units, parts = space.d, len(rows), space.spread, space.parts
    roots = (
        np.tile(np.diag(FIRST_STEP * units), (n, 1, 1))
        if covariances is None
        else roots_of(covariances, units, parts)
    )
    base, up, down = _ends(space, rows, after, values, OUTER * _at_once(roots, parts), past)
    inverse = np.linalg.inv(roots)
    transitions = _by_part((up - down) / (2 * OUTER), parts) @ inverse
    far = np.any(np.maximum(np.abs(up), np.abs(down)) > FAR * units[:, None], axis=(1, 2))
    base = np.where(far[:, None], np.nan, base)
    bends, beyond = np.zeros((n, d, d)), np.zeros((n, d))
    carrier, kinks = _joint_carrier(space, rows, values, base, after, unsure, past)
    if covariances is not None:
        second = _by_part(up + down, parts)
        bends, beyond = _left_by(second), _mean_of(second)
        bent = is_bent(transitions, bends, covariances) & ~far
        if bent.any():
            own = past.of(np.flatnonzero(bent))
            many = _averaged(space, rows[bent], after[bent], values, roots[bent], own)
            transitions[bent], bends[bent], beyond[bent] = many
            transitions[bent] = transitions[bent] @ inverse[bent]
    outputs = base if outputs is None else outputs.copy()
    outputs[~np.isfinite(base).all(axis=1)] = np.nan
    origins = rows[:, : len(space.simulator.state_names)]
    about = np.zeros((n, 0)) if past.forces is None else past.forces
    return ByRow(outputs, transitions, bends, beyond, origins, outputs, about, kinks, roots, unsure, carrier)


def _mean_of(second: Array) -> Array:
    """Return the mean that second differences (n_rows, d, k) at the outer points of `linearise` stand for."""
    means: Array = second.sum(axis=-1) / (2 * OUTER**2)
    return means


def _left_by(second: Array) -> Array:
    """Return the covariance that they do, (n_rows, d, d)."""
    return second @ second.swapaxes(1, 2) / (2 * OUTER**4)


def _at_once(columns: Array, parts: Sequence[Places]) -> Array:
    """Return columns (n, d, d) that stay in their parts, those of all parts beside each other: (n, d, largest part)."""
    out = np.zeros((*columns.shape[:2], max(map(len, parts))))
    for part in parts:
        out[:, part, : len(part)] = columns[:, part[:, None], part]
    return out


def _by_part(columns: Array, parts: Sequence[Places]) -> Array:
    """Return, of columns for all parts at once, those of each: the inverse of `_at_once`."""
    out = np.zeros((*columns.shape[:2], columns.shape[1]))
    for part in parts:
        out[:, part[:, None], part] = columns[:, part, : len(part)]
    return out


def _averaged(
    space: StateSpace, rows: Array, after: Array, values: Mapping[str, float], roots: Array, past: Past
) -> tuple[Array, Array, Array]:
    """Return slopes by standard normal variables, the covariance of what these leave, and means beyond the centre.

    Over the points of `normal_points` and their negatives, the same for all rows.
    """
    parts = space.parts
    d = max(map(len, parts))
    Z = normal_points(d, max(PAIRS, d + 1))
    _, up, down = _ends(space, rows, after, values, _at_once(roots, parts) @ Z, past)
    odd, even = (up - down) / 2, (up + down) / 2
    slopes = _by_part(odd @ Z.T / Z.shape[1], parts)
    beyond = even.mean(axis=-1)
    left, scatter = odd - _at_once(slopes, parts) @ Z, even - beyond[..., None]
    bends = np.zeros_like(slopes)
    for part in parts:
        own, other = left[:, part], scatter[:, part]
        bends[:, part[:, None], part] = own @ own.swapaxes(1, 2) / (Z.shape[1] - d)
        bends[:, part[:, None], part] += other @ other.swapaxes(1, 2) / (Z.shape[1] - 1)
    return slopes, bends, beyond


def normal_points(d: int, least: int) -> Array:
    """Return points (d, n_points), so many at least, that with their negatives stand for a standard normal law.

    They lie on axes turned at random, as far out as its quantiles: first and second moments are exact.
    """
    times = -(-least // d)
    turned = np.ones((times, 1, 1))
    if d > 1:
        turned = ortho_group.rvs(d, size=times, random_state=0).reshape(times, d, d)
    squares = chi2.ppf((np.arange(times) + 0.5) / times, d)
    radii = np.sqrt(squares * d / squares.mean())
    points: Array = np.concatenate(radii[:, None, None] * turned, axis=1)
    return points


def _ends(
    space: StateSpace, rows: Array, after: Array, values: Mapping[str, float], offsets: Array, past: Past
) -> tuple[Array, Array, Array]:
    """Return where rows end, and by how much off from there if they start displaced by offsets or by their negatives.

    Both are of shape (n_rows, d, k), as `offsets` is. What was before a row is as it was.
    """
    simulator = space.simulator
    moved = [rows]
    for offset in np.moveaxis(offsets, -1, 0):
        moved += [simulator.displace(rows, offset), simulator.displace(rows, -offset)]
    copies = past.of(np.tile(np.arange(len(rows)), len(moved)))
    (outputs,) = simulator.predict_many(np.concatenate(moved), [values], past=copies)
    outputs = outputs.reshape(len(moved), len(rows), -1)
    safe = finite(outputs[0], after)
    off = np.stack([simulator.residual(finite(one, safe), safe) for one in outputs[1:]], axis=-1)
    return outputs[0], off[..., ::2], off[..., 1::2]


def is_bent(transitions: Array, bends: Array, covariances: Array, share: float = BENT) -> Mask:
    """Return which rows end off from where any line has them, as far as it is known where they start.

    Parameters
    ----------
    transitions, bends : ndarray of shape (n_rows, d, d)
        As in `Chains`.
    covariances : ndarray of shape (n_rows, d, d)
        Of the states that the rows start from.
    share : float, default=0.1
        Of the standard deviation of what is not known of where they end: from so much on.
    """
    unknown = transitions @ covariances @ transitions.swapaxes(1, 2) + covariances
    bent: Mask = np.any(
        np.diagonal(bends, axis1=1, axis2=2) > share**2 * np.diagonal(unknown, axis1=1, axis2=2), axis=1
    )
    return bent


def _joint_carrier(
    space: StateSpace,
    rows: Array,
    values: Mapping[str, float],
    base: Array,
    safe: Array,
    unsure: Array,
    past: Past,
    near: tuple[Array | None, Array] | None = None,
) -> tuple[Array | None, Array]:
    """Return the slope of the next state by a force on each joint, and second differences, both (n_rows, d, n_forces).

    Over what is not known of the force, as slopes by the state are: a joint that rests against its friction gives way
    to a large force, and to one side before the other. Slopes are None where the simulator has no forces on joints.
    Those of `near` are kept in rows that end, as far as that is known there (n_rows, d), as they say.
    """
    names = [effect.name for effect, _ in space.simulator.joint_forces()]
    kinks = np.zeros((len(rows), space.d, len(names)))
    if not names:
        return None, kinks
    steps, base = _force_steps(space.simulator, unsure), finite(base, safe)

    def pushed(asked: Places, pushes: Array) -> Array:
        """Return by how much off some rows end if their joints are pushed."""
        forces = pushes if past.forces is None else past.forces[asked] + pushes
        moved = replace(past.of(asked), forces=forces)
        (after,) = space.simulator.predict_many(rows[asked], [values], past=moved)
        return space.simulator.residual(finite(after, base[asked]), base[asked])

    columns, asked, groups = np.zeros_like(kinks), np.arange(len(rows)), told_apart(space, names)
    if near is not None and near[0] is not None and len(groups) > 1:
        columns, said = near[0].copy(), (near[0] @ steps[..., None])[..., 0]
        off = np.maximum(*(np.abs(pushed(asked, sign * steps) - sign * said) for sign in (1, -1)))
        asked = np.flatnonzero(~np.all(off < UNSEEN * near[1], axis=1))
        columns[asked] = 0.0
    for group in groups if len(asked) else ():
        pushes = np.where(np.isin(names, group), steps[asked], 0.0)
        up, down = (pushed(asked, sign * pushes) for sign in (1, -1))
        for name in group:
            channels, place = space.channels_of(name), names.index(name)
            own = asked[:, None], channels, place
            columns[own] = (up - down)[:, channels] / (2 * steps[asked, place, None])
            kinks[own] = (up + down)[:, channels]
    return columns, kinks


def _force_steps(simulator: Simulator, unsure: Array) -> Array:
    """Return over which forces slopes are taken, where so much is not known of them, (n_rows, n_forces)."""
    largest = np.array([effect.bounds[1] for effect, _ in simulator.joint_forces()])
    steps: Array = np.clip(OUTER * unsure, SMALL_FORCE * largest, largest)
    return steps


def told_apart(space: StateSpace, names: Sequence[str]) -> list[list[str]]:
    """Return effects in groups whose members act in a part each: one simulation of all of them tells each one's."""
    by_part: dict[int | None, list[str]] = {}
    for name in names:
        by_part.setdefault(space.simulator.part_of(name), []).append(name)
    alone = [[name] for name in by_part.pop(None, [])]
    return alone + [[name for name in group if name] for group in zip_longest(*by_part.values())]


def roots_of(covariances: Array, units: Array, parts: Sequence[Places]) -> Array:
    """Return roots of covariances, (n_rows, d, d), no axis of which is too short or too long for a slope."""
    roots = np.zeros(covariances.shape)
    for part in parts:
        own, block = units[part], (..., part[:, None], part)
        variances, axes = np.linalg.eigh(covariances[block] / (own[:, None] * own))
        roots[block] = axes * own[:, None] * np.sqrt(np.clip(variances, SMALLEST_STEP**2, 1.0))[:, None]
    return roots


def moved_path(space: StateSpace, path: Array, deviations: Array) -> Array:
    """Return a path displaced by deviations (n_chains, n_steps + 1, d)."""
    if not space.simulator.state_names:
        return path
    return space.simulator.displace(path, deviations)


def _assembled(space: StateSpace, path: Array, forces: Forces, found: ByRow) -> Linear:
    after = space.path_ends(path)
    # Of a force that is known all is linear.
    kinks = np.where(forces.deviations[:, None] > 0, found.kinks, 0.0)
    drive = space.simulator.residual(finite(found.outputs, after), after) + found.beyond + _mean_of(kinks)
    if found.carrier is not None:
        # Forces of a chain are whole ones, and begin at zero.
        drive -= (found.carrier @ forces.means[..., None])[..., 0]
    sound = [
        np.isfinite(one).reshape(len(one), -1).all(axis=1)
        for one in (found.outputs, found.transitions, drive)
    ]
    valid: Mask = np.logical_and.reduce(sound)
    there = valid[:, None, None]
    found = replace(
        found,
        transitions=np.where(there, found.transitions, 0.0),
        bends=np.where(there, found.bends, np.diag(space.spread**2)),
        kinks=np.where(there, found.kinks, 0.0),
        # What is not simulated is not pushed either: it may be anywhere.
        carrier=None if found.carrier is None else np.where(there, found.carrier, 0.0),
    )
    whole = np.tile(np.eye(space.d), (*space.real.shape, 1, 1))
    whole[space.places] = found.transitions
    if found.carrier is None:
        carrier = np.broadcast_to(space.carrier, (*space.real.shape, *space.carrier.shape))
    else:
        carrier = space.padded(found.carrier)
    chains = Chains(
        whole,
        space.padded(np.where(valid[:, None], drive, 0.0)),
        space.padded(found.bends + _left_by(np.where(there, kinks, 0.0))),
        carrier,
        np.where(space.mask, space.simulator.residual(space.measured, path), 0.0),
        space.mask,
        space.spread**2,
    )
    return Linear(path, chains, valid, forces, found)


def finite(values: Array, otherwise: Array) -> Array:
    """Return rows of values, or others in the place of those that are not finite."""
    bad: Mask = np.asarray(~np.isfinite(values).all(axis=-1))
    return np.where(bad[..., None], otherwise, values) if bad.any() else values


def quaternions(names: Sequence[str]) -> Iterator[tuple[str, list[int]]]:
    """Yield each joint that has a quaternion among columns, and its columns."""
    for name in names:
        if name.endswith(".qw"):
            joint = name[: -len(".qw")]
            yield joint, [names.index(f"{joint}.{part}") for part in QUATERNION]


def tangents(simulator: Simulator, states: Array) -> Array:
    """Return states (n, n_outputs) in the channels of a residual, from the first of them, (n, d)."""
    return simulator.residual(states, np.broadcast_to(states[:1], states.shape))


def tangent_mask(simulator: Simulator, seen: Mask) -> Mask:
    """Return which channels of a residual were measured: a rotation as a whole, or not."""
    outputs, tangent = simulator.output_names, simulator.residual_names
    if outputs == tangent:
        return seen
    mask = np.empty((*seen.shape[:-1], len(tangent)), dtype=bool)
    for column, name in enumerate(tangent):
        if name in outputs:
            mask[..., column] = seen[..., outputs.index(name)]
        else:
            joint = name[: -len(".rx")]
            parts = [outputs.index(f"{joint}.{part}") for part in QUATERNION]
            mask[..., column] = seen[..., parts].all(axis=-1)
    return mask


def filled_in(
    simulator: Simulator, X: Array, episodes: Places | None, places: tuple[Places, Places], states: Array
) -> Array:
    """Return the states of chains with what was not measured filled in, (n_chains, n_steps + 1, n_outputs).

    See `guessed`; states that nobody measured at all are what the simulation makes of the others: row by row, from the
    model's own place.

    Parameters
    ----------
    simulator : Simulator
    X : ndarray of shape (n_rows, n_inputs)
    episodes : ndarray of int of shape (n_rows,) or None
        Whose rows follow each other in time; none do, if None.
    places, states
        As `in_chains` returns them.
    """
    guesses = guessed(simulator, states)
    hidden = _never_seen(simulator.output_names, states)
    n_states = len(simulator.state_names)
    if not n_states or not len(hidden):
        return guesses
    each = np.arange(len(X)) if episodes is None else np.unique(episodes, return_inverse=True)[1]
    times = np.zeros(len(X), dtype=int) if episodes is None else steps_of(each)
    order = np.argsort(times, kind="stable")
    now = np.tile(simulator.reference_state[hidden], (int(each.max()) + 1, 1))
    chain, step = places
    for rows in np.split(order, np.flatnonzero(np.diff(times[order])) + 1):
        guesses[chain[rows, None], step[rows, None], hidden] = now[each[rows]]
        inputs = X[rows].copy()
        inputs[:, :n_states] = guesses[chain[rows], step[rows]]
        (ends,) = simulator.predict_many(inputs, [{}], groups=np.arange(len(rows)))
        safe = np.isfinite(ends).all(axis=1)
        now[each[rows[safe]]] = ends[safe][:, hidden]
        guesses[chain[rows, None], step[rows, None] + 1, hidden] = now[each[rows]]
    return guesses


def _never_seen(names: Sequence[str], states: Array) -> Places:
    """Return the columns of states that were not measured at any time, and that no position tells."""
    unseen: Mask = np.asarray(~np.isfinite(states).any(axis=(0, 1)))
    told = [
        name.startswith("qvel.")
        and (place := name.replace("qvel.", "qpos.", 1)) in names
        and not unseen[names.index(place)]
        for name in names
    ]
    return np.flatnonzero(unseen & ~np.array(told))


def guessed(simulator: Simulator, states: Array) -> Array:
    """Return the states with what was not measured filled in: in time, from positions, or the model's own place."""
    filled = states.copy()
    names = simulator.output_names
    rest = simulator.reference_state if simulator.state_names else np.zeros(len(names))
    times = np.arange(states.shape[1])
    for _, columns in quaternions(names):
        filled[..., columns] = _turns_between(states[..., columns])
    for column in range(states.shape[2]):
        for chain in range(states.shape[0]):
            series = filled[chain, :, column]
            known = np.isfinite(series)
            if known.any() and not known.all():
                filled[chain, :, column] = np.interp(times, times[known], series[known])
    for column, name in enumerate(names):
        if np.isfinite(filled[..., column]).all():
            continue
        position = name.replace("qvel.", "qpos.", 1)
        guess = np.full(states.shape[:2], rest[column])
        if name.startswith("qvel.") and position in names and simulator.dt:
            place = filled[..., names.index(position)]
            if np.isfinite(place).all() and place.shape[1] > 1:
                guess = np.gradient(place, axis=1) / simulator.dt
        missing = ~np.isfinite(filled[..., column])
        own = np.nanmean(states[..., column]) if np.isfinite(states[..., column]).any() else None
        filled[..., column] = np.where(missing, guess if own is None else own, filled[..., column])
    return filled


def _turns_between(turns: Array) -> Array:
    """Return quaternions (n_chains, n_times, 4) with those that were not measured between the ones before and after.

    A chain without any has the one that is nearest in the chains beside it.
    """
    known: Mask = np.asarray(np.isfinite(turns).all(axis=-1))
    told = np.flatnonzero(known.any(axis=1))
    if known.all() or not len(told):
        return turns
    filled, times = turns.copy(), np.arange(turns.shape[1])
    for chain in told:
        there = known[chain]
        measured = turns[chain, there]
        # Of the two quaternions that are each turn the one that is nearer to the one before: no mean of two is short.
        apart = np.sum(measured[1:] * measured[:-1], axis=1) < 0
        aligned = measured * np.cumprod(np.r_[1.0, np.where(apart, -1.0, 1.0)])[:, None]
        between = np.stack([np.interp(times[~there], times[there], part) for part in aligned.T], axis=-1)
        filled[chain, ~there] = between / np.linalg.norm(between, axis=1, keepdims=True)
    for chain in np.setdiff1d(np.arange(len(turns)), told):
        nearest = told[np.argmin(np.abs(told - chain))]
        filled[chain] = filled[nearest, -1 if nearest < chain else 0]
    return filled


def _carrier(simulator: Simulator, spread: Array) -> Array:
    """Return how a random acceleration of each degree of freedom enters position and velocity in a transition."""
    names, dt = simulator.residual_names, simulator.dt
    velocities = [index for index, name in enumerate(names) if name.startswith("qvel.")]
    if not velocities or dt is None or len(names) != 2 * len(velocities):
        return np.diag(spread)
    steps = int(getattr(simulator, "frame_skip", 1))
    carrier = np.zeros((len(names), len(velocities)))
    for force, index in enumerate(velocities):
        carrier[index, force] = dt
        carrier[index - len(velocities), force] = dt**2 * (steps + 1) / (2 * steps)
    return carrier
