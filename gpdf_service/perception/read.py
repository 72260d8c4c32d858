"""Reading point clouds: .ply .pcd .xyz (Open3D), .npz (NumPy), .las .laz (laspy), with labels if any; ROS bags."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gpdf_service.errors import CloudError
from gpdf_service.perception.bag import read_bag
from gpdf_service.perception.rows import extent_of
from gpdf_service.perception.stream import VoxelSieve, chunks_of
from gpdf_service.types import BoolArray, FloatArray

LAS_GROUND = 2
"""ASPRS LAS specification 1.4, table 17: class 2 is ground."""
GROUND_CLASSES = ("ground", "floor", "terrain")
"""Names that mean ground in an .npz file's `classes`."""
BAGS = (".mcap", ".db3", ".bag")
"""Suffixes of ROS bags."""
SYSTEM_LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libgomp.so.1": "libgomp1",
    "libusb-1.0.so.0": "libusb-1.0-0",
}
"""What Open3D's shared library links against, and the Debian and Ubuntu package of each."""
APT = f"sudo apt-get install {' '.join(SYSTEM_LIBRARIES.values())}"
COARSEST = 0.01
"""[m] Between two numbers of single precision as large as a coordinate; more, and walls are where no wall is."""
MAX_EXTENT = 5000.0
"""[m] No place that one plans in on foot is wider; a room in millimetres is."""


@dataclass(frozen=True, slots=True)
class PointCloud:
    """A cloud as read: points [m], shape (n, 3), and which are ground, shape (n,), where the file says so."""

    points: FloatArray
    ground: BoolArray | None = None


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
) -> PointCloud:
    """Read a cloud by its suffix; a folder is a rosbag2, or holds the tiles of one cloud.

    Args:
        path: The file.
        ground_label: The label that means ground (.npz `label`, LAS class); by name or standard if not given.
        topic: Where a bag has clouds on several topics, the one to take.
        thin: Keep one point of each voxel of this width [m], and read in chunks: only what is kept is ever in memory
            (but for text and compressed .pcd files, which are read at once). A folder of tiles needs it.

    Raises:
        CloudError: the file is missing, of an unknown kind, damaged, empty, or lacks a column.
    """
    file = Path(path)
    if file.suffix.lower() in BAGS or (file / "metadata.yaml").is_file():
        if ground_label is not None:
            raise CloudError(f"bag {file}", "bags carry no labels", "Leave --ground-label out, or use .npz.")
        if not file.exists():
            raise CloudError(f"bag {file}", "there is no such file", "Check the path.")
        return PointCloud(check_points(read_bag(file, topic)))
    if thin is not None:
        return _read_thinned(file, ground_label, thin)
    if file.is_dir():
        raise CloudError(
            f"folder {file}", "it is no rosbag2", "Of a cloud in tiles say how far to thin it: --thin 0.03."
        )
    reader = _READERS.get(file.suffix.lower())
    if reader is None:
        raise CloudError(
            f"cloud {file}", f"files of kind {file.suffix!r} are not known", f"Use {' '.join([*_READERS, *BAGS])}."
        )
    if not file.is_file():
        raise CloudError(f"cloud {file}", "there is no such file", "Check the path.")
    try:
        points, ground = reader(file, ground_label)
    except (OSError, ValueError, RuntimeError, EOFError, KeyError) as error:
        raise CloudError(f"cloud {file}", f"it cannot be read ({error})", "Is the file complete?") from error
    return PointCloud(check_points(points), ground)


Read = tuple[FloatArray, BoolArray | None]
"""What `PointCloud` holds."""


def _read_thinned(path: Path, ground_label: int | None, width: float) -> PointCloud:
    files = sorted(f for f in path.iterdir() if f.suffix.lower() in _READERS) if path.is_dir() else [path]
    if not files:
        raise CloudError(f"folder {path}", "no tile is in it", f"Tiles are {' '.join(_READERS)}.")
    sieve = VoxelSieve(width)
    for file in files:
        try:
            chunks, marks = chunks_of(file) if file.is_file() else None, _ground_marks(file, ground_label)
            for points, labels in [] if chunks is None else chunks:
                sieve.add(points, None if labels is None or marks is None else np.isin(labels, marks).astype(np.int64))
        except (OSError, ValueError, RuntimeError, EOFError, KeyError, zipfile.BadZipFile) as error:
            raise CloudError(f"cloud {file}", f"it cannot be read ({error})", "Is the file complete?") from error
        if chunks is None:
            whole = read_cloud(file, ground_label=ground_label)
            sieve.add(whole.points, None if whole.ground is None else whole.ground.astype(np.int64))
    points, marked = sieve.result()
    ground = None if marked is None or not marked.any() else marked.astype(bool)
    if ground_label is not None and ground is None:
        raise CloudError(f"cloud {path}", f"no point is labelled {ground_label!r}", "Name the right label.")
    return PointCloud(check_points(points), ground)


def _ground_marks(path: Path, ground_label: int | None) -> list[int] | None:
    """The labels that mean ground in a file; None where it has none."""
    if ground_label is not None or path.suffix.lower() in (".las", ".laz"):
        return [LAS_GROUND if ground_label is None else ground_label]
    if path.suffix.lower() != ".npz":
        return None
    with np.load(path, allow_pickle=False) as stored:
        return list(_ground_classes(stored)) or None


def _ground_classes(stored: Mapping[str, NDArray[Any]]) -> dict[int, str]:
    """The labels of an .npz file whose classes are called ground, and how."""
    classes = [str(name).lower() for name in stored["classes"]] if "classes" in stored else []
    return {i: name for i, name in enumerate(classes) if name in GROUND_CLASSES}


def _read_npz(path: Path, ground_label: int | None) -> Read:
    with np.load(path, allow_pickle=False) as stored:
        key = next((name for name in ("xyz", "points") if name in stored.files), None)
        if key is None:
            found = f"it has no column xyz (it has {', '.join(stored.files)})"
            raise CloudError(f"cloud {path}", found, "Store the points as 'xyz', shape (n, 3).")
        points = stored[key].astype(np.float64)
        label = stored["label"] if "label" in stored.files else None
        named = _ground_classes(stored)
    if ground_label is not None:
        if label is None:
            raise CloudError(f"cloud {path}", "it has no column label", "Leave --ground-label out.")
        return points, _labelled(label == ground_label, points, path, ground_label)
    if label is None or not named:
        return points, None
    return points, _labelled(np.isin(label, list(named)), points, path, next(iter(named.values())))


def _labelled(ground: BoolArray, points: FloatArray, path: Path, label: object) -> BoolArray:
    if ground.shape != (len(points),):
        raise CloudError(f"cloud {path}", f"labels of shape {ground.shape}", f"One label a point: ({len(points)},).")
    if not ground.any():
        raise CloudError(f"cloud {path}", f"no point is labelled {label!r}", "Name the right label: --ground-label N.")
    return ground


def _read_open3d(path: Path, ground_label: int | None) -> Read:
    open3d = import_open3d()
    if ground_label is not None:
        raise CloudError(
            f"cloud {path}", "files of this kind carry no labels", "Leave --ground-label out, or use .npz."
        )
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        cloud = open3d.io.read_point_cloud(path, remove_nan_points=False, remove_infinite_points=False)
    points = np.asarray(cloud.points, dtype=np.float64)
    if len(points) == 0:
        raise CloudError(f"cloud {path}", "no point could be read from it", "Is it empty or damaged?")
    return points, None


def import_open3d() -> Any:  # noqa: ANN401 - a module without types
    """Open3D, which takes 1.2 s to import: only where it is needed.

    Raises:
        CloudError: a system library that it links against is not installed.
    """
    try:
        import open3d
    except (OSError, ImportError) as error:
        missing = [package for library, package in SYSTEM_LIBRARIES.items() if library in str(error)]
        if not missing:
            raise
        found = f"it cannot start here ({error})"
        raise CloudError("Open3D, which reads this kind of file", found, f"Install {missing[0]}: {APT}") from error
    return open3d


def _read_las(path: Path, ground_label: int | None) -> Read:
    import laspy

    try:
        stored = laspy.read(path)
    except laspy.errors.LaspyException as error:
        raise CloudError(f"cloud {path}", f"it cannot be read ({error})", "Is the file complete?") from error
    points = np.asarray(stored.xyz, dtype=np.float64)
    ground = np.asarray(stored.classification) == (LAS_GROUND if ground_label is None else ground_label)
    if ground_label is None and not ground.any():
        return points, None
    return points, _labelled(ground, points, path, ground_label or LAS_GROUND)


_READERS: dict[str, Callable[[Path, int | None], Read]] = {
    ".ply": _read_open3d,
    ".pcd": _read_open3d,
    ".xyz": _read_open3d,
    ".npz": _read_npz,
    ".las": _read_las,
    ".laz": _read_las,
}


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
