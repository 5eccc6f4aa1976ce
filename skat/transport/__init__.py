"""Estimators that carry rows of a source domain onto a target domain."""

from skat.transport.affine import AffineTransport
from skat.transport.baselines import CORAL, ExactTransport, IdentityTransport, KernelAlignment
from skat.transport.batched import BatchedMaps, fit_batched
from skat.transport.conditional import ConditionalAffineTransport
from skat.transport.procrustes import ProcrustesAffineTransport
from skat.transport.residual import ResidualTransport
from skat.transport.several import MultiSourceTransport
from skat.transport.shift import importance_weights
from skat.transport.splitting import TargetRows

__all__ = [
    "CORAL",
    "AffineTransport",
    "BatchedMaps",
    "ConditionalAffineTransport",
    "ExactTransport",
    "IdentityTransport",
    "KernelAlignment",
    "MultiSourceTransport",
    "ProcrustesAffineTransport",
    "ResidualTransport",
    "TargetRows",
    "fit_batched",
    "importance_weights",
]
