"""Values of a diagnosis in one file: JSON that names what it holds, and arrays as NumPy writes them.

A file holds data only. Classes are those of `CLASSES`, arrays hold numbers or text, and nothing that is read is run: no
pickle, no import by name. An effect, which knows functions, is written as its numbers and read as that of the simulator
at hand; a simulator within values is the one at hand.
"""

import base64
import hashlib
import json
import math
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from skat.diagnosis import (
    causes,
    chains,
    evidence,
    filtering,
    findings,
    fits,
    fitting,
    found,
    log,
    noise,
    posterior,
    prediction,
    remainder,
    search,
    smoothing,
    statespace,
)
from skat.diagnosis.report import content, from_diagnosis
from skat.effects import Effect
from skat.files import whole
from skat.simulators import Simulator
from skat.simulators.source import ModelSource

# Of the file as a whole; what the classes hold may differ between versions of skat, and is checked as they are read.
FORMAT = 1
CONTENT = "content.json"
# Arrays of at most so many bytes stand within the JSON: sets of causes have thousands of small ones.
SMALL = 1024


@dataclass(frozen=True)
class EffectRecord:
    """What can be written of an effect."""

    name: str
    unit: str
    neutral: float
    bounds: tuple[float, float]
    typical: float
    odds: float
    force_share: float | None
    aliases: tuple[str, ...]

    @classmethod
    def of(cls, effect: Effect) -> "EffectRecord":
        """Return the record of an effect."""
        return cls(**{one.name: getattr(effect, one.name) for one in fields(cls)})

    def is_like(self, effect: Effect) -> bool:
        """Whether values of an effect mean what they did."""
        numbers = zip((self.neutral, *self.bounds), (effect.neutral, *effect.bounds))
        return self.unit == effect.unit and all(
            math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-12) for one, other in numbers
        )

    def revived(self, known: Mapping[str, Effect]) -> Effect:
        """Return the effect of this name, with the prior that was written."""
        same = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "name"}
        return replace(known[self.name], **same)


def _classes(*modules: ModuleType) -> dict[str, type]:
    return {
        f"{module.__name__.rpartition('.')[2]}.{name}": value
        for module in modules
        for name, value in vars(module).items()
        if is_dataclass(value)
        and isinstance(value, type)
        and value.__module__ == module.__name__
        and not name.startswith("_")
    }


# What a file may hold, by the name that it has there.
CLASSES: Mapping[str, type] = MappingProxyType(
    {
        **_classes(
            causes, chains, evidence, filtering, findings, fits, fitting, found, log, noise, posterior
        ),
        **_classes(prediction, remainder, search, smoothing, statespace, content, from_diagnosis),
        "archive.EffectRecord": EffectRecord,
        "source.ModelSource": ModelSource,
    }
)
_NAMES = {one: name for name, one in CLASSES.items()}


def write_archive(path: Path, kind: str, parts: Mapping[str, Any]) -> None:
    """Write values into a file, as a whole or not at all.

    Parameters
    ----------
    path : Path
        One that exists is replaced.
    kind : str
        What the file is.
    parts : mapping from name to value

    Raises
    ------
    TypeError
        If a value is of a class that is not written.
    """
    with whole(path) as draft, zipfile.ZipFile(draft, "w") as archive:

        def put(array: NDArray[Any], place: int) -> str:
            name = f"{place}.npy"
            with archive.open(name, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, array, allow_pickle=False)
            return name

        encoder = _Encoder(put)
        text = json.dumps(
            {
                "kind": kind,
                "format": FORMAT,
                "skat": skat_version(),
                "parts": {name: encoder.encoded(value, name) for name, value in parts.items()},
            },
            allow_nan=False,
            separators=(",", ":"),
        )
        archive.writestr(zipfile.ZipInfo(CONTENT), text, zipfile.ZIP_DEFLATED)


def digest(value: Any) -> str:
    """Return the SHA-256 of what would be written of a value."""
    encoder = _Encoder(
        lambda array, _: hashlib.sha256(array.dtype.str.encode() + array.tobytes()).hexdigest()
    )
    return hashlib.sha256(json.dumps(encoder.encoded(value, "value"), allow_nan=False).encode()).hexdigest()


def skat_version() -> str:
    """Return the version of skat that runs."""
    try:
        return version("skat")
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "unknown"


class Archive:
    """A file that `write_archive` wrote, open to be read.

    Attributes
    ----------
    skat : str
        Version that wrote it.
    """

    def __init__(self, path: Path, file: zipfile.ZipFile, text: Mapping[str, Any]) -> None:
        self.skat = str(text["skat"])
        self._path, self._file, self._parts = path, file, text["parts"]
        self._arrays: dict[str, NDArray[Any]] = {}

    def read(self, name: str, simulator: Simulator | None = None) -> Any:
        """Return a value.

        Parameters
        ----------
        name : str
        simulator : Simulator, optional
            That effects and simulators within it are of.

        Raises
        ------
        ValueError
            If the file is damaged, or was written by a version of skat whose classes hold something else.
        """
        known = {} if simulator is None else {one.name: one for one in simulator.effects(also="all")}
        with _readable(self._path, self.skat):
            return self._decoded(self._parts[name], simulator, known)

    def _decoded(self, written: Any, simulator: Simulator | None, known: Mapping[str, Effect]) -> Any:
        def decoded(inner: Any) -> Any:
            return self._decoded(inner, simulator, known)

        if isinstance(written, list):
            return [decoded(one) for one in written]
        if not isinstance(written, dict):
            return written
        kind = written["is"]
        if kind == "float":
            return float(written["value"])
        if kind == "tuple":
            return tuple(decoded(one) for one in written["items"])
        if kind == "dict":
            return {decoded(key): decoded(value) for key, value in written["items"]}
        if kind == "array":
            return self._array(written)
        if kind == "bytes":
            return self._array(written["array"]).tobytes()
        if kind == "frame":
            return _frame(decoded(written["columns"]), decoded(written["index"]), decoded(written["name"]))
        if kind == "random":
            random_state = np.random.RandomState()
            random_state.set_state(decoded(written["state"]))
            return random_state
        if kind == "simulator":
            return simulator
        if kind == "effect":
            return decoded(written["record"]).revived(known)
        return CLASSES[kind](**{name: decoded(value) for name, value in written["fields"].items()})

    def _array(self, written: Mapping[str, Any]) -> NDArray[Any]:
        if "file" not in written:
            dtype = np.dtype(written["dtype"])
            if dtype.hasobject:
                raise ValueError("an array of objects")
            small: NDArray[Any] = np.frombuffer(base64.b64decode(written["bytes"]), dtype)
            return small.reshape(written["shape"]).copy()
        name = written["file"]
        if name not in self._arrays:
            with self._file.open(name) as file:
                self._arrays[name] = np.lib.format.read_array(file, allow_pickle=False)
                if file.read():  # to its end, where its checksum is looked at
                    raise ValueError(f"{name} is longer than its array")
        return self._arrays[name]


@contextmanager
def opened(path: Path, kind: str) -> Iterator[Archive]:
    """Yield a file that `write_archive` wrote.

    Parameters
    ----------
    path : Path
    kind : str
        What the file has to be.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is something else, damaged, or in another format.
    """
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}.")
    if not zipfile.is_zipfile(path):
        raise ValueError(f"{path} is no {kind} that skat wrote, or only a part of one.")
    try:
        opened_file = zipfile.ZipFile(path)
    except zipfile.BadZipFile as error:
        raise ValueError(
            f"{path} cannot be read: {error}. It is damaged; use a copy, or fit anew."
        ) from error
    with opened_file as file:
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
    """Turn whatever a damaged file leads to into one error.

    Raises
    ------
    ValueError
    """
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


class _Encoder:
    """Values as JSON; what is larger than `SMALL` goes where `put` says, once however often it occurs."""

    def __init__(self, put: Callable[[NDArray[Any], int], str]) -> None:
        self._put = put
        # With the arrays themselves, so that no other one can get the identity of one that is gone.
        self._placed: dict[int, tuple[str, NDArray[Any]]] = {}

    def encoded(self, value: Any, where: str) -> Any:
        """Return what JSON has for a value; `where` it stands is for messages."""
        if value is None or isinstance(value, bool | np.bool_):
            return None if value is None else bool(value)
        if isinstance(value, str):
            return str(value)
        if isinstance(value, int | np.integer):
            return int(value)
        if isinstance(value, float | np.floating):
            return float(value) if math.isfinite(value) else {"is": "float", "value": str(float(value))}
        if isinstance(value, set | frozenset):
            value = sorted(value, key=str)
        elif isinstance(value, pd.Index | pd.Series) or (
            isinstance(value, np.ndarray) and value.dtype.hasobject
        ):
            value = value.tolist()
        if isinstance(value, list):
            return [self.encoded(one, where) for one in value]
        if isinstance(value, tuple):
            return {"is": "tuple", "items": [self.encoded(one, where) for one in value]}
        if isinstance(value, Mapping):
            items = [
                [self.encoded(key, where), self.encoded(one, f"{where}[{key!r}]")]
                for key, one in value.items()
            ]
            return {"is": "dict", "items": items}
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            return self._array(value)
        if isinstance(value, bytes):
            return {"is": "bytes", "array": self._array(np.frombuffer(value, np.uint8))}
        if isinstance(value, pd.DataFrame):
            columns = {str(name): _column(value[name]) for name in value.columns}
            return {
                "is": "frame",
                "columns": self.encoded(columns, where),
                "index": self.encoded(_column(value.index), where),
                "name": self.encoded(value.index.name, where),
            }
        if isinstance(value, np.random.RandomState):
            return {"is": "random", "state": self.encoded(value.get_state(legacy=False), where)}
        if isinstance(value, Simulator):
            return {"is": "simulator"}
        if isinstance(value, Effect):
            return {"is": "effect", "record": self.encoded(EffectRecord.of(value), where)}
        name = _NAMES.get(type(value))
        if name is None:
            raise TypeError(f"{where} is a {type(value).__name__}, which cannot be saved: {value!r:.200}")
        return {
            "is": name,
            "fields": {
                one.name: self.encoded(getattr(value, one.name), f"{where}.{one.name}")
                for one in fields(value)
            },
        }

    def _array(self, array: NDArray[Any]) -> dict[str, Any]:
        if array.nbytes <= SMALL:
            return {
                "is": "array",
                "dtype": array.dtype.str,
                "shape": list(array.shape),
                "bytes": base64.b64encode(array.tobytes()).decode(),
            }
        if id(array) not in self._placed:
            self._placed[id(array)] = self._put(array, len(self._placed)), array
        return {"is": "array", "shape": list(array.shape), "file": self._placed[id(array)][0]}


def _column(values: Any) -> dict[str, Any]:
    numeric = values.dtype.kind in "biuf"
    return {"dtype": str(values.dtype), "values": values.to_numpy() if numeric else values.tolist()}


def _frame(columns: Mapping[str, Any], index: Mapping[str, Any], name: Any) -> pd.DataFrame:
    rows = pd.Index(index["values"], dtype=index["dtype"], name=name)
    series = {key: pd.Series(one["values"], index=rows, dtype=one["dtype"]) for key, one in columns.items()}
    return pd.DataFrame(series, index=rows)


__all__ = ["CLASSES", "Archive", "EffectRecord", "digest", "opened", "skat_version", "write_archive"]
