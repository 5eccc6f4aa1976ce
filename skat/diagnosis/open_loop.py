"""Whole episodes in open loop, from measured or fitted initial states."""

import numpy as np

from skat.diagnosis.log import measured_channels

FIT_STEPS = 12
# Of a channel's spread, over which to differentiate by its initial state.
RELATIVE_STEP = 1e-4
# Of a channel's spread: a change by less than that is none.
ROUNDING = 1e-11
# The rows of an episode that its initial state is fitted to, relative to those before, until it is whole.
GROWTH = 1.6
# In noise units squared: a step that lowers the loss by less was the last one.
SMALL_GAIN = 1e-3
MOST_DAMPING = 1e6
# Of an episode's residuals, what fitted initial states leave is never taken for a smaller share than this.
LEAST_FREE = 0.1


class Episodes:
    """The episodes of a log as padded arrays, to be rolled out side by side.

    Parameters
    ----------
    simulator : Simulator
        With a state.
    log : Log
        Of consecutive rows.
    hidden : sequence of str
        State channels that were not measured.
    """

    def __init__(self, simulator, log, hidden=()):
        self.simulator, self.log = simulator, log
        n_states = len(simulator.state_names)
        self.measured = measured_channels(simulator, hidden)
        lengths = np.bincount(log.episodes)
        self.place = log.episodes, log.steps
        self.n_steps = int(lengths.max())
        first = np.flatnonzero(log.steps == 0)
        self.initial = log.X[first, :n_states]
        self.inputs = np.zeros((log.n_episodes, self.n_steps, log.X.shape[1] - n_states))
        self.inputs[self.place] = log.X[:, n_states:]
        spread = simulator.residual(log.y, np.broadcast_to(log.y[:1], log.y.shape)).std(axis=0)
        self.spread = np.where(spread > 0, spread, 1.0)
        # By which each coordinate of an initial state is moved to differentiate.
        self.steps = RELATIVE_STEP * self.spread

    def noise_left(self):
        """Return the share of the noise's variance that initial states leave if they are fitted to it.

        They take up as many residuals of their episode as they have coordinates.
        """
        lengths = np.bincount(self.log.episodes)
        left = np.maximum(1 - len(self.measured) / (lengths * self.measured.sum()), LEAST_FREE)
        return float(np.average(left, weights=lengths))

    def residuals(self, candidates, initial=None):
        """Return measured minus rolled out, (n_candidates, n_rows, n_measured channels).

        Parameters
        ----------
        candidates : sequence of dict
            Effect values.
        initial : ndarray of shape (n_episodes, n_states), optional
            By default the measured ones.
        """
        initial = self.initial if initial is None else initial
        paths = self.simulator.rollout_many(initial, self.inputs, candidates, n_steps=self.n_steps)
        return np.stack(
            [self.simulator.residual(self.log.y, path[:, 1:][self.place])[:, self.measured] for path in paths]
        )

    def sensitivities(self, values, initial, *, horizon=None, episodes=None):
        """Return residuals at the initial states and their derivatives by them.

        Parameters
        ----------
        values : dict of str to float
            The model's effects.
        initial : ndarray of shape (n_episodes, n_states)
        horizon : int, optional
            So many rows of each episode are simulated. By default all.
        episodes : ndarray of int, optional
            Of these. By default all.

        Returns
        -------
        residuals : ndarray of shape (n_rows, n_measured)
            Zero in rows that are not simulated.
        derivatives : ndarray of shape (n_rows, n_measured, n_directions)
            By which a unit of each tangent direction of the row's own initial state lowers the residual.
        """
        horizon = self.n_steps if horizon is None else horizon
        episodes = np.arange(len(initial)) if episodes is None else episodes
        n_directions, n_episodes, log = len(self.measured), len(episodes), self.log
        rows = np.flatnonzero(np.isin(log.episodes, episodes) & (log.steps < horizon))
        place = np.searchsorted(episodes, log.episodes[rows]), log.steps[rows]
        start = initial[episodes]
        moved = [
            self.simulator.displace(start, np.broadcast_to(one, (n_episodes, n_directions)))
            for one in np.diag(self.steps)
        ]
        inputs = np.tile(self.inputs[episodes, :horizon], (n_directions + 1, 1, 1))
        paths = self.simulator.rollout_many(
            np.concatenate([start, *moved]), inputs, [values], n_steps=horizon
        )[0]
        paths = paths.reshape(n_directions + 1, n_episodes, horizon + 1, -1)[:, :, 1:]
        at = np.zeros((n_directions + 1, len(log), int(self.measured.sum())))
        for one, path in zip(at, paths):
            one[rows] = self.simulator.residual(log.y[rows], path[place])[:, self.measured]
        changes = np.stack([at[0] - one for one in at[1:]], axis=-1)
        # What nothing depends on, such as the orientation of what flies freely, would move by rounding errors else.
        changes[np.abs(changes) < ROUNDING * self.spread[self.measured, None]] = 0.0
        return at[0], changes / self.steps

    def fit_initial_states(self, values, deviations, present=None):
        """Return the initial states that explain each episode best, by damped Gauss-Newton.

        They are fitted to the first rows, then to more and more: where a guess of what was not measured is poor, the
        whole of an episode with contacts has many optima.

        Parameters
        ----------
        values : dict of str to float
            The model's effects.
        deviations : ndarray of shape (n_measured,)
            How much each measured channel counts.
        present : ndarray of bool of shape (n_rows,), optional
            Rows that count.

        Raises
        ------
        RuntimeError
            If an episode diverges from its measured initial state.
        """
        counts = np.ones(len(self.log), dtype=bool) if present is None else present
        best, horizon = self.initial, 0
        while horizon < self.n_steps:
            horizon = min(int(np.ceil(GROWTH * max(horizon, 1))), self.n_steps)
            best, loss = self._fitted(best, values, deviations, counts, horizon)
        if not np.isfinite(loss).all():
            lost = self.log.label(np.flatnonzero(~np.isfinite(loss))[0])
            raise RuntimeError(
                f"The simulation of episode {lost} diverges from the initial state in its first row: cut the episode "
                "into shorter ones, or leave it out."
            )
        return best

    def _fitted(self, initial, values, deviations, counts, horizon):
        """Return initial states fitted to the first rows of the episodes, and the loss of each episode."""
        n_episodes, n_directions = len(initial), len(self.measured)
        counts = counts & (self.log.steps < horizon)
        best, best_loss = initial.copy(), np.full(n_episodes, np.inf)
        moves = np.zeros((n_episodes, n_directions))
        damping = np.full(n_episodes, 1e-6)
        information = np.zeros((n_episodes, n_directions, n_directions))
        score = np.zeros((n_episodes, n_directions))
        active = np.arange(n_episodes)
        for _ in range(FIT_STEPS):
            trial = best.copy()
            trial[active] = self.simulator.displace(best[active], moves[active])
            residuals, derivatives = self.sensitivities(values, trial, horizon=horizon, episodes=active)
            white, design = residuals / deviations, derivatives / deviations[:, None]
            settled = []
            for episode in active:
                rows = (self.log.episodes == episode) & counts
                flat = white[rows].ravel()
                loss = np.nan_to_num(flat @ flat, nan=np.inf)
                better = loss < best_loss[episode]
                last = better and loss > best_loss[episode] - SMALL_GAIN
                if better:
                    by_state = np.nan_to_num(design[rows]).reshape(-1, n_directions)
                    best[episode], best_loss[episode] = trial[episode], loss
                    information[episode], score[episode] = by_state.T @ by_state, by_state.T @ flat
                damping[episode] = max(damping[episode] / 10, 1e-9) if better else damping[episode] * 30
                sizes = np.diag(information[episode])
                scale = np.sqrt(np.where(sizes > 0, sizes, 1.0))
                inner = information[episode] / np.outer(scale, scale) + damping[episode] * np.eye(
                    n_directions
                )
                moves[episode] = np.linalg.lstsq(inner, score[episode] / scale, rcond=1e-12)[0] / scale
                small = np.all(np.abs(moves[episode]) < self.steps)
                settled.append(small or last or damping[episode] > MOST_DAMPING)
            active = active[~np.array(settled)]
            if not len(active):
                break
        return best, best_loss
