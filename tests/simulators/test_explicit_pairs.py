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
