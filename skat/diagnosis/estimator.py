"""SimulationDiagnosis: what a user meets."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.exceptions import NotFittedError
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted

from skat.diagnosis.agreement import differing, shared_causes
from skat.diagnosis.causes import QUICK_TURNS, TURNS, find_causes
from skat.diagnosis.chains import Array
from skat.diagnosis.changes import find_changes
from skat.diagnosis.doubts import warn_of_doubts
from skat.diagnosis.evidence import coarsened
from skat.diagnosis.findings import Alias, Cause, Gain
from skat.diagnosis.fitting import Fitted, Known, coordinate, first_fit, hits, nominal_look, value_at
from skat.diagnosis.forces.efforts import causes_of_efforts
from skat.diagnosis.forces.start import start_in_forces
from skat.diagnosis.found import Found, is_held
from skat.diagnosis.identifiability import identifiability, preflight
from skat.diagnosis.log import Log, check_log, check_matrix, without_channels
from skat.diagnosis.noise import variances_of
from skat.diagnosis.posterior import Posterior
from skat.diagnosis.prediction import Prediction, horizon_rows, open_loop_gain, predicted
from skat.diagnosis.reading import read_change, read_logs
from skat.diagnosis.remainder import Remainder, find_remainder, is_unexplained
from skat.diagnosis.report.from_diagnosis import DiagnosisReport
from skat.diagnosis.saving import Begun, Checkpoint, read_diagnosis, write_diagnosis
from skat.diagnosis.smoothing import Smoothing, smoothing_of
from skat.diagnosis.statespace import CHAIN_LENGTH, StateSpace, state_space
from skat.diagnosis.velocities import computed_velocities, motions
from skat.effects import Effect, unknown_name_message
from skat.simulators import Simulator

Progress = Callable[[str, int, int], None]
VELOCITIES = ("auto", "measured", "computed")
ACTIONS = ("auto", "commanded", "measured")
# A log in which the simulation diverges in a larger share of the rows is not explained by it.
MOST_DIVERGED = 0.1
# Readings are multiples of a step if none misses one by more than this share of it.
ROUNDED = 0.01


class SimulationDiagnosis(RegressorMixin, BaseEstimator):
    """Find out what a simulation gets wrong about measured data.

    Parameters
    ----------
    simulator : Simulator
        A `MujocoSimulator`, a `FunctionSimulator`, or what `make_simulator` returns.
    effects : "all" or list of str or Effect, default="all"
        The effects that may be found, of those in ``simulator.effects(also="all")``; "all" are those in
        ``simulator.effects()``. Of one that is given as an `Effect` the odds, the typical size and the bounds hold.
    noise : "estimate" or array-like of shape (n_residuals,), default="estimate"
        Standard deviation of the measurement noise of each channel, in the channel's unit; by default estimated.
    alpha : float, default=0.01
        A cause is named where the odds of the set with it are 1 / alpha times those of the set without it;
        "unexplained" is said where the evidence of a law in what is left is as strong.
    max_effects : int or None, default=None
        Most causes at a time.
    test_size : float, default=0.3
        Share of the rows held out to measure the gain: whole episodes, or pieces of time of a single one. 0: all rows
        are fitted and `gain_` is None.
    hidden : sequence of str, default=()
        State channels that were not measured, as if their columns held NaN.
    velocities : {"auto", "measured", "computed"}, default="auto"
        Whether velocities are measurements of their own. Those that were computed from positions are none and are left
        out; "auto" tells them by what noise of the positions must leave in them.
    actions : {"auto", "commanded", "measured"}, default="auto"
        Whether actions are what motors were told, or efforts that were measured as states are, such as those of a ROS
        ``JointState``: a controller has answered in them to all that brakes a joint, so that they are asked for given
        the motion, by inverse dynamics, and not the motion given them. "auto" goes by what a log says of itself.
    horizon : float, optional
        How far ahead predictions are compared, s. By default a quarter of a second or ten rows, whichever is longer.
    tolerance : float, default=0.1
        Share of the excess error, or of a joint's force, that may be left unexplained.
    priors : mapping from name to float, optional
        Typical sizes of effects, in place of `Effect.typical`: .03 for a mass that the datasheet states to 3 %.
    quick : bool, default=False
        Whether a first look is enough, at two stretches of a log: it takes less time, sees less, has wider
        intervals, and says that it is one.
    n_jobs : int or None, default=None
        Processes of joblib that share the simulations; ``joblib.parallel_config(backend="dask")`` takes them to a
        cluster. None means one, whose own threads take all cores where the simulator is a `MujocoSimulator`.
    random_state : int, RandomState or None, default=None
        What is held out, and the draws by which gain and remainder are measured.

    Attributes
    ----------
    verdict_ : {"nothing detected", "named", "ambiguous", "unexplained"}
    causes_ : list of Cause
        Most telling first.
    also_seen_ : dict of str to float
        Effects that the log shows but that matter less than what no model gets right, and their values.
    gain_ : Gain or None
    noise_ : ndarray of shape (n_residuals,)
        Standard deviation of the measurement noise of each channel; NaN where it was not measured. Of several logs the
        root mean square of theirs.
    noise_of_logs_ : DataFrame
        The same of each log, a row for each.
    agreement_ : DataFrame or None
        Of several logs, what each says of each cause by itself, the other causes shared, and whether they agree; with
        the columns of `compare_findings`.
    remainder_ : Remainder
        What is left beside the causes.
    posterior_ : Posterior
        Sets of causes with their probabilities, and the law of their values.
    actions_ : {"commanded", "measured"}
        What actions were taken for.
    computed_velocities_ : tuple of str
        Velocities that were left out since they were computed from positions.
    smoothing_ : Smoothing or None
        The filter, forward and backward, that was undone in the positions: its `order`, its `cutoff` as a share of the
        Nyquist frequency, its `channels`.
    settled_ : bool
        Whether the search came to rest; where it did not, the verdict is "unexplained".
    n_rows_fitted_, n_rows_ : int
        Rows that were fitted, and those that there were to fit; they differ where `quick` was set.
    diverged_share_ : float
        Share of the rows in which the simulation with its causes diverges; they tell nothing.
    extended_simulator_ : Simulator
        The simulation with the causes built in.
    identifiability_ : DataFrame
        For each effect the smallest size that these data show, and its nearest alias.
    report_ : DiagnosisReport
    n_features_in_ : int

    Notes
    -----
    A log is taken for a state space with heavy-tailed noise in the sensors and random forces on the joints; the theory
    page derives what follows.
    """

    def __init__(
        self,
        simulator: Simulator,
        *,
        effects: Any = "all",
        noise: Any = "estimate",
        alpha: float = 0.01,
        max_effects: int | None = None,
        test_size: float = 0.3,
        hidden: Sequence[str] = (),
        velocities: str = "auto",
        actions: str = "auto",
        horizon: float | None = None,
        tolerance: float = 0.1,
        priors: Mapping[str, float] | None = None,
        quick: bool = False,
        n_jobs: int | None = None,
        random_state: Any = None,
    ):
        self.simulator = simulator
        self.effects = effects
        self.noise = noise
        self.alpha = alpha
        self.max_effects = max_effects
        self.test_size = test_size
        self.hidden = hidden
        self.velocities = velocities
        self.actions = actions
        self.horizon = horizon
        self.tolerance = tolerance
        self.priors = priors
        self.quick = quick
        self.n_jobs = n_jobs
        self.random_state = random_state

    def fit(
        self,
        X: Any,
        y: Any = None,
        groups: ArrayLike | None = None,
        *,
        floor: ArrayLike | None = None,
        progress: Progress | None = None,
        resume: str | PathLike[str] | None = None,
    ) -> "SimulationDiagnosis":
        """Diagnose the simulation with measured rows.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_inputs), log, or list of logs
            In the order of ``simulator.input_names``, or a data frame with these columns: for a simulation with a
            state, state and action. NaN in the state: not measured. Or a log, as `skat.logs.load_log` returns, or
            several of one robot, each such a log or a tuple of (X, y) or (X, y, groups): they share their causes, and
            each has noise of its own; a warning tells if they do not agree. A mapping gives them names.
        y : array-like of shape (n_rows, n_outputs)
            What followed: for a simulation with a state, the next state, which is the state in the next row of X. NaN:
            not measured. None where X is a log, or several.
        groups : array-like of shape (n_rows,), optional
            Episode of each row; an episode's rows are consecutive and in time order. None: independent rows. For a
            simulation without a state, rows of a group may have something in common and count as one.
        floor : array-like of shape (n_states,), optional
            Least variance of each state channel's noise, in the channel's unit squared, such as `skat.logs.Log.floor`
            that resampling has left; that of rounding is found in the values and added.
        progress : callable, optional
            ``progress(stage, done, total)`` is called as the work goes on.
        resume : path, optional
            A file that holds how far the fit has come. It is written behind each relinearisation and removed when the
            fit is done; where it exists, the fit goes on from there and comes to the same answer, rows held out
            included, as without an interruption.

        Returns
        -------
        SimulationDiagnosis

        Raises
        ------
        ValueError
            If the rows do not fit the simulator, are fewer than 4, hold text or an infinite value, or are not in time
            order; if an effect is unknown; if ``velocities="computed"`` and none is known as a velocity, or rows are
            independent; if `floor` holds no variances; if `resume` is a file of another log, simulator, setting or
            version of skat, or damaged.
        RuntimeError
            If the simulation diverges in every row.
        """
        progress = progress or _silent
        self._check_parameters()
        effects = self._chosen_effects()
        random_state = check_random_state(self.random_state)
        given = read_logs(self.simulator, X, y, groups, floor, self.actions)
        self._forget()
        least, self.actions_ = given.least, given.actions
        log = without_channels(self.simulator, given.log, self.hidden)
        warn_of_doubts(self.simulator, log)
        log = self._as_read(self._without_computed(log), effects, least, progress)
        self.n_features_in_ = log.X.shape[1]
        begun = Begun(*log.split(self.test_size, random_state), random_state)
        checkpoint = None if resume is None else Checkpoint(resume, self, log, least)
        begun = begun if checkpoint is None else checkpoint.resumed(begun)
        fitted, held_out, random_state = begun.fitted, begun.held_out, begun.random_state
        self.n_rows_ = len(fitted)
        if self.quick:
            fitted, held_out = fitted.few(), None if held_out is None else held_out.few()
        self.n_rows_fitted_ = len(fitted)
        first_look = self.n_rows_fitted_ < self.n_rows_
        whole = self._space(fitted)
        # Where something hits, what a wrong model makes of a state misleads about the rows after it.
        look = nominal_look(whole)
        self._chain_length = 1 if hits(whole, look) else CHAIN_LENGTH
        space = self._space(fitted, chain_length=1) if self._chain_length == 1 else whole
        least = least + _rounding(whole)
        known = Known(least, self._given_deviations())
        asked: dict[str, Any] = {
            "alpha": self.alpha,
            "typical": self.priors,
            "known": known,
            "max_effects": self.max_effects,
            "progress": progress,
        }
        left: Remainder | None = None
        if self.actions_ == "measured":
            answer = causes_of_efforts(whole, _rows_of(fitted), effects, **asked)
            space, found, left = whole, answer.found, answer.remainder
        else:
            found = find_causes(
                space,
                effects,
                turns=QUICK_TURNS if first_look else TURNS,
                coarse=first_look,
                start=self._start(fitted, effects),
                look=look,
                resumed=begun.search,
                checkpoint=None if checkpoint is None else partial(checkpoint.write, begun),
                **asked,
            )
        if space is not whole:
            # A force is told from noise by the rows beside it.
            found = replace(found, fitted=first_fit(whole, found.values, known, found.fitted.linear))
        self._found = found
        self._values = dict(found.values)
        self.causes_ = _causes(found)
        self.also_seen_ = dict(found.also)
        self.posterior_ = Posterior.of(found)
        self.settled_ = found.settled
        self.diverged_share_ = float(np.mean(~found.fitted.linear.valid))
        self._tell_noise(whole, found, fitted.sources)
        self.agreement_: pd.DataFrame | None = None
        if fitted.sources:
            self.agreement_ = shared_causes(whole, found, fitted.sources)
            if names := differing(self.agreement_):
                warnings.warn(
                    f"The logs do not agree on {', '.join(names)} (agreement_): they are of a robot that changed, or "
                    "of motions in which the model is wrong in different ways. Ask fit_change what changed.",
                    UserWarning,
                    stacklevel=2,
                )
        self.extended_simulator_ = self.simulator.extended(self._values)
        self.identifiability_ = identifiability(
            found.gram,
            found.priors,
            found.effects,
            found.values,
            alpha=self.alpha,
            power=coarsened(len(fitted)),
            value_at=value_at,
        )
        told = ", ".join(f"{cause.name} {cause.value:.4g}" for cause in self.causes_)
        progress(f"what is left beside {told or 'no cause'}", 0, 1)
        self.remainder_ = left or find_remainder(
            whole, found.fitted, known=known, horizon=self._rows_ahead(), random_state=random_state
        )
        self._prediction: Prediction | None = None
        self.gain_ = None
        progress("gain", 0, 1)
        try:
            self._prediction = self._predicted(held_out if held_out is not None else fitted, random_state)
        except RuntimeError as error:
            warnings.warn(f"The gain could not be measured. {error}", stacklevel=2)
        if held_out is not None and self._prediction is not None:
            self.gain_ = self._prediction.gain
        _warn_of_diverged(self.diverged_share_, len(fitted))
        self.verdict_ = self._verdict()
        self.report_ = DiagnosisReport(self, fitted, held_out)
        if checkpoint is not None:
            checkpoint.remove()
        progress("done", 1, 1)
        return self

    def fit_change(self, before: Any, after: Any) -> "SimulationDiagnosis":
        """Say what changed between two logs of one machine, whatever the simulation gets wrong in both.

        Errors that are in both logs are not named, and the simulation needs no calibration. Changes are searched for in
        the forces on joints, in seconds: for machines of hinges and slides that move freely. Of the parameters it goes
        by `effects`, `priors`, `alpha`, `test_size` and `hidden`, and by no other: `noise`, `velocities`, `actions`,
        `max_effects`, `quick` are those of `fit`, and actions are taken for commands.

        Parameters
        ----------
        before, after : log, or tuple of (X, y) or (X, y, groups)
            As `skat.logs.load_log` returns, or as in `fit`; without groups, a single episode.

        Returns
        -------
        SimulationDiagnosis
            With `changes_`, a list of `Cause` whose value is by how much an effect is more in the log after, or, of a
            factor, how many times what it was; `verdict_`, "nothing changed", "named", "ambiguous" or "unexplained",
            where columns of the log after seem to be mixed up, where a motor seems to have died in it, or a joint to be
            stuck, which no change explains, where changes explain too little of parts that were held out, or where logs
            differ by more than any misfit of the simulation makes, and by no effect that was asked about; `reason_`,
            which of these it is; `gain_`, on parts of the log after that were held out; and `common_`: for
            each degree of freedom the rms force that the simulation lacks in both logs, and what is left with all that
            is common in it, N or N m, with servos that exert no more than they may. Where nothing changed `detectable_`
            says of each effect by how much it would have had to change, either way, to be named: in its unit, of
            factors as a share of what it is, infinite where no possible change would have been. What an earlier `fit`
            found is gone.

        Raises
        ------
        ValueError
            If the simulator is no `MujocoSimulator` or has free joints, or contacts push all the time; as in `fit`.
        """
        self._check_parameters()
        effects, logs = self._chosen_effects(), []
        for name, log in zip(("before", "after"), read_change(self.simulator, before, after)):
            log = without_channels(self.simulator, log, self.hidden)
            warn_of_doubts(self.simulator, log, f"the log {name}")
            logs.append((log.X, log.y, log.episodes))
        self._forget()
        found = find_changes(
            self.simulator,
            logs[0],
            logs[1],
            effects,
            typical=self.priors,
            alpha=self.alpha,
            test_size=self.test_size,
        )
        if found.mistake:
            warnings.warn(found.reason, stacklevel=2)
        self.changes_, self.verdict_, self.reason_ = list(found.changes), found.verdict, found.reason
        self.gain_, self.common_, self.detectable_ = found.gain, found.common, dict(found.detectable)
        return self

    def save(self, path: str | PathLike[str], *, force: bool = False) -> Path:
        """Write the fitted diagnosis, with its report and the log, into one file.

        The file is a zip of JSON and arrays, and holds data only: no pickle, nothing that is run as it is loaded. A
        `MujocoSimulator` is in it as text; a simulator that is Python code, such as a `FunctionSimulator`, or has
        effects of your own, is not. Of the fit the laws of the noise are in it, not the path of each row.

        Parameters
        ----------
        path : str or Path
        force : bool, default=False
            Whether to overwrite a file that exists.

        Returns
        -------
        Path

        Raises
        ------
        FileExistsError
            If the file exists and `force` is False, or is a folder.
        FileNotFoundError
            If its folder does not exist.
        TypeError
            If a parameter is of a class that cannot be written.
        """
        self._check_fitted()
        return write_diagnosis(self, path, force=force)

    @classmethod
    def load(cls, path: str | PathLike[str], *, simulator: Simulator | None = None) -> Self:
        """Return a diagnosis that was saved: it answers what it answered then, and can be fitted again.

        Parameters
        ----------
        path : str or Path
        simulator : Simulator, optional
            The one that was diagnosed; needed where the file does not hold it. Its columns, its effects and what it
            predicts for the first rows of the log are compared with those of then.

        Returns
        -------
        SimulationDiagnosis

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If the file is damaged, something else, or in the format of another version of skat; if the simulator is
            another one, or is needed and not given.
        """
        diagnosis: Self = read_diagnosis(cls, path, simulator)
        return diagnosis

    def evaluate(
        self,
        X: Any,
        y: Any,
        groups: ArrayLike | None = None,
        *,
        horizon: float | str | None = None,
        initial_state: str = "measured",
        outputs: Sequence[str] | None = None,
    ) -> Gain:
        """Measure the gain on another log.

        Parameters
        ----------
        X, y, groups
            As in `fit`, of one log.
        horizon : float or "episode", optional
            How far ahead, s (rows for a simulation without time), errors in noise units; by default the diagnosis's
            own. Or whole episodes in open loop, root mean squared distance in the outputs' units.
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
        self._check_fitted()
        if isinstance(horizon, str) and horizon != "episode":
            raise ValueError(f"horizon must be seconds, None or 'episode'; it is {horizon!r}.")
        if initial_state not in ("measured", "fitted"):
            raise ValueError(f"initial_state must be 'measured' or 'fitted'; it is {initial_state!r}.")
        if outputs is not None and (isinstance(outputs, str) or not isinstance(horizon, str)):
            raise ValueError(f"outputs must be a list of names, with horizon='episode'; it is {outputs!r}.")
        if y is None:
            raise ValueError(
                "evaluate takes the rows of one log: pass X, y and groups, such as log.X, log.y, log.groups."
            )
        # In open loop a smoothed path is as near to the motion as one that was read.
        log = self._other_log(X, y, groups, undone=not isinstance(horizon, str))
        random_state = check_random_state(self.random_state)
        if not isinstance(horizon, str):
            prediction = self._predicted(log, random_state, horizon)
            if prediction.n_diverged:
                warnings.warn(
                    f"The simulation, as given or with its causes, diverges in {prediction.n_diverged} of "
                    f"{prediction.n_starts} predictions; there it counts as wholly wrong.",
                    stacklevel=2,
                )
            return prediction.gain
        if not log.consecutive:
            raise ValueError(
                "horizon='episode' needs a simulation with a state, and groups=, the episode of each row."
            )
        return open_loop_gain(
            self._space(log, len(log)),
            self._fitted_for(log),
            self._values,
            initial_state=initial_state,
            outputs=outputs,
            labels=log.labels,
            random_state=random_state,
        )

    def predict(self, X: Any, groups: ArrayLike | None = None) -> Array:
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
        self._check_fitted()
        return self.extended_simulator_.predict(X, groups=groups)

    def score(self, X: Any, y: Any, sample_weight: ArrayLike | None = None) -> float:
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
        return float(super().score(X, check_matrix(y, "y", self.simulator.output_names), sample_weight))

    def preflight(self, X: Any, groups: ArrayLike | None = None) -> pd.DataFrame:
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
        return preflight(
            self.simulator,
            X,
            groups,
            self._chosen_effects(),
            noise=self._given_deviations(),
            hidden=self.hidden,
            alpha=self.alpha,
            typical=self.priors,
        )

    def __repr__(self, N_CHAR_MAX: int = 700) -> str:
        """Return the parameters, and after a fit the findings."""
        text = str(super().__repr__(N_CHAR_MAX))
        if hasattr(self, "changes_"):
            return "\n".join(
                [text, f"Verdict: {self.verdict_}", *(f"  {one.sentence}" for one in self.changes_)]
            )
        return f"{text}\n{self.report_.text()}" if hasattr(self, "report_") else text

    def _repr_html_(self) -> str:
        return str(self.report_.html(figures=False) if hasattr(self, "report_") else super()._repr_html_())

    def _repr_mimebundle_(self, **_: Any) -> dict[str, str]:
        """Return what Jupyter shows; scikit-learn would have it show the parameters only."""
        if hasattr(self, "changes_"):
            return {"text/plain": repr(self)}
        if not hasattr(self, "report_"):
            return dict(super()._repr_mimebundle_())
        return {"text/plain": repr(self), "text/html": self._repr_html_()}

    def __getattr__(self, name: str) -> Any:
        if name.endswith("_") and not name.startswith("_"):
            if "verdict_" not in vars(self):
                raise NotFittedError(
                    f"this {type(self).__name__} is not fitted yet, so it has no {name}; call fit(X, y, groups=...) "
                    "first."
                )
            if "changes_" in vars(self):
                raise NotFittedError(
                    f"fit_change was asked what changed, so there is no {name}; call fit(X, y, groups=...) first."
                )
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def _forget(self) -> None:
        """Leave nothing of what was asked before: `fit` and `fit_change` answer other questions."""
        kept = {*self.get_params(deep=False), "_metadata_request"}
        for name in set(vars(self)) - kept:
            delattr(self, name)

    def _check_fitted(self) -> None:
        """Raise where `fit` was not the last that was asked."""
        if "causes_" not in vars(self):
            check_is_fitted(self, "verdict_")
            self.__getattr__("causes_")

    # -- parts of fit ------------------------------------------------------------------------------------------------

    def _check_parameters(self) -> None:
        if not isinstance(self.simulator, Simulator):
            raise TypeError(
                "simulator must be a Simulator, such as MujocoSimulator(path_of_the_model, frame_skip=...) or a "
                f"FunctionSimulator; it is {self.simulator!r}."
            )
        if not 0 < self.alpha < 1:
            raise ValueError(f"alpha must lie between 0 and 1; it is {self.alpha!r}.")
        if not 0 <= self.test_size < 1:
            raise ValueError(f"test_size must be at least 0 and below 1; it is {self.test_size!r}.")
        most = self.max_effects
        if most is not None and not (isinstance(most, int | np.integer) and most >= 1):
            raise ValueError(f"max_effects must be None or a whole number of at least 1; it is {most!r}.")
        if self.velocities not in VELOCITIES:
            raise ValueError(f"velocities must be one of {', '.join(VELOCITIES)}; it is {self.velocities!r}.")
        if self.actions not in ACTIONS:
            raise ValueError(f"actions must be one of {', '.join(ACTIONS)}; it is {self.actions!r}.")
        if isinstance(self.hidden, str):
            raise ValueError(f"hidden must be a list of names; it is {self.hidden!r}.")
        if not self.tolerance > 0:
            raise ValueError(f"tolerance must be positive; it is {self.tolerance!r}.")
        if self.horizon is not None:
            horizon_rows(self.simulator, self.horizon)
        if self.n_jobs is not None and (not isinstance(self.n_jobs, int | np.integer) or self.n_jobs == 0):
            raise ValueError(
                f"n_jobs must be a number of processes, -1 for one per core, or None; it is {self.n_jobs!r} (on the "
                "command line --jobs)."
            )
        for name, size in (self.priors or {}).items():
            if name not in {effect.name for effect in self.simulator.effects(also="all")}:
                raise ValueError(
                    unknown_name_message(name, {one.name: one for one in self.simulator.effects(also="all")})
                )
            if not (size > 0 and 0 < size * size < np.inf):
                raise ValueError(
                    f"the typical size of {name} must be positive, in its unit, and a number whose square is one; it "
                    f"is {size!r}."
                )

    def _chosen_effects(self) -> list[Effect]:
        known = {effect.name: effect for effect in self.simulator.effects(also="all")}
        if isinstance(self.effects, str) and self.effects == "all":
            return list(self.simulator.effects())
        given = [self.effects] if isinstance(self.effects, str | Effect) else list(self.effects)
        chosen = {}
        for one in given:
            name = one.name if isinstance(one, Effect) else one
            if name not in known:
                raise ValueError(unknown_name_message(name, known))
            chosen[name] = _checked_effect(one, known[name]) if isinstance(one, Effect) else known[name]
        if not chosen:
            raise ValueError("effects is empty: name at least one, or pass 'all'.")
        return list(chosen.values())

    def _without_computed(self, log: Log) -> Log:
        names = self.simulator.state_names
        rates = [name for name in names if name.startswith("qvel.")]
        rates = rates or [rate for _, rate in motions(self.simulator)]
        self.computed_velocities_: tuple[str, ...] = ()
        if self.velocities == "computed" and not rates:
            raise ValueError(
                f"velocities='computed' finds no velocity among {', '.join(names) or 'no state'}: it knows them by "
                "MuJoCo's names (qvel.), or by their unit, where one channel has that of another per second (units= of "
                "a FunctionSimulator). Name those that were computed in hidden=."
            )
        if self.velocities == "computed" and not log.consecutive:
            raise ValueError(
                "velocities='computed' leaves velocities to be told by positions in time order: pass groups=, the "
                "episode of each row."
            )
        if self.velocities == "measured" or not rates or not log.consecutive:
            return log
        if self.velocities == "computed":
            self.computed_velocities_ = tuple(rates)
        else:
            self.computed_velocities_ = computed_velocities(self.simulator, log.X, log.y, log.episodes)
            if self.computed_velocities_:
                warnings.warn(
                    f"{', '.join(self.computed_velocities_)} were computed from the positions beside them: noise of "
                    "the positions that no independent sensor knows of is in them. They are left out, as they measure "
                    "nothing; pass velocities='measured' if that is wrong.",
                    UserWarning,
                    stacklevel=3,
                )
        return without_channels(self.simulator, log, self.computed_velocities_)

    def _as_read(self, log: Log, effects: Sequence[Effect], least: Array, progress: Progress) -> Log:
        """Return the log with positions as they were read, if they were smoothed and alone tell of the velocities."""
        self.smoothing_: Smoothing | None = None
        known = Known(least)

        def likelihood(log: Log, *, values: Mapping[str, float]) -> float:
            try:
                return first_fit(self._space(log), values, known).bound
            except (RuntimeError, np.linalg.LinAlgError):
                # With a cutoff that is far too low nothing but noise is left.
                return -np.inf

        def causes(one: Log) -> Mapping[str, float]:
            rough = partial(find_causes, turns=QUICK_TURNS, coarse=True, max_effects=self.max_effects)
            return rough(self._space(one), effects, alpha=self.alpha, typical=self.priors, known=known).values

        if self._given_deviations() is None:
            self.smoothing_ = smoothing_of(self.simulator, log, likelihood, causes, progress)
        if self.smoothing_ is None:
            return log
        warnings.warn(
            f"{self.smoothing_.sentence(self.simulator)} is undone in what follows. Every second row counts, but where "
            "an episode begins or ends none does, and intervals take the cutoff for known.",
            UserWarning,
            stacklevel=3,
        )
        return self.smoothing_.undone(self.simulator, log)

    def _other_log(self, X: Any, y: Any, groups: ArrayLike | None, *, undone: bool = True) -> Log:
        """Return another log with what was measured of it as in the one that was fitted."""
        log = check_log(self.simulator, X, y, groups, fewest_rows=1)
        log = without_channels(self.simulator, log, (*self.hidden, *self.computed_velocities_))
        if undone and self.smoothing_ is not None:
            log = self.smoothing_.undone(self.simulator, log)
            if not log.measured.any():
                reach = self.smoothing_.reach
                raise ValueError(
                    f"nothing is left where the filter of the fitted log is undone: {reach} instants are lost at both "
                    f"ends of an episode. Give episodes of more than {2 * reach} rows, in time order, with groups=."
                )
        return log

    def _given_deviations(self) -> Array | None:
        if isinstance(self.noise, str):
            if self.noise != "estimate":
                raise ValueError(
                    f"noise must be 'estimate' or one standard deviation per channel; it is {self.noise!r}."
                )
            return None
        names = self.simulator.residual_names
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

    def _tell_noise(self, space: StateSpace, found: Found, names: Sequence[str]) -> None:
        """Set the standard deviation of each channel's noise, of each log and of all."""
        noise, given = found.fitted.estimate.noise, self._given_deviations()
        variances = variances_of(noise.error, noise.error_nu)[:, : space.d]
        if given is not None:
            variances = np.tile(given**2, (len(variances), 1))
        read = np.stack([space.mask[space.origin == log].any(axis=(0, 1)) for log in range(len(variances))])
        logs = np.where(read, np.sqrt(variances), np.nan)
        self.noise_of_logs_ = pd.DataFrame(
            logs, index=pd.Index(names or ["log"], name="log"), columns=list(self.simulator.residual_names)
        )
        counts = read.sum(axis=0)
        means = np.sum(variances, axis=0, where=read) / np.maximum(counts, 1)
        self.noise_ = np.where(counts > 0, np.sqrt(means), np.nan)

    def _space(self, log: Log, chain_length: int = CHAIN_LENGTH) -> StateSpace:
        return state_space(
            self.simulator,
            log.X,
            log.y,
            log.episodes,
            consecutive=log.consecutive,
            chain_length=chain_length,
            origins=log.source,
            n_jobs=self.n_jobs,
        )

    def _start(self, log: Log, effects: Sequence[Effect]) -> dict[str, float]:
        if not log.consecutive:
            return {}
        needed = -float(np.log(self.alpha))
        return start_in_forces(self.simulator, _rows_of(log), effects, typical=self.priors, needed=needed)

    def _rows_ahead(self, horizon: float | None = None) -> int:
        return horizon_rows(self.simulator, self.horizon if horizon is None else horizon)

    def _predicted(
        self, log: Log, random_state: np.random.RandomState, horizon: float | None = None
    ) -> Prediction:
        rows = self._rows_ahead(horizon) if log.consecutive else 1
        return predicted(
            self._space(log, self._chain_length),
            self._fitted_for(log),
            self._values,
            horizon=rows,
            random_state=random_state,
        )

    def _fitted_for(self, log: Log) -> Fitted:
        """Return the fit; for a log that is none of several that were fitted, with a noise like theirs."""
        fitted = self._found.fitted
        if log.source is not None:
            return fitted
        return replace(fitted, estimate=replace(fitted.estimate, noise=fitted.estimate.noise.pooled()))

    def _apart(self) -> list[str]:
        """Return on what several logs do not agree by more than the tolerance's share of what is wrong with it."""
        if self.agreement_ is None:
            return []
        effects, rows = {one.name: one for one in self._found.effects}, self.agreement_.set_index("cause")
        found = []
        for name in differing(self.agreement_):
            values = rows.loc[name, [one for one in rows.columns if one.startswith("value in ")]].dropna()
            places = [coordinate(effects[name], value) for value in values]
            wrong = coordinate(effects[name], self._values.get(name, effects[name].neutral))
            if max(places) - min(places) > self.tolerance * abs(wrong):
                found.append(name)
        return found

    def _verdict(self) -> str:
        gain = None if self._prediction is None else self._prediction.gain
        if (
            not self.settled_
            or is_unexplained(self.remainder_, gain, tolerance=self.tolerance, alpha=self.alpha)
            or self._apart()
        ):
            return "unexplained"
        if not self.causes_:
            return "nothing detected" if self.diverged_share_ < MOST_DIVERGED else "unexplained"
        return "ambiguous" if any(cause.aliases for cause in self.causes_) else "named"


def _checked_effect(given: Effect, known: Effect) -> Effect:
    """Return an effect that was given in the place of the simulator's, if it is of the same quantity."""
    (low, high), (least, most) = given.bounds, known.bounds
    if (given.unit, given.neutral) != (known.unit, known.neutral) or low < least or high > most:
        raise ValueError(
            f"{given.name} must be in {known.unit}, neutral at {known.neutral:g}, with bounds within {known.bounds}; "
            f"it is in {given.unit}, neutral at {given.neutral:g}, with bounds {given.bounds}."
        )
    return given


def _rows_of(log: Log) -> tuple[Array, Array, NDArray[np.intp]]:
    return log.X, log.y, log.episodes


def _causes(found: Found) -> list[Cause]:
    """Return the causes, most telling first."""
    known = {effect.name: effect for effect in found.effects}
    causes = []
    for name, value in found.values.items():
        effect = known[name]
        low, high = found.intervals[name]
        causes.append(
            Cause(
                name=name,
                family=effect.family,
                target=effect.target,
                value=value,
                interval=(float(low), float(high)),
                unit=effect.unit,
                probability=found.probabilities[name],
                evidence=found.worth[name],
                aliases=tuple(Alias(*alias) for alias in found.aliases[name]),
                sentence=effect.describe(value),
                at_bound=is_held(effect, value),
            )
        )
    return sorted(causes, key=lambda cause: -cause.evidence)


def _rounding(space: StateSpace) -> Array:
    """Return the variance of rounding of each channel: a twelfth of the square of its smallest step."""
    names = space.simulator.output_names
    floor = np.zeros(space.d)
    for channel, name in enumerate(space.simulator.residual_names):
        if name not in names:
            continue
        read = np.unique(space.measured[..., names.index(name)][space.mask[..., channel]])
        if len(read) > 2:
            steps = np.diff(read)
            step = float(steps.min())
            whole = np.abs(steps / step - np.round(steps / step))
            if step > 1e-9 * float(np.ptp(read)) and float(whole.max()) < ROUNDED:
                floor[channel] = step**2 / 12
    return floor


def _warn_of_diverged(share: float, n_rows: int) -> None:
    if share:
        warnings.warn(
            f"The simulation with its causes diverges in {round(share * n_rows)} of {n_rows} rows, which were left "
            "out; check that they are physical.",
            stacklevel=3,
        )


def _silent(stage: str, done: int, total: int) -> None:
    """Report no progress."""
