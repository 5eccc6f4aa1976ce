"""Whole episodes in open loop, from measured or fitted initial states."""

import numpy as np

from skat.diagnosis.log import measured_channels

FIT_STEPS = 12
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

    def sensitivities(self, values, initial, steps):
        """Return residuals at the initial states and their derivatives by them.

        Returns
        -------
        residuals : ndarray of shape (n_rows, n_measured)
        derivatives : ndarray of shape (n_rows, n_measured, n_states)
            By which a unit of each tangent direction of the row's own initial state lowers the residual.
        """
        n_directions = len(self.measured)
        n_episodes = len(initial)
        moved = np.concatenate(
            [
                initial,
                *(
                    self.simulator.displace(initial, np.broadcast_to(row, (n_episodes, n_directions)))
                    for row in np.diag(steps)
                ),
            ]
        )
        inputs = np.tile(self.inputs, (n_directions + 1, 1, 1))
        paths = self.simulator.rollout_many(moved, inputs, [values], n_steps=self.n_steps)[0]
        paths = paths.reshape(n_directions + 1, n_episodes, self.n_steps + 1, -1)[:, :, 1:]
        at = [self.simulator.residual(self.log.y, path[self.place])[:, self.measured] for path in paths]
        derivatives = np.stack([(at[0] - one) / step for one, step in zip(at[1:], steps)], axis=-1)
        return at[0], derivatives

    def fit_initial_states(self, values, deviations, present=None):
        """Return the initial states that explain each episode best, by damped Gauss-Newton.

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
        spread = self.simulator.residual(self.log.y, np.broadcast_to(self.log.y[:1], self.log.y.shape)).std(
            axis=0
        )
        steps = 1e-4 * np.where(spread > 0, spread, 1.0)
        initial = self.initial
        n_episodes, n_directions = len(initial), len(self.measured)
        episodes = self.log.episodes if present is None else self.log.episodes[present]
        best_loss = np.full(n_episodes, np.inf)
        best = initial.copy()
        moves = np.zeros((n_episodes, n_directions))
        damping = np.full(n_episodes, 1e-6)
        information = np.zeros((n_episodes, n_directions, n_directions))
        score = np.zeros((n_episodes, n_directions))
        for _ in range(FIT_STEPS):
            trial = self.simulator.displace(best, moves)
            residuals, derivatives = self.sensitivities(values, trial, steps)
            white, design = residuals / deviations, derivatives / deviations[:, None]
            if present is not None:
                white, design = white[present], design[present]
            losses = np.bincount(episodes, np.sum(white**2, axis=1), minlength=n_episodes)
            better = np.nan_to_num(losses, nan=np.inf) < best_loss
            best[better], best_loss[better] = trial[better], losses[better]
            damping = np.where(better, np.maximum(damping / 10, 1e-9), damping * 30)
            for episode in np.flatnonzero(better):
                rows = episodes == episode
                flat = np.nan_to_num(design[rows]).reshape(-1, n_directions)
                information[episode] = flat.T @ flat
                score[episode] = flat.T @ np.nan_to_num(white[rows]).ravel()
            for episode in np.arange(n_episodes):
                scale = np.sqrt(np.maximum(np.diag(information[episode]), 1e-300))
                inner = information[episode] / np.outer(scale, scale) + damping[episode] * np.eye(
                    n_directions
                )
                moves[episode] = np.linalg.lstsq(inner, score[episode] / scale, rcond=1e-12)[0] / scale
            if np.all(np.abs(moves) < steps) or damping.min() > 1e6:
                break
        if not np.isfinite(best_loss).all():
            lost = self.log.label(np.flatnonzero(~np.isfinite(best_loss))[0])
            raise RuntimeError(
                f"The simulation of episode {lost} diverges from the initial state in its first row: cut the episode "
                "into shorter ones, or leave it out."
            )
        return best
