"""What a service counts of itself: health, readiness and numbers, for `keys.status_of`."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Sequence

import numpy as np
import psutil
from gpdf_schemas import Status

WINDOW = 1000
"""Answers that the latencies are taken from."""


class Metrics:
    """Counts answers; safe for many threads."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._process = psutil.Process()
        self._answers = Counter[str]()
        self._seconds: deque[float] = deque(maxlen=WINDOW)
        self._bad = 0
        self._lock = threading.Lock()

    def count(self, status: Status, seconds: float) -> None:
        """One answer, and how long it took from the request's arrival [s]."""
        with self._lock:
            self._answers[status.value] += 1
            self._seconds.append(seconds)

    def count_bad_publication(self) -> None:
        """A publication that could not be read: nobody waits for an answer that could say so."""
        with self._lock:
            self._bad += 1

    def numbers(self, pids: Sequence[int] = ()) -> dict[str, float]:
        """Everything by name; times in seconds.

        `memory_bytes` is of this process and of `pids`: at most, for what they share is counted for each of them.
        """
        with self._lock:
            answers, seconds = dict(self._answers), np.array(self._seconds or [0.0])
        p50, p99 = np.percentile(seconds, [50, 99])
        with self._process.oneshot():
            own = {
                "memory_bytes": float(self._process.memory_info().rss + sum(map(_memory, pids))),
                "threads": float(self._process.num_threads()),
                "open_files": float(self._process.num_fds()),
            }
        times = {"uptime_s": time.monotonic() - self._began, "answer_p50_s": float(p50), "answer_p99_s": float(p99)}
        times["bad_publications"] = float(self._bad)
        return {**own, **times, **{f"answers_{name}": float(count) for name, count in sorted(answers.items())}}


def _memory(pid: int) -> int:
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.NoSuchProcess:  # it has just died; another one begins
        return 0
