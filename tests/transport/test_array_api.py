"""Arrays of other libraries stay what and where they are."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import numpy as np
from sklearn import config_context
from skat import AffineTransport, ConditionalAffineTransport, ProcrustesAffineTransport
from sklearn.model_selection import cross_val_score
from skat import CORAL, IdentityTransport
from skat.metrics import affinity_estimate, affinity_score, affinity_scorer, paired_error_scorer
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
    for scoring in (paired_error_scorer, affinity_scorer(), affinity_scorer(affinity_estimate, random_state=0)):
        scores = cross_val_score(AffineTransport(), X, y, cv=3, scoring=scoring, error_score="raise")
        there = cross_val_score(
            AffineTransport(), xp.asarray(X), xp.asarray(y), cv=3, scoring=scoring, error_score="raise"
        )
        np.testing.assert_allclose(there, scores, rtol=1e-10)
    assert abs(affinity_score(xp.asarray(X), xp.asarray(y)) - affinity_score(X, y)) < 1e-12
    parts = AffineTransport().partial_fit(xp.asarray(X)).partial_fit(y=xp.asarray(y))
    np.testing.assert_allclose(host(parts.coef_), AffineTransport().fit(X, y).coef_, rtol=1e-10, atol=1e-12)
"""

# What needs a device of its own: everything stays there, also what is fitted to.
ON_CUDA = """
import numpy as np
import torch
from sklearn import config_context
from sklearn.linear_model import Ridge
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from skat import AffineTransport, ConditionalAffineTransport, ProcrustesAffineTransport, TargetRows
from skat.metrics import affinity_scorer, paired_error_scorer

rng = np.random.default_rng(0)
X = rng.normal(size=(300, 4)) + 5
y = X @ (np.eye(4) + 0.2 * rng.normal(size=(4, 4))) + 0.1 * rng.normal(size=X.shape)
there = torch.asarray(X, device="cuda"), torch.asarray(y, device="cuda")
with config_context(array_api_dispatch=True):
    for transport in (AffineTransport(), ProcrustesAffineTransport(), ConditionalAffineTransport(context=1)):
        expected = transport.fit(X, y).transform(X)
        transport.fit(*there)
        carried = transport.transform(there[0])
        assert carried.device.type == transport.coef_.device.type == "cuda"
        np.testing.assert_allclose(carried.cpu().numpy(), expected, rtol=1e-9)
        single = transport.fit(*(rows.float() for rows in there)).transform(there[0].float())
        assert single.dtype == torch.float32
        np.testing.assert_allclose(single.cpu().numpy(), expected, rtol=1e-4, atol=1e-4)
        for scoring in (paired_error_scorer, affinity_scorer()):
            scores = cross_val_score(transport, *there, cv=3, scoring=scoring, error_score="raise")
            np.testing.assert_allclose(
                scores, cross_val_score(transport, X, y, cv=3, scoring=scoring), rtol=1e-9
            )
    # Domains, labels and groups on the device as well, in front of a predictor.
    rows, labels, domain = np.vstack([X, y]), rng.normal(size=600), np.repeat([1.0, -1.0], 300)
    model = make_pipeline(AffineTransport(unlabelled="target"), Ridge(solver="svd"))

    def scores(array):
        return cross_val_score(
            model,
            array(rows),
            array(labels),
            cv=TargetRows(3, sample_domain=array(domain)),
            params={"affinetransport__sample_domain": array(domain)},
            error_score="raise",
        )

    on_device = scores(lambda values: torch.asarray(values, device="cuda"))
    np.testing.assert_allclose(on_device, scores(np.asarray), rtol=1e-7)
"""

CHECKS = """
from sklearn.utils.estimator_checks import check_array_api_input, check_array_api_same_namespace
from tests.transport.test_estimator_checks import AffineWithTarget, ConditionalWithTarget
from tests.transport.test_estimator_checks import ProcrustesWithTarget

for transport in (AffineWithTarget(), ConditionalWithTarget(context=1), ProcrustesWithTarget()):
    name = type(transport).__name__
    for device, dtype in (("CPU_DEVICE", "float64"), ("device1", "float32")):
        check_array_api_input(name, transport, "array_api_strict", device, dtype, check_values=True)
    check_array_api_same_namespace(name, transport, "array_api_strict")
"""


# One process does both for the first, as most of its time goes into imports.
@pytest.mark.parametrize(
    ("module", "checks"), [("array_api_strict", CHECKS), ("torch", "")], ids=["array_api_strict", "torch"]
)
def test_arrays_of_other_libraries_give_the_map_of_their_values_and_pass_scikit_learns_checks(module, checks):
    pytest.importorskip(module)
    run_with_array_api(SCRIPT.format(module=module) + checks)


def test_tensors_on_cuda_stay_there():
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("there is no CUDA device")
    run_with_array_api(ON_CUDA)


def run_with_array_api(script):
    """Run in another process: SciPy decides on its array API support as it is imported."""
    root = Path(__file__).parents[2]
    environment = {**os.environ, "SCIPY_ARRAY_API": "1", "PYTHONPATH": str(root)}
    subprocess.run([sys.executable, "-W", "error", "-c", script], check=True, env=environment, cwd=root)
