"""The operator's page: a client of a running service, in a browser. Everybody who opens it sees the same page."""

from __future__ import annotations

import logging
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import viser
from gpdf_client import Client, ClientError, PlanResult, UnavailableError
from gpdf_client.results import to_result
from gpdf_schemas import LoadRequest, PlanReply, PlanRequest, SceneReply, Status, keys

from gpdf_service.types import AGENTS, Agent, FloatArray
from gpdf_service.viewer import colours, words
from gpdf_service.viewer.link import Link
from gpdf_service.viewer.map_layers import MapLayers, View
from gpdf_service.viewer.panel import ALL_LEVELS, METHODS, NO_SCENE, SLICES, build_panel, gradient, put
from gpdf_service.viewer.path_layers import PathLayers
from gpdf_service.viewer.profile import known_clearance, profile_of
from gpdf_service.viewer.worker import Worker

log = logging.getLogger(__name__)

FRAME_S = 0.05
"""[s] Between two places of the moving body."""
BUILD_POLL_S = 0.3
"""[s] Between two looks at a build."""
CAMERA = np.array([0.0, -0.25, 0.55])
"""From the middle of the ground to the camera, in diagonals of the ground."""
SLICE_OVER_GROUND = 0.6
"""[m]"""
PLAN_DEADLINE_S = 30.0
"""[s] The first plan of a body waits until the service knows where it fits."""


class Server(viser.ViserServer):
    """viser, without its offer to publish the page through a relay on the internet."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: maps of people's homes do not leave by a click."""
        return None


class Page:
    """State and behaviour of the page. Slow work runs on two workers, so that plans do not wait for maps.

    Args:
        server: Where the page is served.
        endpoint: Of the planning service.
        log_path: A log to open at once.
    """

    def __init__(self, server: viser.ViserServer, endpoint: str, log_path: Path | None = None) -> None:
        self.server, self.endpoint = server, endpoint
        server.scene.world_axes.visible = False
        self.panel = build_panel(server.gui)
        self.map, self.paths = MapLayers(server.scene), PathLayers(server.scene)
        self.facts: dict[str, dict[str, Any]] = {}
        self.shown: tuple[str, str] = ("", "")  # name and digest of the scene on the page
        self.ends: dict[str, FloatArray | None] = {"start": None, "goal": None}
        self.next = "start"
        self.recorded: list[tuple[PlanRequest, PlanReply]] = []
        self.digests: dict[tuple[str, int], str] = {}  # of the recorded scenes, by name and version
        self._stale: set[str] = set()  # layers that the view has changed since they were drawn
        self._closing = threading.Event()
        self._maps, self._plans = Worker("gpdf-maps", self._say_work), Worker("gpdf-plans", self._say_answer)
        self._connect_widgets()
        self._say_next()
        self.link = Link(endpoint, self._on_service)
        self.link.start()  # what it calls needs `self.link`
        self._ticker = threading.Thread(target=self._tick, name="gpdf-tick", daemon=True)
        self._ticker.start()
        if log_path is not None:
            self._open_log(log_path)

    def close(self) -> None:
        """End all threads and the connection; the server stays."""
        self._closing.set()
        self.link.close()
        self._maps.close()
        self._plans.close()
        self._ticker.join()

    # What is said.

    def _say_work(self, text: str, share: float | None = None) -> None:
        self.panel.work.content, self.panel.work.visible = text, bool(text)
        self.panel.bar.visible = share is not None
        if share is not None:
            put(self.panel.bar, 100.0 * share)

    def _say_answer(self, text: str) -> None:
        self.panel.plan.answer.content = text

    def _say_next(self) -> None:
        ends = self.ends
        given = [f"{name} ({at[0]:.2f}, {at[1]:.2f}, {at[2]:.2f})" for name, at in ends.items() if at is not None]
        self.panel.plan.next.content = (
            " → ".join(given) + ("\n\n" if given else "") + f"Click the ground: **{self.next}**"
        )
        ready = all(place is not None for place in ends.values())
        self.panel.plan.plan.disabled = self.panel.plan.compare.disabled = not ready

    # The service comes and goes.

    def _on_service(self, there: bool) -> None:
        if there:
            self.panel.link.content = f"Connected to `{self.endpoint}`"
            self._maps.do("scenes", self._look_for_scenes)
        else:
            self.panel.link.content = f"**Service lost.** Looking for it at `{self.endpoint}` …"

    def _look_for_scenes(self) -> None:
        """List the scenes, and show the chosen one as it is now."""
        client = self.link.client
        self.facts = client.scenes()
        names = tuple(sorted(self.facts)) or (NO_SCENE,)
        chosen = self.panel.scene.value
        if chosen not in names:
            chosen = next((name for name, facts in sorted(self.facts.items()) if facts["state"] == "ready"), names[0])
        self.panel.scene.options = names
        put(self.panel.scene, chosen)
        if self.facts.get(chosen, {}).get("building"):
            self._await_build(client, chosen)
            self.facts = client.scenes()
        self._open_scene(client, chosen)

    def _await_build(self, client: Client, name: str) -> None:
        while not self._closing.is_set():
            facts = client.scenes().get(name, {})
            if not facts.get("building"):
                self._say_work(f"{name}: {facts['error']}" if facts.get("error") else "")
                return
            self._say_work(f"{name}: {facts['stage'] or 'waiting'} …", facts["done"])
            time.sleep(BUILD_POLL_S)

    # The map.

    def _open_scene(self, client: Client, name: str) -> None:
        facts = self.facts.get(name, {})
        if facts.get("state") != "ready":
            self.map.clear()
            self._say_work(f"{name}: {facts['error']}" if facts.get("error") else "No scene is ready. Load one.")
            return
        self.panel.map.facts.content = words.facts(facts)
        if self.shown == (name, facts["digest"]):
            self._say_work("")
            self._prepare()  # it may be another service
            return
        self.shown = (name, facts["digest"])
        self.map.clear()
        self._clear_plan()
        self.panel.map.level.options = (ALL_LEVELS, *(str(level["level"]) for level in facts["levels"]))
        self._fetch("ground")
        self._look_at_ground()
        self._offer_heights(facts)
        self._fetch(*self.map.view.shown)
        self._prepare()

    def _offer_heights(self, facts: dict[str, Any]) -> None:
        """Slices from the scene's lowest point to its highest; at first over the lowest ground."""
        low, high = facts["extent"]
        slider = self.panel.map.height
        slider.max = round(high[2] - low[2], 2)
        put(slider, round(min(level["height"][0] for level in facts["levels"]) - low[2] + SLICE_OVER_GROUND, 2))

    def _prepare(self) -> None:
        """Let the service find out where the body fits before the first plan needs it."""
        self.link.client.draw(self.shown[0], "leaves", self.panel.plan.agent.value, limit=1)

    def _look_at_ground(self) -> None:
        """From above and the south, so that all known ground is seen left of the panel."""
        if self.map.ground is None:
            return
        low, high = self.map.ground.box
        reach = float(np.linalg.norm((high - low)[:2]))
        target = 0.5 * (low + high) + [0.12 * reach, 0.0, 0.0]
        position = target + CAMERA * reach
        initial = self.server.initial_camera
        initial.position, initial.look_at = position, target
        for client in self.server.get_clients().values():
            client.camera.position, client.camera.look_at = position, target

    def _fetch(self, *whats: str) -> None:
        client, (name, _) = self.link.client, self.shown
        if not name:
            return
        width = self.facts[name]["levels"][0]["cell_width"]
        for what in whats:

            def progress(share: float, what: str = what) -> None:
                self._say_work(f"{name}: {what} …", share)

            self.map.fetch(client, name, what, self.panel.plan.agent.value, width, progress)
            self.paths.origin = self.map.origin
            self.map.draw(what)
        self._say_work("")

    def _renew(self) -> None:
        """Hide what is not wanted, then fetch and draw what is."""
        while self._stale:
            self.map.draw(self._stale.pop())
        self._fetch(*(self.map.view.shown - self.map.there))

    def _slice(self) -> None:
        field = SLICES[self.panel.map.slice.value]
        legend = self.panel.map.slice_legend
        if not field:
            self.map.no_slice()
            legend.visible = False
            return
        agent, height = self.panel.plan.agent.value, self.panel.map.height.value
        low, high = self.map.slice(self.link.client, self.shown[0], field, agent, height)
        legend.content = gradient(colours.VIRIDIS, f"{low:.0f} m", f"{high:.1f} m, a line each 0.25 m")
        legend.visible = True

    # Plans.

    def _click(self, event: viser.SceneClickEvent) -> None:
        if self.map.ground is None:
            return
        ray = np.array(event.ray_origin), np.array(event.ray_direction)
        hit = self.map.ground.hit(*ray, self.map.view.level)
        if hit is None:
            self._say_answer("There is no known ground there.")
            return
        self.set_end(self.next, hit + self.map.origin)
        if self.next == "start" and self.ends["goal"] is not None:
            self._plans.do("plan", self._plan)

    def set_end(self, name: str, place: FloatArray) -> None:
        """Set the start or the goal (x, y, z of the ground) [m]; the next click sets the other."""
        self.ends[name] = place
        self.paths.mark(name, place)
        self.next = "goal" if name == "start" else "start"
        self._say_next()

    def _clear_plan(self) -> None:
        for name in self.ends:
            self.ends[name] = None
            self.paths.mark(name, None)
        self.next = "start"
        self._clear_path()
        self._say_answer("")
        self._say_next()

    def _clear_path(self) -> None:
        self.paths.clear()
        tab = self.panel.plan
        tab.charts.hide()
        tab.details.content = ""
        tab.legend.visible = tab.time.visible = tab.play.visible = False

    def _ask(self, method: str) -> tuple[PlanResult, float]:
        start, goal = self.ends["start"], self.ends["goal"]
        if start is None or goal is None:
            raise ValueError("Click a start and a goal first.")
        began = time.perf_counter()
        result = self.link.client.plan(
            self.shown[0],
            start.tolist(),
            goal.tolist(),
            self.panel.plan.agent.value,
            method=method,
            deadline_s=PLAN_DEADLINE_S,
        )
        return result, time.perf_counter() - began

    def _plan(self) -> None:
        self._say_answer("Planning …")
        self._clear_path()
        result, seconds = self._ask(self.panel.plan.method.value)
        self._show(result, self.shown[0], AGENTS[self.panel.plan.agent.value], seconds)
        if result.scene_version not in (0, self.facts.get(self.shown[0], {}).get("version")):
            self._maps.do("scenes", self._look_for_scenes)  # somebody replaced the scene

    def _show(self, result: PlanResult, scene: str, agent: Agent, seconds: float | None) -> None:
        self._clear_path()
        self._say_answer(words.answer(result))
        self.panel.plan.details.content = words.details(result, seconds)
        path = result.trajectory
        if path is None:
            return
        clearance = known_clearance(self.link, scene, path, agent)
        shades = np.array(colours.NOWHERE, np.uint8)
        if clearance is not None:
            shades = colours.ramp(clearance, 0.0, colours.ENOUGH_ROOM, colours.ROOM)
            self.panel.plan.charts.show(profile_of(path, clearance))
        self.paths.add_line("plan", path, shades)
        self.paths.add_sweep(path, agent, shades)
        tab = self.panel.plan
        tab.time.max = round(path.duration, 2)
        put(tab.time, 0.0)
        tab.legend.visible = clearance is not None
        tab.time.visible = tab.play.visible = True

    def _compare(self) -> None:
        self._clear_path()
        results: dict[str, PlanResult | str] = {}
        times: dict[str, float] = {}
        for method in METHODS:
            self._say_answer(f"Planning with {method} …")
            try:
                result, times[method] = self._ask(method)
            except ClientError as error:
                if isinstance(error, UnavailableError):
                    raise
                results[method] = str(error)
                continue
            results[method] = result
            if result.trajectory is not None:
                self.paths.add_line(method, result.trajectory, np.array(colours.METHODS[method], np.uint8))
        self._say_answer(words.comparison(results, times))

    def _tick(self) -> None:
        while not self._closing.wait(FRAME_S):
            slider = self.panel.plan.time
            if self.panel.plan.play.value and slider.visible:
                put(slider, (slider.value + FRAME_S) % slider.max)

    # Scenes and logs that come in.

    def _load_file(self) -> None:
        client, name = self.link.client, self.panel.load.name.value
        request = LoadRequest(scene=name, file=self.panel.load.file.value)
        client.ask(keys.SCENE_LOAD, request, SceneReply, request.deadline_s, {Status.BUILDING})
        self._take_scene(client, name)

    def _send_cloud(self, file: viser.UploadedFile) -> None:
        from gpdf_service.perception import read_cloud

        client, name = self.link.client, self.panel.load.name.value
        self._say_work(f"{name}: reading {file.name} …", 0.0)
        cloud = _with_file(file, read_cloud)
        client.load_scene(
            name,
            upload=cloud.points,
            ground=cloud.ground,
            progress=lambda share: self._say_work(f"{name}: sending, then building …", share),
        )
        self._take_scene(client, name)

    def _take_scene(self, client: Client, name: str) -> None:
        self._await_build(client, name)
        self.facts = client.scenes()
        if self.facts[name]["state"] != "ready" or self.facts[name]["error"]:
            return
        self.panel.scene.options = tuple(sorted(self.facts))
        put(self.panel.scene, name)
        self._open_scene(client, name)

    def _open_log(self, path: Path) -> None:
        from gpdf_service.service.replay import recorded_plans, recorded_scenes

        self.recorded, self.digests = list(recorded_plans(path)), recorded_scenes(path)
        tab = self.panel.log
        if not self.recorded:
            tab.text.content = f"There is no plan in `{path.name}`."
            return
        tab.text.content = f"{len(self.recorded)} plans in `{path.name}`."
        tab.step.max = max(2, len(self.recorded))
        tab.step.visible = tab.sides.visible = tab.again.visible = True
        put(tab.step, 1)
        self._show_recorded()

    def _show_recorded(self) -> None:
        index = min(self.panel.log.step.value, len(self.recorded)) - 1
        request, reply = self.recorded[index]
        digest = self.digests.get((request.scene, reply.scene_version), "")
        facts = self.facts.get(request.scene, {})
        if request.scene != self.shown[0] and facts.get("state") == "ready":
            self._maps.do("scenes", lambda: self._turn_to(request.scene))
            return
        warning = ""
        if facts.get("digest") != digest:
            warning = (
                f"\n\n**The service has no such scene** (`{digest or 'unknown'}`): the path is drawn without a map."
            )
            self._leave_scene(np.array([*request.start, 0.0][:3]))
        agent = AGENTS[request.agent] if isinstance(request.agent, str) else Agent(**request.agent)
        self.panel.log.text.content = (
            f"**{index + 1} of {len(self.recorded)}** · `{request.request_id}`\n\n"
            f"{request.scene}, {agent.name}, {request.method}: {_place(request.start)} → {_place(request.goal)}\n\n"
            + words.answer(to_result(reply))
            + warning
        )
        for name, place in (("start", request.start), ("goal", request.goal)):
            self.set_end(name, self._on_ground(place))
        if isinstance(request.agent, str):
            put(self.panel.plan.agent, request.agent)
        self._show(to_result(reply), request.scene, agent, None)

    def _turn_to(self, scene: str) -> None:
        """Show the scene of a recorded request, then the request."""
        put(self.panel.scene, scene)
        self._look_for_scenes()
        self._plans.do("plan", self._show_recorded)

    def _leave_scene(self, origin: FloatArray) -> None:
        """Show none: a path over another scene's map would mislead."""
        self.map.clear()
        self.shown = ("", "")
        self.map.origin = self.paths.origin = origin

    def _on_ground(self, place: list[float]) -> FloatArray:
        """A place with the height of the ground there, where the page knows it."""
        if len(place) == 3 or self.map.ground is None:
            return np.array([*place, 0.0][:3])
        over = np.array([*place, 0.0]) - self.map.origin
        over[2] = float(np.nanmax(self.map.ground.heights)) + 1.0
        hit = self.map.ground.hit(over, np.array([0.0, 0.0, -1.0]))
        return np.array([*place, self.map.origin[2]]) if hit is None else hit + self.map.origin

    # What the widgets do.

    def _connect_widgets(self) -> None:
        panel, tab = self.panel, self.panel.plan
        self.server.scene.on_click()(self._click)
        panel.scene.on_update(self._by_hand(lambda: self._maps.do("scenes", self._look_for_scenes)))
        tab.agent.on_update(self._by_hand(self._change_agent))
        tab.method.on_update(self._by_hand(self._replan))
        tab.sets.on_click(lambda event: self._set_next(str(event.target.value)))
        tab.plan.on_click(lambda _: self._plans.do("plan", self._plan))
        tab.compare.on_click(lambda _: self._plans.do("plan", self._compare))
        tab.clear.on_click(lambda _: self._plans.do("plan", self._clear_plan))
        tab.time.on_update(lambda _: self.paths.move(tab.time.value))
        self._connect_map()
        panel.load.load.on_click(lambda _: self._maps.do("load", self._load_file))
        panel.load.look.on_click(lambda _: self._maps.do("scenes", self._look_for_scenes))
        panel.load.upload.on_upload(
            lambda event: self._maps.do("load", lambda file=event.target.value: self._send_cloud(file))  # type: ignore[misc]
        )
        panel.log.open.on_upload(
            lambda event: self._plans.do(
                "log",
                lambda file=event.target.value: _with_file(file, self._open_log),  # type: ignore[misc]
            )
        )
        panel.log.step.on_update(self._by_hand(lambda: self._plans.do("plan", self._show_recorded)))
        panel.log.sides.on_click(lambda event: self._step(1 if event.target.value == "on" else -1))
        panel.log.again.on_click(lambda _: self._plans.do("plan", self._plan))

    def _connect_map(self) -> None:
        tab = self.panel.map
        for box in tab.layers.values():
            box.on_update(lambda _: self._change_view())
        for handle in (tab.colour, tab.level, tab.below, tab.size):
            handle.on_update(lambda _: self._change_view())
        for handle in (tab.slice, tab.height):
            handle.on_update(lambda _: self._maps.do("slice", self._slice))

    @staticmethod
    def _by_hand(act: Callable[[], None]) -> Callable[[viser.GuiEvent[Any]], None]:
        """Act only when a person changed a widget, not the page itself."""

        def on_update(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                act()

        return on_update

    def _change_view(self) -> None:
        tab, before = self.panel.map, self.map.view
        self.map.view = View(
            shown=frozenset(name for name, box in tab.layers.items() if box.value),
            colour=tab.colour.value,
            below=tab.below.value,
            point_size=tab.size.value,
            level=None if tab.level.value == ALL_LEVELS else int(tab.level.value),
        )
        self._stale |= self.map.view.touched(before)
        self._maps.do("view", self._renew)

    def _change_agent(self) -> None:
        def refetch() -> None:
            self.map.forget("obstacles", "leaves")
            self._fetch(*self.map.view.shown)
            if SLICES[self.panel.map.slice.value] == "obstacle":
                self._slice()

        self._maps.do("view", refetch)
        self._replan()

    def _replan(self) -> None:
        if all(place is not None for place in self.ends.values()):
            self._plans.do("plan", self._plan)

    def _set_next(self, name: str) -> None:
        self.next = name
        self._say_next()

    def _step(self, by: int) -> None:
        step = self.panel.log.step
        put(step, min(max(1, step.value + by), len(self.recorded)))
        self._plans.do("plan", self._show_recorded)


def _with_file(file: viser.UploadedFile, read: Callable[[Path], Any]) -> Any:  # noqa: ANN401 - what `read` returns
    """Let something that reads files read what the browser sent."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / Path(file.name).name
        path.write_bytes(file.content)
        return read(path)


def _place(place: list[float]) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in place) + ")"
