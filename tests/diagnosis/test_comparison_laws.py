"""What a comparison with learned maps is made of, by hand: standardised rows, ratios, sentences."""

import numpy as np
import pandas as pd
import pytest
from sklearn.preprocessing import FunctionTransformer

from skat.diagnosis import SimulationDiagnosis, compare_transports
from skat.diagnosis.comparison import (
    EXTENDED,
    NOMINAL,
    _rank,
    _ratio,
    _spread,
    ceiling_sentence,
    is_beaten,
)
from skat.effects import Effect
from skat.simulators import FunctionSimulator

LIFT = Effect("lift", unit="V", neutral=0.0, bounds=(-5.0, 5.0))


def bent(lost=np.inf):
    """Return a one-shot simulation of two outputs, one of them far larger, that has no answer beyond some input."""
    return FunctionSimulator(
        lambda X, lift: np.where(
            X[:, :1] > lost, np.nan, np.c_[X[:, :1] ** 2 + lift, 100 * np.sin(X.sum(axis=1))]
        ),
        input_names=("p", "q"),
        output_names=("low", "high"),
        effects=(LIFT,),
    )


def diagnosed(simulator, causes=(), hidden=()):
    """Return a diagnosis as fit would leave it, of given causes."""
    diagnosis = SimulationDiagnosis(simulator, hidden=hidden)
    diagnosis.verdict_, diagnosis.computed_velocities_ = "named", ()
    diagnosis.extended_simulator_ = simulator.extended(dict(causes))
    return diagnosis


def logs(lift=1.0, n=(60, 40)):
    rng = np.random.default_rng(0)
    found = []
    for length in n:
        X = rng.normal(size=(length, 2))
        y = bent().predict(X) + [lift, 0.0] + [0.1, 3.0] * rng.normal(size=(length, 2))
        found += [X, y]
    return found


def with_map(function, *, simulator=None, lift=1.0, **options):
    """Return the table of a comparison with one map, a function of standardised rows."""
    return compare_transports(
        diagnosed(bent() if simulator is None else simulator, {"lift": 0.9}),
        *logs(lift),
        methods={"mine": FunctionTransformer(function)},
        random_state=0,
        **options,
    ).set_index("method")


# -- tables ----------------------------------------------------------------------------------------------------------


def test_a_map_that_changes_nothing_is_the_simulation_as_given():
    table = with_map(lambda rows: rows)
    columns = ["error", "ratio", "ratio_low", "ratio_high", "low", "high"]
    np.testing.assert_allclose(
        table.loc["mine", columns].astype(float), table.loc[NOMINAL, columns].astype(float), rtol=1e-9
    )


def test_a_map_works_in_units_of_the_measured_outputs_and_of_inputs_about_their_means():
    _, y, X_test, y_test = logs()
    seen = []

    def moved(rows):
        seen.append(rows)
        return rows + np.array([9.0, 9.0, 1.0, -2.0])

    table = with_map(moved)
    prediction = bent().predict(X_test) + [1.0, -2.0] * y.std(axis=0)
    expected = np.sqrt(np.mean((y_test - prediction) ** 2, axis=0))
    np.testing.assert_allclose(table.loc["mine", ["low", "high"]].astype(float), expected, rtol=1e-9)
    X = logs()[0]
    np.testing.assert_allclose(seen[-1][:, :2], (X_test - X.mean(axis=0)) / X.std(axis=0), rtol=1e-9)
    np.testing.assert_allclose(
        seen[-1][:, 2:], (bent().predict(X_test) - y.mean(axis=0)) / y.std(axis=0), rtol=1e-9
    )


def test_ratios_are_those_of_errors_over_the_spread_that_the_rows_fitted_have():
    table = with_map(lambda rows: rows)
    _, y, X_test, y_test = logs()
    errors = {
        method: np.sqrt(np.mean(((y_test - bent().predict(X_test) - [lift, 0]) / y.std(axis=0)) ** 2))
        for method, lift in ((NOMINAL, 0.0), (EXTENDED, 0.9))
    }
    for method, error in errors.items():
        assert table.loc[method, "error"] == pytest.approx(error)
        assert table.loc[method, "ratio"] == pytest.approx(error / errors[EXTENDED])
    assert table.loc[NOMINAL, "ratio_low"] < table.loc[NOMINAL, "ratio"] < table.loc[NOMINAL, "ratio_high"]
    assert table.loc[EXTENDED, ["ratio_low", "ratio", "ratio_high"]].tolist() == [1.0, 1.0, 1.0]


def test_the_interval_of_a_ratio_is_that_of_rows_drawn_again():
    """By draws of one's own, from another generator: to what so many draws leave open."""
    _, y, X_test, y_test = logs()
    table = with_map(lambda rows: rows)
    squares = [
        np.sum(((y_test - bent().predict(X_test) - [lift, 0]) / y.std(axis=0)) ** 2, axis=1)
        for lift in (0, 0.9)
    ]
    draws = np.random.default_rng(1).integers(40, size=(20_000, 40))
    ratios = np.sqrt(squares[0][draws].sum(axis=1) / squares[1][draws].sum(axis=1))
    told = table.loc[NOMINAL, ["ratio_low", "ratio_high"]].astype(float)
    np.testing.assert_allclose(told, np.quantile(ratios, [0.025, 0.975]), rtol=0.05)


def test_rows_in_which_a_simulation_diverges_are_counted():
    X_test = logs()[2]
    table = with_map(lambda rows: rows, simulator=bent(lost=1.0))
    lost = int(np.sum(X_test[:, 0] > 1))
    assert lost > 0
    for method in (NOMINAL, EXTENDED):
        assert table.loc[method, "note"] == f"{lost} rows left out, in which a simulation diverges"
    assert table.loc["mine", "n_rows"] == np.sum(logs()[0][:, 0] <= 1)


@pytest.mark.parametrize(("pieces", "told"), [(5, True), (4, False)])
def test_five_groups_of_rows_tell_how_far_a_ratio_varies(pieces, told):
    table = with_map(lambda rows: rows, groups_test=np.arange(40) * pieces // 40)
    assert np.isfinite(table[["ratio_low", "ratio_high"]]).all(axis=None) == told


def test_a_map_s_warnings_are_its_notes_and_its_errors_no_answer():
    def grumbling(rows):
        import warnings

        warnings.warn("hardly", UserWarning, stacklevel=1)
        return rows

    def refusing(rows):
        raise ValueError("never")

    assert with_map(grumbling).loc["mine", "note"] == "hardly"
    refused = with_map(refusing).loc["mine"]
    assert refused["note"] == "no answer: never"
    assert refused[["error", "ratio", "ratio_low", "low", "high"]].isna().all()
    assert refused["n_rows"] == 60


def test_the_simulations_names_are_taken():
    with pytest.raises(ValueError, match=r"methods may not be called 'nominal simulation'"):
        compare_transports(diagnosed(bent()), *logs(), methods={NOMINAL: FunctionTransformer()})
    with pytest.raises(
        ValueError, match=r"Unknown method 'Coral'\. Methods: AffineTransport, .*, ExactTransport"
    ):
        compare_transports(diagnosed(bent()), *logs(), methods=["CORAL", "Coral"])
    table = compare_transports(diagnosed(bent()), *logs(), methods="CORAL", random_state=0)
    assert table["method"].tolist() == [NOMINAL, "CORAL", EXTENDED]


@pytest.mark.parametrize(
    ("ratio", "high", "beaten"),
    [
        (0.94, 0.99, True),
        (0.96, 0.99, False),
        (0.94, 1.01, False),
        (0.5, np.nan, False),
        (np.nan, np.nan, False),
    ],
)
def test_what_beats_the_causes_is_clearly_and_by_more_than_noise_gives_better(ratio, high, beaten):
    frame = pd.DataFrame(
        {
            "method": [NOMINAL, "one", "two", EXTENDED],
            "error": [0.1, 0.9, ratio, 1.0],
            "ratio": [0.1, 0.9, ratio, 1.0],
            "ratio_low": [0.1, 0.8, high - 0.5, 1.0],
            "ratio_high": [0.1, 1.2, high, 1.0],
        }
    )
    assert is_beaten(frame) == beaten
    best, size = ("one", "0.9") if np.isnan(ratio) or ratio > 0.9 else ("two", "0.5")
    sentence = ceiling_sentence(frame)
    interval = " (95 %: 0.8 to 1.2)" if best == "one" else ""
    if beaten:
        assert sentence == (
            f"{best} beats the extended simulation on data not used: {size} times its error{interval}. Something is "
            "left that the named causes do not explain."
        )
    else:
        assert sentence == (
            f"No transport beats the extended simulation on data not used: {best} has {size} times its error"
            f"{interval}."
        )
    none = frame[frame["method"].isin([NOMINAL, EXTENDED])]
    assert ceiling_sentence(none) == "No transport could be fitted to these data."


# -- parts -----------------------------------------------------------------------------------------------------------


def test_the_rank_of_rows_is_that_of_what_varies_in_any_unit():
    rows = np.random.default_rng(0).normal(size=(30, 3))
    assert _rank(rows * [1e-6, 1.0, 1e6] + 100) == 3
    assert _rank(np.c_[rows, rows[:, 0] - 2 * rows[:, 1]]) == 3
    assert _rank(np.c_[rows, np.full(30, 7.0)]) == 3
    assert _rank(np.c_[rows, rows[:, 0] + 1e-5 * np.random.default_rng(1).normal(size=30)]) == 4


def test_a_column_that_is_constant_up_to_rounding_has_a_spread_of_one():
    rounding = 1e3 * (1 + 1e-15 * np.arange(20))
    rows = np.c_[np.arange(20.0), rounding, np.zeros(20)]
    assert _spread(rows).tolist() == [np.arange(20).std(), 1.0, 1.0]


def test_ratios_of_nothing_are_one():
    assert _ratio([4.0, 0.0, 0.0], [1.0, 0.0, 2.0]).tolist() == [2.0, 1.0, 0.0]
    assert _ratio(1.0, 0.0) > 1e100
