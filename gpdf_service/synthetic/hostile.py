"""Clouds that nobody should send, and somebody does: wrong units, outliers, rounding, a few points over kilometres."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from gpdf_service.types import BoolArray, FloatArray


class Hostile(NamedTuple):
    """A cloud [m], shape (n, 3), and which points are called ground, shape (n,), or None."""

    name: str
    points: FloatArray
    ground: BoolArray | None


def _room(rng: np.random.Generator, count: int = 20_000) -> FloatArray:
    """A room of 4 × 4 m with a floor and two walls, the floor first."""
    points = rng.uniform(0.0, 4.0, (count, 3))
    points[: count // 2, 2] = 0.0
    points[count // 2 : 3 * count // 4, 0] = 4.0
    points[3 * count // 4 :, 1] = 4.0
    return points


def _few_and_far(rng: np.random.Generator) -> FloatArray:
    points = rng.uniform(0.0, rng.uniform(500.0, 4900.0), (int(rng.integers(4, 600)), 3))
    points[:, 2] = 0.0
    return points


def _corners(rng: np.random.Generator) -> FloatArray:
    side = rng.uniform(300.0, 4990.0)
    return np.array([[x, y, 0.0] for x in (0.0, side) for y in (0.0, side)])


def _millimetres(rng: np.random.Generator) -> FloatArray:
    return 1000.0 * _room(rng) * rng.uniform(0.1, 1.0)


def _outlier(rng: np.random.Generator) -> FloatArray:
    far = rng.uniform(-4900.0, 4900.0, (int(rng.integers(1, 5)), 3)) * [[0.5, 0.5, 0.01]]
    return np.concatenate([_room(rng), far])


def _not_finite(rng: np.random.Generator) -> FloatArray:
    points = _room(rng)
    points[rng.integers(0, len(points), 50), rng.integers(0, 3)] = rng.choice([np.nan, np.inf, -np.inf])
    return points


def _duplicates(rng: np.random.Generator) -> FloatArray:
    return np.repeat(rng.uniform(0.0, 50.0, (int(rng.integers(1, 60)), 3)), 2000, axis=0)


def _line(rng: np.random.Generator) -> FloatArray:
    ends = rng.uniform(-2400.0, 2400.0, (2, 3)) * rng.choice([0.0, 0.01, 1.0], 3)
    made: FloatArray = ends[0] + rng.uniform(0.0, 1.0, (50_000, 1)) * (ends[1] - ends[0])
    return made


def _single_precision(rng: np.random.Generator) -> FloatArray:
    far = np.array([rng.uniform(2e5, 8e5), rng.uniform(1e6, 9e6), 300.0])
    made: FloatArray = (_room(rng) + far).astype(np.float32).astype(np.float64)
    return made


def _two_places(rng: np.random.Generator) -> FloatArray:
    apart = rng.uniform(50.0, 3000.0, 3) * [1.0, 1.0, 0.01]
    return np.concatenate([_room(rng), _room(rng) + apart])


def _stacked(rng: np.random.Generator) -> FloatArray:
    """Sheets over sheets, each of them a level."""
    sheets = int(rng.integers(20, 60))
    points = rng.uniform(0.0, rng.uniform(5.0, 400.0), (40_000, 3))
    points[:, 2] = 2.5 * rng.integers(0, sheets, len(points))
    return points


KINDS: dict[str, Callable[[np.random.Generator], FloatArray]] = {
    "few and far": _few_and_far,
    "corners": _corners,
    "millimetres": _millimetres,
    "outlier": _outlier,
    "not finite": _not_finite,
    "duplicates": _duplicates,
    "line": _line,
    "single precision": _single_precision,
    "two places": _two_places,
    "stacked": _stacked,
}


def hostile_clouds(count: int, seed: int = 0) -> list[Hostile]:
    """So many clouds, of each kind in turn; every other one of a kind has all low points called ground."""
    made = []
    for i in range(count):
        name, make = list(KINDS.items())[i % len(KINDS)]
        points = make(np.random.default_rng((seed, i)))
        labelled = (i // len(KINDS)) % 2 == 0
        low = points[:, 2] <= np.nanquantile(points[:, 2], 0.5)
        made.append(Hostile(f"{name} {i // len(KINDS)}", points, low if labelled else None))
    return made
