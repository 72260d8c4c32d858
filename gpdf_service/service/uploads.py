"""Clouds that come in parts."""

from __future__ import annotations

import threading

import numpy as np

from gpdf_service.types import BoolArray, FloatArray

MAX_UPLOAD_POINTS = 20_000_000
"""Points that one upload may have: 0.5 GB."""
LEAST_PART = 40
"""[points] That a part counts for: what holds it takes as much room as so many."""
MAX_UPLOADS = 64
"""Unfinished uploads that are kept at once."""
MAX_KEY = 256
"""[characters] Of an upload's key: a scene's name, and four times a UUID."""
Part = tuple[FloatArray, BoolArray | None]


class Uploads:
    """Parts that wait for the others; uploads that nobody finishes make room, the oldest ahead."""

    def __init__(self) -> None:
        self._kept: dict[str, dict[int, Part]] = {}
        self._waiting = 0  # points, as they count
        self._lock = threading.Lock()

    def add(self, key: str, part: int, parts: int, points: FloatArray, labels: BoolArray | None) -> Part | None:
        """Take one part; the whole cloud and the labels of its points when it was the last.

        Raises:
            ValueError: the part does not fit.
        """
        if not 0 <= part < parts or parts > MAX_UPLOAD_POINTS:
            raise ValueError(f"part {part} of {parts} is none. Parts count from 0.")
        if len(key) > MAX_KEY:
            raise ValueError(f"an upload_id of {len(key)} characters is too long. Send a short one.")
        if len(points) == 0:
            raise ValueError(f"part {part} has no points. Send at least one a part.")
        with self._lock:
            if part > 0 and key not in self._kept:
                raise ValueError(
                    f"part {part} belongs to no upload that is under way: part 0 comes first, and "
                    "uploads that stay unfinished make room for others. Send it again."
                )
            kept = self._kept.setdefault(key, {})
            self._waiting += _weight(points) - (_weight(kept[part][0]) if part in kept else 0)
            kept[part] = (points, labels)
            self._make_room(key)
            if len(kept) < parts:
                return None
            self._let_go(key)
        if max(kept) >= parts:
            raise ValueError(f"part {max(kept)} came before, now there are to be {parts} parts. Send it again.")
        return _joined([kept[i] for i in range(parts)])

    def _make_room(self, key: str) -> None:
        while self._waiting > MAX_UPLOAD_POINTS or len(self._kept) > MAX_UPLOADS:
            oldest = next(iter(self._kept))
            self._let_go(oldest)
            if oldest == key:
                words = f"it has more than {MAX_UPLOAD_POINTS} points, or too small parts (each counts {LEAST_PART})"
                raise ValueError(f"{words}. Thin the cloud, send larger parts, or load a file.")

    def _let_go(self, key: str) -> None:
        self._waiting -= sum(_weight(points) for points, _ in self._kept.pop(key).values())


def _weight(points: FloatArray) -> int:
    return max(LEAST_PART, len(points))


def _joined(parts: list[Part]) -> Part:
    given = [ground for _, ground in parts if ground is not None]
    if given and len(given) != len(parts):
        raise ValueError("some parts have labels and some have none. Send them with all parts or none.")
    return np.concatenate([points for points, _ in parts]), np.concatenate(given) if given else None
