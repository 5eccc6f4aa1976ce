"""The smoother of a coordinate against dense regressions: states, errors, noise, likelihood, and what it keeps."""

import numpy as np
import pytest
from scipy import linalg

from skat.diagnosis.forces.smoothing import STEP, TRANSITION, Smooth, _posterior, smooth_coordinate

DT = 0.02
PUSHES = np.linalg.inv(STEP)


def walk(lengths, *, jerk=1e-3, sigma=0.1, seed=0):
    """Return readings of positions of integrated random walks, and the episode of each."""
    rng, positions = np.random.default_rng(seed), []
    root = sigma * np.sqrt(jerk) * np.linalg.cholesky(PUSHES)
    for length in lengths:
        state = rng.normal(size=3) * [1.0, 0.3, 0.03]
        for _ in range(length):
            positions.append(state[0] + sigma * rng.normal())
            state = TRANSITION @ state + root @ rng.normal(size=3)
    return np.array(positions), np.repeat(np.arange(len(lengths)), lengths)


def dense(positions, episodes, jerk):
    """Return the states (n, 3), their covariance and the variance of readings, by least squares over all of them."""
    n, seen = len(positions), np.isfinite(positions)
    rows, right = [np.eye(3 * n)[::3][seen]], [positions[seen]]
    root = np.linalg.cholesky(STEP).T / np.sqrt(jerk)
    for instant in np.flatnonzero(episodes[1:] == episodes[:-1]):
        block = np.zeros((3, 3 * n))
        block[:, 3 * instant : 3 * instant + 6] = np.hstack([-root @ TRANSITION, root])
        rows.append(block)
        right.append(np.zeros(3))
    A, b = np.concatenate(rows), np.concatenate(right)
    states = np.linalg.lstsq(A, b, rcond=None)[0]
    sigma2 = np.sum((b - A @ states) ** 2) / (seen.sum() - 3 * len(np.unique(episodes)))
    return states.reshape(n, 3), np.linalg.inv(A.T @ A) * sigma2, sigma2


@pytest.mark.parametrize("lost", [[], [3, 4, 20, 36], [0, 36]])
def test_states_and_their_errors_are_those_of_least_squares(lost):
    positions, episodes = walk([14, 23], jerk=0.3)
    positions[lost] = np.nan
    smooth = smooth_coordinate(positions, episodes, DT)
    states, covariance, sigma2 = dense(positions, episodes, smooth.jerk)
    np.testing.assert_allclose(smooth.position, states[:, 0], atol=1e-6)
    np.testing.assert_allclose(smooth.velocity, states[:, 1] / DT, atol=1e-5 / DT)
    np.testing.assert_allclose(smooth.acceleration, 2 * states[:, 2] / DT**2, atol=1e-4 / DT**2)
    assert smooth.position_noise == pytest.approx(np.sqrt(sigma2), rel=1e-6)
    middle = 14 + 23 // 2  # of the longest episode
    error = np.sqrt(covariance[3 * middle + 1, 3 * middle + 1]) / DT
    assert smooth.velocity_error == pytest.approx(error, rel=1e-5)


def test_variances_are_chosen_by_the_restricted_likelihood():
    """Of readings about a parabola of each episode, from their dense covariance; but for what is always the same."""
    positions, episodes = walk([9, 12])
    seen = np.ones(21, dtype=bool)
    seen[[2, 15]] = False
    joined = episodes[1:] == episodes[:-1]

    def reference(jerk):
        blocks, bases = [], []
        for length in (9, 12):
            powers = [np.linalg.matrix_power(TRANSITION, step) for step in range(length)]
            covariance = np.eye(length)
            for one in range(length):
                for other in range(length):
                    for push in range(min(one, other)):
                        both = powers[one - 1 - push] @ PUSHES @ powers[other - 1 - push].T
                        covariance[one, other] += jerk * both[0, 0]
            blocks.append(covariance)
            bases.append(np.array(powers)[:, 0])
        V, B = linalg.block_diag(*blocks)[np.ix_(seen, seen)], linalg.block_diag(*bases)[seen]
        y = positions[seen]
        information = B.T @ np.linalg.solve(V, B)
        left = y - B @ np.linalg.solve(information, B.T @ np.linalg.solve(V, y))
        degrees = len(y) - B.shape[1]
        squares = left @ np.linalg.solve(V, left) / degrees
        return np.linalg.slogdet(V)[1] + np.linalg.slogdet(information)[1] + degrees * np.log(
            squares
        ), squares

    places = [1e-4, 1e-3, 1e-1, 1e2]
    own = [_posterior(positions, seen, joined, jerk) for jerk in places]
    expected = [reference(jerk) for jerk in places]
    np.testing.assert_allclose([one[3] for one in own], [one[1] for one in expected], rtol=1e-6)
    differences = np.array([one[0] for one in own]) - [one[0] for one in expected]
    np.testing.assert_allclose(differences, differences[0], atol=1e-5)


@pytest.mark.parametrize("jerk", [1e-4, 1e-1])
def test_variances_of_a_long_log_come_back_and_are_the_likeliest(jerk):
    positions, episodes = walk([500, 500], jerk=jerk, sigma=0.1)
    smooth = smooth_coordinate(positions, episodes, DT)
    assert smooth.position_noise == pytest.approx(0.1, rel=0.1)
    assert np.log(smooth.jerk / jerk) == pytest.approx(0.0, abs=0.7)
    joined, seen = episodes[1:] == episodes[:-1], np.ones(1000, dtype=bool)
    best, *others = (
        _posterior(positions, seen, joined, smooth.jerk * factor)[0] for factor in (1.0, 0.7, 1.4)
    )
    assert best < min(others) + 0.1


@pytest.mark.parametrize("jerk", [1e-2, 1.0, 30.0])
@pytest.mark.parametrize("frequency", [1.0, 3.0, 6.0])
def test_of_a_motion_the_share_is_kept_that_least_squares_keep(jerk, frequency):
    motion = np.sin(2 * np.pi * frequency * DT * np.arange(160))
    states, _, _ = dense(motion, np.zeros(160), jerk)
    inner = slice(50, 110)
    share = states[inner, 0] @ motion[inner] / (motion[inner] @ motion[inner])
    assert Smooth(*[np.zeros(0)] * 3, 0.0, 1.0, jerk).kept(frequency, DT) == pytest.approx(share, abs=0.02)


def test_the_cutoff_is_the_highest_frequency_of_which_a_share_is_kept():
    """Of three quarters a third is lost: the sixth power of the angle in a row is a third of the jerk's variance."""
    smooth = Smooth(*[np.zeros(0)] * 3, 0.0, 1.0, 0.05)
    cutoff = smooth.cutoff(0.75, DT)
    step = 0.5 / DT / 2000
    assert cutoff <= (0.05 / 3) ** (1 / 6) / (2 * np.pi * DT) < cutoff + step
    assert Smooth(*[np.zeros(0)] * 3, 0.0, 1.0, 1e9).cutoff(0.75, DT) == 0.5 / DT


@pytest.mark.parametrize("n", [2, 3])
def test_three_readings_of_each_episode_tell_how_a_coordinate_moves(n):
    positions, episodes = walk([6, 5])
    positions[6 + n :] = np.nan
    if n < 3:
        with pytest.raises(ValueError, match="fewer than 3 readings of a coordinate; it takes 3"):
            smooth_coordinate(positions, episodes, DT)
    else:
        assert np.isfinite(smooth_coordinate(positions, episodes, DT).position).all()
