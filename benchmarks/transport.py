"""Time, memory and error of affine transport beside its peers.

Run with the `bench` extra installed::

    python benchmarks/transport.py | tee benchmarks/results/transport.txt
    python benchmarks/transport.py --small            # a cut of a minute

ADAPT needs TensorFlow and an older scikit-learn, so it runs in an environment of its own; without it, its
rows are left out with a message::

    python3.11 -m venv adapt-env
    adapt-env/bin/pip install adapt tensorflow-cpu tf-keras "scikit-learn<1.6"
    python benchmarks/transport.py --adapt-python adapt-env/bin/python

What is measured

- time: wall time of each call, the median over repeats; the methods take turns within a repeat. ADAPT, in a
  process of its own, cannot take turns. On a machine that others use at the same time, ``--clock cpu`` with
  ``OMP_NUM_THREADS=1`` measures CPU time instead.
- floor: time of the two bare products X'X and Y'Y, which any method that reads the rows once has to pay.
- memory: peak resident memory of a fresh process over that just before ``fit``, with the arrays loaded.
- covariance, mean: relative distance of the carried rows' covariance from the target's, and of their mean
  in units of the target's spread.
- map error: relative Frobenius distance of the coefficient from a reference, computed by mpmath to 150 digits
  from the very floating-point numbers of the rows. CORAL is not the optimal map, so it has none.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

LARGE = {
    "1e6 x 30": (1_000_000, 30),
    "1e5 x 200": (100_000, 200),
    "2e4 x 2000": (20_000, 2000),
    "200 x 1000": (200, 1000),
}
SMALL = {
    "5e4 x 30": (50_000, 30),
    "5e3 x 200": (5_000, 200),
    "2e3 x 300": (2_000, 300),
    "50 x 200": (50, 200),
}
# Case -> least ratio of POT's fit time to skat's, largest ratio of skat's fit time to the floor's.
TARGETS = {"1e6 x 30": (1.5, 1.5), "1e5 x 200": (1.5, 1.5), "2e4 x 2000": (2.0, 2.2)}
LEAST_SPEED_UP_OVER_SKADA = 3.0
LEAST_TRANSFORM_SPEED = 0.8
LARGEST_MEMORY_RATIO = 0.5
LARGEST_TIME_OF_2000_BY_10 = 2e-3
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}


# --- methods: fit on X and y, carry X, tell the coefficient ---------------------------------------


@dataclass
class Calls:
    """What is timed of a method on some rows."""

    fit: Callable
    transform: Callable | None = None
    coef: Callable = lambda: None


def skat(X, y):
    from skat.transport import AffineTransport

    model = AffineTransport()
    return Calls(lambda: model.fit(X, y), lambda: model.transform(X), lambda: model.coef_)


def pot(X, y):
    import ot

    model = ot.da.LinearTransport()
    return Calls(lambda: model.fit(Xs=X, Xt=y), lambda: model.transform(Xs=X), lambda: model.A_.T)


def skada(X, y):
    from skada import LinearOTMappingAdapter

    model = LinearOTMappingAdapter()
    calls = stacked(model, X, y)
    calls.coef = lambda: model.ot_transport_.A_.T
    return calls


def skada_coral(X, y):
    from skada import CORALAdapter

    return stacked(CORALAdapter(), X, y)


def stacked(model, X, y):
    """Return the calls of a skada adapter; stacking the rows is not timed."""
    rows, domain = np.vstack([X, y]), np.repeat([1, -1], [len(X), len(y)])

    def transform():
        return np.asarray(model.transform(rows, sample_domain=domain, allow_source=True))[: len(X)]

    return Calls(lambda: model.fit(rows, None, sample_domain=domain), transform)


def adapt_coral(X, y):
    os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
    from adapt.feature_based import CORAL

    model = CORAL(lambda_=1e-8, verbose=0)
    return Calls(lambda: model.fit_transform(X, y), lambda: np.asarray(model.transform(X, domain="src")))


def floor(X, y):
    return Calls(lambda: (X.T @ X, y.T @ y))


METHODS = {
    "skat": skat,
    "POT": pot,
    "skada": skada,
    "skada CORAL": skada_coral,
    "ADAPT CORAL": adapt_coral,
    "floor": floor,
}


# --- one process: repeats of a case, or one fit for its memory ------------------------------------


def work(arguments):
    """Print, as JSON, what one process measures of some methods on the rows of a file."""
    X, y = (np.load(Path(arguments.rows) / f"{name}.npy") for name in "Xy")
    names = arguments.methods.split(",")
    warnings.simplefilter("ignore")
    clock = CLOCKS[arguments.clock]
    report = (
        memory_of(names[0], X, y) if arguments.memory else times_of(names, X, y, arguments.repeats, clock)
    )
    print("RESULT" + json.dumps(report))


def memory_of(name, X, y):
    warm_up(name)
    calls = METHODS[name](X, y)
    before = peak_bytes()
    calls.fit()
    return {"bytes": peak_bytes() - before}


def peak_bytes():
    """Return this process's peak memory; getrusage would count that of the process which started it, too."""
    status = Path("/proc/self/status")
    if status.exists():
        (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return 1024 * int(line.split()[1])
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def warm_up(name):
    """Fit tiny rows first, so that imports and threads are there before anything is measured."""
    METHODS[name](*np.random.default_rng(0).normal(size=(2, 50, 3))).fit()


def times_of(names, X, y, repeats, clock):
    reports = {name: {"fit": [], "transform": []} for name in names}
    for name in names:
        warm_up(name)
    for repeat in range(repeats):
        for name, report in reports.items():
            if "failure" not in report:
                calls = METHODS[name](X, y)
                try:
                    report["fit"].append(seconds(calls.fit, clock))
                    if calls.transform:
                        report["transform"].append(seconds(calls.transform, clock))
                        report |= residuals(calls, X, y) if repeat == 0 else {}
                except Exception as failure:
                    report["failure"] = f"{type(failure).__name__}: {failure}".splitlines()[0]
    return reports


def seconds(call, clock):
    start = clock()
    call()
    return clock() - start


def residuals(calls, X, y):
    """Return how far the carried rows' moments are from the target's, and the coefficient of small maps."""
    carried, target = (np.asarray(rows, dtype=np.float64) for rows in (calls.transform(), y))
    report = {}
    if np.isfinite(carried).all():
        of_carried, of_target = (np.cov(rows.T, ddof=0) for rows in (carried, target))
        report["covariance"] = float(np.linalg.norm(of_carried - of_target) / np.linalg.norm(of_target))
        shift = np.linalg.norm(carried.mean(axis=0) - target.mean(axis=0))
        report["mean"] = float(shift / np.sqrt(np.trace(of_target)))
    coef = calls.coef()
    if coef is not None and len(coef) <= 50:
        report["coef"] = np.asarray(coef, dtype=np.float64).tolist()
    return report


# --- cases ----------------------------------------------------------------------------------------


def plain_rows(n_rows, n_features, seed=0):
    """Rows of two normal laws with covariances of condition about 100."""
    rng = np.random.default_rng(seed)
    samples = []
    for _ in range(2):
        turn, _ = np.linalg.qr(rng.normal(size=(n_features, n_features)))
        root = turn * np.logspace(0, -1, n_features)
        rows = rng.normal(size=(n_rows, n_features)) @ root.T
        rows += rng.normal(size=n_features)
        samples.append(rows)
    return samples


def hard_rows(n_rows=1000, n_features=8):
    """Return the cases that peers are known to fail at: name -> source and target rows."""
    rng = np.random.default_rng(1)

    def rows_of_condition(condition, n=n_rows, d=n_features):
        turn, _ = np.linalg.qr(rng.normal(size=(d, d)))
        return rng.normal(size=(n, d)) @ (np.logspace(0, -0.5 * np.log10(condition), d)[:, np.newaxis] * turn)

    X, y = rows_of_condition(100), rows_of_condition(100)
    mixed = np.logspace(-6, 6, n_features)
    return {
        "condition 1e12": (rows_of_condition(1e12), y),
        "micro-units": (1e-6 * X, 1e-6 * y),
        "duplicated columns": (np.hstack([X, X[:, :2]]), np.hstack([y, y[:, :2]])),
        "mixed units": (X * mixed, y * mixed),
        "float32, condition 1e7": (rows_of_condition(1e7).astype(np.float32), y.astype(np.float32)),
        "n < d": (rows_of_condition(10, 15, 20), rows_of_condition(10, 10, 20)),
    }


def reference_map(X, y, digits=150):
    """Return the map of least rank between the rows' covariances, from their exact values."""
    from mpmath import mp

    with mp.workdps(digits):
        source, target = (covariance_of(rows, mp) for rows in (X, y))
        root = power(target, 0.5, mp)
        middle = power(root * source * root, -0.5, mp)
        coef = root * middle * root
        return np.array(coef.tolist(), dtype=np.float64)


def covariance_of(rows, mp):
    rows = mp.matrix(np.asarray(rows, dtype=np.float64).tolist())
    for column in range(rows.cols):
        mean = mp.fsum(rows[k, column] for k in range(rows.rows)) / rows.rows
        for k in range(rows.rows):
            rows[k, column] -= mean
    return rows.T * rows / rows.rows


def power(matrix, exponent, mp):
    """Return a power of a positive semi-definite matrix; directions of no variance stay at zero."""
    values, vectors = mp.eigsy((matrix + matrix.T) / 2)
    largest = max(values)
    scaled = [value**exponent if value > largest * mp.mpf(10) ** -100 else mp.mpf(0) for value in values]
    return vectors * mp.diag(scaled) * vectors.T


# --- the tables -----------------------------------------------------------------------------------


@dataclass
class Settings:
    """How to measure."""

    peers: list
    adapt_python: str | None
    repeats: int
    clock: str

    def measured(self, X, y, repeats=None, with_memory=True):
        """Return the report of every method on some rows."""
        with tempfile.TemporaryDirectory() as rows:
            np.save(Path(rows) / "X.npy", X)
            np.save(Path(rows) / "y.npy", y)
            options = ["--rows", rows, "--clock", self.clock, "--repeats", str(repeats or self.repeats)]
            reports = in_a_process(sys.executable, options, ["skat", *self.peers, "floor"])
            if self.adapt_python:
                reports |= in_a_process(self.adapt_python, options, ["ADAPT CORAL"])
            for name, report in reports.items():
                if with_memory and "failure" not in report and name != "floor":
                    python = self.adapt_python if name == "ADAPT CORAL" else sys.executable
                    report["memory"] = in_a_process(python, [*options, "--memory"], [name]).get(
                        "bytes", np.nan
                    )
        return reports


def in_a_process(python, options, methods):
    command = [python, __file__, "--worker", "--methods", ",".join(methods), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = [line for line in done.stdout.splitlines() if line.startswith("RESULT")]
    if not lines:
        tail = (done.stderr.strip().splitlines() or ["nothing"])[-1]
        return {name: {"failure": f"process ended with {done.returncode}: {tail}"} for name in methods}
    return json.loads(lines[-1].removeprefix("RESULT"))


def median(report, call):
    return float(np.median(report[call])) if report.get(call) else np.nan


def print_sizes(cases, settings):
    verdicts = []
    head = f"{'case':<12}{'method':<14}{'fit s':>10}{'transform s':>13}"
    print(f"{head}{'memory MB':>11}{'covariance':>12}{'mean':>10}")
    for case, shape in cases.items():
        reports = settings.measured(*plain_rows(*shape))
        for name, report in reports.items():
            print(line_of(case, name, report), flush=True)
        verdicts += verdicts_of(case, reports)
        print(flush=True)
    return verdicts


def line_of(case, name, report):
    if "failure" in report:
        return f"{case:<12}{name:<14}{report['failure'][:90]}"
    transform = median(report, "transform")
    cells = f"{case:<12}{name:<14}{median(report, 'fit'):>10.4f}"
    cells += f"{transform:>13.4f}" if np.isfinite(transform) else f"{'':>13}"
    cells += f"{report['memory'] / 1e6:>11.1f}" if "memory" in report else f"{'':>11}"
    if "covariance" in report:
        cells += f"{report['covariance']:>12.1e}{report['mean']:>10.1e}"
    elif name != "floor":
        cells += "  the carried rows are not finite"
    return cells


def verdicts_of(case, reports):
    """Return lines that compare the measured ratios with what is wanted of them."""
    fit = {name: median(report, "fit") for name, report in reports.items()}
    transform = {name: median(report, "transform") for name, report in reports.items()}
    memory = {name: report.get("memory", np.nan) for name, report in reports.items()}
    lines = []
    if case in TARGETS:
        over_pot, over_floor = TARGETS[case]
        lines.append(verdict(case, "fit, POT / skat", fit.get("POT", np.nan) / fit["skat"], ">=", over_pot))
        lines.append(
            verdict(
                case,
                "fit, skada / skat",
                fit.get("skada", np.nan) / fit["skat"],
                ">=",
                LEAST_SPEED_UP_OVER_SKADA,
            )
        )
        lines.append(verdict(case, "fit, skat / floor", fit["skat"] / fit["floor"], "<=", over_floor))
        ratio = transform.get("POT", np.nan) / transform["skat"]
        lines.append(verdict(case, "transform, POT / skat", ratio, ">=", LEAST_TRANSFORM_SPEED))
        ratio = memory["skat"] / memory.get("POT", np.nan)
        lines.append(verdict(case, "memory, skat / POT", ratio, "<=", LARGEST_MEMORY_RATIO))
    return lines


def verdict(case, what, value, sign, bound):
    holds = value >= bound if sign == ">=" else value <= bound
    word = "not measured" if np.isnan(value) else "holds" if holds else "DOES NOT HOLD"
    return f"{case:<12}{what:<24}{value:>9.3g} {sign} {bound:<8g}{word}"


def print_hard(settings):
    print(f"{'hard case':<26}{'method':<14}{'map error':>11}{'covariance':>12}{'mean':>10}")
    for case, (X, y) in hard_rows().items():
        reference = reference_map(X, y)
        reports = settings.measured(X, y, repeats=1, with_memory=False)
        del reports["floor"]
        for name, report in reports.items():
            if "failure" in report:
                print(f"{case:<26}{name:<14}{report['failure'][:90]}")
                continue
            error = ""
            if "coef" in report:
                coef = np.array(report["coef"])
                error = f"{np.linalg.norm(coef - reference) / np.linalg.norm(reference):.1e}"
            cells = f"{case:<26}{name:<14}{error:>11}"
            cells += (
                f"{report['covariance']:>12.1e}{report['mean']:>10.1e}"
                if "covariance" in report
                else "   not finite"
            )
            print(cells, flush=True)
        print()


def installed_peers():
    """Return the peers that run in this interpreter, with a line about each package."""
    import ot
    import sklearn

    packages = [f"POT {ot.__version__}", f"numpy {np.__version__}", f"scikit-learn {sklearn.__version__}"]
    try:
        import skada as skada_package
    except ImportError:
        print("skada is not installed, so its rows are left out: pip install 'skat[bench]'.")
        return ["POT"], packages
    return ["POT", "skada", "skada CORAL"], [*packages, f"skada {skada_package.__version__}"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--small", action="store_true", help="a cut of a few minutes: small arrays, no targets"
    )
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument(
        "--cases", nargs="*", help="some of the sizes, such as '1e6 x 30'; none without a name"
    )
    parser.add_argument("--no-hard", action="store_true", help="leave the hard cases out")
    parser.add_argument("--peers", help="some of POT,skada,skada CORAL")
    parser.add_argument("--clock", choices=CLOCKS, default="wall", help="cpu on a machine that others use")
    parser.add_argument("--adapt-python", help="interpreter of an environment with ADAPT")
    for option in ("--worker", "--memory"):
        parser.add_argument(option, action="store_true", help=argparse.SUPPRESS)
    for option in ("--rows", "--methods"):
        parser.add_argument(option, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        work(arguments)
        return
    peers, packages = installed_peers()
    if arguments.peers:
        peers = arguments.peers.split(",")
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    print(f"{', '.join(packages)}, Python {platform.python_version()}")
    threads = os.environ.get("OMP_NUM_THREADS", "all")
    print(f"{cores} cores, load {load:.1f} before the run, {arguments.clock} time, BLAS threads: {threads}")
    if not arguments.adapt_python:
        print("ADAPT is left out: see the head of this script for an environment, and --adapt-python.")
    print()
    settings = Settings(peers, arguments.adapt_python, arguments.repeats, arguments.clock)
    cases = SMALL if arguments.small else LARGE
    if arguments.cases is not None:
        cases = {name: shape for name, shape in cases.items() if name in arguments.cases}
    verdicts = print_sizes(cases, settings)
    if cases and not arguments.small:
        reports = settings.measured(*plain_rows(2000, 10), repeats=50, with_memory=False)
        small = median(reports["skat"], "fit")
        verdicts.append(verdict("2000 x 10", "fit s", small, "<=", LARGEST_TIME_OF_2000_BY_10))
    if not arguments.no_hard:
        print_hard(settings)
    print("\n".join(verdicts))


if __name__ == "__main__":
    main()
