"""Time ``skat diagnose --quick`` on 30 s of a six-joint arm at 100 Hz: to the causes, the verdict, the report on disk.

Once with a dry friction hidden in the elbow, once with nothing; the log is a CSV. Seconds are those of a clock on the
wall, on two cores with nothing else to do, so that this is worth running only there::

    python benchmarks/first_answer.py [--runs 2] [--output benchmarks/results/first_answer.txt]

The peer of the same run is the import of scikit-learn, which is part of it.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from worlds.hidden import channel_names, nominal_model
from worlds.robots import make_log

HIDDEN = {"a friction": {"dry_friction[elbow]": 4.0}, "nothing": {}}
ROWS = 3000
LIMIT_S = 10.0


def written(folder, truth):
    """Write model and log of an arm; return their paths."""
    import mujoco

    log = make_log("torque_arm", truth, rows=ROWS, episodes=1, seed=1)
    model = nominal_model(log.mjcf)
    controls = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, one) for one in range(model.nu)]
    names = [*channel_names(model), *(f"ctrl.{name}" for name in controls)]
    # The state behind the last row has no command.
    rows = np.vstack([log.X, np.concatenate([log.y[-1], log.X[-1, log.y.shape[1] :]])])
    dt = log.frame_skip * model.opt.timestep
    table = pd.DataFrame(rows, columns=names)
    table.insert(0, "time", dt * np.arange(len(rows)))
    (folder / "arm.xml").write_text(log.mjcf)
    table.to_csv(folder / "log.csv", index=False)
    return folder / "arm.xml", folder / "log.csv"


def timed(arguments, folder):
    """Return after how many seconds a command told causes, said its verdict and ended; and the verdict."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg", "PYTHONUNBUFFERED": "1"}
    start = time.perf_counter()
    command = subprocess.Popen(
        [sys.executable, "-m", "skat", *arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    causes = verdict = np.nan
    said = ""
    for line in command.stdout:
        if line.startswith("what is left"):
            causes = time.perf_counter() - start
        elif line.startswith("Log: "):
            verdict, said = time.perf_counter() - start, line.strip()
    if command.wait():
        raise RuntimeError(f"skat {' '.join(arguments)} ended with {command.returncode}")
    return causes, verdict, time.perf_counter() - start, said


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    lines = [
        f"at most {LIMIT_S:.0f} s are allowed; {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at the start"
    ]
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        peer = []
        for _ in range(arguments.runs):
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", "import sklearn.base"], check=True)
            peer.append(time.perf_counter() - start)
        lines.append(f"import sklearn.base: {min(peer):.2f} s")
        for name, truth in HIDDEN.items():
            model, log = written(folder, truth)
            command = ["diagnose", str(model), str(log), "--quick", "--force"]
            runs = [timed(command, folder) for _ in range(arguments.runs)]
            times = (", ".join(f"{one:.1f}" for one in some) for some in list(zip(*runs, strict=True))[:3])
            lines.append(
                "{} hidden: causes told after {} s, verdict and gain after {} s, report written after {} s; {}".format(
                    name, *times, runs[0][-1]
                )
            )
    text = "\n".join(lines)
    print(text)
    if arguments.output is not None:
        arguments.output.write_text(text + "\n")


if __name__ == "__main__":
    main()
