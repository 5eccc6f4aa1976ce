"""What rows, weights, domains and columns a transport takes, and what it says of those that it does not; support."""

import numpy as np
import pandas as pd
import pytest
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import cross_val_predict

from skat import AffineTransport
from skat.gaussian import row_moments
from skat.transport import importance_weights
from skat.transport.shift import Distances, Support

ROWS = np.arange(12.0).reshape(6, 2) ** 1.5
OTHER = ROWS[::-1] @ [[2.0, 0.5], [-0.3, 1.0]] + [1.0, 2.0]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"X": ROWS}, "requires y to be passed, but the target y is None. Give the target rows"),
        ({"X": ROWS[:1], "y": OTHER}, "the source has 1 sample(s), n_samples = 1. Give more rows."),
        ({"X": ROWS, "y": OTHER[:1]}, "the target has 1 sample(s), n_samples = 1. Give more rows."),
        ({"X": ROWS, "y": OTHER[:, 0]}, "2-D with the columns of X, n_features = 2; it is 1-D, of shape (6,)."),
        ({"X": ROWS[:1], "y": OTHER[0]}, "the source has 1 sample(s)"),
        ({"X": np.where(ROWS > 5, np.nan, ROWS), "y": OTHER[:, 0]}, "Input X contains NaN"),
        ({"X": ROWS, "y": OTHER[:, 0], "sample_weight": -np.ones(6)}, "Negative values in data"),
        ({"X": ROWS, "y": OTHER[:, :1]}, "X has 2 features, y has 1."),
        ({"X": ROWS, "y": OTHER[:5], "sample_weight": np.ones(6)},
         "there are 6 source rows and 5 target rows. Give a tuple"),
        ({"X": ROWS, "y": OTHER, "sample_weight": (np.ones(6),)}, "it has 1 entries"),
        ({"X": ROWS, "y": OTHER, "sample_weight": (np.ones(6), np.ones(5))}, "(5,)"),
        ({"X": ROWS, "sample_domain": np.ones(6)}, "marks none of the 6 rows as target (negative)."),
        ({"X": ROWS, "sample_domain": -np.ones(6)}, "marks none of the 6 rows as source (positive)."),
        ({"X": ROWS, "sample_domain": [1, -1]}, "it has 2, X 6 rows"),
        ({"X": ROWS, "sample_domain": [1, -1, -1, -1, -1, -1]}, "the source has 1 sample(s)"),
        ({"X": 1e200 * ROWS, "y": OTHER}, "the squares of X or y exceed the range of float64"),
        ({"X": pd.DataFrame(ROWS, columns=["a", "b"]), "y": pd.DataFrame(OTHER, columns=["b", "a"])},
         "X has ['a', 'b'], y has ['b', 'a']. Give y[X.columns]."),
        ({"X": pd.DataFrame(ROWS, columns=["a", "b"]), "y": pd.DataFrame(OTHER, columns=["a", "c"])},
         "missing: ['b'], unexpected: ['c']."),
    ],
)  # fmt: skip
def test_what_cannot_be_fitted_is_said(given, message):
    with pytest.raises(ValueError, match=r"\S") as caught:
        AffineTransport().fit(**given)
    assert message in " ".join(str(caught.value).split())


@pytest.mark.parametrize(
    "weight",
    [2.0, np.full(6, 2.0), (2.0, None), (None, np.full(6, 2.0)), (np.full(6, 3.0), 5.0)],
)
def test_weights_of_one_size_change_nothing(weight):
    expected = AffineTransport().fit(ROWS, OTHER)
    found = AffineTransport().fit(ROWS, OTHER, sample_weight=weight)
    np.testing.assert_allclose(found.coef_, expected.coef_, rtol=1e-10)
    np.testing.assert_allclose(found.intercept_, expected.intercept_, rtol=1e-9)


def test_weights_of_stacked_rows_are_those_of_each_side():
    domain, weight = np.array([1, -1] * 6), np.linspace(0.5, 2, 12)
    stacked = np.empty((12, 2))
    stacked[::2], stacked[1::2] = ROWS, OTHER
    found = AffineTransport().fit(stacked, sample_weight=weight, sample_domain=domain)
    expected = AffineTransport().fit(ROWS, OTHER, sample_weight=(weight[::2], weight[1::2]))
    np.testing.assert_allclose(found.coef_, expected.coef_, rtol=1e-11)
    score = found.score(stacked, sample_weight=weight, sample_domain=domain)
    assert score == pytest.approx(expected.score(ROWS, OTHER, sample_weight=(weight[::2], weight[1::2])))
    carried = found.fit_transform(stacked, sample_weight=weight, sample_domain=domain)
    np.testing.assert_array_equal(carried[1::2], OTHER)
    np.testing.assert_allclose(carried[::2], expected.transform(ROWS), rtol=1e-10)
    np.testing.assert_allclose(
        AffineTransport().fit_transform(ROWS, OTHER), AffineTransport().fit(ROWS, OTHER).transform(ROWS)
    )


# -- support -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_rows", [1, 3, 40, 199])
@pytest.mark.parametrize("level", [0.02, 0.5, 0.9])
def test_radius_is_the_distance_of_one_place_in_order(level, n_rows):
    """Of n rows and one that comes, a share of at most the level lies within the k-th, k = level (n + 1) rounded up."""
    values = np.random.default_rng(0).permutation(np.arange(1.0, n_rows + 1))
    support = Support(np.zeros(1), np.ones(1), np.eye(1)).calibrated(Distances.of(values))
    assert support.radius(level) == min(np.ceil(np.round(level * (n_rows + 1), 9)), n_rows)
    assert support.radius(1 - 1e-9) == n_rows


def test_support_of_weighted_rows_with_a_constant_column_is_that_of_the_others():
    rng = np.random.default_rng(0)
    rows, weight = rng.normal(size=(50, 2)) * [1.0, 1e6], rng.uniform(0.5, 2, size=50)
    flat = np.column_stack([rows, np.full(50, 7.0)])
    plain, wide = (Support.of(row_moments(one, weight), one, weight) for one in (rows, flat))
    np.testing.assert_allclose(wide.quantiles, plain.quantiles, rtol=1e-6)
    np.testing.assert_allclose(wide.distance(flat), plain.distance(rows), rtol=1e-6)
    assert np.isinf(wide.distance(np.add(flat, [0, 0, 0.01]))).all()
    assert Support.of(row_moments(rows, weight), rows[:0]).quantiles is None
    left_out = plain.left_out(rows, row_moments(rows, weight), weight)
    np.testing.assert_array_equal(plain.quantiles, Distances.of(left_out).quantiles)


def test_importance_weights_are_the_odds_that_a_classifier_gives_rows_it_has_not_seen():
    rng = np.random.default_rng(0)
    here, there = rng.normal(size=(60, 2)), 1 + rng.normal(size=(40, 2))
    classifier = LogisticRegression(C=0.3)
    found = importance_weights(here, there, classifier=classifier, cv=4)
    seen = cross_val_predict(
        classifier, np.vstack([here, there]), np.r_[np.zeros(60), np.ones(40)], cv=4, method="predict_proba"
    )[:60]
    odds = seen[:, 1] / seen[:, 0]
    np.testing.assert_allclose(found, odds / odds.mean(), rtol=1e-9)
    with pytest.raises(ValueError, match="X has 2, y has 1"):
        importance_weights(here, there[:, :1])
