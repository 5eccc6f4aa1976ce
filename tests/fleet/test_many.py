"""Many logs at once: each as if by itself, whatever is killed on the way."""

import os
import signal

import numpy as np
import pandas as pd
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.effects import Effect
from skat.fleet import diagnose_many
from skat.fleet.many import Fleet, _drifts, _files, _table, clear_store
from skat.logs import Log
from skat.simulators import FunctionSimulator, MujocoSimulator
from tests.machines import DT, RATE, decaying, heater


def log_of(seed, rate=RATE, n=60):
    """Return X, y, groups of a heater, by Euler's steps of a hundredth of a row."""
    rng = np.random.default_rng(seed)
    given, warmth = np.repeat(rng.uniform(0, 2, n // 5), 5), [1.0]
    for row in range(n):
        now = warmth[-1]
        for _ in range(100):
            now += DT / 100 * rate * (given[row] - now)
        warmth.append(now)
    read = np.array(warmth) + 0.01 * rng.normal(size=n + 1)
    return np.column_stack([read[:-1], given]), read[1:, None], np.repeat([0, 1, 2], n // 3)


@pytest.fixture(scope="module")
def logs():
    return [log_of(seed, rate=RATE if seed % 3 else 1.3 * RATE) for seed in range(6)]


@pytest.fixture(scope="module")
def fleet(logs):
    return diagnose_many(logs, heater(), names=list("abcdef"))


def test_each_log_has_the_answer_that_it_has_by_itself(logs, fleet):
    for name, log in zip("abcdef", logs):
        alone = SimulationDiagnosis(heater(), random_state=0).fit(*log)
        own = fleet.table[fleet.table["log"] == name]
        assert set(own["verdict"]) == {alone.verdict_}
        assert own["cause"].dropna().tolist() == [cause.name for cause in alone.causes_]
        assert own["value"].dropna().tolist() == [cause.value for cause in alone.causes_]
    assert fleet.table.loc[fleet.table["held"], "log"].tolist() == ["a", "d"]
    assert fleet.findings[0]["causes"][0]["name"] == "rate"


def test_what_is_in_the_store_is_not_asked_again_and_the_table_is_the_same(
    logs, fleet, tmp_path, monkeypatch
):
    diagnose_many(logs[:4], heater(), names=list("abcd"), store=tmp_path)
    kept = sorted(tmp_path.iterdir())
    assert len(kept) == 4
    told = []
    again = diagnose_many(
        logs, heater(), names=list("abcdef"), store=tmp_path, progress=lambda *one: told.append(one)
    )
    assert told == [("logs", 4, 6), ("logs", 5, 6), ("logs", 6, 6)]
    pd.testing.assert_frame_equal(again.table, fleet.table)
    # Other parameters are another question.
    diagnose_many(logs[:1], heater(), store=tmp_path, alpha=0.05)
    assert len(list(tmp_path.iterdir())) == 7


def kept_as(store, log, simulator, **parameters):
    """Return the name of the file in which a store has what a log says."""
    (file,) = _files(store, [log], simulator, parameters, {})
    return file.name


def test_another_model_by_the_same_path_is_another_question(logs, tmp_path):
    path = tmp_path / "model.xml"
    files = []
    for mass in (1, 2):
        path.write_text(
            f"<mujoco><worldbody><body><freejoint/><geom size='.1' mass='{mass}'/></body></worldbody></mujoco>"
        )
        files.append(kept_as(tmp_path, logs[0], MujocoSimulator(path)))
    assert files[0] != files[1]
    assert files[1] == kept_as(tmp_path, logs[0], MujocoSimulator(path))


def heater_of(function=decaying, top=30.0, typical=1.0):
    effects = [Effect("rate", unit="1/s", neutral=RATE, bounds=(0.1, top), typical=typical)]
    names = dict(input_names=("warmth", "given"), output_names=("warmth",), state_names=("warmth",))
    return FunctionSimulator(function, **names, effects=effects)


def test_whatever_an_answer_depends_on_is_another_question(logs, tmp_path):
    X, y, groups = logs[0]

    def frame(*columns):
        return pd.DataFrame(X, columns=list(columns)), y, None

    def faster(X, rate=RATE):
        return decaying(X, 1.1 * rate)

    def same_when_neutral(X, rate=RATE):
        return decaying(X, RATE + 1.1 * (rate - RATE))

    def log(actions):
        return Log(X, y, groups, ("0", "1", "2"), X[:, 0], heater_of(), actions=actions)

    questions = [
        (logs[0], heater_of()),
        *((logs[0], heater_of(function)) for function in (faster, same_when_neutral)),
        *((logs[0], heater_of(**change)) for change in ({"top": 31.0}, {"typical": 0.5})),
        *((frame(*names), heater_of()) for names in (("warmth", "given"), ("given", "warmth"))),
        *((log(actions), heater_of()) for actions in ("commanded", "measured")),
    ]
    assert len({kept_as(tmp_path, *one) for one in questions}) == len(questions)
    assert kept_as(tmp_path, *questions[0]) == kept_as(tmp_path, logs[0], heater_of())


def test_an_edit_of_a_model_that_is_code_is_known_by_what_it_does(tmp_path):
    model = (
        "<mujoco><worldbody><body><joint name='a' type='slide' axis='1 0 0'/><geom size='.1' mass='1'/></body>"
        "</worldbody></mujoco>"
    )
    X = np.random.default_rng(0).normal(size=(30, 2))

    def worn(share):
        def apply(spec, value):
            spec.joints[0].frictionloss = share * value

        wear = Effect("wear", unit="N", neutral=0.0, bounds=(0.0, 1.0), apply=apply)
        return MujocoSimulator(model, extra_effects=[wear])

    files = [kept_as(tmp_path, (X[:-1], X[1:]), worn(share)) for share in (1.0, 0.5, 1.0)]
    assert files[0] == files[2] != files[1]


def test_episodes_may_have_any_labels(logs, tmp_path):
    X, y, groups = logs[0]
    names = pd.Series(np.array(["x", "y", "z"])[groups])
    for store in (None, tmp_path):
        found = diagnose_many([[X, y, names], None], heater(), effects=["rate"], store=store)
        assert found.table["verdict"].tolist()[0] == "named"
        assert found.table["error"].tolist()[1].startswith("TypeError: expected a path, a log")
    assert len(list(tmp_path.iterdir())) == 1


def test_a_process_that_is_killed_costs_nothing_but_time(logs, fleet, tmp_path):
    mark = tmp_path / "mark"

    def deadly(X, rate=RATE, push=1.0):
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return decaying(X, rate, push)

    with pytest.warns(UserWarning, match="A process was killed"):
        found = diagnose_many(logs[:3], heater(deadly), names=list("abc"), n_jobs=2)
    assert mark.exists()
    pd.testing.assert_frame_equal(found.table, fleet.table[fleet.table["log"] <= "c"].reset_index(drop=True))


def test_a_change_over_time_is_told(logs):
    rates = [RATE, RATE, RATE, 1.4 * RATE, 1.4 * RATE]
    mine = [log_of(20 + at, rate) for at, rate in enumerate(rates)]
    times = list(pd.date_range("2026-01-01", periods=5, freq="MS"))
    # Not in the order of time, and beside another robot in which nothing changes.
    order = [3, 0, 4, 1, 2]
    found = diagnose_many(
        [*(mine[at] for at in order), log_of(40), log_of(41)],
        heater(),
        robots=["17"] * 5 + ["18"] * 2,
        times=[*(times[at] for at in order), *times[:2]],
    )
    (row,) = found.drifts.to_dict("records")
    assert (row["robot"], row["effect"], row["since"]) == ("17", "rate", times[3])
    assert row["low"] < 0.4 * RATE < row["high"]
    (sentence,) = found.sentences
    assert sentence.startswith("17: rate went from 3")
    assert "(+4" in sentence or "(+3" in sentence


def findings_of(name, gram, values, verdict="named"):
    """Return findings of a log that names one cause, and shows of each effect what is there, without noise."""
    cause = {
        "name": name,
        "value": 1.0,
        "interval": [0.9, 1.1],
        "unit": "1/s",
        "probability": 1.0,
        "aliases": [],
    }
    return {
        "verdict": verdict,
        "gain": None,
        "causes": [cause | {"evidence": 100.0}],
        "gram": {
            "names": ["rate", "push"],
            "products": gram,
            "projections": gram @ values,
            "origin": np.zeros(2),
        },
    }


def test_what_one_log_names_and_the_next_does_not_is_no_change():
    gram = 1e4 * np.array([[1.0, 0.8], [0.8, 1.0]])
    found = [findings_of(name, gram, np.array([0.3, 0.2])) for name in ("rate", "push", "push")]
    table = _table("abc", "rrr", None, found, 0.05)
    assert table["held"].all()
    assert _drifts(heater(), table, "abc", "rrr", None, found, 0.05).empty
    moved = [*found, findings_of("push", gram, np.array([0.3, 0.4]))]
    table = _table("abcd", "rrrr", None, moved, 0.05)
    (row,) = _drifts(heater(), table, "abcd", "rrrr", None, moved, 0.05).to_dict("records")
    # Without times it is told by its name.
    assert (row["effect"], row["since"]) == ("push", "d")


def test_no_cause_of_an_unexplained_log_holds_or_makes_a_change():
    values, gram = np.array([[0.3, 0.2], [0.3, 0.2], [0.3, 0.6]]), 1e4 * np.eye(2)
    found = [
        findings_of("push", gram, one, verdict)
        for one, verdict in zip(values, ("named", "named", "unexplained"))
    ]
    table = _table("abc", "rrr", None, found, 0.05)
    assert table["held"].tolist() == [True, True, False]
    assert _drifts(heater(), table, "abc", "rrr", None, found, 0.05).empty


@pytest.mark.parametrize(
    ("neutral", "unit", "before", "share"),
    [
        (0.0, "N m", 3.89e-5, ""),
        (0.0, "1", 0.2, ""),
        (1.0, "1", 0.2, " (+100 %)"),
        (3.0, "1/s", 0.2, " (+100 %)"),
    ],
)
def test_a_change_has_a_share_where_the_model_has_something_to_share(neutral, unit, before, share):
    drift = {"robot": "a", "effect": "friction", "before": before, "after": 0.4, "unit": unit, "since": "May"}
    of = "" if unit == "1" else f" {unit}"
    (told,) = Fleet(pd.DataFrame(), pd.DataFrame([drift | {"neutral": neutral}]), ()).sentences
    assert told == f"a: friction went from {before:.3g} to 0.4{of}{share}, first seen at May."


def test_only_findings_are_cleared_from_a_store(logs, tmp_path):
    diagnose_many(logs[:2], heater(), store=tmp_path / "store")
    (tmp_path / "store" / f".{'0' * 32}-17.json").write_text("a draft of a process that was killed")
    (tmp_path / "store" / "mine.json").write_text("mine")
    clear_store(tmp_path / "store")
    assert [file.name for file in (tmp_path / "store").iterdir()] == ["mine.json"]
    (tmp_path / "store" / "mine.json").unlink()
    clear_store(tmp_path / "store")
    assert not (tmp_path / "store").exists()


def test_a_log_that_cannot_be_diagnosed_has_its_error_in_the_table(logs, tmp_path):
    X, y, groups = logs[1]
    found = diagnose_many([(X, y[:-1], groups), logs[1]], heater(), names=["bad", "good"], store=tmp_path)
    bad, good = found.table.to_dict("records")
    assert bad["error"].startswith("ValueError")
    assert good["verdict"] == "nothing detected"
    # Whoever mends it asks again.
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"names": ["a"]}, "names must be one for each log: 2; got 1"),
        ({"names": ["a", "a"]}, "two logs have the name 'a'"),
        ({"robots": ["1"]}, "robots must be one for each log"),
        ({"times": [1, 2, 3]}, "times must be one for each log"),
        ({"false_discoveries": 0.0}, "a share between 0 and 1"),
        ({"alfa": 0.1}, "alfa"),
        ({"times": [1, None]}, "log 1 has no time"),
        ({"times": pd.to_datetime(["2026-01-01", None])}, "log 1 has no time"),
        ({"times": [1, "May"]}, "times must have an order"),
        ({"alpha": 2}, "alpha must lie between 0 and 1"),
        ({"effects": ["nope"]}, "unknown effect 'nope'"),
        ({"store": __file__}, "is a file; findings are kept in a folder"),
    ],
)
def test_wrong_arguments_are_told(logs, given, message):
    with pytest.raises((ValueError, TypeError, FileExistsError), match=message):
        diagnose_many(logs[:2], heater(), **given)


def test_a_mapping_gives_logs_their_names(logs, fleet):
    named = dict(zip("ab", logs))
    pd.testing.assert_frame_equal(diagnose_many(named, heater()).table, fleet.table[:2])
    with pytest.raises(TypeError, match="names are those of the mapping"):
        diagnose_many(named, heater(), names=["a", "b"])


def test_one_path_is_no_sequence_of_logs():
    with pytest.raises(TypeError, match=r"logs is one path, 'logs/\*.csv'"):
        diagnose_many("logs/*.csv", heater())


@pytest.mark.parametrize("text", ["", "{", "[]", "{}"])
def test_findings_that_are_not_whole_are_asked_again(logs, fleet, tmp_path, text):
    diagnose_many(logs[:1], heater(), names=["a"], store=tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_text(text)
    again = diagnose_many(logs[:1], heater(), names=["a"], store=tmp_path)
    pd.testing.assert_frame_equal(again.table, fleet.table[:1])


def test_no_log_is_told():
    with pytest.raises(ValueError, match="there is no log"):
        diagnose_many([], heater())
