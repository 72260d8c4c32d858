"""Which of the large surfaces of a scan is the floor that one starts from, and which are storeys of their own."""

import numpy as np
import pytest

from gpdf_service import segment_ground
from gpdf_service.bench.houses import THIN
from gpdf_service.synthetic.places import gallery, supermarket
from gpdf_service.synthetic.scanners import NOISE, SCANNERS


def scanned(make, scanner, seed):
    rng = np.random.default_rng(seed)
    return SCANNERS[scanner](make(np.random.default_rng(seed)), rng, NOISE[scanner]).thinned(THIN, rng)


@pytest.mark.parametrize(("scanner", "seed"), [("tripod", 3), ("handheld", 3)])
def test_the_ceiling_of_a_shop_is_no_ground_where_shelves_hide_most_of_its_floor(scanner, seed):
    scan = scanned(supermarket, scanner, seed)
    ground = segment_ground(scan.points)
    ceiling = scan.points[:, 2] > scan.points[:, 2].max() - 0.1
    assert ceiling.sum() > 3 * scan.ground.sum()
    assert not (ground & ceiling).any()
    assert ground[scan.ground].mean() > 0.9


def test_a_gallery_smaller_than_a_third_of_the_floor_is_ground():
    scan = scanned(gallery, "tripod", 1)
    upper = scan.ground & (scan.points[:, 2] > np.median(scan.points[scan.ground, 2]) + 2.0)
    assert 0 < upper.sum() < 0.3 * scan.ground.sum()
    assert segment_ground(scan.points)[upper].mean() > 0.9
