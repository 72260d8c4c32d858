"""How much of a scene a body reaches, and two places to begin with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpdf_service.search.free_space import FreeSpace
from gpdf_service.types import FloatArray


@dataclass(frozen=True, slots=True)
class Reach:
    """Facts about a free space.

    Attributes:
        free_area: Where the body's centre may be [m²].
        largest_area: Of that, the largest connected piece [m²].
        pieces: Connected pieces.
        start: A place in the largest piece with the most room (x, y, z of the ground) [m]; None if nothing is free.
        goal: A place far from it that is half as roomy at least.
    """

    free_area: float
    largest_area: float
    pieces: int
    start: FloatArray | None
    goal: FloatArray | None


def find_reach(space: FreeSpace) -> Reach:
    """Measure a free space: its wholly free leaves, and the pieces that the graph makes of them."""
    whole = np.concatenate([tree.whole for tree in space.quadtrees])
    if not whole.any():
        return Reach(0.0, 0.0, 0, None, None)
    graph = space.graph
    half_size = np.concatenate([tree.half_size for tree in space.quadtrees])
    clearance = np.concatenate([tree.clearance for tree in space.quadtrees])
    areas = np.bincount(graph.component[whole], weights=4.0 * half_size[whole] ** 2)
    inside = np.flatnonzero(whole & (graph.component == areas.argmax()))
    roomiest = inside[clearance[inside].argmax()]
    roomy = inside[clearance[inside] >= 0.5 * clearance[roomiest]]
    far = roomy[np.linalg.norm(graph.position[roomy] - graph.position[roomiest], axis=1).argmax()]
    start, goal = (_on_ground(space, node) for node in (roomiest, far))
    return Reach(float(areas.sum()), float(areas.max()), int(np.count_nonzero(areas)), start, goal)


def _on_ground(space: FreeSpace, node: int) -> FloatArray:
    xy = space.graph.position[node]
    return np.append(xy, space.surfaces[space.graph.level[node]].height_at(xy[None]))
