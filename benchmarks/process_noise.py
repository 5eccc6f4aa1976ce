"""Random forces on the joints: whether causes are still named, intervals cover, and the sensors' noise is found.

Robots: puck, Hopper, two-link arm, cart-pole, servo arm. Forces of 5 and 20 % of the rms torque of the motors: white,
with a memory of 0.2 s, and a resonance at 20 Hz. Some logs have a force beside the random one that no effect is: there
the noise that is found is judged, and nothing else::

    python benchmarks/process_noise.py --cut
    python benchmarks/process_noise.py --cases "| memory20"     # see tables.py for the rest

A rod that bends under a pendulum, whose encoder sits at the motor, is a force that is taken back
(`worlds.flexible`): positions alone, one cause each, or none. A base that shakes pushes both joints of an arm at once
(`worlds.shaken`), with speeds measured and not. An arm in continuous time is what no step of its model is
(`worlds.continuous`): its time step is wrong in every log, and may be named.

Causes have sizes s of 0.3 to 5, which count the random force as noise (`worlds.robots.size_of`).
"""

import numpy as np
import sensors
import tables
from tables import Case, Table
from worlds import continuous, flexible, shaken
from worlds.robots import World, make_log
from worlds.worth import noise_bound

from skat.simulators import MujocoSimulator

ROBOTS = ("puck", "hopper", "two_link", "cart_pole", "servo_arm")
# The interval of 88 % is for memory20 and resonance20.
KINDS = ("white5", "white20", "memory5", "memory20", "resonance5", "resonance20")
CAUSES = {robot: sensors.CAUSES[robot] for robot in ROBOTS if robot != "cart_pole"} | {
    "cart_pole": {
        "mass[pole]": ((0.6, 0.8), (1.25, 1.6)),
        "dry_friction[slider]": ((0.4, 1.5),),
        "damping[hinge]": ((0.003, 0.01),),
        "gain[push]": ((0.7, 0.85), (1.15, 1.3)),
        "tilt[x]": ((-0.08, -0.03), (0.03, 0.08)),
        "delay[action]": ((0.018, 0.022),),
    }
}
N_CLEAN = 200
N_UNMODELLED, UNMODELLED = 20, 0.2
N_FLEXIBLE, N_FLEXIBLE_CLEAN = 10, 20
N_SHAKEN, N_SHAKEN_CLEAN = 8, 20
N_CONTINUOUS, N_CONTINUOUS_CLEAN = 3, 6
ODD = {"flexible": flexible, "shaken": shaken, "continuous": continuous}
VISIBLE = 0.3
SIZES = (0.3, 5.0)


def cases(cut):
    found = []
    kinds = KINDS[1:3] if cut else KINDS
    for kind in kinds:
        for robot in ROBOTS:
            for name in list(CAUSES[robot])[:1] if cut else CAUSES[robot]:
                found.append(Case(f"cause | {robot} | {kind} | {name}", 4000, {"cause": name}))
    pairs = [(robot, kind) for kind in kinds for robot in ROBOTS]
    for index in range(len(pairs) if cut else N_CLEAN):
        robot, kind = pairs[index % len(pairs)]
        found.append(Case(f"clean | {robot} | {kind}", 5000 + index // len(pairs), {}))
    for index in range(2 if cut else N_UNMODELLED):
        robot, kind = ROBOTS[index % len(ROBOTS)], KINDS[index // len(ROBOTS) % 2]
        found.append(Case(f"unmodelled | {robot} | {kind}", 6000 + index, {"unmodelled": UNMODELLED}))
    for name, value in flexible.CAUSES.items():
        for seed in range(1 if cut else N_FLEXIBLE):
            found.append(Case(f"flexible | pendulum | {name}", 7000 + seed, {"truth": {name: value}}))
    for seed in range(1 if cut else N_FLEXIBLE_CLEAN):
        found.append(Case("flexible | pendulum | nothing", 7000 + seed, {"truth": {}}))
    for name, value in (*shaken.CAUSES.items(), ("nothing", None)):
        for seed in range(1 if cut else N_SHAKEN_CLEAN if value is None else N_SHAKEN):
            truth = {} if value is None else {name: value}
            settings = {"truth": truth, "how": {"measured": seed % 2 == 0}}
            found.append(Case(f"shaken | two_link | {name}", 8000 + seed, settings))
    for name, value in (*continuous.CAUSES.items(), ("nothing", None)):
        truth = {} if value is None else {name: value}
        for seed in range(1 if cut else N_CONTINUOUS_CLEAN if value is None else N_CONTINUOUS):
            found.append(Case(f"continuous | scara | {name}", 9000 + seed, {"truth": truth}))
    return found


def log_of(case):
    """Return the log of a case."""
    _, robot, kind, *_ = case.name.split(" | ")
    name = case.settings.get("cause")
    truth = {name: value_of(robot, kind, name, case.seed)} if name else {}
    return make_log(robot, truth, force=kind, seed=case.seed, unmodelled=case.settings.get("unmodelled", 0.0))


def value_of(robot, kind, name, seed):
    """Return the value at which a cause has about the s that a seed draws, log-uniform in `SIZES`.

    s grows with the square of a strength: two pilots of 300 rows find it. Where that takes more than a world bears, the
    value is the largest.
    """
    rng = np.random.default_rng([seed, sum(robot.encode()), sum(name.encode())])
    ranges = CAUSES[robot][name]
    low, high = ranges[rng.integers(len(ranges))]
    wanted = np.exp(rng.uniform(*np.log(SIZES)))
    family = name.partition("[")[0]
    is_factor = family in ("mass", "gain", "gravity", "kp", "contact_friction")
    strength = np.log(low * high) / 2 if is_factor else (low + high) / 2
    most = {"delay": 4 * World(robot).dt, "tilt": 0.5, "offset": 0.3}.get(
        family, 20 * max(abs(low), abs(high))
    )
    most = max(np.log(3.0), abs(strength)) if is_factor else most

    def value(strength):
        return float(np.exp(strength) if is_factor else strength)

    for _ in range(2):
        try:
            size = make_log(robot, {name: value(strength)}, force=kind, seed=seed + 500_000, rows=300).size
        except RuntimeError:  # Too much for this world.
            strength /= 2
            continue
        strength = float(np.clip(strength * np.sqrt(wanted / max(size, 1e-6)), -most, most))
    try:
        make_log(robot, {name: value(strength)}, force=kind, seed=seed)
    except RuntimeError:
        strength /= 2
    return value(strength)


def run(case, parameters):
    what, robot, kind, *_ = case.name.split(" | ")
    if what in ODD:
        return _run_odd(what, robot, case, parameters)
    log = log_of(case)
    answer, _ = tables.ask(
        tables.simulator_of(log), log.X, log.y, log.groups, seed=case.seed, parameters=parameters
    )
    return {
        "kind": what,
        "robot": robot,
        "force": kind,
        "truth": log.truth,
        "size": log.size,
        "sigma": log.sigma.tolist(),
        # The least standard error of a log standard deviation that any estimate of it can have, by channel.
        "bound": noise_bound(log).tolist(),
        **answer,
    }


def _run_odd(what, robot, case, parameters):
    world, truth, how = ODD[what], case.settings["truth"], case.settings.get("how", {})
    simulator = MujocoSimulator(world.nominal(), frame_skip=world.STEPS)
    X, y, groups = world.log_of(truth, seed=case.seed, **how)
    answer, _ = tables.ask(simulator, X, y, groups, seed=case.seed, parameters=parameters)
    parts = ["timestep"] if what == "continuous" else []
    return {"kind": what, "robot": robot, "truth": truth, "parts": parts, **how, **answer}


def _ratios(line):
    """Return, for each channel with noise, the log ratio of estimated to true noise, and its Fisher bound."""
    estimated = np.asarray(line.get("noise", []), float)
    sigma, bound = np.asarray(line["sigma"]), np.asarray(line["bound"])
    usable = sigma > 0
    if estimated.shape != sigma.shape:
        return []
    with np.errstate(divide="ignore"):
        return list(zip(np.log(estimated[usable] / sigma[usable]), bound[usable]))


def report(lines, shown):
    causes = [line for line in lines if line["kind"] == "cause"]
    clean = [line for line in lines if line["kind"] == "clean"]
    visible = [line for line in causes if line["size"] >= VISIBLE]
    shown.share("clean: alarms", [not tables.silent(line) for line in clean], "<= 2 %")
    shown.share(
        f"s >= {VISIBLE}: named first", [tables.names(x)[:1] == list(x["truth"]) for x in visible], ">= 95 %"
    )
    shown.share("... alone", map(tables.alone, visible))
    shown.share("... named or alias, alone", map(tables.or_alias, visible))
    shown.share(
        f"s < {VISIBLE}: named or alias", map(tables.or_alias, [x for x in causes if x not in visible])
    )
    mild = [x for x in causes if x["force"].startswith("white") or x["force"].endswith("5")]
    rest = [x for x in causes if x not in mild]
    for label, some, wanted in (("white and 5 %", mild, "92 to 98 %"), ("the rest", rest, ">= 88 %")):
        shown.share(
            f"intervals that cover, {label}", [one for x in some for one in tables.in_interval(x)], wanted
        )
    for kind in KINDS:
        shown.share(
            f"... {kind}: named first",
            [tables.names(x)[:1] == list(x["truth"]) for x in visible if x["force"] == kind],
        )
        shown.share(f"... {kind}: alarms", [not tables.silent(x) for x in clean if x["force"] == kind])
    odd = {kind: [line for line in lines if line["kind"] == kind] for kind in ODD}
    for label, some in (("rod that bends", odd["flexible"]), ("base that shakes", odd["shaken"])):
        shown.share(f"{label}: named or alias", map(tables.or_alias, [x for x in some if x["truth"]]))
        shown.share("... alone", map(tables.alone, [x for x in some if x["truth"]]))
        shown.share("... intervals that cover", [one for x in some for one in tables.in_interval(x)])
        shown.share("... alarms", [not tables.silent(x) for x in some if not x["truth"]])
    shown.share(
        "continuous time: nothing named but the time step and what is hidden",
        [set(tables.names(x)) - {"timestep"} == set(x["truth"]) for x in odd["continuous"]],
    )
    ratios = [pair for line in lines if "sigma" in line for pair in _ratios(line)]
    shown.share(
        "noise within its Fisher 95 % interval", [abs(r) <= 1.96 * b for r, b in ratios], "92 to 98 %"
    )
    known = [r for r, b in ratios if b <= 0.04]
    shown.share("noise within 10 %, bound <= 4 %", [abs(r) <= np.log(1.1) for r in known], ">= 90 %")
    wrong_in_one = [line for kind in ("flexible", "shaken") for line in odd[kind]]
    shown.probabilities(causes + clean + wrong_in_one)


TABLE = Table("process_noise", cases, run, report)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
