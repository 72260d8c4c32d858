"""Start and goal, the plan between them, and the comparison of methods."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import viser
from gpdf_client import ClientError, PlanResult, Status, Trajectory, UnavailableError
from gpdf_schemas import MovingObstacle

from gpdf_service.types import AGENTS, Agent, FloatArray
from gpdf_service.viewer import colours, words
from gpdf_service.viewer.desk import Desk
from gpdf_service.viewer.drops import Drops, room_beside
from gpdf_service.viewer.map_control import MapControl
from gpdf_service.viewer.panel import METHODS, OBSTACLE
from gpdf_service.viewer.path_layers import PathLayers
from gpdf_service.viewer.profile import known_clearance, profile_of
from gpdf_service.viewer.scenes import Scenes
from gpdf_service.viewer.widgets import by_hand, put

PLAN_DEADLINE_S = 30.0
"""[s] The first plan of a body waits until the service knows where it fits."""
AT_ONCE_S = 0.1
"""[s] What comes within is felt to come at once (Nielsen 1993): nothing is drawn before. Words are shown as they come,
but behind something to draw they wait for the frame, for half a second where no graphics card draws it."""
T = TypeVar("T")
Place = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Way:
    """How to plan: for which body, as a request names it, by which method; and the colour of the path."""

    body: str | dict[str, Any]
    method: str
    colour: tuple[int, int, int] = colours.NOWHERE


class Plans:
    """What the Plan tab and clicks on the ground ask for, and how the answers are shown."""

    def __init__(self, desk: Desk, map_control: MapControl, scenes: Scenes) -> None:
        self._desk, self._map, self._scenes, self._tab = desk, map_control, scenes, desk.panel.plan
        self.paths = PathLayers(desk.browser.scene, desk.frame)
        self.ends: dict[str, FloatArray | None] = {"start": None, "goal": None}
        self.next = "start"
        self._nearest: tuple[str, FloatArray] | None = None
        self._unmarked: set[str] = set()
        self._asking = ThreadPoolExecutor(1, "gpdf-asking")
        self.drops = Drops(desk, self._replan)
        map_control.on_lift(lambda: desk.plans.do("lift", self._draw_again))
        tab = self._tab
        desk.browser.scene.on_click()(self._click)
        tab.body.on_change(self._change_body)
        tab.method.on_update(by_hand(self._replan))
        tab.sets.on_click(lambda event: self._set_next(str(event.target.value)))
        desk.panel.scene.on_update(self._leave_soon)
        tab.take.on_click(lambda _: self._soon(self._take_typed))
        tab.nearest.on_click(lambda _: self._soon(self._take_nearest))
        tab.plan.on_click(lambda _: self.plan_soon())
        tab.compare_methods.on_click(lambda _: self._soon(self._compare_methods))
        tab.compare_bodies.on_click(lambda _: self._soon(self._compare_bodies))
        tab.clear.on_click(self._clear_soon)
        tab.time.on_update(lambda _: self.paths.move(tab.time.value))
        self._say_next()

    def close(self) -> None:
        """Ask nothing any more."""
        self._asking.shutdown()

    def plan_soon(self) -> None:
        """Plan on the plans' worker."""
        self._soon(self._plan)

    def _soon(self, job: Callable[[], None]) -> None:
        """Do it on the plans' worker; if another scene was chosen, when that is shown."""
        desk = self._desk
        if self._scenes.is_coming:
            desk.maps.do("plan", lambda: desk.plans.do("plan", job))
        else:
            desk.plans.do("plan", job)

    def set_end(self, name: str, place: FloatArray) -> None:
        """Set the start or the goal (x, y, z of the ground) [m]; the next click sets the other."""
        self._note_end(name, place)
        self._mark_ends()

    def _note_end(self, name: str, place: FloatArray) -> None:
        self.ends[name] = place
        self._unmarked.add(name)
        put(self._tab.typed[name], ", ".join(f"{value:.2f}" for value in place))
        self._set_next("goal" if name == "start" else "start")

    def _mark_ends(self) -> None:
        for name in tuple(self._unmarked):
            self._unmarked.discard(name)
            self.paths.mark(name, self.ends[name])

    def open(self, ends: dict[str, Place | None], obstacles: Sequence[MovingObstacle]) -> None:
        """Set what is given, start and goal by name (x, y, z) [m], and plan if both are; on the plans' worker."""
        self.drops.replace(obstacles)
        for name, place in ends.items():
            if place is not None:
                self._note_end(name, np.array(place))
        if self._ready:
            self._plan()
        self._mark_ends()

    def _draw_again(self) -> None:
        """Where the storeys are now."""
        self.drops.replace(tuple(self.drops.obstacles.values()))
        self.paths.draw_again()
        self.paths.move(self._tab.time.value)

    def leave(self) -> None:
        """Forget what was planned in the scene that was shown; what has been typed for the next one stays."""
        for name, place in self.ends.items():
            if place is not None:
                put(self._tab.typed[name], "")
        self._forget()

    async def _leave_soon(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:  # a person chose another scene
            self.ends = dict.fromkeys(self.ends)
            await self._clear_soon(event)

    async def _clear_soon(self, _: viser.GuiEvent[Any]) -> None:
        """The fields at once, before viser takes what is typed next: on a thread it could come after that."""
        self._empty_fields()
        self._desk.plans.do("clear", self._forget)

    def _empty_fields(self) -> None:
        for field in self._tab.typed.values():
            put(field, "")

    def _forget(self) -> None:
        self.drops.replace(())
        for name in self.ends:
            self.ends[name] = None
            self.paths.mark(name, None)
        self._unmarked.clear()
        self._clear_words()
        self._clear_path()
        self._desk.panel.say_answer("")
        self._set_next("start")

    def show(self, result: PlanResult, scene: str, agent: Agent, seconds: float | None) -> None:
        """Show an answer, its words first; `seconds`: how long it took, if that is known."""
        path, proven = result.trajectory, result.status is Status.OK
        self._clear_words()
        self._desk.panel.say_answer("" if path is None else words.answer(result))
        self._tab.details.content = words.details(result, seconds)
        if path is None:
            self._tab.refusal.content, self._tab.refusal.visible = words.refusal(result), True
        self._desk.browser.flush()
        if path is None:
            self._clear_path()
            self._mark_ends()
            self._show_nearest(result)
            return
        shades = np.array(colours.NOWHERE if proven else colours.WARNING, np.uint8)
        clearance = self._wait_for(
            lambda: known_clearance(self._desk.link, scene, path, agent),
            meanwhile=lambda: self._draw_line(path, shades, proven=proven),
        )
        if clearance is not None:
            clearance = np.minimum(clearance, room_beside(list(self.drops.obstacles.values()), path, agent))
            if proven:
                shades = colours.ramp(clearance, 0.0, colours.ENOUGH_ROOM, colours.ROOM)
            self._tab.charts.show(profile_of(path, clearance))
        self._draw_line(path, shades, proven=proven)
        self.paths.add_sweep(path, agent, shades)
        self._tab.time.max = round(path.duration, 2)
        put(self._tab.time, 0.0)
        self._tab.legend.visible = clearance is not None and proven
        self._tab.time.visible = self._tab.play.visible = True

    def _draw_line(self, path: Trajectory, shades: colours.Colours, *, proven: bool) -> None:
        self._clear_path()
        self._mark_ends()
        self.paths.add_line("plan", path, shades, dashed=not proven)

    def _show_nearest(self, result: PlanResult) -> None:
        """Where the way ends on the map, and a button that takes the nearest place that is valid."""
        self._nearest = None
        for what in ("nearest", "cut"):
            place = np.array([result.details.get(f"{what}_{axis}", np.nan) for axis in "xyz"])
            if not np.isfinite(place).all():
                continue
            self.paths.mark(what, place)
            if what == "nearest":
                name = "start" if result.status.value.startswith("START") else "goal"
                self._nearest = name, place
                self._tab.nearest.label = f"Take the nearest {name}: ({place[0]:.2f}, {place[1]:.2f}, {place[2]:.2f})"
                self._tab.nearest.visible = True

    def _take_nearest(self) -> None:
        if self._nearest is not None:
            self._note_end(*self._nearest)
            self._plan()

    def _take_typed(self) -> None:
        """Start and goal as they are typed: numbers, or names of places."""
        for name, field in self._tab.typed.items():
            if text := field.value.strip():
                self._note_end(name, self._map.on_ground(self._where(text)))
        missing = [name for name, place in self.ends.items() if place is None]
        self._set_next(missing[0] if missing else "start")
        if missing:
            self._mark_ends()
            raise ValueError(f"Type the {' and the '.join(missing)}, too, or click the ground there.")
        self._plan()

    def _where(self, text: str) -> list[float]:
        try:
            place = [float(part) for part in text.replace(",", " ").split()]
        except ValueError:
            return self._desk.link.client.where(self._scenes.shown[0], text)
        if len(place) not in (2, 3):
            raise ValueError(f"{text!r} is no place: type x, y or x, y, z in metres, or the name of a place.")
        return place

    def tick(self, seconds: float) -> None:
        """Move the body on, if it shall play."""
        slider = self._tab.time
        if self._tab.play.value and slider.visible:
            put(slider, (slider.value + seconds) % slider.max)

    def _click(self, event: viser.SceneClickEvent) -> None:
        hit = self._map.hit(np.array(event.ray_origin), np.array(event.ray_direction))
        if hit is None:
            self._desk.panel.say_answer("There is no known ground there.")
            return
        if self.next == OBSTACLE:
            self.drops.drop(hit)
            return
        self.set_end(self.next, hit)
        if self.next == "start":
            self._replan()

    def _set_next(self, name: str) -> None:
        self.next = name
        self._tab.drops.radius.visible = name == OBSTACLE
        self._say_next()

    def _say_next(self) -> None:
        ends = self.ends
        given = [f"{name} ({at[0]:.2f}, {at[1]:.2f}, {at[2]:.2f})" for name, at in ends.items() if at is not None]
        self._tab.next.content = " → ".join(given) + ("\n\n" if given else "") + f"Click the ground: **{self.next}**"
        for button in (self._tab.plan, self._tab.compare_methods, self._tab.compare_bodies):
            button.disabled = not self._ready

    @property
    def _ready(self) -> bool:
        return all(place is not None for place in self.ends.values())

    def _clear_path(self) -> None:
        self.paths.clear()
        for what in ("nearest", "cut"):
            self.paths.mark(what, None)

    def _clear_words(self) -> None:
        tab = self._tab
        tab.charts.hide()
        tab.details.content = ""
        tab.refusal.visible = tab.nearest.visible = False
        tab.legend.visible = tab.table.visible = tab.time.visible = tab.play.visible = False

    def _change_body(self) -> None:
        self._map.change_body()
        self._replan()

    def _replan(self) -> None:
        if self._ready:
            self.plan_soon()

    def _ask(self, way: Way) -> tuple[PlanResult, float]:
        start, goal = self.ends["start"], self.ends["goal"]
        if start is None or goal is None:
            raise ValueError("Click a start and a goal first.")
        began = time.perf_counter()
        result = self._desk.link.client.plan(
            self._scenes.shown[0],
            start.tolist(),
            goal.tolist(),
            way.body,
            method=way.method,
            deadline_s=PLAN_DEADLINE_S,
            obstacles=list(self.drops.obstacles.values()),
        )
        return result, time.perf_counter() - began

    def _wait_for(self, job: Callable[[], T], meanwhile: Callable[[], None]) -> T:
        """What a job comes to; where that takes longer than anybody would notice, or fails, something else is done."""
        answer = self._asking.submit(job)
        if not wait([answer], AT_ONCE_S).done or answer.exception() is not None:
            meanwhile()
        return answer.result()

    def _say_planning(self) -> None:
        self._desk.panel.say_answer("Planning …")
        self._clear_words()
        self._clear_path()
        self._mark_ends()

    def _plan(self) -> None:
        agent, way = self._desk.body.agent, Way(self._desk.body.wire, self._tab.method.value)
        result, seconds = self._wait_for(lambda: self._ask(way), meanwhile=self._say_planning)
        scene = self._scenes.shown[0]
        self.show(result, scene, agent, seconds)
        if result.scene_version not in (0, self._scenes.facts.get(scene, {}).get("version")):
            self._scenes.look_soon()  # somebody replaced the scene

    def _compare_methods(self) -> None:
        body = self._desk.body.wire
        self._compare("method", {name: Way(body, name, colours.METHODS[name]) for name in METHODS})

    def _compare_bodies(self) -> None:
        method, own = self._tab.method.value, self._desk.body
        ways = {name: Way(name, method, colours.BODIES[name]) for name in AGENTS}
        if own.wire != own.agent.name:
            ways[own.agent.name] = Way(own.wire, method, colours.OWN_BODY)
        self._compare("body", ways)

    def _compare(self, what: str, ways: dict[str, Way]) -> None:
        self._clear_words()
        self._clear_path()
        results: dict[str, PlanResult | str] = {}
        times: dict[str, float] = {}
        for storey, (name, way) in enumerate(ways.items()):
            self._desk.panel.say_answer(f"Planning: {name} …")
            try:
                result, times[name] = self._ask(way)
            except ClientError as error:
                if isinstance(error, UnavailableError):
                    raise
                results[name] = str(error)
                continue
            results[name] = result
            if result.trajectory is not None:
                shade, proven = np.array(way.colour, np.uint8), result.status is Status.OK
                self.paths.add_line(name, result.trajectory, shade, dashed=not proven, storey=storey)
        self._desk.panel.say_answer("")
        self._tab.table.content = words.comparison(
            what, results, times, {name: way.colour for name, way in ways.items()}
        )
        self._tab.table.visible = True
