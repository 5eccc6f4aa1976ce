"""What changed on robots over time, and which names of a fleet hold together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit
from scipy.stats import false_discovery_control

from skat.diagnosis.fitting import on_logarithm, value_at
from skat.effects import Effect

Array = NDArray[np.float64]
# Degrees of freedom that the errors' own word is worth: with none, one that is left of four logs made a coin flip of
# it; with more, errors three times too small make false changes of two robots in five.
WORD = 4


@dataclass(frozen=True)
class Estimate:
    """An effect's coordinate in one log, beside the causes that any log of its robot names.

    Attributes
    ----------
    place, deviation : float
        0 is neutral; of factors, logarithms.
    """

    place: float
    deviation: float


def discoveries(probabilities: Array, rate: float) -> NDArray[np.bool_]:
    """Return which of many named causes hold if a share of them may be false.

    As many of the likeliest as are false in the mean no more often than `rate` [1]_.

    Parameters
    ----------
    probabilities : ndarray of shape (n,)
    rate : float

    References
    ----------
    .. [1] Newton, Noueiry, Sarkar, Ahlquist (2004). Detecting differential gene expression with a semiparametric
       hierarchical mixture method. Biostatistics 5(2).
    """
    order = np.argsort(-probabilities, kind="stable")
    false = np.cumsum(1 - probabilities[order]) / np.arange(1, len(order) + 1)
    held = np.zeros(len(order), dtype=bool)
    held[order] = false <= rate
    return held


def drifts_of(
    estimates: Mapping[str, Sequence[Mapping[str, Estimate]]],
    times: Mapping[str, Sequence[object]],
    effects: Mapping[str, Effect],
    asked: Mapping[str, Sequence[str]],
    *,
    rate: float = 0.05,
) -> pd.DataFrame:
    """Return what changed on robots between one of their logs and the next.

    An effect's values are taken for one until some log and for another from there on. Where the values of all robots
    scatter about such steps by more than their errors say, the errors are as much larger; that they are right counts as
    much as four degrees of freedom in which they were.

    Parameters
    ----------
    estimates : mapping from robot to sequence of mappings from name to Estimate
        Of each log, in the order of time.
    times : mapping from robot to sequence
        When each log was measured.
    effects : mapping from name to Effect
    asked : mapping from robot to names
        Effects that are asked about.
    rate : float, default=0.05
        Share of what is told that may be false [1]_.

    Returns
    -------
    DataFrame
        With columns robot, effect, since, before, after, change, low, high, unit, neutral and p. `change` is a ratio of
        factors and a difference of others; low and high are its 95 % interval; neutral is the value of the model as
        given; p that it is none.

    References
    ----------
    .. [1] Benjamini, Hochberg (1995). Controlling the false discovery rate. J. R. Stat. Soc. B 57(1).
    """
    steps = []
    for robot, logs in estimates.items():
        for name in asked[robot]:
            known = [index for index, one in enumerate(logs) if name in one]
            if len(known) > 1:
                places, deviations = (
                    np.array([getattr(logs[index][name], part) for index in known])
                    for part in ("place", "deviation")
                )
                step = _step_of(places, deviations)
                steps.append((robot, name, times[robot][known[step.split]], step))
    rows = []
    for name in dict.fromkeys(one[1] for one in steps):
        own = [(robot, since, step) for robot, other, since, step in steps if other == name]
        free = WORD + sum(step.free for *_, step in own)
        scatter = max(1.0, (WORD + sum(step.scatter for *_, step in own)) / free)
        for robot, since, step in own:
            error = step.error * np.sqrt(scatter)
            p = min(1.0, 2 * step.tries * float(stdtr(free, -abs(step.last - step.first) / error)))
            half = -float(stdtrit(free, 0.025)) * error
            effect = effects[name]
            rows.append((robot, name, since, *_values(effect, step, half), effect.unit, effect.neutral, p))
    names = ["robot", "effect", "since", "before", "after", "change", "low", "high", "unit", "neutral", "p"]
    table = pd.DataFrame(rows, columns=names)
    if table.empty:
        return table
    kept = false_discovery_control(table["p"].to_numpy(float)) <= rate
    return table[kept].sort_values("p", kind="stable").reset_index(drop=True)


@dataclass(frozen=True)
class _Step:
    """The likeliest step in a series.

    Attributes
    ----------
    split, tries : int
        Place of the first value behind it, of so many that there are.
    first, last, error : float
        Coordinates on either side, and the standard deviation of their difference.
    scatter : float
        Sum of squares about both, in units of the errors.
    free : int
        How many degrees of freedom that sum has: two means and the place were chosen.
    """

    split: int
    tries: int
    first: float
    last: float
    error: float
    scatter: float
    free: int


def _step_of(places: Array, deviations: Array) -> _Step:
    """Return where a step is likeliest, and how large it is."""
    weights = deviations**-2.0
    sums, moments = np.cumsum(weights), np.cumsum(weights * places)
    before, after = sums[:-1], sums[-1] - sums[:-1]
    first, last = moments[:-1] / before, (moments[-1] - moments[:-1]) / after
    errors = np.sqrt(1 / before + 1 / after)
    at = int(np.argmax(np.abs(last - first) / errors))
    means = np.where(np.arange(len(places)) <= at, first[at], last[at])
    scatter, free = float(weights @ (places - means) ** 2), max(len(places) - 3, 0)
    return _Step(at + 1, len(places) - 1, first[at], last[at], errors[at], scatter if free else 0.0, free)


def _values(effect: Effect, step: _Step, half: float) -> tuple[float, float, float, float, float]:
    """Return the values before and after a step, how large it is, and its interval."""
    first, last = (value_at(effect, place) for place in (step.first, step.last))
    size = step.last - step.first
    ends = np.array([size, size - half, size + half])
    change, low, high = np.exp(ends) if on_logarithm(effect) else ends
    return first, last, float(change), float(low), float(high)
