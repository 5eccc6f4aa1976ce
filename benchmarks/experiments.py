"""The paper's experiments in full, as tables for the documentation.

Run from the root of the repository::

    python benchmarks/experiments.py                      # everything, up to an hour on 2 cores
    python benchmarks/experiments.py hopper puck          # some of it
    python benchmarks/experiments.py --small              # a cut of two minutes, for a look

A robot's table is made in pieces, one for each seed, number of rows and world to carry from, which are kept in
``--pieces`` and not made again, so that a run that was
ended goes on where it was. Pieces of several runs at once may lie in one folder.

Each experiment writes ``benchmarks/results/experiments_<name>.csv``; the pucks' also
``experiments_puck_paper.csv``, in the columns of the paper, and a robot's ``experiments_<robot>_covariance.csv``,
which compares a transport and regressions by every measure of covariance. "between" asks whether any map between
least squares and a transport would keep the covariance better with few rows. Bounds that the medians of a robot are
to keep are printed with whether they hold. The seed is 0 throughout, and
0, 1, 2 for the robots.
"""

import argparse
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.linear_model import LinearRegression

from skat import ProcrustesAffineTransport
from skat.experiments import domain_matrix, in_columns_of_paper, puck_learning_curve, puck_table
from skat.experiments.methods import METHODS, RegressionTransport
from skat.experiments.puck import SIMULATIONS
from skat.experiments.robots import CONDITIONS, COVARIANCE_MEASURES, MEASURES

RESULTS = Path(__file__).parent / "results"
SEEDS = (0, 1, 2)
ROBOTS = ("hopper", "halfcheetah", "ant")
SIZES = (2000, 200)
SMALL_WORLDS = ("normal", "heavy", "inverted")
# Largest median of error after / before with 2,000 pairs.
BOUNDS = {
    "procrustes_whitened": {"hopper": 0.20, "halfcheetah": 0.27, "ant": 0.50},
    "conditional_disjoint": {"hopper": 0.35, "halfcheetah": 0.35, "ant": 0.70},
}
MOST_OF_LEAST_SQUARES = 1.10
COVARIANCE_METHODS = ("procrustes_whitened", "conditional", "least_squares", "ridge_on_residual")
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
        "--methods", nargs="+", help="Some of a robot's methods; the table's name ends in _some."
    )
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
        whole = not arguments.small and not arguments.methods and {*arguments.sizes} == {*SIZES}
        if name in ROBOTS and whole:
            for line, holds in bounds(tables[""], tables["_covariance"], name):
                print(f"{'holds' if holds else 'DOES NOT HOLD'}: {line}")
        seconds, cpu_seconds = time.perf_counter() - began, time.process_time() - began_cpu
        print(f"{name}: {seconds:.0f} s, {cpu_seconds:.0f} s of processor time", flush=True)


def tables_of(name, arguments):
    """Return the tables of an experiment by what their files' names end in."""
    small = arguments.small
    if name == "puck":
        return pucks(small)
    if name == "learning_curve":
        return {"": curves(small)}
    if name == "between":
        return {"": between(small)}
    return {"": diagnoses(small)} if name == "diagnosis" else robots(name, arguments)


def robots(name, arguments):
    """Return medians over the ordered pairs of worlds, and those of the covariance by every measure."""
    arguments.pieces.mkdir(parents=True, exist_ok=True)
    tables = {
        size: over_seeds([seed_table(name, size, seed, arguments) for seed in arguments.seeds])
        for size in sorted(arguments.sizes)
    }
    medians = pd.concat([robot_medians(table, size) for size, table in tables.items()])
    if arguments.methods:
        return {"_some": medians}
    return {
        "": medians,
        "_covariance": pd.concat([covariances(table, size) for size, table in tables.items()]),
    }


def seed_table(robot, size, seed, arguments):
    """Return the table of one seed and number of rows, in pieces from the files of those that have been made."""
    conditions = SMALL_WORLDS if arguments.small else CONDITIONS
    return pd.concat([piece(robot, size, seed, source, conditions, arguments) for source in conditions])


def piece(robot, size, seed, source, conditions, arguments):
    """Return the part of a table in which rows of one world are carried."""
    cut = ("_small" if arguments.small else "") + ("_some" if arguments.methods else "")
    path = arguments.pieces / f"{robot}_{size}_{seed}_{source}{cut}.csv"
    if not path.exists():
        methods = [
            name
            for name, method in METHODS.items()
            if name in (arguments.methods or METHODS) and (seed == SEEDS[0] or not method.slow)
        ]
        table = domain_matrix(
            robot,
            n_transitions=size,
            methods=methods,
            n_repeats=1,
            random_state=seed,
            sources=[source],
            conditions=conditions,
            n_test=500 if arguments.small else 2000,
            n_scored=arguments.scored,
        )
        unfinished = path.with_suffix(".part")
        table.to_csv(unfinished, index=False)
        unfinished.rename(path)
        print(f"{path} at {commit()}: {' '.join(sys.argv)}", flush=True)
    return pd.read_csv(path)


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
    )
    by_method = table.groupby("method", sort=False)
    medians = pd.DataFrame(
        {
            "pairs to fit": n_transitions,
            "after / before": by_method["ratio"].median(),
            "lower quartile": by_method["ratio"].quantile(0.25),
            "upper quartile": by_method["ratio"].quantile(0.75),
            "spread over seeds": by_method["spread"].median(),
            "rho": by_method["rho"].median(),
            "covariance error": by_method["covariance_error"].median(),
            "in raw units": by_method["covariance_error_raw"].median(),
            "best in": wins(table, ["source", "target"], by_method.ngroups),
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


def pucks(small):
    """Return the puck table in the paper's columns, and the medians over simulations and pucks by method."""
    options = {"simulations": SIMULATIONS[4:6], "n_repeats": 1, "n_test": 100} if small else {}
    table = puck_table(**options)
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
            "best in": wins(table, ["puck", "simulation"], by_method.ngroups),
        }
    )
    return medians.sort_values(["puck", "error after, m"]).reset_index()


def curves(small):
    """Return the median error over simulations and twice its deviation, by method and number of strikes."""
    options = {"simulations": SIMULATIONS[4:6], "n_repeats": 5, "n_test": 100} if small else {}
    table = puck_learning_curve(**options)
    by_size = table.groupby(["method", "n_strikes"], sort=False)
    errors = by_size["error_after"].median().unstack()
    twice = 2 * by_size["error_after_std"].median().unstack()
    printed = errors.map("{:.3f}".format) + " ± " + twice.map("{:.3f}".format)
    return printed.loc[errors.iloc[:, -1].sort_values().index].reset_index()


def wins(table, case, n_methods):
    """Return in how many cases each method has the smallest error."""
    best = table.loc[table.groupby(case)["error_after"].idxmin()]
    keys = [name for name in ("puck", "method") if name == "method" or "puck" in case]
    return best.groupby(keys).size().reindex(table.groupby(keys, sort=False).size().index, fill_value=0)


def bounds(medians, errors, robot):
    """Yield a line for each bound on a robot's medians, with whether it holds."""
    rows = medians.set_index(["pairs to fit", "method"])
    for method, largest in BOUNDS.items():
        value = rows.loc[(2000, method), "after / before"]
        yield f"{robot}, 2000 pairs: {method} {value:.3f} <= {largest[robot]:.2f}", value <= largest[robot]
    for n_transitions in SIZES:
        ours, theirs = (rows.loc[(n_transitions, name)] for name in ("procrustes_whitened", "least_squares"))
        ratio = ours["after / before"] / theirs["after / before"]
        comparison = f"whitened over least squares {ratio:.3f} <= {MOST_OF_LEAST_SQUARES:.2f}"
        yield f"{robot}, {n_transitions} pairs: {comparison}", ratio <= MOST_OF_LEAST_SQUARES
    for row in errors.to_dict("records"):
        ours, theirs = row["procrustes_whitened"], row["least_squares"]
        comparison = f"{row['measure']} {ours:.3g} < {theirs:.3g} of least squares"
        yield f"{robot}, {row['pairs to fit']} pairs: {comparison}", ours < theirs


if __name__ == "__main__":
    main()
