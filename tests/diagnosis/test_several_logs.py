"""Several logs of one robot: causes shared, noise of each its own, and whether they agree."""

import json

import numpy as np
import pandas as pd
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.chains import Chains
from skat.diagnosis.log import check_log, put_together
from skat.diagnosis.noise import estimate_noise, normal_noise
from skat.diagnosis.report.agreement import agreement_sentences
from skat.diagnosis.report.machine import findings_as_data
from skat.effects import Effect
from skat.simulators import FunctionSimulator
from tests.machines import DT, RATE, heater


def log_of(seed, rate, noise, n=150):
    """Return X, y, groups of three episodes, by Euler's steps of a hundredth of a row."""
    rng = np.random.default_rng(seed)
    X, y = [], []
    for _ in range(3):
        given, warmth = np.repeat(rng.uniform(0, 2, n // 15), 5), [1.0]
        for row in range(n // 3):
            now = warmth[-1]
            for _ in range(100):
                now += DT / 100 * rate * (given[row] - now)
            warmth.append(now)
        read = np.array(warmth) + noise * rng.normal(size=len(warmth))
        X.append(np.column_stack([read[:-1], given]))
        y.append(read[1:, None])
    return np.concatenate(X), np.concatenate(y), np.repeat([0, 1, 2], n // 3)


@pytest.fixture(scope="module")
def alike():
    """A log that was measured well, one that was not, and what they say together."""
    logs = {"june": log_of(1, 1.4 * RATE, 0.01), "july": log_of(2, 1.4 * RATE, 0.06)}
    return logs, SimulationDiagnosis(heater(), random_state=0).fit(logs)


@pytest.fixture(scope="module")
def apart():
    logs = [log_of(3, RATE, 0.01), log_of(4, 1.4 * RATE, 0.01)]
    with pytest.warns(UserWarning, match=r"do not agree on rate \(agreement_\)"):
        return SimulationDiagnosis(heater(), random_state=0, test_size=0).fit(logs)


def test_a_cause_is_shared_and_each_log_has_its_noise(alike):
    logs, found = alike
    (cause,) = found.causes_
    assert (found.verdict_, cause.name) == ("named", "rate")
    assert cause.interval[0] < 1.4 * RATE < cause.interval[1]
    noise = found.noise_of_logs_["warmth"]
    assert list(noise.index) == ["june", "july"]
    np.testing.assert_allclose(noise, [0.01, 0.06], rtol=0.25)
    assert found.noise_[0] == pytest.approx(np.sqrt(np.mean(noise**2)))
    # A log that says little spoils nothing of what another says.
    alone = SimulationDiagnosis(heater(), random_state=0).fit(*logs["june"]).causes_[0]
    assert np.ptp(cause.interval) < 1.1 * np.ptp(alone.interval)


def test_logs_that_agree_are_said_to(alike):
    _, found = alike
    (row,) = found.agreement_.to_dict("records")
    assert (row["cause"], row["agreement"], row["n_compared"]) == ("rate", "agree", 2)
    assert row["low in june"] < 1.4 * RATE < row["high in june"]
    wide, narrow = (row[f"high in {name}"] - row[f"low in {name}"] for name in ("july", "june"))
    assert wide > 3 * narrow
    assert "On rate the logs agree (p = " in found.report_.text()


def test_a_cause_of_one_log_alone_is_told_and_no_verdict_speaks_for_both(apart):
    (row,) = apart.agreement_.to_dict("records")
    assert row["agreement"] == "differ"
    for name, rate in (("log 1", RATE), ("log 2", 1.4 * RATE)):
        assert row[f"value in {name}"] == pytest.approx(rate, rel=0.06)
    assert apart.verdict_ == "unexplained"
    assert "The logs do not agree on rate." in apart.report_.text()


def test_so_is_what_is_none_in_both_together():
    """Up in one and down in the other: no value explains both."""
    logs = [log_of(5, 0.85 * RATE, 0.01), log_of(6, RATE / 0.85, 0.01)]
    with pytest.warns(UserWarning, match="do not agree on rate"):
        found = SimulationDiagnosis(heater(), random_state=0, test_size=0, alpha=1e-9).fit(logs)
    assert found.verdict_ == "unexplained"
    assert list(found.agreement_["cause"]) == ["rate"]
    # It is no cause, and more was compared than this row.
    assert set(found.agreement_[["status in log 1", "status in log 2"]].to_numpy().ravel()) == {"estimated"}
    (row,) = found.agreement_.to_dict("records")
    (sentence,) = agreement_sentences(found.agreement_)
    assert ("corrected" in sentence) == (row["p_corrected"] != row["p_value"])


def test_one_log_in_a_list_is_that_log():
    log = log_of(7, 1.4 * RATE, 0.01)
    one, same = (SimulationDiagnosis(heater(), random_state=0).fit(*given) for given in ([[log]], log))
    assert [cause.value for cause in one.causes_] == [cause.value for cause in same.causes_]
    assert one.agreement_ is None
    assert same.noise_of_logs_.shape == (1, 1)


def test_of_each_log_something_is_held_out(alike):
    _, found = alike
    test = found.report_.tests[0].log
    assert set(test.source) == {0, 1}
    assert {label.partition(":")[0] for label in test.labels} == {"june", "july"}
    assert found.gain_.explained > 0.8


def test_noise_of_each_law_is_what_its_chains_say_by_themselves():
    rng = np.random.default_rng(0)
    n, steps = 8, 20
    law = np.array([0, 1, 1, 0, 0, 1, 0, 1])
    walks = np.cumsum(rng.normal(size=(n, steps + 1, 1)) * np.array([0.1, 1.0])[law][:, None, None], axis=1)
    measured = walks + rng.standard_t(3, size=walks.shape) * np.array([0.5, 0.02])[law][:, None, None]
    chains = Chains(
        np.ones((n, steps, 1, 1)), np.zeros((n, steps, 1)), np.zeros((n, steps, 1, 1)), np.ones((n, steps, 1, 1)),
        measured, np.ones((n, steps + 1, 1), dtype=bool), np.full(1, 100.0),
    )  # fmt: skip
    real = np.ones((n, steps), dtype=bool)
    start = normal_noise(chains, np.full((2, 1), 0.1), np.full((2, 1), 0.1), law)
    both = estimate_noise(chains, start, real, floor=np.zeros(1))
    bound = 0.0
    for one in range(2):
        own = law == one
        alone = estimate_noise(chains.of(own), start.alone(one), real[own], floor=np.zeros(1))
        bound += alone.bound
        for name in ("force", "error", "force_nu", "error_nu"):
            np.testing.assert_array_equal(getattr(both.noise, name)[one], getattr(alone.noise, name)[0])
        np.testing.assert_array_equal(both.smoothed.means[own], alone.smoothed.means)
        np.testing.assert_array_equal(both.noise.error_variances[own], alone.noise.error_variances)
    assert both.bound == pytest.approx(bound, abs=1e-9)
    assert both.noise.error[0, 0] > 4 * both.noise.error[1, 0]


def test_what_logs_say_is_kept_in_a_file_and_told_to_programs(alike, tmp_path):
    _, found = alike
    loaded = SimulationDiagnosis.load(found.save(tmp_path / "both.skat"), simulator=heater())
    pd.testing.assert_frame_equal(loaded.agreement_, found.agreement_)
    pd.testing.assert_frame_equal(loaded.noise_of_logs_, found.noise_of_logs_)
    other = log_of(8, 1.4 * RATE, 0.01)
    assert loaded.evaluate(*other).extended == found.evaluate(*other).extended
    data = json.loads(json.dumps(findings_as_data(found), allow_nan=False))
    assert [one["name"] for one in data["logs"]] == ["june", "july"]
    assert data["agreement"][0]["agreement"] == "agree"


def test_a_fit_of_several_goes_on_where_it_was_interrupted(alike, tmp_path):
    logs, found = alike

    def interrupt(stage, done, total):
        if stage == "search" and done == 1:
            raise KeyboardInterrupt

    again = SimulationDiagnosis(heater(), random_state=0)
    with pytest.raises(KeyboardInterrupt):
        again.fit(logs, resume=tmp_path / "half", progress=interrupt)
    assert (tmp_path / "half").exists()
    again.fit(logs, resume=tmp_path / "half")
    assert again.causes_[0].value == found.causes_[0].value


def test_logs_without_time_have_a_noise_each():
    rng = np.random.default_rng(0)
    simulator = FunctionSimulator(
        lambda X, gain=1.0: gain * X,
        input_names=("u",),
        output_names=("v",),
        effects=[Effect("gain", unit="1", neutral=1.0, bounds=(0.1, 10.0))],
    )
    logs = []
    for noise in (0.01, 0.2):
        X = rng.uniform(-1, 1, (80, 1))
        logs.append((X, 1.3 * X + noise * rng.normal(size=X.shape)))
    found = SimulationDiagnosis(simulator, random_state=0).fit(logs)
    np.testing.assert_allclose(found.noise_of_logs_["v"], [0.01, 0.2], rtol=0.25)
    assert found.causes_[0].interval[0] < 1.3 < found.causes_[0].interval[1]
    assert list(found.agreement_["agreement"]) == ["agree"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([log_of(1, RATE, 0.01)[:2], log_of(2, RATE, 0.01)],), "rows of one are in time order"),
        (([log_of(1, RATE, 0.01), (1, 2, 3, 4)],), "log 2: expected a log, or a tuple"),
        (([log_of(1, RATE, 0.01), log_of(2, RATE, 0.01)], None, np.zeros(3)), "groups and floor are those of each"),
        (([],), "there is no log"),
        ((np.zeros((5, 2)),), "requires y to be passed, but the target y is None"),
        (({"june": log_of(1, RATE, 0.01), "july": (np.zeros((9, 3)), np.zeros((9, 1)))},), "july: X has 3 columns"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:Each row begins")
def test_wrong_logs_are_told(arguments, message):
    with pytest.raises(ValueError, match=message):
        SimulationDiagnosis(heater()).fit(*arguments)


def test_logs_put_together_come_apart_again():
    simulator = heater()
    logs = [check_log(simulator, *log_of(seed, RATE, 0.01, n=30 * (seed + 1))) for seed in range(2)]
    whole = put_together(logs, ("a", "b"))
    assert whole.labels[:2] == ("a: 0", "a: 1")
    for one, log in zip(whole.parts, logs):
        np.testing.assert_array_equal(one.X, log.X)
        np.testing.assert_array_equal(one.episodes, log.episodes)
    left, test = whole.split(0.3, np.random.RandomState(0))
    assert len(left) + len(test) == len(whole)
    assert set(left.source) == set(test.source) == {0, 1}
    assert left.split(0.0, np.random.RandomState(0)) == (left, None)
