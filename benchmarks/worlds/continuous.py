"""A SCARA arm in continuous time (Runge and Kutta, .5 ms), whose model takes steps of 2 ms. Plain MuJoCo.

Good encoders alone tell of it, so that what the model's steps are off is the largest error of all.
"""

import mujoco
import numpy as np

STEPS, TIMESTEP, FINE = 5, 0.002, 0.0005
TICKS, RESOLUTION = 65536, 1e-5  # of an encoder, a turn; of the quill, m
COMMANDS = (6.0, 2.5, 4.0)  # N m, N m, N
HOLD = (3.0, 2.0, 60.0)  # N m/rad, N m/rad, N/m, by which a controller keeps the arm near its place
PLACE = (0.0, 0.0, -0.08)
WEIGHT = 4.9  # N, of the quill
CAUSES = {"dry_friction[elbow]": 0.25, "mass[upper]": 1.15, "damping[quill]": 1.5}


def nominal(truth=None):
    """Return the model of a user, or the same with something else in it."""
    truth = truth or {}

    def joint(name, damping, armature, more):
        damping += truth.get(f"damping[{name}]", 0.0)
        friction = truth.get(f"dry_friction[{name}]", 0.0)
        return (
            f'<joint name="{name}" axis="0 0 1" damping="{damping}" armature="{armature}" '
            f'frictionloss="{friction}" {more}/>'
        )

    upper, slide = 2.0 * truth.get("mass[upper]", 1.0), 'type="slide"'
    return (
        f'<mujoco><option timestep="{TIMESTEP}" integrator="implicitfast"/>'
        '<default><geom contype="0" conaffinity="0"/></default><worldbody>'
        f'<body name="upper" pos="0 0 .5">{joint("shoulder", 0.3, 0.05, "")}'
        f'<geom type="capsule" fromto="0 0 0 .3 0 0" size=".04" mass="{upper}"/>'
        f'<body name="fore" pos=".3 0 0">{joint("elbow", 0.2, 0.03, "")}'
        '<geom type="capsule" fromto="0 0 0 .25 0 0" size=".03" mass="1.2"/>'
        f'<body name="quill" pos=".25 0 0">{joint("quill", 4.0, 0.2, slide)}'
        '<geom type="cylinder" size=".015 .15" mass=".5"/></body></body></body></worldbody><actuator>'
        '<motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/>'
        '<motor name="quill" joint="quill"/></actuator></mujoco>'
    )


def log_of(truth, *, seed, rows=300):
    """Return X, y and groups of one episode, positions alone.

    Parameters
    ----------
    truth : mapping from name to value
        Some of `CAUSES`; N m, a factor, N s/m more than in the model.
    """
    rng = np.random.default_rng([seed, 911])
    model = mujoco.MjModel.from_xml_string(nominal(truth))
    model.opt.timestep, model.opt.integrator = FINE, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos[:] = PLACE + np.array([0.0, 0.5, 0.0])
    frequencies, phases = rng.uniform(0.1, 1.5, size=(6, 3)), rng.uniform(0, 2 * np.pi, size=(6, 3))
    weights = rng.normal(size=(6, 3)) / np.sqrt(3)
    positions, commands = np.empty((rows + 1, 3)), np.empty((rows, 3))
    for row in range(rows + 1):
        positions[row] = data.qpos
        if row == rows:
            break
        waves = np.sum(weights * np.sin(2 * np.pi * frequencies * row * STEPS * TIMESTEP + phases), axis=0)
        commands[row] = np.array(COMMANDS) * waves - np.array(HOLD) * (data.qpos - PLACE) + [0, 0, WEIGHT]
        data.ctrl[:] = commands[row]
        mujoco.mj_step(model, data, round(STEPS * TIMESTEP / FINE))
    steps = np.array([2 * np.pi / TICKS, 2 * np.pi / TICKS, RESOLUTION])
    read = np.column_stack([steps * np.round(positions / steps), np.full_like(positions, np.nan)])
    return np.column_stack([read[:-1], commands]), read[1:], np.zeros(rows, dtype=int)
