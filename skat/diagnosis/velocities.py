r"""Whether velocities were measured or computed from the positions beside them, told without a simulation.

Regress a velocity on the positions around it and on its own neighbours, :math:`v_t \approx \sum_k c_k q_{t+k} + \sum_k
a_k v_{t+k}`. Noise of the positions that the velocity knows nothing of enters what is left with exactly
:math:`\sigma_q^2 \sum c_k^2`, so that no measured velocity can be predicted better; one that was computed from these
positions can, by any linear filter, causal or not, that so many neighbours express.
"""

from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from skat.diagnosis.chains import Array
from skat.simulators import Simulator

# Neighbours to each side that a filter may use.
POSITIONS, VELOCITIES = 4, 2
# Order of the differences of positions in which noise is all that is left.
ORDER = 6
# Motion adds to differences, above all where something hits: noise is what the quieter quarter of the pieces has.
PIECE, QUIET = 10, 0.25
# Of what independent noise would leave: far from 1 for the scatter of a variance, far from 0 for a log's own rounding.
SHARE = 0.03
# Rows for each regressor.
ROWS_EACH = 4


def is_computed(
    positions: Array, velocities: Array, episodes: NDArray[Any], others: Array | None = None
) -> bool:
    """Return whether one joint's velocities were computed from its positions.

    `positions`, `velocities` (n_instants,): as measured, evenly spaced within an episode; NaN where nothing was.
    `episodes` (n_instants,). `others` (n_instants, n_others): what else tells of the motion but knows nothing of the
    noise of these positions: other positions, commands. Returns: False also where too few rows leave it open. Where
    positions have no noise, either answer may come: they then tell what the velocity would.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> angle = np.sin(0.05 * np.arange(400))
    >>> read = angle + 0.001 * rng.normal(size=400)
    >>> is_computed(read, np.gradient(read, 0.01), np.zeros(400))
    True
    >>> is_computed(read, 5 * np.cos(0.05 * np.arange(400)) + 0.05 * rng.normal(size=400), np.zeros(400))
    False
    """
    q, v = np.moveaxis(_windows(np.column_stack([positions, velocities]), episodes, POSITIONS), 1, 0)
    v = v[:, POSITIONS - VELOCITIES : POSITIONS + VELOCITIES + 1]
    design, target = np.column_stack([q, np.delete(v, VELOCITIES, axis=1)]), v[:, VELOCITIES]
    # Sensors that repeat themselves, at rest, tell nothing of either.
    moves = np.ptp(design[:, : 2 * POSITIONS + 1], axis=1) > 0
    kept = np.isfinite(design).all(axis=1) & np.isfinite(target) & moves
    design, target = design[kept], target[kept]
    if len(target) < ROWS_EACH * design.shape[1]:
        return False
    noise = min(noise_variance(positions, episodes), _unpredictable(positions, episodes, others))
    coefficients, left, degrees = _regression(design, target)
    own = coefficients[: 2 * POSITIONS + 1]
    return bool(np.sum(left**2) / degrees < SHARE * noise * np.sum(own**2))


def _unpredictable(positions: Array, episodes: NDArray[Any], others: Array | None) -> float:
    """Return the variance of what neighbours and all else tell nothing of: noise is no larger."""
    if others is None or not others.shape[1]:
        return np.inf
    windows = _windows(np.column_stack([positions, others]), episodes, POSITIONS)
    target, beside = windows[:, 0, POSITIONS], windows[:, 1:].reshape(len(windows), -1)
    design = np.column_stack([np.delete(windows[:, 0], POSITIONS, axis=1), beside])
    kept = np.isfinite(target)
    design, target = design[kept], target[kept]
    design = design[:, np.isfinite(design).all(axis=0)]
    if len(target) < ROWS_EACH * design.shape[1]:
        return np.inf
    _, left, degrees = _regression(design, target)
    return float(left @ left / degrees)


def _windows(columns: Array, episodes: NDArray[Any], reach: int) -> Array:
    """Return what is around each instant, and as far within its episode, (n, n_columns, 2 reach + 1)."""
    length = 2 * reach + 1
    own = [columns[episodes == one] for one in np.unique(episodes)]
    found = [
        np.lib.stride_tricks.sliding_window_view(one, length, axis=0) for one in own if len(one) >= length
    ]
    return np.concatenate([np.empty((0, columns.shape[1], length)), *found])


def _regression(design: Array, target: Array) -> tuple[Array, Array, int]:
    """Return coefficients of the columns and of a constant, what is left of the target, and its degrees of freedom."""
    design = np.column_stack([design - design.mean(axis=0), np.ones(len(design))])
    sizes = np.sqrt(np.mean(design**2, axis=0))
    sizes[sizes == 0] = 1.0
    coefficients, *_ = np.linalg.lstsq(design / sizes, target, rcond=None)
    left = target - design / sizes @ coefficients
    return coefficients / sizes, left, len(target) - design.shape[1]


def noise_variance(series: Array, episodes: NDArray[Any]) -> float:
    """Return the variance of a channel's noise as neighbouring rows show it: what high differences leave.

    `series` (n_instants,): NaN where nothing was measured. `episodes` (n_instants,). Returns: 0 where no piece is long
    enough to tell; pieces in which a sensor repeats itself are none.
    """
    rough = [np.diff(series[episodes == episode], ORDER) for episode in np.unique(episodes)]
    squares = np.concatenate(rough) ** 2 / comb(2 * ORDER, ORDER)
    squares = squares[np.isfinite(squares)]
    n_pieces = max(1, len(squares) // PIECE)
    means = [piece.mean() for piece in np.array_split(squares, n_pieces) if piece.any()]
    return float(np.quantile(means, QUIET)) if means else 0.0


def power_by_frequency(series: Array, fewest: int) -> tuple[Array, Array]:
    """Return frequencies, as shares of the Nyquist frequency, and the power of an episode's channel at each.

    High differences take the motion out before a window that hardly leaks; what they do to noise is made good.

    `series` (n_instants,). `fewest`: instants; of a shorter series, or one of which some were not measured, there are
    no frequencies.
    """
    if len(series) < fewest or not np.isfinite(series).all():
        return np.zeros(0), np.zeros(0)
    rough = np.diff(series, ORDER)
    window = signal.windows.blackmanharris(len(rough))
    powers = np.abs(np.fft.rfft(rough * window / np.linalg.norm(window)))[1:] ** 2
    shares = np.arange(1, len(powers) + 1) * 2 / len(rough)
    return shares, powers / (2 * np.sin(np.pi / 2 * shares)) ** (2 * ORDER)


def states_in_time(
    simulator: Simulator, X: Array, y: Array, groups: NDArray[Any]
) -> tuple[Array, NDArray[Any], Array]:
    """Return the states of all instants, the last of each episode included, with their episodes and actions."""
    n_states = len(simulator.state_names)
    last = np.flatnonzero(np.r_[groups[1:] != groups[:-1], True])
    states = np.insert(X[:, :n_states], last + 1, y[last], axis=0)
    actions = np.insert(X[:, n_states:], last + 1, X[last, n_states:], axis=0)
    return states, np.insert(groups, last + 1, groups[last]), actions


def computed_velocities(simulator: Simulator, X: Array, y: Array, groups: NDArray[Any]) -> tuple[str, ...]:
    """Return the names of the velocities that were computed from positions.

    `X`, `y` (n_rows, n_inputs), (n_rows, n_outputs). `groups` (n_rows,): episode of each row.
    """
    names, pairs = simulator.state_names, motions(simulator)
    states, episodes, actions = states_in_time(simulator, X, y, groups)
    places = {position: states[:, names.index(position)] for position, _ in pairs}
    return tuple(
        velocity
        for position, velocity in pairs
        if is_computed(
            places[position],
            states[:, names.index(velocity)],
            episodes,
            np.column_stack([actions, *(place for name, place in places.items() if name != position)]),
        )
    )


def motions(simulator: Simulator) -> tuple[tuple[str, str], ...]:
    """Return (position, velocity) of each pair of channels of which the second is the rate of the first.

    MuJoCo's names tell, but for orientations, whose rates no difference of a column makes; elsewhere units do, where
    there is one pair of them.
    """
    states, units = simulator.state_names, simulator.units
    names = simulator.residual_names
    if all(name.startswith(("qpos.", "qvel.")) for name in names):
        half = len(names) // 2
        return tuple(pair for pair in zip(names[:half], names[half:]) if set(pair) <= set(states))
    pairs = []
    for name in states:
        alike = [one for one in states if units.get(one) == units.get(name)]
        rates = [one for one in states if name in units and units.get(one) == f"{units[name]}/s"]
        if len(alike) == len(rates) == 1:
            pairs.append((name, rates[0]))
    return tuple(pairs)
