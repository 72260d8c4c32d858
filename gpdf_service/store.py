"""One scene, one file: named arrays in an uncompressed zip (NumPy's .npz), each with its checksum, written atomically.

Nothing is pickled, so a scene file from a stranger can hold wrong numbers but no code.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import tempfile
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from errno import ENOENT
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from gpdf_service.errors import SceneFileError, words_of

SCHEMA_VERSION = 4
_META = "meta"
_CHUNK = 2**20
"""[bytes]"""

Arrays = dict[str, NDArray[Any]]


def write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> None:
    """Write `arrays` and `meta` (JSON) to `path`: complete under that name, or not there at all.

    Raises:
        OSError: it cannot be written there.
    """
    target = Path(path)
    if not target.parent.is_dir() or target.is_dir():
        raise FileNotFoundError(ENOENT, "no file can be written there", str(target))
    header = np.frombuffer(json.dumps({"schema_version": SCHEMA_VERSION, **meta}).encode(), np.uint8)
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, allow_pickle=False, **{_META: header, **arrays})
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).replace(target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


class Later:
    """Arrays of a file, read when they are asked for: of the file that was opened, even if it is replaced since."""

    def __init__(self, stored: NpzFile, path: Path) -> None:
        self._stored, self._path = stored, path

    def under(self, prefix: str) -> Arrays:
        """The arrays whose names begin with `prefix`, by what follows it.

        Raises:
            SceneFileError: the file was written over, or is damaged by now.
        """
        with _reading(self._path):
            names = [key for key in self._stored.files if key.startswith(prefix)]
            return {key.removeprefix(prefix): self._stored[key] for key in names}

    def check(self, names: Iterable[str]) -> None:
        """Compare arrays with their checksums, without memory for them."""
        assert self._stored.zip is not None
        for name in names:
            with self._stored.zip.open(f"{name}.npy") as file:
                while file.read(_CHUNK):
                    pass


def read_arrays(path: str | os.PathLike[str], later: str | None = None) -> tuple[Arrays, dict[str, Any], Later]:
    """Read what `write_arrays` wrote.

    Args:
        path: The file.
        later: Arrays whose names begin with this are checked, but read only when they are asked for.

    Raises:
        SceneFileError: the file is missing, damaged, no scene, or of another schema version.
    """
    target = Path(path)
    asked = f"scene file {target}"
    if not target.is_file():
        raise SceneFileError(asked, "there is no such file", "Build it first: gpdf scene build CLOUD --out FILE.")
    with _reading(target):
        stored = np.load(target, allow_pickle=False)
        shelved = {key for key in stored.files if later and key.startswith(later)}
        arrays = {key: stored[key] for key in stored.files if key not in shelved}
        (rest := Later(stored, target)).check(shelved)
        meta = json.loads(bytes(arrays.pop(_META)))
    if meta.get("schema_version") != SCHEMA_VERSION:
        found = f"it has schema version {meta.get('schema_version')}, this program reads {SCHEMA_VERSION}"
        raise SceneFileError(asked, found, "Build the scene again from its cloud.")
    return arrays, meta, rest


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except MemoryError:  # it may be whole
        raise
    except Exception as error:  # whatever damaged bytes come to
        found = f"it is damaged or no scene ({words_of(error)})"
        raise SceneFileError(f"scene file {path}", found, "Build it again.") from error


def under(prefix: str, arrays: Mapping[str, NDArray[Any]]) -> Arrays:
    """The arrays whose names begin with `prefix`, by what follows it."""
    return {key.removeprefix(prefix): value for key, value in arrays.items() if key.startswith(prefix)}


def flatten(value: object, prefix: str) -> Arrays:
    """Turn nested dataclasses and tuples of arrays and numbers into named arrays."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    elif isinstance(value, tuple):
        parts = {str(i): part for i, part in enumerate(value)}
    else:
        return {prefix: np.asarray(value)}
    made: Arrays = {}
    for name, part in parts.items():
        made |= flatten(part, f"{prefix}/{name}")
    return made


def restore(kind: Any, arrays: Mapping[str, NDArray[Any]], prefix: str) -> Any:  # noqa: ANN401 - any dataclass
    """Rebuild what `flatten` took apart; `kind` is its type."""
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        hints = typing.get_type_hints(kind)
        parts = {f.name: restore(hints[f.name], arrays, f"{prefix}/{f.name}") for f in dataclasses.fields(kind)}
        return kind(**parts)
    if typing.get_origin(kind) is tuple:
        (item, *_) = typing.get_args(kind)
        count = 0
        while any(key == f"{prefix}/{count}" or key.startswith(f"{prefix}/{count}/") for key in arrays):
            count += 1
        return tuple(restore(item, arrays, f"{prefix}/{i}") for i in range(count))
    if prefix not in arrays:
        raise SceneFileError("scene file", f"the part {prefix!r} is missing", "Build the scene again from its cloud.")
    value = arrays[prefix]
    if isinstance(kind, type) and kind in (int, float, bool, str) and not isinstance(kind, types.GenericAlias):
        return kind(value)
    return value
