"""Change lines of the numerical core, one at a time, and list those that its tests do not notice.

The commit's hash draws the lines and what becomes of each: a comparison, an operator, a sign, a number, min for max.
Each changed line meets the tests of its own folder, the long ones left out, in a copy of the commit; the tree itself
stays as it is. A run that fails, or takes much longer than that of the commit, has caught the change. Of a folder only
those files are run of which some test reaches the line, as a run of the commit with coverage tells; the quick ones
first, and with ``--seconds`` no slower ones than fit into so much: what these would notice counts as not noticed. A run
is a fork of this process, which has loaded the libraries, but never skat: loading them takes longer than most tests.
Some changes are none, as ``<`` for ``<=`` where equality has no chance: look at the survivors before adding a test.

    python benchmarks/mutations.py --output FILE        # 50 lines; an hour or so; ended by anybody, it goes on
    python benchmarks/mutations.py --lines 5 --only transport
"""

import argparse
import ast
import contextlib
import copy
import importlib
import io
import itertools
import json
import math
import os
import random
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
import traceback
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Beside these is what shows and reads: it has tests of its own kind.
NOT_NUMERICAL = {"cli", "plotting", "experiments", "datasets", "report", "envs"}
OTHER_WAY = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.FloorDiv: ast.Div,
    ast.Mod: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
OTHER_NAME = {
    "min": "max",
    "max": "min",
    "any": "all",
    "all": "any",
    "minimum": "maximum",
    "maximum": "minimum",
}
CAUGHT, SURVIVED = "caught  ", "SURVIVED"
# No plugin of pytest is among them: pytest rewrites the asserts of those as it loads them.
LIBRARIES = (
    "numpy",
    "scipy.optimize",
    "scipy.signal",
    "scipy.spatial",
    "scipy.stats",
    "sklearn.model_selection",
    "sklearn.pipeline",
    "pandas",
    "mujoco",
    "pytest",
)
ALONE = {"PYTHONDONTWRITEBYTECODE": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
TOO_LONG = 124
PAUSE = 0.02
ENDINGS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


@dataclass(frozen=True)
class Mutation:
    """One changed expression of one line."""

    path: str
    line: int
    before: str
    after: str
    source: str

    def __str__(self):
        return f"{self.path}:{self.line}: {self.before} -> {self.after}"


def mutations(path, source):
    """Return every change of an expression that stands on one line, by line."""
    found = {}
    tree = ast.parse(source)
    lines = source.splitlines(keepends=True)
    for node in _expressions(tree):
        if node.lineno != node.end_lineno:
            continue
        for changed in _changes(node):
            raw = lines[node.lineno - 1].encode()
            before = raw[node.col_offset : node.end_col_offset].decode()
            after = f"({ast.unparse(changed)})"
            line = raw[: node.col_offset] + after.encode() + raw[node.end_col_offset :]
            text = "".join([*lines[: node.lineno - 1], line.decode(), *lines[node.lineno :]])
            found.setdefault(node.lineno, []).append(Mutation(path, node.lineno, before, after, text))
    return found


def folder_of_tests(path, root):
    """Return the tests of a module's own folder; loose modules have a file of tests, or are the transport's."""
    _, *folders, module = Path(path).with_suffix("").parts
    for candidate in (*(f"tests/{folder}" for folder in folders), f"tests/test_{module}.py"):
        if (root / candidate).exists():
            return candidate
    return "tests/transport"


@dataclass(frozen=True)
class Reached:
    """Which lines the files of a folder of tests reach, and how long each takes.

    Attributes
    ----------
    seconds : dict of str to float
        Of each file of tests.
    lines : dict of str to dict of str to list of str
        Of each module, for each line that is run, the files whose tests reach it; none where it is run on import.
    """

    seconds: dict
    lines: dict

    def files(self, mutation, seconds=math.inf):
        """Return the files that reach a mutation, quick ones first; all, of a line that is run as it is imported.

        Only so many as take so many seconds together, but one at least.
        """
        first, last = _statement(mutation)
        own = self.lines.get(mutation.path, {})
        told = [own[str(line)] for line in range(first, last + 1) if str(line) in own]
        found = {file for files in told for file in files} or (self.seconds if told else ())
        files = sorted(found, key=lambda file: (self.seconds[file], file))
        taken = itertools.accumulate(self.seconds[file] for file in files)
        return [
            file for place, (file, so_far) in enumerate(zip(files, taken)) if not place or so_far <= seconds
        ]


def _statement(mutation):
    """Return first and last line of the innermost statement that a mutation is in, of its head where it has a body."""
    place = 1, 1
    for node in ast.walk(ast.parse(mutation.source)):
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            last = body[0].lineno - 1 if body else node.end_lineno
            if node.lineno <= mutation.line <= last and node.lineno >= place[0]:
                place = node.lineno, last
    return place


def reached(place, tests):
    """Return what the tests of a folder reach in a copy of a commit, from a run with coverage.

    Raises
    ------
    SystemExit
        If they fail.
    """
    from coverage import CoverageData

    with tempfile.TemporaryDirectory() as folder:
        data, times, told = (Path(folder) / name for name in ("coverage", "times.xml", "told.txt"))
        options = ["--cov=skat", "--cov-context=test", "--cov-report=", f"--junitxml={times}"]
        options += ["--cov-fail-under=0", "-o", "junit_family=xunit1"]
        code = Run(place, [tests, *options], 7200, told, COVERAGE_FILE=str(data)).wait()
        if code:
            last = "\n".join(told.read_text("utf-8").splitlines()[-60:])
            raise SystemExit(f"{last}\n{tests} fails (exit code {code}) before anything is changed.")
        seconds, lines = {}, {}
        for case in ET.parse(times).iter("testcase"):
            seconds[case.get("file")] = seconds.get(case.get("file"), 0.0) + float(case.get("time"))
        measured = CoverageData(str(data))
        measured.read()
        for path in measured.measured_files():
            contexts = measured.contexts_by_lineno(path)
            lines[Path(path).relative_to(place).as_posix()] = {
                str(line): sorted({one.partition("::")[0] for one in tests_of} & seconds.keys())
                for line, tests_of in contexts.items()
            }
    return Reached(seconds, lines)


def drawn(root, seed, n_lines, only=None):
    """Return one mutation of each of `n_lines` lines of the numerical core, drawn by the seed."""
    candidates = []
    for file in sorted((root / "skat").rglob("*.py")):
        path = file.relative_to(root)
        if NOT_NUMERICAL & set(path.parts) or (only and not any(piece in str(path) for piece in only)):
            continue
        candidates += mutations(str(path), file.read_text("utf-8")).values()
    generator = random.Random(seed)
    if not candidates:
        raise SystemExit(f"No line to change in a path with {only!r}.")
    return [generator.choice(line) for line in generator.sample(candidates, min(n_lines, len(candidates)))]


def tried(chosen, places, begun):
    """Yield each mutation and the exit code of its tests, as they end.

    Parameters
    ----------
    chosen : list of Mutation
    places : list of Path
        Copies of the commit; in each, one mutation at a time.
    begun : callable
        Of a mutation and the place that has it, returns a `Run`.
    """
    waiting, free, running = [*reversed(chosen)], [*places], {}
    try:
        while waiting or running:
            while waiting and free:
                place, mutation = free.pop(), waiting.pop()
                source = (place / mutation.path).read_text("utf-8")
                (place / mutation.path).write_text(mutation.source, "utf-8")
                running[place] = mutation, source, begun(mutation, place)
            time.sleep(PAUSE)
            for place, (mutation, source, run) in [*running.items()]:
                if run.ended():
                    (place / mutation.path).write_text(source, "utf-8")
                    free.append(place)
                    del running[place]
                    yield mutation, run.code
    finally:
        for _, _, run in running.values():
            run.end()


class Run:
    """Tests at work in a copy of a commit, in a fork of this process with a group of its own.

    Attributes
    ----------
    code : int or None
        How it ended, `TOO_LONG` where its limit in seconds did it; none while it is at work.
    """

    def __init__(self, place, tests, limit, output=os.devnull, **environment):
        self.code, self._own_code, self._last = None, None, time.monotonic() + limit
        sys.stdout.flush()
        self._process = os.fork()
        if not self._process:
            _test(place, tests, output, environment)
        os.setpgid(self._process, self._process)

    def ended(self):
        """Return whether it has ended, and with it all that the tests have started; past its limit, it is ended."""
        if self.code is None and (self._is_over() or time.monotonic() > self._last):
            self.code = TOO_LONG if self._own_code is None else self._own_code
            self.end()
        return self.code is not None

    def wait(self):
        """Return its exit code, once it has ended."""
        try:
            while not self.ended():
                time.sleep(PAUSE)
        finally:
            if self.code is None:
                self.end()
        return self.code

    def end(self):
        """End it, with all that the tests have started."""
        # Joblib's workers are asked to end first: its trackers, which do not heed that, then tidy up after them.
        for number in (signal.SIGTERM, signal.SIGKILL):
            until = time.monotonic() + 1
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process, number)
                while time.monotonic() < until:
                    time.sleep(PAUSE)
                    self._is_over()
                    os.killpg(self._process, 0)

    def _is_over(self):
        if self._own_code is None:
            process, status = os.waitpid(self._process, os.WNOHANG)
            if process:
                self._own_code = os.waitstatus_to_exitcode(status)
        return self._own_code is not None


def _test(place, tests, output, environment):
    """Run tests in a copy of a commit and end this process, a fork, with their exit code."""
    code = 1
    try:
        os.setpgid(0, 0)
        for number in ENDINGS:
            signal.signal(number, signal.SIG_DFL)
        _write_to(output)
        os.chdir(place)
        os.environ.update(ALONE, PYTHONPATH=str(place), **environment)
        sys.dont_write_bytecode = True
        own = ROOT, ROOT / "benchmarks"
        sys.path[:] = [str(place), *(entry for entry in sys.path if Path(entry).resolve() not in own)]
        options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:randomly", "-m", "not long"]
        code = int(importlib.import_module("pytest").main([*options, *tests]))
    except BaseException:
        traceback.print_exc()
    finally:
        # Nothing of the process that was forked is left for this one to tidy up.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _write_to(output):
    """Let this process, and what it starts, read nothing and write to a file."""
    with open(os.devnull) as nothing, open(output, "w") as file:
        os.dup2(nothing.fileno(), 0)
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)


def _load_libraries():
    os.environ.update(ALONE)
    for name in LIBRARIES:
        importlib.import_module(name)


def main():
    """Draw, try and list; what the file of the output has of this commit already is not tried again."""
    arguments = _arguments()
    if not hasattr(os, "fork"):
        raise SystemExit(
            "The runs of changed lines are forked, which Windows cannot: run this on Linux, as in WSL."
        )
    commit = _git("rev-parse", arguments.commit).decode().strip()
    report = Report(arguments.output, f"commit {commit}")
    for number in ENDINGS:
        signal.signal(number, _ended)
    _load_libraries()
    with tempfile.TemporaryDirectory() as folder:
        places = [_checked_out(commit, Path(folder) / str(number)) for number in range(arguments.jobs)]
        chosen = drawn(places[0], commit, arguments.lines, arguments.only)
        left = [
            each for each in chosen if not {f"{word} {each}" for word in (CAUGHT, SURVIVED)} & {*report.lines}
        ]
        tests_of = {each: folder_of_tests(each.path, places[0]) for each in left}
        known = _kept(arguments.output, commit)
        for tests in sorted(set(tests_of.values()) - known.keys()):
            known[tests] = reached(places[0], tests)
            _keep(arguments.output, commit, known)
            report.say(f"{tests} unchanged: {sum(known[tests].seconds.values()):.0f} s")

        files_of = {each: known[tests_of[each]].files(each, arguments.seconds) for each in left}
        for each in left:
            if not files_of[each]:
                report.say(f"{SURVIVED} {each}")

        def begun(mutation, place):
            seconds = sum(known[tests_of[mutation]].seconds[file] for file in files_of[mutation])
            # Some changes make a loop endless: that is noticed, too.
            return Run(place, files_of[mutation], 60 + 3 * seconds)

        for mutation, code in tried([each for each in left if files_of[each]], places, begun):
            report.say(f"{CAUGHT if code else SURVIVED} {mutation}")
    n_caught = sum(f"{CAUGHT} {each}" in report.lines for each in chosen)
    report.say(f"{n_caught} of {len(chosen)} caught ({n_caught / len(chosen):.0%})")
    sys.exit(n_caught < arguments.least * len(chosen))


class Report:
    """The lines of a run, kept in a file where one is given; those of an earlier run of the same commit are kept."""

    def __init__(self, path, head):
        self.path, self.lines = path and Path(path), [head]
        if path and self.path.exists():
            self.lines = self.path.read_text("utf-8").splitlines()
            if self.lines[:1] != [head]:
                raise SystemExit(f"{path} holds something other than a run of {head}; name another file.")
        print("\n".join(self.lines), flush=True)

    def say(self, line):
        """Print a line and keep it, once."""
        if line in self.lines:
            return
        print(line, flush=True)
        self.lines.append(line)
        if self.path:
            self.path.write_text("\n".join([*self.lines, ""]), "utf-8")


def _expressions(tree):
    """Yield the expressions that compute: not annotations, not the texts of errors, nothing for types alone."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(child, ast.Raise | ast.JoinedStr | ast.Assert):
                continue
            if isinstance(child, ast.Call) and getattr(child.func, "attr", "") == "warn":
                continue
            if isinstance(child, ast.expr):
                yield child
            yield from _expressions(child)


def _changes(node):
    changed = copy.deepcopy(node)
    if isinstance(node, ast.Compare) and type(node.ops[0]) in OTHER_WAY:
        changed.ops[0] = OTHER_WAY[type(node.ops[0])]()
    elif isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in OTHER_WAY:
        changed.op = OTHER_WAY[type(node.op)]()
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        changed = changed.operand
    elif isinstance(node, ast.Constant) and type(node.value) is bool:
        changed.value = not node.value
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        changed.value = node.value + 1
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in OTHER_NAME:
        changed.id = OTHER_NAME[node.id]
    elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load) and node.attr in OTHER_NAME:
        changed.attr = OTHER_NAME[node.attr]
    else:
        return
    yield changed


def _kept(output, commit):
    """Return what tests reach, as an earlier run of this commit has kept it beside its output."""
    path = output and Path(f"{output}.reached.json")
    kept = json.loads(path.read_text("utf-8")) if path and path.exists() else {}
    return {tests: Reached(**one) for tests, one in kept.get(commit, {}).items()}


def _keep(output, commit, known):
    if output:
        told = {tests: {"seconds": one.seconds, "lines": one.lines} for tests, one in known.items()}
        Path(f"{output}.reached.json").write_text(json.dumps({commit: told}), "utf-8")


def _ended(number, frame):
    signal.signal(number, signal.SIG_IGN)
    raise SystemExit(f"Ended by {signal.Signals(number).name}; run it again with the same --output to go on.")


def _checked_out(commit, place):
    place.mkdir()
    with tarfile.open(fileobj=io.BytesIO(_git("archive", commit))) as archive:
        archive.extractall(place, filter="data")
    return place


def _git(*arguments):
    return subprocess.run(["git", "-C", str(ROOT), *arguments], check=True, capture_output=True).stdout


def _arguments():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lines", type=int, default=50)
    parser.add_argument("--only", nargs="+", help="pieces of the paths to draw from")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--least", type=float, default=0.85, help="exit code 1 if a smaller share is caught")
    parser.add_argument(
        "--seconds", type=float, default=math.inf, help="of tests for each line, the quick ones; default all"
    )
    parser.add_argument("--commit", default="HEAD", help="the commit whose lines are changed, default HEAD")
    parser.add_argument("--output", help="a file for what is printed; a run that ended early goes on from it")
    return parser.parse_args()


if __name__ == "__main__":
    main()
