"""A Content filled from a fitted diagnosis."""

from __future__ import annotations

import copy
import warnings
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from skat.diagnosis.comparison import EXTENDED, NOMINAL, ceiling_sentence, compare_transports
from skat.diagnosis.evidence import weigh
from skat.diagnosis.fitting import around
from skat.diagnosis.log import Log
from skat.diagnosis.noise import variances_of
from skat.diagnosis.remainder import PAST
from skat.diagnosis.report.changes import model_changes
from skat.diagnosis.report.content import (
    Alternative,
    ChannelError,
    ChannelNoise,
    Cloud,
    Content,
    Episode,
    ForceNoise,
    Law,
    Left,
    MethodError,
    Series,
    ShownCause,
    ShownLog,
    Spectrum,
    Verdict,
    Visibility,
)
from skat.diagnosis.report.page import Report, without_figures
from skat.diagnosis.report.provenance import provenance
from skat.diagnosis.report.sentences import (
    capital,
    cause_sentence,
    clear_parts,
    counted,
    gain_sentence,
    horizon_text,
    is_law_left,
    left_sentence,
    verdict_sentences,
)
from skat.diagnosis.report.stills import worst_moment

if TYPE_CHECKING:
    from collections.abc import Iterable

    import pandas as pd
    from numpy.typing import ArrayLike

    from skat.diagnosis.findings import Gain
    from skat.diagnosis.prediction import Overlay, Prediction

HEADLINES = {
    "nothing detected": "Nothing detected",
    "named": "{} named",
    "ambiguous": "{} named, but the data allow other names",
    "unexplained": "Unexplained",
}
LONGEST_REPR = 120
# Points of a cloud, and spectra that are drawn.
MOST_POINTS, MOST_SPECTRA = 600, 6
# Odds of e to the power of this, and of more, say the same.
MOST_NATS = 1000
# Other sets of causes that are told, and the least probable of them.
MOST_SETS, LEAST_PROBABILITY = 3, 0.01
# Where a model has no force at all, a remainder's scale is no larger than this.
NO_FORCE = 1e-9


@dataclass(frozen=True)
class TestedLog:
    """Rows that a diagnosis is shown and tested on.

    `log`: NaN where nothing was measured. `prediction`: at the diagnosis's horizon. `open_loop`: over whole episodes.
    `errors`: from `compare_transports`. `note`: why there are none. `is_complete`: whether all of these were sought.
    """

    title: str
    log: Log
    gain: Gain | None = None
    prediction: Prediction | None = None
    open_loop: Gain | None = None
    errors: pd.DataFrame | None = None
    note: str = ""
    is_complete: bool = False

    @property
    def gains(self) -> tuple[Gain, ...]:
        """One at each horizon."""
        predicted = None if self.prediction is None else self.prediction.gain
        known = (self.gain, predicted, self.open_loop)
        found: dict[float | str, Gain] = {}
        for gain in known:
            if gain is not None:
                found.setdefault(gain.horizon, gain)
        return tuple(found.values())


class DiagnosisReport(Report):
    """The findings of a fitted diagnosis, in text and as a page.

    It stays as it is if the diagnosis is fitted again, pickles with it, and measures what only a page shows when
    that is asked for.

    `diagnosis`: fitted. `log`: the rows it was fitted to. `held_out`: the rows that measured its gain.
    """

    def __init__(self, diagnosis: Any, log: Log, held_out: Log | None = None) -> None:
        super().__init__(_findings(diagnosis))
        self.diagnosis, self.log = copy.copy(diagnosis), log
        # The report of an earlier fit, with its logs.
        vars(self.diagnosis).pop("report_", None)
        self._tests: list[TestedLog] = []
        if held_out is not None:
            self._tests.append(TestedLog("Rows held out", held_out, diagnosis.gain_, diagnosis._prediction))

    @classmethod
    def restored(
        cls, diagnosis: Any, log: Log, tests: Iterable[TestedLog], content: Content
    ) -> DiagnosisReport:
        """Return the report that had these logs and this content."""
        report = cls(diagnosis, log)
        report.content, report._tests = content, list(tests)
        return report

    @property
    def tests(self) -> tuple[TestedLog, ...]:
        """Logs that the page shows instead of the rows fitted."""
        return tuple(self._tests)

    def add_test(
        self,
        title: str,
        X: ArrayLike,
        y: ArrayLike,
        groups: ArrayLike | None = None,
        *,
        gain: Gain | None = None,
        errors: pd.DataFrame | None = None,
    ) -> None:
        """Add a log that the diagnosis was not fitted to; the page shows it instead of the rows fitted.

        `title`: what was measured. `X`, `y`, `groups`: as in `SimulationDiagnosis.fit`. `gain`: from
        ``diagnosis.evaluate``; by default it is measured at the diagnosis's horizon. `errors`: from
        `compare_transports`; by default it is computed when the page is made.
        """
        diagnosis = self.diagnosis
        log = diagnosis._other_log(X, y, groups)
        prediction = None
        if gain is None:
            prediction = diagnosis._predicted(log, np.random.RandomState(0))
            gain = prediction.gain
        self._tests.append(
            TestedLog(str(title), log, gain, prediction, errors=None if errors is None else errors.copy())
        )

    def _content(self, figures: bool) -> Content:
        diagnosis = self.diagnosis
        if figures:
            self._tests = [test if test.is_complete else self._completed(test) for test in self._tests]
        tests = self._tests or [TestedLog("Rows fitted", self.log, prediction=diagnosis._prediction)]
        comparisons = [test.errors for test in self._tests if test.errors is not None]
        made = self.content.provenance
        content = replace(
            self.content,
            verdict=replace(self.content.verdict, sentences=tuple(verdict_sentences(diagnosis, comparisons))),
            logs=tuple(_shown_log(diagnosis, test, not self._tests, figures) for test in tests),
            provenance=replace(made, settings=(*_settings(diagnosis, self.log), *made.settings)),
        )
        if not figures:
            return without_figures(content)
        episode = next((log.episodes[0] for log in content.logs if log.episodes), None)
        stills, note = worst_moment(diagnosis.simulator, episode)
        content = replace(content, stills=stills, stills_note=note)
        if not diagnosis.causes_:
            return content
        changes, beside = model_changes(diagnosis.simulator, diagnosis.extended_simulator_)
        return replace(content, changes=changes, beside=beside)

    def _completed(self, test: TestedLog) -> TestedLog:
        """Return a test with what is only measured for a page."""
        diagnosis, fitted, rows = self.diagnosis, _rows(self.log), _rows(test.log)
        prediction, errors, note = test.prediction, test.errors, ""
        if prediction is None:
            try:
                prediction = diagnosis._predicted(test.log, np.random.RandomState(0))
            except RuntimeError:  # it diverges, which the errors say
                prediction = None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # the rows were accepted before
            if errors is None:
                try:
                    errors = compare_transports(
                        diagnosis,
                        *fitted[:2],
                        *rows[:2],
                        groups_fit=fitted[2],
                        groups_test=rows[2],
                        random_state=0,
                    )
                except (ValueError, RuntimeError) as error:  # no row of it can be simulated
                    note = f"No comparison by method: {error}"
            open_loop = self._open_loop_gain(test.log) if diagnosis.causes_ else None
        return replace(
            test, prediction=prediction, errors=errors, note=note, open_loop=open_loop, is_complete=True
        )

    def _open_loop_gain(self, log: Log) -> Gain | None:
        """Return the Gain over whole episodes, or None if there is none."""
        if not log.consecutive or not self.diagnosis.simulator.state_names:
            return None
        first = log.X[log.steps == 0, : len(self.diagnosis.simulator.state_names)]
        diagnosis = copy.copy(self.diagnosis)
        diagnosis.random_state = 0
        try:
            gain: Gain = diagnosis.evaluate(
                *_rows(log),
                horizon="episode",
                initial_state="measured" if np.isfinite(first).all() else "fitted",
            )
        except RuntimeError:  # an episode diverges
            return None
        return gain


# -- findings ------------------------------------------------------------------------------------------------


def _findings(diagnosis: Any) -> Content:
    """Return what does not depend on the logs shown."""
    return Content(
        title="A simulation against measured data",
        verdict=_verdict(diagnosis),
        causes=_causes(diagnosis),
        also_seen=_also_seen(diagnosis),
        left=_left(diagnosis),
        left_sentences=_left_sentences(diagnosis),
        noise=_noise(diagnosis),
        forces=_forces(diagnosis),
        visibility=_visibility(diagnosis),
        provenance=provenance(seed=diagnosis.random_state),
    )


def _verdict(diagnosis: Any) -> Verdict:
    name = diagnosis.verdict_
    headline = HEADLINES[name].format(counted(diagnosis.causes_, "cause"))
    if name == "unexplained":  # probabilities are of sets that explain the log
        return Verdict(name, headline)
    named = {cause.name for cause in diagnosis.causes_}
    probability: float | None = None
    others: list[Alternative] = []
    for one in diagnosis.posterior_.sets:
        if set(one.names) == named:
            probability = one.probability
        elif one.probability >= LEAST_PROBABILITY and len(others) < MOST_SETS:
            others.append(Alternative(one.names or ("no cause",), one.probability))
    return Verdict(name, headline, (), probability, tuple(others))


def _causes(diagnosis: Any) -> tuple[ShownCause, ...]:
    neutral = {effect.name: effect.neutral for effect in diagnosis.simulator.effects(also="all")}
    return tuple(
        ShownCause(
            cause.name,
            cause.unit,
            cause.value,
            cause.interval,
            neutral[cause.name],
            cause_sentence(cause, neutral[cause.name]),
            cause.probability,
            f"{cause.evidence:.0f} nats" if cause.evidence <= MOST_NATS else f"> {MOST_NATS} nats",
            tuple(Alternative((alias.name,), alias.probability) for alias in cause.aliases),
            cause.at_bound,
        )
        for cause in diagnosis.causes_
    )


def _also_seen(diagnosis: Any) -> tuple[ShownCause, ...]:
    """Return the effects beside the causes, with the intervals that they have if the model is taken for exact."""
    found, also = diagnosis._found, diagnosis.also_seen_
    if not also:
        return ()
    places = {name: place for place, name in enumerate(found.priors.names)}
    weighed = weigh(found.gram, found.priors, [places[name] for name in {**found.values, **also}])
    halves = dict(zip(weighed.members, weighed.half_widths))
    shown = []
    for name, value in also.items():
        effect, half = found.effects[places[name]], float(halves[places[name]])
        interval = around(effect, value, half)
        sentence = capital(effect.describe(value))
        shown.append(
            ShownCause(
                name, effect.unit, value, interval, effect.neutral, sentence, found.probabilities[name]
            )
        )
    return tuple(shown)


def _left(diagnosis: Any) -> tuple[Left, ...]:
    simulator, clear = diagnosis.simulator, clear_parts(diagnosis)
    left = []
    for place, part in enumerate(diagnosis.remainder_.parts):
        is_clear = part in clear
        spectrum = None
        if simulator.state_names and part.word != "none":
            is_drawn = bool(simulator.dt) and place < MOST_SPECTRA
            nothing = np.zeros(0)
            spectrum = Spectrum(
                part.frequencies if is_drawn else nothing, part.spectrum if is_drawn else nothing, part.word
            )
        left.append(
            Left(
                part.name,
                part.unit,
                part.rms,
                None,
                part.scale if part.scale > NO_FORCE else None,
                part.share if is_clear else None,
                _law(simulator, part) if is_clear else None,
                spectrum,
                f"{capital(left_sentence(part))}." if is_clear else "",
            )
        )
    return tuple(left)


def _law(simulator: Any, part: Any) -> Law:
    law, units = part.law, {**simulator.units, "time": "s" if simulator.dt else "", PAST: part.unit}
    return Law(
        law.coordinate,
        units.get(law.coordinate, ""),
        (law.edges[:-1] + law.edges[1:]) / 2,
        law.mean,
        law.low,
        law.high,
    )


def _left_sentences(diagnosis: Any) -> tuple[str, ...]:
    if not clear_parts(diagnosis):
        return ("What is left follows no law that this log shows.",)
    if is_law_left(diagnosis):
        return ()
    return (
        f"What is left follows laws, which matter less than the tolerance of {100 * diagnosis.tolerance:g} %.",
    )


def _noise(diagnosis: Any) -> tuple[ChannelNoise, ...]:
    simulator = diagnosis.simulator
    tails, deviations = diagnosis._found.fitted.estimate.noise.error_nu, diagnosis.noise_of_logs_.to_numpy()
    endings = [f" in {name}" for name in diagnosis.noise_of_logs_.index] if len(deviations) > 1 else [""]
    return tuple(
        ChannelNoise(
            f"{name}{ending}", simulator.units.get(name, ""), float(row[channel]), None, float(tail[channel])
        )
        for channel, name in enumerate(simulator.residual_names)
        for ending, row, tail in zip(endings, deviations, tails)
        if np.isfinite(row[channel])
    )


def _forces(diagnosis: Any) -> tuple[ForceNoise, ...]:
    """Return the random forces; one has memory if that makes up most of its variance."""
    simulator, memory = diagnosis.simulator, diagnosis._found.fitted.memory
    if not simulator.state_names:
        return ()
    time = -simulator.dt / np.log(memory.share) if memory and simulator.dt else None
    beside, clear, forces = _beside(diagnosis), clear_parts(diagnosis), []
    for part in diagnosis.remainder_.parts:
        lasts, (other, correlation) = part.past > memory.predicted / 2, beside.get(part.name, ("", 0.0))
        memory_s, returns = (time, memory.returns) if lasts else (0.0, False)
        rms = float(np.sqrt(part.rms**2 - part.predictable**2)) if part in clear else part.rms
        forces.append(ForceNoise(part.name, part.unit, rms, memory_s, returns, other, correlation))
    return tuple(forces)


def _beside(diagnosis: Any) -> dict[str, tuple[str, float]]:
    """Return for each joint the other one whose random force goes most with its own, if any, and their correlation."""
    names = [effect.target or effect.name for effect, _ in diagnosis.simulator.joint_forces()]
    noise, memory = diagnosis._found.fitted.estimate.noise, diagnosis._found.fitted.memory
    if noise.mixing is None or len(names) < 2:
        return {}
    force, k = variances_of(noise.force, noise.force_nu), len(names)
    pushes = force[:, :k] + (memory.variance(force[:, k:]) if len(memory) else 0.0)
    covariance = ((noise.mixing * pushes[:, None]) @ noise.mixing.swapaxes(1, 2)).mean(axis=0)
    sizes = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlations = covariance / np.outer(sizes, sizes)
    np.fill_diagonal(correlations, 0.0)
    most = np.argmax(np.abs(correlations), axis=1)
    return {
        name: (names[other], float(row[other]))
        for name, other, row in zip(names, most, correlations)
        if row[other] != 0
    }


def _visibility(diagnosis: Any) -> tuple[Visibility, ...]:
    named = {cause.name for cause in diagnosis.causes_}
    return tuple(
        Visibility(
            str(name), row["unit"], row["smallest"], row["nearest_alias"], row["similarity"], name in named
        )
        for name, row in diagnosis.identifiability_.iterrows()
    )


def _settings(diagnosis: Any, log: Log) -> tuple[tuple[str, str], ...]:
    simulator = diagnosis.simulator
    episodes = f" in {log.n_episodes} {'episodes' if log.consecutive else 'groups'}"
    if not log.consecutive and log.n_episodes == len(log):
        episodes = ", independent of each other"
    text, most, smoothing = repr(simulator), diagnosis.max_effects, diagnosis.smoothing_
    unmeasured = [name for name, one in zip(simulator.residual_names, diagnosis.noise_) if np.isnan(one)]
    settings = {
        "Simulator": text if len(text) <= LONGEST_REPR else type(simulator).__name__,
        "Rows fitted": f"{len(log)}{episodes}",
        "Inputs": ", ".join(simulator.input_names),
        "Outputs": ", ".join(simulator.output_names),
        "Not measured": ", ".join(one for one in unmeasured if one not in diagnosis.computed_velocities_),
        "Actions": "efforts that were measured" if diagnosis.actions_ == "measured" else "",
        "Computed from positions": ", ".join(diagnosis.computed_velocities_),
        "Smoothed, and made what was read": "" if smoothing is None else smoothing.sentence(simulator),
        "Effects considered": f"{len(diagnosis.identifiability_)}"
        + ("" if most is None else f", at most {most} named"),
        "A cause is named at odds of": f"{1 / diagnosis.alpha:g}",
        "Noise": "estimated from the log" if isinstance(diagnosis.noise, str) else "given",
    }
    return tuple((name, one) for name, one in settings.items() if one)


# -- logs ----------------------------------------------------------------------------------------------------


def _rows(log: Log) -> tuple[Any, Any, Any]:
    """Return X, y and the episodes of a log."""
    return log.X, log.y, log.episodes if log.consecutive or log.n_episodes < len(log) else None


def _shown_log(diagnosis: Any, test: TestedLog, is_fitted: bool, figures: bool) -> ShownLog:
    simulator, gains = diagnosis.simulator, () if is_fitted else test.gains
    overlays = test.prediction.overlays if figures and test.prediction is not None else ()
    episodes: tuple[Episode, ...] = ()
    clouds: tuple[Cloud, ...] = ()
    anew = "each row by itself"
    if test.log.consecutive and test.log.steps.max() > 0:
        episodes = _episodes(diagnosis, test.log, overlays)
        if episodes:
            rows = overlays[0].horizon
            ahead = f"{rows * simulator.dt:.3g} s" if simulator.dt else f"{rows} rows"
            anew = f"simulated anew every {ahead} from what was measured until then"
    elif figures:
        clouds = _clouds(diagnosis, test.log)
    comparison: tuple[MethodError, ...] = ()
    sentences: tuple[str, ...] = (test.note,) if test.note else ()
    if test.errors is not None:
        comparison = _comparison(test.errors)
        sentences = (ceiling_sentence(test.errors), *_notes(test.errors))
    return ShownLog(
        test.title,
        is_fitted,
        horizon_text(simulator, gains[0].horizon) if gains else "",
        anew,
        tuple(f"With the causes built in, {gain_sentence(diagnosis, gain)}" for gain in gains)
        if diagnosis.causes_
        else (),
        episodes,
        clouds,
        _channel_errors(diagnosis, gains[0]) if gains else (),
        comparison,
        sentences,
    )


def _channel_errors(diagnosis: Any, gain: Gain) -> tuple[ChannelError, ...]:
    units, is_named = diagnosis.simulator.units, bool(diagnosis.causes_)
    return tuple(
        ChannelError(name, units.get(name, ""), before, after if is_named else None)
        for name, (before, after) in gain.channels.items()
    )


def _comparison(errors: pd.DataFrame) -> tuple[MethodError, ...]:
    rows = []
    for row in errors.to_dict("records"):
        answered = np.isfinite(row["error"])
        is_ratio = answered and row["method"] != EXTENDED
        interval = (row["ratio_low"], row["ratio_high"])
        rows.append(
            MethodError(
                row["method"],
                row["error"] if answered else None,
                {NOMINAL: "before", EXTENDED: "after"}.get(row["method"], "map"),
                row["ratio"] if is_ratio else None,
                interval if is_ratio and np.isfinite(interval).all() else None,
                int(row["n_rows"]),
            )
        )
    return tuple(rows)


def _notes(errors: pd.DataFrame) -> list[str]:
    """Return the notes of a comparison, each with the methods that it is about."""
    notes: dict[str, list[str]] = {}
    for method, note in zip(errors["method"], errors["note"], strict=True):
        if note:
            notes.setdefault(note, []).append(method)
    return [f"{', '.join(methods)}: {note}" for note, methods in notes.items()]


def _episodes(diagnosis: Any, log: Log, overlays: tuple[Overlay, ...]) -> tuple[Episode, ...]:
    simulator, shown = diagnosis.simulator, []
    for place, overlay in enumerate(overlays):
        word = ", the only one" if log.n_episodes == 1 else ", the worst" if place == 0 else ""
        time, measured, nominal, extended = _with_breaks(overlay)
        shown.append(
            Episode(
                f"Episode {log.label(overlay.episode)}{word}",
                time,
                tuple(
                    Series(
                        overlay.channels[k],
                        simulator.units.get(overlay.channels[k], ""),
                        measured[:, k],
                        nominal[:, k],
                        extended[:, k] if diagnosis.causes_ else None,
                    )
                    for k in _by_error(measured, nominal)
                ),
                "time (s)" if simulator.dt else "step",
            )
        )
    return tuple(shown)


def _with_breaks(overlay: Overlay) -> tuple[Any, ...]:
    """Return time, measured and predictions, which break where they begin anew."""
    parts = overlay.measured, overlay.nominal, overlay.extended
    steps = overlay.horizon if overlay.horizon > 1 else len(overlay.time)
    anew = np.arange(steps, len(overlay.time), steps)
    measured, *predicted = (
        np.insert(part, anew, part[np.subtract(anew, 1).astype(int)], axis=0)
        for part in (np.column_stack([overlay.time, overlay.measured]), *parts[1:])
    )
    for part in predicted:
        part[np.asarray(anew, dtype=int) + np.arange(len(anew))] = np.nan
    return measured[:, 0], measured[:, 1:], *predicted


def _by_error(measured: Any, nominal: Any) -> list[int]:
    """Return the channels that were measured, that with the largest error in units of its spread first."""
    seen = np.isfinite(measured)
    sizes = []
    for k, there in enumerate(seen.T):
        miss = nominal[there, k] - measured[there, k]
        spread = float(np.std(measured[there, k])) if there.any() else 0.0
        sizes.append(float(np.sum(np.nan_to_num(miss / (spread or 1.0)) ** 2)) / max(int(there.sum()), 1))
    return [int(k) for k in np.argsort(-np.array(sizes), kind="stable") if seen[:, k].any()]


def _clouds(diagnosis: Any, log: Log) -> tuple[Cloud, ...]:
    simulator, filled = diagnosis.simulator, log.filled
    picked = np.unique(np.linspace(0, len(log) - 1, min(len(log), MOST_POINTS)).astype(int))
    X, measured, groups = filled.X[picked], log.y[picked], log.groups[picked]
    before, after = (
        each.predict_many(X, [{}], groups=groups)[0] for each in (simulator, diagnosis.extended_simulator_)
    )
    there = np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    outputs, has_state = list(simulator.output_names), bool(simulator.state_names)
    reference = X[:, : len(outputs)] if has_state else np.zeros_like(measured)
    clouds = []
    for k, name in enumerate(outputs):
        seen = there & np.isfinite(measured[:, k])
        if name in simulator.residual_names and seen.any():
            parts = [(part - reference)[seen, k] for part in (measured, before, after)]
            clouds.append(
                Cloud(
                    f"change of {name}" if has_state else name,
                    simulator.units.get(name, ""),
                    parts[0],
                    parts[1],
                    parts[2] if diagnosis.causes_ else None,
                )
            )
    return tuple(clouds)
