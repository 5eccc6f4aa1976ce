"""By how much the two-link arm's encoders were zeroed otherwise in each run: gravity's direction, by least squares.

The arm is zeroed where it hangs before a run, within what friction holds. The torque of the elbow is regressed on
inertial terms, viscous and dry friction, and the sine and cosine of the angle of the outer link to the vertical; the
ratio of the last two is the zero's error. Nothing of `skat` but the logs is used. Errors are a jackknife's of eighths
of a run::

    SKAT_DATA_HOME=... python benchmarks/encoder_zeros.py
"""

import numpy as np
from dose_response import RUNS
from scipy.signal import savgol_filter

DT, WINDOW, ORDER = 0.002, 101, 3
SLOW = 0.1  # rad/s, below which dry friction is taken to grow with the speed
PIECES = 8


def zero(angles, torques):
    """Return by how much the outer link's angle to the vertical is off, and its standard error, rad."""

    def smooth(x, order=0):
        return savgol_filter(x, WINDOW, ORDER, deriv=order, delta=DT, axis=0)[WINDOW:-WINDOW]

    (shoulder, elbow), (speed, own), (pull, turn) = (smooth(angles, order).T for order in range(3))
    columns = np.column_stack(
        [
            np.sin(shoulder + elbow),
            np.cos(shoulder + elbow),
            pull + turn,
            np.cos(elbow) * pull + np.sin(elbow) * speed**2,
            own,
            np.tanh(own / SLOW),
        ]
    )
    target = smooth(torques[:, 1])

    def solved(kept):
        found = np.linalg.lstsq(columns[kept], target[kept], rcond=None)[0]
        return found[1] / found[0]

    piece = np.arange(len(target)) * PIECES // len(target)
    without = [solved(piece != one) for one in range(PIECES)]
    return solved(piece >= 0), np.sqrt(PIECES - 1) * np.std(without)


def main():
    from skat import datasets

    for run in RUNS["double_pendulum"]:
        X = np.asarray(datasets.fetch_double_pendulum(run, download_if_missing=False).data)
        off, error = zero(X[:, :2], X[:, 4:6])
        print(f"{run}: {off:+.4f} +- {error:.4f} rad")


if __name__ == "__main__":
    main()
