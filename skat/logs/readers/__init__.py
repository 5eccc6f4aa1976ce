"""One reader a format; `recording` finds the one that a source needs."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skat.logs.errors import LogError
from skat.logs.readers import torch
from skat.logs.streams import Recording, Stream

FORMATS = (
    "CSV (also .gz), Parquet, NPZ, HDF5, PyTorch (tensors by name), rosbag2 (folder, .db3 or .mcap), ROS 1 bag, "
    "MCAP (ROS 2, JSON, protobuf), LeRobot v2.1 and v3 (folder), Minari (folder)"
)
MAGIC = (
    (b"PAR1", "parquet"),
    (b"PK\x03\x04", "npz"),
    (b"PK\x05\x06", "npz"),
    (b"\x89HDF\r\n\x1a\n", "hdf5"),
    (b"SQLite format 3\x00", "bags"),
    (b"\x89MCAP0\r\n", "mcap"),
    (b"#ROSBAG V2.0", "bags"),
    (b"\x93NUMPY", "npy"),
)
# What a file that begins otherwise is called after its ending: it is damaged, not another format.
ENDINGS = {
    ".parquet": "parquet",
    ".npz": "npz",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".db3": "bags",
    ".bag": "bags",
    ".mcap": "mcap",
}
# Of tables that are parts of one log.
TABLES = (".csv", ".csv.gz", ".parquet")
PICKLES = (".pkl", ".pickle", ".pt", ".pth", ".joblib")


def recording(source: Any, *, topic: str | None = None) -> Recording:
    """Return what a source holds.

    Parameters
    ----------
    source : path, data frame or mapping from name to array
    topic : str, optional
        Handed to readers of bags.

    Raises
    ------
    FileNotFoundError
        If there is no such path.
    LogError
        If it is no format that is read.
    TypeError
        If it is none of these.
    """
    from skat.logs.readers import memory

    if (
        isinstance(source, Mapping)
        and source
        and all(isinstance(value, str | Path) for value in source.values())
    ):
        return _tables(
            {str(name): Path(path) for name, path in source.items()}, ", ".join(map(str, source.values()))
        )
    if memory.is_frame(source) or isinstance(source, Mapping):
        return memory.read(source)
    if not isinstance(source, str | Path) and not hasattr(source, "__fspath__"):
        raise TypeError(
            f"a log is a path, a data frame, or a mapping from names to arrays; got {type(source).__name__}. Files "
            f"that are read: {FORMATS}."
        )
    path = Path(source)
    if not path.exists():
        raise FileNotFoundError(f"There is no log {path} (looked in {Path.cwd()}). Check the path.")
    if path.is_dir() and (tables := _tables_in(path)):
        return _tables(tables, str(path), folder=True)
    kind = folder_kind(path) if path.is_dir() else file_kind(path)
    return READERS[kind](path, topic)


def _tables_in(path: Path) -> dict[str, Path]:
    """Return the tables in a folder by their names; none where it holds anything else that is a log."""
    known = [path / "meta", path / "data", path / "metadata.json", path / "metadata.yaml"]
    if any(one.exists() for one in known):
        return {}
    tables: dict[str, Path] = {}
    for file in sorted(path.iterdir()):
        ending = next((one for one in TABLES if file.name.lower().endswith(one)), None)
        if ending is None or not file.is_file():
            continue
        name = file.name[: -len(ending)]
        if name in tables:
            raise LogError(
                str(path),
                f"holds {tables[name].name} and {file.name}, two tables of one name.",
                "Give one of them another name, or take it out.",
            )
        tables[name] = file
    return tables


def _tables(paths: dict[str, Path], where: str, *, folder: bool = False) -> Recording:
    """Return the recording of several tables, each a stream with its own clock."""
    streams: list[Stream] = []
    notes: list[str] = []
    left_out: dict[str, str] = {}
    for name, path in paths.items():
        record = recording(path)
        stream = record.streams[0]
        notes += [f"{path.name}: {note}" for note in record.notes]
        left_out |= {f"{name}.{array}": why for array, why in record.left_out.items()}
        columns = {f"{name}.{column}": column for column in stream.columns}

        def read(
            wanted: Sequence[str], stream: Stream = stream, columns: dict[str, str] = columns
        ) -> dict[str, np.ndarray]:
            found = stream.read([columns[one] for one in wanted])
            return {one: found[columns[one]] for one in wanted}

        labels = {f"{name}.{column}": label for column, label in stream.labels.items()}
        streams.append(Stream(name, tuple(columns), read, _placed(path, stream), labels))
    shapes = {
        tuple(column.removeprefix(f"{stream.name}.") for column in stream.columns) for stream in streams
    }
    if folder and len(streams) > 1 and len(shapes) == 1:
        raise LogError(
            where,
            f"holds {len(streams)} tables of the same columns.",
            "They are read as parts of one log, taken at the same time; give runs one by one, each a log.",
        )
    return Recording(where, tuple(streams), notes=tuple(notes), left_out=left_out)


def _placed(path: Path, stream: Stream) -> Callable[[int], str]:
    return lambda row: f"{path.name}, {stream.place(row)}"


def folder_kind(path: Path) -> str:
    """Return which reader a folder needs, by what is in it."""
    if (path / "meta" / "info.json").is_file():
        return "lerobot"
    if (path / "data" / "metadata.json").is_file() or (path / "metadata.json").is_file():
        return "minari"
    if (path / "metadata.yaml").is_file() or any(path.glob("*.db3")):
        return "bags"
    if any(path.glob("*.mcap")):
        return "bags"
    if any(path.glob("data/**/*.parquet")):
        raise LogError(
            str(path),
            "has data/*.parquet but no meta/info.json: a LeRobot data set without its description.",
            "Copy the folder meta too; or give one of the .parquet files.",
        )
    inside = ", ".join(sorted(file.name for file in path.iterdir())[:6]) or "nothing"
    raise LogError(
        str(path), f"is a folder of no known kind; it holds {inside}.", f"Formats that are read: {FORMATS}."
    )


def file_kind(path: Path) -> str:
    """Return which reader a file needs, by its first bytes."""
    try:
        with path.open("rb") as file:
            head = file.read(512)
    except OSError as error:
        raise LogError(str(path), f"cannot be read: {error.strerror}.", "Check its permissions.") from None
    for magic, kind in MAGIC:
        if head.startswith(magic):
            return "torch" if kind == "npz" and torch.is_torch(path) else kind
    if path.suffix.lower() in PICKLES or head[:2] in (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05"):
        raise LogError(
            str(path),
            "is a pickle, which can run any program when it is loaded, and is not read.",
            f"Write it as one of: {FORMATS}.",
        )
    if path.suffix.lower() in ENDINGS and head:
        return ENDINGS[path.suffix.lower()]
    if b"\0" in head and head[:2] != b"\x1f\x8b":
        if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise LogError(str(path), "is text in UTF-16.", "Save it as CSV in UTF-8.")
        raise LogError(str(path), "is in no format that is read.", f"Formats that are read: {FORMATS}.")
    if head.lstrip()[:1] in (b"{", b"["):
        raise LogError(str(path), "is JSON, which is not read.", f"Write it as one of: {FORMATS}.")
    return "csv"


def _csv(path: Path, topic: str | None) -> Recording:
    from skat.logs.readers import csv

    return csv.read(path)


def _parquet(path: Path, topic: str | None) -> Recording:
    from skat.logs.readers import parquet

    return parquet.read(path)


def _npz(path: Path, topic: str | None) -> Recording:
    from skat.logs.readers import npz

    return npz.read(path)


def _torch(path: Path, topic: str | None) -> Recording:
    return torch.read(path)


def _hdf5(path: Path, topic: str | None) -> Recording:
    from skat.logs.readers import hdf5

    return hdf5.read(path, topic)


def _bags(path: Path, topic: str | None) -> Recording:
    from skat.logs.readers import bags

    return bags.read(path)


def _mcap(path: Path, topic: str | None) -> Recording:
    from skat.logs.readers import mcap

    return mcap.read(path)


def _lerobot(path: Path, topic: str | None) -> Recording:
    from skat.logs.readers import lerobot

    return lerobot.read(path)


def _minari(path: Path, topic: str | None) -> Recording:
    from skat.logs.readers import minari

    return minari.read(path)


READERS = {
    "csv": _csv,
    "parquet": _parquet,
    "npz": _npz,
    "npy": _npz,
    "torch": _torch,
    "hdf5": _hdf5,
    "bags": _bags,
    "mcap": _mcap,
    "lerobot": _lerobot,
    "minari": _minari,
}
