"""What the process runs that builds scenes, the `Child` of a `Builder`."""

from __future__ import annotations

import logging
import os
import resource
from multiprocessing.connection import Connection

import msgspec
import numpy as np

from gpdf_service.config import Config
from gpdf_service.errors import GpdfError
from gpdf_service.fields.tree import build_tree
from gpdf_service.service.builder import MB, SMALLER, BuildSettings, Built, Failed, Note
from gpdf_service.service.child import go_first
from gpdf_service.service.logs import set_up
from gpdf_service.service.memory import TIDY_S
from gpdf_service.service.workshop import Job, NotKeptError, Workshop

log = logging.getLogger(__name__)
NICE = 5
"""Plans come ahead of builds."""


def serve(pipe: Connection, workshop: Workshop, limit_bytes: int) -> None:
    """Build until the other end is closed, or memory runs out: then a fresh process is better than this one."""
    try:
        while True:
            while not pipe.poll(TIDY_S):
                workshop.forget_gone()
            job = msgspec.json.decode(pipe.recv_bytes(), type=Job)
            answer = _do(job, workshop, pipe, limit_bytes)
            pipe.send_bytes(msgspec.json.encode(answer))
            if isinstance(answer, Failed) and not answer.goes_on:
                return
    except (EOFError, OSError):  # the service has ended, however it did
        return


def _do(job: Job, workshop: Workshop, pipe: Connection, limit_bytes: int) -> Built | Failed:
    def tell(stage: str, done: float) -> None:
        pipe.send_bytes(msgspec.json.encode(Note(stage, done)))

    try:
        return Built(str(workshop.build(job, tell)))
    except MemoryError:
        words = (
            f"it needs more than the {limit_bytes / MB:.0f} MB that a build may take (--build-memory-mb). {SMALLER}."
        )
        return Failed(words, goes_on=False)
    except GpdfError as error:
        return Failed(str(error))
    except NotKeptError as error:
        return Failed(str(error), kept=False)
    except BrokenPipeError:  # the service has ended: nobody is told of what is done
        raise
    except Exception:
        log.exception("scene %s", job.name)
        return Failed("the build failed inside the service; its log says more.")


def prepare() -> None:
    """Load what all kernels share, which takes half a second, once for all builders."""
    build_tree(np.zeros((1, 3)))


def main(pipe: Connection, words: bytes) -> None:
    """Build for the service at the other end, as the `BuildSettings` say."""
    settings = msgspec.json.decode(words, type=BuildSettings)
    set_up(settings.log_format)  # type: ignore[arg-type]
    go_first()
    os.nice(NICE)
    resource.setrlimit(resource.RLIMIT_DATA, (settings.limit_bytes, settings.limit_bytes))
    workshop = Workshop(Config.from_mapping(settings.config), settings.memory_bytes, settings.bodies)
    serve(pipe, workshop, settings.limit_bytes)
