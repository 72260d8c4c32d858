"""Errors that this package raises.

GpdfError
├── ConfigError               a configuration value is unknown, of the wrong type or out of range
├── CloudError                an input point cloud cannot be used
│   ├── NoGroundError         no walkable ground was found in it
│   └── TooLargeError         its scene would take more memory than it may
├── FieldError                a distance field cannot be fitted or asked
├── SceneFileError            a saved scene is missing, damaged or of another version
├── UnknownAgentError         an agent's name that is not in AGENTS
└── RequestError              a planning request that cannot be understood (wrong shape, not finite, unknown option)

A failure to find a path is no error: it is a `Status` with a message.
"""

from __future__ import annotations

from collections.abc import Iterable


class GpdfError(Exception):
    """Root of the tree: `what` was asked, what was `found`, what to `try_`.

    Args:
        what: What was asked for.
        found: What was found instead.
        try_: What the caller can do about it.
    """

    def __init__(self, what: str, found: str, try_: str) -> None:
        super().__init__(f"{what}: {found}. {try_}")
        self.what, self.found, self.try_ = what, found, try_

    def __reduce__(self) -> tuple[type[GpdfError], tuple[str, str, str]]:
        return type(self), (self.what, self.found, self.try_)


class ConfigError(GpdfError):
    """A configuration value is unknown, of the wrong type or out of range."""


class CloudError(GpdfError):
    """An input point cloud cannot be used."""


class NoGroundError(CloudError):
    """No walkable ground was found in the cloud."""


class TooLargeError(CloudError):
    """A cloud's scene would take more memory than it may."""


class FieldError(GpdfError):
    """A distance field cannot be fitted to, or asked at, what was given."""


class SceneFileError(GpdfError):
    """A saved scene is missing, damaged or of another version."""


class RequestError(GpdfError):
    """A planning request that cannot be understood."""


class UnknownAgentError(RequestError):
    """An agent's name that is not known.

    Args:
        name: The name that was asked for.
        known: The names that exist.
    """

    def __init__(self, name: str, known: Iterable[str]) -> None:
        self.name, self.known = name, tuple(known)
        super().__init__(
            f"agent {name!r}",
            "there is no agent of that name",
            f"Use one of {', '.join(self.known)}, or give its measures (gpdf.Agent(...); gpdf plan --width …).",
        )

    def __reduce__(self) -> tuple[type[GpdfError], tuple[str, tuple[str, ...]]]:  # type: ignore[override]
        return type(self), (self.name, self.known)


def words_of(error: Exception) -> str:
    """What reading a file of arrays raised; NumPy's advice on what is none is to run whatever the file holds."""
    return "it holds no arrays of numbers" if "pickle" in str(error) else str(error)
