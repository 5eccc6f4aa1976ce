"""A joint that friction holds and one whose motor is dead: told apart by how it comes to rest."""

import numpy as np
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.simulators import MujocoSimulator

CART = """<mujoco><option timestep="0.005" gravity="0 0 0" integrator="implicitfast"/><worldbody><body>
<joint name="rail" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/></body></worldbody>
<actuator><motor name="push" joint="rail" ctrlrange="-8 8"/></actuator></mujoco>"""
EFFECTS = ["mass[body1]", "damping[rail]", "dry_friction[rail]", "gain[push]", "wind[x]"]


def log_of(hidden):
    simulator = MujocoSimulator(CART, frame_skip=4)
    rng = np.random.default_rng(7)
    starts = np.column_stack([np.zeros(4), [0.5, -0.5, 0.35, -0.35]])
    commands = np.repeat(rng.uniform(-5, 5, (4, 8, 1)), 5, axis=1)
    path = simulator.rollout_many(starts, commands, [hidden], n_steps=40)[0]
    path = path + rng.normal(size=path.shape) * [1e-3, 1e-2]
    X = np.concatenate([path[:, :-1], commands], axis=2).reshape(-1, 3)
    return simulator, X, path[:, 1:].reshape(-1, 2), np.repeat(np.arange(4), 40)


@pytest.mark.parametrize(("name", "value"), [("dry_friction[rail]", 12.0), ("gain[push]", 0.0)])
def test_friction_that_holds_is_told_from_a_dead_motor(name, value):
    simulator, X, y, groups = log_of({name: value})
    diagnosis = SimulationDiagnosis(simulator, effects=EFFECTS, test_size=0, random_state=0)
    diagnosis.fit(X, y, groups=groups)
    assert [cause.name for cause in diagnosis.causes_] == [name]
    low, high = diagnosis.causes_[0].interval
    assert low <= value <= high
