"""A machine that vibrates: forces that are taken back do not hide what acts at low frequencies."""

from skat.diagnosis import SimulationDiagnosis
from skat.simulators import MujocoSimulator


def _asked(truth):
    from worlds import flexible

    simulator = MujocoSimulator(flexible.nominal(), frame_skip=flexible.STEPS)
    X, y, groups = flexible.log_of(truth, seed=3, rows=500)
    effects = ["dry_friction[hinge]", "gain[motor]"]
    return SimulationDiagnosis(simulator, effects=effects, test_size=0, random_state=0).fit(
        X, y, groups=groups
    )


def test_friction_of_a_pendulum_whose_rod_bends_is_named_and_covered():
    diagnosis = _asked({"dry_friction[hinge]": 0.3})
    assert [cause.name for cause in diagnosis.causes_] == ["dry_friction[hinge]"]
    low, high = diagnosis.causes_[0].interval
    assert low < 0.3 < high
    assert diagnosis._found.fitted.memory.returns


def test_of_a_pendulum_whose_rod_bends_and_that_has_no_friction_nothing_is_named():
    assert _asked({}).verdict_ == "nothing detected"
