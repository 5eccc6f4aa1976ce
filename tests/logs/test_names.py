"""What names of columns say: quantity, joint, unit, series; and which are clocks."""

import pytest

from skat.logs.names import Reading, is_time, joint_key, named_unit, natural, reading, tokens


def said(kind="", of="", key=(), series="", unit="", rank=0):
    return Reading(kind, of, tuple(key), series, unit, rank)


PLAIN = [
    ("elbow_position", said("qpos", key=["elbow"], series="elbow_position")),
    ("qpos.elbow", said("qpos", key=["elbow"], series="qpos.elbow")),
    ("JointPos3", said("qpos", key=["3"], series="JointPos#")),
    ("arm2_q_1", said("qpos", key=["arm", "2", "1"], series="arm2_q_#")),
    ("joint_3_vel_deg_per_s", said("qvel", key=["3"], series="joint_#_vel_deg_per_s", unit="deg/s")),
    ("velocity [rad/s]", said("qvel", series="velocity [rad/s]", unit="rad/s")),
    ("q_filt_raw", said("qpos", series="q_filt_raw", rank=2)),
    ("tau_2", said("effort", key=["2"], series="tau_#")),
    ("elbow_torque_cmd", said("ctrl", of="effort", key=["elbow"], series="elbow_torque_cmd")),
    ("cmd.pos.elbow", said("ctrl", of="qpos", key=["elbow"], series="cmd.pos.elbow")),
    ("elbow_velocity_target", said("ctrl", of="qvel", key=["elbow"], series="elbow_velocity_target")),
    ("u0", said("ctrl", key=["0"], series="u#")),
    # What was measured under a command is none.
    ("cmd_pos_meas", said("qpos", series="cmd_pos_meas")),
    ("measured_target_pos", said("qpos", series="measured_target_pos")),
    ("qpos_error", said("other", key=["error"], series="qpos_error")),
    ("lever", said(key=["lever"], series="lever")),
    # Elements of vectors.
    ("observation.state[2]", said("state", key=["2"], series="observation.state")),
    ("position[elbow]", said("qpos", key=["elbow"], series="position")),
    ("position_deg[elbow]", said("qpos", key=["elbow"], series="position_deg", unit="deg")),
    ("action[pos]", said("ctrl", of="qpos", key=["pos"], series="action")),
]


@pytest.mark.parametrize(("column", "expected"), PLAIN)
def test_a_column_says_quantity_joint_series_and_unit(column, expected):
    assert reading(column) == expected


OF_TOPICS = [
    ("/arm", "/arm.position[elbow]", "", said("qpos", key=["elbow"], series="/arm.position")),
    # The name of the topic counts where that of the column says nothing, or where it is of commands.
    ("/cmd", "/cmd.data[0]", "elbow", said("ctrl", key=["elbow"], series="/cmd.data")),
    ("/position_cmd", "/position_cmd.data[0]", "", said("ctrl", of="qpos", key=["0"], series="/position_cmd.data")),
    ("/cmd", "/cmd.velocity[0]", "", said("ctrl", of="qvel", key=["0"], series="/cmd.velocity")),
    ("/cmd", "/cmd.effort", "", said("ctrl", of="effort", series="/cmd.effort")),
    ("/cmd_state", "/cmd_state.position", "", said("qpos", series="/cmd_state.position")),
    ("/arm", "/arm.desired.positions[0]", "", said("ctrl", of="qpos", key=["0"], series="/arm.desired.positions")),
    ("/x", "/x.state[0]", "hip", said("state", key=["hip"], series="/x.state")),
    ("/cmd", "/cmd.pos_error", "", said("other", key=["error"], series="/cmd.pos_error")),
    ("/foo", "/foo.bar", "label", said(key=["bar"], series="/foo.bar")),
]  # fmt: skip


@pytest.mark.parametrize(("topic", "column", "label", "expected"), OF_TOPICS)
def test_the_name_of_a_topic_counts_where_its_columns_do_not_say(topic, column, label, expected):
    assert reading(column, label, topic) == expected


@pytest.mark.parametrize(
    ("name", "stem", "unit"),
    [
        ("elbow_deg", "elbow", "deg"),
        ("elbow (degrees)", "elbow", "deg"),
        ("elbow_degps", "elbow", "deg/s"),
        ("elbow_degrees_s", "elbow", "deg/s"),
        ("elbow_radians/s", "elbow", "rad/s"),
        ("rail [mm/s]", "rail", "mm/s"),
        ("rail_mm_s", "rail", "mm/s"),
        ("rail_m_per_s", "rail", "m/s"),
        ("rail_m_s", "rail", "m/s"),
        ("rail [cm/s]", "rail", "cm/s"),
        ("rail_cm", "rail", "cm"),
        ("rail_m", "rail", "m"),
        ("wheel_rps", "wheel", "rps"),
        ("wheel.rpm", "wheel", "rpm"),
        ("pull_N_m", "pull", "Nm"),
        ("pull [N m]", "pull", "Nm"),
        ("pull_mNm", "pull", "mNm"),
        ("time_microseconds", "time", "us"),
        ("t_s", "t", "s"),
        # A unit alone is a name, and a name that ends like a unit has none.
        ("deg", "deg", ""),
        ("_deg", "_deg", ""),
        ("arms", "arms", ""),
        ("timeMs", "timeMs", ""),
    ],
)
def test_a_unit_at_the_end_of_a_name_is_taken_off(name, stem, unit):
    assert named_unit(name) == (stem, unit)


@pytest.mark.parametrize(
    ("column", "is_clock"),
    [
        ("time", True),
        ("t [ms]", True),
        ("sim_time", True),
        ("elapsed_time", True),
        ("header.stamp", True),
        ("seconds", True),
        ("elapsed", False),
        ("header", False),
        ("wall", False),
        ("time_constant", False),
        ("episode", False),
        ("", False),
    ],
)
def test_a_clock_has_words_of_time_alone_and_one_that_is_certain(column, is_clock):
    assert is_time(column) == is_clock
    assert is_time(f"/arm.{column}", "/arm") == is_clock
    assert not is_time(f"/arm.{column}")


def test_words_are_split_at_marks_numbers_and_capitals():
    assert tokens("leftElbow_3b-POS") == ("left", "elbow", "3", "b", "pos")
    assert joint_key("left_elbow_joint2") == ("left", "elbow", "2")
    assert joint_key("joint") == ("joint",)


def test_numbers_in_names_are_in_the_order_of_numbers():
    assert sorted(["q10", "q9", "p11b", "q10a", "p2b"], key=natural) == ["p2b", "p11b", "q9", "q10", "q10a"]
