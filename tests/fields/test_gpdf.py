import numpy as np
import pytest
from scipy.spatial import cKDTree

from gpdf_service.bench.field import in_bands
from gpdf_service.bench.surfaces import SURFACES
from gpdf_service.errors import FieldError
from gpdf_service.fields import (
    Gpdf,
    build_tree,
    estimate_spacing,
    find_nearest,
    fit_gpdf,
    sample_at,
    thin,
)
from gpdf_service.fields.gpdf import Box
from gpdf_service.fields.solve import solve_all
from gpdf_service.fields.threads import MIN_CHUNK
from gpdf_service.fields.traversal import bracket_at, nearest_at
from gpdf_service.fields.tree import change_tree, make_scratch, place_of, tree_of


@pytest.fixture(scope="module")
def rng():
    return np.random.default_rng(3)


@pytest.fixture(scope="module")
def floor(rng):
    points = np.column_stack([rng.uniform(0, 6, (8000, 2)), np.zeros(8000)])
    return fit_gpdf(points)


def over(rng, low, high, count=2000):
    return np.column_stack([rng.uniform(1, 5, (count, 2)), rng.uniform(low, high, count)])


@pytest.mark.parametrize("dim", [2, 3])
def test_the_spacing_is_told_by_exact_neighbours_whoever_builds_the_tree(dim):
    points = np.random.default_rng(dim).normal(size=(3000, dim))
    true = np.median(cKDTree(points).query(points, k=9)[0][:, 8]) * np.sqrt(np.pi / 8)
    assert estimate_spacing(points) == estimate_spacing(points, build_tree(points)) == pytest.approx(true, rel=1e-12)


def test_distance_over_a_plane_is_its_height(floor, rng):
    queries = over(rng, 0.3, 3.0)
    error = floor.query(queries).distance - queries[:, 2]
    assert np.sqrt((error**2).mean()) < 0.05 * floor.spacing
    assert error.max() < 0.5 * floor.spacing


def test_gradient_over_a_plane_points_up(floor, rng):
    gradient = floor.query(over(rng, 0.3, 3.0)).gradient
    angle = np.degrees(np.arccos(np.clip(gradient[:, 2] / np.linalg.norm(gradient, axis=1), -1, 1)))
    assert np.median(angle) < 1.5


def test_gradient_agrees_with_finite_differences(floor, rng):
    queries, h = over(rng, 0.3, 2.0), 1e-5
    sample = floor.query(queries)
    for axis in range(3):
        step = np.eye(3)[axis] * h
        difference = (floor.query(queries + step).distance - floor.query(queries - step).distance) / (2 * h)
        assert np.quantile(np.abs(difference - sample.gradient[:, axis]), 0.8) < 1e-5


def test_distance_never_exceeds_the_nearest_point(rng):
    points = rng.uniform(0, 3, (3000, 2))
    field = fit_gpdf(points)
    queries = rng.uniform(-1, 4, (4000, 2))
    sample = field.query(queries)
    assert (sample.distance <= find_nearest(field.tree, queries)[0] + 1e-12).all()
    assert (sample.distance >= 0).all()
    assert (np.linalg.norm(sample.gradient, axis=1) <= 1 + 1e-9).all()


def test_a_sphere_from_outside_is_closer_to_the_truth_than_its_nearest_point(rng):
    points = rng.normal(size=(6000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    field = fit_gpdf(points)
    queries = rng.normal(size=(2000, 3))
    queries *= rng.uniform(1.05, 1.8, (2000, 1)) / np.linalg.norm(queries, axis=1, keepdims=True)
    real = np.abs(np.linalg.norm(queries, axis=1) - 1)
    away = real > field.spacing
    error = field.query(queries).distance[away] - real[away]
    nearest = find_nearest(field.tree, queries)[0][away] - real[away]
    assert np.sqrt((error**2).mean()) < 0.9 * np.sqrt((nearest**2).mean())


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("count", [1, 5, 16, 17, 1000, 5000])
def test_nearest_point_equals_scipy(rng, dim, count):
    points = rng.uniform(-1, 1, (count, dim))
    queries = rng.uniform(-2, 2, (3 * MIN_CHUNK, dim))  # enough that the batch is split over threads
    distance, row = find_nearest(build_tree(points), queries)
    expected, _ = cKDTree(points).query(queries)
    np.testing.assert_allclose(distance, expected, atol=1e-12)
    tree = build_tree(points)
    np.testing.assert_allclose(np.linalg.norm(tree.points[row] - queries, axis=1), expected, atol=1e-12)
    np.testing.assert_array_equal(points[tree.order], tree.points)


def test_a_batch_on_threads_equals_one_by_one(floor, rng):
    queries = over(rng, 0.0, 2.0, 5 * MIN_CHUNK)
    whole = floor.query(queries)
    single = [floor.query(queries[i : i + 1]).distance[0] for i in range(0, len(queries), 37)]
    np.testing.assert_array_equal(whole.distance[::37], single)


def test_log_domain_equals_the_plain_formula(rng):
    points = np.column_stack([np.linspace(0, 2, 60), np.zeros(60)])
    field = fit_gpdf(points, spacing=2 / 59)
    queries = np.column_stack([rng.uniform(0.3, 1.7, 200), rng.uniform(0.02, 0.15, 200)])
    l = field.length_scale
    K = np.exp(-((points[:, None] - points[None]) ** 2).sum(-1) / (2 * l**2))
    alpha = np.linalg.solve(K + field.noise_variance * np.eye(60), np.ones(60))
    o = np.exp(-((queries[:, None] - points[None]) ** 2).sum(-1) / (2 * l**2)) @ alpha
    plain = np.sqrt(np.maximum(-2 * l**2 * np.log(o), 0))
    bare = field.discs * [1, 1, 1, 0, 1, 1]  # no radius: the bracket begins at the points
    field = Gpdf(field.tree, field.alpha, bare, field.noise, field.kernel)
    sample = field.query(queries).distance
    free = np.abs(sample - find_nearest(field.tree, queries)[0]) > 1e-6  # where the bracket did not clip
    assert free.sum() > 30
    inside = free & (plain > np.sqrt(np.maximum(find_nearest(field.tree, queries)[0] ** 2 - field.spacing**2, 0)))
    np.testing.assert_allclose(sample[inside], plain[inside], atol=1e-3)


def test_far_away_it_does_not_underflow(floor):
    sample = floor.query([[3.0, 3.0, 5.5]])
    assert sample.valid[0]
    assert abs(sample.distance[0] - 5.5) < 0.01


def test_outside_the_domain_nothing_reads_as_free(floor):
    sample = floor.query([[1e4, 0, 0], [np.nan, 0, 0], [0, np.inf, 0]])
    assert not sample.valid.any()
    assert (sample.distance == 0).all()
    assert (sample.gradient == 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_point_order_changes_nothing_though_two_points_of_a_cell_are_as_near_to_their_mean(seed):
    rng = np.random.default_rng(seed)
    points, queries = rng.uniform(0, 2, (500, 2)), rng.uniform(0, 2, (300, 2))
    spacing = 0.2 * estimate_spacing(points)
    one, other = fit_gpdf(points, spacing=spacing), fit_gpdf(rng.permutation(points), spacing=spacing)
    assert len(one.points) < len(points)
    np.testing.assert_allclose(one.query(queries).distance, other.query(queries).distance, atol=1e-9)


def test_rigid_motion_changes_nothing_where_no_two_points_share_a_cell(rng):
    grid = np.stack(np.meshgrid(np.arange(20), np.arange(20)), axis=-1).reshape(-1, 2)
    points, queries = 0.1 * (grid + rng.uniform(0.2, 0.8, grid.shape)), rng.uniform(0, 2, (300, 2))
    R = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    before = fit_gpdf(points, spacing=0.02).query(queries).distance
    moved = fit_gpdf(points @ R.T + [5, -3], spacing=0.02).query(queries @ R.T + [5, -3]).distance
    np.testing.assert_allclose(before, moved, atol=1e-5)


def test_a_restored_field_answers_the_same_without_a_fit(floor, rng, monkeypatch):
    monkeypatch.setattr("gpdf_service.fields.gpdf.solve_all", None)
    back = Gpdf.from_arrays(floor.to_arrays(), Box(floor.points))
    queries = over(rng, 0, 2, 50)
    np.testing.assert_array_equal(back.query(queries).distance, floor.query(queries).distance)


@pytest.mark.parametrize("points", [[[1.0, 2.0, 3.0]], [[1.0, 2.0, 3.0]] * 5])
def test_one_place_gives_the_distance_to_it(points):
    field = fit_gpdf(points, domain=Box(np.array([[0.0, 0, 0], [5, 5, 5]])))
    assert field.query([[1.0, 2.0, 4.0]]).distance[0] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((0, 3)), "no points"),
        (np.zeros((5, 4)), "shape"),
        (np.zeros(5), "shape"),
        ([[0.0, np.nan, 1.0]], "not finite"),
        ([[0.0, np.inf, 1.0]], "not finite"),
        ([[1e200, 0.0, 0.0], [0.0, 0.0, 0.0]], "beyond"),
        ([*np.random.default_rng(0).uniform(size=(200, 3)), [1e7, 0.0, 0.0]], "apart"),
        ([["a", "b", "c"]], "array of real numbers"),
        ([[1.0, 2.0], [1.0, 2.0, 3.0]], "array of real numbers"),
        (np.ones((5, 3)) * 1j, "array of real numbers"),
        (None, "array of real numbers"),
    ],
)
def test_points_that_cannot_be_fitted_are_refused(points, message):
    with pytest.raises(FieldError, match=message):
        fit_gpdf(points)


@pytest.mark.parametrize(
    "wrong",
    [{"noise": value} for value in ([0.1, 0.2], np.nan, -1.0)]
    + [{"spacing": value} for value in (0.0, np.nan, -1.0, 1e-12)],
)
def test_noise_and_spacing_that_are_none_are_refused(rng, wrong):
    with pytest.raises(FieldError, match=r"noise|spacing"):
        fit_gpdf(rng.uniform(size=(100, 3)), **wrong)


@pytest.mark.parametrize("queries", [[[0.0, 0.0]], [0.0, 0.0, 0.0], np.zeros((2, 4)), [["a", "b", "c"]], None, []])
def test_queries_of_another_dimension_or_kind_are_refused(floor, queries):
    with pytest.raises(FieldError, match=r"\(m, 3\)|array of real numbers"):
        floor.query(queries)


def test_no_queries_have_no_answers(floor):
    assert len(floor.query(np.zeros((0, 3))).distance) == len(find_nearest(floor.tree, np.zeros((0, 3)))[0]) == 0


class Everywhere:
    def contains(self, queries):
        return np.ones(len(queries), dtype=bool)


def test_where_squares_overflow_there_is_no_room_whatever_the_domain_says(floor):
    far = np.array([[1e4, 0, 0], [1e200, 0, 0], [1e308, -1e308, 0]])
    sample = floor.over(Everywhere()).query(far)
    np.testing.assert_array_equal(sample.valid, [True, False, False])
    assert sample.distance[0] == pytest.approx(1e4 - floor.points[:, 0].max(), rel=1e-3)
    np.testing.assert_array_equal(sample.distance[1:], 0)


@pytest.mark.parametrize("place", [[np.nan, 0.0, 0.0], [np.inf, 0.0, 0.0], [1e200, 0.0, 0.0]])
def test_compiled_loops_see_no_room_at_what_is_no_place(floor, place):
    gradient = np.ones(3)
    assert sample_at(floor.arrays, place_of(np.array(place)), make_scratch(), gradient) == 0.0
    assert nearest_at(floor.tree, place_of(np.array(place)), make_scratch())[0] == 0.0
    np.testing.assert_array_equal(gradient, 0)


def test_float32_integers_and_any_layout_are_taken(rng):
    points = rng.integers(0, 50, (400, 3)) * 0.5
    expected = fit_gpdf(points).query(points[:50] + 0.3).distance
    for other in (
        points.astype(np.float32),
        np.asfortranarray(points),
        np.repeat(points, 2, axis=0)[::2],
        points.tolist(),
    ):
        np.testing.assert_array_equal(fit_gpdf(other).query(np.asarray(other)[:50] + np.float32(0.3)).valid, True)
        np.testing.assert_allclose(fit_gpdf(other).query(points[:50] + 0.3).distance, expected, atol=1e-12)


def test_thinning_keeps_real_points_one_a_cell(rng):
    points = rng.uniform(0, 1, (5000, 3))
    rows = thin(points, 0.2)
    assert len(np.unique(rows)) == len(rows)
    key = np.floor((points - points.min(axis=0)) / 0.2).astype(int)
    assert len(np.unique(key[rows], axis=0)) == len(rows) == len(np.unique(key, axis=0))


def test_spacing_of_a_grid_is_its_step():
    grid = np.stack(np.meshgrid(np.arange(60) * 0.1, np.arange(60) * 0.1), axis=-1).reshape(-1, 2)
    assert estimate_spacing(grid) == pytest.approx(0.1, rel=0.2)


@pytest.fixture(scope="module")
def room(rng):
    grid = np.stack(np.meshgrid(np.arange(0, 5, 0.04), np.arange(0, 5, 0.04)), axis=-1).reshape(-1, 2)
    return fit_gpdf(np.column_stack([grid, rng.normal(size=len(grid)) * 0.002]), spacing=0.04)


def from_scratch(field):
    """The same points, all solved together."""
    tree = build_tree(np.ascontiguousarray(field.points))
    alpha = solve_all(tree, field.length_scale, field.noise_variance)
    return Gpdf(tree, alpha, field.discs[tree.order], field.noise[tree.order], field.kernel, field.domain)


def with_more(field, points):
    """The field with those of the points that say something new."""
    points = points[thin(points, 0.5 * field.spacing)]
    far = find_nearest(field.tree, points)[0] >= 0.5 * field.spacing
    return field.replace(np.zeros(len(field.points), dtype=bool), points[far])


def test_what_is_replaced_equals_a_fit_from_scratch(room, rng):
    box = rng.uniform(0, 0.6, (600, 3)) + np.array([2, 2, 0])
    queries = np.column_stack([rng.uniform(0, 5, (4000, 2)), rng.uniform(0, 2, 4000)])
    inserted = with_more(room, box)
    assert len(room.points) < len(inserted.points) <= len(room.points) + 600
    under = (np.abs(inserted.points[:, :2] - 2.3) < 0.3).all(axis=1) & (inserted.points[:, 2] < 0.01)
    removed = inserted.replace(under, np.zeros((0, 3)))
    assert len(removed.points) == len(inserted.points) - under.sum() < len(inserted.points)
    for field in (inserted, removed):
        scratch = from_scratch(field)
        np.testing.assert_allclose(field.query(queries).distance, scratch.query(queries).distance, atol=1e-3)
        np.testing.assert_allclose(
            find_nearest(field.tree, queries)[0], cKDTree(field.points).query(queries)[0], atol=1e-12
        )
    assert np.abs(inserted.query(queries).distance - room.query(queries).distance).max() > 0.3  # it did change


def test_what_is_put_in_and_taken_out_again_gives_the_field_back(room, rng):
    inserted = with_more(room, rng.uniform(0, 0.5, (300, 3)) + np.array([1, 3, 0.2]))
    old = {tuple(point) for point in room.points}
    back = inserted.replace(np.array([tuple(point) not in old for point in inserted.points]), np.zeros((0, 3)))
    assert len(back.points) == len(room.points)
    queries = rng.uniform(0, 5, (2000, 3))
    np.testing.assert_allclose(back.query(queries).distance, room.query(queries).distance, atol=1e-3)


def test_nothing_that_comes_or_goes_leaves_the_field_as_it_is(room):
    assert room.replace(np.zeros(len(room.points), dtype=bool), np.zeros((0, 3))) is room


@pytest.mark.parametrize("dim", [2, 3])
def test_a_tree_changed_many_times_finds_what_scipy_finds(rng, dim):
    """Leaves are added, emptied, and all is built again when half of their room is empty."""
    tree, sizes = build_tree(rng.uniform(0, 1, (300, dim))), []
    queries = rng.uniform(-0.5, 1.5, (300, dim))
    for _ in range(30):
        keep, added = rng.random(len(tree.points)) < 0.9, rng.uniform(0, 1, (rng.integers(0, 40), dim))
        before = tree.points
        tree, source = change_tree(tree, keep, added)
        old = source >= 0
        np.testing.assert_array_equal(tree.points[old], before[source[old]])
        np.testing.assert_array_equal(tree.points[~old], added[-1 - source[~old]])
        assert sorted(source[old]) == np.flatnonzero(keep).tolist()
        for ours, built in zip(tree, tree_of(tree.points, tree.order, tree.begin), strict=True):
            np.testing.assert_array_equal(ours, built)  # leaves that are as they were are copied
        np.testing.assert_allclose(find_nearest(tree, queries)[0], cKDTree(tree.points).query(queries)[0], atol=1e-12)
        sizes.append(len(tree.blocks))
    assert (np.diff(sizes) > 0).any()
    assert (np.diff(sizes) < 0).any()


def test_a_copy_that_fills_up_a_leaf_stands_for_the_last_point_of_it(rng):
    """However its distance is rounded: here a copy is nearer than the point itself by what a sum may be off."""
    few = np.column_stack([0.05 * np.arange(20), np.zeros(20)])
    field = with_more(fit_gpdf(few, spacing=0.05), np.add(few, (0.0, 5.0)))
    tree = field.tree
    assert tree.begin.tolist() == [0, 20, 40]
    last, noise = tree.points[19], np.where(np.arange(40) == 20, 10.0, 0.0)
    query = last + rng.normal(size=(100, 2)) * 1e-3
    blocks = tree.blocks.copy()
    blocks[0, 0, 20:] += np.copysign(1e-12, query[0, 0] - last[0])
    rounded = Gpdf(tree._replace(blocks=blocks), field.alpha, field.discs, noise, field.kernel)
    nearer = query[np.abs(query[:, 0] - blocks[0, 0, 20]) < np.abs(query[:, 0] - last[0])]
    assert len(nearer) > 20
    assert set(find_nearest(rounded.tree, nearer)[1]) == {19}
    np.testing.assert_allclose(rounded.query(nearer).deviation, field.query(nearer).deviation, atol=1e-9)


def test_the_disc_of_a_point_at_an_edge_does_not_hang_on_the_order_of_the_points(rng):
    """A lattice is cut in two right through a row, and both half planes go through the points of an edge."""
    along, up = (axis.ravel() for axis in np.meshgrid(0.05 * np.arange(21), 0.05 * np.arange(1, 21)))
    floor, slope = np.column_stack([-up, along, 0.0 * up]), np.column_stack([up, along, 2.0 * up])
    points = np.concatenate([floor, slope, np.column_stack([0.0 * along[:21], along[:21], 0.0 * along[:21]])])
    discs = []
    for _ in range(5):
        order = rng.permutation(len(points))
        field = fit_gpdf(points[order], spacing=0.05)
        discs.append(field.discs[np.lexsort(field.points.T)])
    for again in discs[1:]:
        np.testing.assert_allclose(np.abs(again), np.abs(discs[0]), atol=1e-9)  # a normal may face either way


def test_all_points_cannot_be_removed(room):
    with pytest.raises(FieldError, match="all points"):
        room.replace(np.ones(len(room.points), dtype=bool), np.zeros((0, 3)))


def test_pieces_and_their_halos_equal_one_solve(room, monkeypatch):
    monkeypatch.setattr("gpdf_service.fields.solve.PIECE", 1500)
    pieces = from_scratch(room)
    assert len(room.points) > 10 * 1500
    rng = np.random.default_rng(5)
    queries = np.column_stack([rng.uniform(0, 5, (3000, 2)), rng.uniform(0, 1, 3000)])
    np.testing.assert_allclose(pieces.query(queries).distance, room.query(queries).distance, atol=5e-4)


def test_parts_of_a_piece_equal_one_solve_and_do_not_ask_how_many_cores_there_are(room, monkeypatch):
    solved = []
    for rows, cores in ((10**9, 1), (1000, 1), (1000, 7)):
        monkeypatch.setattr("gpdf_service.fields.solve.PART", rows)
        monkeypatch.setattr("gpdf_service.fields.threads.worker_count", lambda cores=cores: cores)
        solved.append(solve_all(room.tree, room.length_scale, room.noise_variance))
    np.testing.assert_allclose(solved[1], solved[0], atol=1e-6)
    np.testing.assert_array_equal(solved[1], solved[2])


def test_a_field_takes_less_than_200_bytes_a_point(room):
    assert 50 * len(room.points) < room.nbytes < 200 * len(room.points)


def test_where_nothing_is_valid_the_deviation_is_endless(floor):
    sample = floor.query([[1e4, 0, 0], [3.0, 3.0, 1.0]])
    assert np.isinf(sample.deviation[0])
    assert 0 < sample.deviation[1] < floor.spacing


@pytest.mark.parametrize("name", ["stairs", "step", "corner", "sphere", "board", "pole"])
def test_on_clean_points_the_field_says_at_most_half_a_spacing_too_much(name):
    rng, surface = np.random.default_rng(3), SURFACES[name]
    points = surface.sample(20_000, rng)
    field = fit_gpdf(points)
    for _, asked, real in in_bands(surface, points, 300, rng):
        assert (field.query(asked).distance - real).max() <= 0.5 * field.spacing


def test_beside_an_evenly_sampled_plane_the_distance_is_exact_and_finite_differences_agree(rng):
    grid = np.stack(np.meshgrid(np.arange(60), np.arange(60)), axis=-1).reshape(-1, 2) * 0.05
    field = fit_gpdf(np.column_stack([grid, np.zeros(3600)]))
    asked = np.column_stack([rng.uniform(1, 2, (500, 2)), rng.uniform(0.02, 0.05, 500)])
    sample = field.query(asked)
    assert np.quantile(np.abs(sample.distance - asked[:, 2]), 0.95) < 0.02 * field.spacing
    assert (sample.distance <= find_nearest(field.tree, asked)[0]).all()
    h = 1e-6
    smooth = np.ones(500, dtype=bool)
    for axis, step in enumerate(np.eye(3) * h):
        ahead, behind = field.query(asked + step).distance, field.query(asked - step).distance
        smooth &= np.abs(ahead + behind - 2 * sample.distance) < 1e-9
        difference = (ahead - behind) / (2 * h)
        assert np.quantile(np.abs(difference - sample.gradient[:, axis])[smooth], 0.95) < 1e-5
    assert smooth.mean() > 0.8


def test_what_a_field_says_lies_in_its_bracket(rng, floor):
    queries, scratch, slope = over(rng, 0.0, 2.0), make_scratch(), np.empty(3)
    for place in map(tuple, queries):
        low, high = bracket_at(floor.arrays, place, scratch)
        assert low <= sample_at(floor.arrays, place, scratch, slope) <= high
    assert bracket_at(floor.arrays, (np.nan, 0.0, 0.0), scratch) == (0.0, np.inf)
