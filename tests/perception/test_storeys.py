"""Which of the large surfaces of a scan is the floor that one starts from, and which are storeys of their own."""

import numpy as np
import pytest

from gpdf_service import segment_ground
from gpdf_service.bench.places import scanned_place
from gpdf_service.errors import NoGroundError
from gpdf_service.synthetic.places import bedroom, gallery, museum, platform, storage, supermarket, workshop


def scanned(make, scanner, seed):
    return scanned_place(make, scanner, seed)[1]


@pytest.mark.parametrize(("scanner", "seed"), [("tripod", 3), ("handheld", 3)])
def test_the_ceiling_of_a_shop_is_no_ground_where_shelves_hide_most_of_its_floor(scanner, seed):
    scan = scanned(supermarket, scanner, seed)
    ground = segment_ground(scan.points)
    ceiling = scan.points[:, 2] > scan.points[:, 2].max() - 0.1
    assert ceiling.sum() > 3 * scan.ground.sum()
    assert not (ground & ceiling).any()
    assert ground[scan.ground].mean() > 0.9


@pytest.mark.parametrize(("make", "seed", "share"), [(gallery, 1, 0.95), (museum, 3, 0.95), (platform, 3, 0.8)])
def test_a_gallery_and_a_platform_that_no_stair_in_the_scan_leads_to_are_ground(make, seed, share):
    scan = scanned(make, "tripod", seed)
    ground = segment_ground(scan.points)
    high = scan.ground & (scan.points[:, 2] > scan.points[scan.ground, 2].min() + 0.5)
    assert high.sum() > 10_000
    assert ground[high].mean() > share
    assert ground[scan.ground & ~high].mean() > 0.5  # of a track bed the half beyond the rails
    assert scan.ground[ground].mean() > 0.9


@pytest.mark.parametrize(("scanner", "seed"), [("tripod", 201), ("depth", 201)])
def test_boards_of_racks_that_crates_stand_beside_are_no_ground(scanner, seed):
    scan = scanned(storage, scanner, seed)
    ground = segment_ground(scan.points)
    assert scan.ground[ground].mean() > 0.97
    assert ground[scan.ground].mean() > 0.93


@pytest.mark.parametrize(("make", "seed", "share"), [(bedroom, 8, 0.9), (bedroom, 10, 0.97), (workshop, 1, 0.97)])
def test_beds_and_lids_that_one_could_climb_from_box_to_box_are_no_ground(make, seed, share):
    scan = scanned(make, "handheld", seed)
    assert scan.ground[segment_ground(scan.points)].mean() > share


def test_a_scan_of_a_ceiling_alone_has_no_ground():
    rng = np.random.default_rng(0)
    ceiling = np.column_stack([rng.uniform(0.0, 5.0, (20_000, 2)), np.full(20_000, 2.5)])
    sign = np.column_stack([np.full(4_000, 2.0), rng.uniform(1.0, 4.0, 4_000), rng.uniform(1.0, 2.0, 4_000)])
    wall = np.column_stack([rng.uniform(0.0, 5.0, 8_000), np.zeros(8_000), rng.uniform(1.0, 2.5, 8_000)])
    with pytest.raises(NoGroundError, match="ceiling"):
        segment_ground(np.concatenate([ceiling, sign, wall]))


def deck_with_a_ramp(slab, grade, spacing=0.08, size=8.0, height=3.0):
    """A deck over a floor, open at two sides, and a ramp up to it; of its top three round holes were not seen.

    Returns:
        The points, shape (n, 3), and which of them are seen through a hole, of the ramp, and of the top.
    """
    rng, length = np.random.default_rng(0), height / grade

    def face(low, high, z):
        xy = rng.uniform(low, high, (int(np.prod(np.subtract(high, low)) / spacing**2), 2))
        return np.column_stack([xy, z + grade * np.minimum(xy[:, 0], 0.0)])

    deck, ramp = ((0.0, 0.0), (size, size)), ((-length, 2.0), (0.0, 6.0))
    wall = rng.uniform((0.0, 0.0), (size, height + 2.0), (int(size * (height + 2.0) / spacing**2), 2))
    walls = [np.insert(wall, 1, y, axis=1) for y in (0.0, size)]
    floor = rng.uniform((-length, 0.0), (size, size), (int((length + size) * size / spacing**2), 2))
    parts = [
        np.insert(floor, 2, 0.0, axis=1),
        face(*deck, height),
        face(*deck, height - slab),
        face(*ramp, height),
        *walls,
    ]
    points, kind = np.concatenate(parts), np.repeat(np.arange(6), [len(part) for part in parts])
    holes = [np.hypot(*(points[:, :2] - middle).T) < 0.5 for middle in ((2.0, 2.0), (5.0, 4.0), (3.0, 6.0))]
    hole = np.logical_or.reduce(holes)
    seen = ~(hole & (kind == 1))
    points += rng.normal(0.0, 0.003, points.shape)
    return points[seen], *(mask[seen] for mask in (hole & (kind == 2), kind == 3, kind == 1))


@pytest.mark.parametrize(("slab", "grade"), [(0.25, 0.3), (0.2, 0.15)])
def test_an_underside_is_no_ground_where_a_slope_joins_it_to_the_ramp_of_its_deck(slab, grade):
    points, through, ramp, top = deck_with_a_ramp(slab, grade)
    ground = segment_ground(points)
    assert through.sum() > 300
    assert ground[through].mean() < 0.02
    assert ground[ramp].mean() > 0.85
    assert ground[top].mean() > 0.95
