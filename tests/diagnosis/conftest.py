import importlib
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="session")
def worlds():
    """The worlds of the benchmark: they share no code with the library."""
    return _import("worlds")


@pytest.fixture(scope="session")
def cases():
    """What the benchmark hides in the worlds."""
    return _import("worlds.cases")


def _import(name):
    if str(BENCHMARKS) not in sys.path:
        sys.path.append(str(BENCHMARKS))
    return importlib.import_module(name)
