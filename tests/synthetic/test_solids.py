"""Convex solids and the worlds made of them: exact answers to where, how far, and what."""

import numpy as np
import pytest

from gpdf_service.synthetic.solid_world import SolidWorld, sample_triangles
from gpdf_service.synthetic.solids import ball, board, box, post, prism, turn_and_shift


def surface_of(solid):
    a, b, c = solid.triangles.transpose(1, 0, 2)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


def test_solids_have_the_surface_that_geometry_says():
    assert surface_of(box("x", (0, 0, 0), (1, 2, 3))) == pytest.approx(22.0)
    assert surface_of(post("x", (0, 0, 0), 1.0, 2.0, 64)) == pytest.approx(6 * np.pi, rel=0.01)
    assert surface_of(ball("x", (1, 2, 3), 0.5)) == pytest.approx(np.pi, rel=0.06)
    rising = board("x", (0, 0, 0), (3, 4, 5), 0.1, 0.2, 0.3)
    assert surface_of(rising) == pytest.approx(2 * 5 * 0.5 + 2 * 0.1 * 0.5 + 2 * 0.1 * np.hypot(5, 5))


def test_normals_look_outward_whatever_the_winding_and_the_motion():
    reflected = turn_and_shift(0.7, (3.0, -2.0, 1.0)) @ np.diag([1.0, -1.0, 1.0, 1.0])
    for solid in (box("x", (0, 0, 0), (1, 2, 3)), ball("x", (0, 0, 0), 1.0).moved(reflected)):
        middle = solid.triangles.reshape(-1, 3).mean(axis=0)
        away = solid.triangles.mean(axis=1) - middle
        assert ((away * solid.normals).sum(axis=1) > 0).all()
        assert solid.covers(middle[None]).all()
        assert not solid.covers(middle[None] + [9.0, 0.0, 0.0]).any()


def test_a_ray_meets_the_first_thing_and_knows_what_it_is():
    world = SolidWorld((box("floor", (0, 0, -1), (4, 4, 0), walkable=True), box("table", (1, 1, 0.7), (2, 2, 0.74))))
    hits = world.cast(np.array([[1.5, 1.5, 2.0], [3, 3, 2], [9, 9, 2]]), np.tile([0.0, 0.0, -1.0], (3, 1)))
    assert hits.distance[:2] == pytest.approx([1.26, 2.0], abs=1e-5)
    assert hits.distance[2] == np.inf
    assert hits.triangle[2] == -1
    assert [world.kinds[world.kind[row]] for row in hits.triangle[:2]] == ["table", "floor"]


def test_ground_under_a_place_is_ground_and_no_table():
    world = SolidWorld((box("floor", (0, 0, -1), (4, 4, 0), walkable=True), box("table", (1, 1, 0.7), (2, 2, 0.74))))
    under = world.ground_under(np.array([[1.5, 1.5, 1.0], [3.0, 3.0, 0.0], [3.0, 3.0, -0.1], [9.0, 9.0, 1.0]]))
    assert under[:2] == pytest.approx([0.0, 0.0], abs=1e-5)
    assert np.isnan(under[2:]).all()


def test_samples_leave_no_gap_and_nothing_that_another_solid_hides():
    world = SolidWorld(
        (box("floor", (0, 0, -0.5), (2, 2, 0), walkable=True), box("cupboard", (0.5, 0.5, 0), (1, 1, 1)))
    )
    points, ground = world.sample(0.05)
    inside = ((points[:, :2] > 0.501) & (points[:, :2] < 0.999)).all(axis=1)
    assert not (inside & (np.abs(points[:, 2]) < 1e-9)).any()  # neither the floor below it nor its underside
    assert (points[ground, 2] == 0.0).all()
    probes = np.random.default_rng(0).uniform(0.0, 2.0, (500, 2))
    probes = probes[~((probes > 0.45) & (probes < 1.05)).all(axis=1)]
    gap = np.linalg.norm(probes[:, None] - points[ground][None, :, :2], axis=-1).min(axis=1)
    assert gap.max() < 0.05


def test_samples_of_a_box_are_those_of_the_whole_that_lie_in_it():
    world = SolidWorld((box("floor", (0, 0, -0.5), (2, 2, 0), walkable=True), box("wall", (1, 0, 0), (1.1, 2, 2))))
    whole, part = world.sample(0.1)[0], world.sample(0.1, within=np.array([[0.3, 0.3, -0.1], [1.5, 1.5, 1.0]]))[0]
    inside = ((whole >= [0.3, 0.3, -0.1]) & (whole <= [1.5, 1.5, 1.0])).all(axis=1)
    assert {*map(tuple, whole[inside].round(6))} == {*map(tuple, part.round(6))}


def test_a_ramp_is_ground_at_every_height_of_it():
    world = SolidWorld((prism("ramp", [(0, 0), (4, 0), (4, 2), (0, 2)], -0.1, [0, 1, 1, 0], walkable=True),))
    x = np.array([0.5, 2.0, 3.5])
    under = world.ground_under(np.column_stack([x, np.ones(3), np.full(3, 3.0)]))
    assert under == pytest.approx(x / 4, abs=1e-5)


def test_a_narrow_triangle_is_sampled_within_itself():
    corners = np.array([[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [2.9, 0.2, 0.0]]])
    points, whose = sample_triangles(corners, 0.05)
    assert (whose == 0).all()
    assert (points[:, 1] >= -1e-9).all()
    assert (points[:, 1] <= points[:, 0] * 0.2 / 2.9 + 1e-9).all()
    assert points[:, 1].max() == pytest.approx(0.2)
