"""How many cores there are; by itself, so that options can be read before anything that computes is loaded."""

from __future__ import annotations

import os


def worker_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
