"""Values between samples, and commands that are held: what an uneven clock asks for."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skat.logs.clock import BETWEEN, ON_GRID
from skat.simulators.tables import Array

# Samples at a time, so that tables of neighbours stay small.
BLOCK = 1 << 16
# Directions of commands weaker than this, relative to the strongest, are no direction.
RANK = 1e-10


@dataclass(frozen=True)
class Held:
    """A command that acts from each of its times to the next one.

    Attributes
    ----------
    times : ndarray of shape (n_commands,)
        Not decreasing, s.
    values : ndarray of shape (n_commands,)
        Finite.
    """

    times: Array
    values: Array

    @classmethod
    def of(cls, times: Array, values: Array) -> "Held":
        """Return the command of samples in any order, of which some may be NaN."""
        good = np.isfinite(values) & np.isfinite(times)
        times, values = times[good], values[good]
        order = np.argsort(times, kind="stable")
        return cls(times[order], values[order])

    def mean(self, at: Array, dt: float) -> Array:
        """Return the mean over rows that begin at `at` and last `dt` seconds; NaN before the first command."""
        if not len(self.times):
            return np.full(len(at), np.nan)
        near = ON_GRID * dt
        first = np.searchsorted(self.times, at + near, side="right") - 1
        last = np.searchsorted(self.times, at + dt - near, side="left") - 1
        out = np.where(first >= 0, self.values[np.maximum(first, 0)], np.nan)
        changing = (last > first) & (first >= 0)
        if changing.any():
            begin = at[changing]
            out[changing] = (self.integral(begin + dt) - self.integral(begin)) / dt
        return out

    def jump(self, at: Array, width: float) -> Array:
        """Return by how much it has changed from half of a width before each of the times to half of one after it."""
        if not len(self.times):
            return np.zeros(len(at))
        before, after = (
            np.clip(np.searchsorted(self.times, at + half, side="right") - 1, 0, None)
            for half in (-width / 2, width / 2)
        )
        return self.values[after] - self.values[before]

    def integral(self, at: Array) -> Array:
        """Return the integral from the first command to each of the times; before it the first one counts."""
        if not len(self.times):
            return np.zeros(len(at))
        sums = np.concatenate([[0.0], np.cumsum(np.diff(self.times) * self.values[:-1])])
        place = np.clip(np.searchsorted(self.times, at, side="right") - 1, 0, None)
        return sums[place] + (at - self.times[place]) * self.values[place]


@dataclass(frozen=True)
class Bends:
    r"""By how much held commands bend a channel: velocities have a corner wherever a force jumps.

    Between corners a cubic through four samples goes wrong by half of each jump, always to the same side, and so do
    causes that are fitted to it. What is interpolated is therefore the remainder

    .. math:: r(t) = v(t) - \sum_a c_a \int^t u_a(s)\, ds ,

    with the sizes that let cubics through the four neighbours of each sample miss it least.

    Attributes
    ----------
    sizes : ndarray of shape (n_commands,)
        The channel's unit a second, for each unit of a command.
    missed : float
        Mean square of what the cubics miss, for each degree of freedom.
    """

    sizes: Array
    missed: float

    @property
    def told(self) -> bool:
        """Whether any command bends it."""
        return bool(self.sizes.any())

    def share(self, commands: Sequence[Held], at: Array) -> Array:
        """Return the bent part of the channel."""
        out = np.zeros(len(at))
        for size, command in zip(self.sizes, commands, strict=True):
            if size:
                out += size * command.integral(at)
        return out

    def corner(self, commands: Sequence[Held], at: Array, width: float) -> Array:
        """Return by how much the slope of the channel jumps within a width around each of the times."""
        return sum(
            (size * command.jump(at, width) for size, command in zip(self.sizes, commands, strict=True)),
            np.zeros(len(at)),
        )


def bends(pieces: Sequence[tuple[Array, Array, Sequence[Held]]], dt: float) -> Bends:
    """Return by how much commands bend a channel; sizes are 0 where they do not tell more than they cost.

    Parameters
    ----------
    pieces : sequence of (times, values, commands)
        Samples of the channel with growing times, s, and the same commands in each piece.
    dt : float
        The usual distance of samples, s.
    """
    n_commands = len(pieces[0][2]) if pieces else 0
    moments, count = np.zeros((n_commands + 1, n_commands + 1)), 0
    for times, values, commands in pieces:
        for begin in range(0, len(times) - 4, BLOCK):
            block = slice(begin, min(begin + BLOCK + 4, len(times)))
            at = times[block]
            columns = np.stack([values[block], *(command.integral(at) for command in commands)], axis=1)
            left_out = _left_out(at, columns, dt)
            moments += left_out.T @ left_out
            count += len(left_out)
    plain = moments[0, 0] / count if count else 0.0
    scale = np.sqrt(np.diag(moments)[1:])
    scale[scale == 0] = 1.0
    gram, right = moments[1:, 1:] / np.outer(scale, scale), moments[1:, 0] / scale
    sizes = np.linalg.pinv(gram, rcond=RANK, hermitian=True) @ right
    rest = (moments[0, 0] - sizes @ right) / max(count - n_commands, 1)
    if count <= 2 * n_commands or rest >= plain:
        return Bends(np.zeros(n_commands), plain)
    return Bends(sizes / scale, rest)


def _left_out(times: Array, columns: Array, dt: float) -> Array:
    """Return what cubics through the four neighbours of each sample miss, where no sample is lost among them."""
    middle = np.arange(2, len(times) - 2)
    nodes = middle[:, None] + np.array([-2, -1, 1, 2])
    near = times[nodes[:, 3]] - times[nodes[:, 0]] <= (4 + BETWEEN) * dt
    middle, nodes = middle[near], nodes[near]
    weights = _lagrange(times[nodes], times[middle])
    missed: Array = columns[middle] - np.einsum("pn,pnc->pc", weights, columns[nodes])
    return missed


def interpolated(
    times: Array, values: Array, at: Array, dt: float, *, kinked: bool = False
) -> tuple[Array, Array]:
    r"""Return values between samples, by cubics through the four around, and an estimate of the error.

    .. math:: q(t) = \sum_{i=0}^{3} q_i \prod_{j \ne i} \frac{t - t_j}{t_i - t_j}

    The estimate is the difference of the parabolas through the first and the last three, between which the cubic
    lies: a bound for motion that is smooth from sample to sample. A velocity has a kink wherever a held command
    changes; beside it the cubic has about the mean of both slopes, half of the jump off either. The straight line
    between two samples has one of them, so twice its distance from the cubic counts as well.

    Parameters
    ----------
    times : ndarray of shape (n_samples,)
        Increasing, s.
    values : ndarray of shape (n_samples, n_channels)
    at : ndarray of shape (n_places,)
        s.
    dt : float
        The usual distance of samples; places between samples further apart than 1.5 of it are NaN.
    kinked : bool, default=False
        Whether the slope jumps from sample to sample.

    Returns
    -------
    values, errors : ndarray of shape (n_places, n_channels)
    """
    n = len(times)
    if n < 4:
        out = np.full((len(at), values.shape[1]), np.nan)
        return out, np.zeros_like(out)
    left = np.clip(np.searchsorted(times, at, side="right") - 1, 0, n - 2)
    first = np.clip(left - 1, 0, n - 4)
    nodes = first[:, None] + np.arange(4)
    cubic = _lagrange(times[nodes], at)
    around = values[nodes]
    smooth = np.einsum("pn,pnc->pc", cubic, around)
    # The third divided difference: by it the cubic and the parabolas through three of its samples differ.
    third = np.einsum("pn,pnc->pc", 1 / _products(times[nodes]), around)
    reach = (at - times[left]) * (at - times[left + 1]) * (times[nodes[:, 3]] - times[nodes[:, 0]])
    errors = np.abs(third * reach[:, None])
    if kinked:
        share = ((at - times[left]) / (times[left + 1] - times[left]))[:, None]
        line = (1 - share) * values[left] + share * values[left + 1]
        errors = np.maximum(errors, 2 * np.abs(line - smooth))
    near = np.minimum(np.abs(times[left] - at), np.abs(times[left + 1] - at))
    nearest = np.where(np.abs(times[left] - at) <= np.abs(times[left + 1] - at), left, left + 1)
    exact = near <= ON_GRID * dt * 1e-3
    smooth[exact], errors[exact] = values[nearest[exact]], 0.0
    inside = (at >= times[0] - ON_GRID * dt) & (at <= times[-1] + ON_GRID * dt)
    lost = ~(((times[left + 1] - times[left] <= BETWEEN * dt) & inside) | exact)
    # Cubics reach over a gap beside them; what they make of it is not measured.
    spread = times[nodes[:, 3]] - times[nodes[:, 0]] > (3 + BETWEEN) * dt
    smooth[lost | (spread & ~exact)] = np.nan
    return smooth, np.where(np.isfinite(smooth), errors, 0.0)


def _lagrange(nodes: Array, at: Array) -> Array:
    weights = np.ones(nodes.shape)
    for i in range(nodes.shape[1]):
        for j in range(nodes.shape[1]):
            if i != j:
                weights[:, i] *= (at - nodes[:, j]) / (nodes[:, i] - nodes[:, j])
    return weights


def _products(nodes: Array) -> Array:
    apart = nodes[:, :, None] - nodes[:, None, :]
    apart[:, np.arange(nodes.shape[1]), np.arange(nodes.shape[1])] = 1.0
    products: Array = apart.prod(axis=2)
    return products
