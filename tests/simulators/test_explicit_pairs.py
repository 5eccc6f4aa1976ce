"""An explicit pair of two geoms is the contact that MuJoCo makes of them."""

import mujoco
import numpy as np
import pytest

from skat.simulators.contacts import (
    contact_pairs,
    explicit_pair,
    scale_all_damping_ratios,
    scale_all_friction,
    scale_damping_ratio,
    scale_friction,
    set_anisotropy,
)

MODEL = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1" {floor}/>
    <body pos="0 0 .09"><freejoint/><geom name="ball" size=".1" {ball}/></body>
  </worldbody>
</mujoco>"""
FLOOR, BALL = 'solref=".03 .7" friction=".4 .01 .001"', 'solref=".05 1.2" friction=".9 .002 .0003"'


def contact(model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    (one,) = data.contact
    return np.concatenate([one.solref, one.friction, one.solimp])


@pytest.mark.parametrize(
    ("floor", "ball"),
    [
        ("", ""),
        ('solmix="3"', ""),
        ('solmix="0"', 'solmix="0"'),  # nobody weighs: halves
        ('priority="1"', ""),
        ('priority="1" solmix="0"', ""),
    ],
)
def test_an_explicit_pair_is_the_contact_that_mujoco_infers(floor, ball):
    spec = mujoco.MjSpec.from_string(MODEL.format(floor=f"{floor} {FLOOR}", ball=f"{ball} {BALL}"))
    model = spec.compile()
    (pair,) = contact_pairs(model)
    inferred = contact(model)
    explicit_pair(spec, pair)
    np.testing.assert_allclose(contact(spec.compile()), inferred, rtol=1e-12)


def crowd(seed, flag=""):
    """Return spheres that are all in one place: on the world, on bodies in chains, welded or free, of few kinds."""
    random, bodies = np.random.default_rng(seed), []
    for body in range(7):
        geoms = "".join(
            f'<geom size=".1" contype="{random.integers(3)}" conaffinity="{random.integers(3)}" '
            f'condim="{random.choice([1, 3])}" priority="{random.integers(2)}"/>'
            for _ in range(random.integers(1, 3))
        )
        joint = random.choice(['<joint axis="1 0 0"/>', ""], p=[0.7, 0.3])
        inner = bodies.pop() if bodies and random.random() < 0.6 else ""
        bodies.append(f'<body name="b{body}">{joint}{geoms}{inner}</body>')
    first, second, third = random.choice(7, 3, replace=False)
    return f"""<mujoco><option>{flag}</option><worldbody><geom size=".1"/>{"".join(bodies)}</worldbody>
    <contact><exclude body1="b{first}" body2="b{second}"/><exclude body1="b{third}" body2="b{first}"/></contact>
    </mujoco>"""


@pytest.mark.parametrize("flag", ["", '<flag filterparent="disable"/>'])
@pytest.mark.parametrize("seed", range(6))
def test_pairs_are_those_that_mujoco_finds_where_all_geoms_overlap(seed, flag):
    model = mujoco.MjModel.from_xml_string(crowd(seed, flag))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    expected = {(*sorted(map(int, contact.geom)), contact.dim > 1) for contact in data.contact}
    found = [(pair.first, pair.second, pair.has_friction) for pair in contact_pairs(model)]
    assert len(found) == len(set(found)) > 3
    assert set(found) == expected


def test_pairs_that_a_model_names_come_first_and_once():
    named = '<contact><pair name="roll" geom1="floor" geom2="ball" condim="1"/></contact></mujoco>'
    text = MODEL.format(floor="", ball="").replace("</mujoco>", named)
    (pair,) = contact_pairs(mujoco.MjModel.from_xml_string(text))
    assert (pair.name, pair.is_explicit, pair.has_friction) == ("roll", True, False)
    (pair,) = contact_pairs(mujoco.MjModel.from_xml_string(text.replace('name="roll" ', "")))
    assert pair.name == "floor/ball"
    off = text.replace("<worldbody>", '<option><flag contact="disable"/></option><worldbody>')
    assert contact_pairs(mujoco.MjModel.from_xml_string(off)) == ()


TWO_BALLS = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1" friction=".4 .01 .001" solref=".03 .7" margin=".01"/>
    <body pos="0 0 .09"><freejoint/><geom name="left" size=".1" friction=".9 .002 .0003" margin=".02"/></body>
    <body pos="3 0 .09"><freejoint/><geom name="right" size=".1" friction=".9 .002 .0003"/></body>
  </worldbody>
  <contact><pair name="named" geom1="floor" geom2="right" friction=".5 .6 .02 .003 .004" solref=".04 .8"/></contact>
</mujoco>"""


@pytest.mark.parametrize(
    ("edit", "of", "factors"),
    [
        (scale_friction, "left", {"left": (0.5, 0.5, 1.0)}),
        (scale_friction, "named", {"named": (0.5, 0.5, 1.0)}),
        (scale_friction, "both", {"left": (0.5, 0.5, 1.0), "named": (0.5, 0.5, 1.0)}),
        (scale_all_friction, None, {"left": (0.5, 0.5, 1.0), "named": (0.5, 0.5, 1.0)}),
        (set_anisotropy, "left", {"left": (1.0, 0.5, 1.0)}),
        (set_anisotropy, "both", {"left": (1.0, 0.5, 1.0), "named": (1.0, 0.5, 1.0)}),
        (scale_damping_ratio, "named", {"named": (1.0, 1.0, 0.5)}),
        (scale_all_damping_ratios, None, {"left": (1.0, 1.0, 0.5), "named": (1.0, 1.0, 0.5)}),
    ],
)
def test_an_edit_changes_sliding_friction_or_damping_of_the_contacts_it_names(edit, of, factors):
    def contacts(model):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        return {("named" if model.geom("right").id in one.geom else "left"): one for one in data.contact}

    spec = mujoco.MjSpec.from_string(TWO_BALLS)
    before = spec.compile()
    names = {"left": ["floor/left"], "named": ["named"], "both": ["floor/left", "named"]}
    if of is None:
        edit(spec, 0.5)
    else:
        edit(tuple(pair for pair in contact_pairs(before) if pair.name in names[of]), spec, 0.5)
    nominal, found = contacts(before), contacts(spec.compile())
    assert nominal.keys() == found.keys() == {"left", "named"}
    for name, one in nominal.items():
        first, second, ratio = factors.get(name, (1.0, 1.0, 1.0))
        np.testing.assert_allclose(found[name].friction, one.friction * [first, second, 1, 1, 1], rtol=1e-12)
        np.testing.assert_allclose(found[name].solref, one.solref * [1, ratio], rtol=1e-12)
        np.testing.assert_allclose(found[name].solimp, one.solimp, rtol=1e-12)
        assert found[name].includemargin == pytest.approx(one.includemargin)
        assert found[name].dist == pytest.approx(one.dist)
