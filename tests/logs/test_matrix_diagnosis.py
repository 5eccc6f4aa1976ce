"""The whole diagnosis of a log in ten cells of the matrix: the same cause, inside the same interval."""

import functools
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
import pandas as pd
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.experiments.studies import study_log
from skat.logs import load_log
from skat.simulators import MujocoSimulator
from tests.logs import formats

pytest.importorskip("pyarrow")
pytest.importorskip("rosbags")
pytest.importorskip("mcap")
pytest.importorskip("minari")

# Each format once, each state at least once.
CELLS = list(zip(formats.FORMATS, (*formats.STATES, "positions", "jitter", "lost")))
CAUSE = "damping[elbow]"
# Of the log's arm; its model has half of it.
HIDDEN = 0.3
MODEL = formats.ARM.replace(f'damping="{HIDDEN}"', f'damping="{HIDDEN / 2}"')
EFFECTS = [CAUSE, "damping[shoulder]", "mass[lower]", "gain[shoulder]", "gain[elbow]", "dry_friction[elbow]"]
NOISE = {"position": 2e-4, "velocity": 2e-3}  # rad, rad/s

ROWS = 400


@functools.cache
def motion():
    """Return the motion of the arm every ms, as sensors with noise tell it, under commands that each row holds."""
    model = mujoco.MjModel.from_xml_string(formats.ARM)
    data = mujoco.MjData(model)
    steps = ROWS * 1000 // formats.RATE
    times, q, v, u = np.arange(steps) / 1000, *(np.empty((steps, 2)) for _ in range(3))
    for step in range(steps):
        time = times[step - step % (1000 // formats.RATE)]
        data.ctrl[:] = 1.2 * np.sin(5 * time), 0.9 * np.sin(8 * time + 1)
        q[step], v[step], u[step] = data.qpos, data.qvel, data.ctrl
        mujoco.mj_step(model, data)
    rng = np.random.default_rng(0)
    q += NOISE["position"] * rng.normal(size=q.shape)
    v += NOISE["velocity"] * rng.normal(size=v.shape)
    return times, q, v, u


@pytest.fixture
def noisy(monkeypatch):
    """Let the writers write longer logs of an arm with sensors."""
    monkeypatch.setattr(formats, "ROWS", ROWS)
    monkeypatch.setattr(formats, "motion", motion)


def diagnosed(source, **options):
    log = load_log(source, MujocoSimulator(MODEL), **options)
    diagnosis = SimulationDiagnosis(log.simulator, effects=EFFECTS, test_size=0, random_state=0)
    return diagnosis.fit(log.X, log.y, groups=log.groups, floor=log.floor)


@functools.cache
def of_the_clean_log():
    """Return the cause that the documented CSV names; to be asked while the writers write longer logs."""
    with TemporaryDirectory() as folder:
        return named(diagnosed(formats.documented(Path(folder, "clean.csv"))))


def named(diagnosis):
    """Return the only cause."""
    assert [cause.name for cause in diagnosis.causes_] == [CAUSE], diagnosis.verdict_
    return diagnosis.causes_[0]


@pytest.mark.long
@pytest.mark.parametrize(("kind", "state"), CELLS, ids=[f"{kind}-{state}" for kind, state in CELLS])
def test_a_log_in_any_format_and_state_names_the_same_cause_inside_the_same_interval(
    kind, state, noisy, tmp_path
):
    source, options = formats.write(kind, state, tmp_path)
    cause = named(diagnosed(source, **options))
    told = {"units": "deg"} if state == "degrees" else {}
    same = named(diagnosed(formats.documented(tmp_path / "same.csv", state), **told))
    np.testing.assert_allclose([cause.value, *cause.interval], [same.value, *same.interval], rtol=1e-6)
    clean = of_the_clean_log()
    # What lacks half of its channels tells less: its wider interval is to hold what the whole log says.
    inside = _holds(clean.interval, cause.value) or _holds(cause.interval, clean.value)
    assert inside
    assert clean.interval[0] < HIDDEN / 2 < clean.interval[1]


def test_the_error_of_interpolation_is_carried_into_the_noise(tmp_path):
    path = formats.documented(tmp_path / "log.csv", "jitter")
    pd.read_csv(path).tail(45).to_csv(path, index=False)
    log = load_log(path, MujocoSimulator(MODEL))
    assert log.interpolation
    least = np.sqrt(log.floor)
    told = {"effects": [CAUSE], "velocities": "measured"}
    carried = study_log(log, test_size=0, **told).diagnosis
    assert (carried.noise_ >= (1 - 1e-9) * least).all()
    bare = SimulationDiagnosis(log.simulator, test_size=0, **told).fit(log.X, log.y, groups=log.groups)
    assert (bare.noise_ < 0.9 * least).any()


def _holds(interval, value):
    return interval[0] <= value <= interval[1]


def test_each_format_and_each_state_is_in_a_cell():
    assert {kind for kind, _ in CELLS} == set(formats.FORMATS)
    assert {state for _, state in CELLS} == set(formats.STATES)
    assert len(CELLS) == 10
