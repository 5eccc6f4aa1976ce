r"""How well the simulation as given and the extended one predict a log that neither was fitted to.

Both start, every h rows, in the state that the filter has there from what was measured until then, run for h rows with
the logged commands and without any random force, and are compared with what was measured h rows on. An error counts in
units of its standard deviation under a right model, which is drawn: runs of the extended model from what the filter
leaves unknown of each start, pushed by random forces, and read with noise. So a right model has a mean square of 1, the
floor, also where something hits the ground on the way. Random forces that nothing predicts belong to it. So do forces
with memory: what is known of them at a start is not told to the simulation, and they are drawn with all of their
variance.

Both models start in the same states, those that the extended one's filter has, as the noise is its own: a filter that
takes that little noise for granted follows a wrong model rather than its readings, and would compare runs that began
long before the horizon.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skat.diagnosis.ahead import SETTLED_ROWS, Seen, ahead, before, filtered
from skat.diagnosis.chains import Array, Mask, Places
from skat.diagnosis.filtering import kalman_filter, smooth, updated
from skat.diagnosis.findings import Gain
from skat.diagnosis.fitting import Fitted, as_measured, known_forces
from skat.diagnosis.forces.force_space import LEFT_AT_LEAST
from skat.diagnosis.noise import (
    Estimate,
    Noise,
    expected_squares,
    normal_noise,
    passed,
    precisions,
    variances_of,
)
from skat.diagnosis.statespace import StateSpace, linearise, moved_path, steps_of
from skat.simulators import Simulator

# By default the horizon is so long, and as long as a filter takes to settle.
HORIZON_S = 0.25
# How often the path of a held-out log, and the weights of its samples, are taken anew.
TURNS = 3
# An error counts with at most this square, in units of the larger of its own variance and the nominal model's typical
# square.
LARGEST_SQUARE = 9.0
# Of a square of a standard normal number, the median.
MEDIAN_OF_SQUARES = 0.4549
# In an output's own unit, no error counts for more than so many standard deviations of what was measured, in this log
# or in the one that was fitted, whichever is more.
FARTHEST = 10.0
# Draws of pieces of time that count as independent. Fewer pieces, drawn with replacement, are too often all the same,
# and do not say how much a gain varies from one to the next; few episodes are cut, into about so many.
N_BOOTSTRAP = 999
FEWEST_PIECES, PIECES = 5, 20
N_OVERLAYS = 3
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
    """Errors at a horizon, episodes that the nominal model predicts worst, and how many starts diverge in some row."""

    gain: Gain
    overlays: tuple[Overlay, ...]
    n_starts: int
    n_diverged: int


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
        If the horizon is not positive and finite.
    """
    if horizon is not None and not 0 < horizon < np.inf:
        raise ValueError(f"horizon must be positive and finite, in seconds; it is {horizon!r}.")
    if not simulator.state_names:
        return 1
    dt = simulator.dt
    if horizon is None:
        return max(SETTLED_ROWS, int(np.ceil(HORIZON_S / dt - 1e-9)) if dt else 0)
    return max(1, round(horizon / dt if dt else horizon))


def predicted(
    space: StateSpace,
    fitted: Fitted,
    values: Mapping[str, float],
    *,
    horizon: int | None = None,
    random_state: np.random.RandomState,
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
    lost = np.asarray(~np.isfinite(errors).all(axis=(0, 2, 3)))
    right = ahead(space, seen, values, starts, h)
    with np.errstate(over="ignore"):
        squares = np.nan_to_num(errors[:, :, -1] ** 2 / right.variances[:, -1], nan=np.inf)
    nominal, extended, floor = _cut(squares, right.last, counted)
    there = counted.any(axis=1)
    gain = measured_gain(
        np.stack([nominal, extended, floor])[:, there],
        pieces_of(space.groups[starts])[there],
        random_state,
        horizon=float(h * simulator.dt) if simulator.dt else float(h),
        channels=_channel_errors(space, fitted, errors, mask[rows]),
    )
    chosen = _worst_episodes(space.groups[starts], nominal, N_OVERLAYS) if simulator.state_names else []
    overlays = tuple(_overlay(space, paths, starts, h, episode) for episode in chosen)
    return Prediction(gain, overlays, len(lost), int(lost.sum()))


def look(space: StateSpace, fitted: Fitted, values: Mapping[str, float]) -> Seen:
    """Return a log that a noise was not fitted to, as this noise and a model have it.

    Where heavy tails were found, each sample's weight is found anew in turns with the variances held.
    """
    noise, memory = _with_even_weights(fitted.estimate.noise, space), fitted.memory
    path, covariances, forces, slopes = space.measured, None, None, None
    if space.simulator.state_names and space.mask[space.places].all():
        covariances = as_measured(space, variances_of(noise.error, noise.error_nu)[:, : space.d])
    heavy = bool(np.isfinite(np.c_[noise.force_nu, noise.error_nu]).any())
    turns = TURNS if space.simulator.state_names or heavy else 1
    for turn in range(turns):
        linear = linearise(space, path, values, covariances, forces=forces, slopes=slopes, renewed=True)
        chains = linear.chains.with_memory(memory)
        for _ in range(TURNS if heavy else 0):
            estimate = passed(chains, noise, space.real)
            noise = _weighted(estimate, space.real, chains.mask)
        estimate = passed(chains, noise, space.real, covariances=True)
        if turn < turns - 1:
            means, known = updated(chains, estimate.filtered, noise.error_variances)
            path, slopes = moved_path(space, linear.path, means[..., : space.d]), linear
            covariances = known[..., : space.d, : space.d]
            forces = known_forces(space, memory, noise, means, known)
    return Seen(linear, chains, estimate, memory)


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
        Of which each episode is a chain.
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
    variances = variances_of(noise.error, noise.error_nu)[:, : space.d]
    counted = mask & chosen
    paths = []
    models: tuple[Mapping[str, float], ...] = ({}, values)
    for name, model in zip(("nominal", "extended"), models):
        path, lost = in_open_loop(space, model, variances, initial_state=initial_state)
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
    return measured_gain(
        np.stack([*squares, floor])[:, there],
        space.groups[there],
        random_state,
        horizon="episode",
        channels=_channel_errors(space, fitted, errors, counted),
        root=True,
    )


# -- parts of a prediction -------------------------------------------------------------------------------------------


def _with_even_weights(noise: Noise, space: StateSpace) -> Noise:
    n, steps = space.real.shape
    return replace(
        noise,
        law=space.origin,
        force_weights=np.ones((n, steps, noise.force.shape[1])),
        error_weights=np.ones((n, steps + 1, noise.error.shape[1])),
    )


def _weighted(last: Estimate, real: Mask, mask: Mask) -> Noise:
    """Return a noise with the expected precision of each sample, its law held."""
    noise = last.noise
    force_squares, error_squares = expected_squares(last.smoothed)
    force, force_nu, error, error_nu = (
        one[noise.law][:, None] for one in (noise.force, noise.force_nu, noise.error, noise.error_nu)
    )
    return replace(
        noise,
        force_weights=precisions(force_squares, force, force_nu, real[..., None]),
        error_weights=precisions(error_squares, error, error_nu, mask),
    )


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
        before=before(space, seen, candidates, starts),
    )
    return paths[:, :, 1:]


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


def pieces_of(episodes: Places) -> Places:
    """Return the piece of each row or start that counts as one: its episode, or where there are few, one of time."""
    labels = np.unique(episodes, return_inverse=True)[1]
    n_episodes = int(labels.max()) + 1
    if n_episodes >= FEWEST_PIECES:
        return labels
    sizes = np.bincount(labels)
    each = -(-PIECES // n_episodes)
    within = np.arange(len(labels)) - np.r_[0, np.cumsum(sizes)[:-1]][labels]
    pieces: Places = labels * each + within * np.minimum(each, sizes[labels]) // sizes[labels]
    return pieces


def measured_gain(
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


def _channel_errors(
    space: StateSpace, fitted: Fitted, errors: Array, mask: Mask
) -> dict[str, tuple[float, float]]:
    """Return root mean squares (nominal, extended) of errors (2, ..., d) of each channel that was measured."""
    names = space.simulator.residual_names
    # Where the machine rests, errors of a model that moves are far beyond the spread of this log.
    most = FARTHEST * np.maximum(space.spread, np.sqrt(fitted.linear.chains.prior)) / 3
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


def in_open_loop(
    space: StateSpace, values: Mapping[str, float], error: Array, *, initial_state: str = "fitted"
) -> tuple[Array, Mask]:
    """Return episodes in open loop (n_episodes, n_steps + 1, n_outputs), and which of them diverge.

    Parameters
    ----------
    space : StateSpace
        Of which each episode is a chain.
    values : mapping from name to value
    error : ndarray of shape (n_laws, d)
        Variance of each channel's noise.
    initial_state : {"measured", "fitted"}, default="fitted"
        Where they begin; a fitted state is taken where it does better than what was measured.
    """
    simulator, (measured, mask) = space.simulator, ends(space)
    inputs = space.padded(space.X[:, len(simulator.state_names) :])
    n_steps, episode = space.real.shape[1], space.places[0]
    starts = [space.measured[:, 0]] + (
        _fitted_starts(space, values, error) if initial_state == "fitted" else []
    )
    best, least = np.empty(0), np.full(len(space.real), np.inf)
    for start in starts:
        (path,) = simulator.rollout_many(start, inputs, [values], n_steps=n_steps)
        with np.errstate(invalid="ignore", over="ignore"):
            squares = simulator.residual(measured, path[:, 1:][space.places]) ** 2 / error[space.origins]
            loss = np.bincount(episode, np.where(mask, squares, 0.0).sum(axis=1))
        loss = np.where(
            np.bincount(episode, ~np.isfinite(path[:, 1:][space.places]).all(axis=1)) > 0, np.inf, loss
        )
        if not len(best):
            best = path
        better = loss < least
        best[better], least[better] = path[better], loss[better]
    return best, ~np.isfinite(least)


def _fitted_starts(space: StateSpace, values: Mapping[str, float], error: Array) -> list[Array]:
    """Return initial states of episodes given all of them, with no random force, as relinearisation goes on."""
    path, starts = space.measured, []
    for _ in range(START_TURNS):
        linear = linearise(space, path, values)
        force = np.zeros((len(error), linear.chains.carrier.shape[-1]))
        noise = normal_noise(linear.chains, force, error, space.origin)
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


def _open_loop_variances(
    space: StateSpace, fitted: Fitted, values: Mapping[str, float], initial_state: str, begun: Array
) -> Array:
    """Return the variance of what a right model's error would be after each row, (n_rows, d), from states begun in."""
    linear, memory = linearise(space, space.measured, values), fitted.memory
    seen = Seen(linear, linear.chains.with_memory(memory), fitted.estimate, memory)
    d = space.d
    errors = variances_of(fitted.estimate.noise.error, fitted.estimate.noise.error_nu)[:, :d]
    out = np.empty((len(space.X), d))
    for episode in range(len(space.real)):
        rows, error = np.flatnonzero(space.places[0] == episode), errors[space.origin[episode]]
        unknown = np.diag(error) if initial_state == "measured" else np.zeros((d, d))
        begin = begun[episode : episode + 1], unknown[None]
        out[rows] = ahead(space, seen, values, rows[:1], len(rows), begin).variances[0]
        if initial_state == "fitted":
            # A fitted start takes up as many of its episode's residuals as it has coordinates.
            n_measured = int(space.mask[episode].sum())
            out[rows] -= error * (1 - max(1 - d / max(n_measured, 1), LEFT_AT_LEAST))
    return out
