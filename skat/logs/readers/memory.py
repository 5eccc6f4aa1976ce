"""Data frames of pandas and polars, and mappings from names to arrays."""

from collections.abc import Mapping
from typing import Any

from skat.logs.errors import LogError
from skat.logs.readers.arrays import arrays_recording
from skat.logs.streams import Recording


def is_frame(source: Any) -> bool:
    """Whether it is a data frame."""
    return hasattr(source, "columns") and hasattr(source, "to_numpy")


def read(source: Any) -> Recording:
    """Return the recording of a data frame or a mapping.

    Raises
    ------
    LogError
        If it has no rows, or two columns of one name.
    """
    if not isinstance(source, Mapping):
        names = [str(name) for name in source.columns]
        if repeated := [name for name in set(names) if names.count(name) > 1]:
            raise LogError(
                "the data frame", f"has two columns {sorted(repeated)[0]}.", "Give one of them another name."
            )
        arrays = {name: source[column].to_numpy() for name, column in zip(names, source.columns)}
        return arrays_recording(arrays, "the data frame")
    return arrays_recording(source, "the arrays")
