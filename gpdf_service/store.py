"""One scene, one file: named arrays in a zip, each packed and with its checksum, written atomically.

`meta` is JSON in NumPy's format; it tells how each array lies in its bytes.
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
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from errno import ENOENT
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpdf_service.errors import SceneFileError, words_of
from gpdf_service.packing import Packed, pack, unpack

SCHEMA_VERSION = 9
"""The only one that is read: who has another one builds the scene again."""
_META = "meta.npy"
_CHUNK = 2**20
"""[bytes]"""
MOST = 1000
"""[-] What a scene file unpacks to in its own size, at most; true ones unpack to 4 to 20 of it, a bomb to 10,000."""

Arrays = dict[str, NDArray[Any]]


def write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> None:
    """Write `arrays` and `meta` (JSON) to `path`: complete under that name, or not there at all.

    Raises:
        OSError: it cannot be written there.
    """
    target = Path(path)
    if not target.parent.is_dir() or target.is_dir():
        raise FileNotFoundError(ENOENT, "no file can be written there", str(target))
    packed = {name: pack(np.asarray(array)) for name, array in arrays.items()}
    lie = {name: dataclasses.astuple(how) for name, (how, _) in packed.items()}
    header = json.dumps({"schema_version": SCHEMA_VERSION, "arrays": lie, **meta}).encode()
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            with zipfile.ZipFile(file, "w") as stored:
                with stored.open(_META, "w") as entry:
                    np.lib.format.write_array(entry, np.frombuffer(header, np.uint8), allow_pickle=False)
                for name, (_, raw) in packed.items():
                    stored.writestr(zipfile.ZipInfo(name), raw)  # without the time, so that a scene's bytes are its own
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).replace(target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


class _Stored:
    """The open file, and how its arrays lie in it."""

    def __init__(self, path: Path) -> None:
        self._zip = zipfile.ZipFile(path)
        with self._zip.open(_META) as file:
            self.meta = json.loads(bytes(np.lib.format.read_array(file, allow_pickle=False)))
        self._packed = {name: _described(*how) for name, how in self.meta.pop("arrays", {}).items()}
        self.names = list(self._packed)
        if sum(how.nbytes for how in self._packed.values()) > MOST * path.stat().st_size:
            raise ValueError("it says that it unpacks to more than a scene file does")

    def array(self, name: str) -> NDArray[Any]:
        return unpack(self._packed[name], self._zip.read(name))

    def check(self, name: str) -> None:
        """Compare an array with its checksum, without memory for it."""
        with self._zip.open(name) as file:
            while file.read(_CHUNK):
                pass


def _described(dtype: str, shape: list[int], kept: str, lengths: list[int], *decimal: Any) -> Packed:  # noqa: ANN401
    return Packed(dtype, tuple(shape), kept, tuple(lengths), *decimal)


class Later:
    """Arrays of a file, read when they are asked for: of the file that was opened, even if it is replaced since."""

    def __init__(self, stored: _Stored, path: Path) -> None:
        self._stored, self._path = stored, path

    def under(self, prefix: str) -> Arrays:
        """The arrays whose names begin with `prefix`, by what follows it.

        Raises:
            SceneFileError: the file was written over, or is damaged by now.
        """
        with _reading(self._path):
            names = [name for name in self._stored.names if name.startswith(prefix)]
            return {name.removeprefix(prefix): self._stored.array(name) for name in names}

    def check(self, names: Iterable[str]) -> None:
        """Compare arrays with their checksums, without memory for them."""
        for name in names:
            self._stored.check(name)


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
        stored = _Stored(target)
    if (version := stored.meta.get("schema_version")) != SCHEMA_VERSION:
        found = f"another gpdf built it: it has schema version {version}, this one reads {SCHEMA_VERSION}"
        raise SceneFileError(asked, found, "Build the scene again from its cloud.")
    with _reading(target):
        shelved = {name for name in stored.names if later and name.startswith(later)}
        arrays = {name: stored.array(name) for name in stored.names if name not in shelved}
        (rest := Later(stored, target)).check(shelved)
    return arrays, stored.meta, rest


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
    """Turn nested dataclasses, named and other tuples of arrays and numbers into named arrays."""
    if names := _names_of(type(value)):
        parts = {name: getattr(value, name) for name in names}
    elif isinstance(value, tuple):
        parts = {str(i): part for i, part in enumerate(value)}
    else:
        return {prefix: np.asarray(value)}
    made: Arrays = {}
    for name, part in parts.items():
        made |= flatten(part, f"{prefix}/{name}")
    return made


def restore(kind: Any, arrays: Mapping[str, NDArray[Any]], prefix: str) -> Any:  # noqa: ANN401 - any of these
    """Rebuild what `flatten` took apart; `kind` is its type."""
    if names := _names_of(kind):
        hints = _hints(kind)
        return kind(**{name: restore(hints[name], arrays, f"{prefix}/{name}") for name in names})
    if typing.get_origin(kind) is tuple:
        (item, *_) = typing.get_args(kind)
        beneath = under(f"{prefix}/", arrays)
        count = len({name.partition("/")[0] for name in beneath})
        return tuple(restore(item, beneath, str(i)) for i in range(count))
    if prefix not in arrays:
        raise SceneFileError("scene file", f"the part {prefix!r} is missing", "Build the scene again from its cloud.")
    value = arrays[prefix]
    if isinstance(kind, type) and kind in (int, float, bool, str) and not isinstance(kind, types.GenericAlias):
        return kind(value)
    return value


def _names_of(kind: Any) -> tuple[str, ...]:  # noqa: ANN401 - any type
    """The fields of a dataclass or a named tuple; none of another type."""
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return tuple(each.name for each in dataclasses.fields(kind))
    names: tuple[str, ...] = getattr(kind, "_fields", ())
    return names


@cache
def _hints(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind)
