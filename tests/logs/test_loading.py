import numpy as np
import pandas as pd
import pytest

from skat.logs import LogError, joined, load_log, read_map, write_map
from skat.logs.between import interpolated
from skat.simulators import FunctionSimulator, MujocoSimulator

CART = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0"/>
      <geom name="cart" type="box" size="0.1 0.1 0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="rail"/></actuator>
</mujoco>
"""


@pytest.fixture
def cart():
    return MujocoSimulator(CART)


@pytest.fixture
def table():
    """Two episodes of 30 and 20 rows, every value a different number."""
    rng = np.random.default_rng(0)
    return pd.DataFrame(
        {
            "ctrl.push": rng.normal(size=50),
            "time": np.r_[0.02 * np.arange(30), 5 + 0.02 * np.arange(20)],
            "qvel.rail": rng.normal(size=50),
            "qpos.rail": 0.02 * rng.normal(size=50),
            "episode": ["first"] * 30 + ["second"] * 20,
        }
    )


def written(tmp_path, table):
    table.to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv"


def refusal(source, cart, **options):
    with pytest.raises(ValueError) as caught:
        load_log(source, cart, **options)
    return str(caught.value)


def smooth(n_rows, dt=0.02):
    """A log whose positions are the integral of its velocities."""
    time = dt * np.arange(n_rows)
    return pd.DataFrame(
        {
            "time": time,
            "qpos.rail": np.sin(3 * time),
            "qvel.rail": 3 * np.cos(3 * time),
            "ctrl.push": -9 * np.sin(3 * time),
        }
    )


def test_transitions_stay_within_their_episode(tmp_path, table, cart):
    log = load_log(written(tmp_path, table), cart)
    values = table[["qpos.rail", "qvel.rail", "ctrl.push"]].to_numpy()
    starts = np.r_[0:29, 30:49]
    np.testing.assert_array_equal(log.X, values[starts])
    np.testing.assert_array_equal(log.y, values[starts + 1, :2])
    np.testing.assert_array_equal(log.groups, [0] * 29 + [1] * 19)
    np.testing.assert_allclose(log.time, table["time"].to_numpy()[starts], atol=1e-12)
    assert log.group_names == ("first", "second")


def test_a_log_cannot_be_written_to(table, cart):
    with pytest.raises(ValueError, match="read-only"):
        load_log(table, cart).X[0, 0] = 1.0


def test_a_transition_is_as_many_steps_as_fit_between_two_rows(table, cart):
    log = load_log(table, cart)
    assert log.simulator.frame_skip == 4
    assert log.dt == pytest.approx(0.02) == pytest.approx(log.simulator.dt)
    state = np.array([[0.3, 2.0, 0.0]])
    np.testing.assert_allclose(log.simulator.predict(state), [[0.3 + 2 * 0.02, 2.0]], atol=1e-12)


def test_a_step_that_is_no_multiple_is_met_by_the_time_step_and_said(table, cart):
    """A camera at 15 frames a second is not 13 steps of 5 ms: the model would be 2.5 % short in every row."""
    table["time"] = np.r_[np.arange(30) / 15, 5 + np.arange(20) / 15]
    log = load_log(table, cart)
    assert log.simulator.frame_skip == 14
    assert log.dt == pytest.approx(1 / 15, rel=1e-9)
    assert any("0.0666667 s from row to row is no multiple" in note for note in log.notes)
    assert cart.dt == 0.005
    faster = smooth(100, dt=0.002)
    assert load_log(faster, cart).dt == pytest.approx(0.002)


def test_a_rate_replaces_the_clock_where_there_is_none(table, cart):
    bare = table.drop(columns="time")
    assert load_log(bare, cart, rate=50).simulator.frame_skip == 4
    assert "Say how many: rate=..., on the command line --rate;" in refusal(bare, cart)
    settled = MujocoSimulator(CART, frame_skip=4)
    assert load_log(bare, settled).dt == pytest.approx(0.02)


def test_a_rate_thins_a_faster_log_or_interpolates_it(cart):
    thinned = load_log(smooth(200), cart, rate=25)
    np.testing.assert_array_equal(thinned.X[:, 0], smooth(200)["qpos.rail"][:-2:2])
    assert not thinned.interpolation
    commands = smooth(200)["ctrl.push"].to_numpy().reshape(-1, 2)
    np.testing.assert_allclose(thinned.X[:, 2], commands.mean(axis=1)[:-1], rtol=0, atol=1e-12)
    between = load_log(smooth(200), cart, rate=40)
    assert between.dt == pytest.approx(0.025)
    missed = between.X[:, 0] - np.sin(3 * between.time)
    assert np.sqrt(np.mean(missed**2)) <= between.interpolation["qpos.rail"] < 1e-3


def test_rows_whose_stamps_jitter_are_interpolated_from_their_even_times(cart):
    even = smooth(200)
    late = even.assign(time=even["time"] + np.random.default_rng(6).uniform(0, 0.004, size=200))
    log = load_log(late, cart, rate=40)
    assert any("time stamps jitter" in note for note in log.notes)
    missed = log.X[:, 0] - np.sin(3 * (log.time - log.time[0]))
    assert np.abs(missed).max() < 5e-4  # m, at 3 m/s: of stamps that are 2 ms late or early it were 6e-3


@pytest.mark.parametrize("streams", ["one table", "commands in a table of their own"])
def test_a_row_that_is_lost_takes_no_command_with_it_where_rows_are_thinned(cart, tmp_path, streams):
    whole = smooth(101)
    held = whole.drop(index=[40, 41, 53])
    commands = whole["ctrl.push"].to_numpy().copy()
    if streams == "one table":
        commands[[40, 41, 53]] = commands[[39, 39, 52]]
        log = load_log(held, cart, rate=25)
    else:
        held.drop(columns="ctrl.push").to_csv(tmp_path / "a.csv", index=False)
        whole[["time", "ctrl.push"]].rename(columns={"ctrl.push": "u"}).to_csv(
            tmp_path / "b.csv", index=False
        )
        log = load_log(tmp_path, cart, columns={"ctrl.push": "b.u"}, rate=25)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(log.X[:, 0])), [20])
    np.testing.assert_allclose(log.X[:, 2], commands[:100].reshape(-1, 2).mean(axis=1), atol=1e-12)


def test_a_jittering_clock_within_one_percent_is_accepted(table, cart):
    table["time"] += np.random.default_rng(1).uniform(-4e-5, 4e-5, size=50)
    log = load_log(table, cart)
    assert log.simulator.frame_skip == 4
    assert not log.interpolation


def test_stamps_that_jitter_over_even_samples_are_told_from_samples_that_jitter(cart):
    """Where only the stamps are late, interpolation would make an error that is not there."""
    rng = np.random.default_rng(2)
    even, jitter = smooth(300), rng.uniform(-0.004, 0.004, size=300)
    stamps = even.assign(time=even["time"] + jitter)
    log = load_log(stamps, cart)
    np.testing.assert_array_equal(log.X[:, 0], even["qpos.rail"][:-1])
    assert any("time stamps jitter" in note for note in log.notes)
    time = even["time"] + jitter
    uneven = even.assign(**{"time": time, "qpos.rail": np.sin(3 * time), "qvel.rail": 3 * np.cos(3 * time)})
    log = load_log(uneven, cart)
    assert any("positions are interpolated" in note for note in log.notes)
    missed = log.X[:, 0] - np.sin(3 * log.time)
    assert np.sqrt(np.nanmean(missed**2)) <= log.interpolation["qpos.rail"] < 1e-4


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("is_late", [True, False])
def test_commands_and_velocities_that_jump_do_not_tell_which_jitters(cart, seed, is_late):
    rng = np.random.default_rng(seed)
    jitter = rng.uniform(-0.003, 0.003, size=300)
    begins = 0.02 * np.arange(300) + (0 if is_late else jitter)
    lasts, force = np.diff(begins), 20 * rng.normal(size=300)
    speeds = np.r_[0, np.cumsum(lasts * force[:-1])]
    places = np.r_[0, np.cumsum(lasts * (speeds[:-1] + speeds[1:]) / 2)]
    columns = {"qpos.rail": places, "qvel.rail": speeds, "ctrl.push": force}
    log = load_log(pd.DataFrame({"time": 0.02 * np.arange(300) + jitter, **columns}), cart)
    assert any("time stamps jitter" in note for note in log.notes) == is_late


@pytest.mark.parametrize("told", [None, "as units", "as columns"])
@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_tables_of_a_folder_have_times_in_any_unit(tmp_path, cart, unit, factor, told):
    whole = smooth(60)
    whole["time"] = np.rint(whole["time"] * factor)
    whole[["time", "qpos.rail", "qvel.rail"]].to_csv(tmp_path / "state.csv", index=False)
    whole[["time", "ctrl.push"]].to_csv(tmp_path / "cmd.csv", index=False)
    said = {"as units": {"units": {"time": unit}}, "as columns": {"columns": {"time": f":{unit}"}}}
    log = load_log(tmp_path, cart, **said.get(told, {}))
    assert log.dt == pytest.approx(0.02)
    np.testing.assert_allclose(log.X, smooth(60).to_numpy()[:-1, 1:], atol=1e-12)


@pytest.mark.parametrize("clock", ["even", "uneven", "one of two"])
def test_the_floor_of_the_noise_covers_what_interpolation_has_missed(clock, cart, tmp_path):
    rng = np.random.default_rng(3)
    even = smooth(300)
    time = even["time"] + (0 if clock == "even" else rng.uniform(-0.004, 0.004, size=300))
    place, speed = np.sin(3 * time), 3 * np.cos(3 * time)
    if clock == "one of two":
        even.drop(columns="qvel.rail").to_csv(tmp_path / "a.csv", index=False)
        pd.DataFrame({"time": time, "v": speed}).to_csv(tmp_path / "b.csv", index=False)
        log = load_log(tmp_path, cart, columns={"qvel.rail": "b.v"})
    else:
        log = load_log(even.assign(**{"time": time, "qpos.rail": place, "qvel.rail": speed}), cart)
    truth = np.stack([np.sin(3 * log.time), 3 * np.cos(3 * log.time)], axis=1)
    missed = np.nanmean((log.X[:, :2] - truth) ** 2, axis=0)
    assert log.floor.shape == (2,)
    np.testing.assert_array_equal(
        log.floor > 0, {"even": [False] * 2, "uneven": [True] * 2, "one of two": [False, True]}[clock]
    )
    assert (missed <= log.floor + 1e-28).all()
    assert (log.floor < 1e-5).all()


@pytest.mark.parametrize("streams", ["one table", "commands in a table of their own"])
@pytest.mark.parametrize("acting", ["at even times", "at the stamps"])
def test_velocities_are_interpolated_with_the_corners_that_held_commands_make(
    cart, tmp_path, acting, streams
):
    """Under a force that is held for each row, the velocity is made of straight lines and the position of parabolas.

    Either the controller keeps its beat and the reading of its sensors jitters, or it acts when they are read.
    """
    rng = np.random.default_rng(4)
    dt, force = 0.02, 5 * np.sin(0.9 * np.arange(300))
    at = dt * np.arange(300) + np.r_[0, rng.uniform(-0.004, 0.004, size=299)]
    begins = dt * np.arange(300) if acting == "at even times" else at
    lasts = np.diff(begins, append=begins[-1] + dt)
    speeds = np.r_[0, np.cumsum(lasts * force)]
    places = np.r_[0, np.cumsum(lasts * (speeds[:-1] + speeds[1:]) / 2)]

    def moved(times):
        row = np.clip(np.searchsorted(begins, times + 1e-9, side="right") - 1, 0, 299)
        rest = times - begins[row]
        place = places[row] + rest * speeds[row] + rest**2 * force[row] / 2
        return np.stack([place, speeds[row] + rest * force[row]], axis=1)

    state = pd.DataFrame(moved(at), columns=["qpos.rail", "qvel.rail"]).assign(time=at)
    if streams == "one table":
        log = load_log(state.assign(**{"ctrl.push": force}), cart)
    else:
        state.to_csv(tmp_path / "a.csv", index=False)
        pd.DataFrame({"time": at, "u": force}).to_csv(tmp_path / "b.csv", index=False)
        log = load_log(tmp_path, cart, columns={"ctrl.push": "b.u"})
    truth = moved(log.time)
    missed = np.nanmean((log.X[:, :2] - truth) ** 2, axis=0)
    assert (missed <= 4 * log.floor).all()  # of the times behind stamps that jitter the error is one draw
    assert (log.floor <= 30 * missed + 1e-12).all()
    told = any("velocities bend at even times" in note for note in log.notes)
    assert told == (acting == "at even times")
    plain, _ = interpolated(at, state[["qvel.rail"]].to_numpy(), log.time, dt)
    assert missed[1] < np.nanmean((plain[:, 0] - truth[:, 1]) ** 2) / 10


@pytest.mark.parametrize("dt", [1e-3, 5.0])
def test_nothing_is_interpolated_beyond_the_samples_by_more_than_their_jitter(dt):
    times, values = 3 + dt * np.arange(10), np.arange(10.0)[:, None]
    at = np.r_[times[0] - np.array([0.3, 0.005]) * dt, times[-1] + np.array([0.005, 0.3]) * dt]
    found, _ = interpolated(times, values, at, dt)
    assert np.isnan(found[:, 0]).tolist() == [True, False, False, True]
    np.testing.assert_allclose(found[1:3, 0], [-0.005, 9.005], atol=1e-9)


def test_lost_rows_are_not_measured_and_commands_are_held(table, cart):
    log = load_log(table.drop(index=[10, 11]), cart)
    assert len(log) == 48
    lost = ~np.isfinite(log.X[:, 0])
    np.testing.assert_array_equal(np.flatnonzero(lost), [10, 11])
    np.testing.assert_array_equal(np.flatnonzero(~np.isfinite(log.y[:, 0])), [9, 10])
    np.testing.assert_array_equal(log.X[10:12, 2], table["ctrl.push"][9])
    assert any("2 of 50 rows are lost" in note for note in log.notes)
    assert log.measured["qpos.rail"] == pytest.approx(46 / 48)


def test_a_row_repeated_is_left_out(table, cart):
    log = load_log(pd.concat([table[:5], table[4:]]), cart)
    np.testing.assert_array_equal(log.X, load_log(table, cart).X)
    assert any("1 rows repeat the time" in note for note in log.notes)


def test_gaps_become_episodes(cart):
    long = smooth(100)
    long.loc[60:, "time"] += 3.0
    log = load_log(long, cart)
    np.testing.assert_array_equal(log.groups, [0] * 59 + [1] * 39)
    assert log.group_names == ("0", "0 (2)")


def test_a_lone_row_between_gaps_is_no_episode(cart):
    long = smooth(100)
    long.loc[60:, "time"] += 3.0
    long.loc[61:, "time"] += 3.0
    log = load_log(long, cart)
    np.testing.assert_array_equal(log.groups, [0] * 59 + [1] * 38)
    assert log.group_names == ("0", "0 (3)")


def test_a_single_stamp_that_is_late_moves_no_other(cart):
    late = smooth(101)
    late.loc[50, "time"] += 0.006
    log = load_log(late, cart)
    assert any("time stamps jitter" in note for note in log.notes)
    np.testing.assert_allclose(log.time, smooth(101)["time"][:-1], rtol=0, atol=1e-4)


def test_what_was_told_is_marked_so_and_what_was_found_by_its_name(table, cart):
    how = {match.name: match.how for match in load_log(table, cart).matches}
    assert (how["time"], how["episode"]) == ("by its name", "by its name")
    told = load_log(table, cart, columns={"time": "time", "episode": "episode"})
    how = {match.name: match.how for match in told.matches}
    assert (how["time"], how["episode"]) == ("told", "told")


def test_a_clock_that_starts_anew_begins_an_episode(table, cart):
    table["time"] %= 5
    log = load_log(table.drop(columns="episode"), cart)
    np.testing.assert_array_equal(log.groups, [0] * 29 + [1] * 19)
    ignored = load_log(table, cart, episodes="gaps")
    np.testing.assert_array_equal(ignored.groups, log.groups)


@pytest.mark.parametrize(
    ("unit", "factor", "origin"),
    [("ms", 1e3, 0), ("us", 1e6, 0), ("ns", 1e9, 0), ("ns", 1e9, 1.7e18), ("us", 1e6, 1.7e15), ("s", 1, 0)],
)
def test_the_unit_of_times_is_found_out(unit, factor, origin, table, cart):
    table["time"] = np.rint(table["time"] * factor) + origin if unit != "s" else table["time"]
    log = load_log(table, cart)
    assert log.dt == pytest.approx(0.02)
    assert any(unit in note for note in log.notes) == (unit != "s")


def test_times_may_be_iso_dates(tmp_path, table, cart):
    stamps = pd.Timestamp("2024-05-01T12:00:00Z") + pd.to_timedelta(table["time"], unit="s")
    table["time"] = stamps.dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    log = load_log(written(tmp_path, table), cart)
    np.testing.assert_allclose(log.time[:3], [0, 0.02, 0.04], atol=1e-9)
    assert log.simulator.frame_skip == 4


@pytest.mark.parametrize("start", [0, 1.7e9])
@pytest.mark.parametrize(
    ("whole", "rest"),
    [
        ("header.stamp.sec", "header.stamp.nanosec"),
        ("header_stamp_secs", "header_stamp_nsecs"),
        ("sec", "nsec"),
        ("stamp.seconds", "stamp.nanos"),
    ],
)
def test_a_stamp_in_two_columns_is_one_clock(cart, start, whole, rest):
    even = smooth(200)
    stamps = np.rint(even["time"] * 1e9).astype(np.int64)
    parts = {whole: int(start) + stamps // 10**9, rest: stamps % 10**9}
    log = load_log(even.drop(columns="time").assign(**parts), cart)
    assert log.notes == ()
    np.testing.assert_array_equal(log.X, even.to_numpy()[:-1, 1:])
    np.testing.assert_allclose(log.time, even["time"][:-1], rtol=0, atol=1e-6)


def test_stamps_of_tables_in_two_columns_each_are_put_beside_each_other(tmp_path, cart):
    even = smooth(60)
    stamps = np.rint(even["time"] * 1e9).astype(np.int64)
    parts = {"sec": 1_700_000_000 + stamps // 10**9, "nanosec": stamps % 10**9}
    state = even.drop(columns=["time", "ctrl.push"])
    state.assign(**{f"header.stamp.{part}": values for part, values in parts.items()}).to_csv(
        tmp_path / "state.csv", index=False
    )
    even[["ctrl.push"]].assign(**parts).to_csv(tmp_path / "cmd.csv", index=False)
    log = load_log(tmp_path, cart)
    np.testing.assert_array_equal(log.X, even.to_numpy()[:-1, 1:])
    clocks = {match.theirs for match in log.matches if match.name == "time"}
    assert clocks == {"state.header.stamp", "cmd.stamp"}


def test_columns_that_are_no_parts_of_a_stamp_are_not_added_up(cart):
    """Two whole clocks, one in seconds and one in nanoseconds."""
    even = smooth(60)
    both = even.drop(columns="time").assign(t_sec=even["time"], t_nsec=np.rint(even["time"] * 1e9))
    np.testing.assert_allclose(load_log(both, cart).time, even["time"][:-1], atol=1e-12)


def test_what_the_log_lacks_is_not_measured(table, cart):
    log = load_log(table.drop(columns="qvel.rail"), cart)
    assert log.unmeasured == ("qvel.rail",)
    assert np.isnan(log.X[:, 1]).all()
    assert np.isnan(log.y[:, 1]).all()
    assert any("not measured: qvel.rail" in note for note in log.notes)


def test_commands_of_another_topic_are_held_and_averaged(cart):
    """A command at half of a row acts in half of it."""
    state = smooth(60)
    times = np.r_[0.0, 0.41, 0.80]
    sources = {
        "arm": state.drop(columns="ctrl.push"),
        "told": pd.DataFrame({"time": times, "u": [1.0, 2.0, 3.0]}),
    }

    def parts(folder):
        for name, part in sources.items():
            part.to_csv(folder / f"{name}.csv", index=False)
        return folder

    import pathlib
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        log = load_log(parts(pathlib.Path(folder)), cart, columns={"ctrl.push": "told.u"})
    commands = log.X[:, 2]
    np.testing.assert_allclose(commands[[0, 19, 20, 21, 39, 40, 58]], [1, 1, 1.5, 2, 2, 3, 3])


def beside(folder, state, commands):
    """Write a state and its commands as tables of a folder."""
    state[["time", "qpos.rail", "qvel.rail"]].to_csv(folder / "state.csv", index=False)
    commands[["time", "ctrl.push"]].to_csv(folder / "cmd.csv", index=False)
    return folder


@pytest.mark.parametrize(("state", "commands"), [("ns", "s"), ("s", "ns"), ("ms", "us"), ("s", "ISO 8601")])
def test_commands_beside_a_state_may_be_dated_in_another_unit(tmp_path, cart, state, commands):
    def dated(unit):
        table = smooth(60)
        if unit == "ISO 8601":
            stamps = pd.to_datetime(np.rint((1.7e9 + table["time"]) * 1e3), unit="ms")
            return table.assign(time=stamps.dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ"))
        factor = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit]
        stamps = (1.7e9 + table["time"]) * factor
        return table.assign(time=stamps if unit == "s" else np.rint(stamps).astype(np.int64))

    log = load_log(beside(tmp_path, dated(state), dated(commands)), cart)
    np.testing.assert_array_equal(log.X[:, 2], smooth(60)["ctrl.push"][:-1])


@pytest.mark.parametrize(
    ("origins", "said"),
    [((1.7e9, 0), "ends 1.7e+09 s before the state begins"), ((0, 90), "begins 88.82 s after")],
)
def test_clocks_with_no_time_in_common_are_refused(tmp_path, cart, origins, said):
    state, commands = (smooth(60).assign(time=origin + smooth(60)["time"]) for origin in origins)
    message = refusal(beside(tmp_path, state, commands), cart)
    assert f"cmd: has no time in common with the state: it {said}" in message
    assert "in one unit and from one origin" in message


def test_commands_of_two_runs_beside_each_other_are_refused_and_small_steps_back_are_not(tmp_path, cart):
    twice = pd.concat([smooth(60), smooth(60)])
    message = refusal(beside(tmp_path, twice, twice), cart)
    assert "cmd.csv, line 62: time goes back by 1.18 s" in message
    assert "Give runs one by one" in message
    stamped = smooth(60)
    commands = stamped.iloc[np.r_[0:30, 31, 30, 32:60]]
    log = load_log(beside(tmp_path, stamped, commands), cart)
    np.testing.assert_array_equal(log.X[:, 2], stamped["ctrl.push"][:-1])


@pytest.mark.parametrize(("n_commands", "held"), [(60, 0), (50, 0), (48, 2), (10, 40), (1, 0)])
def test_commands_that_end_before_the_states_are_told(tmp_path, cart, n_commands, held):
    log = load_log(beside(tmp_path, smooth(60), smooth(60)[:n_commands]), cart)
    note = f"Commands of cmd end at {0.02 * (n_commands - 1):.6g} s: held for the last {held} rows."
    assert [one for one in log.notes if "Commands" in one] == ([note] if held else [])
    assert len(log) == 59


def test_columns_are_mapped_with_units_signs_and_offsets(table, cart):
    theirs = table.rename(columns={"qpos.rail": "x", "qvel.rail": "v", "ctrl.push": "amps"})
    theirs["x"] = 25 - 1000 * theirs["x"]
    theirs["v"] = 1000 * theirs["v"]
    theirs["amps"] = theirs["amps"] / 0.12
    columns = {"qpos.rail": "x:-mm+25", "qvel.rail": "v:mm", "ctrl.push": "amps:A:0.12"}
    log = load_log(theirs, cart, columns=columns)
    np.testing.assert_allclose(log.X, load_log(table, cart).X, rtol=1e-12, atol=1e-15)
    assert log.table.set_index("name").loc["qpos.rail", "unit"] == "-mm+25"


TWO = """
<mujoco>
  <worldbody>
    <body><joint name="hook" axis="0 1 0"/><geom size="0.1" pos="0 0 -1"/>
      <body pos="0 0 -1"><joint name="J1" axis="0 1 0"/><geom size="0.1" pos="0 0 -1"/></body>
    </body>
  </worldbody>
  <actuator><motor name="hook" joint="hook"/><motor name="J1" joint="J1"/></actuator>
</mujoco>
"""


def test_what_the_log_calls_a_joint_is_said_once_for_all_its_columns():
    rng = np.random.default_rng(0)
    names = ("arm_pos", "tail_pos", "arm_vel", "tail_vel", "tail_cmd", "tail_clipped")
    theirs = {"time": 0.01 * np.arange(40)} | {name: 0.01 * rng.normal(size=40) for name in names}
    theirs |= {"arm_pos_des": theirs["arm_pos"]}
    columns = {"*.hook": "arm", "*.J1": "tail", "ctrl.hook": "0", "ctrl.*": "*_clipped"}
    log = load_log(theirs, MujocoSimulator(TWO), columns=columns)
    expected = [theirs[name] for name in ("arm_pos", "tail_pos", "arm_vel", "tail_vel")]
    np.testing.assert_array_equal(log.X[:, :4], np.stack(expected, axis=1)[:-1])
    np.testing.assert_array_equal(log.X[:, 4:], np.stack([np.zeros(40), theirs["tail_clipped"]], axis=1)[:-1])
    turned = load_log(theirs, MujocoSimulator(TWO), columns=columns | {"*.hook": "arm:-deg"})
    np.testing.assert_allclose(turned.X[:, [0, 2]], np.deg2rad(-log.X[:, [0, 2]]), rtol=1e-12)
    np.testing.assert_array_equal(turned.X[:, [1, 3, 4, 5]], log.X[:, [1, 3, 4, 5]])
    again = load_log(theirs, MujocoSimulator(TWO), columns=columns | {"qvel.J1": "arm_vel"})
    np.testing.assert_array_equal(again.X[:, 3], log.X[:, 2])
    with pytest.raises(
        LogError, match=r"column 'leg': was told for \*\.J1 and is not there\. It has time, arm_pos"
    ):
        load_log(theirs, MujocoSimulator(TWO), columns=columns | {"*.J1": "leg"})


def test_units_in_names_are_taken(table, cart):
    names = {"qpos.rail": "rail_pos_mm", "qvel.rail": "rail_vel_mm_s", "time": "time_ms"}
    theirs = table.rename(columns=names)
    theirs[list(names.values())] *= 1000
    log = load_log(theirs, cart)
    np.testing.assert_allclose(log.X, load_log(table, cart).X, rtol=1e-12, atol=1e-15)
    centimetres = theirs.rename(columns={"rail_vel_mm_s": "rail_vel [cm/s]"})
    centimetres["rail_vel [cm/s]"] /= 10
    np.testing.assert_allclose(load_log(centimetres, cart).X, log.X, rtol=1e-12, atol=1e-15)


def test_a_name_of_the_simulators_own_has_its_unit_however_it_ends(table, tmp_path):
    cart = MujocoSimulator(CART.replace('"rail"', '"rail_mm"'))
    own = table.rename(columns={"qpos.rail": "qpos.rail_mm", "qvel.rail": "qvel.rail_mm"})
    log = load_log(own, cart)
    assert {match.unit for match in log.matches} <= {"", "s"}
    np.testing.assert_array_equal(log.y[0], own[["qpos.rail_mm", "qvel.rail_mm"]].iloc[1])
    (tmp_path / "folder").mkdir()
    written(tmp_path / "folder", own)
    whole = {"qpos.rail_mm": "log.qpos.rail_mm", "qvel.rail_mm": "log.qvel.rail_mm"}
    told = load_log(tmp_path / "folder", cart, columns=whole | {"ctrl.*": "log.ctrl.push"})
    np.testing.assert_array_equal(told.X, log.X)
    shrunk = load_log(own, cart, units={"qpos.rail_mm": "mm"})
    np.testing.assert_allclose(shrunk.X[:, 0], log.X[:, 0] / 1000, rtol=1e-12)


def test_a_rate_far_above_the_logs_own_is_refused_before_the_memory_is_full(table, cart):
    log = table.head(30)
    assert load_log(log, cart, rate=100 / 0.02).dt == pytest.approx(0.02 / 100)
    message = refusal(log, cart, rate=101 / 0.02)
    assert "has 50 rows per second" in message
    assert "--rate 50" in message


@pytest.mark.parametrize("value", [np.inf, -np.inf])
def test_an_episode_without_end_is_told_with_its_row(value, table, cart):
    table["episode"] = np.r_[np.zeros(30), np.full(20, value)]
    assert f"row 30, column episode: is {value}, and tells episodes apart" in refusal(table, cart)


def test_a_number_that_only_python_reads_is_told_with_its_line(tmp_path, table, cart):
    table = table.astype({"qpos.rail": object})
    table.loc[3, "qpos.rail"] = "1_0"
    message = refusal(written(tmp_path, table), cart)
    assert "line 5, column qpos.rail: expected a number for qpos.rail, got '1_0'" in message


def test_a_map_comes_back_from_its_file(tmp_path, table, cart):
    theirs = table.rename(columns={"qpos.rail": "x", "qvel.rail": "v", "ctrl.push": "force"})
    log = load_log(theirs, cart, columns=read_map(["qpos.rail=x:m", "qvel.rail=v", "ctrl.*=force"]))
    path = write_map(tmp_path / "map.toml", log)
    again = load_log(theirs, cart, columns=path)
    np.testing.assert_array_equal(again.X, log.X)
    assert [match.theirs for match in again.matches] == [match.theirs for match in log.matches]
    with pytest.raises(FileExistsError):
        write_map(path, log)


def test_columns_that_nobody_uses_are_left_aside_with_a_note(table, cart):
    log = load_log(table.assign(temperature=30.0), cart)
    assert any("Left aside: temperature." in note for note in log.notes)


def glide(X):
    return np.stack([X[:, 0] + 0.02 * X[:, 1], X[:, 1] + 0.02 * X[:, 2]], axis=1)


def test_log_of_a_function_has_its_columns_and_its_step(table):
    names = ("qpos.rail", "qvel.rail", "ctrl.push")
    columns = {"input_names": names, "output_names": names[:2], "state_names": names[:2]}
    log = load_log(table, FunctionSimulator(glide, **columns, dt=0.02))
    np.testing.assert_array_equal(log.X, table[list(names)].to_numpy()[np.r_[0:29, 30:49]])
    assert (log.dt, log.simulator.dt) == (0.02, 0.02)
    faster = FunctionSimulator(glide, **columns, dt=0.01)
    assert "0.02 s from row to row, while a transition of the simulator takes 0.01 s" in refusal(
        table, faster
    )
    assert "has no dt" in refusal(table, FunctionSimulator(glide, **columns))
    slower = FunctionSimulator(glide, **columns, dt=0.04)
    np.testing.assert_array_equal(load_log(table, slower).X[:5, 0], table["qpos.rail"][:10:2])
    shot = FunctionSimulator(glide, input_names=names, output_names=("a", "b"))
    assert "needs a simulator with a state" in refusal(table, shot)


def test_names_of_episodes_are_texts(tmp_path, table, cart):
    table["episode"] = np.repeat(["01", "1", "NA"], [30, 10, 10])
    assert load_log(written(tmp_path, table), cart).group_names == ("01", "1", "NA")


def test_blank_lines_count_in_messages(tmp_path, table, cart):
    path = written(tmp_path, table)
    lines = path.read_text().splitlines()
    lines[5] = lines[5].replace(lines[5].split(",")[2], "n/a")
    path.write_text("\n".join(["\n", *lines[:4], "  ", "", *lines[4:]]))
    with pytest.raises(ValueError, match=r"line 10, column .*: expected a number for qvel.rail, got 'n/a'"):
        load_log(path, cart)


def test_several_logs_are_joined_each_its_own_episodes(table, cart):
    log = load_log([table, table.head(30)], cart)
    assert len(log) == 48 + 29
    assert len(log.group_names) == 3
    with pytest.raises(ValueError, match="--rate"):
        joined([load_log(table, cart), load_log(table, cart, rate=25)])


QUADRUPED = """
<mujoco>
  <worldbody>
    <body name="base" pos="0 0 1">
      <freejoint name="root"/>
      <geom size="0.2" mass="5"/>
      <body name="leg"><joint name="hip" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.3" mass="1"/></body>
    </body>
  </worldbody>
  <actuator><motor name="hip" joint="hip"/></actuator>
  <keyframe><key qpos="0 0 1 1 0 0 0 0.3"/></keyframe>
</mujoco>
"""


def test_a_root_that_is_not_in_the_log_is_welded_or_not_measured():
    robot = MujocoSimulator(QUADRUPED, frame_skip=5)
    time = 0.01 * np.arange(60)
    log = {"time": time, "hip_pos": np.sin(time), "hip_vel": np.cos(time), "hip_cmd": 0 * time}
    message = refusal(log, robot)
    assert "does not hold the pose of the model's free root" in message
    assert "--base fixed" in message
    free = load_log(log, robot, base="free")
    assert len(free.unmeasured) == 13
    fixed = load_log(log, robot, base="fixed")
    assert fixed.simulator.input_names == ("qpos.hip", "qvel.hip", "ctrl.hip")
    assert np.isfinite(fixed.X).all()


def test_quaternions_get_unit_length_and_keep_their_direction():
    robot = MujocoSimulator(QUADRUPED, frame_skip=5)
    half = np.linspace(0, 0.3, 60)
    log = {name: np.zeros(60) for name in robot.input_names} | {"time": 0.01 * np.arange(60)}
    log |= {"qpos.root.qw": 1.02 * np.cos(half), "qpos.root.qz": 1.02 * np.sin(half)}
    found = load_log(log, robot)
    column = robot.input_names.index("qpos.root.qw")
    turned = np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)])
    np.testing.assert_allclose(found.X[:, column : column + 4], turned[:-1], rtol=0, atol=1e-12)


def test_a_constant_stands_for_commands_that_were_not_given(table, cart):
    log = load_log(table.drop(columns="ctrl.push"), cart, columns={"ctrl.*": "0"})
    assert (log.X[:, 2] == 0).all()


def test_an_error_of_a_log_survives_pickling():
    import pickle

    error = LogError("log.csv", "is empty.", "Fill it.", options={"rate": 50.0})
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.options) == (str(error), error.options)


def test_rows_of_a_log_that_leave_a_gap_begin_an_episode(table, cart):
    log = load_log(table, cart)
    part = log.rows(np.r_[0:10, 12:20])
    np.testing.assert_array_equal(part.groups, [0] * 10 + [1] * 8)
    assert part.group_names == ("first", "first")
