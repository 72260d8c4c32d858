"""A single-valued piece of ground as a height map, with the holes filled that its surroundings explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gpdf_service.types import BoolArray, FloatArray

UNKNOWN, OBSERVED, INFERRED = 0, 1, 2
GAP_CELLS = 4
"""Empty cells side by side that chance alone explains, at one in ten empty."""
RING_SHARE = 0.95
"""[-] Of the ground around a hole that must lie on one plane; the rest are a chair's feet."""
MAX_HOLE_RADIUS = 1.0
"""[m] A hole is filled if no place in it is further from seen ground: a scanner's blind spot, the shadow of a desk."""


@dataclass(frozen=True, slots=True)
class HeightMap:
    """Ground height on a grid.

    Attributes:
        origin: Lower corner of the grid [m], shape (2,).
        cell_width: [m].
        height: At the cells' centres [m], NaN where unknown, shape (nx, ny).
        state: UNKNOWN, OBSERVED or INFERRED, shape (nx, ny).
    """

    origin: FloatArray
    cell_width: float
    height: NDArray[np.float32]
    state: NDArray[np.uint8]

    def cells(self, xy: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64], BoolArray]:
        """Cell of each place, shape (m, ≥ 2), clipped to the grid, and whether it was inside."""
        index = np.floor((xy[:, :2] - self.origin) / self.cell_width).astype(np.int64)
        inside: BoolArray = np.logical_and.reduce((index >= 0) & (index < self.height.shape), axis=1)
        ix = np.clip(index[:, 0], 0, self.height.shape[0] - 1)
        return ix, np.clip(index[:, 1], 0, self.height.shape[1] - 1), inside

    def contains(self, queries: FloatArray) -> BoolArray:
        """Whether the ground is known under each place, shape (m, 2 or 3)."""
        ix, iy, inside = self.cells(queries)
        known: BoolArray = inside & (self.state[ix, iy] != UNKNOWN)
        return known

    def height_at(self, xy: FloatArray) -> FloatArray:
        """Height of the ground [m], shape (m,), NaN where unknown.

        Bilinear between the four centres around a place where they lie on one slope; across a step, the cell's own.
        """
        xy = np.asarray(xy, dtype=np.float64)
        ix, iy, inside = self.cells(xy)
        own = np.where(inside, self.height[ix, iy], np.nan).astype(np.float64)
        low = (xy - self.origin) / self.cell_width - 0.5
        i = np.clip(np.floor(low).astype(np.int64), 0, np.array(self.height.shape) - 2)
        t = np.clip(low - i, 0.0, 1.0)
        corners = np.stack([self.height[i[:, 0] + a, i[:, 1] + b] for a in (0, 1) for b in (0, 1)]).astype(np.float64)
        u, v = t[:, 0], t[:, 1]
        mixed = np.array([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v])
        level = np.ptp(corners, axis=0) <= self.cell_width * np.sqrt(2.0)  # a NaN compares false
        return np.where(level & ~np.isnan(own), (mixed * np.nan_to_num(corners)).sum(axis=0), own)

    def centres(self, mask: BoolArray) -> FloatArray:
        """Centres of the cells in `mask`, shape (nx, ny), with their height: (k, 3) [m]."""
        index = np.argwhere(mask)
        return np.column_stack([self.origin + (index + 0.5) * self.cell_width, self.height[mask].astype(np.float64)])


def fill_holes(surface: HeightMap, material: BoolArray) -> HeightMap:
    """Infer ground where its surroundings explain it, and mark it.

    A hole is a connected set of unknown cells bounded by known ground and `material` (cells that hold other points),
    shut off from the map's rim, with no place further than `MAX_HOLE_RADIUS` from seen ground, and with all the ground
    around it on one plane within a cell's slope: an edge that drops is not bridged.
    """
    known = surface.state == OBSERVED
    height, state = surface.height.copy(), surface.state.copy()
    cells, nearest = ndimage.distance_transform_edt(~known, return_indices=True)
    distance = cells * surface.cell_width
    _fill_gaps(height, state, ~known, distance, nearest, surface.cell_width)
    known = state != UNKNOWN
    _fill(height, state, ~known & ~material, known, distance, surface.cell_width)
    solid = state != UNKNOWN  # then the ground that carries the furniture itself
    _fill(height, state, ~solid & (distance <= MAX_HOLE_RADIUS) & material, solid, distance, surface.cell_width)
    return HeightMap(surface.origin, surface.cell_width, height, state)


def _fill_gaps(
    height: NDArray[np.float32],
    state: NDArray[np.uint8],
    holes: BoolArray,
    distance: FloatArray,
    nearest: NDArray[np.int32],
    cell_width: float,
) -> None:
    """Fill single cells that the scan's spacing left empty, with the ground beside them: also at a step's edge."""
    label = ndimage.label(holes)[0]
    widest = ndimage.maximum(distance, label, np.arange(1, label.max() + 1))
    size = np.bincount(label.ravel())[1:]
    small = np.isin(label, 1 + np.flatnonzero((np.asarray(widest) <= cell_width) & (size <= GAP_CELLS)))
    height[small] = height[nearest[0][small], nearest[1][small]]
    state[small] = INFERRED


def _fill(
    height: NDArray[np.float32],
    state: NDArray[np.uint8],
    holes: BoolArray,
    known: BoolArray,
    distance: FloatArray,
    cell_width: float,
) -> None:
    label = ndimage.label(holes)[0]
    rim = np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))
    for i, box in enumerate(ndimage.find_objects(label), start=1):
        inner = label[box] == i
        if i in rim or distance[box][inner].max() > MAX_HOLE_RADIUS:
            continue
        grown = tuple(slice(max(s.start - 2, 0), s.stop + 2) for s in box)
        inner = label[grown] == i
        ring = ndimage.binary_dilation(inner, np.ones((3, 3)), iterations=2) & known[grown]
        if ring.sum() < 3:
            continue
        ring_at, ring_height = np.argwhere(ring).astype(float), height[grown][ring].astype(float)
        design = np.column_stack([ring_at, np.ones(len(ring_at))])
        plane = np.linalg.lstsq(design, ring_height, rcond=None)[0]
        if np.quantile(np.abs(design @ plane - ring_height), RING_SHARE) > cell_width:
            continue
        height[grown][inner] = np.column_stack([np.argwhere(inner), np.ones(int(inner.sum()))]) @ plane
        state[grown][inner] = INFERRED


def without_enclosed(surface: HeightMap, low: BoolArray) -> HeightMap:
    """Take back inferred ground that material at ground level shuts off from all seen ground: a cupboard's inside.

    Nobody has seen that it is hollow, so it is not called free.

    Args:
        surface: After `fill_holes`.
        low: Cells with material that the lowest body cannot pass under, shape (nx, ny).
    """
    label = ndimage.label((surface.state != UNKNOWN) & ~low)[0]
    seen = np.unique(label[(surface.state == OBSERVED) & ~low])
    enclosed = (surface.state == INFERRED) & ~low & ~np.isin(label, seen)
    height = np.where(enclosed, np.float32(np.nan), surface.height)
    state = np.where(enclosed, UNKNOWN, surface.state).astype(np.uint8)
    return HeightMap(surface.origin, surface.cell_width, height, state)
