"""Read ten million rows of CSV and Parquet, and a bag of 1 GiB: peak memory and time, beside the bare library.

    python benchmarks/large_logs.py [--rows 10000000] [--bag-mib 1024] [--only csv] [--output FILE]

Each is written and read in a process of its own; the peak is that of the reading process. The peer reads the same file
with nothing but the library underneath: pandas, pyarrow, or rosbags' iteration over the raw messages.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
LIMIT_GIB = 4.0
AT_ONCE = 250_000
NAMES = [f"{kind}.{joint}" for kind in ("qpos", "qvel", "ctrl") for joint in ("base", "shoulder", "elbow")]


def arm():
    """Return a simulator of three joints in a chain, with motors."""
    from skat.simulators import MujocoSimulator

    opened = "".join(
        f'<body pos="0 0 -0.3"><joint name="{joint}" axis="0 1 0"/><geom size="0.02" pos="0 0 -0.3" mass="1"/>'
        for joint in ("base", "shoulder", "elbow")
    )
    motors = "".join(f'<motor name="{joint}" joint="{joint}"/>' for joint in ("base", "shoulder", "elbow"))
    text = f"<worldbody>{opened}{'</body>' * 3}</worldbody><actuator>{motors}</actuator>"
    return MujocoSimulator(f'<mujoco><option timestep="0.002"/>{text}</mujoco>')


def columns(first, number):
    """Return rows of a log as a mapping from name to array."""
    t = 0.002 * np.arange(first, first + number)
    return {"time": t} | {name: np.sin((place + 1) * t) for place, name in enumerate(NAMES)}


def write_csv(path, rows, mib):
    """Write a CSV in pieces."""
    import pandas as pd

    for first in range(0, rows, AT_ONCE):
        piece = pd.DataFrame(columns(first, min(AT_ONCE, rows - first))).round(7)
        piece.to_csv(path, index=False, mode="a", header=first == 0)


def write_parquet(path, rows, mib):
    """Write a Parquet file in row groups."""
    import pyarrow
    import pyarrow.parquet

    writer = None
    for first in range(0, rows, AT_ONCE):
        table = pyarrow.table(columns(first, min(AT_ONCE, rows - first)))
        writer = writer or pyarrow.parquet.ParquetWriter(path, table.schema)
        writer.write_table(table)
    writer.close()


def write_bag(path, rows, mib):
    """Write a rosbag2 of joint states and commands, beside pictures that nobody asks for."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    Header, Time = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    JointState, Image = types["sensor_msgs/msg/JointState"], types["sensor_msgs/msg/Image"]
    picture = np.random.default_rng(0).integers(0, 256, 640 * 480 * 3, dtype=np.uint8)
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        links = [
            writer.add_connection(topic, JointState.__msgtype__, typestore=store)
            for topic in ("/joints", "/commands")
        ]
        camera = writer.add_connection("/camera", Image.__msgtype__, typestore=store)
        written, row = 0, 0
        while written < mib * 2**20:
            stamp = row * 2_000_000
            header = Header(stamp=Time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
            values = columns(row, 1)
            q, v, u = (np.array([values[name][0] for name in NAMES[i : i + 3]]) for i in (0, 3, 6))
            empty = np.zeros(0)
            for link, parts in zip(links, ((q, v, empty), (empty, empty, u))):
                message = JointState(header, ["base", "shoulder", "elbow"], *parts)
                data = store.serialize_cdr(message, JointState.__msgtype__)
                writer.write(link, stamp, data)
                written += len(data)
            if row % 15 == 0:
                image = Image(header, 480, 640, "rgb8", 0, 1920, picture)
                data = store.serialize_cdr(image, Image.__msgtype__)
                writer.write(camera, stamp, data)
                written += len(data)
            row += 1


def read_bare(kind, path):
    """Read with the library underneath alone."""
    if kind == "csv":
        import pandas as pd

        return len(pd.read_csv(path))
    if kind == "parquet":
        import pyarrow.parquet

        return len(pyarrow.parquet.read_table(path))
    from rosbags.rosbag2 import Reader

    with Reader(path) as reader:
        return sum(1 for _ in reader.messages())


WRITERS = {
    "csv": ("log.csv", write_csv),
    "parquet": ("log.parquet", write_parquet),
    "bag": ("bag", write_bag),
}


def child(kind, path, how):
    """Read and print rows, seconds and the peak of this process."""
    simulator = arm()
    before = time.perf_counter()
    if how == "bare":
        rows = read_bare(kind, path)
    else:
        from skat.logs import load_log

        options = {"columns": {"ctrl.*": "/commands.effort"}} if kind == "bag" else {}
        rows = len(load_log(path, simulator, units="rad", **options))
    spent = time.perf_counter() - before
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(json.dumps({"rows": rows, "s": spent, "gib": peak}))


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=10_000_000)
    parser.add_argument("--bag-mib", type=float, default=1024)
    parser.add_argument("--only", choices=list(WRITERS))
    parser.add_argument("--output", type=Path)
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        child(*options.child)
        return
    table = [
        "| log | size, MiB | reader | rows or messages | time, s | peak, GiB |",
        "|---|---|---|---|---|---|",
    ]
    failed = False
    for kind, (name, write) in WRITERS.items():
        if options.only not in (None, kind):
            continue
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, name)
            write(path, options.rows, options.bag_mib)
            files = path.rglob("*") if path.is_dir() else [path]
            size = sum(file.stat().st_size for file in files) / 2**20
            for how in ("bare", "skat"):
                command = [sys.executable, __file__, "--child", kind, str(path), how]
                said = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
                failed |= how == "skat" and said["gib"] > LIMIT_GIB
                table.append(
                    f"| {kind} | {size:.0f} | {how} | {said['rows']} | {said['s']:.1f} | {said['gib']:.2f} |"
                )
                print(table[-1], flush=True)
    print("\n".join(table))
    if options.output:
        options.output.write_text("\n".join(["# Large logs", "", *table, ""]))
    sys.exit(failed)


if __name__ == "__main__":
    main()
