"""Windows of a log as sums of products, with a normal law of some columns integrated out, and drawn with replacement.

Of a model that is not right a long log is sure of whichever set fits best, though its windows may not agree. So sets
have the mean of the probabilities that pairs of logs of windows drawn from both give them: a bagged posterior [1]_.

References
----------
.. [1] Huggins, Miller (2019). Robust inference and model criticism using bagged posteriors. arXiv:1912.07104.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from skat.diagnosis.changes.force_space import Rows
from skat.diagnosis.evidence import SwiftWeigher, Weighed
from skat.diagnosis.filtering import Array

# Pairs of logs of drawn windows.
BAGS = 50


@dataclass(frozen=True)
class Windows:
    """Windows of a log, by the whitened columns N and target z of their rows.

    Attributes
    ----------
    products : ndarray of shape (n_windows, k, k)
        N'N of each: without a unit, as columns are those of typical sizes, over the noise.
    projections : ndarray of shape (n_windows, k)
        N'z of each.
    """

    products: Array
    projections: Array

    @classmethod
    def of(cls, rows: Rows, noise: Array) -> "Windows":
        """Return the windows of rows whose noise has these deviations, (n_rows,), in the rows' units."""
        z, N = rows.whitened(noise)
        own = [rows.stretch == one for one in np.unique(rows.stretch)]
        return cls(np.stack([N[one].T @ N[one] for one in own]), np.stack([N[one].T @ z[one] for one in own]))

    def without(self, spread: Array) -> "Windows":
        """Return these with each window's own effects integrated out.

        ``spread`` (n_effects,) holds the variances of the first columns, of which each window has its own.
        """
        which = np.arange(len(spread))
        found = [integrated(G, h, which, 1 / spread) for G, h in zip(self.products, self.projections)]
        return Windows(np.stack([G for G, _ in found]), np.stack([h for _, h in found]))

    def drawn(self, times: Array) -> tuple[Array, Array]:
        """Return the sums of products (k, k) and projections (k,), each window so many times (n_windows,)."""
        return np.tensordot(times, self.products, 1), times @ self.projections

    def every(self) -> tuple[Array, Array]:
        """Return the sums of products and projections."""
        return self.drawn(np.ones(len(self.products)))

    def own_share(self, spread: Array) -> float:
        """Return by how much z'z falls with each window's own effects, of variances (n_effects,)."""
        k = len(spread)
        return sum(
            float(h[:k] @ np.linalg.solve(G[:k, :k] + np.diag(1 / spread), h[:k]))
            for G, h in zip(self.products, self.projections)
        )


def integrated(
    products: Array, projections: Array, which: NDArray[np.intp], weights: Array
) -> tuple[Array, Array]:
    """Return products and projections of all columns, with those of a normal law of given weights integrated out.

    Parameters
    ----------
    products, projections : ndarray of shape (k, k) and (k,)
        N'N and N'z of whitened rows.
    which : ndarray of int of shape (m,)
        Columns whose values the law is of.
    weights : ndarray of shape (m,)
        Precisions of the law, which has mean zero.
    """
    held = products[np.ix_(which, which)] + np.diag(weights)
    unit = 1 / np.sqrt(np.diag(held))
    cross = products[:, which] * unit
    right = np.column_stack([cross.T, unit * projections[which]])
    solved = np.linalg.solve(held * unit * unit[:, None], right)
    return products - cross @ solved[:, :-1], projections - cross @ solved[:, -1]


def drawn_windows(sides: Sequence[Windows]) -> list[tuple[Array, ...]]:
    """Return how often each window of either log, (n_windows,), is in each of BAGS pairs of logs of drawn windows."""
    rng = np.random.default_rng(0)
    counts = [len(side.products) for side in sides]
    return [tuple(rng.multinomial(n, np.full(n, 1 / n)).astype(float) for n in counts) for _ in range(BAGS)]


class Bagged(SwiftWeigher):
    """Weighs sets by the mean of their probabilities over logs of drawn windows.

    Parameters
    ----------
    whole : SwiftWeigher
        Of both logs as they are.
    bags : sequence of SwiftWeigher
        Of drawn windows.
    pool : sequence of tuple of int
        The sets that probabilities are shared out between.
    """

    def __init__(self, whole: SwiftWeigher, bags: Sequence[SwiftWeigher], pool: Sequence[tuple[int, ...]]):
        super().__init__(whole.gram, whole.priors, rivals=whole.rivals)
        self.whole, self.bags = whole, bags
        self.totals = [float(logsumexp([worth(members).evidence for members in pool])) for worth in bags]

    def _weighed(self, members: tuple[int, ...]) -> Weighed:
        ours, theirs = self.whole(members), [worth(members) for worth in self.bags]
        shares = [one.evidence - total for one, total in zip(theirs, self.totals)]
        curvature = ours.curvature
        if members:
            off = np.array([one.values for one in theirs]) - ours.values
            curvature = np.asarray(np.linalg.inv(ours.covariance + off.T @ off / len(off)))
        return replace(ours, evidence=float(logsumexp(shares) - np.log(len(shares))), curvature=curvature)
