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
    parts = [
        Stream(
            name,
            tuple(own.split()),
            None,
            labels=labels or {},
            clock_unit="s" if name.startswith("/") else None,
        )
        for name, own in named
    ]
    record = Recording("log", tuple(parts))
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
        # Of what has positions, a vector is another matter.
        ("rail_pos hip_pos obs[0] obs[1] obs[2] obs[3] u1 u2", ("rail_pos", "hip_pos", None, None, "u1", "u2"),
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
        # Numbers beside the name of something else are none of joints.
        (
            "time lever_1_pos lever_2_pos u1 u2",
            "no column could be found for the model's positions (qpos.rail, qpos.hip); it has time, lever_1_pos, "
            "lever_2_pos, u1, u2.",
            "Say which is which: columns={'qpos.rail': 'lever_1_pos'} (on the command line --map "
            "'qpos.rail=lever_1_pos'); with :deg behind it where it is in degrees. Or the log is of another robot.",
            {},
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


ARM = ("/arm", "/arm.q[rail] /arm.q[hip] /arm.header.stamp /arm.time /arm.run")
TOLD = ("/cmd", "/cmd.data[1] /cmd.data[0] /cmd.time")
OTHER = ("/other", "/other.q[rail] /other.q[hip] /other.time /other.header.stamp")


@pytest.mark.parametrize(
    ("streams", "told", "clocks"),
    [
        ([ARM], {"columns": {"ctrl.*": "0"}}, ["/arm.header.stamp"]),
        # Stamps of the sender count where every topic that is used has them: clocks must be one.
        ([ARM, TOLD], {}, ["/arm.time", "/cmd.time"]),
        ([ARM, ("/cmd", f"{TOLD[1]} /cmd.header.stamp")], {}, ["/arm.header.stamp", "/cmd.header.stamp"]),
        ([OTHER, ARM, TOLD], {"topic": "/arm"}, [None, "/arm.time", "/cmd.time"]),
        ([ARM, TOLD], {"columns": {"time": "/arm.run:ms"}}, ["/arm.run", "/cmd.time"]),
    ],
)
def test_clocks_of_topics_are_those_of_their_messages(streams, told, clocks):
    found = planned(MOTORS, *streams, **told)
    expected = {place: clock for place, clock in enumerate(clocks) if clock}
    assert {place: clock for place, (clock, _) in found.times.items()} == expected
    assert {unit for clock, unit in found.times.values() if clock != "/arm.run"} <= {"s"}
    assert [match.theirs for match in found.matches if match.name == "time"] == list(expected.values())
    assert taken(found)["qpos.hip"] == ("/arm.q[hip]", "", "by its name")


def test_tables_beside_each_other_have_clocks_of_their_own():
    tables = [("a", "a.t a.rail_pos a.hip_pos"), ("b", "b.t_ms b.tick b.u1 b.u2"), ("c", "c.time")]
    assert planned(MOTORS, *tables).times == {0: ("a.t", None), 1: ("b.t_ms", "ms")}
    told = planned(MOTORS, *tables, columns={"time": "b.tick:us"}, units={"time": "s"})
    assert told.times == {0: ("a.t", "s"), 1: ("b.tick", "us")}
    assert planned(MOTORS, *tables, columns={"time": ":us"}).times == {0: ("a.t", "us"), 1: ("b.t_ms", "us")}
    timed = [("a", "a.t a.rail_pos a.hip_pos a.time"), ("b", "b.time b.u1 b.u2")]
    assert planned(MOTORS, *timed).times == {0: ("a.time", None), 1: ("b.time", None)}
    assert planned(MOTORS, *timed, units={"time": "ms"}).times == {0: ("a.time", "ms"), 1: ("b.time", "ms")}


@pytest.mark.parametrize(("topic", "advised"), [("cmd", "/cmd"), ("/leg", "/arm")])
def test_a_topic_that_is_not_there_is_told_with_one_that_is(topic, advised):
    error = refused(ARM, TOLD, topic=topic)
    assert error.problem == f"has no topic {topic!r} with numbers; it has /arm, /cmd."
    assert error.options == {"topic": advised}
    assert refused(OTHER, ARM, TOLD).options == {"topic": "/other"}
    assert planned(MOTORS, f"time {ALL}", topic=topic).lacking == ()  # a table has none


@pytest.mark.parametrize(
    ("columns", "told", "episode", "how"),
    [
        ("run Episode", {}, "Episode", "by its name"),
        ("Traj_ID lap", {}, "Traj_ID", "by its name"),
        ("run Episode", {"episodes": "run"}, "run", "told"),
        ("run lap", {"columns": {"episode": "lap"}}, "lap", "told"),
        ("run lap", {"columns": {"episode": "lap"}, "episodes": "gaps"}, "lap", "told"),
        ("run", {"episodes": "gaps"}, None, None),
        ("lap", {}, None, None),
    ],
)
def test_episodes_are_told_apart_by_what_is_told_or_named_so(columns, told, episode, how):
    found = planned(MOTORS, f"time {columns} {ALL}", **told)
    assert found.episode == ((0, episode) if episode else None)
    matched = [(match.theirs, match.unit, match.how) for match in found.matches if match.name == "episode"]
    assert matched == ([(episode, "", how)] if episode else [])
    assert planned(MOTORS, ("a", f"time {ALL}"), ("b", "b.t run")).episode is None


@pytest.mark.parametrize(("columns", "advised"), [("time Run", "Run"), ("time lap", "gaps")])
def test_a_column_of_episodes_that_is_not_there_is_told_with_what_may_be_meant(columns, advised):
    error = refused(f"{columns} {ALL}", episodes="turn")
    assert error.problem == (
        f"was told to tell episodes apart and is not there; it has {', '.join(f'{columns} {ALL}'.split())}."
    )
    assert error.options == {"episodes": advised}


SAID = [
    # What names one channel comes before what names many, in any order.
    ({"qpos.hip": "b", "qpos.*": "*_a"}, "rail_a hip_a b", "rail_a b", "told", 2),
    ({"qpos.*": "*_a", "qpos.hip": "b"}, "rail_a hip_a b", "rail_a b", "told", 2),
    ({"qpos.hip": "-", "qpos.*": "*_a"}, "rail_a hip_a", "rail_a", "told", 3),
    ({"qpos.*": "j_*_p"}, "j_10_p j_2_p", "j_2_p j_10_p", "told, by order", 2),
    ({"qpos.*": "j_*_p"}, "j_hip_joint_p j_rail_joint_p j_p", "j_rail_joint_p j_hip_joint_p", "told", 2),
    ({"qpos.*": "angle"}, "angle[10] angle[9]", "angle[9] angle[10]", "told, by order", 2),
    ({"qpos.*": "angle"}, "angle[hip] angle[rail]", "angle[rail] angle[hip]", "told", 2),
    ({"qpos.*": "angle"}, "angle[7] angle[8]", "angle[8] angle[7]", "told", 2),
    ({"qpos.*": "arm/angle"}, "/arm/angle[0] /arm/angle[1]", "/arm/angle[0] /arm/angle[1]", "told, by order", 2),
]  # fmt: skip


@pytest.mark.parametrize(("columns", "theirs", "expected", "how", "n_lacking"), SAID)
def test_columns_are_those_that_the_user_says(columns, theirs, expected, how, n_lacking):
    labels = {"angle[7]": "hip.pos", "angle[8]": "rail.pos"}
    found = planned(MOTORS, f"time {theirs} u1 u2", columns=columns, labels=labels)
    positions = {name: match for name, match in taken(found).items() if name.startswith("qpos.")}
    assert [match[0] for match in positions.values()] == expected.split()
    assert {match[2] for match in positions.values()} == {how}
    assert len(found.lacking) == n_lacking


def test_a_vector_of_all_joints_keeps_its_order_where_one_is_told_apart():
    columns = {"qpos.*": "angle", "qpos.hip": "angle[1]:deg"}
    found = taken(planned(MOTORS, "time angle[0] angle[1] u1 u2", columns=columns))
    assert found["qpos.rail"] == ("angle[0]", "", "told, by order")
    assert found["qpos.hip"] == ("angle[1]", "deg", "told")


def test_constants_units_and_what_is_left_out_are_those_that_the_user_says():
    said = {"qpos.rail": "a:mm", "qpos.hip": "b", "qvel.*": "-", "ctrl.turn": "0:-x:2", "ctrl.*": "0.5"}
    found = planned(MOTORS, "time a b 0 rail_vel hip_vel", columns=said, units={"qpos.rail": "cm"})
    assert taken(found) == {
        "qpos.rail": ("a", "mm", "told"),
        "qpos.hip": ("b", "", "told"),
        "ctrl.push": ("0.5", "", "told"),
        "ctrl.turn": ("0", "-x:2", "told"),
    }
    assert found.constants == {"ctrl.push": 0.5}
    assert found.lacking == ("qvel.rail", "qvel.hip")
    assert found.told_units == {"qpos.rail", "ctrl.turn"}
    unit = found.found["ctrl.turn"][2]
    assert (unit.factor, unit.sign) == (2.0, -1.0)


def test_a_topic_of_commands_is_told_by_its_name_where_it_has_one_array():
    found = taken(planned(MOTORS, ARM, TOLD, columns={"ctrl.*": "/cmd"}))
    assert found["ctrl.push"] == ("/cmd.data[0]", "", "told, by order")
    assert found["ctrl.turn"] == ("/cmd.data[1]", "", "told, by order")
    two = refused(ARM, (TOLD[0], f"{TOLD[1]} /cmd.other[0]"), columns={"ctrl.*": "/cmd"})
    assert (two.where, two.problem) == ("log, column '/cmd'", "was told for ctrl.* and is not there.")


@pytest.mark.parametrize(
    ("theirs", "columns", "where", "problem", "advice"),
    [
        ("a b", {"qpos.*": "a"}, "column a", "is one column, and qpos.* means 2 inputs: qpos.rail, qpos.hip.",
         "Name one input for it, or put * for what differs in their names."),
        ("q_1 q_2 q_3", {"qpos.*": "q_*"}, "q_*",
         "has 3 columns (q_1, q_2, q_3) for 2 inputs; none is named after qpos.rail, qpos.hip.",
         "Name each: columns={'qpos.rail': 'q_1'} (on the command line --map 'qpos.rail=q_1')."),
        ("q_hip q_2", {"qpos.*": "q_*"}, "q_*",
         "has 2 columns (q_hip, q_2) for 2 inputs; none is named after qpos.rail.",
         "Name each: columns={'qpos.rail': 'q_hip'} (on the command line --map 'qpos.rail=q_hip')."),
        ("rail_pos b", {"qpos.rail": "rail_p"}, "column 'rail_p'", "was told for qpos.rail and is not there.",
         "It has rail_pos."),
        ("rail_pos b", {"qpos.rail": "zz"}, "column 'zz'", "was told for qpos.rail and is not there.",
         "It has time, rail_pos, b, u1, u2."),
        ("a b", {"qpos.knee": "a"}, "columns['qpos.knee']", "is no input of the simulator.",
         f"It has {', '.join(ALL.split())}, time and episode."),
        ("a b", {"act.*": "a"}, "columns['act.*']", "means no input of the simulator.",
         f"It has {', '.join(ALL.split())}."),
        ("a b", {"qpos.hip": "a:m"}, "unit of qpos.hip", "'m' does not measure what the model has in rad.",
         "Check the unit or the name."),
        ("a b", {"qpos.hip": "a", "qvel.rail": "b:rpm"}, "unit of qvel.rail",
         "'rpm' does not measure what the model has in m/s.", "Check the unit or the name."),
        ("a b", {"time": "tick", "qpos.rail": "a"}, "column 'tick'", "was told for time and is not there.",
         "It has time, a, b, u1, u2."),
    ],
)  # fmt: skip
def test_what_a_user_says_and_is_not_there_is_told(theirs, columns, where, problem, advice):
    error = refused(f"time {theirs} u1 u2", columns=columns)
    assert (error.where, error.problem, error.advice) == (f"log, {where}", problem, advice)


def test_rates_told_as_angles_or_lengths_are_those_in_a_second():
    units = {
        "qpos.hip": "deg",
        "qvel.hip": "deg",
        "qvel.rail": "mm",
        "ctrl.push": "A:0.5",
        "ctrl.turn": "mNm",
    }
    found = planned(MOTORS, f"time {ALL}", units=units)
    assert {name: unit for name, (_, unit, _) in taken(found).items() if unit} == units


@pytest.mark.parametrize(
    ("columns", "theirs", "positions"),
    [
        ({"*.hip": "leg"}, "rail_q leg_q rail_v leg_v", ["rail_q", "leg_q"]),
        ({"*.rail": "0"}, "hip_q", ["0", "hip_q"]),
        ({"*.rail": "-"}, "rail_q hip_q", [None, "hip_q"]),
        ({"qpos.*": "*_q"}, "rail_q hip_q", ["rail_q", "hip_q"]),
    ],
)
def test_a_joints_name_in_all_columns_a_number_and_a_dash_are_told_apart(columns, theirs, positions):
    found = taken(planned(MOTORS, f"time {theirs} u_push u_turn", columns=columns))
    assert [found.get(name, [None])[0] for name in ("qpos.rail", "qpos.hip")] == positions
    assert [found[name][0] for name in ("ctrl.push", "ctrl.turn")] == ["u_push", "u_turn"]


URDF = """
<robot name="arm"><link name="world"/>
  <link name="arm">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="hip" type="continuous"><axis xyz="0 1 0"/><parent link="world"/><child link="arm"/></joint>
</robot>
"""


def test_commands_of_a_urdf_ask_what_drives_its_joints():
    record = Recording("log", (Stream("", ("time", "hip_pos", "hip_cmd"), None),))
    with pytest.raises(
        LogError, match=r"has commands \(hip_cmd\), and the model, a URDF, has no actuators\."
    ):
        plan(record, MujocoSimulator(URDF), {}, None, None, None)
    for motors in ("torque", "none"):
        found = plan(record, MujocoSimulator(URDF, motors=motors), {}, None, None, None)
        assert ("ctrl.hip" in found.found) == (motors == "torque")
    silent = Recording("log", (Stream("", ("time", "hip_pos"), None),))
    assert plan(silent, MujocoSimulator(URDF), {}, None, None, None).lacking == ("qvel.hip",)
    used = plan(record, MujocoSimulator(URDF), {"qvel.hip": "hip_cmd"}, None, None, None)
    assert used.found["qvel.hip"][1] == "hip_cmd"
