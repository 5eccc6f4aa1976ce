import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

LOGS = Path(os.environ.get("SKAT_DATA_HOME", "")) / "double_pendulum"
pytestmark = pytest.mark.skipif(
    not LOGS.is_dir(), reason="needs the measured logs of the arm in $SKAT_DATA_HOME"
)


def test_pieces_of_the_arm_are_whole_and_follow_the_clock():
    import measured

    X, y, groups = measured.arm_log(measured.RUNS[:1], 5, 0.5)
    assert X.shape[1] == 6
    assert set(np.bincount(groups)) == {50}
    inside = groups[1:] == groups[:-1]
    np.testing.assert_array_equal(y[:-1][inside], X[1:, :4][inside])
    # Angles change as the measured speeds say, at 10 ms a row, within the speeds' noise.
    moved, said = (y - X[:, :4])[:, :2], 0.005 * (X[:, 2:4] + y[:, 2:])
    assert np.all((moved - said).std(axis=0) < 0.1 * moved.std(axis=0))
    hidden, _, _ = measured.arm_log(measured.RUNS[:1], 5, 0.5, measured=False)
    assert np.isnan(hidden[:, 2:4]).all()
    np.testing.assert_array_equal(hidden[:, [0, 1, 4, 5]], X[:, [0, 1, 4, 5]])


def test_friction_and_rotors_explain_most_of_the_arm_s_open_loop():
    import measured

    nominal, with_friction = (
        measured.open_loop(mujoco.MjModel.from_xml_string(measured.arm_mjcf(*extra)))
        for extra in ((), ((0.25, 0.19), (0.0, 0.0), (0.0023, 0.0023)))
    )
    assert with_friction < 0.25 * nominal
