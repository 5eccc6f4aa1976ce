"""What a log does at its edges: labels, steps, splits and their shares, what follows, and tables that are refused."""

import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from skat.diagnosis.log import (
    Log,
    _share_that_follows,
    check_log,
    check_matrix,
    tangent_variances,
    without_channels,
)
from skat.simulators import FunctionSimulator, MujocoSimulator

DT = 0.1


def counter(n=2):
    names = tuple("xyzw"[:n])
    return FunctionSimulator(
        lambda X: X[:, :n] + X[:, n:], input_names=(*names, "u"), output_names=names, state_names=names, dt=DT
    )


def empty(lengths, *, consecutive=True, labels=None):
    n = sum(lengths)
    X = np.arange(n, dtype=float)[:, None]
    return Log(X, X + 1, np.repeat(np.arange(len(lengths)), lengths), consecutive, labels)


def counted(lengths, seed=0):
    """Return X, y and groups of the simulation itself."""
    rng, X, y = np.random.default_rng(seed), [], []
    for length in lengths:
        u = rng.normal(size=(length, 1))
        path = rng.normal(size=2) + np.r_[np.zeros((1, 1)), np.cumsum(u, axis=0)]
        X.append(np.c_[path[:-1], u])
        y.append(path[1:])
    return np.concatenate(X), np.concatenate(y), np.repeat(np.arange(len(lengths)), lengths)


def random_state(seed=0):
    return np.random.RandomState(seed)


# -- episodes, steps, labels -----------------------------------------------------------------------------------------


def test_steps_count_from_zero_in_each_episode_and_labels_are_the_user_s():
    log = empty([3, 1, 2], labels=("a", "b", "c"))
    assert log.steps.tolist() == [0, 1, 2, 0, 0, 1]
    assert log.n_episodes == 3
    assert [log.label(one) for one in range(3)] == ["a", "b", "c"]
    assert replace(log, labels=None).label(np.int64(2)) == 2
    assert len(log) == 6
    assert empty([]).n_episodes == 0


def test_rows_keep_the_label_of_the_episode_that_they_are_of():
    log = empty([4, 3, 3], labels=("a", "b", "c"))
    some = log.rows([1, 2, 4, 6, 9])
    assert some.episodes.tolist() == [0, 0, 1, 2, 3]
    assert some.labels == ("a", "b", "b", "c")
    np.testing.assert_array_equal(some.X[:, 0], [1, 2, 4, 6, 9])
    chosen = np.zeros(10, dtype=bool)
    chosen[[1, 2, 4, 6, 9]] = True
    np.testing.assert_array_equal(log.rows(chosen).episodes, some.episodes)
    unordered = replace(log, consecutive=False).rows([0, 2, 9])
    assert unordered.episodes.tolist() == [0, 0, 1]
    assert unordered.labels == ("a", "c")
    assert len(log.rows(np.zeros(10, dtype=bool))) == 0


def test_without_time_order_each_row_stands_for_itself_to_a_simulator():
    assert empty([2, 2]).groups.tolist() == [0, 0, 1, 1]
    assert empty([2, 2], consecutive=False).groups.tolist() == [0, 1, 2, 3]


def test_a_row_is_complete_with_both_of_its_ends_and_a_channel_measured_with_one_row():
    log = empty([4])
    log.X[0], log.y[1] = np.nan, np.nan
    assert log.complete.tolist() == [False, False, True, True]
    log.y[:3] = np.nan
    assert log.measured.tolist() == [True]
    log.y[3] = np.nan
    assert log.measured.tolist() == [False]
    with pytest.raises(ValueError, match="without its simulator cannot be filled"):
        _ = log.filled


# -- splits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.1, 0.25, 0.5])
def test_of_rows_without_order_the_share_asked_for_is_held_out_by_chance(share):
    log = empty([1] * 200, consecutive=False)
    fitted, held = log.split(share, random_state())
    assert len(held) == round(share * 200)
    assert sorted([*fitted.X[:, 0], *held.X[:, 0]]) == list(range(200))
    _, again = log.split(share, random_state())
    _, other = log.split(share, random_state(1))
    np.testing.assert_array_equal(held.X, again.X)
    assert set(held.X[:, 0]) != set(other.X[:, 0])


def test_at_least_one_row_is_held_out_and_ten_are_left():
    assert len(empty([1] * 40, consecutive=False).split(0.001, random_state())[1]) == 1
    fitted, held = empty([1] * 11, consecutive=False).split(0.9, random_state())
    assert (len(fitted), len(held)) == (10, 1)


@pytest.mark.filterwarnings("ignore:The log is a single episode")
@pytest.mark.parametrize("n", [60, 100, 400, 1000])
def test_a_single_episode_is_held_out_in_pieces_of_time_that_lie_all_over_it(n):
    (fitted, held), n_pieces = empty([n]).split(0.3, random_state()), 10
    count = max(1, round(0.3 * n_pieces))
    assert held.n_episodes == count
    assert len(held) == pytest.approx(n * count / n_pieces, abs=count)
    assert held.X[-1, 0] == n - 1
    # Pieces are as far from each other as can be.
    begins = held.X[np.r_[True, np.diff(held.episodes) > 0], 0]
    assert np.ptp(np.diff(begins)) <= n / n_pieces + 1 if count > 2 else True
    assert len(fitted) + len(held) == n


@pytest.mark.filterwarnings("ignore:The log is a single episode")
def test_of_a_short_episode_so_much_is_left_as_a_fit_needs():
    for n in range(14, 40):
        fitted, held = empty([n]).split(0.9, random_state())
        assert len(fitted) >= 10
        assert held is not None


def test_several_episodes_are_held_out_whole_and_told_of_by_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fitted, held = empty([20] * 10).split(0.3, random_state())
    assert (fitted.n_episodes, held.n_episodes) == (7, 3)


@pytest.mark.parametrize("sizes", [[400, 3], [5, 300, 4]])
def test_one_long_episode_beside_scraps_is_held_out_in_pieces_of_time(sizes):
    """A gap in a log leaves a few rows by themselves: on these no gain is measured."""
    with pytest.warns(UserWarning, match="Nearly all rows are of one episode") as caught:
        fitted, held = empty(sizes).split(0.3, random_state())
    assert len(caught) == 1
    assert len(held) == pytest.approx(0.3 * sum(sizes), rel=0.15)
    assert len(fitted) + len(held) == sum(sizes)


def test_where_the_share_is_less_than_any_episode_the_shortest_is_held_out():
    fitted, held = empty([30, 12, 40, 50]).split(1e-6, random_state())
    assert held.n_episodes == 1
    assert len(fitted) + len(held) == 132


# -- what is checked -------------------------------------------------------------------------------------------------


def test_rows_follow_each_other_as_far_as_both_ends_were_measured():
    states = np.array([[0.0, 0.0], [1.0, 5.0], [2.0, np.nan], [np.nan, np.nan], [9.0, 4.0]])
    y = np.array([[1.0, 5.0], [2.0, 6.0], [3.0, 7.0], [9.0, 4.5], [0.0, 0.0]])
    # 1 follows; 2 does in what was measured; of 3 nothing was; 4 begins elsewhere.
    assert _share_that_follows(states, y) == pytest.approx(2 / 4)
    assert _share_that_follows(states[:1], y[:1]) == 0.0


@pytest.mark.parametrize(("n_apart", "warned"), [(1, True), (3, False)])
def test_rows_of_which_nine_in_ten_follow_each_other_ask_for_groups(n_apart, warned):
    X, y, _ = counted([21])
    y[:n_apart] += 1.0
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_log(counter(), X, y, None)
    assert bool(caught) == warned


@pytest.mark.parametrize(("gap", "accepted"), [(0.5e-4, True), (2e-4, False), (-2e-4, False)])
@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_rounding_between_two_rows_is_a_share_of_a_channel_s_spread_in_any_unit(gap, accepted, unit):
    X, y, groups = counted([40])
    X, y = X * unit, y * unit
    y[17, 1] += gap * y[:, 1].std()
    if accepted:
        check_log(counter(), X, y, groups)
    else:
        with pytest.raises(ValueError, match="y of row 17 is not the state in row 18 of X: y differs by"):
            check_log(counter(), X, y, groups)


def test_a_channel_that_rests_may_be_rounded_too():
    X, y, groups = counted([40])
    X[:, 1], y[:, 1] = 1.0, 1.0
    y[17, 1] += 5e-10
    check_log(counter(), X, y, groups)
    y[17, 1] += 5e-9
    with pytest.raises(ValueError, match="y of row 17"):
        check_log(counter(), X, y, groups)


def test_one_group_says_nothing_of_rows_without_a_state():
    thrown = FunctionSimulator(lambda X: X, input_names=("a",), output_names=("b",))
    X = np.linspace(0, 1, 12)[:, None]
    assert check_log(thrown, X, X, np.zeros(12)).n_episodes == 12
    assert not check_log(thrown, X, X, np.repeat(range(4), 3)).consecutive
    with pytest.raises(ValueError, match="3 groups"):
        check_log(thrown, X, X, np.repeat(range(3), 4))
    assert check_log(thrown, X, X, np.repeat(range(3), 4), fewest_rows=1).n_episodes == 3


def test_one_longer_episode_is_enough_to_check_the_order_of_time():
    X, y, groups = counted([1, 1, 2, 1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert check_log(counter(), X, y, groups).n_episodes == 4


def test_labels_of_episodes_are_kept_in_their_order():
    X, y, _ = counted([3, 4, 2])
    log = check_log(counter(), X, y, np.repeat(["late", "early", "other"], [3, 4, 2]))
    assert log.labels == ("late", "early", "other")
    assert log.episodes.tolist() == [0] * 3 + [1] * 4 + [2] * 2


def test_a_table_s_columns_are_found_by_name_in_any_order_and_others_left():
    table = pd.DataFrame({"u": [1.0, 2.0], "more": [9.0, 9.0], "x": [3.0, 4.0]})
    np.testing.assert_array_equal(check_matrix(table, "X", ("x", "u")), [[3.0, 1.0], [4.0, 2.0]])
    with pytest.raises(ValueError, match="X lacks the columns y; expected x, y"):
        check_matrix(table, "X", ("x", "y"))


def test_only_a_single_output_may_have_one_dimension():
    assert check_matrix([1.0, 2.0], "y", ("a",)).shape == (2, 1)
    with pytest.raises(ValueError):
        check_matrix([1.0, 2.0], "X", ("a",))
    with pytest.raises(ValueError):
        check_matrix([1.0, 2.0], "y", ("a", "b"))


def test_the_first_value_that_lacks_is_named_by_its_own_column():
    values = np.zeros((3, 4))
    values[1, 1], values[2, 3], values[0, 0] = np.nan, np.nan, np.nan
    with pytest.raises(ValueError, match=r"X has nan in row 1, column 1 \(b\).*in a column of the state"):
        check_matrix(values, "X", ("a", "b", "c", "d"), optional=("a",))
    assert np.isnan(check_matrix(values, "X", ("a", "b", "c", "d"), optional=tuple("abcd"))).sum() == 3
    whole = np.array([[1.0, 2.0]])
    check_matrix(whole, "X", ("a", "b"))[:] = 7.0
    assert whole.tolist() == [[1.0, 2.0]]


def test_a_channel_that_is_left_out_lacks_at_both_ends_of_each_row_and_no_other_does():
    X, y, groups = counted([12])
    log = check_log(counter(), X, y, groups)
    less = without_channels(counter(), log, ["y"])
    assert np.isnan(less.X).all(axis=0).tolist() == [False, True, False]
    assert np.isnan(less.y).all(axis=0).tolist() == [False, True]
    np.testing.assert_array_equal(less.X[:, [0, 2]], X[:, [0, 2]])
    np.testing.assert_array_equal(log.y, y)


def test_variances_of_places_stay_and_those_of_turns_are_of_their_own_quaternion():
    simulator = MujocoSimulator(
        "<mujoco><worldbody><body><freejoint name='a'/><geom size='.1'/></body>"
        "<body pos='1 0 0'><freejoint name='b'/><geom size='.1'/></body></worldbody></mujoco>"
    )
    variances = np.arange(1.0, 27.0)
    told = dict(zip(simulator.residual_names, tangent_variances(simulator, variances)))
    given = dict(zip(simulator.output_names, variances))
    for name, value in told.items():
        parts = [given.get(f"{name[:-3]}.{part}") for part in ("qw", "qx", "qy", "qz")]
        assert value == pytest.approx(given[name] if name in given else np.sum(parts))


@pytest.mark.parametrize("nothing", [None, pd.NA, np.nan])
def test_what_lacks_is_not_named_where_something_else_is_no_number(nothing):
    X, y, groups = counted([10])
    X = X.astype(object)
    X[1, 0], X[3, 1] = nothing, "fast"
    with pytest.raises(
        ValueError, match=r"X has fast in row 3, column 1 \(y\); every value must be a finite"
    ):
        check_log(counter(), X, y, groups)


@pytest.mark.parametrize("nothing", [None, pd.NA, np.nan])
def test_what_lacks_among_objects_was_not_measured(nothing):
    X = np.array([[1.0, nothing], [2, 3.5]], dtype=object)
    table = pd.DataFrame({"a": [1.0, 2.0], "b": pd.Series([nothing, 3.5], dtype=object)})
    for rows in (X, X.tolist(), table):
        checked = check_matrix(rows, "T", ("a", "b"), optional=("b",))
        np.testing.assert_array_equal(checked, [[1.0, np.nan], [2.0, 3.5]])
        with pytest.raises(ValueError, match=r"T has nan in row 0, column 1 \(b\)"):
            check_matrix(rows, "T", ("a", "b"))


def test_what_is_wrong_with_a_table_is_told_with_what_may_lack():
    names = ("a", "b")
    X = np.zeros((3, 2))
    X[1, 1] = np.inf
    for optional, told in (
        ((), r"finite number\."),
        (("a",), r"finite number, or, in a column of the state, NaN where nothing was measured\."),
        (names, r"finite number, or NaN where nothing was measured\."),
    ):
        with pytest.raises(
            ValueError, match=rf"T has inf in row 1, column 1 \(b\); every value must be a {told}"
        ):
            check_matrix(X, "T", names, optional=optional)
