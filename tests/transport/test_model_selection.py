"""Every way of scikit-learn's model selection to score, on every container: each score is the one computed by hand."""

import os

import numpy as np
import pandas as pd
import polars as pl
import pytest
from sklearn import config_context
from sklearn.base import clone
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.linear_model import Ridge
from sklearn.metrics import accuracy_score, make_scorer, max_error, r2_score
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_val_score, cross_validate, learning_curve
from sklearn.pipeline import make_pipeline

from skat import AffineTransport, ProcrustesAffineTransport, TargetRows
from skat.metrics import affinity_score, affinity_scorer, paired_error_scorer

N_PAIRS = 60
TRAIN_SHARES = (0.5, 1.0)
GRID = (None, "target")


def tensors(device):
    """Return a maker of tensors, or skip where there is no torch, no such device, or SciPy was not told."""
    torch = pytest.importorskip("torch")
    if os.environ.get("SCIPY_ARRAY_API") != "1":
        pytest.skip("SCIPY_ARRAY_API=1 has to be set before SciPy is imported")
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("there is no CUDA device")
    return lambda rows: torch.asarray(rows, device=device)


CONTAINERS = {
    "numpy": lambda: np.asarray,
    "pandas": lambda: lambda rows: pd.DataFrame(rows, columns=list("abc")) if rows.ndim == 2 else rows,
    "polars": lambda: lambda rows: pl.DataFrame(rows, schema=list("abc")) if rows.ndim == 2 else rows,
    "torch": lambda: tensors("cpu"),
    "cuda": lambda: tensors("cuda"),
}


def pairs(n_pairs):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(n_pairs, 3)) @ rng.normal(size=(3, 3)) + 1
    return X, X @ (np.eye(3) + 0.3 * rng.normal(size=(3, 3))) + 0.05 * rng.normal(size=X.shape) - 2


class Case:
    """Rows in one layout, and what scikit-learn is given of them."""

    def __init__(self, stacked):
        X, y = pairs(N_PAIRS)
        self.X, self.y, self.given = X, y, {}
        self.groups = np.arange(N_PAIRS) // 4
        if stacked:
            rng = np.random.default_rng(1)
            # Partners stand beside each other, either of them first.
            self.domain = rng.permuted(np.tile([1, -1], (N_PAIRS, 1)), axis=1).ravel()
            self.X = np.empty((2 * N_PAIRS, 3))
            self.X[self.domain > 0], self.X[self.domain < 0] = X, y
            self.groups = np.repeat(self.groups, 2)
            side = y @ [1.0, -2.0, 0.5] + 0.1 * rng.normal(size=N_PAIRS)
            self.y = np.empty(2 * N_PAIRS)
            self.y[self.domain > 0] = self.y[self.domain < 0] = side


# --- the four ways to score: scores of scikit-learn, an array, and the folds and parameters that they belong to ---


def by_cross_val_score(model, case, X, y, cv, scoring, given):
    folds = list(cv.split(case.X, None, case.groups))
    scores = cross_val_score(model, X, y, cv=folds, scoring=scoring, error_score="raise", **given(False))
    return scores, [(train, test, GRID[0]) for train, test in folds]


def by_cross_validate(model, case, X, y, cv, scoring, given):
    scores = cross_validate(model, X, y, cv=cv, scoring=scoring, error_score="raise", **given(True))
    folds = cv.split(case.X, None, case.groups)
    return scores["test_score"], [(train, test, GRID[0]) for train, test in folds]


def by_grid_search(model, case, X, y, cv, scoring, given):
    step = "" if not hasattr(model, "steps") else f"{model.steps[0][0]}__"
    search = GridSearchCV(
        model, {f"{step}metric_scale": list(GRID)}, cv=cv, scoring=scoring, error_score="raise", refit=False
    )
    given = given(True)
    search.fit(X, y, **given.pop("params", {}), **given)
    folds = list(cv.split(case.X, None, case.groups))
    scores = [search.cv_results_[f"split{k}_test_score"] for k in range(len(folds))]
    return np.ravel(scores), [(train, test, scale) for train, test in folds for scale in GRID]


def by_learning_curve(model, case, X, y, cv, scoring, given):
    folds = list(cv.split(case.X, None, case.groups))
    sizes, _, scores = learning_curve(
        model,
        X,
        y,
        cv=folds,
        scoring=scoring,
        train_sizes=list(TRAIN_SHARES),
        error_score="raise",
        **given(False),
    )
    assert list(sizes) == [int(share * len(folds[0][0])) for share in TRAIN_SHARES]
    return np.ravel(scores), [(train[:size], test, GRID[0]) for size in sizes for train, test in folds]


WAYS = {
    "cross_val_score": by_cross_val_score,
    "cross_validate with groups": by_cross_validate,
    "GridSearchCV": by_grid_search,
    "learning_curve": by_learning_curve,
}
each_way = pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
each_container = pytest.mark.parametrize("container", CONTAINERS.values(), ids=CONTAINERS)


def found_and_expected(way, model, case, container, cv, scoring, given, by_hand, *, routing=False):
    made = container()
    with config_context(
        enable_metadata_routing=routing, array_api_dispatch=made is not None and is_tensor(made(case.X))
    ):
        scores, folds = way(model, case, made(case.X), made(case.y), cv, scoring, given)
    return scores, [by_hand(*fold) for fold in folds]


def is_tensor(rows):
    return type(rows).__module__.partition(".")[0] == "torch"


# --- transports alone: both scorers ----------

SCORERS = {
    "paired": (paired_error_scorer, lambda carried, y: -np.linalg.norm(carried - y, axis=1).mean()),
    "affinity": (affinity_scorer(), affinity_score),
}


@each_container
@each_way
@pytest.mark.parametrize("scoring", SCORERS)
@pytest.mark.parametrize("layout", ["pairs", "stacked"])
def test_transports_alone_are_scored_as_by_hand(layout, scoring, way, container):
    case = Case(layout == "stacked")
    scorer, metric = SCORERS[scoring]
    transport = AffineTransport() if layout == "stacked" else ProcrustesAffineTransport()

    def given(groups):
        if layout == "pairs":
            return {"groups": case.groups} if groups else {}
        return {"params": {"sample_domain": case.domain, **({"groups": case.groups} if groups else {})}}

    def by_hand(train, test, scale):
        (X, y), (X_test, y_test) = (
            (case.X[rows], case.y[rows])
            if layout == "pairs"
            else (case.X[rows][case.domain[rows] > 0], case.X[rows][case.domain[rows] < 0])
            for rows in (train, test)
        )
        fitted = clone(transport).set_params(metric_scale=scale).fit(X, y)
        return metric(fitted.transform(X_test), y_test)

    found, expected = found_and_expected(
        way,
        transport,
        case,
        container,
        GroupKFold(3),
        scorer,
        given,
        by_hand,
        routing=layout == "stacked",
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9)


# --- a transport in front of a predictor: any scorer, on target rows ----------

METRICS = {
    "r2": ("r2", r2_score),
    "accuracy": ("accuracy", accuracy_score),
    "custom": (make_scorer(max_error, greater_is_better=False), lambda y, found: -max_error(y, found)),
}


@each_container
@each_way
@pytest.mark.parametrize("scoring", METRICS)
@pytest.mark.parametrize("layout", ["stacked", "stacked pairs"])
def test_predictors_of_target_rows_are_scored_as_by_hand(layout, scoring, way, container):
    case, paired = Case(True), layout == "stacked pairs"
    scorer, metric = METRICS[scoring]
    predictor = Ridge(solver="svd")  # the one for arrays of every library
    if scoring == "accuracy":
        predictor = LinearDiscriminantAnalysis()
        case.y = (case.y > np.median(case.y)).astype(int)
    transport = (ProcrustesAffineTransport if paired else AffineTransport)(unlabelled="target")
    model = make_pipeline(transport, predictor)
    domain_of_step = {f"{model.steps[0][0]}__sample_domain": case.domain}
    cv = TargetRows(GroupKFold(3), sample_domain=case.domain, paired=paired)

    def given(groups):
        return {"params": domain_of_step, **({"groups": case.groups} if groups else {})}

    def by_hand(train, test, scale):
        is_source = case.domain[train] > 0
        carried = np.array(case.X[train])
        fitted = clone(transport).set_params(metric_scale=scale).fit(carried[is_source], carried[~is_source])
        carried[is_source] = fitted.transform(carried[is_source])
        assert (case.domain[test] < 0).all()
        found = clone(predictor).fit(carried, case.y[train]).predict(case.X[test])
        return metric(case.y[test], found)

    found, expected = found_and_expected(way, model, case, container, cv, scorer, given, by_hand)
    np.testing.assert_allclose(found, expected, rtol=1e-7)


@pytest.mark.parametrize("n_pairs", [24, 120])
def test_a_grid_finds_the_same_parameters_as_by_hand_whatever_the_size_of_the_data(n_pairs):
    X, y = pairs(n_pairs)
    X, y = X * [1.0, 30.0, 1.0], y * [1.0, 30.0, 1.0]
    grid = {"alignment": ["raw", "whitened"], "metric_scale": [None, "target"]}
    search = GridSearchCV(
        ProcrustesAffineTransport(), grid, cv=3, scoring=paired_error_scorer, error_score="raise"
    )
    search.fit(X, y)
    expected = []
    for params in search.cv_results_["params"]:
        scores = []
        for part in np.array_split(np.arange(n_pairs), 3):
            kept = np.setdiff1d(np.arange(n_pairs), part)
            fitted = ProcrustesAffineTransport(**params).fit(X[kept], y[kept])
            scores.append(-np.linalg.norm(fitted.transform(X[part]) - y[part], axis=1).mean())
        expected.append(np.mean(scores))
    np.testing.assert_allclose(search.cv_results_["mean_test_score"], expected, rtol=1e-9)
    assert search.best_index_ == np.argmax(expected)


def test_rows_to_train_on_hold_both_domains_from_the_front():
    case = Case(True)
    ordered = np.argsort(-case.domain, kind="stable")
    domain = case.domain[ordered]  # all source rows first, as two arrays are stacked
    for train, test in TargetRows(3, sample_domain=domain).split(np.empty((2 * N_PAIRS, 1))):
        assert not set(train) & set(test)
        for size in (3, 10, 50, len(train)):
            n_source = (domain[train[:size]] > 0).sum()
            assert abs(n_source - size * N_PAIRS / len(train)) <= 1
    for train, _ in TargetRows(3, sample_domain=domain, paired=True).split(np.empty((2 * N_PAIRS, 1))):
        np.testing.assert_array_equal(train[::2] + N_PAIRS, train[1::2])
