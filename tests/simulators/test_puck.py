"""The puck: strikes in, resting places out."""

import copy
import pickle

import numpy as np
import pytest
from sklearn.base import clone

from skat.simulators import make_simulator, stepping
from skat.simulators.puck import CONDITIONS, LOG_SPEED_PER_UNIT

RATIO = np.exp(2 * LOG_SPEED_PER_UNIT)  # of the squared speeds at z1 = 1 and z1 = 0


def strikes(n=12):
    return np.random.default_rng(0).uniform(-1, 1, size=(n, 2))


def test_columns():
    puck = make_simulator("puck")
    assert (puck.input_names, puck.output_names, puck.state_names) == (("z0", "z1"), ("x", "y"), ())
    assert puck.dt is None


def test_puck_rests_in_the_direction_of_the_sweep():
    puck, z = make_simulator("puck"), strikes()
    places = puck.predict(z)
    np.testing.assert_allclose(np.arctan2(places[:, 1], places[:, 0]), 0.4 * z[:, 0], atol=4e-3)


def test_distance_grows_with_the_squared_speed_over_the_friction():
    z = np.array([[0.0, 0.0], [0.0, 1.0]])
    nominal = make_simulator("puck").predict(z)[:, 0]
    slippery = make_simulator("puck").predict(z, effects={"contact_friction[slide]": 0.5})[:, 0]
    assert nominal[1] / nominal[0] == pytest.approx(RATIO, rel=0.05)
    np.testing.assert_allclose(slippery / nominal, 2, rtol=0.03)


def test_distance_is_that_of_the_speed_after_the_hit():
    # mass m, hit by a stick of mass M and speed V with restitution e: v = (1 + e) V M / (m + M)
    puck = make_simulator("puck")
    heavy, nominal = (
        puck.predict([[0.0, 0.0]], effects={"mass[puck]": factor})[0, 0] for factor in (2.0, 1.0)
    )
    assert heavy / nominal == pytest.approx(((1 + 0.165) / (1 + 0.33)) ** 2, rel=0.05)


def test_resting_place_is_smooth_in_the_strike():
    z = np.column_stack([np.full(60, 0.3), np.linspace(-1, 1, 60)])
    places = make_simulator("puck").predict(z)
    smooth = np.polynomial.Polynomial.fit(z[:, 1], places[:, 0], 6)
    assert np.std(places[:, 0] - smooth(z[:, 1])) < 0.0015  # of 0.77 m


def test_left_and_right_are_mirror_images():
    z, effects = strikes(), {"contact_anisotropy[slide]": 0.6}
    mirrored = make_simulator("puck").predict(z * [-1, 1], effects=effects)
    np.testing.assert_allclose(
        mirrored, make_simulator("puck").predict(z, effects=effects) * [1, -1], atol=5e-3
    )


def test_second_direction_of_the_anisotropy_is_x():
    puck = make_simulator("puck")
    along_x = puck.predict([[0.0, 0.0]], effects={"contact_anisotropy[slide]": 2.0})[0, 0]
    along_y = puck.predict([[np.pi / 0.8, 0.0]], effects={"contact_anisotropy[slide]": 2.0})[0, 1]
    nominal = puck.predict([[0.0, 0.0]])[0, 0]
    assert along_x / nominal == pytest.approx(0.5, rel=0.03)
    assert along_y / nominal == pytest.approx(1.0, rel=0.03)


def test_lower_friction_is_along_the_axis_named():
    z = strikes(40)
    low_x, low_y = (make_simulator("puck", condition=f"heavy_anisotr_low{axis}").predict(z) for axis in "xy")
    assert np.ptp(low_x[:, 0]) > np.ptp(low_y[:, 0])
    assert np.ptp(low_x[:, 1]) < np.ptp(low_y[:, 1])


@pytest.mark.parametrize("axis", [0, 1])
def test_tilt_and_wind_are_nearly_one_direction(axis):
    puck, z, name = make_simulator("puck"), strikes(), "xy"[axis]
    angle = 0.01
    tilted = puck.predict(z, effects={f"tilt[{name}]": angle}) - puck.predict(z)
    blown = puck.predict(z, effects={f"wind[{name}]": 0.165 * 9.81 * np.sin(angle)}) - puck.predict(z)
    cosine = np.sum(tilted * blown) / np.linalg.norm(tilted) / np.linalg.norm(blown)
    assert cosine > 0.99
    assert tilted[:, axis].mean() > 0.01


def test_every_effect_changes_something_and_every_bound_comes_to_rest():
    puck, z = make_simulator("puck"), strikes(6)
    nominal = puck.predict(z)
    for effect in puck.effects():
        ends = puck.predict_many(z, [{effect.name: bound} for bound in effect.bounds])
        assert np.isfinite(ends).all(), effect.name
        assert np.abs(ends - nominal).max() > 1e-3, effect.name


def test_rows_do_not_depend_on_other_rows_nor_on_chunks(monkeypatch):
    puck, z = make_simulator("puck"), strikes(9)
    candidates = [{}, {"wind[x]": 0.05}, {"air_drag[all]": 0.02}, {"mass[puck]": 2.0}]
    whole = puck.predict_many(z, candidates)
    monkeypatch.setattr(stepping, "CHUNK", 4)
    np.testing.assert_array_equal(puck.predict_many(z, candidates), whole)
    np.testing.assert_array_equal(puck.predict(z[5:7], effects=candidates[2]), whole[2, 5:7])


def test_conditions_are_eleven_and_differ():
    assert len(CONDITIONS) == 12
    z = strikes(4)
    places = {name: make_simulator("puck", condition=name).predict(z) for name in CONDITIONS}
    np.testing.assert_array_equal(places["isotr_med"], places["normal"])
    others = [places[name] for name in CONDITIONS if name != "normal"]
    for index, first in enumerate(others):
        assert all(np.abs(first - second).max() > 0.02 for second in others[:index])


def test_puck_pickles_copies_and_clones():
    puck, z = make_simulator("puck", condition="isotr_low_offc"), strikes(3)
    expected = puck.predict(z)
    for other in (pickle.loads(pickle.dumps(puck)), copy.deepcopy(puck), clone(puck)):
        np.testing.assert_array_equal(other.predict(z), expected)
