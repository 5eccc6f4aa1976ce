"""The state-space engine beside the present one, on the same logs of worlds that share no code with either.

python benchmarks/two_engines.py            # a line of JSON a case in results/two_engines.jsonl; resumes
python benchmarks/two_engines.py --report   # prints the table
python benchmarks/two_engines.py --present  # asks the present engine as well (slow)
"""

import argparse
import json
import time
import warnings
from pathlib import Path

import numpy as np
from tables import source_hash
from worlds.robots import make_log

RESULTS = Path(__file__).parent / "results" / "two_engines.jsonl"
CAUSES = {
    "two_link": ({}, {"dry_friction[elbow]": 0.1}, {"mass[lower]": 1.15}, {"gain[shoulder]": 0.9}),
    "cart_pole": ({}, {"mass[pole]": 1.2}, {"damping[slider]": 0.3}),
    "torque_arm": ({}, {"mass[forearm]": 1.1}, {"damping[elbow]": 1.0}),
    "hopper": ({}, {"mass[torso]": 1.1}, {"gain[leg_joint]": 0.9}),
}
SENSORS = ("ideal", "differences", "lowpass10", "zero_phase", "positions", "encoder")
FORCES = (None, "white5", "white20", "memory20", "resonance20")
# Every force with ideal sensors, every other sensor without one.
PAIRS = [*(("ideal", force) for force in FORCES), *((sensor, None) for sensor in SENSORS[1:])]
SEEDS = range(9110, 9112)


def cases():
    """Yield (key, robot, truth, sensor, force, seed)."""
    for seed in SEEDS:
        for robot, truths in CAUSES.items():
            for truth in truths:
                for sensor, force in PAIRS:
                    yield f"{robot} {truth} {sensor} {force} {seed}", robot, truth, sensor, force, seed


def ask_state_space(simulator, log):
    """Return what the engine on a state space names."""
    from skat.diagnosis import SimulationDiagnosis

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        diagnosis = SimulationDiagnosis(simulator, random_state=0, test_size=0.0).fit(
            log.X, log.y, groups=log.groups
        )
    return {
        "values": {cause.name: cause.value for cause in diagnosis.causes_},
        "intervals": {cause.name: cause.interval for cause in diagnosis.causes_},
        "worth": {cause.name: cause.evidence for cause in diagnosis.causes_},
        "probability": {cause.name: cause.probability for cause in diagnosis.causes_},
        "aliases": {cause.name: [alias.name for alias in cause.aliases] for cause in diagnosis.causes_},
        "verdict": diagnosis.verdict_,
        "computed": diagnosis.computed_velocities_,
        "noise": list(np.round(diagnosis.noise_ / log.sigma, 3)),
    }


def ask_present(simulator, log):
    """Return what SimulationDiagnosis names."""
    from skat.diagnosis import SimulationDiagnosis

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        diagnosis = SimulationDiagnosis(simulator, random_state=0, test_size=0.0).fit(
            log.X, log.y, groups=log.groups
        )
    return {
        "values": {cause.name: cause.value for cause in diagnosis.causes_},
        "intervals": {cause.name: cause.interval for cause in diagnosis.causes_},
        "verdict": diagnosis.verdict_,
    }


def run(engines, limit, only):
    """Ask the engines about each case that has no line yet."""
    from skat.simulators import MujocoSimulator

    there = {(one["key"], one["engine"], one["source"]) for one in lines()}
    source = source_hash()
    for key, robot, truth, sensor, force, seed in [one for one in cases() if one[1] in only][:limit]:
        for engine in engines:
            if (key, engine, source) in there:
                continue
            log = make_log(robot, truth, sensor=sensor, force=force, seed=seed)
            simulator = MujocoSimulator(log.mjcf, frame_skip=log.frame_skip)
            start = time.process_time()
            answer = {"state space": ask_state_space, "present": ask_present}[engine](simulator, log)
            line = {
                "key": key,
                "engine": engine,
                "source": source,
                "robot": robot,
                "truth": log.truth,
                "force": force,
            }
            line |= {"seed": seed, "cpu_s": round(time.process_time() - start, 1), **answer}
            with RESULTS.open("a") as file:
                file.write(json.dumps(line, default=float) + "\n")


def lines():
    """Return the lines there are."""
    return [json.loads(one) for one in RESULTS.read_text().splitlines()] if RESULTS.exists() else []


def _is_among(one):
    """Whether each cause is named, or is an alias of what is."""
    said = {*one["values"], *(name for names in one.get("aliases", {}).values() for name in names)}
    return set(one["truth"]) <= said


def report():
    """Print, for each engine and kind of force, how many logs were answered rightly: lines of the newest sources."""
    newest = {one["engine"]: one["source"] for one in lines()}
    there = [one for one in lines() if one["source"] == newest[one["engine"]]]
    print(*(f"{engine}: sources {source}" for engine, source in newest.items()), sep="\n")
    for engine in ("present", "state space"):
        for sensor, force in PAIRS:
            chosen = [one for one in there if one["engine"] == engine and f" {sensor} {force} " in one["key"]]
            if not chosen:
                continue
            clean = [one for one in chosen if not one["truth"]]
            hidden = [one for one in chosen if one["truth"]]
            alone = sum(set(one["values"]) == set(one["truth"]) for one in hidden)
            among = sum(_is_among(one) for one in hidden)
            covered = [
                one["intervals"][name][0] <= value <= one["intervals"][name][1]
                for one in hidden
                for name, value in one["truth"].items()
                if name in one["values"]
            ]
            alarms = sum(bool(one["values"]) for one in clean)
            unexplained = sum(one.get("verdict") == "unexplained" for one in chosen)
            seconds = np.median([one["cpu_s"] for one in chosen])
            print(
                f"{engine:12} {sensor:12} {force!s:12} alone {alone}/{len(hidden)}  among {among}/{len(hidden)}  "
                f"covered {sum(covered)}/{len(covered)}  alarms {alarms}/{len(clean)}  "
                f"unexplained {unexplained}/{len(chosen)}  {seconds:.1f} s"
            )
    for one in there:
        print(
            one["engine"], one["key"], {name: float(f"{value:.4g}") for name, value in one["values"].items()}
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--report", action="store_true")
    parser.add_argument("--present", action="store_true")
    parser.add_argument("--limit", type=int)
    parser.add_argument("--only", nargs="*", default=list(CAUSES), help="robots")
    options = parser.parse_args()
    if options.report:
        report()
    else:
        run(["state space", "present"] if options.present else ["state space"], options.limit, options.only)
