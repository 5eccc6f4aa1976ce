"""Tables of numbers in CSV, all of whose columns count: the rows that are transported."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np
import pandas as pd

from skat.logs.errors import LogError
from skat.logs.readers import csv
from skat.logs.streams import is_number


def numeric_columns(path: str | PathLike[str], *, beside: Sequence[str] = ()) -> pd.DataFrame:
    """Return the table in a CSV file, all of whose values are numbers.

    Parameters
    ----------
    path : str or Path
        A file whose first line names the columns.

    beside : sequence of str, default=()
        Names of columns that are no samples, such as the time of a row; they stay the texts that they are.

    Returns
    -------
    DataFrame
        Columns of floats.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    LogError
        If it holds no table, or a value is missing or no number.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}. Check the path; expected a CSV file.")
    stream = csv.read(path).streams[0]
    columns = stream.read(stream.columns)
    kept = [name for name in stream.columns if name in beside]
    for name in stream.columns:
        if name in kept:
            continue
        values = columns[name]
        bad = [not _is_finite(cell) for cell in values] if values.dtype == object else ~np.isfinite(values)
        if np.any(bad):
            row = int(np.argmax(bad))
            cell = (
                values[row] if values.dtype == object else "" if np.isnan(values[row]) else str(values[row])
            )
            raise LogError(
                f"{path}, {stream.place(row)}, column {name}",
                f"expected a finite number, got {cell!r}"
                + (f" (and {int(np.sum(bad)) - 1} more such values)." if np.sum(bad) > 1 else "."),
                "Remove the rows with gaps.",
            )
    texts = _texts(path) if kept else pd.DataFrame()
    table = {
        name: texts[name].to_numpy() if name in kept else columns[name].astype(float)
        for name in stream.columns
    }
    return pd.DataFrame(table, columns=list(stream.columns))


def _texts(path: Path) -> pd.DataFrame:
    """Return the table as the texts that stand in it."""
    texts = pd.read_csv(path, dtype=str, keep_default_na=False, skipinitialspace=True)
    texts.columns = texts.columns.str.strip()
    return texts


def _is_finite(cell: str) -> bool:
    return is_number(cell) and bool(np.isfinite(float(cell)))


def with_same_columns(table: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    """Return a table with its columns in the order of another's.

    Parameters
    ----------
    table, other : DataFrame
        Tables that should have the same columns.

    Returns
    -------
    DataFrame
        Columns of `table`, in the order of `other`.

    Raises
    ------
    ValueError
        If one has a column that the other has not.
    """
    if differing := [name for name in [*table, *other] if (name in table) != (name in other)]:
        raise ValueError(
            f"The two tables must have the same columns; only one of them has: {', '.join(differing)}. "
            "Remove these columns, or add them to the other table."
        )
    return table[list(other)]
