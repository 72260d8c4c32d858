"""One scene, one file: named arrays in an uncompressed zip (NumPy's .npz), each with its checksum, written atomically.

Nothing is pickled, so a scene file from a stranger can hold wrong numbers but no code.
"""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
import types
import typing
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpdf_service.errors import SceneFileError

SCHEMA_VERSION = 4
_META = "meta"

Arrays = dict[str, NDArray[Any]]


def write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> None:
    """Write `arrays` and `meta` (JSON) to `path`: complete under that name, or not there at all."""
    target = Path(path)
    header = np.frombuffer(json.dumps({"schema_version": SCHEMA_VERSION, **meta}).encode(), np.uint8)
    handle, temporary = tempfile.mkstemp(dir=target.parent or ".", prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, allow_pickle=False, **{_META: header, **arrays})
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).replace(target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def read_arrays(path: str | os.PathLike[str]) -> tuple[Arrays, dict[str, Any]]:
    """Read what `write_arrays` wrote.

    Raises:
        SceneFileError: the file is missing, damaged, no scene, or of another schema version.
    """
    target = Path(path)
    asked = f"scene file {target}"
    if not target.is_file():
        raise SceneFileError(asked, "there is no such file", "Build it first: gpdf scene build CLOUD --out FILE.")
    try:
        with np.load(target, allow_pickle=False) as stored:
            arrays = {key: stored[key] for key in stored.files}
        meta = json.loads(bytes(arrays.pop(_META)))
    except (zipfile.BadZipFile, ValueError, KeyError, EOFError, OSError, TypeError) as error:
        raise SceneFileError(asked, f"it is damaged or no scene ({error})", "Build the scene again.") from error
    if meta.get("schema_version") != SCHEMA_VERSION:
        found = f"it has schema version {meta.get('schema_version')}, this program reads {SCHEMA_VERSION}"
        raise SceneFileError(asked, found, "Build the scene again from its cloud.")
    return arrays, meta


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
