"""The world as it is for a simulated walker: the clean cloud, never the planner's picture of it; and people in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from gpdf_service.bench.judge import Judge
from gpdf_service.types import AGENTS, Agent, BoolArray, FloatArray

NEIGHBOURS = 8
"""Ground points that are looked at for the one that the walker can step onto."""
RISER = 0.22
"""[m] Of the steepest stairs: ground that is higher over other ground, and too low to stand under, covers it."""
COVERS = 0.1
"""[m] In plan, half of a foot: onto what is covered from so near nobody steps down, as the underside of a flight."""
LEVEL = 0.05
"""[m] Lower ground is a step down."""
OFF_GROUND = 0.6
"""[m] Further from any ground point, nobody knows what is under the walker; scans have smaller gaps between points."""


@dataclass(slots=True)
class WalkedWorld:
    """Ground under a walker, and what touches it; `fell` once it stepped off the ground or a drop.

    Attributes:
        judge: Holds the points.
        agent: Measures of the walker.
        fell: Whether it took more than its highest step, or left the ground.
    """

    judge: Judge
    agent: Agent
    fell: bool = False

    @classmethod
    def of(cls, points: FloatArray, ground: BoolArray, agent: Agent = AGENTS["human"]) -> WalkedWorld:
        """From a clean cloud and its labels, for a walker with these measures."""
        return cls(Judge(points, ground), agent)

    def ground_height(self, position: FloatArray) -> float:
        """Height of the ground under (x, y), on the storey of z [m]; what is higher than a step is over the walker."""
        rows = np.array(self.judge.ground_plan.query_ball_point(position[:2], OFF_GROUND), dtype=np.int64)
        rows = rows[self.judge.ground[rows, 2] <= position[2] + self.agent.max_step]
        away = np.hypot(*(self.judge.ground[rows, :2] - position[:2]).T)
        lower = position[2] - LEVEL
        open_ground = (row for row in rows[np.argsort(away)] if not self._is_covered(row, lower))
        z = np.array([self.judge.ground[row, 2] for row in islice(open_ground, NEIGHBOURS)])
        near = z[z >= position[2] - self.agent.max_step]
        if len(near) == 0:
            self.fell = True
            return float(z[0] if len(z) else position[2])
        return float(near[0])

    def _is_covered(self, row: int, lower: float) -> bool:
        """Whether this point is under a height [m], and other ground so low over it that nobody stands under that."""
        x, y, z = self.judge.ground[row]
        if z >= lower:
            return False
        over = self.judge.ground[self.judge.ground_plan.query_ball_point((x, y), COVERS), 2] - z
        return bool(((over > RISER) & (over < self.agent.height)).any())

    def penetration(self, position: FloatArray) -> float:
        """How deep the worst point is in the walker's cylinder [m]; inf after a fall."""
        return float("inf") if self.fell else self.judge.penetration(position, self.agent)


RADIUS = 0.25
"""[m] Of a person who moves through the scene."""
PACE = 1.2
"""[m/s] Of one who sees."""
YIELDS = 0.6
"""[m] Between the middles of two bodies: who sees stops before he comes nearer to who does not."""
PASSES = 0.54
"""[m] The same past one who has stood for long, where a stair leaves no more: two bodies and a hand's breadth."""
STOPS_IN = 1.0
"""[m] In which one stops who walks and does not see: nobody who sees steps in front of him nearer than this."""
SEEN_FROM = 5.0
"""[m] A sensor on the guided person sees people from here."""
RING = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
HEIGHTS = np.array([0.2, 0.7, 1.2, 1.7])
STOREY = 1.5
"""[m] Who is so much higher or lower is on another storey."""
ASIDE = np.radians([0, 45, -45, 90, -90])
"""[rad] So far from where he wants to go one goes who sees and finds somebody in his way."""
WAITS = 1.0
"""[s] One who has not got nearer to where he goes for so long goes elsewhere."""
POLITE = 8
"""Places that one who sees chooses from, to leave the way to who does not."""
STANDS = 3.0
"""[s] Who does not see and has stood for so long waits for those who do."""
LOOKS = np.linspace(0.25, 2.0, 8)
"""[m] So far he looks whether he gets there: nobody who sees walks into a wall to make way."""


@dataclass(slots=True)
class Crowd:
    """People who see, walking between places of a scene; they go round each other, and yield to the guided person.

    Attributes:
        places: Where each is, (k, 3) [m].
        ground: Height of the ground at (n, 3), of the storey of z, NaN where no body may stand [m], shape (n,).
        targets: Where each goes, (k, 3) [m].
        candidates: Places to go to, (n, 3) [m].
        rng: Chooses among them.
        waited: How long each has got no nearer to there [s], shape (k,).
        nearest: How near each has been to there [m], shape (k,).
        person: Where the guided person is, (3,) [m].
        stood: How long he has stood there [s].
        ahead: Where he walked last, a direction (2,).
    """

    places: FloatArray
    ground: Callable[[FloatArray], FloatArray]
    targets: FloatArray
    candidates: FloatArray
    rng: np.random.Generator
    waited: FloatArray
    nearest: FloatArray
    person: FloatArray
    stood: float = 0.0
    ahead: FloatArray = field(default_factory=lambda: np.zeros(2))

    @classmethod
    def of(
        cls, count: int, candidates: FloatArray, ground: Callable[[FloatArray], FloatArray], rng: np.random.Generator
    ) -> Crowd:
        """So many people at candidate places (n, 3) [m], or as many as have room beside each other."""
        places: list[FloatArray] = []
        for place in rng.permutation(candidates):
            if len(places) < count and all(np.hypot(*(place - one)[:2]) > 2 * RADIUS for one in places):
                places.append(place)
        targets = candidates[rng.integers(len(candidates), size=len(places))]
        nowhere = np.full(3, np.inf)
        return cls(
            np.array(places),
            ground,
            targets,
            candidates,
            rng,
            np.zeros(len(places)),
            np.full(len(places), np.inf),
            nowhere,
        )

    def move(self, now: float, period: float, person: FloatArray) -> None:
        """Walk on; who would come too near to the guided person, to a thing or to another one steps aside or waits."""
        step = (person - self.person)[:2]
        walks = bool(np.hypot(*step) > 1e-6)
        self.stood = 0.0 if walks else self.stood + period
        self.ahead = step / np.hypot(*step) if walks and np.isfinite(step).all() else self.ahead
        self.person = person.copy()
        for i in range(len(self.places)):
            away = self.targets[i] - self.places[i]
            left = float(np.hypot(*away[:2]))
            if left < 0.3 or self.waited[i] > WAITS:
                self.targets[i], self.waited[i], self.nearest[i] = self._elsewhere(i), 0.0, np.inf
                continue
            stepped = self._step(i, away[:2] / left, period)
            gap = left if stepped is None else float(np.hypot(*(self.targets[i] - stepped)[:2]))
            self.waited[i] = 0.0 if gap < self.nearest[i] else self.waited[i] + period
            self.nearest[i] = min(gap, self.nearest[i])
            self.places[i] = self.places[i] if stepped is None else stepped

    def _step(self, i: int, forward: FloatArray, period: float) -> FloatArray | None:
        """Where one gets to who goes in a direction, or aside where somebody is in his way; None where he waits."""
        for turn in ASIDE:
            c, s = np.cos(turn), np.sin(turn)
            move = PACE * period * np.array([c * forward[0] - s * forward[1], s * forward[0] + c * forward[1], 0.0])
            place: FloatArray = self.places[i] + move
            place[2] = self.ground(place[None])[0]
            if self._may_be(place, i):
                return place
        return None

    def _elsewhere(self, i: int) -> FloatArray:
        """A new place to go to, of a few: the one towards which one gets furthest from the person's way ahead.

        Where he has stood for long he waits for who is in his way, and that one goes wherever he gets furthest.
        """
        few = self.candidates[self.rng.integers(len(self.candidates), size=POLITE)]
        away = few[:, :2] - self.places[i, :2]
        forward = away / np.maximum(np.hypot(*away.T), 1e-9)[:, None]
        looks = self.places[i, :2] + LOOKS[:, None, None] * forward
        height = np.full((*looks.shape[:2], 1), self.places[i, 2])
        free = np.isfinite(self.ground(np.concatenate([looks, height], axis=2).reshape(-1, 3))).reshape(looks.shape[:2])
        least = PASSES if self.stood >= STANDS else YIELDS
        for body, gap in ((self.person, least), *((one, 2 * RADIUS) for one in np.delete(self.places, i, axis=0))):
            free &= np.hypot(*(looks - body[:2]).transpose(2, 0, 1)) > gap  # nobody sees a way through others
        gets = np.append(0.0, LOOKS)[np.logical_and.accumulate(free).sum(axis=0)]
        near = np.hypot(*(self.places[i, :2] - self.person[:2])) < SEEN_FROM
        if near and self.stood < STANDS:
            ends = self.places[i, :2] + gets[:, None] * forward
            gets = self._from_way(ends, SEEN_FROM)
        chosen: FloatArray = few[int(gets.argmax()) if near else 0]
        return chosen

    def _from_way(self, places: FloatArray, reach: float) -> FloatArray:
        """Distance of places (n, 2) from the guided person's way as far as `reach` ahead of him [m], shape (n,)."""
        away = places - self.person[:2]
        along = np.clip(away @ self.ahead, 0.0, reach)
        distance: FloatArray = np.hypot(*(away - along[:, None] * self.ahead).T)
        return distance

    def _may_be(self, place: FloatArray, i: int) -> bool:
        """Whether one may step there: beside the others, not in front of the person, and not nearer past him."""
        others = np.delete(self.places, i, axis=0)
        apart = (np.hypot(*(others - place)[:, :2].T) > 2 * RADIUS).all()
        step = np.array([place, self.places[i]])[:, :2]
        reaches = (0.0,) if self.stood else (0.0, STOPS_IN)
        gaps = (self._from_way(step, reach) for reach in reaches)
        least = PASSES if self.stood >= STANDS else YIELDS
        yields = all(next_to > least or next_to >= now for next_to, now in gaps)
        stands = abs(place[2] - self.places[i, 2]) <= AGENTS["human"].max_step  # not so where there is no ground
        return bool(apart and stands and yields)

    def points(self) -> FloatArray:
        """What the guided person's sensor sees of them, shape (k, 3) [m]."""
        seen = self.places[np.hypot(*(self.places - self.person)[:, :2].T) < SEEN_FROM]
        ring = RADIUS * np.column_stack([np.cos(RING), np.sin(RING), 0.0 * RING])
        up = np.column_stack([0.0 * HEIGHTS, 0.0 * HEIGHTS, HEIGHTS])
        points: FloatArray = (seen[:, None, None, :] + ring[None, :, None, :] + up[None, None]).reshape(-1, 3)
        return points

    def penetration(self, position: FloatArray) -> float:
        """How deep the nearest of them is in a walker at (x, y, z) [m]; 0 where none touches."""
        near = np.hypot(*(self.places[:, :2] - position[:2]).T)
        near = np.where(np.abs(self.places[:, 2] - position[2]) < STOREY, near, np.inf)
        return float(np.maximum(2 * RADIUS - near, 0.0).max(initial=0.0))


@dataclass(frozen=True, slots=True)
class Beset:
    """A world with people in it, as a `Truth`."""

    world: WalkedWorld
    crowd: Crowd

    def penetration(self, position: FloatArray) -> float:
        """How deep the worst point or person is in the walker [m]."""
        return max(self.world.penetration(position), self.crowd.penetration(position))
