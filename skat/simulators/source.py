"""Models as text: reading them from a path, XML text or MjSpec, and writing them without loss of digits."""

import ctypes
import json
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Self

import mujoco

from skat.simulators.derived import write_down

FULL_PRECISION = 17
# Beside a model, what MJCF cannot express of it.
NOTES = ".effects.json"
# What refers to files that no element of the parsed model names.
ELSEWHERE = re.compile(r"<(include|attach|model|flexcomp[^>]*\sfile)\b")


@dataclass(frozen=True)
class ModelSource:
    """MJCF text with the files it refers to: all that a simulator holds of a model, so that it pickles.

    Attributes
    ----------
    xml : str
    assets : mapping from file name to bytes
    """

    xml: str
    assets: Mapping[str, bytes] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<MJCF, {len(self.xml)} characters, {len(self.assets)} assets>"

    def __deepcopy__(self, memo: dict) -> Self:
        return self

    def spec(self) -> mujoco.MjSpec:
        """Return a new MjSpec."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return mujoco.MjSpec.from_string(self.xml, assets=dict(self.assets))


def read_source(model: Any) -> ModelSource:
    """Return the text and assets of a model given as a path, XML text, MjSpec or ModelSource.

    Raises
    ------
    FileNotFoundError
        If the file, or a file that it refers to, does not exist.
    TypeError
        If the model is none of these.
    ValueError
        If MuJoCo cannot read it; with MuJoCo's message.
    """
    if isinstance(model, ModelSource):
        return model
    source = _read(model)
    try:
        spec = source.spec()
        write_down(spec)
        spec.compile()  # MuJoCo's warnings are heard here, and only here
    except ValueError as error:
        raise broken_model("the model", error) from None
    return source


def _read(model: Any) -> ModelSource:
    if isinstance(model, mujoco.MjSpec):
        return _source_of_spec(model.copy(), Path(model.modelfiledir or "."))
    if not isinstance(model, str | PathLike):
        raise TypeError(f"model must be a path, MJCF text or a mujoco.MjSpec; got {type(model).__name__}")
    if isinstance(model, str) and "<" in model:
        spec = _parsed(lambda: mujoco.MjSpec.from_string(model), "the MJCF text")
        return ModelSource(model) if _stands_alone(spec, model) else _source_of_spec(spec, Path("."))
    path = Path(model)
    _warn_of_notes(path.with_suffix(NOTES))
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no model file {str(path)!r} (looked in {Path.cwd()}); give the path of an MJCF "
            f"file, or MJCF text"
        )
    spec = _parsed(lambda: mujoco.MjSpec.from_file(str(path)), f"the model {str(path)!r}")
    text = path.read_text(encoding="utf-8", errors="replace")
    return ModelSource(text) if _stands_alone(spec, text) else _source_of_spec(spec, path.parent)


def _warn_of_notes(path: Path) -> None:
    """Say that effects that MJCF cannot express stand beside a model, and are not read with it."""
    try:
        values = {one["name"]: one["value"] for one in json.loads(path.read_text())["effects"]}
    except (OSError, ValueError, KeyError, TypeError):
        return
    warnings.warn(
        f"{path} holds effects that this model had and that MJCF cannot express; they are not read with it. Build them "
        f"in: simulator.extended({values}).",
        UserWarning,
        stacklevel=5,
    )


def broken_model(what: str, error: Exception) -> ValueError:
    """Return the error for a model that MuJoCo refuses."""
    message = " ".join(str(error).split())
    return ValueError(
        f"MuJoCo cannot read {what}: {message}. Correct the MJCF there; MuJoCo's XML reference lists it"
    )


def write_xml(spec: mujoco.MjSpec) -> str:
    """Return the spec as MJCF with all digits, so that reading it back gives the same numbers."""
    with _full_precision():
        return spec.to_xml()


def _parsed(read: Any, what: str) -> mujoco.MjSpec:
    try:
        return read()
    except ValueError as error:
        raise broken_model(what, error) from None


def _stands_alone(spec: mujoco.MjSpec, text: str) -> bool:
    files = [*spec.meshes, *spec.hfields, *spec.textures, *spec.skins]
    return "<mujoco" in text and not ELSEWHERE.search(text) and not any(_files_of(asset) for asset in files)


def _files_of(asset: Any) -> list[str]:
    return [name for name in [asset.file, *getattr(asset, "cubefiles", [])] if name]


def _source_of_spec(spec: mujoco.MjSpec, folder: Path) -> ModelSource:
    """Return the source with every file that the spec refers to under a name of its own."""
    assets: dict[str, bytes] = {}
    given = dict(spec.assets)
    kinds = ((spec.meshdir, spec.meshes), (spec.meshdir, spec.hfields), (spec.texturedir, spec.textures))
    for subfolder, elements in (*kinds, (spec.meshdir, spec.skins)):
        for asset in elements:
            if asset.file:
                file = Path(asset.file).name if spec.strippath else asset.file
                asset.file = _stored(assets, given, folder, subfolder, file)
            if any(getattr(asset, "cubefiles", [])):
                asset.cubefiles = [
                    name and _stored(assets, given, folder, subfolder, name) for name in asset.cubefiles
                ]
    spec.meshdir = spec.texturedir = ""
    spec.assets = assets
    return ModelSource(write_xml(spec), assets)


def _stored(
    assets: dict[str, bytes], given: Mapping[str, bytes], folder: Path, subfolder: str, name: str
) -> str:
    for key in (name, str(Path(subfolder) / name), Path(name).name):
        if key in given:
            content = given[key]
            break
    else:
        path = folder / subfolder / name
        if not path.is_file():
            raise FileNotFoundError(f"the model refers to the file {name!r}, which is not at {str(path)!r}")
        content = path.read_bytes()
    for index in range(len(assets) + 1):
        unique = f"{Path(name).stem}{'_' + str(index) if index else ''}{Path(name).suffix}"
        if assets.get(unique, content) == content:
            assets[unique] = content
            return unique
    raise AssertionError("unreachable: one of n + 1 names is free among n")


@contextmanager
def _full_precision() -> Iterator[None]:
    """Have MuJoCo write XML with 17 digits instead of 6; it offers that to C programs only."""
    library = _library()
    if library is None:
        warnings.warn(
            "this build of MuJoCo writes XML with 6 digits only: the written model is rounded", stacklevel=4
        )
        yield
        return
    previous = library._mjPRIVATE__get_xml_precision()
    library._mjPRIVATE__set_xml_precision(FULL_PRECISION)
    try:
        yield
    finally:
        library._mjPRIVATE__set_xml_precision(previous)


def _library() -> Any:
    folder = Path(mujoco.__file__).parent
    for path in [
        *folder.glob("libmujoco*.so*"),
        *folder.glob("libmujoco*.dylib"),
        *folder.glob("mujoco.dll"),
    ]:
        library = ctypes.CDLL(str(path))
        if hasattr(library, "_mjPRIVATE__set_xml_precision"):
            return library
    return None
