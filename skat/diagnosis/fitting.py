"""Fits of the state space: values of a set of causes, noise, path and slopes, and the Gram matrices of a search."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skat.diagnosis.chains import NO_MEMORY, Array, Chains, Mask, Memory
from skat.diagnosis.evidence import Gram, Priors
from skat.diagnosis.filtering import Filtered, filter_columns, kalman_filter, updated
from skat.diagnosis.noise import TOLERANCE, Estimate, Noise, estimate_noise, normal_noise, passed
from skat.diagnosis.slopes import derivatives
from skat.diagnosis.statespace import (
    Forces,
    Linear,
    StateSpace,
    about_forces,
    finite,
    is_bent,
    linearise,
    moved_path,
    tangents,
)
from skat.diagnosis.velocities import noise_variance
from skat.effects import Effect
from skat.simulators.base import Simulator

# A path stands still when taking it anew changes the bound by less than so many nats.
STILL = 1.0
# What hits bends a row by so much of the standard deviation of what is not known of where it ends; a motor that reaches
# its limit, by less.
HIT = 0.5
# How often path and slopes are taken anew at most.
TURNS = 16
# Simulations in which the forces that are known come to rest, where another set's were known before; one elsewhere.
FORCE_TURNS = 2
# Of an effect's typical size: slopes are taken over no less; means of slopes, in rows that are bent, over no less than
# five times as much: over less, what jumps seems to be known too well.
SMALL_SHARE, BENT_SHARE = 0.05, 0.25
# Memories of random forces that are tried, in rows; of at most this share of an episode, so that what is steady stays a
# cause; and what each of their numbers must be worth, in nats, as each that says how forces act together.
MEMORIES = (2.0, 5.0, 10.0, 20.0, 40.0)
SHARE_OF_EPISODE = 0.1
NUMBER_WORTH = 2.0
FEWEST_FOR_MEMORY = 10
# Innovations are compared with so many before them: by more, chance says more of it.
WHITE_LAGS = 5
# Scores are compared between pieces of time of at most so many rows, about so many of them, at least so many.
BLOCK_ROWS, MOST_BLOCKS, FEWEST_BLOCKS = 32, 60, 10


@dataclass(frozen=True)
class Known:
    """What is known of the sensors' noise; the rest is estimated.

    Attributes
    ----------
    floor : ndarray of shape (d,) or (n_logs, d), or None
        Least variance of each channel's noise; by default 0.
    given : ndarray of shape (d,) or None
        Standard deviation of each channel's noise, where it is known.
    tolerance : float, default=0.1
        To which noise is estimated, nats.
    """

    floor: Array | None = None
    given: Array | None = None
    tolerance: float = TOLERANCE

    def estimated(self, chains: Chains, noise: Noise, real: Mask) -> Estimate:
        """Return the noise of chains, and the pass with it, from a start."""
        return estimate_noise(
            chains, noise, real, floor=self.least(chains), held=self.held(chains), tolerance=self.tolerance
        )

    def least(self, chains: Chains) -> Array:
        """Return the least variance of each channel, hidden states with them."""
        if self.floor is None:
            return np.zeros(chains.drive.shape[-1])
        hidden = chains.drive.shape[-1] - self.floor.shape[-1]
        return np.pad(self.floor, [(0, 0)] * (self.floor.ndim - 1) + [(0, hidden)])

    def held(self, chains: Chains) -> Mask | None:
        """Return which channels have a noise that was given."""
        if self.given is None:
            return None
        mask: Mask = np.arange(chains.drive.shape[-1]) < len(self.given)
        return mask


NOTHING_KNOWN = Known()


@dataclass(frozen=True)
class Fitted:
    """The simulation at the values of a set of causes, as a log has it.

    Attributes
    ----------
    values : mapping from name to value
    linear : Linear
        About the filtered path: each state as what was measured until then has it.
    estimate : Estimate
        Noise, and the pass of filter and smoother with it.
    chains : Chains
        Those of `linear`, with forces of memory where the noise has such.
    memory : Memory
        Of these forces.
    """

    values: Mapping[str, float]
    linear: Linear
    chains: Chains
    estimate: Estimate
    memory: Memory

    @property
    def bound(self) -> float:
        """Of the log likelihood, at this fit's own noise."""
        return self.estimate.bound


def priors_of(
    effects: Sequence[Effect], typical: Mapping[str, float] | None = None, *, logarithmic: bool = True
) -> Priors:
    """Return the priors of effects, in coordinates of the search: from neutral, factors on the logarithm.

    Parameters
    ----------
    effects : sequence of Effect
    typical : mapping from name to size, optional
        Scales of a user's own.
    logarithmic : bool, default=True
        Whether factors count on the logarithm; differences from neutral otherwise.
    """
    typical = typical or {}
    odds = np.array([effect.odds for effect in effects])
    # Beside all others and none: their sum less its own would be rounded away.
    others = 1 + np.where(np.eye(len(odds), dtype=bool), 0.0, odds).sum(axis=1)
    low, high = (
        np.array(
            [
                coordinate(effect, effect.bounds[end]) if logarithmic else effect.bounds[end] - effect.neutral
                for effect in effects
            ]
        )
        for end in (0, 1)
    )
    return Priors(
        tuple(effect.name for effect in effects),
        np.array([typical.get(effect.name, effect.typical) for effect in effects]),
        np.log(odds) - np.log(others),
        low,
        high,
    )


def first_fit(
    space: StateSpace,
    values: Mapping[str, float],
    known: Known = NOTHING_KNOWN,
    begun: Linear | None = None,
) -> Fitted:
    """Return the fit at given values, begun at what was measured: path filtered, slopes taken, noise estimated.

    Each row is linear about what was measured until it begins, over what is not known of its state. So the path is what
    values and noise make of the log, wherever it was begun: a smoothed one follows what was measured later, about
    contacts to any of several places.

    Parameters
    ----------
    space : StateSpace
    values : mapping from name to value
    known : Known, optional
    begun : Linear, optional
        Of the same rows, whose slopes are kept where they hold; see `nominal_look`.
    """
    linear = linearise(space, space.measured, values, slopes=begun)
    if not linear.valid.any():
        raise RuntimeError("The simulation diverges in every row: check the units of the states and actions.")
    typical = np.minimum(_typical(space, linear.chains.drive[space.places], linear.valid), _rough(space))
    if known.given is not None:
        typical = np.tile(known.given**2, (space.n_logs, 1))
    force = np.stack([_force_guess(linear, one) for one in typical])
    noise = normal_noise(linear.chains, force, typical, space.origin)
    estimate = known.estimated(linear.chains, noise, space.real)
    fitted = Fitted(dict(values), linear, linear.chains, estimate, NO_MEMORY)
    for turn in range(TURNS):
        before = fitted.bound
        # A memory is looked for once more about a path that has come nearer.
        fitted = next_fit(space, values, fitted, known, afresh=turn == 0 and begun is None, memories=turn < 2)
        # What rows say of each other's noise may turn in a circle: a turn that does not raise the bound is the last.
        if turn and fitted.bound - before < STILL:
            break
    return fitted


def next_fit(
    space: StateSpace,
    values: Mapping[str, float],
    start: Fitted,
    known: Known = NOTHING_KNOWN,
    *,
    afresh: bool = False,
    memories: bool = True,
) -> Fitted:
    """Return the fit at given values that follows another one: path and slopes are taken anew once, at its noise.

    Parameters
    ----------
    space, values
    start : Fitted
    known : Known, optional
    afresh : bool, default=False
        Whether slopes are taken anew in every row; otherwise in those alone that do not go as the ones before say.
    memories : bool, default=True
        Whether the memory of random forces is looked for; otherwise it is that of `start`.
    """
    means, covariances = _so_far(start)
    if start.memory and values != start.values:
        means, covariances = _filtered(_about_own_forces(space, values, start), start)
    path = moved_path(space, start.linear.path, means[..., : space.d])
    forces = known_forces(space, start.memory, start.estimate.noise, means, covariances)
    slopes, known_states = None if afresh else start.linear, covariances[..., : space.d, : space.d]
    linear = linearise(space, path, values, known_states, forces=forces, slopes=slopes, renewed=True)
    return _estimated(space, values, linear, start, known, memories=memories)


def _so_far(fitted: Fitted) -> tuple[Array, Array]:
    """Return means and covariances of the states' deviations, hidden forces with them, by what was measured so far."""
    return updated(fitted.chains, fitted.estimate.filtered, fitted.estimate.noise.error_variances)


def _filtered(linear: Linear, start: Fitted) -> tuple[Array, Array]:
    """Return what `_so_far` does of another simulation, at the noise and memory of a fit."""
    chains, noise = linear.chains.with_memory(start.memory), start.estimate.noise
    filtered = kalman_filter(chains.mixed(noise.mixings), noise.force_variances, noise.error_variances)
    return updated(chains, filtered, noise.error_variances)


def known_forces(space: StateSpace, memory: Memory, noise: Noise, means: Array, covariances: Array) -> Forces:
    """Return what is known of random forces as rows begin.

    ``means`` and ``covariances`` are those of chains with this memory by what was measured until then, see `updated`.
    """
    k = len(space.simulator.joint_forces())
    fresh = noise.joint_force[noise.law][space.places[0]]
    known, variances = np.zeros((len(space.X), k)), fresh[:, :k].copy()
    if memory and k:
        known = memory.acting(known, means[:, :-1, space.d :][space.places])
        hidden = np.diagonal(covariances, axis1=-2, axis2=-1)[:, :-1, space.d :][space.places]
        variances += hidden + (fresh[:, k:] if memory.returns else 0.0)
    return Forces(known, np.sqrt(variances))


def bent_rows(space: StateSpace, fitted: Fitted) -> Mask:
    """Return which rows of a fit are bent: their slopes depend on whose values they were taken at."""
    if not space.simulator.state_names:
        return np.zeros(len(space.X), dtype=bool)
    chains, places = fitted.linear.chains, space.places
    covariances = _so_far(fitted)[1][..., : space.d, : space.d]
    return is_bent(chains.transitions[places], fitted.linear.by_row.bends, covariances[:, :-1][places])


def compared(
    space: StateSpace,
    values: Mapping[str, float],
    start: Fitted,
    known: Known = NOTHING_KNOWN,
    *,
    memories: bool = True,
) -> Fitted:
    """Return the fit at given values about the path of another and with its slopes: few simulations of each row.

    Of two sets about one path, with the same slopes, what these differ by is not between them. But lasting forces that
    are known are its own, and slopes by these: to one set a force is what to another is friction.

    Parameters
    ----------
    space, values, start, known
        As in `next_fit`.
    memories : bool, default=True
        Whether random forces are given a memory, if they do not have one in `start`, which they keep; and noise is
        looked for from more than one start.
    """
    linear = _about_own_forces(space, values, start)
    if memories and start.memory:
        return _from_either(space, values, linear, start.estimate.noise, start.memory, known)
    return _estimated(space, values, linear, start, known, memories=memories)


def bound_at(
    space: StateSpace, values: Mapping[str, float], start: Fitted, known: Known = NOTHING_KNOWN
) -> float:
    """Return the bound at given values as `compared` has it, with the memory that forces have in another fit."""
    linear = _about_own_forces(space, values, start)
    return _from_either(space, values, linear, start.estimate.noise, start.memory, known).bound


def _about_own_forces(space: StateSpace, values: Mapping[str, float], start: Fitted) -> Linear:
    """Return the simulation about another fit's path, with the lasting forces that its noise has at these values."""
    linear = linearise(space, start.linear.path, values, slopes=start.linear)
    turns = FORCE_TURNS if values.keys() != start.values.keys() else 1
    for _ in range(turns if start.memory else 0):
        means, covariances = _filtered(linear, start)
        forces = known_forces(space, start.memory, start.estimate.noise, means, covariances)
        linear = about_forces(space, linear, values, forces, covariances[..., : space.d, : space.d])
    return linear


def _estimated(
    space: StateSpace,
    values: Mapping[str, float],
    linear: Linear,
    start: Fitted,
    known: Known,
    *,
    memories: bool,
) -> Fitted:
    """Return the fit about a path, noise estimated from that of another fit on."""
    noise, memory = start.estimate.noise, start.memory
    if memories and space.real.shape[1] > FEWEST_FOR_MEMORY:
        return _with_best_memory(space, values, linear, noise, memory, known)
    return _with_memory_of(space, values, linear, noise, memory, known)


def _typical(space: StateSpace, off: Array, valid: Mask) -> Array:
    """Return half of the typical square of what valid rows' ends (n_rows, d) are off, of each log, (n_logs, d)."""
    found = []
    for log in range(space.n_logs):
        own = valid & (space.origins == log)
        residuals = off[own if own.any() else valid]
        found.append((1.4826 * np.median(np.abs(residuals), axis=0)) ** 2 / 2 + 1e-12 * space.spread**2)
    return np.stack(found)


def _rough(space: StateSpace) -> Array:
    """Return the variance that neighbouring rows show of each channel's noise in each log, (n_logs, d).

    Motion can only add to it.

    A start from larger noise may never find a force that passes for it.
    """
    episodes = np.repeat(np.arange(len(space.measured)), space.measured.shape[1])
    flat = space.measured.reshape(len(episodes), -1)
    read = np.where(space.mask.reshape(len(episodes), -1), tangents(space.simulator, flat), np.nan)
    origins = np.repeat(space.origin, space.measured.shape[1])
    variances = np.array(
        [
            [noise_variance(series[origins == log], episodes[origins == log]) for series in read.T]
            for log in range(space.n_logs)
        ]
    )
    return np.where(variances > 0, variances, np.inf)


def nominal_look(space: StateSpace) -> Linear | None:
    """Return the nominal simulation about what was measured, over what may not be known of it.

    None of a log in which a state was not measured, and of a simulation that diverges in every row.
    """
    if not space.simulator.state_names or not space.mask[space.places].all():
        return None
    (outputs,) = space.simulated(space.rows(space.measured), [{}])
    valid = np.isfinite(outputs).all(axis=1)
    if not valid.any():
        return None
    after = space.path_ends(space.measured)
    off = space.simulator.residual(finite(outputs, after), after)
    return linearise(
        space, space.measured, {}, as_measured(space, np.minimum(_typical(space, off, valid), _rough(space)))
    )


def hits(space: StateSpace, look: Linear | None) -> bool:
    """Whether something hits in a log: some row is bent as far as sensors alone know where it starts.

    Of a log in which a state was not measured this is not known: False.
    """
    if look is None:
        return False
    known = look.by_row.roots @ look.by_row.roots.swapaxes(1, 2)
    bent = is_bent(look.by_row.transitions, look.chains.bends[space.places], known, HIT)
    return bool(bent.any())


def as_measured(space: StateSpace, noise: Array) -> Array:
    """Return covariances of states of which a measurement with such a noise (n_logs, d) alone is known."""
    least = np.minimum(noise, space.spread**2)[space.origin][:, None, :, None] * np.eye(space.d)
    return np.tile(least, (1, space.mask.shape[1], 1, 1))


def _with_memory_of(
    space: StateSpace, values: Mapping[str, float], linear: Linear, noise: Noise, memory: Memory, known: Known
) -> Fitted:
    """Return the fit at a memory of forces, from a noise that has such."""
    chains = linear.chains.with_memory(memory)
    return Fitted(dict(values), linear, chains, known.estimated(chains, noise, space.real), memory)


def _from_either(
    space: StateSpace, values: Mapping[str, float], linear: Linear, noise: Noise, memory: Memory, known: Known
) -> Fitted:
    """Return the likelier fit at a memory, from a noise and from one in which sensors have what rows show of theirs.

    Where forces passed for all that a set of causes explains, sensors were left no noise to begin with.
    """
    found = _with_memory_of(space, values, linear, noise, memory, known)
    if known.given is not None:
        return found
    rough = np.pad(_rough(space), [(0, 0), (0, noise.error.shape[1] - space.d)], constant_values=np.inf)
    read = np.where(np.isfinite(rough), np.maximum(noise.error, rough), noise.error)
    if not (read > noise.error).any():
        return found
    other = _with_memory_of(space, values, linear, replace(noise, error=read), memory, known)
    return max(found, other, key=lambda one: one.bound)


def _with_best_memory(
    space: StateSpace,
    values: Mapping[str, float],
    linear: Linear,
    noise: Noise,
    last: Memory,
    known: Known,
) -> Fitted:
    """Return the fit with forces of the memory, if any, that the bound asks for: the last, or what it climbs to."""
    n_forces = linear.chains.carrier.shape[-1]
    plain = noise.part(np.arange(space.d), np.arange(n_forces))
    without = _from_either(space, values, linear, plain, NO_MEMORY, known)
    # A variance more for each force in each log, and the memory itself.
    needed = NUMBER_WORTH * (noise.force.shape[0] * n_forces + 1)
    longest = SHARE_OF_EPISODE * np.unique(space.groups, return_counts=True)[1].max()
    memories = [
        Memory(n_forces, float(np.exp(-1 / rows)), returns)
        for returns in (False, True)
        for rows in MEMORIES
        if rows <= longest
    ]
    worth = _worth_of_memories(linear.chains, without.estimate, memories)
    asked = {int(np.argmax(worth))} if max(worth, default=0.0) >= needed else set()
    if _worth_beyond_white(linear.chains, without.estimate) >= needed:
        # Of either kind, as what filters make of a force says little of which it is.
        kinds = [
            [place for place, one in enumerate(memories) if one.returns == kind] for kind in (False, True)
        ]
        asked |= {max(kind, key=lambda place: worth[place]) for kind in kinds if kind}
    if not asked and not len(last):
        return without

    def remembered(place: int) -> Fitted:
        start = noise if last == memories[place] else _with_memory(without.estimate.noise, memories[place])
        return _with_memory_of(space, values, linear, start, memories[place], known)

    def climbed(now: int) -> Fitted:
        best, tried = remembered(now), {now}
        while beside := [one for one in (now - 1, now + 1) if one in own(memories[now]) - tried]:
            tried.add(beside[0])
            moved = remembered(beside[0])
            if moved.bound > best.bound:
                now, best = beside[0], moved
        return best

    def own(memory: Memory) -> set[int]:
        return {place for place, one in enumerate(memories) if one.returns == memory.returns}

    # Climbed to from where innovations of white forces point, and from the last one, which may be of either kind: with
    # it the log may be likelier by far though these say nothing.
    starts = asked
    if len(last) and own(last):
        nearest = min(own(last), key=lambda place: abs(memories[place].share - last.share))
        starts = {nearest} | (asked - own(last))
    best = max((climbed(start) for start in sorted(starts)), key=lambda one: one.bound, default=without)
    return best if best.bound > without.bound + needed else without


def _worth_of_memories(chains: Chains, estimate: Estimate, memories: Sequence[Memory]) -> list[float]:
    """Return about how many nats each memory would add, by how innovations go with those before, or against them.

    White forces leave white innovations. Their mean product with the sum of the k before them, in units of its standard
    error, is the score of a memory of about k rows; half its square is what the likelihood would gain.
    """
    whitened = np.where(chains.mask, estimate.filtered.whitened, 0.0)
    whitened = np.clip(whitened, -3.0, 3.0)
    worth = []
    sums = np.cumsum(whitened, axis=1)
    for memory in memories:
        rows = round(-1 / np.log(memory.share))
        if whitened.shape[1] <= rows + 1:
            worth.append(0.0)
            continue
        before = sums[:, rows - 1 : -1].copy()
        before[:, 1:] -= sums[:, : -rows - 1]
        products = whitened[:, rows:] * before
        scores = products.sum(axis=(0, 1)) / np.sqrt(np.maximum(np.sum(products**2, axis=(0, 1)), 1e-300))
        worth.append(float(np.sum(np.maximum(-scores if memory.returns else scores, 0.0) ** 2)) / 2)
    return worth


def _worth_beyond_white(chains: Chains, estimate: Estimate) -> float:
    """Return about how many nats a noise would add under which innovations go with none of the few before them.

    By the squares of their correlations, less what chance makes of them.
    """
    whitened = np.clip(np.where(chains.mask, estimate.filtered.whitened, 0.0), -3.0, 3.0)
    read, worth = np.any(whitened, axis=(0, 1)), 0.0
    for lag in range(1, min(WHITE_LAGS, whitened.shape[1] - 1) + 1):
        products = whitened[:, lag:] * whitened[:, :-lag]
        scores = products.sum(axis=(0, 1))[read] / np.sqrt(np.sum(products**2, axis=(0, 1))[read] + 1e-300)
        worth += float(np.sum(scores**2 - 1)) / 2
    return worth


def _with_memory(noise: Noise, memory: Memory) -> Noise:
    """Return a noise with forces of memory that are as large as the white ones."""
    k = len(memory)
    wide, chains = [(0, 0), (0, k)], [(0, 0), (0, 0), (0, k)]
    return Noise(
        np.concatenate([noise.force, noise.force / memory.variance(np.ones(k))], axis=1),
        np.pad(noise.error, wide, constant_values=1.0),
        np.pad(noise.force_nu, wide, constant_values=np.inf),
        np.pad(noise.error_nu, wide, constant_values=np.inf),
        noise.law,
        np.pad(noise.force_weights, chains, constant_values=1.0),
        np.pad(noise.error_weights, chains, constant_values=1.0),
        noise.mixing,
    )


def slopes_of(
    space: StateSpace,
    fitted: Fitted,
    effects: Sequence[Effect],
    sizes: Array,
    widths: Array | None = None,
    *,
    means: bool = False,
) -> Array:
    """Return the derivative of what the model adds in a step by each effect's coordinate, (n_rows, d, k).

    Parameters
    ----------
    space, fitted, effects
    sizes : ndarray of shape (k,)
        Typical of each coordinate.
    widths : ndarray of shape (k,), optional
        By how much each value may be off to either side: slopes are taken over what is not known, as those by the state
        are. Otherwise over a little of the typical size.
    means : bool, default=False
        Whether the slopes of rows that are bent are means over what is not known of where they start, as what the
        model adds is; otherwise they are those at a point.
    """
    least = SMALL_SHARE * sizes
    widths = least if widths is None else np.maximum(widths, least)
    steps = _steps(fitted.values, effects, widths) | _of_one_time_step(space, fitted, effects, widths)
    known = _so_far(fitted)[1][:, :-1, : space.d, : space.d][space.places] if means else None
    wide = _steps(fitted.values, effects, np.maximum(widths, BENT_SHARE * sizes))
    slopes = derivatives(space, fitted.linear, fitted.values, steps, known, wide)
    for column, effect in enumerate(effects):
        low, high = steps[effect.name]
        slopes[..., column] *= (high - low) / (coordinate(effect, high) - coordinate(effect, low))
    return slopes


def gram_of(space: StateSpace, fitted: Fitted, slopes: Array, effects: Sequence[Effect]) -> "Columns":
    """Return second moments of whitened innovations and derivatives, and both themselves.

    Parameters
    ----------
    space, fitted
    slopes : ndarray of shape (n_rows, d, k)
    effects : sequence of Effect
    """
    chains, filtered, certainty = fitted.chains, fitted.estimate.filtered, fitted.estimate.certainty
    columns = (response(space, chains, filtered, slopes) * certainty[..., None])[chains.mask]
    whitened = (filtered.whitened / certainty)[chains.mask]
    origin = np.array(
        [coordinate(effect, fitted.values.get(effect.name, effect.neutral)) for effect in effects]
    )
    gram = Gram(columns.T @ columns, columns.T @ whitened, origin)
    blocks = np.broadcast_to(_blocks(space)[..., None], chains.mask.shape)[chains.mask]
    # That groups have something in common was said; that pieces of time have is to be seen.
    fewest = 2 if _are_grouped(space) else FEWEST_BLOCKS
    return Columns(gram, whitened, columns, np.unique(blocks, return_inverse=True)[1], fewest)


def response(space: StateSpace, chains: Chains, filtered: Filtered, slopes: Array) -> Array:
    """Return by how much whitened innovations change with what a step adds, (n_chains, n_steps + 1, d_all, k).

    ``slopes`` (n_rows, d, k) are by how much the outcome of each row does.
    """
    hidden = chains.drive.shape[-1] - space.d
    return filter_columns(chains, filtered, space.padded(np.pad(slopes, [(0, 0), (0, hidden), (0, 0)])))


@dataclass(frozen=True)
class Columns:
    """Whitened innovations, their derivatives by each effect, and the second moments of both; see `Estimate.certainty`.

    Attributes
    ----------
    gram : Gram
    whitened : ndarray of shape (n_measured,)
    columns : ndarray of shape (n_measured, k)
    blocks : ndarray of int of shape (n_measured,)
        Piece of time, or group, that each belongs to.
    fewest : int, default=10
        Pieces between which scores are compared at least.
    """

    gram: Gram
    whitened: Array
    columns: Array
    blocks: NDArray[np.intp]
    fewest: int = FEWEST_BLOCKS

    def dense(self, scales: Array) -> Array:
        """Return what all effects together, each held by a normal law of its typical size, would move.

        Coordinates from where the slopes were taken.
        """
        sizes = np.sqrt(np.diag(self.gram.products) + 1 / scales**2)
        scaled = (self.gram.products + np.diag(1 / scales**2)) / (sizes * sizes[:, None])
        # Towards neutral, not towards where the slopes were taken.
        right = self.gram.projections - self.gram.origin / scales**2
        return np.linalg.solve(scaled, right / sizes) / sizes

    def excess(self, left: Array, origin: NDArray[np.intp] | None = None) -> Array:
        """Return by how much the score of each effect scatters between blocks of time more than the model says.

        The effect's own best value is taken out of each score.

        Parameters
        ----------
        left : ndarray of shape (n_measured,)
            Innovations with what is known to act taken out.
        origin : ndarray of int of shape (n_measured,), optional
            Which log each is of, where an effect has a best value in each.
        """
        origin = np.zeros(len(self.blocks), dtype=int) if origin is None else origin
        n_logs = int(origin.max(initial=0)) + 1
        pairs, blocks = np.unique(self.blocks * n_logs + origin, return_inverse=True)
        n_blocks = len(pairs)
        if n_blocks - n_logs < self.fewest - 1:
            return np.zeros(self.columns.shape[1])
        order = np.argsort(blocks, kind="stable")
        starts = np.searchsorted(blocks[order], np.arange(n_blocks))
        columns = self.columns[order]
        scores = np.add.reduceat(columns * left[order, None], starts)
        information = np.add.reduceat(columns**2, starts)
        model = np.maximum(information.sum(axis=0), 1e-300)
        for log in range(n_logs):
            own = pairs % n_logs == log
            scores[own] -= information[own] * (
                scores[own].sum(axis=0) / np.maximum(information[own].sum(axis=0), 1e-300)
            )
        variances = np.sum(scores**2, axis=0) * n_blocks / (n_blocks - n_logs)
        excess: Array = np.maximum(variances / model - 1, 0.0)
        return excess


def _blocks(space: StateSpace) -> NDArray[np.intp]:
    """Return the block of time of each instant, (n_chains, n_steps + 1)."""
    n_chains, steps = space.real.shape
    length = max(1, min(BLOCK_ROWS, int(space.real.sum()) // MOST_BLOCKS))
    per_chain = -(-(steps + 1) // length)
    block: NDArray[np.intp] = np.arange(n_chains)[:, None] * per_chain + np.arange(steps + 1) // length
    if steps == 1:  # rows, or groups of them, that are independent of each other
        pieces = space.groups if _are_grouped(space) else np.arange(n_chains)
        block = np.repeat(pieces[:, None] // max(1, (int(pieces[-1]) + 1) // MOST_BLOCKS), 2, axis=1)
    elif steps + 1 < length:  # drift shows between pieces longer than a chain
        block = np.repeat(np.arange(n_chains)[:, None] // (length // (steps + 1)), steps + 1, axis=1)
    return block


def _are_grouped(space: StateSpace) -> bool:
    """Whether rows without a state are said to have something in common."""
    return not space.simulator.state_names and int(space.groups[-1]) + 1 < len(space.groups)


def noise_without(
    space: StateSpace,
    fitted: Fitted,
    slopes: Array,
    moves: Array,
    known: Known = NOTHING_KNOWN,
) -> Fitted:
    """Return the fit with its noise estimated anew where effects move by so much, its forces' memory with it.

    What effects explain is no noise: a force that a missing friction leaves would hide the friction.
    """
    linear = fitted.linear
    moved = replace(linear.chains, drive=linear.chains.drive + space.padded(slopes @ moves))
    about = replace(linear, chains=moved)
    found = _estimated(space, fitted.values, about, fitted, known, memories=True)
    pairs = [len(forces) * (len(forces) - 1) // 2 for _, forces in linear.chains.parts]
    if space.simulator.joint_forces() and any(pairs) and found.estimate.noise.mixing is None:
        noise = acting_together(found).estimate.noise
        together = _with_memory_of(space, fitted.values, about, noise, found.memory, known)
        if together.bound > found.bound + NUMBER_WORTH * space.n_logs * sum(pairs):
            found = together
    chains = linear.chains.with_memory(found.memory)
    estimate = passed(chains, found.estimate.noise, space.real, covariances=True)
    return replace(fitted, chains=chains, estimate=estimate, memory=found.memory)


def acting_together(fitted: Fitted) -> Fitted:
    """Return a fit from whose noise others are estimated in which pushes may act on several joints at once."""
    noise = fitted.estimate.noise.together(fitted.linear.chains.carrier.shape[-1])
    return replace(fitted, estimate=replace(fitted.estimate, noise=noise))


def on_logarithm(effect: Effect) -> bool:
    """Whether values count on a logarithmic scale: factors that are positive throughout."""
    return effect.is_factor and effect.bounds[0] > 0


def coordinate(effect: Effect, value: float) -> float:
    """Return a value as the search counts it: 0 is neutral."""
    return float(np.log(value / effect.neutral)) if on_logarithm(effect) else value - effect.neutral


def value_at(effect: Effect, place: float) -> float:
    """Return the value at a coordinate, within bounds."""
    value = effect.neutral * np.exp(place) if on_logarithm(effect) else effect.neutral + place
    return float(np.clip(value, *effect.bounds))


def doubled(first: float, bound: float) -> Array:
    """Return places from `first` to a bound, each twice as far off as the one before."""
    times = np.ceil(np.log2(max(abs(bound) / first, 1.0)))
    places: Array = np.sign(bound) * np.minimum(first * 2 ** np.arange(times + 1), abs(bound))
    return places


def around(effect: Effect, value: float, width: float) -> tuple[float, float]:
    """Return the values so far to both sides of one, by their coordinates, within bounds."""
    place = coordinate(effect, value)
    return value_at(effect, place - width), value_at(effect, place + width)


def _steps(
    values: Mapping[str, float], effects: Sequence[Effect], widths: Array
) -> dict[str, tuple[float, float]]:
    """Return between which values each slope is taken, within bounds: to one side of neutral, to both of a cause's."""
    steps = {}
    for effect, width in zip(effects, widths):
        now = values.get(effect.name, effect.neutral)
        low, high = around(effect, now, width)
        one_side = (low, now) if high <= now else (now, high)
        steps[effect.name] = (low, high) if effect.name in values else one_side
    return steps


def _of_one_time_step(
    space: StateSpace, fitted: Fitted, effects: Sequence[Effect], widths: Array
) -> dict[str, tuple[float, float]]:
    """Return between which values slopes by delays that are causes are taken: none of them beyond a whole time step.

    There what a delay does has a kink: of a stiff servo a command that is late by a little more than a row tells a
    tenth of what one that is a little less late does.
    """
    simulator, found = space.simulator, {}
    for effect, width in zip(effects, widths):
        if effect.family != "delay" or effect.name not in fitted.values or not simulator.dt:
            continue
        step, value = time_step(simulator), fitted.values[effect.name]
        before, after = step * np.floor(value / step), step * np.ceil(value / step)
        low, high = around(effect, value, width)
        if not np.isclose(value, (before, after)).any():
            found[effect.name] = max(low, before), min(high, after)
    return found


def time_step(simulator: Simulator) -> float:
    """Return the time step, s, of which a transition has a whole number; 0 of a simulation without time."""
    return float(simulator.dt or 0.0) / int(getattr(simulator, "frame_skip", 1))


def _force_guess(linear: Linear, typical: Array) -> Array:
    """Return variances of forces that would make up the residuals of one step."""
    sizes = np.mean(linear.chains.carrier**2, axis=(0, 1)) / typical[:, None]
    return 1 / np.maximum(sizes.max(axis=0), 1e-300) if sizes.size else np.zeros(0)
