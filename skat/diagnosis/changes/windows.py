"""Log likelihoods of rows as quadratics in effects, window by window, with what follows a normal law integrated out."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np

from skat.diagnosis.chains import Array
from skat.diagnosis.forces.force_space import Rows


@dataclass(frozen=True)
class Quadratic:
    r"""Log likelihood of whitened rows, a quadratic in effects x: :math:`c + h'x - x'Gx / 2`.

    Attributes
    ----------
    products : ndarray of shape (k, k)
        G, without a unit, as columns are those of typical sizes, over the noise.
    projections : ndarray of shape (k,)
        h.
    level : float
        c, nats; constants of the noise are left out.
    """

    products: Array
    projections: Array
    level: float

    @classmethod
    def of(cls, target: Array, columns: Array) -> "Quadratic":
        """Return that of whitened rows, (n_rows,) and (n_rows, k)."""
        return cls(columns.T @ columns, columns.T @ target, -0.5 * float(target @ target))

    def __add__(self, other: "Quadratic") -> "Quadratic":
        """Return that of the rows of both."""
        return Quadratic(
            self.products + other.products, self.projections + other.projections, self.level + other.level
        )

    def __sub__(self, other: "Quadratic") -> "Quadratic":
        """Return that of the rows without those of another."""
        return self + Quadratic(-other.products, -other.projections, -other.level)

    def widened(self, k: int) -> "Quadratic":
        """Return the same of so many effects, of which the further ones do nothing."""
        more = k - len(self.projections)
        return Quadratic(np.pad(self.products, (0, more)), np.pad(self.projections, (0, more)), self.level)

    def integrated(self, weights: Array) -> "Quadratic":
        """Return that of rows in which the first effects differ by a normal law of such precisions, (m,), from x."""
        m = len(weights)
        held = self.products[:m, :m] + np.diag(weights)
        unit = 1 / np.sqrt(np.diag(held))
        scaled = held * unit * unit[:, None]
        cross, right = self.products[:, :m] * unit, unit * self.projections[:m]
        solved = np.linalg.solve(scaled, np.column_stack([cross.T, right]))
        told = (
            float(right @ solved[:, -1])
            - np.linalg.slogdet(scaled)[1]
            - np.sum(np.log(1 / unit**2 / weights))
        )
        return Quadratic(
            self.products - cross @ solved[:, :-1],
            self.projections - cross @ solved[:, -1],
            self.level + 0.5 * float(told),
        )

    def without(self, m: int) -> "Quadratic":
        """Return that of the further effects, where the first m are zero."""
        return Quadratic(self.products[m:, m:], self.projections[m:], self.level)


def windows_of(rows: Rows, noise: Array, spread: Array) -> tuple[Quadratic, ...]:
    """Return the windows of rows, with what each has of its own integrated out.

    Parameters
    ----------
    rows : Rows
    noise : ndarray of shape (n_rows,)
        Deviations, in the rows' units.
    spread : ndarray of shape (n_effects,)
        Variances by which the first effects differ from window to window.
    """
    z, N = rows.whitened(noise)
    own = [rows.stretch == one for one in np.unique(rows.stretch)]
    return tuple(Quadratic.of(z[one], N[one]).integrated(1 / spread) for one in own)


def total(windows: Sequence[Quadratic]) -> Quadratic:
    """Return the log that has these windows."""
    return reduce(add, windows)
