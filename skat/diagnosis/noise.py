r"""Sensor noise and random forces, by variational inference.

Each measured channel has noise of variance r, each degree of freedom a random acceleration of variance q, both with
Student's t: a normal law whose precision is scaled by a Gamma variable of its own for each sample. Path and scales are
factorised, and a bound of the log likelihood is raised in turns: by the scales in closed form, by the degrees of
freedom over a grid, and by the variances with the step of [1]_, which is monotone and shrinks a variance that is not
there geometrically, where the step of expectation maximisation would take for ever.

References
----------
.. [1] Zhou, Hu, Zhou, Lange (2019). MM algorithms for variance components models. J. Comp. Graph. Stat. 28(2).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln, psi

from skat.diagnosis.filtering import (
    Array,
    Chains,
    Filtered,
    Mask,
    Smoothed,
    kalman_filter,
    smooth,
    student_log_density,
)

# Of the variance of a chain's first state: finer than any sensor, and well above the rounding of a covariance.
FINEST = 1e-13
SMALLEST = 1e-300
# A fit that gains less than so many nats gains nothing.
TOLERANCE = 0.1
DEGREES_OF_FREEDOM = (np.inf, 10.0, 5.0, 3.0)


@dataclass(frozen=True)
class Noise:
    """Laws of the random forces and of the sensors' noise.

    Attributes
    ----------
    force, error : ndarray of shape (n_forces,), (d,)
        Squared scales q and r; variances where nu is infinite.
    force_nu, error_nu : ndarray of shape (n_forces,), (d,)
        Degrees of freedom.
    force_weights : ndarray of shape (n_chains, n_steps, n_forces)
        Expected precision of each sample, in units of 1 / q.
    error_weights : ndarray of shape (n_chains, n_steps + 1, d)
    """

    force: Array
    error: Array
    force_nu: Array
    error_nu: Array
    force_weights: Array
    error_weights: Array

    @property
    def force_variances(self) -> Array:
        """Variance of each sample of w."""
        return self.force / self.force_weights

    @property
    def error_variances(self) -> Array:
        """Variance of each sample of e."""
        return self.error / self.error_weights


@dataclass(frozen=True)
class Estimate:
    """Noise, the pass of filter and smoother that it was found with, and the bound of the log likelihood there."""

    noise: Noise
    bound: float
    filtered: Filtered
    smoothed: Smoothed


def normal_noise(chains: Chains, force: Array, error: Array) -> Noise:
    """Return normal noise of given variances."""
    n, steps, d = chains.drive.shape
    n_forces = chains.carrier.shape[-1]
    return Noise(
        np.asarray(force, float),
        np.asarray(error, float),
        np.full(n_forces, np.inf),
        np.full(d, np.inf),
        np.ones((n, steps, n_forces)),
        np.ones((n, steps + 1, d)),
    )


def passed(chains: Chains, noise: Noise, real: Mask, *, covariances: bool = False) -> Estimate:
    """Filter and smooth with a noise, and return the bound there.

    Parameters
    ----------
    chains : Chains
    noise : Noise
    real : ndarray of bool of shape (n_chains, n_steps)
        Steps that are no padding.
    covariances : bool, default=False
        Whether the states' covariances are wanted.
    """
    force, error = noise.force_variances, noise.error_variances
    filtered = kalman_filter(chains, force, error)
    smoothed = smooth(chains, filtered, force, error, covariances=covariances)
    bound = filtered.log_likelihood
    bound += _cost_of_scales(noise.force_weights, noise.force_nu, real[..., None])
    bound += _cost_of_scales(noise.error_weights, noise.error_nu, chains.mask)
    return Estimate(noise, bound, filtered, smoothed)


def estimate_noise(
    chains: Chains,
    noise: Noise,
    real: Mask,
    *,
    floor: Array,
    heavy: bool = True,
    n_passes: int = 40,
    tolerance: float = TOLERANCE,
    held: Mask | None = None,
) -> Estimate:
    """Raise the bound until a pass adds less than a tolerance.

    Parameters
    ----------
    chains : Chains
    noise : Noise
        Where to start.
    real : ndarray of bool of shape (n_chains, n_steps)
    floor : ndarray of shape (d,)
        Least variance of each channel's noise, such as that of rounding.
    heavy : bool, default=True
        Whether degrees of freedom are chosen.
    n_passes : int, default=40
    tolerance : float, default=0.1
        In nats.
    held : ndarray of bool of shape (d,), optional
        Channels whose variance was given.

    Returns
    -------
    Estimate
        The last pass has the states' covariances.
    """
    floor = np.maximum(floor, FINEST * chains.prior)
    # Behind a start below the floor no step would be a gain.
    begun = np.maximum(noise.error, floor)
    noise = replace(noise, error=begun if held is None else np.where(held, noise.error, begun))
    best = passed(chains, noise, real)
    exponent, gain = 1.0, np.inf
    for _ in range(n_passes):
        proposed = _improved(chains, best, real, exponent, floor, heavy, held)
        tried = passed(chains, proposed, real)
        if not tried.bound > best.bound:
            if exponent < 0.4:
                break
            exponent /= 2
            continue
        gain, best = tried.bound - best.bound, tried
        exponent = min(1.0, 1.5 * exponent)
        if gain < tolerance:
            break
    force, error = best.noise.force_variances, best.noise.error_variances
    return replace(best, smoothed=smooth(chains, best.filtered, force, error))


def _improved(
    chains: Chains, last: Estimate, real: Mask, exponent: float, floor: Array, heavy: bool, held: Mask | None
) -> Noise:
    noise, smoothed = last.noise, last.smoothed
    force_squares = smoothed.forces**2 + smoothed.force_variances
    error_squares = smoothed.errors**2 + smoothed.error_variances
    force = noise.force * _step(
        smoothed.forces,
        smoothed.force_variances,
        noise.force_variances,
        noise.force_weights,
        real[..., None],
        exponent,
    )
    error = noise.error * _step(
        smoothed.errors,
        smoothed.error_variances,
        noise.error_variances,
        noise.error_weights,
        chains.mask,
        exponent,
    )
    error = np.maximum(error, floor)
    if held is not None:
        error = np.where(held, noise.error, error)
    force = np.maximum(force, 1e-30)
    if not heavy:
        return replace(noise, force=force, error=error)
    force_nu, force_weights = _scales(
        force_squares, force, np.broadcast_to(real[..., None], force_squares.shape)
    )
    error_nu, error_weights = _scales(error_squares, error, chains.mask)
    if held is not None:  # A noise that is known has no outliers: what lies beyond it is the model's.
        error_nu, error_weights = np.where(held, np.inf, error_nu), np.where(held, 1.0, error_weights)
    return Noise(force, error, force_nu, error_nu, force_weights, error_weights)


def _step(
    means: Array, variances: Array, prior: Array, weights: Array, present: Mask, exponent: float
) -> Array:
    """Return by what each variance is multiplied: (sum u^2 / sum D) to a power; 1/2 is the monotone step of [1]."""
    scaled = prior * weights  # q or r, as all weights of a column belong to one
    u_squares = (means / prior) ** 2 * scaled / weights
    D = (1 - variances / prior) / prior * scaled / weights
    axes = (0, 1)
    top = np.sum(np.where(present, u_squares, 0.0), axis=axes)
    bottom = np.sum(np.where(present, D, 0.0), axis=axes)
    known = (bottom > 0) & (top > 0)
    ratio = np.where(known, top / np.where(known, bottom, 1.0), 1.0)
    return np.clip(ratio, 1e-3, 1e3) ** exponent


def _scales(squares: Array, variance: Array, present: Mask) -> tuple[Array, Array]:
    """Return the best degrees of freedom of each column, and the expected precisions."""
    k = len(variance)
    nus = np.full(k, np.inf)
    there = present.sum(axis=(0, 1)) > 0
    if not there.any():
        return nus, np.ones(squares.shape)
    flat, seen = squares.reshape(-1, k), present.reshape(-1, k)
    bounds = []
    for nu in DEGREES_OF_FREEDOM:
        scale = _best_scales(flat, seen, variance, nu)
        bounds.append(np.sum(student_log_density(flat, scale, nu), axis=0, where=seen))
    nus[there] = np.array(DEGREES_OF_FREEDOM)[np.argmax(bounds, axis=0)][there]
    return nus, precisions(squares, variance, nus, present)


def precisions(squares: Array, scale: Array, nu: Array, present: Mask) -> Array:
    """Return the expected precision of each sample, in units of 1 / scale; 1 where there is none."""
    weights, heavy = np.ones(squares.shape), np.isfinite(nu)
    expected = (nu[heavy] + 1) / (nu[heavy] + squares[..., heavy] / scale[heavy])
    weights[..., heavy] = np.where(np.broadcast_to(present, squares.shape)[..., heavy], expected, 1.0)
    return weights


def _best_scales(squares: Array, seen: Mask, start: Array, nu: float) -> Array:
    """Return the likeliest squared scale of each column of squares (n, k)."""
    # Of a log that a model repeats exactly nothing is left.
    counts = np.maximum(seen.sum(axis=0), 1)
    if np.isinf(nu):
        mean: Array = np.sum(squares, axis=0, where=seen) / counts
        return np.maximum(mean, SMALLEST)
    scale = np.maximum(start, SMALLEST)
    for _ in range(8):
        shares = (nu + 1) / (nu + squares / scale) * squares
        scale = np.maximum(np.sum(shares, axis=0, where=seen) / counts, SMALLEST)
    return scale


def _cost_of_scales(weights: Array, nus: Array, present: Mask) -> float:
    """Return what the bound has beside the normal likelihood at the expected precisions."""
    cost = 0.0
    present = np.broadcast_to(present, weights.shape)
    for column, nu in enumerate(nus):
        if np.isinf(nu):
            continue
        mean = weights[..., column][present[..., column]]
        a, half = (nu + 1) / 2, nu / 2
        b = a / mean
        divergence = (
            (a - half) * psi(a)
            - gammaln(a)
            + gammaln(half)
            + half * (np.log(b) - np.log(half))
            + a * (half - b) / b
        )
        cost += float(np.sum(0.5 * (psi(a) - np.log(b) - np.log(mean)) - divergence))
    return cost
