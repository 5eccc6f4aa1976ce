"""The numbers that the page of numbers states, and those that the code has."""

import ast
import csv
import importlib
import re
import textwrap
from collections.abc import Mapping
from functools import cache
from numbers import Real
from pathlib import Path

import numpy as np

from tests.stated_defaults import CODE, modules_of

PAGE = Path(__file__).parents[1] / "docs" / "numbers.rst"


def modules_with_numbers(package, *, but=" "):
    """Return a package's modules that have numbers in the code or on the page; not those whose names begin so."""
    code = {name for name in modules_of(package) if names_of_numbers(name) and not name.startswith(but)}
    page = {name for name in numbers_of_the_page() if f"{name}.".startswith(f"{package}.")}
    return sorted(code | page)


def misses(module):
    """Return a sentence for each number in which a module and the page differ."""
    code, page = numbers_of_the_code(module), numbers_of_the_page().get(module, {})
    changed = [
        f"{module}.{name} is {code[name]!r}, and docs/numbers.rst says {page[name]!r}: if the change is meant, "
        "write the new value there, and where it comes from"
        for name in code.keys() & page.keys()
        if code[name] != page[name]
    ]
    new = [
        f"{module}.{name} = {code[name]!r} is not on docs/numbers.rst: give it a row in the table of {module}, with "
        "unit, purpose and source"
        for name in code.keys() - page.keys()
    ]
    gone = [
        f"docs/numbers.rst has {module}.{name}, and the code does not: delete its row"
        for name in page.keys() - code.keys()
    ]
    return sorted(changed + new + gone)


def numbers_of_the_code(module):
    """Return the numbers that a module names in capitals, by name."""
    values = {}
    for name in names_of_numbers(module):
        owner = importlib.import_module(module)
        for part in name.split("."):
            owner = getattr(owner, part)
        if _has_numbers(owner):
            values[name] = _plain(owner)
    return values


@cache
def names_of_numbers(module):
    """Return what a module assigns, itself or in a class, to names in capitals and may have numbers.

    Not those of MuJoCo's enumerations, and not what is made of other numbers alone.
    """
    path = CODE.joinpath(*module.split(".")[1:])
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    tree = ast.parse(path.read_text("utf-8"))
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    return [
        prefix + target.id
        for prefix, body in (("", tree.body), *((f"{one.name}.", one.body) for one in classes))
        for node in body
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value and _may_be_numbers(node.value)
        for one in (node.targets if isinstance(node, ast.Assign) else [node.target])
        for target in ast.walk(one)
        if isinstance(target, ast.Name) and target.id.isupper()
    ]


def _may_be_numbers(value):
    nodes = list(ast.walk(value))
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    literal = any(isinstance(node, ast.Constant) and _has_numbers(node.value) for node in nodes)
    return "mujoco" not in names and (literal or not names.isdisjoint({"np", "math"}))


def _has_numbers(value):
    if isinstance(value, Mapping):
        return _has_numbers(tuple(value.items()))
    if isinstance(value, tuple | list | np.ndarray):
        return any(_has_numbers(one) for one in value)
    return isinstance(value, Real) and not isinstance(value, bool)


def _plain(value):
    """Return a value with arrays as lists, and without functions."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, tuple | list):
        return type(value)(_plain(one) for one in value if not callable(one))
    return value


@cache
def tables():
    """Return the rows of the page's tables, by the table's title."""
    parts = re.split(r"^\.\. csv-table:: (.+)\n", PAGE.read_text("utf-8"), flags=re.MULTILINE)
    found = {}
    for title, part in zip(parts[1::2], parts[2::2]):
        lines = part.partition("\n\n")[2].partition("\n\n")[0].splitlines()
        found[title] = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter="|")]
    return found


def number(cell):
    """Return what a cell of a table says, such as ``2**17`` or ``np.pi / 180``; None of an empty one."""
    return _plain(eval(cell.strip("`"), {"np": np})) if cell else None


@cache
def numbers_of_the_page():
    """Return the numbers of each module that the page has: rows of a table, or Python that is too long for one."""
    found = {
        title: {name: number(value) for name, value, *_ in rows}
        for title, rows in tables().items()
        if title.startswith("skat.")
    }
    long = r"^\.\. code-block:: python\n   :caption: (skat\.\S+)\n\n((?:   .*\n|\n)+)"
    for module, code in re.findall(long, PAGE.read_text("utf-8"), re.MULTILINE):
        for node in ast.parse(textwrap.dedent(code)).body:
            found.setdefault(module, {})[node.targets[0].id] = number(ast.unparse(node.value))
    return found
