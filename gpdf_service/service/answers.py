"""From a request's bytes to its reply: decoded, its deadline looked at, handled; each failure is a status and words."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec
from gpdf_schemas import MAX_REQUEST_BYTES, DecodeError, Reply, Status, decode, encode

from gpdf_service.errors import GpdfError, RequestError
from gpdf_service.service.scenes import FullError
from gpdf_service.service.words import public
from gpdf_service.service.workshop import NotKeptError

log = logging.getLogger(__name__)

T = TypeVar("T")
Answer = tuple[type[Any], type[Reply], Callable[[Any], T]]
"""The request's type, the reply's, and what makes one of the other: a reply, or the bytes of one."""
Answers = dict[str, Answer[Reply]]
"""By key."""


MAX_REQUEST_ID = 256
"""[characters] Four times a UUID: it is kept with what was given out, and told again."""
MAX_WORDS = 2000
"""[characters] Of a refusal: what a request says may be in it, but not all of a long one."""
LOOKED = "looked"
"""The time of a reply that says when a plan looked at what moves [s]: what was published until then, it knew."""


class RefusedError(Exception):
    """A request is refused, with the status that says why."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(message)
        self.status = status


def refuse(
    kind: type[Reply], planner: str, status: Status, message: str, request_id: str = "", load: float = 0.0
) -> Reply:
    """A reply that only says why there is none."""
    return kind(request_id=request_id, status=status, message=message, planner=planner, load=load)


def answer(by: Answer[Reply | bytes], planner: str, payload: bytes, received: float, load: float) -> bytes:
    """Answer one request with the reply's bytes; never raises.

    Args:
        by: What the key that was asked does; bytes are given back as they are.
        planner: Id of the service.
        payload: The request's bytes.
        received: When it arrived, on `time.monotonic` [s]; its deadline counts from there.
        load: Of the service.
    """
    request_kind, reply_kind, handle = by
    request_id = ""

    def no(status: Status, message: str) -> bytes:
        said = public(message[:MAX_WORDS]) + ("…" if len(message) > MAX_WORDS else "")
        return encode(refuse(reply_kind, planner, status, said, request_id, load))

    try:
        request = decode(payload, request_kind, limit=MAX_REQUEST_BYTES)
        if len(request.request_id) > MAX_REQUEST_ID:
            words = f"it has {len(request.request_id)} characters"
            raise RequestError("request_id", words, f"Give at most {MAX_REQUEST_ID}.")
        request_id = request.request_id
        waited = time.monotonic() - received
        if waited >= request.deadline_s:
            words = f"the request waited {waited:.3g} s, its deadline was {request.deadline_s:.3g} s. Give more time."
            return no(Status.TIMEOUT, words)
        reply = handle(msgspec.structs.replace(request, deadline_s=request.deadline_s - waited))
        if isinstance(reply, bytes):
            return reply
        timings = {**reply.timings, "waited": waited}
        if LOOKED in timings:
            timings[LOOKED] -= received
        return encode(msgspec.structs.replace(reply, timings=timings, load=load))
    except (DecodeError, ValueError) as error:
        return no(Status.INVALID_REQUEST, str(error))
    except RefusedError as error:
        return no(error.status, str(error))
    except FullError as error:
        return no(Status.BUSY, str(error))
    except NotKeptError as error:
        return no(Status.BUILD_FAILED, str(error))
    except GpdfError as error:
        return no(Status.INVALID_REQUEST, str(error))
    except Exception:
        log.exception("a %s, request_id %r", request_kind.__name__, request_id)
        return no(Status.INTERNAL, "the service failed; its log says more.")
