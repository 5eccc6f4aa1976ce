"""Ratios of time, memory and size that the transports are to keep, beside POT and bare NumPy in the same run.

Run from the root of the repository, on a quiet machine, some minutes::

    OMP_NUM_THREADS=1 python benchmarks/speed.py > benchmarks/results/speed.txt

Everything is the median of five runs, interleaved; CPU is that of the process, over all threads. ``--sizes`` takes some
of the sizes. POT is ``ot.da.LinearTransport``, the floor the two products X'X and Y'Y.
"""

import argparse
import os
import pickle
import subprocess
import sys
import time
import tracemalloc

import numpy as np

from skat import AffineTransport, ProcrustesAffineTransport
from skat.transport import fit_batched

SIZES = ("1000000x30", "100000x200", "20000x1000")
REPEATS = 5


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="*", default=SIZES)
    arguments = parser.parse_args()
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True
    ).stdout.strip()
    print(f"commit {commit}: {' '.join(sys.argv)}; threads {os.environ.get('OMP_NUM_THREADS', 'all')}")
    print(f"load of the machine before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n")
    for size in arguments.sizes:
        at_size(*map(int, size.split("x")))
    many_small_ones()


def at_size(n_rows, n_features):
    import ot

    rng = np.random.default_rng(0)
    X = rng.normal(size=(n_rows, n_features))
    y = X @ (np.eye(n_features) + 0.1 * rng.normal(size=(n_features, n_features))) + 0.1 * rng.normal(
        size=X.shape
    )
    fitted = AffineTransport().fit(X, y)
    peer = ot.da.LinearTransport().fit(Xs=X, Xt=y)
    X32 = X.astype(np.float32)
    coef, intercept = fitted.coef_.T, fitted.intercept_
    coef32, intercept32 = coef.astype(np.float32), intercept.astype(np.float32)
    seconds = measured(
        {
            "affine": lambda: AffineTransport().fit(X, y),
            "POT": lambda: ot.da.LinearTransport().fit(Xs=X, Xt=y),
            "floor": lambda: (X.T @ X, y.T @ y),
            "procrustes": lambda: ProcrustesAffineTransport().fit(X, y),
            "transform": lambda: fitted.transform(X),
            "bare product": lambda: X @ coef + intercept,
            "POT's transform": lambda: peer.transform(X),
            "transform, float32": lambda: fitted.transform(X32),
            "bare product, float32": lambda: X32 @ coef32 + intercept32,
        }
    )
    print(f"{n_rows} x {n_features}: ratios of CPU (wall)")
    for label, over, under in (
        ("fit: POT / affine", "POT", "affine"),
        ("fit: affine / the two products", "affine", "floor"),
        ("fit: procrustes / affine", "procrustes", "affine"),
        ("transform: bare product / ours", "bare product", "transform"),
        ("transform: POT / ours", "POT's transform", "transform"),
        ("transform, float32: bare product / ours", "bare product, float32", "transform, float32"),
    ):
        cpu, wall = (seconds[over][kind] / seconds[under][kind] for kind in (0, 1))
        print(f"  {label:42s} {cpu:6.2f} ({wall:.2f})")
    memory = {
        "affine": peak(lambda: AffineTransport().fit(X, y)),
        "procrustes": peak(lambda: ProcrustesAffineTransport().fit(X, y)),
        "POT": peak(lambda: ot.da.LinearTransport().fit(Xs=X, Xt=y)),
    }
    print(
        f"  peak memory of a fit, MB: {', '.join(f'{name} {value / 1e6:.1f}' for name, value in memory.items())}"
    )
    size = len(pickle.dumps(fitted)) / (fitted.coef_.nbytes + fitted.intercept_.nbytes)
    print(f"  pickle over the map: {size:.2f}\n", flush=True)


def many_small_ones():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(10_000, 200, 4))
    y = X @ rng.normal(size=(10_000, 4, 4))
    seconds = measured(
        {"batched": lambda: fit_batched(X, y), "bare": lambda: [bare_map(*rows) for rows in zip(X, y)]}
    )
    cpu, wall = (seconds["batched"][kind] / seconds["bare"][kind] for kind in (0, 1))
    print(f"10,000 fits of 200 x 4: fit_batched / a bare NumPy loop {cpu:.2f} ({wall:.2f})")


def bare_map(X, y):
    """Return the map by the formula, without a check."""
    source, target = np.cov(X.T, bias=True), np.cov(y.T, bias=True)
    values, vectors = np.linalg.eigh(target)
    root = (vectors * np.sqrt(values)) @ vectors.T
    values, vectors = np.linalg.eigh(root @ source @ root)
    coef = root @ ((vectors / np.sqrt(values)) @ vectors.T) @ root
    return coef, y.mean(axis=0) - coef @ X.mean(axis=0)


def measured(calls):
    """Return the medians of CPU and wall seconds of each call, interleaved."""
    seconds = {name: [] for name in calls}
    for _ in range(REPEATS):
        for name, call in calls.items():
            cpu, wall = time.process_time(), time.perf_counter()
            call()
            seconds[name].append((time.process_time() - cpu, time.perf_counter() - wall))
    return {name: np.median(values, axis=0) for name, values in seconds.items()}


def peak(call):
    """Return the largest memory in bytes that a call holds beyond its input."""
    tracemalloc.start()
    call()
    largest = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return largest


if __name__ == "__main__":
    main()
