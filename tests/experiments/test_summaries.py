import numpy as np
import pandas as pd
import pytest

from skat.experiments.summaries import figure, method_summary, verdict


@pytest.fixture
def matrix():
    pairs = [("light", "heavy"), ("heavy", "light"), ("light", "long")]
    after = {"good": [0.1, 0.2, 0.3], "better": [0.05, 0.1, 0.9], "none": [1.0, 2.0, 3.0]}
    return pd.DataFrame(
        [
            {
                "source": a,
                "target": b,
                "method": method,
                "error_before": before,
                "error_after": error,
                "rho": 0.9,
            }
            for method, errors in after.items()
            for (a, b), before, error in zip(pairs, [1.0, 2.0, 3.0], errors)
        ]
    )


@pytest.fixture
def curve():
    return pd.DataFrame(
        [
            {
                "puck": "blue",
                "simulation": simulation,
                "method": method,
                "n_strikes": n,
                "error_before": 1.0,
                "error_after": scale / n,
                "error_after_std": 0.01,
                "rho": 0.9,
            }
            for simulation in ("a", "b", "c")
            for method, scale in (("slow", 2.0), ("fast", 1.0))
            for n in (5, 10)
        ]
    )


def test_summary_is_the_median_over_pairs_best_first(matrix):
    summary = method_summary(matrix)
    assert list(summary["method"]) == ["better", "good", "none"]
    np.testing.assert_allclose(summary["after / before"], [0.05, 0.1, 1.0])
    np.testing.assert_allclose(summary["error after"], [0.1, 0.2, 2.0])


def test_summary_of_a_learning_curve_has_a_column_for_each_number_of_strikes(curve):
    summary = method_summary(curve)
    assert list(summary.columns) == ["method", 5, 10]
    assert list(summary["method"]) == ["fast", "slow"]
    np.testing.assert_allclose(summary[10], [0.1, 0.2])


def test_verdict_counts_wins_over_cases(matrix, curve):
    assert verdict(matrix) == "Smallest error, of 3 cases: better in 2, good in 1."
    assert verdict(curve) == "Smallest error, of 6 cases: fast in 6."


def test_figure_has_the_error_before_and_a_panel_for_each_method_that_does_something(matrix, curve):
    panels = [ax for ax in figure(matrix).axes if ax.axison]
    assert [ax.get_title() for ax in panels] == ["error before", "good", "better"]
    assert [bool(ax.get_ylabel()) for ax in panels] == [True, False, False]
    assert len(figure(curve).axes[0].get_lines()) >= 2


def test_every_column_of_panels_names_its_targets_at_the_bottom(matrix):
    methods = [matrix[matrix["method"] == "good"].assign(method=f"method {k}") for k in range(5)]
    panels = [ax for ax in figure(pd.concat(methods)).axes if ax.axison]
    assert len(panels) == 6
    assert [ax.get_xlabel() for ax in panels] == ["", "", "target", "target", "target", "target"]
