"""What is left of a log, against closed forms: worth of a law, bins, size, spectra, words and the verdict."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from scipy import special, stats

from skat.diagnosis.ahead import Seen
from skat.diagnosis.chains import NO_MEMORY, Memory
from skat.diagnosis.findings import Gain
from skat.diagnosis.fitting import Fitted, Known, first_fit
from skat.diagnosis.laws import (
    SIZES,
    WAYS,
    Law,
    binned,
    bins_of,
    regressors_of,
    single,
    unwrapped,
    way_of,
    worth_of,
)
from skat.diagnosis.noise import Noise, normal_noise, passed
from skat.diagnosis.remainder import (
    Left,
    Remainder,
    _added,
    _halves,
    _joint_scales,
    _of_time,
    _past,
    _response,
    _runs,
    _spectrum,
    _turned_back,
    _welch,
    _white_spectra,
    find_remainder,
    is_unexplained,
    word_of,
)
from skat.diagnosis.statespace import linearise, state_space
from skat.simulators import FunctionSimulator, MujocoSimulator
from tests.diagnosis.pendulum import FRAME_SKIP, NOMINAL, laid_out, measured

DT = 0.02
STATE = ("qpos.cart", "qvel.cart")
UNITS = {"qpos.cart": "m", "qvel.cart": "m/s"}


def rolling(units=UNITS, names=STATE, dt=DT):
    """Return a cart that its command accelerates."""
    return FunctionSimulator(
        lambda X: np.column_stack([X[:, 0] + DT * X[:, 1], X[:, 1] + DT * X[:, 2]]),
        input_names=(*names, "u"),
        output_names=names,
        state_names=names,
        units=units,
        dt=dt,
    )


def rolled(lengths, *, drag=0.0, seed=0, simulator=None, error=(1e-4, 1e-3)):
    """Return the log of a cart with a drag that the simulation lacks."""
    rng, X, y = np.random.default_rng(seed), [], []
    for length in lengths:
        state, states = np.array([0.0, rng.normal()]), []
        commands = np.repeat(3 * rng.normal(size=length // 5 + 1), 5)[:length]
        for command in commands:
            states.append(state)
            state = state + DT * np.array([state[1], command - drag * state[1]])
        read = np.array([*states, state]) + np.array(error) * rng.normal(size=(length + 1, 2))
        X.append(np.column_stack([read[:-1], commands]))
        y.append(read[1:])
    groups = np.repeat(np.arange(len(lengths)), lengths)
    return state_space(simulator or rolling(), np.concatenate(X), np.concatenate(y), groups, consecutive=True)


def part_of(**changes):
    nothing = np.zeros(0)
    return replace(
        Left(
            "hinge", "N m", 1.0, 1.0, 0.5, "constant", 10.0, Law("x", *[nothing] * 4), 0.0, 0.05, nothing, nothing,
            "white",
        ),
        **changes,
    )  # fmt: skip


# -- the verdict -----------------------------------------------------------------------------------------------------


def test_only_a_law_that_is_clear_is_unexplained():
    part = part_of(evidence=np.log(50))
    assert is_unexplained(Remainder((part,), 10), None, alpha=0.05)
    assert not is_unexplained(Remainder((part,), 10), None, alpha=0.01)
    assert not is_unexplained(Remainder((), 10), None)
    assert Remainder((), 10).evidence == -np.inf
    assert Remainder((part_of(evidence=-2.0), part, part_of(evidence=1.0)), 10).evidence == np.log(50)


def test_a_law_that_adds_little_is_too_much_where_it_is_much_of_its_joint_s_force():
    small = part_of(ahead=0.05, scale=1.0)
    assert is_unexplained(Remainder((replace(small, predictable=0.11),), 10), None)
    assert not is_unexplained(Remainder((replace(small, predictable=0.09),), 10), None)
    assert is_unexplained(Remainder((replace(small, predictable=0.09),), 10), None, tolerance=0.08)
    unclear = replace(small, predictable=5.0, evidence=0.0)
    assert not is_unexplained(Remainder((replace(small, predictable=0.09), unclear), 10), None)
    one_of_two = (replace(small, predictable=0.01, ahead=0.04), replace(small, predictable=0.5, ahead=0.04))
    assert is_unexplained(Remainder(one_of_two, 10), None)


@pytest.mark.parametrize(
    ("gone", "unexplained"), [(None, True), (4.4, True), (4.6, False), (-100.0, True), (0.0, True)]
)
def test_a_law_that_adds_much_is_held_against_what_the_causes_explain(gone, unexplained):
    """.5 is more than a tenth of .5 and what is gone, up to 4.5."""
    parts = part_of(ahead=0.2, predictable=0.0), part_of(ahead=0.3, predictable=0.0)
    unclear = part_of(ahead=50.0, evidence=0.0)
    gain = None if gone is None else Gain(2.0 + gone, 2.0, 1.0, 1.0, (1.0, 1.0), 0.25)
    assert is_unexplained(Remainder((*parts, unclear), 10), gain) == unexplained


def test_the_share_that_is_predictable_is_one_of_squares():
    assert part_of(rms=2.0, predictable=1.0).share == pytest.approx(0.25)
    assert part_of(rms=2.0, predictable=3.0).share == 1.0
    assert part_of(rms=0.0, predictable=0.0).share == 0.0


# -- laws ------------------------------------------------------------------------------------------------------------


def test_a_law_is_worth_its_likelihood_against_none_as_a_mean_over_sizes():
    rng = np.random.default_rng(0)
    N, scale = rng.normal(size=(30, 4)) * [0.3, 1.0, 3.0, 0.0], 2.5
    z = N @ [0.5, -0.4, 0.2, 0.0] + rng.normal(size=30)
    each = [
        stats.multivariate_normal(np.zeros(30), np.eye(30) + (size * scale) ** 2 * N @ N.T).logpdf(z)
        for size in SIZES
    ]
    none = stats.norm.logpdf(z).sum()
    nats, best = worth_of(N.T @ N, N.T @ z, scale)
    assert nats == pytest.approx(special.logsumexp(each) - np.log(len(each)) - none, rel=1e-9)
    assert best == pytest.approx(SIZES[int(np.argmax(each))] * scale)


@pytest.mark.parametrize("n_bins", [5, 12])
def test_bins_hold_about_as_many_rows_each_between_their_edges(n_bins):
    values = np.random.default_rng(0).gamma(2, size=500)
    edges, columns = bins_of(values, n_bins)
    assert columns.shape == (500, n_bins)
    np.testing.assert_array_equal(columns.sum(axis=1), 1)
    assert np.ptp(columns.sum(axis=0)) <= 2
    place = columns.argmax(axis=1)
    assert (values >= edges[place]).all()
    assert ((values < edges[place + 1]) | (values == values.max())).all()
    assert (edges[0], edges[-1]) == (values.min(), values.max())


def test_what_does_not_change_has_no_law_and_what_has_few_values_one_of_these():
    assert bins_of(np.full(20, 3.0), 12)[1].shape == (20, 1)
    assert binned("a", np.full(20, 3.0), 12, is_own=True) == []
    assert single("a", "a", np.zeros(20)) == []
    three = np.tile([0.0, 1.0, 2.0], 20)
    edges, columns = bins_of(three, 12)
    np.testing.assert_array_equal(edges, [0.0, 0.5, 1.5, 2.0])
    np.testing.assert_array_equal(columns.argmax(axis=1), three)
    pulses = np.r_[np.zeros(95), np.ones(5)]
    np.testing.assert_array_equal(bins_of(pulses, 5)[1].argmax(axis=1), pulses)
    (one,) = binned("a", three, 12, is_own=False)
    assert not one.is_own


def test_a_law_of_one_column_has_a_mean_square_of_one():
    values = np.random.default_rng(0).normal(size=50)
    (one,) = single("|v|v", "v", values, np.abs(values) * values)
    assert np.mean(one.columns**2) == pytest.approx(1.0)
    assert np.corrcoef(one.columns[:, 0], np.abs(values) * values)[0, 1] == pytest.approx(1.0)
    np.testing.assert_array_equal(one.values, values)
    assert (one.name, one.coordinate, one.columns.shape) == ("|v|v", "v", (50, 1))


def laws(space, *own, n=1):
    simulator = space.simulator
    return [*regressors_of(simulator, simulator.input_names, space.X, own, space.groups, n), *_of_time(space)]


@pytest.mark.parametrize("episodes", [4, 5])
def test_own_coordinates_are_tried_in_bins_rates_by_sign_and_square_and_time_where_episodes_repeat(episodes):
    space = rolled([30] * episodes)
    rows = space.X
    found = {one.name: one for one in laws(space, "qvel.cart", "qpos.cart")}
    own = {
        "constant",
        "qvel.cart",
        "sign(qvel.cart)",
        "|qvel.cart|qvel.cart",
        "qpos.cart qvel.cart",
        "qpos.cart |qvel.cart|",
        "qpos.cart qvel.cart^2",
        "qpos.cart",
        *(f"the way of qpos.cart, {share:g} of its travel" for share in WAYS),
    }
    assert set(found) == own | {"u"} | ({"time"} if episodes == 5 else set())
    assert {name for name, one in found.items() if not one.is_own} == {"u"}
    np.testing.assert_array_equal(found["constant"].columns, 1)
    np.testing.assert_array_equal(found["constant"].values, rows[:, 1])
    place, speed = rows[:, 0], rows[:, 1]
    for name, law in (
        ("sign(qvel.cart)", np.sign(speed)),
        ("|qvel.cart|qvel.cart", speed * np.abs(speed)),
        ("qpos.cart qvel.cart", place * speed),
        ("qpos.cart |qvel.cart|", place * np.abs(speed)),
        ("qpos.cart qvel.cart^2", place * speed**2),
    ):
        np.testing.assert_allclose(found[name].columns[:, 0], law / np.sqrt(np.mean(law**2)), rtol=1e-12)
    assert found["qvel.cart"].columns.shape[1] > found["u"].columns.shape[1]
    if episodes == 5:
        np.testing.assert_allclose(found["time"].values, np.tile(DT * np.arange(30), 5), atol=1e-12)


def test_a_rate_is_known_by_its_unit_and_a_command_counts_with_how_fast_it_is_met():
    space = rolled([40], simulator=rolling({"x": "m", "w": "rad/s"}, ("x", "w")))
    found = {one.name for one in laws(space, "w", "u")}
    assert found == {"constant", "w", "sign(w)", "|w|w", "u", "u |w|", "u w^2", "x"}
    unnamed = rolled([40], simulator=rolling({}, ("x", "w")))
    assert {one.name for one in laws(unnamed, "w")} == {
        "constant", "w", "u", "x",
    }  # fmt: skip


def test_a_way_forgets_along_itself_whatever_the_time_and_begins_anew_in_each_episode():
    there, back = 1 - np.exp(-1.5 / 0.5), np.exp(-1.0 / 0.5)
    turned = 0.5 * (back * there - (1 - back))
    for n in (4, 40):
        place = np.r_[np.linspace(0, 1.5, n), np.linspace(1.5, 0.5, 2 * n)[1:], 7.0, 7.0]
        groups = np.r_[np.zeros(len(place) - 2, dtype=int), 1, 1]
        way = way_of(place, groups, 0.5)
        assert way[n - 1] == pytest.approx(0.5 * there)
        assert way[-3] == pytest.approx(turned)
        np.testing.assert_array_equal(way[-2:], 0)


def test_angles_go_on_within_an_episode_and_begin_anew_in_the_next():
    there = np.linspace(-2.5, 2.5, 50)
    turning = np.r_[there, there + 5.0]
    folded = (np.tile(turning, 3) + np.pi) % (2 * np.pi) - np.pi
    along = unwrapped(folded, np.repeat(np.arange(3), 100))
    np.testing.assert_allclose(along, np.tile(turning, 3))


def test_other_joints_coordinates_are_tried_only_while_they_are_few():
    space = rolled([40])
    few = laws(space, "qvel.cart", n=150)
    many = laws(space, "qvel.cart", n=151)
    assert {one.name for one in few} - {one.name for one in many} == {"qpos.cart", "u"}


def test_halves_of_a_log_are_blocks_of_time_in_turns():
    real = np.ones((3, 95), dtype=bool)
    half = _halves(SimpleNamespace(real=real))
    assert half.shape == (3, 96)
    for chain in half:
        turns = np.flatnonzero(np.diff(chain)) + 1
        assert len(np.unique(np.diff(np.r_[0, turns, 96]))) == 1
        assert chain.mean() == 0.5
    assert half[0, 0] != half[1, 0]
    assert half[0, 0] == half[2, 0]


def test_angles_that_turn_over_come_back_each_turn_and_others_stay():
    space = rolled([50], simulator=rolling({"qpos.cart": "rad", "qvel.cart": "rad/s"}))
    rows = np.column_stack([np.linspace(-3, 9, 50), np.linspace(-9, 9, 50), np.zeros(50)])
    turned = _turned_back(space, rows.copy())
    assert (np.abs(turned[:, 0]) <= np.pi).all()
    np.testing.assert_allclose(np.exp(1j * turned[:, 0]), np.exp(1j * rows[:, 0]), atol=1e-12)
    np.testing.assert_array_equal(turned[:, 1:], rows[:, 1:])
    rows[:, 0] = np.linspace(3, 9, 50)
    np.testing.assert_array_equal(_turned_back(space, rows.copy()), rows)


def one_shot(n, seed, bent=0.0, error=0.5):
    simulator = FunctionSimulator(
        lambda X: np.zeros((len(X), 1)), input_names=("a", "b"), output_names=("y",), units={"y": "V"}
    )
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, size=(n, 2))
    y = bent * X[:, :1] + error * rng.normal(size=(n, 1))
    space = state_space(simulator, X, y, np.arange(n), consecutive=False)
    linear = linearise(space, space.measured, {})
    noise = normal_noise(linear.chains, np.zeros(0), np.array([error**2]))
    estimate = passed(linear.chains, noise, space.real, covariances=True)
    return space, Fitted({}, linear, linear.chains, estimate, NO_MEMORY)


def test_the_law_of_what_is_read_is_the_mean_in_each_bin_drawn_to_zero_by_its_size():
    error, n = 0.5, 240
    space, fitted = one_shot(n, 0, bent=1.0, error=error)
    (part,) = find_remainder(space, fitted, random_state=np.random.RandomState(0)).parts
    y = space.measured[:, 1, 0]
    assert (part.name, part.unit, part.law.coordinate) == ("y", "V", "a")
    assert part.rms == pytest.approx(np.sqrt(np.mean(y**2)))
    assert part.scale == pytest.approx(y.std())
    place = np.clip(np.searchsorted(part.law.edges, space.X[:, 0], side="right") - 1, 0, None)
    place = np.minimum(place, len(part.law.mean) - 1)
    sums, counts = np.bincount(place, y), np.bincount(place)
    half = (part.law.high - part.law.low) / 2
    np.testing.assert_allclose((part.law.high + part.law.low) / 2, part.law.mean, atol=1e-12)
    curvature = (stats.norm.ppf(0.975) / half) ** 2
    # The noise is that which is left beside the law.
    noise = sums / part.law.mean / curvature
    np.testing.assert_allclose(noise, noise[0], rtol=1e-4)
    left = np.mean((y - part.law.mean[place]) ** 2)
    assert noise[0] == pytest.approx(left, rel=0.03)
    prior = curvature - counts / noise[0]
    size = 1 / np.sqrt(prior[0])
    np.testing.assert_allclose(prior, prior[0], rtol=0.2)
    assert np.abs(np.array(SIZES) * part.scale / size - 1).min() < 0.1
    # Of a right model's square, that of the error.
    assert part.ahead == pytest.approx(part.predictable**2 / error**2, rel=1e-9)
    assert part.predictable == pytest.approx(np.sqrt(1 / 3), rel=0.15)
    assert part.past == 0.0
    assert part.regressor == "a"


def test_a_noise_that_was_given_is_that_at_which_a_law_is_sized():
    error, n = 0.5, 240
    space, fitted = one_shot(n, 0, bent=1.0, error=error)
    given = Known(given=np.array([error]))
    (part,) = find_remainder(space, fitted, known=given, random_state=np.random.RandomState(0)).parts
    place = np.clip(
        np.searchsorted(part.law.edges, space.X[:, 0], side="right") - 1, 0, len(part.law.mean) - 1
    )
    curvature = (stats.norm.ppf(0.975) / ((part.law.high - part.law.low) / 2)) ** 2
    sums = np.bincount(place, space.measured[:, 1, 0])
    np.testing.assert_allclose(part.law.mean, sums / error**2 / curvature, rtol=1e-4)


def test_what_is_predictable_is_the_mean_product_of_what_two_halves_of_the_rows_predict():
    """Each half is of every other row here; the mean of a bin is drawn to zero by the law's size."""
    error, n = 0.5, 80
    space, fitted = one_shot(n, 0, bent=1.0, error=error)
    (part,) = find_remainder(space, fitted, random_state=np.random.RandomState(0)).parts
    y, place = space.measured[:, 1, 0], np.searchsorted(part.law.edges, space.X[:, 0], side="right") - 1
    place = np.clip(place, 0, len(part.law.mean) - 1)
    counts = np.bincount(place)
    curvature = (stats.norm.ppf(0.975) / ((part.law.high - part.law.low) / 2)) ** 2
    noise = np.median(np.bincount(place, y) / part.law.mean / curvature)
    ridge = np.median(curvature - counts / noise)
    means = []
    for which in (0, 1):
        own = np.arange(n) % 2 == which
        sums = np.bincount(place[own], y[own], minlength=len(counts)) / noise
        means.append(sums / (np.bincount(place[own], minlength=len(counts)) / noise + ridge))
    expected = np.sqrt(max(np.mean(means[0][place] * means[1][place]), 0.0))
    assert part.regressor == "a"
    assert expected > 0.1
    assert part.predictable == pytest.approx(expected, rel=1e-3)


def test_chance_makes_evidence_of_which_the_exponential_has_a_mean_of_one():
    """With the noise known, whatever was tried; the fewer rows, the less a law can win or lose."""
    found = []
    for seed in range(150):
        space, fitted = one_shot(12, seed)
        found.append(find_remainder(space, fitted, random_state=np.random.RandomState(0)).evidence)
    assert np.mean(np.exp(found)) == pytest.approx(1.0, abs=0.25)


def test_an_acceleration_that_a_function_lacks_is_found_in_its_unit():
    drag = 0.8
    space = rolled([80] * 4, drag=drag)
    remainder = find_remainder(space, first_fit(space, {}), random_state=np.random.RandomState(0), horizon=7)
    assert remainder.horizon == 7
    (part,) = remainder.parts
    assert (part.name, part.unit) == ("qvel.cart", "m/s/s")
    assert part.evidence > np.log(100)
    speed = space.X[:, 1]
    assert part.predictable == pytest.approx(drag * np.sqrt(np.mean(speed**2)), rel=0.2)
    changes = np.diff(space.measured[..., 1], axis=1)[space.real[:, : space.measured.shape[1] - 1]]
    assert part.scale == pytest.approx(np.sqrt(np.mean(changes**2)) / DT, rel=0.05)
    middle = (part.law.edges[1:] + part.law.edges[:-1]) / 2
    assert part.law.coordinate == "qvel.cart"
    assert np.corrcoef(middle, part.law.mean)[0, 1] < -0.95


def test_a_joint_s_force_is_that_of_its_motor_and_without_one_that_of_gravity():
    X, y, groups = measured(NOMINAL, 0, rows=60, episodes=2)
    driven = MujocoSimulator(NOMINAL, frame_skip=FRAME_SKIP)
    space = laid_out(driven, X, y, groups)
    scales = _joint_scales(space, SimpleNamespace(linear=linearise(space, space.measured, {})))
    np.testing.assert_allclose(scales, np.sqrt(np.mean(X[:, 2] ** 2)), rtol=1e-9)
    text = NOMINAL[: NOMINAL.index("<actuator>")] + "</mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    swinging = MujocoSimulator(text, frame_skip=FRAME_SKIP)
    space = laid_out(swinging, X[:, :2], y, groups)
    scales = _joint_scales(space, SimpleNamespace(linear=linearise(space, space.measured, {})))
    weight = model.body_mass[1] * 9.81 * abs(model.body_ipos[1, 2])
    torque = weight * np.sin(space.measured[:, :-1][space.places][:, 0])
    np.testing.assert_allclose(scales, np.sqrt(np.mean(torque**2)), rtol=1e-6)


def test_the_past_predicts_of_a_force_with_memory_what_is_left_of_it_a_row_later():
    """A lasting force of variance 1, of which half is left a row later, beside a white one of variance 1."""

    def past(memory, force, index, mixing=None):
        some = np.ones((1, len(force)))
        law = np.zeros(1, dtype=int), some[None], some[None]
        noise = Noise(np.array([force]), some, np.inf * some, np.inf * some, *law, mixing)
        return _past(SimpleNamespace(memory=memory, estimate=SimpleNamespace(noise=noise)), index)

    four = [9.0, 1.0, 5.0, 0.75]
    assert past(Memory(2, 0.5), four, 1) == pytest.approx(0.25 / 2)
    # Of pushes of .75 a third of the variance is taken back in later rows.
    assert past(Memory(2, 0.5, returns=True), four, 1) == pytest.approx(0.25 / 2)
    assert past(NO_MEMORY, [9.0, 1.0], 0) == 0.0
    assert past(Memory(1, 0.5), [0.0, 0.0], 0) == 0.0
    # The first pushes act on the second joint, too: white ones of 9 and 1, and lasting ones of 4 and 1.
    mixing = np.array([[[1.0, 0.0], [1.0, 1.0]]])
    assert past(Memory(2, 0.5), [9.0, 1.0, 3.0, 0.75], 1, mixing) == pytest.approx(0.25 * 5 / 15)


def resting(lengths, *, error=0.1, force=0.0):
    """Return the log of places that stay, one in each episode, and how it is seen at a known noise."""
    simulator = FunctionSimulator(
        lambda X: X, input_names=("x",), output_names=("x",), state_names=("x",), dt=DT
    )
    rng, read = np.random.default_rng(0), []
    for length in lengths:
        steps = np.sqrt(force) * rng.normal(size=(length + 1, 1))
        read.append(5 * rng.normal() + np.cumsum(steps, axis=0) + error * rng.normal(size=(length + 1, 1)))
    X, y = (np.concatenate([one[part] for one in read]) for part in (slice(None, -1), slice(1, None)))
    groups = np.repeat(np.arange(len(lengths)), lengths)
    space = state_space(simulator, X, y, groups, consecutive=True, chain_length=1000)
    linear = linearise(space, space.measured, {})
    forces = np.array([force / space.carrier[0, 0] ** 2])
    noise = normal_noise(linear.chains, forces, np.array([error**2]))
    estimate = passed(linear.chains, noise, space.real, covariances=True)
    return space, Fitted({}, linear, linear.chains, estimate, NO_MEMORY)


def test_a_force_adds_ahead_the_product_of_what_its_two_estimates_move():
    """What moves a place by .2 and by .3 a row moves it by ten times as much in ten rows."""
    error = 0.1
    space, fitted = resting([30, 40], error=error)
    seen = Seen(fitted.linear, fitted.chains, fitted.estimate, fitted.memory)
    runs = _runs(space, seen, {}, 10)
    forces = np.tile([0.2, 0.3], (70, 1))
    ahead = _added(space, seen, np.ones((70, 1)), forces, runs)
    assert ahead == pytest.approx(np.mean(2.0 * 3.0 / runs.right))
    # Estimates that disagree are chance, and add nothing.
    assert _added(space, seen, np.ones((70, 1)), forces * [1, -1], runs) == 0.0


def test_a_force_that_sensors_hide_is_as_large_as_its_law_says_lasting_part_and_white_one():
    space, fitted = resting([60], error=1e4)
    white, fresh, share = 0.04, 0.09, 0.8
    carrier = space.carrier[0, 0]
    steady = fresh / (1 - share**2)
    chains = fitted.linear.chains.with_memory(Memory(1, share))
    noise = normal_noise(chains, np.array([white, fresh]) / carrier**2, np.array([1e8, 1.0]))
    estimate = passed(chains, noise, space.real, covariances=True)
    lasting = replace(fitted, chains=chains, estimate=estimate, memory=Memory(1, share))
    (part,) = find_remainder(space, lasting, random_state=np.random.RandomState(0)).parts
    assert part.rms == pytest.approx(np.sqrt(white + steady), rel=1e-3)
    assert part.past == pytest.approx(share**2 * steady / (white + steady))
    assert part.word == "none"


def test_a_row_in_which_the_simulation_diverges_is_pushed_by_no_force():
    space, fitted = resting([12])
    valid = np.arange(12) != 5
    seen = Seen(replace(fitted.linear, valid=valid), fitted.chains, fitted.estimate, fitted.memory)
    own = _response(space, seen, np.ones((12, 1)), np.ones((12, 1)))
    whole = Seen(fitted.linear, fitted.chains, fitted.estimate, fitted.memory)
    expected = _response(space, whole, np.ones((12, 1)), valid[:, None].astype(float))
    np.testing.assert_allclose(own, expected, atol=1e-12)


def test_a_short_log_has_no_spectra():
    space, fitted = resting([31])
    frequencies, spectra = _white_spectra(
        space, fitted, SimpleNamespace(names=("x", "z")), np.random.RandomState(0)
    )
    assert [len(one) for one in (frequencies, *spectra)] == [0, 0, 0]


def test_an_acceleration_adds_ahead_what_it_moves_of_place_and_speed():
    """In h rows a speed gains h f dt, and a place h (h - 1) / 2 f dt^2, as the speed before a row moves it."""
    space = rolled([30, 40])
    linear = linearise(space, space.measured, {})
    noise = normal_noise(linear.chains, np.array([1e-6]), np.array([1e-8, 1e-6]))
    estimate = passed(linear.chains, noise, space.real, covariances=True)
    seen = Seen(linear, linear.chains, estimate, NO_MEMORY)
    h, forces = 10, np.tile([0.2, 0.3], (70, 1))
    runs = _runs(space, seen, {}, h)
    moved = np.array([h * (h - 1) / 2 * DT**2, h * DT])
    ahead = _added(space, seen, np.tile([0.0, DT], (70, 1)), forces, runs)
    assert ahead == pytest.approx(np.mean(0.2 * 0.3 * moved**2 / runs.right), rel=1e-5)


def test_a_white_force_that_sensors_show_has_a_flat_spectrum_and_one_they_hide_less_of_it():
    levels = []
    for error in (1e-4, 3.0):
        space, fitted = resting([600], error=error, force=1.0)
        directions = SimpleNamespace(names=("x",))
        frequencies, (spectrum,) = _white_spectra(space, fitted, directions, np.random.RandomState(0))
        levels.append(spectrum * frequencies[-1])
    # What is shown is the force over its deviation.
    assert levels[0].mean() == pytest.approx(1.0, rel=0.15)
    assert levels[0][1:20].mean() == pytest.approx(levels[0][-20:-1].mean(), rel=0.3)
    # Hidden from readings that scatter three times as far, most of all where it is fast.
    assert levels[1][-20:].mean() < 0.1 < levels[1][1:4].mean()


# -- what it looks like over time ------------------------------------------------------------------------------------


def test_power_adds_up_to_the_variance_and_stands_at_its_frequency():
    space = rolled([400, 256, 20])
    time = DT * np.arange(len(space.X))
    frequencies, power = _welch(space, np.sin(2 * np.pi * 12.5 * time))
    assert frequencies[-1] == pytest.approx(0.5 / DT)
    assert frequencies[np.argmax(power)] == pytest.approx(12.5)
    noise = np.random.default_rng(0).normal(size=len(time))
    frequencies, power = _welch(space, noise)
    assert power.sum() * frequencies[1] == pytest.approx(1.0, rel=0.15)
    timeless = rolled([400], simulator=rolling(dt=None))
    assert _welch(timeless, noise[:400])[0][-1] == pytest.approx(0.5)
    short = rolled([31, 20])
    assert [len(one) for one in _welch(short, noise[:51])] == [0, 0]
    enough = rolled([32, 20])
    assert len(_welch(enough, noise[:52])[0]) == 17


def test_a_spectrum_counts_long_episodes_for_more():
    space = rolled([384, 128])
    force = np.r_[np.zeros(384), np.random.default_rng(0).normal(size=128)]
    alone = rolled([128])
    whole, own = _welch(space, force)[1], _welch(alone, force[384:])[1]
    np.testing.assert_allclose(whole, own / 4, rtol=1e-9)


def test_a_force_that_shows_as_a_white_one_does_has_a_flat_spectrum_of_its_variance():
    space = rolled([512])
    unit = np.random.default_rng(0).normal(size=512)
    frequencies, shown = _welch(space, unit)
    same, spectrum = _spectrum(space, 3 * unit, frequencies, shown)
    np.testing.assert_array_equal(same, frequencies)
    np.testing.assert_allclose(spectrum, spectrum[0], rtol=1e-9)
    assert spectrum[0] * frequencies[-1] == pytest.approx(9.0)
    hidden = np.where(np.arange(len(shown)) < 3, 0.0, shown)
    assert (_spectrum(space, unit, frequencies, hidden)[1][:3] == 0).all()
    assert len(_spectrum(space, unit, np.zeros(0), np.zeros(0))[1]) == 0


FREQUENCIES = np.linspace(0, 50, 101)


def word(spectrum, force=None, frequencies=FREQUENCIES, unit="Hz"):
    force = np.ones(200) if force is None else force
    return word_of(np.asarray(force, float), frequencies, np.asarray(spectrum, float), unit)


def line(*powers):
    """Return a flat spectrum with some shares of its power, (frequency, share) each, in lines."""
    rest = 1 - sum(share for _, share in powers)
    spectrum = np.full(101, rest / 100)
    for frequency, share in powers:
        spectrum[np.searchsorted(FREQUENCIES, frequency)] += share
    return spectrum


def test_a_vibration_holds_most_of_its_power_near_one_frequency():
    assert word(line((20, 0.6))) == "vibration at 20 Hz"
    assert word(line((20, 0.6)), unit="per row") == "vibration at 20 per row"
    assert word(line((20, 0.3))) == "white"
    assert word(line((20, 0.31), (22.5, 0.29))) == "vibration at 21 Hz"
    assert word(line((20, 0.31), (25, 0.29))) == "white"
    # Of few bins from zero, the two beside it belong to it, and no more.
    assert word(line((5.5, 0.31), (6.5, 0.29))) == "vibration at 6 Hz"
    assert word(line((5.5, 0.31), (7.0, 0.29))) == "white"
    assert word(line((2.5, 0.3), (3.5, 0.29))) == "vibration at 3 Hz"


def test_what_is_slow_is_a_drift_and_no_vibration():
    assert word(line((0.5, 0.7))) == "drift"
    assert word(line((1.5, 0.7))) == "drift"
    assert word(line((1.0, 0.2), (3.0, 0.2), (5.0, 0.2))) == "drift"
    assert word(line((1.0, 0.2), (3.0, 0.2), (8.0, 0.2))) == "white"
    # What does not change at all over a segment is told by none.
    assert word(np.r_[1e6, np.ones(100)]) == "white"


def test_impacts_hold_most_of_the_square_in_one_row_of_fifty():
    few = np.r_[np.full(4, 10.0), np.ones(196)]
    assert word(np.ones(101), few) == "impacts"
    assert word(line((20, 0.6)), few) == "impacts"
    assert word(np.ones(101), np.r_[np.full(9, 10.0), np.zeros(191)]) == "white"
    assert word(np.ones(101), np.r_[10.0, np.ones(20)]) == "impacts"


def test_of_no_force_or_too_short_a_log_there_is_no_more_to_say():
    assert word(np.ones(101), np.zeros(200)) == "none"
    assert word(np.zeros(101)) == "white"
    assert word([], frequencies=np.zeros(0)) == "white"
    assert word([2.0], frequencies=np.zeros(1)) == "white"
    assert word([], np.zeros(5), frequencies=np.zeros(0)) == "none"
