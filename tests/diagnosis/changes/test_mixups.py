"""Columns of a log that were mixed up: each kind is told, and none of a log as it is."""

import numpy as np
import pytest

from skat.diagnosis.changes import mixups
from skat.diagnosis.changes.mixups import mistake_of
from tests.diagnosis.changes.arm import arm, question_about
from tests.diagnosis.forces.test_force_space import log_of

NEEDED = np.log(100.0)
DAMPING = ("damping[shoulder]", "damping[elbow]")
# Columns of the state: positions 0 and 1, speeds 2 and 3; commands are 4 and 5.
MIXED = {
    "ctrl.shoulder has its sign turned": ([], [4]),
    "ctrl.elbow has its sign turned": ([], [5]),
    "qpos.shoulder has its sign turned": ([], [0, 2]),
    "qpos.elbow has its sign turned": ([], [1, 3]),
    "ctrl.shoulder and ctrl.elbow are swapped": ([4, 5], []),
    "qpos.shoulder and qpos.elbow are swapped": ([0, 1, 2, 3], []),
}
# What another one does to the other joint.
LIKE_ANOTHER = ("ctrl.shoulder has", "qpos.elbow has")


def mixed(log, swapped, turned):
    """Return a log with columns in each other's place, and with the signs of others turned."""
    X, y, groups = (table.copy() for table in log)
    for first, second in zip(swapped[::2], swapped[1::2], strict=True):
        for table in (X, y) if first < 4 else (X,):
            table[:, [first, second]] = table[:, [second, first]]
    for column in turned:
        for table in (X, y) if column < 4 else (X,):
            table[:, column] *= -1
    return X, y, groups


def unmeasured(log, columns):
    X, y, groups = (table.copy() for table in log)
    X[:, columns] = y[:, columns] = np.nan
    return X, y, groups


def told(before, after):
    question = question_about(arm(), before, after, effects=DAMPING)
    words, nats = mistake_of(question, np.zeros(0), price=0.0, needed=NEEDED)
    return words if nats > NEEDED else ""


def test_the_price_of_changes_is_gained_and_what_is_less_likely_by_what_is_needed_is_not_told():
    after = mixed(log_of(5), *MIXED["ctrl.elbow has its sign turned"])
    question = question_about(arm(), log_of(4), after, effects=DAMPING)
    words, nats = mistake_of(question, np.zeros(0), price=0.0, needed=NEEDED)
    for price, told in ((3.0, True), (-nats - NEEDED + 0.1, True), (-nats - NEEDED - 0.1, False)):
        found = mistake_of(question, np.zeros(0), price=price, needed=NEEDED)
        assert found == ((words, pytest.approx(nats + price)) if told else ("", -np.inf))


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.long if name.startswith(LIKE_ANOTHER) else ()) for name in MIXED],
)
def test_each_mix_up_of_the_second_log_is_told(name):
    assert told(log_of(4), mixed(log_of(5), *MIXED[name])) == name


def test_all_that_mend_the_second_log_alike_are_told(monkeypatch):
    """As of a pendulum, whose angle may as well be turned as its command."""
    mixed_up, name = mixups._mixed_up, "ctrl.elbow has its sign turned"

    def with_a_twin(simulator, half):
        found = mixed_up(simulator, half)
        return [*found, ("its twin", dict(found)[name])]

    monkeypatch.setattr(mixups, "_mixed_up", with_a_twin)
    assert told(log_of(4), mixed(log_of(5), *MIXED[name])) == f"{name}, or its twin"


def test_nothing_is_told_of_a_log_as_it_is():
    assert told(log_of(4), log_of(5)) == ""


def test_what_is_mixed_up_in_both_logs_is_the_model():
    swapped = MIXED["ctrl.shoulder and ctrl.elbow are swapped"]
    assert told(mixed(log_of(4), *swapped), mixed(log_of(5), *swapped)) == ""


@pytest.mark.parametrize("where", [(0, 1), (0,), (1,)])
def test_two_joints_are_told_as_swapped_by_what_was_measured_of_both(where):
    # In neither log do both joints' rows end at one frequency.
    for after, expected in (
        (log_of(4), ""),
        (
            mixed(log_of(4), *MIXED["qpos.shoulder and qpos.elbow are swapped"]),
            "qpos.shoulder and qpos.elbow are swapped",
        ),
    ):
        logs = [log_of(5), after]
        for one in where:
            logs[one] = unmeasured(logs[one], 3)
        assert told(*logs) == expected
