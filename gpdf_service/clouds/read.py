"""Reading point clouds as they come: with their labels, what is not finite left out, in metres and z up."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from gpdf_service.clouds.bag import read_bag
from gpdf_service.clouds.formats import LAS_GROUND, READERS, Colours, Stored, as_bytes, greatest, ground_classes
from gpdf_service.clouds.frame import look, odd_unit, odd_up, turn
from gpdf_service.clouds.stream import VoxelSieve, chunks_of
from gpdf_service.errors import CloudError, GpdfError, words_of
from gpdf_service.tiles.rows import extent_of
from gpdf_service.types import BoolArray, FloatArray

BAGS = (".mcap", ".db3", ".bag")
"""Suffixes of ROS bags."""
COARSEST = 0.01
"""[m] Between two numbers of single precision as large as a coordinate; more, and walls are where no wall is."""
TOLD = GpdfError, ImportError, MemoryError
"""What readers raise with words of its own; what else they raise is whatever damaged bytes come to."""
MAX_EXTENT = 5000.0
"""[m] No place that one plans in on foot is wider; a room in millimetres is."""


@dataclass(frozen=True, slots=True)
class PointCloud:
    """A cloud as read, in metres and z up.

    Attributes:
        points: Points [m], shape (n, 3), all finite.
        ground: Which are ground, shape (n,), where the file says so.
        origins: Where the rays began [m], shape (n, 3), where the file says so.
        colours: Red, green and blue, uint8 of shape (n, 3), where the file has them.
        dropped: Points of the file that were not finite, and were left out.
        scale: Metres of the file's unit.
        up: The axis of the file that points up.
        remarks: What was done to it and what is odd about it, in words.
    """

    points: FloatArray
    ground: BoolArray | None = None
    origins: FloatArray | None = None
    colours: Colours | None = None
    dropped: int = 0
    scale: float = 1.0
    up: str = "z"
    remarks: tuple[str, ...] = ()


def check_finite(points: ArrayLike) -> FloatArray:
    """Points as float64 of shape (n, 3), n = 0 as well, or a clear refusal.

    Raises:
        CloudError: another shape, or not finite.
    """
    return _checked(points)[0]


def _checked(points: ArrayLike) -> tuple[FloatArray, float, float]:
    """`check_finite`, and `extent_of` them."""
    try:
        made = np.ascontiguousarray(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CloudError("point cloud", f"no array of numbers ({error})", "Pass an array of shape (n, 3).") from error
    if made.ndim != 2 or made.shape[1] != 3:
        raise CloudError("point cloud", f"an array of shape {made.shape}", "Pass an array of shape (n, 3): x, y, z.")
    extent, farthest = extent_of(made)
    if not np.isfinite(farthest):
        bad = ~np.isfinite(made).all(axis=1)
        found = f"{int(bad.sum())} of {len(made)} points are not finite, the first in row {int(bad.argmax())}"
        raise CloudError("point cloud", found, "Remove them: points = points[np.isfinite(points).all(axis=1)].")
    return made, extent, farthest


def check_points(points: ArrayLike) -> FloatArray:
    """Points as float64 of shape (n, 3), or a clear refusal.

    Raises:
        CloudError: another shape, empty, not finite, too wide to be in metres, or rounded to single precision far from
            the origin.
    """
    made, extent, farthest = _checked(points)
    if len(made) == 0:
        raise CloudError("point cloud", "it is empty", "Pass at least the points of a floor.")
    if extent > MAX_EXTENT:
        found = f"it is {extent:.6g} wide, more than {MAX_EXTENT:.0f} m"
        raise CloudError("point cloud", found, "Is it in millimetres? Divide by 1000; or crop it.")
    step = float(np.spacing(np.float32(farthest)))
    if step > COARSEST and np.array_equal(made, made.astype(np.float32)):
        found = f"coordinates of {farthest:.0f} m in single precision, which are rounded to {step:.2g} m"
        raise CloudError("point cloud", found, "Take the origin near the points before they are stored as float32.")
    return made


def read_cloud(
    path: str | os.PathLike[str],
    *,
    ground_label: int | None = None,
    topic: str | None = None,
    thin: float | None = None,
    scale: float | None = None,
    up: str | None = None,
) -> PointCloud:
    """Read a cloud by its suffix; a folder is a rosbag2, or holds the tiles of one cloud.

    Args:
        path: The file.
        ground_label: The label that means ground (.npz `label`, LAS class); by name or standard if not given.
        topic: Where a bag has clouds on several topics, the one to take.
        thin: Keep one point of each voxel of this width [m], and read in chunks: only what is kept is ever in memory
            (but for text and compressed .pcd files, which are read at once). A folder of tiles needs it.
        scale: Metres of the file's unit; what the file states, or 1, and judged, if not given.
        up: The axis of the file that points up: x, y, z, -x, -y or -z; what the file states, or z, and judged.

    Raises:
        CloudError: the file is missing, of an unknown kind, damaged, empty, lacks a column, or cannot be in metres.
    """
    file = Path(path)
    if scale is not None or up is not None:
        turn(np.zeros((0, 3)), 1.0 if scale is None else scale, up or "z")  # refused before the work
    if file.suffix.lower() in BAGS or (file / "metadata.yaml").is_file():
        if ground_label is not None:
            raise CloudError(f"bag {file}", "bags carry no labels", "Leave --ground-label out, or use .npz.")
        if not file.exists():
            raise CloudError(f"bag {file}", "there is no such file", "Check the path.")
        return _framed(file, Stored(read_bag(file, topic), up="z", scale=1.0), scale, up)
    if thin is not None:
        return _read_thinned(file, ground_label, VoxelSieve(thin), scale, up)
    if file.is_dir():
        raise CloudError(
            f"folder {file}", "it is no rosbag2", "Of a cloud in tiles say how far to thin it: --thin 0.03."
        )
    return _framed(file, _read_whole(file, ground_label, scale), scale, up)


def _read_whole(file: Path, ground_label: int | None, scale: float | None) -> Stored:
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        kinds = " ".join([*READERS, *BAGS])
        raise CloudError(f"cloud {file}", f"files of kind {file.suffix!r} are not known", f"Use {kinds}.")
    if not file.is_file():
        raise CloudError(f"cloud {file}", "there is no such file", "Check the path.")
    if file.stat().st_size == 0:
        raise CloudError(f"cloud {file}", "it is empty", "Was it copied to its end?")
    with _reading(file):
        return reader(file, ground_label, scale)


@contextmanager
def _reading(file: Path) -> Iterator[None]:
    try:
        yield
    except TOLD:
        raise
    except Exception as error:
        raise CloudError(f"cloud {file}", f"it cannot be read ({words_of(error)})", "Is the file complete?") from error


def _framed(file: Path, stored: Stored, scale: float | None, up: str | None) -> PointCloud:
    """What a file holds in metres, z up, without what is not finite; odd units and axes that nobody asked for are said.

    Raises:
        CloudError: no place in metres can be so.
    """
    points, ground, origins, colours = stored.points, stored.ground, stored.origins, None
    if stored.colours is not None:
        colours = as_bytes(stored.colours, greatest(stored.colours))
    if points.ndim != 2 or points.shape[1] != 3:
        raise CloudError(f"cloud {file}", f"an array of shape {points.shape}", "Store x, y, z a point: (n, 3).")
    finite: BoolArray = np.logical_and.reduce(np.isfinite(points), axis=1)
    dropped = int(len(finite) - finite.sum())
    if dropped:
        points = points[finite]
        ground = None if ground is None else ground[finite]
        origins = None if origins is None else origins[finite]
        colours = None if colours is None else colours[finite]
    if len(points) == 0:
        found = f"none of its {dropped} points is finite" if dropped else "it holds no point"
        raise CloudError(f"cloud {file}", found, "Is it empty or damaged?")
    metres, axis = scale or stored.scale or 1.0, up or stored.up or "z"
    points = turn(points, metres, axis)
    odd = _odd(file, points, unit=scale is None, axis=up is None and axis == "z")
    points = check_points(points)
    told = (stored.remark, f"{dropped} points were not finite and left out" if dropped else "", *odd)
    began = None if origins is None else turn(origins, metres, axis)
    return PointCloud(points, ground, began, colours, dropped, metres, axis, tuple(filter(None, told)))


def _odd(file: Path, points: FloatArray, *, unit: bool, axis: bool) -> list[str]:
    """What is odd about what nobody asked for, the unit and the axis: files state both, and wrongly at times."""
    frame = look(points) if unit or axis else None
    if frame is None:
        return []
    words, impossible = odd_unit(frame) if unit else ("", False)
    if impossible:
        words = "; ".join(filter(None, [words, odd_up(frame) if axis else ""]))
        raise CloudError(f"cloud {file}", words, "Say its unit: --scale METRES; 1 if it is in metres.")
    return [words, odd_up(frame) if axis else ""]


def _read_thinned(
    path: Path, ground_label: int | None, sieve: VoxelSieve, scale: float | None, up: str | None
) -> PointCloud:
    files = sorted(f for f in path.iterdir() if f.suffix.lower() in READERS) if path.is_dir() else [path]
    if not files:
        raise CloudError(f"folder {path}", "no tile is in it", f"Tiles are {' '.join(READERS)}.")
    dropped = 0
    for file in files:
        with _reading(file):
            chunks, marks = chunks_of(file) if file.is_file() else None, _ground_marks(file, ground_label)
            for points, labels, colours in [] if chunks is None else chunks:
                named = None if labels is None or marks is None else np.isin(labels, marks).astype(np.int64)
                dropped += int((~np.isfinite(points).all(axis=1)).sum())
                sieve.add(turn(points, scale or 1.0, up or "z"), named, colours)
        if chunks is None:
            whole = read_cloud(file, ground_label=ground_label, scale=scale, up=up)
            dropped += whole.dropped
            sieve.add(whole.points, None if whole.ground is None else whole.ground.astype(np.int64), whole.colours)
    points, marked, colours = sieve.result()
    ground = None if marked is None or not marked.any() else marked.astype(bool)
    if ground_label is not None and ground is None:
        raise CloudError(f"cloud {path}", f"no point is labelled {ground_label!r}", "Name the right label.")
    odd = _odd(path, points, unit=scale is None, axis=up is None)
    told = (f"{dropped} points were not finite and left out" if dropped else "", *odd)
    remarks = tuple(filter(None, told))
    return PointCloud(check_points(points), ground, None, colours, dropped, scale or 1.0, up or "z", remarks)


def _ground_marks(path: Path, ground_label: int | None) -> list[int] | None:
    """The labels that mean ground in a file; None where it has none."""
    if ground_label is not None or path.suffix.lower() in (".las", ".laz"):
        return [LAS_GROUND if ground_label is None else ground_label]
    if path.suffix.lower() != ".npz":
        return None
    with np.load(path, allow_pickle=False) as stored:
        return list(ground_classes(stored)) or None


def check_labels(ground: ArrayLike, count: int) -> BoolArray:
    """The ground labels of `count` points as booleans, shape (count,).

    Raises:
        CloudError: another type or shape.
    """
    try:
        labels = np.asarray(ground)
    except ValueError as error:
        raise CloudError("ground labels", f"no array ({error})", f"Pass booleans of shape ({count},).") from error
    if labels.dtype != np.bool_ or labels.shape != (count,):
        found = f"an array of {labels.dtype} of shape {labels.shape}"
        raise CloudError("ground labels", found, f"Pass booleans of shape ({count},), one for each point.")
    return labels
