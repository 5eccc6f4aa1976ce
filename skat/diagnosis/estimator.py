"""SimulationDiagnosis: what a user meets."""

import warnings

import numpy as np
from scipy import stats
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.exceptions import NotFittedError
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted

from skat.diagnosis.findings import Cause
from skat.diagnosis.gains import episode_gain, one_step_gain
from skat.diagnosis.identifiability import identifiability, preflight
from skat.diagnosis.log import check_log, check_matrix, measured_channels
from skat.diagnosis.omnibus import find_remainder, is_structured
from skat.diagnosis.plausibility import warn_of_doubts, warn_of_lasting_noise
from skat.diagnosis.report.from_first_engine import FirstReport as Report
from skat.diagnosis.residuals import Residuals
from skat.diagnosis.selection import Selection
from skat.diagnosis.trajectories import TrajectoryResiduals
from skat.diagnosis.transitions import TransitionResiduals
from skat.effects import Effect, unknown_name_message
from skat.simulators import Simulator

# Squared one-step errors in noise units up to which heavy tails and rounding of the noise are taken to be the cause.
CLEAN_EXCESS = 1.3
# Squared error of a row, in noise units, beyond which it counts no more.
LARGEST_ERROR = 9.0
# Where fewer blocks were held out, errors of the rows fitted are judged in their place.
FEWEST_BLOCKS_OF_EXCESS = 3
# A log in which the simulation diverges in a larger share of the rows is not explained by it.
MOST_DIVERGED = 0.1
QUATERNION = ("qw", "qx", "qy", "qz")
# An estimate within this share of its range from a bound is at it.
AT_BOUND = 1e-6


class SimulationDiagnosis(RegressorMixin, BaseEstimator):
    """Find out what a simulation gets wrong about measured data.

    Parameters
    ----------
    simulator : Simulator
        A `MujocoSimulator`, a `FunctionSimulator`, or what `make_simulator` returns.
    effects : "all" or list of str, default="all"
        Names of the effects that may be found, of those in ``simulator.effects(also="all")``; "all" are those in
        ``simulator.effects()``.
    noise : "estimate" or array-like of shape (n_residuals,), default="estimate"
        Standard deviation of the measurement noise of each channel, in the channel's unit; by default estimated.
    alpha : float, default=0.01
        Bound on the chance of any verdict but "nothing detected" where nothing is wrong.
    max_effects : int, default=6
    test_size : float, default=0.3
        Share of the rows, in whole episodes, held out to measure the gain: one step ahead, or with `hidden` channels
        over whole episodes. 0: all rows are fitted and `gain_` is None.
    hidden : sequence of str, default=()
        State channels that were not measured. Their columns in X hold first guesses only; whole episodes are then
        compared in open loop, each from an initial state of its own that is fitted. What no effect explains then
        passes for noise unless it lasts; what it depends on is not tested.
    n_jobs : int or None, default=None
        Processes of joblib that share the simulations of a fit; ``joblib.parallel_config(backend="dask")`` takes them
        to a cluster. None means one, whose own threads take all cores where the simulator is a `MujocoSimulator`. The
        answer does not depend on it. Logs with `hidden` channels use one.
    random_state : int, RandomState or None, default=None
        Which episodes are held out.

    Attributes
    ----------
    verdict_ : {"nothing detected", "named", "ambiguous", "unexplained"}
    causes_ : list of Cause
        Most telling first.
    gain_ : Gain or None
    noise_ : ndarray of shape (n_residuals,)
        Standard deviation of the measurement noise of each channel.
    remainder_ : Remainder or None
        What is left beside the causes.
    refused_ : tuple of (str, float) or None
        Effect, and its value, that explains most of what is left of all those that are significant but were not named,
        since they do not explain it throughout the log, or predict single steps worse.
    excess_p_value_ : float
        Chance of one-step errors so far above the noise if nothing were left.
    diverged_share_ : float
        Share of the rows in which the simulation, as given or with its causes, diverges; they tell nothing.
    extended_simulator_ : Simulator
        The simulation with the causes built in.
    identifiability_ : DataFrame
        For each effect the smallest size that these data show, and its nearest alias.
    report_ : Report
    n_features_in_ : int

    Notes
    -----
    One-step residuals are whitened for noise in the measured states at both ends of a transition; the theory page
    derives the statistics.
    """

    def __init__(
        self,
        simulator,
        *,
        effects="all",
        noise="estimate",
        alpha=0.01,
        max_effects=6,
        test_size=0.3,
        hidden=(),
        n_jobs=None,
        random_state=None,
    ):
        self.simulator = simulator
        self.effects = effects
        self.noise = noise
        self.alpha = alpha
        self.max_effects = max_effects
        self.test_size = test_size
        self.hidden = hidden
        self.n_jobs = n_jobs
        self.random_state = random_state

    def fit(self, X, y, groups=None, *, progress=None):
        """Diagnose the simulation with measured rows.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_inputs)
            In the order of ``simulator.input_names``, or a data frame with these columns: for a simulation with a
            state, state and action.
        y : array-like of shape (n_rows, n_outputs)
            What followed: for a simulation with a state, the next state, which is the state in the next row of X.
        groups : array-like of shape (n_rows,), optional
            Episode of each row; an episode's rows are consecutive and in time order. None: independent rows. For a
            simulation without a state, rows of a group may have something in common and count as one.
        progress : callable, optional
            ``progress(stage, done, total)`` is called as the work goes on.

        Returns
        -------
        SimulationDiagnosis

        Raises
        ------
        ValueError
            If the rows do not fit the simulator, are fewer than 20, hold a value that is not finite, or are not in
            time order; if an effect is unknown.
        RuntimeError
            If the simulation diverges in every row.
        """
        progress = progress or _silent
        self._check_parameters()
        effects = self._chosen_effects()
        random_state = check_random_state(self.random_state)
        hidden = self._checked_hidden()
        if hidden and groups is None:
            raise ValueError("hidden= needs episodes: pass groups=, the episode of each row.")
        log = check_log(self.simulator, X, y, groups, hidden=hidden)
        warn_of_doubts(self.simulator, log, hidden)
        self.n_features_in_ = log.X.shape[1]
        fitted, held_out = log.split(self.test_size, random_state)
        residuals = self._residuals(fitted, effects, self._given_deviations())
        names = [effect.name for effect in effects]
        selected = Selection(
            residuals, names, alpha=self.alpha / 2, max_effects=self.max_effects, progress=progress
        ).run()
        self.causes_ = [self._cause(residuals.effects[name], selected) for name in selected.values]
        progress("remainder", 0, 1)
        # What an effect cannot do within its bounds is left.
        free = [cause.name for cause in self.causes_ if not cause.at_bound]
        self.remainder_ = find_remainder(residuals, selected.linearisation, free)
        self.n_simulated_rows_ = residuals.n_simulated_rows
        refused = selected.refused
        self.refused_ = None if refused is None else (refused.name, float(refused.value))
        n_diverged = residuals.diverged.sum()
        self.noise_ = residuals.deviations
        self.extended_simulator_ = self.simulator.extended(selected.values)
        self.identifiability_ = identifiability(selected, residuals, self.alpha / 2)
        self.gain_ = None
        self._values = dict(selected.values)
        if held_out is not None:
            progress("gain", 0, 1)
            try:
                tested = self._differentiated(held_out)
                if hidden:
                    self.gain_ = self._episode_gain(held_out, "fitted", None, random_state)
                else:
                    self.gain_ = one_step_gain(tested, self._values, random_state)
                n_diverged += tested.diverged.sum()
                if len(np.unique(tested.independent)) >= FEWEST_BLOCKS_OF_EXCESS:
                    residuals = tested
            except RuntimeError as error:
                warnings.warn(f"The gain could not be measured on the rows held out. {error}", stacklevel=2)
        _warn_of_diverged(n_diverged, len(log))
        self.diverged_share_ = float(n_diverged / len(log))
        self.excess_p_value_ = self._excess(residuals, len(fitted))
        self.verdict_ = self._verdict()
        if hidden and isinstance(self.noise, str) and self.verdict_ != "unexplained":
            warn_of_lasting_noise(self.simulator, fitted, hidden, self.noise_)
        self.report_ = Report(self, fitted, held_out)
        progress("done", 1, 1)
        return self

    def evaluate(self, X, y, groups=None, *, horizon=1, initial_state="measured", outputs=None):
        """Measure the gain on another log.

        Parameters
        ----------
        X, y, groups
            As in `fit`.
        horizon : 1 or "episode", default=1
            One-step errors, in noise units; or whole episodes in open loop, root mean squared distance in the
            outputs' units.
        initial_state : {"measured", "fitted"}, default="measured"
            Where open loop starts: from the measured state of an episode's first row, or from the state that explains
            the episode best, for the nominal and the extended model alike.
        outputs : sequence of str, optional
            Channels that make up the distance in open loop; by default all that were measured.

        Returns
        -------
        Gain

        Raises
        ------
        ValueError
            As in `fit`; if a channel or an argument is none of those that it may be.
        RuntimeError
            If the simulation diverges in every row, or in open loop in an episode.
        """
        check_is_fitted(self, "verdict_")
        if horizon not in (1, "episode"):
            raise ValueError(f"horizon must be 1 or 'episode'; it is {horizon!r}.")
        if initial_state not in ("measured", "fitted"):
            raise ValueError(f"initial_state must be 'measured' or 'fitted'; it is {initial_state!r}.")
        hidden = self._checked_hidden()
        if hidden and initial_state == "measured":
            raise ValueError(
                f"{', '.join(hidden)} were not measured, so no episode has a measured initial state: pass "
                "initial_state='fitted'."
            )
        log = check_log(self.simulator, X, y, groups, fewest_rows=1, hidden=hidden)
        random_state = check_random_state(self.random_state)
        if horizon == 1 and not hidden:
            residuals = self._differentiated(log)
            gain = one_step_gain(residuals, self._values, random_state)
            _warn_of_diverged(residuals.diverged.sum(), len(log))
            return gain
        if not log.consecutive:
            raise ValueError(
                "horizon='episode' needs a simulation with a state, and groups=, the episode of each row."
            )
        return self._episode_gain(log, initial_state, outputs, random_state)

    def predict(self, X, groups=None):
        """Return the extended simulation's outputs.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_inputs)
        groups : array-like of shape (n_rows,), optional
            Episode of each row, needed where a delay was found.

        Returns
        -------
        ndarray of shape (n_rows, n_outputs)
        """
        check_is_fitted(self, "verdict_")
        return self.extended_simulator_.predict(X, groups=groups)

    def score(self, X, y, sample_weight=None):
        """Return the coefficient of determination of `predict`.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_inputs)
        y : array-like of shape (n_rows, n_outputs)
            Columns of a data frame are matched by name.
        sample_weight : array-like of shape (n_rows,), optional

        Returns
        -------
        float
        """
        return super().score(X, check_matrix(y, "y", self.simulator.output_names), sample_weight)

    def preflight(self, X, groups=None):
        """Say, before measuring, what transitions like these could show.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_inputs)
            Planned states and actions. Needs no fit.
        groups : array-like of shape (n_rows,), optional

        Returns
        -------
        DataFrame
            As `identifiability_`, with the noise taken as 1 % of each channel's spread unless `noise` gives it, and
            for each effect the further excitation that would separate it from its nearest alias: more rows in which an
            input is large or small; "no single input" where that does not do, and "nothing in these rows" where
            none of those given tells the two apart.
        """
        self._check_parameters()
        if self._checked_hidden():
            raise ValueError(
                "preflight judges transitions from measured states; with hidden channels whole episodes are compared, "
                "and what they show depends on initial states still to be fitted. Call it without hidden=, which is "
                "what the same robot shows with every state measured."
            )
        return preflight(self, X, groups)

    def __repr__(self, N_CHAR_MAX=700):
        """Return the parameters, and after a fit the findings."""
        text = super().__repr__(N_CHAR_MAX)
        return f"{text}\n{self.report_.text()}" if hasattr(self, "report_") else text

    def _repr_html_(self):
        return self.report_.html(figures=False) if hasattr(self, "report_") else super()._repr_html_()

    def _repr_mimebundle_(self, **_):
        """Return what Jupyter shows; scikit-learn would have it show the parameters only."""
        if not hasattr(self, "report_"):
            return super()._repr_mimebundle_()
        return {"text/plain": repr(self), "text/html": self._repr_html_()}

    def __getattr__(self, name):
        if name.endswith("_") and not name.startswith("_") and "verdict_" not in vars(self):
            raise NotFittedError(
                f"this {type(self).__name__} is not fitted yet, so it has no {name}; call fit(X, y, groups=...) first."
            )
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    # -- parts of fit ------------------------------------------------------------------------------------------------

    def _check_parameters(self):
        if not isinstance(self.simulator, Simulator):
            raise TypeError(
                "simulator must be a Simulator, such as MujocoSimulator(path_of_the_model, frame_skip=...) or a "
                f"FunctionSimulator; it is {self.simulator!r}."
            )
        if not 0 < self.alpha < 1:
            raise ValueError(f"alpha must lie between 0 and 1; it is {self.alpha!r}.")
        if not 0 <= self.test_size < 1:
            raise ValueError(f"test_size must be at least 0 and below 1; it is {self.test_size!r}.")
        if not (isinstance(self.max_effects, int | np.integer) and self.max_effects >= 1):
            raise ValueError(f"max_effects must be a whole number of at least 1; it is {self.max_effects!r}.")
        if self.n_jobs is not None and (not isinstance(self.n_jobs, int | np.integer) or self.n_jobs == 0):
            raise ValueError(
                f"n_jobs must be a number of processes, -1 for one per core, or None; it is {self.n_jobs!r} (on the "
                "command line --jobs)."
            )

    def _chosen_effects(self):
        known = {effect.name: effect for effect in self.simulator.effects(also="all")}
        if isinstance(self.effects, str) and self.effects == "all":
            known = {effect.name: effect for effect in self.simulator.effects()}
            return [effect for effect in known.values() if not self._senses_hidden(effect)]
        named = [self.effects] if isinstance(self.effects, str | Effect) else list(self.effects)
        names = [effect.name if isinstance(effect, Effect) else effect for effect in named]
        for name in names:
            if name not in known:
                raise ValueError(unknown_name_message(name, known))
        if not names:
            raise ValueError("effects is empty: name at least one, or pass 'all'.")
        return [known[name] for name in dict.fromkeys(names)]

    def _senses_hidden(self, effect):
        return effect.family in ("bias", "scale") and effect.target in self.hidden

    def _checked_hidden(self):
        hidden = tuple(self.hidden)
        unknown = [name for name in hidden if name not in self.simulator.state_names]
        if unknown:
            raise ValueError(
                f"hidden names {', '.join(unknown)}; state channels are {', '.join(self.simulator.state_names)}."
            )
        if hidden and set(hidden) == set(self.simulator.state_names):
            raise ValueError(
                "hidden names every channel of the state, so that nothing was measured. Name only those that hold no "
                "measurement."
            )
        for joint in {name.rpartition(".")[0] for name in hidden if name.rpartition(".")[2] in QUATERNION}:
            missing = [part for part in QUATERNION if f"{joint}.{part}" not in hidden]
            if missing:
                raise ValueError(
                    f"hidden names a part of the orientation {joint}; name all of its quaternion, also "
                    f"{', '.join(f'{joint}.{part}' for part in missing)}."
                )
        return hidden

    def _given_deviations(self):
        if isinstance(self.noise, str):
            if self.noise != "estimate":
                raise ValueError(
                    f"noise must be 'estimate' or one standard deviation per channel; it is {self.noise!r}."
                )
            return None
        measured = measured_channels(self.simulator, self._checked_hidden())
        names = np.array(self.simulator.residual_names)[measured]
        try:
            deviations = np.asarray(self.noise, dtype=float)
        except (TypeError, ValueError):
            deviations = np.array(np.nan)
        if deviations.shape != (len(names),) or not ((deviations > 0) & (deviations < np.inf)).all():
            raise ValueError(
                f"noise must hold a finite positive standard deviation for each of {', '.join(names)}; it is "
                f"{self.noise!r}."
            )
        return deviations

    def _residuals(self, log, effects, deviations):
        if self.hidden:
            return TrajectoryResiduals(self.simulator, log, effects, deviations, hidden=tuple(self.hidden))
        kind = TransitionResiduals if self.simulator.state_names else Residuals
        return kind(self.simulator, log, effects, deviations, n_jobs=self.n_jobs)

    def _differentiated(self, log):
        residuals = self._residuals(log, self._chosen_effects(), self.noise_)
        residuals.differentiate(self._values)
        return residuals

    def _episode_gain(self, log, initial_state, outputs, random_state):
        return episode_gain(
            self.simulator,
            log,
            self._values,
            self.noise_,
            hidden=self._checked_hidden(),
            initial_state=initial_state,
            outputs=outputs,
            random_state=random_state,
        )

    def _excess(self, residuals, n_fitted):
        """Return the chance of errors so far above the noise, over independent parts of the log, if nothing is left.

        Each row counts with at most `LARGEST_ERROR`: a mean of squares with a long tail tells nothing.
        """
        (errors,) = np.minimum(residuals.noise_errors([self._values]), LARGEST_ERROR)
        blocks = np.unique(residuals.independent[residuals.present], return_inverse=True)[1]
        means = np.bincount(blocks, errors) / np.bincount(blocks)
        spread = means.std(ddof=1) / np.sqrt(len(means)) if len(means) >= FEWEST_BLOCKS_OF_EXCESS else np.inf
        if isinstance(self.noise, str):
            # The noise itself is known from so many residuals only.
            spread = np.hypot(spread, np.sqrt(2 / (n_fitted * residuals.n_channels)))
        return float(stats.t.sf((means.mean() - CLEAN_EXCESS) / max(spread, 1e-12), max(len(means) - 1, 1)))

    def _verdict(self):
        if is_structured(self.remainder_, self.alpha) or self.excess_p_value_ < self.alpha / 4:
            return "unexplained"
        if not self.causes_:
            return "nothing detected" if self.diverged_share_ < MOST_DIVERGED else "unexplained"
        return "ambiguous" if any(cause.aliases for cause in self.causes_) else "named"

    @staticmethod
    def _cause(effect, selected):
        name = effect.name
        value = float(selected.values[name])
        low, high = selected.intervals[name]
        return Cause(
            name=name,
            family=effect.family,
            target=effect.target,
            value=value,
            interval=(float(low), float(high)),
            unit=effect.unit,
            p_value=float(selected.p_values[name]),
            aliases=selected.aliases[name],
            sentence=effect.describe(value),
            at_bound=bool(
                np.min(np.abs(np.subtract(effect.bounds, value))) < AT_BOUND * np.ptp(effect.bounds)
            ),
        )


def _warn_of_diverged(count, n_rows):
    if count:
        warnings.warn(
            f"The simulation as given or with its causes diverges in {count} of {n_rows} rows, which were left out; "
            "check that they are physical.",
            stacklevel=3,
        )


def _silent(stage, done, total):
    """Report no progress."""
