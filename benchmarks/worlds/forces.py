"""Random forces on joints: white, with memory, and a resonance. Plain NumPy and SciPy."""

import numpy as np
from scipy import signal

# Kind: (share of the rms torque, law).
FORCES = {
    "white5": (0.05, "white"),
    "white20": (0.20, "white"),
    "memory5": (0.05, "memory"),
    "memory20": (0.20, "memory"),
    "resonance5": (0.05, "resonance"),
    "resonance20": (0.20, "resonance"),
}
MEMORY = 0.2  # s
FREQUENCY, DAMPING_RATIO = 20.0, 0.05


def random_force(kind, rms, n_rows, substeps, timestep, rng):
    """Return forces of shape (n_rows * substeps, n), one for each time step.

    A white force is held for a row, so that its size does not depend on the time step; one with memory is an
    Ornstein-Uhlenbeck process of 0.2 s; a resonance is white noise through a spring and mass of 20 Hz with 5 % of
    critical damping. Each has the stated root mean square per column.

    Parameters
    ----------
    kind : str
        One of `FORCES`.
    rms : ndarray of shape (n,)
        Root mean square of the torque that the motors give; 0 where there is no force.
    """
    share, law = FORCES[kind]
    n = n_rows * substeps
    if law == "white":
        forces = np.repeat(rng.normal(size=(n_rows, len(rms))), substeps, axis=0)
    elif law == "memory":
        keep = np.exp(-timestep / MEMORY)
        start = rng.normal(size=(1, len(rms)))
        innovations = np.sqrt(1 - keep**2) * rng.normal(size=(n, len(rms)))
        forces = signal.lfilter([1], [1, -keep], innovations, axis=0, zi=keep * start)[0]
    else:
        omega = 2 * np.pi * FREQUENCY
        poles = np.exp(timestep * omega * (-DAMPING_RATIO + 1j * np.sqrt(1 - DAMPING_RATIO**2)))
        denominator = np.real(np.poly([poles, poles.conj()]))
        settle = int(10 / (DAMPING_RATIO * omega * timestep))
        forces = signal.lfilter([1], denominator, rng.normal(size=(n + settle, len(rms))), axis=0)[settle:]
        impulse = signal.lfilter([1], denominator, np.eye(1, 2 * settle)[0])
        forces /= np.sqrt(np.sum(impulse**2))
    return share * rms * forces
