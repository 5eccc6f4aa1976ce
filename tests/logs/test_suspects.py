from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from skat.logs import LogError, load_log, suspects
from skat.logs.suspects import in_degrees
from skat.simulators import MujocoSimulator
from tests.logs import formats


@pytest.fixture(scope="module")
def arm():
    return MujocoSimulator(formats.ARM)


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    return pd.read_csv(formats.documented(tmp_path_factory.mktemp("frame") / "log.csv"))


def first(log):
    return suspects(log.simulator, log)[0]


def test_a_log_without_mistakes_is_made_worse_by_every_repair(arm, frame):
    log = load_log(frame, arm)
    tried = suspects(log.simulator, log)
    assert len(tried) > 8
    assert min(suspect.repaired for suspect in tried if suspect.kind != "shift") > tried[0].error


def test_swapped_columns_are_told_and_the_options_put_them_right(arm, frame):
    theirs = frame.rename(columns={"ctrl.elbow": "ctrl.shoulder", "ctrl.shoulder": "ctrl.elbow"})
    suspect = first(load_log(theirs, arm))
    assert suspect.sentence == "ctrl.shoulder and ctrl.elbow are swapped"
    assert suspect.repaired < 0.3 * suspect.error
    np.testing.assert_array_equal(load_log(theirs, arm, **suspect.options).X, load_log(frame, arm).X)


def test_a_sign_is_told_and_the_options_put_it_right(arm, frame):
    theirs = frame.assign(**{name: -frame[name] for name in ("qpos.elbow", "qvel.elbow")})
    suspect = first(load_log(theirs, arm))
    assert suspect.sentence == "qpos.elbow and qvel.elbow have the opposite sign"
    assert suspect.repaired < 0.3 * suspect.error
    np.testing.assert_array_equal(load_log(theirs, arm, **suspect.options).X, load_log(frame, arm).X)


def test_a_mistake_is_told_of_a_log_that_begins_at_rest(arm, frame):
    still = pd.DataFrame(0.0, index=range(60), columns=frame.columns).assign(time=np.arange(60) * 0.01)
    moving = frame.assign(**{name: -frame[name] for name in ("qpos.elbow", "qvel.elbow")})
    log = load_log(pd.concat([still.assign(episode=0.0), moving.assign(episode=1.0)]), arm)
    assert first(log).sentence == "qpos.elbow and qvel.elbow have the opposite sign"


def test_commands_that_are_late_are_told(arm, frame):
    theirs = frame.assign(**{name: frame[name].shift(2).bfill() for name in ("ctrl.elbow", "ctrl.shoulder")})
    suspect = first(load_log(theirs, arm))
    assert suspect.kind == "shift"
    assert "of 2 rows later" in suspect.sentence


@pytest.mark.parametrize(("rows", "said"), [(1, "1 row later"), (-2, "2 rows earlier")])
def test_velocities_that_are_apart_from_the_positions_are_told(rows, said, arm, tmp_path):
    held = pd.read_csv(formats.held(tmp_path / "held.csv"))
    names = ["qvel.shoulder", "qvel.elbow"]
    suspect = first(load_log(held.assign(**{name: held[name].shift(rows) for name in names}), arm))
    assert suspect.sentence.startswith(f"the velocities fit those of {said}")
    assert suspect.repaired < 1e-6 * suspect.error


def test_swapped_joints_are_told_with_positions_alone_too(arm, frame):
    theirs = frame.drop(columns=["qvel.shoulder", "qvel.elbow"])
    theirs = theirs.rename(columns={"qpos.elbow": "qpos.shoulder", "qpos.shoulder": "qpos.elbow"})
    suspect = first(load_log(theirs, arm))
    assert suspect.sentence == "qpos.shoulder and qpos.elbow are swapped"
    assert suspect.repaired < 0.3 * suspect.error


@pytest.mark.parametrize("velocities", [True, False])
def test_degrees_are_refused_where_commands_are_positions(velocities, arm, frame):
    """Also where no joint leaves its range: the servo's forces are linear, and gravity alone tells."""
    names = [name for name in frame if name != "time" and (velocities or not name.startswith("qvel."))]
    theirs = pd.DataFrame({"time": frame["time"]} | {name: np.rad2deg(frame[name]) for name in names})
    with pytest.raises(LogError, match="look like degrees") as caught:
        load_log(theirs, arm)
    log = load_log(theirs, arm, **caught.value.options)
    columns = [0, 1, 4, 5]
    np.testing.assert_allclose(log.X[:, columns], load_log(frame, arm).X[:, columns], rtol=1e-12, atol=1e-12)
    load_log(theirs, arm, units="rad")


def test_positions_beyond_the_joints_ranges_look_like_degrees():
    limited = formats.ARM.replace('range="-150 150"', 'range="-90 90"')
    time = 0.01 * np.arange(100)
    wide = {"time": time, "ctrl.shoulder": 60 * np.sin(time), "ctrl.elbow": 70 * np.cos(time)}
    wide |= {"qpos.shoulder": 60 * np.sin(9 * time), "qpos.elbow": 70 * np.cos(9 * time)}
    with pytest.raises(
        LogError, match=r"qpos\.shoulder reaches .* where the joint allows -1\.57 to 1\.57 rad"
    ):
        load_log(wide, MujocoSimulator(limited))


def test_of_few_rows_ranges_tell_degrees_where_no_error_can():
    simulator = MujocoSimulator(formats.ARM.replace('range="-150 150"', 'range="-90 90"'))
    time = 0.01 * np.arange(100)
    wide = {"time": time, "ctrl.shoulder": 60 * np.sin(time), "ctrl.elbow": 70 * np.cos(time)}
    wide |= {"qpos.shoulder": 60 * np.sin(9 * time), "qpos.elbow": 70 * np.cos(9 * time)}
    log = load_log(wide, simulator, units="rad")
    some = slice(15, 23)
    suspect = in_degrees(simulator, replace(log, X=log.X[some], y=log.y[some], groups=log.groups[some]))
    assert suspect.sentence.endswith("these look like degrees.")
    assert suspect.options == {"units": "deg"}
    assert np.isnan([suspect.error, suspect.repaired]).all()


LIFTED = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body>
<joint name="turn" axis="0 0 1" damping="1" armature=".1"/>
<geom type="box" pos=".2 0 0" size=".2 .03 .03" mass="2" contype="0" conaffinity="0"/>
<body pos=".4 0 0"><joint name="lift" type="slide" axis="0 0 1" damping="20"/><geom size=".03" mass="1"/></body>
</body></worldbody><actuator>
<position name="turn" joint="turn" kp="200" kv="15" forcerange="-5 5"/>
<position name="lift" joint="lift" kp="4000" kv="90"/>
</actuator></mujoco>"""


def followed(n_rows=300):
    """Return a log of an arm that turns and lifts, in degrees and metres."""
    simulator = MujocoSimulator(LIFTED, frame_skip=5)
    time = simulator.dt * np.arange(n_rows + 1)
    commands = np.stack([0.8 * np.sign(np.sin(2 * time)), 0.05 * np.sin(7 * time)], axis=1)
    path = simulator.rollout(np.zeros((1, 4)), commands[None, :-1], n_steps=n_rows)[0]
    values = np.column_stack([path, commands]) * np.rad2deg(
        [1, np.deg2rad(1), 1, np.deg2rad(1), 1, np.deg2rad(1)]
    )
    return simulator, pd.DataFrame(values, columns=simulator.input_names).assign(time=time)


def test_of_servos_in_degrees_those_of_slides_stay_in_metres():
    simulator, theirs = followed()
    with pytest.raises(LogError, match="the commands of servos look like degrees") as caught:
        load_log(theirs, simulator)
    assert caught.value.options == {"units": "deg"}


CRANE = """<mujoco><option timestep="0.005"/><worldbody><body><joint name="rail" type="slide" axis="1 0 0" damping="5"/>
<geom size=".1" mass="12"/><body pos="0 0 -1"><joint name="swing" axis="0 1 0" pos="0 0 1" damping=".02"/>
<geom size=".08" mass="4"/></body></body></worldbody><actuator><motor name="drive" joint="rail"/></actuator></mujoco>"""


def swung(noise, n_rows=400):
    """Return a log of a crane whose load swings, in degrees and metres; noise of speeds in m/s and rad/s."""
    simulator = MujocoSimulator(CRANE, frame_skip=2)
    time = simulator.dt * np.arange(n_rows + 1)
    commands = 35 * np.sign(np.sin(2 * time))[:, None]
    path = simulator.rollout(np.zeros((1, 4)), commands[None, :-1], n_steps=n_rows)[0]
    path[:, 2:] += np.random.default_rng(0).normal(scale=noise, size=(n_rows + 1, 2))
    values = np.column_stack([path, commands]) * np.rad2deg(
        [np.deg2rad(1), 1, np.deg2rad(1), 1, np.deg2rad(1)]
    )
    return simulator, pd.DataFrame(values, columns=simulator.input_names).assign(time=time)


def test_degrees_are_refused_though_noise_is_most_of_what_changes_from_row_to_row():
    simulator, theirs = swung(noise=0.015)
    log = load_log(theirs, simulator, units="rad")
    assert 0.5 < suspects(simulator, log, kinds=("degrees",))[0].repaired < 1
    with pytest.raises(LogError, match="look like degrees"):
        load_log(theirs, simulator)
    load_log(theirs, simulator, units="deg")


def test_degrees_are_tried_of_encoders_that_flicker_at_rest():
    """Speeds made of such positions say nothing of the positions' unit."""
    simulator, theirs = followed()
    flickering = theirs.drop(columns=["qvel.turn", "qvel.lift"])
    noise = np.random.default_rng(0).normal(scale=0.6, size=len(theirs))
    flickering["qpos.turn"] = (20 * np.sign(theirs["qpos.turn"]) + noise).round()
    log = load_log(flickering, simulator, units="rad")
    assert suspects(simulator, log, kinds=("degrees",))
