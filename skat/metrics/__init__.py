"""How far transported rows are from the target: distances, bounds, scorers, and the affinity score.

`skat.metrics.affinity` holds the affinity score and its kin, and says which of them to ask.
"""

from skat.metrics.affinity import (
    AffinityEstimate,
    AffinityTest,
    affinity_estimate,
    affinity_score,
    affinity_test,
    affinity_upper_bound,
    debiased_affinity_score,
)
from skat.metrics.distances import (
    affine_discrepancy_bound,
    affine_error_bound,
    gaussian_wasserstein_distance,
    gelbrich_bound,
    normal_approximation_bound,
)
from skat.metrics.scorers import affinity_scorer, paired_error_scorer
from skat.metrics.wasserstein import wasserstein_distance

__all__ = [
    "AffinityEstimate",
    "AffinityTest",
    "affine_discrepancy_bound",
    "affine_error_bound",
    "affinity_estimate",
    "affinity_score",
    "affinity_scorer",
    "affinity_test",
    "affinity_upper_bound",
    "debiased_affinity_score",
    "gaussian_wasserstein_distance",
    "gelbrich_bound",
    "normal_approximation_bound",
    "paired_error_scorer",
    "wasserstein_distance",
]
