"""A geared servo's friction, torque and command: against closed forms, BAM's laws, and integrations of their own."""

import json
import math
import os
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skat.simulators import MujocoSimulator, make_simulator
from skat.simulators.friction import NEUTRAL, budget
from tests.machines import SERVO_ARM, changed, without_limits

DATA = Path(os.environ.get("SKAT_DATA_HOME", "")) / "bam"
LAWS = sorted(path.name for path in DATA.glob("*.json")) if os.environ.get("SKAT_DATA_HOME") else []
# BAM's name of a coefficient -> ours.
NAMES = {
    "friction_stribeck": "stribeck",
    "dtheta_stribeck": "stribeck_speed",
    "alpha": "stribeck_exponent",
    "load_friction_base": "load_friction",
    "load_friction_stribeck": "load_stribeck",
    "load_friction_motor": "load_friction_motor",
    "load_friction_external": "load_friction_external",
    "load_friction_motor_stribeck": "load_stribeck_motor",
    "load_friction_external_stribeck": "load_stribeck_external",
    "load_friction_motor_quad": "load_square_motor",
    "load_friction_external_quad": "load_square_external",
}
WEIGHT, REACH, GRAVITY = 0.5, 0.15, 9.81
PENDULUM = f"""
<mujoco><option timestep="{{step}}" integrator="implicitfast"/><worldbody>
  <body><joint name="hinge" axis="0 -1 0" armature="{{armature}}" damping="{{damping}}" frictionloss="{{friction}}"/>
  <inertial pos="0 0 {-REACH}" mass="{WEIGHT}" diaginertia="1e-6 1e-6 1e-6"/></body></worldbody>
<actuator><motor name="m" joint="hinge"/></actuator></mujoco>
"""


# A body on a plane, by slides and a hinge that only say where it is, with a ball and two hinges.
WALKER = """
<mujoco><worldbody><body name="torso">
  <joint name="rootx" type="slide" axis="1 0 0"/><joint name="rootz" type="slide" axis="0 0 1"/>
  <joint name="rooty" axis="0 1 0"/><geom size=".1"/>
  <body><joint name="hip" axis="0 1 0"/><geom size=".05" pos="0 0 -.2"/>
    <body pos="0 0 -.2"><joint name="ankle" type="ball"/><geom size=".03" pos=".05 0 -.1"/></body></body>
  <body pos="0 0 .1"><joint name="neck" axis="0 1 0"/><geom size=".05" pos="0 0 .1"/></body>
</body></worldbody><actuator><motor name="hip" joint="hip"/></actuator></mujoco>
"""


def test_gears_are_where_joints_of_one_axis_are_and_not_where_a_body_is():
    names = [effect.name for effect in MujocoSimulator(WALKER).all_effects()]
    for family in (*NEUTRAL, "backlash"):
        there = {name for name in names if name.startswith(f"{family}[")}
        assert there <= {f"{family}[hip]", f"{family}[neck]"}, family
    assert {"stribeck[hip]", "stribeck[neck]", "load_friction[hip]", "backlash[hip]"} <= set(names)


@pytest.mark.parametrize("motors", [1, 2])
def test_what_is_late_of_one_motor_is_asked_apart_from_all_where_there_are_others(motors):
    more = '<motor name="neck" joint="neck"/></actuator>' if motors == 2 else "</actuator>"
    listed = {
        effect.name
        for effect in MujocoSimulator(WALKER.replace("</actuator>", more)).effects(also="all")
        if effect.family in ("delay", "lag") and not effect.name.startswith("lag[q")
    }
    alone = {"delay[action]", "lag[all]"}
    apart = {f"{family}[{motor}]" for family in ("delay", "lag") for motor in ("hip", "neck")}
    assert listed == (alone if motors == 1 else alone | apart)


def law_of(name):
    return json.loads((DATA / name).read_text())


def by_hand(p, speed, motor, external):
    """Return the budget of friction of laws M1 to M6, one term after another, without the viscous part."""
    slow = math.exp(-(abs(speed / p["dtheta_stribeck"]) ** p["alpha"])) if "alpha" in p else 0.0
    total = p["friction_base"] + slow * p.get("friction_stribeck", 0.0)
    load = abs(external - motor)
    total += p.get("load_friction_base", 0.0) * load + slow * p.get("load_friction_stribeck", 0.0) * load
    for end, weight in (("", 1.0), ("_stribeck", slow)):
        if f"load_friction_motor{end}" in p:
            ours = p[f"load_friction_external{end}"] * external - p[f"load_friction_motor{end}"] * motor
            total += weight * abs(ours)
    if "load_friction_motor_quad" in p and motor * external < 0:
        side, torque = ("motor", motor) if abs(motor) > abs(external) else ("external", external)
        total += slow * p[f"load_friction_{side}_quad"] * torque**2
    return total


def coefficients(p):
    return np.array(list((NEUTRAL | {NAMES[name]: p[name] for name in NAMES if name in p}).values()))


@pytest.mark.parametrize("name", LAWS)
def test_the_budget_is_that_of_every_published_law(name):
    p = law_of(name)
    for speed, motor, external in np.random.default_rng(0).normal(size=(50, 3)) * [3.0, 2.0, 2.0]:
        state = (np.array(one) for one in (0.0, speed, motor, external))
        ours = p["friction_base"] + float(budget(coefficients(p), *state))
        assert ours == pytest.approx(by_hand(p, speed, motor, external), rel=1e-12)


def bench(p, torque, start, seconds, samples):
    """Integrate a weight on a servo: sliding until its speed passes zero, at rest until the budget is exceeded."""
    inertia = p["armature"] + WEIGHT * REACH**2 + 1e-6

    def external(place):
        return -WEIGHT * GRAVITY * REACH * math.sin(place)

    def sliding(sign):
        def slope(t, s):
            motor, load = torque(t), external(s[0])
            brake = sign * by_hand(p, s[1], motor, load) + p["friction_viscous"] * s[1]
            return [s[1], (motor + load - brake) / inertia]

        return slope

    def stops(_, s):
        return s[1]

    def breaks(t, place):
        return abs(torque(t) + external(place)) - by_hand(p, 0.0, torque(t), external(place))

    now, place, speed, found = 0.0, *start, []
    times = np.linspace(0, seconds, samples)
    while now < seconds - 1e-12:
        if speed == 0.0:
            grid = np.arange(now, seconds + 1e-4, 1e-4)
            free = next((t for t in grid if breaks(t, place) > 0), None)
            end = seconds if free is None else min(free, seconds)
            found += [(t, place, 0.0) for t in times[(times >= now) & (times <= end)]]
            now = end
            if free is None or now >= seconds:
                break
            sign = math.copysign(1.0, torque(now) + external(place))
            speed = sign * 1e-12
        sign = math.copysign(1.0, speed)
        stops.terminal, stops.direction = True, -sign
        part = solve_ivp(
            sliding(sign), (now, seconds), [place, speed], events=stops, rtol=1e-9, atol=1e-11, max_step=0.01,
            dense_output=True,
        )  # fmt: skip
        inside = times[(times >= now) & (times <= part.t[-1])]
        found += [(t, *part.sol(t)) for t in inside]
        now, place = float(part.t[-1]), float(part.y[0, -1])
        speed = 0.0
    table = {round(t, 9): (a, b) for t, a, b in found}
    return np.array([table[round(t, 9)] for t in times])


@pytest.mark.parametrize("name", [name for name in LAWS if name.startswith("mx106")])
def test_a_bench_moves_as_an_integration_with_events_says(name):
    p = law_of(name)
    text = PENDULUM.format(
        step=0.0005, armature=p["armature"], damping=p["friction_viscous"], friction=p["friction_base"]
    )
    simulator = MujocoSimulator(text, frame_skip=20)
    values = {f"{NAMES[key]}[hinge]": p[key] for key in NAMES if key in p}
    rows = np.arange(100)
    controls = 0.9 * np.sin(2 * np.pi * 0.8 * 0.01 * rows)  # held for 10 ms each

    def torque(t):
        return float(controls[min(int(t / 0.01 + 1e-9), 99)])

    truth = bench(p, torque, (1.0, 0.0), 1.0, 101)
    assert np.ptp(truth[:, 0]) > 0.3
    found = simulator.rollout([[1.0, 0.0]], controls[None, :, None], n_steps=100, effects=values)[0]
    np.testing.assert_allclose(found[:, 0], truth[:, 0], atol=0.02 * np.ptp(truth[:, 0]))
    plain = simulator.rollout([[1.0, 0.0]], controls[None, :, None], n_steps=100)[0]
    if values:
        off = np.abs(found[:, 0] - truth[:, 0]).max()
        assert np.abs(plain[:, 0] - truth[:, 0]).max() > 5 * off


def test_friction_of_many_candidates_is_that_of_each_alone():
    simulator = MujocoSimulator(SERVO_ARM, frame_skip=3)
    rows = np.random.default_rng(0).normal(size=(40, 6))
    candidates = [
        {"load_friction[elbow]": 0.3},
        {"stribeck[elbow]": 0.5, "mass[lower]": 1.5},
        {"load_friction[shoulder]": 0.1, "gain[lift]": 0.8, "gravity": 0.9},
        {"stribeck[shoulder]": 0.7},
        {"air_drag[all]": 0.5, "load_friction[elbow]": 0.2},
        {"torque_speed[lift]": 5.0, "mass[lower]": 0.6},
        {"dead_zone[bend]": 0.1},
        {"mass[lower]": 1.5},
    ]
    groups = np.arange(40)
    together = simulator.predict_many(rows, candidates, groups=groups)
    for values, found in zip(candidates, together):
        np.testing.assert_array_equal(simulator.predict(rows, effects=values, groups=groups), found)
        plain = simulator.predict(rows, groups=groups)
        assert np.abs(found - plain).max() > 1e-6
    # A batch that ran with friction runs without it again.
    np.testing.assert_array_equal(simulator.predict_many(rows, candidates, groups=groups), together)


def test_candidates_whose_models_name_other_pairs_of_geoms_run_too():
    """A factor on one geom's contacts names its pairs, of which the model had none."""
    simulator = make_simulator("hopper")
    rows = np.zeros((4, len(simulator.input_names)))
    rows[:, 1] = 1.2
    base = {"stribeck[foot_joint]": 0.5, "air_drag[all]": 0.3}
    candidates = [base, base | {"contact_friction[foot_geom]": 1.5}, base | {"mass[torso]": 1.1}]
    for values, found in zip(candidates, simulator.predict_many(rows, candidates)):
        np.testing.assert_array_equal(simulator.predict(rows, effects=values), found)


def test_a_row_with_friction_of_zero_is_that_of_plain_mujoco():
    simulator = MujocoSimulator(SERVO_ARM, frame_skip=3)
    rows = np.random.default_rng(1).normal(size=(20, 6))
    groups = np.arange(20)
    # In a batch with renewed forces, whose size or law is nothing to these rows.
    plain = simulator.predict(rows, groups=groups)
    for name in (
        "stribeck[elbow]",
        "load_friction[elbow]",
        "torque_speed[lift]",
        "dead_zone[bend]",
        "lag_torque[lift]",
    ):
        tiny = simulator.predict(rows, effects={name: 1e-12}, groups=groups)
        np.testing.assert_allclose(tiny, plain, atol=1e-8)


def test_speed_takes_torque_as_a_motors_resistance_and_constant_do():
    """A motor at full voltage V: torque k (V - k w) / R, thus the speed w0 (1 - exp(-t k k / R J))."""
    k, resistance, volts, inertia = 1.2, 2.7, 7.4, 0.05
    stall, slope = k * volts / resistance, k * k / resistance
    text = f"""<mujoco><option timestep=".0005" gravity="0 0 0"/><worldbody><body>
      <joint name="j" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia=".01 {inertia} .045"/></body></worldbody>
      <actuator><motor name="m" joint="j" ctrlrange="-{stall} {stall}"/></actuator></mujoco>"""
    simulator = MujocoSimulator(text, frame_skip=10)
    found = simulator.rollout(
        [[0.0, 0.0]], np.full((1, 60, 1), stall), n_steps=60, effects={"torque_speed[m]": slope}
    )[0]
    times = 0.005 * np.arange(61)
    speed = stall / slope * (1 - np.exp(-times * slope / inertia))
    np.testing.assert_allclose(found[:, 1], speed, atol=0.003 * speed.max())
    braking = simulator.rollout(
        [[0.0, 1.0]], np.full((1, 5, 1), -stall / 2), n_steps=5, effects={"torque_speed[m]": slope}
    )
    plain = simulator.rollout([[0.0, 1.0]], np.full((1, 5, 1), -stall / 2), n_steps=5)
    np.testing.assert_allclose(braking, plain, atol=1e-9)  # half of the torque is there at this speed


def test_a_dead_zone_of_a_servo_is_one_of_its_error_and_of_a_motor_one_of_its_command():
    simulator = MujocoSimulator(SERVO_ARM, frame_skip=1)
    rows = np.array([[0.1, 0.0, 0.0, 0.0, 0.15, 0.0], [0.1, 0.0, 0.0, 0.0, 0.4, 0.0]])
    found = simulator.predict(rows, effects={"dead_zone[lift]": 0.1}, groups=[0, 1])
    as_if = rows.copy()
    as_if[:, 4] = [0.1, 0.3]
    np.testing.assert_allclose(found, simulator.predict(as_if, groups=[0, 1]), atol=1e-12)
    motor = MujocoSimulator(PENDULUM.format(step=0.001, armature=0.01, damping=0, friction=0))
    rows = np.array([[0.0, 0.0, 0.3], [0.0, 0.0, -0.05]])
    found = motor.predict(rows, effects={"dead_zone[m]": 0.1}, groups=[0, 1])
    np.testing.assert_allclose(
        found, motor.predict(rows * 0 + [[0, 0, 0.2], [0, 0, 0]], groups=[0, 1]), atol=1e-12
    )


def test_a_dead_zone_is_about_the_control_of_no_force():
    """With an offset, a servo acts as without one at a larger control; a factor on its force moves nothing."""
    simulator = MujocoSimulator(SERVO_ARM, frame_skip=3)
    rows = np.random.default_rng(0).normal(size=(20, 6)) * 0.1
    further = rows + np.array([0, 0, 0, 0, 0.2, 0])
    for also in ({}, {"gain[lift]": 1.3, "kp[lift]": 0.7, "lag_torque[lift]": 0.01}):
        values = {"dead_zone[lift]": 0.15} | also
        groups = np.arange(20)
        found = simulator.predict(rows, effects=values | {"offset[lift]": 0.2}, groups=groups)
        np.testing.assert_allclose(
            found, simulator.predict(further, effects=values, groups=groups), atol=1e-9
        )


@pytest.mark.parametrize(
    ("servo", "has_zone"),
    [
        ('<position name="m" joint="hinge" kp="10"/>', True),
        ('<position name="m" joint="hinge" kp="10" timeconst=".05"/>', False),
        ('<general name="m" joint="hinge" dyntype="filter" dynprm=".05"/>', True),
        ('<intvelocity name="m" joint="hinge" kp="10" actrange="-1 1"/>', True),
    ],
)
def test_a_servo_that_follows_what_a_filter_holds_has_no_dead_zone(servo, has_zone):
    motor = '<motor name="m" joint="hinge"/>'
    text = changed(PENDULUM.format(step=0.001, armature=0.01, damping=0, friction=0), (motor, servo))
    names = [effect.name for effect in MujocoSimulator(text).all_effects()]
    assert ("dead_zone[m]" in names) == has_zone


def test_what_comes_before_a_control_that_is_integrated_is_no_force(tmp_path):
    drive = '<intvelocity name="lift" joint="hinge" kp="30" actrange="-3 3" ctrlrange="-2 2"/>'
    simulator = MujocoSimulator(
        f"""<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="hinge" damping="1"/>
        <geom size=".1" pos=".2 0 0"/></body></worldbody><actuator>{drive}</actuator></mujoco>""",
        frame_skip=5,
    )
    effects = {effect.name: effect for effect in simulator.all_effects()}
    assert {effects[f"{name}lift]"].unit for name in ("dead_zone[", "bias[ctrl.")} == {"rad/s"}
    assert "offset[lift]" not in effects
    rows = np.array([[0.4, 0.0, command] for command in (0.0, 0.2, 1.0, -0.8)])
    values = {"dead_zone[lift]": 0.3, "scale[ctrl.lift]": 2.0, "bias[ctrl.lift]": 0.1}
    as_if = rows.copy()
    as_if[:, 2] = [0.0, 0.2, 1.7, -1.2]  # 2.1 is beyond the range
    found, groups = simulator.predict(rows, effects=values, groups=range(4)), range(4)
    np.testing.assert_allclose(found, simulator.predict(as_if, groups=groups), atol=1e-12)
    np.testing.assert_allclose(found[0], [0.4, 0.0], atol=1e-12)
    _, notes = simulator.extended(values).to_mjcf(tmp_path / "drive.xml")
    assert {one["name"] for one in json.loads(notes.read_text())["effects"]} == set(values)


def test_a_command_in_the_wrong_unit_is_a_scale_and_written_as_mjcf(tmp_path):
    simulator = MujocoSimulator(SERVO_ARM, frame_skip=2)
    rows = np.random.default_rng(0).normal(size=(10, 6))
    values = {"scale[ctrl.lift]": 0.5, "bias[ctrl.bend]": 0.2}
    as_if = rows.copy()
    as_if[:, 4:] = as_if[:, 4:] * [0.5, 1.0] + [0.0, 0.2]
    found = simulator.predict(rows, effects=values)
    np.testing.assert_allclose(found, simulator.predict(as_if), atol=1e-12)
    paths = simulator.extended(values).to_mjcf(tmp_path / "wrong_unit.xml")
    assert len(paths) == 1
    np.testing.assert_allclose(MujocoSimulator(paths[0], frame_skip=2).predict(rows), found, atol=1e-9)
    sentence = {effect.name: effect for effect in simulator.all_effects()}["scale[ctrl.lift]"].describe(57.3)
    assert sentence == "the scale of the command of lift is 57.3 times the model's"
    both = simulator.predict(rows, effects={"scale[qpos.elbow]": 1.1, "scale[ctrl.lift]": 0.5})
    assert np.abs(both - found).max() > 1e-3


def test_a_current_limit_is_a_limit_of_the_force():
    text = changed(SERVO_ARM, (' forcerange="-40 40"', ""))
    simulator = MujocoSimulator(text)
    effect = {one.name: one for one in simulator.effects(also="all")}["current_limit[lift]"]
    assert effect.neutral == effect.bounds[1] == 240.0
    assert effect.describe(40.0) == "the largest force of lift is 40 N m (the model has no limit)"
    limited = MujocoSimulator(SERVO_ARM)
    rows = np.random.default_rng(0).normal(size=(10, 6))
    found = simulator.predict(rows, effects={"current_limit[lift]": 40.0})
    np.testing.assert_allclose(found, limited.predict(rows), atol=1e-12)


def test_what_mjcf_cannot_hold_is_written_beside_it(tmp_path):
    values = {"load_friction[elbow]": 0.1, "stribeck[elbow]": 0.3, "torque_speed[lift]": 1.0, "lag_torque[bend]": 0.01,
              "dead_zone[lift]": 0.02, "payload[lower]": 0.4, "payload[lower.x]": 0.2}  # fmt: skip
    simulator = MujocoSimulator(SERVO_ARM).extended(values)
    _, beside = simulator.to_mjcf(tmp_path / "servo.xml")
    written = {one["name"]: one["value"] for one in json.loads(beside.read_text())["effects"]}
    assert written == {name: value for name, value in values.items() if not name.startswith("payload")}
    with pytest.warns(UserWarning, match="Build them"):
        again = MujocoSimulator(tmp_path / "servo.xml").extended(written)
    rows = np.random.default_rng(0).normal(size=(10, 6))
    np.testing.assert_allclose(again.predict(rows), simulator.predict(rows), atol=1e-9)


def read_again(simulator, path):
    """Return the simulator of what one wrote: the model, and beside it what MJCF cannot express."""
    simulator.to_mjcf(path, force=True)
    notes = path.with_suffix(".effects.json")
    effects = json.loads(notes.read_text())["effects"] if notes.exists() else []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        again = MujocoSimulator(path, frame_skip=simulator.frame_skip)
    return again.extended({one["name"]: one["value"] for one in effects})


SIZES = {
    "dead_zone[lift]": 0.1, "lag_torque[lift]": 0.01, "torque_speed[lift]": 2.0, "scale[ctrl.lift]": 1.4,
    "bias[ctrl.lift]": 0.2, "lag[lift]": 0.02, "lag[all]": 0.01, "delay[lift]": 0.009,
    "delay[action]": 0.003, "gain[lift]": 1.6, "kp[lift]": 0.7, "kv[lift]": 0.6, "offset[lift]": 0.1,
    "current_limit[lift]": 30.0, "dry_friction[elbow]": 0.2,
}  # fmt: skip


@pytest.mark.parametrize(
    "name", ["dead_zone[lift]", "lag_torque[lift]", "torque_speed[lift]", "scale[ctrl.bend]"]
)
def test_a_model_that_is_written_with_a_pair_of_effects_is_the_simulator_when_it_is_read(tmp_path, name):
    filtered = (
        '<general name="bend" joint="elbow" gainprm="8" dyntype="filter" dynprm=".02" actrange="-.5 .5" '
    )
    filtered += 'ctrlrange="-1 1"/>'
    servo = '<position name="bend" joint="elbow" kp="80" kv="4" ctrlrange="-2 2"/>'
    pairs = [{name: SIZES.get(name, 2.0), other: size} for other, size in SIZES.items() if other != name]
    pairs += [
        pairs[0] | {"lag[all]": 0.01, "lag[bend]": 0.015}
    ]  # a lag alone is written, and is nearly the same
    text = without_limits(SERVO_ARM)
    if name == "scale[ctrl.bend]":
        text = changed(text, (servo, filtered))
        pairs = [{name: factor, "bias[ctrl.bend]": 0.2} for factor in (2.0, -0.4)]
    simulator = MujocoSimulator(text, frame_skip=2)
    rows = np.random.default_rng(0).normal(size=(10, 6))
    for values in pairs:
        again = read_again(simulator.extended(values), tmp_path / "pair.xml")
        expected = simulator.predict(rows, effects=values)
        np.testing.assert_allclose(again.predict(rows), expected, atol=1e-8, err_msg=str(values))


def test_a_limit_that_comes_from_the_largest_control_grows_with_the_gain():
    simulator = MujocoSimulator(without_limits(SERVO_ARM), frame_skip=2)
    rows = np.random.default_rng(0).normal(size=(10, 6)) * 3
    found = simulator.predict(rows, effects={"gain[lift]": 2.0, "torque_speed[lift]": 3.0})
    limited = changed(
        SERVO_ARM,
        ('kp="120" kv="8"', 'kp="240" kv="16"'),
        ("-40 40", "-480 480"),
        (' forcerange="-30 30"', ""),
    )
    expected = MujocoSimulator(limited, frame_skip=2).predict(rows, effects={"torque_speed[lift]": 3.0})
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_a_payload_is_a_point_mass_at_its_place():
    place, mass = np.array([0.2, 0.01, -0.02]), 0.6
    simulator = MujocoSimulator(SERVO_ARM, frame_skip=2)
    values = {"payload[lower]": mass} | {f"payload[lower.{axis}]": at for axis, at in zip("xyz", place)}
    weight = f'<geom type="sphere" size="1e-3" mass="{mass}" pos="{place[0]} {place[1]} {place[2]}"/>'
    text = changed(SERVO_ARM, ('size=".02" mass=".7"/>', f'size=".02" mass=".7"/>{weight}'))
    rows = np.random.default_rng(0).normal(size=(10, 6))
    found = simulator.predict(rows, effects=values)
    np.testing.assert_allclose(found, MujocoSimulator(text, frame_skip=2).predict(rows), rtol=1e-4, atol=1e-5)
    model = simulator.compiled({"payload[lower]": mass})  # at the centre of mass, where nothing else is said
    assert model.body("lower").mass[0] == pytest.approx(0.7 + mass)
    np.testing.assert_allclose(model.body("lower").ipos, simulator.compiled().body("lower").ipos, atol=1e-12)
    np.testing.assert_array_equal(
        simulator.predict(rows, effects={"payload[lower.x]": 0.1}), simulator.predict(rows)
    )


@pytest.mark.parametrize("moved", [{"length[lower]": 1.5}, {"centre_of_mass[lower.x]": 0.05}])
def test_a_payload_without_a_place_is_at_the_centre_of_mass_that_the_body_has(moved):
    simulator = MujocoSimulator(SERVO_ARM)
    centre = simulator.compiled(moved).body("lower").ipos
    found = simulator.compiled(moved | {"payload[lower]": 0.6})
    np.testing.assert_allclose(found.body("lower").ipos, centre, atol=1e-12)
    along = simulator.compiled(moved | {"payload[lower]": 0.7, "payload[lower.x]": 0.2})
    np.testing.assert_allclose(along.body("lower").ipos, [(centre[0] + 0.2) / 2, *centre[1:]], atol=1e-12)


def test_places_of_a_payload_are_within_the_bodys_geoms():
    simulator = MujocoSimulator(SERVO_ARM)
    places = simulator.payload_places("lower")
    assert places.shape == (27, 3)
    np.testing.assert_allclose(
        [places.min(axis=0), places.max(axis=0)], [[-0.02, -0.02, -0.02], [0.27, 0.02, 0.02]]
    )
    with pytest.raises(ValueError, match=r"no payload can be on 'hand'; bodies: upper, lower"):
        simulator.payload_places("hand")
    model = simulator.compiled({"payload[lower]": 1.0, "payload[lower.x]": 0.25})
    assert isinstance(model, mujoco.MjModel)
