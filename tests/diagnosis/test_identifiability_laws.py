"""What a planned log can show, against closed forms: sizes at the needed odds, planned rows, inputs that separate."""

import numpy as np
import pytest

from skat.diagnosis.evidence import Gram, Priors, weigh
from skat.diagnosis.fitting import priors_of
from skat.diagnosis.identifiability import (
    NO_INPUT_SEPARATES,
    NOTHING_SEPARATES,
    _planned,
    _separating,
    _shares_left,
    _steps,
    from_neutral,
    identifiability,
    preflight,
)
from skat.effects import Effect
from skat.simulators import FunctionSimulator


def added(name="a", *, low=-5.0, high=5.0, typical=0.3, neutral=0.0):
    return Effect(name, unit="1", neutral=neutral, bounds=(low, high), typical=typical)


def one_prior(low=-5.0, high=5.0):
    return Priors(("a",), np.array([0.3]), np.array([np.log(0.1)]), np.array([low]), np.array([high]))


def one_gram(information):
    return Gram(np.array([[information]]), np.zeros(1), np.zeros(1))


@pytest.mark.parametrize("alpha", [0.05, 0.01, 1e-6])
@pytest.mark.parametrize("information", [30.0, 900.0, 1e6])
@pytest.mark.parametrize(("low", "high"), [(-5.0, 5.0), (0.0, 5.0), (-5.0, 0.0)])
def test_at_the_smallest_size_the_expected_scores_just_reach_the_odds(alpha, information, low, high):
    table = identifiability(
        one_gram(information), one_prior(low, high), [added(low=low, high=high)], {}, alpha=alpha
    )
    size = table.loc["a", "smallest"]
    place = size if high > 0 else -size
    scores = Gram(np.array([[information]]), np.array([information * place]), np.zeros(1))
    assert size > 0
    assert weigh(scores, one_prior(low, high), [0]).evidence == pytest.approx(-np.log(alpha), abs=0.01)


def test_what_even_the_bound_does_not_show_has_no_smallest_size():
    table = identifiability(
        one_gram(1e-3), one_prior(), [added()], {}, value_at=lambda effect, place: np.clip(place, -5, 5)
    )
    assert table.loc["a", "smallest"] == np.inf


def test_where_a_likelihood_counts_in_part_sets_need_as_much_more():
    half = identifiability(one_gram(900.0), one_prior(), [added()], {}, power=0.5)
    whole = identifiability(one_gram(450.0), one_prior(), [added()], {})
    assert half.loc["a", "smallest"] == whole.loc["a", "smallest"]


def test_values_count_from_neutral():
    assert [from_neutral(added(neutral=1.0), place) for place in (-0.25, 0.5)] == [0.75, 1.5]


def test_the_side_on_which_less_is_needed_counts():
    """Of a factor that search counts on the logarithm, a fall by a place is less than a rise by it."""
    table = identifiability(
        one_gram(100.0), one_prior(), [added(neutral=1.0)], {}, value_at=lambda effect, place: np.exp(place)
    )
    rise = identifiability(
        one_gram(100.0), one_prior(), [added(neutral=1.0)], {}, value_at=lambda effect, place: np.exp(-place)
    )
    plain = identifiability(one_gram(100.0), one_prior(), [added()], {}).loc["a", "smallest"]
    assert table.loc["a", "smallest"] == rise.loc["a", "smallest"] == pytest.approx(1 - np.exp(-plain))


def test_what_causes_leave_of_an_effect_is_what_a_regression_on_them_leaves():
    rng = np.random.default_rng(0)
    N = rng.normal(size=(40, 5)) @ (np.eye(5) + 0.7 * rng.random((5, 5)))
    N[:, 4] = N[:, 0] + N[:, 1]
    shares = _shares_left(N.T @ N, [0, 1])
    for k, others in ((0, [1]), (1, [0]), (2, [0, 1]), (3, [0, 1])):
        residual = N[:, k] - N[:, others] @ np.linalg.lstsq(N[:, others], N[:, k], rcond=None)[0]
        assert shares[k] == pytest.approx(np.sum(residual**2) / np.sum(N[:, k] ** 2), rel=1e-9)
    assert shares[4] == 0.0
    np.testing.assert_array_equal(_shares_left(N.T @ N, []), 1.0)


def test_cosines_have_no_sign_and_no_unit():
    products = np.array([[4.0, -3.6, 0.0], [-3.6, 9.0, 0.0], [0.0, 0.0, 0.0]])
    priors = Priors(tuple("abc"), np.full(3, 0.3), np.zeros(3), np.full(3, -5.0), np.full(3, 5.0))
    table = identifiability(
        Gram(products, np.zeros(3), np.zeros(3)), priors, [added(name) for name in "abc"], {}
    )
    assert table["similarity"].tolist() == pytest.approx([0.6, 0.6, 0.0])
    assert table["nearest_alias"].tolist() == ["b", "a", ""]


# -- planned rows ----------------------------------------------------------------------------------------------------


def counter(effects=(), dt=1.0):
    return FunctionSimulator(
        lambda X, extra=0.0: X[:, :2] + X[:, 2:] + extra,
        input_names=("p", "q", "u"),
        output_names=("p", "q"),
        state_names=("p", "q"),
        effects=effects,
        dt=dt,
    )


def test_planned_rows_end_where_the_next_begins_and_the_last_where_the_simulation_takes_it():
    X = np.random.default_rng(0).normal(size=(9, 3))
    log = _planned(counter(), X, np.repeat(["one", "other"], [5, 4]))
    assert log.consecutive
    assert log.episodes.tolist() == [0] * 5 + [1] * 4
    expected = np.r_[X[1:, :2], np.zeros((1, 2))]
    for last in (4, 8):
        expected[last] = X[last, :2] + X[last, 2]
    np.testing.assert_allclose(log.y, expected, rtol=1e-12)
    X[:, 1] = np.nan
    less = _planned(counter(), X, np.repeat([0, 1], [5, 4]))
    np.testing.assert_allclose(less.y[:, 0], expected[:, 0], rtol=1e-12)
    assert np.isnan(less.y[:, 1]).all()


def test_planned_rows_of_no_order_end_where_the_simulation_takes_each():
    X = np.random.default_rng(0).normal(size=(9, 3))
    log = _planned(counter(), X, None)
    assert not log.consecutive
    np.testing.assert_allclose(log.y, X[:, :2] + X[:, 2:], rtol=1e-12)


def test_one_percent_of_what_a_channel_spreads_is_noise_where_none_was_told():
    extra = added("extra")
    X = np.random.default_rng(0).normal(size=(40, 3)) * [1.0, 30.0, 1.0]
    X[:, :2] = np.cumsum(X[:, :2], axis=0)
    groups = np.zeros(40)
    simulator = counter([extra])
    spread = _planned(simulator, X, groups).y.std(axis=0)
    default = preflight(simulator, X, groups, [extra])["smallest"]
    np.testing.assert_allclose(default, preflight(simulator, X, groups, [extra], spread / 100)["smallest"])
    assert (preflight(simulator, X, groups, [extra], spread / 50)["smallest"] > default).all()


def test_a_user_s_own_typical_size_stands_before_the_effect_s():
    effects = [added("a", low=-1.0, neutral=1.0), added("b", typical=0.7)]
    priors = priors_of(effects, {"a": 0.05}, logarithmic=False)
    assert priors.scales.tolist() == [0.05, 0.7]
    assert (priors.low.tolist(), priors.high.tolist()) == ([-2.0, -5.0], [4.0, 5.0])


def test_slopes_are_taken_to_the_wider_side_and_within_bounds():
    effects = [
        added("up", low=-1.0, high=2.0),
        added("down", low=-2.0, high=1.0),
        added("even", low=-1.0, high=1.0),
        added("narrow", low=0.0, high=1e-3),
        added("narrow_down", low=-1e-3, high=0.0),
        added("factor", low=0.5, high=1.2, neutral=1.0),
    ]
    steps = _steps(effects, priors_of(effects, logarithmic=False))
    for effect in effects:
        low, high = steps[effect.name]
        assert effect.bounds[0] <= low < high <= effect.bounds[1]
        assert effect.neutral == (high if effect.name in ("down", "narrow_down", "factor") else low)
        assert high - low == pytest.approx(
            min(0.05 * effect.typical, 1e-3) if "narrow" in effect.name else 0.015
        )


# -- what separates --------------------------------------------------------------------------------------------------


def rig(difference):
    """Return a simulation of three inputs in which two effects differ by a function of them."""

    def response(X, one=0.0, other=0.0):
        return (one + other * (1 + difference(*X.T)))[:, None]

    return FunctionSimulator(
        response, input_names=("u", "v", "w"), output_names=("y",), effects=(added("one"), added("other"))
    )


def hint(difference, noise=1e-3):
    X = np.random.default_rng(0).uniform(-1.7, 1.7, size=(400, 3))
    simulator = rig(difference)
    table = preflight(simulator, X, None, simulator.effects(), [noise])
    return table.loc["other", "separating_excitation"]


@pytest.mark.parametrize(
    ("difference", "told"),
    [
        (lambda u, v, w: 0.05 * u**2, "large |u|"),
        (lambda u, v, w: 0.1 * (u * v > 0), NO_INPUT_SEPARATES),
        (lambda u, v, w: 0.4 * u * v * (np.abs(u * v) < 1), NO_INPUT_SEPARATES),
        (lambda u, v, w: 3.0 * u, ""),
        (lambda u, v, w: 0.0 * u, NOTHING_SEPARATES),
    ],
)
def test_the_input_is_told_at_whose_values_two_effects_come_apart(difference, told):
    assert hint(difference) == told


def test_what_is_apart_by_less_than_noise_is_not_apart():
    """Over five units, 400 rows differ by 5 (400 / 4)^.5 .01 = .5 in all."""

    def apart(u, v, w):
        return 0.01 * np.sign(u)

    assert hint(apart, noise=0.1) != NOTHING_SEPARATES
    assert hint(apart, noise=2.0) == NOTHING_SEPARATES


@pytest.mark.parametrize(("sign", "told"), [(1, "large v"), (-1, "small v")])
def test_an_input_is_moved_by_its_deviation_to_where_two_effects_come_apart(sign, told):
    X = np.random.default_rng(0).normal(2.0, 3.0, size=(200, 3))
    apart, asked = np.exp(sign * X[:, 1] / 9), []

    def similarity_at(moved):
        asked.append(moved)
        return 1 - 1.3 * 0.01

    assert _separating(rig(None), X, apart, 0.99, similarity_at) == told
    np.testing.assert_array_equal(asked[0][:, [0, 2]], X[:, [0, 2]])
    np.testing.assert_allclose(asked[0][:, 1] - X[:, 1], sign * X[:, 1].std(), rtol=1e-9)
    # An angle that hardly grows is no help.
    assert _separating(rig(None), X, apart, 0.99, lambda moved: 1 - 1.1 * 0.01) == NO_INPUT_SEPARATES
    assert _separating(rig(None), X, np.ones(200), 0.99, similarity_at) == NO_INPUT_SEPARATES


def test_large_and_small_values_alike_are_moved_apart():
    X = np.random.default_rng(0).normal(2.0, 3.0, size=(200, 3))
    standard = (X[:, 2] - X[:, 2].mean()) / X[:, 2].std()
    asked = []
    told = _separating(rig(None), X, np.abs(standard), 0.99, lambda moved: asked.append(moved) or 0.5)
    assert told == "large |w|"
    np.testing.assert_allclose(asked[0][:, 2] - X[:, 2].mean(), 2 * (X[:, 2] - X[:, 2].mean()), rtol=1e-9)
