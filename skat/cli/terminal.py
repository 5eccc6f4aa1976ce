"""What the command line shows: progress, tables, messages; and how it ends when the input is wrong."""

import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from skat.files import writable

if TYPE_CHECKING:
    import pandas as pd

EXIT_BAD_INPUT = 2
# What warnings for Python say to pass, as the command line has it.
AS_OPTIONS = {"velocities='measured'": "--velocities measured", "in hidden=": "by --hidden"}


def output_console() -> Console:
    """Return a console on the present standard output, wide enough for a table when that is a file."""
    return _console(sys.stdout)


def error_console() -> Console:
    """Return a console on the present standard error."""
    return _console(sys.stderr)


@contextmanager
def clear_errors() -> Iterator[None]:
    """End with one message and exit code 2 where the input is wrong, and show warnings as single lines."""
    console = error_console()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            warnings.showwarning = lambda message, *_, **__: _say(
                console, "Warning", "yellow", _worded(message)
            )
            yield
    except (ValueError, OSError, RuntimeError, TypeError, ImportError) as error:
        _say(console, "Error", "red", error)
        raise typer.Exit(EXIT_BAD_INPUT) from error


@contextmanager
def heard() -> Iterator[list[str]]:
    """Yield a list that the texts of warnings given within are added to; they are shown as before."""
    texts: list[str] = []
    show = warnings.showwarning

    def hear(message: Warning | str, *others: Any, **named: Any) -> None:
        texts.append(str(message))
        show(message, *others, **named)

    warnings.showwarning = hear
    try:
        yield texts
    finally:
        warnings.showwarning = show


def existing_file(path: str | PathLike[str], what: str) -> Path:
    """Return a path that the user named, after a check that it is a file.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    """
    if not Path(path).is_file():
        found = "It is a folder." if Path(path).is_dir() else "Check the path."
        raise FileNotFoundError(f"There is no file {path}; expected {what}. {found}")
    return Path(path)


def existing_path(path: str | PathLike[str], what: str) -> Path:
    """Return a path that the user named, after a check that it is there; a folder is one, too.

    Raises
    ------
    FileNotFoundError
        If there is nothing.
    """
    if not Path(path).exists():
        raise FileNotFoundError(f"There is no file {path}; expected {what}. Check the path.")
    return Path(path)


def output_file(path: str | PathLike[str], *, force: bool) -> Path:
    """Return a path that the user named for output, after a check that nothing is lost by writing to it."""
    return writable(path, force=force, remedy="--force")


def check_apart(*outputs: Path | None) -> None:
    """Raise where two outputs of a command are one file, in which the second would replace the first."""
    paths = [path for path in outputs if path is not None]
    places = [path.resolve() for path in paths]
    for path, place in zip(paths, places):
        if places.count(place) > 1:
            raise ValueError(f"{path} is given for two outputs. Choose another name for one of them.")


def unused(path: str | PathLike[str]) -> Path:
    """Return the path, with a number added where a file of that name exists."""
    path, number = Path(path), 1
    candidate = path
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return candidate


def table_of(
    frame: "pd.DataFrame", *, title: str | None = None, formats: Mapping[str, str] | None = None
) -> Table:
    """Return a table with the rows of a data frame.

    Parameters
    ----------
    frame : DataFrame
        What to show.

    title : str, default=None
        Line above the table.

    formats : dict of str to str, default=None
        Format of the numbers in a column, such as ``".3g"``, which is what other columns of floats have.

    Returns
    -------
    rich.table.Table
    """
    formats = formats or {}
    table = Table(title=title, title_justify="left")
    for column in frame.columns:
        table.add_column(str(column), justify="right" if frame[column].dtype.kind in "fi" else "left")
    for row in frame.itertuples(index=False):
        table.add_row(
            *(
                _cell(value, formats.get(column, ".3g"))
                for column, value in zip(frame.columns, row, strict=True)
            )
        )
    return table


def print_line(text: str, style: str | None = None) -> None:
    """Print a line on standard output as it is, however long."""
    output_console().print(text, style=style, markup=False, soft_wrap=True)


def _cell(value: object, number: str) -> str:
    if isinstance(value, float):
        return "" if value != value else format(value, number)
    return escape(str(value))


def _console(stream: TextIO) -> Console:
    # A pipe has no width; 160 keeps rows of a table on one line.
    return Console(file=stream, highlight=False, width=None if stream.isatty() else 160)


def _worded(message: Warning | str) -> str:
    text = str(message)
    for python, option in AS_OPTIONS.items():
        text = text.replace(python, option)
    return text


def _say(console: Console, word: str, colour: str, message: object) -> None:
    console.print(f"[{colour}]{word}:[/{colour}] {escape(str(message))}", soft_wrap=True)
