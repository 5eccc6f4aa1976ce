"""What no effect explains comes back from rows that were drawn with it; misfit may look like effects, by hand."""

from dataclasses import replace

import numpy as np
import pytest

from skat.diagnosis.changes.law import Law, settled_law, with_misfit
from skat.diagnosis.forces.force_space import Rows, joined

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
    assert law.alike.shape == (0, 3)


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


def with_noise(noise):
    return Law(noise, np.zeros(3), np.ones(3), np.zeros(3), np.zeros(3), np.zeros((0, 3)))


def test_misfit_looks_like_an_effect_as_much_as_noise_at_its_frequencies_does():
    columns = np.array([[1.0, 0.0, 0.0], [3.0, 0.0, 1.0], [2.0, 5.0, 0.0]])
    one, joint = np.ones(3), np.array([0, 0, 1])
    rows = Rows(one, columns, joint, one, np.zeros(3, int), one)
    noise = np.array([0.5, 2.0, 3.0])
    law = with_misfit([rows.part(one > 2), rows], with_noise((np.zeros(0), noise)))
    first = 10.0**2 / (2 * (0.25 * 1 + 4 * 9))
    np.testing.assert_allclose(law.alike, [[first, 0.0, 1 / (2 * 4.0)], [4 / 9.0, 25 / 9.0, 0.0]])


def test_precision_of_misfit_is_that_of_both_logs_for_each_joint_and_effect():
    rng = np.random.default_rng(3)
    sides = [drawn_side(rng, VALUE, windows=windows) for windows in (3, 5)]
    noise = tuple(rng.uniform(0.5, 2, len(side.target)) for side in sides)
    law = with_misfit(sides, with_noise(noise))
    rows, squares = joined(sides), np.concatenate(noise) ** 2
    for joint in (0, 1):
        own = rows.joint == joint
        for effect in range(3):
            x = rows.columns[own, effect]
            expected = np.sum(x**2) ** 2 / (own.sum() * np.sum(squares[own] * x**2))
            assert law.alike[joint, effect] == pytest.approx(expected, rel=1e-12)


def test_misfit_of_noise_alike_is_as_wide_as_a_force_of_its_size_on_all_of_a_joint():
    # An effect that exerts its unit on each row, of noise 2: misfit has a variance of 4, however long logs are.
    for n in (10, 1000):
        zeros = np.zeros(n)
        rows = Rows(zeros, np.ones((n, 3)), zeros.astype(int), zeros, zeros.astype(int), zeros)
        law = with_misfit([rows, rows], with_noise((np.full(n, 2.0), np.full(n, 2.0))))
        np.testing.assert_allclose(law.alike, 0.25)
