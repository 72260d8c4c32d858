"""Replay without a service: the scenes of a log by their hashes, and what moved in them at the recorded times."""

from __future__ import annotations

import contextlib
import logging
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from gpdf_schemas import Array, MovingObstacle, PlanReply, decode, encode, keys
from tqdm import tqdm

from gpdf_service.clouds import read_cloud
from gpdf_service.errors import RequestError, SceneFileError
from gpdf_service.pipeline import build_scene
from gpdf_service.scene import Scene, load_scene
from gpdf_service.service.answers import answer
from gpdf_service.service.moving import Moving
from gpdf_service.service.planning import Planning
from gpdf_service.service.replay import Moved, Planned, recorded_scenes
from gpdf_service.service.scene_files import SUFFIX

log = logging.getLogger(__name__)


class Course:
    """What moved, at the times of the log."""

    def __init__(self) -> None:
        self._now = 0.0
        self.moving = Moving(lambda: self._now)

    def follow(self, event: Moved) -> None:
        """Something was published."""
        self._now = event.stamp_ns / 1e9
        with contextlib.suppress(ValueError):  # one has no sense: the service left that out, too
            self.moving.publish(event.scene, event.obstacles)

    def at(self, plan: Planned) -> list[MovingObstacle]:
        """What was in the way when a plan was begun."""
        self._now = plan.stamp_ns / 1e9
        living = self.moving.living(plan.request.scene)
        return [MovingObstacle(id=id_, points=Array.pack(one.points)) for id_, one in living.items()]


class InProcess:
    """Plans again, in the same scenes and with the same obstacles on their way.

    Args:
        path: The log.
        named: NAME=CLOUD for each scene that is given by hand, all its versions.
        folder: Where to look for scene files whose hashes are the log's.
    """

    def __init__(self, path: Path, named: Sequence[str], folder: Path | None) -> None:
        self._digests = recorded_scenes(path)
        self._named = {name: _read(Path(file)) for name, _, file in (text.partition("=") for text in named)}
        self._found = _by_digest(folder, set(self._digests.values())) if folder else {}
        for (name, version), digest in self._digests.items():
            if name in self._named and self._named[name].digest != digest:
                log.warning("scene %s is another place than version %d of it in the log", name, version)
        self._course = Course()

    def scene_of(self, plan: Planned) -> Scene:
        """The scene that a plan was made in.

        Raises:
            RequestError: it is not given.
        """
        scene = self._scene(plan)
        if scene is None:
            name, digest = plan.request.scene, self._digest(plan)
            words = f"Name it with --scene {name}=CLOUD, or give the folder of the scene with the hash {digest or '?'}."
            raise RequestError("replay", f"the log's scene {name!r} is not given", words)
        return scene

    def knows(self, plan: Planned) -> bool:
        """Whether the scene that a plan was made in is given."""
        return self._scene(plan) is not None

    def _scene(self, plan: Planned) -> Scene | None:
        return self._named.get(plan.request.scene) or self._found.get(self._digest(plan))

    def _digest(self, plan: Planned) -> str:
        return self._digests.get((plan.request.scene, plan.reply.scene_version), "")

    def ask_all(self, events: Sequence[Planned | Moved]) -> list[PlanReply]:
        """The replies of today to all plans, as if each came at its recorded time."""
        replies = []
        for event in tqdm(events, desc="replay", unit="event", disable=not sys.stderr.isatty()):
            if isinstance(event, Planned):
                self._course.at(event)
                replies.append(self._ask(event))
            else:
                self._course.follow(event)
        return replies

    def _ask(self, plan: Planned) -> PlanReply:
        scene = self.scene_of(plan)
        planning = Planning(lambda name, timeout_s: scene, self._course.moving, "replay")
        by = planning.answers[keys.PLAN]
        return decode(answer(by, "replay", encode(plan.request), time.monotonic(), 0.0), PlanReply)


def _read(path: Path) -> Scene:
    if path.suffix == SUFFIX:
        return load_scene(path)
    cloud = read_cloud(path)
    return build_scene(cloud.points, cloud.ground, origins=cloud.origins)


def _by_digest(folder: Path, wanted: set[str]) -> dict[str, Scene]:
    found = {}
    for path in folder.glob(f"*{SUFFIX}"):
        try:
            scene = load_scene(path)
        except SceneFileError as error:
            log.warning("%s", error)
            continue
        if scene.digest in wanted:
            found[scene.digest] = scene
    return found
