"""Fit with ``mujoco.sysid`` what it is given, and diagnose the same data with ``skat``, side by side.

The Hopper's knee has a dry friction that its model lacks. Two people use ``mujoco.sysid``: one asks for the
right parameter among four (mass, damping, stiffness and dry friction), the other for mass, damping and
stiffness alone, as nothing tells that friction is what is missing. `SimulationDiagnosis` is told nothing.
Printed are parameter errors, in how many runs 95 % intervals hold the truth, seconds and time steps::

    python benchmarks/sysid_comparison.py --runs 20

``mujoco.sysid`` fits stretches of ``--stretch`` transitions in open loop, each from its measured first state,
with residuals in units of each channel's spread, its own optimizer and intervals. Needs ``mujoco[sysid]``.
"""

import argparse
import json
import logging
import time
import warnings
from pathlib import Path

import mujoco
import numpy as np
from hidden_effects import nominal_simulator
from rich.console import Console
from rich.progress import track
from rich.table import Table
from worlds import FRAME_SKIP, measure, nominal_mjcf, nominal_model

KIND, BODY, JOINT = "hopper", "leg", "leg_joint"
RESULTS = Path(__file__).parent / "results" / "sysid_comparison.jsonl"
PARAMETERS = {
    # Name: (neutral, smallest, largest).
    f"mass[{BODY}]": (1.0, 0.3, 3.0),
    f"damping[{JOINT}]": (0.0, -0.99, 20.0),
    f"stiffness[{JOINT}]": (0.0, 0.0, 100.0),
    f"dry_friction[{JOINT}]": (0.0, 0.0, 50.0),
}


def main():
    arguments = _arguments()
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    results = []
    with arguments.output.open("w") as file:
        for seed in track(range(arguments.runs), description="data sets"):
            friction = float(np.random.default_rng(seed).uniform(3.0, 12.0))
            log = measure(KIND, [("dry_friction", JOINT, friction)], seed=seed, n_episodes=arguments.episodes)
            truth = {name: neutral for name, (neutral, _, _) in PARAMETERS.items()}
            truth[f"dry_friction[{JOINT}]"] = friction
            given = list(PARAMETERS)
            runs = [
                ("sysid, friction given", fit_sysid, (given, arguments.stretch)),
                ("sysid, friction not given", fit_sysid, (given[:3], arguments.stretch)),
                ("skat, nothing given", diagnose, (seed,)),
            ]
            for who, run, options in runs[: 2 if arguments.only_sysid else 3]:
                result = {"who": who, "seed": seed, "truth": truth, **run(log, *options)}
                results.append(result)
                file.write(json.dumps(result) + "\n")
                file.flush()
    report(results, Console())


def fit_sysid(log, names, stretch):
    """Return estimates, half widths of 95 % intervals, seconds and time steps of ``mujoco.sysid``."""
    from mujoco import sysid

    logging.disable(logging.WARNING)
    steps = [0]
    parameters = sysid.ParameterDict()
    for name in names:
        neutral, low, high = PARAMETERS[name]
        parameters.add(
            sysid.Parameter(name, nominal=neutral, min_value=low, max_value=high, modifier=_modifiers()[name])
        )
    sequences = _sequences(log, stretch)
    spread = log.y.std(axis=0)

    def compare(params, predicted, measured, model, return_all, *, state, **_):
        del params, return_all
        steps[0] += len(state)
        frames = state[FRAME_SKIP[KIND] - 1 :: FRAME_SKIP[KIND], 1 : 1 + model.nq + model.nv]
        residual = (frames - measured.data) / spread
        series = sysid.TimeSeries(measured.times, frames, measured.signal_mapping)
        return residual, series, measured

    residual = sysid.build_residual_fn(
        models_sequences=[sequences], modify_residual=compare, resample_true=False
    )
    start = time.perf_counter()
    found, result = sysid.optimize(
        initial_params=parameters, residual_fn=residual, optimizer="mujoco", verbose=False
    )
    residuals, _, _ = residual(result.x, found)
    _, half_widths = sysid.calculate_intervals(residuals, result.jac)
    return {
        "estimates": dict(zip(names, map(float, result.x), strict=True)),
        "half_widths": dict(zip(names, map(float, half_widths), strict=True)),
        "seconds": time.perf_counter() - start,
        "steps": steps[0],
    }


def diagnose(log, seed):
    """Return causes, their intervals and seconds of a diagnosis that is told nothing; it counts no time steps."""
    from skat.diagnosis import SimulationDiagnosis

    warnings.filterwarnings("ignore")
    simulator = nominal_simulator(KIND)
    start = time.perf_counter()
    diagnosis = SimulationDiagnosis(simulator, random_state=seed, n_jobs=2).fit(
        log.X, log.y, groups=log.groups
    )
    seconds = time.perf_counter() - start
    return {
        "verdict": diagnosis.verdict_,
        "estimates": {cause.name: float(cause.value) for cause in diagnosis.causes_},
        "half_widths": {
            cause.name: float(cause.interval[1] - cause.interval[0]) / 2 for cause in diagnosis.causes_
        },
        "aliases": {cause.name: [alias.name for alias in cause.aliases] for cause in diagnosis.causes_},
        "seconds": seconds,
        "steps": None,
    }


def report(results, console):
    """Print one row for each tool and parameter."""
    table = Table(
        "who",
        "parameter",
        "estimates",
        "error, median",
        "95 % interval covers",
        "seconds",
        "steps",
        title=KIND,
    )
    for who in dict.fromkeys(result["who"] for result in results):
        mine = [result for result in results if result["who"] == who]
        seconds = f"{np.median([result['seconds'] for result in mine]):.1f}"
        steps = [result["steps"] for result in mine if result["steps"] is not None]
        steps = f"{np.median(steps):,.0f}" if steps else "not told"
        for name in dict.fromkeys(name for result in mine for name in result["estimates"]):
            some = [result for result in mine if name in result["estimates"]]
            truth = [result["truth"].get(name) for result in some]
            if None in truth:
                table.add_row(who, name, str(len(some)), "a false cause", "", seconds, steps)
                continue
            errors = [abs(result["estimates"][name] - true) for result, true in zip(some, truth, strict=True)]
            covers = [
                error <= result["half_widths"][name] for result, error in zip(some, errors, strict=True)
            ]
            table.add_row(
                who, name, str(len(some)), f"{np.median(errors):.4g}", f"{sum(covers)}", seconds, steps
            )
    console.print(table)


def _sequences(log, stretch):
    """Return the log as ``mujoco.sysid`` takes it: stretches, with controls at every time step."""
    from mujoco import sysid

    model = nominal_model(KIND)
    n_states, h = model.nq + model.nv, model.opt.timestep
    mapping = {"state": (sysid.SignalType.CustomObs, np.arange(n_states))}
    names, starts, controls, measured = [], [], [], []
    for episode in np.unique(log.groups):
        rows = np.flatnonzero(log.groups == episode)
        for first in range(0, len(rows) - stretch + 1, stretch):
            chosen = rows[first : first + stretch]
            state = log.X[chosen[0], :n_states]
            actions = np.repeat(log.X[chosen, n_states:], FRAME_SKIP[KIND], axis=0)
            # Its rollout leaves the last control out.
            actions = np.concatenate([actions, actions[-1:]])
            names.append(f"{episode}, {first}")
            starts.append(sysid.create_initial_state(model, state[: model.nq], state[model.nq :]))
            controls.append(sysid.TimeSeries(h * np.arange(len(actions)), actions))
            times = h * FRAME_SKIP[KIND] * np.arange(1, stretch + 1)
            measured.append(sysid.TimeSeries.create(times, log.y[chosen], mapping))
    spec = mujoco.MjSpec.from_string(nominal_mjcf(KIND))
    return sysid.ModelSequences(KIND, spec, names, starts, controls, measured, allow_missing_sensors=True)


def _modifiers():
    """Return how ``mujoco.sysid`` puts each parameter into a spec."""

    def mass(spec, parameter):
        for geom in spec.body(BODY).geoms:
            geom.density = 1000.0 * parameter.value[0]

    def damping(spec, parameter):
        spec.joint(JOINT).damping[0] = 1.0 + parameter.value[0]

    def stiffness(spec, parameter):
        spec.joint(JOINT).stiffness[0] = parameter.value[0]

    def dry_friction(spec, parameter):
        spec.joint(JOINT).frictionloss = parameter.value[0]

    return dict(zip(PARAMETERS, (mass, damping, stiffness, dry_friction), strict=True))


def _arguments():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=20, help="data sets")
    parser.add_argument("--episodes", type=int, default=30, help="of 50 transitions each")
    parser.add_argument(
        "--stretch", type=int, default=10, help="transitions that sysid simulates in open loop"
    )
    parser.add_argument("--only-sysid", action="store_true")
    parser.add_argument("--output", type=Path, default=RESULTS)
    return parser.parse_args()


if __name__ == "__main__":
    main()
