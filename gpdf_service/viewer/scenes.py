"""Which scene the page shows, and scenes that come in."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import viser
from gpdf_client import Client
from gpdf_schemas import LoadRequest, SceneReply, Status, keys

from gpdf_service.types import FloatArray
from gpdf_service.viewer.desk import Desk
from gpdf_service.viewer.map_control import MapControl
from gpdf_service.viewer.panel import NO_SCENE
from gpdf_service.viewer.widgets import by_hand, put, with_file

BUILD_POLL_S = 0.3
"""[s] Between two looks at a build."""


class Scenes:
    """Lists the service's scenes, shows the chosen one as it is now, loads others.

    Args:
        desk: The page's.
        map_control: Shows the scene.
        on_new: Told before another scene, or another version, is shown.
    """

    def __init__(self, desk: Desk, map_control: MapControl, on_new: Callable[[], None]) -> None:
        self._desk, self._map, self._on_new = desk, map_control, on_new
        self.facts: dict[str, dict[str, Any]] = {}
        self.shown: tuple[str, str] = ("", "")  # name and digest of the scene on the page
        self._closing = threading.Event()
        panel, load = desk.panel, desk.panel.load
        panel.scene.on_update(by_hand(self.look_soon))
        load.load.on_click(lambda _: desk.maps.do("load", self._load_file))
        load.look.on_click(lambda _: self.look_soon())
        load.upload.on_upload(
            lambda event: desk.maps.do("load", lambda file=event.target.value: self._send_cloud(file))  # type: ignore[misc]
        )

    @property
    def is_coming(self) -> bool:
        """Whether another scene was chosen than the one that is shown."""
        return bool(self._desk.panel.scene.value != self.shown[0])

    def close(self) -> None:
        """Wait for no build any more."""
        self._closing.set()

    def look_soon(self) -> None:
        """List the scenes on the maps' worker, and show the chosen one as it is now."""
        self._desk.maps.do("scenes", self.look)

    def show(self, name: str) -> None:
        """Show another scene, if the service has it; on the maps' worker."""
        put(self._desk.panel.scene, name)
        self.look()

    def turn_to(self, name: str, then: Callable[[], None]) -> None:
        """Show another scene, and do something when it is there."""

        def turn() -> None:
            self.show(name)
            then()

        self._desk.maps.do("scenes", turn)

    def leave(self, origin: FloatArray) -> None:
        """Show none: a path over another scene's map would mislead. `origin`: the page's new zero, (3,) [m]."""
        self._map.clear()
        self.shown = ("", "")
        self._desk.frame.origin = origin

    def look(self) -> None:
        """List the scenes, and show the chosen one as it is now; on the maps' worker."""
        panel, client = self._desk.panel, self._desk.link.client
        self.facts = client.scenes()
        names = tuple(sorted(self.facts)) or (NO_SCENE,)
        chosen = panel.scene.value
        if chosen not in names:
            chosen = next((name for name, facts in sorted(self.facts.items()) if facts["state"] == "ready"), names[0])
        panel.scene.options = names
        put(panel.scene, chosen)
        if self.facts.get(chosen, {}).get("building"):
            self._await_build(client, chosen)
            self.facts = client.scenes()
        self._open(chosen)

    def _open(self, name: str) -> None:
        facts = self.facts.get(name, {})
        if facts.get("state") != "ready":
            self._map.clear()
            said = f"{name}: {facts['error']}" if facts.get("error") else "No scene is ready. Load one."
            self._desk.panel.say_work(said)
            return
        if self.shown == (name, facts["digest"]):
            self._map.say_facts(facts)
            self._desk.panel.say_work("")
        else:
            self._map.clear()  # nobody clicks the old ground and asks about the new scene
            self.shown = ("", "")
            self._on_new()
            self._map.show(name, facts)
            self.shown = (name, facts["digest"])
            self._map.fill()
        self._map.prepare()  # also if it is shown already: it may be another service

    def _await_build(self, client: Client, name: str) -> None:
        say = self._desk.panel.say_work
        while not self._closing.is_set():
            facts = client.scenes().get(name, {})
            if not facts.get("building"):
                say(f"{name}: {facts['error']}" if facts.get("error") else "")
                return
            say(f"{name}: {facts['stage'] or 'waiting'} …", facts["done"])
            self._closing.wait(BUILD_POLL_S)

    def _load_file(self) -> None:
        client, load = self._desk.link.client, self._desk.panel.load
        request = LoadRequest(scene=load.name.value, file=load.file.value)
        client.ask(keys.SCENE_LOAD, request, SceneReply, request.deadline_s, {Status.BUILDING})
        self._take(client, load.name.value)

    def _send_cloud(self, file: viser.UploadedFile) -> None:
        from gpdf_service.clouds import read_cloud

        client, panel = self._desk.link.client, self._desk.panel
        name = panel.load.name.value
        panel.say_work(f"{name}: reading {file.name} …", 0.0)
        cloud = with_file(file, read_cloud)
        client.load_scene(
            name,
            upload=cloud.points,
            ground=cloud.ground,
            colours=cloud.colours,
            progress=lambda share: panel.say_work(f"{name}: sending, then building …", share),
        )
        self._take(client, name)

    def _take(self, client: Client, name: str) -> None:
        """Show what was loaded, when it is built."""
        self._await_build(client, name)
        self.facts = client.scenes()
        if self.facts[name]["state"] != "ready" or self.facts[name]["error"]:
            return
        self._desk.panel.scene.options = tuple(sorted(self.facts))
        put(self._desk.panel.scene, name)
        self._open(name)
