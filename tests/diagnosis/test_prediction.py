"""Gains at a horizon and over whole episodes, on logs that were not fitted."""

import numpy as np
import pytest

from skat.diagnosis.fitting import Known, first_fit
from skat.diagnosis.prediction import horizon_rows, open_loop_gain, predicted
from skat.diagnosis.statespace import state_space
from skat.effects import Effect
from skat.simulators import FunctionSimulator, MujocoSimulator
from tests.diagnosis.pendulum import (
    DT,
    FRAME_SKIP,
    NOMINAL,
    SIGMA,
    TEXT,
    known,
    laid_out,
    measured,
)

DAMPED = TEXT.format(damping=0.15)
CAUSE = {"damping[hinge]": 0.1}


@pytest.fixture(scope="module")
def simulator():
    return MujocoSimulator(NOMINAL, frame_skip=FRAME_SKIP)


def push(q, v, time, rng):
    return 0.3 * rng.normal()


def logs(simulator, text, law, *, hidden=False, rows=125, n_episodes=(4, 16)):
    """Return a log to fit, and one to test."""
    spaces = []
    for seed, episodes in enumerate(n_episodes):
        X, y, groups = measured(text, seed, law=law, episodes=episodes, rows=rows)
        if hidden:
            X[:, 1] = y[:, 1] = np.nan
        spaces.append(laid_out(simulator, X, y, groups))
    return spaces


def predicted_gain(*log, **options):
    return predicted(*log, random_state=random_state(), **options).gain


def random_state():
    return np.random.RandomState(0)


# Each force and each way to measure once; the other pairs of them are long.
@pytest.mark.parametrize(
    ("law", "hidden"),
    [
        pytest.param(None, False, id="no force, all measured"),
        pytest.param(push, True, id="a random force, no velocities"),
        pytest.param(None, True, id="no force, no velocities", marks=pytest.mark.long),
        pytest.param(push, False, id="a random force, all measured", marks=pytest.mark.long),
    ],
)
def test_a_right_model_is_at_the_floor_and_a_cause_explains_what_it_adds(simulator, law, hidden):
    train, test = logs(simulator, DAMPED, law, hidden=hidden)
    gain = predicted_gain(test, known(train, CAUSE, 0.3 if law else 1e-6), CAUSE)
    # Of some seventy windows whose channels go together: a mean of squares is right to a third.
    assert gain.extended == pytest.approx(1.0, abs=0.35)
    assert gain.floor == pytest.approx(1.0)
    assert gain.nominal > 10
    assert gain.interval[0] - 0.02 <= 1.0 <= gain.interval[1] + 0.02
    assert gain.explained == pytest.approx(1.0, abs=0.03)
    assert gain.horizon == pytest.approx(0.25)
    if not law and not hidden:
        np.testing.assert_allclose(
            [gain.channels[name][1] for name in simulator.residual_names], SIGMA, rtol=0.2
        )


def test_a_random_force_and_one_with_memory_belong_to_the_floor(simulator):
    last = [0.0]

    def lasting(q, v, time, rng):
        last[0] = (0.9 * last[0] if time else 0.0) + 0.13 * rng.normal()
        return last[0]

    for law, share in ((push, None), (lasting, 0.9)):
        train, test = logs(simulator, NOMINAL, law)
        gain = predicted_gain(test, known(train, {}, 0.3, share=share), {})
        assert gain.extended == gain.nominal == pytest.approx(1.0, abs=0.45)
        assert gain.explained == 0.0


def test_rows_that_were_not_measured_do_not_count(simulator):
    train, _ = logs(simulator, NOMINAL, None)
    X, y, groups = measured(NOMINAL, 5)
    fitted = known(train, {}, 1e-6)
    y[groups == 1] += 1.0  # would be errors
    follows = np.r_[False, np.diff(groups) == 0]
    X[(groups == 1) & follows, :2] += 1.0
    y[groups == 1], X[(groups == 1) & follows, :2] = np.nan, np.nan
    gain = predicted_gain(laid_out(simulator, X, y, groups), fitted, {})
    assert gain.extended == pytest.approx(1.0, abs=0.4)


def test_a_delay_is_known_at_the_start_of_each_window(simulator):
    """Else each prediction begins with commands that were not given."""
    X, y, groups = measured(NOMINAL, 6, delay=3, episodes=12, rows=80)
    cause = {"delay[action]": 0.03}
    space = laid_out(simulator, X, y, groups)
    fitted = known(space, cause, 1e-6)
    gain = predicted_gain(space, fitted, cause, horizon=5)
    assert gain.extended == pytest.approx(1.0, abs=0.25)
    assert gain.nominal > 2


def test_one_wild_row_does_not_decide(simulator):
    train, test = logs(simulator, DAMPED, push, n_episodes=(4, 8))
    fitted = known(train, CAUSE, 0.3, nu=3)
    quiet = predicted_gain(test, fitted, CAUSE)
    X, y, groups = measured(DAMPED, 1, law=push, episodes=8, rows=125)
    y[524, 1] += 10
    X[525, 1] += 10
    wild = predicted_gain(laid_out(simulator, X, y, groups), fitted, CAUSE)
    assert wild.explained == pytest.approx(quiet.explained, abs=0.25)


def test_overlays_show_the_episodes_that_the_nominal_model_predicts_worst(simulator):
    train, test = logs(simulator, DAMPED, None)
    prediction = predicted(test, known(train, CAUSE, 1e-6), CAUSE, horizon=25, random_state=random_state())
    assert len(prediction.overlays) == min(3, len(np.unique(test.groups)))
    first, second = (np.mean((one.nominal - one.measured) ** 2) for one in prediction.overlays[:2])
    assert first > second / 3
    one = prediction.overlays[0]
    assert one.channels == simulator.output_names
    assert one.time[0] == pytest.approx(DT)
    assert np.abs(one.extended - one.measured).max() < 6 * SIGMA.max()
    assert one.measured.shape == one.nominal.shape == (len(one.time), 2)


@pytest.mark.parametrize("start", ["measured", "fitted"])
def test_whole_episodes_in_open_loop_end_where_the_world_does(simulator, start):
    train, test = logs(simulator, DAMPED, None, rows=150, n_episodes=(2, 6))
    gain = open_loop_gain(
        test, known(train, CAUSE, 1e-6), CAUSE, initial_state=start, random_state=random_state()
    )
    assert gain.horizon == "episode"
    assert gain.extended < 2 * gain.floor
    assert gain.explained == pytest.approx(1.0, abs=0.02)
    if start == "fitted":
        assert gain.extended == pytest.approx(np.sqrt(np.sum(SIGMA**2)), rel=0.1)


@pytest.mark.parametrize(("episodes", "told"), [(5, True), (4, False)])
def test_five_episodes_tell_how_far_a_gain_varies_and_four_do_not(simulator, episodes, told):
    train = laid_out(simulator, *measured(DAMPED, 0, episodes=2, rows=60))
    test = laid_out(simulator, *measured(DAMPED, 1, episodes=episodes, rows=60))
    gain = open_loop_gain(test, known(train, CAUSE, 1e-6), CAUSE, random_state=random_state())
    assert np.isfinite(gain.interval).all() == told


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_initial_states_are_fitted_in_any_unit(unit):
    """A place read with much noise: fitted, its own error is left, and no more."""
    simulator = FunctionSimulator(
        lambda X, drift: X[:, :1] + unit * (X[:, 1:] + drift),
        input_names=("x", "u"),
        output_names=("x",),
        state_names=("x",),
        effects=[Effect("drift", unit="1", neutral=0.0, bounds=(-1.0, 1.0))],
        dt=1.0,
    )
    rng = np.random.default_rng(0)
    speed = rng.normal(size=(8, 60))
    truth = unit * np.pad(np.cumsum(speed, axis=1), ((0, 0), (1, 0)))
    read = truth + 0.5 * unit * rng.normal(size=truth.shape)
    read[:, 0] += 5 * unit
    X = np.column_stack([read[:, :-1].ravel(), speed.ravel()])
    space = state_space(
        simulator, X, read[:, 1:].reshape(-1, 1), np.repeat(np.arange(8), 60), consecutive=True
    )
    fitted = first_fit(space, {}, Known(given=np.array([0.5 * unit])))
    gain = open_loop_gain(space, fitted, {}, initial_state="fitted", random_state=random_state())
    assert gain.nominal == pytest.approx(0.5 * unit, rel=0.3)


def test_open_loop_names_what_is_wrong_with_its_input(simulator):
    train, test = logs(simulator, NOMINAL, None, hidden=True, rows=40)
    fitted = known(train, {}, 1e-6)
    with pytest.raises(ValueError, match=r"qvel\.hinge were not measured in the first row"):
        open_loop_gain(test, fitted, {}, random_state=random_state())
    with pytest.raises(ValueError, match=r"outputs names nose; measured channels are qpos\.hinge"):
        open_loop_gain(test, fitted, {}, outputs=["nose"], random_state=random_state())


def test_a_function_without_a_state_is_judged_row_by_row():
    simulator = FunctionSimulator(lambda X: 2 * X, input_names=("a",), output_names=("y",))
    rng = np.random.default_rng(0)
    spaces = []
    for _ in range(2):
        X = rng.normal(size=(200, 1))
        y = 2 * X + 0.1 * rng.normal(size=(200, 1))
        spaces.append(state_space(simulator, X, y, np.arange(200), consecutive=False))
    wrong = {"scale[y]": 1.5}
    gain = predicted_gain(spaces[1], first_fit(spaces[0], {}), wrong)
    assert gain.nominal == pytest.approx(1.0, abs=0.25)
    assert gain.extended > 5
    assert gain.horizon == 1


def test_the_horizon_is_a_quarter_of_a_second_or_ten_rows(simulator):
    assert horizon_rows(simulator) == 25
    assert horizon_rows(MujocoSimulator(NOMINAL, frame_skip=20)) == 10
    assert horizon_rows(simulator, 1.0) == 100
    with pytest.raises(ValueError, match="horizon must be positive"):
        horizon_rows(simulator, 0.0)
