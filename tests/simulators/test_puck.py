"""The puck: strikes in, resting places out."""

import copy
import pickle

import mujoco
import numpy as np
import pytest
from sklearn.base import clone

from skat.simulators import make_simulator, stepping
from skat.simulators.puck import CONDITIONS, LOG_SPEED_PER_UNIT, MODEL, PuckSimulator

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


def test_the_stick_starts_behind_the_puck_and_sweeps_in_its_direction():
    """0.4 rad and a quarter of a nat of speed per unit; edge to edge 1 cm apart; left is a quarter turn on."""
    z, off_centre = strikes(), 0.008
    states = PuckSimulator(off_centre=off_centre).initial_states(z, gain=1.5)
    angle, speed = 0.4 * z[:, 0], 1.5 * 1.2 * np.exp(0.25 * z[:, 1])
    behind = 0.0381 + 0.015 + 0.01
    expected = np.zeros((12, 12))
    expected[:, 4] = -behind * np.cos(angle) - off_centre * np.sin(angle)
    expected[:, 5] = -behind * np.sin(angle) + off_centre * np.cos(angle)
    expected[:, 10], expected[:, 11] = speed * np.cos(angle), speed * np.sin(angle)
    np.testing.assert_allclose(states, expected, atol=1e-12)
    np.testing.assert_allclose(PuckSimulator().initial_states(z)[:, 10:], expected[:, 10:] / 1.5)


# Friction along x and along y.
FRICTIONS = {
    "normal": (0.2, 0.2),
    "isotr_low": (0.1, 0.1),
    "isotr_lowmed": (0.16, 0.16),
    "isotr_med": (0.2, 0.2),
    "isotr_medhi": (0.27, 0.27),
    "isotr_high": (0.34, 0.34),
    "isotr_low_offc": (0.1, 0.1),
    "isotr_high_offc": (0.34, 0.34),
    "heavy_anisotr_lowx": (0.2 / 3**0.5, 0.2 * 3**0.5),
    "heavy_anisotr_lowy": (0.2 * 3**0.5, 0.2 / 3**0.5),
    "low_anisotr_lowx": (0.2 / 1.5**0.5, 0.2 * 1.5**0.5),
    "low_anisotr_lowy": (0.2 * 1.5**0.5, 0.2 / 1.5**0.5),
}


def test_conditions_are_the_frictions_of_the_table():
    world = PuckSimulator().world
    assert FRICTIONS.keys() == set(CONDITIONS)
    for condition, (along_x, along_y) in FRICTIONS.items():
        puck = make_simulator("puck", condition=condition)
        friction = world.compiled(puck.built_in).pair("slide").friction
        np.testing.assert_allclose(friction[:2], [along_y, along_x], rtol=1e-12)  # the first direction is y
        assert puck.off_centre == (0.008 if condition.endswith("offc") else 0.0)
        assert (puck.built_in is None) == (condition in ("normal", "isotr_med"))


def test_effects_are_bounded_so_that_the_puck_comes_to_rest():
    puck = make_simulator("puck")
    world = {effect.name: effect.bounds for effect in puck.world.all_effects()}
    expected = {name: (-0.08, 0.08) for name in ("tilt[x]", "tilt[y]")}
    expected |= {name: (-0.12, 0.12) for name in ("wind[x]", "wind[y]")}
    expected |= {"contact_friction[slide]": (0.2, 10.0), "contact_anisotropy[slide]": (0.2, 5.0)}
    expected |= {f"bias[{axis}]": (-2.0, 2.0) for axis in "xy"} | {
        f"scale[{axis}]": (0.1, 10.0) for axis in "xy"
    }
    expected |= {"gain[stick]": (0.2, 3.0)}
    own = ("mass[puck]", "air_drag[all]", "contact_friction[hit]", "restitution[hit]")
    assert {effect.name: effect.bounds for effect in puck.effects()} == expected | {
        name: world[name] for name in own
    }
    assert puck.units == {"x": "m", "y": "m"}
    assert {effect.unit for effect in puck.effects() if effect.family == "bias"} == {"m"}


def test_strikes_are_those_of_plain_mujoco_run_until_nothing_slides():
    puck, z = make_simulator("puck"), strikes(2)
    model = mujoco.MjModel.from_xml_string(MODEL)
    for strike, place in zip(puck.initial_states(z), puck.predict(z)):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = np.split(strike, 2)
        while max(np.hypot(*data.qvel[:2]), np.hypot(*data.qvel[4:])) >= 0.005:
            mujoco.mj_step(model, data, 50)
        np.testing.assert_allclose(place, data.qpos[:2], atol=1e-9)
        assert 0.1 < data.time < 15
