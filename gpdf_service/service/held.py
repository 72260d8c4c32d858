"""Scenes by name: in memory as many as fit, the others on disk."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gpdf_service.scene import Scene, load_scene
from gpdf_service.service.journal import Task
from gpdf_service.service.memory import held_bytes
from gpdf_service.service.moving import Moving
from gpdf_service.types import Agent

log = logging.getLogger(__name__)

MAX_BODIES = 4
"""Last used of a scene, whose free spaces come with its next version."""


@dataclass(slots=True)
class Entry:
    """A scene, or why there is none yet.

    Attributes:
        scene: In memory; None when it is not ready, or was evicted.
        file: Where it is on disk.
        facts: What it tells of itself; empty until it is ready.
        pending: Builds that wait or run.
        error: Why the last build failed.
        used: When it was last asked for, on `time.monotonic` [s].
        lock: Held while the scene is loaded, or replaced.
        stage: What the build does, and the share of it that is done.
        waiting: What was sent and waits for its build, in order.
        taken: What the build that runs has taken of it.
        bodies: Those that were planned for last.
    """

    scene: Scene | None = None
    file: Path | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    pending: int = 0
    error: str = ""
    used: float = 0.0
    lock: threading.Lock = field(default_factory=threading.Lock)
    stage: tuple[str, float] = ("", 0.0)
    waiting: list[Task] = field(default_factory=list)
    taken: list[Task] = field(default_factory=list)
    bodies: list[Agent] = field(default_factory=list)

    def note(self, stage: str, done: float) -> None:
        """Take the build's progress."""
        self.stage = stage, done

    def note_body(self, body: Agent) -> None:
        """Somebody of that kind moves here."""
        self.bodies = [*(known for known in self.bodies if known != body), body][-MAX_BODIES:]

    @property
    def building(self) -> bool:
        """Whether a build waits or runs; the scene is the newest only when none does."""
        return self.pending > 0

    @property
    def ready(self) -> bool:
        """Whether there is a scene to plan in."""
        return bool(self.facts)


class Held:
    """The entries of all scenes; safe for many threads.

    Args:
        memory_bytes: Of all scenes together; the least recently used leave memory first.
        moving: What moves in them: a scene that leaves memory takes with it what was made of both.

    Attributes:
        entries: By name; look at them under `lock`.
    """

    def __init__(self, memory_bytes: float, moving: Moving) -> None:
        self.memory_bytes, self.moving = memory_bytes, moving
        self.entries: dict[str, Entry] = {}
        self.lock = threading.Lock()

    def get(self, name: str) -> Entry | None:
        """What is known of a scene."""
        with self.lock:
            return self.entries.get(name)

    def scene(self, entry: Entry) -> Scene:
        """The last complete version of a ready scene, loaded from disk if it had left memory."""
        entry.used = time.monotonic()
        with entry.lock:  # who comes second waits for the first one's load
            if entry.scene is None:
                assert entry.file is not None
                entry.scene = load_scene(entry.file)
                log.info("a scene is loaded", extra={"file": entry.file.name})
                found = entry.scene
            else:
                return entry.scene
        self.trim()
        return found

    def hold(self, name: str, file: Path) -> Entry:
        """A ready scene whose file somebody else keeps, in the place of an older one of that name."""
        with self.lock:
            entry = self.entries.get(name)
            if entry is None or entry.file != file:
                entry = self.entries[name] = Entry(file=file)
            return entry

    def held(self, name: str) -> Entry:
        """What `hold` gave."""
        with self.lock:
            return self.entries[name]

    def forget_gone(self) -> None:
        """Forget the scenes whose files are not there any more; what moves in them stays known."""
        with self.lock:
            gone = [name for name, entry in self.entries.items() if entry.file is None or not entry.file.is_file()]
            for name in gone:
                del self.entries[name]
                self.moving.let_go(name)

    def trim(self) -> float:
        """Let scenes leave memory until the rest fits, the least recently used ahead; of the last one its bodies.

        Returns:
            What is held then [bytes].
        """
        with self.lock:
            entries = sorted(self.entries.items(), key=lambda item: item[1].used)
        sizes = {name: held_bytes((entry.scene, self.moving.kept(name, entry.scene))) for name, entry in entries}
        total = sum(sizes.values())
        kept = [(name, entry) for name, entry in entries if entry.scene is not None]
        for name, entry in kept[:-1]:
            if total <= self.memory_bytes:
                break
            if entry.file is not None and entry.lock.acquire(blocking=False):
                entry.scene = None
                entry.lock.release()
                self.moving.let_go(name)
                total -= sizes[name]
                log.info("scene %s left memory", name, extra={"bytes": sizes[name]})
        if kept and (last := kept[-1][1].scene) is not None:
            name, others = kept[-1][0], total - sizes[kept[-1][0]]
            if total > self.memory_bytes:
                self.moving.let_go(name)
                total = others + held_bytes(last)
            while total > self.memory_bytes and last.forget_oldest_agent():  # who plans in it needs the others soon
                total = others + held_bytes(last)
            if total > self.memory_bytes:
                last.forget_agents()
        return total

    def facts(self) -> dict[str, dict[str, Any]]:
        """Facts of every scene, by name."""
        with self.lock:
            entries = dict(self.entries)
        return {name: describe(entry) for name, entry in entries.items()}


def describe(entry: Entry) -> dict[str, Any]:
    """Facts of one entry, ready for the wire."""
    state = "ready" if entry.ready else ("building" if entry.building else "failed")
    facts: dict[str, Any] = {"state": state, "building": entry.building, "error": entry.error}
    if entry.building:
        facts |= {"stage": entry.stage[0], "done": entry.stage[1]}
    scene = entry.scene
    return (
        facts
        | (entry.facts if scene is None else scene.info())
        | {
            "in_memory": scene is not None,
            "kept": entry.file is not None,
        }
    )
