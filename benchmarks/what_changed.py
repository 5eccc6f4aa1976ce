"""What changed, on simulated arms whose models are wrong in eight to fifteen ways at once.

A six-joint arm, without rotors and with them, and one of two links, with masses 5 to 30 % off, and friction, damping
and rotor inertias that the model lacks. Log before and log after move otherwise. One thing is changed, a mass, a
friction, a damping, a gain or a delay, or nothing. Sensors err by a thousandth of the spread of what they read, three
milliradians of a joint; some logs by a hundredth, two degrees::

    python benchmarks/what_changed.py --cut
    python benchmarks/what_changed.py --cases two_link     # see tables.py for the rest
"""

import numpy as np
import tables
from tables import Case, Table
from worlds.hidden import nominal_model
from worlds.robots import make_log

N_CHANGED = 50
FINE, COARSE = 0.001, 0.01
N_COARSE = 10
# Of each joint the friction, N m. MuJoCo's friction of a light joint is soft: it slides at any torque, as if it were
# damped, and more friction changes nothing. The geared arm has rotors, as real ones do, which its model lacks.
FRICTION = {
    "two_link": (0.05, 0.02),
    **dict.fromkeys(("torque_arm", "geared_arm"), (6.0, 6.0, 5.0, 1.5, 1.4, 1.2)),
}
ROTOR = 0.1  # kg m2
KINDS = ("mass", "dry_friction", "gain", "damping", "delay")


def log_of(robot, truth, **how):
    """Return a log in which it moves; a geared arm is one of torque motors."""
    return make_log("torque_arm" if robot == "geared_arm" else robot, truth, **how)


def names_of(robot):
    """Return names of joints, bodies and actuators."""
    import mujoco

    model = nominal_model(log_of(robot, {}, seed=0, rows=8, episodes=1).mjcf)
    of = mujoco.mj_id2name
    joints = [of(model, mujoco.mjtObj.mjOBJ_JOINT, one) for one in range(model.njnt)]
    bodies = [of(model, mujoco.mjtObj.mjOBJ_BODY, int(body)) for body in model.jnt_bodyid]
    motors = [of(model, mujoco.mjtObj.mjOBJ_ACTUATOR, one) for one in range(model.nu)]
    return joints, bodies, motors


def wrong(robot, rng):
    """Return what the model has wrong in both logs."""
    joints, bodies, _ = names_of(robot)
    truth = {}
    for joint, size in zip(joints, FRICTION[robot]):
        truth[f"dry_friction[{joint}]"] = size * rng.uniform(0.6, 1.5)
        truth[f"damping[{joint}]"] = size * rng.uniform(0.3, 1.0)
    for body in bodies:
        truth[f"mass[{body}]"] = 1 + rng.choice([-1, 1]) * rng.uniform(0.05, 0.3)
    if len(joints) == 2:
        truth |= {f"armature[{joint}]": rng.uniform(0.001, 0.004) for joint in joints}
    rotors = {f"armature[{joint}]": ROTOR for joint in joints} if robot == "geared_arm" else {}
    some = rng.permutation(len(truth))[: max(8, min(15, len(truth)) - len(rotors))]
    return {name: value for place, (name, value) in enumerate(truth.items()) if place in some} | rotors


def change(robot, kind, truth, rng):
    """Return the truth after a change, and the change as it is told."""
    joints, bodies, motors = names_of(robot)
    place = int(rng.integers(len(joints)))
    if kind == "delay":
        late = 0.01 * float(rng.integers(1, 3))
        return {**truth, "delay[action]": late}, {"delay[action]": late}
    if kind in ("dry_friction", "damping"):
        name, size = f"{kind}[{joints[place]}]", FRICTION[robot][place] * rng.uniform(0.5, 1.5)
        return {**truth, name: truth.get(name, 0.0) + size}, {name: size}
    name = f"gain[{motors[place]}]" if kind == "gain" else f"mass[{bodies[-1 - place % 2]}]"
    factor = float(rng.choice([0.75, 0.85, 1.2, 1.4])) if kind == "gain" else rng.uniform(1.3, 2.0)
    return {**truth, name: truth.get(name, 1.0) * factor}, {name: float(factor)}


def cases(cut):
    found = []
    for noise, count in ((FINE, 3 if cut else N_CHANGED), (COARSE, 1 if cut else N_COARSE)):
        for index in range(count):
            for robot in FRICTION:
                kind, settings = KINDS[index % len(KINDS)], {"noise": noise}
                found.append(Case(f"changed | {robot} | {noise} | {kind}", 4000 + index, settings))
                found.append(Case(f"same | {robot} | {noise}", 5000 + index, settings))
    return found


def run(case, parameters):
    what, robot, _, *kind = case.name.split(" | ")
    rng = np.random.default_rng([case.seed, len(robot)])
    before = wrong(robot, rng)
    after, truth = change(robot, kind[0], before, rng) if kind else (before, {})
    logs = [
        log_of(robot, one, seed=[case.seed, number], rows=1500, episodes=1, noise=case.settings["noise"])
        for number, one in enumerate((before, after))
    ]
    simulator = tables.simulator_of(logs[0])
    answer = tables.ask_change(
        simulator, *((log.X, log.y, log.groups) for log in logs), seed=case.seed, parameters=parameters
    )
    return {
        "what": what,
        "robot": robot,
        "kind": (kind or [""])[0],
        "noise": case.settings["noise"],
        "truth": truth,
        "n_wrong": len(before),
        **answer,
    }


def report(lines, shown):
    for noise in (FINE, COARSE):
        for robot in (None, *FRICTION):
            mine = [line for line in lines if robot in (None, line["robot"]) and line["noise"] == noise]
            changed = [line for line in mine if line["what"] == "changed"]
            label = f"noise {noise}: " if robot is None else f"... {robot}: "
            fine = robot is None and noise == FINE
            shown.share(f"{label}named alone", map(tables.alone, changed), "92 %" if fine else "")
            shown.share(f"{label}alone, or an alias of the only one", map(tables.or_alias, changed))
            same = [line for line in mine if line["what"] == "same"]
            shown.share(
                f"{label}nothing changed: named",
                [line["verdict"] != "nothing changed" for line in same],
                "<= 2 %" if fine else "",
            )
    changed = [line for line in lines if line["what"] == "changed" and line["noise"] == FINE]
    for kind in KINDS:
        shown.share(
            f"{kind}: alone or alias", [tables.or_alias(line) for line in changed if line["kind"] == kind]
        )
    errors = [
        abs(cause["value"] / line["truth"][cause["name"]] - 1)
        for line in changed
        for cause in line["causes"]
        if cause["name"] in line["truth"]
    ]
    shown.number("error of its size, as a share", errors, "median .07")
    shown.share("intervals that cover", [one for line in changed for one in tables.in_interval(line)], "90 %")


TABLE = Table("what_changed", cases, run, report, of_changes=True)

if __name__ == "__main__":
    tables.main(TABLE, __doc__)
