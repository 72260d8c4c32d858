"""The nearest of some cells: as SciPy's transform, of equally near ones the same."""

import numpy as np
from scipy import ndimage

from gpdf_service.tiles.nearest import nearest_of


def test_the_nearest_cell_is_that_of_scipys_transform():
    rng = np.random.default_rng(0)
    for _ in range(300):
        cells = rng.random(rng.integers(1, 40, 2)) < rng.choice([0.003, 0.02, 0.1, 0.5])
        if not cells.any():
            continue
        distance, index = nearest_of(cells)
        true, (row, column) = ndimage.distance_transform_edt(~cells, return_indices=True)
        np.testing.assert_array_equal(distance, true)
        np.testing.assert_array_equal(index, row * cells.shape[1] + column)


def test_where_there_is_none_it_is_infinitely_far():
    distance, index = nearest_of(np.zeros((3, 4), dtype=bool))
    assert np.isinf(distance).all()
    assert (index == -1).all()
