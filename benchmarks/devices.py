"""What a fit and a transform cost on a GPU, beside bare products there, ott-jax there, and the CPU in the same run.

Run from the root of the repository, where PyTorch finds a CUDA device::

    SCIPY_ARRAY_API=1 PYTHONPATH=. python benchmarks/devices.py

Wall seconds are the median of ``--repeats`` interleaved runs, each ended by the device's own synchronisation, behind
one that is not counted. The floor is the two products X'X and Y'Y on the device. ``digits`` is the largest difference
of the coefficients from those of the CPU in float64, over the largest of them. ott-jax and skada are left out where
they are not installed; JAX runs in float64 on the same device, behind a first call that compiles.
"""

import argparse
import os
import subprocess
import time
from importlib.util import find_spec

import numpy as np
import torch
from sklearn import config_context
from speed import SIZES, version_of

from skat import AffineTransport, ProcrustesAffineTransport

TRANSPORTS = {"affine": AffineTransport, "procrustes": ProcrustesAffineTransport}
PACKAGES = ("torch", "numpy", "scipy", "scikit-learn", "ott-jax", "jax")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="*", default=SIZES)
    parser.add_argument("--repeats", type=int, default=7)
    arguments = parser.parse_args()
    # JAX would take most of the device's memory for itself.
    os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True)
    print(
        f"commit {commit.stdout.strip() or 'unknown'}; {torch.cuda.get_device_name()}, {os.cpu_count()} cores"
    )
    print(", ".join(f"{name} {version_of(name)}" for name in PACKAGES), flush=True)
    for size in arguments.sizes:
        at_size(*map(int, size.split("x")), arguments.repeats)


def at_size(n_rows, n_features, repeats):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(n_rows, n_features))
    y = X @ (np.eye(n_features) + 0.1 * rng.normal(size=(n_features, n_features)))
    y += 0.1 * rng.normal(size=X.shape)
    rows = {
        "float64": tuple(torch.asarray(one, device="cuda") for one in (X, y)),
        "float32": tuple(torch.asarray(one, device="cuda", dtype=torch.float32) for one in (X, y)),
    }
    calls = {f"{name}, CPU": lambda make=make: make().fit(X, y) for name, make in TRANSPORTS.items()}
    reference = {name: make().fit(X, y).coef_ for name, make in TRANSPORTS.items()}
    print(f"\n{n_rows} x {n_features}")
    for dtype, (there_X, there_y) in rows.items():
        calls[f"floor, {dtype}"] = lambda X=there_X, y=there_y: (X.T @ X, y.T @ y)
        for name, make in TRANSPORTS.items():
            fitted = make().fit(there_X, there_y)
            off = np.abs(fitted.coef_.cpu().numpy() - reference[name]).max() / np.abs(reference[name]).max()
            print(f"  digits: {name}, {dtype:<{36 - len(name)}s} {off:.1e}")
            calls[f"{name}, {dtype}"] = lambda make=make, X=there_X, y=there_y: make().fit(X, y)
        fitted = TRANSPORTS["affine"]().fit(there_X, there_y)
        coef, intercept = (part.to(there_X.dtype) for part in (fitted.coef_.T, fitted.intercept_))
        calls[f"transform, {dtype}"] = lambda model=fitted, X=there_X: model.transform(X)
        calls[f"bare, {dtype}"] = lambda X=there_X, coef=coef, intercept=intercept: X @ coef + intercept
    if find_spec("ott") and find_spec("jax"):
        calls["ott-jax, float64"] = ott_on_device(X, y)
    seconds = measured(calls, repeats)
    for label, over, under in (
        ("fit: CPU / affine", "affine, CPU", "affine, float64"),
        ("fit: CPU / procrustes", "procrustes, CPU", "procrustes, float64"),
        ("fit: ott-jax / affine", "ott-jax, float64", "affine, float64"),
        ("fit: affine / the two products", "affine, float64", "floor, float64"),
        ("fit: affine / the two products, float32", "affine, float32", "floor, float32"),
        ("fit: float32 / float64", "affine, float32", "affine, float64"),
        ("transform: bare product / ours", "bare, float64", "transform, float64"),
        ("transform, float32: bare product / ours", "bare, float32", "transform, float32"),
    ):
        if over in seconds and under in seconds:
            print(f"  {label:46s} {seconds[over] / seconds[under]:8.2f}")
    print("  ms: " + ", ".join(f"{name} {1e3 * value:.2f}" for name, value in seconds.items()), flush=True)


def ott_on_device(X, y):
    import jax
    from ott.tools.gaussian_mixture.gaussian import Gaussian

    jax.config.update("jax_enable_x64", True)
    there_X, there_y = (jax.device_put(rows) for rows in (X, y))

    def fit():
        source, target = Gaussian.from_samples(there_X), Gaussian.from_samples(there_y)
        source.transport(target, there_X[:1]).block_until_ready()

    return fit


def measured(calls, repeats):
    """Return the median seconds of each call, interleaved, each until the device is done."""
    seconds = {name: [] for name in calls}
    for run in range(repeats + 1):
        for name, call in calls.items():
            torch.cuda.synchronize()
            start = time.perf_counter()
            call()
            torch.cuda.synchronize()
            if run:
                seconds[name].append(time.perf_counter() - start)
    return {name: float(np.median(values)) for name, values in seconds.items()}


if __name__ == "__main__":
    with config_context(array_api_dispatch=True):
        main()
