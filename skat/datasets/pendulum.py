"""A pendulum that a motor swings up."""

from os import PathLike

import numpy as np
import pandas as pd
from sklearn.utils import Bunch

from skat.datasets.originals import Source, original_files
from skat.simulators import MujocoSimulator

INTERVAL = 0.005
# Of the weight that the authors' controller reckons with, and its distance from the axis; kg and m.
MASS, LENGTH = 0.6755, 0.5
# The pendulum is up where it hangs less than this far from upright; rad.
UP = 0.3
STEPS = 5
# Of the files, by the weight in kg.
ENDINGS = {0.5: ".csv", 1.0: "_1kg.csv"}

SOURCE = Source(
    folder="pendulum",
    url="https://raw.githubusercontent.com/dfki-ric-underactuated-lab/torque_limited_simple_pendulum/"
    "ed17ea2d32a35ad944944ca03ef57693e2986732/results/control_method_energy_shaping/",
    hashes={
        "data_desired.csv": "503dceac0c5098aaff4ee8375422a44ad4aebdb47d308aa8578c34dac09f9762",
        "data_measured.csv": "e1844e56f87cf763bdecb3f6f7e5b622a9a3b2d71e907b48ed6148b0a059c209",
        "data_desired_1kg.csv": "c9d7c718822ce8069522744da7208854c55cc47bbda3754a6ba46b04696b948e",
        "data_measured_1kg.csv": "61d782d4797500fb2e7f42b4ad80c8c694e5e5ebdf5862535acb94a475b950d2",
    },
)

DESCR = """\
Pendulum: a weight on a rod, swung up by a motor in its axis

A controller that shapes the energy commands the motor's torque every 5 ms, for 20 s: it swings the weight up and
balances it there. Angle, speed and torque are what the motor's driver reports, in steps of 0.0029 rad and 0.022 rad/s,
so that one row says little of the speed: name it as hidden (`hidden`) and compare the angle in open loop instead.
The action in `data` is the torque that was commanded; the one reported follows it about 7 ms later, see `frame`.
Upright, the controller shakes the weight some thirty times a second, and the rod no longer moves as one with the
motor; someone pushes it over now and then. Without the part from where it is first up, the log is that of the swing.

Source: https://github.com/dfki-ric-underactuated-lab/torque_limited_simple_pendulum, commit ed17ea2d, folder
results/control_method_energy_shaping.
Licence: BSD-3-Clause, copyright (c) 2021 DFKI RIC Underactuated Robotics Lab.
"""


def fetch_pendulum(
    *,
    load: float = 0.5,
    part: str = "swing-up",
    seconds: float = 0.5,
    data_home: str | PathLike[str] | None = None,
    download_if_missing: bool = True,
) -> Bunch:
    """Load a run of a motor-driven pendulum as transitions of 5 ms.

    Parameters
    ----------
    load : {0.5, 1.0}, default=0.5
        Weight at the end of the rod, kg: the run with that one.

    part : {"swing-up", "all"}, default="swing-up"
        Whether only the rows until the pendulum is up for the first time, 4 or 8 s of the 20.

    seconds : float, default=0.5
        Length of the pieces that the run is cut into, each an episode; a shorter one at the end is left out.

    data_home : str or Path, default=None
        Folder for the downloaded files. None means the user's cache folder. A copy in ``$SKAT_DATA_HOME`` comes first.

    download_if_missing : bool, default=True
        Whether to download files that are not on this machine.

    Returns
    -------
    Bunch
        With these attributes:

        data : ndarray of shape (n_transitions, 3)
            Angle in rad (0 hangs), speed in rad/s, and the torque commanded in N m, at the start of each transition.
        target : ndarray of shape (n_transitions, 2)
            Angle and speed 5 ms later.
        groups : ndarray of shape (n_transitions,)
            Piece of each transition.
        group_names : list of str
            When each piece starts.
        feature_names, target_names : list of str
            ``qpos.hinge``, ``qvel.hinge``; ``ctrl.motor``.
        hidden : list of str
            The names whose readings are too coarse to start from: ``qvel.hinge``.
        units : dict of str to str
            Unit of each name.
        dt : float
            Seconds per transition.
        files : list of Path
            The originals.
        frame : DataFrame
            Original rows of the whole run: time_s, position_rad, velocity_rad_s, torque_N_m as reported and
            commanded_N_m.
        DESCR : str
            Origin and licence.

    Raises
    ------
    ValueError
        If there is no such load or part, a piece would be shorter than 20 transitions or longer than the part, or a
        file is not the original.

    OSError
        If a file is not there and may not or cannot be downloaded.

    See Also
    --------
    pendulum_simulator : The simulation one would write first.
    """
    if part not in ("swing-up", "all"):
        raise ValueError(f'part must be "swing-up" or "all"; it is {part!r}.')
    if load not in ENDINGS:
        raise ValueError(f"load must be one of {', '.join(map(str, ENDINGS))}, in kg; it is {load!r}.")
    ending = ENDINGS[load]
    names = [f"data_measured{ending}", f"data_desired{ending}"]
    files = original_files(SOURCE, names, home=data_home, download_if_missing=download_if_missing)
    measured, commanded = (pd.read_csv(files[name]) for name in names)
    frame = pd.DataFrame(
        {
            "time_s": measured["time"],
            "position_rad": measured["position"],
            "velocity_rad_s": measured["velocity"],
            "torque_N_m": measured["torque"],
            "commanded_N_m": commanded["torque"],
        }
    )
    states = frame[["position_rad", "velocity_rad_s"]].to_numpy()
    n_rows = len(states) - 1
    if part == "swing-up":
        n_rows = int(np.argmax(np.abs(states[:, 0]) > np.pi - UP))
    length = round(seconds / INTERVAL)
    if not 20 <= length <= n_rows:
        raise ValueError(
            f"seconds must be from {20 * INTERVAL:g} to {n_rows * INTERVAL:g}, the length of this part; it is "
            f"{seconds!r}."
        )
    n_pieces = n_rows // length
    rows = slice(n_pieces * length)
    inputs = np.column_stack([states, frame["commanded_N_m"]])
    return Bunch(
        data=inputs[rows],
        target=states[1:][rows],
        groups=np.repeat(np.arange(n_pieces), length),
        group_names=[f"from {piece * length * INTERVAL:g} s" for piece in range(n_pieces)],
        feature_names=["qpos.hinge", "qvel.hinge", "ctrl.motor"],
        target_names=["qpos.hinge", "qvel.hinge"],
        hidden=["qvel.hinge"],
        units={"qpos.hinge": "rad", "qvel.hinge": "rad/s", "ctrl.motor": "N m"},
        dt=INTERVAL,
        files=list(files.values()),
        frame=frame,
        DESCR=DESCR,
    )


def pendulum_simulator(mass: float = MASS) -> MujocoSimulator:
    """Return the simulation of the pendulum one would write first: a point mass on a rod, and a motor without losses.

    Parameters
    ----------
    mass : float, default=0.6755
        Of the weight, kg; the default is what the authors' controller reckons with in the run without load.

    Returns
    -------
    MujocoSimulator
        A hinge ``hinge`` and a motor ``motor``; a transition is 5 ms, as in `fetch_pendulum`.

    Raises
    ------
    ValueError
        If the mass is not positive.

    Examples
    --------
    >>> from skat.datasets import pendulum_simulator
    >>> pendulum_simulator().input_names
    ('qpos.hinge', 'qvel.hinge', 'ctrl.motor')
    """
    if not 0 < mass < np.inf:
        raise ValueError(f"mass must be positive and finite, in kg; it is {mass!r}.")
    return MujocoSimulator(
        f"""
        <mujoco model="pendulum">
          <option timestep="{INTERVAL / STEPS!r}" integrator="implicitfast"/>
          <worldbody>
            <body name="weight">
              <joint name="hinge" type="hinge" axis="0 -1 0"/>
              <inertial pos="0 0 {-LENGTH}" mass="{mass!r}" diaginertia="1e-6 1e-6 1e-6"/>
            </body>
          </worldbody>
          <actuator>
            <motor name="motor" joint="hinge"/>
          </actuator>
        </mujoco>
        """,
        frame_skip=STEPS,
    )
