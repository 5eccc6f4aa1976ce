"""The tables of a page: numbers in as many digits as they deserve, and guarded where they deserve none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skat.diagnosis.report.content import Table
from skat.rounding import interval_text, number, size_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import pandas as pd

    from skat.diagnosis.report.content import (
        Alternative,
        Change,
        ChannelError,
        ChannelNoise,
        ForceNoise,
        Left,
        MethodError,
        ShownCause,
        Visibility,
    )

# An interval that is wider than so many times what it is about says no size.
WIDE = 1.0
# Longer tables are folded away.
LONGEST_TABLE = 15
GAP = "\N{NO-BREAK SPACE}"


@dataclass(frozen=True)
class Cell:
    """What stands in a cell.

    `key`: what its column is sorted by; None: the text. `share`: length of a bar below the text, in percent. `role`:
    what the bar shows: "before", "after", "map".
    """

    text: str
    key: float | None = None
    share: float | None = None
    role: str = ""


@dataclass(frozen=True)
class Grid:
    """A table, ready to be shown.

    `title`: for who does not see where it stands. `kinds` in {"text", "whole", "number", "bars"}: of the columns: text,
    text that is not broken into lines, numbers, and numbers with bars.
    """

    title: str
    columns: tuple[str, ...]
    kinds: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    @property
    def is_long(self) -> bool:
        """Whether it is folded away."""
        return len(self.rows) > LONGEST_TABLE


def is_guarded(value: float, interval: tuple[float, float] | None, neutral: float = 0.0) -> bool:
    """Whether an interval is so wide that the value in it must not be read as a size.

    `neutral`: from where sizes count.
    """
    if interval is None:
        return False
    width = interval[1] - interval[0]
    return not np.isfinite([value, width]).all() or width > WIDE * abs(value - neutral)


def guarded_size(value: float, interval: tuple[float, float] | None, neutral: float = 0.0) -> str:
    """Return a value in text; where its interval is too wide, the interval in its place."""
    if interval is None:
        return number(value)
    if is_guarded(value, interval, neutral):
        return f"between {interval_text(interval).replace(' to ', ' and ')}"
    return size_text(value, interval)


def probability_text(probability: float) -> str:
    """Return a probability in percent, never as a certainty."""
    percent = 100 * probability
    if percent > 99.5:
        return f">{GAP}99{GAP}%"
    return f"<{GAP}1{GAP}%" if percent < 0.5 else f"{percent:.0f}{GAP}%"


def plain_unit(unit: str) -> str:
    """Return a unit as it stands behind a number; empty where it says nothing."""
    return "" if unit == "1" or unit.startswith("unit of ") else unit


def alternatives_text(alternatives: Iterable[Alternative]) -> str:
    """Return other names in one line, with their probabilities as far as they are known."""
    texts = []
    for one in alternatives:
        names = " with ".join(one.names)
        texts.append(names if one.probability is None else f"{names} ({probability_text(one.probability)})")
    return ", ".join(texts)


def cause_grid(title: str, causes: Sequence[ShownCause]) -> Grid:
    """Return the table of causes; columns of which nothing is known are left out."""
    columns = {
        "cause": ([Cell(cause.name) for cause in causes], "text"),
        "size": (
            [Cell(guarded_size(cause.value, cause.interval, cause.neutral), cause.value) for cause in causes],
            "number",
        ),
        "95 % interval": (
            [Cell(interval_text(cause.interval).replace(" ", GAP), cause.interval[0]) for cause in causes],
            "whole",
        ),
        "unit": ([Cell(_unit(cause.unit)) for cause in causes], "whole"),
        "probability": (
            [
                Cell(
                    "" if cause.probability is None else probability_text(cause.probability),
                    cause.probability,
                )
                for cause in causes
            ],
            "number",
        ),
        "evidence": ([Cell(cause.evidence.replace(" ", GAP)) for cause in causes], "whole"),
        "cannot be told from": (
            [Cell(alternatives_text(cause.aliases) or "none") for cause in causes],
            "text",
        ),
        "at the end of its range": ([Cell("yes" if cause.at_bound else "") for cause in causes], "text"),
    }
    return _grid(title, columns)


def error_grid(title: str, errors: Sequence[ChannelError]) -> Grid:
    """Return the table of errors by channel, with a bar before and a bar after."""
    columns = {
        "channel": ([Cell(one.name) for one in errors], "text"),
        "unit": ([Cell(_unit(one.unit)) for one in errors], "whole"),
        "before": ([_bar(one.nominal, one, "before") for one in errors], "bars"),
        "after": ([_bar(one.extended, one, "after") for one in errors], "bars"),
        "noise alone": ([_bar(one.floor, one, "map") for one in errors], "bars"),
        "excess explained": ([_share(one.gain, one.interval) for one in errors], "number"),
    }
    return _grid(title, columns)


def method_grid(title: str, errors: Sequence[MethodError]) -> Grid:
    """Return the table of errors by method."""
    largest = max((one.error for one in errors if one.error is not None), default=0.0)
    ratios = []
    for one in errors:
        text = "" if one.ratio is None else number(one.ratio, 3)
        if one.ratio is not None and one.interval is not None:
            text += f" ({number(one.interval[0], 3)} to {number(one.interval[1], 3)})".replace(" ", GAP)
        ratios.append(Cell(text, one.ratio))
    columns = {
        "method": ([Cell(one.method) for one in errors], "text"),
        "error": (
            [
                Cell("no answer", np.inf)
                if one.error is None
                else Cell(
                    number(one.error), one.error, 100 * one.error / largest if largest else 0.0, one.kind
                )
                for one in errors
            ],
            "bars",
        ),
        "against extended (95 %)": (ratios, "whole"),
        "rows": (
            [Cell(str(one.n_rows) if one.n_rows else "", float(one.n_rows)) for one in errors],
            "number",
        ),
    }
    return _grid(title, columns)


def left_grid(title: str, left: Sequence[Left]) -> Grid:
    """Return the table of what no cause explains."""
    columns = {
        "where": ([Cell(one.name) for one in left], "text"),
        "size (rms)": (
            [Cell("" if one.rms is None else _bounded(one.rms, one.interval), one.rms) for one in left],
            "number",
        ),
        "unit": ([Cell(_unit(one.unit)) for one in left], "whole"),
        "of what acts there": (
            [
                Cell(f"{100 * one.rms / one.scale:.2g}{GAP}%", one.rms / one.scale)
                if one.scale and one.rms is not None
                else Cell("")
                for one in left
            ],
            "number",
        ),
        "depends on": ([Cell("" if one.law is None else one.law.regressor) for one in left], "text"),
        "that predicts of it": ([_share(one.predictable, None) for one in left], "number"),
        "looks like": ([Cell("" if one.spectrum is None else one.spectrum.word) for one in left], "text"),
    }
    return _grid(title, columns)


def noise_grid(title: str, noise: Sequence[ChannelNoise]) -> Grid:
    """Return the table of the measurement noise."""
    columns = {
        "channel": ([Cell(one.name) for one in noise], "text"),
        "standard deviation": (
            [Cell(guarded_size(one.deviation, one.interval), one.deviation) for one in noise],
            "number",
        ),
        "95 % interval": (
            [
                Cell("" if one.interval is None else interval_text(one.interval).replace(" ", GAP))
                for one in noise
            ],
            "whole",
        ),
        "unit": ([Cell(_unit(one.unit)) for one in noise], "whole"),
        "tails": ([Cell("" if one.tail is None else _tail(one.tail), one.tail) for one in noise], "text"),
    }
    return _grid(title, columns)


def force_grid(title: str, forces: Sequence[ForceNoise]) -> Grid:
    """Return the table of random forces."""
    columns = {
        "joint": ([Cell(one.name) for one in forces], "text"),
        "size (rms)": ([Cell(number(one.rms, 3), one.rms) for one in forces], "number"),
        "unit": ([Cell(_unit(one.unit)) for one in forces], "whole"),
        "memory": (
            [
                Cell(
                    ""
                    if one.memory_s is None
                    else f"{number(one.memory_s, 3)}{GAP}s" + ", taken back" * one.returns
                    if one.memory_s > 0
                    else "none",
                    one.memory_s,
                )
                for one in forces
            ],
            "number",
        ),
        "goes with": (
            [
                Cell(f"{one.beside}{GAP}({one.correlation:+.2f})" if one.beside else "", one.correlation)
                for one in forces
            ],
            "text",
        ),
    }
    return _grid(title, columns)


def visibility_grid(title: str, effects: Sequence[Visibility]) -> Grid:
    """Return the table of effects that the data would have shown."""
    columns = {
        "effect": ([Cell(one.name) for one in effects], "text"),
        "smallest size": ([Cell(number(one.smallest, 3), one.smallest) for one in effects], "number"),
        "unit": ([Cell(_unit(one.unit)) for one in effects], "whole"),
        "most similar": ([Cell(one.nearest_alias) for one in effects], "text"),
        "similarity": (
            [
                Cell("" if one.similarity is None else f"{one.similarity:.2f}", one.similarity)
                for one in effects
            ],
            "number",
        ),
        "told apart by": ([Cell(one.excitation) for one in effects], "text"),
        "named": ([Cell("yes" if one.is_named else "") for one in effects], "text"),
    }
    return _grid(title, columns)


def change_grid(title: str, changes: Sequence[Change]) -> Grid:
    """Return the table of what is different in the extended model."""
    columns = {
        "element": ([Cell(one.element) for one in changes], "text"),
        "attribute": ([Cell(one.attribute) for one in changes], "text"),
        "before": ([Cell("not there" if one.before is None else one.before) for one in changes], "text"),
        "after": ([Cell("not there" if one.after is None else one.after) for one in changes], "text"),
    }
    return _grid(title, columns)


def text_grid(table: Table) -> Grid:
    """Return a table of texts."""
    rows = tuple(tuple(Cell(text) for text in row) for row in table.rows)
    kinds = tuple("number" if numeric else "text" for numeric in table.numeric)
    return Grid(table.title, tuple(table.columns), kinds, rows)


def as_table(title: str, frame: pd.DataFrame) -> Table:
    """Return a DataFrame as a Table; an index with a name is its first column."""
    import pandas as pd

    if frame.index.name is not None:
        frame = frame.reset_index()
    if "unit" in frame and not frame["unit"].any():
        frame = frame.drop(columns="unit")
    numeric = [
        pd.api.types.is_numeric_dtype(dtype) and not pd.api.types.is_bool_dtype(dtype)
        for dtype in frame.dtypes
    ]
    rows = [[_text(value) for value in row] for row in frame.itertuples(index=False, name=None)]
    return Table(str(title), [str(column) for column in frame.columns], rows, numeric)


# -- parts ---------------------------------------------------------------------------------------------------


def _grid(title: str, columns: dict[str, tuple[list[Cell], str]]) -> Grid:
    """Return the columns as a table, without those in which every cell is empty."""
    kept = {name: one for name, one in columns.items() if any(cell.text for cell in one[0])}
    rows = tuple(zip(*(cells for cells, _ in kept.values()), strict=True))
    return Grid(title, tuple(kept), tuple(kind for _, kind in kept.values()), rows)


def _bar(value: float | None, error: ChannelError, role: str) -> Cell:
    if value is None:
        return Cell("")
    largest = max(one for one in (error.nominal, error.extended, error.floor) if one is not None)
    return Cell(number(value, 3), value, 100 * value / largest if largest > 0 else 0.0, role)


def _share(share: float | None, interval: tuple[float, float] | None) -> Cell:
    if share is None or not np.isfinite(share):
        return Cell("")
    if interval is None or not np.isfinite(interval).all():
        return Cell(f"{100 * share:.0f}{GAP}%" if interval is None else "not known", share)
    low, high = (f"{100 * one:.0f}" for one in interval)
    if interval[1] - interval[0] > WIDE:
        return Cell("not known", share)
    return Cell(f"{100 * share:.0f}{GAP}% ({low} to {high}{GAP}%)", share)


def _bounded(rms: float, interval: tuple[float, float] | None) -> str:
    """Return a size, or where it is hardly known what it is at most."""
    if interval is None or not is_guarded(rms, interval):
        return number(rms, 3)
    return f"at most {number(interval[1], 2)}" if np.isfinite(interval[1]) else "not known"


def _tail(tail: float) -> str:
    if np.isinf(tail):
        return "normal"
    return f"heavy (Student's t, {number(tail, 2)} degrees of freedom)"


def _unit(unit: str) -> str:
    return plain_unit(unit).replace(" ", GAP)


def _text(value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else number(float(value))
    return "" if value is None else str(value)
