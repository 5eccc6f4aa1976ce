"""The velocity gain of servos against plain MuJoCo with the compiled model edited."""

import mujoco
import numpy as np
import pytest

from skat.simulators import MujocoSimulator
from tests.machines import FINGER, ROLLER, SERVO_ARM, changed, without_limits

N_STEPS = 5
DAMPING_RATIO = changed(SERVO_ARM, ('kv="4"', 'dampratio="1.2"'))
GRIPPER = changed(  # Its control is not a length, so that no part of its feedback is its gain.
    FINGER,
    (
        '<motor name="pull" tendon="flexor" gear="8" ctrlrange="-1 1"/>',
        '<general name="pull" tendon="flexor" biastype="affine" gainprm="4" biasprm="0 -100 -10" forcerange="-.4 .4"/>',
    ),
)
BACK_EMF = changed(
    ROLLER,
    (
        '<motor name="drive" joint="axle" gear=".5"',
        '<general name="drive" joint="axle" gear=".5" biastype="affine" biasprm="0 0 -.1" forcerange="-.8 .8"',
    ),
)
AMPLE_DAMPING = changed(SERVO_ARM, ('damping=".3"', 'damping="9"'))
BY_TENDON = changed(
    without_limits(FINGER),
    ('<position name="servo" joint="tip"', '<position name="servo" tendon="flexor" gear="3"'),
    ('kv=".002"', 'kv=".2"'),
)


def with_integrator(text, integrator):
    text = text.replace(' integrator="implicitfast"', "")
    return changed(text, ("<option", f'<option integrator="{integrator}"'))


def rows_of(simulator, n=20):
    return np.random.default_rng(0).normal(size=(n, len(simulator.input_names)))


def stepped(model, rows, n_steps=N_STEPS):
    """Step each row in plain MuJoCo, each from a new MjData."""
    found = []
    for row in rows:
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = np.split(row, [model.nq, model.nq + model.nv])
        mujoco.mj_step(model, data, n_steps)
        found.append(np.r_[data.qpos, data.qvel])
    return np.array(found)


def listed(text):
    return {one.target: one.bounds for one in MujocoSimulator(text).effects() if one.family == "kv"}


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize(
    ("text", "name"),
    [(SERVO_ARM, "bend"), (DAMPING_RATIO, "bend"), (FINGER, "servo"), (GRIPPER, "pull"), (BACK_EMF, "drive")],
)
@pytest.mark.parametrize("factor", [0.3, 1.4])
def test_velocity_gain_is_the_third_parameter_of_the_bias_and_nothing_else(
    text, name, factor, integrator, tmp_path
):
    text = with_integrator(text, integrator)
    simulator = MujocoSimulator(text, frame_skip=N_STEPS)
    model, rows = mujoco.MjModel.from_xml_string(text), rows_of(simulator)
    model.actuator(name).biasprm[2] *= factor
    expected = stepped(model, rows)
    found = simulator.predict(rows, effects={f"kv[{name}]": factor})
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    assert np.abs(found - simulator.predict(rows)).max() > 1e-6
    half = simulator.extended({f"kv[{name}]": np.sqrt(factor)})
    np.testing.assert_allclose(
        half.predict(rows, effects={f"kv[{name}]": np.sqrt(factor)}), expected, rtol=1e-9, atol=1e-9
    )
    (path,) = simulator.extended({f"kv[{name}]": factor}).to_mjcf(tmp_path / "written.xml")
    written = mujoco.MjModel.from_xml_path(str(path))
    np.testing.assert_allclose(stepped(written, rows), expected, rtol=1e-9, atol=1e-9)


def test_velocity_gain_of_all_servos_is_that_of_each():
    simulator = MujocoSimulator(SERVO_ARM, frame_skip=N_STEPS)
    rows = rows_of(simulator)
    found, each = (
        simulator.predict(rows, effects=values)
        for values in ({"kv[all]": 1.3}, {"kv[lift]": 1.3, "kv[bend]": 1.3})
    )
    np.testing.assert_allclose(found, each, rtol=1e-12, atol=1e-12)


def test_less_kp_and_more_gain_is_more_velocity_gain():
    simulator = MujocoSimulator(SERVO_ARM, frame_skip=N_STEPS)
    rows = rows_of(simulator)
    found, expected = (
        simulator.predict(rows, effects=values)
        for values in ({"gain[bend]": 1.5, "kp[bend]": 1 / 1.5}, {"kv[bend]": 1.5})
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("kp", "gain", "factor"),
    [
        (7.634834309038386, -1.7947683835248298, 1.8536530506227293),
        (13.914500452995451, -1.0068668382607, 1.479047501320403),
    ],
)
def test_inverted_servo_keeps_its_velocity_gain_whatever_its_position_gain(kp, gain, factor):
    """Rounded, position gain and gain of these are one number, by which MuJoCo tells a damping ratio."""
    simulator = MujocoSimulator(changed(SERVO_ARM, ('kp="80" kv="4"', f'kp="{kp!r}" kv="1"')))
    model = simulator.compiled({"gain[bend]": gain, "kp[bend]": factor, "kv[bend]": 1.5})
    np.testing.assert_allclose(model.actuator("bend").biasprm[2], -1.5 * gain, rtol=1e-12)


@pytest.mark.parametrize("integrator", ["implicitfast", "implicit", "RK4"])
@pytest.mark.parametrize(
    ("text", "kv", "damping"),
    [
        (without_limits(AMPLE_DAMPING), "kv[bend]", {"damping[elbow]": -0.3 * 4}),
        (BY_TENDON, "kv[servo]", {"tendon_damping[flexor]": -0.3 * 0.2 * 3**2}),
    ],
)
def test_velocity_gain_that_is_damping_is_accepted_but_not_listed(text, kv, damping, integrator):
    text = with_integrator(text, integrator)
    simulator = MujocoSimulator(text, frame_skip=N_STEPS)
    rows = rows_of(simulator)
    found, expected = (simulator.predict(rows, effects=values) for values in ({kv: 0.7}, damping))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    assert listed(text) == {}


@pytest.mark.parametrize(
    "changes",
    [
        [('gear="3"', 'gear="3" forcerange="-1 1"')],
        [('damping="2"', 'damping="2" actuatorfrcrange="-1 1"')],
        [('name="knuckle"', 'name="knuckle" actuatorfrcrange="-1 1"')],
    ],
)
def test_velocity_gain_of_a_tendons_servo_is_listed_where_a_limit_cuts_its_force(changes):
    assert list(listed(changed(BY_TENDON, *changes))) == ["servo"]


def test_velocity_gain_is_listed_where_damping_does_not_do_the_same():
    free = without_limits(AMPLE_DAMPING)
    both = {"lift", "bend", "all"}
    assert set(listed(AMPLE_DAMPING)) == both
    assert set(listed(with_integrator(free, "Euler"))) == both  # damping is implicit there, actuators are not
    assert set(listed(changed(free, ("<joint ", '<joint actuatorfrcrange="-40 40" ')))) == both
    assert listed(free) == {}
    assert listed(without_limits(SERVO_ARM)) == dict.fromkeys(both, (0.02, 1.0))  # no damping is that low
    assert listed(SERVO_ARM) == dict.fromkeys(both, (0.02, 20.0))


def test_a_limited_servo_may_be_so_soft_that_a_whole_turn_takes_its_whole_force():
    def lowest(text):
        return {one.target: one.bounds[0] for one in MujocoSimulator(text).effects() if one.family == "kp"}

    stiff = changed(SERVO_ARM, ('kp="80"', 'kp="8000"'))
    force = float(MujocoSimulator(stiff).compiled().actuator("bend").forcerange[1])
    assert MujocoSimulator(stiff).servo_limits["bend"] == force
    assert lowest(stiff)["bend"] == pytest.approx(force / (2 * np.pi * 8000))
    assert lowest(stiff)["all"] == 0.02  # of all servos what the least soft may be
    # Of one whose force has no limit nobody knows how soft it may be; nor does a limit hold a soft one.
    assert set(lowest(without_limits(stiff)).values()) == set(lowest(SERVO_ARM).values()) == {0.02}


def test_servos_without_velocity_feedback_of_their_own_have_no_velocity_gain():
    passive = '<general name="bend" joint="elbow" biastype="affine" gainprm="0" biasprm="0 0 -4" forcerange="-9 9"/>'
    bend = '<position name="bend" joint="elbow" kp="80" kv="4" ctrlrange="-2 2" forcerange="-30 30"/>'
    for other in (
        '<position name="bend" joint="elbow" kp="80" forcerange="-9 9"/>',
        '<velocity name="bend" joint="elbow" kv="4" forcerange="-9 9"/>',
        '<motor name="bend" joint="elbow" forcerange="-9 9"/>',
        passive,
    ):
        assert set(listed(changed(SERVO_ARM, (bend, other)))) == {"lift"}


def test_bounds_of_the_velocity_gain_stay_where_the_integrator_is_stable(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log of what diverges
    text = with_integrator(without_limits(SERVO_ARM), "Euler")
    simulator = MujocoSimulator(text, frame_skip=100)
    rows = rows_of(simulator)
    assert set(listed(text)) == {"lift", "bend", "all"}
    for target, (low, high) in listed(text).items():
        assert low < 1 < high < 20
        for bound in (low, high):
            assert np.abs(simulator.predict(rows, effects={f"kv[{target}]": bound})).max() < 100
    model = mujoco.MjModel.from_xml_string(text)
    model.actuator("bend").biasprm[2] *= 3 * listed(text)["bend"][1]
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    assert not np.abs(stepped(model, rows, 100)).max() < 1e6
