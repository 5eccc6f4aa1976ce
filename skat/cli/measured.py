"""The commands that take a model and logs: ``skat diagnose``, ``changed``, ``check`` and ``preflight``."""

import shlex
import sys
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skat.cli.commands import (
    Alpha,
    Effects,
    Force,
    Model,
    Seed,
    app,
    report_path,
    show_study,
    write_report,
)
from skat.cli.many import diagnose_fleet
from skat.cli.terminal import (
    check_apart,
    clear_errors,
    existing_path,
    heard,
    output_console,
    output_file,
    print_line,
    table_of,
)
from skat.files import whole
from skat.progress import progress_bars

if TYPE_CHECKING:
    import pandas as pd

    from skat.experiments.studies import Study
    from skat.logs import Log
    from skat.logs.suspects import Suspect
    from skat.simulators import MujocoSimulator, Simulator

Logs = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG...", help="What was measured: files or folders; each is episodes of its own."
    ),
]
Maps = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="NAME=THEIRS[:UNIT]",
        help="Which column is which, such as 'qpos.elbow=q1:deg'; repeat.",
    ),
]
Columns = Annotated[Path | None, typer.Option(help="File of such maps, as --save-map writes it.")]
SaveMap = Annotated[Path | None, typer.Option(help="File to write the maps to that were used (TOML).")]
Topic = Annotated[str | None, typer.Option(help="Topic of a bag that holds the state.")]
Rate = Annotated[
    float | None, typer.Option(help="Rows per second to resample to; of a log without times, its rate.")
]
Episodes = Annotated[
    str | None,
    typer.Option(metavar="COLUMN|gaps", help="What tells episodes apart. Default: such a column, and gaps."),
]
Base = Annotated[
    str | None,
    typer.Option(metavar="fixed|free", help="Whether the model's root is bolted down or moves freely."),
]
Motors = Annotated[
    str | None,
    typer.Option(
        metavar="torque|position:KP,KV|none",
        help="What drives the joints of a model without actuators, as a URDF is.",
    ),
]
FrameSkip = Annotated[
    int | None,
    typer.Option(min=1, help="Steps of the model between two rows; sets the rate, as --rate does."),
]


class Velocities(StrEnum):
    """What the velocities of a log are."""

    auto = "auto"
    measured = "measured"
    computed = "computed"


class Actions(StrEnum):
    """What the actions of a log are."""

    auto = "auto"
    commanded = "commanded"
    measured = "measured"


Jobs = Annotated[int | None, typer.Option(help="Processes to use; -1: one per core.")]


@app.command()
def diagnose(
    model: Model,
    log: Logs,
    test: Annotated[
        list[Path] | None, typer.Option(help="Another log, which measures the gain; repeat for several.")
    ] = None,
    maps: Maps = None,
    columns: Columns = None,
    save_map: SaveMap = None,
    topic: Topic = None,
    rate: Rate = None,
    episodes: Episodes = None,
    base: Base = None,
    motors: Motors = None,
    frame_skip: FrameSkip = None,
    effect: Effects = None,
    hidden: Annotated[
        list[str] | None, typer.Option(help="Name of a state column that is a guess, no measurement; repeat.")
    ] = None,
    velocities: Annotated[
        Velocities,
        typer.Option(
            help="Whether velocities were measured, or computed from positions and so measure nothing; auto tells."
        ),
    ] = Velocities.auto,
    actions: Annotated[
        Actions,
        typer.Option(
            help="Whether motors were told the actions, or were measured to exert them; auto: a JointState's efforts."
        ),
    ] = Actions.auto,
    quick: Annotated[
        bool, typer.Option("--quick", help="Take a first look, at a few rows; it says less.")
    ] = False,
    alpha: Alpha = 0.01,
    max_effects: Annotated[
        int | None, typer.Option(min=1, help="Name this many causes at most. Default: no limit.")
    ] = None,
    test_size: Annotated[float, typer.Option(help="Part of the log that measures the gain; 0: none.")] = 0.3,
    extended: Annotated[
        Path | None, typer.Option(help="File to write the extended model to: MJCF, or URDF from a URDF.")
    ] = None,
    json: Annotated[Path | None, typer.Option(help="File to write the findings to, for programs.")] = None,
    table: Annotated[
        Path | None,
        typer.Option(
            help="Diagnose each LOG by itself and write one table (Parquet or CSV); interrupted, it goes on."
        ),
    ] = None,
    robots: Annotated[
        str | None,
        typer.Option(
            metavar="REGEX",
            help="With --table: finds 'robot' and 'time' in a log's path, as '(?P<robot>r\\d+)_(?P<time>[\\d-]+)'.",
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--report", "--output", "-o", help="HTML report to write.")
    ] = None,
    force: Force = False,
    seed: Seed = 0,
    jobs: Jobs = None,
) -> None:
    """Find out what MODEL gets wrong about LOG.

    MODEL is MJCF, URDF or a robot's folder; LOG is CSV, Parquet, NPZ, HDF5, a ROS bag, MCAP, LeRobot or Minari.
    """
    with clear_errors(), heard() as warned:
        from skat.diagnosis.archive import digest
        from skat.diagnosis.report.machine import findings_as_data
        from skat.experiments.studies import study_log

        if robots is not None and table is None:
            raise ValueError("--robots says whose log each is, of many: give --table as well.")
        check_logs_apart(log, test or ())
        if table is not None:
            single = {
                "--test": test,
                "--save-map": save_map,
                "--extended": extended,
                "--json": json,
                "-o": output,
            }
            if given := [name for name, value in single.items() if value]:
                raise ValueError(f"{', '.join(given)} is of one diagnosis; --table makes one for each log.")
            simulator = model_simulator(model, base, motors)
            reading = log_options(simulator, maps, columns, topic, rate, episodes, base, frame_skip)
            asked: dict[str, Any] = dict(
                effects=effect or "all", hidden=tuple(hidden or ()), velocities=velocities.value
            )
            asked |= dict(
                actions=actions.value, quick=quick, alpha=alpha, max_effects=max_effects, test_size=test_size
            )
            diagnose_fleet(
                log, simulator, table, robots, reading, asked | dict(random_state=seed), jobs, force
            )
            return
        path = report_path(output, f"{log[0].name.partition('.')[0]}-report.html", force)
        save_map, json = (None if one is None else output_file(one, force=force) for one in (save_map, json))
        simulator = model_simulator(model, base, motors)
        if extended is not None:
            extended = _extended_file(extended, simulator, force)
        check_apart(path, save_map, json, extended, None if extended is None else _beside(extended))
        options = log_options(simulator, maps, columns, topic, rate, episodes, base, frame_skip)
        fit = read_log(log, simulator, options)
        told = show_log(fit, save_map, force)
        tested = None if not test else read_log(test, fit.simulator, options | {"rate": 1 / fit.dt})
        if tested is not None:
            told += show_second_log(tested, fit)
        with progress_bars() as progress:
            study = study_log(
                fit,
                test=tested,
                effects=effect or "all",
                hidden=hidden or (),
                velocities=velocities.value,
                actions=actions.value,
                quick=quick,
                alpha=alpha,
                max_effects=max_effects,
                test_size=test_size,
                random_state=seed,
                n_jobs=jobs,
                progress=progress,
            )
        show_study(study)
        mistakes = _show_mistakes(study, fit) if study.diagnosis.verdict_ == "unexplained" else []
        _describe(study, model, log, test, fit, told, mistakes, warned, seed)
        write_report(study, path, force)
        if json is not None:
            context = {
                "command": ["skat", *sys.argv[1:]],
                "model": str(model),
                "model_digest": digest(simulator.model),
                "log": {
                    "source": fit.source,
                    "rows": len(fit),
                    "episodes": len(fit.group_names),
                    "dt": fit.dt,
                    "matches": fit.matches,
                    "notes": told,
                    "test": None if tested is None else tested.source,
                },
                "mistakes": mistakes,
                "report": str(path),
                "extended": None if extended is None else str(extended),
            }
            _write_json(
                json,
                findings_as_data(study.diagnosis, gain=study.gain, error_name=study.error_name, **context),
            )
        if extended is not None:
            better = study.diagnosis.extended_simulator_
            write = better.to_urdf if extended.suffix.lower() == ".urdf" else better.to_mjcf
            for path in write(extended, force=force):
                print_line(f"Extended model: {path}")


@app.command()
def changed(
    model: Model,
    before: Annotated[Path, typer.Argument(metavar="BEFORE", help="What was measured before.")],
    after: Annotated[
        Path, typer.Argument(metavar="AFTER", help="What was measured after, in the same form.")
    ],
    maps: Maps = None,
    columns: Columns = None,
    topic: Topic = None,
    rate: Rate = None,
    episodes: Episodes = None,
    base: Base = None,
    motors: Motors = None,
    frame_skip: FrameSkip = None,
    effect: Effects = None,
    hidden: Annotated[
        list[str] | None, typer.Option(help="Name of a state column that is a guess, no measurement; repeat.")
    ] = None,
    alpha: Alpha = 0.01,
    test_size: Annotated[float, typer.Option(help="Part of AFTER that measures the gain; 0: none.")] = 0.3,
) -> None:
    """Say what changed on a machine between the logs BEFORE and AFTER, whatever MODEL gets wrong in both."""
    with clear_errors():
        import pandas as pd

        from skat.diagnosis import SimulationDiagnosis

        simulator = model_simulator(model, base, motors)
        options = log_options(simulator, maps, columns, topic, rate, episodes, base, frame_skip)
        first = read_log([before], simulator, options)
        show_log(first, None, False)
        second = read_log([after], first.simulator, options | {"rate": 1 / first.dt})
        show_second_log(second, first)
        diagnosis = SimulationDiagnosis(
            first.simulator, effects=effect or "all", hidden=hidden or (), alpha=alpha, test_size=test_size
        ).fit_change(first, second)
        print_line(f"Verdict: {diagnosis.verdict_}")
        if diagnosis.reason_:
            print_line(f"  {diagnosis.reason_}")
        rows = [
            (one.name, one.value, *one.interval, one.unit, one.probability, ", ".join(map(str, one.aliases)))
            for one in diagnosis.changes_
        ]
        names = ["change", "value", "from", "to", "unit", "probability", "or"]
        if rows:
            output_console().print(table_of(pd.DataFrame(rows, columns=names)))
        for one in diagnosis.changes_:
            print_line(f"  {one.sentence}")
        if diagnosis.detectable_:
            _show_detectable(diagnosis.detectable_, first.simulator)
        if diagnosis.gain_ is not None and rows:
            gain = diagnosis.gain_
            print_line(
                f"Error on parts of {after.name} not used, in units of noise: {gain.nominal:.3g} -> {gain.extended:.3g}"
            )


def _show_detectable(detectable: "Mapping[str, float]", simulator: "MujocoSimulator") -> None:
    """Show which changes would have been told, and which would not."""
    import pandas as pd

    effects = {one.name: one for one in simulator.all_effects()}
    rows, hidden = [], []
    for name, least in detectable.items():
        effect = effects[name]
        if least == float("inf"):
            hidden.append(name)
        elif effect.neutral == 1:
            rows.append((name, f"{100 * least:.3g} %"))
        else:
            rows.append((name, f"{least:.3g} {effect.unit}".removesuffix(" 1")))
    output_console().print(
        table_of(pd.DataFrame(rows, columns=["what would have been told", "if it had changed by"]))
    )
    if hidden:
        print_line("No change of these would have been told: " + ", ".join(hidden) + ".")


@app.command()
def check(
    model: Model,
    log: Logs,
    maps: Maps = None,
    columns: Columns = None,
    save_map: SaveMap = None,
    topic: Topic = None,
    rate: Rate = None,
    episodes: Episodes = None,
    base: Base = None,
    motors: Motors = None,
    frame_skip: FrameSkip = None,
    preflight: Annotated[
        bool, typer.Option(help="Whether to say what such a log could show; it takes longest.")
    ] = True,
    alpha: Alpha = 0.01,
    force: Force = False,
) -> None:
    """Say how LOG is read with MODEL, and what it could show: names, units, clock, limits, excitation; no diagnosis."""
    with clear_errors():
        from skat.logs.checks import channel_table

        check_logs_apart(log)
        save_map = None if save_map is None else output_file(save_map, force=force)
        simulator = model_simulator(model, base, motors)
        found = read_log(
            log, simulator, log_options(simulator, maps, columns, topic, rate, episodes, base, frame_skip)
        )
        show_log(found, save_map, force, table=False)
        n_episodes = len(found.group_names)
        clock = f"{len(found)} rows of {found.dt:g} s ({1 / found.dt:g} Hz) in "
        clock += "1 episode" if n_episodes == 1 else f"{n_episodes} episodes"
        steps = f", {found.simulator.frame_skip} time steps of the model each"
        output_console().print(table_of(channel_table(found), title=clock + steps))
        if not preflight:
            return
        if found.unmeasured:
            print_line(
                "What such a log could show is not told here: it lacks " + ", ".join(found.unmeasured) + "."
            )
        else:
            _show_preflight(found, None, alpha, most=ROWS_LOOKED_AT)


@app.command("preflight")
def preflight_log(
    model: Model,
    log: Logs,
    maps: Maps = None,
    columns: Columns = None,
    topic: Topic = None,
    rate: Rate = None,
    episodes: Episodes = None,
    base: Base = None,
    motors: Motors = None,
    frame_skip: FrameSkip = None,
    effect: Effects = None,
    alpha: Alpha = 0.01,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="CSV file for the table.")] = None,
    force: Force = False,
) -> None:
    """Say, before measuring, how small an effect a log like LOG would show, and what it would pass for.

    LOG has states and actions such as you plan to measure; it may come from the simulation.
    """
    with clear_errors():
        check_logs_apart(log)
        output = None if output is None else output_file(output, force=force)
        simulator = model_simulator(model, base, motors)
        found = read_log(
            log, simulator, log_options(simulator, maps, columns, topic, rate, episodes, base, frame_skip)
        )
        if found.unmeasured:
            raise ValueError(
                f"{found.source} lacks {', '.join(found.unmeasured)}: a planned log has every state. Take the one that "
                "the simulation gives (simulator.rollout)."
            )
        table = _show_preflight(found, effect, alpha)
        if output is not None:
            with whole(output) as draft:
                table.to_csv(draft, index=False)
            print_line(f"Table: {output}")


def model_simulator(model: Path, base: str | None, motors: str | None) -> "MujocoSimulator":
    """Return the simulator of a model that the user named, and say what was chosen for it."""
    from skat.simulators import MujocoSimulator

    simulator = MujocoSimulator(
        existing_path(model, "a model: MJCF, URDF or a robot's folder"), base=base, motors=motors
    )
    for note in simulator.model.notes:
        print_line(note)
    return simulator


def log_options(
    simulator: "MujocoSimulator",
    maps: Sequence[str] | None,
    columns: Path | None,
    topic: str | None,
    rate: float | None,
    episodes: str | None,
    base: str | None,
    frame_skip: int | None,
) -> dict[str, Any]:
    """Return the keyword arguments of `load_log`; a root that is fixed has been welded in the model already."""
    from skat.logs import read_map

    if rate is not None and frame_skip is not None:
        raise ValueError("--rate and --frame-skip say the same; give one of them.")
    if frame_skip is not None:
        rate = 1 / (frame_skip * simulator.dt)
    return {
        "columns": read_map(maps or (), columns),
        "topic": topic,
        "rate": rate,
        "episodes": episodes,
        "base": "free" if base == "free" else None,
    }


def check_logs_apart(logs: Sequence[Path], tests: Sequence[Path] = ()) -> None:
    """Raise where the same rows would count twice, or be a test of what was fitted to them."""
    fitted = {path.resolve() for path in logs}
    for path in tests:
        if path.resolve() in fitted:
            raise ValueError(
                f"--test {path}: this log is fitted, so it is no test. Give another one; without any a part of LOG is "
                "set aside (--test-size)."
            )
    for paths in (logs, tests):
        places = [path.resolve() for path in paths]
        for path, place in zip(paths, places):
            if places.count(place) > 1:
                raise ValueError(f"{path} is given {places.count(place)} times; give each log once.")


def read_log(paths: Sequence[Path], simulator: "Simulator", options: Mapping[str, Any]) -> "Log":
    """Return the log of the files that the user named."""
    from skat.logs import load_log

    for path in paths:
        existing_path(path, "a log")
    return load_log(paths[0] if len(paths) == 1 else list(paths), simulator, **options)


def show_log(log: "Log", save_map: Path | None, force: bool, *, table: bool = True) -> list[str]:
    """Show which column was taken for what, where that was not said by its name, and all that was done."""
    from skat.logs import write_map

    guessed = [
        match for match in log.matches if match.how != "same name" and match.name not in ("time", "episode")
    ]
    if table and guessed:
        output_console().print(table_of(log.table, title=f"{log.source}: columns"))
    for note in log.notes:
        print_line(f"  {note}")
    if save_map is not None:
        print_line(f"Map: {write_map(save_map, log, force=force)}")
    return list(log.notes)


def show_second_log(log: "Log", first: "Log") -> list[str]:
    """Show what was done to a log that comes after another; return it with the log's name."""
    if log.notes:
        print_line(f"{log.source}:")
    told = show_log(log, None, False, table=log.matches != first.matches)
    return told if log.origins is not None else [f"{log.source}: {note}" for note in told]


def _describe(
    study: "Study",
    model: Path,
    paths: Sequence[Path],
    tested: Sequence[Path] | None,
    log: "Log",
    told: Sequence[str],
    mistakes: "Sequence[Suspect]",
    warned: Sequence[str],
    seed: int,
) -> None:
    """Say on the report what it is of, and how it was made."""
    from skat.diagnosis.report.provenance import provenance

    names = ", ".join(path.name for path in paths)
    made = provenance(
        files=[
            ("model", model),
            *(("log", path) for path in paths),
            *(("test", path) for path in tested or ()),
        ],
        command=shlex.join(["skat", *sys.argv[1:]]),
        seed=seed,
        settings={"Rate": f"{1 / log.dt:g} Hz, {log.simulator.frame_skip} time steps of the model each"},
        warnings=warned,
        notes=[*told, *(f"A usual mistake that would explain it: {one.sentence}" for one in mistakes)],
    )
    study.diagnosis.report_.describe(title=f"{model.name} against {names}", made=made)


def _show_mistakes(study: "Study", log: "Log") -> "list[Suspect]":
    """Show the usual mistakes in columns that would explain much of what is left."""
    from skat.logs import suspects
    from skat.logs.errors import shell_options

    found = [
        one
        for one in suspects([log.simulator, study.diagnosis.extended_simulator_], log)
        if one.repaired < WORTH_TELLING * one.error
    ][:3]
    if found:
        print_line(
            "Usual mistakes that would explain it, with what one step misses then, as a share of the change:"
        )
    for one in found:
        remedy = f"; {shell_options(one.options)}" if one.options else ""
        print_line(f"  {one.sentence}: {one.error:.3g} -> {one.repaired:.3g}{remedy}")
    return found


# Rows of a log from which `skat check` says what it could show; more of them would show still smaller effects.
ROWS_LOOKED_AT = 600
# A mistake is told that leaves less than this share of the error.
WORTH_TELLING = 0.7


def _show_preflight(
    log: "Log", effect: Sequence[str] | None, alpha: float, most: int | None = None
) -> "pd.DataFrame":
    from skat.diagnosis import SimulationDiagnosis
    from skat.logs.checks import rows_of

    X, groups = rows_of(log, most)
    diagnosis = SimulationDiagnosis(log.simulator, effects=effect or "all", alpha=alpha)
    with progress_bars() as progress:
        progress("differentiate", 0, 1)
        table = diagnosis.preflight(X, groups=groups).reset_index()
        progress("differentiate", 1, 1)
    shown = table["smallest"] < float("inf")
    title = f"Named one time in two in {len(X)} transitions with noise of 1 % of each channel's spread"
    names = {
        "smallest": "from this size on",
        "nearest_alias": "nearest alias",
        "separating_excitation": "told apart by",
    }
    output_console().print(
        table_of(table[shown].rename(columns=names), title=title, formats={"similarity": ".3f"})
    )
    if not shown.all():
        print_line(f"Not shown within their bounds: {', '.join(table['effect'][~shown])}")
    return table


def _extended_file(path: Path, simulator: "MujocoSimulator", force: bool) -> Path:
    """Return where to write the extended model, after a check that its name says a form that it can have."""
    forms = [".xml", ".mjcf"] + ([".urdf"] if simulator.model.urdf is not None else [])
    if path.suffix.lower() not in forms:
        why = " (a URDF is written where MODEL is one)" if path.suffix.lower() == ".urdf" else ""
        raise ValueError(f"--extended {path}: expected a name that ends in {' or '.join(forms)}{why}.")
    output_file(_beside(path), force=force)
    return output_file(path, force=force)


def _beside(extended: Path) -> Path:
    """Return where what an extended model's form cannot hold is written."""
    return extended.with_suffix(".effects.json")


def _write_json(path: Path, content: Any) -> None:
    import json

    with whole(path) as draft:
        draft.write_text(
            json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
        )
    print_line(f"Findings: {path}")
