"""What a comparison with learned maps is made of, by hand: standardised rows, pieces, ratios, starts, sentences."""

import numpy as np
import pytest

from skat.diagnosis.comparison import _open_loop
from skat.diagnosis.log import check_log, without_channels
from skat.simulators import FunctionSimulator


@pytest.mark.parametrize("hidden", [[], ["v"]])
def test_open_loop_begins_where_least_squares_over_the_episode_do(hidden):
    """Of linear dynamics, with readings of the first state as one row more, and a weak hold where there is none."""
    A, rng, names, n = np.array([[0.95, 0.3], [-0.2, 0.9]]), np.random.default_rng(0), ("x", "v"), 25
    simulator = FunctionSimulator(
        lambda X: X[:, :2] @ A.T + np.c_[0 * X[:, 2], X[:, 2]],
        input_names=(*names, "u"),
        output_names=names,
        state_names=names,
        dt=0.1,
    )
    u = rng.normal(size=(2, n, 1))
    states = simulator.rollout(rng.normal(size=(2, 2)), u, n_steps=n) + 0.1 * rng.normal(size=(2, n + 1, 2))
    X = np.concatenate([states[:, :-1], u], axis=2).reshape(2 * n, 3)
    log = check_log(simulator, X, states[:, 1:].reshape(2 * n, 2), np.repeat([0, 1], n))
    log = without_channels(simulator, log, hidden)
    left = _open_loop(simulator, log).reshape(2, n, 2)
    filled = log.filled
    spread = filled.y.std(axis=0) if not hidden else np.array([filled.y[:, 0].std(), 1.0])
    seen = [0] if hidden else [0, 1]
    weights = np.array([1.0, 1e-6 if hidden else 1.0])
    forced = simulator.rollout(np.zeros((2, 2)), u, n_steps=n)[:, 1:]
    powers = np.array([np.linalg.matrix_power(A, step) for step in range(1, n + 1)])
    for episode in range(2):
        guess = filled.X[episode * n, :2]
        target = states[episode, 1:] - forced[episode]
        rows = [(powers / spread[:, None])[:, seen].reshape(-1, 2), np.diag(np.sqrt(weights) / spread)]
        right = [(target / spread)[:, seen].ravel(), np.sqrt(weights) * guess / spread]
        start = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
        expected = target - powers @ start
        np.testing.assert_allclose(left[episode][:, seen], expected[:, seen], atol=1e-4)
