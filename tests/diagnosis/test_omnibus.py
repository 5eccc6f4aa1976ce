"""What outlasts single rows is found, and only where most episodes show it."""

import numpy as np

from skat.diagnosis.log import Log
from skat.diagnosis.omnibus import TIME, _persistence


class Rows:
    """As much of residuals as the test of persistence needs: episodes and names."""

    log = Log(np.zeros((1000, 1)), np.zeros((1000, 1)), np.repeat(np.arange(20), 50), True)

    class simulator:
        residual_names = ("a", "b")


def test_persistence_is_uniform_for_noise_with_heavy_tails():
    p_values = [
        p
        for seed in range(200)
        for _, _, p in _persistence(Rows, np.random.default_rng(seed).standard_t(4, (1000, 2)))
    ]
    # A standard deviation of the share is 0.011 at 5 %.
    assert 0.02 < np.mean(np.array(p_values) < 0.05) < 0.09
    assert np.mean(np.array(p_values) < 0.001) < 0.01


def test_periodic_remainder_is_found_in_its_channel():
    white = np.random.default_rng(0).normal(size=(1000, 2))
    white[:, 1] += np.sin(np.arange(1000) / 3)
    (_, _, quiet), (name, what, loud) = _persistence(Rows, white)
    assert (name, what) == ("b", TIME)
    assert loud < 1e-4 < quiet


def test_one_contact_whose_linearisation_failed_does_not_count_as_lasting():
    white = np.random.default_rng(0).normal(size=(1000, 2))
    white[200:230, 1] += 5.0
    assert all(p > 0.05 for _, _, p in _persistence(Rows, white))
