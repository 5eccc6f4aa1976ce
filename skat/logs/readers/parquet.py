"""Parquet, column by column."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np

from skat.logs.errors import LogError
from skat.logs.streams import MOST_COLUMNS, Recording, Stream, as_numbers, plain_array, required

T = TypeVar("T")

# Rows that say how long the lists of a column are.
FIRST_ROWS = 10


def read(path: Path) -> Recording:
    """Return the recording of a Parquet file.

    Raises
    ------
    LogError
        If it is cut or damaged.
    """
    return Recording(str(path), (parquet_stream([path]),))


def parquet_stream(paths: list[Path], labels: dict[str, list[str]] | None = None) -> Stream:
    """Return the stream of Parquet files that follow each other.

    Parameters
    ----------
    paths : list of Path
    labels : mapping from column to names of its elements, optional
    """
    parquet = required("pyarrow.parquet", "A Parquet file")
    sizes = _sizes(parquet, paths[0])
    counts = [_guarded(path, partial(_n_rows, parquet, path)) for path in paths]
    rows = sum(counts)
    if rows == 0:
        raise LogError(str(paths[0]), "has no rows.", "Record a log with at least 20 rows.")
    columns: list[str] = []
    named: dict[str, str] = {}
    for name, size in sizes.items():
        elements = [f"{name}[{element}]" for element in range(size)] if size else [name]
        columns += elements
        names = (labels or {}).get(name)
        if size and names and len(names) == size:
            named |= dict(zip(elements, names))
    if len(columns) > MOST_COLUMNS:
        raise LogError(
            str(paths[0]), f"has {len(columns)} columns.", "Give a table with a column for each channel."
        )

    def read_columns(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        return _columns(parquet, paths, sizes, wanted)

    return Stream("", tuple(columns), read_columns, "row {}".format, named)


def _n_rows(parquet: ModuleType, path: Path) -> int:
    return int(parquet.ParquetFile(path).metadata.num_rows)


def _sizes(parquet: ModuleType, path: Path) -> dict[str, int]:
    """Return of each column how many numbers a cell holds; 0 where it is plain."""
    arrow = required("pyarrow", "A Parquet file")

    def look() -> dict[str, int]:
        file = parquet.ParquetFile(path)
        sizes: dict[str, int] = {}
        for field in file.schema_arrow:
            kind = field.type
            if arrow.types.is_fixed_size_list(kind):
                sizes[field.name] = kind.list_size
            elif arrow.types.is_list(kind) or arrow.types.is_large_list(kind):
                first = next(file.iter_batches(FIRST_ROWS, columns=[field.name]), None)
                cells = (
                    []
                    if first is None
                    else [cell for cell in first.column(0).to_pylist() if cell is not None]
                )
                if cells and all(isinstance(item, int | float) for item in cells[0]):
                    sizes[field.name] = len(cells[0])
            elif not arrow.types.is_nested(kind) and not arrow.types.is_binary(kind):
                sizes[field.name] = 0
        return sizes

    return _guarded(path, look)


def _columns(
    parquet: ModuleType, paths: list[Path], sizes: dict[str, int], wanted: Sequence[str]
) -> dict[str, np.ndarray]:
    whole = sorted({name if name in sizes else name.rsplit("[", 1)[0] for name in wanted})
    parts: dict[str, list[np.ndarray]] = {name: [] for name in wanted}
    for path in paths:
        # Column by column: of a wide or long file no more than one stands in memory twice.
        for name in whole:
            array = _guarded(path, partial(_column, parquet, path, name, sizes[name]))
            if not sizes[name]:
                parts[name].append(array)
                continue
            for element in range(sizes[name]):
                if f"{name}[{element}]" in parts:
                    parts[f"{name}[{element}]"].append(array[:, element])
    return {name: pieces[0] if len(pieces) == 1 else np.concatenate(pieces) for name, pieces in parts.items()}


def _column(parquet: ModuleType, path: Path, name: str, size: int) -> Any:
    column = parquet.ParquetFile(path).read(columns=[name]).column(0).combine_chunks()
    if not size:
        return as_numbers(plain_array(column.to_numpy(zero_copy_only=False)))
    if column.null_count or any(length != size for length in column.value_lengths().unique().to_pylist()):
        cells = column.to_pylist()
        lengths = [size if cell is None else len(cell) for cell in cells]
        if set(lengths) != {size}:
            row = next(row for row, length in enumerate(lengths) if length != size)
            raise LogError(
                f"{path}, row {row}, column {name}",
                f"holds {lengths[row]} numbers, the first row {size}.",
                "Leave the row out, or write as many numbers in each.",
            )
        return np.array([[np.nan] * size if cell is None else cell for cell in cells], dtype=float)
    return column.flatten().to_numpy(zero_copy_only=False).astype(float).reshape(-1, size)


def _guarded(path: Path, read: Callable[[], T]) -> T:
    """Return what a function of pyarrow returns; a damaged file is an error of the log."""
    arrow = required("pyarrow", "A Parquet file")
    try:
        return read()
    except LogError:
        raise
    except (
        arrow.ArrowException,
        OSError,
        ValueError,
        KeyError,
        EOFError,
        OverflowError,
        MemoryError,
        TypeError,
    ) as error:
        told = " ".join(str(error).split())[:200] or type(error).__name__
        raise LogError(
            str(path), f"is cut or damaged, or no Parquet file: {told}.", "Copy the file anew."
        ) from None
