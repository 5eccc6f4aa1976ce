"""A Content filled from the first engine's findings: it goes with that engine, and only the estimator imports it."""

from __future__ import annotations

import copy
import warnings
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from skat.diagnosis.comparison import EXTENDED, NOMINAL, ceiling_sentence, compare_transports
from skat.diagnosis.findings import Gain
from skat.diagnosis.log import Log, check_log, measured_channels
from skat.diagnosis.omnibus import is_structured
from skat.diagnosis.open_loop import Episodes
from skat.diagnosis.report.changes import model_changes
from skat.diagnosis.report.content import (
    Alternative,
    Change,
    ChannelError,
    ChannelNoise,
    Cloud,
    Content,
    Episode,
    Law,
    Left,
    MethodError,
    Provenance,
    Series,
    ShownCause,
    ShownLog,
    Still,
    Table,
    Verdict,
    Visibility,
)
from skat.diagnosis.report.page import Report, checked_table
from skat.diagnosis.report.provenance import provenance
from skat.diagnosis.report.sentences import (
    capital,
    cause_sentence,
    cautions,
    counted,
    gain_sentence,
    remainder_sentence,
    verdict_sentences,
)
from skat.diagnosis.report.stills import worst_moment

HEADLINES = {
    "nothing detected": "Nothing detected",
    "named": "{} named",
    "ambiguous": "{} named, but the data allow other names",
    "unexplained": "Unexplained",
}
LONGEST_REPR = 120
# Episodes and steps looked at to choose those that are drawn, and points of a cloud.
MOST_CANDIDATES, MOST_STEPS, MOST_POINTS = 12, 400, 600
MOST_ROWS = 5_000
N_BINS = 12
MOST_LAWS = 3
# Standard deviations of a chi-square beyond which an error's dependence on an input is worth a picture.
CLEAR_DEPENDENCE = 5.0


@dataclass(frozen=True)
class TestedLog:
    """Rows that a diagnosis is shown and tested on.

    Attributes
    ----------
    title : str
    log : Log
    gain : Gain or None
    open_loop : Gain or None
        Over whole episodes, where `gain` is one step ahead.
    errors : DataFrame or None
        From `compare_transports`.
    note : str
        Why there are none.
    is_compared : bool
        Whether `errors` and `open_loop` were sought.
    """

    title: str
    log: Log
    gain: Gain | None = None
    open_loop: Gain | None = None
    errors: pd.DataFrame | None = None
    note: str = ""
    is_compared: bool = False


class FirstReport(Report):
    """The findings of a fitted diagnosis, in text and as a page.

    It stays as it is if the diagnosis is fitted again, pickles with it, and simulates what it draws when that is
    asked for.

    Parameters
    ----------
    diagnosis : SimulationDiagnosis
        Fitted.
    log : Log
        The rows it was fitted to.
    held_out : Log, optional
        The rows that measured its gain.
    """

    def __init__(self, diagnosis, log, held_out=None):
        self.diagnosis, self.log = copy.copy(diagnosis), log
        # The report of an earlier fit, with its logs.
        vars(self.diagnosis).pop("report_", None)
        self._tables: list[Table] = []
        self._tests = [] if held_out is None else [TestedLog("Rows held out", held_out, diagnosis.gain_)]
        self._title = "A simulation against measured data"
        self._provenance = provenance(seed=diagnosis.random_state)

    def text(self):
        """Return the findings as a few lines of text."""
        diagnosis = self.diagnosis
        lines = [f"Verdict: {diagnosis.verdict_}"]
        neutral = _neutral(diagnosis)
        for cause in diagnosis.causes_:
            lines.append(f"  {cause_sentence(cause, neutral[cause.name])}")
            if cause.aliases:
                lines.append(f"    cannot be told from: {', '.join(cause.aliases)}")
        lines += [f"  {sentence}" for sentence in cautions(diagnosis.causes_)]
        if diagnosis.verdict_ == "unexplained":
            lines.append(f"  {capital(remainder_sentence(diagnosis))}.")
        if diagnosis.causes_:
            lines += [
                f"  {test.title}: {gain_sentence(diagnosis, test.gain)}" for test in self._tests if test.gain
            ]
        return "\n".join(lines)

    def add_table(self, title, frame):
        """Add a table to the page.

        Parameters
        ----------
        title : str
        frame : DataFrame
            An index with a name is shown as the first column.
        """
        self._tables.append(checked_table(title, frame))

    def describe(self, *, title: str | None = None, made: Provenance | None = None) -> None:
        """Say what the findings are of and how they were made.

        Parameters
        ----------
        title : str, optional
        made : Provenance, optional
            Its settings are added to the diagnosis's own.
        """
        self._title = self._title if title is None else title
        self._provenance = self._provenance if made is None else made

    def add_test(self, title, X, y, groups=None, *, gain=None, errors=None):
        """Add a log that the diagnosis was not fitted to; the page shows it instead of the rows fitted.

        Parameters
        ----------
        title : str
            What was measured.
        X, y, groups
            As in `SimulationDiagnosis.fit`.
        gain : Gain, optional
            From ``diagnosis.evaluate``; by default it is measured one step ahead.
        errors : DataFrame, optional
            From `compare_transports`; by default it is computed when the page is made.
        """
        diagnosis = self.diagnosis
        log = check_log(diagnosis.simulator, X, y, groups, fewest_rows=1, hidden=tuple(diagnosis.hidden))
        if gain is None:
            gain = diagnosis.evaluate(X, y, groups, initial_state=_initial_state(diagnosis))
        self._tests.append(TestedLog(str(title), log, gain, errors=None if errors is None else errors.copy()))

    # -- content ------------------------------------------------------------------------------------------

    def _content(self, figures):
        diagnosis = self.diagnosis
        if figures:
            self._compare()
        shown = self._tests or [TestedLog("Rows fitted", self.log)]
        changes: tuple[Change, ...] = ()
        beside: tuple[str, ...] = ()
        stills: tuple[Still, ...] = ()
        left: tuple[Left, ...] = ()
        stills_note = ""
        if figures:
            if diagnosis.causes_:
                changes, beside = model_changes(diagnosis.simulator, diagnosis.extended_simulator_)
            left = _laws(diagnosis, shown[0].log)
        logs = tuple(_shown_log(diagnosis, test, not self._tests, figures) for test in shown)
        if figures:
            episode = next((log.episodes[0] for log in logs if log.episodes), None)
            stills, stills_note = worst_moment(diagnosis.simulator, episode)
        return Content(
            title=self._title,
            verdict=Verdict(
                diagnosis.verdict_,
                HEADLINES[diagnosis.verdict_].format(counted(diagnosis.causes_, "cause")),
                tuple(
                    verdict_sentences(
                        diagnosis, [test.errors for test in self._tests if test.errors is not None]
                    )
                ),
            ),
            causes=_causes(diagnosis),
            logs=logs,
            left=left,
            left_sentences=_left_sentences(diagnosis),
            noise=_noise(diagnosis),
            visibility=_visibility(diagnosis),
            changes=changes,
            beside=beside,
            stills=stills,
            stills_note=stills_note,
            tables=tuple(self._tables),
            provenance=replace(
                self._provenance, settings=(*_settings(diagnosis, self.log), *self._provenance.settings)
            ),
        )

    def _compare(self):
        """Measure each test in open loop, and transports on it, once."""
        fitted = _rows(self.log)
        for index, test in enumerate(self._tests):
            if test.is_compared:
                continue
            rows, errors, note = _rows(test.log), test.errors, ""
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # the rows were accepted before
                if errors is None:
                    try:
                        errors = compare_transports(
                            self.diagnosis,
                            *fitted[:2],
                            *rows[:2],
                            groups_fit=fitted[2],
                            groups_test=rows[2],
                            random_state=0,
                        )
                    except (ValueError, RuntimeError) as error:  # no row of it can be simulated
                        note = f"No comparison by method: {error}"
                open_loop = self._open_loop_gain(test, rows)
            self._tests[index] = replace(
                test, errors=errors, open_loop=open_loop, note=note, is_compared=True
            )

    def _open_loop_gain(self, test, rows):
        """Return the Gain over whole episodes, or None if it is known or there is none."""
        known = test.gain is not None and test.gain.horizon == "episode"
        if known or not test.log.consecutive or not self.diagnosis.causes_:
            return None
        diagnosis = copy.copy(self.diagnosis)
        diagnosis.random_state = 0
        try:
            return diagnosis.evaluate(*rows, horizon="episode", initial_state=_initial_state(diagnosis))
        except RuntimeError:  # an episode diverges, which the picture shows
            return None


# -- findings ------------------------------------------------------------------------------------------------


def _neutral(diagnosis):
    return {effect.name: effect.neutral for effect in diagnosis.simulator.effects(also="all")}


def _causes(diagnosis):
    neutral = _neutral(diagnosis)
    return tuple(
        ShownCause(
            cause.name,
            cause.unit,
            cause.value,
            cause.interval,
            neutral[cause.name],
            cause_sentence(cause, neutral[cause.name]),
            evidence=f"p {_p_value(cause.p_value)}",
            aliases=tuple(Alternative((name,)) for name in cause.aliases),
            at_bound=cause.at_bound,
        )
        for cause in diagnosis.causes_
    )


def _shown_log(diagnosis, test, is_fitted, figures):
    gains = [gain for gain in (test.gain, test.open_loop) if gain and diagnosis.causes_]
    episodes: tuple[Episode, ...] = ()
    clouds: tuple[Cloud, ...] = ()
    if figures:
        if test.log.consecutive and test.log.steps.max() > 0:
            episodes = _episodes(diagnosis, test.log)
        elif not tuple(diagnosis.hidden):
            clouds = _clouds(diagnosis, test.log)
    start = "the initial state that fits each best" if tuple(diagnosis.hidden) else "the first measured state"
    horizon = ""
    if test.gain is not None:
        horizon = "one step ahead" if test.gain.horizon == 1 else "whole episodes"
    comparison, sentences = (), (test.note,) if test.note else ()
    if test.errors is not None:
        comparison = _comparison(test.errors)
        sentences = (ceiling_sentence(test.errors), *_notes(test.errors))
    return ShownLog(
        test.title,
        is_fitted,
        horizon,
        f"whole episodes, simulated from {start}" if episodes else "each row by itself",
        tuple(f"With the causes built in, {gain_sentence(diagnosis, gain)}" for gain in gains),
        episodes,
        clouds,
        _channel_errors(diagnosis, test.gain),
        comparison,
        sentences,
    )


def _channel_errors(diagnosis, gain):
    if gain is None:
        return ()
    units = diagnosis.simulator.units
    is_named = bool(diagnosis.causes_)
    return tuple(
        ChannelError(name, units.get(name, ""), before, after if is_named else None)
        for name, (before, after) in gain.channels.items()
    )


def _comparison(errors):
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


def _notes(errors):
    """Return the notes of a comparison, each with the methods that it is about."""
    notes: dict[str, list[str]] = {}
    for method, note in zip(errors["method"], errors["note"], strict=True):
        if note:
            notes.setdefault(note, []).append(method)
    return [f"{', '.join(methods)}: {note}" for note, methods in notes.items()]


def _left_sentences(diagnosis):
    remainder = diagnosis.remainder_
    if diagnosis.verdict_ != "unexplained" or not is_structured(remainder, diagnosis.alpha):
        return ()
    return (
        f"{capital(remainder_sentence(diagnosis))}.",
        *(
            f"What is left acts on {direction} as a function of {coordinate}: p {_p_value(p)}."
            for direction, coordinate, p in remainder.table[:3]
        ),
    )


def _noise(diagnosis):
    simulator = diagnosis.simulator
    names = np.array(simulator.residual_names)[measured_channels(simulator, tuple(diagnosis.hidden))]
    deviations = np.asarray(diagnosis.noise_, dtype=float)
    return tuple(
        ChannelNoise(str(name), simulator.units.get(name, ""), float(one))
        for name, one in zip(names, deviations, strict=True)
    )


def _visibility(diagnosis):
    named = {cause.name for cause in diagnosis.causes_}
    return tuple(
        Visibility(
            str(name), row["unit"], row["smallest"], row["nearest_alias"], row["similarity"], name in named
        )
        for name, row in diagnosis.identifiability_.iterrows()
    )


def _settings(diagnosis, log):
    simulator = diagnosis.simulator
    episodes = f" in {log.n_episodes} {'episodes' if log.consecutive else 'groups'}"
    if not log.consecutive and log.n_episodes == len(log):
        episodes = ", independent of each other"
    text = repr(simulator)
    settings = {
        "Simulator": text if len(text) <= LONGEST_REPR else type(simulator).__name__,
        "Rows fitted": f"{len(log)}{episodes}",
        "Inputs": ", ".join(simulator.input_names),
        "Outputs": ", ".join(simulator.output_names),
        "Not measured": ", ".join(diagnosis.hidden),
        "Effects considered": f"{len(diagnosis.identifiability_)}, at most {diagnosis.max_effects} named",
        "Chance of a false alarm": f"at most {diagnosis.alpha:g}",
        "Noise": "estimated from the log" if isinstance(diagnosis.noise, str) else "given",
    }
    return tuple((name, one) for name, one in settings.items() if one)


def _p_value(value):
    return "< 0.0001" if value < 1e-4 else f"= {value:.2g}"


def _initial_state(diagnosis):
    return "fitted" if tuple(diagnosis.hidden) else "measured"


def _rows(log):
    """Return X, y and the episodes of a log."""
    return log.X, log.y, log.episodes if log.consecutive or log.n_episodes < len(log) else None


# -- whole episodes ------------------------------------------------------------------------------------------


def _episodes(diagnosis, log):
    """Return the worst and a typical Episode, simulated from their first state on."""
    short = log.rows((log.episodes < MOST_CANDIDATES) & (log.steps < MOST_STEPS))
    simulator, hidden = diagnosis.simulator, tuple(diagnosis.hidden)
    paths = []
    for each in (simulator, diagnosis.extended_simulator_):
        episodes = Episodes(each, short, hidden)
        try:
            initial = episodes.fit_initial_states({}, diagnosis.noise_) if hidden else episodes.initial
        except RuntimeError:  # no initial state can be fitted to an episode that diverges
            return ()
        paths.append(each.rollout_many(initial, episodes.inputs, [{}], n_steps=episodes.n_steps)[0])
    names = list(simulator.output_names)
    there = [k for k, name in enumerate(names) if name in simulator.residual_names and name not in hidden]
    if not there:
        return ()
    measured = np.full_like(paths[0], np.nan)
    measured[:, 0] = short.X[short.steps == 0][:, : len(names)]
    measured[short.episodes, short.steps + 1] = short.y
    spread = np.nanstd(measured.reshape(-1, len(names)), axis=0)
    errors = np.abs(measured - paths[0]) / np.where(spread > 0, spread, 1.0)
    errors = np.where(np.isnan(paths[0]) & ~np.isnan(measured), 1.0, np.nan_to_num(errors))[:, :, there]
    channels = [there[k] for k in np.argsort(-np.mean(errors**2, axis=(0, 1)))]
    lengths = np.sum(~np.isnan(measured[..., there[0]]), axis=1)
    worst, *typical = worst_and_typical(np.sum(errors**2, axis=(1, 2)), lengths)
    labels = {worst: "the worst"} | dict.fromkeys(typical, "a typical one")
    if len(lengths) == 1:
        labels = {worst: "the only one"}
    shown = []
    for episode, word in labels.items():
        n_times = int(lengths[episode])
        time, label = _time(simulator, np.arange(n_times))
        parts = [part[episode, :n_times] for part in (measured, *paths)]
        shown.append(
            Episode(
                f"Episode {short.label(episode)}, {word}",
                time,
                tuple(
                    Series(
                        names[k],
                        simulator.units.get(names[k], ""),
                        parts[0][:, k],
                        parts[1][:, k],
                        parts[2][:, k] if diagnosis.causes_ else None,
                    )
                    for k in channels
                ),
                label,
            )
        )
    return tuple(shown)


def worst_and_typical(errors, lengths):
    """Return the episodes of the largest and of the median error per row, given each one's sum and number of rows."""
    order = np.argsort(errors / lengths)
    return list(dict.fromkeys([int(order[-1]), int(order[len(order) // 2])]))


def _time(simulator, steps):
    if simulator.dt is None:
        return steps.astype(float), "step"
    return simulator.dt * steps, "time (s)"


# -- one step ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _OneStep:
    """One-step predictions of the first rows of a log, without rows in which a simulation diverges."""

    inputs: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    residuals: tuple[np.ndarray, np.ndarray]


def _one_step(diagnosis, log):
    simulator = diagnosis.simulator
    rows = np.arange(min(len(log), MOST_ROWS))
    groups, X, y = log.groups[rows], log.X[rows], log.y[rows]
    before, after = (
        each.predict_many(X, [{}], groups=groups)[0] for each in (simulator, diagnosis.extended_simulator_)
    )
    there = np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    if not there.any():
        return None
    X, y, before, after = (one[there] for one in (X, y, before, after))
    return _OneStep(X, y, before, after, tuple(simulator.residual(y, each) for each in (before, after)))


def _clouds(diagnosis, log):
    rows = _one_step(diagnosis, log)
    if rows is None:
        return ()
    simulator = diagnosis.simulator
    outputs, state = list(simulator.output_names), bool(simulator.state_names)
    picked = np.unique(np.linspace(0, len(rows.inputs) - 1, min(len(rows.inputs), MOST_POINTS)).astype(int))
    reference = rows.inputs[:, : len(outputs)] if state else np.zeros_like(rows.measured)
    clouds = []
    for k, name in enumerate(outputs):
        if name not in simulator.residual_names:
            continue
        measured, before, after = (
            (part - reference)[picked, k] for part in (rows.measured, rows.before, rows.after)
        )
        clouds.append(
            Cloud(
                f"change of {name}" if state else name,
                simulator.units.get(name, ""),
                measured,
                before,
                after if diagnosis.causes_ else None,
            )
        )
    return tuple(clouds)


def _laws(diagnosis, log):
    """Return the residuals of the channels that depend on an input most clearly, binned by it."""
    rows = None if tuple(diagnosis.hidden) else _one_step(diagnosis, log)
    if rows is None:
        return ()
    found = []
    for coordinate in range(rows.inputs.shape[1]):
        bins = _bins(rows.inputs[:, coordinate])
        if bins.max() > 0:
            scores = _dependence(rows.residuals[0], bins)
            found += [(score, channel, coordinate) for channel, score in enumerate(scores)]
    pairs: dict[int, int] = {}
    for score, channel, coordinate in sorted(found, reverse=True):
        if score > CLEAR_DEPENDENCE and len(pairs) < MOST_LAWS:
            pairs.setdefault(channel, coordinate)
    names, inputs = diagnosis.simulator.residual_names, diagnosis.simulator.input_names
    units = diagnosis.simulator.units
    left = []
    for channel, coordinate in pairs.items():
        bins = _bins(rows.inputs[:, coordinate])
        centres = _bin_means(rows.inputs[:, [coordinate]], bins)[0][:, 0]
        (before, _), (mean, error) = (
            tuple(part[:, 0] for part in _bin_means(residuals[:, [channel]], bins))
            for residuals in rows.residuals
        )
        law = Law(
            inputs[coordinate],
            units.get(inputs[coordinate], ""),
            centres,
            mean,
            mean - 2 * error,
            mean + 2 * error,
            before if diagnosis.causes_ else None,
        )
        left.append(
            Left(f"error of {names[channel]}, one step ahead", units.get(names[channel], ""), law=law)
        )
    return tuple(left)


def _bins(values):
    edges = np.unique(np.quantile(values, np.linspace(0, 1, N_BINS + 1)[1:-1]))
    return np.unique(np.searchsorted(edges, values, side="left"), return_inverse=True)[1]


def _bin_means(columns, bins):
    """Return means and their standard errors, (n_bins, n_columns)."""
    counts = np.bincount(bins)[:, None]
    means = np.stack([np.bincount(bins, column) for column in columns.T], axis=1) / counts
    squares = np.stack([np.bincount(bins, column) for column in ((columns - means[bins]) ** 2).T], axis=1)
    return means, np.sqrt(squares / counts / np.maximum(counts - 1, 1))


def _dependence(residuals, bins):
    """Return for each channel how far the bins' means are from zero, in standard errors."""
    means, errors = _bin_means(residuals, bins)
    count = bins.max() + 1
    safe = np.where(errors > 0, errors, np.inf)
    return (np.sum(np.minimum((means / safe) ** 2, 1e6), axis=0) - count) / np.sqrt(2 * count)
