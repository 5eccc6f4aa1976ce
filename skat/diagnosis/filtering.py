r"""Kalman filter and disturbance smoother of many short chains at once: pure functions of arrays.

A chain is a piece of an episode. About a path, its deviations follow

.. math::

    \delta_{t+1} = A_t \delta_t + c_t + F_t w_t + v_t, \qquad m_t = H_t \delta_t + e_t,

with :math:`w_t \sim N(0, \mathrm{diag}(q_t))`, :math:`e_t \sim N(0, \mathrm{diag}(r_t))` and
:math:`v_t \sim N(0, \Omega_t)`, what the linearisation leaves. A channel that was not measured is a row that
:math:`H_t` lacks. The first state of a chain has a wide prior. Everything is linear in c and m, so that derivatives by
parameters are further columns of c that run through the same gains.

References
----------
.. [1] Durbin, Koopman (2012). Time Series Analysis by State Space Methods, chapters 4.3 to 4.5.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Chains:
    """Linear dynamics and measurements of chains, padded to the longest one.

    Attributes
    ----------
    transitions : ndarray of shape (n_chains, n_steps, d, d)
    drive : ndarray of shape (n_chains, n_steps, d)
        c, what the model adds to the deviation in a step.
    bends : ndarray of shape (n_chains, n_steps, d, d)
        Covariance of what the linearisation leaves.
    carrier : ndarray of shape (n_chains, n_steps, d, n_forces)
        F, by which random forces enter the state.
    measured : ndarray of shape (n_chains, n_steps + 1, d)
        m; any number where nothing was measured.
    mask : ndarray of bool of shape (n_chains, n_steps + 1, d)
    prior : ndarray of shape (d,)
        Variance of a chain's first state about the path.
    """

    transitions: Array
    drive: Array
    bends: Array
    carrier: Array
    measured: Array
    mask: Mask
    prior: Array

    def with_memory(self, shares: Array, prior: Array) -> "Chains":
        """Return these chains with a force of memory beside each random force, as further, hidden channels.

        Parameters
        ----------
        shares : ndarray of shape (n_forces,)
            What is left of such a force a step later: g[t+1] = share g[t] + w[t].
        prior : ndarray of shape (n_forces,)
            Variance of each such force where a chain begins.
        """
        n, steps, d = self.drive.shape
        k = self.carrier.shape[-1]
        transitions = np.zeros((n, steps, d + k, d + k))
        transitions[..., :d, :d], transitions[..., :d, d:] = self.transitions, self.carrier
        transitions[..., d:, d:] = np.diag(shares)
        carrier = np.zeros((n, steps, d + k, 2 * k))
        carrier[..., :d, :k] = self.carrier
        carrier[..., d:, k:] = np.eye(k)
        bends = np.zeros((n, steps, d + k, d + k))
        bends[..., :d, :d] = self.bends
        wide = [(0, 0), (0, 0), (0, k)]
        return Chains(
            transitions,
            np.pad(self.drive, wide),
            bends,
            carrier,
            np.pad(self.measured, wide),
            np.pad(self.mask, wide),
            np.r_[self.prior, prior],
        )

    @property
    def n_measured(self) -> int:
        """Number of values that were measured."""
        return int(self.mask.sum())


@dataclass(frozen=True)
class Filtered:
    """What a pass of the filter leaves.

    Attributes
    ----------
    log_likelihood : float
        Gaussian, of what was measured.
    means : ndarray of shape (n_chains, n_steps + 1, d)
        Predicted deviations.
    covariances : ndarray of shape (n_chains, n_steps + 1, d, d)
    innovations : ndarray of shape (n_chains, n_steps + 1, d)
    precisions : ndarray of shape (n_chains, n_steps + 1, d, d)
        Inverse covariances of the innovations, zero in rows and columns that were not measured.
    gains : ndarray of shape (n_chains, n_steps + 1, d, d)
        By which an innovation moves the mean of the state at the same time.
    factors : ndarray of shape (n_chains, n_steps + 1, d, d)
        W with W' W = precisions: whitens innovations.
    """

    log_likelihood: float
    means: Array
    covariances: Array
    innovations: Array
    precisions: Array
    gains: Array
    factors: Array

    @property
    def whitened(self) -> Array:
        """Innovations of unit variance, uncorrelated."""
        return np.einsum("ctij,ctj->cti", self.factors, self.innovations)


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
    """

    means: Array
    covariances: Array
    forces: Array
    force_variances: Array
    errors: Array
    error_variances: Array


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
    n, steps, d = chains.drive.shape
    F = chains.carrier
    spread = (F * force_variances[:, :, None]) @ F.swapaxes(2, 3) + chains.bends
    means = np.zeros((n, steps + 1, d))
    covariances = np.empty((n, steps + 1, d, d))
    precisions, gains, factors = (np.zeros((n, steps + 1, d, d)) for _ in range(3))
    innovations = np.zeros((n, steps + 1, d))
    mean, P = np.zeros((n, d)), np.tile(np.diag(chains.prior), (n, 1, 1))
    diagonal = np.arange(d)
    log_determinant = 0.0
    for t in range(steps + 1):
        seen = chains.mask[:, t]
        means[:, t], covariances[:, t] = mean, P
        both = seen[:, :, None] & seen[:, None, :]
        S = np.where(both, P, 0.0)
        S[:, diagonal, diagonal] += np.where(seen, error_variances[:, t], 1.0)
        L = np.linalg.cholesky(S)
        W = _inverse_factor(L) * seen[:, None, :]
        log_determinant += float(2 * np.log(L[:, diagonal, diagonal]).sum())
        precision = W.swapaxes(1, 2) @ W
        K = P @ precision
        innovation = np.where(seen, chains.measured[:, t] - mean, 0.0)
        innovations[:, t], precisions[:, t], gains[:, t], factors[:, t] = innovation, precision, K, W
        mean = mean + np.einsum("nij,nj->ni", K, innovation)
        if t == steps:
            break
        # The form that keeps a covariance positive where the noise is small against what was not known before.
        kept = np.eye(d) - K
        P = kept @ P @ kept.swapaxes(1, 2) + (K * np.where(seen, error_variances[:, t], 0.0)[:, None]) @ (
            K.swapaxes(1, 2)
        )
        A = chains.transitions[:, t]
        mean = np.einsum("nij,nj->ni", A, mean) + chains.drive[:, t]
        P = A @ P @ A.swapaxes(1, 2) + spread[:, t]
        P = (P + P.swapaxes(1, 2)) / 2
    squares = float(np.einsum("cti,ctij,ctj->", innovations, precisions, innovations))
    log_likelihood = -0.5 * (squares + log_determinant + chains.n_measured * np.log(2 * np.pi))
    return Filtered(log_likelihood, means, covariances, innovations, precisions, gains, factors)


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
    mean = np.zeros((n, d, k))
    for t in range(1, steps + 1):
        mean = chains.transitions[:, t - 1] @ mean + columns[:, t - 1]
        out[:, t] = filtered.factors[:, t] @ mean
        mean = mean - filtered.gains[:, t] @ mean
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
    n, steps, d = chains.drive.shape
    F, P = chains.carrier, filtered.covariances
    means = np.empty((n, steps + 1, d))
    spreads = np.zeros((n, steps + 1, d, d))
    forces, force_spreads = np.empty(force_variances.shape), np.empty(force_variances.shape)
    errors, error_spreads = np.empty((n, steps + 1, d)), np.empty((n, steps + 1, d))
    r, N = np.zeros((n, d)), np.zeros((n, d, d))
    for t in range(steps, -1, -1):
        precision, gain, innovation = (
            filtered.precisions[:, t],
            filtered.gains[:, t],
            filtered.innovations[:, t],
        )
        if t < steps:
            q = force_variances[:, t]
            forces[:, t] = q * np.einsum("nj,njf->nf", r, F[:, t])
            force_spreads[:, t] = q - q**2 * np.einsum("njf,njk,nkf->nf", F[:, t], N, F[:, t], optimize=True)
            A = chains.transitions[:, t]
            r = np.einsum("nji,nj->ni", A, r)
            N = A.swapaxes(1, 2) @ N @ A
        noise = error_variances[:, t]
        u = np.einsum("nij,nj->ni", precision, innovation) - np.einsum("nji,nj->ni", gain, r)
        D = precision + gain.swapaxes(1, 2) @ N @ gain
        errors[:, t] = noise * u
        error_spreads[:, t] = noise - noise**2 * np.einsum("nii->ni", D)
        # Information that the measurement at t adds to that of later times.
        r = r + u
        kept = np.eye(d) - gain
        N = precision + kept.swapaxes(1, 2) @ N @ kept
        means[:, t] = filtered.means[:, t] + np.einsum("nij,nj->ni", P[:, t], r)
        if covariances:
            spreads[:, t] = P[:, t] - P[:, t] @ N @ P[:, t]
    return Smoothed(means, spreads, forces, force_spreads, errors, error_spreads)


def student_log_density(squares: Array, variance: Array | float, nu: float) -> Array:
    r"""Return the log density of Student's t with the square of its argument replaced by an expectation.

    It is what :math:`E[\ln N(e; 0, r/\lambda)] + E[\ln p(\lambda)] + H[q(\lambda)]` comes to at the best
    :math:`q(\lambda)`; for nu = inf, E[ln N(e; 0, r)].
    """
    if np.isinf(nu):
        return -0.5 * (np.log(2 * np.pi * variance) + squares / variance)
    constant = gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * np.log(nu * np.pi * variance)
    return constant - (nu + 1) / 2 * np.log1p(squares / (nu * variance))


def _inverse_factor(L: Array) -> Array:
    """Return the inverses of lower triangular matrices."""
    return np.asarray(np.linalg.solve(L, np.broadcast_to(np.eye(L.shape[-1]), L.shape)), dtype=np.float64)
