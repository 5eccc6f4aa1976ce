"""A map that is written is read again, and says the same."""

import numpy as np
import pytest

from skat.logs import load_log, write_map
from skat.simulators import MujocoSimulator
from tests.logs import formats


@pytest.mark.parametrize("kind", ["mcap_json", "rosbag2_mcap", "npz", "lerobot"])
def test_a_written_map_reads_the_log_as_what_was_told_did(kind, tmp_path):
    pytest.importorskip("mcap")
    simulator = MujocoSimulator(formats.ARM)
    source, told = formats.write(kind, "names", tmp_path)
    log = load_log(source, simulator, **told)
    again = load_log(source, simulator, columns=write_map(tmp_path / "map.toml", log))
    np.testing.assert_array_equal(again.X, log.X)
    np.testing.assert_array_equal(again.y, log.y)
