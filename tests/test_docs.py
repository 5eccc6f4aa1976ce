"""What stands on the pages of the documentation runs, and what they point to exists."""

import ast
import doctest
import importlib
import inspect
import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skat.cli import app
from tests.diagnosis.pages import blank_frames
from tests.stated_defaults import modules_of, untrue_defaults

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [
    path
    for path in sorted(DOCS.rglob("*.rst"))
    if not {"generated", "gallery", "_build", "_templates"} & set(path.relative_to(DOCS).parts)
]
WITH_EXAMPLES = [path for path in PAGES if ">>>" in path.read_text("utf-8")]
COMMANDS = {
    path: re.findall(r"^ +\$ skat (.*)$", path.read_text("utf-8"), re.MULTILINE)
    for path in [DOCS / "tutorial.rst", *sorted((DOCS / "how_to").glob("*.rst"))]
}
# A short log of a robot with the model's own time step, and one effect, is enough to see that a page's lines run.
QUICK = {"timestep": 0.002, "n_episodes": 6, "n_rows": 25}
SHORTER = {
    "changed": ["--effect", "mass[lower]", "--effect", "gain[elbow]"],
    "diagnose": ["--effect", "dry_friction[elbow]", "--test-size", "0"],
    "preflight": ["--effect", "dry_friction[elbow]"],
    "check": ["--no-preflight"],
}
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


# A diagnosis by way of a cluster's scheduler.
LONG = {"cluster.rst"}


@pytest.fixture
def arm(tmp_path, monkeypatch):
    """The folder that the tutorial and the how-to pages work in."""
    pytest.importorskip("rosbags")
    pytest.importorskip("pyarrow")
    runpy.run_path(str(DOCS / "arm_logs.py"))["write"](tmp_path, **QUICK)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("skat.replay.frames", blank_frames)


@pytest.mark.filterwarnings("ignore:The positions lag:UserWarning")
@pytest.mark.filterwarnings("ignore::DeprecationWarning:distributed")
@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=pytest.mark.long if path.name in LONG else ()) for path in WITH_EXAMPLES],
    ids=lambda path: str(path.relative_to(DOCS)),
)
def test_commands_and_examples_of_a_page_do_what_it_says(path, request, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # what a page writes is not left in the tree
    if ".xml" in path.read_text("utf-8") and path in COMMANDS:
        request.getfixturevalue("arm")
    for command in COMMANDS.get(path, []):
        name, *words = shlex.split(command)
        done = CliRunner().invoke(app, [name, *words, *SHORTER[name]])
        assert done.exit_code == 0, f"{command}\n{done.output}"
    if path.name in NEEDS_A_PROCESS:
        code = f"from tests.test_docs import *; said = run(Path({str(path)!r})); sys.exit(said or 0)"
        done = subprocess.run(
            [sys.executable, "-c", code],
            cwd=tmp_path,
            env={**os.environ, "SCIPY_ARRAY_API": "1", "PYTHONPATH": str(ROOT)},
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


PUBLIC = [
    "skat",
    *(f"skat.{part}" for part in ("transport", "metrics", "simulators", "diagnosis", "datasets", "logs")),
]
PUBLIC += ["skat.experiments", "skat.plotting"]
REFERENCE = re.findall(r"^   ([\w.]+)$", (DOCS / "reference.rst").read_text("utf-8"), re.MULTILINE)


@pytest.mark.parametrize("module", PUBLIC)
def test_reference_has_every_public_name(module):
    listed = {name.rpartition(".")[2] for name in REFERENCE}
    public = {name for name in importlib.import_module(module).__all__ if not name.startswith("__")}
    assert public <= listed


# What numpydoc asks for and these docstrings leave out on purpose: a "See Also" (SA), an example and a longer text
# (EX01, ES01) for everything; a word on what X, y or a returned array obviously is (PR01, PR02, PR07, RT01 to RT03);
# order and types where parameters share a line (PR03, PR04).
NOT_ASKED = {"SA01", "SA03", "EX01", "ES01", "PR01", "PR02", "PR03", "PR04", "PR07", "RT01", "RT02", "RT03"}


@pytest.mark.parametrize("name", REFERENCE)
def test_docstrings_of_the_reference_are_valid_numpydoc(name):
    validate = pytest.importorskip("numpydoc.validate").validate
    module, _, attribute = f"skat.{name}".rpartition(".")
    found = getattr(importlib.import_module(module), attribute)
    members = vars(found) if inspect.isclass(found) else {}
    parts = [
        member
        for member, value in members.items()
        if not member.startswith("_") and (inspect.isfunction(value) or isinstance(value, property))
    ]
    for target in (f"skat.{name}", *(f"skat.{name}.{part}" for part in parts)):
        errors = [error for error in validate(target)["errors"] if error[0] not in NOT_ASKED]
        assert not errors, f"{target}: {errors}"


# Whose own tests say so.
FOLDERS = "datasets|diagnosis|experiments|gaussian|logs|metrics|replay|simulators|transport"


@pytest.mark.parametrize(
    "module", [name for name in modules_of("skat") if not re.match(rf"skat\.({FOLDERS})\b", name)]
)
def test_defaults_are_those_of_the_docstrings(module):
    assert not untrue_defaults(module)


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("plot_*.py")), ids=lambda path: path.name)
def test_thumbnails_of_the_gallery_show_an_effect_and_no_lone_interval(path):
    text = path.read_text("utf-8")
    drawn = re.findall(r"\b(\w+Display)\.from_|(?:plt|pyplot)\.(subplots)\(", text)
    chosen = re.search(r"^# sphinx_gallery_thumbnail_number = (\d+)$", text, re.MULTILINE)
    display, _ = drawn[int(chosen[1]) - 1 if chosen else 0]
    assert display != "CauseDisplay"
