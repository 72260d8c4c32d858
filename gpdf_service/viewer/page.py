"""The operator's page: a client of a running service, in a browser. Each browser has a page of its own.

Its parts, each knows only those before it: what is at hand (`desk`), the map (`map_control`), which scene is shown
(`scenes`), plans (`planning`), the link to all of it (`sharing`), recorded logs (`logs`). Beside them, who is on the
way (`live`).
"""

from __future__ import annotations

import threading
from functools import partial
from pathlib import Path

import viser
import zenoh

from gpdf_service.viewer.desk import Desk
from gpdf_service.viewer.link import Link
from gpdf_service.viewer.live import LiveLayers
from gpdf_service.viewer.logs import Logs
from gpdf_service.viewer.map_control import MapControl
from gpdf_service.viewer.panel import build_panel
from gpdf_service.viewer.planning import Plans
from gpdf_service.viewer.scenes import Scenes
from gpdf_service.viewer.sharing import Sharing
from gpdf_service.viewer.worker import Worker

MOST_PAGES = 16
"""At once: each holds its own map."""
FRAME_S = 0.05
"""[s] Between two places of what moves."""


class Server(viser.ViserServer):
    """viser, without its offer to publish the page through a relay on the internet."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: maps of people's homes do not leave by a click."""
        return None


class Pages:
    """A page for each browser that is there; what one does, another does not see.

    Args:
        server: Where they are served.
        endpoint: Of the planning service.
        log_path: A log that each opens at once.
        config: Zenoh's, with credentials; it names the endpoint, too.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        endpoint: str,
        log_path: Path | None = None,
        config: zenoh.Config | None = None,
    ) -> None:
        server.scene.world_axes.visible = False
        self._make = partial(Page, endpoint=endpoint, log_path=log_path, config=config)
        self._lock = threading.Lock()
        self._open: dict[int, Page] = {}
        server.on_client_connect(self._begin)
        server.on_client_disconnect(self._end)

    @property
    def open(self) -> tuple[Page, ...]:
        """Those that are there, the oldest first."""
        with self._lock:
            return tuple(self._open.values())

    def close(self) -> None:
        """End all of them; the server stays."""
        with self._lock:
            ended, self._open = tuple(self._open.values()), {}
        for page in ended:
            page.close()

    def _begin(self, browser: viser.ClientHandle) -> None:
        if len(self.open) >= MOST_PAGES:
            browser.gui.add_markdown(f"**{MOST_PAGES} pages are open already.** Close one, and load this one again.")
            return
        page = self._make(browser)
        with self._lock:
            self._open[browser.client_id] = page

    def _end(self, browser: viser.ClientHandle) -> None:
        with self._lock:
            page = self._open.pop(browser.client_id, None)
        if page is not None:
            page.close()


class Page:
    """The parts of the page, wired to each other and to the service.

    Args:
        browser: Who sees it.
        endpoint: Of the planning service.
        log_path: A log to open at once.
        config: Zenoh's, with credentials; it names the endpoint, too.
    """

    def __init__(
        self,
        browser: viser.ClientHandle,
        endpoint: str,
        log_path: Path | None = None,
        config: zenoh.Config | None = None,
    ) -> None:
        panel = self.panel = build_panel(browser.gui)
        workers = Worker("gpdf-maps", panel.say_work), Worker("gpdf-plans", panel.say_answer)
        self.desk = Desk(browser, panel, Link(endpoint, self._on_service, config), *workers)
        self.map = MapControl(self.desk)
        self.scenes = Scenes(self.desk, self.map, on_new=lambda: self.plans.leave())
        self.plans = Plans(self.desk, self.map, self.scenes)
        self.sharing = Sharing(self.desk, self.map, self.scenes, self.plans)
        self.logs = Logs(self.desk, self.map, self.scenes, self.plans)
        self.live = LiveLayers(browser.scene, self.desk.frame)
        self._closing = threading.Event()
        self._ticker = threading.Thread(target=self._tick, name="gpdf-tick", daemon=True)
        self._ticker.start()
        self.desk.link.start()
        if log_path is not None:
            self.logs.open(log_path)

    def close(self) -> None:
        """End all threads and the connection; the server stays."""
        self._closing.set()
        self.scenes.close()
        self.desk.link.close()
        self.desk.maps.close()
        self.desk.plans.close()
        self.plans.close()
        self._ticker.join()

    def _on_service(self, there: bool) -> None:
        endpoint = self.desk.link.endpoint
        if there:
            self.panel.link.content = f"Connected to `{endpoint}`"
            self.live.listen(self.desk.link.client)
            self.desk.maps.do("scenes", self.sharing.look)
        else:
            self.panel.link.content = f"**Service lost.** Looking for it at `{endpoint}` …"

    def _tick(self) -> None:
        while not self._closing.wait(FRAME_S):
            self.plans.tick(FRAME_S)
            self.live.draw()
            self.sharing.tick()
