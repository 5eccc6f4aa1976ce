"""The Gymnasium robots under the conditions of the paper's Table I."""

import warnings

import gymnasium
import mujoco
import numpy as np
import pytest

from skat.simulators import make_simulator

NAMES = {"hopper": "Hopper-v5", "halfcheetah": "HalfCheetah-v5", "ant": "Ant-v5"}


def rows_of(robot, n=8):
    random = np.random.default_rng(0)
    model = robot.compiled()
    rows = np.tile(np.r_[model.qpos0, np.zeros(model.nv), np.zeros(model.nu)], (n, 1))
    rows[:, len(robot.state_names) :] = random.uniform(-1, 1, size=(n, model.nu))
    return robot.displace(rows, 0.1 * random.normal(size=(n, len(robot.residual_names))))


@pytest.mark.parametrize("name", NAMES)
def test_normal_robot_is_that_of_gymnasium(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo logs its warning
    robot = make_simulator(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # HalfCheetah's file: settotalmass is deprecated
        environment = gymnasium.make(NAMES[name]).unwrapped
    rows = rows_of(robot)
    assert robot.dt == pytest.approx(environment.dt)
    for row, found in zip(rows, robot.predict(rows)):
        environment.reset(seed=0)
        mujoco.mj_resetData(environment.model, environment.data)
        nq, nv = environment.model.nq, environment.model.nv
        environment.set_state(row[:nq], row[nq : nq + nv])
        environment.data.qacc_warmstart[:] = 0
        environment.do_simulation(row[nq + nv :], environment.frame_skip)
        np.testing.assert_allclose(
            found, np.r_[environment.data.qpos, environment.data.qvel], rtol=1e-6, atol=1e-6
        )
    environment.close()


@pytest.mark.parametrize("name", NAMES)
def test_conditions_are_those_of_table_1(name):
    normal = make_simulator(name).compiled()
    for condition, factor in (("light", 0.5), ("heavy", 2.0)):
        model = make_simulator(name, condition=condition).compiled()
        np.testing.assert_allclose(model.body_mass, factor * normal.body_mass)
        np.testing.assert_allclose(model.body_inertia, factor * normal.body_inertia)
    for condition, factor in (("long", 1.5), ("short", 0.5)):
        model = make_simulator(name, condition=condition).compiled()
        np.testing.assert_allclose(model.body_mass, normal.body_mass)
        np.testing.assert_allclose(model.body_pos[2:], factor * normal.body_pos[2:], atol=1e-12)
        capsules = normal.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE
        np.testing.assert_allclose(model.geom_size[capsules, 1], factor * normal.geom_size[capsules, 1])
        np.testing.assert_allclose(model.geom_size[:, 0], normal.geom_size[:, 0])
    every = np.ones(normal.nu)
    second = np.where(np.arange(normal.nu) % 2, 1.0, 0.0)
    for condition, factor in (
        ("some_inverted", every - 2 * second), ("inverted", -every), ("some_off", every - second),
    ):  # fmt: skip
        model = make_simulator(name, condition=condition).compiled()
        np.testing.assert_array_equal(model.actuator_gainprm[:, 0], factor * normal.actuator_gainprm[:, 0])


def test_inverted_robot_does_what_the_negated_action_does():
    rows = rows_of(make_simulator("hopper"))
    negated = rows.copy()
    negated[:, 12:] *= -1
    np.testing.assert_array_equal(
        make_simulator("hopper", condition="inverted").predict(rows),
        make_simulator("hopper").predict(negated),
    )


def test_state_is_the_full_state():
    assert make_simulator("hopper").input_names == (
        "qpos.rootx", "qpos.rootz", "qpos.rooty", "qpos.thigh_joint", "qpos.leg_joint", "qpos.foot_joint",
        "qvel.rootx", "qvel.rootz", "qvel.rooty", "qvel.thigh_joint", "qvel.leg_joint", "qvel.foot_joint",
        "ctrl.thigh_joint", "ctrl.leg_joint", "ctrl.foot_joint",
    )  # fmt: skip
    assert len(make_simulator("halfcheetah").state_names) == 18
    assert make_simulator("ant").state_names[:7] == tuple(
        f"qpos.root.{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz")
    )


def test_unknown_names_list_those_that_exist():
    with pytest.raises(
        ValueError, match=r"unknown simulator 'hoper'\. Did you mean 'hopper'\? There are: hopper, half"
    ):
        make_simulator("hoper")
    with pytest.raises(ValueError, match=r"unknown condition of ant 'heavvy'\. Did you mean 'heavy'\?"):
        make_simulator("ant", condition="heavvy")
