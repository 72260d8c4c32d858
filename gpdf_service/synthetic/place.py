"""A place to scan and to judge: its exact world, its floors, and a way through it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.synthetic.solid_world import SolidWorld
from gpdf_service.types import FloatArray

EYES = (0.15, 0.8, 1.6)
"""[m] Over the ground: heights at which somebody who walks needs room."""
SEEN = 0.06
"""[m] Floor with a point within this everywhere was seen."""
AROUND = 24
"""Directions in which room is looked for."""


@dataclass(frozen=True, slots=True)
class Place:
    """A place.

    Attributes:
        name: Its kind.
        world: What is there.
        rooms: Floors that a scanner is carried over: corners in order, (4, 3) each [m].
        way: Where one walks from the first of them to the last, shape (n, 3) [m]; one row where there is one floor.
        landings: Places on that way where a tripod stands as well, (k, 3) [m].
        islands: Ground that no way leads to, corners in order, (4, 3) each [m].
    """

    name: str
    world: SolidWorld
    rooms: tuple[FloatArray, ...]
    way: FloatArray
    landings: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    islands: tuple[FloatArray, ...] = ()

    def free_places(self, room: int, count: int, rng: np.random.Generator, least: float = 0.4) -> FloatArray:
        """Random places on a floor with `least` of room around somebody who stands there, (≤ count, 3) [m]."""
        a, b, _, d = self.rooms[room]
        uv = rng.uniform(0.02, 0.98, (40 * count, 2))
        places = a + uv[:, :1] * (b - a) + uv[:, 1:] * (d - a)
        ground = self.world.ground_under(places + np.array([0.0, 0.0, 0.05]), 0.1)
        places = places[np.isfinite(ground)]
        free: FloatArray = places[self.room_around(places) >= least][:count]
        return free

    def seen_end(self, room: int, ground: FloatArray, rng: np.random.Generator) -> FloatArray:
        """A free place on a floor whose ground was seen, the nearest of some to the end of the way, (3,) [m].

        Args:
            room: 0, or the last one.
            ground: Points of the scan that are ground [m], shape (n, 3).
            rng: Source of the places that are tried.
        """
        end = self.way[-1 if room else 0]
        tried = np.vstack([end, self.free_places(room, 60, rng)])
        tree = cKDTree(ground)
        turn = 2 * np.pi * np.arange(AROUND) / AROUND
        rim = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(AROUND)])
        disc = np.vstack([np.zeros(3), 0.15 * rim, 0.3 * rim])
        gap = tree.query((tried[:, None] + disc).reshape(-1, 3))[0].reshape(len(tried), -1).max(axis=1)
        seen = tried[gap < SEEN]
        if len(seen) == 0:
            return np.asarray(end)
        nearest: FloatArray = seen[np.hypot(*(seen - end)[:, :2].T).argmin()]
        return nearest

    def room_around(self, places: FloatArray) -> FloatArray:
        """Free way in every direction from somebody who stands at places (m, 3) [m], shape (m,)."""
        turn = 2 * np.pi * np.arange(AROUND) / AROUND
        ray = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(AROUND)])
        room = np.full(len(places), np.inf)
        for eye in EYES:
            began = np.repeat(places + np.array([0.0, 0.0, eye]), AROUND, axis=0)
            distance = self.world.cast(began, np.tile(ray, (len(places), 1))).distance
            room = np.minimum(room, distance.reshape(-1, AROUND).min(axis=1))
        return room

    def sees(self, a: FloatArray, b: FloatArray, half_width: float = 0.3) -> bool:
        """Whether somebody can walk straight from `a` to `b`, (3,) each on one floor."""
        ahead = (b - a)[:2] / max(float(np.hypot(*(b - a)[:2])), 1e-9)
        aside = half_width * np.array([-ahead[1], ahead[0], 0.0])
        began = np.array([a + s * aside + np.array([0.0, 0.0, eye]) for s in (-1, 0, 1) for eye in EYES])
        rays = np.tile([*ahead, 0.0], (len(began), 1))
        return bool((self.world.cast(began, rays).distance > np.hypot(*(b - a)[:2]) + half_width).all())
