"""Models fitted to a log side by side, by damped Gauss-Newton at a robust loss."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from skat.diagnosis.residuals import largest_of_noise

REFIT_STEPS = 8
# A refit ends when its step is below this share of the standard error.
CONVERGED = 0.05
# Of the models refitted side by side, so many go on after so many steps.
FINALISTS = {2: 4, 4: 2}


@dataclass(frozen=True)
class Fit:
    """A model fitted to the log.

    Attributes
    ----------
    values : dict of str to float
    losses : ndarray of shape (n_blocks,)
        Robust loss of each block, in noise units.
    """

    values: dict
    losses: np.ndarray

    @property
    def loss(self):
        """Sum of the losses."""
        return float(self.losses.sum())


class Refits:
    """Fits the values of effects to whitened residuals.

    Parameters
    ----------
    residuals : Residuals
    """

    def __init__(self, residuals):
        self.residuals, self.effects = residuals, residuals.effects
        self.starts = np.flatnonzero(np.r_[True, np.diff(residuals.blocks) > 0])
        self.cut = np.inf

    def fit(self, models, *, race=False, hold=None, n_steps=REFIT_STEPS):
        """Fit the values of several models by damped Gauss-Newton, all side by side, and return their Fits.

        With `race`, only the best go on to the end. The effect named by `hold` keeps its value. After `n_steps` a refit
        ends where it is.
        """
        damping = np.full(len(models), 1e-4)
        best: list[Any] = [None] * len(models)
        held = [{name: value for name, value in model.items() if name == hold} for model in models]
        proposals = [{name: value for name, value in model.items() if name != hold} for model in models]
        active = list(range(len(models)))
        for step in range(n_steps):
            if race and step in FINALISTS:
                leaders = np.argsort([one[0].sum() for one in best])[: FINALISTS[step]]
                active = [m for m in active if m in leaders]
            if not active:
                break
            candidates: list[dict[str, float]] = []
            places = []
            for m in active:
                places.append(len(candidates))
                candidates.append(proposals[m] | held[m])
                candidates += [self._moved(proposals[m], name) | held[m] for name in proposals[m]]
            white = self.whitened(candidates)
            still = []
            for m, place in zip(active, places):
                residuals = white[place]
                block_losses = self.losses(residuals)
                if best[m] is None or block_losses.sum() < best[m][0].sum():
                    derivatives = np.empty((*residuals.shape, len(proposals[m])))
                    for i, (name, value) in enumerate(proposals[m].items()):
                        move = (self._moved(proposals[m], name)[name] - value) or 1.0
                        derivatives[..., i] = (residuals - white[place + 1 + i]) / move
                    flat = derivatives * self.weights(residuals)[:, None, None]
                    information = np.einsum("ndk,ndl->kl", flat, derivatives)
                    score = np.einsum("ndk,nd->k", flat, residuals)
                    best[m] = (block_losses, dict(proposals[m]), information, score)
                    damping[m] = max(damping[m] / 10, 1e-9)
                else:
                    damping[m] = max(damping[m] * 30, 1e-2)
                _, at, information, score = best[m]
                proposals[m], size = self.step(at, information, score, damping[m])
                if size > CONVERGED and damping[m] < 1e4:
                    still.append(m)
            active = still
        return [Fit(one[1] | fixed, one[0]) for one, fixed in zip(best, held)]

    def step(self, at, information, score, damping):
        """Return the values after a damped step within the bounds, and the step's length in standard errors."""
        names = list(at)
        scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
        free = np.ones(len(names), dtype=bool)
        move = np.zeros(len(names))
        for _ in names:
            inner = information[np.ix_(free, free)] / np.outer(scale[free], scale[free])
            move[:] = 0
            move[free] = (
                np.linalg.lstsq(inner + damping * np.eye(free.sum()), (score / scale)[free], rcond=1e-10)[0]
                / scale[free]
            )
            blocked = np.array(
                [
                    (at[name] + step > high and at[name] >= high - 1e-12 * (high - low))
                    or (at[name] + step < low and at[name] <= low + 1e-12 * (high - low))
                    for name, step in zip(names, move)
                    for low, high in [self.effects[name].bounds]
                ]
            )
            if not (blocked & free).any():
                break
            free &= ~blocked
            move[~free] = 0
        new = {
            name: float(np.clip(at[name] + step, *self.effects[name].bounds))
            for name, step in zip(names, move)
        }
        size = max((abs(new[name] - at[name]) * scale[i] for i, name in enumerate(names)), default=0.0)
        return new, size

    def _moved(self, values, name):
        high = self.effects[name].bounds[1]
        step = self.residuals.slopes.steps[name]
        at = values[name]
        return {**values, name: at + step if at + step <= high else at - step}

    def whitened(self, candidates):
        """Return whitened residuals of many models, a bounded number at a time."""
        return np.concatenate(
            [self.residuals.whitened(candidates[i : i + 32]) for i in range(0, len(candidates), 32)]
        )

    def set_scale(self, residuals):
        """Fix the size beyond which a row's residual counts linearly, for all models compared with each other."""
        sizes = np.sum(residuals**2, axis=-1)
        typical = np.median(sizes[sizes > 0]) if (sizes > 0).any() else 0.0
        self.cut = max(largest_of_noise(residuals.shape[1]), 4 * typical)

    def weights(self, residuals):
        """Return the weight of each row, 1 within the scale and less beyond."""
        return np.sqrt(np.minimum(1.0, self.cut / np.maximum(np.sum(residuals**2, axis=-1), 1e-30)))

    def misfit(self, residuals):
        """Return twice the negative log likelihood, robust, of residuals whitened with their model's own noise, by row.

        Losses compare models in one whitening. Where a model misses, more passes for noise, which this counts. It is
        a mean over the rows that are evidence, since a model may leave some out: those whose past it does not know.
        """
        cut, sizes = largest_of_noise(residuals.shape[1]), np.sum(residuals**2, axis=-1)
        robust = np.where(sizes <= cut, sizes, 2 * np.sqrt(cut * sizes) - cut)
        n_rows = np.count_nonzero(self.residuals.present)
        return float(robust.sum() + self.residuals.log_determinant()) / n_rows

    def is_likelier(self, residuals, misfit, by):
        """Whether residuals, whitened with their model's own noise, are likelier than another model's misfit was.

        `by` so much of twice the log likelihood of all their rows.
        """
        n_rows = np.count_nonzero(self.residuals.present)
        return bool(n_rows * (misfit - self.misfit(residuals)) > by)

    def losses(self, residuals):
        """Return the robust loss of each block, in noise units."""
        return np.add.reduceat(self._robust(np.sum(residuals**2, axis=-1)), self.starts)

    def _robust(self, sizes):
        return np.where(sizes <= self.cut, sizes, 2 * np.sqrt(self.cut * sizes) - self.cut)
