"""What every reader returns: streams of columns, each stream with a clock of its own."""

import importlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np

from skat.logs.errors import LogError

# Of a library that is missing, the extra that holds it.
EXTRAS = {
    "pyarrow": "parquet",
    "h5py": "hdf5",
    "rosbags": "ros",
    "mcap": "ros",
    "mcap_ros2": "ros",
    "mcap_protobuf": "ros",
    "minari": "minari",
}
# An element of a vector column, by number or by name; a unit in brackets is none.
ELEMENT = re.compile(r"^(.*\S)\[(?!(?:deg|rad|rpm|rps|mm|cm|ms|us|ns|Nm|mNm|m|s)(?:/s)?\])([^\[\]]*)\]$")
# More columns than this in a log are no log: a picture, or a broken file.
MOST_COLUMNS = 10_000
# Bytes of a value that a log may hold; what is longer than that is no number.
MOST_BYTES = 1 << 29


@dataclass(frozen=True)
class Stream:
    """Columns whose rows were taken together.

    Attributes
    ----------
    name : str
        A topic; "" for a table.
    columns : tuple of str
        Every column; an element of a vector is ``column[0]``, or ``column[elbow]`` where the file names them.
    read : callable
        ``read(names)`` returns {name: array of shape (n_rows,)}, of floats (NaN: empty) or, where a cell is no
        number, of objects.
    place : callable
        ``place(row)`` says where a row stands, such as "line 12".
    labels : dict
        Of a column whose element the file names beside it, that name.
    clock_unit : str or None
        Of the times in ``name.time`` and ``name.header.stamp``, where the format says it, as a bag does.
    texts : frozenset of str
        Columns to be read as text, such as names of episodes.
    """

    name: str
    columns: tuple[str, ...]
    read: Callable[[Sequence[str]], dict[str, np.ndarray]]
    place: Callable[[int], str] = "row {}".format
    labels: dict[str, str] = field(default_factory=dict)
    clock_unit: str | None = None


@dataclass(frozen=True)
class Recording:
    """What is in a file.

    Attributes
    ----------
    source : str
        The path, or what it is.
    streams : tuple of Stream
    rate : float or None
        Rows per second, where the file says it once for all of them.
    notes : tuple of str
        What the reader did.
    left_out : mapping from name to str
        What each array has that is left out, such as "199 rows, the others 200".
    """

    source: str
    streams: tuple[Stream, ...]
    rate: float | None = None
    notes: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)

    def where(self, stream: Stream) -> str:
        """Say which stream of it is meant."""
        return f"{self.source}, {stream.name}" if stream.name else self.source


def required(module: str, what: str) -> ModuleType:
    """Return a module that reads a format; say how to install it where it is missing."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        extra = EXTRAS[module.split(".")[0]]
        raise ImportError(
            f'{what} needs {module.split(".")[0]}, which is not installed: pip install "skat[{extra}]"'
        ) from error


def plain_array(values: Any) -> np.ndarray:
    """Return an array of numbers, texts, or of shape (n, k) for cells that hold lists."""
    array = np.asarray(values)
    if array.dtype.kind in "Mm":
        kind = {"M": "datetime64[ns]", "m": "timedelta64[ns]"}[array.dtype.kind]
        return np.where(np.isnat(array), np.nan, array.astype(kind).astype(np.int64) / 1e9)
    if array.dtype == object and array.ndim == 1 and len(array):
        first = array[0]
        if isinstance(first, list | tuple | np.ndarray):
            try:
                return np.array([np.asarray(cell, dtype=float) for cell in array])
            except (ValueError, TypeError):
                return array
    return array


def as_numbers(array: np.ndarray) -> np.ndarray:
    """Return a column as floats where each cell is a number or empty, and as it is otherwise."""
    if array.dtype.kind in "fiub":
        return array.astype(float)
    if array.dtype.kind == "M":
        return plain_array(array)
    if array.dtype.kind in "OUS":
        try:
            return np.array([np.nan if _empty(cell) else float(cell) for cell in array.tolist()])
        except (TypeError, ValueError):
            return np.array([_text(cell) for cell in array.tolist()], dtype=object)
    raise LogError("an array", f"holds {array.dtype}, no numbers.", "Give real numbers.")


def is_number(text: str) -> bool:
    """Whether a text is a number as tables have them; Python also takes 1_0 and digits of other scripts for one."""
    try:
        float(text)
    except ValueError:
        return False
    return text.isascii() and "_" not in text


def _text(cell: object) -> object:
    return cell.decode("utf-8", "replace") if isinstance(cell, bytes) else cell


def _empty(cell: object) -> bool:
    return cell is None or (isinstance(cell, str | bytes) and not cell.strip())
