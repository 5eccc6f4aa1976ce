"""Sensors as robots have them, on paths of true states: noise, differences, filters, encoders, lost samples.

All are of one position noise e per channel, so that sensors can be compared on the same path. What was not measured
is NaN. Plain NumPy and SciPy.
"""

import numpy as np
from scipy import signal

SENSORS = ("ideal", "differences", "lowpass10", "lowpass30", "zero_phase", "positions", "encoder")
# Those whose velocities were computed from positions.
COMPUTED = ("differences", "lowpass10", "lowpass30", "zero_phase", "encoder")
# Noise over the spread of a channel: of positions that are measured as they are, and of those that velocities are
# computed from (an encoder's; with 1 % a difference over 10 ms would be noise alone).
NOISE, FINE_NOISE = 0.01, 0.001
ENCODER_STEPS = 2**14
# Travel in m that the encoder of a slide divides.
TRAVEL = 2.0
DROPPED = 0.02
ZERO_PHASE_CUTOFF = 0.2  # of Nyquist


def read(sensor, path, sigma, turning, dt, rng, *, normal=None):
    """Return the readings of a path, and which samples of it are NaN.

    Parameters
    ----------
    sensor : str
        One of `SENSORS`, or "exact" (the states themselves).
    path : ndarray of shape (n_samples, 2 nv)
        True positions and velocities at the rate of the rows.
    sigma : ndarray of shape (2 nv,)
        Noise of the ideal sensor: 1 % of each channel's spread.
    turning : ndarray of bool of shape (nv,)
        Whether a position is an angle; an encoder has 2^14 steps in a turn, or in 2 m.
    dt : float
        Duration of a row, s.
    rng : numpy.random.Generator
    normal : ndarray of shape (n_samples, 2 nv), optional
        Standard normal noise to take, as a controller has read it already.
    """
    nv = path.shape[1] // 2
    noise = rng.normal(size=path.shape) if normal is None else normal
    positions, velocities = path[:, :nv], path[:, nv:]
    if sensor == "exact":
        return path.copy()
    if sensor == "ideal":
        return path + sigma * noise
    if sensor == "positions":
        return np.column_stack([positions + sigma[:nv] * noise[:, :nv], np.full_like(velocities, np.nan)])
    if sensor == "encoder":
        step = np.where(turning, 2 * np.pi, TRAVEL) / ENCODER_STEPS
        counted = np.round(positions / step) * step
        readings = np.column_stack([counted, backward(counted, dt)])
        readings[rng.random(len(readings)) < DROPPED] = np.nan
        return readings
    fine = positions + FINE_NOISE / NOISE * sigma[:nv] * noise[:, :nv]
    if sensor == "differences":
        return np.column_stack([fine, np.gradient(fine, dt, axis=0)])
    if sensor.startswith("lowpass"):
        return np.column_stack([fine, lowpass(backward(fine, dt), int(sensor.removeprefix("lowpass")) / 100)])
    if sensor == "zero_phase":
        smooth = signal.sosfiltfilt(signal.butter(2, ZERO_PHASE_CUTOFF, output="sos"), fine, axis=0)
        return np.column_stack([smooth, np.gradient(smooth, dt, axis=0)])
    raise ValueError(f"sensor must be one of {', '.join(SENSORS)} or 'exact'; it is {sensor!r}")


def backward(positions, dt):
    """Return each sample's difference from the one before, per time; the first has that of the second."""
    difference = np.diff(positions, axis=0) / dt
    return np.concatenate([difference[:1], difference])


def lowpass(values, cutoff):
    """Return values after a causal Butterworth filter of second order; ``cutoff`` is a share of Nyquist."""
    sections = signal.butter(2, cutoff, output="sos")
    settled = signal.sosfilt_zi(sections)[:, :, None] * values[0]
    return signal.sosfilt(sections, values, axis=0, zi=settled)[0]
