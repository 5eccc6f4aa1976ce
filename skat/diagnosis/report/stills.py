"""Pictures of the robot where the simulation is furthest from what was measured."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from skat.diagnosis.report.content import Still

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from skat.diagnosis.report.content import Episode

SIZE = (480, 360)
# As a PNG with a palette a picture takes a quarter of the room.
COLOURS = 96


def worst_moment(simulator: Any, episode: Episode | None) -> tuple[tuple[Still, ...], str]:
    """Draw an episode's worst moment: the simulated robot, before and after, and the measured one as a ghost.

    `simulator`: as given. Where it is no MuJoCo model, or the episode has no positions, there is nothing to draw.
    Returns `note`: why there are none, where there could be.
    """
    from skat.replay import NoOpenGL, frames
    from skat.simulators import MujocoSimulator

    if episode is None or not isinstance(simulator, MujocoSimulator):
        return (), ""
    names = [name for name in simulator.state_names if name.startswith("qpos.")]
    shown = {series.name: series for series in episode.channels if series.name in names}
    if not shown:
        return (), ""
    moment = _worst(shown)
    rest = simulator.compiled().qpos0
    versions = {"as given": "nominal", "with its causes": "extended"}
    if any(series.extended is None for series in shown.values()):
        versions.pop("with its causes")
    measured = _pose(names, shown, "measured", moment, rest)
    poses = [_pose(names, shown, kind, moment, rest) for kind in versions.values()]
    if not np.isfinite([measured, *poses]).all():
        return (), "No picture of the robot: a simulation diverges."
    try:
        pictures = list(frames(simulator, poses, [measured] * len(poses), size=SIZE))
    except NoOpenGL as error:
        return (), f"No picture of the robot: {error}"
    when = f"{episode.time[moment]:.3g} s"
    stills = [
        Still(
            f"The simulation {version}, {when} into {_lowered(episode.label)}; the green ghost is what was measured.",
            f"The robot as simulated {version}, and as a ghost as measured.",
            _png(picture),
        )
        for version, picture in zip(versions, pictures, strict=True)
    ]
    return tuple(stills), ""


def _worst(shown: dict[str, Any]) -> int:
    """Return the row in which the simulation as given is furthest off, in spreads of what was measured."""
    total: NDArray[np.float64] = np.zeros(len(next(iter(shown.values())).measured))
    for series in shown.values():
        spread = np.nanstd(series.measured)
        total += np.nan_to_num(((series.nominal - series.measured) / (spread if spread > 0 else 1.0)) ** 2)
    return int(np.argmax(total))


def _pose(
    names: list[str], shown: dict[str, Any], kind: str, moment: int, rest: NDArray[np.float64]
) -> NDArray[np.float64]:
    pose = np.array(rest, dtype=float)
    for column, name in enumerate(names):
        if name in shown:
            pose[column] = getattr(shown[name], kind)[moment]
    return pose


def _png(picture: NDArray[np.uint8]) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    image = Image.fromarray(picture).quantize(COLOURS, dither=Image.Dither.NONE)
    image.save(buffer, format="png", optimize=True)
    return buffer.getvalue()


def _lowered(text: str) -> str:
    return text[:1].lower() + text[1:]
