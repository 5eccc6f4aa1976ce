from functools import partial

import numpy as np
import pandas as pd
import pytest

from skat.experiments import (
    in_columns_of_paper,
    puck_learning_curve,
    puck_table,
    repeated_strikes_error,
    strike_pucks,
)
from skat.experiments.puck import PUCKS, SIMULATIONS
from skat.simulators import make_simulator

SMALL = {
    "simulations": ["isotr_low", "isotr_high_offc"],
    "methods": ["none", "affine", "procrustes_whitened"],
    "n_test": 30,
}
FEW = {"n_strikes": 2, "n_repeats": 5}
# Normal noise of 0.05 m on each of two axes has a mean length of 0.05 sqrt(pi / 2).
NOISE = 0.05 * np.sqrt(np.pi / 2)


@pytest.fixture(scope="module")
def table():
    # How far the noise scatters is asked by itself, below, and takes more strikes than all the rest.
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(
            "skat.experiments.puck.repeated_strikes_error", partial(repeated_strikes_error, **FEW)
        )
        return puck_table(n_strikes=30, n_repeats=2, **SMALL)


def test_there_are_the_papers_pucks_and_simulations():
    assert PUCKS == ("blue", "red")
    assert len(SIMULATIONS) == len(set(SIMULATIONS)) == 11
    for simulation in SIMULATIONS:
        make_simulator("puck", condition=simulation)


def test_strikes_are_the_same_for_the_real_puck_and_the_simulated_one():
    strikes = strike_pucks("blue", n_strikes=5, simulations=["isotr_med"])
    source, target = strikes.source_rows("isotr_med"), strikes.target_rows
    assert source.shape == target.shape == (5, 4)
    np.testing.assert_array_equal(source[:, :2], target[:, :2])
    np.testing.assert_array_equal(source[:, 2:], make_simulator("puck").predict(source[:, :2]))


def test_a_row_for_each_puck_simulation_and_method(table):
    assert len(table) == 2 * 2 * 3
    assert not table.duplicated(["puck", "simulation", "method"]).any()
    assert np.isfinite(table.select_dtypes("number")).all(axis=None)


def test_repeated_strikes_scatter_by_the_noise():
    error = repeated_strikes_error("red", n_strikes=3, n_repeats=40)
    # 120 lengths with a standard deviation of 0.52 times their mean.
    np.testing.assert_allclose(error, NOISE, rtol=4 * 0.52 / np.sqrt(120))


def test_transport_comes_near_the_noise_from_far_away(table):
    carried = table[table["method"] == "procrustes_whitened"]
    assert (carried["error_before"] > 0.3).all()
    assert (carried["error_after"] < 0.5 * carried["error_before"]).all()
    assert (carried["error_after"] < 1.5 * NOISE).all()


def test_scores_of_places_are_lower_than_of_rows_that_share_the_strike(table):
    assert (table["rho"] < table["rho_rows"]).all()


def test_the_papers_columns(table):
    printed = in_columns_of_paper(table)
    assert list(printed.columns) == ["Puck", "Simulation", "Sim2Real Error", "Sim Error", "rho"]
    assert len(printed) == 4
    first = table[table["method"] == "affine"].iloc[0]
    assert printed["Sim Error"][0] == f"{first['error_before']:.2f} ± {first['error_before_spread']:.2f}"
    with pytest.raises(ValueError, match=r"no method 'magic'\. It has: none, affine, procrustes_whitened"):
        in_columns_of_paper(table, "magic")


def test_the_learning_curve_falls_and_repeats_from_its_seed():
    options = {
        "simulations": ["isotr_low_offc"],
        "methods": ["affine", "least_squares"],
        "sizes": (6, 16),
        "n_repeats": 6,
        "n_test": 15,
    }
    calls = []
    curve = puck_learning_curve(**options, progress=lambda *call: calls.append(call))
    pd.testing.assert_frame_equal(curve, puck_learning_curve(**options))
    assert calls[-1] == ("carrying", 12, 12)
    errors = curve.pivot(index="method", columns="n_strikes", values="error_after")
    assert (errors[16] < errors[6]).all()
    assert (curve["error_after_std"] > 0).all()


def test_what_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="'green' puck"):
        puck_table(pucks=["green"], **SMALL)
    with pytest.raises(ValueError, match="unknown condition of puck 'isotr'"):
        strike_pucks("blue", n_strikes=1, simulations=["isotr"])


def test_of_few_measured_strikes_more_simulated_ones_are_fitted_to_the_same():
    options = {"simulations": ["isotr_low"], "n_test": 15, "n_repeats": 6}
    curve = puck_learning_curve(methods=["affine"], sizes=[8, 16], n_measured=8, **options)
    paired = puck_learning_curve(methods=["affine"], sizes=[8, 16], **options)
    # With as many simulated as measured strikes these are pairs, the same in both curves.
    assert curve["error_after"][0] == pytest.approx(paired["error_after"][0], rel=1e-12)
    assert (curve["error_after"] < curve["error_before"]).all()
    assert paired["error_after"][1] < curve["error_after"][1]
    with pytest.raises(ValueError, match="learns from pairs"):
        puck_learning_curve(methods=["procrustes_whitened"], sizes=[5], n_measured=4, **options)
