"""Blocks of rows shared among threads."""

import threading
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any

from threadpoolctl import ThreadpoolController

# Fewer blocks are not worth threads of their own.
FEWEST_BLOCKS_TO_SHARE = 16


def shared(work: Any, blocks: Any) -> Any:
    """Return what work returns for each of some parts of the blocks, in order: a part for each thread of BLAS.

    Each thread calls BLAS with one thread. Many small products, each on all threads, would wait at the end of each
    for the slowest thread; on a machine that others use that costs more than the products.

    Parameters
    ----------
    work : callable
        ``work(part)``; it releases the interpreter's lock in its products.
    blocks : sequence

    Returns
    -------
    list
    """
    # The limit on BLAS is one for the process: two threads that set and restore it could leave it set.
    if len(blocks) < FEWEST_BLOCKS_TO_SHARE or threading.current_thread() is not threading.main_thread():
        return [work(blocks)]
    blas = _controller().select(user_api="blas")
    n_threads = max((pool["num_threads"] for pool in blas.info()), default=1)
    if n_threads == 1:
        return [work(blocks)]
    ends = [len(blocks) * part // n_threads for part in range(n_threads + 1)]
    parts = [blocks[start:end] for start, end in pairwise(ends)]
    with blas.limit(limits=1), ThreadPoolExecutor(n_threads) as executor:
        return list(executor.map(work, parts))


@cache
def _controller() -> Any:
    return ThreadpoolController()
