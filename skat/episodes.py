"""Which episodes of a log are set aside to test what was fitted to the others."""

import warnings

FEWEST_ROWS = 20
# Of the rows that should stay to be fitted, episodes of unequal length leave at least this share.
LEAST_FITTED = 0.5
# Episodes of unequal length may make up less than was asked for; less than this share of it is worth a word.
LEAST_TESTED = 0.5


def drawn_episodes(sizes, test_size, random_state, *, most=None, stacklevel=2):
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
    for episode in random_state.permutation(len(sizes)):
        held = sizes[drawn].sum()
        fits = (most is None or len(drawn) < most) and held + sizes[episode] <= most_rows
        if held < wanted and fits:
            drawn.append(int(episode))
    held = int(sizes[drawn].sum())
    if drawn and held < LEAST_TESTED * wanted:
        warnings.warn(
            f"Only {held} of {n_rows} rows are set aside to measure the gain, not {100 * test_size:g} %: whole "
            "episodes are, and the longer ones have to stay to be fitted. Cut long episodes into shorter ones, or "
            "measure the gain on another log.",
            UserWarning,
            stacklevel=stacklevel,
        )
    return drawn
