"""Messages on stderr: a line for people, or one JSON object a line for machines."""

from __future__ import annotations

import json
import logging
import time
from typing import Literal

PLAIN = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime"}
"""Attributes that every record has; the others came with `extra=` and are the message's data."""


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
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)


def _data(record: logging.LogRecord) -> dict[str, object]:
    return {key: value for key, value in vars(record).items() if key not in PLAIN}
