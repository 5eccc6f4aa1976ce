import numpy as np
import pandas as pd
import pytest
from skat.datasets.logs import numeric_columns, with_same_columns
from sklearn.utils import Bunch

from skat.datasets import load_log, split_episodes
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


def refusal(tmp_path, table, cart, **options):
    with pytest.raises(ValueError) as caught:
        load_log(written(tmp_path, table), cart, **options)
    return str(caught.value)


def test_transitions_stay_within_their_episode(tmp_path, table, cart):
    log = load_log(written(tmp_path, table), cart)
    values = table[["qpos.rail", "qvel.rail", "ctrl.push"]].to_numpy()
    starts = np.r_[0:29, 30:49]
    np.testing.assert_array_equal(log.data, values[starts])
    np.testing.assert_array_equal(log.target, values[starts + 1, :2])
    np.testing.assert_array_equal(log.groups, [0] * 29 + [1] * 19)
    assert log.group_names == ["first", "second"]


def test_a_transition_is_as_many_steps_as_fit_between_two_rows(tmp_path, table, cart):
    log = load_log(written(tmp_path, table), cart)
    assert log.frame_skip == log.simulator.frame_skip == 4
    assert log.dt == pytest.approx(0.02) == pytest.approx(log.simulator.dt)
    state = np.array([[0.3, 2.0, 0.0]])
    np.testing.assert_allclose(log.simulator.predict(state), [[0.3 + 2 * 0.02, 2.0]], atol=1e-12)


def test_a_given_number_of_steps_replaces_the_clock(tmp_path, table, cart):
    assert load_log(written(tmp_path, table.drop(columns="time")), cart, frame_skip=3).frame_skip == 3
    clock = table.assign(time=[f"12:00:{row:02d}" for row in range(50)])
    assert load_log(written(tmp_path, clock), cart, frame_skip=3).dt == pytest.approx(0.015)


def test_a_given_number_of_steps_that_the_clock_contradicts_raises_a_warning(tmp_path, table, cart):
    assert load_log(written(tmp_path, table), cart, frame_skip=4).frame_skip == 4
    with pytest.warns(
        UserWarning, match=r"0.015 s .* while its column 'time' says 0.02 s \(4 steps\)"
    ) as caught:
        log = load_log(written(tmp_path, table), cart, frame_skip=3)
    assert log.frame_skip == 3
    assert caught[0].filename == __file__


def test_a_jittering_clock_within_one_percent_is_accepted(tmp_path, table, cart):
    table["time"] += np.random.default_rng(1).uniform(-4e-5, 4e-5, size=50)
    assert load_log(written(tmp_path, table), cart).frame_skip == 4


def test_without_episodes_there_is_one(tmp_path, table, cart):
    log = load_log(written(tmp_path, table.head(30).drop(columns="episode")), cart)
    assert set(log.groups) == {0}
    assert len(log.data) == 29


def test_runs_without_a_column_episode_are_told_to_get_one(tmp_path, table, cart):
    table["time"] %= 5
    message = refusal(tmp_path, table.drop(columns="episode"), cart)
    assert "line 32: -0.58 s after the row before" in message
    assert "start a new episode, in a column 'episode', after each gap" in message


def test_a_lost_row_is_named(tmp_path, table, cart):
    assert "line 12: 0.04 s after the row before, while the usual step is 0.02 s" in refusal(
        tmp_path, table.drop(index=10), cart
    )


def test_a_step_that_is_no_multiple_is_refused_with_a_time_step_that_divides_it(tmp_path, table, cart):
    table["time"] *= 0.7
    message = refusal(tmp_path, table, cart)
    assert "0.014 s from row to row is 2.8 of the model's time steps of 0.005 s" in message
    assert "for example 0.00466667" in message


def test_a_step_that_misses_a_multiple_by_half_a_percent_is_refused(tmp_path, table, cart):
    """A camera at 15 frames a second is not 13 steps of 5 ms: the model would be 2.5 % short in every row."""
    table["time"] = np.r_[np.arange(30) / 15, 5 + np.arange(20) / 15]
    assert "0.0666667 s from row to row is 13.33 of the model's" in refusal(tmp_path, table, cart)
    finer = MujocoSimulator(CART.replace("0.005", "0.001"))
    assert "66.67 of the model's" in refusal(tmp_path, table, finer)
    assert load_log(written(tmp_path, table), finer, frame_skip=67).frame_skip == 67


def test_milliseconds_for_seconds_are_refused(tmp_path, table, cart):
    table["qpos.rail"] = np.cumsum(0.02 * table["qvel.rail"])
    assert load_log(written(tmp_path, table), cart).frame_skip == 4
    message = refusal(tmp_path, table.assign(time=1000 * table["time"]), cart)
    assert "20 s by the column 'time', positions move by 0.00" in message
    assert message.endswith("look like milliseconds or less: divide them by 1000.")


def test_velocities_in_another_unit_raise_a_warning(tmp_path, table, cart):
    table["qpos.rail"] = np.cumsum(0.02 * table["qvel.rail"] / 57.3)
    with pytest.warns(UserWarning, match="positions and velocities in the same unit"):
        load_log(written(tmp_path, table), cart)


def glide(X):
    return np.stack([X[:, 0] + 0.02 * X[:, 1], X[:, 1] + 0.02 * X[:, 2]], axis=1)


def test_log_of_a_function_has_its_columns_and_its_step(tmp_path, table):
    names = ("qpos.rail", "qvel.rail", "ctrl.push")
    columns = {"input_names": names, "output_names": names[:2], "state_names": names[:2]}
    log = load_log(written(tmp_path, table), FunctionSimulator(glide, **columns, dt=0.02))
    np.testing.assert_array_equal(log.data, table[list(names)].to_numpy()[np.r_[0:29, 30:49]])
    assert (log.dt, log.frame_skip, log.simulator.dt) == (0.02, 1, 0.02)
    assert "0.02 s from row to row, while a transition of the simulator takes 0.01 s" in refusal(
        tmp_path, table, FunctionSimulator(glide, **columns, dt=0.01)
    )
    assert "has no dt" in refusal(tmp_path, table, FunctionSimulator(glide, **columns))
    assert "frame_skip=2 is of MuJoCo models" in refusal(
        tmp_path, table, FunctionSimulator(glide, **columns, dt=0.02), frame_skip=2
    )
    shot = FunctionSimulator(glide, input_names=names, output_names=("a", "b"))
    assert "needs a simulator with a state" in refusal(tmp_path, table, shot)


def test_rows_in_another_order_are_refused(tmp_path, table, cart):
    assert "time does not grow" in refusal(tmp_path, table.iloc[::-1], cart)
    assert "line 4: -0.02 s after the row before" in refusal(
        tmp_path, table.iloc[[0, 2, 1, *range(3, 50)]], cart
    )


def test_names_of_episodes_are_texts(tmp_path, table, cart):
    table["episode"] = np.repeat(["01", "1", "NA"], [30, 10, 10])
    assert load_log(written(tmp_path, table), cart).group_names == ["01", "1", "NA"]
    table.loc[7, "episode"] = " "
    assert "line 9: the column 'episode' is empty" in refusal(tmp_path, table, cart)


def test_blank_lines_count_in_messages(tmp_path, table, cart):
    path = written(tmp_path, table)
    lines = path.read_text().splitlines()
    lines[5] = lines[5].replace(lines[5].split(",")[2], "n/a")
    path.write_text("\n".join(["\n", *lines[:4], "  ", "", *lines[4:]]))
    with pytest.raises(ValueError, match=r"line 10, column .*: expected a finite number, got 'n/a'"):
        load_log(path, cart)


def test_an_episode_that_comes_back_is_refused(tmp_path, table, cart):
    table.loc[40:, "episode"] = "first"
    assert "line 42: episode first goes on after another one began" in refusal(tmp_path, table, cart)


def test_a_row_without_an_episode_is_refused(tmp_path, table, cart):
    table.loc[3, "episode"] = None
    assert "line 5: the column 'episode' is empty" in refusal(tmp_path, table, cart)


def test_columns_must_be_those_of_the_model(tmp_path, table, cart):
    message = refusal(tmp_path, table.rename(columns={"ctrl.push": "ctrl.pull"}), cart)
    assert "Missing: ctrl.push." in message
    assert "Not in the model: ctrl.pull; take such columns out." in message
    assert "has no column 'time'" in refusal(tmp_path, table.drop(columns="time"), cart)
    assert (
        "add a column of zeros for each, and name it in hidden= (on the command line --hidden qvel.rail)"
        in refusal(tmp_path, table.drop(columns="qvel.rail"), cart)
    )


@pytest.mark.parametrize("separator", [";", "\t", "|"])
@pytest.mark.parametrize("decimal", [".", ","])
def test_a_table_separated_by_another_mark_is_told_so(tmp_path, table, cart, separator, decimal):
    table.to_csv(tmp_path / "log.csv", index=False, sep=separator, decimal=decimal)
    with pytest.raises(ValueError, match="separated by another mark than commas"):
        load_log(tmp_path / "log.csv", cart)


@pytest.mark.parametrize("value", [np.nan, np.inf, "fast"])
def test_values_that_are_no_finite_numbers_are_named(tmp_path, table, cart, value):
    table["qvel.rail"] = table["qvel.rail"].astype(object)
    table.loc[6, "qvel.rail"] = value
    assert "line 8, column qvel.rail: expected a finite number" in refusal(tmp_path, table, cart)


def test_too_few_transitions_are_refused(tmp_path, table, cart):
    assert load_log(written(tmp_path, table.head(21)), cart).data.shape == (20, 3)
    assert "19 transitions in 1 episodes; at least 20" in refusal(tmp_path, table.head(20), cart)


@pytest.mark.parametrize("content", ["", "a,b\n1,2,3\n4,5\n", "a,b\n1,2,3\n4,5,6\n", "\0\0\0", "a,b\n"])
@pytest.mark.filterwarnings("default")
def test_a_file_that_holds_no_table_is_refused(tmp_path, content):
    """Also where warnings are no errors, as they are in these tests and not with users."""
    (tmp_path / "log.csv").write_text(content)
    with pytest.raises(ValueError, match=r"log\.csv"):
        numeric_columns(tmp_path / "log.csv")


def test_columns_are_matched_by_name():
    table = pd.DataFrame({"a": [1.0], "b": [2.0]})
    assert list(with_same_columns(table, table[["b", "a"]])) == ["b", "a"]
    with pytest.raises(ValueError, match="only one of them has: b, c"):
        with_same_columns(table, pd.DataFrame({"a": [1.0], "c": [2.0]}))


@pytest.mark.parametrize("n_groups", [1, 2, 7, None])
def test_a_split_is_a_partition_by_whole_episodes(n_groups):
    groups = None if n_groups is None else np.repeat(np.arange(n_groups), 140 // n_groups)
    log = Bunch(data=np.arange(140.0)[:, None], target=np.arange(140.0)[:, None], groups=groups, dt=0.1)
    fit, test = split_episodes(log, test_size=0.5, random_state=0)
    assert sorted([*fit.data[:, 0], *test.data[:, 0]]) == list(range(140))
    assert min(len(fit.data), len(test.data)) >= 60
    assert fit.dt == 0.1
    if n_groups == 1:
        assert fit.data.max() < test.data.min()
    elif n_groups:
        assert not set(fit.groups) & set(test.groups)


def test_a_split_counts_rows_and_leaves_enough_to_fit():
    for seed in range(10):
        log = Bunch(data=np.zeros((315, 1)), target=np.zeros((315, 1)), groups=np.repeat([0, 1], [300, 15]))
        with pytest.warns(UserWarning, match="Only 15 of 315 rows are set aside") as caught:
            fit, test = split_episodes(log, test_size=0.3, random_state=seed)
        assert caught[0].filename == __file__
        assert (len(fit.data), len(test.data)) == (300, 15)
        fit, _ = split_episodes(
            Bunch(data=np.zeros((25, 1)), target=np.zeros((25, 1)), groups=np.zeros(25)), test_size=0.3
        )
        assert len(fit.data) == 20


def test_a_split_that_leaves_a_side_empty_is_refused():
    log = Bunch(data=np.zeros((40, 1)), target=np.zeros((40, 1)), groups=np.repeat([0, 1], 20))
    with pytest.raises(ValueError, match="leaves one side empty"):
        split_episodes(log, test_size=0.01)


@pytest.mark.parametrize("test_size", [-0.3, 0.0, 1.0, 3.0, np.nan])
def test_a_split_needs_a_share(test_size):
    log = Bunch(data=np.zeros((40, 1)), target=np.zeros((40, 1)), groups=np.repeat([0, 1], 20))
    with pytest.raises(ValueError, match="test_size must lie between 0 and 1"):
        split_episodes(log, test_size=test_size)


@pytest.mark.parametrize("lengths", [[20], [15, 15]])
def test_a_log_too_short_to_be_split_is_refused(lengths):
    n_rows = sum(lengths)
    log = Bunch(
        data=np.zeros((n_rows, 1)),
        target=np.zeros((n_rows, 1)),
        groups=np.repeat(range(len(lengths)), lengths),
    )
    with pytest.raises(ValueError, match="at least 20 rows stay to be fitted"):
        split_episodes(log, test_size=0.3)
