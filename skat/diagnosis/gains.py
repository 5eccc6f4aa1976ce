"""Errors of the nominal and the extended simulation on data that neither was fitted to."""

import numpy as np

from skat.diagnosis.findings import Gain
from skat.diagnosis.open_loop import Episodes

N_BOOTSTRAP = 999
# Fewer pieces do not say how much the gain varies from one to the next.
FEWEST_PIECES = 5


def one_step_gain(residuals, values, random_state):
    """Return the Gain in mean squared one-step error, in units of what noise alone gives.

    Parameters
    ----------
    residuals : Residuals
        Of the held-out log, linearised at `values` with the noise known.
    values : dict of str to float
    random_state : numpy.random.RandomState

    Raises
    ------
    RuntimeError
        If one of the simulations diverges in every row.
    """
    nominal, extended = residuals.noise_errors([{}, values])
    blocks = residuals.blocks[residuals.present]
    before, after = residuals.channel_errors({}), residuals.channel_errors(values)
    channels = {name: (error, after[name]) for name, error in before.items()}
    return _gain(nominal, extended, 1.0, blocks, random_state, horizon=1, channels=channels)


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
    return _gain(
        nominal, extended, floor, log.episodes, random_state, horizon="episode", channels=channels, root=True
    )


def _gain(nominal, extended, floor, blocks, random_state, *, horizon, channels, root=False):
    transform = np.sqrt if root else np.asarray
    labels = np.unique(blocks, return_inverse=True)[1]
    counts = np.bincount(labels)
    low = high = np.nan
    if len(counts) >= FEWEST_PIECES:
        sums = np.stack([np.bincount(labels, one) for one in (nominal, extended)])
        draws = random_state.randint(len(counts), size=(N_BOOTSTRAP, len(counts)))
        totals = counts[draws].sum(axis=1)
        sampled = [
            _explained(a, b, float(transform(floor)))
            for a, b in (transform(sums[:, draw].sum(axis=1) / total) for draw, total in zip(draws, totals))
        ]
        low, high = np.quantile(sampled, [0.025, 0.975])
    nominal, extended, floor = (float(transform(one)) for one in (nominal.mean(), extended.mean(), floor))
    return Gain(
        nominal,
        extended,
        floor,
        _explained(nominal, extended, floor),
        (float(low), float(high)),
        horizon,
        channels,
    )


def _explained(nominal, extended, floor):
    """Return the share of the excess error that is gone; 0 where there is no excess."""
    return float((nominal - extended) / (nominal - floor)) if nominal > floor else 0.0
