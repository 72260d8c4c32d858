"""The nearest place where a body fits, against a look at every leaf."""

from __future__ import annotations

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.search.nearest import nearest_free
from tests.clients.two_storeys import make_house


def plain(space, place, off, component):
    """The same by brute force."""
    best, found = np.inf, None
    for own in space.levels:
        tree, first = own.quadtree, own.offset
        leaves = tree.numbers[tree.free[tree.numbers]]
        if component is not None:
            leaves = leaves[space.graph.component[first + leaves] == component]
        half = 0.5 * tree.width * tree.size[leaves][:, None]
        center = tree.origin + tree.corner[leaves] * tree.width + half
        room = np.where(tree.whole[leaves][:, None], half, 0.0)
        nearest = np.clip(place[:2], center - room, center + room)
        z = own.surface.height_at(np.clip(place[:2], center - 0.999 * room, center + 0.999 * room))
        far = np.linalg.norm(nearest - place[:2], axis=1)
        good = np.isfinite(z) & ((np.abs(z - place[2]) <= off) if len(place) == 3 else True)
        if good.any() and far[good].min() < best:
            best, found = far[good].min(), nearest[good][far[good].argmin()]
    return best, found


@pytest.fixture(scope="module", params=[False, True], ids=["standing", "moving"])
def space(request):
    made = make_house(np.random.default_rng(0))
    scene = gpdf.build_scene(made.points, made.ground)
    if request.param:
        low, high = scene.points[:, :2].min(axis=0), scene.points[:, :2].max(axis=0)
        people = np.random.default_rng(2).uniform(low, high, (12, 2))
        scene = scene.with_obstacles(np.column_stack([people, np.full(12, 1.0)]))
    return scene.free_space("human")


def test_the_nearest_place_is_that_of_all_leaves(space):
    rng = np.random.default_rng(4)
    low = np.min([one.origin for one in space.surfaces], axis=0)
    high = np.max([one.origin + one.cell_width * np.array(one.state.shape) for one in space.surfaces], axis=0)
    components = np.unique([space.graph.component[node] for node in range(0, len(space.graph.position), 97)])
    found = 0
    for number in range(120):
        place = rng.uniform([*(low - 1.0), -1.0], [*(high + 1.0), 4.0])[: 3 if number % 3 else 2]
        component = int(rng.choice(components)) if number % 2 else None
        near, (far, _) = nearest_free(space, place, 0.5, component), plain(space, place, 0.5, component)
        assert (near is None) == (not np.isfinite(far))
        if near is not None:
            found += 1
            assert np.linalg.norm(near[:2] - place[:2]) == pytest.approx(far, abs=1e-5)
            assert len(place) == 2 or abs(near[2] - place[2]) <= 0.5
    assert 30 < found < 120
