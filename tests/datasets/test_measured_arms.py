"""The measured logs of arms, a quadruped and a brachiating robot: what is returned are the originals' numbers."""

import gzip
import io
import pickle
import shutil
import sqlite3
import sys
import zipfile

import numpy as np
import pandas as pd
import pytest

from skat.datasets import (
    fetch_ball_drops,
    fetch_double_pendulum,
    fetch_go2_air,
    fetch_ricmonk,
    fetch_so101,
    fetch_ur10,
)
from skat.datasets.originals import original_files, verified
from skat.datasets.runs import Run, transitions
from skat.torch_arrays import read_torch_arrays


def check(bunch, *, rows, joints, commands, dt):
    assert bunch.data.shape == (rows, 2 * joints + commands)
    assert bunch.target.shape == (rows, 2 * joints) == (rows, len(bunch.target_names))
    assert bunch.feature_names[: 2 * joints] == bunch.target_names
    assert set(bunch.units) == set(bunch.feature_names)
    assert bunch.dt == pytest.approx(dt, rel=0.05)
    assert len(np.unique(bunch.groups)) == len(bunch.group_names)
    inside = bunch.groups[1:] == bunch.groups[:-1]
    np.testing.assert_array_equal(bunch.data[1:, : 2 * joints][inside], bunch.target[:-1][inside])
    measured = [name not in bunch.hidden for name in bunch.feature_names]
    assert np.isfinite(bunch.data[:, measured]).all()
    assert "Licence" in bunch.DESCR


def test_double_pendulum(measured_data):
    arm = fetch_double_pendulum("143339", download_if_missing=False)
    check(arm, rows=len(arm.data), joints=2, commands=2, dt=0.002)
    table = pd.read_csv(measured_data / "double_pendulum" / "143339.csv.gz")
    gap = np.diff(table["time"]) > 1.5 * 0.002000093460083008
    columns = ["pos_meas1", "pos_meas2", "vel_meas1", "vel_meas2", "tau_con1", "tau_con2"]
    np.testing.assert_array_equal(arm.data, table[columns][:-1][~gap])
    assert len(fetch_double_pendulum(download_if_missing=False).files) == 5


def test_so101(measured_data):
    arm = fetch_so101("multisine", download_if_missing=False)
    check(arm, rows=5999, joints=6, commands=6, dt=0.02)
    assert arm.data[0, 2] == 0.6097573631845423
    assert arm.data[1, -1] == pytest.approx(0.785398 + 2.336233 * 0.057269, abs=1e-5)
    # The gripper's speed is the change of its place, as of any joint: the files have its place as a share of its range.
    chirp = fetch_so101("chirp_sweep", download_if_missing=False)
    moved, told = np.diff(chirp.data[:, 5]) / chirp.dt, (chirp.data[1:, 11] + chirp.data[:-1, 11]) / 2
    assert np.std(moved) == pytest.approx(np.std(told), rel=0.1)
    assert arm.facts["torque"]["multisine"].shape == (6000, 6)
    with pytest.raises(ValueError, match=r"There is no motion 'dance'. There are: backlash_detection, "):
        fetch_so101("dance")


def test_go2_is_read_without_torch(measured_data):
    dog = fetch_go2_air(download_if_missing=False)
    check(dog, rows=4697, joints=12, commands=12, dt=0.005)
    assert dog.hidden == [name for name in dog.target_names if name.startswith("qvel.")]
    with zipfile.ZipFile(dog.files[0]) as archive:
        raw = np.frombuffer(archive.read("traj_0/data/1"), "<f4").reshape(-1, 12)
    np.testing.assert_array_equal(dog.data[:, :12], raw[:-1])


def test_ur10(measured_data):
    pytest.importorskip("rosbags")
    arm = fetch_ur10(download_if_missing=False)
    check(arm, rows=3440, joints=6, commands=6, dt=0.008)
    assert arm.feature_names[0] == "qpos.shoulder_pan_joint"
    assert arm.units["ctrl.elbow_joint"] == "A"
    with sqlite3.connect(arm.files[0]) as bag:
        ((first,),) = bag.execute("SELECT data FROM messages LIMIT 1").fetchall()
    assert arm.data[0, 0].tobytes() in bytes(first)


def test_ricmonk(measured_data):
    monkey = fetch_ricmonk(None, download_if_missing=False)
    check(monkey, rows=len(monkey.data), joints=3, commands=2, dt=0.006)
    assert len(monkey.group_names) == 10
    assert np.abs(monkey.data[:, -2:]).max() <= 3
    assert {path.name.partition(".")[2] for path in monkey.files} == {"csv.gz", "urdf"}


@pytest.mark.parametrize(
    "fetch", [fetch_double_pendulum, fetch_so101, fetch_go2_air, fetch_ur10, fetch_ricmonk]
)
def test_without_network_a_missing_file_is_said(fetch, tmp_path, monkeypatch):
    monkeypatch.delenv("SKAT_DATA_HOME", raising=False)
    with pytest.raises(OSError, match="are not on this machine"):
        fetch(data_home=tmp_path, download_if_missing=False)


def test_compressed_copies_are_verified_by_what_is_in_them(measured_data, tmp_path):
    from skat.datasets.double_pendulum import SOURCE

    folder = tmp_path / "double_pendulum"
    folder.mkdir()
    copy = folder / "143747.csv.gz"
    content = gzip.decompress((measured_data / "double_pendulum" / copy.name).read_bytes())
    copy.write_bytes(gzip.compress(content, compresslevel=1))  # other bytes, the same content
    found = original_files(SOURCE, ["143747.csv"], home=tmp_path, download_if_missing=False)
    assert found["143747.csv"].read_bytes()[:2] == b"\x1f\x8b"
    copy.write_bytes(gzip.compress(content[:-1]))
    with pytest.raises(ValueError, match="is not the original"):
        verified(copy, SOURCE.hashes["143747.csv"])
    copy.write_bytes(gzip.compress(content)[:1000])
    with pytest.raises(ValueError, match="is not the original"):
        verified(copy, SOURCE.hashes["143747.csv"])


def test_a_gap_in_time_begins_another_episode():
    time = np.r_[0.0:1.0:0.1, 5.0:6.0:0.1]
    states = np.arange(40.0).reshape(20, 2)
    bunch = transitions(
        {"a": Run(time, states, states[:, :1])}, joints=["j"], commanded=["j"], command_unit="N m"
    )
    np.testing.assert_array_equal(np.bincount(bunch.groups), [9, 9])
    assert bunch.group_names == ["a", "a, from 5 s"]
    assert not (bunch.target[:, 0] == states[10, 0]).any()


class Malicious:
    def __reduce__(self):
        return print, ("harm",)


def written(path, program, **members):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a/data.pkl", program)
        for name, content in members.items():
            archive.writestr(f"a/{name}", content)
    return path


def test_torch_files_that_ask_for_more_than_tensors_are_refused(tmp_path, capsys):
    with pytest.raises(ValueError, match=r"asks for builtins\.print, which no tensor needs"):
        read_torch_arrays(written(tmp_path / "a.pt", pickle.dumps({"x": Malicious()})))
    assert capsys.readouterr().out == ""
    with pytest.raises(ValueError, match="holds a dict; expected a dictionary of tensors"):
        read_torch_arrays(written(tmp_path / "b.pt", pickle.dumps({"x": 1})))
    with pytest.raises(ValueError, match="in another order"):
        read_torch_arrays(written(tmp_path / "c.pt", pickle.dumps({}), byteorder="big"))
    (tmp_path / "d.pt").write_bytes(b"no zip")
    with pytest.raises(ValueError, match="not a PyTorch file"):
        read_torch_arrays(tmp_path / "d.pt")


def test_torch_files_that_are_cut_short_are_refused(measured_data, tmp_path):
    original = measured_data / "go2_air" / "traj_0.pt"
    with zipfile.ZipFile(original) as source:
        members = {name: source.read(name) for name in source.namelist()}
    members["traj_0/data/1"] = members["traj_0/data/1"][:-4]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    (tmp_path / "cut.pt").write_bytes(buffer.getvalue())
    with pytest.raises(ValueError, match="cut short or damaged"):
        read_torch_arrays(tmp_path / "cut.pt")
    shutil.copy(original, tmp_path / "half.pt")
    (tmp_path / "half.pt").write_bytes(original.read_bytes()[:100_000])
    with pytest.raises(ValueError, match="not a PyTorch file"):
        read_torch_arrays(tmp_path / "half.pt")


@pytest.mark.parametrize(
    ("module", "fetch", "extra"),
    [("rosbags.typesys", fetch_ur10, "ros"), ("openpyxl", fetch_ball_drops, "excel")],
)
def test_a_missing_library_is_named_with_the_line_that_installs_it(
    measured_data, tmp_path, monkeypatch, module, fetch, extra
):
    monkeypatch.setitem(sys.modules, module, None)
    # Without the tidied copy, which needs no library.
    shutil.copytree(
        measured_data / "ball_drops", tmp_path / "ball_drops", ignore=shutil.ignore_patterns("*.csv")
    )
    shutil.copytree(measured_data / "ur10_bag", tmp_path / "ur10_bag")
    monkeypatch.setenv("SKAT_DATA_HOME", str(tmp_path))
    with pytest.raises(ImportError, match=rf'python -m pip install "skat\[{extra}\]"'):
        fetch(download_if_missing=False)
