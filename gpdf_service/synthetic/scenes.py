"""The scenes: the paper's office with step and hanging ball, a cluttered office, a cow and a lady, a stair, a cave."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gpdf_service.synthetic.world import Box, Pillar, Shape, Sphere, World
from gpdf_service.types import BoolArray, FloatArray

SPACING = 0.03
"""[m] Between sampled points, where nothing else is asked for."""


@dataclass(frozen=True, slots=True)
class SyntheticScene:
    """A sampled world: points (n, 3) [m], ground labels (n,), a start and a goal in plan, and the truth."""

    name: str
    points: FloatArray
    ground: BoolArray
    start: tuple[float, float]
    goal: tuple[float, float]
    truth: World


Factory = Callable[..., SyntheticScene]


def _scene(
    name: str,
    world: World,
    start: tuple[float, float],
    goal: tuple[float, float],
    rng: np.random.Generator,
    noise: float,
    spacing: float,
) -> SyntheticScene:
    points, ground = world.sample(spacing, rng, noise)
    return SyntheticScene(name, points, ground, start, goal, world)


def table(x: float, y: float, width: float, depth: float, height: float = 0.74) -> list[Shape]:
    """A table top on four legs, its lower corner at (x, y) [m]."""
    top = Box((x, y, height - 0.03), (x + width, y + depth, height))
    legs = [
        Pillar((x + dx, y + dy, 0.0), 0.025, height - 0.03)
        for dx in (0.05, width - 0.05)
        for dy in (0.05, depth - 0.05)
    ]
    return [top, *legs]


def chair(x: float, y: float) -> list[Shape]:
    """A seat of 0.45 × 0.45 m at 0.45 m on a column, with a back; its lower corner at (x, y) [m]."""
    return [
        Box((x, y, 0.42), (x + 0.45, y + 0.45, 0.46)),
        Pillar((x + 0.225, y + 0.225, 0.0), 0.04, 0.42),
        Box((x, y + 0.41, 0.46), (x + 0.45, y + 0.45, 0.9)),
    ]


def office(rng: np.random.Generator, noise: float = 0.0, spacing: float = SPACING) -> SyntheticScene:
    """The paper's office 1: a step of 1 × 1.2 × 0.35 m at the side, and a ball that hangs 0.7 m over the floor."""
    shapes: list[Shape] = [
        Box((5.0, 1.6, 0.0), (6.0, 2.8, 0.35), walkable=True),
        Sphere((3.0, 2.9, 1.0), 0.3),
        *table(0.1, 3.1, 1.6, 0.8),
        *chair(0.7, 2.5),
        Box((2.2, 0.0, 0.0), (3.2, 0.4, 1.8)),
        *table(3.6, 3.9, 1.6, 0.8),
    ]
    return _scene("office", World((6.0, 5.0, 2.7), tuple(shapes)), (0.9, 0.9), (5.4, 3.4), rng, noise, spacing)


def cluttered_office(rng: np.random.Generator, noise: float = 0.0, spacing: float = SPACING) -> SyntheticScene:
    """Desks, chairs, shelves, and a couch across the room that only the Roomba fits under."""
    couch: list[Shape] = [Box((2.6, 2.2, 0.16), (4.6, 3.0, 0.42)), Box((2.6, 2.85, 0.42), (4.6, 3.0, 0.8))]
    couch += [Pillar((x, y, 0.0), 0.03, 0.16) for x in (2.65, 4.55) for y in (2.25, 2.95)]
    shapes: list[Shape] = [
        *couch,
        *table(0.0, 1.6, 1.3, 0.7),
        *chair(0.4, 2.4),
        *table(0.0, 3.9, 1.2, 0.8),
        Box((4.6, 2.2, 0.0), (5.0, 3.0, 2.0)),
        Box((1.6, 2.4, 0.0), (2.6, 2.9, 1.1)),
        *chair(4.9, 0.7),
        Box((6.2, 0.0, 0.0), (7.0, 0.5, 1.9)),
        *table(2.6, 4.6, 1.8, 0.8),
        *chair(3.2, 4.0),
    ]
    world = World((7.0, 6.0, 2.7), tuple(shapes))
    return _scene("cluttered_office", world, (3.6, 1.2), (3.6, 3.6), rng, noise, spacing)


def cow_and_lady(rng: np.random.Generator, noise: float = 0.0, spacing: float = SPACING) -> SyntheticScene:
    """A cow-sized body on four legs, a standing figure, a ladder-like rack and a table in a hall."""
    legs: list[Shape] = [Pillar((x, y, 0.0), 0.08, 0.8) for x in (2.2, 3.6) for y in (2.2, 2.7)]
    shapes: list[Shape] = [
        *legs,
        Box((2.0, 2.1, 0.8), (3.8, 2.8, 1.4)),
        Sphere((4.1, 2.45, 1.45), 0.28),
        Pillar((5.2, 3.6, 0.0), 0.22, 1.4),
        Sphere((5.2, 3.6, 1.55), 0.16),
        *table(1.0, 4.4, 1.6, 0.8),
        Box((6.4, 1.0, 0.0), (6.9, 2.4, 1.5)),
    ]
    return _scene("cow_and_lady", World((8.0, 6.0, 3.0), tuple(shapes)), (1.0, 1.0), (7.0, 5.0), rng, noise, spacing)


def stair(rng: np.random.Generator, noise: float = 0.0, spacing: float = SPACING) -> SyntheticScene:
    """Twenty treads of 0.17 × 0.29 m between walls, with a landing in the middle, at the foot and at the head."""
    shapes: list[Shape] = []
    x, z = 2.0, 0.0
    for i in range(20):
        depth = 1.2 if i == 9 else 0.29
        z += 0.17
        shapes.append(Box((x, 0.0, 0.0), (x + depth, 1.6, z), walkable=True))
        x += depth
    shapes.append(Box((x, 0.0, 0.0), (x + 2.0, 1.6, z), walkable=True))
    world = World((x + 2.0, 1.6, z + 2.5), tuple(shapes), ceiling=False)
    return _scene("stair", world, (0.8, 0.8), (x + 1.2, 0.8), rng, noise, spacing)


def cave(rng: np.random.Generator, noise: float = 0.0, spacing: float = 0.06) -> SyntheticScene:
    """Rough ground with slopes up to about 20°, rock pillars, and a ceiling that follows the ground."""
    phase = rng.uniform(0.0, 2 * np.pi, 4)

    def floor(xy: FloatArray) -> FloatArray:
        x, y = xy[:, 0], xy[:, 1]
        waves = 0.35 * np.sin(0.5 * x + phase[0]) * np.cos(0.4 * y + phase[1])
        rough = 0.03 * np.sin(2.1 * x + phase[2]) * np.sin(1.9 * y + phase[3])
        result: FloatArray = waves + rough
        return result

    shapes: list[Shape] = []
    for x, y in rng.uniform([3.0, 1.5], [17.0, 10.5], (9, 2)):
        shapes.append(Pillar((float(x), float(y), -1.0), float(rng.uniform(0.3, 0.8)), 5.0))
    world = World((20.0, 12.0, 3.2), tuple(shapes), floor)
    return _scene("cave", world, (1.2, 1.2), (18.8, 10.8), rng, noise, spacing)


def ramp(rng: np.random.Generator, noise: float = 0.0, spacing: float = SPACING) -> SyntheticScene:
    """A hall whose floor rises on a ramp of random slope (4° to 12°) to a gallery, with a table on either level."""
    slope, foot = np.tan(rng.uniform(0.07, 0.21)), rng.uniform(2.0, 3.0)
    run = rng.uniform(2.0, 4.0)

    def floor(xy: FloatArray) -> FloatArray:
        result: FloatArray = slope * np.clip(xy[:, 0] - foot, 0.0, run)
        return result

    length, high = foot + run + 2.5, float(slope * run)
    gallery = [Box((length - 1.5, 0.3, high + 0.71), (length - 0.3, 1.1, high + 0.74))]
    world = World((float(length), 4.0, 3.0), (*table(0.4, 2.8, 1.2, 0.8), *gallery), floor)
    return _scene("ramp", world, (0.6, 0.6), (float(length) - 0.6, 3.2), rng, noise, spacing)


def random_room(rng: np.random.Generator, noise: float = 0.0, spacing: float = SPACING) -> SyntheticScene:
    """A room of random size with random boxes, tables, chairs, pillars, hanging balls and a platform."""
    width, depth = rng.uniform(5.0, 9.0, 2)
    shapes: list[Shape] = []
    if rng.random() < 0.7:
        x, y = rng.uniform(0.0, width - 1.4), rng.uniform(0.0, depth - 1.6)
        shapes.append(Box((x, y, 0.0), (x + 1.2, y + 1.4, float(rng.uniform(0.08, 0.35))), walkable=True))
    for _ in range(int(rng.integers(4, 9))):
        x, y = rng.uniform(0.0, width - 1.6), rng.uniform(0.0, depth - 1.0)
        kind = rng.integers(4)
        made: list[Shape]
        if kind == 0:
            made = [Box((x, y, 0.0), (x + rng.uniform(0.3, 1.2), y + rng.uniform(0.3, 0.8), rng.uniform(0.5, 2.0)))]
        elif kind == 1:
            made = table(x, y, rng.uniform(0.9, 1.6), rng.uniform(0.6, 0.9))
        elif kind == 2:
            made = [Pillar((x + 0.3, y + 0.3, 0.0), rng.uniform(0.03, 0.3), 2.5)]
        else:
            made = [Sphere((x + 0.4, y + 0.4, rng.uniform(0.9, 1.8)), rng.uniform(0.15, 0.35))]
        if not any(isinstance(other, Box) and other.walkable and _near(made, other) for other in shapes):
            shapes += made
    world = World((float(width), float(depth), 2.6), tuple(shapes))
    return _scene("random_room", world, (0.5, 0.5), (float(width) - 0.5, float(depth) - 0.5), rng, noise, spacing)


def _near(made: list[Shape], platform: Box) -> bool:
    """Furniture on or across a platform's edge has no simple truth, so none is put there."""
    x, y = (0.5 * (platform.low[k] + platform.high[k]) for k in (0, 1))
    contact = np.array([[x, y, 0.0]])
    return min(float(shape.distance(contact, 3.0)[0]) for shape in made) < 1.3


SCENES: dict[str, Factory] = {
    "office": office,
    "cluttered_office": cluttered_office,
    "cow_and_lady": cow_and_lady,
    "stair": stair,
    "cave": cave,
}
