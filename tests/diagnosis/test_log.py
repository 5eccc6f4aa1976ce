"""What a log must look like, what NaN means in it, and how it is split."""

import numpy as np
import pandas as pd
import pytest

from skat.diagnosis.log import (
    Log,
    check_log,
    check_matrix,
    measured_channels,
    tangent_variances,
    without_channels,
)
from skat.diagnosis.statespace import state_space
from skat.effects import Effect
from skat.simulators import FunctionSimulator, MujocoSimulator

DT = 0.1


def push(X, drag=0.0):
    place, speed, force = X.T
    return np.stack([place + DT * speed, speed + DT * (force - drag * speed)], axis=1)


@pytest.fixture
def simulator():
    return FunctionSimulator(
        push,
        input_names=("x", "v", "force"),
        output_names=("x", "v"),
        state_names=("x", "v"),
        effects=(Effect("drag", unit="1/s", neutral=0.0, bounds=(0.0, 2.0)),),
    )


def rows(lengths, seed=0):
    """Return X, y and groups of episodes with the given numbers of rows, without noise."""
    rng = np.random.default_rng(seed)
    inputs, outputs = [], []
    for length in lengths:
        state = rng.normal(size=(1, 2))
        for _ in range(length):
            row = np.c_[state, rng.normal(size=(1, 1))]
            state = push(row)
            inputs.append(row)
            outputs.append(state)
    return np.concatenate(inputs), np.concatenate(outputs), np.repeat(np.arange(len(lengths)), lengths)


@pytest.mark.parametrize(("dt", "length"), [(None, 80), (0.1, 80), (0.005, 160), (1e-4, 320)])
def test_a_first_look_takes_stretches_of_time_from_either_half_of_a_log(dt, length):
    simulator = FunctionSimulator(
        push,
        input_names=("x", "v", "force"),
        output_names=("x", "v"),
        state_names=("x", "v"),
        effects=(),
        dt=dt,
    )
    log = check_log(simulator, *rows([1000]))
    few = log.few()
    assert np.bincount(few.episodes).tolist() == [length, length]
    places = [np.flatnonzero((row == log.X).all(axis=1)).item() for row in few.X]
    np.testing.assert_array_equal(np.diff(places[:length]), 1)
    assert abs(np.mean(places[:length]) - 250) <= 1
    assert abs(np.mean(places[length:]) - 750) <= 1
    short = check_log(simulator, *rows([2 * length]))
    assert short.few() is short


def test_a_first_look_takes_rows_without_an_order_from_all_over(simulator):
    X, y, _ = rows([1] * 1000)
    few = check_log(simulator, X, y, None).few()
    places = [np.flatnonzero((row == X).all(axis=1)).item() for row in few.X]
    assert len(few) == 160
    assert np.ptp(np.diff(places)) <= 1


def test_variances_of_a_turn_are_four_times_those_of_its_quaternion():
    model = (
        """<mujoco><worldbody><body><freejoint name="root"/><geom size=".1"/></body></worldbody></mujoco>"""
    )
    simulator = MujocoSimulator(model)
    rng = np.random.default_rng(0)
    deviation = 1e-4
    at = np.r_[np.zeros(3), np.full(4, 0.5), np.zeros(6)]
    noisy = np.repeat(at[None], 20_000, axis=0)
    noisy[:, 3:7] += deviation * rng.normal(size=(20_000, 4))
    noisy[:, 3:7] /= np.linalg.norm(noisy[:, 3:7], axis=1, keepdims=True)
    turned = simulator.residual(noisy, np.broadcast_to(at, noisy.shape))
    variances = np.zeros(13)
    variances[3:7] = deviation**2
    told = tangent_variances(simulator, variances)
    np.testing.assert_allclose(turned.var(axis=0), told, rtol=0.05)


def test_nan_in_an_action_and_what_is_infinite_are_named_with_their_row_and_column(simulator):
    X, y, groups = rows([20, 20])
    X[7, 2] = np.nan
    with pytest.raises(
        ValueError, match=r"X has nan in row 7, column 2 \(force\); .* in a column of the state, NaN"
    ):
        check_log(simulator, X, y, groups)
    X[7, 2], y[31, 0] = 0.0, np.inf
    with pytest.raises(
        ValueError, match=r"y has inf in row 31, column 0 \(x\).*or NaN where nothing was measured"
    ):
        check_log(simulator, X, y, groups)
    X[3, 1] = -np.inf
    with pytest.raises(ValueError, match=r"X has -inf in row 3, column 1 \(v\)"):
        check_log(simulator, X, y, groups)


def test_of_a_state_that_two_rows_share_one_measurement_is_enough(simulator):
    X, y, groups = rows([20, 20])
    whole = X.copy(), y.copy()
    X[5, 0], y[11, 1], X[20, 1] = np.nan, np.nan, np.nan
    log = check_log(simulator, X, y, groups)
    np.testing.assert_array_equal(log.y, whole[1])
    # What an episode begins with stands in one row only.
    assert np.argwhere(np.isnan(log.X)).tolist() == [[20, 1]]
    assert log.complete.sum() == 39
    X[6, 0] += 0.1
    with pytest.raises(ValueError, match=r"y of row 5 is not the state in row 6 of X: x differs by 0\.1"):
        check_log(simulator, X, y, groups)


def test_a_channel_may_lack_wholly_but_not_all_of_them(simulator):
    X, y, groups = rows([20, 20])
    X[:, 1], y[:, 1] = np.nan, np.nan
    log = check_log(simulator, X, y, groups)
    assert log.measured.tolist() == [True, False]
    assert not log.complete.any()
    X[:, 0], y[:, 0] = np.nan, np.nan
    with pytest.raises(ValueError, match="nothing was measured"):
        check_log(simulator, X, y, groups)
    with pytest.raises(ValueError, match="nothing was measured"):
        check_log(simulator, X, y, None)


def test_what_a_table_lacks_was_not_measured(simulator):
    X, y, groups = rows([20])
    table = pd.DataFrame(X, columns=simulator.input_names).convert_dtypes()
    table.loc[0, "v"] = pd.NA
    assert np.argwhere(np.isnan(check_log(simulator, table, y, groups).X)).tolist() == [[0, 1]]
    X = X.astype(object)
    X[0, 1] = None
    assert np.argwhere(np.isnan(check_log(simulator, X, y, groups).X)).tolist() == [[0, 1]]


def test_nan_is_not_taken_by_who_wants_numbers(simulator):
    with pytest.raises(
        ValueError, match=r"y has nan in row 1, column 0 \(x\); every value must be a finite number\."
    ):
        check_matrix([[0.0, 0.0], [np.nan, 0.0]], "y", simulator.output_names)


def test_guesses_leave_what_was_measured_and_are_those_of_the_state_space(simulator):
    X, y, groups = rows([300, 20])
    X[[0, 40], 0], X[:, 1], y[:, 1] = np.nan, np.nan, np.nan
    y[[39, 100, 101, 102], 0] = np.nan
    log = check_log(simulator, X, y, groups)
    filled = log.filled
    assert filled.complete.all()
    for given, full in ((log.X, filled.X), (log.y, filled.y)):
        np.testing.assert_array_equal(full[np.isfinite(given)], given[np.isfinite(given)])
    follows = np.flatnonzero(np.diff(log.episodes) == 0)
    np.testing.assert_array_equal(filled.y[follows], filled.X[follows + 1, :2])
    space = state_space(simulator, log.X, log.y, log.episodes, consecutive=True)
    np.testing.assert_array_equal(space.X, filled.X)
    simulator.predict(filled.X)
    assert filled.filled is filled


def test_a_gap_is_filled_in_time_and_a_velocity_from_positions():
    rail = MujocoSimulator(
        "<mujoco><worldbody><body><joint name='rail' type='slide'/><geom size='.1'/></body></worldbody></mujoco>",
        frame_skip=5,
    )
    states = np.column_stack([0.3 * rail.dt * np.arange(41), np.full(41, np.nan)])
    states[10:13, 0] = np.nan
    filled = check_log(rail, states[:-1], states[1:], np.zeros(40)).filled
    np.testing.assert_allclose(filled.X[:, 0], 0.3 * rail.dt * np.arange(40), atol=1e-15)
    np.testing.assert_allclose(filled.X[:, 1], 0.3, rtol=1e-12)
    np.testing.assert_allclose(filled.y[:, 1], 0.3, rtol=1e-12)


@pytest.fixture
def ball():
    return MujocoSimulator(
        "<mujoco><worldbody><body><freejoint name='ball'/><geom type='box' size='.1 .2 .3'/></body></worldbody>"
        "</mujoco>",
        frame_skip=5,
    )


def test_a_quaternion_was_measured_as_a_whole_or_not(ball):
    start = np.r_[0.0, 0.0, 9.0, 1.0, np.zeros(3), 2.0, 0.3, np.zeros(2), 0.5, 0.0]
    states = ball.rollout(start[None], n_steps=30)[0]
    states[7, 4] = np.nan
    states[3, 0] = np.nan
    log = check_log(ball, states[:-1], states[1:], np.zeros(30))
    assert np.argwhere(np.isnan(log.X)).tolist() == [[3, 0], [7, 3], [7, 4], [7, 5], [7, 6]]
    assert log.measured.all()
    less = without_channels(ball, log, ["qpos.ball.qx"])
    assert np.flatnonzero(np.isnan(less.y).all(axis=0)).tolist() == [3, 4, 5, 6]
    rotation = [name in ("qpos.ball.rx", "qpos.ball.ry", "qpos.ball.rz") for name in ball.residual_names]
    np.testing.assert_array_equal(less.measured, ~np.array(rotation))
    np.testing.assert_array_equal(
        less.measured, measured_channels(ball, [f"qpos.ball.q{part}" for part in "wxyz"])
    )
    assert np.isfinite(ball.predict(less.filled.X)).all()


@pytest.mark.parametrize("flipped", [False, True])
def test_turns_in_a_gap_are_between_those_before_and_after_whatever_the_signs_of_quaternions(ball, flipped):
    angles = np.linspace(0, 3, 41)
    states = np.zeros((41, 13))
    states[:, 3], states[:, 4] = np.cos(angles / 2), np.sin(angles / 2)
    true = states[:, 3:7].copy()
    if flipped:
        states[::2, 3:7] *= -1
    read = states.copy()
    read[10:25, 3:7] = np.nan
    filled = check_log(ball, read[:-1], read[1:], np.zeros(40)).filled.X[:, 3:7]
    np.testing.assert_allclose(np.linalg.norm(filled, axis=1), 1, rtol=1e-12)
    # Not at an even rate, but about the same axis.
    assert np.abs(np.sum(filled * true[:-1], axis=1)).min() > np.cos(0.01)
    known = np.isfinite(read[:-1, 3])
    np.testing.assert_array_equal(filled[known], read[:-1, 3:7][known])


def test_a_chain_of_which_no_turn_was_read_has_that_of_the_chain_beside_it(ball):
    states = np.zeros((131, 13))
    states[:, 3:5] = np.sqrt(0.5)
    states[50:, 3:7] = np.nan
    filled = check_log(ball, states[:-1], states[1:], np.zeros(130)).filled.X[:, 3:5]
    np.testing.assert_allclose(filled, np.sqrt(0.5), rtol=1e-12)


def test_outputs_of_a_one_shot_simulation_may_lack_its_inputs_may_not():
    thrown = FunctionSimulator(lambda X: np.c_[X, X**2], input_names=("a",), output_names=("b", "c"))
    X = np.linspace(0, 1, 40)[:, None]
    y = np.c_[X, X**2]
    y[3, 1] = np.nan
    log = check_log(thrown, X, y, None)
    assert log.filled.complete.all()
    assert without_channels(thrown, log, ["c"]).measured.tolist() == [True, False]
    X[4] = np.nan
    with pytest.raises(
        ValueError, match=r"X has nan in row 4, column 0 \(a\); every value must be a finite number\."
    ):
        check_log(thrown, X, y, None)


def test_channels_that_are_left_out_must_exist_and_leave_some(simulator):
    log = check_log(simulator, *rows([30]))
    assert without_channels(simulator, log, []) is log
    with pytest.raises(ValueError, match="hidden names w; state channels are x, v"):
        without_channels(simulator, log, ["w"])
    with pytest.raises(ValueError, match="nothing was measured"):
        without_channels(simulator, log, ["x", "v"])


def test_text_in_a_cell_is_named_with_its_row_and_column(simulator):
    X, y, groups = rows([20])
    X = X.astype(object)
    X[3, 1] = "fast"
    with pytest.raises(ValueError, match=r"X has fast in row 3, column 1 \(v\)"):
        check_log(simulator, X, y, groups)


def test_an_infinite_value_in_a_column_too_many_is_named_by_its_number(simulator):
    X, y, groups = rows([20])
    X = np.column_stack([X, np.zeros(20)])
    X[3, 3] = np.inf
    with pytest.raises(ValueError, match=r"X has inf in row 3, column 3; every"):
        check_log(simulator, X, y, groups)


def test_wrong_number_of_columns_lists_those_of_the_simulator(simulator):
    X, y, groups = rows([20])
    with pytest.raises(ValueError, match=r"X has 2 columns; the simulator's are 3: x, v, force"):
        check_log(simulator, X[:, :2], y, groups)
    with pytest.raises(ValueError, match=r"X has 20 rows and y 19"):
        check_log(simulator, X, y[:-1], groups)


def test_fewer_than_four_rows_are_an_error(simulator):
    X, y, groups = rows([2, 1])
    with pytest.raises(ValueError, match=r"has 3 rows.*at least 4"):
        check_log(simulator, X, y, groups)
    assert len(check_log(simulator, X, y, groups, fewest_rows=1)) == 3
    assert len(check_log(simulator, *rows([2, 2]))) == 4


def test_y_that_is_not_the_next_state_names_the_row_and_the_channel(simulator):
    X, y, groups = rows([15, 15])
    y[21, 1] += 0.5
    with pytest.raises(ValueError, match=r"y of row 21 is not the state in row 22 of X: v differs by 0\.5"):
        check_log(simulator, X, y, groups)
    with pytest.warns(UserWarning, match="Each row begins where the one before it has ended"):
        assert not check_log(simulator, X, y, None).consecutive


def test_last_row_of_an_episode_need_not_lead_to_the_next_episode(simulator):
    X, y, groups = rows([15, 15])
    assert not np.allclose(y[14], X[15, :2])
    log = check_log(simulator, X, y, groups)
    assert log.n_episodes == 2
    np.testing.assert_array_equal(log.steps, np.tile(np.arange(15), 2))


def test_episode_that_goes_on_after_another_is_named_with_its_row(simulator):
    X, y, _ = rows([30])
    groups = np.r_[np.zeros(10), np.ones(10), np.zeros(10)]
    with pytest.raises(ValueError, match=r"Episode 0\.0 goes on at row 20 after rows of another episode"):
        check_log(simulator, X, y, groups)


def test_episodes_have_labels_of_any_kind(simulator):
    X, y, _ = rows([10, 10, 10])
    groups = np.repeat(np.array(["a", 1, 2.5], dtype=object), 10)
    assert check_log(simulator, X, y, groups).labels == ("a", 1, 2.5)
    with pytest.raises(ValueError, match="Episode 'a' goes on at row 29"):
        check_log(simulator, X, y, np.r_[groups[:-1], groups[:1]])


def test_groups_must_name_the_episode_of_every_row(simulator):
    X, y, groups = rows([30])
    with pytest.raises(ValueError, match=r"each of the 30 rows; it has shape \(29,\)"):
        check_log(simulator, X, y, groups[1:])


def test_few_groups_of_rows_without_time_order_are_too_little_evidence():
    thrown = FunctionSimulator(lambda X: X, input_names=("a",), output_names=("b",))
    X = np.linspace(0, 1, 40)[:, None]
    with pytest.raises(ValueError, match=r"2 groups .* needs at least 4. Pass groups=None"):
        check_log(thrown, X, X, np.repeat(range(2), 20))
    assert check_log(thrown, X, X, np.repeat(range(4), 10)).n_episodes == 4


def test_episodes_of_one_row_warn(simulator):
    X, y, _ = rows([30])
    with pytest.warns(UserWarning, match="Every episode has one row"):
        check_log(simulator, X, y, np.arange(30))


def test_single_episode_is_split_by_blocks_with_a_warning(simulator):
    X, y, groups = rows([200])
    log = check_log(simulator, X, y, groups)
    with pytest.warns(UserWarning, match="single episode"):
        fitted, held_out = log.split(0.3, np.random.RandomState(0))
    assert len(fitted) + len(held_out) == 200
    assert 0.2 < len(held_out) / 200 < 0.4
    # A gap in time starts a new episode: rows of one stay in the order of time.
    for part in (fitted, held_out):
        follows = np.flatnonzero(np.diff(part.episodes) == 0)
        np.testing.assert_array_equal(part.y[follows], part.X[follows + 1, :2])


def test_split_holds_out_whole_episodes(simulator):
    X, y, groups = rows([12, 30, 21, 7, 40])
    log = check_log(simulator, X, y, groups)
    fitted, held_out = log.split(0.3, np.random.RandomState(1))
    sizes = sorted(np.bincount(fitted.episodes).tolist() + np.bincount(held_out.episodes).tolist())
    assert sizes == [7, 12, 21, 30, 40]
    assert len(held_out) >= 0.3 * len(log)


def test_split_of_independent_rows_is_by_rows(simulator):
    order = np.random.default_rng(0).permutation(100)
    X, y = (part[order] for part in rows([100])[:2])
    fitted, held_out = check_log(simulator, X, y, None).split(0.3, np.random.RandomState(0))
    assert (len(fitted), len(held_out)) == (70, 30)
    both = np.concatenate([fitted.X, held_out.X])
    np.testing.assert_array_equal(both[np.lexsort(both.T)], X[np.lexsort(X.T)])


def test_nothing_is_held_out_with_test_size_zero(simulator):
    X, y, groups = rows([30])
    log = check_log(simulator, X, y, groups)
    assert log.split(0, np.random.RandomState(0)) == (log, None)


def test_gap_in_the_chosen_rows_starts_a_new_episode():
    log = Log(np.zeros((10, 1)), np.zeros((10, 1)), np.repeat([0, 1], 5), True)
    np.testing.assert_array_equal(log.rows([0, 1, 3, 4, 5, 6]).episodes, [0, 0, 1, 1, 2, 2])


def test_split_leaves_enough_to_fit():
    X = np.zeros((20, 1))
    fitted, held_out = Log(X, X, np.arange(20), False).split(0.95, np.random.RandomState(0))
    assert (len(fitted), len(held_out)) == (10, 10)
    fitted, held_out = Log(X, X, np.arange(20) // 4, False).split(0.8, np.random.RandomState(0))
    assert (fitted.n_episodes, held_out.n_episodes) == (4, 1)
    with pytest.warns(UserWarning, match="single episode"):
        fitted, held_out = Log(X, X, np.zeros(20, dtype=int), True).split(0.9, np.random.RandomState(0))
    assert (len(fitted), len(held_out)) == (10, 10)


@pytest.mark.parametrize(
    ("episodes", "consecutive"),
    [
        (np.zeros(8, dtype=int), True),
        (np.arange(8) // 2, True),
        (np.arange(8), False),
        (np.repeat(np.arange(4), 5), False),
    ],
    ids=["one short episode", "short episodes", "few rows", "four groups"],
)
def test_of_a_log_that_is_too_short_nothing_is_held_out_with_a_warning(episodes, consecutive):
    X = np.zeros((len(episodes), 1))
    log = Log(X, X, episodes, consecutive)
    with pytest.warns(UserWarning, match=r"Nothing of .* is held out .* Pass test_size=0") as caught:
        fitted, held_out = log.split(0.3, np.random.RandomState(0))
    assert fitted is log
    assert held_out is None
    assert len(caught) == 1


def test_missing_episode_is_named(simulator):
    X, y, groups = rows([20, 20])
    groups = groups.astype(float)
    groups[7] = np.nan
    with pytest.raises(ValueError, match="groups is missing in row 7"):
        check_log(simulator, X, y, groups)


def test_columns_with_other_names_are_not_taken_by_their_place(simulator):
    X, y, groups = rows([20])
    table = pd.DataFrame(X, columns=["velocity", "position", "action"])
    with pytest.raises(ValueError, match="X lacks the columns x, v, force"):
        check_log(simulator, table, y, groups)
    assert check_log(simulator, pd.DataFrame(X), y, groups).X.shape == X.shape
