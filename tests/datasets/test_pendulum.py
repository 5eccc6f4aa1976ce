import numpy as np
import pandas as pd
import pytest

from skat.datasets import fetch_pendulum, pendulum_simulator


@pytest.mark.parametrize(("load", "ending", "n_pieces"), [(0.5, "", 8), (1.0, "_1kg", 16)])
def test_rows_are_those_of_the_originals(measured_data, load, ending, n_pieces):
    run = fetch_pendulum(load=load, download_if_missing=False)
    measured = pd.read_csv(measured_data / "pendulum" / f"data_measured{ending}.csv")
    commanded = pd.read_csv(measured_data / "pendulum" / f"data_desired{ending}.csv")
    n_rows = 100 * n_pieces
    assert run.data.shape == (n_rows, 3)
    assert run.target.shape == (n_rows, 2)
    assert np.array_equal(run.data[:, :2], measured[["position", "velocity"]][:n_rows])
    assert np.array_equal(run.target, measured[["position", "velocity"]][1 : n_rows + 1])
    assert np.array_equal(run.data[:, 2], commanded["torque"][:n_rows])
    assert np.array_equal(run.frame["torque_N_m"], measured["torque"])
    assert list(np.bincount(run.groups)) == [100] * n_pieces
    assert run.group_names[:2] == ["from 0 s", "from 0.5 s"]
    assert np.abs(run.data[:, 0]).max() < np.pi - 0.3
    assert "BSD-3-Clause" in run.DESCR
    assert np.diff(run.frame["time_s"]).mean() == pytest.approx(run.dt, rel=1e-3)


def test_whole_run_goes_on_where_the_pendulum_is_up(measured_data):
    whole = fetch_pendulum(part="all", seconds=2.0, download_if_missing=False)
    assert len(whole.data) == 3600  # 3,999 transitions have nine pieces of 400
    assert np.abs(whole.data[:, 0]).max() > 15
    assert len(whole.group_names) == 9


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"part": "swingup"}, '"swing-up" or "all"; it is \'swingup\''),
        ({"seconds": 0.05}, "seconds must be from 0.1 to 4.*it is 0.05"),
        ({"seconds": 30.0}, "seconds must be from 0.1 to 4.*it is 30"),
    ],
)
def test_bad_arguments_are_refused(measured_data, options, message):
    with pytest.raises(ValueError, match=message):
        fetch_pendulum(**options, download_if_missing=False)


def test_simulation_swings_as_a_point_mass_on_a_rod():
    path = pendulum_simulator().rollout(np.array([[0.1, 0.0]]), np.zeros((1, 600, 1)), n_steps=600)[0, :, 0]
    crossings = np.flatnonzero((path[1:] < 0) & (path[:-1] >= 0))
    falls = 0.005 * (crossings + path[crossings] / (path[crossings] - path[crossings + 1]))
    assert np.diff(falls)[0] == pytest.approx(2 * np.pi * np.sqrt(0.5 / 9.81) * (1 + 0.1**2 / 16), rel=2e-3)
    torque = 0.6755 * 9.81 * 0.5 * np.sin(1.0)
    held = pendulum_simulator().predict(np.array([[1.0, 0.0, torque]]))
    np.testing.assert_allclose(held, [[1.0, 0.0]], atol=1e-4)


@pytest.mark.parametrize("mass", [0.0, -1.0, np.inf, np.nan])
def test_mass_must_be_positive(mass):
    with pytest.raises(ValueError, match="mass must be positive"):
        pendulum_simulator(mass)
