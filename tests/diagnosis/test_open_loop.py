"""Episodes in open loop, where velocities were not measured: initial states, and what is left."""

import numpy as np
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.log import check_log
from skat.diagnosis.omnibus import TIME
from skat.diagnosis.open_loop import Episodes
from skat.diagnosis.trajectories import TrajectoryResiduals
from tests.diagnosis.cart_pole import make_simulator, measure

HIDDEN = ("v", "w")


def without_velocities(seed, **options):
    """Return X, y, groups of a measured cart with a pole, zeros for its velocities, and the noise of its places."""
    X, y, groups, deviations = measure(seed, **options)
    X[:, 2:4] = y[:, 2:4] = 0.0
    return X, y, groups, deviations[:2]


def test_initial_states_are_found_where_an_episode_is_long_and_no_velocity_known():
    """A pole that turns over and over is chaotic: fitted to all rows at once, half of the episodes end far off."""
    X, y, groups, deviations = without_velocities(0, n_steps=120)
    simulator = make_simulator()
    episodes = Episodes(simulator, check_log(simulator, X, y, groups, hidden=HIDDEN), HIDDEN)
    initial = episodes.fit_initial_states({}, deviations)
    errors = episodes.residuals([{}], initial)[0] / deviations
    sizes = [np.sqrt(np.mean(errors[groups == group] ** 2)) for group in np.unique(groups)]
    assert 0.7 < min(sizes) <= max(sizes) < 1.5


def test_rows_that_are_not_simulated_say_nothing_of_initial_states():
    X, y, groups, _ = without_velocities(0, n_episodes=3, n_steps=10)
    simulator = make_simulator()
    episodes = Episodes(simulator, check_log(simulator, X, y, groups, hidden=HIDDEN), HIDDEN)
    whole = episodes.sensitivities({}, episodes.initial)
    part = episodes.sensitivities({}, episodes.initial, horizon=4, episodes=np.array([0, 2]))
    simulated = (groups != 1) & (np.arange(30) % 10 < 4)
    for some, everything in zip(part, whole):
        np.testing.assert_allclose(some[simulated], everything[simulated], rtol=1e-9, atol=1e-12)
        assert not some[~simulated].any()


def test_what_is_taken_by_initial_states_makes_up_the_projection():
    X, y, groups, deviations = without_velocities(0, n_episodes=4, n_steps=20)
    simulator = make_simulator()
    log = check_log(simulator, X, y, groups, hidden=HIDDEN)
    residuals = TrajectoryResiduals(simulator, log, simulator.effects(), deviations, hidden=HIDDEN)
    residuals.settle({})
    residuals.correlation = np.array([0.3, 0.6])
    columns = np.random.default_rng(0).normal(size=(len(log), 2))
    scaled = residuals._decorrelated((columns / deviations)[..., None])[..., 0]
    expected = scaled.copy()
    for episode, taken in zip(np.split(expected, 4), np.split(residuals.taken(), 4)):
        basis = taken.reshape(40, -1)
        np.testing.assert_allclose(basis.T @ basis, np.eye(4), atol=1e-9)
        episode -= (basis @ (basis.T @ episode.ravel())).reshape(episode.shape)
    np.testing.assert_allclose(residuals.whiten(columns), expected, atol=1e-9)


@pytest.mark.parametrize("magnet", [0.0, 4.0])
def test_force_that_no_effect_is_like_is_unexplained_where_velocities_were_not_measured(magnet):
    X, y, groups, _ = without_velocities(5, magnet=magnet, n_episodes=30)
    diagnosis = SimulationDiagnosis(
        make_simulator(), hidden=HIDDEN, effects=["pole", "drag", "gain"], random_state=0
    ).fit(X, y, groups=groups)
    if magnet:
        assert diagnosis.verdict_ == "unexplained"
        assert diagnosis.remainder_.coordinate == TIME
        assert "for longer than single rows" in diagnosis.report_.text()
    else:
        assert diagnosis.verdict_ == "nothing detected"
        assert diagnosis.remainder_.p_value > 0.01
        assert diagnosis.excess_p_value_ > 0.01


def test_errors_of_episodes_held_out_are_compared_with_noise_that_was_given():
    X, y, groups, deviations = without_velocities(3, n_episodes=16)
    diagnosis = SimulationDiagnosis(
        make_simulator(), hidden=HIDDEN, effects=["pole"], noise=deviations / 2, random_state=0
    )
    diagnosis.fit(X, y, groups=groups)
    assert diagnosis.excess_p_value_ < 0.0025
    assert diagnosis.verdict_ == "unexplained"
    assert diagnosis.set_params(noise=deviations).fit(X, y, groups=groups).excess_p_value_ > 0.05
