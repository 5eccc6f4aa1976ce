"""The MuJoCo simulator: columns, rows, states with quaternions, copies, written models, errors."""

import copy
import json
import os
import pickle
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from sklearn.base import clone

from skat.effects import Effect
from skat.simulators import MujocoSimulator, stepping

BOT = """
<mujoco model="bot">
  <option timestep="0.004"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="trunk" pos="0 0 .3">
      <freejoint name="root"/>
      <geom name="trunk" type="box" size=".1 .08 .05" mass="2"/>
      <body name="leg" pos=".1 0 0">
        <joint name="hip" type="ball" damping="0.05"/>
        <geom name="leg" type="capsule" size=".02" fromto="0 0 0 0 0 -.2" mass=".3"/>
        <body pos="0 0 -.2">
          <joint name="slider" type="slide" axis="0 0 1" damping="2" range="-.05 .05" limited="true"/>
          <geom type="sphere" size=".03" mass=".1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="slider" gear="10"/>
    <motor name="twist" joint="hip" gear="0 0 1"/>
  </actuator>
</mujoco>
"""
STATE = (
    *(f"qpos.root.{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz")),
    *(f"qpos.hip.q{part}" for part in "wxyz"),
    "qpos.slider",
    *(f"qvel.root.{part}" for part in ("vx", "vy", "vz", "wx", "wy", "wz")),
    *(f"qvel.hip.w{axis}" for axis in "xyz"),
    "qvel.slider",
)


@pytest.fixture
def bot():
    return MujocoSimulator(BOT, frame_skip=5)


def rows_of(bot, n, seed=0):
    """Return states around the reference pose, some in contact, with random actions."""
    random = np.random.default_rng(seed)
    state = np.zeros(len(STATE))
    state[:7], state[7:11], state[2] = [0, 0, 0, 1, 0, 0, 0], [1, 0, 0, 0], 0.28
    rows = np.hstack([np.tile(state, (n, 1)), random.normal(size=(n, 2))])
    return bot.displace(rows, 0.1 * random.normal(size=(n, len(bot.residual_names))))


def test_columns_have_the_names_of_mujoco(bot):
    assert bot.state_names == bot.output_names == STATE
    assert bot.input_names == (*STATE, "ctrl.slider", "ctrl.twist")
    assert bot.residual_names[3:6] == ("qpos.root.rx", "qpos.root.ry", "qpos.root.rz")
    assert [bot.units[f"qpos.root.{axis}"] for axis in ("x", "qx", "rx")] == ["m", "1", "rad"]
    assert len(bot.residual_names) == 2 * 10
    assert bot.dt == pytest.approx(0.02)


def test_unnamed_elements_have_names():
    simulator = MujocoSimulator(
        """
        <mujoco>
          <worldbody>
            <body>
              <joint type="slide"/><geom size=".1"/>
              <body pos="1 0 0"><joint name="arm"/><geom size=".1"/></body>
            </body>
          </worldbody>
          <actuator><motor joint="arm"/><motor joint="arm"/></actuator>
        </mujoco>
        """
    )
    assert simulator.input_names == (
        "qpos.joint0", "qpos.arm", "qvel.joint0", "qvel.arm", "ctrl.actuator0", "ctrl.actuator1",
    )  # fmt: skip
    assert {"mass[body1]", "mass[body2]", "damping[joint0]"} <= {
        effect.name for effect in simulator.effects()
    }


def test_prediction_is_that_of_plain_mujoco(bot):
    rows = rows_of(bot, 10)
    model = mujoco.MjModel.from_xml_string(BOT)
    for row, found in zip(rows, bot.predict(rows)):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = np.split(row, [12, 22])
        mujoco.mj_step(model, data, 5)
        np.testing.assert_allclose(found, np.r_[data.qpos, data.qvel], rtol=1e-9, atol=1e-9)


def test_rows_do_not_depend_on_other_rows_nor_on_chunks(bot, monkeypatch):
    rows = rows_of(bot, 40)
    candidates = [{}, {"mass[leg]": 2.0}, {"air_drag[all]": 1.0}, {"delay[action]": 0.01}, {"timestep": 0.7}]
    candidates += [{"centre_of_mass[trunk.x]": 0.05}, {"wind[x]": 2.0}, {"position_friction[slider]": 5.0}]
    groups = np.arange(40) // 8
    whole = bot.predict_many(rows, candidates, groups=groups)
    monkeypatch.setattr(stepping, "CHUNK", 7)
    np.testing.assert_array_equal(bot.predict_many(rows, candidates, groups=groups), whole)
    for index in (0, 3, 5):
        np.testing.assert_array_equal(
            bot.predict(rows, effects=candidates[index], groups=groups), whole[index]
        )
    episode = slice(16, 24)
    np.testing.assert_array_equal(bot.predict_many(rows[episode], candidates), whole[:, episode])
    order = np.random.default_rng(3).permutation(40)
    np.testing.assert_array_equal(bot.predict(rows[order]), whole[0, order])


def test_candidates_do_not_depend_on_other_candidates():
    arm = MujocoSimulator(
        """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/>
        <body pos=".5 0 0"><joint name="b" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/></body></body>
        </worldbody></mujoco>""",
        frame_skip=5,
    )
    rows = np.random.default_rng(0).normal(size=(6, 4))
    candidates = [
        {name: value}
        for name in (
            "position_friction[a]",
            "position_friction[b]",
            "air_drag[x]",
            "air_drag[all]",
            "wind[z]",
        )
        for value in (1.0, 2.0)
    ]
    together = arm.predict_many(rows, candidates)
    for values, found in zip(candidates, together):
        np.testing.assert_array_equal(clone(arm).predict(rows, effects=values), found)
        assert np.abs(found - arm.predict(rows)).max() > 1e-6


@pytest.mark.parametrize(
    "values", [{}, {"air_drag[all]": 0.5, "bias[qpos.slider]": 0.01}, {"delay[action]": 0.012}]
)
def test_rollout_is_repeated_prediction(bot, values):
    rows = rows_of(bot, 4)
    states, actions = rows[:, : len(STATE)], np.random.default_rng(1).normal(size=(4, 6, 2))
    found = bot.rollout(states, actions, n_steps=6, effects=values)
    for step in range(6):
        table = np.hstack([found[:, step], actions[:, step]])
        if "delay[action]" in values and step:  # the row before it gives the action that still holds
            earlier = np.hstack([found[:, step - 1], actions[:, step - 1]])
            table = np.stack([earlier, table], axis=1).reshape(8, -1)
            expected = bot.predict(table, effects=values, groups=np.arange(8) // 2)[1::2]
        else:
            expected = bot.predict(table, effects=values, groups=np.arange(4))
        np.testing.assert_allclose(found[:, step + 1], expected, rtol=1e-9, atol=1e-9)


def test_residual_and_displacement_are_those_of_mujoco(bot):
    model = mujoco.MjModel.from_xml_string(BOT)
    rows, tangent = rows_of(bot, 20), np.random.default_rng(4).uniform(-1.7, 1.7, size=(20, 20))
    moved = bot.displace(rows, tangent)
    difference = bot.residual(moved[:, :22], rows[:, :22])
    np.testing.assert_allclose(difference, tangent, atol=1e-12)
    for row, step, found in zip(rows, tangent, moved):
        qpos = row[:12].copy()
        mujoco.mj_integratePos(model, qpos, step[:10], 1.0)
        np.testing.assert_allclose(found[:12], qpos, atol=1e-12)
        reverse = np.empty(10)
        mujoco.mj_differentiatePos(model, reverse, 1.0, row[:12], found[:12])
        np.testing.assert_allclose(bot.residual(found[:22], row[:22])[:10], reverse, atol=1e-12)


def test_sign_and_small_errors_of_quaternions_do_not_matter(bot):
    rows = rows_of(bot, 5)
    other = rows.copy()
    other[:, 3:7] *= -1.1
    expected, found = bot.predict(rows), bot.predict(other)
    np.testing.assert_allclose(bot.residual(found, expected), 0, atol=1e-9)
    assert (np.sum(found[:, 3:7] * other[:, 3:7], axis=1) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(found[:, 3:7], axis=1), 1)
    np.testing.assert_allclose(bot.residual(other[:, :22], rows[:, :22]), 0, atol=1e-9)


def test_quaternion_far_from_unit_length_is_an_error(bot):
    rows = rows_of(bot, 5)
    rows[3, 7:11] *= 1.3
    with pytest.raises(
        ValueError, match=r"qpos.hip.qw and the three columns after it have the length 1.3 in row 3"
    ):
        bot.predict(rows)


def test_a_single_state_with_a_quaternion_far_from_unit_length_is_an_error(bot):
    state = np.zeros(len(bot.state_names))
    with pytest.raises(ValueError, match="have the length 0; expected w, x, y, z with length 1"):
        bot.residual(state, state)


def test_quaternions_have_no_sensor_effects(bot):
    channels = {effect.target for effect in bot.effects() if effect.family in {"bias", "scale"}}
    assert channels == {name for name in STATE if ".q" not in name}


def test_simulator_pickles_copies_and_clones(bot):
    extended, rows = bot.extended({"mass[trunk]": 1.5, "wind[x]": 1.0}), rows_of(bot, 5)
    expected = extended.predict(rows)
    for other in (pickle.loads(pickle.dumps(extended)), copy.deepcopy(extended), clone(extended)):
        np.testing.assert_array_equal(other.predict(rows), expected)
        assert other.effects() == extended.effects()
    assert "_memory" not in extended.__getstate__()


def test_representation_says_what_is_built_in(bot):
    assert repr(bot) == "MujocoSimulator('bot', frame_skip=5)"
    assert (
        repr(bot.extended({"gravity": 2.0}))
        == "MujocoSimulator('bot', frame_skip=5, built_in={'gravity': 2.0})"
    )


def test_changed_parameters_take_effect(bot):
    rows = rows_of(bot, 3)
    slower = MujocoSimulator(BOT, frame_skip=10).predict(rows)
    np.testing.assert_array_equal(clone(bot).set_params(frame_skip=10).predict(rows), slower)


def test_another_model_base_or_motors_make_another_simulator_or_change_nothing():
    walker = """<mujoco><worldbody><body name="trunk"><freejoint name="float"/><geom size=".1"/>
    <body><joint name="hip"/><geom size=".05" pos="0 0 -.3"/></body></body></worldbody></mujoco>"""
    changed = MujocoSimulator(BOT).set_params(model=walker, base="fixed", motors="torque")
    assert changed.input_names == ("qpos.hip", "qvel.hip", "ctrl.hip")
    assert clone(changed).input_names == changed.input_names
    with pytest.raises(ValueError, match="frame_skip must be"):
        changed.set_params(base=None, frame_skip=0)
    assert (changed.base, changed.frame_skip) == ("fixed", 1)
    with pytest.raises(ValueError, match="unknown parameters bas; valid: "):
        changed.set_params(bas="free")


def test_model_is_read_from_path_text_and_spec(bot, tmp_path):
    path, rows = tmp_path / "bot.xml", rows_of(bot, 5)
    path.write_text(BOT)
    expected = bot.predict(rows)
    for model in (path, str(path), mujoco.MjSpec.from_string(BOT)):
        simulator = pickle.loads(pickle.dumps(MujocoSimulator(model, frame_skip=5)))
        np.testing.assert_array_equal(simulator.predict(rows), expected)


def test_assets_and_included_files_travel_with_the_simulator(tmp_path):
    (tmp_path / "meshes").mkdir()
    corners = "".join(f"v {x} {y} {z}\n" for x in (0, 0.1) for y in (0, 0.2) for z in (0, 0.3))
    (tmp_path / "meshes" / "block.obj").write_text(corners + "f 1 2 3\nf 5 6 7\n")
    (tmp_path / "part.xml").write_text('<mujocoinclude><option gravity="0 0 -5"/></mujocoinclude>')
    (tmp_path / "model.xml").write_text(
        """<mujoco><compiler meshdir="meshes"/><include file="part.xml"/><asset><mesh name="block"
        file="block.obj" inertia="convex"/></asset><worldbody><body name="block"><freejoint/><geom type="mesh"
        mesh="block"/></body> </worldbody></mujoco>"""
    )
    simulator = MujocoSimulator(tmp_path / "model.xml", frame_skip=10)
    expected = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    for file in sorted(tmp_path.rglob("*.*")):
        file.unlink()
    copied = pickle.loads(pickle.dumps(simulator))
    np.testing.assert_allclose(copied.compiled().body_inertia, expected.body_inertia)
    assert copied.predict(np.eye(1, 13, 3))[0, 9] == pytest.approx(-5 * 0.02)
    written = copied.to_mjcf(tmp_path / "copy.xml")
    assert {path.name for path in written} == {"copy.xml", "block.obj"}
    np.testing.assert_allclose(
        mujoco.MjModel.from_xml_path(str(tmp_path / "copy.xml")).body_inertia, expected.body_inertia
    )


IN_MJCF = {
    "mass[leg]": 1.3, "length[leg]": 1.1, "centre_of_mass[trunk.x]": 0.02, "gravity": 0.9, "tilt[x]": 0.1,
    "damping[slider]": 0.5, "dry_friction[slider]": 0.2, "armature[slider]": 0.1, "stiffness[slider]": 20.0,
    "gain[slider]": 0.7, "contact_friction[leg]": 0.6, "contact_anisotropy[all]": 1.4,
    "restitution[all]": 0.8, "timestep": 0.5,
}  # fmt: skip


def test_written_model_predicts_the_same_in_plain_mujoco(bot, tmp_path):
    rows = rows_of(bot, 10)
    extended = bot.extended(IN_MJCF)
    assert [path.name for path in extended.to_mjcf(tmp_path / "extended.xml")] == ["extended.xml"]
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "extended.xml"))
    assert "One transition is 10 time steps" in (tmp_path / "extended.xml").read_text()
    for row, found in zip(rows, extended.predict(rows)):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = np.split(row, [12, 22])
        mujoco.mj_step(model, data, 10)
        np.testing.assert_allclose(found, np.r_[data.qpos, data.qvel], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("effect", [name for name in IN_MJCF if name != "timestep"])
def test_written_effect_is_the_effect(bot, tmp_path, effect):
    extended, rows = bot.extended({effect: IN_MJCF[effect]}), rows_of(bot, 10)
    path = extended.to_mjcf(tmp_path / "one.xml")[0]
    np.testing.assert_allclose(
        MujocoSimulator(path, frame_skip=5).predict(rows), extended.predict(rows), rtol=1e-10, atol=1e-10
    )


def test_a_time_step_that_divides_no_transition_is_written_as_the_nearest_that_does(bot, tmp_path):
    extended = bot.extended({"timestep": 0.3})
    model, beside = extended.to_mjcf(tmp_path / "fine.xml")
    found = mujoco.MjModel.from_xml_path(str(model))
    n_steps = round(5 / 0.3)
    assert found.opt.timestep == pytest.approx(bot.dt / n_steps, rel=1e-12)
    assert f"One transition is {n_steps} time steps" in model.read_text()
    notes = json.loads(beside.read_text())
    assert notes["effects"] == []
    assert notes["written rounded"] == {"timestep": pytest.approx(5 / n_steps)}
    rows = rows_of(bot, 5)
    found, written = MujocoSimulator(model, frame_skip=n_steps), bot.extended(notes["written rounded"])
    np.testing.assert_allclose(found.predict(rows), written.predict(rows), rtol=1e-10, atol=1e-10)


def test_what_mjcf_cannot_express_is_written_beside(bot, tmp_path):
    values = {"wind[x]": 1.0, "air_drag[all]": 0.1, "bias[qpos.slider]": 0.01, "mass[leg]": 1.3}
    model, beside = bot.extended(values).to_mjcf(tmp_path / "windy.xml")
    notes = json.loads(beside.read_text())
    assert beside.name == "windy.effects.json"
    assert notes["wind and drag act on body"] == "trunk"
    assert {effect["name"]: effect["value"] for effect in notes["effects"]} == {
        name: value for name, value in values.items() if name != "mass[leg]"
    }
    assert "the mass of leg is 1.3 times the model" in model.read_text()
    with pytest.warns(
        UserWarning, match=r"windy\.effects\.json holds effects .* simulator\.extended\(\{'wind\[x\]': 1"
    ):
        again = MujocoSimulator(model, frame_skip=5)
    del values["mass[leg]"]
    rows = rows_of(bot, 5)
    np.testing.assert_allclose(
        again.extended(values).predict(rows),
        bot.extended({**values, "mass[leg]": 1.3}).predict(rows),
        rtol=1e-10,
        atol=1e-10,
    )


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
@pytest.mark.parametrize("delay", [0.006, 0.012, 0.03])
def test_delay_of_mujoco_agrees_with_ours(tmp_path, integrator, delay):
    simulator = MujocoSimulator(BOT.replace("<option", f'<option integrator="{integrator}"'), frame_skip=5)
    rows, actions = rows_of(simulator, 3), np.random.default_rng(5).normal(size=(3, 8, 2))
    states = simulator.rollout(rows[:, :22], actions, n_steps=8, effects={"delay[action]": delay})
    path = simulator.extended({"delay[action]": delay}).to_mjcf(tmp_path / "late.xml")[0]
    model = mujoco.MjModel.from_xml_path(str(path))
    for start, controls, expected in zip(rows, actions, states):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = np.split(start[:22], [12])
        past = [-0.004 * lag for lag in range(model.actuator_history[0, 0], 0, -1)]
        for actuator in range(2):  # before the start, the first action
            mujoco.mj_initCtrlHistory(model, data, actuator, past, np.full(len(past), controls[0, actuator]))
        for step in range(8):
            data.ctrl[:] = controls[step]
            mujoco.mj_step(model, data, 5)
            data.qacc_warmstart[:] = 0
            found = simulator.residual(np.r_[data.qpos, data.qvel], expected[step + 1])
            np.testing.assert_allclose(found, 0, atol=1e-6)
    again = MujocoSimulator(path, frame_skip=5).rollout(rows[:, :22], actions, n_steps=8)
    np.testing.assert_allclose(again, states, atol=1e-9)


def test_no_file_is_overwritten_unless_that_is_asked_for(bot, tmp_path):
    path, notes = tmp_path / "mine.xml", tmp_path / "mine.effects.json"
    windy = bot.extended({"wind[x]": 1.0})
    path.write_text("mine")
    with pytest.raises(FileExistsError, match=r"mine\.xml exists\..*force=True"):
        windy.to_mjcf(path)
    path.unlink()
    notes.write_text("mine")
    with pytest.raises(FileExistsError, match=r"mine\.effects\.json exists"):
        bot.to_mjcf(path)
    assert notes.read_text() == "mine"
    assert not path.exists()
    assert windy.to_mjcf(path, force=True) == (path, notes)
    assert windy.to_mjcf(path, force=True) == (path, notes)
    assert notes.exists()
    # What was written beside the windy model is not true of this one.
    assert bot.to_mjcf(path, force=True) == (path,)
    assert not notes.exists()
    with pytest.raises(FileNotFoundError, match="Make it first"):
        bot.to_mjcf(tmp_path / "nowhere" / "mine.xml")


def test_asset_of_another_model_is_not_overwritten(tmp_path):
    block = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    (tmp_path / "block.obj").write_text(block)
    text = """<mujoco><asset><mesh name="block" file="block.obj" inertia="convex"/></asset><worldbody><body>
        <freejoint/><geom type="mesh" mesh="block"/></body></worldbody></mujoco>"""
    (tmp_path / "model.xml").write_text(text)
    simulator = MujocoSimulator(tmp_path / "model.xml")
    there = tmp_path / "there"
    there.mkdir()
    (there / "block.obj").write_text(block)
    simulator.to_mjcf(there / "same.xml")
    (there / "block.obj").write_text(block.replace("1", "2"))
    with pytest.raises(FileExistsError, match="block"):
        simulator.to_mjcf(there / "other.xml")
    assert not (there / "other.xml").exists()
    assert "2" in (there / "block.obj").read_text()


def test_delay_under_runge_kutta_is_written_beside(tmp_path):
    simulator = MujocoSimulator(BOT.replace("<option", '<option integrator="RK4"'), frame_skip=5)
    _, beside = simulator.extended({"delay[action]": 0.01}).to_mjcf(tmp_path / "late.xml")
    assert "delay[action]" in beside.read_text()


def test_total_mass_of_the_compiler_does_not_undo_effects(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo logs its warning
    text = BOT.replace("<option", '<compiler settotalmass="7"/><option')
    simulator = MujocoSimulator(text)
    assert simulator.compiled().body_mass.sum() == pytest.approx(7)
    assert simulator.compiled({"mass[all]": 2.0}).body_mass.sum() == pytest.approx(14)
    simulator.extended({"mass[all]": 2.0}).to_mjcf(tmp_path / "heavy.xml")
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "heavy.xml"))
    np.testing.assert_allclose(
        written.body_mass, simulator.compiled({"mass[all]": 2.0}).body_mass, rtol=1e-12
    )


def test_diverged_rows_are_nan_and_leave_no_log(bot, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = rows_of(bot, 5)
    rows[2, 15] = 1e12
    found = bot.predict_many(rows, [{}])[0]
    np.testing.assert_array_equal(np.isnan(found).any(axis=1), [False, False, True, False, False])
    np.testing.assert_array_equal(found[[0, 1, 3, 4]], bot.predict(rows[[0, 1, 3, 4]]))
    with pytest.raises(RuntimeError, match=r"diverged in 1 of 5 rows \(row 2\)"):
        bot.predict(rows)
    assert not list(tmp_path.iterdir())


def test_own_effects_edit_the_model(bot):
    def raise_floor(spec, height):
        spec.geom("floor").pos = [0, 0, height]

    own = Effect("floor_height", unit="m", neutral=0.0, bounds=(-0.1, 0.1), apply=raise_floor)
    simulator, rows = MujocoSimulator(BOT, frame_skip=5, extra_effects=(own,)), rows_of(bot, 10)
    by_hand = MujocoSimulator(BOT.replace('size="5 5 .1"', 'size="5 5 .1" pos="0 0 .02"'), frame_skip=5)
    np.testing.assert_array_equal(
        simulator.predict(rows, effects={"floor_height": 0.02}), by_hand.predict(rows)
    )


def test_missing_file_says_where_it_was_looked_for():
    with pytest.raises(FileNotFoundError, match=r"no model file 'nowhere/robot.xml' \(looked in /"):
        MujocoSimulator("nowhere/robot.xml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "<mujoco><worldbody><body><geom siz='1'/></body></worldbody></mujoco>",
            "unrecognized attribute: 'siz'.*line 1",
        ),
        ("<mujoco>", "MISMATCHED_ELEMENT"),
        (
            "<mujoco><worldbody><body><joint/></body></worldbody></mujoco>",
            "mass and inertia of moving bodies",
        ),
        ("<mujoco/>", "nothing in it can move"),
    ],
)
def test_broken_model_gets_mujocos_message(text, message):
    with pytest.raises(ValueError, match=message):
        MujocoSimulator(text)


def test_model_of_another_type_is_refused():
    with pytest.raises(TypeError, match=r"a path, MJCF or URDF text, .* or a mujoco\.MjModel; got MjData"):
        MujocoSimulator(mujoco.MjData(mujoco.MjModel.from_xml_string(BOT)))
    for frame_skip in (0, 1.5, True, None, "2", np.inf, np.nan):
        with pytest.raises(ValueError, match="frame_skip must be a positive whole number"):
            MujocoSimulator(BOT, frame_skip=frame_skip)


def test_missing_asset_is_named():
    text = '<mujoco><asset><mesh name="a" file="gone.stl"/></asset><worldbody/></mujoco>'
    with pytest.raises(FileNotFoundError, match=r"refers to the file 'gone.stl'"):
        MujocoSimulator(text)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_simulates_as_its_parent_does():
    """The threads of the parent's batches are not in the child, which would wait for them."""
    code = """
import os, signal, sys
import numpy as np
from skat.simulators import make_simulator
simulator = make_simulator("hopper")
rows = np.random.default_rng(0).normal(scale=0.1, size=(300, len(simulator.input_names)))
here = simulator.predict(rows)
if (child := os.fork()) == 0:
    signal.alarm(30)
    os._exit(not np.array_equal(simulator.predict(rows), here))
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    assert subprocess.run([sys.executable, "-W", "ignore", "-c", code]).returncode == 0


APART = """<mujoco><compiler angle="radian"/><option timestep=".002"/><worldbody>
<body pos="0 0 0"><joint name="a" axis="0 1 0"/><geom size=".1" pos=".3 0 0" contype="0"/></body>
<body pos="0 1 0"><joint name="b" axis="0 1 0"/><geom size=".1" pos=".3 0 0" contype="0"/></body>
<body pos="0 2 0"><joint name="c" type="slide" axis="0 0 1"/><geom size=".1" contype="0"/></body></worldbody>
<actuator><motor name="a" joint="a"/><motor name="b" joint="b"/><motor name="c" joint="c"/></actuator></mujoco>"""


@pytest.mark.parametrize("loose", ["a", "b"])
def test_play_in_one_joint_is_nothing_to_a_joint_that_hangs_on_another_body(loose):
    simulator, rows = MujocoSimulator(APART, frame_skip=5), np.random.default_rng(0).normal(size=(6, 9))
    others = {
        "force[c]": 0.7,
        "position_friction[c]": 3.0,
        "stribeck[b]": 4.0,
        "force[b]": -0.3,
        "dead_zone[c]": 0.1,
    }
    groups, columns = np.arange(6), [2, 5] if loose == "b" else [1, 2, 4, 5]
    found = simulator.predict(rows, effects={f"backlash[{loose}]": 0.05} | others, groups=groups)
    tight = simulator.predict(rows, effects=others, groups=groups)
    np.testing.assert_allclose(found[:, columns], tight[:, columns], atol=1e-12)
    assert np.abs(found - tight).max() > 1e-4
    for name in others:
        without = {other: value for other, value in others.items() if other != name}
        assert np.abs(simulator.predict(rows, effects=without, groups=groups) - tight).max() > 1e-6


def test_a_transition_is_one_time_step_unless_it_is_said_to_be_more():
    simulator = MujocoSimulator(APART)
    assert simulator.dt == simulator.time_step == 0.002
    assert MujocoSimulator(APART, frame_skip=3).dt == pytest.approx(0.006)
    model, n_substeps, _ = MujocoSimulator(APART, frame_skip=3).prepared({})
    assert (model.opt.timestep, n_substeps) == (0.002, 3)
    assert MujocoSimulator(APART, frame_skip=3).prepared({}, 7)[1] == 7


def test_rows_and_displacements_of_any_leading_shape_go_together(bot):
    rows, tangent = rows_of(bot, 3), 0.1 * np.random.default_rng(0).normal(size=(4, 1, 20))
    moved = bot.displace(rows, tangent)
    assert moved.shape == (4, 3, 24)
    states = bot.displace(rows[:, :22], tangent)
    np.testing.assert_array_equal(states, moved[..., :22])
    np.testing.assert_array_equal(moved[..., 22:], np.tile(rows[:, 22:], (4, 1, 1)))
    for index in range(4):
        np.testing.assert_allclose(
            moved[index], bot.displace(rows, np.tile(tangent[index], (3, 1))), atol=1e-14
        )


def test_more_models_than_are_kept_are_compiled_again(monkeypatch):
    monkeypatch.setattr("skat.simulators.mujoco.CACHED_MODELS", 2)
    monkeypatch.setattr(stepping, "CACHED_BATCHES", 1)
    rows, simulator = np.random.default_rng(0).normal(size=(4, 9)), MujocoSimulator(APART)
    candidates = [{"gravity": 0.1 * number} for number in range(1, 8)] + [
        {"air_drag[all]": 0.3},
        {"gravity": 0.1},
    ]
    commands = np.zeros((len(candidates), 4, 3))
    for _ in range(2):
        found = simulator.predict_many(rows, candidates)
        forces = simulator.missing_forces(rows[:, :6], np.zeros((4, 3)), commands, candidates)
        np.testing.assert_array_equal(found[0], found[-1])
        for index in (0, 3, 7):
            alone = clone(simulator)
            np.testing.assert_array_equal(alone.predict(rows, effects=candidates[index]), found[index])
            one = alone.missing_forces(rows[:, :6], np.zeros((4, 3)), commands[:1], [candidates[index]])
            np.testing.assert_array_equal(one[0], forces[index])
