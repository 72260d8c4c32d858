import numpy as np
import pytest
from scipy import ndimage

from gpdf_service.perception.obstacles import highest_within


@pytest.mark.parametrize("radius", [0.0, 1.0, 4.4, 7.0, 40.0])
@pytest.mark.parametrize("shape", [(1, 1), (3, 90), (60, 25)])
def test_the_highest_in_a_disc_is_that_of_a_filter_over_its_area(radius, shape):
    rng = np.random.default_rng(0)
    known = rng.random(shape) < 0.8
    heights = np.where(known, rng.normal(size=shape).astype(np.float32), -np.inf)
    reach = int(np.ceil(radius))
    x, y = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = np.hypot(x, y) <= radius
    found = highest_within(heights, disc)
    assert found.dtype == heights.dtype
    # scipy's default mode reflects wrongly at a map that is much narrower than the disc
    expected = ndimage.maximum_filter(heights, footprint=disc, mode="constant", cval=-np.inf)
    np.testing.assert_array_equal(found, expected)
