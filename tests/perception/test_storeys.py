"""Which of the large surfaces of a scan is the floor that one starts from, and which are storeys of their own."""

import numpy as np
import pytest

from gpdf_service import segment_ground
from gpdf_service.bench.places import scanned_place
from gpdf_service.errors import NoGroundError
from gpdf_service.synthetic.places import bedroom, gallery, museum, platform, supermarket, workshop


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
