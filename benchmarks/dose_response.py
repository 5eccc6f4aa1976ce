"""What changed between two measured logs of one machine: doses of exact size, and pairs in which nothing changed.

The doses are made in the measured log: commands scaled (a motor's gain), late by rows (delay), a constant added to a
servo's target (offset), a position's sensor scaled or shifted (scale, bias), two columns swapped, a sign turned. Within
a run, odd blocks of time are the log before and even ones the log after; across runs, motions differ. Beside them what
was really changed: the load of a pendulum, and weights on a brachiating robot. Logs are looked for in
``$SKAT_DATA_HOME``::

    SKAT_DATA_HOME=... python benchmarks/dose_response.py --cut
    SKAT_DATA_HOME=... python benchmarks/dose_response.py --cases ur10     # see tables.py for the rest
"""

import functools

import numpy as np
import tables
from tables import Case, Table

BLOCK = 2.0  # s
# Of each machine: runs that may be compared across, and those of which doses are asked.
# By how much less the two-link arm's shoulder and elbow read than they are turned, rad, by `encoder_zeros.py`.
ZEROS = {
    "143339": {"shoulder": -0.0143, "elbow": -0.0054},
    "143524": {"shoulder": -0.0094, "elbow": -0.0031},
    "143601": {"shoulder": -0.0265, "elbow": 0.0027},
    "143704": {"shoulder": 0.0615, "elbow": -0.0355},
    "143747": {"shoulder": -0.0138, "elbow": 0.0431},
}
ZEROED_ALIKE = 0.03
RUNS = {
    "double_pendulum": ("143339", "143524", "143601", "143704", "143747"),
    "pendulum": (0.5, 1.0),
    "ur10": ("",),
    "ricmonk": ("no load", "170 g on one arm", "200 g on both arms"),
    "so101": (
        *("backlash_detection", "chirp_sweep", "friction_gravity", "hold_under_gravity", "multisine"),
        *("pick_place", "prbs_excitation", "single_joint_elbow", "step_response", "velocity_ramp"),
    ),
    "go2_air": ("",),
}
# Runs that move every joint, and of which doses are asked.
DOSED = {
    "double_pendulum": ("143339", "143524", "143601"),
    "pendulum": (0.5, 1.0),
    "ur10": ("",),
    "ricmonk": ("no load", "200 g on both arms"),
    "so101": ("friction_gravity", "multisine"),
    "go2_air": ("",),
}
# Actuators, and joints that gravity pulls at: of others a shifted position changes nothing.
MOTORS = {
    "double_pendulum": ("shoulder", "elbow"),
    "pendulum": ("motor",),
    "ur10": ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint"),
    "ricmonk": ("tail", "phi"),
    "so101": ("Pitch", "Elbow", "Wrist_Pitch"),
    "go2_air": ("FL_hip", "FR_thigh", "RL_calf", "RR_thigh"),
}
JOINTS = {
    "double_pendulum": ("shoulder", "elbow"),
    "pendulum": ("hinge",),
    "ur10": ("shoulder_lift_joint", "elbow_joint"),
    "ricmonk": ("arm1", "tail"),
    "so101": ("Pitch", "Elbow"),
    "go2_air": ("FL_thigh_joint", "RR_calf_joint"),
}
SERVOS = ("so101", "go2_air")
DOSES = {
    "gain": (0.8, 0.9, 1.1, 1.25),
    "delay": (1, 2, 3),
    "offset": (-0.1, -0.05, 0.05, 0.1),
    "bias": (-0.1, -0.05, 0.05, 0.1),
    "scale": (0.9, 0.95, 1.05, 1.1),
    "swap": (1.0,),
    "flip": (1.0,),
}
FEWEST_ROWS = 200


def cases(cut):
    found = []
    for machine, runs in DOSED.items():
        kinds = ("delay", "offset" if machine in SERVOS else "gain", "bias", "scale", "swap", "flip")
        for kind in kinds:
            targets = {"delay": ("action",), "bias": JOINTS[machine], "scale": JOINTS[machine]}
            for index, target in enumerate(targets.get(kind, MOTORS[machine])):
                if kind == "swap" and len(MOTORS[machine]) < 2:
                    continue
                for number, dose in enumerate(DOSES[kind][:1] if cut else DOSES[kind]):
                    run = runs[(number + index) % len(runs)]
                    settings = {"kind": kind, "target": target, "dose": dose, "before": run, "after": run}
                    found.append(Case(f"dose | {machine} | {run} | {kind} {target} {dose}", 0, settings))
    for machine, runs in RUNS.items():
        for run in runs[:1] if cut else runs:
            for turn in range(2):
                found.append(
                    Case(f"nothing | {machine} | {run} | {'back' if turn else 'forth'}", turn,
                         {"before": run, "after": run})
                )  # fmt: skip
    for machine in ("double_pendulum", "so101"):
        pairs = [(one, other) for one in RUNS[machine] for other in RUNS[machine] if one != other]
        for one, other in pairs[::20] if cut else pairs:
            found.append(Case(f"across | {machine} | {one} | {other}", 0, {"before": one, "after": other}))
    runs = DOSED["double_pendulum"]
    for index, (one, other) in enumerate((a, b) for a in runs for b in runs if a != b):
        for kind, target, dose in (
            ("gain", MOTORS["double_pendulum"][index % 2], DOSES["gain"][index % 4]),
            ("scale", JOINTS["double_pendulum"][index % 2], DOSES["scale"][index % 4]),
        ):
            settings = {"kind": kind, "target": target, "dose": dose, "before": one, "after": other}
            found.append(
                Case(
                    f"dose across | double_pendulum | {one} to {other} | {kind} {target} {dose}", 0, settings
                )
            )
    found.append(Case("real | pendulum | 1 kg for .5 kg", 0, {"before": 0.5, "after": 1.0}))
    found.append(Case("real | pendulum | .5 kg for 1 kg", 0, {"before": 1.0, "after": 0.5}))
    for load in ("170 g on one arm", "200 g on both arms"):
        found.append(Case(f"real | ricmonk | {load}", 0, {"before": "no load", "after": load}))
    return found


@functools.lru_cache(maxsize=4)
def run_of(machine, run):
    """Return X, y, groups of a run."""
    from skat import datasets

    fetch = getattr(datasets, f"fetch_{machine}")
    if machine == "pendulum":
        # One piece: where it is cut, motion is smoothed worse.
        bunch = fetch(load=run, seconds=4.0, download_if_missing=False)
    else:
        bunch = fetch(*([run] if run else []), download_if_missing=False)
    groups = np.asarray(bunch.groups)
    long = np.isin(groups, [one for one in np.unique(groups) if np.sum(groups == one) > 50])
    return np.array(bunch.data, float)[long], np.array(bunch.target, float)[long], groups[long]


def halves(log, dt):
    """Return odd and even blocks of a log, shorter ones of a short log, as episodes."""
    X, y, groups = log
    block = round(min(BLOCK, len(X) * dt / 8) / dt)
    places = np.concatenate([np.arange(np.sum(groups == one)) for one in dict.fromkeys(groups)])
    number = places // block
    labels = groups * 10_000 + number
    return [(X[number % 2 == side], y[number % 2 == side], labels[number % 2 == side]) for side in range(2)]


def dosed(simulator, log, kind, target, dose):
    """Return a log with a dose, and its truth."""
    X, y, groups = log[0].copy(), log[1].copy(), log[2]
    inputs, outputs = list(simulator.input_names), list(simulator.output_names)
    controls = [inputs.index(name) for name in inputs if name.startswith("ctrl.")]
    if kind == "delay":
        for one in np.unique(groups):
            own = np.flatnonzero(groups == one)
            X[np.ix_(own[dose:], controls)] = log[0][np.ix_(own[:-dose], controls)]
        # What was logged is late, so that the machine is early.
        return (X, y, groups), {"delay[action]": -dose * simulator.dt}
    if kind in ("gain", "offset", "flip"):
        column = inputs.index(f"ctrl.{target}")
        if kind == "offset":
            X[:, column] += dose
            return (X, y, groups), {f"offset[{target}]": -dose}
        X[:, column] *= dose if kind == "gain" else -1
        return (X, y, groups), {f"gain[{target}]": 1 / dose} if kind == "gain" else {
            f"ctrl.{target} sign": 1.0
        }
    if kind == "swap":
        column = inputs.index(f"ctrl.{target}")
        other = controls[(controls.index(column) + 1) % len(controls)]
        X[:, [column, other]] = X[:, [other, column]]
        return (X, y, groups), {f"{inputs[column]} and {inputs[other]} swapped": 1.0}
    name = f"qpos.{target}"
    for table, columns in ((X, inputs), (y, outputs)):
        column = columns.index(name)
        table[:, column] = table[:, column] * dose if kind == "scale" else table[:, column] + dose
    return (X, y, groups), {f"{kind}[{name}]": dose}


def run(case, parameters):
    from skat.simulators import make_simulator

    what, machine, *_ = case.name.split(" | ")
    settings = case.settings
    simulator = make_simulator(machine)
    if settings["before"] == settings["after"]:
        before, after = halves(run_of(machine, settings["before"]), simulator.dt)
        if case.seed:
            before, after = after, before
    else:
        before, after = (run_of(machine, settings[one]) for one in ("before", "after"))
    truth = {}
    if "dose" in settings:
        after, truth = dosed(simulator, after, settings["kind"], settings["target"], settings["dose"])
    if min(len(before[0]), len(after[0])) < FEWEST_ROWS:
        return {"what": what, "machine": machine, "truth": truth, "verdict": "too short", "causes": []}
    # The pendulum's rates were computed.
    if machine == "pendulum":
        parameters = {"hidden": ["qvel.hinge"], **parameters}
    answer = tables.ask_change(simulator, before, after, seed=case.seed, parameters=parameters)
    return {"what": what, "machine": machine, "kind": settings.get("kind"), "truth": truth, **answer}


def moved_zeros(line):
    """Return by how much more sensors read in the second run, rad, of those that were zeroed otherwise."""
    if (line["what"], line["machine"]) != ("across", "double_pendulum"):
        return {}
    *_, before, after = line["case"].partition(" #")[0].split(" | ")
    moved = {f"bias[qpos.{joint}]": zero - ZEROS[after][joint] for joint, zero in ZEROS[before].items()}
    return {name: value for name, value in moved.items() if abs(value) > ZEROED_ALIKE}


def told_mixed_up(line):
    """Whether the columns that were mixed up are told, by their names."""
    (what,) = line["truth"]
    if what.endswith("sign"):
        motor = what.removeprefix("ctrl.").removesuffix(" sign")
        if any(cause["name"] == f"gain[{motor}]" and cause["value"] < 0 for cause in line["causes"]):
            return True
    return all(word in line["mistake"] for word in what.split() if word.startswith("ctrl."))


def right(line):
    """Whether the dose is a cause, or an alias of one."""
    (truth,) = line["truth"]
    return any(tables.covers(cause, truth) for cause in line["causes"])


def is_detectable(line, lines):
    """Whether a dose is as large as its untouched halves say that it has to be; None where they were not asked."""
    _, machine, run, *_ = line["case"].split(" | ")
    for other in lines:
        if other["case"] == f"nothing | {machine} | {run} | forth":
            if "detectable" not in other or other["verdict"] != "nothing changed":
                return None
            ((name, size),) = line["truth"].items()
            neutral = 1.0 if line["kind"] in ("gain", "scale") else 0.0
            return abs(size - neutral) >= other["detectable"].get(name, np.inf)
    return None


def report(lines, shown):
    dose = [line for line in lines if line["what"] == "dose" and line["kind"] not in ("swap", "flip")]
    shown.share("doses: right family and element, or alias", map(right, dose), "95 %")
    shown.share(
        "... nothing else named", [not line["causes"] or tables.or_alias(line) for line in dose], "90 %"
    )
    told = {True: [], False: [], None: []}
    for line in dose:
        told[is_detectable(line, lines)].append(line)
    shown.share("... as large as the untouched halves say: right", map(right, told[True]), "95 %")
    shown.share("... smaller: right", map(right, told[False]))
    for kind in ("gain", "delay", "offset", "bias", "scale"):
        mine = [line for line in dose if line["kind"] == kind]
        shown.share(f"... {kind}: right", map(right, mine))
        shown.share(f"... {kind}: alone, by its own name", map(tables.alone, mine))
    for machine in RUNS:
        mine = [line for line in dose if line["machine"] == machine]
        shown.share(f"... {machine}: right and nothing else", map(tables.or_alias, mine))
    pairs = [
        (line["truth"][cause["name"]], cause["value"])
        for line in dose
        for cause in line["causes"]
        if cause["name"] in line["truth"]
    ]
    if len(pairs) > 2:
        for kind in ("gain", "delay", "offset", "bias", "scale"):
            some = [
                (line["truth"][cause["name"]], cause["value"])
                for line in dose
                if line["kind"] == kind
                for cause in line["causes"]
                if cause["name"] in line["truth"]
            ]
            if len(some) > 2:
                neutral = 1.0 if kind in ("gain", "scale") else 0.0
                x, found = np.array(some).T - neutral
                shown.number(
                    f"... {kind}: slope of size against dose", [float(x @ found / (x @ x))], "1 +- .03"
                )
    shown.share(
        "... intervals that cover", [one for line in dose for one in tables.in_interval(line)], "92 %"
    )
    mixed = [line for line in lines if line["what"] == "dose" and line["kind"] in ("swap", "flip")]
    shown.share("swapped and turned columns told", map(told_mixed_up, mixed), "every one")
    for what, label, wanted in (
        ("nothing", "nothing changed: named", "<= 2 %"),
        ("across", "other motions: named", "<= 3 %"),
    ):
        for machine in (None, *RUNS):
            mine = [line for line in lines if line["what"] == what and machine in (None, line["machine"])]
            mine = [line for line in mine if line["verdict"] != "too short" and not moved_zeros(line)]
            shown.share(
                label if machine is None else f"... {machine}",
                [bool(line["causes"]) for line in mine],
                wanted if machine is None else "",
            )
        mine = [line for line in lines if line["what"] == what and not moved_zeros(line)]
        differing = [line["verdict"] == "unexplained" for line in mine]
        shown.share("... told to differ by nothing that has a name", differing)
    zeroed = [line for line in lines if moved_zeros(line)]
    told = [
        [one for one in line["causes"] if any(tables.covers(one, name) for name in moved_zeros(line))]
        for line in zeroed
    ]
    shown.share("a zero that moved by itself: told, or an alias of it", map(bool, told))
    shown.share("... another name", [len(line["causes"]) > len(some) for line, some in zip(zeroed, told)])
    shown.share("... unexplained", [line["verdict"] == "unexplained" for line in zeroed])
    shown.number(
        "... by itself: its size, of what least squares say",
        [
            one["value"] / moved_zeros(line)[one["name"]]
            for line, some in zip(zeroed, told)
            for one in some
            if one["name"] in moved_zeros(line)
        ],
    )
    across = [line for line in lines if line["what"] == "dose across"]
    shown.share("doses across motions: right", map(right, across), "90 %")
    shown.share("... and nothing else", map(tables.or_alias, across))


TABLE = Table("dose_response", cases, run, report, of_changes=True)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
