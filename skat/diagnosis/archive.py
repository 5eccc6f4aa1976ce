"""Values of a diagnosis in one file: JSON that names what it holds, and arrays as NumPy writes them.

A file holds data only. Classes are the frozen records of the diagnosis, arrays hold numbers or text, and nothing that
is read is run: no pickle, no import by name. An effect, which knows functions, is written as its numbers and read as
that of the simulator at hand; a simulator within values is the one at hand.
"""

import hashlib
import json
import math
import sys
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from skat.effects import Effect
from skat.files import whole
from skat.simulators import Simulator
from skat.simulators.source import ModelSource

# Of the file as a whole; what the classes hold may differ between versions of skat, and is checked as they are read.
FORMAT = 2
CONTENT = "content.json"
_RECORD = ("name", "unit", "neutral", "bounds", "typical", "odds", "force_share", "aliases")


def classes() -> dict[str, type]:
    """Return the classes that a file may hold, by the name that they have there."""
    found: dict[str, type] = {"ModelSource": ModelSource}
    for module, content in list(sys.modules.items()):
        if module.startswith("skat.diagnosis."):
            for name, value in vars(content).items():
                if is_dataclass(value) and isinstance(value, type) and value.__module__ == module:
                    found[f"{module.removeprefix('skat.diagnosis.')}.{name}"] = value
    return found


def bare(effect: Effect) -> Effect:
    """Return what can be written of an effect: all but its functions."""
    return Effect(**{name: getattr(effect, name) for name in _RECORD})


def write_archive(path: Path, kind: str, parts: Mapping[str, Any]) -> None:
    """Write values by name into a file that says of which kind it is, as a whole or not at all, over one that exists.

    Raises a TypeError if a value is of a class that is not written.
    """
    blocks: dict[str, list[NDArray[Any]]] = {}
    # With the arrays themselves, so that no other one can get the identity of one that is gone.
    placed: dict[int, tuple[dict[str, Any], NDArray[Any]]] = {}

    lengths: Counter[str] = Counter()

    def put(array: NDArray[Any]) -> dict[str, Any]:
        dtype = array.dtype.str
        if id(array) not in placed:
            where = {"is": "array", "dtype": dtype, "at": lengths[dtype], "shape": list(array.shape)}
            placed[id(array)] = where, array
            blocks.setdefault(dtype, []).append(array.ravel())
            lengths[dtype] += array.size
        return placed[id(array)][0]

    encode = _encoder(put)
    text = {
        "kind": kind,
        "format": FORMAT,
        "skat": skat_version(),
        "parts": {name: encode(value, name) for name, value in parts.items()},
        "blocks": list(blocks),
    }
    with whole(path) as draft, zipfile.ZipFile(draft, "w") as archive:
        for number, block in enumerate(blocks.values()):
            with archive.open(f"{number}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.concatenate(block), allow_pickle=False)
        written = json.dumps(text, allow_nan=False, separators=(",", ":"))
        archive.writestr(zipfile.ZipInfo(CONTENT), written, zipfile.ZIP_DEFLATED)


def digest(value: Any) -> str:
    """Return the SHA-256 of what would be written of a value."""

    def put(array: NDArray[Any]) -> str:
        return hashlib.sha256(f"{array.dtype.str}{array.shape}".encode() + array.tobytes()).hexdigest()

    encode = _encoder(put)
    return hashlib.sha256(json.dumps(encode(value, "value"), allow_nan=False).encode()).hexdigest()


def skat_version() -> str:
    """Return the version of skat that runs."""
    try:
        return version("skat")
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "unknown"


class Archive:
    """A file that `write_archive` wrote, open to be read; `skat` is the version that wrote it."""

    def __init__(self, path: Path, file: zipfile.ZipFile, text: Mapping[str, Any]) -> None:
        self.skat = str(text["skat"])
        self._path, self._file, self._text = path, file, text
        self._blocks: dict[str, NDArray[Any]] = {}

    def read(self, name: str, simulator: Simulator | None = None) -> Any:
        """Return a value; effects and simulators within it are of the simulator.

        Raises a ValueError if the file is damaged, or was written by a version of skat whose classes hold something
        else.
        """
        effects = {} if simulator is None else {one.name: one for one in simulator.effects(also="all")}
        known = classes()

        def decoded(written: Any) -> Any:
            if isinstance(written, list):
                return [decoded(one) for one in written]
            if not isinstance(written, dict):
                return written
            kind, inner = (
                written.get("is"),
                {name: decoded(one) for name, one in written.items() if name != "is"},
            )
            if kind is None:
                return inner
            return make[kind](**inner) if kind in make else known[kind](**inner["fields"])

        def effect(record: Mapping[str, Any]) -> Effect:
            own = effects.get(record["name"])
            return Effect(**record) if own is None else replace(own, **record)

        make: Mapping[str, Callable[..., Any]] = {
            "float": lambda value: float(value),
            "tuple": lambda items: tuple(items),
            "dict": lambda items: dict(items),
            "array": self._array,
            "bytes": lambda array: array.tobytes(),
            "frame": _frame,
            "random": _generator,
            "simulator": lambda: simulator,
            "effect": effect,
        }
        with _readable(self._path, self.skat):
            return decoded(self._text["parts"][name])

    def _array(self, dtype: str, at: int, shape: list[int]) -> NDArray[Any]:
        if dtype not in self._blocks:
            with self._file.open(f"{self._text['blocks'].index(dtype)}.npy") as file:
                self._blocks[dtype] = np.lib.format.read_array(file, allow_pickle=False)
                if file.read():  # to its end, where its checksum is looked at
                    raise ValueError("a block is longer than its array")
        return self._blocks[dtype][at : at + math.prod(shape)].reshape(shape)


@contextmanager
def opened(path: Path, kind: str) -> Iterator[Archive]:
    """Yield a file that `write_archive` wrote, of a kind.

    Raises a FileNotFoundError if there is no such file. Raises a ValueError if it is something else, damaged, or in
    another format.
    """
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}.")
    if not zipfile.is_zipfile(path):
        raise ValueError(f"{path} is no {kind} that skat wrote, or only a part of one.")
    with _readable(path, "unknown"):
        file = zipfile.ZipFile(path)
    with file:
        with _readable(path, "unknown"):
            text = json.loads(file.read(CONTENT))
            found = text["kind"], text["format"], text["skat"]
        if found[0] != kind:
            raise ValueError(f"{path} is a {found[0]}; expected a {kind}.")
        if found[1] != FORMAT:
            raise ValueError(
                f"{path} has the format {found[1]}, of skat {found[2]}; this is skat {skat_version()}, which reads "
                f"the format {FORMAT}. Read it with that version, or fit anew."
            )
        yield Archive(path, file, text)


@contextmanager
def _readable(path: Path, skat: str) -> Iterator[None]:
    """Turn whatever a damaged file leads to into one ValueError."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(
            f"{path} cannot be read: {reason}. It is damaged, or of a version of skat that saves other things: "
            f"written by {skat}, read by {skat_version()}."
        ) from error


def _encoder(put: Callable[[NDArray[Any]], Any]) -> Callable[[Any, str], Any]:
    """Return what makes JSON of a value, whose arrays go where `put` says; where it stands is for messages."""
    names = {one: name for name, one in classes().items()}

    def encode(value: Any, where: str) -> Any:
        def made(kind: str, **inner: Any) -> dict[str, Any]:
            return {"is": kind, **{name: encode(one, where) for name, one in inner.items()}}

        if isinstance(value, np.generic):
            value = value.item()
        elif isinstance(value, set | frozenset):
            value = sorted(value, key=str)
        elif isinstance(value, pd.Index | pd.Series) or (
            isinstance(value, np.ndarray) and value.dtype.hasobject
        ):
            value = value.tolist()
        if isinstance(value, float) and not math.isfinite(value):
            return made("float", value=str(value))
        if value is None or isinstance(value, bool | int | float | str):
            return value
        if isinstance(value, list):
            return [encode(one, where) for one in value]
        if isinstance(value, tuple):
            return made("tuple", items=list(value))
        if isinstance(value, Mapping):
            items = [[encode(key, where), encode(one, f"{where}[{key!r}]")] for key, one in value.items()]
            return {"is": "dict", "items": items}
        if isinstance(value, np.ndarray):
            return put(value)
        if isinstance(value, bytes):
            return made("bytes", array=np.frombuffer(value, np.uint8))
        if isinstance(value, pd.DataFrame):
            columns = {str(name): _column(value[name]) for name in value.columns}
            return made("frame", columns=columns, index=_column(value.index), name=value.index.name)
        if isinstance(value, np.random.RandomState):
            return made("random", state=value.get_state(legacy=False))
        if isinstance(value, Simulator):
            return made("simulator")
        if isinstance(value, Effect):
            return made("effect", record={name: getattr(value, name) for name in _RECORD})
        if type(value) not in names:
            raise TypeError(f"{where} is a {type(value).__name__}, which cannot be saved: {value!r:.200}")
        inner = {one.name: encode(getattr(value, one.name), f"{where}.{one.name}") for one in fields(value)}
        return {"is": names[type(value)], "fields": inner}

    return encode


def _generator(state: dict[str, Any]) -> np.random.RandomState:
    random_state = np.random.RandomState()
    random_state.set_state(state)
    return random_state


def _column(values: Any) -> dict[str, Any]:
    numeric = values.dtype.kind in "biuf"
    return {"dtype": str(values.dtype), "values": values.to_numpy() if numeric else values.tolist()}


def _frame(columns: Mapping[str, Any], index: Mapping[str, Any], name: Any) -> pd.DataFrame:
    rows = pd.Index(index["values"], dtype=index["dtype"], name=name)
    series = {key: pd.Series(one["values"], index=rows, dtype=one["dtype"]) for key, one in columns.items()}
    return pd.DataFrame(series, index=rows)
