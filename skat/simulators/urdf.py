"""URDF in and out: read as MuJoCo does, with every link kept; written back with only the changed elements edited."""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import mujoco
import numpy as np

# What a URDF says of a model, and what a compiler derives from that.
HELD_OF_JOINTS = ("dof_damping", "dof_frictionloss")
HELD = {
    *("body_mass", "body_inertia", "body_iquat", "body_ipos", "body_pos"),
    *HELD_OF_JOINTS,
    "actuator_forcerange",
}
DERIVED = {
    *("body_invweight0", "body_subtreemass", "body_sameframe"),
    *("dof_M0", "dof_invweight0", "dof_length", "actuator_acc0"),
}
READ_BY_MUJOCO = (".stl", ".obj", ".msh")
# Relative difference of two numbers that are meant to be one.
SAME = 1e-9


def is_urdf(text: str) -> bool:
    """Whether a text is a URDF, by its first element."""
    return (
        re.match(r"(\s|<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^>]*>)*<robot\b", text.lstrip("\ufeff"), re.DOTALL)
        is not None
    )


def spec_of_urdf(text: str, folder: Path | None) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """Return a URDF as a spec with a body for each link, and what was left aside.

    Pictures are left out, and so are collision meshes that are not there or that MuJoCo cannot read.

    Parameters
    ----------
    text : str
    folder : Path or None
        Where meshes are looked for, there and in the folders above.

    Raises
    ------
    ValueError
        If the text is no URDF that MuJoCo reads.
    """
    try:
        robot = ElementTree.fromstring(text.lstrip("\ufeff"))
    except ElementTree.ParseError as error:
        raise ValueError(f"the URDF is not well-formed XML: {error}") from None
    if "<xacro:" in text or "${" in text:
        raise ValueError("the file holds xacro macros; expand it first: xacro robot.urdf.xacro > robot.urdf")
    links = {link.get("name") for link in robot.findall("link")}
    if "world" in {joint.parent.get("link") for joint in _joints(robot)} - links:
        robot.insert(0, ElementTree.Element("link", name="world"))
    notes: list[str] = []
    assets: dict[str, bytes] = {}
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if mesh is None:
                continue
            path = _mesh_file(mesh.get("filename", ""), folder)
            if path is None:
                link.remove(collision)
                notes.append(
                    f"The collision mesh {mesh.get('filename')!r} of {link.get('name')} is left out: it is not there, "
                    f"or none of {', '.join(READ_BY_MUJOCO)}, which MuJoCo reads."
                )
                continue
            name = f"{len(assets)}_{path.name}"
            assets[name] = path.read_bytes()
            mesh.set("filename", name)
    _set_compiler(robot)
    return mujoco.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"), assets=assets), tuple(
        notes
    )


def says_what_its_root_is(text: str) -> bool:
    """Whether a URDF has a joint to the world, so that its root is fixed or free by what it says itself."""
    robot = ElementTree.fromstring(text.lstrip("\ufeff"))
    return any(joint.parent.get("link") == "world" for joint in _joints(robot))


def root_link(text: str) -> str:
    """Return the name of the link that is no joint's child."""
    robot = ElementTree.fromstring(text.lstrip("\ufeff"))
    children = {joint.child.get("link") for joint in _joints(robot)}
    return next(
        (str(link.get("name")) for link in robot.findall("link") if link.get("name") not in children), ""
    )


def edited_urdf(text: str, nominal: mujoco.MjModel, edited: mujoco.MjModel) -> str:
    """Return a URDF with the numbers of an edited model, all else as it is, to the letter.

    Masses, inertias, centres of mass, places of joints, damping, dry friction and effort limits are compared; an
    element is edited where they differ.

    Parameters
    ----------
    text : str
        The URDF that `nominal` is the model of.
    nominal, edited : mujoco.MjModel
        With a body for each link, before and after.
    """
    source = text.encode()
    document = _Document(source)
    edits: list[tuple[int, int, bytes]] = []
    for link in document.all("link"):
        edits += _link_edits(source, link, nominal, edited)
    for joint in document.all("joint"):
        if joint.child("parent") is not None:
            edits += _joint_edits(source, joint, nominal, edited)
    for start, end, replacement in sorted(edits, reverse=True):
        source = source[:start] + replacement + source[end:]
    return source.decode()


@dataclass(frozen=True)
class _Joint:
    element: ElementTree.Element
    parent: ElementTree.Element
    child: ElementTree.Element


def _joints(robot: ElementTree.Element) -> Iterator[_Joint]:
    for element in robot.findall("joint"):
        parent, child = element.find("parent"), element.find("child")
        if parent is not None and child is not None:
            yield _Joint(element, parent, child)


def _mesh_file(name: str, folder: Path | None) -> Path | None:
    """Return where a mesh is, looked for from the URDF's folder upwards, as packages are laid out."""
    inner = re.sub(r"^(package|file|model)://", "", name)
    if Path(inner).suffix.lower() not in READ_BY_MUJOCO:
        return None
    start = Path.cwd() if folder is None else folder.resolve()
    # The package's name stands first; where its folder has another name, what follows still leads to the file.
    for relative in (inner, inner.partition("/")[2]):
        for place in (start, *list(start.parents)[:4]):
            if relative and (place / relative).is_file():
                return place / relative
    return None


def _set_compiler(robot: ElementTree.Element) -> None:
    extension = robot.find("mujoco")
    extension = ElementTree.SubElement(robot, "mujoco") if extension is None else extension
    compiler = extension.find("compiler")
    compiler = ElementTree.SubElement(extension, "compiler") if compiler is None else compiler
    compiler.attrib |= {"fusestatic": "false", "discardvisual": "false", "strippath": "false"}
    compiler.attrib.pop("meshdir", None)


# -- writing back --------------------------------------------------------------------------------------------------


@dataclass
class _Element:
    """An element of a document with the places of its tags, in bytes."""

    name: str
    attributes: Mapping[str, str]
    start: int
    end_of_tag: int = 0
    close: int = 0
    children: "list[_Element]" = field(default_factory=list)

    def child(self, *path: str) -> "_Element | None":
        found: _Element | None = self
        for name in path:
            found = next((one for one in found.children if one.name == name), None) if found else None
        return found


class _Document:
    def __init__(self, source: bytes):
        self._stack = [_Element("", {}, 0)]
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._begin
        self._parser.EndElementHandler = self._end
        self._source = source
        self._parser.Parse(source, True)

    def all(self, name: str) -> list[_Element]:
        """Return the elements of this name right below the root."""
        return [one for one in self._stack[0].children[0].children if one.name == name]

    def _begin(self, name: str, attributes: dict[str, str]) -> None:
        start = self._parser.CurrentByteIndex
        element = _Element(name, attributes, start, _end_of_tag(self._source, start))
        self._stack[-1].children.append(element)
        self._stack.append(element)

    def _end(self, name: str) -> None:
        self._stack.pop().close = self._parser.CurrentByteIndex


def _end_of_tag(source: bytes, start: int) -> int:
    found = re.compile(rb"<(\"[^\"]*\"|'[^']*'|[^>\"'])*>").match(source, start)
    assert found is not None, "expat has read this tag"
    return found.end()


def _link_edits(
    source: bytes, link: _Element, nominal: mujoco.MjModel, edited: mujoco.MjModel
) -> Iterator[tuple[int, int, bytes]]:
    body, inertial = _id(nominal, mujoco.mjtObj.mjOBJ_BODY, link), link.child("inertial")
    if body <= 0:
        return
    if inertial is None:  # the compiler has it from the shapes
        if _differ(nominal.body_mass[body], edited.body_mass[body]) or _differ(
            _tensor(nominal, body), _tensor(edited, body)
        ):
            yield link.end_of_tag, link.end_of_tag, _inertial(edited, body).encode()
        return
    mass, tensor, origin = (inertial.child(name) for name in ("mass", "inertia", "origin"))
    if mass is not None and _differ(nominal.body_mass[body], edited.body_mass[body]):
        yield _with(source, mass, value=_text(edited.body_mass[body]))
    before, after = _tensor(nominal, body), _tensor(edited, body)
    if tensor is not None and _differ(before, after):
        rpy = origin.attributes.get("rpy", "0 0 0") if origin is not None else "0 0 0"
        turn = _rotation([float(angle) for angle in rpy.split()])
        own = turn.T @ after @ turn
        parts = {f"i{'xyz'[i]}{'xyz'[j]}": _text(own[i, j]) for i in range(3) for j in range(i, 3)}
        yield _with(source, tensor, **parts)
    if _differ(nominal.body_ipos[body], edited.body_ipos[body]):
        yield from _moved(source, inertial, origin, edited.body_ipos[body])


def _inertial(model: mujoco.MjModel, body: int) -> str:
    place, tensor = " ".join(map(_text, model.body_ipos[body])), _tensor(model, body)
    parts = " ".join(f'i{"xyz"[i]}{"xyz"[j]}="{_text(tensor[i, j])}"' for i in range(3) for j in range(i, 3))
    mass = _text(model.body_mass[body])
    return f'\n    <inertial><origin xyz="{place}"/><mass value="{mass}"/><inertia {parts}/></inertial>'


def _joint_edits(
    source: bytes, joint: _Element, nominal: mujoco.MjModel, edited: mujoco.MjModel
) -> Iterator[tuple[int, int, bytes]]:
    child = joint.child("child")
    name = child.attributes.get("link", "") if child is not None else ""
    body = mujoco.mj_name2id(nominal, mujoco.mjtObj.mjOBJ_BODY, name)
    if body > 0 and _differ(nominal.body_pos[body], edited.body_pos[body]):
        yield from _moved(source, joint, joint.child("origin"), edited.body_pos[body])
    index = _id(nominal, mujoco.mjtObj.mjOBJ_JOINT, joint)
    if index < 0:
        return
    dof = nominal.jnt_dofadr[index]
    changed = {}
    for attribute, field_name in (("damping", "dof_damping"), ("friction", "dof_frictionloss")):
        before, after = (float(getattr(model, field_name)[dof]) for model in (nominal, edited))
        if _differ(before, after):
            changed[attribute] = _text(after)
    dynamics, limit = joint.child("dynamics"), joint.child("limit")
    if changed and dynamics is not None:
        yield _with(source, dynamics, **changed)
    elif changed:
        words = " ".join(f'{name}="{value}"' for name, value in changed.items())
        yield joint.close, joint.close, f"  <dynamics {words}/>\n  ".encode()
    drives = [nominal.actuator_trnid[i, 0] == index for i in range(nominal.nu)]
    for actuator in np.flatnonzero(drives):
        before, after = (model.actuator_forcerange[actuator, 1] for model in (nominal, edited))
        if limit is not None and _differ(before, after):
            yield _with(source, limit, effort=_text(after))


def _moved(
    source: bytes, parent: _Element, origin: _Element | None, place: np.ndarray
) -> Iterator[tuple[int, int, bytes]]:
    xyz = " ".join(map(_text, place))
    if origin is not None:
        yield _with(source, origin, xyz=xyz)
    else:
        yield parent.end_of_tag, parent.end_of_tag, f'\n    <origin xyz="{xyz}"/>'.encode()


def _with(source: bytes, element: _Element, **values: str) -> tuple[int, int, bytes]:
    """Return the edit that gives an element's tag other attributes."""
    tag = source[element.start : element.end_of_tag].decode()
    for name, value in values.items():
        tag, found = re.subn(rf"(\s{name}\s*=\s*)(\"[^\"]*\"|'[^']*')", rf'\g<1>"{value}"', tag)
        if not found:
            tag = re.sub(r"\s*(/?>)$", rf' {name}="{value}"\1', tag)
    return element.start, element.end_of_tag, tag.encode()


def _id(model: mujoco.MjModel, kind: mujoco.mjtObj, element: _Element) -> int:
    return int(mujoco.mj_name2id(model, kind, element.attributes.get("name", "")))


def _tensor(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Return the rotational inertia about the centre of mass, along the axes of the link."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    axes = turn.reshape(3, 3)
    return axes @ np.diag(model.body_inertia[body]) @ axes.T


def _rotation(rpy: list[float]) -> np.ndarray:
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    rotation: np.ndarray = yaw @ pitch @ roll
    return rotation


def _differ(first: np.ndarray | float, second: np.ndarray | float) -> bool:
    scale = max(float(np.max(np.abs(first))), float(np.max(np.abs(second))))
    return bool(np.max(np.abs(np.asarray(first) - second)) > SAME * scale)


def _text(value: float) -> str:
    return repr(float(value))
