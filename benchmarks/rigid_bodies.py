"""Inverse dynamics of an arm and least squares on it, in plain MuJoCo and NumPy: nothing of skat is in here."""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy import signal

CUTOFF = 8.0  # Hz
ENDS = 0.5  # s at either end of a log, where a filter without phase guesses
# Speeds above which dry friction has its full size, rad/s, in the inverse dynamics alone.
SLIDING = 0.02
# What least squares know of a joint's own.
OWN = ("dry friction", "damping", "rotor", "constant")


@dataclass(frozen=True)
class Smooth:
    """Angles, speeds, accelerations and efforts without their fast part; shape (n_rows, n_joints) each, SI units."""

    angles: np.ndarray
    speeds: np.ndarray
    accelerations: np.ndarray
    efforts: np.ndarray


def smoothed(angles, speeds, efforts, dt, cutoff=CUTOFF):
    """Return a log behind a Butterworth filter that is run forward and backward; accelerations are slopes of speeds."""
    filtered = signal.butter(4, cutoff, fs=1 / dt, output="sos")
    q, v, u = (signal.sosfiltfilt(filtered, one, axis=0) for one in (angles, speeds, efforts))
    inner = slice(round(ENDS / dt), len(q) - round(ENDS / dt))
    return Smooth(q[inner], v[inner], np.gradient(v, dt, axis=0)[inner], u[inner])


def efforts_of(model, log):
    """Return what a model's motors would have to be sent for the motion, shape (n_rows, n_joints)."""
    bare = _without_dry_friction(model)
    data = mujoco.MjData(bare)
    found = []
    for q, v, a in zip(log.angles, log.speeds, log.accelerations, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(bare, data)
        force = data.qfrc_inverse + model.dof_frictionloss * np.tanh(v / SLIDING)
        found.append(
            (force / bare.actuator_gear[:, 0] - bare.actuator_biasprm[:, 0]) / bare.actuator_gainprm[:, 0]
        )
    return np.array(found)


def _without_dry_friction(model):
    bare = copy.copy(model)
    bare.dof_frictionloss[:] = 0.0
    bare.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    return bare


def regressors(model, log):
    """Return the torques of each inertial parameter alone, shape (n_rows, n_joints, 10 n_bodies).

    Of each body its mass, first moment (3) and moments about its frame's origin (xx, yy, zz, xy, xz, yz), in its frame.
    """
    data = mujoco.MjData(model)
    nv, bodies = model.nv, range(1, model.nbody)
    jacp, jacr, dotp, dotr = (np.zeros((3, nv)) for _ in range(4))
    found = np.zeros((len(log.angles), nv, 10 * (model.nbody - 1)))
    for row, (q, v, a) in enumerate(zip(log.angles, log.speeds, log.accelerations, strict=True)):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        for place, body in enumerate(bodies):
            at = data.xpos[body]
            mujoco.mj_jac(model, data, jacp, jacr, at, body)
            mujoco.mj_jacDot(model, data, dotp, dotr, at, body)
            turn = data.xmat[body].reshape(3, 3)
            # All in the body's frame; gravity is an acceleration of the base.
            linear = turn.T @ (jacp @ a + dotp @ v - model.opt.gravity)
            spin, spun = turn.T @ (jacr @ v), turn.T @ (jacr @ a + dotr @ v)
            mine = np.zeros((6, 10))
            mine[:3, 0] = linear
            mine[:3, 1:4] = _cross(spun) + _cross(spin) @ _cross(spin)
            mine[3:, 1:4] = -_cross(linear)
            mine[3:, 4:] = _moments(spun) + _cross(spin) @ _moments(spin)
            found[row, :, 10 * place : 10 * place + 10] = (turn.T @ jacp).T @ mine[:3] + (
                turn.T @ jacr
            ).T @ mine[3:]
    return found


def _cross(x):
    return np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


def _moments(x):
    """Return the matrix M with I x = M (xx, yy, zz, xy, xz, yz)."""
    return np.array([[x[0], 0, 0, x[1], x[2], 0], [0, x[1], 0, x[0], 0, x[2]], [0, 0, x[2], 0, x[0], x[1]]])


def friction_columns(log, joint, without=None):
    """Return the columns of a joint's own: those of `OWN`, or all of them but one."""
    v = log.speeds[:, joint]
    columns = [np.tanh(v / SLIDING), v, log.accelerations[:, joint], np.ones_like(v)]
    return np.column_stack([one for name, one in zip(OWN, columns, strict=True) if name != without])


def fitted_efforts(columns, log, other_columns, other, without=None):
    """Return efforts of another log, and the coefficients, by least squares of each joint's own effort.

    ``columns`` are of shape (n_rows, n_joints, n_columns); directions that the log does not excite are left out.
    """
    told, coefficients = [], []
    for joint in range(log.efforts.shape[1]):
        mine = np.column_stack([columns[:, joint], friction_columns(log, joint, without)])
        scale = np.linalg.norm(mine, axis=0)
        scale[scale == 0] = 1.0
        found = np.linalg.lstsq(mine / scale, log.efforts[:, joint], rcond=1e-5)[0] / scale
        theirs = np.column_stack([other_columns[:, joint], friction_columns(other, joint, without)])
        told.append(theirs @ found)
        coefficients.append(found)
    return np.column_stack(told), np.array(coefficients)
