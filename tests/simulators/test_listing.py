"""Which effects are listed: what moves, what the model disables, what its own numbers and integrator allow."""

import json

import numpy as np
import pytest

from skat.simulators import MujocoSimulator

ROD = '<geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" contype="0" conaffinity="0"/>'


def model(body, rest="", option=""):
    return f"<mujoco><option timestep='0.002'>{option}</option><worldbody>{body}</worldbody>{rest}</mujoco>"


def hinged(joint="", rest="", option=""):
    return model(f'<body name="rod"><joint name="x" axis="0 1 0" {joint}/>{ROD}</body>', rest, option)


def effects_of(text):
    return {effect.name: effect for effect in MujocoSimulator(text).effects()}


@pytest.mark.parametrize(
    ("attribute", "family"),
    [
        ("stiffness", "stiffness"),
        ("damping", "damping"),
        ("frictionloss", "dry_friction"),
        ("armature", "armature"),
    ],
)
def test_what_a_model_has_below_zero_is_not_taken_off(attribute, family):
    effect = effects_of(hinged(f'{attribute}="-0.01"'))[f"{family}[x]"]
    assert effect.bounds[0] == 0.0 < effect.bounds[1]


def test_a_mocap_body_does_not_move_wherever_it_is_listed():
    target = '<body name="target" mocap="true"><geom size=".02" contype="0" conaffinity="0"/></body>'
    cart = f'<body name="cart" pos="0 0 1"><joint name="x" type="slide" axis="1 0 0"/>{ROD}</body>'
    first, last = effects_of(model(target + cart)), effects_of(model(cart + target))
    assert first.keys() == last.keys()
    assert "wind[x]" in first
    assert not {"mass[target]", "mass[all]"} & first.keys()


def test_a_body_on_a_mocap_body_is_a_root():
    arm = (
        f'<body name="hand" mocap="true"><body name="tool"><joint name="x" axis="0 1 0"/>{ROD}</body></body>'
    )
    assert {"wind[x]", "mass[tool]"} <= effects_of(model(arm)).keys()


SERVO = (
    '<actuator><position name="p" joint="x" kp="30" kv="1" gear="2" forcerange="-9 9" group="3"/></actuator>'
)


@pytest.mark.parametrize(
    ("option", "gone"),
    [
        ('<flag frictionloss="disable"/>', ("dry_friction", "position_friction")),
        ('<flag spring="disable"/>', ("stiffness",)),
        ('<flag damper="disable"/>', ("damping",)),
        ('<flag actuation="disable"/>', ("gain", "kp", "kv", "force_limit", "offset", "delay")),
        (None, ("gain", "kp", "kv", "force_limit", "offset", "delay")),
    ],
)
def test_effects_of_what_a_model_disables_are_not_listed(option, gone):
    text = hinged('stiffness="1"', SERVO, option or "")
    if option is None:
        text = text.replace("<option", '<option actuatorgroupdisable="3"')
    listed = {name.partition("[")[0] for name in effects_of(text)}
    everything = {name.partition("[")[0] for name in effects_of(hinged('stiffness="1"', SERVO))}
    assert everything - listed == set(gone)


def test_damping_is_bounded_where_euler_treats_it_explicitly():
    text = hinged('damping="0.1"', '<actuator><motor joint="x"/></actuator>', '<flag eulerdamp="disable"/>')
    simulator = MujocoSimulator(text)
    high = {effect.name: effect for effect in simulator.effects()}["damping[x]"].bounds[1]
    states = simulator.rollout([[0.1, 1.0]], np.zeros((1, 300, 1)), n_steps=300, effects={"damping[x]": high})
    assert np.abs(states).max() < 2


def test_velocity_feedback_that_is_damping_is_not_listed_beside_it():
    servo = SERVO.replace('forcerange="-9 9"', "")
    option = '<flag eulerdamp="disable"/>'
    assert "kv[p]" in effects_of(hinged('damping="5"', servo))
    assert "kv[p]" not in effects_of(hinged('damping="5"', servo, option))


def test_two_columns_of_one_name_are_refused():
    ball = f'<body name="a"><joint name="j" type="ball"/>{ROD}</body>'
    hinge = f'<body name="b"><joint name="j.qw" axis="0 1 0"/>{ROD}</body>'
    with pytest.raises(ValueError, match=r"two columns of the state would be called qpos\.j\.qw"):
        MujocoSimulator(model(ball + hinge)).predict(np.zeros((1, 9)))


@pytest.mark.parametrize(("delay", "written"), [(0.0006, False), (0.002, True), (0.0031, True)])
def test_delay_that_ends_within_the_first_time_step_is_written_beside(tmp_path, delay, written):
    late = MujocoSimulator(hinged("", '<actuator><motor joint="x"/></actuator>')).extended(
        {"delay[action]": delay}
    )
    path, *beside = late.to_mjcf(tmp_path / "late.xml")
    assert ("delay" in path.read_text().partition("<actuator>")[2]) == written
    told = [one["name"] for file in beside for one in json.loads(file.read_text())["effects"]]
    assert told == ["delay[action]"] * (not written)


@pytest.mark.parametrize(
    ("actuator", "default", "asked"),
    [
        ('<motor name="drive" joint="x"/>', "gain[drive]", "bias[ctrl.drive]"),
        ('<position name="drive" joint="x" kp="9"/>', "offset[drive]", "scale[ctrl.drive]"),
    ],
)
def test_a_command_is_scaled_or_shifted_only_where_nothing_else_does_the_same(actuator, default, asked):
    """A motor's gain scales its command, and a servo's offset shifts it."""
    simulator = MujocoSimulator(hinged(rest=f"<actuator>{actuator}</actuator>"))
    listed = {effect.name for effect in simulator.effects()}
    every = {effect.name for effect in simulator.effects(also="all")}
    assert default in listed
    assert {name for name in every if "ctrl.drive" in name} == {asked}
    assert asked not in listed
