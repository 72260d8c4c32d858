"""Batches split over one shared pool of threads; the kernels release the GIL."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TypeVar

from gpdf_service.cores import worker_count

T = TypeVar("T")
S = TypeVar("S")
MIN_CHUNK = 256
"""Fewer queries than this finish sooner (about 1 ms) than a second thread wakes and returns."""


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=worker_count(), thread_name_prefix="gpdf-kernel")


def end_threads() -> None:
    """End the pool's threads, which do not live on in a fork; whoever needs them begins others."""
    _pool().shutdown()
    _pool.cache_clear()


def run_chunked(kernel: Callable[[int, int], None], count: int) -> None:
    """Call `kernel(begin, end)` over ranges that tile `range(count)`, on all cores when there is enough to do."""
    if count < 2 * MIN_CHUNK:
        kernel(0, count)
        return
    chunks = min(4 * worker_count(), count // MIN_CHUNK)
    run_parallel(lambda i: kernel(count * i // chunks, count * (i + 1) // chunks), range(chunks))


def run_beside(one: Callable[[], T], other: Callable[[], S]) -> tuple[T, S]:
    """What both return; `other` runs in the pool, or after the first one where that is busy."""
    future = _pool().submit(other)
    first = one()
    return first, other() if future.cancel() else future.result()


def run_parallel(work: Callable[[T], S], items: Iterable[T]) -> list[S]:
    """What `work` returns for every item, made on all cores; an error is raised.

    The caller works, too, and does not wait for a helper that has not begun: so work may itself be split in the pool.
    """
    items = list(items)
    if len(items) < 2:
        return [work(item) for item in items]
    made: dict[int, S] = {}
    left = iter(range(len(items)))  # its next() is atomic

    def drain() -> None:
        for i in left:
            made[i] = work(items[i])

    helpers = [_pool().submit(drain) for _ in range(min(worker_count(), len(items)) - 1)]
    try:
        drain()
    finally:
        for helper in helpers:
            if not helper.cancel():
                helper.result()
    return [made[i] for i in range(len(items))]
