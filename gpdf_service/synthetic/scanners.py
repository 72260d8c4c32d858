"""Scanners in an exact world: on a tripod, carried along a walk, a depth camera, of profiles; and where rays began."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from gpdf_service.synthetic.place import Place
from gpdf_service.types import BoolArray, FloatArray, IntArray

BLIND = np.radians(30.0)
"""Half angle of the cone under a tripod that its scanner does not see."""
TRIPOD_EYE, HAND_EYE, CHEST_EYE = 1.6, 1.4, 1.3
"""[m] Of the scanner over the ground."""
NEXT_TO_STAIR = 0.8
"""[m] Nobody puts a tripod where everybody must pass."""
TRIPOD_STEP = np.radians(0.25)
"""[rad] Between two rays of a tripod: 1.7 cm in 4 m."""
BEAMS = 32
"""Of a lidar that is carried, spread over `BEAM_FAN`."""
BEAM_FAN = np.radians(45.0)
SWEEP = 720
"""Rays of a beam in one turn."""
EVERY = 0.4
"""[m] Of walk between two turns of the lidar, and between two pictures."""
PICTURE = (120, 90)
"""Pixels of a depth picture that are kept."""
VIEW = (np.radians(70.0), np.radians(55.0))
"""Field of view of a depth camera."""
PROFILE, PROFILE_EVERY = 1440, 0.1
"""Rays of a profile, and walk between two [m]: points lie in lines, near to each other on each."""
RANGE = {"tripod": 60.0, "handheld": 60.0, "depth": 5.0, "profile": 30.0}
"""[m] Farthest that each sees."""
NOISE = {"tripod": 0.002, "handheld": 0.006, "depth": 0.002, "profile": 0.004}
"""[m] Standard deviation along the ray, where nothing else is asked for; of a depth camera at 1 m, growing as the
square of the distance (Khoshelham and Elberink 2012)."""
Look = tuple[FloatArray, FloatArray]
"""Where the rays of one turn, or of one picture, begin, shape (3,), and their directions, shape (k, 3)."""
Progress = Callable[[float], None]
"""Is told which share of the rays is cast."""


@dataclass(frozen=True, slots=True)
class Scan:
    """What a scanner saw.

    Attributes:
        points: [m], shape (n, 3).
        origins: Where each one's ray began [m], shape (n, 3).
        ground: Which are truly ground, shape (n,).
        kind: What each truly is: an index into the world's `kinds`, shape (n,).
    """

    points: FloatArray
    origins: FloatArray
    ground: BoolArray
    kind: IntArray

    def thinned(self, width: float, rng: np.random.Generator) -> Scan:
        """One random point of each voxel of this width [m]."""
        order = rng.permutation(len(self.points))
        cell = np.floor(self.points[order] / width).astype(np.int64)
        cell -= cell.min(axis=0)
        size = cell.max(axis=0) + 1
        _, first = np.unique((cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2], return_index=True)
        return self.of(np.sort(order[first]))

    def centred(self, width: float) -> Scan:
        """Each point in the middle of its voxel of this width [m], as an occupancy map hands them on."""
        return replace(self, points=(np.floor(self.points / width) + 0.5) * width)

    def of(self, rows: IntArray | BoolArray) -> Scan:
        """Some of its points."""
        return Scan(self.points[rows], self.origins[rows], self.ground[rows], self.kind[rows])


def _nobody(done: float) -> None:
    """Nobody is told."""


def tripod(
    place: Place,
    rng: np.random.Generator,
    noise: float = NOISE["tripod"],
    stations: int = 2,
    progress: Progress = _nobody,
) -> Scan:
    """A scanner on so many places of every floor, one of them near the way's end there, and one on each landing."""
    feet = [*(_stations(place, room, stations, rng) for room in range(len(place.rooms))), place.landings]
    eyes = np.concatenate(feet) + np.array([0.0, 0.0, TRIPOD_EYE])
    return _scan(place, _told([(eye, _sphere(rng)) for eye in eyes], progress), noise, rng, "tripod")


def _stations(place: Place, room: int, count: int, rng: np.random.Generator) -> FloatArray:
    """Random places on a floor; the first is the one of them that is nearest to the end of the way there."""
    free = place.free_places(room, 20, rng)
    end = place.way[-1 if room else 0]
    off = np.hypot(*(free - end)[:, :2].T)
    first = int(np.where(off > NEXT_TO_STAIR, off, np.inf).argmin())
    return np.vstack([free[first], np.delete(free, first, axis=0)[: count - 1]])


def handheld(
    place: Place, rng: np.random.Generator, noise: float = NOISE["handheld"], progress: Progress = _nobody
) -> Scan:
    """A spinning lidar that somebody carries, tilted, over every floor and along the way between them."""
    feet, heading = _every(walk(place, rng))
    eyes = feet + np.array([0.0, 0.0, HAND_EYE])
    looks = [(e, _spin(h, rng)) for e, h in zip(eyes, heading, strict=True)]
    return _scan(place, _told(looks, progress), noise, rng, "handheld")


def depth(place: Place, rng: np.random.Generator, noise: float = NOISE["depth"], progress: Progress = _nobody) -> Scan:
    """A depth camera at the chest of somebody who walks, looking ahead and down, and to either side in turn."""
    feet, heading = _every(walk(place, rng))
    eyes = feet + np.array([0.0, 0.0, CHEST_EYE])
    yaw = heading + np.resize([0.0, 2.1, 0.0, -2.1], len(heading))
    looks = [(e, _picture(h, rng)) for e, h in zip(eyes, yaw, strict=True)]
    return _scan(place, _told(looks, progress), noise, rng, "depth")


def profile(
    place: Place, rng: np.random.Generator, noise: float = NOISE["profile"], progress: Progress = _nobody
) -> Scan:
    """A scanner of profiles that somebody carries: each is a plane across the way, which sees straight down, too."""
    feet, heading = _every(walk(place, rng), PROFILE_EVERY)
    turn = 2 * np.pi * (np.arange(PROFILE) + rng.random()) / PROFILE
    rays = np.column_stack([np.zeros(PROFILE), np.sin(turn), -np.cos(turn)])
    eyes = feet + np.array([0.0, 0.0, HAND_EYE])
    looks = [(e, _turned(rays, 0.0, 0.0, h)) for e, h in zip(eyes, heading, strict=True)]
    return _scan(place, _told(looks, progress), noise, rng, "profile")


SCANNERS: dict[str, Callable[..., Scan]] = {"tripod": tripod, "handheld": handheld, "depth": depth, "profile": profile}


def walk(place: Place, rng: np.random.Generator) -> list[FloatArray]:
    """Feet of somebody who carries a scanner, (n, 3) each [m]: out and back on every floor, and on the way."""
    if len(place.way) > 1:
        back = _excursions(place, len(place.rooms) - 1, place.way[-1], rng)
        return [np.array([*_excursions(place, 0, place.way[0], rng), *place.way, *back])]
    homes = [place.way[0], *(place.free_places(room, 1, rng)[0] for room in range(1, len(place.rooms)))]
    return [np.array(_excursions(place, room, home, rng)) for room, home in enumerate(homes)]


def _excursions(place: Place, room: int, home: FloatArray, rng: np.random.Generator) -> list[FloatArray]:
    """From home to places that can be walked to straight, from one to the next, and back."""
    path, here = [home], home
    for there in place.free_places(room, 30, rng):
        if len(path) < 8 and place.sees(here, there) and np.hypot(*(there - here)[:2]) > 0.5:
            path.append(there)
            here = there
    return [*path, *path[-2::-1]]


def _every(walks: list[FloatArray], every: float = EVERY) -> tuple[FloatArray, FloatArray]:
    """Places so far from each other along walks [m], and the heading there [rad]."""
    feet, heading = [], []
    for path in walks:
        ahead = np.diff(path, axis=0)
        step = np.linalg.norm(ahead, axis=1)
        along = np.concatenate([[0.0], np.cumsum(step)])
        s = np.arange(0.0, along[-1] + 1e-9, every)
        feet.append(np.column_stack([np.interp(s, along, column) for column in path.T]))
        leg = np.clip(np.searchsorted(along, s, side="right") - 1, 0, max(len(step) - 1, 0))
        heading.append(np.arctan2(ahead[leg, 1], ahead[leg, 0]) if len(step) else np.zeros(len(s)))
    return np.concatenate(feet), np.concatenate(heading)


def _sphere(rng: np.random.Generator) -> FloatArray:
    """Rays of a tripod, all around but straight down."""
    down = np.arange(BLIND, np.pi, TRIPOD_STEP)
    turn = np.arange(0.0, 2 * np.pi, TRIPOD_STEP) + rng.uniform(0.0, TRIPOD_STEP)
    down, turn = (axis.ravel() for axis in np.meshgrid(down, turn))
    return np.column_stack([np.sin(down) * np.cos(turn), np.sin(down) * np.sin(turn), -np.cos(down)])


def _spin(heading: float, rng: np.random.Generator) -> FloatArray:
    """Rays of one turn of a lidar whose axis leans forward by about 30°, as a hand holds it."""
    fan = np.linspace(-0.5 * BEAM_FAN, 0.5 * BEAM_FAN, BEAMS)
    turn = 2 * np.pi * (np.arange(SWEEP) + rng.random()) / SWEEP
    fan, turn = (axis.ravel() for axis in np.meshgrid(fan, turn))
    rays = np.column_stack([np.cos(fan) * np.cos(turn), np.cos(fan) * np.sin(turn), np.sin(fan)])
    return _turned(rays, np.radians(30.0) + rng.normal(0.0, 0.15), rng.normal(0.0, 0.1), heading + rng.normal(0.0, 0.1))


def _picture(heading: float, rng: np.random.Generator) -> FloatArray:
    """Rays of the pixels of a camera that looks ahead and 30° down."""
    y, z = (np.tan(0.5 * view) * np.linspace(-1.0, 1.0, n) for view, n in zip(VIEW, PICTURE, strict=True))
    y, z = (axis.ravel() for axis in np.meshgrid(y, z))
    rays = np.column_stack([np.ones(len(y)), y, z])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return _turned(rays, np.radians(30.0) + rng.normal(0.0, 0.1), rng.normal(0.0, 0.03), heading)


def _turned(rays: FloatArray, pitch: float, roll: float, yaw: float) -> FloatArray:
    """Rays after rolling about x, then pitching down about y, then turning about z [rad]."""
    for angle, (i, j) in ((roll, (1, 2)), (pitch, (2, 0)), (yaw, (0, 1))):
        c, s = np.cos(angle), np.sin(angle)
        T = np.eye(3)
        T[i, i], T[i, j], T[j, i], T[j, j] = c, -s, s, c
        rays = rays @ T.T
    return rays


def _told(looks: list[Look], progress: Progress) -> Iterator[Look]:
    """All looks; after each of them, which share of them was taken."""
    for i, look in enumerate(looks, 1):
        yield look
        progress(i / len(looks))


def _scan(place: Place, looks: Iterable[Look], noise: float, rng: np.random.Generator, scanner: str) -> Scan:
    """Cast all rays of all looks, (3,) and (k, 3) each, and put noise along them."""
    parts = [_look(place, eye, rays, RANGE[scanner]) for eye, rays in looks]
    eyes, rays, distance, triangle = (np.concatenate(column) for column in zip(*parts, strict=True))
    spread = noise * distance**2 if scanner == "depth" else np.full(len(distance), noise)
    measured = distance + spread * rng.normal(size=len(distance))
    world = place.world
    return Scan(eyes + measured[:, None] * rays, eyes, world.walkable[triangle], world.kind[triangle])


def _look(
    place: Place, eye: FloatArray, rays: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    hits = place.world.cast(np.broadcast_to(eye, rays.shape), rays)
    seen = (hits.distance < reach) & (hits.triangle >= 0)
    return np.broadcast_to(eye, rays.shape)[seen], rays[seen], hits.distance[seen], hits.triangle[seen]
