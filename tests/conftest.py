"""What has to be set before the libraries that read it are loaded, and who rewrites the asserts of which tests."""

import contextlib
import gc
import importlib
import multiprocessing
import os
from pathlib import Path

import pytest

if "forkserver" in multiprocessing.get_all_start_methods():
    # Workers of a dask cluster are forked from a process that has loaded what they need, and do not load it each.
    os.environ.setdefault("DASK_DISTRIBUTED__WORKER__MULTIPROCESSING_METHOD", "forkserver")

# Next to nothing of what is made while tests are collected is garbage.
gc.disable()


def pytest_collection_finish():
    gc.freeze()
    gc.enable()


def pytest_collection():
    """Load the tests from their end on in every second worker: each of two finds half of them compiled by the other."""
    if int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % 2:
        tests = Path(__file__).parent
        for path in sorted(tests.rglob("test_*.py"), reverse=True):
            # What cannot be loaded is told when it is collected.
            with contextlib.suppress(Exception, pytest.skip.Exception):
                importlib.import_module(".".join(path.relative_to(tests.parent).with_suffix("").parts))
