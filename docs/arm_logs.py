"""Write README's arm, and its log in every shape that the tutorial and the how-to pages read.

    python docs/arm_logs.py FOLDER

``robot.xml``, and of one motion: ``log.csv`` as documented, ``bag`` (rosbag2), ``run.mcap`` (JSON), ``lerobot``
(positions in degrees, no velocities), ``positions.csv``; ``june.csv`` and ``july.csv``, between which the forearm
became heavier. The formats' own libraries write them: ``pip install "skat[ros,parquet]"``.
"""

import json
import runpy
import sys
from pathlib import Path

import numpy as np

README = runpy.run_path(str(Path(__file__).with_name("readme.py")))
JOINTS = ["shoulder", "elbow"]
PAUSE = 5.0  # s between two episodes, in recordings that go on meanwhile
HEAVIER = 1.25  # the forearm of July over that of June


def write(folder, kinds=("csv", "bag", "mcap", "lerobot", "positions", "months"), **log):
    """Write the files of these kinds; `log` goes to `measured` of README's arm."""
    folder = Path(folder)
    README["write_files"](folder, **log)
    table = README["measured"](**log)
    writers = {
        "csv": lambda folder, table: None,
        "bag": write_bag,
        "mcap": write_mcap,
        "lerobot": write_lerobot,
        "positions": write_positions,
        "months": lambda folder, table: write_months(folder, **log),
    }
    for kind in kinds:
        writers[kind](folder, table)


def by_row(table):
    """Yield (stamp in ns, positions, velocities, commands); a pause is between episodes."""
    length = table.groupby("episode")["time"].max().max() + PAUSE
    names = [f"{kind}.{joint}" for kind in ("qpos", "qvel", "ctrl") for joint in JOINTS]
    for time, episode, *values in table[["time", "episode", *names]].itertuples(index=False):
        stamp = 1_700_000_000_000_000_000 + round(1e9 * (time + length * episode))
        yield stamp, *(np.array(values[k : k + 2]) for k in (0, 2, 4))


def write_bag(folder, table):
    """Write a rosbag2 with a JointState and the commands as an array."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    JointState, Array = types["sensor_msgs/msg/JointState"], types["std_msgs/msg/Float64MultiArray"]
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        joints = writer.add_connection("/joint_states", JointState.__msgtype__, typestore=store)
        commands = writer.add_connection("/commands", Array.__msgtype__, typestore=store)
        for stamp, q, v, u in by_row(table):
            time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
            header = types["std_msgs/msg/Header"](stamp=time, frame_id="")
            state = JointState(header, JOINTS, q, v, np.zeros(0))
            writer.write(joints, stamp, store.serialize_cdr(state, JointState.__msgtype__))
            command = Array(layout=types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0), data=u)
            writer.write(commands, stamp, store.serialize_cdr(command, Array.__msgtype__))


def write_mcap(folder, table):
    """Write an MCAP file of JSON messages under names of our own."""
    from mcap.writer import Writer

    with (folder / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("arm", "jsonschema", b'{"type": "object"}')
        state, wanted = (writer.register_channel(topic, "json", schema) for topic in ("/arm", "/wanted"))
        for stamp, q, v, u in by_row(table):
            arm = {"name": JOINTS, "position": q.tolist(), "velocity": v.tolist()}
            for channel, message in ((state, arm), (wanted, {"position": u.tolist()})):
                writer.add_message(channel, stamp, json.dumps(message).encode(), stamp)
        writer.finish()


def write_lerobot(folder, table):
    """Write a LeRobot data set of version 3, as a follower arm records it."""
    import pyarrow
    import pyarrow.parquet

    place = folder / "lerobot" / "data" / "chunk-000"
    place.mkdir(parents=True)
    (folder / "lerobot" / "meta").mkdir()
    names = [f"{joint}.pos" for joint in JOINTS]
    features = {
        key: {"dtype": "float32", "shape": [2], "names": names} for key in ("observation.state", "action")
    }
    features |= {
        key: {"dtype": kind, "shape": [1], "names": None}
        for key, kind in (("timestamp", "float32"), ("frame_index", "int64"), ("episode_index", "int64"))
    }
    info = {
        "codebase_version": "v3.0",
        "robot_type": "arm",
        "fps": round(1 / README["STEP"]),
        "total_episodes": table["episode"].nunique(),
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "features": features,
    }
    (folder / "lerobot" / "meta" / "info.json").write_text(json.dumps(info), "utf-8")
    degrees = {
        key: np.rad2deg(table[[f"{kind}.{joint}" for joint in JOINTS]]).to_numpy(np.float32)
        for key, kind in (("observation.state", "qpos"), ("action", "ctrl"))
    }
    columns = {key: list(values) for key, values in degrees.items()}
    columns |= {
        "timestamp": table["time"].to_numpy(np.float32),
        "frame_index": table.groupby("episode").cumcount().to_numpy(),
        "episode_index": table["episode"].to_numpy(),
    }
    pyarrow.parquet.write_table(pyarrow.table(columns), place / "file-000.parquet")


def write_positions(folder, table):
    """Write a CSV without velocities."""
    table.drop(columns=[f"qvel.{joint}" for joint in JOINTS]).to_csv(folder / "positions.csv", index=False)


def write_months(folder, **log):
    """Write two logs of different motions; in the second the forearm is heavier."""
    README["measured"](**log).to_csv(folder / "june.csv", index=False)
    README["measured"](seed=1, forearm=HEAVIER, **log).to_csv(folder / "july.csv", index=False)


if __name__ == "__main__":
    write(sys.argv[1])
