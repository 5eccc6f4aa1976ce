"""Which episodes of a log are set aside to test what was fitted to the others."""

import warnings

import numpy as np
from numpy.typing import NDArray
from sklearn.utils import Bunch, check_random_state

FEWEST_ROWS = 20
# Of the rows that should stay to be fitted, episodes of unequal length leave at least this share.
LEAST_FITTED = 0.5
# Episodes of unequal length may make up less than was asked for; less than this share of it is worth a word.
LEAST_TESTED = 0.5


def drawn_episodes(
    sizes: NDArray[np.integer],
    test_size: float,
    random_state: np.random.RandomState,
    *,
    most: int | None = None,
    stacklevel: int = 2,
) -> list[int]:
    """Return episodes that make up a share of the rows, as far as enough remains to be fitted; none where none fits.

    Parameters
    ----------
    sizes : ndarray of shape (n_episodes,)
        Number of rows of each.
    test_size : float
        Share of the rows, 0 < test_size < 1.
    random_state : numpy.random.RandomState
        Draws the episodes.
    most : int or None, default=None
        Number of episodes that may be drawn at most.
    stacklevel : int, default=2
        Of warnings, from here; 2 is the caller.

    Returns
    -------
    list of int
    """
    n_rows = int(sizes.sum())
    wanted = round(test_size * n_rows)
    most_rows = n_rows - max(FEWEST_ROWS, LEAST_FITTED * (1 - test_size) * n_rows)
    drawn: list[int] = []
    held = 0
    for episode in random_state.permutation(len(sizes)):
        if held >= wanted or len(drawn) == most:
            break
        if held + sizes[episode] <= most_rows:
            drawn.append(int(episode))
            held += int(sizes[episode])
    if drawn and held < LEAST_TESTED * wanted:
        warnings.warn(
            f"Only {held} of {n_rows} rows are set aside to measure the gain, not {100 * test_size:g} %: whole "
            "episodes are, and the longer ones have to stay to be fitted. Cut long episodes into shorter ones, or "
            "measure the gain on another log.",
            UserWarning,
            stacklevel=stacklevel,
        )
    return drawn


def split_episodes(
    log: Bunch, *, test_size: float, random_state: int | np.random.RandomState | None = None
) -> tuple[Bunch, Bunch]:
    """Split a log into two, by whole episodes where there are several.

    Parameters
    ----------
    log : Bunch
        With data, target and, unless its rows are independent, groups; with origins, of which of several logs each row
        is, where there are several.

    test_size : float
        Part of the rows that the second log gets, between 0 and 1, in whole episodes, as far as they leave enough to
        fit. A single episode is cut, and its end is the second log. Independent rows are drawn one by one.

    random_state : int, RandomState or None, default=None
        Draws the episodes.

    Returns
    -------
    fit, test : Bunch
        Copies of `log` with a part of the rows each.

    Raises
    ------
    ValueError
        If `test_size` is not between 0 and 1, or leaves one of them empty.
    """
    if not 0 < test_size < 1:
        raise ValueError(f"test_size must lie between 0 and 1, such as 0.3; it is {test_size}.")
    n_rows = len(log.data)
    groups = np.arange(n_rows) if log.get("groups") is None else np.asarray(log.groups)
    names, sizes = np.unique(groups, return_counts=True)
    if len(names) == 1:
        n_fitted = max(n_rows - round(test_size * n_rows), min(FEWEST_ROWS, n_rows))
        chosen = np.arange(n_rows) >= n_fitted
    else:
        drawn = drawn_episodes(sizes, test_size, check_random_state(random_state), stacklevel=3)
        chosen = np.isin(groups, names[drawn])
    if chosen.all() or not chosen.any():
        raise ValueError(
            f"test_size={test_size} of {len(names)} episodes and {n_rows} rows leaves one side empty: whole episodes "
            f"are set aside, and at least {FEWEST_ROWS} rows stay to be fitted. Choose another value, such as 0.3, or "
            "measure longer."
        )
    fit, test = (
        Bunch(
            **{
                **log,
                **{
                    name: log[name][rows]
                    for name in ("data", "target", "groups", "origins")
                    if log.get(name) is not None
                },
            }
        )
        for rows in (~chosen, chosen)
    )
    return fit, test
