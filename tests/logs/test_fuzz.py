import signal

import numpy as np
import pytest

from tests.logs import mutations

pytest.importorskip("pyarrow")
pytest.importorskip("rosbags")
pytest.importorskip("mcap")
pytest.importorskip("minari")

# 300 in all; the readers' own costs decide how many of each. benchmarks/fuzz_logs.py makes 10,000.
TIMES = dict.fromkeys(mutations.KINDS, 12) | dict.fromkeys(("csv", "lists", "gzip", "npz"), 18)
LONGEST = 5


@pytest.fixture(scope="module")
def arm():
    return mutations.arm()


def hangs(signum, frame):
    raise AssertionError(f"reading took more than {LONGEST} s")


def test_three_hundred_damaged_logs_are_tried():
    assert sum(TIMES.values()) >= 300


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", mutations.KINDS)
def test_a_damaged_log_is_read_or_refused_with_the_error_of_a_log(kind, arm, tmp_path):
    (tmp_path / "whole").mkdir()
    path = mutations.seed(kind, tmp_path / "whole")
    assert mutations.outcome(path, arm, kind) == "read"
    rng = np.random.default_rng(mutations.KINDS.index(kind))
    ends = []
    for _ in range(TIMES[kind]):
        copy, how = mutations.damaged(path, tmp_path, rng)
        before = signal.signal(signal.SIGALRM, hangs)
        signal.alarm(LONGEST)
        try:
            ends.append(mutations.outcome(copy, arm, kind))
        except Exception as error:
            error.add_note(how)
            raise
        finally:
            signal.alarm(0)
            signal.signal(signal.SIGALRM, before)
    assert set(ends) <= {"read", *(kind.__name__ for kind in mutations.ALLOWED)}
