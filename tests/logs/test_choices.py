"""What a log's columns are taken for, which rows are taken, and what is said of the others."""

import numpy as np
import pandas as pd
import pytest

from skat.logs import LogError, load_log
from skat.logs.loading import _align
from skat.logs.matching import _listed, simulator_inputs
from skat.logs.names import reading
from skat.logs.readers.messages import DEEPEST, MOST_FIELDS, collected, fields
from skat.simulators import FunctionSimulator, MujocoSimulator

ROBOT = """
<mujoco><compiler angle="radian"/><option timestep="0.01"/><worldbody>
  <body name="base"><joint name="rail" type="slide" axis="1 0 0" range="-2 2" limited="true"/>
    <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <body name="arm"><joint name="elbow" axis="0 1 0" range="-1.5 1" limited="true"/>
      <inertial pos="0 0 -1" mass="1" diaginertia="1 1 1"/></body></body>
</worldbody><actuator>{}</actuator></mujoco>
"""
SERVO = '<position name="servo" joint="elbow" kp="20"/>'
FLOATING = """
<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody><body name="box"><freejoint name="root"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>
"""


@pytest.fixture
def robot():
    return MujocoSimulator(ROBOT.format(SERVO))


@pytest.mark.parametrize(
    ("column", "kind"),
    [
        ("elbow_position", "qpos"),
        ("elbow_position_error", "other"),
        ("elbow_velocity_std", "other"),
        ("elbow_command_voltage", "other"),
        ("temperature", "other"),
        ("elbow_velocity_command", "ctrl"),
    ],
)
def test_one_word_of_what_is_no_state_is_enough_to_leave_a_column_out(column, kind):
    assert reading(column).kind == kind


def table(n_rows=40, **changes):
    time = 0.01 * np.arange(n_rows)
    columns = {
        "time": time,
        "qpos.rail": 0.1 * np.sin(time),
        "qpos.elbow": 0.2 * np.cos(time),
        "qvel.rail": 0.1 * np.cos(time),
        "qvel.elbow": -0.2 * np.sin(time),
        "ctrl.servo": 0.3 * np.ones(n_rows),
    }
    return pd.DataFrame({name: value for name, value in (columns | changes).items() if value is not None})


def refused(source, simulator, **options):
    with pytest.raises(LogError) as caught:
        load_log(source, simulator, **options)
    return str(caught.value)


def floating(n_rows=40):
    angle = 0.5 * np.arange(n_rows)
    columns = {f"qpos.root.{axis}": np.linspace(0, 1, n_rows) for axis in "xyz"}
    columns |= {"qpos.root.qw": np.cos(angle / 2), "qpos.root.qx": np.sin(angle / 2)}
    columns |= {"qpos.root.qy": np.zeros(n_rows), "qpos.root.qz": np.zeros(n_rows)}
    return pd.DataFrame({"time": 0.01 * np.arange(n_rows)} | columns)


# -- columns -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("actuator", "kind"),
    [
        (SERVO, "qpos"),
        ('<velocity name="servo" joint="elbow" kv="2"/>', "qvel"),
        ('<motor name="servo" joint="elbow"/>', "effort"),
        ('<general name="servo" joint="elbow" gainprm="3" biasprm="0 0 0"/>', "effort"),
    ],
)
def test_a_command_is_what_its_actuator_compares_it_with(actuator, kind):
    inputs = simulator_inputs(MujocoSimulator(ROBOT.format(actuator)))
    assert inputs.servos == {"ctrl.servo": kind}
    assert inputs.kinds == {
        "qpos": ("qpos.rail", "qpos.elbow"),
        "qvel": ("qvel.rail", "qvel.elbow"),
        "ctrl": ("ctrl.servo",),
    }
    assert inputs.limits == {
        "qpos.rail": (-2.0, 2.0),
        "qpos.elbow": (-1.5, 1.0),
        "ctrl.servo": (-1.5, 1.0),
    }
    assert inputs.roots == ()


def test_a_free_root_is_one_joint_of_the_world_only():
    inputs = simulator_inputs(MujocoSimulator(FLOATING))
    assert len(inputs.roots) == 13
    assert inputs.roots[0] == "qpos.root.x"
    assert inputs.servos == inputs.limits == {}


def test_a_function_has_positions_of_any_name_and_commands():
    simulator = FunctionSimulator(
        lambda X: X[:, :1] + X[:, 1:], input_names=("level", "valve"), output_names=("level",), state_names=("level",),
        dt=0.1,
    )  # fmt: skip
    inputs = simulator_inputs(simulator)
    assert (inputs.kinds["qpos"], inputs.kinds["ctrl"]) == (("level",), ("valve",))


def test_units_for_all_are_those_of_angles_and_their_commands(robot):
    log = load_log(table(), robot, units={"qpos.elbow": "deg", "qvel.elbow": "deg", "ctrl.*": "deg"})
    np.testing.assert_allclose(log.X[:, 1], np.radians(0.2 * np.cos(log.time)))
    np.testing.assert_allclose(log.X[:, 3], np.radians(-0.2 * np.sin(log.time)))
    np.testing.assert_allclose(log.X[:, 4], np.radians(0.3))
    np.testing.assert_allclose(log.X[:, 0], 0.1 * np.sin(log.time))


def test_one_unit_for_all_is_none_of_a_floating_roots_pose():
    simulator = MujocoSimulator(FLOATING)
    np.testing.assert_array_equal(
        load_log(floating(), simulator, units="deg").X, load_log(floating(), simulator).X
    )


def test_a_share_of_the_range_is_a_unit_of_any_joint(robot):
    percent = {name: f"{name}:percent:-100:100" for name in ("qpos.rail", "qpos.elbow")}
    shares = {"qpos.rail": np.full(40, 50.0), "qpos.elbow": np.full(40, -100.0)}
    log = load_log(table(**shares), robot, columns=percent)
    np.testing.assert_allclose(log.X[:, 0], 1.0)
    np.testing.assert_allclose(log.X[:, 1], -1.5)


@pytest.mark.parametrize(
    ("name", "unit"), [("qpos.rail", "deg"), ("qpos.elbow", "mm"), ("qvel.elbow", "m/s")]
)
def test_a_unit_of_another_kind_is_refused(robot, name, unit):
    assert "does not measure what the model has in" in refused(table(), robot, units={name: unit})


def test_a_constant_a_dash_and_a_name_are_what_is_said_of_a_channel(robot):
    renamed = table().rename(columns={"qpos.elbow": "q2"}).drop(columns=["ctrl.servo", "qvel.rail"])
    log = load_log(renamed, robot, columns={"ctrl.*": "0.25", "qpos.elbow": "q2", "qvel.elbow": "-"})
    np.testing.assert_array_equal(log.X[:, 4], 0.25)
    np.testing.assert_allclose(log.X[:, 1], 0.2 * np.cos(log.time))
    assert np.isnan(log.X[:, 2:4]).all()
    assert set(log.unmeasured) == {"qvel.rail", "qvel.elbow"}
    told = {match.name: match.how for match in log.matches}
    assert told["qpos.elbow"] == told["ctrl.servo"] == "told"
    assert told["qpos.rail"] == "same name"
    assert any("Not in the log, so not measured: qvel.rail, qvel.elbow." in note for note in log.notes)
    assert "is no input of the simulator" in refused(renamed, robot, columns={"qpos.wrist": "q2"})
    assert "means no input of the simulator" in refused(renamed, robot, columns={"act.*": "q2"})
    assert "was told for qpos.elbow and is not there" in refused(renamed, robot, columns={"qpos.elbow": "q3"})
    assert "and qpos.* means 2 inputs" in refused(renamed, robot, columns={"qpos.*": "q2"})


def test_columns_by_number_are_taken_in_their_order_and_that_is_said(robot):
    numbered = table().rename(columns={"qpos.rail": "q_1", "qpos.elbow": "q_2"})
    numbered = numbered[["q_2", "q_1", "qvel.rail", "qvel.elbow", "ctrl.servo", "time"]]
    log = load_log(numbered, robot)
    np.testing.assert_allclose(log.X[:, 0], 0.1 * np.sin(log.time))
    assert any(
        note.startswith("Taken by order, as the file names no joints: qpos.rail = q_1") for note in log.notes
    )
    both = numbered.assign(q_3=0.0, time=numbered["time"])
    assert "no column could be found for the model's positions" in refused(
        both.drop(columns=["qvel.rail", "qvel.elbow"]), robot
    )


def test_what_is_left_aside_is_named_once_each(robot):
    log = load_log(table(temperature=np.arange(40.0)), robot)
    assert "Left aside: temperature." in log.notes
    assert not any(note.startswith("Left aside") for note in load_log(table(), robot).notes)
    assert _listed("abc") == "a, b, c"
    assert _listed(map(str, range(12))).endswith("10, 11")
    assert _listed(map(str, range(13))) == "0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, ... (13 in all)"


def test_missing_commands_are_asked_for(robot):
    said = refused(table(**{"ctrl.servo": None}), robot)
    assert "--map 'ctrl.*=" in said
    assert "of a position servo that is a position" in said
    warm = table(**{"ctrl.servo": None, "temperature": np.zeros(40)})
    assert "could be commands" not in refused(warm, robot)
    assert "Columns that could be commands: effort.elbow." in refused(
        warm.assign(**{"effort.elbow": 1.0}), robot
    )
    two = MujocoSimulator(ROBOT.format(SERVO + '<motor name="push" joint="rail"/>'))
    assert "--map 'ctrl.push=" in refused(table(), two)


# -- rows --------------------------------------------------------------------------------------------------------------


def test_rows_before_the_first_command_are_left_out_and_said(robot):
    command = np.r_[[np.nan] * 5, np.linspace(0, 1, 35)]
    log = load_log(table(**{"ctrl.servo": command}), robot)
    assert "5 rows are left out, before the first command." in log.notes
    assert len(log.X) == 34
    np.testing.assert_allclose(log.X[:, 4], command[5:-1])
    np.testing.assert_allclose(log.time, 0.05 + 0.01 * np.arange(34))


def test_rows_without_a_state_or_a_time_are_told_of(robot):
    holed = table()
    holed.loc[[7, 8], holed.columns != "time"] = np.nan
    log = load_log(holed, robot)
    assert any(note.startswith("2 rows hold no state") for note in log.notes)
    assert np.isnan(log.X[[7, 8], :4]).all()
    holed = table()
    holed.loc[12, "time"] = np.nan
    assert any(note.startswith("1 rows have no time") for note in load_log(holed, robot).notes)
    holed.loc[1:, "time"] = np.nan
    assert "holds 1 rows" in refused(holed, robot)
    holed["time"] = np.nan
    assert "holds no time" in refused(holed, robot) or "holds no number" in refused(holed, robot)


@pytest.mark.parametrize(
    ("value", "said"), [(np.inf, "expected a finite number"), ("high", "expected a number")]
)
def test_a_cell_that_is_no_number_is_located(robot, value, said):
    bad, column = table(), "qpos.rail"
    bad[column] = bad[column].astype(object)
    bad.loc[3, column] = value
    bad = bad if isinstance(value, str) else bad.astype(float)
    text = refused(bad, robot)
    assert said in text
    assert column in text


def test_a_column_without_a_number_is_refused_with_what_to_do(robot):
    nothing = np.full(40, np.nan)
    assert "Leave the channel out, as not measured" in refused(table(**{"qpos.rail": nothing}), robot)
    said = refused(table(**{"ctrl.servo": nothing}), robot)
    assert "holds no number" in said
    assert "Leave the channel out" not in said


def test_episodes_may_be_numbers_and_halves(robot):
    labels = np.repeat([2.0, 0.5, 1.0, 3.0], 10)
    log = load_log(table(episode=labels), robot)
    assert log.group_names == ("2", "0.5", "1", "3")
    np.testing.assert_array_equal(log.groups, np.repeat(range(4), 9))
    again = table(episode=np.repeat([1.0, 2.0, 1.0, 3.0], 10))
    assert "episode 1 goes on after another one began" in refused(again, robot)
    assert len(set(load_log(again, robot, episodes="gaps").groups)) == 1
    for labels in (np.where(np.arange(40) == 6, np.nan, 1.0), np.where(np.arange(40) == 6, " ", "a")):
        assert "is empty, and tells episodes apart" in refused(table(episode=labels), robot)
    assert "was told to tell episodes apart and is not there" in refused(table(), robot, episodes="trial")


@pytest.mark.parametrize(("clock", "is_said"), [(0.01, False), (0.010005, False), (0.01005, True)])
def test_a_rate_that_is_told_is_true_within_a_hundredth(robot, clock, is_said):
    log = load_log(table(time=clock * np.arange(40)), robot, rate=100.0)
    assert log.dt == pytest.approx(0.01)
    assert len(log.X) == 39
    assert any("as told; the clock says" in note for note in log.notes) == is_said
    assert not any("Interpolated" in note for note in log.notes)


def test_a_rate_that_is_another_is_met_by_interpolation(robot):
    log = load_log(table(time=0.0102 * np.arange(40)), robot, rate=100.0)
    assert any(note.startswith("Interpolated from 98.0392 to 100 rows") for note in log.notes)
    half = load_log(table(60), robot, rate=50.0)
    assert (half.dt, half.simulator.frame_skip) == (pytest.approx(0.02), 2)
    np.testing.assert_allclose(half.X[:, 0], 0.1 * np.sin(0.02 * np.arange(29)))
    for rate in (0, -5.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="positive and finite"):
            load_log(table(), robot, rate=rate)


def test_a_function_takes_logs_of_its_step_or_faster():
    simulator = FunctionSimulator(
        lambda X: X, input_names=("level",), output_names=("level",), state_names=("level",), dt=0.02
    )
    rows = np.linspace(0, 1, 60)
    log = load_log({"time": 0.01 * np.arange(60), "level": rows}, simulator)
    assert log.dt == 0.02
    np.testing.assert_allclose(log.X[:, 0], rows[:-2:2])
    assert "0.03 s from row to row, while a transition of the simulator takes 0.02 s" in refused(
        {"time": 0.03 * np.arange(60), "level": rows}, simulator
    )
    assert load_log({"time": 0.02001 * np.arange(60), "level": rows}, simulator).dt == 0.02


def test_too_short_a_log_is_refused_with_the_number_that_is_needed(robot):
    said = refused(table(3), robot)
    least = int(said.split("at least ")[1].split()[0])
    assert "holds 2 transitions in 1 episodes" in said
    assert len(load_log(table(least + 1), robot).X) == least
    assert f"at least {least} are needed" in refused(table(least), robot)


# -- quaternions and messages ------------------------------------------------------------------------------------------


def test_quaternions_keep_one_sign_and_unit_length():
    simulator = MujocoSimulator(FLOATING)
    rows = floating()
    parts = [f"qpos.root.q{part}" for part in "wxyz"]
    flipped, scaled = rows.copy(), rows.copy()
    flipped.loc[::3, parts] *= -1
    scaled[parts] *= 1.1
    true = load_log(rows, simulator).X[:, 3:7]
    np.testing.assert_allclose(np.linalg.norm(true, axis=1), 1)
    assert (np.sum(true[1:] * true[:-1], axis=1) > 0).all()
    np.testing.assert_allclose(load_log(scaled, simulator).X[:, 3:7], true, atol=1e-12)
    found = load_log(flipped, simulator).X[:, 3:7]
    np.testing.assert_allclose(np.abs(np.sum(found * true, axis=1)), 1)
    assert (np.sum(found[1:] * found[:-1], axis=1) > 0).all()
    # Of a body that only floats, a pose is a log.
    assert set(load_log(rows, simulator).unmeasured) == set(simulator.state_names[7:])
    assert "no column could be found" in refused(rows[["time"]].assign(level=1.0), simulator)
    # Of streams with clocks of their own there is no row beside another.
    apart = {f"qpos.root.q{part}": np.ones(3 if part == "w" else 2) for part in "wxyz"}
    _align(apart)
    assert all((values == 1).all() for values in apart.values())
    alone = {"qpos.root.qw": np.array([1.0, -1.0])}
    _align(alone)
    np.testing.assert_array_equal(alone["qpos.root.qw"], [1.0, -1.0])


@pytest.mark.parametrize(
    "stamp", [("sec", "nanosec"), ("secs", "nsecs"), ("sec", "nsec"), ("seconds", "nanos")]
)
def test_stamps_of_any_kind_of_message_are_nanoseconds(stamp):
    found = fields({"header": {"stamp": dict(zip(stamp, (1_700_000_000, 5)))}, "x": 2})
    assert found == {"header.stamp": 1_700_000_000 * 10**9 + 5, "x": 2.0}
    assert isinstance(found["header.stamp"], int)


def test_numbers_of_a_message_are_found_by_their_paths():
    message = {"name": ["a", "b"], "position": (1, 2.5), "odd": np.arange(3), "on": True, "word": "no", "none": None,
               "parts": [{"x": 1}], "big": 10**400}  # fmt: skip
    found = fields(message)
    assert np.isnan(found.pop("big"))
    assert found == {"position[a]": 1.0, "position[b]": 2.5, "odd[0]": 0.0, "odd[1]": 1.0, "odd[2]": 2.0,
                     "on": 1.0, "parts[0].x": 1.0}  # fmt: skip
    deep = 1.0
    for _ in range(DEEPEST):
        deep = {"d": deep}
    assert len(fields(deep)) == 1
    assert fields({"d": deep}) == {}
    assert len(fields({"v": np.zeros(MOST_FIELDS)})) == MOST_FIELDS
    assert fields({"v": np.zeros(MOST_FIELDS + 1)}) == {}


def test_columns_of_messages_are_seconds_and_numbers():
    messages = [("/t", 5_000_000_000 + 10_000_000 * index, {"x": index}) for index in range(3)]
    del messages[1][2]["x"]
    found = collected(messages, {"x": "x"}, {})
    np.testing.assert_array_equal(found["x"], [0.0, np.nan, 2.0])
    assert collected([], {"x": "x"}, {})["x"].shape == (0,)
