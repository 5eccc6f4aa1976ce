"""The parts that transports and scores are made of, against NumPy, SciPy, POT and what is known in closed form."""

import pickle
import warnings

import numpy as np
import ot
import pytest
import scipy.linalg
import scipy.stats
from scipy.spatial.distance import cdist
from sklearn.linear_model import Ridge

from skat.gaussian import (
    AffineMap,
    coral_map,
    covariance_root,
    distance_of_roots,
    gaussian_wasserstein_distance,
    optimal_map,
    root_of_moments,
    row_moments,
    spectrum,
    transport_map,
)
from skat.gaussian.backends import _device_moments
from skat.gaussian.maps import accurate_svd, coefficient_distance, reached_part, reached_rank, root_of_factor
from skat.gaussian.moments import CHEAP_QR, Moments, SideBySide, triangle
from skat.gaussian.threads import shared
from skat.metrics import affinity_estimate, affinity_test, debiased_affinity_score
from skat.metrics.affinity import AffinityTest, _splits
from skat.metrics.distances import (
    affine_discrepancy_bound,
    affine_error_bound,
    gelbrich_bound,
    normal_approximation_bound,
)
from skat.metrics.domains import domain_signs
from skat.metrics.marginals import halves, marginal_squares, orders
from skat.metrics.samples import row_weight, twice_the_spread, two_weights
from skat.metrics.wasserstein import affinity, is_large_cost, optimal_plan, wasserstein_distance
from skat.transport import fit_batched
from skat.transport.alignment import PairFactors, look_shuffled, raw_alignment, whitened_alignment
from skat.transport.regression import PENALTIES, ridge_regression
from skat.transport.shift import Distances, Support, importance_weights
from skat.transport.shrinkage import mean_drawn_towards


def normal_rows(n_rows, n_features, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n_rows, n_features)) @ rng.normal(size=(n_features, n_features)) + rng.normal(
        size=n_features
    )


def biased_covariance(rows, weight=None):
    return np.atleast_2d(np.cov(rows.T, bias=True, aweights=weight))


def product_rows(n_features=12, seed=0):
    """Rows that are so many that their moments are held as a product."""
    n_rows = int(CHEAP_QR / n_features**2) + 5000
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n_rows, n_features)) + 0.1 * np.arange(n_features)


# -- moments -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int64])
@pytest.mark.parametrize("is_weighted", [False, True])
def test_moments_are_those_of_numpy(dtype, is_weighted):
    rows = (100 * normal_rows(60, 3)).astype(dtype)
    weight = np.random.default_rng(1).uniform(0.5, 2, 60) if is_weighted else None
    found = row_moments(rows, weight)
    np.testing.assert_allclose(found.mean, np.average(rows.astype(float), axis=0, weights=weight), rtol=1e-13)
    np.testing.assert_allclose(found.covariance, biased_covariance(rows.astype(float), weight), rtol=1e-11)
    np.testing.assert_allclose(found.variance, np.diagonal(found.covariance), rtol=1e-13)
    total = 60.0 if weight is None else weight.sum()
    squared = 60.0 if weight is None else np.square(weight).sum()
    assert (found.n_rows, found.n_features) == (60, 3)
    assert found.weight == pytest.approx(total)
    assert found.effective_n_rows == pytest.approx(total**2 / squared)
    assert found.eps == np.finfo(dtype if dtype == np.float32 else np.float64).eps


def test_rounding_is_that_of_a_grid_as_fine_as_the_type():
    """An even distribution over one unit of rounding has the standard deviation of a twelfth's root."""
    rows = np.random.default_rng(0).normal(3.0, 4.0, size=(500, 1)).astype(np.float32)
    found = row_moments(rows)
    size = np.sqrt(np.square(rows.astype(float)).mean())
    np.testing.assert_allclose(found.rounding, np.finfo(np.float32).eps * size / np.sqrt(12), rtol=1e-6)


@pytest.mark.parametrize("is_weighted", [False, True])
@pytest.mark.parametrize("offset", [0.0, 1e3, 1e8])
def test_moments_of_many_rows_are_a_product_without_loss(offset, is_weighted):
    rows = product_rows() + offset
    rows[:100] += 5  # The first rows are no measure of where the others lie.
    weight = np.random.default_rng(1).uniform(0.5, 2, len(rows)) if is_weighted else None
    found = row_moments(rows, weight)
    assert found.factor is None
    centred = rows - offset
    near = 1e-7 if offset > 1e5 else 1e-11
    mean = np.average(centred, axis=0, weights=weight)
    np.testing.assert_allclose(found.mean - offset, mean, atol=1e-15 * max(offset, 10) * 4)
    np.testing.assert_allclose(found.covariance, biased_covariance(centred, weight), atol=near)
    np.testing.assert_allclose(
        found.covariance_factor.T @ found.covariance_factor, found.covariance, atol=1e-12
    )


def test_many_rows_that_nearly_depend_on_each_other_keep_their_least_direction():
    rows = product_rows()
    rows[:, 1] = rows[:, 0] + 1e-5 * rows[:, 1]
    found = row_moments(rows)
    assert found.scatter is None
    least = np.linalg.svd(found.factor, compute_uv=False)[-1]
    centred = rows - rows.mean(axis=0)
    assert least == pytest.approx(np.linalg.svd(centred, compute_uv=False)[-1], rel=1e-8)


def test_a_constant_column_of_many_rows_does_not_vary_at_all():
    rows = product_rows()
    rows[:, 4] = 1 / 3
    found = row_moments(rows)
    assert found.variance[4] == 0.0
    root = root_of_moments(found)
    assert root.shape == (12, 11)
    np.testing.assert_allclose(root @ root.T, found.covariance, atol=1e-12)


def test_sums_of_products_and_factors_are_moments_of_all_rows():
    many, few, far = product_rows(), normal_rows(40, 12, seed=2), product_rows(seed=3) + 1e7
    for parts in ((many, few), (few, many), (many, many + 1), (many, far)):
        merged = row_moments(parts[0]) + row_moments(parts[1])
        rows = np.vstack(parts)
        assert merged.n_rows == merged.weight == merged.squared_weight == len(rows)
        shift = rows[0]
        np.testing.assert_allclose(merged.mean - shift, (rows - shift).mean(axis=0), rtol=1e-9, atol=1e-8)
        true = biased_covariance(rows - shift)
        np.testing.assert_allclose(merged.covariance, true, rtol=1e-8, atol=1e-8 * np.abs(true).max())
    within = row_moments(many) + row_moments(far)
    # The spread across the line between two far sets is that within them: no digit of it is lost.
    across = scipy.linalg.null_space(np.ones((1, 12)))
    found = np.linalg.norm(within.covariance_factor @ across, axis=0)
    true = np.sqrt((np.var(many @ across, axis=0) + np.var((far - 1e7) @ across, axis=0)) / 2)
    np.testing.assert_allclose(found, true, rtol=1e-2)


def test_moments_scale_fade_and_take_columns_as_their_rows_do():
    factors = np.linspace(0.5, 3, 12)
    for rows in (product_rows(), normal_rows(50, 12)):
        found = row_moments(rows)
        scaled, faded, some = found.scaled(factors), 0.25 * found, found.columns(np.array([5, 2]))
        np.testing.assert_allclose(scaled.mean, (rows * factors).mean(axis=0), rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(
            scaled.covariance, biased_covariance(rows * factors), rtol=1e-9, atol=1e-11
        )
        np.testing.assert_allclose(faded.covariance, found.covariance, rtol=1e-12)
        assert faded.weight == 0.25 * found.weight
        assert faded.effective_n_rows == pytest.approx(found.effective_n_rows)
        np.testing.assert_allclose(some.covariance, biased_covariance(rows[:, [5, 2]]), rtol=1e-9, atol=1e-11)
        np.testing.assert_array_equal(some.mean, found.mean[[5, 2]])
        again = pickle.loads(pickle.dumps(found))
        np.testing.assert_allclose(again.covariance, found.covariance, rtol=1e-13, atol=1e-14)
        np.testing.assert_array_equal(again.mean, found.mean)
        assert len(pickle.dumps(found)) < 8 * 12 * 13 / 2 + 2000


@pytest.mark.parametrize("factor", [0, -1.0, np.inf, np.nan])
def test_rows_fade_by_positive_numbers_only(factor):
    with pytest.raises(ValueError, match="multiplied by a positive number"):
        row_moments(normal_rows(5, 2)) * factor


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("rows", [normal_rows(50, 3), product_rows()], ids=["few", "many"])
def test_one_number_that_is_not_finite_shows(rows, bad):
    assert row_moments(rows).is_finite
    rows = rows.copy()
    rows[7, 1] = bad
    found = row_moments(rows)
    assert not found.is_finite
    assert not pickle.loads(pickle.dumps(found)).is_finite


def test_two_arrays_side_by_side_are_their_columns():
    first, second = normal_rows(40, 2), normal_rows(40, 3, seed=1).astype(np.float32)
    beside, stacked = SideBySide(first, second), np.hstack([first, second])
    assert (beside.ndim, beside.shape, len(beside), beside.dtype) == (2, (40, 5), 40, np.float64)
    np.testing.assert_array_equal(beside[7], stacked[7])
    np.testing.assert_array_equal(beside[3:9].less(np.arange(5.0)), stacked[3:9] - np.arange(5.0))
    np.testing.assert_allclose(row_moments(beside).covariance, biased_covariance(stacked), rtol=1e-10)


@pytest.mark.parametrize("n_rows", [3, 50])
@pytest.mark.parametrize("is_weighted", [False, True])
def test_moments_of_another_library_are_those_of_numpy(is_weighted, n_rows):
    xp = pytest.importorskip("array_api_strict")
    rows = 1e6 + normal_rows(n_rows, 4)
    weight = np.random.default_rng(1).uniform(0.5, 2, n_rows) if is_weighted else None
    if is_weighted:
        rows[0], weight[0] = 1e9, 0.0  # without weight, however far
    given = None if weight is None else xp.asarray(weight)
    found, true = _device_moments(xp.asarray(rows), given, xp, None), row_moments(rows, weight)
    assert (found.n_rows, found.eps) == (true.n_rows, true.eps)
    assert found.weight == pytest.approx(true.weight)
    assert found.squared_weight == pytest.approx(true.squared_weight)
    np.testing.assert_allclose(found.mean, true.mean, rtol=1e-14)
    np.testing.assert_allclose(found.covariance, true.covariance, rtol=1e-6, atol=1e-9)
    assert (found.scatter is None) == (n_rows < 4)


def test_nearly_dependent_columns_of_another_library_keep_the_digits_that_their_product_would_lose():
    xp = pytest.importorskip("array_api_strict")
    rows = normal_rows(200, 3)
    rows[:, 2] = rows[:, 0] + 1e-7 * rows[:, 2]
    found, true = _device_moments(xp.asarray(rows), None, xp, None), row_moments(rows)
    assert found.factor.shape == (3, 3)
    least, expected = (np.linalg.svd(one.covariance_factor)[1][-1] for one in (found, true))
    assert least == pytest.approx(expected, rel=1e-8)


def test_a_triangle_is_a_factor_of_the_same_product():
    factor = normal_rows(50, 4)
    upper = triangle(factor)
    assert upper.shape == (4, 4)
    np.testing.assert_allclose(upper.T @ upper, factor.T @ factor, rtol=1e-12)


@pytest.mark.parametrize("n_blocks", [0, 1, 15, 16, 17, 100])
def test_shared_blocks_are_all_done_once_and_in_order(n_blocks):
    parts = shared(list, range(n_blocks))
    assert [block for part in parts for block in part] == list(range(n_blocks))


# -- maps --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_features", [1, 2, 5])
def test_optimal_map_is_scipys_formula(n_features):
    source, target = (biased_covariance(normal_rows(40, n_features, seed)) for seed in (1, 2))
    root = scipy.linalg.sqrtm(target)
    formula = root @ scipy.linalg.inv(scipy.linalg.sqrtm(root @ source @ root)) @ root
    np.testing.assert_allclose(transport_map(source, target), formula.real, rtol=1e-8, atol=1e-10)
    coral = coral_map(covariance_root(source), covariance_root(target))
    np.testing.assert_allclose(coral @ source @ coral.T, target, rtol=1e-9, atol=1e-11)


def test_distance_of_normal_laws_is_that_of_pot():
    (m_s, C_s), (m_t, C_t) = (
        (rows.mean(axis=0), biased_covariance(rows))
        for rows in (normal_rows(40, 4, 1), normal_rows(40, 4, 2))
    )
    true = ot.gaussian.bures_wasserstein_distance(m_s, m_t, C_s, C_t)
    assert gaussian_wasserstein_distance(m_s, C_s, m_t, C_t) == pytest.approx(float(true), rel=1e-8)


def test_distance_in_many_dimensions_is_the_sum_over_axes():
    """Of covariances that share their axes; with more than 256 columns it is taken another way."""
    rng = np.random.default_rng(0)
    axes = np.linalg.qr(rng.normal(size=(300, 300)))[0]
    source, target = rng.uniform(0.5, 2, size=(2, 300))
    shift = rng.normal(size=300)
    true = np.sqrt(np.square(shift).sum() + np.square(source - target).sum())
    roots = axes * source, axes * target
    assert distance_of_roots(shift, *roots) == pytest.approx(true, rel=1e-10)
    assert distance_of_roots(0 * shift, roots[0], 1.0001 * roots[0]) == pytest.approx(
        1e-4 * np.linalg.norm(source), rel=1e-8
    )
    coef = (axes * (target / source)) @ axes.T
    np.testing.assert_allclose(optimal_map(*roots), coef, atol=1e-10)
    lower = [np.linalg.cholesky(root @ root.T) for root in roots]
    np.testing.assert_allclose(optimal_map(*lower), coef, atol=1e-9)
    moments = [
        Moments(9, 1.0, 1.0, mean, 0 * mean, factor=root.T) for mean, root in zip((shift, 0 * shift), roots)
    ]
    assert coefficient_distance(*moments, coef) == pytest.approx(true, rel=1e-9)
    nearly = Moments(9, 1.0, 1.0, shift, 0 * shift, factor=1.0001 * roots[0].T)
    assert coefficient_distance(moments[0], nearly, 1.0001 * np.eye(300)) == pytest.approx(
        1e-4 * np.linalg.norm(source), rel=1e-8
    )


def test_coefficient_distance_is_that_of_the_moments():
    source, target = row_moments(normal_rows(40, 4, 1)), row_moments(normal_rows(40, 4, 2))
    roots = root_of_moments(source), root_of_moments(target)
    true = distance_of_roots(source.mean - target.mean, *roots)
    assert coefficient_distance(source, target, optimal_map(*roots)) == pytest.approx(true, rel=1e-9)


def test_directions_that_a_source_lacks_are_counted_and_their_share_told():
    axes = np.linalg.qr(np.random.default_rng(0).normal(size=(5, 5)))[0]
    source, target = axes[:, :2] * [1.0, 2.0], axes[:, :3] * [1.0, 1.0, 2.0]
    assert reached_rank(target.T @ source) == 2
    assert reached_rank(np.empty((0, 3))) == 0
    coef = optimal_map(source, target, reach=True)
    rank, missed = reached_part(coef, source, target)
    assert (rank, missed) == (2, pytest.approx(4 / 6))
    assert reached_part(coef, source, target[:, :0]) == (0, 0.0)
    assert reached_part(0 * coef, source[:, :0], target) == (0, 1.0)
    assert reached_part(optimal_map(target, source), target, source) == (2, 0.0)
    with pytest.raises(np.linalg.LinAlgError, match=r"rank\(S_t\) is 3, .* only 2"):
        optimal_map(source, target)


def test_coral_with_fewer_directions_matches_the_targets_largest():
    axes = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0]
    source, target = axes[:, :2] * [1.0, 2.0], axes[:, 1:] * [3.0, 1.0, 2.0]
    coef = coral_map(source, target)
    values = np.linalg.eigvalsh(coef @ source @ source.T @ coef.T)
    np.testing.assert_allclose(values, [0, 0, 4, 9], atol=1e-12)


def test_rank_of_a_covariance_does_not_depend_on_units():
    rows = normal_rows(30, 3)
    rows = np.column_stack([rows, rows @ [1.0, 2.0, -1.0], np.full(30, 0.1)])
    units = np.array([1.0, 1e-9, 1e7, 1e3, 1.0])
    for scale in (np.ones(5), units):
        moments = row_moments(rows * scale)
        for root in (root_of_moments(moments), covariance_root(moments.covariance)):
            assert root.shape == (5, 3)
            error = (root @ root.T - moments.covariance) / np.outer(scale, scale)
            assert np.abs(error).max() < 1e-8
    wide = root_of_factor(rows[:3, :4] - rows[:3, :4].mean(axis=0))
    assert wide.shape == (4, 2)


def test_what_varies_by_rounding_alone_does_not_vary():
    rows = normal_rows(200, 2).astype(np.float32)
    rows = np.column_stack([rows, rows.sum(axis=1, dtype=np.float32)])
    assert root_of_moments(row_moments(rows)).shape[1] == 2
    assert root_of_moments(row_moments(rows + np.float32([0, 0, 0.1]) * normal_rows(200, 3))).shape[1] == 3


def test_small_negative_eigenvalues_are_rounding_and_large_ones_are_not():
    axes = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    almost = (axes * [1.0, 2.0, -1e-10]) @ axes.T
    assert covariance_root((almost + almost.T) / 2).shape == (3, 2)
    with pytest.raises(ValueError, match="positive semi-definite"):
        covariance_root((axes * [1.0, 2.0, -1e-6]) @ axes.T)
    with pytest.raises(ValueError, match="positive semi-definite"):
        covariance_root([[1.0, 0.0], [0.0, -1e-20]])
    skew = np.array([[1.0, 1e-6], [0.0, 1.0]])
    with pytest.raises(ValueError, match="symmetric"):
        covariance_root(skew)
    covariance_root([[1.0, 1e-10], [0.0, 1.0]])
    for shape in ((2,), (2, 3), (0, 0)):
        with pytest.raises(ValueError, match="square matrix"):
            covariance_root(np.ones(shape))
    with pytest.raises(ValueError, match="finite"):
        covariance_root([[np.nan]])
    assert covariance_root(np.zeros((2, 2))).shape == (2, 0)


@pytest.mark.parametrize("shape", [(4, 4), (6, 3), (3, 6), (4, 0)])
def test_svd_is_one_and_keeps_small_columns(shape):
    matrix = np.random.default_rng(0).normal(size=shape) * np.logspace(0, -20, shape[1])
    left, values, right = accurate_svd(matrix)
    size = min(shape)
    assert (left.shape, values.shape, right.shape) == ((shape[0], size), (size,), (size, shape[1]))
    np.testing.assert_allclose(left.T @ left, np.eye(size), atol=1e-13)
    np.testing.assert_allclose((left * values) @ right, matrix, rtol=1e-9, atol=1e-32)
    if shape[1]:
        assert (np.diff(values) <= 0).all()
    if shape == (6, 3):
        # The determinant of the Gram matrix is the product of squared values, column by column.
        assert np.prod(values) == pytest.approx(
            np.prod(np.abs(np.diagonal(np.linalg.qr(matrix)[1]))), rel=1e-12
        )
    directions, spread = spectrum(matrix) if shape[0] >= shape[1] else spectrum(matrix.T)
    assert directions.shape[1] == len(spread)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_map_carries_the_source_mean_exactly_and_leaves_columns_alone(dtype):
    rng = np.random.default_rng(0)
    affine = AffineMap(
        rng.normal(size=(3, 3)), 1e4 * np.ones(3), np.array([1.0, 2.0, 3.0]), np.array([False, True, False])
    )
    rows = np.vstack([affine.source_mean, 1e4 + rng.normal(size=(4, 3))]).astype(dtype)
    carried = affine(rows)
    assert carried.dtype == dtype
    np.testing.assert_array_equal(carried[:, 1], rows[:, 1])
    np.testing.assert_array_equal(carried[0, [0, 2]], [1.0, 3.0])
    true = (rows.astype(float) - 1e4) @ affine.coef.T + affine.target_mean
    np.testing.assert_allclose(
        carried[:, [0, 2]], true[:, [0, 2]], rtol=1e-6 if dtype == np.float32 else 1e-12
    )
    np.testing.assert_allclose(affine.intercept, affine.target_mean - affine.coef @ affine.source_mean)


def test_a_map_is_tame_where_no_terms_cancel():
    rows = row_moments(np.random.default_rng(0).normal(size=(400, 2)) @ [[1.0, 1.0], [0.0, 0.01]])
    assert AffineMap(np.eye(2), rows.mean, rows.mean).tame(rows).is_tame
    assert AffineMap(np.ones((2, 2)), rows.mean, rows.mean).tame(rows).is_tame
    assert not AffineMap(np.array([[1.0, -1.0], [0.0, 1.0]]), rows.mean, rows.mean).tame(rows).is_tame


def test_maps_between_moments_and_in_other_units():
    source, target = normal_rows(30, 3, 1), normal_rows(30, 3, 2)
    affine = AffineMap.between(np.diag([1.0, 2.0, 3.0]), row_moments(source), row_moments(target))
    np.testing.assert_allclose(affine(source).mean(axis=0), target.mean(axis=0), rtol=1e-12)
    units = np.array([1.0, 10.0, 0.1])
    symmetric = AffineMap(transport_map(np.eye(3), biased_covariance(target)), source[0], target[0])
    scaled = symmetric.scaled(units)
    np.testing.assert_allclose(scaled(source * units), symmetric(source) * units, rtol=1e-12)
    for one in (affine, symmetric, scaled):
        again = pickle.loads(pickle.dumps(one))
        np.testing.assert_allclose(again.coef, one.coef, rtol=1e-14)
        np.testing.assert_allclose(again(source), one(source), rtol=1e-12)


def test_many_small_maps_are_each_the_optimal_one():
    X = np.stack([normal_rows(20, 3, seed) for seed in range(5)])
    y = np.stack([normal_rows(15, 3, seed) for seed in range(5, 10)])
    X[3, :, 2] = X[3, :, 0] + 1e-5 * X[3, :, 2]  # ill-conditioned: goes its own way
    maps = fit_batched(X, y)
    for one in range(5):
        expected = transport_map(biased_covariance(X[one]), biased_covariance(y[one]))
        np.testing.assert_allclose(maps.coef[one], expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
        np.testing.assert_allclose(maps(X)[one].mean(axis=0), y[one].mean(axis=0), rtol=1e-7, atol=1e-9)
        carried = biased_covariance(maps(X)[one])
        np.testing.assert_allclose(carried, biased_covariance(y[one]), rtol=1e-5, atol=1e-7)
    assert fit_batched(X[:, :2, :1], y[:, :2, :1]).coef.shape == (5, 1, 1)
    for wrong in ((X[:4], y), (X[:, :, :2], y)):
        with pytest.raises(ValueError, match="as many problems with the same columns"):
            fit_batched(*wrong)
    for wrong in ((X[:, :1], y), (X, y[:, :1])):
        with pytest.raises(ValueError, match="two rows a side"):
            fit_batched(*wrong)
    for wrong in (X[:4], X[:, :, :2]):
        with pytest.raises(ValueError, match="stack of rows for 5 maps of 3 columns"):
            maps(wrong)
    for wrong in (X[0], X[:, :0]):
        with pytest.raises(ValueError, match="must be of shape"):
            fit_batched(wrong, y)
    with pytest.raises(ValueError, match="NaN or infinity"):
        fit_batched(np.where(X[0, 0, 0] == X, np.inf, X), y)


# -- support -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_weighted", [False, True])
def test_left_out_distance_is_the_one_without_the_row(is_weighted):
    rows = normal_rows(30, 3)
    weight = np.random.default_rng(1).uniform(0.5, 2, 30) if is_weighted else None
    moments = row_moments(rows, weight)
    found = Support.of(moments).left_out(rows, moments, weight)
    for index in range(30):
        others = np.arange(30) != index
        own = None if weight is None else weight[others]
        step = rows[index] - np.average(rows[others], axis=0, weights=own)
        true = np.sqrt(step @ np.linalg.solve(biased_covariance(rows[others], own), step))
        assert found[index] == pytest.approx(true, rel=1e-8)


def test_distance_is_mahalanobis_and_endless_off_the_plane():
    rows = normal_rows(700, 3)
    support = Support.of(row_moments(rows))
    inverse = np.linalg.inv(biased_covariance(rows))
    true = cdist(rows, rows.mean(axis=0)[np.newaxis], "mahalanobis", VI=inverse)[:, 0]
    np.testing.assert_allclose(support.distance(rows), true, rtol=1e-9)
    flat = np.column_stack([rows[:, :2], rows[:, :2].sum(axis=1), np.full(700, 2.0)])
    inside = Support.of(row_moments(flat)).distance(np.vstack([flat, flat[0] + [0, 0, 1e-2, 0]]))
    inverse = np.linalg.inv(biased_covariance(rows[:, :2]))
    true = cdist(rows[:, :2], rows[:, :2].mean(axis=0)[np.newaxis], "mahalanobis", VI=inverse)[:, 0]
    np.testing.assert_allclose(inside[:-1], true, rtol=1e-6)
    assert inside[-1] == np.inf
    assert support.distance(rows[:0]).shape == (0,)


@pytest.mark.parametrize("n_rows", [3, 40, 5000])
def test_radius_is_the_conformal_quantile_of_the_latest_rows(n_rows):
    values = np.random.default_rng(0).chisquare(3, size=n_rows)
    latest = np.sort(values[-2000:].astype(np.float32))
    support = Support(np.zeros(1), np.ones(1), np.eye(1)).calibrated(Distances.of(values))
    for level in (0.5, 0.9, 0.98):
        place = min(int(np.ceil(level * (len(latest) + 1))), len(latest)) - 1
        near = latest[max(place - len(latest) // 50, 0) : place + len(latest) // 50 + 1]
        assert near[0] <= support.radius(level) <= near[-1]
    assert support.radius(0.9999) == latest[-1]
    radii = [support.radius(level) for level in np.linspace(0.01, 0.99, 50)]
    assert (np.diff(radii) >= 0).all()
    for level in (0.0, 1.0, -0.5):
        with pytest.raises(ValueError, match="between 0 and 1"):
            support.radius(level)
    with pytest.raises(ValueError, match="seen no rows"):
        Support(np.zeros(1), np.ones(1), np.eye(1)).radius(0.9)


def test_distances_keep_their_quantiles_when_they_are_stored_and_the_latest_when_they_are_many():
    rng = np.random.default_rng(0)
    first = Distances.of(rng.chisquare(3, size=1500))
    second = rng.chisquare(3, size=1500)
    both = Distances.of(second, first)
    assert len(both.values) == 2000
    np.testing.assert_array_equal(both.values[-1500:], second.astype(np.float32))
    np.testing.assert_array_equal(both.values[:500], first.values[-500:])
    again = pickle.loads(pickle.dumps(both))
    np.testing.assert_array_equal(again.quantiles, both.quantiles)
    assert len(again.values) == 2000


def test_importance_weights_carry_one_normal_law_to_another():
    rng = np.random.default_rng(0)
    here, there = rng.normal(size=(3000, 2)), rng.normal(size=(2000, 2)) + np.array([1.0, 0.0])
    weight = importance_weights(here, there)
    assert weight.mean() == pytest.approx(1.0)
    true = np.exp(here[:, 0] - 0.5)
    assert np.corrcoef(np.log(weight), np.log(true))[0, 1] > 0.98
    np.testing.assert_allclose(np.average(here, axis=0, weights=weight), [1.0, 0.0], atol=0.12)


# -- scores ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_target", [30, 41])
def test_distance_and_plan_are_those_of_pot(n_target):
    X, y = normal_rows(30, 2, 1) * 1e3, normal_rows(n_target, 2, 2) * 1e3
    x_weight, y_weight = (np.random.default_rng(3).uniform(0.1, 2, size) for size in (30, n_target))
    cost = cdist(X, y, "sqeuclidean")
    for weights in (
        (None, None),
        (x_weight, y_weight),
        (x_weight, None),
        (np.ones(30), 3 * np.ones(n_target)),
    ):
        a, b = (
            np.full(size, 1 / size) if weight is None else weight / weight.sum()
            for size, weight in zip(cost.shape, weights)
        )
        true = np.sqrt(ot.emd2(a, b, cost))
        names = dict(zip(("x_weight", "y_weight"), weights))
        assert wasserstein_distance(X, y, **names) == pytest.approx(true, rel=1e-9)
        plan, distance = optimal_plan(X, y, **names)
        assert distance == pytest.approx(true, rel=1e-9)
        np.testing.assert_allclose(plan.sum(axis=1), a, atol=1e-12)
        np.testing.assert_allclose(plan.sum(axis=0), b, atol=1e-12)
        spread = biased_covariance(y, weights[1]).trace()
        assert affinity(X, y, **names) == pytest.approx(1 - true / np.sqrt(2 * spread), rel=1e-9)


def test_eight_gigabytes_are_the_most_that_a_cost_may_have():
    assert not is_large_cost(10_000, 100_000)
    assert is_large_cost(10_000, 100_001)
    with pytest.raises(ValueError, match="exceed the range"):
        wasserstein_distance([[1e308]], [[-1e308]])
    assert wasserstein_distance([[2.0]], [[2.0]]) == 0.0
    assert affinity([[2.0]], [[2.0]]) == 1.0


def test_bounds_are_their_formulas():
    X, y = normal_rows(50, 3, 1), normal_rows(60, 3, 2)
    source, target = biased_covariance(X), biased_covariance(y)
    cross = np.sqrt(np.linalg.eigvals(source @ target).real.clip(0)).sum()
    assert affine_discrepancy_bound(X, y) == pytest.approx(
        2 * cross / np.sqrt(source.trace() + target.trace()), rel=1e-8
    )
    assert normal_approximation_bound(X) == pytest.approx(np.sqrt(2 * source.trace()))
    assert affine_error_bound(y) == pytest.approx(np.sqrt(2 * target.trace()))
    assert twice_the_spread(y) == pytest.approx(2 * target.trace())
    exact = wasserstein_distance(X, y)
    assert gelbrich_bound(X, y) <= exact + 1e-12
    assert exact - gelbrich_bound(X, y) <= affine_discrepancy_bound(X, y)
    assert affine_discrepancy_bound([[1.0], [1.0]], [[2.0], [2.0]]) == 0.0


@pytest.mark.parametrize(
    "weight",
    [[1.0, -0.1, 1.0], [0.0, 0.0, 0.0], [1.0, np.nan, 1.0], [1.0, np.inf, 1.0], [1.0, 1.0], np.ones((3, 1))],
)
def test_weights_that_weigh_nothing_are_refused(weight):
    with pytest.raises(ValueError, match="sample_weight must"):
        row_weight(weight, 3)
    np.testing.assert_array_equal(row_weight([0, 1, 0], 3), [0.0, 1.0, 0.0])


def test_one_weight_serves_both_sides_of_pairs_only():
    first, second = two_weights([1.0, 2.0], 2, 2)
    np.testing.assert_array_equal(first, second)
    with pytest.raises(ValueError, match="3 source and 2 target rows need a weight each"):
        two_weights([1.0, 2.0], 3, 2)
    assert two_weights(None, 3, 2) == (None, None)
    assert two_weights((None, [1.0, 1.0]), 3, 2)[0] is None
    with pytest.raises(ValueError, match="it has 3 entries"):
        two_weights((1.0, 2.0, 3.0), 3, 3)


def test_every_word_for_a_domain_is_on_its_side():
    words = ["sim", "source", "simulated", "simulation", "real", "target", "measured"]
    np.testing.assert_array_equal(domain_signs(words), [1, 1, 1, 1, -1, -1, -1])
    np.testing.assert_array_equal(domain_signs([3.5, -0.1]), [3.5, -0.1])
    np.testing.assert_array_equal(domain_signs([0, 1, 2, 0], source_domain=0), [1, -1, -1, 1])
    np.testing.assert_array_equal(domain_signs(["a", "b", "c"], source_domain=["a", "c"]), [1, -1, 1])
    assert domain_signs([], source_domain="a").shape == (0,)
    for bad in ([1, 0], [1.0, np.nan]):
        with pytest.raises(ValueError, match="1 of 2 values are zero or NaN"):
            domain_signs(bad)
    with pytest.raises(ValueError, match="no label for 2 of 3"):
        domain_signs([None, "a", float("nan")], source_domain="a")
    with pytest.raises(ValueError, match=r"it holds 'q0', 'q1', 'q2', 'q3', 'q4', 'q5', \.\.\."):
        domain_signs([f"q{index}" for index in range(7)])
    with pytest.raises(ValueError, match=r"it holds 'q0', 'q1', 'q2', 'q3', 'q4', 'q5'[.]"):
        domain_signs([f"q{index}" for index in range(6)])
    with pytest.raises(ValueError, match="it has 2, X 3 rows"):
        domain_signs([1, -1], 3)


def test_marginal_square_is_that_of_sorted_columns_where_components_are_independent():
    """Of many rows; the distance of a shift is the shift, and that of two spreads their difference."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(4000, 2))
    y = rng.normal(size=(4000, 2)) * [2.0, 1.0] + [0.0, 3.0]
    squares = marginal_squares(X, y, np.random.RandomState(0))
    np.testing.assert_allclose(squares, (2 - 1) ** 2 + 3**2, rtol=0.05)
    alike = marginal_squares(X, rng.normal(size=(5000, 2)), np.random.RandomState(0))
    assert np.abs(alike).max() < 0.02
    assert min(marginal_squares(X, X[:, ::-1] * 1.0, np.random.RandomState(0))) < 0.02
    with pytest.raises(ValueError, match="7 source and 9"):
        marginal_squares(X[:7], y[:9], np.random.RandomState(0))
    marginal_squares(X[:8], y[:9], np.random.RandomState(0))


def test_orders_keep_pairs_together_and_halves_are_all_rows():
    rng = np.random.RandomState(0)
    source, target = orders(9, 9, rng)
    np.testing.assert_array_equal(source, target)
    assert sorted(source) == list(range(9))
    source, target = orders(9, 7, rng)
    assert (len(source), sorted(target)) == (9, list(range(7)))
    first, second = halves(np.arange(7))
    assert (len(first), len(second)) == (3, 4)
    np.testing.assert_array_equal(np.concatenate([first, second]), np.arange(7))


def test_blocks_are_disjoint_as_long_as_there_are_rows():
    splits = _splits(50, 50, 5, 12, np.random.RandomState(0))
    assert len(splits) == 12
    for first in range(0, 10, 5):
        rows = np.concatenate([source for source, _ in splits[first : first + 5]])
        assert sorted(rows) == list(range(50))
    for source, target in splits:
        assert len(source) == 10
        np.testing.assert_array_equal(source, target)


def test_debiased_score_and_estimate_are_what_they_say_of_a_shift():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(2, 400, 2))
    y[:, 0] += 1
    true = 1 - 1 / np.sqrt(2 * 2)
    assert debiased_affinity_score(X, y, random_state=0) == pytest.approx(true, abs=0.12)
    estimate = affinity_estimate(X, y, random_state=0)
    assert estimate.lower < estimate.score <= estimate.upper
    assert estimate.score == pytest.approx(true, abs=0.12)
    assert float(estimate) == estimate.score
    assert (estimate.n_block_rows, estimate.n_blocks) == (100, 2)
    small = affinity_estimate(X, y, n_block_rows=10, random_state=0)
    assert (small.n_block_rows, small.n_blocks) == (10, 12)
    assert 0 < small.standard_error < 0.2
    # A shift is all that a map fitted to these rows could take away.
    assert debiased_affinity_score(X, y, in_sample=True, random_state=0) == pytest.approx(1.0, abs=0.1)


def test_pairs_that_agree_sharpen_the_lower_end():
    X = normal_rows(200, 3)
    y = X + 1e-6
    paired, loose = (affinity_estimate(X, y, paired=one, random_state=0) for one in (True, False))
    assert paired.lower == pytest.approx(1.0, abs=1e-4)
    assert loose.lower < 0.9
    assert (paired.upper, paired.standard_error) == (loose.upper, loose.standard_error)
    with pytest.raises(ValueError, match="pairs need as many"):
        affinity_estimate(X, y[:-1], paired=True)


@pytest.mark.parametrize(
    ("call", "least"), [(debiased_affinity_score, 4), (affinity_estimate, 8)], ids=["debiased", "estimate"]
)
def test_too_few_rows_to_cut_are_refused_and_just_enough_are_not(call, least):
    X, y = normal_rows(20, 1, 1), normal_rows(20, 1, 2)
    call(X[:least], y, random_state=0)
    for few in ((X[: least - 1], y), (X, y[: least - 1])):
        with pytest.raises(ValueError, match="Give at least"):
            call(*few)


def test_p_value_counts_ties_and_the_sample_itself():
    y = normal_rows(12, 1)
    found = affinity_test(y, y, paired=True, n_permutations=19, random_state=0)
    assert (found.score, found.p_value) == (1.0, 1.0)
    far = affinity_test(y, y + 50, n_permutations=19, random_state=0)
    assert far.p_value == 1 / 20
    assert (np.diff(far.null_scores) >= 0).all()
    scores = np.arange(1, 100) / 100
    assert AffinityTest(0.5, 0.5, scores).quantile(0.05) == pytest.approx(0.05)


@pytest.mark.parametrize(("n_fitted", "warns"), [(35, True), (36, False)])
def test_a_map_of_few_rows_is_told_of(n_fitted, warns):
    X, y = normal_rows(12, 1, 1), normal_rows(15, 1, 2)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        affinity_test(X, y, n_fitted=n_fitted, n_permutations=1, random_state=0)
        affinity_test(X, y, n_fitted=2, in_sample=True, n_permutations=1, random_state=0)
    assert len(caught) == warns


# -- rows in pairs -----------------------------------------------------------------------------------------------------


def pairs(n_rows, n_features, noise=0.5, seed=0):
    rng = np.random.default_rng(seed)
    source = normal_rows(n_rows, n_features, seed + 1)
    target = source @ np.linalg.qr(rng.normal(size=(n_features, n_features)))[0]
    target = (target + noise * normal_rows(n_rows, n_features, seed + 2)) * rng.uniform(0.5, 2, n_features)
    source, target = (rows - rows.mean(axis=0) for rows in (source, target))
    return _factors(source, target, n_rows), source, target


def _factors(source, target, n_rows=1):
    """Return factors of as few rows as there are columns, the source's a triangle."""
    both = triangle(np.hstack([source, target]) / np.sqrt(n_rows))
    return PairFactors(both[:, : source.shape[1]], both[:, source.shape[1] :])


@pytest.mark.parametrize("n_features", [1, 3, 65, 80])
def test_map_of_pairs_is_the_polar_factor_between_roots(n_features):
    factors, source, target = pairs(300, n_features)
    assert (factors.triangles is not None) == (n_features > 64)
    C_s, C_t, C_ts = source.T @ source / 300, target.T @ target / 300, target.T @ source / 300
    root_s, root_t = (scipy.linalg.sqrtm(covariance).real for covariance in (C_s, C_t))
    polar = scipy.linalg.polar(root_t @ C_ts @ np.linalg.inv(root_s))[0]
    coef = root_t @ polar @ np.linalg.inv(root_s)
    for quick in (True, False):
        found = whitened_alignment(factors, quick=quick)
        np.testing.assert_allclose(found.coef, coef, atol=1e-6 * np.abs(coef).max())
        np.testing.assert_allclose(found.inverse_coef @ found.coef, np.eye(n_features), atol=1e-6)
        assert (found.rank, found.unreached) == (n_features, 0.0)
    np.testing.assert_allclose(found.rotation, polar, atol=1e-6)
    raw = raw_alignment(factors)
    rotation = scipy.linalg.polar(C_ts)[0]
    np.testing.assert_allclose(raw.rotation, rotation, atol=1e-6)
    np.testing.assert_allclose(
        raw.coef, transport_map(rotation @ C_s @ rotation.T, C_t) @ rotation, atol=1e-5
    )
    np.testing.assert_allclose(raw.inverse_coef @ raw.coef, np.eye(n_features), atol=1e-5)
    moved = np.full((n_features, n_features), 0.3)
    with_means = raw_alignment(factors, mean_product=moved)
    np.testing.assert_allclose(with_means.rotation, scipy.linalg.polar(C_ts + moved)[0], atol=1e-6)


def test_pairs_reach_as_many_directions_as_their_source_has():
    rng = np.random.default_rng(0)
    source, target = np.zeros((50, 3)), rng.normal(size=(50, 3)) * [3.0, 2.0, 1.0]
    source[:, :2] = target[:, :2] + 0.1 * rng.normal(size=(50, 2))
    source, target = ((rows - rows.mean(axis=0)) / np.sqrt(50) for rows in (source, target))
    found = whitened_alignment(PairFactors(source, target), reach=True)
    assert found.rank == 2
    assert found.inverse_coef is None
    covariance, true = target.T @ target, found.coef @ source.T @ source @ found.coef.T
    assert found.unreached == pytest.approx(1 - true.trace() / covariance.trace(), rel=1e-9)
    assert 0 < found.unreached < 0.2
    with pytest.raises(np.linalg.LinAlgError):
        whitened_alignment(PairFactors(source, target))
    back = whitened_alignment(PairFactors(target, source))
    assert (back.rank, back.unreached, back.inverse_coef) == (2, 0.0, None)


@pytest.mark.parametrize(("n_features", "n_rows"), [(1, 30), (4, 30), (66, 200)])
def test_shuffled_pairs_look_shuffled_and_others_do_not(n_features, n_rows):
    rng = np.random.default_rng(0)
    n_draws, n_missed = (400, 0) if n_features < 64 else (20, 0)
    for _ in range(n_draws):
        source, target = rng.normal(size=(2, n_rows, n_features))
        source, target = (rows - rows.mean(axis=0) for rows in (source, target))
        n_missed += not look_shuffled(_factors(source, target), n_rows)
    assert n_missed <= 0.03 * n_draws
    if n_features == 1:
        assert n_missed > 0  # one in a hundred
    for noise in (0.0, 0.5):
        seen = source + noise * target
        assert not look_shuffled(_factors(source, seen), n_rows)


def test_too_few_pairs_never_look_shuffled():
    source, target = np.random.default_rng(0).normal(size=(2, 5, 4))
    source, target = (rows - rows.mean(axis=0) for rows in (source, target))
    assert not look_shuffled(PairFactors(source, target), 5)


def test_ridge_is_that_of_least_generalised_cross_validation():
    rng = np.random.default_rng(0)
    context = normal_rows(40, 3, 1)
    prior = rng.normal(size=(2, 3))
    rest = context @ (prior + 0.3 * rng.normal(size=(2, 3))).T + rng.normal(size=(40, 2)) * [0.5, 3.0]
    rows = np.column_stack([context, rest])
    mask = np.array([True] * 3 + [False] * 2)
    slope, residual, freedom = ridge_regression(row_moments(rows), mask, prior)
    centred = context - context.mean(axis=0)
    scaled = centred / centred.std(axis=0)
    used = []
    for column in range(2):
        missing = rest[:, column] - rest[:, column].mean() - centred @ prior[column]
        judged = []
        for penalty in PENALTIES:
            fit = Ridge(alpha=40 * penalty, fit_intercept=False).fit(scaled, missing)
            hat = scaled @ np.linalg.solve(scaled.T @ scaled + 40 * penalty * np.eye(3), scaled.T)
            error = np.square(missing - fit.predict(scaled)).sum() / (40 - 1 - hat.trace()) ** 2
            judged.append((error, fit.coef_ / centred.std(axis=0), 1 + hat.trace()))
        _, correction, own = min(judged, key=lambda one: one[0])
        np.testing.assert_allclose(slope[column], prior[column] + correction, rtol=1e-6)
        left = rest[:, column] - rest[:, column].mean() - centred @ slope[column]
        assert np.square(residual[:, column]).sum() == pytest.approx(
            np.square(left).sum() / (40 - own), rel=1e-8
        )
        used.append(own)
    assert freedom == pytest.approx(max(used))


@pytest.mark.parametrize("is_paired", [False, True])
def test_mean_is_drawn_by_the_positive_part_of_james_and_stein(is_paired):
    source, target = normal_rows(40, 5, 1), normal_rows(40, 5, 1) + 0.02 * normal_rows(40, 5, 2)
    if not is_paired:
        target = target[::-2]
    moments = row_moments(source), row_moments(target)
    together = row_moments(np.column_stack([source, target])) if is_paired else None
    found, intensity = mean_drawn_towards(moments[1], moments[0], len(target), 40, together)
    # In any coordinates that whiten the source.
    white = np.linalg.inv(np.linalg.cholesky(biased_covariance(source)))
    shift = white @ (target.mean(axis=0) - source.mean(axis=0))
    error = np.cov((target @ white.T).T) / len(target) + np.cov((source @ white.T).T) / 40
    if is_paired:
        error = np.cov(((target - source) @ white.T).T) / 40
    spare = error.trace() - 2 * np.linalg.eigvalsh(error)[-1]
    assert intensity == pytest.approx(np.clip(spare / (shift @ shift), 0, 1), rel=1e-3)
    drawn = (1 - intensity) * (target.mean(axis=0) - source.mean(axis=0))
    np.testing.assert_allclose(found.mean - source.mean(axis=0), drawn, rtol=1e-9, atol=1e-12)
    same, none = mean_drawn_towards(moments[0], moments[0], 40, 40)
    assert none == 0.0
    np.testing.assert_array_equal(same.mean, moments[0].mean)
