"""Carry simulated samples onto measured ones, and find out what the simulation gets wrong."""

from skat.transport import (
    CORAL,
    AffineTransport,
    ConditionalAffineTransport,
    ExactTransport,
    IdentityTransport,
    MultiSourceTransport,
    ProcrustesAffineTransport,
    ResidualTransport,
    TargetRows,
)

__version__ = "0.1.0"

__all__ = [
    "CORAL",
    "AffineTransport",
    "ConditionalAffineTransport",
    "ExactTransport",
    "IdentityTransport",
    "MultiSourceTransport",
    "ProcrustesAffineTransport",
    "ResidualTransport",
    "TargetRows",
    "__version__",
]
