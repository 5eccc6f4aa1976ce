"""Read CSV tables, with the line and the remedy where one is not as it should be."""

import csv
import warnings
from pathlib import Path

import numpy as np
import pandas as pd


def numeric_columns(path, *, beside=()):
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

    ValueError
        If it holds no table, or a value is missing or no number.
    """
    table = read_table(path)
    names = [name for name in table if name not in beside]
    table[names] = numbers(table, names, path)
    return table.astype(dict.fromkeys(names, float))


def with_same_columns(table, other):
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
            f"The two tables must have the same columns; only one of them has: {listed(differing)}. "
            "Remove these columns, or add them to the other table."
        )
    return table[list(other)]


def read_table(path):
    """Return the table in a CSV file.

    Parameters
    ----------
    path : str or Path
        A file whose first line names the columns.

    Returns
    -------
    DataFrame
        Of texts without spaces around them: the episode "01" is not "1", and "NA" is one.

    Raises
    ------
    FileNotFoundError
        If there is no such file.

    ValueError
        If it holds no table.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}. Check the path; expected a CSV file.")
    try:
        with warnings.catch_warnings():
            # Where rows have more values than names, pandas only warns, and columns get the names of others.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(
                path, skipinitialspace=True, index_col=False, dtype=str, keep_default_na=False
            )
    except (ValueError, pd.errors.ParserWarning) as error:
        with path.open(errors="replace") as file:
            advice = other_mark(file.readline())
        raise ValueError(f"{path} is not a CSV table: {(advice or str(error)).strip()}") from error
    table.columns = table.columns.str.strip()
    table = table.fillna("").apply(lambda column: column.str.strip())
    if len(table) == 0:
        raise ValueError(f"{path} has no rows below its first line.")
    return table


def other_mark(line):
    """Return what to do about the first line of a file that is separated by another mark; "" where it is not."""
    if "," in line or not any(mark in line for mark in ";\t|"):
        return ""
    return (
        "The file seems to be separated by another mark than commas: write it with commas between columns, and "
        "points in numbers. "
    )


def numbers(table, names, path):
    """Return columns of texts as an array of finite numbers, or raise with file, line and column."""
    converted = table[names].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    bad = np.argwhere(~np.isfinite(converted))
    if len(bad):
        row, column = bad[0]
        raise ValueError(
            f"{path}, line {line_of(path, row)}, column {names[column]}: expected a finite number, got "
            f"{table[names[column]].iloc[row]!r}"
            + (f" (and {len(bad) - 1} more such values). " if len(bad) > 1 else ". ")
            + "Remove the rows with gaps, and start a new episode after each gap."
        )
    return converted


def line_of(path, row):
    """Return the line of a file that ends the row of its table."""
    with path.open(newline="") as file:
        reader = csv.reader(file)
        lines = [reader.line_num for fields in reader if any(map(str.strip, fields)) or len(fields) > 1]
    return lines[row + 1]


def listed(names, limit=12):
    """Return names for a message, the first ones where there are many."""
    return ", ".join(names[:limit]) + (f", ... ({len(names)} in all)" if len(names) > limit else "")
