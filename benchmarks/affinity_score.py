"""How the affinity score and its kin behave where the truth is known.

Run::

    python benchmarks/affinity_score.py | tee benchmarks/results/affinity_score.txt
    python benchmarks/affinity_score.py --small       # a cut of half a minute

Source rows are normal with unit covariance; target rows have independent components of unit variance and one
law, turned by a random rotation. The population's score is then that of one component, a one-dimensional
integral.
"""

import argparse
import time
import tracemalloc
import warnings
from functools import cache

import numpy as np
from joblib import Parallel, delayed
from scipy.stats import norm

from skat.metrics import (
    affinity_estimate,
    affinity_score,
    affinity_test,
    affinity_upper_bound,
    debiased_affinity_score,
)
from skat.transport import AffineTransport, ProcrustesAffineTransport


def normal(rng, shape):
    return rng.normal(size=shape)


def uniform(rng, shape):
    return rng.uniform(-np.sqrt(3), np.sqrt(3), size=shape)


def exponential(rng, shape):
    return rng.exponential(size=shape) - 1


def heavy_tailed(rng, shape):
    return rng.standard_t(5, size=shape) / np.sqrt(5 / 3)


def bimodal(rng, shape):
    return 0.95 * rng.choice([-1.0, 1.0], size=shape) + np.sqrt(1 - 0.95**2) * rng.normal(size=shape)


LAWS = (normal, uniform, exponential, heavy_tailed, bimodal)


def turned(law, rng, n_rows, n_features):
    turn, _ = np.linalg.qr(rng.normal(size=(n_features, n_features)))
    return law(rng, (n_rows, n_features)) @ turn


@cache
def population_score(law):
    component = np.sort(law(np.random.default_rng(0), 2_000_000))
    quantiles = norm.ppf((np.arange(len(component)) + 0.5) / len(component))
    return 1 - np.sqrt(np.square(component - quantiles).mean() / 2) if law is not normal else 1.0


def many(function, n_trials, n_jobs):
    """Return the results of a function of a generator, in rows."""
    generators = np.random.default_rng(0).spawn(n_trials)
    return np.array(Parallel(n_jobs=n_jobs)(delayed(function)(rng) for rng in generators))


def bias_of_rho(dimensions, sizes, n_trials, n_jobs):
    print("Score of two samples of one normal law (population value 1): mean +- standard deviation")
    print(f"{'features':>8}" + "".join(f"{f'n = {size}':>18}" for size in sizes))
    for n_features in dimensions:
        cells = []
        for n_rows in sizes:

            def trial(rng, n_rows=n_rows, n_features=n_features):
                return affinity_score(*rng.normal(size=(2, n_rows, n_features)))

            scores = many(trial, n_trials, n_jobs)
            cells.append(f"{scores.mean():>10.3f} +- {scores.std():.3f}")
        print(f"{n_features:>8}" + "".join(cells), flush=True)
    print()


def powers(dimensions, n_rows, n_trials, n_jobs):
    print(
        f"Share of tests that reject normal source rows at 5 %, {n_rows} rows, {n_trials} trials, 19 shuffles each"
    )
    print(f"{'features':>8}" + "".join(f"{law.__name__:>14}" for law in LAWS[1:]))
    for n_features in dimensions:
        cells = f"{n_features:>8}"
        for law in LAWS[1:]:

            def p_value(rng, n_features=n_features, law=law):
                seed = int(rng.integers(2**31))
                X, y = (each(rng, (n_rows, n_features)) for each in (normal, law))
                return affinity_test(X, y, n_permutations=19, random_state=seed).p_value

            cells += f"{(many(p_value, n_trials, n_jobs) <= 0.05).mean():>14.3f}"
        print(cells, flush=True)
    print()


def levels(in_sample, cases, n_trials, n_jobs):
    rows = "the rows that it was fitted to, in_sample=True" if in_sample else "rows held out"
    print(f"Share of tests that reject a right map at 5 %, {rows}: {n_trials} trials, 19 shuffles each")
    print(f"{'source':>8}{'target':>8}{'features':>10}" + "".join(f"{law.__name__:>14}" for law in LAWS))
    table = []
    for n_source, n_target, n_features in cases:
        shares = []
        for law in LAWS:

            def p_value(rng, law=law, n_source=n_source, n_target=n_target, n_features=n_features):
                seed = int(rng.integers(2**31))
                X, y = law(rng, (n_source, n_features)), law(rng, (n_target, n_features))
                if in_sample:
                    X = AffineTransport().fit(X, y).transform(X)
                options = {"in_sample": in_sample, "n_permutations": 19, "random_state": seed}
                return affinity_test(X, y, **options).p_value

            shares.append((many(p_value, n_trials, n_jobs) <= 0.05).mean())
        table.append(shares)
        cells = "".join(f"{share:>14.3f}" for share in shares)
        print(f"{n_source:>8}{n_target:>8}{n_features:>10}" + cells, flush=True)
    print(f"{'mean':<26}" + "".join(f"{share:>14.3f}" for share in np.mean(table, axis=0)))
    ought_to_be(0.05, n_trials)


def levels_of_pairs(noises, n_rows, n_features, n_trials, n_jobs):
    print(
        f"Share of tests that reject a right map at 5 %, {n_rows} pairs, {n_features} features, {n_trials} trials, "
        "19 shuffles each"
    )
    print(f"{'map':<28}{'noise':>6}" + "".join(f"{law.__name__:>14}" for law in LAWS))
    maps = {
        "held out": None,
        "AffineTransport, in sample": AffineTransport(),
        "Procrustes, in sample": ProcrustesAffineTransport(),
    }
    for name, transport in maps.items():
        for noise in noises:
            cells = ""
            for law in LAWS:

                def p_value(rng, transport=transport, noise=noise, law=law):
                    seed = int(rng.integers(2**31))
                    X, y = law(rng, (n_rows, n_features)) + noise * rng.normal(size=(2, n_rows, n_features))
                    if transport is not None:
                        with warnings.catch_warnings():
                            # With this much noise some right pairs look shuffled.
                            warnings.filterwarnings("ignore", message="the pairs carry no correlation")
                            X = transport.fit(X, y).transform(X)
                    options = {"in_sample": transport is not None, "n_permutations": 19, "random_state": seed}
                    return affinity_test(X, y, paired=True, **options).p_value

                cells += f"{(many(p_value, n_trials, n_jobs) <= 0.05).mean():>14.3f}"
            print(f"{name:<28}{noise:>6}{cells}", flush=True)
    ought_to_be(0.05, n_trials)


def ought_to_be(level, n_trials):
    error = np.sqrt(level * (1 - level) / n_trials)
    print(f"Each share ought to be {level}, with a standard error of {error:.3f}.\n")


def debiased_and_bound(dimensions, n_rows, n_trials, n_jobs):
    print(f"Scores of {n_rows} rows, from means of squared distances over {n_trials} trials")
    print(f"{'law':<14}{'features':>8}{'population':>12}{'plain':>9}{'debiased':>10}{'bound':>8}")
    for law in LAWS:
        for n_features in dimensions:

            def squares(rng, law=law, n_features=n_features):
                X, y = rng.normal(size=(n_rows, n_features)), turned(law, rng, n_rows, n_features)
                seed = int(rng.integers(2**31))
                scores = np.array(
                    [
                        affinity_score(X, y),
                        debiased_affinity_score(X, y, n_repeats=2, random_state=seed),
                        affinity_upper_bound(X, y, random_state=seed),
                    ]
                )
                return np.sign(1 - scores) * np.square(1 - scores)

            mean = many(squares, n_trials, n_jobs).mean(axis=0)
            plain, debiased, bound = 1 - np.sign(mean) * np.sqrt(np.abs(mean))
            print(
                f"{law.__name__:<14}{n_features:>8}{population_score(law):>12.3f}{plain:>9.3f}"
                f"{debiased:>10.3f}{bound:>8.3f}",
                flush=True,
            )
    print()


def estimates(n_rows, dimensions, n_jobs):
    print(f"affinity_estimate of {n_rows} rows, default options, n_jobs={n_jobs}")
    for law in LAWS:
        population_score(law)
    head = f"{'law':<14}{'features':>8}{'population':>12}{'lower':>8}{'score':>8}{'upper':>8}{'bias':>8}"
    print(f"{head}{'wall s':>8}{'CPU s':>8}")
    rng = np.random.default_rng(0)
    for n_features in dimensions:
        for law in LAWS:
            X, y = rng.normal(size=(n_rows, n_features)), turned(law, rng, n_rows, n_features)
            wall, cpu = time.perf_counter(), time.process_time()
            estimate = affinity_estimate(X, y, n_jobs=n_jobs, random_state=0)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            truth = population_score(law)
            cells = f"{law.__name__:<14}{n_features:>8}{truth:>12.3f}{estimate.lower:>8.3f}"
            cells += f"{estimate.score:>8.3f}"
            cells += f"{estimate.upper:>8.3f}{estimate.score - truth:>8.3f}{wall:>8.2f}{cpu:>8.2f}"
            print(cells, flush=True)
        sizes = (n_rows // 4, n_rows // 2, n_rows)
        cells = [f"{peak_bytes(X[:size], y[:size]) / 1e6:.0f} at {size}" for size in sizes]
        rows = f"the rows themselves have {2 * X.nbytes / 1e6:.0f}"
        print(f"Peak of allocations, MB: {', '.join(cells)} rows; {rows}.\n")


def peak_bytes(X, y):
    tracemalloc.start()
    affinity_estimate(X, y, random_state=0)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


# Source rows, target rows, features.
FEW_ROWS = ((40, 40, 2), (60, 60, 2), (60, 60, 5), (40, 40, 10), (200, 40, 5))

# Table -> function, and its arguments in full and in the small cut.
TABLES = {
    "estimate": (estimates, (100_000, (27,)), (20_000, (27,))),
    "bias": (bias_of_rho, ((2, 5, 10, 27, 62), (100, 1000), 20), ((2, 27), (100, 500), 4)),
    "power": (powers, ((2, 10, 27), 100, 100), ((2,), 50, 40)),
    "scores": (debiased_and_bound, ((2, 10, 27), 1000, 6), ((2, 27), 300, 4)),
    "level": (levels, (False, FEW_ROWS, 250), (False, FEW_ROWS[:1], 40)),
    "fitted": (levels, (True, FEW_ROWS, 250), (True, FEW_ROWS[:1], 40)),
    "pairs": (levels_of_pairs, ((0.1, 1.0), 40, 2, 150), ((0.1, 1.0), 40, 2, 20)),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--small", action="store_true", help="a cut of half a minute")
    parser.add_argument("--tables", nargs="+", choices=TABLES, default=list(TABLES))
    parser.add_argument("--n-jobs", type=int, default=2)
    arguments = parser.parse_args()
    for name in arguments.tables:
        table, in_full, small = TABLES[name]
        table(*(small if arguments.small else in_full), arguments.n_jobs)


if __name__ == "__main__":
    main()
