"""What a log can show: the smallest size of each effect that would be named, and what it could be taken for."""

import warnings

import numpy as np
import pandas as pd
from scipy import stats

from skat.diagnosis.evidence import grams, solve_scaled
from skat.diagnosis.judgement import least_fall
from skat.diagnosis.log import Log, check_log

COMMON_NOISE = 0.01
# Effects whose derivatives make a smaller angle than this cosine are worth a warning before measuring.
NEARLY_ALIKE = 0.95
# At the end of its range an effect differs from its nearest alias by more than this much noise, or by rounding only.
LEAST_APART = 2.0
# An excitation separates two effects if with twice of it the angle's share grows by this factor; so many are tried.
LEAST_GAINED = 1.2
MOST_TRIED = 3
NO_INPUT_SEPARATES = "no single input"
NOTHING_SEPARATES = "nothing in these rows"
# An effect of which the causes found leave a smaller share is not seen beside them.
LEAST_SHARE = 1e-9


def identifiability(selected, residuals, alpha):
    """Return a table of what the fitted log shows of each effect, given the causes found.

    Returns
    -------
    DataFrame
        Indexed by effect: `smallest` (size that would be named with a chance of one half, in the effect's unit; inf
        where the log does not show it), `unit`, `nearest_alias`, `similarity` (cosine, 0 to 1).
    """
    return _table(selected.gram, selected.linearisation.names, residuals, alpha, list(selected.values))


def _table(gram, names, residuals, alpha, found=()):
    effects = residuals.effects
    information = gram.information.sum(axis=0)
    size = np.sqrt(np.diag(information))
    shown = size > 0
    cosines = np.abs(information) / np.where(shown, size, np.inf)[:, None] / np.where(shown, size, np.inf)
    np.fill_diagonal(cosines, 0.0)
    size = size * np.sqrt(_shares_left(information, [names.index(name) for name in found]))
    shown &= size > 0
    # A named effect is significant among all and lowers the loss throughout the log, which has half the effect's t.
    threshold = max(stats.norm.isf(alpha / len(names) / 2), 2 * least_fall(residuals))
    nearest = cosines.argmax(axis=1)
    smallest = threshold / np.where(shown, size, 1e-300)
    # An effect that must leave its bounds to be seen is not shown at all.
    shown &= smallest < [
        np.max(np.abs(np.subtract(effects[name].bounds, effects[name].neutral))) for name in names
    ]
    return pd.DataFrame(
        {
            "smallest": np.where(shown, smallest, np.inf),
            "unit": [effects[name].unit for name in names],
            "nearest_alias": [
                names[k] if shown[i] and cosines[i, k] > 0 else "" for i, k in enumerate(nearest)
            ],
            "similarity": np.clip(cosines[np.arange(len(names)), nearest], 0, 1),
        },
        index=pd.Index(names, name="effect"),
    )


def _shares_left(information, found):
    """Return of each effect's information the share that the causes found, but itself, leave."""
    own = np.maximum(np.diag(information), 1e-300)
    shares = np.ones(len(own))
    for k in range(len(own)):
        others = [j for j in found if j != k]
        if others:
            carry = solve_scaled(information[np.ix_(others, others)], information[others, k][:, None])[:, 0]
            shares[k] = 1 - information[k, others] @ carry / own[k]
    return np.where(shares > LEAST_SHARE, shares, 0.0)


def preflight(diagnosis, X, groups):
    """Return the identifiability of planned transitions; see `SimulationDiagnosis.preflight`."""
    simulator = diagnosis.simulator
    groups = None if groups is None else np.asarray(groups)
    y = simulator.predict(X, groups=groups)
    with warnings.catch_warnings():
        if groups is not None:
            warnings.simplefilter("ignore", UserWarning)  # of rows that follow each other without groups
        log = check_log(simulator, X, y, None)
    consecutive = bool(simulator.state_names)
    if groups is not None and (consecutive or len(np.unique(groups)) > 1):
        # Rows that are planned need not follow each other, so they are not checked as a log's are.
        log = Log(log.X, log.y, np.cumsum(np.r_[True, groups[1:] != groups[:-1]]) - 1, consecutive)
    deviations = diagnosis._given_deviations()
    if deviations is None:
        spread = simulator.residual(y, np.broadcast_to(y[:1], y.shape)).std(axis=0)
        deviations = COMMON_NOISE * np.where(spread > 0, spread, 1.0)
    effects = diagnosis._chosen_effects()
    residuals = diagnosis._residuals(log, effects, deviations)
    names = [effect.name for effect in effects]
    residuals.settle({})
    line = residuals.linearise({}, names)
    gram = grams(line.residuals, line.derivatives, residuals.blocks, np.ones(len(log)))
    table = _table(gram, line.names, residuals, diagnosis.alpha / 2)
    table["separating_excitation"] = _excitation(line, residuals, table)
    return table


def _excitation(line, residuals, table):
    """Return for each effect the input at whose large or small values it differs most from its nearest alias."""
    hints = []
    for k, name in enumerate(line.names):
        alias = table.loc[name, "nearest_alias"]
        if not alias or table.loc[name, "similarity"] < NEARLY_ALIKE:
            hints.append("")
            continue
        one, other = line.derivatives[..., k], line.derivatives[..., line.names.index(alias)]
        share = np.sum(one * other) / np.sum(other**2)
        apart = np.sum((one - share * other) ** 2, axis=-1)
        effect = residuals.effects[name]
        if np.sqrt(apart.sum()) * np.max(np.abs(np.subtract(effect.bounds, effect.neutral))) < LEAST_APART:
            hints.append(NOTHING_SEPARATES)
            continue
        hints.append(_excitation_that_separates(residuals, name, alias, table.loc[name, "similarity"], apart))
    return hints


def _excitation_that_separates(residuals, name, alias, similarity, apart):
    """Return the input whose large or small values go with what is apart, if more of it makes the two less alike."""
    inputs = residuals.points
    spread = inputs.std(axis=0)
    standard = (inputs - inputs.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    features = np.concatenate([np.abs(standard), standard, -standard], axis=1)
    centred = features - features.mean(axis=0)
    scale = np.linalg.norm(centred, axis=0) * np.linalg.norm(apart - apart.mean())
    strength = np.where(scale > 0, centred.T @ (apart - apart.mean()) / np.where(scale > 0, scale, 1.0), 0.0)
    for best in np.argsort(-strength)[:MOST_TRIED]:
        kind, column = divmod(best, inputs.shape[1])
        if strength[best] <= 0:
            break
        moved = inputs.copy()
        moved[:, column] += spread[column] * (standard[:, column], 1.0, -1.0)[kind]
        if 1 - _similarity_at(residuals, moved, name, alias) > LEAST_GAINED * (1 - similarity):
            return ("large |{}|", "large {}", "small {}")[kind].format(
                residuals.simulator.input_names[column]
            )
    return NO_INPUT_SEPARATES


def _similarity_at(residuals, points, name, alias):
    """Return the cosine between the derivatives by two effects in other rows."""
    state = residuals.state()
    residuals.points = points
    one, other = np.moveaxis(residuals.derivatives({}, [name, alias]), -1, 0)
    residuals.restore(state)
    size = np.sqrt(np.sum(one**2) * np.sum(other**2))
    return abs(np.sum(one * other)) / size if size > 0 else 1.0
