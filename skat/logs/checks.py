"""What can be said of a log before it is diagnosed: how each channel moves, and where a command is at its limit."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

# A command this close to its limit, as a share of the range, is at it.
AT_LIMIT = 1e-6
# Runs that stand for a long log.
RUNS = 6


def channel_table(log: Any) -> pd.DataFrame:
    """Return how each of a simulator's channels stands in a log.

    Returns: A row for each input of the simulator: name, column (the log's), unit (of the log; "" is the simulator's
    own), measured (share of rows), lowest, highest, spread (standard deviation; simulator's unit), at limit (share of
    the rows in which a command is at an end of its range, or a position beyond its joint's), remark.
    """
    matches = {match.name: match for match in log.matches}
    limits = log.simulator.command_limits
    rows = []
    for column, name in enumerate(log.simulator.input_names):
        values = log.X[:, column]
        seen = values[np.isfinite(values)]
        match = matches.get(name)
        saturated = float("nan")
        if name in limits and len(seen):
            low, high = limits[name]
            room = AT_LIMIT * (high - low)
            saturated = float(np.mean((seen <= low + room) | (seen >= high - room)))
        rows.append(
            {
                "name": name,
                "column": match.theirs if match else "",
                "unit": (match.unit if match else "") or log.simulator.units.get(name, ""),
                "measured": len(seen) / max(len(values), 1),
                "lowest": seen.min() if len(seen) else float("nan"),
                "highest": seen.max() if len(seen) else float("nan"),
                "spread": seen.std() if len(seen) else float("nan"),
                "at limit": saturated,
                "remark": _remark(seen, saturated),
            }
        )
    return pd.DataFrame(rows)


def _remark(seen: NDArray[np.float64], saturated: float) -> str:
    if not len(seen):
        return "not measured"
    if np.ptp(seen) == 0:
        return "does not move: it tells nothing"
    if saturated > 0.1:
        return "often at its limit"
    return ""


def rows_of(log: Any, most: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of a log that were measured as a whole, and their episodes.

    `most`: of a longer log only so many rows, in `RUNS` runs from all over it. None means all. Returns `X` (n_rows,
    n_inputs). Returns `groups` (n_rows,).
    """
    whole = log.rows(np.isfinite(log.X).all(axis=1))
    if most is not None and len(whole) > most:
        starts = np.linspace(0, len(whole) - most // RUNS, RUNS).astype(int)
        whole = whole.rows(np.unique(np.add.outer(starts, np.arange(most // RUNS))))
    return whole.X, whole.groups
