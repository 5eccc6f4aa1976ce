"""A two-link arm whose base shakes sideways, so that both joints are pushed at once. Plain MuJoCo."""

import mujoco
import numpy as np

STEPS, TIMESTEP = 5, 0.002
SHAKE = 1.5  # m/s^2, deviation of the base's acceleration, anew in each row
HEAVY = 1e4  # kg, of the base: the arm does not move it
NOISE = 2e-4, 4e-3  # rad, rad/s
TORQUES = (1.5, 0.6)  # N m, of each of three waves
CAUSES = {
    "dry_friction[shoulder]": 0.15,
    "dry_friction[elbow]": 0.06,
    "armature[elbow]": 0.004,
    "mass[lower]": 1.15,
    "damping[shoulder]": 0.1,
}
DAMPING, MASSES = (0.05, 0.05), (1.2, 0.8)  # N m s/rad, kg: of the model


def nominal(base="", truth=None):
    """Return the model of a user: a base at rest; or the same with something that moves the base."""
    truth = truth or {}

    def joint(name, damping):
        damping += truth.get(f"damping[{name}]", 0.0)
        friction, armature = (truth.get(f"{family}[{name}]", 0.0) for family in ("dry_friction", "armature"))
        resistance = f'damping="{damping}" frictionloss="{friction}" armature="{armature}"'
        return f'<joint name="{name}" axis="0 1 0" {resistance}/>'

    return (
        f'<mujoco><option timestep="{TIMESTEP}" integrator="implicitfast"/><worldbody><body name="base">{base}'
        f'<body name="upper">{joint("shoulder", DAMPING[0])}'
        f'<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="{MASSES[0]}"/>'
        f'<body name="lower" pos="0 0 -.3">{joint("elbow", DAMPING[1])}<geom type="capsule" '
        f'fromto="0 0 0 0 0 -.25" size=".025" mass="{MASSES[1] * truth.get("mass[lower]", 1.0)}"/></body></body>'
        '</body></worldbody><actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/>'
        "</actuator></mujoco>"
    )


def log_of(truth, *, seed, episodes=6, rows=100, measured=True):
    """Return X, y and groups of the arm driven by waves, the base seen by no sensor.

    Parameters
    ----------
    truth : mapping from name to value
        Some of `CAUSES`; a factor of mass, N m, N m s/rad more than in the model, kg m2.
    measured : bool, default=True
        Whether speeds are.
    """
    rng = np.random.default_rng([seed, 733])
    moving = f'<joint name="cart" type="slide" axis="1 0 0" armature="{HEAVY}"/><geom size=".05" mass="1"/>'
    model = mujoco.MjModel.from_xml_string(nominal(moving, truth))
    data = mujoco.MjData(model)
    X, y = [], []
    for _ in range(episodes):
        mujoco.mj_resetData(model, data)
        data.qpos[1:], data.qvel[1:] = rng.uniform(-1, 1, size=2), rng.normal(0, 0.5, size=2)
        frequencies, phases = rng.uniform(0.3, 1.5, size=(2, 3)), rng.uniform(0, 2 * np.pi, size=(2, 3))
        states, torques = np.empty((rows + 1, 4)), np.empty((rows, 2))
        for row in range(rows + 1):
            states[row] = np.r_[data.qpos[1:], data.qvel[1:]]
            if row == rows:
                break
            waves = np.sin(2 * np.pi * frequencies * row * STEPS * TIMESTEP + phases)
            torques[row] = np.array(TORQUES) * waves.sum(axis=1)
            data.ctrl[:] = torques[row]
            data.qfrc_applied[0] = HEAVY * SHAKE * rng.normal()
            mujoco.mj_step(model, data, STEPS)
        states += np.repeat(NOISE, 2) * rng.normal(size=states.shape)
        if not measured:
            states[:, 2:] = np.nan
        X.append(np.column_stack([states[:-1], torques]))
        y.append(states[1:])
    return np.concatenate(X), np.concatenate(y), np.repeat(np.arange(episodes), rows)
