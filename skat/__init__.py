"""Carry simulated samples onto measured ones, and find out what the simulation gets wrong."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skat.baselines import CORAL, ExactTransport, IdentityTransport
    from skat.transport import AffineTransport, ConditionalAffineTransport, ProcrustesAffineTransport

__version__ = "0.1.0"

__all__ = [
    "CORAL",
    "AffineTransport",
    "ConditionalAffineTransport",
    "ExactTransport",
    "IdentityTransport",
    "ProcrustesAffineTransport",
    "__version__",
]

# Scikit-learn takes a second to load, which `skat --help` does not wait for.
_HOMES = {
    "CORAL": "skat.baselines",
    "AffineTransport": "skat.transport",
    "ConditionalAffineTransport": "skat.transport",
    "ExactTransport": "skat.baselines",
    "IdentityTransport": "skat.baselines",
    "ProcrustesAffineTransport": "skat.transport",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(_HOMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
