"""The command line: what it prints, what it writes, and how it ends when the input is wrong."""

import json
import re
import subprocess
import sys
import warnings
from hashlib import sha256

import mujoco
import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from skat.cli import app
from skat.cli.many import _show, _time_of
from skat.cli.terminal import clear_errors, heard
from skat.simulators import MujocoSimulator
from tests.diagnosis.forces.test_force_space import ARM, log_of
from tests.diagnosis.pages import Page, blank_frames

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


def measured_cart(n_episodes=8, n_rows=15, damping=0.6, noise=1e-4, seed=0):
    """A log of the cart in a world with viscous friction, which the model has not."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    model.dof_damping[:] = damping
    rows = measured_states(model, np.random.default_rng(seed), n_episodes, n_rows, noise)
    return rows.set_axis(["time", "episode", "qpos.rail", "qvel.rail", "ctrl.push"], axis=1)


def measured_states(model, rng, n_episodes=6, n_rows=40, noise=1e-4):
    rows = []
    for episode in range(n_episodes):
        data = mujoco.MjData(model)
        data.qvel[0] = rng.normal()
        for row in range(n_rows):
            data.ctrl[:] = round(rng.uniform(-3, 3), 3)
            state = np.concatenate([data.qpos, data.qvel])
            state += noise * rng.normal(size=len(state))
            rows.append([round(0.02 * row, 2), episode, *state, data.ctrl[0]])
            for _ in range(4):
                mujoco.mj_step(model, data)
    return pd.DataFrame(rows)


@pytest.fixture
def drawing(tmp_path, monkeypatch):
    """The folder with a model and a log; reports have pictures of the robot where there is OpenGL."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SKAT_DATA_HOME", raising=False)
    (tmp_path / "model.xml").write_text(MODEL)
    measured_cart().to_csv(tmp_path / "log.csv", index=False)
    return tmp_path


@pytest.fixture
def here(drawing, monkeypatch):
    """The same folder; reports have blank pictures."""
    monkeypatch.setattr("skat.replay.frames", blank_frames)
    return drawing


def skat(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def refused(*arguments):
    """Run a command that must end with exit code 2 and one message; return the message."""
    result = skat(*arguments)
    assert result.exit_code == 2, result.output
    assert isinstance(result.exception, SystemExit)
    assert "Traceback" not in result.output

    *stages, message = result.stderr.splitlines()
    assert all(stage.endswith(" ...") for stage in stages)
    assert message.startswith("Error: ")
    return message


def edited(here, **columns):
    """Write the log with some columns replaced, None to drop one, and return its path."""
    log = pd.read_csv(here / "log.csv")
    for name, values in columns.items():
        log = log.drop(columns=name) if values is None else log.assign(**{name: values})
    log.to_csv(here / "edited.csv", index=False)
    return here / "edited.csv"


def test_help_names_the_commands():
    result = skat("--help")
    assert result.exit_code == 0
    for command in ("demo", "diagnose", "compare", "effects", "preflight", "transport", "experiment"):
        assert command in result.stdout


def test_why_logs_are_unexplained_is_said(here):
    (here / "arm.xml").write_text(ARM)
    names = ["qpos.shoulder", "qpos.elbow", "qvel.shoulder", "qvel.elbow", "ctrl.shoulder", "ctrl.elbow"]
    for month, seed in (("june", 4), ("july", 5)):
        rows = pd.DataFrame(log_of(seed, friction=(0.12, 0.06))[0], columns=names)
        if month == "july":
            rows[names[4:]] = rows[names[:3:-1]].to_numpy()
        rows.assign(time=0.01 * rows.index).to_csv(here / f"{month}.csv", index=False)
    effects = ("--effect", "damping[elbow]", "--effect", "gain[elbow]")
    result = skat("changed", "arm.xml", "june.csv", "july.csv", *effects)
    assert result.exit_code == 0, result.output
    assert "Verdict: unexplained" in result.stdout
    assert "The log after reads as if ctrl.shoulder and ctrl.elbow are swapped." in result.stdout
    assert "by more than what the model misses" not in result.stdout
    assert "ctrl.shoulder and ctrl.elbow are swapped" in result.stderr


def test_where_nothing_changed_it_is_said_what_would_have_been_told(here):
    (here / "arm.xml").write_text(ARM)
    names = ["qpos.shoulder", "qpos.elbow", "qvel.shoulder", "qvel.elbow", "ctrl.shoulder", "ctrl.elbow"]
    rows = pd.DataFrame(log_of(4, rows=600, friction=(0.12, 0.06))[0], columns=names)
    rows.assign(time=0.01 * rows.index).to_csv(here / "june.csv", index=False)
    rows.assign(time=0.01 * rows.index, fan=1).to_csv(here / "july.csv", index=False)
    effects = ("--effect", "damping[elbow]", "--effect", "gain[elbow]", "--effect", "delay[action]")
    result = skat("changed", "arm.xml", "june.csv", "july.csv", *effects)
    assert result.exit_code == 0, result.output
    assert "july.csv:\n  Left aside: fan." in result.stdout
    assert "Verdict: nothing changed" in result.stdout
    assert re.search(r"gain\[elbow\] +│ [\d.]+ %", result.stdout)
    assert re.search(r"damping\[elbow\] +│ [\d.]+ N m s/rad", result.stdout)


def test_help_loads_nothing_heavy():
    code = (
        "import sys\nfrom skat.cli import app\n"
        "heavy = {'mujoco', 'matplotlib', 'ot', 'gymnasium', 'sklearn', 'scipy', 'numpy', 'pandas'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_diagnose_names_the_hidden_friction_and_writes_a_report(drawing):
    measured_cart(n_episodes=6, n_rows=40).to_csv(drawing / "log.csv", index=False)
    result = skat("diagnose", "model.xml", "log.csv", "--effect", "damping[rail]", "--effect", "mass[cart]")
    assert result.exit_code == 0, result.output
    assert "(95 %: " in result.stdout
    assert "% of the excess is explained (95 %: " in result.stdout
    for method in ("AffineTransport", "ProcrustesAffineTransport", "CORAL", "ExactTransport", "extended"):
        assert method in result.stdout
    report = Page((drawing / "log-report.html").read_text())
    assert "damping[rail]" in report.text
    assert any("line measured" in plot["roles"] for plot in report.plots)
    assert "the green ghost is what was measured" in report.text or "No picture of the robot" in report.text
    for told in (
        "model.xml against log.csv",
        sha256((drawing / "log.csv").read_bytes()).hexdigest(),
        "SHA-256",
    ):
        assert told in report.text


def test_a_first_look_says_that_it_is_one(here):
    measured_cart(n_episodes=20).to_csv(here / "long.csv", index=False)
    effects = ("--effect", "damping[rail]", "--effect", "mass[cart]")
    result = skat("diagnose", "model.xml", "long.csv", "--quick", *effects, "--json", "found.json")
    assert result.exit_code == 0, result.output
    assert "Log: named (a first look)" in result.stdout
    assert "A first look, at 160 of " in result.stdout
    assert "damping[rail]" in result.stdout
    found = json.loads((here / "found.json").read_text())
    assert (found["verdict"], found["first_look"], found["rows_fitted"]) == ("named", True, 160)
    assert found["gain"]["extended"] < found["gain"]["nominal"]
    assert "A first look, at 160 of " in Page((here / "long-report.html").read_text()).text


def test_several_logs_have_a_noise_each_and_share_their_causes(here):
    for month, seed in (("june", 0), ("july", 1)):
        measured_cart(damping=0.6, seed=seed).to_csv(here / f"{month}.csv", index=False)
    result = skat(
        "diagnose", "model.xml", "june.csv", "july.csv", "--effect", "damping[rail]", "--json", "both.json"
    )
    assert result.exit_code == 0, result.output
    assert "On damping[rail] the logs agree (p = " in result.stdout
    found = json.loads((here / "both.json").read_text())
    assert [one["name"] for one in found["logs"]] == ["june.csv", "july.csv"]
    assert [one["cause"] for one in found["agreement"]] == ["damping[rail]"]


def test_logs_of_one_robot_are_shown_side_by_side(here):
    for month, damping, seed in (("june", 0.6, 0), ("july", 0.6, 1), ("august", 0.8, 2)):
        measured_cart(damping=damping, seed=seed).to_csv(here / f"{month}.csv", index=False)
        call = (
            "diagnose",
            "model.xml",
            f"{month}.csv",
            "--effect",
            "damping[rail]",
            "--json",
            f"{month}.json",
        )
        assert skat(*call).exit_code == 0
    alike = skat("compare", "june.json", "july.json")
    assert alike.exit_code == 0, alike.output
    assert re.search(r"damping\[rail\]: the logs agree \(p = [\d.]+\)", alike.stdout)

    result = skat("compare", "june.json", "july.json", "august.json", "-o", "all.csv")
    assert result.exit_code == 0, result.output
    assert re.search(r"july +│ july\.csv +│ +112 │ named +│ \d+ %", result.stdout)
    assert "damping[rail]: the logs differ (p < 1e-09)" in result.stdout
    (row,) = pd.read_csv(here / "all.csv").to_dict("records")
    (cause,) = json.loads((here / "august.json").read_text())["causes"]
    assert (row["unit"], row["agreement"], row["status in august"]) == ("N s/m", "differ", "named")
    assert [row["low in august"], row["high in august"]] == pytest.approx(cause["interval"], rel=1e-12)


def findings(here, path, model="model.xml", gain=None, **causes):
    """Write findings by hand: of each cause the value, with an interval of .1 to both sides."""
    content = {
        "schema": 2,
        "model": model,
        "verdict": "ambiguous",
        "first_look": True,
        "rows_fitted": 40,
        "gain": gain,
        "also_seen": {"wind[x]": 0.5},
        "causes": [
            {
                "name": f"damping[{name}]",
                "unit": "N s/m",
                "value": value,
                "interval": [value - 0.1, value + 0.1],
                "aliases": [{"name": "mass[cart]", "probability": 0.2}],
            }
            for name, value in causes.items()
        ],
    }
    (here / path).parent.mkdir(exist_ok=True)
    (here / path).write_text(json.dumps(content))


def test_files_of_one_name_are_told_apart_by_their_folders_and_other_models_are_warned_of(here):
    gain = {"nominal": 9.0, "extended": 2.0, "floor": 1.0, "explained": 0.875, "interval": [0.8, 0.95]}
    findings(here, "june/found.json", gain=gain, rail=0.6)
    findings(here, "july/found.json", model="then.xml", gain=gain | {"nominal": 1.0}, rail=0.6, hinge=0.2)
    findings(here, "none.json", gain=gain | {"interval": [None, None]})
    result = skat("compare", "june/found.json", "july/found.json", "none.json")
    assert result.exit_code == 0, result.output
    assert (
        "Warning: These findings are of models with different paths: june/found.json of model.xml"
        in result.stderr
    )
    assert re.search(
        r"june/found\.json +│ +│ +40 │ ambiguous \(a first look\) │ 88 % \(80 to 95 %\)", result.stdout
    )
    assert re.search(r"july/found\.json .*│ there is none", result.stdout)
    assert re.search(r"none .*│ 88 % \(no interval\)", result.stdout)
    assert re.search(
        r"damping\[rail\] +│ N s/m │ 0\.6 \(0\.5 to 0\.7\) │ 0\.6 \(0\.5 to 0\.7\) +│ - ", result.stdout
    )
    agreed = "damping[rail]: june/found.json and july/found.json agree (p = 1); not named in none"
    assert agreed in result.stdout
    assert "damping[hinge]: named in july/found.json alone" in result.stdout


def test_what_another_log_names_is_shown_as_an_alias_or_as_also_seen(here):
    findings(here, "june.json", rail=0.6)
    mass = json.loads((here / "june.json").read_text())
    for name in ("mass[cart]", "wind[x]"):
        mass["causes"].append(mass["causes"][0] | {"name": name, "aliases": []})
    (here / "july.json").write_text(json.dumps(mass | {"gain": {"explained": None}}))
    result = skat("compare", "june.json", "july.json")
    assert result.exit_code == 0, result.output
    assert re.search(r"mass\[cart\] +│ N s/m │ - \(alias of damping\[rail\]\)", result.stdout)
    assert re.search(r"wind\[x\] +│ N s/m │ 0\.5 \(also seen\)", result.stdout)
    assert "mass[cart]: named in july alone; alias of damping[rail] in june" in result.stdout
    assert result.stdout.count("not measured") == 2


def test_where_no_log_names_a_cause_it_is_said(here):
    findings(here, "june.json")
    findings(here, "july.json")
    result = skat("compare", "june.json", "july.json", "-o", "all.csv")
    assert result.exit_code == 0, result.output
    assert "No log names a cause." in result.stdout
    assert (here / "all.csv").read_text().startswith("cause,unit,value in june")


@pytest.mark.parametrize(("said", "left_out"), [("measured", []), ("computed", ["qvel.rail"])])
def test_the_user_says_whether_velocities_were_computed(here, said, left_out):
    result = skat(
        "diagnose",
        "model.xml",
        "log.csv",
        "--velocities",
        said,
        "--effect",
        "damping[rail]",
        "--json",
        "found.json",
    )
    assert result.exit_code == 0, result.output
    assert json.loads((here / "found.json").read_text())["computed_velocities"] == left_out


def test_velocities_are_one_of_three(here):
    result = skat("diagnose", "model.xml", "log.csv", "--velocities", "guessed")
    assert result.exit_code == 2
    assert "'auto', 'measured', 'computed'" in result.stderr


def test_warnings_are_shown_and_remembered_for_the_report(capsys):
    with clear_errors(), heard() as said:
        warnings.warn("the clock is uneven", UserWarning, stacklevel=1)
    assert said == ["the clock is uneven"]
    assert "Warning: the clock is uneven" in capsys.readouterr().err


def test_warnings_name_options_of_the_command_line_and_not_arguments_of_python(capsys):
    with clear_errors(), heard() as said:
        warnings.warn("pass velocities='measured' or name them in hidden=.", UserWarning, stacklevel=1)
    assert "pass --velocities measured or name them by --hidden." in capsys.readouterr().err
    assert said == ["pass velocities='measured' or name them in hidden=."]


def test_a_column_that_was_guessed_is_hidden_from_the_diagnosis(here):
    guessed = edited(here, **{"qvel.rail": np.zeros(120)})
    result = skat("diagnose", "model.xml", guessed, "--hidden", "qvel.rail", "--effect", "damping[rail]")
    assert result.exit_code == 0, result.output
    assert "Log: named" in result.stdout
    assert "Error of whole episodes on data not used" in result.stdout
    assert "trajectory error, all measured channels, m, on data not used: " in result.stdout
    assert "qpos.rail:" not in result.stdout
    assert (here / "edited-report.html").exists()


def test_preflight_says_what_a_log_would_show_and_what_nothing_in_it_tells_apart(here):
    names = ("mass[cart]", "gain[push]", "damping[rail]", "dry_friction[rail]", "gravity")
    chosen = [word for name in names for word in ("--effect", name)]
    result = skat("preflight", "model.xml", "log.csv", *chosen, "-o", "table.csv")
    assert result.exit_code == 0, result.output
    assert "Not shown within their bounds: gravity" in result.stdout
    table = pd.read_csv(here / "table.csv", index_col="effect", keep_default_na=False)
    assert list(table.index) == list(names)
    # A world with a damping of 0.6 N s/m was measured, which such a log shows well.
    assert 0.001 < table.loc["damping[rail]", "smallest"] < 0.06
    assert table.loc["mass[cart]", "nearest_alias"] == "gain[push]"
    assert table.loc["mass[cart]", "separating_excitation"] == "nothing in these rows"
    assert table.loc["dry_friction[rail]", "nearest_alias"] == "damping[rail]"
    assert "table.csv exists" in refused("preflight", "model.xml", "log.csv", "-o", "table.csv")
    assert "nonsense" in refused("preflight", "model.xml", "log.csv", "--effect", "nonsense")
    assert not list(here.glob("*.html"))


def test_channels_of_different_units_are_told_one_by_one(here):
    pole = '<body name="pole"><joint name="hinge" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.5" mass="0.2"/></body>'
    (here / "model.xml").write_text(MODEL.replace("</body>", f"{pole}</body>"))
    model = mujoco.MjModel.from_xml_path("model.xml")
    model.dof_damping[:] = 0.6, 0.0
    rng = np.random.default_rng(0)
    names = ["time", "episode", "qpos.rail", "qpos.hinge", "qvel.rail", "qvel.hinge", "ctrl.push"]
    measured_states(model, rng, n_rows=15).set_axis(names, axis=1).to_csv(here / "log.csv", index=False)
    hidden = ("--hidden", "qvel.rail", "--hidden", "qvel.hinge")
    result = skat("diagnose", "model.xml", "log.csv", *hidden, "--effect", "damping[rail]")
    assert result.exit_code == 0, result.output
    assert (
        "trajectory error, all measured channels together, whose units differ, on data not used: "
        in result.stdout
    )
    assert re.search(r"^  qpos.rail: \S+ m before, \S+ m after$", result.stdout, re.MULTILINE)
    assert re.search(r"^  qpos.hinge: \S+ rad before, \S+ rad after$", result.stdout, re.MULTILINE)


def test_effects_are_listed_with_unit_and_range(here):
    result = skat("effects", "model.xml")
    assert result.exit_code == 0, result.output
    rows = {
        row[1]: row[2:7]
        for row in (re.split(r" *[│┃] *", line) for line in result.stdout.splitlines())
        if row[3:]
    }
    assert rows.pop("effect") == ["unit", "neutral", "lowest", "highest", "meaning"]
    effects = MujocoSimulator(here / "model.xml").effects()
    assert list(rows) == [effect.name for effect in effects]
    assert rows["mass[cart]"] == ["1", "1", "0.05", "20", "the mass of cart"]
    assert all(row[-1] and row[-1] != name for name, row in rows.items()), rows
    longer = skat("effects", "model.xml", "--frame-skip", 4).stdout
    assert longer != result.stdout
    assert "backlash[rail]" not in result.stdout
    assert "backlash[rail]" in skat("effects", "model.xml", "--all").stdout
    assert "There is no file none.xml" in refused("effects", "none.xml")


def test_extended_model_is_one_that_mujoco_loads(here):
    result = skat(
        "diagnose",
        "model.xml",
        "log.csv",
        "--effect",
        "damping[rail]",
        "--extended",
        "better.xml",
        "-o",
        "r.html",
    )
    assert result.exit_code == 0, result.output
    damping = mujoco.MjModel.from_xml_path(str(here / "better.xml")).dof_damping
    np.testing.assert_allclose(np.ravel(damping)[0], 0.6, atol=0.02)


CART_URDF = """<robot name="cart">
  <link name="world"/>
  <link name="cart">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="rail" type="prismatic">
    <parent link="world"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-100" upper="100" effort="20" velocity="9"/>
  </joint>
</robot>
"""


def test_a_urdf_in_gives_a_urdf_out_with_one_element_more(here):
    (here / "cart.urdf").write_text(CART_URDF)
    call = ("diagnose", "cart.urdf", "log.csv", "--motors", "torque", "--map", "ctrl.rail=ctrl.push")
    result = skat(*call, "--effect", "damping[rail]", "--extended", "better.urdf", "--json", "found.json")
    assert result.exit_code == 0, result.output
    assert "Added a torque motor on rail; limits of effort: rail 20." in result.stdout
    better = (here / "better.urdf").read_text()
    value = float(re.search(r'<dynamics damping="([\d.]+)"/>', better)[1])
    assert value == pytest.approx(0.6, abs=0.02)
    assert re.sub(r"\s*<dynamics[^>]*>", "", better).split() == CART_URDF.split()
    found = json.loads((here / "found.json").read_text())
    assert found["causes"][0]["name"] == "damping[rail]"
    assert found["causes"][0]["value"] == pytest.approx(value)
    assert found["extended"] == "better.urdf"


def test_a_second_report_gets_another_name_unless_one_is_given(here):
    (here / "log-report.html").write_text("mine")
    (here / "r.html").write_text("mine")
    assert "r.html exists" in refused("diagnose", "model.xml", "log.csv", "-o", "r.html")
    arguments = ("diagnose", "model.xml", "log.csv", "--effect", "damping[rail]", "--test-size", "0")
    assert skat(*arguments).exit_code == 0
    assert (here / "log-report.html").read_text() == "mine"
    assert (here / "log-report-2.html").exists()
    assert skat(*arguments, "-o", "r.html", "--force").exit_code == 0
    assert "damping[rail]" in Page((here / "r.html").read_text()).text


@pytest.mark.parametrize("missing", ["model.xml", "log.csv"])
def test_a_missing_file_is_named(here, missing):
    (here / missing).unlink()
    assert f"There is no file {missing}" in refused("diagnose", "model.xml", "log.csv")


def test_a_broken_model_is_refused_with_mujocos_reason(here):
    (here / "model.xml").write_text(
        "<mujoco><worldbody><body><joint type='slip'/></body></worldbody></mujoco>"
    )
    message = refused("diagnose", "model.xml", "log.csv")
    assert "slip" in message or "type" in message


@pytest.mark.parametrize("text", ["", "<mujoco>", "no xml at all"])
def test_a_file_that_is_no_model_is_refused(here, text):
    (here / "model.xml").write_text(text)
    assert "model.xml" in refused("diagnose", "model.xml", "log.csv")


def test_what_a_log_lacks_is_not_measured_and_what_nobody_uses_is_left_aside(here):
    renamed = edited(here, **{"qvel.rail": None, "qvel.track": 0.0})
    result = skat("check", "model.xml", renamed)
    assert result.exit_code == 0, result.output
    assert "Left aside: qvel.track." in result.stdout
    assert re.search(r"qvel.rail .* not measured", result.stdout)
    assert "What such a log could show is not told here: it lacks qvel.rail." in result.stdout


def test_a_text_is_refused_with_its_line(here):
    values = pd.read_csv(here / "log.csv")["qvel.rail"].astype(object)
    values[7] = "fast"
    message = refused("check", "model.xml", edited(here, **{"qvel.rail": values}))
    assert "line 9" in message
    assert "qvel.rail" in message


def test_too_few_rows_are_refused(here):
    pd.read_csv(here / "log.csv").head(15).to_csv(here / "short.csv", index=False)
    assert "14 transitions in 1 episodes; at least 20 are needed" in refused(
        "diagnose", "model.xml", "short.csv"
    )


@pytest.mark.parametrize(("every", "has_whole_rows"), [(17, True), (2, False)])
def test_rows_with_a_missing_reading_tell_of_the_rest(here, every, has_whole_rows):
    table = pd.read_csv(here / "log.csv")
    table.loc[1::every, "qvel.rail"] = np.nan
    table.to_csv(here / "lost.csv", index=False)
    result = skat("diagnose", "model.xml", "lost.csv", "--json", "found.json")
    assert result.exit_code == 0, result.output
    found = json.loads((here / "found.json").read_text())
    assert [cause["name"] for cause in found["causes"]] == ["damping[rail]"]
    assert ("One-step error" in result.stdout) == has_whole_rows  # as maps need them


def test_a_lost_row_is_told(here):
    time = pd.read_csv(here / "log.csv")["time"]
    time[10:15] += 0.02
    result = skat("check", "model.xml", edited(here, time=time))
    assert result.exit_code == 0, result.output
    assert "rows are lost" in result.stdout


def test_an_unknown_effect_is_refused_with_those_that_exist(here):
    message = refused("diagnose", "model.xml", "log.csv", "--effect", "dumping[rail]")
    assert "dumping[rail]" in message
    assert "damping[rail]" in message


def test_an_unknown_ball_is_refused_before_any_download(here):
    assert "no ball 'Football'" in refused("demo", "ball-drops", "--ball", "Football")


def test_an_unknown_command_or_option_is_refused(here):
    for arguments in (("diagnoze",), ("diagnose", "model.xml"), ("experiment", "walker")):
        result = skat(*arguments)
        assert result.exit_code == 2
        assert "Traceback" not in result.output


def test_in_a_process_of_its_own_an_error_is_one_message_and_exit_code_2(here):
    result = subprocess.run(
        [sys.executable, "-m", "skat", "diagnose", "model.xml", "nothing.csv"],
        cwd=here,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2

    assert result.stderr == "Error: There is no file nothing.csv; expected a log. Check the path.\n"


def write_samples(here, seed=0):
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(400, 2))
    pd.DataFrame(source, columns=["a", "b"]).to_csv(here / "source.csv", index=False)
    pd.DataFrame(source * [2, 0.5] + [3, -1], columns=["a", "b"])[["b", "a"]].to_csv(
        here / "target.csv", index=False
    )


@pytest.mark.parametrize("method", ["affine", "procrustes"])
def test_transport_carries_the_source_onto_the_target(here, method):
    write_samples(here)
    result = skat("transport", "source.csv", "target.csv", "-o", "out.csv", "--method", method)
    assert result.exit_code == 0, result.output
    moved, target = pd.read_csv(here / "out.csv"), pd.read_csv(here / "target.csv")
    assert list(moved.columns) == ["a", "b"]
    np.testing.assert_allclose(moved[["a", "b"]], target[["a", "b"]], atol=0.1)
    np.testing.assert_allclose(moved.cov(), target[["a", "b"]].cov(), rtol=1e-9, atol=1e-9)


def test_transport_leaves_the_time_and_the_episode_alone(here):
    write_samples(here)
    source = pd.read_csv(here / "source.csv")
    source.insert(0, "time", 0.1 * np.arange(len(source)))
    source["episode"] = "01"
    source.to_csv(here / "source.csv", index=False)
    pd.read_csv(here / "target.csv").assign(time=7.5).to_csv(here / "target.csv", index=False)
    assert skat("transport", "source.csv", "target.csv", "-o", "out.csv").exit_code == 0
    moved = pd.read_csv(here / "out.csv", dtype=str)
    assert list(moved.columns) == ["time", "episode", "a", "b"]
    assert (moved["episode"] == "01").all()
    assert (moved["time"].astype(float) == source["time"]).all()


def test_transport_refuses_bad_input(here):
    write_samples(here)
    assert "There is no file none.csv" in refused("transport", "none.csv", "target.csv", "-o", "out.csv")
    (here / "out.csv").write_text("mine")
    assert "out.csv exists" in refused("transport", "source.csv", "target.csv", "-o", "out.csv")
    assert (here / "out.csv").read_text() == "mine"
    pd.read_csv(here / "target.csv").rename(columns={"a": "c"}).to_csv(here / "other.csv", index=False)
    assert "only one of them has: c, a." in refused("transport", "source.csv", "other.csv", "-o", "new.csv")
    (here / "text.csv").write_text("a,b\n1,2\n3,four\n")
    assert "line 3, column b: expected a finite number, got 'four'" in refused(
        "transport", "text.csv", "target.csv", "-o", "new.csv"
    )
    assert "There is no folder" in refused("transport", "source.csv", "target.csv", "-o", "no/new.csv")
    assert not (here / "new.csv").exists()


def test_a_picture_needs_a_name_that_says_its_kind_and_is_not_overwritten(here):
    for name in ("picture", "picture.xyz"):
        assert "expected a name that ends in .png, .svg, .pdf" in refused(
            "experiment", "puck", "--plot", name
        )
    (here / "picture.png").write_text("mine")
    assert "picture.png exists" in refused("experiment", "puck", "--plot", "picture.png")


def test_notes_beside_the_extended_model_are_not_overwritten(here):
    (here / "better.effects.json").write_text("mine")
    message = refused("diagnose", "model.xml", "log.csv", "--extended", "better.xml")
    assert "better.effects.json exists" in message
    assert "--force" in message


def test_findings_are_shown_where_the_gain_cannot_be_measured(here, monkeypatch):
    def diverging(*_, **__):
        raise RuntimeError("The simulation diverges in every row.")

    monkeypatch.setattr("skat.diagnosis.SimulationDiagnosis.evaluate", diverging)
    result = skat("diagnose", "model.xml", "log.csv", "--effect", "damping[rail]", "--extended", "better.xml")
    assert result.exit_code == 0, result.output
    assert "damping[rail]" in result.stdout
    assert "% of the excess" not in result.stdout
    assert (here / "log-report.html").exists()
    assert (here / "better.xml").exists()


def test_a_share_beyond_one_is_refused_before_anything_is_drawn(here):
    message = refused("diagnose", "model.xml", "log.csv", "--test-size", "3")
    assert message == "Error: test_size must lie between 0 and 1, such as 0.3; it is 3.0."


def test_the_version_is_that_of_the_package():
    from importlib.metadata import version

    import skat as package

    assert skat("--version").stdout == f"skat {package.__version__}\n"
    assert version("skat") == package.__version__


def test_completion_is_offered():
    assert "--install-completion" in skat("--help").stdout


def test_zero_processes_are_refused_before_the_work(here):
    message = refused("diagnose", "model.xml", "log.csv", "--jobs", "0")
    assert "n_jobs must be a number of processes" in message
    assert "--jobs" in message


def test_nothing_is_set_aside_if_the_user_says_so(here):
    result = skat("diagnose", "model.xml", "log.csv", "--effect", "damping[rail]", "--test-size", "0")
    assert result.exit_code == 0, result.output
    assert "damping[rail]" in result.stdout
    assert "on data not used" not in result.stdout


# -- a fleet ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def carts(tmp_path):
    """Logs of two carts, one of which has friction since March."""
    (tmp_path / "cart.xml").write_text(MODEL)
    for seed, (name, damping) in enumerate(
        [("a_2026-01-05", 0.0), ("a_2026-03-09", 0.6), ("b_2026-01-05", 0.0)]
    ):
        log = measured_cart(n_episodes=3, damping=damping, seed=seed)
        log.to_csv(tmp_path / f"{name}.csv", index=False)
    return tmp_path


def fleet_of(folder, *options):
    logs = sorted(folder.glob("*.csv"))
    effects = ["--effect", "damping[rail]", "--effect", "mass[cart]"]
    return skat("diagnose", folder / "cart.xml", *logs, *effects, *options)


def test_diagnose_writes_a_table_of_many_logs_and_tells_what_changed(carts):
    pattern = r"(?P<robot>\w)_(?P<time>[\d-]+)\.csv"
    (carts / "fleet.parquet.part").mkdir()
    (carts / "fleet.parquet.part" / "mine.txt").write_text("mine")
    result = fleet_of(carts, "--table", carts / "fleet.parquet", "--robots", pattern)
    assert result.exit_code == 0, result.output
    table = pd.read_parquet(carts / "fleet.parquet")
    assert table["robot"].tolist() == ["a", "a", "b"]
    assert table["verdict"].tolist() == ["nothing detected", "named", "nothing detected"]
    assert table.loc[1, "cause"] == "damping[rail]"
    assert table.loc[1, "low"] < 0.6 < table.loc[1, "high"]
    text = " ".join(result.output.split())
    assert "1 of 3 logs have a cause that holds" in text
    assert "a: damping[rail] went from" in text
    assert "2026-03-09" in text
    assert [path.name for path in (carts / "fleet.parquet.part").iterdir()] == ["mine.txt"]


def test_a_table_with_an_error_keeps_what_is_done_and_counts_what_was_found(carts):
    (carts / "b_2026-03-09.csv").write_text("time\n")
    pattern = r"(?P<robot>\w)_"
    result = fleet_of(carts, "--table", carts / "fleet.csv", "--robots", pattern, "--test-size", "0")
    assert result.exit_code == 0, result.output
    text = " ".join(result.output.split())
    assert "4 logs: 2 nothing detected, 1 named, 1 no diagnosis." in text
    assert "the logs of a robot are taken in the order in which they are given" in text
    assert f"first seen at {carts / 'a_2026-03-09.csv'}" in text
    assert f"What is done is kept in {carts / 'fleet.csv.part'}" in text
    assert len(list((carts / "fleet.csv.part").iterdir())) == 3


def test_a_log_that_is_unexplained_is_told_by_name(capsys):
    columns = ["log", "verdict", "cause", "value", "low", "high", "unit", "probability", "aliases", "held"]
    table = pd.DataFrame(
        [["a.csv", "unexplained", "gain[x]", 1.2, 1.1, 1.3, "1", 1.0, "", False]], columns=columns
    )
    table["warnings"] = "Beware."
    _show(table, table)
    text = capsys.readouterr().out
    assert "1 logs: 1 unexplained." in text
    assert "Unexplained, so that no cause of theirs holds: a.csv." in text
    assert "1 of 1 logs have warnings" in text


@pytest.mark.parametrize(
    "text",
    ["2026-01-05", "20260105", "2026_01_05", "20260105_000000", "2026-01-05_00-00-00", "2026-01-05T00:00"],
)
def test_a_time_is_said_from_the_year_on(text):
    assert _time_of(text) == pd.Timestamp("2026-01-05")


@pytest.mark.parametrize("text", ["01-02-2026", "1.2.2026", "nat", "17"])
def test_a_time_that_may_be_read_in_two_ways_is_refused(text):
    with pytest.raises(ValueError, match="year, month and day in this order"):
        _time_of(text)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--table", "fleet.txt"], "a name that ends in .parquet or .csv"),
        (["--table", "fleet.csv", "--json", "one.json"], "--json is of one diagnosis"),
        (["--table", "fleet.csv", "--robots", "("], "is no regular expression"),
        (["--table", "fleet.csv", "--robots", r"\w"], "has no group named robot"),
        (["--table", "fleet.csv", "--robots", "(?P<robot>x9)"], "finds nothing in"),
        (["--table", "fleet.csv", "--robots", r"(?P<robot>\w)_(?P<time>\w)"], "finds times that are none"),
        (["--table", "fleet.csv", "--effect", "bogus"], "unknown effect 'bogus'"),
        (["--table", "fleet.csv", "--map", "qpos.rail=none"], "none of 3 logs could be diagnosed"),
        (["--robots", "(?P<robot>a)"], "give --table as well"),
    ],
)
def test_diagnose_says_what_is_wrong_with_the_options_of_a_table(carts, options, message, monkeypatch):
    monkeypatch.chdir(carts)
    result = fleet_of(carts, *options)
    assert result.exit_code == 2
    assert message in " ".join(result.output.split())
    assert not (carts / "fleet.csv").exists()
