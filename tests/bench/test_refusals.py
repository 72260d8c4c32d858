"""`gpdf bench refusals`: that it asks for what is refused, and tries what a refusal names."""

import dataclasses
import json
import math

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.refusals import measure_deadline, measure_refusals, named_bodies, random_queries, rows_of, tries
from gpdf_service.cli import main
from gpdf_service.synthetic import Box, World
from gpdf_service.types import AGENTS, PlanResult, Status

GAP = 0.45
HUMAN = AGENTS["human"]
PLACES = np.array([1.0, 2.0, 0.0]), np.array([5.0, 2.0, 0.0])


@pytest.fixture(scope="module")
def narrow():
    walls = Box((3.0, 0.0, 0.0), (3.2, 2.0 - GAP / 2, 2.6)), Box((3.0, 2.0 + GAP / 2, 0.0), (3.2, 4.0, 2.6))
    points, ground = World((6.0, 4.0, 2.6), walls).sample(0.02, np.random.default_rng(0))
    return gpdf.build_scene(points, ground)


def no_path(message="it is so", **details):
    return PlanResult(Status.NO_VALID_PATH, message, details=details)


@pytest.mark.parametrize(("short", "helps"), [(HUMAN.width - GAP + 0.05, True), (HUMAN.width - GAP - 0.02, False)])
def test_the_body_that_a_narrow_door_is_said_to_let_pass_is_tried(narrow, short, helps):
    refused = gpdf.plan(narrow, *PLACES, HUMAN)
    assert refused.status is Status.NO_VALID_PATH
    said = dataclasses.replace(refused, details={"short_width": short})
    assert tries(narrow, HUMAN, *PLACES, said) == [helps]


def test_a_nearest_free_place_helps_if_it_is_one(narrow):
    wall = np.array([2.95, 1.0, 0.0])
    refused = gpdf.plan(narrow, PLACES[0], wall, HUMAN)
    assert refused.status is Status.GOAL_OCCUPIED
    assert tries(narrow, HUMAN, PLACES[0], wall, refused) == [True]
    said = dataclasses.replace(refused, details={f"nearest_{axis}": v for axis, v in zip("xyz", wall, strict=True)})
    assert tries(narrow, HUMAN, PLACES[0], wall, said) == [False]


def test_each_limit_names_a_body_and_limits_that_go_together_name_one():
    apart = named_bodies(HUMAN, no_path(short_width=0.1, short_height=0.3))
    assert [(body.width, body.height) for body in apart] == [
        (pytest.approx(HUMAN.width - 0.1, abs=1e-5), HUMAN.height),
        (HUMAN.width, pytest.approx(HUMAN.height - 0.3, abs=1e-5)),
    ]
    (joint,) = named_bodies(HUMAN, no_path("a; and b", short_step=0.2, short_slope=math.radians(5)))
    assert joint.max_step == pytest.approx(HUMAN.max_step + 0.2, abs=1e-5)
    assert joint.max_slope == pytest.approx(HUMAN.max_slope + math.radians(5), abs=1e-5)
    assert named_bodies(HUMAN, no_path("a; and b", short_step=0.2, short_unknown=0.0)) == []


def test_queries_are_on_ground_and_some_where_the_body_does_not_stand(narrow):
    pairs = random_queries(narrow, HUMAN, 50, np.random.default_rng(0))
    assert pairs.shape == (50, 2, 3)
    found = {gpdf.plan(narrow, *pair, HUMAN).status for pair in pairs}
    assert {Status.OK, Status.NO_VALID_PATH, Status.START_OCCUPIED, Status.GOAL_OCCUPIED} <= found


def test_every_refusal_is_counted_once_and_every_answer_to_a_deadline(narrow):
    pairs = random_queries(narrow, HUMAN, 20, np.random.default_rng(1))
    refused = sum(gpdf.plan(narrow, *pair, HUMAN).status is not Status.OK for pair in pairs)
    rows = rows_of(measure_refusals(narrow, HUMAN, pairs, tried=0))
    assert sum(row["refused"] for row in rows) == refused
    assert all(row["tried"] == 0 for row in rows)
    row = measure_deadline(narrow, HUMAN, pairs, 1e-9)
    assert (row["ok"], row["queries"]) == (0, 20)
    assert row["timeout"] + row["refused"] == 20
    assert row["late"] == 20


def test_the_verb_prints_a_row_for_each_status_and_for_each_deadline(capsys):
    words = ["bench", "refusals", "--scene", "office", "--agent", "roomba", "--count", "20", "--json"]
    assert main([*words, "--tried", "1"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert rows
    assert {"scene", "agent", "status", "refused", "p99_ms", "tried", "helped"} <= rows[0].keys()
    assert [row["refused"] for row in rows if row["scene"] == "all"] == [
        row["refused"] for row in rows[: len(rows) // 2]
    ]
    assert main([*words, "--deadlines", "0.02", "0.1"]) == 0
    assert [row["deadline_ms"] for row in json.loads(capsys.readouterr().out)] == [20.0, 100.0]
