"""In which unit and which way up a cloud is: what can be told from the cloud alone, and how it is set right.

Of a sample of the points the level ones are told by the plane through their neighbours. The lowest and the highest
large layer of them are the floor and the ceiling: their distance is the headroom, and furniture has its level tops in
the lower half of it. What is odd is said, what is impossible is refused, and nothing is changed without being asked.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.errors import CloudError
from gpdf_service.types import FloatArray

UP: dict[str, tuple[tuple[int, int, int], tuple[int, int, int]]] = {
    "z": ((0, 1, 2), (1, 1, 1)),
    "y": ((0, 2, 1), (1, -1, 1)),
    "x": ((1, 2, 0), (1, 1, 1)),
    "-z": ((0, 1, 2), (1, -1, -1)),
    "-y": ((0, 2, 1), (1, 1, -1)),
    "-x": ((2, 1, 0), (1, 1, -1)),
}
"""Which axis of a file points up: the file's axes that become x, y and z, and their signs; all are rotations."""
UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "feet": 0.3048, "kilometres": 1000.0}
"""[m] What a file may be in without saying so."""
SAMPLE = 20_000
"""Points that are looked at; of a large cloud they lie further apart by the root of the share."""
FEWEST = 500
"""Of fewer points nothing is told."""
NEIGHBOURS = 10
"""That a plane is laid through."""
BINS = 100
"""Of heights: 2 or 3 cm each in a room."""
COVERED = 20
"""Cells to a side of the plan, in which a ceiling is looked for over the floor."""
LEVEL = np.cos(np.radians(15.0))
"""[-] A normal this near to an axis: level, if the axis is up."""
ROOMS = (2.0, 4.0)
"""[m] Headroom of most storeys, from low cellars to old houses."""
TOPS = (0.40, 0.52), (0.68, 0.80)
"""[m] Over their floor: what one sits on, and what one works at."""
FURNISHED = 0.6
"""[-] Share of `TOPS` `AMONG` furniture; the bands are a quarter of it in height."""
AMONG = (0.25, 1.30)
"""[m] Over the floor: where other level things are rare in a furnished place."""
TALLEST = 60.0
"""[m] Between floor and ceiling of no building; few places that one walks in are as high as that."""
OUTERMOST = 0.01
"""[-] Of the points to each side: strays are fewer, and walls more."""
FARTHEST = 0.5
"""[m] Between points, in a cloud where a body can be planned for: a person's width."""
NARROWEST = 0.34
"""[m] Of a place: the footprint of the smallest body here."""


@dataclass(frozen=True, slots=True)
class Frame:
    """What a cloud shows of its unit and of its up axis.

    Attributes:
        spacing: Between points, about [unit of the file].
        headroom: Between the lowest and the highest large level layer [unit of the file]; 0 where there is one alone.
        level: Share of the points in which the cloud is level about x, y and z, shape (3,).
        lower: Share of the level points between floor and ceiling that lie in the lower half; NaN where there are few.
        tops: Of what is level `AMONG` furniture, the share that is at the height of `TOPS`: if the file is in metres,
            and if it is in feet; 0 where there is little, and where there is a ceiling, which tells more.
        hanging: Share of the points that lie below the one large level layer; 0 where there are several, or none.
        size: Extents [unit of the file], shape (3,).
        least: The smallest extent, without the `OUTERMOST` points [unit of the file]: the height of most places.
    """

    spacing: float
    headroom: float
    level: FloatArray
    lower: float
    tops: tuple[float, float]
    hanging: float
    size: FloatArray
    least: float


def turn(points: FloatArray, scale: float, up: str) -> FloatArray:
    """Points (n, 3) of a file in metres, z up.

    Raises:
        CloudError: no such axis, or no such scale.
    """
    if up not in UP or not 0.0 < scale < np.inf:
        raise CloudError("frame of the cloud", f"scale {scale!r}, up {up!r}", f"Up is one of {', '.join(UP)}.")
    if up == "z" and scale == 1.0:
        return points
    axes, signs = UP[up]
    return np.ascontiguousarray(points[:, axes] * (scale * np.array(signs, dtype=np.float64)))


def look(points: FloatArray) -> Frame | None:
    """What the points (n, 3) show; None if they are too few."""
    if len(points) < FEWEST:
        return None
    rows = np.random.default_rng(0).permutation(len(points))[:SAMPLE]
    some = points[rows] - points.mean(axis=0)
    near, beside = cKDTree(some).query(some, k=NEIGHBOURS)
    spacing = float(np.median(near[:, 1])) * np.sqrt(len(some) / len(points))
    around = some[beside] - some[beside].mean(axis=1, keepdims=True)
    normal = np.abs(np.linalg.eigh(around.transpose(0, 2, 1) @ around)[1][:, :, 0])
    level = (normal > LEVEL).mean(axis=0)
    size, flat = np.ptp(some, axis=0), some[normal[:, 2] > LEVEL]
    headroom, lower = _storey(flat, size)
    tops = (0.0, 0.0) if headroom else (_tops(flat[:, 2], 1.0), _tops(flat[:, 2], UNITS["feet"]))
    least = float(np.ptp(np.quantile(some, (OUTERMOST, 1.0 - OUTERMOST), axis=0), axis=0).min())
    return Frame(spacing, headroom, level, lower, tops, _hanging(some[:, 2], flat[:, 2]), size, least)


def _tops(z: FloatArray, scale: float) -> float:
    """Of level points at heights z, in units of `scale` [m]: the share of `TOPS` `AMONG` furniture, 0 if they are few.

    The floor is the lowest bin of heights that holds a third of the points of the fullest one.
    """
    if len(z) < FEWEST // 5 or np.ptp(z) <= 0.0:
        return 0.0
    count, edges = np.histogram(z, BINS)
    low = int(np.flatnonzero(count > count.max() / 3)[0])
    high = scale * (z - np.median(z[(z >= edges[low]) & (z <= edges[low + 1])]))
    among = np.count_nonzero((high > AMONG[0]) & (high < AMONG[1]))
    tops = sum(np.count_nonzero((high > least) & (high < most)) for least, most in TOPS)
    return float(tops / among) if tops > 0.01 * len(z) else 0.0


def _hanging(z: FloatArray, flat: FloatArray) -> float:
    """Of points at the heights z, of which some are flat: the share below the one large layer of these."""
    if len(flat) < FEWEST // 5 or np.ptp(z) <= 0.0:
        return 0.0
    count, edges = np.histogram(flat, BINS, (z.min(), z.max()))
    layers = np.flatnonzero(count > count.max() / 3)
    if layers[-1] - layers[0] > BINS // 20:
        return 0.0
    return float((z < edges[layers[0]]).mean())


def _storey(points: FloatArray, size: FloatArray) -> tuple[float, float]:
    """Of the level points: headroom of the lowest storey, share of what is level in it that is in its lower half.

    A layer is a bin of the height that holds a third of the points of the largest one; a ceiling covers its floor.
    """
    if len(points) < FEWEST // 5 or size.min() <= 0.0:
        return 0.0, np.nan
    z = points[:, 2]
    row = np.minimum((BINS * (z - z.min()) / size[2]).astype(np.int64), BINS - 1)
    count = np.bincount(row, minlength=BINS)
    layers = np.flatnonzero(count > count.max() / 3)
    storey = next(((low, high) for low, high in pairwise(layers) if high - low > BINS // 5), None)
    if storey is None:
        return 0.0, np.nan
    cell = (COVERED * (points[:, :2] - points[:, :2].min(axis=0)) / size[:2]).astype(np.int64) @ [1, 2 * COVERED]
    below, above = (np.unique(cell[row == layer]) for layer in storey)
    if np.isin(below, above).mean() < 0.5:
        return 0.0, np.nan
    floor, ceiling = (float(np.median(z[row == layer])) for layer in storey)
    room = ceiling - floor
    within = z[(z > floor + 0.1 * room) & (z < ceiling - 0.1 * room)]
    few = len(within) < 0.005 * len(z)
    return room, np.nan if few else float((within < floor + 0.5 * room).mean())


def odd_unit(frame: Frame) -> tuple[str, bool]:
    """What is odd about the unit, in words, or nothing; and whether no place in metres can be so."""
    size = float(frame.size.max())
    if size < NARROWEST:
        return f"it is {size:.2g} m wide{_guess(frame, frame.headroom)}", True
    if frame.headroom > TALLEST:
        return f"its ceiling is {frame.headroom:.0f} m over its floor{_guess(frame, frame.headroom)}", True
    if frame.spacing > FARTHEST:
        return f"its points lie {frame.spacing:.2g} m apart{_guess(frame, frame.headroom)}", True
    if frame.least > TALLEST:  # on a mountain, too: so it is said alone
        return f"it is {frame.least:.0f} m high, and wider{_guess(frame, frame.least)}", False
    feet = UNITS["feet"]
    if ROOMS[0] < feet * frame.headroom < 0.8 * ROOMS[1]:
        return f"its ceiling is {frame.headroom:.1f} m over its floor; is it in feet? --scale {feet}", False
    if frame.tops[0] < FURNISHED < frame.tops[1]:
        return f"it has seats and tables if it is in feet, and none if it is in metres; --scale {feet}", False
    return "", False


def _guess(frame: Frame, height: float) -> str:
    """The unit in which a height is a storey's, or else the spacing a scanner's."""
    for name, scale in UNITS.items():
        if ROOMS[0] < scale * height < ROOMS[1]:
            return f": is it in {name}? --scale {scale:g}"
    fits = {name: s for name, s in UNITS.items() if 0.002 < s * frame.spacing < 0.1 and s * frame.size.max() > 1.0}
    if not fits:
        return ""
    return f": is it in {' or '.join(fits)}? --scale {' or '.join(f'{scale:g}' for scale in fits.values())}"


def odd_up(frame: Frame) -> str:
    """What is odd about the up axis, in words, or nothing.

    Ground and ceilings are what most of a cloud is level with, and few places are higher than wide.
    """
    axis = int(np.argmax(frame.level))
    if axis < 2 and frame.level[axis] > 1.5 * frame.level[2] and ROOMS[0] < frame.size[axis] < 0.7 * frame.size[2]:
        name = "xy"[axis]
        return f"more of it is level about {name} than about z; is {name} up? --up {name} (or -{name})"
    if frame.lower < 0.3:
        return "what is level between floor and ceiling is nearer to the ceiling; is z down? --up -z"
    if frame.hanging > 0.5:
        return "most of it lies under its one large level surface; is z down? --up -z"
    return ""
