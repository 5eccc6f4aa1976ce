"""Which columns are taken for what: whole plans of recordings whose columns have names and no numbers."""

from functools import cache

import pytest

from skat.logs import LogError
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


def refused(*streams, actuators=MOTORS, **told):
    with pytest.raises(LogError) as caught:
        planned(actuators, *streams, **told)
    return caught.value


def taken(found):
    """Return {name: (column, unit, how)} of what is no clock and no episode."""
    return {
        match.name: (match.theirs, match.unit, match.how)
        for match in found.matches
        if match.name not in ("time", "episode")
    }


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


NAMES = ("qpos.rail", "qpos.hip", "qvel.rail", "qvel.hip", "ctrl.push", "ctrl.turn")
ORDER, STATE = "by order", "by order, [qpos, qvel]"


@pytest.mark.parametrize(
    ("columns", "expected", "how", "lacking"),
    [
        ("rail_pos hip_angle rail_speed hip_rate push_cmd turn_cmd", NAMES, "by its name", ()),
        # Of an actuator the joint that it drives is a name, too.
        ("rail_pos hip_angle rail_speed hip_rate rail_cmd hip_cmd", NAMES, "by its name", ()),
        ("q_2 q_10 dq_2 dq_10 u_2 u_10", NAMES, ORDER, ()),
        ("q_raw1 q_raw2 q1 q2 dq1 dq2 u1 u2", ("q1", "q2", "dq1", "dq2", "u1", "u2"), ORDER, ()),
        ("q1 q2 q3 q4 q7 theta1 theta2 u1 u2", ("theta1", "theta2", None, None, "u1", "u2"), ORDER, NAMES[2:4]),
        ("obs[0] obs[1] obs[2] obs[3] u1 u2", ("obs[0]", "obs[1]", "obs[2]", "obs[3]", "u1", "u2"), STATE, ()),
        ("obs[0] obs[1] obs[2] u1 u2", (None, "obs[0]", "obs[1]", "obs[2]", "u1", "u2"), STATE, NAMES[:1]),
        ("obs[0] obs[1] u1 u2", ("obs[0]", "obs[1]", None, None, "u1", "u2"), ORDER, NAMES[2:4]),
        ("rail hip u_push u_turn", ("rail", "hip", None, None, "u_push", "u_turn"), "by its name", NAMES[2:4]),
        ("rail_pos rail_pos_filt hip_pos push_u turn_u", ("rail_pos", "hip_pos", None, None, "push_u", "turn_u"),
         "by its name", NAMES[2:4]),
        ("hip_vel push_u turn_u", (None, None, None, "hip_vel", "push_u", "turn_u"), "by its name", NAMES[:3]),
    ],
)  # fmt: skip
def test_columns_are_found_by_joint_by_number_or_as_one_vector(columns, expected, how, lacking):
    found = planned(MOTORS, f"time {columns}")
    own = columns.split() if expected is NAMES else expected
    assert {name: match[0] for name, match in taken(found).items()} == {
        name: column for name, column in zip(NAMES, own) if column
    }
    assert {match[2] for name, match in taken(found).items() if name.startswith("q")} == {how}
    assert found.lacking == lacking
    assert (found.times, found.episode) == ({0: ("time", None)}, None)


def test_what_is_taken_by_order_lacking_and_left_aside_is_said():
    found = planned(MOTORS, "time obs[0] obs[1] u1 u2 temperature image[0] image[1]")
    assert found.notes == (
        "Taken by order, as the file names no joints: ctrl.push = u1, ctrl.turn = u2, qpos.rail = obs[0], "
        "qpos.hip = obs[1].",
        "Left aside: temperature, image.",
        "Not in the log, so not measured: qvel.rail, qvel.hip.",
    )
    assert planned(MOTORS, f"time {' '.join(NAMES)}").notes == ()


@pytest.mark.parametrize(
    ("commands", "chosen"),
    [
        ("lift_pos_cmd bend_pos_cmd lift_force_cmd bend_force_cmd", "lift_pos_cmd bend_pos_cmd"),
        ("lift_force_cmd bend_force_cmd lift_cmd bend_cmd", "lift_cmd bend_cmd"),
        ("lift_vel_cmd bend_vel_cmd lift_pos_cmd bend_pos_cmd", "lift_pos_cmd bend_pos_cmd"),
    ],
)
def test_commands_of_servos_are_positions(commands, chosen):
    found = taken(planned(SERVOS, f"time rail_pos hip_pos {commands}"))
    assert [found[name][0] for name in ("ctrl.lift", "ctrl.bend")] == chosen.split()
    alone = refused("time rail_pos hip_pos lift_force_cmd bend_force_cmd", actuators=SERVOS)
    assert "Columns that could be commands: lift_force_cmd, bend_force_cmd." in str(alone)


@pytest.mark.parametrize(
    ("columns", "problem", "advice", "options"),
    [
        (
            "time q1 q2 theta1 theta2 u1 u2",
            "has several series of columns that may be qpos.rail, qpos.hip: q#, theta#.",
            "",
            {"columns": {"qpos.rail": "q1", "qpos.hip": "q2"}},
        ),
        (
            "time rail_pos rail_q hip_pos u1 u2",
            "has several columns that may be qpos.rail: rail_pos, rail_q.",
            "",
            {"columns": {"qpos.rail": "rail_pos"}},
        ),
        (
            "time rail_pos hip_pos push_u push_cmd turn_u",
            "has several columns that may be ctrl.push: push_u, push_cmd.",
            "",
            {"columns": {"ctrl.push": "push_u"}},
        ),
        # Of a vector with more than the state, or much less, nothing is known.
        *(
            (
                f"time {vector} u1 u2",
                f"no column could be found for the model's positions (qpos.rail, qpos.hip); it has time, "
                f"{', '.join(vector.split())}, u1, u2.",
                "Say which is which: columns={'qpos.rail': 'obs[0]'} (on the command line --map 'qpos.rail=obs[0]'); "
                "with :deg behind it where it is in degrees. Or the log is of another robot.",
                {},
            )
            for vector in ("obs[0]", "obs[0] obs[1] obs[2] obs[3] obs[4]")
        ),
        (
            "time lever u1 u2",
            "no column could be found for the model's positions (qpos.rail, qpos.hip); it has time, lever, u1, u2.",
            "Say which is which: columns={'qpos.rail': 'lever'} (on the command line --map 'qpos.rail=lever'); with "
            ":deg behind it where it is in degrees. Or the log is of another robot.",
            {},
        ),
        (
            "time rail_pos hip_pos tau_1 tau_2 temperature",
            "no column could be found for ctrl.push, ctrl.turn: what the model's motors were told. Columns that could "
            "be commands: tau_*.",
            "If a column is the command, name it (--map 'ctrl.*=tau_*'). If the motors were off, and the robot moved "
            "freely, hold the commands constant at 0.",
            {"columns": {"ctrl.*": "0"}},
        ),
        (
            "time rail_pos hip_pos turn_u tau_1",
            "no column could be found for ctrl.push: what the model's motors were told. Columns that could be "
            "commands: tau_1.",
            "If a column is the command, name it (--map 'ctrl.push=tau_1'). If the motors were off, and the robot "
            "moved freely, hold the commands constant at 0.",
            {"columns": {"ctrl.push": "0"}},
        ),
    ],
)
def test_what_cannot_be_chosen_is_asked_for(columns, problem, advice, options):
    error = refused(columns)
    assert (error.where, error.problem, error.advice, error.options) == ("log", problem, advice, options)


ALL = "qpos.rail qpos.hip qvel.rail qvel.hip ctrl.push ctrl.turn"


@pytest.mark.parametrize(
    ("columns", "told", "clock"),
    [
        ("t time", {}, ("time", None)),
        ("clock t_us stamp_ms", {}, ("t_us", "us")),
        ("sim_clock_ms", {}, ("sim_clock_ms", "ms")),
        ("t time", {"units": {"time": "ms"}}, ("time", "ms")),
        # A unit alone does not say which clock.
        ("t time", {"columns": {"time": ":us"}}, ("time", "us")),
        ("t time_ns", {"columns": {"time": ":us"}, "units": {"time": "ms"}}, ("t", "us")),
        ("time tick_ms", {"columns": {"time": "tick_ms"}}, ("tick_ms", "ms")),
        ("time tick_ms", {"columns": {"time": "tick_ms:us"}}, ("tick_ms", "us")),
        ("time tick_ms", {"columns": {"time": "tick_ms"}, "units": {"time": "s"}}, ("tick_ms", "s")),
        ("time", {"columns": {"time": "-"}}, None),
        ("elapsed", {}, None),
    ],
)
def test_the_clock_of_a_table_is_one_that_is_told_or_named_so(columns, told, clock):
    assert planned(MOTORS, f"{columns} {ALL}", **told).times == ({0: clock} if clock else {})
