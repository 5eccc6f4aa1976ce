"""Studies: what five measured robots' models get wrong, each a page of the documentation.

Each is asked once, with least squares and ``mujoco.sysid`` of a given list of parameters on the same rows beside it,
all compared on motions that none of them used. What is done is kept in ``--work``, so that an interrupted script goes
on; delete that folder to begin anew. Numbers, tables and figures are written into ``docs/studies``; the pages' words
are written by hand. Logs are looked for in ``$SKAT_DATA_HOME``; ``mujoco.sysid`` needs ``mujoco[sysid]``::

    SKAT_DATA_HOME=... python benchmarks/studies.py             # all: hours
    SKAT_DATA_HOME=... python benchmarks/studies.py ur10 go2_air
"""

import argparse
import json
import os
import subprocess
import tempfile
import time
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import open_loop
import rigid_bodies
import study_pages
from open_loop import Parameter

from skat import datasets
from skat.diagnosis import SimulationDiagnosis, compare_findings
from skat.diagnosis.forces.motions import motion_of
from skat.diagnosis.report.machine import findings_as_data, plain
from skat.simulators import MujocoSimulator, make_simulator

SYSID_LIMIT = 90.0  # s
LEAST_SQUARES_LIMIT = 180.0  # s


class Kept:
    """What was done already: diagnoses and other answers, by name, in a folder."""

    def __init__(self, folder, parts=True):
        self.folder, self.parts = Path(folder), parts
        self.folder.mkdir(parents=True, exist_ok=True)

    def answer(self, name, make):
        """Return what ``make`` returns as JSON holds it, made once."""
        file = self.folder / f"{name}.json"
        if not file.exists():
            answer = make()
            file.write_text(json.dumps(answer))
        return json.loads(file.read_text())

    def diagnosis(self, name, simulator, X, y, groups, **parameters):
        """Return a fitted diagnosis and what it took, made once; all rows are fitted."""
        file = self.folder / f"{name}.skat"
        if not file.exists():
            start, cpu, load = time.perf_counter(), time.process_time(), os.getloadavg()[0]
            diagnosis = SimulationDiagnosis(simulator, test_size=0, random_state=0, **parameters)
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                diagnosis.fit(X, y, groups=groups, resume=self.folder / f"{name}.begun")
            cost = {
                "seconds": time.perf_counter() - start,
                "cpu_seconds": time.process_time() - cpu,
                "load": load,
                "warnings": sorted({str(one.message) for one in told}),
                "commit": commit(),
            }
            (self.folder / f"{name}.cost.json").write_text(json.dumps(cost))
            diagnosis.save(file)
        cost = json.loads((self.folder / f"{name}.cost.json").read_text())
        return SimulationDiagnosis.load(file), cost


def commit():
    """Return the commit that is checked out."""
    said = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True
    )
    return said.stdout.strip()


# -- models and paths --------------------------------------------------------------------------------------------------


def exported(simulator):
    """Return a simulator's model as MJCF text, and effects that MJCF cannot hold, by name."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.xml"
        simulator.to_mjcf(path)
        beside = path.with_name("model.effects.json")
        left = json.loads(beside.read_text()) if beside.exists() else {}
        return path.read_text(), left


def open_loop_angles(simulator, stretches):
    """Return angles in open loop, a list of arrays of shape (n_rows, n_joints).

    By plain MuJoCo where the model holds everything; else by the simulator, from the same states and commands.
    """
    mjcf, beside = exported(simulator)
    if not beside:
        model = mujoco.MjModel.from_xml_string(mjcf)
        return [plain_path(model, one, round(simulator.dt / model.opt.timestep)) for one in stretches]
    found = []
    for one in stretches:
        start = np.concatenate([one.qpos, one.qvel])
        states = simulator.rollout([start], one.commands[None], n_steps=len(one.commands))[0]
        found.append(states[1:, : len(one.qpos)])
    return found


def plain_path(model, stretch, frame_skip):
    """Return angles of a stretch in open loop by `mujoco.mj_step`; NaN from where they leave all bounds."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = stretch.qpos, stretch.qvel
    for motor in np.flatnonzero(model.actuator_delay > 0):
        # Where commands come late, the first one held before.
        held = np.full((int(model.actuator_history[motor, 0]), 1), stretch.commands[0, motor])
        mujoco.mj_initCtrlHistory(model, data, int(motor), None, held)
    found = np.full_like(stretch.after, np.nan)
    for row, command in enumerate(stretch.commands):
        data.ctrl[:] = command
        mujoco.mj_step(model, data, frame_skip)
        if not np.isfinite(data.qpos).all() or np.abs(data.qpos).max() > 1e3:
            break
        found[row] = data.qpos
    return found


def fitted_angles(mjcf, parameters, values, stretches, frame_skip):
    """Return angles in open loop of a model with values written into it, as `open_loop_angles`."""
    model, delay = open_loop.compiled(mjcf, parameters, values)
    found = {}
    for some in open_loop.by_length(stretches):
        together = open_loop.paths([model], [delay], some, frame_skip)[0]
        found |= {id(one): path for one, path in zip(some, together, strict=True)}
    return [found[id(one)] for one in stretches]


def distance(paths, stretches, measure="rms"):
    """Return the rms or mean absolute distance of paths from what was measured, rad; infinite where one is lost."""
    misses = np.concatenate([(path - one.after).ravel() for path, one in zip(paths, stretches, strict=True)])
    if not np.isfinite(misses).all():
        return float("inf")
    return float(np.sqrt(np.mean(misses**2)) if measure == "rms" else np.mean(np.abs(misses)))


def peers(kept, name, mjcf, parameters, stretches, frame_skip, *, with_sysid=True):
    """Return values, seconds of least squares, and of ``mujoco.sysid`` with the same list but a delay."""

    def squares():
        values, seconds = open_loop.least_squares(
            mjcf, parameters, stretches, frame_skip, seconds=LEAST_SQUARES_LIMIT
        )
        return {"names": [one.name for one in parameters], "values": values.tolist(), "seconds": seconds}

    def toolbox():
        mine, values, half, seconds = open_loop.sysid(
            mjcf, parameters, stretches, frame_skip, seconds=SYSID_LIMIT
        )
        values = None if values is None else values.tolist()
        names = [one.name for one in mine]
        return {"names": names, "values": values, "half_widths": half, "seconds": seconds}

    found = {"least squares": kept.answer(f"{name}_least_squares", squares)}
    if with_sysid:
        found["mujoco.sysid"] = kept.answer(f"{name}_sysid", toolbox)
    return found


def physical(mjcf):
    """Return what a model says of each joint, and of its servo or motor, by joint and by quantity with its unit."""
    model = mujoco.MjModel.from_xml_string(mjcf)
    found = {}
    for joint in range(model.njnt):
        name = model.joint(joint).name
        mine = {
            "dry friction, N m": float(model.dof_frictionloss[joint]),
            "damping, N m s/rad": float(model.dof_damping[joint]),
            "armature, kg m2": float(model.dof_armature[joint]),
        }
        motor = int(np.flatnonzero(model.actuator_trnid[:, 0] == joint)[0])
        gear, gain, bias = (
            model.actuator_gear[motor, 0],
            model.actuator_gainprm[motor, 0],
            model.actuator_biasprm[motor],
        )
        if bias[1]:
            mine |= {
                "kp, N m/rad": float(gear * gain),
                "kv, N m s/rad": float(-gear * bias[2]),
                "offset, rad": float(bias[0] / gain),
            }
        else:
            mine["gain"] = float(gear * gain)
        found[name] = mine
    return found


def as_told(diagnosis):
    """Return causes as JSON holds them."""
    neutral = {effect.name: effect.neutral for effect in diagnosis.simulator.effects(also="all")}
    return [told(cause, neutral[cause.name]) for cause in diagnosis.causes_]


def told(cause, neutral):
    """Return a cause, or a change, as JSON holds it."""
    return {
        "name": cause.name,
        "value": float(cause.value),
        "interval": [float(end) for end in cause.interval],
        "unit": cause.unit,
        "neutral": float(neutral),
        "probability": float(cause.probability),
        "aliases": [alias.name for alias in cause.aliases],
        "at_bound": bool(cause.at_bound),
    }


def not_named(diagnosis):
    """Return, of each family of which no effect is named, the one that would have been seen smallest."""
    named = {cause.family for cause in diagnosis.causes_}
    asked = list(diagnosis.identifiability_.index)
    known = {effect.name: effect for effect in diagnosis.simulator.effects(also=asked)}
    found = {}
    for name, row in diagnosis.identifiability_.iterrows():
        effect, smallest = known[name], float(row["smallest"])
        least = found.get(effect.family, {"smallest": float("inf")})["smallest"]
        if effect.family not in named and abs(smallest) < least:
            found[effect.family] = {
                "effect": name,
                "smallest": abs(smallest),
                "unit": effect.unit,
                "alias": row["nearest_alias"],
            }
    return list(found.values())


def findings_of(diagnosis):
    """Return the findings as ``skat diagnose --json`` writes them."""
    return plain(findings_as_data(diagnosis))


def asked(diagnosis, cost):
    """Return what a diagnosis says, and what it took."""
    return {
        "verdict": diagnosis.verdict_,
        "causes": as_told(diagnosis),
        "also_seen": dict(diagnosis.also_seen_),
        "rows": int(diagnosis.n_rows_fitted_),
        "rows_offered": int(diagnosis.n_rows_),
        "unexplained": str(diagnosis.remainder_)[:2000],
        "left_out": list(diagnosis.computed_velocities_),
        "not_named": not_named(diagnosis),
        **cost,
    }


# -- the studies -------------------------------------------------------------------------------------------------------


def go2_air(kept):
    """A quadruped hung up by its base, positions only: fitted on two thirds of the rows, tested on the last."""
    log, simulator = datasets.fetch_go2_air(), make_simulator("go2_air")
    n = len(log.data)
    part = partial(_rows, log)
    diagnosis, cost = kept.diagnosis("go2_air_quick", simulator, *part(0, 2 * n // 3), quick=True)
    cut = partial(open_loop.stretches_of, n_joints=12, dt=simulator.dt)
    fitted, tested = cut(*part(0, 2 * n // 3)), cut(*part(2 * n // 3, n))
    mjcf, _ = exported(simulator)
    joints = [name.removeprefix("qpos.") for name in log.feature_names[:12]]
    # The base is fixed: a leg moves no other.
    legs = {joint: tuple(3 * (place // 3) + np.arange(3)) for place, joint in enumerate(joints)}
    parameters = [
        replace(one, reach=legs[one.name.rpartition(" | ")[2]])
        for one in servo_parameters(
            physical(mjcf), joints, [joint.removesuffix("_joint") for joint in joints]
        )
    ]
    others = peers(kept, "go2_air", mjcf, parameters, fitted, 5)
    found = compared(simulator, diagnosis.extended_simulator_, mjcf, parameters, others, tested, 5)
    return {
        **found,
        **asked(diagnosis, cost),
        "rows_tested": n - 2 * n // 3,
        "at_bound": [cause.name for cause in diagnosis.causes_ if cause.at_bound],
        **({"thirds": thirds_of(kept, simulator, part, n)} if kept.parts else {}),
        "shown": {"joints": ["FL_hip_joint", "FL_thigh_joint", "FL_calf_joint"], "seconds": 4.0},
    }


def thirds_of(kept, simulator, part, n):
    """Return what three parts of a log say of each cause, each asked by itself, and whether they agree."""
    findings = {}
    for third in range(3):
        rows = part(third * n // 3, (third + 1) * n // 3)
        one, _ = kept.diagnosis(f"go2_air_part{third + 1}_quick", simulator, *rows, quick=True)
        findings[f"third {third + 1}"] = findings_of(one)
    return json.loads(compare_findings(findings).to_json(orient="records"))


def each_joint_s(simulator, families):
    """Return the effects of families that are of one joint or motor."""
    return [one.name for one in simulator.effects() if one.family in families and one.target != "all"]


UR10_FAMILIES = ("dry_friction", "damping", "armature", "gain")
UR10_MINE, UR10_FEWER = "skat's extended model", "skat's, asked of friction, rotors and gains alone"
UR10_SCALED = "least squares, the model's masses"


def _rows(log, first, last):
    return log.data[first:last], log.target[first:last], log.groups[first:last]


def ur10(kept):
    """An industrial arm whose bag holds what its motors exerted: two thirds are fitted, the last third is tested."""
    log, simulator = datasets.fetch_ur10(), make_simulator("ur10")
    n = len(log.data)
    part = partial(_rows, log)
    joints = [name.removeprefix("qpos.") for name in log.feature_names[:6]]
    fewer = each_joint_s(simulator, UR10_FAMILIES)
    # Motors report with a zero of their own, and what hung on the flange nobody wrote down.
    effects = [*fewer, *(f"bias[ctrl.{joint}]" for joint in joints), "payload[wrist_3_link]"]
    given = part(0, 2 * n // 3)
    ask = partial(kept.diagnosis, X=given[0], y=given[1], groups=given[2], actions="measured")
    diagnosis, cost = ask("ur10_measured", simulator, effects=effects)
    of_fewer, _ = ask("ur10_measured_fewer", simulator, effects=fewer)
    cut = partial(open_loop.stretches_of, n_joints=6, n_rows=31)
    fitted, tested = cut(*given), cut(*part(2 * n // 3, n))
    mjcf, _ = exported(simulator)
    parameters = [
        *(Parameter(f"dry_friction[{j}]", 1.0, 0, 100, 2.0, open_loop.friction(j)) for j in joints),
        *(Parameter(f"damping[{j}]", 1.0, 0, 100, 2.0, open_loop.damping(j)) for j in joints),
        *(Parameter(f"armature[{j}]", 0.1, 0, 20, 0.2, open_loop.armature(j)) for j in joints),
        *(Parameter(f"gain[{j}]", 1.0, 0.05, 20, 0.1, open_loop.gain(j)) for j in joints),
    ]
    others = peers(kept, "ur10", mjcf, parameters, fitted, 4)
    found = compared(simulator, diagnosis.extended_simulator_, mjcf, parameters, others, tested, 4)
    asked_of = {UR10_MINE: diagnosis, UR10_FEWER: of_fewer}
    found["efforts"] = kept.answer("ur10_efforts_measured", partial(_ur10_efforts, log, asked_of, mjcf))
    shares = found["efforts"]["share"]
    return {
        **found,
        **asked(diagnosis, cost),
        "rows_tested": n - 2 * n // 3,
        "numbers": {
            "n_asked": str(len(effects)),
            "n_effects": str(len(simulator.effects())),
            "compared_to": study_pages.shown(
                float(motion_of(simulator, given, "", measured=True).cutoff.max())
            ),
            "wrist_scaled": study_pages.shown(found["efforts"]["masses"][3]),
            "of_least_squares": study_pages.shown(shares[UR10_MINE] / shares[UR10_SCALED]),
            "fewer_of_least_squares": study_pages.shown(shares[UR10_FEWER] / shares[UR10_SCALED]),
        },
        "shown": {"joints": joints[:3], "seconds": 2.0},
    }


def _ur10_efforts(log, diagnoses, mjcf):
    """Return errors of the efforts that models predict of the rows not used: rms by joint, A, and as a share of all."""
    n = len(log.data)
    mine, other = sides = [
        rigid_bodies.smoothed(rows[:, :6], rows[:, 6:12], rows[:, 12:], log.dt)
        for rows in (log.data[: 2 * n // 3], log.data[2 * n // 3 :])
    ]
    nominal = mujoco.MjModel.from_xml_string(mjcf)
    torques = [rigid_bodies.efforts_of(nominal, one) for one in sides]
    told, beside = {"nominal": torques[1]}, {}
    for name, diagnosis in diagnoses.items():
        extended_mjcf, left = exported(diagnosis.extended_simulator_)
        told[name] = rigid_bodies.efforts_of(mujoco.MjModel.from_xml_string(extended_mjcf), other)
        beside |= left

    def squares(columns, **without):
        return rigid_bodies.fitted_efforts(columns[0], mine, columns[1], other, **without)[0]

    scaled = [one[:, :, None] for one in torques]
    told[UR10_SCALED], coefficients = rigid_bodies.fitted_efforts(scaled[0], mine, scaled[1], other)
    for name in rigid_bodies.OWN:
        told[f"... without {name}"] = squares(scaled, without=name)
    # What the model says stands as it is: least squares of what is left.
    left = replace(mine, efforts=mine.efforts - torques[0])
    none = [np.zeros((len(one), 6, 0)) for one in torques]
    told["... with masses as they are"] = (
        torques[1] + rigid_bodies.fitted_efforts(none[0], left, none[1], other)[0]
    )
    told["least squares, all masses"] = squares([rigid_bodies.regressors(nominal, one) for one in sides])
    spread = other.efforts.std(axis=0)
    errors = {name: np.sqrt(np.mean((one - other.efforts) ** 2, axis=0)) for name, one in told.items()}
    return {
        "beside": beside,
        "masses": coefficients[:, 0].tolist(),
        "by_joint": {name: one.tolist() for name, one in errors.items()},
        "share": {name: float(np.sqrt(np.mean((one / spread) ** 2))) for name, one in errors.items()},
    }


WITHOUT_ZERO = "skat's, without the sensor's zero"


def double_pendulum(kept):
    """A two-link arm: two runs fitted, three held out; the log of `measured.py` in rows of 10 ms."""
    import measured
    from dose_response import ZEROS

    simulator = MujocoSimulator(measured.arm_mjcf(), frame_skip=5)
    facts = datasets.fetch_double_pendulum(measured.RUNS[0]).facts
    diagnosis, cost = kept.diagnosis(
        "double_pendulum", simulator, *measured.arm_log(measured.RUNS[: measured.N_FITTED], 5, 1.0)
    )
    fitted, tested = (
        open_loop.stretches_of(*measured.arm_log(runs, 1, seconds), n_joints=2)
        for runs, seconds in (
            (measured.RUNS[: measured.N_FITTED], 0.5),
            (measured.RUNS[measured.N_FITTED :], measured.HELD_OUT),
        )
    )
    mjcf = measured.arm_mjcf()
    joints = ["shoulder", "elbow"]
    parameters = [
        *(Parameter(f"dry_friction[{j}]", 0.1, 0, 2, 0.1, open_loop.friction(j)) for j in joints),
        *(Parameter(f"damping[{j}]", 0.0, 0, 1, 0.01, open_loop.damping(j)) for j in joints),
        *(Parameter(f"armature[{j}]", 0.001, 0, 0.1, 0.003, open_loop.armature(j)) for j in joints),
    ]
    others = peers(kept, "double_pendulum", mjcf, parameters, fitted, 1)
    found = compared(
        simulator, diagnosis.extended_simulator_, mjcf, parameters, others, tested, 1, rows_a_step=5
    )
    # Each run's encoders were zeroed anew (`encoder_zeros.py`): a bias is of the runs fitted.
    bodies = {cause.name: cause.value for cause in diagnosis.causes_ if cause.family != "bias"}
    coarse = [_every(one, 5) for one in tested]
    found["errors"][WITHOUT_ZERO] = distance(open_loop_angles(simulator.extended(bodies), coarse), coarse)
    better = kept.answer("double_pendulum_six_parameters", measured.six_parameters)
    found["errors"]["least squares of the benchmark"] = better[0]
    errors = found["errors"]
    return {
        **found,
        **asked(diagnosis, cost),
        "six_parameters": dict(zip([one.name for one in parameters], better[1])),
        "wanted": {name: list(ends) for name, ends in measured.WANTED.items()},
        "numbers": {
            f"authors_{joint}": study_pages.shown(np.pi / 2 * facts[f"cf{place}"])
            for place, joint in enumerate(joints, 1)
        }
        | {
            **{
                f"zero_{place}": study_pages.shown(-ZEROS[run]["shoulder"])
                for place, run in enumerate(measured.RUNS[: measured.N_FITTED], 1)
            },
            "ratio_without_zero": study_pages.shown(errors[WITHOUT_ZERO] / better[0]),
            "ratio_to_best": study_pages.shown(errors["extended"] / better[0]),
        },
        "rows_tested": sum(len(one.after) for one in tested),
        "shown": {"joints": joints, "seconds": 4.0},
    }


# Of the masses at the end of the rod: rod and .5 kg are .676 kg together.
TRUE_RATIO = (0.676 + 0.5) / 0.676


def pendulum(kept):
    """A pendulum with a load, and with another: what changed, asked of the model as it was and of the extended one."""
    simulator = make_simulator("pendulum")
    # Few pieces: where a swing-up is cut, speeds are known by coarse readings alone.
    logs = {}
    for load in (0.5, 1.0):
        log = datasets.fetch_pendulum(load=load, seconds=4.0)
        logs[load] = log.data, log.target, log.groups
    hidden = {"hidden": ["qvel.hinge"]}
    diagnosis, cost = kept.diagnosis("pendulum", simulator, *logs[0.5], **hidden)
    heavier, heavier_cost = kept.diagnosis("pendulum_1kg", simulator, *logs[1.0], **hidden)
    again, again_cost = kept.diagnosis("pendulum_again", diagnosis.extended_simulator_, *logs[1.0], **hidden)
    changes = {}
    for name, model in (("as given", simulator), ("extended", diagnosis.extended_simulator_)):
        for first, second in ((0.5, 1.0), (1.0, 0.5)):
            changes[f"{name}, {first:g} to {second:g} kg"] = kept.answer(
                f"pendulum_change_{name}_{first:g}",
                partial(_changed, model, logs[first], logs[second], hidden),
            )
    cut = partial(open_loop.stretches_of, n_joints=1)
    fitted, tested = cut(*logs[0.5]), cut(*logs[1.0])
    mjcf, _ = exported(simulator)
    parameters = _mass_and_friction(mjcf)
    others = {
        load: peers(kept, f"pendulum_{load:g}", mjcf, parameters, stretches, 5)
        for load, stretches in ((0.5, fitted), (1.0, tested))
    }
    both = kept.answer("pendulum_both", partial(_both_loads, mjcf, fitted, tested))
    # The second log's load is known, and is put into every model.
    spec = mujoco.MjSpec.from_string(mjcf)
    open_loop.body_mass(mjcf, "weight")(spec, TRUE_RATIO)
    heavy_mjcf = spec.to_xml()
    heavy = MujocoSimulator(heavy_mjcf, frame_skip=5)
    extended = heavy.extended({cause.name: cause.value for cause in diagnosis.causes_})
    loaded = heavy_mjcf, _mass_and_friction(heavy_mjcf)
    found = compared(
        heavy,
        extended,
        heavy_mjcf,
        parameters,
        others[0.5],
        tested,
        5,
        models=dict.fromkeys(others[0.5], loaded),
    )
    return {
        **found,
        **asked(diagnosis, cost),
        "heavier": asked(heavier, heavier_cost),
        "again": asked(again, again_cost),
        "changes": changes,
        "least_squares_of_each": {f"{load:g} kg": one for load, one in others.items()},
        "both": both,
        "numbers": {
            "true_ratio": study_pages.shown(TRUE_RATIO),
            "true_ratio_back": study_pages.shown(1 / TRUE_RATIO),
            "both_ratio": study_pages.shown(both["ratio"]),
            "ls_mass": study_pages.shown(others[0.5]["least squares"]["values"][0]),
            "ls_friction": study_pages.shown(others[0.5]["least squares"]["values"][1]),
            "ls_friction_heavier": study_pages.shown(others[1.0]["least squares"]["values"][1]),
            "each_ratio": study_pages.shown(
                others[1.0]["least squares"]["values"][0] / others[0.5]["least squares"]["values"][0]
            ),
            "least_friction": study_pages.shown(
                diagnosis.identifiability_.loc["dry_friction[hinge]", "smallest"]
            ),
            "again_verdict": f"“{again.verdict_}”",
            "again_seconds": f"{again_cost['seconds']:,.0f}",
            "heavier_verdict": f"“{heavier.verdict_}”",
        },
        "rows_tested": sum(len(one.after) for one in tested),
        "shown": {"joints": ["hinge"], "seconds": 4.0},
    }


def _changed(simulator, before, after, parameters):
    """Return what a diagnosis says has changed."""
    start = time.perf_counter()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = SimulationDiagnosis(simulator, random_state=0, **parameters).fit_change(before, after)
    neutral = {effect.name: effect.neutral for effect in simulator.effects(also="all")}
    return {
        "verdict": found.verdict_,
        "causes": [told(change, neutral[change.name]) for change in found.changes_],
        "detectable": {name: float(one) for name, one in found.detectable_.items() if np.isfinite(one)},
        "seconds": time.perf_counter() - start,
        "warnings": sorted({str(one.message) for one in said}),
    }


def _mass_and_friction(mjcf):
    return [
        Parameter("mass", 1.0, 0.1, 5, 0.2, open_loop.body_mass(mjcf, "weight")),
        Parameter("dry_friction[hinge]", 0.05, 0, 2, 0.05, open_loop.friction("hinge")),
        Parameter("damping[hinge]", 0.01, 0, 1, 0.02, open_loop.damping("hinge")),
        Parameter("delay", 0.005, 0, 0.05, 0.003, None),
    ]


def _both_loads(mjcf, light, heavy):
    """Return least squares of both logs at once: friction, damping and delay of both, a mass of each; its ratio."""
    start = time.perf_counter()
    mass, *shared = _mass_and_friction(mjcf)

    def residuals(values):
        found = []
        for load, stretches in ((values[0], light), (values[1], heavy)):
            model, delay = open_loop.compiled(mjcf, [mass, *shared], [load, *values[2:]])
            found.append(open_loop.misses([model], [delay], stretches, 5)[0])
        return np.concatenate(found)

    from scipy import optimize

    low, high = np.array([(one.low, one.high) for one in (mass, mass, *shared)]).T
    found = optimize.least_squares(
        residuals, [1.0, 1.7, 0.05, 0.01, 0.005], bounds=(low, high), x_scale=[0.2, 0.2, 0.05, 0.02, 0.003],
        diff_step=1e-3, max_nfev=40,
    )  # fmt: skip
    names = ["mass, .5 kg", "mass, 1 kg", *(one.name for one in shared)]
    return {
        "values": dict(zip(names, found.x.tolist())),
        "ratio": float(found.x[1] / found.x[0]),
        "rms": open_loop.rms(found.fun),
        "seconds": time.perf_counter() - start,
    }


# Of each motion that is fitted, from which row on.
FITTED_MOTIONS = {
    "backlash_detection": 1000,
    "chirp_sweep": 4000,
    "friction_gravity": 1000,
    "hold_under_gravity": 620,
    "multisine": 1000,
}
TESTED_MOTIONS = ("pick_place", "prbs_excitation", "single_joint_elbow", "step_response", "velocity_ramp")
BAM = "BAM's M1, gain and delay"
SO101_ROWS = 300
# Asked about all effects of the model, its first fit had not ended after eight minutes.
SO101_FAMILIES = ("dry_friction", "armature", "kp", "kv", "offset")


def so101(kept):
    """A hobbyists' servo arm: five motions fitted, in part, and five tested whole."""
    simulator = make_simulator("so101")
    fitted_log = [_stretch_of_motion(*one) for one in FITTED_MOTIONS.items()]
    X, y = (np.concatenate([one[side] for one in fitted_log]) for side in (0, 1))
    groups = np.repeat(np.arange(len(fitted_log)), [len(one[0]) for one in fitted_log])
    effects = [*each_joint_s(simulator, SO101_FAMILIES), "delay[action]"]
    # They lag the positions, as a fit that is given them warns.
    speeds = [name for name in simulator.state_names if name.startswith("qvel.")]
    diagnosis, cost = kept.diagnosis(
        "so101_positions", simulator, X, y, groups, effects=effects, hidden=speeds
    )
    fitted = open_loop.stretches_of(X, y, groups, 6)
    tested = []
    for motion in TESTED_MOTIONS:
        log = datasets.fetch_so101(motion)
        tested += open_loop.stretches_of(log.data, log.target, log.groups, 6)
    mjcf, _ = exported(simulator)
    joints = [name.removeprefix("qpos.") for name in simulator.input_names[:6]]
    delay = Parameter("delay", 0.02, 0, 0.3, 0.01, None)
    # The servo's damping and the joint's act alike; the servo's is what is fitted, so far that none is left in all.
    parameters = [
        one
        for one in servo_parameters(physical(mjcf), joints, joints, stiffest=3000, kp=20.0)
        if not one.name.startswith("damping")
    ]
    parameters += [
        Parameter(f"kv, N m s/rad | {joint}", 2.7, -0.6, 50.0, 0.5, open_loop.kv(joint)) for joint in joints
    ]
    parameters.append(delay)
    others = peers(kept, "so101", mjcf, parameters, fitted, 10)
    bam = json.loads(
        (Path(os.environ["SKAT_DATA_HOME"]) / "bam" / "feetech_sts3215_7_4V_m1.json").read_text()
    )
    bam_mjcf = with_bam(mjcf, bam)
    bam_parameters = [
        *(Parameter(f"kp[{j}]", 20.0, 0.5, 3000, 5.0, open_loop.kp(j)) for j in joints),
        delay,
    ]
    others |= {
        BAM: peers(kept, "so101_bam", bam_mjcf, bam_parameters, fitted, 10, with_sysid=False)["least squares"]
    }
    found = compared(
        simulator, diagnosis.extended_simulator_, mjcf, parameters, others, tested, 10, measure="mean",
        models={BAM: (bam_mjcf, bam_parameters)},
    )  # fmt: skip
    stiffness = {
        who: [one["kp, N m/rad"] for one in found["joints"][who].values()] for who in found["joints"]
    }
    nominal, force = max(stiffness["nominal"]), max(simulator.servo_limits.values())
    softer = sorted(nominal / one for one in stiffness["least squares"])
    return {
        **found,
        **asked(diagnosis, cost),
        "rows_tested": sum(len(one.after) for one in tested),
        "numbers": {
            "n_asked": str(len(effects)),
            "n_effects": str(len(simulator.effects())),
            "bam": study_pages.shown(1e3 * found["errors"][BAM]),
            "kp": study_pages.shown(nominal),
            "force": study_pages.shown(force),
            "full_force_error": study_pages.shown(1e3 * force / nominal),
            "least_softer": study_pages.shown(softer[0], 2),
            "most_softer": study_pages.shown(softer[-1], 2),
        },
        "shown": {"joints": joints[1:4], "seconds": 10.0},
    }


def _stretch_of_motion(motion, first):
    log = datasets.fetch_so101(motion)
    rows = slice(first, first + SO101_ROWS)
    return log.data[rows], log.target[rows]


def with_bam(mjcf, bam):
    """Return the arm with BAM's M1 in each servo: friction, rotor, and a motor whose back-EMF damps.

    The servo's own loop gives its voltage by the error alone, so that it has no damping of its own.
    """
    spec = mujoco.MjSpec.from_string(mjcf)
    for joint in spec.joints:
        joint.frictionloss, joint.armature = bam["friction_base"], bam["armature"]
        joint.damping[0] = bam["friction_viscous"] + bam["kt"] ** 2 / bam["R"]
    for servo in spec.actuators:
        servo.biasprm[2] = 0.0
    return spec.to_xml()


def servo_parameters(nominal, joints, servos, *, stiffest=100.0, kp=None):
    """Return friction, damping, armature, kp and offset of each joint, from where the model, or ``kp``, has them."""
    found = []
    for what, write, top, scale in (
        ("dry friction, N m", open_loop.friction, 5.0, 0.1),
        ("damping, N m s/rad", open_loop.damping, 20.0, 0.2),
        ("armature, kg m2", open_loop.armature, 0.5, 0.01),
    ):
        found += [Parameter(f"{what} | {j}", nominal[j][what], 0.0, top, scale, write(j)) for j in joints]
    for joint, servo in zip(joints, servos, strict=True):
        start = kp or nominal[joint]["kp, N m/rad"]
        found.append(
            Parameter(f"kp, N m/rad | {joint}", start, 0.5, stiffest, 0.2 * start, open_loop.kp(servo))
        )
    for joint, servo in zip(joints, servos, strict=True):
        found.append(Parameter(f"offset, rad | {joint}", 0.0, -0.3, 0.3, 0.02, open_loop.offset(servo)))
    return found


def compared(
    simulator,
    extended,
    mjcf,
    parameters,
    others,
    tested,
    frame_skip,
    *,
    measure="rms",
    models=None,
    rows_a_step=1,
):
    """Return errors in open loop, what each model says of its joints, and a stretch of paths to be drawn.

    ``rows_a_step`` rows of the stretches tested are one transition of the simulator.
    """
    extended_mjcf, beside = exported(extended)
    coarse = [_every(one, rows_a_step) for one in tested]
    angles = {
        "nominal": fitted_angles(mjcf, [], [], tested, frame_skip),
        "extended": open_loop_angles(extended, coarse),
    }
    said = {"nominal": physical(mjcf), "extended": physical(extended_mjcf)}
    for name, one in others.items():
        if one["values"] is None:
            continue
        text, given = (models or {}).get(name, (mjcf, parameters))
        mine = [next(other for other in given if other.name == wanted) for wanted in one["names"]]
        angles[name] = fitted_angles(text, mine, one["values"], tested, frame_skip)
        spec = mujoco.MjSpec.from_string(text)
        for parameter, value in zip(mine, one["values"], strict=True):
            if parameter.write is not None:
                parameter.write(spec, value)
        said[name] = physical(spec.to_xml())
    errors = {
        name: distance(one, coarse if name == "extended" else tested, measure) for name, one in angles.items()
    }
    joints = [name.removeprefix("qpos.") for name in simulator.input_names[: len(tested[0].qpos)]]
    by_joint = {
        name: {
            joint: distance(
                [path[:, [place]] for path in one], _only(coarse if name == "extended" else tested, place)
            )
            for place, joint in enumerate(joints)
        }
        for name, one in angles.items()
    }
    return {
        "errors": errors,
        "errors_by_joint": by_joint,
        "measure": measure,
        "joints": said,
        "beside": beside,
        "peers": others,
        "paths": _drawn(tested[0], angles, joints, simulator.dt, rows_a_step),
    }


def _drawn(stretch, angles, joints, dt, rows_a_step, seconds=4.0):
    """Return the first seconds of a stretch, measured and in open loop."""
    step = dt / rows_a_step
    models = {}
    for name, paths in angles.items():
        each = dt if name == "extended" else step
        shown = paths[0][: round(seconds / each)]
        models[name] = (each * np.arange(1, len(shown) + 1), shown)
    measured = stretch.after[: round(seconds / step)]
    time = step * np.arange(1, len(measured) + 1)
    return {"joints": joints, "time": time, "measured": measured, "models": models}


def _only(stretches, joint):
    """Return stretches in which one joint's angles alone are compared."""
    return [replace(one, after=one.after[:, [joint]]) for one in stretches]


def _every(stretch, rows):
    """Return a stretch in coarser rows: commands on average, angles at each row's end."""
    if rows == 1:
        return stretch
    commands = stretch.commands.reshape(-1, rows, stretch.commands.shape[1]).mean(axis=1)
    return open_loop.Stretch(stretch.qpos, stretch.qvel, commands, stretch.after[rows - 1 :: rows])


STUDIES = {
    "so101": so101,
    "go2_air": go2_air,
    "double_pendulum": double_pendulum,
    "pendulum": pendulum,
    "ur10": ur10,
}


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("studies", nargs="*", default=list(STUDIES), help=", ".join(STUDIES))
    parser.add_argument(
        "--work", type=Path, default=Path(tempfile.gettempdir()) / "skat-studies", help="what is kept"
    )
    parser.add_argument("--no-parts", action="store_true", help="leave out the three parts of the Go2's log")
    parser.add_argument("--output", type=Path, default=study_pages.PAGES, help="folder of the pages")
    options = parser.parse_args(arguments)
    for name in options.studies:
        if name not in STUDIES:
            parser.error(f"there is no study {name!r}; there are {', '.join(STUDIES)}")
        found = STUDIES[name](Kept(options.work, not options.no_parts))
        study_pages.write(name, {"study": name, **found}, options.output)
        print(
            name,
            found["verdict"],
            {who: round(error, 5) for who, error in found["errors"].items()},
            flush=True,
        )
    study_pages.write_summary(options.output)


if __name__ == "__main__":
    main()
