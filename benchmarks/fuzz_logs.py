"""Read 10,000 damaged logs: no error but those of a log, no crash, none longer than 5 s, no more than 1 GiB.

    python benchmarks/fuzz_logs.py [--number 10000] [--seed 0] [--output benchmarks/results/fuzz_logs.md]

Each batch runs in a process of its own; seconds are those of the processor, which other work does not lengthen; the
lines of the readers that are reached are counted. Files and damage are those of ``tests/logs/mutations.py``.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import types
import warnings
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
READERS = ROOT / "skat" / "logs" / "readers"
BATCH = 250
LONGEST_S, MOST_MIB = 5.0, 1024.0
REACHED = 0.9


def worker(kind, number, seed):
    """Read damaged logs of a kind; print a line of JSON for each, and one for the whole."""
    import numpy as np

    from tests.logs import mutations

    warnings.simplefilter("ignore")
    reached = {}
    # Of each function the lines that were not reached yet: where none is left, it runs without being watched.
    left = {}

    def traced(frame, event, _):
        code = frame.f_code
        if code not in left:
            inside = code.co_filename.startswith(str(READERS))
            left[code] = {line for _, _, line in code.co_lines() if line} if inside else set()
        if not left[code]:
            return None
        lines, missing = reached.setdefault(code.co_filename, set()), left[code]

        def local(frame, event, _):
            lines.add(frame.f_lineno)
            missing.discard(frame.f_lineno)
            return local

        return local(frame, event, _)

    arm = mutations.arm()
    rng = np.random.default_rng([seed, mutations.KINDS.index(kind)])
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder, "whole")
        whole.mkdir()
        path = mutations.seed(kind, whole)
        sys.settrace(traced)
        mutations.outcome(path, arm, kind)
        for _ in range(number):
            copy, how = mutations.damaged(path, folder, rng)
            print(json.dumps({"begin": how}), flush=True)
            before = time.process_time()
            try:
                end, bad = mutations.outcome(copy, arm, kind), False
            except Exception as error:
                end, bad = f"{type(error).__name__}: {error}"[:300], True
            print(json.dumps({"end": end, "bad": bad, "s": time.process_time() - before}), flush=True)
        sys.settrace(None)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        json.dumps({"mib": peak, "lines": {path: sorted(lines) for path, lines in reached.items()}}),
        flush=True,
    )


def executable_lines(path):
    """Return the lines inside functions of a file, without the first of each, which no call passes."""
    lines = set()

    def walk(code, inside):
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):
                walk(constant, True)
        if inside and not code.co_name.startswith("<"):
            lines.update(line for _, _, line in code.co_lines() if line and line != code.co_firstlineno)

    walk(compile(path.read_text(), str(path), "exec"), False)
    return lines


def run(kind, number, seed):
    """Return what a batch came to, whatever became of its process."""
    command = [sys.executable, __file__, "--worker", kind, "--number", str(number), "--seed", str(seed)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=os.environ
    )
    ends, bad, slowest, peak, lines, last = {}, [], 0.0, 0.0, {}, ""
    for text in process.stdout:
        said = json.loads(text)
        if "begin" in said:
            last = said["begin"]
        elif "end" in said:
            name = "read" if said["end"] == "read" else said["end"].split(":")[0]
            ends[name] = ends.get(name, 0) + 1
            slowest = max(slowest, said["s"])
            if said["bad"] or said["s"] > LONGEST_S:
                bad.append(f"{kind}, seed {seed}, {last}: {said['end']} in {said['s']:.2g} s")
        else:
            peak, lines = said["mib"], said["lines"]
    if process.wait() != 0:
        bad.append(f"{kind}, seed {seed}, {last}: the process ended with {process.returncode}")
    return ends, bad, slowest, peak, lines


def main():
    """Run all batches and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--number", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        worker(options.worker, options.number, options.seed)
        return
    from tests.logs import mutations

    rows, failures, reached = {}, [], {}
    share = -(-options.number // len(mutations.KINDS))
    for kind in mutations.KINDS:
        total, slowest, peak = {}, 0.0, 0.0
        for batch, start in enumerate(range(0, share, BATCH)):
            ends, bad, slow, most, lines = run(kind, min(BATCH, share - start), options.seed * 1000 + batch)
            failures += bad
            slowest, peak = max(slowest, slow), max(peak, most)
            for name, count in ends.items():
                total[name] = total.get(name, 0) + count
            for path, numbers in lines.items():
                reached.setdefault(path, set()).update(numbers)
        if peak > MOST_MIB:
            failures.append(f"{kind}: {peak:.0f} MiB")
        rows[kind] = (sum(total.values()), total.get("read", 0), slowest, peak)
        print(kind, *(f"{value:.4g}" for value in rows[kind]), flush=True)
    table = ["| log | damaged | still read | slowest, s | peak, MiB |", "|---|---|---|---|---|"]
    table += [
        f"| {kind} | {n} | {read} | {slow:.2f} | {peak:.0f} |" for kind, (n, read, slow, peak) in rows.items()
    ]
    whole = {str(path): executable_lines(path) for path in sorted(READERS.glob("*.py"))}
    hit = sum(len(reached.get(path, set()) & lines) for path, lines in whole.items())
    size = sum(map(len, whole.values()))
    table += [
        "",
        f"{hit} of {size} lines of the readers reached ({hit / size:.1%}). {len(failures)} failures.",
    ]
    for path, lines in whole.items():
        if missed := sorted(lines - reached.get(path, set())):
            table.append(f"- not reached in {Path(path).name}: {', '.join(map(str, missed))}")
    table += [f"- {failure}" for failure in failures]
    print("\n".join(table))
    if options.output:
        options.output.write_text("\n".join(["# Damaged logs", "", *table, ""]))
    sys.exit(bool(failures) or hit < REACHED * size)


if __name__ == "__main__":
    main()
