import numpy as np
import pytest

from gpdf_service.fields.heights import fit_heights, make_sums, quadric_rest, sum_heights
from gpdf_service.fields.shapes import MOST, add, fit_pair, fit_plane, fit_ring, split_sheets
from gpdf_service.fields.spacing import local_shape
from gpdf_service.fields.tree import build_tree, make_look

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def rows(points):
    near = np.zeros((MOST, 3))
    near[: len(points)] = points
    return near, len(points)


def pair_of(points, normal):
    near, count = rows(points)
    pair = np.zeros((3, 9))
    return fit_pair(near, count, normal, np.zeros(MOST, np.int64), pair), pair


def edge(rng, count, noise):
    """A right angle along y: half of it level, half of it upright and below."""
    t, y = rng.uniform(0, 1, count), rng.uniform(-1, 1, count)
    level = np.arange(count) % 2 == 0
    points = np.column_stack([np.where(level, -t, 0.0), y, np.where(level, 0.0, -t)])
    return points + rng.normal(size=points.shape) * noise


def test_a_quadric_equals_numpys_least_squares(rng):
    points = np.column_stack([rng.uniform(-1, 1, (200, 2)), rng.normal(size=200)])
    sums = make_sums()
    sum_heights(build_tree(points), np.zeros(3), UP, 1.5, sums, make_look())
    inside = points[np.linalg.norm(points, axis=1) <= 1.5]
    assert sums.moments[0] == len(inside) > 100
    x, y, h = inside.T
    basis = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    solution, rest, *_ = np.linalg.lstsq(basis, h, rcond=None)
    expected = solution[0], np.linalg.inv(basis.T @ basis)[0, 0], rest[0]
    np.testing.assert_allclose(fit_heights(sums), expected, rtol=1e-9)
    near, count = rows(inside)
    assert quadric_rest(near, count, UP, make_sums()) == pytest.approx(fit_heights(sums)[2])


def test_too_few_points_have_no_quadric():
    sums = make_sums()
    points = np.column_stack([np.linspace(-1, 1, 30), np.zeros(30), np.zeros(30)])
    sum_heights(build_tree(points), np.zeros(3), UP, 2.0, sums, make_look())
    assert np.isinf(fit_heights(sums)[2])


@pytest.mark.parametrize("seed", range(5))
def test_two_half_planes_explain_an_edge_wherever_it_lies_and_a_quadric_does_not(seed):
    from scipy.stats import special_ortho_group  # a second to import

    rng, noise = np.random.default_rng(seed), 0.05
    R = special_ortho_group.rvs(3, random_state=seed)
    near, count = rows(edge(rng, 200, noise) @ R.T)
    bisector = R @ np.array([1.0, 0, 1.0]) / np.sqrt(2)
    left, _ = pair_of(near[:count], bisector)
    assert left / (count - 6) < 1.3 * noise**2
    assert quadric_rest(near, count, bisector, make_sums()) > 2 * left


def test_a_noisy_plane_is_no_edge(rng):
    plane = np.column_stack([rng.uniform(-1, 1, (200, 2)), rng.normal(size=200) * 0.2])
    near, count = rows(plane)
    left, _ = pair_of(plane, UP)
    assert not left < 0.7 * quadric_rest(near, count, UP, make_sums())


@pytest.mark.parametrize(("radius", "noise"), [(0.1, 0.05), (0.1, 0.0), (0.0, 0.02), (0.3, 0.05)])
def test_a_ring_tells_its_radius_and_its_noise(rng, radius, noise):
    angle = rng.uniform(0, 2 * np.pi, 2000)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-1, 1, 2000)])
    near, count = rows(points + rng.normal(size=points.shape) * noise)
    square, variance = fit_ring(near, count, near[:count].mean(axis=0), UP)
    assert np.sqrt(variance) == pytest.approx(noise, rel=0.15, abs=2e-3)  # a cable: the root of a small difference
    assert np.sqrt(square) == pytest.approx(radius, rel=0.1, abs=0.02)


def test_two_sheets_are_told_from_one(rng):
    one = np.column_stack([rng.uniform(-1, 1, (500, 2)), rng.normal(size=500) * 0.1])
    two = one + np.outer(np.sign(rng.normal(size=500)), [0, 0, 0.4])
    share = {}
    for name, points in (("one", one), ("two", two)):
        near, count = rows(points)
        moments, mean, normal = np.zeros(10), np.zeros(3), np.zeros(3)
        for point in points:
            add(moments, *point)
        low, *_ = fit_plane(moments, mean, normal)
        share[name] = split_sheets(near, count, normal, mean) / low
    assert share["one"] == pytest.approx(1 - 2 / np.pi, rel=0.15)
    assert share["two"] < 0.12


def test_a_surface_bends_at_an_edge_and_ends_at_a_rim_and_does_neither_elsewhere(rng):
    spacing = 0.05
    x, y = rng.uniform(-1, 1, (2, 1600))
    tree = build_tree(np.column_stack([np.minimum(x, 0.0), y, np.minimum(-x, 0.0)]))
    bend = local_shape(tree, np.arange(1600), spacing, np.zeros(1600))[:, 5]
    x, _, z = tree.points.T
    far = np.maximum(-x, -z)
    inner = np.abs(tree.points[:, 1]) < 0.7
    assert np.median(bend[inner & (far < 0.3 * spacing)]) == pytest.approx(0.3 * spacing, rel=0.3)
    assert np.median(bend[inner & (far > 0.3) & (far < 0.7)]) < 0.05 * spacing
    assert np.median(bend[inner & (far > 1 - 0.3 * spacing)]) > 0.15 * spacing


def test_a_disc_is_half_a_gap_wide_on_a_surface_and_neither_on_a_cable_nor_under_noise(rng):
    spacing = 0.05
    grid = np.stack(np.meshgrid(np.arange(40), np.arange(40)), axis=-1).reshape(-1, 2) * spacing
    floor = build_tree(np.column_stack([grid, np.zeros(1600)]))
    inner = (np.abs(floor.points[:, :2] - 1.0) < 0.7).all(axis=1)
    disc = local_shape(floor, np.arange(1600), spacing, np.zeros(1600))[inner]
    np.testing.assert_allclose(np.abs(disc[:, 2]), 1.0)
    np.testing.assert_allclose(disc[:, 3], 0.5 * disc[:, 4])
    assert (local_shape(floor, np.arange(1600), spacing, np.full(1600, spacing))[:, 3] == 0).all()
    cable = build_tree(np.outer(np.arange(100.0) * spacing, [0.0, 0.6, 0.8]))
    assert (local_shape(cable, np.arange(100), spacing, np.zeros(100))[:, 3] < 1e-3 * spacing).all()


def test_at_an_edge_a_disc_lies_in_the_half_plane_of_its_point(rng):
    x, y = rng.uniform(-1, 1, (2, 1600))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    tree = build_tree(np.column_stack([np.minimum(x, 0.0), y, np.minimum(-x, 0.0)]) @ turn.T)
    x, y, z = (tree.points @ turn).T
    near = (np.abs(y) < 0.7) & (np.maximum(-x, -z) < 0.1)
    normal = local_shape(tree, np.arange(1600), 0.05, np.zeros(1600))[near, :3] @ turn
    across = np.where((x < z)[near], np.abs(normal[:, 2]), np.abs(normal[:, 0]))
    assert np.mean(across > 0.99) > 0.9
