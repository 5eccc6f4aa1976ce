"""The picture of the architecture is the one that the imports give."""

import runpy
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"


@pytest.fixture(scope="module")
def script():
    return runpy.run_path(str(DOCS / "architecture.py"))


@pytest.fixture(scope="module")
def imports(script):
    """What each part imports: every module of the package is read for it."""
    return script["imports_of_parts"]()


def test_picture_is_that_of_the_imports(script, imports):
    drawn = (DOCS / "_static" / "architecture.svg").read_text("utf-8")
    assert drawn == script["drawing"](imports), "run python docs/architecture.py"


def test_picture_has_a_box_for_each_part(script, imports):
    svg = ElementTree.fromstring(script["drawing"](imports))
    names = [text.text for text in svg.iter("{http://www.w3.org/2000/svg}text")]
    assert sorted(names) == sorted(imports)
    assert {"diagnosis", "simulators", "effects"} <= set(names)


def test_every_part_stands_above_what_it_imports(script, imports):
    level = {name: n for n, row in enumerate(script["layers"](imports)) for name in row}
    assert all(level[near] < level[name] for name, nears in imports.items() for near in nears)


def test_an_arrow_that_others_imply_is_left_out(script):
    imports = {"a": set(), "b": {"a"}, "c": {"a", "b"}}
    assert script["needed_arrows"](imports) == [("b", "a"), ("c", "b")]


def test_a_circle_is_an_error_that_names_its_parts(script):
    with pytest.raises(ValueError, match="in a circle: a, b"):
        script["layers"]({"a": {"b"}, "b": {"a"}, "c": set()})
