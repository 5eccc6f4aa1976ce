"""Tables of a diagnosis: cases whose truth is known, a line of JSON for each, and what is counted of them.

Every script of a table calls `main`. A case is asked once: its line holds a hash of the sources that decide, and the
commit; a report counts the lines of one hash alone, by default that of the sources at hand. So a table may be
interrupted, gone on with later, and filled by several processes at once, which take cases from each other by file
locks (or by ``--shard 0/2`` and ``--shard 1/2`` where a file system has none)::

    python benchmarks/sensors.py --cut                    # a small cut
    python benchmarks/sensors.py --cases "two_link"       # cases whose name contains this
    python benchmarks/sensors.py --limit 10               # stop after so many
    python benchmarks/sensors.py --report                 # only print what is there
    python benchmarks/sensors.py --velocities auto        # passed to SimulationDiagnosis, only if given
    python benchmarks/sensors.py --parameter quick=true   # any other of its parameters

Nothing here knows how an engine works: it is asked by `SimulationDiagnosis(...).fit(X, y, groups)`, and its answer
is read from `causes_`, `verdict_`, `gain_`.
"""

import argparse
import contextlib
import hashlib
import json
import os
import resource
import subprocess
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table as Shown

HERE = Path(__file__).parent
RESULTS = HERE / "results"
# What decides what a table says: never how it is shown, and what changed between two logs only where that is asked.
SOURCES, SHOWN, CHANGES = ("diagnosis", "simulators", "effects.py"), "diagnosis/report", "diagnosis/changes"


@dataclass(frozen=True)
class Case:
    """A question: a name that is unique in its table, a seed, and what `Table.run` needs to know."""

    name: str
    seed: int
    settings: dict = field(default_factory=dict)

    @property
    def key(self):
        """What a line is found by."""
        return f"{self.name} #{self.seed}"


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes
    ----------
    name : str
        Of its file of lines in ``results``.
    cases : callable
        ``cases(cut)`` returns a sequence of Case, in the order in which they are asked.
    run : callable
        ``run(case, parameters)`` returns the line, without what `main` adds.
    report : callable
        ``report(lines, shown)`` adds rows to a `Figures`.
    of_changes : bool
        Whether it asks what changed between two logs.
    """

    name: str
    cases: Callable
    run: Callable
    report: Callable
    of_changes: bool = False


# -- asking ----------------------------------------------------------------------------------------------------------


def ask(simulator, X, y, groups, *, seed, parameters=None):
    """Return what a diagnosis answers, as plain numbers and texts, and the diagnosis; None if it failed.

    A crash is an answer too: the verdict "error".
    """
    from skat.diagnosis import SimulationDiagnosis

    start, start_cpu = time.perf_counter(), time.process_time()
    _forget_peak()
    diagnosis, answer = None, {}
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            diagnosis = SimulationDiagnosis(
                simulator, **{"random_state": seed, "n_jobs": 1, **(parameters or {})}
            ).fit(X, y, groups=groups)
        except Exception as error:
            answer = {"verdict": "error", "causes": [], "error": f"{type(error).__name__}: {error}"}
    answer |= {
        "seconds": round(time.perf_counter() - start, 2),
        "cpu_seconds": round(time.process_time() - start_cpu, 2),
        "peak_megabytes": round(_peak() / 2**20),
        "warnings": sorted({str(one.message)[:200] for one in told}),
    }
    if diagnosis is not None:
        answer |= read(diagnosis)
    return answer, diagnosis


def ask_change(simulator, before, after, *, seed, parameters=None):
    """Return what a diagnosis says has changed between two logs, as `ask` does."""
    from skat.diagnosis import SimulationDiagnosis

    start, start_cpu = time.perf_counter(), time.process_time()
    _forget_peak()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            diagnosis = SimulationDiagnosis(
                simulator, **{"random_state": seed, "n_jobs": 1, **(parameters or {})}
            ).fit_change(before, after)
            answer = {
                "verdict": diagnosis.verdict_,
                "causes": _causes(diagnosis.changes_),
                "gain": _gain(diagnosis.gain_),
                "detectable": {
                    name: round(least, 6)
                    for name, least in diagnosis.detectable_.items()
                    if np.isfinite(least)
                },
                "mistake": next((str(one.message) for one in told if "reads as if" in str(one.message)), ""),
            }
        except Exception as error:
            answer = {
                "verdict": "error",
                "causes": [],
                "mistake": "",
                "error": f"{type(error).__name__}: {error}",
            }
    return answer | {
        "seconds": round(time.perf_counter() - start, 2),
        "cpu_seconds": round(time.process_time() - start_cpu, 2),
        "peak_megabytes": round(_peak() / 2**20),
    }


def read(diagnosis):
    """Return verdict, causes and gain of a fitted diagnosis."""
    return {
        "verdict": diagnosis.verdict_,
        "causes": _causes(diagnosis.causes_),
        "gain": _gain(diagnosis.gain_),
        "noise": np.asarray(diagnosis.noise_, float).tolist(),
        "velocities": "computed" if diagnosis.computed_velocities_ else "measured",
    }


def _causes(causes):
    return [
        {
            "name": cause.name,
            "value": float(cause.value),
            "interval": [float(bound) for bound in cause.interval],
            "probability": float(cause.probability),
            "evidence": float(cause.evidence),
            "aliases": [[alias.name, float(alias.probability)] for alias in cause.aliases],
        }
        for cause in causes
    ]


def _gain(gain):
    if gain is None:
        return None
    return {name: float(getattr(gain, name)) for name in ("nominal", "extended", "floor", "explained")}


def _forget_peak():
    # Linux keeps the most memory that a process ever had, unless it is told to begin anew.
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak():
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * int(next(line for line in lines if line.startswith("VmHWM")).split()[1])
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


# -- judging ---------------------------------------------------------------------------------------------------------


def names(line):
    """Return the names of the causes."""
    return [cause["name"] for cause in line["causes"]]


def covers(cause, name):
    """Whether a cause is called ``name``, or has it for an alias."""
    return cause["name"] == name or name in [alias for alias, _ in cause["aliases"]]


def alone(line):
    """Whether the one cause is named, and no other."""
    return names(line) == list(line["truth"])


def or_alias(line):
    """Whether the one cause is named or an alias of the only one that is."""
    (truth,) = line["truth"]
    return len(line["causes"]) == 1 and covers(line["causes"][0], truth)


def in_interval(line):
    """Return, for each cause that is named right, whether its interval holds the truth."""
    return [
        cause["interval"][0] <= line["truth"][cause["name"]] <= cause["interval"][1]
        for cause in line["causes"]
        if cause["name"] in line["truth"]
    ]


def silent(line):
    """Whether nothing was detected."""
    return line["verdict"] == "nothing detected"


def is_true(line, name):
    """Whether a name is of what was hidden, or of a family that a line says is part of its world."""
    return name in line["truth"] or name.partition("[")[0] in line.get("parts", ())


def calibration(lines):
    """Return (probability, whether right) of every cause that is told with one."""
    return [
        (cause["probability"], is_true(line, cause["name"]))
        for line in lines
        for cause in line["causes"]
        if cause.get("probability") is not None
    ]


def wilson(hits, count, z=1.96):
    """Return the 95 % interval of a share by Wilson's score."""
    if not count:
        return 0.0, 1.0
    share = hits / count
    middle = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    reach = z / (1 + z**2 / count) * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return max(0.0, middle - reach), min(1.0, middle + reach)


class Figures:
    """Figures beside what is wanted of them."""

    def __init__(self, title):
        self.table = Shown("must hold", "figure", "95 %", "of", "wanted", title=title)

    def share(self, label, flags, wanted=""):
        """Add a share of flags, with its interval."""
        flags = [bool(flag) for flag in flags]
        hits, count = sum(flags), len(flags)
        if not count and not wanted:
            return
        low, high = wilson(hits, count)
        figure = f"{100 * hits / count:.1f} %" if count else "not run"
        between = f"{100 * low:.0f} to {100 * high:.0f} %" if count else ""
        self.table.add_row(label, figure, between, f"{hits} of {count}", wanted)

    def number(self, label, numbers, wanted="", *, form="{:.3g}"):
        """Add the median and the largest of numbers."""
        numbers = [number for number in numbers if number is not None and np.isfinite(number)]
        figure = (
            f"{form.format(np.median(numbers))}, at most {form.format(max(numbers))}"
            if numbers
            else "not run"
        )
        self.table.add_row(label, figure, "", str(len(numbers)), wanted)

    def costs(self, lines):
        """Add time and memory."""
        self.number("processor seconds, median and largest", [line.get("cpu_seconds") for line in lines])
        self.number("megabytes, median and largest", [line.get("peak_megabytes") for line in lines])
        self.share("crashes", [line["verdict"] == "error" for line in lines], "0 %")

    def probabilities(self, lines):
        """Add how often causes are right in four bins of their stated probability."""
        told = calibration(lines)
        for low, high in zip((0, 0.5, 0.8, 0.95), (0.5, 0.8, 0.95, 1.0)):
            some = [(p, right) for p, right in told if low < p <= high]
            stated = np.mean([p for p, _ in some]) if some else 0.0
            reach = 2 * np.sqrt(sum(p * (1 - p) for p, _ in some)) / len(some) if some else 0.0
            self.share(
                f"right where the probability is {low} to {high} (stated {stated:.3f} +- {reach:.3f})",
                [right for _, right in some],
                "no less than stated, by two standard errors",
            )


# -- running ---------------------------------------------------------------------------------------------------------


def source_hash(of_changes=False):
    """Return a hash of the sources that decide: the engine, or what finds changes too, the simulators, the effects."""
    import skat

    root = Path(skat.__file__).parent
    others = [root / SHOWN] if of_changes else [root / SHOWN, root / CHANGES]
    files = [
        file
        for source in SOURCES
        for file in ([root / source] if source.endswith(".py") else sorted((root / source).rglob("*.py")))
        if not any(file.is_relative_to(other) for other in others)
    ]
    return _hash(files, root)


def commit():
    """Return the commit at hand, empty outside of a repository."""
    asked = ["git", "-C", str(HERE), "rev-parse", "--short", "HEAD"]
    try:
        return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def world_hash():
    """Return a hash of the sources that make the worlds."""
    return _hash(sorted((HERE / "worlds").glob("*.py")), HERE)


def _hash(files, root):
    digest = hashlib.sha256()
    for file in files:
        digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def lines_of(path, source=None, parameters=None):
    """Return the lines of a file, of one hash or commit and one set of parameters if given; of a case the last."""
    if not path.exists():
        return []
    found = {}
    for text in path.read_text().splitlines():
        line = json.loads(text)
        wanted = source is None or source in (line.get("source"), line.get("commit"))
        if wanted and (parameters is None or line.get("parameters") == parameters):
            asked = json.dumps(line.get("parameters"), sort_keys=True)
            found[line.get("source"), asked, line["key"]] = line
    return list(found.values())


def main(table, description, arguments=None):
    """Ask the cases of a table that have no line yet, and report."""
    options = _options(description).parse_args(arguments)
    path = options.output or RESULTS / f"{table.name}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    source, worlds = options.source or source_hash(table.of_changes), world_hash()
    parameters = _parameters(options)
    index, count = (int(part) for part in options.shard.split("/"))
    cases = [case for case in table.cases(options.cut) if options.cases in case.key][index::count]
    asked = 0
    for case in () if options.report else cases:
        if options.limit is not None and asked >= options.limit:
            break
        with _claimed(path, f"{source} {json.dumps(parameters, sort_keys=True)} {case.key}") as mine:
            if not mine or case.key in {line["key"] for line in lines_of(path, source, parameters)}:
                continue
            line = {
                "table": table.name,
                "key": case.key,
                "case": case.name,
                "seed": case.seed,
                "source": source,
                "commit": commit(),
                "worlds": worlds,
                "parameters": parameters,
                **table.run(case, parameters),
            }
            _append(path, line)
            asked += 1
            print(told(line), flush=True)
    wanted = {case.key for case in cases}
    lines = [line for line in lines_of(path, source, parameters) if line["key"] in wanted]
    figures = Figures(f"{table.name}: {len(lines)} of {len(wanted)} cases, sources {source}")
    table.report(lines, figures)
    figures.costs(lines)
    if len({line["worlds"] for line in lines}) > 1:
        print("the worlds changed within these lines: delete the file and run them again")
    Console(width=None if options.width is None else options.width).print(figures.table)


def told(line):
    """Return a line for people."""
    truth = ", ".join(f"{name} {value:.4g}" for name, value in list(line["truth"].items())[:4]) or "nothing"
    truth += f" and {len(line['truth']) - 4} more" if len(line["truth"]) > 4 else ""
    found = "; ".join(
        f"{cause['name']} {cause['value']:.4g} [{cause['interval'][0]:.4g}, {cause['interval'][1]:.4g}]"
        + ("" if cause["probability"] is None else f" p {cause['probability']:.2f}")
        + (f" or {', '.join(alias for alias, _ in cause['aliases'])}" if cause["aliases"] else "")
        for cause in line["causes"]
    )
    return (
        f"{line['key']}: hidden {truth}; {line.get('error') or line['verdict']}: {found} "
        f"[{line.get('cpu_seconds', 0):.0f} s]"
    )


@contextlib.contextmanager
def _claimed(path, key):
    """Yield whether the case is this process's own: a lock that ends with the process."""
    folder = path.with_suffix(".locks")
    folder.mkdir(exist_ok=True)
    file = folder / hashlib.sha256(key.encode()).hexdigest()[:20]
    with file.open("a") as handle:
        try:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:
            pass  # Use --shard.
        except OSError:
            yield False
            return
        yield True
        with contextlib.suppress(OSError):
            os.unlink(file)


def _append(path, line):
    text = (json.dumps(line) + "\n").encode()
    # One write to a file opened for appending does not mix with another process's.
    with path.open("ab", buffering=0) as file:
        file.write(text)


def _parameters(options):
    parameters = {} if options.velocities is None else {"velocities": options.velocities}
    for text in options.parameter:
        name, _, value = text.partition("=")
        try:
            parameters[name] = json.loads(value)
        except json.JSONDecodeError:
            parameters[name] = value
    return parameters


def _options(description):
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cut", action="store_true", help="a small cut of the table")
    parser.add_argument("--cases", default="", help="only cases whose name and seed contain this text")
    parser.add_argument("--limit", type=int, help="stop after so many")
    parser.add_argument("--shard", default="0/1", help="i/n: every n-th case, from the i-th on")
    parser.add_argument("--report", action="store_true", help="print what is there, run nothing")
    parser.add_argument(
        "--source", help="hash or commit of the lines to report; by default of the sources at hand"
    )
    parser.add_argument(
        "--velocities", choices=("auto", "measured", "computed"), help="passed on, only if given"
    )
    parser.add_argument("--parameter", action="append", default=[], help="name=value of SimulationDiagnosis")
    parser.add_argument("--output", type=Path, help="file of lines")
    parser.add_argument("--width", type=int, help="columns to print for")
    return parser


def simulator_of(log, extra=()):
    """Return the simulator that a user of a log's robot hands to a diagnosis: of the nominal model."""
    from skat.simulators import MujocoSimulator

    return MujocoSimulator(log.mjcf, frame_skip=log.frame_skip, **({"extra_effects": extra} if extra else {}))
