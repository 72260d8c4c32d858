"""The quadtree in a picture is an image."""

import numpy as np
import pytest
from house import STOREY, sample_house
from matplotlib.figure import Figure
from matplotlib.image import imread

import gpdf_service as gpdf
from gpdf_service.synthetic import SCENES
from gpdf_service.viewer import picture
from gpdf_service.viewer.picture import FITS, FITS_EDGE, PANELS, _draw_quadtree, draw_plans, draw_scene


def test_what_is_painted_is_as_large_as_what_is_free():
    made = SCENES["office"](np.random.default_rng(0))
    scene = gpdf.build_scene(made.points, made.ground)
    tree = scene.free_space("human").levels[0].quadtree
    axes = Figure().add_subplot()
    _draw_quadtree(axes, scene, gpdf.AGENTS["human"], 0, (FITS, FITS_EDGE), 0.4)
    image = axes.images[0]
    left, right, low, high = image.get_extent()
    painted = np.mean(np.asarray(image.get_array())[..., 3] > 0.0) * (right - left) * (high - low)
    free = np.sum((2.0 * tree.half_size[tree.free]) ** 2)
    assert painted == pytest.approx(free, rel=0.01)
    assert len(axes.collections) == 0


def test_a_tower_is_one_sheet_that_fits_a_screen(tmp_path, monkeypatch):
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0, 3, 0.1), np.arange(0, 3, 0.1)))
    points = np.concatenate([np.column_stack([x, y, np.full(x.size, 3.0 * k)]) for k in range(PANELS + 2)])
    scene = gpdf.build_scene(points, np.ones(len(points), dtype=bool))
    said = []
    monkeypatch.setattr(Figure, "suptitle", lambda figure, words, **style: said.append(words))
    draw_scene(scene, "human", tmp_path / "tower.png")
    height, width = imread(tmp_path / "tower.png").shape[:2]
    assert width <= 1920
    assert height <= 1080
    assert len(said) == 1
    assert [f"level {k}, z {3 * k:.1f} m" in said[0] for k in range(PANELS + 2)] == [False] * PANELS + [True] * 2


def test_a_plan_fills_its_picture_and_shows_the_rooms_around_the_way(office, tmp_path):
    made, scene = office
    result = gpdf.plan(scene, made.start, made.goal, "human")
    draw_plans(scene, {"human": result}, tmp_path / "plan.png", start=made.start, goal=made.goal)
    inked = (imread(tmp_path / "plan.png")[..., :3] < 0.99).any(axis=-1).any(axis=0)
    assert np.flatnonzero(inked)[0] < 0.12 * len(inked)
    assert np.flatnonzero(inked)[-1] > 0.88 * len(inked)


def test_a_way_over_two_storeys_is_drawn_on_both_and_none_cuts_its_ends_off(tmp_path, monkeypatch):
    points, ground = sample_house()
    under = (points[:, 2] < STOREY - 0.3) & (points[:, 0] > 5.3)  # of the lower storey nobody saw that part
    scene = gpdf.build_scene(points[~under], ground[~under])
    start, goal = (0.5, 2.0, 0.0), (6.4, 4.4, STOREY)
    result = gpdf.plan(scene, start, goal, "human")
    drawn = []
    monkeypatch.setattr(picture, "_save", lambda figure, path: drawn.append(figure))
    draw_plans(scene, {"human": result}, tmp_path / "plan.png", start=start, goal=goal)
    lower, upper = (axes for axes in drawn[0].axes if "plan view" in axes.get_title())
    assert "level 0" in lower.get_title()
    assert "level 1" in upper.get_title()
    ways = []
    for axes in (lower, upper):
        left, right, low, high = *axes.get_xlim(), *axes.get_ylim()
        assert left < min(start[0], goal[0]) < max(start[0], goal[0]) < right
        assert low < min(start[1], goal[1]) < max(start[1], goal[1]) < high
        (way,) = (line for line in axes.lines if line.get_label().startswith("human: "))
        ways.append(~np.isnan(way.get_xdata()))
    assert (ways[0] ^ ways[1]).all()
    heights = result.trajectory.ground[:, 2]
    assert heights[ways[0]].min() < 0.05
    assert heights[ways[1]].max() > STOREY - 0.05
    assert heights[ways[0]].max() <= heights[ways[1]].min() + 0.2


def test_a_refused_place_far_off_the_map_does_not_make_the_picture_small(office, tmp_path, monkeypatch):
    made, scene = office
    goal = (900.0, 3.0)
    result = gpdf.plan(scene, made.start, goal, "human")
    drawn = []
    monkeypatch.setattr(picture, "_save", lambda figure, path: drawn.append(figure))
    draw_plans(scene, {"human": result}, tmp_path / "plan.png", start=made.start, goal=goal)
    (plan,) = (axes for axes in drawn[0].axes if "plan view" in axes.get_title())
    assert plan.get_xlim()[1] < 8.0
