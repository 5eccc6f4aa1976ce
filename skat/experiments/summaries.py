"""The tables of the experiments in short: a row for each method, who wins, and a figure."""

import numpy as np


def method_summary(table):
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


def verdict(table):
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


def figure(table):
    """Return a figure of an experiment.

    Parameters
    ----------
    table : DataFrame
        As for `method_summary`.

    Returns
    -------
    matplotlib Figure
        Learning curves, or for each method a heat map of error after / before.
    """
    from matplotlib.figure import Figure

    from skat.plotting import DomainMatrixDisplay, LearningCurveDisplay

    if "n_strikes" in table:
        drawing = Figure(figsize=(7, 4.5), layout="constrained")
        curve = table.groupby(["method", "n_strikes"], sort=False)[["error_after", "error_after_std"]].mean()
        LearningCurveDisplay.from_frame(
            curve.reset_index(),
            size="n_strikes",
            value="error_after",
            deviation="error_after_std",
            ax=drawing.subplots(),
        )
        return drawing
    source, target = ("source", "target") if "source" in table else ("simulation", "puck")
    ratios = table.assign(ratio=table["error_after"] / table["error_before"])
    methods = list(dict.fromkeys(table["method"]))
    n_columns = min(4, len(methods))
    n_rows = -(-len(methods) // n_columns)
    drawing = Figure(figsize=(4.2 * n_columns, 3.8 * n_rows), layout="constrained")
    axes = np.ravel(drawing.subplots(n_rows, n_columns, squeeze=False))
    for ax, method in zip(axes, methods):
        rows = ratios[ratios["method"] == method]
        DomainMatrixDisplay.from_frame(
            rows,
            value="ratio",
            source=source,
            target=target,
            label="after / before",
            ax=ax,
            limits=(0, 1),
            colorbar=False,
        )
        ax.set_title(method)
    for ax in axes[len(methods) :]:
        ax.set_axis_off()
    return drawing
