"""What lies on a path and matters to someone who cannot see: turns, steps, stairs, ramps, narrow places."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from math import radians, sqrt

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

TURN = radians(60)
"""[rad] A change of direction from which people need to be told; a smaller one they are led through."""
BEAR = radians(25)
"""[rad] A change of direction that "keep left" is worth saying for."""
STRAIGHTEN = 0.15
"""[m] A path is taken as the straight pieces that stay this close to it."""
CURVE = 2.0
"""[m] Radius of a curve that is a turn; a wider one is a bend that one is led through."""
ONE_TURN = 2.0 * sqrt(2.0 * CURVE * STRAIGHTEN)
"""[m] Bends to the same side that are closer are one turn: so far apart are the corners of the pieces of a curve."""
LARGEST_TURN = radians(120)
"""[rad] A curve that turns further is two turns: who is told to turn around does so on the spot."""
LEAST_STEP = 0.04
"""[m] A lower edge is not felt as a step."""
FOOT = 0.25
"""[m] A foot's length: no three steps, up and down, are within this."""
STEEPEST_RAMP = 0.7
"""[-] Rise over run (35°): steeper than people stand on, so it is a step's face."""
TREAD = 0.6
"""[m] Steps that are closer belong to one flight of stairs."""
FLIGHT = 2
"""Steps from which it is a stair: the second one of two is told of with the first."""
RAMP = 0.05
"""[-] Rise over run (3°) that is felt as a ramp."""
RAMP_LENGTH = 1.0
"""[m] A shorter one is not worth a word."""
NARROW = 0.8
"""[m] A passage narrower than this: less than a hand's breadth and a half beside the elbows, so one is led slowly."""
ONE_PASSAGE = 1.0
"""[m] Narrow passages that are closer are one."""
OPENING = 1.0
"""[m] A passage narrower than this, and no longer, is an opening: a door, or a gap that is felt like one."""
BESIDE_OPENING = 0.5
"""[m] So far before and behind an opening it is wider by as much."""
HEAD_ROOM = 0.5
"""[m] An obstacle at head height is told of when it is this close to the body's side."""
HEAD_EXCESS = 0.15
"""[m] Room that a body to the hip has more, from which the obstacle hangs over it."""


class FeatureKind(StrEnum):
    """What it is."""

    TURN = "turn"
    BEAR = "bear"
    STEP = "step"
    STAIRS = "stairs"
    RAMP = "ramp"
    PLACE = "place"
    NARROW = "narrow"
    OPENING = "opening"
    HEAD = "head"
    UNSEEN = "unseen"


@dataclass(frozen=True, slots=True)
class Feature:
    """A stretch of a path.

    Attributes:
        kind: What it is.
        start: Arc length where it begins [m].
        end: Where it ends [m].
        amount: Angle to the left [rad], rise [m], width [m], length of what nobody saw [m], or 1 and -1 for left and
            right.
        count: Number of steps.
        rail: Of stairs, where their handrail is: "left", "right", "both", or empty where none is known.
        name: Of a place of the scene that is here.
    """

    kind: FeatureKind
    start: float
    end: float
    amount: float
    count: int = 1
    rail: str = ""
    name: str = ""


def find_features(
    rough: FloatArray,
    s: FloatArray,
    heading: FloatArray,
    width: FloatArray,
    free: FloatArray,
    over: FloatArray,
    facing: float | None,
) -> tuple[Feature, ...]:
    """All features of a path, in order.

    Args:
        rough: x, y, z, arc length of the trajectory as it came, so that a step stays sharp, shape (n, 4).
        s: Arc length of the samples of the rest, shape (m,).
        heading: Direction there [rad], shape (m,).
        width: Free width there [m], shape (m,).
        free: Free room there at offsets from right to left [m], shape (m, k).
        over: Room that a body to the hip has more [m], shape (m, k).
        facing: Where the person looks before the first step [rad].
    """
    found = find_turns(rough[:, :2], rough[:, 3])
    if facing is not None and abs(first := wrap(float(heading[0]) - facing)) >= TURN:
        found.insert(0, Feature(FeatureKind.TURN, 0.0, 0.0, first))
    steps = find_steps(rough[:, 2], rough[:, 3])
    found = [_off_stairs(one, steps) for one in found] + steps + find_ramps(rough[:, 2], rough[:, 3])
    found += find_narrow(width, s) + find_head_height(free, over, s)
    return tuple(sorted(found, key=lambda feature: feature.start))


def _off_stairs(turn: Feature, steps: list[Feature]) -> Feature:
    """A turn that goes on behind stairs begins there: nobody turns on them."""
    for one in steps:
        if one.kind is FeatureKind.STAIRS and one.start < turn.start < one.end <= turn.end:
            return replace(turn, start=one.end)
    return turn


def wrap(angle: float) -> float:
    """The same angle within -π to π."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def find_turns(xy: FloatArray, s: FloatArray) -> list[Feature]:
    """Turns and bends, from the straight pieces of a path (n, 2); those to the same side are joined."""
    corners = _straight_pieces(xy)
    bearing = np.arctan2(*np.diff(xy[corners], axis=0).T[::-1])
    bends: list[Feature] = []
    for row, angle in zip(corners[1:-1], np.diff(bearing), strict=True):
        turn, place = wrap(float(angle)), float(s[row])
        last = bends[-1] if bends else None
        same = last is not None and last.amount * turn > 0 and place - last.end < ONE_TURN
        if last is not None and same and abs(last.amount + turn) <= LARGEST_TURN:
            bends[-1] = Feature(last.kind, last.start, place, last.amount + turn)
        else:
            bends.append(Feature(FeatureKind.BEAR, place, place, turn))
    named = [
        Feature(FeatureKind.TURN if abs(b.amount) >= TURN else FeatureKind.BEAR, b.start, b.end, b.amount)
        for b in bends
    ]
    return [bend for bend in named if abs(bend.amount) >= BEAR]


def _straight_pieces(xy: FloatArray) -> list[int]:
    """Rows of the corners by Ramer, Douglas and Peucker, the ends included."""
    keep, stack = {0, len(xy) - 1}, [(0, len(xy) - 1)]
    while stack:
        a, b = stack.pop()
        if b - a < 2:
            continue
        chord, away = xy[b] - xy[a], xy[a + 1 : b] - xy[a]
        length = float(np.hypot(*chord))
        off = np.abs(chord[0] * away[:, 1] - chord[1] * away[:, 0]) / length if length > 0 else np.hypot(*away.T)
        if off.max() > STRAIGHTEN:
            middle = a + 1 + int(off.argmax())
            keep.add(middle)
            stack += [(a, middle), (middle, b)]
    return sorted(keep)


def find_steps(z: FloatArray, s: FloatArray) -> list[Feature]:
    """Single steps and stairs: where the ground rises or falls more steeply than anybody stands on."""
    found: list[Feature] = []
    for flight in find_flights(z, s):
        if len(flight) < FLIGHT:
            found += flight
        else:
            rise = float(np.mean([step.amount for step in flight]))
            found.append(Feature(FeatureKind.STAIRS, flight[0].start, flight[-1].end, rise, len(flight)))
    return found


def find_flights(z: FloatArray, s: FloatArray) -> list[list[Feature]]:
    """The steps of a path, those of one flight together."""
    steps: list[Feature] = []
    for first, last in _runs(_is_face(z, s)):
        for a, b in _same_sign(z, first, last):
            rise = float(z[b] - z[a])
            place = float(s[a] + s[b]) / 2
            if _repeats(steps, place, rise):
                steps.pop()
            elif abs(rise) >= LEAST_STEP:
                steps.append(Feature(FeatureKind.STEP, place, place, rise))
    flights: list[list[Feature]] = []
    for step in steps:
        joins = flights and step.start - flights[-1][-1].start <= TREAD and step.amount * flights[-1][-1].amount > 0
        if joins:
            flights[-1].append(step)
        else:
            flights.append([step])
    return flights


def _repeats(steps: list[Feature], place: float, rise: float) -> bool:
    """Whether a step is the last but one again, the last one back up: two levels that meet see it a cell apart."""
    if len(steps) < 2 or place - steps[-2].start >= FOOT:
        return False
    return max(abs(steps[-2].amount - rise), abs(steps[-1].amount + rise)) < LEAST_STEP


def _is_face(z: FloatArray, s: FloatArray) -> NDArray[np.bool_]:
    """Which segments between rows are a step's face, shape (n - 1,)."""
    face: NDArray[np.bool_] = np.abs(np.diff(z)) > STEEPEST_RAMP * np.diff(s)
    return face


def _same_sign(z: FloatArray, first: int, last: int) -> list[tuple[int, int]]:
    """A run of faces, cut where up becomes down."""
    up = np.diff(z[first : last + 1]) > 0
    cuts = [first, *(first + 1 + np.flatnonzero(up[1:] != up[:-1])).tolist(), last]
    return list(pairwise(cuts))


def find_ramps(z: FloatArray, s: FloatArray) -> list[Feature]:
    """Ramps: a slope that lasts, where there is no step."""
    rise = np.where(_is_face(z, s), 0.0, np.diff(z))
    smooth = np.concatenate([[0.0], np.cumsum(rise)])
    fine = np.linspace(s[0], s[-1], max(3, round(float(s[-1] - s[0]) / 0.1) + 1))
    slope = np.gradient(_averaged(np.interp(fine, s, smooth)), fine)
    found = []
    for sign in (1.0, -1.0):
        for a, b in _runs(sign * slope >= RAMP):
            b = min(b, len(fine) - 1)
            if fine[b] - fine[a] >= RAMP_LENGTH:
                height = float(np.interp(fine[b], s, smooth) - np.interp(fine[a], s, smooth))
                found.append(Feature(FeatureKind.RAMP, float(fine[a]), float(fine[b]), height))
    return found


def _averaged(values: FloatArray) -> FloatArray:
    """Mean over five samples, the ends held."""
    padded = np.pad(values, 2, mode="edge")
    averaged: FloatArray = np.convolve(padded, np.full(5, 0.2), mode="valid")
    return averaged


def find_narrow(width: FloatArray, s: FloatArray) -> list[Feature]:
    """Narrow passages, those that are close as one, and openings."""
    openings = find_openings(width, s)
    found: list[Feature] = []
    for a, b in _runs(width < NARROW):
        last = min(b, len(s)) - 1
        start, end, least = float(s[a]), float(s[last]), float(width[a : last + 1].min())
        if any(one.start <= start and end <= one.end for one in openings):
            continue
        if found and start - found[-1].end < ONE_PASSAGE:
            found[-1] = Feature(FeatureKind.NARROW, found[-1].start, end, min(found[-1].amount, least))
        else:
            found.append(Feature(FeatureKind.NARROW, start, end, least))
    return found + openings


def find_openings(width: FloatArray, s: FloatArray) -> list[Feature]:
    """Passages that are short and narrow between wider places: doors, and gaps that are felt like one."""
    found: list[Feature] = []
    for a, b in _runs(width < OPENING):
        last = min(b, len(s)) - 1
        start, end, least = float(s[a]), float(s[last]), float(width[a : last + 1].min())
        before, behind = (np.interp(at, s, width) for at in (start - BESIDE_OPENING, end + BESIDE_OPENING))
        inside = start - BESIDE_OPENING >= s[0] and end + BESIDE_OPENING <= s[-1]
        if inside and end - start <= OPENING and min(before, behind) >= least + BESIDE_OPENING:
            found.append(Feature(FeatureKind.OPENING, start, end, least))
    return found


def find_head_height(free: FloatArray, over: FloatArray, s: FloatArray) -> list[Feature]:
    """What hangs beside the path over the hip, where a cane finds nothing; amount 1 on the left, -1 on the right."""
    middle, found = free.shape[1] // 2, []
    hangs: NDArray[np.bool_] = (over > HEAD_EXCESS) & (free < HEAD_EXCESS)
    reach = round(HEAD_ROOM / 0.05)
    for side, columns in ((1.0, slice(middle, middle + reach + 1)), (-1.0, slice(middle - reach, middle + 1))):
        for a, b in _runs(np.any(hangs[:, columns], axis=1)):
            found.append(Feature(FeatureKind.HEAD, float(s[a]), float(s[min(b, len(s)) - 1]), side))
    return found


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index and the one after the last of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
