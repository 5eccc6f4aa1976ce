"""The tables of the experiments in short: a row for each method, who wins, and a figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


def method_summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return one row for each method, the best first.

    Parameters
    ----------
    table : DataFrame
        As `domain_matrix`, `puck_table` or `puck_learning_curve` return it.

    Returns
    -------
    DataFrame
        Columns method and, each a median over the rows of the method: error before, error after, after /
        before, rho. For a learning curve: the median error after for each number of strikes instead.
    """
    if "n_strikes" in table:
        curve = table.pivot_table(index="method", columns="n_strikes", values="error_after", aggfunc="median")
        return curve.sort_values(curve.columns[-1]).reset_index().rename_axis(columns=None)
    ratios = table.assign(ratio=table["error_after"] / table["error_before"])
    medians = ratios.groupby("method", sort=False)[["error_before", "error_after", "ratio", "rho"]].median()
    return (
        medians.sort_values("ratio")
        .reset_index()
        .rename(
            columns={"error_before": "error before", "error_after": "error after", "ratio": "after / before"}
        )
    )


def verdict(table: pd.DataFrame) -> str:
    """Return a sentence that says which methods win, whether or not they are of skat.

    Parameters
    ----------
    table : DataFrame
        As for `method_summary`.

    Returns
    -------
    str
        Wins are counted over pairs of domains, or simulations and pucks, and numbers of strikes.
    """
    case = [name for name in ("puck", "simulation", "source", "target", "n_strikes") if name in table]
    best = table.loc[table.groupby(case)["error_after"].idxmin(), "method"].value_counts()
    wins = ", ".join(f"{method} in {count}" for method, count in best.items())
    return f"Smallest error, of {best.sum()} cases: {wins}."


def figure(table: pd.DataFrame) -> Figure:
    """Return a figure of an experiment.

    Parameters
    ----------
    table : DataFrame
        As for `method_summary`.

    Returns
    -------
    matplotlib Figure
        Learning curves; or a heat map of the error before, and for each method but "none" one of error after /
        before, all on one scale.
    """
    return _curves(table) if "n_strikes" in table else _matrices(table)


def _curves(table: pd.DataFrame) -> Figure:
    from matplotlib.figure import Figure

    from skat.plotting import LearningCurveDisplay

    drawing = Figure(figsize=(7, 4.5), dpi=150, layout="constrained")
    ax = drawing.subplots()
    curve = table.groupby(["method", "n_strikes"], sort=False)[["error_after", "error_after_std"]].mean()
    LearningCurveDisplay.from_frame(
        curve.reset_index(), size="n_strikes", value="error_after", deviation="error_after_std", ax=ax
    )
    ax.set(xlabel="strikes to fit on", ylabel="distance from the measured resting place, m")
    return drawing


def _matrices(table: pd.DataFrame) -> Figure:
    from matplotlib.figure import Figure

    from skat.plotting import DomainMatrixDisplay

    source, target = ("source", "target") if "source" in table else ("simulation", "puck")
    ratios = table.assign(ratio=table["error_after"] / table["error_before"])
    # The error before is the same with every method.
    panels = {"error before": ratios.drop_duplicates([source, target])}
    panels |= {name: rows for name, rows in ratios.groupby("method", sort=False) if name != "none"}
    n_columns = min(4, len(panels))
    n_rows = -(-len(panels) // n_columns)
    cell_columns, cell_rows = table[target].nunique(), table[source].nunique()
    size = (
        1.2 + n_columns * (0.5 + max(0.4 * cell_columns, 1.8)),
        1.6 + n_rows * (0.4 + 0.32 * cell_rows),
    )
    drawing = Figure(figsize=size, dpi=120, layout="constrained")
    axes = drawing.subplots(n_rows, n_columns, squeeze=False)
    # Empty places go to the first row, so that the last is full and bears the names of all columns.
    n_first = len(panels) - (n_rows - 1) * n_columns
    places = [
        *np.ndindex(1, n_first),
        *((1 + row, column) for row, column in np.ndindex(n_rows - 1, n_columns)),
    ]
    for ax in axes[0, n_first:]:
        ax.set_axis_off()
    for (row, column), (name, rows) in zip(places, panels.items()):
        ax, is_before = axes[row, column], name == "error before"
        DomainMatrixDisplay.from_frame(
            rows,
            value="error_before" if is_before else "ratio",
            source=source,
            target=target,
            ax=ax,
            limits=None if is_before else (0, 1),
            colorbar=False,
        )
        ax.set_title(name, fontsize=10)
        is_left, is_lowest = column == 0, row == n_rows - 1
        ax.set(xlabel=target if is_lowest else "", ylabel=source if is_left else "")
        ax.tick_params(labelleft=is_left, labelbottom=is_lowest)
    drawing.suptitle("Error before; and error after / before by each method, darkest from 1 up", fontsize=11)
    return drawing
