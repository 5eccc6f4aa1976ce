"""Tables of rows: checks of their columns, and what came before a row in its episode."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def checked_columns(table: Any, names: Sequence[str], argument: str) -> Array:
    """Return a table as a finite float array with the expected columns.

    Parameters
    ----------
    table : array-like of shape (n_rows, n_columns) or data frame
        A data frame's columns are matched by name and may stand in any order.
    names : sequence of str
        The columns expected.
    argument : str
        How the caller names the table, for messages.

    Raises
    ------
    ValueError
        If the shape or the names differ, or a value is not finite; the message names the columns.
    """
    if hasattr(table, "columns") and hasattr(table, "to_numpy"):
        missing = [name for name in names if name not in set(table.columns)]
        if missing:
            raise ValueError(
                f"{argument} lacks the columns {', '.join(missing)}; expected {', '.join(names)}"
            )
        table = table[list(names)].to_numpy()
    refuse_text(table, argument)
    try:
        array = np.asarray(table, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{argument} must hold numbers, with the columns {', '.join(names)}: {error}"
        ) from None
    if array.ndim != 2 or array.shape[1] != len(names):
        raise ValueError(
            f"{argument} must have the shape (n_rows, {len(names)}), with the columns {', '.join(names)}; "
            f"got an array of shape {array.shape}"
        )
    bad = ~np.isfinite(array)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise ValueError(
            f"{argument} holds {bad.sum()} values that are not finite, the first in row {row}, column "
            f"{names[column]!r}; remove or fill these rows"
        )
    return array


def refuse_text(table: Any, argument: str) -> None:
    """Raise if a table holds texts, which numpy would take for the numbers that they spell.

    Parameters
    ----------
    table : array-like or data frame
    argument : str
        How the caller names the table, for the message.

    Raises
    ------
    ValueError
        With the first text and its place.
    """
    array = np.asarray(table)
    if array.dtype.kind not in "OSUT":
        return
    for place, value in np.ndenumerate(array):
        if isinstance(value, str | bytes):
            where = ", ".join(f"{axis} {index}" for axis, index in zip(("row", "column"), place))
            raise ValueError(
                f"{argument} holds the text {value!r} in {where}; every value must be a number. Convert it where the "
                "table is read, such as by table.astype(float)"
            )


def episode_starts(groups: ArrayLike | None, n_rows: int) -> NDArray[np.intp]:
    """Return for each row the index of the first row of its episode."""
    if groups is None:
        return np.zeros(n_rows, dtype=np.intp)
    labels = np.asarray(groups)
    if labels.shape != (n_rows,):
        raise ValueError(
            f"groups must hold one label for each of the {n_rows} rows; got the shape {labels.shape}"
        )
    first = np.r_[True, labels[1:] != labels[:-1]]
    return np.maximum.accumulate(np.where(first, np.arange(n_rows), 0))


def earlier_rows(actions: Array, starts: NDArray[np.intp], n_lags: int) -> Array:
    """Return the actions 1, 2, ... rows before each row; before an episode's start its first action."""
    rows = np.arange(len(actions))[:, None] - np.arange(1, n_lags + 1)
    earlier: Array = actions[np.maximum(rows, starts[:, None])]
    return earlier
