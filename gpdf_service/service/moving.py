"""What moves in a scene: obstacles with a lifetime, merged with the scanned ones when somebody asks."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from gpdf_schemas import MovingObstacle
from gpdf_schemas.moving import MAX_POINTS, points_of, stacked

from gpdf_service.scene import Scene
from gpdf_service.types import FloatArray

MAX_LIFETIME_S = 3600.0
"""[s] What is there for longer belongs into the map."""
MAX_IN_ALL = 50 * MAX_POINTS
"""Points that move in all scenes together, 0.25 GB: anybody may publish under any scene's name, loaded or not yet."""
LEAST_OBSTACLE = 20
"""[points] That an obstacle counts for: its name, its lifetime and its array take as much room as so many."""
SWEEP_S = 1.0
"""[s] Between looks for what has ended in all scenes, when there is no room."""
MAX_ID = 256
"""[characters] Of an obstacle's name: four times a UUID."""
Clock = Callable[[], float]


@dataclass(frozen=True, slots=True)
class Living:
    """An obstacle that was published.

    Attributes:
        points: Where it is [m], (k, 3).
        until: When it ends, on `time.monotonic` [s].
        number: Of the publication; what has the same number is the same.
    """

    points: FloatArray
    until: float
    number: int


class Moving:
    """All moving obstacles of a service, by scene and id; safe for many threads.

    Args:
        clock: Monotonic seconds.
    """

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self._clock = clock
        self._living: dict[str, dict[str, Living]] = {}
        self._sizes: dict[str, int] = {}  # as they count; all together:
        self._total, self._swept = 0, -float("inf")
        self._merged: dict[str, tuple[Scene, tuple[int, ...], Scene]] = {}
        self._numbers = itertools.count()
        self._lock = threading.Lock()

    def publish(
        self, scene: str, obstacles: Sequence[MovingObstacle], told: Callable[[float], None] = lambda at: None
    ) -> None:
        """Take what somebody saw; each takes the place of the one before with its id.

        Args:
            scene: Where.
            obstacles: What.
            told: Told the moment [s] from which on whoever looks knows of it.

        Raises:
            ValueError: one has no sense or no room (the others are taken), or there is too much in the scene or in all
                scenes together (none is taken).
        """
        seen, wrong, room = dict[str, tuple[FloatArray, float]](), [], MAX_POINTS
        for obstacle in obstacles:
            if len(obstacle.id) > MAX_ID:
                wrong.append(f"an obstacle's id has {len(obstacle.id)} characters, at most {MAX_ID} are taken.")
                continue
            try:
                points = points_of(obstacle, room)
            except ValueError as error:
                wrong.append(str(error))
            else:
                seen[obstacle.id] = points, min(obstacle.lifetime_s, MAX_LIFETIME_S)
                room -= len(points)
        with self._lock:
            now = self._clock()
            new = {id_: Living(points, now + lasts, next(self._numbers)) for id_, (points, lasts) in seen.items()}
            living = {id_: one for id_, one in {**self._alive(scene, now), **new}.items() if one.until > now}
            self._admit(scene, living, now)
            self._set(scene, living)
        told(now)
        if wrong:
            raise ValueError(" ".join(wrong))

    def _admit(self, scene: str, living: Mapping[str, Living], now: float) -> None:
        """Refuse what is too much for a scene, or for all; what ended elsewhere is forgotten where it is in the way."""
        size = _size(living)
        if size > MAX_POINTS:
            words = f"more than {MAX_POINTS} points that move (an obstacle counts {LEAST_OBSTACLE} or more)"
            raise ValueError(f"scene {scene!r} would have {words}. Thin them.")
        if self._total + size - self._sizes.get(scene, 0) > MAX_IN_ALL and now - self._swept > SWEEP_S:
            self._swept = now
            for name in set(self._living) - {scene}:
                self._set(name, self._alive(name, now))
        if living and self._total + size - self._sizes.get(scene, 0) > MAX_IN_ALL:
            raise ValueError(f"scene {scene!r} and all others would have more than {MAX_IN_ALL} points that move.")

    def _set(self, scene: str, living: dict[str, Living]) -> None:
        self._total -= self._sizes.pop(scene, 0)
        self._living.pop(scene, None)
        if living:
            self._living[scene], self._sizes[scene] = living, _size(living)
            self._total += self._sizes[scene]

    def look(self, scene: str) -> tuple[float, dict[str, Living]]:
        """The moment [s], and what moves in a scene then, by the obstacle's id."""
        with self._lock:
            now = self._clock()
            return now, self._alive(scene, now)

    def merged(
        self, name: str, scene: Scene, more: Sequence[MovingObstacle] = (), living: Mapping[str, Living] | None = None
    ) -> Scene:
        """The scene with everything that moves in it now, or with what is `living`, and with `more`.

        Raises:
            ValueError: `more` has too many points, or no sense.
        """
        with self._lock:
            living = self._alive(name, self._clock()) if living is None else living
            numbers = tuple(one.number for one in living.values())
            known = self._merged.get(name)
            if known is None or known[0] is not scene or known[1] != numbers:
                whole = scene.with_obstacles(stacked([one.points for one in living.values()])) if numbers else scene
                known = (scene, numbers, whole)
                if numbers:
                    self._merged[name] = known  # its free spaces serve until something changes
                else:
                    self._merged.pop(name, None)
        if not more:
            return known[2]
        parts, room = list[FloatArray](), MAX_POINTS
        for obstacle in more:
            parts.append(points_of(obstacle, room))
            room -= len(parts[-1])
        return known[2].with_obstacles(stacked(parts))

    def living(self, scene: str) -> dict[str, Living]:
        """What moves in a scene now, by the obstacle's id."""
        return self.look(scene)[1]

    def replace(self, scene: str, living: dict[str, Living]) -> None:
        """Take over what another process knows of a scene; on one machine all have the same `time.monotonic`."""
        with self._lock:
            self._set(scene, living)

    def forget(self, scene: str) -> None:
        """The scene is gone, and what moved in it."""
        with self._lock:
            self._set(scene, {})
        self.let_go(scene)

    def kept(self, name: str, scene: Scene | None) -> Scene | None:
        """The merged scene, for the next plan, of this version of a scene; what was made of another one goes."""
        with self._lock:
            known = self._merged.get(name)
            if known is not None and known[0] is not scene:
                del self._merged[name]
                known = None
        return None if known is None else known[2]

    def let_go(self, scene: str) -> None:
        """Free the memory of the merged scene; what moves in it stays known."""
        with self._lock:
            self._merged.pop(scene, None)

    def points(self, scene: str) -> dict[str, FloatArray]:
        """Points of what moves in a scene now, by the obstacle's id."""
        return {id_: one.points for id_, one in self.living(scene).items()}

    def _alive(self, scene: str, now: float) -> dict[str, Living]:
        return {id_: one for id_, one in self._living.get(scene, {}).items() if one.until > now}


def _size(living: Mapping[str, Living]) -> int:
    """Points to hold, as they count."""
    return sum(max(LEAST_OBSTACLE, len(one.points)) for one in living.values())
