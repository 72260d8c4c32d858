"""Every rule of perception, switched off by itself: which numbers it moves. One that moves none has no place there."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Unpack
from unittest import mock

import numpy as np

from gpdf_service.bench import hard_clouds, houses, places
from gpdf_service.bench.placed import placed_rows
from gpdf_service.bench.report import Row, each
from gpdf_service.bench.scanned import judge, overlap, scanned
from gpdf_service.clouds import read_cloud
from gpdf_service.config import PerceptionConfig
from gpdf_service.denoise import as_measured
from gpdf_service.denoise.place import Placed
from gpdf_service.errors import GpdfError
from gpdf_service.perception.visibility import LOW
from gpdf_service.pipeline import build_scene
from gpdf_service.synthetic import SCENES, random_room
from gpdf_service.synthetic.places import ONE_FLOOR, bedroom, museum, platform, supermarket, workshop
from gpdf_service.tiles.beside import Strips
from gpdf_service.tiles.surface import UNKNOWN
from gpdf_service.types import BoolArray, FloatArray, IntArray

NOISES = (0.0, 0.02, 0.05)
"""[m] Of the scanned rooms' coordinates."""
ROOMS = "cluttered_office", "stair"
"""Beside the random ones."""
HALL, HALL_TURNS = (0.02, 0.04, 0.06), 3
"""[m] Voxels of the museum's stair, and angles that it is turned by: at one width two rules seem to move nothing."""
PAIRS = 20
"""Of Spot on the spiral ramps, and of a human in a quarry."""
DEPTH_NOISE = 0.005
"""[m] Of a depth camera at 1 m: stereo has more than structured light."""
REFLECTED = 1e-4
"""[-] Of a scan's points: glass, water and dust send back single ones from anywhere."""
STARTS = 30
"""In each crowded place."""
WIDE = 0.08
"""[m] Voxels of which one point is kept: a tread is three of them deep."""
CENTRED = 0.05
"""[m] Voxels of occupancy maps, of which the centres are kept."""


def _false(of: int) -> Callable[..., BoolArray]:
    """A rule that finds nothing: false for each row of its argument number `of`."""
    return lambda *given, **_: np.zeros(len(given[of]), dtype=bool)


def _none(_: Any, nodes: Strips, *__: Any) -> Strips:  # noqa: ANN401
    """A rule that finds no node."""
    return tuple(np.zeros(len(each), dtype=bool) for each in nodes)


def _first(given: Any, *_: Any, **__: Any) -> Any:  # noqa: ANN401 - whatever the rule is given
    return given


def _none_placed(_: Any, placed: Placed) -> BoolArray:  # noqa: ANN401
    return np.zeros(len(placed.points), dtype=bool)


def _middles(nodes: IntArray, *given: Any) -> FloatArray:  # noqa: ANN401
    middle: FloatArray = given[1]
    return middle[nodes]


def _no_steps(_: Any, asked: BoolArray, config: PerceptionConfig) -> tuple[FloatArray, BoolArray]:  # noqa: ANN401
    return np.full(asked.shape, LOW * config.min_headroom), np.zeros_like(asked)


_P, _G, _D = (f"gpdf_service.{layer}." for layer in ("perception", "ground", "denoise"))
RULES: dict[str, tuple[str, str, Any]] = {
    "a foot on sparse cells": (_P + "segment", "find_footing", _false(2)),
    "rough treads between stances": (_P + "segment", "find_between", _false(1)),
    "stances": (_P + "segment", "find_stances", lambda _, among: among.copy()),
    "undersides": (_P + "segment", "undersides", lambda _, parts, __: (_none(0, parts.keep), parts, parts.size < 0)),
    "crumbs of noise": (_P + "segment", "without_crumbs", lambda _, parts, __: parts),
    "a tread is level": (_P + "segment", "_level", _false(1)),
    "faces join no treads": (_P + "segment", "HALF_RISER", np.inf),
    "grooves": (_P + "segment", "_grooves", _false(1)),
    "roofs": (_P + "segment", "_roofs", _none),
    "low things": (_P + "segment", "low_things", _none),
    "boxes and lids": (_P + "segment", "boxes", _none),
    "places are no things": (_P + "bumps", "_are_places", lambda *given: np.zeros(len(given[1]), dtype=bool)),
    "dead ends and tables": (_P + "parts", "_dead_ends", _false(2)),
    "fragments are one": (_P + "parts", "_units", lambda parts, *_: np.arange(len(parts.size))),
    "ways between storeys": (_P + "parts", "_between_storeys", lambda _, joins, *__: np.zeros(len(joins[0]), bool)),
    "ground that no way leads to": (_P + "parts", "_apart", lambda _, __, group, *___: np.zeros(group.max() + 1, bool)),
    "ceilings": (_P + "parts", "rises_beside", lambda nodes, *_: np.ones(len(nodes), dtype=bool)),
    "faces of boards": ("gpdf_service.tiles.layers", "tops_of_boards", _middles),
    "seams of sheets": (_P + "sheets", "_seams", lambda *_: []),
    "the foot of a step in its cell": (_P + "sheets", "_under_step", lambda layers, _: layers.cell < 0),
    "undersides that nobody saw": (_P + "others", "unseen_beneath", lambda grid, *_: np.zeros_like(grid.others)),
    "strays": (_P + "levels", "find_strays", _false(0)),
    "sagging treads closed": (_P + "seen", "bridged", _first),
    "steps that hold a foot": (
        _P + "ledges",
        "footholds",
        lambda surface, _: np.where(surface.state == UNKNOWN, -np.inf, surface.height),
    ),
    "a ledge is a step": (_P + "ledges", "step_over", lambda surface, _: np.full(surface.state.shape, -np.inf)),
    "rims over faces": (_P + "ledges", "_add_rims", lambda *_: None),
    "outliers of noise": (_P + "seen", "without_outliers", _first),
    "planes at rims": (_P + "seen", "with_rims", _first),
    "heights at centres": (_P + "seen", "to_centres", _first),
    "treads beside a shadow guard": (_P + "complete", "between_treads", lambda _, asked, __: np.zeros_like(asked)),
    "what fronts hide": (_P + "complete", "without_hidden", _first),
    "filling of holes": (_P + "complete", "fill_holes", _first),
    "single empty cells": (_P + "holes", "_fill_gaps", lambda _, __, height, state, *___: (height, state)),
    "single cells on bends": (_P + "holes", "onto_bends", lambda *_: None),
    "planes over holes": (_P + "holes", "_fill", lambda *_: None),
    "single cells where rays met the floor": (_P + "holes", "_fill_single", lambda _, *ground: ground),
    "cells of a step's face": (_P + "complete", "fill_faces", _first),
    "notches of flights": (_P + "holes", "fill_notches", _first),
    "strips at a flight's side": (_P + "notches", "_fill_bitten", lambda *_: None),
    "treads seen as lines": (_P + "notches", "_as_wide_as_a_sole", lambda known, _: known),
    "walls of pits": (_P + "holes", "walled_down", lambda surface, _: np.zeros(surface.state.shape, dtype=bool)),
    "blind spots": (_P + "visibility", "_blind_spots", lambda _, asked, __: np.zeros_like(asked)),
    "holes that rays fell through": (_P + "visibility", "_of_one_hole", lambda _, asked, *__: np.zeros_like(asked)),
    "shadows and edges of steps": (_P + "visibility", "_steps_beside", _no_steps),
    "slanted faces are steps": (_G + "limits", "_slanted", lambda _, slope: np.full(slope.shape, np.inf)),
    "narrow treads": (_G + "limits", "_is_narrow_tread", lambda height, *_: np.zeros(height.shape, dtype=bool)),
    "ridges of flights": (_P + "levels", "ridges", lambda surface, *_: np.zeros(surface.state.shape, dtype=bool)),
    "faces of steps": (_G + "obstacles", "_is_face", _false(1)),
    "worn treads": (_G + "obstacles", "on_treads", _false(0)),
    "headroom from the foot's tread": (_G + "obstacles", "_over_head", lambda points, *_: np.ones(len(points), bool)),
    "voxels": ("gpdf_service.scene", "voxel_pitch", lambda _: 0.0),
    "floors between rungs": (_P + "segment", "_between_rungs", lambda layers, _: layers.cell < 0),
    "cure of noise": (_P + "noisy", "denoise", lambda points, noise, *_: as_measured(points, noise)),
    "treads under noise": (_P + "noisy", "_settled", lambda _, __, cured: cured.points),
    "outliers of things": (_P + "noisy", "return_explained", lambda *_: None),
    "points that noise lifted": (_P + "noisy", "find_lifted", _false(0)),
    "noise of each place": (_D + "cloud", "_quieter", lambda *_: iter(())),
    "planes that meet": (_D + "cloud", "place_at_edges", lambda *_: None),
    "planes next door": (_D + "cloud", "follow_planes", _none_placed),
    "rims drawn in": (_D + "cloud", "draw_in", _none_placed),
    "points alone": (_D + "cloud", "find_alone", _none_placed),
}
"""Each rule: the module that calls it, its name there, and what stands for it when it is off."""


@contextmanager
def without(rule: str) -> Iterator[None]:
    """Switch a rule off."""
    module, name, off = RULES[rule]
    with mock.patch.object(importlib.import_module(module), name, off):
        yield


def rule_rows(data: Path, seed: int, count: int, rules: Sequence[str]) -> Iterator[Row]:
    """For each of the `rules` the first scenes in which it moves a number, and these numbers with it and without.

    Args:
        data: Folder of the real clouds; those that are not there are left out.
        seed: Of all scenes.
        count: Houses from each scanner, and random rooms at each noise.
        rules: Names of rules.
    """
    suites: dict[str, Callable[[], Row]] = {
        "rooms": partial(_rooms, seed, count),
        "labelled rooms": partial(_rooms, seed, count, labelled=True),
        "real clouds": partial(_real, data),
        "islands": partial(_islands, seed),
        "houses": partial(_houses, seed, count),
        "houses with origins": partial(_houses, seed, count, origins=True),
        "crowded places": partial(_crowded, seed),
        "depth camera": partial(_depth, seed),
        "reflections": partial(_reflections, seed),
        "clouds elsewhere": partial(_elsewhere, data),
        "houses of wide voxels": partial(_houses, seed, count, thin=WIDE),
        "voxels' centres": partial(_houses, seed, count, thin=CENTRED, centres=True),
    }
    whole: dict[str, Row] = {}
    for rule in each(rules, "rules"):
        moved: Row = {"in": "all", "moves": "nothing"}
        for name, suite in suites.items():
            if name not in whole:
                whole[name] = suite()
            with without(rule):
                found = suite()
            other = [f"{key} {was} → {found[key]}" for key, was in whole[name].items() if found[key] != was]
            if other:
                moved = {"in": name, "moves": ", ".join(other)}
                break
        yield {"without": rule} | moved


def _rooms(seed: int, count: int, labelled: bool = False) -> Row:
    """Rooms that two tripods scan, with their labels or without: known ground, free places; summed over all of them."""
    rows = []
    makers = [*((SCENES[name], seed) for name in ROOMS), *((random_room, seed + i) for i in range(count))]
    for make, number in makers:
        clean = make(np.random.default_rng(number))
        for noise in NOISES:
            points = make(np.random.default_rng(number), noise=noise).points
            shown = scanned(points, clean.points, np.random.default_rng(number))
            try:
                scene = build_scene(points[shown], clean.ground[shown] if labelled else None)
            except GpdfError:
                continue
            rows.append({"iou": overlap(scene.ground, clean.ground[shown])} | judge(scene, clean))
    keys = "iou", "known_of_true", "wrong_of_known", "human_free_of_true", "roomba_free_of_true"
    mean = {key: round(float(np.nanmean([row.get(key, np.nan) for row in rows])), 4) for key in keys}
    wrong = ("human_wrong_free", "roomba_wrong_free")
    return {"rooms": len(rows)} | mean | {key: sum(row.get(key, 0) for row in rows) for key in wrong}


def _reflections(seed: int) -> Row:
    """A room that two tripods scan with the most noise, with single points anywhere in the air of it."""
    rng, clean = np.random.default_rng(seed), random_room(np.random.default_rng(seed))
    points = random_room(np.random.default_rng(seed), noise=NOISES[-1]).points
    points = points[scanned(points, clean.points, rng)]
    low, high = points.min(axis=0), points.max(axis=0)
    reflected = rng.uniform(low, high, (int(REFLECTED * len(points)), 3))
    row = judge(build_scene(np.concatenate([points, reflected])), clean)
    return {key: round(row[key], 4) for key in ("known_of_true", "human_free_of_true", "roomba_free_of_true")}


def _houses(seed: int, count: int, **how: Unpack[houses.How]) -> Row:
    made: Row = {}
    for scanner in ("tripod", "handheld"):
        rows = [houses.measure(number, scanner, **how) for number in range(seed, seed + count)]
        made[f"{scanner}_ways"] = sum(row["up"] + row["down"] for row in rows)
        for key in ("inferred", "inferred_off", "inferred_unseen", "wrongly_free", "collisions", "in_the_air"):
            made[f"{scanner}_{key}"] = sum(row.get(key, 0) for row in rows)
    return made


def _crowded(seed: int) -> Row:
    """Where starts land, and the ground of places of which shelves, tracks and stairs make several."""
    rows = list(places.land_rows("tripod", STARTS, seed, None, ONE_FLOOR[::3]))
    labels = list(places.label_rows("tripod", 3, seed, None, (supermarket, platform, museum, workshop, bedroom)))
    return {key: sum(row[key] for row in rows) for key in ("landed", "no_ground", "touching")} | {
        f"{row['place']}_{key}": row[key] for row in labels for key in ("found_mean", "wrong_mean")
    }


def _depth(seed: int) -> Row:
    """The ground of places full of lids, as a camera sees them whose noise grows with the square of the distance."""
    rows = list(places.label_rows("depth", 3, seed, DEPTH_NOISE, (workshop, bedroom)))
    return {f"{row['place']}_{key}": row[key] for row in rows for key in ("found_mean", "wrong_mean")}


def _islands(seed: int) -> Row:
    """A pit, a gallery and a platform: places known, and those wrongly joined; over shafts, those free."""
    rows = list(places.island_rows("tripod", 1, seed))
    known = round(sum(row["known"] * row["places"] for row in rows) / max(sum(row["places"] for row in rows), 1), 4)
    return {
        "island_known": known,
        "stands": sum(row["stands"] for row in rows),
        "joined": sum(row["joined"] for row in rows),
        "over_shaft": sum(row["over_shaft"] for row in places.shaft_rows("tripod", 3, seed)),
    }


def _elsewhere(data: Path) -> Row:
    """The spiral's published query, and random pairs in a quarry, where cells lie otherwise."""
    made: Row = {}
    if (data / hard_clouds.SPIRAL).exists():
        made["spiral_shifted"] = hard_clouds.shifted_spiral(data, 0)["ok"]
    if (quarry := data / "quarry_heightmap_4cm.npz").exists():
        (row,) = placed_rows([quarry], PAIRS, 0, bodies=("human",))
        made |= {f"quarry_{key}": row[key] for key in ("everywhere", "uncertified")}
    return made


def _real(data: Path) -> Row:
    """A museum's stair, a house's, spiral ramps, a labelled office; of a hamlet how much is ground: roofs are none."""
    made: Row = {}
    if (data / hard_clouds.HALL).exists():
        rows = list(hard_clouds.hall_rows(data, HALL_TURNS, 0, HALL))
        made |= {f"hall_{key}": sum(row[key] for row in rows) for key in ("up", "down", "cut_joined")}
    if (data / hard_clouds.HOUSE).exists():
        row = hard_clouds.turned_house(data, hard_clouds.HOUSE_TURNS, 0)
        made |= {f"house_{key}": row[key] for key in ("up", "down")}
    if (data / hard_clouds.SPIRAL).exists():
        rows = list(hard_clouds.spiral_rows(data, PAIRS, 0, hard_clouds.SPIRAL_BODIES[1:]))
        made["spiral_spot"] = rows[0]["ok"]
    office = data / "s3dis_office.npz"
    if office.exists() and (cloud := read_cloud(office)).ground is not None:
        made["office_iou"] = round(overlap(build_scene(cloud.points).ground, cloud.ground), 4)
    if (hamlet := data / "alpe_hamlet_10cm.npz").exists():
        made["hamlet_ground"] = round(float(build_scene(read_cloud(hamlet).points).ground.mean()), 4)
    return made
