"""By how much the two-link arm's encoders were zeroed otherwise in each run: gravity's direction, by least squares.

The arm is zeroed where it hangs before a run, within what friction holds. The torques of both joints are regressed on
rigid-body terms with parameters of their own, viscous and dry friction, the angles shifted by the two zeros that leave
least. Nothing of `skat` but the logs is used. Errors are a jackknife's of eighths of a run::

    SKAT_DATA_HOME=... python benchmarks/encoder_zeros.py
"""

import numpy as np
from dose_response import RUNS
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

DT, WINDOW, ORDER = 0.002, 101, 3
SLOW = 0.1  # rad/s, below which dry friction is taken to grow with the speed
PIECES = 8


def zeros(angles, torques):
    """Return by how much less each joint reads than it is turned, and standard errors, rad: (2,) and (2,)."""

    def smooth(x, order=0):
        return savgol_filter(x, WINDOW, ORDER, deriv=order, delta=DT, axis=0)[WINDOW:-WINDOW]

    positions, speeds, pulls = (smooth(angles, order) for order in range(3))
    target = smooth(torques).T.ravel()
    (v1, v2), (a1, a2) = speeds.T, pulls.T
    none = np.zeros(len(v1))

    def columns(zero):
        q1, q2 = (positions + zero).T
        first = [a1, a1 + a2, np.cos(q2) * (2 * a1 + a2) - np.sin(q2) * (v2**2 + 2 * v1 * v2)]
        second = [none, a1 + a2, np.cos(q2) * a1 + np.sin(q2) * v1**2]
        first += [np.sin(q1), np.sin(q1 + q2), v1, np.tanh(v1 / SLOW), none, none, none]
        second += [none, np.sin(q1 + q2), none, none, v2, np.tanh(v2 / SLOW), a2]
        return np.hstack([first, second]).T

    piece = np.tile(np.arange(len(v1)) * PIECES // len(v1), 2)

    def solved(kept):
        def left(zero):
            N = columns(zero)[kept]
            return target[kept] - N @ np.linalg.lstsq(N, target[kept], rcond=None)[0]

        return least_squares(left, np.zeros(2)).x

    without = np.array([solved(piece != one) for one in range(PIECES)])
    return solved(piece >= 0), np.sqrt(PIECES - 1) * np.std(without, axis=0)


def main():
    from skat import datasets

    for run in RUNS["double_pendulum"]:
        X = np.asarray(datasets.fetch_double_pendulum(run, download_if_missing=False).data)
        off, error = zeros(X[:, :2], X[:, 4:6])
        told = (f"{one} {at:+.4f} +- {by:.4f} rad" for one, at, by in zip(("shoulder", "elbow"), off, error))
        print(f"{run}: {', '.join(told)}")


if __name__ == "__main__":
    main()
