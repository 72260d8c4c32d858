"""What is printed of twelve kinds of clouds, each clean and in five ways not as it should be.

`python docs/tools/formats.py` writes the table to the standard output. The clouds are those of the tests: an office
of 16,000 points, and a room with a table in it as a mesh.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gpdf_service.cli import main as gpdf
from gpdf_service.types import FloatArray

sys.path.insert(0, str(Path(__file__).parent.parent.parent / "tests" / "clouds"))
from test_formats import CENTIMETRES, HOLDS_NAN, OFFICE, WITH_NAN, WRITERS, Y_UP, boxes, write_text

KINDS = (".ply", ".pcd", ".xyz", ".csv", ".npy", ".npz", ".las", ".e57", ".obj", ".stl", ".dae", ".glb")
TEXT = (".xyz", ".csv")
WAYS = ("clean", "NaN", "centimetres", "other axis", "commas", "empty")
TURNED = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
"""z up becomes y up."""


def write_cloud(path: Path, way: str) -> bool:
    """Write a cloud of the file's kind; False if the kind cannot hold it."""
    points: dict[str, FloatArray] = {"clean": OFFICE, "NaN": WITH_NAN, "centimetres": CENTIMETRES, "other axis": Y_UP}
    if way == "commas":
        write_text(path, OFFICE, ",")
        return path.suffix in TEXT
    if way == "NaN" and path.suffix not in HOLDS_NAN:
        return False
    WRITERS[path.suffix](path, points[way])
    return True


def write_mesh(path: Path, way: str) -> bool:
    """The same of a mesh, twice as wide; glTF has y up by its standard, COLLADA where the file says no other."""
    if way in ("NaN", "commas"):
        return False
    room = boxes(scale=100.0 if way == "centimetres" else 1.0)
    room.apply_transform(np.diag([2.0, 2.0, 1.0, 1.0]))
    if (way == "other axis") != (path.suffix in (".dae", ".glb")):
        room.apply_transform(TURNED)
    room.export(path)
    return True


def told(path: Path) -> str:
    """How `gpdf scene info` took a cloud, or why it did not."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = gpdf(["scene", "info", str(path)])
    if code:
        return err.getvalue().strip().replace(f"{path}", path.name).removeprefix("gpdf: ")
    return out.getvalue().splitlines()[0].removeprefix("cloud").strip()


def cell(folder: Path, kind: str, way: str) -> str:
    """What is printed, or a dash."""
    path = folder / f"{way.replace(' ', '_')}{kind}"
    if way == "empty":
        path.write_bytes(b"")
        return told(path)
    write: Callable[[Path, str], bool] = write_cloud if kind in WRITERS else write_mesh
    return told(path) if write(path, way) else "–"


def main() -> None:
    """Print the table, a row a kind and way."""
    print("| file | way | what is printed |\n|---|---|---|", flush=True)
    with TemporaryDirectory() as name:
        for kind in KINDS:
            for way in WAYS:
                print(f"| `{kind}` | {way} | {cell(Path(name), kind, way)} |", flush=True)


if __name__ == "__main__":
    main()
