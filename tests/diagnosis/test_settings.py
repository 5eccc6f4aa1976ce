"""What a diagnosis takes for settings, its verdict, the rounding of sensors, and how a saved simulator is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.estimator import _rounding
from skat.diagnosis.findings import Gain
from skat.diagnosis.log import check_log
from skat.diagnosis.reading import _checked_floor
from skat.diagnosis.saving import SavedSimulator, _with_plain_labels, _without_rows
from skat.diagnosis.statespace import state_space
from skat.effects import Effect
from skat.simulators import FunctionSimulator

NAMES = ("x", "v")


def rolling(drag_bound=2.0, more=(), scale=1.0, diverging=False):
    def step(X, drag=0.0, **_):
        out = np.c_[X[:, 0] + 0.1 * X[:, 1], scale * X[:, 1] + 0.1 * (X[:, 2] - drag * X[:, 1])]
        out[X[:, 2] > 1e3] = np.nan if diverging else out[X[:, 2] > 1e3]
        return out

    effects = [Effect("drag", unit="1/s", neutral=0.0, bounds=(0.0, drag_bound))]
    effects += [Effect(name, unit="1", neutral=0.0, bounds=(-1.0, 1.0)) for name in more]
    return FunctionSimulator(
        step, input_names=(*NAMES, "u"), output_names=NAMES, state_names=NAMES, effects=effects, dt=0.1
    )


def log_of(simulator, n=40, step=None):
    commands = np.random.default_rng(0).normal(size=(1, n, 1))
    states = simulator.rollout(np.zeros((1, 2)), commands, n_steps=n)[0]
    states = states if step is None else np.round(states / step) * step
    return np.c_[states[:-1], commands[0]], states[1:], np.zeros(n)


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("alpha", [1e-9, 0.5, 1 - 1e-9], [0.0, 1.0, -0.1, 1.1]),
        ("test_size", [0.0, 0.5, 0.999], [1.0, -0.1]),
        ("max_effects", [None, 1, np.int64(3)], [0, -1, 1.5]),
        ("tolerance", [1e-9, 5.0], [0.0, -1.0]),
        ("n_jobs", [None, 1, -1, np.int64(2)], [0, 1.5]),
        ("velocities", ["measured", "computed", "auto"], ["guessed"]),
        ("horizon", [None, 0.1], [0.0, -1.0, np.inf, np.nan]),
        ("hidden", [(), ["v"]], ["v"]),
        (
            "priors",
            [None, {}, {"drag": 1e-30}],
            [*({"drag": size} for size in (0.0, np.inf, -1.0, 1e-200, 1e200))],
        ),
    ],
)
def test_a_setting_is_checked_on_both_sides_of_its_bounds(name, good, bad):
    for value in good:
        SimulationDiagnosis(rolling(), **{name: value})._check_parameters()
    for value in bad:
        with pytest.raises(ValueError, match="drag" if name == "priors" else name):
            SimulationDiagnosis(rolling(), **{name: value})._check_parameters()


def test_noise_and_floor_are_one_number_for_each_channel():
    given = SimulationDiagnosis(rolling(), noise=[0.1, 0.2])
    np.testing.assert_array_equal(given._given_deviations(), [0.1, 0.2])
    assert SimulationDiagnosis(rolling())._given_deviations() is None
    for noise in ([0.1], [0.1, 0.0], [0.1, np.inf], [0.1, np.nan], "known", [0.1, "a"]):
        with pytest.raises(ValueError, match="noise must"):
            SimulationDiagnosis(rolling(), noise=noise)._given_deviations()
    np.testing.assert_array_equal(_checked_floor(rolling(), None), [0.0, 0.0])
    np.testing.assert_array_equal(_checked_floor(rolling(), [0.0, 0.3]), [0.0, 0.3])
    for floor in ([0.1], [0.1, -1e-9], [0.1, np.inf], "none"):
        with pytest.raises(ValueError, match="floor must hold"):
            _checked_floor(rolling(), floor)


def test_effects_are_chosen_by_name_once_in_their_order():
    simulator = rolling(more=("b", "c"))
    drag = simulator.effects()[0]
    chosen = SimulationDiagnosis(simulator, effects=["c", drag, "c"])._chosen_effects()
    assert [one.name for one in chosen] == ["c", "drag"]
    assert [one.name for one in SimulationDiagnosis(simulator, effects="b")._chosen_effects()] == ["b"]
    assert SimulationDiagnosis(simulator)._chosen_effects() == list(simulator.effects())
    with pytest.raises(ValueError, match="effects is empty"):
        SimulationDiagnosis(simulator, effects=[])._chosen_effects()
    with pytest.raises(ValueError, match="dragg"):
        SimulationDiagnosis(simulator, effects=["dragg"])._chosen_effects()


def test_an_effect_that_is_given_says_how_likely_and_how_large_it_is():
    simulator = rolling(more=("b",))
    drag = replace(simulator.effects()[0], odds=7.0, typical=0.4, bounds=(0.0, 1.0))
    (chosen,) = SimulationDiagnosis(simulator, effects=[drag])._chosen_effects()
    assert (chosen.odds, chosen.typical, chosen.bounds) == (7.0, 0.4, (0.0, 1.0))
    for other in (
        replace(drag, unit="N"),
        replace(drag, neutral=0.1),
        replace(drag, bounds=(-0.1, 1.0)),
        replace(drag, bounds=(0.0, 2.1)),
    ):
        with pytest.raises(
            ValueError, match=r"drag must be in 1/s, neutral at 0, with bounds within \(0.0, 2.0\)"
        ):
            SimulationDiagnosis(simulator, effects=other)._chosen_effects()


def verdict(causes=(), *, evidence=-1.0, settled=True, diverged=0.0, gain=None):
    part = SimpleNamespace(evidence=evidence, ahead=1.0, predictable=1.0, scale=1.0)
    told = SimpleNamespace(
        _prediction=gain and SimpleNamespace(gain=gain),
        settled_=settled,
        remainder_=SimpleNamespace(parts=(part,)),
        tolerance=0.1,
        alpha=0.01,
        causes_=[SimpleNamespace(aliases=aliases) for aliases in causes],
        diverged_share_=diverged,
        _apart=list,
    )
    return SimulationDiagnosis._verdict(told)


def test_a_verdict_is_as_sure_as_its_weakest_part():
    assert verdict() == "nothing detected"
    assert verdict(diverged=1.0) == "unexplained"
    assert verdict([()]) == "named"
    assert verdict([(), ("b",)]) == "ambiguous"
    assert verdict([()], settled=False) == "unexplained"
    assert verdict([()], evidence=10.0) == "unexplained"
    assert verdict([()], evidence=10.0, gain=Gain(100.0, 2.0, 1.0, 1.0, (1.0, 1.0), 1.0)) == "named"


@pytest.mark.parametrize("step", [0.01, 0.5])
def test_rounding_has_the_variance_of_a_uniform_law_of_its_step(step):
    simulator = rolling()
    space = state_space(simulator, *log_of(simulator, 200, step)[:2], np.zeros(200, int), consecutive=True)
    uniform = step * (np.random.default_rng(0).random(100_000) - 0.5)
    np.testing.assert_allclose(_rounding(space), uniform.var(), rtol=0.02)
    fine = state_space(simulator, *log_of(simulator)[:2], np.zeros(40, int), consecutive=True)
    assert _rounding(fine).tolist() == [0.0, 0.0]
    fine.measured[..., 0] = np.arange(41) % 2
    # Two values tell no step.
    assert _rounding(fine)[0] == 0.0
    fine.measured[..., 0] = np.arange(41) % 3
    assert _rounding(fine)[0] == pytest.approx(1 / 12)


def test_a_simulator_is_known_by_what_it_predicts_and_by_its_effects():
    simulator = rolling(diverging=True)
    X, y, groups = log_of(simulator)
    X[3, 2] = 2e3
    log = check_log(simulator, X, y, groups)
    saved = SavedSimulator.of(simulator, log)
    assert len(saved.rows) == len(saved.outputs) == len(saved.groups) <= len(log)
    assert saved.difference(rolling(diverging=True)) == ""
    assert saved.difference(rolling(diverging=True, scale=1 + 1e-9)) == ""
    assert "for v, and predicted" in saved.difference(rolling(diverging=True, scale=1.01))
    assert "in row 3 of the log" in saved.difference(rolling())
    assert "drag is in 1/s" in saved.difference(rolling(drag_bound=3.0, diverging=True))
    assert saved.difference(rolling(more=("b",), diverging=True)) == ""
    richer = SavedSimulator.of(rolling(more=tuple("bcdefg")), log)
    assert richer.difference(rolling()) == "it has no b, c, d, e, f ..."
    assert (
        SavedSimulator.of(rolling(more=tuple("bcdef")), log).difference(rolling())
        == "it has no b, c, d, e, f"
    )


def test_of_a_record_without_rows_only_what_has_no_rows_is_left():
    log = check_log(rolling(), *log_of(rolling()))
    less = _without_rows(log)
    assert (less.X.shape, less.y.shape) == ((0, 3), (0, 2))
    np.testing.assert_array_equal(less.episodes, log.episodes)
    odd = replace(log, labels=((1, 2),))
    assert _with_plain_labels(odd).labels == ("(1, 2)",)
    assert _with_plain_labels(replace(log, labels=("a", 2, 0.5))).labels == ("a", 2, 0.5)
    plain = replace(log, labels=None)
    assert _with_plain_labels(plain) is plain
