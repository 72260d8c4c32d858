"""Start and goal, the plan between them, and the comparison of methods."""

from __future__ import annotations

import time

import numpy as np
import viser
from gpdf_client import ClientError, PlanResult, Status, UnavailableError

from gpdf_service.types import AGENTS, Agent, FloatArray
from gpdf_service.viewer import colours, words
from gpdf_service.viewer.desk import Desk, by_hand
from gpdf_service.viewer.drops import Drops, room_beside
from gpdf_service.viewer.map_control import MapControl
from gpdf_service.viewer.panel import METHODS, OBSTACLE, put
from gpdf_service.viewer.path_layers import PathLayers
from gpdf_service.viewer.profile import known_clearance, profile_of
from gpdf_service.viewer.scenes import Scenes

PLAN_DEADLINE_S = 30.0
"""[s] The first plan of a body waits until the service knows where it fits."""


class Plans:
    """What the Plan tab and clicks on the ground ask for, and how the answers are shown."""

    def __init__(self, desk: Desk, map_control: MapControl, scenes: Scenes) -> None:
        self._desk, self._map, self._scenes, self._tab = desk, map_control, scenes, desk.panel.plan
        self.paths = PathLayers(desk.server.scene, desk.frame)
        self.ends: dict[str, FloatArray | None] = {"start": None, "goal": None}
        self.next = "start"
        self.drops = Drops(desk, self._replan)
        tab = self._tab
        desk.server.scene.on_click()(self._click)
        tab.agent.on_update(by_hand(self._change_body))
        tab.method.on_update(by_hand(self._replan))
        tab.sets.on_click(lambda event: self._set_next(str(event.target.value)))
        tab.plan.on_click(lambda _: self.plan_soon())
        tab.compare.on_click(lambda _: desk.plans.do("plan", self._compare))
        tab.clear.on_click(lambda _: desk.plans.do("plan", self.clear))
        tab.time.on_update(lambda _: self.paths.move(tab.time.value))
        self._say_next()

    def plan_soon(self) -> None:
        """Plan on the plans' worker."""
        self._desk.plans.do("plan", self._plan)

    def set_end(self, name: str, place: FloatArray) -> None:
        """Set the start or the goal (x, y, z of the ground) [m]; the next click sets the other."""
        self.ends[name] = place
        self.paths.mark(name, place)
        self._set_next("goal" if name == "start" else "start")

    def clear(self) -> None:
        """Forget start, goal, obstacles and path."""
        self.drops.replace(())
        for name in self.ends:
            self.ends[name] = None
            self.paths.mark(name, None)
        self._clear_path()
        self._desk.panel.say_answer("")
        self._set_next("start")

    def show(self, result: PlanResult, scene: str, agent: Agent, seconds: float | None) -> None:
        """Show an answer; `seconds`: how long it took, if that is known."""
        self._clear_path()
        self._desk.panel.say_answer(words.answer(result))
        self._tab.details.content = words.details(result, seconds)
        path = result.trajectory
        if path is None:
            return
        clearance, proven = known_clearance(self._desk.link, scene, path, agent), result.status is Status.OK
        shades = np.array(colours.NOWHERE if proven else colours.WARNING, np.uint8)
        if clearance is not None:
            clearance = np.minimum(clearance, room_beside(list(self.drops.obstacles.values()), path, agent))
            if proven:
                shades = colours.ramp(clearance, 0.0, colours.ENOUGH_ROOM, colours.ROOM)
            self._tab.charts.show(profile_of(path, clearance))
        self.paths.add_line("plan", path, shades, dashed=not proven)
        self.paths.add_sweep(path, agent, shades)
        self._tab.time.max = round(path.duration, 2)
        put(self._tab.time, 0.0)
        self._tab.legend.visible = clearance is not None and proven
        self._tab.time.visible = self._tab.play.visible = True

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
        self._tab.plan.disabled = self._tab.compare.disabled = not self._ready

    @property
    def _ready(self) -> bool:
        return all(place is not None for place in self.ends.values())

    def _clear_path(self) -> None:
        self.paths.clear()
        self._tab.charts.hide()
        self._tab.details.content = ""
        tab = self._tab
        tab.legend.visible = tab.table.visible = tab.time.visible = tab.play.visible = False

    def _change_body(self) -> None:
        self._map.change_body()
        self._replan()

    def _replan(self) -> None:
        if self._ready:
            self.plan_soon()

    def _ask(self, method: str) -> tuple[PlanResult, float]:
        start, goal = self.ends["start"], self.ends["goal"]
        if start is None or goal is None:
            raise ValueError("Click a start and a goal first.")
        began = time.perf_counter()
        result = self._desk.link.client.plan(
            self._scenes.shown[0],
            start.tolist(),
            goal.tolist(),
            self._tab.agent.value,
            method=method,
            deadline_s=PLAN_DEADLINE_S,
            obstacles=list(self.drops.obstacles.values()),
        )
        return result, time.perf_counter() - began

    def _plan(self) -> None:
        self._desk.panel.say_answer("Planning …")
        self._clear_path()
        result, seconds = self._ask(self._tab.method.value)
        scene = self._scenes.shown[0]
        self.show(result, scene, AGENTS[self._tab.agent.value], seconds)
        if result.scene_version not in (0, self._scenes.facts.get(scene, {}).get("version")):
            self._scenes.look_soon()  # somebody replaced the scene

    def _compare(self) -> None:
        self._clear_path()
        results: dict[str, PlanResult | str] = {}
        times: dict[str, float] = {}
        for storey, method in enumerate(METHODS):
            self._desk.panel.say_answer(f"Planning with {method} …")
            try:
                result, times[method] = self._ask(method)
            except ClientError as error:
                if isinstance(error, UnavailableError):
                    raise
                results[method] = str(error)
                continue
            results[method] = result
            if result.trajectory is not None:
                shade, proven = np.array(colours.METHODS[method], np.uint8), result.status is Status.OK
                self.paths.add_line(method, result.trajectory, shade, dashed=not proven, storey=storey)
        self._desk.panel.say_answer("")
        self._tab.table.content = words.comparison(results, times)
        self._tab.table.visible = True
