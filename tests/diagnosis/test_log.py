"""What a log must look like, and how it is cut into episodes, chains and blocks."""

import numpy as np
import pandas as pd
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.log import BLOCK_LENGTH, CHAIN_LENGTH, Log, check_log
from skat.effects import Effect
from skat.simulators import FunctionSimulator

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


def test_nan_is_named_with_its_row_and_column(simulator):
    X, y, groups = rows([20, 20])
    X[7, 2] = np.nan
    with pytest.raises(ValueError, match=r"X has nan in row 7, column 2 \(force\)"):
        check_log(simulator, X, y, groups)
    X[7, 2], y[31, 0] = 0.0, np.inf
    with pytest.raises(ValueError, match=r"y has inf in row 31, column 0 \(x\)"):
        check_log(simulator, X, y, groups)


def test_text_in_a_cell_is_named_with_its_row_and_column(simulator):
    X, y, groups = rows([20])
    X = X.astype(object)
    X[3, 1] = "fast"
    with pytest.raises(ValueError, match=r"X has fast in row 3, column 1 \(v\)"):
        check_log(simulator, X, y, groups)


def test_wrong_number_of_columns_lists_those_of_the_simulator(simulator):
    X, y, groups = rows([20])
    with pytest.raises(ValueError, match=r"X has 2 columns; the simulator's are 3: x, v, force"):
        check_log(simulator, X[:, :2], y, groups)
    with pytest.raises(ValueError, match=r"X has 20 rows and y 19"):
        check_log(simulator, X, y[:-1], groups)


def test_fewer_than_twenty_rows_are_an_error(simulator):
    X, y, groups = rows([10, 9])
    with pytest.raises(ValueError, match=r"has 19 rows.*at least 20"):
        check_log(simulator, X, y, groups)
    with pytest.raises(ValueError, match=r"has 19 rows.*at least 20"):
        SimulationDiagnosis(simulator).fit(X, y, groups=groups)
    X, y, groups = rows([10, 10])
    assert len(check_log(simulator, X, y, groups)) == 20


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


def test_hidden_channels_are_not_compared_between_rows(simulator):
    X, y, groups = rows([30])
    X[:, 1] = 0.0
    with pytest.raises(ValueError, match="v differs"):
        check_log(simulator, X, y, groups)
    assert check_log(simulator, X, y, groups, hidden=("v",)).consecutive


def test_episode_that_goes_on_after_another_is_named_with_its_row(simulator):
    X, y, _ = rows([30])
    groups = np.r_[np.zeros(10), np.ones(10), np.zeros(10)]
    with pytest.raises(ValueError, match=r"Episode .*0\.0.* goes on at row 20 after rows of another episode"):
        check_log(simulator, X, y, groups)


def test_groups_must_name_the_episode_of_every_row(simulator):
    X, y, groups = rows([30])
    with pytest.raises(ValueError, match=r"each of the 30 rows; it has shape \(29,\)"):
        check_log(simulator, X, y, groups[1:])


def test_few_groups_of_rows_without_time_order_are_too_little_evidence():
    thrown = FunctionSimulator(lambda X: X, input_names=("a",), output_names=("b",))
    X = np.linspace(0, 1, 40)[:, None]
    with pytest.raises(ValueError, match=r"4 groups .* needs at least 5. Pass groups=None"):
        check_log(thrown, X, X, np.repeat(range(4), 10))
    assert check_log(thrown, X, X, np.repeat(range(5), 8)).n_episodes == 5


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


def test_blocks_and_chains_lie_inside_episodes_and_are_short():
    episodes = np.repeat(np.arange(4), [130, 5, 61, 200])
    log = Log(np.zeros((396, 3)), np.zeros((396, 2)), episodes, True)
    chains, steps = log.chains()
    for labels, longest in ((log.blocks(), BLOCK_LENGTH), (chains, CHAIN_LENGTH)):
        assert (np.diff(labels) >= 0).all()
        assert np.bincount(labels).max() <= longest
        for label in np.unique(labels):
            assert len(np.unique(episodes[labels == label])) == 1
    np.testing.assert_array_equal(steps, np.concatenate([np.arange(n) for n in np.bincount(chains)]))


def test_gap_in_the_chosen_rows_starts_a_new_episode():
    log = Log(np.zeros((10, 1)), np.zeros((10, 1)), np.repeat([0, 1], 5), True)
    np.testing.assert_array_equal(log.rows([0, 1, 3, 4, 5, 6]).episodes, [0, 0, 1, 1, 2, 2])


def test_unknown_effects_and_channels_list_those_that_exist(simulator):
    X, y, groups = rows([20, 20])
    with pytest.raises(ValueError, match=r"(?s)dragg.*drag"):
        SimulationDiagnosis(simulator, effects=["dragg"]).fit(X, y, groups=groups)
    with pytest.raises(ValueError, match=r"effects is empty"):
        SimulationDiagnosis(simulator, effects=[]).fit(X, y, groups=groups)
    with pytest.raises(ValueError, match=r"hidden names w; state channels are x, v"):
        SimulationDiagnosis(simulator, hidden=("w",)).fit(X, y, groups=groups)
    with pytest.raises(ValueError, match=r"hidden= needs episodes"):
        SimulationDiagnosis(simulator, hidden=("v",)).fit(X, y)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"alpha": 1.0}, "alpha must lie between 0 and 1; it is 1.0"),
        ({"test_size": 1.0}, "test_size must be at least 0 and below 1; it is 1.0"),
        ({"max_effects": 0}, "max_effects must be a whole number of at least 1; it is 0"),
        ({"noise": "guess"}, "noise must be 'estimate' or one standard deviation per channel; it is 'guess'"),
        ({"noise": [0.1, -1.0]}, "positive standard deviation for each of x, v"),
        ({"noise": [0.1]}, "positive standard deviation for each of x, v"),
    ],
)
def test_bad_parameters_are_said_with_their_value(simulator, parameters, said):
    X, y, groups = rows([20, 20])
    with pytest.raises(ValueError, match=said):
        SimulationDiagnosis(simulator, **parameters).fit(X, y, groups=groups)


def test_split_leaves_enough_to_fit():
    X = np.zeros((20, 1))
    fitted, held_out = Log(X, X, np.arange(20), False).split(0.95, np.random.RandomState(0))
    assert (len(fitted), len(held_out)) == (10, 10)
    fitted, held_out = Log(X, X, np.arange(20) // 4, False).split(0.8, np.random.RandomState(0))
    assert (fitted.n_episodes, held_out.n_episodes) == (4, 1)
    with pytest.warns(UserWarning, match="single episode"):
        fitted, held_out = Log(X, X, np.zeros(20, dtype=int), True).split(0.9, np.random.RandomState(0))
    assert (len(fitted), len(held_out)) == (10, 10)


def stuck_when_fast(X, drag=0.0):
    return np.where(X[:, 1:2] > 1.2, np.nan, push(X, drag))


@pytest.mark.parametrize("n_episodes", [6, 60])
def test_rows_that_diverge_are_left_out_before_the_noise_is_known(n_episodes):
    """Of many rows the noise is first estimated from some; smoothed states may diverge where measured ones do not."""
    X, y, groups = rows([80] * n_episodes)
    rng = np.random.default_rng(1)
    noise = 0.03 * rng.normal(size=(len(X), 2))
    last = np.r_[groups[1:] != groups[:-1], True]
    X[:, :2] += noise
    y = np.where(last[:, None], y + 0.03 * rng.normal(size=y.shape), np.roll(X[:, :2], -1, axis=0))
    weak = FunctionSimulator(
        stuck_when_fast,
        input_names=("x", "v", "force"),
        output_names=("x", "v"),
        state_names=("x", "v"),
        effects=(Effect("drag", unit="1/s", neutral=0.0, bounds=(0.0, 2.0)),),
    )
    with pytest.warns(UserWarning, match=f"of {len(X)} rows, which were left out"):
        diagnosis = SimulationDiagnosis(weak, random_state=0).fit(X, y, groups)
    assert diagnosis.causes_ == []


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
