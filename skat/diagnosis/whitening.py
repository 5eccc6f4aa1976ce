r"""Noise of a measured state, seen through a simulation: whitening, smoothing and estimating it.

A measured state is :math:`s_t = x_t + e_t` with :math:`e_t \sim (0, R)`, R diagonal. The one-step residual of a right
model is then :math:`r_t = s_{t+1} - f(s_t) \approx e_{t+1} - A_t e_t`, a moving average whose covariance is block
tridiagonal: :math:`C_{tt} = A_t R A_t^T + R + Q_t` and :math:`C_{t,t-1} = -A_t R`. The theory
page has the derivation.
"""

from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

# Squared residuals, in units of their variance, count up to this much in the estimate of the noise.
LARGEST_SQUARE = 9.0
# A channel has at least this share of its residual's typical variance: other channels cannot explain it all.
SMALLEST_SHARE = 1e-3
# Mean of a channel's squares, cut as above and in units of their expectation, that leaves nothing unexplained.
LARGEST_LEFT = 1.3


@dataclass(frozen=True)
class Whitener:
    """The block Cholesky factor of the covariance of chains of residuals.

    Attributes
    ----------
    factors : ndarray of shape (n_chains, n_steps, n_channels, n_channels)
        Lower triangular diagonal blocks.
    gains : ndarray of shape (n_chains, n_steps, n_channels, n_channels)
        Blocks below the diagonal: how the previous whitened residual enters.
    transitions : ndarray of shape (n_chains, n_steps, n_channels, n_channels)
        A, the derivative of the next state by the state.
    variances : ndarray of shape (n_channels,)
        The diagonal of R.
    present : ndarray of bool of shape (n_chains, n_steps)
        False where a residual is missing; a chain starts afresh behind it.
    """

    factors: np.ndarray
    gains: np.ndarray
    transitions: np.ndarray
    variances: np.ndarray
    present: np.ndarray

    def whiten(self, residuals):
        """Return residuals of shape (n_chains, n_steps, n_channels[, n_columns]) uncorrelated and of variance 1."""
        columns = residuals[..., None] if residuals.ndim == 3 else residuals
        columns = np.where(self.present[..., None, None], columns, 0.0)
        white = np.empty_like(columns)
        previous = np.zeros_like(columns[:, 0])
        for t in range(columns.shape[1]):
            previous = np.linalg.solve(self.factors[:, t], columns[:, t] - self.gains[:, t] @ previous)
            white[:, t] = previous
        return white[..., 0] if residuals.ndim == 3 else white

    def unwhiten_adjoint(self, white):
        """Return the transposed whitening of columns of shape (n_chains, n_steps, n_channels[, n_columns]).

        Of whitened residuals it gives the inverse covariance times the residuals: what each one says when what its
        neighbours say is taken into account.
        """
        columns = white[..., None] if white.ndim == 3 else white
        weights = np.empty_like(columns)
        following = np.zeros_like(columns[:, 0])
        n_steps = columns.shape[1]
        for t in reversed(range(n_steps)):
            right = columns[:, t]
            if t + 1 < n_steps:
                right = right - np.swapaxes(self.gains[:, t + 1], 1, 2) @ following
            following = np.linalg.solve(np.swapaxes(self.factors[:, t], 1, 2), right)
            weights[:, t] = following
        weights = np.where(self.present[..., None, None], weights, 0.0)
        return weights[..., 0] if white.ndim == 3 else weights

    def smooth(self, residuals):
        r"""Return the expected noise :math:`E[e_t | r]` of each measured state that a residual starts from.

        For Gaussian noise the error that is left, :math:`e - E[e | r]`, is independent of the residuals; a derivative
        taken at the smoothed state is therefore not correlated with them, as one taken at the measured state is.
        """
        weights = self.unwhiten_adjoint(self.whiten(residuals))
        noise = -np.einsum("ctji,ctj->cti", self.transitions, weights)
        noise[:, 1:] += weights[:, :-1]
        return noise * self.variances

    def smoothed_covariances(self):
        r"""Return the covariances :math:`Cov(e_t | r)` of what `smooth` leaves unknown.

        Returns
        -------
        ndarray of shape (n_chains, n_steps, n_channels, n_channels)
        """
        n_steps, n_channels = self.factors.shape[1:3]
        # Blocks of the inverse covariance of the residuals: of each step with itself, and of the one before with it.
        own, before = np.zeros_like(self.factors), np.zeros_like(self.factors)
        for t in reversed(range(n_steps)):
            right = inverse = np.linalg.solve(self.factors[:, t], np.eye(n_channels))
            if t + 1 < n_steps:
                following = np.swapaxes(self.gains[:, t + 1], 1, 2)
                before[:, t + 1] = -np.swapaxes(inverse, 1, 2) @ following @ own[:, t + 1]
                right = inverse - following @ np.swapaxes(before[:, t + 1], 1, 2)
            own[:, t] = np.swapaxes(inverse, 1, 2) @ right
        present = self.present[..., None, None]
        own, transitions = np.where(present, own, 0.0), np.where(present, self.transitions, 0.0)
        known = np.swapaxes(transitions, -1, -2) @ own @ transitions
        mixed = before[:, 1:] @ transitions[:, 1:]
        known[:, 1:] += own[:, :-1] - mixed - np.swapaxes(mixed, -1, -2)
        return np.diag(self.variances) - self.variances[:, None] * known * self.variances


def block_cholesky(transitions, variances, extra_variances, present):
    """Return the Whitener of chains with the given derivatives and noise.

    Parameters
    ----------
    transitions : ndarray of shape (n_chains, n_steps, n_channels, n_channels)
        A. All zero for a simulation whose inputs carry no noise.
    variances : ndarray of shape (n_channels,)
        The diagonal of R, positive.
    extra_variances : ndarray of shape (n_chains, n_steps, n_channels)
        The diagonal of Q, what the curvature of the simulation adds.
    present : ndarray of bool of shape (n_chains, n_steps)
    """
    n_steps, n_channels = transitions.shape[1:3]
    noisy_inputs = transitions * variances
    covariances = noisy_inputs @ np.swapaxes(transitions, -1, -2)
    diagonal = np.arange(n_channels)
    covariances[..., diagonal, diagonal] += variances * (1 + 1e-10) + extra_variances
    covariances[~present] = np.diag(variances)
    factors, gains = np.empty_like(covariances), np.zeros_like(covariances)
    for t in range(n_steps):
        if t:
            linked = present[:, t] & present[:, t - 1]
            gains[linked, t] = np.swapaxes(
                np.linalg.solve(factors[linked, t - 1], -np.swapaxes(noisy_inputs[linked, t], -1, -2)), -1, -2
            )
        factors[:, t] = np.linalg.cholesky(covariances[:, t] - gains[:, t] @ np.swapaxes(gains[:, t], -1, -2))
    return Whitener(factors, gains, transitions, variances, present)


def estimate_variances(residuals, transitions, extra_variances, *, smallest, follows=None):
    r"""Return the variances of the measurement noise that explain one-step residuals, their sizes and their neighbours.

    .. math:: E[r_{ti}^2] = R_i + \sum_j A_{tij}^2 R_j + Q_{ti}, \quad E[r_{ti} r_{t-1,j}] = -A_{tij} R_j

    are linear in R: a generalised linear model with the variances that normal residuals give squares and products,
    solved by reweighted non-negative least squares. Sizes alone can trade the noise of a position for that of its
    velocity; what a residual has in common with the one before tells the two apart. Where a model misses, neighbours
    have its misses in common; products that leave the sizes unexplained are not counted. Squares and products beyond a
    few times their expectation are cut, with the cut's own bias for Gaussian noise taken out of the squares, so that
    rows at contacts, where the simulation is not smooth, do not pass for noise.

    Parameters
    ----------
    residuals : ndarray of shape (n_rows, n_channels)
        What the simulation and everything it could take on do not explain.
    transitions : ndarray of shape (n_rows, n_channels, n_channels)
    extra_variances : ndarray of shape (n_rows, n_channels)
    smallest : ndarray of shape (n_channels,)
        Lower bound of each variance.
    follows : ndarray of bool of shape (n_rows,), optional
        True where a row is the step after the row before it; by default no row is.
    """
    squares = residuals**2
    # Cutting is relative to the model's own expectation: start from the middle of the squares.
    typical = np.median(squares, axis=0) / stats.chi2.median(1)
    smallest = np.maximum(smallest, SMALLEST_SHARE * typical)
    if follows is not None and follows.any():
        variances, expected = _solved(residuals, transitions, extra_variances, typical, smallest, follows)
        sizes = np.mean(np.minimum(squares / expected, LARGEST_SQUARE), axis=0)
        if (sizes < LARGEST_LEFT).all():
            return variances
    return _solved(residuals, transitions, extra_variances, typical, smallest, None)[0]


def _solved(residuals, transitions, extra_variances, typical, smallest, follows):
    """Return variances, and the squares (n_rows, n_channels) that they let expect."""
    n_channels = residuals.shape[1]
    diagonal = np.arange(n_channels)
    kept_share = stats.chi2.cdf(LARGEST_SQUARE, 3) + LARGEST_SQUARE * stats.chi2.sf(LARGEST_SQUARE, 1)
    squares = residuals**2
    if follows is not None:
        after = np.flatnonzero(follows)
        products = residuals[after, :, None] * residuals[after - 1, None, :]
    design = transitions**2
    design[:, diagonal, diagonal] += 1
    expected = np.maximum(typical + extra_variances, smallest)
    scale = np.sqrt(np.maximum(typical, smallest))
    variances = None
    for _ in range(50):
        cut = np.minimum(squares, LARGEST_SQUARE * expected) / kept_share - extra_variances
        weights = 1.0 / expected
        rows = (design * weights[..., None]).reshape(-1, n_channels) * scale**2
        information, score = rows.T @ rows, rows.T @ (cut * weights).ravel()
        if follows is not None:
            own, told = _neighbours(
                products, -transitions[after], expected[after], expected[after - 1], scale**2
            )
            information[diagonal, diagonal] += own
            score += told
        new = np.maximum(optimize.nnls(information, score)[0] * scale**2, smallest)
        expected = np.maximum(design @ new + extra_variances, smallest)
        if variances is not None and np.allclose(new, variances, rtol=1e-4, atol=0.0):
            break
        variances = new
    return new, expected


def _neighbours(products, slopes, expected, expected_before, scale):
    """Return what products of neighbours add to the normal equations: to the diagonal, and to the right-hand side.

    A product of two normal numbers varies half as much as a square, so it counts twice.
    """
    deviations = np.sqrt(expected[:, :, None] * expected_before[:, None, :])
    cut = np.clip(products / deviations, -LARGEST_SQUARE, LARGEST_SQUARE)
    slopes = slopes * scale / deviations
    return 2 * np.sum(slopes**2, axis=(0, 1)), 2 * np.sum(slopes * cut, axis=(0, 1))
