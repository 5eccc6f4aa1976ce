"""How findings were made: files with their hashes, versions, the date, and every warning."""

from __future__ import annotations

import functools
import hashlib
from contextlib import suppress
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

from skat.diagnosis.report.content import Provenance, SourceFile

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from os import PathLike

PACKAGES = ("skat", "mujoco", "numpy", "scipy", "scikit-learn")


def provenance(
    *,
    files: Iterable[tuple[str, str | PathLike[str]]] = (),
    command: str = "",
    seed: object = None,
    settings: Mapping[str, object] | None = None,
    warnings: Iterable[str] = (),
    notes: Iterable[str] = (),
) -> Provenance:
    """Return how findings are made here and now.

    `files`: role and path of each: "model", "log", "test". `settings`: those of None are left out. `warnings`, `notes`:
    each is said once.
    """
    return Provenance(
        date=datetime.now().astimezone().isoformat(timespec="seconds"),
        files=tuple(source_file(role, path) for role, path in files),
        command=command,
        versions=_versions(),
        seed="" if seed is None else str(seed),
        settings=tuple((name, str(one)) for name, one in (settings or {}).items() if one is not None),
        warnings=tuple(dict.fromkeys(map(str, warnings))),
        notes=tuple(dict.fromkeys(map(str, notes))),
    )


def source_file(role: str, path: str | PathLike[str]) -> SourceFile:
    """Return a file with its size and hash; a folder has those of the list of its files' hashes.

    `path`: one that is not there has no hash.
    """
    place = Path(path)
    if place.is_file():
        return SourceFile(role, str(path), _sha256(place), place.stat().st_size)
    if not place.is_dir():
        return SourceFile(role, str(path))
    inner = sorted(one for one in place.rglob("*") if one.is_file())
    listing = "".join(f"{_sha256(one)}  {one.relative_to(place).as_posix()}\n" for one in inner)
    return SourceFile(
        role,
        f"{path} ({len(inner)} files)",
        hashlib.sha256(listing.encode()).hexdigest(),
        sum(one.stat().st_size for one in inner),
    )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@functools.cache
def _versions() -> tuple[tuple[str, str], ...]:
    """Return the packages' versions; each is read from a file that is parsed whole."""
    found = []
    for name in PACKAGES:
        with suppress(PackageNotFoundError):  # run from a checkout that is not installed
            found.append((name, version(name)))
    return tuple(found)
