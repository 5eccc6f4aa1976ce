"""Laws that forces may follow: of a coordinate, binned or of a known form, and what there is for each of them.

A force that is a law of rows is some columns of them times strengths with a normal law; whoever has a log says by a
quadratic, ``quadratic(columns)``, what it tells of strengths: G and b of the log likelihood ``b'x - x'Gx / 2``.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from skat.diagnosis.chains import Array, Places
from skat.diagnosis.evidence import WIDTH_95
from skat.diagnosis.statespace import steps_of
from skat.simulators import Simulator

# Bins of a law of a joint's own coordinate, and of any other.
OWN_BINS, OTHER_BINS = 12, 5
# Sizes of a law that are tried, over the force on the joint.
SIZES = (0.01, 0.03, 0.1, 0.3, 1.0)
# Laws of other joints' coordinates are tried up to so many columns in all.
MOST_COLUMNS = 1500
# Ways, as shares of a joint's travel, over which a force forgets where the joint came from: a cable's, a tendon's.
WAYS = (0.03, 0.1, 0.3)

Quadratic = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Law:
    """A force as a function of one coordinate.

    `coordinate`: an input, "time", a product of two inputs, or `PAST`. `edges` (n_bins + 1,). `mean`, `low`, `high`
    (n_bins,): force in each bin, and its 95 % interval.
    """

    coordinate: str
    edges: Array
    mean: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class Regressor:
    """What may predict a force: columns of it, and the coordinate that they are of."""

    name: str
    coordinate: str
    values: Array  # (n_rows,)
    columns: Array  # (n_rows, k)
    is_own: bool


@dataclass(frozen=True)
class Likeliest:
    """The regressor of a direction that most speaks for, its size, and the evidence that there is for any, nats."""

    regressor: Regressor
    size: float
    evidence: float

    def strengths(self, G: Array, b: Array) -> Array:
        """Return the strengths of its columns, held by a normal law of its size."""
        return np.asarray(np.linalg.solve(G + np.eye(len(b)) / self.size**2, b), dtype=np.float64)

    def law(self, quadratic: Quadratic) -> Law:
        """Return the force in bins of its coordinate, of such a size."""
        edges, columns = bins_of(self.regressor.values, OWN_BINS)
        G, b = quadratic(columns)
        half = WIDTH_95 * np.sqrt(np.diag(np.linalg.inv(G + np.eye(len(G)) / self.size**2)))
        mean = self.strengths(G, b)
        return Law(self.regressor.coordinate, edges, mean, mean - half, mean + half)


def likeliest(
    regressors: Sequence[Regressor], quadratic: Quadratic, scale: float, n_directions: int
) -> Likeliest:
    """Return the likeliest law of one of some directions; `scale` is the force there."""
    # Own laws have half of the weight for themselves.
    n_own = sum(one.is_own for one in regressors)
    n_other, tried = len(regressors) - n_own, []
    for one in regressors:
        nats, size = worth_of(*quadratic(one.columns), scale)
        weight = (0.5 if n_other else 1.0) / n_own if one.is_own else 0.5 / n_other
        tried.append((nats + np.log(weight), size, one))
    _, size, chosen = max(tried, key=lambda entry: entry[0])
    evidence = float(logsumexp([nats for nats, *_ in tried]) - np.log(n_directions))
    return Likeliest(chosen, size, evidence)


def regressors_of(
    simulator: Simulator,
    names: Sequence[str],
    rows: Array,
    own: Sequence[str],
    groups: Places,
    n_directions: int,
) -> list[Regressor]:
    """Return the laws of inputs, of which `rows` are columns, that a force may follow; `own` are those of its joint."""
    places = {name: column for column, name in enumerate(names)}
    first = rows[:, places[own[0]]] if own else np.zeros(len(rows))
    found = [Regressor("constant", own[0] if own else "row", first, np.ones((len(rows), 1)), True)]
    for name in own:
        values = rows[:, places[name]]
        found += binned(name, values, OWN_BINS, is_own=True)
        if is_rate(name, simulator.units):
            found += single(f"sign({name})", name, values, np.sign(values))
            found += single(f"|{name}|{name}", name, values, np.abs(values) * values)
            for other in (one for one in own if one != name):
                beside = rows[:, places[other]]
                title = f"{other} {name}"
                if other in simulator.state_names:
                    found += single(title, title, beside * values)
                if not is_rate(other, simulator.units):
                    found += single(f"{other} |{name}|", title, beside * values, beside * np.abs(values))
                    found += single(f"{other} {name}^2", title, beside * values, beside * values**2)
        elif simulator.units.get(name) in ("rad", "m"):
            along = unwrapped(values, groups) if simulator.units[name] == "rad" else values
            travel = float(np.ptp(along))
            for share in WAYS:
                title = f"the way of {name}, {share:g} of its travel"
                found += single(title, name, values, way_of(along, groups, share * travel))
    others = [name for name in names if name not in own]
    if len(others) * OTHER_BINS * n_directions <= MOST_COLUMNS:
        for name in others:
            found += binned(name, rows[:, places[name]], OTHER_BINS, is_own=False)
    return found


def unwrapped(angles: Array, groups: Places) -> Array:
    """Return angles that do not jump by turns within an episode; each begins where it does."""
    begins = np.flatnonzero(steps_of(groups) == 0)
    return np.concatenate([np.unwrap(one) for one in np.split(angles, begins[1:])])


def way_of(values: Array, groups: Places, length: float) -> Array:
    """Return how far a coordinate came, what lies further back than a length along its way forgotten, by episode.

    A force of it is one that pulls back and gives way: hysteresis.
    """
    begins = steps_of(groups) == 0
    moved = np.where(begins, 0.0, np.diff(values, prepend=values[0]))
    kept = np.where(begins, 0.0, np.exp(-np.abs(moved) / max(length, 1e-300)))
    came, way = 0.0, np.empty(len(values))
    for row, (share, step) in enumerate(zip(kept, np.sign(moved) * length * (1 - kept))):
        came = way[row] = share * came + step
    return way


def is_rate(name: str, units: Mapping[str, str]) -> bool:
    """Whether an input is a speed."""
    return name.startswith("qvel.") or units.get(name, "").endswith("/s")


def single(name: str, coordinate: str, values: Array, column: Array | None = None) -> list[Regressor]:
    """Return the regressor of one column, by default the coordinate's values; none where it is zero."""
    column = values if column is None else column
    size = float(np.sqrt(np.mean(column**2)))
    if size == 0:
        return []
    return [Regressor(name, coordinate, values, column[:, None] / size, True)]


def binned(name: str, values: Array, n_bins: int, *, is_own: bool) -> list[Regressor]:
    """Return the regressor that has a value in each bin of a coordinate; none where there are no two."""
    columns = bins_of(values, n_bins)[1]
    return [Regressor(name, name, values, columns, is_own)] if columns.shape[1] > 1 else []


def bins_of(values: Array, n_bins: int) -> tuple[Array, Array]:
    """Return edges, and which bin each row is in as columns: bins of about as many rows, equal values in one.

    Few values, such as those of a command that is on or off, have a bin each.
    """
    levels, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    middles = (np.cumsum(counts) - counts / 2) / len(values)
    bins = np.unique((n_bins * middles).astype(int), return_inverse=True)[1]
    last = np.flatnonzero(np.diff(bins))
    between = (levels[last] + levels[last + 1]) / 2
    edges: Array = np.r_[levels[0], between, max(levels[-1], np.nextafter(levels[0], np.inf))]
    return edges, np.eye(len(edges) - 1)[bins[place]]


def worth_of(G: Array, b: Array, scale: float) -> tuple[float, float]:
    """Return what a law is worth, nats, as a mean over its sizes, and the size that is best."""
    values, vectors = np.linalg.eigh(G)
    values, turned = np.maximum(values, 0.0), vectors.T @ b
    each = []
    for size in SIZES:
        prior = (size * scale) ** 2
        nats = 0.5 * np.sum(turned**2 * prior / (1 + prior * values)) - 0.5 * np.sum(np.log1p(prior * values))
        each.append(float(nats))
    return float(logsumexp(each) - np.log(len(SIZES))), SIZES[int(np.argmax(each))] * scale
