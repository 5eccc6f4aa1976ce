"""An arm whose base shakes: what pushes both joints at once is one thing, and hides nothing."""

import numpy as np
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.simulators import MujocoSimulator

SEED = 8000


def _asked(truth):
    from worlds import shaken

    simulator = MujocoSimulator(shaken.nominal(), frame_skip=shaken.STEPS)
    X, y, groups = shaken.log_of(truth, seed=SEED)
    return SimulationDiagnosis(simulator, random_state=SEED).fit(X, y, groups=groups)


def test_a_friction_is_named_alone_and_covered(tmp_path):
    from worlds import shaken

    diagnosis = _asked({"dry_friction[elbow]": 0.06})
    (cause,) = diagnosis.causes_
    low, high = cause.interval
    assert cause.name == "dry_friction[elbow]"
    assert low < 0.06 < high
    noise = diagnosis._found.fitted.estimate.noise
    covariance = (noise.mixing[0] * noise.force[0, :2]) @ noise.mixing[0].T
    # A base has one direction, of which the pose makes a little more than one.
    assert covariance[0, 1] > 0.8 * np.sqrt(covariance[0, 0] * covariance[1, 1])
    # Of an episode as a whole, of another number of pieces, such forces are known as well, also from a file.
    X, y, groups = shaken.log_of({"dry_friction[elbow]": 0.06}, seed=SEED + 1, episodes=2)
    diagnosis.save(tmp_path / "shaken.skat")
    loaded = SimulationDiagnosis.load(tmp_path / "shaken.skat", simulator=diagnosis.simulator)
    for horizon in (None, "episode"):
        gains = [one.evaluate(X, y, groups=groups, horizon=horizon) for one in (diagnosis, loaded)]
        assert gains[0] == gains[1]
        assert gains[0].extended < gains[0].nominal


def test_nothing_is_named_where_nothing_is_hidden():
    assert _asked({}).causes_ == []


@pytest.mark.long
def test_with_forces_that_are_independent_by_decree_it_is_not(monkeypatch):
    monkeypatch.setattr("skat.diagnosis.fitting.acting_together", lambda fitted: fitted)
    assert [cause.name for cause in _asked({"dry_friction[elbow]": 0.06}).causes_] != ["dry_friction[elbow]"]
