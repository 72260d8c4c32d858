"""Places and lengths in messages."""

from __future__ import annotations

from math import isfinite

from gpdf_service.types import FloatArray

LONG = 1e6
"""[m] What is further is said in few digits: no map reaches there."""


def metres(value: float) -> str:
    """A coordinate or a length, to a centimetre."""
    return f"{value:z.2f}" if abs(value) < LONG else f"{value:.3g}"


def measure(value: float) -> str:
    """A measure of a body, or what is held against one: to a millimetre where centimetres do not tell it."""
    return f"{value:.3f}".removesuffix("0")


def place_words(place: FloatArray) -> str:
    """A place as "(x, y)" or "(x, y, z)", without what is not known of it."""
    return f"({', '.join(metres(value) for value in place if isfinite(value))})"
