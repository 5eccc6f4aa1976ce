"""Fit, transform and score as scikit-learn's users know them, and what wrong input is told."""

import pickle
from functools import partial

import numpy as np
import pandas as pd
import pytest
from sklearn import config_context
from sklearn.base import clone
from sklearn.compose import make_column_selector
from sklearn.covariance import GraphicalLasso, LedoitWolf
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV, cross_validate, learning_curve
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils._param_validation import InvalidParameterError

from skat import (
    CORAL,
    AffineTransport,
    ConditionalAffineTransport,
    ExactTransport,
    IdentityTransport,
    ProcrustesAffineTransport,
    ResidualTransport,
)
from skat.metrics import affinity_scorer, paired_error_scorer
from skat.transport import KernelAlignment

TRANSPORTS = [
    AffineTransport(),
    AffineTransport(covariance="shrunk"),
    AffineTransport(covariance=LedoitWolf(), metric_scale="target"),
    ProcrustesAffineTransport(),
    ProcrustesAffineTransport(covariance="shrunk"),
    ProcrustesAffineTransport(alignment="raw", center=False),
    ConditionalAffineTransport(context=1),
    CORAL(),
    ExactTransport(),
    IdentityTransport(),
    ResidualTransport(regressor=Ridge()),
]
each_transport = pytest.mark.parametrize("transport", TRANSPORTS, ids=str)


def pairs(n_rows=60, seed=0):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n_rows, 3)) @ rng.normal(size=(3, 3)) + 1
    return X, X @ (np.eye(3) + 0.2 * rng.normal(size=(3, 3))) + 0.1 * rng.normal(size=X.shape) - 2


def stacked(seed=0):
    X, y = pairs(seed=seed)
    order = np.random.default_rng(seed).permutation(120)
    # Both sides keep their own order, as Procrustes pairs rows by it.
    domain = np.where(order < 60, 3, -2)
    rows = np.empty((120, 3))
    rows[domain > 0], rows[domain < 0] = X, y
    return rows, domain, X, y


@each_transport
def test_stacked_rows_give_the_map_of_two_arrays(transport):
    rows, domain, X, y = stacked()
    labels = np.full(len(rows), np.nan)
    together, apart = clone(transport).fit(rows, labels, sample_domain=domain), clone(transport).fit(X, y)
    np.testing.assert_array_equal(together.transform(X, sample_domain=np.ones(60)), apart.transform(X))
    carried = together.transform(rows, sample_domain=domain)
    np.testing.assert_array_equal(carried[domain < 0], y)
    np.testing.assert_allclose(carried[domain > 0], apart.transform(X), rtol=1e-13, atol=1e-13)
    np.testing.assert_array_equal(clone(transport).fit_transform(rows, labels, sample_domain=domain), carried)
    assert together.score(rows, sample_domain=domain) == apart.score(X, y)


@each_transport
def test_after_a_stacked_fit_transform_asks_for_the_domain_and_names_both_remedies(transport):
    rows, domain, _, _ = stacked()
    transport = clone(transport).fit(rows, sample_domain=domain)
    with pytest.raises(ValueError, match=r"Pass sample_domain=.*fit\(X_source, X_target\)"):
        transport.transform(rows)


@each_transport
def test_missing_target_is_an_error_that_names_both_ways_to_give_one(transport):
    X, _ = pairs()
    for method in ("fit", "fit_transform"):
        with pytest.raises(ValueError, match=r"fit\(X_source, X_target\).*fit\(X, sample_domain=d\)"):
            getattr(clone(transport), method)(X)


@each_transport
def test_transports_survive_pickling_and_cloning(transport):
    X, y = pairs()
    fitted = clone(transport).fit(X, y)
    again = pickle.loads(pickle.dumps(fitted))
    np.testing.assert_array_equal(again.transform(X), fitted.transform(X))
    assert not hasattr(clone(fitted), "n_features_in_")


@each_transport
def test_names_and_frames_go_through(transport):
    X, y = (pd.DataFrame(rows, columns=["x", "y", "v"]) for rows in pairs())
    fitted = clone(transport).set_output(transform="pandas").fit(X, y)
    carried = fitted.transform(X)
    assert list(carried.columns) == ["x", "y", "v"] == list(fitted.get_feature_names_out())
    expected = clone(transport).fit(*pairs()).transform(pairs()[0])
    np.testing.assert_allclose(carried, expected, rtol=1e-10)
    assert list(fitted.fit_transform(X, y).columns) == ["x", "y", "v"]


@each_transport
def test_every_bad_input_has_an_error_of_its_own(transport):
    X, y = pairs()
    frame = pd.DataFrame(X, columns=["x", "y", "v"])

    def fit(X, y, **given):
        clone(transport).fit(X, y, **given)

    nan, infinite = y.copy(), X.copy()
    nan[3, 1], infinite[2, 0] = np.nan, -np.inf
    for call, message in [
        (lambda: fit(X, nan), "Input y contains NaN"),
        (lambda: fit(infinite, y), "Input X contains infinity"),
        (lambda: fit(X[:1], y[:1]), "the source has 1 sample"),
        (lambda: fit(X, y[:1]), "the target has 1 sample"),
        (lambda: fit(X[:0], y), "0 sample"),
        (lambda: fit(X[:, :0], y), "0 feature"),
        (lambda: fit(X, y[:, :2]), "X has 3 features, y has 2"),
        (lambda: fit(X, y[:, 0]), r"y must be 2-D .* it is 1-D.*sample_domain"),
        (lambda: fit(frame, frame[["y", "x", "v"]]), r"in the order of those of X.*Give y\[X.columns\]"),
        (lambda: fit(frame, frame.rename(columns={"v": "w"})), r"missing: \['v'\], unexpected: \['w'\]"),
        (lambda: fit(X, y, sample_domain=np.ones(60)), "marks none of the 60 rows as target"),
        (lambda: fit(X, y, sample_domain=np.zeros(60)), "60 of 60 values are zero or NaN"),
        (lambda: fit(X, y, sample_domain=np.ones(59)), "it has 59, X 60 rows"),
        (lambda: fit(X, y, sample_domain=["sim"] * 60), "marks none of the 60 rows as target"),
        (lambda: fit(X, y, sample_domain=["hot"] * 60), r"numbers, .*source_domain='hot'"),
        (lambda: fit(X, y, sample_domain=np.ones((60, 1))), "1-D array of one label per row"),
        (
            lambda: fit(X, np.vstack([y, y]), sample_weight=np.ones(60)),
            r"60 source rows and 120.*Give a tuple",
        ),
        (lambda: fit(X, y, sample_weight=-np.ones(60)), "Negative values"),
    ]:
        with pytest.raises(ValueError, match=message):
            call()


@each_transport
def test_transform_refuses_what_fit_would(transport):
    X, y = pairs()
    fitted = clone(transport).fit(X, y)
    spoilt = X.copy()
    spoilt[5, 2] = np.nan
    with pytest.raises(ValueError, match="Input X contains NaN"):
        fitted.transform(spoilt)
    with pytest.raises(ValueError, match="Input X contains NaN"):
        (fitted.transform if isinstance(fitted, ResidualTransport) else fitted.inverse_transform)(spoilt)
    with pytest.raises(ValueError, match="3 features"):
        fitted.transform(X[:, :2])
    with pytest.raises(NotFittedError):
        clone(transport).transform(X)


def test_parameters_that_make_no_sense_are_told_so():
    X, y = pairs()
    for transport, message in [
        (
            AffineTransport(covariance="robust"),
            "'covariance' parameter .* a str among .*Got 'robust'",
        ),
        (AffineTransport(covariance=LedoitWolf), r"not its class; give LedoitWolf\(\)"),
        (AffineTransport(metric_scale="source"), "'metric_scale' parameter .* Got 'source'"),
        (AffineTransport(metric_scale=[1.0, -1.0, 2.0]), "one positive length per feature, 3"),
        (ProcrustesAffineTransport(alignment="none"), "'alignment' parameter .* Got 'none'"),
        (ProcrustesAffineTransport(center=False), 'alignment="raw"'),
        (ConditionalAffineTransport(context=3), "less than the number of columns"),
        (ConditionalAffineTransport(context=[]), "names 0 of 3"),
        (ConditionalAffineTransport(context=1, shrinkage="target"), "'shrinkage' parameter"),
        (ConditionalAffineTransport(context=1, shrinkage="source", covariance="shrunk"), "drawn twice"),
        (AffineTransport(unlabelled="real"), "'unlabelled' parameter .* Got 'real'"),
        (AffineTransport(rank_deficient="drop"), "'rank_deficient' parameter"),
        (AffineTransport(outside="stop"), "'outside' parameter"),
        (ResidualTransport(regressor="ridge"), "'regressor' parameter"),
        (KernelAlignment(gamma=-1.0), "'gamma' parameter"),
    ]:
        with pytest.raises(ValueError, match=message):
            transport.fit(X, y)
    with pytest.raises(InvalidParameterError):
        AffineTransport(covariance="robust").fit(X, y)


def test_weights_are_repetitions():
    X, y = pairs()
    rng = np.random.default_rng(1)
    weight, other = rng.integers(0, 4, size=60), rng.integers(0, 4, size=60)
    repeated = AffineTransport().fit(np.repeat(X, weight, axis=0), np.repeat(y, other, axis=0))
    weighted = AffineTransport().fit(X, y, sample_weight=(weight, other))
    np.testing.assert_allclose(weighted.coef_, repeated.coef_, rtol=1e-11)
    np.testing.assert_allclose(weighted.intercept_, repeated.intercept_, rtol=1e-11)
    beside = AffineTransport().fit(X, y, sample_weight=weight)
    np.testing.assert_allclose(
        beside.coef_, AffineTransport().fit(X, y, sample_weight=(weight, weight)).coef_, rtol=1e-14
    )
    rows, domain, X, y = stacked()
    weight = rng.uniform(size=120)
    apart = AffineTransport().fit(X, y, sample_weight=(weight[domain > 0], weight[domain < 0]))
    together = AffineTransport().fit(rows, sample_weight=weight, sample_domain=domain)
    np.testing.assert_allclose(together.coef_, apart.coef_, rtol=1e-13)


def test_partial_fit_takes_either_side_and_has_a_map_once_both_are_there():
    X, y = pairs()
    transport = AffineTransport().partial_fit(X)
    with pytest.raises(NotFittedError, match="no target rows yet"):
        transport.transform(X)
    transport.partial_fit(y=y[:2])
    assert transport.rank_ == 1
    transport.partial_fit(y=y[2:])
    np.testing.assert_allclose(transport.coef_, AffineTransport().fit(X, y).coef_, rtol=1e-12)
    with pytest.raises(ValueError, match="needs rows"):
        transport.partial_fit()
    with pytest.raises(ValueError, match="needs all rows at once"):
        AffineTransport(covariance=LedoitWolf()).partial_fit(X, y)


def test_partial_fit_says_what_is_missing_while_the_source_does_not_reach_the_target():
    X, y = pairs()
    transport = AffineTransport().partial_fit(X[:2], y)
    with pytest.raises(NotFittedError, match=r"rank\(S_t\) is 3"):
        transport.transform(X)
    transport.partial_fit(X[2:])
    np.testing.assert_allclose(transport.coef_, AffineTransport().fit(X, y).coef_, rtol=1e-12)


@pytest.mark.parametrize(
    "transport", [ProcrustesAffineTransport(), ConditionalAffineTransport(context=["x"])]
)
def test_partial_fit_of_pairs_equals_fit(transport):
    X, y = (pd.DataFrame(rows, columns=["x", "y", "v"]) for rows in pairs())
    parts = clone(transport)
    for start in range(0, 60, 20):
        parts.partial_fit(X.iloc[start : start + 20], y.iloc[start : start + 20])
    np.testing.assert_allclose(parts.coef_, clone(transport).fit(X, y).coef_, rtol=1e-11, atol=1e-13)


def test_procrustes_needs_pairs():
    X, y = pairs()
    with pytest.raises(ValueError, match="60 source rows and 59 target rows"):
        ProcrustesAffineTransport().fit(X, y[:-1])
    with pytest.raises(ValueError, match="source and target rows together"):
        ProcrustesAffineTransport().partial_fit(X)
    with pytest.warns(UserWarning, match="no correlation"):
        ProcrustesAffineTransport().fit(X, np.random.default_rng(0).permutation(y))


def test_shuffled_pairs_warn_nearly_always_and_true_ones_never():
    rng = np.random.default_rng(0)
    for _ in range(100):
        X, y = pairs(seed=int(rng.integers(2**31)))
        ProcrustesAffineTransport().fit(X, y)
        with pytest.warns(UserWarning, match="no correlation"):
            ProcrustesAffineTransport().fit(X, rng.permutation(y))


@pytest.mark.parametrize(
    "context",
    [
        2,
        [0, 1],
        ["x", "y"],
        slice(0, 2),
        [True, True, False],
        lambda X: [0, 1],
        lambda X: X.columns != "v",
        make_column_selector("x|y"),
    ],
)
def test_context_is_understood_in_every_form(context):
    X, y = (pd.DataFrame(rows, columns=["x", "y", "v"]) for rows in pairs())
    carried = ConditionalAffineTransport(context=context).fit(X, y).transform(X)
    np.testing.assert_array_equal(carried[:, :2], X[["x", "y"]])
    np.testing.assert_array_equal(carried, ConditionalAffineTransport(context=2).fit(X, y).transform(X))


def test_any_covariance_estimator_is_used():
    X, y = pairs()
    transport = AffineTransport(covariance=GraphicalLasso(alpha=0.1)).fit(X, y)
    for rows, covariance in ((X, transport.source_covariance_), (y, transport.target_covariance_)):
        np.testing.assert_allclose(covariance, GraphicalLasso(alpha=0.1).fit(rows).covariance_, rtol=1e-9)
    with pytest.raises(ValueError, match="GraphicalLasso takes no sample_weight"):
        clone(transport).fit(X, y, sample_weight=np.ones(60))


def test_pipeline_scores_target_rows_as_a_regressor_on_carried_source_rows():
    rows, domain, X, y = stacked()
    labels = rows @ [1.0, -2.0, 0.5] + np.random.default_rng(0).normal(size=120)
    by_hand = Ridge().fit(AffineTransport().fit(X, y).transform(X), labels[domain > 0])
    with config_context(enable_metadata_routing=True):
        # The regressor sees all rows; weights of zero leave the target rows to the transport alone.
        transport = AffineTransport().set_fit_request(sample_weight=False)
        pipeline = Pipeline([("carry", transport), ("ridge", Ridge().set_fit_request(sample_weight=True))])
        pipeline.fit(rows, labels, sample_domain=domain, sample_weight=(domain > 0).astype(float))
        target = domain < 0
        score = pipeline.score(rows[target], labels[target], sample_domain=domain[target])
        prediction = pipeline.predict(rows[target], sample_domain=domain[target])
    assert score == pytest.approx(by_hand.score(y, labels[target]), abs=1e-12)
    np.testing.assert_allclose(prediction, by_hand.predict(y), rtol=1e-12)


def test_grid_search_over_a_pipeline_with_domains():
    rows, domain, _, _ = stacked()
    labels = rows @ [1.0, -2.0, 0.5]
    with config_context(enable_metadata_routing=True):
        search = GridSearchCV(
            make_pipeline(AffineTransport(), Ridge()),
            {"affinetransport__covariance": ["empirical", "shrunk"], "ridge__alpha": [0.1, 1.0]},
            cv=3,
            error_score="raise",
        ).fit(rows, labels, sample_domain=domain)
    assert len(search.cv_results_["params"]) == 4
    assert np.isfinite(search.cv_results_["mean_test_score"]).all()


@pytest.mark.parametrize(
    "scoring", [affinity_scorer(), paired_error_scorer, None], ids=["affinity", "paired", "score"]
)
def test_model_selection_works_with_each_score(scoring):
    X, y = pairs()
    search = GridSearchCV(
        ProcrustesAffineTransport(),
        {"alignment": ["whitened", "raw"]},
        scoring=scoring,
        cv=3,
        error_score="raise",
    ).fit(X, y)
    assert search.best_params_["alignment"] in ("whitened", "raw")
    scores = cross_validate(AffineTransport(), X, y, scoring=scoring, cv=3, error_score="raise")
    assert np.isfinite(scores["test_score"]).all()
    _, _, held_out = learning_curve(
        AffineTransport(), X, y, scoring=scoring, train_sizes=[0.5, 1.0], cv=3, error_score="raise"
    )
    assert np.isfinite(held_out).all()


def test_transports_work_between_other_steps_with_set_output():
    X, y = (pd.DataFrame(rows, columns=["x", "y", "v"]) for rows in pairs())
    pipeline = make_pipeline(AffineTransport(), StandardScaler()).set_output(transform="pandas")
    assert list(pipeline.fit_transform(X, y).columns) == ["x", "y", "v"]
    np.testing.assert_allclose(pipeline[:-1].transform(X).mean(), y.mean(), rtol=1e-12)


def test_integers_and_lists_are_rows_too():
    transport = AffineTransport().fit([[0, 1], [1, 0], [2, 2]], [[0, 2], [2, 0], [4, 4]])
    np.testing.assert_allclose(transport.transform([[3, 3]]), [[6, 6]], atol=1e-12)


@pytest.mark.parametrize(
    "transport",
    [
        AffineTransport(),
        AffineTransport(metric_scale="target", covariance="shrunk"),
        ProcrustesAffineTransport(),
        ConditionalAffineTransport(context=1),
    ],
    ids=str,
)
def test_a_pickle_carries_both_ways_knows_its_support_and_goes_on_learning(transport):
    X, y = pairs(500)
    later = pairs(50, seed=1)
    fitted = clone(transport).fit(X, y)
    again = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(fitted))))
    for call in ("transform", "in_support"):
        np.testing.assert_array_equal(getattr(again, call)(X), getattr(fitted, call)(X))
    np.testing.assert_array_equal(again.coef_, fitted.coef_)
    # A factor comes back as its triangle, which rounds otherwise.
    nearly = partial(np.testing.assert_allclose, rtol=1e-11, atol=1e-12)
    nearly(again.support_distance(X), fitted.support_distance(X))
    nearly(again.inverse_transform(y), fitted.inverse_transform(y))
    nearly(again.target_covariance_, fitted.target_covariance_)
    nearly(again.partial_fit(*later).coef_, fitted.partial_fit(*later).coef_)


@each_transport
def test_nothing_is_left_of_an_earlier_fit_where_another_fails(transport):
    X, y = pairs()
    fitted = clone(transport).fit(X, y)
    for source, target in ((np.full_like(X, np.nan), y), (X, np.full_like(y, np.nan))):
        with pytest.raises(ValueError, match="NaN"):
            fitted.fit(source, target)
        assert [name for name in vars(fitted) if name.endswith("_")] == ["n_features_in_"]
        for method in (fitted.transform, fitted.inverse_transform):
            with pytest.raises(NotFittedError):
                method(X)
    np.testing.assert_array_equal(fitted.fit(X, y).transform(X), clone(transport).fit(X, y).transform(X))


def test_a_refit_without_shrinkage_has_none():
    X, y = pairs()
    fitted = AffineTransport(covariance="shrunk", mean="shrunk").fit(X, y)
    fitted.set_params(covariance="empirical", mean="empirical").fit(X, y)
    assert not hasattr(fitted, "shrinkage_")
    assert not hasattr(fitted, "mean_shrinkage_")


@pytest.mark.parametrize("change", [{"covariance": "empirical"}, {"metric_scale": None}], ids=str)
def test_parameters_act_at_the_next_fit_only(change):
    X, y = pairs(20)
    fitted = AffineTransport(covariance="shrunk", metric_scale=[1.0, 10.0, 100.0]).fit(X, y)
    expected, covariance = fitted.inverse_transform(y), fitted.target_covariance_
    changed = clone(fitted).fit(X, y).set_params(**change)
    for found in (changed, pickle.loads(pickle.dumps(changed))):
        np.testing.assert_allclose(found.inverse_transform(y), expected, rtol=1e-9)
        np.testing.assert_allclose(found.target_covariance_, covariance, rtol=1e-12)


def test_a_pickle_before_there_is_a_map_goes_on_learning():
    X, y = pairs()
    begun = pickle.loads(pickle.dumps(AffineTransport().partial_fit(X)))
    with pytest.raises(NotFittedError, match="no map yet"):
        begun.transform(X)
    np.testing.assert_array_equal(begun.partial_fit(y=y).coef_, AffineTransport().fit(X, y).coef_)


@pytest.mark.parametrize(("n_features", "scale"), [(30, None), (100, None), (40, "target"), (100, "target")])
def test_a_pickle_is_of_at_most_twice_the_map(n_features, scale):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(3000, n_features))
    y = X @ (np.eye(n_features) + 0.1 * rng.normal(size=(n_features, n_features)))
    fitted = AffineTransport(metric_scale=scale).fit(X, y)
    assert len(pickle.dumps(fitted)) <= 2 * (fitted.coef_.nbytes + fitted.intercept_.nbytes)
    again = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(fitted))))
    np.testing.assert_array_equal(again.coef_, fitted.coef_)
