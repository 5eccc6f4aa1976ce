"""Which rows of a log become transitions, when they begin, and what is said of them: whole logs."""

import numpy as np
import pandas as pd
import pytest

from skat.logs import LogError, load_log
from skat.logs.log import Match
from skat.simulators import FunctionSimulator, MujocoSimulator

NAMES = ("qpos.x", "qvel.x", "ctrl.u")


def cart(dt=0.01):
    return FunctionSimulator(
        lambda X: X[:, :2],
        input_names=NAMES,
        output_names=NAMES[:2],
        state_names=NAMES[:2],
        dt=dt,
        units={"qpos.x": "m", "qvel.x": "m/s"},
    )


def table(times, **changes):
    """Return a table whose values are all different."""
    n_rows = len(times)
    columns = {"time": np.asarray(times, float)}
    columns |= {name: 100.0 * place + np.arange(n_rows) for place, name in enumerate(NAMES)}
    return {name: values for name, values in (columns | changes).items() if values is not None}


def check(log, source, starts, groups, names, times, notes):
    """Check a log against the rows of its source that transitions start at, one row before where they end."""
    values = np.column_stack([source[name] for name in NAMES])
    np.testing.assert_array_equal(log.X, values[starts])
    np.testing.assert_array_equal(log.y, values[np.add(starts, 1), :2])
    np.testing.assert_array_equal(log.groups, groups)
    np.testing.assert_allclose(log.time, times, rtol=0, atol=1e-9)
    assert log.group_names == names
    assert log.notes == notes
    for array in (log.X, log.y, log.groups, log.time):
        assert not array.flags.writeable


def refused(source, simulator, **told):
    with pytest.raises(LogError) as caught:
        load_log(source, simulator, **told)
    return caught.value


def test_pieces_between_gaps_are_episodes_where_they_have_a_transition():
    times = np.r_[np.arange(21), 100, 101, 200, 300 + np.arange(5)] * 0.01
    starts = np.r_[0:20, 21, 24:28]
    check(
        load_log(table(times), cart()),
        table(times),
        starts,
        [0] * 20 + [1] + [2] * 4,
        ("0", "0 (2)", "0 (4)"),
        times[starts],
        ("3 gaps of more than 10 rows: an episode begins behind each.",),
    )


def test_rows_without_a_clock_count_from_the_beginning_of_their_episode():
    source = table(np.zeros(40), time=None, episode=np.repeat(["b", "a"], [25, 15]))
    starts, counted = np.r_[0:24, 25:39], np.r_[0:24, 0:14]
    groups = [0] * 24 + [1] * 14
    note = "The log has no times: rows are {:g} s apart, as {}"
    told = (note.format(0.01, "the simulator has it."),)
    check(load_log(source, cart()), source, starts, groups, ("b", "a"), 0.01 * counted, told)
    told = (note.format(0.02, "told."),)
    at_rate = load_log(source, cart(0.02), rate=50)
    check(at_rate, source, starts, groups, ("b", "a"), 0.02 * counted, told)
    assert load_log(source, cart(), columns={"time": "-"}).time[30] == pytest.approx(0.06)
    whole = load_log({name: values for name, values in source.items() if name != "episode"}, cart())
    np.testing.assert_allclose(whole.time, 0.01 * np.arange(39), atol=1e-12)


def test_what_is_read_is_matched_and_said():
    log = load_log(table(np.arange(30) * 10.0, more=np.zeros(30)), cart())
    assert log.matches == (
        *(Match(name, name, "", "same name") for name in NAMES),
        Match("time", "time", "", "by its name"),
    )
    assert log.notes == ("Left aside: more.", "Times in time are taken as ms.")
    told = load_log(table(np.arange(30) * 10.0), cart(), units={"time": "ms"})
    assert told.notes == ()
    np.testing.assert_allclose(told.time, 0.01 * np.arange(29), atol=1e-12)


def test_an_episode_without_a_command_is_left_out_and_the_others_counted_anew():
    commands = np.where(np.arange(60) < 20, np.nan, 1.0)
    commands[40:43] = np.nan
    source = table(0.01 * np.arange(60), episode=np.repeat(["a", "b", "c"], 20), **{"ctrl.u": commands})
    starts = np.r_[20:39, 43:59]
    check(
        load_log(source, cart()),
        source,
        starts,
        [0] * 19 + [1] * 16,
        ("b", "c"),
        0.01 * starts,
        ("23 rows are left out, before the first command.",),
    )


@pytest.mark.parametrize(
    ("holes", "labels", "n_transitions", "n_episodes"),
    [
        ([], [0] * 20, 19, 1),
        ([5], [0] * 21, 19, 1),
        ([20], [0] * 21, 20, 1),  # no transition starts there
        ([], [0] * 11 + [1] * 11, 20, 2),
        ([], [0] * 11 + [1] * 10, 19, 2),
        ([10], [0] * 11 + [1] * 11, 20, 2),
        ([11], [0] * 11 + [1] * 11, 19, 2),
    ],
)
def test_twenty_transitions_that_begin_with_a_state_are_enough(holes, labels, n_transitions, n_episodes):
    source = table(0.01 * np.arange(len(labels)), episode=np.array(labels, float))
    for name in NAMES[:2]:
        source[name][holes] = np.nan
    if n_transitions >= 20:
        assert len(load_log(source, cart())) == len(labels) - n_episodes
        return
    assert refused(source, cart()).problem == (
        f"holds {n_transitions} transitions in {n_episodes} episodes; at least 20 are needed."
    )


def test_rows_without_time_or_state_are_left_out_and_counted():
    source = table(0.01 * np.arange(40))
    source["time"][[3, 4]] = np.nan
    for name in NAMES[:2]:
        source[name][[10, 11, 12]] = np.nan
    source["qvel.x"][20] = np.nan
    for name in NAMES:
        source[name][[30, 31]] = np.nan
    log = load_log(source, cart())
    assert log.notes == (
        "2 rows have no time: left out.",
        "2 rows hold no state: not measured there.",
        "4 of 40 rows are lost (0.1 of them): not measured there, commands held.",
    )
    lost = np.zeros((39, 2), dtype=bool)
    lost[[3, 4, 10, 11, 12, 30, 31]] = True
    lost[20, 1] = True
    np.testing.assert_array_equal(np.isnan(log.X[:, :2]), lost)
    held = np.arange(39)
    held[[3, 4, 30, 31]] = [2, 2, 29, 29]
    np.testing.assert_array_equal(log.X[:, 2], source["ctrl.u"][held])
    for name in NAMES:
        source[name][1:] = np.nan
    assert refused(source, cart()).problem == "holds 1 rows with a state."
    source["time"][:39] = np.nan
    assert refused(source, cart()).problem == "holds 1 rows."


@pytest.mark.parametrize(("clock", "dt"), [(0.01, 0.01), (0.010009, 0.01), (0.005, 0.01), (0.0025, 0.01)])
def test_a_function_takes_every_row_that_begins_one_of_its_steps(clock, dt):
    source = table(clock * np.arange(100))
    log = load_log(source, cart(dt))
    every = round(dt / clock)
    np.testing.assert_array_equal(log.X[:, 0], np.arange(0, 100, every)[: len(log)])
    assert (log.dt, len(log)) == (dt, (99 // every))


def test_a_rate_that_is_told_stands_for_a_clock_that_is_a_little_off_for_a_function_too():
    source = table(0.0201 * np.arange(40))
    assert refused(source, cart(0.02)).problem.startswith("0.0201 s from row to row")
    log = load_log(source, cart(0.02), rate=50)
    assert (log.dt, len(log)) == (0.02, 39)
    assert log.notes == ("Rows are taken as 0.02 s apart, as told; the clock says 0.0201 s.",)
    np.testing.assert_array_equal(log.X[:, 0], source["qpos.x"][:-1])
    # A rate that is far off is none of the log's.
    far = refused(source, cart(0.01), rate=100)
    assert far.problem.startswith(
        "0.0201 s from row to row, while a transition of the simulator takes 0.01 s"
    )


def test_a_function_of_longer_or_unknown_steps_is_refused():
    error = refused(table(0.010011 * np.arange(40)), cart())
    assert error.problem == (
        "0.010011 s from row to row, while a transition of the simulator takes 0.01 s (dt)."
    )
    bare = table(np.zeros(40), time=None)
    without = refused(bare, cart(None))
    assert without.problem == ("has no column of times, and nobody has said how many rows a second it has.")
    assert without.options == {}  # no rate is known: one that a reader would copy is none to give
    assert "rate=..." in without.advice
    assert "--map time=COLUMN" in without.advice
    nothing = refused(table(np.full(40, np.nan)), cart(0.02))
    assert (nothing.problem, nothing.options) == ("holds no times.", {"columns": {"time": "-"}, "rate": 50.0})


def test_the_error_of_interpolation_is_said_of_each_channel_in_its_unit():
    rng = np.random.default_rng(0)
    time = 0.01 * (np.arange(200) + rng.uniform(-0.2, 0.2, size=200))
    source = {"time": time, "qpos.x": np.sin(9 * time), "qvel.x": 9 * np.cos(9 * time), "ctrl.u": 0 * time}
    log = load_log(source, cart())
    sizes = log.interpolation
    assert log.notes[-1] == (
        f"Error of interpolation (standard deviation): qpos.x {sizes['qpos.x']:.2g} m, "
        f"qvel.x {sizes['qvel.x']:.2g} m/s."
    )
    np.testing.assert_allclose(np.sqrt(log.floor), [sizes["qpos.x"], sizes["qvel.x"]])
    assert log.notes[0].startswith("The clock is uneven, by up to ")


SLIDER = """
<mujoco><option timestep="0.005"/><worldbody><body><joint name="x" type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
<actuator><motor name="u" joint="x"/></actuator></mujoco>
"""


@pytest.mark.parametrize(
    ("clock", "rate", "frame_skip", "dt", "note"),
    [
        (0.02, None, 4, 0.02, None),
        (0.005, None, 1, 0.005, None),
        (0.02, 25, 8, 0.04, "Of 2 rows one is taken, with the mean command over them."),
        (0.0201, 50, 4, 0.02, "Rows are taken as 0.02 s apart, as told; the clock says 0.0201 s."),
        (
            0.032,
            None,
            7,
            0.032,
            "0.032 s from row to row is no multiple of the model's time step of 0.005 s: it is simulated in 7 steps "
            "of 0.00457143 s.",
        ),
        (
            0.002,
            None,
            1,
            0.002,
            "0.002 s from row to row is no multiple of the model's time step of 0.005 s: it is simulated in 1 steps "
            "of 0.002 s.",
        ),
    ],
)
def test_a_model_takes_so_many_of_its_steps_or_of_finer_ones(clock, rate, frame_skip, dt, note):
    log = load_log(table(clock * np.arange(60)), MujocoSimulator(SLIDER), rate=rate)
    assert log.simulator.frame_skip == frame_skip
    assert log.dt == pytest.approx(dt, rel=1e-9)
    assert log.notes == ((note,) if note else ())


def test_a_model_of_settled_steps_says_how_far_rows_are_apart_where_nobody_else_does():
    bare = table(np.zeros(40), time=None)
    assert load_log(bare, MujocoSimulator(SLIDER, frame_skip=2)).time[1] == pytest.approx(0.01)
    assert refused(bare, MujocoSimulator(SLIDER)).options == {}


# -- several tables ----------------------------------------------------------------------------------------------------


def tables(folder, **parts):
    for name, columns in parts.items():
        pd.DataFrame(columns).to_csv(folder / f"{name}.csv", index=False)
    return {name: folder / f"{name}.csv" for name in parts}


@pytest.mark.parametrize("main", ["a", "b"])
def test_the_clock_is_that_of_the_table_with_most_of_the_state_or_the_first(tmp_path, main):
    fast, slow = 0.01 * np.arange(80), 0.02 * np.arange(40)
    x, v, u = 3 * slow, np.full(40, 3.0), np.arange(40.0)
    parts = {"a": {"time": fast, "x": 3 * fast}, "b": {"time": slow, "v": v, "u": u}}
    said = {"qpos.x": "a.x", "qvel.x": "b.v", "ctrl.u": "b.u"}
    if main == "a":  # one channel of the state each
        parts = {"a": {"time": slow, "x": x}, "b": {"time": fast, "v": np.full(80, 3.0), "u": 0 * fast}}
        parts["a"]["u"] = u
        said["ctrl.u"] = "a.u"
    log = load_log(tables(tmp_path, **parts), cart(0.02), columns=said)
    assert log.dt == 0.02
    np.testing.assert_allclose(log.X[:, 0], 3 * slow[:-1], atol=1e-9)
    np.testing.assert_allclose(log.X[:, 1], 3.0)
    np.testing.assert_array_equal(log.X[:, 2], u[:-1])
    assert not any("row is taken" in note for note in log.notes)


def test_episodes_are_told_by_the_table_of_the_state(tmp_path):
    time = 0.01 * np.arange(40)
    state = {"time": time, "x": 1.0 * np.arange(40), "v": 1.0 * np.arange(40)}
    paths = tables(tmp_path, a=state, b={"time": time, "u": 0 * time, "lap": 0 * time})
    said = {"qpos.x": "a.x", "qvel.x": "a.v", "ctrl.u": "b.u", "episode": "b.lap"}
    error = refused(paths, cart(), columns=said)
    assert error.where.endswith("b.csv, column b.lap")
    assert error.problem == "tells episodes apart, and is in another topic than the state."
    assert error.options == {"episodes": "gaps"}


def test_a_word_among_empty_cells_is_located(tmp_path):
    source = pd.DataFrame(table(0.01 * np.arange(40))).astype({"qvel.x": object})
    source.loc[[2, 7], "qvel.x"] = ["", "a word of more letters than a message should repeat whole"]
    source.to_csv(tmp_path / "log.csv", index=False)
    error = refused(tmp_path / "log.csv", cart())
    assert error.where.endswith("log.csv, line 9, column qvel.x")
    assert error.problem == ("expected a number for qvel.x, got 'a word of more letters than a message sh'.")


# -- options -----------------------------------------------------------------------------------------------------------


def test_options_are_those_of_each_of_several_logs():
    source = table(0.01 * np.arange(81), trial=np.repeat([1.0, 2.0], [41, 40]))
    told = {"units": {"qpos.x": "cm"}, "rate": 50, "episodes": "gaps", "columns": {"ctrl.u": "2"}}
    one, two = load_log(source, cart(0.02), **told), load_log([source, source], cart(0.02), **told)
    np.testing.assert_array_equal(two.X, np.concatenate([one.X, one.X]))
    np.testing.assert_array_equal(two.groups, np.repeat([0, 1], 40))
    np.testing.assert_allclose(one.X[:, 0], 0.01 * np.arange(0, 80, 2))
    np.testing.assert_array_equal(one.X[:, 2], 2.0)
    with pytest.raises(ValueError, match="no logs to join"):
        load_log([], cart())


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"base": "loose"}, 'base must be "fixed", "free" or None; it is \'loose\'.'),
        ({"rate": 0}, "rate must be rows per second, positive and finite; it is 0."),
        ({"rate": np.inf}, "rate must be rows per second, positive and finite; it is inf."),
    ],
)
def test_an_option_that_is_none_is_refused(told, message):
    with pytest.raises(ValueError, match="must be") as caught:
        load_log(table(0.01 * np.arange(40)), cart(), **told)
    assert str(caught.value) == message


FLOATING = """
<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody><body name="box"><freejoint name="root"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>
"""


@pytest.mark.parametrize(
    ("length", "is_kept"), [(1.19, False), (1.21, True), (0.81, False), (0.79, True), (1, True)]
)
def test_quaternions_of_nearly_unit_length_get_it_and_others_are_left(length, is_kept):
    simulator = MujocoSimulator(FLOATING)
    source = {name: np.zeros(40) for name in simulator.input_names} | {"time": 0.01 * np.arange(40)}
    source |= {"qpos.root.qw": np.full(40, 0.6 * length), "qpos.root.qy": np.full(40, 0.8 * length)}
    source["qpos.root.x"] = 5.0 + np.arange(40)
    source["qpos.root.qy"][7] = np.nan
    log = load_log(source, simulator)
    scale = length if is_kept else 1.0
    expected = np.tile([0.6 * scale, 0.0, 0.8 * scale, 0.0], (39, 1))
    expected[7] = [0.6 * length, 0.0, np.nan, 0.0]
    np.testing.assert_allclose(log.X[:, 3:7], expected, rtol=1e-12)
    np.testing.assert_array_equal(log.X[:, 0], 5.0 + np.arange(39))


def test_commands_that_are_missing_while_the_state_is_there_are_held_and_said():
    source = table(0.01 * np.arange(40))
    source["ctrl.u"] = np.where(np.isin(np.arange(40), [7, 8]), np.nan, np.arange(40.0))
    log = load_log(source, cart())
    np.testing.assert_array_equal(log.X[5:10, log.simulator.input_names.index("ctrl.u")], [5, 6, 6, 6, 9])
    assert "2 rows without a command: the one before is held there." in log.notes


def test_a_path_of_a_model_is_no_simulator():
    with pytest.raises(
        TypeError, match=r"must be a Simulator, such as MujocoSimulator\(.*; it is 'cart\.xml'\."
    ):
        load_log(table(0.01 * np.arange(40)), "cart.xml")
