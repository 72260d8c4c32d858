"""What raw scans hold besides surfaces: drift, returns from between two things at an edge, rooms in a mirror."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.synthetic.place import Place
from gpdf_service.synthetic.scanners import Scan
from gpdf_service.types import FloatArray, IntArray

DRIFT, TURNING = 0.003, np.radians(0.03)
"""[m] and [rad] Standard deviations of what a scanner's pose is off after a look, besides what it was before."""
SPLIT = 0.1
"""[-] Of the rays at an edge whose beam is as wide that both sides send something back."""
BESIDE = 4
"""Rays beside one, of which one tells whether there is an edge; a look of no more has none."""
PULSE = 1.0
"""[m] Two returns further apart than this are told apart by the scanner."""
EDGE = 0.05
"""[m] Between what two rays beside each other hit, from which on it is an edge."""
SHINE = 0.05
"""[-] Of the rays to a floor that see what is mirrored in it."""
MIRRORED = 10.0
"""[m] Behind a floor up to which anything comes back."""


def drifting(_: Place, scan: Scan, rng: np.random.Generator) -> Scan:
    """Poses that drift from look to look, and are closed to a loop at the end, as SLAM leaves them."""
    look = _looks(scan)
    off, turned = (_closed(rng.normal(0.0, by, (look[-1] + 1, n))) for by, n in ((DRIFT, 3), (TURNING, 1)))
    c, s = (f(turned[look, 0]) for f in (np.cos, np.sin))
    x, y, z = (scan.points - scan.origins).T
    return replace(scan, points=scan.origins + np.column_stack([c * x - s * y, s * x + c * y, z]) + off[look])


def between(_: Place, scan: Scan, rng: np.random.Generator) -> Scan:
    """One in ten rays at an edge returns from somewhere between the two things that its beam hit: a mixed pixel."""
    along, distance = _rays(scan)
    made, kept = distance.copy(), scan.ground.copy()
    for rows in _each(_looks(scan)):
        if len(rows) <= BESIDE:
            continue
        near = cKDTree(along[rows]).query(along[rows], k=BESIDE + 1)[1]
        beside = rows[near[np.arange(len(rows)), rng.integers(1, BESIDE + 1, len(rows))]]
        gap = np.abs(distance[beside] - distance[rows])
        edge = (scan.kind[rows] != scan.kind[beside]) & (gap > EDGE) & (gap < PULSE)
        split = edge & (rng.random(len(rows)) < SPLIT)
        share = rng.random(np.count_nonzero(split))
        made[rows[split]] += share * (distance[beside] - distance[rows])[split]
        kept[rows[split]] = False
    return replace(scan, points=scan.origins + made[:, None] * along, ground=kept)


def mirrored(place: Place, scan: Scan, rng: np.random.Generator) -> Scan:
    """One in twenty rays to a floor goes on to what it is mirrored to; the scanner puts that under the floor."""
    along, _ = _rays(scan)
    rows = np.flatnonzero(scan.ground & (rng.random(len(scan.points)) < SHINE))
    up = along[rows] * np.array([1.0, 1.0, -1.0])
    hits = place.world.cast(scan.points[rows] + EDGE * up, up)
    back = (hits.triangle >= 0) & (hits.distance < MIRRORED)
    points, kept = scan.points.copy(), scan.ground.copy()
    points[rows[back]] += (EDGE + hits.distance[back])[:, None] * along[rows[back]]
    kept[rows[back]] = False
    return replace(scan, points=points, ground=kept)


FAULTS: dict[str, Callable[[Place, Scan, np.random.Generator], Scan]] = {
    "drift": drifting,
    "between": between,
    "mirrors": mirrored,
}
"""Each makes of the scan of a place one with its fault."""


def _looks(scan: Scan) -> IntArray:
    """The number of the look that each ray is of, shape (n,): rays of one begin at one place, one after another."""
    another = (np.diff(scan.origins, axis=0) != 0.0).any(axis=1)
    return np.append(0, np.cumsum(another))


def _each(look: IntArray) -> Iterator[IntArray]:
    """The rows of each look."""
    return iter(np.split(np.arange(len(look)), np.flatnonzero(np.diff(look)) + 1))


def _rays(scan: Scan) -> tuple[FloatArray, FloatArray]:
    """Directions of the rays, shape (n, 3), and how far what they hit is [m], shape (n,)."""
    off = scan.points - scan.origins
    distance: FloatArray = np.linalg.norm(off, axis=1)
    return off / distance[:, None], distance


def _closed(steps: FloatArray) -> FloatArray:
    """A random walk, shape (n, k), that ends where it began: what it was off at the end is spread over all of it."""
    walked: FloatArray = np.cumsum(steps, axis=0)
    walked -= np.linspace(0.0, 1.0, len(walked))[:, None] * walked[-1]
    return walked
