"""A film of a motion: the simulated robot and its measured ghost, a picture beside the other for each simulation."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skat.files import whole
from skat.replay.frames import SIZE, frames

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from skat.replay.motion import Motion

    Pictures = NDArray[np.uint8]

FORMATS = (".gif", ".mp4")
FPS = 25
# Pictures per second of a GIF: players slow down what is shown for a hundredth of a second.
MOST_IN_GIF = 50
# Of the letters on a picture, relative to its height.
LETTERS = 1 / 24
COLOURS = 128


def write_film(
    path: Path,
    simulator: Any,
    motion: Motion,
    *,
    fps: float = FPS,
    speed: float = 1.0,
    size: tuple[int, int] = SIZE,
    camera: str | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Path:
    """Write a film.

    Parameters
    ----------
    path : Path
        Its name ends in .gif or .mp4.
    simulator : MujocoSimulator
        Its model is drawn.
    motion : Motion
    fps : float, default=25
        Pictures per second of the film; of a GIF 50 at most, which counts in hundredths of a second.
    speed : float, default=1
        Seconds of the log per second of the film.
    size : tuple of two ints
        Width and height of each simulation's picture.
    camera : str, optional
        As in `frames`.
    progress : callable, optional
        Called with (stage, done, total).

    Returns
    -------
    Path

    Raises
    ------
    ValueError
        If the name ends in something else.
    RuntimeError
        If there is nothing to make MP4 with; `NoOpenGL` if there is nothing to draw with.
    """
    path = Path(path)
    kind = check_format(path)
    fps = min(fps, MOST_IN_GIF) if kind == ".gif" else fps
    n_frames = max(2, int(np.floor(motion.time[-1] / speed * fps)) + 1)
    shown = motion.at(np.arange(n_frames) * speed / fps)
    pictures = _side_by_side(simulator, shown, size, camera, progress)
    with whole(path) as draft:
        if kind == ".gif":
            _write_gif(draft, pictures, fps)
        else:
            _write_mp4(draft, pictures, fps)
    return path


def check_format(path: Path) -> str:
    """Return the end of a film's name, after a check that such a film can be made."""
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise ValueError(f"a film's name ends in {' or '.join(FORMATS)}; this one is called {path.name}.")
    if kind == ".mp4":
        _ffmpeg()
    return kind


def lettered(picture: Pictures, text: str) -> Pictures:
    """Return a picture with a line of text in its upper left corner."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(picture)
    height = max(11, round(picture.shape[0] * LETTERS))
    draw = ImageDraw.Draw(image)
    draw.text(
        (height // 2, height // 3),
        text,
        font=ImageFont.load_default(height),
        fill="black",
        stroke_width=max(1, height // 10),
        stroke_fill="white",
    )
    return np.asarray(image)


def _side_by_side(
    simulator: Any,
    motion: Motion,
    size: tuple[int, int],
    camera: str | None,
    progress: Callable[[str, int, int], None] | None,
) -> Iterator[Pictures]:
    """Yield a picture for each time, with one part for each simulation."""
    names, total = list(motion.simulated), len(motion.time)
    # One after the other in one process, so that all are seen from the same place.
    poses = np.stack([motion.simulated[name] for name in names], axis=1).reshape(-1, motion.measured.shape[1])
    ghosts = np.repeat(motion.measured, len(names), axis=0)
    drawn = frames(simulator, poses, ghosts, size=size, camera=camera)
    for done, time in enumerate(motion.time):
        parts = [lettered(next(drawn), f"{name}  {time:.2f} s") for name in names]
        yield np.concatenate(parts, axis=1)
        if progress is not None:
            progress("draw", done + 1, total)


def _write_gif(path: Path, pictures: Iterator[Pictures], fps: float) -> None:
    from PIL import Image

    first, *others = (
        Image.fromarray(picture).quantize(COLOURS, dither=Image.Dither.NONE) for picture in pictures
    )
    first.save(
        path,
        format="gif",
        save_all=True,
        append_images=others,
        duration=_durations(1 + len(others), fps),
        loop=0,
        optimize=True,
    )


def _durations(n: int, fps: float) -> list[int]:
    """Return for how many ms each picture of a GIF is shown, in whole hundredths of a second that add up."""
    ends = 10 * np.rint(100 * np.arange(n + 1) / fps).astype(int)
    return [int(one) for one in np.diff(ends)]


def _write_mp4(path: Path, pictures: Iterator[Pictures], fps: float) -> None:
    first = next(pictures)
    height, width = first.shape[:2]
    command = [_ffmpeg(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-", "-an"]
    command += ["-pix_fmt", "yuv420p", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-f", "mp4", str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            for picture in _again(first, pictures):
                process.stdin.write(picture.tobytes())  # type: ignore[union-attr]
        except BrokenPipeError:
            pass  # ffmpeg says why
        _, said = process.communicate()
    if process.returncode:
        raise RuntimeError(f"ffmpeg could not write the film: {said.decode(errors='replace').strip()}")


def _again(first: Pictures, others: Iterator[Pictures]) -> Iterator[Pictures]:
    yield first
    yield from others


def _ffmpeg() -> str:
    found = shutil.which("ffmpeg")
    if found:
        return found
    try:
        import imageio_ffmpeg
    except ImportError:
        raise RuntimeError(
            "an MP4 is written by ffmpeg, which is not installed: apt install ffmpeg, or pip install imageio-ffmpeg; "
            "or name the film .gif, which needs neither."
        ) from None
    return str(imageio_ffmpeg.get_ffmpeg_exe())
