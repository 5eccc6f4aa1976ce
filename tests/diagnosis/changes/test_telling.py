"""What is told of two logs: by hand, of questions that are made up."""

import numpy as np
import pytest

from skat.diagnosis.changes.law import Law
from skat.diagnosis.changes.question import Question
from skat.diagnosis.changes.telling import causes_of, gain_of, sizes_of
from skat.diagnosis.evidence import Gram, Priors, Weigher
from skat.diagnosis.forces.force_space import Rows
from skat.diagnosis.forces.machines import Candidate, Model
from tests.diagnosis.changes.arm import arm, effect_of


@pytest.fixture(scope="module")
def simulator():
    return arm()


def made_up(simulator, names, scales, *, sides=(None, None), noise=(None, None), held_out=None, beside=None):
    candidates = tuple(
        Candidate(effect_of(simulator, name), 1.0, (beside or {}).get(name, {})) for name in names
    )
    k = 0 if sides[0] is None else sides[0].columns.shape[1]
    law = Law(noise, np.zeros(k), np.ones(k), np.zeros(k), np.zeros(k), np.zeros((0, k)))
    effects = tuple(effect_of(simulator, "damping[elbow]") for _ in range(k))
    return Question(
        simulator=simulator,
        halves=(),
        base=Model({}),
        effects=effects,
        candidates=candidates,
        sizes=np.ones(k),
        scales=np.array(scales),
        here=np.zeros(k),
        sides=sides,
        later=np.zeros((0 if sides[0] is None else len(sides[0].target), 0)),
        law=law,
        held_out=held_out,
    )


def weigher(products, projections):
    k = len(projections)
    priors = Priors(("",) * k, np.ones(k), np.full(k, -np.log(k + 1.0)), np.full(k, -50.0), np.full(k, 50.0))
    return Weigher(Gram(np.array(products), np.array(projections), np.zeros(k)), priors)


NAMES = ["damping[elbow]", "mass[lower]", "gain[elbow]"]


def test_values_and_intervals_are_told_in_units_of_effects(simulator):
    worth = weigher(np.diag([4e4, 1e4, 1e4]), [4e4, 2e4, 1e4])
    best = worth((0, 1, 2))
    nats = {0: 30.0, 1: 50.0, 2: 40.0}
    found = causes_of(made_up(simulator, NAMES, [0.3, 0.2, 0.1]), best, worth, nats)
    # Most telling first.
    assert [cause.name for cause in found] == ["mass[lower]", "gain[elbow]", "damping[elbow]"]
    assert [cause.evidence for cause in found] == [50.0, 40.0, 30.0]
    error = 1 / np.sqrt(np.diag(best.curvature))
    ends = np.array([-1.96, 0.0, 1.96])
    damping, mass, gain = (value + ends * one for value, one in zip(best.values, error))
    for cause, told in zip(found, (1 + 0.2 * mass, 1 + 0.1 * gain, 0.3 * damping), strict=True):
        np.testing.assert_allclose([cause.interval[0], cause.value, cause.interval[1]], told, rtol=1e-9)
        assert cause.aliases == ()
    assert [cause.probability for cause in found] == pytest.approx([1.0, 1.0, 1.0])
    assert [(cause.family, cause.target, cause.unit) for cause in found[::2]] == [
        ("mass", "lower", "1"), ("damping", "elbow", "N m s/rad"),
    ]  # fmt: skip


def test_a_change_that_is_hardly_worth_its_name_is_as_probable_as_its_odds(simulator):
    worth = weigher(np.diag([1e4, 1e4, 1e4]), [1e4, 0.0, 0.0])
    (cause,) = causes_of(made_up(simulator, NAMES, [0.3, 0.2, 0.1]), worth((0,)), worth, {0: np.log(4.0)})
    assert cause.probability == pytest.approx(0.8)


def test_nothing_is_told_of_no_change(simulator):
    worth = weigher(np.eye(3), np.zeros(3))
    assert causes_of(made_up(simulator, NAMES, np.ones(3)), worth(()), worth, {}) == ()


def test_what_could_stand_in_a_changes_place_is_its_alias(simulator):
    # The first two act alike; what is there is between them, and a little nearer to the first.
    N = np.array([[100.0, 99.0, 0.0], [0.0, 14.0, 0.0], [0.0, 0.0, 100.0]])
    worth = weigher(N.T @ N, N.T @ [99.76, 6.915, 0.0])
    best, other = worth((0,)), worth((1,))
    (cause,) = causes_of(made_up(simulator, NAMES, [0.3, 0.2, 0.1]), best, worth, {0: 50.0})
    lost = best.evidence - other.evidence
    assert 0 < lost < np.log(20)
    (alias,) = cause.aliases
    assert alias.name == "mass[lower]"
    assert alias.probability == pytest.approx(np.exp(-lost) / (1 + np.exp(-lost)), rel=1e-9)
    assert cause.probability == pytest.approx(1 / (1 + np.exp(-lost)), rel=1e-9)


def test_what_is_less_likely_by_twenty_times_is_no_alias(simulator):
    N = np.array([[100.0, 99.0, 0.0], [0.0, 14.0, 0.0], [0.0, 0.0, 100.0]])
    worth = weigher(N.T @ N, N.T @ [99.76, 6.6, 0.0])
    assert np.log(20) < worth((0,)).evidence - worth((1,)).evidence < np.log(400)
    (cause,) = causes_of(made_up(simulator, NAMES, [0.3, 0.2, 0.1]), worth((0,)), worth, {0: 50.0})
    assert cause.aliases == ()


def test_another_place_of_a_weight_is_no_alias_of_it(simulator):
    N = np.array([[100.0, 99.0], [0.0, 14.0]])
    worth = weigher(N.T @ N, N.T @ [99.76, 6.915])
    question = made_up(simulator, ["payload[lower]", "payload[lower]"], [0.3, 0.3])
    (cause,) = causes_of(question, worth((0,)), worth, {0: 50.0})
    assert cause.aliases == ()


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("mass[lower]", 0.25, "the mass of lower is 1.25 times what it was"),
        ("damping[elbow]", 0.25, "viscous damping of elbow: 0.25 N m s/rad more than it was"),
        ("damping[elbow]", -0.25, "viscous damping of elbow: 0.25 N m s/rad less than it was"),
        ("payload[lower]", 0.25, "a weight on lower: 0.25 kg more than it was, about at (0.1, -0.2) m"),
        ("load_friction[elbow]", 0.25, "friction of elbow per load on its gear: 0.25 more than it was"),
    ],
)
def test_a_sentence_tells_the_value_as_it_is_counted(simulator, name, value, sentence):
    worth = weigher([[1e8]], [1e8 * value])
    beside = {"payload[lower]": {"payload[lower.x]": 0.1, "payload[lower.z]": -0.2}}
    (cause,) = causes_of(made_up(simulator, [name], [1.0], beside=beside), worth((0,)), worth, {0: 9.0})
    assert cause.sentence == sentence


def side(rng, n_windows, n=6, columns=2):
    joint, stretch = np.tile([0, 1], n_windows * n // 2), np.repeat(np.arange(n_windows), n)
    return Rows(
        rng.normal(size=len(joint)), rng.normal(size=(len(joint), columns)), joint, np.ones(len(joint)), stretch,
        rng.normal(size=len(joint)),
    )  # fmt: skip


VALUE, DIFFERENCE = np.array([0.7]), np.array([-1.3])


def asked(simulator, held_windows):
    """Return a question of one effect and one candidate, and the second log's rows that are held out."""
    rng = np.random.default_rng(0)
    first, second = side(rng, 3, columns=1), side(rng, 9)
    noise = np.full(len(first.target), 0.5), rng.uniform(0.2, 0.4, len(second.target))
    held = np.isin(second.stretch, held_windows)
    return made_up(simulator, ["mass[lower]"], [0.2], sides=(first, second), noise=noise, held_out=held), held


def test_the_gain_is_the_mean_square_over_the_noise_of_windows_held_out(simulator):
    question, held = asked(simulator, [1, 3, 4, 6, 7])
    gain, rows, noise = gain_of(question, VALUE, DIFFERENCE), question.sides[1], question.law.noise[1]
    nominal = rows.target - rows.columns[:, 0] * VALUE
    extended = nominal - rows.columns[:, 1] * DIFFERENCE
    squares = [np.mean((one / noise)[held] ** 2) for one in (nominal, extended)]
    assert (gain.nominal, gain.extended, gain.floor, gain.horizon) == pytest.approx((*squares, 1.0, 0.0))
    assert gain.explained == pytest.approx((squares[0] - squares[1]) / (squares[0] - 1))
    assert list(gain.channels) == ["qvel.shoulder", "qvel.elbow"]
    for joint, channel in enumerate(gain.channels.values()):
        own = held & (rows.joint == joint)
        rms = [np.sqrt(np.mean(one[own] ** 2)) for one in (nominal, extended)]
        assert channel == pytest.approx(rms)
    low, high = gain.interval
    assert low < gain.explained < high


def test_the_interval_of_the_gain_is_that_of_windows_drawn_again(simulator):
    question, _ = asked(simulator, [1, 3, 4, 6, 7])
    rows, noise = question.sides[1], question.law.noise[1]
    nominal = (rows.target - rows.columns[:, 0] * VALUE) / noise
    extended = nominal - rows.columns[:, 1] * DIFFERENCE / noise
    windows = [(rows.stretch == one) for one in (1, 3, 4, 6, 7)]
    sums = np.array([[np.mean(one[own] ** 2) for one in (nominal, extended)] for own in windows])
    drawn = sums[np.random.default_rng(7).integers(5, size=(20000, 5))].mean(axis=1)
    expected = np.percentile((drawn[:, 0] - drawn[:, 1]) / (drawn[:, 0] - 1), [2.5, 97.5])
    width = expected[1] - expected[0]
    np.testing.assert_allclose(gain_of(question, VALUE, DIFFERENCE).interval, expected, atol=0.15 * width)


def test_few_windows_have_a_gain_without_an_interval_and_none_has_none(simulator):
    assert np.isnan(gain_of(asked(simulator, [1, 3, 4, 6])[0], VALUE, DIFFERENCE).interval).all()
    assert gain_of(asked(simulator, [])[0], VALUE, DIFFERENCE) is None


def test_nothing_is_explained_where_no_more_than_noise_is_left(simulator):
    question, _ = asked(simulator, [1, 3, 4, 6, 7])
    quiet = question.sides[1].target * 100
    question.law.noise[1][:] = np.abs(quiet) + 100
    assert gain_of(question, VALUE, DIFFERENCE).explained == 0.0


def test_sizes_are_those_of_both_logs_before_and_after_what_is_common(simulator):
    question, _ = asked(simulator, [])
    found = sizes_of(question, VALUE)
    assert list(found) == ["qvel.shoulder", "qvel.elbow"]
    for joint, (nominal, left) in enumerate(found.values()):
        sides = [(side, side.joint == joint) for side in question.sides]
        whole = np.concatenate([side.nominal[own] for side, own in sides])
        rest = np.concatenate([(side.target - side.columns[:, 0] * VALUE)[own] for side, own in sides])
        assert nominal == pytest.approx(np.sqrt(np.mean(whole**2)))
        assert left == pytest.approx(np.sqrt(np.mean(rest**2)))
