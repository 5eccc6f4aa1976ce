import mujoco
import numpy as np
import pytest
from scipy import signal

ARRAYS = ("two_link", "cart_pole", "servo_arm", "so101", "hopper", "halfcheetah", "puck")


def _robots():
    from worlds import robots

    return robots


def _stepped(log, state, command):
    """Return the next state of the user's model, by plain MuJoCo from rest."""
    model = mujoco.MjModel.from_xml_string(log.mjcf)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = state[: model.nq], state[model.nq :]
    data.ctrl[:] = command
    for _ in range(log.frame_skip):
        mujoco.mj_step(model, data)
    return np.concatenate([data.qpos, data.qvel])


@pytest.mark.parametrize("robot", ARRAYS)
def test_a_world_without_anything_hidden_is_plain_stepping_of_the_model(robot):
    log = _robots().make_log(robot, sensor="exact", rows=20, episodes=1)
    expected = [_stepped(log, row, command) for row, command in zip(log.exact, log.commands)]
    # The solver of contacts starts warm on a path, and cold here: its tolerance is 1e-8.
    np.testing.assert_allclose(
        log.y, expected, rtol=0, atol=1e-5 if robot in ("hopper", "halfcheetah", "puck") else 1e-12
    )
    np.testing.assert_array_equal(log.X[:, : log.y.shape[1]], log.exact)


def test_rows_of_an_episode_follow_each_other():
    log = _robots().make_log("two_link", rows=60, episodes=2)
    n = log.y.shape[1]
    inside = log.groups[1:] == log.groups[:-1]
    np.testing.assert_array_equal(log.y[:-1][inside], log.X[1:, :n][inside])
    assert not np.allclose(log.y[29], log.X[30, :n])


@pytest.mark.parametrize(
    ("robot", "cause"),
    [
        ("two_link", {"mass[lower]": 1.2}),
        ("two_link", {"dry_friction[elbow]": 0.1}),
        ("two_link", {"centre_of_mass[lower.z]": 0.02}),
        ("two_link", {"length[upper]": 1.1}),
        ("two_link", {"delay[action]": 0.013}),
        ("servo_arm", {"kp[elbow]": 0.8}),
        ("servo_arm", {"offset[lift]": 0.02}),
        ("puck", {"wind[x]": 0.5}),
        ("puck", {"contact_friction[all]": 0.7}),
        ("hopper", {"gain[leg_joint]": 0.8}),
        ("torque_arm", None),
        ("quadruped_hung", None),
    ],
)
def test_a_world_is_the_effects_of_the_same_name(robot, cause):
    """What worlds hide by plain MuJoCo is what the simulator does under effects of these names and values."""
    from skat.simulators import MujocoSimulator

    robots = _robots()
    # Of joints of geared robots, small enough for effects' bounds.
    cause = cause or {
        name: 0.01 * value for name, value in robots.machine(robot).items() if "damping" not in name
    }
    if robot in ("torque_arm", "quadruped_hung"):
        cause = {name: value for name, value in cause.items() if "armature" not in name}
    log = robots.make_log(robot, cause, sensor="exact", rows=20, episodes=1)
    simulator = MujocoSimulator(log.mjcf, frame_skip=log.frame_skip)
    # Before the first row, commands are in no log.
    start = 3 if "delay[action]" in cause else 0
    nominal, extended = (
        simulator.predict(log.X, effects=effects, groups=log.groups)[start:] - log.y[start:]
        for effects in ({}, cause)
    )
    assert np.abs(extended).max() < 1e-5
    assert np.abs(nominal).max() > 30 * np.abs(extended).max()


@pytest.mark.parametrize("robot", ["puck", "cart_pole", "two_link"])
def test_every_effect_that_a_draw_from_the_prior_may_hide_is_the_effect_of_its_name(robot):
    from probabilities import HIDDEN

    from skat.simulators import MujocoSimulator

    robots = _robots()
    kind = robots.ROBOTS[robot]
    simulator = MujocoSimulator(kind.text(), frame_skip=kind.frame_skip)
    for effect in simulator.effects():
        if effect.family not in HIDDEN:
            continue
        _, high = effect.bounds
        step = 0.3 if effect.is_factor else 0.02 * high
        truth = {effect.name: min(effect.neutral + step, high)}
        log = robots.make_log(robot, truth, sensor="exact", rows=12, episodes=1)
        error = simulator.predict(log.X, effects=truth, groups=log.groups)[6:] - log.y[6:]
        assert np.abs(error).max() < 1e-5, effect.name


def test_readings_are_scaled_before_a_bias_is_added():
    robots = _robots()
    names = ("bias[qpos.elbow]", "scale[qpos.elbow]")
    first, second = (
        robots.make_log("two_link", dict(zip(order, values)), sensor="exact", rows=12, episodes=1)
        for order, values in ((names, (0.1, 1.2)), (names[::-1], (1.2, 0.1)))
    )
    np.testing.assert_array_equal(first.X, second.X)
    np.testing.assert_allclose(first.X[:, 1], 1.2 * first.exact[:, 1] + 0.1, rtol=1e-12)


def test_a_delay_of_one_row_is_the_command_of_the_row_before():
    robots = _robots()
    log = robots.make_log("servo_arm", {"delay[action]": 0.01}, sensor="exact", rows=20, episodes=1)
    expected = [_stepped(log, state, command) for state, command in zip(log.exact[1:], log.commands[:-1])]
    np.testing.assert_allclose(log.y[1:], expected, rtol=0, atol=1e-12)


def test_the_same_seed_with_another_sensor_is_the_same_motion():
    robots = _robots()
    one, other = (
        robots.make_log("two_link", sensor=sensor, rows=50, episodes=1) for sensor in ("ideal", "encoder")
    )
    np.testing.assert_array_equal(one.exact, other.exact)


def test_feedback_moves_by_its_own_noise():
    robots = _robots()
    quiet, noisy = (robots.make_log("feedback", rows=50, episodes=1, noise=noise) for noise in (1e-9, 0.01))
    assert np.abs(quiet.exact - noisy.exact).max() > 1e-4


def test_ideal_noise_has_the_stated_size():
    log = _robots().make_log("two_link", rows=2000, episodes=1)
    errors = log.y - log.exact_next
    # Of 2,000 normal numbers, the standard deviation is known within 1.6 %.
    np.testing.assert_allclose(errors.std(axis=0), log.sigma, rtol=5 * 0.016)


def test_size_of_nothing_is_nothing_and_grows_with_what_is_hidden():
    robots = _robots()
    sizes = [
        robots.make_log("two_link", {"dry_friction[elbow]": value}, rows=200, episodes=1).size
        for value in (1e-9, 0.05, 0.1)
    ]
    assert sizes[0] < 1e-9
    assert sizes[2] == pytest.approx(4 * sizes[1], rel=0.3)


def test_a_low_pass_has_the_stated_bandwidth():
    from worlds.sensing import lowpass

    time = np.arange(4000)
    for cutoff in (0.1, 0.3):
        # Frequencies in half cycles per sample; 3 dB down at the cut-off, 40 dB per decade for this order beyond.
        gains = []
        for frequency in (cutoff / 10, cutoff):
            through = lowpass(np.sin(np.pi * frequency * time)[:, None], cutoff)[2000:]
            gains.append(np.sqrt(2) * through.std())
        assert gains == pytest.approx([1, np.sqrt(0.5)], abs=0.01)


def test_sensors_say_what_they_are():
    from worlds.sensing import ENCODER_STEPS, read

    dt, n = 0.01, 5000
    time = dt * np.arange(n)
    path = np.column_stack([np.sin(time), np.cos(time)])
    sigma, turning = np.array([1e-4, 1e-2]), np.array([True])

    def readings(sensor):
        return read(sensor, path, sigma, turning, dt, np.random.default_rng(0))

    np.testing.assert_array_equal(readings("exact"), path)
    assert np.isnan(readings("positions")[:, 1]).all()
    assert not np.isnan(readings("positions")[:, 0]).any()
    encoder = readings("encoder")
    lost = np.isnan(encoder).any(axis=1)
    assert 0.01 < lost.mean() < 0.03
    steps = encoder[~lost, 0] * ENCODER_STEPS / (2 * np.pi)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    differences = readings("differences")
    np.testing.assert_allclose(
        differences[1:-1, 1], (differences[2:, 0] - differences[:-2, 0]) / (2 * dt), rtol=0, atol=1e-9
    )
    # A causal filter comes late, one without phase does not.
    late, prompt = readings("lowpass10")[:, 1], readings("zero_phase")[:, 1]
    lag = [np.argmax(signal.correlate(one[500:-500], path[500:-500, 1])) for one in (late, prompt)]
    assert lag[0] > lag[1]


@pytest.mark.parametrize("kind", ["white20", "memory20", "resonance20", "white5"])
def test_random_forces_have_the_stated_size_and_memory(kind):
    from worlds.forces import random_force

    rms = np.array([2.0, 0.0])
    share = int(kind.lstrip("abcdefghijklmnopqrstuvwxyz")) / 100
    forces = random_force(kind, rms, 200_000, 1, 0.005, np.random.default_rng(0))
    np.testing.assert_allclose(np.sqrt(np.mean(forces**2, axis=0)), share * rms, rtol=0.05)
    force = forces[:, 0] / forces[:, 0].std()
    kept = np.mean(force[40:] * force[:-40])  # after 0.2 s
    if kind.startswith("white"):
        assert abs(kept) < 0.02
    elif kind.startswith("memory"):
        assert kept == pytest.approx(np.exp(-1), abs=0.05)
    else:
        spectrum = signal.welch(force, fs=200, nperseg=4096)
        assert spectrum[0][np.argmax(spectrum[1])] == pytest.approx(20, abs=0.5)


def test_a_random_force_changes_the_path_and_not_the_commands():
    robots = _robots()
    calm, pushed = (
        robots.make_log("two_link", force=force, rows=50, episodes=1) for force in (None, "white20")
    )
    np.testing.assert_array_equal(calm.commands, pushed.commands)
    assert np.abs(calm.exact - pushed.exact).max() > 1e-3
    assert pushed.forces.std() > 0


def test_nats_are_half_the_square_of_a_slope_over_its_error_where_the_problem_is_linear():
    from worlds.worth import worth

    robots = _robots()
    log = robots.make_log("two_link", {"gain[elbow]": 1.001}, rows=100, episodes=1)
    halved = robots.make_log("two_link", {"gain[elbow]": 1.0005}, rows=100, episodes=1)
    whole, half = (worth(one)["gain[elbow]"][0] for one in (log, halved))
    assert whole == pytest.approx(4 * half, rel=0.02)


def test_two_causes_that_are_one_are_worth_nothing_beside_each_other():
    from worlds.worth import worth

    log = _robots().make_log("cart_pole", {"gain[push]": 1.1, "gain[all]": 1.1}, rows=60, episodes=1)
    for beside, alone in worth(log).values():
        assert beside < 1e-3 * alone


def test_noise_bound_without_random_forces_is_that_of_known_means():
    from worlds.worth import noise_bound

    log = _robots().make_log("cart_pole", rows=400, episodes=1)
    np.testing.assert_allclose(noise_bound(log), 1 / np.sqrt(2 * 400), rtol=0.03)
