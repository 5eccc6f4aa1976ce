"""Valid logs, damaged at random, and what reading them may end in."""

import csv
import gzip
import re
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
    "frame",
    "torch_tensors",
    "mcap_mixed",
    "lerobot_motors",
    "hdf5_groups",
)
# Beginnings that say which format a file is in, of others than its own.
HEADS = (
    *(
        b"PAR1",
        b"PK\x03\x04",
        b"\x89HDF\r\n\x1a\n",
        b"SQLite format 3\0",
        b"\x89MCAP0\r\n",
        b"#ROSBAG V2.0\n",
    ),
    *(b"\x93NUMPY\x01\0", b"\x80\x04", b"\xff\xfe", b"\x1f\x8b"),
)
WITHOUT_STATES = (
    *(
        "hdf5_episodes",
        "parquet_lists",
        "tables",
        "torch_tensors",
        "mcap_mixed",
        "lerobot_motors",
        "hdf5_groups",
    ),
)
# What a user says of a kind.
OPTIONS: dict[str, dict] = {
    "hdf5_groups": {"topic": "arm"},
    "mcap_mixed": {
        "columns": {
            f"{ours}.{joint}": f"/arm.joints[{place}].{theirs}"
            for ours, theirs in (("qpos", "position"), ("qvel", "velocity"))
            for place, joint in enumerate(formats.JOINTS)
        }
    },
}
# What a reader may raise of a damaged file.
ALLOWED = (LogError, FileNotFoundError)


def arm():
    """Return the simulator that the logs are of."""
    return MujocoSimulator(formats.ARM)


def seed(kind, folder):
    """Write a valid log of a kind, as short as may be; return its path."""
    folder = Path(folder)
    if kind in ("csv", "gzip", "lists", "frame"):
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
    if kind in WITHOUT_STATES:
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
    """Copy a log into a folder and damage it, one of its files or what is where; return the copy and what was done."""
    path, target = Path(path), Path(folder) / Path(path).name
    for old in Path(folder).glob(f"{target.stem}*"):
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    if path.is_dir():
        shutil.copytree(path, target)
    else:
        shutil.copy(path, target)
    files = sorted(file for file in target.rglob("*") if file.is_file()) or [target]
    victim = files[int(rng.integers(len(files)))]
    if rng.random() < 0.15:
        return _displaced(victim, target, rng)
    how = _damage(victim, rng)
    return target, f"{victim.name}: {how}"


def _displaced(victim, target, rng):
    """Lose a file, or let it be empty, doubled, called otherwise, or begin like another format."""
    way = ("lost", "empty", "doubled", "renamed", "headed")[int(rng.integers(5))]
    if victim == target and way in ("lost", "doubled"):
        way = "empty"
    endings = (".csv", ".parquet", ".npz", ".h5", ".db3", ".bag", ".mcap", ".pkl", ".txt", "")
    ending = endings[int(rng.integers(len(endings)))]
    if way == "lost":
        victim.unlink()
    elif way == "empty":
        victim.write_bytes(b"")
    elif way == "doubled":
        shutil.copy(victim, victim.with_name(f"again-{victim.name}"))
    elif way == "renamed":
        renamed = victim.rename(victim.with_name(f"{victim.name.partition('.')[0]}{ending}"))
        target = renamed if victim == target else target
    else:
        content = victim.read_bytes()
        head = HEADS[int(rng.integers(len(HEADS)))]
        victim.write_bytes(head + content[len(head) if rng.random() < 0.5 else 0 :])
    return target, f"{victim.name}: {way} {ending if way == 'renamed' else ''}".strip()


def _damage(victim, rng):
    """Damage a file; of a packed one, whose check sum hides what is inside, half of the time what is inside."""
    inside = rng.random() < 0.5
    if inside and victim.suffix == ".gz":
        content, how = mutated(gzip.decompress(victim.read_bytes()), rng)
        victim.write_bytes(gzip.compress(content, mtime=0))
        return f"inside, {how}"
    if inside and victim.suffix in (".npz", ".pt"):
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
    """Return the log: the path, or what is in the file as a mapping of arrays or as a data frame."""
    if kind not in ("memory", "frame"):
        return path
    try:
        if kind == "frame":
            with path.open(newline="") as file:
                names, *rows = csv.reader(file)
            return pd.DataFrame(rows, columns=names)
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except Exception:
        return path


def mutated(content, rng):
    """Return bytes that differ in one of eleven ways, and which."""
    data = bytearray(content)
    size = len(data)
    # Where formats keep their tables is at both ends: half of the damage goes there.
    near_an_end = rng.random() < 0.5
    place = int(rng.integers(max(min(size, 256) if near_an_end else size, 1)))
    if near_an_end and size and rng.random() < 0.5:
        place = size - 1 - place
    length = int(min(size - place, 1 + rng.integers(64)))
    way = int(rng.integers(11))
    if way == 0:
        data[place : place + 1] = bytes(
            byte ^ (1 << int(rng.integers(8))) for byte in data[place : place + 1]
        )
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
    elif way == 8:  # every byte of one value, such as all commas
        marks = b';\t| \n,\x00"[]{}:'
        other = marks[int(rng.integers(len(marks)))] if rng.random() < 0.7 else int(rng.integers(256))
        data = data.replace(bytes([data[place]]), bytes([other])) if size else data
    elif way == 9 and (digits := list(re.finditer(rb"\d+", content[: 1 << 16]))):
        chosen = digits[int(rng.integers(len(digits)))]
        data[chosen.start() : chosen.end()] = b"%d" % int(10 ** rng.uniform(0, 6))
    elif size:
        other = int(rng.integers(size))
        data[place : place + length], data[other : other + length] = (
            data[other : other + length],
            data[place : place + length],
        )
    return bytes(data), f"way {way} at {place} of {size}"


def outcome(path, simulator, kind=""):
    """Return "read" or the error that a damaged log ends in; raise what it must not."""
    try:
        log = load_log(_source(path, kind), simulator, units="rad", **OPTIONS.get(kind, {}))
    except ALLOWED as error:
        return type(error).__name__ if str(error) else "no message"
    n_states = len(log.simulator.state_names)
    assert np.isfinite(log.X[:, n_states:]).all()
    assert not np.isinf(log.X).any()
    return "read"
