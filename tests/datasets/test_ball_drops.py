import numpy as np
import pandas as pd
import pytest

from skat.datasets import ball_drop_simulator, fetch_ball_drops
from skat.datasets.ball_drops import BALLS


@pytest.fixture(scope="module")
def drops(measured_data):
    return fetch_ball_drops(download_if_missing=False)


def test_conversion_of_the_original_agrees_with_the_tidied_copy(measured_data, drops):
    tidied = pd.read_csv(measured_data / "ball_drops" / "ball_drops.csv")
    pd.testing.assert_frame_equal(drops.frame, tidied, atol=5e-7, rtol=0)  # the copy has six decimals


def test_a_transition_ends_where_the_next_one_starts(drops):
    within = np.diff(drops.groups) == 0
    assert np.array_equal(drops.target[:-1][within], drops.data[1:][within])
    assert len(drops.group_names) == len(set(drops.groups)) == 22


def test_even_grid_keeps_the_measured_heights_where_the_clock_was_even(drops):
    group = drops.group_names.index("Whiffle Ball 1 2")
    measured = drops.frame.query("ball == 'Whiffle Ball 1' and drop == 2")
    on_grid = measured["time_s"].to_numpy() * 15
    rows = np.flatnonzero(np.abs(on_grid - np.round(on_grid)) < 1e-4)
    assert len(rows) > 2
    np.testing.assert_allclose(
        drops.data[drops.groups == group][on_grid[rows].round().astype(int), 0],
        measured["height_m"].to_numpy()[rows],
        atol=1e-4,
    )


def test_every_drop_falls_at_the_frame_rate(drops):
    for group in range(22):
        rows = drops.groups == group
        duration = drops.frame.groupby(["ball", "drop"], sort=False)["time_s"].max().iloc[group]
        assert 0 <= duration - rows.sum() * drops.dt < drops.dt
        assert -20 < np.polyfit(drops.dt * np.arange(rows.sum()), drops.data[rows, 0], 1)[0] < -8


def test_a_choice_is_the_part_of_the_whole(drops):
    chosen = fetch_ball_drops("Tennis Ball", drops=2, download_if_missing=False)
    whole = drops.groups == drops.group_names.index("Tennis Ball 2")
    assert np.array_equal(chosen.data, drops.data[whole])
    assert chosen.group_names == ["Tennis Ball 2"]
    assert set(chosen.groups) == {0}


def test_the_velocity_is_declared_hidden_and_the_licence_named(drops):
    assert drops.hidden == ["qvel.z"]
    assert "MIT" in drops.DESCR
    assert "b79c3431" in drops.DESCR


def test_unknown_names_list_those_that_exist():
    with pytest.raises(ValueError, match=r"no ball 'Football'.*Baseball.*Orange Whiffle Ball"):
        fetch_ball_drops(["Football"])
    with pytest.raises(ValueError, match="no drop 3"):
        fetch_ball_drops(drops=3)
    with pytest.raises(ValueError, match=r"no ball 'Football'.*Baseball"):
        ball_drop_simulator("Football")


@pytest.mark.parametrize("ball", BALLS)
def test_simulation_is_free_fall(ball):
    simulator = ball_drop_simulator(ball)
    states = simulator.rollout(np.array([[47.0, -1.5]]), n_steps=45)[0]
    time = np.arange(46) / 15
    np.testing.assert_allclose(states[:, 0], 47 - 1.5 * time - 9.81 / 2 * time**2, atol=1e-9)
    np.testing.assert_allclose(states[:, 1], -1.5 - 9.81 * time, atol=1e-9)
    assert simulator.dt == pytest.approx(1 / 15, rel=1e-12)
