"""What may be said to strangers."""

from __future__ import annotations

import re

_FOLDERS = re.compile(r"(?<![\w.:/])/(?:[^\s/:'\"]+/)+")


def public(words: str) -> str:
    """Without where files are on this machine: their names alone."""
    return _FOLDERS.sub("", words)
