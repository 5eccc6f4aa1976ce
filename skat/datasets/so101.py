"""A servo arm of hobbyists, the SO-101."""

import json
from collections.abc import Iterable, Sequence
from os import PathLike
from typing import Any

import numpy as np
import pandas as pd
from sklearn.utils import Bunch

from skat.datasets.originals import Source, original_files
from skat.datasets.runs import Run, chosen, transitions

SOURCE = Source(
    folder="so101",
    url="https://raw.githubusercontent.com/isaac-sim2real/sage/4ffd2627df9d23e279b35712a67e629ce0c0dfa7/"
    "output/real/so101/custom/",
    hashes={
        "backlash_detection/control.csv": "daec0b6d5f718e57211f0a02c23b4b32a6eb30d9211fcbe2eec8e20fd9dc2432",
        "backlash_detection/state_motor.csv": "de47b14babdb2cd7453395f4119f6c8eeecee0e237134b48651b53ecdc9df2b1",
        "chirp_sweep/control.csv": "9b87d99cdbddfe72cf2f7ceddbde9290b5a47de996fe35f8f2c9a83a84917670",
        "chirp_sweep/state_motor.csv": "85e9bd89fbc1cb97d21eba269242aca4437a8faa2116859e96b458b7001579d8",
        "friction_gravity/control.csv": "f2e53e26d4050ea8631542f10a6c6baa71274114641d9b688fbd4bca165dde0b",
        "friction_gravity/state_motor.csv": "2f4ad531531dd6ee112ee874ec08f186b7f5b364a7176c4d14227a8e650a35e2",
        "hold_under_gravity/control.csv": "8be0b6ce3e5790a8e75b20a9816c484732db6a008a969b19c4b1dfde77d666c3",
        "hold_under_gravity/state_motor.csv": "4ee6f2386b70ae80d23e258c7519df42f73ef18a1d26a3b300817efd932b0f2d",
        "multisine/control.csv": "99562591fb0e8cecae236670e14a13458d49a146bb6448c26cdec25935cd5a80",
        "multisine/state_motor.csv": "97d4112d4e83567b62e39e67c1eed515540bbba271a226df5ac796163e35d27b",
        "pick_place/control.csv": "9cd0e3d038c84b4e4153032d2b86d1806ddaabf3fb0410d4aa886be654e248c1",
        "pick_place/state_motor.csv": "865bdb444b3a6f50607fb48083b54011aea09000a668da999618b2d9c5df238e",
        "prbs_excitation/control.csv": "bf4a3a4624842040cb796a0db5a61f47b7de9d8779f53d7825c37e737196ee01",
        "prbs_excitation/state_motor.csv": "3900353f0a48a6a2105998f71a29e155c099de9bc0c1b2d44b71402dcc5492d7",
        "single_joint_elbow/control.csv": "38f7a57f0db1aa801f1e9e1b0718a1706c90ee90e423d86fb33890fdfd439d95",
        "single_joint_elbow/state_motor.csv": "500599987ec9878eecbaf767cb9b370172e00eaad00a1c835aa5ee8579a9756f",
        "step_response/control.csv": "ba3ef94713ab9e581c2d587aa88245793ba03c644dd9f455fd869a6b428f3ccc",
        "step_response/state_motor.csv": "74f67c391331664f059c7058f79b42c5845e813c0acf16e7c79851b1b18b9ec5",
        "velocity_ramp/control.csv": "7192916f209fa955039c32843d4a3c60ea244ac2e30b1d31f5d6e77bc8b9cb9d",
        "velocity_ramp/state_motor.csv": "dd0fdcc9c18889987ec6fc633c155ed0c35e10852e667c479681a880d16a86d1",
    },
)
MOTIONS = list(dict.fromkeys(name.partition("/")[0] for name in SOURCE.hashes))
# As the official model calls them; the log's own names are Rotation, Pitch, Elbow, Wrist_Pitch, Wrist_Roll and Jaw.
JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]

# The driver tells the gripper's place as a share of the range that it was calibrated to: places are on a grid of so
# many steps of a servo that has 4096 a turn, and the speeds beside them are those of such a range.
GRIPPER_STEPS, STEPS_OF_A_TURN = 1523, 4096
# The middle of that range is put where the official model has its own: where the share is 0 is not known.
GRIPPER_MIDDLE = 0.785398

DESCR = """\
SO-101: a servo arm of six joints (Feetech STS3215) in ten motions

The action in `data` are the positions that were commanded, 50 times a second; positions, speeds and torques are what
the servos' driver reports. Positions come in steps of 0.0015 rad. The reported speeds lag the positions. The files have
the gripper's positions and commands as shares of its calibrated range, 1523 steps or 2.336 rad, as their grid and the
speeds show; here they are rad, with the middle of that range in the middle of the official model's.

Source: https://github.com/isaac-sim2real/sage, commit 4ffd2627, folder output/real/so101/custom.
Licence: Apache-2.0.
"""


def fetch_so101(
    motions: str | Sequence[str] | None = None,
    *,
    data_home: str | PathLike[str] | None = None,
    download_if_missing: bool = True,
) -> Bunch:
    """Load motions of an SO-101 servo arm as transitions of 20 ms.

    Parameters
    ----------
    motions : str or sequence of str, default=None
        Of "backlash_detection", "chirp_sweep", "friction_gravity", "hold_under_gravity",
        "multisine", "pick_place", "prbs_excitation", "single_joint_elbow",
        "step_response", "velocity_ramp". None means all.

    data_home : str or Path, default=None
        Folder for the downloaded files. None means the user's cache folder. A copy in ``$SKAT_DATA_HOME`` comes first.

    download_if_missing : bool, default=True
        Whether to download files that are not on this machine.

    Returns
    -------
    Bunch
        With these attributes:

        data : ndarray of shape (n_transitions, 18)
            Angles in rad, speeds in rad/s, and commanded angles in rad, of the six joints.
        target : ndarray of shape (n_transitions, 12)
            The state one row later.
        groups : ndarray of shape (n_transitions,)
            Episode of each transition: a run, or what of it has no gap in time.
        group_names : list of str
            Name of each episode.
        feature_names, target_names : list of str
            ``qpos.<joint>``, ``qvel.<joint>``; ``ctrl.<joint>``; joints as in the official model.
        hidden : list of str
            States that were not measured, whose columns are NaN; none.
        units : dict of str to str
            Unit of each name.
        dt : float
            Seconds from row to row, about 0.02.
        facts : dict
            ``"torque"``: what the driver reports, in its units, an array of shape (n_rows, 6) by motion;
            ``"names"``: what the log calls the joints.
        files : list of Path
            The originals, which `skat.logs.load_log` and ``skat diagnose`` read as they are.
        DESCR : str
            Origin and licence.

    Raises
    ------
    ValueError
        If there is no such motion, or a file is not the original.

    OSError
        If a file is not there and may not or cannot be downloaded.
    """
    motions = chosen("motion", motions, MOTIONS)
    names = [f"{motion}/{kind}.csv" for motion in motions for kind in ("control", "state_motor")]
    files = original_files(SOURCE, names, home=data_home, download_if_missing=download_if_missing)
    runs, torques = {}, {}
    for motion in motions:
        commanded, measured = (
            pd.read_csv(files[f"{motion}/{kind}.csv"]) for kind in ("control", "state_motor")
        )
        states = np.hstack([_angles(measured["positions"]), _vectors(measured["velocities"])])
        # Both files have a row for each cycle of the controller, of one time, in microseconds.
        time = 1e-6 * measured["timestamp"].to_numpy()
        runs[motion] = Run(time, states, _angles(commanded["positions"]))
        torques[motion] = _vectors(measured["torques"])
    return transitions(
        runs,
        joints=JOINTS,
        commanded=JOINTS,
        command_unit="rad",
        facts={
            "torque": torques,
            "names": ["Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll", "Jaw"],
        },
        files=list(files.values()),
        DESCR=DESCR,
    )


def _angles(column: Iterable[str]) -> Any:
    """Return positions in rad."""
    angles = _vectors(column)
    reach = GRIPPER_STEPS * 2 * np.pi / STEPS_OF_A_TURN
    angles[:, -1] = GRIPPER_MIDDLE + reach * (angles[:, -1] - 0.5)
    return angles


def _vectors(column: Iterable[str]) -> Any:
    """Return the lists that a column holds as texts, a row each."""
    return np.array([json.loads(text) for text in column], dtype=float)
