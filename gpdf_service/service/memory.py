"""How much memory something holds."""

from __future__ import annotations

import dataclasses

import numpy as np


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
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return [getattr(value, field.name) for field in dataclasses.fields(value)]
    if type(value).__module__.startswith("gpdf_service"):
        return list(vars(value).values()) if hasattr(value, "__dict__") else []
    return []
