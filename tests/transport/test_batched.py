"""Many small maps at once are the maps one by one."""

import numpy as np
import pytest

from skat import AffineTransport
from skat.transport import fit_batched


def problems(n_maps=30, n_features=4):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(n_maps, 50, n_features)) @ rng.normal(size=(n_maps, n_features, n_features))
    return X, rng.normal(size=(n_maps, 40, n_features)) @ rng.normal(
        size=(n_maps, n_features, n_features)
    ) + 3


def test_each_map_is_that_of_the_estimator():
    X, y = problems()
    # Two problems that products of centred rows would lose the digits of.
    X[3, :, 1] = X[3, :, 0] + 1e-7 * X[3, :, 1]
    y[5] *= [1e-9, 1.0, 1e9, 1.0]
    maps = fit_batched(X, y)
    carried = maps(X)
    for k, (source, target) in enumerate(zip(X, y)):
        expected = AffineTransport().fit(source, target)
        scale = np.abs(expected.coef_).max()
        np.testing.assert_allclose(maps.coef[k], expected.coef_, rtol=1e-6, atol=1e-9 * scale)
        np.testing.assert_allclose(carried[k].mean(axis=0), target.mean(axis=0), rtol=1e-9)


def test_what_cannot_be_solved_is_told_so():
    X, y = problems(3)
    for call, message in [
        (lambda: fit_batched(X[0], y), r"\(n_maps, n_rows, n_features\)"),
        (lambda: fit_batched(X, y[:2]), "as many problems"),
        (lambda: fit_batched(X, y * np.nan), "Input y contains NaN"),
        (lambda: fit_batched(X[:, :1], y), "two rows a side"),
        (lambda: fit_batched(X, y)(X[:2]), "for 3 maps of 4 columns"),
    ]:
        with pytest.raises(ValueError, match=message):
            call()
    X[1, :, 0] = 0
    with pytest.raises(np.linalg.LinAlgError, match="rank"):
        fit_batched(X, y)


def test_a_column_that_is_constant_but_for_rounding_does_not_vary():
    X, y = problems(3)
    X[1, :, 0] = 0.1
    with pytest.raises(np.linalg.LinAlgError, match="rank"):
        fit_batched(X, y)
    y[1, :, 0] = 0.7
    np.testing.assert_allclose(fit_batched(X, y).coef[1], AffineTransport().fit(X[1], y[1]).coef_, rtol=1e-9)
