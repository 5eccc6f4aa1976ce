"""Laws of every simulator, checked on a pendulum written as a function."""

import copy
import pickle
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

from skat.effects import Effect
from skat.simulators import FunctionSimulator

STATE = ("angle", "rate")
EFFECTS = (
    Effect("gravity", unit="1", neutral=1.0, bounds=(0.0, 3.0)),
    Effect("damping[joint]", unit="1/s", neutral=0.0, bounds=(0.0, 5.0)),
)


def swing(X, **values):
    angle, rate, torque = X.T
    change = -9.81 * values["gravity"] * np.sin(angle) - values["damping[joint]"] * rate + torque
    return np.stack([angle + 0.1 * rate, rate + 0.1 * change], axis=1)


@pytest.fixture
def pendulum():
    return FunctionSimulator(
        swing, input_names=(*STATE, "torque"), output_names=STATE, state_names=STATE, effects=EFFECTS, dt=0.1
    )


@pytest.fixture
def rows():
    return np.random.default_rng(0).normal(size=(30, 3))


def test_predict_is_predict_many_with_one_candidate(pendulum, rows):
    values = {"gravity": 1.5}
    np.testing.assert_array_equal(
        pendulum.predict(rows, effects=values), pendulum.predict_many(rows, [{}, values])[1]
    )


def test_pushes_displace_the_state_behind_each_step(pendulum):
    rng = np.random.default_rng(1)
    start, torques, pushes = rng.normal(size=(4, 2)), rng.normal(size=(4, 6, 1)), rng.normal(size=(4, 6, 2))
    candidates = [{}, {"gravity": 0.5}]
    found = pendulum.rollout_many(start, torques, candidates, n_steps=6, pushes=pushes)
    for values, paths in zip(candidates, found):
        state = start
        for step in range(6):
            state = swing(
                np.concatenate([state, torques[:, step]], axis=1),
                **{"gravity": 1.0, "damping[joint]": 0.0} | values,
            )
            state = state + pushes[:, step]
            np.testing.assert_allclose(paths[:, step + 1], state, rtol=1e-12)
    unpushed = pendulum.rollout_many(start, torques, candidates, n_steps=6, pushes=np.zeros_like(pushes))
    np.testing.assert_array_equal(unpushed, pendulum.rollout_many(start, torques, candidates, n_steps=6))


def test_built_in_effects_are_those_given_to_predict(pendulum, rows):
    values = {"gravity": 1.5, "bias[angle]": 0.1, "scale[rate]": 1.2}
    np.testing.assert_array_equal(
        pendulum.extended(values).predict(rows), pendulum.predict(rows, effects=values)
    )


def test_extensions_compose(pendulum, rows):
    twice = pendulum.extended({"gravity": 1.5, "damping[joint]": 0.2}).extended(
        {"gravity": 0.5, "damping[joint]": 0.3}
    )
    once = pendulum.extended({"gravity": 0.75, "damping[joint]": 0.5})
    assert twice.built_in == once.built_in
    np.testing.assert_array_equal(twice.predict(rows), once.predict(rows))


def test_extension_by_the_inverse_is_the_nominal_simulator(pendulum):
    assert pendulum.extended({"gravity": 2.0}).extended({"gravity": 0.5}).built_in is None


def test_bounds_are_relative_to_what_is_built_in(pendulum):
    bounds = {
        effect.name: effect.bounds
        for effect in pendulum.extended({"gravity": 2.0, "damping[joint]": 1.0}).effects()
    }
    assert bounds["gravity"] == (0.0, 1.5)
    assert bounds["damping[joint]"] == (-1.0, 4.0)


def test_what_is_built_in_reaches_a_bound_in_any_number_of_steps():
    """In floating point .1 + .2 is more than .3, and .3 - .1 - .2 less than 0."""
    drag = Effect("drag", unit="1/s", neutral=0.0, bounds=(0.0, 0.3))
    still = FunctionSimulator(
        lambda X, drag: X * (1 - drag), input_names=("v",), output_names=("v",), effects=[drag]
    )
    full = still.extended({"drag": 0.1}).extended({"drag": 0.2})
    assert (full.built_in, full.effects()[0].bounds) == ({"drag": 0.3}, (-0.3, 0.0))
    assert full.extended({"drag": -0.1}).extended({"drag": -0.2}).built_in is None


def test_quantity_stated_in_full_stays_one_when_it_is_built_in():
    pull = Effect("pull", unit="N", neutral=2.0, bounds=(0.0, 5.0))
    simulator = FunctionSimulator(
        lambda X, pull: X + pull, input_names=("x",), output_names=("x",), effects=[pull]
    ).extended({"pull": 2.5})
    (effect,) = (effect for effect in simulator.effects() if effect.name == "pull")
    assert (effect.neutral, effect.bounds) == (2.5, (0.0, 5.0))
    assert effect.describe(3.0) == "pull is 3 N (the model has 2.5 N)"
    assert simulator.extended({"pull": 3.0}).built_in == {"pull": 3.0}
    assert simulator.extended({"pull": 2.0}).built_in is None
    np.testing.assert_allclose(simulator.predict([[1.0]], effects={"pull": 3.0}), [[4.0]])


@pytest.mark.parametrize(
    ("effects", "error", "text"),
    [
        (
            [Effect("scale[motor]", unit="1", neutral=1.0, bounds=(0.2, 3.0))],
            ValueError,
            "Choose another family",
        ),
        (
            [Effect("lag[angle]", unit="s", neutral=0.0, bounds=(0.0, 1.0))],
            ValueError,
            "Choose another family",
        ),
        ({"gain": 1.0}, TypeError, "sequence of skat.effects.Effect"),
        ([EFFECTS[0], EFFECTS[0]], ValueError, "gravity occurs more than once"),
    ],
)
def test_effects_that_cannot_be_are_refused(pendulum, effects, error, text):
    with pytest.raises(error, match=text):
        pendulum.set_params(effects=effects)


def test_error_of_the_function_says_for_which_effects():
    def root(X, gain):
        if gain > 1.5:
            raise ZeroDivisionError("solver failed")
        return X * gain

    gain = Effect("gain", unit="1", neutral=1.0, bounds=(0.2, 3.0))
    simulator = FunctionSimulator(root, input_names=("x",), output_names=("y",), effects=[gain])
    with pytest.raises(ZeroDivisionError) as raised:
        simulator.predict([[1.0]], effects={"gain": 2.0})
    assert "1 rows and gain=2" in raised.value.__notes__[0]
    with pytest.raises(TypeError, match="real numbers"):
        simulator.set_params(function=lambda X, gain: X + 1j).predict([[1.0]])


def test_sensors_read_scale_times_true_plus_bias_in_inputs_and_outputs(pendulum, rows):
    true = pendulum.predict(rows)
    measured = rows * [1.0, 2.0, 1.0] + [0.3, 0.0, 0.0]
    found = pendulum.predict(measured, effects={"bias[angle]": 0.3, "scale[rate]": 2.0})
    np.testing.assert_allclose(found, true * [1.0, 2.0] + [0.3, 0.0], atol=1e-14)


@pytest.mark.parametrize("values", [{}, {"gravity": 1.5}, {"bias[angle]": 0.2, "scale[rate]": 1.1}])
def test_rollout_is_repeated_prediction(pendulum, values):
    random = np.random.default_rng(1)
    states, actions = random.normal(size=(4, 2)), random.normal(size=(4, 6, 1))
    found = pendulum.rollout(states, actions, n_steps=6, effects=values)
    assert found.shape == (4, 7, 2)
    for step in range(6):
        states = pendulum.predict(np.hstack([states, actions[:, step]]), effects=values)
        np.testing.assert_allclose(found[:, step + 1], states, atol=1e-12)


def test_missing_actions_are_zero(pendulum):
    np.testing.assert_array_equal(
        pendulum.rollout([[0.1, 0.0]], n_steps=3),
        pendulum.rollout([[0.1, 0.0]], np.zeros((1, 3, 1)), n_steps=3),
    )


def test_residual_and_displacement_are_inverse(pendulum, rows):
    tangent = np.random.default_rng(2).normal(size=(30, 2))
    moved = pendulum.displace(rows, tangent)
    np.testing.assert_array_equal(moved[:, 2], rows[:, 2])
    np.testing.assert_allclose(pendulum.residual(moved[:, :2], rows[:, :2]), tangent, atol=1e-14)


def test_simulator_pickles_copies_and_clones(pendulum, rows):
    extended = pendulum.extended({"gravity": 1.5})
    expected = extended.predict(rows)
    for other in (pickle.loads(pickle.dumps(extended)), copy.deepcopy(extended), clone(extended)):
        np.testing.assert_array_equal(other.predict(rows), expected)
        assert other.effects() == extended.effects()


def test_parameters_can_be_set(pendulum):
    assert pendulum.set_params(dt=0.2).get_params()["dt"] == 0.2
    assert pendulum.get_params()["effects"] == EFFECTS
    with pytest.raises(ValueError, match="unknown parameters mass"):
        pendulum.set_params(mass=1)
    with pytest.raises(ValueError, match="angel"):
        pendulum.set_params(units={"angel": "rad"}, dt=0.3)
    assert pendulum.dt == 0.2
    for dt in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="dt must be positive and finite"):
            pendulum.set_params(dt=dt)


def test_data_frame_columns_are_matched_by_name(pendulum, rows):
    frame = pd.DataFrame(rows, columns=pendulum.input_names)[["torque", "rate", "angle"]]
    np.testing.assert_array_equal(pendulum.predict(frame), pendulum.predict(rows))
    with pytest.raises(ValueError, match="X lacks the columns torque; expected angle, rate, torque"):
        pendulum.predict(frame[["angle", "rate"]])


def test_wrong_number_of_columns_lists_the_columns(pendulum):
    with pytest.raises(
        ValueError, match=r"\(n_rows, 3\), with the columns angle, rate, torque; got .*\(5, 2\)"
    ):
        pendulum.predict(np.zeros((5, 2)))


def test_missing_value_is_located(pendulum, rows):
    rows[7, 1] = np.nan
    with pytest.raises(ValueError, match="1 values that are not finite, the first in row 7, column 'rate'"):
        pendulum.predict(rows)


def test_a_number_written_as_a_text_is_located(pendulum, rows):
    texts = rows.astype(object)
    texts[3, 2] = "0.5"
    with pytest.raises(ValueError, match=r"X holds the text '0.5' in row 3, column 2; .* by table\.astype"):
        pendulum.predict(texts)


def test_diverged_rows_are_named():
    broken = FunctionSimulator(
        lambda X: np.where(X > 2, np.inf, X), input_names=("a",), output_names=("b",), effects=()
    )
    with pytest.raises(RuntimeError, match=r"diverged in 2 of 4 rows \(row 1, 3\)"):
        broken.predict([[0.0], [3.0], [1.0], [4.0]])
    assert np.isnan(broken.predict_many([[0.0], [3.0]], [{}])[0, :, 0]).tolist() == [False, True]


def test_diverged_episode_is_nan_from_there_on():
    growing = FunctionSimulator(
        lambda X: np.where(X > 4, np.inf, 2 * X), input_names=("a",), output_names=("a",), state_names=("a",)
    )
    states = growing.rollout_many([[1.0], [0.1]], None, [{}], n_steps=5)[0, :, :, 0]
    np.testing.assert_array_equal(np.isnan(states[0]), [False] * 4 + [True] * 2)
    assert np.isfinite(states[1]).all()
    with pytest.raises(RuntimeError, match="episode 0 diverged at step 4 of 5"):
        growing.rollout([[1.0], [0.1]], n_steps=5)


def test_one_shot_simulation_has_no_state():
    shot = FunctionSimulator(lambda X: X**2, input_names=("z",), output_names=("x",))
    assert {effect.name for effect in shot.effects()} == {"bias[x]", "scale[x]"}
    np.testing.assert_allclose(shot.predict([[3.0]], effects={"scale[x]": 2.0, "bias[x]": 1.0}), [[19.0]])
    with pytest.raises(ValueError, match="one-shot"):
        shot.rollout([[1.0]], n_steps=1)
    with pytest.raises(ValueError, match="one-shot"):
        shot.displace([[1.0]], [[1.0]])


def test_names_must_fit_together():
    with pytest.raises(ValueError, match="first inputs and the outputs must be the state"):
        FunctionSimulator(swing, input_names=("u", *STATE), output_names=STATE, state_names=STATE)
    with pytest.raises(ValueError, match="a occurs more than once"):
        FunctionSimulator(swing, input_names=("a", "a"), output_names=("b",))


def test_units_are_those_of_sensor_effects_and_bound_the_bias_of_an_angle():
    units = {"angle": "rad", "rate": "rad/s"}
    pendulum = FunctionSimulator(
        swing,
        input_names=(*STATE, "torque"),
        output_names=STATE,
        state_names=STATE,
        effects=EFFECTS,
        units=units,
    )
    effects = {effect.name: effect for effect in clone(pendulum).effects()}
    assert (effects["bias[angle]"].unit, effects["bias[rate]"].unit) == ("rad", "rad/s")
    assert effects["bias[angle]"].bounds == (-np.pi, np.pi)
    assert effects["bias[rate]"].bounds[1] > 100
    assert pendulum.angle_names == STATE
    with pytest.raises(
        ValueError, match=r"units has names that no column bears: angel; the columns are angle, rate"
    ):
        pendulum.set_params(units={"angel": "rad"})


def test_representation_names_the_function_and_the_effects(pendulum):
    assert repr(pendulum) == "FunctionSimulator(swing, effects=[gravity, damping[joint]])"
    assert repr(pendulum.extended({"gravity": 1.5})).endswith("built_in={'gravity': 1.5})")


def test_function_of_the_wrong_shape_is_named():
    wrong = FunctionSimulator(lambda X: X[:, 0], input_names=("a",), output_names=("b",))
    with pytest.raises(
        ValueError, match=r"must return the shape .* \(2, 1\), with the columns b; it returned \(2,\)"
    ):
        wrong.predict([[1.0], [2.0]])


@pytest.mark.parametrize("n_steps", [0, -1, 1.5, True])
def test_number_of_steps_is_checked(pendulum, n_steps):
    with pytest.raises(ValueError, match="n_steps must be a positive whole number"):
        pendulum.rollout([[0.0, 0.0]], n_steps=n_steps)


def test_a_delay_that_the_function_has_itself_acts_once():
    own = Effect("delay[u]", unit="s", neutral=0.0, bounds=(0.0, 0.3))
    simulator = FunctionSimulator(
        lambda X, **values: X[:, :1] + X[:, 1:] + values["delay[u]"],
        input_names=("x", "u"),
        output_names=("x",),
        state_names=("x",),
        effects=[own],
        dt=0.1,
    )
    rows = np.c_[np.zeros(5), np.arange(5.0)]
    found = simulator.predict(rows, effects={"delay[u]": 0.1})
    np.testing.assert_array_equal(found[:, 0], rows[:, 1] + 0.1)
    assert simulator.n_lags({"delay[u]": 0.1}) == 0


def test_actions_of_another_shape_are_refused(pendulum):
    with pytest.raises(ValueError, match=r"\(1, 3, 1\), with the columns torque; got \(1, 2, 1\)"):
        pendulum.rollout([[0.0, 0.0]], np.zeros((1, 2, 1)), n_steps=3)


def spring(X, **values):
    place, speed, push = X.T
    return np.stack([place + 0.1 * speed, speed + 0.1 * (push - 4.0 * values["stiffness"] * place)], axis=1)


@pytest.fixture
def oscillator():
    stiffness = Effect("stiffness", unit="1", neutral=1.0, bounds=(-2.0, 4.0))
    names = ("place", "speed")
    return FunctionSimulator(
        spring,
        input_names=(*names, "push"),
        output_names=names,
        state_names=names,
        effects=[stiffness],
        dt=0.1,
        units={"place": "deg"},
    )


def late_readings(truth, lag, dt):
    """Return what a filter of first order reads of a truth that goes straight from row to row, steady before."""
    read = [truth[0] - lag * (truth[1] - truth[0]) / dt]
    for start, end in pairwise(truth):
        slope, left = (end - start) / dt, np.exp(-dt / lag)
        read.append(end - lag * slope + (read[-1] - start + lag * slope) * left)
    return np.array(read)


@pytest.mark.parametrize("lag", [0.03, 0.1, 0.5])
def test_a_late_sensor_is_a_filter_in_rollouts_and_along_the_rows_of_a_log(oscillator, lag):
    pushes = np.random.default_rng(0).normal(size=(1, 40, 1))
    truth = oscillator.rollout([[0.2, 1.0]], pushes, n_steps=40)[0]
    read = np.column_stack([late_readings(truth[:, 0], lag, 0.1), truth[:, 1]])
    values = {"lag[place]": lag}
    assert oscillator.extended(values).hidden_state_names == ("ahead.place",)
    rows = np.column_stack([read[:-1], pushes[0]])
    np.testing.assert_allclose(oscillator.predict(rows, effects=values), read[1:], atol=1e-12)
    found = oscillator.rollout(read[:1], pushes, n_steps=40, effects=values)[0]
    np.testing.assert_allclose(found, read, atol=1e-12)
    # The same from the middle of a log, and of two episodes that are told apart by their groups.
    before = oscillator.rollout_many(
        read[15:16], pushes[:, 15:], [values, {}], n_steps=25, before=rows[None, :15]
    )
    np.testing.assert_allclose(before[0, 0], read[15:], atol=1e-12)
    assert np.abs(before[1, 0] - read[15:]).max() > 1e-3
    twice = oscillator.predict_many(np.vstack([rows, rows]), [{}, values], groups=np.repeat(["b", "a"], 40))
    np.testing.assert_allclose(twice[1], np.vstack([read[1:], read[1:]]), atol=1e-12)
    np.testing.assert_allclose(twice[0], np.vstack([oscillator.predict(rows)] * 2), atol=1e-14)


def test_a_late_sensor_reads_with_its_scale_and_bias(oscillator):
    pushes = np.random.default_rng(0).normal(size=(1, 20, 1))
    plain = oscillator.rollout([[0.2, 1.0]], pushes, n_steps=20, effects={"lag[place]": 0.2})[0]
    values = {"lag[place]": 0.2, "scale[place]": 2.0, "bias[place]": -1.0}
    found = oscillator.rollout([[-0.6, 1.0]], pushes, n_steps=20, effects=values)[0]
    np.testing.assert_allclose(found, plain * [2.0, 1.0] - [1.0, 0.0], atol=1e-12)


def test_bounds_of_factors_that_turn_the_sign_are_those_of_the_total(oscillator):
    def bounds(built_in):
        effects = oscillator.extended({"stiffness": built_in}).effects()
        return next(effect.bounds for effect in effects if effect.name == "stiffness")

    assert bounds(2.0) == (-1.0, 2.0)
    assert bounds(-0.5) == (-8.0, 4.0)
    assert bounds(-2.0) == (-2.0, 1.0)
    assert bounds(4.0) == (-0.5, 1.0)
    assert bounds(0.0) == bounds(1.0) == (-2.0, 4.0)
    zero = oscillator.extended({"stiffness": 0.0})
    np.testing.assert_array_equal(zero.predict([[1.0, 0.0, 0.0]], effects={"stiffness": 3.0}), [[1.0, 0.0]])


def test_a_bias_is_up_to_half_a_turn_in_any_unit_and_lags_are_listed_when_asked_for(oscillator):
    plain, late = ({effect.name: effect for effect in oscillator.effects(also=also)} for also in ((), "all"))
    assert plain["bias[place]"].bounds == (-180.0, 180.0)
    assert plain["bias[speed]"].bounds[1] == -plain["bias[speed]"].bounds[0] >= 1e12
    assert plain["scale[place]"].bounds == pytest.approx((0.1, 1 / 0.1))
    asked = {name for name in late if name not in plain}
    assert {"lag[place]", "lag[speed]"} <= asked
    assert {effect.name for effect in oscillator.effects(also=["lag[speed]"])} == {*plain, "lag[speed]"}
    assert oscillator.effects(also="lag") == oscillator.effects(also=["lag"])
    by_family = {effect.name for effect in oscillator.effects(also="lag")} - {*plain}
    assert by_family == {name for name in asked if name.startswith("lag[")}
    assert late["lag[place]"].typical == oscillator.dt == oscillator.time_step
    assert late["lag[place]"].bounds[0] == late["lag[place]"].neutral == 0.0
    assert oscillator.n_lags() == 0
    assert oscillator.command_limits == {}
    assert oscillator.joint_forces() == ()
    assert oscillator.angle_names == ()


@pytest.mark.parametrize(("n_bad", "end"), [(5, r"0, 1, 2, 3, 4\)"), (6, r"0, 1, 2, 3, 4, \.\.\.\)")])
def test_at_most_five_diverged_rows_are_named(n_bad, end):
    broken = FunctionSimulator(lambda X: X * np.inf, input_names=("a",), output_names=("b",), effects=())
    with pytest.raises(RuntimeError, match=rf"diverged in {n_bad} of {n_bad} rows \(row {end}"):
        broken.predict(np.ones((n_bad, 1)))


def test_no_rows_and_no_candidates_have_outputs_of_their_shape(oscillator):
    assert oscillator.predict_many(np.ones((4, 3)), []).shape == (0, 4, 2)
    assert oscillator.predict_many(np.ones((0, 3)), [{}]).shape == (1, 0, 2)


def test_the_first_bad_action_is_located(oscillator):
    actions = np.zeros((3, 4, 1))
    actions[1, 2, 0] = actions[2, 0, 0] = np.nan
    with pytest.raises(ValueError, match="episode 1, step 2, push"):
        oscillator.rollout(np.zeros((3, 2)), actions, n_steps=4)
    moved = oscillator.displace(np.zeros((1, 3)), np.ones((5, 2)))
    np.testing.assert_array_equal(moved, np.tile([1.0, 1.0, 0.0], (5, 1)))


@pytest.mark.parametrize(
    "values", [{"delay[push]": 0.25}, {"lag[push]": 0.3}, {"delay[action]": 0.12, "lag[place]": 0.2}]
)
def test_what_came_before_is_on_the_way_when_an_episode_goes_on(oscillator, values):
    pushes = np.random.default_rng(3).normal(size=(2, 20, 1))
    whole = oscillator.rollout([[0.2, 1.0], [-0.4, 0.3]], pushes, n_steps=20, effects=values)
    before = np.concatenate([whole[:, :12], pushes[:, :12]], axis=2)
    parts = oscillator.rollout_many(whole[:, 12], pushes[:, 12:], [{}, values], n_steps=8, before=before)
    np.testing.assert_allclose(parts[1], whole[:, 12:], atol=1e-12)
    forgetful = oscillator.rollout_many(whole[:, 12], pushes[:, 12:], [values], n_steps=8)[0]
    assert np.abs(forgetful - whole[:, 12:]).max() > 1e-3
    np.testing.assert_allclose(
        parts[0], oscillator.rollout(whole[:, 12], pushes[:, 12:], n_steps=8), atol=1e-14
    )


def test_a_candidate_that_diverges_leaves_the_others_to_go_on():
    growing = FunctionSimulator(
        lambda X, growth: np.where(X > 4, np.inf, growth * X),
        **dict.fromkeys(("input_names", "output_names", "state_names"), ("a",)),
        effects=[Effect("growth", unit="1", neutral=1.0, bounds=(0.1, 3.0))],
    )
    found = growing.rollout_many([[1.0], [0.1]], None, [{"growth": 2.0}, {}], n_steps=5)[..., 0]
    np.testing.assert_array_equal(np.isnan(found[0, 0]), [False] * 4 + [True] * 2)
    np.testing.assert_allclose(found[0, 1], 0.1 * 2.0 ** np.arange(6))
    np.testing.assert_allclose(found[1], [[1.0] * 6, [0.1] * 6])
    with pytest.raises(
        RuntimeError, match=r"diverged in 1 of 2 rows \(row 1\) with effects \{'growth': 2.0\}"
    ):
        growing.predict([[1.0], [5.0]], effects={"growth": 2.0})
