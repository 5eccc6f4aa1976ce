"""Read arrays from PyTorch files, without PyTorch and without running what a file asks for."""

import collections
import io
import math
import pickle
import zipfile
from os import PathLike
from typing import Any, ClassVar

import numpy as np

_MAGIC_NUMBER = 0x1950A86A20F9469CFC6C
_PROTOCOL = 1001
_STORAGES = {
    "DoubleStorage": np.dtype("<f8"),
    "FloatStorage": np.dtype("<f4"),
    "LongStorage": np.dtype("<i8"),
}


def read_torch_array(path: str | PathLike[str]) -> np.ndarray:
    """Return the array that ``torch.save(tensor, path)`` wrote in the format before PyTorch 1.6.

    A pickle may name any function for the reader to call. This reader knows three names, those that a
    tensor needs, and stops at any other.

    Parameters
    ----------
    path : str or Path
        A file with one dense tensor on the CPU.

    Returns
    -------
    ndarray
        The tensor's values.

    Raises
    ------
    ValueError
        If the file is not such a file, is cut short, or asks for anything but the rebuilding of a tensor.

    References
    ----------
    .. [1] The format as ``torch.serialization`` writes it with ``_use_new_zipfile_serialization=False``:
       four pickles (magic number, protocol, system, the object), the keys of the storages, and the bytes of
       each storage after their number of elements.
    """
    with open(path, "rb") as file:
        try:
            magic, protocol, system = (_TensorUnpickler(file).load() for _ in range(3))
            if (magic, protocol) != (_MAGIC_NUMBER, _PROTOCOL) or not system["little_endian"]:
                raise ValueError(
                    f"{path} is not a legacy PyTorch file: it begins with {magic!r}, {protocol!r}."
                )
            tensor = _TensorUnpickler(file).load()
            keys = _TensorUnpickler(file).load()
        except (pickle.UnpicklingError, EOFError, IndexError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{path} is not a legacy PyTorch file of one tensor: {error}") from error
        if not isinstance(tensor, _Tensor) or keys != [tensor.storage.key]:
            raise ValueError(
                f"{path} holds {type(tensor).__name__} and storages {keys}; expected one tensor."
            )
        count = int.from_bytes(file.read(8), "little")
        content = file.read()
    storage = tensor.storage
    if count != storage.size or len(content) != count * storage.dtype.itemsize:
        raise ValueError(
            f"{path} is cut short or damaged: {len(content)} bytes of values, "
            f"expected {storage.size * storage.dtype.itemsize}."
        )
    return tensor.of(np.frombuffer(content, dtype=storage.dtype))


def read_torch_arrays(path: str | PathLike[str]) -> dict[str, np.ndarray]:
    """Return the arrays that ``torch.save({name: tensor, ...}, path)`` wrote in the format since PyTorch 1.6.

    The names that may be read are those of `read_torch_array`: what a tensor needs, and nothing else.

    Parameters
    ----------
    path : str or Path
        A file with a dictionary of dense tensors on the CPU.

    Returns
    -------
    dict of str to ndarray

    Raises
    ------
    ValueError
        If the file is not such a file, is damaged, or asks for anything but the rebuilding of tensors.

    References
    ----------
    .. [1] The format of ``torch.serialization``: a zip archive without compression with, in one folder, ``data.pkl``,
       ``byteorder``, and the bytes of each storage as ``data/<key>``.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            (program,) = (
                name for name in archive.namelist() if name.count("/") == 1 and name.endswith("/data.pkl")
            )
            folder = program.removesuffix("data.pkl")
            found = _TensorUnpickler(io.BytesIO(archive.read(program))).load()
            order = (
                archive.read(folder + "byteorder")
                if folder + "byteorder" in archive.namelist()
                else b"little"
            )
            if order != b"little":
                raise ValueError(f"{path} has its bytes in another order: {order!r}.")
            if not isinstance(found, dict) or not all(isinstance(one, _Tensor) for one in found.values()):
                raise ValueError(f"{path} holds a {type(found).__name__}; expected a dictionary of tensors.")
            return {
                str(name): tensor.of(_stored(archive, folder, tensor.storage, path))
                for name, tensor in found.items()
            }
    except (
        zipfile.BadZipFile,
        pickle.UnpicklingError,
        *(EOFError, IndexError, KeyError, TypeError, AttributeError, OverflowError, NotImplementedError),
    ) as error:
        raise ValueError(f"{path} is not a PyTorch file of tensors by name: {error}") from error


def _stored(
    archive: zipfile.ZipFile, folder: str, storage: "_Storage", path: str | PathLike[str]
) -> np.ndarray:
    content = archive.read(f"{folder}data/{storage.key}")
    if len(content) != storage.size * storage.dtype.itemsize:
        raise ValueError(
            f"{path} is cut short or damaged: {len(content)} bytes of values, "
            f"expected {storage.size * storage.dtype.itemsize}."
        )
    return np.frombuffer(content, dtype=storage.dtype)


class _Storage:
    def __init__(self, dtype: np.dtype, key: str, size: int) -> None:
        self.dtype, self.key, self.size = dtype, key, size


class _Tensor:
    """What a pickled tensor says of itself: where in its storage its elements lie."""

    def __init__(
        self, storage: _Storage, offset: int, shape: tuple[int, ...], strides: tuple[int, ...], *_: Any
    ) -> None:
        if not isinstance(storage, _Storage):
            raise pickle.UnpicklingError("a tensor without a storage")
        self.storage, self.offset, self.shape, self.strides = storage, offset, shape, strides

    def of(self, values: np.ndarray) -> np.ndarray:
        last = self.offset + sum((n - 1) * stride for n, stride in zip(self.shape, self.strides, strict=True))
        too_many = math.prod(self.shape) > len(
            values
        )  # of one value, shown often, any size could be asked for
        if min((*self.strides, self.offset, *self.shape)) < 0 or last >= max(len(values), 1) or too_many:
            raise ValueError(
                f"A tensor of shape {self.shape} does not fit into its storage of {len(values)} values."
            )
        strides = [stride * values.itemsize for stride in self.strides]
        return np.lib.stride_tricks.as_strided(values[self.offset :], self.shape, strides).copy()


class _TensorUnpickler(pickle.Unpickler):
    _ALLOWED: ClassVar[dict[tuple[str, str], Any]] = {
        ("torch._utils", "_rebuild_tensor_v2"): _Tensor,
        ("collections", "OrderedDict"): collections.OrderedDict,
        **{("torch", name): dtype for name, dtype in _STORAGES.items()},
    }

    def find_class(self, module: str, name: str) -> Any:
        try:
            return self._ALLOWED[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}, which no tensor needs") from None

    def persistent_load(self, reference: Any) -> _Storage:
        kind, dtype, key, location, size, *view = reference  # of a view only the older format tells
        if (
            kind != "storage"
            or location != "cpu"
            or view not in ([], [None])
            or not isinstance(dtype, np.dtype)
        ):
            raise pickle.UnpicklingError(f"storage {reference!r} is not a dense one on the CPU")
        return _Storage(dtype, key, size)
