"""Files that a user names for output: none is overwritten unless that is asked for."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path


def writable(path: str | PathLike[str], *, force: bool, remedy: str = "force=True") -> Path:
    """Return a path to write to, before the work begins that would be lost otherwise.

    Parameters
    ----------
    path : str or Path
    force : bool
        Whether a file that exists may be overwritten.
    remedy : str, default="force=True"
        How the user says so, for the message.

    Raises
    ------
    FileExistsError
        If the file exists and may not be overwritten, or is a folder.
    FileNotFoundError
        If its folder does not exist.
    """
    path = Path(path)
    if path.is_dir():
        raise FileExistsError(f"{path} is a folder; expected the name of a file to write.")
    if path.exists() and not force:
        raise FileExistsError(f"{path} exists. Choose another name, or overwrite it with {remedy}.")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"There is no folder {path.parent} to write {path.name} into. Make it first.")
    return path


@contextmanager
def whole(path: str | PathLike[str]) -> Iterator[Path]:
    """Yield the name of a draft beside a file, which becomes the file once it is written as a whole.

    Parameters
    ----------
    path : str or Path
        As `writable` returns it.
    """
    path = Path(path)
    draft = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        yield draft
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)
