"""Models as text: reading them from a path, XML text or MjSpec, and writing them without loss of digits."""

import ctypes
import json
import os
import posixpath
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
# MuJoCo's words for a file that it does not find.
MISSING = re.compile(r"Error opening file '(.*?)'")


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

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
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
        return _source_of_spec(model.copy())
    if not isinstance(model, str | PathLike):
        raise TypeError(f"model must be a path, MJCF text or a mujoco.MjSpec; got {type(model).__name__}")
    if isinstance(model, str) and "<" in model:
        spec = _parsed(lambda: mujoco.MjSpec.from_string(model), "the MJCF text")
        return ModelSource(model) if _stands_alone(spec, model) else _source_of_spec(spec)
    path = Path(model)
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no model file {str(model)!r} (looked in {Path.cwd()}); give the path of an MJCF "
            f"file, or MJCF text"
        )
    _warn_of_notes(path.with_suffix(NOTES))
    spec = _parsed(lambda: mujoco.MjSpec.from_file(str(path)), f"the model {str(path)!r}")
    text = path.read_text(encoding="utf-8", errors="replace")
    return ModelSource(text) if _stands_alone(spec, text) else _source_of_spec(spec)


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
    return "<mujoco" in text and not ELSEWHERE.search(text) and not any(map(_files_of, _assets_of(spec)))


def _assets_of(spec: mujoco.MjSpec) -> list[Any]:
    return [*spec.meshes, *spec.hfields, *spec.textures, *spec.skins]


def _files_of(asset: Any) -> list[str]:
    return [name for name in [asset.file, *getattr(asset, "cubefiles", [])] if name]


def _source_of_spec(spec: mujoco.MjSpec) -> ModelSource:
    """Return the source with every file that the spec refers to under a name of its own."""
    assets: dict[str, bytes] = {}
    given = {posixpath.normpath(name): content for name, content in spec.assets.items()}
    paths, sides = _paths(spec), [_paths(spec, side) for side in range(6)]
    for index, asset in enumerate(_assets_of(spec)):
        if asset.file:
            asset.file = _stored(assets, given, paths[index])
        if any(getattr(asset, "cubefiles", [])):
            asset.cubefiles = [
                name and _stored(assets, given, sides[side][index])
                for side, name in enumerate(asset.cubefiles)
            ]
    for texture in spec.textures:
        texture.embed = mujoco.mjtEmbed.mjEMBED_AUTO  # MuJoCo refuses references to what is not on the disk
    spec.meshdir = spec.texturedir = ""
    spec.assets = assets
    return ModelSource(write_xml(spec), assets)


def _paths(spec: mujoco.MjSpec, side: int | None = None) -> list[str]:
    """Return where the compiler finds the file of each asset, or of that side of each cube; nothing if none has one.

    An attached model has folders of its own, which the spec does not tell and the compiled model does.
    """
    spec = spec.copy()
    if side is None:
        named = [asset for asset in _assets_of(spec) if asset.file]
    else:  # of a cube, the compiled model tells one file only: this side's is made that one
        named = [texture for texture in spec.textures if any(texture.cubefiles) and texture.cubefiles[side]]
        for texture in named:
            texture.file, texture.cubefiles = texture.cubefiles[side], [""] * 6
    if not named:
        return []
    spec.compiler.discardvisual = False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = spec.compile()
    except ValueError as error:
        missing = MISSING.search(str(error))
        if missing is None:
            raise broken_model("the model", error) from None
        raise FileNotFoundError(
            f"the model refers to the file {missing[1]!r}, which is not there. It is looked for from the folder of the "
            f"MJCF file that names it; from {Path.cwd()}, if MJCF text names it"
        ) from None
    starts = (model.mesh_pathadr, model.hfield_pathadr, model.tex_pathadr, model.skin_pathadr)
    return [_text_at(model.paths, int(start)) for kind in starts for start in kind]


def _text_at(characters: bytes, start: int) -> str:
    return "" if start < 0 else os.fsdecode(characters[start : characters.index(b"\0", start)])


def _stored(assets: dict[str, bytes], given: Mapping[str, bytes], path: str) -> str:
    content, name = _content(given, path), Path(path)
    for index in range(len(assets) + 1):
        unique = f"{name.stem}{'_' + str(index) if index else ''}{name.suffix}"
        if assets.get(unique, content) == content:
            assets[unique] = content
            return unique
    raise AssertionError("unreachable: one of n + 1 names is free among n")


def _content(given: Mapping[str, bytes], path: str) -> bytes:
    """Return what MuJoCo reads at a path: the given file of this path, then of this name in any case, then the disk."""
    if path in given:
        return given[path]
    alike = [name for name in given if Path(name).name.lower() == Path(path).name.lower()]
    if len({given[name] for name in alike}) > 1:
        raise ValueError(
            f"the model refers to the file {path!r}; its assets hold several of this name, {', '.join(sorted(alike))}, "
            f"and none with this path. Name the one that is meant {path!r} in spec.assets"
        )
    if alike:
        return given[alike[0]]
    if not Path(path).is_file():
        raise FileNotFoundError(
            f"the model refers to the file {path!r}, which is not there (looked in {Path.cwd()})"
        )
    return Path(path).read_bytes()


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
