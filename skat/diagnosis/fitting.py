"""Fits of the state space: values of a set of causes, noise, path and slopes, and the Gram matrices of a search."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skat.diagnosis.filtering import Array, Chains, filter_columns
from skat.diagnosis.noise import Estimate, Noise, estimate_noise, normal_noise
from skat.diagnosis.set_evidence import Gram, Priors
from skat.diagnosis.statespace import Linear, StateSpace, derivatives, linearise, moved_path
from skat.effects import Effect

# A path stands still when it moves by less than this share of what is not known of it.
STILL = 0.1
# Memories of random forces that are tried, in rows; of at most this share of an episode, so that what is steady stays a
# cause; and what each of their numbers must be worth, in nats.
MEMORIES = (2.0, 5.0, 10.0, 20.0, 40.0)
SHARE_OF_EPISODE = 0.1
MEMORY_WORTH = 2.0
FEWEST_FOR_MEMORY = 10


@dataclass(frozen=True)
class Fitted:
    """The simulation at the values of a set of causes, as a log has it.

    Attributes
    ----------
    values : mapping from name to value
    linear : Linear
        About the smoothed path.
    estimate : Estimate
        Noise, and the pass of filter and smoother with it.
    chains : Chains
        Those of `linear`, with forces of memory where the noise has such.
    shares : ndarray of shape (n_forces,) or (0,)
        What is left of such a force a row later.
    """

    values: Mapping[str, float]
    linear: Linear
    chains: Chains
    estimate: Estimate
    shares: Array

    @property
    def bound(self) -> float:
        """Of the log likelihood, at this fit's own noise."""
        return self.estimate.bound


def priors_of(effects: Sequence[Effect], typical: Mapping[str, float] | None = None) -> Priors:
    """Return the priors of effects, values measured from neutral."""
    typical = typical or {}
    odds = np.array([effect.odds for effect in effects])
    return Priors(
        tuple(effect.name for effect in effects),
        np.array([typical.get(effect.name, effect.typical) for effect in effects]),
        np.log(odds / (odds.sum() + 1)),
        np.array([effect.bounds[0] - effect.neutral for effect in effects]),
        np.array([effect.bounds[1] - effect.neutral for effect in effects]),
    )


def settled(
    space: StateSpace, values: Mapping[str, float], start: Fitted | None, floor: Array, *, turns: int = 3
) -> Fitted:
    """Return the fit at given values: path smoothed, slopes taken over what is not known, noise estimated.

    Parameters
    ----------
    space : StateSpace
    values : mapping from name to value
    start : Fitted, optional
        Begin with the path and the noise of this one.
    floor : ndarray of shape (d,)
        Least variance of each channel's noise.
    turns : int, default=3
        How often path and slopes are taken anew at most.
    """
    if start is None:
        linear = linearise(space, space.measured, values)
        residuals = np.where(linear.valid[:, None], linear.chains.drive[space.places], np.nan)
        typical = (1.4826 * np.nanmedian(np.abs(residuals), axis=0)) ** 2 / 2 + 1e-12 * space.spread**2
        noise = normal_noise(linear.chains, _force_guess(linear, typical), typical)
        chains, shares = linear.chains, np.zeros(0)
    else:
        linear = linearise(space, start.linear.path, values, _covariances(space, start.estimate))
        noise, shares = start.estimate.noise, start.shares
        chains = _remembering(space, linear, shares)
    estimate = estimate_noise(chains, noise, space.real, floor=_extended(floor, chains))
    for turn in range(turns):
        deviations = estimate.smoothed.means[..., : space.d]
        covariances = _covariances(space, estimate)
        unknown = np.sqrt(np.maximum(np.einsum("ctii->cti", covariances), 0.0)) + 1e-12 * space.spread
        moved = np.sqrt(np.mean((deviations / unknown)[:, :-1][space.real] ** 2))
        path = moved_path(space, linear.path, deviations)
        linear = linearise(space, path, values, covariances)
        if turn == 0 and space.real.shape[1] > FEWEST_FOR_MEMORY:
            estimate, shares = _with_best_memory(space, linear, estimate.noise, shares, floor)
        else:
            chains = _remembering(space, linear, shares)
            estimate = estimate_noise(chains, estimate.noise, space.real, floor=_extended(floor, chains))
        if moved < STILL:
            break
    return Fitted(dict(values), linear, _remembering(space, linear, shares), estimate, shares)


def _with_best_memory(
    space: StateSpace, linear: Linear, noise: Noise, shares: Array, floor: Array
) -> tuple[Estimate, Array]:
    """Return the noise with forces of the memory, if any, that the bound asks for."""
    n_forces = linear.chains.carrier.shape[-1]
    plain = _without_memory(noise, space.d, n_forces)
    without = best = estimate_noise(linear.chains, plain, space.real, floor=floor)
    found = np.zeros(0)
    longest = SHARE_OF_EPISODE * np.unique(space.groups, return_counts=True)[1].max()
    for rows in MEMORIES:
        if rows > longest:
            continue
        tried = np.full(n_forces, np.exp(-1 / rows))
        chains = _remembering(space, linear, tried)
        start = noise if len(shares) else _with_memory(without.noise, tried)
        estimate = estimate_noise(chains, start, space.real, floor=_extended(floor, chains))
        # A variance more for each force, and the memory itself.
        if estimate.bound > best.bound + (0 if len(found) else MEMORY_WORTH * (n_forces + 1)):
            best, found = estimate, tried
    return best, found


def _remembering(space: StateSpace, linear: Linear, shares: Array) -> Chains:
    if not len(shares):
        return linear.chains
    sizes = np.mean(linear.chains.carrier**2, axis=(0, 1)) / space.spread[:, None] ** 2
    return linear.chains.with_memory(shares, 1 / np.maximum(sizes.max(axis=0), 1e-300))


def _with_memory(noise: Noise, shares: Array) -> Noise:
    n_chains, steps, _ = noise.force_weights.shape
    k = len(shares)
    return Noise(
        np.r_[noise.force, noise.force * (1 - shares**2)],
        np.r_[noise.error, np.ones(k)],
        np.r_[noise.force_nu, np.full(k, np.inf)],
        np.r_[noise.error_nu, np.full(k, np.inf)],
        np.concatenate([noise.force_weights, np.ones((n_chains, steps, k))], axis=-1),
        np.concatenate([noise.error_weights, np.ones((n_chains, steps + 1, k))], axis=-1),
    )


def _without_memory(noise: Noise, d: int, n_forces: int) -> Noise:
    if len(noise.error) == d:
        return noise
    return Noise(
        noise.force[:n_forces],
        noise.error[:d],
        noise.force_nu[:n_forces],
        noise.error_nu[:d],
        noise.force_weights[..., :n_forces],
        noise.error_weights[..., :d],
    )


def _extended(floor: Array, chains: Chains) -> Array:
    return np.r_[floor, np.zeros(chains.drive.shape[-1] - len(floor))]


def _covariances(space: StateSpace, estimate: Estimate) -> Array:
    return estimate.smoothed.covariances[..., : space.d, : space.d]


def gram_of(
    space: StateSpace, fitted: Fitted, effects: Sequence[Effect], priors: Priors
) -> tuple[Gram, Array, Array]:
    """Return second moments of whitened innovations and derivatives; innovations and derivatives themselves.

    Returns
    -------
    Gram
    whitened : ndarray of shape (n_measured,)
    columns : ndarray of shape (n_measured, k)
    """
    steps = _steps(fitted.values, effects, priors)
    slopes = derivatives(space, fitted.linear, fitted.values, steps)
    chains, filtered = fitted.chains, fitted.estimate.filtered
    hidden = chains.drive.shape[-1] - space.d
    slopes = np.pad(slopes, [(0, 0), (0, hidden), (0, 0)])
    columns = filter_columns(chains, filtered, space.padded(slopes))[chains.mask]
    whitened = filtered.whitened[chains.mask]
    origin = np.array([fitted.values.get(effect.name, effect.neutral) - effect.neutral for effect in effects])
    return Gram(columns.T @ columns, columns.T @ whitened, origin), whitened, columns


def _steps(
    values: Mapping[str, float], effects: Sequence[Effect], priors: Priors
) -> dict[str, tuple[float, float]]:
    """Return between which values each slope is taken: about a twentieth of the typical size, within bounds."""
    steps = {}
    for effect, scale in zip(effects, priors.scales):
        now = values.get(effect.name, effect.neutral)
        width = 0.05 * scale
        low, high = max(effect.bounds[0], now - width), min(effect.bounds[1], now + width)
        steps[effect.name] = (
            (low, now) if high <= now else (now, high) if effect.name not in values else (low, high)
        )
    return steps


def _force_guess(linear: Linear, typical: Array) -> Array:
    """Return variances of forces that would make up the residuals of one step."""
    sizes = np.mean(linear.chains.carrier**2, axis=(0, 1)) / typical[:, None]
    return 1 / np.maximum(sizes.max(axis=0), 1e-300) if sizes.size else np.zeros(0)
