"""The robot of a log, moving: the measured one as a ghost beside the simulated one."""

from skat.replay.film import write_film
from skat.replay.frames import NoOpenGL, frames
from skat.replay.motion import Motion, motion

__all__ = ["Motion", "NoOpenGL", "frames", "motion", "write_film"]
