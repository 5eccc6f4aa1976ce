"""What is said of a log before it is diagnosed: each channel by hand, and rows from all over it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from skat.logs import load_log
from skat.logs.checks import RUNS, channel_table, rows_of
from skat.simulators import MujocoSimulator

CART = """
<mujoco><option timestep="0.01"/><worldbody><body>
  <joint name="rail" type="slide" axis="1 0 0"/><geom size=".1"/></body></worldbody>
<actuator><motor name="push" joint="rail" ctrlrange="-2 1" ctrllimited="true"/></actuator></mujoco>
"""


@pytest.fixture(scope="module")
def log():
    time = 0.01 * np.arange(101)
    frame = {"time": time, "qpos.rail": np.sin(3 * time) - 0.2, "ctrl.push": np.full(101, 0.5)}
    frame["ctrl.push"][:20] = 1.0
    return load_log(pd.DataFrame(frame), MujocoSimulator(CART))


def test_a_channel_is_told_by_its_ends_its_spread_and_where_it_is_at_its_limit(log):
    table = channel_table(log).set_index("name")
    position = log.X[:, 0]
    assert table.loc["qpos.rail", "lowest"] == position.min() < 0
    assert table.loc["qpos.rail", "highest"] == position.max() > 0
    assert table.loc["qpos.rail", "spread"] == pytest.approx(position.std())
    assert np.isnan(table.loc["qpos.rail", "at limit"])
    assert table.loc["ctrl.push", "at limit"] == pytest.approx(0.2)
    assert table.loc["ctrl.push", "remark"] == "often at its limit"
    assert table.loc["qpos.rail", "remark"] == ""


def test_a_channel_that_was_not_measured_or_does_not_move_is_told(log):
    X = log.X.copy()
    X[:, 0] = 0.3
    X[:, 1] = np.nan
    table = channel_table(replace(log, X=X)).set_index("name")
    assert table.loc["qvel.rail", "measured"] == 0
    assert table.loc["qvel.rail", "remark"] == "not measured"
    assert table.loc["qvel.rail", ["lowest", "highest", "spread"]].isna().all()
    assert table.loc["qpos.rail", "remark"] == "does not move: it tells nothing"


def test_rows_measured_as_a_whole_are_taken_from_all_over_a_log(log):
    X = log.X.copy()
    X[:, 1] = 0.1
    X[[3, 50], 1] = np.nan
    whole = replace(log, X=X)
    kept, groups = rows_of(whole)
    np.testing.assert_array_equal(kept, X[np.isfinite(X).all(axis=1)])
    assert len(groups) == len(kept) == len(X) - 2
    some, _ = rows_of(whole, most=2 * RUNS)
    assert len(some) == 2 * RUNS
    np.testing.assert_array_equal(some[[0, -1]], kept[[0, -1]])


def laid(columns, *, units=None, matches=()):
    """Return a log of a machine whose command may be anything from -1 to 3."""
    simulator = SimpleNamespace(
        command_limits={"u": (-1.0, 3.0)}, input_names=tuple(columns), units={"q": "rad"} | (units or {})
    )
    return SimpleNamespace(X=np.column_stack(list(columns.values())), simulator=simulator, matches=matches)


@pytest.mark.parametrize(
    ("value", "at_limit"),
    [(3.0, 0.2), (-1.0, 0.2), (3.0 - 3e-6, 0.2), (3.0 - 5e-6, 0.0), (-1.0 + 5e-6, 0.0), (9.0, 0.2)],
)
def test_a_command_is_at_either_end_of_its_range_to_a_millionth_of_it(value, at_limit):
    commands = np.linspace(0, 1, 10)
    commands[[2, 7]] = value
    (row,) = channel_table(laid({"u": commands})).to_dict("records")
    assert row["at limit"] == pytest.approx(at_limit)
    assert row["remark"] == ("often at its limit" if at_limit else "")


def test_one_row_in_ten_at_a_limit_is_not_often():
    commands = np.linspace(0, 1, 10)
    commands[3] = 3.0
    assert channel_table(laid({"u": commands}))["remark"].tolist() == [""]


def test_each_channel_has_a_row_with_the_log_s_name_and_unit_where_it_has_such():
    matches = (
        SimpleNamespace(name="q", theirs="angle", unit="deg"),
        SimpleNamespace(name="u", theirs="pwm", unit=""),
    )
    q, v = np.array([1.0, np.nan, 3.0, np.nan]), np.full(4, np.nan)
    table = channel_table(laid({"q": q, "v": v, "u": np.full(4, 0.5)}, units={"u": "N"}, matches=matches))
    columns = ["name", "column", "unit", "measured", "lowest", "highest", "spread", "at limit", "remark"]
    assert list(table) == columns
    nan, still = float("nan"), "does not move: it tells nothing"
    np.testing.assert_equal(
        table.to_numpy().tolist(),
        [
            ["q", "angle", "deg", 0.5, 1.0, 3.0, 1.0, nan, ""],
            ["v", "", "", 0.0, nan, nan, nan, nan, "not measured"],
            ["u", "pwm", "N", 1.0, 0.5, 0.5, 0.0, 0.0, still],
        ],
    )
    plain = channel_table(laid({"q": q}))
    assert plain.loc[0, ["column", "unit"]].tolist() == ["", "rad"]


def test_runs_of_a_long_log_are_from_all_over_it_and_of_one_length(log):
    X = np.tile(np.arange(100.0)[:, None], (1, 3))
    whole = replace(log, X=X, y=X[:, :2] + 1, groups=np.zeros(100, dtype=int))
    some, groups = rows_of(whole, most=20)
    starts = np.linspace(0, 97, RUNS).astype(int)
    np.testing.assert_array_equal(some[:, 0], (starts[:, None] + np.arange(3)).ravel())
    assert len(groups) == 18
    assert len(rows_of(whole, most=100)[0]) == 100
    assert len(rows_of(whole, most=99)[0]) == 6 * 16
