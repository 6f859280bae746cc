"""Independent work, by as many threads as there are processors, or as OMP_NUM_THREADS says."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def in_threads(work: Callable[[_Item], _Result], items: Sequence[_Item]) -> list[_Result]:
    """Call `work` with each item and return the results in order; what it does for one must not depend on others."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    threads = min(len(items), int(asked) if asked.isdigit() and int(asked) else os.cpu_count() or 1)
    if threads < 2:
        return [work(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, items))


def in_chunks(work: Callable[[slice], object], count: int, size: int) -> None:
    """Call `work` with slices of `size` rows that make up `count`, as `in_threads`: the same for any number of them."""
    in_threads(work, [slice(first, min(first + size, count)) for first in range(0, count, size)])
