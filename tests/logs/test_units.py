import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skat.logs import LogError, load_log, read_map
from skat.logs.units import BASE, parsed_unit
from skat.simulators import MujocoSimulator
from tests.logs import formats

# (unit, limits of the joint, theirs, ours), by hand.
CASES = [
    ("deg", None, 180.0, np.pi),
    ("deg/s", None, 90.0, np.pi / 2),
    ("rpm", None, 60.0, 2 * np.pi),
    ("rps", None, 0.5, np.pi),
    ("rev", None, 0.25, np.pi / 2),
    ("mrad", None, 1500.0, 1.5),
    ("mm", None, 25.0, 0.025),
    ("cm/s", None, 25.0, 0.25),
    ("mNm", None, 40.0, 0.04),
    ("A:0.12", None, 2.0, 0.24),
    ("mA:0.12", None, 2000.0, 0.24),
    ("-A:0.12", None, 2.0, -0.24),
    ("x:0.5", None, 3.0, 1.5),
    ("ticks:4096", None, 1024.0, np.pi / 2),
    ("ticks:4096-2048", None, 2048.0, 0.0),
    ("ticks:4096-2048", None, 3072.0, np.pi / 2),
    ("-deg+90", None, 30.0, np.pi / 3),
    ("percent:-100:100", (-1.0, 3.0), -100.0, -1.0),
    ("percent:-100:100", (-1.0, 3.0), 0.0, 1.0),
    ("percent:-100:100", (-1.0, 3.0), 100.0, 3.0),
    ("percent:0:100", (-1.0, 3.0), 25.0, 0.0),
    ("percent:-100:100:-1.9:1.9", (-1.0, 3.0), 50.0, 0.95),
]


@pytest.mark.parametrize(("unit", "limits", "theirs", "ours"), CASES)
def test_a_unit_is_what_it_says(unit, limits, theirs, ours):
    assert parsed_unit(unit, limits=limits).applied(np.array([theirs]))[0] == pytest.approx(ours, abs=1e-12)


@given(st.sampled_from(sorted(BASE)), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_a_turned_unit_with_an_offset_is_affine(unit, value, offset):
    turned = parsed_unit(f"-{unit}{offset:+f}").applied(np.array([value]))[0]
    assert turned == pytest.approx(BASE[unit][0] * (round(offset, 6) - value), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("unit", "said"),
    [
        ("percent", "needs the values at both ends"),
        ("percent:-100:100", "the model has no limits there"),
        ("percent:1:1:0:1", "a range without length"),
        ("ticks", "ticks:4096"),
        ("ticks:many", "'many' where numbers belong"),
        ("A", "the motor's torque constant"),
        ("x:inf", "needs finite numbers"),
        ("furlong", "known: rad, deg"),
    ],
)
def test_a_unit_that_is_none_says_what_to_write(unit, said):
    with pytest.raises(ValueError, match="unit") as caught:
        parsed_unit(unit)
    assert said in str(caught.value)


@pytest.fixture
def arm():
    return MujocoSimulator(formats.ARM)


def test_percentages_of_a_servos_range_are_those_of_its_joint(arm, tmp_path):
    """As LeRobot stores the SO-100 and SO-101: positions and commands from -100 to 100 of what was calibrated."""
    expected = load_log(formats.documented(tmp_path / "log.csv", "positions"), arm).X
    limit = np.deg2rad(150)
    time, q, _, u = formats.table("positions")
    theirs = {"time": time, "observation.state": 100 * q / limit, "action": 100 * u / limit}
    columns = {"qpos.*": ":percent:-100:100", "ctrl.*": ":percent:-100:100"}
    log = load_log(theirs, arm, columns=columns)
    np.testing.assert_allclose(log.X, expected, rtol=1e-12, atol=1e-12)


def test_a_lerobot_that_looks_like_degrees_may_be_in_percentages(arm, tmp_path, monkeypatch):
    expected = load_log(formats.documented(tmp_path / "log.csv", "positions"), arm).X
    plain, limit = formats.table, np.deg2rad(150)

    def table(state):
        t, q, v, u = plain(state)
        return t, 100 * q / limit, v, 100 * u / limit

    monkeypatch.setattr(formats, "table", table)
    source, _ = formats.lerobot(tmp_path, "positions")
    with pytest.raises(LogError, match="look like degrees") as caught:
        load_log(source, arm)
    remedy = re.findall(r"--map '([^']*percent[^']*)'", str(caught.value))
    assert len(remedy) == 2
    log = load_log(source, arm, columns=read_map(remedy))
    np.testing.assert_allclose(log.X, expected, rtol=1e-12, atol=1e-12)


def test_a_length_is_no_unit_of_an_angle(arm, tmp_path):
    path = formats.documented(tmp_path / "log.csv")
    with pytest.raises(LogError, match="'rpm' does not measure what the model has in rad"):
        load_log(path, arm, columns={"qpos.*": ":rpm"})
    rates = load_log(path, arm, columns={"qvel.*": ":rpm"}).X
    np.testing.assert_allclose(rates[:, 2:4], 2 * np.pi / 60 * load_log(path, arm).X[:, 2:4], rtol=1e-12)
