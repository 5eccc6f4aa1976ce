import collections
import io
import os
import pickle

import numpy as np
import pytest

from skat.torch_arrays import read_torch_array


class _Global:
    """Pickles as the bare name of something, imported or not."""

    def __init__(self, module, name):
        self.line = f"c{module}\n{name}\n".encode()


class _Call:
    def __init__(self, function, *arguments):
        self.function, self.arguments = function, arguments


class _Stored:
    def __init__(self, *reference):
        self.reference = reference


class _Writer(pickle._Pickler):
    """A writer that can name what is not installed, as `torch.save` would have written it."""

    def save(self, obj, save_persistent_id=True):
        if isinstance(obj, _Global):
            self.write(obj.line)
        elif isinstance(obj, _Call):
            self.save(obj.function)
            self.save(obj.arguments)
            self.write(pickle.REDUCE)
        elif isinstance(obj, _Stored):
            self.save(obj.reference)
            self.write(pickle.BINPERSID)
        else:
            super().save(obj, save_persistent_id)


def legacy_file(
    path, values, *, shape, strides, offset=0, storage="DoubleStorage", rebuild=None, content=None
):
    stored = _Stored("storage", _Global("torch", storage), "7", "cpu", len(values), None)
    hooks = _Call(_Global("collections", "OrderedDict"))
    tensor = _Call(
        rebuild or _Global("torch._utils", "_rebuild_tensor_v2"), stored, offset, shape, strides, False, hooks
    )
    buffer = io.BytesIO()
    system = {
        "protocol_version": 1001,
        "little_endian": True,
        "type_sizes": {"short": 2, "int": 4, "long": 4},
    }
    for part in (0x1950A86A20F9469CFC6C, 1001, system, tensor, ["7"]):
        _Writer(buffer, protocol=2).dump(part)
    buffer.write(len(values).to_bytes(8, "little"))
    buffer.write(values.tobytes() if content is None else content)
    path.write_bytes(buffer.getvalue())
    return path


@pytest.mark.parametrize(
    ("storage", "dtype"), [("DoubleStorage", "<f8"), ("FloatStorage", "<f4"), ("LongStorage", "<i8")]
)
def test_reads_what_was_written(tmp_path, storage, dtype):
    values = np.arange(12, dtype=dtype)
    path = legacy_file(tmp_path / "a.pt", values, shape=(3, 4), strides=(4, 1), storage=storage)
    assert np.array_equal(read_torch_array(path), values.reshape(3, 4))


def test_offset_and_strides_are_those_of_the_tensor(tmp_path):
    values = np.arange(12.0)
    path = legacy_file(tmp_path / "a.pt", values, shape=(4, 2), strides=(1, 4), offset=4)
    assert np.array_equal(read_torch_array(path), values.reshape(3, 4)[1:].T)


def test_a_file_that_names_another_function_is_refused_and_nothing_runs(tmp_path):
    flag = tmp_path / "ran"
    payload = io.BytesIO()
    for part in (0x1950A86A20F9469CFC6C, 1001, {"little_endian": True}):
        _Writer(payload, protocol=2).dump(part)
    _Writer(payload, protocol=2).dump(_Call(_Global(os.system.__module__, "system"), f"touch {flag}"))
    path = tmp_path / "a.pt"
    path.write_bytes(payload.getvalue())
    with pytest.raises(ValueError, match=r"asks for posix.system, which no tensor needs"):
        read_torch_array(path)
    assert not flag.exists()


def test_a_known_name_in_place_of_the_tensor_is_refused(tmp_path):
    path = legacy_file(
        tmp_path / "a.pt",
        np.arange(4.0),
        shape=(2, 2),
        strides=(2, 1),
        rebuild=_Global("collections", "OrderedDict"),
    )
    with pytest.raises(ValueError, match="not a legacy PyTorch file of one tensor"):
        read_torch_array(path)


@pytest.mark.parametrize(
    ("shape", "strides", "offset"), [((3, 4), (5, 1), 0), ((3, 4), (4, 1), 1), ((2,), (-1,), 3)]
)
def test_a_tensor_outside_its_storage_is_refused(tmp_path, shape, strides, offset):
    path = legacy_file(tmp_path / "a.pt", np.arange(12.0), shape=shape, strides=strides, offset=offset)
    with pytest.raises(ValueError, match="does not fit into its storage of 12 values"):
        read_torch_array(path)


def test_a_file_cut_short_is_refused(tmp_path):
    path = legacy_file(tmp_path / "a.pt", np.arange(4.0), shape=(4,), strides=(1,), content=b"\0" * 24)
    with pytest.raises(ValueError, match="24 bytes of values, expected 32"):
        read_torch_array(path)


@pytest.mark.parametrize("content", [b"", b"not a pickle", pickle.dumps(collections.OrderedDict())])
def test_another_file_is_refused(tmp_path, content):
    (tmp_path / "a.pt").write_bytes(content)
    with pytest.raises(ValueError, match="not a legacy PyTorch file"):
        read_torch_array(tmp_path / "a.pt")
