"""Rows of two domains or more in one array: labels, rows without one, several sources, and what is scored."""

import numpy as np
import pandas as pd
import polars as pl
import pytest
from sklearn import config_context
from sklearn.base import clone
from sklearn.linear_model import Ridge
from sklearn.model_selection import (
    GroupKFold,
    cross_validate,
)
from sklearn.pipeline import make_pipeline

from skat import (
    CORAL,
    AffineTransport,
    ConditionalAffineTransport,
    ExactTransport,
    MultiSourceTransport,
    ProcrustesAffineTransport,
    ResidualTransport,
    TargetRows,
)
from skat.metrics import affinity_score

N = 60
CONTAINERS = {
    "numpy": np.asarray,
    "pandas": lambda rows: pd.DataFrame(rows, columns=list("abc")),
    "polars": lambda rows: pl.DataFrame(rows, schema=list("abc")),
}
each_container = pytest.mark.parametrize("container", CONTAINERS.values(), ids=CONTAINERS)


def pairs():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(N, 3)) @ rng.normal(size=(3, 3)) + 1
    return X, X @ (np.eye(3) + 0.3 * rng.normal(size=(3, 3))) + 0.05 * rng.normal(size=X.shape) - 2


def stacked():
    """Return rows of both domains in random order, their domains, what to predict, and the pair of each row."""
    X, y = pairs()
    domain = np.random.default_rng(1).permutation(np.repeat([1, -1], N))
    rows, pair, value = np.empty((2 * N, 3)), np.empty(2 * N, dtype=int), np.empty(2 * N)
    truth = y @ [1.0, -2.0, 0.5] + 0.1 * np.random.default_rng(2).normal(size=N)
    for sign, side in ((1, X), (-1, y)):
        rows[domain == sign], pair[domain == sign], value[domain == sign] = side, np.arange(N), truth
    return rows, domain, value, pair


@pytest.mark.parametrize(
    ("labels", "source"),
    [
        (lambda domain: np.where(domain > 0, "sim", "real"), None),
        (lambda domain: np.where(domain > 0, "source", "target"), None),
        (lambda domain: (domain > 0).astype(int), 1),
        (lambda domain: domain > 0, True),
        (lambda domain: pd.Series(np.where(domain > 0, "mujoco", "lab")), "mujoco"),
        (lambda domain: np.where(domain > 0, np.arange(len(domain)) % 2, 7), [0, 1]),
        (lambda domain: pl.Series(np.where(domain > 0, "mujoco", "lab")), "mujoco"),
        (lambda domain: np.where(domain > 0, np.array(["a", 3] * N, dtype=object), "lab"), ["a", 3]),
        (lambda domain: np.where(domain > 0, np.array(["a", 3] * N, dtype=object), "lab").tolist(), ["a", 3]),
    ],
)
def test_domains_are_understood_however_they_are_labelled(labels, source):
    rows, domain, _, _ = stacked()
    given = labels(domain)
    expected = AffineTransport().fit(rows, sample_domain=domain)
    transport = AffineTransport(source_domain=source).fit(rows, sample_domain=given)
    np.testing.assert_array_equal(
        transport.transform(rows, sample_domain=given), expected.transform(rows, sample_domain=domain)
    )
    assert transport.score(rows, sample_domain=given) == expected.score(rows, sample_domain=domain)


def test_target_rows_alone_are_carried_and_added_by_any_label():
    rows, domain, _, _ = stacked()
    given = np.where(domain > 0, "mujoco", "lab")
    fitted = AffineTransport(source_domain="mujoco").fit(rows, sample_domain=given)
    target = rows[domain < 0]
    np.testing.assert_array_equal(fitted.transform(target, sample_domain=given[domain < 0]), target)
    both = AffineTransport(source_domain="mujoco").partial_fit(
        rows[domain > 0], sample_domain=given[domain > 0]
    )
    both.partial_fit(target, sample_domain=given[domain < 0])
    np.testing.assert_allclose(both.coef_, fitted.coef_, rtol=1e-10)


@pytest.mark.parametrize(
    ("labels", "source", "message"),
    [
        ([0, 1], None, "1 of 2 values are zero or NaN.*source_domain=0"),
        (["hot", "cold"], None, "source_domain='hot'"),
        (["hot", "cold"], "warm", "labels are 'hot', 'cold'"),
        (np.array(["hot", None], dtype=object), "hot", "no label for 1 of 2 rows"),
    ],
)
def test_labels_that_say_nothing_are_refused_with_what_to_do(labels, source, message):
    with pytest.raises(ValueError, match=message):
        AffineTransport(source_domain=source).fit([[0.0], [1.0]], sample_domain=np.array(labels))


@pytest.mark.parametrize(
    "transport",
    [
        AffineTransport(),
        ProcrustesAffineTransport(),
        CORAL(),
        ExactTransport(),
        ResidualTransport(),
        ConditionalAffineTransport(context=1),
    ],
    ids=lambda transport: type(transport).__name__,
)
def test_rows_without_a_domain_are_what_unlabelled_says(transport):
    rows, domain, _, _ = stacked()
    fitted = clone(transport).set_params(unlabelled="target").fit(rows, sample_domain=domain)
    np.testing.assert_array_equal(fitted.transform(rows), rows)
    fitted.set_params(unlabelled="source")
    np.testing.assert_allclose(
        fitted.transform(rows), fitted.transform(rows, sample_domain=np.ones(len(rows))), rtol=1e-12
    )
    with pytest.raises(ValueError, match='unlabelled="target"'):
        fitted.set_params(unlabelled="raise").transform(rows)
    # After a fit to two arrays every row is a source row, whatever unlabelled says.
    X, y = pairs()
    apart = clone(transport).set_params(unlabelled="target").fit(X, y)
    assert np.abs(apart.transform(X) - X).max() > 0.1


@each_container
def test_a_pipeline_fitted_to_both_domains_predicts_measured_rows_without_routing(container):
    rows, domain, value, _ = stacked()
    X, y = pairs()
    pipeline = make_pipeline(AffineTransport(unlabelled="target"), Ridge())
    pipeline.fit(container(rows), value, affinetransport__sample_domain=domain)
    carried = np.array(rows)
    carried[domain > 0] = AffineTransport().fit(X, y).transform(X)
    by_hand = Ridge().fit(carried, value)
    np.testing.assert_allclose(pipeline.predict(container(y)), by_hand.predict(y), rtol=1e-10)


def test_with_routing_the_splitter_gets_the_domain_like_the_others():
    rows, domain, value, pair = stacked()
    with config_context(enable_metadata_routing=True):
        routed = cross_validate(
            make_pipeline(AffineTransport(unlabelled="target"), Ridge()),
            rows,
            value,
            cv=TargetRows(GroupKFold(3)).set_split_request(groups=True),
            params={"sample_domain": domain, "groups": pair},
            error_score="raise",
        )["test_score"]
    target = np.flatnonzero(domain < 0)
    folds = list(GroupKFold(3).split(target, groups=pair[target]))
    expected = []
    for train, test in folds:
        kept = np.sort(np.concatenate([np.flatnonzero(domain > 0), target[train]]))
        pipeline = make_pipeline(AffineTransport(unlabelled="target"), Ridge())
        pipeline.fit(rows[kept], value[kept], affinetransport__sample_domain=domain[kept])
        expected.append(pipeline.score(rows[target[test]], value[target[test]]))
    np.testing.assert_allclose(routed, expected, rtol=1e-10)


def test_own_score_of_a_transport_is_the_affinity_of_rows_not_fitted():
    rows, domain, value, pair = stacked()
    with config_context(enable_metadata_routing=True):
        scores = cross_validate(
            AffineTransport(),
            rows,
            value,
            cv=GroupKFold(3),
            params={"sample_domain": domain, "groups": pair},
            error_score="raise",
        )["test_score"]
    expected = []
    for train, test in GroupKFold(3).split(rows, groups=pair):
        (X, y), (X_test, y_test) = (
            (rows[part][domain[part] > 0], rows[part][domain[part] < 0]) for part in (train, test)
        )
        expected.append(affinity_score(AffineTransport().fit(X, y).transform(X_test), y_test))
    np.testing.assert_allclose(scores, expected, rtol=1e-9)


def test_target_rows_refuses_what_it_cannot_split():
    rows, domain, _, _ = stacked()
    with pytest.raises(ValueError, match="TargetRows has to know"):
        next(TargetRows(3).split(rows))
    with pytest.raises(ValueError, match="120 source and 0 target"):
        next(TargetRows(3, sample_domain=np.ones(120)).split(rows))
    drop = np.flatnonzero(domain < 0)[0]
    short = TargetRows(3, sample_domain=np.delete(domain, drop), paired=True)
    with pytest.raises(ValueError, match="there are 60 and 59"):
        next(short.split(np.delete(rows, drop, 0)))


def worlds(n_worlds=4, n_rows=200):
    rng = np.random.default_rng(3)
    target = rng.normal(size=(n_rows, 2)) @ [[1.0, 0.5], [0.0, 1.0]]
    sources = {
        k: rng.normal(size=(n_rows, 2)) @ (np.eye(2) + 0.4 * rng.normal(size=(2, 2))) + k
        for k in range(n_worlds)
    }
    rows = np.vstack([target, *sources.values()])
    labels = np.array(["lab"] * n_rows + [f"sim{k}" for k in sources for _ in range(n_rows)])
    return rows, labels, target, {f"sim{k}": value for k, value in sources.items()}


def test_every_source_has_a_map_of_its_own():
    rows, labels, target, sources = worlds()
    transport = MultiSourceTransport(target_domain="lab").fit(rows, sample_domain=labels)
    carried = transport.transform(rows, sample_domain=labels)
    np.testing.assert_array_equal(carried[labels == "lab"], target)
    for label, source in sources.items():
        expected = AffineTransport().fit(source, target).transform(source)
        np.testing.assert_allclose(carried[labels == label], expected, rtol=1e-10, atol=1e-12)
    scores = [affinity_score(carried[labels == label], target) for label in sources]
    assert transport.score(rows, sample_domain=labels) == pytest.approx(np.mean(scores), rel=1e-12)
    with pytest.raises(ValueError, match="no rows of 'sim9' were fitted"):
        transport.transform(rows[:1], sample_domain=["sim9"])
    with pytest.raises(ValueError, match="has a map for each of 4 domains"):
        transport.transform(rows)
    np.testing.assert_array_equal(transport.set_params(unlabelled="target").transform(rows), rows)


def test_by_the_barycentre_every_source_reaches_the_target_and_numbers_are_domains_too():
    rows, labels, target, sources = worlds()
    numbers = np.array([-1 if label == "lab" else int(label[3:]) + 1 for label in labels])
    transport = MultiSourceTransport(by="barycentre").fit(rows, sample_domain=numbers)
    carried = transport.transform(rows, sample_domain=numbers)
    for k in range(4):
        part = carried[numbers == k + 1]
        np.testing.assert_allclose(part.mean(axis=0), target.mean(axis=0), atol=1e-8)
        np.testing.assert_allclose(np.cov(part.T), np.cov(target.T), rtol=1e-5, atol=1e-6)
    # The barycentre is the fixed point: the mean of the maps from it to the sources is the identity.
    from skat.gaussian import transport_map

    maps = [transport_map(transport.barycentre_covariance_, np.cov(s.T, bias=True)) for s in sources.values()]
    np.testing.assert_allclose(np.mean(maps, axis=0), np.eye(2), atol=1e-8)


def test_of_one_source_both_ways_are_the_plain_transport():
    rows, labels, target, sources = worlds(1)
    expected = AffineTransport().fit(sources["sim0"], target).transform(sources["sim0"])
    for by in ("each", "barycentre"):
        carried = MultiSourceTransport(by=by, target_domain="lab").fit_transform(rows, sample_domain=labels)
        np.testing.assert_allclose(carried[labels == "sim0"], expected, atol=1e-6)


def test_target_rows_are_cut_into_five_folds_unless_told():
    assert TargetRows().get_n_splits() == 5
