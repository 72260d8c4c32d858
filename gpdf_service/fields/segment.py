"""Distance in plan from the points of a tree to a straight segment: one walk, whatever its length.

A box of points is left out where it is apart from the segment, by more than the limit, along x, along y or across the
segment (separating axes, Gottschalk et al. 1996). A leaf's points are worked on as vectors, as in `traversal.py`.
"""

from __future__ import annotations

from math import isfinite, sqrt

import numpy as np

from gpdf_service.fields.tree import FANOUT, LEAF_SIZE, VECTORS, Scratch, Tree, larger, lesser
from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray


@lean(fastmath=VECTORS)
def segment_distance2(
    tree: Tree, a: FloatArray, b: FloatArray, limit: float, enough: float, scratch: Scratch
) -> tuple[float, float]:
    """Squared distance from the segment ab, places (≥ 2,), to the nearest point, and where on it that is.

    Args:
        tree: The points, in plan.
        a: Where it begins [m].
        b: Where it ends [m].
        limit: Squared distance from which on points do not count [m²].
        enough: The walk ends with the first leaf that is nearer than this [m²].
        scratch: Of the walk.

    Returns:
        The squared distance, `limit` where there is nothing below it [m²], 0 from what is no place; and how far along
        ab that is [-].
    """
    if not (isfinite(a[0]) and isfinite(a[1]) and isfinite(b[0]) and isfinite(b[1])):
        return 0.0, 0.0
    boxes, stack, near, a0, a1, b0, b1 = tree.boxes, scratch.stack, scratch.near, a[0], a[1], b[0], b[1]
    length = sqrt((b0 - a0) * (b0 - a0) + (b1 - a1) * (b1 - a1))
    u0, u1 = ((b0 - a0) / length, (b1 - a1) / length) if length > 0.0 else (1.0, 0.0)
    low0, low1, high0, high1 = min(a0, b0), min(a1, b1), max(a0, b0), max(a1, b1)
    nodes, least, share, far, top = boxes.shape[0], limit, 0.0, sqrt(limit), 1
    stack[0] = 0
    while top > 0 and least >= enough:
        top -= 1
        node = stack[top]
        if node >= nodes:
            found, along = _nearest_in(tree.blocks, node - nodes, (a0, a1), (u0, u1), length)
            if found < least:
                least, share, far = found, along / length if length > 0.0 else 0.0, sqrt(found)
            continue
        for k in range(FANOUT):
            apart0 = larger(boxes[node, 0, k] - high0, low0 - boxes[node, 3, k])
            apart1 = larger(boxes[node, 1, k] - high1, low1 - boxes[node, 4, k])
            near[k] = larger(apart0, apart1)
        for k in range(FANOUT):
            if near[k] <= far and near[k] < np.inf:  # where there is no child it is inf
                half0 = 0.5 * (boxes[node, 3, k] - boxes[node, 0, k])
                half1 = 0.5 * (boxes[node, 4, k] - boxes[node, 1, k])
                c0, c1 = boxes[node, 0, k] + half0 - a0, boxes[node, 1, k] + half1 - a1
                if abs(c0 * u1 - c1 * u0) <= far + half0 * abs(u1) + half1 * abs(u0):
                    stack[top] = FANOUT * node + 1 + k
                    top += 1
    return least, share


@lean(fastmath=VECTORS)
def _nearest_in(
    blocks: FloatArray, leaf: int, a: tuple[float, float], u: tuple[float, float], length: float
) -> tuple[float, float]:
    """Squared distance to a leaf's point that is nearest to the segment [m²], and how far along that is [m].

    The segment begins at `a` and goes along the unit vector `u`.
    """
    least, (a0, a1), (u0, u1) = np.int64(2**63 - 1), a, u
    for j in range(LEAF_SIZE):
        x, y = blocks[leaf, 0, j] - a0, blocks[leaf, 1, j] - a1
        along = lesser(larger(x * u0 + y * u1, 0.0), length)
        e0, e1 = x - along * u0, y - along * u1
        square = np.float64(e0 * e0 + e1 * e1)
        least = min(least, (square.view(np.int64) & -LEAF_SIZE) | j)  # as `traversal.nearest_in` finds the least
    found = int(least & (LEAF_SIZE - 1))
    x, y = blocks[leaf, 0, found] - a0, blocks[leaf, 1, found] - a1
    along = min(max(x * u0 + y * u1, 0.0), length)
    e0, e1 = x - along * u0, y - along * u1
    return e0 * e0 + e1 * e1, along
