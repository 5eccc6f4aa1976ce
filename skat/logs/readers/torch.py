"""Arrays by name in a PyTorch file, by an allow-list: no pickle of it is loaded, nor is PyTorch needed."""

import zipfile
from pathlib import Path

from skat.logs.errors import LogError
from skat.logs.readers.arrays import arrays_recording
from skat.logs.streams import Recording
from skat.torch_arrays import read_torch_arrays


def is_torch(path: Path) -> bool:
    """Whether a zip archive is what ``torch.save`` writes."""
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name.endswith("data.pkl") for name in archive.namelist())
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):
        return False


def read(path: Path) -> Recording:
    """Return the recording of a dictionary of tensors.

    Raises
    ------
    LogError
        If it is damaged, or holds anything but tensors by name.
    """
    try:
        arrays = read_torch_arrays(path)
    except (ValueError, OSError, RuntimeError, MemoryError) as error:
        raise LogError(
            str(path),
            f"is a PyTorch file that is not read: {error}",
            "Save a dictionary of tensors, torch.save({'time': ..., 'qpos': ...}, path), or arrays by numpy.savez.",
        ) from None
    if not arrays:
        raise LogError(str(path), "holds no tensors.", "Save a tensor for each kind of column.")
    return arrays_recording(arrays, str(path))
