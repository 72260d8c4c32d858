"""What lies between two samples of the ground is known only where a foot bridges it, or dense floor explains it."""

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.config import PerceptionConfig
from gpdf_service.ground.footing import rings_of
from gpdf_service.perception.levels import survey_levels
from gpdf_service.tiles.points import points_of
from gpdf_service.tiles.width import MIN_CELL, cell_width_of, widest_cell

CONFIG = PerceptionConfig()


def lattice(spacing, count):
    side = int(np.sqrt(count)) * spacing
    x, y = np.meshgrid(*2 * [np.arange(0.0, side - 0.5 * spacing, spacing)], indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def scattered(spacing, count):
    floor = lattice(spacing, count)
    floor[:, :2] = np.random.default_rng(1).uniform(0.0, floor[-1, 0] + spacing, (len(floor), 2))
    return floor


def dense(keep, step=0.02, side=8.0):
    """A floor without the places where `keep` of x and y is false."""
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.arange(0.01, side, step)], indexing="ij"))
    kept = keep(x, y)
    return np.column_stack([x[kept], y[kept], np.zeros(kept.sum())])


def surface_of(floor):
    return survey_levels(points_of(floor), np.ones(len(floor), dtype=bool), CONFIG)[0].levels[0].surface


@pytest.mark.parametrize("made", [lattice, scattered])
@pytest.mark.parametrize(("spacing", "count"), [(6.7, 500), (2.2, 500), (1.0, 900), (0.6, 900)])
def test_between_samples_that_no_foot_bridges_there_is_no_way(made, spacing, count):
    floor = made(spacing, count)
    scene = gpdf.build_scene(floor, np.ones(len(floor), dtype=bool))
    for agent in ("human", "roomba"):
        near = gpdf.plan(scene, floor[0, :2], floor[1, :2], agent)
        across = gpdf.plan(scene, floor[0, :2], floor[-1, :2], agent)
        assert (near.status, across.status) != (gpdf.Status.OK, gpdf.Status.OK)
        assert across.status is not gpdf.Status.OK
        assert across.certificate is None


@pytest.mark.parametrize(("spacing", "made"), [(0.2, lattice), (0.2, scattered), (0.1, scattered)])
def test_samples_that_a_foot_bridges_carry_a_path_that_tells_their_spacing(spacing, made):
    floor = made(spacing, 3000)
    scene = gpdf.build_scene(floor, np.ones(len(floor), dtype=bool))
    side = floor[:, 0].max()
    result = gpdf.plan(scene, (0.2 * side, 0.5 * side), (0.8 * side, 0.5 * side))
    assert result.status is gpdf.Status.OK
    assert spacing <= result.certificate.ground_spacing <= 6.0 * spacing


def test_cells_do_not_grow_with_the_spacing():
    assert cell_width_of(lattice(67.0, 500), CONFIG) == widest_cell(CONFIG) < np.sqrt(2.0) * CONFIG.widest_gap
    assert cell_width_of(lattice(0.1, 500), CONFIG) == pytest.approx(0.15, abs=0.03)


def test_as_many_of_the_smallest_cells_are_in_a_length_as_are_in_it():
    width = cell_width_of(lattice(0.02, 500), CONFIG)
    assert width == pytest.approx(MIN_CELL)
    assert [rings_of(count * MIN_CELL, width) for count in range(1, 20)] == list(range(1, 20))


def test_a_scanners_blind_spot_in_a_dense_floor_is_explained_and_the_certificate_tells_it():
    floor = dense(lambda x, y: np.hypot(x - 4.0, y - 4.0) > 0.9)
    scene = gpdf.build_scene(floor, np.ones(len(floor), dtype=bool))
    across = gpdf.plan(scene, (1.0, 4.0), (7.0, 4.0)).certificate
    beside = gpdf.plan(scene, (1.0, 1.0), (7.0, 1.0)).certificate
    assert 1.2 < across.ground_spacing < 2.0
    assert beside.ground_spacing == pytest.approx(0.05)


@pytest.mark.parametrize("inner", [0.0, 1.2])
def test_single_samples_in_a_wide_hole_do_not_explain_it(inner):
    """A hole of 5 × 5 m in a dense floor; single points in it, as far apart, are no floor."""

    def keep(x, y):
        outside = (np.abs(x - 4.0) > 2.5) | (np.abs(y - 4.0) > 2.5)
        if not inner:
            return outside
        single = (np.round((x - 0.01) % inner, 6) < 0.01) & (np.round((y - 0.01) % inner, 6) < 0.01)
        return outside | single

    surface = surface_of(dense(keep))
    asked = np.random.default_rng(0).uniform(1.8, 6.2, (500, 2))
    assert surface.contains(asked).mean() < 0.02


def test_lines_of_a_scan_further_apart_than_a_foot_bridges_are_no_floor():
    def keep(x, y):
        outside = (np.abs(x - 4.0) > 3.0) | (np.abs(y - 4.0) > 3.0)
        return outside | (np.round((x - 0.01) % 0.8, 6) < 0.01)

    surface = surface_of(dense(keep))
    between = np.column_stack([np.full(50, 0.01 + 0.8 * 5 + 0.4), np.linspace(2.5, 5.5, 50)])
    assert not surface.contains(between).any()
