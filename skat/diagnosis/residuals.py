"""What a log and a simulation disagree on, in units of the noise, and how each effect would change it.

Three kinds of log, one interface: rows that are independent of each other (`Residuals`), transitions whose state was
measured (`TransitionResiduals`, in `transitions.py`), and episodes of which only some channels were measured
(`TrajectoryResiduals`, in `trajectories.py`). The rest of the diagnosis knows only whitened residuals and derivatives.
"""

from dataclasses import dataclass, replace
from typing import Any

import joblib
import numpy as np
from scipy import stats

from skat.diagnosis.slopes import LEAST_CHANGE, Slopes
from skat.diagnosis.whitening import estimate_variances
from skat.simulators.base import UNBOUNDED

# Where few rows stand for a log, so many follow each other: an action may act on the row after.
ROWS_OF_RUN = 3
# Fewer simulated rows are not worth sending to other processes.
FEWEST_ROWS_TO_SHARE = 5000
# Squared error of a row, in noise units, in which a simulation diverges.
DIVERGED = 1e6
# Predictions are kept up to so many bytes.
MOST_KEPT = 64_000_000
# Effects regressed out before the noise is estimated: at most one for so many residuals.
RESIDUALS_PER_REGRESSOR = 10


@dataclass(frozen=True)
class Linearisation:
    """Whitened residuals at a model and their derivatives by its effects.

    Attributes
    ----------
    values : dict of str to float
        The effects that the model has.
    residuals : ndarray of shape (n_rows, n_channels)
        Standard normal and uncorrelated where the model is right.
    derivatives : ndarray of shape (n_rows, n_channels, n_effects)
        By which adding a unit of each effect lowers the residuals.
    names : tuple of str
        The effects of the last axis.
    """

    values: dict
    residuals: np.ndarray
    derivatives: np.ndarray
    names: tuple


class Residuals:
    """Whitened residuals of independent rows: the inputs are exact, the outputs carry noise.

    Parameters
    ----------
    simulator : Simulator
    log : Log
    effects : sequence of Effect
        All that the simulation could take on.
    deviations : ndarray of shape (n_channels,) or None
        Standard deviations of the measurement noise; None: estimated from the residuals.
    n_jobs : int or None, default=None
        Processes of joblib that share the candidates of a call.
    """

    def __init__(self, simulator, log, effects, deviations=None, *, n_jobs=None):
        self.simulator, self.log, self.n_jobs = simulator, log, n_jobs
        self.effects = {effect.name: _bounded(effect, simulator, log) for effect in effects}
        self.blocks = log.blocks()
        self.given_variances = None if deviations is None else np.asarray(deviations, dtype=float) ** 2
        self.points = log.X
        self.present = np.ones(len(log), dtype=bool)
        delayed = any(effect.family == "delay" for effect in effects) and log.consecutive
        if delayed and (log.steps > 0).any():
            self.present = log.steps > 0
        self.diverged = np.zeros(len(log), dtype=bool)
        self.smallest = self._smallest_variances()
        self.variances: Any = self.given_variances
        self.regressors = np.zeros((len(log), self.n_channels, 0))
        self.forces = simulator.joint_forces()
        self.slopes = Slopes([*self.effects.values(), *(force for force, _ in self.forces)])
        self.n_simulated_rows = 0
        # Predictions of models at the points, which a search asks for again and again.
        self.predicted_at, self.predicted = self.points, {}

    @property
    def channels(self):
        """Names of the columns of a residual."""
        return tuple(self.simulator.residual_names)

    @property
    def n_channels(self):
        """Number of columns of a residual."""
        return len(self.channels)

    @property
    def independent(self):
        """Part of the log, of each row, from which its errors do not reach into another."""
        return self.blocks

    @property
    def deviations(self):
        """Standard deviations of the measurement noise, in the channels' units."""
        return np.sqrt(self.variances)

    # -- linearisation ---------------------------------------------------------------------------------------

    def settle(self, values, *, roughly=False):
        """Bring noise, whitening and the points of linearisation up to date with a model.

        Parameters
        ----------
        values : dict of str to float
        roughly : bool, default=False
            Leave as they are what is costly and changes little from one model to one close to it.
        """
        if self.variances is None:
            self.variances = self._first_variances(values)
        self._leave_out_unknown(values)

    def differentiate(self, values):
        """Differentiate predictions by the state they start from, as far as `noise_errors` needs it: not at all."""
        self._leave_out_unknown(values)

    def linearise(self, values, names):
        """Return the Linearisation by the named effects, at the points that `settle` found.

        All named effects are regressed out of the residuals before the noise is estimated anew.
        """
        raw = self._model_residuals(values)
        derivatives = self._derivatives(values, names)
        self.regressors = derivatives
        raw = self._estimate_noise(raw)
        return Linearisation(dict(values), self.whiten(raw), self.whiten(derivatives), tuple(names))

    def with_slopes(self, line, names, slopes):
        """Return the last Linearisation with raw slopes (n_rows, n_channels, n_names) in place of some derivatives."""
        self.regressors = self.regressors.copy()
        self.regressors[..., [line.names.index(name) for name in names]] = slopes
        return self.shifted(line, line.values)

    def shifted(self, line, values):
        """Return the last Linearisation carried to a model close to its own: residuals anew, derivatives kept."""
        raw = self._estimate_noise(self._model_residuals(values))
        return Linearisation(dict(values), self.whiten(raw), self.whiten(self.regressors), line.names)

    def whitened(self, candidates):
        """Return whitened residuals (n_candidates, n_rows, n_channels) of other models, in the same whitening.

        A row in which a candidate diverges, and the model of the last linearisation did not, counts as far off.
        """
        raw = self.raw_residuals(candidates)
        diverged = ~np.isfinite(raw).all(axis=-1)
        raw[diverged] = 0
        white = np.moveaxis(self.whiten(np.moveaxis(raw, 0, -1)), -1, 0)
        white[diverged & self.present] = np.sqrt(DIVERGED)
        return white

    def error_sizes(self, candidates, n_rows):
        """Return how far each candidate is off, by no measure of noise: the sum over channels of log errors.

        Parameters
        ----------
        candidates : sequence of dict
            Effect values.
        n_rows : int
            About so many rows, short runs spread over the log, are simulated from their measured states.

        Returns
        -------
        ndarray of shape (n_candidates,)
            Infinite where most rows diverge.
        """
        part = self.log.part(n_rows, ROWS_OF_RUN)
        sizes = []
        for i in range(0, len(candidates), 64):
            self.n_simulated_rows += len(part) * len(candidates[i : i + 64])
            for one in self.simulator.predict_many(part.X, candidates[i : i + 64], groups=part.groups):
                errors = np.nan_to_num(np.abs(self.simulator.residual(part.y, one)), nan=np.inf)
                with np.errstate(divide="ignore"):
                    sizes.append(
                        np.sum(np.log(np.maximum(np.median(errors, axis=0), np.sqrt(self.smallest))))
                    )
        return np.array(sizes)

    def moved(self, values, candidates, n_rows):
        """Return for each candidate whether any of about so many rows is predicted otherwise than by a model."""
        rows = np.unique(np.linspace(0, len(self.log) - 1, n_rows).astype(int))
        changes = np.abs(self._changes([values, *candidates], rows)) / self._typical_deviations()
        return np.max(np.nan_to_num(changes), axis=(1, 2)) >= LEAST_CHANGE

    def derivatives(self, values, names):
        """Return the whitened derivatives (n_rows, n_channels, n_effects) at a model."""
        return self.whiten(self._derivatives(values, names))

    def _derivatives(self, values, names):
        return self.slopes.derivatives(
            self._changes, values, names, n_rows=len(self.log), deviations=self._typical_deviations()
        )

    def choose_steps(self, values, names):
        """Choose the steps of effects anew, as fits a model and its noise: the first were chosen before either."""
        self.slopes.choose(
            self._changes, values, names, n_rows=len(self.log), deviations=self._typical_deviations()
        )

    def secants(self, values, widths):
        """Return the raw slopes of secants about a model, as `Slopes.secants`."""
        return self.slopes.secants(self._changes, values, widths)

    def _changes(self, candidates, rows=None):
        """Return by how much the predictions of the candidates after the first exceed the first's."""
        base, *moved = self._predict(candidates, rows)
        return np.stack([self.simulator.residual(one, base) for one in moved])

    def _solution(self, raw, columns):
        """Return the coefficients (n_columns,) by which raw columns together explain raw residuals, robustly."""
        white, design = self.whiten(raw), self.whiten(columns)
        flat = design.reshape(white.size, -1)
        scale = np.sqrt(np.einsum("ij,ij->j", flat, flat))
        usable = scale > 0
        found = np.zeros(len(scale))
        if not usable.any():
            return found
        flat = flat[:, usable] / scale[usable]
        weights = np.repeat(robust_weights(white), self.n_channels)
        values, vectors = np.linalg.eigh((flat * weights[:, None]).T @ flat)
        most = max(1, flat.shape[0] // RESIDUALS_PER_REGRESSOR)
        kept = np.argsort(values)[::-1][:most]
        kept = kept[values[kept] > 1e-8 * values.max()]
        right = flat.T @ (weights * white.reshape(-1))
        solution = vectors[:, kept] @ ((vectors[:, kept].T @ right) / values[kept])
        found[usable] = solution / scale[usable]
        return found

    def _model_residuals(self, values):
        """Return the raw residuals of a model; rows in which it diverges are no evidence any more."""
        raw = self.raw_residuals([values])[0]
        self._leave_out_diverged(~np.isfinite(raw).all(axis=-1))
        return np.where(self.present[:, None], raw, 0.0)

    def _leave_out_diverged(self, rows):
        self.diverged = self.diverged | rows
        self._leave_out(rows)
        if not self.present.any():
            raise RuntimeError("The simulation diverges in every row; check that these rows are physical.")

    def _leave_out_unknown(self, values):
        """Leave out the rows in which an action from before the log still acts, unless that is all."""
        if self.log.consecutive:
            unknown = self.log.steps < self.simulator.n_lags(values)
            if (self.present & ~unknown).any():
                self._leave_out(unknown)

    def _leave_out(self, rows):
        self.present = self.present & ~rows

    def raw_residuals(self, candidates):
        """Return measured minus predicted (n_candidates, n_rows, n_channels), NaN where a simulation diverges."""
        return np.stack([self.simulator.residual(self.log.y, one) for one in self._predict(candidates)])

    def _predict(self, candidates, rows=None):
        """Return predictions (n_candidates, n_rows, n_channels) at the points, of all rows or some of them."""
        if rows is not None:
            return self._simulated(self.points[rows], candidates, self.log.groups[rows])
        if self.predicted_at is not self.points:
            self.predicted_at, self.predicted = self.points, {}
        keys = [tuple(sorted(candidate.items())) for candidate in candidates]
        new = {key: one for key, one in zip(keys, candidates) if key not in self.predicted}
        found = self._simulated(self.points, list(new.values()), self.log.groups) if new else ()
        together = self.predicted | dict(zip(new, found))
        predictions = np.stack([together[key] for key in keys])
        self.predicted = together if predictions[0].nbytes * len(together) < MOST_KEPT else {}
        return predictions

    def _simulated(self, points, candidates, groups):
        n_rows = len(points) * len(candidates)
        self.n_simulated_rows += n_rows
        n_parts = min(joblib.effective_n_jobs(self.n_jobs), len(candidates))
        if n_parts == 1 or n_rows < FEWEST_ROWS_TO_SHARE:
            return self.simulator.predict_many(points, candidates, groups=groups)
        parts = joblib.Parallel(n_jobs=self.n_jobs)(
            joblib.delayed(self.simulator.predict_many)(points, candidates[part::n_parts], groups=groups)
            for part in range(n_parts)
        )
        predictions = np.empty((len(candidates), *parts[0].shape[1:]))
        for part, one in enumerate(parts):
            predictions[part::n_parts] = one
        return predictions

    # -- noise -----------------------------------------------------------------------------------------------------

    def _smallest_variances(self):
        y = self.log.y
        spread = self.simulator.residual(y, np.broadcast_to(y[:1], y.shape)).std(axis=0)
        return (1e-6 * np.where(spread > 0, spread, 1.0)) ** 2

    def _first_variances(self, values):
        raw = self._model_residuals(values)[self.present]
        return np.maximum((1.4826 * np.median(np.abs(raw), axis=0)) ** 2, self.smallest)

    def _estimate_noise(self, raw):
        """Estimate the noise from what all regressors together, linearly, do not explain; return the residuals."""
        if self.given_variances is None:
            for _ in range(2):
                left = (raw - self.regressors @ self._solution(raw, self.regressors))[self.present]
                none = np.zeros((len(left), self.n_channels, self.n_channels))
                self._set_variances(estimate_variances(left, none, 0.0 * left, smallest=self.smallest))
        return raw

    def _set_variances(self, variances):
        self.variances = variances

    def _typical_deviations(self):
        """Standard deviation of each channel's raw residual under a right model."""
        return np.sqrt(self.variances)

    def whiten(self, columns):
        """Return raw columns (n_rows, n_channels[, k]) in units of the noise; rows without evidence are zero."""
        extra = (1,) * (columns.ndim - 2)
        present, deviations = self.present.reshape(-1, 1, *extra), np.sqrt(self.variances).reshape(-1, *extra)
        return np.where(present, columns, 0.0) / deviations

    def state(self):
        """Return what `settle` and `linearise` have found, for `restore`."""
        return {name: value for name, value in vars(self).items() if name != "n_simulated_rows"}

    def restore(self, state):
        """Go back to an earlier model's noise, whitening and points of linearisation."""
        vars(self).update(state)

    def log_determinant(self):
        """Return the logarithm of the determinant of the residuals' covariance, as the noise now is."""
        return float(np.count_nonzero(self.present) * np.log(self.variances).sum())

    def taken(self):
        """Return orthonormal columns (n_rows, n_channels, n_columns) that are projected out of whitened residuals.

        Each row has those of its own episode.
        """
        return np.zeros((len(self.log), self.n_channels, 0))

    def directions(self, values):
        """Return raw additive errors of the prediction that a remainder is sought along, and their names.

        Parameters
        ----------
        values : dict of str to float
            The model.

        Returns
        -------
        columns : ndarray of shape (n_rows, n_channels, n_directions)
        directions : tuple of (str, tuple of str)
            What the error acts on, and the inputs that belong to it: a joint where the simulator knows its forces,
            which then stand for errors of velocities; otherwise an output.
        """
        outputs = self.simulator.residual_names
        moved = {name for _, inputs in self.forces for name in inputs[1:]}
        kept = [index for index, name in enumerate(outputs) if name not in moved]
        eye = np.diag(self._typical_deviations())[:, kept]
        columns = np.broadcast_to(eye, (len(self.log), *eye.shape))
        names = [(outputs[index], self._inputs_of(outputs[index])) for index in kept]
        if self.forces:
            responses = self._derivatives(values, [force.name for force, _ in self.forces])
            columns = np.concatenate([columns, responses], axis=-1)
            names += [(force.target, inputs) for force, inputs in self.forces]
        return columns, tuple(names)

    def _inputs_of(self, output):
        """Return the inputs that belong to an output: itself, and where forces are not known those of its joint."""
        joint = "" if self.forces else output.partition(".")[2]
        return tuple(
            name
            for name in self.simulator.input_names
            if name == output or (joint and name.partition(".")[2] == joint)
        )

    def noise_errors(self, candidates):
        """Return the squared one-step errors (n_candidates, n_rows) in units of what noise gives, to first order.

        From the measured states, not the smoothed ones; a smooth and right model has 1 on average. Rows in which a
        candidate diverges are left out, from then on.
        """
        errors = self.squared_errors(candidates)
        return np.mean(errors / self.residual_variances(), axis=-1)[:, self.present]

    def log_errors(self, candidates):
        """Return log(1 + e) of the errors e of `noise_errors` (n_candidates, n_rows): few that are huge do not decide.

        Rows in which a candidate diverges stay, as far off.
        """
        errors = np.mean(self._squared_errors(candidates) / self.residual_variances(), axis=-1)[
            :, self.present
        ]
        return np.log1p(np.nan_to_num(errors, nan=DIVERGED, posinf=DIVERGED))

    def channel_errors(self, values):
        """Return the root mean squared one-step error of each channel, by name, in its own unit."""
        (errors,) = self._squared_errors([values])
        return dict(
            zip(self.simulator.residual_names, np.sqrt(np.mean(errors[self.present], axis=0)).tolist())
        )

    def squared_errors(self, candidates):
        """Return squared one-step errors (n_candidates, n_rows, n_channels) from the measured states.

        Rows in which a candidate diverges are left out, from then on.
        """
        errors = self._squared_errors(candidates)
        self._leave_out_diverged(~np.isfinite(errors).all(axis=(0, 2)))
        return errors

    def squares_of_noise(self, values, n_draws, random_state):
        """Return squares (n_draws, n_rows, n_channels) that a model's one-step errors might have, were it right.

        Parameters
        ----------
        values : dict of str to float
            The model, which has settled.
        n_draws : int
            Without noise in what a row starts from there is nothing to draw: they are all the variance.
        random_state : numpy.random.RandomState
        """
        return np.broadcast_to(self.residual_variances(), (n_draws, len(self.log), self.n_channels))

    def _squared_errors(self, candidates):
        predictions = self.simulator.predict_many(self.log.X, candidates, groups=self.log.groups)
        return np.stack([self.simulator.residual(self.log.y, one) for one in predictions]) ** 2

    def residual_variances(self):
        """Return the variance of each raw residual under a right model, to first order: by row, or one row for all."""
        return self.variances


def _bounded(effect, simulator, log):
    """Return an effect; the bias of a sensor that has no bounds gets those of ten times what it read at most."""
    if effect.family != "bias" or np.ptp(effect.bounds) < UNBOUNDED:
        return effect
    read = np.nan_to_num(log.y[:, simulator.output_names.index(effect.target)])
    reach = 10 * float(np.abs(read).max()) or 1.0
    return replace(effect, bounds=(-reach, reach))


def largest_of_noise(n_channels):
    """Return the size of a row's whitened residual, its squares summed, that noise alone exceeds once in a thousand."""
    return float(stats.chi2.isf(1e-3, n_channels))


def robust_weights(residuals):
    """Return a weight in (0, 1] for each row: small where its residual is far beyond what is typical.

    Rows within what is typical, or within what noise explains, weigh 1.
    """
    sizes = np.sum(residuals**2, axis=-1)
    n_channels = residuals.shape[-1]
    noise = largest_of_noise(n_channels)
    typical = 4 * np.median(sizes[sizes > 0]) if (sizes > 0).any() else noise
    return np.sqrt(np.minimum(1.0, max(noise, typical) / np.maximum(sizes, 1e-30)))
