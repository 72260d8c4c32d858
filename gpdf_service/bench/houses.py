"""Ray-cast houses of two storeys: does a human's plan go up and down, and is it right?"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from gpdf_service.bench.exact import ON, STEP, Truth, every, judge_path
from gpdf_service.bench.report import Row, each
from gpdf_service.errors import GpdfError
from gpdf_service.perception.surface import INFERRED
from gpdf_service.pipeline import build_scene, plan
from gpdf_service.scene import Scene
from gpdf_service.synthetic.houses import house
from gpdf_service.synthetic.place import Place
from gpdf_service.synthetic.scanners import NOISE, SCANNERS, Scan
from gpdf_service.synthetic.stairs import STAIRS
from gpdf_service.types import AGENTS, BoolArray, FloatArray, PlanResult, Status, Trajectory

COUNT = {"tripod": 21, "handheld": 28, "depth": 0}
"""Houses that are scanned in each way, where nothing else is asked for."""
THIN = 0.03
"""[m] Scans are thinned to one point of such a voxel, as they are handed on in practice."""
TOE = 0.3
"""[m] Over an inferred cell, from where the true ground under it is looked for: more than any riser."""
KINDS = tuple(STAIRS)


def scanned_house(seed: int, scanner: str, noise: float | None = None, thin: float = THIN) -> tuple[Place, Scan]:
    """A house and its scan; the kind of its stair goes round with the seed.

    Args:
        seed: Of house and scan.
        scanner: One of `SCANNERS`.
        noise: Along the ray [m]; the scanner's own where it is None.
        thin: Width of the voxels of which one point is kept [m].
    """
    rng = np.random.default_rng(seed)
    place = house(rng, KINDS[seed % len(KINDS)])
    scan = SCANNERS[scanner](place, rng, NOISE[scanner] if noise is None else noise)
    return place, scan.thinned(thin, rng)


def house_rows(scanner: str, count: int | None, seed: int, noise: float | None = None) -> Iterator[Row]:
    """One row for each house, and one for all of them."""
    rows = []
    numbers = range(seed, seed + (COUNT[scanner] if count is None else count))
    for number in each(numbers, f"houses, {scanner}"):
        rows.append({"row": "house", "scanner": scanner, "seed": number} | measure(number, scanner, noise))
        yield rows[-1]
    if rows:
        yield {"row": "houses", "scanner": scanner, "houses": len(rows)} | _sum(rows)


def measure(seed: int, scanner: str, noise: float | None = None) -> Row:
    """Build one scanned house; plan from floor to floor and back; judge what is OK."""
    place, scan = scanned_house(seed, scanner, noise)
    began = time.process_time()
    row: Row = {"kind": place.name, "points": len(scan.points)}
    try:
        scene = build_scene(scan.points)
    except GpdfError as error:
        return row | {"up": False, "down": False, "said": f"{type(error).__name__}: {error}"[:90]}
    row["us_a_point"] = 1e6 * (time.process_time() - began) / len(scan.points)
    rng, floor = np.random.default_rng(seed), scan.points[scan.ground]
    ends = place.seen_end(0, floor, rng), place.seen_end(len(place.rooms) - 1, floor, rng)
    results = {name: plan(scene, *pair, "human") for name, pair in (("up", ends), ("down", ends[::-1]))}
    row |= {name: result.status is Status.OK for name, result in results.items()}
    truths = [judge_ok(place, result) for result in results.values() if result.status is Status.OK]
    sigma, inferred = NOISE[scanner] if noise is None else noise, judge_inferred(place, scene)
    return row | {
        "inferred": len(inferred),
        "inferred_off": int(np.count_nonzero(~inferred)),
        "way_free": way_is_free(place),
        "collisions": sum(truth.collides(sigma) for truth in truths),
        "deepest_mm": 1e3 * max((truth.penetration for truth in truths), default=0.0),
        "in_the_air": sum(truth.in_the_air for truth in truths),
        "foot_mm": 1e3 * max((truth.foot for truth in truths), key=abs, default=0.0),
        "said": " ".join(sorted({str(result.status) for result in results.values()})),
    }


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


def way_is_free(place: Place) -> bool:
    """Whether a human can take the way that the place says: nothing is touched, and feet are on the ground."""
    contacts = on_ground(place, place.way)
    path = _standing(contacts)
    truth = judge_path(place.world, path, AGENTS["human"])
    return truth.penetration == 0.0 and not truth.in_the_air


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
        "inferred": sum(row["inferred"] for row in done),
        "inferred_off": sum(row["inferred_off"] for row in done),
        "up": sum(row["up"] for row in rows),
        "down": sum(row["down"] for row in rows),
        "both": sum(row["up"] and row["down"] for row in rows),
        "collisions": sum(row["collisions"] for row in done),
        "deepest_mm": max((row["deepest_mm"] for row in done), default=0.0),
        "in_the_air": sum(row["in_the_air"] for row in done),
        "foot_mm": max((row["foot_mm"] for row in done), key=abs, default=0.0),
    }
