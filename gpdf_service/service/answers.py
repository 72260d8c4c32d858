"""From a request's bytes to its reply: decoded, its deadline looked at, handled; each failure is a status and words."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

import msgspec
from gpdf_schemas import MAX_REQUEST_BYTES, DecodeError, Reply, Status, decode

from gpdf_service.errors import GpdfError
from gpdf_service.service.scenes import FullError

log = logging.getLogger(__name__)

Answers = dict[str, tuple[type[Any], type[Reply], Callable[[Any], Reply]]]
"""By key: the request's type, the reply's, and what makes one of the other."""


class RefusedError(Exception):
    """A request is refused, with the status that says why."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(message)
        self.status = status


def refuse(kind: type[Reply], planner: str, status: Status, message: str, request_id: str = "") -> Reply:
    """A reply that only says why there is none."""
    return kind(request_id=request_id, status=status, message=message, planner=planner)


def answer(answers: Answers, planner: str, key: str, payload: bytes, received: float) -> Reply:
    """Answer one request; never raises.

    Args:
        answers: What each key does.
        planner: Id of the service.
        key: The key that was asked.
        payload: The request's bytes.
        received: When it arrived, on `time.monotonic` [s]; its deadline counts from there.
    """
    request_kind, reply_kind, handle = answers[key]
    request_id = ""

    def no(status: Status, message: str) -> Reply:
        return refuse(reply_kind, planner, status, message, request_id)

    try:
        request = decode(payload, request_kind, limit=MAX_REQUEST_BYTES)
        request_id = request.request_id
        waited = time.monotonic() - received
        if waited >= request.deadline_s:
            words = f"the request waited {waited:.2f} s, its deadline was {request.deadline_s:.2f} s. Ask later."
            return no(Status.TIMEOUT, words)
        reply = handle(msgspec.structs.replace(request, deadline_s=request.deadline_s - waited))
        return msgspec.structs.replace(reply, timings={**reply.timings, "waited": waited})
    except (DecodeError, ValueError) as error:
        return no(Status.INVALID_REQUEST, str(error))
    except RefusedError as error:
        return no(error.status, str(error))
    except FullError as error:
        return no(Status.BUSY, str(error))
    except GpdfError as error:
        return no(Status.INVALID_REQUEST, str(error))
    except Exception:
        log.exception("request %s on %s", request_id, key)
        return no(Status.INTERNAL, "the service failed; its log says more.")
