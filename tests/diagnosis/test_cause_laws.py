"""What a search for causes counts in, and what it makes of its sets: coordinates, steps, blocks, aliases, draws."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from skat.diagnosis import causes
from skat.diagnosis.causes import (
    Comparison,
    _comparable,
    _ends_of_chords,
    _live,
    _without_stand_ins,
    readable,
    typical_biases,
)
from skat.diagnosis.chains import Memory
from skat.diagnosis.evidence import Gram, Priors, Weighed, Weigher, weigh
from skat.diagnosis.fitting import (
    MEMORIES,
    Columns,
    Known,
    _blocks,
    _force_guess,
    _steps,
    _with_memory,
    _worth_beyond_white,
    _worth_of_memories,
    coordinate,
    first_fit,
    gram_of,
    on_logarithm,
    priors_of,
    slopes_of,
    value_at,
)
from skat.diagnosis.found import Rival, _beside_rivals, _ends, _quantiles, _with_fits, is_held, stand_ins
from skat.diagnosis.noise import Noise
from skat.diagnosis.posterior import CauseSet, Posterior
from skat.diagnosis.search import Ranked, families_of, rivals_of, search
from skat.diagnosis.statespace import state_space
from skat.effects import Effect
from skat.simulators import FunctionSimulator

GAIN = Effect("gain", unit="1", neutral=1.0, bounds=(0.25, 4.0), typical=0.2)
TURN = Effect("turn", unit="1", neutral=1.0, bounds=(-2.0, 2.0), typical=0.2)
DRAG = Effect("drag", unit="1/s", neutral=0.0, bounds=(0.0, 2.0), typical=0.1)
SHIFT = Effect("shift", unit="m", neutral=0.0, bounds=(-3.0, 1.0), typical=0.1)


# -- coordinates -----------------------------------------------------------------------------------------------------


def test_factors_that_are_positive_count_on_the_logarithm_and_all_within_bounds():
    assert [on_logarithm(one) for one in (GAIN, TURN, DRAG, SHIFT)] == [True, False, False, False]
    for effect in (GAIN, TURN, DRAG, SHIFT):
        assert coordinate(effect, effect.neutral) == 0.0
        for value in np.linspace(*effect.bounds, 7):
            assert value_at(effect, coordinate(effect, value)) == pytest.approx(value, abs=1e-12)
        assert value_at(effect, -1e3) == effect.bounds[0]
        assert value_at(effect, 100.0) == effect.bounds[1]
    # Half and twice are as far from neutral.
    assert coordinate(GAIN, 0.5) == -coordinate(GAIN, 2.0)


def test_chances_of_effects_and_of_none_sum_to_one_and_bounds_are_those_of_the_coordinates():
    effects = [GAIN, DRAG, Effect("rare", unit="1", neutral=0.0, bounds=(-1.0, 1.0), odds=0.1)]
    priors = priors_of(effects, {"drag": 0.7})
    chances = 1 / (1 + np.exp(-priors.log_odds))
    assert chances.sum() + 1 / (1 + 2.1) == pytest.approx(1.0)
    assert chances[0] / chances[2] == pytest.approx(10)
    assert priors.scales[:2].tolist() == [0.2, 0.7]
    np.testing.assert_allclose(priors.low, [-np.log(4), 0.0, -1.0])
    np.testing.assert_allclose(priors.high, [np.log(4), 2.0, 1.0])
    plain = priors_of(effects, logarithmic=False)
    np.testing.assert_allclose([plain.low[0], plain.high[0]], [-0.75, 3.0])


def test_odds_that_leave_next_to_nothing_to_others_are_counted_to_the_last_digit():
    effects = [
        replace(GAIN, odds=1e20),
        DRAG,
        Effect("rare", unit="1", neutral=0.0, bounds=(-1.0, 1.0), odds=0.1),
    ]
    sure, likely, rare = priors_of(effects).log_odds
    assert sure == pytest.approx(np.log(1e20 / 2.1))
    assert likely == pytest.approx(np.log(1 / 1e20))
    assert likely - rare == pytest.approx(np.log(10))


def test_slopes_are_taken_to_both_sides_of_a_cause_and_to_one_of_neutral():
    effects, widths = [GAIN, DRAG, SHIFT, TURN], np.full(4, 0.1)
    steps = _steps({"drag": 0.5, "shift": 1.0}, effects, widths)
    assert steps["gain"] == pytest.approx((1.0, np.exp(0.1)))
    assert steps["drag"] == pytest.approx((0.4, 0.6))
    assert steps["shift"] == pytest.approx((0.9, 1.0))  # at its bound
    assert steps["turn"] == pytest.approx((1.0, 1.1))
    below = Effect("below", unit="1", neutral=0.0, bounds=(-1.0, 0.0))
    assert _steps({}, [below], np.array([0.1]))["below"] == pytest.approx((-0.1, 0.0))


@pytest.mark.parametrize(
    ("effect", "value", "held"),
    [
        (GAIN, 4.0, True),
        (GAIN, 0.25, True),
        (GAIN, 3.99, False),
        (GAIN, 1.0, False),
        (DRAG, 0.0, False),  # neutral is no bound that holds
        (DRAG, 2.0, True),
        (SHIFT, -3.0, True),
        (SHIFT, -2.99, False),
    ],
)
def test_an_estimate_is_held_at_a_bound_that_is_not_neutral(effect, value, held):
    assert is_held(effect, value) == held


def test_chords_end_at_a_typical_size_or_all_over_the_range_of_what_has_no_slope():
    still = FunctionSimulator(lambda X: X, input_names=("a",), output_names=("b",))
    assert _ends_of_chords(still, SHIFT, 0.1, False) == pytest.approx([-0.1, 0.1])
    assert _ends_of_chords(still, DRAG, 0.1, False) == pytest.approx([0.1])
    assert _ends_of_chords(still, GAIN, 0.2, False) == pytest.approx([np.exp(-0.2), np.exp(0.2)])
    # From the furthest on: what does nothing there does nothing nearer by.
    dead = _ends_of_chords(still, SHIFT, 0.1, True)
    assert [end for end in dead if end > 0] == pytest.approx([1.0, 0.8, 0.4, 0.2, 0.1, 0.05])
    assert [end for end in dead if end < 0] == pytest.approx([-3.0, -1.6, -0.8, -0.4, -0.2, -0.1, -0.05])
    assert 0.0 not in dead


def test_what_acts_beyond_a_threshold_has_chords_all_over_its_range():
    """Its slope says little of what it does further off: a quarter of a degree of play, of up to a few degrees."""
    still = FunctionSimulator(lambda X: X, input_names=("a",), output_names=("b",))
    play = Effect("backlash[elbow]", unit="rad", neutral=0.0, bounds=(0.0, 0.05))
    assert _ends_of_chords(still, play, 0.01, False) == pytest.approx([0.005, 0.01, 0.02, 0.04, 0.05])


def test_chords_of_a_delay_end_at_each_time_step():
    timed = SimpleNamespace(dt=0.02, frame_skip=4)
    delay = Effect("delay[action]", unit="s", neutral=0.0, bounds=(0.0, 0.03))
    assert _ends_of_chords(timed, delay, 0.01, False) == pytest.approx(0.005 * np.arange(1, 7))


# -- fits ------------------------------------------------------------------------------------------------------------


def pushed(gain=1.0, error=0.1, n=40, seed=0):
    """Return the log of a place that a command moves `gain` times as far."""

    def step(X, gain=1.0, shift=0.0):
        return X[:, :1] + gain * X[:, 1:] + shift

    simulator = FunctionSimulator(
        step, input_names=("x", "u"), output_names=("x",), state_names=("x",), effects=(GAIN, SHIFT), dt=1.0
    )
    rng, X, y = np.random.default_rng(seed), [], []
    for _ in range(3):
        u = rng.normal(size=(n, 1))
        path = np.r_[np.zeros((1, 1)), np.cumsum(gain * u, axis=0)] + error * rng.normal(size=(n + 1, 1))
        X.append(np.c_[path[:-1], u])
        y.append(path[1:])
    groups = np.repeat(np.arange(3), n)
    return state_space(simulator, np.concatenate(X), np.concatenate(y), groups, consecutive=True)


def test_slopes_count_by_the_coordinate_of_the_search():
    space = pushed()
    fitted = first_fit(space, {})
    effects = (GAIN, SHIFT)
    slopes = slopes_of(space, fitted, effects, priors_of(effects).scales)
    chord = (np.exp(0.01) - 1) / 0.01
    np.testing.assert_allclose(slopes[:, 0, 0], chord * space.X[:, 1], rtol=1e-6)
    np.testing.assert_allclose(slopes[:, 0, 1], 1.0, rtol=1e-6)
    wide = slopes_of(space, fitted, effects, priors_of(effects).scales, np.array([0.5, 0.0]))
    np.testing.assert_allclose(wide[:, 0, 0], (np.exp(0.5) - 1) / 0.5 * space.X[:, 1], rtol=1e-6)
    columns = gram_of(space, fitted, slopes, effects)
    assert columns.gram.origin.tolist() == [0.0, 0.0]
    np.testing.assert_allclose(columns.gram.products, columns.columns.T @ columns.columns, rtol=1e-9)
    # Of a right model a step by the score over its information is one of about its error.
    step = columns.gram.projections / np.sqrt(np.diag(columns.gram.products))
    assert np.abs(step).max() < 4


def test_a_fit_at_given_noise_keeps_it():
    space = pushed()
    given = first_fit(space, {}, Known(given=np.array([0.3])))
    assert given.estimate.noise.error[0] == pytest.approx(0.09)
    free = first_fit(space, {})
    assert free.estimate.noise.error[0] == pytest.approx(0.01, rel=0.35)


def test_the_right_value_is_likelier_than_others():
    space = pushed(gain=1.3)
    bounds = [first_fit(space, {"gain": value}).bound for value in (1.0, 1.3, 1.6)]
    assert bounds[1] > max(bounds[0], bounds[2]) + 10


def test_forces_are_first_guessed_as_large_as_what_one_step_leaves():
    """Of two channels the one that shows less of the force bounds it."""
    carrier = np.tile(np.array([[2.0], [0.5]]), (1, 6, 1, 1))
    linear = SimpleNamespace(chains=SimpleNamespace(carrier=carrier))
    assert _force_guess(linear, np.array([4.0, 0.01])).tolist() == pytest.approx([min(1.0, 0.04)])
    nothing = SimpleNamespace(chains=SimpleNamespace(carrier=np.zeros((1, 6, 2, 0))))
    assert len(_force_guess(nothing, np.ones(2))) == 0


def test_a_noise_with_memory_is_as_large_as_without_and_comes_back_as_it_was():
    noise = Noise(
        np.array([[4.0]]), np.array([[1.0, 2.0]]), np.array([[5.0]]), np.array([[np.inf, 3.0]]), np.zeros(2, dtype=int),
        np.full((2, 3, 1), 0.5), np.full((2, 4, 2), 0.7),
    )  # fmt: skip
    both = _with_memory(noise, Memory(1, 0.8))
    # In steady state the lasting force has the variance of the white one.
    assert both.force[0, 1] / (1 - 0.8**2) == pytest.approx(4.0)
    assert both.error.tolist() == [[1.0, 2.0, 1.0]]
    assert (both.force_weights.shape, both.error_weights.shape) == ((2, 3, 2), (2, 4, 3))
    assert np.isinf(both.force_nu[0, 1])
    back = both.part(np.arange(2), np.arange(1))
    for name in ("force", "error", "force_nu", "error_nu", "force_weights", "error_weights"):
        np.testing.assert_array_equal(getattr(back, name), getattr(noise, name))


@pytest.mark.parametrize("share", [0.0, 0.9])
def test_innovations_that_go_with_those_before_or_against_them_ask_for_a_memory(share):
    rng, n = np.random.default_rng(0), 300
    white = rng.normal(size=(4, n, 1))
    z = np.zeros_like(white)
    for step in range(n):
        z[:, step] = share * z[:, step - 1] + np.sqrt(1 - share**2) * white[:, step]
    # A force that is taken back by as much in each of the ten rows behind it.
    back = white.copy()
    for later in range(1, 11):
        back[:, later:] -= white[:, :-later] / 10
    memories = [Memory(1, np.exp(-1 / rows), returns) for returns in (False, True) for rows in MEMORIES]

    def worth(series, memories=memories):
        filtered = SimpleNamespace(filtered=SimpleNamespace(whitened=series))
        found = _worth_of_memories(SimpleNamespace(mask=np.ones_like(series, dtype=bool)), filtered, memories)
        return found[:5], found[5:]

    lasting, returning = worth(z)
    assert (max(lasting) > 20) == bool(share)
    assert max(returning) < 20
    lasting, returning = worth(back if share else white)
    assert (max(returning) > 20) == bool(share)
    assert max(lasting) < 20
    # Of a memory that is longer than a chain nothing is known.
    assert worth(z[:, :12])[0][3:] == [0.0, 0.0]


@pytest.mark.parametrize("away", [0.0, 0.3])
def test_innovations_that_go_with_any_before_are_not_white(away):
    """Neither sum of the five before says so where they go with one of them and against another."""
    series = np.random.default_rng(0).normal(size=(4, 300, 2))
    series[..., 1] = 0.0
    series[:, 3:, 0] += away * (series[:, 2:-1, 0] - series[:, :-3, 0])
    mask = np.array([True, False])
    told = SimpleNamespace(filtered=SimpleNamespace(whitened=series))
    worth = _worth_beyond_white(SimpleNamespace(mask=np.broadcast_to(mask, series.shape)), told)
    assert (worth > 20) if away else (abs(worth) < 6)


def columns_of(N, z, origin, blocks=None):
    blocks = np.zeros(len(z), dtype=int) if blocks is None else blocks
    return Columns(Gram(N.T @ N, N.T @ z, origin), z, N, blocks)


def test_what_all_effects_move_together_is_a_ridge_towards_neutral():
    rng = np.random.default_rng(0)
    N, z, origin = rng.normal(size=(30, 4)), rng.normal(size=30), np.array([0.3, 0.0, -1.0, 0.5])
    scales = np.array([0.1, 0.2, 0.5, 1.0])
    rows = np.r_[N, np.diag(1 / scales)]
    expected = np.linalg.lstsq(rows, np.r_[z, -origin / scales], rcond=None)[0]
    np.testing.assert_allclose(columns_of(N, z, origin).dense(scales), expected, rtol=1e-9)


@pytest.mark.parametrize("each", [1, 8])
def test_scores_scatter_between_blocks_by_what_the_blocks_have_in_common(each):
    n_blocks = 12
    shifts = np.random.default_rng(0).normal(size=n_blocks)
    order = np.random.default_rng(1).permutation(n_blocks * each)
    blocks = np.repeat(np.arange(n_blocks), each)[order]
    columns = columns_of(np.ones((n_blocks * each, 1)), np.zeros(n_blocks * each), np.zeros(1), blocks)
    excess = columns.excess(shifts[blocks])
    assert excess[0] == pytest.approx(max(each * shifts.var(ddof=1) - 1, 0.0))
    # What is the same in all blocks is the effect's own value, and no scatter.
    np.testing.assert_allclose(columns.excess(shifts[blocks] + 5.0), excess)
    assert columns.excess(np.zeros(len(blocks))).tolist() == [0.0]
    few = columns_of(np.ones((18, 1)), np.zeros(18), np.zeros(1), np.repeat(np.arange(9), 2))
    assert few.excess(100.0 * np.arange(18)).tolist() == [0.0]
    enough = columns_of(np.ones((20, 1)), np.zeros(20), np.zeros(1), np.repeat(np.arange(10), 2))
    assert enough.excess(100.0 * np.arange(20))[0] > 0


@pytest.mark.parametrize("n", [30, 120, 1000])
def test_rows_that_are_independent_fall_in_about_sixty_blocks(n):
    simulator = SimpleNamespace(state_names=("q",))
    blocks = _blocks(SimpleNamespace(real=np.ones((n, 1), dtype=bool), simulator=simulator))
    assert blocks.shape == (n, 2)
    np.testing.assert_array_equal(blocks[:, 0], blocks[:, 1])
    assert (np.diff(blocks[:, 0]) >= 0).all()
    assert len(np.unique(blocks)) == pytest.approx(min(n, 60), rel=0.1)


# -- sets ------------------------------------------------------------------------------------------------------------


def gram_with(cosine):
    """Return the Gram matrices of three effects, of which the first two act alike."""
    products = 400 * np.array([[1.0, cosine, 0.0], [cosine, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return Gram(products, products @ np.array([0.4, 0.0, 0.3]), np.zeros(3))


PRIORS = Priors(tuple("abc"), np.full(3, 0.3), np.full(3, -2.0), np.full(3, -5.0), np.full(3, 5.0))


def a_set(members, evidence):
    k = len(members)
    return Weighed(tuple(members), np.zeros(k), evidence, evidence, np.eye(k))


def test_cosines_are_those_of_the_angles_between_responses():
    N = np.random.default_rng(0).normal(size=(30, 3)) * [1.0, -5.0, 100.0]
    expected = np.abs(np.corrcoef(np.r_[N, -N].T)[1])
    np.testing.assert_allclose(Gram(N.T @ N, np.zeros(3), np.zeros(3)).cosines(1), expected, rtol=1e-9)


def test_deviations_are_those_of_the_curvature():
    gram = gram_with(0.9)
    curvature = weigh(gram, PRIORS, (0, 1)).curvature
    expected = np.sqrt(np.linalg.solve(curvature, np.eye(2)).diagonal())
    np.testing.assert_allclose(weigh(gram, PRIORS, (0, 1)).deviations, expected, rtol=1e-9)
    assert len(weigh(gram, PRIORS, ()).deviations) == 0


def test_what_stands_in_a_cause_s_place_in_likely_sets_is_its_alias():
    gram = gram_with(0.9)
    best = a_set((0, 2), 50.0)
    sets = best, a_set((1, 2), 49.0), a_set((2,), 48.5), a_set((0, 1, 2), 48.0), a_set((1,), 40.0)
    ranked = Ranked(sets)
    others_of = stand_ins(ranked, gram, best, PRIORS.names)
    weights = np.exp(np.array([one.evidence for one in sets]) - 50)
    assert others_of[2] == {}
    assert others_of[0] == pytest.approx({1: (weights[1] + weights[4]) / weights.sum()})


class WeighedBefore(dict):
    """Weighs these sets, and allows no other."""

    __call__, allows = dict.__getitem__, dict.__contains__


def rival(members, gain):
    return Rival(members, np.zeros(len(members)), gain)


def test_fits_of_rivals_go_before_what_slopes_say_of_all_sets_with_them():
    best = a_set((0, 3), 50.0)
    slopes = {(1, 3): 49.5, (1, 3, 4): 47.0, (2, 3): 30.0, (2, 3, 4): 29.0, (0, 2, 3): 46.0, (1, 2): 10.0}
    ranked = Ranked((best, *(a_set(members, nats) for members, nats in slopes.items())))
    worth = WeighedBefore({one.members: one for one in (*ranked.sets, a_set((3,), 20.0))})

    def refitted(*rivals):
        return _with_fits(ranked, worth, best, rivals).sets

    # One that is 80 nats behind, not half a nat; what was added to it loses as much.
    worse = {one.members: one.evidence for one in refitted(rival((1, 3), -80.0))}
    assert worse == pytest.approx({**slopes, best.members: 50, (1, 3): -30, (1, 3, 4): -32.5})
    # One that slopes had 20 nats behind is as likely, and is not preferred; of larger sets its fit says nothing.
    better = refitted(rival((2, 3), 3.0))
    assert better[0] is best
    assert {one.members: one.evidence for one in better} == pytest.approx(
        {**slopes, best.members: 50, (2, 3): 50}
    )
    # But for what names cost one with more may be likelier; and what is lost by a cause less, more may make up for.
    assert {one.members: one.evidence for one in refitted(rival((1, 2), -80.0))}[1, 2] == -30
    larger = {one.members: one.evidence for one in refitted(rival((0, 2, 3), 3.0))}
    assert larger == pytest.approx({**slopes, best.members: 50, (0, 2, 3): 53})
    fewer = {one.members: one.evidence for one in refitted(rival((3,), -80.0))}
    assert fewer == pytest.approx({**slopes, best.members: 50, (3,): -30})
    assert refitted() == tuple(sorted(ranked.sets, key=lambda one: -one.evidence))


def test_a_rival_that_slopes_did_not_weigh_is_weighed_by_its_fit():
    best = a_set((0,), 10.0)
    found = _with_fits(Ranked((best,)), lambda members: a_set(members, -5.0), best, [rival((1,), -1.0)])
    assert found.probability(1) == pytest.approx(1 / (1 + np.e))
    assert found.probability(0) == pytest.approx(np.e / (1 + np.e))


def test_what_may_act_beside_a_cause_may_act_beside_its_rival():
    """Two effects act alike; of a third, worth no name beside either, the sets at hand have it beside one alone."""
    N = np.random.default_rng(0).normal(size=(200, 3))
    N[:, 1] = N[:, 0]
    gram = Gram(N.T @ N, N.T @ (N @ [0.5, 0.0, 0.3]), np.zeros(3))
    worth = Weigher(
        gram, Priors(tuple("abc"), np.ones(3), np.full(3, -3.0), np.full(3, -50.0), np.full(3, 50.0))
    )
    best, both = worth((0,)), worth((0, 2))
    assert both.evidence > best.evidence + 1

    def beside(gain, *larger):
        rivals = [rival((1,), gain), *larger]
        return _beside_rivals(_with_fits(Ranked((both, best)), worth, best, rivals), worth, best, rivals)

    for gain in (-1.0, -3.0):
        found = beside(gain)
        assert found.probability(0) / found.probability(1) == pytest.approx(np.exp(-gain))
        assert found.probability(2) == pytest.approx(1 / (1 + np.exp(best.evidence - both.evidence)))
    # So it does where a fit has it be worth more than slopes do.
    found = beside(-1.0, rival((0, 2), 9.0))
    assert found.probability(0) / found.probability(1) == pytest.approx(np.e)


def test_an_interval_is_of_all_sets_with_a_cause():
    """One in five has beside it what acts the same: there the value is anywhere."""
    N = np.random.default_rng(0).normal(size=(200, 3))
    N[:, 1] = N[:, 0] + 1e-4 * N[:, 2]
    gram = Gram(N.T @ N, N.T @ (N @ [0.5, 0.0, 0.3]), np.zeros(3))
    some = Priors(tuple("abc"), np.ones(3), np.zeros(3), np.full(3, -50.0), np.full(3, 50.0))
    worth = Weigher(gram, some)
    alone, both, without = (worth(one) for one in ((0, 2), (0, 1, 2), (1, 2)))

    def sets(*shares):
        return Ranked(tuple(replace(one, evidence=np.log(share)) for one, share in shares))

    half = alone.half_widths[0]
    for ranked in (sets((alone, 1.0)), sets((alone, 0.5), (without, 0.5))):
        assert _ends(worth, alone, ranked)[0] == pytest.approx((-half, half), rel=1e-3)
    low, high = _ends(worth, alone, sets((alone, 0.8), (both, 0.2)))[0]
    # Of 20 % a share of 2.5 % each is beyond the ends: of the product of both priors, (.5 - x)^2 about it.
    at = alone.values[0] + np.linspace(-60, 60, 600_001)
    law = 1 / (1 + at**2) / (1 + (alone.values[0] - at) ** 2)
    share = np.cumsum(law) / law.sum()
    assert [low, high] == pytest.approx(
        [at[np.searchsorted(share, end)] - alone.values[0] for end in (0.125, 0.875)], abs=0.05
    )
    # One that was fitted is where its fit is.
    elsewhere = replace(
        alone, members=(0, 1, 2), values=both.values + np.array([3.0, 0.0, 0.0]), evidence=np.log(0.2)
    )
    fitted = Ranked((replace(alone, evidence=np.log(0.8)), elsewhere))
    assert _ends(worth, alone, fitted)[0][1] == pytest.approx(high + 3.0, abs=0.1)


def test_ends_of_laws_are_found_however_narrow_they_are():
    for narrow in (1e-13, 1e-9, 1.0):
        low, high = _quantiles(np.ones(1), np.zeros(1), np.array([narrow]))
        assert [low, high] == pytest.approx([-1.96 * narrow, 1.96 * narrow], rel=1e-6, abs=0.0)
    low, high = _quantiles(np.array([0.98, 0.02]), np.array([1402.0, 1e-4]), np.array([1e-12, 1e6]))
    assert [low, high] == pytest.approx([1402.0, 1402.0], abs=1e-6)


def test_an_interval_is_told_of_a_set_that_slopes_find_next_to_impossible():
    """A search that is stopped ends with a set that slopes would leave, and may not have weighed as it is."""
    N = 100 * np.random.default_rng(0).normal(size=(200, 3))
    gram = Gram(N.T @ N, N.T @ (N @ [0.5, 0.0, 0.9]), np.zeros(3))
    worth = Weigher(gram, Priors(tuple("abc"), np.ones(3), np.zeros(3), np.full(3, -50.0), np.full(3, 50.0)))
    best, other = worth((0,)), worth((2,))
    assert other.evidence > best.evidence + 1e3
    half = best.half_widths[0]
    for sets in ((other, best), (other,)):
        ranked = _with_fits(Ranked(sets), worth, best, [])
        assert _ends(worth, best, ranked)[0] == pytest.approx((-half, half), rel=1e-3)
        assert ranked.probability(0) == 0.0


def test_where_slopes_mislead_only_sets_with_less_and_with_a_little_more_are_left():
    best = a_set((0, 1), 50.0)
    sets = [
        ((0,), 60.0),
        ((0, 1, 2), 53.0),
        ((0, 1, 3), 56.0),
        ((0, 2), 49.0),
        ((1, 2, 3), 49.0),
        ((0, 1, 2, 3), 58.0),
    ]
    ranked = Ranked((best, *(a_set(members, nats) for members, nats in sets)))
    left = {one.members for one in _comparable(ranked, best, 5.0).sets}
    assert left == {(0, 1), (0,), (0, 1, 2), (0, 1, 2, 3)}


def test_sets_that_lost_narrowly_are_told_with_their_places():
    fits = SimpleNamespace(places=lambda fit: fit.places)
    compared = Comparison(fits, SimpleNamespace(members=()))
    for members, nats in {(0,): 50.0, (1,): 48.0, (0, 1): 54.0, (): 10.0}.items():
        compared._fits[members] = SimpleNamespace(members=members, evidence=nats, places=len(members))
    assert compared.near(SimpleNamespace(members=(0,)), 3.0) == {(1,): 1, (0, 1): 2}
    assert compared.near(SimpleNamespace(members=(2,)), 3.0) == {}


def test_effects_that_may_still_be_causes_are_those_of_likely_sets():
    ranked = Ranked((a_set((4,), 100.0), a_set((1, 5), 90.0), a_set((7,), -1e6)))
    assert _live(ranked, (2,)) == [2, 4, 1, 5]
    many = Ranked(tuple(a_set((2 * k, 2 * k + 1), 100.0 - k) for k in range(40)))
    live = _live(many, ())
    assert len(live) == 24
    assert live == list(range(24))


def bias(target, unit):
    return Effect(f"bias[{target}]", unit=unit, neutral=0.0, bounds=(-1.0, 1.0))


def test_what_a_law_leaves_of_a_set_is_fitted_anew(monkeypatch):
    """Drag is worth nothing beside the law; the shift is then what a fit has it to be, whatever slopes and laws say."""
    effects, members = (SHIFT, DRAG), (0, 1)

    def gram(*modes):
        products = 1e6 * np.eye(2)
        return Gram(products, products @ np.array(modes), np.zeros(2))

    fits = SimpleNamespace(
        space=None,
        effects=effects,
        priors=priors_of(effects),
        power=1.0,
        of=lambda kept, places, near: SimpleNamespace(members=tuple(kept), begun=places, fitted=None),
    )
    laws = iter([gram(-0.7, 0.0), None])
    monkeypatch.setattr(causes, "gram_of", lambda *_: SimpleNamespace(gram=gram(-0.6, 0.2)))
    monkeypatch.setattr(causes, "beside_laws", lambda *_: next(laws))
    monkeypatch.setattr(causes, "_slopes", lambda *_: None)
    left = _without_stand_ins(fits, SimpleNamespace(members=members, fitted=None), None, np.log(100))
    assert left.members == (0,)
    assert left.begun == pytest.approx([-0.7], abs=1e-3)


def test_sensors_that_were_not_read_have_no_effects_and_biases_of_odd_units_are_shares_of_a_spread():
    names = ("x", "y", "z")
    mask = np.ones((2, 3, 3), dtype=bool)
    mask[..., 1] = False
    mask[0, :, 2] = False
    space = SimpleNamespace(
        mask=mask, spread=np.array([2.0, 3.0, 4.0]), simulator=SimpleNamespace(residual_names=names)
    )
    effects = [bias("x", "V"), bias("y", "V"), bias("z", "m"), DRAG]
    assert [one.name for one in readable(space, effects)] == ["bias[x]", "bias[z]", "drag"]
    biases = typical_biases(space, [*effects, bias("elsewhere", "V")])
    assert set(biases) == {"bias[x]", "bias[y]"}
    assert biases["bias[y]"] / biases["bias[x]"] == pytest.approx(1.5)


def test_families_are_of_targets_and_not_of_what_stands_for_all():
    effects = [
        Effect(name, unit="1", neutral=0.0, bounds=(-1.0, 1.0))
        for name in ("damping[all]", "damping[a]", "drag", "damping[b]", "mass[a]")
    ]
    assert families_of(effects) == {"damping": [1, 3], "mass": [4]}


# -- the posterior ---------------------------------------------------------------------------------------------------


def found(probabilities=None, aliases=None):
    gram = gram_with(0.9)
    effects = tuple(Effect(name, unit="1", neutral=0.0, bounds=(-5.0, 5.0)) for name in "abc")
    sets = tuple(
        sorted((weigh(gram, PRIORS, m) for m in ((0, 2), (1, 2), (0, 1, 2))), key=lambda one: -one.evidence)
    )
    ranked = Ranked(sets)
    best = sets[0]
    known = {name: ranked.probability(place) for place, name in enumerate("abc")} | (probabilities or {})
    return SimpleNamespace(
        ranked=ranked,
        gram=gram,
        priors=PRIORS,
        effects=effects,
        best=best,
        values={"abc"[one]: 0.0 for one in best.members},
        probabilities=known,
        aliases=aliases or {},
    )


def test_the_posterior_of_a_search_has_its_sets_by_their_probabilities():
    search = found()
    posterior = Posterior.of(search)
    assert sum(one.probability for one in posterior.sets) == pytest.approx(1.0)
    assert np.all(np.diff([one.probability for one in posterior.sets]) <= 0)
    assert posterior.sets[0].names == ("a", "c")
    for one, weighed in zip(posterior.sets, search.ranked.sets):
        np.testing.assert_allclose(one.covariance @ weighed.curvature, np.eye(len(one.names)), atol=1e-9)
        np.testing.assert_allclose(one.mean, weighed.values)
        assert list(one.values.values()) == pytest.approx(one.mean)
    assert all(one.probability >= 1e-3 for one in posterior.sets)


def test_sets_that_are_less_likely_than_one_in_a_thousand_are_left_out():
    search = found()
    search.ranked = Ranked(
        (a_set((0, 2), 50.0), a_set((1, 2), 50.0 - np.log(500)), a_set((0,), 50.0 - np.log(2000)))
    )
    search.values = {}
    posterior = Posterior.of(search)
    assert [one.names for one in posterior.sets] == [("a", "c"), ("b", "c")]
    assert [one.probability for one in posterior.sets] == pytest.approx([500 / 501, 1 / 501])
    np.testing.assert_array_equal(posterior.sets[0].mean, np.zeros(2))
    assert posterior.sets[0].values == {"a": 0.0, "c": 0.0}


def test_values_that_are_drawn_stay_within_bounds():
    effect = Effect("gain", unit="1", neutral=1.0, bounds=(0.5, 2.0))
    one = CauseSet(("gain",), 1.0, {"gain": 1.9}, np.array([np.log(1.9)]), np.array([[0.25]]))
    draws = np.array([draw["gain"] for draw in Posterior((one,), (effect,)).sample(400, 0)])
    assert (draws.min(), draws.max()) == (0.5, 2.0)
    inside = draws[(draws > 0.5) & (draws < 2.0)]
    # Factors are drawn on the logarithm: as far below as the bound cuts off above.
    assert np.mean(draws == 2.0) == pytest.approx(stats.norm.sf(np.log(2 / 1.9) / 0.5), abs=0.06)
    assert np.median(draws) == pytest.approx(1.9, abs=0.2)
    assert len(inside) > 100


def test_draws_are_of_sets_by_their_probability_with_values_of_their_law(tmp_path):
    search = found({"a": 0.6}, {"a": (("b", 0.4),)})
    posterior = Posterior.of(search)
    draws = posterior.sample(1500, 0)
    for one in posterior.sets:
        own = np.array([list(draw.values()) for draw in draws if tuple(draw) == one.names])
        assert len(own) / 1500 == pytest.approx(one.probability, abs=0.04)
        if len(own) > 500:
            np.testing.assert_allclose(
                own.mean(axis=0), one.mean, atol=5 * np.sqrt(one.covariance.max() / len(own))
            )
            np.testing.assert_allclose(
                np.cov(own.T), one.covariance, rtol=0.25, atol=0.1 * one.covariance.max()
            )
    assert posterior.sample(3, 1) == posterior.sample(3, 1)
    nothing = Posterior(
        (SimpleNamespace(names=(), probability=1.0, mean=np.zeros(0), covariance=np.eye(0)),), ()
    )
    assert nothing.sample(2) == [{}, {}]
    path = posterior.to_randomization(tmp_path / "draws.json", n=5, random_state=3)
    content = json.loads(path.read_text())
    assert content["draws"] == posterior.sample(5, 3)
    assert len(json.loads(posterior.to_randomization(path, force=True).read_text())["draws"]) == 100
    with pytest.raises(FileExistsError):
        posterior.to_randomization(path)


def a_family(members, common):
    """Return a weigher of a family's members and of all of it, its fifth effect, of responses of these sizes."""
    N = np.zeros((400, 5))
    for one in range(4):
        N[100 * one : 100 * (one + 1), one] = 1.0
    N[:, 4] = 1.0
    z = N[:, :4] @ np.asarray(members, float) + common + np.random.default_rng(0).normal(size=400)
    effects = [Effect(f"drag[{one}]", unit="1", neutral=0.0, bounds=(0, 50), typical=1.0) for one in "abcd"]
    effects.append(Effect("drag[all]", unit="1", neutral=0.0, bounds=(0, 50), typical=1.0))
    worth = Weigher(Gram(N.T @ N, N.T @ z, np.zeros(5)), priors_of(effects), rivals_of(effects))
    return search(worth, families=families_of(effects)).sets[0].members, worth


@pytest.mark.parametrize(
    ("members", "common", "best"),
    [((0, 0, 0, 0), 2.0, (4,)), ((1, 2, 3, 4), 0.0, (0, 1, 2, 3)), ((0, 3, 3, 3), 1.0, (0, 1, 2, 3))],
)
def test_all_of_a_family_is_apart_as_soon_as_its_members_differ(members, common, best):
    found, worth = a_family(members, common)
    assert found == best
    assert all(worth.allows(one) for one in worth.seen)


def test_what_stands_for_all_excludes_each_of_its_family():
    effects = [
        Effect(name, unit="1", neutral=0.0, bounds=(0, 1))
        for name in ("drag[a]", "drag[all]", "delay[action]", "delay[a]", "wind[x]", "drag[b]")
    ]
    assert rivals_of(effects) == {1: [0, 5], 0: [1], 5: [1], 2: [3], 3: [2]}
    assert families_of(effects) == {"drag": [0, 5], "delay": [3], "wind": [4]}
