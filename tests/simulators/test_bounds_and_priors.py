"""Bounds that no geared robot breaks, and what is likely before anything was measured."""

import math

import pytest

from skat.effects import FAMILIES, Effect
from skat.simulators import MujocoSimulator, make_simulator

# An arm as light at its wrist as a UR10's last link, driven by torques that no limit tells of.
ARM = """
<mujoco><option timestep="0.002"/><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .6 0 0" size=".06" mass="12" contype="0"/>
    <body name="wrist" pos=".6 0 0"><joint name="wrist" axis="1 0 0"/>
      <geom type="cylinder" size=".045 .02" euler="0 90 0" mass=".2" contype="0"/></body></body>
</worldbody><actuator><motor joint="shoulder"/><motor joint="wrist" {limit}/></actuator></mujoco>
"""


def effects_of(limit=""):
    return {effect.name: effect for effect in MujocoSimulator(ARM.format(limit=limit)).effects()}


@pytest.mark.parametrize("limit", ["", 'forcerange="-54 54"'])
@pytest.mark.parametrize(
    ("name", "value"), [("armature[wrist]", 0.49), ("damping[wrist]", 3.2), ("dry_friction[wrist]", 2.8)]
)
def test_a_light_wrist_may_have_a_geared_drive(name, value, limit):
    """What least squares finds at the last joint of a UR10, whose link has 0.0002 kg m2."""
    assert effects_of(limit)[name].bounds[1] > value


def test_a_force_limit_sets_the_bounds():
    low, high = effects_of('forcerange="-54 54"'), effects_of('forcerange="-5400 5400"')
    for family in ("armature", "damping", "dry_friction"):
        name = f"{family}[wrist]"
        assert high[name].bounds[1] == pytest.approx(100 * low[name].bounds[1], rel=1e-9)
        assert high[name].typical == pytest.approx(100 * low[name].typical, rel=1e-9)


def test_every_effect_has_the_odds_and_the_typical_size_of_its_family():
    for name in ("hopper", "ant", "puck"):
        for effect in make_simulator(name).effects():
            record = FAMILIES[effect.family]
            assert effect.odds == record.odds
            assert 0 < effect.typical < math.inf
            if record.typical is not None and record.force_share is None:
                assert effect.typical == record.typical


def test_friction_is_likelier_than_tilt_and_a_user_says_otherwise():
    assert FAMILIES["dry_friction"].odds == FAMILIES["mass"].odds == FAMILIES["delay"].odds == 1
    assert all(FAMILIES[name].odds < 0.5 for name in ("tilt", "length", "gravity", "scale", "timestep"))
    own = Effect("mass[arm]", unit="1", neutral=1.0, bounds=(0.5, 2.0), typical=0.03, odds=4.0)
    assert (own.typical, own.odds) == (0.03, 4.0)
    unknown = Effect("drag", unit="1/s", neutral=0.0, bounds=(0.0, 2.0))
    assert (unknown.typical, unknown.odds) == (0.2, 1.0)
    with pytest.raises(ValueError, match="odds of drag must be positive"):
        Effect("drag", unit="1/s", neutral=0.0, bounds=(0.0, 2.0), odds=0.0)


def test_aliases_of_a_mass_are_those_that_share_its_moment():
    effects = {effect.name: effect for effect in make_simulator("hopper").effects()}
    assert "mass[torso]" in effects["centre_of_mass[torso.x]"].aliases
    assert "payload[torso]" in effects["mass[torso]"].aliases


def test_a_lopsided_force_limit_bounds_as_its_larger_side_does():
    lopsided, even = (
        {name: effect.bounds for name, effect in effects_of(limit).items() if effect.family != "force_limit"}
        for limit in ('forcerange="-10 54"', 'forcerange="-54 54"')
    )
    assert lopsided == even


def test_a_motor_may_be_turned_round_at_any_strength_that_it_may_have_the_right_way():
    for name in ("gain[wrist]", "gain[all]"):
        low, high = effects_of()[name].bounds
        assert low == -high
