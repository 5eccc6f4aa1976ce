"""Transports that are put together of others, and splitters, against the same put together by hand."""

import numpy as np
import pandas as pd
import polars as pl
import pytest
from sklearn import config_context
from sklearn.linear_model import Ridge
from sklearn.model_selection import (
    GridSearchCV,
    GroupKFold,
    KFold,
    LeaveOneGroupOut,
    LeaveOneOut,
    ShuffleSplit,
    StratifiedKFold,
    TimeSeriesSplit,
)
from sklearn.pipeline import make_pipeline

from skat import (
    AffineTransport,
    ConditionalAffineTransport,
    MultiSourceTransport,
    ResidualTransport,
    TargetRows,
)
from skat.gaussian import barycentre_root, gaussian_wasserstein_distance, transport_map
from skat.metrics import affinity_score
from skat.transport.residual import KernelRidgeCV


def rows_of(n_rows, n_features=2, seed=0):
    rng = np.random.default_rng(seed)
    mixed = rng.normal(size=(n_rows, n_features)) @ rng.normal(size=(n_features, n_features))
    return mixed + rng.normal(size=n_features)


# -- a regression of what a transport leaves ---------------------------------------------------------------------------


def by_hand(X, y, weight=None, n_folds=3):
    """Return transport, regression, weights of its columns and lengths, as the documentation has them."""

    def given(kept):
        return {} if weight is None else {"sample_weight": weight[kept]}

    residuals, predictions, lengths = np.empty(y.shape), np.empty(y.shape), y.std(axis=0)
    folds = np.array_split(np.arange(len(X)), n_folds)
    for fold in folds:
        kept = np.setdiff1d(np.arange(len(X)), fold)
        transport = AffineTransport().fit(X[kept], y[kept], **given(kept))
        residuals[fold] = (y[fold] - transport.transform(X[fold])) / lengths
    for fold in folds:
        kept = np.setdiff1d(np.arange(len(X)), fold)
        ridge = Ridge().fit(X[kept], residuals[kept], **given(kept))
        predictions[fold] = ridge.predict(X[fold]).reshape(len(fold), -1)
    counts = np.ones(len(X)) if weight is None else weight / weight.mean()
    size = np.sum(counts[:, np.newaxis] * predictions**2, axis=0)
    best = np.sum(counts[:, np.newaxis] * residuals * predictions, axis=0) / size
    missed = counts[:, np.newaxis] * predictions * (residuals - best * predictions)
    weights = np.where(best > 0, np.clip(best - np.sum(missed**2, axis=0) / size**2 / best, 0, 1), 0)
    everything = np.arange(len(X))
    return (
        AffineTransport().fit(X, y, **given(everything)),
        Ridge().fit(X, residuals, **given(everything)),
        weights,
        lengths,
    )


@pytest.mark.parametrize("is_weighted", [False, True])
def test_a_correction_is_the_one_that_its_formula_says(is_weighted):
    X = rows_of(31, 3)
    y = np.column_stack([3 * X[:, 1], X[:, 0] - 2 * X[:, 2], X[:, 2]]) + 0.3 * rows_of(31, 3, seed=1)
    weight = np.random.default_rng(2).uniform(0.5, 2, 31) if is_weighted else None
    fitted = ResidualTransport(AffineTransport(), Ridge()).fit(X, y, sample_weight=weight)
    transport, ridge, weights, lengths = by_hand(X, y, weight)
    np.testing.assert_allclose(fitted.weights_, weights, rtol=1e-9, atol=1e-12)
    assert (weights > 0).any()
    fresh = rows_of(7, 3, seed=3)
    expected = transport.transform(fresh) + weights * lengths * ridge.predict(fresh)
    np.testing.assert_allclose(fitted.transform(fresh), expected, rtol=1e-9)
    assert fitted.wasserstein_distance_ == transport.wasserstein_distance_
    np.testing.assert_array_equal(fitted.support_distance(fresh), transport.support_distance(fresh))
    np.testing.assert_array_equal(fitted.in_support(fresh, level=0.6), transport.in_support(fresh, level=0.6))


def test_corrected_rows_keep_their_type_and_target_rows_stay():
    X = rows_of(30)
    y = X[:, ::-1] * 2
    domain = np.repeat([1, -1], 30)
    stacked = np.vstack([X, y])
    fitted = ResidualTransport(AffineTransport(), Ridge()).fit(stacked, sample_domain=domain)
    apart = ResidualTransport(AffineTransport(), Ridge()).fit(X, y)
    carried = fitted.transform(stacked, sample_domain=domain)
    np.testing.assert_array_equal(carried[30:], y)
    np.testing.assert_allclose(carried[:30], apart.transform(X), rtol=1e-12)
    single = apart.transform(X.astype(np.float32))
    assert (single.dtype, carried.dtype) == (np.float32, np.float64)
    np.testing.assert_allclose(single, carried[:30], rtol=1e-3, atol=1e-3)


def test_one_column_and_folds_of_ones_own_are_taken():
    X = rows_of(24, 1)
    for cv in (4, KFold(4)):
        fitted = ResidualTransport(AffineTransport(), Ridge(), cv=cv).fit(X, X**2)
        np.testing.assert_allclose(fitted.weights_, by_hand(X, X**2, n_folds=4)[2], rtol=1e-9, atol=1e-12)


class Unweighted(Ridge):
    def fit(self, X, y):
        return super().fit(X, y)


def test_a_regressor_without_weights_serves_rows_without_weights():
    X = rows_of(20)
    found, same = (ResidualTransport(AffineTransport(), one).fit(X, X**2) for one in (Unweighted(), Ridge()))
    np.testing.assert_array_equal(found.transform(X), same.transform(X))


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({"sample_weight": (np.ones(20), np.arange(1.0, 21))}, {}, "a pair has one weight"),
        ({"sample_weight": (None, np.arange(1.0, 21))}, {}, "a pair has one weight"),
        ({"sample_weight": (np.arange(1.0, 21), None)}, {}, "a pair has one weight"),
        ({}, {"cv": TimeSeriesSplit(3)}, "cv has to leave each of the 20 pairs .* 5 out never"),
        ({}, {"cv": ShuffleSplit(3, random_state=0)}, "ShuffleSplit.* out never or more often"),
        ({"sample_weight": np.ones(20)}, {"regressor": Unweighted()}, "Unweighted takes no sample_weight"),
        ({"y": rows_of(19, seed=1)}, {}, "there are 20 source rows and 19 target rows"),
        ({"X": np.full((20, 2), np.nan)}, {}, "Input X contains NaN"),
        ({"y": np.where(np.eye(20, 2), np.inf, 1.0)}, {}, "Input y contains infinity"),
    ],
)
def test_pairs_that_cannot_be_corrected_are_refused(change, options, message):
    given = {"X": rows_of(20), "y": rows_of(20, seed=1)} | change
    with pytest.raises(ValueError, match=message):
        ResidualTransport(AffineTransport(), **options).fit(**given)


def test_pairs_without_weight_are_as_if_they_were_not_there():
    X = rows_of(50)
    weight = np.repeat([0.0, 1.0], [30, 20])
    found = ResidualTransport(AffineTransport()).fit(X, X**2, sample_weight=weight)
    same = ResidualTransport(AffineTransport()).fit(X[30:], X[30:] ** 2, sample_weight=weight[30:])
    np.testing.assert_array_equal(found.transform(X), same.transform(X))


def test_target_rows_of_a_stack_do_not_reach_the_transport():
    X = rows_of(60)
    rows, domain = np.vstack([X, X + 50]), np.repeat([1, -1], 60)
    fitted = ResidualTransport(AffineTransport(outside="raise"), Ridge()).fit(rows, sample_domain=domain)
    np.testing.assert_array_equal(fitted.transform(rows, sample_domain=domain)[60:], X + 50)


@pytest.mark.parametrize("output", ["pandas", "polars"])
@pytest.mark.parametrize("container", [pd.DataFrame, pl.DataFrame])
def test_a_correction_knows_columns_by_their_names_and_takes_any_output(container, output):
    X, y = rows_of(40), rows_of(40, seed=1)
    named = [container({"a": rows[:, 0], "b": rows[:, 1]}) for rows in (X, y)]
    expected = ResidualTransport(ConditionalAffineTransport(context=[1])).fit(X, y)
    with config_context(transform_output=output):
        fitted = ResidualTransport(ConditionalAffineTransport(context=["b"])).fit(*named)
        np.testing.assert_allclose(np.asarray(fitted.transform(named[0])), expected.transform(X), atol=1e-12)
    np.testing.assert_array_equal(fitted.in_support(named[0]), expected.in_support(X))


@pytest.mark.parametrize(("n_rows", "gamma", "alpha"), [(11, 1.0 / 2, 1.0), (12, 0.05 / 2, 1e-3)])
def test_length_and_penalty_are_chosen_from_twelve_rows_on(n_rows, gamma, alpha):
    """Of a straight line the longest length and the least penalty are the best."""
    X = rows_of(n_rows)
    ridge = KernelRidgeCV().fit(X, X @ [[1.0], [2.0]]).model_.named_steps["kernelridge"]
    assert (ridge.gamma, ridge.alpha) == (gamma, alpha)


# -- several sources ---------------------------------------------------------------------------------------------------


def domains():
    """Return rows of two sources of 12 and 30 rows and a target of 18, in turn, their labels and weights."""
    rng = np.random.default_rng(0)
    labels = rng.permutation(np.repeat(["a", "b", "real"], [12, 30, 18]))
    rows = rng.normal(size=(60, 2)) * 3
    for label, mix in (("a", [[1.0, 0.5], [0.0, 2.0]]), ("b", [[0.3, 0.0], [1.0, 1.0]])):
        rows[labels == label] = rows[labels == label] @ mix + [5.0, -1.0]
    return rows, labels, rng.uniform(0.5, 2, 60)


@pytest.mark.parametrize("is_weighted", [False, True])
def test_sources_count_by_their_rows(is_weighted):
    rows, labels, weight = domains()
    weight = weight if is_weighted else None
    fitted = MultiSourceTransport().fit(rows, sample_weight=weight, sample_domain=labels)
    assert list(fitted.transports_) == list(dict.fromkeys(label for label in labels if label != "real"))
    target, distances, scores = rows[labels == "real"], [], []
    for label in "ab":
        own = labels == label
        given = None if weight is None else (weight[own], weight[labels == "real"])
        alone = AffineTransport().fit(rows[own], target, sample_weight=given)
        np.testing.assert_allclose(
            fitted.transform(rows, sample_domain=labels)[own], alone.transform(rows[own]), rtol=1e-12
        )
        distances.append(alone.wasserstein_distance_)
        scores.append(affinity_score(alone.transform(rows[own]), target, sample_weight=given))
    mean_square = (12 * distances[0] ** 2 + 30 * distances[1] ** 2) / 42
    assert fitted.wasserstein_distance_ == pytest.approx(np.sqrt(mean_square), rel=1e-12)
    score = fitted.score(rows, sample_weight=weight, sample_domain=labels)
    assert score == pytest.approx((12 * scores[0] + 30 * scores[1]) / 42, rel=1e-9)


@pytest.mark.parametrize("is_weighted", [False, True])
def test_the_barycentre_is_of_sources_by_their_weight_and_one_map_leads_from_it(is_weighted):
    rows, labels, weight = domains()
    weight = weight if is_weighted else None
    fitted = MultiSourceTransport(by="barycentre").fit(rows, sample_weight=weight, sample_domain=labels)
    counts = np.ones(60) if weight is None else weight
    parts = {label: (rows[labels == label], counts[labels == label]) for label in "ab"}
    shares = {label: own.sum() / counts[labels != "real"].sum() for label, (_, own) in parts.items()}
    means = {label: np.average(own, axis=0, weights=count) for label, (own, count) in parts.items()}
    spreads = {label: np.cov(own.T, bias=True, aweights=count) for label, (own, count) in parts.items()}
    middle = fitted.barycentre_covariance_
    np.testing.assert_allclose(fitted.barycentre_mean_, sum(shares[label] * means[label] for label in "ab"))
    mean_map = sum(shares[label] * transport_map(middle, spreads[label]) for label in "ab")
    np.testing.assert_allclose(mean_map, np.eye(2), atol=1e-8)
    moved = rows.copy()
    for label in "ab":
        step = (rows[labels == label] - means[label]) @ transport_map(spreads[label], middle).T
        moved[labels == label] = fitted.barycentre_mean_ + step
    is_target = labels == "real"
    order = np.concatenate([np.flatnonzero(labels == label) for label in fitted.transports_])
    given = None if weight is None else (weight[order], weight[is_target])
    shared = AffineTransport().fit(moved[order], rows[is_target], sample_weight=given)
    assert fitted.transports_["a"] is fitted.transports_["b"]
    carried = fitted.transform(rows, sample_domain=labels)
    np.testing.assert_allclose(carried[~is_target], shared.transform(moved[~is_target]), rtol=1e-6, atol=1e-8)
    np.testing.assert_array_equal(carried[is_target], rows[is_target])
    true = gaussian_wasserstein_distance(
        np.average(moved[order], axis=0, weights=counts[order]),
        np.cov(moved[order].T, bias=True, aweights=counts[order]),
        np.average(rows[is_target], axis=0, weights=counts[is_target]),
        np.cov(rows[is_target].T, bias=True, aweights=counts[is_target]),
    )
    assert fitted.wasserstein_distance_ == pytest.approx(true, rel=1e-5)


@pytest.mark.parametrize(
    ("labels", "target_domain", "sources"),
    [
        (["a", "target", "b", "real", "a", "measured"] * 3, None, ["a", "b"]),
        ([2, -1, 7, -1, 2, -3] * 3, None, [2, 7]),
        ([2.5, -1.0, 7.0, -1.0, 2.5, -3.0] * 3, None, [2.5, 7.0]),
        ([1, 0, 2, 0, 1, 0] * 3, 0, [1, 2]),
        (["a", "lab", "b", "hall", "a", "lab"] * 3, ["lab", "hall"], ["a", "b"]),
        (np.array([1, "target", "b", "real", 1, "measured"] * 3, dtype=object), None, [1, "b"]),
        (np.array([1, "lab", "b", 3, 1, "lab"] * 3, dtype=object), ["lab", 3], [1, "b"]),
        (["a", "lab", "b", 3, "a", "lab"] * 3, ["lab", 3], ["a", "b"]),
    ],
)
def test_target_rows_are_known_by_their_labels(labels, target_domain, sources):
    rows = rows_of(18)
    fitted = MultiSourceTransport(target_domain=target_domain).fit(rows, sample_domain=labels)
    assert list(fitted.transports_) == sources
    is_target = np.array([label not in sources for label in labels])
    carried = fitted.transform(rows, sample_domain=labels)
    np.testing.assert_array_equal(carried[is_target], rows[is_target])
    assert np.abs(carried - rows)[~is_target].max(axis=1).min() > 0
    part = fitted.transform(rows[:1], sample_domain=labels[:1])
    np.testing.assert_allclose(part, carried[:1], rtol=1e-12)


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        (None, "has to know the domain of every row"),
        (["real"] * 6, "there are 6 target rows and 0 sources"),
        (["a", "b"] * 3, "there are 0 target rows and 2 sources"),
        (["a", "real"], r"its shape is \(2,\), there are 6 rows"),
        ([["a", "real"]] * 3, r"its shape is \(3, 2\), there are 6 rows"),
        (np.array(["a", None, "real"] * 2, dtype=object), "no label for 2 of 6 rows"),
        ([1.0, np.nan, -1.0] * 2, "no label for 2 of 6 rows"),
        ([1, 0, -1] * 2, "2 of 6 are zero. Say which label is the target's by target_domain=0"),
    ],
)
def test_labels_without_a_target_or_a_source_are_refused(labels, message):
    with pytest.raises(ValueError, match=message):
        MultiSourceTransport().fit(rows_of(6), sample_domain=labels)


def test_rows_of_a_domain_that_was_not_fitted_and_the_way_back_are_refused():
    rows, labels, _ = domains()
    fitted = MultiSourceTransport().fit(rows, sample_domain=labels)
    with pytest.raises(ValueError, match="no rows of 'c', 'd' were fitted; the source domains are"):
        fitted.transform(rows[:3], sample_domain=["c", "d", "real"])
    with pytest.raises(ValueError, match=r"Use transports_\[label\]"):
        fitted.inverse_transform(rows)


@pytest.mark.parametrize("method", ["fit", "transform", "score"])
def test_rows_of_all_domains_must_be_finite_and_have_a_weight_each(method):
    rows, labels, weight = domains()
    transport = MultiSourceTransport().fit(rows, sample_domain=labels)
    broken = rows.copy()
    broken[np.flatnonzero(labels == "real")[0], 0] = np.nan
    with pytest.raises(ValueError, match="Input X contains NaN"):
        getattr(transport, method)(broken, sample_domain=labels)
    if method != "transform":
        with pytest.raises(ValueError, match=r"\(59,\)"):
            getattr(transport, method)(rows, sample_weight=weight[1:], sample_domain=labels)


@pytest.mark.parametrize("by", ["each", "barycentre"])
def test_a_source_without_weight_is_refused(by):
    rows, labels, weight = domains()
    weight[labels == "a"] = 0
    with pytest.raises(ValueError, match="at least one non-zero"):
        MultiSourceTransport(by=by).fit(rows, sample_weight=weight, sample_domain=labels)


@pytest.mark.parametrize("estimator", [MultiSourceTransport, ResidualTransport])
def test_what_is_no_transport_is_refused_as_one(estimator):
    rows, labels, _ = domains()
    with pytest.raises(ValueError, match="'transport' parameter"):
        estimator(make_pipeline(AffineTransport())).fit(rows, sample_domain=labels)


@pytest.mark.parametrize("unit", [1e-8, 1e-4, 1e6])
def test_the_barycentre_does_not_depend_on_the_unit(unit):
    rows, labels, _ = domains()
    here, there = (
        MultiSourceTransport(by="barycentre").fit(factor * rows, sample_domain=labels) for factor in (1, unit)
    )
    np.testing.assert_allclose(there.barycentre_covariance_, unit**2 * here.barycentre_covariance_, rtol=1e-9)


def test_the_barycentre_of_dependent_columns_is_that_of_the_others():
    rows, labels, _ = domains()
    dependent = np.column_stack([rows, rows.sum(axis=1), np.full(60, 0.1)])
    # Displacement of the third column counts, too: it is a matter of the metric in the plane.
    corner = np.linalg.cholesky(np.eye(2) + np.ones((2, 2)))
    here = MultiSourceTransport(by="barycentre").fit(rows @ corner, sample_domain=labels)
    there = MultiSourceTransport(by="barycentre").fit(dependent, sample_domain=labels)
    np.testing.assert_allclose(
        corner.T @ there.barycentre_covariance_[:2, :2] @ corner, here.barycentre_covariance_, rtol=1e-8
    )
    carried = there.transform(dependent, sample_domain=labels)
    np.testing.assert_allclose(carried[:, :2].sum(axis=1), carried[:, 2], rtol=1e-9)
    np.testing.assert_allclose(carried[:, 3], 0.1)


def test_the_barycentre_of_two_lines_at_right_angles_is_that_by_hand():
    roots = [np.array([[2.0], [0.0]]), np.array([[0.0], [4.0]])]
    root = barycentre_root(roots, np.array([0.25, 0.75]))
    np.testing.assert_allclose(root @ root.T, np.diag([0.25, 9.0]), atol=1e-12)


@pytest.mark.parametrize("container", [pd.DataFrame, pl.DataFrame])
def test_by_the_barycentre_columns_keep_their_names(container):
    rows, labels, _ = domains()
    frame = container({"a": rows[:, 0], "b": rows[:, 1]})
    named, numbered = (
        MultiSourceTransport(ConditionalAffineTransport(context=context), by="barycentre").fit_transform(
            X, sample_domain=labels
        )
        for context, X in ((["b"], frame), ([1], rows))
    )
    np.testing.assert_array_equal(named, numbered)


# -- splitters ---------------------------------------------------------------------------------------------------------

DOMAIN = np.array([1, -1, -1, 1, -1, -1, 1, -1, -1, 1])
SOURCE, TARGET = np.flatnonzero(DOMAIN > 0), np.flatnonzero(DOMAIN < 0)


@pytest.mark.parametrize(
    ("cv", "same"),
    [
        (3, KFold(3)),
        (KFold(2), KFold(2)),
        (3, StratifiedKFold(3)),
        (StratifiedKFold(2), StratifiedKFold(2)),
        (GroupKFold(3), GroupKFold(3)),
    ],
    ids=str,
)
def test_target_rows_are_split_by_any_splitter_with_their_values_and_groups(cv, same):
    y = np.array([0, 0, 1, 1, 1, 0, 0, 1, 0, 1]) if isinstance(same, StratifiedKFold) else None
    groups = np.arange(10) % 4 if isinstance(same, GroupKFold) else None
    splitter = TargetRows(cv, sample_domain=DOMAIN)
    own = (None if given is None else given[TARGET] for given in (y, groups))
    expected = list(same.split(TARGET, *own))
    found = list(splitter.split(pd.DataFrame({"a": range(10)}), y, groups))
    assert len(found) == len(expected) == splitter.get_n_splits(None, y, groups)
    for (train, test), (kept, left_out) in zip(found, expected):
        np.testing.assert_array_equal(test, TARGET[left_out])
        assert sorted(train) == sorted([*SOURCE, *TARGET[kept]])


@pytest.mark.parametrize(
    ("cv", "groups", "n_folds"),
    [
        (LeaveOneOut(), None, 6),
        # The last group has no target row.
        (LeaveOneGroupOut(), np.arange(10) // 3, 3),
        (KFold(3).split(TARGET), None, 3),
    ],
)
def test_a_grid_over_target_rows_has_as_many_folds_as_they_make(cv, groups, n_folds):
    splitter = TargetRows(cv, sample_domain=DOMAIN)
    grid = GridSearchCV(Ridge(), {"alpha": [0.1, 1.0]}, cv=splitter, scoring="neg_mean_squared_error")
    X = rows_of(10)
    scores = grid.fit(X, X[:, 0], groups=groups).cv_results_
    assert splitter.get_n_splits(X, X[:, 0], groups) == n_folds
    assert f"split{n_folds - 1}_test_score" in scores
    assert f"split{n_folds}_test_score" not in scores


def test_pairs_leave_with_their_partners_and_come_two_by_two():
    domain = ["sim", "real", "real", "sim", "sim", "real"]
    for (train, test), left_out in zip(
        TargetRows(3, paired=True).split([[0]] * 6, sample_domain=domain), range(3)
    ):
        source, target = np.array([0, 3, 4]), np.array([1, 2, 5])
        kept = [pair for pair in range(3) if pair != left_out]
        np.testing.assert_array_equal(test, target[[left_out]])
        np.testing.assert_array_equal(train, np.ravel(np.column_stack([source[kept], target[kept]])))
    assert repr(TargetRows(3)) == "TargetRows(3)"


@pytest.mark.parametrize(
    ("domain", "options", "message"),
    [
        (None, {}, "has to know which rows are target rows"),
        (np.ones(10), {}, "there are 10 source and 0 target rows"),
        (-np.ones(10), {}, "there are 0 source and 10 target rows"),
        (DOMAIN, {"paired": True}, "there are 4 and 6 rows"),
    ],
)
def test_rows_that_cannot_be_split_are_refused(domain, options, message):
    with pytest.raises(ValueError, match=message):
        next(TargetRows(2, **options).split(np.zeros((10, 1)), sample_domain=domain))
