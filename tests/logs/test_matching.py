"""Which columns are taken for what: whole plans of recordings whose columns have names and no numbers."""

from functools import cache

import pytest

from skat.logs.matching import plan
from skat.logs.streams import Recording, Stream
from skat.simulators import MujocoSimulator

SLIDE = """
<mujoco><compiler angle="radian"/><worldbody>
  <body><joint name="rail" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <body><joint name="hip" axis="0 1 0"/><inertial pos="0 0 -1" mass="1" diaginertia="1 1 1"/></body></body>
</worldbody><actuator>{}</actuator></mujoco>
"""
MOTORS = '<motor name="push" joint="rail"/><motor name="turn" joint="hip"/>'
SERVOS = '<position name="lift" joint="rail" kp="9"/><position name="bend" joint="hip" kp="9"/>'


@cache
def machine(actuators):
    return MujocoSimulator(SLIDE.format(actuators))


def planned(actuators, *streams, columns=None, units=None, topic=None, episodes=None, labels=None):
    """Return the plan for a table, or for topics as (name, columns); columns are names with blanks between."""
    named = [("", one) if isinstance(one, str) else one for one in streams]
    record = Recording(
        "log", tuple(Stream(name, tuple(own.split()), None, labels=labels or {}) for name, own in named)
    )
    return plan(record, machine(actuators), columns or {}, units, topic, episodes)


@pytest.mark.parametrize(
    ("pattern", "unit", "measured"),
    [
        ("*", "deg", "qpos.hip qvel.hip ctrl.bend"),
        ("*", "mm", "qpos.rail qvel.rail ctrl.lift"),
        ("*", "x:2", "qpos.rail qpos.hip qvel.rail qvel.hip ctrl.lift ctrl.bend"),
        ("*.hip", "deg", "qpos.hip qvel.hip"),
        ("qpos.*", "deg", "qpos.hip"),
        ("ctrl.*", "-cm+1", "ctrl.lift"),
        ("ctrl.*", "x:2", "ctrl.push ctrl.turn ctrl.lift ctrl.bend"),
        ("ctrl.turn", "deg", "ctrl.turn"),
    ],
)
def test_a_unit_for_many_is_that_of_what_it_measures_however_it_is_told(pattern, unit, measured):
    """What an error advises on the command line, ``--map '*=:deg'``, is what ``units="deg"`` does."""
    names = "time qpos.rail qpos.hip qvel.rail qvel.hip ctrl.push ctrl.turn ctrl.lift ctrl.bend"
    ways = [{"columns": {pattern: f":{unit}"}}, {"units": {pattern: unit}}]
    ways += [{"units": unit}] if pattern == "*" else []
    for told in ways:
        found = planned(MOTORS + SERVOS, names, **told)
        assert {match.name for match in found.matches if match.unit} == set(measured.split())
        assert found.told_units == set(measured.split())
