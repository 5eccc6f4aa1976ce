"""The struck puck as a world: a strike in, a resting place out, by plain stepping of edited MJCF text."""

import mujoco
import numpy as np


def strike_log(mjcf, edit, *, seed, n_strikes=80, noise=0.01):
    """Return strikes and measured resting places in the world that an edit makes of a puck's MJCF.

    Parameters
    ----------
    mjcf : str
        The nominal model: joints of the puck first, then the stick's two; see ``skat.simulators.puck``.
    edit : pair of str
        Text that is there once, and what replaces it.
    seed : int
    n_strikes : int
    noise : float
        Standard deviation of the noise over the spread of each output.

    Returns
    -------
    z : ndarray of shape (n_strikes, 2)
        Direction, 0.4 rad per unit, and speed, 1.2 exp(0.25 z) m/s.
    places : ndarray of shape (n_strikes, 2)
        Measured x and y of the puck at rest, m.
    """
    if mjcf.count(edit[0]) != 1:
        raise ValueError(f"expected {edit[0]!r} once in the model; it is there {mjcf.count(edit[0])} times")
    rng = np.random.default_rng([seed, 20240608])
    model = mujoco.MjModel.from_xml_string(mjcf.replace(*edit))
    z = rng.normal(size=(n_strikes, 2))
    places = np.array([_strike(model, *row) for row in z])
    sigma = noise * places.std(axis=0)
    return z, np.round(
        (places + sigma * rng.standard_t(5, size=places.shape) * 0.6**0.5) / sigma * 2
    ) * sigma / 2


def _strike(model, turn, push):
    """Return where the puck comes to rest."""
    data = mujoco.MjData(model)
    along = np.array([np.cos(0.4 * turn), np.sin(0.4 * turn)])
    reach = model.geom("puck").size[0] + model.geom("stick").size[0] + 0.01
    data.qpos[4:6] = -reach * along
    data.qvel[4:6] = 1.2 * np.exp(0.25 * push) * along
    for _ in range(15_000):
        mujoco.mj_step(model, data)
        if np.hypot(*data.qvel[:2]) < 0.005 and np.hypot(*data.qvel[4:6]) < 0.005:
            break
    return data.qpos[:2].copy()
