"""A search for causes of what is linear in them: all of what it tells is known from the weighing of each set."""

import itertools

import numpy as np
import pytest
from scipy import special

from skat.diagnosis.causes import _slopes, _without_doubtful, find_causes
from skat.diagnosis.evidence import Gram, Weigher, coarsened, weigh
from skat.diagnosis.fits import Fits
from skat.diagnosis.fitting import Known, priors_of
from skat.diagnosis.statespace import state_space
from skat.effects import Effect
from skat.simulators import FunctionSimulator

NAMES = tuple("abc")
SIGMA = 0.5
NEEDED = -np.log(0.01)


def effects_of(bounds=((-5.0, 5.0),) * 3):
    return tuple(
        Effect(name, unit="1", neutral=0.0, bounds=both, typical=0.5) for name, both in zip(NAMES, bounds)
    )


def sloped(effects):
    """Return a one-shot simulation of a sum of three inputs, each times an effect."""
    return FunctionSimulator(
        lambda X, **values: X @ [[values.get(name, 0.0)] for name in NAMES],
        input_names=("p", "q", "r"),
        output_names=("y",),
        effects=effects,
    )


def measured(values, n=100, seed=0, alike=0.0):
    """Return inputs of unit variance, the second like the first, and noisy sums."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, 3))
    X[:, 1] = alike * X[:, 0] + np.sqrt(1 - alike**2) * X[:, 1]
    return X, X @ np.reshape(values, (3, 1)) + SIGMA * rng.normal(size=(n, 1))


GIVEN = Known(given=np.array([SIGMA]))


def found_in(X, y, effects=None, known=GIVEN, **options):
    effects = effects_of() if effects is None else effects
    space = state_space(sloped(effects), X, y, np.arange(len(X)), consecutive=False)
    return find_causes(space, effects, known=known, **options)


def gram_of(X, y):
    return Gram(X.T @ X / SIGMA**2, X.T @ y[:, 0] / SIGMA**2, np.zeros(3))


def all_sets(X, y, power=None, effects=None):
    """Return every set of causes, weighed."""
    priors = priors_of(effects_of() if effects is None else effects)
    power = coarsened(len(X)) if power is None else power
    return {
        members: weigh(gram_of(X, y), priors, members, power=power)
        for k in range(4)
        for members in itertools.combinations(range(3), k)
    }


def test_values_intervals_and_worths_are_those_of_the_likeliest_set():
    X, y = measured([1.0, 0.0, -0.4])
    found, sets = found_in(X, y), all_sets(X, y)
    best = max(sets, key=lambda members: sets[members].evidence)
    assert best == (0, 2)
    assert found.settled
    assert list(found.values) == ["a", "c"]
    np.testing.assert_allclose(list(found.values.values()), sets[best].values, atol=0.003)
    whole = weigh(gram_of(X, y), priors_of(effects_of()), best)
    for name, half in zip(found.values, whole.half_widths):
        low, high = found.intervals[name]
        assert (high - low) / 2 == pytest.approx(half, rel=0.01)
        assert (high + low) / 2 == pytest.approx(found.values[name], abs=2e-3 * half + 1e-3)
    assert found.worth["a"] == pytest.approx(sets[best].evidence - sets[2,].evidence, rel=0.02)
    assert found.worth["c"] == pytest.approx(sets[best].evidence - sets[0,].evidence, rel=0.02)
    assert (found.also, found.aliases) == ({}, {"a": (), "c": ()})


@pytest.mark.parametrize("values", [[1.0, 0.0, -0.4], [0.0, 0.08, 0.0], [0.0, 0.0, 0.0]])
def test_probabilities_are_those_of_the_sets_that_an_effect_is_in(values):
    X, y = measured(values)
    found, sets = found_in(X, y), all_sets(X, y)
    shares = special.softmax([one.evidence for one in sets.values()])
    for place, name in enumerate(NAMES):
        own = sum(share for members, share in zip(sets, shares) if place in members)
        assert found.probabilities[name] == pytest.approx(own, abs=0.03)


@pytest.mark.parametrize(("more", "named"), [(0.3, True), (-0.3, False)])
def test_a_cause_is_named_where_its_odds_are_as_long_as_asked(more, named):
    X, y = measured([0.0, 0.22, 0.0], seed=3)
    sets = all_sets(X, y)
    worth = sets[1,].evidence - sets[()].evidence
    assert worth > 2
    assert list(found_in(X, y, alpha=np.exp(more - worth)).values) == ["b"] * named


def test_what_a_long_log_shows_but_no_model_gets_right_is_told_beside_the_causes(monkeypatch):
    """Of as many rows as count half, an effect is worth half of its likelihood, as no model is exact."""
    monkeypatch.setattr("skat.diagnosis.evidence.COARSE_ROWS", 100)
    X, y = measured([1.0, 0.25, 0.0], seed=4)
    coarse, exact = all_sets(X, y, power=0.5), all_sets(X, y, power=1.0)
    assert coarse[0, 1].evidence - coarse[0,].evidence < NEEDED - 0.5
    assert exact[0, 1].evidence - exact[0,].evidence > NEEDED + 0.5
    found = found_in(X, y)
    assert list(found.values) == ["a"]
    assert list(found.also) == ["b"]
    assert found.also["b"] == pytest.approx(exact[0, 1].values[1], rel=0.02)


def test_without_a_member_that_slopes_find_worth_no_name_the_others_have_values_of_their_own():
    X, y = measured([0.6, 0.3, 0.0], alike=0.95)
    effects, power = effects_of(), coarsened(len(X))
    space = state_space(sloped(effects), X, y, np.arange(len(X)), consecutive=False)
    fits = Fits(space, effects, priors_of(effects), GIVEN, power)
    both = fits.of((0, 1), np.zeros(2), fits.first())
    worth = Weigher(gram_of(X, y), priors_of(effects), power=power)
    losses = worth.losses(worth((0, 1)))
    weakest = min(losses.values())
    assert _without_doubtful(fits, both, worth, weakest - 0.1) is both
    alone = _without_doubtful(fits, both, worth, weakest + 0.1)
    (left,) = alone.members
    assert losses[left] == max(losses.values())
    assert alone.values[NAMES[left]] == pytest.approx(all_sets(X, y)[left,].values[0], abs=0.003)
    assert abs(alone.values[NAMES[left]] - both.values[NAMES[left]]) > 0.05


@pytest.mark.parametrize("coarse", [False, True])
def test_a_search_that_ends_with_what_slopes_find_worth_no_name_does_not_stand(monkeypatch, coarse):
    """Of a first look, whose members no fit has weighed, slopes alone tell."""
    X, y = measured([1.0, 0.0, -0.4])
    assert found_in(X, y, coarse=coarse).settled
    monkeypatch.setattr(
        "skat.diagnosis.causes._without_doubtful",
        lambda fits, now, worth, needed: fits.of((0,), np.ones(1), now),
    )
    found = found_in(X, y, coarse=coarse)
    assert found.settled == coarse
    assert list(found.values) == (["a", "c"] if coarse else ["a"])
    if not coarse:
        assert found.values["a"] == pytest.approx(all_sets(X, y)[0,].values[0], abs=0.003)


def test_no_more_causes_are_named_than_were_asked_for():
    X, y = measured([1.0, 0.6, -0.8], n=40)
    assert list(found_in(X, y).values) == ["a", "b", "c"]
    assert list(found_in(X, y, max_effects=1).values) == ["a"]


def test_a_typical_size_of_a_user_s_own_holds_a_value_as_its_prior_does():
    X, y = measured([0.4, 0.0, 0.0], n=30)
    free, held = (found_in(X, y, typical=typical, alpha=0.9).values["a"] for typical in ({}, {"a": 0.05}))
    gram, priors = gram_of(X, y), priors_of(effects_of(), {"a": 0.05})
    power = coarsened(30)
    assert held == pytest.approx(weigh(gram, priors, (0,), power=power).values[0], abs=0.005)
    assert held < free


def test_an_effect_that_would_have_to_leave_its_bounds_is_no_cause():
    effects = effects_of(((-5.0, 5.0), (0.0, 0.5), (-5.0, 5.0)))
    X, y = measured([1.0, 0.8, 0.0], n=60)
    assert "b" not in found_in(X, y, effects).values
    assert list(found_in(*measured([1.0, 0.4, 0.0], n=60), effects).values) == ["a", "b"]


def test_noise_is_estimated_where_it_was_not_given():
    X, y = measured([1.0, 0.0, -0.4], n=200)
    found = found_in(X, y, known=Known())
    assert list(found.values) == ["a", "c"]
    left = y[:, 0] - X[:, [0, 2]] @ list(found.values.values())
    assert found.fitted.estimate.noise.error[0] == pytest.approx(np.mean(left**2), rel=0.02)
    # No finer than its floor.
    rough = found_in(X, y, known=Known(np.array([4.0])))
    assert rough.fitted.estimate.noise.error[0] == 4.0


@pytest.mark.parametrize("coarse", [False, True])
def test_effects_that_act_alike_share_a_name_by_their_odds(coarse):
    """By fits of either, or by slopes alone, whose scores scatter between the rows more than the model has it."""
    X, y = measured([0.35, 0.0, 0.0], alike=0.97, seed=2)
    found = found_in(X, y, coarse=coarse)
    assert list(found.values) == ["a"]
    priors, power = priors_of(effects_of()), coarsened(len(X))
    slopes = {members: weigh(found.gram, priors, members, power=power).evidence for members in all_sets(X, y)}
    if not coarse:  # A fit of the other goes before what slopes say of it, and of more with it.
        at_its_fit = slopes[0,] - (all_sets(X, y)[0,].evidence - all_sets(X, y)[1,].evidence)
        lost = max(slopes[1,] - at_its_fit, 0.0)
        slopes = {
            one: nats - lost if {1} < set(one) and 0 not in one else nats for one, nats in slopes.items()
        }
        slopes[1,] = at_its_fit
    shares = dict(zip(slopes, special.softmax(list(slopes.values()))))
    own = sum(one for members, one in shares.items() if 0 in members)
    other = sum(one for members, one in shares.items() if 1 in members and 0 not in members)
    sets = all_sets(X, y)
    apart = sets[0,].evidence - sets[1,].evidence
    assert 0 < apart < 2.5
    ((name, share),) = found.aliases["a"]
    assert name == "b"
    assert share == pytest.approx(other if coarse else special.expit(-apart), abs=0.03)
    assert found.probabilities["a"] == pytest.approx(own if coarse else min(own, 1 - share), abs=0.03)


def test_a_search_without_a_turn_left_has_not_come_to_rest():
    X, y = measured([1.0, 0.0, -0.4])
    told, states = [], []
    stopped = found_in(X, y, turns=0, checkpoint=states.append, progress=lambda *one: told.append(one))
    assert not stopped.settled
    assert told == [("search", 0, 0)]
    assert [state.turn for state in states] == [0]
    assert stopped.values == {}


def test_each_turn_is_told_and_a_search_goes_on_from_it_to_the_same_answer():
    X, y = measured([1.0, 0.5, -0.8], n=40)
    told, states = [], []
    found = found_in(X, y, checkpoint=states.append, progress=lambda *one: told.append(one))
    assert len(states) > 1
    assert [state.turn for state in states] == list(range(len(states)))
    assert told == [("search", turn, 16) for turn in range(len(states))]
    for state in states:
        later = []
        again = found_in(X, y, resumed=state, checkpoint=later.append)
        assert again.values == found.values
        assert [one.turn for one in later] == list(range(state.turn + 1, len(states)))


# -- what is not linear ----------------------------------------------------------------------------------------------


def fits_of(function, effect, x, y, sigma=0.1):
    """Return fits of one effect to readings of a one-shot simulation, and that of no cause."""
    simulator = FunctionSimulator(function, input_names=("x",), output_names=("y",), effects=(effect,))
    space = state_space(simulator, x[:, None], y[:, None], np.arange(len(x)), consecutive=False)
    fits = Fits(space, (effect,), priors_of((effect,)), Known(given=np.array([sigma])), 1.0)
    return fits, fits.first()


def test_slopes_are_tangents_where_these_explain_most_and_of_a_cause_over_what_is_not_known_of_it():
    effect = Effect("e", unit="1", neutral=0.0, bounds=(-4.0, 4.0), typical=1.0)
    rng = np.random.default_rng(0)
    x = rng.normal(size=60)
    y = 0.1 * x + 5 * 0.1**3 * x**2 + 0.1 * rng.normal(size=60)
    fits, nothing = fits_of(lambda X, e: X * e + 5 * X**2 * e**3, effect, x, y)
    # Over a twentieth of the typical size.
    np.testing.assert_allclose(_slopes(fits, nothing, [0])[:, 0, 0], x + 5 * x**2 * 0.05**2, atol=1e-9)
    cause = fits.of((0,), np.array([0.3]), nothing)
    at, width = cause.values["e"], max(float(cause.widths[0]), 0.05)
    expected = x + 5 * x**2 * (3 * at**2 + width**2)
    np.testing.assert_allclose(_slopes(fits, cause, [0])[:, 0, 0], expected, atol=1e-9)


def test_what_has_no_slope_has_a_chord_to_where_it_explains_most():
    """A limit that is never reached, as a factor: of chords that double until its bound, on the logarithm."""
    effect = Effect("limit", unit="1", neutral=1.0, bounds=(0.2, 1.0), typical=0.1)
    rng = np.random.default_rng(0)
    x = rng.uniform(-2, 2, size=80)
    y = np.clip(x, -1.2, 1.2) + 0.1 * rng.normal(size=80)
    fits, nothing = fits_of(lambda X, limit: np.clip(X, -3 * limit, 3 * limit), effect, x, y)
    places = np.r_[-0.05 * 2.0 ** np.arange(6), np.log(0.2)]
    chords = [(np.clip(x, -3 * np.exp(place), 3 * np.exp(place)) - x) / place for place in places]
    gains = []
    for place, chord in zip(places, chords):
        b, G = chord @ (y - x) / 0.01, max(chord @ chord / 0.01, 1e-300)
        at = np.clip(b / G, place, 0)
        gains.append(b * at - 0.5 * G * at**2)
    best = int(np.argmax(gains))
    assert gains[best] > 100
    np.testing.assert_allclose(_slopes(fits, nothing, [0])[:, 0, 0], chords[best], atol=1e-9)
