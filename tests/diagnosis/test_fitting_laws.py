"""What fits are made of, against least squares and the weighing of sets: evidence, noise beside effects, scores."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from skat.diagnosis import slopes as module_of_slopes
from skat.diagnosis.chains import Memory
from skat.diagnosis.evidence import Gram, weigh
from skat.diagnosis.filtering import kalman_filter
from skat.diagnosis.fits import Fits
from skat.diagnosis.fitting import (
    MEMORIES,
    Known,
    _rough,
    _with_best_memory,
    around,
    compared,
    first_fit,
    gram_of,
    next_fit,
    noise_without,
    priors_of,
    response,
    slopes_of,
)
from skat.diagnosis.noise import normal_noise
from skat.diagnosis.statespace import linearise, state_space
from skat.diagnosis.velocities import noise_variance
from skat.effects import Effect
from skat.simulators import FunctionSimulator, MujocoSimulator

NAMES, SIGMA, POWER = tuple("abc"), 0.5, 0.7
EFFECTS = tuple(Effect(name, unit="1", neutral=0.0, bounds=(-5.0, 5.0), typical=0.5) for name in NAMES)


def logged(n=60, seed=0):
    """Return the space of a one-shot sum of three inputs, each times an effect, its inputs and its readings."""
    simulator = FunctionSimulator(
        lambda X, **values: X @ [[values[name]] for name in NAMES],
        input_names=("p", "q", "r"),
        output_names=("y",),
        effects=EFFECTS,
    )
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, 3))
    y = X @ [1.0, 0.0, -0.4] + SIGMA * rng.normal(size=n)
    return state_space(simulator, X, y[:, None], np.arange(n), consecutive=False), X, y


@pytest.fixture(scope="module")
def fits():
    return Fits(logged()[0], EFFECTS, priors_of(EFFECTS), Known(given=np.array([SIGMA])), POWER)


# -- sets ------------------------------------------------------------------------------------------------------------


def test_fits_of_what_is_linear_have_the_values_and_the_evidence_of_their_weighing(fits):
    _, X, y = logged()
    gram = Gram(X.T @ X / SIGMA**2, X.T @ y / SIGMA**2, np.zeros(3))
    nothing = fits.first()
    assert nothing.evidence == pytest.approx(POWER * nothing.fitted.bound)
    for members in ((0,), (1,), (0, 2)):
        one = fits.of(members, np.full(len(members), 0.1), nothing)
        weighed = weigh(gram, fits.priors, members, power=POWER)
        assert one.members == members
        np.testing.assert_allclose(
            list(one.values.values()), weighed.values, atol=0.1 * weighed.deviations.min()
        )
        assert one.evidence - nothing.evidence == pytest.approx(weighed.evidence, abs=0.05)
        np.testing.assert_allclose(fits.gram(one.fitted, range(3)).products, gram.products, rtol=1e-6)
        np.testing.assert_allclose(fits.gram(one.fitted, range(3)).at_neutral, gram.projections, rtol=1e-6)


def test_a_fit_without_a_member_is_that_of_the_others(fits):
    nothing = fits.first()
    both = fits.of((0, 2), np.zeros(2), nothing)
    for gone, left in ((0, (2,)), (2, (0,))):
        kept = np.array(both.members) != gone
        rest, own = fits.of(left, fits.places(both)[kept], both), fits.of(left, np.zeros(1), nothing)
        assert rest.members == left
        assert rest.evidence == pytest.approx(own.evidence, abs=0.02)
        assert list(rest.values) == [NAMES[left[0]]]
    assert fits.of((), np.zeros(0), both).evidence == pytest.approx(nothing.evidence, abs=1e-6)


# -- noise -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("given", [None, np.array([0.3])])
def test_what_effects_explain_is_no_noise(given):
    space, X, y = logged(200)
    fitted = first_fit(space, {}, Known(given=given))
    slopes = slopes_of(space, fitted, EFFECTS, priors_of(EFFECTS).scales)
    np.testing.assert_allclose(slopes[:, 0], X, atol=1e-9)
    moves = np.array([1.0, 0.0, -0.4])
    without = noise_without(space, fitted, slopes, moves, Known(given=given))
    expected = 0.09 if given is not None else np.mean((y - X @ moves) ** 2)
    assert without.estimate.noise.error[0] == pytest.approx(expected, rel=0.03)
    # The fit stays about no effect: innovations are all of the readings.
    z = without.estimate.filtered.whitened[without.chains.mask] * np.sqrt(without.estimate.noise.error[0])
    if np.isinf(without.estimate.noise.error_nu[0]):
        np.testing.assert_allclose(z, y, rtol=1e-6)
    floored = noise_without(space, fitted, slopes, moves, Known(np.array([9.0])))
    assert floored.estimate.noise.error[0] == 9.0


def test_scores_are_of_whitened_rows_in_blocks_of_time():
    space, X, y = logged(120)
    fitted = first_fit(space, {}, Known(given=np.array([SIGMA])))
    columns = gram_of(space, fitted, slopes_of(space, fitted, EFFECTS, priors_of(EFFECTS).scales), EFFECTS)
    np.testing.assert_allclose(columns.columns, X / SIGMA, atol=1e-9)
    np.testing.assert_allclose(columns.whitened, y / SIGMA, rtol=1e-9)
    np.testing.assert_allclose(columns.gram.projections, X.T @ y / SIGMA**2, rtol=1e-9)
    assert columns.blocks.tolist() == (np.arange(120) // 2).tolist()


def test_responses_are_what_steps_take_from_innovations_beside_forces_of_memory():
    """Of linear dynamics: the difference of two passes, one with more added in each step to the places alone."""
    space, rng = walks(), np.random.default_rng(1)
    chains = linearise(space, space.measured, {}).chains.with_memory(Memory(2, 0.8))
    slopes = rng.normal(size=(len(space.X), 2, 1))
    drive = chains.drive.copy()
    drive[..., :2] += space.padded(slopes[..., 0])
    force, error = np.ones((*space.real.shape, 4)), np.ones(chains.mask.shape)
    base, moved = (kalman_filter(one, force, error) for one in (chains, replace(chains, drive=drive)))
    expected = base.whitened - moved.whitened
    np.testing.assert_allclose(response(space, chains, base, slopes)[..., 0], expected, atol=1e-9)


def walks():
    """Return the log of two places that a command moves, read with much and with little noise."""
    rng, names = np.random.default_rng(0), ("x", "z")
    simulator = FunctionSimulator(
        lambda X: X[:, :2] + X[:, 2:],
        input_names=(*names, "u"),
        output_names=names,
        state_names=names,
        dt=0.1,
    )
    X, y = [], []
    for length in (150, 90):
        u = 0.1 * np.sin(0.1 * np.arange(length))[:, None]
        path = np.r_[np.zeros((1, 2)), np.cumsum(np.tile(u, 2), axis=0)] + [0.5, 0.01] * rng.normal(
            size=(length + 1, 2)
        )
        X.append(np.c_[path[:-1], u])
        y.append(path[1:])
    return state_space(
        simulator, np.concatenate(X), np.concatenate(y), np.repeat([0, 1], [150, 90]), consecutive=True
    )


def test_noise_begins_at_what_neighbouring_rows_show_of_each_channel():
    space = walks()
    (rough,) = _rough(space)
    episodes = np.repeat(np.arange(len(space.measured)), space.measured.shape[1])
    for channel, error in enumerate((0.5, 0.01)):
        series = np.where(space.mask[..., channel], space.measured[..., channel], np.nan).ravel()
        assert rough[channel] == noise_variance(series, episodes)
        assert 0.2 * error**2 < rough[channel] < 1.2 * error**2
    space.mask[..., 0] = False
    assert np.isinf(_rough(space)[0, 0])


def test_turns_show_no_noise_of_their_own():
    ball = MujocoSimulator(
        "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    states = np.tile(np.r_[np.zeros(3), 1.0, np.zeros(9)], (20, 1))
    states[:, :3] += 0.01 * np.random.default_rng(0).normal(size=(20, 3))
    space = state_space(ball, states[:-1], states[1:], np.zeros(19, dtype=int), consecutive=True)
    (rough,) = _rough(space)
    assert np.isfinite(rough[:3]).all()
    assert np.isinf(rough[3:6]).all()


def test_of_forces_with_memory_nothing_is_known():
    chains = linearise(walks(), walks().measured, {}).chains.with_memory(Memory(2, 0.8))
    known = Known(np.array([0.1, 0.2]), np.array([0.3, 0.4]))
    assert known.least(chains).tolist() == [0.1, 0.2, 0.0, 0.0]
    assert known.held(chains).tolist() == [True, True, False, False]
    assert Known().held(chains) is None
    real = np.ones(chains.drive.shape[:2], dtype=bool)
    start = normal_noise(chains, np.full(4, 0.01), np.array([0.09, 0.16, 1.0, 1.0]))
    assert known.estimated(chains, start, real).noise.error[0, :2].tolist() == [0.09, 0.16]


@pytest.mark.parametrize(
    ("last", "bounds", "best"),
    [
        # Between two memories that fit there is one that does not: each of the two stays where it was the last one.
        (0, {0: 50.0, 1: 20.0, 2: 60.0}, 0),
        (2, {0: 50.0, 1: 20.0, 2: 60.0}, 2),
        # One of the other kind is tried, too, where innovations point to it.
        (2, {2: 60.0, 4: 70.0}, 4),
        (4, {2: 60.0, 4: 50.0}, 2),
    ],
)
def test_a_memory_is_sought_from_the_last_one_on(last, bounds, best, monkeypatch):
    fitted, memories = sought(last, bounds, bounds, monkeypatch)
    assert fitted.bound == bounds[best]
    assert fitted.memory == memories[best]


def test_the_last_memory_is_tried_though_innovations_ask_for_none(monkeypatch):
    fitted, memories = sought(4, {4: 59.0}, {}, monkeypatch)
    assert fitted.memory == memories[4]
    assert not sought(4, {4: 5.0}, {}, monkeypatch)[0].memory


def sought(last, bounds, worth, monkeypatch):
    """Return the fit, where memories have bounds and seem to be worth so much by place, and the memories."""
    space = walks()
    linear = linearise(space, space.measured, {})
    memories = [
        Memory(2, float(np.exp(-1 / rows)), returns) for returns in (False, True) for rows in MEMORIES[:3]
    ]
    monkeypatch.setattr("skat.diagnosis.chains.Chains.with_memory", lambda chains, memory: memory)
    monkeypatch.setattr(
        "skat.diagnosis.fitting._worth_of_memories",
        lambda chains, estimate, memories: [worth.get(place, 0.0) for place in range(6)],
    )
    monkeypatch.setattr("skat.diagnosis.fitting._worth_beyond_white", lambda chains, estimate: 0.0)

    def estimated(memory, noise, real):
        return SimpleNamespace(bound=bounds.get(memories.index(memory), 0.0) if memory else 0.0, noise=noise)

    known = SimpleNamespace(given=np.ones(2), estimated=estimated)
    noise = normal_noise(linear.chains, np.ones(2), np.ones(2))
    return _with_best_memory(space, {}, linear, noise, memories[last], known), memories


@pytest.mark.parametrize("nu", [3.0, np.inf])
def test_what_a_log_tells_of_a_value_is_the_information_of_students_law(nu):
    """Of 1 / r for each row of scale r as long as tails are normal; (nu + 1) / (nu + 3) of it where they are not."""
    rng, n = np.random.default_rng(2), 4000
    X = rng.normal(size=(n, 1))
    noise = rng.standard_t(nu, size=(n, 1)) if np.isfinite(nu) else rng.normal(size=(n, 1))
    mass = Effect("mass", unit="1", neutral=0.0, bounds=(-5.0, 5.0))
    simulator = FunctionSimulator(
        lambda X, mass: X * mass, input_names=("x",), output_names=("y",), effects=(mass,)
    )
    space = state_space(simulator, X, 0.1 * noise, np.arange(n), consecutive=False)
    fitted = first_fit(space, {"mass": 0.0})
    assert fitted.estimate.noise.error_nu[0, 0] == nu
    slopes = slopes_of(space, fitted, [mass], np.ones(1))
    gram = gram_of(space, fitted, slopes, [mass]).gram
    share = (nu + 1) / (nu + 3) if np.isfinite(nu) else 1.0
    assert gram.products[0, 0] == pytest.approx(share * np.sum(X**2) / 0.01, rel=0.05)
    # The slope of the likelihood is what it is.
    step = 1e-4
    up, down = (compared(space, {"mass": one}, fitted).bound for one in (step, -step))
    assert gram.projections[0] == pytest.approx((up - down) / (2 * step), rel=0.02, abs=0.5)


def test_a_simulation_that_diverges_everywhere_has_no_fit():
    names = ("x",)
    lost = FunctionSimulator(
        lambda X: np.full((len(X), 1), np.nan),
        input_names=names,
        output_names=names,
        state_names=names,
        dt=0.1,
    )
    X = np.random.default_rng(0).normal(size=(21, 1))
    space = state_space(lost, X[:-1], X[1:], np.zeros(20, dtype=int), consecutive=True)
    with pytest.raises(
        RuntimeError, match=r"diverges in every row: check the units of the states and actions\."
    ):
        first_fit(space, {})


def test_values_to_both_sides_are_as_far_off_as_they_count_and_within_bounds():
    gain = Effect("gain", unit="1", neutral=1.0, bounds=(0.25, 4.0))
    assert around(gain, 1.0, np.log(2)) == pytest.approx((0.5, 2.0))
    assert around(gain, 3.0, np.log(2)) == pytest.approx((1.5, 4.0))
    assert around(EFFECTS[0], 1.0, 0.25) == pytest.approx((0.75, 1.25))


# -- lasting forces and friction -------------------------------------------------------------------------------------

CART = """<mujoco><option timestep='0.002'/><worldbody><body><geom size='.1' mass='1'/>
<joint name='rail' type='slide' axis='1 0 0' frictionloss='2'/></body></worldbody>
<actuator><motor name='push' joint='rail'/></actuator></mujoco>"""


def pushed_cart(seed, n=600, dt=0.02, memory=0.2):
    """A log of plain MuJoCo: a cart that turns back at times, under a force of 1 N that lasts 0.2 s."""
    rng, model = np.random.default_rng(seed), mujoco.MjModel.from_xml_string(CART)
    data, keep, force = mujoco.MjData(model), np.exp(-dt / memory), rng.standard_normal()
    times = dt * np.arange(n)
    commands = 3 * np.sin(2 * np.pi * 0.7 * times) + np.sin(2 * np.pi * 1.9 * times)
    states = np.zeros((n + 1, 2))
    for row, command in enumerate(commands):
        data.ctrl[:], data.qfrc_applied[:] = command, force
        mujoco.mj_step(model, data, nstep=10)
        states[row + 1] = np.r_[data.qpos, data.qvel]
        force = keep * force + np.sqrt(1 - keep**2) * rng.standard_normal()
    states += rng.standard_normal(states.shape) * [0.002, 0.01]
    return np.c_[states[:-1], commands], states[1:]


@pytest.mark.parametrize("seed", [0, 3])
def test_the_likeliest_friction_under_a_lasting_force_is_about_the_true_one(seed):
    """A joint that a force slides, though the model without the force has it rest, is no sign of less friction."""
    X, y = pushed_cart(seed)
    simulator = MujocoSimulator(CART, frame_skip=10)
    space = state_space(simulator, X, y, np.zeros(len(X), int), consecutive=True)
    offs = (-0.6, -0.3, 0.0, 0.3)
    bounds = [first_fit(space, {"dry_friction[rail]": off} if off else {}).bound for off in offs]
    assert bounds[2] > max(bounds) - 3
    assert bounds[2] > bounds[0] + 10


def test_a_set_beside_another_has_the_lasting_forces_that_are_known_at_its_own_values():
    """About the path of a model without friction the lasting force is the friction: with both, nothing would slide."""
    X, y = pushed_cart(0)
    simulator = MujocoSimulator(CART.replace(" frictionloss='2'", ""), frame_skip=10)
    space = state_space(simulator, X, y, np.zeros(len(X), int), consecutive=True)
    nothing = first_fit(space, {})
    assert nothing.memory
    less, right = {"dry_friction[rail]": 1.0}, {"dry_friction[rail]": 2.0}
    beside = [compared(space, values, nothing).bound for values in (less, right)]
    own = [first_fit(space, values).bound for values in (less, right)]
    assert own[1] > own[0] + 50
    assert beside[1] > beside[0] + 30 > nothing.bound + 100
    assert next_fit(space, right, nothing).bound > own[1] - 15


@pytest.mark.parametrize(("friction", "off"), [(0.0, 0.3), (2.0, 3.5)])
def test_slopes_under_a_lasting_force_say_what_fits_do(friction, off):
    """A heavier cart needs more of the force to move as it does: what is kept is what the force does."""
    X, y = pushed_cart(0)
    simulator = MujocoSimulator(CART.replace(" frictionloss='2'", ""), frame_skip=10)
    space = state_space(simulator, X, y, np.zeros(len(X), int), consecutive=True)
    effect = next(one for one in simulator.effects() if one.name == "armature[rail]")
    heavier = {"dry_friction[rail]": friction, "armature[rail]": 1.0}
    fitted = first_fit(space, heavier)
    assert fitted.memory
    slopes = slopes_of(space, fitted, [effect], np.ones(1), np.array([0.05]), means=True)
    gram = gram_of(space, fitted, slopes, [effect]).gram
    for step in (-0.2, 0.2):
        said = gram.projections[0] * step - gram.products[0, 0] * step**2 / 2
        gained = first_fit(space, {**heavier, "armature[rail]": 1.0 + step}).bound - fitted.bound
        assert said == pytest.approx(gained, abs=off)


@pytest.mark.parametrize(("name", "asked"), [("damping[rail]", False), ("armature[rail]", True)])
def test_what_a_lasting_force_does_is_kept_as_inertia_moves_alone(name, asked, monkeypatch):
    X, y = pushed_cart(0)
    simulator = MujocoSimulator(CART.replace(" frictionloss='2'", ""), frame_skip=10)
    space = state_space(simulator, X, y, np.zeros(len(X), int), consecutive=True)
    fitted = first_fit(space, {"dry_friction[rail]": 2.0})
    assert fitted.linear.forces.means.any()
    calls = []
    exerted = module_of_slopes._exerted
    monkeypatch.setattr(module_of_slopes, "_exerted", lambda *args: calls.append(args) or exerted(*args))
    effect = next(one for one in simulator.effects() if one.name == name)
    assert np.any(slopes_of(space, fitted, [effect], np.ones(1)))
    assert bool(calls) == asked


# -- delays ----------------------------------------------------------------------------------------------------------

STIFF = """<mujoco><option timestep='.004' gravity='0 0 0' integrator='implicitfast'/><worldbody><body>
<geom size='.1' mass='1'/><joint name='rail' type='slide' axis='1 0 0'/></body></worldbody>
<actuator><position name='drive' joint='rail' kp='4000' kv='400'/></actuator></mujoco>"""


@pytest.mark.parametrize(("late", "ends"), [(5.05, (5.05, 5.5)), (5.0, (4.5, 5.5))])
def test_a_slope_by_a_delay_is_of_its_own_time_step_and_of_both_that_it_is_between(late, ends):
    """A row has 5 of them: what is later than that moves a stiff servo thirty times less."""
    rng, step = np.random.default_rng(0), 0.004
    simulator = MujocoSimulator(STIFF, frame_skip=5)
    delay = next(one for one in simulator.effects() if one.name == "delay[action]")
    commands = 0.1 * np.cumsum(rng.normal(size=(1, 60, 1)), axis=1)
    states = simulator.extended({delay.name: late * step}).rollout(np.zeros((1, 2)), commands, n_steps=60)[0]
    states += [0.001, 0.003] * rng.normal(size=states.shape)
    X, y, groups = np.c_[states[:-1], commands[0]], states[1:], np.zeros(60, int)
    space = state_space(simulator, X, y, groups, consecutive=True)
    fitted = first_fit(space, {delay.name: late * step})
    slopes = slopes_of(space, fitted, [delay], np.array([delay.typical]), np.array([0.5 * step]))[..., 0]

    def chord(first, last):
        early, after = (
            simulator.predict(X, effects={delay.name: one * step}, groups=groups) for one in (first, last)
        )
        return (after - early) / ((last - first) * step)

    sizes = np.abs(chord(*ends)).max(axis=0)
    np.testing.assert_allclose(slopes / sizes, chord(*ends) / sizes, atol=1e-9)
    before, behind, across = (np.linalg.norm(chord(*one)[:, 1]) for one in ((4.5, 5), (5, 5.5), (4.5, 5.5)))
    assert min(before, across) > 10 * behind
