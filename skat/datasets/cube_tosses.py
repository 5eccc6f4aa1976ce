"""Tosses of an acrylic cube onto a table, measured by motion capture."""

from collections.abc import Sequence
from importlib.resources import files
from os import PathLike
from typing import Any

import numpy as np
from sklearn.utils import Bunch

from skat.datasets.originals import Source, original_files, provided, verified
from skat.simulators import MujocoSimulator
from skat.torch_arrays import read_torch_array

FRAME_INTERVAL = 1 / 148
HALF_WIDTH = 0.0524
MASS = 0.37
N_TOSSES = 570

SOURCE = Source(
    folder="cube_tosses",
    url="https://raw.githubusercontent.com/DAIRLab/contact-nets/c3dc21c94577ff4ed99123f0b00bfe57bb2d1d90/"
    "data/tosses_processed/",
    hashes=dict(
        line.split()
        for line in files("skat.datasets").joinpath("cube_tosses.sha256").read_text().splitlines()
    ),
)
TIDIED = "tosses_si.npz"
TIDIED_SHA256 = "dc5e4a07545dbe87b297cb2cd3814b9e7d7a14e48b7cc0b3983ca144f2a90ddc"

DESCR = """\
Cube tosses: 570 tosses of an acrylic cube of 0.1048 m and 0.37 kg onto a flat table

Position, orientation and velocities by motion capture at 148 Hz; between 80 and 442 rows a toss. Positions
are the centre of the cube in m, z upwards, the table at z = 0; the orientation is a unit quaternion
(w, x, y, z); velocities are in m/s in the world's frame, angular velocities in rad/s in the cube's frame, as
MuJoCo has them. The velocities follow from the positions (close to the difference from the row before), they
are no measurement of their own. The originals count lengths in half-widths of the cube, 0.0524 m. The
authors state a coefficient of friction of 0.18 between cube and table.

Source: https://github.com/DAIRLab/contact-nets, commit c3dc21c9, folder data/tosses_processed.
Licence: BSD-3-Clause, copyright (c) 2020 Dynamic Autonomy and Intelligent Robotics Lab.
Citation: S. Pfrommer, M. Halm, M. Posa (2020). ContactNets: Learning Discontinuous Contact Dynamics with
Smooth, Implicit Representations. Conference on Robot Learning.
"""

STATE_NAMES = [
    *(f"qpos.cube.{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz")),
    *(f"qvel.cube.{part}" for part in ("vx", "vy", "vz", "wx", "wy", "wz")),
]


def fetch_cube_tosses(
    tosses: int | Sequence[int] | np.ndarray | None = None,
    *,
    data_home: str | PathLike[str] | None = None,
    download_if_missing: bool = True,
) -> Bunch:
    """Load tosses of a cube as transitions from one frame of the motion capture to the next.

    Parameters
    ----------
    tosses : int or sequence of int, default=None
        Numbers of tosses, from 0 to 569. None means all of them: 570 files, 9 MB.

    data_home : str or Path, default=None
        Folder for the downloaded files. None means the user's cache folder. Copies in ``$SKAT_DATA_HOME``
        come first.

    download_if_missing : bool, default=True
        Whether to download the files that are not on this machine.

    Returns
    -------
    Bunch
        With these attributes:

        data : ndarray of shape (n_transitions, 13)
            State at the start of each transition.
        target : ndarray of shape (n_transitions, 13)
            State 1/148 s later.
        groups : ndarray of shape (n_transitions,)
            Number of the toss each transition belongs to.
        group_names : list of str
            Name of each toss, in the order of `data`.
        feature_names, target_names : list of str
            MuJoCo's names of the state of a free joint ``cube``.
        units : dict of str to str
            Unit of each name.
        dt : float
            Seconds per transition.
        frame : DataFrame
            The same rows, one for each frame: toss, time_s and the state.
        DESCR : str
            Origin, licence, citation.

    Raises
    ------
    ValueError
        If a toss does not exist, or a file is not the original.

    OSError
        If a file is not there and may not or cannot be downloaded.

    See Also
    --------
    cube_toss_simulator : The simulation one would write first.

    Notes
    -----
    The data are described in [1]_.

    References
    ----------
    .. [1] S. Pfrommer, M. Halm, M. Posa (2020). ContactNets: Learning Discontinuous
       Contact Dynamics with Smooth, Implicit Representations. Conference on Robot Learning.
    """
    import pandas as pd

    tosses = list(range(N_TOSSES)) if tosses is None else np.atleast_1d(tosses).tolist()
    if unknown := [toss for toss in tosses if toss not in range(N_TOSSES)]:
        raise ValueError(
            f"There is no toss {unknown[0]!r}. The tosses are numbered from 0 to {N_TOSSES - 1}."
        )
    if not tosses:
        raise ValueError("No toss was asked for; name at least one, or pass tosses=None for all.")
    states = _read_tosses([int(toss) for toss in tosses], data_home, download_if_missing)
    lengths = [len(state) for state in states]
    frame = pd.DataFrame(np.concatenate(states), columns=STATE_NAMES)
    frame.insert(0, "toss", np.repeat(tosses, lengths))
    frame.insert(1, "time_s", np.concatenate([FRAME_INTERVAL * np.arange(length) for length in lengths]))
    return Bunch(
        data=np.concatenate([state[:-1] for state in states]),
        target=np.concatenate([state[1:] for state in states]),
        groups=np.repeat(tosses, [length - 1 for length in lengths]),
        group_names=[f"toss {toss}" for toss in tosses],
        feature_names=STATE_NAMES,
        target_names=STATE_NAMES,
        units=dict(zip(STATE_NAMES, ["m"] * 3 + [""] * 4 + ["m/s"] * 3 + ["rad/s"] * 3, strict=True)),
        dt=FRAME_INTERVAL,
        frame=frame,
        DESCR=DESCR,
    )


def cube_toss_simulator() -> MujocoSimulator:
    """Return the simulation of a tossed cube one would write first, with MuJoCo's default friction.

    The cube has the stated size and mass; contact and friction are MuJoCo's defaults. The friction cone is
    round (elliptic): MuJoCo's default, a pyramid, is weaker between its edges, so that its coefficient is not
    the one that a slope measures. A step is a frame of the motion capture, because its velocities are
    differences between frames, which is what MuJoCo's Euler step gives.

    Returns
    -------
    MujocoSimulator
        A box on a free joint ``cube`` above a plane; a transition is 1/148 s, as in `fetch_cube_tosses`.

    Examples
    --------
    >>> from skat.datasets import cube_toss_simulator
    >>> cube_toss_simulator().state_names[:3]
    ('qpos.cube.x', 'qpos.cube.y', 'qpos.cube.z')
    """
    return MujocoSimulator(
        f"""
        <mujoco model="cube toss">
          <option timestep="{FRAME_INTERVAL!r}" cone="elliptic"/>
          <worldbody>
            <geom name="table" type="plane" size="2 2 0.1"/>
            <body name="cube" pos="0 0 {HALF_WIDTH}">
              <freejoint name="cube"/>
              <geom name="cube" type="box" size="{HALF_WIDTH} {HALF_WIDTH} {HALF_WIDTH}" mass="{MASS}"/>
            </body>
          </worldbody>
        </mujoco>
        """
    )


def read_toss(path: str | PathLike[str]) -> Any:
    """Return the state of one original toss in SI units.

    Parameters
    ----------
    path : str or Path
        An original file.

    Returns
    -------
    ndarray of shape (n_frames, 13)
        Position, quaternion, velocity, angular velocity in the cube's frame.

    Raises
    ------
    ValueError
        If the file is not a tensor of shape (1, n_frames, 19).
    """
    table = read_torch_array(path)
    if table.ndim != 3 or (len(table), table.shape[2]) != (1, 19):
        raise ValueError(f"{path} holds an array of shape {table.shape}; expected (1, n_frames, 19).")
    in_half_widths = np.r_[0:3, 7:10]
    state = table[0, :, :13].copy()
    state[:, in_half_widths] *= HALF_WIDTH
    return state


def _read_tosses(tosses: Any, home: str | PathLike[str] | None, download_if_missing: bool) -> Any:
    mine = provided(SOURCE.folder)
    if mine is not None and (tidied := mine / TIDIED).is_file():
        with np.load(verified(tidied, TIDIED_SHA256)) as arrays:
            return [arrays[str(toss)] for toss in tosses]
    names = [f"{toss}.pt" for toss in tosses]
    found = original_files(SOURCE, dict.fromkeys(names), home=home, download_if_missing=download_if_missing)
    return [read_toss(found[name]) for name in names]
