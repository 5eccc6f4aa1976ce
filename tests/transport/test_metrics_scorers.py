"""The scorers at work in scikit-learn's model selection."""

import pickle

import numpy as np
import pandas as pd
import pytest
import sklearn
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV, StratifiedKFold, cross_validate, learning_curve
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler

from skat.metrics import (
    affinity_estimate,
    affinity_score,
    affinity_scorer,
    affinity_upper_bound,
    debiased_affinity_score,
    paired_error_scorer,
)
from skat.transport import AffineTransport, ConditionalAffineTransport, ProcrustesAffineTransport

TRANSPORTS = [AffineTransport(), ProcrustesAffineTransport(), ConditionalAffineTransport(context=1)]


def pairs(n_rows=120, noise=0.05):
    rng = np.random.default_rng(0)
    X = rng.exponential(size=(n_rows, 3))
    y = X @ rng.normal(size=(3, 3)) + rng.normal(size=3) + noise * rng.normal(size=(n_rows, 3))
    y[:, 0] = X[:, 0]
    return X, y


@pytest.mark.parametrize("transport", TRANSPORTS, ids=lambda transport: type(transport).__name__)
def test_cross_validate_takes_both_scorers(transport):
    X, y = pairs()
    scoring = {"error": paired_error_scorer, "affinity": affinity_scorer()}
    result = cross_validate(make_pipeline(FunctionTransformer(), transport), X, y, cv=3, scoring=scoring)
    assert (result["test_error"] <= 0).all()
    assert (result["test_affinity"] <= 1).all()


def test_scores_are_those_of_the_transformed_rows():
    X, y = pairs()
    pipeline = make_pipeline(StandardScaler(), AffineTransport()).fit(X[:80], y[:80])
    carried = pipeline.transform(X[80:])
    expected = -np.linalg.norm(carried - y[80:], axis=1).mean()
    assert paired_error_scorer(pipeline, X[80:], y[80:]) == pytest.approx(expected, rel=1e-14)
    assert affinity_scorer()(pipeline, X[80:], y[80:]) == affinity_score(carried, y[80:])


def test_grid_search_finds_the_map_of_least_error():
    X, y = pairs()
    search = GridSearchCV(
        make_pipeline(FunctionTransformer(), ProcrustesAffineTransport()),
        {"procrustesaffinetransport__alignment": ["raw", "whitened"]},
        scoring=paired_error_scorer,
        cv=3,
    ).fit(X, y)
    assert search.best_params_ == {"procrustesaffinetransport__alignment": "whitened"}
    assert search.best_score_ == pytest.approx(-0.05 * np.sqrt(2) * 1.2, rel=0.5)


def test_grid_search_takes_two_scorers_at_once():
    X, y = pairs()
    search = GridSearchCV(
        AffineTransport(),
        {"metric_scale": [None, "target"]},
        scoring={"error": paired_error_scorer, "affinity": affinity_scorer()},
        refit="affinity",
        cv=3,
    ).fit(X, y)
    assert {"mean_test_error", "mean_test_affinity"} <= set(search.cv_results_)


@pytest.mark.parametrize("transport", TRANSPORTS, ids=lambda transport: type(transport).__name__)
def test_data_frames_stay_data_frames_through_cross_validation(transport):
    X, y = (pd.DataFrame(rows, columns=list("abc")) for rows in pairs())
    seen = []

    def watchful_error(estimator, X, y):
        seen.append(estimator.transform(X).columns)
        return paired_error_scorer(estimator, X, y)

    pipeline = make_pipeline(FunctionTransformer(), transport).set_output(transform="pandas")
    scoring = {"error": watchful_error, "affinity": affinity_scorer()}
    result = cross_validate(pipeline, X, y, cv=3, scoring=scoring)
    plain = cross_validate(pipeline, X, y, cv=3, scoring=paired_error_scorer)
    assert [list(columns) for columns in seen] == [list("abc")] * 3
    np.testing.assert_array_equal(result["test_error"], plain["test_score"])


def test_learning_curve_rises_with_more_rows_by_either_scorer():
    X, y = pairs(400, noise=0.5)
    for scoring in (paired_error_scorer, affinity_scorer()):
        sizes, _, scores = learning_curve(
            ProcrustesAffineTransport(), X, y, train_sizes=[12, 200], cv=4, scoring=scoring
        )
        assert list(sizes) == [12, 200]
        assert scores[0].mean() < scores[1].mean() < 1


@pytest.mark.parametrize(
    ("score", "options"),
    [
        (debiased_affinity_score, {"random_state": 0}),
        (affinity_upper_bound, {"random_state": 0}),
        (affinity_estimate, {"random_state": 0, "paired": True}),
    ],
)
def test_scorer_takes_every_score(score, options):
    X, y = pairs()
    scorer = affinity_scorer(score, **options)
    result = cross_validate(AffineTransport(), X, y, cv=3, scoring=scorer)
    transport = AffineTransport().fit(X[40:], y[40:])
    assert result["test_score"][0] == float(score(transport.transform(X[:40]), y[:40], **options))
    assert score.__name__ in repr(scorer)


def test_beyond_the_largest_cost_matrix_the_default_scorer_is_the_estimate(monkeypatch):
    X, y = pairs(400)
    transport = AffineTransport().fit(X, y)
    exact = affinity_scorer()(transport, X, y)
    monkeypatch.setattr("skat.metrics.wasserstein.LARGEST_COST_MATRIX_BYTES", 8.0 * 399**2)
    expected = affinity_estimate(transport.transform(X), y, random_state=0).score
    assert affinity_scorer()(transport, X, y) == transport.score(X, y) == expected != exact
    search = GridSearchCV(transport, {"metric_scale": [None, "target"]}, cv=2, scoring=affinity_scorer())
    assert np.isfinite(search.fit(np.tile(X, (2, 1)), np.tile(y, (2, 1))).best_score_)
    # Of weighted rows there is no estimate, and the refusal says what to do.
    with pytest.raises(ValueError, match="affinity_estimate"):
        affinity_scorer()(transport, X, y, sample_weight=np.ones(400))


@pytest.mark.long
def test_a_grid_over_1e5_rows_of_each_is_scored():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200_000, 5))
    y = X @ rng.normal(size=(5, 5)) + 0.1 * rng.normal(size=X.shape)
    search = GridSearchCV(
        AffineTransport(), {"metric_scale": [None, "target"]}, cv=2, scoring=affinity_scorer()
    )
    assert search.fit(X, y).best_score_ > 0.9


def test_scorers_pickle_and_run_in_other_processes():
    X, y = pairs()
    scorer = pickle.loads(pickle.dumps(affinity_scorer(debiased_affinity_score, random_state=0)))
    transport = AffineTransport().fit(X, y)
    assert scorer(transport, X, y) == affinity_scorer(debiased_affinity_score, random_state=0)(
        transport, X, y
    )


def test_scorers_take_data_frames():
    X, y = (pd.DataFrame(rows, columns=list("abc")) for rows in pairs())
    transport = AffineTransport().set_output(transform="pandas").fit(X, y)
    assert affinity_scorer()(transport, X, y) == affinity_score(transport.transform(X), y)
    assert paired_error_scorer(transport, X, y) < 0


def test_weights_count_rows():
    X, y = pairs(30)
    counts = np.random.default_rng(0).integers(0, 4, size=30)
    transport = AffineTransport().fit(X, y)
    repeated = np.repeat(X, counts, axis=0), np.repeat(y, counts, axis=0)
    for scorer in (paired_error_scorer, affinity_scorer()):
        weighted = scorer(transport, X, y, sample_weight=counts)
        assert weighted == pytest.approx(scorer(transport, *repeated), rel=1e-9)


def test_stacked_rows_are_scored_by_domain():
    X, y = pairs()
    stacked, domain = np.vstack([X, y]), np.repeat([1, -1], len(X))
    labels = np.arange(len(stacked))
    with sklearn.config_context(enable_metadata_routing=True):
        result = cross_validate(
            AffineTransport(),
            stacked,
            labels,
            cv=StratifiedKFold(3).split(stacked, domain),
            scoring=affinity_scorer(),
            params={"sample_domain": domain},
        )
    train, test = next(StratifiedKFold(3).split(stacked, domain))
    fitted = AffineTransport().fit(stacked[train][domain[train] > 0], stacked[train][domain[train] < 0])
    carried = fitted.transform(stacked[test][domain[test] > 0])
    expected = affinity_score(carried, stacked[test][domain[test] < 0])
    assert result["test_score"][0] == pytest.approx(expected, rel=1e-12)


def test_weights_can_be_routed():
    X, y = pairs(30)
    weight = np.random.default_rng(0).random(30)
    with sklearn.config_context(enable_metadata_routing=True):
        scorer = affinity_scorer().set_score_request(sample_weight=True)
        transport = AffineTransport().set_fit_request(sample_weight=False)
        result = cross_validate(transport, X, y, cv=3, scoring=scorer, params={"sample_weight": weight})
    fitted = AffineTransport().fit(X[10:], y[10:])
    expected = affinity_score(fitted.transform(X[:10]), y[:10], sample_weight=weight[:10])
    assert result["test_score"][0] == pytest.approx(expected, rel=1e-12)


def test_scorers_say_what_is_wrong():
    X, y = pairs()
    with pytest.raises(TypeError, match=r"Ridge cannot transform\. Give a transport"):
        paired_error_scorer(Ridge().fit(X, y), X, y)
    with pytest.raises(ValueError, match=r"120 source and 100 target rows\. Use affinity_scorer\(\)"):
        paired_error_scorer(AffineTransport().fit(X, y), X, y[:100])
    with pytest.raises(TypeError, match="it is 'rho'"):
        affinity_scorer("rho")
    with pytest.raises(ValueError, match=r"120 are source and 0 target\. Stratify"):
        affinity_scorer()(AffineTransport().fit(X, y), X, sample_domain=np.ones(120))
