"""The commands, each of which reads, calls one function of skat, and shows what that returns."""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skat import __version__
from skat.cli.terminal import (
    check_apart,
    clear_errors,
    existing_file,
    existing_path,
    output_console,
    output_file,
    print_line,
    table_of,
    unused,
)
from skat.files import whole
from skat.progress import progress_bars

if TYPE_CHECKING:
    import pandas as pd

    from skat.diagnosis.findings import Cause
    from skat.experiments.studies import Study


def _version(wanted: bool) -> None:
    if wanted:
        print_line(f"skat {__version__}")
        raise typer.Exit


app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
)


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_version, help="Print the version and end.")
    ] = False,
) -> None:
    """Find out what a simulation gets wrong, and carry simulated samples onto measured ones."""


demo = typer.Typer(help="Diagnose data that come with skat.", invoke_without_command=True)
app.add_typer(demo, name="demo")

Output = Annotated[Path | None, typer.Option("--output", "-o", help="HTML report to write.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite output that exists.")]
Seed = Annotated[int, typer.Option(help="Seed of everything random.")]
Model = Annotated[
    Path, typer.Argument(metavar="MODEL", help="The simulation: MJCF, URDF, or a robot's folder (Menagerie).")
]
Effects = Annotated[
    list[str] | None, typer.Option(help="Name of an effect to consider; repeat for several. Default: all.")
]
Alpha = Annotated[float, typer.Option(help="A cause is named where the odds for it are 1 to this.")]


@demo.callback()
def demo_puck(context: typer.Context, output: Output = None, force: Force = False, seed: Seed = 0) -> None:
    """Puck shots, simulated with a hidden effect; or measured data: demo ball-drops, cube-tosses, pendulum."""
    if context.invoked_subcommand is not None:
        return
    with clear_errors():
        from skat.experiments.studies import study_hidden_puck

        path = report_path(output, "skat-demo-report.html", force)
        with progress_bars() as progress:
            study = study_hidden_puck(random_state=seed, progress=progress)
        show_study(study)
        write_report(study, path, force)


@demo.command("ball-drops")
def demo_ball_drops(
    ball: Annotated[
        list[str] | None, typer.Option(help="Name of a ball; repeat for several. Default: all.")
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(help="Effect to consider, or 'all'; repeat. Default: drag, quadratic and linear."),
    ] = None,
    output: Output = None,
    force: Force = False,
    seed: Seed = 0,
) -> None:
    """Sports balls dropped from 48 m: fit on drop 1 of each ball, test on drop 2."""
    with clear_errors():
        from skat.experiments.studies import ball_drop_table, study_ball_drops

        path = report_path(output, "skat-ball-drops-report.html", force)
        options: dict[str, Any] = {} if not effect else {"effects": "all" if effect == ["all"] else effect}
        with progress_bars() as progress:
            studies = study_ball_drops(ball or None, random_state=seed, progress=progress, **options)
        for study in studies.values():
            show_study(study)
        table, title = ball_drop_table(studies), "Every ball: trajectory error on drop 2, m"
        output_console().print(table_of(table, title=title))
        shown = max(studies.values(), key=lambda study: study.gain.ratio)
        shown.diagnosis.report_.add_table(title, table)
        write_report(shown, path, force)


@demo.command("cube-tosses")
def demo_cube_tosses(
    fit: Annotated[int, typer.Option(min=2, help="Number of tosses to fit on.")] = 5,
    test: Annotated[int, typer.Option(min=1, help="Number of other tosses to test on.")] = 50,
    output: Output = None,
    force: Force = False,
    seed: Seed = 0,
) -> None:
    """A cube tossed onto a table: fit on some tosses, test on others."""
    with clear_errors():
        from skat.experiments.studies import study_cube_tosses

        path = report_path(output, "skat-cube-tosses-report.html", force)
        with progress_bars() as progress:
            study = study_cube_tosses(n_fit=fit, n_test=test, random_state=seed, progress=progress)
        show_study(study)
        write_report(study, path, force)


@demo.command("pendulum")
def demo_pendulum(
    seconds: Annotated[float, typer.Option(help="Length of the pieces of the run that are compared.")] = 0.5,
    output: Output = None,
    force: Force = False,
    seed: Seed = 0,
) -> None:
    """A motor swings up a pendulum: fit on some pieces of the run, test on the others."""
    with clear_errors():
        from skat.experiments.studies import study_pendulum

        path = report_path(output, "skat-pendulum-report.html", force)
        with progress_bars() as progress:
            study = study_pendulum(seconds=seconds, random_state=seed, progress=progress)
        show_study(study)
        write_report(study, path, force)


@app.command()
def effects(
    model: Model,
    frame_skip: Annotated[
        int,
        typer.Option(
            min=1, help="Steps of the model in a transition; the ranges of delay and timestep depend on it."
        ),
    ] = 1,
    base: Annotated[
        str | None,
        typer.Option(metavar="fixed|free", help="Whether its root is bolted down or moves freely."),
    ] = None,
    motors: Annotated[
        str | None, typer.Option(metavar="torque|position:KP,KV", help="What drives the joints of a URDF.")
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Also those that are sought only where --effect names them.")
    ] = False,
) -> None:
    """List the effects that MODEL may be diagnosed for."""
    with clear_errors():
        import pandas as pd

        from skat.simulators import MujocoSimulator

        path = existing_path(model, "a model: MJCF, URDF or a robot's folder")
        simulator = MujocoSimulator(path, frame_skip=frame_skip, base=base, motors=motors)
        listed = simulator.effects(also="all" if every else ())
        rows = [
            (effect.name, effect.unit, effect.neutral, *effect.bounds, effect.meaning) for effect in listed
        ]
        columns = ["effect", "unit", "neutral", "lowest", "highest", "meaning"]
        output_console().print(table_of(pd.DataFrame(rows, columns=columns)))


# Of a log, what is no sample: a transport leaves them as they are.
STAMPS = ["time", "episode"]
PUCKS_ARE_SIMULATED = (
    "The recordings of real pucks in the paper are not public; the blue and the red puck here are simulations with "
    "another time step, friction and slope, and 0.05 m of noise from strike to strike."
)


class Method(StrEnum):
    """Ways to carry source rows onto target rows."""

    affine = "affine"
    procrustes = "procrustes"
    coral = "coral"
    exact = "exact"


@app.command()
def transport(
    source: Annotated[Path, typer.Argument(metavar="SOURCE.csv", help="Simulated rows.")],
    target: Annotated[Path, typer.Argument(metavar="TARGET.csv", help="Measured rows, same columns.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="OUT.csv", help="Transported rows to write.")
    ],
    method: Annotated[
        Method, typer.Option(help="procrustes needs pairs: row i of SOURCE belongs to row i of TARGET.")
    ] = Method.affine,
    force: Force = False,
) -> None:
    """Carry the rows of SOURCE.csv onto those of TARGET.csv."""
    with clear_errors():
        import pandas as pd

        from skat import CORAL, AffineTransport, ExactTransport, ProcrustesAffineTransport
        from skat.logs.tables import numeric_columns, with_same_columns

        path = output_file(output, force=force)
        rows = numeric_columns(existing_file(source, "simulated rows in CSV"), beside=STAMPS)
        measured = numeric_columns(existing_file(target, "measured rows in CSV"), beside=STAMPS)
        rows, stamps = rows.drop(columns=STAMPS, errors="ignore"), rows.filter(STAMPS)
        measured = with_same_columns(measured.drop(columns=STAMPS, errors="ignore"), rows)
        estimators = {
            Method.affine: AffineTransport,
            Method.procrustes: ProcrustesAffineTransport,
            Method.coral: CORAL,
            Method.exact: ExactTransport,
        }
        with progress_bars() as progress:
            progress("fitting", 0, 1)
            estimator = estimators[method]().fit(rows.to_numpy(), measured.to_numpy())
            moved = rows.copy()
            moved[:] = estimator.transform(rows.to_numpy())
            score = estimator.score(rows.to_numpy(), measured.to_numpy())
            progress("fitting", 1, 1)
        with whole(path) as draft:
            pd.concat([stamps, moved], axis=1).to_csv(draft, index=False)
        output_console().print(table_of(_moments(source=rows, target=measured, transported=moved)))
        print_line(f"Affinity score of the transported and the target rows: {score:.4g}")
        print_line(f"Transported rows: {path}")


PICTURES = (".png", ".svg", ".pdf")


class Experiment(StrEnum):
    """The experiments of the paper."""

    hopper = "hopper"
    halfcheetah = "halfcheetah"
    ant = "ant"
    puck = "puck"
    learning_curve = "learning-curve"


@app.command()
def experiment(
    name: Annotated[Experiment, typer.Argument(help="Which one.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="CSV file for the whole table.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Picture to write, PNG, SVG or PDF.")] = None,
    force: Force = False,
    n_repeats: Annotated[int | None, typer.Option(min=1, help="Repetitions with other rows.")] = None,
    n_transitions: Annotated[int, typer.Option(min=50, help="Rows to fit on (robots).")] = 2000,
    seed: Seed = 0,
) -> None:
    """Run an experiment of the paper, every method side by side."""
    with clear_errors():
        from skat import experiments
        from skat.experiments.summaries import figure, method_summary, verdict

        output = None if output is None else output_file(output, force=force)
        if plot is not None and plot.suffix.lower() not in PICTURES:
            raise ValueError(f"--plot {plot}: expected a name that ends in {', '.join(PICTURES)}.")
        plot = None if plot is None else output_file(plot, force=force)
        check_apart(output, plot)
        options: dict[str, Any] = {"random_state": seed}
        if n_repeats is not None:
            options["n_repeats"] = n_repeats
        with progress_bars() as progress:
            if name is Experiment.puck:
                table = experiments.puck_table(**options, progress=progress)
            elif name is Experiment.learning_curve:
                table = experiments.puck_learning_curve(**options, progress=progress)
            else:
                table = experiments.domain_matrix(
                    name.value, n_transitions=n_transitions, **options, progress=progress
                )
        output_console().print(table_of(method_summary(table), title=f"{name.value}: medians by method"))
        print_line(verdict(table))
        if name in (Experiment.puck, Experiment.learning_curve):
            print_line(PUCKS_ARE_SIMULATED)
        if output is not None:
            with whole(output) as draft:
                table.to_csv(draft, index=False)
            print_line(f"Table: {output}")
        if plot is not None:
            with whole(plot) as draft:
                figure(table).savefig(draft)
            print_line(f"Picture: {plot}")


def show_study(study: "Study") -> None:
    """Print the verdict, the causes, and the errors on data not used."""
    from skat.diagnosis.report.sentences import capital, is_first_look, share_sentence, verdict_sentences

    console = output_console()
    diagnosis, gain = study.diagnosis, study.gain
    print_line("")
    first_look = " (a first look)" if is_first_look(diagnosis) else ""
    print_line(f"{study.title}: {diagnosis.verdict_}{first_look}", style="bold")
    for sentence in verdict_sentences(diagnosis, [] if study.errors is None else [study.errors]):
        print_line(f"  {sentence}")
    if diagnosis.causes_:
        console.print(table_of(_causes(diagnosis.causes_)))
    if study.errors is not None:
        whose = "Error of whole episodes" if tuple(diagnosis.hidden) else "One-step error"
        print_line(f"{whose} on data not used, in standard deviations of each channel")
        console.print(table_of(study.errors[["method", "error", "ratio"]]))
        noted = study.errors[study.errors["note"] != ""]
        for note, rows in noted.groupby("note", sort=False):
            print_line(f"  {', '.join(rows['method'])}: {note}")
    if gain is not None:
        print_line(
            f"{study.error_name}, on data not used: {gain.nominal:.3g} before, {gain.extended:.3g} after, "
            f"{gain.ratio:.3g} times smaller"
        )
        units = {name: diagnosis.simulator.units.get(name, "") for name in gain.channels}
        if gain.horizon == "episode" and len(set(units.values())) > 1:
            for name, errors in gain.channels.items():
                before, after = (f"{error:.3g} {units[name]}".rstrip() for error in errors)
                print_line(f"  {name}: {before} before, {after} after")
        print_line(capital(share_sentence(diagnosis, gain)))
    if study.truth is not None:
        print_line(f"Now the answer: {study.truth}")


def _causes(causes: "Sequence[Cause]") -> "pd.DataFrame":
    import pandas as pd

    from skat.diagnosis.report.sentences import plain_percent
    from skat.rounding import interval_text, size_text

    return pd.DataFrame(
        {
            "cause": [cause.name for cause in causes],
            "size": [size_text(cause.value, cause.interval) for cause in causes],
            "95 % interval": [interval_text(cause.interval) for cause in causes],
            "unit": [cause.unit for cause in causes],
            "probability": [plain_percent(cause.probability) for cause in causes],
            "aliases": [
                ", ".join(f"{alias.name} ({plain_percent(alias.probability)})" for alias in cause.aliases)
                or "none"
                for cause in causes
            ],
        }
    )


def _moments(**tables: "pd.DataFrame") -> "pd.DataFrame":
    import pandas as pd

    moments = {"column": list(tables["source"])}
    for name, table in tables.items():
        moments[f"mean of {name}"] = table.mean().to_numpy()
        moments[f"std of {name}"] = table.std().to_numpy()
    return pd.DataFrame(moments)


def report_path(given: Path | None, default: str, force: bool) -> Path:
    """Return where to write the report: where the user said, or under a name that is free."""
    return unused(default) if given is None else output_file(given, force=force)


def write_report(study: "Study", path: Path, force: bool) -> None:
    """Write the report, and say where."""
    study.diagnosis.report_.to_html(path, force=force)
    print_line(f"Report with pictures: {path}")
