"""The command ``skat replay``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skat.cli.commands import Force, Model, app
from skat.cli.measured import (
    Base,
    Columns,
    Episodes,
    FrameSkip,
    Maps,
    Motors,
    Rate,
    Topic,
    log_options,
    model_simulator,
    read_log,
    show_log,
)
from skat.cli.terminal import clear_errors, existing_path, output_file, print_line
from skat.progress import progress_bars

if TYPE_CHECKING:
    from skat.logs import Log
    from skat.simulators import MujocoSimulator

BEFORE, AFTER = "as given", "extended"


@app.command()
def replay(
    model: Model,
    log: Annotated[Path, typer.Argument(metavar="LOG", help="What was measured: a file or folder.")],
    extended: Annotated[
        Path | None,
        typer.Option(
            help="Extended model, as `skat diagnose --extended` writes it: it is shown beside MODEL."
        ),
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option(metavar="OUT.gif|OUT.mp4", help="Film to write. Default: MuJoCo's viewer, in a window."),
    ] = None,
    episode: Annotated[int, typer.Option(min=0, help="Number of the episode, from 0.")] = 0,
    horizon: Annotated[
        float | None,
        typer.Option(
            help="Seconds after which simulations start anew from what was measured. Default: whole episodes."
        ),
    ] = None,
    speed: Annotated[float, typer.Option(help="Seconds of the log per second shown.")] = 1.0,
    fps: Annotated[float, typer.Option(help="Pictures per second of a film; of a GIF 50 at most.")] = 25.0,
    width: Annotated[
        int, typer.Option(min=64, help="Width of each picture in pixels; 3/4 of it is its height.")
    ] = 640,
    camera: Annotated[
        str | None, typer.Option(help="Name of a camera of MODEL. Default: one that sees all of it.")
    ] = None,
    maps: Maps = None,
    columns: Columns = None,
    topic: Topic = None,
    rate: Rate = None,
    episodes: Episodes = None,
    base: Base = None,
    motors: Motors = None,
    frame_skip: FrameSkip = None,
    force: Force = False,
) -> None:
    """See LOG move: the measured robot as a ghost beside the simulated one, before and after.

    The simulations get the commands of LOG and start from its first row.
    """
    with clear_errors():
        import numpy as np

        from skat.replay import motion, write_film
        from skat.replay.film import check_format
        from skat.replay.viewer import show

        for name, value in (("--speed", speed), ("--fps", fps), ("--horizon", horizon)):
            if value is not None and not 0 < value < float("inf"):
                raise ValueError(f"{name} must be positive; it is {value:g}.")
        if film is not None:
            film = output_file(film, force=force)
            check_format(film)
        simulator = model_simulator(model, base, motors)
        found = read_log(
            [log], simulator, log_options(simulator, maps, columns, topic, rate, episodes, base, frame_skip)
        )
        show_log(found, None, force)
        if episode >= len(found.group_names):
            raise ValueError(
                f"--episode {episode}: {found.source} has {len(found.group_names)} episodes, from 0 on."
            )
        simulators = {BEFORE: found.simulator}
        if extended is not None:
            simulators[AFTER] = _extended(extended, found)
        rows = np.flatnonzero(found.groups == episode)
        seen = motion(
            simulators,
            found.X[rows],
            found.y[rows],
            rest=found.simulator.compiled().qpos0,
            horizon=None if horizon is None else max(1, round(horizon / found.dt)),
        )
        for note in seen.notes:
            print_line(f"  {note}")
        if film is None:
            show(found.simulator, seen, speed=speed)
            return
        with progress_bars() as progress:
            write_film(
                film,
                found.simulator,
                seen,
                fps=fps,
                speed=speed,
                size=(width, 3 * width // 4),
                camera=camera,
                progress=progress,
            )
        print_line(f"Film: {film}")


def _extended(path: Path, log: "Log") -> "MujocoSimulator":
    """Return the extended model as a simulator with the log's time from row to row."""
    from skat.simulators import MujocoSimulator

    better = MujocoSimulator(existing_path(path, "a model: MJCF, URDF or a robot's folder"))
    steps = log.dt / better.dt
    if abs(steps - round(steps)) > 1e-6 * steps or round(steps) < 1:
        raise ValueError(
            f"{path} has a time step of {better.dt:g} s, of which {log.dt:g} s from row to row of {log.source} are no "
            "whole number: replay the log with an extended model that was written from it."
        )
    return MujocoSimulator(better.model, frame_skip=round(steps))
