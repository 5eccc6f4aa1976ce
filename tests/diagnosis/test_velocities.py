"""Velocities that were computed from positions are told from measured ones."""

import numpy as np
import pytest
from scipy import signal

from skat.diagnosis.velocities import is_computed

DT = 0.01


def motion(rng, n=400):
    times = np.arange(n) * DT
    phases = rng.uniform(0, 6, 4)
    rates = rng.uniform(1, 15, 4)
    return np.sin(rates * times[:, None] + phases).sum(axis=1), (
        rates * np.cos(rates * times[:, None] + phases)
    ).sum(axis=1)


def causal(read):
    return signal.lfilter(*signal.butter(2, 0.1), np.diff(read, prepend=read[:1]) / DT)


def zero_phase(read):
    return signal.filtfilt(*signal.butter(2, 0.3), np.gradient(read, DT))


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("noise", [1e-4, 1e-2], ids=["little noise", "much noise"])
def test_a_measured_velocity_is_no_computed_one(seed, noise):
    rng = np.random.default_rng(seed)
    angle, rate = motion(rng)
    read = angle + noise * rng.normal(size=len(angle))
    # A sensor may be better than any difference of positions.
    for error in (1e-3, 0.5):
        assert not is_computed(read, rate + error * rng.normal(size=len(rate)), np.zeros(len(rate)))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(
    "made", [lambda read: np.gradient(read, DT), causal, zero_phase], ids=["central", "causal", "zero"]
)
def test_a_computed_velocity_is_found(seed, made):
    rng = np.random.default_rng(seed)
    angle, _ = motion(rng)
    for read in (angle + 1e-3 * rng.normal(size=len(angle)), np.round(angle / 4e-4) * 4e-4):
        assert is_computed(read, made(read), np.zeros(len(read)))


def test_lost_samples_and_several_episodes_change_nothing():
    rng = np.random.default_rng(0)
    pieces = [motion(rng, 150)[0] + 1e-3 * rng.normal(size=150) for _ in range(4)]
    read, made = np.concatenate(pieces), np.concatenate([np.gradient(piece, DT) for piece in pieces])
    lost = rng.random(600) < 0.02
    read[lost] = made[lost] = np.nan
    assert is_computed(read, made, np.repeat(np.arange(4), 150))


def test_few_rows_leave_it_open():
    angle, _ = motion(np.random.default_rng(0))
    assert not is_computed(angle[:30], np.gradient(angle[:30], DT), np.zeros(30))
