"""Speech through espeak-ng, where it is installed."""

from __future__ import annotations

import shutil
import subprocess

WORDS_PER_MINUTE = 180
"""A pace that a listener follows while walking."""


class Voice:
    """Speaks one sentence at a time; a new one cuts the old one off, since it is newer news.

    Args:
        language: A voice of espeak-ng, for example "en" or "de".
        program: The synthesiser.

    Raises:
        FileNotFoundError: it is not installed.
    """

    def __init__(self, language: str, program: str = "espeak-ng") -> None:
        found = shutil.which(program)
        if found is None:
            raise FileNotFoundError(f"{program} is not installed. Install it, or go without speech.")
        self._words = [found, "-v", language, "-s", str(WORDS_PER_MINUTE)]
        self._speaking: subprocess.Popen[bytes] | None = None

    def say(self, text: str) -> None:
        """Start to speak; returns at once."""
        self.close()
        self._speaking = subprocess.Popen([*self._words, "--", text], stderr=subprocess.DEVNULL)

    def close(self) -> None:
        """Be silent."""
        if self._speaking is not None:
            self._speaking.terminate()
            self._speaking.wait()
            self._speaking = None
