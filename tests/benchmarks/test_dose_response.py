import os
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(
    not (Path(os.environ.get("SKAT_DATA_HOME", "")) / "ur10_bag").is_dir(),
    reason="needs the measured log of the UR10 in $SKAT_DATA_HOME",
)


def test_a_motor_whose_command_is_turned_is_told_to_have_no_other_gain():
    pytest.importorskip("rosbags")
    import dose_response

    (case,) = (one for one in dose_response.cases(cut=True) if "flip wrist_1_joint" in one.name)
    line = dose_response.run(case, {})
    assert line["verdict"] == "unexplained" or dose_response.told_mixed_up(line)
