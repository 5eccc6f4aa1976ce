import functools
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


@pytest.fixture(scope="session")
def servo_log():
    """Return a log of a robot with what servos and people do to it: ``servo_log(robot, truth, **settings)``."""
    robots, servos = _import("worlds.robots"), _import("worlds.servos")
    return functools.partial(robots.make_log, build=servos.ServoWorld)


def _import(name):
    if str(BENCHMARKS) not in sys.path:
        sys.path.append(str(BENCHMARKS))
    return importlib.import_module(name)
