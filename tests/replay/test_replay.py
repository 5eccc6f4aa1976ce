import contextlib
import itertools
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pandas as pd
import pytest
from PIL import Image
from typer.testing import CliRunner

from skat.cli import app
from skat.replay import Motion, NoOpenGL, frames, motion, write_film
from skat.replay.film import lettered
from skat.replay.frames import backend, visual_model
from skat.replay.viewer import check_display, show
from skat.simulators import MujocoSimulator

ARM = """
<mujoco model="arm">
  <option timestep="0.005"/>
  <worldbody>
    <light pos="0 0 3"/>
    <geom type="plane" size="2 2 .1" rgba=".7 .7 .7 1"/>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="0.3"/>
      <geom type="capsule" size=".05" fromto="0 0 0 0.4 0 0" rgba=".8 .4 .2 1"/>
      <body name="lower" pos="0.4 0 0">
        <joint name="elbow" type="hinge" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" size=".04" fromto="0 0 0 0.35 0 0" rgba=".3 .4 .8 1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/></actuator>
</mujoco>
"""
SIZE = (200, 150)
N_FRAMES = 20
# MuJoCo's own renderer, asked which pixels belong to the moving geoms: the reference for where a ghost is to be.
SEGMENTATION = """
import sys
import mujoco, numpy as np
from skat.replay.drawing import seeing_all
with np.load(sys.argv[2]) as job:
    poses, others = job["poses"], job["others"]
model = mujoco.MjModel.from_binary_path(sys.argv[1])
data = mujoco.MjData(model)
camera = seeing_all(model, np.concatenate([others, poses]))
masks = []
with mujoco.Renderer(model, {height}, {width}) as renderer:
    renderer.enable_segmentation_rendering()
    for pose in poses:
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        renderer.update_scene(data, camera)
        ids, kinds = np.moveaxis(renderer.render(), -1, 0)
        bodies = model.geom_bodyid[np.maximum(ids, 0)]
        masks.append((kinds == mujoco.mjtObj.mjOBJ_GEOM) & (ids >= 0) & (bodies > 0))
np.save(sys.argv[3], np.array(masks))
"""


@pytest.fixture(scope="module")
def opengl():
    try:
        return backend()
    except NoOpenGL as error:
        pytest.skip(f"needs OpenGL: {error}")


@pytest.fixture(scope="module")
def arm():
    return MujocoSimulator(ARM, frame_skip=2)


def measured(simulator, n_steps=100, seed=0, **effects):
    """Return X and y of an episode in a world with effects."""
    rng = np.random.default_rng(seed)
    commands = np.cumsum(rng.standard_normal((n_steps, 2)), axis=0) * 0.1
    path = simulator.rollout(np.zeros((1, 4)), commands[None], n_steps=n_steps, effects=effects)[0]
    return np.hstack([path[:-1], commands]), path[1:]


def segmented(model, poses, others, folder, opengl):
    """Return the pixels (n_frames, height, width) that MuJoCo gives to what moves."""
    mujoco.mj_saveModel(model, str(folder / "model.mjb"))
    np.savez(folder / "job.npz", poses=poses, others=others)
    code = SEGMENTATION.format(width=SIZE[0], height=SIZE[1])
    arguments = [sys.executable, "-c", code, folder / "model.mjb", folder / "job.npz", folder / "masks.npy"]
    subprocess.run(arguments, check=True, env={**os.environ, "MUJOCO_GL": opengl})
    return np.load(folder / "masks.npy")


def grown(masks):
    """Return masks with the pixels next to theirs: edges are smoothed."""
    padded = np.pad(masks, ((0, 0), (1, 1), (1, 1)))
    height, width = masks.shape[1:]
    return np.any([padded[:, i : i + height, j : j + width] for i in range(3) for j in range(3)], axis=0)


# -- pictures ------------------------------------------------------------------------------------------------


def test_the_ghost_is_where_mujoco_s_segmentation_puts_the_measured_robot(arm, tmp_path, opengl):
    X, y = measured(arm, **{"damping[elbow]": 1.0})
    seen = motion({"m": arm}, X, y, rest=np.zeros(2)).at(np.linspace(0.05, 1, N_FRAMES))
    poses = seen.simulated["m"]
    both = np.array(list(frames(arm, poses, seen.measured, size=SIZE)), dtype=int)
    # The same view without a ghost: the camera sees all poses, so all are given.
    alone = np.array(list(frames(arm, np.vstack([poses, seen.measured]), size=SIZE))[:N_FRAMES], dtype=int)
    ghost = np.abs(both - alone).max(axis=-1) > 12
    model = visual_model(arm, SIZE)
    place = segmented(model, seen.measured, poses, tmp_path, opengl)
    robot = segmented(model, poses, seen.measured, tmp_path, opengl)
    assert len(both) == N_FRAMES
    assert not (ghost & ~grown(place)).any()
    # Where the simulated robot is not in front of it, all of the ghost is seen, but for its smoothed edge.
    free = place & ~grown(robot) & ~grown(~place)
    assert free.sum() > 200
    assert ghost[free].all()
    # A ghost one frame late would not pass.
    assert (np.roll(ghost, 1, axis=0) & ~grown(place)).any()


def test_before_and_after_are_drawn_with_the_ghost_further_off_before(arm, opengl):
    X, y = measured(arm, **{"damping[elbow]": 1.0})
    better = arm.extended({"damping[elbow]": 1.0})
    seen = motion({"as given": arm, "extended": better}, X, y, rest=np.zeros(2))
    np.testing.assert_allclose(seen.simulated["extended"], seen.measured, atol=1e-9)
    assert np.abs(seen.simulated["as given"] - seen.measured).max() > 0.1
    shown = seen.at(np.array([0.9]))
    before, after = frames(
        arm, np.vstack(list(shown.simulated.values())), np.repeat(shown.measured, 2, axis=0), size=SIZE
    )
    assert (np.abs(before.astype(int) - after).max(axis=-1) > 30).mean() > 0.002


def test_pictures_have_the_size_that_was_asked_for_also_beyond_the_model_s_own(arm, opengl):
    (picture,) = frames(arm, np.zeros((1, 2)), size=(1000, 700))
    assert picture.shape == (700, 1000, 3)
    assert picture.std() > 5


def test_a_camera_that_is_not_there_is_named(arm):
    with pytest.raises(ValueError, match="no camera 'front'; it has none"):
        list(frames(arm, np.zeros((1, 2)), camera="front"))
    with pytest.raises(ValueError, match="2 poses and 1 ghosts"):
        list(frames(arm, np.zeros((2, 2)), np.zeros((1, 2))))


def test_without_opengl_the_remedy_is_said(arm, monkeypatch):
    backend.cache_clear()
    monkeypatch.setenv("MUJOCO_GL", "off")
    try:
        with pytest.raises(
            NoOpenGL, match=r"found no OpenGL to draw with .*apt install libegl1 .*libosmesa6"
        ):
            list(frames(arm, np.zeros((1, 2))))
    finally:
        backend.cache_clear()


def test_without_a_display_a_film_is_offered(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(NoOpenGL, match=r"no display .*--film out\.gif"):
        check_display()


def test_in_a_window_space_pauses_and_tab_changes_the_simulation(arm, monkeypatch):
    keys, said = pytest.importorskip("glfw"), []
    pressed = {2: keys.KEY_SPACE, 4: keys.KEY_SPACE, 6: keys.KEY_TAB}

    def launched(model, data, *, key_callback, **options):
        def is_running():
            if len(said) in pressed:
                key_callback(pressed[len(said)])
            return len(said) < 8

        window = SimpleNamespace(
            is_running=is_running,
            lock=contextlib.nullcontext,
            user_scn=mujoco.MjvScene(model, 100),
            set_texts=lambda texts: said.append(texts[2]),
            sync=lambda: None,
        )
        return contextlib.nullcontext(window)

    tenths = itertools.count()  # The clock is asked twice a picture, a tenth of a second apart.
    clock = SimpleNamespace(monotonic=lambda: next(tenths) / 10, sleep=lambda seconds: None)
    monkeypatch.setattr("skat.replay.viewer.time", clock)
    monkeypatch.setattr("skat.replay.viewer.check_display", lambda: None)
    monkeypatch.setattr(mujoco, "viewer", SimpleNamespace(launch_passive=launched), raising=False)
    poses = np.zeros((21, 2))
    show(arm, Motion(np.arange(21) / 10, poses, {"given": poses, "extended": poses}))
    assert said == [
        *("given, 0.10 s", "given, 0.20 s", "given, 0.20 s", "given, 0.20 s"),
        *("given, 0.30 s", "given, 0.40 s", "extended, 0.50 s", "extended, 0.60 s"),
    ]


# -- motions -------------------------------------------------------------------------------------------------


def test_a_simulation_of_its_own_log_goes_where_the_log_goes(arm):
    X, y = measured(arm)
    for horizon in (None, 1, 7, 1000):
        seen = motion({"as given": arm}, X, y, rest=np.zeros(2), horizon=horizon)
        np.testing.assert_allclose(seen.simulated["as given"], np.vstack([X[:1, :2], y[:, :2]]), atol=1e-9)
        assert seen.time[-1] == pytest.approx(len(X) * arm.dt)
        assert seen.notes == ()


def test_with_a_horizon_simulations_start_anew_from_what_was_measured(arm):
    X, y = measured(arm, **{"damping[elbow]": 1.0})
    far = motion({"m": arm}, X, y, rest=np.zeros(2))
    near = motion({"m": arm}, X, y, rest=np.zeros(2), horizon=10)
    np.testing.assert_array_equal(near.simulated["m"][::10][:-1], near.measured[::10][:-1])
    errors = [np.abs(one.simulated["m"] - one.measured).max() for one in (near, far)]
    assert errors[0] < 0.5 * errors[1]


def test_velocities_that_were_not_measured_are_those_of_the_positions(arm):
    X, y = measured(arm)
    for table in (X, y):
        table[:, 2:4] = np.nan
    X[30:33, :2] = y[29:32, :2] = np.nan
    seen = motion({"m": arm}, X, y, rest=np.zeros(2))
    assert "qvel.shoulder, qvel.elbow were not measured" in seen.notes[0]
    assert np.isfinite(seen.simulated["m"]).all()
    np.testing.assert_array_equal(seen.measured[30:33], np.repeat(seen.measured[29:30], 3, axis=0))


def test_a_joint_that_only_the_extended_model_has_is_at_rest(arm):
    X, y = measured(arm)
    more = ARM.replace(
        'name="lower" pos="0.4 0 0">', 'name="lower" pos="0.4 0 0"><joint name="play" range="0 1e-6"/>'
    )
    seen = motion({"m": arm, "more": MujocoSimulator(more, frame_skip=2)}, X, y, rest=np.zeros(2))
    assert seen.simulated["more"].shape == seen.measured.shape
    fewer = ARM.replace('<joint name="elbow" type="hinge" axis="0 1 0" damping="0.1"/>', "")
    fewer = MujocoSimulator(fewer.replace('<motor name="elbow" joint="elbow"/>', ""), frame_skip=2)
    with pytest.raises(ValueError, match=r"lacks qpos\.elbow, qvel\.elbow"):
        motion({"m": arm, "fewer": fewer}, X, y, rest=np.zeros(2))


def test_times_are_taken_from_the_nearest_rows():
    time = np.array([0.0, 0.1, 0.2])
    poses = np.array([[0.0], [1.0], [2.0]])
    shown = Motion(time, poses, {"m": poses}).at(np.array([-1.0, 0.04, 0.06, 0.16, 9.0]))
    assert shown.measured[:, 0].tolist() == [0, 0, 1, 2, 2]


# -- films and the command -----------------------------------------------------------------------------------


@pytest.fixture
def here(tmp_path, monkeypatch, arm):
    monkeypatch.chdir(tmp_path)
    Path("arm.xml").write_text(ARM)
    X, y = measured(arm, n_steps=60, **{"damping[elbow]": 1.0})
    names = [*arm.state_names, "ctrl.shoulder", "ctrl.elbow"]
    table = pd.DataFrame(np.vstack([X, [*y[-1], 0, 0]]), columns=names)
    table.insert(0, "time", np.arange(len(table)) * arm.dt)
    table.to_csv("log.csv", index=False)
    arm.extended({"damping[elbow]": 1.0}).to_mjcf("better.xml")
    return tmp_path


def skat(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_a_film_shows_both_simulations_beside_each_other_at_the_log_s_speed(here, opengl):
    result = skat(
        "replay",
        "arm.xml",
        "log.csv",
        "--extended",
        "better.xml",
        "--film",
        "out.gif",
        "--fps",
        10,
        "--width",
        160,
    )
    assert result.exit_code == 0, result.output
    assert "Film: out.gif" in result.stdout
    with Image.open("out.gif") as film:
        assert film.size == (2 * 160, 120)
        assert film.n_frames == 7
        assert film.info["duration"] == 100
        film.seek(6)
        last = np.asarray(film.convert("RGB"), dtype=int)
    left, right = last[20:, :160], last[20:, 160:]
    assert (np.abs(left - right).max(axis=-1) > 30).mean() > 0.002
    assert skat("replay", "arm.xml", "log.csv", "--film", "out.gif").exit_code == 2


def test_a_film_without_an_extended_model_shows_one_simulation(here, opengl):
    options = ["--film", "one.gif", "--fps", 5, "--width", 128, "--speed", 0.5, "--horizon", 0.1]
    result = skat("replay", "arm.xml", "log.csv", *options)
    assert result.exit_code == 0, result.output
    with Image.open("one.gif") as film:
        assert film.size == (128, 96)
        assert film.n_frames == 7


def test_the_command_without_opengl_ends_with_code_2_and_the_remedy(here, monkeypatch):
    backend.cache_clear()
    monkeypatch.setenv("MUJOCO_GL", "off")
    try:
        result = skat("replay", "arm.xml", "log.csv", "--film", "out.gif")
    finally:
        backend.cache_clear()
    assert result.exit_code == 2
    assert "apt install libosmesa6" in result.stderr
    assert "Traceback" not in result.output
    assert not Path("out.gif").exists()


def test_the_command_without_a_display_ends_with_code_2_and_offers_a_film(here, monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    result = skat("replay", "arm.xml", "log.csv")
    assert result.exit_code == 2
    assert "--film out.gif" in result.stderr


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--film", "out.avi"], "ends in .gif or .mp4"),
        (["--film", "out.gif", "--episode", "3"], "has 1 episodes"),
        (["--film", "out.gif", "--speed", "0"], "--speed must be positive"),
        (["--film", "out.gif", "--extended", "none.xml"], "no file none.xml"),
        (["--film", "out.gif", "--extended", "slow.xml"], "no whole number"),
        (["--film", "no/out.gif"], "no folder no"),
    ],
)
def test_bad_calls_end_with_one_message(here, options, said):
    Path("slow.xml").write_text(ARM.replace('timestep="0.005"', 'timestep="0.007"'))
    result = skat("replay", "arm.xml", "log.csv", *options)
    assert result.exit_code == 2
    assert said in result.stderr
    assert sorted(path.name for path in here.iterdir()) == ["arm.xml", "better.xml", "log.csv", "slow.xml"]


def test_a_film_in_mp4_needs_ffmpeg_and_says_so(arm, tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    poses = np.zeros((2, 2))
    with pytest.raises(
        RuntimeError, match=r"apt install ffmpeg, or pip install imageio-ffmpeg; or name the film \.gif"
    ):
        write_film(tmp_path / "out.mp4", arm, Motion(np.array([0, 0.1]), poses, {"m": poses}))
    assert not list(tmp_path.iterdir())


def test_a_film_in_mp4_is_one_that_ffprobe_can_read(arm, tmp_path, opengl):
    from shutil import which

    if not which("ffprobe"):
        pytest.skip("needs ffmpeg with ffprobe")
    poses = np.zeros((11, 2))
    path = write_film(
        tmp_path / "out.mp4", arm, Motion(np.arange(11) / 10, poses, {"m": poses}), fps=10, size=SIZE
    )
    probe = ["ffprobe", "-v", "error", "-count_frames", "-show_streams", "-of", "json", path]
    (stream,) = json.loads(subprocess.run(probe, capture_output=True, check=True).stdout)["streams"]
    assert (stream["width"], stream["height"], stream["nb_read_frames"]) == (*SIZE, "11")


@pytest.mark.parametrize(
    ("fps", "n_pictures"), [(10, 21), (24, 49), (30, 61), (50, 101), (60, 101), (1000, 101)]
)
def test_a_gif_lasts_as_long_as_its_log_at_any_rate(arm, tmp_path, monkeypatch, fps, n_pictures):
    def drawn(simulator, motion, *others):
        for shade in range(len(motion.time)):
            yield np.full((4, 4, 3), shade, dtype=np.uint8)

    monkeypatch.setattr("skat.replay.film._side_by_side", drawn)
    poses = np.zeros((201, 2))
    path = write_film(tmp_path / "out.gif", arm, Motion(np.arange(201) / 100, poses, {"m": poses}), fps=fps)
    with Image.open(path) as film:
        durations = []
        for place in range(film.n_frames):
            film.seek(place)
            durations.append(film.info["duration"])
    assert len(durations) == n_pictures
    assert min(durations) >= 20
    assert np.abs(np.cumsum(durations) - 1000 * np.arange(1, n_pictures + 1) / min(fps, 50)).max() <= 5


def test_letters_are_in_the_corner_and_nowhere_else():
    plain = np.full((150, 200, 3), 128, dtype=np.uint8)
    written = lettered(plain, "as given")
    assert (written != plain).any()
    assert (written[40:] == plain[40:]).all()
