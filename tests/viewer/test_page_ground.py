import numpy as np
import pytest
from gpdf_client import Drawing

from gpdf_service.viewer.ground import Ground

WIDTH = 0.1


def ground(*levels):
    """A square of 2 m with these heights, one a level; a height may be a function of x, NaN where there is none."""
    x, y = (np.mgrid[0:20, 0:20].reshape(2, -1) + 0.5) * WIDTH
    rows = []
    for i, height in enumerate(levels):
        z = height(x) if callable(height) else np.full(x.size, height)
        rows.append(np.column_stack([x, y, z, np.full(x.size, float(i))])[np.isfinite(z)])
    table = np.concatenate(rows)
    return Ground.of(Drawing(1, np.zeros(3), table[:, :3], {"level": table[:, 3]}), WIDTH)


def test_a_slanted_ray_meets_a_floor_where_geometry_says():
    origin, direction = np.array([0.2, 0.3, 1.5]), np.array([0.4, 0.3, -1.0])
    hit = ground(0.0).hit(origin, direction)
    np.testing.assert_allclose(hit, origin + 1.5 * direction, atol=0.05)
    assert hit[2] == 0.0


def test_a_ray_meets_the_step_before_the_floor_behind_it():
    stepped = ground(lambda x: np.where(x > 1.0, 0.3, 0.0))
    down = np.array([0.0, 0.0, -1.0])
    assert stepped.hit(np.array([1.5, 1.0, 2.0]), down)[2] == pytest.approx(0.3)
    assert stepped.hit(np.array([0.5, 1.0, 2.0]), down)[2] == pytest.approx(0.0)
    hit = stepped.hit(np.array([0.5, 1.0, 1.0]), np.array([1.0, 0.0, -1.0]))
    assert hit[2] == pytest.approx(0.3)
    assert hit[0] == pytest.approx(1.2, abs=0.06)


def test_of_two_storeys_the_upper_is_met_first_unless_the_lower_is_asked():
    house = ground(0.0, 2.8)
    ray = np.array([1.0, 1.0, 5.0]), np.array([0.0, 0.0, -1.0])
    assert house.hit(*ray)[2] == pytest.approx(2.8)
    assert house.hit(*ray, levels=frozenset({0}))[2] == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("origin", "direction"),
    [((1.0, 1.0, 1.0), (0.0, 0.0, 1.0)), ((1.0, 1.0, 1.0), (1.0, 0.0, 0.0)), ((9.0, 9.0, 1.0), (0.0, 0.0, -1.0))],
)
def test_a_ray_that_leaves_or_misses_meets_nothing(origin, direction):
    assert ground(0.0).hit(np.array(origin), np.array(direction)) is None


def test_a_hole_is_no_ground():
    holed = ground(lambda x: np.where(np.abs(x - 1.0) < 0.3, np.nan, 0.0))
    assert holed.hit(np.array([1.0, 1.0, 1.0]), np.array([0.0, 0.0, -1.0])) is None


def test_the_box_holds_all_that_is_known():
    low, high = ground(0.0, 2.8).box
    np.testing.assert_allclose(low, [0.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(high, [2.0, 2.0, 2.8], atol=1e-9)
