"""Random changes of many kinds in ray-cast places of all kinds, and in heaps of planes: does each equal a build?"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from gpdf_service.bench.build_changes import around, differences, from_scratch
from gpdf_service.bench.report import Row
from gpdf_service.errors import CloudError
from gpdf_service.pipeline import build_scene
from gpdf_service.scene import Scene
from gpdf_service.synthetic.places import PLACES
from gpdf_service.synthetic.scanners import NOISE, SCANNERS, Scan
from gpdf_service.types import FloatArray

CHANGES = 10
"""Of a place, one after another, if nothing else is asked."""
LARGEST = 150_000
"""Points of a scan; of a larger one so many are taken, as each version is held against a build."""
THIN = (0.03, 0.04, 0.06)
"""[m] Of the voxels that a scan may be thinned to."""
LOUD = 5.0
"""[-] Noise over the scanner's own, at most."""
WIDEST = 1.2
"""[m] Half of the side of what a change touches, at most."""
SHARES = (0.4, 0.35, 0.4)
"""[-] Shares of the places that are noisier, that have labels, and that have origins."""
LATE = 0.1
"""[-] Share of a scan that comes by and by."""
ROUGH = (0.0, 0.0, 0.001, 0.01, 0.03, 0.1)
"""[m] Standard deviations of a heap's points."""

Change = dict[str, Any]
"""Arguments of `Scene.update`, but for labels and origins."""
Rng = np.random.Generator


def wild_rows(count: int, changes: int, seed: int) -> Iterator[Row]:
    """A row for each of so many places, each changed so often; every second one is a heap."""
    for i in range(seed, seed + count):
        rng = np.random.default_rng([i, 7])
        name, scanner = (str(rng.choice(list(kinds))) for kinds in (PLACES, SCANNERS))
        noisy, labels, origins = (bool(rng.random() < share) for share in SHARES)
        if i % 2:
            name, scanner, noise = "heap", "none", float(rng.choice(ROUGH))
            scan = heap(rng, noise)
        else:
            noise = NOISE[scanner] * (rng.uniform(1.0, LOUD) if noisy else 1.0)
            scan = SCANNERS[scanner](PLACES[name](rng), rng, noise).thinned(float(rng.choice(THIN)), rng)
            scan = scan.of(np.sort(rng.permutation(len(scan.points))[:LARGEST]))
        row = {"place": name, "seed": i, "scanner": scanner, "points": len(scan.points), "noise_m": noise}
        yield row | {"labels": labels, "origins": origins} | measure_wild(scan, labels, origins, changes, rng)


def heap(rng: Rng, noise: float) -> Scan:
    """A floor, planes that lie anyhow, and a flight, sampled at random, densely or not; its labels are at random."""
    side = rng.uniform(0.5, 12.0, 2)
    parts = [rng.random((int(10.0 ** rng.uniform(1.0, 4.3)), 2)) * side @ np.eye(2, 3)]
    for _ in range(rng.integers(6)):
        corner, ends = rng.uniform(-3.0, 3.0, 3) * (1.0, 1.0, 0.5), rng.normal(size=(2, 3)) * rng.uniform(0.05, 3.0)
        parts.append(0.5 * np.append(side, 0.0) + corner + rng.random((int(10.0 ** rng.uniform(0.0, 3.7)), 2)) @ ends)
    depth, rise, width, count = rng.uniform(0.1, 0.5), rng.uniform(0.05, 0.35), rng.uniform(0.3, 2.0), rng.integers(16)
    for k in range(count):
        tread = rng.random((int(10.0 ** rng.uniform(1.0, 3.0)), 3)) * (width, depth, 0.0)
        parts.append(tread + np.array([0.0, k * depth, (k + 1) * rise]))
    points = np.concatenate(parts)
    points += rng.normal(0.0, noise, points.shape)
    eye = np.broadcast_to(points.mean(axis=0) + np.array([0.0, 0.0, 1.5]), points.shape)
    return Scan(points, eye, rng.random(len(points)) < rng.random(), np.zeros(len(points), np.int64))


def measure_wild(scan: Scan, labels: bool, origins: bool, changes: int, rng: Rng) -> Row:
    """Change the scene of a scan over and over, and hold each version against a build of the same points.

    Returns:
        How many changes were `made`, `as_a_whole` and `refused`, and the kinds of those in which what is `other`.
    """
    late = rng.random(len(scan.points)) < LATE
    first, later = scan.of(~late), scan.of(late)
    row: Row = {"made": 0, "as_a_whole": 0, "refused": 0, "other": ""}
    try:
        ground, eyes = first.ground if labels else None, first.origins if origins else None
        scene = build_scene(first.points, ground, origins=eyes)
        scene.free_space("human")
    except CloudError:
        return row | {"refused": 1}
    for _ in range(changes):
        kind = list(KINDS)[rng.integers(len(KINDS))]
        change = _with_more(KINDS[kind](scene.points, later.points, rng), scene, rng)
        try:
            scene = scene.update(**change)
        except CloudError:
            row["refused"] += 1
            continue
        found = differences(scene, from_scratch(scene))
        row["made"] += 1
        row["as_a_whole"] += not (scene.perceived and scene.perceived.touched)
        row["other"] += f"{kind}: {', '.join(found)}; " if found else ""
    return row


def _with_more(change: Change, scene: Scene, rng: Rng) -> Change:
    """The change, often with labels for what is new, and with an origin, where the scene has some."""
    count = len(change.get("insert", ()))
    labels = {"ground": rng.random(count) < 0.5} if count and scene.labelled and rng.random() < 0.5 else {}
    eyes = {"origins": scene.points[rng.integers(len(scene.points))] + [0.0, 0.0, 1.5]}
    return change | labels | (eyes if count and scene.rays and rng.random() < 0.5 else {})


def _place(points: FloatArray, rng: Rng) -> tuple[FloatArray, float]:
    """A point of a scene, and half of the side of a square around it [m]."""
    return points[rng.integers(len(points))], float(rng.uniform(0.1, WIDEST))


def _taken_away(points: FloatArray, _: FloatArray, rng: Rng) -> Change:
    """All in a square."""
    return {"remove": around(points, *_place(points, rng))}


def _put_in(points: FloatArray, _: FloatArray, rng: Rng) -> Change:
    """A box of points, or a few of them."""
    place, half = _place(points, rng)
    return {"insert": place + rng.uniform(-0.5 * half, 0.5 * half, (rng.integers(1, 800), 3))}


def _seen_later(points: FloatArray, later: FloatArray, rng: Rng) -> Change:
    """What the scanner saw of a square, too."""
    fresh = later[around(later, *_place(points, rng))]
    return {"insert": fresh} if len(fresh) else {}


def _board(points: FloatArray, _: FloatArray, rng: Rng) -> Change:
    """A board somewhere over a place, in place of what is over it."""
    place, half = _place(points, rng)
    over = around(points, place, half) & (points[:, 2] > place[2])
    x, y = np.meshgrid(np.arange(-half, half, 0.03), np.arange(-0.3, 0.3, 0.03))
    board = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, rng.uniform(0.0, 1.2))])
    return {"remove": over, "insert": place + board}


def _scanned_again(points: FloatArray, _: FloatArray, rng: Rng) -> Change:
    """What is there in a square, 4 mm off; of each voxel without a point one."""
    near = points[around(points, *_place(points, rng))]
    return {"insert": near + rng.normal(0.0, 0.004, near.shape), "thin": float(rng.choice(THIN))}


def _strays(points: FloatArray, _: FloatArray, rng: Rng) -> Change:
    """One to three points anywhere, within half a metre around the scene, too."""
    low, high = points.min(axis=0) - 0.5, points.max(axis=0) + 0.5
    return {"insert": rng.uniform(low, high, (rng.integers(1, 4), 3))}


KINDS: dict[str, Callable[[FloatArray, FloatArray, Rng], Change]] = {
    "taken away": _taken_away,
    "put in": _put_in,
    "seen later": _seen_later,
    "board": _board,
    "scanned again": _scanned_again,
    "strays": _strays,
}
"""What may change, from the points of the scene [m], those of its scan that come later [m], and a source of chance."""
