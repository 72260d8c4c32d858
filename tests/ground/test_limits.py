"""Steps, slopes and limits of the ground: closed forms, and cell by cell as the docstrings say it."""

from itertools import product

import numpy as np
import pytest
from scipy import ndimage

from gpdf_service.ground.foot import sector_of
from gpdf_service.ground.footing import ridges, ridges_reach
from gpdf_service.ground.limits import (
    ObstacleKind,
    _is_narrow_tread,
    find_limits,
    limits_reach,
    median_around,
    neighbourhood,
    step_and_slope,
)
from gpdf_service.tiles.surface import INFERRED, OBSERVED, UNKNOWN, HeightMap

FOOT, LEAST_STEP, STANDABLE, STRIDE, SECTORS = 0.1, 0.01, 0.524, 0.4, 16
FLIGHT_RISE, STAIR_STEP, ROUGH, TREAD_DEPTH, HALF_SOLE, MAX_STEP, SOLE = 0.74, 0.25, 0.075, 0.2, 0.015, 0.37, 0.12
"""What is promised, written down once more."""


def surface_of(height, width, origin=(1.0, -2.0)):
    state = np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8)
    return HeightMap(np.array(origin), width, height.astype(np.float32), state)


def windows(values, reach, rim):
    """Values around each cell, shape (nx, ny, k); beyond the rim mirrored, or a number."""
    known = {"mode": "symmetric"} if rim == "mirrored" else {"constant_values": rim}
    wide = np.pad(values, reach, **known)
    found = np.lib.stride_tricks.sliding_window_view(wide, 2 * [2 * reach + 1])
    return found.reshape(*values.shape, -1)


def medians(values, reach, wanted):
    made = np.full(values.shape, np.nan)
    near = windows(values, reach, "mirrored")
    asked = wanted & ~np.isnan(near).all(axis=-1)
    made[asked] = np.nanmedian(near[asked], axis=-1)
    return made


@pytest.mark.parametrize("reach", [1, 2])
@pytest.mark.parametrize("shape", [(5, 5), (3, 63), (4, 64), (6, 65), (4, 150), (20, 2), (2, 3)])
@pytest.mark.parametrize("unknown", [0.0, 0.03, 0.4, 0.95])
def test_a_median_counts_what_is_known_around_and_mirrors_the_rim(reach, shape, unknown):
    if min(shape) < reach:
        return
    rng = np.random.default_rng(reach)
    values = np.where(rng.random(shape) < unknown, np.nan, rng.normal(size=shape).round(1))
    wanted = rng.random(shape) < 0.8
    np.testing.assert_allclose(median_around(values, reach, wanted), medians(values, reach, wanted), atol=1e-12)


def at(values, x, y):
    """NaN outside the grid."""
    return values[x, y] if 0 <= x < values.shape[0] and 0 <= y < values.shape[1] else np.nan


def narrow(height, width, x, y, axis):
    """Whether a cell is a tread between two risers of a stair, with level ground beyond either."""
    line = [at(height, *((x + k, y) if axis == 0 else (x, y + k))) for k in (-2, -1, 0, 1, 2)]
    if np.isnan(line).any():
        return False
    rises, level = np.diff(line), width * np.tan(STANDABLE)
    up = (rises[1:3] > level).all() or (rises[1:3] < -level).all()
    return bool(up and np.abs(rises[1:3]).max() <= STAIR_STEP + ROUGH and np.abs(rises[[0, 3]]).max() <= level)


def flights(height, width):
    near = windows(height, int(2.0 * STRIDE / width), np.nan)
    return np.fmax.reduce(near, axis=-1) - np.fmin.reduce(near, axis=-1) > FLIGHT_RISE


def rise_of_face(height, slope, level, width, x, y):
    """Of the nearest level cells in each direction, one above and one opposite below, within a stride: least rise."""
    reach, found = STRIDE / width, {}
    for u, v in np.argwhere(level):
        away = (u - x) ** 2 + (v - y) ** 2
        if 0 < away <= reach**2:
            key = int(height[u, v] < height[x, y]), sector_of(int(u - x), int(v - y))
            if key not in found or away < found[key][0]:
                found[key] = away, height[u, v]
    best = np.inf
    for s, t in product(range(SECTORS), repeat=2):
        apart = min((s - t) % SECTORS, (t - s) % SECTORS)
        if apart >= 6 and (0, s) in found and (1, t) in found:
            (far, high), (near, low) = found[0, s], found[1, t]
            if np.sqrt(far) + np.sqrt(near) <= reach:
                best = min(best, high - low)
    return best


def or_nothing(value):
    return 0.0 if np.isnan(value) else value


def measured(surface):
    """Step and slope of every cell, one by one."""
    width, known = surface.cell_width, surface.state != UNKNOWN
    raw = np.where(known, surface.height, np.nan).astype(float)
    reach, cells = max(1, round(FOOT / width)), [(int(x), int(y)) for x, y in np.argwhere(known)]
    smooth, flight = medians(raw, 1, known), 3.0 * width > TREAD_DEPTH and flights(raw, width)
    long2, short2, step = np.zeros(raw.shape), np.zeros(raw.shape), np.zeros(raw.shape)
    for axis in (0, 1):
        rate, rises = np.zeros(raw.shape), {}
        for x, y in cells:
            next_to = [((x + k, y) if axis == 0 else (x, y + k)) for k in (-reach, reach, -1, 1)]
            own = flight is not False and flight[x, y] and narrow(raw, width, x, y, axis)
            rise = 0.0 if own else np.fmin(*(abs(at(smooth, *n) - smooth[x, y]) for n in next_to[:2]))
            short = 0.0 if own else np.fmin(*(abs(at(smooth, *n) - smooth[x, y]) for n in next_to[2:]))
            rate[x, y] = or_nothing(rise / (reach * width))
            long2[x, y] += rate[x, y] ** 2
            short2[x, y] += or_nothing(short / width) ** 2
            before, behind = (at(raw, *n) for n in next_to[2:])
            one = np.fmax(abs(before - raw[x, y]), abs(behind - raw[x, y]))
            rises[x, y] = own, abs(behind - before), one
        usual = medians(rate, 2, known)
        for x, y in cells:
            own, across, one = rises[x, y]
            excess = np.fmax(0.0 if own else across - 2.0 * width * usual[x, y], one - width * usual[x, y])
            step[x, y] = np.fmax(step[x, y], or_nothing(excess))
    slope = np.arctan(np.sqrt(np.minimum(medians(long2, 1, known), medians(short2, 1, known))))
    flat = np.where(known, slope, np.inf) <= STANDABLE
    need = np.clip(int(np.ceil(HALF_SOLE / width**2 - 1e-6)), 3, 6)
    level = flat & (windows(flat, 1, False).sum(axis=-1) >= need)
    for x, y in cells:
        if slope[x, y] > STANDABLE:
            rise = rise_of_face(raw, slope, level, width, x, y)
            if np.isfinite(rise):
                step[x, y], slope[x, y] = max(step[x, y], rise), 0.0
    return np.where(known, step, 0.0), np.where(known, slope, 0.0)


def terrain(kind, width, rng, shape=(20, 17)):
    """A rough piece of ground with some unknown cells."""
    x, y = (np.indices(shape) + 0.5) * width
    turn = rng.uniform(0.0, 2.0 * np.pi)
    along = x * np.cos(turn) + y * np.sin(turn)
    along -= np.median(along)
    height = {
        "slope": along * np.tan(rng.uniform(0.0, 0.8)),
        "step": np.where(along > 0.0, rng.uniform(0.0, 0.5), 0.0),
        "bank": np.clip(along, -0.1, 0.1) * rng.uniform(0.7, 3.0),
        "stair": np.floor(x / max(2 * width, 0.26)) * rng.uniform(0.12, 0.3),
        "narrow": np.floor(y / max(width, 0.2)) * rng.uniform(0.12, 0.33) * (rng.random() < 0.9),
        "worn": np.maximum(0.0, np.clip(np.floor(x / width), 5, 12) - 4) * rng.uniform(0.1, 0.3),
        "rough": rng.normal(0.0, 0.04, shape),
    }[kind]
    height = height + rng.normal(0.0, rng.choice([0.0, 0.002, 0.01]), shape)
    return np.where(rng.random(shape) < rng.choice([0.0, 0.03]), np.nan, height)


@pytest.mark.parametrize("width", [0.04, 0.0545, 0.08, 0.15])
@pytest.mark.parametrize("kind", ["slope", "step", "bank", "stair", "narrow", "worn", "rough"])
@pytest.mark.parametrize("seed", range(3))
def test_steps_and_slopes_of_rough_ground_are_those_of_each_cell_by_itself(kind, width, seed):
    rng = np.random.default_rng([seed, int(100 * width), len(kind)])
    surface = surface_of(terrain(kind, width, rng), width)
    with np.errstate(invalid="ignore"):
        step, slope = step_and_slope(surface)
        expected = measured(surface)
    np.testing.assert_allclose(step, expected[0], atol=1e-5)
    np.testing.assert_allclose(slope, expected[1], atol=1e-4)


@pytest.mark.parametrize("width", [0.05, 0.1])
@pytest.mark.parametrize("angle", [0.0, 0.1, 0.4, 0.9])
@pytest.mark.parametrize("turn", [0.0, 0.3, 0.7854, 1.5708])
def test_a_plane_has_its_slope_and_no_step(width, angle, turn):
    x, y = (np.indices((24, 24)) + 0.5) * width
    surface = surface_of(np.tan(angle) * (x * np.cos(turn) + y * np.sin(turn)), width)
    step, slope = (values[3:-3, 3:-3] for values in step_and_slope(surface))
    np.testing.assert_allclose(slope, angle, atol=1e-3)
    assert step.max() < 1e-3


@pytest.mark.parametrize("width", [0.05, 0.1])
@pytest.mark.parametrize("rise", [0.02, 0.15, 0.4])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_step_has_its_height_on_both_sides_and_is_no_slope(width, rise, axis):
    cell = np.indices((24, 24))[axis]
    step, slope = step_and_slope(surface_of(np.where(cell < 12, 0.0, rise), width))
    np.testing.assert_allclose(step[(cell == 11) | (cell == 12)], rise, atol=1e-6)
    assert step[(cell < 11) | (cell > 12)].max() == 0.0
    assert slope.max() == 0.0


@pytest.mark.parametrize("rise", [0.3, 0.45])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_short_bank_between_two_footholds_is_a_step_as_high_as_it_and_a_long_one_is_steep(rise, axis):
    cell = np.indices((40, 40))[axis]
    short = surface_of(np.clip((cell - 18) / 3.0, 0.0, 1.0) * rise, 0.05)
    step, slope = step_and_slope(short)
    assert slope.max() < STANDABLE
    assert step.max() == pytest.approx(rise, abs=1e-6)
    long = surface_of(np.clip((cell - 10) / 20.0, 0.0, 1.0), 0.05)
    assert step_and_slope(long)[1][18:22, 18:22].min() == pytest.approx(np.pi / 4, abs=0.01)


@pytest.mark.parametrize("seed", range(8))
def test_limits_are_steps_slopes_ridges_and_the_edge_of_what_is_known_where_no_material_is(seed):
    rng = np.random.default_rng(seed)
    shape, width = (14, 11), 0.1
    height = np.where(rng.random(shape) < 0.4, np.nan, rng.uniform(0.0, 0.5, shape)).astype(np.float32)
    surface, material = surface_of(height, width), rng.random(shape) < 0.3
    step = np.where(np.isnan(height), 0.0, rng.choice([0.0, 0.0099, 0.0101, 0.3], shape))
    slope = np.where(np.isnan(height), 0.0, rng.choice([0.0, 1e-6, 0.3], shape))
    ridge = ~np.isnan(height) & (rng.random(shape) < 0.1)
    found = find_limits(surface, material, (step, slope), ridge, np.ones_like(ridge))
    expected = []
    for x, y in np.ndindex(shape):
        place = surface.origin + (np.array([x, y]) + 0.5) * width
        if not np.isnan(height[x, y]):
            if step[x, y] > LEAST_STEP:
                expected.append((*place, height[x, y], ObstacleKind.STEP, step[x, y]))
            if slope[x, y] > 0.0:
                expected.append((*place, height[x, y], ObstacleKind.SLOPE, slope[x, y]))
            if ridge[x, y]:
                expected.append((*place, height[x, y], ObstacleKind.MATERIAL, np.inf))
        elif not material[x, y] and not np.isnan(near := windows(height, 1, np.nan)[x, y]).all():
            expected.append((*place, np.nanmax(near), ObstacleKind.UNKNOWN, np.inf))
    rows = np.column_stack([found.points, found.kind, found.value])
    assert found.kind.dtype == np.uint8
    np.testing.assert_allclose(sorted(rows.tolist()), sorted(expected), atol=1e-6)


def test_inferred_ground_is_known():
    cell, none = np.indices((16, 16))[0], np.zeros((16, 16), dtype=bool)
    surface = surface_of(np.where(cell < 8, 0.0, 0.2), 0.1)
    surface.state[7] = INFERRED
    found = find_limits(surface, none, step_and_slope(surface), none, ~none)
    assert set(found.kind.tolist()) == {int(ObstacleKind.STEP)}
    assert len(found.points) == 2 * 16
    np.testing.assert_allclose(found.value, 0.2, atol=1e-6)


def test_heights_of_the_neighbours_are_unknown_beyond_the_rim():
    height = np.random.default_rng(0).normal(size=(5, 4))
    height[2, 2] = np.nan
    found = neighbourhood(surface_of(height, 0.1))
    for row, (i, j) in enumerate(product((-1, 0, 1), repeat=2)):
        expected = [[at(height, x - i, y - j) for y in range(4)] for x in range(5)]
        np.testing.assert_allclose(found[row], expected, atol=1e-6)


@pytest.mark.parametrize(("width", "reach"), [(0.05, 2 + 6 + 8), (0.1, 1 + 6 + 12), (0.3, 1 + 6 + 4)])
def test_what_lies_further_than_the_reach_changes_nothing(width, reach):
    """A foot's length, three medians and a stride, or three in cells that a tread may show in one of."""
    assert limits_reach(surface_of(np.zeros((2, 2)), width)) == reach
    rng = np.random.default_rng(3)
    height = terrain("bank", width, rng, (2 * reach + 9, 12))
    other = height.copy()
    other[: reach + 1] += rng.normal(0.0, 0.3, other[: reach + 1].shape)
    for one, two in zip(
        step_and_slope(surface_of(height, width)), step_and_slope(surface_of(other, width)), strict=True
    ):
        np.testing.assert_array_equal(one[2 * reach + 2 :], two[2 * reach + 2 :])


def ridges_of(height, width, pits=None, drops=False):
    """Ridges of ground that was seen as high as `pits` before it was bridged, and ends at `drops`."""
    surface = surface_of(height, width)
    pits = surface.height if pits is None else pits.astype(np.float32)
    return ridges(surface, MAX_STEP, pits, np.isnan(height) & drops)


def a_flight(width, turn, stringer, rise=0.17, run=0.27):
    """Heights of a flight up from a floor, 0.9 m wide, with or without a board of 0.12 m along one side of it.

    Also which cells are of the board's place, and how far inside the flight's sides each cell is [m].
    """
    x, y = (np.indices((64, 64)) - 32) * width
    along, aside = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    tread = np.clip(np.ceil(along / run), 0, 4)
    board = (np.abs(aside - 0.45) <= 0.6 * width) & (tread > 0)
    height = np.where((np.abs(aside) <= 0.45) & (tread > 0), tread * rise, 0.0)
    return np.where(board & stringer, tread * rise + 0.12, height), board, 0.45 - np.abs(aside)


@pytest.mark.parametrize("width", [0.04, 0.05, 0.06])
@pytest.mark.parametrize("turn", [0.0, 0.4, 0.7854, 1.2])
def test_a_board_along_a_flight_is_a_ridge_from_the_first_tread_on(width, turn):
    height, board, inside = a_flight(width, turn, stringer=True)
    found = ridges_of(height, width)
    assert found[board].mean() > 0.9
    assert not found[inside > SOLE + width].any()


@pytest.mark.parametrize("width", [0.04, 0.05, 0.06])
@pytest.mark.parametrize("turn", [0.0, 0.4, 0.7854, 1.2])
@pytest.mark.parametrize(
    ("beyond", "least"), [("a flight", 0.8), ("a bridged gap", 0.8), ("a room", 0.4), ("nothing", 0.0)]
)
def test_a_board_is_a_ridge_whatever_is_beyond_a_gap_unless_nothing_was_seen_there(width, turn, beyond, least):
    height, board, inside = a_flight(width, turn, stringer=True)
    gap, other = (inside < -0.6 * width) & (inside > -2.6 * width), inside <= -2.6 * width
    board &= height > 0.3  # from the second tread on: under the first one is no step's depth
    pits = np.where(other, height + 1.4, height)
    if beyond == "a bridged gap":
        height = np.where(gap, ndimage.grey_closing(height, (7, 7)), height)
    elif beyond in ("a room", "nothing"):
        pits = np.where(gap | other, np.nan, height)
    height = np.where(gap & ~np.isnan(pits), height, pits)
    found = ridges_of(height, width, pits, drops=beyond == "a room")
    assert found[board].mean() > least if least else not found[board].any()
    assert not found[inside > SOLE + width].any()


@pytest.mark.parametrize("turn", [0.0, 0.2, 0.3, 0.4, 0.7854, 1.2])
def test_a_nose_behind_which_a_room_was_seen_is_no_ridge(turn):
    width, run = 0.05, 0.27
    height, _, inside = a_flight(width, turn, stringer=False)
    x, y = (np.indices(height.shape) - 32) * width
    along = x * np.cos(turn) + y * np.sin(turn)
    seen = (along <= 2.0 * run + 1.5 * width) & (inside > -0.01)
    assert not ridges_of(np.where(seen, height, np.nan), width, drops=True)[inside > SOLE + width].any()


@pytest.mark.parametrize("width", [0.04, 0.05, 0.06])
@pytest.mark.parametrize("turn", [0.0, 0.4, 0.7854, 1.2])
def test_treads_are_no_ridges_but_for_their_tips_at_a_free_side(width, turn):
    height, _, inside = a_flight(width, turn, stringer=False)
    found = ridges_of(height, width)
    assert not found[inside > SOLE + width].any()
    assert found.mean() < 0.01


def test_a_nose_before_a_dip_is_no_ridge():
    steps = np.repeat(0.17 * np.arange(8), 5)
    steps[12:14] -= 0.15
    assert not ridges_of(np.tile(steps[:, None], (1, 20)), 0.05)[:, 6:-6].any()  # but at the rim


def test_a_sill_on_a_floor_is_no_ridge():
    cell = np.indices((30, 30))[0]
    assert not ridges_of(np.where(cell == 15, 0.15, 0.0), 0.05).any()


@pytest.mark.parametrize("width", [0.04, 0.05, 0.1])
@pytest.mark.parametrize("broken", [0.0, 0.2])
def test_boards_further_than_the_reach_from_a_rise_are_no_ridges_of_its_flight(width, broken):
    reach = ridges_reach(surface_of(np.zeros((2, 2)), width))
    height = np.where(np.indices((12 + 2 * reach, 40))[1] % 9 == 4, 0.12, 0.0)
    height[np.random.default_rng(0).random(height.shape) < broken] = 0.0
    beside = height.copy()
    beside[:12] += 1.0
    off, on = (ridges_of(each, width) for each in (height, beside))
    rows = np.flatnonzero((off != on).any(axis=1))
    assert 12 + reach // 2 < rows.max() < 12 + reach


@pytest.mark.parametrize("axis", [0, 1])
def test_a_narrow_tread_is_one_cell_between_two_risers_with_level_ground_beyond(axis):
    width, rng = 0.12, np.random.default_rng(3)
    flat, riser = width * np.tan(STANDABLE), STAIR_STEP + ROUGH
    rises = [0.0, 0.5 * flat, -0.5 * flat, 0.17, -0.17, 1.2 * riser]
    height = np.cumsum(rng.choice(rises, (400, 12), p=[0.2, 0.15, 0.1, 0.3, 0.2, 0.05]), axis=1)
    height = np.where(rng.random(height.shape) < 0.03, np.nan, height).astype(np.float32)
    want = np.zeros(height.shape, dtype=bool)
    for row, i in product(range(400), range(2, 10)):
        below2, below, here, above, above2 = (float(height[row, k]) for k in range(i - 2, i + 3))
        up, down = above - here, here - below
        climbs = min(up, down) > flat or max(up, down) < -flat
        level = abs(above2 - above) <= flat and abs(below - below2) <= flat
        want[row, i] = climbs and abs(up) <= riser and abs(down) <= riser and level
    assert 20 < want.sum() < 2000
    turned = height if axis == 1 else height.T
    found = _is_narrow_tread(turned, width, axis)
    np.testing.assert_array_equal(found if axis == 1 else found.T, want)


def test_kinds_have_the_numbers_that_scene_files_hold():
    numbers = {"MATERIAL": 0, "STEP": 1, "SLOPE": 2, "UNKNOWN": 3}
    assert {kind.name: kind.value for kind in ObstacleKind} == numbers


@pytest.mark.parametrize(("what", "value"), [("step", 0.2), ("slope", 0.7), ("edge", np.inf), ("ridge", np.inf)])
def test_one_limit_alone_stands_over_the_middle_of_its_cell(what, value):
    surface = surface_of(np.array([[0.3, np.nan if what == "edge" else 0.3]]), 0.1)
    of_one = {name: np.array([[name == what, False]]) for name in ("step", "slope", "ridge")}
    measured = 0.2 * of_one["step"], 0.7 * of_one["slope"]
    found = find_limits(surface, np.zeros((1, 2), bool), measured, of_one["ridge"], np.ones((1, 2), bool))
    at = 0.15 if what == "edge" else 0.05
    np.testing.assert_allclose(found.points, [[1.05, -2.0 + at, 0.3]], atol=1e-6)
    np.testing.assert_allclose(found.value, [value])
    kinds = {"step": ObstacleKind.STEP, "slope": ObstacleKind.SLOPE, "edge": ObstacleKind.UNKNOWN}
    assert found.kind.tolist() == [kinds.get(what, ObstacleKind.MATERIAL)]
