"""Models as text: reading them from a path, XML text or MjSpec, and writing them without loss of digits."""

import ctypes
import json
import os
import posixpath
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import mujoco
import numpy as np

from skat.simulators.derived import write_down
from skat.simulators.urdf import SAME, is_urdf, spec_of_urdf

FULL_PRECISION = 17
# Beside a model, what MJCF cannot express of it.
NOTES = ".effects.json"
# What refers to files that no element of the parsed model names.
ELSEWHERE = re.compile(r"<(include|attach|model|flexcomp[^>]*\sfile)\b")
# In what two models may differ that are the same otherwise.
UNLIKE = frozenset(
    {
        "signature",
        "paths",
        "mesh_pathadr",
        "hfield_pathadr",
        "tex_pathadr",
        "skin_pathadr",
        "npaths",
        "nbuffer",
    }
)
# MuJoCo's words for a file that it does not find.
MISSING = re.compile(r"Error opening file '(.*?)'")


@dataclass(frozen=True)
class ModelSource:
    """MJCF text with the files it refers to: all that a simulator holds of a model, so that it pickles.

    Attributes
    ----------
    xml : str
    assets : mapping from file name to bytes
    urdf : str or None
        The URDF that it was read from.
    motors : str or None
        Those that were added to it; see `skat.simulators.furnishing`.
    notes : tuple of str
        What was chosen, added or left out as it was read.
    """

    xml: str
    assets: Mapping[str, bytes] = field(default_factory=dict)
    urdf: str | None = None
    motors: str | None = None
    notes: tuple[str, ...] = ()

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
    """Return the text and assets of a model given as a path, XML text, MjSpec, MjModel or ModelSource.

    Parameters
    ----------
    model : path, str, mujoco.MjSpec, mujoco.MjModel or ModelSource
        The last one is taken as it is.

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
    if isinstance(model, mujoco.MjModel):
        return _source_of_model(model)
    if not isinstance(model, str | PathLike):
        raise TypeError(
            f"model must be a path, MJCF or URDF text, a mujoco.MjSpec or a mujoco.MjModel; got {type(model).__name__}"
        )
    if isinstance(model, str) and "<" in model:
        if is_urdf(model):
            return _source_of_urdf(model, None, "the URDF text")
        spec = _parsed(lambda: mujoco.MjSpec.from_string(model), "the MJCF text")
        return ModelSource(model) if _stands_alone(spec, model) else _source_of_spec(spec)
    path = Path(model)
    if str(model) and path.is_dir():
        return replace(_read(chosen := model_in_folder(path)), notes=(f"The model is {chosen}.",))
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no model file {str(model)!r} (looked in {Path.cwd()}); give the path of an MJCF or URDF "
            f"file, or of a folder that holds one, or MJCF text"
        )
    text = path.read_text(encoding="utf-8", errors="replace")
    _warn_of_notes(path.with_suffix(NOTES))
    if is_urdf(text):
        return _source_of_urdf(text, path.parent, f"the URDF {str(path)!r}")
    spec = _parsed(lambda: mujoco.MjSpec.from_file(str(path)), f"the model {str(path)!r}")
    return ModelSource(text) if _stands_alone(spec, text) else _source_of_spec(spec)


def model_in_folder(folder: Path) -> Path:
    """Return the model of a robot's folder, laid out as in MuJoCo Menagerie: the robot, and a scene that includes it.

    A robot that moves freely needs the ground of its scene.

    Raises
    ------
    FileNotFoundError
        If there is no model in the folder.
    ValueError
        If there are several, and no scene says which.
    """
    models = sorted(path for path in folder.glob("*.xml") if "<mujoco" in path.read_text(errors="replace"))
    scene = folder / "scene.xml"
    included = (
        set(re.findall(r"<include\s+file=[\"']([^\"']+)", scene.read_text())) if scene in models else set()
    )
    robots = [path for path in models if path.name in included] or [path for path in models if path != scene]
    robots = robots or [*folder.glob("*.urdf"), *folder.glob("urdf/*.urdf")] or models
    if not robots:
        raise FileNotFoundError(
            f"there is no model in the folder {folder}; expected an MJCF (.xml) or URDF file in it"
        )
    if len(robots) > 1:
        names = ", ".join(path.name for path in robots)
        raise ValueError(f"the folder {folder} holds several models, {names}; give the path of one of them")
    if scene in models and re.search(
        r"<freejoint\b|type=[\"']free[\"']", robots[0].read_text(errors="replace")
    ):
        return scene
    return robots[0]


def _source_of_urdf(text: str, folder: Path | None, what: str) -> ModelSource:
    try:
        spec, notes = spec_of_urdf(text, folder)
        spec.compile()
    except ValueError as error:
        message = " ".join(str(error).split())
        raise ValueError(f"{what} cannot be read: {message}. Correct it there") from None
    return replace(_source_of_spec(spec), urdf=text, notes=notes)


def _source_of_model(model: mujoco.MjModel) -> ModelSource:
    """Return the source of the compiled model that MuJoCo read last, with the numbers that it has now.

    Raises
    ------
    ValueError
        If it is not that one: a compiled model no longer holds its MJCF.
    """
    try:
        with TemporaryDirectory() as folder, _full_precision():
            path = Path(folder, "model.xml")
            mujoco.mj_saveLastXML(str(path), model)
            source = _source_of_spec(mujoco.MjSpec.from_string(path.read_text()))
            again = source.spec().compile()
    except (mujoco.FatalError, ValueError, OSError) as error:
        differing = [" ".join(str(error).split())]
    else:
        differing = differing_fields(model, again)
    if differing:
        raise ValueError(
            "a compiled MjModel does not hold its MJCF, and this one is not the model that MuJoCo read last from XML "
            f"({', '.join(differing[:3])}): pass the path of the MJCF file, or the mujoco.MjSpec"
        )
    return source


def differing_fields(first: mujoco.MjModel, second: mujoco.MjModel) -> list[str]:
    """Return the names of what two compiled models differ in, by more than rounding."""
    if first.names != second.names:
        return ["names"]
    pairs = [
        (name, getattr(first, name), getattr(second, name))
        for name in dir(first)
        if not name.startswith("_") and isinstance(getattr(first, name), np.ndarray | int | float)
    ]
    pairs += [
        (f"opt.{name}", getattr(first.opt, name), getattr(second.opt, name))
        for name in dir(first.opt)
        if not name.startswith("_") and isinstance(getattr(first.opt, name), np.ndarray | int | float)
    ]
    return [
        name
        for name, one, other in pairs
        if name not in UNLIKE
        and (
            np.shape(one) != np.shape(other)
            or not np.allclose(one, other, rtol=SAME, atol=1e-12, equal_nan=True)
        )
    ]


def _warn_of_notes(path: Path) -> None:
    """Say that effects that MJCF cannot express stand beside a model, and are not read with it."""
    try:
        values = {one["name"]: one["value"] for one in json.loads(path.read_text())["effects"]}
    except (OSError, ValueError, KeyError, TypeError):
        return
    if not values:
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
        return str(spec.to_xml())


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
