"""What a servo does to a robot is told from what is like it, in worlds that share no code with the simulators."""

import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.simulators import MujocoSimulator

OFFERED = ("delay[action]", "lag[all]", "kp[all]", "damping[elbow]", "offset[elbow]", "payload[wrist_3]")


@pytest.mark.parametrize(
    "truth", [{"lag[all]": 0.006}, pytest.param({"payload[wrist_3]": 1.0}, marks=pytest.mark.long)]
)
def test_a_lag_and_a_weight_are_named_alone_with_their_sizes(servo_log, truth):
    ((name, value),) = truth.items()
    log = servo_log("servo_arm", truth, rows=90, episodes=3, seed=5)
    simulator = MujocoSimulator(log.mjcf, frame_skip=log.frame_skip)
    found = SimulationDiagnosis(simulator, effects=OFFERED, random_state=0)
    found.fit(log.X, log.y, groups=log.groups)
    (cause,) = found.causes_
    assert cause.name == name
    assert cause.interval[0] < value < cause.interval[1]
    assert cause.value == pytest.approx(value, rel=0.2)
