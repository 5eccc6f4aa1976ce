"""Which causes are kept and exchanged, and how exactly and how surely their values are known."""

import numpy as np
import pytest
from sklearn.utils import check_random_state

from skat.diagnosis.log import check_log
from skat.diagnosis.residuals import Residuals, TransitionResiduals
from skat.diagnosis.selection import Selection
from skat.effects import Effect
from skat.simulators import FunctionSimulator
from tests.diagnosis.cart_pole import make_simulator, measure


@pytest.fixture
def simulator():
    return make_simulator()


def selection_of(simulator, hidden, seed=3):
    X, y, groups, _ = measure(seed, **hidden)
    log, _ = check_log(simulator, X, y, groups).split(0.3, check_random_state(0))
    effects = simulator.effects()
    selection = Selection(
        TransitionResiduals(simulator, log, effects),
        [effect.name for effect in effects],
        alpha=0.005,
        max_effects=6,
        progress=lambda *_: None,
    )
    selection._linearised({})
    return selection


@pytest.mark.parametrize(
    ("hidden", "named"),
    [
        ({"gain": 0.9, "drag": 0.3}, {"dry_friction": 0.1, "drag": 0.1}),
        ({"drag": 0.3}, {"gain": 0.8, "hinge": 0.005}),
        ({"drag": 0.3}, {"gain": 0.8}),
    ],
)
def test_wrong_causes_are_exchanged_for_the_right_ones(simulator, hidden, named):
    selection = selection_of(simulator, hidden)
    values, line = selection._polished(named)
    while exchanged := selection._exchanged(values, line):
        values, line = selection._polished(exchanged)
    assert set(values) == set(hidden)
    for name, value in hidden.items():
        assert abs(values[name] - value) < 0.05


def test_right_pair_is_kept(simulator):
    hidden = {"gain": 0.9, "drag": 0.3}
    selection = selection_of(simulator, hidden)
    values, line = selection._polished(hidden)
    assert selection._exchanged(values, line) is None


def test_values_of_a_smooth_simulation_have_no_spread_from_settling(simulator):
    selection = selection_of(simulator, {"pole": 0.9})
    values, line = selection._polished({"pole": 0.9})
    averaged, _, spread = selection._averaged(values, line)
    assert averaged == values
    assert spread == {"pole": 0.0}


def test_profile_interval_agrees_with_the_standard_error_where_nothing_bends(simulator):
    selection = selection_of(simulator, {"pole": 0.9})
    values, line = selection._polished({"pole": 0.9})
    low, high = selection._profile_interval("pole", values, line)
    error = np.sqrt(selection._covariance(values)[1][0, 0])
    assert low < values["pole"] < high
    assert 1 * error < (high - low) / 2 < 8 * error


# -- a simulation of steps ---------------------------------------------------------------------------------------------


def tooth_wheel(X, *, rate=1.0):
    """Count the teeth of a wheel that pass: a step of one tooth where the rate is enough for one more."""
    return np.floor(20 * rate + X)


def selection_of_steps(seed, n_rows=600):
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
    residuals = Residuals(simulator, log, simulator.effects(), np.ones(1))
    selection = Selection(residuals, ["rate"], alpha=0.005, max_effects=1, progress=lambda *_: None)
    return selection, selection._linearised({"rate": 1.1})


def test_steps_of_a_simulation_neither_hold_an_estimate_up_nor_pass_for_precision():
    covered = []
    for seed in range(20):
        selection, line = selection_of_steps(seed)
        values, _, spread = selection._averaged({"rate": 1.112}, line)
        width = np.hypot(np.sqrt(selection._covariance(values)[1][0, 0]), spread["rate"])
        covered.append(abs(values["rate"] - 1.1) < 1.96 * width)
    # With the chance of 95 % each, fewer than 16 of 20 come in 0.3 % of runs.
    assert sum(covered) >= 16
