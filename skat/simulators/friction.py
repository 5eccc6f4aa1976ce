r"""The friction of a geared servo: a budget that grows with what its gears carry and falls with speed.

The joint stands still as long as the torque on it stays within the budget; moving, it is braked by all of it, and by
the viscous damping, which is the joint's own. Laws M1 to M6 of [1]_ are this budget with some of its coefficients zero:

.. math:: b = b_0 + c |q| + s\, b_s + |k_e \tau_e - k_m \tau_m| + s |k_{es} \tau_e - k_{ms} \tau_m|
              + s\, (k_{mq} \tau_m^2 \text{ or } k_{eq} \tau_e^2), \qquad s = e^{-|v / v_s|^\alpha},

with the motor's torque tau_m and that of all else on the joint, tau_e; the squares count where the two oppose each
other, that of the larger one.

References
----------
.. [1] Duclusaud, Passault, Padois, Ly (2025). Extended Friction Models for the Physics Simulation of Servo Actuators.
"""

import mujoco
import numpy as np
from scipy.special import erf

from skat.simulators.tables import Array

# Family of effect -> its value when nothing else is said, in the order of the last axis of `budget`'s coefficients.
NEUTRAL = {
    "position_friction": 0.0,
    "stribeck": 0.0,
    "stribeck_speed": 2.0,
    "stribeck_exponent": 2.0,
    "load_friction": 0.0,
    "load_stribeck": 0.0,
    "load_friction_motor": 0.0,
    "load_friction_external": 0.0,
    "load_stribeck_motor": 0.0,
    "load_stribeck_external": 0.0,
    "load_square_motor": 0.0,
    "load_square_external": 0.0,
}
PLACE = {family: place for place, family in enumerate(NEUTRAL)}
LOADED = tuple(place for family, place in PLACE.items() if family.startswith("load_"))


def budget(coefficients: Array, position: Array, velocity: Array, motor: Array, external: Array) -> Array:
    """Return the friction that the law adds to a joint's own, N or N m.

    Parameters
    ----------
    coefficients : ndarray of shape (..., 12)
        In the order of `NEUTRAL`. ``load_friction`` and ``load_stribeck`` are coefficients of both torques.
    position, velocity, motor, external : ndarray of shape (...)
        Of the joint: rad or m, per s; the motor's torque on it, and that of all else (gravity, inertia, springs).

    Returns
    -------
    ndarray of shape (...)
    """
    (
        by_position, stribeck, speed, exponent, load, load_stribeck,
        motor_load, external_load, motor_stribeck, external_stribeck, motor_square, external_square,
    ) = np.moveaxis(coefficients, -1, 0)  # fmt: skip
    slow = np.exp(-(np.abs(velocity / speed) ** exponent))
    total = by_position * np.abs(position) + slow * stribeck
    total = total + np.abs((load + external_load) * external - (load + motor_load) * motor)
    total = total + slow * np.abs(
        (load_stribeck + external_stribeck) * external - (load_stribeck + motor_stribeck) * motor
    )
    square = np.where(
        np.abs(motor) > np.abs(external), motor_square * motor**2, external_square * external**2
    )
    largest: Array = total + slow * np.where(motor * external < 0, square, 0.0)
    return largest


def creep(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Return how soft MuJoCo's dry friction is: R and b of each degree of freedom.

    It is a soft constraint there: R force = -(acceleration + b speed), until it saturates.
    """
    least, most = (np.clip(model.dof_solimp[:, place], 1e-4, 1 - 1e-4) for place in (0, 1))
    time, ratio = model.dof_solref.T
    safe = np.maximum(time, 2 * model.opt.timestep)
    damping = np.where(time > 0, 2 / (most * safe), -ratio / most)
    return np.asarray((1 - least) / least * model.dof_invweight0), np.maximum(damping, 1e-9)


def braking_share(speed: Array, zone: Array, slip: Array) -> Array:
    """Return the mean of speed / zone, cut at -1 and 1, over a normal law of the speed.

    Parameters
    ----------
    speed, zone : ndarray
    slip : ndarray
        Standard deviation of the speed.
    """
    zone, slip = np.maximum(zone, 1e-9), np.maximum(slip, 1e-9)

    def ramp(x: Array) -> Array:
        return np.asarray(
            x * erf(x / (np.sqrt(2) * slip)) + slip * np.sqrt(2 / np.pi) * np.exp(-0.5 * (x / slip) ** 2)
        )

    return np.asarray((ramp(speed + zone) - ramp(speed - zone)) / (2 * zone))
