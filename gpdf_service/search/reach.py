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
    nodes, rows = [], []
    for own in space.levels:
        tree = own.quadtree
        leaves = tree.numbers[tree.whole[tree.numbers]]
        nodes.append(leaves + own.offset)
        rows.append(np.column_stack([tree.width * tree.size[leaves], tree.clearance[leaves]]))
    node, (width, clearance) = np.concatenate(nodes), np.concatenate(rows).T
    if not len(node):
        return Reach(0.0, 0.0, 0, None, None)
    component = np.unique(space.graph.component[node], return_inverse=True)[1]
    areas = np.bincount(component, weights=width**2)
    inside = np.flatnonzero(component == areas.argmax())
    roomiest = inside[clearance[inside].argmax()]
    roomy = inside[clearance[inside] >= 0.5 * clearance[roomiest]]
    place = space.graph.position[node]
    far = roomy[np.linalg.norm(place[roomy] - place[roomiest], axis=1).argmax()]
    start, goal = (_on_ground(space, one) for one in node[[roomiest, far]])
    return Reach(float(areas.sum()), float(areas.max()), len(areas), start, goal)


def _on_ground(space: FreeSpace, node: int) -> FloatArray:
    xy = space.graph.position[node]
    return np.append(xy, space.levels[space.graph.level[node]].surface.height_at(xy[None]))
