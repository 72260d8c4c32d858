"""A thread that does jobs by name: of jobs with one name that wait, only the newest is done."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from gpdf_client import ClientError

log = logging.getLogger(__name__)
Job = Callable[[], None]


class Worker:
    """Keeps slow work off the page's own threads; a slider that is dragged asks for its last place only.

    Args:
        name: Name of the thread.
        on_error: Told in words why a job failed.
    """

    def __init__(self, name: str, on_error: Callable[[str], None]) -> None:
        self._on_error = on_error
        self._waiting: dict[str, Job] = {}
        self._changed = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def do(self, name: str, job: Job) -> None:
        """Do `job` soon, after all others that wait, in place of one of that name among them."""
        with self._changed:
            self._waiting.pop(name, None)
            self._waiting[name] = job
            self._changed.notify()

    def close(self) -> None:
        """Let the running job end, and do no other."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: bool(self._waiting) or self._closing)
                if self._closing:
                    return
                job = self._waiting.pop(next(iter(self._waiting)))
            try:
                job()
            except (ClientError, ValueError) as error:
                self._on_error(str(error))
            except Exception as error:
                log.exception("a job of the page failed")
                self._on_error(f"The page failed: {error!r}. Its terminal says more.")
