"""The paper's experiments in full, as tables for the documentation.

Run from the root of the repository::

    python benchmarks/experiments.py                      # everything, up to an hour on 2 cores
    python benchmarks/experiments.py hopper puck          # some of it
    python benchmarks/experiments.py --small              # a cut of two minutes, for a look

A robot's table is made in pieces, one for each seed, number of rows, world to carry from and method, which are kept
in ``--pieces`` and not made again, so that a run that was ended goes on where it was. Runs of other methods may share
the folder; a table is written once all of its pieces are there.

Each experiment writes ``benchmarks/results/experiments_<name>.csv``, a robot's one for each number of rows; the pucks'
also ``experiments_puck_paper.csv``, in the columns of the paper, and a robot's ``experiments_<robot>_covariance.csv``,
which compares a transport and regressions by every measure of covariance. "between" asks whether any map between
least squares and a transport would keep the covariance better with few rows. Bounds that the medians of a robot are
to keep are printed with whether they hold. Seeds are 0, 1, 2 for robots and pucks, and 0 for the others.
"""

import argparse
import subprocess
import time
from pathlib import Path

import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.linear_model import LinearRegression

from skat import ProcrustesAffineTransport
from skat.experiments import domain_matrix, in_columns_of_paper, puck_learning_curve, puck_table
from skat.experiments.methods import METHODS, RegressionTransport
from skat.experiments.puck import SIMULATIONS, UNPAIRED_CURVE_METHODS
from skat.experiments.robots import CONDITIONS, COVARIANCE_MEASURES, MEASURES

RESULTS = Path(__file__).parent / "results"
SEEDS = (0, 1, 2)
ROBOTS = ("hopper", "halfcheetah", "ant")
SIZES = (2000, 200)
SMALL_WORLDS = ("normal", "heavy", "inverted")
# Largest median of error after / before: of the best method that sees pairs, and of the best that sees none.
PAIRED_BOUNDS = {"hopper": 0.145, "halfcheetah": 0.22, "ant": 0.46}
UNPAIRED_BOUNDS = {"hopper": 0.26, "halfcheetah": 0.28, "ant": 0.60}
UNPAIRED_BOUND_OF_ANT_WITH_200 = 1.05
# What a residual may cost in the median with 200 pairs.
MOST_OF_BASE = 1.02
COVARIANCE_METHODS = ("procrustes_whitened", "conditional", "least_squares", "ridge_on_residual")
MEASURED_STRIKES, SIMULATED_STRIKES = 20, (8, 20, 60, 200, 600)
# A diagnosis needs few rows, and its time grows with their number.
DIAGNOSIS_ROWS = 200
# Columns of state and action in a robot's rows, and shares of the way from least squares to whitened Procrustes.
CONTEXT = {"hopper": 14, "halfcheetah": 23, "ant": 35}
SHARES = (0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
DIAGNOSIS_METHODS = ("affine", "procrustes_whitened", "least_squares", "ridge_on_residual", "diagnosis")


def main():
    names = (*ROBOTS, "puck", "learning_curve", "diagnosis", "between")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=names, help=f"Which: {', '.join(names)}")
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--pieces", type=Path, default=Path("build/experiments"))
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument(
        "--methods", nargs="+", help="Make the pieces of some of a robot's methods, no table."
    )
    parser.add_argument("--without", nargs="+", default=(), help="Leave methods out of a robot's tables.")
    parser.add_argument("--scored", type=int, default=500, help="Rows that rho is of.")
    arguments = parser.parse_args()
    arguments.results.mkdir(exist_ok=True)
    for name in arguments.names:
        if name not in names:
            parser.error(f"unknown experiment {name!r}. There are: {', '.join(names)}")
        began, began_cpu = time.perf_counter(), time.process_time()
        tables = tables_of(name, arguments)
        for suffix, table in tables.items():
            path = arguments.results / f"experiments_{name}{suffix}.csv"
            table.to_csv(path, index=False, float_format="%.4g")
            print(f"\n{path.name}\n{table.to_string(index=False)}")
        if name in ROBOTS and tables and not arguments.small:
            medians = pd.concat([tables[f"_{size}"] for size in arguments.sizes])
            for line, holds in bounds(medians, name):
                print(f"{'holds' if holds else 'DOES NOT HOLD'}: {line}")
        seconds, cpu_seconds = time.perf_counter() - began, time.process_time() - began_cpu
        print(f"{name}: {seconds:.0f} s, {cpu_seconds:.0f} s of processor time", flush=True)


def tables_of(name, arguments):
    """Return the tables of an experiment by what their files' names end in."""
    small = arguments.small
    if name == "puck":
        return pucks(arguments)
    if name == "learning_curve":
        return {"": curves(small), "_simulated": curves(small, MEASURED_STRIKES)}
    if name == "between":
        return {"": between(small)}
    return {"": diagnoses(small)} if name == "diagnosis" else robots(name, arguments)


def robots(name, arguments):
    """Return medians over the ordered pairs of worlds, and those of the covariance by every measure."""
    arguments.pieces.mkdir(parents=True, exist_ok=True)
    cases = [(size, seed) for size in sorted(arguments.sizes) for seed in arguments.seeds]
    pieces = {case: seed_table(name, *case, arguments) for case in cases}
    if arguments.methods:
        return {}
    tables = {
        size: over_seeds([pieces[size, seed] for seed in arguments.seeds]) for size in sorted(arguments.sizes)
    }
    return {
        **{f"_{size}": robot_medians(table, size) for size, table in tables.items()},
        "_covariance": pd.concat([covariances(table, size) for size, table in tables.items()]),
    }


def seed_table(robot, size, seed, arguments):
    """Return the table of one seed and number of rows, making what has no file yet."""
    folder = arguments.pieces / f"{robot}_{size}_{seed}{'_small' if arguments.small else ''}"
    folder.mkdir(exist_ok=True)
    conditions = SMALL_WORLDS if arguments.small else CONDITIONS
    methods = [name for name in arguments.methods or METHODS if name not in arguments.without]
    paths = {(source, name): folder / f"{source}_{name}.csv" for name in methods for source in conditions}
    missing = [case for case, path in paths.items() if not path.exists()]
    # What takes long is made world by world, so that less is lost where a run ends; the others simulate once.
    quick = {name for name in methods if not name.startswith("residual")}
    together = [{source for source, name in missing if name in quick}] + [{source} for source in conditions]
    for sources, names in zip(together, [quick] + [set(methods) - quick] * len(conditions)):
        wanted = [case for case in missing if case[0] in sources and case[1] in names]
        if not wanted:
            continue
        table = domain_matrix(
            robot,
            n_transitions=size,
            methods=list(dict.fromkeys(name for _, name in wanted)),
            n_repeats=1,
            random_state=seed,
            sources=sorted(sources, key=conditions.index),
            conditions=conditions,
            n_test=500 if arguments.small else 2000,
            n_scored=arguments.scored,
        )
        for case, rows in table.groupby(["source", "method"]):
            unfinished = paths[case].with_suffix(".part")
            rows.to_csv(unfinished, index=False)
            unfinished.rename(paths[case])
        print(f"{folder.name} at {commit()}: {', '.join(map(' '.join, wanted))}", flush=True)
    return pd.concat([pd.read_csv(path) for path in paths.values()])


def over_seeds(tables):
    """Return means over the seeds, and the standard deviation of the error from seed to seed."""
    groups = pd.concat(tables).groupby(["source", "target", "method"], sort=False)
    means = groups[[*MEASURES]].mean()
    return means.assign(error_after_std=groups["error_after"].std()).reset_index()


def commit():
    """Return what the code is at, as Git or the builder of a copy says."""
    if (given := Path("COMMIT")).exists():
        return given.read_text().strip()
    said = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True)
    return said.stdout.strip() or "unknown commit"


class Between(TransformerMixin, BaseEstimator):
    """A share of the way from least squares on pairs to the whitened Procrustes transport."""

    def __init__(self, context, share):
        self.context = context
        self.share = share

    def fit(self, X, y):
        """Fit both to pairs of rows."""
        self.regression_ = RegressionTransport(LinearRegression(), context=self.context).fit(X, y)
        self.transport_ = ProcrustesAffineTransport(alignment="whitened").fit(X, y)
        return self

    def transform(self, X):
        """Carry rows by the weighted mean of both."""
        return (1 - self.share) * self.regression_.transform(X) + self.share * self.transport_.transform(X)


def between(small):
    """Return medians over the pairs of worlds with 200 rows, by robot and share of the way."""
    options = {"conditions": SMALL_WORLDS, "n_repeats": 1, "n_test": 500} if small else {}
    records = []
    for robot in ROBOTS:
        methods = {str(share): Between(CONTEXT[robot], share) for share in SHARES}
        table = domain_matrix(robot, n_transitions=SIZES[-1], methods=methods, n_scored=50, **options)
        table = table.assign(ratio=table["error_after"] / table["error_before"])
        medians = table.groupby("method", sort=False)[["ratio", *COVARIANCE_MEASURES]].median()
        records.append(medians.reset_index(names="share").assign(robot=robot))
    return pd.concat(records)[["robot", "share", "ratio", *COVARIANCE_MEASURES]]


def diagnoses(small):
    """Return error after / before from Hopper's normal world, the diagnosis' extended simulator among others."""
    options = {"conditions": SMALL_WORLDS[:2], "n_test": 500} if small else {}
    options |= {"n_transitions": DIAGNOSIS_ROWS, "n_repeats": 1}
    table = domain_matrix("hopper", methods=DIAGNOSIS_METHODS, sources=["normal"], **options)
    ratios = table.assign(ratio=table["error_after"] / table["error_before"])
    return ratios.pivot(index="target", columns="method", values="ratio")[[*DIAGNOSIS_METHODS]].reset_index()


def robot_medians(table, n_transitions):
    """Return one row for each method: medians, and quartiles of the ratio, over the pairs of worlds."""
    table = table.assign(
        ratio=table["error_after"] / table["error_before"],
        spread=table["error_after_std"] / table["error_before"],
        triplet=table["triplet_error"] / table["error_before"],
    )
    by_method = table.groupby("method", sort=False)
    medians = pd.DataFrame(
        {
            "pairs to fit": n_transitions,
            "after / before": by_method["ratio"].median(),
            "lower quartile": by_method["ratio"].quantile(0.25),
            "upper quartile": by_method["ratio"].quantile(0.75),
            "spread over seeds": by_method["spread"].median(),
            "whole triplet": by_method["triplet"].median(),
            "rho": by_method["rho"].median(),
            "covariance error": by_method["covariance_error"].median(),
            "in raw units": by_method["covariance_error_raw"].median(),
            "best in": wins(table, ["source", "target"]),
        }
    )
    return medians.sort_values("after / before").reset_index()


def covariances(table, n_transitions):
    """Return medians over the pairs of worlds by measure, and in how many whitened Procrustes is nearer."""
    records = []
    for measure in COVARIANCE_MEASURES:
        errors = table.pivot(index=["source", "target"], columns="method", values=measure)
        nearer = (errors["procrustes_whitened"] < errors["least_squares"]).sum()
        medians = errors[[*COVARIANCE_METHODS]].median()
        records.append(
            {"pairs to fit": n_transitions, "measure": measure, **medians, "whitened nearer in": nearer}
        )
    return pd.DataFrame(records)


def pucks(arguments):
    """Return the puck table in the paper's columns, and the medians over simulations and pucks by method."""
    options = {"simulations": SIMULATIONS[4:6], "n_repeats": 1, "n_test": 100} if arguments.small else {}
    arguments.pieces.mkdir(parents=True, exist_ok=True)
    tables = []
    for seed in arguments.seeds:
        path = arguments.pieces / f"puck_{seed}{'_small' if arguments.small else ''}.csv"
        if not path.exists():
            puck_table(random_state=seed, **options).to_csv(path, index=False)
            print(f"{path.name} at {commit()}", flush=True)
        tables.append(pd.read_csv(path))
    table = pd.concat(tables).groupby(["puck", "simulation", "method"], sort=False).mean().reset_index()
    return {"": puck_medians(table), "_paper": in_columns_of_paper(table)}


def puck_medians(table):
    """Return one row for each puck and method: medians over the simulations."""
    table = table.assign(
        ratio=table["error_after"] / table["error_before"], floor=table["error_after"] / table["noise"]
    )
    by_method = table.groupby(["puck", "method"], sort=False)
    medians = pd.DataFrame(
        {
            "error after, m": by_method["error_after"].median(),
            "largest": by_method["error_after"].max(),
            "after / noise": by_method["floor"].median(),
            "after / before": by_method["ratio"].median(),
            "rho": by_method["rho"].median(),
            "rho of rows": by_method["rho_rows"].median(),
            "best in": wins(table, ["puck", "simulation"]),
        }
    )
    return medians.sort_values(["puck", "error after, m"]).reset_index()


def curves(small, n_measured=None):
    """Return the median error over simulations and twice its deviation, by method and number of strikes.

    With `n_measured` the numbers are of simulated strikes, beside so many measured ones.
    """
    options = {"simulations": SIMULATIONS[4:6], "n_repeats": 5, "n_test": 100} if small else {}
    if n_measured is not None:
        options |= {"n_measured": n_measured, "sizes": SIMULATED_STRIKES, "methods": UNPAIRED_CURVE_METHODS}
    table = puck_learning_curve(**options)
    by_size = table.groupby(["method", "n_strikes"], sort=False)
    errors = by_size["error_after"].median().unstack()
    twice = 2 * by_size["error_after_std"].median().unstack()
    printed = errors.map("{:.3f}".format) + " ± " + twice.map("{:.3f}".format)
    return printed.loc[errors.iloc[:, -1].sort_values().index].reset_index()


def wins(table, case):
    """Return in how many cases each method has the smallest error."""
    best = table.loc[table.groupby(case)["error_after"].idxmin()]
    keys = [name for name in ("puck", "method") if name == "method" or "puck" in case]
    return best.groupby(keys).size().reindex(table.groupby(keys, sort=False).size().index, fill_value=0)


def bounds(medians, robot):
    """Yield a line for each bound on those of a robot's medians that are there, with whether it holds."""
    ratios = medians.set_index(["pairs to fit", "method"])["after / before"].sort_index()
    unpaired = [name for name, method in METHODS.items() if method.disjoint]
    paired = [name for name in METHODS if name not in unpaired]
    for size, names, kind, bound in (
        (2000, paired, "best with pairs", PAIRED_BOUNDS[robot]),
        (2000, unpaired, "best without", UNPAIRED_BOUNDS[robot]),
        *([(200, unpaired, "best without", UNPAIRED_BOUND_OF_ANT_WITH_200)] if robot == "ant" else []),
    ):
        if size in ratios.index:
            best = ratios[size][ratios[size].index.isin(names)]
            line = f"{robot}, {size} pairs, {kind}: {best.idxmin()} {best.min():.3f} <= {bound}"
            yield line, best.min() <= bound
    for ending in ("", "_scaled"):
        names = [(200, f"residual{ending}"), (200, f"procrustes_whitened{ending}")]
        if all(name in ratios.index for name in names):
            share = ratios[names[0]] / ratios[names[1]]
            line = f"{robot}, 200 pairs: residual{ending} over its base {share:.3f} <= {MOST_OF_BASE}"
            yield line, share <= MOST_OF_BASE


if __name__ == "__main__":
    main()
