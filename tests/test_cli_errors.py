"""Bad calls of the command line: each ends with one message that says where and what to do, and changes nothing."""

import gzip
import json
import re
import shlex

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from skat.cli import app

MODEL = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0"/>
      <geom name="cart" type="box" size="0.1 0.1 0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="rail"/></actuator>
</mujoco>
"""
INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
LINK = '<link name="{}"><inertial><mass value="1"/>' + INERTIA + "</inertial></link>"
URDF = f"""<robot name="cart"><link name="world"/>{LINK.format("cart")}
<joint name="rail" type="prismatic"><parent link="world"/><child link="cart"/><axis xyz="1 0 0"/>
<limit lower="-9" upper="9" effort="20" velocity="9"/></joint></robot>
"""
UNBOLTED = f"""<robot name="cart">{LINK.format("track")}{LINK.format("cart")}
<joint name="rail" type="prismatic"><parent link="track"/><child link="cart"/><axis xyz="1 0 0"/>
<limit lower="-9" upper="9" effort="20" velocity="9"/></joint></robot>
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    time, push = 0.02 * np.arange(60), rng.normal(size=60)
    speed = np.cumsum(np.r_[0, 0.02 * push[:-1]])
    place = np.cumsum(np.r_[0, 0.02 * speed[1:]])
    columns = {"time": time, "qpos.rail": place, "qvel.rail": speed, "ctrl.push": push}
    log = pd.DataFrame(columns)
    log.to_csv(tmp_path / "log.csv", index=False)
    log.drop(columns="ctrl.push").to_csv(tmp_path / "free.csv", index=False)
    log.head(5).to_csv(tmp_path / "short.csv", index=False)
    log.rename(columns={"qpos.rail": "gps", "qvel.rail": "gps2"}).to_csv(tmp_path / "other.csv", index=False)
    log.rename(columns={"qpos.rail": "x_mm"}).to_csv(tmp_path / "named.csv", index=False)
    log.assign(**{"qvel.rail": "fast"}).to_csv(tmp_path / "text.csv", index=False)
    log.drop(columns="time").to_csv(tmp_path / "untimed.csv", index=False)
    log.assign(**{"qvel.rail": np.nan}).to_csv(tmp_path / "lacking.csv", index=False)
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "head.csv").write_text("time,qpos.rail,qvel.rail,ctrl.push\n")
    (tmp_path / "noise.bin").write_bytes(rng.bytes(2000))
    (tmp_path / "cut.csv.gz").write_bytes(gzip.compress((tmp_path / "log.csv").read_bytes())[:300])
    (tmp_path / "folder").mkdir()
    (tmp_path / "map.toml").write_text("[columns\n")
    for name, text in (("model.xml", MODEL), ("cart.urdf", URDF), ("unbolted.urdf", UNBOLTED)):
        (tmp_path / name).write_text(text)
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody>")
    (tmp_path / "broken.urdf").write_text(URDF.replace('link="world"', 'link="wrold"'))
    found = {"schema": 2, "verdict": "nothing detected", "causes": [], "also_seen": {}}
    for name, content in (("nothing", found), ("old", found | {"schema": 1}), ("list", [])):
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    (tmp_path / "mine.html").write_text("mine")
    (tmp_path / "mine.json").write_text("mine")
    (tmp_path / "mine.toml").write_text("mine")
    (tmp_path / "mine.xml").write_text("mine")
    return tmp_path


# A call; what its message says of the place; what it says to do.
BAD_CALLS = [
    ("diagnose none.xml log.csv", "There is no file none.xml", "Check the path"),
    ("diagnose model.xml none.csv", "There is no file none.csv", "Check the path"),
    ("diagnose model.xml log.csv none.csv", "There is no file none.csv", "Check the path"),
    ("diagnose model.xml log.csv --test none.csv", "There is no file none.csv", "Check the path"),
    ("diagnose broken.xml log.csv", "'broken.xml'", "Correct the MJCF"),
    ("diagnose broken.urdf log.csv", "'broken.urdf'", "Correct it there"),
    ("diagnose folder log.csv", "folder folder", "expected an MJCF (.xml) or URDF file"),
    ("diagnose log.csv log.csv", "log.csv", "Correct the MJCF"),
    ("diagnose unbolted.urdf log.csv", "root link 'track'", "--base"),
    ("check unbolted.urdf log.csv --base loose", "'loose'", "base must be 'fixed' or 'free'"),
    ("diagnose cart.urdf log.csv", "log.csv", "--motors torque"),
    ("diagnose cart.urdf log.csv --motors pid", "'pid'", "position:kp,kv"),
    ("diagnose model.xml log.csv --motors torque", "1 actuators of its own", "models without any"),
    ("check model.xml other.csv", "other.csv", "--map"),
    ("check model.xml free.csv", "ctrl.push", "--map 'ctrl.*=0'"),
    ("check model.xml short.csv", "short.csv", "Record longer"),
    ("check model.xml text.csv", "text.csv", "qvel.rail"),
    ("check model.xml empty.csv", "empty.csv: is not a CSV table", "A CSV table has a line of names"),
    ("check model.xml head.csv", "head.csv: has no rows below its first line", "at least 20 rows"),
    ("check model.xml noise.bin", "noise.bin", "Formats that are read: CSV"),
    ("check model.xml cut.csv.gz", "cut.csv.gz: is cut or damaged", "Copy the file anew"),
    ("check model.xml folder", "folder", "Formats that are read: CSV"),
    ("check model.xml log.csv --map qpos.rail", "qpos.rail", "NAME=THEIRS"),
    ("check model.xml log.csv --map qpos.rial=time", "qpos.rial", "qpos.rail"),
    ("check model.xml log.csv --map qpos.rail=place", "place", "qpos.rail"),
    ("check model.xml log.csv --map qpos.rail=qpos.rail:parsec", "parsec", "mm"),
    ("check model.xml log.csv --columns none.toml", "none.toml", "Check the path"),
    ("check model.xml log.csv --columns map.toml", "map.toml", "qpos.elbow"),
    ("check model.xml log.csv --rate 0", "rate", "positive"),
    ("check model.xml log.csv --rate 50 --frame-skip 4", "--rate and --frame-skip", "one of them"),
    ("check model.xml log.csv --episodes run", "run", "gaps"),
    ("diagnose model.xml log.csv --report mine.html", "mine.html exists", "--force"),
    ("diagnose model.xml log.csv --json mine.json", "mine.json exists", "--force"),
    ("diagnose model.xml log.csv --extended mine.xml", "mine.xml exists", "--force"),
    ("check model.xml log.csv --save-map mine.toml", "mine.toml exists", "--force"),
    ("diagnose model.xml log.csv --report no/new.html", "no folder no", "Make it first"),
    (
        "diagnose model.xml log.csv -o same.out --json ./same.out",
        "same.out is given for two",
        "Choose another",
    ),
    ("diagnose model.xml log.csv --save-map q --json q", "q is given for two outputs", "Choose another name"),
    (
        "diagnose model.xml log.csv --json log-report.html",
        "log-report.html is given for two",
        "Choose another",
    ),
    (
        "diagnose model.xml log.csv --extended b.xml --json b.effects.json",
        "b.effects.json is given for two",
        "Choose another name",
    ),
    ("experiment puck -o p.png --plot p.png", "p.png is given for two outputs", "Choose another name"),
    ("diagnose model.xml log.csv --test ./log.csv", "--test log.csv: this log is fitted", "--test-size"),
    ("diagnose model.xml log.csv folder/../log.csv", "log.csv is given 2 times", "each log once"),
    ("diagnose model.xml log.csv ./log.csv --table t.csv", "log.csv is given 2 times", "each log once"),
    ("diagnose model.xml log.csv --test a.csv --test a.csv", "a.csv is given 2 times", "each log once"),
    ("check model.xml log.csv ./log.csv", "log.csv is given 2 times", "each log once"),
    ("preflight model.xml log.csv ./log.csv", "log.csv is given 2 times", "each log once"),
    ("diagnose model.xml log.csv --extended better.txt", "better.txt", "ends in .xml"),
    ("diagnose model.xml log.csv --extended better.urdf", "better.urdf", "where MODEL is one"),
    ("diagnose model.xml log.csv --jobs 0", "n_jobs", "--jobs"),
    ("diagnose model.xml log.csv --alpha 2", "alpha", "between 0 and 1"),
    ("diagnose model.xml log.csv --effect dumping[rail]", "dumping[rail]", "damping[rail]"),
    ("preflight model.xml named.csv --map qpos.rail=-", "lacks qpos.rail", "simulator.rollout"),
    ("compare nothing.json", "two logs or more", "got 1"),
    ("compare nothing.json nothing.json", "'nothing.json' is there 2 times", "must differ"),
    ("compare nothing.json none.json", "There is no file none.json", "Check the path"),
    ("compare nothing.json log.csv", "log.csv is no JSON", "skat diagnose --json"),
    ("compare nothing.json noise.bin", "noise.bin is no JSON", "skat diagnose --json"),
    ("compare nothing.json list.json", "list.json", "skat diagnose --json"),
    ("compare nothing.json old.json", "old.json is of schema 1", "diagnose the log again"),
    ("compare nothing.json old.json -o mine.toml", "mine.toml exists", "--force"),
    ("effects unbolted.urdf", "root link 'track'", "--base"),
]


@pytest.mark.parametrize(("call", "place", "remedy"), BAD_CALLS, ids=[call for call, _, _ in BAD_CALLS])
def test_a_bad_call_ends_with_place_and_remedy_and_changes_nothing(here, call, place, remedy):
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    result = CliRunner().invoke(app, shlex.split(call))
    assert result.exit_code == 2, result.output
    assert isinstance(result.exception, SystemExit)
    assert "Traceback" not in result.output
    message = result.stderr.splitlines()[-1]
    assert message.startswith("Error: ")
    assert place in message
    assert remedy in message
    assert {path: path.read_bytes() for path in here.rglob("*") if path.is_file()} == before


# What a message says to add, as it is written there.
REMEDY = re.compile(
    r"on the command line (--\w+ (?:'[^']*'|[^\s;)]+?))(?=[;)]|\.?$| --)|overwrite it with (--force)"
)
CURED = [
    ("check unbolted.urdf log.csv", 3),
    ("check cart.urdf log.csv", 2),
    ("check model.xml other.csv", 1),
    ("check model.xml free.csv", 1),
    ("check model.xml log.csv --episodes run", 1),
    ("check model.xml log.csv --save-map mine.toml", 1),
    ("check model.xml lacking.csv", 1),
]


@pytest.mark.parametrize(("call", "most"), CURED, ids=[call for call, _ in CURED])
def test_the_remedies_in_the_messages_lead_to_a_log_that_is_read(here, call, most):
    arguments = [*shlex.split(call), "--no-preflight"]
    said = []
    for _ in range(most + 1):
        result = CliRunner().invoke(app, [*arguments, *said])
        if result.exit_code == 0:
            break
        told = REMEDY.findall(result.stderr.splitlines()[-1])
        assert told, result.stderr
        said += shlex.split("".join(told[-1]))
    assert result.exit_code == 0, (said, result.output)
    assert said


def test_remedies_of_a_urdf_work(here):
    for call in (
        "check cart.urdf log.csv --motors torque --no-preflight",
        "check cart.urdf log.csv --motors position:20,1 --no-preflight",
        "check cart.urdf log.csv --motors none --no-preflight",
        "check unbolted.urdf log.csv --base fixed --motors torque --no-preflight",
        "check model.xml free.csv --map 'ctrl.*=0' --no-preflight",
    ):
        arguments = shlex.split(call)
        if "urdf" in call:  # its motor has the joint's name
            arguments += ["--map", "ctrl.*=ctrl.push"] if "none" not in call else []
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0, (call, result.output)


def test_findings_for_programs_have_the_documented_fields(here):
    log = pd.read_csv("log.csv")
    log["qpos.rail"] += 0.001 * np.random.default_rng(1).normal(size=len(log))
    log["qvel.rail"] = np.gradient(log["qpos.rail"], 0.02)
    log.to_csv("log.csv", index=False)
    log.drop(5).to_csv("other.csv", index=False)
    call = "diagnose model.xml log.csv --effect damping[rail] --json found.json --test other.csv --save-map used.toml"
    result = CliRunner().invoke(app, shlex.split(call))
    assert result.exit_code == 0, result.output
    lost = "1 of 60 rows are lost (0.017 of them): not measured there, commands held."
    told = result.stdout.splitlines()
    assert told[told.index("other.csv:") + 1].strip() == lost
    found = json.loads((here / "found.json").read_text())
    assert found["schema"] == 2
    assert found["verdict"] in ("nothing detected", "named", "ambiguous", "unexplained")
    assert set(found["log"]) == {"source", "rows", "episodes", "dt", "matches", "notes", "test"}
    assert found["log"]["rows"] == 59
    assert found["log"]["test"] == "other.csv"
    assert f"other.csv: {lost}" in found["log"]["notes"]
    assert found["computed_velocities"] == ["qvel.rail"]
    assert set(found["noise"]) == {"qpos.rail"}
    guide = documented_fields()
    assert set(found) == set(guide)
    assert '"qpos.rail" = "qpos.rail"' in (here / "used.toml").read_text()
    again = CliRunner().invoke(app, shlex.split("check model.xml log.csv --columns used.toml --no-preflight"))
    assert again.exit_code == 0, again.output


def documented_fields():
    from pathlib import Path

    text = (Path(__file__).parent.parent / "docs" / "user_guide" / "findings.rst").read_text()
    return [line.strip().strip("`") for line in text.splitlines() if re.fullmatch("``[a-z_]+``", line)]
