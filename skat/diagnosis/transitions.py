"""Residuals of transitions whose states were measured, with noise: smoothed states, and whitening along each chain."""

from typing import Any

import numpy as np

from skat.diagnosis.residuals import Residuals, largest_of_noise
from skat.diagnosis.whitening import block_cholesky, estimate_variances

# Smoothed states stay this close to the measured ones, in standard deviations of the noise.
FARTHEST_SMOOTHED = 3.0
# A model that misses less than this share beyond the noise counts as right where states are smoothed.
NEGLIGIBLE_MISFIT = 1.3
# The noise is first estimated from about so many residuals, in runs of so many rows. From the first rows alone, an
# impact among them passed for noise of a velocity, and left none for the position; so it did in a puck from
# 960 residuals, and no later estimate came back from there.
RESIDUALS_FOR_FIRST_NOISE = 2400
RUN_FOR_FIRST_NOISE = 12


class TransitionResiduals(Residuals):
    """Whitened one-step residuals of measured transitions; the states they start from carry noise, too."""

    def __init__(self, simulator, log, effects, deviations=None, *, n_jobs=None):
        super().__init__(simulator, log, effects, deviations, n_jobs=n_jobs)
        self.places = log.chains()
        self.transitions = np.zeros((len(log), self.n_channels, self.n_channels))
        # Of what smoothing leaves unknown of each state: axes (in columns) and variances, in units of the noise. Along
        # them, second derivatives over one standard deviation of the noise, which then had these variances.
        self.axes = np.tile(np.eye(self.n_channels), (len(log), 1, 1))
        self.unknown = np.zeros((len(log), self.n_channels))
        self.curvatures = np.zeros((len(log), self.n_channels, self.n_channels))
        self.variances_stepped = np.ones(self.n_channels)
        self.drift_share = 0.0
        self.noise = np.zeros((len(log), self.n_channels))
        self.whitener: Any = None

    def settle(self, values, *, roughly=False):
        """Smooth the measured states with the model, and differentiate the next state by the state there."""
        if self.variances is None:
            self.variances = self._first_variances(values)
        if self.whitener is None:
            self.differentiate(values)
        self._leave_out_unknown(values)
        raw = self.raw_residuals([values])[0]
        raw[~self.present | ~np.isfinite(raw).all(axis=-1)] = 0.0
        scale = self.deviations
        whitener = self._factorised(self._missed(raw))
        noise = whitener.smooth(_padded(raw / scale, self.places))
        noise = np.clip(noise[self.places], -FARTHEST_SMOOTHED, FARTHEST_SMOOTHED)
        self.noise = noise * scale
        self.points = self.simulator.displace(self.log.X, -self.noise)
        if not roughly:
            unknown, self.axes = np.linalg.eigh(whitener.smoothed_covariances()[self.places])
            self.unknown = np.clip(unknown, 0.0, 1.0)
            self.differentiate(values)
        if self.regressors.shape[-1]:
            self._estimate_noise(self._model_residuals(values))

    def _missed(self, raw):
        """Return the variance (n_rows, n_channels) that residuals have beyond the noise, as far as can be seen.

        What a model misses is no noise of the state, so states are smoothed the less, the more it misses: everywhere,
        where the typical row shows it, and in single rows beyond what noise explains, such as at contacts. A row is
        judged by itself before it is judged by its chain, where the misses of its neighbours would pass for its own.
        """
        expected = self.residual_variances()
        typical = np.median(expected, axis=0)
        found = (1.4826 * np.median(np.abs(raw[self.present]), axis=0)) ** 2
        missed = np.where(found > NEGLIGIBLE_MISFIT * typical, found - typical, 0.0) + 0.0 * expected
        alone = np.arange(len(self.log)), np.zeros(len(self.log), dtype=int)
        for places in (alone, self.places):
            white = self._factorised(missed, places).whiten(_padded(raw / self.deviations, places))[places]
            sizes = np.sum(white**2, axis=-1)
            beyond = np.where(sizes > largest_of_noise(self.n_channels), sizes / self.n_channels - 1, 0.0)
            missed = missed + beyond[:, None] * (expected + missed)
        return missed

    def raw_residuals(self, candidates):
        """Return residuals at the smoothed states, carried to the measured ones to first order, less their drift."""
        carried = np.einsum("nij,nj->ni", self.transitions, self.noise) + self.drift_share * self._drift()
        return super().raw_residuals(candidates) - carried

    def _drift(self):
        """Return what the noise that smoothing leaves unknown adds to the next state on average, to second order.

        That is for normal noise. At contacts the outcome itself tells on which side of the kink a state was, and less
        than all of it is left: `drift_share`.
        """
        return np.einsum("nij,nj->ni", self._bends(), self.unknown) / 2

    def _bends(self):
        """Return second derivatives along the axes, in units of the present noise (n_rows, n_channels, n_axes)."""
        ratio = self.variances / self.variances_stepped
        return self.curvatures * np.einsum("nja,j->na", self.axes**2, ratio)[:, None]

    def _first_variances(self, values):
        """Estimate the noise from a part of the log, all effects regressed out, at the measured states."""
        spread = np.sqrt(self.smallest) * 1e6
        n_rows = RESIDUALS_FOR_FIRST_NOISE // self.n_channels
        if len(self.log) > n_rows + RUN_FOR_FIRST_NOISE:
            part = self.log.part(n_rows, RUN_FOR_FIRST_NOISE)
            inner = TransitionResiduals(self.simulator, part, self.effects.values(), n_jobs=self.n_jobs)
            variances = inner._first_variances(values)
            self.slopes = inner.slopes
            self.n_simulated_rows += inner.n_simulated_rows
            return variances
        raw = super().raw_residuals([values])[0]
        self._leave_out_diverged(~np.isfinite(raw).all(axis=-1))
        raw = np.where(self.present[:, None], raw, 0.0)
        deviation = 1.4826 * np.median(np.abs(raw[self.present]), axis=0) / np.sqrt(2)
        self.variances = np.maximum(np.minimum(deviation, 0.02 * spread) ** 2, self.smallest)
        self.differentiate(values)
        self.regressors = self._derivatives(values, self.effects)
        self._estimate_noise(raw)
        return self.variances

    def differentiate(self, values):
        """Differentiate the next state by the state, along the axes over one standard deviation to both sides."""
        deviations = self.deviations
        self.variances_stepped = self.variances
        n, d = len(self.log), self.n_channels
        moved = [self.points]
        for axis in range(d):
            step = self.axes[:, :, axis] * deviations
            moved += [self.simulator.displace(self.points, sign * step) for sign in (1, -1)]
        stacked = np.concatenate(moved)
        groups = np.concatenate(
            [self.log.episodes + copy * self.log.n_episodes for copy in range(len(moved))]
        )
        self.n_simulated_rows += len(stacked)
        next_states = self.simulator.predict_many(stacked, [values], groups=groups)[0].reshape(
            2 * d + 1, n, -1
        )
        base = next_states[0]
        up = np.stack([self.simulator.residual(one, base) for one in next_states[1::2]], axis=-1)
        down = np.stack([self.simulator.residual(one, base) for one in next_states[2::2]], axis=-1)
        self.transitions = np.nan_to_num((up - down) / 2) @ np.swapaxes(self.axes, 1, 2) / deviations
        self.curvatures = np.nan_to_num(up + down)
        self._leave_out_diverged(~np.isfinite(base).all(axis=-1))
        self.whitener = self._factorised()
        self._leave_out_unknown(values)

    @property
    def extra(self):
        """Variance that the curvature of the simulation adds: f'' e^2 / 2 has (f'' s^2)^2 / 2 for normal noise."""
        return np.sum(self._bends() ** 2, axis=-1) / 2

    def _leave_out(self, rows):
        if (self.present & rows).any():
            super()._leave_out(rows)
            if self.whitener is not None:
                self.whitener = self._factorised()

    def _set_variances(self, variances):
        self.variances = variances
        self.whitener = self._factorised()

    def _estimate_noise(self, raw):
        """Estimate the noise and the share of the drift from what all regressors, linearly, do not explain."""
        drift = np.where(self.present[:, None], self._drift(), 0.0)
        columns = np.concatenate([self.regressors, drift[..., None]], axis=-1)
        rows = self.present
        follows = (np.diff(self.places[0], prepend=-1) == 0) & rows & np.roll(rows, 1)
        for _ in range(2):
            solution = self._solution(raw, columns)
            if self.given_variances is None:
                left = (raw - columns @ solution)[rows]
                self._set_variances(
                    estimate_variances(
                        left,
                        self.transitions[rows],
                        self.extra[rows],
                        smallest=self.smallest,
                        follows=follows[rows],
                    )
                )
        before = self.drift_share
        self.drift_share = float(np.clip(before + solution[-1], 0.0, 1.0))
        return raw - (self.drift_share - before) * drift

    def _factorised(self, missed=0.0, places=None):
        places, scale = self.places if places is None else places, self.deviations
        return block_cholesky(
            _padded(self.transitions * scale / scale[:, None], places),
            np.ones(self.n_channels),
            _padded((self.extra + missed) / self.variances, places),
            _padded(self.present, places),
        )

    def whiten(self, columns):
        """Return raw columns (n_rows, n_channels[, k]) uncorrelated and in units of the noise."""
        scale = self.deviations.reshape((-1,) + (1,) * (columns.ndim - 2))
        return self.whitener.whiten(_padded(columns / scale, self.places))[self.places]

    def log_determinant(self):
        """Return the logarithm of the determinant of the residuals' covariance, as the noise now is."""
        factors = np.diagonal(self.whitener.factors, axis1=-2, axis2=-1)[self.places][self.present]
        return super().log_determinant() + float(2 * np.log(factors).sum())

    def squares_of_noise(self, values, n_draws, random_state):
        """Return squared errors between states drawn about the smoothed ones and about their outcomes."""
        (outcomes,) = self.simulator.predict_many(self.points, [values], groups=self.log.groups)
        squares = np.empty((n_draws, len(self.log), self.n_channels))
        for one in squares:
            at_start, at_end = random_state.normal(size=(2, *one.shape)) * self.deviations
            starts = self.simulator.displace(self.points, at_start)
            (predicted,) = self.simulator.predict_many(starts, [values], groups=self.log.groups)
            one[:] = self.simulator.residual(self.simulator.displace(outcomes, at_end), predicted) ** 2
        return np.where(np.isfinite(squares), squares, self.residual_variances())

    def residual_variances(self):
        """Return the variances (n_rows, n_channels) of raw residuals under a right model, to first order."""
        return np.einsum("nij,j->ni", self.transitions**2, self.variances) + self.variances + self.extra

    def _typical_deviations(self):
        return np.sqrt(np.median(self.residual_variances(), axis=0))


def _padded(rows, places):
    """Return rows as (n_chains, n_steps, ...), zero where a chain is shorter; `places` are their chains and steps."""
    chain, step = places
    out = np.zeros((chain[-1] + 1, step.max() + 1, *rows.shape[1:]), dtype=rows.dtype)
    out[places] = rows
    return out
