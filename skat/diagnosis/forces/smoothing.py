r"""Smooth position, velocity and acceleration of one coordinate from noisy positions: pure functions of arrays.

The coordinate is an integrated random walk, its jerk white noise, read with white noise. The variances maximise the
restricted likelihood; the smoothed state is the posterior mean. The information matrix of all states is banded, so that
all of it is linear in the number of rows. In units of the row's duration h the states are :math:`(q, h v, h^2 a / 2)`,
whose transition and covariance of a step hold no h at all:

.. math::

    x_{t+1} = \begin{pmatrix} 1 & 1 & 1 \\ 0 & 1 & 2 \\ 0 & 0 & 1 \end{pmatrix} x_t + w_t, \qquad
    w_t \sim N\left(0, \lambda \sigma^2 \begin{pmatrix} 1/20 & 1/8 & 1/12 \\ 1/8 & 1/3 & 1/4 \\
    1/12 & 1/4 & 1/4 \end{pmatrix}\right).

Of a motion at the angular frequency :math:`\Omega / h` the smoother keeps the share
:math:`1 / (1 + \Omega^6 / \lambda)`, with :math:`\sigma^2` the variance of readings.

References
----------
.. [1] Wahba (1978). Improper priors, spline smoothing and the problem of guarding against model errors in regression.
   J. R. Stat. Soc. B 40(3).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize

from skat.diagnosis.chains import Array, Mask

TRANSITION = np.array([[1.0, 1, 1], [0, 1, 2], [0, 0, 1]])
STEP = np.linalg.inv(np.array([[1 / 20, 1 / 8, 1 / 12], [1 / 8, 1 / 3, 1 / 4], [1 / 12, 1 / 4, 1 / 4]]))
# Logarithm of the variance of jerk over that of positions: from a straight line to no noise.
LOG_JERK = (-30.0, 12.0)
# Rows from which variances are estimated, at most.
ROWS_FOR_VARIANCES = 4000


@dataclass(frozen=True)
class Smooth:
    """A smoothed coordinate.

    Attributes
    ----------
    position, velocity, acceleration : ndarray of shape (n_instants,)
    velocity_error : float
        Standard deviation of the velocity given the readings, in the middle of the longest episode.
    position_noise : float
        Standard deviation of a position's reading.
    jerk : float
        lambda.
    """

    position: Array
    velocity: Array
    acceleration: Array
    velocity_error: float
    position_noise: float
    jerk: float

    def kept(self, frequency: Array, dt: float) -> Array:
        """Return which share of a motion at a frequency (Hz) is kept."""
        omega = 2 * np.pi * np.asarray(frequency) * dt
        return 1 / (1 + omega**6 / self.jerk)

    def cutoff(self, share: float, dt: float) -> float:
        """Return the frequency (Hz), Nyquist's at most, up to which at least a share of a motion is kept."""
        frequencies = np.linspace(0, 0.5 / dt, 2001)
        lost = np.flatnonzero(self.kept(frequencies, dt) < share)
        return float(frequencies[lost[0] - 1] if lost.size else frequencies[-1])


def smooth_coordinate(positions: Array, episodes: Array, dt: float) -> Smooth:
    """Return a smoothed coordinate, its variances estimated.

    Parameters
    ----------
    positions : ndarray of shape (n_instants,)
        Evenly spaced within an episode; NaN where nothing was measured.
    episodes : ndarray of shape (n_instants,)
        Episode of each instant; those of one follow each other.
    dt : float
        s.

    Raises
    ------
    ValueError
        If an episode has fewer than 3 values.
    """
    joined = episodes[1:] == episodes[:-1]
    starts = np.r_[0, np.flatnonzero(~joined) + 1]
    seen = np.isfinite(positions)
    if (np.add.reduceat(seen, starts, dtype=int) < 3).any():
        raise ValueError(
            "an episode holds fewer than 3 readings of a coordinate; it takes 3 to tell how it moves"
        )
    part = slice(0, ROWS_FOR_VARIANCES)
    jerk = _jerk(positions[part], seen[part], joined[: len(positions[part]) - 1])
    _, states, factor, scale = _posterior(positions, seen, joined, jerk)
    longest = int(np.argmax(np.diff(np.r_[starts, len(positions)])))
    middle = (starts[longest] + (np.r_[starts, len(positions)][longest + 1])) // 2
    unit = np.zeros(states.size)
    unit[3 * middle + 1] = 1.0
    spread = cho_solve_banded((factor, True), unit)[3 * middle + 1] * scale
    return Smooth(
        states[:, 0],
        states[:, 1] / dt,
        2 * states[:, 2] / dt**2,
        float(np.sqrt(spread) / dt),
        float(np.sqrt(scale)),
        jerk,
    )


def _jerk(positions: Array, seen: Mask, joined: Mask) -> float:
    """Return the variance of jerk, over that of positions."""

    def cost(parameters: Array) -> float:
        log_jerk = np.clip(parameters[0], *LOG_JERK)
        beyond = abs(parameters[0] - log_jerk)
        return float(_posterior(positions, seen, joined, np.exp(log_jerk))[0] + beyond)

    start = min((np.array([jerk]) for jerk in np.arange(-24.0, 10.0, 3.0)), key=cost)
    simplex = np.array([start, start + 1.5])
    options = {"xatol": 0.05, "fatol": 0.05, "initial_simplex": simplex, "maxfev": 15}
    found = minimize(cost, start, method="Nelder-Mead", options=options).x
    return float(np.exp(np.clip(found[0], *LOG_JERK)))


def _posterior(positions: Array, seen: Mask, joined: Mask, jerk: float) -> tuple[float, Array, Array, float]:
    """Return -2 log of the restricted likelihood, the states (n, 3), the factor of their information, sigma^2."""
    n = len(positions)
    values = np.where(seen, positions, 0.0)
    diagonal = np.zeros((n, 3, 3))
    inner = TRANSITION.T @ STEP @ TRANSITION / jerk
    diagonal[:-1] += joined[:, None, None] * inner
    diagonal[1:] += joined[:, None, None] * STEP / jerk
    diagonal[:, 0, 0] += seen
    below = np.zeros((n, 3, 3))
    below[:-1] = joined[:, None, None] * (-STEP @ TRANSITION / jerk)
    shaped = np.zeros((6, n, 3))
    for row in range(3):
        for column in range(3):
            if row >= column:
                shaped[row - column, :, column] += diagonal[:, row, column]
            shaped[3 + row - column, :, column] += below[:, row, column]
    bands = shaped.reshape(6, 3 * n)
    right = np.zeros((n, 3))
    right[:, 0] = values
    factor = cholesky_banded(bands, lower=True, check_finite=False)
    states = cho_solve_banded((factor, True), right.ravel(), check_finite=False).reshape(n, 3)
    pushes = (states[1:] - states[:-1] @ TRANSITION.T)[joined]
    squares = float((seen * (values - states[:, 0]) ** 2).sum())
    squares += float(np.einsum("ti,ij,tj->", pushes, STEP, pushes)) / jerk
    n_pushes = 3 * int(joined.sum())
    degrees = max(int(seen.sum()) - 3 * (n - int(joined.sum())), 1)
    squares = max(squares, 1e-26 * float((values**2).sum()) + 1e-300)
    cost = 2 * float(np.log(factor[0]).sum()) + n_pushes * np.log(jerk)
    cost += degrees * np.log(squares / degrees)
    return cost, states, factor, squares / degrees
