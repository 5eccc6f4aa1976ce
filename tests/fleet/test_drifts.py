"""Which of many names hold, and what changed over time, against hand calculations and simulated estimates."""

import numpy as np
import pytest
from scipy.stats import t

from skat.effects import Effect
from skat.fleet.drifts import WORD, Estimate, discoveries, drifts_of

FRICTION = Effect("dry_friction[elbow]", unit="N m", neutral=0.0, bounds=(0.0, 5.0), typical=0.1)
GAIN = Effect("gain[elbow]", unit="1", neutral=1.0, bounds=(0.1, 10.0), typical=0.2)
EFFECTS = {effect.name: effect for effect in (FRICTION, GAIN)}


def series(places, deviations, name=FRICTION.name):
    return [{name: Estimate(place, deviation)} for place, deviation in zip(places, deviations)]


def drifts(robots, *, name=FRICTION.name, rate=0.05):
    times = {robot: list(range(len(logs))) for robot, logs in robots.items()}
    return drifts_of(robots, times, EFFECTS, {robot: [name] for robot in robots}, rate=rate)


def test_as_many_of_the_likeliest_hold_as_are_false_no_more_often_than_allowed():
    probabilities = np.array([0.7, 1.0, 0.99, 0.9, 0.2])
    # In the mean 0, .5 %, 3.67 %, 10.3 % and 24 % of the one, two, ... likeliest are false.
    assert discoveries(probabilities, 0.05).tolist() == [False, True, True, True, False]
    assert discoveries(probabilities, 0.11).tolist() == [True, True, True, True, False]
    assert discoveries(np.zeros(0), 0.05).tolist() == []


def test_a_step_between_two_logs_is_that_of_students_law():
    found = drifts({"17": series([0.10, 0.14], [0.005, 0.005])})
    (row,) = found.to_dict("records")
    error = 0.005 * np.sqrt(2)
    assert (row["robot"], row["effect"], row["since"], row["unit"]) == ("17", FRICTION.name, 1, "N m")
    assert (row["before"], row["after"], row["change"]) == pytest.approx((0.10, 0.14, 0.04))
    assert row["p"] == pytest.approx(2 * t.sf(0.04 / error, WORD))
    half = t.isf(0.025, WORD) * error
    assert (row["low"], row["high"]) == pytest.approx((0.04 - half, 0.04 + half))


@pytest.mark.parametrize("n", [2, 3, 4, 5, 6, 8])
def test_a_step_of_ten_errors_is_told_of_one_robot_however_few_its_logs(n):
    """100 robots, one at a time, and 400 that stayed the same."""
    rng = np.random.default_rng(n)
    step = 0.1 * (np.arange(n) >= n // 2)
    told = [len(drifts({"1": series(rng.normal(step, 0.01), np.full(n, 0.01))})) for _ in range(100)]
    false = [len(drifts({"1": series(rng.normal(0, 0.01, n), np.full(n, 0.01))})) for _ in range(400)]
    assert np.mean(told) >= 0.98
    assert np.mean(false) <= 0.05


def test_a_change_of_a_factor_is_a_ratio():
    (row,) = drifts({"1": series([0.0, np.log(1.2)], [0.01, 0.01], GAIN.name)}, name=GAIN.name).to_dict(
        "records"
    )
    assert (row["before"], row["after"], row["change"]) == pytest.approx((1.0, 1.2, 1.2))
    assert row["neutral"] == 1


def test_errors_of_unequal_size_are_weighed():
    (row,) = drifts({"1": series([0.1, 0.3, 0.5, 0.5], [0.01, 1.0, 0.01, 0.01])}).to_dict("records")
    assert row["since"] in (1, 2)
    assert row["before"] == pytest.approx(0.1, abs=1e-3)
    assert row["after"] == pytest.approx(0.5, abs=1e-3)


def test_what_scatters_by_more_than_its_errors_is_no_step():
    rng = np.random.default_rng(0)
    scattered = rng.normal(0.2, 0.02, size=12)
    assert drifts({"1": series(scattered, np.full(12, 0.002))}).empty
    assert len(drifts({"1": series(scattered + 0.2 * (np.arange(12) > 6), np.full(12, 0.002))})) == 1


def test_few_of_many_robots_without_a_change_are_told_and_nearly_all_with_one():
    """Of 200 robots of six logs each ten change, by six standard errors of one log; 40 repeats."""
    rng = np.random.default_rng(1)
    told, false = 0, []
    for _ in range(40):
        robots = {}
        for robot in range(200):
            places = 0.2 + rng.normal(0, 0.01, size=6)
            if robot < 10:
                places[rng.integers(1, 6) :] += 0.06
            robots[str(robot)] = series(places, np.full(6, 0.01))
        found = drifts(robots)["robot"].astype(int).to_numpy()
        told += np.sum(found < 10)
        false.append(np.mean(found >= 10) if len(found) else 0.0)
    assert np.mean(false) <= 0.05
    assert told >= 0.9 * 400


def test_one_log_of_a_robot_has_no_before():
    assert drifts({"1": series([0.1], [0.01])}).empty
    missing = [{FRICTION.name: Estimate(0.1, 0.01)}, {}]
    assert drifts({"1": missing}).empty
