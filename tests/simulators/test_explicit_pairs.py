"""An explicit pair of two geoms is the contact that MuJoCo makes of them."""

import mujoco
import numpy as np
import pytest

from skat.simulators.contacts import contact_pairs, explicit_pair

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
