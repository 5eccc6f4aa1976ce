"""Each dynamics of the paper's Table I is named: what was changed, where, and by how much."""

import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.simulators import MujocoSimulator

# Those of the quick run have none, and all actuators.
QUICK = ["normal", "inverted"]
LONG = ["light", "some_off", "heavy", "long", "short", "some_inverted"]


def diagnosed(worlds, cases, kind, condition, n_episodes, n_steps=50):
    hidden = cases.condition(kind, condition)
    log = worlds.measure(kind, hidden, seed=17, n_episodes=n_episodes, n_steps=n_steps)
    simulator = MujocoSimulator(worlds.nominal_mjcf(kind), frame_skip=worlds.FRAME_SKIP[kind])
    diagnosis = SimulationDiagnosis(simulator, random_state=0).fit(log.X, log.y, groups=log.groups)
    return diagnosis, {cases.name(family, target): value for family, target, value in hidden}


def assert_diagnosed(diagnosis, truth):
    assert {cause.name for cause in diagnosis.causes_} == set(truth)
    for cause in diagnosis.causes_:
        assert abs(cause.value - truth[cause.name]) < 0.03 * abs(truth[cause.name] - 1)
    assert diagnosis.verdict_ == ("named" if truth else "nothing detected")


@pytest.mark.parametrize(
    "condition", [*QUICK, *(pytest.param(name, marks=pytest.mark.long) for name in LONG)]
)
def test_condition_of_hopper_is_diagnosed(worlds, cases, condition):
    n_steps = 15 if condition in QUICK else 50
    assert_diagnosed(*diagnosed(worlds, cases, "hopper", condition, n_episodes=4, n_steps=n_steps))


@pytest.mark.long
def test_some_off_of_halfcheetah_is_the_gains_of_every_second_actuator(worlds, cases):
    diagnosis, truth = diagnosed(worlds, cases, "halfcheetah", "some_off", n_episodes=4)
    assert set(truth) == {"gain[bshin]", "gain[fthigh]", "gain[ffoot]"}
    assert_diagnosed(diagnosis, truth)
    assert all(cause.sentence.endswith("is disabled") for cause in diagnosis.causes_)


@pytest.mark.long
def test_inverted_ant_is_one_cause(worlds, cases):
    diagnosis, truth = diagnosed(worlds, cases, "ant", "inverted", n_episodes=3)
    assert_diagnosed(diagnosis, truth)
    assert diagnosis.causes_[0].sentence == "gain[all] is inverted"
