"""The quadtree in a picture is an image."""

import numpy as np
import pytest
from matplotlib.figure import Figure

import gpdf_service as gpdf
from gpdf_service.synthetic import SCENES
from gpdf_service.viewer.picture import FITS, FITS_EDGE, _draw_quadtree


def test_what_is_painted_is_as_large_as_what_is_free():
    made = SCENES["office"](np.random.default_rng(0))
    scene = gpdf.build_scene(made.points, made.ground)
    tree = scene.free_space("human").quadtrees[0]
    axes = Figure().add_subplot()
    _draw_quadtree(axes, scene, gpdf.AGENTS["human"], 0, (FITS, FITS_EDGE), 0.4)
    image = axes.images[0]
    left, right, low, high = image.get_extent()
    painted = np.mean(np.asarray(image.get_array())[..., 3] > 0.0) * (right - left) * (high - low)
    free = np.sum((2.0 * tree.half_size[tree.free]) ** 2)
    assert painted == pytest.approx(free, rel=0.01)
    assert len(axes.collections) == 0
