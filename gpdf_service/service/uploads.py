"""Clouds that come in parts."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_UPLOAD_POINTS = 20_000_000
"""Points that one upload may have: 0.5 GB."""
LEAST_PART = 40
"""[points] That a part counts for: what holds it takes as much room as so many."""
MAX_UPLOADS = 64
"""Unfinished uploads that are kept at once."""
MAX_KEY = 256
"""[characters] Of an upload's key: a scene's name, and four times a UUID."""
Part = dict[str, NDArray[Any]]
"""The `points`, shape (n, 3), and what else is known of each of them, shape (n, …)."""


class Uploads:
    """Parts that wait for the others; uploads that nobody finishes make room, the oldest ahead."""

    def __init__(self) -> None:
        self._kept: dict[str, dict[int, Part]] = {}
        self._waiting = 0  # points, as they count
        self._lock = threading.Lock()

    def add(self, key: str, part: int, parts: int, sent: Part) -> Part | None:
        """Take one part; the whole cloud, and what is known of its points, when it was the last.

        Raises:
            ValueError: the part does not fit.
        """
        if not 0 <= part < parts or parts > MAX_UPLOAD_POINTS:
            raise ValueError(f"part {part} of {parts} is none. Parts count from 0.")
        if len(key) > MAX_KEY:
            raise ValueError(f"an upload_id of {len(key)} characters is too long. Send a short one.")
        if len(sent["points"]) == 0:
            raise ValueError(f"part {part} has no points. Send at least one a part.")
        with self._lock:
            if part > 0 and key not in self._kept:
                raise ValueError(
                    f"part {part} belongs to no upload that is under way: part 0 comes first, and "
                    "uploads that stay unfinished make room for others. Send it again."
                )
            kept = self._kept.setdefault(key, {})
            self._waiting += _weight(sent) - (_weight(kept[part]) if part in kept else 0)
            kept[part] = sent
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
        self._waiting -= sum(_weight(each) for each in self._kept.pop(key).values())


def _weight(part: Part) -> int:
    return max(LEAST_PART, len(part["points"]))


def _joined(parts: list[Part]) -> Part:
    for name in set().union(*parts):
        if not all(name in each for each in parts):
            raise ValueError(f"some parts have {name} and some have none. Send them with all parts or none.")
    return {name: np.concatenate([each[name] for each in parts]) for name in parts[0]}
