"""What has to be set before the libraries that read it are loaded."""

import multiprocessing
import os

if "forkserver" in multiprocessing.get_all_start_methods():
    # Workers of a dask cluster are forked from a process that has loaded what they need, and do not load it each.
    os.environ.setdefault("DASK_DISTRIBUTED__WORKER__MULTIPROCESSING_METHOD", "forkserver")
