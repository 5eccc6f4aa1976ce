"""NPZ and NPY, without pickles."""

import zipfile
from pathlib import Path

import numpy as np

from skat.logs.errors import LogError
from skat.logs.readers.arrays import arrays_recording
from skat.logs.streams import MOST_BYTES, Recording


def read(path: Path) -> Recording:
    """Return the recording of an NPZ file.

    Raises
    ------
    LogError
        If it is damaged, holds Python objects (a pickle), or its arrays are no columns of one length.
    """
    try:
        arrays = _arrays(path)
    except Exception as error:  # of a damaged header NumPy raises what zipfile, zlib, tokenize and ast raise
        if "allow_pickle" in str(error):
            raise LogError(
                str(path),
                "holds Python objects, a pickle, which can run any program when it is loaded.",
                "Save arrays of numbers (numpy.savez), none of dtype=object.",
            ) from None
        told = str(error) or type(error).__name__
        raise LogError(str(path), f"is cut or damaged: {told}.", "Copy the file anew.") from None
    if not arrays:
        raise LogError(str(path), "holds no arrays.", "Save an array for each column (numpy.savez).")
    return arrays_recording(arrays, str(path))


def _arrays(path: Path) -> dict[str, np.ndarray]:
    with path.open("rb") as file:
        if file.read(6) == b"\x93NUMPY":
            raise ValueError("a single .npy array has no names for its columns; save an .npz")
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            _check_size(archive, entry)
    with np.load(path, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files if isinstance(stored[name], np.ndarray)}


def _check_size(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> None:
    """Raise where a header announces more numbers than the file holds: a damaged one could ask for all memory."""
    with archive.open(entry) as member:
        version = np.lib.format.read_magic(member)
        header = (
            np.lib.format.read_array_header_1_0(member)
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0(member)
        )
        shape, _, dtype = header
        announced = int(np.prod([int(size) for size in shape], dtype=object)) * max(dtype.itemsize, 1)
        if min(shape, default=0) < 0 or announced > entry.file_size:
            raise ValueError(f"{entry.filename} announces {announced} bytes and holds {entry.file_size}")
        if entry.file_size > MOST_BYTES and entry.file_size > 200 * max(entry.compress_size, 1):
            raise ValueError(
                f"{entry.filename} unpacks to {entry.file_size} bytes from {entry.compress_size}"
            )
