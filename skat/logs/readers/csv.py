"""CSV, also compressed by gzip, also with cells that hold a list as text."""

import csv
import gzip
import json
import re
import warnings
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import pandas as pd

from skat.logs.errors import LogError
from skat.logs.streams import MOST_COLUMNS, Recording, Stream
from skat.simulators.tables import Array

ROWS_AT_ONCE = 200_000
# Pandas 3 reads numbers to the last digit by itself, and warns of being told to.
EXACT: dict[str, Any] = {"float_precision": "round_trip"} if int(pd.__version__.split(".")[0]) < 3 else {}
# Rows that say which columns hold lists.
FIRST_ROWS = 50
LIST = re.compile(r"^\s*[\[(].*[\])]\s*$", re.DOTALL)
LONGEST_LINE = 1 << 24


def read(path: Path) -> Recording:
    """Return the recording of a CSV file.

    Raises
    ------
    LogError
        If it holds no table.
    """
    _check_first_line(path)
    head = _frame(path, nrows=FIRST_ROWS, dtype=str)
    names = [str(name) for name in head.columns]
    if len(names) > MOST_COLUMNS:
        raise LogError(
            str(path), f"has {len(names)} columns.", "Give a table with a column for each channel."
        )
    if len(head) == 0:
        raise LogError(str(path), "has no rows below its first line.", "Record a log with at least 20 rows.")
    sizes = {name: _size(head[name]) for name in names}
    columns = []
    for name in names:
        columns += [f"{name}[{element}]" for element in range(sizes[name])] if sizes[name] else [name]
    return Recording(
        str(path),
        (
            Stream(
                "",
                tuple(columns),
                lambda wanted: _columns(path, sizes, wanted),
                lambda row: f"line {line_of(path, row)}",
            ),
        ),
    )


def _check_first_line(path: Path) -> None:
    """Raise where the first line holds no names: pandas would make some up, or change those that come twice."""
    try:
        with _opened(path) as file:
            line = next((line for line in iter(lambda: file.readline(LONGEST_LINE), "") if line.strip()), "")
        names = [name.strip().lstrip("\ufeff") for name in next(csv.reader([line]), [])]
    except READ_ERRORS as error:
        raise _no_table(path, error) from None
    if len(names) == 1 and (advice := _other_mark(line)):
        raise LogError(f"{path}, line 1", "has a single column.", advice)
    if names and all(_is_number(name) for name in names):
        raise LogError(
            f"{path}, line 1",
            f"holds numbers ({', '.join(names[:3])}, ...) where the names of the columns were expected.",
            "Write a first line with a name for each column.",
        )
    if repeated := [name for name in names if name and names.count(name) > 1]:
        raise LogError(
            f"{path}, line 1", f"names two columns {repeated[0]!r}.", "Give one of them another name."
        )


def line_of(path: Path, row: int) -> int:
    """Return the line of the file that ends a row of its table."""
    with _opened(path) as file:
        reader = csv.reader(file)
        seen = -1
        for fields in reader:
            if any(map(str.strip, fields)) or len(fields) > 1:
                if seen == row:
                    return reader.line_num
                seen += 1
    return row + 2


def _columns(path: Path, sizes: dict[str, int], wanted: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the wanted columns, read in chunks; elements of a list come out of its cells."""
    whole = {name.rsplit("[", 1)[0] if name not in sizes else name for name in wanted}
    parts: dict[str, list[np.ndarray]] = {name: [] for name in wanted}
    start = 0
    for chunk in _frame(path, usecols=lambda name: str(name).strip() in whole, chunksize=ROWS_AT_ONCE):
        for name in whole:
            if sizes[name]:
                cells = _lists(chunk[name], sizes[name], path, name, start)
                for element in range(sizes[name]):
                    if f"{name}[{element}]" in parts:
                        parts[f"{name}[{element}]"].append(cells[:, element])
            else:
                parts[name].append(_numbers(chunk[name]))
        start += len(chunk)
    return {name: _concatenated(pieces) for name, pieces in parts.items()}


def _concatenated(pieces: list[np.ndarray]) -> np.ndarray:
    if len({piece.dtype.kind for piece in pieces}) > 1:
        pieces = [piece.astype(object) for piece in pieces]
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


def _numbers(column: pd.Series) -> np.ndarray:
    """Return floats where each cell is a number or empty; otherwise the texts, stripped."""
    if column.dtype.kind in "fiub":
        return np.asarray(column, dtype=float)
    texts = column.fillna("").astype(str).str.strip()
    numbers = np.asarray(pd.to_numeric(texts, errors="coerce"), dtype=float)
    empty = texts.str.lower().isin(["", "nan", "+nan", "-nan", "null", "none"]).to_numpy()
    if (empty | ~np.isnan(numbers)).all():
        return numbers
    return np.asarray(texts, dtype=object)


def _lists(column: pd.Series, size: int, path: Path, name: str, start: int) -> Array:
    values = np.full((len(column), size), np.nan)
    for row, cell in enumerate(column.fillna("").astype(str)):
        if not cell.strip():
            continue
        try:
            numbers = [np.nan if item is None else float(item) for item in _parsed(cell)]
        except (ValueError, TypeError):
            numbers = []
        if len(numbers) != size:
            raise LogError(
                f"{path}, line {line_of(path, start + row)}, column {name}",
                f"expected a list of {size} numbers, got {cell[:60]!r}.",
                "Remove the row, or write as many numbers as in the first one.",
            )
        values[row] = numbers
    return values


def _parsed(cell: str) -> list[Any]:
    inner = cell.strip()[1:-1]
    if "," in inner:
        cells: list[Any] = json.loads(f"[{inner}]")
        return cells
    return inner.split()


def _size(column: pd.Series) -> int:
    """Return how many numbers the cells of a column hold; 0 where they are plain."""
    cells = [cell for cell in column.fillna("").astype(str) if cell.strip()]
    if not cells or not all(LIST.match(cell) for cell in cells):
        return 0
    try:
        return len(_parsed(cells[0]))
    except ValueError:
        return 0


def _frame(path: Path, **options: Any) -> Any:
    """Return a data frame, or an iterator of them, whose errors are those of a log."""
    try:
        with warnings.catch_warnings():
            # Where rows have more values than names, pandas only warns, and columns get the names of others.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            warnings.simplefilter("ignore", pd.errors.DtypeWarning)
            frame = pd.read_csv(
                path,
                compression="gzip" if _is_gzip(path) else None,
                skipinitialspace=True,
                index_col=False,
                keep_default_na=False,
                na_values=[""],
                low_memory=False,
                encoding="utf-8-sig",
                **EXACT,
                **options,
            )
            if "chunksize" not in options:
                frame.columns = frame.columns.astype(str).str.strip()
                return frame
    except READ_ERRORS as error:
        raise _no_table(path, error) from None
    return _chunks(path, frame)


READ_ERRORS = (
    ValueError,
    OverflowError,
    EOFError,
    OSError,
    zlib.error,
    csv.Error,
    IndexError,
    pd.errors.ParserWarning,
    pd.errors.ParserError,
)


def _chunks(path: Path, frames: Any) -> Iterator[pd.DataFrame]:
    with frames:
        while True:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error", pd.errors.ParserWarning)
                    warnings.simplefilter("ignore", pd.errors.DtypeWarning)
                    chunk = next(frames)
            except StopIteration:
                return
            except READ_ERRORS as error:
                raise _no_table(path, error) from None
            chunk.columns = chunk.columns.astype(str).str.strip()
            yield chunk


def _no_table(path: Path, error: BaseException) -> LogError:
    if isinstance(error, EOFError | zlib.error | gzip.BadGzipFile) and _is_gzip(path):
        return LogError(str(path), f"is cut or damaged: {error}.", "Copy the file anew.")
    try:
        with _opened(path) as file:
            advice = _other_mark(file.readline(LONGEST_LINE))
    except READ_ERRORS:
        advice = ""
    told = str(error).strip().rstrip(".")
    return LogError(
        str(path),
        f"is not a CSV table: {told}.",
        advice or "A CSV table has a line of names, and as many values in each row.",
    )


def _other_mark(line: str) -> str:
    """Return what to do about a line that is separated by another mark; "" where it is not."""
    if "," in line.strip(";\t| ") and ";" not in line and "\t" not in line:
        return ""
    if any(mark in line for mark in ";\t|"):
        return (
            "The file seems to be separated by another mark than commas: write it with commas between columns, and "
            "points in numbers."
        )
    return ""


def _is_gzip(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(2) == b"\x1f\x8b"


def _opened(path: Path) -> IO[str]:
    if _is_gzip(path):
        return gzip.open(path, "rt", errors="replace", newline="")
    return path.open(errors="replace", newline="")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
