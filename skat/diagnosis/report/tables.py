"""The tables of a page: texts, ready to be shown."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from skat.diagnosis.comparison import EXTENDED, NOMINAL
from skat.diagnosis.log import measured_channels
from skat.diagnosis.omnibus import is_structured
from skat.rounding import interval_text, number, size_text

# Longer tables are folded away.
LONGEST_TABLE = 15


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


def as_table(title, frame):
    """Return a DataFrame as a Table; an index with a name is its first column."""
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
        return "" if np.isnan(value) else number(value)
    return "" if value is None else str(value)


def _p_value(value):
    return "<\N{NO-BREAK SPACE}0.0001" if value < 1e-4 else f"{value:.2g}"


def _unit(unit):
    return "" if unit == "1" or unit.startswith("unit of ") else unit.replace(" ", "\N{NO-BREAK SPACE}")


def cause_table(causes):
    """Return the table of the causes named."""
    return as_table(
        "Causes",
        pd.DataFrame(
            {
                "cause": [cause.name for cause in causes],
                "size": [size_text(cause.value, cause.interval) for cause in causes],
                "95 % interval": [
                    interval_text(cause.interval).replace(" ", "\N{NO-BREAK SPACE}") for cause in causes
                ],
                "unit": [_unit(cause.unit) for cause in causes],
                "p": [_p_value(cause.p_value) for cause in causes],
                "cannot be told from": [", ".join(cause.aliases) or "none" for cause in causes],
            }
        ),
    )


def error_bars(errors):
    """Return the rows of the table of errors, with each bar's length in percent."""
    largest = errors["error"].max()
    best = errors["error"].idxmin()
    rows = []
    for index, row in errors.iterrows():
        answered = np.isfinite(row["error"])
        interval = ""
        if answered and row["method"] != EXTENDED:
            interval = "{ratio:.3g}".format(**row)
            if np.isfinite(row["ratio_low"]):
                interval += " ({ratio_low:.3g} to {ratio_high:.3g})".format(**row)
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


def error_notes(errors):
    """Return the notes of a comparison, each with the methods that it is about."""
    notes: dict[str, list] = {}
    for method, note in zip(errors["method"], errors["note"], strict=True):
        if note:
            notes.setdefault(note, []).append(method)
    return [f"{', '.join(methods)}: {note}" for note, methods in notes.items()]


def channel_table(diagnosis, test):
    """Return the table of noise and one-step errors of each channel."""
    simulator = diagnosis.simulator
    names = np.array(simulator.residual_names)[measured_channels(simulator, tuple(diagnosis.hidden))]
    frame = pd.DataFrame(
        {"noise": np.asarray(diagnosis.noise_, dtype=float)}, index=pd.Index(names, name="channel")
    )
    frame["unit"] = [_unit(simulator.units.get(name, "")) for name in names]
    if test.gain is not None and test.gain.channels:
        horizon = "one step" if test.gain.horizon == 1 else "open loop"
        before, after = (
            [test.gain.channels.get(name, (np.nan, np.nan))[k] for name in names] for k in (0, 1)
        )
        frame[f"error before, {horizon}"] = before
        if diagnosis.causes_:
            frame[f"error after, {horizon}"] = after
    return as_table("Channels", frame)


def remainder_table(diagnosis):
    """Return the table of what is left, or None."""
    remainder = diagnosis.remainder_
    if diagnosis.verdict_ != "unexplained" or not is_structured(remainder, diagnosis.alpha):
        return None
    frame = pd.DataFrame(
        [(direction, coordinate, _p_value(p)) for direction, coordinate, p in remainder.table[:6]],
        columns=["acts on", "as a function of", "p of this pair"],
    )
    return as_table("What is left", frame)


def identifiability_table(diagnosis):
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
    return as_table("What these data would have shown", shown), list(frame.index[~visible])
