"""What a cloud's file holds, by its suffix: text, NumPy arrays, LAS, E57, what Open3D reads, and meshes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpdf_service.clouds.ply import check_whole
from gpdf_service.errors import CloudError
from gpdf_service.types import BoolArray, FloatArray

LAS_GROUND = 2
"""ASPRS LAS specification 1.4, table 17: class 2 is ground."""
GROUND_CLASSES = ("ground", "floor", "terrain")
"""Names that mean ground in an .npz file's `classes`."""
SYSTEM_LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libgomp.so.1": "libgomp1",
    "libusb-1.0.so.0": "libusb-1.0-0",
}
"""What Open3D's shared library links against, and the Debian and Ubuntu package of each."""
APT = f"sudo apt-get install {' '.join(SYSTEM_LIBRARIES.values())}"
MESH_SPACING = 0.015
"""[m] Between points sampled on a mesh, on average: then hardly a cell of 5 cm of a surface has none."""
MOST_SAMPLES = 5_000_000
"""Points of a mesh; those of a larger one lie further apart."""
NPZ_COLOURS = ("rgb", "colors", "colours", "color", "colour")
"""Names that mean colours in an .npz file."""
RED_GREEN_BLUE = ("red", "green", "blue"), ("r", "g", "b")
"""What the columns of a colour are called."""
UNNAMED_COLOURS = {6: (3, 4, 5), 7: (4, 5, 6)}
"""Of a text file's columns without names, by their number: x y z r g b, and with an intensity before the colour."""
Colours = NDArray[np.uint8]
"""Red, green and blue, shape (n, 3)."""
_HEADER_LINES = 200
"""Of a text file, that are looked at for the first line of numbers."""


@dataclass(frozen=True, slots=True)
class Stored:
    """What a file holds, in its own frame.

    Attributes:
        points: Shape (n, 3), rows that are not finite among them.
        ground: Which are ground, (n,), where the file says so.
        origins: Where the rays began, (n, 3), where the file says so.
        colours: Red, green and blue as the file has them (n, 3): of 8 or 16 bits, or shares of 1; None without.
        up: The axis that points up, where the kind of file or the file says so.
        scale: Metres of its unit, where the kind of file or the file says so.
        remark: What was done to it, in words.
    """

    points: FloatArray
    ground: BoolArray | None = None
    origins: FloatArray | None = None
    colours: NDArray[Any] | None = None
    up: str | None = None
    scale: float | None = None
    remark: str = ""


def greatest(values: NDArray[Any]) -> float:
    """Of colours (n, 3); 0 where they are no numbers, or all 0: nobody filled them in."""
    return float(np.fmax.reduce(values, axis=None, initial=0.0)) if values.dtype.kind in "uif" else 0.0


def as_bytes(values: NDArray[Any], most: float) -> Colours | None:
    """Colours (n, 3) of 8 bits, of the 16 bits or the shares of 1 that some files hold; None where there are none.

    Args:
        values: As the file has them, or a part of it.
        most: The greatest of the whole file: a dark part alone looks like one of fewer bits.
    """
    if most <= 0.0:
        return None
    scale = 255.0 if values.dtype.kind == "f" and most <= 1.0 else 1.0 if most <= 255.0 else 255.0 / 65535.0
    made: Colours = np.clip(np.nan_to_num(np.rint(scale * values)), 0.0, 255.0).astype(np.uint8)
    return made


def record_colours(records: NDArray[np.void]) -> NDArray[Any] | None:
    """Of records with a field a channel, or all three in the bytes of `rgb`, as .pcd files have them; else None."""
    names = records.dtype.names or ()
    named = next((three for three in RED_GREEN_BLUE if set(three) <= set(names)), None)
    if named is not None:
        return np.column_stack([records[name].ravel() for name in named])
    packed = next((records[name].ravel() for name in ("rgb", "rgba") if name in names), None)
    if packed is None or packed.dtype.itemsize != 4:
        return None
    return np.ascontiguousarray(packed).view(np.uint8).reshape(-1, 4)[:, 2::-1].copy()


def _unnamed_colours(table: FloatArray) -> FloatArray | None:
    """The three columns (n, 3) after x, y and z, if they are whole numbers of 8 bits: no normal is."""
    fits = table.size and np.all((table >= 0.0) & (table <= 255.0) & (table == np.rint(table))) and table.max() > 1.0
    return table if fits else None


def read_text(path: Path, ground_label: int | None, scale: float | None = None) -> Stored:
    """Numbers in lines: x, y, z in the columns of these names, or the first three; spaces, commas or semicolons."""
    _no_labels(path, ground_label)
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        head = [line for _, line in zip(range(_HEADER_LINES), file, strict=False)]
    split = next((re.compile(mark) for mark in (";", ",", r"\s+") if _numbers(head, re.compile(mark))), None)
    if split is None:
        raise CloudError(f"cloud {path}", "no line of three numbers is in it", "Write x, y and z, a point a line.")
    first = next(i for i, line in enumerate(head) if _is_row(line, split))
    columns = _named_columns(head[:first], split, "xyz") or (0, 1, 2)
    named = next(filter(None, (_named_columns(head[:first], split, names) for names in RED_GREEN_BLUE)), ())
    shades = named or UNNAMED_COLOURS.get(len(split.split(head[first].strip())), ())
    delimiter = None if split.pattern == r"\s+" else split.pattern
    options: dict[str, Any] = {"delimiter": delimiter, "skiprows": first, "ndmin": 2}
    options |= {"comments": ("#", "//"), "encoding": "utf-8-sig"}
    try:
        table = np.loadtxt(path, usecols=(*columns, *shades), **options)
    except ValueError:  # a value that is missing, or a decimal comma: slower
        table = np.loadtxt(path, usecols=columns, converters=_number, **options)
    points, rest = table[:, :3].astype(np.float64, order="C"), table[:, 3:]
    return Stored(points, colours=rest if named and rest.size else _unnamed_colours(rest))


def _number(text: str) -> float:
    return float(text.strip().replace(",", ".") or "nan")


def _is_row(line: str, split: re.Pattern[str]) -> bool:
    parts = split.split(line.strip())
    if len(parts) < 3 or parts[0].lstrip().startswith(("#", "//")):
        return False
    try:
        [_number(part) for part in parts[:3]]
    except ValueError:
        return False
    return any(part.strip() for part in parts)


def _numbers(lines: list[str], split: re.Pattern[str]) -> bool:
    return any(_is_row(line, split) for line in lines)


def _named_columns(header: list[str], split: re.Pattern[str], wanted: Sequence[str]) -> tuple[int, ...]:
    """Which columns have these names; none where one is missing."""
    for line in reversed(header):
        names = [name.strip(" \t\r\n\"'#/").lower() for name in split.split(line.strip().lstrip("#/ "))]
        if set(wanted) <= set(names):
            return tuple(names.index(name) for name in wanted)
    return ()


def read_npy(path: Path, ground_label: int | None, scale: float | None = None) -> Stored:
    """An array (…, 3 or more) or one with the fields x, y and z."""
    _no_labels(path, ground_label)
    array = np.load(path, allow_pickle=False)
    if array.dtype.names is not None:
        if not {"x", "y", "z"} <= set(array.dtype.names):
            found = f"it has no field x, y and z (it has {', '.join(array.dtype.names)})"
            raise CloudError(f"cloud {path}", found, "Name them so.")
        points = np.column_stack([array[axis].ravel() for axis in "xyz"]).astype(np.float64)
        return Stored(points, colours=record_colours(array))
    if array.ndim < 2 or array.shape[-1] < 3:
        raise CloudError(f"cloud {path}", f"an array of shape {array.shape}", "Store x, y, z a point: (n, 3).")
    table = array.reshape(-1, array.shape[-1])
    colours = _unnamed_colours(table[:, 3:6]) if table.shape[1] == 6 else None
    return Stored(table[:, :3].astype(np.float64), colours=colours)


def read_npz(path: Path, ground_label: int | None, scale: float | None = None) -> Stored:
    """`xyz` or `points`, `label` with `classes`, `origins`, (3,) or (n, 3), and `rgb`."""
    with np.load(path, allow_pickle=False) as stored:
        key = next((name for name in ("xyz", "points") if name in stored.files), None)
        if key is None:
            found = f"it has no column xyz (it has {', '.join(stored.files)})"
            raise CloudError(f"cloud {path}", found, "Store the points as 'xyz', shape (n, 3).")
        points = stored[key].astype(np.float64)
        label = stored["label"] if "label" in stored.files else None
        named = ground_classes(stored)
        origins = (
            np.broadcast_to(stored["origins"].astype(np.float64), points.shape) if "origins" in stored.files else None
        )
        shades = next((stored[name] for name in NPZ_COLOURS if name in stored.files), None)
    colours = shades if shades is not None and shades.shape == points.shape else None
    if ground_label is not None:
        if label is None:
            raise CloudError(f"cloud {path}", "it has no column label", "Leave --ground-label out.")
        return Stored(points, _labelled(label == ground_label, points, path, ground_label), origins, colours)
    if label is None or not named:
        return Stored(points, None, origins, colours)
    ground = _labelled(np.isin(label, list(named)), points, path, next(iter(named.values())))
    return Stored(points, ground, origins, colours)


def ground_classes(stored: Mapping[str, NDArray[Any]]) -> dict[int, str]:
    """The labels of an .npz file whose classes are called ground, and how."""
    classes = [str(name).lower() for name in stored["classes"]] if "classes" in stored else []
    return {i: name for i, name in enumerate(classes) if name in GROUND_CLASSES}


def _labelled(ground: BoolArray, points: FloatArray, path: Path, label: object) -> BoolArray:
    if ground.shape != (len(points),):
        raise CloudError(f"cloud {path}", f"labels of shape {ground.shape}", f"One label a point: ({len(points)},).")
    if not ground.any():
        raise CloudError(f"cloud {path}", f"no point is labelled {label!r}", "Name the right label: --ground-label N.")
    return ground


def read_open3d(path: Path, ground_label: int | None, scale: float | None = None) -> Stored:
    """The vertices of a .ply, the points of a .pcd."""
    open3d = import_open3d()
    _no_labels(path, ground_label)
    if path.suffix.lower() == ".ply":
        check_whole(path)
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        cloud = open3d.io.read_point_cloud(path, remove_nan_points=False, remove_infinite_points=False)
    points = np.asarray(cloud.points, dtype=np.float64)
    if len(points) == 0:
        raise CloudError(f"cloud {path}", "no point could be read from it", "Is it empty or damaged?")
    return Stored(points, colours=np.asarray(cloud.colors) if cloud.has_colors() else None)


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


def read_las(path: Path, ground_label: int | None, scale: float | None = None) -> Stored:
    """LAS and LAZ; class 2 is ground."""
    import laspy

    stored = laspy.read(path)
    points, colours = las_points(stored.points), las_colours(stored.points)
    ground = np.asarray(stored.classification) == (LAS_GROUND if ground_label is None else ground_label)
    if ground_label is None and not ground.any():
        return Stored(points, colours=colours)
    return Stored(points, _labelled(ground, points, path, ground_label or LAS_GROUND), colours=colours)


def las_colours(record: Any) -> NDArray[np.uint16] | None:  # noqa: ANN401 - of laspy
    """Colours of a LAS file's records, (n, 3); None where its format has none."""
    if not set(RED_GREEN_BLUE[0]) <= set(record.point_format.dimension_names):
        return None
    return np.column_stack([np.asarray(record[name]) for name in RED_GREEN_BLUE[0]])


def las_points(record: Any) -> FloatArray:  # noqa: ANN401 - of laspy
    """Places (n, 3) of a LAS file's records: the decimals that are meant, and not a product's last bits."""
    own = zip("XYZ", record.scales, record.offsets, strict=True)
    return np.column_stack([_decimals(np.asarray(record[axis]), scale, offset) for axis, scale, offset in own])


def _decimals(whole: NDArray[np.int32], scale: float, offset: float) -> FloatArray:
    with np.errstate(all="ignore"):  # a scale of 0 is a wrong file's
        per = np.rint(1.0 / np.float64(scale))
        first = np.rint(offset * per)
        meant = 1.0 / per == scale and first / per == offset
    return np.asarray((whole + first) / per if meant else whole * scale + offset)


def read_e57(path: Path, ground_label: int | None, scale: float | None = None) -> Stored:
    """All scans of an E57 file, in the file's frame; each scan's pose is where its rays began. Metres, z up."""
    import pye57

    _no_labels(path, ground_label)
    with path.open("rb") as head:  # ASTM E2807, table 1: the library itself does not survive every file
        magic, length = head.read(8), int.from_bytes(head.read(16)[8:], "little")
    if magic != b"ASTM-E57" or length != path.stat().st_size:
        raise CloudError(f"cloud {path}", "it is no E57 file, or not all of one", "Is the file complete?")
    try:
        file = pye57.E57(str(path))
        points, origins, shades = [], [], []
        for i in range(file.scan_count):
            scan = file.read_scan(i, colors=True, ignore_missing_fields=True)
            points.append(np.column_stack([scan[f"cartesian{axis}"] for axis in "XYZ"]).astype(np.float64))
            if "colorRed" in scan:
                shades.append(np.column_stack([scan[f"color{name}"] for name in ("Red", "Green", "Blue")]))
            header = file.get_header(i)
            place = np.asarray(header.translation, dtype=np.float64) if header.has_pose() else np.full(3, np.nan)
            origins.append(np.broadcast_to(place, points[-1].shape))
    except (pye57.libe57.E57Exception, IndexError) as error:
        raise CloudError(f"cloud {path}", f"it cannot be read ({error})", "Is the file complete?") from error
    made = np.concatenate([np.zeros((0, 3)), *points])
    began = np.concatenate([np.zeros((0, 3)), *origins])
    remark = f"{len(points)} scan(s)"
    colours = np.concatenate(shades) if shades and len(shades) == len(points) else None
    known = began if np.isfinite(began).all() else None
    return Stored(made, origins=known, colours=colours, up="z", scale=1.0, remark=remark)


def read_mesh(path: Path, ground_label: int | None, scale: float | None = None) -> Stored:
    """Points on the faces of a mesh, as far apart as a scanner's; glTF has y up, COLLADA says its unit and axis."""
    import trimesh

    _no_labels(path, ground_label)
    try:
        mesh = trimesh.load_scene(path).to_mesh()
    except ImportError:
        raise
    except Exception as error:  # its loaders raise whatever damaged bytes come to
        raise CloudError(f"mesh {path}", f"it cannot be read ({error!r})", "Is the file complete?") from error
    area = float(mesh.area) if len(mesh.faces) else 0.0
    if not 0.0 < area < np.inf:
        raise CloudError(f"mesh {path}", "it has no faces", "Is it empty? Of points alone make a .ply.")
    up, unit = _frame_of_mesh(path)
    metres = (unit or 1.0) if scale is None else scale
    count = int(min(MOST_SAMPLES, max(1.0, area * (metres / MESH_SPACING) ** 2)))
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=0)[:2]
    painted = mesh.visual.kind in ("face", "vertex")  # not a texture
    colours = np.asarray(mesh.visual.face_colors[faces, :3], np.uint8) if painted else None
    remark = f"{len(points)} points on {len(mesh.faces)} faces"
    return Stored(np.asarray(points, dtype=np.float64), colours=colours, up=up, scale=unit, remark=remark)


def _frame_of_mesh(path: Path) -> tuple[str | None, float | None]:
    """Up axis and unit [m] that a mesh states."""
    if path.suffix.lower() in (".glb", ".gltf"):
        return "y", 1.0  # glTF 2.0 specification, section 3.4
    if path.suffix.lower() != ".dae":
        return None, None
    text = path.read_text(errors="replace")[:100_000]
    axis = re.search(r"<up_axis>\s*([XYZ])_UP", text)
    unit = re.search(r"<unit\b[^>]*\bmeter\s*=\s*[\"']([0-9.eE+-]+)", text)
    return (axis[1].lower() if axis else "y"), (float(unit[1]) if unit else 1.0)  # COLLADA 1.4.1: Y_UP and metres


def _no_labels(path: Path, ground_label: int | None) -> None:
    if ground_label is not None:
        found = "files of this kind carry no labels"
        raise CloudError(f"cloud {path}", found, "Leave --ground-label out, or use .npz.")


READERS: dict[str, Callable[[Path, int | None, float | None], Stored]] = {
    **dict.fromkeys((".ply", ".pcd"), read_open3d),
    **dict.fromkeys((".xyz", ".txt", ".csv", ".asc", ".pts"), read_text),
    ".npy": read_npy,
    ".npz": read_npz,
    **dict.fromkeys((".las", ".laz"), read_las),
    ".e57": read_e57,
    **dict.fromkeys((".obj", ".stl", ".off", ".dae", ".glb", ".gltf"), read_mesh),
}
"""Who reads a file: by its suffix; given the path, the label that means ground, and metres of the file's unit."""
