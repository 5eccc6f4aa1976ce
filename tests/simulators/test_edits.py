"""Edits of a spec against the numbers of a model that has the change in its text."""

from functools import partial

import mujoco
import numpy as np
import pytest

from skat.simulators import edits

LINK = """<mujoco><compiler angle="{angle}" inertiafromgeom="{mode}"/><option timestep=".004" gravity="1 2 -9"/>
<worldbody><body name="link" pos="1 0 0"><joint name="hinge" axis="0 1 0" {joint}/>{parts}</body></worldbody>
{rest}</mujoco>"""
SIZE = '<geom type="box" size=".1 .2 .3" pos=".1 0 0" mass="2"/>'


def spec_of(parts=SIZE, *, joint="", rest="", angle="radian", mode="auto"):
    return mujoco.MjSpec.from_string(LINK.format(parts=parts, joint=joint, rest=rest, angle=angle, mode=mode))


def edited(edit, *values, **text):
    """Return the compiled model after an edit."""
    spec = spec_of(**text)
    edit(spec, *values)
    return spec.compile()


def tensor(model, body="link"):
    """Return mass, centre of mass and the inertia about it along the axes of the body."""
    one, turn = model.body(body), np.zeros(9)
    mujoco.mju_quat2Mat(turn, one.iquat)
    axes = turn.reshape(3, 3)
    return float(one.mass[0]), one.ipos, axes @ np.diag(one.inertia) @ axes.T


INERTIALS = {
    "from geoms": SIZE,
    "from density": '<geom type="box" size=".1 .2 .3" pos=".1 0 0" density="80"/>',
    "diagonal": '<inertial pos=".1 .2 0" euler=".3 .4 .5" mass="2" diaginertia=".1 .2 .25"/>',
    "full": '<inertial pos=".1 .2 0" mass="2" fullinertia=".1 .2 .25 .01 .02 .03"/>',
}


@pytest.mark.parametrize("mode", ["auto", "true"])
@pytest.mark.parametrize("case", INERTIALS)
def test_a_payload_adds_its_moments_to_those_of_the_body(case, mode):
    parts, place = INERTIALS[case], np.array([0.3, -0.2, 0.4])
    mass, centre, inertia = tensor(spec_of(parts, mode=mode).compile())
    found = tensor(edited(partial(edits.add_payload, 1, place), 0.5, parts=parts, mode=mode))
    total = mass + 0.5
    middle = (mass * centre + 0.5 * place) / total
    assert found[0] == pytest.approx(total, rel=1e-12)
    np.testing.assert_allclose(found[1], middle, rtol=1e-9)
    for part, at in ((mass, centre), (0.5, place)):
        arm = at - middle
        inertia = inertia + part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    np.testing.assert_allclose(found[2], inertia, rtol=1e-9, atol=1e-12)
