# ruff: noqa: E501 - a log a line
"""Logs that cannot be read as they are: each message has the place and the remedy, and the remedy works."""

import gzip
import json
import pickle
import shutil
import zipfile

import numpy as np
import pandas as pd
import pytest

from skat.logs import LogError, load_log, read_map
from skat.simulators import MujocoSimulator
from tests.logs import formats

pytest.importorskip("pyarrow")
pytest.importorskip("rosbags")
pytest.importorskip("mcap")


@pytest.fixture(scope="module")
def arm():
    return MujocoSimulator(formats.ARM)


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    return pd.read_csv(formats.documented(tmp_path_factory.mktemp("frame") / "log.csv"))


def csv(folder, frame, **options):
    frame.to_csv(folder / "log.csv", index=False, **options)
    return folder / "log.csv"


def text(folder, content, name="log.csv"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def with_cell(frame, row, column, value):
    changed = frame.copy().astype({column: object})
    changed.loc[row, column] = value
    return changed


def cut(path, share=0.5):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    return path


def written(kind, folder):
    return formats.write(kind, "clean", folder)[0]


def bag_without(folder, what):
    """A bag with a topic of texts alone, or of another message."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = {"text": "std_msgs/msg/String", "twist": "geometry_msgs/msg/Vector3"}[what]
    message = store.types[kind](**({"data": "hello"} if what == "text" else {"x": 1.0, "y": 2.0, "z": 3.0}))
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/chat", kind, typestore=store)
        for row in range(30):
            writer.write(connection, row * 10**7, store.serialize_cdr(message, kind))
    return folder / "bag"


def bag_of_nothing(folder):
    """A bag in which a message has lost its content."""
    import sqlite3

    path = written("rosbag2_sqlite3", folder)
    with sqlite3.connect(next(path.glob("*.db3"))) as database:
        database.executescript(
            "CREATE TABLE lax AS SELECT * FROM messages; DROP TABLE messages; ALTER TABLE lax RENAME TO messages;"
            "UPDATE messages SET data = NULL WHERE id = 9"
        )
    database.close()
    return path


def lerobot_with(folder, change):
    path = formats.lerobot(folder, "clean")[0]
    change(path)
    return path


def with_info(path, **changes):
    info = path / "meta" / "info.json"
    info.write_text(json.dumps(json.loads(info.read_text()) | changes))


def npz(folder, **arrays):
    np.savez(folder / "log.npz", **arrays)
    return folder / "log.npz"


def degrees(frame):
    return frame.assign(**{name: np.rad2deg(frame[name]) for name in frame if name != "time"})


# name: (make the source, what the message says of place, and of the remedy)
BAD = {
    "an empty file": (lambda d, f: text(d, ""), "log.csv", "CSV table"),
    "names without rows": (lambda d, f: csv(d, f.head(0)), "log.csv: has no rows", "at least 20"),
    "one row": (lambda d, f: csv(d, f.head(1)), "log.csv: holds 1 rows", "at least 20"),
    "too few rows": (lambda d, f: csv(d, f.head(15)), "14 transitions", "Record longer"),
    "no first line": (lambda d, f: csv(d, f, header=False), "line 1: holds numbers", "first line with a name"),
    "semicolons": (lambda d, f: csv(d, f, sep=";", decimal=","), "line 1: has a single", "commas between columns"),
    "tabs": (lambda d, f: csv(d, f, sep="\t"), "line 1: has a single", "another mark than commas"),
    "more values than names": (lambda d, f: text(d, "a,b\n1,2,3\n4,5,6\n"), "log.csv", "as many values"),
    "zero bytes": (lambda d, f: text(d, b"\0" * 50), "log.csv: is in no format", "rosbag2"),
    "UTF-16": (lambda d, f: csv(d, f, encoding="utf-16"), "UTF-16", "CSV in UTF-8"),
    "two columns of a name": (lambda d, f: text(d, "time,q,q\n" + "1,2,3\n" * 30), "line 1: names two columns 'q'", "another name"),
    "too few joints": (lambda d, f: text(d, "time,q\n" + "1,2\n" * 30), "no column could be found", "Say which is which"),
    "text in numbers": (
        lambda d, f: csv(d, with_cell(f, 5, "qpos.elbow", "fast")),
        "line 7, column qpos.elbow: expected a number for qpos.elbow, got 'fast'",
        "Correct the cell",
    ),
    "an infinite number": (lambda d, f: csv(d, with_cell(f, 5, "qvel.elbow", "inf")), "line 7, column qvel.elbow", "Correct the cell"),
    "a column of NaN": (lambda d, f: csv(d, f.assign(**{"qvel.elbow": np.nan})), "column qvel.elbow: is taken for", "--map qvel.elbow=-"),
    "commands of NaN": (lambda d, f: csv(d, f.assign(**{"ctrl.elbow": np.nan})), "column ctrl.elbow", "--map ctrl.elbow=0"),
    "reversed time": (lambda d, f: csv(d, f.iloc[::-1]), "column time: time does not grow", "Sort the rows"),
    "two rows exchanged": (
        lambda d, f: csv(d, f.iloc[[0, 1, 2, 4, 3, *range(5, len(f))]]),
        "line 6: time goes back by 0.01 s",
        "Sort the rows",
    ),
    "a standing clock": (lambda d, f: csv(d, f.assign(time=1.0)), "column time: time does not grow", "which column is the time"),
    "no times": (lambda d, f: csv(d, f.drop(columns="time")), "has no column of times", "--rate"),
    "empty times": (lambda d, f: csv(d, f.assign(time=np.nan)), "column time: holds no times", "--map time=- --rate 1000"),
    "times that are words": (lambda d, f: csv(d, f.assign(time="noon")), "column time: holds no times", "ISO 8601"),
    "another robot's log": (
        lambda d, f: csv(d, f[["time"]].assign(lift=f["qpos.elbow"], boom=1.0)),
        "no column could be found for the model's positions",
        "another robot",
    ),
    "no commands": (lambda d, f: csv(d, f.drop(columns=["ctrl.elbow", "ctrl.shoulder"])), "ctrl.shoulder, ctrl.elbow", "--map 'ctrl.*=0'"),
    "no commands but torques": (
        lambda d, f: csv(d, f.rename(columns={"ctrl.elbow": "tau_2", "ctrl.shoulder": "tau_1"})),
        "could be commands: tau_*",
        "--map 'ctrl.*=tau_*'",
    ),
    "one command missing": (lambda d, f: csv(d, f.drop(columns="ctrl.elbow")), "for ctrl.elbow", "--map ctrl.elbow=0"),
    "all in degrees": (lambda d, f: csv(d, degrees(f)), "look like degrees", "--map '*=:deg'"),
    "an episode that comes back": (
        lambda d, f: csv(d, f.assign(episode=[1] * 50 + [2] * 50 + [1] * (len(f) - 100))),
        "line 102, column episode: episode 1 goes on",
        "--episodes gaps",
    ),
    "an episode without a name": (
        lambda d, f: csv(d, with_cell(f.assign(episode="a"), 9, "episode", "")),
        "line 11, column episode: is empty",
        "--episodes gaps",
    ),
    "two clocks for a channel": (
        lambda d, f: csv(d, f.rename(columns={"qpos.elbow": "elbow_pos"}).assign(elbow_angle=f["qpos.elbow"])),
        "several columns that may be qpos.elbow: elbow_pos, elbow_angle",
        "--map qpos.elbow=elbow_pos",
    ),
    "a ragged list": (
        lambda d, f: text(
            d,
            'time,positions,command\n0,"[1, 2]","[0, 0]"\n1,"[1]","[0, 0]"\n'
            + "".join(f'{row},"[1, 2]","[0, 0]"\n' for row in range(2, 40)),
        ),
        "line 3, column positions: expected a list of 2 numbers, got '[1]'",
        "Remove the row",
    ),
    "a truncated gzip": (lambda d, f: cut(text(d, gzip.compress(csv(d, f).read_bytes()), "log.csv.gz")), "log.csv.gz", "Copy the file anew"),
    "a truncated Parquet": (lambda d, f: cut(written("parquet", d)), "log.parquet", "Copy the file anew"),
    "an empty Parquet": (lambda d, f: (f.head(0).to_parquet(d / "log.parquet"), d / "log.parquet")[1], "has no rows", "at least 20"),
    "a truncated NPZ": (lambda d, f: cut(written("npz", d)), "log.npz", "Copy the file anew"),
    "a pickle in an NPZ": (lambda d, f: npz(d, q=np.array([{}, 1], dtype=object)), "holds Python objects", "numpy.savez"),
    "an NPZ without arrays": (lambda d, f: npz(d), "log.npz: holds no arrays", "an array for each column"),
    "an NPZ of nothing known": (lambda d, f: npz(d, image=np.zeros((50, 3))), "no column could be found", "Say which is which"),
    "an NPZ in a zip of texts": (
        lambda d, f: (zipfile.ZipFile(d / "log.npz", "w").writestr("a.txt", "hello"), d / "log.npz")[1],
        "log.npz",
        "Copy the file anew",
    ),
    "a single array": (lambda d, f: (np.save(d / "log.npy", np.zeros((50, 4))), d / "log.npy")[1], "no names for its columns", "Copy"),
    "a pickle": (lambda d, f: text(d, pickle.dumps({"q": [1.0]}), "log.pkl"), "is a pickle", "Write it as"),
    "a truncated HDF5": (lambda d, f: cut(written("hdf5", d)), "log.h5", "Copy the file anew"),
    "a truncated MCAP": (lambda d, f: cut(written("mcap_json", d)), "log.mcap", "mcap recover"),
    "a truncated bag": (lambda d, f: (cut(next(written("rosbag2_sqlite3", d).glob("*.db3"))), d / "bag_sqlite3")[1], "bag_sqlite3", "Copy the bag anew"),
    "a truncated ROS 1 bag": (lambda d, f: cut(written("rosbag1", d)), "log.bag", "Copy the bag anew"),
    "a bag of which a message is empty": (lambda d, f: bag_of_nothing(d), "a message without content", "Copy the bag anew"),
    "a bag of texts": (lambda d, f: bag_without(d, "text"), "no topic with messages that hold numbers", "/joint_states"),
    "a bag of another message": (lambda d, f: bag_without(d, "twist"), "no column could be found", "Say which is which"),
    "a LeRobot without meta": (lambda d, f: lerobot_with(d, lambda p: shutil.rmtree(p / "meta")), "no meta/info.json", "Copy the folder meta"),
    "a LeRobot with a broken meta": (
        lambda d, f: lerobot_with(d, lambda p: (p / "meta" / "info.json").write_text("{")),
        "info.json: is no description",
        "codebase_version",
    ),
    "a LeRobot without data": (lambda d, f: lerobot_with(d, lambda p: shutil.rmtree(p / "data")), "no data/*/*.parquet", "git lfs pull"),
    "a LeRobot of version 1": (lambda d, f: lerobot_with(d, lambda p: with_info(p, codebase_version="v1.6")), "'v1.6'", "Convert it"),
    "an unknown folder": (lambda d, f: ((d / "log").mkdir(), text(d / "log", "x", "notes.txt"), d / "log")[2], "it holds notes.txt", "rosbag2"),
    "a folder with nothing": (lambda d, f: ((d / "log").mkdir(), d / "log")[1], "it holds nothing", "LeRobot"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_bad_log_is_told_with_its_place_and_remedy_and_the_remedy_works(name, tmp_path, frame, arm):
    make, place, remedy = BAD[name]
    source = make(tmp_path, frame)
    with pytest.raises(LogError) as caught:
        load_log(source, arm)
    message = str(caught.value)
    assert str(source) in message
    assert place in message
    assert remedy in message
    if caught.value.options:
        log = load_log(source, arm, **caught.value.options)
        assert len(log) >= 20


def test_there_are_at_least_forty_bad_logs():
    assert len(BAD) >= 40


@pytest.mark.parametrize(
    ("options", "place", "remedy"),
    [
        (
            {"columns": {"qpos.elbow": "q9"}},
            "column 'q9': was told for qpos.elbow and is not there",
            "It has",
        ),
        ({"columns": {"qpos.wrist": "q9"}}, "columns['qpos.wrist']: is no input", "qpos.elbow"),
        ({"columns": {"qpos.elbow": "qpos.elbow:furlong"}}, "the unit 'furlong' is unknown", "rad, deg"),
        (
            {"columns": {"qpos.elbow": "qpos.elbow:mm"}},
            "'mm' does not measure what the model has in rad",
            "Check",
        ),
        ({"columns": {"qpos.elbow": "qpos.elbow:ticks"}}, "lacks its number", "ticks:4096"),
        ({"columns": {"ctrl.elbow": "ctrl.elbow:A"}}, "lacks its number", "torque constant"),
        ({"columns": {"qpos.*": "time"}}, "is one column, and qpos.* means 2 inputs", "put *"),
        ({"episodes": "run"}, "column 'run': was told to tell episodes apart", "--episodes gaps"),
        ({"base": "fixed"}, "the model has no free root", "Leave base out"),
        ({"rate": 1e9}, "has 100 rows per second; a rate of 1e+09", "--rate 100"),
        ({"units": {"time": "deg"}}, "column time: has the unit 'deg'", "time=:s"),
    ],
)
def test_a_bad_option_is_told_with_its_place_and_remedy(options, place, remedy, tmp_path, frame, arm):
    with pytest.raises(LogError) as caught:
        load_log(csv(tmp_path, frame), arm, **options)
    assert place in str(caught.value)
    assert remedy in str(caught.value)


@pytest.mark.parametrize("units", [["deg"], {"qpos.*": 3}, 3])
def test_units_that_are_no_texts_are_told_with_what_is_expected(units, frame, arm):
    with pytest.raises(TypeError, match='units must be a unit such as "deg", or a mapping'):
        load_log(frame, arm, units=units)


def test_a_missing_file_and_another_kind_of_source_are_told(tmp_path, arm):
    with pytest.raises(FileNotFoundError, match=r"There is no log .*nowhere\.csv"):
        load_log(tmp_path / "nowhere.csv", arm)
    with pytest.raises(TypeError, match="a log is a path, a data frame, or a mapping"):
        load_log(7, arm)
    with pytest.raises(FileNotFoundError, match=r"expected a map\.toml"):
        load_log(tmp_path, arm, columns=tmp_path / "map.toml")


def test_a_bad_map_is_told(tmp_path):
    with pytest.raises(LogError, match="has no '='"):
        read_map(["qpos.elbow"])
    with pytest.raises(LogError, match="is no TOML"):
        read_map(path=text(tmp_path, "qpos = ", "map.toml"))
    with pytest.raises(LogError, match="has no text for time"):
        read_map(path=text(tmp_path, "[columns]\ntime = [1]", "map.toml"))
    with pytest.raises(LogError, match=r"columns = 3 where a table was expected.*\[columns\]"):
        read_map(path=text(tmp_path, "columns = 3", "map.toml"))


def test_no_pickle_is_ever_run(tmp_path, arm):
    class Trap:
        def __reduce__(self):
            return (tmp_path / "sprung").touch, ()

    for name in ("log.pkl", "log.npz", "log.csv", "log.npy", "log.pt"):
        text(tmp_path, pickle.dumps(Trap()), name)
        with pytest.raises(LogError):
            load_log(tmp_path / name, arm)
    np.savez(tmp_path / "inside.npz", q=np.array([Trap()] * 30, dtype=object))
    with pytest.raises(LogError):
        load_log(tmp_path / "inside.npz", arm)
    (tmp_path / "sprung").unlink(missing_ok=True)  # writing it has run it, if anything has
    with pytest.raises(LogError):
        load_log(tmp_path / "inside.npz", arm)
    assert not (tmp_path / "sprung").exists()
