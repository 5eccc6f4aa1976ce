"""What no effect explains: the noise of rows, and by how much effects differ from window to window and log to log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skat.diagnosis.chains import Array
from skat.diagnosis.changes.windows import Quadratic
from skat.diagnosis.evidence import bounded_solution
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
        What is common, if nothing changed, of what a machine may have.
    second : ndarray of shape (n_effects,)
        What the second log tells if every effect changed, of the same.
    alike : ndarray of shape (n_joints, n_effects)
        Precision with which each joint, or speed that was measured, tells an effect if all of its noise looks like it.
    """

    noise: tuple[Array, Array]
    spread: Array
    weights: Array
    value: Array
    second: Array
    alike: Array


def settled_law(sides: Sequence[Rows], possible: tuple[Array, Array] | None = None) -> Law:
    """Return noise of each row, variances of effects between windows, and what is common; by turns.

    The second log has effects of its own, so that a change makes no variance. Logs are not apart in what is returned.

    Parameters
    ----------
    sides : sequence of Rows
        Of the first log and of the second, with the same columns: of effects that may be wrong in both.
    possible : tuple of two ndarray of shape (n_effects,), optional
        Between which values a machine may have effects, in units of their typical sizes.
    """
    k = sides[0].columns.shape[1]
    low, high = possible or (np.full(k, -np.inf), np.full(k, np.inf))
    # Both logs have one noise: with one each, a fit may give one of them up.
    together = joined(sides)
    first = np.arange(len(together.target)) < len(sides[0].target)
    masks = first, ~first
    noise = noise_of(together, together.target**2, flat=True)
    spread, weights = np.full(k, BEGUN**2), np.r_[np.ones(k), np.full(k, BEGUN**-2)]
    maps = np.eye(k, 2 * k), np.hstack([np.eye(k), np.eye(k)])
    # Windows of both logs, one behind the other.
    windows = [
        (place, np.flatnonzero(mask)[rows.stretch == one])
        for place, (rows, mask) in enumerate(zip(sides, masks))
        for one in np.unique(rows.stretch)
    ]
    second = np.array([bool(place) for place, _ in windows])
    for turn in range(2 * NOISE_TURNS):
        parts = [
            Quadratic.of(together.target[own] / noise[own], together.columns[own] / noise[own, None])
            for _, own in windows
        ]
        G, h = np.array([one.products for one in parts]), np.array([one.projections for one in parts])
        for _ in range(WINDOW_TURNS):
            inner = np.linalg.inv(G + np.diag(1 / spread))
            apart, alone = inner @ G, (inner @ h[:, :, None])[:, :, 0]
            # Of the rest of each window, with what it has of its own integrated out.
            rest, right = apart / spread[:, None], alone / spread
            one, other = rest[~second].sum(axis=0), rest[second].sum(axis=0)
            H = np.block([[one + other + np.diag(weights[:k]), other], [other, other + np.diag(weights[k:])]])
            law = np.linalg.inv(H)
            solved = law @ np.r_[right.sum(axis=0), right[second].sum(axis=0)]
            values, covers = (
                np.array(each) for each in zip(*((map_ @ solved, map_ @ law @ map_.T) for map_ in maps))
            )
            value, cover = values[second.astype(int)], covers[second.astype(int)]
            means = alone - (apart @ value[:, :, None])[:, :, 0]
            moments = np.sum(means**2, axis=0)
            unsure = np.einsum("wii->wi", inner) + np.sum((apart @ cover) * apart, axis=2)
            told = np.sum(1 - unsure / spread, axis=0)
            # MacKay's fixed point: squares over how many of them the rows tell, and not the law itself.
            last = inner, apart, value, cover, means
            spread = (moments + PSEUDO * APART_AT_LEAST**2) / (np.maximum(told, 0) + PSEUDO)
            weights = 2 / (1 + solved**2)
        squares = np.empty(len(noise))
        for (_, own), *of_window in zip(windows, *last):
            squares[own] = _squares(together.target[own], together.columns[own], noise[own], *of_window)
        noise = noise_of(together, squares, flat=turn < NOISE_TURNS)
    precisions = np.linalg.inv(covers)
    value, changed = (
        bounded_solution(precision, precision @ one, low, high, np.zeros(k))
        for one, precision in zip(values, precisions)
    )
    return Law((noise[first], noise[~first]), spread, weights[:k], value, changed, np.zeros((0, k)))


def _squares(
    target: Array,
    columns: Array,
    noise: Array,
    inner: Array,
    apart: Array,
    value: Array,
    cover: Array,
    mean: Array,
) -> Array:
    """Return unbiased squares of what a window's values leave of its rows, (n_rows,)."""
    N = columns / noise[:, None]
    seen = N - N @ apart
    lever = np.sum((N @ inner) * N, axis=1) + np.sum((seen @ cover) * seen, axis=1)
    left = target - columns @ (value + mean)
    return np.asarray(left**2 / np.maximum(1 - lever, LEFT_AT_LEAST))


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
