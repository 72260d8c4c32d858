"""A running service and a person before the page, for the tests of the page."""

import io
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import viser.transforms as vtf
from gpdf_client import Client
from PIL import Image

from gpdf_service.ports import free_port
from gpdf_service.viewer.page import Pages, Server

SIZE = {"width": 1100, "height": 600}


def until(claim, seconds=60.0):
    """Wait until `claim()` is true, and return it; fail when it never is."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := claim():
            return found
        time.sleep(0.05)
    pytest.fail(f"it did not become true within {seconds} s")


class Service:
    """`gpdf serve` as its own process, that can be killed and started again."""

    def __init__(self, scenes, folder):
        self.endpoint, self.folder = f"tcp/127.0.0.1:{free_port()}", folder
        self._scenes = [f"{name}={path}" for name, path in scenes.items()]
        self.start()

    def start(self):
        words = ["serve", *self._scenes, "--endpoint", self.endpoint, "--log-dir", str(self.folder / "log")]
        words += ["--scenes-dir", str(self.folder), "--workers", "1"]
        with (self.folder / "stderr.txt").open("a") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "gpdf_service.cli", *words], stderr=log, env=os.environ
            )
        with Client.connect(self.endpoint, timeout_s=60) as client:
            for name in client.scenes():
                client.wait_for_scene(name)

    def stop(self, number=signal.SIGTERM):
        self._process.send_signal(number)
        self._process.wait(60)

    def kill(self):
        self.stop(signal.SIGKILL)


CALM = """
document.addEventListener('DOMContentLoaded', () => document.head.insertAdjacentHTML(
    'beforeend', '<style>.mantine-Notification-root {display: none}</style>'));
"""
"""Notices lie over the map: hidden, for the page still removes them itself (a node that is gone breaks it)."""


class Operator:
    """A person before the page: what the browser shows, and where the mouse goes."""

    def __init__(self, browser, endpoint, log=None):
        self.server = Server("127.0.0.1", free_port(), label="gpdf", verbose=False)
        self.pages = Pages(self.server, endpoint, log)
        self.context = browser.new_context(viewport=SIZE)
        self.context.add_init_script(CALM)
        self.web = self.context.new_page()
        self.errors, self._seen = [], ""
        self.web.on("pageerror", lambda error: self.errors.append(str(error)))
        self.web.goto(f"http://127.0.0.1:{self.server.get_port()}/")
        self.sees("Connected to")

    @property
    def page(self):
        """The oldest one, which `web` shows."""
        return self.pages.open[0]

    def close(self):
        self.context.close()
        self.pages.close()
        self.server.stop()

    def sees(self, text, seconds=60.0):
        """Wait until a text stands in the page."""
        self.web.get_by_text(re.compile(text)).first.wait_for(timeout=1000 * seconds)

    def choose(self, label, value):
        self.web.get_by_label(label, exact=True).first.click()
        self.web.get_by_role("option", name=value, exact=True).click()

    def tab(self, name):
        self.web.get_by_role("tab", name=name).click()

    def presses(self, name):
        self.web.get_by_role("button", name=name, exact=True).click()

    def opens(self, scene):
        """Choose a scene, and wait until its map is drawn and the browser has told its camera."""
        new = scene != self._seen
        self._seen = scene
        if self.page.panel.scene.value != scene:
            self.choose("Scene", scene)
        until(lambda: self.page.scenes.shown[0] == scene and "cloud" in self.page.map.layers.there)
        until(lambda: not self.page.panel.work.content)
        if new:
            self.settle()  # the camera has moved, and the browser has said so

    def begins(self):
        """Come to the page as it is at first, whatever was done on it before."""
        self.errors.clear()
        self.opens("office")
        self.tab("Plan")
        for label, value in (("Body", "human"), ("Method", "dual_gpdf")):
            if self.web.get_by_label(label, exact=True).first.input_value() != value:
                self.choose(label, value)
        self.presses("Clear")
        self.sees("Click the ground: start")

    def settle(self):
        """Wait until the picture stands still."""
        before, same = b"", 0
        while same < 3:
            self.web.wait_for_timeout(300)
            now = self.web.screenshot(scale="css")
            same = same + 1 if now == before else 0
            before = now

    def pixel(self, place):
        """Where a place of the scene is on the screen."""
        (client,) = self.server.get_clients().values()
        camera = client.camera
        rotation = vtf.SO3(np.asarray(camera.wxyz)).as_matrix()
        seen = rotation.T @ (self.page.desk.frame.to_page(np.asarray(place)) - camera.position)
        focal = 0.5 * SIZE["height"] / np.tan(0.5 * camera.fov)
        return tuple(0.5 * np.array([SIZE["width"], SIZE["height"]]) + focal * seen[:2] / seen[2])

    def clicks(self, place):
        self.web.mouse.click(*self.pixel(place))

    def plans(self, start, goal):
        """Click twice, and wait for the answer."""
        self.presses("start")
        self.settle()  # a picture that is still drawn can swallow a click
        self.clicks(start)
        self.sees("Click the ground: goal")
        self.clicks(goal)
        self.sees("Click the ground: start")

    def picture(self):
        """What the browser shows, (height, width, 3)."""
        return np.asarray(Image.open(io.BytesIO(self.web.screenshot(scale="css"))).convert("RGB")).astype(int)

    def around(self, picture, place, reach=4):
        """Pixels around a place of the scene."""
        u, v = (round(x) for x in self.pixel(place))
        return picture[v - reach : v + reach + 1, u - reach : u + reach + 1]
