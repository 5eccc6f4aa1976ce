"""Stamps in two columns, whole seconds and nanoseconds, as tools of ROS write them into tables."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skat.logs.streams import Recording, Stream

PARTS = (("sec", "nanosec"), ("secs", "nsecs"), ("sec", "nsec"), ("seconds", "nanos"))


def joined_stamps(record: Recording) -> Recording:
    """Return the recording with one column, in s, in the place of the two of a stamp: ``header.stamp`` of its parts."""
    return replace(record, streams=tuple(_joined(stream) for stream in record.streams))


def _joined(stream: Stream) -> Stream:
    pairs = _pairs(stream)
    if not pairs:
        return stream

    def read(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        parts = [part for name in wanted for part in pairs.get(name, (name,))]
        found = stream.read(list(dict.fromkeys(parts)))
        return {
            name: _seconds(*(found[part] for part in pairs[name])) if name in pairs else found[name]
            for name in wanted
        }

    names = {whole: name for name, (whole, _) in pairs.items()}
    rests = {rest for _, rest in pairs.values()}
    columns = tuple(names.get(column, column) for column in stream.columns if column not in rests)
    return replace(stream, columns=columns, read=read)


def _pairs(stream: Stream) -> dict[str, tuple[str, str]]:
    """Return {name: (column of seconds, column of nanoseconds)} of the stamps of a stream."""
    prefix = f"{stream.name}." if stream.name else ""
    found = {}
    for whole, rest in PARTS:
        for column in stream.columns:
            stem = column.removesuffix(whole)
            if stem == column or stem + rest not in stream.columns:
                continue
            name = prefix + (stem.removeprefix(prefix).rstrip("._ ") or "stamp")
            if name not in stream.columns:
                found[name] = column, stem + rest
    return found


def _seconds(whole: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return s of both; of columns that are no parts of a stamp the first one, as it is."""
    if whole.dtype == object or rest.dtype == object:
        return whole
    seconds, nanoseconds = (part[np.isfinite(whole) & np.isfinite(rest)] for part in (whole, rest))
    are_parts = not (seconds % 1).any() and ((nanoseconds >= 0) & (nanoseconds < 1e9)).all()
    return whole + rest / 1e9 if are_parts else whole
