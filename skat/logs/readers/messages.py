"""Messages of any type as rows of numbers: fields by their names, arrays beside names of joints by those."""

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from skat.logs.errors import LogError
from skat.logs.streams import Recording, Stream

# Messages of a topic that say which fields it has; several publishers may share one.
FIRST_MESSAGES = 20
# Messages looked through for the first ones of every topic.
MOST_LOOKED_AT = 50_000
# A message larger than this is a picture or a cloud.
LARGEST_MESSAGE = 100_000
MOST_FIELDS = 2_000
NAMES = ("name", "names", "joint_name", "joint_names")
STAMP, RECEIPT = "header.stamp", "time"
DEEPEST = 8

# (topic, stamp of receipt in ns, the message)
Message = tuple[str, int, Any]


def messages_recording(
    source: str,
    types: dict[str, str],
    messages: Callable[[set[str] | None], Iterable[Message]],
    notes: Iterable[str] = (),
) -> Recording:
    """Return the recording of messages.

    Parameters
    ----------
    source : str
        The file, for messages.
    types : mapping from topic to the name of its type
    messages : callable
        ``messages(topics)`` iterates over the messages of the topics, of all where None, decoded.
    notes : iterable of str

    Raises
    ------
    LogError
        If no topic holds numbers.
    """
    first: dict[str, list[dict[str, float]]] = {topic: [] for topic in types}
    origins: list[int] = []
    for looked, (topic, stamp, message) in enumerate(messages(None)):
        origins.append(stamp)
        seen = first.setdefault(topic, [])
        if len(seen) < FIRST_MESSAGES:
            seen.append(fields(message))
        if looked > MOST_LOOKED_AT or all(len(rows) >= FIRST_MESSAGES for rows in first.values()):
            break
    streams = []
    stamps = [row[STAMP] for rows in first.values() for row in rows if row.get(STAMP)]
    origin = {RECEIPT: min(origins, default=0), STAMP: int(min(stamps, default=0))}
    for topic, rows in first.items():
        keys = list(dict.fromkeys(key for row in rows for key in row if key != STAMP))
        if not keys or len(keys) > MOST_FIELDS:
            continue
        if any(row.get(STAMP) for row in rows):
            keys.append(STAMP)
        columns = {f"{topic}.{key}": key for key in (*keys, RECEIPT)}
        streams.append(
            Stream(
                topic,
                tuple(columns),
                _reader(messages, topic, columns, origin),
                f"message {{}} of {topic}".format,
                clock_unit="s",
            )
        )
    if not streams:
        told = ", ".join(f"{topic} ({kind})" for topic, kind in types.items()) or "none"
        raise LogError(
            source,
            f"has no topic with messages that hold numbers; its topics: {told}.",
            "Record the topic of the joint states, such as /joint_states.",
        )
    return Recording(source, tuple(streams), notes=tuple(notes))


def _reader(
    messages: Callable[[set[str] | None], Iterable[Message]],
    topic: str,
    columns: dict[str, str],
    origin: dict[str, int],
) -> Callable[[Sequence[str]], dict[str, np.ndarray]]:
    return lambda wanted: collected(messages({topic}), {name: columns[name] for name in wanted}, origin)


def collected(
    messages: Iterable[Message], wanted: dict[str, str], origin: dict[str, int]
) -> dict[str, np.ndarray]:
    """Return the wanted fields of the messages as arrays; times in s since the origin."""
    columns = {name: array("d") for name in wanted}
    nan = float("nan")
    for _, stamp, message in messages:
        row = fields(message)
        for name, key in wanted.items():
            if key == RECEIPT and RECEIPT not in row:
                value = (stamp - origin[RECEIPT]) / 1e9
            elif key == STAMP:
                value = (row[STAMP] - origin[STAMP]) / 1e9 if row.get(STAMP) else nan
            else:
                value = row.get(key, nan)
            columns[name].append(value)
    return {
        name: np.frombuffer(values, dtype=float) if len(values) else np.empty(0)
        for name, values in columns.items()
    }


def fields(message: Any) -> dict[str, float]:
    """Return the numbers in a message by their paths; ``header.stamp`` in ns, an element of an array as ``data[0]``."""
    found: dict[str, float] = {}
    _walk("", message, None, found, 0)
    return found


def _walk(path: str, value: Any, names: list[str] | None, found: dict[str, float], depth: int) -> None:
    if len(found) > MOST_FIELDS or depth > DEEPEST:
        return
    if isinstance(value, bool | np.bool_):
        found[path] = float(value)
    elif isinstance(value, int | float | np.integer | np.floating):
        found[path] = value if isinstance(value, int) and path.endswith("stamp") else _float(value)
    elif isinstance(value, str | bytes | None):
        return
    elif _is_sequence(value):
        _elements(path, value, names, found, depth)
    else:
        parts = _parts(value)
        if (stamp := _stamp(parts)) is not None:
            found[path or STAMP] = stamp
            return
        names = _names(parts) or names
        for key, part in parts.items():
            _walk(f"{path}.{key}" if path else str(key), part, names, found, depth + 1)


def _float(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        return float("nan")


def _elements(path: str, value: Any, names: list[str] | None, found: dict[str, float], depth: int) -> None:
    if len(value) > MOST_FIELDS:
        return
    labels = names if names is not None and len(names) == len(value) else range(len(value))
    for label, element in zip(labels, value):
        if isinstance(element, int | float | np.integer | np.floating):
            found[f"{path}[{label}]"] = _float(element)
        elif not isinstance(element, str | bytes):
            _walk(f"{path}[{label}]", element, None, found, depth + 1)


def _is_sequence(value: Any) -> bool:
    if isinstance(value, list | tuple | np.ndarray):
        return not (isinstance(value, np.ndarray) and value.ndim == 0)
    return hasattr(value, "__len__") and hasattr(value, "__getitem__") and not hasattr(value, "keys")


def _parts(value: Any) -> dict[str, Any]:
    """Return the fields of a message by name, whichever library has decoded it."""
    if isinstance(value, dict):
        return value
    if hasattr(value, "DESCRIPTOR"):
        return {field.name: getattr(value, field.name) for field in value.DESCRIPTOR.fields}
    if hasattr(value, "__dataclass_fields__"):
        return {
            name: getattr(value, name) for name in value.__dataclass_fields__ if not name.startswith("__")
        }
    return {
        name: getattr(value, name) for name in getattr(value, "__slots__", ()) if not name.startswith("_")
    }


def _stamp(parts: Mapping[str, Any]) -> int | None:
    """Return ns where the fields are those of a time stamp, of ROS 1, ROS 2 or protobuf."""
    for seconds, rest in (("sec", "nanosec"), ("secs", "nsecs"), ("sec", "nsec"), ("seconds", "nanos")):
        if set(parts) == {seconds, rest}:
            try:
                return int(parts[seconds]) * 10**9 + int(parts[rest])
            except (TypeError, ValueError, OverflowError):
                return None
    return None


def _names(parts: Mapping[str, Any]) -> list[str] | None:
    for key in NAMES:
        names = parts.get(key)
        if names is None or isinstance(names, str | bytes) or not _is_sequence(names) or not len(names):
            continue
        if all(isinstance(name, str) for name in names):
            return list(names)
    return None
