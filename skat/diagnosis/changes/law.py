"""What no effect explains: the noise of rows, and by how much effects differ from window to window and log to log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skat.diagnosis.changes.candidates import Model
from skat.diagnosis.changes.force_space import Rows, joined, noise_of, smooth_squares
from skat.diagnosis.changes.motions import Half, coefficients_of, lacking_forces
from skat.diagnosis.changes.windows import Windows
from skat.diagnosis.filtering import Array
from skat.simulators import MujocoSimulator

# Effects differ between windows by this share of their typical size, told as by so many windows.
APART_AT_LEAST, PSEUDO = 0.1, 1.0
# Two logs that move otherwise differ by the variance of two windows, and of what is left of a joint's force.
APART = 2.0
# Turns of noise, and within each of what windows differ by.
NOISE_TURNS, WINDOW_TURNS = 4, 5
# Of its typical size, by which an effect differs from window to window until the logs tell.
BEGUN = 0.3
# Of a row's square that is taken to be left at least: what a fit takes nearly all of tells no noise.
LEFT_AT_LEAST = 0.1


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
    apart : ndarray of shape (n_effects,)
        Variance by which an effect differs between the logs, though nothing changed.
    """

    noise: tuple[Array, Array]
    spread: Array
    weights: Array
    value: Array
    apart: Array


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
            (G0, h0), (G1, h1) = (one.without(spread).every() for one in windows)
            H = np.block([[G0 + G1 + np.diag(weights[:k]), G1], [G1, G1 + np.diag(weights[k:])]])
            law = np.linalg.inv(H)
            solved = law @ np.r_[h0 + h1, h1]
            moments, told = np.zeros(k), np.zeros(k)
            for rows, own, window, map_ in zip(sides, masks, windows, maps):
                value, cover = map_ @ solved, map_ @ law @ map_.T
                for place, one in enumerate(np.unique(rows.stretch)):
                    G, h = window.products[place], window.projections[place]
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
    return Law((noise[first], noise[~first]), spread, weights[:k], solved[:k], np.zeros(k))


def variance_apart(
    simulator: MujocoSimulator, halves: Sequence[Half], sides: Sequence[Rows], law: Law
) -> Array:
    """Return the variance by which effects may differ between logs that move otherwise, though nothing changed.

    What a model leaves of a joint's force may look, by a share, like any effect on it; what the noise of sensors makes
    of it is no misfit.

    Parameters
    ----------
    simulator : MujocoSimulator
    halves, sides : sequence of Half and of Rows
        Of the first log and of the second; the columns of rows are those of effects.
    law : Law
        With noise and spread.

    Returns
    -------
    ndarray of shape (n_effects,)
        In units of the squares of typical sizes.
    """
    rows, left = joined(sides), np.concatenate(law.noise) ** 2
    read = _of_sensors(simulator, halves, rows)
    unlike = np.tile(_unlike(halves), 2)
    joints = np.unique(rows.joint)
    own = [rows.joint == joint for joint in joints]
    exerted = np.array([np.sum(rows.columns[one] ** 2, axis=0) for one in own])
    # Of the frequencies at which an effect acts.
    remains = np.array([one.sum() * ((left - read)[one] @ rows.columns[one] ** 2) for one in own])
    feels = np.argmax(exerted / np.array([np.sum(rows.nominal[one] ** 2) for one in own])[:, None], axis=0)
    # Of an effect that several joints feel it would have to look alike on each.
    worst = 1 / np.maximum(np.sum(exerted**2 / np.maximum(remains, 1e-300), axis=0), 1e-300)
    return np.asarray(APART * unlike[joints[feels]] * (law.spread + worst) + 1e-12)


def _unlike(halves: Sequence[Half]) -> Array:
    """Return of each joint the share of the variance of its motion that is between the logs, not within, (nv,).

    A window's motion is told by its mean place, and by the logarithms of its rms speed and acceleration.
    """
    found = []
    for half in halves:
        motion, nv = half.motion, len(half.motion.slip)
        own = [motion.stretches == one for one in np.unique(motion.stretches)]
        q, v, a = motion.states[:, :nv], motion.states[:, nv:], motion.accelerations
        found.append(
            np.array(
                [
                    [
                        q[one].mean(axis=0),
                        *(0.5 * np.log(np.mean(x[one] ** 2, axis=0) + 1e-12) for x in (v, a)),
                    ]
                    for one in own
                ]
            )
        )
    n0, n1 = map(len, found)
    within = sum(((one - one.mean(axis=0)) ** 2).sum(axis=0) for one in found) / max(n0 + n1 - 2, 1)
    apart = 0.5 * (found[0].mean(axis=0) - found[1].mean(axis=0)) ** 2
    between = np.maximum(apart - 0.5 * within * (1 / n0 + 1 / n1), 0)
    return np.asarray(np.max(between / np.maximum(between + within, 1e-12), axis=0))


def _of_sensors(simulator: MujocoSimulator, halves: Sequence[Half], rows: Rows) -> Array:
    """Return the variance of rows that the noise of positions makes, by motions that were read anew."""
    squares = []
    for half in halves:
        motions = [
            half.motion,
            *(replace(half.motion, states=q, accelerations=a) for q, a in half.motion.anew),
        ]
        forces = np.concatenate(
            [lacking_forces(simulator, replace(half, motion=motion), [Model({})]) for motion in motions]
        )
        squares.append(np.mean(coefficients_of(half, forces[1:] - forces[:1])[0] ** 2, axis=1))
    return smooth_squares(rows, np.concatenate(squares))
