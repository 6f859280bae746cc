"""Work on independent rows, by as many threads as there are processors, or as OMP_NUM_THREADS says."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def in_chunks(work: Callable[[slice], object], count: int, size: int) -> None:
    """Call `work` with slices of `size` rows that make up `count`; what it does for a row must not depend on others.

    The slices are the same for any number of threads.
    """
    parts = [slice(first, min(first + size, count)) for first in range(0, count, size)]
    asked = os.environ.get("OMP_NUM_THREADS", "")
    threads = int(asked) if asked.isdigit() and int(asked) else os.cpu_count() or 1
    if min(len(parts), threads) < 2:
        for part in parts:
            work(part)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, parts))
