"""Points with nothing beside them: reflections."""

from __future__ import annotations

import numpy as np

from gpdf_service.fields.order import corners_of
from gpdf_service.fields.threads import run_chunked
from gpdf_service.tiles.rows import is_among
from gpdf_service.types import BoolArray, FloatArray


def find_strays(points: FloatArray, width: float) -> BoolArray:
    """Which points (n, 3) have no other in their voxel of `width` [m] or in the 26 around it, shape (n,)."""
    stray, key = np.zeros(len(points), dtype=bool), np.empty(len(points), np.int64)
    if len(points) == 0:
        return stray
    low, high = (np.floor(corner / width) for corner in corners_of(points))
    ny, nz = (int(n) for n in (high - low)[1:] + 2.0)  # a voxel at each end is empty: none is beside a row's last one
    strides = np.array([ny * nz, nz, 1])

    def tell(a: int, b: int) -> None:  # counted from the frame's origin, so that a part of a cloud has the same voxels
        key[a:b] = (np.floor(points[a:b] / width) - low).astype(np.int64) @ strides

    run_chunked(tell, len(points))
    held, count = np.unique(key, return_counts=True)
    alone = held[count == 1]
    for beside in (np.indices((3, 3, 3)).reshape(3, -1).T - 1) @ strides:
        if beside != 0:
            alone = alone[~is_among(alone + beside, held)]

    def mark(a: int, b: int) -> None:
        stray[a:b] = is_among(key[a:b], alone)

    run_chunked(mark, len(points))
    return stray
