"""Read any log as transitions of a simulator."""

from collections.abc import Mapping
from typing import Any, Literal

from skat.logs.log import Log
from skat.simulators import Simulator


def load_log(
    source: Any,
    simulator: Simulator,
    *,
    columns: Any = None,
    units: str | Mapping[str, str] | None = None,
    rate: float | None = None,
    topic: str | None = None,
    episodes: str | None = None,
    base: Literal["fixed", "free"] | None = None,
) -> Log:
    r"""Load a log as transitions of a simulator.

    Parameters
    ----------
    source : path, data frame, mapping from name to array, or sequence of these
        A file or folder that is recognised by what is in it: CSV (also compressed by gzip), Parquet, NPZ, HDF5,
        rosbag2 (SQLite or MCAP, a folder or a single file), ROS 1 bag, MCAP (ROS 2, JSON, protobuf), a LeRobot data
        set v2.1 or v3, a Minari data set. A data frame of pandas or polars; a mapping from names to arrays, of which
        one of shape (n, k) is k columns ``name[0]``, ... Several are joined, each its own episodes.

    simulator : Simulator
        With a state. Its inputs are what is looked for.

    columns : mapping from name to str, or path, default=None
        What is not found by its name: ``{"qpos.elbow": "q1:deg"}``, the simulator's name, then theirs (a column, an
        element ``observation.state[2]`` of a vector, a field ``/commands.position`` of a topic), and, after a colon,
        the unit. ``*`` stands for every joint: ``{"ctrl.*": "/commands.position"}``, ``{"qpos.*": "*_pos:deg"}``.
        Also ``time`` and ``episode``. A number is a constant: ``{"ctrl.*": "0"}``; "" (or ``-``) leaves a channel out, as not
        measured. A path is that of a ``map.toml``, as `write_map` writes it.

    units : str or mapping from name to str, default=None
        Units beside `columns`: ``{"qpos.*": "deg", "time": "ms"}``; one alone, such as ``"deg"``, is that of every
        angle, its rate and its command. See the user guide for the list.

    rate : float, default=None
        Rows per second of the log that is returned. None: that of the log. Where the file has no times, its rate.

    topic : str, default=None
        Of a bag, the topic that holds the state, where there are several.

    episodes : str, default=None
        Name of the column that tells episodes apart; ``"gaps"``: gaps in time alone do. None: a column ``episode``,
        or of that meaning, where there is one, and gaps in time.

    base : {"fixed", "free"}, default=None
        Of a model with a free root whose pose the log does not hold: whether the root is welded to the world, or
        moves unmeasured.

    Returns
    -------
    Log

    Raises
    ------
    LogError
        A ValueError with file, place and remedy: if the source is no log that can be read, or its columns cannot be
        matched.
    FileNotFoundError
        If there is no such file.
    ImportError
        If a library that reads this format is missing; with the line that installs it.
    TypeError
        If the source is none of these.
    """
    raise NotImplementedError
