"""What differs between two models as MJCF, attribute by attribute."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from skat.diagnosis.report.content import Change

if TYPE_CHECKING:
    from collections.abc import Iterator
    from xml.etree.ElementTree import Element

# Digits of a number, where it is not changed by less.
READABLE = 6


def model_changes(nominal: Any, extended: Any) -> tuple[tuple[Change, ...], tuple[str, ...]]:
    """Return what differs between the MJCF of two simulators, and in words what MJCF cannot express.

    `nominal`, `extended`: those that are not written as MJCF have no changes.
    """
    if not (hasattr(nominal, "to_mjcf") and hasattr(extended, "to_mjcf")):
        return (), ()
    with TemporaryDirectory() as folder:
        texts: list[str] = []
        beside: tuple[str, ...] = ()
        for number, simulator in enumerate((nominal, extended)):
            # Each in a folder of its own, for its assets.
            path = Path(folder, str(number), "model.xml")
            path.parent.mkdir()
            simulator.to_mjcf(path)
            texts.append(path.read_text(encoding="utf-8"))
            beside = _beside(path.with_suffix(".effects.json"))
    return mjcf_changes(*texts), beside


def mjcf_changes(before: str, after: str) -> tuple[Change, ...]:
    """Return what differs between two texts of MJCF.

    `before`, `after`: elements belong together that have the same tag and name in the same parent; without names, the
    same place among those of their tag. Returns: in the order of the elements.

    Examples
    --------
    >>> one = '<mujoco><worldbody><body name="leg"><joint name="knee"/></body></worldbody></mujoco>'
    >>> mjcf_changes(one, one.replace('name="knee"', 'name="knee" damping="0.5"'))
    (Change(element='joint "knee"', attribute='damping', before=None, after='0.5'),)
    """
    return tuple(_changes(ElementTree.fromstring(before), ElementTree.fromstring(after), "mujoco"))


def _changes(before: Element, after: Element, label: str) -> Iterator[Change]:
    for name in dict.fromkeys([*before.attrib, *after.attrib]):
        values = before.get(name), after.get(name)
        if values[0] != values[1]:
            yield Change(label, name, *_readable(*values))
    children, others = _children(before), _children(after)
    for key in dict.fromkeys([*children, *others]):
        one, other = children.get(key), others.get(key)
        inner = _label(key, label)
        if one is not None and other is not None:
            yield from _changes(one, other, inner)
        else:
            yield Change(inner, "", _whole(one), _whole(other))


def _children(element: Element) -> dict[tuple[str, str, int], Element]:
    """Return the children by tag, name, and place among those that share both."""
    found: dict[tuple[str, str, int], Element] = {}
    for child in element:
        tag, name = child.tag, child.get("name") or child.get("class") or ""
        place = sum(1 for key in found if key[:2] == (tag, name))
        found[tag, name, place] = child
    return found


def _label(key: tuple[str, str, int], parent: str) -> str:
    tag, name, place = key
    if name:
        return f'{tag} "{name}"'
    number = "" if place == 0 else f" {place + 1}"
    return f"{tag}{number}" if parent == "mujoco" else f"{tag}{number} of {parent}"


def _whole(element: Element | None) -> str | None:
    if element is None:
        return None
    return " ".join(f'{name}="{_readable(value, None)[0]}"' for name, value in element.attrib.items())


def _readable(before: str | None, after: str | None) -> tuple[str | None, str | None]:
    """Return two attributes with fewer digits, unless they would become the same."""
    short = tuple(None if text is None else " ".join(map(_short, text.split())) for text in (before, after))
    return (before, after) if short[0] == short[1] else (short[0], short[1])


def _short(token: str) -> str:
    try:
        return f"{float(token):.{READABLE}g}"
    except ValueError:
        return token


def _beside(path: Path) -> tuple[str, ...]:
    if not path.exists():
        return ()
    notes = json.loads(path.read_text(encoding="utf-8"))
    said = [f"{one['name']}: {one['meaning']}." for one in notes.get("effects", ())]
    said += [f"{name} is written as {value:g}." for name, value in notes.get("written rounded", {}).items()]
    return tuple(said)
