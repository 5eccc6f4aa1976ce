"""README's commands and code do what it says, with the arm of its picture."""

import re
import runpy
import shlex
from pathlib import Path

import mujoco
import pytest
from typer.testing import CliRunner

from skat.cli import app

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text("utf-8")
BLOCKS = {kind: re.findall(rf"```{kind}\n(.*?)```", README, re.DOTALL) for kind in ("console", "python")}
COMMANDS = [
    line.removeprefix("$ skat ").partition("#")[0].strip()
    for block in BLOCKS["console"]
    for line in block.splitlines()
    if line.startswith("$ skat ") and "robot.xml" in line
]
OF_A_ROBOT, OF_SAMPLES = (
    next(block for block in BLOCKS["python"] if word in block) for word in ("robot.xml", "rng")
)


# A short log of a robot with the model's own time step, and one effect, is enough to see that the lines run.
QUICK = {"timestep": 0.002, "n_episodes": 6, "n_rows": 24}
LOGS = [QUICK, pytest.param({}, marks=pytest.mark.long, id="as written")]


@pytest.fixture
def arm(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return runpy.run_path(str(ROOT / "docs" / "readme.py"))["write_files"]


def skat(command):
    result = CliRunner().invoke(app, shlex.split(command))
    assert result.exit_code == 0, result.output
    return result.stdout


def test_readme_names_the_commands():
    assert [command.split()[0] for command in COMMANDS] == [
        "effects",
        "check",
        "preflight",
        "diagnose",
        "diagnose",
    ]


def test_effects_of_the_arm_are_listed(arm):
    arm(".", **QUICK)
    assert "dry_friction[elbow]" in skat(COMMANDS[0])


def test_check_of_the_log_says_how_it_is_read(arm):
    arm(".", **QUICK)
    assert "qpos.elbow" in skat(COMMANDS[1] + " --no-preflight")


@pytest.mark.parametrize("log", LOGS)
def test_preflight_of_the_log_shows_the_friction(arm, log):
    arm(".", **log)
    assert "dry_friction[elbow]" in skat(COMMANDS[2] + " --effect dry_friction[elbow]" * bool(log))


@pytest.mark.filterwarnings("ignore:The positions lag:UserWarning")
@pytest.mark.parametrize("log", LOGS)
def test_the_elbows_friction_is_named_and_written_into_a_model_for_plain_mujoco(arm, log):
    arm(".", **log)
    assert "dry_friction[elbow]" in skat(COMMANDS[-1] + " --effect dry_friction[elbow]" * bool(log))
    better = mujoco.MjModel.from_xml_path("better.xml")
    assert better.dof_frictionloss[better.joint("elbow").dofadr[0]] == pytest.approx(0.6, rel=0.1)


@pytest.mark.filterwarnings("ignore:The positions lag:UserWarning")
@pytest.mark.parametrize("log", LOGS)
def test_five_lines_of_python_diagnose_and_write_model_and_report(arm, log):
    arm(".", **log)
    Path("better.xml").write_text("<mujoco/>", "utf-8")  # The commands before them have written one.
    effects = 'effects=["dry_friction[elbow]"], ' if log else ""
    found = {}
    exec(OF_A_ROBOT.replace("random_state", f"{effects}random_state"), found)
    assert "dry_friction[elbow]" in [cause.name for cause in found["diagnosis"].causes_]
    mujoco.MjModel.from_xml_path("better.xml")
    assert "<html" in Path("report.html").read_text("utf-8")


def test_samples_are_carried_onto_their_partners():
    found = {}
    exec(OF_SAMPLES, found)
    assert abs(found["carried"] - found["measured"]).max() < 1e-9


def test_files_that_readme_names_exist():
    for file in re.findall(r"`([\w/]+\.(?:md|rst|txt|py|cff))`|\(([\w/]+\.svg)\)", README):
        assert (ROOT / (file[0] or file[1])).exists(), file
