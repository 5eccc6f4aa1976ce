r"""The affinity score and its kin: how much the cloud of transported rows differs from the target.

The affinity score :math:`\rho` compares finite samples, and samples of the very same law are far apart in
high dimension. So there is a family, each member with its own way to lie:

==========================  ============================================  ==============================
function                    what it returns                               error against the population
==========================  ============================================  ==============================
`affinity_score`            the paper's :math:`\rho` of the rows          too low
`affinity_test`             its null distribution and p-value             little power for many features
`debiased_affinity_score`   :math:`\rho` less the null part               too high where not affine
`affinity_upper_bound`      a bound from marginals                        too high
`affinity_estimate`         all of these, memory linear in the rows       a bracket
==========================  ============================================  ==============================

None of them measures the error of a map row by row; that is `skat.metrics.paired_error_scorer`, which needs
pairs.
"""

import warnings
from dataclasses import dataclass, field
from functools import partial
from numbers import Integral

import numpy as np
from joblib import Parallel, delayed
from sklearn.utils import check_random_state, check_scalar

from skat.gaussian import AffineMap, Moments, optimal_map, root_of_moments, row_moments
from skat.gaussian.arrays import AnyArray, Floats, Places
from skat.metrics.marginals import halves, marginal_squares, orders
from skat.metrics.samples import twice_the_spread, two_samples, two_weights
from skat.metrics.wasserstein import affinity, is_large_cost, wasserstein_distance

__all__ = [
    "AffinityEstimate",
    "AffinityTest",
    "affinity_at_any_size",
    "affinity_estimate",
    "affinity_score",
    "affinity_test",
    "affinity_upper_bound",
    "debiased_affinity_score",
]


def affinity_score(X_transported: AnyArray, y: AnyArray, *, sample_weight: AnyArray | None = None) -> float:
    r"""Return the paper's affinity score of transported rows and target rows.

    .. math:: \rho = 1 - \frac{W_2(T X, Y)}{\sqrt{2 \operatorname{tr} \Sigma(Y)}}

    with :math:`T X` the transported rows, :math:`Y` the target rows, :math:`W_2` the exact 2-Wasserstein
    distance between the two samples and :math:`\Sigma(Y)` the covariance of the target rows (divided by their
    number). It is one if the samples are equal as sets. If their means and covariances agree, as they do
    after an affine transport fitted to these very rows, it is not negative; it is not clipped, and on other
    rows it may be.

    Parameters
    ----------
    X_transported : array-like of shape (n_source, n_features)
        Source rows, carried over by a map.
    y : array-like of shape (n_target, n_features)
        Target rows, in the same units.
    sample_weight : array-like of shape (n_rows,) or tuple of two array-likes, default=None
        One weight per row of `X_transported` and the row of `y` beside it; with unequal numbers a tuple
        (source, target).

    Returns
    -------
    float
        At most one, without unit.

    Raises
    ------
    ValueError
        If the arrays are not two-dimensional, finite and of the same number of columns; if the target rows
        are all equal; or if the cost matrix would be larger than 8 GB.

    See Also
    --------
    affinity_estimate : the same question for many rows, in linear memory.
    debiased_affinity_score : with the part taken out that two samples of one law would have.

    Notes
    -----
    *When it lies.* It depends on the number of rows. Two samples of 1,000 rows of the same normal law, whose
    population value is 1, score 0.91 with 2 features, 0.33 with 27 and 0.22 with 62: compare it only between
    samples of the same size and number of features, or ask `affinity_test`. It never looks at pairs: a map
    that turns every row into another row of the target scores 1. And it is one only for maps whose matrix is
    symmetric and positive semi-definite; after a rotation that affine transport cannot see, it is one as well
    if the law does not change under rotations, and less if it does.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Section III.

    Examples
    --------
    >>> affinity_score([[0.0], [2.0]], [[2.0], [0.0]])
    1.0
    >>> round(affinity_score([[1.0], [1.0]], [[2.0], [0.0]]), 6)
    0.292893
    """
    X_transported, y = two_samples(X_transported, y)
    x_weight, y_weight = two_weights(sample_weight, len(X_transported), len(y))
    return affinity(X_transported, y, x_weight=x_weight, y_weight=y_weight)


def affinity_at_any_size(
    X_transported: AnyArray,
    y: AnyArray,
    *,
    x_weight: AnyArray | None = None,
    y_weight: AnyArray | None = None,
) -> float:
    """Return the affinity score or, of more rows than a cost matrix has room for, its estimate.

    Parameters
    ----------
    X_transported, y : array-like of shape (n_rows, n_features)
    x_weight, y_weight : array-like of shape (n_rows,), default=None
        Of weighted rows there is no estimate.

    Returns
    -------
    float
        Beyond 31,600 rows of each the score of `affinity_estimate` with ``random_state=0``.
    """
    if x_weight is None and y_weight is None and is_large_cost(len(X_transported), len(y)):
        return affinity_estimate(X_transported, y, random_state=0).score
    return affinity(X_transported, y, x_weight=x_weight, y_weight=y_weight)


@dataclass(frozen=True, eq=False)
class AffinityTest:
    """An affinity score beside the scores that it would have if the map were right.

    Attributes
    ----------
    score : float
        The affinity score of the rows.
    p_value : float
        Share of the null scores, the score itself among them, that are not larger than the score.
    null_scores : ndarray of shape (n_permutations,)
        Scores after the labels source and target have been shuffled, ascending.
    """

    score: float
    p_value: float
    null_scores: Floats = field(repr=False)

    def quantile(self, level: float) -> float:
        """Return the score below which a share `level` of the null scores lies.

        Parameters
        ----------
        level : float
            Between 0 and 1; 0.05 gives the score below which a map is rejected at 5 %.

        Returns
        -------
        float
        """
        return float(np.quantile(self.null_scores, level, method="weibull"))


def affinity_test(
    X_transported: AnyArray,
    y: AnyArray,
    *,
    paired: bool = False,
    in_sample: bool = False,
    n_fitted: int | None = None,
    n_permutations: int = 99,
    n_jobs: int | None = None,
    random_state: int | np.random.RandomState | None = None,
) -> AffinityTest:
    r"""Test whether transported rows and target rows come from one law, by the affinity score.

    Under the null hypothesis the labels *source* and *target* carry no information. Rows that are not paired
    are pooled and dealt out anew; pairs are kept together and each is swapped or not by the toss of a coin,
    because pairs that agree score far higher than independent rows would, and only swapping keeps that. With
    :math:`\rho_b` the score after shuffle :math:`b` of :math:`B`,

    .. math:: p = \frac{1 + \#\{b : \rho_b \le \rho\}}{1 + B}

    Parameters
    ----------
    X_transported : array-like of shape (n_source, n_features)
        Source rows, carried over by a map.
    y : array-like of shape (n_target, n_features)
        Target rows.
    paired : bool, default=False
        Whether row k of `X_transported` belongs to row k of `y`.
    in_sample : bool, default=False
        Whether the map was an affine transport fitted to these very rows, so that their means and covariances
        agree. Then the carried rows are moved off, before each shuffle, by as much as the moments of two
        samples differ, and after it both sides are fitted to the moments of `y`. Without it the test of such
        rows rejects too rarely.
    n_fitted : int, default=None
        Number of rows, on the side that had fewer, that the map was fitted to, where they are others than these.
        With fewer than three times as many as are tested there is a warning.
    n_permutations : int, default=99
        Number of shuffles. Each costs one exact score, 0.1 s for 1,000 rows.
    n_jobs : int, default=None
        Number of threads.
    random_state : int, RandomState instance or None, default=None
        Source of the shuffles.

    Returns
    -------
    AffinityTest

    Raises
    ------
    ValueError
        As `affinity_score`; if `paired` and the numbers of rows differ; if `in_sample` and a shuffle leaves fewer
        source directions than target directions; or without a shuffle.

    Notes
    -----
    *When it lies.* The test is exact for independent rows (or pairs) and a map from other data that is
    exactly right, whatever the law. A map estimated from few other rows is itself a little wrong, and enough held-out
    rows will show it. Fit three times as many rows as you test, or more, and say so
    by `n_fitted`. With `in_sample` the level is approximate and depends on the law. At 5 %, with 40 or 60 target rows
    of 2 to 10 features, 2 to 9 % of right maps are rejected for normal and exponential rows, 2 to 4 % for
    uniform, 2 to 12 % for bimodal and 6 to 14 % for heavy-tailed ones; of 40 pairs, 1 to 2 % where partners
    nearly agree and 1 to 6 % where their noise is as large as what they share. To decide by it, hold rows out.
    Rows of one trajectory are not independent: thin them first. The power falls with the number of features
    (see the tables of the benchmark `affinity_score.py`): with many, not rejecting is no evidence of
    affinity.

    References
    ----------
    .. [1] Hemerik and Goeman (2018). Exact testing with random permutations. TEST 27.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> normal, exponential = rng.normal(size=(200, 1)), rng.exponential(size=(200, 1)) - 1
    >>> affinity_test(normal, exponential, random_state=0).p_value
    0.01
    """
    X_transported, y = two_samples(X_transported, y, paired=paired)
    check_scalar(n_permutations, "n_permutations", Integral, min_val=1)
    n_tested = min(len(X_transported), len(y))
    if n_fitted is not None and not in_sample and n_fitted < 3 * n_tested:
        warnings.warn(
            f"the map was fitted to {n_fitted} rows and {n_tested} are tested: a right map is rejected too often "
            "with fewer than three times as many. Fit more rows, or test fewer.",
            UserWarning,
            stacklevel=2,
        )
    rng = check_random_state(random_state)
    score = affinity_score(X_transported, y)
    seeds = rng.randint(np.iinfo(np.int32).max, size=n_permutations)
    null = Parallel(n_jobs=n_jobs, prefer="threads")(
        delayed(_null_score)(X_transported, y, paired, in_sample, seed) for seed in seeds
    )
    null = np.sort(np.array(null, dtype=float))
    # Shuffles that only reorder rows must count as ties whatever the order of summation.
    tied = null <= score + 1e-12
    return AffinityTest(score, float((1 + tied.sum()) / (1 + n_permutations)), null)


def debiased_affinity_score(
    X_transported: AnyArray,
    y: AnyArray,
    *,
    in_sample: bool = False,
    n_repeats: int = 5,
    n_block_rows: int = 1000,
    n_jobs: int | None = None,
    random_state: int | np.random.RandomState | None = None,
) -> float:
    r"""Return the affinity score less what two samples of one law would lose.

    .. math::
        \tilde\rho = 1 - \operatorname{sign}(D) \sqrt{\frac{|D|}{2 \operatorname{tr} \Sigma(Y)}}, \qquad
        D = \overline{W_2^2}(T X_a, Y_b)
            - \tfrac12 \overline{W_2^2}(T X_a, T X_b) - \tfrac12 \overline{W_2^2}(Y_a, Y_b)

    with :math:`a, b` disjoint halves of the rows (or blocks of `n_block_rows` where there are more), all of
    the same size, and a bar for the mean over splits. The subtraction is done on squared distances, where
    means over samples are comparable. Rows of the same number never meet, so that pairs do not matter.

    Parameters
    ----------
    X_transported : array-like of shape (n_source, n_features)
        Source rows, carried over by a map.
    y : array-like of shape (n_target, n_features)
        Target rows.
    in_sample : bool, default=False
        Whether the map was an affine transport fitted to these very rows. Then one is fitted between the
        blocks of each distance, too, and only the shape of the laws is compared. Without it the score of such
        rows is too high by what the fit gains by chance, about the share 1 / n_rows of :math:`D`'s scale.
    n_repeats : int, default=5
        Number of random splits.
    n_block_rows : int, default=1000
        Largest number of rows on either side of one distance.
    n_jobs : int, default=None
        Number of threads.
    random_state : int, RandomState instance or None, default=None
        Source of the splits.

    Returns
    -------
    float
        Without unit. For a map that is right it scatters about one on the squared scale, and so it can exceed
        one.

    Raises
    ------
    ValueError
        As `affinity_score`; with fewer than four rows on a side; or without a split, or blocks of one row.

    Notes
    -----
    *When it lies.* It is centred where the map is right, and too high where it is not: away from the null,
    samples inflate the distance less than the subtraction assumes. The more features, the more: for 1,000
    normal rows against rows of independent exponential components (population value 0.69) it is about 0.69
    with 2 features, 0.73 with 10, 0.78 with 27 and 0.82 with 62, and it passes bimodal components (0.75) off
    as 0.91. With 27 features and more a value near one says little; `affinity_upper_bound` often says more.

    References
    ----------
    .. [1] Feydy et al. (2019). Interpolating between Optimal Transport and MMD using Sinkhorn Divergences.
       AISTATS; the same subtraction, for the entropic distance.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X, y = rng.normal(size=(2, 400, 5))
    >>> round(affinity_score(X, y), 2), round(debiased_affinity_score(X, y, random_state=0), 2)
    (0.67, 1.03)
    """
    X_transported, y = two_samples(X_transported, y)
    n_rows = min(len(X_transported), len(y))
    if n_rows < 4:
        raise ValueError(
            f"halves of at least two rows are compared; there are {len(X_transported)} source and {len(y)} "
            "target rows. Give at least four of each."
        )
    check_scalar(n_repeats, "n_repeats", Integral, min_val=1)
    check_scalar(n_block_rows, "n_block_rows", Integral, min_val=2)
    n_block_rows = min(n_rows // 2, n_block_rows)
    splits = _splits(len(X_transported), len(y), n_block_rows, n_repeats, check_random_state(random_state))
    squares = Parallel(n_jobs=n_jobs, prefer="threads")(
        delayed(_debiased_square)(X_transported[source], y[target], in_sample) for source, target in splits
    )
    return _signed_score(np.mean(squares), twice_the_spread(y))


def affinity_upper_bound(
    X_transported: AnyArray, y: AnyArray, *, random_state: int | np.random.RandomState | None = None
) -> float:
    r"""Return an upper bound of the affinity, from one-dimensional marginals.

    For an orthonormal basis :math:`u_1, \dots, u_d` every coupling has
    :math:`\|x - y\|^2 = \sum_i (u_i^T x - u_i^T y)^2`, so that

    .. math:: W_2^2(T X, Y) \ge \sum_i W_2^2(u_i^T T X, u_i^T Y) =: L, \qquad
              \rho \le 1 - \sqrt{\frac{L}{2 \operatorname{tr} \Sigma(Y)}}

    and marginals need few rows, whatever the number of features. The basis is found on one half of the rows:
    the better of the coordinate axes, the target's principal axes and the orthonormal bases nearest to the
    independent components of either sample. :math:`L` is then estimated on the other half, and the roles
    swapped.

    Sampling noise does not fake a distance: that half is cut in two, the differences of sorted marginals are
    taken in each part, and only their product counts, so that independent noise cancels in the mean. Its
    expectation is at most :math:`L`, for any number of rows: expected order statistics are averages of the
    quantile function, and averages shrink differences (Jensen).

    Parameters
    ----------
    X_transported : array-like of shape (n_source, n_features)
        Source rows, carried over by a map.
    y : array-like of shape (n_target, n_features)
        Target rows.
    random_state : int, RandomState instance or None, default=None
        Source of the halves and of the start of the independent component analysis.

    Returns
    -------
    float
        At most one, without unit.

    Raises
    ------
    ValueError
        As `affinity_score`; or with fewer than eight rows on a side.

    Notes
    -----
    *When it lies.* It is one for laws that differ only in how their components depend on each other, and
    above the truth wherever they do. It is sharp for independent components in an orthonormal basis; a target
    with very different spreads along oblique components loosens it (condition 100: a quarter of the squared
    distance). The bound holds for expectations on the squared scale, for independent rows; a single value
    scatters. It looks at the shape of clouds, never at pairs.

    References
    ----------
    .. [1] Hyvärinen and Oja (2000). Independent component analysis: algorithms and applications.
       Neural Networks 13.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> normal, exponential = rng.normal(size=(2000, 27)), rng.exponential(size=(2000, 27)) - 1
    >>> round(affinity_upper_bound(normal, exponential, random_state=0), 2)
    0.69
    """
    X_transported, y = two_samples(X_transported, y)
    squares = marginal_squares(X_transported, y, check_random_state(random_state))
    return _score(np.mean(squares), twice_the_spread(y))


@dataclass(frozen=True)
class AffinityEstimate:
    r"""A population's affinity score, bracketed.

    Attributes
    ----------
    score : float
        The estimate: :math:`\max(D, L, 0)` as squared distance. Too high where the map is not affine, by at
        most ``score - lower``.
    lower : float
        From the mean squared distance of blocks, whose expectation is at least the population's; so this is
        too low.
    upper : float
        From the marginals, as `affinity_upper_bound`; too high.
    standard_error : float
        Standard error of the debiased :math:`D / (2 \operatorname{tr} \Sigma(Y))`, from the scatter between
        blocks: on the scale of :math:`(1 - \rho)^2`.
    n_block_rows : int
        Number of rows on either side of each distance.
    n_blocks : int
        Number of disjoint pairs of blocks.
    """

    score: float
    lower: float
    upper: float
    standard_error: float
    n_block_rows: int
    n_blocks: int

    def __float__(self) -> float:
        return self.score


def affinity_estimate(
    X_transported: AnyArray,
    y: AnyArray,
    *,
    paired: bool = False,
    in_sample: bool = False,
    n_block_rows: int = 500,
    n_blocks: int = 12,
    n_jobs: int | None = None,
    random_state: int | np.random.RandomState | None = None,
) -> AffinityEstimate:
    r"""Estimate the affinity score of two populations from many rows, with memory linear in their number.

    The exact score of 100,000 rows would need 80 GB and hours, and would still be far below the population's
    value with many features. Three squared distances are cheap instead, and their errors have known signs:

    .. math:: \operatorname{E} L \le W_2^2(T X, Y) \le \operatorname{E} U, \qquad
              \operatorname{E} D = W_2^2(T X, Y) = 0 \text{ if } T X \text{ and } Y \text{ have one law}

    with :math:`U` the mean squared distance of disjoint blocks (an inequality of Jensen, since :math:`W_2^2`
    is jointly convex), :math:`L` the sum over marginals of `affinity_upper_bound`, and :math:`D` the
    difference of `debiased_affinity_score`. The estimate takes :math:`\max(D, L, 0)`.

    Parameters
    ----------
    X_transported : array-like of shape (n_source, n_features)
        Source rows, carried over by a map.
    y : array-like of shape (n_target, n_features)
        Target rows.
    paired : bool, default=False
        Whether row k of `X_transported` belongs to row k of `y`. Then :math:`U` compares blocks of the same
        rows, which sharpens `lower` and changes nothing else.
    in_sample : bool, default=False
        As in `debiased_affinity_score`.
    n_block_rows : int, default=500
        Largest number of rows on either side of one distance: memory and time grow with its square and cube,
        the gap between `lower` and `score` shrinks slowly. A quarter of the rows where there are few.
    n_blocks : int, default=12
        Largest number of pairs of blocks, all disjoint.
    n_jobs : int, default=None
        Number of threads.
    random_state : int, RandomState instance or None, default=None
        Source of the blocks and halves.

    Returns
    -------
    AffinityEstimate
        ``float(estimate)`` is its score.

    Raises
    ------
    ValueError
        As `affinity_score`; with fewer than eight rows on a side; or with one block, or blocks of one row.

    Notes
    -----
    *The bias, stated.* `score` is at least the population's value in expectation on the squared scale, as far
    as :math:`D` is, which is measured and not proved, and exceeds it by at most ``score - lower``. The table
    of the benchmark `affinity_score.py` has both for normal, uniform, exponential, heavy-tailed and bimodal
    laws.

    *When it lies.* As the functions it is made of: differences in dependence alone, with 27 features and
    more, are hidden from `score` and `upper` alike, and only the width down to `lower` warns of it. Rows of
    one trajectory are not independent, and then neither inequality is certain.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X, y = rng.normal(size=(2, 4000, 5))
    >>> estimate = affinity_estimate(X, y, random_state=0)
    >>> estimate.lower < 0.8 < 0.9 < estimate.score
    True
    """
    X_transported, y = two_samples(X_transported, y, paired=paired)
    n_rows = min(len(X_transported), len(y))
    if n_rows < 8:
        raise ValueError(
            "at least two pairs of blocks of two rows are compared; there are "
            f"{len(X_transported)} source and {len(y)} target rows. Give at least eight of each."
        )
    check_scalar(n_block_rows, "n_block_rows", Integral, min_val=2)
    check_scalar(n_blocks, "n_blocks", Integral, min_val=2)  # The standard error is theirs.
    spread = twice_the_spread(y)
    rng = check_random_state(random_state)
    n_block_rows = min(n_block_rows, n_rows // 4)
    n_blocks = min(n_blocks, n_rows // (2 * n_block_rows))
    splits = _splits(len(X_transported), len(y), n_block_rows, n_blocks, rng)
    square = partial(_bracketing_squares, paired=paired, in_sample=in_sample)
    parallel = Parallel(n_jobs=n_jobs, prefer="threads")
    plain, debiased = np.transpose(
        parallel(delayed(square)(X_transported[source], y[target]) for source, target in splits)
    )
    marginal = np.mean(marginal_squares(X_transported, y, rng, n_jobs))
    return AffinityEstimate(
        score=_score(max(debiased.mean(), marginal), spread),
        lower=_score(plain.mean(), spread),
        upper=_score(marginal, spread),
        standard_error=float(debiased.std(ddof=1) / np.sqrt(n_blocks) / spread),
        n_block_rows=n_block_rows,
        n_blocks=n_blocks,
    )


def _null_score(X: Floats, y: Floats, paired: bool, in_sample: bool, seed: int) -> float:
    rng = np.random.default_rng(seed)
    shuffle = _swapped_pairs if paired else _dealt_out_anew
    if not in_sample:
        return affinity(*shuffle(X, y, rng))
    source, target = shuffle(_loosened(X, y, paired, rng), y, rng)
    # Both get the moments of y, on whose shape the score depends, as the rows under test have them.
    return affinity(_refitted(source, y), _refitted(target, y))


def _loosened(X: Floats, y: Floats, paired: bool, rng: np.random.Generator) -> Floats:
    """Return fitted rows whose moments differ from those of y as two samples do, by a bootstrap."""
    y_weight = rng.exponential(size=len(y))
    x_weight = y_weight if paired else rng.exponential(size=len(X))
    moved: Floats = _affine_map(row_moments(y, y_weight), row_moments(X, x_weight))(X)
    return moved


def _swapped_pairs(X: Floats, y: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    swap = rng.random(len(X))[:, np.newaxis] < 0.5
    return np.where(swap, y, X), np.where(swap, X, y)


def _dealt_out_anew(X: Floats, y: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    pooled = np.vstack([X, y])
    order = rng.permutation(len(pooled))
    return pooled[order[: len(X)]], pooled[order[len(X) :]]


def _refitted(source: Floats, target: Floats) -> Floats:
    """Return the source rows carried to the target rows by the affine transport between them."""
    moved: Floats = _affine_map(row_moments(source), row_moments(target))(source)
    return moved


def _affine_map(source: Moments, target: Moments) -> AffineMap:
    coef = optimal_map(root_of_moments(source), root_of_moments(target))
    return AffineMap(coef, source.mean, target.mean)


def _splits(
    n_source: int, n_target: int, n_block_rows: int, n_splits: int, rng: np.random.RandomState
) -> list[tuple[Places, Places]]:
    """Return pairs of row numbers, each two blocks long, disjoint as long as there are rows.

    With equal numbers of rows both sides get the same numbers, so that pairs stay together.
    """
    per_pass = min(n_source, n_target) // (2 * n_block_rows)
    splits = []
    for k in range(n_splits):
        if k % per_pass == 0:
            source, target = orders(n_source, n_target, rng)
        block = slice(2 * n_block_rows * (k % per_pass), 2 * n_block_rows * (k % per_pass + 1))
        splits.append((source[block], target[block]))
    return splits


def _debiased_square(X: Floats, y: Floats, in_sample: bool) -> float:
    """Return D of two blocks a side."""
    between, within = _block_squares(halves(X), halves(y), in_sample)
    return between - within


def _bracketing_squares(X: Floats, y: Floats, paired: bool, in_sample: bool) -> tuple[float, float]:
    """Return U and D of two blocks a side."""
    X, y = halves(X), halves(y)
    between, within = _block_squares(X, y, in_sample)
    plain = between
    if paired or in_sample:
        plain = (_square(X[0], y[0]) + _square(X[1], y[1])) / 2
    return plain, between - within


def _block_squares(X: Floats, y: Floats, in_sample: bool) -> tuple[float, float]:
    """Return the mean squared distances between and within; rows of the same number never meet."""
    between = (_square(X[0], y[1], in_sample) + _square(X[1], y[0], in_sample)) / 2
    within = (_square(X[0], X[1], in_sample) + _square(y[0], y[1], in_sample)) / 2
    return between, within


def _square(source: Floats, target: Floats, refit: bool = False) -> float:
    return wasserstein_distance(_refitted(source, target) if refit else source, target) ** 2


def _score(square: float, spread: float) -> float:
    return 1.0 - float(np.sqrt(max(square, 0.0) / spread))


def _signed_score(square: float, spread: float) -> float:
    return 1.0 - float(np.sign(square) * np.sqrt(abs(square) / spread))
