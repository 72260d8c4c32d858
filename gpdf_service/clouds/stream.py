"""Clouds larger than memory: read in chunks, one real point kept of each voxel.

What is held is what is kept: a few tens of bytes for each voxel that holds a point, however many points the files have.
"""

from __future__ import annotations

import zipfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpdf_service.clouds.formats import (
    NPZ_COLOURS,
    Colours,
    as_bytes,
    greatest,
    las_colours,
    las_points,
    record_colours,
)
from gpdf_service.errors import CloudError
from gpdf_service.tiles.rows import rows_among
from gpdf_service.types import FloatArray, IntArray

CHUNK = 1_000_000
"""Points read at once: 24 MB, and several times that while they are sorted."""
_BITS = 21
"""Of a key for each axis: three fit into 64."""
_REACH = 1 << (_BITS - 1)
"""Voxels to either side of the first point that a key has room for: 20 km at 2 cm."""

Chunk = tuple[FloatArray, NDArray[np.integer] | None, NDArray[Any] | None]
"""Points (n, 3) [m], their labels (n,) and colours (n, 3) as stored, where the file has them."""


class VoxelSieve:
    """Keeps the first point of each voxel; `add` chunks, then `result`.

    Args:
        width: Of the voxels [m].
    """

    def __init__(self, width: float) -> None:
        self.width = _check_width(width)
        self._first: FloatArray | None = None
        self._keys = np.zeros(0, np.int64)
        self._points: list[FloatArray] = []
        self._labels: list[IntArray] = []
        self._colours: list[NDArray[Any]] = []
        self._most: defaultdict[np.dtype[Any], float] = defaultdict(float)

    def add(
        self, points: FloatArray, labels: NDArray[np.integer] | None = None, colours: NDArray[Any] | None = None
    ) -> None:
        """Look at points (n, 3) [m], their labels (n,) and colours (n, 3); those that are not finite are left out."""
        if colours is not None:
            self._most[colours.dtype] = max(self._most[colours.dtype], greatest(colours))
        rows = np.flatnonzero(np.isfinite(points.sum(axis=1)))
        if len(rows) == 0:
            return
        if self._first is None:
            self._first = np.floor(points[rows[0]] / self.width)
        key = _keys(points[rows], self.width, self._first)
        key, first = np.unique(key, return_index=True)
        at = np.searchsorted(self._keys, key)
        fresh = np.append(self._keys, np.int64(-1))[at] != key
        self._keys = np.insert(self._keys, at[fresh], key[fresh])
        rows = np.sort(rows[first[fresh]])
        self._points.append(np.asarray(points[rows], dtype=np.float64))
        if labels is not None:
            self._labels.append(np.asarray(labels[rows], dtype=np.int64))
        if colours is not None:
            self._colours.append(colours[rows])

    def result(self) -> tuple[FloatArray, IntArray | None, Colours | None]:
        """The points that were kept, in the order that they came in, their labels and their colours."""
        points, count = np.concatenate([np.zeros((0, 3)), *self._points]), len(self._points)
        labels = self._labels  # those of some tiles alone say nothing of the others
        colours = [made for part in self._colours if (made := as_bytes(part, self._most[part.dtype])) is not None]
        return (
            points,
            np.concatenate(labels) if labels and len(labels) == count else None,
            np.concatenate(colours) if colours and len(colours) == count else None,
        )


def _check_width(width: float) -> float:
    if not 0.0 < width < np.inf:
        raise CloudError("thin", f"a width of {width!r} m", "It must be positive and finite.")
    return width


def _keys(points: FloatArray, width: float, first: FloatArray) -> IntArray:
    """A number for the voxel of each of the points, (n, 3) [m], none of which is far from the `first` voxel."""
    voxel = (np.floor(points / width) - first).astype(np.int64) + _REACH
    if voxel.min(initial=0) < 0 or voxel.max(initial=0) >= 2 * _REACH:
        far = float(np.abs(voxel - _REACH).max() * width)
        raise CloudError("thin", f"points {far:.0f} m apart", "Take wider voxels, or a part of the cloud.")
    key: IntArray = (voxel[:, 0] << 2 * _BITS) | (voxel[:, 1] << _BITS) | voxel[:, 2]
    return key


def rows_in_new_voxels(points: FloatArray, width: float, *held: FloatArray) -> IntArray:
    """Rows of the points (n, 3) that are the first in a voxel of that `width` [m] in which none of the `held` ones is.

    Raises:
        CloudError: a width that is none, or points too far apart for it.
    """
    _check_width(width)
    if len(points) == 0:
        return np.zeros(0, np.int64)
    low, high = points.min(axis=0), points.max(axis=0)
    key, row = np.unique(_keys(points, width, first := np.floor(low / width)), return_index=True)
    new = np.ones(len(key), dtype=bool)
    for each in held:
        near = each[((each >= low - width) & (each <= high + width)).all(axis=1)]
        taken = rows_among(_keys(near, width, first), key)
        new[taken[taken >= 0]] = False
    rows: IntArray = np.sort(row[new])
    return rows


def chunks_of(path: Path) -> Iterator[Chunk] | None:
    """The points of a file in chunks; None for a kind, or a variant of it, that must be read at once."""
    suffix = path.suffix.lower()
    if suffix in (".las", ".laz"):
        return _las_chunks(path)
    if suffix == ".npz":
        return _npz_chunks(path)
    if suffix in (".ply", ".pcd"):
        layout = (_ply_layout if suffix == ".ply" else _pcd_layout)(path)
        return None if layout is None else _record_chunks(path, *layout)
    return None


def _las_chunks(path: Path) -> Iterator[Chunk]:
    import laspy

    with laspy.open(path) as file:
        for part in file.chunk_iterator(CHUNK):
            yield las_points(part), np.asarray(part.classification), las_colours(part)


def _npz_chunks(path: Path) -> Iterator[Chunk]:
    with zipfile.ZipFile(path) as archive:
        names = {name.removesuffix(".npy") for name in archive.namelist()}
        points = "xyz" if "xyz" in names else "points"
        labels = _rows_of(archive, "label") if "label" in names else None
        shades = next((_rows_of(archive, name) for name in NPZ_COLOURS if name in names), None)
        for part in _rows_of(archive, points):
            colours = None if shades is None else next(shades)
            fits = colours is not None and colours.shape == part.shape
            yield part.astype(np.float64), None if labels is None else next(labels), colours if fits else None


def _rows_of(archive: zipfile.ZipFile, name: str) -> Iterator[NDArray[Any]]:
    with archive.open(f"{name}.npy") as file:
        version = np.lib.format.read_magic(file)  # type: ignore[no-untyped-call]
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, by_column, dtype = read(file)  # type: ignore[no-untyped-call]
        if by_column:
            raise ValueError(f"{name} is stored by columns")
        width = int(np.prod(shape[1:], dtype=np.int64)) * dtype.itemsize
        for begin in range(0, shape[0], CHUNK):
            count = min(CHUNK, shape[0] - begin)
            raw = file.read(count * width)
            if len(raw) < count * width:
                raise EOFError(f"{name} ends early")
            yield np.frombuffer(raw, dtype).reshape(count, *shape[1:])


_PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float32": "f4", "float64": "f8"},
}
"""What a .ply file calls its kinds of numbers, and what NumPy does."""
_HEADER = 1000, 10_000
"""Lines of a header, and characters of one, that are looked at; what goes on without an end is none."""
Layout = tuple[int, int, np.dtype[np.void]]
"""First byte, number and kind of the records of a binary file."""


def _ply_layout(path: Path) -> Layout | None:
    with path.open("rb") as file:
        fields: list[tuple[str, str]] = []
        order, count, elements = "", 0, 0
        for _ in range(_HEADER[0]):
            words = file.readline(_HEADER[1]).decode("ascii", "replace").split()
            if not words or words[0] == "end_header":
                break
            if words[0] == "format":
                order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(words[1], "")
            elif words[0] == "element":
                elements += 1
                count = int(words[2]) if elements == 1 and words[1] == "vertex" else count
            elif words[0] == "property" and elements == 1:
                if words[1] not in _PLY_TYPES:
                    return None  # a list has no fixed length
                fields.append((words[-1], order + _PLY_TYPES[words[1]]))
        return _layout(file.tell(), count, fields) if order else None


def _pcd_layout(path: Path) -> Layout | None:
    with path.open("rb") as file:
        header: dict[str, list[str]] = {}
        for _ in range(_HEADER[0]):
            words = file.readline(_HEADER[1]).decode("ascii", "replace").split()
            if words:
                header[words[0]] = words[1:]
            if words[:1] == ["DATA"]:
                break
        if header.get("DATA") != ["binary"] or any(n != "1" for n in header.get("COUNT", [])):
            return None
        kinds = [f"<{kind.lower()}{size}" for kind, size in zip(header["TYPE"], header["SIZE"], strict=True)]
        return _layout(file.tell(), int(header["POINTS"][0]), list(zip(header["FIELDS"], kinds, strict=True)))


def _layout(begin: int, count: int, fields: list[tuple[str, str]]) -> Layout | None:
    names = [name for name, _ in fields]
    if not {"x", "y", "z"} <= set(names) or len(set(names)) < len(names):
        return None
    return begin, count, np.dtype(fields)


def _record_chunks(path: Path, begin: int, count: int, kind: np.dtype[np.void]) -> Iterator[Chunk]:
    with path.open("rb") as file:
        file.seek(begin)
        for first in range(0, count, CHUNK):
            part = np.fromfile(file, kind, min(CHUNK, count - first))
            if len(part) < min(CHUNK, count - first):
                raise EOFError("it ends early")
            yield np.column_stack([part[axis].astype(np.float64) for axis in "xyz"]), None, record_colours(part)
