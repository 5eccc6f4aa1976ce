"""A two-link arm with a motor at each joint, the elbow's over a belt."""

from collections.abc import Sequence
from os import PathLike

import pandas as pd
from sklearn.utils import Bunch

from skat.datasets.originals import Source, original_files
from skat.datasets.runs import Run, chosen, transitions

FOLDER = "data/experiment_records/design_C.1/sys_id/20230629/20230629-{run}/trajectory.csv"
SOURCE = Source(
    folder="double_pendulum",
    url="https://raw.githubusercontent.com/dfki-ric-underactuated-lab/double_pendulum/"
    "1e8544e67f3da72a51ee52fbbb278e131ce2a43f/",
    hashes={
        "143339.csv": "94f17287b53187dfe8f4ce131f4e7c49918309fcc915cbae2f64ed3101e7c23b",
        "143524.csv": "03fc5e18915e80afabb3e2674b627f9d849d43675aeacbf586ccd24b3ebd7ca5",
        "143601.csv": "e028c1d7a6a45cfe1b96b7cb33aae412b8888f022677d392f6f9cd4d4f63886d",
        "143704.csv": "e19682394cb7dc8847db9010e568b139a85a447bfbc4547b8828ad58da64a2a9",
        "143747.csv": "8b3f8f25dceec77dbe05c2e687d86485b272fbcabd3af5485a119c9944243a1e",
    },
    paths={
        f"{run}.csv": FOLDER.format(run=run) for run in ("143339", "143524", "143601", "143704", "143747")
    },
)
RUNS = [name.removesuffix(".csv") for name in SOURCE.hashes]
JOINTS = ["shoulder", "elbow"]
# Of the authors' model_1.0; SI units.
AUTHORS = {
    **{"I1": 0.031887199591513114, "I2": 0.05086984812807257, "Ir": 6.287203962819607e-05, "gr": 6.0},
    **{"b1": 0.001, "b2": 0.001, "cf1": 0.16, "cf2": 0.12, "l1": 0.2, "l2": 0.3},
    **{"m1": 0.5234602302310271, "m2": 0.6255677234174437, "r1": 0.2, "r2": 0.25569305436052964},
}

DESCR = """\
Double pendulum: a two-link arm driven by a motor in the shoulder and, over a belt, one in the elbow

Five runs of the authors' identification of design C.1, ten seconds each at about 2 ms: angles and speeds as the motors'
drivers report them, the torque that was commanded and the one that was measured. The action in `data` is the commanded
torque; the compensation of friction in it is zero in these runs. `facts` holds the authors' model: friction is
cf atan(100 v), that is a dry friction of cf pi / 2.

Source: https://github.com/dfki-ric-underactuated-lab/double_pendulum, commit 1e8544e6, folder
data/experiment_records/design_C.1/sys_id/20230629.
Licence: BSD-3-Clause, copyright (c) DFKI RIC Underactuated Robotics Lab.
"""


def fetch_double_pendulum(
    runs: str | Sequence[str] | None = None,
    *,
    data_home: str | PathLike[str] | None = None,
    download_if_missing: bool = True,
) -> Bunch:
    """Load runs of a two-link arm as transitions of 2 ms.

    Parameters
    ----------
    runs : str or sequence of str, default=None
        Of "143339", "143524", "143601", "143704", "143747". None means all.

    data_home : str or Path, default=None
        Folder for the downloaded files. None means the user's cache folder. A copy in ``$SKAT_DATA_HOME`` comes first.

    download_if_missing : bool, default=True
        Whether to download files that are not on this machine.

    Returns
    -------
    Bunch
        With these attributes:

        data : ndarray of shape (n_transitions, 6)
            Angles in rad, speeds in rad/s, and commanded torques in N m, of shoulder and elbow.
        target : ndarray of shape (n_transitions, 4)
            The state one row later.
        groups : ndarray of shape (n_transitions,)
            Episode of each transition: a run, or what of it has no gap in time.
        group_names : list of str
            Name of each episode.
        feature_names, target_names : list of str
            ``qpos.shoulder``, ``qpos.elbow``, ``qvel.shoulder``, ...; ``ctrl.shoulder``, ``ctrl.elbow``.
        hidden : list of str
            States that were not measured, whose columns are NaN; none.
        units : dict of str to str
            Unit of each name.
        dt : float
            Seconds from row to row, about 0.002.
        facts : dict
            The authors' parameters (``model_1.0``) by name, SI units.
        files : list of Path
            The originals, which `skat.logs.load_log` and ``skat diagnose`` read as they are.
        DESCR : str
            Origin and licence.

    Raises
    ------
    ValueError
        If there is no such run, or a file is not the original.

    OSError
        If a file is not there and may not or cannot be downloaded.
    """
    runs = chosen("run", runs, RUNS)
    files = original_files(
        SOURCE, [f"{run}.csv" for run in runs], home=data_home, download_if_missing=download_if_missing
    )
    found = {}
    for run, path in zip(runs, files.values()):
        table = pd.read_csv(path)
        states = table[["pos_meas1", "pos_meas2", "vel_meas1", "vel_meas2"]].to_numpy()
        found[run] = Run(table["time"].to_numpy(), states, table[["tau_con1", "tau_con2"]].to_numpy())
    return transitions(
        found,
        joints=JOINTS,
        commanded=JOINTS,
        command_unit="N m",
        facts=dict(AUTHORS),
        files=list(files.values()),
        DESCR=DESCR,
    )
