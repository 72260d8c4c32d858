"""What was acknowledged and is not built yet: a file a task, on the disk before the acknowledgement."""

from __future__ import annotations

import json
import os
import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gpdf_service.errors import SceneFileError
from gpdf_service.service.scene_files import sync_folder

SUFFIX = ".task"
STORED = re.compile(r"(?P<number>\d+)(@(?P<version>\d+))?" + re.escape(SUFFIX))
Kind = Literal["file", "cloud", "change"]
_DAMAGE = ValueError, KeyError, OSError, EOFError


@dataclass(frozen=True, slots=True)
class Task:
    """One entry of the journal.

    Attributes:
        path: Its file.
        kind: What it brings: a file of the scenes folder, a cloud, or a change of a scene.
        scene: Name of the scene.
        facts: What else there is to know of it, ready for JSON.
        size: Points in it.
        version: That the build which takes it makes; 0 while none does.
    """

    path: Path
    kind: Kind
    scene: str
    facts: Mapping[str, Any]
    size: int
    version: int = 0


class Journal:
    """A folder of tasks in the order in which they were acknowledged; safe for many threads."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        for path in folder.iterdir():
            if path.name.startswith(".") and STORED.fullmatch(path.name[1:]):  # cut short: never acknowledged
                path.unlink()
        self._lock = threading.Lock()
        self._next = 1 + max((_number(path) for path in folder.iterdir()), default=0)

    def put(self, kind: Kind, scene: str, facts: Mapping[str, Any], **arrays: NDArray[Any]) -> Task:
        """Write a task down; when this returns, neither a kill nor a loss of power takes it back.

        Raises:
            OSError: the disk does not take it.
        """
        with self._lock:
            number, self._next = self._next, self._next + 1
        path = self.folder / f"{number:012d}{SUFFIX}"
        size = len(arrays["points"]) if "points" in arrays else 0
        meta = json.dumps({"kind": kind, "scene": scene, "facts": dict(facts), "size": size}).encode()
        partial = path.with_name(f".{path.name}")
        try:
            with partial.open("wb") as file:
                np.savez(file, allow_pickle=False, meta=np.frombuffer(meta, np.uint8), **arrays)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
        sync_folder(self.folder)
        return Task(path, kind, scene, facts, size)

    def promise(self, task: Task, version: int) -> Task:
        """Say which version holds the task: once that version's file is there, the task is done, whatever happens."""
        path = self.folder / f"{_number(task.path):012d}@{version}{SUFFIX}"
        task.path.replace(path)
        sync_folder(self.folder)
        return Task(path, task.kind, task.scene, task.facts, task.size, version)

    def done(self, task: Task) -> None:
        """Forget a task."""
        task.path.unlink(missing_ok=True)

    def waiting(self) -> tuple[list[Task], list[str]]:
        """The tasks in their order, and in words which of them cannot be read."""
        found, wrong = [], []
        for path in sorted((path for path in self.folder.iterdir() if STORED.fullmatch(path.name)), key=_number):
            try:
                found.append(_read(path))
            except _DAMAGE as error:
                wrong.append(f"{path.name} of the journal cannot be read ({error})")
        return found, wrong


def arrays_of(path: Path) -> dict[str, NDArray[Any]]:
    """What a task brings.

    Raises:
        SceneFileError: its file cannot be read.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files if name != "meta"}
    except _DAMAGE as error:
        raise SceneFileError("what was sent", f"it cannot be read again ({error})", "Send it again.") from error


def _read(path: Path) -> Task:
    with np.load(path, allow_pickle=False) as stored:
        meta = json.loads(bytes(stored["meta"]))
    match = STORED.fullmatch(path.name)
    version = int(match["version"] or 0) if match else 0
    return Task(path, meta["kind"], meta["scene"], meta["facts"], int(meta["size"]), version)


def _number(path: Path) -> int:
    match = STORED.fullmatch(path.name)
    return int(match["number"]) if match else 0
