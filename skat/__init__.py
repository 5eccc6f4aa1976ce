"""Carry simulated samples onto measured ones, and find out what the simulation gets wrong."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
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

    __version__: str

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


def __getattr__(name: str) -> object:
    # Scikit-learn takes a second to load, which `skat --help` does not wait for.
    if name == "__version__":
        found: object = _version()
    elif name in __all__:
        found = getattr(import_module("skat.transport"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("skat")
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "0+unknown"
