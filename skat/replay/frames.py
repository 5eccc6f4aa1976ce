"""Pictures of a robot and its ghost, drawn by MuJoCo in a process of its own.

MuJoCo chooses its OpenGL once, as it is imported: only a new process can try another one, and a driver that fails takes
no diagnosis with it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

    Pictures = NDArray[np.uint8]

SIZE = (640, 480)
REMEDY = (
    "Without a display, install one that draws in memory: on Debian and Ubuntu `apt install libegl1 libgl1-mesa-dri` "
    "(MUJOCO_GL=egl) or `apt install libosmesa6` (MUJOCO_GL=osmesa)."
)
READY = b"ready\n"


class NoOpenGL(RuntimeError):
    """MuJoCo has no OpenGL to draw with."""


def frames(
    simulator: Any,
    simulated: ArrayLike,
    ghosts: ArrayLike | None = None,
    *,
    size: tuple[int, int] = SIZE,
    camera: str | None = None,
) -> Iterator[Pictures]:
    """Draw a robot in poses, and as a ghost in others.

    Parameters
    ----------
    simulator : MujocoSimulator
        Its model, with all that the eye needs, is drawn.
    simulated : array-like of shape (n_frames, n_positions)
        Poses (qpos) of the solid robot.
    ghosts : array-like of shape (n_frames, n_positions), optional
        Poses of the ghost.
    size : tuple of two ints
        Width and height in pixels.
    camera : str, optional
        Name of a camera of the model. By default one that sees all poses.

    Yields
    ------
    ndarray of uint8 of shape (height, width, 3)

    Raises
    ------
    NoOpenGL
        If MuJoCo has none to draw with.
    ValueError
        If the model has no such camera.
    """
    import mujoco

    model = visual_model(simulator, size)
    if camera is not None and mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera) < 0:
        names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_CAMERA, index) for index in range(model.ncam)]
        there = f"it has {', '.join(map(str, names))}" if names else "it has none"
        raise ValueError(f"the model has no camera {camera!r}; {there}.")
    poses = np.asarray(simulated, dtype=float).reshape(-1, model.nq)
    others = (
        np.empty((0, model.nq)) if ghosts is None else np.asarray(ghosts, dtype=float).reshape(-1, model.nq)
    )
    if len(others) not in (0, len(poses)):
        raise ValueError(
            f"a ghost for each pose is needed; there are {len(poses)} poses and {len(others)} ghosts."
        )
    with TemporaryDirectory() as folder:
        mujoco.mj_saveModel(model, str(Path(folder, "model.mjb")))
        name = np.array(camera or "")
        np.savez(Path(folder, "poses.npz"), simulated=poses, ghosts=others, size=np.array(size), camera=name)
        yield from _drawn(folder, len(poses), size)


def visual_model(simulator: Any, size: tuple[int, int] = SIZE) -> Any:
    """Return the compiled model of a simulator with all that the eye needs, and room for pictures of a size.

    Parameters
    ----------
    simulator : MujocoSimulator
    size : tuple of two ints

    Returns
    -------
    mujoco.MjModel
    """
    import mujoco

    spec = simulator.model.spec()
    spec.compiler.discardvisual = False
    spec.visual.global_.offwidth = max(size[0], spec.visual.global_.offwidth)
    spec.visual.global_.offheight = max(size[1], spec.visual.global_.offheight)
    if not any(texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX for texture in spec.textures):
        spec.add_texture(
            name="skat.sky",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=[0.75, 0.80, 0.86],
            rgb2=[0.94, 0.95, 0.96],
            width=128,
            height=768,
        )
    return spec.compile()


def _drawn(folder: str, n_frames: int, size: tuple[int, int]) -> Iterator[Pictures]:
    with _process(backend(), folder) as process:
        pipe = process.stdout
        if pipe is None or pipe.readline() != READY:
            raise NoOpenGL(f"MuJoCo cannot draw here: {_last_line(process)}. {REMEDY}")
        n_bytes = size[0] * size[1] * 3
        for _ in range(n_frames):
            raw = pipe.read(n_bytes)
            if len(raw) < n_bytes:
                raise NoOpenGL(f"MuJoCo stopped drawing: {_last_line(process)}")
            yield np.frombuffer(raw, dtype=np.uint8).reshape(size[1], size[0], 3)


@cache
def backend() -> str:
    """Return the value of MUJOCO_GL with which MuJoCo can draw here.

    Raises
    ------
    NoOpenGL
        If there is none.
    """
    failures = []
    for name in _candidates():
        with _process(name, "") as process:
            if process.stdout is not None and process.stdout.readline() == READY:
                return name
            failures.append(f"{name or 'default'}: {_last_line(process)}")
    raise NoOpenGL(f"MuJoCo found no OpenGL to draw with ({'; '.join(failures)}). {REMEDY}")


def _candidates() -> tuple[str, ...]:
    given = os.environ.get("MUJOCO_GL", "")
    if given or not sys.platform.startswith("linux"):
        return (given,)
    return ("egl", "osmesa", "glfw") if os.environ.get("DISPLAY") else ("egl", "osmesa")


def _process(name: str, folder: str) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "MUJOCO_GL": name}
    environment.pop("PYOPENGL_PLATFORM", None)
    return subprocess.Popen(
        [sys.executable, "-m", "skat.replay.drawing", folder],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def _last_line(process: subprocess.Popen[bytes]) -> str:
    """Return what a process that failed said last."""
    _, said = process.communicate()
    lines = said.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else f"it ended with {process.returncode}"
