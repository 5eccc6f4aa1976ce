r"""Whether anything is left that no effect explains, and what shape it has.

What is left is tested against additive errors :math:`B_j \phi(c)` of the prediction: a direction j (a force on a joint
where the simulator knows forces, otherwise an error of one output) times any piecewise linear function of one input c.
Each pair (j, c) is a cluster-robust score test with a few degrees of freedom. Whether it outlasts single rows, as what
changes with time does, is tested for each channel, too. The smallest p-value counts, corrected for their number. Laws
of friction, springs and motors depend on a joint's own position, speed and command, so the few pairs of that kind have
half of the level for themselves.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from skat.diagnosis.evidence import family_p_value, solve_scaled
from skat.diagnosis.residuals import robust_weights

KNOTS = 4
# What is left is compared with itself so many rows on, residuals cut at so many standard deviations.
LAGS = range(4, 16)
LARGEST_RESIDUAL = 4.0
TIME = "time"
# Rows whose scores count as one: whitened rows are uncorrelated where nothing is left.
ROWS_TOGETHER = 3


@dataclass(frozen=True)
class Remainder:
    """What is left of the residuals after the named effects.

    Attributes
    ----------
    p_value : float
        Family-wise chance of so much structure where nothing is left.
    direction : str
        Where the most telling error acts: a joint, or an output.
    coordinate : str
        The input it depends on.
    table : list of tuple (direction, coordinate, p_value)
        The most telling pairs, each p-value by itself.
    """

    p_value: float
    direction: str
    coordinate: str
    table: tuple

    @property
    def sentence(self):
        """What is left, in words."""
        if self.coordinate == TIME:
            return f"something acts on {self.direction} for longer than single rows and is none of the effects known"
        return f"something acts on {self.direction} that depends on {self.coordinate} and is none of the effects known"


def find_remainder(residuals, line, fitted):
    """Return the Remainder of a linearisation at a model, or None where there is no direction to test.

    Parameters
    ----------
    residuals : Residuals
    line : Linearisation
    fitted : sequence of str
        Effects of the model, which the test projects out.
    """
    directions, names = residuals.directions(line.values)
    weights = robust_weights(line.residuals)[:, None]
    inside = [line.names.index(name) for name in fitted]
    derivatives = line.derivatives[..., inside]
    weighted = derivatives * weights[..., None]
    information = np.einsum("ndk,ndl->kl", weighted, derivatives)
    starts = np.arange(0, len(residuals.blocks), ROWS_TOGETHER)
    own = np.add.reduceat(np.einsum("ndk,nd->nk", weighted, line.residuals), starts, axis=0)
    found = []
    for index, coordinate in enumerate(residuals.simulator.input_names if names else ()):
        basis = hat_functions(residuals.points[:, index])
        n_rows, n_channels, n_directions = directions.shape
        # Whitened, what different rows say is uncorrelated; the errors themselves are not.
        columns = residuals.whiten(
            (directions[..., None] * basis[:, None, None, :]).reshape(n_rows, n_channels, -1)
        )
        scores = np.add.reduceat(np.einsum("ndm,nd->nm", columns, line.residuals * weights), starts, axis=0)
        if inside:
            cross = np.einsum("ndm,ndk->km", columns, weighted)
            scores = scores - own @ solve_scaled(information, cross)
        for direction, part in zip(names, np.split(scores, n_directions, axis=1)):
            found.append((direction, coordinate, _score_test(part)))
    if not found:
        return None
    found += _persistence(residuals, line.residuals)
    found.sort(key=lambda row: row[2])
    own_laws = [row for row in found if _element(row[0]) == _element(row[1])]
    others = [row for row in found if row not in own_laws]
    families = [(family_p_value(rows[0][2], len(rows)), rows[0]) for rows in (own_laws, others) if rows]
    p_value, (direction, coordinate, _) = min(families)
    return Remainder(family_p_value(p_value, len(families)), direction, coordinate, tuple(found[:10]))


def _element(name):
    """Return the joint or motor that a channel belongs to, the channel itself where names do not say."""
    return name.partition(".")[2] or name


def _persistence(residuals, white):
    """Return rows (channel, TIME, p-value) that test whether what is left outlasts single rows.

    Whitened residuals some rows apart are uncorrelated even where the noise is a little misjudged, which neighbours are
    not; an error that is no function of any one input, such as a force that changes with time, is found here. It must
    last in most episodes: a linearisation that failed at one contact echoes through one of them.
    """
    if not residuals.log.consecutive:
        return []
    clipped = np.clip(white, -LARGEST_RESIDUAL, LARGEST_RESIDUAL)
    pieces, _ = residuals.log.chains()
    starts = np.flatnonzero(np.r_[True, np.diff(pieces) > 0])
    statistics = np.zeros(clipped.shape[1])
    for lag in LAGS:
        together = residuals.log.episodes[lag:] == residuals.log.episodes[:-lag]
        products = np.zeros_like(clipped)
        products[lag:] = clipped[lag:] * clipped[:-lag] * together[:, None]
        sums = np.add.reduceat(products, starts)
        statistics += sums.sum(axis=0) ** 2 / np.maximum((sums**2).sum(axis=0), 1e-300)
    p_values = stats.chi2.sf(statistics, len(LAGS))
    return [(name, TIME, float(p)) for name, p in zip(residuals.simulator.residual_names, p_values)]


def hat_functions(values):
    """Return piecewise linear functions (n_rows, at most KNOTS) that sum to 1, knots at quantiles."""
    knots = np.unique(np.quantile(values, np.linspace(0.02, 0.98, KNOTS)))
    if len(knots) < 2:
        return np.ones((len(values), 1))
    return np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))], axis=1)


def _score_test(scores):
    """Return the p-value of block scores having mean zero (Hotelling)."""
    scores = scores[np.abs(scores).max(axis=1) > 0]
    count = len(scores)
    scale = np.sqrt(np.mean(scores**2, axis=0))
    scores = scores[:, scale > 0] / scale[scale > 0]
    if count <= 2 * scores.shape[1] or not scores.shape[1]:
        return 1.0
    mean = scores.mean(axis=0)
    values, vectors = np.linalg.eigh(np.cov(scores.T, ddof=1).reshape(len(mean), len(mean)))
    kept = values > 1e-6 * values[-1]
    freedom = int(kept.sum())
    statistic = count * np.sum((vectors[:, kept].T @ mean) ** 2 / values[kept])
    return float(
        stats.f.sf(statistic * (count - freedom) / (freedom * (count - 1)), freedom, count - freedom)
    )
