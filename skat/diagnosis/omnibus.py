r"""Whether anything is left that no effect explains, and what shape it has.

What is left is tested against additive errors :math:`B_j \phi(c)` of the prediction: a direction j (a force on a joint
where the simulator knows forces, or an error of one output) times any piecewise linear function of one input c. Each
pair (j, c) is a score test with a few degrees of freedom; rows say how much the scores vary. Whether what is left
outlasts single rows, as what changes with time does, is tested for each channel, too. The smallest p-value counts,
corrected for their number. Laws of friction, springs and motors depend on a joint's own position, speed and command, so
the few pairs of that kind have half of the level for themselves; and as most such laws are odd, these pairs are tested
for odd functions, too, which have finer pieces for as many degrees of freedom.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from skat.diagnosis.evidence import family_p_value, solve_scaled
from skat.diagnosis.residuals import robust_weights

KNOTS = 4
LONGEST_TABLE = 10
# What is left is compared with itself so many rows on, residuals cut at so many standard deviations.
LAGS = range(4, 16)
LARGEST_RESIDUAL = 4.0
TIME = "time"
# Pairs count as seen below this p-value, corrected for their number.
CLEAR = 0.01
# What acts on a joint mostly depends on that joint: another input must explain so many times more to be named.
OWN_LAW = 1.25
# In noise units: an error that explains less is rounding, however regular.
LEAST_EXPLAINED = 1.0


@dataclass(frozen=True)
class Remainder:
    """What is left of the residuals after the named effects.

    Attributes
    ----------
    p_value : float
        Family-wise chance of so much structure where nothing is left.
    direction : str
        Where the error acts that explains most of those that are clear: a joint, which a force acts on, or an output.
    coordinate : str
        The input it depends on, if on any.
    table : tuple of (direction, coordinate, p_value)
        The most telling pairs; of those that are clear, the one first that explains most, a joint's or an output's law
        of its own counting a fourth more. p-values are not corrected for the number of pairs.
    varies : float
        p-value of the error's varying with any coordinate, beside a constant error.
    """

    p_value: float
    direction: str
    coordinate: str
    table: tuple
    varies: float = 0.0

    @property
    def sentence(self):
        """What is left, in words."""
        if self.coordinate == TIME:
            return f"something acts on {self.direction} for longer than single rows, and no effect known explains it"
        if self.varies >= CLEAR:
            return (
                f"something acts on {self.direction}, always alike as far as the log shows, and no effect known "
                "explains it"
            )
        return f"something acts on {self.direction} that depends on {self.coordinate}, and no effect known explains it"


def is_structured(remainder, alpha):
    """Whether a Remainder, or None, has a shape that noise would have more rarely than a share of alpha allows."""
    return remainder is not None and remainder.p_value < alpha / 4


@dataclass(frozen=True)
class _Pair:
    """An error that acts in a direction as a function of a coordinate: its p-value, and the loss it would explain."""

    direction: str
    coordinate: str
    p_value: float
    explained: float = 0.0


def find_remainder(residuals, line, fitted):
    """Return the Remainder of a linearisation at a model, or None where there is nothing to test.

    Parameters
    ----------
    residuals : Residuals
    line : Linearisation
    fitted : sequence of str
        Effects of the model, which the test projects out.
    """
    columns, directions = residuals.directions(line.values)
    own_laws, others = _shapes(residuals, _ScoreTests(residuals, line, fitted), columns, directions)
    others += _persistence(residuals, line.residuals)
    families = [family for family in (own_laws, others) if family]
    if not families:
        return None
    smallest = [family_p_value(min(pair.p_value for pair in family), len(family)) for family in families]
    p_value = family_p_value(min(smallest), len(families))
    pairs = sorted(own_laws + others, key=lambda pair: pair.p_value)[:LONGEST_TABLE]
    if pairs[0].coordinate != TIME:
        # Where p-values are tiny, which one is the tiniest says little of what is left.
        level = CLEAR / len(own_laws + others)
        clear, rest = ([pair for pair in pairs if (pair.p_value < level) is one] for one in (True, False))
        pairs = sorted(clear, key=lambda pair: -pair.explained * (OWN_LAW if pair in own_laws else 1)) + rest
    table = tuple((pair.direction, pair.coordinate, pair.p_value) for pair in pairs)
    varies = 0.0
    if pairs[0].coordinate != TIME:
        index = [direction for direction, _ in directions].index(pairs[0].direction)
        column = columns[..., [index]]
        beside_constant = _ScoreTests(residuals, line, fitted, residuals.whiten(column))
        values = residuals.points[:, residuals.simulator.input_names.index(pairs[0].coordinate)]
        tested = [beside_constant.of(column, basis(values)) for basis in (hat_functions, odd_functions)]
        # The coordinate is the best of all.
        n_tried = len(tested) * len(residuals.simulator.input_names)
        varies = family_p_value(min(p for ((p, _),) in tested), n_tried)
    return Remainder(p_value, *table[0][:2], table, varies)


def _shapes(residuals, tests, columns, directions):
    """Return the pairs of a direction with an input: those of a joint's or an output's own law, and all others."""
    own_laws: list[_Pair] = []
    others: list[_Pair] = []
    if not directions:
        return own_laws, others
    for index, coordinate in enumerate(residuals.simulator.input_names):
        values = residuals.points[:, index]
        found = tests.of(columns, hat_functions(values))
        own = [j for j, (_, inputs) in enumerate(directions) if coordinate in inputs]
        for j, odd in zip(own, tests.of(columns[..., own], odd_functions(values)) if own else ()):
            best = min(found[j], odd)
            found[j] = family_p_value(best[0], 2), best[1]
        for j, (direction, _) in enumerate(directions):
            (own_laws if j in own else others).append(_Pair(direction, coordinate, *found[j]))
    return own_laws, others


class _ScoreTests:
    """Score tests of additive errors of the prediction, with the effects of the model projected out.

    So are whitened columns (n_rows, n_channels, n_columns) that are given beside them.
    """

    def __init__(self, residuals, line, fitted, beside=None):
        self.residuals = residuals
        # Rows without time order that were given in groups may have something in common.
        self.groups = None if residuals.log.consecutive else residuals.blocks
        weights = robust_weights(line.residuals)[:, None]
        derivatives = line.derivatives[..., [line.names.index(name) for name in fitted]]
        if beside is not None:
            derivatives = np.concatenate([derivatives, beside], axis=-1)
        self.weighted_residuals = line.residuals * weights
        self.weighted = derivatives * weights[..., None]
        self.information = np.einsum("ndk,ndl->kl", self.weighted, derivatives)
        self.scores = np.einsum("ndk,nd->nk", self.weighted, line.residuals)
        self.weights = weights

    def of(self, columns, basis):
        """Return (p-value, loss explained) of each direction of the columns times any function that the basis spans."""
        # Whitened, what different rows say is uncorrelated where nothing is left; the errors themselves are not.
        errors = columns[..., None] * basis[:, None, None, :]
        white = self.residuals.whiten(errors.reshape(*columns.shape[:2], -1))
        scores = np.einsum("ndm,nd->nm", white, self.weighted_residuals)
        cross = np.einsum("ndm,ndk->km", white, self.weighted)
        carry = solve_scaled(self.information, cross) if len(cross) else cross
        scores = scores - self.scores @ carry
        found = []
        for part in np.split(np.arange(white.shape[-1]), columns.shape[-1]):
            own = white[..., part]
            information = np.einsum("ndl,ndm->lm", own * self.weights[..., None], own)
            information -= cross[:, part].T @ carry[:, part]
            total = scores[:, part].sum(axis=0)
            explained = float(total @ solve_scaled(information, total[:, None])[:, 0])
            p_value = _score_test(self._pieces(scores[:, part])) if explained > LEAST_EXPLAINED else 1.0
            found.append((p_value, explained))
        return found

    def _pieces(self, scores):
        """Return the scores of rows, or of groups where rows are not independent."""
        if self.groups is None:
            return scores
        return np.add.reduceat(scores, np.flatnonzero(np.r_[True, np.diff(self.groups) > 0]), axis=0)


def _persistence(residuals, white):
    """Return the pairs of each channel with TIME, which test whether what is left outlasts single rows.

    Whitened residuals some rows apart are uncorrelated even where the noise is a little misjudged, which neighbours are
    not; an error that is no function of any one input, such as a force that changes with time, is found here. It must
    last in most episodes: a linearisation that failed at one contact echoes through one of them. What is projected out
    of residuals, such as initial states, leaves them correlated, by so much as is taken off here.
    """
    if not residuals.log.consecutive:
        return []
    clipped = np.clip(white, -LARGEST_RESIDUAL, LARGEST_RESIDUAL)
    pieces, _ = residuals.log.chains()
    starts = np.flatnonzero(np.r_[True, np.diff(pieces) > 0])
    statistics = np.zeros(clipped.shape[1])
    taken = residuals.taken()
    variances = np.mean(clipped**2, axis=0) / (1 - np.mean(np.sum(taken**2, axis=-1), axis=0))
    for lag in LAGS:
        # Whitening begins anew with each piece, so what lies on both sides of its beginning is correlated.
        together = pieces[lag:] == pieces[:-lag]
        products = np.zeros_like(clipped)
        expected = -variances * np.sum(taken[lag:] * taken[:-lag], axis=-1)
        products[lag:] = (clipped[lag:] * clipped[:-lag] - expected) * together[:, None]
        sums = np.add.reduceat(products, starts)
        statistics += sums.sum(axis=0) ** 2 / np.maximum((sums**2).sum(axis=0), 1e-300)
    p_values = stats.chi2.sf(statistics, len(LAGS))
    return [_Pair(name, TIME, float(p)) for name, p in zip(residuals.channels, p_values)]


def hat_functions(values):
    """Return piecewise linear functions (n_rows, at most KNOTS) that sum to 1, knots at quantiles."""
    knots = np.unique(np.quantile(values, np.linspace(0.02, 0.98, KNOTS)))
    if len(knots) < 2:
        return np.ones((len(values), 1))
    return np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))], axis=1)


def odd_functions(values):
    """Return odd functions (n_rows, at most KNOTS) that are piecewise linear on either side of 0 and may jump there."""
    return np.sign(values)[:, None] * hat_functions(np.abs(values))


def _score_test(scores):
    """Return the p-value of the scores of rows, or of groups of them, having mean zero (Hotelling)."""
    scores = scores[np.abs(scores).max(axis=1) > 0]
    count = len(scores)
    if not count:
        return 1.0
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
