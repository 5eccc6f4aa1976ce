"""The findings of a diagnosis as text and as a page."""

import copy
import warnings
from dataclasses import dataclass, replace
from importlib.metadata import version

import pandas as pd

from skat.diagnosis.comparison import ceiling_sentence, compare_transports
from skat.diagnosis.findings import Gain
from skat.diagnosis.log import Log, check_log
from skat.diagnosis.report.pictures import cause_picture, log_pictures
from skat.diagnosis.report.sentences import (
    capital,
    cause_sentence,
    cautions,
    counted,
    gain_sentence,
    remainder_sentence,
    verdict_sentences,
)
from skat.diagnosis.report.tables import (
    Table,
    as_table,
    cause_table,
    channel_table,
    error_bars,
    error_notes,
    identifiability_table,
    remainder_table,
)
from skat.files import whole, writable

TEMPLATE = "page.html.jinja"
LONGEST_REPR = 120
HEADLINES = {
    "nothing detected": "Nothing detected",
    "named": "{} named",
    "ambiguous": "{} named, but the data allow other names",
    "unexplained": "Unexplained",
}


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
        # The report of an earlier fit, with its logs.
        vars(self.diagnosis).pop("report_", None)
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
            lines.append(f"  {cause_sentence(cause)}")
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
            loader=PackageLoader("skat.diagnosis.report", "."),
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
            If the file exists and `force` is False, or is a folder.
        FileNotFoundError
            If its folder does not exist.
        """
        path = writable(path, force=force)
        body = self.html()
        page = (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            '<meta name="color-scheme" content="light dark">\n<title>Diagnosis of a simulation</title>\n'
            f"</head>\n<body>\n{body}\n</body>\n</html>\n"
        )
        with whole(path) as draft:
            draft.write_text(page, encoding="utf-8")
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
        self._tables.append(as_table(title, frame))

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
        table, invisible = identifiability_table(diagnosis)
        return {
            "verdict": diagnosis.verdict_,
            "headline": HEADLINES[diagnosis.verdict_].format(counted(diagnosis.causes_, "cause")),
            "sentences": verdict_sentences(
                diagnosis, [test.errors for test in self._tests if test.errors is not None]
            ),
            "causes": cause_table(diagnosis.causes_) if diagnosis.causes_ else None,
            "cause_picture": cause_picture(diagnosis) if figures else None,
            "tests": [
                {
                    "title": test.title,
                    "fitted": not self._tests,
                    "gains": [
                        gain_sentence(diagnosis, gain)
                        for gain in (test.gain, test.open_loop)
                        if gain and diagnosis.causes_
                    ],
                    "errors": error_bars(test.errors) if test.errors is not None else None,
                    "ceiling": ceiling_sentence(test.errors) if test.errors is not None else "",
                    "notes": error_notes(test.errors) if test.errors is not None else [],
                    "note": test.note,
                    "channels": channel_table(diagnosis, test),
                    "pictures": pictures.get(index, []),
                }
                for index, test in enumerate(shown)
            ],
            "remainder": remainder_table(diagnosis),
            "identifiability": table,
            "invisible": invisible,
            "tables": self._tables,
            "facts": self._facts(),
        }

    def _facts(self):
        diagnosis, log = self.diagnosis, self.log
        simulator = diagnosis.simulator
        episodes = f" in {log.n_episodes} {'episodes' if log.consecutive else 'groups'}"
        if not log.consecutive and log.n_episodes == len(log):
            episodes = ", independent of each other"
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


def _short(simulator):
    text = repr(simulator)
    return text if len(text) <= LONGEST_REPR else type(simulator).__name__


def _initial_state(diagnosis):
    return "fitted" if tuple(diagnosis.hidden) else "measured"


def _rows(log):
    """Return X, y and the episodes of a log."""
    return log.X, log.y, log.episodes if log.consecutive or log.n_episodes < len(log) else None
