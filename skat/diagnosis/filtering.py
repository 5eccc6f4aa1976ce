r"""Kalman filter and disturbance smoother of many short chains at once: pure functions of arrays.

Everything is linear in c and m, so that derivatives by parameters are further columns of c that run through the same
gains. Parts of chains are filtered apart.

References
----------
.. [1] Durbin, Koopman (2012). Time Series Analysis by State Space Methods, chapters 4.3 to 4.5.
.. [2] Gilmour, Thompson, Cullis (1995). Average information REML. Biometrics 51(4).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtri
from scipy.special import gammaln

from skat.diagnosis.chains import Array, Chains, Places, block

# A variance that is not there.
SMALLEST = 1e-300


@dataclass(frozen=True)
class Filtered:
    """What a pass of the filter leaves.

    Attributes
    ----------
    log_likelihoods : ndarray of shape (n_chains,)
        Gaussian, of what was measured.
    means : ndarray of shape (n_chains, n_steps + 1, d)
        Predicted deviations.
    covariances : ndarray of shape (n_chains, n_steps + 1, d, d)
    innovations : ndarray of shape (n_chains, n_steps + 1, d)
    gains : ndarray of shape (n_chains, n_steps + 1, d, d)
        By which an innovation moves the mean of the state at the same time.
    factors : ndarray of shape (n_chains, n_steps + 1, d, d)
        W with W' W the inverse covariances of innovations, zero where nothing was measured: whitens them.
    """

    log_likelihoods: Array
    means: Array
    covariances: Array
    innovations: Array
    gains: Array
    factors: Array

    def part(self, channels: Places) -> "Filtered":
        """Return what a pass leaves of some channels."""
        others = [getattr(self, one.name) for one in fields(self)[1:]]
        own = (one[..., channels] if one.ndim == 3 else block(one, channels) for one in others)
        return Filtered(self.log_likelihoods, *own)

    @property
    def log_likelihood(self) -> float:
        """Of all chains."""
        return float(self.log_likelihoods.sum())

    @property
    def whitened(self) -> Array:
        """Innovations of unit variance, uncorrelated."""
        return (self.factors @ self.innovations[..., None])[..., 0]


def updated(chains: Chains, filtered: Filtered, error_variances: Array) -> tuple[Array, Array]:
    """Return means and covariances of the deviations given what was measured until then, the same instant with it.

    Parameters
    ----------
    chains : Chains
    filtered : Filtered
    error_variances : ndarray of shape (n_chains, n_steps + 1, d)
        Those that the filter ran with.

    Returns
    -------
    means : ndarray of shape (n_chains, n_steps + 1, d)
    covariances : ndarray of shape (n_chains, n_steps + 1, d, d)
    """
    means = filtered.means + (filtered.gains @ filtered.innovations[..., None])[..., 0]
    own = np.where(chains.mask, error_variances, 0.0)
    covariances = []
    for channels, _ in chains.parts:
        gains, P = block(filtered.gains, channels), block(filtered.covariances, channels)
        kept = np.eye(len(channels)) - gains
        read = (gains * own[:, :, None, channels]) @ gains.swapaxes(2, 3)
        covariances.append(kept @ P @ kept.swapaxes(2, 3) + read)
    return means, together([channels for channels, _ in chains.parts], covariances, chains.drive.shape[-1])


@dataclass(frozen=True)
class Smoothed:
    """States and disturbances given all measurements.

    Attributes
    ----------
    means, covariances : ndarray of shape (n_chains, n_steps + 1, d), (..., d, d)
        Of the deviations.
    forces, force_variances : ndarray of shape (n_chains, n_steps, n_forces)
        Of w.
    errors, error_variances : ndarray of shape (n_chains, n_steps + 1, d)
        Of e; zero and the prior variance where nothing was measured.
    force_information : ndarray of shape (n_chains, n_steps, n_forces, n_forces)
        Of what was measured, on the forces of a step: q less q times this times q is their covariance.
    error_known : ndarray of shape (n_chains, n_steps + 1, d)
        Share of the prior variance of each error that measurements take away.
    force_first, force_first_information : ndarray of shape (n_chains, 1, n_forces), (..., n_forces, n_forces)
        Of the forces before a chain that enter its first state.
    force_scores : ndarray of shape (n_chains, 1, n_forces, n_forces)
        Slope of the log likelihood by the share of the force of each column that acts in the place of that of each row
        as well.
    """

    means: Array
    covariances: Array
    forces: Array
    force_variances: Array
    errors: Array
    error_variances: Array
    force_information: Array
    error_known: Array
    force_first: Array
    force_first_information: Array
    force_scores: Array


def kalman_filter(chains: Chains, force_variances: Array, error_variances: Array) -> Filtered:
    """Run the filter.

    Parameters
    ----------
    chains : Chains
    force_variances : ndarray of shape (n_chains, n_steps, n_forces)
    error_variances : ndarray of shape (n_chains, n_steps + 1, d)

    Returns
    -------
    Filtered
    """
    if len(chains.parts) == 1:
        return _filtered(chains, force_variances, error_variances)
    return filtered_together(
        chains,
        [
            _filtered(
                chains.part(channels, forces), force_variances[..., forces], error_variances[..., channels]
            )
            for channels, forces in chains.parts
        ],
    )


def filtered_together(chains: Chains, parts: Sequence[Filtered]) -> Filtered:
    """Return the passes over the parts of chains as one."""
    places = [channels for channels, _ in chains.parts]
    log_likelihoods: Array = np.sum([one.log_likelihoods for one in parts], axis=0)
    others = [one.name for one in fields(Filtered)[1:]]
    return Filtered(
        log_likelihoods,
        *(together(places, [getattr(one, name) for one in parts], chains.drive.shape[-1]) for name in others),
    )


def _filtered(chains: Chains, force_variances: Array, error_variances: Array) -> Filtered:
    """Run the filter over channels that may all act on each other."""
    n, steps, d = chains.drive.shape
    F, A = chains.carrier, chains.transitions
    spread = (F * force_variances[:, :, None]) @ F.swapaxes(2, 3) + chains.bends
    # What was never measured, such as a force with memory, is in no innovation.
    read = _measured(chains)
    m = len(read)
    mask, variances, measured = chains.mask[..., read], error_variances[..., read], chains.measured[..., read]
    means, covariances = np.zeros((n, steps + 1, d)), np.zeros((n, steps + 1, d, d))
    innovations, gains = np.zeros((n, steps + 1, m)), np.zeros((n, steps + 1, d, m))
    factors, scales = (np.zeros((n, steps + 1, m, m)) for _ in range(2))
    both = (mask[..., :, None] & mask[..., None, :]).astype(np.float64)
    own = np.where(mask, variances, 0.0)
    padded = np.where(mask, variances, 1.0)[..., None] * np.eye(m)
    seen = mask.astype(np.float64)
    mean, P = np.zeros((n, d)), np.tile(np.diag(chains.prior), (n, 1, 1))
    if chains.before is not None:
        P = P + (chains.before * force_variances[:, 0, None]) @ chains.before.swapaxes(1, 2)
    diagonal = np.arange(m)
    for t in range(steps + 1):
        means[:, t], covariances[:, t] = mean, P
        across = P if m == d else P[:, :, read]
        L = np.linalg.cholesky((across if m == d else across[:, read]) * both[:, t] + padded[:, t])
        W = _inverses(L) * seen[:, t, None, :]
        K = across @ W.swapaxes(1, 2) @ W
        innovation = (measured[:, t] - mean[:, read]) * seen[:, t]
        innovations[:, t], gains[:, t], factors[:, t], scales[:, t] = innovation, K, W, L
        if t == steps:
            break
        # The form that keeps a covariance positive where the noise is small against what was not known before.
        AK = A[:, t] @ K
        if m == d:
            M = A[:, t] - AK
        else:
            M = A[:, t].copy()
            M[:, :, read] -= AK
        P = M @ P @ M.swapaxes(1, 2) + (AK * own[:, t, None]) @ AK.swapaxes(1, 2) + spread[:, t]
        P = (P + P.swapaxes(1, 2)) / 2
        mean = (A[:, t] @ mean[..., None] + AK @ innovation[..., None])[..., 0] + chains.drive[:, t]
    whitened = (factors @ innovations[..., None])[..., 0]
    log_determinants = 2 * np.log(scales[..., diagonal, diagonal]).sum(axis=(1, 2))
    constants = mask.sum(axis=(1, 2)) * np.log(2 * np.pi)
    log_likelihoods = -0.5 * (np.sum(whitened**2, axis=(1, 2)) + log_determinants + constants)
    if m < d:
        innovations = _spread_out(innovations, read, (n, steps + 1, d))
        gains = _spread_out(gains, read, (n, steps + 1, d, d))
        rows = _spread_out(factors.swapaxes(2, 3), read, (n, steps + 1, m, d))
        factors = _spread_out(rows.swapaxes(2, 3), read, (n, steps + 1, d, d))
    return Filtered(log_likelihoods, means, covariances, innovations, gains, factors)


def _inverses(roots: NDArray[Any]) -> Array:
    """Return the inverses of lower triangular matrices: to solve for them as for any takes three times as long."""
    inverses: Array = roots.copy()
    for one in inverses:
        dtrtri(one.T, overwrite_c=1)
    return inverses


def together(places: Sequence[Places], parts: Sequence[Array], size: int) -> Array:
    """Return vectors, or square matrices, of parts as those of all: zero between parts.

    Parameters
    ----------
    places : sequence of ndarray of int
        Of each part's channels, or forces, among all.
    parts : sequence of ndarray of shape (n, n_steps, n_channels) or (n, n_steps, n_channels, n_channels)
    size : int
        How many there are in all.
    """
    n, steps, *own = parts[0].shape
    out = np.zeros((n, steps, *(size,) * len(own)))
    for where, values in zip(places, parts):
        out[(..., where) if len(own) == 1 else (..., where[:, None], where)] = values
    return out


def _measured(chains: Chains) -> Places:
    """Return the channels of which anything was measured."""
    return np.flatnonzero(chains.mask.any(axis=(0, 1)))


def _spread_out(values: Array, places: Places, shape: tuple[int, ...]) -> Array:
    """Return values at some places of the last axis, and zeros at the others."""
    out = np.zeros(shape)
    out[..., places] = values
    return out


def filter_columns(chains: Chains, filtered: Filtered, columns: Array) -> Array:
    """Return by how much the whitened innovations fall with each column of drive.

    Parameters
    ----------
    chains : Chains
    filtered : Filtered
        A pass of the filter over these chains.
    columns : ndarray of shape (n_chains, n_steps, d, k)
        What the model adds to the deviation in a step, by unit of each parameter.

    Returns
    -------
    ndarray of shape (n_chains, n_steps + 1, d, k)
        N: whitened innovations at the values theta are those at zero minus N theta.
    """
    n, steps, d, k = columns.shape
    out = np.zeros((n, steps + 1, d, k))
    for channels, forces in chains.parts:
        own = columns[:, :, channels]
        acting = np.flatnonzero(own.any(axis=(0, 1, 2)))
        part = chains.part(channels, forces), filtered.part(channels), own[..., acting]
        out[:, :, channels[:, None], acting] = _filtered_columns(*part)
    return out


def _filtered_columns(chains: Chains, filtered: Filtered, columns: Array) -> Array:
    """Return what `filter_columns` does, of channels that may all act on each other."""
    n, steps, d, k = columns.shape
    out = np.zeros((n, steps + 1, d, k))
    mean = np.zeros((n, d, k))
    read = _measured(chains)
    factors, gains = filtered.factors[:, :, read[:, None], read], filtered.gains[..., read]
    for t in range(1, steps + 1):
        mean = chains.transitions[:, t - 1] @ mean + columns[:, t - 1]
        out[:, t, read] = factors[:, t] @ mean[:, read]
        mean = mean - gains[:, t] @ mean[:, read]
    return out


def smooth(
    chains: Chains,
    filtered: Filtered,
    force_variances: Array,
    error_variances: Array,
    *,
    covariances: bool = True,
) -> Smoothed:
    """Return states, forces and errors given all measurements.

    Parameters
    ----------
    chains, filtered
    force_variances, error_variances
        Those that the filter ran with.
    covariances : bool, default=True
        Whether the states' covariances are wanted; zeros otherwise.
    """
    if len(chains.parts) == 1:
        return _smoothed(chains, filtered, force_variances, error_variances, covariances)
    return smoothed_together(
        chains,
        [
            _smoothed(
                chains.part(channels, forces),
                filtered.part(channels),
                force_variances[..., forces],
                error_variances[..., channels],
                covariances,
            )
            for channels, forces in chains.parts
        ],
        force_variances,
    )


def smoothed_together(chains: Chains, parts: Sequence[Smoothed], force_variances: Array) -> Smoothed:
    """Return what is known of the parts of chains as one, and of a force that moves nothing its variance."""
    channels, forces = zip(*chains.parts)
    d, k = chains.carrier.shape[-2:]

    def whole(name: str) -> Array:
        places, size = (forces, k) if name.startswith("force") else (channels, d)
        return together(places, [getattr(one, name) for one in parts], size)

    smoothed = Smoothed(*(whole(one.name) for one in fields(Smoothed)))
    idle = np.setdiff1d(np.arange(k), np.concatenate(forces))
    smoothed.force_variances[..., idle] = force_variances[..., idle]
    return smoothed


def _smoothed(
    chains: Chains, filtered: Filtered, force_variances: Array, error_variances: Array, covariances: bool
) -> Smoothed:
    """Return what `smooth` does, of channels that may all act on each other."""
    n, steps, d = chains.drive.shape
    F, P, read = chains.carrier, filtered.covariances, _measured(chains)
    G = filtered.gains[..., read]
    back = np.zeros((n, steps + 1, d, d))
    back[:, :-1] = chains.transitions.swapaxes(2, 3)
    precisions = filtered.factors.swapaxes(2, 3) @ filtered.factors
    weighed = (precisions @ filtered.innovations[..., None])[..., 0]
    # What later measurements say of the state before and after the one at t: a gradient and its information.
    r, N = np.zeros((n, d)), np.zeros((n, d, d))
    before, information = np.empty((n, steps + 1, d)), np.empty((n, steps + 1, d, d))
    after, later = np.empty((n, steps + 1, d)), np.empty((n, steps + 1, d, d))
    for t in range(steps, -1, -1):
        after[:, t], later[:, t] = r, N
        B, gained = back[:, t].copy(), G[:, t].swapaxes(1, 2)
        B[:, read] -= gained @ back[:, t]
        r = weighed[:, t] + (B @ r[..., None])[..., 0]
        N = precisions[:, t] + B @ N @ B.swapaxes(1, 2)
        before[:, t], information[:, t] = r, N
    q = force_variances
    u, D = _scores(F, after[:, :-1], later[:, :-1])
    forces, force_spreads = q * u, q - q**2 * np.diagonal(D, axis1=2, axis2=3)
    scores, first, of_first = _of_shares(u, D, q), np.zeros_like(q[:, :1]), np.zeros_like(D[:, :1])
    if chains.before is not None:
        u, of_first = _scores(chains.before[:, None], before[:, :1], information[:, :1])
        scores, first = scores + _of_shares(u, of_first, q[:, :1]), q[:, :1] * u
    r_of_noise = error_variances[..., read]
    ahead = np.zeros(G.shape)
    ahead[:, :-1] = chains.transitions @ G[:, :-1]
    errors, error_spreads = np.zeros(error_variances.shape), error_variances.copy()
    errors[..., read] = r_of_noise * (weighed[..., read] - (ahead.swapaxes(2, 3) @ after[..., None])[..., 0])
    of_errors = np.diagonal(precisions, axis1=2, axis2=3)[..., read] + np.sum(ahead * (later @ ahead), axis=2)
    errors_known = np.zeros(error_variances.shape)
    errors_known[..., read] = r_of_noise * of_errors
    error_spreads -= error_variances * errors_known
    means = filtered.means + (P @ before[..., None])[..., 0]
    spreads = P - P @ information @ P if covariances else np.zeros((n, steps + 1, d, d))
    own = forces, force_spreads, errors, error_spreads, D, errors_known
    return Smoothed(means, spreads, *own, first, of_first, scores)


def _scores(F: Array, r: Array, N: Array) -> tuple[Array, Array]:
    """Return gradients by forces and their information, of those by the states that they enter."""
    across = F.swapaxes(2, 3)
    return (across @ r[..., None])[..., 0], across @ N @ F


def _of_shares(u: Array, D: Array, q: Array) -> Array:
    """Return slopes by shares of forces, of each chain; see `Smoothed`."""
    scores: Array = np.einsum("nti,ntj->nij", u, u * q) - np.einsum("ntij,ntj->nij", D, q)
    return scores[:, None]


def average_information(
    chains: Chains, filtered: Filtered, smoothed: Smoothed, force_variances: Array, n_mixed: int = 0
) -> Array:
    """Return the mean of the observed and of the expected information on the laws of forces and errors [2]_.

    It is half the product of what the innovations say of each: of a variance, how they answer to the force, or to the
    error, that the smoother finds.

    Parameters
    ----------
    chains, filtered, smoothed, force_variances
        Chains whose channels may all act on each other, and a pass over them.
    n_mixed : int, default=0
        Of so many forces shares act in the place of those before, too, as they do of as many forces of memory.

    Returns
    -------
    ndarray of shape (p, p)
        On the logarithm of the variance of each force and of each channel's error, and on the shares below the
        diagonal, row by row.
    """
    n, steps, d = chains.drive.shape
    read, n_forces = _measured(chains), chains.carrier.shape[-1]
    found, q = smoothed.forces, np.maximum(force_variances, SMALLEST)
    to, of = np.tril_indices(n_mixed, -1)
    # Shares are of forces and of those of memory alike.
    shares = [(to + first, of + first) for first in range(0, n_forces if n_mixed else 0, max(n_mixed, 1))]
    pairs = slice(n_forces + d, None)

    def pushed(carrier: Array, w: Array, q: Array) -> Array:
        out = np.zeros((n, d, n_forces + d + len(to)))
        out[..., :n_forces] = carrier * w[:, None]
        for i, j in shares:
            out[..., pairs] += carrier[..., i] * w[:, None, j]
            out[..., pairs] += carrier[..., j] * (q[:, j] * w[:, i] / q[:, i])[:, None]
        return out

    moved = np.zeros((n, d, n_forces + d + len(to)))
    if chains.before is not None:
        moved = pushed(chains.before, smoothed.force_first[:, 0], q[:, 0])
    information = np.zeros((moved.shape[-1], moved.shape[-1]))
    factors, gains = filtered.factors[:, :, read[:, None], read], filtered.gains[..., read]
    errors = np.where(chains.mask, smoothed.errors, 0.0)[..., read]
    for t in range(steps + 1):
        seen = moved[:, read]
        seen[:, np.arange(len(read)), n_forces + read] += errors[:, t]
        white = (factors[:, t] @ seen).reshape(-1, len(information))
        information += white.T @ white / 2
        if t < steps:
            moved = chains.transitions[:, t] @ (moved - gains[:, t] @ seen)
            moved += pushed(chains.carrier[:, t], found[:, t], q[:, t])
    return information


def student_log_density(squares: Array, variance: Array | float, nu: float) -> Array:
    r"""Return the log density of Student's t with the square of its argument replaced by an expectation.

    It is what :math:`E[\ln N(e; 0, r/\lambda)] + E[\ln p(\lambda)] + H[q(\lambda)]` comes to at the best
    :math:`q(\lambda)`; for nu = inf, E[ln N(e; 0, r)].
    """
    if np.isinf(nu):
        return -0.5 * (np.log(2 * np.pi * variance) + squares / variance)
    constant = gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * np.log(nu * np.pi * variance)
    expected: Array = constant - (nu + 1) / 2 * np.log1p(squares / (nu * variance))
    return expected
