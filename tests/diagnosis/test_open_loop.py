"""Episodes in open loop, where velocities were not measured: initial states, and what is left."""

import numpy as np
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.log import check_log
from skat.diagnosis.omnibus import TIME
from skat.diagnosis.open_loop import Episodes
from skat.diagnosis.trajectories import TrajectoryResiduals
from skat.simulators import MujocoSimulator
from tests.diagnosis.cart_pole import make_simulator, measure

HIDDEN = ("v", "w")


@pytest.fixture
def simulator():
    return make_simulator()


def without_velocities(seed, **options):
    """Return X, y, groups of a measured cart with a pole, zeros for its velocities, and the noise of its places."""
    X, y, groups, deviations = measure(seed, **options)
    X[:, 2:4] = y[:, 2:4] = 0.0
    return X, y, groups, deviations[:2]


def test_initial_states_are_found_where_an_episode_is_long_and_no_velocity_known(simulator):
    """A pole that turns over and over is chaotic: fitted to all rows at once, half of the episodes end far off."""
    X, y, groups, deviations = without_velocities(0, n_steps=120)
    episodes = Episodes(simulator, check_log(simulator, X, y, groups, hidden=HIDDEN), HIDDEN)
    initial = episodes.fit_initial_states({}, deviations)
    errors = episodes.residuals([{}], initial)[0] / deviations
    sizes = [np.sqrt(np.mean(errors[groups == group] ** 2)) for group in np.unique(groups)]
    assert 0.7 < min(sizes) <= max(sizes) < 1.5


def test_rows_that_are_not_simulated_say_nothing_of_initial_states(simulator):
    X, y, groups, _ = without_velocities(0, n_episodes=3, n_steps=10)
    episodes = Episodes(simulator, check_log(simulator, X, y, groups, hidden=HIDDEN), HIDDEN)
    whole = episodes.sensitivities({}, episodes.initial)
    part = episodes.sensitivities({}, episodes.initial, horizon=4, episodes=np.array([0, 2]))
    simulated = (groups != 1) & (np.arange(30) % 10 < 4)
    for some, everything in zip(part, whole):
        np.testing.assert_allclose(some[simulated], everything[simulated], rtol=1e-9, atol=1e-12)
        assert not some[~simulated].any()


def test_what_is_taken_by_initial_states_makes_up_the_projection(simulator):
    X, y, groups, deviations = without_velocities(0, n_episodes=4, n_steps=20)
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
def test_force_that_no_effect_is_like_is_unexplained_where_velocities_were_not_measured(simulator, magnet):
    X, y, groups, _ = without_velocities(5, magnet=magnet, n_episodes=30)
    diagnosis = SimulationDiagnosis(
        simulator, hidden=HIDDEN, effects=["pole", "drag", "gain"], random_state=0
    ).fit(X, y, groups=groups)
    if magnet:
        assert diagnosis.verdict_ == "unexplained"
        assert diagnosis.remainder_.coordinate == TIME
        assert "for longer than single rows" in diagnosis.report_.text()
    else:
        assert diagnosis.verdict_ == "nothing detected"
        assert diagnosis.remainder_.p_value > 0.01
        assert diagnosis.excess_p_value_ > 0.01


def test_errors_of_episodes_held_out_are_compared_with_noise_that_was_given(simulator):
    X, y, groups, deviations = without_velocities(3, n_episodes=16)
    diagnosis = SimulationDiagnosis(
        simulator, hidden=HIDDEN, effects=["pole"], noise=deviations / 2, random_state=0
    )
    diagnosis.fit(X, y, groups=groups)
    assert diagnosis.excess_p_value_ < 0.0025
    assert diagnosis.verdict_ == "unexplained"
    assert diagnosis.set_params(noise=deviations).fit(X, y, groups=groups).excess_p_value_ > 0.05


def test_hidden_channels_are_carried_not_filled_in(simulator):
    X, y, groups, _ = without_velocities(8, pole=1.1, n_episodes=6)
    diagnosis = SimulationDiagnosis(
        simulator, hidden=HIDDEN, effects=["pole", "drag", "gain"], random_state=0
    ).fit(X, y, groups=groups)
    assert diagnosis.causes_[0].name == "pole"
    low, high = diagnosis.causes_[0].interval
    assert abs(diagnosis.causes_[0].value - 1.1) < 0.75 * (high - low)
    assert diagnosis.noise_.shape == (2,)
    assert diagnosis.gain_.horizon == "episode"
    assert set(diagnosis.gain_.channels) == {"x", "angle"}
    assert "open-loop error" in diagnosis.report_.text()
    with pytest.raises(ValueError, match="Call it without hidden="):
        diagnosis.preflight(X, groups)
    assert diagnosis.gain_.channels["angle"][1] < diagnosis.gain_.channels["angle"][0]
    with pytest.raises(ValueError, match="v, w were not measured"):
        diagnosis.evaluate(X, y, groups)
    gain = diagnosis.evaluate(X, y, groups, horizon="episode", initial_state="fitted")
    assert set(gain.channels) == {"x", "angle"}
    assert gain.extended < gain.nominal


def spinning_log():
    """A box that spins; its orientation was not measured, and stands as a guess in the log."""
    text = """<mujoco><option gravity="0 0 -9"/><worldbody><body name="box" pos="0 0 9"><freejoint name="box"/>
        <geom type="box" size=".1 .2 .3" mass="1"/></body></worldbody></mujoco>"""
    box = MujocoSimulator(text, frame_skip=5)
    rng = np.random.default_rng(0)
    start = np.concatenate(
        [rng.normal(size=(6, 3)), np.tile([1.0, 0, 0, 0], (6, 1)), rng.normal(size=(6, 6))], axis=1
    )
    states = box.rollout(start, n_steps=20, effects={"gravity": 1.1})
    states[..., 3:7] = [1, 0, 0, 0]
    noise = 0.001 * rng.normal(size=states.shape)
    noise[..., 3:7] = 0.0
    states += noise
    return box, states[:, :-1].reshape(-1, 13), states[:, 1:].reshape(-1, 13), np.repeat(np.arange(6), 20)


def test_orientation_that_was_not_measured_is_no_evidence():
    box, X, y, groups = spinning_log()
    quaternion = [f"qpos.box.{part}" for part in ("qw", "qx", "qy", "qz")]
    options = {"effects": ["gravity", "tilt[x]"], "random_state": 0}
    diagnosis = SimulationDiagnosis(box, hidden=quaternion, **options).fit(X, y, groups)
    (cause,) = diagnosis.causes_
    assert cause.name == "gravity"
    assert cause.interval[0] <= 1.1 <= cause.interval[1]
    assert set(diagnosis.gain_.channels) == {name for name in box.residual_names if ".r" not in name}
    with pytest.raises(ValueError, match=r"name all of its quaternion, also qpos\.box\.qx, qpos\.box\.qy"):
        SimulationDiagnosis(box, hidden=quaternion[:1], **options).fit(X, y, groups)


def test_episode_that_diverges_in_open_loop_is_named_as_the_user_names_it(simulator):
    X, y, groups, _ = measure(8, pole=1.1, n_episodes=4)
    names = np.array(["run a", "run b", "run c", "run d"])[groups]
    diagnosis = SimulationDiagnosis(simulator, effects=["pole"], test_size=0, random_state=0).fit(X, y, names)
    far = X.copy()
    far[names == "run c", 3] = 1e200
    with pytest.raises(ValueError, match="in time order"):
        diagnosis.evaluate(far, y, names, horizon="episode")
    first = np.r_[True, names[1:] != names[:-1]]
    far = np.where((first & (names == "run c"))[:, None], [0, 0, 0, 1e200, 0], X)
    with pytest.raises(RuntimeError, match="diverges in episode run c"), np.errstate(all="ignore"):
        diagnosis.evaluate(far, y, names, horizon="episode")


def test_what_was_found_is_not_lost_where_the_gain_cannot_be_measured(simulator, monkeypatch):
    def diverging(*_, **__):
        raise RuntimeError("In open loop the nominal simulation diverges in episode 3: leave it out.")

    monkeypatch.setattr("skat.diagnosis.estimator.episode_gain", diverging)
    X, y, groups, _ = measure(8, pole=1.1, n_episodes=6)
    with pytest.warns(UserWarning, match="The gain could not be measured on the rows held out"):
        diagnosis = SimulationDiagnosis(simulator, hidden=HIDDEN, effects=["pole"], random_state=0).fit(
            X, y, groups
        )
    assert diagnosis.causes_[0].name == "pole"
    assert diagnosis.gain_ is None
    assert "pole" in diagnosis.report_.text()


def test_effect_that_initial_states_make_up_for_is_not_named_even_alone(simulator):
    X, y, groups, _ = measure(8, n_episodes=4, n_steps=25)
    diagnosis = SimulationDiagnosis(simulator, hidden=HIDDEN, effects=["bias[x]"], random_state=0)
    diagnosis.fit(X, y, groups)
    assert diagnosis.verdict_ == "nothing detected"
    assert np.isinf(diagnosis.identifiability_.loc["bias[x]", "smallest"])


PENDULUM = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body>
      <joint name="hinge" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.03" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" gear="2"/></actuator>
</mujoco>
"""


def test_delay_is_measured_where_velocities_are_hidden_and_commands_begin_before_the_log():
    """What an action from before the log does is no evidence, and an initial state makes up for what it did."""
    simulator = MujocoSimulator(PENDULUM)
    effects = ["delay[action]", "damping[hinge]", "gain[motor]", "armature[hinge]"]
    covered = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        commands = 3 * rng.normal(size=(12, 40, 1))
        initial = np.column_stack([rng.normal(size=12), np.zeros(12)])
        states = simulator.rollout(initial, commands, n_steps=40, effects={"delay[action]": 0.045})[:, 10:]
        states = states + 1e-3 * rng.normal(size=states.shape)
        states[..., 1] = 0.0
        X = np.concatenate([states[:, :-1], commands[:, 10:]], axis=-1).reshape(-1, 3)
        diagnosis = SimulationDiagnosis(simulator, effects=effects, hidden=["qvel.hinge"], test_size=0)
        diagnosis.fit(X, states[:, 1:].reshape(-1, 2), groups=np.repeat(np.arange(12), 30))
        (cause,) = diagnosis.causes_
        assert cause.name == "delay[action]"
        assert cause.value == pytest.approx(0.045, abs=5e-4)
        assert diagnosis.noise_ == pytest.approx(1e-3, rel=0.2)
        covered += cause.interval[0] <= 0.045 <= cause.interval[1]
    assert covered >= 3


def test_sensors_of_hidden_channels_are_no_candidates(simulator):
    log = measure(8, n_episodes=4, n_steps=25)
    diagnosis = SimulationDiagnosis(simulator, hidden=HIDDEN, random_state=0).fit(*log[:2], groups=log[2])
    assert not {"bias[v]", "scale[v]", "bias[w]", "scale[w]"} & set(diagnosis.identifiability_.index)
    assert {"bias[angle]", "scale[angle]"} <= set(diagnosis.identifiability_.index)
