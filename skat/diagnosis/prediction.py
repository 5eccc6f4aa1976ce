r"""How well the simulation as given and the extended one predict a log that neither was fitted to.

Both start, every h rows, in the state that the filter has there from what was measured until then, run for h rows with
the logged commands and without any random force, and are compared with what was measured h rows on. An error counts in
units of its standard deviation under a right model, which is drawn: runs of the extended model from what the filter
leaves unknown of each start, pushed by random forces, and read with noise. So a right model has a mean square of 1, the
floor, also where states bounce off each other's ways. Random forces that nothing predicts belong to it. So do forces
with memory: what is known of them at a start is not told to the simulation, and they are drawn with all of their
variance.

Both models start in the same states, those that the extended one's filter has, as the noise is its own: a filter that
takes that little noise for granted follows a wrong model rather than its readings, and would compare runs that began
long before the horizon.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skat.diagnosis.filtering import Array, Chains, Mask, kalman_filter, smooth, updated
from skat.diagnosis.findings import Gain
from skat.diagnosis.fitting import Fitted
from skat.diagnosis.noise import Estimate, Noise, normal_noise, passed, precisions
from skat.diagnosis.statespace import (
    Linear,
    Places,
    StateSpace,
    linearise,
    moved_path,
    normal_points,
    steps_of,
)
from skat.simulators import Simulator
from skat.simulators.tables import episode_starts

# By default the horizon is so long, and has at least so many rows.
HORIZON_S = 0.25
FEWEST_ROWS = 10
# Rows after which a filter has found what was not measured, and hidden states of actuators do not show how they began.
SETTLED_ROWS = 10
# How often the path of a held-out log, and the weights of its samples, are taken anew.
TURNS = 3
# An error counts with at most this square, in units of the larger of its own variance and the nominal model's typical
# square.
LARGEST_SQUARE = 9.0
# Of a square of a standard normal number, the median.
MEDIAN_OF_SQUARES = 0.4549
# In an output's own unit, no error counts for more than so many standard deviations of what was measured.
FARTHEST = 10.0
# Draws of pieces of time that count as independent. Fewer pieces, drawn with replacement, are too often all the same,
# and do not say how much a gain varies from one to the next; few episodes are cut, into about so many.
N_BOOTSTRAP = 999
FEWEST_PIECES, PIECES = 5, 20
N_OVERLAYS = 3
# Rows that are drawn at a time.
MOST_DRAWN = 200_000
# Of an episode's residuals, what fitted initial states leave is never taken for a smaller share than this.
LEAST_LEFT = 0.1
# Relinearisations by which an initial state is fitted.
START_TURNS = 6


@dataclass(frozen=True)
class Overlay:
    """An episode, measured and predicted.

    Attributes
    ----------
    episode : int
        Its label among the rows of the log.
    time : ndarray of shape (n_instants,)
        s from the first row, or rows where the simulation has no time.
    channels : tuple of str
    measured : ndarray of shape (n_instants, n_channels)
        NaN where nothing was measured.
    nominal, extended : ndarray of shape (n_instants, n_channels)
        Predictions, begun anew every `horizon` instants; NaN where they diverged.
    horizon : int
        Rows of a prediction.
    """

    episode: int
    time: Array
    channels: tuple[str, ...]
    measured: Array
    nominal: Array
    extended: Array
    horizon: int


@dataclass(frozen=True)
class Prediction:
    """Errors at a horizon, the episodes that the nominal model predicts worst, and how many starts diverge."""

    gain: Gain
    overlays: tuple[Overlay, ...]
    n_starts: int
    n_diverged: int


@dataclass(frozen=True)
class Ahead:
    """What a right model's errors would be.

    Attributes
    ----------
    variances : ndarray of shape (n_starts, horizon, d)
        After each row.
    last : ndarray of shape (n_draws, n_starts, d)
        Squares of errors after the last row, drawn, in these units.
    """

    variances: Array
    last: Array


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
    shares : ndarray of shape (n_forces,) or (0,)
        What is left of a force with memory a row later.
    """

    linear: Linear
    chains: Chains
    estimate: Estimate
    shares: Array


def horizon_rows(simulator: Simulator, horizon: float | None = None) -> int:
    """Return a horizon in rows.

    Parameters
    ----------
    simulator : Simulator
    horizon : float, optional
        In s, or in rows where the simulation has no time. By default a quarter of a second or ten rows, whichever is
        longer; one row for a simulation without a state.

    Raises
    ------
    ValueError
        If the horizon is not positive.
    """
    if horizon is not None and not horizon > 0:
        raise ValueError(f"horizon must be positive, in seconds; it is {horizon!r}.")
    if not simulator.state_names:
        return 1
    dt = simulator.dt
    if horizon is None:
        return max(FEWEST_ROWS, int(np.ceil(HORIZON_S / dt - 1e-9)) if dt else 0)
    return max(1, round(horizon / dt if dt else horizon))


def predicted(
    space: StateSpace,
    fitted: Fitted,
    values: Mapping[str, float],
    *,
    horizon: int | None = None,
    random_state: np.random.RandomState,
    n_overlays: int = N_OVERLAYS,
) -> Prediction:
    """Return how well the nominal and the extended simulation predict a log at a horizon.

    Parameters
    ----------
    space : StateSpace
        The log, held out.
    fitted : Fitted
        On another log, at the values of the causes: its noise counts, the weights of its samples do not.
    values : mapping from name to value
        Of the extended simulation.
    horizon : int, optional
        In rows; as `horizon_rows` by default. At most as long as the longest episode.
    random_state : numpy.random.RandomState
        Draws the bootstrap.
    n_overlays : int, default=3

    Returns
    -------
    Prediction

    Raises
    ------
    RuntimeError
        If one of the simulations diverges in every row, or nothing was measured at any horizon.

    Notes
    -----
    The square of an error is cut at nine times the larger of its variance and the nominal model's own typical square in
    that channel (by the median), so that no single row decides, and a simulation that diverged counts as one that is
    wholly wrong. Squares are over what a right model has under the same cut.
    """
    simulator = space.simulator
    h = horizon_rows(simulator) if horizon is None else horizon
    seen = look(space, fitted, values)
    if simulator.state_names:
        starts, h = windows(space, h, n_lags=simulator.n_lags(values))
    else:
        starts, h = np.arange(len(space.X)), 1
    if not len(starts):
        raise RuntimeError("No episode is long enough to be predicted.")
    candidates: list[Mapping[str, float]] = [{}, values]
    paths = _runs(space, seen, candidates, starts, h)
    rows = starts[:, None] + np.arange(h)
    measured, mask = ends(space)
    with np.errstate(invalid="ignore", over="ignore"):
        errors = simulator.residual(measured[rows], paths)
    for name, one in zip(("as given", "with its causes"), errors):
        if not np.isfinite(one).all(axis=-1).any():
            raise RuntimeError(f"The simulation {name} diverges in every row.")
    counted = mask[rows[:, -1]]
    if not counted.any():
        raise RuntimeError("Nothing was measured at the horizon of any row.")
    lost = np.asarray(~np.isfinite(errors[:, :, 0]).all(axis=(0, 2)))
    right = ahead(space, seen, values, starts, h)
    with np.errstate(over="ignore"):
        squares = np.nan_to_num(errors[:, :, -1] ** 2 / right.variances[:, -1], nan=np.inf)
    nominal, extended, floor = _cut(squares, right.last, counted)
    there = counted.any(axis=1)
    gain = _gain(
        np.stack([nominal, extended, floor])[:, there],
        _pieces(space.groups[starts])[there],
        random_state,
        horizon=float(h * simulator.dt) if simulator.dt else float(h),
        channels=_channel_errors(space, errors, mask[rows]),
    )
    chosen = _worst_episodes(space.groups[starts], nominal, n_overlays) if simulator.state_names else []
    overlays = tuple(_overlay(space, paths, starts, h, episode) for episode in chosen)
    return Prediction(gain, overlays, len(lost), int(lost.sum()))


def look(space: StateSpace, fitted: Fitted, values: Mapping[str, float]) -> Seen:
    """Return a log that a noise was not fitted to, as this noise and a model have it.

    Where heavy tails were found, each sample's weight is found anew in turns with the variances held.
    """
    noise, shares = _with_even_weights(fitted.estimate.noise, space), fitted.shares
    path, covariances = space.measured, None
    heavy = bool(np.isfinite(np.r_[noise.force_nu, noise.error_nu]).any())
    turns = TURNS if space.simulator.state_names or heavy else 1
    for turn in range(turns):
        linear = linearise(space, path, values, covariances)
        chains = linear.chains
        if len(shares):
            chains = chains.with_memory(shares, _steady(noise, shares))
        for _ in range(TURNS if heavy else 0):
            estimate = passed(chains, noise, space.real)
            noise = _weighted(estimate, space.real, chains.mask)
        estimate = passed(chains, noise, space.real, covariances=True)
        if turn < turns - 1:
            means, known = updated(chains, estimate.filtered, noise.error_variances)
            path = moved_path(space, linear.path, means[..., : space.d])
            covariances = known[..., : space.d, : space.d]
    return Seen(linear, chains, estimate, shares)


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


def windows(space: StateSpace, horizon: int, *, n_lags: int = 0) -> tuple[Places, int]:
    """Return the rows at which predictions start, one after the other in each episode, and how many rows they run.

    Where not all of a state was measured, a start lies some rows behind the beginning of its chain; where commands come
    late, behind those of an episode in which commands from before the log act.
    """
    step = space.places[1]
    unknown = not space.mask[:, 0].all()
    first = np.flatnonzero(steps_of(space.groups) == 0)
    length = np.diff(np.r_[first, len(space.groups)])
    late = min(SETTLED_ROWS, int(length.max()) - 1) if unknown else 0
    n_lags = min(n_lags, int(length.max()) - 1)
    horizon = max(1, min(horizon, int(length.max()) - max(late, n_lags)))
    starts = np.concatenate(
        [np.arange(begin + n_lags, begin + n, horizon) for begin, n in zip(first, length)]
    )
    last = np.repeat(first + length, length)
    settled = starts + np.maximum(late - step[starts], 0)
    starts = np.unique(settled[settled < last[starts]])
    return starts[starts + horizon <= last[starts]], horizon


def ends(space: StateSpace) -> tuple[Array, Mask]:
    """Return what was measured at the end of each row, (n_rows, n_states), and which channels, (n_rows, d)."""
    chain, step = (one.copy() for one in space.places)
    # A state at which an episode was cut into chains belongs to the one that it begins.
    cut = np.flatnonzero((np.diff(space.groups) == 0) & (np.diff(chain) != 0))
    after = chain, step + 1
    after[0][cut], after[1][cut] = chain[cut + 1], 0
    return space.measured[after], space.mask[after]


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
    error = variances_of(noise.error, noise.error_nu)[:d]
    random_state = np.random.RandomState(0)
    points = normal_points(d)
    n_draws = 2 * points.shape[1]
    variances = np.broadcast_to(error, (len(starts), horizon, d)).copy()
    last = _drawn_noise(noise, (n_draws, len(starts), d), random_state)
    if not space.simulator.state_names:
        return Ahead(variances, last**2 / variances[:, -1])
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


def open_loop_gain(
    space: StateSpace,
    fitted: Fitted,
    values: Mapping[str, float],
    *,
    initial_state: str = "measured",
    outputs: Sequence[str] | None = None,
    labels: Sequence[object] | None = None,
    random_state: np.random.RandomState,
) -> Gain:
    """Return the Gain in root mean squared distance over whole episodes in open loop.

    Parameters
    ----------
    space : StateSpace
    fitted : Fitted
        Its noise says how much each channel counts where initial states are fitted, and what a right model has.
    values : mapping from name to value
    initial_state : {"measured", "fitted"}, default="measured"
        "fitted": the first state of each episode given all of it, with no random force, for either model.
    outputs : sequence of str, optional
        Channels that make up the distance; by default all that were measured.
    labels : sequence, optional
        What the user calls each episode.
    random_state : numpy.random.RandomState

    Returns
    -------
    Gain
        Its floor is what a right model would have: noise of what is compared, and, carried on, random forces and noise
        of the initial states.

    Raises
    ------
    ValueError
        If an output is none that was measured; if an initial state was not measured.
    RuntimeError
        If an episode diverges.
    """
    simulator = space.simulator
    space = _whole_episodes(space)
    measured, mask = ends(space)
    names = [name for channel, name in enumerate(simulator.residual_names) if mask[:, channel].any()]
    unknown = [name for name in outputs or () if name not in names]
    if unknown:
        raise ValueError(f"outputs names {', '.join(unknown)}; measured channels are {', '.join(names)}.")
    chosen = np.isin(simulator.residual_names, list(outputs or names))
    if initial_state == "measured" and not space.mask[:, 0].all():
        missing = [
            name
            for channel, name in enumerate(simulator.residual_names)
            if not space.mask[:, 0, channel].all()
        ]
        raise ValueError(
            f"{', '.join(missing)} were not measured in the first row of every episode: pass initial_state='fitted'."
        )
    noise = fitted.estimate.noise
    deviations = np.sqrt(variances_of(noise.error, noise.error_nu)[: space.d])
    counted = mask & chosen
    paths = []
    models: tuple[Mapping[str, float], ...] = ({}, values)
    for name, model in zip(("nominal", "extended"), models):
        starts = [space.measured[:, 0]]
        if initial_state == "fitted":
            starts += _fitted_starts(space, model, deviations**2)
        path, lost = _best_runs(space, model, starts, measured, mask, deviations)
        if lost.any():
            episode = int(np.flatnonzero(lost)[0])
            label = episode if labels is None else labels[episode]
            raise RuntimeError(
                f"In open loop the {name} simulation diverges in episode {label}: cut it into shorter ones, or leave "
                "it out."
            )
        paths.append(path[:, 1:][space.places])
    errors = simulator.residual(measured, np.stack(paths))
    squares = np.where(counted, errors**2, 0.0).sum(axis=-1)
    right = _open_loop_variances(space, fitted, values, initial_state, path[:, 0])
    floor = np.where(counted, right, 0.0).sum(axis=-1)
    there = counted.any(axis=1)
    return _gain(
        np.stack([*squares, floor])[:, there],
        space.groups[there],
        random_state,
        horizon="episode",
        channels=_channel_errors(space, errors, counted),
        root=True,
    )


# -- parts of a prediction -------------------------------------------------------------------------------------------


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
    before = _before(space, seen, [values], starts)
    (paths,) = simulator.rollout_many(
        np.concatenate(begun),
        np.tile(commands, (copies, 1, 1)),
        [values],
        n_steps=horizon,
        before=None if before is None else np.tile(before, (copies, 1, 1)),
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
    (n_points, n_starts, horizon, d), noise, k = pushes.shape, seen.estimate.noise, len(seen.shares)
    A, F = (one[space.places] for one in (seen.chains.transitions, seen.chains.carrier))
    force = variances_of(noise.force, noise.force_nu)
    M = np.zeros((n_starts, d + k, d + k))
    M[:, :d, :d] = unknown
    if k:
        M[:, d:, d:] = np.diag(_steady(noise, seen.shares))
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


def _drawn_noise(noise: Noise, shape: tuple[int, ...], random_state: np.random.RandomState) -> Array:
    """Return draws of the noise of sensors, whose channels are the last axis."""
    d = shape[-1]
    nu = noise.error_nu[:d]
    heavy = np.isfinite(nu)
    squares = random_state.chisquare(np.where(heavy, nu, 1.0), size=shape)
    tails = np.where(heavy, np.sqrt(nu / np.maximum(squares, 1e-300)), 1.0)
    drawn: Array = np.sqrt(noise.error[:d]) * tails * random_state.standard_normal(shape)
    return drawn


def _drawn_pushes(
    space: StateSpace,
    seen: Seen,
    starts: Places,
    horizon: int,
    n_draws: int,
    random_state: np.random.RandomState,
) -> Array:
    """Return draws of what random forces add to the state in each row, (n_draws, n_starts, horizon, d)."""
    noise, k = seen.estimate.noise, len(seen.shares)
    deviations = np.sqrt(variances_of(noise.force, noise.force_nu))
    shape = n_draws, len(starts), horizon
    forces = random_state.standard_normal((*shape, len(deviations))) * deviations
    if k:
        # A simulation does not know what is known of these forces: to it, all of their variance is an error.
        lasting = np.sqrt(_steady(noise, seen.shares)) * random_state.standard_normal((*shape[:2], k))
        for step in range(horizon):
            forces[:, :, step, :k] += lasting
            lasting = seen.shares * lasting + forces[:, :, step, -k:]
    carrier = seen.linear.chains.carrier[space.places][starts[:, None] + np.arange(horizon)]
    pushes: Array = np.einsum("shdf,nshf->nshd", carrier, forces[..., : carrier.shape[-1]])
    return pushes


def _with_even_weights(noise: Noise, space: StateSpace) -> Noise:
    n, steps = space.real.shape
    return replace(
        noise,
        force_weights=np.ones((n, steps, len(noise.force))),
        error_weights=np.ones((n, steps + 1, len(noise.error))),
    )


def _weighted(last: Estimate, real: Mask, mask: Mask) -> Noise:
    """Return a noise with the expected precision of each sample, its law held."""
    noise, smoothed = last.noise, last.smoothed
    force_squares = smoothed.forces**2 + smoothed.force_variances
    error_squares = smoothed.errors**2 + smoothed.error_variances
    return replace(
        noise,
        force_weights=precisions(force_squares, noise.force, noise.force_nu, real[..., None]),
        error_weights=precisions(error_squares, noise.error, noise.error_nu, mask),
    )


def variances_of(scale: Array, nu: Array) -> Array:
    """Return the variances of Student's laws of squared scales."""
    heavy = np.isfinite(nu)
    return scale * np.where(heavy, nu / np.where(heavy, nu - 2, 1.0), 1.0)


def _steady(noise: Noise, shares: Array) -> Array:
    """Return the variance of each force with memory, at any time."""
    force = variances_of(noise.force, noise.force_nu)[-len(shares) :]
    return force / np.maximum(1 - shares**2, 1e-12)


def _runs(
    space: StateSpace, seen: Seen, candidates: Sequence[Mapping[str, float]], starts: Places, horizon: int
) -> Array:
    """Return outputs after each row of each prediction, (n_candidates, n_starts, horizon, n_outputs)."""
    simulator = space.simulator
    if not simulator.state_names:
        outputs = simulator.predict_many(space.X, candidates, groups=space.groups)
        return outputs[:, starts, None]
    n_states = len(simulator.state_names)
    rows = starts[:, None] + np.arange(horizon)
    paths = simulator.rollout_many(
        filtered(space, seen)[0][starts],
        space.X[rows][..., n_states:],
        candidates,
        n_steps=horizon,
        before=_before(space, seen, candidates, starts),
    )
    return paths[:, :, 1:]


def _before(
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
    before: Array = space.rows(seen.linear.path)[np.maximum(earlier, first[:, None])]
    return before


def _cut(squares: Array, drawn: Array, counted: Mask) -> tuple[Array, Array, Array]:
    """Return the mean squares (n_starts,) of two models and of a right one, cut alike, a right one's mean being 1."""
    typical = np.ones(squares.shape[-1])
    for channel, there in enumerate(counted.T):
        if there.any():
            middle = float(np.median(squares[0, there, channel]))
            typical[channel] = max(1.0, middle / MEDIAN_OF_SQUARES) if np.isfinite(middle) else np.inf
    typical = np.where(
        np.isfinite(typical), typical, max(1.0, typical[np.isfinite(typical)].max(initial=1.0))
    )
    most = LARGEST_SQUARE * typical
    right = np.minimum(drawn, most).mean(axis=0)
    numbers = np.maximum(counted.sum(axis=1), 1)
    parts = [*np.minimum(squares, most), right]
    nominal, extended, floor = (np.where(counted, one, 0.0).sum(axis=1) / numbers for one in parts)
    unit = float(floor[counted.any(axis=1)].mean())
    return nominal / unit, extended / unit, floor / unit


def _pieces(episodes: Places) -> Places:
    """Return the piece of each start: its episode, or where there are few, a piece of time."""
    labels = np.unique(episodes, return_inverse=True)[1]
    n_episodes = int(labels.max()) + 1
    if n_episodes >= FEWEST_PIECES:
        return labels
    sizes = np.bincount(labels)
    each = -(-PIECES // n_episodes)
    within = np.arange(len(labels)) - np.r_[0, np.cumsum(sizes)[:-1]][labels]
    pieces: Places = labels * each + within * np.minimum(each, sizes[labels]) // sizes[labels]
    return pieces


def _gain(
    parts: Array,
    pieces: Places,
    random_state: np.random.RandomState,
    *,
    horizon: float | str,
    channels: dict[str, tuple[float, float]],
    root: bool = False,
) -> Gain:
    """Return the Gain of squares (3, n_rows): of two models and of a right one."""
    labels = np.unique(pieces, return_inverse=True)[1]
    counts = np.bincount(labels)
    low = high = np.nan
    if len(counts) >= FEWEST_PIECES:
        sums = np.stack([np.bincount(labels, one) for one in parts])
        draws = random_state.randint(len(counts), size=(N_BOOTSTRAP, len(counts)))
        sampled = _explained(sums[:, draws].sum(axis=2) / counts[draws].sum(axis=1), root)
        # Where there may be no excess, a share of it may be anything.
        none = np.isnan(sampled)
        low = float(np.quantile(np.where(none, -np.inf, sampled), 0.025, method="lower"))
        high = float(np.quantile(np.where(none, np.inf, sampled), 0.975, method="higher"))
    means = parts.mean(axis=1)
    explained = float(np.nan_to_num(_explained(means, root)))
    nominal, extended, floor = map(float, np.sqrt(means) if root else means)
    return Gain(nominal, extended, floor, explained, (low, high), horizon, channels)


def _explained(means: Array, root: bool) -> Array:
    """Return the share of the excess error that is gone; NaN where there is no excess."""
    nominal, extended, floor = np.sqrt(means) if root else means
    excess = nominal - floor
    return np.where(excess > 0, (nominal - extended) / np.where(excess > 0, excess, 1.0), np.nan)


def _channel_errors(space: StateSpace, errors: Array, mask: Mask) -> dict[str, tuple[float, float]]:
    """Return root mean squares (nominal, extended) of errors (2, ..., d) of each channel that was measured."""
    names = space.simulator.residual_names
    most = FARTHEST * space.spread / 3
    sizes = np.minimum(np.nan_to_num(np.abs(errors), nan=np.inf), most)
    found = {}
    for channel, name in enumerate(names):
        there = mask[..., channel]
        if there.any():
            nominal, extended = (float(np.sqrt(np.mean(one[..., channel][there] ** 2))) for one in sizes)
            found[name] = nominal, extended
    return found


def _worst_episodes(episodes: Places, squares: Array, count: int) -> list[int]:
    """Return the labels of the episodes with the largest mean square, worst first."""
    labels, inverse, sizes = np.unique(episodes, return_inverse=True, return_counts=True)
    if len(labels) == len(episodes):  # of one prediction each there is nothing to see over time
        inverse = np.arange(len(episodes))
    means = np.bincount(inverse, squares) / sizes
    return [int(labels[place]) for place in np.argsort(-means, kind="stable")[:count]]


def _overlay(space: StateSpace, paths: Array, starts: Places, horizon: int, episode: int) -> Overlay:
    simulator = space.simulator
    own = np.flatnonzero(space.groups[starts] == episode)
    rows = (starts[own][:, None] + np.arange(horizon)).ravel()
    first = int(np.flatnonzero(space.groups == episode)[0])
    measured, mask = ends(space)
    columns = [_channel_of(name, simulator) for name in simulator.output_names]
    nominal, extended = (one[own].reshape(len(rows), -1) for one in paths)
    time = np.asarray((rows + 1 - first) * (simulator.dt or 1.0), dtype=np.float64)
    shown = np.where(mask[rows][:, columns], measured[rows], np.nan)
    return Overlay(episode, time, simulator.output_names, shown, nominal, extended, horizon)


def _channel_of(output: str, simulator: Simulator) -> int:
    """Return the channel of a residual that tells whether an output was measured."""
    names = simulator.residual_names
    if output in names:
        return names.index(output)
    return names.index(f"{output.rpartition('.')[0]}.rx")


# -- parts of whole episodes in open loop ----------------------------------------------------------------------------


def _whole_episodes(space: StateSpace) -> StateSpace:
    """Return the log with each episode as one chain."""
    episode: NDArray[np.intp] = np.unique(space.groups, return_inverse=True)[1]
    if len(space.real) == int(episode[-1]) + 1:
        return space
    step = steps_of(episode)
    first = np.flatnonzero(step == 0)
    shape = int(episode[-1]) + 1, int(step.max()) + 1
    real = np.zeros(shape, dtype=bool)
    real[episode, step] = True
    after, seen_after = ends(space)
    measured = np.repeat(space.measured[space.places][first][:, None], shape[1] + 1, axis=1)
    mask = np.zeros((shape[0], shape[1] + 1, space.d), dtype=bool)
    mask[:, 0] = space.mask[space.places][first]
    measured[episode, step + 1], mask[episode, step + 1] = after, seen_after
    return StateSpace(
        space.simulator,
        space.X,
        space.groups,
        (episode, step),
        measured,
        mask,
        real,
        space.carrier,
        space.spread,
    )


def _fitted_starts(space: StateSpace, values: Mapping[str, float], error: Array) -> list[Array]:
    """Return initial states of episodes given all of them, with no random force, as relinearisation goes on."""
    path, starts = space.measured, []
    for _ in range(START_TURNS):
        linear = linearise(space, path, values)
        noise = normal_noise(linear.chains, np.zeros(linear.chains.carrier.shape[-1]), error)
        variances = noise.force_variances, noise.error_variances
        smoothed = smooth(
            linear.chains, kalman_filter(linear.chains, *variances), *variances, covariances=False
        )
        if not np.isfinite(smoothed.means).all():
            break
        farthest = FARTHEST * space.spread
        path = moved_path(space, path, np.clip(smoothed.means, -farthest, farthest))
        starts.append(path[:, 0])
    return starts


def _best_runs(
    space: StateSpace,
    values: Mapping[str, float],
    starts: Sequence[Array],
    measured: Array,
    mask: Mask,
    deviations: Array,
) -> tuple[Array, Mask]:
    """Return the episodes (n_episodes, n_steps + 1, n_outputs) from the best of several starts, and which diverge."""
    simulator = space.simulator
    inputs = space.padded(space.X[:, len(simulator.state_names) :])
    n_steps, episode = space.real.shape[1], space.places[0]
    best, least = np.empty(0), np.full(len(space.real), np.inf)
    for start in starts:
        (path,) = simulator.rollout_many(start, inputs, [values], n_steps=n_steps)
        with np.errstate(invalid="ignore", over="ignore"):
            white = simulator.residual(measured, path[:, 1:][space.places]) / deviations
            loss = np.bincount(episode, np.where(mask, white**2, 0.0).sum(axis=1))
        loss = np.where(
            np.bincount(episode, ~np.isfinite(path[:, 1:][space.places]).all(axis=1)) > 0, np.inf, loss
        )
        if not len(best):
            best = path
        better = loss < least
        best[better], least[better] = path[better], loss[better]
    return best, ~np.isfinite(least)


def _open_loop_variances(
    space: StateSpace, fitted: Fitted, values: Mapping[str, float], initial_state: str, begun: Array
) -> Array:
    """Return the variance of what a right model's error would be after each row, (n_rows, d), from states begun in."""
    linear, shares = linearise(space, space.measured, values), fitted.shares
    chains = linear.chains
    if len(shares):
        chains = chains.with_memory(shares, _steady(fitted.estimate.noise, shares))
    seen = Seen(linear, chains, fitted.estimate, shares)
    d = space.d
    error = variances_of(fitted.estimate.noise.error, fitted.estimate.noise.error_nu)[:d]
    unknown = np.diag(error) if initial_state == "measured" else np.zeros((d, d))
    out = np.empty((len(space.X), d))
    for episode in range(len(space.real)):
        rows = np.flatnonzero(space.places[0] == episode)
        begin = begun[episode : episode + 1], unknown[None]
        out[rows] = ahead(space, seen, values, rows[:1], len(rows), begin).variances[0]
        if initial_state == "fitted":
            # A fitted start takes up as many of its episode's residuals as it has coordinates.
            n_measured = int(space.mask[episode].sum())
            out[rows] -= error * (1 - max(1 - d / max(n_measured, 1), LEAST_LEFT))
    return out
