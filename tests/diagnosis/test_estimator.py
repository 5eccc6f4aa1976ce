"""The diagnosis as a whole, on a cart with a pole: a simulation that costs next to nothing."""

import copy
import functools
import pickle
import warnings

import numpy as np
import pytest
from sklearn.base import clone

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.log import STRETCH_ROWS, STRETCHES, check_log
from skat.diagnosis.report.machine import findings_as_data
from skat.effects import Effect
from skat.simulators import FunctionSimulator
from tests.diagnosis.cart_pole import (
    NEUTRAL,
    STATES,
    cart_pole,
    make_simulator,
    measure,
)

FEW = STRETCHES * STRETCH_ROWS[0]
# Episodes are short, as a fit goes through all of them at once, row by row.
SHORT_EPISODES = {"n_episodes": 13, "n_steps": 12}
MORE_EPISODES = {"n_episodes": 16, "n_steps": 12}
# A log that several tests look at: a motor of four fifths of its strength shows in half of the usual rows.
SHORT = {"n_episodes": 10, "n_steps": 12, "gain": 0.8}


@pytest.fixture
def simulator():
    return make_simulator()


def fitted(simulator, log, **parameters):
    return SimulationDiagnosis(simulator, **{"random_state": 0, **parameters}).fit(*log[:2], groups=log[2])


@pytest.fixture(scope="module")
def diagnosed():
    """A function of a world that fits its diagnosis at the first call; tests that use it leave what they get alone."""
    return functools.cache(lambda seed, **world: fitted(make_simulator(), measure(seed, **world)))


@pytest.fixture(scope="module")
def refitted(diagnosed):
    """A clone of the diagnosis of the short log that was fitted anew; its parameters before, and what it was given."""
    blank, given = clone(diagnosed(5, **SHORT)), measure(5, **SHORT)[:3]
    assert not hasattr(blank, "verdict_")
    before = blank.get_params()
    return blank.fit(*given), before, given


# -- the world and the simulation agree ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "hidden", [{}, {"bob": 1.3}, {"pole": 0.8, "hinge": 0.01}, {"gain": -1.0, "drag": 0.3}]
)
def test_world_and_simulation_are_the_same_physics(simulator, hidden):
    X, y, groups, _ = measure(0, noise=0, **hidden)
    np.testing.assert_allclose(simulator.predict(X, effects=hidden, groups=groups), y, atol=2e-4)


# -- verdicts --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("bob", 1.1),
        pytest.param("pole", 0.9, marks=pytest.mark.long),
        ("pole", 1.6),
        pytest.param("gain", 0.9, marks=pytest.mark.long),
        ("gain", -1.0),
        ("drag", 0.2),
        *(
            pytest.param(*case, marks=pytest.mark.long)
            for case in [("dry_friction", 0.2), ("gravity", 1.05), ("hinge", 0.01)]
        ),
        ("bias[angle]", 0.1),
        ("scale[v]", 1.05),
    ],
)
def test_hidden_effect_is_named_with_its_size(simulator, diagnosed, name, value):
    family, _, channel = name.rstrip("]").partition("[")
    if channel:
        X, y, groups, _ = measure(3, **MORE_EPISODES)
        k = STATES.index(channel)
        for rows in (X, y):
            rows[:, k] = rows[:, k] + value if family == "bias" else rows[:, k] * value
        diagnosis = fitted(simulator, (X, y, groups))
    else:
        diagnosis = diagnosed(3, **MORE_EPISODES, **{name: value})
    assert diagnosis.verdict_ in ("named", "ambiguous")
    assert [cause.name for cause in diagnosis.causes_] == [name]
    (cause,) = diagnosis.causes_
    low, high = cause.interval
    assert low <= cause.value <= high
    # Twice the 95 % interval: a fixed seed, not luck, decides that the test passes; coverage has a test of its own.
    assert abs(cause.value - value) < high - low
    assert (cause.family, cause.target) == (family, channel or None)
    assert cause.probability > 0.9
    assert cause.evidence > -np.log(0.01)
    assert diagnosis.gain_.extended < diagnosis.gain_.nominal


@pytest.mark.parametrize(
    "hidden",
    [
        {"bob": 1.3},
        *(pytest.param(one, marks=pytest.mark.long) for one in ({"pole": 0.9}, {"gain": 0.9}, {"drag": 0.2})),
    ],
)
def test_most_of_an_excess_well_above_the_noise_is_explained(simulator, hidden):
    gain = fitted(simulator, measure(3, noise=0.0005, **MORE_EPISODES, **hidden)).gain_
    assert gain.nominal > 10
    assert gain.explained > 0.9
    assert gain.interval[0] > 0.8


def test_two_hidden_effects_are_both_named(simulator):
    diagnosis = fitted(simulator, measure(4, drag=0.2, pole=1.05, **SHORT_EPISODES))
    assert {cause.name for cause in diagnosis.causes_} == {"drag", "pole"}
    assert diagnosis.verdict_ == "named"
    for cause in diagnosis.causes_:
        low, high = cause.interval
        assert abs(cause.value - {"drag": 0.2, "pole": 1.05}[cause.name]) < 0.75 * (high - low)


def short_throw(X, drag=0.0):
    """Return how far a throw goes, m; a simulation that gives up beyond 4.8 m/s."""
    speed, angle = X.T
    distance = speed**2 * np.sin(2 * angle) / 9.81 * (1 - drag * speed)
    return np.where(speed > 4.8, np.nan, distance)[:, None]


def test_rows_in_which_a_simulation_diverges_are_left_out_with_a_warning():
    rng = np.random.default_rng(0)
    X = np.column_stack([rng.uniform(1, 5, 200), rng.uniform(0.3, 1.2, 200)])
    y = X[:, :1] ** 2 * np.sin(2 * X[:, 1:]) / 9.81 * (1 - 0.02 * X[:, :1]) + 0.002 * rng.normal(
        size=(200, 1)
    )
    drag = Effect("drag", unit="s/m", neutral=0.0, bounds=(0.0, 0.2))
    simulator = FunctionSimulator(
        short_throw, input_names=("speed", "angle"), output_names=("distance",), effects=[drag]
    )
    with pytest.warns(UserWarning, match=r"diverges in \d+ of 140 rows, which were left out"):
        diagnosis = fitted(simulator, (X, y, None))
    (cause,) = diagnosis.causes_
    assert cause.interval[0] < 0.02 < cause.interval[1]
    assert np.isfinite([diagnosis.gain_.nominal, diagnosis.gain_.extended]).all()


def test_an_estimate_at_a_bound_is_not_named(simulator):
    beyond, within = (
        fitted(simulator, measure(8, drag=drag, **SHORT_EPISODES), effects=["drag", "bob", "gain"])
        for drag in (3.0, 1.9)
    )
    assert "drag" not in [cause.name for cause in beyond.causes_]
    assert "drag" in [cause.name for cause in within.causes_]


def test_effect_with_narrow_bounds_is_named():
    narrow = Effect("gravity", unit="1", neutral=1.0, bounds=(0.95, 1.05))
    simulator = FunctionSimulator(
        cart_pole, input_names=(*STATES, "force"), output_names=STATES, state_names=STATES, effects=[narrow]
    )
    (cause,) = fitted(simulator, measure(6, gravity=1.04, **SHORT_EPISODES), effects=["gravity"]).causes_
    assert cause.interval[0] < 1.04 < cause.interval[1]


def test_force_that_no_effect_is_like_is_unexplained(simulator):
    diagnosis = fitted(simulator, measure(5, magnet=4.0, n_episodes=12, n_steps=20))
    assert diagnosis.verdict_ == "unexplained"
    assert diagnosis.remainder_.parts[0].name == "v"
    assert "x" in diagnosis.remainder_.parts[0].regressor


def test_cause_that_was_not_offered_is_unexplained(simulator):
    others = [name for name in NEUTRAL if name not in ("pole", "gravity", "bob")]
    diagnosis = fitted(simulator, measure(3, pole=1.6, n_episodes=16, n_steps=20), effects=others)
    assert diagnosis.verdict_ == "unexplained"
    assert diagnosis.remainder_.evidence > -np.log(0.01)


def test_errors_above_a_noise_that_is_known_are_unexplained(simulator):
    log = measure(3, pole=1.6, **SHORT_EPISODES)
    diagnosis = fitted(simulator, log, effects=["drag", "dry_friction"], noise=log[3])
    assert diagnosis.verdict_ == "unexplained"
    clean = measure(3, **MORE_EPISODES)
    assert fitted(simulator, clean, noise=clean[3]).verdict_ == "nothing detected"


# Each of these fits many logs once, and asks all that they can tell: a fixture is made anew in each process.
def assert_noise_is_that_of_the_measurement(diagnoses, logs):
    ratios = [
        diagnosis.noise_ / deviations for diagnosis, (*_, deviations) in zip(diagnoses, logs, strict=True)
    ]
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1, atol=0.12)


def test_clean_logs_raise_no_more_alarms_than_alpha_allows_and_tell_their_noise():
    logs = [measure(100 + seed, **SHORT_EPISODES) for seed in range(20)]
    diagnoses = [fitted(make_simulator(), log) for log in logs]
    # With the chance of 1 % each, more than one alarm of 20 comes in 1.7 % of runs.
    assert sum(diagnosis.verdict_ != "nothing detected" for diagnosis in diagnoses) <= 1
    assert_noise_is_that_of_the_measurement(diagnoses, logs)


def test_intervals_cover_the_truth_as_often_as_they_say_beside_a_right_noise():
    logs = [measure(200 + seed, bob=1.2, **SHORT_EPISODES) for seed in range(14)]
    diagnoses = [fitted(make_simulator(), log, effects=["bob", "drag", "gain"]) for log in logs]
    covered = []
    for diagnosis in diagnoses:
        intervals = {cause.name: cause.interval for cause in diagnosis.causes_}
        assert "bob" in intervals
        covered.append(intervals["bob"][0] <= 1.2 <= intervals["bob"][1])
    # With the chance of 95 % each, fewer than 12 of 14 come in 3.0 % of runs.
    assert sum(covered) >= 12
    assert_noise_is_that_of_the_measurement(diagnoses, logs)


# -- parameters ------------------------------------------------------------------------------------------------------


def findings(diagnosis):
    return diagnosis.verdict_, [(cause.name, cause.value, cause.interval) for cause in diagnosis.causes_]


def test_same_random_state_gives_the_same_answer(simulator, diagnosed, refitted):
    log = measure(5, **SHORT)
    first, (second, _, _) = diagnosed(5, **SHORT), refitted
    assert findings(first) == findings(second)
    assert first.gain_ == second.gain_
    assert first.evaluate(*log[:3]) == second.evaluate(*log[:3])
    assert fitted(simulator, log, random_state=1).gain_ != first.gain_


def test_clone_pickle_and_deepcopy_keep_what_they_should(diagnosed):
    log = measure(5, **SHORT)
    diagnosis = diagnosed(5, **SHORT)
    assert not hasattr(clone(diagnosis), "verdict_")
    for twin in (pickle.loads(pickle.dumps(diagnosis)), copy.deepcopy(diagnosis)):
        assert findings(twin) == findings(diagnosis)
        np.testing.assert_array_equal(twin.predict(log[0]), diagnosis.predict(log[0]))


def test_fit_leaves_the_parameters_and_the_log_alone(refitted):
    diagnosis, before, given = refitted
    assert diagnosis.get_params() == before
    for now, then in zip(given, measure(5, **SHORT)):
        np.testing.assert_array_equal(now, then)


def test_only_the_effects_given_are_considered(simulator):
    diagnosis = fitted(simulator, measure(3, bob=1.1, **MORE_EPISODES), effects=["bob", "drag"])
    assert list(diagnosis.identifiability_.index) == ["bob", "drag"]
    assert [cause.name for cause in diagnosis.causes_] == ["bob"]


def test_max_effects_bounds_the_number_of_causes(simulator):
    log = measure(4, drag=0.2, pole=1.2, n_steps=12)
    assert len(fitted(simulator, log, effects=["drag", "pole", "gain"], max_effects=1).causes_) == 1


def test_without_test_rows_there_is_no_gain(simulator):
    diagnosis = fitted(simulator, measure(3, bob=1.1, **MORE_EPISODES), test_size=0)
    assert diagnosis.gain_ is None
    assert diagnosis.verdict_ == "named"
    assert "bob" in repr(diagnosis)


def test_noise_that_is_given_is_kept(simulator):
    log = measure(3, bob=1.1, **MORE_EPISODES)
    diagnosis = fitted(simulator, log, noise=log[3])
    np.testing.assert_allclose(diagnosis.noise_, log[3], rtol=1e-12)
    assert [cause.name for cause in diagnosis.causes_] == ["bob"]


def test_single_episode_warns_and_is_diagnosed(simulator):
    log = measure(6, bob=1.3, n_episodes=1, n_steps=60)
    with pytest.warns(UserWarning, match="single episode"):
        diagnosis = fitted(simulator, log)
    assert "bob" in [cause.name for cause in diagnosis.causes_]


# -- what a fitted diagnosis gives -----------------------------------------------------------------------------------


def test_extended_simulation_predicts_and_scores_as_the_diagnosis_does(simulator, diagnosed):
    X, y, _, _ = measure(3, **MORE_EPISODES, bob=1.1)
    diagnosis = diagnosed(3, **MORE_EPISODES, bob=1.1)
    np.testing.assert_array_equal(diagnosis.predict(X), diagnosis.extended_simulator_.predict(X))
    values = {cause.name: cause.value for cause in diagnosis.causes_}
    np.testing.assert_allclose(diagnosis.predict(X), simulator.predict(X, effects=values), rtol=1e-12)
    nominal = np.sum((y - simulator.predict(X)) ** 2)
    assert np.sum((y - diagnosis.predict(X)) ** 2) < nominal
    assert 0.99 < diagnosis.score(X, y) <= 1


def test_gain_on_another_log_one_step_and_open_loop(diagnosed):
    diagnosis = diagnosed(3, **MORE_EPISODES, pole=1.6)
    fresh = measure(7, pole=1.6)
    one_step = diagnosis.evaluate(*fresh[:3])
    assert (one_step.horizon, one_step.floor) == (10.0, pytest.approx(1.0))
    # What the pole's own interval leaves is an error of the extended model, too, ten rows ahead.
    assert one_step.explained > 0.99
    assert 0.6 < one_step.extended < 3
    assert one_step.interval[0] <= one_step.explained <= one_step.interval[1]
    measured = diagnosis.evaluate(*fresh[:3], horizon="episode")
    refined = diagnosis.evaluate(*fresh[:3], horizon="episode", initial_state="fitted")
    for gain in (measured, refined):
        assert gain.horizon == "episode"
        assert gain.extended < gain.nominal
        assert set(gain.channels) == set(STATES)
    # An initial state of its own takes an episode's noisy start away, for both models.
    assert refined.extended < measured.extended
    assert refined.nominal < measured.nominal
    assert refined.extended < 1.5 * refined.floor


def test_outputs_choose_the_channels_of_the_distance(diagnosed):
    diagnosis = diagnosed(3, **MORE_EPISODES, pole=1.6)
    fresh = measure(7, pole=1.6)
    gain = diagnosis.evaluate(*fresh[:3], horizon="episode", outputs=["x"])
    assert set(gain.channels) == {"x"}
    np.testing.assert_allclose((gain.nominal, gain.extended), gain.channels["x"], rtol=1e-12)
    with pytest.raises(ValueError, match=r"outputs names z; measured channels are x, angle, v, w"):
        diagnosis.evaluate(*fresh[:3], horizon="episode", outputs=["z"])


def test_evaluate_refuses_what_it_does_not_know(diagnosed):
    diagnosis = diagnosed(3, **MORE_EPISODES, bob=1.1)
    X, y, groups, _ = measure(7, bob=1.1)
    with pytest.raises(ValueError, match="horizon must be seconds, None or 'episode'; it is 'whole'"):
        diagnosis.evaluate(X, y, groups, horizon="whole")
    with pytest.raises(ValueError, match="initial_state must be 'measured' or 'fitted'; it is 'guessed'"):
        diagnosis.evaluate(X, y, groups, initial_state="guessed")
    for outputs, horizon in ((["x"], None), (["x"], 0.1), ("x", "episode")):
        with pytest.raises(
            ValueError, match="outputs must be a list of names, with horizon='episode'; it is"
        ):
            diagnosis.evaluate(X, y, groups, outputs=outputs, horizon=horizon)
    with pytest.raises(ValueError, match="evaluate takes the rows of one log"):
        diagnosis.evaluate([(X, y, groups)], None)
    with pytest.raises(ValueError, match="needs a simulation with a state, and groups="):
        diagnosis.evaluate(X, y, horizon="episode")


def test_effect_that_no_state_depends_on_has_no_detectable_size(diagnosed):
    table = diagnosed(3, **MORE_EPISODES).identifiability_
    # The track looks the same everywhere: where its origin lies cannot be seen.
    assert table.loc["bias[x]", "smallest"] > 1e6
    assert np.isfinite(table.loc[["bob", "drag", "bias[angle]", "bias[v]"], "smallest"]).all()
    assert (table["similarity"] <= 1).all()


def test_detectable_size_falls_with_the_noise(simulator):
    fine, coarse = (
        fitted(simulator, measure(3, **MORE_EPISODES, noise=noise), effects=["bob", "drag"]).identifiability_[
            "smallest"
        ]
        for noise in (0.002, 0.02)
    )
    assert fine["bob"] < coarse["bob"] / 5


def test_preflight_needs_no_measurement_and_foresees_what_a_log_shows(simulator):
    log = measure(3, **MORE_EPISODES)
    diagnosis = SimulationDiagnosis(simulator, random_state=0, noise=log[3], test_size=0)
    table = diagnosis.preflight(log[0], groups=log[2])
    assert not hasattr(diagnosis, "verdict_")
    assert "separating_excitation" in table
    assert np.isinf(table.loc["bias[x]", "smallest"])
    seen = diagnosis.fit(*log[:2], groups=log[2]).identifiability_
    ratio = table.loc[["bob", "drag", "pole", "gravity"], "smallest"] / seen["smallest"]
    assert ratio.dropna().between(0.6, 1.6).all()


@pytest.mark.parametrize("hidden", [{}, {"gain": 0.8}])
def test_a_first_look_takes_few_rows_from_all_over_a_log_and_says_so(simulator, hidden):
    log = measure(5, **hidden)
    diagnosis = fitted(simulator, log, quick=True)
    whole = len(check_log(simulator, *log[:3]).split(0.3, np.random.RandomState(0))[0])
    assert diagnosis.n_rows_ == whole
    assert diagnosis.n_rows_fitted_ == len(diagnosis.report_.log) == FEW < whole
    assert [cause.name for cause in diagnosis.causes_] == list(hidden)
    for cause in diagnosis.causes_:
        low, high = cause.interval
        assert abs(cause.value - hidden[cause.name]) < high - low
    said = f"A first look, at {FEW} of {whole:,} rows"
    assert said in diagnosis.report_.text()
    assert said in diagnosis.report_.html(figures=False)
    assert ("What was looked at shows no difference" in diagnosis.report_.text()) == (not hidden)
    data = findings_as_data(diagnosis)
    assert (data["first_look"], data["rows_fitted"]) == (True, FEW)


def test_a_search_that_has_not_come_to_rest_leaves_a_log_unexplained(simulator, diagnosed, monkeypatch):
    assert diagnosed(5, **SHORT).settled_
    monkeypatch.setattr("skat.diagnosis.estimator.TURNS", 1)
    diagnosis = fitted(simulator, measure(5, **SHORT))
    assert not diagnosis.settled_
    assert diagnosis.verdict_ == "unexplained"
    assert "had not come to rest" in diagnosis.report_.text()


def test_a_first_look_at_a_short_log_is_a_whole_fit(simulator, diagnosed):
    whole = diagnosed(5, **SHORT)
    quick = fitted(simulator, measure(5, **SHORT), quick=True)
    assert quick.causes_ == whole.causes_
    assert quick.n_rows_fitted_ == quick.n_rows_ == whole.n_rows_ <= FEW
    assert quick.report_.text() == whole.report_.text()
    assert "first look" not in quick.report_.text()
    assert not findings_as_data(quick)["first_look"]


def test_no_channel_has_less_noise_than_its_floor(simulator):
    X, y, groups, deviations = measure(2, **SHORT_EPISODES)
    floor = np.array([0.0, (5 * deviations[1]) ** 2, 0.0, 0.0])
    found = [
        SimulationDiagnosis(simulator, random_state=0).fit(X, y, groups, floor=given).noise_
        for given in (None, floor)
    ]
    assert found[0][1] < 2 * deviations[1]
    assert found[1][1] >= 5 * deviations[1] * (1 - 1e-9)


@pytest.mark.parametrize("floor", [[0.1], [0.0, 0.0, 0.0, -1.0], [0.0, np.nan, 0.0, 0.0], "much"])
def test_a_floor_that_holds_no_variances_is_refused(simulator, floor):
    X, y, groups, _ = measure(2, n_episodes=2)
    with pytest.raises(
        ValueError, match="floor must hold a finite variance of at least 0 for each of x, angle"
    ):
        SimulationDiagnosis(simulator).fit(X, y, groups, floor=floor)


def test_progress_is_told(simulator):
    log = measure(3, n_episodes=4)
    stages = []
    SimulationDiagnosis(simulator, effects=["drag"], random_state=0).fit(
        *log[:2], groups=log[2], progress=lambda stage, done, total: stages.append(stage)
    )
    assert stages[-1] == "done"
    assert "search" in stages


# -- simulations without a state -------------------------------------------------------------------------------------


def thrown(X, speed=1.0, drop=1.0, wind=0.0):
    """Where a ball thrown at an angle (rad) and a speed (m/s) lands, and how long it flew."""
    angle, v = X.T
    time = 2 * speed * v * np.sin(angle) / (9.81 * drop)
    return np.stack([speed * v * np.cos(angle) * time + wind * time**2, time], axis=1)


@pytest.fixture
def throw():
    return FunctionSimulator(
        thrown,
        input_names=("angle", "v"),
        output_names=("place", "time"),
        effects=[
            Effect("speed", unit="1", neutral=1.0, bounds=(0.2, 5.0)),
            Effect("drop", unit="1", neutral=1.0, bounds=(0.2, 5.0)),
            Effect("wind", unit="m/s^2", neutral=0.0, bounds=(-5.0, 5.0)),
        ],
    )


def throws(seed, n_rows=150, **hidden):
    rng = np.random.default_rng(seed)
    X = np.column_stack([rng.uniform(0.3, 1.3, n_rows), rng.uniform(3, 8, n_rows)])
    return X, thrown(X, **hidden) + rng.standard_t(5, size=(n_rows, 2)) * [0.03, 0.01]


def test_one_shot_simulation_needs_no_episodes(throw):
    diagnosis = SimulationDiagnosis(throw, random_state=0).fit(*throws(0, wind=0.3))
    assert [cause.name for cause in diagnosis.causes_] == ["wind"]
    low, high = diagnosis.causes_[0].interval
    assert low < 0.3 < high
    assert diagnosis.gain_.explained > 0.9
    fresh = throws(1, wind=0.3)
    assert diagnosis.evaluate(*fresh).extended < diagnosis.evaluate(*fresh).nominal
    with pytest.raises(ValueError, match="needs a simulation with a state"):
        diagnosis.evaluate(*fresh, horizon="episode")


def test_one_shot_simulation_without_an_error_is_left_alone(throw):
    verdicts = [SimulationDiagnosis(throw, random_state=0).fit(*throws(10 + k)).verdict_ for k in range(12)]
    # With the chance of 1 % each, more than one alarm of 12 comes in 0.6 % of runs.
    assert sum(verdict != "nothing detected" for verdict in verdicts) <= 1


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e-6])
def test_bias_of_a_sensor_is_named_in_any_unit(unit):
    rng = np.random.default_rng(0)
    X = rng.uniform(0.2, 1.0, (80, 2))
    measured = unit * (600 * X[:, 0] ** 1.8 + 200 * X[:, 1] + 5 + 1.5 * rng.normal(size=80))
    pipe = FunctionSimulator(
        lambda X, rough, head: unit * (600 * rough * X[:, :1] ** 1.8 + 200 * head * X[:, 1:]),
        input_names=("flow", "level"),
        output_names=("dp",),
        effects=[Effect(name, unit="1", neutral=1.0, bounds=(0.5, 3.0)) for name in ("rough", "head")],
    )
    diagnosis = SimulationDiagnosis(pipe, random_state=0).fit(X, measured)
    assert [cause.name for cause in diagnosis.causes_] == ["bias[dp]"]
    low, high = diagnosis.causes_[0].interval
    assert low < 5 * unit < high


def slow_drive(seed):
    """Return six episodes at 20 Hz of a drive whose gain is 1.1, its place read to 1 mm: a step is mostly noise."""
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.uniform(-10, 10, (6, 6)), 20, axis=1)
    place = np.pad(np.cumsum(0.05 * 1.1 * speed, axis=1), ((0, 0), (1, 0))) + rng.normal(size=(6, 121))
    X = np.column_stack([place[:, :-1].ravel(), speed.ravel()])
    return X, place[:, 1:].reshape(-1, 1), np.repeat(np.arange(6), 120)


def test_cause_that_shows_in_sums_of_steps_alone_is_named():
    """Seeds in which single steps, by chance, are predicted no better with the true cause."""
    drive = FunctionSimulator(
        lambda X, gain, drift: X[:, :1] + 0.05 * (gain * X[:, 1:] + drift),
        input_names=("x", "u"),
        output_names=("x",),
        state_names=("x",),
        effects=[
            Effect("gain", unit="1", neutral=1.0, bounds=(0.2, 3.0)),
            Effect("drift", unit="mm/s", neutral=0.0, bounds=(-20.0, 20.0)),
        ],
        dt=0.05,
    )
    for seed in (11, 12, 14):
        diagnosis = fitted(drive, slow_drive(seed))
        assert diagnosis.verdict_ == "ambiguous"
        (cause,) = diagnosis.causes_
        assert "gain" in (cause.name, *(alias.name for alias in cause.aliases))


def test_what_is_no_simulator_and_noise_that_is_no_list_are_refused(simulator):
    X, y, groups, _ = measure(3)
    with pytest.raises(
        TypeError, match=r"simulator must be a Simulator, such as MujocoSimulator.*robot\.xml"
    ):
        SimulationDiagnosis("robot.xml").fit(X, y, groups=groups)
    with pytest.raises(ValueError, match="noise must hold a finite positive standard deviation for each of"):
        SimulationDiagnosis(simulator, noise={"x": 0.1}).fit(X, y, groups=groups)
    with pytest.raises(ValueError, match="measured"):
        SimulationDiagnosis(simulator, hidden=simulator.state_names).fit(X, y, groups=groups)


def test_preflight_asks_for_groups_only_where_none_were_given(simulator):
    forces = np.random.default_rng(0).normal(size=(2, 40, 1))
    states = simulator.rollout(np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0]]), forces, n_steps=40)
    X = np.concatenate([states[:, :-1], forces], axis=2).reshape(80, -1)
    groups = np.repeat([0, 1], 40)
    diagnosis = SimulationDiagnosis(simulator, effects=["drag", "gain"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        diagnosis.preflight(X, groups=groups)
    with pytest.warns(UserWarning, match="Pass groups="):
        diagnosis.preflight(X)


@pytest.mark.parametrize(
    ("groups", "message"), [([0, 0, 1], r"it has shape \(3,\)"), ([0, 0, np.nan, 1], "missing in row 2")]
)
def test_preflight_reads_groups_as_a_fit_does(simulator, groups, message):
    with pytest.raises(ValueError, match=message):
        SimulationDiagnosis(simulator).preflight(np.zeros((4, 5)), groups)


def test_a_cause_with_a_twin_is_ambiguous_and_has_at_most_half_of_the_probability():
    drive = FunctionSimulator(
        lambda X, gain, twin: X[:, :1] + 0.05 * gain * twin * X[:, 1:],
        input_names=("x", "u"),
        output_names=("x",),
        state_names=("x",),
        effects=[Effect(name, unit="1", neutral=1.0, bounds=(0.2, 3.0)) for name in ("gain", "twin")],
        dt=0.05,
    )
    rng = np.random.default_rng(0)
    speed = np.repeat(rng.uniform(-10, 10, (18, 2)), 20, axis=1)
    place = np.pad(np.cumsum(0.05 * 1.5 * speed, axis=1), ((0, 0), (1, 0))) + 0.02 * rng.normal(size=(18, 41))
    X = np.column_stack([place[:, :-1].ravel(), speed.ravel()])
    diagnosis = fitted(drive, (X, place[:, 1:].reshape(-1, 1), np.repeat(np.arange(18), 40)))
    (cause,) = diagnosis.causes_
    assert diagnosis.verdict_ == "ambiguous"
    twins = {alias.name: alias.probability for alias in cause.aliases}
    # A sensor that multiplies what it reads does the same.
    assert {"gain", "twin"} <= {cause.name, *twins} <= {"gain", "twin", "scale[x]"}
    assert cause.probability < 0.55
    (other,) = {"gain", "twin"} - {cause.name}
    assert twins[other] == pytest.approx(0.5, abs=0.1)
    sets = diagnosis.posterior_.sets
    assert sum(one.probability for one in sets) == pytest.approx(1)
    with_cause = sum(one.probability for one in sets if cause.name in one.names)
    assert with_cause == pytest.approx(cause.probability, abs=0.02)
    with_twin = [one for one in sets if cause.name not in one.names and cause.aliases[0].name in one.names]
    # What has both of two aliases is told as one of them.
    assert sum(one.probability for one in with_twin) == pytest.approx(cause.aliases[0].probability, abs=0.05)
    drawn = [name for draw in diagnosis.posterior_.sample(200, 0) for name in draw]
    assert min(drawn.count("gain"), drawn.count("twin")) > 60
