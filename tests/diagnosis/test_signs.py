"""The size of each sign in a log, by hand, and how the table makes doubts of signs."""

import warnings

import mujoco
import numpy as np
import pytest

from skat.diagnosis import doubts
from skat.diagnosis.doubts import Doubt, Look, Sign, doubts_about, warn_of_doubts
from skat.diagnosis.log import check_log
from skat.simulators import FunctionSimulator, MujocoSimulator

DT = 0.1
NAMES = ("p", "q")
SLIDER = """
<mujoco>
  <worldbody><body>
    <joint name="rail" type="slide" axis="1 0 0" range="-1 3" limited="{limited}"/>
    <geom size=".1" mass="1"/>
    <body><joint name="wheel" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 0 0 -.2"/></body>
  </body></worldbody>
  <actuator>
    <motor name="pull" joint="rail" ctrlrange="-2 2" ctrllimited="true"/>
    <position name="aim" joint="wheel" kp="3"/><velocity name="speed" joint="wheel" kv="2"/>
    <position name="place" joint="rail" kp="3"/><motor name="torque" joint="wheel"/>
  </actuator>
</mujoco>"""


def moving(step=None, *, units=None, dt=DT, names=NAMES):
    """Return a simulation of two coordinates that a command moves, or of another step."""
    return FunctionSimulator(
        step or (lambda X: X[:, :2] + X[:, 2:]),
        input_names=(*names, "u"),
        output_names=names,
        state_names=names,
        units=units,
        dt=dt,
    )


def logged(simulator, lengths=(60,), *, seed=0, begin=0.0, commands=None):
    """Return X, y and groups of the simulation itself."""
    rng, states, actions = np.random.default_rng(seed), [], []
    for length in lengths:
        own = rng.normal(size=(length, 1)) if commands is None else commands
        state = begin + np.zeros((1, 2))
        run = [state]
        for command in own:
            state = simulator.predict(np.c_[state, command[None]])
            run.append(state)
        states.append(np.concatenate(run))
        actions.append(own)
    X = np.concatenate([np.c_[run[:-1], own] for run, own in zip(states, actions)])
    y = np.concatenate([run[1:] for run in states])
    return X, y, np.repeat(np.arange(len(lengths)), lengths)


def look_at(simulator, X, y, groups):
    return Look(simulator, check_log(simulator, X, y, groups))


# -- the table -------------------------------------------------------------------------------------------------------


def yielding(*signs):
    return lambda look: iter(signs)


@pytest.fixture
def log():
    simulator = moving()
    return simulator, check_log(simulator, *logged(simulator))


def raised(log, *table, monkeypatch):
    monkeypatch.setattr(doubts, "DOUBTS", table)
    return list(doubts_about(*log))


def test_only_a_sign_that_is_larger_than_the_threshold_is_a_doubt(log, monkeypatch):
    table = Doubt("a", yielding(Sign(1.0, ("x",)), Sign(1.5, ("y",)), Sign(3.5, ("z",))), 1.0, "{names}", 3.0)
    found = raised(log, table, monkeypatch=monkeypatch)
    assert [(one.sentence, one.size, one.refused) for one in found] == [("y", 1.5, False), ("z", 3.5, True)]
    at_the_edge = Doubt("a", yielding(Sign(3.0, ("x",))), 1.0, "{names}", 3.0)
    assert [one.refused for one in raised(log, at_the_edge, monkeypatch=monkeypatch)] == [False]
    assert Doubt("a", yielding(), 1.0, "").refused == np.inf


def test_a_doubt_that_another_explains_is_not_raised(log, monkeypatch):
    first = Doubt("first", yielding(Sign(2.0)), 1.0, "one")
    weak = Doubt("first", yielding(Sign(0.5)), 1.0, "one")
    second = Doubt("second", yielding(Sign(2.0)), 1.0, "two", unless=("first", "other"))
    assert [one.name for one in raised(log, first, second, monkeypatch=monkeypatch)] == ["first"]
    assert [one.name for one in raised(log, weak, second, monkeypatch=monkeypatch)] == ["second"]


def test_signs_that_share_a_sentence_are_told_with_the_words_of_the_largest(log, monkeypatch):
    signs = Sign(0.5, ("v",), {"k": 0}), Sign(2.0, ("x",), {"k": 1}), Sign(5.0, ("y",), {"k": 2})
    together = Doubt("a", yielding(*signs), 1.0, "{names} {has} {k}, {is} it", together=True)
    (one,) = raised(log, together, monkeypatch=monkeypatch)
    assert (one.sentence, one.size) == ("x, y have 2, are it", 5.0)
    alone = Doubt("a", yielding(*signs), 1.0, "{names} {has} {k}, {is} it")
    assert [one.sentence for one in raised(log, alone, monkeypatch=monkeypatch)] == [
        "x has 1, is it",
        "y has 2, is it",
    ]
    assert raised(log, Doubt("a", yielding(), 1.0, "", together=True), monkeypatch=monkeypatch) == []


def test_what_is_refused_is_an_error_and_the_rest_a_warning(log, monkeypatch):
    table = (
        Doubt("a", yielding(Sign(2.0, ("x",))), 1.0, "{names} is odd"),
        Doubt("b", yielding(Sign(9.0, ("y",))), 1.0, "{names} is wrong", refused=5.0),
    )
    monkeypatch.setattr(doubts, "DOUBTS", table)
    with pytest.warns(UserWarning, match="x is odd"), pytest.raises(ValueError, match="y is wrong"):
        warn_of_doubts(*log)


# -- what signs ask of a log -----------------------------------------------------------------------------------------


def test_errors_are_shares_of_what_a_channel_spreads_and_infinite_where_the_simulation_diverges():
    simulator = moving()
    X, y, groups = logged(simulator)
    y[:, 1], X[:, 1] = 3.0, 3.0
    look = look_at(simulator, X, y, groups)
    errors = np.zeros_like(y)
    errors[7] = [0.5, -0.25]
    predicted = y + errors
    predicted[9, 1] = np.nan
    shares = look.shares_of_spread(y, predicted)
    # A channel that rests has none to be a share of.
    np.testing.assert_allclose(shares[7], [0.5 / y[:, 0].std(), 0.25], rtol=1e-9)
    assert (shares[9] == np.inf).all()
    assert (np.delete(shares, [7, 9], axis=0) == 0).all()


def test_a_channel_that_was_measured_in_one_row_was_measured():
    simulator = moving()
    X, y, groups = logged(simulator)
    X[:, 0], y[:, 0] = np.nan, np.nan
    X[:, 1], y[:, 1] = np.nan, np.nan
    y[4, 1] = 0.0
    X[5, 1] = 0.0
    look = look_at(simulator, X, y, groups)
    assert not look.is_measured("p")
    assert look.is_measured("q")
    assert not look.has_whole_rows
    X[5, 0] = y[4, 0] = X[4, 0] = X[4, 1] = y[3, 0] = y[3, 1] = 0.0
    assert look_at(simulator, X, y, groups).has_whole_rows


# -- sizes by hand ---------------------------------------------------------------------------------------------------


def test_a_stuck_channel_is_as_odd_as_the_simulation_moves_it():
    simulator = moving(lambda X: np.c_[X[:, 0] + X[:, 2], X[:, 1] + 0.4 * np.sign(X[:, 0])])
    X, y, groups = logged(simulator)
    X[:, 1], y[:, 1] = 2.0, 2.0
    (sign,) = doubts._constant(look_at(simulator, X, y, groups))
    assert sign.names == ("q",)
    assert sign.size == pytest.approx(0.4)
    X[:, 0], y[:, 0] = 1.0, 1.0
    look = look_at(simulator, X, y, groups)
    assert [one.size for one in doubts._constant(look)] == pytest.approx([np.abs(X[:, 2]).max(), 0.4])
    # Two stuck channels share a sentence.
    (doubt,) = (one for one in doubts_about(simulator, look.log) if one.name == "constant")
    assert doubt.sentence.startswith("p, q have the same value")


def slider(limited="true"):
    return MujocoSimulator(SLIDER.format(limited=limited), frame_skip=5)


def slid(simulator, n=100):
    rng = np.random.default_rng(0)
    commands = 0.1 * rng.uniform(-1, 1, size=(1, n, 5))
    states = simulator.rollout(np.zeros((1, 4)), commands, n_steps=n)[0]
    return np.c_[states[:-1], commands[0]], states[1:], np.zeros(n)


def test_commands_beyond_their_range_count_and_those_at_its_ends_do_not():
    simulator = slider()
    X, y, groups = slid(simulator)
    pull = simulator.input_names.index("ctrl.pull")
    X[:, pull] = 2.0
    X[::2, pull] = -2.0
    (sign,) = doubts._clipped(look_at(simulator, X, y, groups))
    assert (sign.size, sign.names) == (0.0, ("ctrl.pull",))
    X[:5, pull], X[5:8, pull] = 2.01, -2.01
    (sign,) = doubts._clipped(look_at(simulator, X, y, groups))
    assert sign.size == pytest.approx(0.08)
    assert (sign.words["percent"], sign.words["low"], sign.words["high"]) == ("8", -2, 2)


@pytest.mark.parametrize(("place", "size"), [(5.0, 0.5), (-3.0, 0.5), (3.0, 0.0), (1.0, -0.5), (0.0, -0.25)])
def test_a_position_beyond_its_range_is_so_by_a_share_of_its_width(place, size):
    simulator = slider()
    X, y, groups = slid(simulator)
    column = simulator.input_names.index("qpos.rail")
    X[:, column], y[:, column] = place, place
    (sign,) = doubts._beyond(look_at(simulator, X, y, groups))
    assert sign.names == ("qpos.rail",)
    assert sign.size == pytest.approx(size)
    assert float(sign.words["value"]) == place
    assert (sign.words["low"], sign.words["high"], sign.words["unit"]) == (-1, 3, "m")
    # One row of a hundred tells nothing of the others.
    X[50, column] = y[49, column] = 50.0
    (same,) = doubts._beyond(look_at(simulator, X, y, groups))
    assert same.size == pytest.approx(size)
    assert list(doubts._beyond(look_at(slider("false"), X, y, groups))) == []


def test_of_servos_those_on_a_hinge_are_told_by_what_they_hold():
    aims, speeds = doubts._commands_of_servos(slider())
    assert (aims, speeds) == (["ctrl.aim"], ["ctrl.speed"])
    plain = moving(units={"u": "rad"})
    assert doubts._commands_of_servos(plain) == (["u"], [])
    assert doubts._commands_of_servos(moving(units={"u": "rad/s"})) == ([], ["u"])


@pytest.mark.parametrize(("unit", "half"), [("rad", np.pi), ("deg", 180.0)])
def test_full_turns_are_counted_where_the_simulation_turns_on(unit, half):
    simulator = moving(units={"p": unit})
    commands = np.full((100, 1), half / 8)
    X, y, groups = logged(simulator, (len(commands),), commands=commands)
    assert list(doubts._wrapped(look_at(simulator, X, y, groups))) == []
    for table in (X, y):
        table[:, 0] = np.remainder(table[:, 0] + half - 1e-6, 2 * half) - half
    (sign,) = doubts._wrapped(look_at(simulator, X, y, groups))
    assert sign.size == sign.words["count"] == np.sum(np.abs(y[:, 0] - X[:, 0]) > half)
    assert sign.words["rows"] == 100
    assert sign.size > 5
    rows = np.arange(12)  # one turn is enough
    assert np.sum(np.abs(y[rows, 0] - X[rows, 0]) > half) == 1
    once = check_log(simulator, X[rows], y[rows], groups[rows])
    assert "wrapped" in {one.name for one in doubts_about(simulator, once)}


@pytest.mark.parametrize("n_changes", [19, 20])
def test_late_commands_are_told_from_twenty_rows_in_which_they_change(n_changes):
    simulator = moving()
    commands = np.zeros((60, 1))
    commands[1 : n_changes + 1] = np.cumsum(np.ones((n_changes, 1)), axis=0)
    commands[n_changes + 1 :] = commands[n_changes]
    X, y, groups = logged(simulator, (len(commands),), commands=commands)
    late = X.copy()
    late[1:, 2] = X[:-1, 2]
    late[0, 2] = 0.0
    # A row behind, as many changes stand between two rows.
    signs = list(doubts._late(look_at(simulator, late, y, groups)))
    assert len(signs) == (n_changes == 20)
    if signs:
        assert signs[0].size == np.inf
    for sign in doubts._late(look_at(simulator, X, y, groups)):
        assert sign.size == 0.0


def test_a_simulation_that_fits_either_way_has_no_late_commands():
    simulator = moving(lambda X: X[:, :2] + 0.1)
    X, y, groups = logged(simulator)
    (sign,) = doubts._late(look_at(simulator, X, y, groups))
    assert sign.size == 1.0


@pytest.mark.parametrize(
    ("at", "told"),
    [([20], "row 20"), ([20, 40], "rows 20, 40"), (range(9, 63, 9), "rows 9, 18, 27, 36, 45, ...")],
)
def test_jumps_are_counted_and_the_first_five_named(at, told):
    simulator = moving()
    X, y, groups = logged(simulator, (100,), seed=3)
    X[:, 2] *= 0.01
    path = np.cumsum(np.r_[np.zeros((1, 1)), X[:, 2:]], axis=0) * np.ones((1, 2))
    for place, row in enumerate(at):
        path[row + 1 :] += 2.0 * (-1) ** place
    X[:, :2], y = path[:-1], path[1:]
    (sign,) = doubts._jumps(look_at(simulator, X, y, groups))
    assert sign.size == len(at)
    assert sign.words["rows"] == told
    assert "jumps" in {one.name for one in doubts_about(simulator, check_log(simulator, X, y, groups))}


def test_where_many_rows_jump_or_one_channel_of_two_does_no_episode_begins():
    simulator = moving()
    X, _, groups = logged(simulator, (100,), seed=3)
    X[:, 2] *= 0.01
    smooth = np.cumsum(np.r_[np.zeros((1, 1)), X[:, 2:]], axis=0) * np.ones((1, 2))
    one = smooth.copy()
    one[21:, 0] += 2.0
    X[:, :2] = one[:-1]
    assert [sign.size for sign in doubts._jumps(look_at(simulator, X, one[1:], groups))] == [0]
    many = smooth + 2.0 * (np.arange(101)[:, None] // 5 % 2)
    X[:, :2] = many[:-1]
    assert list(doubts._jumps(look_at(simulator, X, many[1:], groups))) == []


def test_a_simulation_that_keeps_its_word_has_no_random_sign_and_one_that_forgets_it_by_its_share():
    simulator = moving()
    X, y, groups = logged(simulator)
    (sign,) = doubts._random(look_at(simulator, X, y, groups))
    assert sign.size == 0.0
    calls = []

    def forgetful(X):
        calls.append(0)
        out = X[:, :2] + X[:, 2:]
        out[5, 1] += 0.1 * len(calls)
        return out

    look = look_at(moving(forgetful), X, y, groups)
    (sign,) = doubts._random(look)
    assert (sign.names, sign.words["row"]) == (("q",), 5)
    assert sign.size == pytest.approx(0.1 / y[:, 1].std())
    calls.clear()

    def sometimes(X):
        calls.append(0)
        out = X[:, :2] + X[:, 2:]
        out[3, 0] = np.nan if len(calls) == 2 else out[3, 0]
        return out

    (sign,) = doubts._random(look_at(moving(sometimes), X, y, groups))
    assert (sign.size, sign.words["row"]) == (np.inf, 3)


BALL = """<mujoco><worldbody><body><freejoint name="ball"/><geom type="box" size=".1 .2 .3"/></body></worldbody>
</mujoco>"""


@pytest.mark.parametrize("length", [0.9, 1.0, 1.15])
def test_a_quaternion_s_length_is_odd_by_what_it_differs_from_one(length):
    ball = MujocoSimulator(BALL, frame_skip=5)
    states = ball.rollout(np.r_[np.zeros(3), 1.0, np.zeros(6), 1.0, 2.0, 0.5][None], n_steps=40)[0]
    states[:, 3:7] *= length
    states[5] = np.nan
    (sign,) = doubts._lengths(look_at(ball, states[:-1], states[1:], np.zeros(40)))
    assert sign.size == pytest.approx(abs(length - 1), abs=1e-9)
    assert (sign.names, sign.words["length"]) == (("qpos.ball",), f"{length:.3g}")


def test_a_solver_that_is_not_needed_is_as_warm_as_cold_and_steps_as_mujoco_does():
    simulator = slider()
    X, y, groups = slid(simulator, 30)
    log = check_log(simulator, X, y, groups)
    model = simulator.compiled()
    data = mujoco.MjData(model)
    for warm in (False, True):
        ends = doubts._stepped(model, log, 5, warm=warm)
        for row in (0, 7, 29):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:], data.ctrl[:] = np.split(log.X[row], [2, 4])
            mujoco.mj_step(model, data, 5)
            np.testing.assert_allclose(ends[row], np.r_[data.qpos, data.qvel], atol=1e-9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_doubts(simulator, log)


# -- velocities that lag ---------------------------------------------------------------------------------------------


def swinging(late=0.0, share=1.0, seed=0):
    """Return the log of a place that swings, whose velocity is read late by a time and too large by a share."""
    names = ("qpos.c", "qvel.c")
    simulator = FunctionSimulator(
        lambda X: np.c_[X[:, 0] + DT * X[:, 1] + DT**2 / 2 * X[:, 2], X[:, 1] + DT * X[:, 2]],
        input_names=(*names, "u"), output_names=names, state_names=names, units={"qpos.c": "m", "qvel.c": "m/s"}, dt=DT,
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    time = DT * np.arange(401)
    frequencies, phases = rng.uniform(0.3, 1.5, 4), rng.uniform(0, 6, 4)
    place = np.sin(time[:, None] * frequencies + phases).sum(axis=1)
    speed = (frequencies * np.cos((time[:, None] - late) * frequencies + phases)).sum(axis=1) * share
    states = np.c_[place, speed] + 1e-3 * rng.normal(size=(401, 2))
    force = -(frequencies**2 * np.sin(time[:-1, None] * frequencies + phases)).sum(axis=1)
    return simulator, np.c_[states[:-1], force], states[1:], np.zeros(400)


@pytest.mark.parametrize("late", [0.03, -0.03])
def test_a_lag_is_told_in_seconds_and_in_rows_with_who_lags(late):
    simulator, X, y, groups = swinging(late, share=1.2)
    (sign,) = doubts._lagging(look_at(simulator, X, y, groups))
    assert sign.size > 5
    told = sign.words["lag"]
    seconds, percent = float(told.split()[1]), float(told.split("(")[1].split()[0])
    assert seconds == pytest.approx(0.03, abs=0.006)
    assert percent == pytest.approx(100 * seconds / DT, abs=2)
    assert sign.words["who"] == (
        "The velocities lag the positions" if late > 0 else "The positions lag the velocities"
    )


def test_velocities_in_step_have_no_lag_however_large_their_scale():
    for share in (1.0, 0.8):
        assert list(doubts._lagging(look_at(*swinging(0.0, share)))) == []
