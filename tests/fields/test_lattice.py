"""A field over a height map is the field over its points, and a change of it is a build."""

from __future__ import annotations

import numpy as np
import pytest

from gpdf_service.config import FieldConfig
from gpdf_service.fields import Gpdf, Lattice, change_lattice, fit_gpdf, fit_lattice, lattice_of
from gpdf_service.fields.lattice import TILE, disc, half_disc, solve_lattice
from gpdf_service.types import FloatArray

WIDTH = 0.06


def terrain(rng: np.random.Generator, shape: tuple[int, int], gaps: float = 0.1) -> FloatArray:
    """A slope with a step, roughness and gaps [m]."""
    x, y = np.meshgrid(*(np.arange(size) * WIDTH for size in shape), indexing="ij")
    height = 0.3 * x + np.where(y > 0.5 * y.max(), 0.17, 0.0) + rng.normal(0.0, 0.004, shape) + 40.0
    return np.where(rng.uniform(size=shape) < gaps, np.nan, height)


def lattice(height: FloatArray) -> Lattice:
    return lattice_of(height, np.array([3.0, -2.0]), WIDTH, FieldConfig())


def plain(field: Gpdf) -> Gpdf:
    """The field that is fitted to the same points without knowing of a lattice."""
    return fit_gpdf(field.points, domain=field.domain, spacing=field.spacing)


class Everywhere:
    def contains(self, queries: FloatArray) -> np.ndarray:
        return np.ones(len(queries), dtype=bool)


def places(field: Gpdf, rng: np.random.Generator, count: int = 3000) -> FloatArray:
    rows = rng.integers(len(field.points), size=count)
    return field.points[rows] + rng.normal(0.0, 1.0, (count, 3)) * np.array([0.1, 0.1, 0.3])


@pytest.mark.parametrize("shape", [(150, 140), (TILE, TILE), (7, 90), (5, 3)])
def test_a_lattice_gives_the_field_of_its_points(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    field = fit_lattice(lattice(terrain(rng, shape)), Everywhere())
    queries, other = places(field, rng), plain(field)
    ours, theirs = field.query(queries), other.query(queries)
    np.testing.assert_allclose(ours.distance, theirs.distance, atol=6e-4)
    far = theirs.distance > 0.02
    np.testing.assert_allclose(ours.gradient[far], theirs.gradient[far], atol=0.01)
    np.testing.assert_allclose(ours.deviation, theirs.deviation, atol=6e-4)


def test_a_point_by_itself_is_one_over_its_row() -> None:
    height = np.full((9, 9), np.nan)
    height[4, 4] = 1.0
    solved = solve_lattice(lattice(height))
    assert solved.alpha[4, 4] == pytest.approx(1.0 / (1.0 + FieldConfig().noise_variance), rel=1e-4)
    assert np.isnan(solved.alpha).sum() == 80


def test_what_is_solved_satisfies_the_equation() -> None:
    """(K + σ² I) α = 1 in each row, with K from all pairs of points, across the borders of tiles."""
    own = lattice(terrain(np.random.default_rng(1), (70, 75)))
    solved, known = solve_lattice(own), ~np.isnan(own.height)
    plan = np.argwhere(known) * WIDTH
    points = np.column_stack([plan, own.height[known]])
    square = ((points[:, None] - points[None]) ** 2).sum(axis=2)
    kernel = np.exp(-0.5 * square / own.length_scale**2) * (square <= (4.5 * own.length_scale) ** 2)
    left = kernel @ solved.alpha[known] + own.noise_variance * solved.alpha[known]
    np.testing.assert_allclose(left, 1.0, atol=3e-3)


def test_a_change_gives_what_a_build_gives() -> None:
    rng = np.random.default_rng(2)
    before = terrain(rng, (200, 190))
    field = fit_lattice(lattice(before), Everywhere())
    for _ in range(10):
        after, (x, y) = before.copy(), rng.integers(0, 190, 2)
        after[x : x + 12, y : y + 9] = rng.choice([np.nan, 41.0]) + 0.01 * rng.integers(0, 3)
        cells = ~((after == before) | (np.isnan(after) & np.isnan(before)))
        field, before = change_lattice(field, lattice(after), cells, Everywhere()), after
        built = fit_lattice(lattice(after), Everywhere())
        rows, others = (np.lexsort(each.points.T) for each in (field, built))
        np.testing.assert_array_equal(field.points[rows], built.points[others])
        np.testing.assert_array_equal(field.alpha[rows], built.alpha[others])
        np.testing.assert_array_equal(field.discs[rows], built.discs[others])


def test_a_change_solves_only_tiles_within_reach() -> None:
    rng = np.random.default_rng(3)
    own = lattice(terrain(rng, (3 * TILE, 3 * TILE)))
    solved = solve_lattice(own)
    marked = solved._replace(alpha=np.where(np.isnan(solved.alpha), np.nan, 7.0))
    cells = np.zeros(own.height.shape, dtype=bool)
    cells[1, 1] = True
    again = solve_lattice(own, marked, cells).alpha
    np.testing.assert_array_equal(again[:TILE, :TILE], solved.alpha[:TILE, :TILE])
    assert (again[TILE:][~np.isnan(own.height[TILE:])] == 7.0).all()


def test_each_pair_of_cells_is_met_once() -> None:
    whole, half = disc(5.9), half_disc(5.9)
    both = np.concatenate([half, -half, [[0, 0]]])
    assert sorted(map(tuple, both.tolist())) == sorted(map(tuple, whole.tolist()))


@pytest.mark.parametrize("factor", [0.7, 1.5, 1.7, 3.0])
@pytest.mark.parametrize("noise_variance", [1e-3, 0.01, 0.5])
def test_any_kernel_that_may_be_asked_for_is_solved(factor: float, noise_variance: float) -> None:
    config = FieldConfig(length_scale_factor=factor, noise_variance=noise_variance)
    height = terrain(np.random.default_rng(4), (40, 50))
    solved = solve_lattice(lattice_of(height, np.zeros(2), WIDTH, config))
    assert np.isfinite(solved.alpha[~np.isnan(height)]).all()
