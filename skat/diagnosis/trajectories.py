"""Whitened residuals of open-loop trajectories, for logs of which some state channels were not measured."""

import numpy as np

from skat.diagnosis.open_loop import Episodes
from skat.diagnosis.residuals import Residuals

# An effect counts as made up for by initial states where less than this share of its derivative is left.
LEAST_SHARE = 1e-4


class TrajectoryResiduals(Residuals):
    """Residuals of measured channels along whole episodes, each with an initial state of its own that is fitted.

    What an initial state can explain is projected out of residuals and derivatives alike; what is left of the noise is
    taken as an autoregression of first order. Where an action is delayed, the first rows of an episode, in which one
    from before the log acts, do not count: what it does to later ones, an initial state makes up for.

    Parameters
    ----------
    simulator, log, effects, deviations
        As in `Residuals`.
    hidden : sequence of str
        State channels that were not measured.
    """

    def __init__(self, simulator, log, effects, deviations=None, *, hidden):
        self.episodes = Episodes(simulator, log, hidden)
        super().__init__(simulator, log, effects, deviations)
        self.initial = self.episodes.initial
        self.correlation = np.zeros(self.n_channels)
        self.nuisance = None

    @property
    def channels(self):
        """Names of the channels measured."""
        return tuple(np.array(self.simulator.residual_names)[self.episodes.measured].tolist())

    @property
    def independent(self):
        """Episode of each row: in open loop an error lasts through its episode."""
        return self.log.episodes

    def settle(self, values, *, roughly=False):
        """Fit the initial states to the model."""
        self._leave_out_unknown(values)
        if self.variances is None:
            raw = self.episodes.residuals([values])[0]
            self.variances = np.maximum(np.nan_to_num(np.nanvar(raw, axis=0), nan=1.0), self.smallest)
        self.initial = self.episodes.fit_initial_states(values, self.deviations, self.present)
        _, self.nuisance = self.episodes.sensitivities(values, self.initial)

    def differentiate(self, values):
        """Fit the initial states to the model."""
        self.settle(values)

    def noise_errors(self, candidates):
        """Return the squared open-loop errors (n_candidates, n_rows) in units of what noise gives.

        Infinite where a candidate diverges. What fitted initial states take of the noise is made up for.
        """
        errors = np.mean(self.raw_residuals(candidates) ** 2 / self.variances, axis=-1)[:, self.present]
        return np.nan_to_num(errors, nan=np.inf) / self.episodes.noise_left()

    def error_sizes(self, candidates, n_rows):
        """Return the log root mean square of the whitened trajectories of each candidate."""
        return np.array([np.log(np.sqrt(np.mean(one**2))) for one in self.whitened(candidates)])

    def _derivatives(self, values, names):
        """Return derivatives, zero for effects that an initial state makes up for entirely."""
        return self._without_made_up(super()._derivatives(values, names))

    def secants(self, values, widths):
        """Return slopes of secants, zero for effects that an initial state makes up for entirely."""
        return self._without_made_up(super().secants(values, widths))

    def _without_made_up(self, raw):
        shown = self._counted(raw)
        left = self._without_initial_states(shown, self._counted(self.nuisance))
        norms, kept = np.linalg.norm(shown, axis=(0, 1)), np.linalg.norm(left, axis=(0, 1))
        return raw * (kept > LEAST_SHARE * norms)

    def raw_residuals(self, candidates):
        """Return measured minus rolled out from the fitted initial states."""
        self.n_simulated_rows += len(self.log) * len(candidates)
        return self.episodes.residuals(candidates, self.initial)

    def _changes(self, candidates, rows=slice(None)):
        raw = self.raw_residuals(candidates)[:, rows]
        return raw[:1] - raw[1:]

    def _smallest_variances(self):
        return (1e-6 * self.episodes.spread[self.episodes.measured]) ** 2

    def _estimate_noise(self, raw):
        """Estimate variance and correlation of what neither initial states nor all effects explain."""
        if self.given_variances is not None:
            return raw
        left = raw - self.regressors @ self._solution(raw, self.regressors)
        left = self._without_initial_states(self._counted(left)[..., None], self._counted(self.nuisance))[
            ..., 0
        ]
        count = np.count_nonzero(self.present)
        lost = self.log.n_episodes * len(self.episodes.measured) / self.n_channels
        lost += min(self.regressors.shape[-1], max(1, count * self.n_channels // 10)) / self.n_channels
        share = max(1 - lost / count, 0.1)
        squares = np.sum(left**2, axis=0) / count
        self.variances = np.maximum(squares / share, self.smallest)
        follows = self._follows()
        products = np.mean(left[follows] * left[follows - 1], axis=0) / np.maximum(squares, 1e-300)
        # What is projected out leaves residuals correlated by about -lost / n.
        self.correlation = np.clip(products + lost / count, 0.0, 0.95)
        return raw

    def _without_initial_states(self, columns, initial_state):
        out = np.array(columns)
        for rows, basis in self._bases(initial_state):
            flat = columns[rows].reshape(len(basis), -1)
            out[rows] = (flat - basis @ (basis.T @ flat)).reshape(columns[rows].shape)
        return out

    def _bases(self, initial_state):
        """Yield the rows of each episode and an orthonormal basis (n_rows * n_channels, k) of its initial state."""
        for episode in range(self.log.n_episodes):
            rows = np.flatnonzero(self.log.episodes == episode)
            nuisance = initial_state[rows].reshape(-1, initial_state.shape[-1])
            norms = np.linalg.norm(nuisance, axis=0)
            basis, values, _ = np.linalg.svd(nuisance[:, norms > 0] / norms[norms > 0], full_matrices=False)
            yield rows, basis[:, values > 1e-8]

    def taken(self):
        """Return what an initial state can explain of its episode."""
        nuisance = self._white_nuisance()
        taken = np.zeros_like(nuisance)
        for rows, basis in self._bases(nuisance):
            taken[rows, :, : basis.shape[1]] = basis.reshape(len(rows), self.n_channels, -1)
        return taken

    def _white_nuisance(self):
        return self._decorrelated(self._counted(self.nuisance) / self.deviations[:, None])

    def whiten(self, columns):
        """Return raw columns without what initial states explain, uncorrelated and in units of the noise."""
        wide = columns[..., None] if columns.ndim == 2 else columns
        scaled = self._counted(wide) / self.deviations[:, None]
        white = self._without_initial_states(self._decorrelated(scaled), self._white_nuisance())
        return white[..., 0] if columns.ndim == 2 else white

    def log_errors(self, candidates):
        """Return log(1 + e) of the squared whitened residuals e of each row (n_candidates, n_rows)."""
        return np.log1p(np.mean(self.whitened(candidates) ** 2, axis=-1))[:, self.present]

    def log_determinant(self):
        """Return the logarithm of the determinant of the residuals' covariance, as the noise now is."""
        return super().log_determinant() + float(
            len(self._follows()) * np.log1p(-(self.correlation**2)).sum()
        )

    def _decorrelated(self, columns):
        rho = self.correlation[:, None]
        white = np.array(columns)
        follows = self._follows()
        white[follows] = (columns[follows] - rho * columns[follows - 1]) / np.sqrt(1 - rho**2)
        return white

    def _counted(self, columns):
        """Return columns (n_rows, ...) with zeros in rows that do not count."""
        return np.where(self.present.reshape(-1, *(1,) * (columns.ndim - 1)), columns, 0.0)

    def _follows(self):
        """Return the rows that count and follow another one that does."""
        together = (np.diff(self.log.episodes) == 0) & self.present[1:] & self.present[:-1]
        return np.flatnonzero(together) + 1

    def directions(self, values):
        """Return no directions: what is left of a trajectory is not tested for a place in state space."""
        return np.zeros((len(self.log), self.n_channels, 0)), ()
