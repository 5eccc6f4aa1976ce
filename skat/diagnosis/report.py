"""The findings of a diagnosis as text and as a page."""

import copy
import warnings
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd

from skat.diagnosis.comparison import EXTENDED, NOMINAL, ceiling_sentence, compare_transports, is_beaten
from skat.diagnosis.findings import Gain
from skat.diagnosis.log import Log, check_log
from skat.diagnosis.omnibus import is_structured
from skat.diagnosis.report_figures import cause_picture, log_pictures

TEMPLATE = "report.html.jinja"
# Longer tables are folded away.
LONGEST_TABLE = 15
LONGEST_REPR = 120
HEADLINES = {
    "nothing detected": "Nothing detected",
    "named": "{} named",
    "ambiguous": "{} named, but the data allow other names",
    "unexplained": "Unexplained",
}


@dataclass(frozen=True)
class Table:
    """A table of a page: texts, ready to be shown.

    Attributes
    ----------
    title : str
    columns : list of str
    rows : list of list of str
    numeric : list of bool
        Which columns hold numbers.
    """

    title: str
    columns: list
    rows: list
    numeric: list

    @property
    def is_long(self):
        """Whether it is folded away."""
        return len(self.rows) > LONGEST_TABLE


@dataclass(frozen=True)
class ShownLog:
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


class Report:
    """The findings of a fitted diagnosis, in text and as a page.

    It stays as it is if the diagnosis is fitted again, pickles with it, and draws its pictures when they are
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
        self._tables: list[Table] = []
        self._tests = [ShownLog("Rows held out", held_out, diagnosis.gain_)] if held_out is not None else []

    def __repr__(self):
        return self.text()

    def _repr_html_(self):
        return self.html(figures=False)

    def text(self):
        """Return the findings as a few lines of text."""
        diagnosis = self.diagnosis
        lines = [f"Verdict: {diagnosis.verdict_}"]
        for cause in diagnosis.causes_:
            lines.append(f"  {_cause_sentence(cause)}")
            if cause.aliases:
                lines.append(f"    cannot be told from: {', '.join(cause.aliases)}")
        if diagnosis.verdict_ == "unexplained":
            lines.append(f"  {_capital(_rest(diagnosis))}.")
        if diagnosis.causes_:
            lines += [f"  {test.title}: {gain_sentence(test.gain)}" for test in self._tests if test.gain]
        return "\n".join(lines)

    def html(self, figures=True):
        """Return the findings as a piece of HTML that needs no other file.

        Parameters
        ----------
        figures : bool, default=True
            Whether to add the pictures, and the errors of transports learned from the data: it takes seconds.

        Returns
        -------
        str
            ASCII, to stand in any page or notebook; it follows the reader's choice of light or dark.
        """
        from jinja2 import Environment, PackageLoader, StrictUndefined

        environment = Environment(
            loader=PackageLoader("skat.diagnosis", "."),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        if figures:
            self._compare()
        page = environment.get_template(TEMPLATE).render(self._content(figures))
        page = page.replace(" %", "\N{NO-BREAK SPACE}%")
        return page.encode("ascii", "xmlcharrefreplace").decode()

    def to_html(self, path, *, force=False):
        """Write the findings, with pictures, as a page that any browser shows.

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
            If the file exists and `force` is False.
        FileNotFoundError
            If its folder does not exist.
        """
        path = Path(path)
        if path.is_dir():
            raise FileExistsError(f"{path} is a folder; expected the name of a file to write.")
        if path.exists() and not force:
            raise FileExistsError(f"{path} exists. Choose another name, or overwrite it with force=True.")
        if not path.parent.is_dir():
            raise FileNotFoundError(
                f"There is no folder {path.parent} to write {path.name} into. Make it first."
            )
        body = self.html()
        page = (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            '<meta name="color-scheme" content="light dark">\n<title>Diagnosis of a simulation</title>\n'
            f"</head>\n<body>\n{body}\n</body>\n</html>\n"
        )
        with path.open("w" if force else "x", encoding="utf-8") as file:
            file.write(page)
        return path

    def add_table(self, title, frame):
        """Add a table to the page.

        Parameters
        ----------
        title : str
        frame : DataFrame
            An index with a name is shown as the first column.
        """
        if not isinstance(frame, pd.DataFrame):
            raise TypeError(f"frame must be a pandas DataFrame; it is a {type(frame).__name__}.")
        self._tables.append(_table(title, frame))

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
        self._tests.append(ShownLog(str(title), log, gain, errors=None if errors is None else errors.copy()))

    # -- content ------------------------------------------------------------------------------------------

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

    def _content(self, figures):
        diagnosis = self.diagnosis
        shown = self._tests or [ShownLog("Rows fitted", self.log)]
        pictures = {}
        if figures:
            pictures = {index: log_pictures(diagnosis, test.log) for index, test in enumerate(shown)}
        table, invisible = _identifiability(diagnosis)
        return {
            "verdict": diagnosis.verdict_,
            "headline": HEADLINES[diagnosis.verdict_].format(_counted(diagnosis.causes_, "cause")),
            "sentences": self._sentences(),
            "causes": _causes(diagnosis.causes_) if diagnosis.causes_ else None,
            "cause_picture": cause_picture(diagnosis) if figures else None,
            "tests": [
                {
                    "title": test.title,
                    "fitted": not self._tests,
                    "gains": [
                        gain_sentence(gain)
                        for gain in (test.gain, test.open_loop)
                        if gain and diagnosis.causes_
                    ],
                    "errors": _errors(test.errors) if test.errors is not None else None,
                    "ceiling": ceiling_sentence(test.errors) if test.errors is not None else "",
                    "notes": _notes(test.errors) if test.errors is not None else [],
                    "note": test.note,
                    "channels": _channels(diagnosis, test),
                    "pictures": pictures.get(index, []),
                }
                for index, test in enumerate(shown)
            ],
            "remainder": _remainder(diagnosis),
            "identifiability": table,
            "invisible": invisible,
            "tables": self._tables,
            "facts": self._facts(),
        }

    def _sentences(self):
        """Return the verdict in sentences."""
        diagnosis = self.diagnosis
        unexplained = diagnosis.verdict_ == "unexplained"
        sentences = [_cause_sentence(cause) for cause in diagnosis.causes_]
        for cause in diagnosis.causes_:
            if cause.aliases:
                others, each = _listed(cause.aliases), "each of them" if len(cause.aliases) > 1 else "it"
                sentences.append(
                    f"These data cannot tell {cause.name} from {others}: put in its place, {each} explains "
                    "the log as well."
                )
        if diagnosis.verdict_ == "nothing detected":
            sentences.append("The log shows no difference from the simulation that noise would not explain.")
        if unexplained:
            rest = _rest(diagnosis)
            sentences.insert(
                0, f"Beside what is named below, {rest}." if diagnosis.causes_ else f"{_capital(rest)}."
            )
        known = [test.errors for test in self._tests if test.errors is not None]
        return sentences + [ceiling_sentence(errors) for errors in known if unexplained or is_beaten(errors)]

    def _facts(self):
        diagnosis, log = self.diagnosis, self.log
        simulator = diagnosis.simulator
        episodes = f" in {log.n_episodes} episodes" if log.consecutive else ", independent of each other"
        effects = len(diagnosis.identifiability_)
        facts = {
            "Simulator": _short(simulator),
            "Rows fitted": f"{len(log)}{episodes}",
            "Inputs": ", ".join(simulator.input_names),
            "Outputs": ", ".join(simulator.output_names),
            "Not measured": ", ".join(diagnosis.hidden),
            "Effects considered": f"{effects}, at most {diagnosis.max_effects} named",
            "Chance of a false alarm": f"at most {diagnosis.alpha:g}",
            "Noise": "estimated from the log" if isinstance(diagnosis.noise, str) else "given",
            "Written by": f"skat {version('skat')}",
        }
        return {name: fact for name, fact in facts.items() if fact}


def gain_sentence(gain):
    """Return a Gain in a sentence."""
    if gain.horizon == 1:
        text = (
            f"the squared one-step error goes from {gain.nominal:.3g} to {gain.extended:.3g} times what "
            "noise alone gives"
        )
    else:
        text = f"the open-loop error of whole episodes goes from {gain.nominal:.3g} to {gain.extended:.3g}"
    share, low, high = (f"{100 * one:.0f}" for one in (gain.explained, *gain.interval))
    if np.ptp(gain.interval) > 1:
        return f"{text}; that is too close to the noise to say which share of the excess is explained."
    return f"{text}; {share} % of the excess is explained (95 %: {low} to {high} %)."


def _rest(diagnosis):
    """Return in words what is left: its shape, or that it has none."""
    if is_structured(diagnosis.remainder_, diagnosis.alpha):
        return diagnosis.remainder_.sentence
    return "errors are larger than the noise explains, and depend on no single input in a way that would say where"


def _cause_sentence(cause):
    low, high = cause.interval
    sentence = cause.sentence if cause.sentence.startswith(cause.name) else _capital(cause.sentence)
    end = (
        "; the estimate is at the end of the range allowed, so something else may be behind it"
        if cause.at_bound
        else ""
    )
    return f"{sentence.rstrip('.')} (95 %: {_number(low)} to {_number(high)}){end}."


def _capital(text):
    return text[:1].upper() + text[1:]


def _counted(things, word):
    return f"{len(things)} {word}{'' if len(things) == 1 else 's'}"


def _listed(names):
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def _short(simulator):
    text = repr(simulator)
    return text if len(text) <= LONGEST_REPR else type(simulator).__name__


def _initial_state(diagnosis):
    return "fitted" if tuple(diagnosis.hidden) else "measured"


def _rows(log):
    """Return X, y and the episodes of a log."""
    return log.X, log.y, log.episodes if log.consecutive else None


# -- tables ----------------------------------------------------------------------------------------------


def _table(title, frame):
    if frame.index.name is not None:
        frame = frame.reset_index()
    if "unit" in frame and not frame["unit"].any():
        frame = frame.drop(columns="unit")
    numeric = [
        pd.api.types.is_numeric_dtype(dtype) and not pd.api.types.is_bool_dtype(dtype)
        for dtype in frame.dtypes
    ]
    rows = [[_cell(value) for value in row] for row in frame.itertuples(index=False, name=None)]
    return Table(str(title), [str(column) for column in frame.columns], rows, numeric)


def _cell(value):
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else _number(value)
    return "" if value is None else str(value)


def _number(value):
    if np.isinf(value):
        return "∞" if value > 0 else "-∞"
    return f"{value:.4g}"


def _p_value(value):
    return "<\N{NO-BREAK SPACE}0.0001" if value < 1e-4 else f"{value:.2g}"


def _unit(unit):
    return "" if unit == "1" or unit.startswith("unit of ") else unit.replace(" ", "\N{NO-BREAK SPACE}")


def _causes(causes):
    return _table(
        "Causes",
        pd.DataFrame(
            {
                "cause": [cause.name for cause in causes],
                "size": [cause.value for cause in causes],
                "95 % interval": [
                    "{}\N{NO-BREAK SPACE}to\N{NO-BREAK SPACE}{}".format(*map(_number, cause.interval))
                    for cause in causes
                ],
                "unit": [_unit(cause.unit) for cause in causes],
                "p": [_p_value(cause.p_value) for cause in causes],
                "cannot be told from": [", ".join(cause.aliases) or "none" for cause in causes],
            }
        ),
    )


def _errors(errors):
    """Return the rows of the table of errors, with each bar's length in percent."""
    largest = errors["error"].max()
    best = errors["error"].idxmin()
    rows = []
    for index, row in errors.iterrows():
        answered = np.isfinite(row["error"])
        interval = ""
        if answered and row["method"] != EXTENDED:
            interval = "{ratio:.3g} ({ratio_low:.3g} to {ratio_high:.3g})".format(**row)
        rows.append(
            {
                "method": row["method"],
                "error": f"{row['error']:.4g}" if answered else "no answer",
                "share": f"{100 * row['error'] / largest:.1f}" if answered and largest > 0 else "0",
                "ratio": interval,
                "n_rows": row["n_rows"] or "",
                "kind": {NOMINAL: "before", EXTENDED: "after"}.get(row["method"], "map"),
                "best": index == best,
            }
        )
    return rows


def _notes(errors):
    notes: dict[str, list] = {}
    for method, note in zip(errors["method"], errors["note"], strict=True):
        if note:
            notes.setdefault(note, []).append(method)
    return [f"{', '.join(methods)}: {note}" for note, methods in notes.items()]


def _channels(diagnosis, test):
    """Return the table of noise and one-step errors of each channel."""
    names = [name for name in diagnosis.simulator.residual_names if name not in tuple(diagnosis.hidden)]
    frame = pd.DataFrame(
        {"noise": np.asarray(diagnosis.noise_, dtype=float)}, index=pd.Index(names, name="channel")
    )
    units = {
        effect.target: effect.unit for effect in diagnosis.simulator.effects() if effect.family == "bias"
    }
    frame["unit"] = [_unit(units.get(name, "")) for name in names]
    if test.gain is not None and test.gain.channels:
        horizon = "one step" if test.gain.horizon == 1 else "open loop"
        before, after = (
            [test.gain.channels.get(name, (np.nan, np.nan))[k] for name in names] for k in (0, 1)
        )
        frame[f"error before, {horizon}"] = before
        if diagnosis.causes_:
            frame[f"error after, {horizon}"] = after
    return _table("Channels", frame)


def _remainder(diagnosis):
    """Return the table of what is left, or None."""
    remainder = diagnosis.remainder_
    if diagnosis.verdict_ != "unexplained" or not is_structured(remainder, diagnosis.alpha):
        return None
    frame = pd.DataFrame(
        [(direction, coordinate, _p_value(p)) for direction, coordinate, p in remainder.table[:6]],
        columns=["acts on", "depends on", "p of this pair"],
    )
    return _table("What is left", frame)


def _identifiability(diagnosis):
    """Return the table of effects that the log would show, and the names of the others."""
    frame = diagnosis.identifiability_
    visible = np.isfinite(frame["smallest"])
    named = {cause.name for cause in diagnosis.causes_}
    shown = pd.DataFrame(
        {
            "smallest size": frame.loc[visible, "smallest"],
            "unit": frame.loc[visible, "unit"].map(_unit),
            "most similar effect": frame.loc[visible, "nearest_alias"],
            "similarity": frame.loc[visible, "similarity"].map("{:.2f}".format),
            "named": [("yes" if name in named else "") for name in frame.index[visible]],
        },
        index=frame.index[visible],
    )
    return _table("What these data would have shown", shown), list(frame.index[~visible])
