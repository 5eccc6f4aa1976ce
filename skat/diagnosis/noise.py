r"""Sensor noise and random forces, by variational inference.

Each measured channel has noise of variance r, each degree of freedom a random force of variance q, both with
Student's t: a normal law whose precision is scaled by a Gamma variable of its own for each sample. Path and scales are
factorised, and a bound of the log likelihood is raised in turns: by the scales in closed form, by the degrees of
freedom over a grid, and by the variances, and how forces act together, with steps of Newton on the average information.
They are damped by the curvature of the step of [1]_, which never lowers the bound and shrinks a variance that is not
there geometrically, where that of expectation maximisation would take for ever.

References
----------
.. [1] Zhou, Hu, Zhou, Lange (2019). MM algorithms for variance components models. J. Comp. Graph. Stat. 28(2).
.. [2] Lange, Little, Taylor (1989). Robust statistical modeling using the t distribution. JASA 84(408).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np
from scipy.special import gammaln, psi

from skat.diagnosis.chains import Array, Chains, Mask, Places, block
from skat.diagnosis.filtering import (
    SMALLEST,
    Filtered,
    Smoothed,
    average_information,
    filtered_together,
    kalman_filter,
    smooth,
    smoothed_together,
    student_log_density,
)

# Of the variance of a chain's first state: finer than any sensor, and well above the rounding of a covariance.
FINEST = 1e-13
# A fit that gains less than so many nats gains nothing.
TOLERANCE = 0.1
# Passes of an estimate at most.
PASSES = 40
# In a pass no variance is moved by more on its logarithm.
FURTHEST = float(np.log(1e3))
# A step that lowers the bound is damped by so many times as much.
LEAST_DAMPING, DAMPED = 1 / 64, 8.0
DEGREES_OF_FREEDOM = (np.inf, 10.0, 5.0, 3.0)
Part = TypeVar("Part")


@dataclass(frozen=True)
class Noise:
    """Laws of the random forces and of the sensors' noise: each log has its own.

    Attributes
    ----------
    force, error : ndarray of shape (n_laws, n_forces), (n_laws, d)
        Squared scales q and r; variances where nu is infinite.
    force_nu, error_nu : ndarray of shape (n_laws, n_forces), (n_laws, d)
        Degrees of freedom.
    law : ndarray of int of shape (n_chains,)
        Of each chain.
    force_weights : ndarray of shape (n_chains, n_steps, n_forces)
        Expected precision of each sample, in units of 1 / q.
    error_weights : ndarray of shape (n_chains, n_steps + 1, d)
    mixing : ndarray of shape (n_laws, k, k), optional
        What acts on the k joints is this times k pushes that are independent of each other, whose laws these are: a
        base that shakes or a link that bends acts on several joints at once. Lower triangular, with a diagonal of ones;
        None where each push acts on a joint of its own.
    """

    force: Array
    error: Array
    force_nu: Array
    error_nu: Array
    law: Places
    force_weights: Array
    error_weights: Array
    mixing: Array | None = None

    @property
    def force_variances(self) -> Array:
        """Variance of each sample of w."""
        return self.force[self.law][:, None] / self.force_weights

    @property
    def error_variances(self) -> Array:
        """Variance of each sample of e."""
        return self.error[self.law][:, None] / self.error_weights

    def together(self, k: int) -> "Noise":
        """Return this noise as one whose pushes may act together on k joints, though they do not yet."""
        return replace(self, mixing=np.tile(np.eye(k), (len(self.force), 1, 1)))

    @property
    def mixings(self) -> Array | None:
        """How pushes act together in each chain, (n_chains, k, k)."""
        return None if self.mixing is None else self.mixing[self.law]

    def on_joints(self, pushes: Array) -> Array:
        """Return what pushes (n_chains, n_steps, k) amount to on joints."""
        return pushes if self.mixings is None else pushes @ self.mixings.swapaxes(1, 2)

    def variances_on_joints(self, smoothed: Smoothed, k: int) -> Array:
        """Return the variances of what the first k pushes amount to on joints, given all measurements."""
        if self.mixings is None:
            return smoothed.force_variances[..., :k]
        q, information = self.force_variances[..., :k], smoothed.force_information[..., :k, :k]
        pushed = self.mixings[:, None] * q[:, :, None]
        variances: Array = q @ (self.mixings**2).swapaxes(1, 2) - np.sum(
            (pushed @ information) * pushed, axis=-1
        )
        return variances

    @property
    def joint_force(self) -> Array:
        """Squared scales of the forces on joints, as `force` has those of pushes."""
        if self.mixing is None:
            return self.force
        n, k = self.mixing.shape[:2]
        pushes = self.force.reshape(n, -1, k)
        return (pushes @ (self.mixing**2).swapaxes(1, 2)).reshape(self.force.shape)

    def part(self, channels: Places, forces: Places) -> "Noise":
        """Return the laws of some channels and forces."""
        mixing = self.mixing
        if mixing is not None:
            mixing = block(mixing, forces[forces < mixing.shape[-1]])
        own = {one: getattr(self, one)[..., forces if "force" in one else channels] for one in self.names()}
        return replace(self, **own, mixing=mixing)

    def alone(self, law: int) -> "Noise":
        """Return one law, of the chains that have it."""
        own, one = self.law == law, slice(law, law + 1)
        mine = {name: getattr(self, name)[own if "weights" in name else one] for name in self.names()}
        mixing = None if self.mixing is None else self.mixing[one]
        return replace(self, **mine, mixing=mixing, law=np.zeros(int(own.sum()), dtype=int))

    @staticmethod
    def names() -> tuple[str, ...]:
        """Return the names of what each force has, and each channel."""
        return ("force", "error", "force_nu", "error_nu", "force_weights", "error_weights")

    def unseen(self) -> "Noise":
        """Return the laws of no chain."""
        force, error = self.force_weights[:0], self.error_weights[:0]
        return replace(self, law=self.law[:0], force_weights=force, error_weights=error)

    def pooled(self) -> "Noise":
        """Return one law for all chains: mean variances, of forces on joints, with the heaviest tails."""
        if len(self.error) == 1:
            return self
        force_nu, error_nu = (one.min(axis=0, keepdims=True) for one in (self.force_nu, self.error_nu))
        variances, mixing = variances_of(self.force, self.force_nu), self.mixing
        force = variances.mean(axis=0, keepdims=True)
        if mixing is not None:
            n, k = mixing.shape[:2]
            pushes = variances.reshape(n, -1, k)
            whole = np.mean((mixing * pushes.sum(axis=1)[:, None]) @ mixing.swapaxes(1, 2), axis=0)
            root = np.linalg.cholesky(whole + np.diag(FINEST * np.diag(whole) + SMALLEST))
            pooled = root / np.diag(root)
            # As sums of squares they are not below zero by rounding where pushes have all but gone.
            force = np.mean(pushes @ (np.linalg.inv(pooled) @ mixing).swapaxes(1, 2) ** 2, axis=0).reshape(
                1, -1
            )
            mixing = pooled[None]
        error = variances_of(self.error, self.error_nu).mean(axis=0, keepdims=True)
        return replace(
            self,
            force=scales_of(force, force_nu),
            error=scales_of(error, error_nu),
            force_nu=force_nu,
            error_nu=error_nu,
            mixing=mixing,
            law=np.zeros_like(self.law),
        )

    def with_unread(self, read: Mask) -> "Noise":
        """Return this noise where a law of a channel that its log did not read is that of the logs that did, together.

        Parameters
        ----------
        read : ndarray of bool of shape (n_laws, d)
        """
        unread = ~read & read.any(axis=0)
        if not unread.any():
            return self
        nu = np.where(read, self.error_nu, np.inf).min(axis=0)
        variances = variances_of(self.error, self.error_nu)
        means = np.sum(variances, axis=0, where=read) / np.maximum(read.sum(axis=0), 1)
        return replace(
            self,
            error=np.where(unread, scales_of(means, nu), self.error),
            error_nu=np.where(unread, nu, self.error_nu),
        )


@dataclass(frozen=True)
class Estimate:
    """Noise, the pass of filter and smoother that it was found with, and the bound of the log likelihood there."""

    noise: Noise
    bound: float
    filtered: Filtered
    smoothed: Smoothed

    @property
    def certainty(self) -> Array:
        """Root of the share of each whitened innovation's information that is left as its sample's scale is not known.

        Of Student's t that share is (nu + 1) / (nu + 3) [2]_, and of an innovation's variance its sensor's noise is but
        a part. Derivatives times this and innovations over it keep their scores. (n_chains, n_steps + 1, d).
        """
        own = np.diagonal(self.filtered.factors, axis1=2, axis2=3)
        part = np.minimum(self.noise.error_variances * own**2, 1.0)
        certainty: Array = np.sqrt(1 - 2 * part**2 / (self.noise.error_nu[self.noise.law][:, None] + 3))
        return certainty


def normal_noise(chains: Chains, force: Array, error: Array, law: Places | None = None) -> Noise:
    """Return normal noise of given variances, (n_forces,) and (d,), or of each law where chains have several."""
    n, steps, d = chains.drive.shape
    n_forces = chains.carrier.shape[-1]
    force, error = np.atleast_2d(np.asarray(force, float)), np.atleast_2d(np.asarray(error, float))
    return Noise(
        force,
        error,
        np.full(force.shape, np.inf),
        np.full(error.shape, np.inf),
        np.zeros(n, dtype=int) if law is None else law,
        np.ones((n, steps, n_forces)),
        np.ones((n, steps + 1, d)),
    )


def passed(chains: Chains, noise: Noise, real: Mask, *, covariances: bool = False) -> Estimate:
    """Filter and smooth with a noise, and return the bound there.

    Parameters
    ----------
    chains : Chains
        As each push acts on a joint of its own: here the noise says how they act together.
    noise : Noise
    real : ndarray of bool of shape (n_chains, n_steps)
        Steps that are no padding.
    covariances : bool, default=False
        Whether the states' covariances are wanted.
    """
    force, error = noise.force_variances, noise.error_variances
    mixed = chains.mixed(noise.mixings)
    filtered = kalman_filter(mixed, force, error)
    smoothed = smooth(mixed, filtered, force, error, covariances=covariances)
    bound = filtered.log_likelihood
    bound += _cost_of_scales(noise.force_weights, noise.force_nu, noise.law, real[..., None])
    bound += _cost_of_scales(noise.error_weights, noise.error_nu, noise.law, chains.mask)
    return Estimate(noise, bound, filtered, smoothed)


def estimate_noise(
    chains: Chains,
    noise: Noise,
    real: Mask,
    *,
    floor: Array,
    heavy: bool = True,
    tolerance: float = TOLERANCE,
    held: Mask | None = None,
) -> Estimate:
    """Raise the bound until a pass adds less than a tolerance, each law by itself, and each part of the channels.

    Parameters
    ----------
    chains : Chains
    noise : Noise
        Where to start.
    real : ndarray of bool of shape (n_chains, n_steps)
    floor : ndarray of shape (d,) or (n_laws, d)
        Least variance of each channel's noise, such as that of rounding.
    heavy : bool, default=True
        Whether degrees of freedom are chosen.
    tolerance : float, default=0.1
        In nats.
    held : ndarray of bool of shape (d,), optional
        Channels whose variance was given.

    Returns
    -------
    Estimate
        The last pass has the states' covariances.
    """
    n_laws = len(noise.error)
    floors = np.broadcast_to(np.atleast_2d(floor), noise.error.shape)

    def estimated(chains: Chains, noise: Noise, real: Mask, floor: Array) -> Estimate:
        parts = [
            _estimated(
                chains.part(channels, forces),
                noise.part(channels, forces),
                real,
                floor[channels],
                heavy,
                tolerance,
                None if held is None else held[channels],
            )
            for channels, forces in chains.parts
        ]
        return parts[0] if len(parts) == 1 else _of_parts(chains, noise, parts)

    if n_laws == 1:
        return estimated(chains, noise, real, floors[0])
    members = [np.flatnonzero(noise.law == law) for law in range(n_laws)]
    parts = {
        law: estimated(chains.of(own), noise.alone(law), real[own], floors[law])
        for law, own in enumerate(members)
        if len(own)
    }
    order = np.argsort(np.concatenate(members))
    laws = [parts[law].noise if law in parts else noise.alone(law) for law in range(n_laws)]
    own = {name: np.concatenate([getattr(one, name) for one in laws]) for name in noise.names()}
    mixings = [one.mixing for one in laws if one.mixing is not None]
    whole = Noise(
        **{name: one[order] if "weights" in name else one for name, one in own.items()},
        law=noise.law,
        mixing=np.concatenate(mixings) if mixings else None,
    )
    read = np.stack([chains.mask[own].any(axis=(0, 1)) for own in members])
    return Estimate(
        whole.with_unread(read),
        sum(part.bound for part in parts.values()),
        _joined([part.filtered for part in parts.values()], order),
        _joined([part.smoothed for part in parts.values()], order),
    )


def _of_parts(chains: Chains, noise: Noise, parts: Sequence[Estimate]) -> Estimate:
    """Return the estimates of the parts of chains, which have one law, as one."""

    def filled(name: str) -> Array:
        values: Array = getattr(noise, name).copy()
        for (channels, forces), one in zip(chains.parts, parts):
            values[..., forces if "force" in name else channels] = getattr(one.noise, name)
        return values

    mixing = noise.mixing
    if mixing is not None:
        k = mixing.shape[-1]
        mixing = np.tile(np.eye(k), (len(mixing), 1, 1))
        for (_, forces), one in zip(chains.parts, parts):
            own = forces[forces < k]
            mixing[:, own[:, None], own] = one.noise.mixing
    whole = Noise(**{name: filled(name) for name in noise.names()}, law=noise.law, mixing=mixing)
    return Estimate(
        whole,
        sum(one.bound for one in parts),
        filtered_together(chains, [one.filtered for one in parts]),
        smoothed_together(chains, [one.smoothed for one in parts], whole.force_variances),
    )


def _joined(parts: Sequence[Part], order: Places) -> Part:
    """Return what a pass leaves of some chains and of others as one, in the order of all."""
    names = [one.name for one in fields(parts[0])]  # type: ignore[arg-type]
    return type(parts[0])(
        **{name: np.concatenate([getattr(one, name) for one in parts])[order] for name in names}
    )


def _estimated(
    chains: Chains,
    noise: Noise,
    real: Mask,
    floor: Array,
    heavy: bool,
    tolerance: float,
    held: Mask | None,
) -> Estimate:
    """Raise the bound of chains that have one law."""
    floor = np.maximum(floor, FINEST * chains.prior)
    # Behind a start below the floor no step would be a gain.
    begun = np.maximum(noise.error, floor)
    noise = replace(noise, error=begun if held is None else np.where(held, noise.error, begun))
    best = _begun(chains, noise, real, held)
    look, damping = _look(chains, best, real, floor, held), LEAST_DAMPING
    for _ in range(PASSES):
        try:
            proposed = _moved(chains, best, real, look.step(damping), floor, heavy, held)
            tried = passed(chains, proposed, real)
        except np.linalg.LinAlgError:  # too far for rounding
            gain = -np.inf
        else:
            gain = tried.bound - best.bound
        if not gain > 0:
            if damping > 1:
                break
            damping *= DAMPED
            continue
        best = tried
        if gain < tolerance:
            break
        look, damping = _look(chains, best, real, floor, held), max(damping / DAMPED, LEAST_DAMPING)
    force, error = best.noise.force_variances, best.noise.error_variances
    mixed = chains.mixed(best.noise.mixings)
    return replace(best, smoothed=smooth(mixed, best.filtered, force, error))


def _begun(chains: Chains, noise: Noise, real: Mask, held: Mask | None) -> Estimate:
    """Return the pass at a start, or at one with so much more noise of the sensors that rounding lets a filter run."""
    free = (noise.error < chains.prior) & ~np.asarray(False if held is None else held)
    try:
        return passed(chains, noise, real)
    except np.linalg.LinAlgError:
        if not free.any():
            raise
        more = np.minimum(noise.error * np.exp(FURTHEST), chains.prior)
        return _begun(chains, replace(noise, error=np.where(free, more, noise.error)), real, held)


@dataclass(frozen=True)
class _Look:
    """The bound about a noise, by the logarithms of variances of forces and errors, then by shares; see `_moved`.

    Attributes
    ----------
    slopes, damping : ndarray of shape (p,)
        The latter is curvature enough for a step in each alone.
    information : ndarray of shape (p, p)
    longest : ndarray of shape (p,)
    """

    slopes: Array
    information: Array
    damping: Array
    longest: Array

    def step(self, damping: float) -> Array:
        """Return the step of Levenberg and Marquardt."""
        curvature = self.information + np.diag(damping * self.damping)
        sizes = np.sqrt(np.maximum(np.diag(curvature), SMALLEST))
        step = np.linalg.lstsq(curvature / sizes / sizes[:, None], self.slopes / sizes, rcond=None)[0] / sizes
        return np.clip(step, -self.longest, self.longest)


def _look(chains: Chains, last: Estimate, real: Mask, floor: Array, held: Mask | None) -> _Look:
    """Return the bound about an estimate. What is held, or would go below its floor, does not move."""
    noise, smoothed = last.noise, last.smoothed
    force, error = noise.force_variances, noise.error_variances
    # Those before a chain are of the variances of its first step.
    forces = np.concatenate([smoothed.forces, smoothed.force_first], axis=1)
    information = np.concatenate([smoothed.force_information, smoothed.force_first_information], axis=1)
    prior = np.concatenate([force, force[:, :1]], axis=1)
    known = prior * np.diagonal(information, axis1=2, axis2=3)
    acting = np.pad(real[..., None], [(0, 0), (0, 1), (0, 0)], constant_values=True)
    laws = [
        _of_variances(forces, known, prior, acting),
        _of_variances(smoothed.errors, smoothed.error_known, error, chains.mask),
    ]
    slopes, damping, scale = map(np.concatenate, zip(*laws))
    longest = np.full(len(slopes), FURTHEST)
    k = 0 if noise.mixing is None else noise.mixing.shape[-1]
    information = average_information(chains.mixed(noise.mixings), last.filtered, smoothed, force, k)
    if k:
        blocks = [slice(first, first + k) for first in range(0, force.shape[-1], k)]
        scores = sum(smoothed.force_scores[:, 0, own, own].sum(axis=0) for own in blocks)
        below = np.tril_indices(k, -1)
        sizes = np.sqrt(np.maximum(noise.force[0].reshape(-1, k).sum(axis=0), SMALLEST))
        slopes = np.r_[slopes, scores[below]]
        damping = np.r_[damping, np.diag(information)[len(damping) :]]
        scale = np.r_[scale, np.ones(len(below[0]))]
        # As a correlation no share moves by more than one.
        longest = np.r_[longest, (sizes[:, None] / sizes)[below]]
    fixed = (noise.error[0] <= floor) & (laws[1][0] < 0) | (False if held is None else held)
    moves = np.ones(len(slopes), dtype=bool)
    moves[force.shape[-1] :][: len(fixed)] = ~fixed
    scale = np.where(moves, scale, 0.0)
    return _Look(np.where(moves, slopes, 0.0), information * scale * scale[:, None], damping, longest)


def _of_variances(means: Array, known: Array, prior: Array, present: Mask) -> tuple[Array, Array, Array]:
    """Return slopes by logarithms of variances, the curvature with which a step is the ratio of [1]_, and a scale.

    By that of the information: where a variance alone says what is left, a step is then that ratio, too, far from it.
    """
    top = np.sum(np.where(present, means**2 / prior, 0.0), axis=(0, 1))
    bottom = np.sum(np.where(present, known, 0.0), axis=(0, 1))
    told = (bottom > SMALLEST) & (top > SMALLEST)
    top, bottom = np.where(told, top, 1.0), np.where(told, bottom, 1.0)
    apart = np.log(top / bottom)
    far = np.abs(apart) > 1e-6
    curvature = np.where(far, (top - bottom) / np.where(far, apart, 1.0), bottom)
    return (top - bottom) / 2, curvature / 2, np.sqrt(curvature / top)


def _moved(
    chains: Chains, last: Estimate, real: Mask, steps: Array, floor: Array, heavy: bool, held: Mask | None
) -> Noise:
    """Return the noise whose variances are moved by steps on their logarithm, with the best scales of samples there."""
    noise, smoothed = last.noise, last.smoothed
    force_squares, error_squares = expected_squares(smoothed)
    k, n = noise.force.shape[1], noise.force.shape[1] + noise.error.shape[1]
    force = np.maximum(noise.force * np.exp(steps[:k]), 1e-30)
    error = np.maximum(noise.error * np.exp(steps[k:n]), floor)
    if noise.mixing is not None:
        step = np.eye(noise.mixing.shape[-1])
        step[np.tril_indices(len(step), -1)] = steps[n:]
        noise = replace(noise, mixing=noise.mixing @ step)
    if held is not None:
        error = np.where(held, noise.error, error)
    if not heavy:
        return replace(noise, force=force, error=error)
    force_nu, force_weights = _scales(
        force_squares, force[0], np.broadcast_to(real[..., None], force_squares.shape)
    )
    error_nu, error_weights = _scales(error_squares, error[0], chains.mask)
    if held is not None:  # A noise that is known has no outliers: what lies beyond it is the model's.
        error_nu, error_weights = np.where(held, np.inf, error_nu), np.where(held, 1.0, error_weights)
    weights = force_weights, error_weights
    return Noise(force, error, force_nu[None], error_nu[None], noise.law, *weights, noise.mixing)


def variances_of(scale: Array, nu: Array) -> Array:
    """Return the variances of Student's laws of squared scales."""
    return scale * _spread_by(nu)


def scales_of(variances: Array, nu: Array) -> Array:
    """Return the squared scales of Student's laws of variances."""
    return variances / _spread_by(nu)


def _spread_by(nu: Array) -> Array:
    """Return the variances of Student's laws of scale one."""
    heavy = np.isfinite(nu)
    return np.where(heavy, nu / np.where(heavy, nu - 2, 1.0), 1.0)


def expected_squares(smoothed: Smoothed) -> tuple[Array, Array]:
    """Return the expected squares of forces and of errors, none of which rounding puts below zero."""
    force: Array = np.maximum(smoothed.forces**2 + smoothed.force_variances, 0.0)
    error: Array = np.maximum(smoothed.errors**2 + smoothed.error_variances, 0.0)
    return force, error


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
        bounds.append(np.where(seen, student_log_density(flat, scale, nu), 0.0).sum(axis=0))
    nus[there] = np.array(DEGREES_OF_FREEDOM)[np.argmax(bounds, axis=0)][there]
    return nus, precisions(squares, variance, nus, present)


def precisions(squares: Array, scale: Array, nu: Array, present: Mask) -> Array:
    """Return the expected precision of each sample, in units of 1 / scale; 1 where there is none."""
    heavy = np.isfinite(nu)
    nu, scale = np.where(heavy, nu, 1.0), np.where(heavy, scale, 1.0)
    return np.where(heavy & present, (nu + 1) / (nu + squares / scale), 1.0)


def _best_scales(squares: Array, seen: Mask, start: Array, nu: float) -> Array:
    """Return the likeliest squared scale of each column of squares (n, k)."""
    # Of a log that a model repeats exactly nothing is left.
    counts, squares = np.maximum(seen.sum(axis=0), 1), np.where(seen, squares, 0.0)
    if np.isinf(nu):
        mean: Array = squares.sum(axis=0) / counts
        return np.maximum(mean, SMALLEST)
    scale = np.maximum(start, SMALLEST)
    for _ in range(8):
        shares = (nu + 1) / (nu + squares / scale) * squares
        scale = np.maximum(shares.sum(axis=0) / counts, SMALLEST)
    return scale


def _cost_of_scales(weights: Array, nus: Array, law: Places, present: Mask) -> float:
    """Return what the bound has beside the normal likelihood at the expected precisions."""
    cost = 0.0
    present = np.broadcast_to(present, weights.shape)
    for one, column in np.argwhere(np.isfinite(nus)):
        nu, own = nus[one, column], law == one
        mean = weights[own][..., column][present[own][..., column]]
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
