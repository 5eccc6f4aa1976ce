import time

import numpy as np
import pytest
from sklearn.utils import Bunch

from skat.episodes import split_episodes


@pytest.mark.parametrize("n_groups", [1, 2, 7, None])
def test_a_split_is_a_partition_by_whole_episodes(n_groups):
    groups = None if n_groups is None else np.repeat(np.arange(n_groups), 140 // n_groups)
    log = Bunch(data=np.arange(140.0)[:, None], target=np.arange(140.0)[:, None], groups=groups, dt=0.1)
    fit, test = split_episodes(log, test_size=0.5, random_state=0)
    assert sorted([*fit.data[:, 0], *test.data[:, 0]]) == list(range(140))
    assert min(len(fit.data), len(test.data)) >= 60
    assert fit.dt == 0.1
    if n_groups == 1:
        assert fit.data.max() < test.data.min()
    elif n_groups:
        assert not set(fit.groups) & set(test.groups)


def test_a_split_counts_rows_and_leaves_enough_to_fit():
    for seed in range(10):
        log = Bunch(data=np.zeros((315, 1)), target=np.zeros((315, 1)), groups=np.repeat([0, 1], [300, 15]))
        with pytest.warns(UserWarning, match="Only 15 of 315 rows are set aside") as caught:
            fit, test = split_episodes(log, test_size=0.3, random_state=seed)
        assert caught[0].filename == __file__
        assert (len(fit.data), len(test.data)) == (300, 15)
        fit, _ = split_episodes(
            Bunch(data=np.zeros((25, 1)), target=np.zeros((25, 1)), groups=np.zeros(25)), test_size=0.3
        )
        assert len(fit.data) == 20


def test_the_time_of_a_split_is_linear_in_the_number_of_episodes():
    log = Bunch(data=np.zeros((40_000, 1)), target=np.zeros((40_000, 1)))
    start = time.process_time()
    _, test = split_episodes(log, test_size=0.5, random_state=0)
    assert time.process_time() - start < 2
    assert len(test.data) == 20_000


def test_a_split_that_leaves_a_side_empty_is_refused():
    log = Bunch(data=np.zeros((40, 1)), target=np.zeros((40, 1)), groups=np.repeat([0, 1], 20))
    with pytest.raises(ValueError, match="leaves one side empty"):
        split_episodes(log, test_size=0.01)


@pytest.mark.parametrize("test_size", [-0.3, 0.0, 1.0, 3.0, np.nan])
def test_a_split_needs_a_share(test_size):
    log = Bunch(data=np.zeros((40, 1)), target=np.zeros((40, 1)), groups=np.repeat([0, 1], 20))
    with pytest.raises(ValueError, match="test_size must lie between 0 and 1"):
        split_episodes(log, test_size=test_size)


@pytest.mark.parametrize("lengths", [[20], [15, 15]])
def test_a_log_too_short_to_be_split_is_refused(lengths):
    n_rows = sum(lengths)
    log = Bunch(
        data=np.zeros((n_rows, 1)),
        target=np.zeros((n_rows, 1)),
        groups=np.repeat(range(len(lengths)), lengths),
    )
    with pytest.raises(ValueError, match="at least 20 rows stay to be fitted"):
        split_episodes(log, test_size=0.3)
