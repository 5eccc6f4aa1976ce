"""What no effect explains comes back from rows that were drawn with it, and is nothing between logs that move alike."""

from dataclasses import replace

import numpy as np
import pytest

from skat.diagnosis.changes.candidates import Model
from skat.diagnosis.changes.force_space import Motion, Rows, joined, smooth_squares
from skat.diagnosis.changes.law import APART, Law, _of_sensors, _unlike, settled_law, variance_apart
from skat.diagnosis.changes.motions import Half, coefficients_of, half_of, lacking_forces, rows_about
from tests.diagnosis.changes.arm import arm, effect_of
from tests.diagnosis.changes.test_force_space import log_of

VALUE, SPREAD, NOISE = np.array([2.0, -0.5, 0.1]), np.array([0.8, 0.4, 0.0]) ** 2, np.array([0.5, 2.0])


def drawn_side(rng, value, *, windows=40, n=20):
    """Return rows of two joints, in windows each of which has effects of its own."""
    stretch, joint = np.repeat(np.arange(windows), n), np.tile([0, 1], windows * n // 2)
    columns = rng.normal(size=(windows * n, 3))
    own = value + np.sqrt(SPREAD) * rng.normal(size=(windows, 3))
    target = np.sum(columns * own[stretch], axis=1) + NOISE[joint] * rng.normal(size=windows * n)
    frequency = rng.uniform(0.1, 1.0, windows * n)
    return Rows(target, columns, joint, frequency, stretch, np.ones(windows * n))


@pytest.fixture(scope="module")
def settled():
    rng = np.random.default_rng(0)
    sides = [drawn_side(rng, VALUE), drawn_side(rng, VALUE + np.array([0.0, 3.0, 0.0]))]
    return sides, settled_law(sides)


def test_noise_of_each_joint_comes_back(settled):
    sides, law = settled
    for rows, noise in zip(sides, law.noise, strict=True):
        for joint in (0, 1):
            own = noise[rows.joint == joint]
            np.testing.assert_allclose(own, NOISE[joint], rtol=0.3)
            assert np.mean(own) == pytest.approx(NOISE[joint], rel=0.05)


def test_variances_between_windows_come_back_and_a_change_makes_none(settled):
    _, law = settled
    np.testing.assert_allclose(law.spread[:2], SPREAD[:2], rtol=0.25)
    assert law.spread[2] < 0.01


def test_what_is_common_comes_back(settled):
    _, law = settled
    # Of 40 windows of the first log for what changed, of both for what did not.
    np.testing.assert_allclose(law.value, VALUE, atol=0.4)
    np.testing.assert_allclose(law.value[2], VALUE[2], atol=0.08)
    np.testing.assert_allclose(law.weights, 2 / (1 + law.value**2), rtol=1e-9)
    np.testing.assert_array_equal(law.apart, 0.0)


def test_noise_and_variances_are_unbiased_of_few_rows():
    found = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        law = settled_law([drawn_side(rng, VALUE, windows=8, n=8) for _ in range(2)])
        noise = [float(np.mean(np.concatenate(law.noise)[np.tile([0, 1], 64) == joint])) for joint in (0, 1)]
        found.append([*noise, *law.spread[:2]])
    mean, error = np.mean(found, axis=0), np.std(found, axis=0)[2:] / np.sqrt(len(found))
    np.testing.assert_allclose(mean[:2], NOISE, rtol=0.1)
    assert (np.abs(mean[2:] - SPREAD[:2]) < 3 * error + 0.02).all()


def test_windows_that_tell_nothing_leave_the_least_that_they_differ_by():
    rng = np.random.default_rng(1)
    sides = [drawn_side(rng, VALUE) for _ in range(2)]
    faint = [replace(side, columns=side.columns * [1.0, 1.0, 1e-6]) for side in sides]
    assert settled_law(faint).spread[2] == pytest.approx(0.1**2, rel=1e-3)


def half_of_places(places, *, speeds=None, pulls=None):
    """Return a log of one joint that is at one place in each window."""
    n = len(places)
    speeds, pulls = (np.ones(n) if one is None else np.asarray(one) for one in (speeds, pulls))
    motion = Motion(
        states=np.column_stack([places, speeds]).repeat(2, axis=0),
        accelerations=pulls[:, None].repeat(2, axis=0),
        commands=np.zeros((2 * n, 0)),
        episodes=np.zeros(2 * n, int),
        rows=np.arange(2 * n)[:, None],
        stretches=np.arange(n).repeat(2),
        duration=0.01,
        slip=np.zeros(1),
        cutoff=np.ones(1),
        anew=(),
    )
    return Half(motion, np.full((2 * n, 1), np.nan))


def test_logs_that_move_alike_are_not_unlike():
    one = half_of_places([0.0, 1.0, 2.0], speeds=[1.0, 2.0, 3.0])
    np.testing.assert_array_equal(_unlike([one, one]), 0.0)


def test_motions_are_unlike_by_the_share_of_their_variance_that_is_between_logs():
    # Within: squares of 2 and 2 over 4 degrees of freedom. Between: half of 9, less half of 1 / 3 + 1 / 3.
    halves = half_of_places([-1.0, 0.0, 1.0]), half_of_places([2.0, 3.0, 4.0])
    between = 0.5 * 9 - 0.5 * 1.0 * (2 / 3)
    assert _unlike(halves)[0] == pytest.approx(between / (between + 1.0), rel=1e-9)


@pytest.mark.parametrize("what", ["speeds", "pulls"])
def test_how_fast_a_motion_is_counts_by_its_logarithm(what):
    halves = [
        half_of_places(np.zeros(3), **{what: factor * np.exp([-1.0, 0.0, 1.0])}) for factor in (1, np.exp(3))
    ]
    between = 0.5 * 9 - 0.5 * 1.0 * (2 / 3)
    assert _unlike(halves)[0] == pytest.approx(between / (between + 1.0), rel=1e-6)


@pytest.fixture(scope="module")
def logs():
    simulator = arm()
    halves = [half_of(simulator, log_of(seed, damping=(0.1, 0.05)), "log") for seed in (4, 5)]
    effects = [effect_of(simulator, name) for name in ("damping[elbow]", "mass[lower]", "scale[qvel.elbow]")]
    sides = [rows_about(simulator, half, Model({}), effects, np.array([0.3, 0.2, 0.02])) for half in halves]
    return simulator, halves, sides


def law_of(sides, deviation, spread=0.0):
    k = sides[0].columns.shape[1]
    noise = tuple(np.full(len(side.target), deviation) for side in sides)
    return Law(noise, np.full(k, spread), np.ones(k), np.zeros(k), np.zeros(k))


def test_logs_whose_windows_are_alike_are_not_apart(logs):
    simulator, halves, sides = logs
    law = law_of(sides[:1] * 2, 10.0, spread=1.0)
    np.testing.assert_allclose(variance_apart(simulator, halves[:1] * 2, sides[:1] * 2, law), 0.0, atol=1e-9)


def test_logs_are_apart_by_what_windows_are_and_by_what_is_left_of_a_joints_force(logs):
    simulator, halves, sides = logs
    rows, unlike = joined(sides), np.tile(_unlike(halves), 2)
    read = _of_sensors(simulator, halves, rows)
    found = variance_apart(simulator, halves, sides, law_of(sides, 10.0, spread=0.3))
    assert (unlike > 0.01).any()
    # The first and the last act on one joint alone: its force, and its speed.
    for effect, joint in ((0, 1), (2, 3)):
        own = rows.joint == joint
        squares = rows.columns[own, effect] ** 2
        worst = own.sum() * np.sum((10.0**2 - read[own]) * squares) / squares.sum() ** 2
        assert found[effect] == pytest.approx(APART * unlike[joint] * (0.3 + worst), rel=1e-6)


def test_logs_are_further_apart_where_more_is_left(logs):
    simulator, halves, sides = logs
    less, more = (variance_apart(simulator, halves, sides, law_of(sides, one)) for one in (10.0, 20.0))
    apart = less > 1e-9
    assert apart.any()
    assert (more[apart] > 2 * less[apart]).all()


def test_an_effect_that_several_joints_feel_would_have_to_look_alike_on_each(logs):
    simulator, halves, sides = logs
    law = law_of(sides, 10.0)

    def worst(chosen):
        """Return what mass is apart by as if it acted on these joints alone, over that of the joint it is felt on."""
        some = [replace(side, columns=side.columns * np.isin(side.joint, chosen)[:, None]) for side in sides]
        return variance_apart(simulator, halves, some, law)[1] / unlike[chosen[0]]

    unlike = _unlike(halves)
    # Precisions add; the joint that feels it most is the shoulder.
    assert 1 / worst([0, 1]) == pytest.approx(1 / worst([0]) + 1 / worst([1]), rel=1e-6)


def test_what_sensors_make_of_noise_is_no_misfit(logs):
    simulator, halves, sides = logs
    read = _of_sensors(simulator, halves, joined(sides))
    first = len(sides[0].target)
    law = replace(law_of(sides, 1.0), noise=(np.sqrt(read[:first]), np.sqrt(read[first:])))
    np.testing.assert_allclose(variance_apart(simulator, halves, sides, law), 0.0, atol=1e-9)


def test_the_noise_of_sensors_is_by_how_much_forces_differ_that_were_read_anew(logs):
    simulator, halves, sides = logs
    squares = []
    for half in halves:
        motion = half.motion
        motions = [motion, *(replace(motion, states=q, accelerations=a) for q, a in motion.anew[:2])]
        read, first, second = (
            coefficients_of(half, lacking_forces(simulator, replace(half, motion=one), [Model({})]))[0][:, 0]
            for one in motions
        )
        squares.append(0.5 * ((first - read) ** 2 + (second - read) ** 2))
    twice = [replace(half, motion=replace(half.motion, anew=half.motion.anew[:2])) for half in halves]
    rows = joined(sides)
    expected = smooth_squares(rows, np.concatenate(squares))
    np.testing.assert_allclose(_of_sensors(simulator, twice, rows), expected, rtol=1e-6)
