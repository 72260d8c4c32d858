"""What a process runs that plans for a service, a `Child` of its `Pool`."""

from __future__ import annotations

import select
import time
from multiprocessing.connection import Connection
from pathlib import Path

import msgspec
from gpdf_schemas import DrawRequest, decode

from gpdf_service.errors import SceneFileError
from gpdf_service.fields.threads import end_threads
from gpdf_service.service.answers import answer
from gpdf_service.service.child import go_first
from gpdf_service.service.held import Held
from gpdf_service.service.logs import set_up
from gpdf_service.service.memory import TIDY_S
from gpdf_service.service.moving import Living, Moving
from gpdf_service.service.planning import Planning, agent_of
from gpdf_service.service.pool import READY, WARM, Ask, Settings
from gpdf_service.warm import Warming


class Desk:
    """Scenes from their files, what moves in them, and answers.

    Args:
        settings: What it shares with the service.
    """

    def __init__(self, settings: Settings) -> None:
        self._planner, self._bodies = settings.planner, settings.bodies
        self._looked = 0.0
        self._moving = Moving(lambda: self._looked)  # the service has looked, for all
        self._scenes = Held(settings.memory_bytes, self._moving)
        self._planning = Planning(
            lambda name, _: self._scenes.scene(self._scenes.held(name)), self._moving, self._planner
        )
        self._tidied = time.monotonic()

    @property
    def scenes(self) -> list[str]:
        """Names of those that are held."""
        return list(self._scenes.facts())

    def answer(self, ask: Ask) -> bytes:
        """The reply's bytes; none if the scene cannot be read from its file."""
        self._looked = ask.looked
        for name in ask.gone:
            self._moving.forget(name)
        if ask.moving is not None:
            living = {one.id: Living(one.points.unpack(), one.until, one.number) for one in ask.moving}
            self._moving.replace(ask.scene, living)
        try:
            scene = self._scenes.scene(self._scenes.hold(ask.scene, Path(ask.file)))
        except SceneFileError:
            return b""
        if ask.key == WARM:
            own = self._bodies if not ask.request else [agent_of(decode(ask.request, DrawRequest).agent)]
            for body in own:
                scene.prepare(body)
            return b""
        return answer(self._planning.answers[ask.key], self._planner, ask.request, ask.received, ask.load)

    def tidy(self) -> None:
        """Let go of scenes that are unloaded or replaced (their files are gone), and of what is too much."""
        if time.monotonic() - self._tidied >= TIDY_S:
            self._scenes.forget_gone()
            self._scenes.trim()
            self._tidied = time.monotonic()


def serve(pipe: Connection, desk: Desk) -> None:
    """Answer until the other end is closed."""
    waiting = select.poll()
    waiting.register(pipe, select.POLLIN)
    try:
        pipe.send_bytes(READY)
        while True:
            if waiting.poll(1e3 * TIDY_S):
                pipe.send_bytes(desk.answer(decode(pipe.recv_bytes(), Ask)))
            desk.tidy()
    except (EOFError, OSError):  # the service has ended, however it did
        return


def prepare() -> None:
    """Load the kernels of plans."""
    Warming().plans()
    end_threads()


def main(pipe: Connection, words: bytes) -> None:
    """Plan for the service at the other end, as the `Settings` say."""
    settings = msgspec.json.decode(words, type=Settings)
    set_up(settings.log_format)  # type: ignore[arg-type]
    go_first()
    serve(pipe, Desk(settings))
