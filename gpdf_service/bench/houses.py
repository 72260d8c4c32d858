"""Ray-cast houses of two storeys: does a human's plan go up and down, and is it right?"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import TypedDict, Unpack

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.bench.exact import ON, STEP, Truth, count_touching, every, judge_path
from gpdf_service.bench.report import Row, each
from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import GpdfError
from gpdf_service.pipeline import build_scene, plan
from gpdf_service.scene import Scene
from gpdf_service.synthetic.faults import FAULTS
from gpdf_service.synthetic.houses import house
from gpdf_service.synthetic.place import Place
from gpdf_service.synthetic.scanners import NOISE, SCANNERS, Scan
from gpdf_service.synthetic.stairs import STAIRS
from gpdf_service.tiles.surface import INFERRED, UNKNOWN
from gpdf_service.types import AGENTS, Agent, BoolArray, FloatArray, PlanResult, Status, Trajectory

COUNT = {"tripod": 21, "handheld": 28, "depth": 0, "profile": 0}
"""Houses that are scanned in each way, where nothing else is asked for."""
THIN = 0.03
"""[m] Scans are thinned to one point of such a voxel, as they are handed on in practice."""
TOE = 0.3
"""[m] Over an inferred cell, from where the true ground under it is looked for: more than any riser."""
ASIDE = np.arange(-6, 7) * 0.05
"""[m] To the side of the way that a house says: other ways over its treads, as far as half of a stair is wide."""
FREE = 2000
"""Random free places of each house that are held against the exact one."""
KINDS = tuple(STAIRS)


def scanned_house(
    seed: int,
    scanner: str,
    noise: float | None = None,
    thin: float = THIN,
    fault: str | None = None,
    *,
    centres: bool = False,
) -> tuple[Place, Scan]:
    """A house and its scan; the kind of its stair goes round with the seed.

    Args:
        seed: Of house and scan.
        scanner: One of `SCANNERS`.
        noise: Along the ray [m]; the scanner's own where it is None.
        thin: Width of the voxels of which one point is kept [m].
        fault: One of `FAULTS`, or none.
        centres: Whether the points are moved into the middles of these voxels.
    """
    rng = np.random.default_rng(seed)
    place = house(rng, KINDS[seed % len(KINDS)])
    scan = SCANNERS[scanner](place, rng, NOISE[scanner] if noise is None else noise)
    if fault is not None:
        scan = FAULTS[fault](place, scan, rng)
    scan = scan.thinned(thin, rng)
    return place, scan.centred(thin) if centres else scan


class Scanned(TypedDict, total=False):
    """How a house is scanned and thinned: see `scanned_house`."""

    thin: float
    fault: str | None
    centres: bool


class How(Scanned, total=False):
    """And how it is built: told where the rays began, or not."""

    origins: bool


def house_rows(
    scanner: str, count: int | None, seed: int, noise: float | None = None, **how: Unpack[How]
) -> Iterator[Row]:
    """One row for each house, and one for all of them."""
    rows = []
    numbers = range(seed, seed + (COUNT[scanner] if count is None else count))
    for number in each(numbers, f"houses, {scanner}"):
        rows.append({"row": "house", "scanner": scanner, "seed": number} | measure(number, scanner, noise, **how))
        yield rows[-1]
    if rows:
        yield {"row": "houses", "scanner": scanner, "houses": len(rows)} | _sum(rows)


def measure(
    seed: int,
    scanner: str,
    noise: float | None = None,
    *,
    origins: bool = False,
    **how: Unpack[Scanned],
) -> Row:
    """Build one scanned house, told where rays began or not; plan from floor to floor and back; judge what is OK."""
    place, scan = scanned_house(seed, scanner, noise, **how)
    began = time.process_time()
    row: Row = {"kind": place.name, "points": len(scan.points)}
    try:
        scene = build_scene(scan.points, origins=scan.origins if origins else None)
    except GpdfError as error:
        return row | {"up": False, "down": False, "said": f"{type(error).__name__}: {error}"[:90]}
    row["us_a_point"] = 1e6 * (time.process_time() - began) / len(scan.points)
    rng, floor = np.random.default_rng(seed), scan.points[scan.ground]
    ends = place.seen_end(0, floor, rng), place.seen_end(len(place.rooms) - 1, floor, rng)
    results = {name: plan(scene, *pair, "human") for name, pair in (("up", ends), ("down", ends[::-1]))}
    row |= {name: result.status is Status.OK for name, result in results.items()}
    truths = [judge_ok(place, result) for result in results.values() if result.status is Status.OK]
    free = free_places(scene, AGENTS["human"], FREE, np.random.default_rng(seed))
    sigma, inferred = NOISE[scanner] if noise is None else noise, judge_inferred(place, scene)
    return row | {
        "inferred": len(inferred),
        "inferred_off": int(np.count_nonzero(~inferred)),
        "inferred_unseen": count_unseen(place, scene, floor),
        "free": len(free),
        **count_touching(place.world, free, AGENTS["human"], sigma, scan.points[~scan.ground]),
        "way_free": way_is_free(place),
        "seen": was_seen(place, floor),
        "collisions": sum(truth.collides(sigma) for truth in truths),
        "deepest_mm": 1e3 * max((truth.penetration for truth in truths), default=0.0),
        "in_the_air": sum(truth.in_the_air for truth in truths),
        "foot_mm": 1e3 * max((truth.foot for truth in truths), key=abs, default=0.0),
        "said": " ".join(sorted({str(result.status) for result in results.values()})),
    }


def free_places(scene: Scene, agent: Agent, count: int, rng: np.random.Generator) -> FloatArray:
    """Random places, middles of cells of the ground, where nothing that is known stops a body, (m, 3) [m].

    The search and the optimiser keep further away, so paths alone would not tell that such a place is wrong.
    """
    space, places = scene.free_space(agent), []
    for level, surface in enumerate(space.surfaces):
        centres = surface.centres(surface.state != UNKNOWN)
        places.append(centres[space.levels[level].clearance(centres[:, :2])[0] >= space.reach])
    return rng.permutation(np.concatenate(places))[:count]


def judge_ok(place: Place, result: PlanResult) -> Truth:
    """The truth of a path that was handed out."""
    if result.trajectory is None:
        raise ValueError("an OK result has a trajectory")
    return judge_path(place.world, result.trajectory, AGENTS["human"])


def judge_inferred(place: Place, scene: Scene) -> BoolArray:
    """Whether true ground is within a cell of each inferred cell and within `ON` of its height, shape (k,)."""
    made = []
    for surface in scene.surfaces:
        centres = surface.centres(surface.state == INFERRED)
        found = np.zeros(len(centres), dtype=bool)
        for shift in np.ndindex(3, 3):  # the cell, and the eight around it
            off = surface.cell_width * np.array([*shift, 1.0]) - surface.cell_width
            true = place.world.ground_under(centres + off + np.array([0.0, 0.0, TOE]))
            found |= np.abs(centres[:, 2] - true) <= ON
        made.append(found)
    return np.concatenate(made)


def count_unseen(place: Place, scene: Scene, ground: FloatArray) -> int:
    """Inferred cells over a tread that the scan shows no point of within what a foot bridges.

    Args:
        place: A house.
        scene: Of its scan.
        ground: Points of the scan that are truly ground [m], shape (n, 3).
    """
    world, rise = place.world, float(np.diff(place.way[:, 2]).max())
    cells = np.concatenate([surface.centres(surface.state == INFERRED) for surface in scene.surfaces])
    hits = world.cast(cells + np.array([0.0, 0.0, TOE]), np.broadcast_to([0.0, 0.0, -1.0], cells.shape))
    kind = np.where(hits.triangle >= 0, world.kind[hits.triangle], -1)
    treads = cells[np.isin(kind, [world.kinds.index(name) for name in ("tread", "landing") if name in world.kinds])]
    return int(np.count_nonzero(~has_within(treads, ground, PerceptionConfig().widest_gap, 0.5 * rise)))


def way_is_free(place: Place) -> bool:
    """Whether a human can take the way that the place says: nothing is touched, and feet are on the ground."""
    contacts = on_ground(place, place.way)
    path = _standing(contacts)
    truth = judge_path(place.world, path, AGENTS["human"])
    return truth.penetration == 0.0 and not truth.in_the_air


def was_seen(place: Place, ground: FloatArray) -> bool:
    """Whether a scan leaves no gap in the treads that a human could not judge, on some way that it can take over them.

    Such a way is the place's own or one beside it, free in the exact world. Every place of true ground within the
    human's radius of it, from the first tread's middle to the last one's, has a point of ground within half of what a
    foot bridges, of this tread or of one beside it, and one of its own tread within all of that. In the floors before
    and behind the treads gaps are allowed: their surroundings may explain them.

    Args:
        place: A house.
        ground: Points of the scan that are truly ground [m], shape (n, 3).
    """
    bridged, rise = PerceptionConfig().widest_gap, float(np.diff(place.way[:, 2]).max())

    def shows(way: FloatArray) -> bool:
        under = ground_below(place, way[1:-1])
        spans = (0.5 * bridged, 2.0 * rise), (bridged, 0.5 * rise)
        return all(has_within(under, ground, *span).all() for span in spans)

    ways = (beside(place.way, shift) for shift in sorted(ASIDE, key=abs))
    return any(shows(way) and way_is_free(replace(place, way=way)) for way in ways)


def has_within(places: FloatArray, points: FloatArray, aside: float, up: float) -> BoolArray:
    """Which of the places (m, 3) have a point (n, 3) in an ellipsoid so far to the side and up [m], shape (m,)."""
    scale = np.array([1.0, 1.0, aside / up])
    found: BoolArray = cKDTree(scale * points).query(scale * places)[0] <= aside
    return found


def beside(way: FloatArray, shift: float) -> FloatArray:
    """A way (n, 3) moved to its left by so much [m]."""
    ahead = np.gradient(way[:, :2], axis=0)
    ahead /= np.hypot(*ahead.T)[:, None]
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(way))])
    moved: FloatArray = way + shift * aside
    return moved


def ground_below(place: Place, way: FloatArray) -> FloatArray:
    """Places of true ground that a human on a way (n, 3) is over, and no more than a step from it, (k, 3) [m]."""
    agent = AGENTS["human"]
    grid = np.stack(np.meshgrid(*2 * [np.arange(-agent.radius, agent.radius + STEP, STEP)]), axis=-1).reshape(-1, 2)
    disc = np.column_stack([grid, np.zeros(len(grid))])[np.hypot(*grid.T) <= agent.radius]
    places = (on_ground(place, way)[:, None] + disc).reshape(-1, 3)
    reach = np.array([0.0, 0.0, agent.max_step])
    places[:, 2] = place.world.ground_under(places + reach, 2.0 * agent.max_step)
    found: FloatArray = places[np.isfinite(places[:, 2])]
    return found


def on_ground(place: Place, way: FloatArray) -> FloatArray:
    """A way every few centimetres, on the true ground."""
    dense = every(way, STEP)
    rise = float(np.abs(np.diff(way[:, 2])).max(initial=0.0))
    dense[:, 2] = place.world.ground_under(dense + np.array([0.0, 0.0, rise]))
    return dense


def _standing(contacts: FloatArray) -> Trajectory:
    top = contacts + np.array([0.0, 0.0, AGENTS["human"].height])
    return Trajectory(top, contacts, np.arange(len(contacts), dtype=np.float64), np.zeros(len(contacts)))


def _sum(rows: list[Row]) -> Row:
    done = [row for row in rows if "foot_mm" in row]
    return {
        "points": sum(row["points"] for row in rows),
        "us_a_point": float(np.median([row["us_a_point"] for row in done])) if done else float("nan"),
        "solvable": sum(row["way_free"] for row in done),
        "seen": sum(row["seen"] for row in done),
        "seen_both": sum(row["seen"] and row["up"] and row["down"] for row in done),
        "inferred": sum(row["inferred"] for row in done),
        "inferred_off": sum(row["inferred_off"] for row in done),
        "free": sum(row["free"] for row in done),
        "wrongly_free": sum(row["wrongly_free"] for row in done),
        "wrongly_free_seen": sum(row["wrongly_free_seen"] for row in done),
        "inferred_unseen": sum(row["inferred_unseen"] for row in done),
        "up": sum(row["up"] for row in rows),
        "down": sum(row["down"] for row in rows),
        "both": sum(row["up"] and row["down"] for row in rows),
        "collisions": sum(row["collisions"] for row in done),
        "deepest_mm": max((row["deepest_mm"] for row in done), default=0.0),
        "in_the_air": sum(row["in_the_air"] for row in done),
        "foot_mm": max((row["foot_mm"] for row in done), key=abs, default=0.0),
    }
