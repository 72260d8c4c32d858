"""Messages on stderr: a line for people, or one JSON object a line for machines."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable
from typing import Literal

PLAIN = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime"}
"""Attributes that every record has; the others came with `extra=` and are the message's data."""


MOST, WINDOW_S = 100, 60.0
"""Messages of one line of the program in so many seconds; strangers cause some, and they are on a disk, too."""


class Sparing(logging.Filter):
    """Lets so many messages of each line of the program pass; the first after a pause says how many were left out.

    Args:
        clock: Monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock, self._lock = clock, threading.Lock()
        self._seen: dict[tuple[str, int], tuple[float, int]] = {}  # since when, and how many

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether it is told."""
        where = record.pathname, record.lineno
        with self._lock:
            began, count = self._seen.get(where, (-WINDOW_S, 0))
            if (now := self._clock()) - began >= WINDOW_S:
                if count > MOST:
                    left_out = f"(and {count - MOST} more of these, which were not told)"
                    record.msg, record.args = f"{record.getMessage()} {left_out}", ()
                began, count = now, 0
            self._seen[where] = began, count + 1
        return count < MOST


class JsonFormatter(logging.Formatter):
    """One object a line: time (UTC), level, logger, message, and whatever `extra=` gave."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        made: dict[str, object] = {
            "time": f"{stamp}.{int(record.msecs):03d}Z",
            "level": record.levelname,
            "logger": record.name,
        }
        made |= {"message": record.getMessage()} | _data(record)
        if record.exc_info:
            made["exception"] = self.formatException(record.exc_info)
        return json.dumps(made, default=str)


class TextFormatter(logging.Formatter):
    """A line for people; the data follow as key=value."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        return " ".join([super().format(record), *(f"{key}={value}" for key, value in _data(record).items())])


def set_up(style: Literal["text", "json"]) -> None:
    """Let all messages of the process go to stderr."""
    handler = logging.StreamHandler()
    lines = "%(asctime)s %(levelname)s %(name)s: %(message)s"
    handler.setFormatter(JsonFormatter() if style == "json" else TextFormatter(lines))
    handler.addFilter(Sparing())
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)


def _data(record: logging.LogRecord) -> dict[str, object]:
    return {key: value for key, value in vars(record).items() if key not in PLAIN}
