"""What moves in a model, how far, how heavy and how strong it is: by hand, and bounds of effects that follow."""

import mujoco
import numpy as np
import pytest

from skat.simulators import MujocoSimulator
from skat.simulators.anatomy import Anatomy, actuator_name, drag_joint, tendon_name

# A cart on a rail, with a rod on it, whose lower end carries a lighter one; all inertias are written.
CART = """
<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
<worldbody>
  <geom name="ground" type="plane" size="5 5 1"/>
  <body name="cart" pos="0 0 2"><joint name="rail" type="slide" axis="1 0 0"/>
    <inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>
    <body name="rod"><joint name="hinge" axis="0 1 0" damping="0.5" frictionloss="0.2" armature="0.04"
      stiffness="3"/>
      <inertial pos="0 0 -0.5" mass="1" diaginertia="0.02 0.02 0.001"/>
      <body name="tip" pos="0 0 -1"><joint name="wrist" axis="0 1 0"/>
        <inertial pos="0 0 -0.1" mass="0.1" diaginertia="0.0001 0.0001 0.0001"/></body>
    </body>
  </body>
</worldbody>
<tendon><fixed name="string"><joint joint="hinge" coef="0.3"/><joint joint="wrist" coef="-0.1"/></fixed></tendon>
<actuator>
  <motor name="push" joint="rail" gear="2" ctrlrange="-4 3" ctrllimited="true"/>
  <motor joint="hinge" gear="-3" forcerange="-5 1" forcelimited="true"/>
  <position joint="wrist" kp="7" kv="0.2"/>
  <motor name="pull" tendon="string" gear="2"/>
  <motor tendon="string"/>
</actuator></mujoco>
"""


@pytest.fixture(scope="module")
def cart():
    return Anatomy(mujoco.MjModel.from_xml_string(CART))


def compiled(bodies, head="", tail=""):
    return mujoco.MjModel.from_xml_string(f"<mujoco>{head}<worldbody>{bodies}</worldbody>{tail}</mujoco>")


def bounds(text, **parameters):
    simulator = MujocoSimulator(text, **parameters)
    return {effect.name: effect for effect in simulator.all_effects()}


def test_names_are_those_of_the_model_or_of_what_is_moved(cart):
    names = [actuator_name(cart.model, index) for index in range(5)]
    assert names == ["push", "hinge", "wrist", "pull", "actuator4"]
    assert tendon_name(cart.model, 0) == "string"
    twice = compiled(
        '<body name="a"><joint name="j"/><geom size="1"/></body>',
        tail='<actuator><motor joint="j"/><motor joint="j"/><motor name="actuator0" joint="j"/></actuator>',
    )
    assert [actuator_name(twice, index) for index in range(3)] == ["actuator0_", "actuator1", "actuator0"]


def test_what_moves_hangs_together(cart):
    assert [cart.body_name(body) for body in cart.moving] == ["cart", "rod", "tip"]
    assert cart.roots == [cart.root] == [1]
    assert cart.turned_by(3) == [2, 1]
    assert cart.turned_by(1) == []
    assert cart.joint_driven == [0, 1, 2]
    assert cart.actuated == {0, 1, 2}
    assert cart.drives == [[0], [1], [2]]
    assert cart.base_joints == set()
    assert [cart.dofs_of(joint) for joint in range(3)] == [[0], [1], [2]]


def test_reach_is_the_arm_of_the_turn(cart):
    np.testing.assert_allclose(cart.reach[1], [1, 0, 0])
    assert cart.reach[2][0] == 1.0  # along the rail; the hinge moves it half as far per radian
    assert 0 < cart.reach[2][2] <= 0.5
    assert cart.reach[2][1] == cart.reach[3][1] == 0


def test_capacity_is_the_largest_force_behind_the_gear(cart):
    assert [cart.capacity(index) for index in range(5)] == pytest.approx([8.0, 15.0, 7.0, 2.0, 1.0])


def test_force_is_that_of_gravity_or_of_the_drive_or_of_one_g(cart):
    assert cart.force[0] == pytest.approx(10 * 3.1)  # 1 g on all that the rail carries
    assert cart.force[1] == pytest.approx(15.0)
    assert cart.force[2] == pytest.approx(7.0)
    np.testing.assert_allclose(cart.inertia[0], 3.1)
    np.testing.assert_allclose(cart.inertia[1], 0.04 + 0.02 + 0.25 + 0.0001 + 0.1 * 1.1**2, rtol=1e-9)
    # The drive of the wrist is taken to be no weaker than a third of the strongest hinge's.
    assert cart.strength[2] == pytest.approx(max(7.0, 0.3 * 15.0))
    weak = Anatomy(mujoco.MjModel.from_xml_string(CART.replace('kp="7" kv="0.2"', 'kp="1" kv="0.2"')))
    assert weak.strength[2] == pytest.approx(0.3 * 15.0)
    assert weak.strength[0] == pytest.approx(31.0)


def test_a_tendon_moves_the_mass_that_its_joints_carry(cart):
    model, data = cart.model, mujoco.MjData(cart.model)
    slope, largest, lengths = np.array([0.0, 0.3, -0.1]), 0.0, []
    for pose in cart.poses:
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        matrix = np.zeros((3, 3))
        mujoco.mj_fullM(model, data, matrix)
        largest = max(largest, slope @ np.linalg.solve(matrix, slope))
        lengths.append(slope @ pose)
    mobility, ranges = cart.tendon_ranges
    np.testing.assert_allclose(mobility, largest, rtol=1e-6)
    np.testing.assert_allclose(ranges, np.ptp(lengths), rtol=1e-9)
    np.testing.assert_allclose(cart.actuator_mobility[[3, 4]], [4 * largest, largest], rtol=1e-6)
    assert cart.tendon_force(0) == pytest.approx(max(2.0, 10 / largest))


def test_a_tendon_without_a_motor_is_as_strong_as_1_g_on_what_it_moves():
    bodies = '<body><joint name="j" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="2 2 2"/></body>'
    tail = '<tendon><fixed><joint joint="j" coef="0.5"/></fixed></tendon>'
    anatomy = Anatomy(compiled(bodies, tail=tail))
    assert anatomy.tendon_force(0) == pytest.approx(10 * 2 / 0.5**2, rel=1e-6)


def test_explicit_damping_is_stable_up_to_the_inertia_per_time_step():
    explicit = CART.replace("implicitfast", "RK4")
    rate = Anatomy(mujoco.MjModel.from_xml_string(explicit)).stable_rate
    model = mujoco.MjModel.from_xml_string(CART)
    np.testing.assert_allclose(rate, 1 / (0.002 * model.dof_invweight0), rtol=1e-12)
    assert np.isinf(Anatomy(model).stable_rate).all()
    assert np.isinf(
        Anatomy(mujoco.MjModel.from_xml_string(CART.replace("implicitfast", "Euler"))).stable_rate
    ).all()
    told = CART.replace(
        'integrator="implicitfast"/>', 'integrator="Euler"><flag eulerdamp="disable"/></option>'
    )
    anatomy = Anatomy(mujoco.MjModel.from_xml_string(told))
    assert anatomy.damps_explicitly
    np.testing.assert_allclose(anatomy.stable_rate, rate, rtol=1e-12)
    assert anatomy.is_off("eulerdamp")
    assert not anatomy.is_off("gravity")


def test_a_box_holds_geoms_turned_and_shifted_and_is_never_flat():
    model = compiled(
        '<body name="a"><freejoint/><geom type="box" size="1 2 3" pos="10 0 0" euler="0 0 90"/>'
        '<geom type="sphere" size="0.5"/></body>'
        '<body name="b"><freejoint/><inertial pos="1 2 3" mass="2" diaginertia="4 4 4"/></body>'
        '<body name="c"><freejoint/><geom type="box" size="1 1 1e-5" mass="1"/></body>'
    )
    anatomy = Anatomy(model)
    low, high = anatomy.box(1)
    np.testing.assert_allclose([low, high], [[-0.5, -1, -3], [12, 1, 3]], atol=1e-9)
    low, high = anatomy.box(2)  # as wide as twice the radius of gyration about a line, on the average
    np.testing.assert_allclose((low + high) / 2, [1, 2, 3])
    np.testing.assert_allclose(high - low, np.sqrt(12 / 2))
    low, high = anatomy.box(3)
    np.testing.assert_allclose(high - low, [2, 2, 1e-3], atol=1e-9)


def test_a_floating_base_is_free_or_planar_and_carries_something():
    planar = (
        '<body name="torso"><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>'
        '<joint name="pitch" axis="0 1 0"/><geom size="0.1"/>{}</body>'
    )
    leg = '<body name="leg"><joint name="hip" axis="0 1 0"/><geom size="0.1" pos="0 0 -1"/></body>'
    assert Anatomy(compiled(planar.format(leg))).base_joints == {0, 1, 2}
    assert Anatomy(compiled(planar.format(""))).base_joints == set()
    driven = compiled(planar.format(leg), tail='<actuator><motor joint="x"/></actuator>')
    assert Anatomy(driven).base_joints == set()
    free = compiled(f'<body><freejoint/><geom size="1"/>{leg}</body>')
    assert Anatomy(free).base_joints == {0}
    assert Anatomy(free).turned_by(2) == [6, 3, 4, 5]
    two = compiled(
        f'{leg.replace("leg", "a").replace("hip", "b")}<body name="r"><freejoint/><geom size="1"/></body>'
    )
    assert Anatomy(two).root == 2
    ball = compiled('<body><joint type="ball"/><geom size="1" pos="1 0 0"/></body>')
    assert Anatomy(ball).turned_by(1) == [0, 1, 2]


@pytest.mark.parametrize(("axis", "along"), [("1 0 0", 0), ("0 2 0", 1), ("1 1 0", None)])
def test_drag_is_a_slides_where_one_slide_goes_along_it(axis, along):
    anatomy = Anatomy(compiled(f'<body><joint type="slide" axis="{axis}"/><geom size="1"/></body>'))
    for place in range(3):
        assert drag_joint(anatomy, place) == (0 if place == along else None)


def test_drag_of_what_turns_is_no_slides(cart):
    assert drag_joint(cart, 0) == 0
    turning = '<body><joint type="slide" axis="1 0 0"/><joint axis="0 1 0"/><geom size="1"/></body>'
    assert drag_joint(Anatomy(compiled(turning)), 0) is None
    crossed = (
        '<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="1 1 0"/><geom size="1"/></body>'
    )
    assert drag_joint(Anatomy(compiled(crossed)), 0) is None
    assert drag_joint(Anatomy(compiled(crossed)), 1) is None


# -- bounds ------------------------------------------------------------------------------------------------------------


def test_what_is_added_takes_off_all_that_the_model_has_and_no_more():
    found = bounds(CART, frame_skip=5)
    assert found["damping[hinge]"].bounds[0] == -0.5
    assert found["dry_friction[hinge]"].bounds[0] == -0.2
    assert found["stiffness[hinge]"].bounds[0] == -3
    assert -0.04 < found["armature[hinge]"].bounds[0] < -0.03  # a light link may not be stable without
    assert found["damping[wrist]"].bounds[0] == found["position_friction[hinge]"].bounds[0] == 0
    for name in ("damping[all]", "dry_friction[all]"):
        family = name.partition("[")[0]
        each = [found[f"{family}[{joint}]"].bounds for joint in ("rail", "hinge", "wrist")]
        assert found[name].bounds == (max(low for low, _ in each), min(high for _, high in each))
    assert found["damping[all]"].unit == "N s/m, N m s/rad"


def test_factors_may_be_as_much_too_small_as_too_large_and_signs_turn_round():
    text = CART.replace(
        '<inertial pos="0 0 -0.1" mass="0.1" diaginertia="0.0001 0.0001 0.0001"/>',
        '<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="0.1"/>',
    )
    found = bounds(text, frame_skip=5)
    for name in ("mass[tip]", "mass[all]", "inertia[tip]", "contact_anisotropy[ground, geom1]"):
        if name in found:
            low, high = found[name].bounds
            assert low * high == pytest.approx(1.0), name
    for effect in found.values():
        low, high = effect.bounds
        if effect.family in ("gain", "tilt", "wind", "centre_of_mass", "offset", "force") or (
            effect.target or ""
        ).startswith("ctrl."):
            assert low == -high, effect.name
        if effect.family in ("length", "kv", "kp", "force_limit"):
            assert 0 < low * high <= 1.0, effect.name
    assert found["gravity"].bounds[0] == 0.0
    assert found["tilt[x]"].bounds[1] < np.pi / 4
    assert found["timestep"].bounds == pytest.approx((0.01, 5.0))


def test_forces_have_bounds_and_sizes_of_the_weight_that_they_act_on():
    found = bounds(CART, frame_skip=5)
    weight = 10 * 3.1
    assert found["wind[x]"].bounds == pytest.approx((-2 * weight, 2 * weight))
    assert found["air_drag[x]"].bounds == pytest.approx((0.0, weight))
    assert found["wind[x]"].typical == found["air_drag[x]"].typical == pytest.approx(0.3 * weight)
    assert found["force[rail]"].bounds == pytest.approx((-10 * weight, 10 * weight))
    assert found["force[rail]"].typical == pytest.approx(0.3 * weight)
    assert (found["force[rail]"].unit, found["force[hinge]"].unit) == ("N", "N m")
    assert found["damping[hinge]"].typical == pytest.approx(0.3 * 15)  # at 1 rad/s
    assert found["armature[hinge]"].typical == pytest.approx(0.3 * 15 / 10)  # at 10 rad/s2
    assert found["dry_friction[all]"].typical == pytest.approx(0.3 * 7)


def test_times_have_bounds_and_sizes_in_transitions():
    found = bounds(CART, frame_skip=5)
    dt = 5 * 0.002
    for name in ("delay[action]", "delay[push]"):
        assert found[name].bounds == pytest.approx((0.0, 5 * dt))
        assert found[name].typical == pytest.approx(dt)
    assert found["lag[push]"].bounds == found["lag[all]"].bounds == found["lag_torque[wrist]"].bounds
    slow = bounds(CART, frame_skip=50)
    assert slow["lag[push]"].bounds == slow["delay[push]"].bounds == pytest.approx((0.0, 0.5))


def test_a_command_may_be_off_by_half_of_its_range():
    found = bounds(CART, frame_skip=5)
    assert found["bias[ctrl.push]"].bounds == (-3.5, 3.5)
    assert found["bias[ctrl.push]"].typical == pytest.approx(0.35)
    assert found["dead_zone[push]"].bounds == pytest.approx((0.0, 0.9 * 3.5))
    assert found["dead_zone[push]"].typical == pytest.approx(0.035)
    assert found["offset[wrist]"].unit == "rad"
    assert found["scale[ctrl.push]"].bounds[1] > 180 / np.pi  # degrees for radians
    narrow = bounds(CART.replace('kp="7"', 'kp="7" ctrlrange="-1 0.5" ctrllimited="true"'), frame_skip=5)
    assert narrow["offset[wrist]"].bounds == (-0.75, 0.75)


def test_a_motors_force_falls_to_nothing_within_the_speed_of_its_bound():
    found = bounds(CART, frame_skip=5)
    assert found["torque_speed[push]"].bounds == pytest.approx((0.0, 4.0 / 0.5))
    assert found["torque_speed[push]"].unit == "N s/m"
    assert found["torque_speed[hinge]"].bounds == pytest.approx((0.0, 5.0 / 0.5))
    assert (
        found["current_limit[push]"].neutral == found["current_limit[push]"].bounds[1] == pytest.approx(4.0)
    )
    assert "current_limit[hinge]" not in found  # it has a limit, which is a factor's
    assert "force_limit[hinge]" in found
    assert "force_limit[push]" not in found


def test_a_payload_is_somewhere_in_the_body_and_weighs_no_more_than_the_robot_or_five_bodies():
    found = bounds(CART, frame_skip=5)
    assert found["payload[cart]"].bounds == pytest.approx((0.0, 10.0))
    assert found["payload[tip]"].bounds == pytest.approx((0.0, 3.1))
    assert found["payload[rod]"].typical == pytest.approx(0.2)
    for axis, centre in zip("xyz", (0.0, 0.0, -0.5)):
        place = found[f"payload[rod.{axis}]"]
        assert place.neutral == centre
        assert place.bounds[0] < centre < place.bounds[1]
        assert place.typical == pytest.approx((place.bounds[1] - place.bounds[0]) / 4)


def test_a_centre_of_mass_moves_within_its_link_where_that_changes_its_motion():
    text = CART.replace('mass="1" diaginertia="0.02 0.02 0.001"/>', 'mass="1" diaginertia="0.02 0.02 0.001"/>'
                        '<geom size="0.1" pos="0 0.3 0.4"/>')  # fmt: skip
    found = bounds(text, frame_skip=5)
    assert found["centre_of_mass[rod.x]"].bounds == pytest.approx((-0.6, 0.6))
    assert "centre_of_mass[rod.y]" not in found  # along the hinge
    assert not any(name.startswith("centre_of_mass[cart") for name in found)  # it cannot turn
    assert found["centre_of_mass[tip.z]"].bounds == (-0.1, 0.1)


def test_a_motor_without_inertia_gets_a_small_share_of_its_joints():
    simulator = MujocoSimulator(CART, frame_skip=5)
    model, inertia = simulator.compiled({"backlash[wrist]": 0.05}), 0.0001 + 0.1 * 0.1**2
    # And a time step times what damps it, which the flanks of play must know.
    wrist, damped = model.joint("wrist").dofadr[0], 0.002 * np.array([0.2, 0.5])
    assert model.dof_armature[wrist] == pytest.approx(0.02 * inertia + damped[0], rel=1e-9)
    hinge = simulator.compiled({"backlash[hinge]": 0.05})
    assert hinge.dof_armature[hinge.joint("hinge").dofadr[0]] == pytest.approx(0.04 + damped[1], rel=1e-9)
    low, high = hinge.joint("hinge.play").range
    assert high - low == pytest.approx(0.05)
