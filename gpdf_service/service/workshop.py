"""Builds: from files to the file of a scene's next version. Runs in the build process, or in this one."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from gpdf_service.clouds import read_cloud
from gpdf_service.clouds.formats import as_bytes, greatest
from gpdf_service.config import Config
from gpdf_service.errors import SceneFileError
from gpdf_service.pipeline import Progress, build_scene
from gpdf_service.scene import Scene, load_scene
from gpdf_service.search.ways import Prefer
from gpdf_service.service.changes import Change, changed
from gpdf_service.service.journal import arrays_of
from gpdf_service.service.memory import held_bytes
from gpdf_service.service.scene_files import SUFFIX, SceneFiles, short_of_room
from gpdf_service.types import Agent, resolve_agent

MAKE_ROOM = "Make room in the state folder"
"""What helps when the disk is why something is not kept."""


class Job(msgspec.Struct, frozen=True):
    """One version of a scene, to be built from one of `file`, `cloud`, or `base` and `changes`.

    Attributes:
        name: Of the scene.
        version: To give it, or a later one if the file has had that already.
        folder: The state folder.
        file: A cloud or a scene.
        cloud: What was uploaded, as the journal keeps it.
        base: File of the version before.
        changes: What was sent since, as the journal keeps it, with the radius and the voxels [m] of each.
        agents: Measures of the bodies that were planned for last.
        spare_bytes: That stay free on the disk.
    """

    name: str
    version: int
    folder: str
    file: str = ""
    cloud: str = ""
    base: str = ""
    changes: list[tuple[str, float, float]] = []
    agents: list[dict[str, Any]] = []
    spare_bytes: float = 0.0


class BuildError(Exception):
    """A build failed, in words."""


class NotKeptError(BuildError):
    """What was built, or sent, cannot be written to the state folder."""


class EndedError(Exception):
    """The service ends; what is not built stays in the journal."""


class Workshop:
    """Builds one job after another; keeps what it built, from which the next version is made in a moment.

    Args:
        config: Settings of what is built.
        memory_bytes: Of the scenes that are kept.
        bodies: Names of the bodies whose free spaces are built with each scene.
    """

    def __init__(
        self, config: Config | None = None, memory_bytes: float = float("inf"), bodies: Sequence[str] = ()
    ) -> None:
        self._config, self._memory_bytes, self._bodies = config, memory_bytes, bodies
        self._kept: OrderedDict[Path, tuple[Path, Scene]] = OrderedDict()  # by its file; that until it is published

    def build(self, job: Job, progress: Progress) -> Path:
        """Build it, and save it; its file, which is on the disk under a name that nobody looks for yet.

        Raises:
            GpdfError: it cannot be built.
            NotKeptError: it cannot be written.
        """
        scene = self._scene(job, progress)
        for body in dict.fromkeys([*map(resolve_agent, self._bodies), *(Agent(**measures) for measures in job.agents)]):
            progress(f"free space of {body.name}", 0.9)
            scene.ways(body, Prefer.COMPANION)  # and the free spaces that they take, which are saved
        progress("save", 0.95)
        files = SceneFiles(Path(job.folder))
        scene.version = max(job.version, scene.version)
        file = files.built(job.name, scene.version)
        try:
            scene.save(file)
        except OSError as error:
            raise NotKeptError(f"it cannot be kept ({error.strerror or error}). {MAKE_ROOM}") from error
        if short := short_of_room(files.folder, job.spare_bytes):
            file.unlink()
            raise NotKeptError(f"it cannot be kept ({short}). {MAKE_ROOM}")
        self._kept.pop(Path(job.base), None)
        self._kept[files.path_of(job.name, scene.version)] = file, scene
        self.forget_gone()
        while self._kept and self.held > self._memory_bytes:
            self._kept.popitem(last=False)
        return file

    @property
    def held(self) -> float:
        """What the scenes that are kept take [bytes]."""
        return sum(held_bytes(scene) for _, scene in self._kept.values())

    def forget_gone(self) -> None:
        """Let go of the scenes whose files are not there any more: they are unloaded, or replaced."""
        for file in [file for file, (built, _) in self._kept.items() if not (built.is_file() or file.is_file())]:
            del self._kept[file]

    def _scene(self, job: Job, progress: Progress) -> Scene:
        if job.cloud:
            sent = arrays_of(Path(job.cloud))
            points, colours = sent["points"][:, :3], sent["points"][:, 3:]
            shown = as_bytes(colours, greatest(colours))
            given = {"origins": sent.get("origins"), "colours": shown}
            return build_scene(points, sent.get("ground"), self._config, **given, progress=progress)
        if job.file:
            progress("read the file", 0.0)
            path = Path(job.file)
            if path.suffix == SUFFIX:
                return load_scene(path)
            cloud = read_cloud(path)
            more = {"origins": cloud.origins, "colours": cloud.colours}
            return build_scene(cloud.points, cloud.ground, self._config, **more, progress=progress)
        if not job.base:
            raise SceneFileError("a change", "the scene that it belongs to could not be built", "Load the scene first.")
        base = self._kept[Path(job.base)][1] if Path(job.base) in self._kept else load_scene(job.base)
        return changed(base, [_change(Path(path), *how) for path, *how in job.changes], progress)


def _change(path: Path, radius: float, thin: float) -> Change:
    sent = arrays_of(path)
    gone = sent["gone"] > 0
    origins = sent["origins"][~gone] if "origins" in sent else None
    return Change(sent["points"][~gone], sent["points"][gone], radius, origins, thin)
