"""How exactly and how surely the values of named effects are known."""

from dataclasses import replace

import numpy as np
import pytest

from skat.diagnosis.estimates import Estimates
from skat.diagnosis.evidence import grams, lone_statistics
from skat.diagnosis.log import check_log
from skat.diagnosis.residuals import Residuals
from skat.diagnosis.transitions import TransitionResiduals
from skat.effects import Effect
from skat.simulators import FunctionSimulator
from tests.diagnosis.cart_pole import make_simulator, measure


@pytest.fixture
def estimates():
    simulator = make_simulator()
    X, y, groups, _ = measure(3, pole=0.9)
    effects = simulator.effects()
    residuals = TransitionResiduals(simulator, check_log(simulator, X, y, groups), effects)
    estimates = Estimates(residuals, [effect.name for effect in effects])
    estimates.linearised({})
    return estimates


def test_values_of_a_smooth_simulation_have_no_spread_from_settling(estimates):
    values, line = estimates.polished({"pole": 0.9})
    averaged, _, spread = estimates.averaged(values, line)
    assert averaged == values
    assert spread == {"pole": 0.0}


def stuck_once(estimates, monkeypatch, times, misled=0.93):
    """Let so many fits end, without settling, at a wrong value with the noise that it leaves."""
    fitted, calls = estimates.fitted, iter(range(100))

    def sometimes_stuck(values):
        if next(calls) >= times:
            return fitted(values)
        estimates.residuals.settle({"pole": misled})
        estimates.residuals.linearise({"pole": misled}, ["drag"])
        return {"pole": misled}, False

    monkeypatch.setattr(estimates, "fitted", sometimes_stuck)


def test_a_fit_that_does_not_settle_starts_again_from_the_noise_of_the_model_without_effects(
    estimates, monkeypatch
):
    right, line = estimates.polished({"pole": 0.9})
    stuck_once(estimates, monkeypatch, times=1)
    values, again = estimates.polished({"pole": 0.93})
    assert abs(values["pole"] - right["pole"]) < 1e-3
    np.testing.assert_allclose(
        estimates.refits.misfit(again.residuals), estimates.refits.misfit(line.residuals), rtol=1e-3
    )


def test_a_fit_that_never_settles_stays_where_it_was_with_its_noise(estimates, monkeypatch):
    stuck_once(estimates, monkeypatch, times=100)
    values, line = estimates.polished({"pole": 0.93})
    assert values == {"pole": 0.93}
    assert line.values == values


def test_profile_interval_agrees_with_the_standard_error_where_nothing_bends(estimates):
    values, line = estimates.polished({"pole": 0.9})
    low, high = estimates.profile_interval("pole", values, line)
    error = np.sqrt(estimates.covariance(values)[1][0, 0])
    assert low < values["pole"] < high
    assert 1 * error < (high - low) / 2 < 8 * error


# -- a simulation of steps ---------------------------------------------------------------------------------------------


def tooth_wheel(X, *, rate=1.0):
    """Count the teeth of a wheel that pass: a step of one tooth where the rate is enough for one more."""
    return np.floor(20 * rate + X)


def measured_wheel(seed, n_rows=600):
    """Return the Estimates of a wheel with a rate of 1.1, and the linearisation there."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 1, (n_rows, 1))
    teeth = (np.arange(1, 100) <= 20 * 1.1 + phase).sum(axis=1, keepdims=True)
    simulator = FunctionSimulator(
        tooth_wheel,
        input_names=("phase",),
        output_names=("teeth",),
        effects=[Effect("rate", unit="1", neutral=1.0, bounds=(0.5, 2.0))],
    )
    log = check_log(simulator, phase, teeth + rng.standard_t(5, size=(n_rows, 1)) * np.sqrt(3 / 5), None)
    estimates = Estimates(Residuals(simulator, log, simulator.effects(), np.ones(1)), ["rate"])
    return estimates, estimates.linearised({"rate": 1.1})


def test_steps_of_a_simulation_neither_hold_an_estimate_up_nor_pass_for_precision():
    covered = []
    for seed in range(12):
        estimates, line = measured_wheel(seed)
        values, _, spread = estimates.averaged({"rate": 1.112}, line)
        width = np.hypot(np.sqrt(estimates.covariance(values)[1][0, 0]), spread["rate"])
        covered.append(abs(values["rate"] - 1.1) < 1.96 * width)
    # With the chance of 95 % each, fewer than 9 of 12 come in 0.2 % of runs.
    assert sum(covered) >= 9


# -- a simulation with jumps -------------------------------------------------------------------------------------------


def gate(X, *, opening=1.0):
    """Let through what the opening allows, and much more or less in a row where it is beyond a threshold."""
    return 20 * opening + 15 * np.tanh((opening - X) / 1e-3)


def measured_gate(seed):
    """Return the Estimates of a gate with an opening of 0.95 and of noisy thresholds."""
    rng = np.random.default_rng(seed)
    threshold = rng.uniform(0.5, 2.0, (600, 1))
    simulator = FunctionSimulator(
        gate,
        input_names=("threshold",),
        output_names=("flow",),
        effects=[Effect("opening", unit="1", neutral=1.0, bounds=(0.5, 2.0))],
    )
    flow = 20 * 0.95 + 15 * np.sign(0.95 - threshold) + rng.standard_t(5, size=(600, 1))
    log = check_log(simulator, threshold + rng.normal(0, 0.05, (600, 1)), flow, None)
    return Estimates(Residuals(simulator, log, simulator.effects(), np.ones(1)), ["opening"])


def statistic(line):
    return lone_statistics(grams(line.residuals, line.derivatives, np.arange(600)))[0][0]


def test_effect_that_moves_jumps_is_screened_by_what_a_larger_change_does():
    derivatives, kept = [], []
    for seed in range(8):
        estimates = measured_gate(seed)
        kept.append(statistic(estimates.linearised({})))
        derivatives.append(statistic(estimates.residuals.linearise({}, ["opening"])))
    # The jumps of a few rows leave derivatives that tell in one of these logs, and secants that tell in five.
    assert np.sum(np.less(derivatives, -6)) <= 2
    assert np.sum(np.less(kept, -6)) >= 4
    assert np.all(np.abs(kept) >= 0.99 * np.abs(derivatives))


# -- at a bound, and far from the optimum ------------------------------------------------------------------------------


def two_pulls(X, a=0.0, b=0.0):
    """Return what two alike inputs give."""
    return (a * X[:, 0] + b * (0.9 * X[:, 0] + 0.436 * X[:, 1]))[:, None]


def pulls_estimates(highest):
    """Return the Estimates of a = 0, b = 3 where b may not exceed a bound, and the model fitted within it."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200, 2))
    y = two_pulls(X, b=3.0) + 0.1 * rng.normal(size=(200, 1))
    effects = [
        Effect("a", unit="1", neutral=0.0, bounds=(-5.0, 5.0)),
        Effect("b", unit="1", neutral=0.0, bounds=(-highest, highest)),
    ]
    simulator = FunctionSimulator(two_pulls, input_names="uv", output_names="p", effects=effects)
    estimates = Estimates(Residuals(simulator, check_log(simulator, X, y, None), effects, [0.1]), ["a", "b"])
    estimates.linearised({})
    return estimates, X, y


def test_an_effect_at_its_bound_leaves_the_others_where_they_fit_best():
    estimates, X, y = pulls_estimates(1.0)
    values, line = estimates.polished({"a": 0.1, "b": 0.9})
    averaged, line, _ = estimates.averaged(values, line)
    assert averaged["b"] == 1.0
    # By hand: least squares of a with b at 1.
    left = (y - two_pulls(X, b=1.0))[:, 0]
    assert abs(averaged["a"] - X[:, 0] @ left / (X[:, 0] @ X[:, 0])) < 0.03


def test_linearisation_belongs_to_the_averaged_values():
    estimates, _, _ = pulls_estimates(5.0)
    values, line = estimates.polished({"a": 0.1, "b": 2.9})
    error = np.sqrt(np.diag(estimates.covariance(values)[1]))[0]
    averaged, line, spread = estimates.averaged(values | {"a": values["a"] + 4 * error}, line)
    assert abs(averaged["a"] - values["a"]) < 0.2 * error
    assert line.values == averaged
    assert spread == {"a": 0.0, "b": 0.0}


def test_degrees_of_freedom_are_those_of_the_blocks_where_they_widen_the_error():
    rng = np.random.default_rng(0)
    widened = 0
    for _ in range(6):
        blocks = np.repeat(np.arange(15), 12)
        X = rng.normal(size=(180, 1)) + 2
        y = 0.5 * X + np.repeat(rng.normal(size=15), 12)[:, None] + 0.1 * rng.normal(size=(180, 1))
        effect = Effect("slope", unit="1", neutral=0.0, bounds=(-5.0, 5.0))
        simulator = FunctionSimulator(
            lambda X, slope=0.0: slope * X, input_names="u", output_names="p", effects=[effect]
        )
        residuals = Residuals(simulator, check_log(simulator, X, y, None), [effect], [1.0])
        residuals.blocks, residuals.log = blocks, replace(residuals.log, consecutive=True)
        estimates = Estimates(residuals, ["slope"])
        estimates.linearised({})
        values, _ = estimates.polished({"slope": 0.4})
        _, covariance, freedom = estimates.covariance(values)
        alone = 1 / np.sum(X**2)
        assert covariance[0, 0] > 3 * alone
        widened += freedom[0] < 15
    assert widened == 6
