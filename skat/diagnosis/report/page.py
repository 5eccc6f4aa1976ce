"""A Content as text and as a page: a view, which computes nothing."""

from __future__ import annotations

import base64
import dataclasses
import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from skat.diagnosis.report.plots import (
    cause_line,
    cloud_plot,
    law_plot,
    points_of_each,
    signal_plots,
    spectrum_plot,
)
from skat.diagnosis.report.tables import (
    Cell,
    Grid,
    alternatives_text,
    as_table,
    cause_grid,
    change_grid,
    error_grid,
    force_grid,
    guarded_size,
    is_guarded,
    left_grid,
    method_grid,
    noise_grid,
    probability_text,
    text_grid,
    visibility_grid,
)
from skat.files import whole, writable

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from os import PathLike
    from pathlib import Path

    import pandas as pd
    from markupsafe import Markup

    from skat.diagnosis.report.content import (
        Content,
        Episode,
        Provenance,
        ShownCause,
        ShownLog,
        SourceFile,
        Table,
        Visibility,
    )
    from skat.diagnosis.report.plots import Plot

TEMPLATE, STYLE, SCRIPT = "page.html.jinja", "page.css", "page.js"
# Names break after a bracket, an underscore or a dot; what is as long as a hash within itself.
BREAKS = re.compile(
    r"(?<=[\[_])|(?<=\.)(?=[a-zA-Z])|(?<=\b[0-9a-f]{16})(?=[0-9a-f]{16})|(?<=[0-9a-f]{32})(?=[0-9a-f]{16})"
)
# Channels of an episode that are drawn unfolded.
MOST_CHANNELS = 4
# Effects that are less similar to their nearest alias can be told from it.
ALIKE = 0.9


@dataclass(frozen=True)
class Section:
    """A part of the page.

    `grid`: of a table that the user added.
    """

    anchor: str
    title: str
    grid: Grid | None = None


class Report:
    """The findings of a diagnosis, in text and as a page.

    Parameters
    ----------
    content : Content
    """

    def __init__(self, content: Content) -> None:
        self.content = content

    def __repr__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        return self.html(figures=False)

    def text(self) -> str:
        """Return the findings as a few lines of text."""
        return page_text(self._content(figures=False))

    def html(self, figures: bool = True) -> str:
        """Return the findings as a piece of HTML that needs no other file, for a page or a notebook.

        Parameters
        ----------
        figures : bool, default=True
            Whether to draw.

        Returns
        -------
        str
            ASCII, without a script; it follows the reader's choice of light or dark.
        """
        return fragment(self._content(figures))

    def to_html(self, path: str | PathLike[str], *, force: bool = False) -> Path:
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
        text = page(self._content(figures=True))
        with whole(path) as draft:
            draft.write_text(text, encoding="utf-8")
        return path

    def add_table(self, title: str, frame: pd.DataFrame) -> None:
        """Add a table to the page.

        Parameters
        ----------
        title : str
        frame : DataFrame
            An index with a name is shown as the first column.
        """
        self.content = dataclasses.replace(
            self.content, tables=(*self.content.tables, checked_table(title, frame))
        )

    def describe(self, *, title: str | None = None, made: Provenance | None = None) -> None:
        """Say what the findings are of and how they were made.

        Parameters
        ----------
        title : str, optional
        made : Provenance, optional
            It takes the place of the one that there was.
        """
        self.content = dataclasses.replace(
            self.content,
            title=self.content.title if title is None else title,
            provenance=self.content.provenance if made is None else made,
        )

    def _content(self, figures: bool) -> Content:
        return self.content if figures else without_figures(self.content)


def checked_table(title: str, frame: pd.DataFrame) -> Table:
    """Return a DataFrame as a Table, after a check that it is one."""
    import pandas as pd

    if not isinstance(frame, pd.DataFrame):
        raise TypeError(f"frame must be a pandas DataFrame; it is a {type(frame).__name__}.")
    return as_table(title, frame)


def page(content: Content) -> str:
    """Return a whole page, in ASCII."""
    title = _escaped(f"{content.title}: {content.verdict.headline}")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="color-scheme" content="light dark">\n<title>{title}</title>\n'
        # An empty icon: else a browser asks for one.
        f'<link rel="icon" href="data:,">\n</head>\n<body>\n{_rendered(content, is_page=True)}\n</body>\n</html>\n'
    )


def fragment(content: Content) -> str:
    """Return a piece of a page, in ASCII and without a script."""
    return _rendered(content, is_page=False)


def page_text(content: Content) -> str:
    """Return what the page says first, as lines of text."""
    verdict = content.verdict
    head = f"Verdict: {verdict.name}"
    if verdict.probability is not None:
        head += f" (probability {probability_text(verdict.probability)})".replace("\N{NO-BREAK SPACE}", " ")
    lines = [head, *(f"  {sentence}" for sentence in verdict.sentences)]
    lines += [f"  {log.title}: {sentence}" for log in content.logs for sentence in log.sentences]
    return "\n".join(lines)


def without_figures(content: Content) -> Content:
    """Return the content without what is drawn."""
    logs = tuple(dataclasses.replace(log, episodes=(), clouds=()) for log in content.logs)
    left = tuple(dataclasses.replace(one, law=None, spectrum=None) for one in content.left)
    return dataclasses.replace(content, logs=logs, left=left, stills=(), stills_note="")


# -- what the template shows ---------------------------------------------------------------------------------


def _rendered(content: Content, *, is_page: bool) -> str:
    body: str = _template().render(content=content, is_page=is_page, **_parts(content))
    return body.replace(" %", "\N{NO-BREAK SPACE}%").encode("ascii", "xmlcharrefreplace").decode()


@cache
def _template() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=PackageLoader("skat.diagnosis.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"breakable": _breakable, "readable_date": _readable_date}
    environment.globals |= {
        "css": Markup(_resource(STYLE)),
        "script": Markup(_resource(SCRIPT)),
        "probability_text": probability_text,
        "alternatives_text": alternatives_text,
    }
    return environment.get_template(TEMPLATE)


def _parts(content: Content) -> dict[str, Any]:
    visible = [one for one in content.visibility if np.isfinite(one.smallest)]
    roles = [
        ("measured", "measured"),
        ("before", "simulated, before" if _has_after(content) else "simulated"),
    ]
    if _has_after(content):
        roles.append(("after", "simulated, after"))
    left = [
        (
            one,
            None if one.law is None else law_plot(one.law, one.unit),
            None if one.spectrum is None else spectrum_plot(one.spectrum, one.unit),
        )
        for one in content.left
    ]
    left = [one for one in left if one[1] or one[2] or one[0].sentence]
    return {
        "sections": _sections(content),
        "roles": roles,
        "shown": [_Shown(log, content) for log in content.logs if log.episodes or log.clouds],
        "stills": [(one, _data_uri(one.png, "image/png")) for one in content.stills],
        "lines": [
            (cause, line, _Size(cause)) for cause in content.causes if (line := cause_line(cause)) is not None
        ],
        "errors": [
            (
                log,
                error_grid(f"Errors, {log.title}", log.errors) if log.errors else None,
                method_grid(f"Errors by method, {log.title}", log.comparison) if log.comparison else None,
            )
            for log in content.logs
            if _has_errors(log)
        ],
        "left": left,
        "law_has_before": [one.law is not None and one.law.before is not None for one, *_ in left],
        "n_visible": len(visible),
        "invisible": [one.name for one in content.visibility if not np.isfinite(one.smallest)],
        "facts": _facts(content),
        "grids": _grids(content, visible),
    }


class _Size:
    """A cause's size in words, and whether a dot may stand for it."""

    def __init__(self, cause: ShownCause):
        unit = "" if cause.unit in ("", "1") else f" {cause.unit}"
        self.text = f"{guarded_size(cause.value, cause.interval, cause.neutral)}{unit}"
        self.has_dot = not is_guarded(cause.value, cause.interval, cause.neutral)


class _Shown:
    """The plots of a log."""

    def __init__(self, log: ShownLog, content: Content):
        n_series = sum(
            len(episode.channels) * (3 if _has_after(content) else 2)
            for one in content.logs
            for episode in one.episodes
        )
        most = points_of_each(n_series)
        self.title, self.signal_horizon, self.is_fitted = log.title, log.signal_horizon, log.is_fitted
        self.episodes = [(episode.label, *_split(episode, most)) for episode in log.episodes]
        self.clouds = [cloud_plot(cloud) for cloud in log.clouds]


def _split(episode: Episode, most_points: int) -> tuple[list[Plot], list[Plot]]:
    plots = signal_plots(episode, most_points)
    return plots[:MOST_CHANNELS], plots[MOST_CHANNELS:]


def _has_after(content: Content) -> bool:
    shown = [
        one for log in content.logs for part in (*log.episodes, log) for one in getattr(part, "channels", ())
    ]
    shown += [cloud for log in content.logs for cloud in log.clouds]
    return any(one.extended is not None for one in shown)


def _has_errors(log: ShownLog) -> bool:
    return bool(log.errors or log.comparison or log.sentences or log.comparison_sentences or log.is_fitted)


def _grids(content: Content, visible: list[Visibility]) -> dict[str, Grid | None]:
    confused = {cause.name for cause in content.causes if cause.aliases}
    near = [one for one in visible if one.name in confused or (one.similarity or 0.0) >= ALIKE]
    files_of = content.provenance.files
    return {
        "causes": cause_grid("Causes", content.causes) if content.causes else None,
        "also_seen": cause_grid("Also seen", content.also_seen) if content.also_seen else None,
        "apart": visibility_grid("What cannot be told apart", near) if near else None,
        "left": left_grid("What is left", content.left)
        if any(o.rms is not None for o in content.left)
        else None,
        "noise": noise_grid("Noise", content.noise) if content.noise else None,
        "forces": force_grid("Random forces", content.forces) if content.forces else None,
        "visibility": visibility_grid("Effects that would have shown", visible) if visible else None,
        "changes": change_grid("Changes of the model", content.changes) if content.changes else None,
        "files": _file_grid(files_of) if files_of else None,
    }


def _file_grid(shown: Iterable[SourceFile]) -> Grid:
    rows = tuple(
        (
            Cell(one.role),
            Cell(one.path),
            Cell(
                "" if one.size is None else f"{one.size:,}".replace(",", "\N{NARROW NO-BREAK SPACE}"),
                one.size,
            ),
            Cell(one.sha256 or "not known"),
        )
        for one in shown
    )
    return Grid("Files", ("file", "path", "bytes", "SHA-256"), ("text", "text", "number", "text"), rows)


def _sections(content: Content) -> list[Section]:
    grids = _grids(content, [one for one in content.visibility if np.isfinite(one.smallest)])
    made = content.provenance
    candidates: Iterator[tuple[str, str, Any]] = iter(
        [
            (
                "signals",
                "Measured and simulated",
                content.stills
                or content.stills_note
                or any(log.episodes or log.clouds for log in content.logs),
            ),
            ("causes", "Causes", content.causes or content.also_seen),
            (
                "next",
                "What cannot be told apart, and what to measure next",
                grids["apart"] or content.next_steps,
            ),
            ("errors", "Errors", any(_has_errors(log) for log in content.logs)),
            ("left", "What is left", content.left or content.left_sentences),
            ("noise", "Noise", content.noise or content.forces),
            ("visible", "What these data could have shown", content.visibility),
            ("changes", "Changes of the model", content.changes or content.beside),
        ]
    )
    sections = [Section(anchor, title) for anchor, title, is_there in candidates if is_there]
    sections += [
        Section(f"table-{number}", table.title, text_grid(table))
        for number, table in enumerate(content.tables, start=1)
    ]
    if any((made.date, made.files, made.command, made.versions, made.settings, made.warnings, made.notes)):
        sections.append(Section("made", "How this was made"))
    return sections


def _facts(content: Content) -> list[tuple[str, str]]:
    made = content.provenance
    facts = [
        ("Command", made.command),
        ("Date", made.date),
        ("Seed", made.seed),
        *made.settings,
        ("Versions", ", ".join(f"{name} {version}" for name, version in made.versions)),
    ]
    return [(name, fact) for name, fact in facts if fact]


def _breakable(text: str) -> Markup:
    """Return the text with places at which a long name or number may be broken."""
    from markupsafe import Markup, escape

    return Markup("<wbr>").join(escape(piece) for piece in BREAKS.split(text))


def _readable_date(date: str) -> str:
    """Return a date of ISO 8601 to the minute, in words as far as need be."""
    return f"{date[:10]} {date[11:16]} {'UTC' if date.endswith('+00:00') else date[19:]}".strip()


def _resource(name: str) -> str:
    return files("skat.diagnosis.report").joinpath(name).read_text(encoding="utf-8")


def _data_uri(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _escaped(text: str) -> str:
    from html import escape

    return escape(text).encode("ascii", "xmlcharrefreplace").decode()
