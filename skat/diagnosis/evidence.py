r"""What blocks of whitened residuals say about effects: linear gains, Wald statistics and intervals.

With weights w, residuals z and derivatives G, the score of effect k in block b is :math:`g_{bk} = \sum w G_k^T z` and
the information :math:`H = \sum w G^T G`. Effects already in the model are projected out of both. Variances come from
the blocks' scores, each at the value fitted without it (a jackknife), and are never smaller than the noise alone gives.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from skat.diagnosis.residuals import robust_weights

# Models within this quantile of each other's loss (paired over blocks, one-sided) cannot be told apart.
ALIAS_LEVEL = 0.05
# In noise units: an effect moves the loss of a block where it changes it by more. What so few blocks agree on may be
# chance, however well they agree.
LEAST_MOVED = 1.0
FEWEST_MOVED = 5
# Loss in noise units that a refit may leave of what it could explain.
LEFT_BY_A_REFIT = 0.01
# A model is not ruled out by less than this loss in noise units, a likelihood ratio of 20, however evenly it is spread:
# of two models that hardly differ, one is always better by a little, and the difference of their losses nearly normal.
LEAST_TO_RULE_OUT = 6.0


@dataclass(frozen=True)
class Screen:
    """What adding each effect to a model would bring, to first order; arrays of shape (n_effects,).

    Attributes
    ----------
    names : tuple of str
    moves : ndarray
        Best change of the effect, in its unit, within its bounds; the effects in the model adapt.
    gains : ndarray
        By which the loss (weighted squared residuals in noise units) falls.
    p_values : ndarray
        Two-sided, of a single effect.
    flat : ndarray of bool
        Where an effect changes nothing at the model: a limit that is not reached, for example.
    """

    names: tuple
    moves: np.ndarray
    gains: np.ndarray
    p_values: np.ndarray
    flat: np.ndarray


@dataclass(frozen=True)
class Grams:
    """Sums over the rows of each block that every statistic comes from.

    Attributes
    ----------
    scores : ndarray of shape (n_blocks, n_effects)
    information : ndarray of shape (n_blocks, n_effects, n_effects)
    """

    scores: np.ndarray
    information: np.ndarray


def grams(residuals, derivatives, blocks, weights=None):
    """Return the Grams of whitened residuals and derivatives."""
    weights = robust_weights(residuals) if weights is None else weights
    starts = np.flatnonzero(np.r_[True, np.diff(blocks) > 0])
    weighted = derivatives * weights[:, None, None]
    scores = np.add.reduceat(np.einsum("ndk,nd->nk", weighted, residuals), starts, axis=0)
    n_effects = derivatives.shape[-1]
    information = np.stack(
        [
            weighted[begin:end].reshape(-1, n_effects).T @ derivatives[begin:end].reshape(-1, n_effects)
            for begin, end in zip(starts, np.r_[starts[1:], len(blocks)])
        ]
    )
    return Grams(scores, information)


def screen(gram, names, values, effects, fitted=()):
    """Return the Screen of all effects, given those already in the model.

    Parameters
    ----------
    gram : Grams
        At the model, with `names` as the effects.
    names : sequence of str
    values : dict of str to float
        The model's effects.
    effects : dict of str to Effect
    fitted : sequence of str
        Those of the model's effects that adapt when another is added.
    """
    inside = np.array([names.index(name) for name in fitted], dtype=int)
    information = gram.information.sum(axis=0)
    scores = gram.scores
    carry = np.zeros((len(inside), len(names)))
    if len(inside):
        carry = solve_scaled(information[np.ix_(inside, inside)], information[inside])
    own = np.einsum("bkk->bk", gram.information)
    cross = gram.information[:, inside, :]
    # Information and score of each effect with the fitted ones projected out, by block.
    within = own - 2 * np.einsum("bik,ik->bk", cross, carry)
    within += np.einsum(
        "ik,bij,jk->bk", carry, gram.information[:, inside][:, :, inside], carry, optimize=True
    )
    adjusted = scores - scores[:, inside] @ carry
    total = within.sum(axis=0)
    flat = np.diag(information) == 0
    usable = (total > 1e-9 * np.diag(information)) & ~flat
    usable[inside] = False
    safe = np.where(usable, total, 1.0)
    change = np.where(usable, adjusted.sum(axis=0) / safe, 0.0)
    errors, freedom = block_errors(adjusted - change * within, within, safe)
    p_values = np.where(usable, 2 * stats.t.sf(np.abs(change) / errors, freedom), 1.0)
    moves, gains = np.zeros(len(names)), np.zeros(len(names))
    for k in np.flatnonzero(usable):
        low, high = effects[names[k]].bounds
        at = values.get(names[k], effects[names[k]].neutral)
        moves[k] = np.clip(change[k], low - at, high - at)
        gains[k] = moves[k] * (2 * change[k] - moves[k]) * total[k]
    return Screen(tuple(names), moves, gains, p_values, flat)


def lone_statistics(gram):
    """Return the Wald statistic, standard error and degrees of freedom of each effect, were it the only one.

    Arrays of shape (n_effects,); zero, infinite and infinite where an effect shows nothing.
    """
    within = np.einsum("bkk->bk", gram.information)
    total = within.sum(axis=0)
    safe = np.where(total > 0, total, 1.0)
    changes = gram.scores.sum(axis=0) / safe
    errors, freedom = block_errors(gram.scores - changes * within, within, safe)
    shows = total > 0
    return (
        np.where(shows, changes / errors, 0.0),
        np.where(shows, errors, np.inf),
        np.where(shows, freedom, np.inf),
    )


def block_errors(scores, within, total):
    """Return standard errors and degrees of freedom of changes that maximise a sum over blocks.

    Parameters
    ----------
    scores : ndarray of shape (n_blocks, n_effects)
        What is left of each block's score at the fitted change.
    within : ndarray of shape (n_blocks, n_effects)
        Information of each block.
    total : ndarray of shape (n_effects,)
    """
    leverage = np.clip(within / total, 0.0, 1.0)
    jackknife = np.sum((scores / np.maximum(1 - leverage, 1e-3)) ** 2, axis=0)
    variance = np.maximum(jackknife, total) / total**2
    freedom = np.maximum(1 / np.maximum(np.sum(leverage**2, axis=0), 1e-12) - 1, 1.0)
    return np.sqrt(variance), freedom


def wald(gram):
    """Return (covariance, degrees of freedom) of effects fitted together, all of the Grams' effects.

    The covariance is the sandwich of the blocks' scores with each block's leverage taken out, never smaller than what
    noise alone gives.
    """
    sizes = np.diag(gram.information.sum(axis=0))
    scale = np.sqrt(np.where(sizes > 0, sizes, 1.0))
    covariance, freedom = _scaled_wald(gram.scores / scale, gram.information / np.outer(scale, scale))
    return covariance / np.outer(scale, scale), freedom


def _scaled_wald(scores, informations):
    total = informations.sum(axis=0)
    bread = np.linalg.pinv(total, rcond=1e-12, hermitian=True)
    n_effects = len(total)
    hats = informations @ bread
    # Of the whole that an effect shows beside the others, which are projected out of it: these shares sum to 1.
    shown = np.maximum(np.diag(bread), 1e-300)
    leverages = np.einsum("kl,blm,mk->bk", bread, informations, bread, optimize=True) / shown
    inverses = np.linalg.pinv(np.eye(n_effects) - np.clip(hats, -0.999, 0.999), rcond=1e-8)
    corrected = np.einsum("bkl,bl->bk", inverses, scores)
    meat = corrected.T @ corrected
    covariance = bread @ meat @ bread
    widen = np.sqrt(np.maximum(np.diag(bread) / np.maximum(np.diag(covariance), 1e-300), 1.0))
    freedom = np.maximum(1 / np.maximum(np.sum(np.square(leverages), axis=0), 1e-12) - n_effects, 1.0)
    covariance = covariance * np.outer(widen, widen)
    covariance[np.diag_indices(n_effects)] += np.where(np.diag(total) > 0, 0.0, np.inf)
    return covariance, freedom


def solve_scaled(information, right):
    """Return the least-squares solution of information @ x = right, whatever the units of the effects."""
    scale = np.sqrt(np.where(np.diag(information) > 0, np.diag(information), 1.0))
    inner = information / np.outer(scale, scale)
    return np.linalg.lstsq(inner, right / scale[:, None], rcond=1e-12)[0] / scale[:, None]


def family_p_value(p_value, n_effects):
    """Return the chance that the smallest of `n_effects` independent p-values is as small as this one (Sidak)."""
    return float(-np.expm1(n_effects * np.log1p(-min(p_value, 1 - 1e-16))))


def fall_p_value(without, losses):
    """Return the p-value of the fall of the loss by an effect, over blocks, or that of its logarithm where it moves.

    With noise alone t is half the Wald statistic, so this test rarely counts; where a simulation has kinks, which widen
    the errors of the effect but do not keep it from explaining the log, it does. Of the logarithm it does where few
    blocks miss, by very different amounts, and the effect explains each of them. The smaller counts, corrected for
    there being two. Neither takes the blocks to vary by less than noise makes them, so that a few that happen to agree,
    as quantised measurements do, prove nothing.

    Parameters
    ----------
    without, losses : ndarray of shape (n_blocks,)
        Without the effect, and with it.
    """
    fall = without - losses
    moved = (np.abs(fall) > LEAST_MOVED) & (losses > 0) & (without > 0)
    of_falls = _above_zero(fall, LEAST_MOVED * np.sqrt(max(moved.sum(), 1)))
    of_logarithms = 1.0
    if moved.sum() >= FEWEST_MOVED:
        logarithms = np.log(without[moved] / losses[moved])
        of_logarithms = _above_zero(logarithms, LEAST_MOVED * np.linalg.norm(1 / losses[moved]))
    return family_p_value(min(of_falls, of_logarithms), 2)


def _above_zero(values, least_error):
    """Return the p-value of a sum above zero, the error of which is not below the least one."""
    if len(values) < 2:
        return 1.0
    error = max(np.sqrt(len(values) * values.var(ddof=1)), least_error)
    return float(stats.t.sf(values.sum() / error, len(values) - 1))


def is_ruled_out(losses, reference):
    """Whether a log speaks against a model with these losses (n_blocks,), beside one with the reference's."""
    return not as_good(losses, reference) and bool((losses - reference).sum() > LEAST_TO_RULE_OUT)


def as_good(losses, reference, level=ALIAS_LEVEL):
    """Whether a model's losses (n_blocks,) are not significantly higher than another's, paired by block (Vuong)."""
    worse = losses - reference
    error = np.sqrt(len(worse) * worse.var(ddof=1))
    return bool(worse.sum() <= stats.t.isf(level, len(worse) - 1) * error + LEFT_BY_A_REFIT)
