"""Carry simulated samples onto measured ones, and find out what the simulation gets wrong."""

from importlib.metadata import PackageNotFoundError, version

from skat.baselines import CORAL, ExactTransport, IdentityTransport
from skat.transport import AffineTransport, ConditionalAffineTransport, ProcrustesAffineTransport

try:
    __version__ = version("skat")
except PackageNotFoundError:  # run from a checkout that is not installed
    __version__ = "0+unknown"

__all__ = [
    "CORAL",
    "AffineTransport",
    "ConditionalAffineTransport",
    "ExactTransport",
    "IdentityTransport",
    "ProcrustesAffineTransport",
    "__version__",
]
