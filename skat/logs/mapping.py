"""What the user says of names and units: options and map.toml."""

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from skat.files import writable
from skat.logs.errors import LogError
from skat.logs.log import Log
from skat.logs.units import parsed_unit


def read_map(maps: Sequence[str] = (), path: str | PathLike[str] | None = None) -> dict[str, str]:
    """Return the mapping for `load_log`'s ``columns`` from options and a file.

    Parameters
    ----------
    maps : sequence of str
        ``NAME=THEIRS[:UNIT]`` each, as ``--map`` takes them; they come before the file's. ``NAME=:UNIT`` says the
        unit alone.
    path : path, optional
        A ``map.toml``.

    Returns
    -------
    dict from str to str

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    LogError
        If it is no such map, or an option has no ``=``.

    Examples
    --------
    >>> from skat.logs import read_map
    >>> read_map(["qpos.*=*_pos:deg", "ctrl.*=/commands.position"])
    {'qpos.*': '*_pos:deg', 'ctrl.*': '/commands.position'}
    """
    found = {} if path is None else _file(Path(path))
    for option in maps:
        name, mark, theirs = option.partition("=")
        if not mark or not name.strip():
            raise LogError(
                f"--map {option!r}", "has no '='.", "Expected NAME=THEIRS[:UNIT], such as qpos.elbow=q1:deg."
            )
        found[name.strip()] = theirs.strip()
    return found


def _file(path: Path) -> dict[str, str]:
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}. Check the path; expected a map.toml.")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise LogError(
            str(path), f"is no TOML: {error}.", 'A line of it is "qpos.elbow" = "q1:deg".'
        ) from None
    columns = content.get("columns", content)
    if not isinstance(columns, dict):
        raise LogError(
            str(path),
            f"has columns = {columns!r} where a table was expected.",
            "Write [columns] on a line of its own.",
        )
    bad = [name for name, theirs in columns.items() if not isinstance(theirs, str | int | float)]
    if bad:
        raise LogError(
            str(path), f"has no text for {', '.join(bad)}.", 'Put names in quotes: "qpos.elbow" = "q1:deg".'
        )
    return {name: str(theirs) for name, theirs in columns.items()}


def write_map(path: str | PathLike[str], log: Log, *, force: bool = False) -> Path:
    """Write which column of a log stands for what, as a map.toml that `load_log` takes as ``columns``.

    Parameters
    ----------
    path : path
    log : Log
    force : bool, default=False
        Whether to overwrite a file that exists.

    Returns
    -------
    Path

    Raises
    ------
    FileExistsError
        If the file exists and `force` is False.
    """
    target = writable(path, force=force)
    lines = [
        f"# Columns of {log.source}: the simulator's name, then theirs, then the unit after a colon.",
        "[columns]",
    ]
    clocks = sum(match.name == "time" for match in log.matches)
    for match in log.matches:
        # Topics have clocks of their own, found again by their names; one key of TOML cannot hold them.
        if match.name == "time" and clocks > 1:
            continue
        theirs = f"{match.theirs}:{match.unit}" if match.unit else match.theirs
        lines.append(f"{json.dumps(match.name)} = {json.dumps(theirs)}  # {match.how}")
    target.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return target


def checked_columns(columns: Any) -> dict[str, str]:
    """Return the mapping that `load_log` was given, a path read.

    Raises
    ------
    TypeError
        If it is neither.
    """
    if columns is None:
        return {}
    if isinstance(columns, str | PathLike):
        return read_map(path=columns)
    if not isinstance(columns, Mapping):
        raise TypeError(
            f'columns must be a mapping such as {{"qpos.elbow": "q1:deg"}}, or the path of a map.toml; got '
            f"{type(columns).__name__}"
        )
    return {str(name): str(theirs) for name, theirs in columns.items()}


def without_unit(theirs: str, known: Mapping[str, Any]) -> tuple[str, str]:
    """Return (column, unit) of what a user wrote; a column whose own name has a colon is left whole."""
    if theirs in known:
        return theirs, ""
    for mark in re.finditer(":", theirs):
        head, tail = theirs[: mark.start()], theirs[mark.end() :]
        if _is_unit(tail):
            return head, tail
    if ":" in theirs and (not theirs.partition(":")[0] or theirs.partition(":")[0] in known):
        return theirs.partition(":")[0], theirs.partition(":")[2]
    return theirs, ""


def _is_unit(text: str) -> bool:
    try:
        parsed_unit(text, limits=(0.0, 1.0))
    except ValueError as error:
        return "is unknown" not in str(error)
    return True
