"""HDF5: data sets of one length are columns; groups of the same data sets are episodes."""

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from skat.logs.errors import LogError
from skat.logs.readers.arrays import common_rows, notes_of, too_wide, with_last_held
from skat.logs.streams import MOST_BYTES, MOST_COLUMNS, Recording, Stream, as_numbers, plain_array, required

READ_ERRORS = (
    OSError,
    ValueError,
    KeyError,
    RuntimeError,
    TypeError,
    OverflowError,
    MemoryError,
    AttributeError,
)
DEEPEST = 12


def read(path: Path, topic: str | None = None) -> Recording:
    """Return the recording of an HDF5 file.

    Parameters
    ----------
    path : Path
    topic : str, optional
        A group; by default the whole file.

    Raises
    ------
    LogError
        If it is damaged or has no table.
    """
    h5py = required("h5py", "An HDF5 file")
    try:
        with h5py.File(path, "r") as file:
            shapes = _shapes(h5py, file, path)
    except LogError:
        raise
    except READ_ERRORS as error:
        raise _damaged(path, error) from None
    if topic is not None:
        prefix = topic.strip("/") + "/"
        inside = {name: shape for name, shape in shapes.items() if name.startswith(prefix)}
        if not inside:
            there = sorted({name.rpartition("/")[0] for name in shapes} - {""})
            raise LogError(
                str(path), f"has no group {topic!r}.", f"It has: {', '.join(there[:12]) or 'none'}."
            )
        shapes = inside
    if not shapes:
        raise LogError(
            str(path),
            "holds no data set with rows.",
            "A log has a data set for each column, or (rows, columns).",
        )
    groups = _episodes(shapes)
    parts = groups or [("", shapes)]
    wide = {name: int(np.prod(shape[1:])) if len(shape) > 1 else 0 for name, shape in parts[0][1].items()}
    left_out = {name: why for name, width in wide.items() if (why := too_wide(width))}
    rows = common_rows({name: shape[0] for name, shape in parts[0][1].items()})
    names = [name for name in wide if name not in rows.left_out]
    # Whose rows are counted.
    first = next(name for name in names if name not in rows.held)
    for group, inside in groups:
        odd = [
            name
            for name in names
            if inside[name] != (inside[first][0] - (name in rows.held), *groups[0][1][name][1:])
        ]
        if odd:
            raise LogError(
                f"{path}, {group}/{odd[0]}",
                f"has the shape {inside[odd[0]]}; {first} there has {inside[first][0]} rows, and a row of "
                f"{groups[0][0]}/{odd[0]} the shape {groups[0][1][odd[0]][1:]}.",
                "Write as many rows of each in an episode, and as many numbers in each row.",
            )
    columns: list[str] = []
    for name in names:
        if name not in left_out:
            columns += [f"{name}[{element}]" for element in range(wide[name])] if wide[name] else [name]
    if groups:
        columns.append("episode")
    prefix = "" if topic is None else topic.strip("/") + "/"
    shown = {column: column.removeprefix(prefix) for column in columns}
    theirs = {short: column for column, short in shown.items()}

    def read_columns(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        try:
            with h5py.File(path, "r") as file:
                found = {}
                for name in wanted:
                    if groups and theirs[name] == "episode":
                        found[name] = np.concatenate(
                            [np.full(inside[first][0], group, dtype=object) for group, inside in groups]
                        )
                    else:
                        found[name] = _column(file, parts, wide, theirs[name], rows.held)
                return found
        except LogError:
            raise
        except READ_ERRORS as error:
            raise _damaged(path, error) from None

    return Recording(
        str(path),
        (Stream("", tuple(shown.values()), read_columns),),
        notes=(*rows.notes, *notes_of(left_out)),
        left_out={**rows.left_out, **left_out},
    )


def _shapes(h5py: ModuleType, file: Any, path: Path) -> dict[str, tuple[int, ...]]:
    """Return the shape of each data set of numbers or texts, by name."""
    shapes: dict[str, tuple[int, ...]] = {}

    def walk(group: Any, prefix: str, depth: int) -> None:
        for name in group:
            link = group.get(name, getlink=True)
            if not isinstance(link, h5py.HardLink) or depth > DEEPEST or len(shapes) > MOST_COLUMNS:
                continue
            item = group[name]
            if isinstance(item, h5py.Group):
                walk(item, f"{prefix}{name}/", depth + 1)
            elif (
                isinstance(item, h5py.Dataset)
                and item.shape
                and item.dtype.kind in "fiubOSU"
                and item.shape[0]
            ):
                if (
                    item.dtype.kind in "fiub"
                    and item.nbytes > MOST_BYTES
                    and item.nbytes > 200 * max(item.id.get_storage_size(), 1)
                ):
                    raise LogError(
                        f"{path}, {prefix}{name}",
                        f"announces {item.nbytes} bytes and holds {item.id.get_storage_size()}.",
                        "Copy the file anew.",
                    )
                shapes[f"{prefix}{name}"] = tuple(int(size) for size in item.shape)

    walk(file, "", 0)
    return shapes


def _episodes(shapes: dict[str, tuple[int, ...]]) -> list[tuple[str, dict[str, tuple[int, ...]]]]:
    """Return [(group, {name in it: shape})] where groups hold the same data sets: episodes, in natural order."""
    by_group: dict[str, dict[str, tuple[int, ...]]] = {}
    for name, shape in shapes.items():
        top, _, rest = name.partition("/")
        if not rest:
            return []
        by_group.setdefault(top, {})[rest] = shape
    names = sorted(by_group, key=lambda group: (len(group), group))
    if len(names) < 2 or any(set(by_group[name]) != set(by_group[names[0]]) for name in names):
        return []
    return [(name, by_group[name]) for name in names]


def _column(
    file: Any,
    parts: list[tuple[str, dict[str, tuple[int, ...]]]],
    wide: dict[str, int],
    name: str,
    held: Sequence[str],
) -> np.ndarray:
    base, element = (
        (name, None) if name in wide else (name.rsplit("[", 1)[0], int(name.rsplit("[", 1)[1][:-1]))
    )
    pieces = []
    for group, _ in parts:
        item = file[f"{group}/{base}" if group else base]
        values = item[:] if element is None or item.ndim != 2 else item[:, element]
        if element is not None and item.ndim > 2:
            values = values.reshape(len(values), -1)[:, element]
        column = as_numbers(plain_array(values))
        pieces.append(with_last_held(column) if base in held else column)
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


def _damaged(path: Path, error: BaseException) -> LogError:
    told = " ".join(str(error).split())[:200]
    return LogError(str(path), f"is cut or damaged, or no HDF5 file: {told}.", "Copy the file anew.")
