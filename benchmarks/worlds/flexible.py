"""A pendulum on a rod that bends, swung up by a motor with ripple; its encoder sits at the motor. Plain MuJoCo."""

import mujoco
import numpy as np

MASS, LENGTH, ROTOR = 0.7, 0.5, 0.02  # kg, m, kg m2
TORQUE, RIPPLE, PERIODS = 1.0, 0.05, 42  # N m, N m, of the ripple in a turn
STIFFNESS, BENDING_LOSS = (
    200.0,
    0.4,
)  # N m/rad, N m s/rad: 17 Hz beside a free motor, a tenth of critical damping
STEPS, TIMESTEP, FINER = 5, 0.001, 10  # of the model; reality has so many steps for one of them
STEP_OF_ENCODER = 2 * np.pi / 4096  # rad
CAUSES = {"dry_friction[hinge]": 0.2, "damping[hinge]": 0.05, "gain[motor]": 0.8, "mass[weight]": 1.2}


def nominal(rod=""):
    """Return the model of a user: a rigid rod; or the same with something between the motor and the rod."""
    inner = (
        f'<geom type="capsule" fromto="0 0 0 0 0 -{LENGTH}" size=".01" mass="1e-6"/>'
        f'<body name="weight" pos="0 0 -{LENGTH}"><geom type="sphere" size=".03" mass="{MASS}"/></body>'
    )
    inner = f'<body name="rod">{rod}{inner}</body>' if rod else inner
    return (
        f'<mujoco><option timestep="{TIMESTEP}" integrator="implicitfast"/><worldbody><body name="hub">'
        f'<joint name="hinge" type="hinge" axis="0 1 0" armature="{ROTOR}"/>'
        f'<geom type="sphere" size=".01" mass="1e-6"/>{inner}</body></worldbody>'
        '<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>'
    )


def torques(rng, rows):
    """Return torques that someone turns by hand about every half swing, N m."""
    lengths = np.round(rng.uniform(0.55, 0.9, size=rows) / (STEPS * TIMESTEP)).astype(int)
    sizes = TORQUE * rng.choice([0.8, 1.0, 1.2], size=rows) * (-1) ** np.arange(rows)
    return np.repeat(sizes, lengths)[:rows]


def log_of(truth, *, seed, rows=1200):
    """Return X, y and groups of a swing-up: positions alone, what the motor was asked for, one episode.

    Parameters
    ----------
    truth : mapping from name to value
        Some of `CAUSES`; factors of gain and mass, N m and N m s/rad.
    """
    rng = np.random.default_rng([seed, 411])
    bend = f'<joint name="bend" type="hinge" axis="0 1 0" stiffness="{STIFFNESS}" damping="{BENDING_LOSS}"/>'
    model = mujoco.MjModel.from_xml_string(nominal(bend))
    body = model.body("weight").id
    model.body_mass[body] *= truth.get("mass[weight]", 1.0)
    model.body_inertia[body] *= truth.get("mass[weight]", 1.0)
    model.opt.timestep = TIMESTEP / FINER
    data = mujoco.MjData(model)
    data.qpos[0] = rng.uniform(-0.2, 0.2)
    phase = rng.uniform(0, 2 * np.pi)
    asked = torques(rng, rows)
    angles = np.empty(rows + 1)
    angles[0] = data.qpos[0]
    for row in range(rows):
        for _ in range(STEPS * FINER):
            speed = data.qvel[0]
            lost = truth.get("damping[hinge]", 0.0) * speed
            lost += truth.get("dry_friction[hinge]", 0.0) * np.tanh(speed / 1e-3)
            ripple = RIPPLE * np.sin(PERIODS * data.qpos[0] + phase)
            data.qfrc_applied[0] = truth.get("gain[motor]", 1.0) * asked[row] - lost + ripple
            mujoco.mj_step(model, data)
        angles[row + 1] = data.qpos[0]
    noisy = angles + STEP_OF_ENCODER / 2 * rng.normal(size=rows + 1)
    read = STEP_OF_ENCODER * np.round(noisy / STEP_OF_ENCODER)
    unread = np.full(rows, np.nan)
    X = np.column_stack([read[:-1], unread, asked])
    return X, np.column_stack([read[1:], unread]), np.zeros(rows, dtype=int)
