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
