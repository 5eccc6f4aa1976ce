"""Minari data sets on disk: observations and actions, which are matched by the model's degrees of freedom."""

from pathlib import Path

import numpy as np

from skat.logs.errors import LogError
from skat.logs.streams import Recording, Stream, required


def read(path: Path) -> Recording:
    """Return the recording of a Minari data set.

    The action of an episode's last row, which has none, is the one before it.

    Raises
    ------
    LogError
        If it is damaged.
    """
    minari = required("minari", "A Minari data set")
    folder = path / "data" if (path / "data").is_dir() else path
    try:
        data = minari.MinariDataset(folder)
        episodes = [_flat(episode) for episode in data.iterate_episodes()]
    except LogError:
        raise
    except ImportError as error:
        raise ImportError(f'{path}: {error}. Install what reads it: pip install "skat[minari]"') from error
    except Exception as error:  # noqa: BLE001 - of a damaged file Minari raises what its libraries raise
        raise LogError(
            str(path), f"is no Minari data set, or damaged: {type(error).__name__} {str(error)[:150]}.", "Copy it anew."
        ) from None
    if not episodes:
        raise LogError(str(path), "has no episodes.", "Record some.")
    try:
        arrays = {name: np.concatenate([episode[name] for episode in episodes]) for name in episodes[0]}
    except (KeyError, ValueError) as error:
        raise LogError(str(path), f"has episodes of different columns: {error}.", "Copy it anew.") from None
    numbers = [np.full(len(next(iter(episode.values()))), str(place), object) for place, episode in enumerate(episodes)]
    arrays["episode"] = np.concatenate(numbers)
    return Recording(
        str(path),
        (Stream("", tuple(arrays), lambda names: {name: arrays[name] for name in names}),),
        notes=(f"Minari, {len(episodes)} episodes",),
    )


def _flat(episode):
    n_rows = len(episode.rewards) + 1
    found: dict[str, np.ndarray] = {}
    _flatten("observations", episode.observations, n_rows, found)
    _flatten("actions", episode.actions, n_rows, found)
    if isinstance(getattr(episode, "infos", None), dict):
        _flatten("infos", episode.infos, n_rows, found)
    return found


def _flatten(name, value, n_rows, found):
    if isinstance(value, dict):
        for key, inner in value.items():
            _flatten(f"{name}.{key}", inner, n_rows, found)
        return
    if isinstance(value, tuple):
        for key, inner in enumerate(value):
            _flatten(f"{name}.{key}", inner, n_rows, found)
        return
    array = np.asarray(value)
    if array.dtype.kind not in "fiub" or array.ndim == 0 or len(array) not in (n_rows, n_rows - 1) or not len(array):
        return
    array = array.astype(float)
    if len(array) == n_rows - 1:
        array = np.concatenate([array, array[-1:]])
    if array.ndim == 1:
        found[name] = array
        return
    array = array.reshape(len(array), -1)
    found |= {f"{name}[{element}]": array[:, element] for element in range(array.shape[1])}

