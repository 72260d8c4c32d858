"""Whether an answer depends on where cells lie: the same random pairs in a cloud that is turned and shifted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gpdf_service.bench.houses import free_places
from gpdf_service.bench.report import Row, each
from gpdf_service.clouds import read_cloud
from gpdf_service.pipeline import build_scene, plan
from gpdf_service.scene import Scene
from gpdf_service.synthetic.solids import turn_and_shift
from gpdf_service.types import AGENTS, FloatArray, Status

PLACES = 8
"""Of the cells under a cloud: as it comes, then shifted alone, and turned and shifted, by turns."""
NEAR = 0.3
"""[m] Ends are moved by this at most: a place at a rim may be free at some angles alone."""
BODIES = ("human", "roomba", "spot")


def placed_rows(
    paths: Sequence[Path], count: int, seed: int, places: int = PLACES, bodies: Sequence[str] = BODIES
) -> Iterator[Row]:
    """For each cloud and body: how many random pairs are answered wherever the cells lie, and how many somewhere alone.

    Args:
        paths: The clouds.
        count: Pairs of places that are free where the cloud lies as it comes.
        seed: Of the turns and shifts, and of the pairs.
        places: Places of the cells.
        bodies: Names of bodies.
    """
    for path in each(paths, "clouds"):
        points, rng = read_cloud(path).points, np.random.default_rng(seed)
        middle = points.mean(axis=0) * [1.0, 1.0, 0.0]
        ends: dict[str, FloatArray] = {}
        said: dict[str, list[list[Status]]] = {name: [] for name in bodies}
        for place in range(places):
            angle, shift = rng.uniform(0.0, 2.0 * np.pi), np.append(rng.random(2), 0.0)
            T = turn_and_shift(angle if place and place % 2 == 0 else 0.0, shift if place else np.zeros(3))
            scene = build_scene(_moved(points, middle, T))
            for name in bodies:
                if place == 0:
                    found = free_places(scene, AGENTS[name], 2 * count, np.random.default_rng(seed))
                    ends[name] = found[: len(found) // 2 * 2]
                said[name].append(_answers(scene, _moved(ends[name], middle, T), name))
        for name in bodies:
            yield {"row": "placed", "cloud": path.stem, "agent": name, "places": places} | _counted(
                np.array(said[name])
            )


def _moved(points: FloatArray, middle: FloatArray, T: FloatArray) -> FloatArray:
    """Points (n, 3) turned about the middle (3,), and shifted [m]."""
    made: FloatArray = (points - middle) @ T[:3, :3].T + middle + T[:3, 3]
    return made


def _answers(scene: Scene, ends: FloatArray, body: str) -> list[Status]:
    return [plan(scene, start, goal, body, snap=NEAR).status for start, goal in ends.reshape(-1, 2, 3)]


def _counted(said: NDArray[np.str_]) -> Row:
    """Of the answers, shape (places, pairs): pairs that are OK everywhere, or somewhere alone, and UNCERTIFIED ones."""
    ok = said == Status.OK
    return {
        "pairs": ok.shape[1],
        "everywhere": int(ok.all(axis=0).sum()),
        "somewhere": int((ok.any(axis=0) & ~ok.all(axis=0)).sum()),
        "uncertified": int((said == Status.UNCERTIFIED).sum()),
    }
