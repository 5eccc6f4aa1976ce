import ast
import inspect
from dataclasses import replace

import numpy as np
import pytest

from skat.datasets import _worlds, make_hidden_puck, make_real_puck
from skat.simulators import make_simulator

COMMANDS = np.array([[0.0, 0.0], [1.0, 0.5], [-1.0, 1.0], [0.5, -1.0]])


def shots(**differences):
    world = _worlds.PuckWorld(**{"noise": 0.0, **differences})
    return _worlds.shoot(world, COMMANDS, np.random.RandomState(0))


def test_worlds_share_no_code_with_what_is_tested():
    modules = {
        node.module if isinstance(node, ast.ImportFrom) else node.names[0].name
        for node in ast.walk(ast.parse(inspect.getsource(_worlds)))
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    assert modules == {"dataclasses", "math", "mujoco", "numpy"}


def test_a_world_that_hides_nothing_differs_from_the_simulator_by_its_time_step_alone():
    predicted = make_simulator("puck").predict(COMMANDS)
    step = make_simulator("puck").world.dt
    np.testing.assert_allclose(shots(time_step=step), predicted, atol=2e-5)
    assert 0 < np.abs(shots() - predicted).max() < 0.003


def test_a_puck_slides_as_far_as_friction_lets_it():
    """From its speed after the strike to rest, v^2 = 2 mu g d: half the friction, twice the distance."""
    ratio = np.linalg.norm(shots(friction_x=0.1, friction_y=0.1), axis=1) / np.linalg.norm(shots(), axis=1)
    np.testing.assert_allclose(ratio, 2, rtol=0.03)


def test_grain_shortens_the_way_along_its_axis_only():
    along_x, along_y = shots(friction_x=0.3)[0], shots(friction_y=0.3)[0]
    assert along_x[0] < 0.72 * shots()[0, 0]
    assert along_y[0] == pytest.approx(shots()[0, 0], rel=0.002)


@pytest.mark.parametrize(("slope", "axis"), [({"slope_x": 0.02}, 0), ({"slope_y": 0.02}, 1)])
def test_pucks_drift_down_the_slope(slope, axis):
    assert (shots(**slope)[:, axis] - shots()[:, axis] > 0.005).all()


def test_drag_and_mass_shorten_the_way_and_a_faster_stick_lengthens_it():
    way = np.linalg.norm(shots(), axis=1)
    assert (np.linalg.norm(shots(drag=0.02), axis=1) < 0.98 * way).all()
    assert (np.linalg.norm(shots(puck_mass=0.25), axis=1) < 0.95 * way).all()
    assert (np.linalg.norm(shots(stick_speed=1.1), axis=1) > 1.1 * way).all()


@pytest.mark.parametrize("effect", _worlds.HIDDEN)
def test_what_a_world_hides_is_what_its_truth_says(effect):
    world, truth, sentence = _worlds.HIDDEN[effect]
    step = make_simulator("puck").world.dt
    hidden = _worlds.shoot(replace(world, noise=0.0, time_step=step), COMMANDS, np.random.RandomState(0))
    # Sliding contacts chatter, so that two models of one world agree to a millimetre or two.
    np.testing.assert_allclose(make_simulator("puck").predict(COMMANDS, effects=truth), hidden, atol=2e-3)
    assert sentence.endswith(".")


def test_shots_follow_from_the_seed():
    first, again, other = (make_hidden_puck(4, random_state=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.target, again.target)
    assert not np.array_equal(first.target, other.target)


def test_the_hidden_effect_is_drawn():
    drawn = {make_hidden_puck(1, random_state=seed).truth_sentence for seed in range(20)}
    assert drawn == {sentence for _, truth, sentence in _worlds.HIDDEN.values() if truth}


@pytest.mark.parametrize("colour", ["blue", "red"])
def test_strikes_of_a_real_puck_scatter_by_five_centimetres(colour):
    places = make_real_puck(colour, np.zeros((75, 2)), random_state=0)
    np.testing.assert_allclose(places.std(axis=0, ddof=1), 0.05, rtol=0.2)


def test_unknown_names_list_those_that_exist():
    with pytest.raises(ValueError, match=r"no 'green' puck\. There are: blue, red"):
        make_real_puck("green", [[0.0, 0.0]])
    with pytest.raises(ValueError, match=r"no hidden effect 'magnet'\. There are: slope, .*nothing"):
        make_hidden_puck(effect="magnet")
    with pytest.raises(ValueError, match="3 columns; expected two"):
        make_real_puck("red", [[0.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match="n_shots=0"):
        make_hidden_puck(0)
