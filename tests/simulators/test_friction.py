"""How soft MuJoCo's dry friction is, and what of it acts for certain."""

import mujoco
import numpy as np
import pytest

from skat.simulators.friction import braking_share, creep

SLED = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
<joint type="slide" frictionloss="2" {}/><inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/></body></worldbody>
</mujoco>"""


@pytest.mark.parametrize(
    "soft",
    [
        "",
        'solreffriction="0.05 1"',
        'solreffriction="0.05 3"',
        'solreffriction="0.0001 1"',  # no shorter than two time steps
        'solreffriction="-100 -40"',
        'solimpfriction="0.5 0.8 0.01"',
        'solimpfriction="0.5 0.9999999 0.01"',
        'solimpfriction="0.0000001 0.8 0.01"',
    ],
)
def test_a_push_within_friction_ends_in_the_creep_of_the_soft_constraint(soft):
    """R force = -b speed, with the acceleration zero."""
    model = mujoco.MjModel.from_xml_string(SLED.format(soft))
    softness, damping = creep(model)
    data = mujoco.MjData(model)
    data.qvel[0], data.qfrc_applied[0] = softness[0] / damping[0], 1.0
    mujoco.mj_forward(model, data)
    assert data.qfrc_constraint[0] == pytest.approx(-1.0, rel=1e-6)
    assert data.qacc[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("speed", [-3.0, -0.4, 0.0, 0.1, 0.7, 2.0])
@pytest.mark.parametrize("zone", [0.05, 0.6])
@pytest.mark.parametrize("slip", [0.2, 1.5])
def test_share_of_friction_is_the_mean_over_the_speeds_that_may_be(speed, zone, slip):
    quantiles = np.linspace(-9, 9, 200_001)
    weights = np.exp(-0.5 * quantiles**2)
    cut = np.clip((speed + slip * quantiles) / zone, -1, 1)
    expected = cut @ weights / weights.sum()
    found = braking_share(np.array(speed), np.array(zone), np.array(slip))
    assert found == pytest.approx(expected, abs=1e-8)


def test_share_of_friction_at_a_certain_speed_is_that_within_its_zone():
    speeds = np.array([-2.0, -0.5, 0.0, 0.1, 3.0])
    found = braking_share(speeds, np.full(5, 0.5), np.zeros(5))
    np.testing.assert_allclose(found, [-1.0, -1.0, 0.0, 0.2, 1.0], atol=1e-8)
    rigid = braking_share(speeds, np.zeros(5), np.zeros(5))
    np.testing.assert_allclose(rigid, np.sign(speeds), atol=1e-8)
