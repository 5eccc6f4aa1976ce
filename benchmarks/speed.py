"""Ratios of time, memory and size that the transports are to keep, beside peers and bare NumPy in the same run.

Run from the root of the repository, on a quiet machine, some minutes each::

    OMP_NUM_THREADS=1 python benchmarks/speed.py     # CPU is what counts
    python benchmarks/speed.py                       # wall time, with all threads

Everything is the median of five runs, interleaved, or with ``--least`` the least of them, which other work on the
machine disturbs less; CPU is that of the process, over all threads. ``--sizes`` takes some of the sizes. The floor is
the two products X'X and Y'Y; the time of a peer over that of the floor is the most that anything which reads the rows
once can gain on it. Peers are ``ot.da.LinearTransport`` (POT), ``LinearOTMappingAdapter`` (skada),
``Gaussian.transport`` (ott-jax, in float64) and ``LinearRegression`` (scikit-learn); those that are not installed are
left out. An environment of their own, beside this one's packages::

    python -m venv peers-env && peers-env/bin/pip install POT threadpoolctl scikit-learn skada ott-jax
    PYTHONPATH=. OMP_NUM_THREADS=1 peers-env/bin/python benchmarks/speed.py
"""

import argparse
import os
import pickle
import platform
import subprocess
import sys
import time
import tracemalloc
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

import numpy as np
from sklearn.linear_model import LinearRegression

from skat import AffineTransport, ProcrustesAffineTransport
from skat.transport import fit_batched

SIZES = ("1000000x30", "100000x200", "20000x1000")
REPEATS = 5
PACKAGES = ("numpy", "scipy", "scikit-learn", "POT", "skada", "ott-jax", "jax")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="*", default=SIZES)
    parser.add_argument("--repeats", type=int, default=REPEATS)
    parser.add_argument("--least", action="store_true", help="the least of the runs instead of the median")
    parser.add_argument("--no-peers", action="store_true", help="POT only")
    parser.add_argument("--calls", nargs="*", help="some of what is timed, as 'affine' and 'floor'")
    parser.add_argument("--no-small", action="store_true", help="leave out the 10,000 fits of 200 x 4")
    arguments = parser.parse_args()
    if os.environ.get("OMP_NUM_THREADS") == "1":
        # JAX has threads of its own.
        os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True
    ).stdout.strip()
    print(f"commit {commit}: {' '.join(sys.argv)}; threads {os.environ.get('OMP_NUM_THREADS', 'all')}")
    print(", ".join(f"{name} {version_of(name)}" for name in PACKAGES), platform.python_version())
    print(f"load of the machine before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n", flush=True)
    for size in arguments.sizes:
        at_size(*map(int, size.split("x")), arguments)
    if not arguments.no_small:
        many_small_ones(arguments)


def version_of(package):
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def pot(X, y):
    import ot

    model = ot.da.LinearTransport().fit(Xs=X, Xt=y)
    return lambda: model.transform(Xs=X)


def skada(X, y):
    from skada import LinearOTMappingAdapter

    rows, domain = np.vstack([X, y]), np.repeat([1, -1], [len(X), len(y)])
    LinearOTMappingAdapter().fit(rows, None, sample_domain=domain)


def ott(X, y):
    import jax
    from ott.tools.gaussian_mixture.gaussian import Gaussian

    jax.config.update("jax_enable_x64", True)
    source, target = (Gaussian.from_samples(jax.numpy.asarray(rows)) for rows in (X, y))
    source.transport(target, jax.numpy.asarray(X[:1])).block_until_ready()


def regression(X, y):
    LinearRegression().fit(X, y)


# Name of a fit -> its call and the package that it needs.
PEERS = {
    "POT": (pot, "ot"),
    "skada": (skada, "skada"),
    "ott-jax": (ott, "ott"),
    "LinearRegression": (regression, "sklearn"),
}


def at_size(n_rows, n_features, arguments):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(n_rows, n_features))
    y = X @ (np.eye(n_features) + 0.1 * rng.normal(size=(n_features, n_features)))
    y += 0.1 * rng.normal(size=X.shape)
    peers = {
        name: call
        for name, (call, package) in PEERS.items()
        if find_spec(package) and (name == "POT" or not arguments.no_peers)
    }
    fitted = AffineTransport().fit(X, y)
    carry = None if arguments.calls and "POT's transform" not in arguments.calls else pot(X, y)
    # The mean of ten standard deviations is taken from each row before it is squared.
    far_X, far_y = X + 10, y + 10 * y.std()
    X32, y32 = X.astype(np.float32), y.astype(np.float32)
    coef, intercept = fitted.coef_.T, fitted.intercept_
    coef32, intercept32 = coef.astype(np.float32), intercept.astype(np.float32)
    calls = {
        "affine": lambda: AffineTransport().fit(X, y),
        "affine, off centre": lambda: AffineTransport().fit(far_X, far_y),
        "floor": lambda: (X.T @ X, y.T @ y),
        "three products": lambda: (X.T @ X, y.T @ y, X.T @ y),
        "procrustes": lambda: ProcrustesAffineTransport().fit(X, y),
        "transform": lambda: fitted.transform(X),
        "bare product": lambda: X @ coef + intercept,
        "POT's transform": carry,
        "affine, float32": lambda: AffineTransport().fit(X32, y32),
        "POT, float32": lambda: pot(X32, y32),
        "transform, float32": lambda: fitted.transform(X32),
        "bare product, float32": lambda: X32 @ coef32 + intercept32,
    }
    for name, call in peers.items():
        call(X[: n_features + 10], y[: n_features + 10])  # what JAX compiles, and imports
        calls[name] = lambda call=call: call(X, y)
    wanted = arguments.calls or calls
    seconds = measured({name: call for name, call in calls.items() if name in wanted}, arguments)
    print(f"{n_rows} x {n_features}: ratios of CPU (wall)")
    for label, over, under in (
        *((f"fit: {name} / affine", name, "affine") for name in peers),
        ("fit, float32: POT / affine", "POT, float32", "affine, float32"),
        ("fit: affine / the two products", "affine", "floor"),
        ("fit, off centre: affine / the two products", "affine, off centre", "floor"),
        ("fit, float32: affine / float64's", "affine, float32", "affine"),
        ("fit: POT / the two products", "POT", "floor"),
        ("fit: procrustes / the two products", "procrustes", "floor"),
        ("fit: procrustes / affine", "procrustes", "affine"),
        ("bare: three products / two", "three products", "floor"),
        ("transform: bare product / ours", "bare product", "transform"),
        ("transform: POT / ours", "POT's transform", "transform"),
        ("transform, float32: bare product / ours", "bare product, float32", "transform, float32"),
    ):
        if over in seconds and under in seconds:
            cpu, wall = (seconds[over][kind] / seconds[under][kind] for kind in (0, 1))
            print(f"  {label:44s} {cpu:6.2f} ({wall:.2f})")
    memory = {name: peak(calls[name]) for name in ("affine", "procrustes", "POT") if name in seconds}
    print(
        f"  peak memory of a fit, MB: {', '.join(f'{name} {value / 1e6:.1f}' for name, value in memory.items())}"
    )
    if "POT" in memory and "affine" in memory:
        print(f"  peak memory of a fit: affine / POT {memory['affine'] / memory['POT']:.4f}")
    size = len(pickle.dumps(fitted)) / (fitted.coef_.nbytes + fitted.intercept_.nbytes)
    print(f"  pickle over the map: {size:.2f}\n", flush=True)


def many_small_ones(arguments):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(10_000, 200, 4))
    y = X @ rng.normal(size=(10_000, 4, 4))
    seconds = measured(
        {"batched": lambda: fit_batched(X, y), "bare": lambda: [bare_map(*rows) for rows in zip(X, y)]},
        arguments,
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


def measured(calls, arguments):
    """Return the medians, or the least, of CPU and wall seconds of each call, interleaved."""
    seconds = {name: [] for name in calls}
    for _ in range(arguments.repeats):
        for name, call in calls.items():
            cpu, wall = time.process_time(), time.perf_counter()
            call()
            seconds[name].append((time.process_time() - cpu, time.perf_counter() - wall))
    over_runs = np.min if arguments.least else np.median
    return {name: over_runs(values, axis=0) for name, values in seconds.items()}


def peak(call):
    """Return the largest memory in bytes that a call holds beyond its input."""
    tracemalloc.start()
    call()
    largest = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return largest


if __name__ == "__main__":
    main()
