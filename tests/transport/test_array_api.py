"""Arrays of other libraries stay what and where they are."""

import os
import subprocess
import sys

import pytest

SCRIPT = """
import numpy as np
from sklearn import config_context
from skat import AffineTransport, ConditionalAffineTransport, ProcrustesAffineTransport
from skat import CORAL, IdentityTransport
import {module} as xp

rng = np.random.default_rng(0)
X = rng.normal(size=(60, 3)) + 5
y = X @ (np.eye(3) + 0.2 * rng.normal(size=(3, 3))) + 0.1 * rng.normal(size=(60, 3))
weight = rng.uniform(0.5, 2, size=60)
domain = np.repeat([1, -1], 60)

def host(array):
    return np.asarray(array)

with config_context(array_api_dispatch=True):
    for transport in (
        AffineTransport(), AffineTransport(metric_scale="target", covariance="shrunk"),
        ProcrustesAffineTransport(), ProcrustesAffineTransport(alignment="raw"),
        ConditionalAffineTransport(context=1), CORAL(), IdentityTransport(),
    ):
        expected = transport.fit(X, y, sample_weight=weight)
        coef, carried, back = expected.coef_, expected.transform(X), expected.inverse_transform(y)
        score = expected.score(X, y)
        there = transport.fit(xp.asarray(X), xp.asarray(y), sample_weight=xp.asarray(weight))
        kind = type(xp.asarray(X))
        for name in ("coef_", "intercept_", "source_mean_", "target_covariance_"):
            assert isinstance(getattr(there, name), kind), name
        np.testing.assert_allclose(host(there.coef_), coef, rtol=1e-10, atol=1e-12)
        image = there.transform(xp.asarray(X))
        assert isinstance(image, kind)
        np.testing.assert_allclose(host(image), carried, rtol=1e-10)
        np.testing.assert_allclose(host(there.inverse_transform(xp.asarray(y))), back, rtol=1e-10)
        assert abs(there.score(xp.asarray(X), xp.asarray(y)) - score) < 1e-10
        single = transport.fit(xp.asarray(X, dtype=xp.float32), xp.asarray(y, dtype=xp.float32))
        assert single.transform(xp.asarray(X, dtype=xp.float32)).dtype == xp.float32
        try:
            transport.fit(xp.asarray(X), xp.asarray(y)).transform(xp.asarray(X * np.nan))
        except ValueError as error:
            assert "NaN" in str(error)
        else:
            raise AssertionError("NaN went through")
    rows = np.vstack([X, y])
    carried = AffineTransport().fit(rows, sample_domain=domain).transform(rows, sample_domain=domain)
    there = AffineTransport().fit(xp.asarray(rows), sample_domain=xp.asarray(domain))
    image = there.transform(xp.asarray(rows), sample_domain=domain)
    np.testing.assert_allclose(host(image), carried, rtol=1e-10)
    parts = AffineTransport().partial_fit(xp.asarray(X)).partial_fit(y=xp.asarray(y))
    np.testing.assert_allclose(host(parts.coef_), AffineTransport().fit(X, y).coef_, rtol=1e-10, atol=1e-12)
"""


@pytest.mark.parametrize("module", ["array_api_strict", "torch"])
def test_arrays_of_other_libraries_give_the_map_of_their_values(module):
    pytest.importorskip(module)
    # SciPy decides on its array API support as it is imported, hence another process.
    subprocess.run(
        [sys.executable, "-W", "error", "-c", SCRIPT.format(module=module)],
        check=True,
        env={**os.environ, "SCIPY_ARRAY_API": "1"},
    )
