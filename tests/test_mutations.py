"""The script that changes lines changes one at a time, and draws them by the commit."""

import ast
import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = '''def spread(x: int = 3, *, least=1.0):
    """Return -1 or more than 2 * x."""
    if x < 0 and not least:
        raise ValueError(f"x must be above {-1 + 1}")
    high = max(x, 2)
    return -high ** 2 @ x
'''


@pytest.fixture(scope="module")
def script():
    return runpy.run_path(str(ROOT / "benchmarks" / "mutations.py"))


def test_each_mutation_changes_one_line_and_is_python(script):
    lines = SOURCE.splitlines()
    for number, changes in script["mutations"]("x.py", SOURCE).items():
        for change in changes:
            changed = change.source.splitlines()
            assert [
                k + 1 for k, pair in enumerate(zip(lines, changed, strict=True)) if pair[0] != pair[1]
            ] == [number]
            assert ast.dump(ast.parse(change.source)) != ast.dump(ast.parse(SOURCE))


def test_numbers_signs_operators_and_names_are_changed_and_texts_are_not(script):
    found = script["mutations"]("x.py", SOURCE)
    assert sorted(found) == [1, 3, 5, 6]
    assert {(m.before, m.after) for m in found[1]} == {("3", "(4)"), ("1.0", "(2.0)")}
    assert {m.after for m in found[3]} == {"(x < 0 or not least)", "(x <= 0)", "(least)", "(1)"}
    assert {m.after for m in found[5]} == {"(min)", "(3)"}


def test_the_seed_draws_the_lines(script):
    first, again, other = (script["drawn"](ROOT, seed, 20, ["gaussian"]) for seed in ("a", "a", "b"))
    assert first == again != other
    assert len({(each.path, each.line) for each in first}) == 20


def test_every_module_of_the_core_has_tests(script):
    modules = [file.relative_to(ROOT) for file in (ROOT / "skat").rglob("*.py")]
    core = [module for module in modules if not script["NOT_NUMERICAL"] & set(module.parts)]
    assert len(core) > 30
    for module in core:
        assert (ROOT / script["folder_of_tests"](str(module), ROOT)).exists()


def run_in_script(code):
    """Return what lines print as JSON that are run as those of the script, in a process that may be forked."""
    path = ROOT / "benchmarks" / "mutations.py"
    head = f"import runpy\nglobals().update(runpy.run_path({str(path)!r}))\n"
    told = subprocess.run([sys.executable, "-c", head + code], capture_output=True, text=True, timeout=300)
    assert told.returncode == 0, told.stderr
    return json.loads(told.stdout)


forks = pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork on Windows")

MODULE = """SHIFT = 2


def shifted(x):
    if x > 0:
        return x + (
            SHIFT * 1
        )
    return x - SHIFT


def other(x):
    return x * 3
"""


@forks
def test_files_that_reach_a_line_are_found_quick_ones_first(script, tmp_path):
    (tmp_path / "skat").mkdir()
    (tmp_path / "skat" / "__init__.py").write_text("")
    (tmp_path / "skat" / "moves.py").write_text(MODULE)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_up.py").write_text(
        "from skat.moves import shifted\n\n\ndef test_up():\n    assert shifted(1) == 3\n"
    )
    (tmp_path / "tests" / "test_slow.py").write_text(
        "import time\n\nfrom skat.moves import shifted\n\n\n"
        "def test_up_and_down():\n    time.sleep(0.3)\n    assert shifted(2) == 4\n    assert shifted(-1) == -3\n"
    )
    reached = script["Reached"](
        **run_in_script(
            f"reached = reached(Path({str(tmp_path)!r}), 'tests')\n"
            "print(json.dumps({'seconds': reached.seconds, 'lines': reached.lines}))"
        )
    )
    drawn = script["mutations"]("skat/moves.py", MODULE)

    def files(line, **limit):
        return [file.removeprefix("tests/test_") for file in reached.files(drawn[line][0], **limit)]

    assert files(1) == ["up.py", "slow.py"]
    assert files(7) == ["up.py", "slow.py"]
    assert files(9) == ["slow.py"]
    assert files(13) == []
    # What takes too long together is left out, but not all.
    assert files(7, seconds=0.2) == ["up.py"]
    assert files(9, seconds=0.2) == ["slow.py"]
    kept = tmp_path / "found.txt"
    script["_keep"](kept, "a", {"tests": reached})
    assert script["_kept"](kept, "a") == {"tests": reached}
    assert script["_kept"](kept, "b") == {}


def test_a_run_goes_on_from_what_its_file_has_and_refuses_that_of_another_commit(script, tmp_path):
    path = tmp_path / "found.txt"
    first = script["Report"](path, "commit a")
    first.say("caught   skat/x.py:1: 1 -> (2)")
    again = script["Report"](path, "commit a")
    again.say("caught   skat/x.py:1: 1 -> (2)")
    assert again.lines == first.lines == path.read_text().splitlines()
    with pytest.raises(SystemExit, match="commit b; name another file"):
        script["Report"](path, "commit b")


@pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")
def test_what_outlasts_its_limit_is_ended_with_all_that_it_started(tmp_path):
    (tmp_path / "test_it.py").write_text(
        "import subprocess, sys, time\n"
        "def test_it():\n"
        "    child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(300)'])\n"
        "    open('child', 'w').write(str(child.pid))\n"
        "    time.sleep(300)\n"
    )
    # The clock of the script is past the limit once there is what was started.
    code = (
        f"place = Path({str(tmp_path)!r})\n"
        "clock, child = time.monotonic, place / 'child'\n"
        "time.monotonic = lambda: clock() + (1000 if child.exists() and child.read_text() else 0)\n"
        "print(Run(place, ['test_it.py'], 1000).wait())"
    )
    assert run_in_script(code) == 124
    child = Path("/proc") / (tmp_path / "child").read_text()
    assert not child.exists() or "Z" in (child / "stat").read_text().split()[2]


@forks
def test_each_run_loads_the_changed_module_anew_and_the_copy_is_left_as_it_was(tmp_path):
    (tmp_path / "skat").mkdir()
    (tmp_path / "skat" / "__init__.py").write_text("")
    (tmp_path / "skat" / "moves.py").write_text(MODULE)
    (tmp_path / "test_it.py").write_text(
        "from skat.moves import other\n\n\ndef test_it():\n    assert other(2) == 6\n"
    )
    code = (
        f"place = Path({str(tmp_path)!r})\n"
        "by_line = mutations('skat/moves.py', (place / 'skat/moves.py').read_text())\n"
        "chosen = [by_line[line][0] for line in (9, 13, 1)]\n"
        "begun = lambda mutation, place: Run(place, ['test_it.py'], 100)\n"
        "print(json.dumps([(each.line, code) for each, code in tried(chosen, [place], begun)]))"
    )
    assert run_in_script(code) == [[9, 0], [13, 1], [1, 0]]
    assert (tmp_path / "skat" / "moves.py").read_text() == MODULE
