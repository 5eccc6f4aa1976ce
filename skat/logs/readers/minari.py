"""Minari data sets on disk: observations and actions, which are matched by the model's degrees of freedom."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from skat.logs.errors import LogError
from skat.logs.streams import MOST_BYTES, Recording, Stream, required


def read(path: Path) -> Recording:
    """Return the recording of a Minari data set.

    The action of an episode's last row, which has none, is the one before it.

    Raises
    ------
    LogError
        If it is damaged.
    """
    folder = path / "data" if (path / "data").is_dir() else path
    try:
        metadata = json.loads((folder / "metadata.json").read_text(encoding="utf-8"))
        stored = str(metadata.get("data_format", "hdf5"))
    except (OSError, ValueError, AttributeError, RecursionError) as error:
        raise _damaged(folder / "metadata.json", error) from None
    try:
        episodes = (
            _from_hdf5(folder / "main_data.hdf5") if stored == "hdf5" else _from_minari(folder, metadata)
        )
    except (LogError, ImportError):
        raise
    except Exception as error:
        raise _damaged(path, error) from None
    if not episodes or not episodes[0]:
        raise LogError(str(path), "has no episodes.", "Record some.")
    try:
        arrays = {name: np.concatenate([episode[name] for episode in episodes]) for name in episodes[0]}
    except (KeyError, ValueError) as error:
        raise LogError(str(path), f"has episodes of different columns: {error}.", "Copy it anew.") from None
    numbers = [
        np.full(len(next(iter(episode.values()))), str(place), object)
        for place, episode in enumerate(episodes)
    ]
    arrays["episode"] = np.concatenate(numbers)
    return Recording(
        str(path),
        (Stream("", tuple(arrays), lambda names: {name: arrays[name] for name in names}),),
        notes=(f"Minari, {len(episodes)} episodes",),
    )


def _damaged(path: Path, error: Exception) -> LogError:
    told = f"{type(error).__name__} {str(error)[:150]}".strip()
    return LogError(str(path), f"is no Minari data set, or damaged: {told}.", "Copy it anew.")


def _from_hdf5(path: Path) -> list[dict[str, np.ndarray]]:
    """Return the episodes in a file, without Minari, which would import what the data set names as its environment."""
    h5py = required("h5py", "A Minari data set in HDF5")
    episodes = []
    with h5py.File(path, "r") as file:
        names = sorted(
            (name for name in file if name.startswith("episode_")), key=lambda name: (len(name), name)
        )
        for name in names:
            group = file[name]
            n_rows = len(group["rewards"]) + 1
            found: dict[str, np.ndarray] = {}
            for part in ("observations", "actions", "infos"):
                if part in group:
                    _flatten(part, _plain(h5py, group, part), n_rows, found)
            episodes.append(found)
    return episodes


def _plain(h5py: ModuleType, group: Any, name: str) -> Any:
    """Return a data set's numbers, or a mapping of those in a group; links to other files are passed over."""
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        return {}
    item = group[name]
    if isinstance(item, h5py.Group):
        return {key: _plain(h5py, item, key) for key in item}
    whole = item.dtype.kind in "fiub" and item.nbytes <= max(MOST_BYTES, 200 * item.id.get_storage_size())
    return item[()] if whole else {}


def _from_minari(folder: Path, metadata: Mapping[str, Any]) -> list[dict[str, np.ndarray]]:
    """Return the episodes of a data set in Minari's other format.

    Where a description lacks its spaces Minari makes the environment that it names, which can be any program.
    """
    if not ("observation_space" in metadata and "action_space" in metadata):
        raise LogError(
            str(folder / "metadata.json"),
            "lacks observation_space or action_space; to find them out a program that the data set names would be run.",
            "Write the data set anew in Minari's format hdf5, or with its spaces.",
        )
    minari = required("minari", "A Minari data set in Arrow")
    _check_arrow(folder)
    return [_flat(episode) for episode in minari.MinariDataset(folder).iterate_episodes()]


def _check_arrow(folder: Path) -> None:
    """Raise where a table is damaged: Arrow ends the process where it works with offsets that lead out of a buffer."""
    dataset = required("pyarrow.dataset", "A Minari data set in Arrow")
    for file in sorted(folder.rglob("*.arrow")):
        for batch in dataset.dataset(file, format="arrow").to_batches():
            batch.validate(full=True)


def _flat(episode: Any) -> dict[str, np.ndarray]:
    n_rows = len(episode.rewards) + 1
    found: dict[str, np.ndarray] = {}
    _flatten("observations", episode.observations, n_rows, found)
    _flatten("actions", episode.actions, n_rows, found)
    if isinstance(getattr(episode, "infos", None), dict):
        _flatten("infos", episode.infos, n_rows, found)
    return found


def _flatten(name: str, value: Any, n_rows: int, found: dict[str, np.ndarray]) -> None:
    if isinstance(value, dict):
        for key, inner in value.items():
            _flatten(f"{name}.{key}", inner, n_rows, found)
        return
    if isinstance(value, tuple):
        for key, inner in enumerate(value):
            _flatten(f"{name}.{key}", inner, n_rows, found)
        return
    array = np.asarray(value)
    if (
        array.dtype.kind not in "fiub"
        or array.ndim == 0
        or len(array) not in (n_rows, n_rows - 1)
        or not len(array)
    ):
        return
    array = array.astype(float)
    if len(array) == n_rows - 1:
        array = np.concatenate([array, array[-1:]])
    if array.ndim == 1:
        found[name] = array
        return
    array = array.reshape(len(array), -1)
    found |= {f"{name}[{element}]": array[:, element] for element in range(array.shape[1])}
