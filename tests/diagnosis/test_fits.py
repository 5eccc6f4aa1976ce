"""Fits of sets of causes: the same wherever they are begun; sets are compared by the slopes of both."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from skat.diagnosis import fitting
from skat.diagnosis.causes import Comparison, _again, _as_one, _first_guess, _likeliest, _unbent
from skat.diagnosis.evidence import Weighed, Weigher
from skat.diagnosis.fits import Fit, Fits
from skat.diagnosis.fitting import (
    FORCE_TURNS,
    Known,
    _blocks,
    bent_rows,
    compared,
    first_fit,
    gram_of,
    hits,
    next_fit,
    nominal_look,
    priors_of,
    slopes_of,
)
from skat.diagnosis.search import rivals_of
from skat.diagnosis.statespace import state_space
from skat.effects import Effect
from skat.simulators import FunctionSimulator, MujocoSimulator
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
STIFF = """
<mujoco>
  <option timestep="0.004" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body>
      <joint name="rail" type="slide" axis="1 0 0"/>
      <geom size=".1" mass="1"/>
    </body>
  </worldbody>
  <actuator><position name="drive" joint="rail" kp="4000" kv="400"/></actuator>
</mujoco>
"""
predict = SIMULATOR.predict_many
HEAVIER = pendulum.TEXT.format(damping=0.15)


@pytest.fixture(scope="module")
def space():
    """A log of a pendulum that is damped more than the model says."""
    return pendulum.laid_out(SIMULATOR, *pendulum.measured(HEAVIER, 0, rows=125))


@pytest.fixture(scope="module")
def fits(space):
    offered = {effect.name: effect for effect in SIMULATOR.effects()}
    effects = offered["damping[hinge]"], offered["gravity"]
    return Fits(space, effects, priors_of(effects), Known(), 1.0)


@pytest.fixture(scope="module")
def nothing(fits):
    """The fit of no cause that all others begin at."""
    return fits.first()


def bouncing(chain_length=64, hidden=()):
    """Return the state space of a ball that bounces, measured with noise, and that without some of its states."""
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
    states[:, list(hidden)] = np.nan
    last = np.arange(len(states)) % 128 == 127
    before, after = states[~last], states[np.roll(~last, 1)]
    simulator = MujocoSimulator(BALL, frame_skip=5)
    return state_space(
        simulator, before, after, np.repeat([0, 1], 127), consecutive=True, chain_length=chain_length
    )


def a_fit(members, evidence):
    """Return a fit of which only members and evidence matter."""
    return Fit(members, {}, None, evidence, np.zeros(len(members)))


class Told:
    """Fits of which the evidence of each set is told: with the slopes of the present set, of another, and its own."""

    def __init__(self, own=50.0, bent=True, **evidences):
        self.own, self.bent, self.guesses = own, bent, []
        self.evidences = {tuple(map(int, name[1:])): told for name, told in evidences.items()}

    def places(self, fit):
        return np.zeros(len(fit.members))

    def of(self, members, places, near, own_slopes=True, guessed=True):
        if own_slopes:
            return a_fit(members, self.own)
        self.guesses += [members] if guessed else []
        return a_fit(members, self.evidences[tuple(members)][near.evidence != 0])

    def bends(self, fit):
        return self.bent

    def about(self, members, places, near):
        return a_fit(members, self.own)


def beside(now, own=50.0, bent=True, **evidences):
    """Return sets beside a present one; ``s01=(1.0, 2.0)`` is {0, 1}, with its slopes and with those of the other."""
    return Comparison(Told(own, bent, **evidences), a_fit(now, 0))


def a_set(members):
    return Weighed(members, np.zeros(len(members)), 0.0, 0.0, np.eye(len(members)))


def test_more_names_must_be_worth_what_they_need():
    assert beside((), s=(0,), s0=(6,)).gain((0,), np.zeros(1)) == 6
    assert beside((), s=(0,), s0=(6,)).prefers((0,), np.zeros(1), 5.0)
    assert not beside((), s=(0,), s0=(5,)).prefers((0,), np.zeros(1), 5.0)
    for told in ((4, 109), (9, 104)):
        assert beside((0,), s=(0, 100), s0=told).prefers((), np.zeros(0), 5.0)
    assert not beside((0,), s=(0, 100), s0=(5, 105)).prefers((), np.zeros(0), 5.0)
    assert beside((0,), s0=(0,), s1=(1,)).prefers((1,), np.zeros(1), 5.0)
    assert not beside((0,), s0=(0,), s1=(0,)).prefers((1,), np.zeros(1), 5.0)


@pytest.mark.parametrize(("theirs", "own", "is_taken"), [(6, 106, True), (6, 104, False), (4, 106, False)])
def test_more_names_are_taken_if_the_slopes_of_either_set_prefer_them(theirs, own, is_taken):
    taken = beside((), s=(0, 100), s0=(theirs, own)).taken((0,), np.zeros(1), 5.0)
    assert (taken is not None) is is_taken


@pytest.mark.parametrize(("theirs", "own", "is_taken"), [(4, 106, True), (6, 104, True), (6, 106, False)])
def test_fewer_names_are_taken_if_the_slopes_of_one_set_prefer_them(theirs, own, is_taken):
    taken = beside((0,), s=(0, 100), s0=(theirs, own)).taken((), np.zeros(0), 5.0)
    assert (taken is not None) is is_taken


def test_only_values_that_no_fit_has_found_are_guesses():
    compared = beside((0,), s0=(0, 100), s1=(9, 104))
    compared.gains((1,), np.zeros(1))
    assert compared.fits.guesses == [(1,)]


def test_a_set_that_its_own_fit_contradicts_is_not_taken():
    # One name more needs 5 nats, and fits of their own have so many between them.
    assert beside((), 6, s=(0, 100), s0=(6, 106)).taken((0,), np.zeros(1), 5.0) is not None
    assert beside((), 4, s=(0, 100), s0=(6, 106)).taken((0,), np.zeros(1), 5.0) is None
    assert beside((0,), 1, s0=(0, 100), s1=(1, 101)).taken((1,), np.zeros(1), 0.0) is not None


def test_rivals_are_the_sets_that_were_fitted_by_the_slopes_of_either():
    compared = beside((0,), s0=(0, 100), s1=(-6, 102), s01=(-19, 100), s2=(-4, 96))
    for members in [(0, 1), (1,)]:
        compared.fit(members, np.zeros(len(members)))
    # Of one that is hardly possible the slopes of the present set are enough; what was not fitted is none.
    assert {one.members: one.gain for one in compared.rivals()} == {(1,): -2.0, (0, 1): -19.0}


def test_a_rival_that_was_not_taken_is_no_likelier_than_its_own_fit_found_it():
    compared = beside((0,), 4, s0=(0, 100), s12=(2000, 101))
    assert compared.taken((1, 2), np.zeros(2), 5.0) is None
    assert [one.gain for one in compared.rivals()] == [1.0]


def test_a_set_that_lost_narrowly_is_asked_for_again_beside_the_one_that_won():
    near = {(0,): np.zeros(1), (1,): np.zeros(1), (2,): np.zeros(1)}
    compared = beside((0,), s0=(0, 100), s1=(-1, 98), s2=(6, 108))
    assert _again(compared, near, (), 0.0).members == (2,)
    assert _again(compared, {(1,): np.zeros(1)}, (), 0.0) is None
    # Not one with what was seen to be held at a bound.
    assert _again(compared, near, (2,), 0.0) is None
    assert [one.members for one in compared.rivals()] == [(1,), (2,)]


def test_what_acts_alike_but_where_something_hits_is_alike():
    """Weight and push, whose slopes are taken over a very little and over less little of what hits."""
    space = bouncing()
    effects = tuple(one for one in space.simulator.effects() if one.name in ("gravity", "wind[z]"))
    fits = Fits(space, effects, priors_of(effects), Known(), 1.0)
    now = fits.first()
    slopes = slopes_of(space, now.fitted, effects, fits.priors.scales)
    slopes[bent_rows(space, now.fitted), :, 1] *= -1e3
    assert gram_of(space, now.fitted, slopes, effects).gram.cosines(0)[1] < 0.9
    assert _unbent(fits, now, slopes).cosines(0)[1] == pytest.approx(1.0, abs=1e-3)


def test_sets_are_compared_by_the_slopes_of_either():
    assert beside((0,), s0=(0, 100), s1=(-6, 102)).gains((1,), np.zeros(1)) == (-6, 2)
    # Where no row is bent those of one do.
    assert beside((0,), bent=False, s0=(0, 100), s1=(-6, 102)).gains((1,), np.zeros(1)) == (-6, -6)
    # And of a set far behind those of the present one.
    assert beside((0,), s0=(0, 100), s1=(-101, 102)).gains((1,), np.zeros(1)) == (-101, -101)
    assert beside((0,), s0=(0, 100), s1=(-99, 102)).gains((1,), np.zeros(1)) == (-99, 2)


@pytest.mark.parametrize(
    ("promised", "taken"),
    [
        # Slopes promise 40 of the first, fits find 20: the second, of which they promise 30, is worth 26.
        ({(0,): 40.0, (1,): 30.0, (2,): 15.0}, (1,)),
        # They promise less of it than the first was found to be worth: it is not asked.
        ({(0,): 40.0, (1,): 19.0, (2,): 15.0}, (0,)),
        # Two names must be worth another five.
        ({(0,): 40.0, (1, 2): 40.0}, (0,)),
    ],
)
def test_the_set_that_fits_like_best_is_taken_of_those_that_promise_more_than_was_found(promised, taken):
    compared = beside((), s=(0, 100), s0=(20, 120), s1=(26, 126), s2=(10, 110), s12=(24, 124))
    asked = [replace(a_set(members), evidence=nats) for members, nats in promised.items()]
    assert _likeliest(compared, a_set, asked, 5.0).members == taken
    assert (2,) not in compared._fits


def test_where_fits_find_nothing_no_set_is_taken():
    compared = beside((), s=(0, 100), s0=(4, 104))
    assert _likeliest(compared, a_set, [replace(a_set((0,)), evidence=40.0)], 5.0) is None


@pytest.mark.parametrize(("values", "one"), [((1.2, 1.2), True), ((1.2, 1.3), False)])
def test_members_of_a_family_are_one_cause_where_the_log_is_likelier_so(values, one):
    names = ("gain[a]", "gain[b]", "gain[all]")
    effects = tuple(Effect(name, unit="1", neutral=1.0, bounds=(0.0, 2.0), typical=0.3) for name in names)

    def law(X, **values):
        a, b, every = (values[name] for name in names)
        return X @ np.diag([a, b]) * every

    simulator = FunctionSimulator(law, input_names=("p", "q"), output_names=("y", "z"), effects=effects)
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200, 2))
    y = X * values + 0.1 * rng.normal(size=(200, 2))
    space = state_space(simulator, X, y, np.arange(200), consecutive=False)
    fits = Fits(space, effects, priors_of(effects), Known(), 1.0)
    both = fits.of((0, 1), np.full(2, 0.1), fits.first())
    worth = Weigher(fits.gram(both.fitted, range(3)), fits.priors, rivals_of(effects))
    found = _as_one(Comparison(fits, both), worth, rivals_of(effects))
    assert (None if found is None else found.members) == ((2,) if one else None)
    if one:
        assert found.values["gain[all]"] == pytest.approx(1.2, abs=0.02)


def test_sets_with_the_slopes_of_another_fit_differ_as_fits_of_their_own_do(fits, nothing):
    damped = fits.of((0,), np.array([0.1]), nothing)
    gravity = fits.of((1,), np.array([0.0]), nothing)
    for look in (damped, nothing):
        both = Comparison(fits, damped, look)
        # Of 350 nats.
        assert both.gain((), np.zeros(0)) == pytest.approx(nothing.evidence - damped.evidence, abs=5.0)
        assert both.gain((1,), np.zeros(1)) == pytest.approx(gravity.evidence - damped.evidence, abs=5.0)


def test_a_search_goes_on_from_a_first_guess_that_is_likelier_as_it_is_than_nothing(fits, nothing):
    # The pendulum's damping is larger by .1.
    neutral = fits.effects[0].neutral
    found = _first_guess({"damping[hinge]": neutral + 0.13}, fits, nothing, 4.6, None)
    assert found.members == (0,)
    assert found.values["damping[hinge]"] == pytest.approx(neutral + 0.1, abs=0.01)
    assert _first_guess({}, fits, nothing, 4.6, None) is None
    assert _first_guess({"damping[hinge]": neutral + 3.0}, fits, nothing, 4.6, None) is None
    assert _first_guess({"damping[hinge]": neutral + 0.13}, fits, nothing, 1e4, None) is None
    assert _first_guess({"damping[hinge]": neutral + 0.13}, fits, nothing, 4.6, 0) is None


def test_a_set_is_weighed_about_a_path_of_its_own():
    """About that of no friction the friction that is there seems to be worth fourteen nats more than it is."""
    law = lambda q, v, t, rng: rng.normal(scale=0.05) - 0.5 * np.sign(v)  # noqa: E731
    X, y, groups = pendulum.measured(pendulum.NOMINAL, 0, law=law, rows=60, episodes=6)
    X[:, 1] = y[:, 1] = np.nan
    space = pendulum.laid_out(SIMULATOR, X, y, groups)
    friction = next(effect for effect in SIMULATOR.effects() if effect.name == "dry_friction[hinge]")
    fits = Fits(space, (friction,), priors_of((friction,)), Known(), 1.0)
    nothing = fits.first()
    far = fits.of((0,), np.array([0.25]), nothing)
    near = fits.of((0,), fits.places(far), nothing)
    assert near.evidence == pytest.approx(far.evidence, abs=2.0)
    # Nor is a step that went too far, and was halved, any nearer to it.
    assert fits.of((0,), np.array([2.0]), nothing).evidence == pytest.approx(far.evidence, abs=4.0)


def test_forces_are_given_no_memory_where_none_is_looked_for(space, nothing, monkeypatch):
    assert len(nothing.fitted.memory)
    monkeypatch.setattr(fitting, "TURNS", 0)
    bare = first_fit(space, {})
    assert not len(bare.memory)
    assert not len(compared(space, {}, bare, memories=False).memory)
    assert len(compared(space, {}, bare).memory)
    kept = compared(space, {}, nothing.fitted, memories=False)
    assert len(kept.memory) == len(nothing.fitted.memory)


def test_a_fit_is_the_same_wherever_it_was_begun(space):
    for one, other in ((space, {"damping[hinge]": 0.5}), (bouncing(chain_length=1), {"gravity": 0.8})):
        first, far = first_fit(one, {}), first_fit(one, other)
        for start in (first, far):
            fitted = start
            for _ in range(4):
                fitted = next_fit(one, {}, fitted)
            assert fitted.bound == pytest.approx(first.bound, abs=1.5)


def test_only_where_something_hits_is_a_row_bent_and_only_where_all_is_measured_is_it_known(space):
    assert bent_rows(bouncing(), first_fit(bouncing(), {})).any()
    assert not bent_rows(space, first_fit(space, {})).any()
    assert hits(bouncing(), nominal_look(bouncing()))
    assert not hits(bouncing(hidden=(1,)), nominal_look(bouncing(hidden=(1,))))
    assert not hits(space, nominal_look(space))


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


@pytest.mark.parametrize(("members", "turns"), [((0,), FORCE_TURNS), ((), 1)])
def test_beside_another_fit_a_row_is_simulated_few_times(fits, nothing, members, turns, monkeypatch):
    """Once as it is; and, as forces last there, with those known then, and with more and less of each.

    Twice where another set's were known before.
    """
    asked = []
    monkeypatch.setattr(
        SIMULATOR,
        "predict_many",
        lambda rows, *args, **options: asked.append(len(rows)) or predict(rows, *args, **options),
    )
    values = {fits.effects[one].name: 0.1 for one in members}
    fit = compared(fits.space, values, nothing.fitted, fits.known)
    assert nothing.fitted.memory
    assert asked == (1 + turns * (1 + 2)) * [len(fits.space.X)]
    np.testing.assert_array_equal(fit.linear.path, nothing.fitted.linear.path)


def test_blocks_of_time_are_as_long_in_short_chains_as_in_long_ones():
    log = pendulum.measured(HEAVIER, 0, rows=1000, episodes=2)
    for length in (64, 4):
        short = state_space(SIMULATOR, *log, consecutive=True, chain_length=length)
        blocks = _blocks(short)
        assert blocks.shape == (len(short.real), short.real.shape[1] + 1)
        sizes = np.bincount(np.unique(blocks[:, :-1][short.real], return_inverse=True)[1])
        assert 20 <= np.median(sizes) <= 32
        assert np.all(np.diff(blocks[short.places]) >= 0)


@pytest.mark.parametrize("rows", [0.4, 1.2, 1.66, 2.5])
def test_a_delay_is_found_from_wherever_slopes_say(rows):
    """Between whole rows its likelihood has maxima of its own, most of which lead back to no delay."""
    rng = np.random.default_rng(0)
    simulator = MujocoSimulator(STIFF, frame_skip=5)
    delay = next(one for one in simulator.effects() if one.name == "delay[action]")
    commands = 0.1 * np.cumsum(rng.normal(size=(1, 200, 1)), axis=1)
    late = simulator.extended({delay.name: 2 * simulator.dt})
    states = late.rollout(np.zeros((1, 2)), commands, n_steps=200)[0]
    states += [0.001, 0.003] * rng.normal(size=states.shape)
    X, y, groups = np.c_[states[:-1], commands[0]], states[1:], np.zeros(200, int)
    space = state_space(simulator, X, y, groups, consecutive=True)
    fits = Fits(space, (delay,), priors_of((delay,)), Known(), 1.0)
    found = fits.of((0,), np.array([rows * simulator.dt]), fits.first(), own_slopes=False)
    assert found.values[delay.name] == pytest.approx(2 * simulator.dt, rel=1e-3)


def test_friction_that_holds_nothing_is_not_looked_for_below_what_is_found(monkeypatch):
    """A log of the model as it is may ask for a little of it, and is as likely without."""
    space = pendulum.laid_out(SIMULATOR, *pendulum.measured(pendulum.TEXT.format(damping=0.05), 1, rows=125))
    friction = next(effect for effect in SIMULATOR.effects() if effect.family == "dry_friction")
    fits, fitted = Fits(space, (friction,), priors_of((friction,)), Known(), 1.0), []
    unweighed = Fits.unweighed

    def counted(*arguments):
        fitted.append(arguments)
        assert len(fitted) < 10
        return unweighed(*arguments)

    monkeypatch.setattr(Fits, "unweighed", counted)
    found = fits.of((0,), [0.01], fits.first())
    assert 0 < found.values[friction.name] < 1e-3
    assert found.widths[0] > 0


def test_a_fit_begun_with_known_slopes_is_the_one_begun_without():
    space = bouncing()
    begun, bare = first_fit(space, {}, begun=nominal_look(space)), first_fit(space, {})
    assert begun.bound == pytest.approx(bare.bound, abs=1.0)
    np.testing.assert_allclose(begun.estimate.noise.error, bare.estimate.noise.error, rtol=0.05)
