"""Estimators that carry rows of a source domain onto a target domain."""

from skat.transport.affine import AffineTransport
from skat.transport.baselines import CORAL, ExactTransport, IdentityTransport, KernelAlignment
from skat.transport.conditional import ConditionalAffineTransport
from skat.transport.procrustes import ProcrustesAffineTransport
from skat.transport.residual import ResidualTransport

__all__ = [
    "CORAL",
    "AffineTransport",
    "ConditionalAffineTransport",
    "ExactTransport",
    "IdentityTransport",
    "KernelAlignment",
    "ProcrustesAffineTransport",
    "ResidualTransport",
]
