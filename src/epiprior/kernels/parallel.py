"""Work on independent rows, by as many threads as there are processors."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def in_chunks(work: Callable[[slice], object], count: int, size: int) -> None:
    """Call `work` with slices of `size` rows that make up `count`; what it does for a row must not depend on others.

    The slices are the same for any number of threads.
    """
    parts = [slice(first, min(first + size, count)) for first in range(0, count, size)]
    if len(parts) < 2:
        for part in parts:
            work(part)
        return
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        list(pool.map(work, parts))
