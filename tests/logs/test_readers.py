"""What is in files of each format: whole recordings, with the names, numbers and notes that readers make of them."""

import json

import numpy as np
import pandas as pd
import pytest

from skat.logs import LogError, load_log
from skat.logs.readers import file_kind, folder_kind, hdf5, lerobot, minari, parquet, recording
from skat.logs.readers.messages import FIRST_MESSAGES, messages_recording
from skat.simulators import FunctionSimulator

pytest.importorskip("pyarrow")
pytest.importorskip("h5py")


def numbers(stream, names=None):
    """Return {name: list} of a stream's columns, NaN as None."""
    found = stream.read(names or stream.columns)
    return {
        name: [None if isinstance(value, float) and np.isnan(value) else value for value in values.tolist()]
        for name, values in found.items()
    }


# -- Parquet and LeRobot -----------------------------------------------------------------------------------------------


def write_parquet(path, **columns):
    import pyarrow.parquet

    path.parent.mkdir(parents=True, exist_ok=True)
    pyarrow.parquet.write_table(pyarrow.table(columns), path)
    return path


def test_cells_of_lists_are_columns_and_empty_ones_not_measured(tmp_path):
    path = write_parquet(
        tmp_path / "a.parquet",
        t=[0.0, 0.5, None],
        v=[[1, 2, 3], None, [4.0, 5.0, 6.5]],
        word=["a", "b", None],
        inner=[[[1]], [[2]], [[3]]],
        none=[[], [1.0], [2.0]],
    )
    (stream,) = parquet.read(path).streams
    assert stream.columns == ("t", "v[0]", "v[1]", "v[2]", "word", "none")
    assert numbers(stream, ["v[2]", "t", "v[0]"]) == {
        "v[2]": [3, None, 6.5],
        "t": [0.0, 0.5, None],
        "v[0]": [1, None, 4],
    }
    assert stream.read(["word"])["word"].tolist()[:2] == ["a", "b"]


@pytest.mark.parametrize("lengths", [(2, 1, 3), (2, 2, 1), (2, None, 3)])
def test_lists_of_other_lengths_are_refused_also_where_they_are_as_many_in_all(tmp_path, lengths):
    cells = [None if length is None else list(range(length)) for length in lengths]
    (stream,) = parquet.read(write_parquet(tmp_path / "a.parquet", v=cells)).streams
    row = next(row for row, length in enumerate(lengths) if length not in (2, None))
    with pytest.raises(
        LogError, match=rf"row {row}, column v: holds {lengths[row]} numbers, the first row 2"
    ):
        stream.read(["v[0]"])


def write_lerobot(folder, features, version="v2.1", **described):
    (folder / "meta").mkdir(parents=True)
    info = {"codebase_version": version, "features": features} | described
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    for place, chunk in enumerate(("chunk-000", "chunk-000", "chunk-001")):
        state = [[10.0 * place + row, -row] for row in range(2)]
        write_parquet(folder / "data" / chunk / f"episode_{place}.parquet", state=state, n=[place] * 2)
    return folder


@pytest.mark.parametrize(
    ("names", "labels"),
    [
        (["hip.pos", "knee.pos"], ["hip.pos", "knee.pos"]),
        ({"motors": ["hip", "knee"]}, ["hip", "knee"]),
        ({"hip": 1, "knee": 0}, ["knee", "hip"]),
        ({"motors": {"hip": 1, "knee": 0}}, ["knee", "hip"]),
        ({"motors": ["hip", "knee"], "size": 2}, ["hip", "knee"]),
        (["hip"], None),
        ({}, None),
        (None, None),
        ("hip", None),
    ],
)
def test_a_lerobot_is_its_files_after_each_other_with_the_names_of_its_description(tmp_path, names, labels):
    features = {"state": {"names": names}, "n": {"names": None}, "camera": "none"}
    record = lerobot.read(write_lerobot(tmp_path / "set", features, fps=50))
    (stream,) = record.streams
    assert (record.source, record.rate) == (str(tmp_path / "set"), 50.0)
    assert record.notes == ("LeRobot v2.1, 3 files",)
    assert stream.columns == ("state[0]", "state[1]", "n")
    assert stream.labels == (dict(zip(stream.columns, labels)) if labels else {})
    assert numbers(stream) == {
        "state[0]": [0, 1, 10, 11, 20, 21],
        "state[1]": [0, -1, 0, -1, 0, -1],
        "n": [0, 0, 1, 1, 2, 2],
    }


@pytest.mark.parametrize(
    ("fps", "rate"),
    [(30, 30.0), (12.5, 12.5), (0, None), (-5, None), (True, None), ("30", None), (None, None)],
)
def test_the_rate_of_a_lerobot_is_a_positive_number(tmp_path, fps, rate):
    assert lerobot.read(write_lerobot(tmp_path / "set", {}, version="v3.0", fps=fps)).rate == rate


@pytest.mark.parametrize(
    ("spacing", "dt", "note"),
    [
        (0.02, 0.02, None),
        (0.0201, 0.02, "Rows are taken as 0.02 s apart, as told; the clock says 0.0201 s."),
        (0.025, 0.025, None),
        (None, 0.02, "The log has no times: rows are 0.02 s apart, as told."),
    ],
)
def test_the_rate_of_a_lerobot_stands_for_its_clock_where_they_agree(tmp_path, spacing, dt, note):
    folder = write_lerobot(tmp_path / "set", {}, fps=50)
    for path in (folder / "data").rglob("*.parquet"):
        path.unlink()
    clock = {} if spacing is None else {"timestamp": spacing * np.arange(40)}
    write_parquet(folder / "data" / "chunk-000" / "file.parquet", q=np.arange(40.0), **clock)
    simulator = FunctionSimulator(
        lambda X: X, input_names=("q",), output_names=("q",), state_names=("q",), dt=dt
    )
    log = load_log(folder, simulator)
    assert log.dt == pytest.approx(dt, rel=1e-12)
    np.testing.assert_allclose(log.time, (spacing or dt) * np.arange(39), atol=1e-9)
    np.testing.assert_array_equal(log.X[:, 0], np.arange(39))
    assert log.notes == ("LeRobot v2.1, 1 files", *([note] if note else []))


# -- HDF5 and Minari ---------------------------------------------------------------------------------------------------


def write_hdf5(path, **arrays):
    import h5py

    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            if values is not None:
                file[name.replace("__", "/")] = values
    return path


def test_groups_of_the_same_data_sets_are_episodes_in_the_order_of_their_numbers(tmp_path):
    path = write_hdf5(
        tmp_path / "a.h5",
        **{
            f"run_{run}__{name}": values
            for run in (10, 2)
            for name, values in (
                ("t", np.arange(3.0) + run),
                ("v", np.arange(6.0).reshape(3, 2) - run),
                ("deep__w", np.arange(12.0).reshape(3, 2, 2) * run),
                ("constants", np.zeros(7)),
            )
        },
    )
    (stream,) = hdf5.read(path).streams
    assert set(stream.columns) == {
        "t",
        "v[0]",
        "v[1]",
        *(f"deep/w[{place}]" for place in range(4)),
        "episode",
    }
    assert numbers(stream, ["t", "v[1]", "deep/w[2]", "episode"]) == {
        "t": [2, 3, 4, 10, 11, 12],
        "v[1]": [-1, 1, 3, -9, -7, -5],
        "deep/w[2]": [4, 12, 20, 20, 60, 100],
        "episode": ["run_2"] * 3 + ["run_10"] * 3,
    }


@pytest.mark.parametrize(
    ("run", "shape", "problem"),
    [
        (1, (3, 2), "run_2/v: has the shape (3, 2); t there has 4 rows"),
        (1, (4, 3), "run_2/v: has the shape (4, 3)"),
    ],
)
def test_an_episode_whose_columns_do_not_fit_together_is_refused(tmp_path, run, shape, problem):
    """One row less in an episode and one more in the next would set all between them apart by a row."""
    shapes = [(4, 2), (4, 2), (4, 2)]
    shapes[run] = shape
    arrays = {f"run_{place + 1}__v": np.zeros(one) for place, one in enumerate(shapes)}
    arrays |= {f"run_{place}__t": np.arange(4.0) for place in (1, 2, 3)}
    with pytest.raises(LogError) as caught:
        hdf5.read(write_hdf5(tmp_path / "a.h5", **arrays))
    assert problem in str(caught.value)


def test_a_group_is_chosen_by_its_name(tmp_path):
    path = write_hdf5(
        tmp_path / "a.h5", arm__t=np.arange(3.0), arm__q=np.ones((3, 1)), hand__t=np.arange(2.0)
    )
    for topic in ("arm", "/arm/"):
        (stream,) = hdf5.read(path, topic).streams
        assert numbers(stream) == {"q[0]": [1, 1, 1], "t": [0, 1, 2]}
    with pytest.raises(LogError, match=r"has no group 'leg'\. It has: arm, hand\."):
        hdf5.read(path, "leg")
    (stream,) = hdf5.read(write_hdf5(tmp_path / "b.h5", one=np.arange(3.0), run__t=np.arange(3.0))).streams
    assert set(stream.columns) == {"one", "run/t"}


def write_minari(folder, *episodes, metadata="{}"):
    arrays = {f"episode_{place}__{name}": values for place, one in episodes for name, values in one.items()}
    write_hdf5(folder / "data" / "main_data.hdf5", **arrays)
    (folder / "data" / "metadata.json").write_text(metadata)
    return folder


def steps(n_rows, first, **more):
    return {
        "rewards": np.zeros(n_rows - 1),
        "observations__q": first + np.arange(2.0 * n_rows).reshape(n_rows, 2),
        "actions": first - np.arange(n_rows - 1.0),
    } | more


def test_episodes_of_a_minari_follow_each_other_and_its_actions_have_a_last_one(tmp_path):
    more = {
        "infos__time": np.arange(4.0),
        "infos__image": np.arange(16).reshape(4, 2, 2),
        "infos__word": np.array([b"a", b"b", b"c", b"d"]),
        "infos__short": np.zeros(7),
        "infos__single": 1.0,
        "other": np.zeros(4),
    }
    path = write_minari(tmp_path / "set", (10, steps(4, 100.0, **more)), (2, steps(4, 0.0, **more)))
    record = minari.read(path)
    (stream,) = record.streams
    assert (record.source, record.rate, record.notes) == (str(path), None, ("Minari, 2 episodes",))
    pixels = {f"infos.image[{place}]": 2 * [float(4 * row + place) for row in range(4)] for place in range(4)}
    assert (
        numbers(stream)
        == {
            "observations.q[0]": [0, 2, 4, 6, 100, 102, 104, 106],
            "observations.q[1]": [1, 3, 5, 7, 101, 103, 105, 107],
            "actions": [0, -1, -2, -2, 100, 99, 98, 98],
            "infos.time": [0, 1, 2, 3, 0, 1, 2, 3],
            "episode": ["0"] * 4 + ["1"] * 4,
        }
        | pixels
    )
    assert minari.read(path / "data").notes == record.notes


@pytest.mark.parametrize(
    ("episodes", "metadata", "problem"),
    [
        ([], "{}", "has no episodes"),
        ([(0, {"rewards": np.zeros(2)})], "{}", "has no episodes"),
        ([(0, steps(3, 0.0)), (1, {"rewards": np.zeros(2)})], "{}", "has episodes of different columns"),
        ([(0, {"actions": np.zeros(2)})], "{}", "is no Minari data set, or damaged"),
        ([(0, steps(3, 0.0))], "[]", "metadata.json: is no Minari data set, or damaged"),
        ([(0, steps(3, 0.0))], "{", "metadata.json: is no Minari data set, or damaged"),
    ],
)
def test_a_minari_without_whole_episodes_is_refused(tmp_path, episodes, metadata, problem):
    with pytest.raises(LogError) as caught:
        minari.read(write_minari(tmp_path / "set", *episodes, metadata=metadata))
    assert problem in str(caught.value)


# -- messages ----------------------------------------------------------------------------------------------------------

RECEIVED, STAMPED = 5_000_000_000, 4_000_000_000


def arm(row, **more):
    stamp = STAMPED + 10_000_000 * row
    return {"header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}}, "q": [row, -row]} | more


def recorded(*messages, types=None):
    return messages_recording(
        "bag",
        types if types is not None else {topic: "kind" for topic, _, _ in messages},
        lambda topics: (one for one in messages if topics is None or one[0] in topics),
        ("noted",),
    )


def test_topics_are_streams_whose_times_count_from_the_first_message_of_all():
    messages = [("/cmd", RECEIVED, {"u": 7.0})]
    for row in range(3):
        messages.append(
            ("/arm", RECEIVED + 1_000_000 * (1 + row), arm(row, **({"late": 1.0} if row == 2 else {})))
        )
    messages += [("/cmd", RECEIVED + 9_000_000, {}), ("/words", RECEIVED, {"data": "hello"})]
    record = recorded(*messages)
    assert (record.source, record.rate, record.notes) == ("bag", None, ("noted",))
    assert [stream.name for stream in record.streams] == ["/cmd", "/arm"]
    told, moved = record.streams
    assert numbers(told) == {"/cmd.u": [7.0, None], "/cmd.time": [0.0, 0.009]}
    assert list(moved.columns) == ["/arm.q[0]", "/arm.q[1]", "/arm.late", "/arm.header.stamp", "/arm.time"]
    assert numbers(moved) == {
        "/arm.q[0]": [0, 1, 2],
        "/arm.q[1]": [0, -1, -2],
        "/arm.late": [None, None, 1.0],
        "/arm.header.stamp": [0.0, 0.01, 0.02],
        "/arm.time": [0.001, 0.002, 0.003],
    }
    assert moved.place(4) == "message 4 of /arm"


def test_a_stamp_of_nought_is_none_and_a_time_of_the_messages_own_counts():
    unset = {"header": {"stamp": {"sec": 0, "nanosec": 0}}, "q": 1.0, "time": 0.25}
    (stream,) = recorded(("/arm", RECEIVED, unset), ("/arm", RECEIVED, arm(3, q=2.0, time=0.5))).streams
    assert numbers(stream) == {"/arm.q": [1, 2], "/arm.time": [0.25, 0.5], "/arm.header.stamp": [None, 0.0]}
    (plain,) = recorded(("/arm", RECEIVED, unset)).streams
    assert "/arm.header.stamp" not in plain.columns


def test_names_of_joints_are_those_of_arrays_as_long_as_they_also_further_down():
    message = {"name": [], "joint_names": ["a", "b"], "actual": {"q": [1, 2], "one": [3]}, "n": np.int64(4)}
    (stream,) = recorded(("/arm", RECEIVED, message)).streams
    found = {"/arm.actual.q[a]": [1], "/arm.actual.q[b]": [2], "/arm.actual.one[0]": [3], "/arm.n": [4]}
    assert numbers(stream) == found | {"/arm.time": [0]}


def test_fields_are_those_of_the_first_messages_of_each_topic():
    messages = [
        ("/arm", RECEIVED + row, {"q": row} | ({"late": 1} if row == 20 else {})) for row in range(21)
    ]
    assert FIRST_MESSAGES == 20
    (stream,) = recorded(*messages).streams
    assert stream.columns == ("/arm.q", "/arm.time")
    assert len(stream.read(["/arm.q"])["/arm.q"]) == 21
    early, late = recorded(*messages, ("/cmd", RECEIVED, {"u": 1})).streams
    assert (early.columns, late.columns) == (("/arm.q", "/arm.time"), ("/cmd.u", "/cmd.time"))


@pytest.mark.parametrize(
    ("messages", "types", "told"),
    [
        ([("/words", 0, {"data": "hello"})], {"/words": "std_msgs/String"}, "/words (std_msgs/String)"),
        ([], {"/a": "A", "/b": "B"}, "/a (A), /b (B)"),
        ([], {}, "none"),
    ],
)
def test_messages_without_numbers_are_told_with_their_topics(messages, types, told):
    with pytest.raises(LogError) as caught:
        recorded(*messages, types=types)
    assert caught.value.problem == f"has no topic with messages that hold numbers; its topics: {told}."


# -- which reader ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "head", "kind"),
    [
        ("a", b"PAR1....", "parquet"),
        ("a.csv", b"PK\x03\x04....", "npz"),
        ("a", b"PK\x05\x06....", "npz"),
        ("a", b"\x89HDF\r\n\x1a\n..", "hdf5"),
        ("a", b"SQLite format 3\x00..", "bags"),
        ("a", b"#ROSBAG V2.0\n", "bags"),
        ("a", b"\x89MCAP0\r\n..", "mcap"),
        ("a", b"\x93NUMPY..", "npy"),
        # What begins otherwise is damaged where its ending says what it should be.
        ("a.MCAP", b"\0\0\0", "mcap"),
        ("a.h5", b"time,q\n", "hdf5"),
        ("a.h5", b"", "csv"),
        ("a.txt", b"time,q\n", "csv"),
        ("a.gz", b"\x1f\x8b\0\0", "csv"),
    ],
)
def test_a_file_is_known_by_its_first_bytes(tmp_path, name, head, kind):
    (tmp_path / name).write_bytes(head)
    assert file_kind(tmp_path / name) == kind


@pytest.mark.parametrize(
    ("name", "head", "problem"),
    [
        ("a.pkl", b"time,q\n", "is a pickle"),
        ("a", b"\x80\x04..", "is a pickle"),
        ("a.csv", b"\x80\x02..", "is a pickle"),
        ("a", "time,q".encode("utf-16"), "is text in UTF-16."),
        ("a", b"\x7fELF\0\0", "is in no format that is read."),
    ],
)
def test_a_file_of_no_format_is_told(tmp_path, name, head, problem):
    (tmp_path / name).write_bytes(head)
    with pytest.raises(LogError) as caught:
        file_kind(tmp_path / name)
    assert caught.value.problem.startswith(problem)


@pytest.mark.parametrize(
    ("inside", "kind"),
    [
        (["meta/info.json", "data/a.parquet"], "lerobot"),
        (["data/metadata.json"], "minari"),
        (["metadata.json"], "minari"),
        (["metadata.yaml"], "bags"),
        (["a.db3", "b.txt"], "bags"),
        (["a.mcap"], "bags"),
        (["data/chunk/a.parquet"], "has data/*.parquet but no meta/info.json"),
        (
            [f"{letter}.t" for letter in "gfedcba"],
            "is a folder of no known kind; it holds a.t, b.t, c.t, d.t, e.t, f.t.",
        ),
        ([], "is a folder of no known kind; it holds nothing."),
    ],
)
def test_a_folder_is_known_by_what_is_in_it(tmp_path, inside, kind):
    for name in inside:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    if " " not in kind:
        assert folder_kind(tmp_path) == kind
        return
    with pytest.raises(LogError) as caught:
        folder_kind(tmp_path)
    assert caught.value.problem.startswith(kind)


def test_tables_in_a_folder_or_by_name_are_streams_with_the_names_of_their_files(tmp_path):
    (tmp_path / "arm.csv").write_text("t,q\n0,1\n1,2\n")
    write_parquet(tmp_path / "hand.parquet", t=[0.0], u=[[5.0, 6.0]])
    (tmp_path / "notes.txt").write_text("of no matter")
    for source in (tmp_path, {"arm": tmp_path / "arm.csv", "hand": str(tmp_path / "hand.parquet")}):
        record = recording(source)
        assert [stream.name for stream in record.streams] == ["arm", "hand"]
        arm_table, hand = record.streams
        assert numbers(arm_table) == {"arm.t": [0, 1], "arm.q": [1, 2]}
        assert numbers(hand, ["hand.u[1]"]) == {"hand.u[1]": [6]}
        assert hand.columns == ("hand.t", "hand.u[0]", "hand.u[1]")
        assert arm_table.place(1) == "arm.csv, line 3"
    (tmp_path / "more").mkdir()
    for name in "ab":
        (tmp_path / "more" / f"{name}.csv").write_text("t,q\n0,1\n")
    with pytest.raises(LogError, match="holds 2 tables of the same columns"):
        recording(tmp_path / "more")
    both = {name: tmp_path / "more" / f"{name}.csv" for name in "ab"}
    assert [stream.name for stream in recording(both).streams] == ["a", "b"]
    (tmp_path / "more" / "b.csv").unlink()
    assert [stream.name for stream in recording(tmp_path / "more").streams] == ["a"]
    with pytest.raises(FileNotFoundError, match="There is no log"):
        recording(tmp_path / "none.csv")
    with pytest.raises(TypeError, match="got bytes"):
        recording(b"log.csv")


def test_tables_whose_names_begin_alike_are_all_read(tmp_path):
    for name, table in (("j.pos", "t,q"), ("j.vel", "t,v")):
        (tmp_path / f"{name}.csv").write_text(f"{table}\n0,1\n1,2\n")
    record = recording(tmp_path)
    assert [stream.columns for stream in record.streams] == [
        ("j.pos.t", "j.pos.q"),
        ("j.vel.t", "j.vel.v"),
    ]
    (tmp_path / "j.vel.csv").write_text("t,q\n0,1\n")
    with pytest.raises(LogError, match="holds 2 tables of the same columns"):
        recording(tmp_path)
    (tmp_path / "j.pos.CSV.gz").write_text("")
    with pytest.raises(LogError, match=r"holds j\.pos\.CSV\.gz and j\.pos\.csv, two tables of one name"):
        recording(tmp_path)


def rollout(n=30):
    """Return n + 1 states and n actions of a mass that a force pushes."""
    force = np.random.default_rng(0).normal(size=n)
    speed = np.cumsum(np.r_[0, 0.1 * force])
    return {"time": 0.1 * np.arange(n + 1), "x": np.cumsum(0.1 * speed), "v": speed, "action": force}


def pushed():
    states = ("x", "v")
    return FunctionSimulator(
        lambda X: X[:, :2], input_names=(*states, "action"), output_names=states, state_names=states, dt=0.1
    )


def in_memory(folder, arrays):
    return arrays


def npz(folder, arrays):
    np.savez(folder / "log.npz", **arrays)
    return folder / "log.npz"


def hdf5_file(folder, arrays):
    import h5py

    with h5py.File(folder / "log.h5", "w") as file:
        for name, values in arrays.items():
            file[name] = values
    return folder / "log.h5"


FORMS = pytest.mark.parametrize("form", [in_memory, npz, hdf5_file])


@FORMS
def test_a_rollout_of_one_action_less_than_states_is_read_whole(form, tmp_path):
    arrays = rollout()
    log = load_log(form(tmp_path, arrays), pushed())
    np.testing.assert_array_equal(log.X[:, 2], arrays["action"])
    np.testing.assert_array_equal(log.X[:, 1], arrays["v"][:-1])
    np.testing.assert_array_equal(log.y[:, 1], arrays["v"][1:])
    assert "action has a row less than states: the last command is held." in log.notes


def test_a_rollout_is_as_long_as_its_states_also_where_most_arrays_are_actions():
    states = np.zeros((5, 2))
    record = recording({"obs": states, "action": np.arange(4.0), "reward": np.zeros(4), "done": np.zeros(4)})
    assert numbers(record.streams[0]) == {
        "obs[0]": [0] * 5,
        "obs[1]": [0] * 5,
        "action": [0, 1, 2, 3, 3],
    }
    assert record.notes[1] == "reward, done have 4 rows, the others 5: left out."


@FORMS
def test_arrays_of_another_length_are_left_out_with_a_note_and_no_command_is_made_up(form, tmp_path):
    arrays = rollout() | {"v": rollout()["v"][:-1]}
    log = load_log(form(tmp_path, arrays), pushed())
    assert log.unmeasured == ("v",)
    assert "v has 30 rows, the others 31: left out." in log.notes
    arrays = rollout() | {"action": rollout()["action"][:-5]}
    with pytest.raises(LogError, match="Left out: action has 25 rows, the others 31") as caught:
        load_log(form(tmp_path, arrays), pushed())
    assert "write as many rows of it" in caught.value.advice
    assert not caught.value.options
    with pytest.raises(LogError, match="Left out: action has 25 rows"):
        load_log(form(tmp_path, arrays), pushed(), columns={"action": "actions"})


def test_actions_of_each_episode_may_be_one_less_than_its_states(tmp_path):
    import h5py

    with h5py.File(tmp_path / "log.h5", "w") as file:
        for run in range(2):
            for name, values in rollout(20 + run).items():
                file[f"run{run}/{name}"] = values
    log = load_log(tmp_path / "log.h5", pushed())
    assert len(log) == 41
    np.testing.assert_array_equal(log.X[:, 2], np.r_[rollout(20)["action"], rollout(21)["action"]])
    assert log.group_names == ("run0", "run1")


def test_dates_and_durations_are_seconds_and_missing_ones_not_measured():
    stamps = np.array(["2024-01-01T00:00:00", "NaT", "2024-01-01T00:00:01.5"], dtype="datetime64[ms]")
    found = numbers(recording({"at": stamps, "since": stamps - stamps[0]}).streams[0])
    assert found["since"] == [0.0, None, 1.5]
    assert found["at"] == [1704067200.0, None, 1704067201.5]
    frame = pd.DataFrame({"at": stamps, "q": [1, 2, 3]})
    assert numbers(recording(frame).streams[0])["at"] == found["at"]


def test_arrays_by_name_are_columns_of_their_elements():
    grid = np.arange(24.0).reshape(3, 2, 4)
    source = {"q": grid[:, :, 0], "deep": grid, "one": 3.0, "short": np.zeros(2), "t": [0, 1, 2]}
    source |= {"word": ["a", None, "b"], "cell": [b" 1.5", "", None]}
    source |= {"film": np.zeros((3, 10_001))}
    record = recording(source)
    assert set(record.notes) == {
        "short has 2 rows, the others 3: left out.",
        "one has no rows: left out.",
        "film has 10001 numbers in a row, more than 10000: left out.",
    }
    (stream,) = record.streams
    found = numbers(stream)
    assert list(found) == [
        "q[0]",
        "q[1]",
        *(f"deep[{place}]" for place in range(8)),
        "t",
        "word",
        "cell",
    ]
    assert (found["q[1]"], found["deep[5]"], found["t"]) == ([4, 12, 20], [5, 13, 21], [0, 1, 2])
    assert (found["word"], found["cell"]) == (["a", None, "b"], [1.5, None, None])
    for nothing, problem in (({"q": np.zeros(0)}, "has no rows"), ({"q": 1.0}, "holds no array with rows")):
        with pytest.raises(LogError, match=problem):
            recording(nothing)
    with pytest.raises(LogError, match="has two columns a"):
        recording(pd.DataFrame([[1, 2]], columns=["a", "a"]))
