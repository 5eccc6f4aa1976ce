"""Dask containers are reduced where they are, in any chunks, and on a cluster."""

import numpy as np
import pandas as pd
import pytest

from skat import AffineTransport, ConditionalAffineTransport, ProcrustesAffineTransport
from skat.gaussian import AffineMap, row_moments
from skat.gaussian.backends import apply_map, beside, moments_of, on_host, to_namespace

da = pytest.importorskip("dask.array")
dd = pytest.importorskip("dask.dataframe")


def arrays(n_rows=300):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(n_rows, 4)) @ (np.eye(4) + 0.2 * rng.normal(size=(4, 4))) + 3
    return X, X @ (np.eye(4) + 0.2 * rng.normal(size=(4, 4))) + 0.3 * rng.normal(size=X.shape)


TRANSPORTS = [
    AffineTransport(),
    AffineTransport(covariance="shrunk"),
    ProcrustesAffineTransport(),
    ConditionalAffineTransport(context=2),
]


@pytest.mark.parametrize("transport", TRANSPORTS, ids=str)
@pytest.mark.parametrize("chunks", [(70, 4), (300, 4), (7, 2)])
def test_dask_arrays_give_the_map_of_their_values(transport, chunks):
    X, y = arrays()
    expected = transport.fit(X, y)
    coef, carried, back = expected.coef_, expected.transform(X), expected.inverse_transform(y)
    lazy = transport.fit(da.from_array(X, chunks=chunks), da.from_array(y, chunks=chunks))
    np.testing.assert_allclose(lazy.coef_, coef, rtol=1e-11, atol=1e-13)
    image = lazy.transform(da.from_array(X, chunks=chunks))
    assert isinstance(image, da.Array)
    np.testing.assert_allclose(image.compute(), carried, rtol=1e-11)
    np.testing.assert_allclose(
        lazy.inverse_transform(da.from_array(y, chunks=chunks)).compute(), back, rtol=1e-10
    )
    np.testing.assert_allclose(lazy.transform(X), carried, rtol=1e-11)


@pytest.mark.parametrize(
    "transport",
    [AffineTransport(), ConditionalAffineTransport(context=["a", "b"]), ProcrustesAffineTransport()],
    ids=str,
)
def test_dask_frames_keep_their_names(transport):
    X, y = (pd.DataFrame(rows, columns=list("abcd")) for rows in arrays())
    coef, carried = transport.fit(X, y).coef_, transport.transform(X)
    lazy = transport.fit(dd.from_pandas(X, npartitions=4), dd.from_pandas(y, npartitions=3))
    np.testing.assert_allclose(lazy.coef_, coef, rtol=1e-11, atol=1e-13)
    assert list(lazy.feature_names_in_) == list("abcd")
    image = lazy.transform(dd.from_pandas(X, npartitions=4))
    assert list(image.columns) == list("abcd")
    np.testing.assert_allclose(image.compute().to_numpy(), carried, rtol=1e-11)
    with pytest.raises(ValueError, match="in the order of those of X"):
        transport.fit(dd.from_pandas(X, npartitions=4), dd.from_pandas(y[list("bacd")], npartitions=4))


def test_stacked_and_weighted_dask_rows_give_the_map_of_their_values():
    X, y = arrays()
    rng = np.random.default_rng(1)
    rows, domain, weight = np.vstack([X, y]), np.repeat([1, -1], 300), rng.uniform(0.5, 2, size=600)
    order = rng.permutation(600)
    rows, domain = rows[order], domain[order]
    expected = AffineTransport().fit(rows, sample_domain=domain, sample_weight=weight)
    lazy_rows, lazy_domain = da.from_array(rows, chunks=(110, 4)), da.from_array(domain, chunks=110)
    for given in (domain, lazy_domain):
        lazy = AffineTransport().fit(lazy_rows, sample_domain=given, sample_weight=weight)
        np.testing.assert_allclose(lazy.coef_, expected.coef_, rtol=1e-11, atol=1e-13)
        image = lazy.transform(lazy_rows, sample_domain=given).compute()
        np.testing.assert_allclose(image, expected.transform(rows, sample_domain=domain), rtol=1e-11)


def test_nothing_is_computed_before_it_is_asked_for_and_no_block_is_joined_to_another():
    largest = []

    def block(block_id):
        rows = np.random.default_rng(block_id[0]).normal(size=(1000, 3))
        largest.append(rows.shape[0])
        return rows

    X = da.map_blocks(block, chunks=((1000,) * 20, (3,)), dtype=float, meta=np.empty((0, 0)))
    largest.clear()
    transport = AffineTransport().fit(X, 2 * X)
    np.testing.assert_allclose(transport.coef_, 2 * np.eye(3), atol=1e-12)
    done = len(largest)
    image = transport.transform(X)
    assert len(largest) == done
    assert image.chunks == X.chunks


def test_not_a_number_in_a_block_is_refused():
    X, y = arrays()
    y[200, 1] = np.nan
    lazy = [da.from_array(rows, chunks=(50, 4)) for rows in (X, y)]
    with pytest.raises(ValueError, match="contains NaN or infinity"):
        AffineTransport().fit(*lazy)
    transport = AffineTransport().fit(X, X)
    with pytest.raises(ValueError, match="Input X contains NaN"):
        transport.transform(lazy[1]).compute()


def test_partial_fit_takes_dask():
    X, y = arrays()
    transport = AffineTransport().partial_fit(X=da.from_array(X, chunks=(90, 4))).partial_fit(y=y)
    np.testing.assert_allclose(transport.coef_, AffineTransport().fit(X, y).coef_, rtol=1e-12, atol=1e-14)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_cluster_fits_an_array_larger_than_the_memory_of_any_worker():
    distributed = pytest.importorskip("distributed")
    limit = 320 * 2**20
    settings = {"n_workers": 2, "threads_per_worker": 1, "memory_limit": limit, "dashboard_address": ":0"}
    with distributed.LocalCluster(processes=True, **settings) as cluster, distributed.Client(cluster):
        X = da.random.default_rng(0).normal(size=(850_000, 50), chunks=(25_000, 50))
        assert X.nbytes > limit
        y = X[:400_000] * 3.0 + 1.0
        transport = AffineTransport().fit(X, y)
        assert transport.source_mean_.shape == (50,)
        np.testing.assert_allclose(transport.coef_, 3 * np.eye(50), atol=0.03)
        mean = transport.transform(X[:100_000]).mean(axis=0).compute()
    np.testing.assert_allclose(mean, transport.target_mean_, atol=0.05)


# -- the parts that do it ----------------------------------------------------------------------------------------------


def same_moments(found, rows, weight=None):
    expected = row_moments(rows, weight)
    assert (found.n_rows, found.eps) == (expected.n_rows, expected.eps)
    assert (found.weight, found.squared_weight) == pytest.approx((expected.weight, expected.squared_weight))
    np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-9)


@pytest.mark.parametrize("n_blocks", [1, 2, 3, 5])
@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int64])
def test_moments_of_blocks_are_those_of_their_rows_also_where_some_have_no_weight(n_blocks, dtype):
    rows = (10 * arrays(40)[0]).astype(dtype)
    weight = np.random.default_rng(1).uniform(0.5, 2, size=40)
    weight[:8] = 0.0  # of five blocks the first
    lazy = da.from_array(rows, chunks=(-(-40 // n_blocks), 2))
    sides = [
        (None, None),
        (lazy, None),
        (rows, weight),
        (lazy, weight),
        (lazy, da.from_array(weight, chunks=7)),
        (lazy, 0 * weight),
    ]
    nothing, plain, eager, weighted, other, empty = moments_of(sides)
    assert nothing is empty is None
    same_moments(plain, rows.astype(float) if dtype == np.int64 else rows)
    for found in (eager, weighted, other):
        same_moments(found, rows.astype(float) if dtype == np.int64 else rows, weight)


def test_rows_and_weights_lie_beside_each_other_block_by_block():
    X, _ = arrays(40)
    frame, series = pd.DataFrame(X, columns=list("abcd")), pd.Series(np.linspace(0.5, 2, 40))
    lazy = dd.from_pandas(frame, npartitions=4)
    (found,) = moments_of([(lazy, dd.from_pandas(series, npartitions=4))])
    same_moments(found, X, series.to_numpy())
    with pytest.raises(ValueError, match="there are 4 and 2 blocks"):
        moments_of([(lazy, dd.from_pandas(series, npartitions=2))])
    with pytest.raises(ValueError, match="Give a dask series of the same partitions"):
        moments_of([(lazy, series.to_numpy())])


@pytest.mark.parametrize("kind", ["array", "frame"])
@pytest.mark.parametrize("is_kept", [False, True])
def test_a_map_carries_the_rows_of_each_block_that_are_not_kept(kind, is_kept):
    X, _ = arrays(40)
    affine = AffineMap(np.diag([1.0, 2.0, 3.0, 4.0]), X[0], X[1])
    keep = np.arange(40) % 3 == 0 if is_kept else None
    expected = np.where(keep[:, np.newaxis], X, affine(X)) if is_kept else affine(X)
    if kind == "array":
        lazy = da.from_array(X, chunks=(11, 3))
        given = keep
        for dtype in (np.float32, np.int64):
            image = apply_map(affine, lazy.astype(dtype), keep=given)
            assert image.dtype == image.compute().dtype == (np.float32 if dtype == np.float32 else np.float64)
    else:
        frame = pd.DataFrame(X, columns=list("abcd"), index=np.arange(40) + 7)
        lazy = dd.from_pandas(frame, npartitions=4)
        given = dd.from_pandas(pd.Series(keep, index=frame.index), npartitions=4) if is_kept else None
    told = []
    image = apply_map(affine, lazy, keep=given, check=told.append)
    assert type(image) is type(lazy)
    done = image.compute()
    np.testing.assert_allclose(np.asarray(done), expected, rtol=1e-12)
    if kind == "frame":
        assert (list(done.index), list(done.columns)) == (list(frame.index), list(frame.columns))
    assert told == []


def test_rows_whose_image_is_not_finite_are_told_block_by_block():
    X, _ = arrays(40)
    X[25, 1] = np.nan
    told = []
    affine = AffineMap(np.eye(4), X[0], X[1])
    apply_map(affine, da.from_array(X, chunks=(10, 4)), check=told.append).compute(scheduler="synchronous")
    assert len(told) == 1
    np.testing.assert_array_equal(told[0], X[20:30])


def test_columns_of_two_containers_stand_side_by_side():
    X, y = arrays(40)
    lazy_X, lazy_y = da.from_array(X, chunks=(11, 4)), da.from_array(y, chunks=(7, 2))
    frame = dd.from_pandas(pd.DataFrame(y, columns=list("abcd")), npartitions=3)
    for first, second in ((lazy_X, lazy_y), (lazy_X, y), (X, lazy_y), (lazy_X, frame)):
        np.testing.assert_array_equal(beside(first, second).compute(), np.hstack([X, y]))
    assert beside(lazy_X, lazy_y).chunks[0] == lazy_X.chunks[0]
    np.testing.assert_array_equal(on_host(lazy_X), X)
    assert to_namespace(X, lazy_X) is X


def test_stacked_rows_are_no_pairs():
    rows = da.from_array(arrays(30)[0], chunks=(7, 4))
    domain = da.from_array(np.tile([1, -1], 15), chunks=7)
    with pytest.raises(ValueError, match="stacked dask rows do not show"):
        ProcrustesAffineTransport().fit(rows, sample_domain=domain)
