"""What a log can show, from the true model alone: nats of each hidden cause, and how well noise can be told.

A linear Kalman filter along the true path, with the sensors' true noise and the covariance of the true random forces;
the slopes of its innovations by each cause's strength (1: as hidden, 0: neutral) give the Fisher information F.
A cause is worth 1 / (2 [F^-1]_ii) nats: what the true model's log likelihood, others refitted, loses without it. Plain
NumPy.
"""

import mujoco
import numpy as np

from worlds.hidden import channel_names, family_of, target_of
from worlds.robots import World, predict, scales, tangent_error
from worlds.sensing import COMPUTED, ENCODER_STEPS, FINE_NOISE, NOISE, TRAVEL

_DRIFT = 1e-9  # of a channel's spread, so that no covariance is singular


def derivatives(log):
    """Return the slopes of the true model's next state by the state, (n_rows, 2 nv, 2 nv)."""
    world = World(log.robot, log.truth)
    model = world.model
    nq, nv = model.nq, model.nv
    spread, _ = scales(log.robot)
    step = 1e-5 * np.maximum(spread, 1e-3)
    slopes = np.empty((len(log.exact), 2 * nv, 2 * nv))
    for channel in range(2 * nv):
        ends = []
        for sign in (-1, 1):
            moved = log.exact.copy()
            tangent = np.zeros(nv)
            if channel < nv:
                tangent[channel] = sign * step[channel]
                for row in moved:
                    mujoco.mj_integratePos(model, row[:nq], tangent, 1.0)
            else:
                moved[:, nq + channel - nv] += sign * step[channel]
            ends.append(predict(log, log.truth, moved))
        slopes[:, :, channel] = tangent_error(model, ends[1], ends[0]) / (2 * step[channel])
    return slopes


def effects_of(log):
    """Return by how much each hidden cause moves the true model's next state and readings.

    Returns
    -------
    dict of str to (ndarray of shape (n_rows, 2 nv), ndarray of shape (n_rows, 2 nv))
    """
    model = World(log.robot).model
    whole = predict(log, log.truth)
    moves = {}
    for name, value in log.truth.items():
        state, reading = np.zeros((len(whole), 2 * model.nv)), np.zeros((len(whole), 2 * model.nv))
        if family_of(name) in ("bias", "scale"):
            column = channel_names(model).index(target_of(name))
            reading[:, column] = value if family_of(name) == "bias" else (value - 1) * log.exact[:, column]
        else:
            rest = {other: number for other, number in log.truth.items() if other != name}
            state = tangent_error(model, whole, predict(log, rest))
        moves[name] = state, reading
    return moves


def sensor_noise(log):
    """Return the variance of each channel's readings, and which channels are measured; computed velocities are not."""
    model = World(log.robot).model
    nv = model.nv
    variance = log.sigma**2
    if log.sensor in ("positions", *COMPUTED):
        measured = np.arange(2 * nv) < nv
        if log.sensor == "encoder":
            step = np.where(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE, 2 * np.pi, TRAVEL) / ENCODER_STEPS
            variance = np.concatenate([step**2 / 12, np.ones(nv)])
        elif log.sensor in COMPUTED:
            variance = (FINE_NOISE / NOISE) ** 2 * variance
        return np.maximum(variance, 1e-18), measured & (variance > 0)
    return variance, variance > 0


def process_noise(log):
    """Return the covariance of what the true model without random forces misses in a row, (2 nv, 2 nv)."""
    spread, _ = scales(log.robot)
    missed = tangent_error(World(log.robot).model, log.exact_next, predict(log, log.truth))
    return missed.T @ missed / len(missed) + np.diag((_DRIFT * np.maximum(spread, 1e-6)) ** 2)


def worth(log):
    """Return the nats that each hidden cause is worth, the others refitted, and each alone.

    Returns
    -------
    dict of str to (float, float)
    """
    moves = effects_of(log)
    if not moves:
        return {}
    information = _filter(log, moves)
    alone = np.diag(information) / 2
    # A direction that nothing shows has no information: its causes are worth nothing beside each other.
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-12))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    inverse = (vectors**2 / np.maximum(values, 1e-9)).sum(axis=1) * scale**2
    return {name: (float(1 / (2 * one)), float(two)) for name, one, two in zip(moves, inverse, alone)}


def _filter(log, moves):
    slopes = derivatives(log)
    n = slopes.shape[1]
    variance, measured = sensor_noise(log)
    H = np.eye(n)[measured]
    R = np.diag(variance[measured])
    Q = process_noise(log)
    spread, _ = scales(log.robot)
    P0 = np.diag(np.maximum(4 * spread, 1e-3) ** 2)
    information = np.zeros((len(moves), len(moves)))
    state_moves = np.stack([state for state, _ in moves.values()], axis=-1)
    read_moves = np.stack([reading for _, reading in moves.values()], axis=-1)
    P, D = P0, np.zeros((n, len(moves)))
    for row in range(len(slopes)):
        if row == 0 or log.groups[row] != log.groups[row - 1]:
            P, D = P0, np.zeros((n, len(moves)))
        S = H @ P @ H.T + R
        Z = H @ (D + read_moves[row])
        information += Z.T @ np.linalg.solve(S, Z)
        K = np.linalg.solve(S, H @ P).T
        D = D - K @ Z
        P = P - K @ H @ P
        D = slopes[row] @ D + state_moves[row]
        P = slopes[row] @ P @ slopes[row].T + Q
        P = (P + P.T) / 2
    return information


def noise_bound(log):
    """Return the least standard error of the log of each channel's noise, from the Fisher information of variances.

    Of innovations with covariance S: F_ij = sum_t tr(S^-1 dS_i S^-1 dS_j) / 2, for the log variances of the sensors and
    of the random accelerations together; dS follows the filter from row to row. What the means of innovations
    say of variances, through the gain, is left out: it is small. ``inf`` where a channel is not measured.
    """
    slopes = derivatives(log)
    n = slopes.shape[1]
    variance, measured = sensor_noise(log)
    channels = np.flatnonzero(measured)
    H = np.eye(n)[measured]
    R = np.diag(variance[measured])
    Q = process_noise(log)
    parts = [
        np.outer(row, row) * variance[channel]
        for row, channel in zip(np.eye(n), range(n))
        if measured[channel]
    ]
    forced = [
        n // 2 + dof for dof in range(n // 2) if Q[n // 2 + dof, n // 2 + dof] > 1e-6 * variance[n // 2 + dof]
    ]
    pushes = [Q * (np.eye(n)[dof][:, None] * np.eye(n)[dof]) for dof in forced]
    spread, _ = scales(log.robot)
    P0 = np.diag(np.maximum(4 * spread, 1e-3) ** 2)
    count = len(parts) + len(pushes)
    information = np.zeros((count, count))
    P, dP = P0, np.zeros((count, n, n))
    for row in range(len(slopes)):
        if row == 0 or log.groups[row] != log.groups[row - 1]:
            P, dP = P0, np.zeros((count, n, n))
        S = H @ P @ H.T + R
        inverse = np.linalg.inv(S)
        dS = np.einsum("ia,kab,jb->kij", H, dP, H, optimize=True)
        for index, part in enumerate(parts):
            dS[index] += H @ part @ H.T
        scaled = np.einsum("ij,kjl->kil", inverse, dS, optimize=True)
        information += 0.5 * np.einsum("kij,lji->kl", scaled, scaled, optimize=True)
        # Joseph's form with the gain's own change of second order in the covariance: exact at the optimal gain.
        K = P @ H.T @ inverse
        keep = np.eye(n) - K @ H
        dP = np.einsum("ia,kab,jb->kij", keep, dP, keep, optimize=True)
        for index, part in enumerate(parts):
            dP[index] += K @ (H @ part @ H.T) @ K.T
        P = keep @ P
        dP = np.einsum("ia,kab,jb->kij", slopes[row], dP, slopes[row], optimize=True)
        for index, push in enumerate(pushes):
            dP[len(parts) + index] += push
        P = slopes[row] @ P @ slopes[row].T + Q
        P = (P + P.T) / 2
    bound = np.full(n, np.inf)
    # Of a log variance; that of a log standard deviation is half of it.
    covariance = np.linalg.pinv(information, hermitian=True)
    bound[channels] = np.sqrt(np.maximum(np.diag(covariance)[: len(channels)], 0)) / 2
    return bound
