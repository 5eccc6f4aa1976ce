"""What `fit` and `fit_change` take for a log, and what they say of anything else."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.simulators import MujocoSimulator
from tests.diagnosis.forces.test_force_space import ARM, log_of

SHORT = {"rows": 60}


@dataclass
class Measured:
    X: np.ndarray
    y: np.ndarray
    groups: np.ndarray
    simulator: MujocoSimulator


def arm(frame_skip=5):
    return MujocoSimulator(ARM, frame_skip=frame_skip)


def asks(how, simulator, log):
    """Ask `fit` of one log or of several, or `fit_change`."""
    diagnosis = SimulationDiagnosis(simulator, effects=["mass[lower]"], random_state=0)
    return {
        "one": lambda: diagnosis.fit(log),
        "several": lambda: diagnosis.fit({"june": log_of(4, **SHORT), "july": log}),
        "change": lambda: diagnosis.fit_change(log_of(4, **SHORT), log),
    }[how]()


@pytest.mark.parametrize("how", ["one", "several", "change"])
def test_a_log_of_another_rate_than_the_simulators_is_refused_with_a_remedy(how):
    log = Measured(*log_of(5, **SHORT), arm(frame_skip=10))
    with pytest.raises(
        ValueError, match=r"rows of 0\.02 s, and a step of the simulator is 0\.01 s.*rate=100"
    ):
        asks(how, arm(), log)


def test_a_log_without_groups_is_one_episode_to_what_changed():
    X, y, groups = log_of(4, rows=300)
    simulator = arm()

    def changed(*log):
        return (
            SimulationDiagnosis(simulator, effects=["gain[elbow]"])
            .fit_change((X, y, groups), log)
            .detectable_
        )

    assert changed(X, y) == changed(X, y, None) == changed(X, y, groups)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            "july.csv",
            r"the log after: .* got the path 'july\.csv': read it, load_log\('july\.csv', simulator\)",
        ),
        (pd.DataFrame({"a": [1.0]}), "the log after: .* got a table: read it, load_log"),
        ({"july": 1}, "the log after: .* got dict"),
        (None, "the log after: .* got NoneType"),
        ([log_of(5, **SHORT)] * 2, "the log after: .* got a list of 2"),
        ((np.zeros((9, 6)), None), "the log after: "),
    ],
)
def test_what_is_no_log_is_told_with_which_it_is(given, message):
    with pytest.raises(ValueError, match=message):
        asks("change", arm(), given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("june.csv", r"got the path 'june\.csv'"),
        (pd.DataFrame({"a": [1.0]}), "got a table"),
        ([[1, 2], [3, 4]], "got a list of 2"),
        ({"1": log_of(4, **SHORT), 1: log_of(5, **SHORT)}, "two logs have the same name: '1', 1"),
    ],
)
def test_no_log_is_dropped_and_what_is_none_is_told(given, message):
    with pytest.raises(ValueError, match=message):
        asks("one", arm(), given)


def test_what_is_doubtful_in_a_log_is_told_of_what_changed_too():
    X, y, groups = log_of(5, rows=300)
    degrees = (np.hstack([np.rad2deg(X[:, :4]), X[:, 4:]]), np.rad2deg(y), groups)
    with pytest.raises(ValueError, match=r"the log after: .*degrees"):
        asks("change", arm(), degrees)
    X, y = X.copy(), y.copy()
    X[:, 1] = y[:, 1] = 0.1
    with pytest.warns(UserWarning, match=r"the log after: .*qpos\.elbow"):
        asks("change", arm(), (X, y, groups))
