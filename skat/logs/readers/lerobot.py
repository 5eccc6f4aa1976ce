"""LeRobot data sets on disk, v2.1 (a file an episode) and v3 (many episodes a file)."""

import json
from operator import itemgetter
from pathlib import Path

from skat.logs.errors import LogError
from skat.logs.readers.parquet import parquet_stream
from skat.logs.streams import Recording


def read(path: Path) -> Recording:
    """Return the recording of a LeRobot data set; elements of vectors have the names of ``meta/info.json``.

    Raises
    ------
    LogError
        If its description is damaged or its data are missing.
    """
    meta = path / "meta" / "info.json"
    try:
        info = json.loads(meta.read_text(encoding="utf-8"))
        version, features = str(info["codebase_version"]), dict(info["features"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise LogError(
            str(meta),
            f"is no description of a LeRobot data set: {type(error).__name__} {str(error)[:100]}.",
            "Expected JSON with codebase_version and features; copy the folder meta anew.",
        ) from None
    if not version.startswith(("v2", "v3")):
        raise LogError(
            str(meta),
            f"says codebase_version {version!r}; v2.x and v3.x are read.",
            "Convert it with LeRobot's scripts.",
        )
    files = sorted((path / "data").glob("**/*.parquet"))
    if not files:
        raise LogError(
            str(path),
            "has a description but no data/*/*.parquet.",
            "Download the folder data too (Git LFS: git lfs pull).",
        )
    labels = {name: _names(feature) for name, feature in features.items()}
    rate = info.get("fps")
    known = isinstance(rate, int | float) and not isinstance(rate, bool) and rate > 0
    return Recording(
        str(path),
        (parquet_stream(files, {name: names for name, names in labels.items() if names}),),
        rate=float(rate) if known else None,
        notes=(f"LeRobot {version}, {len(files)} files",),
    )


def _names(feature: object) -> list[str]:
    """Return the names of a feature's elements: a list, or a list or mapping in a mapping."""
    names = feature.get("names") if isinstance(feature, dict) else None
    while isinstance(names, dict) and names:
        if all(isinstance(value, int) for value in names.values()):
            return [str(name) for name, _ in sorted(names.items(), key=itemgetter(1))]
        names = next(iter(names.values()))
    return [str(name) for name in names] if isinstance(names, list) else []
