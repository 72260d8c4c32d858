"""What ways cost, and that people are led where a companion would lead them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.errors import RequestError
from gpdf_service.search.ways import (
    LEDGE,
    LENGTH,
    SLOPED,
    STEPPED,
    TIGHT,
    Prefer,
    beside,
    level_body,
    prices,
    way_takes,
)
from gpdf_service.synthetic.world import Box, World

HUMAN = gpdf.AGENTS["human"]


def build(*shapes: Box, size=(6.0, 4.0, 2.6), floor=None, seed=0):
    world = World(size, shapes) if floor is None else World(size, shapes, floor)
    points, ground = world.sample(0.04, np.random.default_rng(seed), 0.0)
    return gpdf.build_scene(points, ground)


@pytest.fixture(scope="module")
def ledge():
    """A platform of 30 cm across most of a room; one gets past it on level ground at y > 3."""
    return build(Box((2.0, 0.0, 0.0), (4.0, 2.6, 0.3), walkable=True))


def test_a_way_takes_what_its_ground_and_room_ask_for(ledge):
    about = beside(ledge.free_space("human"), 0)
    over = way_takes(np.array([[1.0, 1.0], [5.0, 1.0]]), about).sum(axis=0)
    past = way_takes(np.array([[1.0, 3.3], [5.0, 3.3]]), about).sum(axis=0)
    assert over[LENGTH] == past[LENGTH] == pytest.approx(4.0)
    assert over[STEPPED] == over[LEDGE] == pytest.approx(0.6, abs=0.02)
    assert past[STEPPED] == past[LEDGE] == 0.0
    assert past[SLOPED] < 0.01
    assert over[TIGHT] > 0.9


def test_every_edge_costs_at_least_its_length(ledge):
    for prefer in Prefer:
        ways = ledge.ways("human", prefer)
        graph = ways.graph
        row = np.repeat(np.arange(len(graph.position)), np.diff(graph.first))
        far = np.linalg.norm(graph.position[row] - graph.position[graph.other], axis=1)
        assert (graph.cost >= ways.rate * far - 1e-9).all()  # so the heuristic is admissible
        back = {(a, b): cost for a, b, cost in zip(row, graph.other, graph.cost, strict=True)}
        assert all(back[b, a] == pytest.approx(cost) for (a, b), cost in back.items())


def test_a_person_is_led_past_a_ledge_and_one_in_a_hurry_is_not(ledge):
    ours, fast = (gpdf.plan(ledge, (1.0, 2.2), (5.0, 2.2), prefer=p) for p in (None, "quickest"))
    assert ours.status == fast.status == gpdf.Status.OK
    assert ours.certificate.max_step < 0.03
    assert ours.details["steps"] == 0
    assert ours.trajectory.length < 1.3 * fast.trajectory.length
    able = replace(HUMAN, ledge_time=0.0, climb_time=0.0, comfortable_step=0.37, speed=0.8)
    assert gpdf.plan(ledge, (1.0, 0.3), (5.0, 0.3), able).certificate.max_step == pytest.approx(0.3, abs=0.02)


def test_who_must_take_a_step_takes_it_once(ledge):
    result = gpdf.plan(ledge, (1.0, 3.4), (3.0, 1.0))
    assert result.status is gpdf.Status.OK
    assert result.details["steps"] == 1
    assert result.details["stepped"] == pytest.approx(0.3, abs=0.03)


def test_people_who_stand_in_the_level_way_send_one_over_the_ledge(ledge):
    around = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    column = np.stack(np.meshgrid(around, np.arange(0.1, 1.8, 0.05)), axis=-1).reshape(-1, 2)
    person = np.column_stack([0.2 * np.cos(column[:, 0]), 0.2 * np.sin(column[:, 0]), column[:, 1]])
    for places, steps in ([(3.0, 2.85), (3.0, 3.25), (3.0, 3.65)], 2), ([(5.5, 0.5)], 0):
        points = np.concatenate([person + np.array([*place, 0.0]) for place in places])
        solid = np.append(ledge.ground, np.zeros(len(points), dtype=bool))
        scenes = ledge.with_obstacles(points), gpdf.build_scene(np.concatenate([ledge.points, points]), solid)
        ours, scanned = (gpdf.plan(scene, (1.0, 2.2), (5.0, 2.2)) for scene in scenes)
        assert ours.status is scanned.status is gpdf.Status.OK
        assert ours.details["steps"] == scanned.details["steps"] == steps
        assert ours.details["cost"] == pytest.approx(scanned.details["cost"], rel=0.05)
        far = np.linalg.norm(ours.trajectory.ground[:, None, :2] - points[None, :, :2], axis=-1)
        assert far.min() >= HUMAN.radius


def test_level_goes_round_low_steps_that_are_taken_otherwise():
    scene = build(Box((2.5, 0.0, 0.0), (3.5, 3.0, 0.1), walkable=True))
    start, goal = (1.0, 0.4), (5.0, 0.4)
    ours, level = (gpdf.plan(scene, start, goal, prefer=p) for p in (None, "level"))
    assert ours.details["steps"] == 2
    assert ours.certificate.max_step == pytest.approx(0.1, abs=0.02)
    assert level.details["steps"] == 0
    assert level.trajectory.length > ours.trajectory.length + 2.0


def test_wide_goes_through_the_wide_gap():
    walls = (Box((2.9, 0.0, 0.0), (3.1, 0.6, 2.0)), Box((2.9, 1.3, 0.0), (3.1, 1.8, 2.0)))  # 0.7 m and 2.2 m
    scene = build(*walls)
    ours, wide = (gpdf.plan(scene, (1.0, 0.95), (5.0, 0.95), prefer=p) for p in (None, "wide"))
    assert ours.certificate.min_clearance < 0.15 < 0.3 < wide.certificate.min_clearance


def test_a_body_that_takes_no_steps_has_no_level_ground_of_its_own():
    assert level_body(gpdf.AGENTS["roomba"]) is None
    assert level_body(HUMAN).max_step < HUMAN.comfortable_step


@pytest.mark.parametrize("prefer", list(Prefer))
def test_a_metre_costs_its_time_at_least(prefer):
    price = prices(HUMAN, prefer)
    assert price[LENGTH] == pytest.approx(1.0 / HUMAN.speed)
    assert (price >= 0.0).all()


def test_words_that_are_no_preference_are_refused(ledge):
    with pytest.raises(RequestError, match="quickest, level, wide"):
        gpdf.plan(ledge, (1.0, 1.0), (5.0, 1.0), prefer="scenic")
    with pytest.raises(RequestError, match="alternatives"):
        gpdf.plan(ledge, (1.0, 1.0), (5.0, 1.0), alternatives=-1)
