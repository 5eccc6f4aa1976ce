import json
import threading

import numpy as np
import pytest

CAUSE = {
    "name": "mass[a]",
    "value": 1.2,
    "interval": [1.1, 1.3],
    "probability": 0.9,
    "aliases": [["gain[b]", 0.1]],
}


def _line(truth, *causes, verdict="named"):
    return {"truth": truth, "causes": list(causes), "verdict": verdict}


def test_a_line_is_judged_by_name_alias_and_interval():
    import tables

    right = _line({"mass[a]": 1.25}, CAUSE)
    assert tables.alone(right)
    assert tables.or_alias(right)
    assert tables.in_interval(right) == [True]
    alias = _line({"gain[b]": 0.8}, CAUSE)
    assert not tables.alone(alias)
    assert tables.or_alias(alias)
    assert tables.in_interval(alias) == []
    beside = _line({"mass[a]": 1.4}, CAUSE, {**CAUSE, "name": "tilt[x]", "aliases": []})
    assert not tables.or_alias(beside)
    assert tables.in_interval(beside) == [False]
    assert tables.calibration([right, beside]) == [(0.9, True), (0.9, True), (0.9, False)]
    assert tables.calibration([{**beside, "parts": ["tilt"]}]) == [(0.9, True), (0.9, True)]


def test_wilson_is_the_interval_of_the_score_test():
    import tables

    for hits, count in ((0, 10), (7, 10), (460, 480), (5, 5)):
        for bound in tables.wilson(hits, count):
            if 0 < bound < 1:
                # At the bound the test of that share just does not reject.
                score = (hits / count - bound) / np.sqrt(bound * (1 - bound) / count)
                assert abs(score) == pytest.approx(1.96, rel=1e-9)


def _table(asked):
    from tables import Case, Table

    def run(case, parameters):
        asked.append(case.key)
        return _line({}, verdict="nothing detected")

    return Table(
        "t", lambda cut: [Case("a", seed) for seed in range(2 if cut else 6)], run, lambda lines, shown: None
    )


def test_a_table_resumes_and_shares_its_cases(tmp_path, capsys):
    import tables

    asked, output = [], ["--output", str(tmp_path / "t.jsonl")]
    tables.main(_table(asked), "", [*output, "--limit", "1"])
    tables.main(_table(asked), "", [*output, "--cut"])
    assert asked == ["a #0", "a #1"]
    threads = [
        threading.Thread(target=tables.main, args=(_table(asked), "", [*output, "--shard", f"{i}/2"]))
        for i in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(asked) == [f"a #{seed}" for seed in range(6)]
    tables.main(_table(asked), "", output)
    assert len(asked) == 6
    lines = [json.loads(line) for line in (tmp_path / "t.jsonl").read_text().splitlines()]
    assert {line["source"] for line in lines} == {tables.source_hash()}
    assert "6 of 6 cases" in capsys.readouterr().out


def test_a_case_that_another_process_asks_is_left_to_it(tmp_path):
    fcntl = pytest.importorskip("fcntl")
    import tables

    asked, output = [], tmp_path / "t.jsonl"
    with tables._claimed(output, f"{tables.source_hash()} {{}} a #0") as mine:
        assert mine
        tables.main(_table(asked), "", ["--output", str(output), "--cut"])
    assert asked == ["a #1"]
    assert fcntl


def test_a_report_counts_lines_of_one_hash_and_one_set_of_parameters(tmp_path):
    import tables

    path = tmp_path / "t.jsonl"
    for source, parameters in (("old", {}), ("new", {}), ("new", {"quick": True})):
        tables._append(path, {"source": source, "parameters": parameters, "key": "a #0"})
    assert len(tables.lines_of(path)) == 3
    assert len(tables.lines_of(path, "new", {})) == 1


@pytest.mark.parametrize(
    "name", ["sensors", "process_noise", "many_at_once", "servo_arm", "cost", "measured", "other_robots"]
)
def test_cases_of_a_table_are_unique_and_its_cut_is_small(name):
    module = __import__(name)
    keys = [case.key for case in module.TABLE.cases(False)]
    assert len(set(keys)) == len(keys)
    assert len(module.TABLE.cases(True)) < max(40, len(keys) / 4)


def test_every_cause_of_the_sensors_table_can_be_hidden_and_changes_the_data():
    import sensors
    from worlds.robots import make_log, predict

    for robot, causes in sensors.CAUSES.items():
        for name in causes:
            log = make_log(robot, {name: sensors.draw(robot, name, 0)}, sensor="exact", rows=40, episodes=1)
            change = np.abs(log.exact_next - predict(log, {})).max(axis=0)
            assert np.any(change > 0.1 * np.resize(log.sigma, change.shape)), name


def test_every_constant_of_the_engine_is_tried():
    import ablation

    found = ablation.constants()
    assert found["search", "ALIAS_FACTOR"] == 20.0
    assert ("causes", "SENSORS") not in found  # names are no numbers
    assert ("causes", "REFITTED") in found  # of two in one line
    tried = ablation.changes(
        {("a", "SHARE"): 0.1, ("a", "ROWS"): 21, ("a", "NU"): (3.0, 5.0), ("b", "MOST"): np.inf}
    )
    assert tried["a.SHARE halved"] == ("a", "SHARE", 0.05)
    assert tried["a.ROWS halved"] == ("a", "ROWS", 10)
    assert tried["a.ROWS off"] == ("a", "ROWS", 0)
    assert tried["a.NU without its first"] == ("a", "NU", (5.0,))
    assert tried["b.MOST finite"] == ("b", "MOST", 1.0)
    assert {label.split()[0] for label in ablation.changes(found)} == {".".join(name) for name in found}


def test_the_prior_of_a_draw_is_a_cauchy_within_bounds():
    import probabilities

    from skat.effects import Effect

    effect = Effect("damping[a]", unit="N m s/rad", neutral=0.0, bounds=(0.0, 10.0))
    object.__setattr__(effect, "typical", 0.5)
    object.__setattr__(effect, "odds", 0.1)
    rng = np.random.default_rng(0)
    values = np.array([probabilities.value_of(effect, rng) for _ in range(4000)])
    assert values.min() > 0
    assert values.max() < 10
    # Half of a Cauchy's magnitude lies below its scale; what lies beyond 10 is drawn again.
    inside = 2 / np.pi * np.arctan(10 / 0.5)
    assert np.mean(values < 0.5) == pytest.approx(0.5 / inside, abs=0.03)
    share = np.mean([bool(probabilities.draw([effect], rng)) for _ in range(4000)])
    assert share == pytest.approx(0.1 / 1.1, abs=0.015)


def test_a_constant_is_replaced_wherever_a_module_takes_it_and_put_back():
    import ablation

    from skat.diagnosis import log, statespace

    assert log.QUATERNION is statespace.QUATERNION
    with ablation.replaced("statespace", "QUATERNION", ("w",)):
        assert statespace.QUATERNION == log.QUATERNION == ("w",)
    assert statespace.QUATERNION == log.QUATERNION != ("w",)
