"""Seconds until ``skat diagnose --quick`` has printed a first answer about a six-joint log of 30 s at 100 Hz.

    python benchmarks/quick_answer.py [--hidden "dry_friction[elbow]=2"] [--rows 3000] [--runs 3]

The arm's worlds share no code with skat. Wanted are 10 s on two free cores, from the start of the process to the line
with the verdict; the load of the machine is printed beside.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pandas as pd
from worlds.robots import make_log

LIMIT_S = 10.0


def write_log(folder, hidden, rows):
    """Write model.xml and log.csv of an arm; return the seconds from row to row."""
    log = make_log("torque_arm", hidden, sensor="ideal", force=None, seed=0, rows=rows, episodes=1)
    from skat.simulators import MujocoSimulator

    simulator = MujocoSimulator(log.mjcf, frame_skip=log.frame_skip)
    (folder / "model.xml").write_text(log.mjcf)
    table = pd.DataFrame(log.X, columns=list(simulator.input_names))
    table.insert(0, "time", simulator.dt * pd.RangeIndex(len(table)))
    table.to_csv(folder / "log.csv", index=False)
    return simulator.dt


def answer(folder, name):
    """Run the command; return (seconds to the verdict, seconds to the end, seconds of the processor, the verdict)."""
    command = [sys.executable, "-m", "skat", "diagnose", "model.xml", "log.csv", "--quick", "-o", name]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun, first, verdict = time.perf_counter(), None, ""
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            if first is None and line.startswith("Log: "):
                first, verdict = time.perf_counter() - begun, line.strip()
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} ended with {process.returncode}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return first, time.perf_counter() - begun, spent, verdict


def main():
    """Print a line a run; end with 1 where no run was as fast as is wanted."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hidden", default="dry_friction[elbow]=2", help="NAME=VALUE")
    parser.add_argument("--rows", type=int, default=3000)
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    name, _, value = options.hidden.partition("=")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        dt = write_log(folder, {name: float(value)}, options.rows)
        print(
            f"{options.rows} rows of {dt:g} s, {options.hidden}, load {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores"
        )
        least = float("inf")
        for run in range(options.runs):
            first, whole, spent, verdict = answer(folder, f"{run}.html")
            least = min(least, first)
            print(
                f"verdict after {first:.1f} s, end after {whole:.1f} s, {spent:.1f} s of processor: {verdict}"
            )
    raise SystemExit(least > LIMIT_S)


if __name__ == "__main__":
    main()
