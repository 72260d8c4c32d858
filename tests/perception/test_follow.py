"""Rays over cells: what one says of a cell is told by the two of them alone, whatever box is asked and by whom else."""

import numpy as np
import pytest

from gpdf_service.perception.follow import FARTHEST, Follow
from gpdf_service.perception.rays import Bundle
from gpdf_service.tiles.surface import INFERRED, UNKNOWN, HeightMap, cropped

SHAPE, WIDTH = (50, 37), 0.05
CORNER = np.array([-0.3, 1.1])
FOLLOW = Follow(CORNER, WIDTH, 0.1, 0.1)


def place(rng):
    """Ground of which a third is asked about, and how high a ray may pass over it."""
    height = rng.uniform(-0.1, 0.1, SHAPE).astype(np.float32)
    asked = rng.random(SHAPE) < 0.3
    state = np.where(asked, INFERRED, UNKNOWN).astype(np.uint8)
    return HeightMap(CORNER, WIDTH, height, state), np.full(SHAPE, 0.05, np.float32), asked


def rays(rng, count=400, on_borders=False):
    low, high = np.append(CORNER - 0.3, -0.3), np.append(CORNER + WIDTH * np.array(SHAPE) + 0.3, 0.3)
    origins, ends = (rng.uniform(low, high, (count, 3)) for _ in range(2))
    if on_borders:  # along them, through their corners, straight down
        origins[:, :2] = CORNER + WIDTH * np.rint((origins[:, :2] - CORNER) / WIDTH)
        ends[:, :2] = CORNER + WIDTH * np.rint((ends[:, :2] - CORNER) / WIDTH)
        ends[::3, 0], ends[1::3, 1], ends[::9, :2] = origins[::3, 0], origins[1::3, 1], origins[::9, :2]
    return Bundle(origins, ends, rng.random(count) < 0.9)


def counted_one_by_one(bundle, ground, room, asked):
    """By the middles of many short pieces of each ray."""
    low, fell = np.zeros(SHAPE, int), np.zeros(SHAPE, int)
    share = (np.arange(40_000) + 0.5) / 40_000
    for a, b in zip(bundle.origins[bundle.there], bundle.ends[bundle.there], strict=True):
        length = np.linalg.norm(b - a)
        at = a + share[share < 1.0 - FOLLOW.before / length, None] * (b - a)
        x, y = np.floor((at[:, :2] - CORNER) / WIDTH).astype(int).T
        inside = (x >= 0) & (x < SHAPE[0]) & (y >= 0) & (y < SHAPE[1])
        x, y, z = x[inside], y[inside], at[inside, 2]
        highest, lowest = np.full(SHAPE, -np.inf), np.full(SHAPE, np.inf)
        np.maximum.at(highest, (x, y), z)
        np.minimum.at(lowest, (x, y), z)
        low += asked & (lowest <= ground.height + room) & (highest >= ground.height)
        fell += (
            asked
            & (lowest < ground.height)
            & (highest >= ground.height)
            & (min(a[2], b[2]) + FOLLOW.deep < ground.height)
        )
    return low, fell


def test_rays_are_counted_where_they_are():
    rng = np.random.default_rng(0)
    ground, room, asked = place(rng)
    bundle = rays(rng, 200)
    made = FOLLOW.over([bundle], ground, room, asked)
    low, fell = counted_one_by_one(bundle, ground, room, asked)
    assert low.sum() > 200
    assert fell.sum() > 10
    # a piece that is shorter than those of the test is in a cell, too
    assert np.abs(made[..., 0] - low).sum() <= 0.01 * low.sum()
    assert np.abs(made[..., 1] - fell).sum() <= 0.02 * fell.sum()
    assert not made[~asked].any()


@pytest.mark.parametrize("on_borders", [False, True])
def test_counts_of_parts_add_up(on_borders):
    rng = np.random.default_rng(1)
    ground, room, asked = place(rng)
    bundle = rays(rng, 2000, on_borders)
    whole = FOLLOW.over([bundle], ground, room, asked)
    assert whole.any(axis=(0, 1)).all()
    half = [Bundle(bundle.origins[k::2], bundle.ends[k::2], bundle.there[k::2]) for k in range(2)]
    np.testing.assert_array_equal(sum(FOLLOW.over([each], ground, room, asked) for each in half), whole)
    np.testing.assert_array_equal(FOLLOW.over(half, ground, room, asked), whole)
    for _ in range(20):  # whatever else is asked, and in whatever box
        some = asked & (rng.random(SHAPE) < rng.random())
        (x, y), (u, v) = rng.integers(0, 20, 2), rng.integers(25, 37, 2)
        box = slice(x, u), slice(y, v)
        np.testing.assert_array_equal(FOLLOW.over([bundle], ground, room, some), np.where(some[..., None], whole, 0))
        part = FOLLOW.over([bundle], cropped(ground, box), room[box], some[box])
        np.testing.assert_array_equal(part, np.where(some[box][..., None], whole[box], 0))


def test_a_ray_from_one_origin_or_from_many_and_one_from_nowhere():
    rng = np.random.default_rng(2)
    ground, room, asked = place(rng)
    ends, there = rays(rng).ends, np.ones(400, dtype=bool)
    one = FOLLOW.over([Bundle(np.array([[0.5, 2.0, 0.3]]), ends, there)], ground, room, asked)
    each = FOLLOW.over([Bundle(np.tile([0.5, 2.0, 0.3], (400, 1)), ends, there)], ground, room, asked)
    nowhere = FOLLOW.over([Bundle(np.full((400, 3), np.nan), ends, there)], ground, room, asked)
    assert one.any()
    np.testing.assert_array_equal(one, each)
    assert not nowhere.any()


def test_a_long_ray_is_followed_as_far_before_its_point_as_its_work_is_bounded():
    shape = (FARTHEST + 200, 3)
    ground = HeightMap(CORNER, WIDTH, np.zeros(shape, np.float32), np.full(shape, INFERRED, np.uint8))
    ends = CORNER + WIDTH * np.array([shape[0] - 0.5, 1.5])
    bundle = Bundle(np.array([[*(ends - (WIDTH * 2000, 0.0)), 0.02]]), np.array([[*ends, 0.02]]), np.array([True]))
    made = FOLLOW.over([bundle], ground, np.full(shape, 0.05, np.float32), np.ones(shape, dtype=bool))[..., 0]
    assert not made[:, [0, 2]].any()
    passed = np.flatnonzero(made[:, 1])
    assert FARTHEST <= len(passed) <= FARTHEST + 1
    assert (np.diff(passed) == 1).all()
