"""Effects of wheels and tendons against plain MuJoCo with the same change made by hand in the MJCF."""

import numpy as np
import pytest

from skat.simulators import MujocoSimulator
from tests.machines import FINGER, ROLLER, changed, plain

FINGER_CASES = {
    "tendon_damping[flexor]": (-1.5, [('damping="2"', 'damping="0.5"')]),
    "tendon_dry_friction[flexor]": (1.5, [('damping="2"', 'damping="2" frictionloss="1.5"')]),
    "tendon_stiffness[flexor]": (40.0, [('damping="2"', 'damping="2" stiffness="40"')]),
    "tendon_damping[band]": (0.5, [('stiffness="30"', 'stiffness="30" damping=".5"')]),
    "tendon_dry_friction[band]": (0.3, [('stiffness="30"', 'stiffness="30" frictionloss=".3"')]),
    "tendon_stiffness[band]": (-12.0, [('stiffness="30"', 'stiffness="18"')]),
}


@pytest.mark.parametrize("name", FINGER_CASES)
def test_effect_on_a_tendon_is_the_change_made_by_hand(name):
    value, changes = FINGER_CASES[name]
    rows = np.random.default_rng(2).normal(size=(12, 6)) * [1, 1, 3, 3, 1, 1]
    simulator = MujocoSimulator(FINGER, frame_skip=4)
    listed = {effect.name for effect in simulator.effects() if effect.family.startswith("tendon_")}
    assert listed == set(FINGER_CASES)  # what the tendon of one joint does is this joint's
    found = simulator.predict(rows, effects={name: value})
    np.testing.assert_allclose(found, plain(changed(FINGER, *changes), rows, 4), rtol=1e-9, atol=1e-9)
    assert np.abs(found - simulator.predict(rows)).max() > 1e-4


def test_tendon_through_the_axis_of_its_joint_has_bounds_of_where_it_pulls():
    text = """<mujoco><worldbody><site name="above" pos="0 0 1"/><site name="beside" pos="1 0 1"/><body>
    <joint name="h" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.5" size=".02" mass="1"/>
    <site name="tip" pos="0 0 -.5"/></body></worldbody><tendon>
    <spatial name="pulls"><site site="above"/><site site="tip"/></spatial>
    <spatial name="moves_nothing"><site site="above"/><site site="beside"/></spatial></tendon></mujoco>"""
    simulator = MujocoSimulator(text, frame_skip=5)
    tendons = [effect for effect in simulator.effects() if effect.family.startswith("tendon_")]
    assert [effect.target for effect in tendons] == ["pulls"] * 3
    for effect in tendons:
        found = simulator.predict([[1.0, 2.0]], effects={effect.name: 0.02 * effect.bounds[1]})
        assert np.abs(found).max() < 100


TYRE = '<geom name="tyre" type="cylinder" size=".1 .02" euler="90 0 0" mass=".4"/>'
SPOKE = '<geom name="spoke" type="box" size=".05 .01 .01" contype="0" conaffinity="0" mass=".1"/>'
TURNED, ALONG = 0.4 * (3 * 0.1**2 + 0.04**2) / 12, 0.4 * 0.1**2 / 2  # Moments of inertia of the tyre.


def radii(text):
    return [one.name for one in MujocoSimulator(text).effects() if one.family == "radius"]


def roller_rows():
    return np.random.default_rng(3).normal(size=(12, 7)) * [1, 0.01, 1, 1, 1, 9, 1]


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
@pytest.mark.parametrize("mode", ["", '<compiler inertiafromgeom="true"/>'])
@pytest.mark.parametrize(
    "rim", [TYRE, TYRE.replace('size=".1 .02" euler="90 0 0"', 'size=".1" fromto="0 -.02 0 0 .02 0"')]
)
def test_radius_is_that_of_a_wheel_whose_mass_and_inertia_stay(rim, mode, integrator):
    text = changed(ROLLER, ("<option", f'{mode}<option integrator="{integrator}"'), (TYRE, rim + SPOKE))
    simulator, rows = MujocoSimulator(text, frame_skip=5), roller_rows()
    assert radii(text) == ["radius[wheel]"]
    thin, broad = 0.1 / 3 * (0.01**2 + 0.01**2), 0.1 / 3 * (0.05**2 + 0.01**2)
    moments = f"{TURNED + thin!r} {ALONG + broad!r} {TURNED + broad!r}"
    inertial = f'<inertial pos="0 0 0" mass=".5" diaginertia="{moments}"/>'
    by_hand = changed(
        text,
        (mode, ""),
        ('size=".1', 'size=".105'),
        ('<body name="wheel">', f'<body name="wheel">{inertial}'),
    )
    by_hand = by_hand.replace('size=".105 .05 .02"', 'size=".1 .05 .02"')
    found = simulator.predict(rows, effects={"radius[wheel]": 1.05})
    np.testing.assert_allclose(found, plain(by_hand, rows, 5), rtol=1e-8, atol=1e-8)
    assert np.abs(found - simulator.predict(rows)).max() > 1e-3
    heavy = simulator.compiled({"radius[wheel]": 1.05, "mass[wheel]": 2.0}).body("wheel")
    np.testing.assert_allclose(heavy.mass, 1.0)


def test_radius_is_also_that_of_a_tyre_welded_to_its_hub_and_leaves_what_touches_nothing():
    drum = '<geom name="drum" type="cylinder" size=".03 .02" euler="90 0 0" contype="0" conaffinity="0" mass=".1"/>'
    text = changed(ROLLER, (TYRE, f'{drum}<body name="rubber"><frame>{TYRE}</frame></body>'))
    simulator, rows = MujocoSimulator(text, frame_skip=5), roller_rows()
    assert radii(text) == ["radius[wheel]"]
    inertial = f'<inertial pos="0 0 0" mass=".4" diaginertia="{TURNED!r} {ALONG!r} {TURNED!r}"/>'
    by_hand = changed(
        text, ('size=".1 .02"', 'size=".105 .02"'), ('name="rubber">', f'name="rubber">{inertial}')
    )
    found = simulator.predict(rows, effects={"radius[wheel]": 1.05})
    np.testing.assert_allclose(found, plain(by_hand, rows, 5), rtol=1e-8, atol=1e-8)


def test_radius_of_all_wheels_is_that_of_each():
    second = (
        '<body name="rear" pos="-.3 0 0"><joint name="trailing" axis="0 1 0"/>'
        + TYRE.replace("tyre", "rear")
        + "</body>"
    )
    text = changed(ROLLER, ('<body name="wheel">', second + '<body name="wheel">'))
    assert set(radii(text)) == {"radius[wheel]", "radius[rear]", "radius[all]"}
    rows = np.random.default_rng(3).normal(size=(12, 9)) * [1, 0.01, 1, 1, 1, 1, 9, 9, 1]
    simulator = MujocoSimulator(text, frame_skip=5)
    found, each = (
        simulator.predict(rows, effects=values)
        for values in ({"radius[all]": 1.05}, {"radius[wheel]": 1.05, "radius[rear]": 1.05})
    )
    np.testing.assert_allclose(found, each, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('axis="0 1 0"', 'axis="0 1 0" range="-90 90"'),
        ('axis="0 1 0"', 'axis="0 1 .1"'),
        ('axis="0 1 0"', 'axis="0 1 0" pos=".01 0 0"'),
        ('name="axle" axis="0 1 0"', 'name="axle" axis="0 1 0"/><joint axis="1 0 0"'),
        (TYRE, TYRE.replace("cylinder", "ellipsoid").replace(".1 .02", ".1 .1 .02")),
        (TYRE, TYRE + '<geom type="box" size=".05 .01 .15" mass=".1"/>'),
        (TYRE, TYRE.replace("name", 'contype="0" conaffinity="0" name')),
    ],
)
def test_what_does_not_roll_is_no_wheel(old, new):
    assert radii(ROLLER) == ["radius[wheel]"]
    assert radii(changed(ROLLER, (old, new))) == []


@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_radius_is_also_that_of_a_geom_fitted_to_a_mesh(kind):
    vertices = " ".join(f"{x} {y} {z}" for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.3, 0.3))
    mesh = f'<asset><mesh name="drum" vertex="{vertices}"/></asset><worldbody>'
    fitted = f'<geom name="tyre" type="{kind}" mesh="drum" euler="90 0 0" mass=".4"/>'
    text = changed(ROLLER, ("<worldbody>", mesh), (TYRE, fitted))
    simulator = MujocoSimulator(text)
    assert radii(text) == ["radius[wheel]"]
    before, after = (simulator.compiled(values) for values in ({}, {"radius[wheel]": 1.05}))
    np.testing.assert_allclose(after.geom("tyre").size[0], 1.05 * before.geom("tyre").size[0], rtol=1e-12)
    np.testing.assert_allclose(after.body("wheel").mass, before.body("wheel").mass, rtol=1e-12)
    np.testing.assert_allclose(after.body("wheel").inertia, before.body("wheel").inertia, rtol=1e-9)
