"""The documented command for each published log reads it as it is, and takes a first look at it."""

import json
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skat.cli import app
from skat.simulators import make_simulator

GUIDE = Path(__file__).parent.parent / "docs" / "user_guide"
COMMANDS = re.findall(r"^ +\$ skat (diagnose .*)$", (GUIDE / "published_logs.rst").read_text(), re.MULTILINE)
# The names in the guide, where the originals lie below $SKAT_DATA_HOME.
ORIGINALS = {
    "data_measured.csv": "pendulum/data_measured.csv",
    "trajectory.csv": "double_pendulum/143339.csv.gz",
    "multisine": "so101/multisine",
    "traj_0.pt": "go2_air/traj_0.pt",
    "ur10_exciting_trajectory.db3": "ur10_bag/ur10_exciting_trajectory.db3",
    "measured.csv": "ricmonk/TVLQR_3xForward_170gm_asymmetricLoad.csv.gz",
    "ricmonk.urdf": "ricmonk/ricmonk.urdf",
}
# Of these a first look takes seconds, at the effects that are most alike.
QUICK = {"pendulum.xml": ["dry_friction[hinge]", "damping[hinge]"]}
# Of each model: what is found in the log, in words of the output.
FOUND = {
    "pendulum.xml": "3999 rows of 0.005 s",
    "double_pendulum.xml": "4999 rows of 0.002 s",
    "so101.xml": "5999 rows of 0.02006",
    "go2.xml": "4697 rows of 0.005 s",
    "ur10.xml": "3440 rows of 0.008 s",
    "ricmonk.urdf": "in 3 episodes",
}


MACHINES = {
    "pendulum.xml": "pendulum",
    "double_pendulum.xml": "double_pendulum",
    "so101.xml": "so101",
    "go2.xml": "go2_air",
    "ur10.xml": "ur10",
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    import os

    home = os.environ.get("SKAT_DATA_HOME")
    if not home:
        pytest.skip("SKAT_DATA_HOME is not set: no measured data on this machine")
    monkeypatch.chdir(tmp_path)
    for name, original in ORIGINALS.items():
        (tmp_path / name).symlink_to(Path(home, original))
    for file, name in MACHINES.items():
        make_simulator(name).to_mjcf(tmp_path / file)
    for columns in GUIDE.glob("*.toml"):
        (tmp_path / columns.name).write_text(columns.read_text())
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS, ids=[command.split()[1] for command in COMMANDS])
def test_a_published_log_is_read_by_its_command(here, command):
    if ".db3" in command:
        pytest.importorskip("rosbags")
    words = shlex.split(command.removesuffix(" --quick").replace("diagnose", "check", 1))
    result = CliRunner().invoke(app, [*words, "--no-preflight"])
    assert result.exit_code == 0, result.output
    assert FOUND[shlex.split(command)[1]] in result.stdout
    channels = [line for line in result.stdout.splitlines() if re.search(r"│ (qpos|qvel|ctrl)\.", line)]
    assert len(channels) >= 3
    assert not [line for line in channels if "not measured" in line and "│ qvel." not in line]


@pytest.mark.parametrize(
    "command",
    [
        *(
            pytest.param(" --effect ".join([command, *QUICK[model]]), id=f"{model}, few effects")
            for command in COMMANDS
            for model in [command.split()[1]]
            if model in QUICK
        ),
        *(pytest.param(command, id=command.split()[1], marks=pytest.mark.long) for command in COMMANDS),
    ],
)
@pytest.mark.filterwarnings("ignore::UserWarning")  # of velocities that lag or were computed
def test_a_first_look_at_a_published_log_is_taken_by_its_command(here, command):
    if ".db3" in command:
        pytest.importorskip("rosbags")
    result = CliRunner().invoke(app, [*shlex.split(command), "--json", "found.json"])
    assert result.exit_code == 0, result.output
    assert "(a first look)" in result.stdout
    found = json.loads((here / "found.json").read_text())
    assert found["first_look"]
    assert found["rows_fitted"] < found["log"]["rows"]
    assert found["verdict"] in ("nothing detected", "named", "ambiguous", "unexplained")
    for cause in found["causes"]:
        assert cause["interval"][0] <= cause["value"] <= cause["interval"][1]


def test_every_measured_log_of_an_arm_has_a_command():
    assert sorted(command.split()[1] for command in COMMANDS) == sorted(FOUND)
