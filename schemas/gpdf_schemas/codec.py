"""Bytes to messages and back. Unknown fields are ignored, so that an older reader understands a newer writer."""

from __future__ import annotations

import threading
from typing import Any, TypeVar

import msgspec
import numpy as np

MAX_REQUEST_BYTES = 4 << 20
"""A request above this is refused before it is decoded; larger clouds go in parts."""

T = TypeVar("T")
_DECODERS: dict[type, msgspec.msgpack.Decoder[Any]] = {}
_LOCK = threading.Lock()
"""Two threads that are the first to decode one type at once end msgspec 0.22 in a segmentation fault."""


class DecodeError(ValueError):
    """Bytes that are not the message they should be; says what was asked and what was found."""


def encode(message: msgspec.Struct) -> bytes:
    """Message to msgpack; NumPy's numbers are numbers."""
    return msgspec.msgpack.encode(message, enc_hook=_plain)


def decode(data: bytes, kind: type[T], *, limit: int | None = None) -> T:
    """Bytes to a message of type `kind`.

    Raises:
        DecodeError: too long, truncated, nested too deep, a field missing or of the wrong type, a number not finite.
    """
    if limit is not None and len(data) > limit:
        raise DecodeError(f"{kind.__name__}: {len(data)} bytes, at most {limit} are taken. Send it in parts.")
    try:
        message = _decoder(kind).decode(data)
    except (msgspec.MsgspecError, RecursionError, ValueError, OverflowError, MemoryError) as error:
        raise DecodeError(f"{kind.__name__}: {error}. See schemas/CONVENTIONS.md.") from error
    if not _finite(message):
        raise DecodeError(f"{kind.__name__}: a number is not finite. Send finite numbers.")
    return message


def _decoder(kind: type[T]) -> msgspec.msgpack.Decoder[T]:
    """The one decoder of a type."""
    with _LOCK:
        if kind not in _DECODERS:
            _DECODERS[kind] = msgspec.msgpack.Decoder(kind)
        return _DECODERS[kind]


def _plain(value: Any) -> Any:  # noqa: ANN401 - whatever msgspec does not know
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"{type(value).__name__} has no place in a message")


def _finite(value: Any) -> bool:  # noqa: ANN401 - any decoded value
    if isinstance(value, float):
        return value - value == 0.0
    if isinstance(value, msgspec.Struct):
        return all(_finite(getattr(value, name)) for name in value.__struct_fields__)
    if isinstance(value, dict):
        return all(_finite(part) for part in value.values())
    if isinstance(value, list | tuple):
        return all(_finite(part) for part in value)
    return True
