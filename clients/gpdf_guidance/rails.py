"""On which side stairs have a handrail, as far as a scan shows one.

A rail stands out at hand's height: what is nearest to the way there is nearer than what is below it and what is above.
A wall and a parapet are as near all the way. Where a scan is unsure, nothing is said of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpdf_guidance.features import Feature, FeatureKind
from gpdf_guidance.stairs import Flight

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

BANDS = ((0.3, 0.6), (0.7, 1.05), (1.2, 1.7))
"""[m] Over a tread: below a rail, where rails are (0.8 to 1 m over the edges of treads), and above it."""
STANDS_OUT = 0.04
"""[m] A rail stands off its wall by a hand's thickness; what is less is noise."""
TREADS = 0.6
"""Share of the treads beside which it is seen: a rail goes along, a box on one tread does not."""
REACH = 1.2
"""[m] From the way to a rail that an arm finds when one keeps to that side."""
AROUND = 2.0 * REACH
"""[m] How far from a flight is looked."""


def with_rails(
    features: tuple[Feature, ...], ground: FloatArray, s: FloatArray, flights: tuple[Flight, ...], cloud: FloatArray
) -> tuple[Feature, ...]:
    """Features whose stairs know the side of their handrail.

    Args:
        features: Of a way.
        ground: Contact points of the way [m], shape (n, 3).
        s: Their arc lengths [m], shape (n,).
        flights: Stairs on the way.
        cloud: Points around the flights [m], shape (k, 3).
    """
    named = []
    for one in features:
        flight = next((f for f in flights if one.kind is FeatureKind.STAIRS and abs(f.start - one.start) < 0.1), None)
        named.append(one if flight is None else replace(one, rail=_rail(ground, s, flight, one.count, cloud)))
    return tuple(named)


def _rail(ground: FloatArray, s: FloatArray, flight: Flight, count: int, cloud: FloatArray) -> str:
    """Beside each tread, on which side something stands out; empty where that is so on none, or hardly any."""
    forward = np.array([np.cos(flight.enter), np.sin(flight.enter)])
    left = np.array([-forward[1], forward[0]])
    edges = np.linspace(flight.start, flight.end, max(2, count))
    treads = np.column_stack([np.interp(0.5 * (edges[:-1] + edges[1:]), s, ground[:, k]) for k in range(3)])
    half = 0.5 * (flight.end - flight.start) / (len(edges) - 1)
    seen = np.array([_stands_out(cloud, tread, forward, left, half) for tread in treads])
    sides = [name for name, share in zip(("left", "right"), seen.mean(axis=0), strict=True) if share >= TREADS]
    return "both" if len(sides) == 2 else "".join(sides)


def _stands_out(
    cloud: FloatArray, tread: FloatArray, forward: FloatArray, left: FloatArray, half: float
) -> tuple[bool, bool]:
    """Whether something stands out to the left and to the right of a tread."""
    away, over = cloud[:, :2] - tread[:2], cloud[:, 2] - tread[2]
    beside = away @ left
    near = (np.abs(away @ forward) <= half) & (np.abs(beside) <= AROUND)
    found = []
    for sign in (1.0, -1.0):
        gaps = []
        for low, high in BANDS:
            rows = near & (over >= low) & (over <= high) & (sign * beside > 0.0)
            gaps.append(float(np.abs(beside[rows]).min(initial=np.inf)))
        below, rail, above = gaps
        found.append(rail <= REACH and min(below, above) - rail >= STANDS_OUT)
    return found[0], found[1]
