"""Errors of the nominal and the extended simulation on data that neither was fitted to."""

import numpy as np

from skat.diagnosis.findings import Gain
from skat.diagnosis.open_loop import Episodes

N_BOOTSTRAP = 999
# Fewer pieces do not say how much the gain varies from one to the next.
FEWEST_PIECES = 5
# Draws of the noise at each row: so many say how much its error counts, as many others what noise alone gives. In long
# logs fewer do, about so many in all.
NOISE_DRAWS = 16
FEWEST_NOISE_DRAWS = 4
ALL_NOISE_DRAWS = 20_000
# Of normal noise, in variances. Where a draw is larger, the simulation kicks, and the row counts the less.
LARGEST_SQUARE = 9.0


def one_step_gain(residuals, values, random_state):
    """Return the Gain in mean squared one-step error, in units of what noise alone gives.

    What noise in the measured states does to an error is simulated: at stiff contacts it is many times more than a
    linearisation says.

    Parameters
    ----------
    residuals : Residuals
        Of the held-out log, differentiated at `values` with the noise known.
    values : dict of str to float
    random_state : numpy.random.RandomState
        Draws the noise, and the bootstrap.

    Raises
    ------
    RuntimeError
        If one of the simulations diverges in every row.
    """
    errors = residuals.squared_errors([{}, values])
    residuals.settle(values, roughly=True)
    # Of two sets of draws, so that what the first says of a row by chance is no bias.
    n_draws = int(np.clip(ALL_NOISE_DRAWS // len(residuals.log), FEWEST_NOISE_DRAWS, NOISE_DRAWS))
    some, others = (residuals.squares_of_noise(values, n_draws, random_state) for _ in range(2))
    sizes = np.maximum(some.max(axis=0) / LARGEST_SQUARE, residuals.residual_variances())
    rows = residuals.present
    nominal, extended, floor = np.mean(
        [one[rows] / sizes[rows] for one in (*errors, others.mean(axis=0))], axis=-1
    )
    parts = nominal / floor.mean(), extended / floor.mean(), floor / floor.mean()
    before, after = residuals.channel_errors({}), residuals.channel_errors(values)
    channels = {name: (error, after[name]) for name, error in before.items()}
    return _gain(*parts, residuals.blocks[rows], random_state, horizon=1, channels=channels)


def episode_gain(simulator, log, values, deviations, *, hidden, initial_state, outputs, random_state):
    """Return the Gain in root mean squared distance over whole episodes in open loop.

    Parameters
    ----------
    simulator : Simulator
    log : Log
    values : dict of str to float
    deviations : ndarray of shape (n_measured,)
        How much each measured channel counts where initial states are fitted, and what a right model cannot avoid.
    hidden : sequence of str
    initial_state : {"measured", "fitted"}
    outputs : sequence of str or None
        Channels that make up the distance; None: all that were measured.
    random_state : numpy.random.RandomState

    Raises
    ------
    RuntimeError
        If an episode diverges.
    """
    episodes = Episodes(simulator, log, hidden)
    names = [name for name, there in zip(simulator.residual_names, episodes.measured) if there]
    unknown = [name for name in outputs or () if name not in names]
    if unknown:
        raise ValueError(f"outputs names {', '.join(unknown)}; measured channels are {', '.join(names)}.")
    chosen = [names.index(name) for name in (outputs or names)]
    errors = []
    models: tuple[dict, dict] = ({}, values)
    for model in models:
        initial = episodes.fit_initial_states(model, deviations) if initial_state == "fitted" else None
        residuals = episodes.residuals([model], initial)[0][:, chosen]
        lost = ~np.isfinite(residuals).all(axis=1)
        if lost.any():
            raise RuntimeError(
                f"In open loop the {'extended' if model else 'nominal'} simulation diverges in episode "
                f"{log.label(log.episodes[lost][0])}: cut it into shorter ones, or leave it out."
            )
        errors.append(residuals)
    nominal, extended = (np.sum(one**2, axis=1) for one in errors)
    channels = {
        names[k]: tuple(float(np.sqrt(np.mean(one[:, i] ** 2))) for one in errors)
        for i, k in enumerate(chosen)
    }
    floor = float(np.sum(np.asarray(deviations)[chosen] ** 2))
    if initial_state == "fitted":
        floor *= episodes.noise_left()
    parts = nominal, extended, np.full(len(log), floor)
    return _gain(*parts, log.episodes, random_state, horizon="episode", channels=channels, root=True)


def _gain(nominal, extended, floor, blocks, random_state, *, horizon, channels, root=False):
    """Return the Gain of errors (n_rows,) of two models and of a right one."""
    transform = np.sqrt if root else np.asarray
    parts = np.stack([nominal, extended, floor])
    labels = np.unique(blocks, return_inverse=True)[1]
    counts = np.bincount(labels)
    low = high = np.nan
    if len(counts) >= FEWEST_PIECES:
        sums = np.stack([np.bincount(labels, one) for one in parts])
        draws = random_state.randint(len(counts), size=(N_BOOTSTRAP, len(counts)))
        sampled = [_explained(*transform(sums[:, draw].sum(axis=1) / counts[draw].sum())) for draw in draws]
        # Where there may be no excess, a share of it may be anything.
        none = np.isnan(sampled)
        low = np.quantile(np.where(none, -np.inf, sampled), 0.025, method="lower")
        high = np.quantile(np.where(none, np.inf, sampled), 0.975, method="higher")
    nominal, extended, floor = map(float, transform(parts.mean(axis=1)))
    return Gain(
        nominal,
        extended,
        floor,
        float(np.nan_to_num(_explained(nominal, extended, floor))),
        (float(low), float(high)),
        horizon,
        channels,
    )


def _explained(nominal, extended, floor):
    """Return the share of the excess error that is gone; NaN where there is no excess."""
    return (nominal - extended) / (nominal - floor) if nominal > floor else np.nan
