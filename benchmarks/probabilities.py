"""Whether a probability is right: causes and sizes drawn from the documented prior and odds, many small logs.

Puck, cart-pole and two-link arm, at most 2 s each. Each effect that these worlds can hide is hidden with the chance
that its odds give beside those of all others (less than one cause is expected), all of a family or members of it, with
a value from its prior: a Cauchy of its typical size (on the logarithm for positive factors), cut at its bounds. The
effects offered are those that may be hidden; a log so short is hardly coarsened. To a9133a2 each effect was hidden with
the chance of its odds alone, ten or so at a time, which is not the prior that the documentation states::

    python benchmarks/probabilities.py --cut
    python benchmarks/probabilities.py --shard 0/2       # see tables.py for the rest
    python benchmarks/probabilities.py --report --diagram docs/probabilities.svg
"""

import itertools
import sys

import numpy as np
import tables
from tables import Case, Table
from worlds.hidden import edited_model
from worlds.robots import ROBOTS, make_log

N_LOGS = 2000
WORLDS = {"puck": (100, 2), "cart_pole": (100, 1), "two_link": (200, 1)}  # rows, episodes: at most 2 s
# Families that `worlds.robots` hides in all three as skat's effects state them.
HIDDEN = (
    "mass",
    "inertia",
    "gravity",
    "tilt",
    "wind",
    "damping",
    "dry_friction",
    "armature",
    "stiffness",
    "gain",
    "offset",
    "contact_friction",
    "restitution",
    "delay",
    "bias",
    "scale",
)
BINS = (0.0, 0.5, 0.8, 0.95, 1.0)


def cases(cut):
    return [
        Case(f"{list(WORLDS)[index % len(WORLDS)]}", 9000 + index) for index in range(6 if cut else N_LOGS)
    ]


def offered(simulator):
    """Return the effects of a simulator that these worlds hide; single members and whole families alike."""
    found = [effect for effect in simulator.effects() if effect.family in HIDDEN]
    for effect in found:
        for name in ("typical", "odds"):
            if not isinstance(getattr(effect, name, None), int | float):
                raise ValueError(
                    f"{effect.name} states no {name}: this table needs an engine whose effects have a prior, "
                    "Effect.typical and Effect.odds"
                )
    return found


def draw(effects, rng):
    """Return names and values of what is hidden, drawn from the prior of the effects."""
    everything = 1 + sum(effect.odds for effect in effects)
    while True:
        hidden = [effect for effect in effects if rng.random() < effect.odds / everything]
        whole = {effect.family for effect in hidden if effect.target == "all"}
        if all(effect.target == "all" or effect.family not in whole for effect in hidden):
            return {effect.name: value_of(effect, rng) for effect in hidden}


def value_of(effect, rng):
    """Return a value from an effect's prior: Cauchy of its typical size about neutral, cut at its bounds.

    On the logarithm for factors that are positive throughout.
    """
    low, high = effect.bounds
    on_logarithm = effect.is_factor and low > 0
    for _ in range(10_000):
        step = effect.typical * rng.standard_cauchy()
        with np.errstate(over="ignore"):
            value = effect.neutral * np.exp(step) if on_logarithm else effect.neutral + step
        if low <= value <= high and value != effect.neutral:
            return float(value)
    raise ValueError(f"no value of {effect.name} lies within its bounds {effect.bounds}")


def log_of(case):
    """Return the log of a case; a draw in which the world is unstable is drawn anew, as no robot runs there."""
    from skat.simulators import MujocoSimulator

    robot = case.name
    simulator = MujocoSimulator(ROBOTS[robot].text(), frame_skip=ROBOTS[robot].frame_skip)
    effects = offered(simulator)
    rows, episodes = WORLDS[robot]
    for attempt in range(20):
        rng = np.random.default_rng([case.seed, attempt, 20240615])
        truth = draw(effects, rng)
        try:
            edited_model(ROBOTS[robot].text(), truth)
            return make_log(robot, truth, seed=case.seed, rows=rows, episodes=episodes), simulator, effects
        except (RuntimeError, ValueError):
            continue
    raise RuntimeError(f"no world of {case.key} is stable")


def run(case, parameters):
    log, simulator, effects = log_of(case)
    parameters = {"effects": [effect.name for effect in effects], "test_size": 0, **parameters}
    answer, _ = tables.ask(simulator, log.X, log.y, log.groups, seed=case.seed, parameters=parameters)
    return {"robot": log.robot, "truth": log.truth, **answer}


def every(lines):
    """Return (probability, whether right) of every cause and every alias that is told with one."""
    return [
        (p, name in line["truth"])
        for line in lines
        for cause in line["causes"]
        for name, p in [(cause["name"], cause["probability"]), *cause["aliases"]]
        if p is not None
    ]


def report(lines, shown):
    told = every(lines)
    for low, high in itertools.pairwise(BINS):
        some = [(p, right) for p, right in told if low < p <= high]
        stated = np.mean([p for p, _ in some]) if some else np.nan
        error = np.sqrt(sum(p * (1 - p) for p, _ in some)) / len(some) if some else np.nan
        share = np.mean([right for _, right in some]) if some else np.nan
        shown.share(
            f"right where {low} < p <= {high}: stated {stated:.3f}, {(share - stated) / max(error, 1e-12):+.1f} errors",
            [right for _, right in some],
            "within 2 errors, >= 200",
        )
    hidden = [(line, name) for line in lines for name in line["truth"]]
    found = [any(tables.covers(cause, name) for cause in line["causes"]) for line, name in hidden]
    shown.share("hidden causes that are named or an alias", found)
    shown.share("nothing hidden: alarms", [not tables.silent(line) for line in lines if not line["truth"]])
    shown.share("intervals that cover", [one for line in lines for one in tables.in_interval(line)])


def diagram(lines, path):
    """Draw stated against observed probabilities, in tenths."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    told = every(lines)
    figure, axes = plt.subplots(figsize=(4, 4), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    edges = np.linspace(0, 1, 11)
    for low, high in itertools.pairwise(edges):
        some = [(p, right) for p, right in told if low < p <= high]
        if not some:
            continue
        hits = sum(right for _, right in some)
        share, (least, most) = hits / len(some), tables.wilson(hits, len(some))
        stated = np.mean([p for p, _ in some])
        axes.errorbar(stated, share, [[share - least], [most - share]], fmt="o", color="C0", capsize=2)
        axes.annotate(str(len(some)), (stated, share), xytext=(5, -9), textcoords="offset points", fontsize=7)
    axes.set(
        xlabel="stated probability", ylabel="share that is right", xlim=(0, 1), ylim=(0, 1), aspect="equal"
    )
    figure.savefig(path, metadata={"Date": None} if str(path).endswith(".svg") else None)
    plt.close(figure)


TABLE = Table("probabilities", cases, run, report)

if __name__ == "__main__":
    arguments = sys.argv[1:]
    if "--diagram" in arguments:
        at = arguments.index("--diagram")
        target = arguments[at + 1]
        lines = tables.lines_of(tables.RESULTS / "probabilities.jsonl", tables.source_hash())
        if not lines:
            sys.exit("nothing to draw: results/probabilities.jsonl has no line of the sources at hand")
        diagram(lines, target)
        del arguments[at : at + 2]
    tables.main(TABLE, __doc__, arguments)
