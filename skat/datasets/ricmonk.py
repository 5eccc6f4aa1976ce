"""A brachiating robot, without and with weights on its arms."""

from collections.abc import Sequence
from os import PathLike

import numpy as np
import pandas as pd
from sklearn.utils import Bunch

from skat.datasets.originals import Source, original_files
from skat.datasets.runs import Run, chosen, transitions

RUNS = {
    "no load": "TVLQR_3xForward",
    "170 g on one arm": "TVLQR_3xForward_170gm_asymmetricLoad",
    "200 g on both arms": "TVLQR_3xForward_200gm_symmetricLoad",
    "520 g as a disturbance": "TVLQR_ZF_520gm_disturbance",
}
SOURCE = Source(
    folder="ricmonk",
    url="https://raw.githubusercontent.com/dfki-ric-underactuated-lab/ricmonk/"
    "05b19cf011708f179049383e8507a8645fe1848c/",
    hashes={
        "TVLQR_3xForward.csv": "cf08dad7f7016af79e342daf8d971ab7180b5c0474eb9d5d87f4136df2d7c6c8",
        "TVLQR_3xForward_170gm_asymmetricLoad.csv": "55d6b9d768edb123fd81535233b9f1a947a17efad5e53f67bc74a2141693b295",
        "TVLQR_3xForward_200gm_symmetricLoad.csv": "744347e7d4ef3b0247f071fc776772523b4917faf29324d8c36f0609af973061",
        "TVLQR_ZF_520gm_disturbance.csv": "81985feb993328f8de578f01614fcd27c7015e19c50cb4f36228f82d45eab29e",
        "ricmonk.urdf": "a8ad2f3214c83d2a2157fac49ee6f0bd0a1b66341d0675547b6291990a079db8",
    },
    paths={f"{run}.csv": f"results/multipleBrachiation_tvlqr/{run}/measured.csv" for run in RUNS.values()}
    | {"ricmonk.urdf": "data/simulation_models/finalRicMonkCurrent.urdf"},
)
JOINTS = ["arm1", "tail", "phi"]
HANGING = "state_machine_flag"

DESCR = f"""\
RicMonk: a robot that swings from bar to bar, with two arms that hook on and a tail between them

One motor turns the tail against arm 1, another one arm 2 against the tail; about which bar the robot swings is nobody's
command. Four runs at about 165 Hz: without a weight, with 170 g on one arm, with 200 g shared by both, and with 520 g
hung on as a disturbance. The action in `data` are the two torques as commanded after clipping. An episode is a phase in
which one hook holds (``{HANGING}`` 1), and what of it has no gap. `facts` holds all 40 columns of a run.

Arm 1 is the arm that hangs on the bar, so that another arm has that name in the second swing: by least squares on the
second motor's torque the free arm of the run with 170 g is heavier than that of the run without in swings 1 and 3, by
four standard errors each, and in swing 2 it is not. In the last 0.18 s of a swing the free hook is at the
next bar, and the motors at their limits. Where exactly the weights sit, only the authors' pictures show.

Source: https://github.com/dfki-ric-underactuated-lab/ricmonk, commit 05b19cf0, folders
results/multipleBrachiation_tvlqr and data/simulation_models.
Licence: BSD-3-Clause, copyright (c) DFKI RIC Underactuated Robotics Lab.
"""


def fetch_ricmonk(
    runs: str | Sequence[str] | None = "no load",
    *,
    data_home: str | PathLike[str] | None = None,
    download_if_missing: bool = True,
) -> Bunch:
    """Load runs of a brachiating robot as transitions of 6 ms.

    Parameters
    ----------
    runs : str, sequence of str or None, default="no load"
        Of "no load", "170 g on one arm", "200 g on both arms", "520 g as a disturbance". None means all.

    data_home : str or Path, default=None
        Folder for the downloaded files. None means the user's cache folder. A copy in ``$SKAT_DATA_HOME`` comes first.

    download_if_missing : bool, default=True
        Whether to download files that are not on this machine.

    Returns
    -------
    Bunch
        With these attributes:

        data : ndarray of shape (n_transitions, 8)
            Angles of arm 1 (about the bar, 0 hangs), tail and phi (as the log calls the second motor's) in rad, their
            speeds in rad/s, and the torques commanded of tail and phi in N m.
        target : ndarray of shape (n_transitions, 6)
            The state one row later.
        groups : ndarray of shape (n_transitions,)
            Episode of each transition: a run, or what of it has no gap in time.
        group_names : list of str
            Name of each episode.
        feature_names, target_names : list of str
            ``qpos.arm1``, ``qpos.tail``, ``qpos.phi``, ``qvel.arm1``, ...; ``ctrl.tail``, ``ctrl.phi``.
        hidden : list of str
            States that were not measured, whose columns are NaN; none.
        units : dict of str to str
            Unit of each name.
        dt : float
            Seconds from row to row, about 0.006.
        facts : dict
            ``"frame"``: the whole table of each run, by name.
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
    runs = chosen("run", runs, list(RUNS))
    names = [f"{RUNS[run]}.csv" for run in runs]
    files = original_files(
        SOURCE, [*names, "ricmonk.urdf"], home=data_home, download_if_missing=download_if_missing
    )
    tables = {run: pd.read_csv(files[name]) for run, name in zip(runs, names)}
    phases = {}
    for run, table in tables.items():
        held = table[HANGING].to_numpy() == 1
        starts = np.flatnonzero(np.diff(np.r_[0, held]) == 1)
        ends = np.flatnonzero(np.diff(np.r_[held, 0]) == -1) + 1
        for number, (start, end) in enumerate(zip(starts, ends), start=1):
            part = table.iloc[start:end]
            states = [f"{joint}_meas_Ang_{kind}" for kind in ("pos", "vel") for joint in JOINTS]
            commands = [f"{joint}_clipped_tau" for joint in JOINTS[1:]]
            phases[f"{run}, swing {number}"] = Run(
                part["meas_time"].to_numpy(), part[states].to_numpy(), part[commands].to_numpy()
            )
    return transitions(
        phases,
        joints=JOINTS,
        commanded=JOINTS[1:],
        command_unit="N m",
        facts={"frame": tables},
        files=list(files.values()),
        DESCR=DESCR,
    )
