"""Normal approximations: moments of rows, wherever they live, and the maps and distances between them."""

from skat.gaussian.barycentre import barycentre_root
from skat.gaussian.maps import (
    AffineMap,
    accurate_svd,
    check_that_source_reaches_target,
    coefficient_distance,
    coral_map,
    covariance_root,
    distance_of_roots,
    gaussian_wasserstein_distance,
    optimal_map,
    root_of_factor,
    root_of_moments,
    spectrum,
    transport_map,
)
from skat.gaussian.moments import Moments, row_moments

__all__ = [
    "AffineMap",
    "Moments",
    "accurate_svd",
    "barycentre_root",
    "check_that_source_reaches_target",
    "coefficient_distance",
    "coral_map",
    "covariance_root",
    "distance_of_roots",
    "gaussian_wasserstein_distance",
    "optimal_map",
    "root_of_factor",
    "root_of_moments",
    "row_moments",
    "spectrum",
    "transport_map",
]
