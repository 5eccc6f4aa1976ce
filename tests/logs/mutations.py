"""Valid logs, damaged at random, and what reading them may end in."""

import gzip
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd

from skat.logs import LogError, load_log
from skat.simulators import MujocoSimulator
from tests.logs import formats

KINDS = (
    "csv",
    "lists",
    "gzip",
    "parquet",
    "npz",
    "hdf5",
    "mcap_json",
    "mcap_ros2",
    "rosbag1",
    "rosbag2_sqlite3",
    "rosbag2_mcap",
    "lerobot",
    "minari",
    "mcap_protobuf",
    "minari_arrow",
    "hdf5_episodes",
    "parquet_lists",
    "tables",
    "bag_files",
    "memory",
)
# What a reader may raise of a damaged file.
ALLOWED = (LogError, FileNotFoundError)


def arm():
    """Return the simulator that the logs are of."""
    return MujocoSimulator(formats.ARM)


def seed(kind, folder):
    """Write a valid log of a kind, as short as may be; return its path."""
    folder = Path(folder)
    if kind in ("csv", "gzip", "lists"):
        path = formats.documented(folder / "log.csv")
        if kind == "lists":
            t, q, v, u = formats.table("clean")
            lists = {
                name: [str(row.tolist()) for row in values]
                for name, values in zip(("q", "dq", "u"), (q, v, u))
            }
            pd.DataFrame({"time": t} | lists).to_csv(path, index=False)
        if kind == "gzip":
            packed = folder / "log.csv.gz"
            packed.write_bytes(gzip.compress(path.read_bytes(), mtime=0))
            path = packed
        return path
    if kind in ("mcap_protobuf", "minari_arrow"):
        return getattr(formats, kind)(folder, "clean")[0]
    if kind in ("hdf5_episodes", "parquet_lists", "tables"):
        return getattr(formats, kind)(folder)[0]
    if kind == "bag_files":
        bag = formats.write("rosbag2_sqlite3", "clean", folder)[0]
        (bag / "metadata.yaml").unlink()
        return bag
    if kind == "memory":
        return formats.write("npz", "clean", folder)[0]
    if kind == "mcap_ros2":
        bag = formats.write("rosbag2_mcap", "clean", folder)[0]
        return shutil.copy(next(bag.glob("*.mcap")), folder / "log.mcap")
    return formats.write(kind, "clean", folder)[0]


def damaged(path, folder, rng):
    """Copy a log into a folder with one of its files damaged; return the copy and what was done."""
    path, target = Path(path), Path(folder) / Path(path).name
    if target.exists():
        shutil.rmtree(target) if target.is_dir() else target.unlink()
    if path.is_dir():
        shutil.copytree(path, target)
        files = sorted(file for file in target.rglob("*") if file.is_file())
        victim = files[int(rng.integers(len(files)))]
    else:
        shutil.copy(path, target)
        victim = target
    how = _damage(victim, rng)
    return target, f"{victim.name}: {how}"


def _damage(victim, rng):
    """Damage a file; of a packed one, whose check sum hides what is inside, half of the time what is inside."""
    inside = rng.random() < 0.5
    if inside and victim.suffix == ".gz":
        content, how = mutated(gzip.decompress(victim.read_bytes()), rng)
        victim.write_bytes(gzip.compress(content, mtime=0))
        return f"inside, {how}"
    if inside and victim.suffix == ".npz":
        with zipfile.ZipFile(victim) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        name = sorted(members)[int(rng.integers(len(members)))]
        members[name], how = mutated(members[name], rng)
        with zipfile.ZipFile(victim, "w") as archive:
            for member, content in members.items():
                archive.writestr(member, content)
        return f"inside {name}, {how}"
    content, how = mutated(victim.read_bytes(), rng)
    victim.write_bytes(content)
    return how


def _source(path, kind):
    """Return the log: the path, or, of the kind "memory", what is in the file as a mapping of arrays."""
    if kind != "memory":
        return path
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except Exception:
        return path
    return arrays if len(arrays) != 3 else pd.DataFrame({"time": np.arange(30.0)})


def mutated(content, rng):
    """Return bytes that differ in one of nine ways, and which."""
    data = bytearray(content)
    size = len(data)
    # Where formats keep their tables is at both ends: half of the damage goes there.
    near_an_end = rng.random() < 0.5
    place = int(rng.integers(min(size, 256))) if near_an_end else int(rng.integers(size))
    if near_an_end and rng.random() < 0.5:
        place = size - 1 - place
    length = int(min(size - place, 1 + rng.integers(64)))
    way = int(rng.integers(9))
    if way == 0:
        data[place] ^= 1 << int(rng.integers(8))
    elif way == 1:
        data[place : place + length] = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
    elif way == 2:
        del data[place:]
    elif way == 3:
        del data[place : place + length]
    elif way == 4:
        data[place:place] = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
    elif way == 5:
        data[place : place + length] = bytes([(0, 255, 128, 127)[int(rng.integers(4))]]) * length
    elif way == 6:
        data[place:place] = data[place : place + length]
    elif way == 7:
        words = (
            b"nan",
            b"-1",
            b"1e999",
            b"99999999999999999999",
            b'"',
            b"\n",
            b",",
            b"[",
            b"\xff\xfe",
            b"{}",
            b"null",
        )
        word = words[int(rng.integers(len(words)))]
        data[place : place + len(word)] = word
    else:
        other = int(rng.integers(size))
        data[place : place + length], data[other : other + length] = (
            data[other : other + length],
            data[place : place + length],
        )
    return bytes(data), f"way {way} at {place} of {size}"


def outcome(path, simulator, kind=""):
    """Return "read" or the error that a damaged log ends in; raise what it must not."""
    try:
        log = load_log(_source(path, kind), simulator, units="rad")
    except ALLOWED as error:
        return type(error).__name__ if str(error) else "no message"
    n_states = len(log.simulator.state_names)
    assert np.isfinite(log.X[:, n_states:]).all()
    assert not np.isinf(log.X).any()
    return "read"
