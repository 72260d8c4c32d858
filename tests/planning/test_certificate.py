"""Each thing that a certificate refuses, alone: nothing else in the way would refuse it, too."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

import gpdf_service as gpdf
from gpdf_service.fields.tree import build_tree
from gpdf_service.perception.surface import INFERRED, OBSERVED, UNKNOWN, Cells
from gpdf_service.planning.certificate import _coarsest_spacing, certify
from gpdf_service.planning.shape import stand_up
from gpdf_service.search.places import Places
from gpdf_service.synthetic import Box, World
from gpdf_service.types import AGENTS

FAR = np.array([[100.0, 100.0]])
"""[m] The only obstacle there is, so that room is nowhere the reason."""


def ramp(xy):
    return np.clip(xy[:, 0] - 2.0, 0.0, 2.0) * np.tan(np.radians(20.0))


def scene_of(points, ground):
    return gpdf.build_scene(points, ground)


@pytest.fixture(scope="module")
def scenes():
    rng = np.random.default_rng(0)
    step = World((6.0, 3.0, 2.6), (Box((3.0, 0.0, 0.0), (6.0, 3.0, 0.3), walkable=True),))
    pit = World((6.0, 3.0, 2.6), ())
    made = {name: world.sample(0.05, rng) for name, world in (("step", step), ("pit", pit))}
    made["slope"] = World((6.0, 3.0, 2.6), (), ramp).sample(0.05, rng)
    points, ground = made["pit"]
    seen = ~((points[:, 0] > 2.5) & (points[:, 0] < 5.0) & (points[:, 2] < 0.1))
    made["pit"] = points[seen], ground[seen]
    return {name: scene_of(*cloud) for name, cloud in made.items()}


def certificate_of(scene, agent, begin=1.0, end=4.5):
    """Of the straight way along x, whatever stands there."""
    space = scene.free_space(agent)
    space = dataclasses.replace(space, trees=tuple(Places(build_tree(FAR)) for _ in space.trees))
    xy = np.column_stack([np.arange(begin, end, 0.05), np.full(len(np.arange(begin, end, 0.05)), 1.5)])
    ground, top = stand_up(xy, space.surfaces[0], space.ground_fields[0], space.agent.height)
    contact = np.column_stack([xy, np.nan_to_num(ground[:, 2])])
    return certify(space, np.where(np.isfinite(top), top, contact), contact, np.zeros(len(xy), dtype=np.int64))


@pytest.mark.parametrize(
    ("name", "agent", "reason"),
    [
        ("pit", "human", "leaves the known ground"),
        ("step", "roomba", "a step of 0.30 m is higher than the roomba takes"),
        ("slope", dataclasses.replace(AGENTS["human"], max_slope=0.2), "is steeper than the human stands on"),
    ],
)
def test_ground_is_refused_by_itself(scenes, name, agent, reason):
    found = certificate_of(scenes[name], agent)
    assert found.min_clearance > 10.0
    assert not found.holds
    assert reason in found.reason


@pytest.mark.parametrize(("name", "agent"), [("step", "human"), ("slope", "human"), ("slope", "spot")])
def test_ground_that_the_body_takes_is_not_refused(scenes, name, agent):
    found = certificate_of(scenes[name], agent)
    assert (found.holds, found.reason) == (True, "")


def test_the_limits_are_the_bodys_own(scenes):
    """The same step and slope, a little over and a little under what the body takes."""
    for scene, measure in ((scenes["step"], "max_step"), (scenes["slope"], "max_slope")):
        value = getattr(certificate_of(scene, "human"), measure)
        for change, holds in ((1.01, True), (0.99, False)):
            body = dataclasses.replace(AGENTS["human"], name="own", **{measure: change * value})
            assert certificate_of(scene, body).holds == holds


def test_every_disc_stands_on_known_ground(scenes):
    """The centre stops before the hole; the front of a long body hangs over it."""
    long = dataclasses.replace(AGENTS["spot"], discs=6)
    ends = 2.5 - 0.25
    assert certificate_of(scenes["pit"], dataclasses.replace(long, discs=1), end=ends).holds
    found = certificate_of(scenes["pit"], long, end=ends)
    assert (found.holds, found.reason) == (False, "the path leaves the known ground")
    assert certificate_of(scenes["pit"], long, end=2.5 - 0.7).holds


@pytest.mark.parametrize("seed", range(6))
def test_the_coarsest_spacing_is_that_of_the_inferred_cell_near_the_path_that_is_farthest_from_a_seen_one(seed):
    rng, width, radius, origin = np.random.default_rng(seed), 0.1, 0.1 * seed, np.array([1.0, -2.0])
    kinds = np.array([INFERRED, OBSERVED, UNKNOWN], np.uint8)
    state = rng.choice(kinds, (24, 31), p=[0.85, 0.05, 0.1])
    path = np.column_stack([origin + width * rng.uniform(1.0, 23.0, (3, 2)), np.zeros(3)])
    if seed == 0:  # along the map's edge, and nothing near the path was seen
        state[:], state[0, 0], path[:, 0] = INFERRED, OBSERVED, origin[0] + 0.5 * width
    x, y = np.indices(state.shape)
    near = np.zeros(state.shape, dtype=bool)
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(2.0 * np.hypot(*(b - a)[:2]) / width)))
        for share in np.linspace(0.0, 1.0, count + 1):
            u, v = np.floor((a + share * (b - a) - [*origin, 0.0])[:2] / width)
            near |= (x - u) ** 2 + (y - v) ** 2 <= int(radius / width) ** 2
    farthest = distance_transform_edt(state != OBSERVED)[near & (state == INFERRED)].max(initial=0.0)
    ground = Cells(np.zeros(state.shape, np.float32), state, origin, width)
    assert _coarsest_spacing(path, radius, ground) == pytest.approx((1.0 + 2.0 * farthest) * width)
