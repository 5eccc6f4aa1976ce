"""What a log can show: the smallest size of each effect that would be named, and what it could be taken for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from skat.diagnosis.causes import typical_biases
from skat.diagnosis.chains import Array
from skat.diagnosis.evidence import Gram, Priors, coarsened, weigh
from skat.diagnosis.filtering import kalman_filter
from skat.diagnosis.fitting import SMALL_SHARE, priors_of, response
from skat.diagnosis.log import Log, check_log, check_matrix, checked_episodes, without_channels
from skat.diagnosis.search import TWIN
from skat.diagnosis.slopes import derivatives
from skat.diagnosis.statespace import StateSpace, linearise, state_space, tangents
from skat.effects import Effect
from skat.simulators import Simulator

COMMON_NOISE = 0.01
# At the end of its range an effect differs from its nearest alias by more than this much noise, or by rounding only.
LEAST_APART = 2.0
# An excitation separates two effects if with twice of it the angle's share grows by this factor; so many are tried.
LEAST_GAINED = 1.2
MOST_TRIED = 3
NO_INPUT_SEPARATES = "no single input"
NOTHING_SEPARATES = "nothing in these rows"
# An effect of which the causes found leave a smaller share is not seen beside them.
LEAST_SHARE = 1e-9
# Turns by which the smallest size is found, and as which share two are one: what a prior costs changes slowly with it.
TURNS, CLOSE = 12, 1e-4


def from_neutral(effect: Effect, place: float) -> float:
    """Return the value of an effect that is so far from neutral."""
    return effect.neutral + place


def identifiability(
    gram: Gram,
    priors: Priors,
    effects: Sequence[Effect],
    values: Mapping[str, float],
    *,
    alpha: float = 0.01,
    power: float = 1.0,
    value_at: Callable[[Effect, float], float] = from_neutral,
) -> pd.DataFrame:
    """Return a table of what a log shows of each effect, given the causes found.

    `gram`: of all effects. `effects`: in the order of both. `values`: the causes found. `alpha`: A cause is named where
    the odds for it are 1 / alpha. `power`: to which the likelihood is taken, as `evidence.weigh`'s. `value_at`:
    ``value_at(effect, place)`` returns the value at a coordinate of the priors. Returns: indexed by effect: `smallest`
    (size that would be named with a chance of one half, in the effect's unit; inf where the log does not show it),
    `unit`, `nearest_alias`, `similarity` (cosine, 0 to 1).

    Notes
    -----
    Scores have a normal law about their expectation, so that the evidence at the expected scores is its median: a size
    at which it just reaches the needed odds is named in one log of two. What the causes found could take over of an
    effect is no evidence for it.
    """
    names = list(priors.names)
    information = gram.products
    sizes = np.sqrt(np.maximum(np.diag(information), 0.0))
    shown = sizes > 0
    units = np.where(shown, sizes, np.inf)
    cosines = np.abs(information) / units[:, None] / units
    np.fill_diagonal(cosines, 0.0)
    nearest = cosines.argmax(axis=1)
    shares = _shares_left(information, [names.index(name) for name in values if name in names])
    smallest = np.full(len(names), np.inf)
    for k, effect in enumerate(effects):
        own = float(information[k, k] * shares[k])
        for low, high in ((0.0, priors.high[k]), (priors.low[k], 0.0)):
            if own > 0 and high > low:
                place = _smallest(power * own, priors, k, -np.log(alpha), high if high > 0 else low)
                if np.isfinite(place):
                    smallest[k] = min(smallest[k], abs(value_at(effect, place) - effect.neutral))
    return pd.DataFrame(
        {
            "smallest": smallest,
            "unit": [effect.unit for effect in effects],
            "nearest_alias": [
                names[k] if shown[i] and cosines[i, k] > 0 else "" for i, k in enumerate(nearest)
            ],
            "similarity": np.clip(cosines[np.arange(len(names)), nearest], 0, 1),
        },
        index=pd.Index(names, name="effect"),
    )


def _smallest(information: float, priors: Priors, k: int, needed: float, reach: float) -> float:
    """Return the coordinate on the side of a bound whose expected evidence is what a name needs; inf beyond it."""
    own = priors.part([k])

    def evidence(place: float) -> float:
        gram = Gram(np.array([[information]]), np.array([information * place]), np.zeros(1))
        return weigh(gram, own, [0]).evidence

    side = float(np.sign(reach))
    if evidence(reach) < needed:
        return side * np.inf
    place = min(abs(reach), float(np.sqrt(2 * (needed + 5) / information)))
    for _ in range(TURNS):
        cost = information * place**2 / 2 - evidence(side * place)
        last, place = place, min(abs(reach), float(np.sqrt(max(2 * (needed + cost) / information, 0.0))))
        if abs(place - last) < CLOSE * place:
            break
    return side * place


def beside_causes(gram: Gram, found: Sequence[int]) -> tuple[Array, Array]:
    """Return each effect's likeliest coordinate beside the causes found, whose values may give way, and its error.

    `gram`: of all effects. `found`: places of the causes. Returns `places, errors` (k,): without priors and bounds; the
    error is a standard deviation, inf of what the causes hide.
    """
    shares, left = _left_by(gram.products, found, gram.projections)
    information = np.diag(gram.products) * shares
    shown = information > 0
    places = gram.origin + np.where(shown, left, 0.0) / np.where(shown, information, 1.0)
    return places, np.where(shown, 1 / np.sqrt(np.where(shown, information, 1.0)), np.inf)


def _shares_left(information: Array, found: Sequence[int]) -> Array:
    """Return of each effect's information the share that the causes found, but itself, leave."""
    return _left_by(information, found, np.zeros(len(information)))[0]


def _left_by(information: Array, found: Sequence[int], scores: Array) -> tuple[Array, Array]:
    """Return of each effect's information the share, and of its score what, the causes found, but itself, leave."""
    own = np.maximum(np.diag(information), 1e-300)
    units = 1 / np.sqrt(own)
    scaled = information * units * units[:, None]
    shares, left = np.ones(len(own)), np.array(scores, dtype=float)
    for k in range(len(own)):
        others = [j for j in found if j != k]
        if others:
            carry = np.linalg.lstsq(scaled[np.ix_(others, others)], scaled[others, k], rcond=1e-12)[0]
            shares[k] = 1 - scaled[k, others] @ carry
            left[k] -= carry @ (scores[others] * units[others]) / units[k]
    return np.where(shares > LEAST_SHARE, shares, 0.0), left


def preflight(
    simulator: Simulator,
    X: ArrayLike,
    groups: ArrayLike | None,
    effects: Sequence[Effect],
    noise: ArrayLike | None = None,
    *,
    hidden: Sequence[str] = (),
    alpha: float = 0.01,
    typical: Mapping[str, float] | None = None,
) -> pd.DataFrame:
    """Return the identifiability of planned transitions, and what would tell each effect from its nearest alias.

    `X` (n_rows, n_inputs): NaN in columns of the state: will not be measured. `groups` (n_rows,): episode of each row.
    Rows that are planned need not follow each other. `noise` (n_residuals,): standard deviations; by default 1 % of
    each channel's spread. `hidden`: channels of the state that will not be measured; their columns in X, where they
    hold numbers, say how it moves. `typical`: scales of the priors of a user's own. Returns: as `identifiability`, with
    `separating_excitation`: more rows in which an input is large or small, "no single input" where that does not do,
    "nothing in these rows" where none tells the two apart, and "" where they are not nearly alike.
    """
    log = _planned(simulator, X, groups)
    filled = log.filled.y
    spread = tangents(simulator, filled).std(axis=0)
    deviations = (
        COMMON_NOISE * np.where(spread > 0, spread, 1.0) if noise is None else np.asarray(noise, float)
    )
    space = state_space(simulator, log.X, log.y, log.episodes, consecutive=log.consecutive)
    priors = priors_of(effects, {**typical_biases(space, effects), **(typical or {})}, logarithmic=False)
    space = replace(space, mask=space.mask & without_channels(simulator, log, hidden).measured)
    table = identifiability(
        _expected(space, effects, priors, deviations),
        priors,
        effects,
        {},
        alpha=alpha,
        power=coarsened(len(log)),
    )
    table["separating_excitation"] = _excitations(simulator, log, effects, priors, deviations, table)
    return table


def _planned(simulator: Simulator, X: ArrayLike, groups: ArrayLike | None) -> Log:
    """Return the log that a simulation as given makes of planned rows, with what will not be measured left out."""
    rows = check_matrix(X, "X", simulator.input_names, optional=simulator.state_names)
    n_states = len(simulator.state_names)
    consecutive = groups is not None and n_states > 0
    episodes = np.arange(len(rows))
    if groups is not None and n_states:
        episodes, _ = checked_episodes(groups, len(rows))
    y = np.full((len(rows), len(simulator.output_names)), np.nan)
    if consecutive:
        follows = np.flatnonzero(np.diff(episodes) == 0)
        y[follows] = rows[follows + 1, :n_states]
    log = Log(rows, y, episodes, consecutive, None, simulator)
    ends = np.r_[np.diff(episodes) != 0, True] if consecutive else np.ones(len(rows), dtype=bool)
    predicted = simulator.predict(
        log.filled.X if n_states else rows, groups=log.groups if consecutive else groups
    )
    y[ends] = predicted[ends]
    if n_states:
        y[:, np.isnan(rows[:, :n_states]).all(axis=0)] = np.nan
    if groups is None or not n_states:
        return check_log(simulator, rows, y, None)
    return Log(rows, y, episodes, consecutive, None, simulator)


def _steps(effects: Sequence[Effect], priors: Priors) -> dict[str, tuple[float, float]]:
    """Return neutral and a value beside it, within bounds."""
    steps = {}
    for effect, scale, low, high in zip(effects, priors.scales, priors.low, priors.high):
        up = high >= -low
        end = effect.neutral + (min(SMALL_SHARE * scale, high) if up else max(-SMALL_SHARE * scale, low))
        steps[effect.name] = (effect.neutral, end) if up else (end, effect.neutral)
    return steps


def _expected(space: StateSpace, effects: Sequence[Effect], priors: Priors, deviations: Array) -> Gram:
    """Return second moments of the derivatives of whitened innovations, and those with innovations of a right model."""
    linear = linearise(space, space.measured, {})
    slopes = derivatives(space, linear, {}, _steps(effects, priors))
    chains = linear.chains
    force = np.zeros((*space.real.shape, chains.carrier.shape[-1]))
    error = np.broadcast_to(deviations**2, chains.mask.shape)
    filtered = kalman_filter(chains, force, error)
    columns = response(space, chains, filtered, slopes)[chains.mask]
    return Gram(columns.T @ columns, np.zeros(len(effects)), np.zeros(len(effects)))


def _excitations(
    simulator: Simulator,
    log: Log,
    effects: Sequence[Effect],
    priors: Priors,
    deviations: Array,
    table: pd.DataFrame,
) -> list[str]:
    """Return for each effect the input at whose large or small values it differs most from its nearest alias."""
    X, by_name, hints = log.filled.X, {effect.name: effect for effect in effects}, []
    for k, (effect, alias) in enumerate(zip(effects, table["nearest_alias"])):
        if not alias or table["similarity"].iloc[k] < TWIN:
            hints.append("")
            continue
        slopes = partial(_one_step, simulator, log, (effect, by_name[alias]), priors, deviations)
        one, other = slopes(X)
        share = np.sum(one * other) / max(float(np.sum(other**2)), 1e-300)
        apart = np.sum((one - share * other) ** 2, axis=-1)
        hint = NOTHING_SEPARATES
        if np.sqrt(apart.sum()) * max(-priors.low[k], priors.high[k]) >= LEAST_APART:
            like = lambda rows, of=slopes: _cosine(*of(rows))  # noqa: E731
            hint = _separating(simulator, X, apart, _cosine(one, other), like)
        hints.append(hint)
    return hints


def _one_step(
    simulator: Simulator, log: Log, pair: Sequence[Effect], priors: Priors, deviations: Array, rows: Array
) -> Array:
    """Return the derivative of each row's outcome over its noise by two effects, (2, n_rows, d)."""
    ends = _steps(pair, priors.part([priors.names.index(effect.name) for effect in pair]))
    candidates = [{name: end} for name, both in ends.items() for end in both]
    outputs = np.nan_to_num(simulator.predict_many(rows, candidates, groups=log.groups))
    columns = [
        simulator.residual(high, low) / (both[1] - both[0]) / deviations
        for low, high, both in zip(outputs[::2], outputs[1::2], ends.values())
    ]
    return np.stack(columns)


def _cosine(one: Array, other: Array) -> float:
    size = float(np.sqrt(np.sum(one**2) * np.sum(other**2)))
    return abs(float(np.sum(one * other))) / size if size > 0 else 1.0


def _separating(
    simulator: Simulator, X: Array, apart: Array, similarity: float, similarity_at: Callable[[Array], float]
) -> str:
    """Return the input whose large or small values go with what is apart, if more of it makes the two less alike."""
    spread = X.std(axis=0)
    standard = (X - X.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    features = np.concatenate([np.abs(standard), standard, -standard], axis=1)
    centred = features - features.mean(axis=0)
    scale = np.linalg.norm(centred, axis=0) * np.linalg.norm(apart - apart.mean())
    strength = np.where(scale > 0, centred.T @ (apart - apart.mean()) / np.where(scale > 0, scale, 1.0), 0.0)
    for best in np.argsort(-strength)[:MOST_TRIED]:
        kind, column = divmod(int(best), X.shape[1])
        if strength[best] <= 0:
            break
        moved = X.copy()
        moved[:, column] += spread[column] * (standard[:, column], 1.0, -1.0)[kind]
        if 1 - similarity_at(moved) > LEAST_GAINED * (1 - similarity):
            return ("large |{}|", "large {}", "small {}")[kind].format(simulator.input_names[column])
    return NO_INPUT_SEPARATES
