"""Rows of an array that stands, and a few more of one that changes: read by number, and nothing is copied."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Layered:
    """Rows of `below`, and from number `start` on those of `above`.

    Args:
        below: Shape (n, …).
        above: The same, shape (k, …).
        start: Number of the first row above, n at least, and if not given; what is between the two is no row.
    """

    __slots__ = ("above", "below", "start")

    def __init__(self, below: NDArray[Any], above: NDArray[Any], start: int | None = None) -> None:
        self.below, self.above, self.start = below, above, len(below) if start is None else start

    def __len__(self) -> int:
        return self.start + len(self.above)

    def __getitem__(self, rows: ArrayLike) -> Any:  # noqa: ANN401 - a row, or an array of them
        rows = np.asarray(rows)
        over = rows >= self.start
        if not over.any():
            return self.below.take(rows, axis=0)  # a third of the time of an index
        if not rows.ndim:
            return self.above[rows - self.start]
        made = self.below.take(np.where(over, 0, rows), axis=0)
        made[over] = self.above[rows[over] - self.start]
        return made
