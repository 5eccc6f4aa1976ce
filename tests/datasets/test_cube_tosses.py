import hashlib

import numpy as np
import pytest

from skat.datasets import cube_toss_simulator, fetch_cube_tosses
from skat.datasets.cube_tosses import N_TOSSES, SOURCE, STATE_NAMES, read_toss


def test_conversion_of_the_originals_agrees_with_the_tidied_copy(measured_data):
    originals = sorted((measured_data / "cube_tosses" / "raw").glob("*.pt"))
    assert len(originals) == 5
    with np.load(measured_data / "cube_tosses" / "tosses_si.npz") as tidied:
        for path in originals:
            np.testing.assert_allclose(read_toss(path), tidied[path.stem], rtol=1e-14, atol=1e-15)


def test_every_toss_has_a_hash_and_those_at_hand_have_it(measured_data):
    assert list(SOURCE.hashes) == [f"{toss}.pt" for toss in range(N_TOSSES)]
    for path in (measured_data / "cube_tosses" / "raw").glob("*.pt"):
        assert hashlib.sha256(path.read_bytes()).hexdigest() == SOURCE.hashes[path.name]


def test_originals_and_tidied_copy_load_alike(measured_data, tmp_path, monkeypatch):
    tosses = [127, 0, 10]
    tidied = fetch_cube_tosses(tosses, download_if_missing=False)
    (tmp_path / "cube_tosses").mkdir()
    (tmp_path / "cube_tosses" / "raw").symlink_to(measured_data / "cube_tosses" / "raw")
    monkeypatch.setenv("SKAT_DATA_HOME", str(tmp_path))
    original = fetch_cube_tosses(tosses, download_if_missing=False)
    np.testing.assert_allclose(original.data, tidied.data, rtol=1e-14, atol=1e-15)
    assert list(dict.fromkeys(original.groups)) == tosses
    with pytest.raises(OSError, match="1 of 4 files of cube_tosses"):
        fetch_cube_tosses([*tosses, 3], data_home=tmp_path / "empty", download_if_missing=False)


def test_a_transition_ends_where_the_next_one_starts(measured_data):
    tosses = fetch_cube_tosses(range(5), download_if_missing=False)
    within = np.diff(tosses.groups) == 0
    assert np.array_equal(tosses.target[:-1][within], tosses.data[1:][within])
    assert len(tosses.frame) == len(tosses.data) + 5


def test_velocity_is_the_difference_from_the_frame_before(measured_data):
    tosses = fetch_cube_tosses(range(20), download_if_missing=False)
    difference = (tosses.target[:, :3] - tosses.data[:, :3]) / tosses.dt
    before, after = (np.abs(v[:, 7:10] - difference).mean() for v in (tosses.data, tosses.target))
    assert after < 0.006
    assert before > 2 * after


def test_unknown_tosses_are_refused():
    with pytest.raises(ValueError, match=r"no toss 570.*from 0 to 569"):
        fetch_cube_tosses([0, 570])
    with pytest.raises(ValueError, match="No toss was asked for"):
        fetch_cube_tosses([])


def test_simulated_cube_falls_freely_and_comes_to_rest_on_its_face():
    simulator = cube_toss_simulator()
    assert list(simulator.state_names) == STATE_NAMES
    assert simulator.dt == pytest.approx(1 / 148, rel=1e-12)
    start = np.array([[0, 0, 0.3, 1, 0, 0, 0, 0.5, 0, 0, 0, 0, 0]])
    states = simulator.rollout(start, n_steps=300)[0]
    time = np.arange(20) / 148
    np.testing.assert_allclose(states[:20, 0], 0.5 * time, atol=1e-12)
    np.testing.assert_allclose(states[:20, 9], -9.81 * time, atol=1e-9)
    assert abs(states[-1, 2] - 0.0524) < 1e-3
    assert np.abs(states[-1, 7:]).max() < 1e-3
