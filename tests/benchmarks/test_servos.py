"""Worlds of servos against closed forms."""

import numpy as np
import pytest

ROWS = {"sensor": "exact", "rows": 60, "episodes": 1}


def _log(robot, truth=None, **settings):
    from worlds import robots
    from worlds.servos import ServoWorld

    return robots.make_log(robot, truth, build=ServoWorld, **{**ROWS, **settings})


@pytest.mark.parametrize("robot", ["so101", "quadrotor"])
def test_with_nothing_hidden_it_is_the_world_without_servos(robot):
    from worlds import robots

    np.testing.assert_array_equal(_log(robot).y, robots.make_log(robot, **ROWS).y)


def test_commands_that_lag_are_late_by_the_time_constant():
    from worlds.servos import ServoWorld

    world = ServoWorld("so101", {"lag[all]": 0.012})
    world.reset(np.zeros(12))
    acting = []
    for row in range(200):
        world.advance(np.full((1, 6), 0.3 * world.dt * row))
        acting.append(world.data.ctrl.copy())
    # A command that grows by 0.3 a second and holds for a row; what acted in the last time step of the row.
    late = 0.3 * world.dt * 199 - acting[-1]
    left = np.exp(-world.dt / 0.012)
    held = 0.3 * world.dt * left / (1 - left)
    before, mean = (
        held * np.exp((world.timestep) / 0.012),
        0.012 / world.timestep * -np.expm1(-world.timestep / 0.012),
    )
    np.testing.assert_allclose(late, before * mean, rtol=1e-9)


def test_a_torque_that_lags_comes_to_the_same_place_later():
    now, late = _log("so101"), _log("so101", {"lag_torque[lift]": 0.01})
    assert np.abs(now.y[:, 1] - late.y[:, 1]).max() > 0.005
    from worlds.servos import ServoWorld

    world = ServoWorld("so101", {"lag_torque[lift]": 0.01})
    world.reset(np.zeros(12))
    other = ServoWorld("so101")
    other.reset(np.zeros(12))
    for _ in range(250):
        ends = [one.advance(np.full((1, 6), 0.2)) for one in (world, other)]
    np.testing.assert_allclose(*ends, atol=2e-3)


def test_commands_that_are_late_act_in_the_mean_over_a_time_step_and_in_another_unit():
    from worlds.servos import ServoWorld

    # 1.6 time steps late: nothing of a jump in the first, four tenths in the second, all from the third on.
    world = ServoWorld("so101", {"delay[lift]": 0.008, "scale[ctrl.lift]": 2.0, "bias[ctrl.lift]": 0.1})
    history, step = np.zeros((3, 6)), world.timestep
    history[-1] = 0.5
    found = [world._arrived(history, k * step, step)[1] for k in range(world.substeps)]
    np.testing.assert_allclose(found, [0.0, 0.2, 0.5, 0.5], atol=1e-12)
    world.reset(np.zeros(12))
    world.advance(history)
    np.testing.assert_allclose(world.data.ctrl, [0.5, 2 * 0.5 + 0.1, 0.5, 0.5, 0.5, 0.5])


def test_a_servo_rests_within_its_dead_zone_and_loses_torque_as_it_turns():
    from worlds.servos import ServoWorld

    world = ServoWorld("so101", {"dead_zone[lift]": 0.02, "torque_speed[pan]": 0.5, "force_limit[pan]": 0.5})
    state, kp, limit = np.zeros(12), 17.8, 3.35 / 2
    state[6] = 2.0
    for command, expected in ((0.019, 0.0), (0.03, 0.01 * kp), (-0.03, -0.01 * kp)):
        world.reset(state)
        world.data.ctrl[:] = command
        world.data.ctrl[0] = 1.0
        world._weaken()
        assert (world.data.ctrl[1] - world.data.qpos[1]) * kp == pytest.approx(expected)
        np.testing.assert_allclose(world.real.actuator_forcerange[0], [-limit, limit - 0.5 * 2.0])


def test_a_sensor_with_a_filter_is_behind_by_its_time_constant():
    from worlds.servos import ServoWorld

    world = ServoWorld("so101", {"lag[qpos.lift]": 0.03})
    world.reset(np.zeros(12))
    true = [world.advance(np.full((1, 6), 0.02 * row))[1] for row in range(100)]
    states = np.zeros((101, 12))
    states[1:, 1] = true
    shown = world.readings("exact", states, None, None, states)[1:, 1]
    late = np.interp(world.dt * np.arange(50, 99) - 0.03, world.dt * np.arange(100), true)
    np.testing.assert_allclose(shown[50:99], late, atol=1e-4)
    assert np.abs(shown - true).max() > 0.01


def test_a_link_is_no_further_from_its_motor_than_play_allows():
    from worlds.servos import ServoWorld

    world = ServoWorld("servo_arm", {"backlash[elbow]": 0.02})
    world.reset(np.array([0.0, -1.2, 1.2, -1.4, -1.5, 0.0, *np.zeros(6)]))
    (_, _, loose, _) = world.play[0]
    found = []
    for row in range(60):
        command = np.array([0.0, -1.2, 1.2 + 0.3 * np.sin(row / 5), -1.4, -1.5, 0.0])
        state = world.advance(command[None])
        found.append(world.data.qpos[loose])
        assert state[2] == pytest.approx(world.data.qpos[world.positions[2]] + found[-1])
    # It leans on either end, and goes hardly into it.
    assert 0.0095 < np.max(np.abs(found)) < 0.0105


def test_a_weight_adds_its_mass_and_its_moment():
    import mujoco
    from worlds.servos import ServoWorld

    truth = {"payload[gripper]": 0.05, "payload[gripper.x]": 0.06}
    world = ServoWorld("so101", truth)
    assert world.real.body_mass.sum() - world.model.body_mass.sum() == pytest.approx(0.05)
    data = mujoco.MjData(world.real)
    mujoco.mj_forward(world.real, data)
    body, weight = (world.real.body(name).id for name in ("gripper", "gripper.weight"))
    np.testing.assert_allclose(
        data.xpos[weight] - data.xpos[body], data.xmat[body].reshape(3, 3) @ [0.06, 0, 0]
    )


def test_friction_under_load_holds_a_joint_by_the_published_law():
    from worlds.servos import MX106, ServoWorld

    world = ServoWorld("so101", {"mx106[lift]": 1.0})
    world.reset(np.zeros(12))
    for _ in range(200):
        world.advance(np.zeros((1, 6)))
    dof = world.loaded[0][0]
    load = abs(world.load[dof])
    # At rest motor and gravity pull one against the other: the friction is of what both do.
    expected = MX106["stribeck"] + (MX106["load"] + MX106["load_stribeck"]) * load
    assert load > 0.1
    assert world.real.dof_frictionloss[dof] - world.least[dof] == pytest.approx(expected, rel=1e-3)


def test_every_case_hides_something_that_changes_the_data():
    import servo_effects

    for case in servo_effects.cases(cut=True):
        robot, truth = case.name.partition(" | ")[0], servo_effects.truth_of(case)
        changed = np.abs(_log(robot, truth).y - _log(robot).y).max()
        assert (changed > 1e-4) == bool(truth)


def test_a_line_is_right_if_what_is_hidden_is_named_by_its_size_or_as_what_is_alike():
    import servo_effects

    def line(kind, truth, *causes):
        listed = [
            {"name": name, "value": value, "aliases": [[one, 0.3] for one in others]}
            for name, value, *others in causes
        ]
        return {"kind": kind, "truth": truth, "causes": listed, "masses": {"tip": 2.0}}

    play = {"backlash[elbow]": 0.02}
    assert servo_effects.is_alone(line("play", play, ("dead_zone[elbow]", 0.009)))
    assert not servo_effects.is_named(line("play", play, ("dead_zone[elbow]", 0.02)))
    assert not servo_effects.is_named(line("play", play, ("backlash[lift]", 0.02)))
    weight = {"payload[tip]": 0.4, "payload[tip.x]": 0.1}
    assert servo_effects.is_alone(line("weight", weight, ("mass[tip]", 1.2), ("centre_of_mass[tip.x]", 0.02)))
    beside = line("lag", {"lag[all]": 0.005}, ("lag[all]", 0.0052), ("delay[action]", 0.002))
    assert servo_effects.is_named(beside)
    assert not servo_effects.is_alone(beside)
