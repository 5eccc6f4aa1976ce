"""Poses over an episode: what is held, what is at rest, when simulations start anew, and how films run."""

import numpy as np
import pytest
from PIL import Image

from skat.replay.film import _write_gif
from skat.replay.motion import Motion, _filled, _held, _rolled_out
from skat.simulators import FunctionSimulator

DT = 0.5


@pytest.fixture
def cart():
    names = ("qpos.x", "qvel.x")
    return FunctionSimulator(
        lambda X: np.stack([X[:, 0] + DT * X[:, 1], X[:, 1] + DT * X[:, 2]], axis=1),
        input_names=(*names, "ctrl.x"),
        output_names=names,
        state_names=names,
        dt=DT,
    )


def test_what_is_not_finite_is_held_and_otherwise_taken_from_elsewhere():
    nan, values = np.nan, np.array([[np.nan, 5.0], [2.0, np.nan], [np.nan, np.inf], [3.0, 7.0]])
    otherwise = np.arange(8.0).reshape(4, 2)
    np.testing.assert_array_equal(_held(values, otherwise), [[0, 5], [2, 5], [2, 5], [3, 7]])
    np.testing.assert_array_equal(_held(np.full((2, 1), nan), otherwise[:2, :1]), [[0], [2]])


def test_velocities_are_held_where_they_begin_and_else_as_positions_change():
    names = ("qpos.a", "qpos.b", "qvel.a", "qvel.b", "qvel.c")
    time = DT * np.arange(5)
    states = np.column_stack([time**2, 3 * time, np.full(5, np.nan), np.arange(5.0), np.full(5, np.nan)])
    states[2, 3], states[3, 2], states[1, 1] = np.nan, 9.0, np.nan
    found = _filled(states, 2, np.array([-1.0, -2.0]), DT, names)
    np.testing.assert_array_equal(found[:, 1], [0, 0, 3, 4.5, 6])
    np.testing.assert_allclose(found[:, 2], [0.5, 1.0, 2.0, 9.0, 3.5])
    np.testing.assert_array_equal(found[:, 3], [0, 1, 1, 3, 4])
    np.testing.assert_array_equal(found[:, 4], 0)
    states[:, 0] = np.nan
    np.testing.assert_array_equal(_filled(states, 2, np.array([-1.0, -2.0]), DT, names)[:, 0], -1)


@pytest.mark.parametrize("horizon", [None, 0, 1, 2, 3, 4, 5, 6, 7, 100])
def test_a_simulation_starts_anew_every_horizon(cart, horizon):
    rng = np.random.default_rng(0)
    states, commands = rng.normal(size=(8, 2)), rng.normal(size=(7, 1))
    found = _rolled_out(cart, states, commands, horizon)
    state, every = states[0], horizon or 7
    for row in range(8):
        if row % every == 0 and row < 7:
            state = states[row]
        np.testing.assert_allclose(found[row], state, atol=1e-12)
        if row < 7:
            state = cart.predict(np.r_[state, commands[row]][None])[0]


def test_a_time_is_that_of_the_nearest_row():
    time = np.array([0.0, 1.0, 3.0])
    poses = np.arange(3.0)[:, None]
    motion = Motion(time, poses, {"m": 10 * poses}, ("said",))
    found = motion.at(np.array([-5, 0.49, 0.51, 1.9, 2.1, 3.0, 50.0]))
    np.testing.assert_array_equal(found.time, [0, 0, 1, 1, 3, 3, 3])
    np.testing.assert_array_equal(found.simulated["m"], 10 * found.measured)
    assert found.notes == ("said",)


@pytest.mark.parametrize("fps", [10.0, 20.0])
def test_a_gif_runs_at_the_speed_that_was_asked_for_without_end(tmp_path, fps):
    pictures = [np.full((20, 30, 3), shade, np.uint8) for shade in (0, 100, 200)]
    _write_gif(tmp_path / "film.gif", iter(pictures), fps)
    with Image.open(tmp_path / "film.gif") as film:
        assert (film.n_frames, film.size) == (3, (30, 20))
        assert film.info["loop"] == 0  # for ever
        assert film.info["duration"] == 1000 / fps
        for index, picture in enumerate(pictures):
            film.seek(index)
            np.testing.assert_allclose(np.asarray(film.convert("RGB")), picture, atol=3)
