"""An industrial arm on an exciting trajectory."""

import sqlite3
from contextlib import closing
from os import PathLike
from typing import Any

import numpy as np
from sklearn.utils import Bunch

from skat.datasets.originals import Source, original_files
from skat.datasets.runs import Run, transitions

SOURCE = Source(
    folder="ur10_bag",
    url="https://raw.githubusercontent.com/unisa-acg/inverse-dynamics-solver/"
    "41e196de5ca340f2b48e443484a7c74a77533da4/ur10_inverse_dynamics_solver/bagfiles/",
    hashes={
        "ur10_exciting_trajectory.db3": "14244fc39e9b42047039824f3c20ab984f9d1b28d5a67e9415cc1b3cc0ac3369",
    },
)
MESSAGE = "sensor_msgs/msg/JointState"

DESCR = """\
UR10: an industrial arm of six joints on an exciting trajectory

A rosbag2 of 3,441 messages of joint states, 125 times a second: angles, speeds, and as effort the motors' currents in
A, which stand for the action in `data`. What a motor's torque is for each ampere, the bag does not say.

Source: https://github.com/unisa-acg/inverse-dynamics-solver, commit 41e196de, folder
ur10_inverse_dynamics_solver/bagfiles.
Licence: BSD-3-Clause.
"""


def fetch_ur10(*, data_home: str | PathLike[str] | None = None, download_if_missing: bool = True) -> Bunch:
    """Load a run of a UR10 as transitions of 8 ms.

    Needs rosbags, which ``python -m pip install "skat[ros]"`` installs.

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

        data : ndarray of shape (n_transitions, 18)
            Angles in rad, speeds in rad/s, and motor currents in A, of the six joints.
        target : ndarray of shape (n_transitions, 12)
            The state one row later.
        groups : ndarray of shape (n_transitions,)
            Episode of each transition: a run, or what of it has no gap in time.
        group_names : list of str
            Name of each episode.
        feature_names, target_names : list of str
            ``qpos.<joint>``, ``qvel.<joint>``; ``ctrl.<joint>``; joints as ROS calls them.
        hidden : list of str
            States that were not measured, whose columns are NaN; none.
        units : dict of str to str
            Unit of each name.
        dt : float
            Seconds from row to row, about 0.008.
        facts : dict
            ``"topic"``: where the messages are in the bag.
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

    ImportError
        If rosbags is not installed.
    """
    name = next(iter(SOURCE.hashes))
    files = original_files(SOURCE, [name], home=data_home, download_if_missing=download_if_missing)
    time, states, currents, joints = _joint_states(files[name])
    return transitions(
        {"exciting_trajectory": Run(time, states, currents)},
        joints=joints,
        commanded=joints,
        command_unit="A",
        facts={"topic": "/joint_states"},
        files=list(files.values()),
        DESCR=DESCR,
    )


def _joint_states(path: str | PathLike[str]) -> Any:
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise ImportError(
            'the UR10\'s log is a ROS 2 bag, which rosbags reads: python -m pip install "skat[ros]"'
        ) from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as bag:
        rows = bag.execute("SELECT timestamp, data FROM messages ORDER BY timestamp").fetchall()
    messages: list[Any] = [store.deserialize_cdr(data, MESSAGE) for _, data in rows]
    time = 1e-9 * np.array([stamp for stamp, _ in rows])
    states = np.array([[*message.position, *message.velocity] for message in messages])
    return time, states, np.array([message.effort for message in messages]), list(messages[0].name)
