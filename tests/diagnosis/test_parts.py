"""Channels that do not act on each other are filtered, estimated and simulated beside each other, as if alone."""

from dataclasses import fields, replace

import numpy as np
import pytest

from skat.diagnosis.chains import Chains
from skat.diagnosis.filtering import filter_columns, kalman_filter, smooth, updated
from skat.diagnosis.noise import estimate_noise, normal_noise
from skat.diagnosis.slopes import derivatives
from skat.diagnosis.statespace import linearise, state_space
from skat.simulators import MujocoSimulator, make_simulator

LEG = """<body name='{0}' pos='{1} 0 0'><joint name='{0}_hip' axis='0 1 0' frictionloss='.1' damping='.2'/>
<geom size='.03' fromto='0 0 0 0 0 -.3' type='capsule' mass='1' contype='{2}' conaffinity='{2}'/>
<body name='{0}_shank' pos='0 0 -.3'><joint name='{0}_knee' axis='0 1 0' damping='.1'/>
<geom size='.02' fromto='0 0 0 0 0 -.3' type='capsule' mass='.5' contype='{2}' conaffinity='{2}'/></body></body>"""
SERVO = "<position name='{0}_{1}' joint='{0}_{1}' kp='20' kv='1'/>"


def legged(names, *, touching=0, beside="", **parameters):
    bodies = "".join(LEG.format(name, place, touching) for place, name in enumerate(names))
    servos = "".join(SERVO.format(name, part) for name in names for part in ("hip", "knee"))
    model = f"<mujoco><worldbody>{bodies}</worldbody><actuator>{servos}</actuator>{beside}</mujoco>"
    return MujocoSimulator(model, frame_skip=5, **parameters)


def swinging(simulator, n_rows=40):
    rng = np.random.default_rng(0)
    n = len(simulator.state_names) // 2
    commands = 0.4 * np.sin(0.2 * np.arange(n_rows)[:, None] + np.arange(n))[None]
    states = simulator.rollout([np.r_[0.2 * rng.normal(size=n), np.zeros(n)]], commands, n_steps=n_rows)[0]
    return np.c_[states[:-1], commands[0]], states[1:]


def space_of(simulator, X, y):
    return state_space(simulator, X, y, np.zeros(len(X), int), consecutive=True)


@pytest.fixture
def mixed():
    """Five channels and three forces, of two parts that are woven into each other, and a force that moves nothing."""
    rng, n, steps, d, k = np.random.default_rng(0), 3, 9, 5, 3
    part, of_force = np.array([0, 1, 0, 1, 1]), np.array([1, 2, 0])
    same = part[:, None] == part
    bends = 0.1 * rng.normal(size=(n, steps, d, d)) * same
    mask = rng.random((n, steps + 1, d)) > 0.3
    mask[..., 3] = False
    chains = Chains(
        0.6 * rng.normal(size=(n, steps, d, d)) * same,
        rng.normal(size=(n, steps, d)),
        bends @ bends.swapaxes(-1, -2),
        rng.normal(size=(n, steps, d, k)) * (part[:, None] == of_force),
        rng.normal(size=(n, steps + 1, d)),
        mask,
        np.full(d, 9.0),
    )
    return chains


def as_one(chains):
    """Return the same chains, of which nothing says that they come apart."""
    whole = replace(chains)
    d, k = chains.carrier.shape[-2:]
    vars(whole)["parts"] = ((np.arange(d), np.arange(k)),)
    return whole


def test_parts_of_chains_are_filtered_and_smoothed_as_in_one_pass(mixed):
    chains, whole = mixed, as_one(mixed)
    assert [own[0].tolist() for own in chains.parts] == [[0, 2], [1, 3, 4]]
    assert [own[1].tolist() for own in chains.parts] == [[2], [0]]
    rng = np.random.default_rng(1)
    forces, errors = 0.1 + rng.random((3, 9, 3)), 0.1 + rng.random((3, 10, 5))
    passes = [kalman_filter(one, forces, errors) for one in (chains, whole)]
    smoothed = [smooth(one, passed, forces, errors) for one, passed in zip((chains, whole), passes)]
    for mine, other in (passes, smoothed):
        for one in fields(mine):
            pushed = ...
            if one.name.endswith(("scores", "information")):  # of forces on different parts nothing is asked
                pushed = (..., [0, 1, 2], [0, 1, 2])
            apart, together = (getattr(each, one.name)[pushed] for each in (mine, other))
            np.testing.assert_allclose(apart, together, atol=1e-9)
    columns = rng.normal(size=(3, 9, 5, 2)) * (np.arange(5) % 2)[:, None]
    mine, other = (filter_columns(one, passed, columns) for one, passed in zip((chains, whole), passes))
    np.testing.assert_allclose(mine, other, atol=1e-9)
    for mine, other in zip(*(updated(one, passed, errors) for one, passed in zip((chains, whole), passes))):
        np.testing.assert_allclose(mine, other, atol=1e-9)


def test_noise_of_parts_is_what_each_has_by_itself(mixed):
    real = np.ones((3, 9), dtype=bool)
    noise = normal_noise(mixed, np.full(3, 0.5), np.full(5, 0.5))
    estimate = estimate_noise(mixed, noise, real, floor=np.zeros(5))
    alone = [
        estimate_noise(mixed.part(*own), noise.part(*own), real, floor=np.zeros(len(own[0])))
        for own in mixed.parts
    ]
    assert estimate.bound == pytest.approx(sum(one.bound for one in alone), abs=1e-9)
    for (channels, forces), one in zip(mixed.parts, alone):
        np.testing.assert_array_equal(estimate.noise.error[:, channels], one.noise.error)
        np.testing.assert_array_equal(estimate.noise.force[:, forces], one.noise.force)
        np.testing.assert_array_equal(estimate.smoothed.means[..., channels], one.smoothed.means)


def test_legs_of_a_fixed_base_are_parts_unless_anything_ties_them():
    assert [len(part) for part in make_simulator("go2_air").parts()] == [6, 6, 6, 6]
    free = legged("ab")
    assert free.parts() == tuple(
        tuple(f"{kind}.{leg}_{part}" for kind in ("qpos", "qvel") for part in ("hip", "knee")) for leg in "ab"
    )
    weld = "<equality><joint joint1='a_hip' joint2='b_hip'/></equality>"
    tendon = "<tendon><fixed><joint joint='a_hip' coef='1'/><joint joint='b_hip' coef='1'/></fixed></tendon>"
    own = make_simulator("go2_air").effects()[0]
    tied = [
        legged("ab", touching=1),
        legged("ab", beside=weld),
        legged("ab", beside=tendon),
        legged("ab", extra_effects=[replace(own, name="wear[a_hip]")]),
    ]
    for simulator in tied:
        assert simulator.parts() == (simulator.residual_names,)
    assert free.part_of("kp[b_knee]") == free.part_of("mass[b_shank]") == 1
    assert free.part_of("dry_friction[a_hip]") == free.part_of("bias[qpos.a_hip]") == 0
    assert free.part_of("force[b_knee]") == free.part_of("centre_of_mass[b.x]") == 1
    assert free.part_of("gravity") is free.part_of("mass[all]") is free.part_of("delay[action]") is None
    assert tied[-1].part_of("kp[b_knee]") is None


def test_legs_are_linear_as_each_is_alone():
    both, alone = legged("ab"), [legged("a"), legged("b")]
    X, y = swinging(both)
    whole = space_of(both, X, y)
    covariances = np.broadcast_to(1e-4 * np.eye(8), (1, 41, 8, 8))
    linear = linearise(whole, whole.measured, {}, covariances)
    names = ["damping[a_knee]", "gravity", "kp[b_hip]", "mass[a_shank]", "dry_friction[b_hip]"]
    known = {effect.name: effect for effect in both.effects()}
    steps = {name: (known[name].neutral, known[name].neutral + 0.1) for name in names}
    steps["kp[b_hip]"] = (0.9, 1.1)
    slopes = derivatives(whole, linear, {}, steps)
    for leg, simulator in enumerate(alone):
        states = [whole.simulator.state_names.index(name) for name in simulator.state_names]
        inputs = [whole.simulator.input_names.index(name) for name in simulator.input_names]
        space = space_of(simulator, X[:, inputs], y[:, states])
        own = linearise(space, space.measured, {}, covariances[..., :4, :4])
        block = whole.places[0][:, None, None], whole.places[1][:, None, None], np.array(states)[:, None]
        got = linear.chains.transitions[(*block, states)]
        # The constraints of all legs are solved at once, to a tolerance.
        np.testing.assert_allclose(got, own.chains.transitions[space.places], atol=1e-5)
        forces = linear.chains.carrier[(*block, [2 * leg, 2 * leg + 1])]
        np.testing.assert_allclose(forces, own.chains.carrier[space.places], atol=1e-5)
        mine = [name for name in names if both.part_of(name) in (leg, None)]
        expected = derivatives(space, own, {}, {name: steps[name] for name in mine})
        places = [names.index(name) for name in mine]
        np.testing.assert_allclose(slopes[:, states][..., places], expected, atol=1e-5)
        others = [names.index(name) for name in names if both.part_of(name) == 1 - leg]
        assert not slopes[:, states][..., others].any()


def test_actuators_of_sites_act_in_the_one_part_that_there_is():
    """As thrusts of a quadrotor do; more of them than joints."""
    thrusts = "".join(f'<motor name="rotor{k}" site="place{k}" gear="0 0 1 0 0 0"/>' for k in range(4))
    places = "".join(f'<site name="place{k}" pos=".1 {k} 0"/>' for k in range(4))
    simulator = MujocoSimulator(
        f'<mujoco><worldbody><body name="hull"><freejoint/><geom size=".1"/>{places}</body></worldbody>'
        f"<actuator>{thrusts}</actuator></mujoco>"
    )
    assert {simulator.part_of(effect.name) for effect in simulator.effects()} <= {0, None}
    assert simulator.part_of("gain[rotor3]") == 0
