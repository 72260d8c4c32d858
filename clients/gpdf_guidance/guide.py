"""The guide of one person to one goal: plans, advises, chooses what to say, plans again, knows when to give up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np
from gpdf_client import Client, ClientError, ServiceError, Status, Trajectory
from gpdf_schemas import CueAction, CueMessage
from numpy.typing import NDArray

from gpdf_guidance.advice import BLIND, LEAST_OBSTACLE, PACES, Advice, advise, stop
from gpdf_guidance.ahead import is_hidden_step
from gpdf_guidance.announcer import Announcer
from gpdf_guidance.belief import Belief, believe
from gpdf_guidance.catalogue import phrase
from gpdf_guidance.instruction import Instruction, Kind, Urgency
from gpdf_guidance.route import Pose, Progress, Route, arc_length, build_route, join
from gpdf_guidance.stairs import LEAST_EDGE, SQUARE, find_stairs, obliqueness, places_to_stand
from gpdf_guidance.trust import doubt

FloatArray = NDArray[np.float64]

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
WIDER = (0.25, 0.15, 0.08, 0.0)
"""[m] On each side of the body a way is asked for with elbow room first; less is taken only where there is no other."""
HIP = 1.0
"""[m] What a cane finds ends here."""
LEAST_ROOM = 0.08
"""[m] On each side of the body, away from both ends: who sways more than this would touch."""
ROUNDS = 4
"""Ways at most: one that crosses a corner of the stairs shows their line roughly, one in that line exactly."""
ENDS = 1.0
"""[m] A chair that one gets up from, a door that one goes to: there one is led through less."""
STALLED = 30.0
"""[s] Without half a metre of progress another way is asked for."""
PATIENCE = 3.0
"""[s] Off the way, held up, or facing nothing that is safe: after this another way is asked for."""
OFF_WAY = 0.5
"""[s] The same when the person has left the corridor: he stands by then."""
TRIES = 6
"""Ways that are asked for without half a metre of progress between them."""
LOST = 30.0
"""[s] Without a good pose the guide gives up."""
WAITING = {Kind.STOP_LOST: 2.0, Kind.STOP_OFF_WAY: 2.0, Kind.STOP_UNRELIABLE: 0.4}
"""[s] The cue says stop at once; one that is over within this is felt and not spoken, if somebody feels the cues. Poses
that are missing mostly come again; those that cannot be true are spoken of within half a second."""
STOPS = (*WAITING, Kind.STOP_ALONE, Kind.STOP_OBSTACLE)
"""After these a person waits to be told to go on."""
BRAKES = PACES[0] / BLIND
"""[m/s²] A pace that was told is thought to last this long after a slower one."""
PULSE = 0.5
"""[s] For the planner to say that it is there: many times what it needs; with `PULSE_EVERY`, a stop within a second."""


class Outcome(StrEnum):
    """How a guided walk stands."""

    WALKING = "walking"
    ARRIVED = "arrived"
    SAFE_STOP = "safe stop"


@dataclass(slots=True)
class _Waiting:
    """Since when something keeps the person from walking [s], and where another way was last asked for."""

    since: float | None = None
    tries: int = 0
    at: FloatArray = field(default_factory=lambda: np.full(3, np.inf))


class Planner:
    """Asks the service for a way with as much room as there is, and for the room beside it.

    Args:
        client: Connection to the service.
        scene: Name of the scene.
        person: Measures of the body, as a plan request takes them; with what it carries, and a little to spare.
    """

    def __init__(self, client: Client, scene: str, person: Mapping[str, Any] = PERSON) -> None:
        self._client, self.scene, self.person = client, scene, dict(person)

    def route(self, pose: Pose, goal: Sequence[float]) -> tuple[Route | None, str]:
        """The route from a pose, or why there is none."""
        why, best, askew = "", None, inf
        for wider in WIDER:
            body = {**self.person, "width": self.person["width"] + 2 * wider}
            try:
                result = self._client.plan(self.scene, pose.position, goal, body)
                if result.status is not Status.OK or result.trajectory is None:
                    why = result.message
                    continue
                route, oblique, why = self._squarest(result.trajectory, body, pose, result.scene_version)
                if route is not None and result.certificate is not None:
                    route = replace(route, hidden_height=result.certificate.hidden_height)
            except ServiceError as error:  # it failed for this width
                why = str(error)
                continue
            except ClientError as error:
                return None, str(error)
            if oblique < askew:
                best, askew = route, oblique
            if route is None or oblique <= SQUARE:  # with less width there is less room
                break
        return best, "" if best else why

    def _squarest(
        self, trajectory: Trajectory, body: dict[str, Any], pose: Pose, version: int
    ) -> tuple[Route | None, float, str]:
        """Of a way and those that meet its stairs more squarely the best with room enough; how oblique; why none."""
        tight = ""
        for way, oblique in self._squared(trajectory, body):
            route = self._build(way, pose, version)
            if not (tight := too_tight(route)):
                return route, oblique, ""
        return None, inf, tight

    def _squared(self, trajectory: Trajectory, body: dict[str, Any]) -> list[tuple[Trajectory, float]]:
        """This way and others that meet its stairs more squarely, and how far from square [rad], the least first."""
        found: list[tuple[float, Trajectory]] = []
        for _ in range(ROUNDS):
            path, s = trajectory.ground, arc_length(trajectory.ground)
            flights = find_stairs(path, s, self._field, partial(self._room, self.person))
            found.append((obliqueness(path, s, flights), trajectory))
            stops = places_to_stand(path, s, flights, partial(self._room, body))
            if found[-1][0] <= SQUARE or (again := self._through(path[0], stops, path[-1], body)) is None:
                break
            trajectory = again
        return [(way, oblique) for oblique, way in sorted(found, key=lambda one: one[0])]

    def _through(
        self, start: FloatArray, stops: list[tuple[FloatArray, bool]], goal: FloatArray, body: dict[str, Any]
    ) -> Trajectory | None:
        """A way through places, from one to the next; where it need not climb, it does not touch a step."""
        level = {**body, "name": "on the level", "max_step": LEAST_EDGE}
        legs: list[Trajectory] = []
        for (a, climbs), (b, begins) in pairwise([(start, False), *stops, (goal, True)]):
            bodies = [body] if climbs or not begins else [level, body]
            tries = (self._client.plan(self.scene, a.tolist(), b.tolist(), one) for one in bodies)
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

    def _field(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = self._client.distance(self.scene, "ground", places)
        return np.where(found.valid, found.distance, np.inf), found.gradient

    def _build(self, trajectory: Trajectory, pose: Pose, version: int) -> Route:
        hip = {**self.person, "name": "to the hip", "height": HIP}
        room, low, radius = partial(self._room, self.person), partial(self._room, hip), self.person["width"] / 2
        return build_route(
            trajectory, room, facing=pose.heading, room_low=low, radius=radius, field=self._field, version=version
        )

    def _room(self, body: dict[str, Any], places: FloatArray) -> FloatArray:
        found = self._client.distance(self.scene, "obstacle", places, body)
        room: FloatArray = found.distance - body["width"] / 2
        return room


def too_tight(route: Route) -> str:
    """Why a route is no way for a person who cannot see; empty if it is one."""
    between = (route.s > ENDS) & (route.s < route.length - ENDS)
    if not between.any() or (room := float(route.room[between].min())) >= LEAST_ROOM:
        return ""
    return (
        f"the best way found leaves {int(100 * max(room, 0.0))} cm beside the person at its narrowest, "
        f"and {100 * LEAST_ROOM:.0f} cm are needed."
    )


class Guide:
    """Leads one person; fed with poses and asked for cues. Holds no thread and no clock.

    Args:
        planner: Where routes come from.
        goal: (x, y) or (x, y, z of the ground) [m].
        language: Of the sentences.
        unit: "metres" or "steps".

    Attributes:
        felt: Whether somebody feels the cues; if not, every stop is spoken at once.
    """

    def __init__(self, planner: Planner, goal: Sequence[float], language: str = "en", unit: str = "metres") -> None:
        self.planner, self.goal = planner, tuple(map(float, goal))
        self.route: Route | None = None
        self.outcome, self.reason = Outcome.WALKING, ""
        self.routes: list[Route] = []
        self.obstacles: FloatArray | None = None
        self._announcer = Announcer(lambda instruction: phrase(instruction, language, unit))
        self._s, self._waiting, self._told_to_stop = 0.0, _Waiting(), False
        self._moved, self._moved_at = 0.0, np.full(2, np.inf)
        self._trusted: Pose | None = None
        self._belief: Belief | None = None
        self._pace = 0.0
        self._off_way, self._alone, self._version = False, False, 0
        self.felt = True
        self._then, self._clock = float("inf"), 0.0  # time that goes back is none

    def see(self, obstacles: FloatArray | None) -> None:
        """Tell of things that stand in the scene and that the service does not know, shape (k, 3) [m]."""
        self.obstacles = obstacles

    def hear(self, version: int | None) -> None:
        """Tell which version the scene has, as `Planner.pulse` says it; None stops the person: nobody plans for him."""
        self._alone, self._version = version is None, version or self._version

    def step(self, pose: Pose | None, now: float) -> tuple[CueMessage, tuple[Instruction, str] | None]:
        """What to do and what to say now. Quick: it asks the service nothing.

        Args:
            pose: The newest pose; None before the first.
            now: On the clock of its stamp [s].
        """
        went_on = max(0.0, now - self._then)
        self._clock, self._then = self._clock + went_on, now
        advice = self._advise(pose, now)
        self._notice(advice)
        said = self._announcer.choose(self._worth_saying(advice), self._clock)
        if said is not None:
            self._told_to_stop = said[0].kind in STOPS
        if any(is_hidden_step(one) and not self._announcer.has_told(one, self._clock) for one in advice.instructions):
            advice = replace(advice, action=CueAction.STOP, pace=0.0)  # nobody goes towards a step unheard
        self._pace = max(advice.pace, self._pace - BRAKES * went_on)
        cue = CueMessage(
            action=advice.action,
            direction=advice.direction,
            urgency=advice.urgency,
            pace=advice.pace,
            distance=0.0 if self.route is None else self.route.length - advice.progress.s,
            stamp=now,
            pose_stamp=0.0 if self._trusted is None else self._trusted.stamp,
        )
        return cue, said

    def _advise(self, pose: Pose | None, now: float) -> Advice:
        here = Progress(self._s, 0.0)
        if self.outcome is Outcome.SAFE_STOP:
            return stop(here, Instruction(Kind.GAVE_UP, Urgency.DANGER))
        if self._alone:
            return stop(here, Instruction(Kind.STOP_ALONE, Urgency.DANGER))
        if pose is None:
            return stop(here, Instruction(Kind.STOP_LOST, Urgency.DANGER))
        if (reason := doubt(pose, self._trusted, now)) is not None:
            return stop(here, reason)
        if self._belief is None or pose is not self._trusted:
            self._belief = believe(self._belief, pose, self._pace)
        self._trusted = pose
        if self.route is None:
            return Advice(here, CueAction.STOP)
        if self._version > self.route.version:
            return stop(here, Instruction(Kind.STOP_OFF_WAY, Urgency.DANGER), off_way=True)
        advice = advise(self.route, self._belief.pose, now, near=self._s, obstacles=self.obstacles)
        self._s = advice.progress.s
        return advice

    def _worth_saying(self, advice: Advice) -> tuple[Instruction, ...]:
        """What stops the feet for a moment only is no news; who was told to stop is told to go on."""
        waited = 0.0 if self._waiting.since is None else self._clock - self._waiting.since
        patient = WAITING if self.felt else {}
        worth = tuple(
            one
            for one in advice.instructions
            if waited >= patient.get(one.kind, 0.0) and not (self.felt and self._is_felt(one))
        )
        walks = advice.action in (CueAction.GO, CueAction.SLOW)
        resume = (Instruction(Kind.RESUME, Urgency.DANGER),) if self._told_to_stop and walks else ()
        hidden = 0.0 if self.route is None else self.route.hidden_height
        low = (
            (Instruction(Kind.LOW_UNSEEN, Urgency.PREPARE, amount=hidden),) if hidden > LEAST_OBSTACLE and walks else ()
        )
        return resume + worth + low

    def _is_felt(self, one: Instruction) -> bool:
        """Whether the cue alone says enough: it leads back before that is said, and it says when to turn, once told."""
        told = replace(one, kind=Kind.TURN_SOON)
        return one.kind is Kind.TURN_BACK or (
            one.kind is Kind.TURN_NOW and self._announcer.has_begun(told, self._clock)
        )

    def _notice(self, advice: Advice) -> None:
        """Arrival, and how long the person has been kept from walking."""
        self._off_way = advice.off_way
        if advice.action is CueAction.ARRIVED:
            self.outcome = Outcome.ARRIVED
        if advice.action is not CueAction.STOP:
            self._waiting.since = None
        elif self._waiting.since is None:
            self._waiting.since = self._clock
        elif self._clock - self._waiting.since > LOST:
            self.give_up("no good pose, no planner, or held up, for too long")
        if self._trusted is None:
            return
        place = np.array(self._trusted.position)
        if np.hypot(*(self._waiting.at - place)[:2]) > 0.5:
            self._waiting.tries = 0
        if np.hypot(*(self._moved_at - place[:2])) > 0.5:
            self._moved, self._moved_at = self._clock, place[:2]

    def wants_route(self, pose: Pose | None, now: float) -> bool:
        """Whether `replan` should be called with this pose."""
        if pose is None or self._alone or self.outcome is not Outcome.WALKING:
            return False
        if doubt(pose, self._trusted, now) is not None:
            return False
        if self.route is None:
            return True
        since = self._waiting.since
        if since is None:
            return self._clock - self._moved > STALLED
        return self._clock - since >= (OFF_WAY if self._off_way else PATIENCE)

    def replan(self, pose: Pose) -> None:
        """Ask the service for a way from here, and wait for it."""
        self.take(*self.planner.route(pose, self.goal), pose)

    def take(self, route: Route | None, reason: str, pose: Pose) -> None:
        """Walk on by a route from `Planner.route`, or do without; gives up after `TRIES` in one place.

        Args:
            route: None where there is none.
            reason: Why.
            pose: Where it was asked for.
        """
        self._waiting.tries += 1
        self._waiting.since, self._waiting.at = self._clock, np.array(pose.position)
        self._moved = self._clock
        if route is not None:
            self.route, self._s = route, 0.0
            self.routes.append(route)
        if self._waiting.tries >= TRIES or (route is None and self.route is None):
            self.give_up(reason or "no way that can be walked safely")

    def give_up(self, reason: str) -> None:
        """Stop for good: the person stays and asks for help."""
        self.outcome, self.reason = Outcome.SAFE_STOP, reason
