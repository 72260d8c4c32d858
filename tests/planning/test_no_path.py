import dataclasses

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.ground.limits import ObstacleKind
from gpdf_service.planning import no_path
from gpdf_service.planning.endpoints import find_endpoint
from gpdf_service.planning.no_path import Cut, explain_no_path
from gpdf_service.synthetic import SCENES, Box, World
from gpdf_service.tiles.surface import OBSERVED, Cells
from gpdf_service.types import AGENTS


def scene_of(*boxes, size=(6.0, 4.0, 2.6), spacing=0.05, without=None):
    points, ground = World(size, boxes).sample(spacing, np.random.default_rng(0))
    keep = np.ones(len(points), dtype=bool) if without is None else ~(ground & without(points))
    return gpdf.build_scene(points[keep], ground[keep])


def explain(scene, start, goal, agent):
    result = gpdf.plan(scene, start, goal, agent)
    assert result.status is gpdf.Status.NO_VALID_PATH
    space = scene.free_space(agent)
    ends = (find_endpoint(space, np.array(place, float), name) for place, name in ((start, "start"), (goal, "goal")))
    why = explain_no_path(space, *ends, hidden=scene.hidden_height)
    assert why.message == result.message
    assert result.details["largest_radius"] == why.largest_radius
    return why


@pytest.mark.parametrize(("gap", "aside"), [(0.45, 0.0), (0.378, 0.03), (0.386, 0.011), (0.472, -0.04)])
def test_the_largest_body_that_is_said_to_pass_a_door_passes(gap, aside):
    low, high = 2.0 + aside - gap / 2, 2.0 + aside + gap / 2
    scene = scene_of(Box((3.0, 0.0, 0.0), (3.2, low, 2.6)), Box((3.0, high, 0.0), (3.2, 4.0, 2.6)), spacing=0.03)
    largest = explain(scene, (1, 2), (5, 2), "human").largest_radius
    assert gap / 2 - 0.015 < largest < gap / 2
    said = dataclasses.replace(AGENTS["human"], width=2 * largest, length=2 * largest)
    assert gpdf.plan(scene, (1, 2), (5, 2), said).status is gpdf.Status.OK


@pytest.mark.parametrize("gap", [0.45, 0.3])
def test_a_narrow_door_is_named_with_its_place_and_the_body_that_passes(gap):
    walls = Box((3.0, 0.0, 0.0), (3.2, 2.0 - gap / 2, 2.6)), Box((3.0, 2.0 + gap / 2, 0.0), (3.2, 4.0, 2.6))
    scene = scene_of(*walls, spacing=0.02)
    why = explain(scene, (1, 2), (5, 2), "human")
    assert why.cuts == ("width",)
    np.testing.assert_allclose(why.at[:2], [3.1, 2.0], atol=0.15)
    assert gap / 2 - 0.03 < why.largest_radius <= gap / 2 + 0.005
    thin = dataclasses.replace(AGENTS["human"], width=2 * why.largest_radius - 0.03, length=0.2)
    assert gpdf.plan(scene, (1, 2), (5, 2), thin).status is gpdf.Status.OK


def test_a_passage_that_is_millimetres_too_narrow_is_told_in_millimetres():
    walls = Box((3.0, 0.0, 0.0), (3.2, 1.756, 2.6)), Box((3.0, 2.244, 0.0), (3.2, 4.0, 2.6))  # 488 mm for 500
    result = gpdf.plan(scene_of(*walls, spacing=0.02), (1, 2), (5, 2))
    assert result.status is gpdf.Status.NO_VALID_PATH
    assert "mm too narrow" in result.message
    short = result.details["short_width"]
    assert 0.0 < short < 0.037  # what the search keeps is in it
    assert short == pytest.approx(0.5 - 2.0 * result.details["largest_radius"], abs=1e-6)


def test_a_deadline_leaves_a_refusal_without_its_reason():
    scene = scene_of(Box((3.0, 0.0, 0.0), (3.2, 4.0, 2.6)))
    space = scene.free_space("human")
    ends = [find_endpoint(space, np.array(at), "end") for at in ((1.0, 1.0), (5.0, 3.0))]
    why = explain_no_path(space, *ends, left=lambda: 0.0)
    assert why.cuts == ()
    assert "no time to say why" in why.message


def test_a_cut_on_one_of_many_levels_is_looked_for_where_the_way_goes():
    """Far ground does not make the answer coarser or slower: only what is around start and goal is looked at."""
    near, far = Box((3.0, 0.0, 0.0), (3.2, 4.0, 2.6)), Box((30.0, 0.0, 0.0), (30.2, 1.0, 2.6))
    why = explain(scene_of(near, far, size=(40.0, 4.0, 2.6), spacing=0.08), (1, 1), (5, 3), "human")
    assert why.cuts == ("solid",)
    assert why.at[0] == pytest.approx(3.0, abs=0.2)


def test_a_low_beam_is_named_with_its_headroom_and_a_lower_body_passes():
    scene = scene_of(Box((3.0, 0.0, 0.8), (3.6, 4.0, 2.6)))
    why = explain(scene, (1, 1), (5, 3), "human")
    assert why.cuts == ("height",)
    assert "0.80 m of headroom" in why.message
    assert why.short["height"] == pytest.approx(1.2, abs=0.02)
    assert why.at[0] == pytest.approx(3.0, abs=0.1)
    assert gpdf.plan(scene, (1, 1), (5, 3), dataclasses.replace(AGENTS["human"], height=0.7)).status is gpdf.Status.OK


def test_a_step_is_named_with_its_height_and_place():
    scene = scene_of(Box((3.0, 0.0, 0.0), (6.0, 4.0, 0.3), walkable=True))
    why = explain(scene, (1, 1), (5, 3), "roomba")
    assert why.cuts == ("step",)
    assert "0.30" in why.message
    assert why.at[0] == pytest.approx(3.0, abs=0.1)


def test_a_stair_is_a_step_to_pepper():
    made = SCENES["stair"](np.random.default_rng(0))
    why = explain(gpdf.build_scene(made.points, made.ground), made.start, made.goal, "pepper")
    assert why.cuts == ("step",)
    assert "(0.015 m)" in why.message


def test_a_ramp_too_steep_is_a_slope():
    points, ground = World((6.0, 4.0, 2.6), ()).sample(0.05, np.random.default_rng(0))
    points[:, 2] += 0.36 * np.clip(points[:, 0] - 2.5, 0.0, 1.5)  # 20° over 1.5 m
    cart = dataclasses.replace(AGENTS["pepper"], max_step=0.1)  # at 2 cm a cell, Pepper is told of a step too
    why = explain(gpdf.build_scene(points, ground), (1, 2), (5, 2), cart)
    assert why.cuts == ("slope",)
    assert 18 <= float(why.message.split("a slope of ")[1].split("°")[0]) <= 23
    assert 2.3 <= why.at[0] <= 2.8


def test_a_wide_hole_in_the_ground_is_ground_that_nobody_has_seen():
    scene = scene_of(size=(8.0, 4.0, 2.6), without=lambda p: (p[:, 0] > 3.0) & (p[:, 0] < 5.5))
    why = explain(scene, (1, 1), (7, 3), "human")
    assert why.cuts == ("unknown",)
    assert 2.9 <= why.at[0] <= 4.1


def test_a_wall_stops_every_body():
    why = explain(scene_of(Box((3.0, 0.0, 0.0), (3.2, 4.0, 2.6))), (1, 1), (5, 3), "roomba")
    assert why.cuts == ("solid",)
    assert why.largest_radius == 0.0
    assert why.at[0] == pytest.approx(3.0, abs=0.1)


def test_two_limits_in_a_row_are_both_named():
    beam, platform = Box((2.0, 0.0, 0.8), (2.4, 4.0, 2.6)), Box((4.0, 0.0, 0.0), (6.0, 4.0, 0.3), walkable=True)
    why = explain(scene_of(beam, platform), (1, 2), (5.2, 2), "pepper")
    assert set(why.cuts) == {"height", "step"}
    assert "; and " in why.message


def test_what_is_nowhere_on_the_map_is_no_reason():
    scene = scene_of(Box((2.0, 1.5, 0.0), (2.5, 2.0, 1.0)))  # a way is there, as coarse cells may find one
    space = scene.free_space("human")
    why = explain_no_path(space, *(find_endpoint(space, np.array(at), "end") for at in ((1.0, 1.0), (5.0, 3.0))))
    assert "slope" not in why.cuts


def test_a_passage_that_only_the_noise_makes_too_narrow_says_so():
    words = no_path._narrow_words(np.array([1.0, 2.0, 0.0]), 0.256, 0.26, 0.01)
    assert "8 mm too narrow" in words
    assert "this one needs 0.520 m, 0.020 m of it for the noise of the scan" in words
    assert "noise" not in no_path._narrow_words(np.array([1.0, 2.0, 0.0]), 0.24, 0.25, 0.0)


def test_headroom_is_told_over_the_ground_that_stops_the_body_and_only_where_a_lower_one_gets_through():
    height = np.zeros((40, 20), np.float32)
    height[24:] = 0.3  # a platform from x = 1.2 m on
    ground = Cells(height, np.full(height.shape, OBSERVED, np.uint8), np.zeros(2), 0.05)
    points = np.array([[1.05, 0.5, 2.2], [0.5, 0.5, 1.5], [0.5, 0.5, 2.1], [0.5, 0.5, 0.1]])  # above the floor
    kind, flat = np.full(len(points), int(ObstacleKind.MATERIAL), np.uint8), np.zeros(height.shape)
    box, room = np.array([[0.0, 0.0], [2.0, 1.0]]), (0.115, 2.0, 0.25)
    found, cut, asks = no_path._tell_points(points, kind, box, ground, (flat, flat), 0.37, room)
    assert found.tolist() == points.tolist()
    assert cut.tolist() == [Cut.HEIGHT, Cut.HEIGHT, Cut.SOLID, Cut.SOLID]
    np.testing.assert_allclose(asks[:2], [-1.9, -1.5], atol=1e-6)  # the first is met by who stands on the platform
