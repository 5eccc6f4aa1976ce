import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

PAGES = Path(__file__).parents[2] / "docs" / "studies"
DT, FRAME_SKIP = 0.01, 5
MJCF = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="lower">
      <joint name="elbow" axis="0 -1 0" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><position name="elbow" joint="elbow" kp="20" kv="0.5"/></actuator>
</mujoco>
"""
TRUTH = {"dry_friction": 0.3, "kp": 26.0, "offset": 0.05, "delay": 0.013}


def parameters():
    import open_loop

    return [
        open_loop.Parameter("dry_friction", 0.1, 0.0, 2.0, 0.1, open_loop.friction("elbow")),
        open_loop.Parameter("kp", 20.0, 1.0, 100.0, 4.0, open_loop.kp("elbow")),
        open_loop.Parameter("offset", 0.0, -0.3, 0.3, 0.02, open_loop.offset("elbow")),
        open_loop.Parameter("delay", 0.005, 0.0, 0.1, 0.005, None),
    ]


def log_of(n_rows=120, seed=0):
    """Rows and next states of the arm with `TRUTH`, simulated here step by step."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec.from_string(MJCF)
    spec.joint("elbow").frictionloss = TRUTH["dry_friction"]
    servo = spec.actuator("elbow")
    servo.gainprm[0], servo.biasprm[1] = TRUTH["kp"], -TRUTH["kp"]
    servo.biasprm[0] = TRUTH["kp"] * TRUTH["offset"]
    model = spec.compile()
    data = mujoco.MjData(model)
    commands = np.cumsum(rng.normal(0, 0.06, n_rows))
    states = [[0.0, 0.0]]
    for row in range(n_rows):
        for step in range(FRAME_SKIP):
            # A command that is late by 6.5 steps is half of one row and half of another in the step between.
            late = [commands[max(0, (row * FRAME_SKIP + step - back) // FRAME_SKIP)] for back in (6, 7)]
            data.ctrl[:] = np.mean(late)
            mujoco.mj_step(model, data)
        states.append([data.qpos[0], data.qvel[0]])
    states = np.array(states)
    return np.column_stack([states[:-1], commands]), states[1:], np.zeros(n_rows, dtype=int)


def test_least_squares_in_open_loop_recover_friction_kp_offset_and_delay():
    import open_loop

    stretches = open_loop.stretches_of(*log_of(), n_joints=1)
    values, _ = open_loop.least_squares(MJCF, parameters(), stretches, FRAME_SKIP)
    np.testing.assert_allclose(values, list(TRUTH.values()), rtol=1e-3)
    model, delay = open_loop.compiled(MJCF, parameters(), values)
    assert open_loop.rms(open_loop.misses([model], [delay], stretches, FRAME_SKIP)) < 1e-4


def test_parameters_that_move_other_joints_share_a_simulation_and_none_else():
    import open_loop

    reaches = [(0, 1), (0, 1), (2,), (2,), (), (0,)]
    mine = [open_loop.Parameter(str(k), 0.0, 0.0, 1.0, 1.0, None, reach) for k, reach in enumerate(reaches)]
    assert open_loop.apart(mine, 3) == [[0, 2], [1, 3], [4], [5]]


def test_batched_and_single_paths_in_open_loop_are_the_same():
    import open_loop
    import studies

    stretches = open_loop.stretches_of(*log_of(), n_joints=1, n_rows=40)
    assert [len(one.commands) for one in stretches] == [40, 40, 40]
    model = mujoco.MjModel.from_xml_string(MJCF)
    together = open_loop.paths([model], [0.0], stretches, FRAME_SKIP)[0]
    for path, one in zip(together, stretches):
        np.testing.assert_allclose(studies.plain_path(model, one, FRAME_SKIP), path, rtol=0, atol=1e-12)
    # Of several lengths they come back in their order.
    short = [
        replace(one, commands=one.commands[:n], after=one.after[:n]) for one, n in zip(stretches, (9, 40, 9))
    ]
    found = studies.fitted_angles(MJCF, [], [], short, FRAME_SKIP)
    assert [len(path) for path in found] == [9, 40, 9]
    for path, whole in zip(found, together):
        np.testing.assert_array_equal(path, whole[: len(path)])


def test_late_commands_of_a_model_and_of_least_squares_are_the_same():
    import open_loop
    import studies

    X, y, groups = log_of()
    X[:, 2] += 0.7
    (one,) = open_loop.stretches_of(X, y, groups, n_joints=1)
    late = MJCF.replace('kv="0.5"', 'kv="0.5" delay="0.01" nsample="6"')
    found = studies.plain_path(mujoco.MjModel.from_xml_string(late), one, FRAME_SKIP)
    given = open_loop.paths([mujoco.MjModel.from_xml_string(MJCF)], [0.01], [one], FRAME_SKIP)[0, 0]
    np.testing.assert_allclose(found, given, rtol=0, atol=1e-9)


def test_a_stretch_without_speeds_begins_with_the_slope_of_its_angles():
    import open_loop

    X, y, groups = log_of()
    speed = X[0, 1]
    X[:, 1] = np.nan
    X[:5, 0] = 0.2 + 0.7 * DT * np.arange(5)
    (one,) = open_loop.stretches_of(X, y, groups, n_joints=1, dt=DT)
    np.testing.assert_allclose(one.qvel, 0.7)
    assert speed == 0


def test_inverse_dynamics_and_regressors_are_those_of_mujoco():
    import rigid_bodies

    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="a"><joint axis="0 1 0"/>
        <inertial pos=".1 .02 -.2" mass="1.3" diaginertia=".02 .03 .04" quat=".9 .1 .3 .2"/>
        <body name="b" pos="0 .1 -.4" euler="20 0 50"><joint axis="1 0 0"/>
        <inertial pos=".05 0 -.1" mass=".7" diaginertia=".01 .02 .015"/></body></body></worldbody>
        <actuator><motor joint="joint1"/></actuator></mujoco>""".replace(
            "<joint axis", "<joint name='joint1' axis", 1
        )
    )
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, 4, 2))
    log = rigid_bodies.Smooth(q, v, a, np.zeros((4, 2)))
    columns = rigid_bodies.regressors(model, log)
    theta = np.concatenate([inertial(model, body) for body in (1, 2)])
    data = mujoco.MjData(model)
    for row in range(4):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[row], v[row], a[row]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(columns[row] @ theta, data.qfrc_inverse, rtol=1e-9, atol=1e-9)


def inertial(model, body):
    """Mass, first moment and moments about the frame's origin."""
    mass, centre, turn = model.body_mass[body], model.body_ipos[body], np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    turn = turn.reshape(3, 3)
    about = turn @ np.diag(model.body_inertia[body]) @ turn.T
    about += mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return [mass, *(mass * centre), *np.diag(about), about[0, 1], about[0, 2], about[1, 2]]


def test_tables_and_numbers_hold_what_was_found(tmp_path):
    import study_pages

    cause = {
        "name": "dry_friction[elbow]", "value": 0.1912, "interval": [0.18, 0.2], "unit": "N m", "neutral": 0.0,
        "probability": 0.9999, "aliases": ["damping[elbow]"], "at_bound": False,
    }  # fmt: skip
    header, rows = study_pages.causes_table([cause])
    assert rows == [["``dry_friction[elbow]``", "0.1912 N m (0.18 to 0.2)", "> .999", "``damping[elbow]``"]]
    study_pages.write_table(tmp_path / "t.csv", header, rows)
    assert list(csv.reader((tmp_path / "t.csv").read_text().splitlines())) == [header, *rows]
    assert study_pages.substitutions({"nominal": "18.7"}) == ".. |nominal| replace:: 18.7\n"
    assert [study_pages.shown(value) for value in (0.012345, 1234.5, np.inf, None)] == [
        "0.0123",
        "1234",
        "lost",
        "",
    ]


@pytest.mark.parametrize("page", sorted(PAGES.glob("*.rst")), ids=lambda page: page.name)
def test_a_study_s_page_includes_only_what_the_script_has_written(page):
    text = page.read_text("utf-8")
    files = re.findall(r"(?::file:|include::|image::|figure::) (\S+)", text)
    assert files
    assert [name for name in files if not (PAGES / name).exists()] == []
    defined = [
        name
        for file in files
        if file.endswith(".inc")
        for name in re.findall(r"^\.\. \|(\w+)\|", (PAGES / file).read_text("utf-8"), re.MULTILINE)
    ]
    assert set(re.findall(r"\|(\w+)\|", text)) <= set(defined)


@pytest.mark.parametrize("file", sorted(PAGES.glob("*.json")), ids=lambda file: file.name)
def test_a_study_s_numbers_name_their_commit_and_seconds(file):
    found = json.loads(file.read_text())
    assert found["commit"]
    assert found["seconds"] > 0
    assert set(found["errors"]) >= {"nominal", "extended", "least squares"}
