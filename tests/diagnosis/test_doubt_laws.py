"""What is suspicious about a log, by hand: the size of each sign and the numbers that a user is told."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy import signal

from skat.diagnosis.doubts import _stepped, doubts_about
from skat.diagnosis.log import check_log
from skat.diagnosis.velocities import noise_variance, power_by_frequency
from skat.simulators import FunctionSimulator, MujocoSimulator
from tests.diagnosis.test_doubts import LEGGED, walked


def one_shot(function, *outputs):
    """Return a simulation without a state of outputs that follow from an input a."""
    return FunctionSimulator(function, input_names=("a",), output_names=outputs)


def raised(simulator, log, name):
    return [one for one in doubts_about(simulator, log) if one.name == name]


# -- random ----------------------------------------------------------------------------------------------------------


def asked_again(change):
    """Return a simulation of two outputs to whose second answer an array is added."""
    answers = iter([0.0, change])
    return one_shot(lambda X: np.c_[X, 10 * X] + next(answers, 0.0), "b", "c")


def random_doubts(change):
    X = np.arange(40.0)[:, None]
    return raised(asked_again(change), check_log(asked_again(0.0), X, np.c_[X, 10 * X], None), "random")


def test_a_random_simulation_is_told_by_the_row_and_the_channel_that_differ_most():
    change = np.zeros((40, 2))
    change[5, 0], change[7, 1] = 0.01, 0.05  # less of its spread, which is ten times as wide
    (doubt,) = random_doubts(change)
    share = 0.01 / np.arange(40.0).std()
    assert doubt.size == pytest.approx(share)
    assert doubt.refused
    assert f": b in row 5 differs by {share:.2g} of its spread." in doubt.sentence


def test_a_simulation_that_diverges_at_times_is_random_and_one_that_always_does_is_not():
    change = np.zeros((40, 2))
    change[11, 1] = np.nan
    (doubt,) = random_doubts(change)
    assert doubt.size == np.inf
    assert ": b in row 11 differs by inf of its spread." in doubt.sentence
    assert random_doubts(np.zeros((40, 2))) == []
    X = np.arange(40.0)[:, None]
    lost = one_shot(lambda X: np.where(X == 3, np.nan, X), "b")
    assert raised(lost, check_log(lost, X, X, None), "random") == []


def test_only_the_first_two_hundred_rows_are_asked_for_again():
    X = np.arange(300.0)[:, None]
    asked = []
    counting = one_shot(lambda X: asked.append(len(X)) or X, "b")
    list(doubts_about(counting, check_log(counting, X, X, None)))
    assert set(asked) == {200}


# -- constant --------------------------------------------------------------------------------------------------------


def test_channels_that_never_change_share_a_sentence_and_the_largest_move():
    X = np.linspace(0, 1, 40)[:, None]
    simulator = one_shot(lambda X: np.c_[X, -0.5 * X, 0 * X + 3, X, X], "b", "c", "d", "e", "f")
    # b and c stand where they would move, d stands still in either, e moves, of f nothing was measured.
    y = np.c_[np.full(40, 0.25), np.zeros(40), np.full(40, 3.0), X, np.full(40, np.nan)]
    y[7, 0] = np.nan
    (doubt,) = raised(simulator, check_log(simulator, X, y, None), "constant")
    assert doubt.size == pytest.approx(0.75)
    assert not doubt.refused
    assert doubt.sentence.startswith("b, c have the same value in every row of y")
    y[:, 0] = X[:, 0]
    (doubt,) = raised(simulator, check_log(simulator, X, y, None), "constant")
    assert doubt.size == pytest.approx(0.5)
    assert doubt.sentence.startswith("c has the same value")


def test_where_the_simulation_diverges_a_channel_is_not_moved():
    X = np.linspace(0, 1, 40)[:, None]
    lost = one_shot(lambda X: np.where(X > 0.5, np.nan, 0.0), "b")
    assert raised(lost, check_log(lost, X, np.zeros(40), None), "constant") == []
    nowhere = one_shot(lambda X: np.full_like(X, np.nan), "b")
    assert raised(nowhere, check_log(nowhere, X, np.zeros(40), None), "constant") == []


# -- commands that are clipped, positions beyond a range -------------------------------------------------------------

SLIDER = """
<mujoco>
  <option timestep="0.01" gravity="0 0 0"/>
  <worldbody><body><joint name="rail" type="slide" axis="1 0 0" range="-1 3" limited="true"/>
    <geom size=".1" mass="1"/></body></worldbody>
  <actuator><motor name="push" joint="rail" ctrlrange="-2 1" ctrllimited="true"/></actuator>
</mujoco>
"""


def slid(places, commands):
    """Return the log of a slider that was seen at some places; its speeds were not measured."""
    simulator = MujocoSimulator(SLIDER)
    states = np.column_stack([places, np.full(len(places), np.nan)])
    return simulator, check_log(
        simulator, np.column_stack([states[:-1], commands]), states[1:], np.zeros(len(commands))
    )


def test_the_share_of_commands_beyond_a_limit_is_told():
    commands = np.zeros(100)
    commands[:2], commands[5:10], commands[20:30], commands[40:50] = 1.5, -2.5, 1.0, -2.0
    simulator, log = slid(np.sin(0.1 * np.arange(101)), commands)
    (doubt,) = raised(simulator, log, "clipped")
    assert doubt.size == pytest.approx(0.07)
    assert doubt.sentence.startswith("7 % of ctrl.push lie beyond [-2, 1], where the simulation clips them")
    commands[1:10] = 0.0
    # One row in a hundred is no more than that.
    assert raised(*slid(np.sin(0.1 * np.arange(101)), commands), "clipped") == []


def test_a_command_that_is_beyond_its_limit_by_rounding_is_not_clipped():
    commands = np.tile([1.0 + 1e-12, -2.0 - 1e-12], 50)
    assert raised(*slid(np.sin(0.1 * np.arange(101)), commands), "clipped") == []


@pytest.mark.parametrize(
    ("share", "place", "reach"),
    [(0.1, 7.5, "7.5"), (0.1, -5.5, "-5.5"), (0.1, 6.5, None), (0.1, -4.5, None), (0.01, 50.0, None)],
)
def test_positions_are_beyond_a_range_by_more_than_its_width_in_more_than_a_few_rows(share, place, reach):
    """The range is 4 m wide, from -1 to 3."""
    places = np.linspace(0, 1, 101)
    places[: int(share * 100)] = place
    found = raised(*slid(places, np.zeros(100)), "beyond")
    assert len(found) == (reach is not None)
    if reach:
        assert found[0].size == pytest.approx((max(place, 0) - 3 if place > 0 else -1 - place) / 4)
        said = f"qpos.rail reaches {reach} where the joint allows -1 to 3 m: another unit"
        assert found[0].sentence.startswith(said)


def test_a_joint_without_a_range_has_no_end():
    text = SLIDER.replace('range="-1 3" limited="true"', "")
    simulator, states = (
        MujocoSimulator(text),
        np.column_stack([np.linspace(0, 900, 101), np.full(101, np.nan)]),
    )
    log = check_log(simulator, np.column_stack([states[:-1], np.zeros(100)]), states[1:], np.zeros(100))
    assert raised(simulator, log, "beyond") == []


# -- degrees ---------------------------------------------------------------------------------------------------------


def turning(law=lambda angle, rate: -4 * np.sin(angle)):
    """Return a pendulum of two columns with units."""
    names = ("angle", "rate")
    return FunctionSimulator(
        lambda X: np.c_[X[:, 0] + 0.05 * X[:, 1], X[:, 1] + 0.05 * law(*X.T)],
        input_names=names,
        output_names=names,
        state_names=names,
        units={"angle": "rad", "rate": "rad/s"},
        dt=0.05,
    )


def turned(seed=0, noise=1e-3):
    states = turning().rollout([[2.0, 0.0], [1.0, 3.0]], n_steps=60)
    return states + noise * np.random.default_rng(seed).normal(size=states.shape)


def as_log(simulator, states):
    n = states.shape[1] - 1
    X, y = states[:, :-1].reshape(-1, 2), states[:, 1:].reshape(-1, 2)
    return check_log(simulator, X, y, np.repeat(np.arange(len(states)), n))


def typical_miss(simulator, states):
    """Return the median of errors as shares of the spread of what is predicted."""
    X, y = states[:, :-1].reshape(-1, 2), states[:, 1:].reshape(-1, 2)
    return np.median(np.abs(simulator.predict(X) - y) / y.std(axis=0))


@pytest.mark.parametrize("columns", [[0, 1], [0]])
def test_degrees_are_told_by_the_typical_error_before_and_after(columns):
    simulator, states = turning(), turned()
    wrong = states.copy()
    wrong[..., columns] = np.rad2deg(wrong[..., columns])
    (doubt,) = raised(simulator, as_log(simulator, wrong), "degrees")
    before, after = typical_miss(simulator, wrong), typical_miss(simulator, states)
    assert doubt.size == pytest.approx(before / after)
    assert doubt.refused == (before / after > 10)
    names = ", ".join(np.array(["angle", "rate"])[columns])
    assert doubt.sentence.startswith(
        f"{names} look like degrees: read as such, the simulation's typical error falls from {before:.2g} to "
        f"{after:.2g} of their spread. The simulator's unit"
    )


def test_angles_of_less_than_a_turn_are_never_asked_about():
    """Though the simulation would fit better if they were degrees."""
    simulator, states = turning(), turned()
    small = np.rad2deg(states) * 6.2 / np.abs(np.rad2deg(states[..., 0])).max()
    assert np.abs(small[..., 0]).max() == pytest.approx(6.2)
    assert raised(simulator, as_log(simulator, small), "degrees") == []


@pytest.mark.parametrize(("rate", "size"), [(0.0, None), (1.0, np.inf)])
def test_what_fits_without_any_error_in_degrees_is_refused_and_what_fits_in_either_unit_is_not(rate, size):
    """A wheel that turns on by its rate, of which only the angle is in degrees; and one that stands still."""
    wheel = turning(lambda angle, rate: 0 * angle)
    states = np.zeros((1, 65, 2))
    states[..., 1] = rate
    # Steps that are as exact in degrees as in radians, after numpy's own conversion.
    states[..., 0] = 8.0 + np.r_[0.0, np.cumsum(np.full(64, 0.05 * rate))]
    wrong = states.copy()
    wrong[..., 0] /= np.pi / 180
    found = raised(wheel, as_log(wheel, wrong), "degrees")
    assert len(found) == (size is not None)
    assert all(one.size > 1e6 and one.refused for one in found)


# -- angles that start anew ------------------------------------------------------------------------------------------


def spinning(*, wrap=False, unit="rad"):
    names, half = ("angle", "rate"), {"rad": np.pi, "deg": 180.0, "m": np.pi}[unit]

    def step(X):
        angle = X[:, 0] + 0.1 * X[:, 1]
        return np.c_[(angle + half) % (2 * half) - half if wrap else angle, X[:, 1]]

    return FunctionSimulator(
        step,
        input_names=names,
        output_names=names,
        state_names=names,
        units={"angle": unit, "rate": f"{unit}/s"},
        dt=0.1,
    )


@pytest.mark.parametrize(
    ("wrap", "unit", "noticed"), [(False, "rad", True), (True, "rad", False), (False, "m", False)]
)
def test_an_angle_starts_anew_only_where_the_simulation_turns_on(wrap, unit, noticed):
    states = spinning(wrap=True).rollout([[0.0, 4.0], [1.0, -7.0]], n_steps=50)
    log = as_log(spinning(wrap=wrap, unit=unit), states)
    count = np.sum(np.abs(np.diff(states[..., 0], axis=1)) > np.pi)
    found = raised(spinning(wrap=wrap, unit=unit), log, "wrapped")
    assert [one.size for one in found] == [count] * noticed
    if noticed:
        assert found[0].sentence.startswith(f"angle jumps by about a full turn in {count} of 100 rows, where")


# -- commands a row late, jumps --------------------------------------------------------------------------------------


def carried(dt=0.1):
    """Return two places that a command each moves."""
    names = ("x", "y")
    return FunctionSimulator(
        lambda X: X[:, :2] + X[:, 2:],
        input_names=(*names, "u", "v"),
        output_names=names,
        state_names=names,
        dt=dt,
    )


def carry(lengths=(30, 30), seed=0, noise=0.01):
    """Return commands (n_rows, 2) and the states read at the begin and at the end of each row."""
    rng = np.random.default_rng(seed)
    begins, ends, commands = [], [], []
    for length in lengths:
        pushes = rng.normal(size=(length, 2))
        path = np.r_[np.zeros((1, 2)), np.cumsum(pushes, axis=0)] + noise * rng.normal(size=(length + 1, 2))
        begins.append(path[:-1])
        ends.append(path[1:])
        commands.append(pushes)
    return (
        *(np.concatenate(one) for one in (begins, ends, commands)),
        np.repeat(np.arange(len(lengths)), lengths),
    )


def test_late_commands_are_told_by_the_typical_error_before_and_after():
    begins, ends, commands, groups = carry()
    late = np.roll(commands, 1, axis=0)
    log = check_log(carried(), np.c_[begins, late], ends, groups)
    (doubt,) = raised(carried(), log, "late")
    rows = np.flatnonzero(np.diff(groups) == 0)
    spread = ends[rows].std(axis=0)
    before, after = (
        np.median(np.sqrt(np.mean(((begins + given - ends)[rows] / spread) ** 2, axis=1)))
        for given in (late, commands)
    )
    assert doubt.size == pytest.approx(before / after)
    assert f"typical error falls from {before:.2g} to {after:.2g} of the spread" in doubt.sentence


@pytest.mark.parametrize(("changes", "noticed"), [(20, True), (19, False)])
def test_twenty_rows_in_which_commands_change_tell_whether_they_are_late(changes, noticed):
    begins, ends, commands, groups = carry((changes + 1,))
    log = check_log(carried(), np.c_[begins, np.roll(commands, 1, axis=0)], ends, groups)
    assert len(raised(carried(), log, "late")) == noticed
    assert raised(carried(), replace(log, consecutive=False), "late") == []


def test_commands_that_are_exact_a_row_later_are_infinitely_better():
    rng = np.random.default_rng(0)
    commands = rng.integers(-3, 4, (40, 2)).astype(float)
    path = np.r_[np.zeros((1, 2)), np.cumsum(commands, axis=0)]
    late = check_log(carried(), np.c_[path[:-1], np.roll(commands, 1, axis=0)], path[1:], np.zeros(40))
    assert raised(carried(), late, "late")[0].size == np.inf
    right = check_log(carried(), np.c_[path[:-1], commands], path[1:], np.zeros(40))
    assert raised(carried(), right, "late") == []


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([40], "row 40"),
        ([40, 60], "rows 40, 60"),
        ([10, 20, 30, 40, 50], "rows 10, 20, 30, 40, 50"),
        ([10, 20, 30, 40, 50, 60], "rows 10, 20, 30, 40, 50, ..."),
        (list(range(10, 20)), None),  # a tenth of the rows is what the world does
    ],
)
def test_rows_in_which_the_whole_state_jumps_are_listed(rows, said):
    begins, ends, commands, groups = carry((100,), noise=1e-3)
    for row in rows:
        begins[row + 1 :] += (-1) ** row * 100.0 if said is None else 30.0
        ends[row:] += (-1) ** row * 100.0 if said is None else 30.0
    found = raised(carried(), check_log(carried(), np.c_[begins, commands], ends, groups), "jumps")
    assert [one.size for one in found] == ([] if said is None else [len(rows)])
    if said:
        assert found[0].sentence.startswith(f"The state jumps in {said}, in most channels at once")


def test_a_jump_is_one_of_all_channels_and_of_a_log_in_time_order():
    begins, ends, commands, groups = carry((100,), noise=1e-3)
    begins[41:, 0] += 100
    ends[40:, 0] += 100
    assert raised(carried(), check_log(carried(), np.c_[begins, commands], ends, groups), "jumps") == []
    begins[41:, 1] += 100
    ends[40:, 1] += 100
    log = check_log(carried(), np.c_[begins, commands], ends, groups)
    assert raised(carried(), log, "jumps")
    assert raised(carried(), replace(log, consecutive=False), "jumps") == []
    ends[:, 1], begins[:, 1] = np.nan, np.nan
    assert raised(carried(), check_log(carried(), np.c_[begins, commands], ends, groups), "jumps") == []


# -- lags between positions and velocities ---------------------------------------------------------------------------


def gliding(dt=0.05):
    """Return a simulation whose velocities sum up to its positions."""
    names = ("x", "v")
    return FunctionSimulator(
        lambda X: np.c_[X[:, 0] + dt * X[:, 1] + dt**2 / 2 * X[:, 2], X[:, 1] + dt * X[:, 2]],
        input_names=(*names, "a"),
        output_names=names,
        state_names=names,
        units={"x": "m", "v": "m/s"},
        dt=dt,
    )


def swinging(lag, n=241, *, scale=1.0, bias=0.0, noise=1e-5, n_episodes=1):
    """Return the log of two slow oscillations whose velocities are late by a time, of steps of .05 s."""
    rng, tables = np.random.default_rng(0), []
    for episode in range(n_episodes):
        time = 0.05 * np.arange(n) + 7 * episode
        place = np.sin(1.3 * time) + 0.5 * np.sin(2.1 * time + 1)
        speed = 1.3 * np.cos(1.3 * (time - lag)) + 1.05 * np.cos(2.1 * (time - lag) + 1)
        push = -(1.3**2) * np.sin(1.3 * time) - 0.5 * 2.1**2 * np.sin(2.1 * time + 1)
        states = np.c_[place, scale * speed + bias] + noise * rng.normal(size=(n, 2))
        tables.append((np.c_[states, push][:-1], states[1:]))
    X, y = (np.concatenate(one) for one in zip(*tables))
    return check_log(gliding(), X, y, np.repeat(np.arange(n_episodes), n - 1))


@pytest.mark.parametrize("lag", [0.02, 0.01, -0.02])
@pytest.mark.parametrize(("scale", "bias"), [(1.0, 0.0), (1.1, 0.3)])
def test_a_lag_is_told_in_seconds_and_as_a_share_of_a_row_whatever_else_is_wrong_with_a_sensor(
    lag, scale, bias
):
    (doubt,) = raised(gliding(), swinging(lag, scale=scale, bias=bias), "lagging")
    who = "The velocities lag the positions" if lag > 0 else "The positions lag the velocities"
    seconds, share = re.match(rf"{who} by about (\S+) s \((\d+) % of a row\), as if", doubt.sentence).groups()
    # A change is of velocities as they are read.
    assert float(seconds) == pytest.approx(abs(lag) / scale, rel=0.03)
    assert float(share) == pytest.approx(100 * abs(lag) / scale / 0.05, abs=1.5)


@pytest.mark.parametrize(("lag", "noticed"), [(0.0018, True), (0.0012, False), (0.0, False), (-0.0018, True)])
def test_a_lag_of_less_than_a_thirtieth_of_a_row_is_none(lag, noticed):
    assert len(raised(gliding(), swinging(lag), "lagging")) == noticed


def test_a_lag_is_asked_of_ten_sums_in_time_order():
    assert len(raised(gliding(), swinging(0.02, 101), "lagging")) == 1
    assert raised(gliding(), swinging(0.02, 100), "lagging") == []
    assert len(raised(gliding(), swinging(0.02, 20, n_episodes=10), "lagging")) == 1
    assert raised(gliding(), swinging(0.02, 20, n_episodes=9), "lagging") == []
    assert raised(gliding(), replace(swinging(0.02), consecutive=False), "lagging") == []


def test_a_lag_is_asked_of_simulations_whose_velocities_sum_up_to_their_positions():
    def halved(X, dt=0.05):
        return np.c_[X[:, 0] + dt / 2 * X[:, 1], X[:, 1] + dt * X[:, 2]]

    geared = gliding().set_params(function=halved)
    log = swinging(0.02)
    assert raised(geared, log, "lagging") == []


# -- quaternions -----------------------------------------------------------------------------------------------------

BALL = """
<mujoco><worldbody><body><freejoint name="ball"/><geom type="box" size=".1 .2 .3"/></body></worldbody></mujoco>
"""


@pytest.mark.parametrize(("length", "noticed"), [(0.9, True), (1.03, True), (0.985, False), (1.015, False)])
def test_the_length_of_a_quaternion_is_told_whether_it_is_too_short_or_too_long(length, noticed):
    ball = MujocoSimulator(BALL, frame_skip=5)
    states = ball.rollout(
        np.r_[np.zeros(3), 1.0, np.zeros(3), 1.0, 0.0, 0.0, 0.3, 0.2, 0.1][None], n_steps=40
    )[0]
    states[:, 3:7] *= length
    states[:9, 3:7] *= 1.1 / length  # a few rows are not the typical one
    found = raised(ball, check_log(ball, states[:-1], states[1:], np.zeros(40)), "quaternion length")
    assert len(found) == noticed
    if noticed:
        assert found[0].size == pytest.approx(abs(length - 1))
        assert found[0].sentence.startswith(
            f"The quaternion of qpos.ball has the length {length:.3g} in a typical row, not 1"
        )


def test_the_order_of_a_quaternion_is_told_by_what_the_next_orientation_is_missed_by():
    ball = MujocoSimulator(BALL, frame_skip=5)
    start = np.r_[np.zeros(3), 1.0, np.zeros(3), 1.0, 0.0, 0.0, 3.0, -2.0, 1.0]
    states = ball.displace(
        ball.rollout(start[None], n_steps=40)[0], 1e-3 * np.random.default_rng(0).normal(size=(41, 12))
    )
    wrong = states.copy()
    wrong[:, 3:7] = states[:, [4, 5, 6, 3]]
    (doubt,) = raised(ball, check_log(ball, wrong[:-1], wrong[1:], np.zeros(40)), "quaternion order")
    before, after = (
        np.median(np.linalg.norm(ball.residual(one[1:], ball.predict(one[:-1]))[:, 3:6], axis=1))
        for one in (wrong, states)
    )
    assert doubt.size == pytest.approx(before / after)
    assert (
        f"misses the next orientation by {after:.2g} rad instead of {before:.2g} in a typical"
        in doubt.sentence
    )


# -- a solver that does not arrive ------------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_what_a_cold_solver_misses_counts_in_units_of_noise_but_of_no_less_than_a_thousandth_of_the_spread(
    noise,
):
    legged = MujocoSimulator(LEGGED.format(1, 4), frame_skip=2)
    states, commands = walked(LEGGED.format(1, 4), 2, noise)
    log = check_log(legged, np.hstack([states[:-1], commands]), states[1:], np.zeros(200))
    (doubt,) = raised(legged, log, "cold")
    warm, cold = (_stepped(legged.compiled(), log, 2, warm=one)[1:] for one in (True, False))
    differences = np.sqrt(np.mean((warm - cold) ** 2, axis=0))
    own = np.sqrt([noise_variance(one, np.zeros(200)) for one in states[1:].T])
    sizes = differences / np.maximum(own, 1e-3 * states[1:].std(axis=0))
    assert doubt.size == pytest.approx(sizes.max(), rel=1e-6)
    worst = int(np.argmax(sizes))
    unit = legged.units[legged.state_names[worst]]
    assert (
        f"by up to {differences[worst]:.2g} {unit} in a row (noise of that channel: {own[worst]:.2g})"
        in doubt.sentence
    )
    assert doubt.sentence.startswith(
        ", ".join(np.array(legged.state_names)[sizes > 0.3].tolist()) + " are not what"
    )
    assert "with at most 1 iterations" in doubt.sentence


# -- positions that were smoothed -------------------------------------------------------------------------------------


def read_by_a_sensor(smooth, n=401, n_episodes=2):
    """Return a log of a slow motion, its positions passed through a function, rates as differences of them."""
    rng = np.random.default_rng(0)
    time = 0.05 * np.arange(n)
    X, y = [], []
    for _ in range(n_episodes):
        place = smooth(np.sin(0.7 * time) + 0.5 * np.sin(1.1 * time + 1) + 1e-3 * rng.normal(size=n))
        states = np.column_stack([place, np.gradient(place, 0.05)])
        X.append(np.column_stack([states[:-1], np.zeros(n - 1)]))
        y.append(states[1:])
    episodes = np.repeat(np.arange(n_episodes), n - 1)
    return check_log(gliding(), np.concatenate(X), np.concatenate(y), episodes)


@pytest.mark.parametrize(("order", "cutoff"), [(2, 0.2), (2, 0.5), (4, 0.3)])
def test_positions_that_were_filtered_forward_and_backward_are_noticed(order, cutoff):
    smooth = partial(signal.sosfiltfilt, signal.butter(order, cutoff, output="sos"))
    (doubt,) = raised(gliding(), read_by_a_sensor(smooth), "smoothed")
    assert "hardly any noise at high frequencies" in doubt.sentence
    assert "than at 5 Hz" in doubt.sentence


@pytest.mark.parametrize(
    "smooth",
    [
        lambda place: place,
        lambda place: np.round(place, 3),
        partial(signal.sosfilt, signal.butter(1, 0.5, output="sos")),
    ],
)
def test_positions_as_a_sensor_reads_them_are_not_smoothed(smooth):
    assert raised(gliding(), read_by_a_sensor(smooth), "smoothed") == []


def test_short_episodes_say_nothing_of_a_filter():
    smooth = partial(signal.sosfiltfilt, signal.butter(2, 0.2, output="sos"))
    assert raised(gliding(), read_by_a_sensor(smooth, n=63), "smoothed") == []
    assert len(raised(gliding(), read_by_a_sensor(smooth, n=65), "smoothed")) == 1


def test_power_of_white_noise_is_its_variance_at_every_frequency():
    noise = 0.3 * np.random.default_rng(0).normal(size=40_001)
    shares, powers = power_by_frequency(noise, 64)
    for low in (0.1, 0.3, 0.5, 0.7, 0.9):
        band = powers[(shares > low) & (shares < low + 0.1)]
        assert np.mean(band) == pytest.approx(0.09, rel=0.1)
    assert [len(one) for one in power_by_frequency(np.r_[noise, np.nan], 64)] == [0, 0]
