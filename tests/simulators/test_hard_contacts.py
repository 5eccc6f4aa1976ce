"""Effects where they meet what MuJoCo's compiler or its defaults would decide anew: contacts, frames, muscles."""

import mujoco
import numpy as np
import pytest

from skat.simulators import MujocoSimulator
from skat.simulators.contacts import flex_condims
from tests.machines import changed, plain

BALL = """<mujoco><option timestep="0.002" cone="elliptic"/><default><geom friction=".8"/></default>
<worldbody><geom name="floor" type="plane" size="5 5 .1" /><body name="ball" pos="0 0 .1"><freejoint/>
<geom name="ball" size=".1"/></body></worldbody></mujoco>"""
CLOTH = """<mujoco><option timestep="0.001"/><worldbody><geom name="floor" type="plane" size="5 5 .1" friction=".1"/>
<body name="far" pos="3 0 .2"><freejoint/><geom size=".1" friction=".1"/></body>
<flexcomp name="cloth" type="grid" count="3 3 1" spacing=".1 .1 .1" mass=".2" radius=".01" dim="2" pos="0 0 .0095">
<elasticity young="1e3" poisson=".1" thickness=".01" damping=".01"/>
<contact selfcollide="none" friction=".9" solref=".02 .8"/></flexcomp></worldbody></mujoco>"""
LUMP = """<mujoco><compiler fusestatic="false"/><option gravity="0 0 -1"/><worldbody><frame pos="0 .3 0" euler="0 0 30">
<body name="lump" pos="0 0 1" euler="5 6 7"><freejoint align="true"/><site name="hook" pos="0 0 .1"/>
<geom name="near" size=".1" pos=".2 0 0"/><frame pos="0 0 .2" euler="0 10 0">
<geom name="rod" type="capsule" size=".03" fromto="0 0 0 .1 .2 .3"/></frame></body></frame>
<body name="peer" pos="2 0 1"><freejoint/><geom size=".1"/></body></worldbody></mujoco>"""
INERTIAL = '<inertial pos=".1 .2 .3" mass="2" {}/><site name="hook"'
FULL, DIAGONAL = 'fullinertia="1 2 2.5 .1 .2 .3"', 'diaginertia="1 2 2.5" euler="10 20 30"'
PLATE = '<body name="plate" pos="0 .2 .1"><geom type="box" size=".1 .05 .02"/></body><site name="hook"'
MUSCLE = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body name="arm"><joint name="k" axis="0 1 0"
range="-50 50" damping=".1"/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="1"/></body></worldbody>
<actuator><general name="m" joint="k" dyntype="none" gaintype="muscle" biastype="muscle" ctrlrange="0 1"
gainprm=".75 1.05 -1 200 .5 1.6 1.5 1.3 1.2" biasprm=".75 1.05 -1 200 .5 1.6 1.5 1.3 1.2"/></actuator></mujoco>"""


def rolling_rows():
    heights = np.array([0.098, 0.0995, 0.101])
    rows = np.tile([0, 0, 0, 1, 0, 0, 0, 0.5, 0.2, -0.1, 1, 2, 3.0], (3, 1))
    rows[:, 2] = heights
    return rows


def near_rows(text, n=4):
    """Return rows about the model's own pose."""
    model, random = mujoco.MjModel.from_xml_string(text), np.random.default_rng(0)
    rows = np.zeros((n, model.nq + model.nv))
    for row in rows:
        row[: model.nq] = model.qpos0
        mujoco.mj_integratePos(model, row[: model.nq], 0.3 * random.normal(size=model.nv), 1.0)
        row[model.nq :] = 0.5 * random.normal(size=model.nv)
    return rows


@pytest.mark.parametrize(
    ("floor", "ball"),
    [
        ("", 'adhesion="50"'),
        ('adhesion="30"', 'adhesion="20"'),
        ('adhesion="30" priority="1"', 'adhesion="20"'),
    ],
)
def test_adhesion_stays_where_the_friction_of_one_contact_changes(floor, ball):
    text = changed(BALL, ('size="5 5 .1" ', f'size="5 5 .1" {floor}'), ('size=".1"/>', f'size=".1" {ball}/>'))
    found = MujocoSimulator(text, frame_skip=5).predict(
        rolling_rows(), effects={"contact_friction[ball]": 0.5}
    )
    np.testing.assert_allclose(
        found, plain(changed(text, ('".8"', '".4"')), rolling_rows(), 5), rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize(
    "default",
    [
        'solreffriction=".1 2"',
        'condim="1" margin=".1" gap=".2" solref=".3 .4" solimp=".5 .6 .1" adhesion="3"',
    ],
)
def test_default_of_pairs_is_not_heeded_where_one_contact_changes(default, tmp_path):
    text = changed(BALL, ("<default>", f"<default><pair {default}/>"))
    simulator = MujocoSimulator(text, frame_skip=5).extended({"contact_friction[ball]": 0.5})
    expected = plain(changed(text, ('".8"', '".4"')), rolling_rows(), 5)
    np.testing.assert_allclose(simulator.predict(rolling_rows()), expected, rtol=1e-9, atol=1e-9)
    simulator.to_mjcf(tmp_path / "ball.xml")
    written = plain((tmp_path / "ball.xml").read_text(), rolling_rows(), 5)
    np.testing.assert_allclose(written, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("effect", "changes"), [
    ("contact_friction[all]", [('friction=".1"', 'friction=".05"'), ('friction=".9"', 'friction=".45"')]),
    ("restitution[all]", [('friction=".1"', 'friction=".1" solref=".02 .5"'), ('".02 .8"', '".02 .4"')]),
])  # fmt: skip
def test_what_scales_all_contacts_scales_those_of_a_cloth(effect, changes):
    row = near_rows(CLOTH, 1)
    row[0, 7:34] = 0  # lying on the floor
    row[0, 34:40], row[0, 40:] = 0, np.tile([1, 0.5, -0.2], 9)
    simulator = MujocoSimulator(CLOTH, frame_skip=20)
    found = simulator.predict(row, effects={effect: 0.5})
    np.testing.assert_allclose(found, plain(changed(CLOTH, *changes), row, 20), rtol=1e-9, atol=1e-9)
    assert np.abs(found - simulator.predict(row)).max() > 1e-3


@pytest.mark.parametrize(("changes", "condims"), [
    ([], [3, 3]),
    ([('"none"', '"auto"')], [3, 3, 3]),
    ([('"none"', '"none" passive="true"'), ("<option ", '<option integrator="discrete" ')], [3]),
    ([('"none"', '"none" condim="1" priority="1"')], [1, 1]),
    ([('"none"', '"none" contype="2" conaffinity="2"')], []),
    ([("<option ", '<option><flag contact="disable"/></option><option ')], []),
])  # fmt: skip
def test_contacts_of_a_flex_are_those_that_mujoco_checks(changes, condims):
    model = mujoco.MjModel.from_xml_string(changed(CLOTH, *changes))
    assert sorted(flex_condims(model)) == condims


@pytest.mark.parametrize(
    "default", ['euler="10 20 30"', 'quat="1 1 0 0"', 'zaxis="1 2 3"', 'type="mesh" mesh="m"']
)
def test_ends_of_a_weld_are_placed_as_said_and_not_as_the_default_site(default, tmp_path):
    mesh = '<asset><mesh name="m" vertex="0 0 0 .5 0 0 0 .1 0 0 0 .1"/></asset>'
    weld = '<equality><weld body1="lump" body2="peer" anchor=".1 .2 .3"/></equality>'
    text = changed(
        LUMP,
        ("<worldbody>", f"<default><site {default}/></default>{mesh}<worldbody>"),
        ("</worldbody>", f"</worldbody>{weld}"),
        (' align="true"', ""),
    )
    expected = plain(text, near_rows(text), 5)
    simulator = MujocoSimulator(text, frame_skip=5)
    np.testing.assert_allclose(simulator.predict(near_rows(text)), expected, rtol=1e-9, atol=1e-9)
    simulator.to_mjcf(tmp_path / "welded.xml")
    written = (tmp_path / "welded.xml").read_text()
    np.testing.assert_allclose(plain(written, near_rows(text), 5), expected, rtol=1e-9, atol=1e-9)
    sites = [mujoco.MjModel.from_xml_string(one).site("hook").quat for one in (text, written)]
    np.testing.assert_allclose(*sites, atol=1e-12)


ALIGNED = {
    "by the joint": [],
    "by the compiler": [(' align="true"', ""), ("<compiler ", '<compiler alignfree="true" ')],
    "full inertia": [('<site name="hook"', INERTIAL.format(FULL))],
    "diagonal inertia": [('<site name="hook"', INERTIAL.format(DIAGONAL))],
    "inertia from geoms": [
        ('<site name="hook"', INERTIAL.format(FULL)), ("<compiler ", '<compiler inertiafromgeom="true" ')
    ],
    "bounds": [
        ('<site name="hook"', INERTIAL.format(FULL)),
        ("<compiler ", '<compiler boundmass="5" boundinertia="2.2" '),
    ],
    "fused": [('fusestatic="false"', 'fusestatic="true"'), ('<site name="hook"', PLATE)],
    "welded": [
        ("</worldbody>", '</worldbody><equality><weld body1="lump" body2="peer" anchor=".1 0 0"/></equality>')
    ],
}  # fmt: skip


@pytest.mark.parametrize("case", ALIGNED)
def test_frame_of_a_free_body_stays_where_the_compiler_aligns_it(case, tmp_path):
    text = changed(LUMP, *ALIGNED[case])
    rows = near_rows(text)
    aligned = mujoco.MjModel.from_xml_string(text)
    simulator = MujocoSimulator(text, frame_skip=5)
    np.testing.assert_allclose(simulator.predict(rows), plain(text, rows, 5), rtol=1e-9, atol=1e-9)
    for effect, value, factor in (("centre_of_mass[lump.x]", 0.05, 1.0), ("length[lump]", 1.3, 1.3)):
        moved = simulator.extended({effect: value})
        model = moved.compiled()
        np.testing.assert_allclose(model.qpos0, aligned.qpos0, atol=1e-9)
        for kind, name in ((model.geom, "near"), (model.geom, "rod"), (model.site, "hook")):
            before = getattr(aligned, kind.__name__)(name)
            np.testing.assert_allclose(kind(name).pos, factor * before.pos, atol=1e-9)
        moved.to_mjcf(tmp_path / "moved.xml", force=True)
        written = (tmp_path / "moved.xml").read_text()
        np.testing.assert_allclose(plain(written, rows, 5), moved.predict(rows), rtol=1e-9, atol=1e-9)


def test_centre_of_mass_of_an_aligned_body_moves_in_the_frame_that_its_position_means():
    aligned = mujoco.MjModel.from_xml_string(LUMP).body("lump")
    numbers = {name: " ".join(map(repr, map(float, getattr(aligned, name)))) for name in ("mass", "inertia")}
    text = f"""<mujoco><option gravity="0 0 -1"/><worldbody><body><freejoint/><inertial pos=".05 0 0"
    mass="{numbers["mass"]}" diaginertia="{numbers["inertia"]}"/></body>
    <body name="peer" pos="2 0 1"><freejoint/><geom size=".1"/></body></worldbody></mujoco>"""
    found = MujocoSimulator(LUMP, frame_skip=5).predict(
        near_rows(LUMP), effects={"centre_of_mass[lump.x]": 0.05}
    )
    np.testing.assert_allclose(found, plain(text, near_rows(LUMP), 5), rtol=1e-9, atol=1e-9)


def test_one_body_may_be_aligned_and_another_not(tmp_path):
    text = changed(
        LUMP, (' align="true"', ' align="false"'), ("<compiler ", '<compiler alignfree="true" '),
        ('<geom size=".1"/>', '<geom size=".1" pos=".1 0 0"/>'),
    )  # fmt: skip
    simulator, rows = MujocoSimulator(text, frame_skip=5), near_rows(text)
    np.testing.assert_allclose(simulator.predict(rows), plain(text, rows, 5), rtol=1e-9, atol=1e-9)
    simulator.to_mjcf(tmp_path / "same.xml")
    same = plain((tmp_path / "same.xml").read_text(), rows, 5)
    np.testing.assert_allclose(same, plain(text, rows, 5), rtol=1e-9, atol=1e-9)


def test_muscle_is_as_strong_on_a_heavier_arm():
    rows = np.array([[0.1, 0.2, 0.0], [-0.2, 0.1, 0.5], [0.0, 0.0, 1.0]])
    force = 200 / mujoco.MjModel.from_xml_string(MUSCLE).actuator_acc0[0]
    simulator = MujocoSimulator(MUSCLE, frame_skip=5)
    np.testing.assert_allclose(simulator.predict(rows), plain(MUSCLE, rows, 5), rtol=1e-9, atol=1e-9)
    lengths = simulator.compiled().actuator_lengthrange[0]
    text = changed(
        MUSCLE,
        ("1.05 -1 200", f"1.05 {force} 200"),
        ('mass="1"', 'mass="4"'),
        ('name="m"', f'name="m" lengthrange="{lengths[0]} {lengths[1]}"'),
    )
    found = simulator.predict(rows, effects={"mass[arm]": 4.0})
    np.testing.assert_allclose(found, plain(text, rows, 5), rtol=1e-9, atol=1e-9)


def test_lengths_between_which_a_muscle_works_are_those_of_the_given_model():
    sites = '<site name="wall" pos="-.2 0 .1"/>'
    text = changed(
        MUSCLE,
        ("<worldbody>", f"<worldbody>{sites}"),
        ("</body>", '<site name="skin" pos=".2 0 .05"/></body>'),
        (
            "</worldbody>",
            '</worldbody><tendon><spatial name="t"><site site="wall"/><site site="skin"/></spatial></tendon>',
        ),
        ('joint="k"', 'tendon="t"'),
    )
    simulator = MujocoSimulator(text)
    longer = simulator.compiled({"length[arm]": 1.2}).actuator_lengthrange
    np.testing.assert_array_equal(longer, mujoco.MjModel.from_xml_string(text).actuator_lengthrange)


def test_effects_of_all_contacts_are_listed_where_only_a_flex_can_touch():
    far = '<body name="far" pos="3 0 .2"><freejoint/><geom size=".1" friction=".1"/></body>'
    text = changed(CLOTH, (far, ""))
    names = {effect.name for effect in MujocoSimulator(text).effects()}
    assert {"contact_friction[all]", "restitution[all]"} <= names
    assert not any(name.startswith("contact_anisotropy") for name in names)
    slippery = changed(text, ('"none"', '"none" condim="1" priority="1"'))
    names = {effect.name for effect in MujocoSimulator(slippery).effects()}
    assert "restitution[all]" in names
    assert "contact_friction[all]" not in names
