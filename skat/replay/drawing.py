"""The process that draws the poses in a folder: ``python -m skat.replay.drawing FOLDER`` writes pictures to its output.

Without a folder it only says whether it could.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

GHOST = (0.1, 0.75, 0.5, 0.4)
# Relative to the robot: a ghost in the very place of the robot is within it, in the place of patches of both.
GHOST_SIZE = 0.98
# Of the distance at which a ball around all poses fills the picture.
ROOM = 0.85
# From above, and from the side.
ELEVATION, AZIMUTH = -20.0, 120.0
# Radius beyond which a geom is scenery; planes have none.
TINY = 1e-9
READY = "ready"


def draw(folder: str) -> None:
    """Write the pictures of a folder, as raw bytes, after a line that says that it works."""
    if not folder:
        with mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8) as renderer:
            renderer.render()
        print(READY, flush=True)
        return
    model = mujoco.MjModel.from_binary_path(str(Path(folder, "model.mjb")))
    with np.load(Path(folder, "poses.npz")) as poses:
        simulated, ghosts, size = poses["simulated"], poses["ghosts"], poses["size"]
        name = str(poses["camera"])
    camera: Any = name or seeing_all(model, np.concatenate([simulated, ghosts]))
    width, height = (int(one) for one in size)
    with mujoco.Renderer(model, height, width) as renderer:
        # Shadows take most of the time where the processor draws, and the ghost would cast one.
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        renderer.render()
        print(READY, flush=True)
        data, other = mujoco.MjData(model), mujoco.MjData(model)
        for frame, pose in enumerate(simulated):
            place(model, data, pose)
            renderer.update_scene(data, camera)
            if len(ghosts):
                place(model, other, ghosts[frame])
                add_ghost(model, other, renderer.scene)
            sys.stdout.buffer.write(renderer.render().tobytes())
        sys.stdout.buffer.flush()


def place(model: mujoco.MjModel, data: mujoco.MjData, pose: Array) -> None:
    """Bring a robot into a pose."""
    data.qpos[:] = pose
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    mujoco.mj_tendon(model, data)


def add_ghost(model: mujoco.MjModel, data: mujoco.MjData, scene: mujoco.MjvScene) -> None:
    """Add what moves of a robot to a scene, transparent and in one colour."""
    first = scene.ngeom
    mujoco.mjv_addGeoms(
        model,
        data,
        mujoco.MjvOption(),
        mujoco.MjvPerturb(),
        mujoco.mjtCatBit.mjCAT_DYNAMIC,
        scene,
    )
    for index in range(first, scene.ngeom):
        geom = scene.geoms[index]
        geom.rgba[:] = GHOST
        geom.size[:] *= GHOST_SIZE
        geom.matid = -1
        geom.transparent = True


def seeing_all(model: mujoco.MjModel, poses: Array) -> mujoco.MjvCamera:
    """Return a camera that has what moves in the picture, in all of some poses."""
    data = mujoco.MjData(model)
    moving = np.flatnonzero((model.body_weldid[model.geom_bodyid] != 0) & (model.geom_rbound > TINY))
    if not len(moving):
        moving = np.flatnonzero(model.geom_rbound > TINY)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for pose in poses[:: max(1, len(poses) // 100)]:
        place(model, data, pose)
        radii = model.geom_rbound[moving, None]
        low = np.minimum(low, (data.geom_xpos[moving] - radii).min(axis=0, initial=np.inf))
        high = np.maximum(high, (data.geom_xpos[moving] + radii).max(axis=0, initial=-np.inf))
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.azimuth, camera.elevation = AZIMUTH, ELEVATION
    if np.isfinite(low).all():
        camera.lookat[:] = (low + high) / 2
        radius = np.linalg.norm(high - low) / 2
        camera.distance = ROOM * radius / np.sin(np.deg2rad(model.vis.global_.fovy) / 2)
    return camera


if __name__ == "__main__":
    draw(sys.argv[1] if len(sys.argv) > 1 else "")
