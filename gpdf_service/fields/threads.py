"""Batches split over one shared pool of threads; the kernels release the GIL."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import pairwise
from typing import TypeVar

T = TypeVar("T")
S = TypeVar("S")
MIN_CHUNK = 256
"""Fewer queries than this finish sooner (about 1 ms) than a second thread wakes and returns."""


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=worker_count(), thread_name_prefix="gpdf-kernel")


def worker_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_chunked(kernel: Callable[[int, int], None], count: int) -> None:
    """Call `kernel(begin, end)` over ranges that tile `range(count)`, on all cores when there is enough to do."""
    chunks = min(4 * worker_count(), count // MIN_CHUNK)
    if chunks < 2 or worker_count() == 1:
        kernel(0, count)
        return
    bounds = [count * i // chunks for i in range(chunks + 1)]
    for future in [_pool().submit(kernel, a, b) for a, b in pairwise(bounds)]:
        future.result()


def run_beside(one: Callable[[], T], other: Callable[[], S]) -> tuple[T, S]:
    """What both return; `other` runs in a thread of its own, because both may use the pool."""
    with ThreadPoolExecutor(1, "gpdf-beside") as side:
        future = side.submit(other)
        return one(), future.result()


def run_parallel(work: Callable[[T], None], items: Iterable[T]) -> None:
    """Call `work` for every item, on all cores; the first error is raised."""
    items = list(items)
    if len(items) < 2:
        for item in items:
            work(item)
        return
    for future in [_pool().submit(work, item) for item in items]:
        future.result()
