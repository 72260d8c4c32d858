"""A field over a height map is the field over its points, and a change of it is a build."""

from __future__ import annotations

import numpy as np
import pytest

from gpdf_service.config import FieldConfig
from gpdf_service.fields import Gpdf, fit_gpdf
from gpdf_service.fields.lattice import TILE, Lattice, disc, fit_lattice, half_disc, lattice_of
from gpdf_service.types import FloatArray

WIDTH = 0.06


def terrain(rng: np.random.Generator, shape: tuple[int, int], gaps: float = 0.1) -> FloatArray:
    """A slope with a step, roughness and gaps [m]."""
    x, y = np.meshgrid(*(np.arange(size) * WIDTH for size in shape), indexing="ij")
    height = 0.3 * x + np.where(y > 0.5 * y.max(), 0.17, 0.0) + rng.normal(0.0, 0.004, shape) + 40.0
    return np.where(rng.uniform(size=shape) < gaps, np.nan, height)


def lattice(height: FloatArray) -> Lattice:
    return lattice_of(height, (np.array([2.0, -3.0]) * TILE - 0.5) * WIDTH, WIDTH, FieldConfig())


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
    field = fit_lattice(lattice(height), Everywhere())
    assert field.alpha == pytest.approx([1.0 / (1.0 + FieldConfig().noise_variance)], rel=1e-4)


def test_what_is_solved_satisfies_the_equation() -> None:
    """(K + σ² I) α = 1 in each row, with K from all pairs of points, across the borders of tiles."""
    own = lattice(terrain(np.random.default_rng(1), (70, 75)))
    field = fit_lattice(own, Everywhere())
    assert len(field.points) == np.count_nonzero(~np.isnan(own.height))
    square = ((field.points[:, None] - field.points[None]) ** 2).sum(axis=2)
    kernel = np.exp(-0.5 * square / own.length_scale**2) * (square <= (4.5 * own.length_scale) ** 2)
    np.testing.assert_allclose(kernel @ field.alpha + own.noise_variance * field.alpha, 1.0, atol=3e-3)


def test_a_change_gives_what_a_build_gives() -> None:
    rng = np.random.default_rng(2)
    before = terrain(rng, (200, 190))
    field = fit_lattice(lattice(before), Everywhere())
    for _ in range(10):
        after, (x, y) = before.copy(), rng.integers(0, 190, 2)
        after[x : x + 12, y : y + 9] = rng.choice([np.nan, 41.0]) + 0.01 * rng.integers(0, 3)
        field, before = fit_lattice(lattice(after), Everywhere(), (field, lattice(before))), after
        built = fit_lattice(lattice(after), Everywhere())
        for one, another in zip(*field.arrays, *built.arrays, strict=True):
            np.testing.assert_array_equal(one, another)


def test_a_change_solves_only_tiles_within_reach() -> None:
    rng = np.random.default_rng(3)
    before = terrain(rng, (3 * TILE, 3 * TILE), gaps=0.0)
    field = fit_lattice(lattice(before), Everywhere())
    field.alpha[:] = 7.0
    after = before.copy()
    after[1, 1] += 0.01
    again = fit_lattice(lattice(after), Everywhere(), (field, lattice(before)))
    near = np.floor((again.points[:, :2] - lattice(before).origin) / (TILE * WIDTH)).astype(int).max(axis=1) == 0
    built = fit_lattice(lattice(after), Everywhere())
    np.testing.assert_array_equal(again.alpha[near], built.alpha[near])
    assert (again.alpha[~near] == 7.0).all()


def test_a_box_of_a_grid_that_moves_takes_over_what_is_out_of_reach_of_its_new_sides() -> None:
    """Corners of cells are the same in each box where the width is a short number, and so are tiles."""
    rng, width = np.random.default_rng(4), 0.0625
    whole = terrain(rng, (5 * TILE, 5 * TILE), gaps=0.02)

    def part(x: int, y: int, nx: int, ny: int) -> Lattice:
        origin = (np.array([x, y]) - 0.5) * width
        return lattice_of(whole[x : x + nx, y : y + ny], origin, width, FieldConfig())

    before = part(32, 64, 250, 200)
    field = fit_lattice(before, Everywhere())
    for box in ((64, 32, 200, 256), (0, 64, 310, 170), (32, 64, 250, 200)):
        after = part(*box)
        marked = Gpdf(field.tree, np.full_like(field.alpha, 7.0), field.discs, field.noise, field.kernel, field.domain)
        assert 0.05 < (fit_lattice(after, Everywhere(), (marked, before)).alpha == 7.0).mean() < 0.95
        field, before = fit_lattice(after, Everywhere(), (field, before)), after
        for one, another in zip(*field.arrays, *fit_lattice(after, Everywhere()).arrays, strict=True):
            np.testing.assert_array_equal(one, another)


def test_another_grid_or_kernel_takes_nothing_over() -> None:
    height = terrain(np.random.default_rng(5), (40, 50))
    own = lattice(height)
    field = fit_lattice(own, Everywhere())
    field.alpha[:] = 7.0
    for other in (own._replace(origin=own.origin + WIDTH), own._replace(noise_variance=0.5)):
        assert not (fit_lattice(other, Everywhere(), (field, own)).alpha == 7.0).any()


def test_each_pair_of_cells_is_met_once() -> None:
    whole, half = disc(5.9), half_disc(5.9)
    both = np.concatenate([half, -half, [[0, 0]]])
    assert sorted(map(tuple, both.tolist())) == sorted(map(tuple, whole.tolist()))


@pytest.mark.parametrize("factor", [0.7, 1.5, 1.7, 3.0])
@pytest.mark.parametrize("noise_variance", [1e-3, 0.01, 0.5])
def test_any_kernel_that_may_be_asked_for_is_solved(factor: float, noise_variance: float) -> None:
    config = FieldConfig(length_scale_factor=factor, noise_variance=noise_variance)
    height = terrain(np.random.default_rng(4), (40, 50))
    assert np.isfinite(fit_lattice(lattice_of(height, np.zeros(2), WIDTH, config), Everywhere()).alpha).all()
