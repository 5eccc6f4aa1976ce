"""Every transport passes scikit-learn's own checks, given a target that the checks do not know to give."""

import pytest
from sklearn.utils.estimator_checks import parametrize_with_checks

from skat import (
    CORAL,
    AffineTransport,
    ConditionalAffineTransport,
    ExactTransport,
    IdentityTransport,
    ProcrustesAffineTransport,
)


class WithTarget:
    """Take the source rows for the target where a check gives labels."""

    def fit(self, X, y=None, sample_weight=None):
        return super().fit(X, None if y is None else X, sample_weight=sample_weight)

    def fit_transform(self, X, y=None, sample_weight=None):
        return self.fit(X, y, sample_weight=sample_weight).transform(X)

    def score(self, X, y=None):
        return super().score(X, X)


class PartialWithTarget(WithTarget):
    def partial_fit(self, X, y=None):
        return super().partial_fit(X, X)


class AffineWithTarget(PartialWithTarget, AffineTransport):
    pass


class ProcrustesWithTarget(PartialWithTarget, ProcrustesAffineTransport):
    pass


class ConditionalWithTarget(PartialWithTarget, ConditionalAffineTransport):
    pass


class CORALWithTarget(PartialWithTarget, CORAL):
    pass


class IdentityWithTarget(PartialWithTarget, IdentityTransport):
    pass


class ExactWithTarget(WithTarget, ExactTransport):
    pass


@pytest.mark.filterwarnings("ignore:.*rows cannot show how:UserWarning")
@parametrize_with_checks(
    [
        AffineWithTarget(),
        AffineWithTarget(covariance="shrunk", metric_scale="target"),
        ProcrustesWithTarget(),
        ProcrustesWithTarget(alignment="raw"),
        ConditionalWithTarget(context=1),
        CORALWithTarget(),
        ExactWithTarget(),
        IdentityWithTarget(),
    ]
)
def test_estimator_checks(estimator, check):
    check(estimator)
