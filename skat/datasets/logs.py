"""Read a robot's log from a CSV file as transitions of a simulator."""

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.utils import Bunch, check_random_state

from skat.datasets.tables import line_of, listed, numbers, other_mark, read_table
from skat.episodes import FEWEST_ROWS, drawn_episodes

# The clock of a log may deviate by this much of a transition; more cannot be told from a lost row.
CLOCK_TOLERANCE = 0.01
# The mean transition is known better, and what it misses of a whole number of steps acts in every row.
STEP_TOLERANCE = 1e-3
# Positions that move by so many times more or less than velocities say are not seconds apart.
OTHER_CLOCK = 30.0
# Where velocities say so many times more, times are in milliseconds, or smaller units.
MILLISECONDS = 300.0


def load_log(path, simulator, *, frame_skip=None):
    r"""Load a log as transitions of a simulator.

    Parameters
    ----------
    path : str or Path
        CSV file with one row for each instant, in time order: ``time`` in s, ``episode`` (optional), and one
        column for each input of the simulator: ``qpos.<joint>``, ``qvel.<joint>``, ``ctrl.<actuator>``. The
        action in a row acts from that row to the next.

    simulator : Simulator
        With a state. Its inputs name the columns. The time step of a `MujocoSimulator` tells how many steps make a
        transition; a transition of another simulator takes its ``dt``, and the log's rows must be as far apart.

    frame_skip : int, default=None
        Number of steps of the model from a row to the next. None means: from the times in the log. With a
        number, the log needs no column ``time``; one that says something else, by more than 1 %, raises a warning.

    Returns
    -------
    Bunch
        With these attributes:

        data : ndarray of shape (n_transitions, n_inputs)
            State and action at the start of each transition.
        target : ndarray of shape (n_transitions, n_states)
            State at its end.
        groups : ndarray of shape (n_transitions,)
            Number of the episode, from 0.
        group_names : list of str
            Name of each episode in the log.
        feature_names, target_names : list of str
            Those of the simulator.
        dt : float
            Seconds per transition.
        frame_skip : int
            Steps of the model per transition; 1 where a model has no steps of its own.
        simulator : Simulator
            The simulator with this `frame_skip`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.

    ValueError
        If the file is no table, its columns are not those of the simulator, a value is missing or no number,
        an episode's rows are not together, the times are not even, not in seconds or not a multiple of the model's
        time step, or there are fewer than 20 transitions; if the simulator has no state.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from skat.datasets import ball_drop_simulator, load_log
    >>> rows = [f"{t / 15},{47 - t**2 / 45.9},{-t / 1.53}" for t in range(40)]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "log.csv")
    ...     _ = path.write_text("\n".join(["time,qpos.z,qvel.z", *rows]))
    ...     log = load_log(path, ball_drop_simulator())
    >>> log.data.shape, log.frame_skip, round(log.dt, 4)
    ((39, 2), 4, 0.0667)
    """
    path = Path(path)
    steps_itself = "frame_skip" in simulator.get_params(deep=False)
    if not simulator.state_names:
        raise ValueError(
            "A log of states in time needs a simulator with a state; this one is one-shot. Read its inputs and outputs "
            "by pandas.read_csv, and pass them to fit as X and y."
        )
    if not steps_itself:
        if frame_skip is not None:
            raise ValueError(
                f"frame_skip={frame_skip} is of MuJoCo models; a transition of this {type(simulator).__name__} takes "
                "its dt."
            )
        if simulator.dt is None:
            raise ValueError(
                "The simulator has no dt, the seconds of a transition, to compare the log's times with."
            )
    table = read_table(path)
    _check_columns(table, simulator, path, needs_time=frame_skip is None)
    values = numbers(table, list(simulator.input_names), path)
    starts = _episode_starts(table, path)
    inside = np.ones(len(table), dtype=bool)
    inside[starts] = False
    arrivals = np.flatnonzero(inside)
    if len(arrivals) < FEWEST_ROWS:
        raise ValueError(
            f"{path} has {len(arrivals)} transitions in {len(starts)} episodes; at least {FEWEST_ROWS} are needed. "
            "Record longer, or put several episodes into one file with a column 'episode'."
        )
    timestep = simulator.dt / (simulator.frame_skip if steps_itself else 1)
    if frame_skip is None:
        frame_skip = _steps_per_row(numbers(table, ["time"], path)[:, 0], arrivals, timestep, path)
        _doubt_clock(values, arrivals, simulator, frame_skip * timestep, path)
    elif "time" in table:
        _doubt_steps(table, arrivals, frame_skip, timestep, path)
    if not steps_itself and frame_skip != 1:
        raise ValueError(
            f"{path}: {frame_skip * timestep:g} s from row to row, while a transition of the simulator takes "
            f"{timestep:g} s (dt). Write the function for the log's step, or resample the log."
        )
    episode = np.cumsum(~inside) - 1
    parameters = simulator.get_params(deep=False) | ({"frame_skip": frame_skip} if steps_itself else {})
    n_states = len(simulator.state_names)
    return Bunch(
        data=values[arrivals - 1],
        target=values[arrivals, :n_states],
        groups=episode[arrivals],
        group_names=[str(name) for name in table["episode"].iloc[starts]] if "episode" in table else ["0"],
        feature_names=list(simulator.input_names),
        target_names=list(simulator.state_names),
        dt=frame_skip * timestep,
        frame_skip=frame_skip,
        simulator=type(simulator)(**parameters),
    )


def _check_columns(table, simulator, path, *, needs_time):
    expected = set(simulator.input_names)
    missing = [name for name in simulator.input_names if name not in table]
    unknown = [name for name in table if name not in expected and name not in {"time", "episode"}]
    if missing or unknown:
        raise ValueError(
            f"The columns of {path} do not match the model. "
            + (f"Missing: {listed(missing)}. " if missing else "")
            + (f"Not in the model: {listed(unknown)}; take such columns out. " if unknown else "")
            + _advice(missing, table)
            + f"Expected time, episode (optional), {listed(list(simulator.input_names), 40)}."
        )
    if needs_time and "time" not in table:
        raise ValueError(
            f"{path} has no column 'time' (s). Add it, or say how many steps of the model lie between two rows "
            "(frame_skip, on the command line --frame-skip)."
        )


def _advice(missing, table):
    """Return what to do about columns that are missing."""
    if len(table.columns) == 1 and (advice := other_mark(table.columns[0])):
        return advice
    if missing and all(name.startswith("qvel.") for name in missing):
        options = " ".join(f"--hidden {name}" for name in missing)
        return (
            "Velocities that were not measured: add a column of zeros for each, and name it in hidden= (on the command "
            f"line {options}). "
        )
    return ""


def _episode_starts(table, path):
    if "episode" not in table:
        return np.array([0])
    names = table["episode"].to_numpy()
    if (names == "").any():
        raise ValueError(
            f"{path}, line {line_of(path, np.argmax(names == ''))}: the column 'episode' is empty. Name the episode of "
            "every row."
        )
    starts = np.flatnonzero(np.concatenate([[True], names[1:] != names[:-1]]))
    seen = set()
    for start in starts:
        if names[start] in seen:
            raise ValueError(
                f"{path}, line {line_of(path, start)}: episode {names[start]} goes on after another one began. The "
                "rows of an episode stand together, in time order; give the second part another name if it is "
                "another run."
            )
        seen.add(names[start])
    return starts


def _steps_per_row(time, arrivals, timestep, path):
    intervals = time[arrivals] - time[arrivals - 1]
    dt = float(np.median(intervals))
    if dt <= 0:
        raise ValueError(
            f"{path}: time does not grow from row to row (median step {dt:g} s). Rows must be in time order, the "
            "column 'time' in seconds."
        )
    worst = int(np.argmax(np.abs(intervals - dt)))
    if abs(intervals[worst] - dt) > CLOCK_TOLERANCE * dt:
        raise ValueError(
            f"{path}, line {line_of(path, arrivals[worst])}: {intervals[worst]:g} s after the row before, while the "
            f"usual step is {dt:g} s; more than 1 % apart. Resample the log evenly, start a new episode, in a column "
            "'episode', after each gap, or pass the number of steps per row (frame_skip, on the command line "
            "--frame-skip) if the clock is wrong."
        )
    dt = float(np.mean(intervals))
    steps = round(dt / timestep)
    if steps < 1 or abs(dt / timestep - steps) > STEP_TOLERANCE * dt / timestep:
        raise ValueError(
            f"{path}: {dt:g} s from row to row is {dt / timestep:.4g} of the model's time steps of {timestep:g} s, "
            "not a whole number. Set the model's timestep so that it divides the log's step, "
            f"for example {dt / max(int(np.ceil(dt / timestep - 1e-9)), 1):.6g}, resample the log, or pass the "
            "number of steps per row (frame_skip, on the command line --frame-skip) if the clock is wrong."
        )
    return steps


def _doubt_steps(table, arrivals, frame_skip, timestep, path):
    """Warn where the times, if they are numbers, contradict the number of steps that was given."""
    time = pd.to_numeric(table["time"], errors="coerce").to_numpy(dtype=float)
    told, dt = float(np.median(time[arrivals] - time[arrivals - 1])), frame_skip * timestep
    if abs(told - dt) > CLOCK_TOLERANCE * dt:
        warnings.warn(
            f"{path}: frame_skip={frame_skip} takes {dt:g} s from row to row, while its column 'time' says {told:g} s "
            f"({told / timestep:.4g} steps). The clock is left aside; leave frame_skip out (--frame-skip) if it is "
            "right, and the column 'time' if it is wrong.",
            UserWarning,
            stacklevel=3,
        )


def _doubt_clock(values, arrivals, simulator, dt, path):
    """Warn where positions do not move as far from row to row as velocities say, by orders of magnitude."""
    names = list(simulator.input_names)
    ratios = []
    for position, name in enumerate(names):
        joint, _, axis = name.removeprefix("qpos.").rpartition(".")
        twins = [f"qvel.{name.removeprefix('qpos.')}", f"qvel.{joint}.v{axis}"]
        velocity = next((names.index(twin) for twin in twins if twin in names), None)
        if not name.startswith("qpos.") or velocity is None:
            continue
        moved = np.median(np.abs(values[arrivals, position] - values[arrivals - 1, position]))
        told = np.median(np.abs(values[arrivals - 1, velocity] + values[arrivals, velocity])) / 2 * dt
        if moved > 0 and told > 0:
            ratios.append(moved / told)
    ratio = float(np.median(ratios)) if ratios else 1.0
    text = (
        f"{path}: from row to row, {dt:g} s by the column 'time', positions move by {ratio:.2g} of what the "
        "velocities say. Times must be in seconds, positions and velocities in the same unit of length or angle."
    )
    if ratio < 1 / MILLISECONDS:
        raise ValueError(f"{text} The times look like milliseconds or less: divide them by 1000.")
    if not 1 / OTHER_CLOCK < ratio < OTHER_CLOCK:
        warnings.warn(text, UserWarning, stacklevel=3)


def split_episodes(log, *, test_size, random_state=None):
    """Split a log into two, by whole episodes where there are several.

    Parameters
    ----------
    log : Bunch
        With data, target and, unless its rows are independent, groups.

    test_size : float
        Part of the rows that the second log gets, between 0 and 1, in whole episodes, as far as they leave enough to
        fit. A single episode is cut, and its end is the second log. Independent rows are drawn one by one.

    random_state : int, RandomState or None, default=None
        Draws the episodes.

    Returns
    -------
    fit, test : Bunch
        Copies of `log` with a part of the rows each.

    Raises
    ------
    ValueError
        If `test_size` is not between 0 and 1, or leaves one of them empty.
    """
    if not 0 < test_size < 1:
        raise ValueError(f"test_size must lie between 0 and 1, such as 0.3; it is {test_size}.")
    n_rows = len(log.data)
    groups = np.arange(n_rows) if log.get("groups") is None else np.asarray(log.groups)
    names, sizes = np.unique(groups, return_counts=True)
    if len(names) == 1:
        n_fitted = max(n_rows - round(test_size * n_rows), min(FEWEST_ROWS, n_rows))
        chosen = np.arange(n_rows) >= n_fitted
    else:
        drawn = drawn_episodes(sizes, test_size, check_random_state(random_state), stacklevel=3)
        chosen = np.isin(groups, names[drawn])
    if chosen.all() or not chosen.any():
        raise ValueError(
            f"test_size={test_size} of {len(names)} episodes and {n_rows} rows leaves one side empty: whole episodes "
            f"are set aside, and at least {FEWEST_ROWS} rows stay to be fitted. Choose another value, such as 0.3, or "
            "measure longer."
        )
    return tuple(
        Bunch(
            **{
                **log,
                **{
                    name: log[name][rows]
                    for name in ("data", "target", "groups")
                    if log.get(name) is not None
                },
            }
        )
        for rows in (~chosen, chosen)
    )
