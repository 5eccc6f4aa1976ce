"""What stands on the pages of the documentation runs, and what they point to exists."""

import ast
import doctest
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [
    path
    for path in sorted(DOCS.rglob("*.rst"))
    if not {"generated", "gallery", "_build", "_templates"} & set(path.relative_to(DOCS).parts)
]
WITH_EXAMPLES = [path for path in PAGES if ">>>" in path.read_text("utf-8")]
# Read when scikit-learn is imported, and so of no use to a process that has begun.
NEEDS_A_PROCESS = {"gpu_array.rst"}


def run(path):
    """Run the examples of a page and return the report of those that fail."""
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    text = path.read_text("utf-8")
    test = doctest.DocTestParser().get_doctest(text, {"__name__": "__main__"}, path.name, str(path), 0)
    said = []
    doctest.DocTestRunner(optionflags=flags, verbose=False).run(test, out=said.append)
    return "".join(said)


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=lambda path: str(path.relative_to(DOCS)))
def test_examples_of_a_page_print_what_it_says(path):
    if path.name in NEEDS_A_PROCESS:
        code = f"from tests.test_docs import *; said = run(Path({str(path)!r})); sys.exit(said or 0)"
        done = subprocess.run(
            [sys.executable, "-c", code],
            cwd=ROOT,
            env={**os.environ, "SCIPY_ARRAY_API": "1"},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
    else:
        assert run(path) == ""


def test_every_how_to_has_examples_that_run():
    assert {path.name for path in (DOCS / "how_to").glob("*.rst")} - {"index.rst"} <= {
        path.name for path in WITH_EXAMPLES
    }


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(DOCS)))
def test_tests_and_files_that_a_page_names_exist(path):
    text = path.read_text("utf-8")
    for file, name in re.findall(r"``(tests/[\w/]+\.py)::(\w+)``", text):
        functions = {
            node.name
            for node in ast.walk(ast.parse((ROOT / file).read_text("utf-8")))
            if isinstance(node, ast.FunctionDef)
        }
        assert name in functions, f"{path.name} names {file}::{name}"
    for file in re.findall(r"``((?:benchmarks|examples|tests|docs)/[\w/]+\.\w+)``", text):
        assert (ROOT / file).exists(), f"{path.name} names {file}"


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("plot_*.py")), ids=lambda path: path.name)
def test_thumbnails_of_the_gallery_show_an_effect_and_no_lone_interval(path):
    text = path.read_text("utf-8")
    drawn = re.findall(r"\b(\w+Display)\.from_|(?:plt|pyplot)\.(subplots)\(", text)
    chosen = re.search(r"^# sphinx_gallery_thumbnail_number = (\d+)$", text, re.MULTILINE)
    display, _ = drawn[int(chosen[1]) - 1 if chosen else 0]
    assert display != "CauseDisplay"
