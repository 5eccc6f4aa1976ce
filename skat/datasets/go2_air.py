"""A quadruped, hung up by its base."""

from os import PathLike

import numpy as np
from sklearn.utils import Bunch

from skat.datasets.originals import Source, original_files
from skat.datasets.runs import Run, transitions
from skat.torch_arrays import read_torch_arrays

SOURCE = Source(
    folder="go2_air",
    url="https://raw.githubusercontent.com/iit-DLSLab/sim2real-robot-identification/"
    "06739ea0424fa8b2e141df0942ecdaf27a5c8600/datasets/go2/",
    hashes={
        "traj_0.pt": "f22b1625f331b724e84ebdae5b0679168307364ad93a1d9c3d9cf1620f38efb0",
    },
)
LEGS = ("FL", "FR", "RL", "RR")
JOINTS = [f"{leg}_{part}_joint" for leg in LEGS for part in ("hip", "thigh", "calf")]
MOTORS = [joint.removesuffix("_joint") for joint in JOINTS]
FACTS = {"kp": 20.0, "kd": 1.5}

DESCR = """\
Go2 in the air: a Unitree Go2 hung up by its base, its legs moving freely

The action in `data` are the joint positions that were asked for, 200 times a second, of which the robot makes torques
by gains of its own (`facts`: kp 20 N m/rad, kd 1.5 N m s/rad). Speeds were not recorded.

Source: https://github.com/iit-DLSLab/sim2real-robot-identification, commit 06739ea0, file datasets/go2/traj_0.pt.
Licence: BSD-3-Clause.
"""


def fetch_go2_air(*, data_home: str | PathLike[str] | None = None, download_if_missing: bool = True) -> Bunch:
    """Load a run of a hung-up quadruped as transitions of 5 ms.

    The original is a PyTorch file, of which only the arrays are read, without PyTorch.

    Parameters
    ----------
    data_home : str or Path, default=None
        Folder for the downloaded files. None means the user's cache folder. A copy in ``$SKAT_DATA_HOME`` comes first.

    download_if_missing : bool, default=True
        Whether to download files that are not on this machine.

    Returns
    -------
    Bunch
        With these attributes:

        data : ndarray of shape (n_transitions, 36)
            Angles in rad, speeds (NaN: not measured), and desired angles in rad, of the twelve joints.
        target : ndarray of shape (n_transitions, 24)
            The state one row later.
        groups : ndarray of shape (n_transitions,)
            Episode of each transition: a run, or what of it has no gap in time.
        group_names : list of str
            Name of each episode.
        feature_names, target_names : list of str
            ``qpos.<joint>``, ``qvel.<joint>``; ``ctrl.<motor>``; names as in MuJoCo Menagerie.
        hidden : list of str
            States that were not measured, whose columns are NaN: the speeds.
        units : dict of str to str
            Unit of each name.
        dt : float
            Seconds from row to row, about 0.005.
        facts : dict
            The gains of the robot's own controller: kp in N m/rad, kd in N m s/rad.
        files : list of Path
            The originals, which `skat.logs.load_log` and ``skat diagnose`` read as they are.
        DESCR : str
            Origin and licence.

    Raises
    ------
    ValueError
        If the file is not the original.

    OSError
        If a file is not there and may not or cannot be downloaded.
    """
    files = original_files(SOURCE, ["traj_0.pt"], home=data_home, download_if_missing=download_if_missing)
    arrays = read_torch_arrays(files["traj_0.pt"])
    positions = arrays["dof_pos"].astype(float)
    states = np.hstack([positions, np.full_like(positions, np.nan)])
    run = Run(arrays["time"].astype(float), states, arrays["des_dof_pos"].astype(float))
    return transitions(
        {"traj_0": run},
        joints=JOINTS,
        commanded=MOTORS,
        command_unit="rad",
        facts=dict(FACTS),
        files=list(files.values()),
        DESCR=DESCR,
    )
