"""What is said of a log before it is diagnosed: each channel by hand, and rows from all over it."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from skat.diagnosis.checks import RUNS, channel_table, rows_of
from skat.logs import load_log
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
