"""Whether several logs of one robot that were fitted together agree on what its model gets wrong."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

from skat.diagnosis.chains import Array
from skat.diagnosis.evidence import WIDTH_95, Gram
from skat.diagnosis.fitting import around, gram_of, slopes_of, value_at
from skat.diagnosis.found import Found
from skat.diagnosis.statespace import StateSpace
from skat.effects import Effect

# Logs of a robot that stayed the same are said to differ, in any cause, in so many of all comparisons.
LEVEL = 0.01
# Of a typical size: how far off values may be before anything was measured of them.
FAR = 1e3
NAMED, NO_INTERVAL = "named", "no interval"
# Of an effect that is no cause, by which several logs that were fitted together differ.
ESTIMATED = "estimated"


def table_of(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> pd.DataFrame:
    """Return rows of causes as a table, with p-values corrected for all of them, and whether the logs agree."""
    each = [f"{what} in {name}" for name in names for what in ("value", "low", "high", "status")]
    table = pd.DataFrame(rows, columns=["cause", "unit", *each, "n_compared", "chi_square", "p_value"])
    table["p_corrected"] = _holm(table["p_value"].to_numpy(dtype=float))
    table["agreement"] = [
        "not compared" if math.isnan(p) else "differ" if p < LEVEL else "agree" for p in table["p_corrected"]
    ]
    return table


def shared_causes(space: StateSpace, found: Found, names: Sequence[str]) -> pd.DataFrame:
    """Return what each of several logs says of each cause that they share, the other causes being shared.

    By the slopes of their fit, each cause is given a value in each log; scores are trusted as far as blocks of time
    agree on them. Where the logs agree on all causes and not on an effect that is none, this has a row as well: it may
    act in one log alone, or up in one and down in another.

    `space`: the logs. `found`: of all of them. `names`: of the logs. Returns: with the columns of `compare_findings`; a
    log that tells nothing of a cause has "no interval", and of an effect that is none the status is "estimated".
    `p_corrected` is for all effects that were asked about.
    """
    scales, effects = found.priors.scales, found.effects
    slopes = slopes_of(space, found.fitted, effects, scales, means=True)
    columns = gram_of(space, found.fitted, slopes, effects)
    mask = found.fitted.chains.mask
    origin = np.broadcast_to(space.origin[:, None, None], mask.shape)[mask]
    excess = columns.excess(columns.whitened, origin)
    grams = []
    for log in range(len(names)):
        own = columns.columns[origin == log]
        gram = Gram(own.T @ own, own.T @ columns.whitened[origin == log], columns.gram.origin)
        grams.append(gram.scattered(excess))
    causes = [place for place, effect in enumerate(effects) if effect.name in found.values]
    rows = [_shared(place, causes, effects, grams, scales, names) for place in range(len(effects))]
    table = table_of(rows, names)
    named = table["cause"].isin(list(found.values))
    if "differ" in set(table["agreement"][named]):
        return table[named].reset_index(drop=True)
    apart = table[~named & (table["agreement"] == "differ")].nsmallest(1, "p_value")
    return pd.concat([table[named], apart], ignore_index=True)


def _shared(
    place: int,
    causes: Sequence[int],
    effects: Sequence[Effect],
    grams: Sequence[Gram],
    scales: Array,
    names: Sequence[str],
) -> dict[str, Any]:
    """Return the row of an effect that has a value in each log, beside causes that have one in all."""
    effect, others = effects[place], [one for one in causes if one != place]
    n, k = len(grams), len(others)
    status = NAMED if place in causes else ESTIMATED
    A, b = np.zeros((k + n, k + n)), np.zeros(k + n)
    for log, gram in enumerate(grams):
        A[:k, :k] += gram.products[np.ix_(others, others)]
        A[:k, k + log] = A[k + log, :k] = gram.products[others, place]
        A[k + log, k + log] = gram.products[place, place]
        b[:k] += gram.projections[others]
        b[k + log] = gram.projections[place]
    units = np.r_[scales[others], np.full(n, scales[place])]
    # What a log says nothing of stays where it is, and is hardly held there.
    covariance = np.linalg.inv(A * units * units[:, None] + np.eye(k + n) / FAR**2) * units * units[:, None]
    moves, covariance = (covariance @ b)[k:], covariance[k:, k:]
    deviations = np.sqrt(np.diag(covariance))
    told = np.flatnonzero(deviations < FAR / 10 * scales[place])
    said, chi_square = {}, math.nan
    for log, name in enumerate(names):
        value = value_at(effect, grams[log].origin[place] + moves[log])
        low, high = around(effect, value, WIDTH_95 * deviations[log])
        said[name] = Said(status, value, low, high) if log in told else Said(NO_INTERVAL)
    if len(told) > 1:
        apart = np.eye(len(told))[1:] - np.eye(len(told))[0]
        off, spread = apart @ moves[told], apart @ covariance[np.ix_(told, told)] @ apart.T
        chi_square = float(off @ np.linalg.solve(spread, off))
    return row_of(effect.name, effect.unit, said, chi_square)


def differing(table: pd.DataFrame) -> list[str]:
    """Return the causes on which logs do not agree, of a table of `compare_findings` or `shared_causes`."""
    return list(table.loc[table["agreement"] == "differ", "cause"])


@dataclass(frozen=True)
class Said:
    """What a log says of a cause: its status there, its value and interval, NaN where there is none."""

    status: str
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan


def row_of(cause: str, unit: str, said: Mapping[str, Said], chi_square: float) -> dict[str, Any]:
    """Return the row of a cause: what each log says of it, and by how much they differ."""
    row: dict[str, Any] = {"cause": cause, "unit": unit}
    for name, one in said.items():
        row |= {f"value in {name}": one.value, f"low in {name}": one.low, f"high in {name}": one.high}
        row[f"status in {name}"] = one.status
    n = sum(one.status in (NAMED, ESTIMATED) for one in said.values())
    p_value = float(chi2.sf(chi_square, n - 1)) if n > 1 else math.nan
    return row | {"n_compared": n, "chi_square": chi_square, "p_value": p_value}


def _holm(p_values: Array) -> Array:
    """Return p-values as they count among each other; NaN, of no test, stays so and does not count."""
    corrected = np.full(len(p_values), np.nan)
    tests = np.flatnonzero(~np.isnan(p_values))
    order = tests[np.argsort(p_values[tests])]
    times = np.arange(len(order), 0, -1)
    corrected[order] = np.minimum(np.maximum.accumulate(times * p_values[order]), 1.0)
    return corrected
