"""What no effect explains: the noise of rows, and by how much effects differ from window to window and log to log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skat.diagnosis.changes.windows import Windows
from skat.diagnosis.filtering import Array
from skat.diagnosis.forces.force_space import LEFT_AT_LEAST, NOISE_TURNS, Rows, joined, noise_of

# Effects differ between windows by this share of their typical size, told as by so many windows.
APART_AT_LEAST, PSEUDO = 0.1, 1.0
# Turns of what windows differ by, within each turn of noise.
WINDOW_TURNS = 5
# Of its typical size, by which an effect differs from window to window until the logs tell.
BEGUN = 0.3


@dataclass(frozen=True)
class Law:
    """Of what the effects do not explain, which are in units of their typical sizes.

    Attributes
    ----------
    noise : tuple of ndarray of shape (n_rows,)
        Deviation of each row of both logs: N or N m, of measured speeds m/s or rad/s.
    spread : ndarray of shape (n_effects,)
        Variance by which an effect differs from window to window.
    weights : ndarray of shape (n_effects,)
        Precision of what is common.
    value : ndarray of shape (n_effects,)
        What is common, if nothing changed.
    second : ndarray of shape (n_effects,)
        What the second log tells if every effect changed.
    alike : ndarray of shape (n_joints, n_effects)
        Precision with which each joint, or speed that was measured, tells an effect if all of its noise looks like it.
    """

    noise: tuple[Array, Array]
    spread: Array
    weights: Array
    value: Array
    second: Array
    alike: Array


def settled_law(sides: Sequence[Rows]) -> Law:
    """Return noise of each row, variances of effects between windows, and what is common; by turns.

    The second log has effects of its own, so that a change makes no variance. Logs are not apart in what is returned.

    Parameters
    ----------
    sides : sequence of Rows
        Of the first log and of the second, with the same columns: of effects that may be wrong in both.
    """
    k = sides[0].columns.shape[1]
    # Both logs have one noise: with one each, a fit may give one of them up.
    together = joined(sides)
    first = np.arange(len(together.target)) < len(sides[0].target)
    masks = first, ~first
    noise = noise_of(together, together.target**2, flat=True)
    spread, weights = np.full(k, BEGUN**2), np.r_[np.ones(k), np.full(k, BEGUN**-2)]
    maps = np.eye(k, 2 * k), np.hstack([np.eye(k), np.eye(k)])
    for turn in range(2 * NOISE_TURNS):
        squares = np.empty(len(noise))
        for turn_of_window in range(WINDOW_TURNS):
            windows = [Windows.of(rows, noise[own]) for rows, own in zip(sides, masks)]
            one, other = (window.without(spread).whole() for window in windows)
            both, G1 = one + other, other.products
            H = np.block([[both.products + np.diag(weights[:k]), G1], [G1, G1 + np.diag(weights[k:])]])
            law = np.linalg.inv(H)
            solved = law @ np.r_[both.projections, other.projections]
            moments, told = np.zeros(k), np.zeros(k)
            for rows, own, window, map_ in zip(sides, masks, windows, maps):
                value, cover = map_ @ solved, map_ @ law @ map_.T
                for one, part in zip(np.unique(rows.stretch), window.parts):
                    G, h = part.products, part.projections
                    inner = np.linalg.inv(G + np.diag(1 / spread))
                    apart = inner @ G
                    mean = inner @ h - apart @ value
                    moments += mean**2
                    told += 1 - (np.diag(inner) + np.sum((apart @ cover) * apart, axis=1)) / spread
                    if turn_of_window < WINDOW_TURNS - 1:
                        continue
                    mine = rows.stretch == one
                    N = rows.columns[mine] / noise[own][mine, None]
                    seen = N - N @ apart
                    lever = np.sum((N @ inner) * N, axis=1) + np.sum((seen @ cover) * seen, axis=1)
                    left = rows.target[mine] - rows.columns[mine] @ (value + mean)
                    squares[np.flatnonzero(own)[mine]] = left**2 / np.maximum(1 - lever, LEFT_AT_LEAST)
            # MacKay's fixed point: squares over how many of them the rows tell, and not the law itself.
            spread = (moments + PSEUDO * APART_AT_LEAST**2) / (np.maximum(told, 0) + PSEUDO)
            weights = 2 / (1 + solved**2)
        noise = noise_of(together, squares, flat=turn < NOISE_TURNS)
    return Law(
        (noise[first], noise[~first]), spread, weights[:k], solved[:k], maps[1] @ solved, np.zeros((0, k))
    )


def with_misfit(sides: Sequence[Rows], law: Law) -> Law:
    """Return a law with how much of what is left of each joint's force may look like each effect, at most.

    Parameters
    ----------
    sides : sequence of Rows
        Of the first log and of the second; the columns of rows are those of effects.
    law : Law
        With noise.
    """
    rows, left = joined(sides), np.concatenate(law.noise) ** 2
    alike = []
    for joint in np.unique(rows.joint):
        own = rows.joint == joint
        exerted = rows.columns[own] ** 2
        # Of the frequencies at which an effect acts.
        remains = own.sum() * (left[own] @ exerted)
        alike.append(exerted.sum(axis=0) ** 2 / np.maximum(remains, 1e-300))
    return replace(law, alike=np.array(alike))
