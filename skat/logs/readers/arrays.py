"""Arrays by name, as in memory, NPZ and PyTorch: those of one length are columns, and what is left out is told."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from skat.logs.errors import LogError
from skat.logs.names import reading
from skat.logs.streams import MOST_COLUMNS, Recording, Stream, as_numbers, plain_array

# Arrays with these, by their names, say how many instants a log has.
STATES = {"qpos", "qvel", "state"}
MOST_NAMES = 6


@dataclass(frozen=True)
class Rows:
    """How many rows a log of several arrays has.

    Attributes
    ----------
    size : int
        Of most arrays; those of states go before.
    held : tuple of str
        Commands that lack the last row, where no transition starts: n actions of a rollout with n + 1 states.
    left_out : mapping from name to str
        What each array has that is left out, such as "199 rows, the others 200".
    """

    size: int
    held: tuple[str, ...]
    left_out: Mapping[str, str]

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done, a sentence each."""
        held = (
            [f"{_has(list(self.held))} a row less than states: the last command is held."]
            if self.held
            else []
        )
        return (*held, *notes_of(self.left_out))


def common_rows(lengths: Mapping[str, int]) -> Rows:
    """Return how many rows arrays of these lengths have together."""
    sizes = list(lengths.values())
    size = max(set(sizes), key=lambda one: (sizes.count(one), one))
    kinds = {name: reading(name).kind for name in lengths}

    def of_states(n: int) -> bool:
        return any(kinds[name] in STATES for name in lengths if lengths[name] == n)

    if of_states(size + 1) and not of_states(size):
        size += 1
    held = tuple(name for name, n in lengths.items() if n == size - 1 > 0 and kinds[name] == "ctrl")
    left_out = {
        name: f"{n} rows, the others {size}" for name, n in lengths.items() if n != size and name not in held
    }
    return Rows(size, held, left_out)


def notes_of(left_out: Mapping[str, str]) -> tuple[str, ...]:
    """Return a sentence for all arrays that are left out for the same reason."""
    names: dict[str, list[str]] = {}
    for name, why in left_out.items():
        names.setdefault(why, []).append(name)
    return tuple(f"{_has(own)} {why}: left out." for why, own in names.items())


def _has(names: list[str]) -> str:
    more = f", ... ({len(names)} in all)" if len(names) > MOST_NAMES else ""
    return f"{', '.join(names[:MOST_NAMES])}{more} {'has' if len(names) == 1 else 'have'}"


def too_wide(width: int) -> str:
    """Return why an array of so many numbers in a row is left out; "" where it is not."""
    return f"{width} numbers in a row, more than {MOST_COLUMNS}" if width > MOST_COLUMNS else ""


def with_last_held(values: np.ndarray) -> np.ndarray:
    """Return an array with its last row once more."""
    return np.concatenate([values, values[-1:]])


def arrays_recording(arrays: Mapping[str, Any], source: str) -> Recording:
    """Return the recording of arrays in memory; one of shape (n, k) is k columns.

    Raises
    ------
    LogError
        If there are no rows.
    """
    plain = {str(name): plain_array(values) for name, values in arrays.items()}
    wide = {
        name: array.reshape(len(array), int(np.prod(array.shape[1:]))) if array.ndim > 2 else array
        for name, array in plain.items()
    }
    left_out = {name: "no rows" for name, array in wide.items() if array.ndim == 0}
    left_out |= {
        name: why for name, array in wide.items() if array.ndim == 2 and (why := too_wide(array.shape[1]))
    }
    kept = {name: array for name, array in wide.items() if name not in left_out}
    if not any(array.ndim == 1 or array.shape[1] for array in kept.values()):
        raise LogError(
            source, "holds no array with rows.", "A log has an array for each column, or (rows, columns)."
        )
    rows = common_rows({name: len(array) for name, array in kept.items()})
    if rows.size == 0:
        raise LogError(source, "has no rows.", "Record a log with at least 20 rows.")
    columns: dict[str, np.ndarray] = {}
    for name, array in kept.items():
        if name in rows.left_out:
            continue
        whole = with_last_held(array) if name in rows.held else array
        columns |= (
            {name: whole}
            if whole.ndim == 1
            else {f"{name}[{element}]": whole[:, element] for element in range(whole.shape[1])}
        )
    stream = Stream("", tuple(columns), lambda names: {name: as_numbers(columns[name]) for name in names})
    return Recording(
        source, (stream,), notes=(*rows.notes, *notes_of(left_out)), left_out={**rows.left_out, **left_out}
    )
