r"""Chains: pieces of episodes as linear dynamics, random forces and measurements; their parts, and forces with memory.

A chain is a piece of an episode. About a path, its deviations follow

.. math::

    \delta_{t+1} = A_t \delta_t + c_t + F_t w_t + v_t, \qquad m_t = H_t \delta_t + e_t,

with :math:`w_t \sim N(0, \mathrm{diag}(q_t))`, :math:`e_t \sim N(0, \mathrm{diag}(r_t))` and
:math:`v_t \sim N(0, \Omega_t)`, what the linearisation leaves. A channel that was not measured is a row that
:math:`H_t` lacks. The first state of a chain has a wide prior. Channels of which none acts on another, such as those of
a robot's legs where its base is fixed, are parts.
"""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Places = NDArray[np.intp]


@dataclass(frozen=True)
class Memory:
    """Random forces that remember the ones before, one beside each white force.

    With fresh pushes w and a hidden z, ``z[t+1] = share z[t] + w[t]`` acts as it is and lasts, as a drift does; or
    ``z[t+1] = share z[t] + (1 - share) w[t]`` takes back from w[t], so that nothing is left of a push in the end, as
    of a vibration's: spectra that fall off above a frequency, or below it.

    `n_forces`: 0: there are none. `share`: what is left of z a row later. `returns`: whether pushes are taken back.
    """

    n_forces: int = 0
    share: float = 0.0
    returns: bool = False

    def __len__(self) -> int:
        return self.n_forces

    def acting(self, fresh: Array, hidden: Array) -> Array:
        """Return the forces of pushes (..., n_forces) and of what is hidden beside them."""
        return fresh - hidden if self.returns else hidden

    def kept(self, fresh: Array) -> Array:
        """Return what pushes add to what is hidden."""
        return (1 - self.share) * fresh if self.returns else fresh

    def steady(self, fresh: Array) -> Array:
        """Return the variance of what is hidden, at any time, from that of the pushes (..., n_forces)."""
        return self.kept(self.kept(fresh)) / (1 - self.share**2)

    def variance(self, fresh: Array) -> Array:
        """Return the variance of the forces, at any time."""
        return self.steady(fresh) + (fresh if self.returns else 0.0)

    @property
    def predicted(self) -> float:
        """Share of the forces' variance that is known from those before."""
        return (1 - self.share) / 2 if self.returns else self.share**2


NO_MEMORY = Memory()


@dataclass(frozen=True)
class Chains:
    """Linear dynamics and measurements of chains, padded to the longest one.

    `transitions` (n_chains, n_steps, d, d). `drive` (n_chains, n_steps, d): c, what the model adds to the deviation in
    a step. `bends` (n_chains, n_steps, d, d): covariance of what the linearisation leaves. `carrier` (n_chains,
    n_steps, d, n_forces): F, by which random forces enter the state. `measured` (n_chains, n_steps + 1, d): m; any
    number where nothing was measured. `mask` (n_chains, n_steps + 1, d). `prior` (d,): variance of a chain's first
    state about the path. `before` (n_chains, d, n_forces): by which forces of the first step's variances enter that
    state, beside the prior.
    """

    transitions: Array
    drive: Array
    bends: Array
    carrier: Array
    measured: Array
    mask: Mask
    prior: Array
    before: Array | None = None

    def of(self, chosen: Mask | Places) -> "Chains":
        """Return some of the chains, by a mask of shape (n_chains,) or by their places."""
        whole = (getattr(self, one.name) for one in fields(self))
        own: list[Any] = [one if one is None or one is self.prior else one[chosen] for one in whole]
        return Chains(*own)

    def with_memory(self, memory: Memory) -> "Chains":
        """Return these chains with a force of memory beside each random force, as further, hidden channels.

        What is hidden of them where a chain begins is what all steps before would have made it: what is the same in all
        chains is not unknown anew in each.
        """
        if not memory:
            return self
        n, steps, d = self.drive.shape
        k = self.carrier.shape[-1]
        transitions = np.zeros((n, steps, d + k, d + k))
        none, one = np.zeros(k), np.ones(k)
        transitions[..., :d, :d] = self.transitions
        transitions[..., :d, d:] = self.carrier * memory.acting(none, one)
        transitions[..., d:, d:] = memory.share * np.eye(k)
        carrier = np.zeros((n, steps, d + k, 2 * k))
        carrier[..., :d, :k] = self.carrier
        carrier[..., :d, k:] = self.carrier * memory.acting(one, none)
        carrier[..., d:, k:] = np.diag(memory.kept(one))
        before = np.zeros((n, d + k, 2 * k))
        before[:, d:, k:] = np.diag(np.sqrt(memory.steady(one)))
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
            np.r_[self.prior, none],
            before,
        )

    def mixed(self, mixing: Array | None) -> "Chains":
        """Return these chains as pushes drive them each of which acts on several joints.

        `mixing` (n_chains, k, k): forces on k joints are this times k pushes, as are those of memory.
        """
        if mixing is None or not mixing.shape[-1]:
            return self
        blocks = np.kron(np.eye(self.carrier.shape[-1] // mixing.shape[-1]), mixing)
        before = None if self.before is None else self.before @ blocks
        return replace(self, carrier=self.carrier @ blocks[:, None], before=before)

    @cached_property
    def parts(self) -> tuple[tuple[Places, Places], ...]:
        """Channels, and the forces on them, of each part; none acts on another in any step."""
        d, k = self.carrier.shape[-2:]
        acts = np.zeros((d + k, d + k), dtype=bool)
        acts[:d, :d] = np.any(self.transitions, axis=(0, 1)) | np.any(self.bends, axis=(0, 1))
        acts[:d, d:] = np.any(self.carrier, axis=(0, 1))
        number, label = connected_components(acts, directed=False)
        parts = [np.flatnonzero(label == one) for one in range(number)]
        # A force that moves nothing is of no part.
        return tuple((own[own < d], own[own >= d] - d) for own in parts if own[0] < d)

    def part(self, channels: Places, forces: Places) -> "Chains":
        """Return some of the channels, with the forces on them."""
        return Chains(
            block(self.transitions, channels),
            self.drive[..., channels],
            block(self.bends, channels),
            self.carrier[..., channels[:, None], forces],
            self.measured[..., channels],
            self.mask[..., channels],
            self.prior[channels],
            None if self.before is None else self.before[:, channels[:, None], forces],
        )


def block(matrices: Array, places: Places) -> Array:
    """Return the rows and columns of matrices at some places."""
    return matrices[..., places[:, None], places]
