"""Whether actions are commands or efforts that were measured: a log says so by where they stand."""

import json

import numpy as np
import pandas as pd
import pytest
from mcap.writer import Writer

from skat.logs import joined, load_log
from skat.simulators import MujocoSimulator
from tests.diagnosis.forces.test_force_space import ARM, JOINTS


@pytest.fixture(scope="module")
def simulator():
    return MujocoSimulator(ARM, frame_skip=5)


def recording(folder, topics=("/joint_states", "/commands")):
    """Write positions with efforts beside them, and commands of a topic of their own."""
    rng = np.random.default_rng(0)
    with (folder / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("arm", "jsonschema", b'{"type": "object"}')
        channels = [writer.register_channel(topic, "json", schema) for topic in topics]
        for row in range(60):
            state = {"name": list(JOINTS), "position": np.sin([row / 9, row / 7]).tolist()}
            state["effort"] = rng.normal(size=2).tolist()
            for channel, message in zip(channels, (state, {"data": rng.normal(size=2).tolist()})):
                stamp = row * 10_000_000
                writer.add_message(channel, stamp, json.dumps(message).encode(), stamp)
        writer.finish()
    return folder / "log.mcap"


def test_efforts_of_the_messages_with_the_positions_were_measured(simulator, tmp_path):
    path = recording(tmp_path)
    log = load_log(path, simulator, columns={"ctrl.*": "/joint_states.effort"})
    assert log.actions == "measured"
    assert any("so were measured" in note for note in log.notes)
    assert load_log(path, simulator, columns={"ctrl.*": "/commands.data"}).actions == "commanded"


def test_a_table_does_not_say_and_is_taken_for_commands(simulator):
    columns = {
        f"{kind}.{joint}": np.sin(np.arange(60) / 9) for kind in ("qpos", "effort") for joint in JOINTS
    }
    told = {f"ctrl.{joint}": f"effort.{joint}" for joint in JOINTS}
    log = load_log(pd.DataFrame(columns), simulator, columns=told)
    assert log.actions == "commanded"


def test_logs_of_both_kinds_are_not_diagnosed_together(simulator, tmp_path):
    path = recording(tmp_path)
    logs = [
        load_log(path, simulator, columns={"ctrl.*": name})
        for name in ("/joint_states.effort", "/commands.data")
    ]
    with pytest.raises(ValueError, match="all measured efforts, or all commands"):
        joined(logs)
