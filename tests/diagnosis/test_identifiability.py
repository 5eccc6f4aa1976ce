"""What a log could show: the smallest size that would be named, by simulation, and what tells two effects apart."""

import warnings

import numpy as np
import pytest

from skat.diagnosis.evidence import Gram, Priors, weigh
from skat.diagnosis.identifiability import NOTHING_SEPARATES, identifiability, preflight
from skat.effects import Effect
from skat.simulators import FunctionSimulator

DT = 0.05
NAMES = ("angle", "rate")


def swing(X, damping=0.0, gain=1.0, twin=0.0, origin=0.0):
    rate = X[:, 1] + DT * (gain * X[:, 2] - np.sin(X[:, 0]) - (damping + twin) * X[:, 1])
    return np.stack([X[:, 0] + DT * rate, rate], axis=1)


def effects_of(*names):
    known = {
        "damping": Effect("damping", unit="1/s", neutral=0.0, bounds=(0.0, 5.0), typical=0.3),
        "gain": Effect("gain", unit="1", neutral=1.0, bounds=(0.1, 5.0), typical=0.2),
        "twin": Effect("twin", unit="1/s", neutral=0.0, bounds=(0.0, 5.0), typical=0.3),
        "origin": Effect("origin", unit="rad", neutral=0.0, bounds=(-1.0, 1.0), typical=0.1),
    }
    return [known[name] for name in names]


@pytest.fixture
def pendulum():
    return FunctionSimulator(
        swing,
        input_names=(*NAMES, "push"),
        output_names=NAMES,
        state_names=NAMES,
        effects=effects_of("damping", "gain", "twin", "origin"),
        dt=DT,
    )


def planned(pendulum, n_episodes=4, seed=0, size=1.0):
    rng = np.random.default_rng(seed)
    pushes = size * rng.normal(size=(n_episodes, 40, 1))
    states = pendulum.rollout(size * rng.normal(size=(n_episodes, 2)), pushes, n_steps=40)
    X = np.concatenate([states[:, :-1], pushes], axis=2).reshape(-1, 3)
    return X, np.repeat(np.arange(n_episodes), 40)


def priors_of(k, low=-5.0):
    names = tuple("abcde"[:k])
    return Priors(names, np.full(k, 0.3), np.full(k, np.log(0.1)), np.full(k, low), np.full(k, 5.0))


def plain(k, low=-5.0):
    return [Effect(name, unit="1", neutral=0.0, bounds=(low, 5.0)) for name in "abcde"[:k]]


@pytest.mark.parametrize("low", [-5.0, 0.0])
def test_the_smallest_size_is_named_in_one_log_of_two(low):
    rng, n = np.random.default_rng(0), 300
    priors, effects = priors_of(2, low), plain(2, low)
    N = rng.normal(size=(n, 2)) @ np.array([[1.0, 0.5], [0.0, 0.8]])
    gram = Gram(N.T @ N, np.zeros(2), np.zeros(2))
    size = identifiability(gram, priors, effects, {}, alpha=0.01).loc["a", "smallest"]
    named = 0
    for _ in range(600):
        z = size * N[:, 0] + rng.normal(size=n)
        named += weigh(Gram(N.T @ N, N.T @ z, np.zeros(2)), priors, [0]).evidence > -np.log(0.01)
    assert abs(named / 600 - 0.5) < 0.07  # 3.4 standard errors


def test_what_a_cause_found_could_take_over_is_no_evidence():
    products = 400 * np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 1.0]])
    gram, priors, effects = Gram(products, np.zeros(3), np.zeros(3)), priors_of(3), plain(3)
    alone = identifiability(gram, priors, effects, {})
    beside = identifiability(gram, priors, effects, {"b": 0.4})
    assert alone.loc["a", "nearest_alias"] == "b"
    assert alone.loc["a", "similarity"] == pytest.approx(0.9)
    # By the root of what is left, but for the prior, which costs the less the wider it is known.
    ratio = beside["smallest"] / alone["smallest"]
    assert 0.9 / np.sqrt(1 - 0.81) < ratio["a"] < 1 / np.sqrt(1 - 0.81)
    assert ratio["b"] == pytest.approx(1.0)
    assert ratio["c"] == pytest.approx(1.0)
    same = identifiability(Gram(400 * np.ones((3, 3)), np.zeros(3), np.zeros(3)), priors, effects, {"b": 0.4})
    assert np.isinf(same.loc["a", "smallest"])


def test_an_effect_that_has_to_leave_its_bounds_is_not_shown():
    gram, effects = Gram(np.diag([4.0, 0.0]), np.zeros(2), np.zeros(2)), plain(2)
    table = identifiability(gram, priors_of(2), effects, {})
    assert np.isfinite(table.loc["a", "smallest"])
    assert np.isinf(table.loc["b", "smallest"])
    near = Priors(("a", "b"), np.full(2, 0.3), np.full(2, np.log(0.1)), np.full(2, -1.0), np.full(2, 1.0))
    assert np.isinf(identifiability(gram, near, effects, {}).loc["a", "smallest"])


def test_sizes_are_told_in_the_effect_s_unit_whatever_the_search_counts_in():
    gram, priors = Gram(np.array([[400.0]]), np.zeros(1), np.zeros(1)), priors_of(1)
    plain_size = identifiability(gram, priors, plain(1), {}).loc["a", "smallest"]
    factor = [Effect("a", unit="1", neutral=2.0, bounds=(0.1, 9.0))]
    told = identifiability(
        gram, priors, factor, {}, value_at=lambda effect, place: effect.neutral * np.exp(place)
    ).loc["a", "smallest"]
    assert told == pytest.approx(2 * (1 - np.exp(-plain_size)))


def test_preflight_needs_no_measurement_and_tells_what_nothing_tells_apart(pendulum):
    X, groups = planned(pendulum)
    table = preflight(pendulum, X, groups, effects_of("damping", "gain", "twin", "origin"))
    assert list(table) == ["smallest", "unit", "nearest_alias", "similarity", "separating_excitation"]
    assert np.isfinite(table.loc[["damping", "gain"], "smallest"]).all()
    assert np.isinf(table.loc["origin", "smallest"])
    assert table.loc["origin", "nearest_alias"] == ""
    assert table.loc["damping", "nearest_alias"] == "twin"
    assert table.loc["damping", "separating_excitation"] == NOTHING_SEPARATES
    assert table.loc["gain", "separating_excitation"] == ""


def test_more_noise_and_fewer_rows_and_channels_show_less(pendulum):
    X, groups = planned(pendulum, 8)
    effects = effects_of("damping", "gain")

    def smallest(X, groups, noise, **options):
        return preflight(pendulum, X, groups, effects, noise, **options)["smallest"]

    fine = smallest(X, groups, [0.001, 0.002])
    assert (smallest(X, groups, [0.01, 0.02]) > 5 * fine).all()
    assert (smallest(X[:80], groups[:80], [0.001, 0.002]) > 1.5 * fine).all()
    assert (smallest(X, groups, [0.001, 0.002], hidden=("rate",)) > fine).all()
    # Without a word of how it moves, the rate is guessed.
    X[:, 1] = np.nan
    assert np.isfinite(smallest(X, groups, [0.001, 0.002])["gain"])


def test_labels_of_episodes_may_stand_in_any_order(pendulum):
    X, groups = planned(pendulum)
    effects = effects_of("damping", "gain")
    first = preflight(pendulum, X, groups, effects)
    np.testing.assert_array_equal(
        preflight(pendulum, X, np.array(list("dbca"))[groups], effects)["smallest"], first["smallest"]
    )


def test_groups_are_asked_for_only_where_none_were_given(pendulum):
    X, groups = planned(pendulum)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        preflight(pendulum, X, groups, effects_of("gain"))
    with pytest.warns(UserWarning, match="Pass groups="):
        preflight(pendulum, X, None, effects_of("gain"))


def test_an_excitation_separates_what_small_motions_do_not():
    """At small angles a spring and gravity are alike; larger ones tell them apart."""
    pull, spring = (
        Effect(name, unit="1", neutral=1.0 - place, bounds=(-1.0, 3.0), typical=0.2)
        for place, name in enumerate(("pull", "spring"))
    )

    def turn(X, pull=1.0, spring=0.0):
        rate = X[:, 1] - DT * (pull * np.sin(X[:, 0]) + spring * X[:, 0])
        return np.stack([X[:, 0] + DT * rate, rate], axis=1)

    rig = FunctionSimulator(
        turn, input_names=NAMES, output_names=NAMES, state_names=NAMES, effects=(pull, spring), dt=DT
    )
    X = 0.4 * np.random.default_rng(0).normal(size=(300, 2))
    table = preflight(rig, X, None, [pull, spring], [1e-4, 1e-4])
    assert table.loc["pull", "nearest_alias"] == "spring"
    assert table.loc["pull", "separating_excitation"] == "large |angle|"


def test_a_one_shot_simulation_is_told_of_too():
    reach = FunctionSimulator(
        lambda X, speed=1.0: speed * X, input_names=("v",), output_names=("far",),
        effects=[Effect("speed", unit="1", neutral=1.0, bounds=(0.2, 5.0), typical=0.2)],
    )  # fmt: skip
    X = np.linspace(1, 2, 50)[:, None]
    table = preflight(reach, X, None, reach.effects()[:1], [0.1])
    # Slope v, noise .1: information is the sum of v^2 / .01.
    information = np.sum(X**2) / 0.01
    size = table.loc["speed", "smallest"]
    assert 2.5 < size * np.sqrt(information) < 6
