"""A picture of the operator's page, by a headless Chromium on a real service: part of `make pictures`."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from playwright.sync_api import Page as Tab
from playwright.sync_api import sync_playwright

import gpdf_service as gpdf
from gpdf_service.ports import free_endpoint, free_port
from gpdf_service.service.server import Options
from gpdf_service.service.server import Server as Service
from gpdf_service.viewer.page import Pages, Server

FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
SIZE = {"width": 1200, "height": 720}
WAIT_S = 120.0
"""[s] For one thing to appear, drawn by software beside other work."""


def draw_page(scene: gpdf.Scene, path: Path) -> None:
    """Plan for two clicks on the page, and take its picture.

    Args:
        scene: The office.
        path: The PNG to write.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene.save(folder / "office.gpdf")
        endpoint = free_endpoint()
        with Service(Options(endpoint, folder, folder, 1), [("office", folder / "office.gpdf")]):
            server = Server(host="127.0.0.1", port=free_port(), label="gpdf")
            pages = Pages(server, endpoint)
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
                web = browser.new_page(viewport=SIZE)
                web.goto(f"http://127.0.0.1:{server.get_port()}/")
                _until(lambda: bool(pages.open))
                page = pages.open[0]
                _until(lambda: "cloud" in page.map.layers.there and not page.panel.work.content)
                for end, place in (("start", (0.9, 0.9, 0.0)), ("goal", (5.4, 3.4, 0.0))):
                    page.plans.set_end(end, np.array(place))
                page.plans.plan_soon()
                _until(lambda: page.plans.paths.shown is not None)
                page.panel.plan.time.value = 2.5
                _close_warning(web)
                web.wait_for_timeout(5000)  # drawn by software, frame by frame
                web.screenshot(path=str(path), timeout=1000 * WAIT_S)
                browser.close()
            pages.close()
            server.stop()


def _close_warning(web: Tab) -> None:
    """Chromium's, about drawing by software."""
    warning = web.get_by_text("Software WebGL rendering detected")
    if warning.count():
        web.locator(".mantine-Notification-closeButton").first.click()


def _until(claim: Callable[[], bool]) -> None:
    end = time.monotonic() + WAIT_S
    while not claim():
        if time.monotonic() > end:
            raise SystemExit(f"the page did not get there within {WAIT_S:.0f} s")
        time.sleep(0.1)
