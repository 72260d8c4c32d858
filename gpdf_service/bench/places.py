"""Where a body may stand without being told a height, and what is known of ground that no way leads to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.bench.exact import ON, SPACING, count_touching, feet_off, judge_path
from gpdf_service.bench.houses import THIN, free_places
from gpdf_service.bench.judge import Judge
from gpdf_service.bench.report import Row, each
from gpdf_service.errors import NoGroundError
from gpdf_service.pipeline import build_scene, plan
from gpdf_service.scene import Scene
from gpdf_service.synthetic.place import SEEN, Place
from gpdf_service.synthetic.places import ISLANDS, ONE_FLOOR, car_park, museum, shaft
from gpdf_service.synthetic.scanners import NOISE, SCANNERS, Scan
from gpdf_service.types import AGENTS, Agent, BoolArray, FloatArray, Status

STARTS = 100
"""Random starts in each place, where nothing else is asked for."""
PAIRS = 8
"""Of random places in each place, where nothing else is asked for."""
FREE = 300
"""Random free places of each place that are held against the exact one."""
GRID = 0.1
"""[m] Between the places of an island that are asked for."""
SHAFTS = 12
"""Halls with a shaft, where nothing else is asked for."""
RIM = 0.4
"""[m] Of an island, that is left out: a body does not stand there."""


def land_rows(
    scanner: str,
    count: int | None,
    seed: int,
    noise: float | None = None,
    makers: Sequence[Callable[[np.random.Generator], Place]] = ONE_FLOOR,
) -> Iterator[Row]:
    """For each crowded place: of random starts (x, y), how many are taken, and how many of these are wrong."""
    sigma = NOISE[scanner] if noise is None else noise
    for place, scan, scene in _built(makers, scanner, seed, noise):
        low, high = scan.points[:, :2].min(axis=0), scan.points[:, :2].max(axis=0)
        starts = np.random.default_rng(seed).uniform(low, high, (count or STARTS, 2))
        judge = Judge(*place.world.sample(SPACING, 0.0))
        for name in ("human", "roomba"):
            row: Row = {"row": "lands", "place": place.name, "scanner": scanner, "agent": name, "starts": len(starts)}
            yield row | _land(scene, judge, place, AGENTS[name], starts) | {"noise_m": sigma}


def _built(
    makers: Sequence[Callable[[np.random.Generator], Place]], scanner: str, seed: int, noise: float | None
) -> Iterator[tuple[Place, Scan, Scene]]:
    """Each place, its scan, and the scene of that without its labels."""
    for make in each(makers, f"places, {scanner}"):
        place, scan = scanned_place(make, scanner, seed, noise)
        yield place, scan, build_scene(scan.points)


def scanned_place(
    make: Callable[[np.random.Generator], Place], scanner: str, seed: int, noise: float | None = None
) -> tuple[Place, Scan]:
    """A place of that seed, and its thinned scan; the noise [m] is the scanner's where it is not given."""
    place, rng = make(np.random.default_rng(seed)), np.random.default_rng(seed)
    scan = SCANNERS[scanner](place, rng, NOISE[scanner] if noise is None else noise)
    return place, scan.thinned(THIN, rng)


def _land(scene: Scene, judge: Judge, place: Place, agent: Agent, starts: FloatArray) -> Row:
    """A plan from a start to itself says where it lands: each is held against the world."""
    taken = [plan(scene, start, start, agent) for start in starts]
    paths = [result.trajectory for result in taken if result.status is Status.OK and result.trajectory is not None]
    feet = feet_off(place.world, np.array([path.ground[0] for path in paths]).reshape(-1, 3), agent.max_step)
    deep = np.array([judge.penetration(path.ground[0], agent) for path in paths])
    return {
        "landed": len(paths),
        "no_ground": int((np.abs(feet) > ON).sum()),
        "touching": int((deep > 0.0).sum()),
        "deepest_mm": 1e3 * float(deep.max(initial=0.0)),
    }


def path_rows(
    scanner: str,
    count: int | None,
    seed: int,
    noise: float | None = None,
    makers: Sequence[Callable[[np.random.Generator], Place]] = ONE_FLOOR,
) -> Iterator[Row]:
    """For each crowded place and body: plans between free places whose ground was seen, and places called free.

    Both are held against the world: paths keep away from what stops a body, so they alone would not tell a wrong place.
    """
    sigma = NOISE[scanner] if noise is None else noise
    for place, scan, scene in _built(makers, scanner, seed, noise):
        free = place.free_places(0, 4 * (count or PAIRS), np.random.default_rng(seed))
        free = free[cKDTree(scan.points[scan.ground]).query(free)[0] < SEEN][: 2 * (count or PAIRS)]
        pairs = free[: len(free) // 2 * 2].reshape(-1, 2, 3)
        for name in ("human", "roomba"):
            results = [plan(scene, start, goal, name) for start, goal in pairs]
            paths = [result.trajectory for result in results if result.status is Status.OK and result.trajectory]
            truths = [judge_path(place.world, path, AGENTS[name]) for path in paths]
            yield {
                **{"row": "paths", "place": place.name, "scanner": scanner, "agent": name, "pairs": len(pairs)},
                **{"ok": len(paths), "collisions": sum(truth.collides(sigma) for truth in truths)},
                "deepest_mm": 1e3 * max((truth.penetration for truth in truths), default=0.0),
                "in_the_air": sum(truth.in_the_air for truth in truths),
                **_free(scene, place, AGENTS[name], sigma, seed, scan.points[~scan.ground]),
            }


def _free(scene: Scene, place: Place, agent: Agent, sigma: float, seed: int, things: FloatArray) -> Row:
    """Of random places that the scene calls free: how many touch something, and how many are on no ground."""
    free = free_places(scene, agent, FREE, np.random.default_rng(seed))
    return {
        "free": len(free),
        **count_touching(place.world, free, agent, sigma, things),
        "no_ground": int((np.abs(feet_off(place.world, free, agent.max_step)) > ON).sum()),
    }


def label_rows(
    scanner: str,
    count: int | None,
    seed: int,
    noise: float | None = None,
    makers: Sequence[Callable[[np.random.Generator], Place]] = (*ONE_FLOOR, *ISLANDS, museum, car_park),
) -> Iterator[Row]:
    """For each kind of place, of several: how much of its ground is found at least, and how much is none at most."""
    for make in each(makers, f"labels, {scanner}"):
        found, wrong = [], []
        for number in range(seed, seed + (count or 4)):
            _, scan = scanned_place(make, scanner, number, noise)
            ground = _labelled(scan.points)
            found.append(float((ground & scan.ground).sum() / max(scan.ground.sum(), 1)))
            wrong.append(float((ground & ~scan.ground).sum() / max(ground.sum(), 1)))
        yield {
            **{"row": "labels", "place": make.__name__, "scanner": scanner, "scans": len(found)},
            **{"found_least": round(min(found), 4), "wrong_most": round(max(wrong), 4)},
            **{"found_mean": round(float(np.mean(found)), 4), "wrong_mean": round(float(np.mean(wrong)), 4)},
        }


def _labelled(points: FloatArray) -> BoolArray:
    """What is ground of an unlabelled cloud; nothing where none is."""
    try:
        return build_scene(points).ground
    except NoGroundError:
        return np.zeros(len(points), dtype=bool)


def island_rows(scanner: str, count: int | None, seed: int, noise: float | None = None) -> Iterator[Row]:
    """For pits, galleries and platforms: how much of them is known as ground, stood on, and wrongly joined."""
    for make in each(ISLANDS, f"islands, {scanner}"):
        for number in range(seed, seed + (count or 3)):
            place, scan = scanned_place(make, scanner, number, noise)
            scene = build_scene(scan.points)
            ground = scan.points[scan.ground]
            places = seen_places(place.islands[0], ground)
            heights = np.stack([surface.height_at(places[:, :2]) for surface in scene.surfaces])
            known = (np.abs(heights - places[:, 2]) <= ON).any(axis=0)
            rng = np.random.default_rng(number)
            some = places[rng.permutation(len(places))[:10]]
            home = place.seen_end(0, ground, rng)
            yield {
                "row": "island",
                "place": place.name,
                "scanner": scanner,
                "seed": number,
                "places": len(places),
                "known": float(known.mean()) if known.size else float("nan"),
                "asked": len(some),
                "stands": sum(plan(scene, one, one, "human").status is Status.OK for one in some),
                "joined": sum(plan(scene, home, one, "human").status is Status.OK for one in some),
            }


def shaft_rows(scanner: str, count: int | None, seed: int, noise: float | None = None) -> Iterator[Row]:
    """For halls with a shaft: how many free places of a Roomba, all cells are asked, have no ground where they are."""
    for number in range(seed, seed + (count or SHAFTS)):
        place, scan = scanned_place(shaft, scanner, number, noise)
        free = free_places(build_scene(scan.points), AGENTS["roomba"], len(scan.points), np.random.default_rng(0))
        fall = free[:, 2] - place.world.ground_under(free + np.array([0.0, 0.0, ON]))
        over = fall > 0.5 * (place.rooms[0][0, 2] - place.islands[0][0, 2])
        yield {"row": "shaft", "scanner": scanner, "seed": number, "free": len(free), "over_shaft": int(over.sum())}


def seen_places(corners: FloatArray, ground: FloatArray) -> FloatArray:
    """Places of a rectangle, `RIM` from its edges, beside which ground was seen, (n, 3) [m]."""
    a, u, v = corners[0], corners[1] - corners[0], corners[3] - corners[0]
    across = [np.arange(RIM, np.linalg.norm(side) - RIM, GRID) / np.linalg.norm(side) for side in (u, v)]
    s, t = (axis.ravel()[:, None] for axis in np.meshgrid(*across))
    places = a + s * u + t * v
    seen: FloatArray = places[cKDTree(ground).query(places)[0] < SEEN]
    return seen
