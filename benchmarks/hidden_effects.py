"""Hide effects in four worlds, diagnose each, and print how often the truth was named.

The worlds (``worlds/``) share no code with ``skat``: see there. Every run is a line of JSON in ``--output``, with a
hash of the sources that decide; a run that has its line of these sources is not repeated, so that the table can be
interrupted and gone on with, and only lines of one hash are counted::

    python benchmarks/hidden_effects.py --cut                   # 40 causes, 3 seeds each
    python benchmarks/hidden_effects.py --seeds 10              # the table in full
    python benchmarks/hidden_effects.py --only "hopper: mass"   # runs whose label contains this
    python benchmarks/hidden_effects.py --seeds 0 --clean 200   # 200 clean data sets over all worlds
    python benchmarks/hidden_effects.py --report                # only print what is there

A size s in noise units is the nominal model's squared one-step error over the true model's, minus 1.
"""

import argparse
import json
import time
import warnings
from collections import Counter
from pathlib import Path

import joblib
import numpy as np
import tables
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from sklearn.base import clone
from worlds import FRAME_SKIP, KINDS, measure, nominal_mjcf
from worlds.cases import CONDITIONS, Case, causes, condition, cut, draw, draw_pair, name, outside
from worlds.hidden import family_of

RESULTS = Path(__file__).parent / "results" / "hidden_effects.jsonl"
S_RANGE, S_SMALL, S_PAIRS, S_OUTSIDE = (0.1, 10.0), (0.03, 0.1), (0.3, 5.0), (0.2, 5.0)
N_FRESH_EPISODES = 10
# Of 50 transitions, in each log, so that three seeds of the cut take an hour of two cores. Ant takes several times
# as long to simulate as the others.
EPISODES = {"hopper": 12, "halfcheetah": 12, "ant": 6, "puck": 12}


def main():
    arguments = _arguments()
    source = arguments.source or tables.source_hash()
    done = [line for line in _read(arguments.output) if source in (line.get("source"), line.get("commit"))]
    if not arguments.report:
        tasks = [task for task in _tasks(arguments) if task["key"] not in {run["key"] for run in done}]
        tasks = tasks[: arguments.at_most]
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        runs = joblib.Parallel(n_jobs=arguments.n_jobs, return_as="generator_unordered")(
            joblib.delayed(run)(task) for task in tasks
        )
        columns = (
            *Progress.get_default_columns()[:2],
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns) as progress, arguments.output.open("a") as file:
            bar = progress.add_task("worlds", total=len(tasks))
            for result in runs:
                result |= {"source": source, "commit": tables.commit()}
                file.write(json.dumps(result) + "\n")
                file.flush()
                done.append(result)
                progress.console.print(_line(result), highlight=False, markup=False)
                progress.advance(bar)
    wanted = [result for result in done if arguments.only in result["label"]]
    report(wanted, Console(width=200 if arguments.wide else None))


def run(task):
    """Return what a diagnosis says of one world, beside the truth, as plain numbers and texts."""
    warnings.filterwarnings("ignore")
    case = _case(task)
    log = case.log(n_episodes=task["episodes"])
    from skat.diagnosis import SimulationDiagnosis

    simulator = nominal_simulator(case.kind)
    result = {
        "key": task["key"],
        "table": task["table"],
        "label": case.label,
        "world": case.kind,
        "seed": case.seed,
        "episodes": task["episodes"],
        "truth": [[name(family, target), value] for family, target, value in case.hidden],
        "sizes": list(case.sizes),
    }
    start, start_cpu = time.perf_counter(), time.process_time()
    try:
        diagnosis = SimulationDiagnosis(simulator, random_state=case.seed, n_jobs=1).fit(
            log.X, log.y, groups=log.groups
        )
    except Exception as error:  # A crash is a result too: it counts as a failure.
        return {**result, "verdict": "error", "causes": [], "error": f"{type(error).__name__}: {error}"}
    result["seconds"] = time.perf_counter() - start
    result["cpu_seconds"] = time.process_time() - start_cpu
    result |= tables.read(diagnosis)
    for cause in result["causes"]:
        cause["aliases"] = [alias for alias, _ in cause["aliases"]]
    fresh = case.log(fresh=True, n_episodes=N_FRESH_EPISODES)
    result.update(_fresh_errors(fresh, diagnosis.extended_simulator_))
    if diagnosis.causes_ and case.hidden:
        aliases = result["causes"][0]["aliases"]
        earned = {alias: _earned(alias, diagnosis, log, fresh) for alias in aliases}
        result["earned"] = {alias: within for alias, (within, _) in earned.items()}
        result["earned_in_pairs"] = {alias: paired for alias, (_, paired) in earned.items()}
    return result


def nominal_simulator(kind):
    """Return the simulator that a user of this world would hand to a diagnosis."""
    from skat.simulators import MujocoSimulator

    return MujocoSimulator(nominal_mjcf(kind), frame_skip=FRAME_SKIP[kind])


def _fresh_errors(log, extended):
    """Return the mean squared one-step errors of three models: nominal, extended and true."""
    # The action before an episode's first row is in no log.
    rows = np.append(False, log.groups[1:] == log.groups[:-1])
    predictions = {
        "nominal": log.predict(),
        "extended": extended.predict(log.X, groups=log.groups),
        "floor": log.predict(log.hidden),
    }
    return {
        name: float(log.squared_errors(prediction)[rows].mean()) for name, prediction in predictions.items()
    }


def _earned(alias, diagnosis, log, fresh):
    """Return whether an alias, refitted in the place of the first cause, predicts other episodes as well.

    That is, whether its error is within the 95 % interval of the error with that cause; and, which asks for more,
    whether the errors of the same episodes are not larger by two standard errors of their difference.

    The refit is the diagnosis' own, as at contacts the one-step loss of noisy states has many minima, none of them at
    the value; what is earned is judged by other episodes, by errors that the diagnosis has no part in.
    """
    _, *others = diagnosis.causes_
    refitted = clone(diagnosis).set_params(effects=[alias, *(other.name for other in others)])
    refitted.fit(log.X, log.y, groups=log.groups)

    def losses(model):
        # A cut at 9 times the noise, so that single contacts do not decide.
        errors = fresh.squared_errors(model.extended_simulator_.predict(fresh.X, groups=fresh.groups))
        return np.minimum(np.nan_to_num(errors, nan=9.0), 9.0)

    def by_episode(errors):
        return np.array([errors[fresh.groups == group].mean() for group in np.unique(fresh.groups)])

    present, other = by_episode(losses(diagnosis)), by_episode(losses(refitted))
    reach, apart = (2 * one.std(ddof=1) / np.sqrt(len(one)) for one in (present, other - present))
    return bool(other.mean() <= present.mean() + reach), bool((other - present).mean() <= apart)


# -- tasks ---------------------------------------------------------------------------------------------------


def _tasks(arguments):
    """Return every run that is asked for, seed after seed, so that an interrupted table is an even one."""
    tasks = []
    n_seeds = arguments.seeds if arguments.seeds is not None else (3 if arguments.cut else 10)

    def seeds(count):
        return range(arguments.first_seed, arguments.first_seed + count)

    def add(table, label, seed):
        if arguments.only in label:
            tasks.append(
                {
                    "key": f"{table} | {label} | {seed}",
                    "table": table,
                    "label": label,
                    "seed": seed,
                    "episodes": arguments.episodes or EPISODES[kind_of(label)],
                }
            )

    rows = cut() if arguments.cut else causes()
    for table, count in (("cause", n_seeds), ("small", arguments.small)):
        for seed in seeds(count):
            for row in rows:
                add(table, row.label, seed)
    for seed in seeds(arguments.pairs):
        for kind in KINDS:
            add("pair", kind, seed)
    for seed in seeds(arguments.outside):
        for row in outside():
            add("outside", row.label, seed)
    for seed in seeds(arguments.clean // len(KINDS)):
        for kind in KINDS:
            add("clean", kind, seed)
    for seed in seeds(arguments.conditions):
        for kind in KINDS[:3]:
            for label in CONDITIONS:
                add("condition", f"{kind}, {label}", seed)
    return tasks


def kind_of(label):
    """Return the world that a label names first."""
    return next(kind for kind in KINDS if label.startswith(kind))


def _case(task):
    table, label, seed = task["table"], task["label"], task["seed"]
    if table == "clean":
        return Case(label, label, seed, (), ())
    if table == "pair":
        return draw_pair(label, seed, s_range=S_PAIRS)
    if table == "condition":
        kind, which = label.split(", ")
        hidden = condition(kind, which)
        sizes = tuple(measure(kind, [one], seed=2 * seed, n_episodes=8).excess() for one in hidden)
        return Case(kind, label, seed, hidden, sizes)
    rows, s_range = {
        "cause": (causes(), S_RANGE),
        "small": (causes(), S_SMALL),
        "outside": (outside(), S_OUTSIDE),
    }[table]
    (row,) = (row for row in rows if row.label == label)
    return draw(row, seed, s_range=s_range)


def _arguments():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cut", action="store_true", help="ten causes of each world instead of all")
    parser.add_argument("--seeds", type=int, help="seeds of each cause; by default 3 of the cut, else 10")
    parser.add_argument(
        "--first-seed", type=int, default=0, help="from here on, such as one no engine was made with"
    )
    parser.add_argument("--small", type=int, default=0, help="seeds of the causes with s in [0.03, 0.1]")
    parser.add_argument("--pairs", type=int, default=0, help="pairs of each world")
    parser.add_argument("--outside", type=int, default=0, help="seeds of the effects that are in no list")
    parser.add_argument("--clean", type=int, default=0, help="clean data sets over all worlds")
    parser.add_argument("--conditions", type=int, default=0, help="seeds of the paper's eight conditions")
    parser.add_argument(
        "--episodes", type=int, help="of 50 transitions, in each log; by default 6 of Ant, else 12"
    )
    parser.add_argument("--only", default="", help="only labels that contain this text")
    parser.add_argument("--at-most", type=int, default=None, help="stop after so many runs")
    parser.add_argument("--n-jobs", type=int, default=2, help="processes")
    parser.add_argument("--output", type=Path, default=RESULTS)
    parser.add_argument(
        "--source", help="hash or commit of the lines to count; by default of the sources at hand"
    )
    parser.add_argument("--report", action="store_true", help="print what is there, run nothing")
    parser.add_argument("--wide", action="store_true", help="print for 200 columns")
    return parser.parse_args()


def _read(path):
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def _line(result):
    truth = ", ".join(f"{name} = {value:.4g}" for name, value in result["truth"]) or "nothing"
    found = ", ".join(
        f"{cause['name']} = {cause['value']:.4g}"
        + (f" ({len(cause['aliases'])} aliases)" if cause["aliases"] else "")
        for cause in result["causes"]
    )
    sizes = ", ".join(f"{s:.2g}" for s in result["sizes"])
    mark = "+" if _good(result) else "-"
    told = result.get("error") or f"{result['verdict']}: {found}"
    seconds = result.get("seconds", 0)
    return f"{mark} {result['label']} #{result['seed']}: hidden {truth} (s {sizes}); {told} [{seconds:.0f} s]"


# -- report --------------------------------------------------------------------------------------------------


def _good(result):
    if result["table"] == "clean":
        return result["verdict"] == "nothing detected"
    if result["table"] == "outside":
        return result["verdict"] == "unexplained"
    if result["table"] in ("pair", "condition"):
        return {name for name, _ in result["truth"]} == {cause["name"] for cause in result["causes"]}
    return _named_alone(result)


def _named_alone(result):
    return [cause["name"] for cause in result["causes"]] == [result["truth"][0][0]]


def _covered(result):
    """Whether the truth is the first cause or one of its aliases, and there is no other cause."""
    found = result["causes"]
    return len(found) == 1 and result["truth"][0][0] in [found[0]["name"], *found[0]["aliases"]]


def report(runs, console):
    """Print every figure that has to hold, and the confusion matrix."""
    by_table = {
        table: [run for run in runs if run["table"] == table]
        for table in ("cause", "small", "pair", "outside", "clean", "condition")
    }
    shown = Table("must hold", "figure", "of", "wanted", title="Hidden effects")
    strong = [run for run in by_table["cause"] if 0.08 <= run["sizes"][0] <= 12]
    weak = [run for run in by_table["small"] if 0.02 <= run["sizes"][0] <= 0.12]

    def share(label, flags, wanted):
        flags = list(flags)
        shown.add_row(label, f"{100 * np.mean(flags):.1f} %" if flags else "not run", str(len(flags)), wanted)

    share("one effect, s in [0.1, 10]: named first, alone", map(_named_alone, strong), ">= 97 %")
    share("... named first, whatever is beside it", (_first(run) for run in strong), "")
    share("... named or in the alias set, alone", map(_covered, strong), ">= 99 %")
    share("... of s in [0.03, 0.1]", map(_covered, weak), ">= 95 %")
    singles = strong + weak
    sets = [len(run["causes"][0]["aliases"]) for run in singles if run["causes"]]
    shown.add_row(
        "alias sets: median size", f"{np.median(sets):.0f}" if sets else "not run", str(len(sets)), "0"
    )
    share("... with at most 3 members", (size <= 3 for size in sets), ">= 95 %")
    share(
        "... declared aliases that are earned",
        (flag for run in singles for flag in run.get("earned", {}).values()),
        "100 %",
    )
    share(
        "... and no worse in pairs of errors",
        (flag for run in singles for flag in run.get("earned_in_pairs", {}).values()),
        "",
    )
    named = [(run, run["causes"][0]) for run in singles if _first(run)]
    errors = [_parameter_error(run, cause) for run, cause in named if run["sizes"][0] >= 0.5]
    shown.add_row(
        "parameter error, median where s >= 0.5",
        f"{100 * np.median(errors):.2f} %" if errors else "not run",
        str(len(errors)),
        "<= 3 %",
    )
    share(
        "95 % intervals that cover",
        (cause["interval"][0] <= run["truth"][0][1] <= cause["interval"][1] for run, cause in named),
        "92 to 98 %, >= 400",
    )
    alarms = [run["verdict"] != "nothing detected" for run in by_table["clean"]]
    shown.add_row("alarms on clean data", str(sum(alarms)), str(len(alarms)), "at most 1 of 480")
    pairs = [run for run in by_table["pair"] if min(run["sizes"]) >= 0.25]
    share(
        "pairs with s >= 0.3 each: both named",
        ({t for t, _ in run["truth"]} <= {c["name"] for c in run["causes"]} for run in pairs),
        ">= 92 %",
    )
    share("... and nothing else", map(_good, pairs), "")
    others = [run for run in by_table["outside"] if run["sizes"][0] >= 0.2]
    share("outside the list, s >= 0.2: unexplained", map(_good, others), ">= 95 %")
    share(
        "... a full false name (named; half is left)",
        (run["verdict"] == "named" and _left(run) > 0.5 for run in others),
        "0 %",
    )
    large = [run for run in strong if run["sizes"][0] >= 2 and run["verdict"] != "error"]
    share(
        "s >= 2: >= 95 % of the excess explained on other episodes", (_left(run) <= 0.05 for run in large), ""
    )
    lefts = [_left(run) for run in large]
    shown.add_row(
        "... explained, median",
        f"{100 * (1 - np.median(lefts)):.1f} %" if lefts else "not run",
        str(len(lefts)),
        ">= 95 %",
    )
    share("the paper's conditions: all causes and no other", map(_good, by_table["condition"]), "all")
    share("crashes", (run["verdict"] == "error" for run in runs), "0 %")
    for kind in KINDS:
        seconds = [run["cpu_seconds"] for run in runs if run["world"] == kind and "seconds" in run]
        shown.add_row(
            f"processor seconds, {kind}: median, largest",
            f"{np.median(seconds):.1f}, {max(seconds):.1f}" if seconds else "not run",
            str(len(seconds)),
            "",
        )
    console.print(shown)
    if strong:
        console.print(_confusion(strong))


def _confusion(runs):
    """Return the table of hidden against first-named families."""
    counts = Counter(
        (
            family_of(run["truth"][0][0]),
            family_of(run["causes"][0]["name"]) if run["causes"] else run["verdict"],
        )
        for run in runs
    )
    table = Table(
        "hidden family",
        "named right",
        "named otherwise (family: times)",
        title="Confusion, s in [0.1, 10]: first cause",
    )
    for family in sorted({hidden for hidden, _ in counts}):
        mine = [run for run in runs if family_of(run["truth"][0][0]) == family]
        right = sum(map(_first, mine))
        wrong = Counter(
            run["causes"][0]["name"] if run["causes"] else run["verdict"] for run in mine if not _first(run)
        )
        table.add_row(
            family,
            f"{right} of {len(mine)}",
            ", ".join(f"{found}: {times}" for found, times in wrong.most_common()),
        )
    return table


def _first(run):
    return bool(run["causes"]) and run["causes"][0]["name"] == run["truth"][0][0]


def _parameter_error(run, cause):
    truth = run["truth"][0][1]
    neutral = 1.0 if family_of(cause["name"]) in _FACTOR_FAMILIES else 0.0
    return abs(cause["value"] - truth) / abs(truth - neutral)


_FACTOR_FAMILIES = frozenset(
    (
        "mass",
        "inertia",
        "length",
        "gravity",
        "gain",
        "scale",
        "contact_friction",
        "contact_anisotropy",
        "restitution",
        "timestep",
    )
)


def _left(run):
    """Return the share of the nominal model's excess error that the extended model leaves."""
    excess = run["nominal"] - run["floor"]
    return (run["extended"] - run["floor"]) / excess if excess > 0 else 0.0


if __name__ == "__main__":
    main()
