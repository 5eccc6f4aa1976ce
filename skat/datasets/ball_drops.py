"""Sports balls dropped from about 48 m, their height filmed."""

from collections.abc import Iterable, Sequence
from os import PathLike
from typing import Any

import numpy as np
import pandas as pd
from sklearn.utils import Bunch

from skat.datasets.originals import Source, original_files
from skat.simulators import MujocoSimulator

FRAME_INTERVAL = 1 / 15

SOURCE = Source(
    folder="ball_drops",
    url="https://raw.githubusercontent.com/briandesilva/discovery-of-physics-from-data/"
    "b79c34317f049c9b47aaf2cc4c54c5ec7219f3d7/",
    hashes={"Ball_drops_data.xls": "942b2d68abfff3828ca323de491435d4ec27c3a22e62cee0cbdf52c2e8d1c0ed"},
)

# Ball -> (mass in kg, circumference in m), from the authors' table in ounces and centimetres. They give no
# values for the volleyball: those are the middle of what the rules of the game allow.
BALLS = {
    "Baseball": (0.1417, 0.2225),
    "Blue Basketball": (0.5103, 0.75),
    "Green Basketball": (0.4536, 0.7325),
    "Volleyball": (0.27, 0.66),
    "Bowling Ball": (2.2963, 0.67),
    "Golf Ball": (0.0459, 0.138),
    "Tennis Ball": (0.0567, 0.2075),
    "Whiffle Ball 1": (0.0283, 0.228),
    "Whiffle Ball 2": (0.0283, 0.228),
    "Yellow Whiffle Ball": (0.0425, 0.29),
    "Orange Whiffle Ball": (0.0425, 0.29),
}

DESCR = """\
Ball drops: eleven sports balls, each dropped twice from about 48 m

The height was read from video at 15 Hz. The height is the only measurement: the velocity in `frame` was
computed from the heights by the authors, and the velocity in `data` and `target` by differences here, as a
first guess to start from. Name it as hidden (`hidden`) wherever a method would take it for a measurement.

The time stamps of the originals jump: a row in eighteen is 2.5 % late, and in eight drops one row comes
after a half or one and a half intervals. `data` and `target` hold the heights on an even grid of 1/15 s, by
a cubic spline through the original ones; `frame` holds the original rows.

Source: https://github.com/briandesilva/discovery-of-physics-from-data, commit b79c3431.
Licence: MIT, copyright (c) 2020 Brian de Silva.
Citation: B. M. de Silva, D. M. Higdon, S. L. Brunton, J. N. Kutz (2020). Discovery of Physics From Data:
Universal Laws and Discrepancies. Frontiers in Artificial Intelligence 3:25.
"""


def fetch_ball_drops(
    balls: str | Sequence[str] | None = None,
    *,
    drops: int | Sequence[int] = (1, 2),
    data_home: str | PathLike[str] | None = None,
    download_if_missing: bool = True,
) -> Bunch:
    """Load heights of falling balls as transitions from one video frame to the next.

    Parameters
    ----------
    balls : str or sequence of str, default=None
        Names of balls. None means all eleven.

    drops : int or sequence of int, default=(1, 2)
        Which of the two drops of each ball.

    data_home : str or Path, default=None
        Folder for the downloaded file. None means the user's cache folder. A copy in ``$SKAT_DATA_HOME``
        comes first.

    download_if_missing : bool, default=True
        Whether to download the file if it is not on this machine.

    Returns
    -------
    Bunch
        With these attributes:

        data : ndarray of shape (n_transitions, 2)
            State at the start of each transition: height in m, and a starting guess of the velocity in m/s.
        target : ndarray of shape (n_transitions, 2)
            State 1/15 s later.
        groups : ndarray of shape (n_transitions,)
            Number of the drop each transition belongs to.
        group_names : list of str
            Name of each group: the ball and its drop.
        feature_names, target_names : list of str
            ``qpos.z`` and ``qvel.z``.
        hidden : list of str
            The names that were not measured: ``qvel.z``.
        units : dict of str to str
            Unit of each name.
        dt : float
            Seconds per transition.
        frame : DataFrame
            Original rows: ball, drop, time_s, height_m, velocity_m_s.
        DESCR : str
            Origin, licence, citation.

    Raises
    ------
    ValueError
        If a ball or drop does not exist, or the file is not the original.

    OSError
        If the file is not there and may not or cannot be downloaded.

    See Also
    --------
    ball_drop_simulator : The simulation one would write first.

    Notes
    -----
    The data are described in [1]_.

    References
    ----------
    .. [1] B. M. de Silva, D. M. Higdon, S. L. Brunton, J. N. Kutz (2020). Discovery
       of Physics From Data: Universal Laws and Discrepancies. Frontiers in Artificial Intelligence 3:25.
    """
    balls = list(BALLS) if balls is None else [balls] if isinstance(balls, str) else list(balls)
    drops = list(drops) if isinstance(drops, Iterable) else [drops]
    if unknown := [ball for ball in balls if ball not in BALLS]:
        raise ValueError(f"There is no ball {unknown[0]!r}. The balls are: {', '.join(BALLS)}.")
    if neither := [drop for drop in drops if drop not in (1, 2)]:
        raise ValueError(f"There is no drop {neither[0]!r}. Each ball was dropped twice: drop 1 and drop 2.")

    (path,) = original_files(
        SOURCE, list(SOURCE.hashes), home=data_home, download_if_missing=download_if_missing
    ).values()
    frame = read_workbook(path)
    frame = frame[frame["ball"].isin(balls) & frame["drop"].isin(drops)].reset_index(drop=True)
    names, states = [], []
    for ball in balls:
        for drop in drops:
            rows = frame[(frame["ball"] == ball) & (frame["drop"] == drop)]
            names.append(f"{ball} {drop}")
            states.append(_evenly_spaced(rows["time_s"].to_numpy(), rows["height_m"].to_numpy()))
    state_names = ["qpos.z", "qvel.z"]
    return Bunch(
        data=np.concatenate([state[:-1] for state in states]),
        target=np.concatenate([state[1:] for state in states]),
        groups=np.repeat(np.arange(len(states)), [len(state) - 1 for state in states]),
        group_names=names,
        feature_names=state_names,
        target_names=state_names,
        hidden=["qvel.z"],
        units={"qpos.z": "m", "qvel.z": "m/s"},
        dt=FRAME_INTERVAL,
        frame=frame,
        DESCR=DESCR,
    )


def ball_drop_simulator(ball: str = "Baseball") -> MujocoSimulator:
    """Return the simulation of a falling ball one would write first: gravity and nothing else.

    Parameters
    ----------
    ball : str, default="Baseball"
        Name of a ball: its mass and radius are the model's.

    Returns
    -------
    MujocoSimulator
        A sphere on a vertical slide joint ``z``; a transition is 1/15 s, as in `fetch_ball_drops`.

    Raises
    ------
    ValueError
        If there is no such ball.

    Examples
    --------
    >>> from skat.datasets import ball_drop_simulator
    >>> ball_drop_simulator("Golf Ball").input_names
    ('qpos.z', 'qvel.z')
    """
    if ball not in BALLS:
        raise ValueError(f"There is no ball {ball!r}. The balls are: {', '.join(BALLS)}.")
    mass, circumference = BALLS[ball]
    steps = 4
    return MujocoSimulator(
        f"""
        <mujoco model="ball drop">
          <option timestep="{FRAME_INTERVAL / steps!r}" integrator="RK4"/>
          <worldbody>
            <body name="ball">
              <joint name="z" type="slide" axis="0 0 1"/>
              <geom name="ball" type="sphere" size="{circumference / (2 * np.pi):.5f}" mass="{mass}"/>
            </body>
          </worldbody>
        </mujoco>
        """,
        frame_skip=steps,
    )


def read_workbook(path: str | PathLike[str]) -> pd.DataFrame:
    """Return the tidy table of the original workbook, which has one sheet for each ball.

    Parameters
    ----------
    path : str or Path
        The original file. Its name ends in xls, its content is in the newer xlsx format.

    Returns
    -------
    DataFrame
        Columns ball, drop, time_s, height_m, velocity_m_s; balls in the order of the workbook.
    """
    try:
        import openpyxl
    except ImportError as error:
        raise ImportError(
            'the ball drops are an Excel file, which openpyxl reads: python -m pip install "skat[excel]"'
        ) from error

    columns = {
        "Drop #": "drop",
        "Time (s)": "time_s",
        "Height (m)": "height_m",
        "Velocity (m/s)": "velocity_m_s",
    }
    tables = []
    with open(path, "rb") as file:
        for sheet in openpyxl.load_workbook(file, read_only=True, data_only=True):
            # Some sheets end in thousands of empty rows, with which pandas.read_excel takes ten seconds.
            header, *rows = (row for row in sheet.iter_rows(values_only=True) if set(row) != {None})
            table = pd.DataFrame(rows, columns=header)[list(columns)].rename(columns=columns).astype(float)
            tables.append(table.assign(ball=sheet.title, drop=table["drop"].astype(int)))
    return pd.concat(tables, ignore_index=True)[["ball", *columns.values()]]


def _evenly_spaced(time: Any, height: Any) -> Any:
    from scipy.interpolate import CubicSpline

    grid = FRAME_INTERVAL * np.arange(np.floor((time[-1] - time[0]) / FRAME_INTERVAL + 1e-3) + 1)
    heights = CubicSpline(time - time[0], height)(grid)
    return np.column_stack([heights, np.gradient(heights, FRAME_INTERVAL, edge_order=2)])
