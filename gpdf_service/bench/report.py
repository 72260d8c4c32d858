"""Rows of measurements, printed as a table or as JSON."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from tqdm import tqdm

from gpdf_service.clouds import read_cloud
from gpdf_service.synthetic import SCENES
from gpdf_service.types import BoolArray, FloatArray

Row = dict[str, Any]
T = TypeVar("T")


def each(items: Iterable[T], what: str, total: int | None = None) -> Iterator[T]:
    """The items one by one, with a bar on a terminal: how many are done, and about how much time is left.

    Args:
        items: What is gone through.
        what: What the bar calls it.
        total: How many they are, if they do not tell themselves.
    """
    yield from tqdm(items, desc=what, total=total, disable=None, leave=False)


def show(rows: list[Row], *, as_json: bool) -> None:
    """Print the rows."""
    if as_json:
        print(json.dumps(rows))  # noqa: T201
        return
    names = list(dict.fromkeys(name for row in rows for name in row))
    cells = [names, *([_text(row.get(name, "")) for name in names] for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(names))]
    for line in cells:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))  # noqa: T201


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def add_scene_arguments(parser: argparse.ArgumentParser, default: list[str]) -> None:
    """Which scenes: names of synthetic ones, or clouds."""
    parser.add_argument(
        "--scene", action="append", help=f"{', '.join(SCENES)}, or a cloud; {', '.join(default)} when not given"
    )
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    parser.set_defaults(default_scenes=default)


class Subject(NamedTuple):
    """A cloud that is measured with.

    Attributes:
        name: Its own.
        points: The cloud [m], shape (n, 3).
        ground: Its labels, shape (n,), if there are some.
        origins: Where its rays began [m], shape (n, 3), if it tells.
    """

    name: str
    points: FloatArray
    ground: BoolArray | None = None
    origins: FloatArray | None = None


def clouds(args: argparse.Namespace) -> list[Subject]:
    """The scenes that were asked for."""
    return [read_scene(name) for name in args.scene or args.default_scenes]


def read_scene(name: str) -> Subject:
    """A synthetic scene by its name, or a cloud by its path."""
    if name in SCENES:
        scene = SCENES[name](np.random.default_rng(0))
        return Subject(name, scene.points, scene.ground)
    cloud = read_cloud(Path(name))
    return Subject(Path(name).stem, cloud.points, cloud.ground, cloud.origins)
