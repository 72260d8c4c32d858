"""What raw scans hold besides surfaces is as much as was said, and nothing else is touched."""

import numpy as np
import pytest

from gpdf_service.synthetic.faults import FAULTS, PULSE
from gpdf_service.synthetic.houses import house
from gpdf_service.synthetic.scanners import handheld


@pytest.fixture(scope="module")
def scanned():
    rng = np.random.default_rng(3)
    place = house(rng, "straight")
    return place, handheld(place, rng, noise=0.0)


def made(scanned, fault):
    place, scan = scanned
    return place, scan, FAULTS[fault](place, scan, np.random.default_rng(0))


def test_drift_grows_between_the_ends_of_a_walk_and_is_closed_there(scanned):
    _, scan, off = made(scanned, "drift")
    moved = np.linalg.norm(off.points - scan.points, axis=1)
    last = (scan.origins == scan.origins[-1]).all(axis=1)
    assert moved[last].max() < 1e-9
    assert 0.01 < np.median(moved) < 0.2
    assert (off.ground == scan.ground).all()


def test_a_return_from_between_lies_on_its_ray_less_than_a_pulse_away(scanned):
    _, scan, off = made(scanned, "between")
    moved = (off.points != scan.points).any(axis=1) & (np.abs(off.points - scan.points).max(axis=1) > 1e-6)
    assert 1e-4 < moved.mean() < 1e-2
    along, was = (points[moved] - scan.origins[moved] for points in (off.points, scan.points))
    assert np.allclose(np.cross(along, was), 0.0, atol=1e-6)
    assert np.linalg.norm(along - was, axis=1).max() < PULSE
    assert not off.ground[moved].any()
    assert (off.ground == scan.ground)[~moved].all()


def test_what_a_floor_mirrors_is_under_it_as_deep_as_it_is_over_it(scanned):
    place, scan, off = made(scanned, "mirrors")
    moved = np.linalg.norm(off.points - scan.points, axis=1) > 1e-6
    assert 0.01 < moved[scan.ground].mean() < 0.06
    assert not moved[~scan.ground].any()
    assert (off.points[moved, 2] < scan.points[moved, 2]).all()
    over = off.points[moved].copy()
    over[:, 2] = 2.0 * scan.points[moved, 2] - over[:, 2]
    toward = over - scan.points[moved]
    length = np.linalg.norm(toward, axis=1)
    hits = place.world.cast(scan.points[moved] + 0.01 * toward / length[:, None], toward / length[:, None])
    assert np.median(np.abs(hits.distance + 0.01 - length)) < 1e-6
