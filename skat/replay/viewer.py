"""A motion in MuJoCo's viewer: a window to look at it from all sides."""

from __future__ import annotations

import os
import sys
import time
from typing import TYPE_CHECKING, Any

from skat.replay.frames import NoOpenGL, visual_model

if TYPE_CHECKING:
    from skat.replay.motion import Motion

SPACE, TAB = 32, 258
PAUSE_S = 0.01
WINDOW_S = 1 / 60


def show(simulator: Any, motion: Motion, *, speed: float = 1.0) -> None:
    """Show a motion over and over, until the window is closed. Space pauses, Tab changes the simulation.

    Parameters
    ----------
    simulator : MujocoSimulator
        Its model is drawn.
    motion : Motion
    speed : float, default=1
        Seconds of the log per second shown.

    Raises
    ------
    NoOpenGL
        If there is no display.
    """
    check_display()
    import mujoco
    from mujoco import viewer

    from skat.replay.drawing import add_ghost, place

    model = visual_model(simulator)
    data, other = mujoco.MjData(model), mujoco.MjData(model)
    names, state = list(motion.simulated), {"shown": 0, "paused": False}

    def press(key: int) -> None:
        if key == SPACE:
            state["paused"] = not state["paused"]
        elif key == TAB:
            state["shown"] = (state["shown"] + 1) % len(names)

    with viewer.launch_passive(
        model, data, key_callback=press, show_left_ui=False, show_right_ui=False
    ) as window:
        now, last = 0.0, time.monotonic()
        while window.is_running():
            step, last = time.monotonic() - last, time.monotonic()
            now = now if state["paused"] else (now + speed * step) % max(motion.time[-1], PAUSE_S)
            row = int(abs(motion.time - now).argmin())
            name = names[state["shown"]]
            with window.lock():
                place(model, data, motion.simulated[name][row])
                place(model, other, motion.measured[row])
                window.user_scn.ngeom = 0
                add_ghost(model, other, window.user_scn)
            said = f"{name}, {motion.time[row]:.2f} s"
            keys = "Space: pause" + ("; Tab: the other simulation" if len(names) > 1 else "")
            window.set_texts((None, None, said, keys))
            window.sync()
            time.sleep(WINDOW_S)


def check_display() -> None:
    """Raise `NoOpenGL` where there is no display to open a window on."""
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise NoOpenGL(
            "there is no display to open a window on (DISPLAY is not set): write a film, --film out.gif, or run it "
            "where there is one."
        )
