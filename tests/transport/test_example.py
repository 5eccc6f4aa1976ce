"""The example runs, in a process of its own, and shows what its text says."""

import os
import subprocess
import sys
from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "examples" / "plot_transport.py"


def test_example_shows_that_the_conditional_transport_comes_close_to_the_noise():
    run = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLE)],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "MPLBACKEND": "agg"},
    )
    speed = {}
    for line in run.stdout.splitlines():
        name, values = line.split(":")
        speed[name.strip()] = float(values.split()[2])
    assert 0.01 < speed["conditional"] < 0.016
    assert 0.01 < speed["Procrustes, on pairs"] < 0.016
    assert speed["affine"] > 0.05
    assert speed["no transport"] > 0.05
