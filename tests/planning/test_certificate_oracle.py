"""Certificates of random ways over random ground, against what every cell and every point on the way says."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.fields.tree import build_tree
from gpdf_service.planning.certificate import certify
from gpdf_service.planning.footprint import disc_places
from gpdf_service.planning.shape import runs
from gpdf_service.search.places import Places
from gpdf_service.tiles.surface import OBSERVED, UNKNOWN, HeightMap
from gpdf_service.types import AGENTS

SAMPLE, CELL_SHARE, BETWEEN_HEIGHTS = 0.01, 0.2, 0.03
"""[m], [-] and [m] What is promised, written down once more."""
FAR = np.array([[100.0, 100.0]])
FLAT = 2e-3
"""[m] By which the field of a level floor is off over it."""


@pytest.fixture(scope="module")
def floor():
    """A level floor of 8 x 8 m around (0, 0)."""
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.arange(-4.0, 4.0, 0.05)]))
    return gpdf.build_scene(np.column_stack([x, y, np.zeros(x.size)]), np.ones(x.size, dtype=bool))


def space_of(floor, agent, surface=None, steps=None, slopes=None, obstacles=FAR):
    """The body's free space with this ground and these obstacles in place of its own."""
    space = floor.free_space(agent)
    surface = surface or space.levels[0].surface
    zero = np.zeros(surface.state.shape)
    level = dataclasses.replace(
        space.levels[0],
        surface=surface,
        steps=zero if steps is None else steps,
        slopes=zero if slopes is None else slopes,
        places=Places(build_tree(obstacles)),
    )
    return dataclasses.replace(space, levels=(level,))


def certificate_of(space, path, top=0.0, heading=None):
    """Of a way over places (n, 2 or 3) whose tops are so much off their height."""
    contact = np.column_stack([path[:, :2], path[:, 2] if path.shape[1] == 3 else np.zeros(len(path))])
    tops = contact.copy()
    tops[:, 2] += space.agent.height + top
    return certify(space, tops, contact, np.zeros(len(path), dtype=np.int64), heading)


def lengths_in_cells(path, surface):
    """The longest piece of a way in each cell that it touches [m], as a dictionary; its ends count as long."""
    found = {}
    for a, b in pairwise(path):
        lines = [0.0, 1.0]
        for k in (0, 1):
            ends = sorted(
                ((a[k] - surface.origin[k]) / surface.cell_width, (b[k] - surface.origin[k]) / surface.cell_width)
            )
            cross = np.arange(np.ceil(ends[0]), np.floor(ends[1]) + 1.0) * surface.cell_width + surface.origin[k]
            lines += ((cross - a[k]) / (b[k] - a[k])).tolist()
        lines = sorted(share for share in lines if 0.0 <= share <= 1.0)
        for low, high in pairwise(lines):
            middle = a + 0.5 * (low + high) * (b - a)
            cell = tuple(np.floor((middle - surface.origin) / surface.cell_width).astype(int).tolist())
            found[cell] = max(found.get(cell, 0.0), (high - low) * np.linalg.norm(b - a))
    for place in path:
        found[tuple(np.floor((place - surface.origin) / surface.cell_width).astype(int).tolist())] = np.inf
    return found


@pytest.mark.parametrize("seed", range(60))
def test_every_cell_on_the_way_counts_and_no_other(floor, seed):
    rng = np.random.default_rng(seed)
    width, shape = rng.choice([0.02, 0.05, 0.11, 0.3]), rng.integers(6, 20, 2)
    state = np.where(rng.random(shape) < rng.choice([0.0, 0.01, 0.1]), UNKNOWN, OBSERVED).astype(np.uint8)
    state[-1, -1] = OBSERVED  # what lies outside must not be taken for the last cell
    surface = HeightMap(rng.uniform(-1.0, 0.0, 2), width, np.zeros(shape, np.float32), state)
    steps, slopes = rng.uniform(0.0, 1.0, shape), rng.uniform(0.0, 1.0, shape)
    beyond = rng.choice([0.0, 0.0, 0.2])
    path = surface.origin + rng.uniform(-beyond, 1.0 + beyond, (rng.integers(2, 6), 2)) * shape * width
    body = dataclasses.replace(AGENTS["roomba"], max_step=10.0, max_slope=1.5)
    found = certificate_of(space_of(floor, body, surface, steps, slopes), path)
    known, sample = {}, max(SAMPLE, CELL_SHARE * width)
    for cell, length in lengths_in_cells(path, surface).items():
        inside = all(0 <= c < n for c, n in zip(cell, shape, strict=True))
        known[cell] = (bool(inside and state[cell] == OBSERVED), length >= sample)
    sure, may = ([c for c, (_, long) in known.items() if long or not asked] for asked in (True, False))
    for measure, value in ((found.max_step, steps), (found.max_slope, slopes)):
        least, most = (max((value[c] for c in cells if known[c][0]), default=0.0) for cells in (sure, may))
        assert least <= measure <= most
    if not all(known[c][0] for c in sure):
        assert found.reason == "the path leaves the known ground"
    elif all(known[c][0] for c in may):
        assert (found.reason, found.holds) == ("", True)


@pytest.mark.parametrize("seed", range(40))
def test_the_height_of_the_top_is_known_to_what_it_changes_in_three_centimetres(floor, seed):
    rng = np.random.default_rng(seed)
    space = space_of(floor, AGENTS["human"])
    path = np.cumsum(rng.uniform(0.0, rng.choice([0.05, 0.4]), (9, 2)), axis=0) - 1.5
    off = rng.uniform(-0.12, 0.12, 9)
    found = certificate_of(space, path, off)
    length = np.linalg.norm(np.diff(path, axis=0), axis=1)
    steepest = min((np.abs(np.diff(off)) / length).max() * BETWEEN_HEIGHTS, np.ptp(off))
    worst = max(np.abs(off[[0, -1]]).max(), np.abs(off).max() - steepest)
    assert worst - 0.01 * worst - FLAT <= found.max_height_deviation <= np.abs(off).max() + 1e-9
    at = np.linalg.norm(path - found.max_height_deviation_at[:2], axis=1).argsort()[:2]
    assert np.abs(off[at]).max() >= found.max_height_deviation - 1e-6
    dense = np.linspace(0.0, 1.0, 200)[:, None]
    line = np.concatenate([a + dense * (b - a) for a, b in pairwise(np.column_stack([path, off]))])
    near = np.linalg.norm(line[:, :2] - found.max_height_deviation_at[:2], axis=1)
    assert np.abs(line[near < 0.01, 2]).max() >= found.max_height_deviation - FLAT


def test_a_contact_that_is_off_the_known_ground_is_forgiven_where_the_top_is_at_its_height_and_only_there(floor):
    body = AGENTS["human"]
    space = space_of(floor, body)
    path = np.column_stack([np.linspace(-1.0, 1.0, 5), np.zeros(5), np.full(5, -0.3)])
    assert certificate_of(space, path, 0.3).max_height_deviation < FLAT
    surface = space.levels[0].surface
    hole = HeightMap(surface.origin, surface.cell_width, surface.height, np.zeros_like(surface.state))
    found = certificate_of(space_of(floor, body, hole), path, 0.3)
    assert found.max_height_deviation == pytest.approx(0.3)
    assert found.reason == "the path leaves the known ground"


def test_where_a_way_stands_on_one_place_that_is_looked_at(floor):
    path = np.zeros((2, 2))
    found = certificate_of(space_of(floor, AGENTS["human"]), path, 0.1)
    assert found.max_height_deviation == pytest.approx(0.1, abs=FLAT)
    assert found.holds


@pytest.mark.parametrize("where", [np.nan, np.inf])
def test_what_is_no_place_is_no_known_ground(floor, where):
    path = np.array([[0.0, 0.0], [0.1, 0.0], [where, 0.0]])
    found = certificate_of(space_of(floor, AGENTS["human"]), path)
    assert not found.holds


@pytest.mark.parametrize("seed", range(30))
def test_room_is_that_of_the_nearest_point_to_the_way_and_so_is_the_place(floor, seed):
    rng = np.random.default_rng(seed)
    path, points = rng.uniform(-1.5, 1.5, (rng.integers(2, 9), 2)), rng.uniform(-3.0, 3.0, (rng.integers(1, 40), 2))
    found = certificate_of(space := space_of(floor, AGENTS["human"], obstacles=points), path)
    share = np.linspace(0.0, 1.0, 3001)[:, None]
    line = np.concatenate([a + share * (b - a) for a, b in pairwise(path)])
    away = np.linalg.norm(line[:, None] - points, axis=2).min(axis=1)
    assert found.min_clearance == pytest.approx(away.min() - space.reach, abs=2e-3)
    assert found.min_clearance <= away.min() - space.reach + 1e-9
    at = np.linalg.norm(points - found.min_clearance_at[:2], axis=1).min()
    assert at - space.reach == pytest.approx(found.min_clearance, abs=2e-3)
    assert found.holds == (found.min_clearance >= 0.0)
    if not found.holds:
        assert f"touch an obstacle: {-1000 * found.min_clearance:.0f} mm too little room" in found.reason


@pytest.mark.parametrize("discs", [1, 6])
@pytest.mark.parametrize(("spare", "holds"), [(5e-4, True), (5e-5, True), (-5e-5, False), (-5e-4, False)])
def test_half_a_millimetre_decides(floor, discs, spare, holds):
    """Straight past a point: every disc goes by it at the same distance."""
    body = dataclasses.replace(AGENTS["spot"], discs=discs)
    space = space_of(floor, body)
    space = space_of(floor, body, obstacles=np.array([[0.0, space.reach + spare]]))
    path = np.column_stack([np.linspace(-1.0, 1.0, 41), np.zeros(41)])
    found = certificate_of(space, path)
    assert found.holds == holds
    assert found.min_clearance <= spare + 1e-12
    if holds:
        assert found.min_clearance == pytest.approx(spare, abs=2e-5 if discs > 1 else 1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_room_of_a_body_of_discs_is_that_of_all_its_discs_as_it_turns(floor, seed):
    rng = np.random.default_rng(seed)
    body = dataclasses.replace(AGENTS["spot"], discs=6)
    path, heading = rng.uniform(-1.5, 1.5, (3, 2)), np.cumsum(rng.uniform(-1.5, 1.5, 3))
    points = rng.uniform(-3.0, 3.0, (5, 2))
    space = space_of(floor, body, obstacles=points)
    found = certificate_of(space, path, heading=heading)
    t = np.linspace(0.0, 2.0, 4001)
    poses = np.column_stack([np.interp(t, range(3), column) for column in (*path.T, heading)])
    discs = np.concatenate([disc_places(poses, offset) for offset in body.offsets])
    least = np.linalg.norm(discs[:, None] - points, axis=2).min()
    assert least - space.reach - 4e-3 <= found.min_clearance <= least - space.reach + 1e-9


@pytest.mark.parametrize("ahead", [True, False])
def test_ground_under_a_disc_that_is_turned_to_it_must_be_known(floor, ahead):
    """Before a hole: the body faces it with its front, or with its back, or goes along it."""
    body = dataclasses.replace(AGENTS["spot"], discs=6)
    base = floor.free_space(body).levels[0].surface
    x, _ = np.indices(base.state.shape)
    hole = base.origin[0] + (x + 0.5) * base.cell_width > 0.0
    for side in (hole, ~hole) if ahead else (hole,):
        state = np.where(side, UNKNOWN, OBSERVED).astype(np.uint8)
        space = space_of(floor, body, HeightMap(base.origin, base.cell_width, base.height, state))
        place = 0.5 * body.offsets[-1] * (-1.0 if side is hole else 1.0)
        path = np.array([[place, -0.1], [place, 0.1]])
        faced = certificate_of(space, path, heading=np.full(2, 0.0 if ahead else np.pi / 2))
        assert faced.holds != ahead


@pytest.mark.parametrize("seed", range(20))
def test_a_way_is_cut_where_its_level_changes_and_pieces_meet_in_a_waypoint(seed):
    rng = np.random.default_rng(seed)
    level = np.repeat(rng.integers(0, 3, 6), rng.integers(1, 5, 6))
    pieces = runs(level)
    segments = [i for part, _ in pieces for i in range(part.start, min(part.stop, len(level)) - 1)]
    assert set(segments) == set(range(len(level) - 1))
    for part, on in pieces:
        own = level[part]
        assert len(own) > 1
        assert set(own[1:].tolist()) == {on} or own[0] == on
    for on in set(level.tolist()):
        mine = {i for part, at in pieces if at == on for i in range(part.start, part.stop)}
        assert set(np.flatnonzero(level == on).tolist()) <= mine


def test_reasons_come_in_the_order_of_what_hurts_most(floor):
    """Everything is wrong at once; what is mended, one after another, leaves the next reason."""
    base = floor.free_space("human").levels[0].surface
    one, path = np.ones(base.state.shape), np.column_stack([np.linspace(-1.0, 1.0, 9), np.zeros(9)])
    nowhere = HeightMap(base.origin, base.cell_width, base.height, np.zeros_like(base.state))
    at_all = np.zeros((1, 2))
    parts = [
        ((nowhere, one, one, at_all), "touch an obstacle"),
        ((nowhere, one, one), "leaves the known ground"),
        ((base, one, one), "a step of 1.00 m"),
        ((base, 0.3 * one, one), "a slope of 57°"),
        ((base, 0.3 * one, 0.4 * one), ""),
    ]
    for own, reason in parts:
        found = certificate_of(space_of(floor, AGENTS["human"], *own), path)
        assert (found.holds, reason in found.reason) == (reason == "", True)
        assert (found.reason == "") == (reason == "")


@pytest.mark.parametrize(("step", "holds"), [(0.0099, True), (0.0101, False)])
def test_who_takes_no_step_goes_over_what_is_none(floor, step, holds):
    body = dataclasses.replace(AGENTS["human"], max_step=0.0)
    base = floor.free_space(body).levels[0].surface
    path = np.column_stack([np.linspace(-1.0, 1.0, 9), np.zeros(9)])
    found = certificate_of(space_of(floor, body, base, np.full(base.state.shape, step)), path)
    assert found.holds == holds


def test_on_a_ramp_the_top_is_where_the_contact_is_all_along(floor):
    """A top that is its height away from the ramp stands higher over its contact than that."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-4.0, 4.0, 0.05), np.arange(-1.5, 1.5, 0.05)))
    up = np.tan(0.35) * np.array([0.8, 0.6])
    ramp = gpdf.build_scene(np.column_stack([x, y, np.column_stack([x, y]) @ up]), np.ones(x.size, dtype=bool))
    plan = np.column_stack([np.linspace(-1.5, 1.5, 4), np.linspace(-0.5, 0.5, 4)])
    path = np.column_stack([plan, plan @ up])
    space = ramp.free_space("human")
    level = dataclasses.replace(space.levels[0], places=Places(build_tree(FAR)))
    space = dataclasses.replace(space, levels=(level,))
    high = space.agent.height / np.cos(0.35) - space.agent.height
    assert high > 0.1
    found = certificate_of(space, path, high)
    assert found.max_height_deviation < 0.01
    assert found.max_slope == pytest.approx(0.35, abs=0.01)


@pytest.mark.parametrize("bad", [0, 1])
def test_what_is_wrong_on_one_level_is_wrong_of_the_whole_way(floor, bad):
    """Two levels that are alike, of which one has a hole, a step, a slope, a low obstacle under the way."""
    space, path = floor.free_space("human"), np.column_stack([np.linspace(-1.0, 1.0, 9), np.zeros((9, 2))])
    level = np.repeat([0, 1], [5, 4])
    base, zero = space.levels[0].surface, np.zeros(space.levels[0].surface.state.shape)
    nowhere = HeightMap(base.origin, base.cell_width, base.height, np.zeros_like(base.state))
    good = dataclasses.replace(space.levels[0], steps=zero, slopes=zero, places=Places(build_tree(FAR)))
    wrong = {
        "surface": nowhere,
        "steps": zero + 0.9,
        "slopes": zero + 0.9,
        "places": Places(build_tree(np.zeros((1, 2)))),
    }
    reasons = {"surface": "known ground", "steps": "step of 0.90", "slopes": "slope of 52°", "places": "an obstacle"}
    top = path + np.array([0.0, 0.0, space.agent.height])
    for name, reason in reasons.items():
        levels = [good, good]
        levels[bad] = dataclasses.replace(good, **{name: wrong[name]})
        found = certify(dataclasses.replace(space, levels=tuple(levels)), top, path, level)
        assert reason in found.reason, (name, found.reason)
        assert not found.holds
    off = np.where(level == bad, 0.1, 0.0)[:, None] * np.array([0.0, 0.0, 1.0])
    found = certify(dataclasses.replace(space, levels=(good, good)), top + off, path, level)
    assert found.max_height_deviation == pytest.approx(0.1, abs=FLAT)
    assert found.ground_spacing == pytest.approx(base.cell_width)
