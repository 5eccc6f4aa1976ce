"""What a right model's errors would be some rows ahead, by draws.

Slopes at the filter's state know nothing of what hits the ground a few rows on. So runs of the model are drawn: from
what the filter leaves unknown of a start, pushed by random forces, read with noise. Where motion is smooth, draws
scatter more than slopes err: what slopes make of the same draws, whose mean they know, corrects the mean of the draws.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from skat.diagnosis.chains import Array, Chains, Memory, Places
from skat.diagnosis.filtering import updated
from skat.diagnosis.noise import Estimate, Noise, variances_of
from skat.diagnosis.statespace import PAIRS, Linear, StateSpace, moved_path, normal_points
from skat.simulators.tables import episode_starts

# Rows after which a filter has found what was not measured, and hidden states of actuators do not show how they began.
SETTLED_ROWS = 10
# Rows that are drawn at a time.
MOST_DRAWN = 200_000
# Quantiles of the sensors' noise for each draw of it.
FINER = 16


@dataclass(frozen=True)
class Seen:
    """A log as a model and a noise have it.

    Attributes
    ----------
    linear : Linear
        About the filtered path.
    chains : Chains
        Those of `linear`, with forces of memory where the noise has such.
    estimate : Estimate
    memory : Memory
        Of these forces.
    """

    linear: Linear
    chains: Chains
    estimate: Estimate
    memory: Memory


@dataclass(frozen=True)
class Ahead:
    """What a right model's errors would be.

    Attributes
    ----------
    variances : ndarray of shape (n_starts, horizon, d)
        After each row.
    last : ndarray of shape (n_draws, n_starts, d), or (n_draws, 1, d) where all starts are alike
        Squares of errors after the last row, drawn, in these units.
    """

    variances: Array
    last: Array


def filtered(space: StateSpace, seen: Seen) -> tuple[Array, Array]:
    """Return the state in which each row starts, from what was measured until then, and what is not known of it.

    Returns
    -------
    states : ndarray of shape (n_rows, n_states)
    covariances : ndarray of shape (n_rows, d_all, d_all)
        Of the deviation from the truth, with the forces of memory behind.
    """
    estimate = seen.estimate
    means, covariances = updated(seen.chains, estimate.filtered, estimate.noise.error_variances)
    states = moved_path(space, seen.linear.path, means[..., : space.d])
    return states[:, :-1][space.places], covariances[:, :-1][space.places]


def ahead(
    space: StateSpace,
    seen: Seen,
    values: Mapping[str, float],
    starts: Places,
    horizon: int,
    begin: tuple[Array, Array] | None = None,
) -> Ahead:
    """Return what a right model's errors would be.

    Parameters
    ----------
    space, seen
    values : mapping from name to value
        Of the simulation that is taken for right.
    starts : ndarray of int of shape (n_starts,)
    horizon : int
        In rows.
    begin : tuple of ndarrays of shape (n_starts, n_states) and (n_starts, d, d), optional
        States at the starts, and what is not known of them; as the filter has them by default.
    """
    d, noise = space.d, seen.estimate.noise
    law = space.origins[starts]
    error = variances_of(noise.error, noise.error_nu)[law, :d]
    random_state = np.random.RandomState(0)
    points = normal_points(d, PAIRS)
    n_draws = 2 * points.shape[1]
    variances = np.tile(error[:, None], (1, horizon, 1))
    table = _noise_table(noise, d, FINER * n_draws)
    if not space.simulator.state_names:
        # Starts of one law are alike.
        own = np.zeros(1, dtype=int) if len(noise.error) == 1 else law
        return Ahead(variances, table[:, own] ** 2 / variances_of(noise.error, noise.error_nu)[own, :d])
    # Of each part of the law one draw: few of them have its mean square, whatever it is cut at.
    shape = n_draws, len(starts), d
    places = FINER * random_state.random_sample(shape).argsort(axis=0) + random_state.randint(
        FINER, size=shape
    )
    last = table[places, law[:, None], np.arange(d)]
    states, unknown = [one[starts] for one in filtered(space, seen)] if begin is None else begin
    sizes, axes = np.linalg.eigh(unknown[:, :d, :d])
    roots = axes * np.sqrt(np.maximum(sizes, 0.0))[:, None, :]
    # Two motions that have nothing in common any more are no further apart than that.
    most = 2 * (space.spread / 3) ** 2
    each = max(1, MOST_DRAWN // (n_draws * horizon))
    for begun in range(0, len(starts), each):
        part = slice(begun, begun + each)
        pushes = _drawn_pushes(space, seen, starts[part], horizon, points.shape[1], random_state)
        drawn = _drawn(space, seen, values, starts[part], states[part], roots[part] @ points, pushes)
        # Runs that diverge are as far apart as that.
        drawn = np.where(np.isfinite(drawn), drawn, np.sqrt(most))
        line = _line(space, seen, starts[part], unknown[part, :d, :d], roots[part] @ points, pushes)
        with np.errstate(over="ignore", invalid="ignore"):
            squares = (drawn[::2] ** 2 + drawn[1::2] ** 2) / 2
            variances[part] += np.clip(_mean_beside(squares, *line), 0.0, most)
        last[:, part] += drawn[:, :, -1]
    with np.errstate(over="ignore"):
        return Ahead(variances, last**2 / variances[:, -1])


def steady(noise: Noise, memory: Memory) -> Array:
    """Return the variance of what is hidden of each force with memory, at any time, (n_laws, n_forces)."""
    return memory.steady(variances_of(noise.force, noise.force_nu)[:, -len(memory) :])


def _drawn(
    space: StateSpace,
    seen: Seen,
    values: Mapping[str, float],
    starts: Places,
    states: Array,
    offsets: Array,
    pushes: Array,
) -> Array:
    """Return by how much runs that begin off a state and are pushed differ from one that is not.

    Parameters
    ----------
    space, seen, values, starts
    states : ndarray of shape (n_starts, n_states)
    offsets : ndarray of shape (n_starts, d, n_points)
        To both sides of each state.
    pushes : ndarray of shape (n_points, n_starts, horizon, d)

    Returns
    -------
    ndarray of shape (2 n_points, n_starts, horizon, d)
    """
    simulator, (_, n_starts, horizon, d) = space.simulator, pushes.shape
    begun = [states]
    for offset in np.moveaxis(offsets, -1, 0):
        begun += [simulator.displace(states, offset), simulator.displace(states, -offset)]
    copies = len(begun)
    commands = space.X[starts[:, None] + np.arange(horizon)][..., len(simulator.state_names) :]
    earlier = before(space, seen, [values], starts)
    (paths,) = simulator.rollout_many(
        np.concatenate(begun),
        np.tile(commands, (copies, 1, 1)),
        [values],
        n_steps=horizon,
        before=None if earlier is None else np.tile(earlier, (copies, 1, 1)),
        # Runs from both sides are pushed alike: what pushes and offsets move are then independent of each other.
        pushes=np.concatenate([np.zeros_like(pushes[:1]), np.repeat(pushes, 2, axis=0)]).reshape(
            -1, horizon, d
        ),
    )
    paths = paths.reshape(copies, n_starts, horizon + 1, -1)[:, :, 1:]
    with np.errstate(invalid="ignore", over="ignore"):
        apart: Array = simulator.residual(paths[1:], np.broadcast_to(paths[:1], paths[1:].shape))
    return apart


def _line(
    space: StateSpace, seen: Seen, starts: Places, unknown: Array, offsets: Array, pushes: Array
) -> tuple[Array, Array]:
    """Return what slopes make of the same draws: mean squares of each two, and what these are on average.

    Returns
    -------
    squares : ndarray of shape (n_points, n_starts, horizon, d)
    variances : ndarray of shape (n_starts, horizon, d)
    """
    (n_points, n_starts, horizon, d), noise, k = pushes.shape, seen.estimate.noise, len(seen.memory)
    # These chains may be others than those that the noise was found in.
    chains = seen.chains.mixed(None if noise.mixing is None else noise.mixing[space.origin])
    A, F = (one[space.places] for one in (chains.transitions, chains.carrier))
    law = space.origins[starts]
    force = variances_of(noise.force, noise.force_nu)[law, None]
    M = np.zeros((n_starts, d + k, d + k))
    M[:, :d, :d] = unknown
    if k:
        mixing = np.eye(k) if noise.mixing is None else noise.mixing[law]
        hidden = steady(noise, seen.memory)[law, None]
        M[:, d:, d:] = (mixing * hidden) @ np.swapaxes(mixing, -1, -2)
    moved, pushed = np.moveaxis(offsets, -1, 1), np.zeros((n_starts, n_points, d))
    squares, variances = np.empty((n_points, n_starts, horizon, d)), np.empty((n_starts, horizon, d))
    with np.errstate(over="ignore", invalid="ignore"):
        for step in range(horizon):
            rows = starts + step
            own = A[rows, :d, :d].swapaxes(1, 2)
            moved, pushed = moved @ own, pushed @ own + pushes[:, :, step].swapaxes(0, 1)
            M = A[rows] @ M @ A[rows].swapaxes(1, 2) + (F[rows] * force) @ F[rows].swapaxes(1, 2)
            squares[:, :, step] = (moved**2 + pushed**2).swapaxes(0, 1)
            variances[:, step] = np.einsum("nii->ni", M)[:, :d]
    return squares, variances


def _mean_beside(drawn: Array, known: Array, mean: Array) -> Array:
    """Return the mean of draws (first axis) beside which others were drawn whose mean is known: control variates."""
    with np.errstate(over="ignore", invalid="ignore"):
        off = known - known.mean(axis=0)
        spread = np.mean(off**2, axis=0)
        share = np.clip(np.mean(off * drawn, axis=0) / np.where(spread > 0, spread, 1.0), 0.0, 1.0)
        more = share * (mean - known.mean(axis=0))
    corrected: Array = drawn.mean(axis=0) + np.where(np.isfinite(more), more, 0.0)
    return corrected


def _noise_table(noise: Noise, d: int, n: int) -> Array:
    """Return quantiles of the noise of each sensor, (n, n_laws, d)."""
    levels = (np.arange(n)[:, None, None] + 0.5) / n
    table: Array = np.sqrt(noise.error[:, :d]) * stats.t.ppf(levels, noise.error_nu[:, :d])
    return table


def _drawn_pushes(
    space: StateSpace,
    seen: Seen,
    starts: Places,
    horizon: int,
    n_draws: int,
    random_state: np.random.RandomState,
) -> Array:
    """Return draws of what random forces add to the state in each row, (n_draws, n_starts, horizon, d)."""
    noise, k, law = seen.estimate.noise, len(seen.memory), space.origins[starts]
    deviations = np.sqrt(variances_of(noise.force, noise.force_nu))[law]
    shape = n_draws, len(starts), horizon
    forces = random_state.standard_normal((*shape, deviations.shape[-1])) * deviations[:, None]
    if k:
        # A simulation does not know what is known of these forces: to it, all of their variance is an error.
        hidden = np.sqrt(steady(noise, seen.memory)[law]) * random_state.standard_normal((*shape[:2], k))
        for step in range(horizon):
            fresh = forces[:, :, step, -k:]
            forces[:, :, step, :k] += seen.memory.acting(fresh, hidden)
            hidden = seen.memory.share * hidden + seen.memory.kept(fresh)
    carrier = seen.linear.chains.carrier[space.places][starts[:, None] + np.arange(horizon)]
    forces = forces[..., : carrier.shape[-1]]
    if noise.mixing is not None:
        forces = np.einsum("sij,nshj->nshi", noise.mixing[law], forces)
    pushes: Array = np.einsum("shdf,nshf->nshd", carrier, forces)
    return pushes


def before(
    space: StateSpace, seen: Seen, candidates: Sequence[Mapping[str, float]], starts: Places
) -> Array | None:
    """Return the rows before each start, if what they leave matters to one of the models."""
    simulator = space.simulator
    n_lags = max(simulator.n_lags(values) for values in candidates)
    if not n_lags and not any(simulator.extended(values).hidden_state_names for values in candidates):
        return None
    # Of an episode's first row, the commands have held before.
    first = episode_starts(space.groups, len(space.X))[starts]
    earlier = starts[:, None] - np.arange(max(n_lags, SETTLED_ROWS), 0, -1)
    rows: Array = space.rows(seen.linear.path)[np.maximum(earlier, first[:, None])]
    return rows
