"""How much memory something holds, and how much the C library keeps of what was freed."""

from __future__ import annotations

import ctypes
import dataclasses
from contextlib import suppress

import numpy as np
from scipy.spatial import cKDTree

TIDY_S = 1.0
"""[s] Between looks at what may leave memory."""
_ARENA_MAX = -8
"""What glibc's `mallopt` calls the number of its arenas."""


def share_one_arena() -> None:
    """Let all threads of this process take memory from one place.

    By default glibc gives each thread its own, up to eight a core, and keeps there what was freed: so many threads as
    answer, so many times what a picture takes. Threads that run Python take memory one at a time anyway.
    """
    with suppress(AttributeError, OSError, TypeError):  # another C library
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)


def held_bytes(value: object, seen: set[int] | None = None) -> int:
    """Bytes of all arrays that are reached from `value`; each memory once, also where several arrays look at it."""
    seen = set() if seen is None else seen
    if isinstance(value, np.ndarray):
        while isinstance(value.base, np.ndarray):
            value = value.base
    if id(value) in seen:
        return 0
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        return int(value.nbytes)
    return sum(held_bytes(part, seen) for part in _parts(value))


def _parts(value: object) -> list[object]:
    if isinstance(value, dict):
        return list(value.values())
    if isinstance(value, tuple | list):
        return list(value)
    if isinstance(value, cKDTree):
        return [value.data, value.indices]
    if not type(value).__module__.startswith("gpdf_service"):
        return []
    if hasattr(value, "__dict__"):  # with what it was asked for and keeps
        return list(vars(value).values())
    if dataclasses.is_dataclass(value):
        return [getattr(value, field.name) for field in dataclasses.fields(value)]
    return []
