"""Logs of a two-joint arm in ten formats and seven states, written by the formats' own libraries and without skat."""

import json
import zipfile
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd

ARM = """
<mujoco model="arm">
  <option timestep="0.001"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.5" range="-150 150" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="1"/>
      <body name="lower" pos="0 0 -0.4">
        <joint name="elbow" axis="0 1 0" damping="0.3" range="-150 150" limited="true"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="30"/>
    <position name="elbow" joint="elbow" kp="15"/>
  </actuator>
</mujoco>
"""
JOINTS = ("shoulder", "elbow")
RATE, ROWS = 100, 160
STATES = ("clean", "names", "degrees", "positions", "jitter", "lost", "gaps")
FORMATS = (
    "frame",
    "parquet",
    "npz",
    "hdf5",
    "rosbag2_sqlite3",
    "rosbag2_mcap",
    "rosbag1",
    "mcap_json",
    "lerobot",
    "minari",
)


@cache
def motion():
    """Return times, positions, velocities and commands of the arm, every ms; nobody may write to them."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    steps = ROWS * 1000 // RATE
    times, q, v, u = np.arange(steps) / 1000, np.empty((steps, 2)), np.empty((steps, 2)), np.empty((steps, 2))
    for step in range(steps):
        # Smooth commands: what jumps of held ones do between samples, no interpolation of samples can tell.
        time = times[step]
        data.ctrl[:] = 1.2 * np.sin(5 * time), 0.9 * np.sin(8 * time + 1)
        q[step], v[step], u[step] = data.qpos, data.qvel, data.ctrl
        mujoco.mj_step(model, data)
    return times, q, v, u


def table(state):
    """Return (time, q, v or None, u) of a state of the log, in the units and at the times of that state."""
    times, q, v, u = motion()
    rng = np.random.default_rng(0)
    rows = 10 * np.arange(ROWS)
    if state == "jitter":
        rows[1:-1] += rng.integers(-1, 2, size=ROWS - 2)
    kept = np.ones(ROWS, dtype=bool)
    if state == "lost":
        kept[rng.choice(np.arange(1, ROWS - 1), size=4, replace=False)] = False
    t, q, v, u = times[rows][kept], q[rows][kept], v[rows][kept], u[rows][kept]
    if state == "jitter":  # a command is written down with the row that it acts from
        u = motion()[3][10 * np.arange(ROWS)]
    if state == "gaps":
        t = t + 5.0 * (np.arange(len(t)) >= ROWS // 2)
    if state == "degrees":
        q, v, u = (np.rad2deg(values) for values in (q, v, u))
    return t, q, None if state == "positions" else v, u


def documented(path, state="clean"):
    """Write the documented CSV."""
    t, q, v, u = table(state)
    columns = {"time": t}
    groups = [("qpos", q), ("ctrl", u)] if v is None else [("qpos", q), ("qvel", v), ("ctrl", u)]
    for kind, values in groups:
        columns |= {f"{kind}.{joint}": values[:, place] for place, joint in enumerate(JOINTS)}
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def write(kind, state, folder):
    """Write a log; return (the source, what a user says of names and units)."""
    return WRITERS[kind](Path(folder), state)


def held(path):
    """Write the documented CSV of commands that are held from row to row, which a simulation can meet exactly."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    rows = []
    for time in np.arange(ROWS) / RATE:
        data.ctrl[:] = (
            np.sin(9 * time) + 0.5 * np.sin(31 * time),
            np.sin(14 * time + 1) - 0.5 * np.sin(23 * time),
        )
        rows.append([time, *data.qpos, *data.qvel, *data.ctrl])
        mujoco.mj_step(model, data, 1000 // RATE)
    names = [f"{kind}.{joint}" for kind in ("qpos", "qvel", "ctrl") for joint in JOINTS]
    pd.DataFrame(rows, columns=["time", *names]).to_csv(path, index=False)
    return path


def _options(state, names):
    """Return one entry a group of channels where the state needs it."""
    if state == "names":
        return {"columns": {f"{ours}.*": theirs for ours, theirs in names.items()}}
    if state == "degrees":
        return {"columns": {f"{ours}.*": ":deg" for ours in names}}
    return {}


def _flat(state):
    t, q, v, u = table(state)
    stems = ("a", "w", "u") if state == "names" else ("qpos.", "qvel.", "ctrl.")
    ends = ("1", "2") if state == "names" else JOINTS
    columns = {"time": t}
    for stem, values in zip(stems, (q, v, u)):
        if values is not None:
            columns |= {f"{stem}{end}": values[:, place] for place, end in enumerate(ends)}
    columns["temperature"] = np.full(len(t), 30.0)
    return columns, _options(state, {"qpos": "a*", "qvel": "w*", "ctrl": "u*"})


def _vectors(state):
    t, q, v, u = table(state)
    names = ("angle_list", "rate_list", "told") if state == "names" else ("position", "velocity", "command")
    arrays = {"time": t} | {name: values for name, values in zip(names, (q, v, u)) if values is not None}
    return arrays, _options(state, dict(zip(("qpos", "qvel", "ctrl"), names)))


def _frame(folder, state):
    import polars

    columns, options = _flat(state)
    return polars.DataFrame(columns), options


def _parquet(folder, state):
    import pyarrow
    import pyarrow.parquet

    columns, options = _flat(state)
    pyarrow.parquet.write_table(pyarrow.table(columns), folder / "log.parquet")
    return folder / "log.parquet", options


def _npz(folder, state):
    arrays, options = _vectors(state)
    np.savez(folder / "log.npz", **arrays)
    return folder / "log.npz", options


def _hdf5(folder, state):
    import h5py

    arrays, options = _vectors(state)
    with h5py.File(folder / "log.h5", "w") as file:
        for name, values in arrays.items():
            file[name] = values
    return folder / "log.h5", options


def _ros_names(state):
    return ("m1", "m2") if state == "names" else JOINTS


def _bag(folder, state, storage):
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    first = storage == "rosbag1"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    types = store.types
    Header, Time = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    JointState, Array = types["sensor_msgs/msg/JointState"], types["std_msgs/msg/Float64MultiArray"]
    Layout = types["std_msgs/msg/MultiArrayLayout"]
    t, q, v, u = table(state)
    path = folder / ("log.bag" if first else f"bag_{storage}")
    if first:
        writer, serialize = Writer1(path), store.serialize_ros1
    else:
        plugin = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}[storage]
        writer, serialize = Writer(path, version=9, storage_plugin=plugin), store.serialize_cdr
    topic, told = ("/arm", "/wanted") if state == "names" else ("/joint_states", "/commands")
    with writer:
        joints = writer.add_connection(topic, JointState.__msgtype__, typestore=store)
        commands = writer.add_connection(told, Array.__msgtype__, typestore=store)
        for row in range(len(t)):
            stamp = 1_700_000_000_000_000_000 + round(t[row] * 1e9)
            time = Time(sec=stamp // 10**9, nanosec=stamp % 10**9)
            header = Header(**({"seq": row} if first else {}), stamp=time, frame_id="")
            rates = v[row] if v is not None else np.zeros(0)
            state_message = JointState(header, list(_ros_names(state)), q[row], rates, np.zeros(0))
            writer.write(joints, stamp, serialize(state_message, JointState.__msgtype__))
            message = Array(layout=Layout(dim=[], data_offset=0), data=u[row])
            writer.write(commands, stamp, serialize(message, Array.__msgtype__))
    names = {"qpos": "/arm.position", "qvel": "/arm.velocity", "ctrl": "/wanted"}
    return path, _options(state, names)


def _mcap_json(folder, state):
    from mcap.writer import Writer

    t, q, v, u = table(state)
    with (folder / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("arm", "jsonschema", b'{"type": "object"}')
        channels = [writer.register_channel(topic, "json", schema) for topic in ("/arm", "/commands")]
        for row in range(len(t)):
            stamp = round(t[row] * 1e9)
            arm = {"name": list(_ros_names(state)), "position": q[row].tolist()}
            if v is not None:
                arm["velocity"] = v[row].tolist()
            for channel, message in zip(channels, (arm, {"position": u[row].tolist()})):
                writer.add_message(channel, stamp, json.dumps(message).encode(), stamp)
        writer.finish()
    names = {"qpos": "/arm.position", "qvel": "/arm.velocity", "ctrl": "/commands.position"}
    return folder / "log.mcap", _options(state, names)


def mcap_protobuf(folder, state):
    """Write an MCAP file of protobuf messages whose type is made up here."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
    from mcap_protobuf.writer import Writer

    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="arm.proto", package="arm", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    message = file.message_type.add(name="State")
    for number, (name, kind) in enumerate(
        [
            ("name", kinds.TYPE_STRING),
            *((one, kinds.TYPE_DOUBLE) for one in ("position", "velocity", "command")),
        ],
        1,
    ):
        message.field.add(name=name, number=number, type=kind, label=kinds.LABEL_REPEATED)
    message.field.add(
        name="stamp",
        number=9,
        type=kinds.TYPE_MESSAGE,
        type_name=".google.protobuf.Timestamp",
        label=kinds.LABEL_OPTIONAL,
    )
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    State = message_factory.GetMessageClass(pool.FindMessageTypeByName("arm.State"))
    t, q, v, u = table(state)
    with (folder / "log.mcap").open("wb") as stream, Writer(stream) as writer:
        for row in range(len(t)):
            stamp = round(t[row] * 1e9)
            one = State(name=list(_ros_names(state)), position=q[row], command=u[row])
            if v is not None:
                one.velocity.extend(v[row])
            one.stamp.FromNanoseconds(stamp)
            writer.write_message(topic="/arm", message=one, log_time=stamp, publish_time=stamp)
    names = {"qpos": "/arm.position", "qvel": "/arm.velocity", "ctrl": "/arm.command"}
    return folder / "log.mcap", _options(state, names)


def minari_arrow(folder, state="clean"):
    """Write a Minari data set in Arrow, by Minari."""
    import gymnasium
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    t, q, v, u = table(state)
    path = folder / "arrow-v0"
    (path / "data").mkdir(parents=True)
    observations = gymnasium.spaces.Dict(
        {
            "q": gymnasium.spaces.Box(-9, 9, (2,), np.float64),
            "v": gymnasium.spaces.Box(-99, 99, (2,), np.float64),
        }
    )
    actions = gymnasium.spaces.Box(-9, 9, (2,), np.float64)
    storage = MinariStorage.new(path / "data", observations, actions, data_format="arrow")
    steps = len(t) - 1
    storage.update_metadata({"dataset_id": "arrow-v0", "minari_version": "0.5.4"})
    storage.update_episodes(
        [
            EpisodeBuffer(
                id=0,
                observations={"q": list(q), "v": list(v)},
                actions=list(u[:-1]),
                rewards=[0.0] * steps,
                terminations=[False] * steps,
                truncations=[False] * steps,
                infos={"time": list(t)},
            )
        ]
    )
    return path, {}


def torch_tensors(folder):
    """Write what ``torch.save`` writes of a dictionary of tensors: a program for pickle's machine, and numbers."""

    def word(text):
        return b"X" + len(text).to_bytes(4, "little") + text.encode()

    def numbers(values):
        return b"(" + b"".join(b"J" + int(value).to_bytes(4, "little") for value in values) + b"t"

    program, stored = b"\x80\x02}(", {}
    t, q, v, u = table("clean")
    for key, (name, values) in enumerate({"time": t, "dof_pos": q, "dof_vel": v, "ctrl": u}.items()):
        stored[f"a/data/{key}"] = values.tobytes()
        size = b"J" + values.size.to_bytes(4, "little")
        storage = (
            b"(" + word("storage") + b"ctorch\nDoubleStorage\n" + word(str(key)) + word("cpu") + size + b"tQ"
        )
        layout = numbers(values.shape) + numbers(step // 8 for step in values.strides)
        hooks = b"\x89ccollections\nOrderedDict\n)R"
        program += (
            word(name) + b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + b"K\0" + layout + hooks + b"tR"
        )
    with zipfile.ZipFile(folder / "log.pt", "w") as archive:
        archive.writestr("a/data.pkl", program + b"u.")
        archive.writestr("a/byteorder", "little")
        for name, content in stored.items():
            archive.writestr(name, content)
    return folder / "log.pt", {}


def mcap_mixed(folder):
    """Write an MCAP file of JSON with all that messages may hold, beside what a log needs."""
    from mcap.writer import Writer

    t, q, v, u = table("clean")
    with (folder / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("arm", "jsonschema", b'{"type": "object"}')
        topics = {"/arm": "json", "/commands": "json", "/picture": "json", "/odd": "json", "/bytes": "cbor"}
        channels = [writer.register_channel(topic, encoding, schema) for topic, encoding in topics.items()]
        for row in range(len(t)):
            stamp = round(t[row] * 1e9)
            arm = {
                "header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}},
                "on": row % 2 == 0,
                "note": None,
                "huge": 10**400,
                "feet": [{"force": 1.0, "at": {"x": 0.1}}, {"force": 2.0, "at": {"x": 0.2}}],
                "joints": [
                    {"position": q[row, place], "velocity": v[row, place], "name": joint}
                    for place, joint in enumerate(JOINTS)
                ],
            }
            odd = [row, {"stamp": {"sec": "soon", "nanosec": 0}}] if row else list(range(3000))
            picture = {"data": "x" * (200_000 if row < 2 else 10)}
            for channel, message in zip(channels, (arm, {"position": u[row].tolist()}, picture, odd, 0)):
                writer.add_message(channel, stamp, json.dumps(message).encode(), stamp)
        writer.finish()
    columns = {
        f"{kind}.{joint}": f"/arm.joints[{place}].{name}"
        for kind, name in (("qpos", "position"), ("qvel", "velocity"))
        for place, joint in enumerate(JOINTS)
    }
    return folder / "log.mcap", {"columns": columns}


def lerobot_motors(folder):
    """Write a LeRobot data set whose names are in mappings, as those of other robots are."""
    path, _ = lerobot(folder, "clean", "v2.1")
    info = path / "meta" / "info.json"
    content = json.loads(info.read_text())
    names = {"motors": dict(zip(JOINTS, (0, 1)))}
    for feature in content["features"].values():
        feature["names"] = names
    info.write_text(json.dumps(content))
    return path, {}


def hdf5_groups(folder):
    """Write an HDF5 file of which one group is the log."""
    import h5py

    t, q, v, u = table("clean")
    with h5py.File(folder / "log.h5", "w") as file:
        for name, values in (("time", t), ("position", q), ("velocity", v), ("command", u)):
            file[f"arm/{name}"] = values
        file["arm/picture"] = np.zeros((len(t), 2, 3))
        file["camera/time"] = np.arange(7.0)
    return folder / "log.h5", {"topic": "arm"}


def hdf5_episodes(folder):
    """Write an HDF5 file with a group for each of two episodes."""
    import h5py

    t, q, v, u = table("clean")
    with h5py.File(folder / "log.h5", "w") as file:
        for name, rows in (("run_1", slice(0, 80)), ("run_2", slice(80, None))):
            for key, values in (("time", t), ("obs/position", q), ("obs/velocity", v), ("command", u)):
                file[f"{name}/{key}"] = values[rows]
        file["run_1"].attrs["robot"] = "arm"
    return folder / "log.h5", {}


def parquet_lists(folder):
    """Write a Parquet file whose cells are lists of any length, one of them missing."""
    import pyarrow
    import pyarrow.parquet

    t, q, v, u = table("clean")
    positions = [None if row == 40 else list(values) for row, values in enumerate(q)]
    columns = {
        "time": t,
        "position": positions,
        "velocity": [list(row) for row in v],
        "command": [list(row) for row in u],
    }
    pyarrow.parquet.write_table(pyarrow.table(columns), folder / "log.parquet")
    return folder / "log.parquet", {}


def tables(folder):
    """Write a folder of two tables with clocks of their own."""
    t, q, v, u = table("clean")
    (folder / "run").mkdir()
    state = {"time": t} | {
        f"{kind}{place}": values[:, place] for kind, values in (("q", q), ("dq", v)) for place in (0, 1)
    }
    pd.DataFrame(state).to_csv(folder / "run" / "state.csv", index=False)
    pd.DataFrame({"time": t, "u0": u[:, 0], "u1": u[:, 1]}).to_parquet(folder / "run" / "command.parquet")
    return folder / "run", {}


def lerobot(folder, state, version="v3.0"):
    """Write a LeRobot data set, v2.1 or v3.0."""
    import pyarrow
    import pyarrow.parquet

    t, q, v, u = table(state)
    ends = ("m1", "m2") if state == "names" else JOINTS
    pairs = {"observation.state": q, "action": u}
    if v is not None:
        pairs["observation.velocity"] = v
    features = {
        name: {"dtype": "float64", "shape": [2], "names": [f"{end}.pos" for end in ends]} for name in pairs
    }
    columns = {
        name: pyarrow.FixedSizeListArray.from_arrays(values.ravel(), 2) for name, values in pairs.items()
    }
    columns |= {"timestamp": t, "episode_index": np.zeros(len(t), int), "frame_index": np.arange(len(t))}
    name = "file-000" if version.startswith("v3") else "episode_000000"
    path = folder / "lerobot"
    for part in ("meta", "data/chunk-000"):
        (path / part).mkdir(parents=True)
    pyarrow.parquet.write_table(pyarrow.table(columns), path / "data" / "chunk-000" / f"{name}.parquet")
    info = {"codebase_version": version, "fps": RATE, "features": features}
    (path / "meta" / "info.json").write_text(json.dumps(info))
    names = {"qpos": "observation.state", "qvel": "observation.velocity", "ctrl": "action"}
    return path, _options(state, names)


def _minari(folder, state):
    import gymnasium
    import h5py
    from gymnasium.envs.registration import EnvSpec

    t, q, v, u = table(state)
    path = folder / "minari" / "arm-v0" / "data"
    path.mkdir(parents=True)
    observed = q if v is None else np.hstack([q, v])
    names = {"qpos": "observations", "qvel": "observations", "ctrl": "actions"}
    if state == "names":
        names = {"qpos": "observations.a", "qvel": "observations.w", "ctrl": "actions"}
    boxes = {
        "a": gymnasium.spaces.Box(-9, 9, (2,), np.float64),
        "w": gymnasium.spaces.Box(-99, 99, (2,), np.float64),
    }
    dictionary = state == "names"
    space = (
        gymnasium.spaces.Dict(boxes)
        if dictionary
        else gymnasium.spaces.Box(-99, 99, (observed.shape[1],), float)
    )
    from minari.serialization import serialize_space

    metadata = {
        "dataset_id": "arm-v0",
        "minari_version": "0.5.4",
        "data_format": "hdf5",
        "total_episodes": 1,
        "total_steps": len(t) - 1,
        "observation_space": serialize_space(space),
        "action_space": serialize_space(gymnasium.spaces.Box(-9, 9, (2,), np.float64)),
        "env_spec": EnvSpec("Arm-v0", entry_point="none:None").to_json(),
    }
    (path / "metadata.json").write_text(json.dumps(metadata))
    with h5py.File(path / "main_data.hdf5", "w") as file:
        group = file.create_group("episode_0")
        group.attrs.update({"id": 0, "total_steps": len(t) - 1})
        if dictionary:
            group["observations/a"], group["observations/w"] = q, v
        else:
            group["observations"] = observed
        group["actions"] = u[:-1]
        group["infos/time"] = t
        for name in ("rewards", "terminations", "truncations"):
            group[name] = np.zeros(len(t) - 1, dtype=float if name == "rewards" else bool)
    return path.parent, _options(state, names)


WRITERS = {
    "frame": _frame,
    "parquet": _parquet,
    "npz": _npz,
    "hdf5": _hdf5,
    "rosbag2_sqlite3": lambda folder, state: _bag(folder, state, "sqlite3"),
    "rosbag2_mcap": lambda folder, state: _bag(folder, state, "mcap"),
    "rosbag1": lambda folder, state: _bag(folder, state, "rosbag1"),
    "mcap_json": _mcap_json,
    "lerobot": lerobot,
    "minari": _minari,
}
