"""Where ways for a person come from: the planning service, asked for level ways first and with room beside the body."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np
from gpdf_client import Client, ClientError, PlanResult, ServiceError, Status, Trajectory
from gpdf_schemas import Array, MovingObstacle
from numpy.typing import NDArray

from gpdf_guidance.corridor import FOOTING
from gpdf_guidance.features import FOOT, FeatureKind, find_flights
from gpdf_guidance.instruction import Kind
from gpdf_guidance.rails import AROUND, with_rails
from gpdf_guidance.route import Pose, Route, arc_length, build_route, join
from gpdf_guidance.stairs import LEAST_EDGE, SQUARE, find_stairs, obliqueness, places_to_stand
from gpdf_guidance.unseen import with_unseen

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Plan = Callable[[Any, Any, dict[str, Any]], PlanResult]

PERSON: dict[str, Any] = {
    "name": "person",
    "height": 2.0,
    "width": 0.5,
    "length": 0.32,
    "max_step": 0.37,
    "max_slope": float(np.radians(30)),
    "speed": 0.7,
    "acceleration": 0.6,
    "turn_rate": 1.5,
}
"""Measures of the service's "human" at a pace with a cane."""
LEVEL_STEP = 0.2
"""[m] A stair's riser is at most this high; a higher step is a ledge, which a person is led over if he agrees."""
DETOUR = (3.0, 30.0)
"""A way without a high step is taken up to so many times as long as one with it, or so much longer [m]."""
WIDER = (0.25, 0.15, 0.08, 0.0)
"""[m] On each side of the body a way is asked for with elbow room first; less is taken only where there is no other."""
HIP = 1.0
"""[m] What a cane finds ends here."""
LEAST_ROOM = 0.08
"""[m] On each side of the body, away from both ends: who sways more than this would touch."""
ROUNDS = 4
"""Ways at most: one that crosses a corner of the stairs shows their line roughly, one in that line exactly."""
HARDLY_LONGER = 1.2
"""Times as long a way may be that keeps off steps beside it."""
ENDS = 1.0
"""[m] A chair that one gets up from, a door that one goes to: there one is led through less."""
PULSE = 0.5
"""[s] For the planner to say that it is there: many times what it needs; with `PULSE_EVERY`, a stop within a second."""
LOOK = 3.0
"""[m] Around a person that asks what is around him: a few paces."""
LOOK_STEP = 0.1
"""[m] Between the places of a look."""
CELLS = 1_000_000
"""Of ground along a way that are fetched at most, 20 MB, where it leads over some that nobody saw."""

REFUSALS = {
    Status.START_OUTSIDE_MAP: Kind.NO_WAY_START,
    Status.START_OCCUPIED: Kind.NO_WAY_START,
    Status.GOAL_OUTSIDE_MAP: Kind.NO_WAY_GOAL,
    Status.GOAL_OCCUPIED: Kind.NO_WAY_GOAL,
    Status.NO_VALID_PATH: Kind.NO_WAY,
}
"""What a person is told of an answer; of others, that no safe way is found."""


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """A way, or why there is none.

    Attributes:
        route: The way; None where there is none.
        why: Why there is none, in the service's words.
        refusal: The same as what the person is told.
        room: Beside the body, where that is too little [m].
        highest: The highest step of the way, negative where it goes down [m].
        instead: A way without a step as high, which is longer than is taken unasked; None where there is none.
    """

    route: Route | None
    why: str = ""
    refusal: Kind = Kind.GAVE_UP
    room: float = 0.0
    highest: float = 0.0
    instead: Route | None = None


class Planner:
    """Asks the service for a way with as much room as there is, level first, and for the room beside it.

    Args:
        client: Connection to the service.
        scene: Name of the scene.
        person: Measures of the body, as a plan request takes them; with what it carries, and a little to spare.
    """

    def __init__(self, client: Client, scene: str, person: Mapping[str, Any] = PERSON) -> None:
        self._client, self.scene, self.person = client, scene, dict(person)

    def route(
        self, pose: Pose, goal: Sequence[float], climb: float = LEVEL_STEP, obstacles: FloatArray | None = None
    ) -> Planned:
        """The way from a pose.

        Args:
            pose: Where the person is.
            goal: (x, y) or (x, y, z of the ground) [m].
            climb: The highest step that the person has agreed to [m].
            obstacles: What is in the way and may not be known to the service, shape (k, 3) [m].
        """
        found = self._first_level(pose, goal, climb, obstacles)
        if found.route is None and obstacles is not None:  # what stands there may go; it is stopped for if it does not
            return self._first_level(pose, goal, climb, None)
        return found

    def _first_level(self, pose: Pose, goal: Sequence[float], climb: float, obstacles: FloatArray | None) -> Planned:
        most = float(self.person["max_step"])
        level = self._best(pose, goal, min(climb, most), obstacles)
        if most <= climb:
            return level
        crow = float(np.hypot(goal[0] - pose.position[0], goal[1] - pose.position[1]))
        if level.route is not None and level.route.length <= _detour(crow):  # no way is shorter than the crow's
            return level
        high = self._best(pose, goal, most, obstacles)
        if high.route is None or (level.route is not None and level.route.length <= _detour(high.route.length)):
            return level
        return replace(high, instead=level.route)

    def _best(self, pose: Pose, goal: Sequence[float], climb: float, obstacles: FloatArray | None) -> Planned:
        """The way with the most room beside it, over no step higher than `climb`."""
        best, askew, spare = Planned(None), inf, inf
        for wider in WIDER:
            if wider > max(spare, 0.0):
                continue
            answers: list[PlanResult] = []
            ask = self._asking(obstacles, answers)
            body = {**self.person, "width": self.person["width"] + 2 * wider, "max_step": climb}
            try:
                result = ask(pose.position, goal, body)
                spare = min(spare, spare_at_ends(result, wider))
                if result.status is not Status.OK or result.trajectory is None:
                    refused = Planned(None, result.message, REFUSALS.get(result.status, Kind.GAVE_UP))
                    best = best if best.route is not None else refused
                    continue
                result = replace(result, trajectory=self._off_steps(result.trajectory, ask))
                found, oblique = self._squarest(result, body, pose, ask)
                if found.route is not None:
                    found = replace(found, route=self._with_what_is_missed(found.route, answers))
            except ServiceError as error:  # it failed for this width
                best = best if best.route is not None else Planned(None, str(error))
                continue
            except ClientError as error:
                return Planned(None, str(error))
            if oblique < askew or best.route is None:
                best, askew = found, oblique
            if found.route is None or oblique <= SQUARE:  # with less width there is less room
                break
        return best

    def _asking(self, obstacles: FloatArray | None, answers: list[PlanResult]) -> Plan:
        """Asks the service for a way beside what was seen, and keeps its answers."""
        seen = () if obstacles is None else (_seen(obstacles),)

        def ask(start: Any, goal: Any, body: dict[str, Any]) -> PlanResult:  # noqa: ANN401 - as `Client.plan` takes it
            answers.append(self._client.plan(self.scene, start, goal, body, obstacles=seen))
            return answers[-1]

        return ask

    def _with_what_is_missed(self, route: Route, answers: Sequence[PlanResult]) -> Route:
        """A route with what the map misses there: of all answers that it was made of, what misses most."""
        proofs = [one.certificate for one in answers if one.certificate is not None]
        route = replace(route, hidden_height=max((one.hidden_height for one in proofs), default=0.0))
        if max((one.ground_spacing for one in proofs), default=0.0) <= FOOT:
            return route
        reach = route.radius + FOOT  # what is under the body, and what bridges it
        drawing = self._client.draw(self.scene, "ground", limit=CELLS, near=route.ground, reach=reach)
        cells, seen = drawing.places + drawing.origin, drawing.columns["inferred"] == 0.0
        return replace(route, features=with_unseen(route.features, route.ground, route.s, route.radius, cells, seen))

    def _off_steps(self, way: Trajectory, ask: Plan) -> Trajectory:
        """A way that takes no step: one that keeps off the steps beside it, where one is short enough.

        Where half a stance would be over an edge, that is as good as a step, and a detour is worth it.
        """
        path, s = way.ground, arc_length(way.ground)
        if any(abs(steps[0].amount) >= LEAST_EDGE for steps in find_flights(path[:, 2], s)):
            return way
        level = _level(self.person)
        room = float(self._room(level, path).min())
        longest = _detour(s[-1]) if room + level["width"] / 2 < FOOTING else HARDLY_LONGER * s[-1]
        spare = inf
        for wider in WIDER if room < LEAST_ROOM else ():
            if wider > max(spare, 0.0):
                continue
            result = ask(path[0].tolist(), path[-1].tolist(), {**level, "width": level["width"] + 2 * wider})
            found, spare = result.trajectory, min(spare, spare_at_ends(result, wider))
            if found is not None and arc_length(found.ground)[-1] <= longest:
                return found
        return way

    def _squarest(self, result: PlanResult, body: dict[str, Any], pose: Pose, ask: Plan) -> tuple[Planned, float]:
        """Of a way and those that meet its stairs more squarely the best with room enough; how oblique it is."""
        refused = Planned(None)
        assert result.trajectory is not None
        for way, oblique in self._squared(result.trajectory, body, ask):
            route = self._build(way, pose, result.scene_version)
            if not (tight := too_tight(route)):
                return Planned(route, highest=highest_step(route)), oblique
            refused = Planned(None, tight, Kind.NO_WAY_TIGHT, room_between(route))
        return refused, inf

    def _squared(self, trajectory: Trajectory, body: dict[str, Any], ask: Plan) -> list[tuple[Trajectory, float]]:
        """This way and others that meet its stairs more squarely, and how far from square [rad], the least first."""
        found: list[tuple[float, Trajectory]] = []
        for _ in range(ROUNDS):
            path, s = trajectory.ground, arc_length(trajectory.ground)
            flights = find_stairs(path, s, self._field, partial(self._room, self.person))
            found.append((obliqueness(path, s, flights), trajectory))
            stops = places_to_stand(path, s, flights, partial(self._room, body))
            if found[-1][0] <= SQUARE or (again := self._through([path[0], path[-1]], stops, body, ask)) is None:
                break
            trajectory = again
        return [(way, oblique) for oblique, way in sorted(found, key=lambda one: one[0])]

    def _through(
        self, ends: list[FloatArray], stops: list[tuple[FloatArray, bool]], body: dict[str, Any], ask: Plan
    ) -> Trajectory | None:
        """A way through places, from one to the next; where it need not climb, it does not touch a step."""
        legs: list[Trajectory] = []
        for (a, climbs), (b, begins) in pairwise([(ends[0], False), *stops, (ends[1], True)]):
            bodies = [body] if climbs or not begins else [_level(body), body]
            tries = (ask(a.tolist(), b.tolist(), one) for one in bodies)
            found = [one.trajectory for one in tries if one.status is Status.OK and one.trajectory]
            roomy = (one for one in found if self._room(self.person, one.ground).min() >= LEAST_ROOM)
            leg = next(roomy, found[-1] if found else None)
            if leg is None:
                return None
            legs.append(leg)
        return join(legs)

    def pulse(self) -> int | None:
        """The scene's version, as a sign that whoever plans in it is there; None without one within `PULSE`."""
        try:
            return self._client.distance(self.scene, "ground", np.zeros((1, 3)), deadline_s=PULSE).scene_version
        except ClientError:
            return None

    def where(self, place: str | Sequence[float]) -> list[float] | None:
        """Position of a place [m]; None where the scene has none of that name."""
        try:
            return self._client.where(self.scene, place)
        except ClientError:
            return None

    def places(self) -> dict[str, list[float]]:
        """The scene's named places [m]; none where nobody answers: nothing depends on them."""
        try:
            return self._client.places(self.scene)
        except ClientError:
            return {}

    def around(self, pose: Pose) -> tuple[float, ...]:
        """How far a person may go ahead, to the right, back and to the left [m], at most `LOOK`; empty if unknown."""
        turns = pose.heading - 0.5 * np.pi * np.arange(4)
        steps = np.arange(LOOK_STEP, LOOK + LOOK_STEP, LOOK_STEP)
        x, y, z = pose.position
        places = np.empty((4, len(steps), 3))
        places[..., 0] = x + np.cos(turns)[:, None] * steps
        places[..., 1] = y + np.sin(turns)[:, None] * steps
        places[..., 2] = z
        try:
            room = self._room({**self.person, "max_step": LEVEL_STEP}, places.reshape(-1, 3)).reshape(4, -1)
        except ClientError:
            return ()
        free = np.logical_and.accumulate(room > 0.0, axis=1).sum(axis=1)
        return tuple(float(LOOK if count == len(steps) else LOOK_STEP * count) for count in free)

    def _field(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = self._client.distance(self.scene, "ground", places)
        return np.where(found.valid, found.distance, np.inf), found.gradient

    def _build(self, trajectory: Trajectory, pose: Pose, version: int) -> Route:
        hip = {**self.person, "name": "to the hip", "height": HIP}
        room, low, radius = partial(self._room, self.person), partial(self._room, hip), self.person["width"] / 2
        route = build_route(
            trajectory,
            room,
            facing=pose.heading,
            room_low=low,
            room_level=partial(self._room, _level(self.person)),
            radius=radius,
            field=self._field,
            version=version,
            places=self.places(),
        )
        stairs = [one for one in route.features if one.kind is FeatureKind.STAIRS]
        if not stairs:
            return route
        on = np.any([(route.s >= one.start - AROUND) & (route.s <= one.end + AROUND) for one in stairs], axis=0)
        try:
            drawing = self._client.draw(self.scene, "cloud", near=route.ground[on], reach=AROUND)
        except ClientError:  # only handrails depend on it
            return route
        cloud = drawing.places + drawing.origin
        return replace(route, features=with_rails(route.features, route.ground, route.s, route.flights, cloud))

    def _room(self, body: dict[str, Any], places: FloatArray) -> FloatArray:
        found = self._client.distance(self.scene, "obstacle", places, body)
        room: FloatArray = found.distance - body["width"] / 2
        return room


def _level(body: dict[str, Any]) -> dict[str, Any]:
    """A body that takes no step."""
    return {**body, "max_step": LEAST_EDGE}


def spare_at_ends(result: PlanResult, wider: float) -> float:
    """Room on each side that both ends leave beside the bare body [m], of a body that is `wider`; inf if it fits there.

    To ask for a width costs a service seconds in a large scene, once: it looks where such a body fits at all.
    """
    told = result.details
    return wider - told["needed"] + told["room"] if "needed" in told else inf


def _detour(metres: float) -> float:
    """How long a way without a high step may be, where one with it is so long [m]."""
    return max(DETOUR[0] * metres, DETOUR[1] + metres)


def _seen(points: FloatArray) -> MovingObstacle:
    return MovingObstacle(id="seen by the guide", points=Array.pack(points))


def highest_step(route: Route) -> float:
    """The highest step of a route, negative where it goes down [m]; 0 on the level."""
    rises = [one.amount for one in route.features if one.kind in (FeatureKind.STEP, FeatureKind.STAIRS)]
    return max(rises, key=abs, default=0.0)


def room_between(route: Route) -> float:
    """The least room beside a person, away from both ends of a route [m]; inf on a short one."""
    between = (route.s > ENDS) & (route.s < route.length - ENDS)
    return float(route.room[between].min(initial=inf))


def too_tight(route: Route) -> str:
    """Why a route is no way for a person who cannot see; empty if it is one."""
    if (room := room_between(route)) >= LEAST_ROOM:
        return ""
    return (
        f"the best way found leaves {int(100 * max(room, 0.0))} cm beside the person at its narrowest, "
        f"and {100 * LEAST_ROOM:.0f} cm are needed."
    )
