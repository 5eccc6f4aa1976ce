"""Fits of sets of causes: going on from one loses nothing, chains go their own ways, sets are compared by both fits."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from skat.diagnosis.causes import Comparison, _first_guess
from skat.diagnosis.evidence import Weighed, Weigher
from skat.diagnosis.fits import Fit, Fits, _lowest
from skat.diagnosis.fitting import Fitted, _blocks, _run_freely, priors_of, settled
from skat.diagnosis.statespace import linearise, of_chains, state_space, with_chains
from skat.simulators import MujocoSimulator
from tests.diagnosis import pendulum

SIMULATOR = MujocoSimulator(pendulum.NOMINAL, frame_skip=pendulum.FRAME_SKIP)
BALL = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom type="plane" size="1 1 .1" solref="-40000 -2"/>
    <body pos="0 0 .05">
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom type="sphere" size=".05" mass=".1" solref="-40000 -2"/>
    </body>
  </worldbody>
</mujoco>
"""
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
    return fits.first()


def bouncing():
    """Return the state space of a ball that bounces, measured with noise, in chains of 64 rows."""
    model = mujoco.MjModel.from_xml_string(BALL)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    states = []
    for height in (0.3, 0.5):
        mujoco.mj_resetData(model, data)
        data.qpos[0] = height
        for _ in range(128):
            states.append([data.qpos[0], data.qvel[0]])
            mujoco.mj_step(model, data, nstep=5)
    states = np.array(states) + rng.normal(scale=(0.02, 0.4), size=(len(states), 2))
    last = np.arange(len(states)) % 128 == 127
    before, after = states[~last], states[np.roll(~last, 1)]
    simulator = MujocoSimulator(BALL, frame_skip=5)
    return state_space(simulator, before, after, np.repeat([0, 1], 127), consecutive=True, chain_length=64)


def a_fit(members, evidence, error=100.0):
    """Return a fit of which only members and evidence matter, and how much of that may be another path's."""
    return Fit(members, {}, SimpleNamespace(losses=np.array([error])), evidence, np.zeros(len(members)))


class Told:
    """Fits of which the evidence of each set is told: with the slopes of the present set, of another, and its own."""

    def __init__(self, error=100.0, **evidences):
        self.error = error
        self.evidences = {tuple(map(int, name[1:])): told for name, told in evidences.items()}

    def places(self, fit):
        return np.zeros(len(fit.members))

    def of(self, members, places, near, own_slopes=True):
        evidence = 1 if own_slopes else self.evidences[tuple(members)][near.evidence]
        return a_fit(members, evidence, self.error)


def compared(now, error=100.0, **evidences):
    """Return sets beside a present one; ``s01=(1.0, 2.0)`` is {0, 1}, with its slopes and with those of the other."""
    return Comparison(Told(error, **evidences), a_fit(now, 0, error))


def a_set(members):
    return Weighed(members, np.zeros(len(members)), 0.0, 0.0, np.eye(len(members)))


def test_more_names_must_be_worth_what_they_need():
    assert compared((), s=(0,), s0=(6,)).gain((0,), np.zeros(1)) == 6
    assert compared((), s=(0,), s0=(6,)).prefers((0,), np.zeros(1), 5.0)
    assert not compared((), s=(0,), s0=(5,)).prefers((0,), np.zeros(1), 5.0)
    assert compared((0,), s=(0,), s0=(4,)).prefers((), np.zeros(0), 5.0)
    assert not compared((0,), s=(0,), s0=(5,)).prefers((), np.zeros(0), 5.0)
    assert compared((0,), s0=(0,), s1=(1,)).prefers((1,), np.zeros(1), 5.0)
    assert not compared((0,), s0=(0,), s1=(0,)).prefers((1,), np.zeros(1), 5.0)


@pytest.mark.parametrize(("theirs", "own", "is_taken"), [(6, 106, True), (6, 104, False), (4, 106, False)])
def test_more_names_are_taken_if_the_slopes_of_either_set_prefer_them(theirs, own, is_taken):
    taken = compared((), s=(0, 100), s0=(theirs, own)).taken(a_set((0,)), 5.0)
    assert (taken is not None) is is_taken


@pytest.mark.parametrize(("theirs", "own", "is_taken"), [(4, 106, True), (6, 104, True), (6, 106, False)])
def test_fewer_names_are_taken_if_the_slopes_of_one_set_prefer_them(theirs, own, is_taken):
    taken = compared((0,), s=(0, 100), s0=(theirs, own)).taken(a_set(()), 5.0)
    assert (taken is not None) is is_taken


def test_a_set_that_its_own_fit_contradicts_is_not_taken():
    # One name more needs 5 nats; fits of their own have 1 between them, and of each so much may be another path's.
    assert compared((), 2.1, s=(0, 100), s0=(6, 106)).taken(a_set((0,)), 5.0) is not None
    assert compared((), 1.9, s=(0, 100), s0=(6, 106)).taken(a_set((0,)), 5.0) is None
    assert compared((0,), 0.0, s0=(0, 100), s1=(1, 101)).taken(a_set((1,)), 0.0) is not None


def test_sets_with_the_slopes_of_another_fit_differ_as_fits_of_their_own_do(fits, nothing):
    damped = fits.of((0,), np.array([0.1]), nothing)
    gravity = fits.of((1,), np.array([0.0]), nothing)
    for look in (damped, nothing):
        both = Comparison(fits, damped, look)
        # Of 350 nats.
        assert both.gain((), np.zeros(0)) == pytest.approx(nothing.evidence - damped.evidence, abs=5.0)
        assert both.gain((1,), np.zeros(1)) == pytest.approx(gravity.evidence - damped.evidence, abs=5.0)


def test_a_first_guess_is_tried_where_it_is_likelier_as_it_is_than_nothing_and_than_what_slopes_propose(
    fits, nothing
):
    worth = Weigher(fits.gram(nothing.fitted, (0, 1)), fits.priors)

    def guess(value, *proposals):
        values = {} if value is None else {"damping[hinge]": value}
        sets = [replace(worth((0,)), values=np.array([one])) for one in proposals]
        return [tuple(one.values) for one in _first_guess(values, worth, fits, nothing, sets, 4.6)]

    # The pendulum's damping is larger by .1.
    neutral = fits.effects[0].neutral
    assert guess(neutral + 0.1) == guess(neutral + 0.1, 1.0) == [(pytest.approx(0.1),)]
    assert guess(None) == guess(neutral + 3.0) == []
    assert guess(neutral + 0.13, 0.1, 3.0) == []


def test_forces_are_given_no_memory_where_none_is_looked_for(space, nothing):
    assert len(settled(space, {}, None, np.zeros(space.d)).shares)
    bare = settled(space, {}, None, np.zeros(space.d), memories=False)
    assert not len(bare.shares)
    assert not len(settled(space, {}, bare, np.zeros(space.d), own_slopes=False, memories=False).shares)
    kept = settled(space, {}, nothing.fitted, np.zeros(space.d), own_slopes=False, memories=False)
    assert len(kept.shares) == len(nothing.fitted.shares)


def test_a_chain_runs_freely_where_that_is_likelier(space):
    fitted = settled(space, {"damping[hinge]": 0.1}, None, np.zeros(space.d))
    n_states = space.measured.shape[-1]
    wrong = fitted.linear.path + np.random.default_rng(0).normal(scale=0.05, size=fitted.linear.path.shape)
    wrong[:, 0] = fitted.linear.path[:, 0]
    spoilt = replace(
        fitted,
        linear=linearise(space, wrong, fitted.values, fitted.estimate.smoothed.covariances),
        estimate=replace(
            fitted.estimate,
            smoothed=replace(fitted.estimate.smoothed, means=np.zeros_like(fitted.estimate.smoothed.means)),
        ),
        losses=np.where(np.arange(len(space.real)) == 0, 1.0, 0.0),
    )
    gain, mended = _run_freely(space, spoilt)
    assert gain > 0
    # Only the chain that is restless was tried, and it obeys the model in each of its rows.
    changed = np.any(mended.linear.path != wrong, axis=(1, 2))
    assert changed.tolist() == [True] + [False] * (len(changed) - 1)
    first = space.places[0] == 0
    ends = space.simulator.predict(space.rows(mended.linear.path)[first], effects=fitted.values)
    np.testing.assert_allclose(ends[:, :n_states], space.path_ends(mended.linear.path)[first], atol=1e-9)


def test_a_fit_of_long_chains_ends_early_where_something_hits_and_nowhere_else(space, monkeypatch):
    turns = []

    def counted(*args, **options):
        turns.append(None)
        return linearise(*args, **options)

    monkeypatch.setattr("skat.diagnosis.fitting.linearise", counted)

    def fitted(space, patience):
        turns.clear()
        fit = settled(space, {}, None, np.zeros(space.d), patience=patience)
        return fit, len(turns)

    (whole, most), (ended, least) = (fitted(bouncing(), patience) for patience in (np.inf, 5.0))
    assert min(whole.restless, ended.restless) > 5.0
    assert least < most
    (whole, most), (ended, least) = (fitted(space, patience) for patience in (np.inf, 5.0))
    assert (ended.bound, least) == (whole.bound, most)


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
    back = fits.of((), np.zeros(0), low)
    assert back.members == ()
    assert back.evidence == pytest.approx(nothing.evidence, abs=0.5)


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
