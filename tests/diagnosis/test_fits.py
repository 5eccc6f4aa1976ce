"""Fits of sets of causes: going on from one loses nothing, chains go their own ways, sets are compared by both fits."""

from dataclasses import replace

import numpy as np
import pytest

from skat.diagnosis.causes import Seen
from skat.diagnosis.fits import Fit, Fits, _lowest
from skat.diagnosis.fitting import Fitted, _blocks, priors_of, settled
from skat.diagnosis.statespace import linearise, of_chains, state_space, with_chains
from skat.simulators import MujocoSimulator
from tests.diagnosis import pendulum

SIMULATOR = MujocoSimulator(pendulum.NOMINAL, frame_skip=pendulum.FRAME_SKIP)
HEAVIER = pendulum.TEXT.format(damping=0.15)


@pytest.fixture(scope="module")
def space():
    """A log of a pendulum that is damped more than the model says."""
    return pendulum.laid_out(SIMULATOR, *pendulum.measured(HEAVIER, 0, rows=125))


@pytest.fixture(scope="module")
def fits(space):
    offered = {effect.name: effect for effect in SIMULATOR.effects()}
    effects = offered["damping[hinge]"], offered["gravity"]
    return Fits(space, effects, priors_of(effects), np.zeros(space.d), None, 1.0)


@pytest.fixture(scope="module")
def nothing(fits):
    """The fit of no cause that all others begin at."""
    return fits.first()[-1]


def a_fit(members, evidence):
    """Return a fit of which only members and evidence matter."""
    return Fit(members, {}, None, evidence, np.zeros(len(members)))


def seen(**evidences):
    """Return what was seen of sets, ``s01=(1.0, 2.0)`` of members 0 and 1."""
    return Seen.of(
        [
            a_fit(tuple(int(one) for one in name[1:]), evidence)
            for name, both in evidences.items()
            for evidence in both
        ]
    )


def test_a_larger_set_must_be_worth_its_names_in_every_fit_and_more_than_fits_of_one_set_differ():
    clear = seen(s=(0.0, 3.0), s0=(12.0, 13.0))
    assert clear.spread == 3.0
    assert clear.better((0,), (), 5.0)
    assert not clear.better((), (0,), 5.0)
    # 12 is not 5 + 5 more than 3.
    torn = seen(s=(-2.0, 3.0), s0=(12.0, 13.0))
    assert not torn.better((0,), (), 5.0)
    # What is not worth its name in one fit is left: 13 against 12 - 5.
    assert seen(s=(9.0,), s0=(12.0, 13.0)).better((), (0,), 5.0)


def test_of_two_sets_of_one_size_neither_is_better_where_fits_of_one_differ_by_as_much():
    near = seen(s0=(0.0, 4.0), s1=(6.0, 7.0))
    assert not near.better((1,), (0,), 5.0)
    assert not near.better((0,), (1,), 5.0)
    assert seen(s0=(3.0, 4.0), s1=(6.0, 7.0)).better((1,), (0,), 5.0)


def test_only_the_last_two_fits_of_a_set_count():
    several = seen(s0=(-500.0, 10.0, 11.0))
    assert (several.least((0,)), several.most((0,)), several.spread) == (10.0, 11.0, 1.0)


def test_going_on_from_a_fit_that_rests_loses_nothing(space):
    first = settled(space, {}, None, np.zeros(space.d))
    second = settled(space, {}, first, np.zeros(space.d))
    assert second.bound > first.bound - 0.1
    assert second.restless < 0.1
    assert isinstance(second, Fitted)


def test_a_fit_is_known_to_no_better_than_its_most_restless_chain_loses(space):
    fitted = settled(space, {}, None, np.zeros(space.d))
    restless = replace(fitted, losses=np.array([0.0, 7.0, 2.0]))
    assert _lowest(restless) == pytest.approx(_lowest(replace(fitted, losses=np.zeros(3))) - 7.0)


def test_a_set_is_fitted_to_where_its_slopes_move_it_no_more(fits, nothing):
    # Begun far away, on either side.
    low, high = (fits.of((0,), np.array([place]), nothing) for place in (0.02, 0.4))
    assert low.values["damping[hinge]"] == pytest.approx(high.values["damping[hinge]"], abs=1e-4)
    assert low.values["damping[hinge]"] == pytest.approx(0.15 - 0.05, abs=0.01)
    assert low.evidence == pytest.approx(high.evidence, abs=0.2)
    assert low.evidence > nothing.evidence + 100
    back = fits.without(low, {0})
    assert back.members == ()
    assert back.evidence == pytest.approx(nothing.evidence, abs=0.5)


def test_a_fit_that_cannot_be_what_is_wanted_ends_early(fits, nothing, monkeypatch):
    turns = []
    monkeypatch.setattr("skat.diagnosis.fits.settled", lambda *a, **k: turns.append(a) or settled(*a, **k))
    whole = fits.of((1,), np.array([0.3]), nothing)
    n_whole = len(turns)
    short = fits.of((1,), np.array([0.3]), nothing, whole.evidence + 1e6)
    assert len(turns) - n_whole < n_whole
    assert short.evidence <= whole.evidence + 0.1


def test_a_set_that_is_far_off_is_told_by_the_slopes_of_another_and_one_that_is_not_gets_its_own(
    fits, nothing
):
    damped = fits.of((0,), np.array([0.1]), nothing)
    gravity = fits.of((1,), np.array([0.0]), nothing)
    wanted = damped.evidence - 5.0
    far = fits.without(damped, {0}, wanted)
    assert far.hopeless
    # Slopes that belong to the damping tell what sets without it are worth, of 350 nats less.
    assert far.evidence == pytest.approx(nothing.evidence, abs=5.0)
    other = fits.of((1,), np.array([0.0]), damped, wanted)
    assert other.hopeless
    assert other.evidence == pytest.approx(gravity.evidence, abs=5.0)
    assert not fits.without(damped, {0}, nothing.evidence - 5.0).hopeless
    assert not fits.without(damped, {0}).hopeless
    assert not fits.of((0,), np.array([0.1]), nothing, wanted).hopeless


@pytest.mark.parametrize("members", [(0,), ()])
def test_with_the_slopes_of_another_fit_a_fit_takes_none(fits, nothing, members, monkeypatch):
    asked = []

    def counted(*args, **options):
        asked.append(options.get("slopes") is None)
        return linearise(*args, **options)

    monkeypatch.setattr("skat.diagnosis.fitting.linearise", counted)
    values = {fits.effects[one].name: 0.1 for one in members}
    settled(fits.space, values, nothing.fitted, fits.floor, own_slopes=False)
    assert asked
    assert not any(asked)


def test_chains_are_taken_out_and_put_back_as_they_were(space):
    linear = linearise(space, space.measured, {})
    chosen = np.arange(len(space.real)) % 2 == 0
    part = of_chains(space, linear, chosen)
    own = linearise(space.part(chosen), space.measured[chosen], {})
    np.testing.assert_allclose(part.chains.transitions, own.chains.transitions, atol=1e-9)
    np.testing.assert_allclose(part.outputs, own.outputs, atol=1e-12)
    whole = with_chains(space, linear, own, chosen)
    np.testing.assert_allclose(whole.chains.drive, linear.chains.drive, atol=1e-12)
    np.testing.assert_allclose(whole.outputs, linear.outputs, atol=1e-12)


def test_blocks_of_time_are_as_long_in_short_chains_as_in_long_ones():
    log = pendulum.measured(HEAVIER, 0, rows=1000, episodes=2)
    for length in (64, 4):
        short = state_space(SIMULATOR, *log, consecutive=True, chain_length=length)
        blocks = _blocks(short)
        assert blocks.shape == (len(short.real), short.real.shape[1] + 1)
        sizes = np.bincount(np.unique(blocks[:, :-1][short.real], return_inverse=True)[1])
        assert 20 <= np.median(sizes) <= 32
        assert np.all(np.diff(blocks[short.places]) >= 0)
